"""How a signal ends the program: what was begun is undone, one line says so, and the exit code is 128 + its number."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""Those that end the program; Ctrl-C is the first."""

_undo: list[Callable[[], object]] = []
_ends_on_signals = False


def end_on_signals() -> None:
    """From here on a signal of `SIGNALS` ends the process at once; to be called by a program, before its imports.

    No exception is raised for it. A `KeyboardInterrupt` is lost where a library catches every exception while it is
    imported, and in destructors and callbacks, and it prints a traceback where nobody catches it.
    """
    global _ends_on_signals
    _ends_on_signals = True
    for number in list_signals():
        signal.signal(number, _end)


def list_signals() -> list[int]:
    """The numbers of `SIGNALS` that this system has and this process does not ignore, as it does under nohup."""
    numbers = [signal.Signals[name] for name in SIGNALS if name in signal.Signals.__members__]
    return [number for number in numbers if signal.getsignal(number) != signal.SIG_IGN]


def is_command_line() -> bool:
    """Tells whether this process is the command line itself, and not a program that imports the library."""
    return _ends_on_signals


@contextmanager
def undone(action: Callable[[], object]) -> Iterator[None]:
    """Has `action` called where the process is ended within the `with` statement, and then runs no `finally`."""
    _undo.append(action)
    try:
        yield
    finally:
        _undo.remove(action)


def undo() -> None:
    """Calls what `undone` was given, the last first; for what ends the process at once."""
    for action in reversed(_undo):
        with suppress(Exception):
            action()


def _end(number: int, frame: FrameType | None) -> None:
    undo()
    outcome = "interrupted"
    if number != signal.SIGINT:
        outcome = f"ended by {signal.Signals(number).name}"
    # progress bars have hidden the cursor of a terminal
    shown = "\r\x1b[K\x1b[?25h" if os.isatty(2) else ""
    with suppress(OSError):
        os.write(2, f"{shown}{outcome}: nothing is left half-written\n".encode())
    os._exit(128 + number)
