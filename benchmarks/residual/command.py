"""`python -m benchmarks rivals`: the diagnosis beside what others would do, on real series and on concealed trials."""

import argparse
import csv
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import count as indices
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.ending import DONE, ended
from benchmarks.measure import Record
from benchmarks.residual.score import OURS, Outcome, compare, diagnosed, diagnosed_elsewhere, transfer, unseen
from lite6jax.diagnosis.document import read_model, write_document
from lite6jax.domains.pose.files import read_motion
from lite6jax.domains.pose.predict import predict
from lite6jax.errors import InputError
from lite6jax.fitting.compiled import keep_compiled_code
from lite6jax.recordings import Recording, read_recording, sidecar_path
from lite6jax.storage import check_writable, write_atomically

REAL = "LITE6JAX_REAL"
"""The variable that names the folder of real series."""
_NAMED = 8


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 2 for arguments that cannot be used, 130 where interrupted."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks rivals",
        description="The geometry alone; over it a Gaussian process, a neural network, ridge regression on Fourier "
        "orders and gravity, stepwise regression; and the diagnosis. On real series by contiguous held-out fifths, and "
        "from each series to the next with sensor frame and tool registered anew; on concealed trials by the motion "
        "that none of them saw.",
    )
    parser.add_argument(
        "--real", type=Path, metavar="DIR", help=f"recordings (.csv with .yaml) of one arm; ${REAL} where not given"
    )
    parser.add_argument(
        "--concealed",
        type=int,
        default=0,
        metavar="N",
        help="the first N trials that `concealed` draws, but faulty data",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of those; 0 if not given")
    parser.add_argument(
        "--trials", type=Path, metavar="DIR", help="trials in folders: recording.csv, unseen.csv, truth"
    )
    parser.add_argument("--every", type=int, default=1, metavar="K", help="of a real series: every K-th row")
    parser.add_argument("--rivals-only", action="store_true", help="leave the diagnosis out, which takes longest")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write the records to this file, over an older one")
    options = parser.parse_args(arguments)
    real = options.real or (Path(os.environ[REAL]) if os.environ.get(REAL) else None)
    for name, least in (("every", 1), ("concealed", 0), ("seed", 0)):
        if getattr(options, name) < least:
            parser.error(f"--{name}: give {least} or more")
    if real is None and options.trials is None and not options.concealed:
        parser.error(f"name what to compare on: --real DIR (or the variable {REAL}), --concealed N or --trials DIR")
    keep_compiled_code()
    return ended(partial(_compare, options, real))


def _compare(options: argparse.Namespace, real: Path | None) -> int:
    console, records = Console(highlight=False), []
    if options.json:
        check_writable(options.json, overwrite=True)
    with console.status("…") as status:
        if real is not None:
            for title, outcomes in on_real(series_in(real), options.every, not options.rivals_only, status.update):
                console.print(table(title, outcomes))
                records += [record for outcome in outcomes for record in records_of(title, outcome)]
        with tempfile.TemporaryDirectory() as folder:
            drawn = concealed(options.concealed, options.seed, Path(folder))
            for where in (drawn, trials_in(options.trials) if options.trials else []):
                if where:
                    results = [on_trial(each, not options.rivals_only, status.update) for each in where]
                    console.print(summary(results))
                    records += [
                        record
                        for each, (outcomes, _) in zip(where, results, strict=True)
                        for outcome in outcomes
                        for record in records_of(f"trial {each.name}", outcome)
                    ]
    if options.json:
        text = json.dumps([record.as_json() for record in records], indent=1, allow_nan=False)
        write_atomically(options.json, text, overwrite=True)
    return DONE


# ------------------------------------------------------------------ real series


def series_in(folder: Path) -> list[Path]:
    """The recordings in a folder, by name.

    Raises:
        InputError: there are none.
    """
    found = sorted(path for path in folder.glob("*.csv") if sidecar_path(path).exists())
    if not found:
        raise InputError(f"{folder}: holds no recording (.csv with .yaml beside it); put the real series there")
    return found


def on_real(
    paths: Sequence[Path], every: int, ours: bool, progress: Callable[[str], object]
) -> Iterator[tuple[str, list[Outcome]]]:
    """A title and the outcomes: each series by itself, and from each to the next."""
    series = [_thinned(read_recording(path), every) for path in paths]
    for k, (path, recording) in enumerate(zip(paths, series, strict=True)):

        def said(who: str, where: str = path.name) -> object:
            return progress(f"{where}: {who}")

        outcomes = list(compare(recording, progress=said))
        elsewhere = []
        other = series[k + 1] if k + 1 < len(series) else None
        if other is not None:
            elsewhere = list(transfer(recording, other, progress=said))
        if ours:
            said(OURS)
            outcome, document = diagnosed(recording)
            outcomes.append(outcome)
            if other is not None:
                with tempfile.TemporaryDirectory() as folder:
                    stored = write_document(document, Path(folder) / "d.json")
                    errors = diagnosed_elsewhere(read_model(stored), other)
                elsewhere.append(replace(outcome, errors=errors))
        yield f"{path.name}, {recording.samples} rows, held-out fifths", outcomes
        if other is not None:
            yield f"from {path.name} to {paths[k + 1].name}, frame and tool registered anew", elsewhere


def _thinned(recording: Recording, every: int) -> Recording:
    return recording if every == 1 else recording.select(np.arange(0, recording.samples, every))


# ------------------------------------------------------------------ concealed trials


class Truth(NamedTuple):
    """What is known of a trial once it is opened.

    Attributes:
        position: `(sample, 3)` m, of the unseen motion, without noise.
        names: what is hidden, as `effect:site`; physics outside the catalogue is unnamed.
        oracle: m, RMS that a fit reaches that is told the form of the truth; None where it was not made.
    """

    position: NDArray[np.float64]
    names: frozenset[str]
    oracle: float | None


def concealed(count: int, seed: int, folder: Path) -> list[Path]:
    """The folders of the first trials of a campaign, drawn anew, their truths sealed beside them.

    Those with faulty data are left out: rivals that know of none would be compared by their fall.
    """
    from benchmarks.campaigns.campaign import given_in
    from benchmarks.concealed.campaign import POSES
    from benchmarks.concealed.plans import kind_of

    chosen = list(islice((index for index in indices() if kind_of(seed, index) != "faulty"), count))
    for index in chosen:
        POSES.seal(seed, index, folder)
    return [given_in(folder, index) for index in chosen]


def trials_in(folder: Path) -> list[Path]:
    """The folders of trials below a folder, by name.

    Raises:
        InputError: there are none.
    """
    found = sorted(path.parent for path in folder.glob("**/recording.csv") if (path.parent / "unseen.csv").exists())
    if not found:
        raise InputError(f"{folder}: holds no trial (recording.csv and unseen.csv); name the folder above the trials")
    return found


def truth_of(folder: Path) -> Truth:
    """The truth of a trial, sealed beside or open within.

    Raises:
        InputError: there is none.
    """
    from benchmarks.concealed.scores import called

    sealed = folder.parent.parent / "sealed" / f"{folder.name}.json"
    if sealed.exists():
        said = json.loads(sealed.read_text())
        names = frozenset(f"{called(effect)}:{effect['site']}" for effect in said["hidden"])
        return Truth(np.array(said["unseen_position_m"]), names, said["oracle"]["unseen_position_rms_m"])
    try:
        said = json.loads((folder / "truth.json").read_text())
        with open(folder / "unseen_truth.csv", newline="") as file:
            shown = [[float(row[name]) for name in ("x_m", "y_m", "z_m")] for row in csv.DictReader(file)]
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{folder}: has no truth, sealed or open ({error}); score it where it was made") from error
    names = []
    for effect in said["effects"]:
        joint = effect["args"].get("joint")
        names.append(f"{effect['effect']}:{f'joint{joint}' if joint else _SITES.get(effect['effect'], '')}")
    return Truth(np.array(shown), frozenset(names), None)


_SITES = {
    "base_compliance": "base",
    "base_drift": "base",
    "tool_offset": "tool",
    "measurement_scale": "sensor",
    "time_offset": "clock",
    "link_thermal_expansion": "links",
}


def on_trial(folder: Path, ours: bool, progress: Callable[[str], object]) -> tuple[list[Outcome], Truth]:
    """Everyone on one trial; the diagnosis as the campaign left it, where it did."""
    recording, truth = read_recording(folder / "recording.csv"), truth_of(folder)
    told = replace(recording.settings, motion=recording.motion)
    motion = read_recording(folder / "unseen.csv", dof=recording.dof).made_anew(settings=told)

    def said(who: str) -> object:
        return progress(f"{folder.name}: {who}")

    outcomes = list(unseen(recording, motion, truth.position, said))
    if ours:
        said(OURS)
        stored, seconds = folder / "diagnosis.json", float("nan")
        with tempfile.TemporaryDirectory() as temporary:
            if not stored.exists():
                outcome, document = diagnosed(recording)
                seconds = outcome.seconds
                stored = write_document(document, Path(temporary) / "d.json")
            model = read_model(stored)
            said_by = json.loads(stored.read_text())
        shown = predict(model, read_motion(folder / "unseen.csv", model))
        errors = np.linalg.norm(shown[:, :3, 3] - truth.position, axis=1)
        names = tuple(f"{finding['effect']}:{finding['site']}" for finding in said_by["findings"])
        outcomes.append(Outcome(OURS, errors, model.physics.size, names, seconds))
    return outcomes, truth


# ------------------------------------------------------------------ what is shown


def rms(errors: NDArray[np.floating]) -> float:
    """Of those that are there, in mm."""
    return 1e3 * float(np.sqrt(np.nanmean(errors**2)))


def table(title: str, outcomes: Sequence[Outcome]) -> Table:
    """A row each."""
    shown = Table(title=title, title_justify="left")
    for column in ("", "RMS mm", "p95 mm", "max mm", "numbers", "s", "names"):
        shown.add_column(column, justify="left" if column in ("", "names") else "right")
    for outcome in outcomes:
        e = 1e3 * outcome.errors
        shown.add_row(
            outcome.subject, f"{rms(outcome.errors):.4f}", f"{np.percentile(e, 95):.4f}", f"{e.max():.3f}",
            str(outcome.parameters), f"{outcome.seconds:.0f}", _names(outcome.names),
        )  # fmt: skip
    return shown


def _names(names: Sequence[str]) -> str:
    kinds: dict[str, list[str]] = {}
    for name in names:
        kinds.setdefault(name.split(":")[0], []).append(name.split(":")[1].removeprefix("joint"))
    told = [f"{kind} {', '.join(sites)}" for kind, sites in kinds.items()]
    return "; ".join(told[:_NAMED]) + ("; …" if len(told) > _NAMED else "") or "none"


def summary(results: Sequence[tuple[list[Outcome], Truth]]) -> Table:
    """Over all trials, a row each."""
    shown = Table(title=f"{len(results)} concealed trials, a motion that none of them saw", title_justify="left")
    columns = ("", "RMS mm, median", "× oracle, median", "exactly the names", "names where nothing is hidden")
    for column in (*columns, "numbers, median", "s, median"):
        shown.add_column(column, justify="right" if column else "left")
    for k in range(len(results[0][0])):
        mine = [(outcomes[k], truth) for outcomes, truth in results]
        hidden = [(outcome, truth) for outcome, truth in mine if truth.names]
        clean = [outcome for outcome, truth in mine if not truth.names]
        ratios = [rms(outcome.errors) / (1e3 * truth.oracle) for outcome, truth in mine if truth.oracle]
        right = sum(sorted(outcome.names) == sorted(truth.names) for outcome, truth in hidden)
        shown.add_row(
            mine[0][0].subject,
            f"{np.median([rms(outcome.errors) for outcome, _ in mine]):.4f}",
            f"{np.median(ratios):.2f}" if ratios else "",
            f"{right} of {len(hidden)}",
            f"{sum(bool(outcome.names) for outcome in clean)} of {len(clean)}",
            f"{np.median([outcome.parameters for outcome, _ in mine]):.0f}",
            f"{np.nanmedian([o.seconds for o, _ in mine]):.1f}" if np.isfinite(mine[0][0].seconds) else "",
        )
    return shown


def records_of(work: str, outcome: Outcome) -> Iterator[Record]:
    """For the JSON."""
    yield Record(work, outcome.subject, "error, RMS", rms(outcome.errors), "mm", "lower")
    yield Record(work, outcome.subject, "error, p95", 1e3 * float(np.nanpercentile(outcome.errors, 95)), "mm", "lower")
    yield Record(work, outcome.subject, "error, largest", 1e3 * float(np.nanmax(outcome.errors)), "mm", "lower")
    yield Record(work, outcome.subject, "numbers", float(outcome.parameters), "", "lower")
    yield Record(work, outcome.subject, f"names: {_names(outcome.names)}", float(len(outcome.names)), "", "higher")
    seconds = outcome.seconds if np.isfinite(outcome.seconds) else None
    yield Record(work, outcome.subject, "time", seconds, "s", "lower")
