"""What `init` joins to one table before it looks at it: two files with clocks of their own, and points on one body."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, final

from lite6jax.errors import InputError, command_line
from lite6jax.storage import check_writable, write_atomically

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.domains.pose.joining import File
    from lite6jax.recordings.raw import RawTable


@final
@dataclass(frozen=True)
class JoinedTable:
    """A table that is not on the disk yet.

    Attributes:
        path: where it will be.
        table: its columns.
        notes: how it was made.
        given: the columns whose meaning is given and that it still has.
    """

    path: Path
    table: "RawTable"
    notes: tuple[str, ...]
    given: Mapping[str, str]

    def write(self, overwrite: bool) -> Path:
        """Writes it."""
        import pyarrow as pa

        from lite6jax.recordings.writing import write_table

        columns = {name: values for name, values in self.table.numbers() if values is not None}
        return write_atomically(self.path, lambda target: write_table(pa.table(columns), target), overwrite)


def join(sources: tuple[str, ...], arm: "Arm | None", given: Mapping[str, str], overwrite: bool) -> JoinedTable | None:
    """One table of two files, or of one with three or more points on one body; None where one file is as it is to be.

    Raises:
        InputError: no file or more than two, what neither holds, no arm for two, or the table exists already.
    """
    from lite6jax.domains.pose.joining import join_files, with_joints, with_pose_of_reflectors
    from lite6jax.recordings import raw
    from lite6jax.report import joining

    if not 1 <= len(sources) <= 2:
        raise InputError(f"{len(sources)} recordings: name one, or two, of which one has the joints and one the poses")
    if len(sources) == 1:
        path, columns = _columns(sources[0], arm, only_with_reflectors=True)
        found = with_pose_of_reflectors(columns) if columns else None
        if found is None:
            return None
        place = _place(path, "poses", overwrite)
        notes, table = joining.said_of_reflectors(found), found.columns
    else:
        if arm is None:
            example = command_line("init", *sources, "--arm", "NAME")
            raise InputError(f"two files are joined by the motion of the arm: name it, `{example}`")
        files, notes = [], []
        for source in sources:
            path, columns = _columns(source, arm)
            if (found := with_pose_of_reflectors(columns)) is not None:
                columns = found.columns
                notes += [f"{path.name}: {said}" for said in joining.said_of_reflectors(found)]
            files.append(_file(path, columns, arm, given))
        if named := sorted(given.keys() - files[0].columns.keys() - files[1].columns.keys()):
            raise InputError(f"--column {named[0][:60]}: neither {sources[0]} nor {sources[1]} has it; check the name")
        joints, poses = _roles(*files)
        if joints.found.of("q") is None:
            moved = with_joints(joints, arm)
            joints = moved.file
            notes += joining.said_of_path(moved, arm.name)
        place = _place(Path(files[0].source), files[1].stem, overwrite)
        whole = join_files(joints, poses, arm)
        notes += joining.said_of_files(whole, Path(joints.source).name, Path(poses.source).name)
        table = whole.columns
    return JoinedTable(place, raw.of_arrays(table), tuple(notes), {k: v for k, v in given.items() if k in table})


def _columns(source: str, arm: "Arm | None", only_with_reflectors: bool = False) -> "tuple[Path, Mapping]":
    """The numbers of a table by name; none where only points are of interest and its names tell of none."""
    from lite6jax.domains.pose.reflectors import reflector_columns
    from lite6jax.recordings.ros import ArmJoints
    from lite6jax.recordings.sources import TABLES, open_table, split_topics

    path, topics = split_topics(source)
    if only_with_reflectors and path.suffix.lower() not in TABLES:
        return path, {}
    path, table = open_table(path, topics, ArmJoints.of(arm), [])
    if only_with_reflectors and not reflector_columns(table.names):
        return path, {}
    return path, {name: values for name, values in table.numbers() if values is not None}


def _file(path: Path, columns: Mapping, arm: "Arm", given: Mapping[str, str]) -> "File":
    from lite6jax.domains.pose.inspection import inspect
    from lite6jax.domains.pose.joining import File

    own = {name: meaning for name, meaning in given.items() if name in columns}
    return File(str(path), path.stem, columns, inspect(list(columns.items()), arm, own, str(path)))


def _roles(one: "File", other: "File") -> "tuple[File, File]":
    """The file with the joints and the one with the poses, whatever their order.

    Where neither has joints, the robot's is the one whose poses are the controller's by their names, or the first.
    """
    with_joints = [file for file in (one, other) if file.found.of("q") is not None]
    if len(with_joints) == 2:
        raise InputError(
            f"{one.source} and {other.source}: both have joint positions; say which are none by --column NAME=ignore"
        )
    roles = [any(source.role == "controller" for source in file.found.sources) for file in (one, other)]
    joints = with_joints[0] if with_joints else other if roles == [False, True] else one
    poses = other if joints is one else one
    if poses.found.of("position") is None:
        raise InputError(
            f"{poses.source}: no columns look like positions of the tool; say which they are, --column NAME=x_mm "
            "--column NAME=y_mm --column NAME=z_mm"
        )
    return joints, poses


def _place(path: Path, other: str, overwrite: bool) -> Path:
    """The name of the table beside the first file, where nothing is yet."""
    from lite6jax.recordings.sources import TABLES

    suffix = path.suffix.lower() if path.suffix.lower() in TABLES else ".csv"
    return check_writable(path.with_name(f"{path.stem}_{other}{suffix}"), overwrite)
