"""What a fit returns: parameters, its result code, unidentifiable parameters, covariance and errors."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from lite6jax import threads
from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.dh import write_table
from lite6jax.arms.factory import FactoryCalibration, hayati_of
from lite6jax.array_types import Array, Mask
from lite6jax.calibration.executables import KeptJit
from lite6jax.calibration.quality import ROUNDING, Quality, Result, quality_of_calibration, quality_of_poses
from lite6jax.calibration.residual import pad, padded_size
from lite6jax.estimation.robust import DOWNWEIGHTED
from lite6jax.model import ArmModel, ModelForm, predict
from lite6jax.recordings import Recording, require_radians
from lite6jax.recordings.fault import DataFault
from lite6jax.results import PublicResult


@dataclass(frozen=True)
class Errors:
    """Distances between prediction and measurement, sample by sample.

    Attributes:
        position: `(sample,)` m.
        orientation: `(sample,)` rad, or None where no orientation was measured.
        joint_position: `(sample, joint)` rad, where they were made.
    """

    position: Array
    orientation: Array | None
    joint_position: Array

    def select(self, samples: slice | NDArray) -> "Errors":
        """Those of some samples."""
        orientation = None
        if self.orientation is not None:
            orientation = self.orientation[samples]
        return Errors(self.position[samples], orientation, self.joint_position[samples])

    @property
    def position_rms(self) -> float:
        """Root of the mean squared 3-D distance, m."""
        return float(np.sqrt(np.mean(self.position**2)))


class GeometricElement(NamedTuple):
    """A point, plane, anchor or axis, in the arm's base frame.

    Attributes:
        name: such as `contact a`.
        values: by name with unit: `point_m`, `normal`, `offset_m`, `anchor_m`, `direction`, `constant_m`.
        std: of each of them, likewise.
    """

    name: str
    values: dict[str, list[float]]
    std: dict[str, list[float]]


FROM_PRIOR = 0.01
"""Share of the prior's variance above which an estimate is not determined by the data: its standard deviation is then
over 2 mm or 0.3°, a tenth of the prior's, and no less than real arms are off nominal."""

_AT_ONCE = 24_000
"""Samples, whose predicted poses take 3 MB."""
_predict_poses = KeptJit(predict, 1)


def prediction_errors(
    form: ModelForm, model: ArmModel, joint_position: Array, pose: Array, of: int | None = None
) -> Errors:
    """Distances (m) and angles (rad) of a model's prediction from poses `(sample, 4, 4)` or positions `(sample, 3)`.

    What is compiled for `of` samples serves a part of them as well.
    """

    def compare(block: slice, predicted: Array) -> tuple[Array, ...]:
        measured = pose[block]
        if pose.ndim == 2:
            return (np.linalg.norm(predicted[:, :3, 3] - measured, axis=1),)
        return frames.compare_transforms(predicted, measured)

    position, *orientation = _by_slices(form, model, joint_position, compare, of)
    return Errors(position, orientation[0] if orientation else None, joint_position)


def _by_slices(
    form: ModelForm,
    model: ArmModel,
    joint_position: Array,
    use: Callable[[slice, Array], tuple[Array, ...]],
    of: int | None = None,
) -> list[Array]:
    """What `use` makes of predicted poses `(sample, 4, 4)`, `_AT_ONCE` samples at a time, which bounds the memory."""
    size = padded_size(min(of or len(joint_position), _AT_ONCE))[0]

    def part(first: int) -> tuple[Array, ...]:
        block = slice(first, first + _AT_ONCE)
        q = joint_position[block]
        return use(block, np.asarray(_predict_poses(form.chain, model, pad(q, 0, size)))[: len(q)])

    parts = threads.by_parts(part, range(0, len(joint_position), _AT_ONCE))
    return [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]


@dataclass(frozen=True)
class Noise:
    """One standard deviation per axis, of position (m) and orientation (rad).

    Attributes:
        declared: by the sidecar, each None where it is not; None where neither is.
        position: estimated robustly from the residuals; model errors are included.
        orientation: likewise, or None where no orientation was measured.
    """

    declared: tuple[float | None, float | None] | None
    position: float
    orientation: float | None

    @property
    def over_declared(self) -> float | None:
        """The residuals over the declared noise, of the part where that is more; None where none is declared."""
        pairs = zip((self.position, self.orientation), self.declared or (None, None), strict=True)
        return max(
            (residual / declared for residual, declared in pairs if residual is not None and declared is not None),
            default=None,
        )


@dataclass(frozen=True)
class FixedParameter:
    """A parameter that the data does not identify, held at its nominal value.

    Attributes:
        name: the parameter.
        carried_by: the fitted parameters that it is confounded with.
    """

    name: str
    carried_by: tuple[str, ...]


@final
@dataclass(frozen=True, repr=False)
class Solution(PublicResult):
    """The fit of one arm.

    Attributes:
        arm: the nominal arm it started from.
        form: which parameters could be estimated.
        model: the fitted numbers, NumPy leaves.
        result: how it ended.
        steps: Gauss–Newton or Levenberg–Marquardt steps, of all rounds.
        covariance: `(size, size)` of the entries `form.names`, in m and rad; zero where held; None where the input has
            no noise (a calibration).
        free: `(size,)` bool, the estimated entries.
        held: the parameters that the data does not identify.
        errors: of the data it was fitted to.
        nominal_errors: of the nominal geometry, with frame and tool fitted where they are unknown.
        checked: of data not fitted to: fresh samples of a calibration, held-out contiguous blocks of a recording.
        noise: of the data; None for a calibration.
        weight: `(sample,)` in 0…1, of each sample under the robust loss.
        tolerance: `(size,)`, the precision of the prior about nominal, of which nothing is declared; zero without one.
        notes: assumptions of the fit, each one sentence.
        recording: the recording that was fitted; None for a calibration.
        faults: of its data, in the order in which they were corrected.
        ruled_out: faults that were tested for and are not there.
        places: what touches determine of their points, planes, anchors or axis.
    """

    arm: Arm
    form: ModelForm
    model: ArmModel
    result: Result
    steps: int
    covariance: Array | None
    free: Mask
    held: tuple[FixedParameter, ...]
    errors: Errors
    nominal_errors: Errors
    checked: Errors
    noise: Noise | None
    weight: Array
    tolerance: Array
    notes: tuple[str, ...] = field(default=())
    recording: Recording | None = None
    faults: tuple[DataFault, ...] = ()
    ruled_out: tuple[DataFault, ...] = ()
    places: tuple[GeometricElement, ...] = ()

    @property
    def parameters(self) -> Array:
        """The geometry `(geometry,)`, in the order of `form.chain.names`."""
        return np.asarray(self.model.geometry)

    @cached_property
    def standard_deviation(self) -> Array | None:
        """`(size,)` in m and rad; zero where held."""
        if self.covariance is None:
            return None
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def prior_share(self) -> Array:
        """`(size,)`: the variance of each estimate over that of its prior about nominal, 1 where the data say nothing.

        Zero without such a prior, and where held.
        """
        if self.covariance is None:
            return np.zeros(self.form.size)
        share = np.diagonal(self.covariance) * self.tolerance
        # rounding hides a prior below 1e-16 of the information
        return np.where((share >= 0) & (share <= 1), share, 1.0)

    @property
    def determined(self) -> Mask:
        """`(size,)`: estimated, and by more than the prior about nominal."""
        return self.free & (self.prior_share <= FROM_PRIOR)

    @cached_property
    def quality(self) -> Quality:
        """Judgement whether the model describes the data, on rows or samples that were not fitted."""
        if self.recording is None or self.noise is None:
            return quality_of_calibration(self.checked.position)
        measured = self.recording.position
        q = self.recording.joint_position
        flange = self.model if measured is not None else self.model._replace(T_flange_tool=np.eye(4))  # type: ignore[arg-type]
        (predicted,) = _by_slices(self.form, flange, q, lambda block, poses: (poses[:, :3, 3],))
        measured = predicted if measured is None else measured  # touches have no positions of their own
        noise = None if self.noise.declared is None else self.noise.declared[0]
        return quality_of_poses(
            self.checked.position, measured, predicted, self.arm.reach, noise, self.noise.over_declared
        )

    @cached_property
    def outlying(self) -> Mask:
        """`(sample,)`, rows of little weight whose error exceeds the declared noise, or else the rounding of a file."""
        settings = None if self.recording is None else self.recording.settings
        matters = self.errors.position > ((settings and settings.position_noise_m) or ROUNDING)
        if self.errors.orientation is not None:
            matters |= self.errors.orientation > ((settings and settings.orientation_noise_rad) or ROUNDING)
        return (self.weight < DOWNWEIGHTED) & matters

    def predict(self, joint_position: Array) -> Array:
        """The poses `T_sensor_tool` `(..., 4, 4)` at `joint_position` `(..., joint)` rad.

        Raises:
            InputError: joint positions in degrees.
        """
        require_radians(joint_position, self.arm.joint_limits)
        return np.asarray(predict(self.form.chain, self.model, joint_position))


def write_solution(solution: Solution, path: str | Path, overwrite: bool = False) -> Path:
    """Writes the fitted arm's Hayati parameters; sensor frame and tool, which are not the arm's, stay out of it.

    How the fit ended, whether it describes the data and its error on data not fitted are written beside the table.

    A six-parameter chain, near a factory calibration, is converted in closed form.

    Raises:
        InputError: as `write_table` and `hayati_of`.
    """
    form = solution.form.chain
    parameters = solution.parameters
    if not isinstance(form, HayatiForm):
        arm = solution.arm
        chain = FactoryCalibration(parameters.reshape(-1, 6), arm, arm.T_joint_flange, str(path))
        form = arm.form
        parameters = hayati_of(chain)
    error = solution.checked.position_rms
    fit = {
        "result": solution.result.name.lower(),
        "quality": solution.quality.verdict,
        "checked_position_rms_m": error if np.isfinite(error) else None,
    }
    return write_table(form, np.asarray(parameters), path, overwrite, fit)
