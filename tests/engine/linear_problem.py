"""An estimation problem without any robot: a linear regression with planted terms and groups of unequal noise."""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from lite6jax.estimation.factored import Factored
from lite6jax.estimation.problem import LOCAL_FORMS, CurveDriver, CurveFamily, PeriodicFamily
from lite6jax.estimation.terms import Terms


class Part(NamedTuple):
    """A function that another one contains."""

    numbers: tuple
    made: object


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
    rare: bool = False
    usual: bool = False
    nonparametric: bool = False
    shrunk: bool = False
    chosen: float | None = None
    coordinates: tuple = (Number(),)
    includes: tuple = ()

    size = property(lambda self: len(self.coordinates))
    label = property(lambda self: f"{self.name}:{self.site}")
    drivers = property(lambda self: (self.name,))

    def basis(self, data):
        return data[self.name][None]


@dataclass(frozen=True)
class Wave:
    """Sine and cosine of an order of the angle."""

    order: float | None
    site: str = "wheel"
    specificity: int = 2
    periodic: bool = True
    rare: bool = False
    usual: bool = False
    nonparametric: bool = False
    shrunk: bool = False
    includes: tuple = ()
    parts: tuple = ()
    finer: tuple = ()

    free = property(lambda self: self.order is None)
    chosen = property(lambda self: None if self.order in (None, 1.0) else self.order)
    coordinates = property(lambda self: (Number(),) * (2 if self.order else 3))
    size = property(lambda self: len(self.coordinates))
    label = property(lambda self: f"wave:{self.site}")
    drivers = ("angle",)

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
    rare: bool = False
    usual: bool = False
    nonparametric: bool = False
    shrunk: bool = False
    includes: tuple = ()
    parts: tuple = ()
    finer: tuple = ()

    free = property(lambda self: self.width is None)
    chosen = property(lambda self: self.width)
    coordinates = property(lambda self: (Number(),) if self.width else (Number(), Number(lower=0.0)))
    size = property(lambda self: len(self.coordinates))
    label = property(lambda self: f"decay of {self.name}:{self.site}")
    drivers = property(lambda self: (self.name,))

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
class Hat:
    """A piecewise linear curve over the angle, or a sum of waves of it."""

    lower: float
    upper: float
    pieces: int
    orders: tuple = ()
    spread: float = np.inf
    site: str = "wheel"
    specificity: int = 9
    periodic: bool = False
    rare: bool = False
    usual: bool = False
    nonparametric: bool = True
    chosen: float | None = None
    includes: tuple = ()
    parts: tuple = ()
    finer: tuple = ()

    shrunk = property(lambda self: np.isfinite(self.spread))
    size = property(lambda self: 2 * len(self.orders) or self.pieces + 1)
    coordinates = property(lambda self: (Number(1.0, self.spread),) * self.size)
    label = property(lambda self: f"curve:{self.site}")
    drivers = ("angle",)

    def basis(self, data):
        if self.orders:
            return np.concatenate([Wave(order).basis(data) for order in self.orders])
        knots = np.linspace(self.lower, self.upper, self.pieces + 1)
        return np.stack([np.interp(data["angle"], knots, hat) for hat in np.eye(len(knots))])


@dataclass(frozen=True)
class Curve:
    """A polynomial in one regressor, which contains those of lower degrees unless it says otherwise."""

    over: str
    site: str = "x"
    degree: int = 3
    contains: bool = True
    finest: int = 0
    specificity: int = 9
    periodic: bool = False
    rare: bool = False
    usual: bool = False
    nonparametric: bool = True
    shrunk: bool = False
    chosen: float | None = None
    includes: tuple = ()

    coordinates = property(lambda self: (Number(),) * self.degree)
    size = property(lambda self: self.degree)
    finer = property(lambda self: (replace(self, degree=self.finest),) if self.degree < self.finest else ())
    parts = property(lambda self: [self.part(n) for n in range(1, self.degree) if self.contains])
    label = property(lambda self: f"curve:{self.over}")
    drivers = property(lambda self: (self.over,))

    def part(self, degree):
        return Part(tuple(range(degree)), partial(replace, self, degree=degree))

    def basis(self, data):
        return np.stack([data[self.over] ** power for power in range(1, self.degree + 1)])


def is_free(term):
    """Whether the last of a term's numbers is one in which it is not linear."""
    return getattr(term, "free", False)


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """y = level + Σ terms + noise, rows of which each is a group with a scale and a noise model of its own.

    Each row has its share of every regressor: the second of two has half.
    """

    data: dict
    measured: np.ndarray
    candidates: tuple
    run: np.ndarray = None
    shares: tuple = (1.0, 0.5)
    ladder: tuple = ()
    shaped: tuple = ()
    offset: np.ndarray = 0.0
    preset: tuple = (Terms(), np.zeros(0))
    declared: bool = True

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

    def _rows(self, basis):
        return np.multiply(basis[:, None], np.array(self.shares)[:, None])

    def columns(self, terms, values=None, beside=None):
        out, at = [np.zeros((0, self.rows, self.samples))], 0
        for term in terms:
            part = None if values is None else values[at : at + term.size]
            at += term.size
            out.append(self._rows(term.basis(self.data, part) if is_free(term) else term.basis(self.data)))
        return np.concatenate(out)

    def residual(self, nuisance, terms, values):
        predicted = np.tensordot(self.offset + nuisance, self.levels, 1)
        for term, part in zip(terms.terms, terms.slices, strict=True):
            basis = (term.held(values[part][-1]) if is_free(term) else term).basis(self.data)
            numbers = values[part][: len(basis)]
            predicted = predicted + np.tensordot(numbers, self._rows(basis), 1)
        return predicted - self.measured

    @cached_property
    def _site(self):
        return np.outer(self.shares, np.ones(self.samples))[None]

    def factored(self, term):
        return None if is_free(term) else Factored(self._site, term.basis(self.data))

    def nuisance_columns(self, terms, values):
        return self.levels

    def relinearised(self, nuisance):
        return replace(self, offset=self.offset + nuisance)

    @cached_property
    def flexible(self):
        """Functions of the regressors and of the angle; named regressors are the special case of a straight line."""
        angle = self.data["angle"]
        curves = [Curve(f"u{k}") for k in range(1, 7)]
        return (*curves, Hat(float(angle.min()), float(angle.max()), 6))

    functions_tried = property(lambda self: sum(1 + len(term.parts) for term in self.flexible))

    def limits(self, term):
        return [(number.lower, number.upper) for number in term.coordinates]

    def without_candidates(self, terms):
        return replace(self, candidates=tuple(term for term in self.candidates if term not in terms))

    def thinned(self, every):
        data = {name: values[::every] for name, values in self.data.items()}
        return replace(self, data=data, measured=self.measured[:, ::every], run=self.run[::every])

    def inputs(self, terms):
        return ()

    def alternative(self, terms):
        return None

    def undetermined(self, term):
        return np.zeros(self.samples, bool)

    def shrinkable(self, term):
        return not term.periodic

    @cached_property
    def periodic(self):
        angle = self.data["angle"]
        column = np.multiply.outer(self.shares, np.ones(self.samples))

        def curve(orders, training, spread, fade):
            return Hat(angle.min(), angle.max(), 1, tuple(orders), np.inf if spread is None else spread)

        return (PeriodicFamily("wheel", column, angle, Wave, lambda term: term.order, curve),)

    @cached_property
    def curves(self):
        column = np.multiply.outer(self.shares, np.ones(self.samples))
        return (CurveFamily("wheel", column, (CurveDriver(self.data["angle"], (8,), LOCAL_FORMS, Hat),)),)


def linear_problem(rng, samples=400, planted=None, noise=(1.0, 3.0), correlated=(0.0, 0.0), runs=1, shares=(1.0, 0.5)):
    """A problem with regressors u1 … u6, an angle over several turns, and what `planted` adds to the first row.

    Args:
        rng: of all that is random.
        samples: how many.
        planted: maps the data to `(sample,)`, of which each row has its share.
        noise: standard deviation of each row.
        correlated: first-order autoregressive coefficient of each row's noise.
        runs: into how many runs the samples are divided.
        shares: of each row.
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
    measured = levels[:, None] + np.multiply.outer(shares, signal) + errors
    candidates = (*(Column(f"u{k}") for k in range(1, 7)), Wave(1.0))
    return LinearProblem(data, measured, candidates, run=run, shares=tuple(shares))
