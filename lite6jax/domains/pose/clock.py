"""A clock that is off by seconds: found by how fast the tool moves, which no frame, tool or geometry changes much."""

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.problem import Case
from lite6jax.effects.composition import Physics
from lite6jax.recordings.recording import run_segments

Array = NDArray[np.floating]

_FEWEST = 50
_LEAST_SAMPLES = 3
"""An offset of fewer samples is found as any other effect is."""
_ALIKE = 0.5
"""Correlation of the speeds, under which their likeness means nothing."""
_BETTER = 0.1
_MOST_OF_RUN = 0.5


def clock_offset(case: Case) -> float:
    """By how many seconds the poses show the arm later than their stamps say, where that is several samples; else 0."""
    recording = case.recording
    if recording.motion != "trajectory" or recording.time is None or case.samples < _FEWEST:
        return 0.0
    predicted = case.position_errors(np.zeros(len(case.unknown)), Physics(), np.zeros(0))
    measured = np.asarray(case.measured.position)
    predicted = predicted + measured
    dt = float(np.median(np.diff(recording.time)[np.diff(recording.time) > 0]))
    runs = run_segments(recording.run)
    found: list[tuple[Array, Array]] = []
    for number in range(runs[-1] + 1):
        rows = runs == number
        t = recording.time[rows]
        if t.size >= _FEWEST and (np.diff(t) > 0).all():
            grid = np.arange(t[0], t[-1], dt)
            found.append((_speed(t, measured[:, rows], grid), _speed(t, predicted[:, rows], grid)))
    if not found:
        return 0.0
    most = int(_MOST_OF_RUN * max(len(speed) for speed, _ in found))
    lags = np.arange(-most, most + 1)
    products, squares = np.zeros(len(lags)), np.zeros((2, len(lags)))
    for one, other in found:
        size = len(one)
        there = np.abs(lags) < size - _FEWEST // 2
        lag = lags[there]
        first, last = np.maximum(-lag, 0), np.minimum(size, size - lag)  # of the part of a run that overlaps
        sums = _between(one, first, last), _between(other, first + lag, last + lag)
        count = last - first
        spectra = np.conj(np.fft.rfft(one, 2 * size)) * np.fft.rfft(other, 2 * size)
        products[there] += np.fft.irfft(spectra, 2 * size)[lag] - sums[0] * sums[1] / count
        squares[0, there] += _between(one**2, first, last) - sums[0] ** 2 / count
        squares[1, there] += _between(other**2, first + lag, last + lag) - sums[1] ** 2 / count
    likeness = products / np.sqrt(np.maximum(squares.prod(0), 1e-300))
    best = int(np.argmax(likeness))
    if abs(lags[best]) < _LEAST_SAMPLES or likeness[best] < max(_ALIKE, likeness[most] + _BETTER):
        return 0.0
    return float(lags[best] * dt)


def _speed(time: Array, position: Array, grid: Array) -> Array:
    at = np.stack([np.interp(grid, time, row) for row in position])
    return np.linalg.norm(np.gradient(at, axis=1), axis=0)


def _between(values: Array, first: NDArray[np.integer], last: NDArray[np.integer]) -> Array:
    total = np.cumsum(np.pad(values, (1, 0)))
    return total[last] - total[first]
