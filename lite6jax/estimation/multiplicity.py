"""Among how many candidates a term was chosen: the factor of its family-wise p-value, and its cost in log-likelihood.

Every candidate has a weight, its prior probability, and its p-value is divided by that weight: the family-wise level
holds as the weights add up to one (weighted Bonferroni; C. R. Genovese, K. Roeder, L. Wasserman, Biometrika 93, 2006).
Candidates weigh the same, but for functions that are rare, which add a twentieth, and for the orders of one angle.
The prior density of an order falls as 1/order, that of a quantity whose scale is not known (H. Jeffreys, Theory of
Probability, 3.1), and a whole order is likelier than those around it: an eccentric shaft is likelier than a tooth. Of
orders that are the same wave at every sample, as 2 and 178 are at angles that are multiples of 2°, this prior chooses
the lowest.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import PeriodicFamily, Problem, wave_of
from lite6jax.estimation.terms import Term

Array = NDArray[np.floating]

_UNIFORM = 2 * np.pi / np.sqrt(12)
"""rad, the standard deviation of an angle that is spread evenly over a turn."""


def searched_size(problem: Problem, options: EngineOptions) -> float:
    """The effective number of candidates in a search: the factor of every p-value but that of a wave."""
    single = len(problem.candidates) + len(problem.shaped) + problem.functions_tried
    return single + len(problem.periodic) * options.searched_orders + len(problem.curves) * options.searched_curves


def multiplicity(problem: Problem, term: Term, options: EngineOptions) -> float:
    """The factor by which the p-value of a term becomes family-wise."""
    searched, found = searched_size(problem, options) * np.exp(options.rare * term.rare), wave_of(problem, term)
    return searched if found is None else searched * relative_multiplicity(log_orders_of(*found, options), options)


def relative_multiplicity(log_order: ArrayLike, options: EngineOptions) -> float:
    """The multiplicity of a wave over that of another term, by `log_orders` of its order."""
    return float(np.exp(log_order)) / options.searched_orders


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


def description_length(problem: Problem, terms: Sequence[Term], n: float, options: EngineOptions) -> float:
    """What a set of terms costs in log-likelihood: ½ log n a number, and the choice of an order or a shape among many.

    Schwarz's approximation (Annals of Statistics 6, 1978). Orders that have names of their own, as 1 and 2 may have,
    are not a choice.

    Args:
        problem: the data.
        terms: of a model.
        n: readings, or residual degrees of freedom.
        options: thresholds.
    """
    waves = [wave_of(problem, term) for term in terms if term.chosen is not None]
    orders = [found for found in waves if found is not None]
    shapes = sum(term.chosen is not None for term in terms) - len(orders)
    numbers = sum(term.size + (term.chosen is not None) for term in terms)
    choices = sum(float(log_orders_of(*found, options)) for found in orders) + shapes * np.log(options.searched_shapes)
    choices += sum(log_functions(problem, term, options) for term in terms if term.nonparametric)
    return float(0.5 * numbers * np.log(n) + choices)


def log_functions(problem: Problem, function: Term, options: EngineOptions) -> float:
    """What the choice of a function without a name costs in log-likelihood: more for one that is rare.

    That is the logarithm of the number of functions that it is chosen from, parts of them included.
    """
    number = max(options.searched_shapes, problem.functions_tried)
    return float(np.log(number)) + options.rare * function.rare
