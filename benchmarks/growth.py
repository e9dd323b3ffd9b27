"""How the cost grows with arms, samples, joints, candidates and files: exponents with their intervals, and a figure.

Cost is processor time, because wall time on a machine with other work measures that as well. An exponent is the slope
of log cost over log size; of a program, the constant part that its start takes is estimated beside it.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import curve_fit
from scipy.stats import t as student

from benchmarks.fits import fit
from benchmarks.measure import ROOT, Record
from benchmarks.problem import NOISE, Measured, measured, simulated_arms
from benchmarks.seed_way import sample_joints
from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.dh import six_parameter_to_hayati
from lite6jax.arms.factory import write_factory
from lite6jax.calibration.fleet import fit_fleet
from lite6jax.calibration.quality import Result
from lite6jax.design.criteria import Determinant
from lite6jax.design.information import plan_experiment
from lite6jax.design.selection import Pool, choose
from lite6jax.design.sensor import Sensor
from lite6jax.fleet.place import BATCH

MILLION = 10**6
KNOWN_WITHIN = 0.5
"""Half the 95 % interval of an exponent beyond which nothing is extrapolated: the runs were too short or too noisy."""
FIGURE = ROOT / "docs" / "pictures" / "growth.png"


@dataclass(frozen=True)
class Growth:
    """What a cost is at several sizes, as constant + factor · size^exponent.

    Attributes:
        of: what grows.
        size: of each run.
        seconds: processor time of each, the least of its repeats.
        constant: s.
        factor: s.
        exponent: of the size.
        interval: half the 95 % interval of the exponent.
    """

    of: str
    size: np.ndarray
    seconds: np.ndarray
    constant: float
    factor: float
    exponent: float
    interval: float

    @property
    def known(self) -> bool:
        """Whether the exponent is known well enough to extrapolate, and the size has no bound of its own."""
        return self.interval <= KNOWN_WITHIN and "joints" not in self.of

    def at(self, size: Any) -> Any:
        """s at another size."""
        return self.constant + self.factor * size**self.exponent


def fitted(of: str, size: Sequence[float], seconds: Sequence[float], start: bool = False) -> Growth:
    """The growth that relative errors of equal size make likeliest.

    Args:
        of: what grows.
        size: of each run.
        seconds: of each run.
        start: whether there is a constant part, which is not negative.

    Raises:
        ValueError: fewer than four sizes, which leave too few residuals.
    """
    x, y = np.asarray(size, float), np.asarray(seconds, float)
    if len(x) < 4:
        raise ValueError(f"{of}: {len(x)} sizes; give 4 or more")

    def log_cost(x: np.ndarray, factor: float, exponent: float, constant: float = 0.0) -> np.ndarray:
        return np.log(constant + np.exp(factor) * (x / x.max()) ** exponent)

    first = (np.log(y.max()), 1.0, *((y.min() / 2,) if start else ()))
    bounds = ((-np.inf, 0.0, 0.0)[: len(first)], (np.inf, 6.0, y.min())[: len(first)])
    found, covariance = curve_fit(log_cost, x, np.log(y), first, bounds=bounds)
    spread = float(student.ppf(0.975, len(x) - len(first)) * np.sqrt(covariance[1, 1]))
    constant = float(found[2]) if start else 0.0
    return Growth(of, x, y, constant, float(np.exp(found[0]) / x.max() ** found[1]), float(found[1]), spread)


def growth(scale: float = 1.0, figure: Path | None = FIGURE) -> Iterator[Record]:
    """Exponents, what a million takes by them, and where memory, files and messages stand at the largest size run.

    Args:
        scale: of all sizes; below 1 for smaller runs.
        figure: where it is drawn.
    """
    found: list[Growth] = []
    for of, sizes, prepared in (
        ("arms × 100 samples", (64, 128, 256, 512, 1024, 2048), _arms),
        ("samples of one arm", (6000, 12_000, 24_000, 48_000, 96_000), _samples),
        ("joints of 16 arms × 300 samples", (4, 6, 8, 11, 14), _joints),
        ("candidates of a D-optimal design", (4000, 8000, 16_000, 32_000), _candidates),
    ):
        unscaled = prepared is _joints
        sizes = [size if unscaled else max(int(scale * size), 16) for size in sizes]
        runs = [prepared(size) for size in sizes]
        wrong = next(filter(None, (run()[1] for run in runs)), "")  # compiles, and checks the answers
        seconds = [min(_processor_time(run) for _ in range(3)) for run in runs]
        found.append(fitted(of, sizes, seconds))
        yield from _records(found[-1], wrong)
    with tempfile.TemporaryDirectory() as name:
        grown, walls = _files([max(int(scale * size), 16) for size in (512, 1024, 2048, 4096, 8192)], Path(name))
    found.append(grown)
    yield from _records(grown, "")
    yield from walls
    if figure is not None:
        draw(found, figure)


def _records(grown: Growth, wrong: str) -> Iterator[Record]:
    work = grown.of
    yield Record(work, "lite6jax", "exponent", grown.exponent, "", "lower", wrong)
    yield Record(work, "lite6jax", "half the 95 % interval of it", grown.interval, "", "lower", wrong)
    for size, seconds in zip(grown.size, grown.seconds, strict=True):
        yield Record(work, "lite6jax", f"processor time of {size:.0f}", seconds, "s", "lower", wrong)
    if grown.known:
        yield Record(work, "lite6jax", "processor time of 10⁶, on paper", grown.at(MILLION), "s", "lower", wrong)


def _processor_time(run: Callable[[], Any]) -> float:
    before = time.process_time()
    run()
    return time.process_time() - before


def _arms(arms: int) -> Callable[[], tuple[Any, str]]:
    problem = measured(arms, 100, seed=11)
    return lambda: _fitted(problem)


def _samples(samples: int) -> Callable[[], tuple[Any, str]]:
    problem = measured(1, samples, seed=12)
    return lambda: _fitted(problem)


def _fitted(problem: Measured) -> tuple[Any, str]:
    solution = fit(problem)
    stopped = int((solution.result != Result.CONVERGED).sum())
    return solution, f"{stopped} arms did not converge" if stopped else ""


def _joints(dof: int) -> Callable[[], tuple[Any, str]]:
    """Arms of so many joints whose neighbouring axes are perpendicular, and their poses with noise."""
    random = np.random.default_rng(dof)
    roll = np.where(np.arange(dof) % 2, 1, -1) * np.pi / 2 * (np.arange(dof) > 0)
    kinematics = np.column_stack([random.uniform(0.1, 0.3, (dof, 3)), roll, np.zeros((dof, 2))])
    arm = Arm("grown", kinematics)
    chains = kinematics + random.normal(0, 1, (16, dof, 6)) * 1e-3
    q = random.uniform(-2, 2, (300, dof))
    links = [[frames.transform_from_row(row) for row in chain] for chain in chains]
    T = np.stack([frames.chain(np.array(each), q) for each in links])
    T[:, :, :3, 3] += random.normal(0, NOISE[0], (*T.shape[:2], 3))
    truth = six_parameter_to_hayati(arm.form, chains, arm.hayati)

    def run() -> tuple[Any, str]:
        solution = fit_fleet(q, T, nominal=arm, noise=NOISE)
        off = float(np.abs(solution.parameters - truth).max())
        return solution, "" if off < 1e-3 else f"{dof} joints: off by {off:.2g} m or rad"

    return run


def _candidates(count: int) -> Callable[[], tuple[Any, str]]:
    experiment = plan_experiment("lite6", Sensor("pose", *NOISE), frame=False)
    rows = experiment.rows(sample_joints(count, np.random.default_rng(0)))
    return lambda: (choose(Pool(rows), 40, Determinant()), "")


def _files(sizes: Sequence[int], folder: Path) -> tuple[Growth, list[Record]]:
    """The command `fleet` on so many factory files; and what the largest run takes of memory, disk and messages."""
    arms = folder / "arms"
    arms.mkdir()
    seconds, written = [], 0
    command = [sys.executable, "-m", "lite6jax.cli", "fleet", str(arms), "--force", "--processes", "1", "--out"]
    table = folder / "fleet.parquet"
    chains = simulated_arms(max(sizes), seed=6)
    for size in sizes:
        for number in range(written, size):
            write_factory(chains[number], arms / f"arm{number:07d}.yaml")
        written = max(written, size)
        if size == sizes[0]:
            subprocess.run([*command, str(table)], cwd=ROOT, check=True, capture_output=True)  # compiles
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([*command, str(table)], cwd=ROOT, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    grown = fitted("files of `fleet`", sizes, seconds, start=True)
    work = f"{sizes[-1]} files"
    row = os.stat(table).st_size / sizes[-1]
    name = len("arm0000000.yaml") + sys.getsizeof("") + 8
    return grown, [
        Record(work, "fleet", "table, a row", row, "B", "lower"),
        Record("10⁶ files, on paper", "fleet", "table", MILLION * row / 2**20, "MiB", "lower"),
        Record("10⁶ files, on paper", "fleet", "names in memory", MILLION * name / 2**20, "MiB", "lower"),
        Record("10⁶ files, on paper", "scheduler", "batches, a message each way", MILLION / BATCH, "", "lower"),
    ]


def draw(found: Sequence[Growth], path: Path) -> None:
    """The costs over their sizes on two logarithmic scales, with what was fitted."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 5.2), layout="constrained")
    for number, grown in enumerate(found):
        colour = f"C{number}"
        axes.plot(grown.size, grown.seconds, "o", color=colour)
        last = MILLION if grown.known else grown.size[-1]
        x = np.geomspace(grown.size[0], last, 100)
        named = f"{grown.of}: exponent {grown.exponent:.2f} ± {grown.interval:.2f}"
        measured_part = x <= grown.size[-1]
        axes.plot(x[measured_part], grown.at(x[measured_part]), "-", color=colour, label=named)
        axes.plot(x[~measured_part], grown.at(x[~measured_part]), ":", color=colour)
    axes.set(xscale="log", yscale="log", xlabel="size", ylabel="processor time (s)")
    axes.set_title("Measured (points), fitted (lines) and extrapolated to 10⁶ (dotted)", fontsize="medium")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=110)
    plt.close(figure)
