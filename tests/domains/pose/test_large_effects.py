"""Effects of hundreds of times the noise in an arm of unknown geometry, which they bend far from where it is sought."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.recorded import OPTIONS, Made, static_motion

from lite6jax.domains.pose.clock import linearised
from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.kinematic import LinkCompliance
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.terms import Terms
from lite6jax.search.search import Selection, at_estimate
from lite6jax.search.state import SelectedTerm, State, refitted

TRUE = np.array([4e-3, 3e-3])
"""rad/Nm, about x and y: a link that bends by 10 mrad."""
LINK = Terms((LinkCompliance(2),))


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    bent = f"link_compliance:link=2,compliance_x_rad_per_Nm={TRUE[0]},compliance_y_rad_per_Nm={TRUE[1]}"
    made = Made(
        tmp_path_factory.mktemp("arm"), seed=1, geometry="free", frame=True, tool=True, inertial=0.1, effects=(bent,)
    )
    problem, _ = linearised(pose_problem(made.recording(static_motion(3, 80))), OPTIONS)
    return problem, fit(problem, Terms(), OPTIONS)


@pytest.fixture(scope="module")
def followed(case):
    """The fit of the link, which does not converge in the linearisation of the geometry alone."""
    problem, baseline = case
    return fit(problem, LINK, OPTIONS, None, baseline.nuisance)


@pytest.fixture(scope="module")
def selection(case, followed):
    problem, baseline = case
    tested = SelectedTerm(LINK.terms[0])
    return Selection(problem, problem, State(baseline, followed, (tested,)))


def test_a_fit_that_does_not_converge_is_linearised_anew(case, followed):
    problem, baseline = case
    fixed = fit(problem, LINK, replace(OPTIONS, relinearisations=0), None, baseline.nuisance)
    assert baseline.scale > 5
    assert not fixed.converged
    assert followed.converged
    assert followed.gain_over(fixed) > OPTIONS.close
    assert followed.scale == pytest.approx(1, abs=4 / np.sqrt(2 * followed.freedom))
    std = np.sqrt(np.diagonal(followed.covariance))
    assert (np.abs(followed.values - TRUE) < 4 * std).all()


def test_a_selection_is_linearised_at_its_estimate(selection):
    moved = at_estimate(selection, OPTIONS)
    problem, f = moved.problem, moved.state.fit
    apart = problem.residual(f.nuisance, f.terms, f.values) - f.residuals.rows
    assert np.sum((apart / f.scale) ** 2) < OPTIONS.same
    assert at_estimate(moved, OPTIONS) is moved
    # the nuisance alone is still that of the reference
    baseline = moved.state.baseline
    alone = moved.reference.residual(baseline.nuisance, baseline.terms, baseline.values)
    np.testing.assert_allclose(alone, baseline.residuals.rows, atol=1e-6)


def test_without_its_term_a_moved_selection_is_the_nuisance_alone(selection):
    moved = at_estimate(selection, OPTIONS)
    rest = refitted(moved.problem, moved.state, [], OPTIONS)
    assert rest.fit.scale == pytest.approx(moved.state.baseline.scale, rel=1e-3)


def test_a_selection_of_nothing_stays_where_it_is(case):
    problem, baseline = case
    nothing = Selection(problem, problem, State(baseline, baseline))
    assert at_estimate(nothing, OPTIONS) is nothing
