"""One recording reduced to what pooling needs: white residuals and the columns of what is tested, without a robot.

A recording is diagnosed once, where its problem and its noise model are at hand. What is kept of it is linear: then any
set of effects that the type is found to have is fitted to it by linear algebra alone, without the files, the kinematics
and compiled code.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.torque.filtering import LowPass
from lite6jax.effects import kernels
from lite6jax.estimation.noise import NoiseModel
from lite6jax.estimation.problem import Component, Quantity
from lite6jax.estimation.projection import orthonormal, outside, unit_rows
from lite6jax.estimation.score_test import block_covariance, sums_by_block
from lite6jax.populations.options import PoolingOptions
from lite6jax.populations.terms import Candidate, Groups, PooledTerm, Process, Tested

Array = NDArray[np.floating]
Integers = NDArray[np.integer]

SCREENED = ("cubic", "medium", "rough")
"""Kernels of one driver by which processes are screened."""
VARIANCES = np.geomspace(1e-14, 1e4, 55)
"""Of coefficients in their unit, at which the evidence of processes that are others in each arm is screened."""
_PAIR = "cubic*cubic"
_ORDERS_AT_ONCE = 1 << 21
"""Numbers of columns that are in memory at once: 16 MB."""


def readings(columns: Array, noise: NoiseModel, training: NDArray[np.bool_], number: int) -> Array:
    """Columns of a recording as those of all its readings: whitened; zero at samples that are not fitted.

    Args:
        columns: `(…, row, sample)`, of unit noise.
        noise: the filter that makes them white.
        training: `(sample,)`, which samples are fitted.
        number: of readings; those of the prior come after all samples.

    Returns:
        `(…, number)`.
    """
    white = noise.whitened(columns) * training
    *which, rows, samples = white.shape
    found = np.zeros((*which, number))
    found[..., : rows * samples] = white.reshape(*which, rows * samples)
    return found


@final
@dataclass(frozen=True)
class Found:
    """What the diagnosis of the recording alone found.

    Attributes:
        label: its name and site.
        p_value: family-wise, over all that was searched in the recording.
        pooled: whether it is part of the residual again, and so of what is pooled.
    """

    label: str
    p_value: float
    pooled: bool


class Evidence(NamedTuple):
    """What a recording says of one effect beside others, as a likelihood that is normal in its numbers.

    Attributes:
        score: `(number,)`, the derivative of the log-likelihood at zero.
        information: `(number, number)`, minus its second derivative.
        covariance: `(number, number)` of the score, by the scatter between blocks of samples.
        left: the sum of squares that is left without it.
        freedom: its degrees of freedom.
    """

    score: Array
    information: Array
    covariance: Array
    left: float
    freedom: float


class Screened(NamedTuple):
    """What a recording says of many processes.

    Attributes:
        score: `(group, function)`.
        information: `(group, function, function)`.
        explained: `(group, kernel, variance)`, of the sum of squares by coefficients of each of `VARIANCES`.
        volume: likewise, by which the evidence is less than the likelihood's gain.
        alone: `(group,)`, the evidence of this recording.
    """

    score: Array
    information: Array
    explained: Array
    volume: Array
    alone: Array


class Scan(NamedTuple):
    """What a recording says of all that is tested.

    Attributes:
        named: of each candidate by its key; None where it says nothing.
        waves: by the key of each family, score `(order, 2)` and, as sine², sine·cosine and cosine², information
            `(order, 3)` at the orders of `order_grid`.
        singles, pairs: of the `Groups`; functions are splines, and products of two cubics.
        left, freedom: as in `Evidence`.
    """

    named: dict[str, Evidence | None]
    waves: dict[str, tuple[Array, Array]]
    singles: Screened
    pairs: Screened
    left: float
    freedom: float


@final
@dataclass(frozen=True, eq=False)
class ReducedArm:
    """The linear model of one recording; readings are all rows of all samples, and then those of the nuisance's prior.

    Attributes:
        about: of the recording: `what` was measured ("poses" or "torques"), `arm`, `joints`, `rows`, `date`, `verdict`.
        found: by the recording alone.
        candidates: that can be tested here.
        columns: `(number, reading)`, white, of unit noise, of all candidates one after the other.
        families: of waves, each of an angle that is one of the quantities.
        components: where processes can act; columns of unit noise, not white.
        units: of what acts at each.
        quantities: what they can depend on, at every moment: at the samples, unless there is a `smoothing`.
        run: `(2, moment)`, the first and the last moment of the run of each.
        noise: the filter that makes columns white.
        training: `(sample,)` bool.
        basis: `(k, reading)`, orthonormal, the span of the nuisance and of effects that are not pooled.
        residual: `(reading,)` white, of unit noise, predicted less measured, with all pooled effects zero.
        blocks: the first sample of each block of neighbouring samples.
        smoothing: the low pass that waves and processes pass, and which of its moments are samples; None where they
            pass none.
    """

    about: Mapping[str, Any]
    found: tuple[Found, ...]
    candidates: tuple[Candidate, ...]
    columns: Array
    families: tuple[Candidate, ...]
    components: tuple[Component, ...]
    units: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    run: Integers
    noise: NoiseModel
    training: NDArray[np.bool_]
    basis: Array
    residual: Array
    blocks: Integers
    smoothing: LowPass | None = None

    @cached_property
    def parts(self) -> dict[str, slice]:
        """Where the columns of each candidate stand."""
        ends = np.cumsum([0, *(len(candidate.names) for candidate in self.candidates)]).tolist()
        keys = (candidate.key for candidate in self.candidates)
        return dict(zip(keys, map(slice, ends[:-1], ends[1:]), strict=True))

    @cached_property
    def left(self) -> Array:
        """`(reading,)`, the residual outside the span of the model."""
        return self.residual - (self.basis @ self.residual) @ self.basis

    @property
    def freedom(self) -> float:
        """Of what is left."""
        rows = len(self.noise.groups)
        return float(max(self.residual.size - rows * np.sum(~self.training) - len(self.basis), 1))

    @cached_property
    def _drivers(self) -> dict[str, Array]:
        return {quantity.driver.phrase: quantity.values for quantity in self.quantities}

    @cached_property
    def _places(self) -> dict[tuple[str, str], Array]:
        return {(component.site, component.name): component.column for component in self.components}

    def columns_of(self, term: Tested) -> Array:
        """`(number, reading)`; none where the recording cannot show the term."""
        if isinstance(term, Process):
            place = self._places.get((term.site, term.component))
            if place is None or not set(term.drivers) <= set(self._drivers):
                return self.columns[:0]
            return self._moved(place, self._functions(term.kernel, term.drivers, term.bounds))
        if term.order is None:
            part = self.parts.get(term.key)
            return self.columns[:0] if part is None else self.columns[part]
        family = next((family for family in self.families if family.key == term.key), None)
        return self.columns[:0] if family is None else self.waves(family, np.array([term.order]))[0]

    def waves(self, family: Candidate, orders: Array) -> Array:
        """Columns of sine and cosine of some orders, `(order, 2, reading)`."""
        return self._moved(self._place_of(family), self._waves(family, orders))

    def _place_of(self, family: Candidate) -> Array:
        return next(one.column for one in self.components if one.site == family.site)

    def _waves(self, family: Candidate, orders: Array) -> Array:
        """Sine and cosine `(order, 2, sample)`, as the measurements show them."""
        turned = np.multiply.outer(orders, self._drivers[family.driver])
        return self._seen(np.stack([np.sin(turned), np.cos(turned)], 1))

    def _functions(self, kernel: str, drivers: Sequence[str], bounds: Sequence[float]) -> Array:
        """Those of a kernel `(function, sample)`, as the measurements show them."""
        values = np.stack([self._drivers[phrase] for phrase in drivers])
        return self._seen(np.asarray(kernels.features(kernel, values, bounds, self.run)))  # type: ignore[arg-type]

    def _seen(self, values: Array) -> Array:
        """Values `(…, moment)` as the measurements show them, `(…, sample)`."""
        return values if self.smoothing is None else self.smoothing(values)

    def _moved(self, place: Array, functions: Array) -> Array:
        """Columns `(…, reading)` of what moves a place by functions `(…, sample)`."""
        return readings(functions[..., None, :] * place, self.noise, self.training, self.residual.size)

    def beside(self, terms: Sequence[Tested], options: PoolingOptions) -> "ReducedArm":
        """The same with further terms in the model: they join the basis, and leave the residual."""
        columns = [self.columns_of(term) for term in terms]
        flat = unit_rows(np.concatenate([self.columns[:0], *columns]))
        new = orthonormal(outside(flat, self.basis), options.engine.confounded) if len(flat) else flat
        basis = np.concatenate([self.basis, new])
        return replace(self, basis=basis, residual=self.residual - (new @ self.residual) @ new)

    def evidence(self, term: Tested, options: PoolingOptions) -> Evidence | None:
        """Of a term beside the model; None where the recording cannot show it, or it is confounded with the model."""
        columns = self.columns_of(term)
        projected, norms = outside(columns, self.basis), np.linalg.norm(columns, axis=1)
        # what is confounded with the model is rounding, in the score and in the information alike
        least, length = options.engine.confounded, np.where(norms > 0, norms, 1.0)
        C = projected @ projected.T / np.outer(length, length)
        seen = np.diagonal(C) > least
        eigenvalues, V = np.linalg.eigh(np.where(np.outer(seen, seen), C, 0.0))
        V, eigenvalues = np.where(seen[:, None], V, 0.0)[:, eigenvalues > least], eigenvalues[eigenvalues > least]
        if not eigenvalues.size:
            return None
        per_block = self._by_block(projected * self.left)
        score = -V @ (V.T @ (per_block.sum(1) / length)) * length
        information = (V * eigenvalues) @ V.T * np.outer(length, length)
        values = (V / eigenvalues) @ (V.T @ (per_block.sum(1) / length)) / length
        covariance = block_covariance(projected, per_block, values, self._by_block)
        return Evidence(score, information, covariance, float(self.left @ self.left), self.freedom)

    def scan(self, groups: Groups, options: PoolingOptions) -> Scan:
        """What the recording says of all candidates, of waves and of processes."""
        named = {one.key: self.evidence(PooledTerm(one.key), options) for one in self.candidates}
        waves = {family.key: self._spectrum(family, options) for family in self.families}
        roots = [kernels.root(name) for name in SCREENED]
        singles = self._screened(groups, groups.singles, roots)
        pairs = self._screened(groups, groups.pairs, [np.eye(kernels.size_of(_PAIR, ()))])
        return Scan(named, waves, singles, pairs, float(self.left @ self.left), self.freedom)

    def _screened(self, groups: Groups, which: Integers, roots: Sequence[Array]) -> Screened:
        """Of each group of functions at its component; in autocorrelated noise of those that vary slowly beside it."""
        size, measured = len(roots[0]), len(self.noise.groups) * self.training.size
        score, information = np.zeros((len(which), size)), np.zeros((len(which), size, size))
        known, functions = [phrase in self._drivers for phrase in groups.drivers], dict[tuple[int, ...], Array]()
        for i, where in enumerate(groups.components):
            own = [k for k in np.flatnonzero(which[:, 0] == i) if all(known[j] for j in which[k, 1:])]
            if where not in self._places or not own:
                continue
            for key in map(tuple, which[own, 1:].tolist()):
                if key not in functions:
                    functions[key] = self._screening(groups, key)
            f = np.stack([functions[key] for key in map(tuple, which[own, 1:].tolist())])
            site = self.noise.whitened(self._places[where]) * self.training
            over_rows = np.concatenate([self.left[None], self.basis])[:, :measured].reshape(-1, *site.shape)
            pull, *basis = np.sum(site * over_rows, 1)
            inside = f @ np.reshape(basis, (-1, self.training.size)).T
            score[own] = -(f @ pull)
            information[own] = (f * np.sum(site**2, 0)) @ f.swapaxes(1, 2) - inside @ inside.swapaxes(1, 2)
        explained, volume = zip(*(_by_variance(score @ R, R.T @ information @ R) for R in roots), strict=True)
        explained, volume = np.stack(explained, 1), np.stack(volume, 1)
        share = np.minimum(explained / (self.left @ self.left), 1 - 1e-12)
        alone = np.max(-0.5 * self.freedom * np.log1p(-share) - volume, (1, 2), initial=0.0)
        return Screened(score, information, explained, volume, alone)

    def _screening(self, groups: Groups, which: tuple[int, ...]) -> Array:
        """Splines of one quantity, products of cubics of two: functions `(function, sample)`."""
        drivers, bounds = [groups.drivers[k] for k in which], groups.bounds[list(which)].ravel()
        if len(which) > 1:
            return self._functions(_PAIR, drivers, bounds)
        return self._seen(np.asarray(kernels.spline_basis(self._drivers[drivers[0]], *bounds)))  # type: ignore[arg-type]

    def _spectrum(self, family: Candidate, options: PoolingOptions) -> tuple[Array, Array]:
        """Score `(order, 2)` and information `(order, 3)` of waves, zero where they are confounded with the model."""
        orders, place = order_grid(options), self._place_of(family)
        score, information = np.zeros((orders.size, 2)), np.zeros((orders.size, 3))
        site = place * self.training
        basis, left = self.basis[:, : site.size], self.left[: site.size]
        weight = np.sum(site**2, 0) if self.noise.white else None
        if weight is not None:  # then rows add up before waves are multiplied: their columns are not made
            over_rows = np.sum(site * np.concatenate([left[None], basis]).reshape(-1, *site.shape), 1)
            left, basis = over_rows[0], over_rows[1:]
        step = max(1, _ORDERS_AT_ONCE // (2 * max(left.size, self.run.shape[1])))
        for first in range(0, orders.size, step):
            part = slice(first, first + step)
            flat = self._waves(family, orders[part])
            if weight is not None:
                weighted = flat * weight
            else:
                flat = self.noise.whitened(flat[:, :, None] * place) * self.training
                flat = weighted = flat.reshape(len(flat), 2, -1)
            inside, own = flat @ basis.T, weighted @ flat.swapaxes(1, 2)
            G = own - inside @ inside.swapaxes(1, 2)
            lengths = np.diagonal(own, axis1=1, axis2=2)
            seen = (np.diagonal(G, axis1=1, axis2=2) > options.engine.confounded * lengths).all(1)[:, None]
            score[part] = np.where(seen, -(flat @ left), 0.0)
            information[part] = np.where(seen, np.stack([G[:, 0, 0], G[:, 0, 1], G[:, 1, 1]], 1), 0.0)
        return score, information

    def _by_block(self, products: Array) -> Array:
        return sums_by_block(products, len(self.noise.groups), self.training.size, self.blocks)


def order_grid(options: PoolingOptions) -> Array:
    """The orders at which families are scored, `(order,)`, the same for all recordings."""
    return np.arange(options.engine.lowest_order, options.engine.highest_order + 1e-9, options.order_step)


def _by_variance(score: Array, information: Array) -> tuple[Array, Array]:
    """What processes explain and their volumes `(group, variance)`, by the variance of their coefficients."""
    eigenvalues, V = np.linalg.eigh(information)
    grown = VARIANCES[:, None] * np.maximum(eigenvalues, 0.0)[:, None]
    squares = np.einsum("gij,gi->gj", V, score) ** 2
    explained = np.sum(VARIANCES[:, None] * squares[:, None] / (1 + grown), -1)
    return explained, 0.5 * np.sum(np.log1p(grown), -1)
