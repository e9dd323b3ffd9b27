"""Joints that err at very many orders at once: named loads beside spectra that predict unseen poses."""

import numpy as np
import pytest
from diagnosis.recorded import NOISE, Made, searched, static_motion

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.nonparametric import Unnamed

COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=3e-5"
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
    made = Made(tmp_path_factory.mktemp("arm"), (COMPLIANCE,), seed=5)
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
    pairs = zip(terms.terms, terms.slices, strict=True)
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
