"""The Hayati models of many calibrations of one type of arm: in closed form where that is exact, by a fit elsewhere."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm, joint_motion, six_parameter_fk
from lite6jax.arms.dh import closed_form
from lite6jax.arms.se3 import Frame
from lite6jax.fitting.chunks import CHUNK
from lite6jax.fitting.compiled import Exported
from lite6jax.fitting.residual import predict_frames
from lite6jax.fitting.sampling import SAMPLES, check_positions, sample_within_limits
from lite6jax.fitting.status import Result
from lite6jax.model import ArmModel, ModelForm

EXACT = 1e-12
"""m and rad; a model of a calibration that is off by no more has the errors of rounding."""


class FittedCalibrations(NamedTuple):
    """The Hayati models of many calibrations of one type of arm, and their errors.

    Each of the last three is `(arm, 4)`: root mean square and largest distance (m), and root mean square and largest
    angle (rad), of a model from the calibration.

    Attributes:
        result: `(arm,)` of `Result`.
        steps: `(arm,)` of the solver.
        parameters: `(arm, size)`, m and rad.
        fitted: at the `SAMPLES` joint positions that were fitted.
        checked: at `check_positions`.
        nominal: of the nominal geometry at these.
    """

    result: NDArray[np.int32]
    steps: NDArray[np.integer]
    parameters: NDArray[np.floating]
    fitted: NDArray[np.floating]
    checked: NDArray[np.floating]
    nominal: NDArray[np.floating]


def fit_calibrations(kinematics: NDArray, T_joint_flange: NDArray, arm: Arm) -> FittedCalibrations:
    """The Hayati models that reproduce calibrations, as `fit_calibration` finds that of one.

    A calibration has no noise: a model that reproduces it to `EXACT` at all joint positions is the least-squares fit,
    and took no step. Only those of which the closed form does not (joint axes that are nearly parallel, or a table with
    a transform after its last joint) are fitted.

    Args:
        kinematics: `(arm, joint, 6)` m and rad.
        T_joint_flange: `(arm, 4, 4)` from the frame after the last joint to the flange.
        arm: the type of all.
    """
    if arm.sliding:
        return _one_by_one(kinematics, T_joint_flange, arm)
    count = len(kinematics)
    # filled up to whole chunks, so that batches of any size share compiled code
    filled = np.minimum(np.arange(-(-count // CHUNK) * CHUNK), count - 1)
    kinematics, T_joint_flange = kinematics[filled], T_joint_flange[filled]
    chunks = [slice(first, first + CHUNK) for first in range(0, len(filled), CHUNK)]
    q = np.concatenate([sample_within_limits(arm, SAMPLES, 0), check_positions(arm)])

    def errors(parameters: NDArray) -> NDArray:
        parts = (
            _errors(
                ModelForm(arm.form), parameters[each], arm.hayati, arm.T_joint_flange,
                kinematics[each], T_joint_flange[each], q,
            )
            for each in chunks
        )  # fmt: skip
        return np.concatenate(list(parts))

    parameters, _ = closed_form(arm.form, kinematics, arm.hayati)
    found = errors(parameters)
    result, steps = np.full(len(filled), Result.CONVERGED, np.int32), np.zeros(len(filled), np.int32)
    left = ~(np.max(found[:, :2, [1, 3]], (1, 2)) <= EXACT)
    if left.any():
        from lite6jax.fitting.fleet import fit_fleet  # it knows recordings, which takes as long to import as all else

        poses = jax.vmap(six_parameter_fk, in_axes=(0, None))(kinematics, q[:SAMPLES]) @ T_joint_flange[:, None]
        solution = fit_fleet(q[:SAMPLES], poses, nominal=arm)
        parameters = np.where(left[:, None], solution.parameters, parameters)
        result, steps = np.where(left, solution.result, result), np.where(left, solution.steps, steps)
        found = errors(parameters)
    fitted, checked, nominal = np.moveaxis(found[:count], 1, 0)
    return FittedCalibrations(result[:count], steps[:count], parameters[:count], fitted, checked, nominal)


def _one_by_one(kinematics: NDArray, T_joint_flange: NDArray, arm: Arm) -> FittedCalibrations:
    """As `fit_calibrations`, of arms with prismatic joints, which are few and have no closed form here."""
    from lite6jax.arms.factory import FactoryCalibration
    from lite6jax.fitting.calibration_fit import fit_calibration

    calibrations = zip(kinematics, T_joint_flange, strict=True)
    found = [fit_calibration(FactoryCalibration(rows, arm, T, "")) for rows, T in calibrations]
    errors: list[Any] = [
        [
            [f(part) for part in (each.position, each.orientation) for f in (_root_mean_square, np.max)]  # type: ignore[arg-type]
            for each in (solution.errors, solution.checked, solution.nominal_errors)
        ]
        for solution in found
    ]
    fitted, checked, nominal = np.moveaxis(np.array(errors), 1, 0)
    results = np.array([int(solution.result) for solution in found], np.int32)
    steps = np.array([solution.steps for solution in found])
    parameters = np.stack([solution.parameters for solution in found])
    return FittedCalibrations(results, steps, parameters, fitted, checked, nominal)


def _root_mean_square(values: Any) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _all_errors(
    form: ModelForm,
    parameters: Array,
    nominal: Array,
    T_nominal: Array,
    kinematics: Array,
    T_joint_flange: Array,
    joint_position: Array,
) -> Array:
    """`(arm, 3, 4)`: those of `FittedCalibrations`."""
    chain, joint = ModelForm(SixParameterForm(form.chain.dof)), joint_motion(form.chain, joint_position.T)

    def flange(of: ModelForm, geometry: Array, T: Array) -> Frame:
        return predict_frames(of, ArmModel(geometry, jnp.eye(4), T), joint)[1]

    by_design = flange(form, nominal, T_nominal)

    def one(own: Array, calibrated: Array, T: Array) -> Array:
        true, found = flange(chain, calibrated.reshape(-1), T), flange(form, own, T_nominal)
        (fitted, checked), (_, design) = _differences(found, true), _differences(by_design, true)
        return jnp.stack([fitted, checked, design])

    return jax.vmap(one)(parameters, kinematics, T_joint_flange)


def _differences(predicted: Frame, measured: Frame) -> list[Array]:
    """`(4,)` of the samples that were fitted, and of the others; distance and angle as of `prediction_errors`."""
    squares = [jnp.sum((a - b) ** 2, 0) for a, b in zip(predicted, measured, strict=True)]
    distance, chord = jnp.sqrt(squares[3]), jnp.sqrt(squares[0] + squares[1] + squares[2])
    angle = 2 * jnp.arcsin(jnp.minimum(chord / np.sqrt(8), 1.0))
    return [
        jnp.stack([f(each[part]) for each in (distance, angle) for f in (_rms, jnp.max)])
        for part in (slice(0, SAMPLES), slice(SAMPLES, None))
    ]


def _rms(values: Array) -> Array:
    return jnp.sqrt(jnp.mean(values**2))


_SINGLE_THREADED = {"xla_cpu_multi_thread_eigen": False}
_errors = Exported("calibration_errors", _all_errors, (0,), _SINGLE_THREADED)
