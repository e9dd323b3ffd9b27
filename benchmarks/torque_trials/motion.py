"""Motions of an arm: sums of sines within its limits, temperatures, a payload; and where they are at any other time."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.torque_trials.arms import Arm

Curve = Callable[[Array], tuple[Array, Array, Array]]
"""`(sample, joint)` rad, rad/s and rad/s² at `(sample,)` s."""

AMBIENT = 25.0
"""°C."""
_SINES = 5
_REACH = 1.5
"""rad, the most that a joint moves to either side of its middle."""
_SLACK = 0.9
"""The share of its limits that a motion uses at most."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What an arm does, as it is.

    Attributes:
        time: `(sample,)` s.
        q: `(sample, joint)` rad.
        dq: `(sample, joint)` rad/s.
        ddq: `(sample, joint)` rad/s².
        temperature: `(sample, joint)` °C.
        payload: `(sample,)` kg, as declared.
        curve: the motion at any time.
    """

    time: Array
    q: Array
    dq: Array
    ddq: Array
    temperature: Array
    payload: Array
    curve: Curve

    def later(self, offset: float) -> "Motion":
        """The motion that is so many seconds ahead, at the same times."""

        def curve(time: Array) -> tuple[Array, Array, Array]:
            return self.curve(time + offset)

        q, dq, ddq = curve(self.time)
        return replace(self, q=q, dq=dq, ddq=ddq, curve=curve)

    def thinned(self, every: int) -> "Motion":
        """Every so many samples of it."""
        names = ("time", "q", "dq", "ddq", "temperature", "payload")
        return replace(self, **{name: getattr(self, name)[::every] for name in names})


def draw_motion(
    rng: np.random.Generator,
    arm: Arm,
    rate: float,
    seconds: float,
    speed: float = 1.0,
    warming: bool = False,
    payload: float = 0.0,
    resting: int = 0,
) -> Motion:
    """A motion of five sines a joint within the limits of position, velocity and acceleration.

    Frequencies are `speed` times the usual ones; where it is `warming`, each joint grows warmer in its own way, and
    cooler again; so many of the first joints are `resting`.
    """
    time = np.arange(round(rate * seconds)) / rate
    dof = arm.chain.dof
    lower, upper = np.maximum(arm.chain.limits[:, 0], -np.pi), np.minimum(arm.chain.limits[:, 1], 1.7 * np.pi)
    middle, reach = (lower + upper) / 2, np.minimum((upper - lower) / 2, _REACH)
    highest = rng.uniform(0.4, 1.0)
    pulse = 2 * np.pi * rng.uniform(0.05, highest, (_SINES, dof)) * speed
    amplitude = rng.dirichlet([2.0] * _SINES, dof).T * rng.uniform(0.6, _SLACK, dof) * reach
    for limit, power in ((arm.velocity, 1), (arm.acceleration, 2)):
        amplitude *= np.minimum(1.0, _SLACK * limit / np.sum(amplitude * pulse**power, 0))
    amplitude[:, :resting] = 0.0
    phase = rng.uniform(-np.pi, np.pi, (_SINES, dof))

    def curve(at: Array) -> tuple[Array, Array, Array]:
        angle = pulse * at[:, None, None] + phase
        sine, cosine = np.sin(angle), np.cos(angle)
        return (
            middle + np.sum(amplitude * sine, 1),
            np.sum(amplitude * pulse * cosine, 1),
            -np.sum(amplitude * pulse**2 * sine, 1),
        )

    temperature = np.full((len(time), dof), AMBIENT)
    if warming:
        turns, start = rng.uniform(1.0, 2.5, dof), rng.uniform(-np.pi, np.pi, dof)
        grown = rng.uniform(6, 15, dof) * (1 - np.exp(-3 * time[:, None] / time[-1]))
        waves = np.sin(2 * np.pi * turns * time[:, None] / time[-1] + start) - np.sin(start)
        temperature = temperature + grown + rng.uniform(2, 4, dof) * waves
    temperature = temperature + rng.normal(0, 0.05, temperature.shape)
    return Motion(time, *curve(time), temperature, np.full(len(time), payload), curve)
