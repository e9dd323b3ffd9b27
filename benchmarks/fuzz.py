"""`python -m benchmarks fuzz`: damaged files for every reader and command, each in a process that may die."""

import argparse
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.fuzz_worker import READY
from benchmarks.fuzzed import targets
from benchmarks.measure import Record
from lite6jax.errors import InputError
from lite6jax.storage import check_writable, write_atomically

ROOT = Path(__file__).resolve().parents[1]
MUTATIONS = 15_000
BATCH = 250
"""Mutations of a process, unless it dies."""
HANG_S = 30.0
START_S = 300.0
"""Until the first mutation: imports, a whole file, and for commands what is compiled."""
OUTCOMES = ("read", "refused")
_PLURAL = {"crash": "crashes", "hang": "hangs", "silent change": "silent changes", "traceback": "tracebacks"}
FAILURES = tuple(_PLURAL)


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

    def add(self, index: int, outcome: str, detail: str) -> None:
        """Counts one mutation."""
        self.counts[outcome] += 1
        if outcome in FAILURES:
            self.details.append(f"{outcome}: {self.name} {index}: {detail}")


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where anything failed, 2 for arguments that cannot be used."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
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
    try:
        if options.json:
            check_writable(options.json, overwrite=True)
    except InputError as error:
        print(f"benchmarks: {error}", file=sys.stderr)
        return 2
    names = options.only or list(targets())
    found = fuzz(names, options.mutations, options.seed, options.processes, options.keep)
    console = Console(highlight=False)
    console.print(table(found))
    for tally in found:
        for line in tally.details[:20]:
            console.print(line, soft_wrap=True, markup=False)
    listed = [record for tally in found for record in records(tally)]
    if options.json:
        text = json.dumps([record.as_json() for record in listed], indent=1, allow_nan=False)
        write_atomically(options.json, text, overwrite=True)
    return 1 if any(record.failed for record in listed) else 0


def fuzz(
    names: Sequence[str], mutations: int, seed: int = 0, processes: int = 1, keep: Path | None = None
) -> list[Tally]:
    """The tally of each target.

    Args:
        names: of the targets.
        mutations: of all together, shared by their weights.
        seed: of the damage; mutation k of a target is the same whatever the others.
        processes: at a time.
        keep: a folder for files that failed.
    """
    known = targets()
    weights = {name: getattr(known[name], "weight", 5.0) for name in names}
    found = {name: Tally(name) for name in names}
    batches = []
    for name in names:
        count = max(1, round(mutations * weights[name] / sum(weights.values())))
        batches += [(name, first, min(first + BATCH, count)) for first in range(0, count, BATCH)]
    with ThreadPoolExecutor(processes) as pool:
        outcomes = pool.map(lambda batch: _batch(batch[0], batch[1], batch[2], seed, keep), batches)
        for (name, _, _), each in zip(batches, outcomes, strict=True):
            for outcome in each:
                found[name].add(*outcome)
    return list(found.values())


def records(tally: Tally) -> Iterator[Record]:
    """The counts of a target; a failure is wrong."""
    yield Record("fuzz", tally.name, "mutations", float(tally.counts.total()), "", "higher")
    for outcome in FAILURES:
        count = tally.counts[outcome]
        wrong = f"{count} of {tally.counts.total()}" if count else ""
        yield Record("fuzz", tally.name, _PLURAL[outcome], float(count), "", "lower", wrong)


def table(found: Sequence[Tally]) -> Table:
    """A row for each target, and one for all."""
    shown = Table(title="fuzz", title_justify="left")
    shown.add_column("target")
    for column in ("mutations", *OUTCOMES, *_PLURAL.values()):
        shown.add_column(column, justify="right")
    total = sum((tally.counts for tally in found), Counter())
    for name, counts in (*((tally.name, tally.counts) for tally in found), ("all", total)):
        cells = (counts.total(), *(counts[outcome] for outcome in (*OUTCOMES, *FAILURES)))
        shown.add_row(name, *map(str, cells), style="red" if any(counts[outcome] for outcome in FAILURES) else None)
    return shown


def _batch(name: str, first: int, last: int, seed: int, keep: Path | None) -> list[tuple[int, str, str]]:
    """The outcome of each mutation from `first` to before `last`; after one that ends its process, another goes on."""
    outcomes: list[tuple[int, str, str]] = []
    while first < last:
        outcomes += _process(name, first, last, seed, keep)
        first = outcomes[-1][0] + 1
    return outcomes


def _process(name: str, first: int, last: int, seed: int, keep: Path | None) -> list[tuple[int, str, str]]:
    """The outcomes of one process in order, up to the mutation that ended it.

    Raises:
        RuntimeError: it ended before the first mutation.
    """
    command = [sys.executable, "-m", "benchmarks.fuzz_worker", name, str(seed), str(first), str(last), str(keep or "")]
    outcomes: list[tuple[int, str, str]] = []
    with (
        tempfile.TemporaryFile("w+", errors="replace") as said,
        subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=said, text=True) as process,
    ):
        lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=_read, args=(process, lines), daemon=True).start()
        patience = START_S
        while first < last:
            line = _next_line(lines, process.pid, patience)
            if line is None:
                process.kill()
                return [*outcomes, (first, "hang", f"longer than {patience:g} s")]
            if not line:
                said.seek(0)
                reason = f"exit code {process.wait()}: {(said.read().strip().splitlines() or ['nothing said'])[-1]}"
                if patience == START_S:
                    raise RuntimeError(f"fuzz: {name}: the process ended before a mutation: {reason}")
                return [*outcomes, (first, "crash", reason)]
            patience = HANG_S
            if line != READY:
                outcome, detail = json.loads(line)
                outcomes.append((first, outcome, detail))
                first += 1
    return outcomes


def _next_line(lines: queue.Queue[str], pid: int, patience: float) -> str | None:
    """The next line of a process; None where it has worked for `patience` seconds, or waited for five times as long.

    The time of the processor counts, because what else the machine does is no fault of a file.
    """
    worked, started = _processor_time(pid), time.monotonic()
    while time.monotonic() - started < 5 * patience and _processor_time(pid) - worked < patience:
        try:
            return lines.get(timeout=1.0)
        except queue.Empty:
            continue
    return None


def _processor_time(pid: int) -> float:
    """Seconds, of all threads of a process; 0 where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _read(process: subprocess.Popen[str], lines: queue.Queue[str]) -> None:
    """Puts each line of a process into a queue, and an empty one at its end."""
    assert process.stdout is not None
    for line in process.stdout:
        lines.put(line)
    lines.put("")
