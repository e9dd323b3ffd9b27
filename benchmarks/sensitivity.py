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
from benchmarks.concealed.trials import draw

FACTOR = 1.5
SEED = 8
TRIALS = (35, 45, 100, 0, 3, 5, 10, 25, 55, 60)
"""Mixed, outside, faulty, clean and single ones, static and moving, of chains known, uncertain and unknown."""


class Change(NamedTuple):
    """What one change of one option changes over the trials.

    Attributes:
        option: its group and name.
        value: the documented one.
        changed: the one tried.
        findings: trials whose findings differ, by effect, site and order.
        faults: trials whose data faults differ.
        shift: the largest shift of an estimate of an unchanged finding, in its standard deviations.
        failed: trials that end in an error.
    """

    option: str
    value: float
    changed: float
    findings: int
    faults: int
    shift: float
    failed: int


class Outcome(NamedTuple):
    """What a diagnosis says of a trial: findings with their estimates, faults, or an error."""

    findings: dict[tuple[str, str, float | None], tuple[list[float], list[float]]]
    faults: tuple[str, ...]
    error: str = ""


def main(arguments: Sequence[str]) -> int:
    """Runs all changes and prints what depends on each option, the most first. The exit code."""
    description = "What a diagnosis depends on, option by option."
    parser = argparse.ArgumentParser(prog="python -m benchmarks sensitivity", description=description)
    parser.add_argument("--trials", type=int, default=len(TRIALS), metavar="N", help="how many of the fixed set")
    parser.add_argument("--only", nargs="+", metavar="OPTION", help="only these options, as group.name")
    parser.add_argument("--processes", type=int, default=len(os.sched_getaffinity(0)), metavar="P")
    chosen = parser.parse_args(arguments)
    console = Console()
    changes = [c for c in variations() if not chosen.only or c[0] in chosen.only]
    if not changes:
        parser.error("--only: no such option; they are " + ", ".join(dict.fromkeys(name for name, *_ in variations())))
    with tempfile.TemporaryDirectory() as name:
        folder, indices = Path(name), TRIALS[: chosen.trials]
        with ProcessPoolExecutor(chosen.processes, get_context("spawn")) as pool:
            list(pool.map(partial(_written, folder), indices))
            baseline = list(pool.map(partial(_outcome, folder, None, 0.0), indices))
            jobs = [
                (option, value, changed, [pool.submit(_outcome, folder, option, changed, i) for i in indices])
                for option, value, changed in changes
            ]
            rows = []
            for k, (option, value, changed, futures) in enumerate(jobs, 1):
                rows.append(_compared(option, value, changed, baseline, [future.result() for future in futures]))
                print(f"\r{k} of {len(jobs)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    console.print(table(rows, len(indices)))
    idle = sorted({r.option for r in rows} - {r.option for r in rows if r.findings or r.faults or r.shift > 0.01})
    console.print(f"{len(idle)} of {len({r.option for r in rows})} options change nothing here: {', '.join(idle)}.")
    return 0


def variations() -> Iterator[tuple[str, float, float]]:
    """Every numeric option by group and name, its value, and each value to try."""
    from lite6jax.diagnosis.options import Options

    options = Options()
    groups = {"engine": options.engine, "screening": options.screening, "diagnosis": options}
    for group, holder in groups.items():
        for field in fields(holder):
            value = getattr(holder, field.name)
            if isinstance(value, bool) or not isinstance(value, int | float):
                continue
            for changed in (value / FACTOR, value * FACTOR):
                if isinstance(value, int):
                    step = 1 if changed > value else -1
                    changed = max(round(changed), 1) if round(changed) != value else value + step
                if changed != value and changed > 0:
                    yield f"{group}.{field.name}", value, changed


def table(rows: Sequence[Change], trials: int) -> Table:
    """All changes, those on which most depends first."""
    shown = Table(title=f"sensitivity over {trials} trials of seed {SEED}", title_justify="left")
    for name in ("option", "value", "tried", "findings differ", "faults differ", "largest shift (σ)", "errors"):
        shown.add_column(name, justify="left" if name == "option" else "right", overflow="fold")
    for row in sorted(rows, key=lambda r: (-r.findings - r.faults - r.failed, -r.shift)):
        cells = (f"{row.value:.4g}", f"{row.changed:.4g}", str(row.findings), str(row.faults), f"{row.shift:.2g}")
        shown.add_row(row.option, *cells, str(row.failed))
    return shown


def _written(folder: Path, index: int) -> None:
    write_files(draw(SEED, index).files, folder / str(index))


def _outcome(folder: Path, option: str | None, changed: float, index: int) -> Outcome:
    """The search of all rows of a trial; held-out errors are not part of it."""
    from lite6jax.diagnosis.explanation import Case, explain
    from lite6jax.diagnosis.options import Options
    from lite6jax.recordings import read_recording
    from lite6jax.search.final_estimates import final_estimates

    options: Any = Options()
    if option is not None:
        group, name = option.split(".")
        if group == "diagnosis":
            options = replace(options, **{name: changed})
        else:
            options = replace(options, **{group: replace(getattr(options, group), **{name: changed})})
    try:
        found = explain(Case(read_recording(folder / str(index) / "recording.csv"), None, "declared", options))
        state = final_estimates(found.problem, found.selection.state, options.engine)
    except Exception as problem:  # an option may be moved to where nothing works: that is a result too
        return Outcome({}, (), f"{type(problem).__name__}: {problem}"[:200])
    findings = {}
    for term, part in zip(state.fit.terms.terms, state.fit.terms.slices, strict=True):
        std = np.sqrt(np.diagonal(state.fit.covariance)[part])
        order = None if term.chosen is None else round(term.chosen, 1)
        findings[term.label.split(":")[0], term.site, order] = (state.fit.values[part].tolist(), std.tolist())
    return Outcome(findings, tuple(fault.code for fault in found.screened.found))


def _compared(option: str, value: float, changed: float, before: Sequence[Outcome], after: Sequence[Outcome]) -> Change:
    pairs, shifts = list(zip(before, after, strict=True)), [0.0]
    for old, new in pairs:
        for key in old.findings.keys() & new.findings.keys():
            (a, std), (b, _) = old.findings[key], new.findings[key]
            if len(a) == len(b):
                shifts += [abs(y - x) / s for x, y, s in zip(a, b, std, strict=True) if s > 0]
    findings = sum(old.findings.keys() != new.findings.keys() for old, new in pairs)
    faults = sum(old.faults != new.faults for old, new in pairs)
    failed = sum(bool(new.error) and not old.error for old, new in pairs)
    return Change(option, value, changed, findings, faults, max(shifts), failed)
