"""How numbers, units and lists are written: in sentences, on screens and on pages alike."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from lite6jax.arms.arm import joint_unit

SCREEN = {"m": (1e3, "mm"), "rad": (180 / np.pi, "deg")}
"""Factor and name of the printed unit, by SI unit."""
SHOWS_AS_ZERO = 0.5e-4
"""The largest magnitude that four decimals round to zero."""
STATISTICS = (
    ("mean", np.mean),
    ("median", np.median),
    ("p95", lambda values: np.percentile(values, 95)),
    ("max", np.max),
)
MOST_ROWS = 12
"""The largest number of row numbers that are listed."""
UNKNOWN = "unknown"
"""In place of a number that is not finite: what no data determine has no size."""


def joint_units(sliding: Sequence[int], joints: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """For each joint the factor from rad, or from m of the prismatic joints counted from 0, and the printed unit."""
    shown = [SCREEN["m" if joint in sliding else "rad"] for joint in range(joints)]
    return np.array([scale for scale, _ in shown]), tuple(unit for _, unit in shown)


def torque_units(sliding: Sequence[int], joints: int) -> tuple[str, ...]:
    """For each joint the unit of what its motor exerts; prismatic joints are counted from 0."""
    return tuple(joint_unit("Nm", joint in sliding) for joint in range(joints))


def each_with_unit(values: Sequence[float], units: Sequence[str]) -> str:
    """Numbers one after the other, the unit behind the last where all have the same, else behind each."""
    shown = list(map(significant, values))
    if len(set(units)) == 1:
        return f"{', '.join(shown)} {units[0]}"
    return ", ".join(f"{value} {unit}" for value, unit in zip(shown, units, strict=True))


def number(value: float, digits: int = 4) -> str:
    """A number in fixed point, or in scientific notation where fixed point would show only zeros."""
    if not np.isfinite(value):
        return UNKNOWN
    if value != 0 and abs(value) < SHOWS_AS_ZERO * 10 ** (4 - digits):
        return f"{value:.1e}"
    return f"{value:.{digits}f}"


def significant(value: float, digits: int = 3) -> str:
    """A number to so many significant digits; without an exponent up to a million."""
    if not np.isfinite(value):
        return UNKNOWN
    rounded = float(f"{value:.{digits}g}")
    if 10**digits <= abs(rounded) < 1e6:
        return f"{rounded:.0f}"
    return f"{value:.{digits}g}"


def milli(value: float, digits: int = 3) -> str:
    """Metres in mm, or radians in mrad; rounding errors show as zero."""
    if not np.isfinite(value):
        return UNKNOWN
    return f"{1e3 * value:.{digits}g}" if abs(value) > 1e-9 else "0"


def multiple(ratio: float) -> str:
    """A ratio in two digits, and in whole numbers from 100 on."""
    if not np.isfinite(ratio):
        return UNKNOWN
    return f"{ratio:.2g}" if ratio < 99.5 else f"{ratio:.0f}"


def fixed(value: float, digits: int = 4, sign: str = "") -> str:
    """A number in fixed point, without a minus before zero."""
    if not np.isfinite(value):
        return UNKNOWN
    text = f"{value:{sign}.{digits}f}"
    return text if float(text) else text.replace("-", sign)


def chance(p: float, digits: int = 2) -> str:
    """A p-value as an equation; one that is too small for a float as a bound."""
    return f"p = {p:.{digits}g}" if p > 0 else "p < 1e-300"


def plus_minus(value: float) -> str:
    """A standard deviation to two significant digits."""
    if not np.isfinite(value):
        return UNKNOWN
    if value == 0:
        return "0"
    if value < 1e-4:
        return f"{value:.1e}"
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(value))))}f}"


def rounded(value: float, std: float) -> tuple[str, str]:
    """A value to the digits that its standard deviation supports, and this to two."""
    if not np.isfinite(std) or std < 1e-4:
        return significant(value, 6), f"{std:.1e}" if np.isfinite(std) else UNKNOWN
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(std))))}f}", plus_minus(std)


def row_ranges(rows: Iterable[int]) -> str:
    """Row numbers with consecutive ones as ranges; at most `MOST_ROWS` parts, then the number of the others."""
    parts = ranges(rows)
    shown = ", ".join(text for text, _ in parts[:MOST_ROWS])
    further_rows = sum(count for _, count in parts[MOST_ROWS:])
    return shown + (f" and {further_rows} more" if further_rows else "")


def rows_named(rows: Sequence[int]) -> str:
    """Row numbers with their noun: row 61, or rows 3, 5–9."""
    return f"row{'' if len(rows) == 1 else 's'} {row_ranges(rows)}"


def ranges(numbers: Iterable[int]) -> list[tuple[str, int]]:
    """The numbers as texts, three or more consecutive ones as a range, each with its count."""
    numbers = list(dict.fromkeys(numbers))
    starts = [0, *(i + 1 for i, (a, b) in enumerate(pairwise(numbers)) if b != a + 1), len(numbers)]
    parts = []
    for start, end in pairwise(starts):
        if end - start > 2:
            parts.append((f"{numbers[start]}–{numbers[end - 1]}", end - start))
        else:
            parts += [(str(value), 1) for value in numbers[start:end]]
    return parts


def joints_named(joints: Sequence[int]) -> str:
    """Numbers of joints with their noun: joint 2, or joints 1 and 3."""
    return f"joint{'s' * (len(joints) > 1)} {joined(map(str, joints))}"


def counted(count: int, noun: str) -> str:
    """A number with its noun: 1 row, or 3 rows."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def plural(count: int, of_one: str, of_several: str) -> str:
    """The words that agree with a number."""
    if count == 1:
        return of_one
    return of_several


def be(count: int) -> str:
    """Is, or are."""
    return plural(count, "is", "are")


def joined(words: Iterable[str], last: str = "and") -> str:
    """Words in a row: a, b and c."""
    *first, final = [*words] or [""]
    return f"{', '.join(first)} {last} {final}" if first else final


def shortened(words: Sequence[object], most: int) -> str:
    """The first words or numbers of a list, at most so many, and how many others there are."""
    shown = ", ".join(map(str, words[:most]))
    if len(words) <= most:
        return shown
    return f"{shown} and {len(words) - most} more"


def paragraph(*sentences: str) -> str:
    """Sentences, or parts of one, a blank between them, without those that are empty."""
    return " ".join(filter(None, sentences))


def capital(text: str) -> str:
    """With a capital first letter, the others unchanged."""
    return text[:1].upper() + text[1:]


# ------------------------------------------------------------------ parameters of effects

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
NAMED = {
    "scale": (1e6, "ppm"),
    "peak_to_peak_rad": (1e6, "µrad"),
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
NAMED_OF_TORQUES = {**NAMED, "scale": (100.0, "%")}
"""The same, of effects on torques: the scale of a current is not known to ppm."""
_STIFF = 3.0
"""Standard deviations that a compliance must be from zero for its inverse to mean something."""
_DAY = 86400.0  # s


class RoundedParameter(NamedTuple):
    """A parameter as it is read: its value rounded to its standard deviation, and that to two digits.

    One that was chosen has no `std`, a plain number no unit. `also` is the same in another unit.
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


def quantity(
    name: str, estimate: Mapping[str, float], named: Mapping[str, tuple[float, str]] = NAMED
) -> RoundedParameter:
    """A parameter by its name in the JSON file and its estimate, `value` and `std`; some names have special units."""
    fitting = (unit_rule for unit_rule in _UNITS if name.endswith(unit_rule[0]))
    end, scale, unit = next(fitting, ("", 1.0, ""))
    if name in named:
        scale, unit = named[name]
    read = name.removesuffix("_rad" if end == "phase_rad" else end).replace("_", " ")
    value = scale * estimate["value"]
    std = scale * estimate["std"]
    if not std:
        # the best of a few values, or a whole number such as that of a joint
        return RoundedParameter(read, f"{value:.6g}" if value == round(value) else f"{value:.4g}", "", unit)
    return RoundedParameter(read, *rounded(value, std), unit, "" if name in named else _otherwise(end, estimate))


def _otherwise(end: str, estimate: Mapping[str, float]) -> str:
    """A compliance as a stiffness, a rate as a drift per day; a compliance within its error of none has no inverse."""
    value = estimate["value"]
    std = estimate["std"]
    if end == "_rad_per_Nm" and value > _STIFF * std:
        return f"stiffness {' ± '.join(rounded(1 / value, std / value**2))} Nm/rad"
    if end == "_m_per_N" and value > _STIFF * std:
        return f"stiffness {' ± '.join(rounded(1e-6 / value, 1e-6 * std / value**2))} N/µm"
    if end in ("_m_per_s", "_rad_per_s"):
        scale, unit = (1e3, "mm") if end == "_m_per_s" else (180 / np.pi, "deg")
        return f"{' ± '.join(rounded(scale * _DAY * value, scale * _DAY * std))} {unit} a day"
    return ""
