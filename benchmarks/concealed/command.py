"""`python -m benchmarks concealed`: runs the trials, or one of them, and says what came of it."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.campaigns import command
from benchmarks.campaigns.campaign import Row
from benchmarks.concealed import report
from benchmarks.concealed.campaign import POSES
from benchmarks.concealed.comparison import differences
from benchmarks.concealed.plans import KINDS, indices
from benchmarks.concealed.scores import goals


def _figures(rows: Sequence[Row], folder: Path) -> Iterator[Path]:
    from benchmarks.concealed import figures  # takes a while to load

    yield from figures.draw(rows, folder)


TRIALS = command.Trials(
    name="concealed",
    description="Recordings of simulated arms whose hidden physics is drawn by a generator that shares no code with "
    "the library, sealed before the diagnosis begins and opened after it; and what the diagnosis is worth.",
    count=1000,
    kinds=KINDS,
    indices=indices,
    campaign=POSES,
    sections=report.sections,
    goals=goals,
    story=report.story,
    differences=differences,
    figures=_figures,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where a goal is missed, 2 for arguments that cannot be used, 130 where interrupted."""
    return command.main(TRIALS, arguments)
