"""The whole command on one calibration file, as the shell sees it, against the seed's way as a script."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks import seed_way
from benchmarks.measure import ROOT, Record, disagreement, timed
from benchmarks.problem import chain_error, simulated_arms
from lite6jax.arms.factory import write_factory

EXACT = 1e-13
"""m, and of a rotation's entries: the 1e-10 mm to which a fit reproduces a calibration."""


def command(repeats: int = 3) -> Iterator[Record]:
    """Median wall seconds of each process: start, imports, fit, table, check on 1000 fresh samples."""
    kinematics = simulated_arms(1, seed=4)[0]
    with tempfile.TemporaryDirectory() as folder:
        calibration = write_factory(kinematics, Path(folder, "lite6_calibration.yaml"))
        ours = [sys.executable, "-m", "lite6jax.cli", "fit", str(calibration)]
        seed = [sys.executable, seed_way.__file__, str(calibration)]
        caches = [Path(folder, f"cache{i}") for i in range(repeats)]

        check = partial(wrong_table, kinematics=kinematics)
        base, wrong = processes(seed, caches, check)
        yield Record("command", "seed's way", "wall time", base, "s", "lower", wrong)
        for cache, used in (("cold", caches), ("warm", caches[:1] * repeats)):
            seconds, wrong = processes(ours, used, check)
            subject = f"lite6jax fit, {cache} cache"
            share = None if seconds is None or base is None else seconds / base
            yield Record("command", subject, "wall time", seconds, "s", "lower", wrong)
            yield Record("command", subject, "of the seed's way", share, "×", "lower", wrong)


def processes(arguments: list[str], caches: list[Path], check: Callable[[Path], str]) -> tuple[float | None, str]:
    """Median seconds of a process a cache folder, and why its answer is wrong.

    Args:
        arguments: to which `--out FILE` is added.
        caches: where the compiled code of each is kept.
        check: of the file that it wrote; empty where the answer is right.
    """
    seconds, wrong = [], ""
    for cache in caches:
        cache.mkdir(exist_ok=True)
        out = cache / f"{len(list(cache.iterdir()))}.json"
        # the user's cache folder, below which the compiled code is kept
        environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
        call = partial(subprocess.run, [*arguments, "--out", str(out)], cwd=ROOT, env=environment)
        taken, run = timed(partial(call, capture_output=True, text=True))
        if run.returncode:
            return None, (run.stderr.strip().splitlines() or [f"exit code {run.returncode}"])[-1]
        seconds.append(taken)
        wrong = wrong or check(out)
    return median(seconds), wrong


def wrong_table(path: Path, kinematics: np.ndarray) -> str:
    """Why a JSON table of the seed's form is not the chain `(6, 6)`; empty where it is."""
    table = json.loads(path.read_text())
    base = [table["base"][key] for key in ("x", "y", "roll", "pitch")] * np.array(
        [1e-3, 1e-3, np.pi / 180, np.pi / 180]
    )
    rows = [[row[key] for key in ("theta_off", "d", "a", "alpha")] for row in table["dh"]]
    dh = np.array(rows) * [np.pi / 180, 1e-3, 1e-3, np.pi / 180]
    beta = np.deg2rad(table["beta_joint2"])
    parameters = np.concatenate([base, np.delete(dh.ravel(), seed_way.D2), [beta]])
    fresh = seed_way.sample_joints(1000, np.random.default_rng(5))
    error = chain_error(kinematics[None], parameters[None], fresh)
    return disagreement(np.array(error), np.array(0.0), EXACT, "flange poses")
