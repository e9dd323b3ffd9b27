"""Among how many candidates a term was chosen: the factor of its family-wise p-value, and its cost in log-likelihood.

Every candidate has a weight, its prior probability, and its p-value is divided by that weight: the family-wise level
holds as the weights add up to one (weighted Bonferroni; C. R. Genovese, K. Roeder, L. Wasserman, Biometrika 93, 2006).
Candidates weigh the same, but for the orders of one angle. The prior density of an order falls as 1/order, that of a
quantity whose scale is not known (H. Jeffreys, Theory of Probability, 3.1), and a whole order is likelier than those
around it: an eccentric shaft is likelier than a tooth. Of orders that are the same wave at every sample, as 2 and 178
are at angles that are multiples of 2°, this prior chooses the lowest.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.terms import Term

Array = NDArray[np.floating]


def searched_size(problem: Problem, options: EngineOptions) -> float:
    """The effective number of candidates in a search: the factor of every p-value but that of a wave."""
    single = len(problem.candidates) + len(problem.flexible)
    return single + len(problem.periodic) * options.searched_orders + len(problem.curves) * options.searched_curves


def multiplicity(problem: Problem, term: Term, options: EngineOptions) -> float:
    """The factor by which the p-value of a term becomes family-wise."""
    return searched_size(problem, options) * relative_multiplicity(term, options)


def relative_multiplicity(term: Term, options: EngineOptions) -> float:
    """The multiplicity of a term over that of a term without an order, or of an order that has a name of its own."""
    if not term.periodic or term.chosen is None:
        return 1.0
    return float(np.exp(log_orders(term.chosen, options))) / options.searched_orders


def log_orders(order: ArrayLike, options: EngineOptions, whole: bool = True) -> Array:
    """The logarithm of the number of orders that each order counts as the best of: less for one that is likelier.

    That is the number of independent orders per order over the prior density; of a whole order, one over its prior
    probability.

    Args:
        order: `(order,)`, in waves per turn.
        options: thresholds.
        whole: whether whole orders are the likelier ones.
    """
    order = np.maximum(np.asarray(order, float), options.lowest_order)
    highest, share = options.highest_order, options.whole_share if whole else 0.0
    between = np.log(options.resolved_orders * order * np.log(highest) / (1 - share))
    if not share:
        return between
    inverse = float(np.sum(1 / np.arange(1, highest + 0.5)))
    return np.where(order % 1 == 0, np.log(order * inverse / share), between)


def description_length(terms: Sequence[Term], n: float, options: EngineOptions) -> float:
    """What a set of terms costs in log-likelihood: ½ log n a number, and the choice of an order or a shape among many.

    Schwarz's approximation (Annals of Statistics 6, 1978).

    Args:
        terms: of a model.
        n: readings, or residual degrees of freedom.
        options: thresholds.
    """
    orders = [term.chosen for term in terms if term.periodic and term.chosen is not None]
    shapes = sum((term.chosen is not None) + term.nonparametric for term in terms) - len(orders)
    numbers = sum(term.size + (term.chosen is not None) for term in terms)
    choices = float(np.sum(log_orders(orders, options))) + shapes * np.log(options.searched_shapes)
    return float(0.5 * numbers * np.log(n) + choices)
