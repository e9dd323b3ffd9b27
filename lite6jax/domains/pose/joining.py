"""One table of joints and poses that stand in two files.

What is joined keeps its names and units, so that it is looked at as any table is. Codes and numbers only: the words are
those of `report.inspection`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array, Integers
from lite6jax.domains.pose.clocks import Clocks, Pairing, find_clocks, pair_in_order
from lite6jax.errors import InputError
from lite6jax.recordings.alignment import flange_poses, match_poses, median_distance
from lite6jax.recordings.columns.cells import Names, match_names
from lite6jax.recordings.columns.column import FORMS, PLACE, QUATERNION, Block, spelled
from lite6jax.recordings.columns.inspection import InspectedTable
from lite6jax.recordings.columns.kinematics import CLEARLY, CLOSE, FEWEST
from lite6jax.recordings.columns.orientations import with_quaternions
from lite6jax.recordings.streams import Joined, JointStream, in_order, join
from lite6jax.recordings.table import LATEST_START_S

if TYPE_CHECKING:
    from lite6jax.domains.pose.inverse import JointPath


_OF_JOINTS = ("q", "dq", "ddq", "tau", "current", "temp", "cmd", "payload", "ambient")
_OF_POSES = ("position", "deviation", "rotation", "ambient")
"""Kinds of blocks that are taken from either file."""
_TIME = "time_s"
_MOST_CAPTURES = 2000
"""One by one, of which the order is tried."""


class JoinedFiles(NamedTuple):
    """Joints of one file at the poses of another.

    Attributes:
        columns: of the table of both.
        rows: of it; `poses` and `states` those of the files.
        clocks: where they were joined by time; `start` is the robot's first time less the sensor's, s, which is to be
            added to the offset.
        pairing: where they were joined by order.
        names: where they were joined by the names of their rows; `error` m, of the nominal arm then.
        joined: how joints were interpolated.
        unit: of the joints in `joined`.
        left_out: columns of numbers in either file that are not in the table.
    """

    columns: dict[str, Array]
    rows: int
    poses: int
    states: int
    clocks: Clocks | None = None
    start: float = 0.0
    pairing: Pairing | None = None
    names: Names | None = None
    error: float = np.inf
    joined: Joined | None = None
    unit: str = "rad"
    left_out: tuple[str, ...] = ()


class SolvedPairs(NamedTuple):
    """Pairs of a robot's pose and a target's, with the joints of a nominal arm in place of the robot's.

    Attributes:
        columns: `(row,)` of joints and of the target's pose.
        solved: how the joints were found.
        inverted: whether the target's poses were inverted, as those of a camera on the flange.
        errors: m, the median errors of the nominal arm as recorded and inverted.
    """

    columns: dict[str, Array]
    solved: "WithJoints"
    inverted: bool
    errors: tuple[float, float]


class WithJoints(NamedTuple):
    """A file whose poses of the flange were replaced by the joints of a nominal arm.

    Attributes:
        file: with joints.
        path: how they were found.
        form: of the orientation, as it was read.
    """

    file: InspectedTable
    path: "JointPath"
    form: str


def with_joints(file: InspectedTable, arm: Arm, captures: bool = False) -> WithJoints:
    """A robot's file with joints in place of the poses that its controller computed, of the flange in the arm's base.

    Between captures the arm moved far, so that each pose is solved alone.

    Raises:
        InputError: it has no positions and orientations, or no branch of the arm reaches them.
    """
    position, turned = map(file.inspection.of, ("position", "rotation"))
    if turned is None or position is None:
        raise InputError(
            f"{file.source}: has neither joint positions nor positions with orientations, from which the arm's nominal "
            "kinematics would give them; say what the columns are, --column NAME=q1_deg and so on"
        )
    from lite6jax.domains.pose import inverse  # imports JAX

    solve = inverse.capture_joints if captures else inverse.joint_path

    assert turned.form is not None
    # as it was read; in doubt as any that it may be
    further_forms = turned.forms if turned.form.sure != "certain" else ()
    path = None
    form = ""
    for form in dict.fromkeys([turned.form.choice, *further_forms]):
        path = solve(arm, position.in_si(file.columns), _quaternions(file, turned, form))
        if path is not None:
            break
    if path is None:
        raise InputError(
            f"{file.source}: has no joint positions, and the {arm.name} reaches its poses at no joints, taken as those "
            "of the flange in the arm's base; record the joints, or poses of the flange (without a tool)"
        )
    columns = {
        f"q{joint + 1}_{'m' if slides else 'rad'}": column
        for joint, (slides, column) in enumerate(zip(arm.slides, path.position.T, strict=True))
    }
    times = {name: file.columns[name] for name in file.list_columns("time")}
    table = InspectedTable.of(times | columns, file.source, arm, file.inspection.given)
    return WithJoints(table, path, turned.renamed(form=form)[turned.columns[0]])


def is_of_pairs(file: InspectedTable) -> bool:
    """Tells whether a file has a robot's pose and a sensor's in each row, and no joints: a hand-eye calibration."""
    roles = {source.role for source in file.inspection.sources}
    return file.inspection.of("q") is None and roles >= {"controller", "sensor"}


def solve_pairs(file: InspectedTable, arm: Arm) -> SolvedPairs:
    """A file of pairs of poses as one of joints and poses.

    Of a camera on the flange the pose of the target is that of the sensor's frame in the tool's: it is inverted where
    the nominal arm then agrees clearly better.

    Raises:
        InputError: as `with_joints`.
    """
    of_target = next(source.columns for source in file.inspection.sources if source.role == "sensor")
    robot = {name: column for name, column in file.columns.items() if name not in of_target}
    moved = with_joints(InspectedTable.of(robot, file.source, arm), arm, captures=True)
    reached = np.flatnonzero(moved.path.reached)
    columns = {name: column[reached] for name, column in moved.file.columns.items()}
    columns |= {name: file.columns[name][reached] for name in of_target}
    solved = InspectedTable.of(columns, file.source, arm)
    position = solved.inspection.of("position")
    rotation = solved.inspection.of("rotation")
    if position is None or rotation is None or rotation.form is None or len(reached) < FEWEST:
        return SolvedPairs(columns, moved, False, (np.inf, np.inf))
    q = _joint_positions(solved, arm)
    R = Rotation.from_quat(_quaternions(solved, rotation, rotation.form.choice), scalar_first=True)
    places = position.in_si(columns)
    flange = flange_poses(arm, q)
    inverse = -R.inv().apply(places)
    errors = (match_poses(flange, places)[0], match_poses(flange, inverse)[0])
    if errors[1] * CLEARLY > errors[0]:
        return SolvedPairs(columns, moved, False, errors)
    converted = {name: column for name, column in columns.items() if name not in of_target}
    turned = R.inv().as_quat(scalar_first=True, canonical=True)
    converted |= dict(zip(map(spelled, PLACE), inverse.T, strict=True)) | dict(zip(QUATERNION, turned.T, strict=True))
    return SolvedPairs(converted, moved, True, errors)


def join_files(joints: InspectedTable, poses: InspectedTable, arm: Arm) -> JoinedFiles:
    """The joints of one file at the poses of another: of the same name, at their times, or captures in their order.

    Raises:
        InputError: another number of joints than the arm has, no times, or clocks of which the motion shows no offset;
            the message names the files.
    """
    position = poses.in_si("position")
    q = _joint_positions(joints, arm)
    assert position is not None
    pose_rows = np.flatnonzero(np.isfinite(position).all(axis=1) & (position != 0).any(axis=1))
    state_rows = np.flatnonzero(np.isfinite(q).all(axis=1))
    times = [file.in_si("time") for file in (joints, poses)]
    used = {*_kept(joints, (*_OF_JOINTS, "time")), *_kept(poses, (*_OF_POSES, "time"))}
    left_out = tuple(name for file in (joints, poses) for name in file.columns if name not in used)
    if (by_name := _joined_by_name(joints, poses, arm, q, position)) is not None:
        return by_name._replace(left_out=left_out)
    clock, at = times
    if clock is not None and at is not None:
        joined = _joined_by_time(joints, poses, arm, q, position, clock[:, 0], at[:, 0])
        if joined is not None:
            return joined._replace(left_out=left_out)
    are_captures = len(state_rows) <= _MOST_CAPTURES
    pairing = None
    if are_captures:
        pairing = pair_in_order(arm, q[state_rows], position[pose_rows])
    if pairing is not None:
        states = state_rows[pairing.joint : pairing.joint + pairing.rows]
        placed = pose_rows[pairing.position : pairing.position + pairing.rows]
        moved = {name: column[states] for name, column in _kept(joints, _OF_JOINTS).items()}
        table = _table(joints, poses, moved, placed)
        return JoinedFiles(table, pairing.rows, len(pose_rows), len(state_rows), pairing=pairing, left_out=left_out)
    remedy = "the joint states are too far apart in time to show how the arm moved"
    if lacking := [file.source for file, time in zip((joints, poses), times, strict=True) if time is None]:
        remedy = (
            f"name the column of the times of {' and of '.join(lacking)}, such as --column NAME=time_s (or time_ms)"
        )
    raise InputError(
        f"{joints.source} and {poses.source}: their {len(state_rows)} joint states and {len(pose_rows)} poses do not "
        f"agree in their order; {remedy}"
    )


def _joined_by_name(
    joints: InspectedTable, poses: InspectedTable, arm: Arm, q: Array, position: Array
) -> JoinedFiles | None:
    """Joints and positions of rows that have the same name; None where they have none.

    Whole numbers may count the rows of each file for themselves: they are names where the arm agrees.
    """
    names = match_names(joints.row_names, poses.row_names)
    if names is None:
        return None
    complete = np.isfinite(q[names.rows[0]]).all(axis=1) & np.isfinite(position[names.rows[1]]).all(axis=1)
    states, placed = (rows[complete] for rows in names.rows)
    if len(states) < FEWEST:
        return None
    error, _ = match_poses(flange_poses(arm, q[states]), position[placed])
    of_text = all(column in file.words for file, column in zip((joints, poses), names.columns, strict=True))
    if not of_text and error > CLOSE * median_distance(position[placed]):
        return None
    moved = {name: column[states] for name, column in _kept(joints, _OF_JOINTS).items()}
    table = _table(joints, poses, moved, placed)
    return JoinedFiles(table, len(states), len(position), len(q), names=names, error=error)


def _joined_by_time(
    joints: InspectedTable, poses: InspectedTable, arm: Arm, q: Array, position: Array, clock: Array, at: Array
) -> JoinedFiles | None:
    """Joints and positions of rows at their times in s, joined by the motion; None of captures, which show none."""
    states = in_order(clock, np.isfinite(q).all(axis=1))
    if len(states) < FEWEST or not (stream := JointStream.of(clock[states] - clock[states[0]], q[states])).resolved:
        return None
    who = f"{joints.source} and {poses.source}"
    placed = in_order(at, np.isfinite(position).all(axis=1) & (position != 0).any(axis=1))
    if len(placed) < FEWEST:
        raise InputError(f"{who}: {len(placed)} poses at different times are too few to find the offset of the clocks")
    first = clock[states[0]]
    start = at[placed[0]]
    likely = None
    if min(first, start) > LATEST_START_S:
        likely = float(start - first)
    try:
        clocks = find_clocks(arm, stream, at[placed] - start, position[placed], likely)
    except InputError as error:
        raise InputError(f"{who}: {error}{_assumed(joints, poses)}") from error
    robot_times = clocks.robot_time(at[placed] - start)
    used = _kept(joints, _OF_JOINTS)
    names = [name for name in joints.list_columns("q") if name in used]
    joined = join(stream.time, {name: column[states] for name, column in used.items()}, names, robot_times)
    rows = placed[joined.usable]
    table = {_TIME: robot_times[joined.usable] + first} | _table(joints, poses, joined.columns, rows)
    unit = next(block.unit.choice for block in joints.inspection.blocks if block.kind == "q" and block.unit)
    return JoinedFiles(
        table, len(rows), len(placed), len(states), clocks, float(first - start), joined=joined, unit=unit
    )


def _table(
    joints: InspectedTable, poses: InspectedTable, moved: Mapping[str, Array], rows: Integers
) -> dict[str, Array]:
    """The columns of both, those of the poses at some rows; names that both have begin with the file's."""
    placed = {name: column[rows] for name, column in _kept(poses, _OF_POSES).items()}
    common = moved.keys() & placed.keys()
    return {
        (f"{file.stem}_{name}" if name in common | {_TIME} else name): column
        for file, part in ((joints, moved), (poses, placed))
        for name, column in part.items()
    }


def _kept(file: InspectedTable, kinds: Sequence[str]) -> dict[str, Array]:
    return {name: file.columns[name] for kind in kinds for name in file.list_columns(kind)}


def _quaternions(file: InspectedTable, rotation: Block, form: str) -> Array:
    """`(row, 4)`, scalar first, of orientations in a form."""
    values = dict(zip(map(spelled, FORMS[form]), rotation.in_si(file.columns).T, strict=True))
    turns = with_quaternions(values, file.source)
    return np.stack([turns[name] for name in QUATERNION], 1)


def _joint_positions(file: InspectedTable, arm: Arm) -> Array:
    """`(row, joint)` in SI units."""
    q = file.in_si("q")
    joints = 0 if q is None else q.shape[1]
    if q is None or joints != arm.dof:
        raise InputError(
            f"{file.source}: has {joints} joints and {arm.name} has {arm.dof}; choose the arm, or name the "
            "columns with --column NAME=q1_deg and so on"
        )
    return q


def _assumed(*files: InspectedTable) -> str:
    """In which units times and joints were taken where nothing says so for certain, and how to give others."""
    assumptions = []
    remedies = []
    for of_file, block in ((Path(file.source).name, block) for file in files for block in file.inspection.blocks):
        if block.kind not in ("q", "time") or block.unit is None or block.unit.sure == "certain":
            continue
        unit = block.unit.choice
        alternative = next(unit_name for unit_name in block.units if unit_name != unit)
        name = block.columns[0]
        of_all = " and so on" if len(block.columns) > 1 else ""
        verb = "" if assumptions else " was taken"
        assumptions.append(f"{name}{' …' if of_all else ''} of {of_file}{verb} in {unit}")
        remedies.append(f"--column {name}={block.renamed(unit=alternative)[name]}{of_all}")
    # files that have the column alike need one remedy
    if not assumptions:
        return ""
    return f"; {', '.join(assumptions)}; if that is wrong, give {' or '.join(dict.fromkeys(remedies))}"
