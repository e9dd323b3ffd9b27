"""Harmonic shrinkage: all orders of all periodic families at once, each family under a spectral prior of its own.

Adding orders one by one finds the largest first, and biases each by those still missing. All at once, coefficients that
the data do not determine stay near zero. What repeats with an angle fades towards high orders: coefficients
of order k have the prior variance a² / (1 + (k / c)ˢ). The amplitude a, the corner order c and the slope s of each
family maximise the marginal likelihood (C. Rasmussen and C. Williams, Gaussian Processes for Machine Learning, 2006,
eq. 2.43 and 5.9); the whole posterior is kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import get_lapack_funcs

from lite6jax.estimation.factored import Factored, gram, pulled
from lite6jax.estimation.least_squares import Fit, fit, linear_columns
from lite6jax.estimation.multiplicity import multiplicity
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import PeriodicFamily, Problem
from lite6jax.estimation.projection import orthonormal, outside, unit_rows
from lite6jax.estimation.robust import FREEDOM
from lite6jax.estimation.score_test import Score, gain_p_value, longest_time, score_test
from lite6jax.estimation.terms import Term, Terms, join
from lite6jax.search.state import SelectedTerm, State

Array = NDArray[np.floating]

_HIGHEST = 60.0
"""The highest order: above it, coefficients shrink to zero."""
_RANGES = 1.25
"""Ranges of the angle in the period of the lowest order, at least: errors need not repeat after a turn."""
_STEPS = (12, 6, 4)
"""Steps up the marginal likelihood in each round of robust weights: both settle to a per cent."""
_START = (1e-4, 10.0, 3.0)
"""Amplitude in rad, corner and slope from which the marginal likelihood is climbed."""
_BOUNDS = ((-16.0, -4.0), (np.log(0.5), np.log(_HIGHEST)), (0.0, 8.0))
"""Of the logarithms of amplitude and corner, and of the slope."""
_UNDETERMINED = 0.02
"""Information of a coefficient over that of its prior, below which its order is left out."""
_ROUNDING = 1e-12
"""Relative eigenvalue of products of the nuisance's columns below which a direction does not count."""
_MUCH = 0.3
"""Share of the best named term's gain from which another is added in the same round."""


class _Spectrum(NamedTuple):
    """The lines of one family: which orders, their prior, and the posterior's mean.

    Attributes:
        family: of them.
        orders: `(order,)`.
        amplitude: rad, one standard deviation of a coefficient of low order.
        rolloff: the corner order, and the slope.
        values: `(2 · order,)` rad, of sine and cosine of each order.
    """

    family: PeriodicFamily
    orders: Array
    amplitude: float
    rolloff: tuple[float, float]
    values: Array


def shrink(problem: Problem, state: State, options: EngineOptions) -> State | None:
    """The named terms of a state with curves instead of its periodic terms, where that explains more than these.

    Args:
        problem: the data.
        state: what forward selection found; its periodic terms are estimated anew.
        options: thresholds.

    Returns:
        None where the terms of the state are more likely.
    """
    named = [tested for tested in state.tested if not tested.term.periodic]
    plain = [term for term in problem.candidates if problem.shrinkable(term)]
    current, at = _with_curves(problem, state.baseline, state.baseline, named, _start(problem), options)
    for _ in range(options.shrinkage_rounds - 1):
        room = options.named_numbers - sum(tested.term.size for tested in named)
        more = _named(problem, current, plain, options, room)
        if not more:
            break
        named += more
        current, at = _with_curves(problem, state.baseline, current, named, at, options)
    more_numbers = current.parameters - state.fit.parameters
    if current.gain_over(state.fit) < 0.5 * more_numbers * np.log(state.baseline.freedom):
        return None
    curves = current.terms.terms[len(named) :]
    time = longest_time(problem, current, options)
    return State(
        state.baseline, current, (*named, *(_tested(problem, current, curve, time, options) for curve in curves))
    )


def _with_curves(
    problem: Problem, baseline: Fit, current: Fit, named: Sequence[SelectedTerm], at: Array, options: EngineOptions
) -> tuple[Fit, Array]:
    """Named terms and the curves beside them, fitted; the curves follow from the residuals of `current`.

    The search for the numbers of their priors starts at `at`; those found are returned, in the order of
    `_Evidence.most_likely`.
    """
    terms = tuple(tested.term for tested in named)
    spectra, at = _spectra(problem, current, Terms(terms), at)
    curves = [
        one.family.curve(one.orders, current.training, (one.amplitude, *one.rolloff), options.fade) for one in spectra
    ]
    model = Terms((*terms, *curves))
    start = join([np.zeros(sum(term.size for term in terms)), *(one.values for one in spectra)])
    rough = replace(options, settled=options.exact_settled)  # each step takes hundreds of numbers
    return fit(problem, model, rough, start, baseline.nuisance, baseline.training), at


def _spectra(problem: Problem, current: Fit, named: Terms, at: Array) -> tuple[list[_Spectrum], Array]:
    """The lines of each family beside the nuisance and named terms, under the most likely priors, robustly."""
    training, families = np.flatnonzero(current.training), problem.periodic
    orders = [_orders(family.angle[training]) for family in families]
    fixed = linear_columns(problem, named, np.zeros(named.size))[..., training]
    waves = [
        Factored(family.column[None][..., training], family.waves_of(each)[..., training].reshape(2 * len(each), -1))
        for family, each in zip(families, orders, strict=True)
    ]
    # residuals without nuisance and terms, to first order: those of the current fit less its linear prediction
    explained = np.concatenate([current.nuisance, current.values])
    predicted = np.tensordot(explained, linear_columns(problem, current.terms, current.values), 1)
    target = -(current.residuals.rows - predicted)[:, training]
    prior = np.concatenate([problem.precision, named.precision])
    weight = np.ones(len(training))
    scale = float(np.sqrt(np.mean(target**2)))
    evidence, values = None, np.zeros(0)
    for steps in _STEPS:
        root = np.sqrt(weight) / scale
        evidence = _Evidence.of(fixed * root, prior, [each.weighed(root) for each in waves], target * root, orders)
        at = evidence.most_likely(at, steps)
        values, left, effective = evidence.posterior(at)
        squares = np.sum((left / root) ** 2, 0)
        scale = float(np.sqrt(np.sum(weight * squares) / max(target.size - effective, 1.0)))
        weight = (FREEDOM + problem.rows) / (FREEDOM + squares / scale**2)
    assert evidence is not None
    found, coefficients = [], _by_family(values, orders)
    kept = evidence.determined(at)
    for family, each, numbers, values, some in zip(
        families, orders, at.reshape(-1, 3), coefficients, kept, strict=True
    ):
        if some:
            amplitude, corner, slope = np.exp(numbers[0]), np.exp(numbers[1]), numbers[2]
            rolloff = (float(f"{corner:.6g}"), float(f"{slope:.6g}"))
            found.append(_Spectrum(family, each[:some], float(f"{amplitude:.6g}"), rolloff, values[: 2 * some]))
    return found, at


def _orders(angle: Array) -> Array:
    """The orders of a family: whole ones; of an angle that turns far, so fine that its range is within one period."""
    lowest = float(np.clip(2 * np.pi / (_RANGES * max(float(np.ptp(angle)), 1e-3)), 0.25, 1.0))
    return lowest * np.arange(1, int(_HIGHEST / lowest) + 1)


def _by_family(lines: Array, orders: Sequence[Array]) -> list[Array]:
    """What stands for sine and cosine of all orders `(line,)`, for each family apart."""
    return np.split(lines, np.cumsum([2 * len(each) for each in orders])[:-1])


def _start(problem: Problem) -> Array:
    amplitude, corner, slope = _START
    return np.tile([np.log(amplitude), np.log(corner), slope], len(problem.periodic))


@final
@dataclass(frozen=True, eq=False)
class _Evidence:
    """The marginal likelihood of the priors' numbers, in noise of unit variance.

    The nuisance and the named terms are integrated over.

    Attributes:
        orders: of each family.
        waves: of each family, weighed.
        basis: `(fixed, row, sample)`, orthonormal with what the priors add to it: the span of the nuisance and of named
            terms as far as the data or priors determine them.
        inside: `(fixed, line)`, the columns of all waves in this basis.
        target: `(row, sample)`, the data outside that span.
        gram: `(line, line)`, products of the columns outside that span.
        pulled: `(line,)`, products of the columns with the data there.
    """

    orders: Sequence[Array]
    waves: Sequence[Factored]
    basis: Array
    inside: Array
    target: Array
    gram: Array
    pulled: Array

    @classmethod
    def of(
        cls, fixed: Array, prior: Array, waves: Sequence[Factored], target: Array, orders: Sequence[Array]
    ) -> "_Evidence":
        """From columns `(number, row, sample)`, one over the prior variances of these numbers, and the data."""
        readings = np.concatenate([fixed.reshape(len(fixed), -1), np.diag(np.sqrt(prior))], 1)
        whole = orthonormal(unit_rows(readings), _ROUNDING)
        basis = whole[:, : target.size].reshape(-1, *target.shape)
        left = outside(np.append(target, np.zeros(len(fixed)))[None], whole)[0, : target.size].reshape(target.shape)
        inside = np.concatenate([each.with_rows(basis) for each in waves], 1)
        return cls(orders, waves, basis, inside, left, gram(waves) - inside.T @ inside, pulled(waves, left))

    def most_likely(self, start: Array, steps: int) -> Array:
        """The priors' numbers `(3 · family,)`, so many steps on: logarithms of amplitude and corner, and the slope."""
        from scipy.optimize import minimize  # a tenth of a second, which most recordings do without

        bounds = [*_BOUNDS] * len(self.orders)
        options = {"maxiter": steps, "maxfun": 2 * steps}
        return minimize(self._unlikely, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x

    def posterior(self, at: Array) -> tuple[Array, Array, float]:
        """The mean `(line,)`, what it leaves of the data `(row, sample)`, and the effective number of parameters."""
        s, factor = self._factor(at)
        mean = s * cho_solve(factor, s * self.pulled)
        effective = len(self.basis) + len(s) - float(np.sum(_inverse_diagonal(factor)))
        parts = zip(self.waves, _by_family(mean, self.orders), strict=True)
        explained = sum(
            (each.total(values) for each, values in parts), -np.tensordot(self.inside @ mean, self.basis, 1)
        )
        return mean, self.target - explained, effective

    def _factor(self, at: Array) -> tuple[Array, tuple[Array, bool]]:
        """The prior's standard deviations `(line,)`, and the Cholesky factor of the posterior's precision over it."""
        s = np.sqrt(self._variance(at))
        M = self.gram * np.outer(s, s)
        M[np.diag_indices_from(M)] += 1
        return s, cho_factor(M, lower=True)

    def determined(self, at: Array) -> list[int]:
        """How many orders of each family the data say something of."""
        information = np.diagonal(self.gram) * self._variance(at)
        parts = _by_family(information, self.orders)
        pairs = (np.flatnonzero(part.reshape(-1, 2).max(1) > _UNDETERMINED) for part in parts)
        return [int(some[-1]) + 1 if some.size else 0 for some in pairs]

    def _variance(self, at: Array) -> Array:
        """`(line,)`, of the coefficients' priors."""
        return np.concatenate(
            [np.repeat(_variance(each, *n), 2) for each, n in zip(self.orders, at.reshape(-1, 3), strict=True)]
        )

    def _unlikely(self, at: Array) -> tuple[float, Array]:
        """Minus the log marginal likelihood, up to a constant, and its derivatives."""
        s, factor = self._factor(at)
        x = cho_solve(factor, s * self.pulled)
        value = float(np.sum(np.log(np.diagonal(factor[0]))) - 0.5 * (s * self.pulled) @ x)
        # by the logarithm of each coefficient's prior variance
        change = 0.5 * (1 - _inverse_diagonal(factor) - x**2)
        slopes = []
        parts = _by_family(change, self.orders)
        for each, part, (_, corner, slope) in zip(self.orders, parts, at.reshape(-1, 3), strict=True):
            pair, relative = part.reshape(-1, 2).sum(1), each / np.exp(corner)
            faded = relative**slope / (1 + relative**slope)
            slopes += [2 * pair.sum(), slope * pair @ faded, -pair @ (faded * np.log(relative))]
        return value, np.array(slopes)


def _inverse_diagonal(factor: tuple[Array, bool]) -> Array:
    """The diagonal of the inverse of the matrix with this lower Cholesky factor."""
    (trtri,) = get_lapack_funcs(("trtri",), (factor[0],))
    inverse = trtri(factor[0], lower=factor[1])[0]
    return np.sum(np.tril(inverse) ** 2, 0)


def _variance(orders: Array, amplitude: float, corner: float, slope: float) -> Array:
    """Of the coefficients' priors, by the logarithms of amplitude and corner, and the slope."""
    return np.exp(2 * amplitude) / (1 + (orders / np.exp(corner)) ** slope)


def _named(
    problem: Problem, current: Fit, candidates: Sequence[Term], options: EngineOptions, room: int
) -> list[SelectedTerm]:
    """Named terms that are significant beside the model, each tested after those before it."""
    test = score_test(problem, current, options)
    pairs = [pair for pair in zip(candidates, test.explained(candidates), strict=True) if not pair[1].confounded]
    found: list[SelectedTerm] = []
    for term, _ in sorted(pairs, key=lambda pair: -pair[1].gain)[: options.named_numbers]:
        columns = problem.columns([term])
        score = test.score_columns([columns])[0]
        p_value = score.familywise(multiplicity(problem, term, options))
        if term in current.terms.terms or _outside(problem, term, score.values):
            continue
        if score.confounded or p_value >= options.level:
            continue
        if score.gain < term.size * np.log(test.freedom) or term.size > room:
            continue
        if found and score.gain < _MUCH * found[0].score.gain:
            continue
        found.append(SelectedTerm(term, p_value, score))
        room -= term.size
        test = test.given(columns)
    return found


def _outside(problem: Problem, term: Term, values: Array) -> bool:
    """Whether a number of a term is more or less than it can be."""
    return any(not lower <= v <= upper for v, (lower, upper) in zip(values, problem.limits(term), strict=True))


def _tested(problem: Problem, current: Fit, curve: Term, time: float, options: EngineOptions) -> SelectedTerm:
    """The test of a curve beside all else: by the square of its coefficients in their posterior's metric."""
    k = current.terms.terms.index(curve)
    at = current.terms.slices[k]
    values, covariance = current.values[at], current.covariance[at, at]
    prior = np.array([number.spread for number in curve.coordinates]) ** 2
    effective = int(np.ceil(max(len(values) - float(np.sum(np.diagonal(covariance) / prior)), 1.0)))
    gain = current.quadratic_gain(k)
    p_value = min(gain_p_value(gain, effective, time) * multiplicity(problem, curve, options), 1.0)
    return SelectedTerm(curve, p_value, Score(gain, effective, p_value, False, values))
