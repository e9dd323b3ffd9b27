"""The command `diagnose --fleet`: the recordings of a folder diagnosed one by one, and then pooled."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lite6jax.cli.arguments import check_processes
from lite6jax.cli.diagnose_folder import diagnosed, run_on_folder
from lite6jax.cli.exit_codes import DONE
from lite6jax.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

    from lite6jax.cli.diagnose import Diagnose
    from lite6jax.folders.place import Place


def diagnose_recorded_fleet(command: "Diagnose") -> int:
    """Diagnoses and pools the recordings of the folder, writes what `diagnose` of a folder does and fleet.json.

    Args:
        command: as it was given; its source is a folder or a URL.
    """
    for option in ("reference", "report", "figures"):
        if getattr(command, option) is not None:
            raise InputError(f"--{option}: is of one recording, and --fleet pools many; leave it out")
    if command.torques:
        raise InputError("--torques: --fleet pools measured poses; leave one of them out")
    if command.out is None or command.out.suffix.lower() == ".json":
        raise InputError(f"{command.source}: is a folder; add --out DIR for the documents of its recordings")
    check_processes(command.processes, command.scheduler)
    from lite6jax.diagnosis.document import document_text
    from lite6jax.folders.listing import recording_names
    from lite6jax.folders.place import Place
    from lite6jax.folders.population import DOCUMENT, check_document, diagnose_recorded_population
    from lite6jax.populations.options import DEFAULTS
    from lite6jax.report import population_tables, screen
    from lite6jax.storage import write_atomically

    check_document(command.out, recording_names(Place.of(command.source)), command.force)
    run_on_folder(command, command.out, diagnose_and_reduce)
    effects = [0]
    with screen.repeated(lambda: f"pooling the recordings: {effects[0]} effects so far"):
        found = diagnose_recorded_population(
            str(command.source),
            command.out,
            DEFAULTS,
            command.over,
            command.scheduler,
            command.processes,
            lambda count: effects.__setitem__(0, count),
        )
    document = found.to_dict()
    path = write_atomically(command.out / DOCUMENT, document_text(document), overwrite=command.force)
    if command.json:
        print(document_text(document))
        return DONE
    screen.show(population_tables.population_report(document))
    screen.written([command.out / "summary.parquet", path])
    return DONE


def diagnose_and_reduce(names: Sequence[str], place: "Place", command: "Diagnose") -> "pa.Table":
    """The rows of some recordings with their documents and reduced recordings."""
    from lite6jax.distribution.batches import concatenated

    return concatenated([diagnosed(name, place, command, _reduced) for name in names])


def _reduced(command: "Diagnose") -> tuple[str, bytes]:
    """The document of the poses of one recording as of the command, and its reduced form."""
    from lite6jax.diagnosis.document import document_text
    from lite6jax.populations.reduction import reduced

    found, document = command.diagnosed_poses()
    return document_text(document), reduced(found).to_bytes()
