"""Fleets fitted beside Ceres Solver in C++ with automatic differentiation, on the same threads.

It takes a C++ compiler and Ceres (Debian's `libceres-dev`); both are compiled with what this machine's processor has.
Ratios are of processor time, which other work on the machine changes less than wall time.
"""

import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fits import convert, fit, wrong_fit
from benchmarks.measure import AGREES, Record, disagreement
from benchmarks.problem import SCALE, measured
from benchmarks.seed_way import NOMINAL
from lite6jax.errors import InputError

SOURCE = Path(__file__).with_suffix(".cpp")
HEADERS = Path("/usr/include/ceres/ceres.h")
OURS, CERES = "lite6jax", "Ceres in C++"


def ceres(arms: int = 64, samples: int = 300, threads: int = 2, repeats: int = 7) -> Iterator[Record]:
    """Milliseconds of processor time and of wall time an arm, and their ratios; runs alternate."""
    if shutil.which("g++") is None or not HEADERS.exists():
        raise InputError("no C++ compiler or no Ceres here; apt-get install g++ libceres-dev")
    problem = measured(arms, samples, seed=2)
    work = f"fleet of {arms} × {samples}, {threads} threads"
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        program = compiled(folder)
        poses = np.concatenate([problem.pose[..., :3, :3].reshape(arms, samples, 9), problem.pose[..., :3, 3]], -1)
        data = np.concatenate([problem.joint_position.reshape(arms, -1), poses.reshape(arms, -1)], 1)
        np.concatenate([[arms, samples, threads, 1], SCALE, NOMINAL, data.ravel()]).tofile(folder / "in")
        solution, ours, theirs = fit(problem), [], []
        found = np.zeros(0)
        for _ in range(repeats):
            subprocess.run([program, folder / "in", folder / "out"], check=True)
            found = np.fromfile(folder / "out")
            theirs.append(found[:2])
            ours.append(_taken(lambda: fit(problem)))
    answers = found[2:].reshape(arms, -1)
    wrong = wrong_fit(solution, convert(problem))
    theirs_wrong = disagreement(answers[:, :-1], solution.parameters, AGREES, "parameters (m, rad)")
    yield Record(work, OURS, "steps an arm", float(solution.steps.mean()), "", "lower", wrong)
    yield Record(work, CERES, "steps an arm", float(answers[:, -1].mean()), "", "lower", theirs_wrong)
    for k, kind in enumerate(("wall time", "processor time")):
        best = [min(run[k] for run in runs) for runs in (ours, theirs)]
        for subject, seconds, said in zip((OURS, CERES), best, (wrong, theirs_wrong), strict=True):
            yield Record(work, subject, f"{kind} an arm", 1e3 * seconds / arms, "ms", "lower", said)
        yield Record(work, OURS, f"faster in {kind}", best[1] / best[0], "×", "higher", wrong or theirs_wrong)


def compiled(folder: Path) -> Path:
    """The rival's program."""
    program = folder / "ceres"
    flags = ["-O3", "-march=native", "-DNDEBUG", "-std=c++17", "-I/usr/include/eigen3"]
    subprocess.run(["g++", *flags, SOURCE, "-o", program, "-lceres", "-lglog", "-lpthread"], check=True)
    return program


def _taken(run: Callable[[], Any]) -> tuple[float, float]:
    wall, processor = time.perf_counter(), time.process_time()
    run()
    return time.perf_counter() - wall, time.process_time() - processor
