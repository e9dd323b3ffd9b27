"""Simulated recordings against an independent generator, their noise against its statistics, and the command."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typed
import yaml
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from typed import refusal

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_arms, load_bundled
from lite6jax.arms.factory import read_factory, write_factory
from lite6jax.calibration.fit import fit_recording
from lite6jax.effects import user_effects
from lite6jax.effects.composition import Physics
from lite6jax.effects.serialization import parse_effect
from lite6jax.errors import InputError
from lite6jax.recordings import RecordingSettings, read_recording
from lite6jax.sensors.usual import plan_sensor
from lite6jax.simulation import (
    INSTRUMENTS,
    UndeclaredNoise,
    draw_calibration,
    draw_motion,
    draw_sensor_frame,
    measure,
    simulate,
)
from lite6jax.simulation.motions import SPEED
from tests.oracles.chains import six_parameter_poses
from tests.oracles.effects import predicted_poses
from tests.oracles.transforms import origin_transform

ROOT = Path(__file__).resolve().parents[1]
LITE6 = load_bundled("lite6")
NO_NOISE = UndeclaredNoise(factor=0.0)
PROBABLE = (1e-5, 1 - 1e-5)
"""Of statistics of fixed seeds: outside, the generator is wrong."""


def physics_of(*texts):
    """Effects of the library, their values, and what the plain generator takes."""
    parsed = [parse_effect(text) for text in texts]
    physics = Physics(tuple(effect for effect, _ in parsed))
    plain = []
    for text in texts:
        name, _, rest = text.partition(":")
        plain.append((name, {k: float(v) for k, v in (item.split("=") for item in rest.split(","))}))
        for key in {"joint", "link"} & set(plain[-1][1]):
            plain[-1][1][key] = int(plain[-1][1][key])
    return physics, physics.join([values for _, values in parsed]), plain


def likely(sum_of_squares, count):
    """Whether a sum of squares of `count` independent standard normal numbers is what such sums are."""
    low, high = chi2.ppf(PROBABLE, count)
    return low < sum_of_squares < high


# ------------------------------------------------------------------ motions


@pytest.mark.parametrize("name", ["lite6", "xarm7", "ur10e"])
def test_static_poses_fill_the_ranges_from_both_sides(name):
    arm = load_bundled(name)
    motion = draw_motion(arm, "static", 200, seed=3)
    q = motion.joint_position
    assert motion.motion == "static"
    assert motion.position is None
    assert motion.joint_velocity is None
    lower, upper = arm.joint_limits.T
    width = np.minimum(upper - lower, 2 * np.pi)
    start = (lower + upper - 0.9 * width) / 2
    cell = np.sort(np.floor((q - start) / (0.9 * width) * 200).astype(int), axis=0)
    np.testing.assert_array_equal(cell, np.tile(np.arange(200), (arm.dof, 1)).T)  # each joint once in each cell
    assert (abs((motion.direction_of_motion > 0).mean(0) - 0.5) < 0.1).all()
    assert (abs(np.corrcoef(q.T) - np.eye(arm.dof)) < 0.3).all()
    np.testing.assert_array_equal(motion.time, 8.0 * np.arange(200))


@pytest.mark.parametrize("name", bundled_arms())
def test_trajectories_keep_limits_and_speed_and_start_from_rest(name):
    arm = load_bundled(name)
    motion = draw_motion(arm, "trajectory", 1200, runs=3, seed=4)
    q, dq, t = motion.joint_position, motion.joint_velocity, motion.time
    assert dq is not None
    assert t is not None
    assert motion.motion == "trajectory"
    assert (q >= arm.joint_limits[:, 0]).all()
    assert (q <= arm.joint_limits[:, 1]).all()
    assert abs(dq).max() <= SPEED
    assert abs(dq).max() > 0.2 * SPEED
    np.testing.assert_array_equal(motion.run, np.repeat([0, 1, 2], 400))
    for run in range(3):
        rows = slice(400 * run, 400 * run + 400)
        np.testing.assert_array_equal(dq[rows][0], 0)
        np.testing.assert_allclose(np.diff(t[rows]), 0.02, atol=1e-12)
        # Simpson's rule over pairs of steps: the velocities are the positions' derivative
        v = dq[rows]
        simpson = (v[:-2] + 4 * v[1:-1] + v[2:]) * 0.02 / 3
        np.testing.assert_allclose(q[rows][2:] - q[rows][:-2], simpson, atol=2e-6)
    np.testing.assert_allclose(t[[400, 800]] - t[[399, 799]], 5.0, atol=1e-12)
    assert abs(q[0] - q[400]).max() > 0.1  # another motion in every run


def test_payload_and_warmth_follow_the_schedule():
    motion = draw_motion(LITE6, "static", 90, payload=[0.0, 0.3, 1.0], warm_up=18.0)
    np.testing.assert_array_equal(motion.payload, np.repeat([0.0, 0.3, 1.0], 30))
    temperature = motion.joint_temperature
    assert temperature is not None
    np.testing.assert_array_equal(temperature[0], 25.0)
    share = 1 - np.exp(-3 * np.arange(90) / 89)
    np.testing.assert_allclose(temperature[:, 0], 25 + 18 * share, atol=1e-12)
    np.testing.assert_allclose(temperature[:, 5] - 25, 0.8 * (temperature[:, 0] - 25), atol=1e-12)
    assert draw_motion(LITE6).joint_temperature is None


def test_each_purpose_has_its_own_chance():
    a = simulate(LITE6, samples=30, seed=5)
    b = simulate(LITE6, samples=30, seed=5, sensor="camera", undeclared=UndeclaredNoise(outlier_share=0.2))
    again = simulate(LITE6, samples=30, seed=5)
    np.testing.assert_array_equal(a.joint_position, b.joint_position)
    np.testing.assert_array_equal(a.position, again.position)
    assert abs(a.joint_position - simulate(LITE6, samples=30, seed=6).joint_position).max() > 1


# ------------------------------------------------------------------ poses: an independent generator

EFFECTS = (
    "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",
    "joint_harmonic:joint=1,order=2,amplitude_rad=6e-4,phase_rad=0.7",
    "joint_backlash:joint=4,gap_rad=1.2e-3",
    "link_compliance:link=3,compliance_x_rad_per_Nm=2e-5,compliance_y_rad_per_Nm=3e-5",
    "link_thermal_expansion:expansion_per_K=2.3e-5",
    "base_compliance:compliance_x_rad_per_Nm=1e-5,compliance_y_rad_per_Nm=2e-5",
    "base_drift:vx_m_per_s=1e-7,vy_m_per_s=0,vz_m_per_s=-2e-7",
    "tool_offset:x_m=1e-3,y_m=0,z_m=4e-3",
    "measurement_scale:scale=1e-4",
    "payload_error:mass_kg=0.2",
)
MOVING = ("joint_lag:joint=5,lag_s=2e-3", "time_offset:offset_s=0.012")


@pytest.mark.parametrize(("kind", "texts"), [("static", EFFECTS), ("trajectory", EFFECTS + MOVING)])
def test_poses_are_those_of_an_independent_generator(kind, texts):
    gravity, center = (0.3, -0.4, -9.7), (0.01, 0.02, 0.05)
    arm = replace(LITE6, T_joint_flange=origin_transform([0, 0, 0.01, 0.1, 0, 0.2]), dh=None)
    settings = RecordingSettings(gravity_m_per_s2=gravity, payload_com_m=center)
    motion = draw_motion(arm, kind, 60, runs=2, payload=[0.0, 1.0], warm_up=15.0, settings=settings, seed=7)
    chain = draw_calibration(arm, 8)
    T_sensor_base = draw_sensor_frame(9)
    tool = [0.01, -0.02, 0.1, 0.1, -0.2, 0.3]
    physics, values, plain = physics_of(*texts)
    measured = measure(
        motion, arm, physics, values, kinematics=chain, sensor="tracker_6d", undeclared=NO_NOISE,
        T_sensor_base=T_sensor_base, tool=tool,
    )  # fmt: skip

    told = {
        "joint_position": motion.joint_position,
        "joint_velocity": motion.joint_velocity,
        "direction": motion.direction_of_motion,
        "time": motion.time,
        "run": motion.run,
        "joint_temperature": motion.joint_temperature,
        "payload": motion.payload,
    }
    told = {name: value for name, value in told.items() if value is not None}
    inertia = {
        "mass": LITE6.mass,
        "center_of_mass": LITE6.center_of_mass,
        "payload_center": (arm.T_joint_flange @ [*center, 1.0])[:3],
        "gravity": np.array(gravity),
    }
    T_flange_tool = arm.T_joint_flange @ origin_transform(tool)
    oracle = predicted_poses(chain, T_sensor_base, T_flange_tool, told, inertia, plain)
    rigid = predicted_poses(chain, T_sensor_base, T_flange_tool, told, inertia, [])
    np.testing.assert_allclose(measured.poses, oracle, atol=1e-10)
    np.testing.assert_allclose(measured.rigid, rigid, atol=1e-12)
    recording = measured.recording
    np.testing.assert_allclose(recording.position, oracle[:, :3, 3], atol=1e-10)
    turned = Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()
    np.testing.assert_allclose(turned, oracle[:, :3, :3], atol=1e-10)
    np.testing.assert_array_equal(recording.joint_position, motion.joint_position)
    np.testing.assert_array_equal(recording.direction_of_motion, motion.direction_of_motion)

    distance = np.linalg.norm(oracle[:, :3, 3] - rigid[:, :3, 3], axis=1)
    np.testing.assert_allclose(measured.displacement, distance, atol=1e-10)
    angle = Rotation.from_matrix(np.swapaxes(rigid[:, :3, :3], 1, 2) @ oracle[:, :3, :3]).magnitude()
    np.testing.assert_allclose(measured.rms, np.sqrt([np.mean(distance**2), np.mean(angle**2)]), atol=1e-9)


def test_rows_beyond_the_motion_are_dropped_and_counted():
    physics, values, _ = physics_of("time_offset:offset_s=0.5")
    motion = draw_motion(LITE6, "trajectory", 200, runs=2)
    measured = measure(motion, LITE6, physics, values)
    # the last 0.5 s of each run, but for the one step beyond that is extrapolated
    assert measured.recording.samples == 200 - 2 * 24
    assert len(measured.poses) == len(measured.rigid) == len(measured.outlier) == 152
    assert measured.recording.notes == ("dropped 48 rows whose instant lies beyond the motion, by a clock's offset",)
    assert refusal(measure, motion, LITE6, physics, values * 100) == (
        "simulation: at every row the clock offset requires the motion beyond its ends; give a smaller offset or a "
        "longer motion"
    )


# ------------------------------------------------------------------ one call


def test_a_call_simulates_given_joint_positions_with_effects_as_text_or_with_values():
    q = np.random.default_rng(0).uniform(*(0.9 * LITE6.joint_limits.T), (40, 6))
    text = "joint_harmonic:joint=1,order=2,amplitude_rad=6e-4,phase_rad=0.7"
    physics, values, _ = physics_of(text)
    given = {"kinematics": draw_calibration(LITE6, 1), "undeclared": NO_NOISE, "payload": [0.0, 0.5]}
    recording = simulate("lite6", q, effects=[text], **given)
    np.testing.assert_array_equal(recording.joint_position, q)
    np.testing.assert_array_equal(recording.payload, np.repeat([0.0, 0.5], 20))
    np.testing.assert_array_equal(recording.time, 8.0 * np.arange(40))
    off = q.copy()
    off[:, 0] += 6e-4 * np.sin(2 * q[:, 0] + 0.7)
    oracle = six_parameter_poses(given["kinematics"], off)
    np.testing.assert_allclose(recording.position, oracle[:, :3, 3], atol=1e-10)
    pair = simulate("lite6", q, effects=[(physics.effects[0], values)], **given)
    np.testing.assert_array_equal(pair.position, recording.position)


def test_a_trajectory_through_given_joint_positions_has_velocities():
    time = np.arange(50) * 0.05
    q = np.sin(time)[:, None] * np.linspace(0.1, 0.6, 6)
    recording = simulate(LITE6, q, motion="trajectory", time=time, effects=["joint_lag:joint=3,lag_s=2e-3"])
    np.testing.assert_allclose(recording.joint_velocity, np.gradient(q, time, axis=0, edge_order=2), atol=1e-12)
    assert recording.motion == "trajectory"


def test_noise_that_is_given_is_declared_and_true():
    recording = simulate(
        LITE6, samples=500, sensor="camera", position_noise=3e-4, orientation_noise=4e-3, joint_noise=1e-5, seed=2
    )
    settings = recording.settings
    declared = (settings.position_noise_m, settings.orientation_noise_rad, settings.joint_noise_rad)
    assert declared == (3e-4, 4e-3, 1e-5)
    motion = draw_motion(LITE6, samples=500, seed=2)
    error = recording.position - six_parameter_poses(LITE6.kinematics, motion.joint_position)[:, :3, 3]
    assert likely(np.sum(error**2) / 9e-8, 1500)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"joint_position": np.full((4, 6), 30.0)}, "joint_position: row 1 is at 30 rad while the arm's joint 1 goes"),
        ({"joint_position": np.full((4, 6), 30.0)}, "are these degrees? give radians: np.deg2rad(joint_position)"),
        ({"joint_position": np.zeros((4, 6)) * 1j}, "joint_position: holds complex numbers; give real ones"),
        ({"joint_position": np.zeros((4, 5))}, "joint_position of shape (4, 5): lite6 takes (sample, 6)"),
        ({"joint_position": [[0.0] * 6, [np.nan] * 6]}, "joint_position: row 2 is not finite; leave it out"),
        ({"joint_position": np.zeros((4, 6)), "time": [0.0]}, "time of shape (1,): give (4,) finite numbers, in s"),
        ({"joint_position": np.zeros((4, 6)), "samples": 4}, "samples and runs: belong to a drawn motion; leave them"),
        ({"time": [0.0]}, "time: belongs to given joint positions; give joint_position as well, or leave it out"),
        ({"arm": "lite7"}, "lite7: neither a bundled arm nor a file"),
        ({"sensor": "laser"}, "sensor 'laser': is none of tracker"),
        ({"position_noise": 0.0}, "position noise 0.0: give one standard deviation in m, above 0"),
        ({"effects": ["joint_wobble:joint=1"]}, "effect 'joint_wobble': unknown; the catalogue has joint_offset"),
        ({"effects": ["joint_lag:joint=1,lag_s=1e-3"]}, "joint velocities; simulate with motion='trajectory'"),
        (
            {"effects": ["link_thermal_expansion:expansion_per_K=2e-5"]},
            "link_thermal_expansion:links: depends on temperatures that rise; give warm_up, such as 15 K",
        ),
    ],
)
def test_what_a_call_refuses(given, message):
    assert message in refusal(simulate, **{"arm": "lite6"} | given)


# ------------------------------------------------------------------ noise


def errors_of(measured):
    """What a sensor added: positions (m) and rotation vectors (rad), both in the sensor's or the tool's axes."""
    recording = measured.recording
    position = recording.position - measured.poses[:, :3, 3]
    turned = Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()
    return position, Rotation.from_matrix(np.swapaxes(measured.poses[:, :3, :3], 1, 2) @ turned).as_rotvec()


@pytest.mark.parametrize("factor", [1.0, 2.5])
def test_noise_is_white_and_of_the_declared_size(factor):
    motion = draw_motion(LITE6, samples=1500)
    measured = measure(motion, LITE6, sensor="motion_capture", undeclared=UndeclaredNoise(factor=factor), seed=1)
    settings = measured.recording.settings
    assert (settings.position_noise_m, settings.orientation_noise_rad) == (2e-4, 1e-3)
    for error, sigma in zip(errors_of(measured), (2e-4, 1e-3), strict=True):
        white = error / (sigma * factor)
        for axis in white.T:
            assert likely(np.sum(axis**2), 1500)
            assert abs(np.mean(axis)) < 4.5 / np.sqrt(1500)
            assert abs(np.mean(axis[1:] * axis[:-1])) < 4.5 / np.sqrt(1500)
        assert (abs(np.corrcoef(white.T) - np.eye(3)) < 4.5 / np.sqrt(1500)).all()


def test_noise_that_is_correlated_starts_anew_in_each_run():
    motion = draw_motion(LITE6, "trajectory", 4000, runs=1000)
    measured = measure(motion, LITE6, sensor="motion_capture", undeclared=UndeclaredNoise(correlation=0.8), seed=2)
    for error, sigma in zip(errors_of(measured), (2e-4, 1e-3), strict=True):
        runs = (error / sigma).reshape(1000, 4, 3)
        for k in range(4):  # of the same variance everywhere in a run
            assert likely(np.sum(runs[:, k] ** 2), 3000)
        innovation = (runs[:, 1:] - 0.8 * runs[:, :-1]) / 0.6
        assert likely(np.sum(innovation**2), 9000)
        assert abs(np.mean(innovation * runs[:, :-1])) < 4.5 / np.sqrt(9000)
        assert abs(np.mean(runs[1:, 0] * runs[:-1, 3])) < 4.5 / np.sqrt(2997)


def test_noise_that_grows_with_the_distance_from_the_base():
    motion = draw_motion(LITE6, samples=2000)
    T = draw_sensor_frame(1)
    measured = measure(
        motion, LITE6, sensor="tracker_6d", undeclared=UndeclaredNoise(growth_per_m=3.0), T_sensor_base=T, seed=3
    )
    distance = np.linalg.norm(six_parameter_poses(LITE6.kinematics, motion.joint_position)[:, :3, 3], axis=1)
    for error, sigma in zip(errors_of(measured), (2e-5, 1e-4), strict=True):
        white = error / (sigma * (1 + 3 * distance[:, None]))
        near, far = distance < np.median(distance), distance >= np.median(distance)
        assert likely(np.sum(white[near] ** 2), 3000)
        assert likely(np.sum(white[far] ** 2), 3000)


@pytest.mark.parametrize(("declared", "hidden"), [(3e-5, 0.0), (0.0, 4e-5), (3e-5, 4e-5)])
def test_read_outs_of_the_joints_are_noisy_and_the_poses_are_not(declared, hidden):
    sensor = INSTRUMENTS["tracker"].with_noise(joint=declared)
    motion = draw_motion(LITE6, samples=500)
    measured = measure(motion, LITE6, sensor=sensor, undeclared=UndeclaredNoise(joint_noise=hidden), seed=4)
    assert measured.recording.settings.joint_noise_rad == declared
    read_out = measured.recording.joint_position - motion.joint_position
    assert likely(np.sum(read_out**2) / (declared**2 + hidden**2), 3000)
    rigid = six_parameter_poses(LITE6.kinematics, motion.joint_position)
    np.testing.assert_allclose(measured.poses, rigid, atol=1e-12)


def test_outliers_are_as_many_and_as_large_as_asked():
    motion = draw_motion(LITE6, samples=400)
    wild = UndeclaredNoise(factor=0.0, outlier_share=0.05, outlier_size=4e-3)
    measured = measure(motion, LITE6, sensor="tracker_6d", undeclared=wild, seed=5)
    position, turn = (np.linalg.norm(error, axis=1) for error in errors_of(measured))
    assert measured.outlier.sum() == 20
    assert position[~measured.outlier].max() < 1e-15
    assert turn[~measured.outlier].max() < 1e-14
    assert position[measured.outlier].min() >= 2e-3
    assert position[measured.outlier].max() <= 8e-3
    np.testing.assert_allclose(turn[measured.outlier], position[measured.outlier] / 0.1, rtol=1e-9)


# ------------------------------------------------------------------ settings and fits


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_the_settings_say_what_the_sensor_is(name):
    recording = simulate(LITE6, samples=20, sensor=name)
    settings, instrument = recording.settings, INSTRUMENTS[name]
    assert settings == RecordingSettings(
        arm="lite6", joint_source="measured", pose_source=instrument.source, motion="static", pose_frame="base",
        tool="none", position_noise_m=instrument.position_noise,
        orientation_noise_rad=instrument.orientation_noise,
    )  # fmt: skip
    assert (recording.quaternion is None) == (name == "tracker")
    assert recording.source == "simulation"


def test_the_settings_say_where_sensor_and_tool_are():
    tool = [0.01, 0.0, 0.1, 0.0, 0.0, 0.3]
    T = draw_sensor_frame(0)
    assert simulate(LITE6, samples=20, tool=tool).settings.tool == tuple(tool)
    hidden = simulate(LITE6, samples=20, tool=tool, tool_known=False, T_sensor_base=T)
    assert (hidden.settings.tool, hidden.settings.pose_frame) == ("unknown", "unknown")
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-14)
    assert 1.5 <= np.linalg.norm(T[:2, 3]) <= 3


def test_a_fit_without_physics_attains_the_cramer_rao_bound():
    # the whitened distance of a least-squares fit from the truth, at the fitted poses, is a chi-square of as many
    # degrees of freedom as there are numbers to fit: the bound, attained
    total, numbers = 0.0, 0
    for seed in range(3):
        chain = draw_calibration(LITE6, seed)
        recording = simulate(LITE6, samples=120, kinematics=chain, sensor="tracker_6d", seed=seed)
        solution = fit_recording(recording, loss="least_squares")
        truth = six_parameter_poses(chain, recording.joint_position)
        found = solution.predict(recording.joint_position)
        moved = found[:, :3, 3] - truth[:, :3, 3]
        turned = Rotation.from_matrix(np.swapaxes(truth[:, :3, :3], 1, 2) @ found[:, :3, :3]).as_rotvec()
        total += np.sum((moved / 2e-5) ** 2) + np.sum((turned / 1e-4) ** 2)
        numbers += int(solution.free.sum())
        assert np.linalg.norm(moved, axis=1).max() < 5e-5
    assert likely(total, numbers)


# ------------------------------------------------------------------ refusals


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"samples": 0}, "simulation: 0 samples in 1 runs; give at least 1 a run, and one run"),
        ({"samples": 5, "runs": 3, "kind": "trajectory"}, "5 samples in 3 runs; give at least 2 a run, and one run"),
        ({"runs": 0}, "400 samples in 0 runs; give at least 1 a run, and one run"),
        ({"step": 0.0}, "simulation: step is 0.0; give a number above 0"),
        ({"speed": float("nan")}, "simulation: speed is nan; give a number above 0"),
        ({"payload": -1.0}, "simulation: payload -1.0; give masses in kg, 0 or more"),
        ({"payload": []}, "simulation: payload []; give masses in kg, 0 or more"),
        ({"warm_up": float("inf")}, "simulation: warm_up is inf; give a number of K"),
        ({"seed": -1}, "seed -1: give zero or more"),
    ],
)
def test_motions_that_cannot_be(options, message):
    assert message in refusal(draw_motion, LITE6, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"factor": -1.0}, "simulation: factor is -1.0; give a number, 0 or more"),
        ({"growth_per_m": float("nan")}, "simulation: growth_per_m is nan; give a number, 0 or more"),
        ({"correlation": 1.0}, "simulation: correlation is 1.0; give a number, 0 to below 1"),
        ({"outlier_share": 1.5}, "simulation: outlier_share is 1.5; give a number, 0 to 1"),
    ],
)
def test_noise_that_cannot_be(options, message):
    assert refusal(UndeclaredNoise, **options) == message


def test_measurements_that_cannot_be():
    motion = draw_motion(LITE6, samples=10)
    compliance, value, _ = physics_of("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5")
    assert refusal(measure, motion, LITE6, sensor="laser") == (
        "simulation: sensor 'laser': is none of tracker, tracker_6d, motion_capture, camera, controller_fk, "
        "contact, plane, distance, axis, fixed_camera, flange_camera"
    )
    gauge = plan_sensor("axis", 1e-6)
    assert "a sensor of axis has no place in a recording; give one of positions" in refusal(
        measure, motion, LITE6, sensor=gauge
    )
    assert (
        refusal(measure, motion, LITE6, compliance)
        == "simulation: values []; give 1 finite numbers, one per coordinate"
    )
    assert "give 1 finite numbers" in refusal(measure, motion, LITE6, compliance, value * np.nan)
    assert refusal(measure, motion, load_bundled("xarm7")) == (
        "simulation: has 6 joints, but xarm7 has 7; give a motion of it"
    )
    assert "kinematics has the shape (5, 6); give (6, 6)" in refusal(
        measure, motion, LITE6, kinematics=LITE6.kinematics[1:]
    )
    massless = Arm("lite6", LITE6.kinematics)
    assert refusal(measure, motion, massless, compliance, value) == (
        "joint_compliance:joint2: needs the gravity torque of joint 2: give the masses of the links; add `inertial` to "
        "the arm's description"
    )


# ------------------------------------------------------------------ the command

COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"


def run(capsys, *arguments):
    return typed.run(capsys, "simulate", *arguments)


def command_refused(capsys, *arguments):
    return typed.refused(capsys, "simulate", *arguments)


def test_the_command_writes_what_the_library_simulates(capsys, tmp_path):
    out = tmp_path / "run.csv"
    code, said, err = run(
        capsys, "lite6", "--effect", COMPLIANCE, "--tolerance", "--samples", 50, "--seed", 3, "--out", out
    )
    assert (code, err) == (0, "")
    factory = read_factory(tmp_path / "run_factory.yaml")
    np.testing.assert_array_equal(factory.kinematics, draw_calibration(LITE6, 3))
    off = (factory.kinematics - LITE6.kinematics) / np.array([0.8e-3] * 3 + [np.deg2rad(0.15)] * 3)
    assert likely(np.sum(off**2), 36)

    physics, values, _ = physics_of(COMPLIANCE)
    settings = RecordingSettings(factory_calibration="run_factory.yaml")
    motion = draw_motion(LITE6, samples=50, settings=settings, seed=3)
    measured = measure(motion, LITE6, physics, values, kinematics=factory.kinematics, seed=3)
    read = read_recording(out)
    assert read.settings == measured.recording.settings
    assert read.notes == ()
    for name in ("joint_position", "position", "time", "direction_of_motion", "payload"):
        np.testing.assert_array_equal(getattr(read, name), getattr(measured.recording, name))

    distance = 1e3 * measured.displacement
    rms = 1e3 * measured.rms[0]
    flat = " ".join(said.split())
    assert flat.startswith("Simulated 50 positions of a lite6 by laser tracker, static. Geometry: as drawn.")
    assert "joint_compliance at joint2: compliance_rad_per_Nm = 9e-05" in flat
    assert f"The effects displace the measured point by {rms:.4f} mm RMS ({distance.max():.4f} mm at most)" in flat
    for name in ("run.csv", "run.yaml", "run_factory.yaml"):
        assert f"Wrote {tmp_path / name}\n" in said


def test_everything_the_command_can_hide_is_said(capsys, tmp_path):
    out = tmp_path / "run.parquet"
    code, said, _ = run(
        capsys, "lite6", "--effect", "joint_backlash:joint=4,gap_rad=1e-3", "--effect", "time_offset:offset_s=0.012",
        "--sensor", "motion_capture", "--motion", "trajectory", "--samples", 200, "--runs", 2, "--step", 0.015,
        "--speed", 90, "--payload", 0, 1, "--payload-at", 0, 0, 50, "--warm-up", 10, "--frame", "unknown",
        "--tool", "unknown", "--tool-at", 10, 0, 50, "--tolerance", "--geometry", "unknown", "--position-noise", 0.1,
        "--orientation-noise", 0.01, "--joint-noise", 0.001, "--out", out,
    )  # fmt: skip
    assert code == 0
    flat = " ".join(said.split())
    assert "Simulated 200 poses of a lite6 by motion capture, trajectory in 2 runs." in flat
    assert "Geometry: as drawn, not declared. Sensor frame: unknown. Tool: unknown." in flat
    assert "Noise, as declared: 0.1 mm, 0.01 deg, joints 0.001 deg." in flat
    assert max(map(len, said.splitlines()[:-3])) <= 80
    recording = read_recording(out)
    settings = recording.settings
    assert (settings.pose_frame, settings.tool, settings.factory_calibration) == ("unknown", "unknown", None)
    assert (settings.pose_source, settings.joint_source) == ("motion_capture", "measured")
    noise = (settings.position_noise_m, settings.orientation_noise_rad, settings.joint_noise_rad)
    np.testing.assert_allclose(noise, [1e-4, np.deg2rad(0.01), np.deg2rad(0.001)], rtol=1e-12)
    assert settings.payload_com_m == (0.0, 0.0, 0.05)
    assert recording.joint_temperature is not None
    assert recording.joint_velocity is not None
    assert abs(recording.joint_velocity).max() <= np.deg2rad(90)
    np.testing.assert_array_equal(recording.payload, np.repeat([0.0, 1.0], 100))
    np.testing.assert_array_equal(recording.run, np.repeat([0, 1], 100))
    assert recording.time is not None
    np.testing.assert_allclose(np.diff(recording.time[:100]), 0.015, atol=1e-12)


def test_a_given_calibration_is_named_from_where_the_sidecar_stands(capsys, tmp_path):
    own = tmp_path / "arms" / "arm.yaml"
    own.parent.mkdir()
    write_factory(draw_calibration(LITE6, 1), own)
    (tmp_path / "runs").mkdir()
    out = tmp_path / "runs" / "run.csv"
    code, said, _ = run(
        capsys, "lite6", "--factory", own, "--factory-uncertainty", 0.05, 0.01, "--samples", 40,
        "--sensor", "tracker_6d", "--tool-at", 0, 0, 100, "--out", out,
    )  # fmt: skip
    assert code == 0
    assert "No effects: the arm is rigid." in said
    assert ", within its declared uncertainty." in " ".join(said.split())
    settings = read_recording(out).settings
    assert settings.factory_calibration == "../arms/arm.yaml"
    assert settings.factory_uncertainty is not None
    np.testing.assert_allclose(settings.factory_uncertainty.position_m, 5e-5, rtol=1e-12)
    np.testing.assert_allclose(settings.factory_uncertainty.rotation_rad, np.deg2rad(0.01), rtol=1e-12)
    np.testing.assert_allclose(settings.tool, [0, 0, 0.1, 0, 0, 0], atol=1e-15)
    # the arm is as far from its calibration as declared: with that prior a fit leaves the sensor's noise only
    solution = fit_recording(read_recording(out), loss="least_squares")
    assert solution.nominal_errors.position_rms > 4 * 2e-5
    assert solution.errors.position_rms < 2 * 2e-5
    assert sorted(path.name for path in out.parent.iterdir()) == ["run.csv", "run.yaml"]


def test_effects_of_the_users_own(capsys, tmp_path):
    own = tmp_path / "my_effects.py"
    own.write_text(user_effects.__doc__.split("```python\n")[1].split("```")[0])
    out = tmp_path / "run.csv"
    code, said, _ = run(
        capsys, "lite6", "--effects", own, "--effect", "cable_drag:joint=1,drag_rad=1e-3", "--samples", 30,
        "--position-noise", 1e-9, "--out", out,
    )  # fmt: skip
    assert code == 0
    assert "cable_drag at joint1: drag_rad = 0.001" in said
    read = read_recording(out)
    q = read.joint_position.copy()
    q[:, 0] += 1e-3 * np.tanh(q[:, 0])
    np.testing.assert_allclose(read.position, six_parameter_poses(LITE6.kinematics, q)[:, :3, 3], atol=1e-12)


def test_an_arm_of_the_users_own(capsys, tmp_path):
    description = tmp_path / "arm.yaml"
    row = {"x": 0.0, "y": 0.0, "z": 0.2, "roll": 0.0, "pitch": 0.0, "yaw": 0.0}
    turned = row | {"roll": 1.5}
    description.write_text(yaml.safe_dump({"name": "two", "kinematics": {"joint1": row, "joint2": turned}}))
    out = tmp_path / "runs" / "run.csv"
    out.parent.mkdir()
    assert run(capsys, description, "--samples", 20, "--out", out)[0] == 0
    assert read_recording(out).settings.arm == "../arm.yaml"
    assert "joint_compliance:joint2: needs the gravity torque of joint 2" in command_refused(
        capsys, description, "--effect", COMPLIANCE, "--samples", 20, "--out", tmp_path / "other.csv"
    )


def test_files_are_not_replaced_unasked(capsys, tmp_path):
    for name in ("run.csv", "run.yaml", "run_factory.yaml"):
        (tmp_path / name).write_text("mine")
        order = ("lite6", "--samples", 20, "--tolerance", "--out", tmp_path / "run.csv")
        assert command_refused(capsys, *order) == (
            f"{tmp_path / name}: exists already; choose another name or add --force to replace it"
        )
        assert [path.name for path in tmp_path.iterdir()] == [name]
        assert run(capsys, *order, "--force")[0] == 0
        assert len(list(tmp_path.iterdir())) == 3
        for path in tmp_path.iterdir():
            assert path.read_text() != "mine"
            path.unlink()


def test_nothing_is_left_where_writing_fails(capsys, tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise InputError("run.csv: cannot be written (No space left on device); free space")

    monkeypatch.setattr("lite6jax.recordings.write_recording", refuse)
    message = command_refused(capsys, "lite6", "--samples", 20, "--tolerance", "--out", tmp_path / "run.csv")
    assert message.startswith("run.csv: cannot be written")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--effect", "joint_offset:joint=1,offset_deg=1"], r"joint_offset: the key 'offset_deg' is unknown; .*"),
        (
            ["--effect", "joint_offset:joint=9,offset_rad=1e-3"],
            r"joint_offset:joint9: acts at joint 9, but the arm .*",
        ),
        (
            ["--effect", "link_thermal_expansion:expansion_per_K=2e-5"],
            r"link_thermal_expansion:links: depends on temperatures that rise; add --warm-up 15",
        ),
        (
            ["--effect", "joint_lag:joint=1,lag_s=1e-3"],
            r"joint_lag:joint1: depends on joint velocities; add --motion trajectory",
        ),
        (["--orientation-noise", "1"], r"orientation noise 0\.017.*: a sensor of position measures no orientation; .*"),
        (["--factory", "a.yaml", "--tolerance"], r"--factory and --tolerance: both give the arm's geometry; keep one"),
        (["--factory", "no.yaml"], r"no\.yaml: no such file; check the name"),
        (
            ["--factory-uncertainty", "0.1", "0.1"],
            r"--factory-uncertainty: is one of a calibration; add --factory or --tolerance",
        ),
        (
            ["--tolerance", "--factory-uncertainty", "0", "0.1"],
            r"factory_uncertainty: .* is not accepted \(expected float >= 1e-12, at \.position_m\); give .*",
        ),
        (["--out", "run.mcap"], r"run\.mcap: a recording ends in \.csv or \.parquet; choose such a name"),
        (["--out", "no/run.csv"], r"no/run\.csv: the folder no does not exist; create it first"),
        (["--tool-at", "9000", "0", "0"], r"tool: .* is not accepted \(expected float <= 5\.0, at \[0\]\); give .*"),
    ],
)
def test_what_the_command_refuses(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    said = command_refused(capsys, "lite6", "--out", "run.csv", *arguments)
    assert re.fullmatch(message, said), said
    assert list(Path().iterdir()) == []
