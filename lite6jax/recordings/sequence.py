"""What follows from the order of a recording's samples: runs, the kind of motion, velocities and directions."""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from lite6jax.recordings.settings import Motion

LONGEST_TRAJECTORY_STEP_S = 0.5  # samples further apart than this are taken as poses at which the arm stood still
STANDSTILL_RAD_PER_S = 1e-3
LONGEST_GAP = 10.0  # median steps of time; commands are not followed over longer ones
MOVING_SHARE = 0.05  # of the rows; a static recording may hold a few taken before the arm came to rest


def spread_rows(count: int, limit: int) -> Int[np.ndarray, " row"]:
    """`limit` of so many rows, spread evenly; all where they are no more."""
    return np.arange(count) if count <= limit else np.unique(np.linspace(0, count - 1, limit).astype(int))


def run_segments(run: Int[np.ndarray, " sample"]) -> Int[np.ndarray, " sample"]:
    """Numbers the runs 0, 1, ... in order: `run` only says where a new one starts."""
    return np.concatenate([[0], np.cumsum(run[1:] != run[:-1])])


def stretches(inside: Bool[np.ndarray, " sample"], segment: Int[np.ndarray, " sample"]) -> list[slice]:
    """The samples of each unbroken piece of a run that is inside, in their order.

    Args:
        inside: the samples that count.
        segment: the run of each, as `run_segments` numbers them.
    """
    changes = (np.diff(inside.astype(int)) != 0) | (np.diff(segment) != 0)
    edges = [0, *(1 + np.flatnonzero(changes)).tolist(), len(inside)]
    return [slice(first, stop) for first, stop in pairwise(edges) if inside[first]]


def unwrap(joint_position: Float[np.ndarray, "sample joint"]) -> Float[np.ndarray, "sample joint"]:
    """Joints without jumps of whole turns, where nothing but these breaks their motion."""
    with np.errstate(invalid="ignore"):
        unwrapped = np.unwrap(joint_position, axis=0)
        smooth = np.max(np.abs(np.diff(unwrapped, axis=0)), axis=0, initial=0.0) < np.pi / 2
    return np.where(smooth, unwrapped, joint_position)


def interpolate_columns(
    at: Float[np.ndarray, " instant"],
    time: Float[np.ndarray, " sample"],
    rows: Float[np.ndarray, "sample column"],
) -> Float[np.ndarray, "instant column"]:
    """Each column of rows at other times, on lines between its samples; beyond the ends the last ones."""
    return np.stack([np.interp(at, time, column) for column in rows.T], 1)


def contiguous_blocks(samples: int, count: int) -> list[Bool[np.ndarray, " sample"]]:
    """`count` masks, each a block of neighbouring samples; together they cover every sample once."""
    block = np.arange(samples) * count // samples
    return [block == number for number in range(count)]


def inferred_motion(
    time: Float[np.ndarray, " sample"] | None, velocity: Float[np.ndarray, "sample joint"] | None
) -> tuple[Motion, str]:
    """Tells whether the arm stood still, from velocities or else from the time step, with the reason in words."""
    if velocity is not None:
        moving = np.mean(np.nanmax(np.abs(velocity), axis=1, initial=0.0) > STANDSTILL_RAD_PER_S)
        return "trajectory" if moving > MOVING_SHARE else "static", f"the joints move in {moving:.0%} of the rows"
    if time is None:
        return "static", "it has neither times nor velocities"
    steps = np.diff(time[np.isfinite(time)])
    steps = steps[steps > 0]
    step = float(np.median(steps)) if steps.size else np.inf
    return "trajectory" if step <= LONGEST_TRAJECTORY_STEP_S else "static", f"its time step is {step:.3g} s"


def differentiate(
    joint_position: Float[np.ndarray, "sample joint"],
    time: Float[np.ndarray, " sample"],
    segment: Int[np.ndarray, " sample"],
) -> Float[np.ndarray, "sample joint"]:
    """Velocities by second-order differences over uneven times, within segments and in time order.

    Exact for a parabola, at the ends too, and exactly zero where positions stand still; first order in a segment of two
    rows, zero in one of one row. Rows of equal time are passed over; rows with NaN get NaN and do not touch their
    neighbours.
    """
    velocity = np.full_like(joint_position, np.nan)
    usable = np.flatnonzero(np.isfinite(joint_position).all(axis=1) & np.isfinite(time))
    order = usable[np.lexsort((time[usable], segment[usable]))]
    if not order.size:
        return velocity
    q = joint_position[order]
    t = time[order]
    s = segment[order]
    step = np.diff(t)
    joined = (np.diff(s) == 0) & (step > 0)
    step = np.where(joined, step, 1.0)
    slope = np.where(joined[:, None], np.diff(q, axis=0) / step[:, None], 0.0)

    def padded(array: np.ndarray, before: int, after: int) -> np.ndarray:
        return np.pad(array, [(before, after)] + [(0, 0)] * (array.ndim - 1))

    # per row: the intervals before and after it, and those one further out for the ends of a segment
    has_left = padded(joined, 1, 0)[:, None]
    has_right = padded(joined, 0, 1)[:, None]
    h_left = padded(step, 1, 0)[:, None]
    h_right = padded(step, 0, 1)[:, None]
    v_left = padded(slope, 1, 0)
    v_right = padded(slope, 0, 1)
    inside = (h_right * v_left + h_left * v_right) / np.maximum(h_left + h_right, np.finfo(float).tiny)
    value = np.where(has_left & has_right, inside, v_left + v_right)
    starts = np.flatnonzero(~has_left[:-1, 0] & has_right[:-1, 0] & has_right[1:, 0])
    ends = 1 + np.flatnonzero(has_left[:-1, 0] & has_left[1:, 0] & ~has_right[1:, 0])
    for rows, near, far in ((starts, starts, starts + 1), (ends, ends - 1, ends - 2)):
        weight = (step[near] / (step[near] + step[far]))[:, None]
        value[rows] = slope[near] + (slope[near] - slope[far]) * weight
    velocity[order] = value
    return velocity


def integrate_commands(
    commanded_velocity: Float[np.ndarray, "sample joint"],
    joint_position: Float[np.ndarray, "sample joint"],
    time: Float[np.ndarray, " sample"],
    segment: Int[np.ndarray, " sample"],
) -> Float[np.ndarray, "sample joint"]:
    """Positions that velocities command, each held until the next, from the joint positions at the start of a segment.

    A gap, and a time that goes back, begin a segment as well. Rows with NaN get NaN and are passed over.
    """
    position = np.full_like(joint_position, np.nan)
    finite = np.isfinite(commanded_velocity).all(1) & np.isfinite(joint_position).all(1) & np.isfinite(time)
    usable = np.flatnonzero(finite)
    if not usable.size:
        return position
    step = np.diff(time[usable])
    forward = step[step > 0]
    longest = LONGEST_GAP * float(np.median(forward)) if forward.size else np.inf
    begins = np.r_[True, (np.diff(segment[usable]) != 0) | (step < 0) | (step > longest)]
    moved = np.where(begins[1:, None], 0.0, commanded_velocity[usable[:-1]] * step[:, None])
    travel = np.cumsum(np.concatenate([np.zeros((1, joint_position.shape[1])), moved]), 0)
    first = np.flatnonzero(begins)[np.cumsum(begins) - 1]
    position[usable] = joint_position[usable[first]] + travel - travel[first]
    return position


def held_rows(
    time: Float[np.ndarray, " sample"], instants: Float[np.ndarray, " instant"], period: float
) -> Int[np.ndarray, " instant"]:
    """The row that holds at each instant, the last one that is not later by over a thousandth of a period.

    Before the first row it is the first.
    """
    return np.clip(np.searchsorted(time, instants + 1e-3 * period, side="right") - 1, 0, len(time) - 1)


def directions(
    joint_position: Float[np.ndarray, "sample joint"],
    velocity: Float[np.ndarray, "sample joint"] | None,
    segment: Int[np.ndarray, " sample"],
    motion: Motion,
) -> Float[np.ndarray, "sample joint"]:
    """The direction of motion, −1, 0 or 1: the velocity's sign in a trajectory, else that of the step from the sample
    before it (from zero at the start of a segment). Rows with NaN get NaN and are passed over.
    """
    if motion == "trajectory" and velocity is not None:
        return np.sign(velocity)
    if motion == "trajectory":
        return np.sign(differentiate(joint_position, np.arange(float(len(segment))), segment))
    direction = np.full_like(joint_position, np.nan)
    usable = np.isfinite(joint_position).all(axis=1)
    q = joint_position[usable]
    s = segment[usable]
    previous = np.zeros_like(q)
    previous[1:] = np.where((np.diff(s) == 0)[:, None], q[:-1], 0.0)
    direction[usable] = np.sign(q - previous)
    return direction
