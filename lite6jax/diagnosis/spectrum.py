"""Which orders of a joint's angle the residuals hold: gears and eccentric encoders, whole orders or not, to 200."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.diagnosis.evidence import Evidence, Score
from lite6jax.physics.joints import JointHarmonic

Array = NDArray[np.floating]

HIGHEST = 200.0
_LOWEST = 1.0
_EXACT_BELOW = 12.0
"""Orders under which what the nuisance hides matters; these are scored exactly."""
_KEPT = 4
_AT_ONCE = 128


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
    span = max(float(np.ptp(q)), 1e-3)
    orders = np.arange(_LOWEST, HIGHEST, min(0.5 * np.pi / span, 0.5))
    site = case.sites["joint", joint - 1, 0]
    used = evidence.fitted.used
    pull = np.sum(site * evidence.residual.reshape(site.shape), 0)[used]
    weight = np.sum(site**2, 0)[used]
    q = q[used]
    gains = np.zeros(len(orders))
    for first in range(0, len(orders), _AT_ONCE):
        angle = np.multiply.outer(orders[first : first + _AT_ONCE], q)
        s, c = np.sin(angle), np.cos(angle)
        gains[first : first + _AT_ONCE] = _pair_gain(s @ pull, c @ pull, s * s @ weight, c * c @ weight, s * c @ weight)
    return orders, gains


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
        if whole >= 1 and abs(order - whole) < 0.15 * step + 0.02:
            exact, free = evidence.score_columns(list(evidence.case.harmonics(joint, np.array([float(whole), order]))))
            order = float(whole) if exact.gain > free.gain - 2.0 else order
        score = evidence.score_columns(list(evidence.case.harmonics(joint, np.array([order]))))[0]
        found.append(Line(joint, order, score, len(orders) / 2))
    return sorted(found, key=lambda line: -line.score.gain)


def _best(evidence: Evidence, joint: int, orders: Array) -> float:
    scores = evidence.score_columns(list(evidence.case.harmonics(joint, orders)))
    return float(orders[int(np.argmax([score.gain for score in scores]))])


def _pair_gain(s: Array, c: Array, ss: Array, cc: Array, sc: Array) -> Array:
    determinant = ss * cc - sc**2
    safe = np.where(determinant > 1e-9 * ss * cc, determinant, 1.0)
    gain = 0.5 * (cc * s**2 - 2 * sc * s * c + ss * c**2) / safe
    return np.where(determinant > 1e-9 * ss * cc, gain, 0.0)
