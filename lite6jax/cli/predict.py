"""The command `predict`: what the sensor of a diagnosed recording would show in another motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from lite6jax.cli.arguments import refuse_inputs
from lite6jax.cli.exit_codes import DONE
from lite6jax.errors import InputError
from lite6jax.storage import check_writable, write_atomically

if TYPE_CHECKING:
    from lite6jax.effects.effect import Effect
    from lite6jax.recordings import Recording


@dataclass(frozen=True)
class Predict:
    """Predict what the sensor of a diagnosed recording would measure in another motion of the same arm.

    Of a diagnosis of torques these are tau1_Nm …, the torques of the motors, and tau1_std_Nm …, which contain the
    sensor's noise as well. Of one of poses and torques both are written, if the motion is a trajectory.

    Beside each pose stand its standard deviations, x_std_m … and where orientation was recorded rx_std_rad … about the
    axes of the tool. They contain what the diagnosis left uncertain, and not the sensor's noise. Where `outside` is 1
    the recording does not support the row: it is beyond the recorded range, or in a gap of it.

    For example:

        lite6jax predict diagnosis.json motion.csv --out predicted.csv
        lite6jax predict diagnosis.json run9.csv --register --out predicted.csv
    """

    diagnosis: Annotated[Positional[Path], arg(metavar="DIAGNOSIS")]
    """What `diagnose` wrote (.json)."""
    motion: Annotated[Positional[Path], arg(metavar="FILE")]
    """Joint positions, and the other quantities on which the model's effects depend (.csv, .parquet)."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Write the poses here (.csv), one row per sample."""
    register: bool = False
    """First fit sensor frame and tool to the poses in the file, for another set-up of the same arm."""
    effects: Annotated[Path | None, arg(metavar="FILE.py")] = None
    """Effects of your own that the model has. Runs the file."""
    json: bool = False
    """Print JSON instead of the report."""
    force: bool = False
    """Replace the file if it exists."""

    def run(self) -> int:
        """Reads, predicts, writes."""
        check_writable(self.out, self.force)
        if self.out.suffix.lower() != ".csv":
            raise InputError(f"{self.out}: what is written here is csv; let the name end in .csv")
        refuse_inputs([self.out], [self.diagnosis, self.motion, self.effects])
        import sys

        import numpy as np
        import pyarrow as pa

        from lite6jax.diagnosis.document import (
            check_sum,
            is_of_torques,
            model_from_document,
            parsed_document,
            torque_model_from_document,
            torques_of,
        )
        from lite6jax.domains.pose.files import read_motion
        from lite6jax.domains.pose.predict import predicted, prediction_columns
        from lite6jax.domains.pose.registration import register_model
        from lite6jax.domains.torque.predict import predicted_torques, torque_columns
        from lite6jax.effects.user_effects import load_effects
        from lite6jax.recordings.writing import write_table
        from lite6jax.report import compensation, reference, screen

        document, effects = parsed_document(self.diagnosis), load_effects(self.effects) if self.effects else ()
        opening: list[Any] = []
        said: list[str] = []
        registration, poses = None, None
        if is_of_torques(document):
            if self.register:
                raise InputError("--register: a diagnosis of torques has no sensor frame")
            motors = torque_model_from_document(document, effects, str(self.diagnosis))
            check_sum(document, self.diagnosis)
            recording = read_motion(self.motion, motors)
            found = predicted_torques(motors, recording)
            columns, first = torque_columns(found), found.torque[:, 0]
            if motors.relative_to is not None:
                opening.append(reference.torque_model_statement(motors.relative_to, "rows"))
        else:
            model = model_from_document(document, effects, str(self.diagnosis))
            check_sum(document, self.diagnosis)
            recording = read_motion(self.motion, model)
            if self.register:
                model, registration = register_model(model, recording)
            found = poses = predicted(model, recording)
            columns, first = prediction_columns(poses, model.orientation), poses.poses[:, 0, 0]
            if torques_of(document) is not None:
                columns, said = self._with_torques(document, columns, recording, effects)
            if model.reference is not None:
                opening.append(reference.origin_statement(model.reference))
            if registration is not None:
                opening += compensation.registration_report(registration)
        table = pa.table(columns)
        path = write_atomically(self.out, lambda target: write_table(table, target), self.force)
        if self.json:
            from lite6jax.report import documents

            rows = {"schema": "lite6jax/prediction/1", "rows": recording.samples}
            print(documents.text(rows if poses is None else documents.of_prediction(poses, registration), [path]))
            return DONE
        screen.show(opening)
        screen.show(screen.notes(recording.notes))
        if empty := int(np.isnan(first).sum()):
            why = "there is a gap of its times" if poses is None else "the clock offset reaches beyond the ends"
            print(f"{empty} rows are empty: there, {why} of the motion.")
        if found.outside is None:
            print(f"{self.diagnosis}: {compensation.NO_BARS}", file=sys.stderr)
        else:
            print(compensation.outside_sentence(int(found.outside.sum()), len(found.outside), "row"))
        for line in said:
            print(line)
        screen.written([path])
        return DONE

    def _with_torques(
        self, document: Any, poses: "dict[str, Any]", recording: "Recording", effects: "Sequence[Effect]"
    ) -> "tuple[dict[str, Any], list[str]]":
        """The columns of poses with those of torques beside them, and what is to be said of these.

        A row is outside where it is of poses or of torques. Torques of a motion that has none are left out.
        """
        from lite6jax.diagnosis.document import torque_model_from_document
        from lite6jax.domains.torque.predict import predicted_torques, torque_columns

        model = torque_model_from_document(document, effects, str(self.diagnosis))
        try:
            found = predicted_torques(model, recording)
        except InputError as error:
            return poses, [f"Torques are not predicted: {error}."]
        columns = poses | torque_columns(found)
        if found.outside is None:
            return columns, []
        columns["outside"] = (found.outside | (poses["outside"] > 0 if "outside" in poses else False)).astype(int)
        count, rows = int(found.outside.sum()), len(found.outside)
        few = "Of the torques no row is outside what was recorded."
        return columns, [f"Of the torques: {count} of {rows} rows are outside what was recorded." if count else few]
