"""How uncertain a diagnosed model is: the covariance of all its numbers, what is left of it, where it was recorded."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.special import log_ndtr

from lite6jax.arms.arm import as_revolute
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.pose.kinematics import FRAMES, whitened
from lite6jax.domains.pose.predict import Derivatives, DiagnosedArm
from lite6jax.domains.pose.problem import ONCE_PER_TURN, PoseProblem
from lite6jax.domains.torque.predict import driver_values, link_sites, shown_torques, with_free_numbers
from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.domains.uncertainty import RecordedRange, Uncertainty, distance_to, freed
from lite6jax.effects.motion import in_another_recording
from lite6jax.estimation.least_squares import Fit
from lite6jax.estimation.problem import prior_precision
from lite6jax.estimation.projection import scaled_inverse
from lite6jax.estimation.robust import FREEDOM, variance_factor
from lite6jax.recordings.sequence import spread_rows

_ROWS = 200
"""Recorded rows that are kept to measure the distance from."""
_MOST = 2000
"""Rows of which the distance from the others is measured."""
_BLOCK = 2000
"""Rows of which products are formed at once: the derivatives of hundreds of numbers take half a gigabyte."""
_LEVEL = 0.95
_SQUARES = {1: 3.8415, 3: 7.8147}
"""Squared standard deviations within which that share of a normal distribution lies, by its number of axes."""


def uncertainty_of_poses(
    problem: PoseProblem, fit: Fit, model: DiagnosedArm, kept: Mask, after: Array, folds: Sequence[Mask]
) -> Uncertainty:
    """How uncertain predictions of poses are.

    The information of the fit is that of its weights, its noise model and its priors, with the derivatives
    that predictions use. What is left of the model is calibrated on held-out rows: with it, with the sensor's noise and
    with the uncertainty of the numbers, 95 % of their errors are as large as they are.

    Args:
        problem: that was fitted.
        fit: with all findings.
        model: with them; its own uncertainty is not used.
        kept: `(sample,)`, rows that are no outliers.
        after: `(sample,)` m, held-out errors of positions.
        folds: `(sample,)` each, the rows that were held out together.
    """
    sites = (*problem.frames, *problem.masses)
    change = Derivatives(model, problem.motion, sites)
    J = change.all()
    C = np.zeros((0, 0))
    if len(J):
        frames = len(problem.frames)
        masses = len(problem.masses)
        # by the sensor's own unknowns and by frame jumps: no prediction has them, but they are fitted beside
        beside = np.array([site[0] not in (*FRAMES, "wave", "mass", "payload") for site in problem.unknown], bool)
        moved = problem.frame_columns[beside[: len(problem.frame_columns)]]
        tool = problem.rigid.tool
        turned = np.einsum("sab,nbs->nas", tool[:, :3, :3], J[:, 3:])
        read = problem.measured.columns(tool, J[:, :3], turned)
        columns = np.concatenate([whitened(read, problem.measured.whitener), moved])
        effects = tuple(freed(effect) for effect in model.physics.effects)
        prior = prior_precision(problem, effects)
        nuisance_precision = problem.precision
        # what is no finding is within the tolerance of its joint
        no_finding = [effect not in fit.terms.terms for effect in model.physics.effects]
        prior[np.repeat(no_finding, [effect.size for effect in effects]).astype(bool)] = ONCE_PER_TURN**-2.0
        precision = np.concatenate(
            [
                nuisance_precision[:frames],
                nuisance_precision[len(nuisance_precision) - masses :],
                prior,
                nuisance_precision[beside],
            ]
        )
        C = _covariance(fit, problem.valid, columns, precision)[: len(J), : len(J)]
    estimated = _variance(J, C)
    model_error, unseen, noise = _left_of_poses(problem, fit, estimated, kept, after, len(folds))
    usable_rows = np.flatnonzero(kept) if kept.any() else np.arange(problem.samples)
    if any(driver.is_order for effect in model.physics.effects for driver in effect.drivers):
        # what wanders is as unknown in these postures as in any other recording
        estimated = Derivatives(model, in_another_recording(problem.motion), sites).variance(C)
    typical = np.sqrt([np.median(rows.mean(0)) for rows in np.split(estimated[:, usable_rows], 2)] + model_error**2)
    q = problem.recording.joint_position
    # of those that a model keeps, from which the distance is measured
    rows = usable_rows[spread_rows(len(usable_rows), _ROWS)]
    measured = usable_rows[spread_rows(len(usable_rows), _MOST)]
    recorded = RecordedRange(
        joints=np.stack([q[usable_rows].min(0), q[usable_rows].max(0)], 1),
        positions=np.round(q[rows], 5),
        spacing=_spacing(q, measured, rows, folds),
        drivers=_ranges(change.driver_values(), usable_rows),
    )
    usual = None
    if kept.any() and np.isfinite(typical).all() and typical.min() > 0:
        usual = typical
    return Uncertainty(sites, C, model_error, unseen, noise, recorded, usual)


def _left_of_poses(
    problem: PoseProblem, fit: Fit, estimated: Array, inliers: Mask, after: Array, folds: int
) -> tuple[Array, Array, Array]:
    """What is left per axis, what may be left unseen, and the noise; by variances `(6, sample)` of the prediction.

    The noise is the declared one, or less where the residuals are less: whatever they are more is left of the model.
    Numbers that are estimated without one of n blocks vary by n / (n - 1) more.
    """
    count = max(int(inliers.sum()), 1)
    scales = fit.scale[problem.groups[[0, -1]]]
    declared = [declared_std is not None for declared_std in problem.declared_noise]
    noise = np.where(declared, np.minimum(scales, 1.0), scales) * [problem.noise[0], problem.noise[1] or 0.0]
    rows = min(problem.rows, 3)
    squares = after[inliers] ** 2 / _SQUARES[rows]
    position = _excess(squares - folds / (folds - 1) * estimated[:3, inliers].mean(0), noise[0], rows * count)
    orientation = 0.0
    if problem.rows == 6 and problem.noise[1]:
        lost = max(1 - fit.parameters / max(problem.rows * count, 1), 0.1)
        turned = problem.noise[1] ** 2 * np.sum(fit.residuals.rows[3:, inliers] ** 2, 0) / lost
        lever = np.sqrt(np.mean(np.sum((problem.rigid.tool[:, :3, 3] - problem.rigid.frames[0, :, :3, 3]) ** 2, 1)))
        # an angle inside the arm that displaces the tool by what is left of positions turns it too
        orientation = max(_excess(turned / _SQUARES[3], noise[1], 3 * count), position / max(lever, 1e-3))
    model_error = np.array([position, orientation])
    return model_error, np.sqrt(_relative_error(3 * count) * (noise**2 + model_error**2)), noise


def uncertainty_of_torques(problem: TorqueProblem, fit: Fit, after: Array, folds: Sequence[Mask]) -> Uncertainty:
    """How uncertain predictions of torques are: as `uncertainty_of_poses`, of each joint.

    `after` are held-out errors `(joint, sample)` Nm.
    """
    terms, values = with_free_numbers(fit.terms, fit.values)
    prior = prior_precision(problem, terms.terms)
    columns = problem.nuisance_columns(fit.terms, fit.values)
    if terms.size:
        columns = np.concatenate([columns, problem.columns(terms.terms, values, (fit.terms, fit.values))])
    C = _covariance(fit, problem.valid, columns, np.concatenate([problem.precision, prior]))
    estimated = _variance(columns * problem.sigma, C)
    model_error, unseen, noise = _left_of_torques(problem, fit, estimated, after, len(folds))
    valid_samples = np.flatnonzero(problem.valid)
    at = problem.data.filter.kept[problem.chosen]
    dynamics = problem.data.bodies.dynamics(problem.links_at(fit.nuisance))
    states = problem.data.bodies.moved[..., at]
    ranges = np.stack([states[..., valid_samples].min(-1), states[..., valid_samples].max(-1)], -1)
    rows = valid_samples[spread_rows(len(valid_samples), _ROWS)]
    values_of = {phrase: recorded_values[at] for phrase, recorded_values in driver_values(fit.terms, dynamics).items()}
    recorded = RecordedRange(
        joints=ranges[0],
        positions=np.round(states[0].T[rows], 5),
        spacing=_spacing(as_revolute(states[0], "rad", problem.data.arm.slides).T, valid_samples, rows, folds),
        drivers=_ranges(values_of, valid_samples),
        velocities=ranges[1],
        accelerations=ranges[2],
    )
    sites = link_sites(problem.rows) if len(problem.directions) else ()
    return Uncertainty(sites, C, model_error, unseen, noise, recorded)


def _left_of_torques(
    problem: TorqueProblem, fit: Fit, estimated: Array, after: Array, folds: int
) -> tuple[Array, Array, Array]:
    """As `_left_of_poses`, `(joint,)` Nm each.

    Held-out errors are those of filtered torques. What the filter takes from a row is added: a prediction is not
    filtered.
    """
    valid = problem.valid
    data = problem.data
    dynamics = data.bodies.dynamics(problem.links_at(fit.nuisance))
    time = np.asarray(dynamics.motion.time)
    rough = shown_torques(fit.terms, fit.values, dynamics, time, data.filter.runs) - data.torque[:, data.rows]
    fine = (rough - data.filter.whole(rough))[:, data.filter.kept[problem.chosen]]
    squares = (after + fine)[:, valid] ** 2 / _SQUARES[1]
    noise = 1.4826 * np.median(np.abs(rough), axis=1)
    if problem.declared:
        noise = np.minimum(noise, problem.noise * np.sqrt(data.recorded.every))
    model_error, unseen = np.zeros((2, problem.rows))
    moving = problem.sigma[:, valid] <= 1.01 * problem.noise[:, None]  # not held at rest by friction
    for j in range(problem.rows):
        effective_count = moving[j].sum() / fit.noise.models[j].time
        model_error[j] = _excess(
            (squares[j] - folds / (folds - 1) * estimated[j, valid])[moving[j]], float(noise[j]), effective_count
        )
        unseen[j] = np.sqrt(_relative_error(effective_count) * (noise[j] ** 2 + model_error[j] ** 2))
    return model_error, unseen, noise


# ------------------------------------------------------------------ of both


def _covariance(fit: Fit, valid: Mask, columns: Array, precision: Array) -> Array:
    """The covariance `(number, number)` of fitted numbers: of the weights of a fit, its noise model and its priors.

    It is of the `valid` samples `(sample,)`, with the columns `(number, row, sample)`, derivatives of each row over its
    noise; the precision `(number,)` is one over the variance of the prior.
    """
    if not len(columns):
        return np.zeros((0, 0))
    used = fit.training & valid
    root = np.sqrt(np.where(used, fit.residuals.row_weight, 0.0))
    H = np.diag(np.asarray(precision, float))
    for row, row_root in enumerate(root):  # all at once would take half a gigabyte a copy of a real arm
        of_row = fit.noise.of_row(row).whitened(np.where(used, columns[:, [row]], 0.0))[:, 0] * row_root
        H += of_row @ of_row.T
    return scaled_inverse(H) * variance_factor(fit.residuals.squares[used], columns.shape[1], FREEDOM, 0)


def _variance(J: Array, covariance: Array) -> Array:
    """`(row, sample)`, of what has derivatives `(number, row, sample)` by numbers of a covariance."""
    blocks = np.split(J, range(_BLOCK, J.shape[2], _BLOCK), axis=2)
    return np.concatenate([np.sum(np.tensordot(covariance, block, 1) * block, 0) for block in blocks], 1)


def _relative_error(numbers: float) -> float:
    """The standard error of a variance, over the variance, from so many independent numbers."""
    return float(np.sqrt(2 / max(numbers, 1.0)))


def _excess(variance: Array, noise: float, numbers: float) -> float:
    """The standard deviation left beside the noise, so that 95 % of rows are within the variance `(row,)` they ask for.

    What the rows ask for is as uncertain as of so many independent `numbers`, and an excess is not negative: its mean
    given both (of a truncated normal distribution; N. Johnson, S. Kotz and N. Balakrishnan, Continuous Univariate
    Distributions, 1994, 13.10).
    """
    if not variance.size:
        return 0.0
    excess_variance = float(np.quantile(variance, _LEVEL)) - noise**2
    error = max(_relative_error(numbers) * (noise**2 + max(excess_variance, 0.0)), np.finfo(float).tiny)
    z = excess_variance / error
    return float(np.sqrt(error * max(z + np.exp(-0.5 * z**2 - log_ndtr(z)) / np.sqrt(2 * np.pi), 0.0)))


def _spacing(q: Array, rows: Integers, kept_rows: Integers, folds: Iterable[Mask]) -> float:
    """The distance in `q` `(sample, joint)` rad to the nearest kept row of other blocks that 95 % of rows keep, rad."""
    distances = []
    for fold in folds:
        fold_rows = rows[fold[rows]]
        other_rows = kept_rows[~fold[kept_rows]]
        if fold_rows.size and other_rows.size:
            distances.append(distance_to(q[other_rows], q[fold_rows]))
    if distances:
        return float(np.quantile(np.concatenate(distances), _LEVEL))
    return 0.0


def _ranges(drivers: Mapping[str, Any], rows: Integers) -> dict[str, tuple[float, float]]:
    """The least and the greatest value of each driver over some rows."""
    return {phrase: (float(values[rows].min()), float(values[rows].max())) for phrase, values in drivers.items()}
