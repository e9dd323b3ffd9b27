"""An estimation problem without any robot: a linear regression with planted terms and groups of unequal noise."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lite6jax.effects.kernels import kernel_of
from lite6jax.estimation.problem import Component, DriverValues, PeriodicFamily
from lite6jax.estimation.terms import Factored, Terms


@dataclass(frozen=True)
class Number:
    typical: float = 1.0
    spread: float = np.inf
    lower: float = -np.inf
    upper: float = np.inf


@dataclass(frozen=True)
class Column:
    """A named term, proportional to one regressor."""

    name: str
    specificity: int = 1
    site: str = "x"
    periodic: bool = False
    usual: bool = False
    linear: bool = True
    nonparametric: bool = False
    chosen: float | None = None
    coordinates: tuple = (Number(),)
    includes: tuple = ()
    rivals: tuple = ()

    size = property(lambda self: len(self.coordinates))
    label = property(lambda self: f"{self.name}:{self.site}")
    drivers = property(lambda self: (Driver(self.name),))

    def basis(self, data):
        return data[self.name][None]


@dataclass(frozen=True)
class Wave:
    """Sine and cosine of an order of the angle."""

    order: float | None
    site: str = "wheel"
    specificity: int = 2
    periodic: bool = True
    usual: bool = False
    linear: bool = True
    nonparametric: bool = False
    includes: tuple = ()
    rivals: tuple = ()

    free = property(lambda self: self.order is None)
    chosen = property(lambda self: None if self.order in (None, 1.0) else self.order)
    coordinates = property(lambda self: (Number(),) * (2 if self.order else 3))
    size = property(lambda self: len(self.coordinates))
    label = property(lambda self: f"wave:{self.site}")
    drivers = property(lambda self: (Driver("angle"),))

    def released(self):
        return Wave(None)

    def held(self, number):
        return Wave(number)

    def basis(self, data, values=None):
        if self.order:
            turned = self.order * data["angle"]
            return np.stack([np.sin(turned), np.cos(turned)])
        s, c, order = (0, 0, 1) if values is None else values
        turned = order * data["angle"]
        slope = data["angle"] * (s * np.cos(turned) - c * np.sin(turned))
        return np.stack([np.sin(turned), np.cos(turned), slope])


@dataclass(frozen=True)
class Decay:
    """A named term that decays with the size of one regressor; the width at which it does is tried, or fitted."""

    name: str
    width: float | None
    site: str = "x"
    specificity: int = 4
    periodic: bool = False
    usual: bool = False
    linear: bool = True
    nonparametric: bool = False
    includes: tuple = ()
    rivals: tuple = ()

    free = property(lambda self: self.width is None)
    chosen = property(lambda self: self.width)
    coordinates = property(lambda self: (Number(),) if self.width else (Number(), Number(lower=0.0)))
    size = property(lambda self: len(self.coordinates))
    label = property(lambda self: f"decay of {self.name}:{self.site}")
    drivers = property(lambda self: (Driver(self.name),))

    def released(self):
        return replace(self, width=None)

    def held(self, number):
        return replace(self, width=number)

    def basis(self, data, values=None):
        u = data[self.name]
        size, width = (0.0, 1.0) if values is None else values
        column = np.exp(-((u / (self.width or width)) ** 2)) * np.sign(u)
        if self.width:
            return column[None]
        return np.stack([column, size * column * 2 * u**2 / width**3])


@dataclass(frozen=True)
class Driver:
    """A regressor, or the angle, as what a process depends on."""

    phrase: str

    quantity = property(lambda self: "position" if self.phrase == "angle" else self.phrase)
    generalised = quantity
    is_angle = is_remembered = property(lambda self: self.phrase == "angle")
    place = 0
    discrete = False
    is_order = is_time = False
    turns = ""


@dataclass(frozen=True)
class Turning(Driver):
    """A driver as above; the angle of the wheel counts the turns of its site."""

    turns = property(lambda self: "wheel" if self.phrase == "angle" else "")


@dataclass(frozen=True)
class Process:
    """A Gaussian process of one driver or of two."""

    site: str
    drivers: tuple
    bounds: tuple
    kernel: str = "smooth"
    spread: float = np.inf
    rolloff: tuple = ()
    component: str = ""
    specificity: int = 17
    periodic: bool = False
    usual: bool = False
    linear: bool = True
    nonparametric: bool = True
    chosen: float | None = None
    includes: tuple = ()
    rivals: tuple = ()

    coordinates = property(lambda self: (Number(1.0, self.spread),) * self.size)
    size = property(lambda self: kernel_of(self.kernel).size(self.bounds, self.rolloff))
    label = property(lambda self: f"process:{self.site}")
    phrases = property(lambda self: tuple(driver.phrase for driver in self.drivers))

    def basis(self, data):
        values = np.stack([data[phrase] for phrase in self.phrases])
        return np.asarray(kernel_of(self.kernel).features(values, self.bounds, data["every_run"], self.rolloff))


def is_free(term):
    """Whether the last of a term's numbers is one in which it is not linear."""
    return getattr(term, "free", False)


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """y = level + Σ terms + noise, rows of which each is a group with a scale and a noise model of its own.

    Each row has its share of what acts at the sites `x` and `wheel`: the second of two has half. What acts at `y`,
    whose own no driver is, has the same shares in the opposite order.
    """

    data: dict
    measured: np.ndarray
    candidates: tuple
    run: np.ndarray = None
    shares: tuple = (1.0, 0.5)
    shaped: tuple = ()
    offset: np.ndarray = 0.0
    preset: tuple = (Terms(), np.zeros(0))
    declared: bool = True
    floored: bool = False
    curved: bool = False

    rows = property(lambda self: len(self.shares))
    groups = property(lambda self: np.arange(self.rows))
    precision = property(lambda self: np.zeros(self.rows))
    informative = property(lambda self: np.zeros(self.rows, bool))
    samples = property(lambda self: self.measured.shape[1])
    valid = property(lambda self: np.ones(self.samples, bool))

    @cached_property
    def levels(self):
        """The level of each row, which nothing is known of."""
        return np.eye(self.rows)[:, :, None] * np.ones(self.samples)

    def __post_init__(self):
        object.__setattr__(self, "offset", np.broadcast_to(self.offset, self.rows))
        self.data["every_run"] = self.every_run

    @cached_property
    def every_run(self):
        same = self.run[:, None] == self.run
        return np.stack([np.argmax(same, 1), self.samples - 1 - np.argmax(same[:, ::-1], 1)])

    def _column(self, site):
        return np.outer(shares_at(site, self.shares), np.ones(self.samples))

    def columns(self, terms, values=None, beside=None):
        out, at = [np.zeros((0, self.rows, self.samples))], 0
        for term in terms:
            part = None if values is None else values[at : at + term.size]
            at += term.size
            basis = term.basis(self.data, part) if is_free(term) else term.basis(self.data)
            out.append(basis[:, None] * self._column(term.site))
        return np.concatenate(out)

    def residual(self, nuisance, terms, values):
        predicted = np.tensordot(self.offset + nuisance, self.levels, 1)
        for term, part in terms.pairs:
            basis = (term.held(values[part][-1]) if is_free(term) else term).basis(self.data)
            predicted = predicted + values[part][: len(basis)] @ basis * self._column(term.site)
        return predicted - self.measured

    def factored(self, term):
        return None if is_free(term) else Factored(self._column(term.site)[None], term.basis(self.data))

    def nuisance_columns(self, terms, values):
        return self.levels

    def relinearised(self, nuisance, beside=None):
        return replace(self, offset=self.offset + nuisance)

    @cached_property
    def components(self):
        return tuple(Component(site, "", self._column(site)) for site in ("x", "wheel", "y"))

    @cached_property
    def quantities(self):
        every = [name for name, values in self.data.items() if name != "every_run" and np.ptp(values)]
        own = {name: frozenset({"wheel" if name == "angle" else "x"}) for name in every}
        return tuple(DriverValues(Driver(name), self.data[name], own[name]) for name in every)

    def process(self, component, quantities, kernel, spread, rolloff=()):
        drivers = tuple(one.driver for one in quantities)
        bounds = tuple(bound for one in quantities for bound in one.bounds)
        return Process(component.site, drivers, bounds, kernel, spread, rolloff, component.name)

    def seen(self, functions):
        return functions

    def limits(self, term):
        return [(number.lower, number.upper) for number in term.coordinates]

    def thinned(self, every):
        data = {name: values[..., ::every] for name, values in self.data.items()}
        return replace(self, data=data, measured=self.measured[:, ::every], run=self.run[::every])

    def inputs(self, terms):
        return ()

    def alternative(self, terms):
        return None

    @cached_property
    def periodic(self):
        return (PeriodicFamily("wheel", self._column("wheel"), self.data["angle"], Wave, lambda term: term.order),)


def shares_at(site, shares):
    """The share of each row in what acts at a site."""
    return np.array(shares)[::-1] if site == "y" else np.array(shares)


def linear_problem(
    rng, samples=400, planted=None, noise=(1.0, 3.0), correlated=(0.0, 0.0), runs=1, shares=(1.0, 0.5), site="x"
):
    """A problem with regressors u1 … u6, an angle over several turns, and what `planted` adds at a site.

    Args:
        rng: of all that is random.
        samples: how many.
        planted: maps the data to `(sample,)`, of which each row has its share.
        noise: standard deviation of each row.
        correlated: first-order autoregressive coefficient of each row's noise.
        runs: into how many runs the samples are divided.
        shares: of each row.
        site: where what is planted acts.
    """
    data = {f"u{k}": rng.normal(size=samples) for k in range(1, 7)}
    data["angle"] = rng.uniform(-9.0, 9.0, samples)
    signal = np.zeros(samples) if planted is None else planted(data)
    white = rng.normal(size=(len(shares), samples))
    run = np.arange(samples) * runs // samples
    errors = np.empty_like(white)
    for row, (sigma, coefficient) in enumerate(zip(noise, correlated, strict=True)):
        for k in range(samples):
            first = k == 0 or run[k] != run[k - 1]
            before = 0.0 if first else coefficient * errors[row, k - 1]
            errors[row, k] = before + (1.0 if first else np.sqrt(1 - coefficient**2)) * white[row, k]
        errors[row] *= sigma
    levels = np.resize([5.0, -2.0], len(shares))
    measured = levels[:, None] + np.multiply.outer(shares_at(site, shares), signal) + errors
    candidates = (*(Column(f"u{k}") for k in range(1, 7)), Wave(1.0))
    return LinearProblem(data, measured, candidates, run=run, shares=tuple(shares))
