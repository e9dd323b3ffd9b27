"""Orders of a gear, whole or not, at the joint that has them."""

import numpy as np
import pytest
from diagnosis.recorded import OPTIONS, Made, fitted_to, static_motion, with_effects
from scipy.stats import chi2

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.kinematic import JointHarmonic
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.thresholds import CLOSE
from lite6jax.search.search import search
from lite6jax.search.spectrum import as_likely, lines, spectrum


@pytest.fixture(scope="module")
def still():
    return static_motion(7)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=1, frame=True)


def evidence(made, motion, **options):
    case = pose_problem(made.recording(motion, **options))
    return score_test(case, fitted_to(case), OPTIONS)


@pytest.mark.parametrize(
    ("joint", "order", "within"),
    [
        *((1, 2, 0.0), (3, 7.5, 0.03), (2, 101, 0.0), (4, 63.3, 0.03)),
        *((5, 1, 0.0), (2, 160.7, 0.03), (6, 399, 0.0), (3, 320, 0.0)),
    ],
)
def test_the_order_of_a_joint(arm, still, joint, order, within):
    made = with_effects(arm, f"joint_harmonic:joint={joint},order={order},amplitude_rad=6e-4,phase_rad=0.8")
    against = evidence(made, still)
    best = lines(against)[0]
    assert best.family.site == f"joint{joint}"
    assert abs(best.order - order) <= within
    assert best.term == JointHarmonic(joint, best.order)
    (score,) = against.score([best.term])
    assert best.gain == pytest.approx(score.gain, rel=1e-6)
    assert score.p_value < 1e-6
    # a sine and a cosine of it
    wanted = 6e-4 * np.array([np.cos(0.8), np.sin(0.8)])
    assert np.linalg.norm(score.values - wanted) < 0.15 * 6e-4


def test_two_waves_of_whole_orders_and_one_between_them_are_alternatives(tmp_path):
    """Within a quarter of a turn orders 1 and 2 together are nearly one wave of order 1.7."""
    motion = static_motion(3, 120)
    narrow = motion["joint_position"].copy()
    narrow[:, 3] = 0.8 * np.tanh(narrow[:, 3])
    motion = {**motion, "joint_position": narrow}
    made = with_effects(
        Made(tmp_path, seed=1, frame=True),
        "joint_harmonic:joint=4,order=1,amplitude_rad=2e-4,phase_rad=0.3",
        "joint_harmonic:joint=4,order=2,amplitude_rad=2e-4,phase_rad=1.1",
    )
    found = search(pose_problem(made.recording(motion)), OPTIONS)
    waves = [selected for selected in found.state.tested if selected.term.periodic]
    (wave,) = waves
    assert 1 < wave.term.order < 2
    (pair,) = [alternative for alternative in wave.alternatives if alternative.together_with]
    assert (pair.term.order, [term.order for term in pair.together_with]) == (1, [2])
    assert 0 <= pair.gap < CLOSE


def taught(motion, grid):
    """The motion with joint positions at multiples of some degrees, as they are typed into a teach pendant."""
    return {**motion, "joint_position": np.radians(np.round(np.degrees(motion["joint_position"]) / grid) * grid)}


@pytest.mark.parametrize(
    ("grid", "order", "others"),
    [
        *((2.0, 2, [178, 182, 358]), (3.0, 31, [89, 151, 209]), (1.0, 170, [190]), (0.5, 101, [])),
        *((30.0, 2, [10, 14, 22]), (15.0, 2, [22, 26, 46])),  # three are shown
        *((11.0, 25, None), (7.0, 31, None)),  # and lower ones that are not whole: 7.7 and 20.4
    ],
)
def test_of_orders_that_are_one_wave_at_taught_positions_it_is_the_lowest_whole_one(arm, still, grid, order, others):
    made = with_effects(arm, f"joint_harmonic:joint=2,order={order},amplitude_rad=6e-4,phase_rad=0.8")
    against = evidence(made, taught(still, grid))
    best = lines(against)[0]
    assert (best.family.site, best.order) == ("joint2", order)
    found = as_likely(against, best.family, best.order, CLOSE)
    assert others is None or [other for other, _ in found] == others
    assert max([gap for _, gap in found], default=0.0) < (0.5 if others is None else 1e-6)


def test_gains_are_those_of_exact_scores_where_nothing_is_fitted(arm, still):
    against = evidence(Made(arm.folder, seed=1), still)
    orders, gains = spectrum(against, against.problem.periodic[1])
    some = [0, 40, 200, len(orders) - 1]
    for k in some:
        score = against.score([JointHarmonic(2, float(orders[k]))])[0]
        # angles count by a fine histogram: the phase of order 400 is within a 25th of a radian
        assert gains[k] == pytest.approx(score.gain, abs=0.02 * (1 + score.gain))


def test_noise_has_no_order(arm, still):
    for seed in range(3):
        found = lines(evidence(arm, still, seed=seed))
        assert sorted(line.family.site for line in found) == [f"joint{j}" for j in range(1, 7)]
        assert min(chi2.sf(2 * line.gain, 2) * np.exp(line.searched) for line in found) > 1e-3
        gains = [line.gain for line in found]
        assert gains == sorted(gains, reverse=True)


def test_a_gear_is_told_from_what_else_turns_its_joint(arm):
    """Forty orders, and a function of another joint's position at the same joint."""
    motion, rng, order = static_motion(3, 200), np.random.default_rng(5), np.arange(1, 41)
    moved = motion["joint_position"].copy()
    sine, cosine = 1.5e-4 * rng.standard_normal((2, 40)) / np.sqrt(1 + (order / 8) ** 2)
    turned = np.outer(moved[:, 1], order)
    moved[:, 1] += np.sin(turned) @ sine + np.cos(turned) @ cosine + 6e-4 * np.tanh(3 * np.sin(moved[:, 3]))
    recording = arm.recording(motion, poses=arm.poses({**motion, "joint_position": moved}))
    found = search(pose_problem(recording), OPTIONS).state.fit.terms.terms
    assert {(term.site, term.driver, term.kernel == "spectrum") for term in found} == {
        ("joint2", "position of joint 2", True),
        ("joint2", "position of joint 4", False),
    }
