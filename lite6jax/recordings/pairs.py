"""Logs of KEY=VALUE pairs, as programs print them, as a table: a block of pairs is a row."""

import re
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lite6jax.array_types import Array

_VALUE = r"[-+]?(?:\d+(?:[.,]\d+)?|\.\d+)(?:e[-+]?\d+)?"
_PAIR = re.compile(
    rf"(?P<key>(?<![\w.])[^\W\d][\w.]*(?:\[\d+\]| \d+)?)\s*[=:]\s*"
    rf"(?:[\[(](?P<list>\s*{_VALUE}(?:\s*[,; ]\s*{_VALUE})*\s*)[\])]"
    rf"|(?P<value>{_VALUE})(?:\s*(?P<unit>mm|m|deg|°|rad|ms|s))?(?![\w.:=]))",
    re.IGNORECASE,
)
_NUMBERS = re.compile(rf"(?<![\w.]){_VALUE}(?![\w.])", re.IGNORECASE)
_FEWEST = 4
"""Pairs in the first lines of a log."""
_SHARE = 0.5
"""Of the lines that are not blank, those with pairs; and of all numbers, those of pairs."""


class Pairs(NamedTuple):
    """What a log of pairs holds.

    Attributes:
        columns: `(row,)` numbers by key; NaN where a block lacks one.
        blocks: how many; the pairs that are repeated within one are a row each.
        single: keys that stand there once, as of a head.
    """

    columns: dict[str, Array]
    blocks: int
    single: tuple[str, ...]


def holds_pairs(text: str) -> bool:
    """Tells whether the first lines of a text are pairs and no table."""
    lines = [line for line in text.splitlines() if line.strip()]
    of_pairs = [sum(1 for _ in _pairs(line)) for line in lines]
    numbers = [max(len(_NUMBERS.findall(line)), count) for line, count in zip(lines, of_pairs, strict=True)]
    paired = sum(count > 0 for count in of_pairs)
    return sum(of_pairs) >= _FEWEST and paired >= _SHARE * len(lines) and sum(of_pairs) > _SHARE * sum(numbers)


def read_pairs(text: str) -> Pairs:
    """The table of a log of pairs.

    The first key that is repeated begins a block. Keys that stand in a block twice begin another row, which has the
    values before them as well: two readings at one pose.
    """
    pairs = [*_pairs(text)]
    counts = Counter(key for key, _ in pairs)
    if max(counts.values()) > 1:
        pairs = [(key, value) for key, value in pairs if counts[key] > 1]
    start = pairs[0][0]
    rows: list[dict[str, float]] = []
    blocks = 0
    for key, value in pairs:
        if key == start or not rows:
            rows.append({})
            blocks += 1
        elif key in rows[-1]:
            before = [*rows[-1]]
            rows.append({name: rows[-1][name] for name in before[: before.index(key)]})
        rows[-1][key] = value
    keys = dict.fromkeys(key for key, _ in pairs)
    columns = {key: np.array([row.get(key, np.nan) for row in rows]) for key in keys}
    return Pairs(columns, blocks, tuple(key for key, count in counts.items() if key not in columns))


def _pairs(text: str) -> Iterator[tuple[str, float]]:
    """Keys and values in their order; of a list a pair for each element."""
    for match in _PAIR.finditer(text):
        if match["list"] is None:
            name = f"{match['key']} [{match['unit']}]" if match["unit"] else match["key"]
            yield name, float(match["value"].replace(",", "."))
            continue
        apart = re.split(r"[,;\s]+", match["list"].strip())
        yield from ((f"{match['key']}[{place}]", float(value)) for place, value in enumerate(apart))
