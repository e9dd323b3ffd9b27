"""What differs from one simulated arm to the next: its geometry, where the sensor stands, and the random numbers."""

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.errors import InputError

Array = NDArray[np.floating]

LENGTH_TOLERANCE = 0.8e-3
ANGLE_TOLERANCE = float(np.deg2rad(0.15))
"""One standard deviation of each length (m) and angle (rad) of a calibrated Lite 6 about its nominal value."""

_PURPOSES = ("motion", "calibration", "uncertainty", "frame", "position", "orientation", "joints", "outliers")


def generator(seed: int, purpose: str) -> np.random.Generator:
    """A generator of its own for each purpose, so that another sensor leaves the motion as it was.

    Raises:
        InputError: a negative seed.
    """
    if seed < 0:
        raise InputError(f"seed {seed}: give zero or more")
    return np.random.default_rng([seed, _PURPOSES.index(purpose)])


def draw_calibration(
    arm: Arm, seed: int = 0, *, length: float = LENGTH_TOLERANCE, angle: float = ANGLE_TOLERANCE
) -> Array:
    """The kinematics of one arm as manufactured: the nominal one with a normal error in each number.

    Args:
        arm: the nominal arm.
        seed: of the random numbers.
        length: standard deviation of the error of x, y and z, m.
        angle: standard deviation of the error of roll, pitch and yaw, rad.

    Returns:
        `(joint, 6)` x y z roll pitch yaw of each joint's frame in the previous one, m and rad.

    Raises:
        InputError: a negative seed.
    """
    return perturbed(arm.kinematics, length, angle, seed, "calibration")


def perturbed(kinematics: Array, length: float, angle: float, seed: int, purpose: str = "uncertainty") -> Array:
    """Kinematics `(joint, 6)` with normal errors of standard deviation `length` (m) or `angle` (rad) in each number."""
    return kinematics + np.array([length] * 3 + [angle] * 3) * generator(seed, purpose).standard_normal(
        kinematics.shape
    )


def draw_sensor_frame(seed: int = 0) -> Array:
    """The base's pose in the frame of a sensor that stands 1.5 to 3 m away.

    Any rotation about the vertical is equally likely; the tilt is at most 10° about each horizontal axis.

    Returns:
        `(4, 4)` T_sensor_base, m.

    Raises:
        InputError: a negative seed.
    """
    rng = generator(seed, "frame")
    distance, bearing, yaw = rng.uniform(1.5, 3.0), *rng.uniform(-np.pi, np.pi, 2)
    roll, pitch = rng.uniform(-1, 1, 2) * np.deg2rad(10)
    x, y = distance * np.cos(bearing), distance * np.sin(bearing)
    return frames.transform_from_row([x, y, rng.uniform(-1.0, 0.5), roll, pitch, yaw])
