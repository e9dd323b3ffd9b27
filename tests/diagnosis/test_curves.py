"""Physics that no entry of the catalogue has, at one joint each: found there, called unnamed, and of its shape."""

import numpy as np
import pytest
from diagnosis.recorded import NOISE, OPTIONS, Made, fitted_to, found, moving_motion, searched, static_motion

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.thresholds import MARGIN
from lite6jax.search.scan import ModelScan, Scan
from tests.oracles.gravity import gravity_moments


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=3)


@pytest.fixture(scope="module")
def still():
    return static_motion(3)


def torque_of(arm, motion, joint):
    """(sample,) Nm about the joint's axis."""
    pairs = zip(motion["joint_position"], motion["payload"], strict=True)
    return np.array([gravity_moments(arm.kinematics, q, m, arm.inertia())[0][joint - 1][2] for q, m in pairs])


def slipping(load, most):
    """Of a spring beside one that slides from a quarter of the largest load on."""
    x, slid = np.zeros(len(load)), 0.0
    for k, force in enumerate(load / most):
        x[k] = (force + 4 * slid) / 5
        if abs(x[k] - slid) > 0.05:
            side = np.sign(x[k] - slid)
            x[k] = force - side * 0.2
            slid = x[k] - side * 0.05
    return x


def the_one(made, motion, bump):
    """The one finding, unnamed and at the joint of the bump, and what it does at every sample."""
    selection = searched(pose_problem(made.recording(motion, bump=bump)))
    assert found(selection) == [("unnamed", f"joint{bump[0]}")]
    (effect,) = selection.state.fit.terms.terms
    assert isinstance(effect, Unnamed)
    return effect, selection.state.fit.values @ selection.problem.deflections.basis(effect)


def test_a_step(arm, still):
    effect, done = the_one(arm, still, (4, lambda q: 6e-4 * (q > 0.5)))
    assert (effect.driver, effect.kernel) == ("position of joint 4", "rough")
    q = still["joint_position"][:, 3]
    beyond = np.abs(q - 0.5) > 0.4
    assert np.sqrt(np.mean((done - 6e-4 * (q > 0.5))[beyond] ** 2)) < 6e-5


def test_a_spring_that_hardens(arm, still):
    load = torque_of(arm, still, 2)
    turned = 8e-4 * np.tanh(2 * load / np.abs(load).max())
    effect, done = the_one(arm, still, (2, lambda _: turned))
    assert effect.drivers[0].phrase == "gravity torque of joint 2"
    assert not effect.hysteretic
    np.testing.assert_allclose(done, turned, atol=6e-5)


def yielded(arm, motion):
    """(sample,) rad, a spring of joint 3 that yields in each run, and (sample,) Nm, its load."""
    load = torque_of(arm, motion, 3)
    begins = np.flatnonzero(np.diff(motion["run"], prepend=-1))
    most = np.abs(load).max()
    return np.concatenate([1.5e-3 * slipping(part, most) for part in np.split(load, begins[1:])]), load


@pytest.mark.parametrize("moved", [static_motion, moving_motion])
def test_a_spring_that_yields_is_a_spring_and_wind_up(arm, moved):
    """It is their sum exactly: 0.2 of its load and 0.8 of a play of it, of a quarter of the largest load each way."""
    motion = moved(3)
    turned, load = yielded(arm, motion)
    most = np.abs(load).max()
    selection = searched(pose_problem(arm.recording(motion, bump=(3, lambda _: turned))))
    assert found(selection) == [("joint_compliance", "joint3"), ("joint_windup", "joint3")]
    fitted = {
        term.name: (value, term.chosen)
        for term, value in zip(selection.state.fit.terms.terms, selection.state.fit.values, strict=True)
    }
    (compliance, _), (windup, friction) = fitted["joint_compliance"], fitted["joint_windup"]
    assert compliance == pytest.approx(0.2 * 1.5e-3 / most, rel=0.2)
    assert windup == pytest.approx(0.8 * 1.5e-3 / most, rel=0.1)
    assert friction == pytest.approx(0.25 * most, rel=0.1)


def test_nothing_is_likely_where_nothing_is(arm, still):
    """Of all names, waves and processes of three recordings, none is worth what its choice costs and a margin."""
    for seed in range(3):
        problem = pose_problem(arm.recording(still, seed=seed))
        test = score_test(problem, fitted_to(problem), OPTIONS)
        assert max(one.net for one in ModelScan(Scan(problem, OPTIONS), test).ranked()) < MARGIN


# ------------------------------------------------------------------ very many orders at once


SMALL_COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=3e-5"
JOINTS = (1, 2, 3)
"""Those that err."""


def transmission(joint):
    """A smooth error of a joint over its position: waves of many orders, none of which is most of it."""
    rng = np.random.default_rng(40 + joint)
    orders = rng.choice(np.arange(3, 30), 9, replace=False)
    sizes, phases = 1.2e-4 * rng.uniform(0.6, 1.2, 9), rng.uniform(-np.pi, np.pi, 9)
    return lambda q: np.sin(np.multiply.outer(q, orders) + phases) @ sizes


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """The arm, the rows held out, and what was found in the others."""
    made = Made(tmp_path_factory.mktemp("arm"), (SMALL_COMPLIANCE,), seed=5)
    motion = static_motion(5, samples=800)
    motion["joint_position"][:, 1:] *= 0.6
    truly = motion["joint_position"].copy()
    for joint in JOINTS:
        truly[:, joint - 1] += transmission(joint)(motion["joint_position"][:, joint - 1])
    recording = made.recording(motion, poses=made.poses({**motion, "joint_position": truly}))
    held = np.arange(800) >= 640
    selection = searched(pose_problem(recording), ~held)
    return selection.problem, held, selection


def unnamed(selection):
    """Each nonparametric effect of a position, with its place among the numbers of the fit."""
    terms = selection.state.fit.terms
    pairs = terms.pairs
    return [pair for pair in pairs if isinstance(pair[0], Unnamed) and pair[0].driver.startswith("position")]


def test_every_joint_that_errs_has_one_process(swept):
    _, _, selection = swept
    found = unnamed(selection)
    assert sorted(effect.site for effect, _ in found) == [f"joint{joint}" for joint in JOINTS]
    # of nine waves each: so many numbers at least are determined, and fewer than there are
    for effect, part in found:
        spread = effect.spread
        effective = effect.size - np.trace(selection.state.fit.covariance[part, part]) / spread**2
        assert 12 <= effective < effect.size
        assert effect.driver == f"position of joint {effect.site[5:]}"
    assert all(one.p_value < 0.003 for one in selection.state.tested)


def test_a_process_is_the_joint_s_error_where_it_was_measured(swept):
    case, _, selection = swept
    for effect, part in unnamed(selection):
        joint = int(effect.site[5:])
        q = np.asarray(case.motion.joint_position[joint - 1])
        q = q[(q > np.quantile(q, 0.05)) & (q < np.quantile(q, 0.95))]
        missed = selection.state.fit.values[part] @ effect.functions_at(q[None]) - transmission(joint)(q)
        # an offset is the calibration's, which is exact here: so none is left over
        assert np.sqrt(np.mean(missed**2)) < 0.2 * np.sqrt(np.mean(transmission(joint)(q) ** 2))


def test_poses_that_it_never_saw_are_predicted(swept):
    case, held, selection = swept

    def missed(fitted):
        errors = case.position_errors(fitted.nuisance, fitted.terms, fitted.values)[:, held]
        return np.sqrt(np.mean(np.sum(errors**2, 0)))

    noise = np.sqrt(3) * NOISE[0]
    assert missed(selection.state.baseline) > 4 * noise
    assert missed(selection.state.fit) < 1.1 * noise


def test_a_process_is_uncertain_where_nothing_was_measured(swept):
    _, _, selection = swept
    for effect, part in unnamed(selection):
        inside_at = np.linspace(effect.lower, effect.upper, 50)
        outside_at = inside_at + effect.upper - effect.lower
        inside, outside = (np.asarray(effect.functions_at(x[None])) for x in (inside_at, outside_at))
        C = selection.state.fit.covariance[part, part]
        std = [
            np.sqrt(np.mean(np.sum(functions * (C @ functions), 0) + effect.unknown_at(at[None])))
            for at, functions in zip((inside_at, outside_at), (inside, outside), strict=True)
        ]
        assert std[1] > 3 * std[0]
