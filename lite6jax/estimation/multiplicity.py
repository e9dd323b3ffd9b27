"""Among how many candidates a term was chosen: the factor of its family-wise p-value, and its cost in log-likelihood.

Every candidate has a weight, its prior probability, and its p-value is divided by that weight: the family-wise level
holds as the weights add up to one (weighted Bonferroni; C. R. Genovese, K. Roeder, L. Wasserman, Biometrika 93, 2006).
Candidates weigh the same, but for functions that are rare, which add a twentieth, and for the orders of one angle.
The prior density of an order falls as 1/order, that of a quantity whose scale is not known (H. Jeffreys, Theory of
Probability, 3.1), and a whole order is likelier than those around it: an eccentric shaft is likelier than a tooth. Of
orders that are the same wave at every sample, as 2 and 178 are at angles that are multiples of 2°, this prior chooses
the lowest.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import PeriodicFamily

Array = NDArray[np.floating]

_UNIFORM = 2 * np.pi / np.sqrt(12)
"""rad, the standard deviation of an angle that is spread evenly over a turn."""


def log_orders_of(family: PeriodicFamily, order: ArrayLike, options: EngineOptions) -> Array:
    """`log_orders` of the orders of a family."""
    turns = max(float(np.std(family.angle)) / _UNIFORM, 1.0)
    return log_orders(order, options, family.whole, family.highest, turns)


def log_orders(
    order: ArrayLike, options: EngineOptions, whole: bool = True, highest: float | None = None, turns: float = 1.0
) -> Array:
    """The logarithm of the number of orders that each order counts as the best of: less for one that is likelier.

    That is the number of independent orders per order over the prior density; of a whole order, one over its prior
    probability. Independent orders are the more, the farther the angles spread (R. V. Baluev, Monthly Notices of the
    Royal Astronomical Society 385, 2008).

    Args:
        order: `(order,)`, in waves per turn.
        options: thresholds.
        whole: whether whole orders are the likelier ones.
        highest: order that is searched; that of the options where not given.
        turns: spread of the angles over that of an even full turn, at least 1.
    """
    order, highest = np.asarray(order, float), highest or options.highest_order
    share, at = options.whole_share if whole else 0.0, np.maximum(order, options.lowest_order)
    between = np.log(options.resolved_orders * turns * at * np.log(highest) / (1 - share))
    if not share:
        return between
    inverse = float(np.sum(1 / np.arange(1, highest + 0.5)))
    return np.where(order % 1 == 0, np.log(at * inverse / share), between)
