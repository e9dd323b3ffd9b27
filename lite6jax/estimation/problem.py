"""What an estimation problem is: residuals, columns of every term, nuisance with its prior, groups of noise, runs.

The engine knows nothing else of a domain. Rows are the numbers that a sample has; arrays have the sample last, and
residuals and columns are divided by the declared standard deviation of the noise.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, Self, TypeVar, final

import numpy as np

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.estimation.terms import Factored, Term, Terms

P = TypeVar("P", bound="LinearisedProblem")
_NEAR = 1 / 75
"""Standard deviations of a prior, within which columns are taken for the same."""


@final
@dataclass(frozen=True, eq=False)
class PeriodicFamily:
    """Terms that are sine and cosine of some order of an angle, at one site.

    Attributes:
        site: of its terms.
        column: `(row, sample)`, how residuals change with the site's deflection.
        angle: `(sample,)` rad.
        term: makes the term of one order.
        order: of one of its terms; None where the order is a number to be fitted.
        waves: sine and cosine `(order, 2, sample)` of orders `(order,)`, where a filter changes them; else plain ones.
        whole: whether whole orders are the likelier ones, as of what repeats with a turn.
        highest: order that the data resolve; None for that of the options.
    """

    site: str
    column: Array
    angle: Array
    term: Callable[[float], Term]
    order: Callable[[Term], float | None]
    waves: Callable[[Array], Array] | None = None
    whole: bool = True
    highest: float | None = None

    def columns(self, orders: Array) -> Array:
        """How residuals change with sine and cosine of each order, `(order, 2, row, sample)`."""
        return self.column * self.waves_of(orders)[:, :, None]

    def waves_of(self, orders: Array) -> Array:
        """Sine and cosine of each order, `(order, 2, sample)`."""
        if self.waves is not None:
            return self.waves(np.asarray(orders))
        turned = np.multiply.outer(orders, self.angle)
        return np.stack([np.sin(turned), np.cos(turned)], 1)


class Component(NamedTuple):
    """One way in which a site can move.

    Attributes:
        site: where.
        name: of the component; empty where a site has but one.
        column: `(row, sample)`, how residuals change with it.
        alike: others of the site whose columns are multiples of this one, to first order: fits tell them apart.
        prior: of one that is among these, its entry in the prior; empty where it has none.
        passed: functions `(…, sample)` as they show at this component where they vary fast; None where that is at once.
    """

    site: str
    name: str
    column: Array
    alike: "tuple[Component, ...]" = ()
    prior: str = ""
    passed: "Callable[[Array], Array] | None" = None

    @property
    def place(self) -> tuple[str, str]:
        """Its site and its name."""
        return self.site, self.name


class DriverValues(NamedTuple):
    """A driver of nonparametric effects.

    Attributes:
        driver: which.
        values: `(every sample,)`, before any filter.
        own: the sites that it mostly acts at; all where "" is among them. Of the order of recording those of read-outs
            that may wander by themselves.
        only: the one site where it can act; "" where that is any.
    """

    driver: Any
    values: Array
    own: frozenset[str]
    only: str = ""

    @property
    def bounds(self) -> tuple[float, float]:
        """The least and the greatest value; of the order of recording also where samples are left out."""
        if self.driver.is_order:
            return 0.0, 1.0
        return float(self.values.min()), float(self.values.max())


class LinearisedProblem(Protocol):
    """What a fit needs: residuals and their columns, linearised at zero nuisance.

    Attributes:
        rows: numbers that a sample has.
        samples: how many.
        groups: `(row,)` int, which group of noise a row belongs to; each has a scale and a noise model of its own.
        precision: `(number,)`, one over the variance of each nuisance number's prior; zero where there is none.
        offset: `(number,)`, how far the point of linearisation is from the prior's mean.
        preset: terms that the domain has estimated before the search, because they are too far from zero for the
            linearisation of a score test, and their numbers.
        floored: whether the noise is never less than declared, so that nothing is looked for below it: how a ball seats
            in its socket varies from sample to sample, like physics.
        curved: whether residuals are so far from linear in the nuisance and in terms that columns hold where they are
            taken alone, and what a term gains is known from its fit. Each number of the nuisance then has a prior.
    """

    @property
    def rows(self) -> int: ...
    @property
    def samples(self) -> int: ...
    @property
    def groups(self) -> Integers: ...
    @property
    def precision(self) -> Array: ...
    @property
    def offset(self) -> Array: ...
    @property
    def preset(self) -> tuple[Terms, Array]: ...
    @property
    def floored(self) -> bool: ...
    @property
    def curved(self) -> bool: ...

    def residual(self, nuisance: Array, terms: Terms, values: Array) -> Array:
        """Residuals `(row, sample)`, predicted minus measured, exact."""
        ...

    def columns(
        self, terms: Sequence[Term], values: Array | None = None, beside: tuple[Terms, Array] | None = None
    ) -> Array:
        """How residuals change with the numbers of terms, `(number, row, sample)`.

        Args:
            terms: any of this problem.
            values: `(number,)` at which derivatives are taken; zero where not given.
            beside: the terms of the model, and their numbers, that a term's own columns may depend on; `terms`
                themselves where not given.
        """
        ...

    def factored(self, term: Term) -> Factored | None:
        """The columns of a term as a `Factored`; None where they are no such products."""
        ...

    def nuisance_columns(self, terms: Terms, values: Array) -> Array:
        """How residuals change with each nuisance number, `(number, row, sample)`, beside the terms of a model.

        Args:
            terms: some numbers matter only beside some terms, as masses do beside a compliance.
            values: `(terms.size,)`.
        """
        ...

    def limits(self, term: Term) -> Sequence[tuple[float, float]]:
        """The least and the most that each number of a term can be in these data."""
        ...

    def relinearised(self, nuisance: Array, beside: tuple[Terms, Array] | None = None) -> Self:
        """The same problem about another nuisance, `(number,)` from here, and about terms with numbers where given."""
        ...


class Problem(LinearisedProblem, Protocol):
    """One estimation problem, with all that a search of it needs.

    Attributes:
        run: `(sample,)` int; noise is not correlated across a change.
        valid: `(sample,)` bool, the samples that may be used at all.
        informative: `(number,)` bool, of the nuisance, whether a prior states knowledge, so that it counts as evidence;
            otherwise it only fixes a gauge.
        declared: whether the noise that residuals are divided by is declared, and not assumed.
        candidates: the named terms that are testable with these data.
        periodic: families of periodic terms.
        shaped: named terms with a number in which they are not linear, each at a few of its values.
        components: where nonparametric terms can act.
        quantities: what they can depend on.
        every_run: `(2, every sample)`, the first and the last sample of each one's run, before any filter.
    """

    @property
    def run(self) -> Integers: ...
    @property
    def valid(self) -> Mask: ...
    @property
    def informative(self) -> Mask: ...
    @property
    def declared(self) -> bool: ...
    @property
    def candidates(self) -> tuple[Term, ...]: ...
    @property
    def periodic(self) -> tuple[PeriodicFamily, ...]: ...
    @property
    def shaped(self) -> tuple[Term, ...]: ...
    @property
    def components(self) -> tuple[Component, ...]: ...
    @property
    def quantities(self) -> tuple[DriverValues, ...]: ...
    @property
    def every_run(self) -> Integers: ...

    def process(
        self,
        component: Component,
        quantities: Sequence[DriverValues],
        kernel: str,
        spread: float,
        rolloff: tuple[float, ...] = (),
    ) -> Term:
        """The nonparametric term of a component, one quantity or two and a kernel of `effects.kernels`.

        Args:
            component: where.
            quantities: on what it depends.
            kernel: its name.
            spread: the prior's standard deviation of a coefficient.
            rolloff: its `numbers`.
        """
        ...

    def seen(self, functions: Array) -> Array:
        """Functions `(…, every sample)` as they reach the samples of this problem, through its filter if it has one."""
        ...

    def thinned(self, every: int) -> "Problem":
        """One in `every` samples."""
        ...

    def alternative(self, terms: Terms) -> "Problem | None":
        """The same problem under the other of two models of the inputs; None where these terms do not depend on it."""
        ...

    def inputs(self, terms: Terms) -> "Sequence[Term]":
        """The candidates that say that an input on which these terms depend is wrong, such as a load."""
        ...


class WanderingProblem(Problem, Protocol):
    """A problem whose quantities have the order of recording, in which read-outs may wander by themselves."""

    def with_nuisance(self, terms: Sequence[Term]) -> "WanderingProblem":
        """The same problem with the processes that read-outs do by themselves as nuisance, under their priors."""
        ...


class CurvedProblem(Problem, Protocol):
    """A problem whose residuals are curved: fits end in the nearest minimum, and begin where residuals are least."""

    def likeliest_start(self, term: Term, model: Terms, values: Array) -> Array:
        """The numbers from which the fit of a further term begins, `(term.size,)`: of a few those with least residuals.

        Args:
            term: which.
            model: beside which.
            values: `(model.size,)`.
        """
        ...


def linearised_at(problem: P, nuisance: Array) -> P:
    """The problem whose columns are those at a nuisance `(number,)` from its point of linearisation.

    The problem itself where columns hardly depend on the nuisance, or where that is near.
    """
    if not problem.curved or np.all(np.abs(nuisance) * np.sqrt(problem.precision) <= _NEAR):
        return problem
    return problem.relinearised(nuisance)


def contribution(problem: LinearisedProblem, terms: Terms, values: Array, beside: tuple[Terms, Array]) -> Array:
    """What terms of a model change of the residuals, `(row, sample)`: columns times numbers, of a curved problem exact.

    Args:
        problem: linearised at the model's nuisance.
        terms: some of the model.
        values: `(terms.size,)`.
        beside: the model, and its numbers.
    """
    if not problem.curved:
        return np.tensordot(values, problem.columns(terms.terms, values, beside), 1)
    model, numbers = beside
    without = model.part(numbers, [term not in terms.terms for term in model.terms])
    none = np.zeros(len(problem.precision))
    return problem.residual(none, model, numbers) - problem.residual(none, *without)


def prior_precision(problem: LinearisedProblem, terms: "Sequence[Term]") -> Array:
    """`(number,)`, one over the variance of each number's normal prior of zero mean; zero where there is none.

    Its variance is (l² + l u + u²) / 3, the mean square of a number that is equally likely anywhere within its limits
    [l, u] in these data, or the square of its `spread` where that is less. What the data determine is hardly changed by
    this, and what they leave open stays possible. A number without limits, or that cannot be zero, has no such prior.
    """
    spread = np.array([number.spread for term in terms for number in term.coordinates], float)
    limits = np.array([pair for term in terms for pair in problem.limits(term)], float).reshape(-1, 2)
    bounded = np.all(np.isfinite(limits), axis=1)
    lower, upper = np.where(bounded[:, None], limits, 0.0).T
    mean_square = np.where(bounded & (lower * upper <= 0), (lower**2 + lower * upper + upper**2) / 3, np.inf)
    return 1 / np.minimum(spread**2, mean_square)


def components_at(problem: Problem, site: str) -> list[Component]:
    """The components of a site, those alike among them."""
    return [one for component in problem.components if component.site == site for one in (component, *component.alike)]


def wave_of(problem: Problem, term: Term) -> tuple[PeriodicFamily, float] | None:
    """The family and the order of a term that is a wave of a fixed order; None of any other term."""
    for family in problem.periodic:
        if term.periodic and family.site == term.site and (order := family.order(term)) is not None:
            return family, order
    return None


def acts_on(problem: LinearisedProblem, term: Term, model: tuple[Terms, Array]) -> Mask:
    """`(row,)` bool, the rows that a term changes beside the terms of a model and their numbers."""
    return np.any(problem.columns([term], beside=model), axis=(0, 2))
