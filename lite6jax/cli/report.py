"""The command that shows a diagnosis again from its file, and writes its certificate."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import date as Date  # noqa: N812 (a field is called date)
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, final

from tyro.conf import Positional, arg

from lite6jax.cli.arguments import OutFile, check_out, refuse_inputs
from lite6jax.cli.exit_codes import DONE
from lite6jax.cli.inputs import found_recording
from lite6jax.errors import InputError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from lite6jax.report.ranking import Files

    Worded = Callable[[Mapping[str, Any]], dict[str, Any]]
    Reported = Callable[[Mapping[str, Any], str, Files | None, bool], Iterator[RenderableType]]


@final
@dataclass(frozen=True)
class Report:
    """Show a diagnosis again from its file, or write its certificate: accuracy before and after, findings, checksums.

    For example:

        lite6jax report diagnosis.json
        lite6jax report results/fleet.json
        lite6jax report diagnosis.json --certificate certificate.pdf --date 2026-11-21 --instrument "Leica AT960"
    """

    diagnosis: Annotated[Positional[Path], arg(metavar="DIAGNOSIS")]
    """What `diagnose` wrote (.json), of one recording or of a fleet."""
    certificate: OutFile = None
    """Write one A4 page here (.pdf), of one recording."""
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
        from lite6jax.diagnosis.document import DAMAGED, check_sum, document_text, parsed_document
        from lite6jax.populations.schema import is_of_fleet
        from lite6jax.report import screen
        from lite6jax.report.ranking import Files

        document = parsed_document(self.diagnosis)
        if self.certificate and is_of_fleet(document):
            raise InputError(f"--certificate: is of one recording, and {self.diagnosis} is of a fleet; leave it out")
        with_statements, report = _checked(document, self.diagnosis)
        check_sum(document, self.diagnosis)
        written = []
        try:
            said = with_statements(document)
            recording = found_recording(document, self.diagnosis)
            files = None if recording is None else Files(recording, self.diagnosis)
            page = list(report(said, str(self.diagnosis), files, self.details))
            if self.certificate:
                from lite6jax.report.pages import Stated, write_certificate

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


def _checked(document: Any, diagnosis: Path) -> "tuple[Worded, Reported]":
    """What adds the sentences to a document, and what makes the screen report of it then; refuses a damaged one."""
    from lite6jax.diagnosis.document import check_document
    from lite6jax.populations.schema import check_fleet_document, is_of_fleet

    if is_of_fleet(document):
        from lite6jax.report.fleets import population_report

        check_fleet_document(document, diagnosis)
        return dict, lambda said, source, files, details: population_report(said)
    from lite6jax.report.sections import diagnosis_report
    from lite6jax.report.statements import with_statements

    check_document(document, diagnosis)
    return with_statements, diagnosis_report


def _date(text: str | None) -> Date | None:
    try:
        return None if text is None else Date.fromisoformat(text)
    except ValueError as error:
        raise InputError(f"--date {text}: give a day as YYYY-MM-DD, such as 2026-11-21") from error
