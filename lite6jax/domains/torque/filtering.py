"""Filtering: smooth motions with accelerations, and one zero-phase low pass for both sides of the equation of motion.

Raw noise is never differentiated into a regressor: velocities are low-passed before they are differentiated. Measured
and modelled torques then pass the same filter, and one row in several is kept, so that noise that was white stays white
(parallel filtering; M. Gautier, Dynamic identification of robots with power model, ICRA 1997).
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple, final

import numpy as np
import scipy  # whose parts are imported where they are first used: `signal` alone takes most of a second
from scipy.ndimage import median_filter

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.errors import InputError
from lite6jax.fields import field_values
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault
from lite6jax.recordings.sequence import run_segments

_ORDER = 4
"""Of the Butterworth filter; run forwards and backwards."""
_RESOLVED = 5.12
"""s of a segment of a spectrum: what it resolves is then the same at every sampling rate."""
_ABOVE_FLOOR = 10.0
"""Power spectral density over its floor from which a quantity is taken as signal."""
_BANDWIDTH = 0.99
"""Share of the velocity's power within the motion's bandwidth."""
_WIDEST = 32.0
"""Cutoff of torques over the bandwidth of the motion: friction changes within a fraction of a period.

The evidence of a Stribeck curve of twice its threshold was 8.9 at 16 and is 16.4 at 32.
"""
_NARROWEST = 4.0
"""The same where a recording is long, so that no more than `_MOST_ROWS` are kept."""
_LEAST_CUTOFF = 10.0
"""Hz; motors' ripple in slow motions."""
_MOST_ROWS = 1500
_MODELLED = 5
"""Samples at which torques are modelled for each one that is kept, at least."""
_FEWEST = 32
"""Samples of a run; shorter ones have no spectrum."""
_DISTINCT = 0.5
"""Share of the rows that have a time of their own, below which the times were rounded."""
_CUBIC = 5
"""Fewest samples from which a cubic is estimated."""
_UNEVEN = 0.2
"""Deviation of time steps from their median, over it, from which sampling is not uniform."""
_GAP = 1.8
"""Time steps over their median from which samples are missing, so that a new run begins."""
_BRIDGED = 0.125
"""Of the shortest period of the motion, over which samples are interpolated at most."""
_SMOOTHER = 0.5
"""Of the squares that are left, from which the one of two time scales is clearly the right one."""
_BENDS = 4.0
"""Times the usual deviation of a step of torque from the steps around it, from which torques bend in it."""
_SPIKE = 8.0
"""Standard deviations from the median of neighbouring samples from which a torque is a spike."""
_TURNING = 0.01
"""rad/s below which noise of the velocity hides the direction of motion."""


class Smoothed(NamedTuple):
    """A motion without the noise of its encoders, `(joint, sample)` each.

    Attributes:
        position: rad.
        velocity: rad/s.
        acceleration: rad/s².
        cutoff: Hz, of the low pass.
    """

    position: Array
    velocity: Array
    acceleration: Array
    cutoff: float


@final
@dataclass(frozen=True, eq=False)
class LowPass:
    """The filter that measured and modelled torques both pass.

    Attributes:
        rate: samples per second.
        cutoff: Hz, half the rate of what is kept.
        every: one sample in so many is kept.
        runs: `(sample,)` int, which run a sample belongs to.
        kept: indices of the samples that are kept; those near the ends of a run are not.
    """

    rate: float
    cutoff: float
    every: int
    runs: Integers
    kept: Integers

    def whole(self, rows: Array) -> Array:
        """Rows `(…, sample)` low-passed, every sample of them."""
        if self.every == 1:
            return rows
        return _by_run(rows, self.runs, self.cutoff, self.rate)

    def __call__(self, rows: Array) -> Array:
        """Rows `(…, sample)` low-passed, and of them the samples that are kept."""
        return self.whole(rows)[..., self.kept]


def sample_rate(recording: Recording) -> float:
    """Samples per second.

    Raises:
        InputError: no times, times that were rounded, or steps that vary.
    """
    steps = _steps(recording)
    step = float(np.median(steps))
    if _vary(steps):
        low, high = np.percentile(steps, (5, 95))
        raise InputError(
            f"{recording.source}: its time steps vary, most of them from {low:.3g} to {high:.3g} s; record at a "
            "constant rate, or resample it"
        )
    return 1 / step


def _vary(steps: Array) -> bool:
    step = np.median(steps)
    usual = steps[steps < _GAP * step]
    return bool(np.mean(np.abs(usual - step) > _UNEVEN * step) > 0.05 or len(usual) < 0.8 * len(steps))


def _steps(recording: Recording) -> Array:
    """s, those of a recording that are not zero; raises as `sample_rate`."""
    if recording.time is None:
        raise InputError(f"{recording.source}: has torques without times; add time_s, one row per sample of a motion")
    steps = np.diff(recording.time)[np.diff(recording.run) == 0]
    moments = 1 + int(np.count_nonzero(steps > 0))
    if moments < _DISTINCT * recording.samples:
        raise InputError(
            f"{recording.source}: its {recording.samples} rows have only {moments} different times; write the times "
            "with all their digits, or number the rows by the rate, such as time_s = row / 100"
        )
    steps = steps[steps > 0]
    if steps.size < _FEWEST:
        raise InputError(f"{recording.source}: {recording.samples} rows are too few; record a motion of some seconds")
    return steps


class Even(NamedTuple):
    """A recording at even times.

    Attributes:
        recording: itself where its times are even.
        fault: what was wrong with its times; None where they are even.
        doubt: `(joint, sample)` Nm, one sigma of torques that were interpolated where they bend, as friction does where
            a joint turns back; 0 where nothing was interpolated.
    """

    recording: Recording
    fault: DataFault | None = None
    doubt: Array | float = 0.0


def evenly_timed(recording: Recording) -> Even:
    """A recording at even times, and what was wrong with its own.

    Where positions are smooth over the number of the row and not over the time stamped, the stamps jitter, and are made
    even. Otherwise the samples do, and are interpolated, up to a gap of an eighth of the motion's shortest period.

    Args:
        recording: in the order of time, with velocities.

    Raises:
        InputError: no times, times that were rounded, or more gaps than motion.
    """
    steps = _steps(recording)
    if not _vary(steps):
        return Even(recording)
    assert recording.time is not None
    time = recording.time
    runs = run_segments(recording.run)
    step = float(np.median(steps))
    low, high = np.percentile(steps, (5, 95))
    timing = {"from_s": float(low), "to_s": float(high), "rate_Hz": 1 / step}
    if _stamps_jitter(recording.joint_position, time, runs, step):
        even = np.concatenate([_line(time[rows]) for rows in _each(runs)])
        return Even(replace(recording, time=even), DataFault("uneven_times", (), {"reason": "stamps"} | timing))
    longest = max(_each(runs), key=lambda rows: time[rows.stop - 1] - time[rows.start])
    grid = np.arange(float(time[longest.start]), float(time[longest.stop - 1]), step)
    alone = np.zeros(len(grid), int)
    velocities = recording.velocities()[longest].T
    band = max(_bandwidth(np.interp(grid, time[longest], row), alone, 1 / step) for row in velocities)
    gaps = np.diff(time, prepend=time[0]) > max(_GAP * step, _BRIDGED / band)
    pieces = run_segments(runs * (1 + len(gaps)) + np.cumsum(gaps))
    parts = [rows for rows in _each(pieces) if rows.stop - rows.start >= _FEWEST]
    if sum(rows.stop - rows.start for rows in parts) < 0.5 * recording.samples:
        raise InputError(
            f"{recording.source}: its time steps vary, most of them from {low:.3g} to {high:.3g} s, with gaps too long "
            "to interpolate this motion; record at a constant rate, or move slower"
        )
    at = [np.arange(float(time[r.start]), float(time[r.stop - 1]), step) for r in parts]
    numbers = timing | {"gaps": int(gaps.sum())}
    doubt = 0.0
    if recording.has_torques:
        torques = [recording.torques()[r] for r in parts]
        off = np.concatenate([_from_neighbours(rows, time[r]) for rows, r in zip(torques, parts, strict=True)])
        numbers["rms_Nm"] = np.sqrt(np.mean(off**2, 0)).tolist()
        doubt = np.concatenate([_doubt(rows, time[r], t) for rows, r, t in zip(torques, parts, at, strict=True)]).T
    fault = DataFault("uneven_times", (), {"reason": "samples"} | numbers)
    return Even(_interpolated(recording, parts, at), fault, doubt)


def _stamps_jitter(q: Array, time: Array, runs: Integers, step: float) -> bool:
    """Tells whether positions `(sample, joint)` are smoother over the number of the row than over the time."""
    rough = np.zeros(2)
    for rows in _each(runs):
        t = time[rows]
        y = q[rows]
        if len(t) < _CUBIC or np.diff(t).max() > _GAP * step:
            continue
        for k, x in enumerate((t, _line(t))):
            # the cubic through two neighbours on either side, at the sample between them
            near = np.stack([x[j : len(x) - 4 + j] for j in (0, 1, 3, 4)])
            middle = x[2:-2]
            weights = [
                np.prod([(middle - near[m]) / (near[j] - near[m]) for m in range(4) if m != j], axis=0)
                for j in range(4)
            ]
            interpolated = sum(w[:, None] * y[s : len(y) - 4 + s] for w, s in zip(weights, (0, 1, 3, 4), strict=True))
            rough[k] += np.sum((y[2:-2] - interpolated) ** 2)
    return bool(rough[1] < _SMOOTHER * rough[0])


def _line(time: Array) -> Array:
    """Times with even steps nearest to those of a run."""
    k = np.arange(len(time), dtype=float)
    return np.polyval(np.polyfit(k, time, 1), k) if len(time) > 1 else time


def _from_neighbours(torque: Array, time: Array) -> Array:
    """Torques `(sample, joint)` of every other sample less what its neighbours give."""
    inner = slice(1, (len(time) - 1) // 2 * 2, 2)
    return torque[inner] - scipy.interpolate.PchipInterpolator(time[::2], torque[::2])(time[inner])


def _doubt(torque: Array, time: Array, at: Array) -> Array:
    """`(sample, joint)` Nm, one sigma of torques that are interpolated at other times, where they bend in between.

    A jump of J somewhere between two samples is J / 2 of doubt; J is a step less what the steps around it lead to.
    """
    step = np.diff(time)[:, None]
    slope = np.pad(np.diff(torque, axis=0) / step, ((1, 1), (0, 0)), mode="edge")
    jump = np.abs(step * (slope[1:-1] - 0.5 * (slope[:-2] + slope[2:])))
    jump[jump < _BENDS * 1.4826 * np.median(jump, axis=0)] = 0.0
    return 0.5 * jump[np.clip(np.searchsorted(time, at, "right") - 1, 0, len(step) - 1)]


def _interpolated(recording: Recording, parts: Sequence[slice], at: Sequence[Array]) -> Recording:
    """The recording at other times, those of each part; poses are left out."""
    time = recording.time
    assert time is not None
    cubic = scipy.interpolate.CubicSpline
    monotone = scipy.interpolate.PchipInterpolator
    kinds: dict[str, Any] = {
        **dict.fromkeys(("joint_position", "joint_velocity", "joint_acceleration"), cubic),
        **dict.fromkeys(("joint_torque", "motor_current", "joint_temperature", "commanded_position"), monotone),
    }
    nearest = [
        part.start + np.rint(np.interp(t, time[part], np.arange(part.stop - part.start))).astype(int)
        for part, t in zip(parts, at, strict=True)
    ]
    arrays: dict[str, Any] = {"position": None, "quaternion": None, "time": np.concatenate(at)}
    recorded = field_values(recording)
    for name, kind in kinds.items():
        rows = recorded[name]
        if rows is not None:
            arrays[name] = np.concatenate([kind(time[part], rows[part])(t) for part, t in zip(parts, at, strict=True)])
    for name in ("direction_of_motion", "ambient_temperature", "payload", "row"):
        rows = recorded[name]
        if rows is not None:
            arrays[name] = rows[np.concatenate(nearest)]
    return replace(recording, run=np.repeat(np.arange(len(parts)), [len(t) for t in at]), **arrays)


def runs_of(recording: Recording, rate: float) -> Integers:
    """`(sample,)`, a number for each run; a gap in time begins a new one."""
    assert recording.time is not None
    gaps = np.diff(recording.time, prepend=recording.time[0]) > _GAP / rate
    return run_segments(run_segments(recording.run) * (1 + len(gaps)) + np.cumsum(gaps))


def smoothed(recording: Recording, chosen: LowPass, cutoff: float | None = None) -> Smoothed:
    """The motion low-passed up to where its velocities exceed their noise, with accelerations.

    Args:
        recording: a trajectory with times and velocities.
        chosen: the filter of torques, far above which there is no need of velocities.
        cutoff: Hz, of the low pass; by the noise of the velocities where not given.
    """
    rate = chosen.rate
    runs = chosen.runs
    q = recording.joint_position.T
    v = np.asarray(recording.velocities()).T
    if cutoff is None:
        cutoff = 1.5 * max(_signal_band(row, runs, rate, chosen.cutoff) for row in v)
        cutoff = float(np.clip(cutoff, 2.0, min(2 * chosen.cutoff, 0.4 * rate)))
    position, velocity = (_by_run(x, runs, cutoff, rate) for x in (q, v))
    recorded_acceleration = recording.joint_acceleration
    if recorded_acceleration is not None:
        return Smoothed(position, velocity, _by_run(recorded_acceleration.T, runs, cutoff, rate), cutoff)
    acceleration = np.zeros_like(velocity)
    for rows in _each(runs):
        if rows.stop - rows.start > 2:
            # central differences of fifty samples a second lose half a per cent of a motion of 1.5 Hz
            t = np.arange(rows.stop - rows.start) / rate
            acceleration[:, rows] = scipy.interpolate.CubicSpline(t, velocity[:, rows], axis=1)(t, 1)
            _mend_ends(acceleration[:, rows], v[:, rows], cutoff, rate)
    return Smoothed(position, velocity, acceleration, cutoff)


def _mend_ends(acceleration: Array, velocity: Array, cutoff: float, rate: float) -> None:
    """Puts the slope of a local cubic of the recorded velocities at both ends of a run.

    The low pass follows the noise of the first and the last velocity, and its slope there is several times too large.
    """
    period = int(np.ceil(rate / cutoff))
    # farther inside, the low pass is as exact
    near = 2 * period
    window = max(period | 1, _CUBIC)
    if velocity.shape[1] >= max(2 * near, window):
        slope = scipy.signal.savgol_filter(velocity, window, 3, deriv=1, delta=1 / rate)
        acceleration[:, :near], acceleration[:, -near:] = slope[:, :near], slope[:, -near:]


def low_pass(velocity: Array, rate: float, runs: Integers) -> LowPass:
    """The filter for the torques of a motion, by the spectrum of its velocities.

    Args:
        velocity: `(joint, sample)` rad/s, as recorded.
        rate: samples per second.
        runs: `(sample,)`.
    """
    band = max(_bandwidth(row, runs, rate) for row in velocity)
    widest_cutoff = max(_WIDEST * band, _LEAST_CUTOFF)
    coarse_decimation = min(-(-velocity.shape[1] // _MOST_ROWS), int(rate / (2 * _NARROWEST * band)))
    decimation = max(int(rate / (2 * widest_cutoff)), coarse_decimation, 1)
    decimation -= decimation % _stride(decimation)
    cutoff = rate / (2 * decimation)
    return LowPass(
        rate, cutoff, decimation, runs, _kept(runs, decimation, 0 if decimation == 1 else int(np.ceil(rate / cutoff)))
    )


def _stride(decimation: int) -> int:
    return max(decimation // _MODELLED, 1)


def modelled(recorded: LowPass) -> tuple[LowPass, Integers]:
    """The filter of modelled torques, and the recorded rows `(sample,)` at which they are modelled.

    Of fast recordings these are one in several, of which the filter still keeps no more than one in `_MODELLED`. Both
    filters keep the same moments.

    Args:
        recorded: the filter of measured torques, which are of every row.
    """
    stride = _stride(recorded.every)
    at = np.concatenate([np.arange(r.start, r.stop, stride) for r in _each(recorded.runs)])
    kept_indices = np.searchsorted(at, recorded.kept)
    decimation = recorded.every // stride
    rate = recorded.rate / stride
    return replace(recorded, rate=rate, every=decimation, runs=recorded.runs[at], kept=kept_indices), at


def each_posture(samples: int) -> LowPass:
    """The filter of postures at rest, one a row: nothing is filtered, and each is a run of its own."""
    rows = np.arange(samples)
    return LowPass(rate=1.0, cutoff=0.5, every=1, runs=rows, kept=rows)


def without_ends(chosen: LowPass, motion_cutoff: float) -> LowPass:
    """The filter that keeps no sample near the ends of a run, where a motion low-passed at so many Hz is inexact."""
    margin = int(np.ceil(chosen.rate / min(motion_cutoff, chosen.cutoff)))
    return replace(chosen, kept=_kept(chosen.runs, chosen.every, margin))


def _kept(runs: Integers, decimation: int, margin: int) -> Integers:
    stride = _stride(decimation)
    margin = -(-margin // stride) * stride  # so that what is kept is among the rows of the model
    enough = (rows for rows in _each(runs) if rows.stop - rows.start >= _FEWEST * stride)
    parts = [np.arange(rows.start + margin, rows.stop - margin, decimation) for rows in enough]
    return np.concatenate([np.zeros(0, int), *parts])


def spikes(torque: Array, velocity: Array, runs: Integers) -> Mask:
    """`(joint, sample)` bool, single torques, or two in a row, far from their neighbours, which agree.

    Of outliers at one sample in a hundred, some follow each other; a push lasts longer. Two in a row are none where the
    joint turns back: friction may do the same there.
    """
    spiked = np.zeros(torque.shape, bool)
    for rows in _each(runs):
        part = torque[:, rows]
        if part.shape[1] < _FEWEST:
            continue
        off = np.zeros_like(part)
        off[:, 1:-1] = np.abs(part[:, 1:-1] - 0.5 * (part[:, :-2] + part[:, 2:]))
        step = np.abs(np.roll(part, -1, 1) - np.roll(part, 1, 1))  # of a level that changes, the neighbours differ
        # of quantised torques most differences are zero
        typical = np.maximum(1.4826 * np.median(off, axis=1), 0.1 * off.mean(1))[:, None]
        away = np.abs(part - median_filter(part, (1, 5), mode="nearest"))
        # the neighbours of a spike are off from their middle by half as much
        alone = off >= np.maximum(np.roll(off, 1, 1), np.roll(off, -1, 1))
        threshold = _SPIKE * np.maximum(typical, 1e-12)
        spiked[:, rows] = alone & (step < 0.5 * off) & (np.minimum(off, away) > threshold)
        before, first, second, after = (part[:, k : part.shape[1] - 3 + k] for k in range(4))
        middle = 0.5 * (before + after)
        lower = np.minimum(np.abs(first - middle), np.abs(second - middle))
        pair = (np.abs(after - before) < 0.5 * lower) & (lower > threshold)
        pair &= np.minimum(away[:, 1:-2], away[:, 2:-1]) > threshold
        speeds = [velocity[:, rows][:, k : part.shape[1] - 3 + k] for k in range(4)]
        pair &= (np.min(speeds, 0) > _TURNING) | (np.max(speeds, 0) < -_TURNING)
        at = spiked[:, rows]
        at[:, 1:-2] |= pair
        at[:, 2:-1] |= pair
    return spiked


def without_spikes(torque: Array, spiked: Mask) -> Array:
    """Torques `(joint, sample)`, spikes replaced by interpolation between their neighbours."""
    out = torque.copy()
    at = np.arange(torque.shape[1])
    for row, bad in zip(out, spiked, strict=True):
        if bad.any():
            row[bad] = np.interp(at[bad], at[~bad], row[~bad])
    return out


def interpolant(rows: Array, time: Array, runs: Integers) -> "list[tuple[slice, scipy.interpolate.CubicSpline]]":
    """A cubic spline in time of rows `(joint, sample)`, for each run of more than one sample."""
    return [
        (r, scipy.interpolate.CubicSpline(time[r], rows[:, r], axis=1))
        for r in _each(runs)
        if r.stop - r.start >= _FEWEST
    ]


def _each(runs: Integers) -> list[slice]:
    edges = [0, *(np.flatnonzero(np.diff(runs)) + 1).tolist(), len(runs)]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def _by_run(rows: Array, runs: Integers, cutoff: float, rate: float) -> Array:
    """Each run low-passed on its own, without shift in time."""
    sections = _sections(cutoff, rate)
    out = np.array(rows, float)
    for part in _each(runs):
        length = part.stop - part.start
        if length >= _FEWEST:
            pad = min(int(3 * rate / cutoff) + 1, length - 1)
            out[..., part] = scipy.signal.sosfiltfilt(sections, rows[..., part], padlen=pad)
    return out


@cache
def _sections(cutoff: float, rate: float) -> Array:
    return scipy.signal.butter(_ORDER, cutoff, fs=rate, output="sos")


def spectra(rows: Array, chosen: LowPass) -> tuple[Array, Array]:
    """Frequencies in Hz, without zero, and power spectral densities `(row, frequency)` of rows `(row, sample)`."""
    spectra_by_row = [_spectrum(row, chosen.runs, chosen.rate) for row in rows]
    return spectra_by_row[0][0][1:], np.stack([power[1:] for _, power in spectra_by_row])


def _spectrum(row: Array, runs: Integers, rate: float) -> tuple[Array, Array]:
    """Frequencies and power spectral density of the longest run."""
    longest = max(_each(runs), key=lambda r: r.stop - r.start)
    part = row[longest]
    return scipy.signal.welch(part - part.mean(), rate, nperseg=min(len(part), round(_RESOLVED * rate)))


def _signal_band(row: Array, runs: Integers, rate: float, cutoff: float) -> float:
    """Hz up to which a row exceeds the floor of its spectrum.

    The floor is that of the octave above the `cutoff` in Hz of torques. Controllers low-pass the velocities that they
    differentiate, so that at the highest frequencies there is less noise than at those that matter.
    """
    f, power = _spectrum(row, runs, rate)
    first = min(int(np.searchsorted(f, cutoff)), len(f) // 2)
    floor = float(np.median(power[first : max(2 * first, first + 1)]))
    above = np.flatnonzero(power[:first] > _ABOVE_FLOOR * max(floor, 1e-300))
    return float(f[above[-1]]) if above.size else float(f[1])


def _bandwidth(row: Array, runs: Integers, rate: float) -> float:
    """Hz within which nearly all of a row's power lies."""
    f, power = _spectrum(row, runs, rate)
    total = np.cumsum(power)
    if total[-1] > 0:
        return float(max(f[np.searchsorted(total, _BANDWIDTH * total[-1])], f[1]))
    return float(f[1])
