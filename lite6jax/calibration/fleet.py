"""Many arms of one type: fitted in one call, each with its own result code, and compared with each other."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple, cast, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from numpy.typing import NDArray

from lite6jax.arms import description, frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import HayatiForm, hayati_fk, six_parameter_fk
from lite6jax.arms.dh import closed_form
from lite6jax.arms.factory import FactoryCalibration, hayati_of, read_factory
from lite6jax.array_types import Array, Integers
from lite6jax.calibration.compiled import SINGLE_THREADED
from lite6jax.calibration.quality import Result
from lite6jax.calibration.residual import POSE
from lite6jax.calibration.solve import CHUNK, MAX_STEPS, fit_chunks
from lite6jax.calibration.start import SAMPLES, calibration_poses, check_positions, sample_within_limits
from lite6jax.errors import InputError, require_type
from lite6jax.model import LEVER, ArmModel, ModelForm
from lite6jax.results import PublicResult

EXACT = 1e-12
"""m and rad; a model of a calibration that is off by no more has the errors of rounding."""


@final
@dataclass(frozen=True, repr=False)
class FleetSolution(PublicResult):
    """The fits of many arms; every array has the arm as its first axis.

    Attributes:
        form: which parameters could be estimated.
        parameters: `(arm, size)`, the chain's parameters in the order of `form.chain.names`, m and rad.
        covariance: `(arm, size, size)` from the declared noise, or from the residuals where none was declared; NaN for
            an arm whose data does not determine every parameter.
        result: `(arm,)` of `Result`.
        steps: `(arm,)`.
        position_rms: `(arm,)` m, of the data fitted.
        orientation_rms: `(arm,)` rad.
        cost: `(arm,)`, half the sum of the squared whitened residuals.
    """

    form: ModelForm
    parameters: Array
    covariance: Array
    result: NDArray[np.int32]
    steps: NDArray[np.int32]
    position_rms: Array
    orientation_rms: Array
    cost: Array

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters' names."""
        return self.form.chain.names

    @cached_property
    def standard_deviation(self) -> Array:
        """`(arm, size)` m and rad."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))


def fit_fleet(
    joint_position: ArrayLike,
    T_base_flange: ArrayLike | None = None,
    *,
    nominal: Arm | str | None = None,
    noise: tuple[float, float] | None = None,
    weight: ArrayLike | None = None,
    max_steps: int = MAX_STEPS,
    progress: Callable[[int], object] | None = None,
) -> FleetSolution:
    """Fits the Hayati model of many arms of one type to their flange poses, in one call.

    Args:
        joint_position: `(arm, sample, joint)` rad, or `(sample, joint)` for all arms.
        T_base_flange: `(arm, sample, 4, 4)` m; a pose that is not finite counts as missing. Calibrations have no poses:
            `fit_fleet_calibrations` takes them.
        nominal: the arm's type, an `Arm` or the name of a bundled one.
        noise: one standard deviation of position (m, per axis) and orientation (rad, per axis). None weighs a radian
            like 0.1 m, as the seed does, and takes the covariance from the residuals.
        weight: `(arm, sample)`; zero for a sample that an arm does not have, so that ragged arms fit in one array.
        max_steps: most Gauss–Newton steps an arm may take.
        progress: called with the number of arms done since the last call.

    Returns:
        A `FleetSolution`. An arm whose fit fails has its `result` say so; the others are not affected.

    Raises:
        InputError: arrays whose shapes do not fit each other or the arm, no poses, noise that is not positive,
            negative weights.
    """
    if T_base_flange is None:
        raise InputError(
            "T_base_flange: give the flange's poses, (arm, sample, 4, 4); calibrations, (arm, joint, 6) or files, are "
            "fitted by fit_fleet_calibrations"
        )
    # they take as long to import as all else, and many calibrations are fitted without
    from lite6jax.recordings import require_radians
    from lite6jax.recordings.units import real_array

    arm = _load_type(nominal)
    q = real_array("joint_position", joint_position)
    T = real_array("T_base_flange", T_base_flange)
    if T.ndim != 4 or T.shape[2:] != (4, 4):
        raise InputError(f"T_base_flange of shape {T.shape}: give (arm, sample, 4, 4)")
    arms, samples = T.shape[:2]
    if q.shape not in ((arms, samples, arm.dof), (samples, arm.dof)):
        raise InputError(
            f"joint_position of shape {q.shape}: {arm.name} with these poses takes ({arms}, {samples}, {arm.dof}), "
            f"or ({samples}, {arm.dof}) shared by all arms"
        )
    require_radians(q, arm.joint_limits)
    w = np.ones((arms, samples)) if weight is None else np.asarray(weight, float)
    if w.shape != (arms, samples) or not (np.isfinite(w) & (w >= 0)).all():
        raise InputError(
            f"weight of shape {w.shape}: give ({arms}, {samples}) numbers that are finite and not negative"
        )
    sigma = np.asarray((1.0, 1 / LEVER) if noise is None else noise, float)
    if sigma.shape != (2,) or not (np.isfinite(sigma) & (sigma > 0)).all():
        raise InputError(
            f"noise {noise}: give two positive standard deviations, of position in m and orientation in rad"
        )
    if arms == 0 or samples == 0:
        raise InputError(f"T_base_flange of shape {T.shape}: give at least one arm and one sample")

    form = ModelForm(arm.form)
    start = ArmModel(arm.hayati, np.eye(4), arm.T_joint_flange)  # type: ignore[arg-type]
    fits: Any = fit_chunks(form, start, q, T, w, 1 / sigma, max_steps, progress)
    numbers = POSE * fits.samples
    result = np.where(numbers < form.size, Result.TOO_FEW_SAMPLES, fits.status).astype(np.int32)
    covariance = fits.covariance
    if noise is None:
        covariance = covariance * (2 * fits.cost / np.maximum(numbers - form.size, 1))[:, None, None]
    errors = fits.position_rms, fits.orientation_rms
    return FleetSolution(form, fits.model.geometry, covariance, result, fits.steps, *errors, fits.cost)


def fit_fleet_calibrations(
    factory: ArrayLike | Sequence[str | Path],
    *,
    nominal: Arm | str,
    samples: int = SAMPLES,
    seed: int = 0,
    progress: Callable[[int], object] | None = None,
) -> FleetSolution:
    """Fits the Hayati model of many arms to their six-parameter calibrations, by sampling the chains.

    Args:
        factory: `(arm, joint, 6)`, x y z (m) roll pitch yaw (rad) per joint; or the paths of calibrations.
        nominal: the arm's type, an `Arm` or the name of a bundled one.
        samples: joint positions, uniform inside the arm's limits, the same for all arms.
        seed: of those.
        progress: as in `fit_fleet`.

    Raises:
        InputError: a wrong shape or type, or as `read_factory`.
    """
    from lite6jax.recordings.units import real_array

    arm = _load_type(nominal)
    if isinstance(factory, list | tuple) and any(isinstance(source, str | Path) for source in factory):
        factory = np.stack([read_factory(path, arm).kinematics for path in factory])
    kinematics = real_array("factory", cast(ArrayLike, factory))
    if kinematics.ndim != 3 or kinematics.shape[1:] != (arm.dof, 6):
        raise InputError(f"factory of shape {kinematics.shape}: {arm.name} takes (arm, {arm.dof}, 6)")
    q = sample_within_limits(arm, samples, seed)
    poses = _chain_poses(kinematics, q, arm.sliding) @ arm.T_joint_flange
    solution = fit_fleet(q, poses, nominal=arm, progress=progress)
    broken = ~np.isfinite(kinematics).all((1, 2))
    return replace(solution, result=np.where(broken, Result.NOT_FINITE, solution.result).astype(np.int32))


def _load_type(nominal: Arm | str | None) -> Arm:
    require_type("nominal", nominal, Arm | str, "an Arm or the name of a bundled one")
    if isinstance(nominal, str):
        return description.load_bundled(nominal)
    return cast(Arm, nominal)


def _chain_poses(kinematics: NDArray, joint_position: Array, sliding: tuple[int, ...]) -> jax.Array:
    """Poses `(arm, sample, 4, 4)` after the last joint, of chains `(arm, joint, 6)`."""
    return jax.vmap(lambda rows: six_parameter_fk(rows, joint_position, sliding))(jnp.asarray(kinematics))


class FittedCalibrations(NamedTuple):
    """The Hayati models of many calibrations of one type of arm, and their errors.

    Attributes:
        result: `(arm,)` of `Result`.
        steps: `(arm,)` of the solver.
        parameters: `(arm, size)`, m and rad.
        errors: `(arm, 3, 4)` from the calibration: of the model at the `SAMPLES` joint positions that were fitted, of
            the model at `check_positions`, and of the nominal geometry at these. Each time root mean square and
            largest distance (m), and root mean square and largest angle (rad).
    """

    result: NDArray[np.int32]
    steps: Integers
    parameters: Array
    errors: Array


def fit_calibrations(kinematics: NDArray, T_joint_flange: NDArray, arm: Arm) -> FittedCalibrations:
    """The Hayati models that reproduce calibrations of one type of arm, as `fit_calibration` finds that of one.

    A calibration has no noise: a model that reproduces it to `EXACT` at all joint positions is the least-squares fit,
    and took no step. Only those of which the closed form does not are fitted: joint axes that are nearly parallel, a
    table with a transform after its last joint, or prismatic joints. `kinematics` are `(arm, joint, 6)` m and rad, and
    `T_joint_flange` `(arm, 4, 4)`.
    """
    count = len(kinematics)
    # filled up to whole chunks, so that batches of any size share compiled code
    filled = np.minimum(np.arange(-(-count // CHUNK) * CHUNK), count - 1)
    kinematics = kinematics[filled]
    T_joint_flange = T_joint_flange[filled]
    q = np.concatenate([sample_within_limits(arm, SAMPLES, 0), check_positions(arm)])

    def errors(parameters: Array) -> Array:
        chunks = []
        for chunk in (slice(first, first + CHUNK) for first in range(0, len(filled), CHUNK)):
            models = np.vstack([parameters[chunk], arm.hayati])
            predicted, true = map(
                np.asarray,
                _flange_poses(arm.form, models, arm.T_joint_flange, kinematics[chunk], T_joint_flange[chunk], q),
            )
            fitted, nominal = (
                np.stack(frames.compare_transforms(model_poses, true))
                for model_poses in (predicted[:-1], predicted[-1])
            )
            parts = fitted[..., :SAMPLES], fitted[..., SAMPLES:], nominal[..., SAMPLES:]
            statistics = [np.stack([np.sqrt(np.mean(part**2, -1)), part.max(-1)], -1) for part in parts]
            chunks.append(np.stack(statistics, 1).transpose(2, 1, 0, 3).reshape(-1, 3, 4))
        return np.concatenate(chunks)

    parameters, _ = closed_form(arm.form, kinematics, arm.hayati)
    error_statistics = errors(parameters)
    result = np.full(len(filled), Result.CONVERGED, np.int32)
    steps = np.zeros(len(filled), np.int32)
    inexact = ~(np.max(error_statistics[:, :2, [1, 3]], (1, 2)) <= EXACT)
    if inexact.any():
        poses = _chain_poses(kinematics, q[:SAMPLES], arm.sliding) @ T_joint_flange[:, None]
        solution = fit_fleet(q[:SAMPLES], poses, nominal=arm)
        parameters = np.where(inexact[:, None], solution.parameters, parameters)
        result = np.where(inexact, solution.result, result)
        steps = np.where(inexact, solution.steps, steps)
        error_statistics = errors(parameters)
    return FittedCalibrations(result[:count], steps[:count], parameters[:count], error_statistics[:count])


@partial(jax.jit, static_argnums=0, compiler_options=SINGLE_THREADED)
def _flange_poses(
    form: HayatiForm, parameters: Any, T_nominal: Any, kinematics: Any, T_joint_flange: Any, joint_position: Any
) -> tuple[jax.Array, jax.Array]:
    """Poses `(arm, sample, 4, 4)` of Hayati models `(arm, size)`, and of calibrations."""
    predicted = jax.vmap(lambda row: hayati_fk(form, row, joint_position))(parameters) @ T_nominal
    return predicted, _chain_poses(kinematics, joint_position, form.sliding) @ T_joint_flange[:, None]


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
    for calibration in calibrations[1:]:
        if calibration.arm.name != arm.name:
            raise InputError(
                f"{calibration.source}: is of a {calibration.arm.name}, but {calibrations[0].source} of a {arm.name};"
                " compare arms of one type"
            )
    q = check_positions(arm)
    flange = np.stack([calibration_poses(calibration, q)[:, :3, 3] for calibration in calibrations])
    nominal = np.asarray(hayati_fk(arm.form, arm.hayati, q) @ arm.T_joint_flange)[:, :3, 3]
    sources = tuple(calibration.source for calibration in calibrations)
    stems = tuple(Path(source).stem for source in sources)
    return Comparison(
        arm=arm,
        names=stems if len(set(stems)) == len(stems) else sources,
        sources=sources,
        difference=np.stack([hayati_of(calibration) for calibration in calibrations]) - arm.hayati,
        from_nominal=np.linalg.norm(flange - nominal, axis=-1),
        between=np.stack([np.linalg.norm(flange - reference, axis=-1).max(1) for reference in flange]),
    )
