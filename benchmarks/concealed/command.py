"""`python -m benchmarks concealed`: runs the trials, or one of them, and says what came of it."""

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from benchmarks.concealed.plans import KINDS, indices
from lite6jax.errors import InputError
from lite6jax.storage import check_writable

DONE, MISSED, UNUSABLE, INTERRUPTED = 0, 1, 2, 130
_TRIALS = 1000


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where a goal is missed, 2 for arguments that cannot be used, 130 where interrupted."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks concealed",
        description="Recordings of simulated arms whose hidden physics is drawn by a generator that shares no code "
        "with the library, sealed before the diagnosis begins and opened after it; and what the diagnosis is worth.",
    )
    parser.add_argument("--trials", type=_count, default=_TRIALS, metavar="N", help=f"how many, {_TRIALS} if not given")
    parser.add_argument("--seed", type=_whole, default=0, metavar="S", help="of the campaign; 0 if not given")
    parser.add_argument(
        "--kind", choices=KINDS, action="append", help="only trials of this kind; give it again for one more"
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
    parser.add_argument("--compare", type=Path, metavar="BEFORE.parquet", help="say what differs from earlier results")
    parser.add_argument("--figures", type=Path, metavar="DIR", help="draw the figures into this folder")
    parser.add_argument("--markdown", action="store_true", help="print the tables as Markdown")
    parser.add_argument("--processes", type=_count, metavar="P", help="that work at a time; one a core if not given")
    options = parser.parse_args(arguments)
    if options.trial is not None and (options.kind or options.out or options.figures):
        parser.error("--trial: runs one and keeps nothing; leave --kind, --out and --figures out")
    if options.out and options.out.suffix != ".parquet":
        parser.error(f"--out: {options.out} is to be a Parquet file; end its name in .parquet")
    console = Console(highlight=False)
    try:
        if options.out:
            check_writable(options.out, overwrite=True)
        if options.trial is not None:
            return _one(options.seed, options.trial, options.sealed, console)
        return _many(options, console)
    except (InputError, ValueError, OSError) as problem:
        print(f"benchmarks: {problem}", file=sys.stderr)
        return UNUSABLE
    except KeyboardInterrupt:
        kept = f"; {options.out} has what was done, the same command goes on" if options.out else ""
        print(f"benchmarks: interrupted{kept}", file=sys.stderr)
        return INTERRUPTED


def _many(options: argparse.Namespace, console: Console) -> int:
    from benchmarks.concealed import campaign, report
    from benchmarks.concealed.scores import goals

    wanted = indices(options.seed, options.trials, *(options.kind or ()))
    processes = options.processes or len(os.sched_getaffinity(0))
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    shown = Console(stderr=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        Progress(*columns, console=shown, transient=True, disable=not shown.is_terminal) as bar,
    ):
        out = options.out or Path(folder) / "concealed.parquet"
        task = bar.add_task("")

        def advance(what: str, done: int, total: int) -> None:
            bar.update(task, description=what, completed=done, total=total)

        rows = campaign.run(options.seed, wanted, out, processes, console.print, advance, options.sealed)
    if options.compare:
        from benchmarks.concealed.comparison import differences

        for line in differences(campaign.read_rows(options.compare), rows):
            console.print(line, soft_wrap=True)
    if options.figures:
        from benchmarks.concealed import figures

        for path in figures.draw(rows, options.figures):
            console.print(f"Wrote {path}", soft_wrap=True)
    if options.markdown:
        print(report.markdown(rows))
    else:
        for table in report.tables(rows):
            console.print(table)
    return MISSED if any(goal.met is False for goal in goals(rows)) else DONE


def _one(seed: int, index: int, sealed: bool, console: Console) -> int:
    """Runs a trial and prints what was hidden and what was said."""
    from benchmarks.concealed import campaign, report

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # in a process as in a campaign: its truth is then the same to the last bit
        ((_, digest),) = campaign.worked(campaign.seal, [(seed, index, folder, sealed)], [index], 1)
        if isinstance(digest, Exception):
            raise digest
        console.print(f"Trial {index} of seed {seed}: truth sealed, SHA-256 {digest}.", soft_wrap=True)
        row = campaign.judge(folder, index, digest)
        truth = campaign.opened(folder, index, digest)
        for line in report.story(truth, row):
            console.print(line, soft_wrap=True)
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
