"""A folder of factory files by the command, with one process and with two, against PyYAML's C loader on one core."""

import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import yaml

from benchmarks.measure import ROOT, Record, timed
from benchmarks.problem import simulated_arms
from lite6jax.arms.factory import write_factory


def folders(files: int = 3000, repeats: int = 3) -> Iterator[Record]:
    """Least wall seconds of the command after one that compiles, whose tables are to have the same bytes."""
    work = f"{files} factory files"
    with tempfile.TemporaryDirectory() as name:
        arms = Path(name, "arms")
        arms.mkdir()
        for i, kinematics in enumerate(simulated_arms(files, seed=6)):
            write_factory(kinematics, arms / f"arm{i:06d}.yaml")
        paths = sorted(arms.iterdir())
        loader = min(timed(partial(_loaded, paths))[0] for _ in range(repeats))
        yield Record(work, "PyYAML's C loader", "wall time", loader, "s", "lower")
        fleet(arms, Path(name, "warm.parquet"), 2)
        taken, tables = {}, []
        for processes in (1, 2):
            out = Path(name, f"{processes}.parquet")
            taken[processes] = min(fleet(arms, out, processes) for _ in range(repeats))
            tables.append(out.read_bytes())
        wrong = "" if tables[0] == tables[1] else "two processes write other bytes than one"
        for processes, seconds in taken.items():
            yield Record(work, f"fleet, processes {processes}", "wall time", seconds, "s", "lower", wrong)
        ratio = taken[2] / loader
        yield Record(work, "fleet, processes 2", "of the C loader's time", ratio, "×", "lower")
        yield Record(work, "fleet, processes 2", "faster than one", taken[1] / taken[2], "×", "higher")
        peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**10
        yield Record(work, "fleet", "largest process", peak, "MiB", "lower")


def fleet(arms: Path, out: Path, processes: int) -> float:
    """Wall seconds of the command."""
    seconds, done = timed(partial(subprocess.run, _command(arms, out, processes), cwd=ROOT, capture_output=True))
    if done.returncode:
        raise RuntimeError(done.stderr.decode())
    return seconds


def _command(arms: Path, out: Path, processes: int) -> list[str]:
    given = ["fleet", str(arms), "--out", str(out), "--force", "--processes", str(processes)]
    return [sys.executable, "-m", "lite6jax.cli", *given]


def _loaded(paths: list[Path]) -> None:
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    for path in paths:
        yaml.load(path.read_bytes(), Loader=loader)
