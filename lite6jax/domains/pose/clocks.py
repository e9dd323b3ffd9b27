"""Two clocks, a robot's and a sensor's: their offset and drift from the motion that both have recorded.

    t_robot = t_sensor + offset + drift (t_sensor - middle)

At the right offset the flange, by the nominal chain, moves as the measured point does, whatever the sensor's frame and
the place of the point on the flange. So each offset of a grid is tried with both fitted in closed form, and the best
are refined by Gauss–Newton over offset, drift, frame and point, with Cauchy's weights. Then the geometry joins
them, with a prior about the nominal one: its errors look like a delay where the arm moves one way only.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.errors import InputError
from lite6jax.recordings.alignment import flange_poses, frames_from_poses, match_poses, median_distance
from lite6jax.recordings.columns.kinematics import CLOSE, FEWEST
from lite6jax.recordings.sequence import spread_rows
from lite6jax.recordings.streams import JointStream

ALIKE = 1.5
"""Times the error of the best offset, within which another one is as likely: a motion that repeats itself."""
_TRIED_ROWS = (80, 800)
"""Rows of the sensor by which an offset is tried: where it ran no longer than the robot's log, and at most."""
_FEWEST_TRIED = 20
_LEAST_OVERLAP = 0.3
"""Of them inside the robot's log: frame, point and offset have ten numbers; and as a share of those that could be."""
_LONGEST_WINDOW_S = 600.0
_GROWTH = 4.0
"""In which the offset is sought: a drift of 1e-4 moves its ends by 30 ms. It grows from fit to fit until all rows are
in it."""
_FINEST_S = 2e-3
_MOST_FRAMES = 200_000
"""Step and number of the flange's frames, by which its speed is found."""
_STEP = 0.04
_STEPS_S = (2e-3, 0.5)
"""Of the extent of the motion, covered from one offset to the next at a speed that the flange seldom exceeds."""
_MOST_OFFSETS = 60_000
_AT_ONCE = 40_000
"""Offsets that are tried, and rows of offsets that are tried together."""
_TRIED_AGAIN = 0.05
_TRIALS = 3
"""Share of the offsets that are tried again, and how often."""
_NEAR_S = 10.0
"""Around the offset of clocks that count from one day."""
_CANDIDATES = 4
_REFINED_ROWS = 1500
_MOST_ROWS = 20_000
"""Minima that are refined, by how many rows; and by how many the best one then."""
_GEOMETRY = (1e-3, 3e-3)
_MOST_WITH_GEOMETRY = 3000
"""Standard deviations in m and rad of an arm's numbers about the nominal ones, and the rows that fit them."""
_OFFSET_S = 1.0
_DRIFT = 1e-3
"""Standard deviations beforehand, of an offset around the candidate and of drifts: clocks drift by 1e-4 at most, and
nominal frame rates are off by 1e-3."""
_STILL_M = 5e-3
_LEVER_M = 0.1
"""A flange or a point that moves by less says nothing of the time; a lever by which its rotations count as motion."""
_STANDSTILL_S = 0.1
"""A change of the offset that no moving arm would hide."""
_DIFFERENCE_S = 1e-4
_DIFFERENCE = 1e-6
"""Steps of velocities, and in m and rad of derivatives by an arm's numbers."""
_BEYOND = 2
"""Rows by which captures are shifted further than their numbers allow: a motion that nearly fits there is none."""
_LEAST_LEFT = 0.1
"""Of the rows, as many as they are worth, that is left beside the numbers that were fitted."""
_ROUNDS = 30
_ROUNDS_WITH_GEOMETRY = 10
_DONE_S = 1e-9
_DONE = 1e-2
"""At most; a step in s, and in standard deviations of the offset, that is the last."""


class Clocks(NamedTuple):
    """How a sensor's clock runs against a robot's.

    Attributes:
        offset: s, the robot's time less the sensor's at `middle`.
        drift: by how much that grows per second.
        middle: s, the middle of the rows that show it, in the sensor's time.
        offset_std, drift_std: standard deviations; autocorrelated residuals count as the fewer that they are worth.
            Where the arm stood still at the poses, by how much the offset may be changed before it moves, and infinity.
        error: m, the median distance of measured positions and those of the nominal arm.
        moved: m, the median distance of the positions from their middle.
        rows: of the sensor, by which they were found.
        fitted_error: as `error`, with the geometry fitted beside the clocks; infinite where it was not.
    """

    offset: float
    drift: float
    middle: float
    offset_std: float = np.inf
    drift_std: float = np.inf
    error: float = np.inf
    moved: float = 0.0
    rows: int = 0
    fitted_error: float = np.inf

    @property
    def close(self) -> bool:
        """Tells whether the nominal arm agrees with the poses at all."""
        return self.error <= CLOSE * self.moved

    @property
    def ratio(self) -> float:
        return self.error / max(self.moved, 1e-9)

    def robot_time(self, time: Array) -> Array:
        """The times of a sensor's rows in the robot's clock, s."""
        return time + self.offset + self.drift * (time - self.middle)


class Pairing(NamedTuple):
    """Captures of joints and of positions that belong together in their order: from these rows on, so many.

    Attributes:
        joint, position: the first rows.
        rows: how many.
        error: m, the median distance of measured and predicted positions.
    """

    joint: int
    position: int
    rows: int
    error: float


def find_clocks(arm: Arm, joints: JointStream, time: Array, position: Array, likely: float | None = None) -> Clocks:
    """The offset and the drift of a sensor's clock against a robot's.

    Args:
        arm: the nominal arm.
        joints: the robot's log in SI units, in its own time.
        time: `(sample,)` s, the sensor's own, increasing; both count from nearby, so that a float resolves nanoseconds.
        position: `(sample, 3)` m, the measured point.
        likely: s, the offset near which the right one is, where several fit alike.

    Raises:
        InputError: nothing moves, no offset fits, or several fit alike; without the name of a file.
    """
    lasting = _window(time, position)
    rows = lasting[spread_rows(len(lasting), _REFINED_ROWS)]
    fits = []
    for offset in _candidates(arm, joints, time[lasting], position[lasting], likely):
        fits.append(_fitted(arm, joints, time[rows], position[rows], Clocks(offset, 0.0, float(np.mean(time[rows])))))
    fits.sort(key=lambda clocks: clocks.ratio)
    if not fits or not fits[0].close:
        remark = ""
        if fits:
            remark = f"; the best leaves {1e3 * fits[0].error:.3g} mm"
        raise InputError(
            f"the arm's motion and the poses agree at no offset of the clocks{remark}: check that both files are of "
            "one session, the arm (--arm), and the order, signs and units of the joints"
        )
    first = fits[0]
    rivals = [
        clocks for clocks in fits if clocks.ratio < ALIKE * first.ratio and not _same(arm, joints, time, first, clocks)
    ]
    if rivals and likely is None:
        raise InputError(
            "the motion repeats itself: offsets of the clocks that differ by "
            f"{abs(rivals[0].offset - first.offset):.3f} s fit alike; record a motion that does not repeat, or stamp "
            "both files by one clock"
        )
    if likely is not None:
        first = min([first, *rivals], key=lambda clocks: abs(clocks.offset - likely))
    half = max(_LONGEST_WINDOW_S / 2, 1.0)
    center = first.middle
    reach = float(np.max(np.abs(time - first.middle)))
    while True:
        rows = np.flatnonzero(np.abs(time - center) <= half)
        rows = rows[spread_rows(len(rows), _MOST_ROWS)]
        first = _fitted(arm, joints, time[rows], position[rows], first)
        if half >= reach:
            break
        half *= _GROWTH
    if width := _standstill(arm, joints, time[rows], first):
        return first._replace(offset_std=width, drift=0.0, drift_std=np.inf)
    rows = rows[spread_rows(len(rows), _MOST_WITH_GEOMETRY)]
    last = _fitted(arm, joints, time[rows], position[rows], first, _GEOMETRY)
    return last._replace(error=first.error, moved=first.moved, fitted_error=last.error)


def pair_in_order(arm: Arm, joint: Array, position: Array) -> Pairing | None:
    """Captures that belong together in their order; None where the nominal arm agrees with none, or with several.

    Args:
        arm: the nominal arm.
        joint: `(capture, joint)` in SI units.
        position: `(capture, 3)` m; of other numbers of captures the first or the last ones may be missing. Rows of a
            motion, which fit their neighbours nearly as well, are no captures.
    """
    flange = flange_poses(arm, joint)
    surplus = len(joint) - len(position)
    pairings = []
    for shift in range(min(surplus, 0) - _BEYOND, max(surplus, 0) + _BEYOND + 1):
        first = max(shift, 0), max(-shift, 0)
        count = min(len(joint) - first[0], len(position) - first[1])
        if count >= FEWEST:
            error, _ = match_poses(flange[first[0] :][:count], position[first[1] :][:count])
            pairings.append(Pairing(*first, count, error))
    if not pairings:
        return None
    closest, *further = sorted(pairings, key=lambda pairing: pairing.error)
    is_complete = closest.rows == min(len(joint), len(position))
    alone = all(pairing.error > ALIKE * closest.error for pairing in further)
    if is_complete and alone and closest.error <= CLOSE * median_distance(position):
        return closest
    return None


def _same(arm: Arm, joints: JointStream, time: Array, first: Clocks, second: Clocks) -> bool:
    """Tells whether the arm does not move from one offset to the other, as where it stood still at each pose."""
    rows = time[spread_rows(len(time), _REFINED_ROWS)]
    start = first.robot_time(rows)
    end = second.robot_time(rows)
    times = [start + share * (end - start) for share in np.linspace(0, 1, 6)]
    covered = np.logical_and.reduce([joints.known(at) for at in times])
    if covered.sum() < FEWEST:
        return False
    places = [flange_poses(arm, joints.at(at[covered]))[:, :3, 3] for at in times]
    apart = [float(np.median(np.linalg.norm(place - places[0], axis=1))) for place in places]
    return max(apart) <= max(first.error, second.error)


def _standstill(arm: Arm, joints: JointStream, time: Array, clocks: Clocks) -> float:
    """s, by which the offset may be changed either way before the arm moves; zero where less than `_STANDSTILL_S`."""
    width = 0.0
    for step in _STANDSTILL_S * 2.0 ** np.arange(8):
        either = (clocks._replace(offset=clocks.offset + sign * step) for sign in (1, -1))
        if not any(_same(arm, joints, time, clocks, displaced) for displaced in either):
            break
        width = float(step)
    return width


def _candidates(arm: Arm, joints: JointStream, time: Array, position: Array, likely: float | None) -> list[float]:
    """Offsets in s around which the clocks may be, the most likely first; one near `likely`, whatever others are like.

    Raises:
        InputError: the arm or the point hardly moves.
    """
    start, end = joints.time[[0, -1]]
    fine = max(_FINEST_S, joints.step, (end - start) / _MOST_FRAMES)
    times = np.arange(start, end, fine)
    flange = flange_poses(arm, joints.at(times))
    covered = joints.known(times)
    origin, x, z = (flange[:, :3, k] for k in (3, 0, 2))
    points = np.concatenate([origin, origin + _LEVER_M * z, origin + _LEVER_M * x], 1)
    extent = _extent(points[covered]) if covered.any() else 0.0
    if min(extent, _extent(position)) < _STILL_M:
        who = "the arm" if extent < _STILL_M else "the measured point"
        raise InputError(f"{who} hardly moves, so that nothing shows the offset of the clocks; record a motion")
    speed = float(np.quantile(np.linalg.norm(np.diff(points, axis=0), axis=1), 0.9)) / fine
    stride = max(1, round(float(np.clip(_STEP * extent / max(speed, 1e-9), *_STEPS_S)) / fine))
    step = stride * fine
    flange = flange[::stride]
    covered = covered[::stride]

    span = time[-1] - time[0]
    logged = step * len(flange)
    rows = spread_rows(len(time), int(np.clip(_TRIED_ROWS[0] * span / logged, *_TRIED_ROWS)))
    place = np.round((time[rows] - time[0]) / step).astype(int)
    stride = 1 + (len(flange) + int(place[-1])) // _MOST_OFFSETS
    shifts = np.arange(-int(place[-1]), len(flange), stride)
    fewest = max(_FEWEST_TRIED, _LEAST_OVERLAP * len(rows) * min(1.0, logged / max(span, 1e-9)))
    y = position[rows] - np.median(position[rows], axis=0)
    scores = np.full(len(shifts), np.inf)

    def score(chosen: Integers, rounds: int) -> None:
        for batch in np.array_split(chosen, 1 + len(chosen) * len(place) // _AT_ONCE):
            at = place + shifts[batch, None]
            inside = (at >= 0) & (at < len(flange))
            inside &= covered[np.where(inside, at, 0)]
            enough = inside.sum(1) >= min(fewest, len(rows))
            if enough.any():
                F = flange[np.where(inside, at, 0)[enough]]
                scores[batch[enough]] = _misfit(F[..., :3, :3], F[..., :3, 3], y, inside[enough], rounds)

    score(np.arange(len(shifts)), 1)
    # an offset tried once has its outliers in it: those that may be the best are tried again without
    score(np.flatnonzero(np.isfinite(scores) & (scores <= np.sort(scores)[int(_TRIED_AGAIN * len(scores))])), _TRIALS)
    offsets = start + step * shifts - time[0]
    order = np.argsort(scores)
    near = order[:0] if likely is None else order[np.abs(offsets[order] - likely) <= _NEAR_S][:1]
    candidates: list[float] = []
    for k in (*near, *order):
        if len(candidates) == _CANDIDATES or not np.isfinite(scores[k]):
            break
        if all(abs(offsets[k] - candidate) > 5 * stride * step for candidate in candidates):
            candidates.append(float(offsets[k]))
    return candidates


def _misfit(R: Array, p: Array, y: Array, covered: Mask, rounds: int) -> Array:
    """`(offset,)`, the median error of the positions with frame and point fitted, as a part of their spread.

    p = A y - b - R t is linear in A, b and t; A is projected on the rotations, and b and t are solved again, as in
    `calibration.start` for one offset.

    Args:
        R: `(offset, sample, 3, 3)` of the flange; `p` its position.
        y: `(sample, 3)`, measured.
        covered: `(offset, sample)`, where the flange is known.
        rounds: of weights by which outliers count less.
    """
    offsets, samples = covered.shape
    M = np.zeros((offsets, samples, 3, 15))
    for axis in range(3):
        M[:, :, axis, 3 * axis : 3 * axis + 3] = y
        M[:, :, axis, 9 + axis] = -1.0
    M[..., 12:] = -R
    weight = covered.astype(float)
    scale = np.zeros(offsets)
    for _ in range(rounds):
        A = _least_squares(M, p, weight)[:, :9].reshape(-1, 3, 3)
        U, _, Vt = np.linalg.svd(A)
        U[..., 2] *= np.linalg.det(U @ Vt)[:, None]
        R_sensor_base = np.swapaxes(U @ Vt, 1, 2)
        turned = R_sensor_base[:, None] @ R
        difference = y - np.einsum("oij,osj->osi", R_sensor_base, p)
        columns = np.concatenate([turned, np.broadcast_to(np.eye(3), turned.shape)], 3)
        shifts = _least_squares(columns, difference, weight)
        distance = np.linalg.norm(difference - np.einsum("osij,oj->osi", columns, shifts), axis=2)
        scale = np.nanmedian(np.where(covered, distance, np.nan), axis=1)
        weight = covered / (1 + (distance / (2 * np.maximum(scale, 1e-9))[:, None]) ** 2)
    measured = np.where(covered[..., None], y, np.nan)
    moved = np.linalg.norm(measured - np.nanmedian(measured, axis=1, keepdims=True), axis=2)
    return scale / np.maximum(np.nanmedian(moved, axis=1), 1e-9)


def _least_squares(columns: Array, target: Array, weight: Array) -> Array:
    """`(offset, unknown)` of `(offset, sample, 3, unknown)` columns; nearly the shortest where it is not unique."""
    offsets, samples, _, unknowns = columns.shape
    root = np.sqrt(weight)[..., None]
    A = (root[..., None] * columns).reshape(offsets, 3 * samples, unknowns)
    b = (root * target).reshape(offsets, 3 * samples, 1)
    normal = np.swapaxes(A, 1, 2) @ A
    ridge = 1e-10 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(unknowns)
    return np.linalg.solve(normal + ridge, np.swapaxes(A, 1, 2) @ b)[..., 0]


def _fitted(
    arm: Arm,
    joints: JointStream,
    time: Array,
    position: Array,
    start: Clocks,
    geometry: tuple[float, float] | None = None,
) -> Clocks:
    """The clocks near others, by all rows given whose joints are known.

    The geometry is fitted too where standard deviations of its lengths and angles about the nominal ones are given.
    """
    from scipy.spatial.transform import Rotation  # takes longer to import than captures in their order take

    nothing = Clocks(start.offset, start.drift, start.middle)
    covered = joints.known(start.robot_time(time))
    if covered.sum() < FEWEST:
        return nothing
    middle = float(np.mean(time[covered]))
    now = start._replace(offset=start.offset + start.drift * (middle - start.middle), middle=middle)
    kinematics = 0.0
    T, T_tool = frames_from_poses(
        flange_poses(arm, joints.at(now.robot_time(time[covered]))), position[covered], None, None, None
    )
    R = T[:3, :3]
    t = T[:3, 3]
    tool = T_tool[:3, 3]

    def placed(joint: Array, change: Array | float) -> Array:
        changed = replace(arm, kinematics=arm.kinematics + change, dh=None)
        return (flange_poses(changed, joint)[:, :3] @ np.r_[tool, 1.0]) @ R.T

    # beforehand nothing is known of frame and point; an offset is believed as it is
    std = np.r_[_OFFSET_S, _DRIFT, np.full(9, np.inf), np.tile(np.repeat(geometry or (), 3), arm.dof)]
    rounds = _ROUNDS if geometry is None else _ROUNDS_WITH_GEOMETRY
    done = False
    while True:
        at = now.robot_time(time)
        covered = joints.known(at)
        if covered.sum() < FEWEST:
            return nothing
        at = at[covered]
        since = time[covered] - middle
        measured = position[covered]
        q, ahead, behind = (joints.at(at + _DIFFERENCE_S * sign) for sign in (0, 1, -1))
        predicted = placed(q, kinematics)
        flange = flange_poses(replace(arm, kinematics=arm.kinematics + kinematics, dh=None), q)
        velocity = (placed(ahead, kinematics) - placed(behind, kinematics))[:, :, None] / (2 * _DIFFERENCE_S)
        turned = np.swapaxes(np.cross(np.eye(3), predicted[:, None]), 1, 2)  # of each axis, by which `predicted` moves
        columns = [velocity, velocity * since[:, None, None], turned]
        columns += [np.broadcast_to(np.eye(3), (len(at), 3, 3)), R @ flange[:, :3, :3]]
        for unit in _DIFFERENCE * np.eye(arm.kinematics.size).reshape(-1, arm.dof, 6) if geometry else ():
            columns.append(((placed(q, kinematics + unit) - predicted) / _DIFFERENCE)[:, :, None])
        missed = measured - predicted - t
        J = np.concatenate(columns, axis=2)
        distance = np.linalg.norm(missed, axis=1)
        scale = 2 * max(float(np.median(distance)), 1e-9)
        # m² of an axis, roughly
        weight = 1 / (1 + (distance / scale) ** 2)
        noise = (scale / 3) ** 2
        score = weight[:, None] * np.einsum("sim,si->sm", J, missed)
        prior = noise / std**2
        if done or not rounds:
            break
        rounds -= 1
        away = np.r_[0.0, now.drift, np.zeros(9), np.ravel(np.broadcast_to(kinematics, (arm.dof, 6)))][: len(std)]
        normal = np.einsum("s,sim,sin->mn", weight, J, J) + np.diag(prior)
        step = np.linalg.lstsq(normal, score.sum(axis=0) - prior * away, rcond=1e-12)[0]
        step *= min(1.0, 0.5 / max(float(np.linalg.norm(step[2:5])), 1e-12))
        now = now._replace(offset=float(now.offset + step[0]), drift=float(now.drift + step[1]))
        R = Rotation.from_rotvec(step[2:5]).as_matrix() @ R
        t = t + step[5:8]
        tool = tool + step[8:11]
        kinematics = kinematics + step[11:].reshape(-1, 6) if geometry else 0.0
        shift = abs(step[0]) + abs(step[1]) * float(np.max(np.abs(since)))
        done = shift < max(_DONE_S, _DONE * float(np.sqrt(noise / max(normal[0, 0], 1e-300))))
    curved = weight - (2 / 3) * weight**2 * (distance / scale) ** 2
    information = np.einsum("s,sim,sin->mn", curved, J, J) + np.diag(prior)
    inverse = np.linalg.pinv(information, rcond=1e-12, hermitian=True)[:, :2]
    by_prior = noise * prior @ inverse**2  # what the rows leave open is as uncertain as it was beforehand
    by_rows = [_std_of_sum(part, len(std)) for part in (score @ inverse).T]
    deviation = np.hypot(by_rows, np.sqrt(by_prior))
    return now._replace(
        offset_std=float(deviation[0]),
        drift_std=float(deviation[1]),
        error=float(np.median(distance)),
        moved=median_distance(measured),
        rows=len(missed),
    )


def _std_of_sum(parts: Array, parameters: int) -> float:
    """The standard deviation of a sum of autocorrelated parts of mean zero `(sample,)`.

    Bartlett's weights up to the lag that D. W. K. Andrews (Econometrica 59, 1991) gives for an autoregression.
    """
    n = len(parts)
    correlation = float(np.clip(parts[1:] @ parts[:-1] / max(parts @ parts, 1e-300), 0.0, 0.999))
    persistence = 4 * correlation**2 / ((1 - correlation) ** 2 * (1 + correlation) ** 2)
    lags = int(min(1.1447 * (persistence * n) ** (1 / 3), n // 4))
    white = float(parts @ parts)
    variance = white + sum(2 * (1 - k / (lags + 1)) * (parts[k:] @ parts[:-k]) for k in range(1, lags + 1))
    share = parameters * max(variance / max(white, 1e-300), 1.0) / n  # of the parts that the numbers have used up
    return float(np.sqrt(max(variance, white) / max(1 - share, _LEAST_LEFT)))


def _window(time: Array, position: Array) -> Integers:
    """The rows in which the offset is sought: all, or of a long log the part in which the point moves most."""
    if time[-1] - time[0] <= _LONGEST_WINDOW_S:
        return np.arange(len(time))
    starts = np.arange(time[0], time[-1] - _LONGEST_WINDOW_S / 2, _LONGEST_WINDOW_S / 2)
    windows = [np.flatnonzero((time >= start) & (time <= start + _LONGEST_WINDOW_S)) for start in starts]
    if max(map(len, windows)) < 2 * FEWEST:  # captures minutes apart
        return np.arange(len(time))
    return max(windows, key=lambda rows: median_distance(position[rows]) if len(rows) >= FEWEST else 0.0)


def _extent(position: Array) -> float:
    """The width of the middle nine tenths, along the axis where that is most."""
    return float(np.max(np.ptp(np.quantile(position, [0.05, 0.95], axis=0), axis=0)))
