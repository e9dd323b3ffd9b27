"""A measured number with its unit, its time, its check and its file, and the exit codes."""

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import TypeVar

import numpy as np

from lite6jax.errors import InputError
from lite6jax.storage import write_atomically

T = TypeVar("T")

ROOT = Path(__file__).resolve().parents[1]
DONE, MISSED, UNUSABLE, INTERRUPTED = 0, 1, 2, 130

OURS = "lite6jax"
AGREES = 1e-9  # m and rad: how near all solvers' parameters must be, a ten-thousandth of what the noise leaves open


@dataclass(frozen=True)
class Record:
    """One number of a run."""

    workload: str  # what was to be done
    subject: str  # who did it
    metric: str  # what the number says
    value: float | None  # the number; None where there is none because the subject failed
    unit: str = ""  # of `value`
    failed: str = ""  # why the answer behind the number is wrong; empty where it is right or has no check


Workload = Callable[..., Iterator[Record]]  # runs without arguments; those it takes are for smaller runs


def time_call(call: Callable[[], T]) -> tuple[float, T]:
    """Seconds of one call, and its answer."""
    start = time.perf_counter()
    answer = call()
    return time.perf_counter() - start, answer


def median_time(call: Callable[[], T], repeats: int) -> tuple[float, T]:
    """Median seconds of some calls, and the last answer. Warm up before."""
    runs = [time_call(call) for _ in range(repeats)]
    return median(seconds for seconds, _ in runs), runs[-1][1]


def disagreement(answer: np.ndarray, reference: np.ndarray | float, within: float, what: str) -> str:
    """Why an answer is wrong: empty where no number of it is further than `within` from the reference."""
    distance = np.abs(np.asarray(answer) - np.asarray(reference)).max(initial=0.0)
    return "" if distance <= within else f"{what} off by {distance:.2g}, more than {within:g}"  # NaN is off too


def unlikely(parameters: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> str:
    """Why fitted parameters `(arm, parameter)` are not right: they miss the truth by more than their covariance allows.

    The squared errors in units of the covariance follow χ² with as many degrees of freedom as parameters, for each arm
    and, scaled by the number of arms, for all together: one right answer in 10⁹ is called wrong, and a solver that
    stops early, or a covariance that flatters, is found.
    """
    from scipy.stats import chi2  # here, so that its absence is said before it is needed

    error = parameters - truth
    squares = np.einsum("ai,ai->a", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    arms, size = error.shape
    worst, low, high = chi2.isf(1e-9 / arms, size), chi2.ppf(1e-9, arms * size), chi2.isf(1e-9, arms * size)
    if np.isfinite(squares).all() and squares.max() <= worst and low <= squares.sum() <= high:
        return ""
    each = squares / size
    return f"misses the truth: χ² a degree of freedom is {each.mean():.3g}, {each.max():.3g} at worst"


def write_records(path: Path, records: Sequence[Record]) -> None:
    """The records as a JSON list, over an older file; the key `failed` is there only where an answer is wrong."""
    said = [{key: value for key, value in asdict(each).items() if key != "failed" or value} for each in records]
    write_atomically(path, json.dumps(said, indent=1, allow_nan=False), overwrite=True)


def run_command(work: Callable[[], int], refused: tuple[type[Exception], ...] = (InputError,), kept: str = "") -> int:
    """The exit code of a command.

    Args:
        work: of the command, to its exit code.
        refused: exceptions that say what cannot be used.
        kept: what an interrupt leaves, a clause that begins with its punctuation.
    """
    try:
        return work()
    except refused as problem:
        print(f"benchmarks: {problem}", file=sys.stderr)
        return UNUSABLE
    except KeyboardInterrupt:
        print(f"benchmarks: interrupted{kept}", file=sys.stderr)
        return INTERRUPTED
