"""Formatting of numbers for the screen: units, significant digits, ranges of rows, and table layout."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

from lite6jax.arms.joint_units import joint_unit

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
    """A number to so many significant digits."""
    return f"{value:.{digits}g}" if np.isfinite(value) else UNKNOWN


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


def listing(*headers: str) -> Table:
    """An empty table of numbers whose first column names the row."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False, header_style="")
    for i, header in enumerate(headers):
        table.add_column(Text(header), justify="left" if i == 0 else "right", no_wrap=True)
    return table


def plus_minus(value: float) -> str:
    """A standard deviation to two significant digits."""
    if not np.isfinite(value):
        return UNKNOWN
    if value == 0:
        return "0"
    return f"{value:.1e}" if value < 1e-4 else f"{value:.{max(0, 1 - int(np.floor(np.log10(value))))}f}"


def listed(rows: Iterable[int]) -> str:
    """Row numbers with consecutive ones as ranges; at most `MOST_ROWS` parts, then the number of the others."""
    parts = ranges(rows)
    shown = ", ".join(text for text, _ in parts[:MOST_ROWS])
    rest = sum(count for _, count in parts[MOST_ROWS:])
    return shown + (f" and {rest} more" if rest else "")


def rows_named(rows: Sequence[int]) -> str:
    """Row numbers with their noun: row 61, or rows 3, 5–9."""
    return f"row{'' if len(rows) == 1 else 's'} {listed(rows)}"


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


def counted(count: int, noun: str) -> str:
    """A number with its noun: 1 row, or 3 rows."""
    return f"{count} {noun}{'s' * (count != 1)}"


def joined(words: Iterable[str], last: str = "and") -> str:
    """Words in a row: a, b and c."""
    *first, final = [*words] or [""]
    return f"{', '.join(first)} {last} {final}" if first else final


def capital(text: str) -> str:
    """With a capital first letter, the others unchanged."""
    return text[:1].upper() + text[1:]
