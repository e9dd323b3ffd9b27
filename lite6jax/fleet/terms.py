"""What the recordings of a type are tested for and what each costs.

Tested are names, waves of an angle and processes.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, cast, final

import numpy as np

from lite6jax.array_types import Array, Integers
from lite6jax.effects import kernels
from lite6jax.effects.drivers import Driver
from lite6jax.estimation.evidence import log_orders
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Component, DriverValues, Problem
from lite6jax.estimation.terms import Term
from lite6jax.search.scan import Scan

SPLINES = "splines"
CUBICS = "cubic*cubic"
"""What processes of one quantity and of two are screened by."""
_TYPICAL = 1e-4
"""Of a coefficient, in its unit; the same for all, so that it sets no more than the unit of their spread."""


@final
@dataclass(frozen=True)
class Candidate:
    """An effect that recordings are tested for, as a report names it; that of a family of waves has no order yet.

    Attributes:
        key: tells it from all others.
        effect: its name.
        site: where it acts.
        driver: what it depends on.
        names: of its numbers, with their units.
        typical: their common sizes.
        lower: the least that each can be; minus infinity where there is no bound.
        upper: the most.
        usual: whether nearly every arm has it.
    """

    key: str
    effect: str
    site: str
    driver: str
    names: tuple[str, ...]
    typical: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    usual: bool = False

    chosen: ClassVar[None] = None
    """As of a term: no number is chosen for a candidate."""


class PooledTerm(NamedTuple):
    """A candidate by its key, or a wave of a family.

    Attributes:
        key: of the candidate or of the family.
        order: of the wave; None of a candidate.
    """

    key: str
    order: float | None = None


@final
@dataclass(frozen=True)
class FleetProcess:
    """A Gaussian process of one driver or of two at a component of a site, over the ranges of all recordings.

    Attributes:
        site: where it acts.
        component: in which way; empty where a site has but one.
        unit: of what it adds.
        drivers: phrases of what it depends on.
        bounds: lower and upper of each driver.
        kernel: of `effects.kernels`, or `SPLINES`.
    """

    site: str
    component: str
    unit: str
    drivers: tuple[str, ...]
    bounds: tuple[float, ...]
    kernel: str

    @property
    def key(self) -> str:
        """The same for processes of the same drivers, whatever their kernel."""
        return f"unnamed:{self.site}:{self.component}:{' and '.join(self.drivers)}"

    @property
    def candidate(self) -> Candidate:
        """As a report names it."""
        count = kernels.kernel_of(self.kernel).size(self.bounds)
        names = tuple(f"coefficient{k + 1}_{self.unit}" for k in range(count))
        sizes = ((_TYPICAL,) * count, (-np.inf,) * count, (np.inf,) * count)
        return Candidate(self.key, "unnamed", self.site, " and ".join(self.drivers), names, *sizes)

    def functions(self, values: Array, run: Integers | None = None) -> Array:
        """Its functions `(function, moment)` at values `(driver, moment)`; `run` as of a `Motion`."""
        if self.kernel == SPLINES:
            lower, upper = self.bounds
            return np.asarray(kernels.spline_basis(cast(Any, values[0]), lower, upper))
        return np.asarray(kernels.kernel_of(self.kernel).features(cast(Any, values), self.bounds, cast(Any, run)))


Tested = PooledTerm | FleetProcess


class FleetComponent(NamedTuple):
    """A component at which processes can act, and the unit of what it adds."""

    site: str
    name: str
    unit: str


class Varied(NamedTuple):
    """A quantity of a recording.

    Attributes:
        driver: which.
        few: five of its values, from the least to the greatest.
        own: the sites that it mostly acts at; all where "" is among them.
        only: the one site where it can act; "" where that is any.
    """

    driver: Driver
    few: tuple[float, ...]
    own: frozenset[str]
    only: str = ""

    @classmethod
    def of(cls, quantity: DriverValues) -> "Varied":
        """What a recording says of one of its quantities."""
        quantiles = np.quantile(quantity.values, np.linspace(0, 1, 5), method="nearest")
        return cls(quantity.driver, tuple(quantiles.tolist()), quantity.own, quantity.only)


@final
class Tried:
    """All that the recordings of a type are tested for.

    Attributes:
        named: the candidates by key.
        families: of waves, by key.
        components: where processes can act, without columns.
        quantities: what they can depend on, with a few values of each recording.
    """

    def __init__(self, recordings: Iterable[Any], options: EngineOptions) -> None:
        """What one of the recordings can be tested for at least, by their headings."""
        self.named = dict[str, Candidate]()
        self.families = dict[str, Candidate]()
        self._options = options
        places = dict[FleetComponent, None]()
        varied = dict[str, DriverValues]()
        for heading in recordings:
            self.named |= {
                candidate.key: candidate for candidate in heading.candidates if candidate.key not in self.named
            }
            self.families |= {family.key: family for family in heading.families if family.key not in self.families}
            places |= dict.fromkeys(heading.places)
            for driver, sample_values, sites, only in heading.quantities:
                quantity = varied.setdefault(driver.phrase, DriverValues(driver, np.zeros(0), sites, only))
                varied[driver.phrase] = quantity._replace(values=np.concatenate([quantity.values, sample_values]))
        self._places = tuple(places)
        self._place_of = {phrase: k for k, phrase in enumerate(varied)}
        self.components = tuple(Component(place.site, place.name, np.zeros((0, 0))) for place in places)
        self.quantities, self.candidates, self.shaped = tuple(varied.values()), tuple(self.named.values()), ()
        self._scan = Scan(cast(Problem, self), options)  # of a problem, costs need no more than is here

    @cached_property
    def singles(self) -> tuple[FleetProcess, ...]:
        """Splines of each quantity at each component where it can act."""
        count = range(len(self.quantities))
        may_act = self._scan.may_act
        return tuple(
            self._process(place, SPLINES, k) for place in self._places for k in count if may_act(place.site, k)
        )

    @cached_property
    def pairs(self) -> tuple[FleetProcess, ...]:
        """Products of two cubics of each pair of a site's own quantities, one of few values last."""
        processes = []
        for place in self._places:
            indices = sorted(self._scan.own[place.site], key=lambda k: self._scan.discrete[k])
            pairs = ((j, k) for n, j in enumerate(indices) for k in indices[n + 1 :])
            processes += [
                self._process(place, CUBICS, *pair) for pair in pairs if self._scan.may_act(place.site, *pair)
            ]
        return tuple(processes)

    def with_every_kernel(self, process: FleetProcess) -> list[FleetProcess]:
        """The processes of the same quantities at the same component."""
        quantity_indices = tuple(self._place_of[phrase] for phrase in process.drivers)
        names = kernels.SINGLE if len(quantity_indices) == 1 else kernels.PAIRS
        return [replace(process, kernel=name) for name in names if self._scan.suits(name, quantity_indices)]

    def candidate(self, term: Tested) -> Candidate:
        """A term as a report names it."""
        if isinstance(term, FleetProcess):
            return term.candidate
        if term.order is not None:
            return self.families[term.key]
        return self.named[term.key]

    def cost(self, term: Tested) -> float:
        """−ln of the prior probability of a term, as in the search of one recording."""
        if isinstance(term, FleetProcess):
            return self._scan.cost_of_process(term.site, tuple(self._place_of[phrase] for phrase in term.drivers))
        if term.order is not None:
            return float(self.cost_of_waves(np.array(term.order)))
        return self._scan.cost_of_name(cast(Term, self.named[term.key]))

    def cost_of_waves(self, orders: Array) -> Array:
        """Cost of a wave of each order `(order,)` of one family."""
        return self._options.prior.cost("wave") + np.log(max(len(self.families), 1)) + log_orders(orders, self._options)

    def _process(self, place: FleetComponent, kernel: str, *indices: int) -> FleetProcess:
        quantities = [self.quantities[k] for k in indices]
        bounds = tuple(bound for quantity in quantities for bound in quantity.bounds)
        return FleetProcess(*place, tuple(quantity.driver.phrase for quantity in quantities), bounds, kernel)
