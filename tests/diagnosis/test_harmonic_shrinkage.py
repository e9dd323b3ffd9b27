"""Joints that err at very many orders at once: named loads beside curves, of few numbers, that predict unseen poses."""

import jax.numpy as jnp
import numpy as np
import pytest
from diagnosis.recorded import NOISE, Made, searched, static_motion

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict

COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=3e-5"


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
    motion = static_motion(5, samples=900)
    motion["joint_position"][:, 1:] *= 0.6
    truly = motion["joint_position"].copy()
    for joint in range(1, 6):
        truly[:, joint - 1] += transmission(joint)(motion["joint_position"][:, joint - 1])
    recording = made.recording(motion, poses=made.poses({**motion, "joint_position": truly}))
    held = np.arange(900) >= 720
    selection = searched(pose_problem(recording), ~held)
    return selection.problem, held, selection


@pytest.mark.long
def test_the_load_keeps_its_name_beside_the_curves(swept):
    _, _, selection = swept
    named = [one.term.label for one in selection.state.tested if not isinstance(one.term, Unnamed)]
    assert named == ["joint_compliance:joint2"]
    values = selection.state.fit.values[selection.state.fit.terms.slices[0]]
    std = np.sqrt(selection.state.fit.covariance[0, 0])
    assert values[0] == pytest.approx(3e-5, abs=4 * std)
    assert std < 2e-6


def test_every_joint_that_errs_has_one_curve(swept):
    _, _, selection = swept
    curves = [one.term for one in selection.state.tested if isinstance(one.term, Unnamed)]
    assert sorted(curve.site for curve in curves) == [f"joint{joint}" for joint in range(1, 6)]
    # of nine waves each: so many numbers at least are determined, and fewer than there are
    effective = [one.score.size for one in selection.state.tested if isinstance(one.term, Unnamed)]
    assert all(18 <= size < 0.8 * curve.size for size, curve in zip(effective, curves, strict=True))
    assert all(len(curve.orders) >= 29 for curve in curves)
    assert all(one.p_value < 0.003 for one in selection.state.tested)


def test_a_curve_is_the_joint_s_error_where_it_was_measured(swept):
    case, _, selection = swept
    for effect, part in zip(selection.state.fit.terms.terms, selection.state.fit.terms.slices, strict=True):
        if isinstance(effect, Unnamed):
            joint = int(effect.site[5:])
            q = np.asarray(case.motion.joint_position[joint - 1])
            q = q[(q > np.quantile(q, 0.05)) & (q < np.quantile(q, 0.95))]
            missed = selection.state.fit.values[part] @ np.asarray(effect.basis.at(jnp.asarray(q))) - transmission(
                joint
            )(q)
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


def test_a_curve_fades_where_nothing_was_measured(swept):
    _, _, selection = swept
    curve = next(one.term for one in selection.state.tested if isinstance(one.term, Unnamed))
    values = jnp.ones(curve.size)
    assert np.abs(np.asarray(curve.curve(values, jnp.array([curve.lower - 1, curve.upper + 1])))).max() == 0
    assert np.abs(np.asarray(curve.curve(values, jnp.linspace(curve.lower, curve.upper, 200)))).max() > 1


def test_a_curve_survives_its_file(swept):
    _, _, selection = swept
    terms = selection.state.fit.terms
    for effect, part in zip(terms.terms, terms.slices, strict=True):
        again, values = effect_from_dict(effect_as_dict(effect, selection.state.fit.values[part]))
        assert again == effect
        np.testing.assert_array_equal(values, selection.state.fit.values[part])
