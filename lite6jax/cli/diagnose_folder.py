"""The command `diagnose` of a folder, or of what is behind a URL: a document for each recording, and a table."""

import contextlib
import io
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from lite6jax.cli.arguments import check_processes
from lite6jax.cli.exit_codes import DONE
from lite6jax.errors import InputError, InputWarning
from lite6jax.folders.place import Place, url_of
from lite6jax.temporaries import temporary_folder

if TYPE_CHECKING:
    import pyarrow as pa

    from lite6jax.cli.diagnose import Diagnose
    from lite6jax.distribution.batches import Run


def is_folder(source: Path) -> bool:
    """Whether a source is a folder of recordings, and not a recording that is a folder."""
    if url_of(source) is not None:
        return True
    if not os.path.isdir(source):
        return False
    from lite6jax.recordings import recording_file

    return recording_file(source) is None


def diagnose_recordings(command: "Diagnose") -> int:
    """Diagnoses every recording of the folder, writes the documents and the table, and prints the table.

    Args:
        command: as it was given; its source is a folder or a URL.
    """
    refuse_options_of_one(command, f"{command.source} is a folder")
    if command.out is None:
        raise InputError(f"{command.source}: is a folder; add --out DIR for the documents of its recordings")
    if command.out.suffix.lower() == ".json":
        raise InputError(
            f"{command.source}: is a folder; name a file in it, or a folder with --out for the documents of all"
        )
    check_processes(command.processes, command.scheduler)
    from lite6jax.report import fleets, screen

    run = run_on_folder(command, command.out, diagnose_names)
    if command.json:
        from lite6jax.report import documents

        print(documents.text(documents.of_diagnoses(fleets.read_diagnoses(run.path)), [run.path]))
        return DONE
    screen.show(fleets.diagnoses_report(fleets.read_diagnoses(run.path), run.kept))
    screen.written([run.path])
    return DONE


def refuse_options_of_one(command: "Diagnose", many: str) -> None:
    """Refuses what can only be made of one recording.

    Args:
        command: as it was given.
        many: why there are several recordings, a clause.

    Raises:
        InputError: such an option was given.
    """
    for option in ("reference", "report", "figures"):
        if getattr(command, option) is not None:
            raise InputError(f"--{option}: is of one recording, and {many}; leave it out")


def run_on_folder(command: "Diagnose", out: Path, diagnose: "Callable[..., pa.Table]") -> "Run":
    """Diagnoses every recording of the folder by a function of a module, with progress.

    Args:
        command: as it was given.
        out: the folder of results.
        diagnose: of names, place and command, as `diagnose_names`.
    """
    from lite6jax.folders.diagnoses import diagnose_folder
    from lite6jax.report import screen

    asked, also_read = asked_of(command)
    with screen.progress_of_many("diagnosing") as advance:
        return diagnose_folder(
            command.source,
            out,
            diagnose,
            (asked,),
            also_read=also_read,
            scheduler=command.scheduler,
            processes=command.processes,
            progress=advance,
            overwrite=command.force,
        )


def asked_of(command: "Diagnose") -> "tuple[Diagnose, bytes]":
    """What of the command the diagnoses depend on, and the checksums of the files that they all read."""
    from lite6jax.distribution.kept import sha256_of

    read = [Path(file.partition("#")[0]) for file in (command.arm, command.effects and str(command.effects)) if file]
    alike = {"source": Path(), "out": None, "force": True, "fleet": False}
    alike |= dict.fromkeys(("json", "details"), False) | dict.fromkeys(("processes", "scheduler", "over"))
    return replace(command, **alike), sha256_of(read)


def diagnose_names(names: Sequence[str], place: Place, command: "Diagnose") -> "pa.Table":
    """The rows of some recordings of a folder with their documents, which are those of the command on each file."""
    from lite6jax.distribution.batches import concatenated

    return concatenated([diagnosed(name, place, command, _as_by_the_command) for name in names])


def diagnosed(
    name: str,
    place: Place,
    command: "Diagnose",
    work: "Callable[[Diagnose], tuple[str, bytes | None]]",
) -> "pa.Table":
    """The row of one recording.

    Args:
        name: of the recording.
        place: its folder.
        command: as it was given, but for its source and `out`.
        work: of the command with source and `out`: the document, and the bytes of the reduced recording, if any.
    """
    import json

    from lite6jax.folders.diagnoses import refusal, row_of, with_reduced

    with place.at_hand([name]) as folder, temporary_folder() as written:
        out = written / "diagnosis.json"
        try:
            with (
                warnings.catch_warnings(record=True) as remarks,
                contextlib.redirect_stdout(io.StringIO()),
                contextlib.redirect_stderr(io.StringIO()),
            ):
                warnings.simplefilter("always", InputWarning)
                text, reduced = work(replace(command, source=folder / name, out=out))
        except InputError as error:
            return refusal(name, place.as_shown(str(error), folder))
        except Exception as error:  # a defect of ours, met on one recording, is no reason to lose the others
            found = " ".join(f"{type(error).__name__}: {error}".split())
            said = f"{folder / name}: unexpected {found}; please report it with this recording"
            return refusal(name, place.as_shown(said, folder))
        said = dict.fromkeys(str(remark.message) for remark in remarks if issubclass(remark.category, InputWarning))
        row = row_of(name, json.loads(text), text, place.as_shown("; ".join(said), folder))
        return row if reduced is None else with_reduced(row, reduced)


def _as_by_the_command(command: "Diagnose") -> tuple[str, None]:
    command.run()
    assert command.out is not None
    return command.out.read_text(), None
