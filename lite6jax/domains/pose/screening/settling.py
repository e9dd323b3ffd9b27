"""Joints that were read before the arm had settled: the poses are further along each move than the joints say."""

from dataclasses import replace
from typing import Any, Literal, NamedTuple, final

import numpy as np
from scipy.special import chdtri, ndtr

from lite6jax.array_types import Array
from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.domains.pose.screening.projection import Projected, next_step, physics_columns
from lite6jax.domains.pose.screening.screened import ScreenedPoses
from lite6jax.domains.pose.screening.thresholds import JUMP_LEVEL, MOST_FITTED, MOST_SAMPLES, REFINEMENTS
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault
from lite6jax.recordings.sequence import run_segments, spread_rows

_LEVEL = 1e-4
"""Chance of the best shape, and of a joint's number; three shapes are tested."""
_SHARE = 0.01
"""Share of the freedom that read-outs must explain; poses in an order mimic less."""
_SEPARATE_SHARE = 0.03
"""Share that joints must explain beyond a common number, set on simulated equal servos."""
_NEXT_MOVE_SHARE = 0.1
"""Share that the next move explains beyond the last, from which poses are ordered."""
_NUMBERS_PER_PIECE = 10
"""Measured numbers for each piece of a curve; each is then known to a third."""
_FEWEST_PIECES = 4
"""Fewest pieces of a curve beside the moves; fewer are in the harmonics."""
_MOST_PIECES = 16
"""Most pieces of a curve; finer ones only take time."""

Shape = Literal["move", "velocity", "constant"]


@final
class Unsettled(NamedTuple):
    """Joints that were read before the arm had settled.

    Attributes:
        shape: "move", a share of each move was left; "velocity", a time at the recorded velocity; "constant", the same
            angle after each move.
        joints: concerned, from 0.
        remainder: `(joint,)` share, s or rad.
        std: of it.
    """

    shape: Shape
    joints: tuple[int, ...]
    remainder: Array
    std: Array


def settle_joints(state: ScreenedPoses) -> ScreenedPoses:
    """The joints of a static recording with the rest of their moves added, where they were read too early."""
    samples = state.recording.samples
    if state.recording.motion != "static":
        return state.rule_out("unsettled_readouts", reason="moving", samples=samples)
    if not state.corrections.settling:
        return state
    unsettled, ruled_out = seek_unsettled(state.rigid_arm)
    if unsettled is None:
        return state.rule_out("unsettled_readouts", samples=samples, **ruled_out)
    joints = [j + 1 for j in unsettled.joints]
    arm, unsettled = settled(state.rigid_arm, unsettled)
    largest = int(np.argmax(np.abs(unsettled.remainder)))
    correction = _rests(state.recording)[unsettled.shape] * unsettled.remainder
    numbers = {
        "shape": unsettled.shape,
        "joints": joints,
        "all_joints": len(joints) == len(unsettled.remainder),
        "rest": float(unsettled.remainder[largest]),
        "rest_std": float(unsettled.std[largest]),
        "largest_rms_rad": float(np.sqrt(np.mean(correction**2, 0)).max()),
    }

    def settle(recording: Recording) -> Recording:
        return replace(
            recording,
            joint_position=recording.joint_position + _rests(recording)[unsettled.shape] * unsettled.remainder,
        )

    return state.corrected(DataFault("unsettled_readouts", (), numbers), rigid=arm).transformed(settle)


def count_numbers(fault: DataFault) -> int:
    """How many numbers the correction of unsettled read-outs has: one for all joints, or one for each."""
    if fault.numbers["all_joints"]:
        return 1
    return len(fault.numbers["joints"])


def seek_unsettled(arm: RigidArm) -> tuple[Unsettled | None, dict[str, Any]]:
    """Tells whether the joints of a static recording were read before the arm had come to rest; else what rules it out.

    Then the pose shows the arm at q + rest, rest in the direction of the move: a share of it, or a time at the recorded
    velocity, or an angle. No effect depends on where the arm was before but backlash, whose sign is the opposite; all
    are estimated beside each other. Where the moves that follow explain the poses too, nothing is said: the order of
    the poses is tied to where they are, and it is something else that depends on that.
    """
    recording = arm.recording
    dof = arm.recording.dof
    too_few = {"reason": "too_few_rows"}
    if arm.samples < 3:
        return None, too_few
    sampled_rows = spread_rows(arm.samples, MOST_SAMPLES)
    shapes: dict[Shape, Array] = {name: shape[sampled_rows] for name, shape in _rests(recording).items()}
    arm = arm.select(sampled_rows)
    # from where each joint is in the row after; zero in the last row of a run
    future = np.where(np.diff(run_segments(recording.run), prepend=-1)[:, None] != 0, 0.0, -moves(recording))
    future = np.roll(future, -1, axis=0)[sampled_rows]
    columns: dict[Shape, Array] = {name: arm.joints * shape.T[:, None] for name, shape in shapes.items()}
    nuisance = np.concatenate([physics_columns(arm, skip=("direction",)), _curves(arm)])
    tests = len(shapes) * (1 + dof)
    smallest_p = 1.0
    ordered = False
    candidates: list[tuple[float, Unsettled]] = []
    for name, tested in columns.items():
        rival_columns = [columns[rival] for rival in columns if rival != name]
        projected = Projected(arm, np.concatenate([nuisance, *rival_columns]))
        if projected.freedom < arm.samples:
            return None, too_few
        per_joint, covariance, separate = projected.regression(tested)
        shared, variance, common = projected.regression(tested.sum(0, keepdims=True))
        std = np.sqrt(np.diagonal(covariance))
        p_one = float(ndtr(-shared[0] / np.sqrt(variance[0, 0]))) * tests
        p_each = ndtr(-per_joint / std) * tests
        smallest_p = min(smallest_p, p_one, float(p_each.min()))
        if min(p_one, float(p_each.min())) > _LEVEL:
            continue
        chance = chdtri(max(dof - 1, 1), _LEVEL)
        if p_one > _LEVEL or separate - common > max(chance, _SEPARATE_SHARE * separate):
            concerned = p_each < _LEVEL
            remainder = np.where(concerned, per_joint, 0.0)
            explained = float(np.sum((remainder / std) ** 2))
        else:
            remainder = np.full(dof, shared[0])
            std = np.full(dof, np.sqrt(variance[0, 0]))
            concerned = np.ones(dof, bool)
            explained = common
        if explained < _SHARE * projected.freedom:
            continue
        if name != "velocity":
            after = future if name == "move" else np.sign(future)
            with_next = projected.regression(np.concatenate([tested, arm.joints * after.T[:, None]]))[2]
            chance = chdtri(len(tested), JUMP_LEVEL)
            if with_next - separate > max(chance, _NEXT_MOVE_SHARE * separate):
                ordered = True
                continue
        joints = tuple(int(j) for j in np.flatnonzero(concerned))
        if joints:
            candidates.append((separate, Unsettled(name, joints, remainder, std)))
    if candidates:
        return max(candidates, key=lambda item: item[0])[1], {}
    return None, {"reason": "ordered_poses" if ordered else "chance", "p_value": min(smallest_p, 1.0)}


def settled(arm: RigidArm, unsettled: Unsettled) -> tuple[RigidArm, Unsettled]:
    """The arm with the rest added to its joints, fitted; and the refined rest, each step linearised anew."""
    remainder = np.zeros(len(unsettled.remainder))
    concerned = np.isin(np.arange(len(unsettled.remainder)), unsettled.joints)
    common = np.ptp(unsettled.remainder) == 0
    sampled_rows = spread_rows(arm.samples, MOST_SAMPLES)
    step = unsettled.remainder
    start = arm.recording
    shape = _rests(arm.recording)[unsettled.shape]
    for _ in range(REFINEMENTS):
        remainder = remainder + step
        moved = replace(start, joint_position=start.joint_position + shape * remainder)
        arm = arm.with_poses(moved).fitted(MOST_FITTED)
        part = arm.select(sampled_rows)
        columns = part.joints * shape[sampled_rows].T[:, None]
        physics = physics_columns(part, skip=("direction",) if unsettled.shape == "constant" else ())
        nuisance = np.concatenate([physics, _curves(part)])
        group = columns.sum(0, keepdims=True) if common else columns[concerned]
        if (more := next_step(part, nuisance, group)) is None:
            break
        step = np.zeros_like(remainder)
        step[concerned] = more
    return arm, unsettled._replace(remainder=remainder)


def _rests(recording: Recording) -> dict[Shape, Array]:
    """What the rest of a move may be proportional to, `(sample, joint)` each."""
    shapes: dict[Shape, Array] = {"move": moves(recording), "constant": recording.direction_of_motion}
    if recording.joint_velocity is not None and np.any(recording.joint_velocity):
        shapes["velocity"] = recording.joint_velocity
    return shapes


def moves(recording: Recording) -> Array:
    """`(sample, joint)` rad from where each joint was in the row before; from zero in the first row of a run."""
    moved = np.diff(recording.joint_position, axis=0, prepend=0.0)
    first = np.diff(run_segments(recording.run), prepend=-1) != 0
    return np.where(first[:, None], recording.joint_position, moved)


def _curves(arm: RigidArm) -> Array:
    """`(number, row, sample)` of any curve over each joint's position, piecewise linear: in a sweep to and fro, the
    moves depend on where they lead."""
    dof = arm.recording.dof
    pieces = min(arm.rows * arm.samples // (_NUMBERS_PER_PIECE * dof), _MOST_PIECES)
    out = [np.zeros((0, arm.rows, arm.samples))]
    for column, q in zip(arm.joints, arm.recording.joint_position.T, strict=True):
        knots = np.unique(np.quantile(q, np.linspace(0, 1, max(pieces, 2)), method="nearest"))
        if pieces >= _FEWEST_PIECES and len(knots) > 1:
            out.append(column * np.stack([np.interp(q, knots, hat) for hat in np.eye(len(knots))])[:, None])
    return np.concatenate(out)
