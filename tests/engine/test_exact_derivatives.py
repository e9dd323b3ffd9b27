"""Refits by exact derivatives: as sure as SciPy's own least squares, where derivatives at the start are not."""

import numpy as np
import pytest
from diagnosis.recorded import Made, fitted_to, static_motion, truth
from scipy.optimize import least_squares

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.robust import FREEDOM, variance_factor
from lite6jax.estimation.terms import Terms

TEXT = "link_compliance:link=3,compliance_x_rad_per_Nm=2e-3,compliance_y_rad_per_Nm=1e-3"
PHYSICS = Terms((truth(TEXT)[0],))


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A link that gives way by many milliradians, in an arm whose geometry nobody knows."""
    case = pose_problem(Made(tmp_path_factory.mktemp("arm"), (TEXT,), 2, "free").recording(static_motion(5, 120)))
    for _ in range(3):
        case = case.relinearised(fitted_to(case, Terms()).nuisance)
    return case


def deviations_by_scipy(case, fitted):
    """Of all numbers, from the information in rows weighed as the fit weighs them."""
    k = len(case.unknown)
    weight = np.sqrt(fitted.residuals.weight[0]) / fitted.scale[0]
    root = np.sqrt(case.precision)

    def rows(x):
        left = case.residual(x[:k], PHYSICS, x[k:]) * weight
        return np.concatenate([left.ravel(), root * (case.offset + x[:k])])

    at = np.concatenate([fitted.nuisance, fitted.values])
    scale = np.concatenate([np.full(k, 1e-4), PHYSICS.typical])
    J = least_squares(rows, at, jac="3-point", x_scale=scale, max_nfev=1).jac
    norms = np.linalg.norm(J, axis=0)
    factor = variance_factor(fitted.residuals.squares, case.rows, FREEDOM, 0)
    return np.sqrt(np.diagonal(np.linalg.pinv((J / norms).T @ (J / norms)))) / norms * np.sqrt(factor)


def test_exact_deviations_are_scipys_and_hold_the_truth(case):
    fitted = fitted_to(case, PHYSICS)
    exact = fitted_to(case, PHYSICS, fitted.values, fitted.nuisance, exact=True)
    std = np.sqrt(np.diagonal(exact.covariance))
    np.testing.assert_allclose(std, deviations_by_scipy(case, exact)[-2:], rtol=1e-2)
    assert (np.abs(exact.values - [2e-3, 1e-3]) < 4 * std).all()
    # derivatives at the start see information that is not there
    assert (np.sqrt(np.diagonal(fitted.covariance)) < 0.8 * std).any()


def test_near_the_start_all_derivatives_are_exact(tmp_path):
    text = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"
    terms = Terms((truth(text)[0],))
    known = pose_problem(Made(tmp_path, (text,), seed=1, frame=True).recording(static_motion(5, 80)))
    fitted = fitted_to(known, terms)
    exact = fitted_to(known, terms, fitted.values, fitted.nuisance, exact=True)
    np.testing.assert_allclose(exact.values, fitted.values, rtol=1e-3)
    np.testing.assert_allclose(exact.covariance, fitted.covariance, rtol=5e-3)


def test_what_a_frame_takes_up_stays_where_it_was(tmp_path):
    """The level of a base's turn is the sensor's frame: differences see along it no more than their own error."""
    text = "base_compliance:compliance_x_rad_per_Nm=1e-5,compliance_y_rad_per_Nm=3e-5"
    made = Made(tmp_path, (text,), seed=4, geometry="prior", frame=True, tool=True, orientation=False, inertial=0.1)
    case = pose_problem(made.recording(static_motion(5, 150)))
    moment = np.asarray(case.loads.base_moment[1])
    turn = Unnamed("base", "base moment y", float(moment.min()), float(moment.max()), component="ry", spread=1e-3)
    fitted = fitted_to(case, Terms((turn,)))
    exact = fitted_to(case, Terms((turn,)), fitted.values, fitted.nuisance, exact=True)
    assert np.abs(fitted.values).max() < 2e-3
    assert np.abs(exact.values - fitted.values).max() < 1e-3
    assert np.sqrt(np.diagonal(exact.covariance)).max() < 2e-3
