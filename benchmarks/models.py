"""The seed's comparison of models as a 2 × 2 table, {base or not} × {Hayati or not}, over many simulated arms.

All four are fitted by least squares from nominal to 300 noise-free samples of each arm's six-parameter chain, with one
solver, MINPACK's Levenberg–Marquardt with the exact Jacobian: the plain table's is singular at nominal, where axes 2
and 3 are parallel. The library's own solver is to find as good a fit wherever it says that it converged.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.fits import by_minpack
from benchmarks.measure import AGREES, Record, disagreement
from benchmarks.problem import simulated_arms
from benchmarks.seed_way import LEVER, sample_joints
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.description import load_bundled
from lite6jax.calibration.quality import CONVERGED
from lite6jax.calibration.solve import Known, Solved, fit_chunks
from lite6jax.model import ModelForm, arm_model
from tests.oracles.arms import parameters_of_table, table_of_parameters
from tests.oracles.chains import hayati_poses, six_parameter_poses

TOLERANCE = 1e-15
EXACT = 1e-13
"""m: the 1e-10 mm to which the whole model reproduces a calibration."""
SAME = 1e-9
"""m: position errors nearer than this are the same."""


class Fits(NamedTuple):
    """One model's fits, a row an arm.

    Attributes:
        parameters: `(arm, 28)`, of the model's form.
        condition: of the Jacobian at the end, its columns scaled to one length.
    """

    parameters: np.ndarray
    condition: np.ndarray


def models(arms: int = 200, samples: int = 300, fresh: int = 1000) -> Iterator[Record]:
    """Errors over fresh samples, the largest of each arm, and the condition of the fit."""
    kinematics = simulated_arms(arms, seed=6)
    rng = np.random.default_rng(7)
    sampled, checked = sample_joints(samples, rng), sample_joints(fresh, rng)
    pose = np.array([six_parameter_poses(arm, sampled) for arm in kinematics])
    truth = np.array([six_parameter_poses(arm, checked)[:, :3, 3] for arm in kinematics])
    lite6 = load_bundled("lite6")

    def error(form: HayatiForm, parameters: np.ndarray) -> np.ndarray:
        """Each arm's largest position error, m."""
        predicted = np.array([_positions(form, row, checked) for row in parameters])
        return np.linalg.norm(predicted - truth, axis=2).max(1)

    nominal = error(lite6.form, np.broadcast_to(lite6.hayati, (arms, 28)))
    yield from _spread("nominal", nominal, "")
    for hayati in (False, True):
        form = lite6.form if hayati else HayatiForm(6)
        start = lite6.hayati if hayati else np.asarray(parameters_of_table(form, np.zeros(4), lite6.dh))  # pyright: ignore
        for base in (False, True):
            subject = f"{'base' if base else 'no base'}, {'Hayati' if hayati else 'plain DH'}"
            free = np.arange(0 if base else 4, form.size)
            fits = _fit(form, start, free, sampled, pose)
            reached = error(form, fits.parameters)
            wrong = ""
            if base and hayati:
                wrong = disagreement(reached, np.zeros(()), EXACT, "positions (m)")
            own = _library(form, start, free, sampled, pose)
            settled = np.asarray(own.status) == CONVERGED
            worse = np.where(settled, error(form, np.asarray(own.model.geometry)) - reached, 0.0)
            wrong = wrong or disagreement(
                np.maximum(worse, 0.0), np.zeros(()), SAME, "what the library calls right (m)"
            )
            if hayati:
                wrong = wrong or disagreement(
                    np.asarray(own.model.geometry), fits.parameters, AGREES, "the library's parameters (m, rad)"
                )
            yield from _spread(subject, reached, wrong)
            yield Record("models", subject, "condition, median", float(np.median(fits.condition)), "", "lower", wrong)


def _spread(subject: str, error: np.ndarray, wrong: str) -> Iterator[Record]:
    for name, value in (("median", np.median(error)), ("p95", np.quantile(error, 0.95)), ("most", error.max())):
        yield Record("models", subject, f"position error, {name}", float(1e3 * value), "mm", "lower", wrong)


def _fit(chain: HayatiForm, start: np.ndarray, free: np.ndarray, q: np.ndarray, pose: np.ndarray) -> Fits:
    rows = []
    for target in pose:
        parameters, J = by_minpack(ModelForm(chain), start, free, q, target, (1.0, LEVER), TOLERANCE)
        values = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
        rows.append((parameters, values[0] / values[-1]))
    return Fits(*(np.array(column) for column in zip(*rows, strict=True)))


def _library(chain: HayatiForm, start: np.ndarray, free: np.ndarray, q: np.ndarray, pose: np.ndarray) -> Solved:
    """The same fits by the library's own solver."""
    form = ModelForm(chain)
    movable = np.isin(np.arange(form.size), free).astype(float)
    scale, weight = np.array([1.0, LEVER]), np.ones(pose.shape[:2])
    known = Known(movable, start, np.zeros(form.size))
    return fit_chunks(form, arm_model(start), q, pose, weight, scale, known=known).solved


def _positions(form: HayatiForm, parameters: np.ndarray, joint_position: np.ndarray) -> np.ndarray:
    """Flange positions `(sample, 3)` in plain NumPy."""
    base, table, beta = table_of_parameters(form, parameters)
    betas = dict(zip(form.parallel, beta, strict=True))
    return hayati_poses(base, table, betas, joint_position)[:, :3, 3]
