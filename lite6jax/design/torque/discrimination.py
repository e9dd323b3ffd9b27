"""Which motion to make to discriminate between two rival explanations of an arm's torques."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.design.criteria import coordinates_of, discrimination
from lite6jax.design.torque.ascent import Columns
from lite6jax.design.torque.columns import TorqueModel
from lite6jax.design.torque.fourier import Motion
from lite6jax.design.torque.planning import (
    RANDOM_DRAWS,
    STARTS,
    STEPS,
    MotionRoom,
    Trajectory,
    best_ascent,
    random_motions,
)
from lite6jax.distribution.batches import Workers
from lite6jax.effects.dynamic.torque_effect import TorqueEffect
from lite6jax.errors import InputError

Array = NDArray[np.floating]

_SAME = 1e-4
"""Sine between two columns below which one is the other: the rival's own, which is then not unknown beside it."""


@final
@dataclass(frozen=True, eq=False)
class Rival:
    """One of two explanations.

    Attributes:
        name: for the report.
        columns: torques in Nm per unit of each of its numbers, of a motion: `(joint, column, sample)`.
        values: `(column,)` its hypothesised numbers; all zero where only the other is tested against it.
    """

    name: str
    columns: Columns
    values: Array


@final
@dataclass(frozen=True, eq=False)
class TorqueDiscrimination:
    """A motion that discriminates between two rivals.

    Attributes:
        model: what is unknown beside them, and the noise.
        room: where the motion may be.
        trajectory: the designed one.
        rivals: their names.
        both_ways: whether each is tested against the other, or only the second against the first.
        distance: how many standard deviations the torques of one model are from the closest that the other, with
            everything else that is unknown, explains.
        random_distance: `(draw,)`, of random motions of the same limits; 0 where they determine too little.
        steps: of the ascents that led to a better motion.
    """

    model: TorqueModel
    room: MotionRoom
    trajectory: Trajectory
    rivals: tuple[str, str]
    both_ways: bool
    distance: float
    random_distance: Array
    steps: int


def rival_of(effect: TorqueEffect, values: ArrayLike, model: TorqueModel) -> Rival:
    """An effect on torques as a rival, by its linear coordinates; the others stay at the values given.

    Raises:
        InputError: as `effect_columns`.
    """
    from lite6jax.design.torque.effect_columns import effect_columns

    columns, linear = effect_columns(effect, values, model)
    return Rival(effect.label, columns, np.asarray(values, float)[linear])


def plan_torque_discrimination(
    model: TorqueModel,
    room: MotionRoom,
    rivals: Sequence[Rival],
    *,
    seed: int = 0,
    draws: int = RANDOM_DRAWS,
    starts: int = STARTS,
    steps: int = STEPS,
    processes: int | None = None,
    scheduler: str | None = None,
) -> TorqueDiscrimination:
    """The motion in which two rivals differ most after everything else that is unknown is refitted.

    The criterion is T-optimality (A. Atkinson, V. Fedorov, Biometrika 62, 1975). Columns of `model` that are a rival's
    own are not unknown beside it.

    Args:
        model: what is unknown beside the two, and the noise.
        room: limits, obstacles, duration.
        rivals: two; the first with values that are not all zero.
        seed, draws, starts, steps, processes, scheduler: as in `plan_motion`.

    Raises:
        InputError: the first has no size, the rivals are the same, or as `random_motions`.
    """
    one, other = rivals
    if not one.values.any():
        raise InputError(f"{one.name}: has no size; give a value of its parameters")
    drawn = random_motions(room, seed, draws)
    checks = room.excitation(lambda motion: np.zeros((1, 1, 1)), discrimination(2, [0], [1], [1.0]))
    sample = Motion(*np.concatenate([checks.motion(free, 20 * room.harmonics) for free in drawn[:4]], 2))
    own = np.concatenate([_whitened(model, rival, sample) for rival in rivals], 1)
    common = _not_among(model.columns(sample), own)
    scale = model.scale[common]
    size = len(common) + own.shape[1]
    sizes = np.append(scale, np.where(_lengths(own) > 0, 1 / np.maximum(_lengths(own), 1e-300), 1.0))
    columns = partial(_columns, model, common, tuple(rivals), sizes)
    at = np.arange(len(common), size)
    first, second = at[: len(one.values)], at[len(one.values) :]
    by = discrimination(
        size,
        first,
        second,
        one.values / sizes[first],
        other.values / sizes[second] if other.values.any() else None,
    )
    rows = columns(sample)
    coordinates = coordinates_of(np.einsum("jcs,jds->cd", rows, rows), sample.q.shape[1])
    try:
        inside = by.within(coordinates)
    except InputError as error:
        unknown = "the links' parameters (give --inertial declared)" if model.inertial else "friction"
        raise InputError(
            f"{one.name} and {other.name}: no motion separates them; what one adds to torques the other explains with"
            f" {unknown}"
        ) from error
    excitation = room.excitation(columns, inside, coordinates.outward)
    with Workers(scheduler, 0 if processes is None else processes, max(draws, 1)) as workers:
        best, improved, squares = best_ascent(workers, excitation, drawn, starts, steps)
    return TorqueDiscrimination(
        model=model,
        room=room,
        trajectory=room.trajectory(room.series(best.free)),
        rivals=(one.name, other.name),
        both_ways=bool(other.values.any()),
        distance=float(np.sqrt(best.value)),
        random_distance=np.sqrt(np.maximum(squares, 0.0)),
        steps=improved,
    )


def _columns(
    model: TorqueModel, common: NDArray[np.integer], rivals: Sequence[Rival], sizes: Array, motion: Motion
) -> Array:
    parts = [model.columns(motion, common), *(_whitened(model, rival, motion) for rival in rivals)]
    return np.concatenate(parts, 1) * sizes[:, None]


def _whitened(model: TorqueModel, rival: Rival, motion: Motion) -> Array:
    return np.asarray(rival.columns(motion)) / model.noise[:, None, None]


def _lengths(columns: Array) -> Array:
    return np.sqrt(np.einsum("jcs,jcs->c", columns, columns) / columns.shape[2])


def _not_among(columns: Array, own: Array) -> NDArray[np.integer]:
    """Which of some columns are not, but for a factor, among others."""
    lengths, others = _lengths(columns), _lengths(own)
    product = np.abs(np.einsum("jcs,jds->cd", columns, own)) / columns.shape[2]
    cosine = product / np.maximum(np.outer(lengths, others), 1e-300)
    return np.flatnonzero((cosine < 1 - _SAME**2 / 2).all(1) & (lengths > 0))
