"""Nuisance and terms fitted together, robustly: the one Gauss–Newton of the engine, on exact residuals."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar, final

import numpy as np
import scipy  # whose parts are imported where they are first used

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.estimation.noise import NoiseModel, white_noise
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import LinearisedProblem, linearised_at, prior_precision
from lite6jax.estimation.projection import ROUNDING, scaled_inverse, scaled_solve, schur_complement
from lite6jax.estimation.robust import FREEDOM, gaussian_t_scale, t_scale, variance_factor
from lite6jax.estimation.terms import Factored, Terms, gram, pulled
from lite6jax.estimation.thresholds import CONFOUNDED
from lite6jax.estimation.whitening import Whitened, weighed_columns

P = TypeVar("P", bound=LinearisedProblem)

_FIRST_STEPS = 6
"""Most steps of a fit that is linearised anew where it has not converged by then; four suffice mostly."""
_LEAST_GAIN = 0.01
"""Log-likelihood that a fit must gain to be linearised anew again; `CLOSE` is 600 times that."""
_SHORT = 0.3
"""Standard deviations that a step has at least for the problem to be linearised anew after it."""
_EXACT_STEPS = 8
"""Most steps of a fit with derivatives by differences, which starts at the solution."""
_EXACT_SETTLED = 0.02
"""Length of its last step, in standard deviations, as each step is expensive."""
_VISIBLE = 2.0
"""Times `settled`, the length from which a step of a curved problem is tried: its residuals take the most time."""
_HALVINGS = 6
"""Most halvings of a step that does not improve; a step of 1/64 is no progress."""
_DIFFERENCE = 1e-6
"""m or rad by which a difference is taken, between rounding and curvature."""
_LEAST_SHARE = 0.1
_MOST_SHARE = 0.8
"""Between which the length of a step is of the one before for a step to be stretched: at most five times."""
_ACROSS = 0.5
"""Share of a squared step, at most, that is not along the one before where it is stretched."""
_ANOTHER = 0.2
"""Share by which a damped step of a curved problem differs from the last one that is tried."""
_EXACT_ROUNDING = 1e-9
"""Relative eigenvalue below which a direction is rounding where derivatives are taken by differences.

These are known to about 1e-6: it is a thousand times the square.
"""
_MANY = 40
"""Numbers of a term from which factored columns save time."""
_FAR_STEPS = 20
"""Steps at most that do not count, as the nuisance moves so far that columns are others: e⁸ of a number takes ten."""
_SAME_WEIGHTS = 0.03
"""Mean change of the weights, over themselves, up to which products of columns serve further steps.

The gradient has the weights as they are. Of the distance to the solution a step leaves this share more.
"""
_TYPICAL = 1e-4
"""m or rad, the change of a prediction by a number of its typical size."""


class Residuals(NamedTuple):
    """Residuals with their robust scale and the weights of Student's t.

    Attributes:
        rows: `(row, sample)`, over the declared noise.
        innovations: `(row, sample)`, `rows` less their prediction from earlier samples by the noise model.
        scale: `(group,)`, of the noise over the declared one.
        weight: `(group, sample)`, of Student's t: about 1 at the expected residual, towards 0 for outliers.
        groups: `(row,)`.
    """

    rows: Array
    innovations: Array
    scale: Array
    weight: Array
    groups: Integers

    @property
    def squares(self) -> Array:
        """`(sample,)`, over the scale of each group."""
        return np.sum((self.rows / self.scale[self.groups, None]) ** 2, 0)

    @property
    def row_weight(self) -> Array:
        """`(row, sample)`, of each number in the normal equations."""
        return (self.weight / self.scale[:, None] ** 2)[self.groups]


class _Information(NamedTuple):
    """Products of columns with one another.

    Attributes:
        columns: their parts, as of `gram`; None before there are any.
        weight: `(row, sample)`, of each row and sample in the products.
        products: `(number, number)`.
    """

    columns: Sequence[Array | Factored] | None
    weight: Array
    products: Array


@final
@dataclass(frozen=True, eq=False)
class Fit:
    """A problem with some terms, fitted.

    Attributes:
        terms: of the model.
        nuisance: `(number,)`, from the problem's point of linearisation.
        offset: `(number,)`, of that point from the prior's mean.
        values: `(terms.size,)`.
        covariance: `(terms.size, terms.size)` of the values, the nuisance's uncertainty included.
        residuals: of all samples, including those outside `training`.
        training: `(sample,)` bool, the samples it was fitted to.
        parameters: effective number of fitted parameters: those that only the prior determines do not count.
        converged: whether the last step was short enough.
        stalled: whether it ended where no step led any further.
        noise: the noise model.
        penalty: sum over all numbers of the squared deviation from the prior's mean over the prior's variance.
        volume: ½ ln det(I + τ²λ) of all processes together, by which their evidence is less than the gain of the
            likelihood: each alone beside the others would not count what two of them share. And what names share with
            each other and with processes: the volumes of all terms are those of one determinant.
    """

    terms: Terms
    nuisance: Array
    offset: Array
    values: Array
    covariance: Array
    residuals: Residuals
    training: Mask
    parameters: float
    converged: bool
    noise: NoiseModel
    penalty: float
    volume: float = 0.0
    stalled: bool = False

    @property
    def scale(self) -> Array:
        """`(group,)`, of the noise over the declared one."""
        return self.residuals.scale

    def nuisance_about(self, problem: LinearisedProblem) -> Array:
        """The nuisance from the point of linearisation of another problem of the same data, to first order."""
        return self.offset + self.nuisance - problem.offset

    def part(self, kept: Sequence[bool]) -> "Fit":
        """With some of its terms alone, `(term,)`, and nothing refitted: at which what is left out is weighed."""
        terms, values = self.terms.part(self.values, kept)
        numbers = np.flatnonzero(np.repeat(kept, [one.size for one in self.terms.terms]))
        return replace(self, terms=terms, values=values, covariance=self.covariance[np.ix_(numbers, numbers)])

    def thinned(self, every: int) -> "Fit":
        """The fit with one in `every` samples; of white noise."""
        r = self.residuals
        few = r._replace(rows=r.rows[:, ::every], innovations=r.innovations[:, ::every], weight=r.weight[:, ::every])
        return replace(self, residuals=few, training=self.training[::every])

    def seen_in(self, problem: LinearisedProblem, training: Mask, noise: NoiseModel) -> "Fit":
        """Its numbers and what is known of them, with the residuals of another problem, linearised at them."""
        nuisance = np.zeros_like(self.nuisance)
        rows = problem.residual(nuisance, self.terms, self.values)
        residuals = weighed(rows, noise, training, float(problem.floored))
        moved = {"nuisance": nuisance, "offset": problem.offset, "residuals": residuals}
        return replace(self, **moved, training=training, noise=noise)

    @property
    def freedom(self) -> float:
        """Residual degrees of freedom."""
        return float(len(self.residuals.rows) * self.training.sum()) - self.parameters

    def log_likelihood(self, scale: Array) -> float:
        """Log-likelihood of training samples under Student's t and of the prior, up to a constant, at noise `scale`."""
        r = self.residuals
        total = -0.5 * self.penalty
        for group, s in enumerate(scale):
            squares = np.sum(r.innovations[r.groups == group][:, self.training] ** 2, 0) / s**2
            rows = int(np.sum(r.groups == group))
            total -= 0.5 * (FREEDOM + rows) * np.sum(np.log1p(squares / FREEDOM)) + squares.size * rows * np.log(s)
        return float(total)

    @property
    def own_likelihood(self) -> float:
        """The log-likelihood at the fit's own noise, its scale and its autocorrelation: of fits in different noise."""
        return self.log_likelihood(self.scale) + self.noise.log_volume(self.training)

    def gain_over(self, other: "Fit") -> float:
        """The log-likelihood less that of another fit, both at the smaller noise scale in each group."""
        scale = np.minimum(self.scale, other.scale)
        return self.log_likelihood(scale) - other.log_likelihood(scale)


def fit(
    problem: LinearisedProblem,
    terms: Terms,
    options: EngineOptions,
    values: Array | None = None,
    nuisance: Array | None = None,
    training: Mask | None = None,
    noise: NoiseModel | None = None,
    exact: bool = False,
    whitened: Whitened | None = None,
) -> Fit:
    """Fits the nuisance and the numbers of `terms` under Student's t, whose scale is estimated in each group.

    Derivatives are those at the problem's point of linearisation, unless its columns depend on the nuisance
    (`linearised_at`), and so are the drivers of terms that a domain computes from it; residuals are exact otherwise.
    Each step multiplies the error by about a thousandth, or by the error of the start in rad where that is larger.
    Beside an effect of many times the noise the nuisance may be too far from that point: a fit that has not converged
    after `_FIRST_STEPS` goes on as `relinearised_fit`, if it `may_relinearise`. Its nuisance is then the sum of
    displacements that were made one after the other, which is the same to first order. Derivatives are kept
    while no term's numbers change by more than the share `stale`. Where a combination of nuisance numbers is nearly
    confounded with a term, an error of a hundredth in the derivatives changes the information, and `exact` derivatives
    are needed for the covariance.

    Args:
        problem: the data.
        terms: of the model.
        options: thresholds.
        values: `(terms.size,)` to start from; zero where not given.
        nuisance: `(number,)` to start from; zero where not given.
        training: `(sample,)` bool; all where not given.
        noise: the noise model; white where not given.
        exact: whether derivatives are taken at the current estimate, by differences; a step then evaluates the
            residuals once for each number.
        whitened: columns of other models of this problem, to which this one adds.

    Where a term jumps, as a gear between its flanks does at a torque that depends on the nuisance, a start far from
    zero may lead no further; a start from zero is then tried too, and the likelier result taken.
    """
    following = options.fit.may_relinearise and not exact and len(problem.precision)
    first = replace(options, fit=replace(options.fit, steps=_FIRST_STEPS)) if following else options
    found = _fitted(problem, terms, first, values, nuisance, training, noise, exact, False, whitened)[1]
    if found.converged or exact:
        return found
    if following:
        start = found.values, options, found.nuisance, found.training, found.noise
        again = relinearised_fit(problem, terms, *start)[1]
        if again.gain_over(found) > 0:
            found = replace(again, nuisance=again.nuisance_about(problem), offset=problem.offset)
    if not found.stalled or nuisance is None or not nuisance.any() or not _may_jump(terms):
        return found
    again = _fitted(problem, terms, options, None, None, training, noise, False, False, whitened)[1]
    return again if again.gain_over(found) > 0 else found


def _may_jump(terms: Terms) -> bool:
    """Tells whether a term has a number in which it is not linear: it places a step, as no order of a wave does."""
    return any(term.chosen is not None and not term.periodic for term in terms.terms)


def relinearise(problem: P, options: EngineOptions, training: Mask | None = None, steps: int | None = None) -> P:
    """The problem about the nuisance that fits best without further terms, linearised anew after each long step.

    Args:
        problem: the data.
        options: thresholds.
        training: `(sample,)` bool; all where not given.
        steps: the most; those of the options where not given.
    """
    if steps is not None:
        options = replace(options, fit=replace(options.fit, steps=steps))
    return relinearised_fit(problem, *problem.preset, options, training=training)[0]


def relinearised_fit(
    problem: P,
    terms: Terms,
    values: Array,
    options: EngineOptions,
    nuisance: Array | None = None,
    training: Mask | None = None,
    noise: NoiseModel | None = None,
) -> tuple[P, Fit]:
    """The problem about the best nuisance and numbers of terms, linearised anew after each long step; and the fit.

    Columns of curved problems follow the estimate anyway: these are linearised anew at the end alone.
    Derivatives are then those at the estimate. Where numbers are nearly confounded, an error of a thousandth in the
    derivatives leads every step astray along the combination that the data hardly determine.

    Args:
        problem: the data.
        terms: of the model.
        values: `(terms.size,)` to start from.
        options: thresholds.
        nuisance: `(number,)` to start from, where the problem is linearised first; as it is where not given.
        training: `(sample,)` bool; all where not given.
        noise: the noise model; white where not given.
    """
    if nuisance is not None:
        problem = problem.relinearised(nuisance, (terms, values))
    problem, fitted = _fitted(problem, terms, options, values, None, training, noise, False, True)
    there = problem.relinearised(fitted.nuisance, (terms, fitted.values))
    return there, fitted.seen_in(there, fitted.training, fitted.noise)


def _fitted(
    problem: P,
    terms: Terms,
    options: EngineOptions,
    values: Array | None,
    nuisance: Array | None,
    training: Mask | None,
    noise: NoiseModel | None,
    exact: bool,
    moving: bool,
    whitened: Whitened | None = None,
) -> tuple[P, Fit]:
    """The problem, relinearised at every step if `moving`, and the fit."""
    k = len(problem.precision)
    at = np.concatenate(
        [np.zeros(k) if nuisance is None else nuisance, np.zeros(terms.size) if values is None else values]
    )
    if training is None:
        training = np.ones(problem.samples, bool)
    if noise is None:
        noise = white_noise(problem.groups)
    precision = np.concatenate([problem.precision, prior_precision(problem, terms.terms)])
    rounding = _EXACT_ROUNDING if exact else ROUNDING
    of_models = whitened or Whitened()
    buffer = np.zeros((0, problem.rows, problem.samples))

    def residual(where: P, numbers: Array) -> Array:
        return where.residual(numbers[:k], terms, numbers[k:])

    def prior(where: P, numbers: Array) -> Array:
        return np.concatenate([where.offset, np.zeros(terms.size)]) + numbers

    def columns_at(where: P, numbers: Array, rows: Array) -> Sequence[Array | Factored]:
        if exact:
            return [noise.whitened(_differences(where, terms, numbers, rows, _DIFFERENCE))]
        near = linearised_at(where, numbers[:k])
        if noise.white:
            return _parts(near, terms, numbers[k:])
        return of_models.columns(near, terms, numbers[k:], noise)

    def informed(columns: Sequence[Array | Factored], weight: Array) -> _Information:
        nonlocal buffer
        root = np.sqrt(weight)
        dense = [part for part in columns if not isinstance(part, Factored)]
        if len(dense) == len(columns):
            if len(buffer) != len(at):  # written again and again: new memory takes as long as the products
                buffer = np.empty((len(at), problem.rows, problem.samples))
            parts: list[Array | Factored] = [weighed_columns(dense, root, buffer)]
        else:
            parts = [part.weighed(root) if isinstance(part, Factored) else part * root for part in columns]
        return _Information(columns, weight, gram(parts))

    def differs(where: P, numbers: Array, others: Array) -> bool:
        """Tells whether columns at some numbers differ from those at others by the nuisance."""
        return linearised_at(where, numbers[:k] - others[:k]) is not where

    bounds = _bounds(problem, terms)
    floor = float(problem.floored)
    settled = _EXACT_SETTLED if exact else options.fit.settled
    state = weighed(residual(problem, at), noise, training, floor)
    converged = stalled = False
    H = np.eye(0)
    damped = 0.0
    last: Array | None = None
    columns: Sequence[Array | Factored] | None = None
    weight = np.zeros((problem.rows, problem.samples))
    information = _Information(None, weight, H)
    taken = at
    most_steps = _EXACT_STEPS if exact else options.fit.steps
    far_steps = 0
    for step_number in range(most_steps + _FAR_STEPS):
        far = differs(problem, at, taken)
        far_steps += far
        if step_number - far_steps >= most_steps:
            break
        if columns is None or exact or far or _apart(terms, at[k:], taken[k:], options.fit.stale):
            columns = columns_at(problem, at, state.rows)
            taken = at
        if not sum(map(len, columns)):
            converged = True
            break
        weight = np.where(training, state.row_weight, 0.0)
        if columns is not information.columns or _differ(weight, information.weight):
            information = informed(columns, weight)
        gradient = pulled(columns, weight * state.innovations) + precision * prior(problem, at)
        H = information.products + np.diag(precision)
        full = -scaled_solve(H, gradient, rounding)
        length = float(np.sqrt(max(-full @ gradient, 0.0)))
        before = _cost(state.innovations, state, training) + _square(precision, prior(problem, at))
        fresh = np.array_equal(at[k:], taken[k:]) and not differs(problem, at, taken)
        trial = at
        rows = state.rows
        cost = np.inf
        gains = list[float]()
        stretch = 1.0 if last is None else _stretch(full, last, H)
        for step, damping in _steps(
            H, gradient, full, stretch, rounding, damped, options, gains if problem.curved else None
        ):
            if problem.curved and _predicted_gain(step, gradient, H) < (_VISIBLE * options.fit.settled) ** 2:
                continue
            trial = at + step
            trial[k:] = np.clip(trial[k:], *bounds)
            rows = residual(problem, trial)
            cost = _cost(noise.whitened(rows), state, training) + _square(precision, prior(problem, trial))
            gains.append(before - cost)
            least = 0.5 * length**2 if stretch > 1 and len(gains) == 1 else -1e-9 * abs(before)
            if before - cost >= least:
                if fresh:
                    damped = damping
                break
            if length < settled:
                converged = True
                break
        else:
            if fresh:
                stalled = True
                break  # derivatives at the point of linearisation lead no further
            columns = None
            last = None
            continue
        if converged:
            break
        last = full if step is full else None
        at = trial
        if moving and not problem.curved and length > _SHORT:
            problem = problem.relinearised(at[:k], (terms, at[k:]))
            at = taken = np.concatenate([np.zeros(k), at[k:]])
            rows = residual(problem, at)
            columns = None
            moved_cost = _cost(noise.whitened(rows), state, training) + _square(precision, prior(problem, at))
            # what is computed where a problem is linearised has no derivatives: steps may stay long at the end
            moving = before - moved_cost > 2 * _LEAST_GAIN
        state = weighed(rows, noise, training, floor)
        if length < settled:
            converged = True
            break
        if before - cost < options.fit.settled**2:
            break  # where derivatives are inexact, steps may stay long and change nothing
    if columns is None:
        columns = columns_at(problem, at, state.rows)
    if len(H) and (columns is not information.columns or weight is not information.weight):
        H = informed(columns, weight).products + np.diag(precision)
    factor = variance_factor(state.squares[training], problem.rows, FREEDOM, 0)
    inverse = scaled_inverse(H, rounding) if len(H) else H
    covariance = inverse[k:, k:] * factor if len(H) else np.zeros((0, 0))
    effective = 0.0
    if len(H):
        effective = float(len(H) - np.sum(precision * np.diagonal(inverse)))
    penalty = _square(precision, prior(problem, at))
    volume = _volume_of_processes(H, precision, terms) + _shared_by_names(H, inverse, terms, CONFOUNDED)
    rest = covariance, state, training, effective, converged, noise, penalty, volume, stalled
    return problem, Fit(terms, at[:k], problem.offset, at[k:], *rest)


def _differ(weight: Array, other: Array) -> bool:
    """Tells whether weights differ by more than steps need."""
    return bool(np.sum(np.abs(weight - other)) > _SAME_WEIGHTS * np.sum(weight))


def _volume_of_processes(H: Array, precision: Array, terms: Terms) -> float:
    """½ ln of the determinant of the processes' precision beside all other numbers, over that of their prior.

    Args:
        H: `(number, number)`, the normal equations with the priors; the nuisance first.
        precision: `(number,)` of the priors.
        terms: of the model.
    """
    sizes = [one.size for one in terms.terms]
    processes = np.repeat(np.array([one.nonparametric for one in terms.terms], bool), sizes)
    acting = np.concatenate([np.zeros(len(precision) - len(processes), bool), processes]) & (precision > 0)
    if not acting.any() or not len(H):
        return 0.0
    beside = schur_complement(H, np.flatnonzero(~acting))[np.ix_(acting, acting)]
    root = np.sqrt(precision[acting])
    return 0.5 * float(np.linalg.slogdet(beside / np.outer(root, root))[1])


def _shared_by_names(H: Array, inverse: Array, terms: Terms, confounded: float) -> float:
    """What the volumes of names, each beside all others, leave out of the volume of all terms together.

    That of a name counts the information that it has beside all others. With A the information of all names beside the
    nuisance alone, and Aₙ that of a name beside all others, what is left out is ½ (ln det A − Σ ln det Aₙ). Of two
    numbers of the correlation ρ it is −½ ln(1 − ρ²).

    Args:
        H: `(number, number)`, the normal equations with the priors; the nuisance first.
        inverse: of H.
        terms: of the model.
        confounded: share of a direction's information that is left beside others, from which on it is determined.
    """
    if len(terms.terms) < 2 or not len(H):
        return 0.0
    count = len(H) - terms.size
    names = [np.arange(part.start, part.stop) for term, part in terms.pairs if not term.nonparametric]
    acting = np.concatenate([np.arange(count), *(count + numbers for numbers in names)])
    beside_nuisance = schur_complement(H[np.ix_(acting, acting)], np.arange(count))[count:, count:]
    shared = 0.0
    directions = []
    place = 0
    for numbers in names:
        here = slice(place, place + len(numbers))
        place += len(numbers)
        at = count + numbers
        size = np.sqrt(np.maximum(H[at, at], np.finfo(float).tiny))
        eigenvalues, V = np.linalg.eigh(beside_nuisance[here, here] / np.outer(size, size))
        determined = eigenvalues > confounded
        root = np.sqrt(eigenvalues[determined])
        # in these directions its information beside the nuisance is the identity
        direction = np.zeros((len(root), len(acting) - count))
        direction[:, here] = (V[:, determined] / root).T / size
        directions.append(direction)
        coordinates = (V[:, determined] * root).T * size
        variances = np.linalg.eigvalsh(coordinates @ inverse[np.ix_(at, at)] @ coordinates.T)
        shared += np.sum(np.log(np.clip(variances, 1.0, 1 / confounded)))
    if names:
        turned = np.concatenate(directions)
        eigenvalues = np.linalg.eigvalsh(turned @ beside_nuisance @ turned.T)
        shared += np.sum(np.log(np.maximum(eigenvalues, confounded)))
    return 0.5 * float(max(shared, 0.0))


def _apart(terms: Terms, values: Array, others: Array, share: float) -> bool:
    """Tells whether a term's numbers are so far from others that derivatives there differ; a term may jump anywhere."""
    moved = (values - others) / terms.typical
    size = others / terms.typical
    apart = (np.linalg.norm(moved[part]) > share * np.linalg.norm(size[part]) for part in terms.slices)
    return _may_jump(terms) or any(apart)


def _bounds(problem: LinearisedProblem, terms: Terms) -> tuple[Array, Array]:
    """The least and the most `(number,)` that a fit makes of the numbers of terms: none where residuals are linear.

    Beyond the limits of a term that is curved, such as friction that is less than none, residuals say nothing of it.
    """
    limits = np.array([pair for term in terms.terms for pair in problem.limits(term)], float).reshape(-1, 2)
    if problem.curved:
        return limits[:, 0], limits[:, 1]
    return np.full(len(limits), -np.inf), np.full(len(limits), np.inf)


def _steps(
    H: Array,
    gradient: Array,
    full: Array,
    stretch: float,
    rounding: float,
    damped: float,
    options: EngineOptions,
    gains: Sequence[float] | None,
) -> Iterator[tuple[Array, float]]:
    """The steps to try, each with its damping, until one improves the fit: the full one, halves of it, damped ones.

    Where numbers are nearly confounded, errors of the derivatives turn a full step far along what the data hardly
    determine, and halves of it point the same way. Damping bounds the step along these combinations alone (D.
    Marquardt, Journal of the Society for Industrial and Applied Mathematics 11, 1963). Once `damped`, a fit goes on
    with at least that damping. Where residuals are curved, each takes long to evaluate: a step is halved further only
    if by the parabola through the first two gains a shorter one gains, and a damped one must be another. Steps of the
    numbers that depend on each other alone are tried at last: one part at a kink holds the others up.

    Args:
        H: `(number, number)`, the normal equations.
        gradient: `(number,)`.
        full: `(number,)`, the undamped step.
        stretch: times this step, which is tried before it.
        rounding: relative eigenvalue below which a direction is rounding.
        damped: the damping of the step before.
        options: with the damping factors.
        gains: of the steps that were tried, in log-likelihood, to which the caller adds each; None where residuals are
            not curved.
    """
    if not damped:
        if stretch > 1:
            yield stretch * full, 0.0
        yield full, 0.0
        for k in range(1, _HALVINGS + 1):
            yield full / 2**k, 0.0
            if gains is not None and k == 1 and len(gains) > 1 and 4 * gains[-1] <= gains[-2]:
                break
    steps = [(full, 0.0)]
    last = None if damped else full
    for damping in options.damping:
        if damping >= damped:
            more = H.copy()
            more[np.diag_indices_from(H)] *= 1 + damping
            step = -scaled_solve(more, gradient, rounding)
            steps.append((step, damping))
            if gains is None or last is None or np.linalg.norm(step - last) > _ANOTHER * np.linalg.norm(last):
                last = step
                yield steps[-1]
    if gains is None:
        return
    count, part_of = scipy.sparse.csgraph.connected_components(H != 0, directed=False)
    if count > 1:
        yield from ((np.where(part_of == k, step, 0.0), damped) for step, _ in steps for k in range(count))


def _stretch(full: Array, last: Array, H: Array) -> float:
    """Times a full step that a fit goes, whose steps become shorter by the same share each.

    Weights of Student's t and its scale follow the estimate, so that the error of a step is a share ρ of the one
    before: all steps to come are together 1 / (1 − ρ) of this one (A. Aitken, Proceedings of the Royal Society of
    Edinburgh 46, 1926).

    Args:
        full: `(number,)`, the step.
        last: `(number,)`, the full step before.
        H: `(number, number)`, the normal equations, in which steps are compared.
    """
    share = float(full @ H @ last) / max(float(last @ H @ last), 1e-300)
    across = full - share * last
    if not _LEAST_SHARE < share < _MOST_SHARE or across @ H @ across > _ACROSS * (full @ H @ full):
        return 1.0
    return 1 / (1 - share)


def _predicted_gain(step: Array, gradient: Array, H: Array) -> float:
    """The log-likelihood that a step gains where residuals are linear."""
    return float(-step @ gradient - 0.5 * step @ H @ step)


def weighed(rows: Array, noise: NoiseModel, training: Mask, least: float = 0.0) -> Residuals:
    """Residuals with the scale of each group, from the training samples, and the weights of Student's t.

    Args:
        rows: `(row, sample)`, over the declared noise.
        noise: their model.
        training: `(sample,)`.
        least: that the white part of the noise is: 1 where that is not less than declared.
    """
    innovations = noise.whitened(rows)
    groups = noise.groups
    scale = noise.least_scales(least)
    weight = np.empty((len(noise.models), rows.shape[1]))
    for group in range(len(scale)):
        part = innovations[groups == group]
        squares = np.sum(part**2, 0)
        shown = t_scale(squares[training], len(part), FREEDOM) / gaussian_t_scale(len(part), FREEDOM)
        scale[group] = max(shown, scale[group])
        weight[group] = (FREEDOM + len(part)) / (FREEDOM + squares / scale[group] ** 2)
    return Residuals(rows, innovations, scale, weight, groups)


def _parts(problem: LinearisedProblem, terms: Terms, values: Array) -> list[Array | Factored]:
    """As `linear_columns`, with the columns of terms of many numbers factored where they can be."""
    many = [problem.factored(term) if term.size >= _MANY else None for term in terms.terms]
    if not any(many):
        return [linear_columns(problem, terms, values)]
    base = problem.nuisance_columns(terms, values)
    found: list[Array | Factored] = [base] if len(base) else []
    for term, part, factored in zip(terms.terms, terms.slices, many, strict=True):
        found.append(factored or problem.columns([term], values[part], beside=(terms, values)))
    return found


def linear_columns(problem: LinearisedProblem, terms: Terms, values: Array) -> Array:
    """How residuals change with the nuisance and then with the numbers of terms, `(number, row, sample)`, new."""
    base = problem.nuisance_columns(terms, values)
    if terms.size:
        return np.concatenate([base, problem.columns(terms.terms, values)])
    return base.copy()


def _cost(innovations: Array, at: Residuals, training: Mask) -> float:
    """Twice the negative log-likelihood at the scales of `at`."""
    total = 0.0
    for group, scale in enumerate(at.scale):
        part = innovations[at.groups == group][:, training]
        total += (FREEDOM + len(part)) * float(np.sum(np.log1p(np.sum(part**2, 0) / scale**2 / FREEDOM)))
    return total


def _square(precision: Array, off: Array) -> float:
    return float(np.sum(precision * off**2))


def _differences(problem: LinearisedProblem, terms: Terms, at: Array, rows: Array, step: float) -> Array:
    """Derivatives `(number, row, sample)` of the residuals by all numbers at `at`, where they are `rows`."""
    k = len(at) - terms.size
    columns = np.empty((len(at), *rows.shape))
    for i, size in enumerate(np.concatenate([np.full(k, step), step / _TYPICAL * terms.typical])):
        moved = at.copy()
        moved[i] += size
        columns[i] = (problem.residual(moved[:k], terms, moved[k:]) - rows) / size
    return columns
