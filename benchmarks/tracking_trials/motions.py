"""What arms are commanded to do: sines, trapezoids, steps, chirps and holds. Shares no code with the library."""

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.tracking_trials.arms import Arm
from benchmarks.tracking_trials.physics import Commands

MOTIONS = ("multisine", "trapezoids", "steps", "chirp", "holds")
_FASTEST = 1.5  # rad/s
_STILL = 0.2  # s at the beginning of a run
_SINES = 4


def draw_commands(rng: np.random.Generator, arm: Arm, kinds: tuple[str, ...], rate: float, samples: int) -> Commands:
    """Runs of some kinds, each so many samples long at so many Hz."""
    period = 1 / rate
    time = np.arange(samples) * period
    moved = np.maximum(time - _STILL, 0.0)
    u = np.stack([_moved(rng, arm, kind, moved, period) for kind in kinds])
    begins = np.arange(len(kinds)) * (samples * period + 1.0)
    return Commands(period, u, begins, rng.random((len(kinds), samples)))


def _moved(rng: np.random.Generator, arm: Arm, kind: str, time: Array, period: float) -> Array:
    """`(sample, joint)` rad."""
    u = np.empty((len(time), arm.chain.dof))
    for joint in range(arm.chain.dof):
        wave = _WAVES[kind](rng, time, period, float(arm.reach[joint]))
        u[:, joint] = arm.middle[joint] + np.clip(wave, -1.0, 1.0) * arm.reach[joint]
    return np.round(u, 6)


def _multisine(rng: np.random.Generator, time: Array, period: float, reach: float) -> Array:
    pulse = 2 * np.pi * rng.uniform(0.1, 1.0, _SINES)
    amplitude = rng.dirichlet([2.0] * _SINES) * rng.uniform(0.5, 0.9)
    amplitude *= min(1.0, _FASTEST / (reach * float(np.sum(amplitude * pulse))))
    phase = rng.uniform(-np.pi, np.pi, _SINES)
    return np.sum(amplitude * np.sin(pulse * time[:, None] + phase), 1)


def _trapezoids(rng: np.random.Generator, time: Array, period: float, reach: float) -> Array:
    """From one place to the next with an even velocity, softened over 0.1 s."""
    count = int(time[-1] / 0.6) + 2
    knots = np.cumsum(rng.uniform(0.6, 1.6, count))
    places = _places(rng, count, reach)
    wave = np.interp(time, np.concatenate([[0.0], knots]), np.concatenate([[0.0], places]))
    return _softened(wave, 0.1, period)


def _steps(rng: np.random.Generator, time: Array, period: float, reach: float) -> Array:
    """Steps of a few hundredths of a radian."""
    count = int(time[-1] / 0.4) + 2
    knots = np.cumsum(rng.uniform(0.4, 1.2, count))
    heights = np.cumsum(rng.choice([-1.0, 1.0], count) * rng.uniform(0.02, 0.12, count)) / reach
    heights = np.abs(np.mod(heights + 1, 4) - 2) - 1  # thrown back at the ends of its reach
    heights -= heights[0]
    return heights[np.minimum(np.searchsorted(knots, time, side="right"), count - 1)]


def _chirp(rng: np.random.Generator, time: Array, period: float, reach: float) -> Array:
    slow, fast = rng.uniform(0.1, 0.3), rng.uniform(1.0, 3.0)
    span = max(float(time[-1]), 1e-6)
    angle = 2 * np.pi * (slow * time + 0.5 * (fast - slow) * time**2 / span)
    pulse = 2 * np.pi * (slow + (fast - slow) * time / span)
    amplitude = np.minimum(rng.uniform(0.2, 0.6), _FASTEST / (reach * pulse))
    return amplitude * np.sin(angle)


def _holds(rng: np.random.Generator, time: Array, period: float, reach: float) -> Array:
    """Places that are held for a second, and reached in half of one."""
    count = int(time[-1] / 1.2) + 2
    ends = np.cumsum(np.stack([rng.uniform(0.5, 0.9, count), rng.uniform(0.5, 1.2, count)], 1).ravel())
    places = np.repeat(_places(rng, count, reach), 2)
    wave = np.interp(time, np.concatenate([[0.0], ends]), np.concatenate([[0.0], places]))
    return _softened(wave, 0.15, period)


_WAVES = {
    "multisine": _multisine,
    "trapezoids": _trapezoids,
    "steps": _steps,
    "chirp": _chirp,
    "holds": _holds,
}


def _places(rng: np.random.Generator, count: int, reach: float) -> Array:
    """In parts of the reach, none further from the last than the fastest way allows."""
    most = min(0.9, 0.4 * _FASTEST / reach)
    places = [0.0]
    for _ in range(count):
        places.append(float(np.clip(places[-1] + rng.uniform(-most, most), -0.9, 0.9)))
    return np.array(places[1:])


def _softened(wave: Array, seconds: float, period: float) -> Array:
    """A mean over so many seconds before."""
    count = max(round(seconds / period), 1)
    padded = np.concatenate([np.full(count - 1, wave[0]), wave])
    return np.convolve(padded, np.full(count, 1 / count), "valid")
