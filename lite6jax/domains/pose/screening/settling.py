"""Joints that were read before the arm had settled: the poses are further along each move than the joints say."""

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, chdtri, ndtr

from lite6jax.domains.pose.screening.projection import Projected, thinned
from lite6jax.domains.pose.screening.rigid import Rigid, physics_columns
from lite6jax.recordings import Recording
from lite6jax.recordings.recording import run_segments

Array = NDArray[np.floating]

LEVEL = 1e-4
"""Family-wise."""
LEAST_SHARE = 0.01
"""Of what the physics leaves, that unsettled read-outs explain: less may be anything where poses are in an order."""
_WILD = 30.0
_ALONG = 0.9
_APART = 0.03
_NUMBERS_A_PIECE, _FEWEST_PIECES, _MOST_PIECES = 10, 4, 16
_POLISHED = 6


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
        foretold: whether one was turned down because the moves that follow explain the poses as well.
    """

    shape: Literal["move", "velocity", "constant", "rows"] | None
    joints: tuple[int, ...]
    rest: Array
    std: Array
    correction: Array
    samples: NDArray[np.integer]
    p: float
    foretold: bool = False


def seek_unsettled(arm: Rigid) -> Unsettled:
    """Whether the joints of a static recording were read before the arm had come to rest.

    Then the pose shows the arm at q + rest, rest in the direction of the move: a share of it, or a time at the recorded
    velocity, or an angle. No effect depends on where the arm was before but backlash, whose sign is the opposite; all
    are estimated beside each other.

    Args:
        arm: fitted.
    """
    recording = arm.recording
    dof, n = recording.dof, arm.samples
    none = Unsettled(None, (), np.zeros(dof), np.zeros(dof), np.zeros((n, dof)), np.zeros(0, int), 1.0)
    if recording.motion != "static" or n < 3:
        return none
    wild = _unsettled_rows(arm)
    if wild is not None:
        return wild
    every = _rests(recording)
    few = thinned(n)
    shapes, future, arm = (
        {name: shape[few] for name, shape in every.items()},
        _next_moves(recording)[few],
        arm.select(few),
    )
    columns = {name: arm.joints * shape.T[:, None] for name, shape in shapes.items()}
    plain = np.concatenate([physics_columns(arm, skip=("direction",)), _curves(arm)])
    tests, least, foretold = len(shapes) * (1 + dof), 1.0, False
    found: list[tuple[float, Unsettled]] = []
    for name in shapes:
        projected = Projected(arm, np.concatenate([plain, *(columns[other] for other in shapes if other != name)]))
        if projected.freedom < arm.samples:
            return none._replace(p=np.nan)
        each, covariance, separate = projected.regression(columns[name])
        one, spread, common = projected.regression(columns[name].sum(0, keepdims=True))
        p_one = float(ndtr(-one[0] / np.sqrt(spread[0, 0]))) * tests
        p_each = ndtr(-each / np.sqrt(np.diagonal(covariance))) * tests
        p = min(p_one, float(p_each.min()))
        least = min(least, p)
        if p > LEVEL:
            continue
        rest, std = np.full(dof, one[0]), np.full(dof, np.sqrt(spread[0, 0]))
        concerned, explained = np.ones(dof, bool), common
        apart = separate - common > max(chdtri(max(dof - 1, 1), 1e-4), _APART * separate)
        if p_one > LEVEL or apart:
            concerned = p_each < LEVEL
            rest, std = np.where(concerned, each, 0.0), np.sqrt(np.diagonal(covariance))
            explained = float(np.sum((rest / std) ** 2))
        if explained < LEAST_SHARE * projected.freedom:
            continue
        if name != "velocity" and _foretold(projected, columns[name], future if name == "move" else np.sign(future)):
            foretold = True
            continue
        joints = tuple(int(j) for j in np.flatnonzero(concerned))
        if joints:
            unsettled = Unsettled(name, joints, rest, std, every[name] * rest, np.arange(n), min(p, 1.0))  # type: ignore[arg-type]
            found.append((separate, unsettled))
    return max(found, key=lambda item: item[0])[1] if found else none._replace(p=min(least, 1.0), foretold=foretold)


def settled(arm: Rigid, found: Unsettled) -> tuple[Rigid, Unsettled]:
    """The arm with the rest added to its joints, fitted; and what was found as refined, each step linearised anew."""
    rest, concerned = np.zeros(len(found.rest)), np.isin(np.arange(len(found.rest)), found.joints)
    alike = np.ptp(found.rest) == 0
    few, step, shape = thinned(arm.samples), found.rest, _rests(arm.recording)[str(found.shape)]
    start = arm.recording
    for _ in range(_POLISHED):
        rest = rest + step
        arm = replace(arm, recording=replace(start, joint_position=start.joint_position + shape * rest)).fitted()
        part = arm.select(few)
        columns = part.joints * shape[few].T[:, None]
        known = [physics_columns(part, skip=("direction",) if found.shape == "constant" else ()), _curves(part)]
        group = columns.sum(0, keepdims=True) if alike else columns[concerned]
        values, covariance, _ = Projected(part, np.concatenate(known)).regression(group)
        std = np.sqrt(np.diagonal(covariance))
        if np.all(np.abs(values) < 0.1 * std):
            break
        step = np.zeros_like(rest)
        step[concerned] = np.where(np.isfinite(std), values, 0.0)
    return arm, found._replace(rest=rest, correction=shape * rest)


def _rests(recording: Recording) -> dict[str, Array]:
    """What a rest may be proportional to, `(sample, joint)` each."""
    shapes = {"move": moves(recording), "constant": recording.direction_of_motion}
    if recording.joint_velocity is not None and np.any(recording.joint_velocity):
        shapes["velocity"] = recording.joint_velocity
    return shapes


def moves(recording: Recording) -> Array:
    """`(sample, joint)` rad from where each joint was in the row before; from zero in the first row of a run."""
    q = recording.joint_position
    first = np.concatenate([[True], np.diff(run_segments(recording.run)) != 0])
    before = np.concatenate([np.zeros((1, q.shape[1])), q[:-1]])
    return q - np.where(first[:, None], 0.0, before)


def _curves(arm: Rigid) -> Array:
    """`(number, row, sample)` of any curve over each joint's position, piecewise linear: what moves there may depend on
    where they lead, as in a sweep to and fro."""
    dof = arm.recording.dof
    pieces = min(arm.rows * arm.samples // (_NUMBERS_A_PIECE * dof), _MOST_PIECES)
    out = [np.zeros((0, arm.rows, arm.samples))]
    for column, q in zip(arm.joints, arm.recording.joint_position.T, strict=True):
        knots = np.unique(np.quantile(q, np.linspace(0, 1, max(pieces, 2)), method="nearest"))
        if pieces >= _FEWEST_PIECES and len(knots) > 1:
            out.append(column * np.stack([np.interp(q, knots, hat) for hat in np.eye(len(knots))])[:, None])
    return np.concatenate(out)


def _foretold(projected: Projected, columns: Array, future: Array) -> bool:
    """Whether the moves that follow explain the poses too, beside those that led there: then the order of the poses is
    tied to where they are, and it is something else that depends on that."""
    past = projected.regression(columns)[2]
    both = projected.regression(np.concatenate([columns, projected.arm.joints * future.T[:, None]]))[2]
    return bool(both - past > max(chdtri(len(columns), 1e-6), 0.1 * past))


def _next_moves(recording: Recording) -> Array:
    """`(sample, joint)` rad from where each joint is in the row after; zero in the last row of a run."""
    back = -moves(recording)
    back[np.concatenate([[True], np.diff(run_segments(recording.run)) != 0])] = 0.0
    return np.roll(back, -1, axis=0)


def _unsettled_rows(arm: Rigid) -> Unsettled | None:
    """Rows far off whose residual lies along the move that led there."""
    recording, scale = arm.recording, arm.scale
    wild = arm.squares > _WILD * arm.rows * scale**2
    if not 3 <= wild.sum() <= arm.samples // 3:
        return None
    along = np.einsum("jrs,sj->rs", arm.joints, moves(recording))
    length = np.sum(along**2, 0)
    product = np.sum(along * arm.residual, 0)
    share = -product / np.maximum(length, 1e-300)
    cosine2 = product**2 / np.maximum(length * arm.squares, 1e-300)
    hit = wild & (cosine2 > _ALONG) & (share > 0)
    by_chance = (1 - np.sqrt(_ALONG)) / 2
    p = float(bdtrc(hit.sum() - 1, wild.sum(), by_chance))
    if p > LEVEL or hit.sum() < 3:
        return None
    rest = np.full(recording.dof, float(np.median(share[hit])))
    none = np.zeros_like(recording.joint_position)
    return Unsettled("rows", tuple(range(recording.dof)), rest, np.zeros_like(rest), none, np.flatnonzero(hit), p)
