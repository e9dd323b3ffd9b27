"""What a diagnosis of poses costs against its rows and its findings: processor time over a unit of the machine.

The unit is the time of twelve products of 2000 × 400 numbers with themselves and their eigenvalues, on one thread.
"""

import gc
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.measure import OURS, Record
from lite6jax import threads
from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.simulation import simulate

_PLACES = ((1, 2), (4, 2), (2, 3), (3, 1), (5, 2), (6, 1), (1, 5), (2, 11), (3, 7), (4, 9), (5, 4), (6, 3))
"""Joints and orders of waves."""
_WAVES = tuple(
    f"joint_harmonic:joint={joint},order={order},amplitude_rad={3e-4 / joint:.3g},phase_rad={0.4 * order:.3g}"
    for joint, order in _PLACES
)
HIDDEN = (
    "joint_compliance:joint=2,compliance_rad_per_Nm=5e-5",
    *_WAVES[:2],
    "joint_compliance:joint=3,compliance_rad_per_Nm=6e-5",
    *_WAVES[2:],
    "joint_compliance:joint=5,compliance_rad_per_Nm=3e-4",
)
"""Effects of several times their threshold, in the order in which they are hidden."""


class Case(NamedTuple):
    """A recording: how many rows, and how many effects are hidden."""

    rows: int
    effects: int


CASES = (Case(400, 0), Case(400, 1), Case(1600, 1), Case(6400, 1), Case(1600, 4), Case(1600, 16))


def scaling(cases: tuple[Case, ...] = CASES, repeats: int = 2) -> Iterator[Record]:
    """The processor time of a call in this process that has diagnosed such a recording before."""
    threads.limit(1)
    for case in cases:
        recording = simulate("lite6", effects=HIDDEN[: case.effects], samples=case.rows, seed=5, tool_known=False)
        for _ in range(repeats - 1):
            diagnose_poses(recording)
        begun = time.process_time()
        diagnosis = diagnose_poses(recording)
        taken = time.process_time() - begun
        named = {finding.effect.label for finding in diagnosis.findings if not finding.effect.nonparametric}
        work = f"{case.rows} rows, {case.effects} effects"
        wrong = (
            "" if len(diagnosis.findings) >= case.effects else f"{len(diagnosis.findings)} findings: {sorted(named)}"
        )
        yield Record(work, OURS, "processor time", taken, "s", wrong)
        yield Record(work, OURS, "of the unit", taken / unit_time(), "×")
        yield Record(work, OURS, "findings", float(len(diagnosis.findings)), "")
        del diagnosis
        gc.collect()


def unit_time() -> float:
    """The processor time of the unit, s."""
    numbers = np.random.default_rng(0).normal(size=(2000, 400))
    begun = time.process_time()
    for _ in range(12):
        np.linalg.eigvalsh(numbers.T @ numbers)
    return time.process_time() - begun
