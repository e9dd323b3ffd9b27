"""The command of a kind of trials: runs them, or one of them, and says what came of it."""

import argparse
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmarks.campaigns.campaign import Campaign, Row, opened
from benchmarks.campaigns.shares import Goal
from benchmarks.campaigns.tables import Section, markdown, tables
from benchmarks.ending import DONE, MISSED, ended
from lite6jax.errors import InputError
from lite6jax.storage import check_writable


@dataclass(frozen=True)
class Trials:
    """A kind of trials as its command needs it.

    Attributes:
        name: of the command.
        description: of it.
        count: how many trials, if not said.
        kinds: among which `--kind` chooses.
        indices: of a seed, so many, and kinds.
        campaign: of them.
        sections: the tables of rows.
        goals: those that are set on rows.
        story: of a truth and its row, line by line.
        differences: of earlier rows and these, line by line; None where it has none.
        figures: drawn of rows into a folder; None where it has none.
        export: writes a trial of a seed and an index into a folder, truth and all; None where it cannot.
    """

    name: str
    description: str
    count: int
    kinds: Sequence[str]
    indices: Callable[..., list[int]]
    campaign: Campaign
    sections: Callable[[Sequence[Row]], Iterable[Section]]
    goals: Callable[[Sequence[Row]], list[Goal]]
    story: Callable[[Row, Row], Iterator[str]]
    differences: Callable[[Sequence[Row], Sequence[Row]], Iterator[str]] | None = None
    figures: Callable[[Sequence[Row], Path], Iterator[Path]] | None = None
    export: Callable[[int, int, bool, Path], Path] | None = None


def main(trials: Trials, arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where a goal is missed, 2 for arguments that cannot be used, 130 where interrupted."""
    parser = _parser(trials)
    options = parser.parse_args(arguments)
    if options.trial is not None and any(getattr(options, name, None) for name in ("kind", "out", "figures")):
        also = "--kind, --out and --figures" if trials.figures else "--kind and --out"
        parser.error(f"--trial: runs one and keeps nothing; leave {also} out")
    if options.out and options.out.suffix != ".parquet":
        parser.error(f"--out: {options.out} is to be a Parquet file; end its name in .parquet")
    kept = f"; what was done is kept beside {options.out}, the same command goes on" if options.out else ""
    return ended(partial(_run, trials, options), (InputError, ValueError, OSError), kept)


def _run(trials: Trials, options: argparse.Namespace) -> int:
    console = Console(highlight=False)
    if options.out:
        check_writable(options.out, overwrite=True)
    if getattr(options, "export", None):
        return _export(trials, options, console)
    if options.trial is not None:
        return _one(trials, options.seed, options.trial, options.sealed, console)
    return _many(trials, options, console)


def _parser(trials: Trials) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=f"python -m benchmarks {trials.name}", description=trials.description)
    parser.add_argument(
        "--trials", type=_count, default=trials.count, metavar="N", help=f"how many, {trials.count} if not given"
    )
    parser.add_argument("--seed", type=_whole, default=0, metavar="S", help="of the campaign; 0 if not given")
    parser.add_argument(
        "--kind", choices=trials.kinds, action="append", help="only trials of this kind; give it again for one more"
    )
    parser.add_argument(
        "--sealed",
        action="store_true",
        help="draw what is outside the catalogue from the families that are put aside, and from no other: to be looked "
        "at once, when the development is over",
    )
    parser.add_argument(
        "--trial", type=_whole, metavar="I", help="only trial I of the seed, and all that happened in it"
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE.parquet", help="keep the results here; goes on where it stopped"
    )
    if trials.differences:
        parser.add_argument(
            "--compare", type=Path, metavar="BEFORE.parquet", help="say what differs from earlier results"
        )
    if trials.figures:
        parser.add_argument("--figures", type=Path, metavar="DIR", help="draw the figures into this folder")
    if trials.export:
        parser.add_argument(
            "--export",
            type=Path,
            metavar="DIR",
            help="diagnose nothing; write the files here, truth and all",
        )
    parser.add_argument("--markdown", action="store_true", help="print the tables as Markdown")
    parser.add_argument("--processes", type=_count, metavar="P", help="that work at a time; one a core if not given")
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask cluster that works in place of processes, as tcp://HOST:8786"
    )
    return parser


def _many(trials: Trials, options: argparse.Namespace, console: Console) -> int:
    wanted = trials.indices(options.seed, options.trials, *(options.kind or ()))
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    shown = Console(stderr=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        Progress(*columns, console=shown, transient=True, disable=not shown.is_terminal) as bar,
    ):
        out = options.out or Path(folder) / f"{trials.name}.parquet"
        task = bar.add_task("")

        def advance(what: str, done: int, total: int) -> None:
            bar.update(task, description=what, completed=done, total=total)

        rows = trials.campaign.run(
            options.seed, wanted, out, options.processes, console.print, advance, options.sealed, options.scheduler
        )
    if trials.differences and options.compare:
        for line in trials.differences(trials.campaign.read_rows(options.compare), rows):
            console.print(line, soft_wrap=True)
    if trials.figures and options.figures:
        for path in trials.figures(rows, options.figures):
            console.print(f"Wrote {path}", soft_wrap=True)
    if options.markdown:
        print(markdown(trials.sections(rows)))
    else:
        for table in tables(trials.sections(rows)):
            console.print(table)
    return MISSED if any(goal.met is False for goal in trials.goals(rows)) else DONE


def _one(trials: Trials, seed: int, index: int, sealed: bool, console: Console) -> int:
    """Runs a trial and prints what was hidden and what was said."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        digest = trials.campaign.sealed_by_process(seed, index, folder, sealed)
        console.print(f"Trial {index} of seed {seed}: truth sealed, SHA-256 {digest}.", soft_wrap=True)
        row = trials.campaign.judge(folder, index, digest)
        for line in trials.story(opened(folder, index, digest), row):
            console.print(line, soft_wrap=True, markup=False)
    return DONE


def _export(trials: Trials, options: argparse.Namespace, console: Console) -> int:
    """Writes trials with their truths beside them, for those who look for what went wrong."""
    assert trials.export
    wanted = trials.indices(options.seed, options.trials, *(options.kind or ()))
    for index in wanted if options.trial is None else [options.trial]:
        path = trials.export(options.seed, index, options.sealed, options.export)
        console.print(f"Wrote {path}", soft_wrap=True)
    return DONE


def _whole(text: str) -> int:
    value = int(text)
    if value < 0:
        raise ValueError
    return value


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise ValueError
    return value


_whole.__name__, _count.__name__ = "whole number from 0", "whole number from 1"
