"""Tables of numbers as the files of a trial have them: CSV, a column a name."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike


def csv_text(columns: Mapping[str, ArrayLike], digits: int = 13) -> str:
    """The columns, of equal length, as CSV with so many significant digits."""
    rows = np.column_stack([np.asarray(values, float) for values in columns.values()])
    lines = ([f"{v:.{digits}g}" for v in row] for row in rows)
    return "\n".join([",".join(columns), *map(",".join, lines)]) + "\n"


def read_columns(text: str) -> dict[str, list[float]]:
    """The columns of such a text; NaN where a cell is empty."""
    names, *rows = text.splitlines()
    values = [[float(cell) if cell else math.nan for cell in row.split(",")] for row in rows]
    return dict(zip(names.split(","), map(list, zip(*values, strict=True)), strict=True))
