"""Tables as the files of a trial have them: CSV, a column a name."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike


def csv_text(columns: Mapping[str, ArrayLike], digits: int = 13) -> str:
    """The columns, of equal length, as CSV: numbers with so many significant digits, text as it is."""
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = ([v if isinstance(v, str) else f"{v:.{digits}g}" for v in row] for row in rows)
    return "\n".join([",".join(columns), *map(",".join, lines)]) + "\n"


def read_columns(text: str) -> dict[str, list[float]]:
    """The columns of such a text; NaN where a cell is empty."""
    names, *rows = text.splitlines()
    values = [[float(cell) if cell else math.nan for cell in row.split(",")] for row in rows]
    return dict(zip(names.split(","), map(list, zip(*values, strict=True)), strict=True))
