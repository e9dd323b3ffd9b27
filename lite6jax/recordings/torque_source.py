"""Whether torques are measured: a controller that computes them by a model of its arm sends them without any noise."""

from dataclasses import dataclass, field
from typing import final

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from lite6jax.recordings.recording import Recording
from lite6jax.recordings.sequence import run_segments

WINDOW = 50
"""Rows over which an arm is at rest or not: a fifth of a second of a Lite 6's reports."""
STILL_RAD = 1e-4
"""The range of each joint's position in a window at rest: encoders have some noise."""
NOISELESS = 1e-4
"""Range of a torque in a window at rest over its largest magnitude, below which it has no noise: sensors and currents
have a hundredth, and the range of a joint's position changes gravity's torque by this much."""
QUANTISED = 1e-3
"""Smallest step of a torque over its largest magnitude, from which its noise may be lost in rounding."""
FEWEST = 4
"""Windows at rest that it takes to say anything."""


@final
@dataclass(eq=False)
class TorqueNoise:
    """What windows of `WINDOW` rows show of the noise of torques, while they are recorded or afterwards.

    Attributes:
        ranges: `(joint,)` Nm for each window at rest.
        largest: `(joint,)` Nm, magnitudes in all windows.
        step: `(joint,)` Nm, the smallest change from row to row that is not zero.
    """

    ranges: list[NDArray[np.floating]] = field(default_factory=list)
    largest: NDArray[np.floating] | float = 0.0
    step: NDArray[np.floating] | float = np.inf

    def add(self, position: Float[np.ndarray, "row joint"], torque: Float[np.ndarray, "row joint"]) -> None:
        """One window of consecutive rows: rad and Nm; one with numbers that are not finite says nothing."""
        if not (np.isfinite(position).all() and np.isfinite(torque).all()):
            return
        self.largest = np.maximum(self.largest, np.abs(torque).max(0))
        steps = np.abs(np.diff(torque, axis=0))
        self.step = np.minimum(self.step, np.where(steps > 0, steps, np.inf).min(0, initial=np.inf))
        if np.ptp(position, axis=0).max() <= STILL_RAD:
            self.ranges.append(np.ptp(torque, axis=0))

    @property
    def absent(self) -> bool:
        """Whether the torques of an arm at rest are constant, and known finely enough for that to be no rounding."""
        if len(self.ranges) < FEWEST or not np.any(self.largest):
            return False
        acting = np.asarray(self.largest) > 0
        usual, largest = np.quantile(self.ranges, 0.9, axis=0)[acting], np.asarray(self.largest)[acting]
        step = np.asarray(self.step)[acting]
        rounded = np.isfinite(step) & (step > QUANTISED * largest)
        return bool((usual <= NOISELESS * largest).all() and not rounded.any())


def estimated_torque(recording: Recording) -> bool:
    """Whether the recorded torques have no noise at all: the controller's own model, which says nothing of the motors.

    False where there are no torques, where the arm is nowhere at rest for so long that it would show, and where the
    steps of the torques are so coarse that they may hide noise.
    """
    noise = TorqueNoise()
    if recording.joint_torque is None:
        return False
    segment = run_segments(recording.run)
    for rows in np.split(np.arange(recording.samples), np.flatnonzero(np.diff(segment)) + 1):
        for start in range(0, len(rows) - WINDOW + 1, WINDOW):
            window = rows[start : start + WINDOW]
            noise.add(recording.joint_position[window], recording.joint_torque[window])
    return noise.absent
