"""Commands that servoed joints follow to where they are wanted: the inverse of a rollout, by repeating it.

What a rollout leaves, e, is put back into the commands through an inverse of how each joint answers a command where
nothing sticks and nothing saturates, with the response H(f) of its read-out to one held sample:

    u ← u + share · F⁻¹[ H*(f)·E(f) / (|H(f)|² + λ·max|H|²) ]

It looks ahead, and so undoes delay and lag as well as sag. λ bounds what it amplifies: fast motion that a joint cannot
follow is not asked of it. Friction, limits and play are not in H; repeated rollouts find what they take. A change of a
joint's commands holds only where its error falls, otherwise less is tried.
"""

from collections.abc import Callable
from typing import NamedTuple, final

import numpy as np

from lite6jax.array_types import Array
from lite6jax.domains.tracking.rollout import hold_commands, roll
from lite6jax.effects.servo import UNLIMITED, Servo

_ROUNDS = 12
"""Changes at most: the first leaves a fiftieth of the error where no joint sticks, further ones less and less."""
_DAMPINGS = (1e-3, 1e-2, 1e-1)
"""λ, the first of which amplifies by 16 at most, the last by 1.6."""
_SHARES = (1.0, 0.5, 0.25)
"""Of the change, with each λ."""
_LEAST_GAIN = 0.05
"""Share of a joint's error that a change must take for further ones to be tried."""
_SETTLED = 2e-3
"""Of the error of the commands as they were, below which it is not reduced further: no model is nearer."""
_LEAST = 1e-6
"""rad RMS, likewise."""
_LONGEST = 4.0
"""s, of a response at most."""
_AROUND = 1.0
"""s, by which an error is continued before its first sample and after its last: what belongs there goes to these."""
_BEYOND = 2.0
"""Lag and delay take commands that are ahead by about the error; more is for what a joint cannot do."""
_PULSE = 1e-3
"""rad."""
_INERTIA = 1e-9
"""kg·m², of a joint at least."""


@final
class FollowedCommands(NamedTuple):
    """Commands, and where the joints are by them.

    Attributes:
        command: `(sample, joint)` rad.
        position: `(sample, joint)` rad.
    """

    command: Array
    position: Array


def responses(servo: Servo, mass: Array, period: float, longest: float, interpolated: bool = False) -> Array:
    """`(joint, sample)`, the read-out of each joint to a command of 1 that holds for the first sample.

    Args:
        servo: each `(joint,)`.
        mass: `(joint,)` kg·m², of what each joint moves, without its rotor.
        period: s.
        longest: s, of an integration step.
        interpolated: whether commands go on a line to the next; then the command rises to 1 before that sample, and
            falls after it.
    """
    zero = np.zeros_like(mass)
    limits = dict.fromkeys(("rate_limit", "torque_limit"), zero + UNLIMITED)
    free = (*("dead_band", "coulomb", "stribeck", "load_friction", "backlash", "torque_droop", "clock_rate"), "offset")
    absent = (*free, "sine", "cosine", "spring_torque")
    linear = servo._replace(**limits, **dict.fromkeys(absent, zero))
    samples = max(int(_LONGEST / period), 2)
    command = np.zeros((samples, len(mass)))
    command[0] = _PULSE
    # before a run its first command holds: the pulse begins with the second sample
    command = np.vstack([np.zeros_like(command[:1]), command])
    run = np.zeros(len(command), int)
    commands = hold_commands(command, run, period, np.zeros_like(command), None, interpolated, longest)
    nothing = np.zeros((len(mass), commands.samples * commands.steps))
    inertia = nothing + np.maximum(mass, _INERTIA)[:, None]
    return roll(linear, commands, np.arange(len(mass)), nothing, inertia).readout[:, 1:] / _PULSE


def correct(
    follow: Callable[[Array], Array], wanted: Array, response: Array, period: float, limits: Array
) -> FollowedCommands:
    """Commands by which joints are where they are wanted, or nearer to it.

    Args:
        follow: positions `(sample, joint)` rad, by commands of that shape.
        wanted: `(sample, joint)` rad, of one run on an even grid.
        response: as of `responses`.
        period: s.
        limits: `(joint, 2)` rad, of commands; where a joint is wanted beyond them, what is wanted.
    """
    around = max(int(_AROUND / period), 1)
    best = FollowedCommands(wanted.copy(), follow(wanted))
    farthest = _BEYOND * np.max(np.abs(wanted - best.position), 0)
    lower = np.maximum(wanted - farthest, np.minimum(limits[:, 0], wanted))
    upper = np.minimum(wanted + farthest, np.maximum(limits[:, 1], wanted))
    error = _rms(wanted - best.position)
    enough = np.maximum(_SETTLED * error, _LEAST)
    tried = np.zeros(wanted.shape[1], int)
    steps = [(damping, share) for damping in _DAMPINGS for share in _SHARES]
    for _ in range(_ROUNDS):
        moving = (error > enough) & (tried < len(steps))
        if not moving.any():
            break
        command = best.command.copy()
        for joint in np.flatnonzero(moving).tolist():
            damping, share = steps[tried[joint]]
            left = wanted[:, joint] - best.position[:, joint]
            command[:, joint] += share * _undone(left, response[joint], around, damping)
        command = np.clip(command, lower, upper)
        position = follow(command)
        after = _rms(wanted - position)
        better = moving & (after < (1 - _LEAST_GAIN) * error)
        tried = np.where(moving & ~better, tried + 1, tried)
        if not better.any():
            continue
        if np.any(moving & ~better):
            command = np.where(better, command, best.command)
            position = follow(command)
        error = _rms(wanted - position)
        best = FollowedCommands(command, position)
    return best


def _rms(error: Array) -> Array:
    """`(joint,)` of `(sample, joint)`; infinite where it is not finite."""
    squares = np.mean(np.square(error), 0)
    return np.sqrt(np.where(np.isfinite(squares), squares, np.inf))


def _undone(error: Array, response: Array, around: int, damping: float) -> Array:
    """`(sample,)` rad of command that takes an error `(sample,)` rad away, the response as of `responses`."""
    samples = len(error)
    length = samples + 2 * around + len(response)
    back = np.linspace(error[-1], error[0], len(response) + 2)[1:-1]
    whole = np.concatenate([np.full(around, error[0]), error, np.full(around, error[-1]), back])
    H = np.fft.rfft(response, length)
    size = np.abs(H) ** 2
    change = np.fft.irfft(np.conj(H) * np.fft.rfft(whole) / (size + damping * size.max()), length)
    return change[around : around + samples]
