"""Two estimates of one quantity, of two domains or of two recordings, and whether they agree."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
from scipy.special import chdtrc

from lite6jax.array_types import Array
from lite6jax.effects.effect import Estimate

DISAGREE = 0.0027
"""The probability of a difference by chance, three standard deviations, below which two estimates disagree."""


class EffectEstimate(NamedTuple):
    """What one domain says of a quantity: its values `(number,)`, their covariance, and the same with their names.

    What is not `found` was estimated beside the findings.
    """

    found: bool
    values: Array
    covariance: Array
    parameters: dict[str, Estimate]


@final
@dataclass(frozen=True, eq=False)
class Agreement:
    """Two estimates of one quantity, and whether they agree.

    Attributes:
        of: what, by codes: a `quantity` on which both domains depend; or `effect`, `site` and, of a nonparametric one,
            `driver`.
        estimates: by side: `poses` and `torques`, or `recording` and `reference`; None where a side does not show it.
        p_value: of a difference as large; None where a side does not show the quantity.
    """

    of: Mapping[str, str]
    estimates: Mapping[str, EffectEstimate | None]
    p_value: float | None

    @property
    def agree(self) -> bool | None:
        """Tells whether both say the same within their uncertainty; None where one of them says nothing."""
        return None if self.p_value is None else self.p_value >= DISAGREE

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers."""
        sides = {
            side: None
            if estimate is None
            else {"found": estimate.found, "parameters": {key: e._asdict() for key, e in estimate.parameters.items()}}
            for side, estimate in self.estimates.items()
        }
        return {**self.of, **sides, "p_value": self.p_value, "agree": self.agree}


def compare_estimates(
    of: Mapping[str, str], estimates: Mapping[str, EffectEstimate | None], sign: float = 1.0, compared: int = 1
) -> Agreement:
    """The comparison of two normal estimates, the second of `sign` over the first, as of `Agreement`.

    The p-value is family-wise over as many as are `compared`.
    """
    first, second = estimates.values()
    if first is None or second is None:
        return Agreement(of, estimates, None)
    off = first.values - sign * second.values
    together = first.covariance + second.covariance
    p_value = float(chdtrc(len(off), off @ np.linalg.pinv(together) @ off))
    return Agreement(of, estimates, min(1.0, compared * p_value))
