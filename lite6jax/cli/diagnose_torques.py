"""The commands `diagnose` and `predict` where torques are measured, instead of poses or beside them."""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from lite6jax.cli.exit_codes import BAD_FIT, DONE
from lite6jax.cli.inputs import inputs
from lite6jax.cli.outputs import Drawings, check_figures, present
from lite6jax.errors import InputError
from lite6jax.storage import write_atomically

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.cli.diagnose import Diagnose, Predict
    from lite6jax.domains.torque.predict import TorquePrediction
    from lite6jax.effects.effect import Effect
    from lite6jax.recordings import Recording


def diagnose_motors(
    command: "Diagnose",
    recording: "Recording",
    arm: "Arm | None",
    other: "Recording | None",
    effects: "Sequence[Effect]",
) -> int:
    """Searches the torques of a recording, writes and prints what was found.

    Args:
        command: as it was given; its paths have been checked.
        recording: with torques; poses that it has are not used.
        arm: the nominal arm; from the sidecar where not given.
        other: the reference, if any.
        effects: a user's own; those on torques are used.
    """
    from lite6jax.diagnosis.options import QUICK
    from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
    from lite6jax.diagnosis.torque_document import to_torque_document
    from lite6jax.diagnosis.torque_reference import diagnose_torques_against
    from lite6jax.effects.user_effects import by_domain
    from lite6jax.report import screen
    from lite6jax.report.sections import diagnosis_report
    from lite6jax.report.statements import with_statements

    if command.figures:
        from lite6jax.report.diagnosis_figures import TORQUE_NAMES

        check_figures(command, TORQUE_NAMES)
    _, dynamic = by_domain(effects)
    with screen.stages() as entered:
        options = QUICK if command.quick else None
        if other is None:
            found, seen = diagnose_torques(recording, arm, effects=dynamic, options=options, progress=entered), None
        else:
            found, seen = diagnose_torques_against(
                recording, other, arm, effects=dynamic, options=options, progress=entered
            )
    read = inputs(command.source, command.arm, command.reference, command.effects)
    document = {**to_torque_document(found), "inputs": read}
    if seen is not None:
        document["against"] = seen.to_dict()
    document = with_statements(document)

    def drawings() -> Drawings:
        from lite6jax.report import diagnosis_figures, pages

        figures = diagnosis_figures.drawings(found, command.source.name, document)
        return Drawings(figures, len(diagnosis_figures.TORQUE_NAMES), partial(pages.diagnosis_page, found, document))

    present(command, recording, document, diagnosis_report, drawings, None if seen is None else seen.file)
    return DONE


def diagnose_both(
    command: "Diagnose",
    recording: "Recording",
    arm: "Arm",
    other: "Recording | None",
    effects: "Sequence[Effect]",
) -> int:
    """Searches the poses and the torques of a recording, writes and prints what was found; arguments as above."""
    from lite6jax.diagnosis.combined import diagnose_combined
    from lite6jax.diagnosis.options import QUICK
    from lite6jax.report import diagnosis_figures, pages, screen
    from lite6jax.report.diagnosis_figures import NAMES, PREFIX, TORQUE_NAMES
    from lite6jax.report.sections import diagnosis_report
    from lite6jax.report.statements import with_statements

    names = [*NAMES, *(PREFIX + name for name in TORQUE_NAMES)]
    check_figures(command, names)
    with screen.stages() as entered:
        found = diagnose_combined(
            recording,
            arm,
            reference=other,
            geometry=command.geometry,
            options=QUICK if command.quick else None,
            effects=effects,
            progress=entered,
        )
    read = inputs(command.source, command.arm, command.reference, command.effects)
    document = with_statements({**found.to_dict(), "inputs": read})

    def drawings() -> Drawings:
        figures = diagnosis_figures.drawings(found, command.source.name, document)
        return Drawings(figures, len(names), partial(pages.diagnosis_page, found, document))

    present(command, recording, document, diagnosis_report, drawings, None if other is None else other.source)
    return BAD_FIT if found.poses.quality.verdict == "bad" else DONE


def predict_motors(command: "Predict", document: "dict[str, Any]", effects: "Sequence[Effect]") -> int:
    """Writes the torques of a motion, with their standard deviations.

    Args:
        command: as it was given.
        document: of the diagnosis that it names.
        effects: a user's own, where the model has them.
    """
    import pyarrow as pa

    from lite6jax.diagnosis.document import check_sum
    from lite6jax.diagnosis.torque_document import torque_model_from_document
    from lite6jax.domains.pose.files import read_motion
    from lite6jax.domains.torque.predict import predicted_torques, torque_columns
    from lite6jax.recordings.writing import write_table
    from lite6jax.report import screen
    from lite6jax.report.reference import torque_model_statement

    if command.register:
        raise InputError("--register: a diagnosis of torques has no sensor frame")
    model = torque_model_from_document(document, effects, str(command.diagnosis))
    check_sum(document, command.diagnosis)
    recording = read_motion(command.motion, model)
    shown = predicted_torques(model, recording)
    columns = pa.table(torque_columns(shown))
    path = write_atomically(command.out, lambda target: write_table(columns, target), command.force)
    if command.json:
        from lite6jax.report import documents

        print(documents.text({"schema": "lite6jax/prediction/1", "rows": recording.samples}, [path]))
        return DONE
    if model.relative_to is not None:
        screen.show([torque_model_statement(model.relative_to, "rows")])
    screen.show(screen.notes(recording.notes))
    _say_outside(command, shown)
    screen.written([path])
    return DONE


def _say_outside(command: "Predict", shown: "TorquePrediction") -> None:
    import sys

    from lite6jax.report.compensation import NO_BARS, outside_sentence

    if shown.outside is None:
        print(f"{command.diagnosis}: {NO_BARS}", file=sys.stderr)
    else:
        print(outside_sentence(int(shown.outside.sum()), len(shown.outside), "row"))


def torques_beside(
    command: "Predict",
    document: "dict[str, Any]",
    poses: "dict[str, Any]",
    recording: "Recording",
    effects: "Sequence[Effect]",
) -> "tuple[dict[str, Any], list[str]]":
    """The columns of poses with those of torques beside them, and what is to be said of these.

    A row is outside where it is of poses or of torques. Torques of static poses are left out.

    Args:
        command: as it was given.
        document: of the diagnosis that it names.
        poses: columns.
        recording: the motion.
        effects: a user's own, where the model has them.
    """
    from lite6jax.diagnosis.torque_document import torque_model_from_document
    from lite6jax.domains.torque.predict import predicted_torques, torque_columns

    model = torque_model_from_document(document, effects, str(command.diagnosis))
    try:
        found = predicted_torques(model, recording)
    except InputError as error:
        return poses, [f"Torques are not predicted: {error}."]
    columns = poses | torque_columns(found)
    if found.outside is None:
        return columns, []
    columns["outside"] = (found.outside | (poses["outside"] > 0 if "outside" in poses else False)).astype(int)
    count, rows = int(found.outside.sum()), len(found.outside)
    return columns, [f"Of the torques: {count} of {rows} rows are outside what was recorded." if count else
                     "Of the torques no row is outside what was recorded."]  # fmt: skip
