"""Evidence against marginal likelihoods of multivariate normal distributions, by plain determinants and solutions."""

import numpy as np
import pytest
from diagnosis.recorded import OPTIONS, Made, fitted_to, static_motion

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.kernels import SCALED, kernel_of, spline_basis
from lite6jax.effects.kinematic import JointOffset
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation import thresholds
from lite6jax.estimation.evidence import Marginal, bound, of_process
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms

RNG = np.random.default_rng(8)
CONFOUNDED = 1e-9
KNOWN = 1e9
"""Degrees of freedom of a noise that is known."""


def density(y, C):
    """The log density of a normal distribution of the covariance C, but for a constant."""
    return -0.5 * (np.linalg.slogdet(C)[1] + y @ np.linalg.solve(C, y))


def scale_free(y, C):
    """The same, with the scale of the covariance integrated over (its prior density falls as one over the scale)."""
    return -0.5 * (np.linalg.slogdet(C)[1] + len(y) * np.log(y @ np.linalg.solve(C, y)))


def drawn(n=40, k=6, size=2.0):
    X = RNG.normal(size=(n, k)) * np.geomspace(1, 0.1, k)
    return X, X @ RNG.normal(size=k) * size + RNG.normal(size=n)


@pytest.mark.parametrize("size", [0.0, 0.3, 3.0])
def test_in_known_noise_it_is_the_ratio_of_two_normal_densities(size):
    X, y = drawn(size=size)
    found = of_process(X.T @ y, X.T @ X, KNOWN, KNOWN, CONFOUNDED)
    C = np.eye(len(y)) + found.variance * X @ X.T
    assert found.gain == pytest.approx(density(y, C) - density(y, np.eye(len(y))), abs=1e-5, rel=1e-6)
    assert found.volume == pytest.approx(0.5 * np.linalg.slogdet(C)[1])


@pytest.mark.parametrize("size", [0.0, 0.3, 3.0])
def test_of_unknown_scale_it_is_that_of_student_s_distribution_outside_the_nuisance(size):
    X, y = drawn(size=size)
    N = RNG.normal(size=(40, 5))
    y = y + N @ RNG.normal(scale=50.0, size=5)
    Q = np.linalg.svd(N, full_matrices=True)[0][:, 5:]  # of a flat prior nothing else is left
    X, y = Q.T @ X, Q.T @ y
    found = of_process(X.T @ y, X.T @ X, y @ y, 35.0, CONFOUNDED)
    C = np.eye(35) + found.variance * X @ X.T
    assert found.gain == pytest.approx(scale_free(y, C) - scale_free(y, np.eye(35)), abs=1e-9)


@pytest.mark.parametrize("size", [2.0, 1e5])
def test_no_other_amplitude_is_likelier(size):
    X, y = drawn(size=size)
    found = of_process(X.T @ y, X.T @ X, y @ y, 40.0, CONFOUNDED)
    gains = [scale_free(y, np.eye(40) + s * X @ X.T) for s in np.geomspace(1e-3, 1e3 * size**2, 800)]
    assert max(gains) - scale_free(y, np.eye(40)) == pytest.approx(found.gain, abs=0.1, rel=2e-3)


def test_of_equal_directions_it_is_the_formula():
    """½ (T - K - K ln(T / K)): so many numbers cost little more than one."""
    for K, T in ((1, 40.0), (24, 80.0)):
        pull = np.sqrt(T / K) * np.ones(K)
        found = of_process(pull, np.eye(K), KNOWN, KNOWN, CONFOUNDED)
        assert found.gain == pytest.approx(0.5 * (T - K - K * np.log(T / K)), abs=0.1)


def test_many_at_once_are_each_of_them():
    pairs = [drawn() for _ in range(3)]
    pull, information = (np.stack(each) for each in zip(*((X.T @ y, X.T @ X) for X, y in pairs), strict=True))
    left = np.array([y @ y for _, y in pairs])[:, None, None]
    together = of_process(pull, information, left, np.full((3, 1, 1), 40.0), CONFOUNDED)
    for k, (X, y) in enumerate(pairs):
        assert together.gain[k] == pytest.approx(of_process(X.T @ y, X.T @ X, y @ y, 40.0, CONFOUNDED).gain)


def test_no_kernel_explains_more_than_all_splines_without_a_prior():
    x = RNG.uniform(-1, 1, 90)
    B, y = spline_basis(x, -1.0, 1.0), np.sin(4 * x) + 0.3 * RNG.normal(size=90)
    most = bound(B @ y, B @ B.T, y @ y, 90.0, CONFOUNDED)
    gains = []
    for kernel in SCALED:
        R = kernel_of(kernel).root.T @ B
        gains.append(of_process(R @ y, R @ R.T, y @ y, 90.0, CONFOUNDED).gain)
    assert 20 < max(gains) < most


# ------------------------------------------------------------------ beside the model of a problem


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """A problem with a sensor somewhere unknown, what is left of it, the span of the nuisance, and the test."""
    made = Made(tmp_path_factory.mktemp("evidence"), seed=4, orientation=False, frame=True)
    motion = static_motion(9, 60)
    problem = pose_problem(made.recording(motion, bump=(3, lambda q: 2e-4 * np.sin(3 * q))))
    fitted = fitted_to(problem)
    test = score_test(problem, fitted, OPTIONS)
    N = problem.nuisance_columns(fitted.terms, fitted.values).reshape(len(problem.unknown), -1).T / test.scale[0]
    y = problem.residual(fitted.nuisance, fitted.terms, fitted.values).ravel() / test.scale[0]
    return problem, y, np.linalg.svd(N, full_matrices=True)[0][:, N.shape[1] :], test


def test_the_equations_of_a_process_are_those_outside_the_nuisance(beside):
    problem, y, Q, test = beside
    marginal = Marginal(test)
    component = next(one for one in problem.components if one.site == "joint3")
    splines = spline_basis(np.asarray(problem.motion.joint_position[2]), -3.0, 3.0)
    sums = marginal.sums(component.column)
    pull, information = marginal.equations(sums, splines[None])
    X = (splines[:, None] * component.column).reshape(len(splines), -1).T / test.scale[0]
    Z = Q.T @ X
    np.testing.assert_allclose(information[0], Z.T @ Z, rtol=1e-6, atol=1e-6 * np.abs(Z.T @ Z).max())
    np.testing.assert_allclose(pull[0], Z.T @ (Q.T @ y), rtol=1e-4, atol=1e-4 * np.abs(pull).max())
    dense = marginal.dense(component.column, splines)
    for one, other in zip(dense, (pull[0], information[0], sums.left, sums.freedom), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-8, atol=1e-8 * np.abs(other).max())
    # the noise is declared, which counts as four more degrees of freedom at its declared size
    assert sums.left == pytest.approx(y @ y + 4 / test.scale[0] ** 2, rel=1e-3)
    assert sums.freedom == pytest.approx(Q.shape[1] + 4)


def test_the_evidence_of_a_process_is_that_of_its_covariance_beside_the_nuisance(beside):
    problem, y, Q, test = beside
    marginal, R = Marginal(test), kernel_of("medium").root
    component = next(one for one in problem.components if one.site == "joint3")
    features = R.T @ spline_basis(np.asarray(problem.motion.joint_position[2]), -3.0, 3.0)
    sums = marginal.sums(component.column)
    (pull,), (information,) = marginal.equations(sums, features[None])
    found = of_process(pull, information, sums.left, sums.freedom, thresholds.CONFOUNDED)
    Z = Q.T @ (features[:, None] * component.column).reshape(len(features), -1).T / test.scale[0]
    # beside readings of the declared noise: four more, at its size
    known = np.full(4, 1 / test.scale[0])
    C = np.eye(Q.shape[1] + 4)
    bare = scale_free(np.append(Q.T @ y, known), C)
    C[: Q.shape[1], : Q.shape[1]] += found.variance * Z @ Z.T
    assert found.gain == pytest.approx(scale_free(np.append(Q.T @ y, known), C) - bare, abs=0.05)
    assert found.gain > 20


def test_of_a_name_all_directions_are_determined_equally_well(beside):
    problem, y, Q, test = beside
    labels = ("frame_offset:link3", "joint_scale:joint2")
    groups = [problem.columns([one for one in problem.candidates if one.label == label]) for label in labels]
    left, freedom = y @ y + 4 / test.scale[0] ** 2, Q.shape[1] + 4.0
    for columns, found in zip(groups, Marginal(test).of_names(groups), strict=True):
        Z = Q.T @ columns.reshape(len(columns), -1).T / test.scale[0]
        U, sizes, _ = np.linalg.svd(Z / np.linalg.norm(Z, axis=0), full_matrices=False)
        U = U[:, sizes > 1e-3]
        alike = of_process(U.T @ (Q.T @ y), np.eye(U.shape[1]), left, freedom, CONFOUNDED)
        assert found.gain == pytest.approx(alike.gain, abs=0.05)


def test_a_site_that_moves_by_a_number_of_its_own_in_each_sample_is_noise_along_its_direction(beside):
    problem, y, Q, test = beside
    column = next(one.column for one in problem.components if one.site == "joint3") / test.scale[0]
    found = Marginal(test).of_noise(column * test.scale[0])
    left = np.append(Q @ (Q.T @ y), np.full(4, 1 / test.scale[0]))
    C, bare = np.eye(len(left)), (Q.shape[1] + 4) / len(left)
    for k in range(problem.samples):
        rows = np.arange(problem.rows) * problem.samples + k
        C[np.ix_(rows, rows)] += found.variance * np.outer(column[:, k], column[:, k])
    S = left @ left, left @ np.linalg.solve(C, left)
    gain = -0.5 * bare * len(left) * np.log(S[1] / S[0]) - 0.5 * np.linalg.slogdet(C)[1]
    assert found.gain == pytest.approx(gain, abs=0.05)


def test_a_name_beside_a_process_is_scored_in_the_covariance_that_the_process_has(beside):
    problem, _, _, _ = beside
    q = problem.motion.joint_position
    process = Unnamed("joint3", "position of joint 3", float(q[2].min()), float(q[2].max()), "cubic", spread=2e-4)
    name = JointOffset(3)
    fitted = fitted_to(problem, Terms((process,)))
    test = score_test(problem, fitted, OPTIONS)
    flat = lambda columns: columns.reshape(len(columns), -1).T / test.scale[0]  # noqa: E731
    model = fitted.terms, fitted.values
    N, F = flat(problem.nuisance_columns(*model)), flat(problem.columns((process,), beside=model))
    c = flat(problem.columns((name,), beside=model))[:, 0]
    y = problem.residual(fitted.nuisance, *model).ravel() / test.scale[0] - F @ fitted.values
    spread = process.spread * test.scale[0] / fitted.scale[0]  # priors are weighed in the noise that was fitted
    K = np.eye(len(y)) + spread**2 * F @ F.T
    Ki = np.linalg.inv(K)
    P = Ki - Ki @ N @ np.linalg.pinv(N.T @ Ki @ N) @ N.T @ Ki
    score = test.score([name])[0]
    assert score.gain == pytest.approx(0.5 * (c @ P @ y) ** 2 / (c @ P @ c), rel=1e-4)
    assert score.values[0] == pytest.approx(-(c @ P @ y) / (c @ P @ c), rel=1e-4)


def test_the_volume_of_a_name_is_what_a_fit_of_all_its_numbers_gains_beyond_its_evidence(beside):
    """Also in a direction that is too nearly confounded with the others for evidence."""
    problem, y, Q, test = beside
    component = next(one for one in problem.components if one.site == "joint3")
    q = np.asarray(problem.motion.joint_position[2])
    columns = np.stack([np.sin(q), np.sin(q) + 3e-4 * np.sin(3 * q)])[:, None] * component.column
    marginal = Marginal(test)
    found = marginal.of_names([columns])[0]
    sums = marginal.sums(component.column)
    Z = Q.T @ columns.reshape(2, -1).T / test.scale[0]
    explained = (Q.T @ y) @ Z @ np.linalg.lstsq(Z, Q.T @ y, rcond=None)[0]
    likelihood = -0.5 * sums.freedom * np.log(1 - explained / sums.left)
    assert found.gain + found.volume == pytest.approx(likelihood, rel=1e-3)
    assert found.volume > 20  # of a bump of sin 3q


def test_what_is_left_beside_large_processes_counts_their_priors(beside):
    """yᵀ C⁻¹ y outside the nuisance, C with the processes: terms beside them explain no more than that."""
    problem, _, _, _ = beside
    q = problem.motion.joint_position
    processes = tuple(
        Unnamed(
            f"joint{j}", f"position of joint {j}", float(q[j - 1].min()), float(q[j - 1].max()), "smooth", spread=2e-5
        )
        for j in (2, 3)
    )
    fitted = fitted_to(problem, Terms(processes))
    test = score_test(problem, fitted, OPTIONS)
    model = fitted.terms, fitted.values
    N = problem.nuisance_columns(*model).reshape(len(problem.unknown), -1).T / test.scale[0]
    F = problem.columns(processes, beside=model).reshape(fitted.terms.size, -1).T / test.scale[0]
    y = problem.residual(fitted.nuisance, *model).ravel() / test.scale[0] - F @ fitted.values
    Q = np.linalg.svd(N, full_matrices=True)[0][:, N.shape[1] :]
    spread = 2e-5 * test.scale[0] / fitted.scale[0]  # priors are weighed in the noise that was fitted
    C = np.eye(Q.shape[1]) + spread**2 * (Q.T @ F) @ (Q.T @ F).T
    column = next(one.column for one in problem.components if one.site == "joint3")
    known = Marginal(test).sums(column).left - (Q.T @ y) @ np.linalg.solve(C, Q.T @ y)
    without = score_test(problem, fitted_to(problem), OPTIONS)
    declared = Marginal(without).sums(column).left - np.sum(without.left**2)  # what the declared noise counts
    assert known == pytest.approx(declared * (without.scale[0] / test.scale[0]) ** 2, rel=0.02)
    assert fitted.penalty > 5  # else this would not tell


def test_the_volume_of_processes_is_that_of_all_together(beside):
    """½ ln det of the precision of all coefficients beside the nuisance, over that of their priors."""
    problem, _, _, _ = beside
    q = problem.motion.joint_position
    same = [
        Unnamed("joint3", "position of joint 3", float(q[2].min()), float(q[2].max()), kernel, spread=2e-4)
        for kernel in ("smooth", "medium")
    ]
    volumes = []
    for processes in (same[:1], same[1:], same):
        fitted = fitted_to(problem, Terms(tuple(processes)))
        weight = np.sqrt(fitted.residuals.row_weight).ravel()
        model = fitted.terms, fitted.values
        N = problem.nuisance_columns(*model).reshape(len(problem.unknown), -1).T * weight[:, None]
        F = problem.columns(processes, beside=model).reshape(fitted.terms.size, -1).T * weight[:, None]
        Q = np.linalg.svd(N, full_matrices=True)[0][:, N.shape[1] :]
        expected = 0.5 * np.linalg.slogdet(np.eye(F.shape[1]) + 2e-4**2 * (Q.T @ F).T @ (Q.T @ F))[1]
        volumes.append(fitted.volume)
        assert fitted.volume == pytest.approx(expected, rel=0.02)
    assert volumes[1] < volumes[2] < 0.9 * (volumes[0] + volumes[1])  # they share much of what they can do
