"""Fleets of torque recordings: friction and ripple that all arms share below the threshold of one, and an odd arm."""

import numpy as np
import pytest
from fleet.linear_arms import population, tried
from report.torque_diagnosed import LITE6, NOISE, diagnosed, moved

from lite6jax.arms.dynamics import inverse_dynamics, link_parameters
from lite6jax.effects.dynamic import ViscousFriction
from lite6jax.estimation.options import EngineOptions
from lite6jax.fleet.reduced import ReducedArm
from lite6jax.fleet.reduction import reduced
from lite6jax.fleet.terms import PooledTerm
from lite6jax.recordings import Recording, RecordingSettings

OPTIONS = EngineOptions(highest_order=20.0)
"""A filter of all orders to 400 would take most of the time."""
VISCOUS = PooledTerm("viscous_friction:joint=2,of_slide=False,exponent=1.0")
ORDER, BUMP = 11.0, 0.02
DEVIATION = 0.0057
"""Nm·s/rad, the standard error of joint 2's viscous friction in one recording; a search of one needs five of these."""


@pytest.fixture(scope="module")
def motion():
    """Times, positions, velocities, and the torques of the rigid arm."""
    t, q, dq, ddq = moved(8.0)
    links, down = link_parameters(LITE6), np.array([0, 0, -9.81])
    return t, q, dq, np.array(inverse_dynamics(LITE6.kinematics, links, q, dq, ddq, down))


def recording(motion, seed, viscous=0.0, ripple=0.0, outside=0.0):
    t, q, dq, rigid = motion
    rng = np.random.default_rng(seed)
    torque = rigid + np.array(NOISE)[:, None] * rng.standard_normal(rigid.shape)
    torque[1] += viscous * dq[1]
    torque[2] += ripple * np.sin(ORDER * q[2] + rng.uniform(-np.pi, np.pi))
    torque[3] += outside * np.tanh(dq[3] / 0.01) * bump(q[3])
    settings = RecordingSettings(arm="lite6", motion="trajectory", torque_source="measured", torque_noise_Nm=NOISE)
    return Recording.from_arrays(q.T, time=t, joint_velocity=dq.T, joint_torque=torque.T, settings=settings)


def bump(position):
    """Of friction in a part of the range, which no effect of the catalogue has."""
    return np.exp(-0.5 * ((position - LITE6.joint_limits[3].mean()) / 0.2) ** 2)


def fleet(folder, motion, sizes):
    """Arms with viscous friction and ripple of these sizes, of which none has findings of its own, and their result."""
    arms = [reduced(diagnosed(recording(motion, seed, *size))) for seed, size in enumerate(sizes)]
    return arms, population(folder, arms, options=OPTIONS)


def test_friction_that_all_have_is_found_and_the_arm_that_differs_is_named(tmp_path, motion):
    sizes = [(2.5 * DEVIATION + 10 * DEVIATION * (i == 3), 0.0) for i in range(10)]
    arms, found = fleet(tmp_path, motion, sizes)
    (own,) = (one.evidence(VISCOUS) for one in arms[:1])
    assert own.information[0, 0] ** -0.5 == pytest.approx(DEVIATION, rel=0.1)
    (effect,) = found.effects
    assert (effect.selected.term, list(effect.outliers)) == (VISCOUS, [3])
    assert abs(effect.hierarchy.mean[0] - 2.5 * DEVIATION) < effect.hierarchy.half_width[0]
    document = found.to_dict()
    assert [one["file"] for one in document["recordings"] if one["outlier_in"]] == ["arm3.csv"]


@pytest.mark.long
def test_ripple_of_any_phase_is_found_through_the_filter(tmp_path, motion):
    arms, found = fleet(tmp_path, motion, [(0.0, 0.012)] * 10)
    assert arms[0].smoothing.every > 1
    (effect,) = found.to_dict()["effects"]
    assert (effect["effect"], effect["site"], effect["order"]) == ("torque_ripple", "joint3", ORDER)
    assert effect["amplitude_rms_Nm"] == pytest.approx(0.012, rel=0.25)


def test_friction_in_a_part_of_the_range_has_no_name(tmp_path, motion):
    _, found = fleet(tmp_path, motion, [(0.0, 0.0, BUMP)] * 5)
    (effect,) = found.to_dict()["effects"]
    assert (effect["effect"], effect["site"]) == ("unnamed", "joint4")
    assert effect["driver"] == "position of joint 4 and direction of motion of joint 4"
    curve = effect["curve"]
    assert curve["name"] == "curve_Nm"
    inside = np.abs(np.array(curve["driver"]) - LITE6.joint_limits[3].mean()) < 0.3
    off = (np.array(curve["mean"]) - BUMP * bump(np.array(curve["driver"])))[inside]
    assert np.mean(np.abs(off) < 3 * np.array(curve["std"])[inside]) > 0.9


def test_processes_are_those_of_the_search_of_the_recording(motion):
    found = diagnosed(recording(motion, 0))
    arm, problem = ReducedArm.from_bytes(reduced(found).to_bytes()), found.problem
    all_tried, quantities = tried([arm]), {one.driver.phrase: one for one in problem.quantities}
    components = {one.site: one for one in problem.components}
    for screened in (*all_tried.singles[::23], *all_tried.pairs[::23]):
        for process in all_tried.with_every_kernel(screened):
            own = [quantities[one] for one in process.drivers]
            effect = problem.process(components[process.site], own, process.kernel, 1.0)
            expected = problem.columns([effect]).reshape(effect.size, -1)
            columns = arm.columns_of(process)[:, : expected.shape[1]]
            scale = np.vdot(columns, expected) / np.vdot(expected, expected)
            np.testing.assert_allclose(columns, scale * expected, rtol=1e-6, atol=1e-6 * np.abs(columns).max())
            assert scale == pytest.approx(1.0, rel=0.2)


def test_columns_are_those_of_the_problem_and_a_file_holds_them(motion):
    found = diagnosed(recording(motion, 0, 0.5), (ViscousFriction(2),))
    arm = reduced(found)
    value = np.linalg.solve(*arm.evidence(VISCOUS)[1::-1])
    assert value == pytest.approx(found.fit.values, rel=0.02)
    family = found.problem.periodic[2]
    expected = family.columns(np.array([ORDER]))[0].reshape(2, -1)
    columns = ReducedArm.from_bytes(arm.to_bytes()).columns_of(PooledTerm("waves:joint3", ORDER))[
        :, : expected.shape[1]
    ]
    scale = np.vdot(columns, expected) / np.vdot(expected, expected)
    np.testing.assert_allclose(columns, scale * expected, rtol=1e-9, atol=1e-9)
    assert scale == pytest.approx(1.0, rel=0.1)
