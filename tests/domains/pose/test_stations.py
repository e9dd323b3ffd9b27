"""Poses of one arm that a sensor measured from several stations, each with a frame of its own."""

import dataclasses
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typed import refusal

from lite6jax.arms import frames
from lite6jax.cli.program import main
from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.options import QUICK
from lite6jax.domains.pose.check import check_recording
from lite6jax.domains.pose.fit import fit_recording
from lite6jax.domains.pose.kinematics import measured_poses
from lite6jax.domains.pose.screening.screen import screen
from lite6jax.errors import InputError
from lite6jax.recordings import join_recordings, read_recording, write_recording
from lite6jax.simulation import simulate

ARM = "lite6"
FRAMES = ((0.9, -0.3, 0.2, 0.1, -0.2, 0.7), (8.0, 4.0, -1.0, 0.02, 0.4, -2.6))
"""Of the base in each station's frame: translations in m and angles in rad."""
NOISE = 3e-5


def measured_from(frame, seed, samples=70, orientation=False, **given):
    """The recording of one station, its poses moved into that station's frame."""
    sensor = "tracker_6d" if orientation else "tracker"
    recording = simulate(ARM, samples=samples, seed=seed, sensor=sensor, position_noise=NOISE, **given)
    T = frames.transform_from_row(frame)
    quaternion = None
    if orientation:
        turned = T[:3, :3] @ Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()
        quaternion = Rotation.from_matrix(turned).as_quat(scalar_first=True, canonical=True)
    settings = dataclasses.replace(recording.settings, arm=ARM, pose_frame="unknown", tool="unknown")
    moved = recording.position @ T[:3, :3].T + T[:3, 3]
    source = f"place{seed}.csv"
    return dataclasses.replace(recording, position=moved, quaternion=quaternion, settings=settings, source=source)


def from_two_stations(**given):
    return join_recordings([measured_from(frame, seed, **given) for seed, frame in enumerate(FRAMES, 1)])


@pytest.mark.parametrize("orientation", [False, True])
def test_a_sensor_of_stations_reads_what_each_saw(orientation):
    recording = from_two_stations(samples=9, orientation=orientation)
    sensor = measured_poses(recording, np.ones(2))
    to_first = frames.transform_from_row(FRAMES[0]) @ np.linalg.inv(frames.transform_from_row(FRAMES[1]))
    sensor = dataclasses.replace(sensor, stations=to_first[None])
    tool = np.tile(np.eye(4), (18, 1, 1))
    tool[:, :3, 3], tool[:, :3, :3] = [0.4, 0.2, 0.5], Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    T = np.where(recording.station[:, None, None] == 1, to_first, np.eye(4))
    seen = np.einsum("sab,sb->sa", T[:, :3, :3], recording.position) + T[:, :3, 3]
    apart = sensor.differences(tool)
    np.testing.assert_allclose(apart[:3].T, tool[:, :3, 3] - seen, atol=1e-12)
    if orientation:
        measured = T[:, :3, :3] @ Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()
        turned = np.swapaxes(measured, 1, 2) @ tool[:, :3, :3]
        np.testing.assert_allclose(apart[3:].T, Rotation.from_matrix(turned).as_rotvec(), atol=1e-9)
    assert sensor.numbers == len(sensor.own) == 6
    for k, column in enumerate(sensor.by_numbers(tool)):
        step = 1e-6 * np.eye(6)[k]
        ends = [moved(sign * step).differences(tool) for moved in (sensor.displaced, sensor.moved) for sign in (1, -1)]
        np.testing.assert_allclose(column, (ends[0] - ends[1]) / 2e-6, atol=1e-7)
        np.testing.assert_allclose(ends[0], ends[2], atol=1e-12)


def test_rows_are_counted_through_the_files_and_frames_are_said():
    recording = from_two_stations(samples=9)
    assert recording.row.tolist() == list(range(1, 19))
    assert recording.station.tolist() == [0] * 9 + [1] * 9
    assert recording.select(np.arange(18) > 10).station.tolist() == [1] * 7
    said = " ".join(recording.notes)
    assert "those of place2.csv from 10" in said
    assert "the sensor of place2.csv has a frame of its own" in said


def test_held_out_rows_are_of_every_station():
    recording = from_two_stations(samples=9)
    for held in recording.contiguous_folds(2):
        assert set(recording.station[held]) == set(recording.station[~held]) == {0, 1}


def test_poses_in_the_base_frame_share_it():
    parts = [measured_from(frame, seed, samples=9) for seed, frame in enumerate(FRAMES)]
    based = [dataclasses.replace(one, settings=dataclasses.replace(one.settings, pose_frame="base")) for one in parts]
    assert join_recordings(based).stations == ()


def test_what_one_station_alone_cannot_show_is_found_in_both(tmp_path):
    physics = ("joint_compliance:joint=2,compliance_rad_per_Nm=6e-5",)
    recording = from_two_stations(effects=physics)
    found = diagnose_poses(recording, options=QUICK)
    named = [(finding.effect.name, finding.effect.site) for finding in found.findings]
    assert named == [("joint_compliance", "joint2")]
    (compliance,) = found.findings[0].values
    assert compliance == pytest.approx(6e-5, rel=0.2)
    assert not [fault for fault in found.faults if fault.code == "frame_jump"]


def test_a_reversed_joint_is_found_in_both_files():
    recording = from_two_stations(samples=30)
    q = recording.joint_position.copy()
    q[:, 3] *= -1
    screened = screen(dataclasses.replace(recording, joint_position=q), coarse=True)
    assert [(fault.code, fault.numbers.get("joint")) for fault in screened.found] == [("mirrored_joint", 4)]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda one: one.select(np.arange(5)), "5 poses of file 2 do not determine where its sensor stood"),
        (lambda one: dataclasses.replace(one, position=one.position * [1, 1, -1]), "rows 31 to 60 are not as declared"),
    ],
)
def test_stations_that_cannot_be_joined_are_refused(change, said):
    first, second = (measured_from(frame, seed, samples=30) for seed, frame in enumerate(FRAMES, 1))
    assert said in refusal(screen, join_recordings([first, change(second)]), coarse=True)


def test_poses_of_several_stations_are_not_written_to_one_file(tmp_path):
    with pytest.raises(InputError, match="several stations"):
        write_recording(from_two_stations(samples=9), tmp_path / "both.csv")


@pytest.mark.parametrize("call", [fit_recording, check_recording])
def test_what_knows_one_frame_refuses_several(call):
    assert "which `diagnose` joins" in refusal(call, from_two_stations(samples=9))


def test_images_and_motions_of_several_files_are_refused():
    motion = dataclasses.replace(measured_from(FRAMES[0], 1, samples=9), position=None, quaternion=None)
    other = dataclasses.replace(motion, source="other.csv")
    with pytest.raises(InputError, match="hold joints alone; several files"):
        join_recordings([motion, other])


def test_a_prediction_says_in_which_frame_it_is(tmp_path, capsys):
    files = []
    for seed, frame in enumerate(FRAMES, 1):
        files.append(write_recording(measured_from(frame, seed), tmp_path / f"place{seed}.csv"))
    document = tmp_path / "d.json"
    assert main(["diagnose", *map(str, files), "--quick", "--out", str(document)]) == 0
    assert json.loads(document.read_text())["nuisance"]["stations"] == 2
    capsys.readouterr()
    assert main(["predict", str(document), str(files[0]), "--out", str(tmp_path / "p.csv")]) == 0
    assert "in the sensor's frame of place1.csv" in " ".join(capsys.readouterr().out.split())
    predicted = np.loadtxt(tmp_path / "p.csv", delimiter=",", skiprows=1)[:, :3]
    measured = read_recording(files[0]).position
    assert np.sqrt(np.mean((predicted - measured) ** 2)) < 2 * NOISE
    assert main(["predict", str(document), str(files[1]), "--register", "--out", str(tmp_path / "q.csv")]) == 0
    predicted = np.loadtxt(tmp_path / "q.csv", delimiter=",", skiprows=1)[:, :3]
    assert np.sqrt(np.mean((predicted - read_recording(files[1]).position) ** 2)) < 2 * NOISE
