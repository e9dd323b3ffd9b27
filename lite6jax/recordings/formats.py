"""Recordings in files and folders with a sidecar: read whole or refused in one line, and written exactly."""

from collections.abc import Mapping, Sequence
from math import pi
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.arms.files import read_arm
from lite6jax.errors import InputError, require_type
from lite6jax.recordings.checks import check_joint_scale, check_position_scale
from lite6jax.recordings.columns import is_per_joint
from lite6jax.recordings.plausible import without_implausible
from lite6jax.recordings.recording import Recording, drop_missing
from lite6jax.recordings.ros import ArmJoints
from lite6jax.recordings.settings import RecordingSettings
from lite6jax.recordings.sidecar import Sidecar, read_sidecar, sidecar_path
from lite6jax.recordings.sources import SUFFIXES, TABLES, is_log, open_table, split_topics
from lite6jax.recordings.table import Table, arrays_of, tabulated
from lite6jax.recordings.writing import write_with_settings
from lite6jax.storage import exists


def read_recording(
    path: str | Path,
    *,
    dof: int | None = None,
    arm: Arm | ArmJoints | None = None,
    assume_degrees: bool = False,
    assume_millimetres: bool = False,
    joint_limits: ArrayLike | None = None,
    reach: float | None = None,
) -> Recording:
    """Reads a recording and its sidecar.

    Args:
        path: a table (`.csv`, `.tsv`, `.txt`, `.dat`, `.log`, `.parquet`), a `.mcap` or `.bag` file, or the folder of a
            rosbag2 or of a LeRobot data set; the sidecar is the `.yaml` of the same stem, if there is one. Of a log
            with several topics of a type, `run.mcap#/joint_states,/pose` names those to be read.
        dof: the number of joints expected, where the arm is known.
        arm: whose recording it is, or what is known of its joints: the joint states of a log do not say which are in m
            and N, and often not their order. By default the arm that the sidecar declares. A table's columns say both.
        assume_degrees: take joint columns that say `rad` (positions, velocities and accelerations) as degrees.
        assume_millimetres: take position columns that say `m` as millimetres.
        joint_limits: `(joint, 2)` in rad, to recognise degrees; unchecked without.
        reach: in m, to recognise millimetres; unchecked without.

    Returns:
        the recording; what was dropped, assumed or ignored on the way is in its `notes`.

    Raises:
        InputError: the file or its sidecar cannot be used; one line names file, place and remedy.
    """
    path, topics = split_topics(path)
    notes: list[str] = []
    sidecar = read_sidecar(sidecar_path(path))
    of_arm = ArmJoints.of(arm)
    if is_log(path) and not of_arm.names:  # a diagnosis does not keep the names of the joints
        declared = _declared_joints(path, sidecar)
        of_arm = declared if arm is None else of_arm.named_as(declared)
    path, table = _read(path, topics, sidecar, of_arm if dof is None else of_arm._replace(dof=dof), notes)
    columns, values = table.columns, table.values
    if not exists(sidecar_path(path)):
        notes.append(f"there is no sidecar {sidecar_path(path).name}: the defaults are assumed")

    degrees = [
        name
        for name, column in columns.items()
        if assume_degrees and is_per_joint(column.quantity) and column.unit.startswith("rad")
    ]
    millimetres = [name for name, column in columns.items() if assume_millimetres and column.unit == "m"]
    for names, divisor, unit in ((degrees, 180 / pi, "degrees"), (millimetres, 1e3, "millimetres")):
        for name in names:
            values[name] = values[name] / divisor
        if names:
            notes.append(
                f"columns {columns[names[0]].name} ... {columns[names[-1]].name} are taken as {unit}, as asked"
            )
    recording = _assembled(table, path, sidecar.settings, notes)
    spelling = table.spelling
    recording = drop_missing(recording, spelling)
    if joint_limits is not None:
        check_joint_scale(recording, joint_limits, spelling, assumed=assume_degrees)
    if reach is not None:
        check_position_scale(recording, reach, spelling, assumed=assume_millimetres)
    return recording


class Targets(NamedTuple):
    """Poses that an arm is to reach.

    Attributes:
        recording: the targets as its poses, a sample a row; joints are zero where `start` is None. Rows with NaN stay.
        start: `(sample, joint)` rad, the joints given beside them, or None.
    """

    recording: Recording
    start: np.ndarray | None


def read_targets(
    path: str | Path,
    dof: int,
    joint_limits: ArrayLike | None = None,
    reach: float | None = None,
    columns: Mapping[str, str] | None = None,
) -> Targets:
    """Reads poses to be reached, in the columns of a recording: positions, orientations or not, joints or not.

    Args:
        path: a table, as in `read_recording`; the sidecar as in `read_recording`.
        dof: the arm's number of joints.
        joint_limits: `(joint, 2)` in rad, to recognise degrees; unchecked without.
        reach: in m, to recognise millimetres; unchecked without.
        columns: names of the table with those that they have in a recording, in place of what the sidecar says.

    Raises:
        InputError: as `read_recording`; or there are no positions, or none in any row.
    """
    path, notes = Path(path), []
    sidecar = read_sidecar(sidecar_path(path))
    named = sidecar._replace(columns=columns or sidecar.columns)
    path, table = _read(path, (), named, ArmJoints(dof), notes, TABLES, joints_optional=True)
    found, joints, values = table.columns, table.joints, table.values
    if "x_m" not in found:
        raise InputError(f"{path}: has no positions to reach; name their columns x_m y_m z_m (or x_mm y_mm z_mm)")
    given = "q1_rad" in found
    if not given:
        values |= {f"q{joint}_rad": np.zeros(len(values["x_m"])) for joint in range(1, joints + 1)}
    recording = _assembled(table, path, sidecar.settings, notes)
    assert recording.position is not None
    if not np.isfinite(recording.position).all(1).any():
        raise InputError(f"{path}: columns x_m y_m z_m: no row holds a whole position; fill them")
    if given and joint_limits is not None:
        check_joint_scale(recording, joint_limits, table.spelling, assumed=True)
    if reach is not None:
        check_position_scale(recording, reach, table.spelling, assumed=True)
    return Targets(recording, recording.joint_position if given else None)


def write_recording(recording: Recording, path: str | Path, overwrite: bool = False) -> Path:
    """Writes a recording as CSV or Parquet, by the suffix, and its sidecar beside it.

    Every number reads back bit for bit. Paths in the sidecar are rewritten where it moves to another folder. Not
    written: row numbers and notes, which belong to the file of origin, and what `Recording.columns` leaves out.

    Raises:
        InputError: another suffix, a file that exists while `overwrite` is false, or a disk that refuses.
    """
    require_type("recording", recording, Recording, "a Recording")
    path = Path(path)
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise InputError(f"{path}: a recording ends in .csv or .parquet; choose such a name")
    settings = recording.settings
    if exists(recording.source):
        settings = settings.moved(Path(recording.source).parent, path.parent)
    columns = recording.columns()
    if recording.readings is not None and recording.readings.kind == "camera":
        columns = recording.readings.corner_rows(columns)
    return write_with_settings(pa.table(columns), settings, path, overwrite)


def _assembled(table: Table, path: Path, settings: RecordingSettings, notes: list[str]) -> Recording:
    arrays = without_implausible(arrays_of(table, str(path), notes), str(path), table.spelling, notes)
    return Recording.assembled(**arrays, settings=settings, source=str(path), notes=tuple(notes))


def _declared_joints(path: Path, sidecar: Sidecar) -> ArmJoints:
    """Those of the arm that a sidecar declares; nothing is known of them where it declares none."""
    settings = sidecar.settings
    arm = None if settings.arm is None else read_arm(settings.arm_reference(path.parent))
    return ArmJoints.of(arm)._replace(dof=None)


def _read(
    path: Path,
    topics: Sequence[str],
    sidecar: Sidecar,
    of_arm: ArmJoints,
    notes: list[str],
    kinds: Sequence[str] = SUFFIXES,
    joints_optional: bool = False,
) -> tuple[Path, Table]:
    path, table = open_table(path, topics, of_arm, notes, kinds)
    dof = of_arm.dof
    renamed = table.renamed(str(path), sidecar.columns)
    read = tabulated(
        table.names, str(path), table.load, notes, dof=dof, renamed=renamed, joints_optional=joints_optional
    )
    return path, read
