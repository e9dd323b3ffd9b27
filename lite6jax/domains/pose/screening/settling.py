"""Joints that were read before the arm had settled: the poses are further along each move than the joints say."""

from dataclasses import replace
from typing import Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtr

from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.projection import Projected, next_step, physics_columns
from lite6jax.domains.pose.screening.screened import Screened
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault
from lite6jax.recordings.sequence import run_segments, spread_rows

Array = NDArray[np.floating]

Shape = Literal["move", "velocity", "constant"]


@final
class Unsettled(NamedTuple):
    """Joints that were read before the arm had settled.

    Attributes:
        shape: "move", a share of each move was left; "velocity", a time at the recorded velocity; "constant", the same
            angle after each move.
        joints: concerned, from 0.
        rest: `(joint,)` share, s or rad.
        std: of it.
    """

    shape: Shape
    joints: tuple[int, ...]
    rest: Array
    std: Array


def settle_joints(state: Screened) -> Screened:
    """The joints of a static recording with the rest of their moves added, where they were read too early."""
    samples = state.recording.samples
    if state.recording.motion != "static":
        return state.rule_out("unsettled_readouts", reason="moving", samples=samples)
    if not state.corrections.settling:
        return state
    found, ruled_out = seek_unsettled(state.rigid_arm, state.options)
    if found is None:
        return state.rule_out("unsettled_readouts", samples=samples, **ruled_out)
    joints = [j + 1 for j in found.joints]
    arm, found = settled(state.rigid_arm, found, state.options)
    largest = int(np.argmax(np.abs(found.rest)))
    correction = _rests(state.recording)[found.shape] * found.rest
    numbers = {
        "shape": found.shape,
        "joints": joints,
        "all_joints": len(joints) == len(found.rest),
        "rest": float(found.rest[largest]),
        "rest_std": float(found.std[largest]),
        "largest_rms_rad": float(np.sqrt(np.mean(correction**2, 0)).max()),
    }

    def settle(recording: Recording) -> Recording:
        return replace(recording, joint_position=recording.joint_position + _rests(recording)[found.shape] * found.rest)

    return state.corrected(DataFault("unsettled_readouts", (), numbers), rigid=arm).transformed(settle)


def count_numbers(fault: DataFault) -> int:
    """How many numbers the correction of unsettled read-outs has: one for all joints, or one for each."""
    return 1 if fault.numbers["all_joints"] else len(fault.numbers["joints"])


def seek_unsettled(arm: RigidArm, options: ScreeningOptions) -> tuple[Unsettled | None, dict[str, Any]]:
    """Whether the joints of a static recording were read before the arm had come to rest; else what rules it out.

    Then the pose shows the arm at q + rest, rest in the direction of the move: a share of it, or a time at the recorded
    velocity, or an angle. No effect depends on where the arm was before but backlash, whose sign is the opposite; all
    are estimated beside each other. Where the moves that follow explain the poses too, nothing is said: the order of
    the poses is tied to where they are, and it is something else that depends on that.
    """
    recording, dof = arm.recording, arm.recording.dof
    too_few = {"reason": "too_few_rows"}
    if arm.samples < 3:
        return None, too_few
    few = spread_rows(arm.samples, options.most_samples)
    shapes: dict[Shape, Array] = {name: shape[few] for name, shape in _rests(recording).items()}
    arm = arm.select(few)
    # from where each joint is in the row after; zero in the last row of a run
    future = np.where(np.diff(run_segments(recording.run), prepend=-1)[:, None] != 0, 0.0, -moves(recording))
    future = np.roll(future, -1, axis=0)[few]
    columns: dict[Shape, Array] = {name: arm.joints * shape.T[:, None] for name, shape in shapes.items()}
    known = np.concatenate([physics_columns(arm, skip=("direction",)), _curves(arm, options)])
    tests, least, ordered = len(shapes) * (1 + dof), 1.0, False
    found: list[tuple[float, Unsettled]] = []
    for name, own in columns.items():
        others = [columns[other] for other in columns if other != name]
        projected = Projected(arm, np.concatenate([known, *others]), options)
        if projected.freedom < arm.samples:
            return None, too_few
        each, covariance, separate = projected.regression(own)
        one, variance, common = projected.regression(own.sum(0, keepdims=True))
        std = np.sqrt(np.diagonal(covariance))
        p_one = float(ndtr(-one[0] / np.sqrt(variance[0, 0]))) * tests
        p_each = ndtr(-each / std) * tests
        least = min(least, p_one, float(p_each.min()))
        if min(p_one, float(p_each.min())) > options.settling_level:
            continue
        chance = chdtri(max(dof - 1, 1), options.settling_level)
        if p_one > options.settling_level or separate - common > max(chance, options.separate_share * separate):
            concerned = p_each < options.settling_level
            rest = np.where(concerned, each, 0.0)
            explained = float(np.sum((rest / std) ** 2))
        else:
            rest, std = np.full(dof, one[0]), np.full(dof, np.sqrt(variance[0, 0]))
            concerned, explained = np.ones(dof, bool), common
        if explained < options.settling_share * projected.freedom:
            continue
        if name != "velocity":
            after = future if name == "move" else np.sign(future)
            both = projected.regression(np.concatenate([own, arm.joints * after.T[:, None]]))[2]
            chance = chdtri(len(own), options.jump_level)
            if both - separate > max(chance, options.next_move_share * separate):
                ordered = True
                continue
        joints = tuple(int(j) for j in np.flatnonzero(concerned))
        if joints:
            found.append((separate, Unsettled(name, joints, rest, std)))
    if found:
        return max(found, key=lambda item: item[0])[1], {}
    return None, {"reason": "ordered_poses" if ordered else "chance", "p_value": min(least, 1.0)}


def settled(arm: RigidArm, found: Unsettled, options: ScreeningOptions) -> tuple[RigidArm, Unsettled]:
    """The arm with the rest added to its joints, fitted; and the refined rest, each step linearised anew."""
    rest, concerned = np.zeros(len(found.rest)), np.isin(np.arange(len(found.rest)), found.joints)
    common = np.ptp(found.rest) == 0
    few, step = spread_rows(arm.samples, options.most_samples), found.rest
    start, shape = arm.recording, _rests(arm.recording)[found.shape]
    for _ in range(options.refinements):
        rest = rest + step
        moved = replace(start, joint_position=start.joint_position + shape * rest)
        arm = arm.with_poses(moved).fitted(options.most_fitted)
        part = arm.select(few)
        columns = part.joints * shape[few].T[:, None]
        physics = physics_columns(part, skip=("direction",) if found.shape == "constant" else ())
        known = np.concatenate([physics, _curves(part, options)])
        group = columns.sum(0, keepdims=True) if common else columns[concerned]
        if (more := next_step(part, known, group, options)) is None:
            break
        step = np.zeros_like(rest)
        step[concerned] = more
    return arm, found._replace(rest=rest)


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


def _curves(arm: RigidArm, options: ScreeningOptions) -> Array:
    """`(number, row, sample)` of any curve over each joint's position, piecewise linear: in a sweep to and fro, the
    moves depend on where they lead."""
    dof = arm.recording.dof
    pieces = min(arm.rows * arm.samples // (options.numbers_per_piece * dof), options.most_pieces)
    out = [np.zeros((0, arm.rows, arm.samples))]
    for column, q in zip(arm.joints, arm.recording.joint_position.T, strict=True):
        knots = np.unique(np.quantile(q, np.linspace(0, 1, max(pieces, 2)), method="nearest"))
        if pieces >= options.fewest_pieces and len(knots) > 1:
            out.append(column * np.stack([np.interp(q, knots, hat) for hat in np.eye(len(knots))])[:, None])
    return np.concatenate(out)
