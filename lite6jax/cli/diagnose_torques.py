"""The commands `diagnose` and `predict` where torques are measured instead of poses."""

from typing import TYPE_CHECKING

from lite6jax.cli.drawing import draw
from lite6jax.cli.exit_codes import DONE
from lite6jax.cli.inputs import inputs
from lite6jax.errors import InputError
from lite6jax.storage import write_atomically

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.cli.diagnose import Diagnose, Predict
    from lite6jax.recordings import Recording


def diagnose_motors(command: "Diagnose", recording: "Recording", arm: "Arm | None") -> int:
    """Searches a recording of torques, writes and prints what was found.

    Args:
        command: as it was given; its paths have been checked.
        recording: without poses.
        arm: the nominal arm; from the sidecar where not given.
    """
    from lite6jax.diagnosis.document import document_text, write_document
    from lite6jax.diagnosis.options import QUICK
    from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
    from lite6jax.diagnosis.torque_document import to_torque_document
    from lite6jax.report import canvas, screen, stages, torque_figures, torque_page, torque_tables, worth
    from lite6jax.report.next_steps import Files
    from lite6jax.report.torque_statements import with_statements

    for given, name in ((command.reference, "--reference"), (command.effects, "--effects")):
        if given is not None:
            raise InputError(f"{name}: {command.source} has torques and no poses; {name} needs poses")
    if command.figures:
        names = [f"{command.source.stem}_{name}" for name in torque_figures.NAMES]
        canvas.check_names(command.figures, names, command.force)
    with stages.shown() as entered:
        found = diagnose_torques(recording, arm, options=QUICK if command.quick else None, progress=entered)
    document = with_statements({**to_torque_document(found), "inputs": inputs(command.source, command.arm)})
    files = Files(command.source, command.out)
    written = [write_document(document, command.out, command.force)] if command.out else []
    if command.report or command.figures:
        drawings = torque_figures.drawings(found, command.source.name, worth.order(document))
        written += draw(
            command,
            drawings,
            len(torque_figures.NAMES),
            lambda drawn: torque_page.torque_page(found, document, str(command.source), drawn, files),
        )
    if command.json:
        print(document_text(document))
        return DONE
    screen.show(torque_tables.torque_report(document, str(command.source), files, command.details))
    screen.show(screen.notes(recording.notes))
    screen.written(written)
    return DONE


def predict_motors(command: "Predict") -> int:
    """Writes the torques of a motion."""
    import pyarrow as pa

    from lite6jax.diagnosis.torque_document import read_torque_model
    from lite6jax.domains.pose.files import read_motion
    from lite6jax.domains.torque.predict import predict_torques
    from lite6jax.recordings.writing import write_table
    from lite6jax.report import screen

    if command.register or command.effects is not None:
        raise InputError(
            "--register, --effects: a diagnosis of torques has neither a sensor frame nor effects of yours"
        )
    model = read_torque_model(command.diagnosis)
    recording = read_motion(command.motion, model)
    torque = predict_torques(model, recording)
    columns = pa.table({f"tau{joint}_Nm": row for joint, row in enumerate(torque.T, 1)})
    path = write_atomically(command.out, lambda target: write_table(columns, target), command.force)
    if command.json:
        from lite6jax.report import documents

        print(documents.text({"schema": "lite6jax/prediction/1", "rows": len(torque)}, [path]))
        return DONE
    screen.show(screen.notes(recording.notes))
    screen.written([path])
    return DONE
