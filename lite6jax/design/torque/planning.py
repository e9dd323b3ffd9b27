"""Which motion to make: the exciting trajectory whose torques determine most, and how random ones compare."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.design.candidates import Filter, candidates
from lite6jax.design.criteria import Criterion, Determinant
from lite6jax.design.torque.ascent import Columns, Excitation
from lite6jax.design.torque.columns import TorqueModel
from lite6jax.design.torque.evaluation import Ascended, ascents, identifications, values_of
from lite6jax.design.torque.fourier import Free, Motion, MotionLimits, Series, within
from lite6jax.design.torque.identify import TorqueIdentification, identify_torques, structure_of
from lite6jax.distribution.batches import Workers
from lite6jax.errors import InputError

Array = NDArray[np.floating]

DURATION, HARMONICS, RATE = 10.0, 5, 100.0
"""s of a period, harmonics of the series, samples a second."""
RANDOM_DRAWS = 50
"""Random motions that a design is compared with."""
STARTS, STEPS = 2, 150
"""Ascents from the best random motions, and the steps of each."""
_FULL = 7.0
"""Of `Free.size`: 99.9 % of the greatest amplitude."""
_SMALLEST = 2.0**-6
"""Of the greatest amplitude: a motion that is refused at this size starts where there is no room."""
_FEWEST = 20
"""Random motions of which one has to pass."""


@final
@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion to execute, sample by sample, from rest to rest.

    Attributes:
        series: its Fourier series.
        time: `(sample,)` s, from 0 to one period.
        motion: `(joint, sample)` each; NumPy.
    """

    series: Series
    time: Array
    motion: Motion


@final
@dataclass(frozen=True, eq=False)
class MotionRoom:
    """Where and how fast a motion may be.

    Attributes:
        arm: that moves.
        limits: of each joint.
        filters: that every position passes.
        duration: of one period, s.
        harmonics: of the series.
        rate: samples a second that are recorded.

    Raises:
        InputError: a duration or rate that is not positive, fewer than two harmonics, or so few samples that the
            highest harmonic is not sampled ten times.
    """

    arm: Arm
    limits: MotionLimits
    filters: Sequence[Filter] = ()
    duration: float = DURATION
    harmonics: int = HARMONICS
    rate: float = RATE

    def __post_init__(self) -> None:
        for name, value, unit in (("duration", self.duration, "s"), ("rate", self.rate, "samples a second")):
            if not 0 < value < np.inf:
                raise InputError(f"{name} {value:g}: give a number of {unit}, above 0")
        if self.harmonics < 2:
            raise InputError(f"harmonics {self.harmonics}: a motion from rest to rest takes 2 or more")
        if self.samples < 10 * self.harmonics:
            raise InputError(
                f"a motion of {self.duration:g} s at {self.rate:g} samples a second is too short for"
                f" {self.harmonics} harmonics: give a longer one, of {10 * self.harmonics} samples or more"
            )

    @property
    def samples(self) -> int:
        """Of one period."""
        return round(self.duration * self.rate)

    def trajectory(self, series: Series) -> Trajectory:
        """The recorded samples of one period, both ends among them."""
        time = np.arange(self.samples + 1) * self.duration / self.samples
        return Trajectory(series, time, Motion(*(np.asarray(part) for part in series.at(time))))

    def series(self, free: Free) -> Series:
        """The series of free numbers that keeps the limits."""
        room = self.limits
        return within(free, *room.position.T, room.velocity, room.acceleration, self.duration, self.harmonics)

    def excitation(self, columns: Columns, criterion: Criterion, outward: Array | None = None) -> Excitation:
        """How motions in this room are judged: by a criterion in the coordinates that `outward` leads out of."""
        return Excitation(
            *(columns, criterion, outward, self.limits, self.filters, self.duration, self.harmonics, self.samples)
        )


@final
@dataclass(frozen=True, eq=False)
class TorquePlan:
    """A motion whose torques determine an arm's parameters, and what random motions of the same limits determine.

    Attributes:
        room: where it may be.
        trajectory: the designed one.
        identification: what it determines.
        random: what each of the random motions determines.
        steps: of the ascents that led to a better motion.
    """

    room: MotionRoom
    trajectory: Trajectory
    identification: TorqueIdentification
    random: tuple[TorqueIdentification, ...]
    steps: int

    @property
    def random_log_determinant(self) -> Array:
        """`(draw,)`, of the random motions."""
        return np.array([found.log_determinant for found in self.random])

    @property
    def random_condition(self) -> Array:
        """`(draw,)`, of the random motions."""
        return np.array([found.condition for found in self.random])

    @property
    def random_deviation(self) -> Array:
        """`(base,)` SI: the median standard deviation of each base parameter over the random motions."""
        return np.median([found.standard_deviation for found in self.random], axis=0)

    def gain(self, log_determinant: float) -> float:
        """How many times smaller standard deviations are than of that determinant, in the geometric mean."""
        count = len(self.identification.structure.base)
        return float(np.exp((self.identification.log_determinant - log_determinant) / (2 * count)))


def plan_motion(
    model: TorqueModel,
    room: MotionRoom,
    *,
    seed: int = 0,
    draws: int = RANDOM_DRAWS,
    starts: int = STARTS,
    steps: int = STEPS,
    processes: int | None = None,
    scheduler: str | None = None,
) -> TorquePlan:
    """The motion with the largest information determinant about base parameters and friction that the room allows.

    J. Swevers et al. (1997) minimise the determinant of the covariance likewise; here by gradient, from the best of
    random motions.

    Args:
        model: the unknowns and the noise.
        room: limits, obstacles, duration.
        seed: of the random motions.
        draws: random motions.
        starts: ascents.
        steps: of each.
        processes: of this machine that compute, each with one thread; none but this one where not given.
        scheduler: the address of the scheduler of a Dask cluster that computes.

    Raises:
        InputError: no room for a motion; or as `Workers`.
    """
    structure = structure_of(model)
    scale = np.array([item.scale for item in structure.base])
    first = room.excitation(partial(model.columns, chosen=structure.free, scale=scale), Determinant())
    drawn = random_motions(room, seed, draws)
    with Workers(scheduler, 0 if processes is None else processes, max(draws, 1)) as workers:
        best, improved, _ = best_ascent(workers, first, drawn, starts, steps)
        random = identifications(workers, structure, room, drawn)
    trajectory = room.trajectory(room.series(best.free))
    return TorquePlan(
        room=room,
        trajectory=trajectory,
        identification=identify_torques(model, trajectory.motion, structure=structure),
        random=tuple(random),
        steps=improved,
    )


def best_ascent(
    workers: Workers, excitation: Excitation, drawn: Sequence[Free], starts: int = STARTS, steps: int = STEPS
) -> tuple[Ascended, int, Array]:
    """The best end of ascents from the best of some motions, the steps of all that improved, and the values of these
    motions."""
    values = values_of(workers, excitation, drawn)
    best = np.argsort(-values, kind="stable")[: max(starts, 1)]
    ends = ascents(workers, excitation, [drawn[i] for i in best], steps)
    return max(ends, key=lambda end: end.value), sum(end.improved for end in ends), values


def random_motions(room: MotionRoom, seed: int = 0, count: int = RANDOM_DRAWS) -> list[Free]:
    """Motions of random direction about random positions that pass every filter, each as large as the limits allow,
    halved until the whole of it passes.

    Raises:
        InputError: as `candidates`; or fewer than one in `_FEWEST` passes at any size.
    """
    rng = np.random.default_rng(seed)
    dof = room.arm.dof
    middles = candidates(room.arm, _FEWEST * (count + 1), seed, room.filters).joint_position
    checks = room.excitation(lambda motion: np.zeros((dof, 1, motion.q.shape[1])), Determinant())
    passed: list[Free] = []
    for tried, middle in enumerate(middles):
        if len(passed) == count:
            break
        if tried >= _FEWEST * (len(passed) + 1):
            names = ", ".join(condition.name for condition in room.filters)
            raise InputError(f"motions: {len(passed)} of {tried} random ones pass {names} at any amplitude; widen them")
        shape = rng.standard_normal((dof, 2 * room.harmonics - 2))
        share = 1.0
        while share >= _SMALLEST:
            size = _FULL if share == 1 else float(np.log(share / (1 - share)))
            free = checks.about(middle, Free(shape, np.zeros(dof), np.full(dof, size)))
            if checks.passes(free):
                passed.append(free)
                break
            share /= 2
    return passed
