"""How arms of one type differ from the nominal and from each other: the manufacturing tolerance made visible."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import hayati_fk
from lite6jax.arms.factory import FactoryCalibration, hayati_of
from lite6jax.errors import InputError
from lite6jax.fitting.problem import calibration_poses
from lite6jax.fitting.sampling import check_positions
from lite6jax.results import PublicResult

Array = NDArray[np.floating]


@dataclass(frozen=True, repr=False)
class Comparison(PublicResult):
    """Arms of one type side by side.

    Attributes:
        arm: the nominal arm.
        names: a short name of each arm, from its file.
        sources: its file.
        difference: `(arm, parameter)` of the Hayati parameters from nominal, m and rad.
        from_nominal: `(arm, sample)` m, of the flange.
        between: `(arm, arm)` m, the largest distance of the two flanges over the samples.
    """

    arm: Arm
    names: tuple[str, ...]
    sources: tuple[str, ...]
    difference: Array
    from_nominal: Array
    between: Array

    @property
    def spread(self) -> Array:
        """`(parameter,)` standard deviation across the arms, m and rad."""
        return np.std(self.difference, axis=0, ddof=1)

    @property
    def largest(self) -> Array:
        """`(parameter,)` largest absolute difference from nominal, m and rad."""
        return np.abs(self.difference).max(0)


def compare(calibrations: Sequence[FactoryCalibration]) -> Comparison:
    """Compares calibrations of one type of arm, in closed form and over joint positions inside its limits.

    Raises:
        InputError: fewer than two, of different types, or as `hayati_of`.
    """
    if len(calibrations) < 2:
        raise InputError("compare needs two calibrations or more; name their files")
    arm = calibrations[0].arm
    for other in calibrations[1:]:
        if other.arm.name != arm.name:
            raise InputError(
                f"{other.source}: is of a {other.arm.name}, but {calibrations[0].source} of a {arm.name};"
                " compare arms of one type"
            )
    q = check_positions(arm)
    flange = np.stack([calibration_poses(calibration, q)[:, :3, 3] for calibration in calibrations])
    nominal = np.asarray(hayati_fk(arm.form, arm.hayati, q) @ arm.T_joint_flange)[:, :3, 3]
    return Comparison(
        arm=arm,
        names=_short_names([calibration.source for calibration in calibrations]),
        sources=tuple(calibration.source for calibration in calibrations),
        difference=np.stack([hayati_of(calibration) for calibration in calibrations]) - arm.hayati,
        from_nominal=np.linalg.norm(flange - nominal, axis=-1),
        between=np.stack([np.linalg.norm(flange - own, axis=-1).max(1) for own in flange]),
    )


def _short_names(sources: Sequence[str]) -> tuple[str, ...]:
    """The stems of the files where they tell them apart, else their paths."""
    stems = [Path(source).stem for source in sources]
    return tuple(stems if len(set(stems)) == len(stems) else sources)
