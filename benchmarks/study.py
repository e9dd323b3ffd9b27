"""What poses determine, which model of a chain is exact, and the regressor of torques: the library beside others."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import jax
import numpy as np
import pinocchio

from benchmarks.fits import NOISE, by_minpack, simulated_arms
from benchmarks.measure import AGREES, OURS, Record, disagreement, median_time, time_call
from benchmarks.seed_way import LEVER, NOMINAL, sample_joints
from lite6jax.arms import dynamics
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.description import load_bundled
from lite6jax.calibration.quality import CONVERGED
from lite6jax.calibration.solve import FitConditions, fit_chunks
from lite6jax.design.information import TOLERANCE, Experiment, plan_experiment
from lite6jax.design.poses import Criterion, Design, Pool, choose
from lite6jax.model import ModelForm, arm_model
from lite6jax.sensors.usual import plan_sensor
from tests.oracles.arms import parameters_of_table, table_of_parameters
from tests.oracles.chains import hayati_poses, seed_poses, six_parameter_poses
from tests.oracles.pinocchio_dynamics import pinocchio_model, pinocchio_regressor

pin: Any = pinocchio  # a compiled module, which a type checker cannot look into

STEP = 1e-6  # m and rad of the rival's forward differences
DIFFERENCES = 1e-4  # how near forward differences come to a derivative, relative
EXACT = 1e-13  # m: the 1e-10 mm to which the whole model reproduces a calibration
SAME = 1e-9  # m: position errors nearer than this are the same
WITHIN = 1e-10  # n·m per unit of a parameter


# ------------------------------------------------------------------ information and choice of poses


def study(poses: int = 100_000, chosen: int = 40) -> Iterator[Record]:
    """Milliseconds for information and singular values, seconds for a D-optimal design, and the same by NumPy."""
    experiment = plan_experiment("lite6", plan_sensor("pose", *NOISE), frame=False)
    q = sample_joints(poses, np.random.default_rng(0))
    yield from _information(experiment, q)
    yield from _design(experiment, q, chosen)


def _information(experiment: Experiment, q: np.ndarray) -> Iterator[Record]:
    work, rival = f"information and singular values of {len(q)} poses", "NumPy, finite differences"

    def ours() -> np.ndarray:
        return np.linalg.svd(experiment.root(q), compute_uv=False)

    ours()
    seconds, answer = median_time(ours, 5)
    taken, theirs = time_call(lambda: np.linalg.svd(np.linalg.qr(plain_rows(q), mode="r"), compute_uv=False))
    wrong = disagreement(answer / theirs, 1.0, DIFFERENCES, "singular values")
    yield Record(work, OURS, "time", 1e3 * seconds, "ms", wrong)
    yield Record(work, rival, "time", 1e3 * taken, "ms")
    yield Record(work, OURS, f"faster than {rival}", taken / seconds, "×", wrong)


def _design(experiment: Experiment, q: np.ndarray, count: int) -> Iterator[Record]:
    rows = experiment.rows(q)
    work, rival = f"D-optimal {count} of {len(q)} poses", "NumPy, exchange over all candidates"

    def ours_of() -> Design:
        pool = Pool(rows)
        return choose(pool, count, pool.apply(Criterion()))

    ours_of()
    seconds, design = median_time(ours_of, 3)
    taken, others = time_call(lambda: plain_exchange(rows, count))
    ours, theirs = log_determinant(rows[design.indices]), log_determinant(rows[others])
    wrong = ""
    if ours < theirs - 0.01 * rows.shape[2]:  # 1 % of the poses
        wrong = f"log det {ours:.4f} is under the rival's {theirs:.4f}"
    yield Record(work, OURS, "time", seconds, "s", wrong)
    yield Record(work, rival, "time", taken, "s")
    yield Record(work, OURS, f"faster than {rival}", taken / seconds, "×", wrong)


def plain_rows(q: np.ndarray) -> np.ndarray:
    """The same scaled, whitened Jacobian `(6 sample, 28)` by forward differences of the plain chain."""
    at = seed_poses(NOMINAL, q)
    units = np.array([TOLERANCE[unit] for unit in plan_experiment("lite6", frame=False).form.units])
    columns = []
    for step in STEP * np.eye(len(NOMINAL)):
        moved = seed_poses(NOMINAL + step, q)
        turned = moved[:, :3, :3] @ np.swapaxes(at[:, :3, :3], 1, 2)
        spin = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], 1)
        columns.append(np.concatenate([(moved - at)[:, :3, 3] / NOISE[0], spin / NOISE[1]], 1).ravel() / STEP)
    return np.stack(columns, 1) * units


def log_determinant(rows: np.ndarray) -> float:
    """Of the information of poses `(pose, row, parameter)`."""
    J = rows.reshape(-1, rows.shape[2])
    return float(np.linalg.slogdet(J.T @ J)[1])


def plain_exchange(rows: np.ndarray, count: int) -> np.ndarray:
    """D-optimal poses `(count,)` by the textbook: greedy, then one round of exchange, each over all candidates.

    Adding a pose multiplies the determinant by det(I + J M⁻¹ Jᵀ) (V. Fedorov, 1972).
    """

    def best(M: np.ndarray, taken: list[int]) -> int:
        inside = rows @ np.linalg.inv(M) @ np.swapaxes(rows, 1, 2)
        gain = np.linalg.slogdet(np.eye(rows.shape[1]) + inside)[1]
        gain[taken] = -np.inf
        return int(np.argmax(gain))

    chosen: list[int] = []
    M = 1e-6 * np.eye(rows.shape[2])
    for _ in range(count):
        chosen.append(best(M, chosen))
        M = M + rows[chosen[-1]].T @ rows[chosen[-1]]
    for k in range(count):
        without = M - rows[chosen[k]].T @ rows[chosen[k]]
        chosen[k] = best(without, chosen[:k] + chosen[k + 1 :])
        M = without + rows[chosen[k]].T @ rows[chosen[k]]
    return np.array(chosen)


# ------------------------------------------------------------------ models of a chain


def models(arms: int = 200, samples: int = 300, fresh: int = 1000) -> Iterator[Record]:
    """The seed's comparison as a 2 × 2 table, {base or not} × {Hayati or not}: errors of each arm, mm, and condition.

    All four are fitted by least squares from nominal to noise-free samples of each arm's six-parameter chain, with one
    solver, MINPACK's Levenberg–Marquardt with the exact Jacobian: the plain table's is singular at nominal, where axes
    2 and 3 are parallel. The library's own solver is to find as good a fit wherever it says that it converged.
    """
    kinematics = simulated_arms(arms, seed=6)
    rng = np.random.default_rng(7)
    sampled, checked = sample_joints(samples, rng), sample_joints(fresh, rng)
    pose = np.array([six_parameter_poses(arm, sampled) for arm in kinematics])
    truth = np.array([six_parameter_poses(arm, checked)[:, :3, 3] for arm in kinematics])
    lite6 = load_bundled("lite6")

    def error(form: HayatiForm, parameters: np.ndarray) -> np.ndarray:
        """Each arm's largest position error, m."""
        predicted = []
        for base, table, beta in (table_of_parameters(form, row) for row in parameters):
            betas = dict(zip(form.parallel, beta, strict=True))
            predicted.append(hayati_poses(base, table, betas, checked)[:, :3, 3])
        return np.linalg.norm(np.array(predicted) - truth, axis=2).max(1)

    def errors(subject: str, error: np.ndarray, wrong: str) -> Iterator[Record]:
        for name, value in (("median", np.median(error)), ("p95", np.quantile(error, 0.95)), ("most", error.max())):
            yield Record("models", subject, f"position error, {name}", float(1e3 * value), "mm", wrong)

    yield from errors("nominal", error(lite6.form, np.broadcast_to(lite6.hayati, (arms, 28))), "")
    for hayati in (False, True):
        form = lite6.form if hayati else HayatiForm(6)
        start = lite6.hayati if hayati else np.asarray(parameters_of_table(form, np.zeros(4), lite6.dh))  # pyright: ignore
        for base in (False, True):
            subject = f"{'base' if base else 'no base'}, {'Hayati' if hayati else 'plain DH'}"
            free, parameters, condition = np.arange(0 if base else 4, form.size), [], []
            for target in pose:
                found, J = by_minpack(ModelForm(form), start, free, sampled, target, (1.0, LEVER), 1e-15)
                values = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
                parameters.append(found)
                condition.append(values[0] / values[-1])
            reached = error(form, np.array(parameters))
            whole = ModelForm(form)
            movable = np.isin(np.arange(whole.size), free).astype(float)
            scale, weight = np.array([1.0, LEVER]), np.ones(pose.shape[:2])
            known = FitConditions(movable, start, np.zeros(whole.size))
            own = fit_chunks(whole, arm_model(start), sampled, pose, weight, scale, prior=known)
            geometry = np.asarray(own.model.geometry)
            worse = np.where(np.asarray(own.status) == CONVERGED, error(form, geometry) - reached, 0.0)
            wrong = disagreement(reached, 0.0, EXACT, "positions (m)") if base and hayati else ""
            wrong = wrong or disagreement(np.maximum(worse, 0.0), 0.0, SAME, "what the library calls right (m)")
            if hayati:
                same = disagreement(geometry, np.array(parameters), AGREES, "the library's parameters (m, rad)")
                wrong = wrong or same
            yield from errors(subject, reached, wrong)
            yield Record("models", subject, "condition, median", float(np.median(condition)), "", wrong)


# ------------------------------------------------------------------ the regressor of torques


def regressor(samples: int = 100_000, repeats: int = 5) -> Iterator[Record]:
    """Median seconds of the regressor of inverse dynamics of a 6R arm and of Pinocchio's, called sample by sample."""
    arm, gravity = load_bundled("lite6"), np.array([0.0, 0.0, -9.81])
    rng = np.random.default_rng(6)
    lower, upper = arm.joint_limits.T[:, :, None]
    q = rng.uniform(lower, upper, (arm.dof, samples))
    dq, ddq = rng.normal(0, 1, (2, arm.dof, samples))
    model = pinocchio_model(arm.kinematics, arm.mass, arm.center_of_mass, arm.inertia, gravity)

    def ours() -> Any:
        return jax.block_until_ready(dynamics.regressor(arm.kinematics, q, dq, ddq, gravity))

    matrix = ours()
    reference = pinocchio_regressor(model, *(part[:, :1000] for part in (q, dq, ddq)))
    wrong = disagreement(np.asarray(matrix[:, :, :1000]), reference, WITHIN, "the regressor")
    work, rival = f"regressor, {samples} samples", "Pinocchio, a loop"
    seconds, _ = median_time(ours, repeats)
    loop, _ = median_time(partial(pinocchio_loop, model, q, dq, ddq), max(1, repeats // 2))
    yield Record(work, OURS, "wall time", seconds, "s", wrong)
    yield Record(work, rival, "wall time", loop, "s")
    yield Record(work, OURS, "of Pinocchio's loop", seconds / loop, "×", wrong)


def pinocchio_loop(model: Any, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """(sample, joint, 10 × joint) as Pinocchio has them; it also stores what it computes."""
    data, joints, samples = model.createData(), *q.shape
    rows = [np.ascontiguousarray(part.T) for part in (q, dq, ddq)]
    stored = np.empty((samples, joints, 10 * joints))
    for k in range(samples):
        stored[k] = pin.computeJointTorqueRegressor(model, data, rows[0][k], rows[1][k], rows[2][k])
    return stored
