"""One answer to "what do these poses determine, and how well": of an arm with poses to come, or of a recording.

The predicted precision can be tested by Monte Carlo, with many fits of simulated readings.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.se3 import Frame, rotation_exp, rotation_log_components
from lite6jax.design.determination import Determination, Observability, determination_of, narrow_joints, observability
from lite6jax.design.information import Experiment, Numbers, Reader, check_joints, recording_experiment
from lite6jax.design.sensor import Quantity, Sensor
from lite6jax.distribution.batches import Workers
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError, require_type
from lite6jax.fitting.fit import fit_recording
from lite6jax.fitting.problem import Geometry
from lite6jax.fitting.source import load_nominal, load_recording, with_arm
from lite6jax.fitting.start import sample_within_limits
from lite6jax.model import ModelForm
from lite6jax.recordings import Recording
from lite6jax.results import PublicResult

Array = NDArray[np.floating]

WORKSPACE = 1000
"""Joint positions inside the limits over which accuracy is averaged, and at which an arm shows all it can."""
BATCH = 250
"""Refits of one call, whatever processes there are: so their bytes do not depend on these."""
_UNDETERMINED = 1e-6
"""Share of the readings' change that may lie in directions nothing determines; rounding leaves 1e-12."""
_ON_AXIS = 1e-6
"""m."""
_TOGETHER = 200_000
"""Readings drawn at a time: those of 1000 refits of 200 poses. More are drawn as they are needed, so that memory is
bounded."""
_STEPS = 12
"""Most steps of a refit. The curvature stays that of the truth, from which noise leads away by 1e-4 of its size or so:
each step leaves that share of the error, four leave rounding."""
_SETTLED = 1e-4
"""Length of the last step, in standard deviations, below which a refit has converged."""


def determine(experiment: Experiment, joint_position: ArrayLike) -> Determination:
    """What readings at `joint_position` `(sample, joint)` rad determine.

    Sensor frame, tool and places come first, effects last: what is held is then named after the geometry, or is an
    effect.

    Raises:
        InputError: joints that the arm does not have.
    """
    e = experiment
    geometry, rigid = (int(e.movable[:size].sum()) for size in (e.form.chain.size, e.form.size + len(e.own)))
    whole = e.movable.all() and not e.physics.effects
    return determination_of(
        e.root(joint_position),
        e.names,
        e.units,
        e.unit,
        samples=len(np.asarray(joint_position)),
        order=[*range(geometry, rigid), *range(geometry), *range(rigid, e.size)],
        prior=np.diagonal(e.prior),
        theory=count(e.form, e.sensor.quantity, on_last_axis(e)) if whole and isinstance(e.sensor, Sensor) else None,
    )


def count(form: ModelForm, quantity: Quantity, on_last_axis: bool = False) -> int | None:
    """How many parameters the best poses determine of a generic arm, by counting.

    By the product of exponentials a chain is its joints' axes, 4 numbers each, and the flange's pose, 6 (R. Brockett,
    1984; B. Mooring, Z. Roth, M. Driels, Fundamentals of Manipulator Calibration, 1991): 4 n + 6, all observable in
    full poses. A chain without a free tool has a flange that its last axis carries in a set way: 4 n + 4 of Hayati's,
    4 n + 2 of six parameters. A prismatic joint has a direction only, 2 numbers less; where it is the last, six
    parameters determine the whole flange: 4 n + 4. Positions depend on the flange's pose through the point (3) only,
    and one axis or one distance leaves three motions of the whole arm unobservable.

    Args:
        form: the parameters.
        quantity: what is read.
        on_last_axis: whether the point read lies on the last joint's axis, which then does not move it. Six
            parameters then have three observable numbers less; Hayati's form, whose last a moves the point off the
            axis, is counted as off it.

    Returns:
        None where an arm of one joint, or of prismatic joints and less than three others, moves too little for the
        count to hold.
    """
    n, sliding = form.chain.dof, form.chain.sliding
    hayati, last_slides = isinstance(form.chain, HayatiForm), n - 1 in sliding
    axes = 4 * n - 2 * len(sliding)
    if quantity == "pose":
        return axes + (6 if form.tool else 4 if hayati or last_slides else 2)
    if (n == 1 and quantity != "position") or (sliding and (n - len(sliding) < 3 or last_slides)):
        return None
    observable = axes + 3 if form.tool or hayati else axes - 1 if on_last_axis else axes + 2
    return observable if quantity == "position" else observable - 3


def on_last_axis(experiment: Experiment) -> bool:
    """Whether the measured point lies on the last joint's axis, so that this joint does not move it."""
    return bool(np.hypot(*np.asarray(experiment.model.T_flange_tool)[:2, 3]) < _ON_AXIS)


class Accuracy(NamedTuple):
    """One standard deviation of the pose that the fitted model predicts, root mean square over joint positions.

    Attributes:
        position_rms: m, 3-D.
        orientation_rms: rad.
        position_determined: whether all that positions depend on is determined; else their error is unbounded.
        orientation_determined: likewise.
    """

    position_rms: float
    orientation_rms: float
    position_determined: bool
    orientation_determined: bool


def predict_accuracy(experiment: Experiment, determination: Determination, joint_position: ArrayLike) -> Accuracy:
    """How well a model fitted to what `determination` has determined predicts the tool at `(sample, joint)` rad."""
    J = experiment.error_rows(joint_position)
    variance = np.sum((J / experiment.unit @ determination.covariance) * (J / experiment.unit), 2)
    lost = J @ determination.open_directions
    position, orientation = slice(3), slice(3, 6)

    def rms(part: slice) -> float:
        return float(np.sqrt(np.mean(variance[:, part].sum(1))))

    def determined(part: slice) -> bool:
        return bool(np.linalg.norm(lost[:, part]) <= _UNDETERMINED * np.linalg.norm(J[:, part]))

    return Accuracy(rms(position), rms(orientation), determined(position), determined(orientation))


class Refits(NamedTuple):
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


@final
@dataclass(frozen=True, eq=False, repr=False)
class Identification(PublicResult):
    """What some poses determine.

    Attributes:
        experiment: the model and the sensor.
        joint_position: `(sample, joint)` rad, the poses.
        determination: by these poses.
        possible: by many poses anywhere inside the arm's limits.
        observability: the indices, or None where nothing is determined.
        accuracy: over the arm's whole workspace.
        refits: fits of simulated readings; None where none were requested.
        notes: what was assumed of a recording, a sentence each.
    """

    experiment: Experiment
    joint_position: Array
    determination: Determination
    possible: Determination
    observability: Observability | None
    accuracy: Accuracy
    refits: Refits | None
    notes: tuple[str, ...] = ()

    @property
    def missed(self) -> int:
        """How many combinations other poses of the arm would determine that these do not."""
        return max(self.possible.rank - self.determination.rank, 0)

    def narrow(self) -> list[tuple[int, float]]:
        """Joints, counted from 0, that hardly move in these poses, and their range in rad, m of prismatic joints."""
        return narrow_joints(np.ptp(self.joint_position, 0), self.experiment.arm.slides)

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain numbers and words, in SI units, for a JSON file.

        `parameters` are the unknown ones in the order of `correlation`; what is held has no standard deviation.
        """
        d, accuracy, refits = self.determination, self.accuracy, self.refits
        parameters = zip(d.names, d.units, d.standard_deviation, d.free, d.scale, strict=True)
        return {
            "schema": "lite6jax/identification/1",
            "arm": self.experiment.arm.name,
            "samples": d.samples,
            "sensor": self.experiment.sensor.to_dict(),
            "rank": d.rank,
            "rank_possible": self.possible.rank,
            "rank_by_theory": d.theory,
            "parameters": [
                {"name": name, "unit": unit, "std": float(deviation) if free else None, "tolerance": float(tolerance)}
                for name, unit, deviation, free, tolerance in parameters
            ],
            "singular_values": d.singular_values.tolist(),
            "dependencies": [
                {
                    "held": item.name,
                    "undone_by": {name: share for name, _, share in item.partners},
                    "statement": item.statement,
                }
                for item in d.dependencies
            ],
            "base_parameters": [item.statement for item in d.base if len(item.terms) > 1],
            "weak": list(d.weak()),
            "correlation": d.correlation.tolist(),
            "observability": None if self.observability is None else asdict(self.observability),
            "predicted_accuracy": {
                "position_rms_m": accuracy.position_rms if accuracy.position_determined else None,
                "orientation_rms_rad": accuracy.orientation_rms if accuracy.orientation_determined else None,
            },
            "refits": None
            if refits is None
            else {
                "count": len(refits.errors),
                "settled": int(refits.settled.sum()),
                "std_over_predicted": [float(value) if np.isfinite(value) else None for value in refits.ratio],
            },
            "notes": list(self.notes),
        }


def identify(
    experiment: Experiment,
    joint_position: ArrayLike | None = None,
    *,
    poses: int = 100,
    refits: int = 0,
    seed: int = 0,
    processes: int | None = None,
    scheduler: str | None = None,
) -> Identification:
    """What poses determine of an experiment's parameters, and how well.

    Args:
        experiment: from `plan_experiment` or `recording_experiment`.
        joint_position: `(sample, joint)` rad; drawn inside the arm's limits where not given.
        poses: how many to draw.
        refits: of simulated readings, to test the prediction; 0 is none.
        seed: of the random numbers.
        processes, scheduler: that refit, as `refit` takes them.

    Raises:
        InputError: joints that the arm does not have, degrees for radians, or numbers that are not real or not finite.
    """
    require_type("experiment", experiment, Experiment, "an Experiment, as lite6jax.plan_experiment makes it")
    arm = experiment.arm
    q = sample_within_limits(arm, poses, seed) if joint_position is None else check_joints(experiment, joint_position)
    determination = determine(experiment, q)
    workspace = sample_within_limits(arm, WORKSPACE, seed + 1)
    rank = determination.rank
    return Identification(
        experiment=experiment,
        joint_position=q,
        determination=determination,
        possible=determine(experiment, workspace),
        observability=observability(determination.singular_values[:rank], len(q)) if rank else None,
        accuracy=predict_accuracy(experiment, determination, workspace),
        refits=refit(experiment, q, refits, seed, processes=processes, scheduler=scheduler) if refits else None,
    )


def identify_recording(
    recording: Recording | str | Path,
    arm: Arm | str | Path | None = None,
    *,
    geometry: Geometry = "declared",
    effects: Sequence[Effect] = (),
    refits: int = 0,
    seed: int = 0,
    processes: int | None = None,
    scheduler: str | None = None,
) -> Identification:
    """As `identify`, of the poses, the sensor and the unknowns of a recording or its file, and of effects if given.

    Where the sidecar does not declare the noise of all that is measured, it is taken from the residuals of a fit.

    Raises:
        InputError: as `recording_experiment`.
    """
    arm = load_nominal(arm)
    recording = load_recording(recording, arm)
    recording = recording if arm is not None else with_arm(recording)
    experiment = recording_experiment(recording, arm, geometry)
    notes = list(recording.notes)
    settings, sensor = recording.settings, experiment.sensor
    assert isinstance(sensor, Sensor)
    if settings.position_noise_m is None or (sensor.rows == 6 and settings.orientation_noise_rad is None):
        noise = fit_recording(recording, arm, geometry=geometry).noise
        assert noise is not None
        experiment = experiment.with_sensor(sensor.with_noise(noise.position, noise.orientation))
        notes.append("the sidecar does not declare the noise of all that is measured: it is that of a fit's residuals")
    if effects:
        experiment = experiment.with_physics(effects)
    found = identify(
        experiment, recording.joint_position, refits=refits, seed=seed, processes=processes, scheduler=scheduler
    )
    return replace(found, notes=tuple(notes))


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
        InputError: joints that the arm does not have; fewer than two refits; or as `Workers.outcomes`.
    """
    if count < 2:
        raise InputError(f"{count} refits: a spread needs at least 2")
    q = np.asarray(joint_position, float)
    determination = determine(experiment, q)
    free = determination.free
    draws = islice(_draws(experiment, q, free, count, seed), count)
    batches = -(-count // BATCH)
    with Workers(scheduler, processes or 0, batches) as workers:
        work = workers.outcomes(
            _fit_draws,
            ((k, list(islice(draws, BATCH))) for k in range(batches)),
            (experiment, q, free, determination.covariance),
            died=lambda one: _rows(np.full((1, determination.rank), np.nan), np.full(1, np.inf)),
        )
        parts = dict(work)
    found = pa.concat_tables([parts[k] for k in range(batches)])
    errors = np.zeros((count, experiment.size))
    errors[:, free] = np.stack(found["errors"].to_pylist())
    return Refits(determination, errors, found["length"].to_numpy() < _SETTLED)


Draw = tuple[Array, Array, Array]
"""Of a refit: the noise of its readings `(row, sample)`, that of the joints' read-outs `(sample, joint)`, or nothing,
and the means of the prior `(free,)`."""


def _draws(experiment: Experiment, q: Array, free: NDArray[np.bool_], count: int, seed: int) -> Iterator[Draw]:
    """What is random in each refit, without end; of `count` refits no more are drawn at a time than memory holds."""
    random, sensor = np.random.default_rng(seed), experiment.sensor
    assert isinstance(sensor, Sensor)
    precision = experiment.precision[np.flatnonzero(experiment.movable)[free]]
    prior = 1 / np.sqrt(np.where(precision > 0, precision, np.inf))
    together = min(count, max(_TOGETHER // len(q), 1))
    while True:
        noise = random.standard_normal((together, sensor.rows, len(q))) * sensor.noise[:, None]
        read_out = np.zeros((together, 0, q.shape[1]))
        if sensor.joint_noise:
            read_out = sensor.joint_noise * random.standard_normal((together, *q.shape))
        yield from zip(noise, read_out, prior * random.standard_normal((together, len(prior))), strict=True)


def _fit_draws(
    draws: Sequence[Draw], experiment: Experiment, q: Array, free: NDArray[np.bool_], covariance: Array
) -> pa.Table:
    """The errors and the length of the last step of each refit."""
    active = np.flatnonzero(experiment.movable)[free]
    noise, read_out, center = (np.stack(part) for part in zip(*draws, strict=True))
    steps, lengths = _refit(
        experiment.reader,
        experiment.numbers,
        q,
        experiment.direction(q),
        np.eye(len(experiment.movable))[active],
        covariance[np.ix_(free, free)],
        experiment.precision[active],
        noise,
        read_out if experiment.sensor.joint_noise else None,
        center,
    )
    return _rows(np.asarray(steps), np.asarray(lengths))


def _rows(steps: Array, lengths: Array) -> pa.Table:
    return pa.table({"errors": pa.array(list(steps), pa.list_(pa.float64())), "length": lengths})


@partial(jax.jit, static_argnums=0)
def _refit(
    reader: Reader,
    numbers: Numbers,
    joint_position: jax.Array,
    direction: jax.Array,
    select: jax.Array,
    covariance: jax.Array,
    precision: jax.Array,
    noise: jax.Array,
    read_out: jax.Array | None,
    center: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    sensor = reader.sensor
    assert isinstance(sensor, Sensor)
    true_tool = reader.tool(numbers, joint_position, direction, jnp.zeros(reader.size))
    whitener = reader.whitener(numbers, joint_position) if sensor.joint_noise else None

    def one(noise: jax.Array, read_out: jax.Array | None, center: jax.Array) -> tuple[jax.Array, jax.Array]:
        shown = joint_position if read_out is None else joint_position + read_out

        def cost(step: jax.Array) -> jax.Array:
            tool = reader.tool(numbers, shown, direction, step @ select)
            rows = _difference(sensor, tool, true_tool, noise) / jnp.array(sensor.noise)[:, None]
            rows = rows if whitener is None else jnp.sum(whitener * rows, 1)
            return 0.5 * jnp.sum(rows**2) + 0.5 * jnp.sum(precision * (step - center) ** 2)

        def advance(_: object, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            step = state[0]
            gradient = jax.grad(cost)(step)
            change = covariance @ gradient
            return step - change, jnp.sqrt(gradient @ change)

        return jax.lax.fori_loop(0, _STEPS, advance, (jnp.zeros(len(select)), jnp.inf))

    return jax.vmap(one)(noise, read_out, center)


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
