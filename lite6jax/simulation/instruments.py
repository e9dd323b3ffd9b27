"""The sensors that a simulated recording is made with, and how their noise may differ from what is declared."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.design.sensor import SENSORS, Sensor
from lite6jax.errors import InputError
from lite6jax.recordings.settings import PoseSource

Array = NDArray[np.floating]


class Instrument(NamedTuple):
    """A sensor and its name in a sidecar."""

    sensor: Sensor
    pose_source: PoseSource


INSTRUMENTS: Mapping[str, Instrument] = MappingProxyType(
    {
        "tracker": Instrument(SENSORS["tracker"], "laser_tracker"),
        "tracker_6d": Instrument(SENSORS["tracker_6d"], "laser_tracker"),
        "motion_capture": Instrument(SENSORS["motion_capture"], "motion_capture"),
        "camera": Instrument(SENSORS["camera"], "camera"),
        # 32-bit floats on the wire: 3.4e-8 m on average, 6e-7 rad at most
        "controller_fk": Instrument(Sensor("pose", 3e-8, 3e-7), "controller_fk"),
    }
)
"""By name."""


@final
@dataclass(frozen=True)
class UndeclaredNoise:
    """How the true noise differs from the declared one; the defaults are noise as declared.

    Attributes:
        factor: ratio of the true standard deviation of the poses to the declared one; 0 is no noise.
        correlation: autocorrelation of the noise from one sample of a run to the next, 0 to below 1 (first-order
            autoregression with the same variance).
        growth_per_m: relative growth of the standard deviation per m of distance between the measured point and the
            base: it is 1 + growth_per_m · distance times larger.
        joint_noise: standard deviation of the joints' read-outs in addition to the declared one, rad.
        outlier_share: share of the rows that are outliers, 0 to 1.
        outlier_size: m; an outlier is displaced by 0.5 to 2 times this in a random direction.

    Raises:
        InputError: a number outside these ranges.
    """

    factor: float = 1.0
    correlation: float = 0.0
    growth_per_m: float = 0.0
    joint_noise: float = 0.0
    outlier_share: float = 0.0
    outlier_size: float = 5e-3

    def __post_init__(self) -> None:
        for field in fields(self):
            value, top = getattr(self, field.name), {"correlation": 1.0, "outlier_share": 1.0}.get(field.name, np.inf)
            if not 0 <= value < np.inf or value > top or (field.name == "correlation" and value == 1):
                limits = {"correlation": "0 to below 1", "outlier_share": "0 to 1"}.get(field.name, "0 or more")
                raise InputError(f"simulation: {field.name} is {value}; give a number, {limits}")


AS_DECLARED = UndeclaredNoise()
"""Noise of which nothing is undeclared."""


def instrument(sensor: Instrument | str) -> Instrument:
    """An instrument that a recording can be made with, by its name.

    Raises:
        InputError: another name, or a sensor of single distances.
    """
    if isinstance(sensor, str):
        if sensor not in INSTRUMENTS:
            raise InputError(f"simulation: sensor {sensor!r}: is none of {', '.join(INSTRUMENTS)}")
        sensor = INSTRUMENTS[sensor]
    if sensor.sensor.quantity not in ("position", "pose"):
        raise InputError(
            f"simulation: a sensor of {sensor.sensor.quantity} has no place in a recording; give one of positions or "
            "poses"
        )
    return sensor


def correlated(white: Array, correlation: float, run: NDArray[np.integer]) -> Array:
    """A first-order autoregression of variance 1 in each run, from white noise `(sample, axis)` of variance 1."""
    if not correlation:
        return white
    noise, fresh = white.copy(), np.sqrt(1 - correlation**2)
    for k in range(1, len(noise)):
        if run[k] == run[k - 1]:
            noise[k] = correlation * noise[k - 1] + fresh * white[k]
    return noise
