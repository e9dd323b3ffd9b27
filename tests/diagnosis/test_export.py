"""The arm of a diagnosis of torques, as simulators read it."""

from dataclasses import replace

import numpy as np
import pytest
from domains.torque.moved import GRAVITY, motion_of, setup_of

from lite6jax.arms.dynamics import base_parameters, inverse_dynamics, is_consistent, link_parameters
from lite6jax.arms.files import convert_file, read_arm
from lite6jax.diagnosis.export import diagnosed_arm
from lite6jax.domains.torque.predict import DiagnosedMotors, predict_torques
from lite6jax.effects.catalogue import TORQUE_EFFECTS
from lite6jax.effects.dynamic import CoulombFriction, UnnamedTorque
from lite6jax.effects.serialization import parse_effect
from lite6jax.estimation.terms import Terms, join
from lite6jax.recordings import Recording


def model_with(*texts):
    """A Lite 6 with these effects."""
    _, arm = setup_of(2)
    pairs = [parse_effect(text, TORQUE_EFFECTS) for text in texts]
    links = np.asarray(link_parameters(arm))
    terms, values = Terms(tuple(e for e, _ in pairs)), join(v for _, v in pairs)
    return arm, DiagnosedMotors(arm, links, np.zeros(3), GRAVITY, terms, values, 25.0)


def test_friction_without_a_name_is_exported_as_far_as_simulators_hold_it():
    _, model = model_with()
    drivers = "speed of joint 2 and direction of motion of joint 2"
    curve = UnnamedTorque(2, drivers, 0.0, 1.5, "cubic*line", (-1.0, 1.0))
    # the straight line 0.4 + 0.2 |v| as such a process
    speeds, sign = np.tile(np.linspace(0.0, 1.5, 50), 2), np.repeat([-1.0, 1.0], 50)
    functions = np.asarray(curve.functions_at(np.stack([speeds, sign])))
    values = np.linalg.lstsq(functions.T, sign * (0.4 + 0.2 * speeds), rcond=None)[0]
    wide = CoulombFriction(3, 0.2)
    model = replace(model, terms=Terms((curve, wide)), values=np.concatenate([values, [0.5]]))
    found, left_out = diagnosed_arm(model)
    assert found.coulomb_friction[1] == pytest.approx(0.4, abs=0.02)
    assert found.viscous_friction[1] == pytest.approx(0.2, abs=0.02)
    assert found.coulomb_friction[2] == pytest.approx(0.5)
    assert [phrase.split(" at ")[-1] for phrase in left_out] == [
        "joint2, which its viscous and Coulomb friction leave",
        "joint3, 0.2 rad/s",
    ]


@pytest.mark.parametrize("suffix", [".urdf", ".xml", ".yaml"])
def test_what_was_found_stands_in_the_file(tmp_path, suffix):
    _, model = model_with(
        "viscous_friction:joint=2,viscous_Nm_s_per_rad=0.8",
        "coulomb_friction:joint=3,coulomb_Nm=0.5",
        "rotor_inertia:joint=5,inertia_kg_m2=0.02",
        "torque_offset:joint=1,offset_Nm=0.3",
        "link_mass:link=3,mass_kg=0.2",
        "joint_spring:joint=2,stiffness_Nm_per_rad=4.0,rest_rad=0.3",
        "joint_spring:joint=4,stiffness_Nm_per_rad=-0.5,rest_rad=0",
    )
    if suffix == ".xml":
        pytest.importorskip("mujoco")
    arm, left_out = diagnosed_arm(model)
    assert left_out == ("torque offset at joint1", "joint spring at joint4")  # one that pushes away is none
    done = convert_file(arm, tmp_path / f"arm{suffix}", left_out=left_out)
    again = read_arm(str(done.path))
    assert again.viscous_friction[1] == pytest.approx(0.8)
    assert again.coulomb_friction[2] == pytest.approx(0.5)
    assert again.mass[2] == pytest.approx(model.links[2, 0] + 0.2)
    np.testing.assert_allclose(again.spring_stiffness, [0, 4.0, 0, 0, 0, 0], rtol=1e-12)
    np.testing.assert_allclose(again.spring_rest, [0, 0.3, 0, 0, 0, 0], rtol=1e-12)
    phrases = {"rotor inertia", "springs, but for Gazebo's extension <gazebo reference=…>"}
    assert set(done.left_out) - set(left_out) == (phrases if suffix == ".urdf" else set())
    if suffix != ".urdf":
        assert again.rotor_inertia[4] == pytest.approx(0.02)
    assert done.difference < 1e-9


def test_the_arm_that_is_written_declares_what_was_found(tmp_path):
    """The torques of a model with effects are those of its arm, which declares them; and a second diagnosis adds up."""
    effects = (
        "viscous_friction:joint=2,viscous_Nm_s_per_rad=0.8",
        "coulomb_friction:joint=3,coulomb_Nm=0.5",
        "rotor_inertia:joint=5,inertia_kg_m2=0.02",
        "joint_spring:joint=4,stiffness_Nm_per_rad=2,rest_rad=0.3",
    )
    _, model = model_with(*effects)
    arm, left_out = diagnosed_arm(model)
    assert left_out == ()
    motion = motion_of(setup_of(2)[0], 1, rate=50.0, seconds=5.0)
    recording = Recording.from_arrays(motion.q, time=motion.time, joint_velocity=motion.dq, motion="trajectory")
    nothing = replace(model, arm=arm, terms=Terms(), values=np.zeros(0))
    declared = predict_torques(nothing, recording)
    np.testing.assert_allclose(declared, predict_torques(model, recording), rtol=0, atol=1e-9)
    assert np.abs(declared - predict_torques(replace(nothing, arm=model.arm), recording)).max() > 0.5
    convert_file(arm, tmp_path / "arm.yaml")
    again = predict_torques(replace(nothing, arm=read_arm(str(tmp_path / "arm.yaml"))), recording)
    np.testing.assert_allclose(again, declared, rtol=0, atol=1e-9)
    twice, _ = diagnosed_arm(replace(model, arm=arm))
    assert twice.viscous_friction[1] == pytest.approx(1.6)
    assert twice.coulomb_friction[2] == pytest.approx(1.0)
    assert (twice.spring_stiffness[3], twice.spring_rest[3]) == pytest.approx((4.0, 0.3))
    less, _ = diagnosed_arm(replace(model, arm=arm, values=-2 * model.values))
    assert less.viscous_friction[1] == 0.0  # no simulator takes less


def test_links_that_are_no_bodies_become_such_with_the_same_torques():
    declared, model = model_with()
    base = base_parameters(declared.kinematics, GRAVITY)
    silent = np.linalg.svd(base.basis.T)[2][base.size :]  # directions that no torque shows
    along = np.random.default_rng(0).normal(0, 1, len(silent)) @ silent
    size = next(s for s in np.geomspace(1e-3, 10, 60) if not is_consistent(model.links + s * along.reshape(-1, 10)))
    impossible = model.links + 2 * size * along.reshape(-1, 10)
    arm, left_out = diagnosed_arm(replace(model, links=impossible))
    found = np.asarray(link_parameters(arm))
    assert is_consistent(found)
    assert left_out == ()
    motion = motion_of(setup_of(2)[0], 1, rate=10.0, seconds=5.0)
    asked, has = (
        np.asarray(inverse_dynamics(arm.kinematics, links, motion.q.T, motion.dq.T, motion.ddq.T, GRAVITY))
        for links in (impossible, found)
    )
    np.testing.assert_allclose(has, asked, rtol=0, atol=1e-6 * np.abs(asked).max())
