"""How a command of the benchmarks ends: its exit code, and one line where its input cannot be used."""

import sys
from collections.abc import Callable

from lite6jax.errors import InputError

DONE, MISSED, UNUSABLE, INTERRUPTED = 0, 1, 2, 130


def ended(work: Callable[[], int], refused: tuple[type[Exception], ...] = (InputError,), kept: str = "") -> int:
    """The exit code of a command.

    Args:
        work: of the command, to its exit code.
        refused: exceptions that say what cannot be used.
        kept: what an interrupt leaves, a clause that begins with its punctuation.
    """
    try:
        return work()
    except refused as problem:
        print(f"benchmarks: {problem}", file=sys.stderr)
        return UNUSABLE
    except KeyboardInterrupt:
        print(f"benchmarks: interrupted{kept}", file=sys.stderr)
        return INTERRUPTED
