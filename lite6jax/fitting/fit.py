"""The fit of one arm, from its calibration or from a recording, through one residual."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import JOINTS, FactoryCalibration, read_factory, recognise
from lite6jax.arms.files import read_arm
from lite6jax.errors import InputError
from lite6jax.fitting.fleet import MAX_STEPS, fit_chunks, observe, pad, padded_size, sample_within_limits
from lite6jax.fitting.gauge import determined
from lite6jax.fitting.gauss_newton import Prior
from lite6jax.fitting.problem import (
    Geometry,
    Problem,
    calibration_poses,
    calibration_problem,
    recording_problem,
    whitener_of,
)
from lite6jax.fitting.residual import POSE, POSITION, Robust
from lite6jax.fitting.robust import FREEDOM, gaussian_t_scale, t_scale, variance_factor, weights_left
from lite6jax.fitting.solution import Errors, Held, Noise, Result, Solution
from lite6jax.model import ArmModel, ModelForm, predict
from lite6jax.recordings import Recording, read_recording, read_settings, recording_file, sidecar_path

Array = NDArray[np.floating]
Solver = Literal["gauss_newton", "levenberg_marquardt"]
Loss = Literal["student_t", "least_squares"]

ROUNDING = 1e-15
"""What residuals have by rounding, in m and rad."""
SAMPLES = 300
CHECK_SAMPLES = 1000
FOLDS = 5
_ROUNDS = 30
_SCALE_SETTLED = 1e-3
_EXCESS = 2.0
"""Residual variance over the declared one above which the model, not the sensor, is what leaves it."""


def fit(
    source: str | Path | FactoryCalibration | Recording | ArrayLike,
    nominal: Arm | str | None = None,
    *,
    geometry: Geometry = "declared",
    loss: Loss = "student_t",
    solver: Solver = "gauss_newton",
    samples: int = SAMPLES,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
) -> Solution:
    """Fits one arm.

    Args:
        source: a calibration (file, `FactoryCalibration` or `(joint, 6)` numbers in m and rad), or a recording (file or
            `Recording`).
        nominal: the arm's type, an `Arm` or a bundled name; recognised, or taken from the sidecar, where not given.
        geometry: of a recording; `declared` does what its sidecar says.
        loss: of a recording; Student's t loses 3 % of precision on clean data and is blind to wild samples.
        solver: `gauss_newton` is the fast one, `levenberg_marquardt` optimistix'. They agree to 1e-12 by least squares;
            with Student's t to 1e-5 standard deviations, as the second stops where rounding hides the cost's fall.
        samples: of a calibration's chain, inside the arm's limits.
        seed: of those.
        max_steps: most steps of one solve.

    Raises:
        InputError: the source cannot be used; see `read_factory`, `read_recording` and `recording_problem`.
    """
    arm = load_nominal(nominal)
    if isinstance(source, str | Path):
        source = read_source(source, arm)
    if isinstance(source, Recording):
        return fit_recording(source, arm, geometry=geometry, loss=loss, solver=solver, max_steps=max_steps)
    if not isinstance(source, FactoryCalibration):
        kinematics = np.asarray(source, float)
        if kinematics.ndim != 2 or kinematics.shape[1] != 6 or not np.isfinite(kinematics).all():
            raise InputError(f"calibration of shape {kinematics.shape}: give (joint, 6) finite numbers, m and rad")
        if arm is not None and arm.dof != len(kinematics):
            raise InputError(
                f"calibration: has {len(kinematics)} joints, but {arm.name} has {arm.dof}; name another arm"
            )
        if arm is None and len(kinematics) not in JOINTS:
            raise InputError(f"calibration: has {len(kinematics)} joints, as no bundled arm has; give `nominal`")
        known = recognise(kinematics, [f"joint{i + 1}" for i in range(len(kinematics))], "calibration", arm)
        source = FactoryCalibration(kinematics, known, known.T_joint_flange, "array")
    return fit_calibration(source, solver=solver, samples=samples, seed=seed, max_steps=max_steps)


def load_nominal(nominal: Arm | str | None) -> Arm | None:
    """An arm by name, or as it is."""
    return read_arm(nominal) if isinstance(nominal, str) else nominal


def read_source(
    path: str | Path, arm: Arm | None, *, assume_degrees: bool = False, assume_millimetres: bool = False
) -> FactoryCalibration | Recording:
    """A calibration or a recording, by the file's suffix.

    Args:
        path: the file.
        arm: its nominal arm; recognised, or taken from the sidecar, where not given.
        assume_degrees: of a recording, as in `read_recording`.
        assume_millimetres: likewise.

    Raises:
        InputError: as their readers.
    """
    file = recording_file(path)
    if file is None:
        return read_factory(path, arm)
    arm = arm or read_arm(read_settings(sidecar_path(file)).arm_reference(file.parent))
    return read_recording(
        path,
        dof=arm.dof,
        assume_degrees=assume_degrees,
        assume_millimetres=assume_millimetres,
        joint_limits=arm.joint_limits,
        reach=arm.reach,
    )


def fit_calibration(
    calibration: FactoryCalibration,
    *,
    solver: Solver = "gauss_newton",
    samples: int = SAMPLES,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
) -> Solution:
    """The Hayati model that reproduces a calibration; `checked` on 1000 fresh samples. See `fit`."""
    arm = calibration.arm
    if seed < 0:
        raise InputError(f"seed {seed}: give zero or more")
    fewest = -(-arm.form.size // POSE)
    if samples < fewest:
        raise InputError(
            f"samples {samples}: too few for {arm.form.size} parameters; give at least {fewest}, better 300"
        )
    # fitted and fresh samples in one array, so that the chains are compiled once
    q = np.concatenate([sample_within_limits(arm, samples, seed), sample_within_limits(arm, CHECK_SAMPLES, seed + 1)])
    pose = calibration_poses(calibration, q)
    problem = calibration_problem(calibration, q[:samples], pose[:samples])
    whitener = whitener_of(problem.covariance())
    solved = _solve(problem, problem.movable, whitener, np.ones((1, samples)), None, problem.start, solver, max_steps)
    model = jax.tree.map(lambda leaf: leaf[0], solved.model)
    everywhere = errors(problem.form, model, q, pose)
    return Solution(
        arm=arm,
        form=problem.form,
        model=model,
        result=Result(int(solved.status[0])),
        steps=int(solved.steps[0]),
        covariance=None,
        free=problem.movable,
        held=(),
        errors=everywhere.select(slice(0, samples)),
        nominal_errors=errors(problem.form, problem.start, q, pose).select(slice(samples, None)),
        checked=everywhere.select(slice(samples, None)),
        noise=None,
        weight=np.ones(samples),
    )


def fit_recording(
    recording: Recording,
    nominal: Arm | None = None,
    *,
    geometry: Geometry = "declared",
    loss: Loss = "student_t",
    solver: Solver = "gauss_newton",
    max_steps: int = MAX_STEPS,
) -> Solution:
    """The fit of a recording; `checked` on contiguous fifths, each predicted by a fit of the other four. See `fit`.

    What the model leaves over may be far larger than the noise, and shaped otherwise: where the residuals of a first
    fit exceed what is declared, the excess is added as an isotropic part of the noise before the fit that counts.
    """
    problem = recording_problem(recording, nominal, geometry)
    samples, rows = recording.samples, problem.rows
    everything = np.ones((1, samples))
    declared = problem.covariance()
    freedom = FREEDOM if loss == "student_t" else None
    first = _solve(problem, problem.movable, whitener_of(declared), everything, None, problem.start, "gauss_newton", 0)
    if not np.isfinite(first.curvature).all():
        raise InputError(f"{recording.source}: holds numbers too large to work with; check the units of its columns")
    free, held = _determined(problem, first.curvature[0])
    fittable = int(free.sum())
    if fittable and samples * rows * (FOLDS - 1) <= FOLDS * fittable:
        raise InputError(
            f"{recording.source}: {samples} samples give {samples * rows} numbers, too few to fit {fittable} "
            f"parameters and hold a fifth back; record at least {fittable * FOLDS // (rows * (FOLDS - 1)) + 1} samples"
        )
    training = np.ones((FOLDS + 1, samples))
    for k, fold in enumerate(recording.contiguous_folds(FOLDS)):
        training[k + 1, fold] = 0.0
    geometry_held = free.copy()
    geometry_held[: problem.form.chain.size] = False

    solve = partial(_solve_robustly, problem, freedom=freedom, max_steps=max_steps)
    rough = solve(free, declared, training[:1], problem.start, "gauss_newton")
    left = errors(problem.form, rough.model(0), problem.joint_position, problem.pose)
    if not problem.declared:  # a placeholder shaped the first fit; the residuals tell both parts
        problem = replace(problem, noise=_spreads(left))
        declared = problem.covariance()
        solve = partial(_solve_robustly, problem, freedom=freedom, max_steps=max_steps)
    excess = _excess(problem, declared, left)
    covariance = declared + np.diag(np.repeat(excess, 3)[:rows])
    fits = solve(free, covariance, training, rough.model(0), solver)
    nominal_fit = solve(geometry_held, covariance, training[:1], problem.start, "gauss_newton")

    model = fits.model(0)
    held_out = [errors(problem.form, fits.model(k), problem.joint_position, problem.pose) for k in range(1, FOLDS + 1)]
    fold_of, row = np.argmin(training[1:], 0), np.arange(samples)
    orientation = [e.orientation for e in held_out if e.orientation is not None]
    checked = Errors(
        np.stack([e.position for e in held_out])[fold_of, row],
        np.stack(orientation)[fold_of, row] if orientation else None,
        problem.joint_position,
    )
    fitted = errors(problem.form, model, problem.joint_position, problem.pose)
    return Solution(
        arm=problem.arm,
        form=problem.form,
        model=model,
        result=Result(int(fits.solved.status[0])),
        steps=int(rough.solved.steps[0] + fits.solved.steps[0]),
        covariance=_covariance(problem, free, fits, training[0] > 0, freedom),
        free=free,
        held=held,
        errors=fitted,
        nominal_errors=errors(problem.form, nominal_fit.model(0), problem.joint_position, problem.pose),
        checked=checked,
        noise=Noise(problem.noise if problem.declared else None, *_spreads(fitted)),
        weight=weights_left(fits.solved.squares[0] / fits.scale[0] ** 2, freedom),
        notes=(*problem.notes, *_unsettled(fits)),
    )


def _unsettled(fits: "_Fits") -> list[str]:
    count = int((fits.solved.status[1:] != Result.CONVERGED).sum())
    if not count:
        return []
    return [
        f"{count} of the {FOLDS} held-out fits did not settle: without their block the other rows do not determine "
        f"every parameter, and the held-out errors are no guide; mix the poses when recording."
    ]


def errors(form: ModelForm, model: ArmModel, joint_position: Array, pose: Array) -> Errors:
    """Distances (m) and angles (rad) of a model's prediction from poses `(sample, 4, 4)` or positions `(sample, 3)`."""
    size = padded_size(len(pose))[0]
    predicted = np.asarray(predict(form.chain, model, pad(joint_position, 0, size)))[: len(pose)]
    if pose.ndim == 2:
        return Errors(np.linalg.norm(predicted[:, :3, 3] - pose, axis=1), None, joint_position)
    # ‖R̂ − R‖ = 2 √2 sin(angle / 2), which small angles do not round away
    chord = np.linalg.norm(predicted[:, :3, :3] - pose[:, :3, :3], axis=(1, 2))
    angle = 2 * np.arcsin(np.minimum(chord / np.sqrt(8), 1.0))
    return Errors(np.linalg.norm(predicted[:, :3, 3] - pose[:, :3, 3], axis=1), angle, joint_position)


class _Solved(NamedTuple):
    """Solutions of one problem for several choices of samples; the choice is the first axis."""

    model: ArmModel
    curvature: Array
    squares: Array
    status: Array
    steps: Array


class _Fits(NamedTuple):
    solved: _Solved
    scale: Array

    def model(self, choice: int) -> ArmModel:
        return jax.tree.map(lambda leaf: np.asarray(leaf[choice]), self.solved.model)


def _solve(
    problem: Problem,
    free: NDArray,
    whitener: Array,
    weight: Array,
    robust: Robust | None,
    start: ArmModel,
    solver: Solver,
    max_steps: int,
) -> _Solved:
    """Solves for each row of weights `(choice, sample)`; leaves of `start` and `robust` may have the choice axis."""
    prior = Prior(np.asarray(problem.start.geometry), problem.precision, free.astype(float))  # type: ignore[arg-type]
    choices = len(weight)
    if solver == "levenberg_marquardt":
        return _solve_by_record(problem, prior, whitener, weight, robust, start, max_steps)
    summary = fit_chunks(
        problem.form,
        start,
        problem.joint_position,
        np.broadcast_to(problem.pose, (choices, *problem.pose.shape)),
        weight,
        whitener if whitener.ndim == 1 else np.broadcast_to(whitener, (choices, *whitener.shape)),
        robust,
        prior,
        chunk=1,
        once=problem.exact,
        max_steps=max_steps,
    )
    solved = summary.solved
    return _Solved(solved.model, solved.curvature, summary.squares, solved.status, solved.steps)  # type: ignore[arg-type]


def _solve_by_record(
    problem: Problem,
    prior: Prior,
    whitener: Array,
    weight: Array,
    robust: Robust | None,
    start: ArmModel,
    max_steps: int,
) -> _Solved:
    from lite6jax.fitting.levenberg_marquardt import solve_one  # optimistix takes 0.3 s to import

    size, block = padded_size(len(problem.pose))
    q, pose = pad(problem.joint_position, 0, size), pad(problem.pose, 0, size)
    padded = whitener if whitener.ndim == 1 else pad(whitener, 0, size)
    parts = []
    for k, row in enumerate(weight):
        observed = observe(
            jnp.asarray(q), jnp.asarray(pose), jnp.asarray(pad(row, 0, size)), jnp.asarray(padded), block
        )
        begin = ArmModel(
            *(leaf[k] if np.ndim(leaf) > ndim else leaf for leaf, ndim in zip(start, (1, 2, 2), strict=True))
        )
        own = robust and Robust(*(np.broadcast_to(leaf, len(weight))[k] for leaf in robust))
        parts.append(jax.tree.map(np.asarray, solve_one(problem.form, begin, observed, own, prior, max_steps)))
    solved = jax.tree.map(lambda *leaves: np.stack(leaves), *parts)
    # the fast solver, allowed no step, measures residuals and curvature, and sees what is singular
    free = np.asarray(prior.free) > 0
    still = _solve(problem, free, whitener, weight, robust, solved.model, "gauss_newton", 0)
    singular = (solved.status == Result.CONVERGED) & (still.status == Result.SINGULAR)
    status = np.where(singular, Result.SINGULAR, solved.status)
    return _Solved(solved.model, still.curvature, still.squares, status, solved.steps)


def _determined(problem: Problem, curvature: Array) -> tuple[NDArray[np.bool_], tuple[Held, ...]]:
    """What data and prior determine, among what the fit is asked to move."""
    movable = problem.movable
    if not movable.any():
        return movable, ()
    free, held = determined(problem.form, np.where(np.outer(movable, movable), curvature, 0.0))
    return free & movable, tuple(h for h in held if movable[problem.form.names.index(h.name)])


def _solve_robustly(
    problem: Problem,
    free: NDArray,
    covariance: Array,
    training: Array,
    start: ArmModel,
    solver: Solver,
    freedom: float | None,
    max_steps: int,
) -> _Fits:
    """Alternates the solve with the estimate of the noise's scale until that settles."""
    whitener, used = whitener_of(covariance), training > 0

    def scales(solved: _Solved) -> Array:
        return np.array(
            [t_scale(squares[rows], problem.rows, freedom) for squares, rows in zip(solved.squares, used, strict=True)]
        )

    if freedom is None:
        solved = _solve(problem, free, whitener, training, None, start, solver, max_steps)
        return _Fits(solved, scales(solved))
    scale = scales(_solve(problem, free, whitener, training, None, start, "gauss_newton", 0))
    steps, rounds = 0, 0
    while True:
        robust = Robust(np.full(len(scale), freedom), scale)  # type: ignore[arg-type]
        solved = _solve(problem, free, whitener, training, robust, start, solver, max_steps)
        start, steps, before, scale = solved.model, steps + solved.steps, scale, scales(solved)
        rounds += 1
        if rounds == _ROUNDS or (np.abs(scale / before - 1) < _SCALE_SETTLED).all():
            return _Fits(solved._replace(steps=steps), scale)


def _spreads(fitted: Errors) -> tuple[float, float | None]:
    """Robust standard deviations per axis of position (m) and orientation (rad) errors; not below rounding."""
    unit = gaussian_t_scale(POSITION, FREEDOM)
    position = max(t_scale(fitted.position**2, POSITION, FREEDOM) / unit, ROUNDING)
    if fitted.orientation is None:
        return position, None
    return position, max(t_scale(fitted.orientation**2, POSITION, FREEDOM) / unit, ROUNDING)


def _excess(problem: Problem, declared: Array, residual: Errors) -> Array:
    """Variance per axis of position and orientation by which residuals exceed the declared noise, if clearly so."""
    variances = np.diagonal(declared, axis1=-2, axis2=-1).reshape(-1, problem.rows)
    expected = variances.reshape(len(variances), -1, 3).mean((0, 2))
    found = np.square([spread for spread in _spreads(residual) if spread is not None])
    return np.where(found > _EXCESS * expected, found - expected, 0.0)


def _covariance(problem: Problem, free: NDArray, fits: _Fits, used: NDArray, freedom: float | None) -> Array:
    """The covariance of the entries of a step; the prior's precision is added to the data's information."""
    rows, scale = problem.rows, fits.scale[0]
    prior = np.diag(problem.precision * free)
    information = (np.asarray(fits.solved.curvature[0]) - prior) * np.outer(free, free)
    numbers, fitted = int(used.sum()) * rows, int(free.sum())
    if freedom is None:
        factor = scale**2 * numbers / max(numbers - fitted, 1)
    else:
        factor = variance_factor(fits.solved.squares[0][used] / scale**2, rows, freedom, fitted)
    covariance = np.zeros_like(prior)
    if free.any():
        covariance[np.ix_(free, free)] = np.linalg.inv((information / factor + prior)[np.ix_(free, free)])
    return covariance
