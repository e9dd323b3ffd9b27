"""Trials of several kinds in fixed shares, and choices that go round, so that any number of trials is a fair sample.

Shares no code with the library.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

T = TypeVar("T")
_TRIES = 200


class Rounds(NamedTuple):
    """Kinds that come in rounds, each in its share, in an order of the round's own.

    Attributes:
        shares: how many trials of each kind a round has.
        stream: of random numbers.
    """

    shares: Mapping[str, int]
    stream: int

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
    """A trial as it is written.

    Attributes:
        plan: what was drawn.
        truth: for the sealed file.
        files: name to text, all that the diagnosis is given.
    """

    plan: Any
    truth: dict[str, Any]
    files: dict[str, str]
