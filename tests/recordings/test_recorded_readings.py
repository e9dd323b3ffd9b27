"""Recordings hold readings that are no poses: files, arrays, and what is refused."""

import numpy as np
import pytest
from typed import refusal

from lite6jax.errors import InputError
from lite6jax.recordings import Recording, join_recordings, read_recording, readings_from_arrays, write_recording
from lite6jax.recordings.settings import BoardSettings, CameraSettings, KnownDistance, KnownPlane, RecordingSettings
from lite6jax.simulation import simulate

SENSORS = ("contact", "plane", "distance", "axis", "fixed_camera", "flange_camera")
JOINTS = ",".join(f"q{k}_rad" for k in range(1, 7))


@pytest.fixture(scope="module")
def recordings():
    return {sensor: simulate("lite6", sensor=sensor, samples=8, seed=2) for sensor in SENSORS}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("sensor", SENSORS)
def test_a_file_reads_back_exactly(tmp_path, recordings, sensor, suffix):
    recording = recordings[sensor]
    again = read_recording(write_recording(recording, tmp_path / f"run{suffix}"))
    np.testing.assert_array_equal(again.joint_position, recording.joint_position)
    np.testing.assert_array_equal(again.readings.pixels, recording.readings.pixels)
    np.testing.assert_array_equal(again.readings.value, recording.readings.value)
    labels, before = (np.array(one.readings.names)[one.readings.group] for one in (again, recording))
    assert again.readings.kind == recording.readings.kind
    if sensor in ("contact", "plane"):
        np.testing.assert_array_equal(labels, before)
    assert again.settings == recording.settings
    assert again.numbers_per_sample == {"contact": 3, "plane": 1, "distance": 1, "axis": 1}.get(sensor, 6)


def test_settings_of_readings_read_back(tmp_path):
    settings = RecordingSettings(
        contact_distances=(KnownDistance(("a", "b"), 0.05, 5e-5),),
        contact_points={"a": (0.1, 0.2, 0.3)},
        planes={"p": KnownPlane((0.0, 0.0, 1.0), 0.01)},
        anchor_m={"w": (1.0, 0.0, 0.5)},
        distance_offset="unknown",
        camera=CameraSettings("fixed", 900.0, 900.0, 640.0, 360.0, intrinsics="refine"),
        board=BoardSettings(6, 4, 0.02),
        points_m=((0.0, 0.0, 0.0), (0.1, 0.0, 0.0)),
    )
    readings = readings_from_arrays("contact", labels=["a", "b"])
    recording = Recording.from_arrays(np.zeros((2, 6)), readings=readings, settings=settings, motion="static")
    again = read_recording(write_recording(recording, tmp_path / "run.csv"))
    assert again.settings == recording.settings


@pytest.mark.parametrize(
    ("name", "columns", "rows", "settings", "said"),
    [
        ("several kinds", "contact,plane", ["a,p"] * 3, "", "diagnose a.csv b.csv"),
        ("no camera", "image,corner,u_px,v_px", ["0,0,1,2", "0,1,2,3"], "", "no camera in its sidecar"),
        ("half a corner", "image,corner,u_px", ["0,0,1", "0,1,2"], "", "without v_px"),
        ("a corner of none", "image,corner,u_px,v_px", ["0,0.5,1,2"], "", "count corners from 0"),
        ("twice", "image,corner,u_px,v_px", ["0,1,1,2", "0,1,3,4"], "", "corner twice"),
        ("no such lens", "contact", ["a"], "camera: {mounted: fixed, fx: 900, fy: 900, cx: 1}", "required field cy"),
        ("two names", "contact", ["a"], "contact_distances: [{between: [a], distance_m: 1, noise_m: 1}]", "[a, b]"),
        ("mm", "contact", ["a"], "contact_distances: [{between: [a, b], distance_m: 50, noise_m: 1}]", "at [0].dist"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_said_in_one_line(tmp_path, name, columns, rows, settings, said):
    file = tmp_path / "run.csv"
    file.write_text(f"{JOINTS},{columns}\n" + "".join(f"0,0,0,0,0,0,{row}\n" for row in rows))
    (tmp_path / "run.yaml").write_text(f"recording:\n  arm: lite6\n  {settings}\n")
    assert said in refusal(read_recording, file)


def test_several_files_have_places_of_their_own(tmp_path, recordings):
    files = [write_recording(recordings["contact"], tmp_path / f"{name}.csv") for name in ("left", "right")]
    both = join_recordings([read_recording(file) for file in files])
    assert both.samples == 2 * recordings["contact"].samples
    assert {name.partition("/")[0] for name in both.readings.names} == {"left", "right"}
    assert len(both.settings.contact_distances) == 2 * len(recordings["contact"].settings.contact_distances)
    assert {*both.settings.contact_distances[0].between} <= {*both.readings.names}


def test_files_that_do_not_belong_together_are_refused(recordings):
    with pytest.raises(InputError, match="contact and plane"):
        join_recordings([recordings["contact"], recordings["plane"]])
    with pytest.raises(InputError, match="contact and poses"):
        join_recordings([recordings["contact"], simulate("lite6", samples=3)])
