"""What the recordings of a type are tested for: names, waves of an angle and Gaussian processes, and what each costs."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple, Protocol, cast, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.effects import kernels
from lite6jax.estimation.multiplicity import log_orders
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import Component, Problem, Quantity
from lite6jax.estimation.terms import Term
from lite6jax.search.scan import KINDS, PAIRS, SINGLE, Scan

Array = NDArray[np.floating]

_TYPICAL = 1e-4
"""Of a coefficient, in its unit; the same for all, so that it sets no more than the unit of their spread."""
_QUARTERS = np.linspace(0, 1, 5)


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

    @classmethod
    def of(cls, stored: Mapping[str, Any]) -> "Candidate":
        """From the JSON form of `asdict`."""
        lists = {name: tuple(stored[name]) for name in ("names", "typical", "lower", "upper")}
        return cls(**{**stored, **lists})


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
class Process:
    """A Gaussian process of one driver or of two at a component of a site, over the ranges of all recordings.

    Attributes:
        site: where it acts.
        component: in which way; empty where a site has but one.
        unit: of what it adds.
        drivers: phrases of what it depends on.
        bounds: lower and upper of each driver.
        kernel: of `effects.kernels`.
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
        count = kernels.size_of(self.kernel, self.bounds)
        names = tuple(f"coefficient{k + 1}_{self.unit}" for k in range(count))
        sizes = ((_TYPICAL,) * count, (-np.inf,) * count, (np.inf,) * count)
        return Candidate(self.key, "unnamed", self.site, " and ".join(self.drivers), names, *sizes)


Tested = PooledTerm | Process


class Groups(NamedTuple):
    """Processes as workers screen them; places are those in lists of all recordings.

    Attributes:
        components: site and name of each.
        drivers: the phrase of each quantity.
        bounds: `(quantity, 2)`, over all recordings.
        singles: `(group, 2)`, component and quantity.
        pairs: `(group, 3)`, component and quantities.
    """

    components: tuple[tuple[str, str], ...]
    drivers: tuple[str, ...]
    bounds: Array
    singles: NDArray[np.integer]
    pairs: NDArray[np.integer]


class Described(Protocol):
    """What a recording says of what it can be tested for: a `ReducedArm` or the `Heading` of its file."""

    @property
    def candidates(self) -> tuple[Candidate, ...]: ...
    @property
    def families(self) -> tuple[Candidate, ...]: ...
    @property
    def components(self) -> tuple[Component, ...]: ...
    @property
    def units(self) -> tuple[str, ...]: ...
    @property
    def quantities(self) -> tuple[Quantity, ...]: ...


def quarters(quantity: Quantity) -> Quantity:
    """The same with five of its values, from the least to the greatest: they tell its range, and whether it has few."""
    return quantity._replace(values=np.quantile(quantity.values, _QUARTERS, method="nearest"))


@final
@dataclass(frozen=True, eq=False)
class Tried:
    """All that some recordings of a type are tested for.

    Attributes:
        named: the candidates by key.
        families: of waves, by key.
        places: the component of each site and name, without a column, and its unit.
        measured: the quantities by phrase, with a few values of each recording.
        options: thresholds.
    """

    named: Mapping[str, Candidate] = field(default_factory=dict)
    families: Mapping[str, Candidate] = field(default_factory=dict)
    places: Mapping[tuple[str, str], tuple[Component, str]] = field(default_factory=dict)
    measured: Mapping[str, Quantity] = field(default_factory=dict)
    options: EngineOptions = field(default_factory=EngineOptions)

    @classmethod
    def of(cls, recordings: Iterable[Described], options: EngineOptions) -> "Tried":
        """What one of them can be tested for at least."""
        named, families = dict[str, Candidate](), dict[str, Candidate]()
        places, measured = dict[tuple[str, str], tuple[Component, str]](), dict[str, list[Quantity]]()
        for one in recordings:
            named |= {each.key: each for each in one.candidates if each.key not in named}
            families |= {each.key: each for each in one.families if each.key not in families}
            for component, unit in zip(one.components, one.units, strict=True):
                places.setdefault(component[:2], (component._replace(column=np.zeros((0, 0))), unit))
            for quantity in one.quantities:
                measured.setdefault(quantity.driver.phrase, []).append(quarters(quantity))
        pooled = {
            phrase: each[0]._replace(values=np.concatenate([one.values for one in each]))
            for phrase, each in measured.items()
        }
        return cls(named, families, places, pooled, options)

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """Those with a name."""
        return tuple(self.named.values())

    @property
    def components(self) -> tuple[Component, ...]:
        """Where processes can act."""
        return tuple(component for component, _ in self.places.values())

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What they can depend on."""
        return tuple(self.measured.values())

    @property
    def shaped(self) -> tuple[Term, ...]:
        """None: what is tried at a few values in one recording has a candidate with one of them."""
        return ()

    @cached_property
    def _scan(self) -> Scan:
        return Scan(cast(Problem, self), self.options)  # of a problem, costs need no more than is here

    def candidate(self, term: Tested) -> Candidate:
        """A term as a report names it."""
        if isinstance(term, Process):
            return term.candidate
        return self.families[term.key] if term.order is not None else self.named[term.key]

    def cost(self, term: Tested) -> float:
        """−ln of the prior probability of a term, as in the search of one recording."""
        if isinstance(term, Process):
            which = tuple([*self.measured].index(phrase) for phrase in term.drivers)
            return self._scan.cost_of_process(term.site, which)
        if term.order is not None:
            return self.cost_of_waves(np.array(term.order)).item()
        return self._scan.cost_of_name(cast(Term, self.named[term.key]))

    def cost_of_waves(self, orders: Array) -> Array:
        """Of a wave of each order `(order,)` of one family."""
        return KINDS + np.log(max(len(self.families), 1)) + log_orders(orders, self.options)

    @cached_property
    def groups(self) -> Groups:
        """Each quantity that can act at a component, and each pair of a site's own."""
        scan, count = self._scan, range(len(self.quantities))
        singles, pairs = [], []
        for i, component in enumerate(self.components):
            singles += [(i, k) for k in count if scan.may_act(component.site, k)]
            own = [k for k in scan.own[component.site] if scan.may_act(component.site, k)]
            own.sort(key=lambda k: scan.discrete[k])
            pairs += [(i, j, k) for n, j in enumerate(own) for k in own[n + 1 :]]
        return Groups(
            tuple(component[:2] for component in self.components),
            tuple(self.measured),
            np.array([quantity.bounds for quantity in self.quantities]).reshape(-1, 2),
            np.array(singles, int).reshape(-1, 2),
            np.array(pairs, int).reshape(-1, 3),
        )

    def cost_of_group(self, component: int, *which: int) -> float:
        """As `cost`, of a process of some quantities at a component."""
        return self._scan.cost_of_process(self.components[component].site, which)

    def processes(self, component: int, *which: int) -> list[Process]:
        """Every kernel of some quantities at a component."""
        place, unit = [*self.places.values()][component]
        own = [self.quantities[k] for k in which]
        phrases, bounds = tuple(one.driver.phrase for one in own), tuple(b for one in own for b in one.bounds)
        names = [name for name in (SINGLE if len(which) == 1 else PAIRS) if self._scan.suits(name, which)]
        return [Process(place.site, place.name, unit, phrases, bounds, name) for name in names]
