"""The fit of touches, distances and heights: geometry under its prior, the tool's point and the sensor's unknowns."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.calibration.fit import FOLDS
from lite6jax.calibration.problem import TOUCHED_TOLERANCE
from lite6jax.calibration.quality import Result
from lite6jax.calibration.solution import Errors, Noise, Place, Solution
from lite6jax.domains.pose.kinematics import displaced
from lite6jax.domains.pose.rigid_arm import RigidArm, require_determined
from lite6jax.estimation.least_squares import Fit, relinearise
from lite6jax.estimation.least_squares import fit as fit_numbers
from lite6jax.estimation.options import DEFAULTS
from lite6jax.estimation.projection import scaled_inverse
from lite6jax.estimation.robust import FREEDOM, variance_factor, weights_left
from lite6jax.estimation.terms import Terms
from lite6jax.model import ArmModel
from lite6jax.recordings import require_samples
from lite6jax.sensors.sensor import Sensor

Array = NDArray[np.floating]

_STEP = 1e-6
"""m or rad, of difference quotients of a chain's numbers by displacements of its frames."""
_HELD = 1e16
"""The precision of what is held: to 10 nm or nanoradians."""


def fit_touches(begun: RigidArm) -> Solution:
    """The likeliest geometry, tool and points of touches, with held-out errors of what is read.

    Args:
        begun: the arm with its sensor, not fitted yet.

    Raises:
        InputError: fewer readings than determine the unknowns with a fifth held back.
    """
    recording, sensor = begun.recording, begun.touch
    assert sensor is not None
    require_determined(begun)
    unknowns = int(np.sum(begun.precision == 0)) + 1
    require_samples(recording, -(-unknowns * FOLDS // (FOLDS - 1)))
    arm, steps, converged = begun, 0, False
    while not converged and steps < DEFAULTS.steps:
        arm, before = relinearise(arm, DEFAULTS, steps=1), arm
        steps, converged = steps + 1, bool(np.max(np.abs(arm.offset - before.offset), initial=0.0) < 1e-7)
    known = fit_numbers(arm, Terms(), DEFAULTS)
    checked = np.empty(recording.samples)
    for fold in recording.contiguous_folds(FOLDS):
        checked[fold] = np.linalg.norm(relinearise(arm, DEFAULTS, ~fold).differences[:, fold], axis=0)
    # without a frame of the sensor's own, displacements of the base are of the chain
    of_chain = [name == "link" or (name == "base" and not begun.form.frame) for name, _, _ in begun.unknown]
    rigid = relinearise(replace(begun, precision=np.where(of_chain, _HELD, begun.precision)), DEFAULTS)
    covariance = _covariance(arm, known)
    form, q, size = begun.form, recording.joint_position, begun.form.size
    of_steps = _by_unknowns(arm)
    free = np.diagonal(of_steps @ of_steps.T) > 0
    tolerance = np.zeros(size)
    if recording.settings.factory_calibration is None:
        tolerance[: form.chain.size] = [TOUCHED_TOLERANCE[unit == "rad"] ** -2.0 for unit in form.chain.units]
    noise = float(known.scale[0] * arm.noise[0])
    own = slice(len(arm.unknown) - sensor.numbers, None)
    assert arm.touch is not None
    return Solution(
        arm=arm.arm,
        form=form,
        model=_model(arm, np.zeros(len(arm.unknown))),
        result=Result.CONVERGED if converged else Result.STEPS_EXHAUSTED,
        steps=steps,
        covariance=of_steps @ covariance @ of_steps.T,
        free=free,
        held=(),
        errors=Errors(np.linalg.norm(arm.differences, axis=0), None, q),
        nominal_errors=Errors(np.linalg.norm(rigid.differences, axis=0), None, q),
        checked=Errors(checked, None, q),
        noise=Noise(arm.declared_noise if arm.declared_noise[0] else None, noise, None),
        weight=weights_left(known.residuals.squares, FREEDOM),
        tolerance=tolerance,
        notes=recording.notes,
        recording=recording,
        places=places_of(arm.touch, covariance[own, own]),
    )


def places_of(sensor: Sensor, covariance: Array) -> tuple[Place, ...]:
    """What is known of each point, plane, anchor or axis, with standard deviations.

    Args:
        sensor: with its unknowns fitted.
        covariance: `(number, number)` of these.
    """
    kind = type(sensor).__name__.lower()
    kind = {"distance": "anchor"}.get(kind, kind)
    found = []
    moved = [sensor.displaced(_STEP * one) for one in np.eye(sensor.numbers)]
    for k, name in enumerate(sensor.names):  # type: ignore[attr-defined]
        values, std = sensor.place(k), {}
        for key, at in values.items():
            J = np.array([(np.array(other.place(k)[key]) - at) / _STEP for other in moved]).reshape(-1, len(at))
            std[key] = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", J, covariance, J), 0.0)).tolist()
        found.append(Place(name if name == kind else f"{kind} {name}", values, std))
    return tuple(found)


def _covariance(arm: RigidArm, known: Fit) -> Array:
    """Of all unknowns, `(unknown, unknown)`."""
    root = np.sqrt(known.residuals.row_weight)
    J = (arm.nuisance * root).reshape(len(arm.unknown), -1)
    factor = variance_factor(known.residuals.squares, arm.rows, FREEDOM, 0)
    return scaled_inverse(J @ J.T / factor + np.diag(arm.precision)) if len(J) else np.zeros((0, 0))


def _model(arm: RigidArm, nuisance: Array) -> ArmModel:
    """The arm with its unknowns displaced; where the sensor's frame is the base's, all is in the chain."""
    geometry, T_sensor_base, T_flange_tool = displaced(arm.start, arm.unknown, nuisance)
    if arm.form.frame:
        return ArmModel(geometry, T_sensor_base, T_flange_tool)
    rows = np.array(geometry).reshape(-1, 6)
    rows[0] = frames.row_from_transform(np.asarray(T_sensor_base) @ frames.transform_from_row(rows[0]))
    return ArmModel(rows.ravel(), np.eye(4), T_flange_tool)  # type: ignore[arg-type]


def _by_unknowns(arm: RigidArm) -> Array:
    """How the entries of a step `(size, unknown)` change with the unknowns."""
    form, count = arm.form, len(arm.unknown)
    out = np.zeros((form.size, count))
    for k, (name, _, axis) in enumerate(arm.unknown):
        if name == "reading":
            continue
        step = _STEP * np.eye(count)[k]
        more, less = _model(arm, step), _model(arm, -step)
        change = (np.asarray(more.geometry) - np.asarray(less.geometry)) / (2 * _STEP)
        out[: form.chain.size, k] = np.where(np.abs(change) < 1e3, change, 0.0)  # an angle may jump by a turn
        if name == "base" and form.frame:
            at = form.chain.size + 3 * (axis > 2)
            out[at : at + 3, k] = np.asarray(arm.start.T_sensor_base)[:3, axis % 3]
        if name == "tool":
            out[form.size - 6 + axis, k] = 1.0
    return out
