"""The command that compensates the errors of a diagnosed arm: joint positions at which it reaches given poses."""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax.cli.arguments import check_out, pairs, refuse_inputs
from lite6jax.cli.exit_codes import DONE, NOT_REACHED
from lite6jax.errors import InputError, InputWarning
from lite6jax.storage import check_writable, exists, write_atomically


@dataclass(frozen=True)
class Compensate:
    """Compute the joint positions at which a diagnosed arm reaches given poses.

    The targets are a table with x_m y_m z_m or x_mm y_mm z_mm (X, Y, Z are recognised; --column says what else a column
    is); with qw qx qy qz where orientation matters; with q1_rad … where the joints are to stay near given ones (such as
    those of the nominal inverse kinematics); and with the quantities on which the model's effects depend (payload_kg,
    temp1_degC …, time_s). Each row of the output has the joint positions, whether
    the target is reached, the error, and the reason. Exit code 0 if every target is reached, 1 if not.

    For example:

        lite6jax compensate diagnosis.json targets.csv --out joints.csv
        lite6jax compensate diagnosis.json targets.csv --frame base --approach 1 --out joints.csv
        lite6jax compensate diagnosis.json targets.csv --column A=yaw_deg --column B=pitch_deg --column C=roll_deg
            --out joints.csv
    """

    diagnosis: Annotated[Positional[Path], arg(metavar="DIAGNOSIS")]
    """What `diagnose` wrote (.json)."""
    targets: Annotated[Positional[Path], arg(metavar="FILE")]
    """Poses to reach, of the point that was measured (.csv, .parquet)."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Write the joint positions here (.csv), one row per target."""
    frame: Literal["sensor", "base"] = "sensor"
    """The frame of the targets: that of the diagnosed recording's sensor, or the arm's base."""
    approach: Annotated[tuple[int, ...], arg(metavar="-1|0|1")] = ()
    """The direction from which the joints approach every target, one number for all or one for each, for backlash; by
    default each row is approached from the one before."""
    column: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="COLUMN=MEANING")] = ()
    """What a column of the targets is, such as X=x_mm or foo=ignore. May be repeated."""
    effects: Annotated[Path | None, arg(metavar="FILE.py")] = None
    """Effects of your own that the model has. Runs the file."""
    json: bool = False
    """Print JSON instead of the report."""
    force: bool = False
    """Replace the file if it exists."""

    def run(self) -> int:
        """Reads, solves, writes, prints."""
        check_out(self.out, ".csv", self.force)
        refuse_inputs([self.out, self.out.with_suffix(".yaml")], [self.diagnosis, self.targets, self.effects])
        import pyarrow as pa

        from lite6jax.diagnosis.document import read_model
        from lite6jax.domains.pose.compensate import compensate, read_pose_targets
        from lite6jax.effects.user_effects import load_effects
        from lite6jax.recordings import sidecar_path
        from lite6jax.recordings.writing import write_table, write_with_settings
        from lite6jax.report import compensation, screen
        from lite6jax.report.reference import origin_statement

        model = read_model(self.diagnosis, load_effects(self.effects) if self.effects else ())
        approach = self.approach * (model.dof if len(self.approach) == 1 else 1)
        if approach and (len(approach) != model.dof or not set(approach) <= {-1, 0, 1}):
            raise InputError(
                f"--approach {' '.join(map(str, self.approach))}: give -1, 0 or 1, once or for each of the "
                f"{model.dof} joints"
            )
        sidecar = sidecar_path(self.out)
        declared = exists(sidecar_path(self.targets))
        if declared:
            check_writable(sidecar, self.force)
        elif exists(sidecar):
            raise InputError(
                f"{sidecar}: would be read as the settings of {self.out.name}, but belongs to another file; choose "
                "another name for the joint positions, or remove it"
            )
        targets = read_pose_targets(self.targets, model, pairs("--column", self.column))
        found = compensate(model, targets, frame=self.frame, approach=approach or None)
        table = compensation.compensation_columns(found)
        columns = pa.table({name: pa.array(values) for name, values in table.items()})
        if declared:  # so that `predict` reads the joint positions under the same settings
            settings = targets.recording.settings.moved(self.targets.parent, self.out.parent)
            written = [write_with_settings(columns, settings, self.out, self.force), sidecar]
        else:
            written = [write_atomically(self.out, lambda target: write_table(columns, target), self.force)]
        beyond = compensation.outside_warning(found, model)
        if beyond:
            warnings.warn(f"{self.targets}: {beyond}", InputWarning, stacklevel=1)
        if self.json:
            from lite6jax.report import documents

            print(documents.text(documents.document(found), written))
            return DONE if found.reached.all() else NOT_REACHED
        if model.reference is not None:
            screen.show([origin_statement(model.reference)])
        screen.show(compensation.compensation_report(found, model, str(self.targets), self.frame))
        screen.written(written)
        return DONE if found.reached.all() else NOT_REACHED
