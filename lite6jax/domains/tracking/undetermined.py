"""What a log of commands does not determine: effects that do not show in its motion, or not apart from each other."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from lite6jax.array_types import Integers
from lite6jax.domains.tracking.ranges import resting_loads, run_ends
from lite6jax.domains.tracking.rows import SAME, TrackingRows
from lite6jax.effects.catalogue import Untestable, tracking_catalogue
from lite6jax.effects.drivers import Driver
from lite6jax.effects.dynamic import BaseTilt, CoulombFriction, LinkCom, LinkMass, LoadFriction, PayloadTorque
from lite6jax.effects.effect import Effect, OfJoint
from lite6jax.effects.servo import (
    CommandDelay,
    CommandFilter,
    DeadBand,
    EncoderBacklash,
    EncoderOffset,
    RateLimit,
    ServoFeedforward,
    ServoStiffness,
)

_WITHIN_NOISE = 10.0
"""Standard deviations of the noise: the range of the read-outs of a joint at rest is less."""
_REVERSES = 0.01
"""Of the range of a command, by which it goes back in a reversal."""
_LEAST_REVERSAL = 1e-3
"""rad, likewise at least."""
_REST = 0.2
"""s, for which a command holds still in a rest."""
_CONSTANT = 0.1
"""Of the mean weight on a joint, its standard deviation where the weight hardly varies."""
_LEAST_WEIGHT = 1e-3
"""Nm, RMS: the weight on a joint whose axis is upright is less."""
LOADED = (PayloadTorque, BaseTilt, LoadFriction, LinkMass, LinkCom)
"""Effects that need masses."""
_AT_REST = (ServoStiffness, EncoderOffset)
"""Effects that show at a joint at rest, as one number."""
_OF_COMMANDS = (CommandDelay, CommandFilter, RateLimit, ServoFeedforward)
"""Effects that change nothing where the command is constant."""


class Undetermined(NamedTuple):
    """Effects that a log does not show, or not apart from each other, for one reason.

    Attributes:
        lacks: what the log does not have: "motion", "command", "reversal", "rest" or "load" of the joints; or "masses".
        joints: from 1; none of masses.
        effects: by name.
    """

    lacks: str
    joints: tuple[int, ...]
    effects: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """As values that JSON can hold."""
        return {"lacks": self.lacks, "joints": list(self.joints), "effects": list(self.effects)}


def untestable_effects(data: TrackingRows, effects: Sequence[Effect]) -> tuple[Untestable, ...]:
    """The effects that a log does not show at all, with what they depend on.

    Among `effects` they are those of joints at rest, but for a constant shift, and those that change commands which
    never move. Those of loads that are not known are added.
    """
    resting = set((1 + _resting(data)).tolist())
    held = set((1 + _held(data)).tolist())
    at_rest = [
        Untestable(effect, Driver("velocity", effect.joint))
        for effect in effects
        if isinstance(effect, OfJoint)
        and (
            (effect.joint in resting and not isinstance(effect, _AT_REST))
            or (effect.joint in held and isinstance(effect, _OF_COMMANDS))
        )
    ]
    of_loads = []
    if not data.has_masses:
        loaded = [effect for effect in tracking_catalogue(data.arm.dof) if isinstance(effect, LOADED)]
        joints = [effect.joint if isinstance(effect, OfJoint) else 1 for effect in loaded]
        of_loads = [Untestable(effect, Driver("gravity torque", j)) for effect, j in zip(loaded, joints, strict=True)]
    return (*at_rest, *of_loads)


def undetermined(data: TrackingRows) -> list[Undetermined]:
    """What a log does not determine, by reason."""
    joints = np.arange(len(data.measured))
    resting = _resting(data)
    held = _held(data)
    moving = np.setdiff1d(joints, held)
    reverses = np.array([_reverses(data, joint) for joint in moving.tolist()], bool)
    weights = resting_loads(data.bodies, data.measured)
    # none where masses are not known
    weighed = np.flatnonzero(np.sqrt(np.mean(weights**2, 1)) > _LEAST_WEIGHT)
    steady = np.flatnonzero(np.std(weights, 1) < _CONSTANT * np.abs(np.mean(weights, 1)))
    constant = np.setdiff1d(np.intersect1d(steady, weighed), resting)
    of_joint = [effect for effect in tracking_catalogue(1) if isinstance(effect, OfJoint)]
    of_load = [ServoStiffness.name, EncoderOffset.name]
    if len(constant) and not len(np.setdiff1d(weighed, constant)):
        of_load.append(PayloadTorque.name)
    friction = CoulombFriction.name
    reasons = [
        ("motion", resting, [effect.name for effect in of_joint if not isinstance(effect, _AT_REST)]),
        ("command", np.setdiff1d(held, resting), [kind.name for kind in _OF_COMMANDS]),
        ("reversal", moving[~reverses], [friction, DeadBand.name, EncoderBacklash.name]),
        ("rest", _restless(data, moving[reverses]), [friction, EncoderBacklash.name]),
        ("load", constant, of_load),
    ]
    listed = [
        Undetermined(lacks, tuple((1 + concerned).tolist()), tuple(names))
        for lacks, concerned, names in reasons
        if len(concerned)
    ]
    if not data.has_masses:
        listed.append(Undetermined("masses", (), tuple(kind.name for kind in LOADED)))
    return listed


def _held(data: TrackingRows) -> Integers:
    """The joints, from 0, whose commands never move."""
    return np.flatnonzero(np.ptp(np.asarray(data.recording.commanded_position), 0) < SAME)


def _resting(data: TrackingRows) -> Integers:
    """Those of them whose read-outs move by no more than noise; others give way to the motion of the arm."""
    # of joints at rest read-outs differ from row to row by noise alone, also where it is not declared
    differences = np.median(np.abs(np.diff(data.measured, axis=1)), 1)
    noise = np.maximum(data.noise, differences)
    still = np.flatnonzero(np.ptp(data.measured, 1) < _WITHIN_NOISE * noise)
    return np.intersect1d(_held(data), still)


def _reverses(data: TrackingRows, joint: int) -> bool:
    """Tells whether the command of a joint, from 0, goes to and fro in any run."""
    command = np.asarray(data.recording.commanded_position)[:, joint]
    least = max(_REVERSES * float(np.ptp(command)), _LEAST_REVERSAL)
    for first, last in zip(*run_ends(data.recording.run), strict=True):
        part = command[first:last]
        fallen = float(np.max(np.maximum.accumulate(part) - part))
        risen = float(np.max(part - np.minimum.accumulate(part)))
        if min(fallen, risen) > least:
            return True
    return False


def _restless(data: TrackingRows, joints: Integers) -> Integers:
    """The joints, of some counted from 0, whose command never holds still."""
    command = np.asarray(data.recording.commanded_position)[:, joints]
    steps = max(1, round(_REST / data.commands.period))
    holds = (np.abs(np.diff(command, axis=0)) < SAME) & (np.diff(data.recording.run) == 0)[:, None]
    counted = np.cumsum(np.concatenate([np.zeros((1, len(joints)), int), holds]), 0)
    if len(counted) <= steps:
        return joints
    longest = np.max(counted[steps:] - counted[:-steps], 0)
    return joints[longest < steps]
