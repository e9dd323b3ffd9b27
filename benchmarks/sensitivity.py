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


Change = tuple[str, float, float, int, int, float, int]
"""An option, its value and the one tried; then trials whose findings differ, whose faults do, the shift, failures."""


class Outcome(NamedTuple):
    """What a diagnosis says of a trial: findings with their estimates and deviations, faults, or an error."""

    findings: dict[tuple[str, str, float | None], tuple[list[float], list[float]]]
    faults: tuple[str, ...]
    error: str = ""


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
        with ProcessPoolExecutor(chosen.processes, get_context("spawn")) as pool:
            list(pool.map(partial(_write, folder), indices))
            before = list(pool.map(partial(_outcome, folder, None, 0.0), indices))
            jobs = [pool.map(partial(_outcome, folder, option, tried), indices) for option, _, tried in changes]
            rows: list[Change] = []
            for k, (change, after) in enumerate(zip(changes, jobs, strict=True), 1):
                rows.append((*change, *_compare(before, list(after))))
                print(f"\r{k} of {len(jobs)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    heads = ("value", "tried", "findings differ", "faults differ", "largest shift (σ)", "errors")
    table = Table(
        "option", *heads, title=f"sensitivity over {len(indices)} trials of seed {SEED}", title_justify="left"
    )
    for option, value, tried, findings, faults, shift, failed in sorted(rows, key=_dependence):
        cells = (f"{value:.4g}", f"{tried:.4g}", str(findings), str(faults), f"{shift:.2g}", str(failed))
        table.add_row(option, *cells)
    Console().print(table)
    options, idle = {row[0] for row in rows}, idle_options(rows)
    Console().print(f"{len(idle)} of {len(options)} options change nothing here: {', '.join(idle)}.")
    return 0


def idle_options(rows: Sequence[Change]) -> list[str]:
    """The options of whose changes none has other findings, other faults, a shift above 0.01 σ or a failure."""
    changing = {
        name for name, _, _, findings, faults, shift, failed in rows if findings or faults or failed or shift > 0.01
    }
    return sorted({name for name, *_ in rows} - changing)


def _dependence(row: Change) -> tuple[int, float]:
    """By which rows are sorted, those on which most depends first."""
    *_, findings, faults, shift, failed = row
    return -findings - faults - failed, -shift


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
            for tried in (value / FACTOR, value * FACTOR):
                if isinstance(value, int):
                    step = 1 if tried > value else -1
                    tried = max(round(tried), 1) if round(tried) != value else value + step
                if tried != value and tried > 0:
                    yield f"{group}.{field.name}", value, tried


def _write(folder: Path, index: int) -> None:
    write_files(draw(SEED, index).files, folder / str(index))


def _outcome(folder: Path, option: str | None, tried: float, index: int) -> Outcome:
    """The search of all rows of a trial; held-out errors are not part of it."""
    from lite6jax.diagnosis.explanation import Case, explain
    from lite6jax.diagnosis.options import Options
    from lite6jax.recordings import read_recording
    from lite6jax.search.final_estimates import final_estimates

    options: Any = Options()
    if option is not None:
        group, name = option.split(".")
        if group == "diagnosis":
            options = replace(options, **{name: tried})
        else:
            options = replace(options, **{group: replace(getattr(options, group), **{name: tried})})
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


def _compare(before: Sequence[Outcome], after: Sequence[Outcome]) -> tuple[int, int, float, int]:
    """Trials whose findings differ and whose faults do, the largest shift of an unchanged finding, trials that fail."""
    pairs, shifts = list(zip(before, after, strict=True)), [0.0]
    for old, new in pairs:
        for key in old.findings.keys() & new.findings.keys():
            (a, std), (b, _) = old.findings[key], new.findings[key]
            if len(a) == len(b):
                shifts += [abs(y - x) / s for x, y, s in zip(a, b, std, strict=True) if s > 0]
    findings = sum(old.findings.keys() != new.findings.keys() for old, new in pairs)
    faults = sum(old.faults != new.faults for old, new in pairs)
    return findings, faults, max(shifts), sum(bool(new.error) and not old.error for old, new in pairs)
