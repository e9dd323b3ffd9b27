"""The fit of one arm, from its calibration or from a recording; the latter is screened for data faults first.

Of touches, distances and heights the geometry is fitted under its prior, with the tool's point and the unknowns of the
sensor.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, Unpack, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.array_types import AnyArray, Array
from lite6jax.calibration import fit as plain
from lite6jax.calibration.fit import FOLDS, Loss, calibration_from_array, fit_calibration
from lite6jax.calibration.problem import TOUCHED_TOLERANCE, Geometry
from lite6jax.calibration.quality import Result
from lite6jax.calibration.solution import Errors, GeometricElement, Noise, Solution
from lite6jax.calibration.solve import MAX_STEPS, Solver
from lite6jax.calibration.source import load_nominal, read_source, with_arm
from lite6jax.calibration.start import SAMPLES
from lite6jax.domains.pose.rigid_arm import RigidArm, require_determined, rigid_arm
from lite6jax.domains.pose.screening.screen import screen
from lite6jax.errors import rename_argument, wrong_type
from lite6jax.estimation.least_squares import fit as fit_numbers
from lite6jax.estimation.least_squares import relinearise
from lite6jax.estimation.options import DEFAULTS
from lite6jax.estimation.projection import scaled_inverse
from lite6jax.estimation.robust import FREEDOM, variance_factor, weights_left
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording, require_one_station, require_samples
from lite6jax.recordings.units import real_array
from lite6jax.sensors.points import PointSensor

Source = str | Path | FactoryCalibration | Recording
"""A file, or what one holds."""
_STEP = 1e-6
"""m or rad, of difference quotients of a chain's numbers by displacements of its frames."""


class _Options(TypedDict, total=False):
    """The options of `fit`."""

    geometry: Geometry
    loss: Loss
    solver: Solver
    samples: int
    seed: int
    max_steps: int


@overload
def fit(
    source: Source | AnyArray | Sequence[Sequence[float]],
    nominal: Arm | str | Path | None = None,
    **options: Unpack[_Options],
) -> Solution: ...
@overload
def fit(
    source: Sequence[Source], nominal: Arm | str | Path | None = None, **options: Unpack[_Options]
) -> tuple[Solution, ...]: ...
def fit(
    source: Source | Sequence[Source] | ArrayLike,
    nominal: Arm | str | Path | None = None,
    *,
    geometry: Geometry = "declared",
    loss: Loss = "student_t",
    solver: Solver = "gauss_newton",
    samples: int = SAMPLES,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
) -> Solution | tuple[Solution, ...]:
    """Fits one arm, or several one after the other.

    Args:
        source: a calibration (file, `FactoryCalibration` or `(joint, 6)` numbers in m and rad), or a recording (file or
            `Recording`). Or a list of files, calibrations and recordings: each is fitted by itself.
        nominal: the arm's type, an `Arm`, a bundled name or a file; recognised, or from the sidecar, where not given.
        geometry: of a recording; `declared` is what its sidecar declares.
        loss: of a recording; Student's t is 97 % efficient on Gaussian noise and robust to outliers.
        solver: `gauss_newton` is the fast one, `levenberg_marquardt` optimistix'. They agree to 1e-12 by least squares;
            with Student's t to 1e-5 standard deviations, where rounding exceeds the decrease of the cost.
        samples: of a calibration: joint positions to fit at, uniform inside the joint limits.
        seed: of the random joint positions.
        max_steps: most steps of one solve.

    Returns:
        the solution; a tuple of one for each entry of a list.

    Raises:
        InputError: the source cannot be used; see `read_factory`, `read_recording` and `recording_problem`.
    """
    with rename_argument("arm", "nominal"):
        arm = load_nominal(nominal)
        if isinstance(source, list | tuple) and any(isinstance(member, Source) for member in source):
            settings: dict[str, Any] = {"geometry": geometry, "loss": loss, "solver": solver, "samples": samples}
            sources = cast(Sequence[Source], source)
            return tuple(fit(member, arm, **settings, seed=seed, max_steps=max_steps) for member in sources)
        if isinstance(source, str | Path):
            source = read_source(source, arm)
        if isinstance(source, Recording):
            return fit_recording(source, arm, geometry=geometry, loss=loss, solver=solver, max_steps=max_steps)
        if isinstance(source, list | tuple) or hasattr(source, "__array__"):
            source = calibration_from_array(real_array("source", cast(ArrayLike, source)), arm)
        if not isinstance(source, FactoryCalibration):
            accepted = "a file or a list of files, a Recording, or (joint, 6) numbers in m and rad"
            raise wrong_type("source", source, accepted)
        return fit_calibration(source, solver=solver, samples=samples, seed=seed, max_steps=max_steps)


def fit_recording(
    recording: Recording,
    nominal: Arm | None = None,
    *,
    geometry: Geometry = "declared",
    loss: Loss = "student_t",
    solver: Solver = "gauss_newton",
    max_steps: int = MAX_STEPS,
) -> Solution:
    """The fit of a recording without the faults of its data, as in a diagnosis; these are in `faults` of the solution.

    Args:
        recording: measured poses.
        nominal: the nominal arm; from the sidecar, or recognised, where not given.
        geometry, loss, solver, max_steps: as in `fit`.

    Raises:
        InputError: no measured poses, too few of them, or as `recording_problem`.
    """
    require_one_station(recording)
    if nominal is None:
        recording = with_arm(recording)
    screened = screen(recording, nominal, geometry)
    if recording.touches is not None:
        begun = rigid_arm(screened.recording, screened.arm, geometry)
        return replace(fit_touches(begun), faults=screened.found, ruled_out=screened.ruled_out)
    require_determined(screened.rigid_arm)
    screened = replace(screened, rigid=None)  # whose residuals take as much memory as the recording
    solution = plain.fit_recording(
        screened.recording, screened.arm, geometry=geometry, loss=loss, solver=solver, max_steps=max_steps
    )
    return replace(solution, faults=screened.found, ruled_out=screened.ruled_out)


def fit_touches(begun: RigidArm) -> Solution:
    """The likeliest geometry, tool and points of touches, with held-out errors of what is read.

    Args:
        begun: the arm with its sensor, not fitted yet.

    Raises:
        InputError: fewer readings than determine the unknowns with a fifth held back.
    """
    recording = begun.recording
    require_determined(begun)
    unknowns = int(np.sum(begun.precision == 0)) + 1
    require_samples(recording, -(-unknowns * FOLDS // (FOLDS - 1)))
    arm = begun
    steps = 0
    converged = False
    while not converged and steps < DEFAULTS.fit.steps:
        arm, before = relinearise(arm, DEFAULTS, steps=1), arm
        steps = steps + 1
        converged = bool(np.max(np.abs(arm.offset - before.offset), initial=0.0) < 1e-7)
    estimated = fit_numbers(arm, Terms(), DEFAULTS)
    checked = np.empty(recording.samples)
    for fold in recording.contiguous_folds(FOLDS):
        checked[fold] = np.linalg.norm(relinearise(arm, DEFAULTS, ~fold).differences[:, fold], axis=0)
    # without a frame of the sensor's own, displacements of the base are of the chain
    of_frames = [name != "link" and (name != "base" or begun.form.frame) for name, _, _ in begun.unknown]
    nominal = relinearise(begun.keeping(of_frames), DEFAULTS)
    J = (arm.frame_columns * np.sqrt(estimated.residuals.row_weight)).reshape(len(arm.unknown), -1)
    factor = variance_factor(estimated.residuals.squares, arm.rows, FREEDOM, 0)
    covariance = scaled_inverse(J @ J.T / factor + np.diag(arm.precision)) if len(J) else np.zeros((0, 0))
    form = begun.form
    q = recording.joint_position
    of_steps = _by_unknowns(arm)
    tolerance = np.zeros(form.size)
    if recording.settings.factory_calibration is None:
        tolerance[: form.chain.size] = [TOUCHED_TOLERANCE[unit == "rad"] ** -2.0 for unit in form.chain.units]
    noise = float(estimated.scale[0] * arm.noise[0])
    first_of_sensor = len(arm.unknown) - arm.measured.numbers
    assert isinstance(arm.measured, PointSensor)
    return Solution(
        arm=arm.arm,
        form=form,
        model=arm.model,
        result=Result.CONVERGED if converged else Result.STEPS_EXHAUSTED,
        steps=steps,
        covariance=of_steps @ covariance @ of_steps.T,
        free=np.diagonal(of_steps @ of_steps.T) > 0,
        held=(),
        errors=Errors(np.linalg.norm(arm.differences, axis=0), None, q),
        nominal_errors=Errors(np.linalg.norm(nominal.differences, axis=0), None, q),
        checked=Errors(checked, None, q),
        noise=Noise(arm.declared_noise if arm.declared_noise[0] else None, noise, None),
        weight=weights_left(estimated.residuals.squares, FREEDOM),
        tolerance=tolerance,
        notes=recording.notes,
        recording=recording,
        places=_places_of(arm.measured, covariance[first_of_sensor:, first_of_sensor:]),
    )


def _places_of(sensor: PointSensor, covariance: Array) -> tuple[GeometricElement, ...]:
    """What is known of each point, plane, anchor or axis, with the covariance `(number, number)` of its unknowns."""
    places = []
    moved = [sensor.displaced(_STEP * unit) for unit in np.eye(sensor.numbers)]
    for k, name in enumerate(sensor.names):
        values = sensor.place(k)
        std = {}
        for key, at in values.items():
            J = np.array([(np.array(displaced.place(k)[key]) - at) / _STEP for displaced in moved]).reshape(-1, len(at))
            std[key] = np.sqrt(np.maximum(np.einsum("ik,ij,jk->k", J, covariance, J), 0.0)).tolist()
        places.append(GeometricElement(sensor.place_name(name), values, std))
    return tuple(places)


def _by_unknowns(arm: RigidArm) -> Array:
    """How the entries of a step `(size, unknown)` change with the unknowns."""
    form = arm.form
    count = len(arm.unknown)
    out = np.zeros((form.size, count))
    for k, (name, _, axis) in enumerate(arm.unknown):
        if name == "reading":
            continue
        step = _STEP * np.eye(count)[k]
        more, less = (np.asarray(arm.relinearised(signed_step).model.geometry) for signed_step in (step, -step))
        change = (more - less) / (2 * _STEP)
        out[: form.chain.size, k] = np.where(np.abs(change) < 1e3, change, 0.0)  # an angle may jump by a turn
        if name == "base" and form.frame:
            at = form.chain.size + 3 * (axis > 2)
            out[at : at + 3, k] = np.asarray(arm.start.T_sensor_base)[:3, axis % 3]
        if name == "tool":
            out[form.size - 6 + axis, k] = 1.0
    return out
