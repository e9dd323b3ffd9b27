"""The command `diagnose --fleet`: the recordings of a folder diagnosed one by one, and then pooled."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from lite6jax.cli.arguments import check_processes
from lite6jax.cli.diagnose_folder import asked_of, diagnosed, refuse_options_of_one, run_on_folder
from lite6jax.cli.exit_codes import DONE
from lite6jax.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

    from lite6jax.cli.diagnose import Diagnose
    from lite6jax.folders.place import Place
    from lite6jax.populations.population import Population


def diagnose_recorded_fleet(command: "Diagnose") -> int:
    """Diagnoses and pools the recordings of the folder, writes what `diagnose` of a folder does and fleet.json.

    Args:
        command: as it was given; its source is a folder or a URL.
    """
    refuse_options_of_one(command, "--fleet pools many")
    if command.out is None or command.out.suffix.lower() == ".json":
        raise InputError(f"{command.source}: is a folder; add --out DIR for the documents of its recordings")
    check_processes(command.processes, command.scheduler)
    from lite6jax.diagnosis.document import document_text
    from lite6jax.distribution.kept import Kept
    from lite6jax.folders.diagnoses import TABLE
    from lite6jax.folders.listing import recording_names
    from lite6jax.folders.place import Place
    from lite6jax.folders.population import DOCUMENT, check_document
    from lite6jax.report import fleets, screen
    from lite6jax.storage import write_atomically

    place = Place.of(command.source)
    names = recording_names(place)
    check_document(command.out, names, command.force)
    asked, also_read = asked_of(command)
    kept = Kept(command.out / DOCUMENT, asked)
    diagnoses = kept.key(place.content(names) + also_read)
    try:
        if kept.find(diagnoses) is None:  # a run that was ended while it pooled has them all
            run_on_folder(command, command.out, diagnose_and_reduce)
            kept.keep(diagnoses, b"")
        document = _pooled(command).to_dict()
    except BaseException:
        kept.close()
        raise
    path = write_atomically(command.out / DOCUMENT, document_text(document), overwrite=command.force)
    kept.close(remove=True)
    if command.json:
        print(document_text(document))
        return DONE
    screen.show(fleets.population_report(document))
    screen.written([command.out / TABLE, path])
    return DONE


def _pooled(command: "Diagnose") -> "Population":
    from lite6jax.folders.population import diagnose_recorded_population
    from lite6jax.populations.options import DEFAULTS
    from lite6jax.report import screen

    assert command.out is not None
    effects = [0]
    with screen.repeated(lambda: f"pooling the recordings: {effects[0]} effects so far"):
        return diagnose_recorded_population(
            str(command.source),
            command.out,
            DEFAULTS,
            command.over,
            command.scheduler,
            command.processes,
            lambda count: effects.__setitem__(0, count),
        )


def diagnose_and_reduce(names: Sequence[str], place: "Place", command: "Diagnose") -> "pa.Table":
    """The rows of some recordings with their documents and reduced recordings."""
    from lite6jax.distribution.batches import concatenated

    return concatenated([diagnosed(name, place, command, _reduced) for name in names])


def _reduced(command: "Diagnose") -> tuple[str, bytes]:
    """The document of the poses of one recording as of the command, or of its torques, and its reduced form."""
    from lite6jax.diagnosis.document import document_text
    from lite6jax.diagnosis.torque_result import TorqueDiagnosis
    from lite6jax.populations.files import to_bytes
    from lite6jax.populations.reduction import reduced, reduced_torques

    found, document = command.diagnosed()
    made = reduced_torques(found) if isinstance(found, TorqueDiagnosis) else reduced(found)
    return document_text(document), to_bytes(made)
