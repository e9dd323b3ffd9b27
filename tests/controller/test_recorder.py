"""Recording a live arm: every report once, whatever happens to the line, the disk or the person at the keyboard."""

import threading

import numpy as np
import pyarrow.parquet
import pytest
import yaml
from live import ARM, KINEMATICS, emulated, snapshot
from test_table import room_for

from lite6jax.arms.factory import read_factory
from lite6jax.controller import protocol, recorder
from lite6jax.controller.recorder import record, record_poses
from lite6jax.controller.station import read_station
from lite6jax.diagnosis.diagnose import diagnose
from lite6jax.emulator import EmulatedArm, Faults, draw_sines, visit
from lite6jax.errors import InputError
from lite6jax.recordings import Recording, estimated_torque, read_recording
from tests.oracles.chains import six_parameter_poses

TOOL = [0.0, 0.0, 120.0, 0.0, 0.3, 0.0]


def recorded(tmp_path, seconds=2.0, name="run.parquet", faults=Faults(), during=None, speed=20.0, **options):  # noqa: B008
    """A recording of a moving arm, and what it reads back as."""
    out = tmp_path / name
    path = draw_sines(ARM, seed=2)
    with emulated(path=path, faults=faults, speed=speed, **options) as (controller, address):
        station = read_station(address, ARM, "lite6")
        if during is not None:
            threading.Thread(target=during, args=(controller,), daemon=True).start()
        done = record(address, out, station, seconds=seconds)
    return done, read_recording(out, joint_limits=ARM.joint_limits, reach=ARM.reach)


def test_two_minutes_at_250_hz_lose_and_double_nothing(tmp_path):
    done, read = recorded(tmp_path, 120.0, speed=200.0)
    assert (done.rows, done.missing, done.repeated, done.runs, done.unwritten) == (30_000, 0, 0, 1, 0)
    assert not done.short
    assert yaml.safe_load((tmp_path / "run.yaml").read_text())["account"]["complete"]
    assert read.samples == 30_000
    np.testing.assert_array_equal(np.rint(1e6 * read.time), 4000 * np.arange(30_000))
    assert len(np.unique(read.joint_position, axis=0)) > 29_800  # the arm moved, and no row stands for another
    np.testing.assert_allclose(done.rate, 250)


def test_a_recording_is_what_the_arm_did_and_says_what_it_is(tmp_path):
    done, read = recorded(tmp_path, 4.0, tool=TOOL, payload=[0.4, 1.0, 2.0, 30.0])
    assert read.settings == done.settings
    settings = read.settings
    assert (settings.arm, settings.joint_source, settings.pose_source) == ("lite6", "measured", "controller_fk")
    assert (settings.motion, settings.pose_frame) == ("trajectory", "base")
    np.testing.assert_allclose(settings.tool, [0, 0, 0.12, 0, 0.3, 0], atol=1e-7)
    np.testing.assert_allclose(settings.payload_com_m, [1e-3, 2e-3, 30e-3], rtol=1e-6)
    np.testing.assert_allclose(read.payload, 0.4, rtol=1e-6)
    calibration = read_factory(settings.factory_path(tmp_path))
    np.testing.assert_array_equal(calibration.kinematics, KINEMATICS)
    T = six_parameter_poses(KINEMATICS, read.joint_position) @ protocol.read_pose(np.array(TOOL))
    np.testing.assert_allclose(read.position, T[:, :3, 3], atol=4e-7)
    assert read.quaternion is not None
    assert read.joint_temperature.shape == read.motor_current.shape == read.joint_torque.shape == (1000, 6)
    assert read.commanded_position is not None
    np.testing.assert_allclose(read.joint_position[2:], read.commanded_position[:-2], atol=1e-6)  # two reports later
    with pytest.raises(InputError, match="each command is the read-out of 2 rows after: the log holds measurements"):
        diagnose(read, ARM, domain="tracking")
    slope = np.gradient(read.joint_position[:, 0], read.time)
    np.testing.assert_allclose(read.joint_velocity[5:-5, 0], slope[5:-5], atol=0.05)
    source = pyarrow.parquet.read_schema(tmp_path / "run.parquet").field("q1_rad").metadata[b"source"]
    assert source == b"measured, encoders"
    assert [path.name for path in done.written] == ["run.parquet", "run.yaml", "run_factory.yaml"]


@pytest.mark.parametrize(("noise", "source"), [(0.0, "estimated"), (0.02, "unknown")])
def test_torques_without_noise_are_declared_as_the_controllers_own(tmp_path, noise, source):
    """Of an arm that moves, and then rests."""
    path = visit([[0, 0, 1, 0, 0, 0], [0.5, 0.3, 1, 0, 0.4, 0]], pause=1.0)
    body = EmulatedArm(ARM, KINEMATICS, torque_noise=np.full(6, noise))
    with emulated(body=body, path=path, speed=20.0) as (_, address):
        done = record(address, tmp_path / "run.parquet", read_station(address, ARM, "lite6"), seconds=8.0)
    read = read_recording(tmp_path / "run.parquet")
    assert read.settings.torque_source == done.settings.torque_source == source
    assert estimated_torque(read) == (source == "estimated")
    account = yaml.safe_load((tmp_path / "run.yaml").read_text())["account"]
    assert any("the torques have no noise" in note for note in account["notes"]) == (source == "estimated")


def test_a_line_that_drops_is_made_anew_and_every_report_of_a_connection_is_there(tmp_path):
    done, read = recorded(tmp_path, 12.0, faults=Faults(close_reports_after=300), speed=8.0)
    assert done.runs == read.run.max() + 1 >= 3
    assert done.missing_within == done.repeated == 0
    assert done.short
    starts = np.flatnonzero(np.diff(read.run)) + 2  # data rows count from 1
    rows = pyarrow.parquet.read_table(tmp_path / "run.parquet").to_pydict()
    reasons = {k + 1: reason for k, reason in enumerate(rows["gap"]) if reason is not None}
    assert [*reasons] == starts.tolist()
    assert all("connection lost (" in reason and "closed by the controller" in reason for reason in reasons.values())
    assert done.missing_between == sum(rows["missing"]) > 0
    account = yaml.safe_load((tmp_path / "run.yaml").read_text())["account"]
    assert (account["complete"], account["rows"], account["rows_asked_for"]) == (False, done.rows, 3000)
    assert account["reports_missing_between_runs"] == done.missing_between
    assert account["gaps"] == len(starts)
    assert any(f"{done.missing} reports of the controller are missing" in note for note in read.notes)
    assert done.rows == read.samples
    for run in range(done.runs - 1):
        clock = np.rint(1e6 * read.time[read.run == run])
        assert len(clock) == 300
        assert (np.diff(clock) == 4000).all()
    assert (np.diff(read.time) > 0).all()


def test_a_full_disk_costs_only_what_does_not_fit(tmp_path):
    out = tmp_path / "run.parquet"
    with emulated(path=draw_sines(ARM), speed=40.0) as (_, address):
        station = read_station(address, ARM, "lite6")
        with room_for(1_500_000):
            done = record(address, out, station, seconds=60.0)
    assert done.unwritten > 0
    assert "large" in done.refusal.lower()
    assert done.rows + done.unwritten < 15_000
    assert done.short
    read = read_recording(out)
    assert read.samples == done.rows > 1000
    np.testing.assert_array_equal(np.rint(1e6 * read.time), 4000 * np.arange(done.rows))


def test_a_port_that_is_not_there_or_silent(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "FIRST_REPORT_S", 0.5)
    with emulated(report_ports=(30002,)) as (_, address):
        station = read_station(address, ARM, "lite6")
        with pytest.raises(InputError, match="port 30000: nothing listens there"):
            record(address, tmp_path / "run.csv", station, seconds=1.0)
    with emulated() as (controller, address):
        station = read_station(address, ARM, "lite6")
        controller.set_faults(Faults(silent_reports=True))
        with pytest.raises(InputError, match=r"port 30000: no report within 0\.5 s; check"):
            record(address, tmp_path / "run.csv", station, seconds=1.0)
        with pytest.raises(InputError, match="give more than zero"):
            record(address, tmp_path / "run.csv", station, seconds=-1.0)
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------------------------ forward kinematics for given joints


def poses(count=30, seed=0):
    limits = ARM.joint_limits
    q = np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (count, 6))
    return Recording.from_arrays(q, source="poses.csv")


def test_given_joints_are_answered_by_the_controller(tmp_path):
    wanted, out = poses(), tmp_path / "fk.csv"
    with emulated(tool=TOOL) as (controller, address):
        done = record_poses(address, out, read_station(address, ARM, "lite6"), wanted)
        seen = snapshot(controller)
    assert set(seen.requests) == {1, 8, 44}
    np.testing.assert_array_equal(seen.joints, np.zeros(6))
    read = read_recording(out)
    np.testing.assert_array_equal(read.joint_position, wanted.joint_position.astype(np.float32))
    T = six_parameter_poses(KINEMATICS, read.joint_position) @ protocol.read_pose(np.array(TOOL))
    np.testing.assert_allclose(read.position, T[:, :3, 3], atol=1e-7)
    settings = read.settings
    assert (settings.pose_source, settings.joint_source, settings.motion) == ("controller_fk", "commanded", "static")
    assert settings.factory_calibration == "fk_factory.yaml"
    assert done.sources["q1_rad"] == "as requested, not measured"
    assert done.rows == 30


def test_joints_of_another_arm_or_a_controller_that_refuses(tmp_path):
    with emulated(faults=Faults(nan=frozenset({"kinematics"}))) as (_, address):
        station = read_station(address, ARM, "lite6")
        with pytest.raises(InputError, match=r"refuses all joints of poses\.csv, the first with a pose that is not"):
            record_poses(address, tmp_path / "fk.csv", station, poses(3))
        seven = Recording.from_arrays(np.zeros((2, 7)), source="seven.csv")
        with pytest.raises(InputError, match=r"seven\.csv: has 7 joints, the lite6 6"):
            record_poses(address, tmp_path / "fk.csv", station, seven)
    assert list(tmp_path.iterdir()) == []
