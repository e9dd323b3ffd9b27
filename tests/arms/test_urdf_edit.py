"""An existing URDF with other numbers: Pinocchio finds the chain and the torques of the arm in it."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from arms.test_urdf import heavy, joint, link, write

from lite6jax.arms import frames
from lite6jax.arms.dynamics import inverse_dynamics, link_parameters
from lite6jax.arms.urdf import read_urdf, write_into_urdf
from lite6jax.errors import InputError
from tests.oracles.chains import six_parameter_poses
from tests.oracles.pinocchio_arm import urdf_link_pose
from tests.oracles.pinocchio_dynamics import pinocchio_torques


def moved(rng, row):
    """A row a millimetre and a milliradian away."""
    return frames.row_from_transform(
        frames.transform_from_row(row) @ frames.transform_from_row(1e-3 * rng.normal(size=6))
    )


@pytest.fixture
def robot(tmp_path):
    """Odd axes, a fixed joint in the chain, bodies fixed beside it, and a tip that a fixed joint leads to."""
    parts = [link("base"), heavy("a", 2, "0.1 0 0.02", "0.3 -0.2 1"), heavy("cover", 1, "0 0.05 0.1", "0 1 0.4")]
    parts += [heavy("b", 3, "0 0.2 0", "1 1 1"), heavy("hand", 0.5, "0.01 0.02 0.03", "0.5 0 0"), link("tool")]
    parts += [joint("j1", "base", "a", axis="0 -1 0", rpy="0.2 0 0", extra='<dynamics damping="0.7"/>')]
    parts += [joint("weld", "a", "cover", "fixed", xyz="0 0.5 0", rpy="1.2 0.3 0")]
    parts += [joint("j2", "cover", "b", xyz="0.3 0 0", axis="1 2 -3"), joint("f2", "b", "hand", "fixed", rpy="0 0 1")]
    return write(tmp_path, *parts, joint("f4", "hand", "tool", "fixed", xyz="0.1 0 0"))


def test_the_file_is_the_arm(robot, tmp_path):
    rng = np.random.default_rng(0)
    old = read_urdf(robot, tip="tool")
    tail = frames.transform_from_row(moved(rng, frames.row_from_transform(old.T_joint_flange)))
    arm = replace(
        old,
        kinematics=np.array([moved(rng, row) for row in old.kinematics]),
        T_joint_flange=tail,
        mass=old.mass * 1.1,
        center_of_mass=old.center_of_mass + 0.01,
        inertia=old.inertia * 1.2,
        viscous_friction=np.array([0.9, 0.4]),
        rotor_inertia=np.array([0.1, 0.1]),
    )
    path = tmp_path / "new.urdf"
    assert write_into_urdf(arm, robot, path, tip="tool") == ["rotor inertia"]
    q = rng.uniform(-2, 2, (10, 2))
    shown = np.array([urdf_link_pose(path, "tool")(row) for row in q])
    np.testing.assert_allclose(shown, six_parameter_poses(arm.kinematics, q) @ tail, rtol=0, atol=1e-12)
    motion = rng.normal(0, 2, (3, 2, 20))
    model = pin.buildModelFromUrdf(str(path))
    wanted = inverse_dynamics(arm.kinematics, link_parameters(arm), *motion, model.gravity.linear)
    np.testing.assert_allclose(pinocchio_torques(model, *motion), wanted, rtol=0, atol=1e-10)
    assert '<dynamics damping="0.9"' in path.read_text()
    np.testing.assert_array_equal(read_urdf(path, tip="tool").viscous_friction, [0.9, 0.4])


def test_what_does_not_change_stays_as_it_is_written(robot, tmp_path):
    arm = replace(read_urdf(robot, tip="tool"), viscous_friction=None, mass=None, center_of_mass=None, inertia=None)
    path = tmp_path / "new.urdf"
    assert write_into_urdf(arm, robot, path, tip="tool") == []
    assert (
        path.read_text().split("\n", 1)[1].replace(" ", "")
        == robot.read_text().split("?>", 1)[1].replace(" ", "") + "\n"
    )


def test_a_chain_without_a_fixed_joint_at_its_end_keeps_it(tmp_path):
    robot = write(tmp_path, link("base"), link("a"), joint("j1", "base", "a"))
    arm = read_urdf(robot)
    arm = replace(arm, T_joint_flange=frames.transform_from_row([0, 0, 0.1, 0, 0, 0]))
    left_out = write_into_urdf(arm, robot, tmp_path / "new.urdf")
    assert left_out == ["what follows the last joint (no fixed joint leads to a)"]


def test_another_number_of_joints_is_refused(robot, tmp_path):
    arm = read_urdf(robot, tip="a")
    with pytest.raises(InputError, match=r"has 2 joints from base to tool, but arm has 1"):
        write_into_urdf(arm, robot, tmp_path / "new.urdf", tip="tool")
