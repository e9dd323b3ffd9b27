"""Recordings in files and folders with a sidecar: read whole or refused in one line, and written exactly."""

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from math import pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from numpy.typing import ArrayLike

from lite6jax import suffixes
from lite6jax.arms.arm import Arm
from lite6jax.arms.files import read_arm
from lite6jax.errors import InputError, command_line, require_type
from lite6jax.recordings.columns.column import is_per_joint
from lite6jax.recordings.formats import Asked, find_format
from lite6jax.recordings.parquet import one_line
from lite6jax.recordings.recording import Recording, check_scale, drop_missing
from lite6jax.recordings.ros import ArmJoints
from lite6jax.recordings.settings import (
    RecordingSettings,
    growing_path,
    read_settings,
    read_sidecar,
    sidecar_path,
    write_settings,
)
from lite6jax.recordings.table import RawTable, tabulate
from lite6jax.recordings.units import require_radians
from lite6jax.storage import check_readable, check_writable, exists, write_atomically

_LOG = re.compile(r"(.+(?:\.mcap|\.db3|\.bag))#(.*)", re.IGNORECASE | re.DOTALL)
_STRANGERS = {
    **dict.fromkeys(
        suffixes.ARM_XML,
        "describes an arm and holds no measurements; name a recording, and the arm with `arm='{name}'`",
    ),
    **dict.fromkeys(
        (".xls", ".ods"),
        "is a workbook of an older form; save it as .xlsx, or its sheet as CSV (UTF-8), and name its columns by "
        "`{init}`",
    ),
    **dict.fromkeys(
        (".pt", ".pth"),
        "holds tensors of PyTorch, which is not needed here; write it as {stem}.npz, `d = torch.load('{name}'); "
        "numpy.savez('{stem}.npz', **{{k: v.numpy() for k, v in d.items() if torch.is_tensor(v)}})`",
    ),
    **dict.fromkeys(
        (".pkl", ".pickle", ".feather"),
        "is no recording; write it as {stem}.csv or .parquet with a name for each column",
    ),
}
"""What helps where a file is of a kind that people take for a recording's."""
_ACCEPTED = (
    "is no recording; a recording ends in .csv, .txt, .parquet, .xlsx, .h5, .npz, .mat or .mcap, or is the folder of a "
    "rosbag2 or of a LeRobot data set; convert it or correct the name"
)


def split_topics(path: str | Path) -> tuple[Path, tuple[str, ...]]:
    """The file or folder and the topics of `run.mcap#/joint_states,/pose`; no topics where none are named."""
    file = str(path)
    topics = ""
    if match := _LOG.fullmatch(file):
        file, topics = match.groups()
    elif "#/" in file and os.path.isdir(file.partition("#/")[0]):
        file, _, topics = file.partition("#")
    return Path(file), tuple(filter(None, (topic.strip() for topic in topics.split(","))))


def recording_file(path: str | Path) -> Path | None:
    """The file or folder that a recording's name names, without topics; None where it is no recording's name."""
    file, _ = split_topics(path)
    return file if find_format(file) else None


def no_recording(path: str | Path) -> str:
    """Why a path that `recording_file` does not take is no recording: what helps with its kind, or which files are."""
    path = Path(path)
    if path.suffix.lower() in ("", *suffixes.YAML, suffixes.JSON) and not exists(path):
        return "no such file or folder; check the name"
    return _stranger(path) or _ACCEPTED


def _stranger(path: Path) -> str:
    """What helps where a file or folder is of a kind that people take for a recording's; empty for every other."""
    path = Path(str(path).partition("#")[0])
    if not os.path.isdir(path):
        init = command_line("init", path.with_suffix(".csv"))
        return _STRANGERS.get(path.suffix.lower(), "").format(name=path.name, stem=path.stem, init=init)
    listed = (*suffixes.WRITTEN_TABLES, *suffixes.LOG_FILES)
    tables = sorted(file.name for file in path.iterdir() if file.suffix.lower() in listed)
    if tables:
        command = command_line("fleet", path)
        return f"is a folder; name a file in it, such as {tables[0]}, or fit all of them with `{command}`"
    return (
        "is a folder without a recording: no rosbag2 (metadata.yaml and .db3 or .mcap), no LeRobot data set "
        "(meta/info.json), no table; name the file of a recording"
    )


def require_table(path: str | Path, contents: str = "targets") -> Path:
    """The path of a table, where a log would say too little: it may hold several poses, and often no joints.

    `contents` are its rows, for the message.

    Raises:
        InputError: a log, a folder or another file that is no table, with what helps.
    """
    path = Path(path)
    file_format = find_format(path)
    if exists(path) and (file_format is None or not file_format.is_table):
        raise InputError(
            f"{path}: {_stranger(path) or f'{contents} end in .csv or .parquet; convert it or correct the name'}"
        )
    return path


def open_table(path: Path, topics: Sequence[str], of_arm: ArmJoints, notes: list[str]) -> tuple[Path, RawTable]:
    """The table of a recording and where it is: of a Parquet file that was not completed, the CSV of its rows.

    Args:
        path: the file or folder.
        topics: of a log, as in `ros.read_bag`.
        of_arm: the joints of the arm, as far as known, of which a log says less than a table.
        notes: what was chosen, assumed and dropped is added here.

    Raises:
        InputError: not there, of another kind (with what helps), or as the reader of its kind.
    """
    try:
        file_format = find_format(path)
        if path.suffix.lower() == suffixes.PARQUET and not exists(path) and exists(growing := growing_path(path)):
            notes.append(
                f"there is no {path.name}: the rows are those of {growing.name}, as of a recording that was ended"
            )
            path, file_format = growing, find_format(growing)
        if file_format is None:
            raise InputError(f"{path}: {no_recording(path)}")
        if path.suffix.lower() in file_format.suffixes:
            check_readable(path)
        growing_text = path.suffix.lower() in suffixes.TEXT_TABLES and _was_ended(path)
        return path, file_format.read(path, Asked(notes, topics, of_arm, growing_text))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({one_line(error.strerror or error)}); check the file") from error


def require_own_sidecar(path: Path) -> None:
    """Refuses a recording whose sidecar would have its own name, as one in YAML: `init` makes a table of it.

    Raises:
        InputError: as said.
    """
    file_format = find_format(path)
    if file_format is not None and sidecar_path(path) == path:
        made = command_line("init", path, "--arm", "NAME")
        raise InputError(f"{path}: holds {file_format.kind}; `{made}` makes a table of it, with a sidecar")


def _was_ended(path: Path) -> bool:
    """Tells whether a table of text ends within a line and is of a recording that was not completed, by its sidecar."""
    with open(path, "rb") as file:
        file.seek(-min(file.seek(0, os.SEEK_END), 1), os.SEEK_END)
        if file.read() in (b"", b"\n"):
            return False
    with suppress(InputError):  # whoever needs the sidecar says what is wrong with it
        return not read_sidecar(sidecar_path(path)).complete
    return False


# ------------------------------------------------------------------ whole recordings


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
        path: a table (`.csv`, `.tsv`, `.txt`, `.dat`, `.log`, `.parquet`, `.xlsx`), arrays (`.h5`, `.npz`, `.mat`), a
            program of a robot, a `.mcap` or `.bag` file, or the folder of a rosbag2 or of a LeRobot data set; the
            sidecar is the `.yaml` of the same stem, if there is one. Of a log
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
    require_own_sidecar(path)
    notes: list[str] = []
    sidecar = read_sidecar(sidecar_path(path))
    of_arm = ArmJoints.of(arm)
    file_format = find_format(path)
    if file_format is not None and file_format.is_log and not of_arm.names:  # a diagnosis does not keep the names
        declared_arm = None if sidecar.settings.arm is None else read_arm(sidecar.settings.arm_reference(path.parent))
        declared = ArmJoints.of(declared_arm)._replace(dof=None)
        of_arm = declared if arm is None else of_arm
        of_arm = of_arm._replace(names=declared.names) if len(declared.names) == of_arm.dof else of_arm
    of_arm = of_arm if dof is None else of_arm._replace(dof=dof)
    path, raw = open_table(path, topics, of_arm, notes)
    table = tabulate(raw, str(path), notes, dof=of_arm.dof, renamed=raw.renamed(str(path), sidecar.columns))
    columns = table.columns
    values = table.values
    if not exists(sidecar_path(path)):
        notes.append(f"there is no sidecar {sidecar_path(path).name}: the defaults are assumed")
    angles = [
        name for name, column in columns.items() if is_per_joint(column.quantity) and column.unit.startswith("rad")
    ]
    lengths = [name for name, column in columns.items() if column.unit == "m"]
    for names, divisor, unit in ((angles, 180 / pi, "degrees"), (lengths, 1e3, "millimetres")):
        if names and (assume_degrees if unit == "degrees" else assume_millimetres):
            values |= {name: values[name] / divisor for name in names}
            notes.append(
                f"columns {columns[names[0]].name} ... {columns[names[-1]].name} are taken as {unit}, as asked"
            )
    recording = Recording.from_table(table, sidecar.settings, str(path), notes)
    recording = drop_missing(recording, table.spelling)
    check_scale(recording, joint_limits, reach, table, degrees=assume_degrees, millimetres=assume_millimetres)
    return recording


def read_motion(path: str | Path, model: Any) -> Recording:
    """A motion to predict; what its own sidecar does not declare is taken from the diagnosed recording.

    Args:
        path: of the motion.
        model: of poses or of torques: its `dof`, `sliding`, `motion` and `reference_temperature`.

    Raises:
        InputError: as `read_recording`.
    """
    sidecar = sidecar_path(path)
    usual = RecordingSettings(reference_temperature_degC=model.reference_temperature)
    settings = read_settings(sidecar) if exists(sidecar) else usual
    recording = read_recording(path, arm=ArmJoints(model.dof, model.sliding))
    if settings.motion is None and recording.motion != model.motion:
        settings = replace(settings, motion=model.motion)
    return declare_anew(recording, settings)


def read_commands(path: str | Path, model: Any) -> Recording:
    """Commands whose joints are to be predicted: `time_s` and `cmd1_rad` …; measured joints need not be there.

    Args:
        path: a table, as in `read_recording`; of a log a recording with commands.
        model: of servos: its `dof` and `sliding`.

    Raises:
        InputError: as `read_recording`; or there are no commands.
    """
    file_format = find_format(Path(path))
    if file_format is None or not file_format.is_table:
        return read_recording(path, arm=ArmJoints(model.dof, model.sliding))
    file = require_table(path, "commands")
    notes: list[str] = []
    sidecar = read_sidecar(sidecar_path(file))
    file, raw = open_table(file, (), ArmJoints(model.dof), notes)
    table = tabulate(
        raw, str(file), notes, dof=model.dof, renamed=raw.renamed(str(file), sidecar.columns), joints_optional=True
    )
    commands = [f"cmd{joint}_rad" for joint in range(1, model.dof + 1)]
    missing = [name for name in commands if name not in table.columns]
    if missing:
        raise InputError(f"{file}: has no column {missing[0]}; give time_s and {commands[0]} … of every joint")
    if "q1_rad" not in table.columns:
        table.values.update({f"q{joint}_rad": table.values[f"cmd{joint}_rad"] for joint in range(1, model.dof + 1)})
    settings = replace(sidecar.settings, motion="trajectory")
    recording = drop_missing(Recording.from_table(table, settings, str(file), notes), table.spelling)
    require_radians(np.asarray(recording.commanded_position), model.joint_limits, f"{file}: {commands[0]} …")
    return recording


def assemble_motion(model: Any, joint_position: ArrayLike, **arrays: Any) -> Recording:
    """A motion to predict, of arrays as of `Recording.assembled`; settings are taken from the diagnosed recording.

    Raises:
        InputError: degrees, another number of joints than of the model, or arrays that do not fit together.
    """
    settings = RecordingSettings(motion=model.motion, reference_temperature_degC=model.reference_temperature)
    recording = Recording.assembled(joint_position, settings=settings, source="motion", sliding=model.sliding, **arrays)
    if recording.dof != model.dof:
        raise InputError(f"motion: has {recording.dof} joints, and the arm {model.dof}; give that arm's motion")
    require_radians(recording.joint_position, model.joint_limits)
    return recording


def declare_anew(recording: Recording, settings: RecordingSettings) -> Recording:
    """With other settings; notes on the file stay, except those on what was not declared."""
    undeclared = ("there is no sidecar", *recording.made_anew().notes)
    file_notes = tuple(note for note in recording.notes if not note.startswith(undeclared))
    anew = recording.made_anew(settings=settings)
    return replace(anew, notes=(*file_notes, *anew.notes))


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
    path = require_table(path)
    notes = []
    sidecar = read_sidecar(sidecar_path(path))
    path, raw = open_table(path, (), ArmJoints(dof), notes)
    renamed = raw.renamed(str(path), columns or sidecar.columns)
    table = tabulate(raw, str(path), notes, dof=dof, renamed=renamed, joints_optional=True)
    if "x_m" not in table.columns:
        raise InputError(f"{path}: has no positions to reach; name their columns x_m y_m z_m (or x_mm y_mm z_mm)")
    has_joints = "q1_rad" in table.columns
    if not has_joints:
        table.values.update({f"q{joint + 1}_rad": np.zeros(len(table.values["x_m"])) for joint in range(table.joints)})
    recording = Recording.from_table(table, sidecar.settings, str(path), notes)
    assert recording.position is not None
    if not np.isfinite(recording.position).all(1).any():
        raise InputError(f"{path}: columns x_m y_m z_m: no row holds a whole position; fill them")
    check_scale(recording, joint_limits if has_joints else None, reach, table, degrees=True, millimetres=True)
    return Targets(recording, recording.joint_position if has_joints else None)


# ------------------------------------------------------------------ writing


def write_recording(recording: Recording, path: str | Path, overwrite: bool = False) -> Path:
    """Writes a recording as CSV or Parquet, by the suffix, and its sidecar beside it.

    Every number reads back bit for bit. Paths in the sidecar are rewritten where it moves to another folder. Not
    written: row numbers and notes, which belong to the file of origin, and what `Recording.columns` leaves out.

    Raises:
        InputError: another suffix, poses from several stations, a file that exists while `overwrite` is false, or a
            disk that refuses.
    """
    require_type("recording", recording, Recording, "a Recording")
    path = Path(path)
    if path.suffix.lower() not in suffixes.WRITTEN_TABLES:
        raise InputError(f"{path}: a recording ends in .csv or .parquet; choose such a name")
    if recording.stations:
        raise InputError(f"{path}: the poses are from several stations, each in a frame of its own; write each alone")
    settings = recording.settings
    if exists(recording.source):
        settings = settings.moved(Path(recording.source).parent, path.parent)
    columns = recording.columns()
    if recording.readings is not None and recording.readings.kind == "camera":
        columns = recording.readings.corner_rows(columns)
    return write_with_settings(pa.table(columns), settings, path, overwrite)


def write_with_settings(table: pa.Table, settings: RecordingSettings, path: Path, overwrite: bool) -> Path:
    """Writes a table, and the sidecar beside it.

    Raises:
        InputError: as `storage.write_atomically` of either.
    """
    for file in (path, sidecar_path(path)):
        check_writable(file, overwrite)
    write_atomically(path, lambda target: write_table(table, target), overwrite)
    write_settings(settings, sidecar_path(path), overwrite)
    return path


def write_table(table: pa.Table, path: Path) -> None:
    """Writes a table so that every number reads back bit for bit; Parquet has a checksum in each page.

    Raises:
        OSError: the disk refuses.
    """
    if path.suffix.lower() == suffixes.PARQUET:
        pa_parquet.write_table(table, path, use_dictionary=False, compression="zstd", write_page_checksum=True)
        return
    with open(path, "wb") as file:  # Arrow would put the names in quotes
        file.write(",".join(table.column_names).encode() + b"\n")
        pa_csv.write_csv(table, file, pa_csv.WriteOptions(include_header=False, quoting_style="none"))
