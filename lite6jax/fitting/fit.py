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
from lite6jax.arms.factory import FactoryCalibration, read_factory, recognise
from lite6jax.arms.files import read_arm
from lite6jax.arms.se3 import rotation_log
from lite6jax.errors import InputError
from lite6jax.fitting.fleet import MAX_STEPS, fit_chunks, observe, pad, padded_size, sample_within_limits
from lite6jax.fitting.gauge import determined
from lite6jax.fitting.gauss_newton import Prior, inverse
from lite6jax.fitting.problem import Geometry, Problem, calibration_poses, calibration_problem, recording_problem
from lite6jax.fitting.residual import Observations, Robust, linearise, over_blocks
from lite6jax.fitting.solution import Errors, Held, Result, Solution
from lite6jax.model import ArmModel, ModelForm, predict
from lite6jax.recordings import Recording, read_recording

Array = NDArray[np.float64]
Solver = Literal["gauss_newton", "levenberg_marquardt"]
Loss = Literal["student_t", "least_squares"]

FREEDOM = 15.0
"""Degrees of freedom of the robust loss: 97 % efficient on Gaussian noise, and blind to samples ten sigma off."""
SAMPLES = 300
CHECK_SAMPLES = 1000
FOLDS = 5
_ROUNDS = 30
_SCALE_SETTLED = 1e-3


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
        solver: `gauss_newton` is the fast one, `levenberg_marquardt` optimistix'; they agree to 1e-12.
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
        known = recognise(kinematics, [f"joint{i + 1}" for i in range(len(kinematics))], "calibration", arm)
        source = FactoryCalibration(kinematics, known, known.T_joint_flange, "array")
    return fit_calibration(source, solver=solver, samples=samples, seed=seed, max_steps=max_steps)


def load_nominal(nominal: Arm | str | None) -> Arm | None:
    """An arm by name, or as it is."""
    return read_arm(nominal) if isinstance(nominal, str) else nominal


def read_source(path: str | Path, arm: Arm | None) -> FactoryCalibration | Recording:
    """A calibration or a recording, by the file's suffix.

    Raises:
        InputError: as their readers.
    """
    if Path(path).suffix.lower() not in (".csv", ".parquet"):
        return read_factory(path, arm)
    recording = read_recording(path)
    arm = arm or read_arm(recording.settings.arm_reference(Path(path).parent))
    return read_recording(path, dof=arm.dof, joint_limits=arm.joint_limits, reach=arm.reach)


def fit_calibration(
    calibration: FactoryCalibration,
    *,
    solver: Solver = "gauss_newton",
    samples: int = SAMPLES,
    seed: int = 0,
    max_steps: int = MAX_STEPS,
) -> Solution:
    """The Hayati model that reproduces a calibration; `checked` on 1000 fresh samples. See `fit`."""
    if samples * 6 < 4 * calibration.arm.dof + 4:
        raise InputError(f"samples {samples}: too few for {4 * calibration.arm.dof + 4} parameters; give at least 5")
    problem = calibration_problem(calibration, samples, seed)
    free = problem.movable
    solved = _solve(problem, free, np.ones((1, samples)), Robust(np.inf, np.ones(1)), problem.start, solver, max_steps)  # type: ignore[arg-type]
    model = jax.tree.map(lambda leaf: leaf[0], solved.model)
    fresh = sample_within_limits(problem.arm, CHECK_SAMPLES, seed + 1)
    truth = calibration_poses(calibration, fresh)
    return Solution(
        arm=problem.arm,
        form=problem.form,
        model=model,
        result=Result(int(solved.status[0])),
        steps=int(solved.steps[0]),
        covariance=None,
        free=free,
        held=(),
        errors=errors(problem.form, model, problem.joint_position, problem.pose),
        nominal_errors=errors(problem.form, problem.start, fresh, truth),
        checked=errors(problem.form, model, fresh, truth),
        noise_scale=None,
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
    """The fit of a recording; `checked` on contiguous fifths, each predicted by a fit of the other four. See `fit`."""
    problem = recording_problem(recording, nominal, geometry)
    free, held = _determined(problem)
    fittable = int(free.sum())
    given = recording.samples * problem.rows
    if given - given // FOLDS <= fittable and fittable:
        need = -(-fittable * FOLDS // (problem.rows * (FOLDS - 1))) + 1
        raise InputError(
            f"{recording.source}: {recording.samples} samples give {given} numbers, too few to fit {fittable} parameters "
            f"and hold a fifth back; record at least {need} samples"
        )
    training = np.ones((FOLDS + 1, recording.samples))
    for k, fold in enumerate(recording.contiguous_folds(FOLDS)):
        training[k + 1, fold] = 0.0
    fits = _solve_robustly(problem, free, training, loss, solver, max_steps)
    frames_only = free.copy()
    frames_only[: problem.form.chain.size] = False
    nominal_fit = _solve_robustly(problem, frames_only, training[:1], loss, "gauss_newton", max_steps)

    model = fits.model(0)
    held_out = [errors(problem.form, fits.model(k), problem.joint_position, problem.pose) for k in range(1, FOLDS + 1)]
    fold_of = np.argmin(training[1:], 0)
    rows = np.arange(recording.samples)
    checked = Errors(
        np.stack([e.position for e in held_out])[fold_of, rows],
        None if held_out[0].orientation is None else np.stack([e.orientation for e in held_out])[fold_of, rows],  # type: ignore[arg-type]
        problem.joint_position,
    )
    return Solution(
        arm=problem.arm,
        form=problem.form,
        model=model,
        result=Result(int(fits.status[0])),
        steps=int(fits.steps[0]),
        covariance=fits.covariance,
        free=free,
        held=held,
        errors=errors(problem.form, model, problem.joint_position, problem.pose),
        nominal_errors=errors(problem.form, nominal_fit.model(0), problem.joint_position, problem.pose),
        checked=checked,
        noise_scale=float(fits.noise_scale[0]) if problem.declared else None,
        weight=fits.weight,
        notes=problem.notes,
    )


def errors(form: ModelForm, model: ArmModel, joint_position: Array, pose: Array) -> Errors:
    """Distances (m) and angles (rad) between a model's prediction and poses `(sample, 4, 4)` or positions `(sample, 3)`."""
    predicted = np.asarray(predict(form.chain, model, joint_position))
    if pose.ndim == 2:
        return Errors(np.linalg.norm(predicted[:, :3, 3] - pose, axis=1), None, joint_position)
    relative = np.swapaxes(pose[:, :3, :3], 1, 2) @ predicted[:, :3, :3]
    angle = np.linalg.norm(np.asarray(rotation_log(relative)), axis=1)
    return Errors(np.linalg.norm(predicted[:, :3, 3] - pose[:, :3, 3], axis=1), angle, joint_position)


class _Solved(NamedTuple):
    """Solutions of one problem for several choices of samples; the choice is the first axis."""

    model: ArmModel
    curvature: Array
    squares: Array
    status: Array
    steps: Array


def _solve(
    problem: Problem, free: NDArray, weight: Array, robust: Robust, start: ArmModel, solver: Solver, max_steps: int
) -> _Solved:
    """Solves for each row of weights `(choice, sample)`; `start` may have the choice axis."""
    prior = Prior(np.asarray(problem.start.geometry), problem.precision, free.astype(float))  # type: ignore[arg-type]
    choices, samples = weight.shape
    if solver == "levenberg_marquardt":
        return _solve_by_record(problem, prior, weight, robust, start, max_steps)
    whitener = problem.whitener
    if whitener.ndim == 3:
        whitener = np.broadcast_to(whitener, (choices, *whitener.shape))
    summary = fit_chunks(
        problem.form,
        start,
        problem.joint_position,
        np.broadcast_to(problem.pose, (choices, *problem.pose.shape)),
        weight,
        whitener,
        robust,
        prior,
        chunk=1,
        max_steps=max_steps,
    )
    solved = summary.solved
    return _Solved(solved.model, solved.curvature, summary.squares, solved.status, solved.steps)  # type: ignore[arg-type]


def _solve_by_record(
    problem: Problem, prior: Prior, weight: Array, robust: Robust, start: ArmModel, max_steps: int
) -> _Solved:
    from lite6jax.fitting.levenberg_marquardt import solve_one  # optimistix takes 0.3 s to import
    from lite6jax.fitting.residual import residuals

    parts = []
    for k, row in enumerate(weight):
        observed = _observed(problem, row)
        begin = jax.tree.map(lambda leaf, whole: jnp.asarray(leaf[k] if leaf.ndim > np.ndim(whole) else leaf), start, problem.start)
        loss = Robust(jnp.asarray(robust.freedom, float), jnp.asarray(robust.scale)[k])
        solved = solve_one(problem.form, begin, observed, loss, jax.tree.map(jnp.asarray, prior), max_steps)
        everything = _observed(problem, np.ones_like(row))
        rows = jax.lax.map(lambda block, model=solved.model: residuals(problem.form, model, block), everything)
        squares = np.asarray(jnp.sum(rows**2, 1)).reshape(-1)[: len(row)] * (row > 0)
        parts.append(_Solved(solved.model, solved.curvature, squares, solved.status, solved.steps))  # type: ignore[arg-type]
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves]), *parts)


def _observed(problem: Problem, weight: Array) -> Observations:
    size, block = padded_size(len(weight))
    whitener = problem.whitener if problem.whitener.ndim == 1 else pad(problem.whitener, 0, size)
    data = (pad(problem.joint_position, 0, size), pad(problem.pose, 0, size), pad(weight, 0, size), whitener)
    return observe(*map(jnp.asarray, data), block)


def _determined(problem: Problem) -> tuple[NDArray[np.bool_], tuple[Held, ...]]:
    """What the data determines, among what the fit is asked to move."""
    if not problem.movable.any():
        return problem.movable, ()
    observed = _observed(problem, np.ones(len(problem.joint_position)))
    H = np.asarray(_curvature(problem.form, problem.start, observed))
    if not np.isfinite(H).all():
        raise InputError("the data holds numbers too large to work with; check the units of positions and joints")
    free, held = determined(problem.form, np.where(problem.movable, H, 0.0) * problem.movable[:, None] + np.diag(problem.precision))
    return free & problem.movable, tuple(h for h in held if problem.movable[problem.form.names.index(h.name)])


@partial(jax.jit, static_argnums=0)
def _curvature(form: ModelForm, model: ArmModel, observed: Observations) -> jax.Array:
    least_squares = Robust(jnp.asarray(jnp.inf), jnp.asarray(1.0))
    return over_blocks(partial(linearise, form, model, robust=least_squares), observed)[2]


class _Fits(NamedTuple):
    solved: _Solved
    noise_scale: Array
    weight: Array
    covariance: Array

    def model(self, choice: int) -> ArmModel:
        return jax.tree.map(lambda leaf: np.asarray(leaf[choice]), self.solved.model)

    @property
    def status(self) -> Array:
        return self.solved.status

    @property
    def steps(self) -> Array:
        return self.solved.steps


def _solve_robustly(
    problem: Problem, free: NDArray, training: Array, loss: Loss, solver: Solver, max_steps: int
) -> _Fits:
    """Alternates the solve with the estimate of the noise's scale until that settles.

    The scale is the maximum-likelihood one of Student's t, found by its fixed point c² = mean(w s) / rows
    (K. Lange, R. Little, J. Taylor, J. Am. Stat. Assoc. 84, 1989), and is reported as that of Gaussian noise.
    """
    freedom = FREEDOM if loss == "student_t" else np.inf
    choices, rows = len(training), problem.rows
    scale = _first_scale(problem, training, freedom)
    start, steps = problem.start, np.zeros(choices, int)
    used = training > 0
    for _ in range(_ROUNDS if np.isfinite(freedom) else 1):
        robust = Robust(freedom, scale)  # type: ignore[arg-type]
        solved = _solve(problem, free, training, robust, start, solver, max_steps)
        steps = steps + solved.steps
        start = ArmModel(*(np.asarray(leaf) for leaf in solved.model))  # type: ignore[arg-type]
        new = np.array([t_scale(solved.squares[k][used[k]], rows, freedom) for k in range(choices)])
        settled = np.abs(new / scale - 1) < _SCALE_SETTLED
        scale = new
        if settled.all():
            break
    weight, covariance = _certainty(problem, free, solved, used[0], scale[0], freedom)
    return _Fits(solved._replace(steps=steps), scale / gaussian_t_scale(rows, freedom), weight, covariance)


def _first_scale(problem: Problem, training: Array, freedom: float) -> Array:
    if np.isinf(freedom):
        return np.ones(len(training))
    nothing_moves = np.zeros(problem.form.size, bool)
    solved = _solve(problem, nothing_moves, training[:1], Robust(np.inf, np.ones(1)), problem.start, "gauss_newton", 1)  # type: ignore[arg-type]
    scale = np.sqrt(max(float(np.median(solved.squares[0])) / problem.rows, 1e-6))
    return np.full(len(training), scale)


def t_scale(squares: Array, rows: int, freedom: float) -> float:
    """The scale of Student's t with `freedom` that best explains squared whitened residuals of `rows` numbers each."""
    if np.isinf(freedom):
        return float(np.sqrt(max(np.mean(squares) / rows, 1e-24)))
    scale2 = max(float(np.median(squares)) / rows, 1e-12)
    for _ in range(200):
        new = float(np.mean((freedom + rows) / (freedom + squares / scale2) * squares)) / rows
        done = abs(new / scale2 - 1) < 1e-9
        scale2 = max(new, 1e-12)
        if done:
            break
    return float(np.sqrt(scale2))


def gaussian_t_scale(rows: int, freedom: float) -> float:
    """What `t_scale` finds on Gaussian noise of unit size, by integration over its χ² distribution."""
    if np.isinf(freedom):
        return 1.0
    s = np.linspace(0, 80, 20001)[1:]
    density = s ** (rows / 2 - 1) * np.exp(-s / 2)
    density /= density.sum()
    scale2 = 1.0
    for _ in range(200):
        scale2 = float(density @ ((freedom + rows) / (freedom + s / scale2) * s)) / rows
    return float(np.sqrt(scale2))


def _certainty(
    problem: Problem, free: NDArray, solved: _Solved, used: NDArray, scale: float, freedom: float
) -> tuple[Array, Array]:
    """Each sample's weight in 0…1, and the covariance of the entries of a step.

    An M-estimator's covariance in a regression is (JᵀJ)⁻¹ c² E[ψ²]/E[ψ′]² (P. Huber, Robust Statistics, 1981, 7.6),
    here with the expectations over the samples; the prior's precision is added to the information.
    """
    rows = problem.rows
    u = solved.squares[0][used] / scale**2
    if np.isinf(freedom):
        w, slope = np.ones_like(u), np.zeros_like(u)
    else:
        w = (freedom + rows) / (freedom + u)
        slope = -w / (freedom + u)
    psi2, psi_prime = np.mean(w**2 * u) / rows, np.mean(w + 2 * slope * u / rows)
    information = np.asarray(solved.curvature[0]) - np.diag(problem.precision * free)
    factor = psi2 / psi_prime**2 * np.mean(w) if problem.noisy else 1.0
    if np.isinf(freedom):  # the solve was with the declared noise
        factor = np.sum(u) * scale**2 / max(u.size * rows - int(free.sum()), 1)
    kept = information / max(factor, 1e-300) * np.outer(free, free) + np.diag(problem.precision * free + ~free)
    weight = np.ones(len(used))
    weight[used] = np.minimum(w / max(float(np.max(w, initial=0.0)), 1e-300), 1.0)
    return weight, np.asarray(inverse(jnp.asarray(kept))) * np.outer(free, free)
