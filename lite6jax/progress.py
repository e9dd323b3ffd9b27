"""Which stage a long computation is in, for whoever follows it. Computations say a code and know no follower."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Literal, NamedTuple

Code = Literal["screening", "linearising", "selecting", "naming", "shrinking", "noise", "estimating", "planning"]


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


_Follower = Callable[[Stage], object]

_follower: ContextVar[_Follower | None] = ContextVar("follower", default=None)
_part: ContextVar[tuple[int, int]] = ContextVar("part", default=(0, 1))


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
def part(number: int, of: int) -> Iterator[None]:
    """All stages within belong to this part."""
    before = _part.set((number, of))
    try:
        yield
    finally:
        _part.reset(before)


def entered(code: Code) -> None:
    """Says that a stage begins."""
    follower = _follower.get()
    if follower is not None:
        follower(Stage(code, *_part.get()))
