"""Where a search starts: loads of arms that move, and effects of hundreds of times the noise.

Whether loads hold what it takes to accelerate is decided by data made with Pinocchio.
"""

from dataclasses import fields, replace

import numpy as np
import pinocchio as pin
import pytest
from diagnosis.recorded import OPTIONS, Made, estimates, fitted_to, found, moving_motion, static_motion

from lite6jax.domains.pose.linearisation import linearised, search_load_model
from lite6jax.domains.pose.problem import PoseProblem, pose_problem
from lite6jax.effects.kinematic import JointCompliance, JointHarmonic, LinkCompliance, PayloadError
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.options import FitOptions
from lite6jax.estimation.score_test import Score
from lite6jax.estimation.terms import Terms
from lite6jax.estimation.thresholds import CLOSE
from lite6jax.search.final_estimates import final_estimates, with_alternative
from lite6jax.search.search import Selection, at_estimate
from lite6jax.search.state import SelectedTerm, State
from tests.oracles.pinocchio_arm import pinocchio_arm

COMPLIANCE = 2e-4
SURE = SelectedTerm(JointCompliance(2), 0.0, Score(100.0, 1, 0.0, False, np.zeros(1)))


@pytest.fixture(scope="module")
def still():
    return static_motion(6)


@pytest.fixture(scope="module")
def moving():
    return moving_motion(3, 240)


def searched(problem):
    """The search under the more likely load model."""
    return search_load_model(*linearised(problem, OPTIONS), OPTIONS)


def stated(selection, wrong_input=0.0):
    """With final estimates, by the probability that the payload is declared wrong."""
    options = replace(OPTIONS, prior=replace(OPTIONS.prior, wrong_input=wrong_input))
    return replace(selection, state=final_estimates(selection.problem, selection.state, options))


def recorded(made, motion, accelerating):
    """Joint 2 gives way by the torque of inverse dynamics, or of gravity alone."""
    model = pinocchio_arm(made.kinematics, 0.0, made.inertia())
    data, nothing = model.createData(), np.zeros(6)
    q, dq = motion["joint_position"], motion["joint_velocity"]
    ddq = np.concatenate([np.gradient(dq[motion["run"] == k], 0.02, axis=0, edge_order=2) for k in (0, 1)])
    torque = [
        -pin.rnea(model, data, *(row if accelerating else (row[0], nothing, nothing)))[1]
        for row in zip(q, dq, ddq, strict=True)
    ]
    bent = q.copy()
    bent[:, 1] += COMPLIANCE * np.array(torque)
    return pose_problem(made.recording(motion, poses=made.poses({**motion, "joint_position": bent}), seed=4))


@pytest.mark.parametrize("accelerating", [True, False])
def test_the_data_say_which_loads_bend_an_arm(tmp_path, moving, accelerating):
    case = recorded(Made(tmp_path, seed=1), moving, accelerating)
    selection = searched(case)
    assert (selection.problem.motion.joint_acceleration is not None) == accelerating
    assert found(selection) == [("joint_compliance", "joint2")]
    other = with_alternative(selection.problem, selection.state.fit, OPTIONS)
    assert selection.state.fit.gain_over(other) > 100
    got = estimates(stated(selection), "joint_compliance", "joint2")["compliance_rad_per_Nm"]
    assert abs(got.value - COMPLIANCE) < 4 * got.std < 0.05 * COMPLIANCE
    wrong = abs(other.values[0] - COMPLIANCE)
    assert wrong > 10 * got.std


def test_what_is_unsure_of_the_loads_is_in_the_deviation(tmp_path, moving):
    """In noise that hides which loads they are, the difference between the two counts by its probability."""
    made = Made(tmp_path, seed=1)
    case = recorded(made, moving, True)
    rng = np.random.default_rng(0)
    recording = replace(case.recording, position=case.recording.position + rng.normal(0, 5e-4, (240, 3)))
    settings = replace(recording.settings, position_noise_m=5e-4)
    recording = replace(recording, quaternion=None, settings=replace(settings, orientation_noise_rad=None))
    problem, reference = linearised(pose_problem(recording), OPTIONS)
    fitted = fitted_to(problem, Terms((SURE.term,)))
    other = with_alternative(problem, fitted, OPTIONS)
    gain = fitted.gain_over(other)
    assert abs(gain) < 6
    said = stated(Selection(problem, reference, State(fitted, fitted, (SURE,)))).state.fit
    difference = other.values - fitted.values
    wanted = fitted.covariance + np.outer(difference, difference) / (1 + np.exp(gain))
    np.testing.assert_allclose(said.covariance, wanted, rtol=1e-9)
    assert np.abs(said.values - COMPLIANCE) < 4 * np.sqrt(said.covariance[0])


@pytest.mark.parametrize("payload", [0.0, 0.8])
def test_a_payload_that_may_be_wrong_is_in_the_deviation(tmp_path, payload):
    """By how much it would shift the compliance and what it makes of its variance, by its posterior probability."""
    effects = ["joint_compliance:joint=2,compliance_rad_per_Nm=2e-5", f"payload_error:mass_kg={payload}"]
    case = pose_problem(Made(tmp_path, effects, seed=1).recording(static_motion(5, 120)))
    problem, reference = linearised(case, OPTIONS)
    fitted = fitted_to(problem, Terms((SURE.term,)))
    both = fitted_to(problem, Terms((SURE.term, PayloadError())))
    gain, numbers = both.gain_over(fitted), problem.rows * problem.samples
    odds = 0.1 / 0.9 * np.exp(gain - 0.5 * np.log(numbers))  # Schwarz's approximation, one number more
    share, shift = odds / (1 + odds), both.values[0] - fitted.values[0]
    wanted = (1 - share) * fitted.covariance[0, 0] + share * (both.covariance[0, 0] + shift**2)
    selection = Selection(problem, reference, State(fitted, fitted, (SURE,)))
    said = stated(selection, 0.1).state
    np.testing.assert_allclose(said.fit.covariance[0, 0], wanted * _exact(selection), rtol=0.05)
    np.testing.assert_allclose(said.tested[0].input_share, 1 - fitted.covariance[0, 0] / wanted, rtol=0.1)
    assert share < 0.05 if payload == 0 else 0.3 < share < 0.7


def _exact(selection):
    """What derivatives at the estimate make of the variance."""
    return float(stated(selection).state.fit.covariance[0, 0] / selection.state.fit.covariance[0, 0])


def test_an_arm_at_rest_has_no_other_loads(tmp_path):
    made = Made(tmp_path, ("joint_compliance:joint=2,compliance_rad_per_Nm=2e-4",), seed=1)
    selection = searched(pose_problem(made.recording(static_motion(5, 80))))
    assert selection.problem.motion.joint_acceleration is None
    assert with_alternative(selection.problem, selection.state.fit, OPTIONS) is None
    assert found(selection) == [("joint_compliance", "joint2")]


def selected(made, motion, term):
    """A selection of one term of a recording, as a search would leave it."""
    problem, reference = linearised(pose_problem(made.recording(motion, seed=2)), OPTIONS)
    state = State(fitted_to(problem), fitted_to(problem, Terms((term,))), (replace(SURE, term=term),))
    return Selection(problem, reference, state)


def test_orders_read_off_a_spectrum_are_fitted_along(tmp_path, moving):
    order = 3.37
    made = Made(tmp_path, (f"joint_harmonic:joint=1,order={order},amplitude_rad=3e-4,phase_rad=0.5",), seed=1)
    selection = selected(made, moving, JointHarmonic(1, 3.38))
    said = stated(selection)
    assert [tested.term for tested in said.state.tested] == list(said.state.fit.terms.terms)
    got = estimates(said, "joint_harmonic", "joint1")
    before = estimates(selection, "joint_harmonic", "joint1")
    assert abs(got["order"].value - order) < 0.02
    for name, true in (("amplitude_rad", 3e-4), ("phase_rad", 0.5)):
        assert abs(got[name].value - true) < 4 * got[name].std
    # a phase is known no better than the order by which it turns
    assert got["phase_rad"].std > 1.05 * before["phase_rad"].std


@pytest.mark.parametrize(("order", "said"), [(5.0, 5.0), (4.96, None)])
def test_a_whole_order_is_kept_while_the_data_allow_it(tmp_path, still, order, said):
    made = Made(tmp_path, (f"joint_harmonic:joint=1,order={order},amplitude_rad=4e-4,phase_rad=0.5",), seed=1)
    got = stated(selected(made, still, JointHarmonic(1, 5.0))).state
    (effect,) = got.fit.terms.terms
    assert isinstance(effect, JointHarmonic)
    assert effect.order is not None
    assert effect == got.tested[0].term
    if said is None:
        assert abs(effect.order - order) < 0.01
    else:
        assert effect.order == said


# ------------------------------------------------------------------ effects of hundreds of times the noise

TRUE = np.array([4e-3, 3e-3])
"""rad/Nm, about x and y: a link that bends by 10 mrad."""
LINK = Terms((LinkCompliance(2),))


class _Limp(PoseProblem):
    """Of an arm that may bend by any amount: within the limits of real ones, fits converge at once."""

    def limits(self, term):
        return [(0.0, 1.0)] * term.size


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    bent = f"link_compliance:link=2,compliance_x_rad_per_Nm={TRUE[0]},compliance_y_rad_per_Nm={TRUE[1]}"
    made = Made(
        tmp_path_factory.mktemp("arm"), seed=1, geometry="free", frame=True, tool=True, inertial=0.1, effects=(bent,)
    )
    problem, _ = linearised(pose_problem(made.recording(static_motion(3, 80))), OPTIONS)
    problem = _Limp(**{field.name: getattr(problem, field.name) for field in fields(problem)})
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
    fixed = fit(problem, LINK, replace(OPTIONS, fit=FitOptions(may_relinearise=False)), None, baseline.nuisance)
    assert baseline.scale > 5
    assert not fixed.converged
    assert followed.converged
    assert followed.gain_over(fixed) > CLOSE
    assert followed.scale == pytest.approx(1, abs=4 / np.sqrt(2 * followed.freedom))
    std = np.sqrt(np.diagonal(followed.covariance))
    assert (np.abs(followed.values - TRUE) < 4 * std).all()


def test_a_selection_is_linearised_at_its_estimate(selection):
    moved = at_estimate(selection, OPTIONS)
    problem, f = moved.problem, moved.state.fit
    step = 1e-7
    columns = problem.columns(f.terms.terms, f.values)
    for number, column in enumerate(columns):
        less, more = (f.values + sign * step * np.eye(len(columns))[number] for sign in (-1, 1))
        difference = problem.residual(f.nuisance, f.terms, more) - problem.residual(f.nuisance, f.terms, less)
        difference /= 2 * step
        before = selection.problem.columns(f.terms.terms, f.values)[number]
        size = np.linalg.norm(difference)
        assert np.linalg.norm(column - difference) < 1e-4 * size
        assert np.linalg.norm(before - difference) > 1e-3 * size  # about the rigid arm
    again = at_estimate(moved, OPTIONS).state.fit
    assert (np.abs(again.values - f.values) < 0.01 * np.sqrt(np.diagonal(f.covariance))).all()
    # the nuisance alone is still that of the reference
    baseline = moved.state.baseline
    alone = moved.reference.residual(baseline.nuisance, baseline.terms, baseline.values)
    np.testing.assert_allclose(alone, baseline.residuals.rows, atol=1e-6)
