"""The command that shows a diagnosis again from its file, and writes its certificate."""

from dataclasses import dataclass
from datetime import date as Date  # noqa: N812 (a field is called date)
from pathlib import Path
from typing import Annotated, final

from tyro.conf import Positional, arg

from lite6jax.cli.arguments import OutFile, check_out, refuse_inputs
from lite6jax.cli.exit_codes import DONE
from lite6jax.cli.inputs import found_recording
from lite6jax.errors import InputError


@final
@dataclass(frozen=True)
class Report:
    """Show a diagnosis again from its file, or write its certificate: accuracy before and after, findings, checksums.

    For example:

        lite6jax report diagnosis.json
        lite6jax report diagnosis.json --certificate certificate.pdf --date 2026-11-21 --instrument "Leica AT960"
    """

    diagnosis: Annotated[Positional[Path], arg(metavar="DIAGNOSIS")]
    """What `diagnose` wrote (.json)."""
    certificate: OutFile = None
    """Write one A4 page here (.pdf)."""
    date: Annotated[str | None, arg(metavar="YYYY-MM-DD")] = None
    """When it was measured, for the certificate; the sidecar's date where not given."""
    instrument: Annotated[str | None, arg(metavar="TEXT")] = None
    """With what it was measured, for the certificate; where not given what the sidecar declares, or else the kind of
    sensor."""
    details: bool = False
    """Print also what was ruled out and what was not tested."""
    json: bool = False
    """Print the JSON document instead of the report."""
    force: bool = False
    """Replace the file if it exists."""

    def run(self) -> int:
        """Reads, writes, prints."""
        if self.certificate:
            check_out(self.certificate, ".pdf", self.force)
            refuse_inputs([self.certificate], [self.diagnosis])
        elif self.date is not None or self.instrument is not None:
            raise InputError("--date, --instrument: stand on a certificate; add --certificate FILE.pdf")
        measured = _date(self.date)
        from lite6jax.diagnosis.document import DAMAGED, document_text, parsed_document, read_document
        from lite6jax.diagnosis.torque_document import is_of_torques, read_torque_document
        from lite6jax.report import diagnosis_tables, screen, statements, torque_statements, torque_tables
        from lite6jax.report.next_steps import Files

        torques = is_of_torques(parsed_document(self.diagnosis))
        document = read_torque_document(self.diagnosis) if torques else read_document(self.diagnosis)
        written = []
        try:
            said = torque_statements.with_statements(document) if torques else statements.with_statements(document)
            recording = found_recording(document, self.diagnosis)
            files = None if recording is None else Files(recording, self.diagnosis)
            tables = torque_tables.torque_report if torques else diagnosis_tables.diagnosis_report
            page = list(tables(said, str(self.diagnosis), files, self.details))
            if self.certificate:
                from lite6jax.report.certificate import Stated, write_certificate

                stated = Stated(measured, self.instrument)
                written.append(write_certificate(said, self.certificate, stated, self.force))
        except InputError:
            raise
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise InputError(f"{self.diagnosis}: is damaged (it lacks {error}); {DAMAGED}") from error
        if self.json:
            print(document_text(document))
            return DONE
        screen.show(page)
        screen.written(written)
        return DONE


def _date(text: str | None) -> Date | None:
    try:
        return None if text is None else Date.fromisoformat(text)
    except ValueError as error:
        raise InputError(f"--date {text}: give a day as YYYY-MM-DD, such as 2026-11-21") from error
