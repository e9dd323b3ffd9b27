"""Which parameters move the flange, where, and which of them make up the error of an arm as assembled."""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import binned_statistic, binned_statistic_2d

from lite6jax.arms.arm import Arm
from lite6jax.calibration.start import sample_within_limits
from lite6jax.design.information import TOLERANCE, Chain, plan_experiment
from lite6jax.design.sensor import BARE
from lite6jax.errors import InputError
from lite6jax.model import predict
from lite6jax.results import PublicResult

Array = NDArray[np.floating]


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
        squares = [binned_statistic(at, self.position.T**2, bins=each)[0] for at, each in zip(q.T, edges, strict=True)]
        return (edges[:, 1:] + edges[:, :-1]) / 2, np.sqrt(np.moveaxis(np.stack(squares), 1, 2))

    def over_workspace(self, cell: float = 0.05) -> tuple[Array, Array, Array]:
        """A map over the distance from the base's axis and the height: edges of the cells of `cell` m, and the
        expected error `(radius, height)` m in each; NaN where the flange does not come."""
        radius = np.hypot(*self.flange_position[:, :2].T)
        height = self.flange_position[:, 2]
        across = np.arange(0, radius.max() + cell, cell)
        up = np.arange(np.floor(height.min() / cell) * cell, height.max() + cell, cell)
        squares = binned_statistic_2d(radius, height, self.expected_error**2, bins=(across, up))[0]  # type: ignore[arg-type]
        return across, up, np.sqrt(squares)


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
    experiment = plan_experiment(arm, BARE, chain=chain, frame=False)
    drawn = joint_position is None
    q = sample_within_limits(experiment.arm, samples, seed) if drawn else np.asarray(joint_position, float)
    size = np.array([tolerance[unit] for unit in experiment.units])
    rows = experiment.rows(q) / experiment.unit
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
