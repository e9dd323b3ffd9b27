"""`python -m benchmarks sensitivity`: what a diagnosis depends on, option by option.

Each option is multiplied and divided by 1.5, one at a time, on a fixed set of concealed trials; a count is rounded, and
moved by one at least. Findings, data faults and estimates are compared with those of the documented values. An option
on which nothing depends is a candidate for deletion.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.campaigns.campaign import write_files
from benchmarks.campaigns.command import at_least
from benchmarks.concealed.trials import draw

FACTOR = 1.5
SEED = 8
TRIALS = (35, 45, 100, 0, 3, 5, 10, 25, 55, 60)
"""Mixed, outside, faulty, clean and single ones, static and moving, of chains known, uncertain and unknown."""


class Outcome(NamedTuple):
    """What a diagnosis says of a trial."""

    findings: dict[tuple[str, str, float | None], tuple[list[float], list[float]]]  # with estimates and deviations
    faults: tuple[str, ...]
    failed: bool = False


class Dependence(NamedTuple):
    """What depends on a change of an option."""

    findings: int  # trials whose findings differ
    faults: int  # trials whose faults do
    shift: float  # the largest of an unchanged finding, in its standard deviations
    failed: int  # trials that fail


def main(arguments: Sequence[str]) -> int:
    """Runs all changes and prints what depends on each option, the most first. The exit code."""
    description = "What a diagnosis depends on, option by option."
    parser = argparse.ArgumentParser(prog="python -m benchmarks sensitivity", description=description)
    parser.add_argument(
        "--trials", type=at_least(1), default=len(TRIALS), metavar="N", help="how many of the fixed set"
    )
    parser.add_argument("--only", nargs="+", metavar="OPTION", help="only these options, as group.name")
    parser.add_argument("--processes", type=at_least(1), default=len(os.sched_getaffinity(0)), metavar="P")
    chosen = parser.parse_args(arguments)
    known = list(dict.fromkeys(name for name, *_ in variations()))
    if unknown := [name for name in chosen.only or () if name not in known]:
        parser.error(f"--only: no option {', '.join(unknown)}; they are {', '.join(known)}")
    changes = [change for change in variations() if change[0] in (chosen.only or known)]
    with tempfile.TemporaryDirectory() as name:
        folder, indices = Path(name), TRIALS[: chosen.trials]
        for index in indices:
            write_files(draw(SEED, index).files, folder / str(index))
        with ProcessPoolExecutor(chosen.processes, get_context("spawn")) as pool:
            before = list(pool.map(partial(_diagnosed, folder, None, 0.0), indices))
            jobs = [pool.map(partial(_diagnosed, folder, option, tried), indices) for option, _, tried in changes]
            found = []
            for k, after in enumerate(jobs, 1):
                found.append(_compare(before, list(after)))
                print(f"\r{k} of {len(jobs)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    rows = sorted(
        zip(changes, found, strict=True),
        key=lambda row: (-(row[1].findings + row[1].faults + row[1].failed), -row[1].shift),
    )
    heads = ("option", "value", "tried", "findings differ", "faults differ", "largest shift (σ)", "errors")
    table = Table(*heads, title=f"sensitivity over {len(indices)} trials of seed {SEED}", title_justify="left")
    for (option, *values), (findings, faults, shift, failed) in rows:
        cells = (*(f"{value:.4g}" for value in values), str(findings), str(faults), f"{shift:.2g}", str(failed))
        table.add_row(option, *cells)
    Console().print(table)
    changing = {name for (name, *_), on in rows if on.findings or on.faults or on.failed or on.shift > 0.01}
    options = {name for name, *_ in changes}
    idle = sorted(options - changing)
    Console().print(f"{len(idle)} of {len(options)} options change nothing here: {', '.join(idle)}.")
    return 0


def variations() -> Iterator[tuple[str, float, float]]:
    """Every numeric option by group and name, its value, and each value to try."""
    from lite6jax.diagnosis.options import Options

    options = Options()
    for group, holder in {"engine": options.engine, "diagnosis": options}.items():
        for field in fields(holder):
            value = getattr(holder, field.name)
            if isinstance(value, bool) or not isinstance(value, int | float):
                continue
            for tried in (value / FACTOR, value * FACTOR):
                if isinstance(value, int):
                    step = 1 if tried > value else -1
                    tried = max(round(tried), 1) if round(tried) != value else value + step
                if tried != value and tried > 0:
                    yield f"{group}.{field.name}", value, tried


def _diagnosed(folder: Path, option: str | None, tried: float, index: int) -> Outcome:
    """The search of all rows of a trial; held-out errors are not part of it."""
    from lite6jax.diagnosis.explanation import Case, explain
    from lite6jax.diagnosis.options import Options
    from lite6jax.recordings import read_recording
    from lite6jax.search.final_estimates import final_estimates

    options: Any = Options()
    if option is not None:
        group, name = option.split(".")
        changed = {name: tried}
        if group != "diagnosis":
            changed = {group: replace(getattr(options, group), **changed)}
        options = replace(options, **changed)
    try:
        found = explain(Case(read_recording(folder / str(index) / "recording.csv"), None, "declared", options))
        state = final_estimates(found.problem, found.selection.state, options.engine)
    except Exception:  # an option may be moved to where nothing works: that is a result too
        return Outcome({}, (), failed=True)
    findings = {}
    for term, part in state.fit.terms.pairs:
        std = np.sqrt(np.diagonal(state.fit.covariance)[part])
        order = None if term.chosen is None else round(term.chosen, 1)
        findings[term.label.split(":")[0], term.site, order] = (state.fit.values[part].tolist(), std.tolist())
    return Outcome(findings, tuple(fault.code for fault in found.screened.found))


def _compare(before: Sequence[Outcome], after: Sequence[Outcome]) -> Dependence:
    pairs, shifts = list(zip(before, after, strict=True)), [0.0]
    for old, new in pairs:
        for key in old.findings.keys() & new.findings.keys():
            (a, std), (b, _) = old.findings[key], new.findings[key]
            if len(a) == len(b):
                shifts += [abs(y - x) / s for x, y, s in zip(a, b, std, strict=True) if s > 0]
    findings = sum(old.findings.keys() != new.findings.keys() for old, new in pairs)
    faults = sum(old.faults != new.faults for old, new in pairs)
    return Dependence(findings, faults, max(shifts), sum(new.failed and not old.failed for old, new in pairs))
