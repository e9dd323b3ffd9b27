"""A clock that is off by seconds: found by how fast the tool moves, which no frame, tool or geometry changes much."""

import numpy as np
from numpy.typing import NDArray

from lite6jax.diagnosis.case import Case
from lite6jax.physics.composition import Physics
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
    total: Array = np.zeros(1)
    energy = np.zeros(2)
    longest = 0
    runs = np.zeros(case.samples, int) if recording.run is None else run_segments(recording.run)
    for number in range(runs[-1] + 1):
        segment = runs == number
        t = recording.time[segment]
        if t.size < _FEWEST or not (np.diff(t) > 0).all():
            continue
        grid = np.arange(t[0], t[-1], dt)
        speeds = [_speed(t, p[:, segment], grid) for p in (measured, predicted)]
        length = 2 * len(grid)
        one, other = (np.fft.rfft(speed - speed.mean(), length) for speed in speeds)
        correlation = np.fft.irfft(np.conj(one) * other, length)
        folded = np.concatenate([correlation[-len(grid) :], correlation[: len(grid)]])
        if len(folded) > len(total):
            total = np.pad(total, ((len(folded) - len(total)) // 2,)) if longest else np.zeros(len(folded))
        middle = len(total) // 2
        total[middle - len(grid) : middle + len(grid)] += folded
        energy += [float(np.sum((speed - speed.mean()) ** 2)) for speed in speeds]
        longest = max(longest, len(grid))
    if not longest:
        return 0.0
    total = total / max(np.sqrt(energy.prod()), 1e-300)
    lags = np.arange(len(total)) - len(total) // 2
    near = np.abs(lags) < _MOST_OF_RUN * longest
    best = int(np.argmax(np.where(near, total, -1.0)))
    now = total[len(total) // 2]
    if abs(lags[best]) < _LEAST_SAMPLES or total[best] < max(_ALIKE, now + _BETTER):
        return 0.0
    return float(lags[best] * dt)


def _speed(time: Array, position: Array, grid: Array) -> Array:
    at = np.stack([np.interp(grid, time, row) for row in position])
    return np.linalg.norm(np.gradient(at, axis=1), axis=0)
