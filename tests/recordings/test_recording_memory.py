"""Recordings from arrays and data frames: the numbers they hold, and the line with which each mistake is refused."""

import numpy as np
import pyarrow as pa
import pytest
from typed import refusal

from lite6jax.arms.description import load_bundled
from lite6jax.recordings import Recording, RecordingSettings, read_recording

LITE6 = load_bundled("lite6")
SAMPLES = 40


@pytest.fixture
def plausible():
    rng = np.random.default_rng(0)
    q = rng.uniform(LITE6.joint_limits[:, 0], LITE6.joint_limits[:, 1], (SAMPLES, 6))
    quaternion = rng.normal(size=(SAMPLES, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return {"joint_position": q, "position": rng.uniform(-0.4, 0.4, (SAMPLES, 3)), "quaternion": quaternion}


def columns_of(arrays, degrees=False, millimetres=False):
    """A data frame's columns, made without the library."""
    scale, unit = (180 / np.pi, "deg") if degrees else (1.0, "rad")
    table = {f"q{j + 1}_{unit}": scale * arrays["joint_position"][:, j] for j in range(6)}
    scale, unit = (1e3, "mm") if millimetres else (1.0, "m")
    table |= {f"{axis}_{unit}": scale * arrays["position"][:, k] for k, axis in enumerate("xyz")}
    return table | {name: arrays["quaternion"][:, k] for k, name in enumerate(("qw", "qx", "qy", "qz"))}


# ------------------------------------------------------------------ arrays


def test_arrays_are_kept_and_keys_of_the_sidecar_are_declared(plausible):
    recording = Recording.from_arrays(
        *plausible.values(), arm=LITE6, pose_frame="base", tool=np.array([0, 0, 0.1, 0, 0, 0.2]), position_noise_m=2e-5
    )
    np.testing.assert_array_equal(recording.joint_position, plausible["joint_position"])
    np.testing.assert_array_equal(recording.position, plausible["position"])
    sign = np.sign(plausible["quaternion"][:, :1])
    np.testing.assert_allclose(recording.quaternion, sign * plausible["quaternion"], atol=1e-15)
    assert recording.settings == RecordingSettings(
        arm="lite6", pose_frame="base", tool=(0.0, 0.0, 0.1, 0.0, 0.0, 0.2), position_noise_m=2e-5
    )
    settings = RecordingSettings(pose_frame="base", position_noise_m=1e-3)
    both = Recording.from_arrays(*plausible.values(), settings=settings, position_noise_m=1e-4)
    assert both.settings == RecordingSettings(pose_frame="base", position_noise_m=1e-4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"joint_position": np.zeros((3, 6)) * 1j}, "joint_position: holds complex numbers; give real ones"),
        ({"position": np.zeros((3, 3), complex)}, "position: holds complex numbers; give real ones"),
        ({"joint_position": [["a"] * 6] * 3}, "joint_position: holds <U1, not numbers; give an array of floats"),
        ({"joint_position": [[0.0] * 6, [0.0]]}, "joint_position: its rows have unequal lengths; give one array of"),
        ({"joint_position": np.zeros(6)}, "joint_position has the shape (6,); give (sample, joint), neither zero"),
        ({"joint_position": np.zeros((6, 3, 2))}, "joint_position has the shape (6, 3, 2); give (sample, joint)"),
        ({"position": np.zeros((3, 2))}, "position has the shape (3, 2); give (3, 3)"),
        ({"quaternion": np.eye(4)}, "quaternion has the shape (4, 4); give (3, 4)"),
        ({"position": None, "quaternion": np.eye(4)[:3]}, "measured orientations without positions; add x_m y_m z_m"),
        ({"arm": "xarm7"}, "has 6 joints, but xarm7 has 7; give the arm that it is of"),
        ({"arm": "lite7"}, "lite7: neither a bundled arm nor a file"),
        ({"pose_fram": "base"}, "pose_fram: unknown key; did you mean pose_frame?"),
        ({"tool": "gripper"}, "tool: 'gripper' is not accepted; give none, unknown, or six numbers"),
        ({"run": [0.0, 0.5, 1.0]}, "run has the type float64; give integers"),
    ],
)
def test_arrays_that_cannot_be_a_recording(changes, message):
    given = {"joint_position": np.zeros((3, 6)), "position": np.zeros((3, 3))} | changes
    assert message in refusal(Recording.from_arrays, **given)


# ------------------------------------------------------------------ data frames


class Frame:
    """The part of a data frame that is relied on: named columns, each an array."""

    def __init__(self, table):
        self.table, self.columns = table, list(table)

    def __getitem__(self, name):
        return self.table[name]


@pytest.mark.parametrize("kind", [dict, Frame, pa.table, "pandas"])
@pytest.mark.parametrize("degrees", [False, True])
def test_data_frames_hold_what_a_file_with_the_same_columns_holds(plausible, tmp_path, kind, degrees):
    table = columns_of(plausible, degrees=degrees, millimetres=degrees)
    table |= {"run": np.repeat([0, 1], SAMPLES // 2), "payload_kg": np.linspace(0, 1, SAMPLES)}
    kind = pytest.importorskip("pandas").DataFrame if kind == "pandas" else kind
    recording = Recording.from_dataframe(kind(table), RecordingSettings(motion="static"), pose_frame="base")
    path = tmp_path / "run7.csv"
    np.savetxt(path, np.column_stack(list(table.values())), "%.17g", ",", header=",".join(table), comments="")
    path.with_suffix(".yaml").write_text("recording: {motion: static, pose_frame: base}\n")
    file = read_recording(path)
    assert recording.settings == file.settings
    assert recording.notes == file.notes == ()
    for name in ("joint_position", "position", "quaternion", "payload", "run", "direction_of_motion"):
        np.testing.assert_array_equal(getattr(recording, name), getattr(file, name), err_msg=name)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"q1_rad": np.zeros(SAMPLES, complex)}, "column q1_rad: holds complex128, not numbers; give it as float64"),
        ({"q1_rad": ["a"] * SAMPLES}, "column q1_rad: holds string, not numbers; write it as float64"),
        ({"q1_rad": [True] * SAMPLES}, "column q1_rad: holds bool, not numbers"),
        ({"q1_rad": np.zeros(3)}, "its columns have unequal lengths, 3 to 40; give one each"),
        ({"q1_grad": np.zeros(SAMPLES)}, "column 'q1_grad': the unit 'grad' is unknown; write q1_rad or q1_deg"),
        ({"q7_rad": np.zeros(SAMPLES)}, "has 7 joints, but lite6 has 6; give the arm that it is of"),
        ({"run": np.linspace(0, 1, SAMPLES)}, "column run: row 2 is 0.025641; give whole numbers"),
    ],
)
def test_data_frames_that_cannot_be_a_recording(plausible, changes, message):
    assert message in refusal(Recording.from_dataframe, columns_of(plausible) | changes, arm="lite6")


@pytest.mark.parametrize("frame", [np.zeros((3, 6)), [[0.0] * 6], {}, {1: [0.0]}, None])
def test_what_is_no_data_frame(frame):
    assert "has no named columns; give a data frame with columns q1_rad ... qN_rad" in refusal(
        Recording.from_dataframe, frame
    )
