"""What a diagnosis of poses costs against its rows and its findings, and what rollouts of a log of commands cost:
processor time over a unit of the machine.

The unit is the time of twelve products of 2000 × 400 numbers with themselves and their eigenvalues, on one thread.
"""

import gc
import time
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from benchmarks.measure import OURS, Record, disagreement
from lite6jax import threads
from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.domains.tracking.coupling import JointLoads, loads_along
from lite6jax.domains.tracking.rollout import MOST_LANES, Commands, hold_commands, roll
from lite6jax.effects.servo import Servo
from lite6jax.simulation import simulate, simulate_tracking

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


# ------------------------------------------------------------------ rollouts of a log of commands

_ROLLOUTS_S = 0.3
"""s, that the rollouts may take."""
_FRICTION = 1.0  # Nm, of each joint in the second workload
_SAME = 1e-12  # rad: lanes do not know of each other


def rollouts(rows: int = 2000, variants: int = 32, repeats: int = 5) -> Iterator[Record]:
    """The processor time of rollouts of a Lite 6 with many sets of numbers, each joint alone under its load."""
    threads.limit(1)
    simulated = simulate_tracking("lite6", samples=rows)
    log = simulated.recording
    assert log.time is not None
    assert log.commanded_position is not None
    model = simulated.model.model
    commands = hold_commands(log.commanded_position, log.run, float(np.median(np.diff(log.time))), log.joint_position)
    still = np.zeros_like(log.commanded_position.T)
    loads = loads_along(model.bodies, commands, log.commanded_position.T, still, still)
    ratios = np.repeat(1 + 0.01 * np.arange(variants), log.dof)
    joints = np.tile(np.arange(log.dof), variants)
    for friction in (0.0, _FRICTION):
        servo = model.servo.take(joints)
        servo = servo._replace(stiffness=servo.stiffness * ratios, coulomb=servo.coulomb + friction)
        together = partial(_roll_lanes, servo, commands, joints, loads)
        shown = together()
        taken = []
        for _ in range(repeats):
            begun = time.process_time()
            together()
            taken.append(time.process_time() - begun)
        alone = _roll_lanes(servo.take(slice(log.dof)), commands, joints[: log.dof], loads)
        wrong = disagreement(shown[: log.dof], alone, _SAME, "read-outs")
        work = f"{rows} rows of {log.dof} joints, {variants} variants" + (", friction" if friction else "")
        seconds = float(np.median(taken))
        yield Record(work, OURS, "processor time", seconds, "s", wrong)
        yield Record(work, OURS, f"of the {_ROLLOUTS_S:g} s they may take", seconds / _ROLLOUTS_S, "×", wrong)
        yield Record(work, OURS, "of the unit", seconds / unit_time(), "×")


def _roll_lanes(servo: Servo, commands: Commands, joints: np.ndarray, loads: JointLoads) -> np.ndarray:
    """Read-outs `(lane, sample)` rad, of so many lanes at once as save time."""
    parts = []
    for first in range(0, len(joints), MOST_LANES):
        some = slice(first, first + MOST_LANES)
        part = roll(servo.take(some), commands, joints[some], loads.load, loads.mass, weight=loads.weight)
        parts.append(part.readout)
    return np.concatenate(parts)


# ------------------------------------------------------------------ the unit


def unit_time() -> float:
    """The processor time of the unit, s."""
    numbers = np.random.default_rng(0).normal(size=(2000, 400))
    begun = time.process_time()
    for _ in range(12):
        np.linalg.eigvalsh(numbers.T @ numbers)
    return time.process_time() - begun
