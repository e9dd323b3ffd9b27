"""One recording reduced to what pooling needs: white residuals and the columns of all candidates, without a robot.

A recording is diagnosed once, where its problem and its noise model are at hand. What is kept of it is linear: then any
set of effects that the type is found to have is fitted to it by linear algebra alone, without the files, the kinematics
and compiled code.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.torque.filtering import LowPass
from lite6jax.estimation.noise import NoiseModel
from lite6jax.estimation.projection import orthonormal, outside, unit_rows
from lite6jax.estimation.score_test import Score, block_covariance, block_test, sums_by_block
from lite6jax.populations.candidate import Candidate
from lite6jax.populations.functions import Function
from lite6jax.populations.options import PoolingOptions

Array = NDArray[np.floating]
Integers = NDArray[np.integer]

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


class PooledTerm(NamedTuple):
    """An effect of the type: a candidate by its key, a wave of a family, or a function without a name.

    Attributes:
        key: of the candidate, of the family, or of the function.
        order: of the wave; None of the others.
    """

    key: str
    order: float | None = None


@final
@dataclass(frozen=True)
class Found:
    """What the diagnosis of the recording alone found.

    Attributes:
        term: as a term that can be pooled; None where it cannot, such as a curve without a name.
        label: its name and site.
        p_value: family-wise, over all that was searched in the recording.
    """

    term: PooledTerm | None
    label: str
    p_value: float


class Evidence(NamedTuple):
    """What a recording says of one effect beside others, as a likelihood that is normal in its numbers.

    Attributes:
        score: `(number,)`, the derivative of the log-likelihood at zero.
        information: `(number, number)`, minus its second derivative.
        covariance: `(number, number)` of the score, by the scatter between blocks of samples.
        blocks: their number.
        p_value: of the recording alone; the larger of the tests for white and for correlated noise.
    """

    score: Array
    information: Array
    covariance: Array
    blocks: int
    p_value: float


@final
@dataclass(frozen=True, eq=False)
class ReducedArm:
    """The linear model of one recording; readings are all rows of all samples, and then those of the nuisance's prior.

    Attributes:
        about: of the recording: `what` was measured ("poses" or "torques"), `arm`, `joints`, `rows`, `date`, `verdict`.
        found: by the recording alone.
        candidates: that can be tested here.
        columns: `(number, reading)`, white, of unit noise, of all candidates one after the other.
        families: of waves.
        sites: `(family, row, sample)`, how residuals change with a deflection at the site of each family, unit noise.
        angles: `(family, moment)` rad; the moments are the samples, unless there is a `smoothing`.
        noise: the filter that makes columns white.
        training: `(sample,)` bool.
        basis: `(k, reading)`, orthonormal, the span of the nuisance and of effects that are not pooled.
        residual: `(reading,)` white, of unit noise, predicted less measured, with all pooled effects zero.
        blocks: the first sample of each block of neighbouring samples.
        functions: without a name, by which names are tested; over the ranges of this recording, until `over` others.
        places: `(row, sample)`, how residuals change with a deflection or torque, unit noise, by its key.
        drivers: `(moment,)`, what functions depend on and directions that multiply them, by its key.
        smoothing: the low pass that waves and functions pass, and which of its moments are samples; None where they
            pass none.
    """

    about: Mapping[str, Any]
    found: tuple[Found, ...]
    candidates: tuple[Candidate, ...]
    columns: Array
    families: tuple[Candidate, ...]
    sites: Array
    angles: Array
    noise: NoiseModel
    training: NDArray[np.bool_]
    basis: Array
    residual: Array
    blocks: Integers
    functions: tuple[Function, ...] = ()
    places: Mapping[str, Array] = field(default_factory=dict)
    drivers: Mapping[str, Array] = field(default_factory=dict)
    smoothing: LowPass | None = None

    def over(self, functions: Sequence[Function]) -> "ReducedArm":
        """The same with functions over other ranges, of which those stay that this recording can show."""
        own = {function.key for function in self.functions}
        return replace(self, functions=tuple(function for function in functions if function.key in own))

    @cached_property
    def parts(self) -> dict[str, slice]:
        """Where the columns of each candidate stand."""
        ends = np.cumsum([0, *(len(candidate.names) for candidate in self.candidates)])
        return {
            candidate.key: slice(int(a), int(b))
            for candidate, a, b in zip(self.candidates, ends[:-1], ends[1:], strict=True)
        }

    def columns_of(self, term: PooledTerm) -> Array:
        """`(number, reading)`; none where the recording cannot show the term."""
        if term.order is None:
            part = self.parts.get(term.key)
            function = next((one for one in self.functions if one.key == term.key), None)
            if function is not None:
                return self.columns_of_function(function)
            return self.columns[:0] if part is None else self.columns[part]
        place = next((i for i, family in enumerate(self.families) if family.key == term.key), None)
        return self.columns[:0] if place is None else self.waves(place, np.array([term.order]))[0]

    def waves(self, family: int, orders: Array) -> Array:
        """Columns of sine and cosine of some orders, `(order, 2, reading)`."""
        columns = self._waves(family, orders)[:, :, None] * self.sites[family]
        return readings(columns, self.noise, self.training, self.residual.size)

    def _waves(self, family: int, orders: Array) -> Array:
        """Sine and cosine `(order, 2, sample)`, as the measurements show them."""
        turned = np.multiply.outer(orders, self.angles[family])
        return self._measured(np.stack([np.sin(turned), np.cos(turned)], 1))

    def _measured(self, values: Array) -> Array:
        """Values `(…, moment)` as the measurements show them, `(…, sample)`."""
        return values if self.smoothing is None else self.smoothing(values)

    def columns_of_function(self, function: Function) -> Array:
        """`(number, reading)`, those of each component one after the other."""
        basis = function.basis(np.stack([self.drivers[key] for key in function.drivers]))
        basis = self._measured(basis * self.drivers[function.direction] if function.direction else basis)
        columns = [basis[:, None] * self.places[component] for component in function.components]
        return readings(np.concatenate(columns), self.noise, self.training, self.residual.size)

    def beside(self, terms: Sequence[PooledTerm], options: PoolingOptions) -> "ReducedArm":
        """The same with further terms in the model: they join the basis, and leave the residual."""
        columns = [self.columns_of(term) for term in terms]
        flat = unit_rows(np.concatenate([self.columns[:0], *columns]))
        new = orthonormal(outside(flat, self.basis), options.engine.confounded) if len(flat) else flat
        basis = np.concatenate([self.basis, new])
        return replace(self, basis=basis, residual=self.residual - (new @ self.residual) @ new)

    def evidence(self, term: PooledTerm, options: PoolingOptions) -> Evidence | None:
        """Of a term beside the model; None where the recording cannot show it, or it is confounded with the model."""
        columns = self.columns_of(term)
        if not len(columns):
            return None
        projected, norms = outside(columns, self.basis), np.linalg.norm(columns, axis=1)
        per_block = self._by_block(projected * self.residual)
        score: Score = block_test(projected, norms, per_block, self._by_block, 1.0, options.engine)
        if score.confounded:
            return None
        determined, information = _determined(-per_block.sum(1), projected @ projected.T, norms, options)
        spread = block_covariance(projected, per_block, -score.values, self._by_block)
        return Evidence(determined, information, spread, per_block.shape[1], score.p_value)

    def scores(self, options: PoolingOptions) -> tuple[list[tuple[Array, Array]], Array, Array]:
        """Scores and information of all candidates, and of both waves of all orders of `order_grid`.

        Returns:
            for each candidate `(number,)` and `(number, number)`; then `(family, order, 2)` and, as sine², sine·cosine
            and cosine², `(family, order, 3)`.
        """
        projected = outside(self.columns, self.basis)
        total, norms = -(projected @ self.residual), np.linalg.norm(self.columns, axis=1)
        named: list[tuple[Array, Array]] = [
            _determined(total[part], projected[part] @ projected[part].T, norms[part], options)
            for part in self.parts.values()
        ]
        orders = order_grid(options)
        shape = len(self.families), orders.size
        score, information = np.zeros((*shape, 2)), np.zeros((*shape, 3))
        for family in range(len(self.families)):
            if self.sites[family].any():
                score[family], information[family] = self._spectrum(family, orders, options)
        return named, score, information

    def scores_of_functions(self, options: PoolingOptions) -> list[tuple[Array, Array]]:
        """Score `(number,)` and information `(number, number)` of each function without a name."""
        found = []
        for function in self.functions:
            columns = self.columns_of_function(function)
            projected, norms = outside(columns, self.basis), np.linalg.norm(columns, axis=1)
            found.append(_determined(-(projected @ self.residual), projected @ projected.T, norms, options))
        return found

    def _spectrum(self, family: int, orders: Array, options: PoolingOptions) -> tuple[Array, Array]:
        """The part of `scores` of one family."""
        site = self.sites[family] * self.training
        basis, residual, inside = self.basis[:, : site.size], self.residual[: site.size], self.basis @ self.residual
        weight = np.sum(site**2, 0) if self.noise.white else None
        if weight is not None:  # then rows add up before waves are multiplied: their columns are not made
            over_rows = np.sum(site * np.concatenate([residual[None], basis]).reshape(-1, *site.shape), 1)
            residual, basis = over_rows[0], over_rows[1:]
        score, information = np.zeros((orders.size, 2)), np.zeros((orders.size, 3))
        step = max(1, _ORDERS_AT_ONCE // (2 * max(residual.size, self.angles.shape[1])))
        for first in range(0, orders.size, step):
            part = slice(first, first + step)
            flat = self._waves(family, orders[part])
            if weight is not None:
                weighted = flat * weight
            else:
                flat = self.noise.whitened(flat[:, :, None] * self.sites[family]) * self.training
                flat = weighted = flat.reshape(len(flat), 2, -1)
            known = flat @ basis.T
            score[part] = -(flat @ residual - known @ inside)
            own, G = weighted @ flat.swapaxes(1, 2), known @ known.swapaxes(1, 2)
            G = own - G
            found = np.stack([G[:, 0, 0], G[:, 0, 1], G[:, 1, 1]], 1)
            lengths = np.maximum(np.diagonal(own, axis1=1, axis2=2), np.finfo(float).tiny)
            lost = (np.diagonal(G, axis1=1, axis2=2) < options.engine.confounded * lengths).any(1)
            score[part][lost], found[lost] = 0.0, 0.0
            information[part] = found
        return score, information

    def _by_block(self, products: Array) -> Array:
        return sums_by_block(products, len(self.noise.groups), self.training.size, self.blocks)


def order_grid(options: PoolingOptions) -> Array:
    """The orders at which families are scored, `(order,)`, the same for all recordings."""
    return np.arange(options.engine.lowest_order, options.engine.highest_order + 1e-9, options.order_step)


def _determined(score: Array, G: Array, norms: Array, options: PoolingOptions) -> tuple[Array, Array]:
    """Score and information without what is confounded with the model: there both are rounding.

    Args:
        score: `(number,)`.
        G: `(number, number)`, of projected columns.
        norms: `(number,)` of the columns before that.
        options: thresholds.
    """
    least, length = options.engine.confounded, np.where(norms > 0, norms, 1.0)
    C = G / np.outer(length, length)
    seen = np.diagonal(C) > least
    C = np.where(np.outer(seen, seen), C, 0.0)
    eigenvalues, V = np.linalg.eigh(C)
    V = np.where(seen[:, None], V[:, eigenvalues > least], 0.0)
    information = (V * eigenvalues[eigenvalues > least]) @ V.T * np.outer(length, length)
    return V @ (V.T @ (score / length)) * length, information
