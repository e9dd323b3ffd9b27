"""The stage of a long computation and its time to go, on stderr: an updated line, or one line every ten seconds."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import final

from rich.live import Live
from rich.text import Text

from lite6jax.progress import Code, Stage
from lite6jax.report import screen
from lite6jax.report.screen import minutes

_STAGES: dict[Code, str] = {
    "screening": "looking for data faults",
    "linearising": "fitting frames and clock offset",
    "selecting": "searching for physics",
    "naming": "testing names",
    "shrinking": "fitting each joint's error curve",
    "noise": "testing again with the noise model",
    "estimating": "computing the final estimates",
    "planning": "choosing poses that separate the alternatives",
}
_SHARE = 0.5
"""Of the time for all rows, what a held-out block takes, as long as none has been measured."""


@final
class Clock:
    """Where a computation is and how long it still takes, from the times of its parts so far.

    The functions take the present time in seconds.
    """

    def __init__(self, now: float) -> None:
        self.stage: Stage | None = None
        self._began = [now]

    def entered(self, stage: Stage, now: float) -> None:
        """A stage begins."""
        self.stage = stage
        while len(self._began) <= stage.part:
            self._began.append(now)

    def to_go(self, now: float) -> float | None:
        """Seconds to go; None as long as all rows are searched, which takes a time that nothing measured tells."""
        if self.stage is None or self.stage.part == 0:
            return None
        began, part, left = self._began, self.stage.part, self.stage.parts - self.stage.part
        if left == 0:
            return 0.0
        block = (began[part] - began[1]) / (part - 1) if part > 1 else _SHARE * (began[1] - began[0])
        return max(block - (now - began[part]), 0.0) + (left - 1) * block

    def at_least(self, now: float) -> float:
        """Seconds that the held-out blocks take after all rows, were these searched now."""
        assert self.stage is not None
        return _SHARE * (self.stage.parts - 1) * (now - self._began[0])

    def line(self, now: float) -> str:
        """The stage, the time since the beginning and the time to go, in words."""
        if self.stage is None:
            return f"reading rows, {minutes(now - self._began[0])} so far"
        block = f", without block {self.stage.part} of {self.stage.parts - 1}" if self.stage.part > 0 else ""
        block = block if self.stage.part < self.stage.parts else ""
        to_go = self.to_go(now)
        ahead = f"more than {minutes(self.at_least(now))} to go" if to_go is None else f"about {minutes(to_go)} to go"
        return f"{_STAGES[self.stage.code]}{block}: {minutes(now - self._began[0])} so far, {ahead}"


@contextmanager
def shown() -> Iterator[Callable[[Stage], None]]:
    """Shows the stages that the yielded function is called with, until the end of the context."""
    clock, console = Clock(time.monotonic()), screen.console(stderr=True)

    def follow(stage: Stage) -> None:
        clock.entered(stage, time.monotonic())

    if console.is_terminal:
        line = lambda: Text(clock.line(time.monotonic()), overflow="ellipsis", no_wrap=True)  # noqa: E731
        with Live(get_renderable=line, console=console, transient=True, refresh_per_second=2):
            yield follow
        return
    with screen.repeated(lambda: clock.line(time.monotonic())):
        yield follow
