"""One answer to "what do these poses determine, and how well": of an arm with poses to come, or of a recording."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm
from lite6jax.effects.effect import Effect
from lite6jax.errors import require_type
from lite6jax.fitting.fit import fit_recording
from lite6jax.fitting.problem import Geometry
from lite6jax.fitting.source import load_nominal, load_recording, with_arm
from lite6jax.fitting.start import sample_within_limits
from lite6jax.identifiability.determination import Determination, determine
from lite6jax.identifiability.indices import Observability, observability
from lite6jax.identifiability.information import Experiment, checked_joints, recorded
from lite6jax.identifiability.monte_carlo import Refits, refit
from lite6jax.identifiability.sensor import BARE
from lite6jax.recordings import Recording
from lite6jax.results import PublicResult

Array = NDArray[np.floating]

WORKSPACE = 1000
"""Joint positions inside the limits over which accuracy is averaged, and at which an arm shows all it can."""
NARROW = np.deg2rad(10.0)
"""A joint that moves over less than this tells little of what stands on either side of it."""
_UNDETERMINED = 1e-6
"""Share of the readings' change that may lie in directions nothing determines; rounding leaves 1e-12."""


class Accuracy(NamedTuple):
    """One standard deviation of the pose that the fitted model predicts, in the sensor's frame.

    Attributes:
        position: `(sample,)` m, 3-D.
        orientation: `(sample,)` rad.
        position_determined: whether all that positions depend on is determined; else their error is unbounded.
        orientation_determined: likewise.
    """

    position: Array
    orientation: Array
    position_determined: bool
    orientation_determined: bool

    @property
    def position_rms(self) -> float:
        """m, over the samples."""
        return float(np.sqrt(np.mean(self.position**2)))

    @property
    def orientation_rms(self) -> float:
        """rad, over the samples."""
        return float(np.sqrt(np.mean(self.orientation**2)))


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
        """Joints, counted from 0, that hardly move in these poses, and their range in rad."""
        span = np.ptp(self.joint_position, 0)
        return [(int(j), float(span[j])) for j in np.flatnonzero(span < NARROW)]

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain numbers and words, in SI units, for a JSON file.

        `parameters` are the unknown ones in the order of `correlation`; what is held has no standard deviation.
        """
        d, sensor = self.determination, self.experiment.sensor
        return {
            "schema": "lite6jax/identification/1",
            "arm": self.experiment.arm.name,
            "samples": d.samples,
            "sensor": sensor.to_dict(),
            "rank": d.rank,
            "rank_possible": self.possible.rank,
            "rank_by_theory": d.theory,
            "parameters": [
                {"name": name, "unit": unit, "std": float(deviation) if free else None, "tolerance": float(tolerance)}
                for name, unit, deviation, free, tolerance in zip(
                    d.names, d.units, d.standard_deviation, d.free, d.scale, strict=True
                )
            ],
            "singular_values": [float(value) for value in d.singular_values],
            "dependencies": [
                {
                    "held": item.name,
                    "undone_by": {name: share for name, _, share in item.partners},
                    "statement": item.statement,
                }
                for item in d.dependencies
            ],
            "base_parameters": [item.statement for item in d.base],
            "weak": list(d.weak()),
            "correlation": [[float(value) for value in row] for row in d.correlation],
            "observability": None if self.observability is None else asdict(self.observability),
            "predicted_accuracy": {
                "position_rms_m": self.accuracy.position_rms if self.accuracy.position_determined else None,
                "orientation_rms_rad": self.accuracy.orientation_rms if self.accuracy.orientation_determined else None,
            },
            "refits": None
            if self.refits is None
            else {
                "count": len(self.refits.errors),
                "settled": int(self.refits.settled.sum()),
                "std_over_predicted": [float(value) if np.isfinite(value) else None for value in self.refits.ratio],
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
        experiment: from `plan_experiment` or `recorded`.
        joint_position: `(sample, joint)` rad; drawn inside the arm's limits where not given.
        poses: how many to draw.
        refits: of simulated readings, to test the prediction; 0 is none.
        seed: of the random numbers.
        processes, scheduler: that refit, as `monte_carlo.refit` takes them.

    Raises:
        InputError: joints that the arm does not have, degrees for radians, or numbers that are not real or not finite.
    """
    require_type("experiment", experiment, Experiment, "an Experiment, as lite6jax.plan_experiment makes it")
    arm = experiment.arm
    q = sample_within_limits(arm, poses, seed) if joint_position is None else checked_joints(experiment, joint_position)
    determination = determine(experiment, q)
    workspace = sample_within_limits(arm, WORKSPACE, seed + 1)
    rank = determination.rank
    return Identification(
        experiment=experiment,
        joint_position=q,
        determination=determination,
        possible=determine(experiment, workspace),
        observability=observability(determination.singular_values[:rank], len(q)) if rank else None,
        accuracy=predicted_accuracy(experiment, determination, workspace),
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
        InputError: as `recorded`.
    """
    arm = load_nominal(arm)
    recording = load_recording(recording, arm)
    recording = recording if arm is not None else with_arm(recording)
    experiment = recorded(recording, arm, geometry)
    notes = list(recording.notes)
    settings, sensor = recording.settings, experiment.sensor
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


def predicted_accuracy(experiment: Experiment, determination: Determination, joint_position: ArrayLike) -> Accuracy:
    """How well a model fitted to what determines it predicts the tool at other joint positions.

    Args:
        experiment: the model.
        determination: of its unknown parameters.
        joint_position: `(sample, joint)` rad.
    """
    J = experiment.with_sensor(BARE).rows(joint_position)
    spread = np.sum((J / experiment.unit @ determination.covariance) * (J / experiment.unit), 2)
    lost = J @ determination.open_directions
    determined = [
        bool(np.linalg.norm(lost[:, part]) <= _UNDETERMINED * np.linalg.norm(J[:, part]))
        for part in (slice(3), slice(3, 6))
    ]
    return Accuracy(np.sqrt(spread[:, :3].sum(1)), np.sqrt(spread[:, 3:].sum(1)), *determined)
