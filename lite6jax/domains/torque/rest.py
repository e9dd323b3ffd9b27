"""Joints at rest: where friction holds them anywhere within a band, the torque of the motor is indeterminate."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from lite6jax.arms.arm import as_revolute
from lite6jax.domains.torque.rows import TorqueRows
from lite6jax.effects.dynamic.torque_effect import DIRECTION_SPEED, direction
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.recordings.sequence import stretches

Array = NDArray[np.floating]
Flags = NDArray[np.bool_]

_LONG = 0.25
"""s for which a joint rests at least; a reversal takes less."""
_FEWEST = 10
"""Filtered samples at rest that it takes to say anything."""
_ROWS_PER_NUMBER = 3
"""Filtered samples in motion for each number of the model with which those at rest are compared."""
_AWAY = 3.0
"""Times what is left in motion, from which what is left at rest is no noise."""
_BAND = 2.0
"""Times Coulomb friction, up to which static friction holds a joint: what is more has another cause."""


class Held(NamedTuple):
    """What friction holds at rest.

    Attributes:
        slack: `(joint, sample)` Nm of every sample, one sigma of the torque that is indeterminate, times the square
            root of the samples of a rest, which are not independent; zero in motion, but beside a rest.
        found: the data fault, if a joint is held.
    """

    slack: Array
    found: tuple[DataFault, ...]


def at_rest(data: TorqueRows) -> Flags:
    """`(joint, sample)`, whether a joint rests for a quarter of a second or more around each sample."""
    speed = np.abs(as_revolute(np.asarray(data.motion.joint_velocity), "rad/s", data.arm.slides))
    slow = speed <= DIRECTION_SPEED
    least = max(int(np.ceil(_LONG * data.filter.rate)), 2)
    runs = data.filter.runs
    still = np.zeros_like(slow)
    for row, out in zip(slow, still, strict=True):
        for rows in stretches(row, runs):
            out[rows] = rows.stop - rows.start >= least
    return still


def held_by_friction(data: TorqueRows) -> Held:
    """The slack of torques at rest: of joints whose torque there is far from a model of their torque in motion.

    The model has inertial numbers, offset, friction and rotor of the joint and its neighbours, fitted to the samples in
    motion. What it leaves at rest is compared with what it leaves in motion, and with the Coulomb friction found there.
    """
    still = at_rest(data)
    near = _around(still, data)
    slack = np.zeros(still.shape)
    kept = data.filter.kept
    joints, bands = [], []
    for j in range(len(still)):
        rest = still[j, kept]
        band = _left_at_rest(data, j, rest, ~near[j, kept]) if rest.sum() >= _FEWEST else 0.0
        if band:
            for span in stretches(near[j], data.filter.runs):
                # one rest is one torque, however many samples show it
                slack[j, span] = band * np.sqrt(max((span.stop - span.start) / data.filter.every, 1.0))
            joints.append(j + 1)
            bands.append(band)
    if not joints:
        return Held(slack, ())
    recording = data.recording
    rows = row_numbers(recording.row[still[np.array(joints) - 1].any(0)])
    numbers: dict[str, list] = {"joints": joints, "std_Nm": bands}
    if data.arm.sliding:
        numbers["prismatic_joints"] = [joint for joint in joints if data.arm.slides[joint - 1]]
    return Held(slack, (DataFault("held_by_friction", rows, numbers),))


def _around(still: Flags, data: TorqueRows) -> Flags:
    """`(joint, sample)`, rest and the samples beside it, where the low pass of the motion says when a joint starts."""
    reach = 2 * int(np.ceil(data.filter.rate / data.motion_cutoff)) + 1
    return maximum_filter1d(still.astype(np.uint8), reach, axis=1).astype(bool)


def _left_at_rest(data: TorqueRows, j: int, rest: Flags, moving: Flags) -> float:
    """Nm RMS that a model of a joint in motion leaves at rest; 0 where that is noise, or more than friction holds."""
    velocity = np.asarray(data.motion.joint_velocity)[:, data.filter.kept]
    acceleration = np.asarray(data.motion.joint_acceleration)[j, data.filter.kept]
    slides = data.arm.slides
    near = [k for k in (j - 1, j + 1) if 0 <= k < len(velocity) and slides[k] == slides[j]]
    X = np.concatenate(
        [
            direction(velocity[j], slides[j])[None],  # first: its number is Coulomb friction
            *(part[None] for part in (np.ones(len(acceleration)), velocity[j], acceleration)),
            *(np.stack([velocity[k], direction(velocity[j] + velocity[k], slides[j])]) for k in near),
            data.regressor[j],
        ]
    )
    size = np.linalg.norm(X, axis=1)
    X = X[size > 0] / size[size > 0, None]
    if moving.sum() < _ROWS_PER_NUMBER * len(X):
        return 0.0
    y = data.measured[j]
    U, s, V = np.linalg.svd(X[:, moving].T, full_matrices=False)
    known = s > 1e-8 * s[0]
    into = (V[known].T / s[known]) @ U[:, known].T
    numbers = into @ y[moving]
    left = y - numbers @ X
    usual = 1.4826 * float(np.median(np.abs(left[moving])))
    doubt = np.sqrt(1 + np.sum(((V[known] @ X[:, rest]) / s[known, None]) ** 2, 0))  # of a row that was not fitted
    away = float(np.sqrt(np.mean((left[rest] / doubt) ** 2)))
    coulomb = abs(float(numbers[0])) / float(size[0])
    if away < _AWAY * usual or coulomb < usual or np.median(np.abs(left[rest])) > _BAND * coulomb:
        return 0.0
    return float(np.sqrt(np.mean(left[rest] ** 2)))
