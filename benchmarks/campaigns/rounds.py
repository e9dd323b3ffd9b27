"""Trials of several kinds in fixed shares, choices that go round, so that any number is a fair sample; their tables.

Shares no code with the library.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

T = TypeVar("T")
Array = NDArray[np.floating]
_TRIES = 200

Kind = Literal["clean", "single", "mixture", "outside", "edge", "faulty"]
KINDS: tuple[Kind, ...] = ("clean", "single", "mixture", "outside", "edge", "faulty")


class Rounds(NamedTuple):
    """Kinds that come in rounds, each in its share, in an order of the round's own."""

    shares: Mapping[str, int]  # how many trials of each kind a round has
    stream: int  # of random numbers

    def kind_of(self, seed: int, index: int) -> Any:
        """The kind of a trial."""
        return self._round(seed, index)[0][-1]

    def ordinal(self, seed: int, index: int, kind: str) -> int:
        """How many trials of its kind come before a trial."""
        kinds, lap = self._round(seed, index)
        return lap * self.shares[kind] + kinds[:-1].count(kind)

    def _round(self, seed: int, index: int) -> tuple[list[str], int]:
        """The kinds of a round up to a trial, and how many rounds are before it."""
        kinds = [kind for kind, count in self.shares.items() for _ in range(count)]
        lap, place = divmod(index, len(kinds))
        order = np.random.default_rng([seed, self.stream, lap]).permutation(len(kinds))
        return [kinds[k] for k in order[: place + 1]], lap

    def indices(self, seed: int, trials: int, *kinds: str) -> list[int]:
        """The first trials of a campaign, or the first of some kinds."""
        found: list[int] = []
        index = 0
        while len(found) < trials:
            if not kinds or self.kind_of(seed, index) in kinds:
                found.append(index)
            index += 1
        return found


def turn(seed: int, stream: int, ordinal: int, choices: Sequence[Any]) -> Any:
    """A choice that goes round: each comes once a round, in an order of its own."""
    lap, place = divmod(ordinal, len(choices))
    return choices[np.random.default_rng([seed, stream, lap]).permutation(len(choices))[place]]


def first_made(make: Callable[[np.random.Generator], T | None], seed: int, stream: int, index: int) -> T:
    """What is made of the first draw of a trial of which anything can be made."""
    for again in range(_TRIES):
        made = make(np.random.default_rng([seed, stream, index, again]))
        if made is not None:
            return made
    raise RuntimeError(f"trial {index} of seed {seed}: nothing visible drawn in {_TRIES} tries")


class Trial(NamedTuple):
    """A trial as it is written."""

    plan: Any  # what was drawn
    truth: dict[str, Any]  # for the sealed file
    files: dict[str, str]  # name to text, all that the diagnosis is given
    beside: Mapping[str, str] = {}  # likewise, what an exported trial has beside its truth


def csv_text(columns: Mapping[str, ArrayLike], digits: int = 13) -> str:
    """The columns, of equal length, as CSV: numbers with so many significant digits, text as it is."""
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = ([v if isinstance(v, str) else f"{v:.{digits}g}" for v in row] for row in rows)
    return "\n".join([",".join(columns), *map(",".join, lines)]) + "\n"


def motion_columns(motion: Any, q: Array, dq: Array | None, turns: bool = False) -> dict[str, Array]:
    """The columns of a motion: times, joints as they are read, temperatures, the payload.

    Args:
        motion: with `time`, `temperature` and `payload`.
        q: `(sample, joint)` rad.
        dq: `(sample, joint)` rad/s; None where velocities are not read.
        turns: whether positions are from 0 to a turn.
    """
    columns = {"time_s": motion.time}
    for i in range(q.shape[1]):
        columns |= {f"q{i + 1}_deg": np.rad2deg(np.mod(q[:, i], 2 * np.pi))} if turns else {f"q{i + 1}_rad": q[:, i]}
    if dq is not None:
        columns |= {f"dq{i + 1}_rad_per_s": column for i, column in enumerate(dq.T)}
    columns |= {f"temp{i + 1}_degC": column for i, column in enumerate(motion.temperature.T)}
    return columns | {"payload_kg": motion.payload}


def read_columns(text: str) -> dict[str, list[float]]:
    """The columns of such a text; NaN where a cell is empty."""
    names, *rows = text.splitlines()
    values = [[float(cell) if cell else math.nan for cell in row.split(",")] for row in rows]
    return dict(zip(names.split(","), map(list, zip(*values, strict=True)), strict=True))
