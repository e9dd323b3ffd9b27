"""Numbers as they are read on a screen: mm and degrees, the digits that matter, in tables without clutter."""

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

SCREEN = {"m": (1e3, "mm"), "rad": (180 / np.pi, "deg")}
"""From SI to what is printed."""
SHOWS_AS_ZERO = 0.5e-4
"""What four decimals round to nothing."""


def number(value: float, digits: int = 4) -> str:
    """A number to be read: fixed point, or powers of ten where that would show zeros only."""
    if value != 0 and abs(value) < SHOWS_AS_ZERO * 10 ** (4 - digits):
        return f"{value:.1e}"
    return f"{value:.{digits}f}"


def fixed(value: float, digits: int = 4, sign: str = "") -> str:
    """Fixed point, and no minus before zeros."""
    text = f"{value:{sign}.{digits}f}"
    return text if float(text) else text.replace("-", sign)


def listing(*headers: str) -> Table:
    """A table of numbers: the first column names the row."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False, header_style="")
    for i, header in enumerate(headers):
        table.add_column(Text(header), justify="left" if i == 0 else "right", no_wrap=True)
    return table


def plus_minus(value: float) -> str:
    """A standard deviation to two digits."""
    if value == 0 or not np.isfinite(value):
        return f"{value:.0f}"
    return f"{value:.1e}" if value < 1e-4 else f"{value:.{max(0, 1 - int(np.floor(np.log10(value))))}f}"
