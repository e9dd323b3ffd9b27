"""What the report ports say, to a plain socket and to the SDK; and that hidden physics is where it is said to be."""

import numpy as np
import pytest
from live import CONTROL_PORT, new_host, read_reports, snapshot, until
from scipy.interpolate import PPoly
from scipy.spatial.transform import Rotation

from lite6jax.controller import protocol
from lite6jax.effects.composition import Physics
from lite6jax.effects.serialization import parse_effect
from lite6jax.emulator import Controller, EmulatedArm, draw_sines, visit
from lite6jax.simulation.motions import Polynomials
from tests.oracles.chains import six_parameter_poses
from tests.oracles.gravity import gravity_moments


def emulated(body, **options):
    return Controller(body, **{"address": new_host(), "control_port": CONTROL_PORT, "speed": 40.0} | options)


@pytest.fixture(scope="module")
def sines(lite6):
    return draw_sines(lite6.arm, seed=5)


@pytest.fixture(scope="module")
def recorded(lite6, sines):
    """Twelve seconds of port 30000."""
    with emulated(lite6, path=sines) as controller:
        return read_reports(controller, 30000, 3000)


def seconds(records):
    return (records["time_us"].astype(float) - 60e6) / 1e6


def test_targets_are_the_path(recorded, sines):
    q, dq = sines.at(seconds(recorded))
    np.testing.assert_allclose(recorded["target_position"][:, :6], q, atol=3e-7)
    np.testing.assert_allclose(recorded["target_velocity"][:, :6], dq, atol=5e-7)
    assert not recorded["target_position"][:, 6].any()


def test_the_encoders_follow_two_samples_late(recorded):
    for actual, target in (("joint_position", "target_position"), ("joint_velocity", "target_velocity")):
        np.testing.assert_allclose(recorded[actual][2:], recorded[target][:-2], atol=1e-6)
    np.testing.assert_allclose(recorded["joint_acceleration"][2:], recorded["target_acceleration"][:-2], atol=2e-3)


def test_without_physics_the_pose_is_the_chain_at_the_encoders(recorded, lite6):
    T = six_parameter_poses(lite6.kinematics, recorded["joint_position"][:, :6].astype(float))
    np.testing.assert_allclose(recorded["pose"][:, :3], 1e3 * T[:, :3, 3], atol=2e-4)
    turn = Rotation.from_euler("xyz", recorded["pose"][:, 3:]).inv() * Rotation.from_matrix(T[:, :3, :3])
    assert turn.magnitude().max() < 2e-6
    T = six_parameter_poses(lite6.kinematics, recorded["target_position"][:, :6].astype(float))
    np.testing.assert_allclose(recorded["target_pose"][:, :3], 1e3 * T[:, :3, 3], atol=2e-4)


@pytest.mark.parametrize(("port", "count", "field"), [
    (30000, 500, "target_position"), (30001, 10, "joint_position"), (30002, 10, "joint_position"),
    (30003, 200, "joint_position"),
])  # fmt: skip
def test_ports_keep_their_rates(lite6, port, count, field):
    """Joint 1 turns evenly: it is the clock."""
    rate, start = [0.1, 0, 0, 0, 0, 0], [-3.0, 0, 1, 0, 0, 0]
    path = Polynomials(PPoly(np.array([[rate], [start]]), [0.0, 60.0]), 60.0)
    with emulated(lite6, path=path, speed=4.0) as controller:
        until(lambda: snapshot(controller).time > 0.1)
        turned = np.diff(read_reports(controller, port, count)[field][:, 0].astype(float))
    np.testing.assert_allclose(turned / 0.1, 1 / protocol.RATES[port], atol=1e-5)


def test_the_rich_report_through_the_sdk(lite6, connect):
    at_rest = np.array([0.3, 0.2, 1.0, 0.1, 0.5, 0.2])
    path = visit([at_rest, [0.3, 0.2, 1.0, 0.1, 0.5, 0.3]], pause=1e6)
    tool = [0, 0, 50, 0, 0, 0.25]
    with emulated(
        lite6, path=path, tool=tool, payload=[0.4, 0, 0, 20], speed=500.0, report_ports=(30002,)
    ) as controller:
        arm = connect(controller)
        until(lambda: arm.tcp_offset == tool)
        assert arm.tcp_load == [0.4, [0, 0, 20]]
        np.testing.assert_allclose(arm.angles[:6], at_rest, atol=1e-6)
        assert (arm.state, arm.mode, arm.error_code, arm.warn_code) == (1, 0, 0, 0)
        pose = arm.get_forward_kinematics(at_rest.tolist())[1]
        np.testing.assert_allclose(arm.position, pose, atol=1e-3)
        pose = arm.get_position()[1]
        np.testing.assert_allclose(arm.position, pose, atol=1e-3)
        assert arm.voltages == [24.0] * 7
        assert arm.currents[1] == pytest.approx(0.08 * arm.get_joints_torque()[1][1], abs=1e-5)
        np.testing.assert_allclose(arm.joints_torque, arm.get_joints_torque()[1], atol=1e-4)
        until(lambda: arm.temperatures[0] > 30)  # it warms up by 12 K with 1200 s: 600 s, compressed
        first, *_, sixth, none = arm.temperatures
        assert (first > sixth, none) == (True, 0)
        assert arm.joint_speed_limit[1] == pytest.approx(np.pi)
        assert all(arm.motor_enable_states[:6])


# ------------------------------------------------------------------------------------------ hidden physics


def hidden(lite6, *texts):
    """The same arm with physics."""
    parsed = [parse_effect(text) for text in texts]
    physics = Physics(tuple(effect for effect, _ in parsed))
    return EmulatedArm(lite6.arm, lite6.kinematics, physics, physics.join([values for _, values in parsed]))


def shown(body, path, count=600, **options):
    with emulated(body, path=path, **options) as controller:
        return read_reports(controller, 30000, count)


def assert_poses(records, T, atol=3e-4):
    np.testing.assert_allclose(records["pose"][:, :3], 1e3 * T[:, :3, 3], atol=atol)


def test_compliance_is_in_the_pose_and_nowhere_else(lite6, sines):
    records = shown(hidden(lite6, "joint_compliance:joint=2,compliance_rad_per_Nm=1e-3"), sines)
    q = records["joint_position"][:, :6].astype(float)
    np.testing.assert_allclose(q, sines.at(seconds(records) - 0.008)[0], atol=3e-7)
    np.testing.assert_allclose(
        records["target_pose"][:, :3],
        1e3 * six_parameter_poses(lite6.kinematics, records["target_position"][:, :6])[:, :3, 3],
        atol=2e-4,
    )
    inertia = {"mass": lite6.arm.mass, "center_of_mass": lite6.arm.center_of_mass, "gravity": np.array([0, 0, -9.81])}
    moments, _ = gravity_moments(lite6.kinematics, q, 0.0, inertia)
    q[:, 1] += 1e-3 * moments[:, 1, 2]
    assert_poses(records, six_parameter_poses(lite6.kinematics, q))


def test_backlash_remembers_the_last_direction_while_it_stands(lite6):
    """Each time the arm comes to a place from the other side, the link lies at the other end of the gap."""
    path = visit([[0, 0, 1, 0, 0, 0], [0.5, 0, 1, 0, 0, 0]], pause=0.5)
    records = shown(hidden(lite6, "joint_backlash:joint=1,gap_rad=0.01"), path, 2500)
    q = records["joint_position"][:, :6].astype(float)
    still = np.abs(records["joint_velocity"][:, 0]) == 0
    first_move = np.argmax(~still)
    direction = np.sign(records["joint_velocity"][:, 0].astype(float))
    for k in range(1, len(direction)):
        direction[k] = direction[k] or direction[k - 1]
    assert {direction[k] for k in np.flatnonzero(still) if k > first_move} == {-1.0, 1.0}
    q[:, 0] -= 0.005 * direction
    assert_poses(records[first_move:], six_parameter_poses(lite6.kinematics, q[first_move:]))


def test_a_lag_and_a_clock_that_is_off(lite6, sines):
    lag = shown(hidden(lite6, "joint_lag:joint=1,lag_s=0.02"), sines)
    q = lag["joint_position"][:, :6].astype(float)
    q[:, 0] -= 0.02 * lag["joint_velocity"][:, 0]
    assert_poses(lag, six_parameter_poses(lite6.kinematics, q))
    late = shown(hidden(lite6, "time_offset:offset_s=-0.05"), sines)
    assert_poses(late, six_parameter_poses(lite6.kinematics, sines.at(seconds(late) - 0.008 - 0.05)[0]), atol=3e-3)
    early = shown(hidden(lite6, "time_offset:offset_s=0.05"), sines)
    assert_poses(early, six_parameter_poses(lite6.kinematics, sines.at(seconds(early) - 0.008 + 0.05)[0]), atol=3e-3)
