"""How a fit ended and, which is another question, whether its model describes the poses that it was fitted to.

Nothing is fitted here, so that those who only read results import little.
"""

from enum import IntEnum
from typing import Any, Literal, NamedTuple

import numpy as np

from lite6jax.array_types import Array

QualityVerdict = Literal["good", "above_noise", "bad"]
Reason = Literal["too_far", "unrelated"]

RUNNING, CONVERGED, STEPS_EXHAUSTED, NOT_FINITE, SINGULAR = range(5)
"""How a fit stands."""

FARTHEST_SHARE = 0.01
"""Of the arm's reach, which the errors of a model that describes an arm do not exceed: 7 mm for a Lite 6. The nominal
table of a real arm is off by less (8.5 mm for a real xArm 7, before any fit), and a real UR10 with all its compliance
is 0.4 mm from the best geometry; another model of arm, a wrong joint order or a clock that is off by a tenth of a
second leave more."""
NOISES = 5.0
"""Times the declared noise per axis, which errors may have as well: a camera need not be precise. Three quarters of
isotropic errors are within twice their standard deviation per axis; the rest is for noise that is declared too low."""
LEAST_EXPLAINED = 0.5
"""Share of the variance of the measured positions that a model must explain where the joints move the arm by more than
its error: poses that have nothing to do with the joints are explained by none."""
ABOVE_NOISE = 1.5
"""Times the declared noise, beyond which the residuals show that something is left to explain."""
ROUNDING = 1e-6
"""m; the model of a calibration reproduces it to rounding, and a larger error is that of another minimum."""
_QUARTILE = 75.0
"""Per cent of the rows that must be near: outliers of a sensor are fewer than a quarter."""


class Result(IntEnum):
    """How the fit of one arm ended."""

    CONVERGED = CONVERGED
    STEPS_EXHAUSTED = STEPS_EXHAUSTED
    NOT_FINITE = NOT_FINITE
    SINGULAR = SINGULAR
    TOO_FEW_SAMPLES = 5
    UNREADABLE = 6

    @property
    def message(self) -> str:
        """One line for a person."""
        return {
            Result.CONVERGED: "converged",
            Result.STEPS_EXHAUSTED: "did not converge in the steps allowed; check the arm's model, or allow more steps",
            Result.NOT_FINITE: "met a number that is not finite; check the input",
            Result.SINGULAR: "does not determine every parameter; record poses that move every joint",
            Result.TOO_FEW_SAMPLES: "has fewer measured numbers than parameters; record more poses",
            Result.UNREADABLE: "could not be read",
        }[self]


class Quality(NamedTuple):
    """A judgement whether a model describes the poses that it was fitted to.

    Attributes:
        verdict: `good`; `above_noise`, where it does, and more is left than the declared noise; or `bad`.
        reason: of `bad`: `too_far`, where over a quarter of the rows are further from it than `limit`; `unrelated`,
            where it explains less than half of the variance of the positions.
        error: m, which three quarters of the position errors on rows that were not fitted do not exceed.
        limit: m, for `error`.
        explained: share of the variance of the measured positions that the model explains, in these rows; zero of one
            point, which has none; None for a calibration.
    """

    verdict: QualityVerdict
    reason: Reason | None
    error: float
    limit: float
    explained: float | None

    def to_dict(self) -> dict[str, Any]:
        """As in JSON documents: codes and numbers in SI units."""
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "error_m": self.error if np.isfinite(self.error) else None,
            "limit_m": self.limit,
            "explained_share": self.explained,
        }


def quality_of_poses(
    distance: Array, measured: Array, predicted: Array, reach: float, declared: float | None, over_noise: float | None
) -> Quality:
    """The quality of a model of measured poses.

    Args:
        distance: `(sample,)` m, position errors on rows that were not fitted.
        measured, predicted: `(sample, 3)` m.
        reach: of the arm, m.
        declared: the declared noise per axis, m; None where there is none.
        over_noise: residuals over the declared noise; None where there is none.
    """
    limit = max(FARTHEST_SHARE * reach, NOISES * (declared or 0.0))
    error = upper_quartile(distance)
    spread = spread_of(measured)
    moved = spread_of(predicted)
    explained = 1 - (error / spread) ** 2 if spread > 0 else 0.0
    explained = float(explained) if np.isfinite(explained) else -1.0
    if not error <= limit:
        return Quality("bad", "too_far", error, limit, explained)
    if explained < LEAST_EXPLAINED and moved > error:
        return Quality("bad", "unrelated", error, limit, explained)
    above = over_noise is not None and over_noise >= ABOVE_NOISE
    return Quality("above_noise" if above else "good", None, error, limit, explained)


def quality_of_calibration(distance: Array) -> Quality:
    """The quality of a model of a calibration, by its position errors `(sample,)` m at fresh joint positions."""
    error = float(np.max(distance))
    good = error <= ROUNDING
    return Quality("good" if good else "bad", None if good else "too_far", error, ROUNDING, None)


def upper_quartile(distance: Array) -> float:
    """The distance that three quarters of `(sample,)` do not exceed; infinite where one is not finite."""
    if np.isfinite(distance).all():
        return float(np.percentile(distance, _QUARTILE))
    return float("inf")


def spread_of(position: Array) -> float:
    """m, from the median position, as `error` is of the errors."""
    return upper_quartile(np.linalg.norm(position - np.median(position, axis=0), axis=1))
