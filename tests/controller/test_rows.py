"""Reports as rows: every report once, gaps counted, clocks that jump, and which way orientations are meant."""

import numpy as np
from live import ARM, KINEMATICS
from scipy.spatial.transform import Rotation
from test_condition import report as rich

from lite6jax.arms.factory import FactoryCalibration
from lite6jax.controller import protocol
from lite6jax.controller.connection import Reports
from lite6jax.controller.rows import SOURCES, Rows
from lite6jax.controller.station import Station, parse_condition
from tests.oracles.chains import six_parameter_poses

STEP = 4000


def station(calibrated=True, known=True, **changed):
    own = FactoryCalibration(np.array(KINEMATICS), ARM, ARM.T_joint_flange, "arm") if calibrated else None
    return Station(
        ARM, "lite6", own, parse_condition(rich(temperature=range(20, 27), **changed), "here") if known else None, ()
    )


def reports(time_us, q=None, vector=False, length=784, seed=0):
    """Reports of port 30000 with poses of the calibrated chain."""
    time_us = np.asarray(time_us)
    q = np.random.default_rng(seed).uniform(-1, 1, (len(time_us), 6)) if q is None else q
    made = np.zeros(len(time_us), protocol.report_layout(protocol.REALTIME, length))
    made["length"], made["time_us"] = length, time_us
    made["joint_position"][:, :6] = q
    made["target_position"][:, :6] = q + 0.01
    made["joint_velocity"][:, :6] = q / 2
    made["current"][:, :6], made["torque"][:, :6] = q / 3, q / 4
    T = six_parameter_poses(KINEMATICS, made["joint_position"][:, :6].astype(float))
    made["pose"] = protocol.encode_pose(T)
    if vector:
        made["pose"][:, 3:] = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    return [row.tobytes() for row in made]


def took(rows, many, connection=0, heard=0.0):
    return rows.take(Reports(connection, many, heard))


def test_a_row_is_what_the_report_says_in_si():
    rows = Rows(station(payload=np.array([0.5, 0, 0, 30.0])))
    q = np.random.default_rng(1).uniform(-2, 2, (5, 6))
    table = took(rows, reports(1_000_000 + STEP * np.arange(5), q))
    sent = q.astype(np.float32).astype(float)
    np.testing.assert_allclose(table["time_s"], 0.004 * np.arange(5), atol=1e-12)
    np.testing.assert_array_equal(np.stack([table[f"q{i}_rad"] for i in range(1, 7)], 1), sent)
    np.testing.assert_allclose(np.stack([table[f"dq{i}_rad_per_s"] for i in range(1, 7)], 1), sent / 2, rtol=1e-6)
    np.testing.assert_allclose(np.stack([table[f"cmd{i}_rad"] for i in range(1, 7)], 1), q + 0.01, rtol=1e-6)
    np.testing.assert_allclose(np.stack([table[f"current{i}_A"] for i in range(1, 7)], 1), sent / 3, rtol=1e-6)
    np.testing.assert_allclose(np.stack([table[f"tau{i}_Nm"] for i in range(1, 7)], 1), sent / 4, rtol=1e-6)
    np.testing.assert_array_equal([table[f"temp{i}_degC"][0] for i in range(1, 7)], np.arange(20, 26))
    assert (table["payload_kg"] == 0.5).all()
    T = six_parameter_poses(KINEMATICS, sent)
    np.testing.assert_allclose(np.stack([table[f"{axis}_m"] for axis in "xyz"], 1), T[:, :3, 3], atol=1e-7)
    turn = Rotation.from_quat(np.stack([table[f"q{part}"] for part in "wxyz"], 1), scalar_first=True)
    np.testing.assert_allclose(turn.as_matrix(), T[:, :3, :3], atol=1e-6)
    assert set(table) <= set(SOURCES)
    assert rows.names == tuple(table)
    assert (rows.count, rows.missing, rows.repeated, rows.run, rows.rate) == (5, 0, 0, 0, 250)


def test_a_clock_that_jumps_starts_a_run_and_is_said():
    rows = Rows(station(), seconds=0.06)
    table = took(rows, reports(STEP * np.arange(5)), heard=1.0)
    table = took(rows, reports(10**13 + STEP * np.arange(5)), heard=1.02)
    np.testing.assert_allclose(table["time_s"], 0.02 + 0.004 * np.arange(5))
    assert (rows.complete, rows.run) == (False, 1)
    assert table["gap"].tolist()[:2] == ["the controller's clock jumped by 1e+07 s", None]
    assert any("clock jumped 1 times; each time starts a run" in note for note in rows.notes())
    took(rows, reports(10**13 + STEP * np.arange(5, 30)), heard=1.1)
    assert rows.complete
    assert rows.count == 15
    # in the middle of a piece
    rows = Rows(station())
    table = took(rows, reports([0, STEP, 10**9, 10**9 + STEP]))
    np.testing.assert_array_equal(table["run"], [0, 0, 1, 1])


def test_a_connection_lost_for_long_is_no_jump():
    rows = Rows(station())
    took(rows, reports(STEP * np.arange(5)), heard=1.0)
    table = took(rows, reports(STEP * np.arange(5000, 5003)), connection=1, heard=20.98)
    np.testing.assert_allclose(table["time_s"], 0.004 * np.arange(5000, 5003))
    assert table["gap"][0] == "new connection"
    assert rows.missing_between == 4995


def test_a_rotation_vector_is_recognised_by_the_chain():
    q = np.random.default_rng(4).uniform(-2, 2, (30, 6))
    T = six_parameter_poses(KINEMATICS, q.astype(np.float32).astype(float))
    for vector, said in ((True, "a rotation vector"), (False, "roll pitch yaw")):
        for calibrated in (True, False):
            rows = Rows(station(calibrated))
            table = took(rows, reports(STEP * np.arange(30), q, vector))
            turn = Rotation.from_quat(np.stack([table[f"q{part}"] for part in "wxyz"], 1), scalar_first=True)
            np.testing.assert_allclose(turn.as_matrix(), T[:, :3, :3], atol=2e-6)
            assert any(f"orientations are {said}" in note for note in rows.notes())


def test_an_orientation_that_is_not_the_chains_is_left_out():
    many = reports(STEP * np.arange(5))
    layout = protocol.report_layout(protocol.REALTIME, 784)
    changed = np.frombuffer(b"".join(many), layout).copy()
    changed["pose"][:, 3:] += [0.4, -0.3, 0.5]
    rows = Rows(station())
    table = took(rows, [row.tobytes() for row in changed])
    assert "qw" not in table
    assert "x_m" in table
    assert "orientations are omitted" in rows.notes()[0]


def test_the_tool_turns_the_orientation_that_is_expected():
    T = protocol.read_pose(np.array([0, 0, 100.0, 0.5, 0.6, 0.7]))
    q = np.random.default_rng(6).uniform(-2, 2, (5, 6)).astype(np.float32)
    made = np.frombuffer(b"".join(reports(STEP * np.arange(5), q)), protocol.report_layout(protocol.REALTIME)).copy()
    made["pose"] = protocol.encode_pose(six_parameter_poses(KINEMATICS, q.astype(float)) @ T)
    rows = Rows(station(tool_offset=np.array([0, 0, 100.0, 0.5, 0.6, 0.7])))
    assert "qw" in took(rows, [row.tobytes() for row in made])
