"""The command `diagnose` of a folder, or of what is behind a URL: a document for each recording, a table, a fleet."""

import contextlib
import io
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lite6jax.cli.arguments import check_processes
from lite6jax.cli.exit_codes import DONE
from lite6jax.errors import InputError, InputWarning
from lite6jax.folders.place import Place, sha256_of, url_of
from lite6jax.storage import temporary_folder

if TYPE_CHECKING:
    import pyarrow as pa

    from lite6jax.distribution.batches import Run
    from lite6jax.populations.population import Population

Command = Any
"""The command `diagnose` as it was given, of which this module is a part."""


def is_folder(source: Path) -> bool:
    """Whether a source is a folder of recordings, and not a recording that is a folder."""
    if url_of(source) is not None:
        return True
    if not os.path.isdir(source):
        return False
    from lite6jax.recordings import recording_file

    return recording_file(source) is None


def diagnose_recordings(command: Command) -> int:
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


def diagnose_recorded_fleet(command: Command) -> int:
    """Diagnoses and pools the recordings of the folder, writes what `diagnose` of a folder does and fleet.json.

    Args:
        command: as it was given; its source is a folder or a URL.
    """
    refuse_options_of_one(command, "--fleet pools many")
    if command.out is None or command.out.suffix.lower() == ".json":
        raise InputError(f"{command.source}: is a folder; add --out DIR for the documents of its recordings")
    check_processes(command.processes, command.scheduler)
    import pyarrow as pa

    from lite6jax.diagnosis.document import document_text
    from lite6jax.distribution.batches import Parts
    from lite6jax.folders.diagnoses import POOLED, TABLE, check_pooled
    from lite6jax.folders.place import recording_names
    from lite6jax.report import fleets, screen
    from lite6jax.storage import write_atomically

    place = Place.of(command.source)
    names = recording_names(place)
    check_pooled(command.out, names, command.force)
    asked, also_read = asked_of(command)
    parts = Parts(command.out / POOLED, asked)
    diagnoses = parts.key(place.content(names) + also_read)
    if parts.find(diagnoses) is None:  # a run that was ended while it pooled has them all
        run = run_on_folder(command, command.out, diagnose_and_reduce)
        parts.keep(diagnoses, pa.table({"recordings": [run.rows]}))
    document = _pooled(command).to_dict()
    path = write_atomically(command.out / POOLED, document_text(document), overwrite=command.force)
    parts.remove()
    if command.json:
        print(document_text(document))
        return DONE
    screen.show(fleets.population_report(document))
    screen.written([command.out / TABLE, path])
    return DONE


def _pooled(command: Command) -> "Population":
    from lite6jax.folders.diagnoses import pool_folder
    from lite6jax.populations.options import DEFAULTS
    from lite6jax.report import screen

    assert command.out is not None
    effects = [0]
    with screen.repeated(lambda: f"pooling the recordings: {effects[0]} effects so far"):
        return pool_folder(
            str(command.source),
            command.out,
            DEFAULTS,
            command.over,
            command.scheduler,
            command.processes,
            lambda count: effects.__setitem__(0, count),
        )


def refuse_options_of_one(command: Command, many: str) -> None:
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


def run_on_folder(command: Command, out: Path, diagnose: "Callable[..., pa.Table]") -> "Run":
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


def asked_of(command: Command) -> tuple[Command, bytes]:
    """What of the command the diagnoses depend on, and the checksums of the files that they all read."""
    read = [Path(file.partition("#")[0]) for file in (command.arm, command.effects and str(command.effects)) if file]
    alike = {"source": Path(), "out": None, "force": True, "fleet": False}
    alike |= dict.fromkeys(("json", "details"), False) | dict.fromkeys(("processes", "scheduler", "over"))
    return replace(command, **alike), sha256_of(read)


def diagnose_names(names: Sequence[str], place: Place, command: Command) -> "pa.Table":
    """The rows of some recordings of a folder with their documents, which are those of the command on each file."""
    from lite6jax.distribution.batches import concatenate

    return concatenate([diagnosed(name, place, command, _as_by_the_command) for name in names])


def diagnosed(
    name: str,
    place: Place,
    command: Command,
    work: Callable[[Command], tuple[str, bytes | None]],
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

    with place.local_folder([name]) as folder, temporary_folder() as written:
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
            return refusal(name, place.show(str(error), folder))
        except Exception as error:  # a defect of ours, met on one recording, is no reason to lose the others
            found = " ".join(f"{type(error).__name__}: {error}".split())
            said = f"{folder / name}: unexpected {found}; please report it with this recording"
            return refusal(name, place.show(said, folder))
        said = dict.fromkeys(str(remark.message) for remark in remarks if issubclass(remark.category, InputWarning))
        row = row_of(name, json.loads(text), text, place.show("; ".join(said), folder))
        return row if reduced is None else with_reduced(row, reduced)


def _as_by_the_command(command: Command) -> tuple[str, None]:
    command.run()
    assert command.out is not None
    return command.out.read_text(), None


def diagnose_and_reduce(names: Sequence[str], place: Place, command: Command) -> "pa.Table":
    """The rows of some recordings with their documents and reduced recordings."""
    from lite6jax.distribution.batches import concatenate

    return concatenate([diagnosed(name, place, command, _reduced) for name in names])


def _reduced(command: Command) -> tuple[str, bytes]:
    """The document of the poses of one recording as of the command, or of its torques, and its reduced form."""
    from lite6jax.diagnosis.document import document_text
    from lite6jax.populations.files import to_bytes
    from lite6jax.populations.reduction import reduced

    found, document = command.diagnosed()
    return document_text(document), to_bytes(reduced(found))
