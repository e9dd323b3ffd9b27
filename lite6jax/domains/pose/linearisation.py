"""Where the search of a pose recording starts: at its clock offset, and under the load model that it supports.

A clock offset of many samples is found by the cross-correlation of measured and predicted speeds of the tool: errors of
frames, tool and geometry hardly change that speed.

Compliances deflect under all loads. In motion these are gravity and the inertia of the masses; the catalogue's
compliances are defined by gravity alone, and simulated recordings are made in either way. For small arms the two differ
by some per cent, which is many standard deviations of a large compliance. One arm has one load model.
"""

from dataclasses import replace

import numpy as np

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.pose.deflections import physics_of
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.estimation.least_squares import Fit, fit, relinearise
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms
from lite6jax.estimation.thresholds import CLOSE
from lite6jax.recordings.sequence import run_segments
from lite6jax.search.final_estimates import with_alternative
from lite6jax.search.search import Selection, at_estimate, select
from lite6jax.sensors.pose import PoseSensor

_FEWEST = 50
"""Samples of a run: with fewer a lag is not distinguished from chance."""
_LEAST_SAMPLES = 3
"""An offset of fewer samples is within reach of a score test, like any other effect."""
_CORRELATED = 0.5
"""Correlation of measured and predicted speed below which its maximum is not evidence of a lag."""
_BETTER = 0.1
"""Correlation that the lag must gain over none."""
_MOST_OF_RUN = 0.5
"""Largest lag as a share of the longest run: at larger ones too few samples overlap."""


def linearised(
    problem: PoseProblem, options: EngineOptions, training: Mask | None = None
) -> tuple[PoseProblem, PoseProblem]:
    """The problem at its clock offset, linearised at the geometry that fits best there, and the same without an offset.

    `training` `(sample,)` bool are the rows to use; all where not given.
    """
    offset = clock_offset(problem, training)
    reference = relinearise(problem, options, training)
    if not offset:
        return reference, reference
    return relinearise(replace(problem, clock_offset=offset, units={}), options, training), reference


def clock_offset(problem: PoseProblem, training: Mask | None = None) -> float:
    """The time from a pose's stamp to the instant at which it shows the arm, s, where that is several samples; else 0.

    The frames of the problem are near the true ones. Rows that are not for training divide a run.
    """
    recording = problem.recording
    moving = problem.recording.motion == "trajectory"
    if not moving or recording.time is None or problem.samples < _FEWEST or not problem.measured.reads_poses:
        return 0.0
    assert isinstance(problem.measured, PoseSensor)
    measured = problem.measured.position
    predicted = problem.rigid.tool[:, :3, 3].T
    used = np.ones(problem.samples, bool) if training is None else training
    dt = float(np.median(np.diff(recording.time)[np.diff(recording.time) > 0]))
    runs = run_segments(2 * run_segments(recording.run) + used)
    speeds: list[tuple[Array, Array]] = []
    for number in range(runs[-1] + 1):
        rows = (runs == number) & used
        t = recording.time[rows]
        if t.size >= _FEWEST and (np.diff(t) > 0).all():
            grid = np.arange(t[0], t[-1], dt)
            speeds.append((_speed(t, measured[:, rows], grid), _speed(t, predicted[:, rows], grid)))
    if not speeds:
        return 0.0
    longest_lag = int(_MOST_OF_RUN * max(len(speed) for speed, _ in speeds))
    lags = np.arange(-longest_lag, longest_lag + 1)
    products = np.zeros(len(lags))
    squares = np.zeros((2, len(lags)))
    for measured_speed, predicted_speed in speeds:
        size = len(measured_speed)
        overlapping = np.abs(lags) < size - _FEWEST // 2
        lag = lags[overlapping]
        # of the part of a run that overlaps
        first = np.maximum(-lag, 0)
        last = np.minimum(size, size - lag)
        sums = _between(measured_speed, first, last), _between(predicted_speed, first + lag, last + lag)
        count = last - first
        spectra = np.conj(np.fft.rfft(measured_speed, 2 * size)) * np.fft.rfft(predicted_speed, 2 * size)
        products[overlapping] += np.fft.irfft(spectra, 2 * size)[lag] - sums[0] * sums[1] / count
        squares[0, overlapping] += _between(measured_speed**2, first, last) - sums[0] ** 2 / count
        squares[1, overlapping] += _between(predicted_speed**2, first + lag, last + lag) - sums[1] ** 2 / count
    correlation = products / np.sqrt(np.maximum(squares.prod(0), 1e-300))
    peak = int(np.argmax(correlation))
    if abs(lags[peak]) < _LEAST_SAMPLES or correlation[peak] < max(_CORRELATED, correlation[longest_lag] + _BETTER):
        return 0.0
    return float(lags[peak] * dt)


def _speed(time: Array, position: Array, grid: Array) -> Array:
    at = np.stack([np.interp(grid, time, row) for row in position])
    return np.linalg.norm(np.gradient(at, axis=1), axis=0)


def _between(values: Array, first: Integers, last: Integers) -> Array:
    total = np.cumsum(np.pad(values, (1, 0)))
    return total[last] - total[first]


def search_load_model(
    problem: PoseProblem,
    reference: PoseProblem,
    options: EngineOptions,
    training: Mask | None = None,
) -> Selection:
    """The search under the more likely load model.

    It starts with the load model under which the best single effect is more likely. Where the terms found are more
    likely under the other, the search is repeated with that, as other terms may be still more likely there. If the
    terms found then are not, and the two load models are not distinguished, the first ones are refitted.
    Alternatives of terms are not determined. Arguments are as of `select`.
    """
    problem, reference = _first(problem, reference, options, training)
    selection = select(problem, options, training, reference)
    alternative = with_alternative(selection.problem, selection.state.fit, options)
    if alternative is None:
        return selection
    gain = alternative.gain_over(selection.state.fit)
    if gain <= 0:
        return selection
    other_problem, other_reference = _other(problem, reference)
    again = select(other_problem, options, training, other_reference)
    state = replace(selection.state, fit=alternative)
    if gain > CLOSE or again.evidence > replace(selection, state=state).evidence:
        return again
    thinned = selection.thinned
    if thinned is not None:
        refitted = with_alternative(thinned.problem, thinned.state.fit, options)
        assert refitted is not None
        thinned = _under_other_loads(thinned, refitted, options)
    return replace(_under_other_loads(selection, alternative, options), thinned=thinned)


def _under_other_loads(selection: Selection, fitted: Fit, options: EngineOptions) -> Selection:
    """A selection under the other load model, under which its terms were fitted."""
    assert isinstance(selection.problem, PoseProblem)
    assert isinstance(selection.reference, PoseProblem)
    problem, reference = _other(selection.problem, selection.reference)
    state = replace(selection.state, fit=fitted)
    return at_estimate(replace(selection, problem=problem, reference=reference, state=state), options)


def _other(problem: PoseProblem, reference: PoseProblem) -> tuple[PoseProblem, PoseProblem]:
    """Both with the other load model, where there is one."""
    turned = problem.with_other_loads()
    turned_reference = reference.with_other_loads()
    if turned is None or turned_reference is None:
        return (problem, reference)
    return (turned, turned_reference)


def _first(
    problem: PoseProblem, reference: PoseProblem, options: EngineOptions, training: Mask | None
) -> tuple[PoseProblem, PoseProblem]:
    """Both with the load model under which the most likely effect of loads has the higher likelihood."""
    turned = _other(problem, reference)
    loaded = [effect for effect in problem.candidates if physics_of(Terms((effect,))).loaded]
    if turned[0] is problem or not loaded:
        return problem, reference
    used = problem.valid if training is None else training & problem.valid
    baseline = fit(reference, Terms(), options, training=used)

    def best(case: PoseProblem) -> Fit:
        test = score_test(case, baseline, options)
        scored = zip(loaded, test.score(loaded), strict=True)
        effect, score = max(scored, key=lambda pair: pair[1].gain - 0.5 * pair[1].size * np.log(test.freedom))
        return fit(case, Terms((effect,)), options, score.values, baseline.nuisance, used)

    if best(turned[1]).gain_over(best(reference)) > 0:
        return turned
    return (problem, reference)
