"""Numbers of effects as they are read: in the units of the screen, rounded to their standard deviations."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from lite6jax.report.cells import UNKNOWN, plus_minus, significant

_UNITS = (
    ("_rad_per_Nm", 1e6, "µrad/Nm"),
    ("_m_per_Nm", 1e6, "µm/Nm"),
    ("_m_per_N", 1e6, "µm/N"),
    ("_Nm", 1.0, "Nm"),
    ("_N", 1.0, "N"),
    ("_Nm_s_per_rad_K", 1.0, "Nm·s/rad/K"),
    ("_Nm_s_per_rad", 1.0, "Nm·s/rad"),
    ("_Nm_per_rad", 1.0, "Nm/rad"),
    ("_N_s_per_m_K", 1.0, "N·s/m/K"),
    ("_N_s_per_m", 1.0, "N·s/m"),
    ("_N_per_m", 1.0, "N/m"),
    ("_kg_m2", 1.0, "kg·m²"),
    ("_rad_per_K", 1e6, "µrad/K"),
    ("_rad_per_s", 1e6, "µrad/s"),
    ("_m_per_s", 1e6, "µm/s"),
    ("_per_K", 1e6, "ppm/K"),
    ("phase_rad", 180 / np.pi, "deg"),
    ("_rad", 1e3, "mrad"),
    ("_m", 1e3, "mm"),
    ("_s", 1e3, "ms"),
    ("_kg", 1.0, "kg"),
)
"""The end of a parameter's name, and the unit in which it is read; the first that fits."""
_NAMED = {
    "scale": (1e6, "ppm"),
    "peak_to_peak_scale": (1e6, "ppm"),
    "coupling": (1e6, "ppm"),
    "time_constant_s": (1.0, "s"),
    "velocity_rad_per_s": (1.0, "rad/s"),
    "velocity_m_per_s": (1e3, "mm/s"),
    "transition_rad_per_s": (1.0, "rad/s"),
    "transition_m_per_s": (1e3, "mm/s"),
    "rest_rad": (180 / np.pi, "deg"),
}
"""Whose names alone do not say how they are read."""
OF_TORQUES = {**_NAMED, "scale": (100.0, "%")}
"""The same, of effects on torques: the scale of a current is not known to ppm."""

_STIFF = 3.0
"""Standard deviations that a compliance must be from zero for its inverse to mean something."""
_DAY = 86400.0
"""s."""


class Quantity(NamedTuple):
    """A parameter as it is read.

    Attributes:
        name: without its unit.
        value: rounded to its standard deviation.
        std: two digits; empty where the number was chosen and not estimated.
        unit: of both; empty for plain numbers.
        also: the same in another unit, with its name or unit; empty where there is none.
    """

    name: str
    value: str
    std: str
    unit: str
    also: str = ""

    def __str__(self) -> str:
        size = f"{self.value} ± {self.std}" if self.std else self.value
        also = f" ({self.also})" if self.also else ""
        return f"{self.name} {size}{f' {self.unit}' if self.unit else ''}{also}"


def quantity(name: str, estimate: Mapping[str, float], named: Mapping[str, tuple[float, str]] = _NAMED) -> Quantity:
    """A parameter by the name and the estimate, `value` and `std`, that the JSON file has.

    Args:
        name: as in the file.
        estimate: `value` and `std`.
        named: factors and units of parameters whose names do not say how they are read.
    """
    fitting = (known for known in _UNITS if name.endswith(known[0]))
    end, scale, unit = next(fitting, ("", 1.0, ""))
    if name in named:
        scale, unit = named[name]
    read = name.removesuffix("_rad" if end == "phase_rad" else end).replace("_", " ")
    value, std = scale * estimate["value"], scale * estimate["std"]
    if not std:
        # the best of a few values, or a whole number such as that of a joint
        return Quantity(read, f"{value:.6g}" if value == round(value) else f"{value:.4g}", "", unit)
    return Quantity(read, *rounded(value, std), unit, "" if name in named else _otherwise(end, estimate))


def _otherwise(end: str, estimate: Mapping[str, float]) -> str:
    """A compliance as a stiffness, a rate as a drift per day; a compliance within its error of none has no inverse."""
    value, std = estimate["value"], estimate["std"]
    if end == "_rad_per_Nm" and value > _STIFF * std:
        return f"stiffness {' ± '.join(rounded(1 / value, std / value**2))} Nm/rad"
    if end == "_m_per_N" and value > _STIFF * std:
        return f"stiffness {' ± '.join(rounded(1e-6 / value, 1e-6 * std / value**2))} N/µm"
    if end in ("_m_per_s", "_rad_per_s"):
        scale, unit = (1e3, "mm") if end == "_m_per_s" else (180 / np.pi, "deg")
        return f"{' ± '.join(rounded(scale * _DAY * value, scale * _DAY * std))} {unit} a day"
    return ""


def rounded(value: float, std: float) -> tuple[str, str]:
    """A value to the digits that its standard deviation supports, and this to two."""
    if not np.isfinite(std) or std < 1e-4:
        return significant(value, 6), f"{std:.1e}" if np.isfinite(std) else UNKNOWN
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(std))))}f}", plus_minus(std)
