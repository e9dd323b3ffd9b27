"""Which orders of a joint's angle the residuals hold: gears and eccentric encoders, whole orders or not, to 200."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.estimation.score_test import Evidence, Score

Array = NDArray[np.floating]

HIGHEST = 200.0
_LOWEST = 1.0
_EXACT_BELOW = 12.0
"""Orders under which what the nuisance hides matters; these are scored exactly."""
_KEPT = 4
_BIN = 2 * np.pi / 2**15
"""Angles closer than this count as one: at order 200 they are a fiftieth of a radian apart."""


class Line(NamedTuple):
    """The order of a joint that explains most.

    Attributes:
        joint: counted from 1.
        order: of its angle.
        score: exact, at that order.
        tried: how many independent orders it is the best of, for the penalty of the search.
    """

    joint: int
    order: float
    score: Score
    tried: float

    @property
    def effect(self) -> JointHarmonic:
        """As an effect."""
        return JointHarmonic(self.joint, self.order)


def spectrum(evidence: Evidence, joint: int) -> tuple[Array, Array]:
    """Gains of the log-likelihood over the order of one joint's angle, `(order,)` each: orders, and what they explain.

    The nuisance is not projected out; under a few turns a gain is larger than it is.
    """
    case = evidence.case
    q = np.asarray(case.motion.joint_position[joint - 1])
    site = case.sites["joint", joint - 1, 0]
    used = evidence.fitted.used
    pull = np.sum(site * evidence.residual[: site.size].reshape(site.shape), 0)[used]
    weight = np.sum(site**2, 0)[used]
    # sums over samples of e^{i n q}, for all n at once: a transform of histograms over q
    span = max(float(np.ptp(q)), 1e-3)
    length = 2 ** int(np.ceil(np.log2(2 * np.pi / (_BIN * min(0.5 * np.pi / span, 0.5)))))
    place = np.rint((q[used] - q.min()) / _BIN).astype(int)
    step = 2 * np.pi / (_BIN * length)
    at = np.arange(int(np.ceil(_LOWEST / step)), int(HIGHEST / step))
    e = _transform(place, pull, length)[at]
    w = _transform(place, weight, length)
    total, twice = float(weight.sum()), w[2 * at]
    ss, cc, sc = 0.5 * (total - twice.real), 0.5 * (total + twice.real), 0.5 * twice.imag
    return at * step, _pair_gain(e.imag, e.real, ss, cc, sc)


def _transform(place: NDArray[np.integer], values: Array, length: int) -> NDArray[np.complexfloating]:
    return np.conj(np.fft.rfft(np.bincount(place, values), length)).astype(complex)


def lines(evidence: Evidence) -> list[Line]:
    """The best order of each joint, refined, the best joint first."""
    found = []
    for joint in range(1, evidence.case.motion.dof + 1):
        orders, gains = spectrum(evidence, joint)
        if not gains.any():
            continue
        step = orders[1] - orders[0]
        low = orders[orders <= _EXACT_BELOW][::2]
        best = np.unique(np.concatenate([low, orders[np.argsort(-gains)[:_KEPT]]]))
        order = _best(evidence, joint, best)
        for width in (step, step / 5):
            near = order + width * np.linspace(-1, 1, 9)
            order = _best(evidence, joint, near[near >= 0.5])
        whole = round(order)
        if whole >= 1:  # most gears are: another order must be clearly likelier
            exact, free = evidence.gains(evidence.case.harmonics(joint, np.array([float(whole), order])))
            order = float(whole) if exact > free - 2.0 else order
        score = evidence.score_columns(list(evidence.case.harmonics(joint, np.array([order]))))[0]
        found.append(Line(joint, order, score, len(orders) / 2))
    return sorted(found, key=lambda line: -line.score.gain)


def _best(evidence: Evidence, joint: int, orders: Array) -> float:
    return float(orders[int(np.argmax(evidence.gains(evidence.case.harmonics(joint, orders))))])


def _pair_gain(s: Array, c: Array, ss: Array, cc: Array, sc: Array) -> Array:
    determinant = ss * cc - sc**2
    safe = np.where(determinant > 1e-9 * ss * cc, determinant, 1.0)
    gain = 0.5 * (cc * s**2 - 2 * sc * s * c + ss * c**2) / safe
    return np.where(determinant > 1e-9 * ss * cc, gain, 0.0)
