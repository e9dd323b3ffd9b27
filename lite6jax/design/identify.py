"""One answer to "what do these poses determine, and how well": of an arm with poses to come, or of a recording."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array
from lite6jax.calibration.fit import fit_recording
from lite6jax.calibration.problem import Geometry
from lite6jax.calibration.source import load_nominal, load_recording, with_arm
from lite6jax.calibration.start import sample_within_limits
from lite6jax.design.determination import Determination, Observability, determination_of, narrow_joints, observability
from lite6jax.design.information import (
    TOLERANCE,
    Chain,
    Experiment,
    check_joints,
    plan_experiment,
    recording_experiment,
)
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError, require_type
from lite6jax.model import predict
from lite6jax.recordings import Recording
from lite6jax.results import PublicResult

WORKSPACE = 1000
"""Joint positions inside the limits over which accuracy is averaged, and at which an arm shows all it can."""
_UNDETERMINED = 1e-6
"""Share of the readings' change that may lie in directions nothing determines; rounding leaves 1e-12."""
_ON_AXIS = 1e-6
"""m."""


def determine(experiment: Experiment, joint_position: ArrayLike) -> Determination:
    """What readings at `joint_position` `(sample, joint)` rad determine.

    Sensor frame, tool and places come first, effects last: what is held is then named after the geometry, or is an
    effect.

    Raises:
        InputError: joints that the arm does not have.
    """
    e = experiment
    geometry = int(e.movable[: e.form.chain.size].sum())
    rigid = e.size - e.physics.size
    return determination_of(
        e.root(joint_position),
        e.names,
        e.units,
        e.unit,
        samples=len(np.asarray(joint_position)),
        order=[*range(geometry, rigid), *range(geometry), *range(rigid, e.size)],
        prior=np.diagonal(e.prior),
    )


class Accuracy(NamedTuple):
    """One standard deviation of the pose that the fitted model predicts, RMS over joint positions: m in 3-D, and rad.

    Where not all that they depend on is determined their error is unbounded.
    """

    position_rms: float
    orientation_rms: float
    position_determined: bool
    orientation_determined: bool


def predict_accuracy(experiment: Experiment, determination: Determination, joint_position: ArrayLike) -> Accuracy:
    """How well a model fitted to what `determination` has determined predicts the tool at `(sample, joint)` rad."""
    J = experiment.error_rows(joint_position)
    by_unit = J / experiment.unit
    variance = np.sum((by_unit @ determination.covariance) * by_unit, 2)
    lost = J @ determination.open_directions
    parts = (slice(3), slice(3, 6))
    position, orientation = (float(np.sqrt(np.mean(variance[:, part].sum(1)))) for part in parts)
    determined = [bool(np.linalg.norm(lost[:, p]) <= _UNDETERMINED * np.linalg.norm(J[:, p])) for p in parts]
    return Accuracy(position, orientation, *determined)


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
        notes: what was assumed of a recording, a sentence each.
    """

    experiment: Experiment
    joint_position: Array
    determination: Determination
    possible: Determination
    observability: Observability | None
    accuracy: Accuracy
    notes: tuple[str, ...] = ()

    @property
    def missed(self) -> int:
        """How many combinations other poses of the arm would determine that these do not."""
        return max(self.possible.rank - self.determination.rank, 0)

    @property
    def on_last_axis(self) -> bool:
        """Tells whether the measured point lies on the last joint's axis, so that this joint does not move it."""
        return bool(np.hypot(*np.asarray(self.experiment.model.T_flange_tool)[:2, 3]) < _ON_AXIS)

    def narrow(self) -> list[tuple[int, float]]:
        """Joints, counted from 0, that hardly move in these poses, and their range in rad, m of prismatic joints."""
        return narrow_joints(np.ptp(self.joint_position, 0), self.experiment.arm.slides)

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain numbers and words, in SI units, for a JSON file.

        `parameters` are the unknown ones in the order of `correlation`; what is held has no standard deviation.
        """
        d = self.determination
        accuracy = self.accuracy
        parameters = zip(d.names, d.units, d.standard_deviation, d.free, d.scale, strict=True)
        return {
            "schema": "lite6jax/identification/1",
            "arm": self.experiment.arm.name,
            "samples": d.samples,
            "sensor": self.experiment.sensor.to_dict(),
            "rank": d.rank,
            "rank_possible": self.possible.rank,
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
            "observability": None if self.observability is None else self.observability._asdict(),
            "predicted_accuracy": {
                "position_rms_m": accuracy.position_rms if accuracy.position_determined else None,
                "orientation_rms_rad": accuracy.orientation_rms if accuracy.orientation_determined else None,
            },
            "notes": list(self.notes),
        }


def identify(
    experiment: Experiment, joint_position: ArrayLike | None = None, *, poses: int = 100, seed: int = 0
) -> Identification:
    """What poses determine of an experiment's parameters, and how well.

    Args:
        experiment: from `plan_experiment` or `recording_experiment`.
        joint_position: `(sample, joint)` rad; drawn inside the arm's limits where not given.
        poses: how many to draw.
        seed: of the random numbers.

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
    )


def identify_recording(
    recording: Recording | str | Path,
    arm: Arm | str | Path | None = None,
    *,
    geometry: Geometry = "declared",
    effects: Sequence[Effect] = (),
    seed: int = 0,
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
    settings = recording.settings
    sensor = experiment.sensor
    if settings.position_noise_m is None or (sensor.rows == 6 and settings.orientation_noise_rad is None):
        noise = fit_recording(recording, arm, geometry=geometry).noise
        assert noise is not None
        experiment = replace(experiment, sensor=sensor.with_noise(noise.position, noise.orientation))
        notes.append("the sidecar does not declare the noise of all that is measured: it is that of a fit's residuals")
    if effects:
        experiment = experiment.with_physics(effects)
    return replace(identify(experiment, recording.joint_position, seed=seed), notes=tuple(notes))


# ------------------------------------------------------------------ where the error of an arm comes from


@final
@dataclass(frozen=True, eq=False, repr=False)
class Sensitivity(PublicResult):
    """How far the flange moves per tolerance of each parameter, to first order.

    Attributes:
        names, units: of the parameters.
        tolerance: `(parameter,)` m or rad.
        joint_position: `(sample, joint)` rad, where.
        flange_position: `(sample, 3)` m, nominal, in the base frame.
        per_unit: `(parameter,)` root-mean-square m of the flange per m or rad of each.
        position: `(sample, parameter)` m that the flange moves per tolerance.
        orientation: `(sample, parameter)` rad that it turns.
        sliding: the prismatic joints, counted from 0.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    tolerance: Array
    joint_position: Array
    flange_position: Array
    per_unit: Array
    position: Array
    orientation: Array
    sliding: tuple[int, ...] = ()

    @property
    def share(self) -> Array:
        """`(parameter,)` of the mean squared position error that independent tolerances cause; they sum to 1."""
        squares = np.mean(self.position**2, 0)
        return squares / squares.sum()

    @property
    def expected_error(self) -> Array:
        """`(sample,)` m, the root-mean-square distance that all tolerances together cause."""
        return np.sqrt(np.sum(self.position**2, 1))

    def by_joint(self, bins: int = 24) -> tuple[Array, Array]:
        """A map over each joint: the middles of its bins `(joint, bin)` rad, and root-mean-square m per tolerance over
        the samples of each bin `(joint, bin, parameter)`; NaN where a bin is empty."""
        q = self.joint_position
        edges = np.linspace(q.min(0), q.max(0), bins + 1).T
        means = [
            [_means_of_cells([at], [bin_edges], row) for row in self.position.T**2]
            for at, bin_edges in zip(q.T, edges, strict=True)
        ]
        return (edges[:, 1:] + edges[:, :-1]) / 2, np.sqrt(np.moveaxis(np.array(means), 1, 2))

    def over_workspace(self, cell: float = 0.05) -> tuple[Array, Array, Array]:
        """A map over the distance from the base's axis and the height: edges of the cells of `cell` m, and the
        expected error `(radius, height)` m in each; NaN where the flange does not come."""
        radius = np.hypot(*self.flange_position[:, :2].T)
        height = self.flange_position[:, 2]
        across = np.arange(0, radius.max() + cell, cell)
        up = np.arange(np.floor(height.min() / cell) * cell, height.max() + cell, cell)
        return across, up, np.sqrt(_means_of_cells([radius, height], [across, up], self.expected_error**2))


def _means_of_cells(places: Sequence[Array], edges: Sequence[Array], values: Array) -> Array:
    """The means of `values` `(sample,)` in the cells between `edges` of each axis; NaN where there is no sample."""
    samples = np.stack(places, 1)
    counts = np.histogramdd(samples, edges)[0]
    sums = np.histogramdd(samples, edges, weights=values)[0]
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def sensitivity(
    arm: Arm | str,
    joint_position: ArrayLike | None = None,
    *,
    chain: Chain = "six_parameter",
    tolerance: dict[str, float] = TOLERANCE,
    samples: int = 4000,
    seed: int = 0,
) -> Sensitivity:
    """The first-order sensitivities, columns of the identification Jacobian.

    Args:
        arm: an `Arm` or a bundled name.
        joint_position: `(sample, joint)` rad; drawn inside the limits where not given.
        chain: the parameters; a factory file's six a joint, to which tolerances apply, or Hayati's.
        tolerance: one standard deviation of a length (`m`) and an angle (`rad`); 0.8 mm and 0.15° where not given.
        samples, seed: of the joint positions drawn.

    Raises:
        InputError: tolerances of which none moves the flange.
    """
    experiment = plan_experiment(arm, chain=chain, frame=False)
    drawn = joint_position is None
    q = sample_within_limits(experiment.arm, samples, seed) if drawn else np.asarray(joint_position, float)
    size = np.array([tolerance[unit] for unit in experiment.units])
    rows = experiment.error_rows(q) / experiment.unit
    per_unit = np.sqrt(np.mean(np.sum(rows[:, :3] ** 2, 1), 0))
    if not (per_unit * size).any():
        raise InputError(f"{experiment.arm.name}: no tolerance given moves its flange; give one of lengths too")
    rows = rows * size
    return Sensitivity(
        names=experiment.names,
        units=experiment.units,
        tolerance=size,
        joint_position=q,
        sliding=experiment.arm.sliding,
        flange_position=np.asarray(predict(experiment.form.chain, experiment.model, q))[:, :3, 3],
        per_unit=per_unit,
        position=np.linalg.norm(rows[:, :3], axis=1),
        orientation=np.linalg.norm(rows[:, 3:], axis=1),
    )
