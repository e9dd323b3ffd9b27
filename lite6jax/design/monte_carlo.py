"""The predicted precision tested by Monte Carlo: many refits of simulated readings, batch by batch."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.chains import joint_motion
from lite6jax.arms.moves import Frame
from lite6jax.arms.se3 import rotation_exp, rotation_log_components
from lite6jax.design.determination import Determination, determine
from lite6jax.design.information import Experiment, direction
from lite6jax.design.readings import Numbers, joint_changes, tool_frame
from lite6jax.design.sensor import Sensor, joint_whitener
from lite6jax.distribution.batches import outcomes
from lite6jax.effects.composition import Physics
from lite6jax.errors import InputError
from lite6jax.model import ModelForm

Array = NDArray[np.floating]

_TOGETHER = 200_000
"""Readings drawn at a time: those of 1000 refits of 200 poses. More are drawn as they are needed, so that memory is
bounded."""
BATCH = 250
"""Refits of one call, whatever processes there are: so their bytes do not depend on these."""
STEPS = 12
"""Most steps of a refit. The curvature stays that of the truth, from which noise leads away by 1e-4 of its size or so:
each step leaves that share of the error, four leave rounding."""
_SETTLED = 1e-4
"""Length of the last step, in standard deviations, below which a refit has converged."""


@final
@dataclass(frozen=True, eq=False)
class Refits:
    """Estimates of simulated readings beside their prediction.

    Attributes:
        determination: what was predicted.
        errors: `(refit, size)` estimate minus truth, m and rad; zero where held.
        settled: `(refit,)` bool.
    """

    determination: Determination
    errors: Array
    settled: NDArray[np.bool_]

    @property
    def standard_deviation(self) -> Array:
        """`(size,)` of the converged refits about the truth, m and rad; NaN where none converged."""
        errors = self.errors[self.settled]
        return np.sqrt(np.mean(errors**2, 0)) if len(errors) else np.full(self.errors.shape[1], np.nan)

    @property
    def ratio(self) -> Array:
        """`(rank,)` observed over predicted, of the free parameters; 1 ± 1/√(2 refits) where the model is linear."""
        free = self.determination.free
        return self.standard_deviation[free] / self.determination.standard_deviation[free]


def refit(
    experiment: Experiment,
    joint_position: ArrayLike,
    count: int = 1000,
    seed: int = 0,
    *,
    processes: int | None = None,
    scheduler: str | None = None,
) -> Refits:
    """Simulates `count` sets of readings of the same poses and fits each.

    The truth is the experiment's model; the means of the prior are drawn about it. Noise of the joints' read-outs is
    simulated as such: the fit is given other joint positions than the arm had.

    Args:
        experiment: which model and sensor.
        joint_position: `(sample, joint)` rad.
        count: refits.
        seed: of the noise.
        processes: of this machine that compute, each with one thread; none but this one where not given.
        scheduler: the address of the scheduler of a Dask cluster that computes.

    Raises:
        InputError: joints that the arm does not have; fewer than two refits; or as `outcomes`.
    """
    if count < 2:
        raise InputError(f"{count} refits: a spread needs at least 2")
    q = np.asarray(joint_position, float)
    determination = determine(experiment, q)
    batches = -(-count // BATCH)
    work = outcomes(
        _refitted,
        enumerate(_drawn(experiment, q, determination, count, seed)),
        (experiment, q, determination.free, determination.covariance),
        died=lambda one: _rows(np.full((1, determination.rank), np.nan), np.full(1, np.inf)),
        processes=0 if processes is None and scheduler is None else processes,
        scheduler=scheduler,
        most=batches,
    )
    parts = dict(work)
    found = pa.concat_tables([parts[k] for k in range(batches)])
    errors = np.zeros((count, experiment.size))
    errors[:, determination.free] = np.stack(found["errors"].to_pylist())
    return Refits(determination, errors, found["length"].to_numpy() < _SETTLED)


def _drawn(
    experiment: Experiment, q: Array, determination: Determination, count: int, seed: int
) -> Iterator[list[tuple[Array, Array, Array]]]:
    """For each refit of each batch its noise `(row, sample)`, that of the joints, and the means of the prior."""
    random, sensor = np.random.default_rng(seed), experiment.sensor
    precision = experiment.precision[np.flatnonzero(experiment.movable)[determination.free]]
    spread = 1 / np.sqrt(np.where(precision > 0, precision, np.inf))
    together = min(count, max(_TOGETHER // len(q), 1))
    waiting: list[tuple[Array, Array, Array]] = []
    for first in range(0, count, together):
        drawn = random.standard_normal((together, sensor.rows, len(q))) * sensor.noise[:, None]
        read_out = np.zeros((together, 0, q.shape[1]))
        if sensor.joint_noise:
            read_out = sensor.joint_noise * random.standard_normal((together, *q.shape))
        center = spread * random.standard_normal((together, len(spread)))
        waiting += list(zip(drawn, read_out, center, strict=True))[: count - first]
        while len(waiting) >= BATCH:
            yield waiting[:BATCH]
            waiting = waiting[BATCH:]
    if waiting:
        yield waiting


def _refitted(
    drawn: Sequence[tuple[Array, Array, Array]],
    experiment: Experiment,
    q: Array,
    free: NDArray[np.bool_],
    covariance: Array,
) -> pa.Table:
    """The errors and the length of the last step of each refit."""
    form, sensor = experiment.form, experiment.sensor
    active = np.flatnonzero(experiment.movable)[free]
    noise, read_out, center = (np.stack(part) for part in zip(*drawn, strict=True))
    if not sensor.joint_noise:
        read_out = np.zeros((1, *q.shape))
    steps, lengths = _refit(
        form,
        experiment.physics,
        sensor,
        experiment.numbers,
        q,
        direction(experiment, q),
        np.eye(len(experiment.movable))[active],
        covariance[np.ix_(free, free)],
        experiment.precision[active],
        noise,
        read_out,
        center,
    )
    return _rows(np.asarray(steps), np.asarray(lengths))


def _rows(steps: Array, lengths: Array) -> pa.Table:
    return pa.table({"errors": pa.array(list(steps), pa.list_(pa.float64())), "length": lengths})


@partial(jax.jit, static_argnums=(0, 1, 2))
def _refit(
    form: ModelForm,
    physics: Physics,
    sensor: Sensor,
    numbers: Numbers,
    joint_position: jax.Array,
    direction: jax.Array,
    select: jax.Array,
    covariance: jax.Array,
    precision: jax.Array,
    noise: jax.Array,
    read_out: jax.Array,
    center: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    predict = partial(tool_frame, form, physics, numbers)
    true_tool = predict(joint_position, direction, jnp.zeros(form.size + physics.size))
    whitener = None
    if sensor.joint_noise:
        changes = joint_changes(form, sensor, numbers.model, joint_motion(form.chain, joint_position.T))
        whitener = jnp.moveaxis(joint_whitener(changes, sensor.joint_noise), 0, -1)

    def one(noise: jax.Array, read_out: jax.Array, center: jax.Array) -> tuple[jax.Array, jax.Array]:
        def whitened(step: jax.Array) -> jax.Array:
            tool = predict(joint_position + read_out, direction, step @ select)
            rows = _difference(sensor, tool, true_tool, noise) / jnp.array(sensor.noise)[:, None]
            return rows if whitener is None else jnp.sum(whitener * rows, 1)

        def cost(step: jax.Array) -> jax.Array:
            return 0.5 * jnp.sum(whitened(step) ** 2) + 0.5 * jnp.sum(precision * (step - center) ** 2)

        def advance(_: object, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            step = state[0]
            gradient = jax.grad(cost)(step)
            change = covariance @ gradient
            return step - change, jnp.sqrt(gradient @ change)

        return jax.lax.fori_loop(0, STEPS, advance, (jnp.zeros(len(select)), jnp.inf))

    return jax.vmap(one, in_axes=(0, 0 if sensor.joint_noise else None, 0))(
        noise, read_out if sensor.joint_noise else read_out[0], center
    )


def _difference(sensor: Sensor, tool: Frame, true_tool: Frame, noise: jax.Array) -> jax.Array:
    """Predicted minus simulated readings, `(row, sample)` in m and rad: the residual that the fit has."""
    shift = sensor.read(tool) - sensor.read(true_tool) - noise[:3]
    if sensor.quantity != "pose":
        return shift
    spun = jnp.moveaxis(rotation_exp(noise[3:].T), 0, -1)  # about the sensor's axes
    axes = [jnp.sum(spun * axis, 1) for axis in true_tool[:3]]
    relative = [[jnp.sum(measured * predicted, 0) for predicted in tool[:3]] for measured in axes]
    in_tool = rotation_log_components(relative)
    return jnp.concatenate([shift, axes[0] * in_tool[0] + axes[1] * in_tool[1] + axes[2] * in_tool[2]])
