"""One answer to "what do these poses determine, and how well": of an arm with poses to come, or of a recording."""

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm
from lite6jax.fitting.fleet import sample_within_limits
from lite6jax.fitting.problem import Geometry
from lite6jax.identifiability.determination import Determination, determine
from lite6jax.identifiability.indices import Observability, observability
from lite6jax.identifiability.information import Experiment, recorded
from lite6jax.identifiability.monte_carlo import Refits, refit
from lite6jax.identifiability.sensor import Sensor
from lite6jax.recordings import Recording

Array = NDArray[np.floating]

WORKSPACE = 1000
"""Joint positions inside the limits over which accuracy is averaged, and at which an arm shows all it can."""
NARROW = np.deg2rad(10.0)
"""A joint that moves over less than this tells little of what stands on either side of it."""
_BARE = Sensor("pose", 1.0, 1.0)
_ON_AXIS = 1e-6


class Accuracy(NamedTuple):
    """One standard deviation of the pose that the fitted model predicts, in the sensor's frame.

    Attributes:
        position: `(sample,)` m, 3-D.
        orientation: `(sample,)` rad.
    """

    position: Array
    orientation: Array

    @property
    def position_rms(self) -> float:
        """m, over the samples."""
        return float(np.sqrt(np.mean(self.position**2)))

    @property
    def orientation_rms(self) -> float:
        """rad, over the samples."""
        return float(np.sqrt(np.mean(self.orientation**2)))


@dataclass(frozen=True, eq=False)
class Identification:
    """What some poses determine.

    Attributes:
        experiment: the model and the sensor.
        joint_position: `(sample, joint)` rad, the poses.
        determination: by these poses.
        possible: by many poses anywhere inside the arm's limits.
        observability: the indices, or None where nothing is determined.
        accuracy: over the arm's whole workspace.
        refits: of simulated readings, where they were asked for.
    """

    experiment: Experiment
    joint_position: Array
    determination: Determination
    possible: Determination
    observability: Observability | None
    accuracy: Accuracy
    refits: Refits | None

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
                "position_rms_m": self.accuracy.position_rms,
                "orientation_rms_rad": self.accuracy.orientation_rms,
            },
            "refits": None
            if self.refits is None
            else {
                "count": len(self.refits.errors),
                "settled": int(self.refits.settled.sum()),
                "std_over_predicted": [float(value) for value in self.refits.ratio],
            },
        }

    @property
    def on_last_axis(self) -> bool:
        """Whether the measured point lies on the last joint's axis, which then shows nothing but its orientation."""
        return bool(np.hypot(*np.asarray(self.experiment.model.T_flange_tool)[:2, 3]) < _ON_AXIS)


def identify(
    experiment: Experiment,
    joint_position: ArrayLike | None = None,
    *,
    poses: int = 100,
    refits: int = 0,
    seed: int = 0,
) -> Identification:
    """What poses determine of an experiment's parameters, and how well.

    Args:
        experiment: from `plan` or `recorded`.
        joint_position: `(sample, joint)` rad; drawn inside the arm's limits where not given.
        poses: how many to draw.
        refits: of simulated readings, to put the prediction to the test; 0 is none.
        seed: of what is drawn.

    Raises:
        InputError: joints that the arm does not have.
    """
    arm = experiment.arm
    q = sample_within_limits(arm, poses, seed) if joint_position is None else np.asarray(joint_position, float)
    determination = determine(experiment, q)
    workspace = sample_within_limits(arm, WORKSPACE, seed + 1)
    rank = determination.rank
    return Identification(
        experiment=experiment,
        joint_position=q,
        determination=determination,
        possible=determine(experiment, workspace),
        observability=observability(determination.singular_values[:rank], len(q)) if rank else None,
        accuracy=predicted_accuracy(experiment, determination.covariance, workspace),
        refits=refit(experiment, q, refits, seed) if refits else None,
    )


def identify_recording(
    recording: Recording, arm: Arm | None = None, *, geometry: Geometry = "declared", refits: int = 0, seed: int = 0
) -> Identification:
    """As `identify`, of the poses, the sensor and the unknowns of a recording.

    Raises:
        InputError: as `recorded`.
    """
    return identify(recorded(recording, arm, geometry), recording.joint_position, refits=refits, seed=seed)


def predicted_accuracy(experiment: Experiment, covariance: Array, joint_position: ArrayLike) -> Accuracy:
    """How well a model fitted with `covariance` `(size, size)` (m, rad) predicts the tool at other joint positions.

    Args:
        experiment: the model.
        covariance: of its unknown parameters; zero where held, so that what is held wrongly does not count.
        joint_position: `(sample, joint)` rad.
    """
    J = experiment.with_sensor(_BARE).rows(joint_position) / experiment.unit
    spread = np.sum((J @ covariance) * J, 2)
    return Accuracy(np.sqrt(spread[:, :3].sum(1)), np.sqrt(spread[:, 3:].sum(1)))
