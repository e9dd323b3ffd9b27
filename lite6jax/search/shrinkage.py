"""Joints that err at many orders at once: all orders under one prior, thinned out to the few that the curves need.

To add orders one by one finds the largest first and fits the others wrongly meanwhile; all at once, their size being
what the data say it is (D. MacKay, Bayesian Interpolation, Neural Computation 4, 1992, eq. 4.9), none is fitted far
from where it was measured. What matters least is then taken away, step by step.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.special import chdtri

from lite6jax.domains.pose.problem import Case
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.least_squares import Fitted, refit, without
from lite6jax.estimation.score_test import Score, chance, evidence_of
from lite6jax.estimation.robust import FREEDOM
from lite6jax.search.backward import Step

Array = NDArray[np.floating]

ORDERS = np.arange(1.0, 60.25, 0.5)
LINES_PER_JOINT = 11
"""What is kept at most: a curve of more numbers would be a table of corrections."""
_NAMED_MOST = 12
"""Numbers of named effects beside the curves."""
_FEW = 3
"""Orders of one joint that stay harmonics, each with its name."""
_DROPPED = 0.1
_PLAUSIBLE = 300.0
"""Times the typical size of a number, beyond which it fits something else."""
_ROUNDS = 3
_WEIGHINGS = 3
_SETTLINGS = 5
_FADES_WITHIN = 0.2
_NEIGHBOURS = 8


class _Lines(NamedTuple):
    """The lines that are kept: joints from 0, orders, and the prior's standard deviation of a joint's coefficients."""

    joint: NDArray[np.integer]
    order: Array
    spread: Array


def sweep(
    case: Case, baseline: Fitted, found: Sequence[Step], candidates: Sequence[Effect], tried: float, level: float
) -> tuple[Fitted, list[Step]]:
    """The named effects and the curves of joints that explain a case together.

    Args:
        case: the data.
        baseline: the nuisance alone.
        found: what a search has found that adds one effect after another; its harmonics are found anew.
        candidates: named effects.
        tried: how many independent candidates there are.
        level: of the family-wise error.
    """
    named = [item for item in found if not isinstance(item.effect, JointHarmonic)]
    plain = [
        effect for effect in candidates if effect.drivers and not any(d.quantity == "position" for d in effect.drivers)
    ]
    state, curves = _with_curves(case, baseline, baseline, named)
    for _ in range(_ROUNDS - 1):
        room = _NAMED_MOST - sum(item.effect.size for item in named)
        added = _named(case, state, plain, tried, level, room)
        if not added:
            break
        named += added
        state, curves = _with_curves(case, baseline, state, named)
    return state, [*named, *(_judged(case, state, curve, tried) for curve in curves)]


def _with_curves(case: Case, baseline: Fitted, state: Fitted, named: Sequence[Step]) -> tuple[Fitted, list[Effect]]:
    """Named effects and the curves that joints need beside them, fitted; `state` is what is known so far."""
    effects = tuple(item.effect for item in named)
    curves = _curves(case, _lines(case, state, Physics(effects)), state.used)
    return refit(case, Physics((*effects, *curves)), moved=baseline.moved, used=baseline.used), curves


def _lines(case: Case, state: Fitted, named: Physics) -> _Lines:
    """The orders of each joint that matter most, beside the nuisance and named effects."""
    used = np.flatnonzero(state.used)
    fixed = np.concatenate([case.nuisance, case.columns(named.effects)])[..., used]
    q = np.asarray(case.motion.joint_position)[:, used]
    turned = ORDERS[:, None] * q[:, None]
    waves = np.stack([np.sin(turned), np.cos(turned)], 2)
    sites = np.stack([case.sites["joint", j, 0] for j in range(len(q))])[..., used]
    lines = (sites[:, None, None] * waves[..., None, :]).reshape(-1, *fixed.shape[1:])
    columns = np.concatenate([fixed, lines]).reshape(len(fixed) + len(lines), -1)
    norms = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
    columns /= norms[:, None]
    # residuals of the state, with all that it has put back
    target = (state.residual.rows - _shown(case, state))[:, used].ravel()
    free, shrink = len(fixed), 0.01
    weight = np.ones(len(used))
    total = squares = np.sum(target.reshape(-1, len(used)) ** 2, 0)
    for _ in range(_WEIGHINGS):
        H, g = _normal(columns, target, weight)
        solved, shrink = _settled(H, g, free, shrink, float(weight @ total), target.size)
        squares = np.sum((target - solved @ columns).reshape(-1, len(used)) ** 2, 0)
        scale = np.median(squares) / chdtri(case.rows, 0.5)
        weight = (FREEDOM + case.rows) / (FREEDOM + squares / scale)
    H, g = _normal(columns, target, weight)
    noise = float(weight @ squares / max(target.size - len(H), 1))
    active = _thinned_out(H, g, free, shrink, LINES_PER_JOINT * len(q))
    joint, order = np.divmod(active, len(ORDERS))
    size = np.sqrt(noise / shrink) / norms[free:].reshape(len(q), -1)
    return _Lines(joint, ORDERS[order], np.median(size, axis=1))


def _shown(case: Case, state: Fitted) -> Array:
    """What the effects and the nuisance of a state do to its residuals, to first order."""
    columns = np.concatenate([case.nuisance, case.columns(state.physics.effects, state.values)])
    return np.tensordot(np.concatenate([state.moved, state.values]), columns, 1)


def _normal(columns: Array, target: Array, weight: Array) -> tuple[Array, Array]:
    weights = np.tile(np.sqrt(weight), target.size // weight.size)
    weighted = columns * weights
    return weighted @ weighted.T, weighted @ (weights * target)


def _settled(H: Array, g: Array, free: int, shrink: float, total: float, count: int) -> tuple[Array, float]:
    """The coefficients, and the prior's precision over the noise's that their own size asks for."""
    x = np.zeros(len(H))
    for _ in range(_SETTLINGS):
        inverse = np.linalg.inv(_regular(H, free, shrink))
        x = inverse @ g
        left = total - 2 * x @ g + x @ H @ x
        told = len(H) - shrink * np.trace(inverse[free:, free:])
        asked = (told - free) * left / max(count - told, 1.0) / max(float(np.sum(x[free:] ** 2)), 1e-300)
        shrink = float(np.clip(asked, 1e-8, 1e8))
    return x, shrink


def _regular(H: Array, free: int, shrink: float) -> Array:
    return H + np.diag(np.where(np.arange(len(H)) < free, 1e-9, shrink))


def _thinned_out(H: Array, g: Array, free: int, shrink: float, most: int) -> NDArray[np.integer]:
    """The lines left when those that matter least have been taken away, a few at a time."""
    active = np.arange((len(H) - free) // 2)
    while len(active) > most:
        at = np.concatenate([np.arange(free), (free + 2 * active[:, None] + np.arange(2)).ravel()])
        inverse = np.linalg.inv(_regular(H[np.ix_(at, at)], free, shrink))
        pairs = (inverse @ g[at])[free:].reshape(-1, 2)
        k = np.arange(len(active))
        blocks = inverse[free:, free:].reshape(len(active), 2, len(active), 2)[k, :, k]
        matters = np.einsum("pi,pij,pj->p", pairs, np.linalg.inv(blocks), pairs)
        dropped = max(1, min(len(active) - most, int(_DROPPED * len(active))))
        active = np.sort(active[np.argsort(matters)[dropped:]])
    return active


def _curves(case: Case, lines: _Lines, used: NDArray[np.bool_]) -> list[Effect]:
    """One effect for each joint that has lines: a curve, or harmonics where they are few."""
    curves: list[Effect] = []
    for joint in np.unique(lines.joint):
        orders = tuple(float(order) for order in lines.order[lines.joint == joint])
        if len(orders) <= _FEW:
            curves += [JointHarmonic(int(joint) + 1, order) for order in orders]
            continue
        curves.append(waves_of(case, int(joint) + 1, orders, used, float(lines.spread[joint])))
    return curves


def waves_of(
    case: Case, joint: int, orders: Sequence[float], used: NDArray[np.bool_], spread: float | None = None
) -> Unnamed:
    """The curve of some orders of a joint, counted from 1, that fades where none of the rows used was."""
    q = np.asarray(case.motion.joint_position[joint - 1])[used]
    lower, upper = float(q.min()) - 3 * _FADES_WITHIN, float(q.max()) + 3 * _FADES_WITHIN
    at = np.linspace(lower, upper, int(np.ceil((upper - lower) / (_FADES_WITHIN / 4))))
    nth = min(max(_NEIGHBOURS, len(q) // 150), len(q))
    away = np.asarray(KDTree(q[:, None]).query(at[:, None], k=nth)[0])[:, -1]
    trust = tuple(float(t) for t in np.exp(-((away / _FADES_WITHIN) ** 2)).round(4))
    driver = f"position of joint {joint}"
    return Unnamed(f"joint{joint}", driver, lower, upper, orders=tuple(orders), trust=trust, spread=spread)


def _named(
    case: Case, state: Fitted, candidates: Sequence[Effect], tried: float, level: float, room: int
) -> list[Step]:
    """Named effects that what is left still asks for, each judged after those before it."""
    evidence = evidence_of(case, state)
    pairs = [pair for pair in zip(candidates, evidence.score(candidates), strict=True) if not pair[1].hidden]
    added: list[Step] = []
    for effect, _ in sorted(pairs, key=lambda pair: -pair[1].gain)[:_NAMED_MOST]:
        columns = case.columns([effect])
        score = evidence.score_columns([columns])[0]
        p = score.familywise(tried)
        known = any(effect == have for have in state.physics.effects)
        wild = (np.abs(score.values) > _PLAUSIBLE * Physics((effect,)).typical).any()
        if known or wild or score.hidden or p >= level or score.gain < effect.size * np.log(evidence.freedom):
            continue
        if effect.size > room or (added and score.gain < 0.3 * added[0].score.gain):
            continue
        added.append(Step(effect, p, score))
        room -= effect.size
        evidence = evidence.given(columns)
    return added


def _judged(case: Case, state: Fitted, curve: Effect, tried: float) -> Step:
    """What a curve explains beside all else; too many numbers for a test by blocks, so as many samples as forget."""
    at = state.physics.effects.index(curve)
    part = state.physics.slices[at]
    scale = state.residual.scale
    gain = state.log_likelihood(scale) - without(case, state, at).log_likelihood(scale)
    p = min(chance(gain, curve.size, evidence_of(case, state).memory) * tried, 1.0)
    return Step(curve, p, Score(gain, curve.size, p, False, state.values[part]))
