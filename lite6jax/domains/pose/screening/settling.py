"""Joints that were read before the arm had settled: the poses are further along each move than the joints say."""

from dataclasses import replace
from functools import partial
from typing import Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, chdtri, ndtr

from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.projection import Projected, physics_columns, thinned
from lite6jax.domains.pose.screening.screened import Detection, Screened, not_there
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.recordings.sequence import run_segments

Array = NDArray[np.floating]

Shape = Literal["move", "velocity", "constant", "rows"]


@final
class Unsettled(NamedTuple):
    """What a search for unsettled read-outs found.

    Attributes:
        shape: "move", a share of each move was left; "velocity", a time at the recorded velocity; "constant", the same
            angle after each move; "rows", a share of the move in some rows; or None.
        joints: concerned, from 0.
        rest: `(joint,)` share, s or rad.
        std: of it.
        correction: `(sample, joint)` rad to be added.
        samples: concerned.
        p: family-wise, of the best candidate if nothing was found; NaN where there are too few rows to tell.
        ordered: whether one was rejected because the moves that follow explain the poses as well.
    """

    shape: Shape | None
    joints: tuple[int, ...]
    rest: Array
    std: Array
    correction: Array
    samples: NDArray[np.integer]
    p: float
    ordered: bool = False


def detect_unsettled(state: Screened, options: ScreeningOptions) -> Detection:
    """Joints of a static recording that were read before the arm had settled."""
    samples = state.recording.samples
    if state.recording.motion != "static":
        return not_there("unsettled_readouts", reason="moving", samples=samples)
    if not state.corrections.settling:
        return Detection()
    searched = seek_unsettled(state.rigid_arm, options)
    if searched.shape is not None:
        return Detection(searched)
    if np.isnan(searched.p):
        return not_there("unsettled_readouts", reason="too_few_rows", samples=samples)
    reason = "ordered_poses" if searched.ordered else "chance"
    return not_there("unsettled_readouts", reason=reason, samples=samples, p_value=searched.p)


def estimated(fault: DataFault) -> int:
    """How many numbers the correction of unsettled read-outs has: one for all joints, or one for each."""
    if fault.numbers["shape"] == "rows":
        return 0
    return 1 if fault.numbers["all_joints"] else len(fault.numbers["joints"])


def settle_joints(state: Screened, found: Unsettled, options: ScreeningOptions) -> Screened:
    """The joints with the rest of their moves added; single rows are left, as they count for little."""
    arm, rows = state.rigid_arm, ()
    numbers: dict[str, Any] = {
        "shape": found.shape,
        "joints": [joint + 1 for joint in found.joints],
        "all_joints": len(found.joints) == arm.recording.dof,
    }
    if found.shape == "rows":
        rows = row_numbers(arm.recording.row[found.samples])
        return state.corrected(DataFault("unsettled_readouts", rows, numbers | {"rest": float(found.rest[0])}))
    arm, found = settled(arm, found, options)
    largest = int(np.argmax(np.abs(found.rest)))
    numbers |= {
        "rest": float(found.rest[largest]),
        "rest_std": float(found.std[largest]),
        "largest_rms_rad": float(np.sqrt(np.mean(found.correction**2, 0)).max()),
    }
    state = state.corrected(DataFault("unsettled_readouts", rows, numbers), rigid=arm)
    return state.transformed(partial(_settled_rows, found.shape or "move", found.rest))


def _settled_rows(shape: Shape, rest: Array, recording: Recording) -> Recording:
    """The correction in other rows of the same recording."""
    return replace(recording, joint_position=recording.joint_position + _rests(recording)[shape] * rest)


def seek_unsettled(arm: RigidArm, options: ScreeningOptions) -> Unsettled:
    """Whether the joints of a static recording were read before the arm had come to rest.

    Then the pose shows the arm at q + rest, rest in the direction of the move: a share of it, or a time at the recorded
    velocity, or an angle. No effect depends on where the arm was before but backlash, whose sign is the opposite; all
    are estimated beside each other.

    Args:
        arm: fitted.
        options: the thresholds.
    """
    recording = arm.recording
    dof, n = recording.dof, arm.samples
    none = Unsettled(None, (), np.zeros(dof), np.zeros(dof), np.zeros((n, dof)), np.zeros(0, int), 1.0)
    if recording.motion != "static" or n < 3:
        return none
    single = _unsettled_rows(arm, options)
    if single is not None:
        return single
    every = _rests(recording)
    few = thinned(n, options)
    shapes, future, arm = (
        {name: shape[few] for name, shape in every.items()},
        _next_moves(recording)[few],
        arm.select(few),
    )
    columns = {name: arm.joints * shape.T[:, None] for name, shape in shapes.items()}
    known = np.concatenate([physics_columns(arm, skip=("direction",)), _curves(arm, options)])
    tests, least, ordered = len(shapes) * (1 + dof), 1.0, False
    found: list[tuple[float, Unsettled]] = []
    for name in every:
        others = [columns[other] for other in shapes if other != name]
        projected = Projected(arm, np.concatenate([known, *others]), options)
        if projected.freedom < arm.samples:
            return none._replace(p=np.nan)
        each, covariance, separate = projected.regression(columns[name])
        one, spread, common = projected.regression(columns[name].sum(0, keepdims=True))
        p_one = float(ndtr(-one[0] / np.sqrt(spread[0, 0]))) * tests
        p_each = ndtr(-each / np.sqrt(np.diagonal(covariance))) * tests
        p = min(p_one, float(p_each.min()))
        least = min(least, p)
        if p > options.settling_level:
            continue
        rest, std = np.full(dof, one[0]), np.full(dof, np.sqrt(spread[0, 0]))
        concerned, explained = np.ones(dof, bool), common
        apart = separate - common > max(
            chdtri(max(dof - 1, 1), options.separate_level), options.separate_share * separate
        )
        if p_one > options.settling_level or apart:
            concerned = p_each < options.settling_level
            rest, std = np.where(concerned, each, 0.0), np.sqrt(np.diagonal(covariance))
            explained = float(np.sum((rest / std) ** 2))
        if explained < options.settling_share * projected.freedom:
            continue
        after = future if name == "move" else np.sign(future)
        if name != "velocity" and _explained_by_next(projected, columns[name], after, options):
            ordered = True
            continue
        joints = tuple(int(j) for j in np.flatnonzero(concerned))
        if joints:
            unsettled = Unsettled(name, joints, rest, std, every[name] * rest, np.arange(n), min(p, 1.0))
            found.append((separate, unsettled))
    return max(found, key=lambda item: item[0])[1] if found else none._replace(p=min(least, 1.0), ordered=ordered)


def settled(arm: RigidArm, found: Unsettled, options: ScreeningOptions) -> tuple[RigidArm, Unsettled]:
    """The arm with the rest added to its joints, fitted; and the refined rest, each step linearised anew."""
    rest, concerned = np.zeros(len(found.rest)), np.isin(np.arange(len(found.rest)), found.joints)
    common = np.ptp(found.rest) == 0
    few, step = thinned(arm.samples, options), found.rest
    shape = _rests(arm.recording)[found.shape or "move"]
    start = arm.recording
    for _ in range(options.refinements):
        rest = rest + step
        arm = replace(arm, recording=replace(start, joint_position=start.joint_position + shape * rest)).fitted(
            options.most_fitted
        )
        part = arm.select(few)
        columns = part.joints * shape[few].T[:, None]
        known = [
            physics_columns(part, skip=("direction",) if found.shape == "constant" else ()),
            _curves(part, options),
        ]
        group = columns.sum(0, keepdims=True) if common else columns[concerned]
        values, covariance, _ = Projected(part, np.concatenate(known), options).regression(group)
        std = np.sqrt(np.diagonal(covariance))
        if np.all(np.abs(values) < options.converged * std):
            break
        step = np.zeros_like(rest)
        step[concerned] = np.where(np.isfinite(std), values, 0.0)
    return arm, found._replace(rest=rest, correction=shape * rest)


def _rests(recording: Recording) -> dict[Shape, Array]:
    """What the rest of a move may be proportional to, `(sample, joint)` each."""
    shapes: dict[Shape, Array] = {"move": moves(recording), "constant": recording.direction_of_motion}
    if recording.joint_velocity is not None and np.any(recording.joint_velocity):
        shapes["velocity"] = recording.joint_velocity
    return shapes


def moves(recording: Recording) -> Array:
    """`(sample, joint)` rad from where each joint was in the row before; from zero in the first row of a run."""
    q = recording.joint_position
    first = np.concatenate([[True], np.diff(run_segments(recording.run)) != 0])
    before = np.concatenate([np.zeros((1, q.shape[1])), q[:-1]])
    return q - np.where(first[:, None], 0.0, before)


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


def _explained_by_next(projected: Projected, columns: Array, future: Array, options: ScreeningOptions) -> bool:
    """Whether the moves that follow explain the poses too, beside those that led there: then the order of the poses is
    tied to where they are, and it is something else that depends on that."""
    past = projected.regression(columns)[2]
    both = projected.regression(np.concatenate([columns, projected.arm.joints * future.T[:, None]]))[2]
    chance = chdtri(len(columns), options.next_move_level)
    return bool(both - past > max(chance, options.next_move_share * past))


def _next_moves(recording: Recording) -> Array:
    """`(sample, joint)` rad from where each joint is in the row after; zero in the last row of a run."""
    back = -moves(recording)
    back[np.concatenate([[True], np.diff(run_segments(recording.run)) != 0])] = 0.0
    return np.roll(back, -1, axis=0)


def _unsettled_rows(arm: RigidArm, options: ScreeningOptions) -> Unsettled | None:
    """Rows far off whose residual lies along the move that led there."""
    recording, scale = arm.recording, arm.scale
    outlying = arm.squares > options.outlier_squares * arm.rows * scale**2
    if not options.outlier_rows <= outlying.sum() <= arm.samples // 3:
        return None
    rows = np.flatnonzero(outlying)
    far = arm.select(rows)
    along = np.einsum("jrs,sj->rs", far.joints, moves(recording)[rows])
    length = np.sum(along**2, 0)
    product = np.sum(along * far.residuals, 0)
    share = -product / np.maximum(length, 1e-300)
    cosine2 = product**2 / np.maximum(length * far.squares, 1e-300)
    hit = (cosine2 > options.along_move) & (share > 0)
    by_chance = (1 - np.sqrt(options.along_move)) / 2
    p = float(bdtrc(hit.sum() - 1, len(rows), by_chance))
    if p > options.settling_level or hit.sum() < options.outlier_rows:
        return None
    rest = np.full(recording.dof, float(np.median(share[hit])))
    none = np.zeros_like(recording.joint_position)
    return Unsettled("rows", tuple(range(recording.dof)), rest, np.zeros_like(rest), none, rows[hit], p)
