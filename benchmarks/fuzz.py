"""`python -m benchmarks fuzz`: damaged files for every reader and command, each in a process that may die."""

import argparse
import os
import resource
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.fuzzed import Trial, targets
from benchmarks.measure import DONE, MISSED, Record, ended, write_records
from lite6jax.storage import check_writable

MUTATIONS = 15_000
BATCH = 250
"""Mutations of a process, unless it dies."""
HANG_S = 30.0
START_S = 300.0
"""Until the first mutation: imports, a whole file, and for commands what is compiled."""
MEMORY = 16 << 30
"""Bytes of address space; a file that makes a process ask for more is a traceback."""
OUTCOMES = ("read", "refused")
_PLURAL = {"crash": "crashes", "hang": "hangs", "silent change": "silent changes", "traceback": "tracebacks"}

Work = Callable[[Connection, str, int, int, int, Path | None], None]
"""Sends None once it is ready, then outcome and detail of each mutation from the first to before the last."""


@dataclass
class Tally:
    """What came of the mutations of one target.

    Attributes:
        name: of the target.
        counts: by outcome.
        details: one line for each failure, with the number of the mutation.
    """

    name: str
    counts: Counter[str] = field(default_factory=Counter)
    details: list[str] = field(default_factory=list)

    def records(self) -> Iterator[Record]:
        """The counts; a failure is wrong."""
        yield Record("fuzz", self.name, "mutations", float(self.counts.total()), "", "higher")
        for outcome, plural in _PLURAL.items():
            count = self.counts[outcome]
            wrong = f"{count} of {self.counts.total()}" if count else ""
            yield Record("fuzz", self.name, plural, float(count), "", "lower", wrong)


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where anything failed, 2 for arguments that cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks fuzz", description=__doc__)
    parser.add_argument("--mutations", type=int, default=MUTATIONS, metavar="N", help=f"{MUTATIONS} if not given")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the damage; 0 if not given")
    parser.add_argument("--only", action="append", choices=sorted(targets()), help="this reader or command; repeatable")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the files that failed in this folder")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the records to this file, over an older one")
    parser.add_argument("--processes", type=int, default=len(os.sched_getaffinity(0)), metavar="P", help="at a time")
    options = parser.parse_args(arguments)
    if min(options.mutations, options.processes) < 1:
        parser.error("--mutations and --processes: give 1 or more")
    return ended(partial(_run, options))


def _run(options: argparse.Namespace) -> int:
    if options.json:
        check_writable(options.json, overwrite=True)
    names = options.only or list(targets())
    found = fuzz(names, options.mutations, options.seed, options.processes, options.keep)
    console = Console(highlight=False)
    console.print(table(found))
    for tally in found:
        for line in tally.details[:20]:
            console.print(line, soft_wrap=True, markup=False)
    listed = [record for tally in found for record in tally.records()]
    if options.json:
        write_records(options.json, listed)
    return MISSED if any(record.failed for record in listed) else DONE


def table(found: Sequence[Tally]) -> Table:
    """A row for each target, and one for all."""
    shown = Table(title="fuzz", title_justify="left")
    shown.add_column("target")
    for column in ("mutations", *OUTCOMES, *_PLURAL.values()):
        shown.add_column(column, justify="right")
    total = sum((tally.counts for tally in found), Counter())
    for name, counts in (*((tally.name, tally.counts) for tally in found), ("all", total)):
        cells = (counts.total(), *(counts[outcome] for outcome in (*OUTCOMES, *_PLURAL)))
        shown.add_row(name, *map(str, cells), style="red" if any(counts[outcome] for outcome in _PLURAL) else None)
    return shown


def mutations_of(pipe: Connection, name: str, seed: int, first: int, last: int, keep: Path | None) -> None:
    """Damages the file of a target and reads it, again and again."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.RLIM_INFINITY))
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(targets()[name], Path(folder))
        pipe.send(None)
        for index in range(first, last):
            outcome, detail, content = trial.mutation(seed, index)
            if keep and outcome not in OUTCOMES:
                path = keep / f"{name}_{index}_{outcome}{trial.damaged.suffix}".replace(" ", "_")
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            pipe.send((outcome, detail))


def fuzz(
    names: Sequence[str],
    mutations: int,
    seed: int = 0,
    processes: int = 1,
    keep: Path | None = None,
    work: Work = mutations_of,
) -> list[Tally]:
    """The tally of each target.

    Args:
        names: of the targets.
        mutations: of all together, shared by their weights.
        seed: of the damage; mutation k of a target is the same whatever the others.
        processes: at a time.
        keep: a folder for files that failed.
        work: of a process.
    """
    known = targets()
    weights = {name: getattr(known[name], "weight", 5.0) for name in names}
    found = {name: Tally(name) for name in names}
    batches = []
    for name in names:
        count = max(1, round(mutations * weights[name] / sum(weights.values())))
        batches += [(name, first, min(first + BATCH, count)) for first in range(0, count, BATCH)]
    with ThreadPoolExecutor(processes) as pool:
        outcomes = pool.map(lambda batch: list(_batch(work, batch[0], seed, batch[1], batch[2], keep)), batches)
        for (name, _, _), each in zip(batches, outcomes, strict=True):
            for index, outcome, detail in each:
                found[name].counts[outcome] += 1
                if outcome in _PLURAL:
                    found[name].details.append(f"{outcome}: {name} {index}: {detail}")
    return list(found.values())


def _batch(
    work: Work, name: str, seed: int, first: int, last: int, keep: Path | None
) -> Iterator[tuple[int, str, str]]:
    """The outcome of each mutation from `first` to before `last`; after one that ends its process, another goes on.

    Raises:
        RuntimeError: a process ended before its first mutation.
    """
    context = get_context("spawn")
    while first < last:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=work, args=(theirs, name, seed, first, last, keep), daemon=True)
        process.start()
        theirs.close()
        ready = False
        while first < last:
            try:
                answer = ours.recv() if _answers(ours, process.pid, HANG_S if ready else START_S) else "hang"
            except EOFError:
                process.join()
                if not ready:
                    raise RuntimeError(f"fuzz: {name}: the process ended before a mutation") from None
                answer = "crash"
            if answer is None:
                ready = True
                continue
            outcome, detail = (answer, f"exit code {process.exitcode}") if isinstance(answer, str) else answer
            yield first, outcome, detail
            first += 1
            if isinstance(answer, str):
                break
        process.kill()
        process.join()


def _answers(pipe: Connection, pid: int | None, patience: float) -> bool:
    """Whether a process answers before it has worked for `patience` seconds, or waited for five times as long.

    The time of the processor counts, because what else the machine does is no fault of a file.
    """
    worked, started = _processor_time(pid), time.monotonic()
    while time.monotonic() - started < 5 * patience and _processor_time(pid) - worked < patience:
        if pipe.poll(1.0):
            return True
    return False


def _processor_time(pid: int | None) -> float:
    """Seconds, of all threads of a process; 0 where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
