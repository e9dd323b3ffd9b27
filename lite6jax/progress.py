"""Which stage a long computation is in, for whoever follows it. Computations say a code and know no follower."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from threading import RLock
from typing import Literal, NamedTuple

Code = Literal["screening", "linearising", "servos", "selecting", "naming", "estimating", "planning"]


class Stage(NamedTuple):
    """Where a computation is.

    Attributes:
        code: what it does now.
        part: which of its large parts this belongs to, from 0; `parts` where only little is left to do.
        parts: how many large parts there are.
    """

    code: Code
    part: int = 0
    parts: int = 1


@dataclass
class Part:
    """Which of the large parts of a computation is going on, and how many there are."""

    number: int
    of: int


_Follower = Callable[[Stage], object]

_follower: ContextVar[_Follower | None] = ContextVar("follower", default=None)
_one_at_a_time = RLock()
"""Computations may go on side by side; a follower hears of one stage after the other."""
_part: ContextVar[Part | None] = ContextVar("part", default=None)


@contextmanager
def followed(follower: _Follower | None) -> Iterator[None]:
    """Calls `follower` with each stage that is entered within; with None, whoever followed goes on."""
    if follower is None:
        yield
        return
    before = _follower.set(follower)
    try:
        yield
    finally:
        _follower.reset(before)


@contextmanager
def part(number: int, of: int) -> Iterator[Part]:
    """All stages within belong to this part, whose number may be raised as what goes on side by side is completed."""
    current = Part(number, of)
    before = _part.set(current)
    try:
        yield current
    finally:
        _part.reset(before)


def entered(code: Code) -> None:
    """Says that a stage begins."""
    follower = _follower.get()
    if follower is not None:
        with _one_at_a_time:
            current = _part.get() or Part(0, 1)
            follower(Stage(code, current.number, current.of))
