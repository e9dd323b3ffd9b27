"""Files that people have: arrays, workbooks, hand-eye samples, echoed topics and programs, each by its own writer."""

import json
import pickle
import struct
import sys
import zipfile

import numpy as np
import pytest
import yaml
from scipy.io import savemat
from scipy.spatial.transform import Rotation
from typed import flat, refusal, refused, run

from lite6jax import suffixes
from lite6jax.arms import frames
from lite6jax.arms.description import load_bundled
from lite6jax.recordings import ArmJoints, read_recording, recording_file
from lite6jax.recordings.files import open_table
from lite6jax.recordings.formats import FORMATS, find_format

SAMPLES = 24
ARM = load_bundled("lite6")
NAMES = tuple(f"q{k}_rad" for k in range(1, 7))


@pytest.fixture(scope="module")
def measured():
    """Joints, flange in the base and target in the sensor, of an arm that turns about one configuration."""
    rng = np.random.default_rng(2)
    q = np.array([0.3, 0.4, 1.2, 0.2, 0.8, -0.4]) + rng.uniform(-0.4, 0.4, (SAMPLES, 6))
    frame = frames.transform_from_row([0.9, -0.3, 0.2, 0.1, -0.2, 0.7])
    tool = frames.transform_from_row([0.02, 0.01, 0.05, 0, 0, 0.3])
    flange = frames.chain(ARM.links, q) @ ARM.T_joint_flange
    return q, flange, frame @ flange @ tool


def columns_of(path):
    """The columns of a file by their names, and what was noted."""
    notes = []
    _, table = open_table(path, (), ArmJoints(), notes)
    return dict(table.numbers()), " ".join(notes)


def init(capsys, *words):
    code, said, error = run(capsys, "init", *words, "--arm", "lite6", "--yes")
    assert code == 0, error
    return flat(said)


# ------------------------------------------------------------------ arrays


def test_arrays_of_numpy_are_columns(tmp_path, capsys, measured):
    q, _, seen = measured
    path = tmp_path / "run.npz"
    np.savez(path, q=q, xyz=seen[:, :3, 3], picture=np.zeros((SAMPLES, 20, 20)), note=np.array("a test"))
    columns, notes = columns_of(path)
    np.testing.assert_array_equal(columns["q[2]"], q[:, 2])
    assert "picture" in notes
    assert "radians (certain" in init(capsys, path)
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.joint_position, q)
    np.testing.assert_array_equal(recording.position, seen[:, :3, 3])


def test_an_array_without_names_gets_them(tmp_path, capsys, measured):
    q, _, seen = measured
    path = tmp_path / "run.npy"
    np.save(path, np.hstack([q, seen[:, :3, 3]]))
    assert "--names" in refused(capsys, "init", path, "--arm", "lite6", "--yes")
    init(capsys, path, "--names", ",".join([*NAMES, "x_m", "y_m", "z_m"]))
    np.testing.assert_array_equal(read_recording(path).joint_position, q)


def test_structs_of_matlab_are_columns_whichever_axis_the_samples_are_on(tmp_path, capsys, measured):
    q, _, seen = measured
    path = tmp_path / "run.mat"
    savemat(path, {"robot": {"q": q.T}, "T": np.moveaxis(seen, 0, -1)})
    init(capsys, path)
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.joint_position, q)
    turned = Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()
    np.testing.assert_allclose(turned, seen[:, :3, :3], atol=1e-9)


@pytest.fixture
def h5py():
    return pytest.importorskip("h5py", reason="HDF5 is written by h5py, extra hdf5")


def test_an_episode_of_aloha_is_read(tmp_path, capsys, h5py, measured):
    q, path = measured[0], tmp_path / "episode_0.hdf5"
    with h5py.File(path, "w") as file:
        file["observations/qpos"] = np.hstack([q, np.zeros((SAMPLES, 1))]).astype(np.float32)
        file["observations/images/cam_high"] = np.zeros((SAMPLES, 9, 9, 3), np.uint8)
        file["action"] = np.hstack([q + 1e-3, np.zeros((SAMPLES, 1))])
    said = init(capsys, path)
    assert "Joint positions: observations.qpos[0] … observations.qpos[5]" in said
    assert "Commanded positions: action[0] … action[5]" in said
    assert "cam_high" in said
    np.testing.assert_allclose(read_recording(path).joint_position, q, rtol=1e-6)


def test_demonstrations_of_robomimic_are_runs(tmp_path, capsys, h5py, measured):
    q, flange, _ = measured
    path = tmp_path / "low_dim.hdf5"
    with h5py.File(path, "w") as file:
        for number, rows in ((10, slice(16, 24)), (2, slice(0, 16))):  # in the order of their numbers
            demo = file.create_group(f"data/demo_{number}")
            demo["obs/robot0_joint_pos"] = q[rows]
            demo["obs/robot0_joint_pos_cos"] = np.cos(q[rows])
            demo["obs/robot0_eef_pos"] = flange[rows, :3, 3]
            demo["actions"] = np.zeros((len(q[rows]), 7))
    said = init(capsys, path)
    assert "2 episodes are read one after the other" in said
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.joint_position, q)
    assert recording.run.tolist() == [2] * 16 + [10] * 8


def test_states_and_actions_of_agibot_are_read(tmp_path, h5py, measured):
    q, path = measured[0], tmp_path / "proprio_stats.h5"
    with h5py.File(path, "w") as file:
        file["timestamp"] = (1_700_000_000_000_000_000 + 33_333_333 * np.arange(SAMPLES)).astype(np.int64)
        file["state/joint/position"] = q
        file["action/joint/position"] = q + 1e-3
        file["state/end/position"] = np.zeros((SAMPLES, 2, 3))
    columns, _ = columns_of(path)
    np.testing.assert_array_equal(columns["state.joint.position[5]"], q[:, 5])
    assert {"action.joint.position[0]", "state.end.position_1[2]", "timestamp"} <= columns.keys()


def test_what_lies_in_another_file_is_not_read(tmp_path, h5py):
    other, path = tmp_path / "other.h5", tmp_path / "run.h5"
    with h5py.File(other, "w") as file:
        file["secret"] = np.arange(10.0)
    layout = h5py.VirtualLayout((10,), float)
    layout[:] = h5py.VirtualSource(str(other), "secret", (10,))
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("q", layout)
        file["link"] = h5py.ExternalLink(str(other), "secret")
        file["time"] = np.arange(10.0)
    assert set(columns_of(path)[0]) == {"time"}


def test_the_sheet_with_most_numbers_is_read(tmp_path, capsys, measured):
    openpyxl = pytest.importorskip("openpyxl", reason="workbooks are written by openpyxl, extra excel")
    q, _, seen = measured
    book = openpyxl.Workbook()
    book.active.append(["Operator", 7])
    sheet = book.create_sheet("Data")
    sheet.append(["Run of today"])
    sheet.append([*(f"J{k} [deg]" for k in range(1, 7)), "X [mm]", "Y [mm]", "Z [mm]"])
    for joints, T in zip(q, seen, strict=True):
        sheet.append([*np.rad2deg(joints).tolist(), *(1e3 * T[:3, 3]).tolist()])
    path = tmp_path / "run.xlsx"
    book.save(path)
    assert "the sheet 'Data' is read" in init(capsys, path)
    np.testing.assert_allclose(read_recording(path).joint_position, q, atol=1e-12)


# ------------------------------------------------------------------ hand-eye samples


def of_opencv(path, flange, seen):
    R, t = "R_gripper2base", "t_gripper2base"
    arrays = {
        R: flange[:, :3, :3],
        t: flange[:, :3, 3:],
        "R_target2cam": seen[:, :3, :3],
        "t_target2cam": seen[:, :3, 3:],
    }
    np.savez(path.with_suffix(".npz"), **arrays)
    return path.with_suffix(".npz")


def of_opencv_inverted(path, flange, seen):
    back = np.linalg.inv(flange)
    turned = Rotation.from_matrix(back[:, :3, :3]).as_rotvec()
    pairs = {"rvec_base2gripper": turned, "tvec_base2gripper": back[:, :3, 3], "T_target2cam": seen}
    path = path.with_suffix(".json")
    path.write_text(json.dumps({name: array.tolist() for name, array in pairs.items()}))
    return path


def of_moveit(path, flange, seen):
    path = path.with_suffix(".yaml")
    pairs = zip(flange.reshape(-1, 16).tolist(), seen.reshape(-1, 16).tolist(), strict=True)
    path.write_text(
        yaml.safe_dump([{"effector_wrt_world": robot, "object_wrt_sensor": target} for robot, target in pairs])
    )
    return path


def of_easy_handeye(path, flange, seen):
    def transform(T):
        turned = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
        shift = dict(zip("xyz", T[:3, 3].tolist(), strict=True))
        return {"translation": shift, "rotation": dict(zip("xyzw", turned, strict=True))}

    path = path.with_suffix(".yaml")
    samples = [{"robot": transform(a), "tracking": transform(b)} for a, b in zip(flange, seen, strict=True)]
    path.write_text(yaml.safe_dump({"samples": samples}))
    return path


def of_file_storage(path, flange, seen):
    cv2 = pytest.importorskip("cv2", reason="OpenCV's storage is written by OpenCV, extra camera")
    path = path.with_suffix(".xml")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for k, (robot, target) in enumerate(zip(flange, seen, strict=True)):
        storage.write(f"T_gripper2base_{k}", robot)
        storage.write(f"R_target2cam_{k}", target[:3, :3].copy())
        storage.write(f"t_target2cam_{k}", target[:3, 3:].copy())
    storage.release()
    return path


@pytest.mark.parametrize("write", [of_opencv, of_opencv_inverted, of_moveit, of_easy_handeye, of_file_storage])
def test_hand_eye_samples_get_joints_of_the_nominal_arm(tmp_path, capsys, measured, write):
    _, flange, seen = measured
    path = write(tmp_path / "samples", flange, seen)
    assert recording_file(path) == path
    said = init(capsys, path, "--set", "pose_source=camera")
    assert "pairs of a robot's pose and a target's" in said
    assert "the joints are those of its kinematics, not what encoders read" in said
    recording = read_recording(tmp_path / "samples_poses.csv")
    again = frames.chain(ARM.links, recording.joint_position) @ ARM.T_joint_flange
    np.testing.assert_allclose(again, flange, atol=2e-6)
    np.testing.assert_allclose(recording.position, seen[:, :3, 3], atol=1e-9)


def test_the_target_of_a_camera_on_the_flange_is_turned_back(tmp_path, capsys, measured):
    _, flange, seen = measured
    path = of_opencv(tmp_path / "samples", flange, np.linalg.inv(seen))
    assert "the target's poses are inverted, as those of a camera on the flange" in init(capsys, path)
    recording = read_recording(tmp_path / "samples_poses.csv")
    np.testing.assert_allclose(recording.position, seen[:, :3, 3], atol=1e-9)


def test_samples_without_an_arm_ask_for_it(tmp_path, capsys, measured):
    path = of_moveit(tmp_path / "samples", *measured[1:])
    said = refused(capsys, "init", path, "--yes")
    assert "pairs of poses and no joints" in said
    assert "--arm NAME" in said
    assert not (tmp_path / "samples_poses.csv").exists()


def test_other_commands_send_samples_in_yaml_to_init(tmp_path, capsys, measured):
    path = of_moveit(tmp_path / "samples", *measured[1:])
    assert f"lite6jax init {path}" in refused(capsys, "check", path)


# ------------------------------------------------------------------ echoed topics


def echo_joints(path, q, order=(2, 0, 1, 3, 4, 5)):
    names = "".join(f"- joint{k + 1}\n" for k in order)
    path.write_text(
        "".join(
            f"header:\n  stamp:\n    sec: {1700000000 + k // 10}\n    nanosec: {k % 10 * 100_000_000}\n  frame_id: ''\n"
            f"name:\n{names}position:\n" + "".join(f"- {row[j]}\n" for j in order) + "velocity: []\neffort: []\n---\n"
            for k, row in enumerate(q)
        )
    )
    return path


def test_an_echoed_topic_names_its_joints(tmp_path, capsys, measured):
    q, _, _ = measured
    path = echo_joints(tmp_path / "joints.yaml", q)
    assert "position.joint1 … position.joint6" in init(capsys, path)
    recording = read_recording(tmp_path / "joints_table.csv")
    np.testing.assert_array_equal(recording.joint_position, q)
    np.testing.assert_allclose(recording.time, 0.1 * np.arange(SAMPLES), atol=1e-6)


def test_a_message_that_is_cut_off_is_left_out(tmp_path, measured):
    path = echo_joints(tmp_path / "joints.txt", measured[0])
    text = path.read_text()
    path.write_text(text[: text.rfind("position:") + 15])
    columns, notes = columns_of(path)
    assert len(columns["position.joint1"]) == SAMPLES - 1
    assert "the last message is cut off and left out" in notes


def test_transforms_of_several_frames_are_columns_of_each(tmp_path):
    path = tmp_path / "tf.yaml"
    one = (
        "- header:\n    stamp:\n      secs: 3\n      nsecs: 5\n    frame_id: cam\n  child_frame_id: {}\n  transform:\n"
        "    translation: {{x: {}, y: 0.0, z: 1.0}}\n    rotation: {{x: 0.0, y: 0.0, z: 0.0, w: 1.0}}\n"
    )
    path.write_text("".join(f"transforms:\n{one.format('a', k)}{one.format('b', -k)}---\n" for k in range(4)))
    columns, _ = columns_of(path)
    np.testing.assert_array_equal(columns["b.transform.translation.x"], [0, -1, -2, -3])


# ------------------------------------------------------------------ programs


def listed(values, form):
    return ",".join(form.format(k, value) for k, value in enumerate(values, 1))


def kuka(q):
    points = [f"DECL E6AXIS XP{k}={{{listed(one, 'A{} {:.6f}')},E1 0.0,E2 0.0}}\n" for k, one in enumerate(q)]
    return "".join(["DEFDAT POINTS\n", *points, "DECL E6POS XHOME={X 1,Y 2,Z 3,A 0,B 0,C 0,S 2,T 10}\nENDDAT\n"])


def kuka_inline(q):
    return "".join(["DEF prog()\n", *(f"PTP {{{listed(one, 'A{} {:.6f}')}}}\n" for one in q), "END\n"])


def fanuc(q):
    head = "GP1:\n  UF : 0, UT : 1,\n"
    points = [f'P[{k}:"p"]{{\n {head} {listed(one, "J{}= {:.6f} deg")}\n}};\n' for k, one in enumerate(q, 1)]
    return "".join(["/PROG CAL\n/POS\n", *points, "/END\n"])


def abb(q):
    none = "[9E9,9E9,9E9,9E9,9E9,9E9]"
    points = [f"CONST jointtarget j{k}:=[[{listed(one, '{1:.6f}')}],{none}];\n" for k, one in enumerate(q)]
    return "".join(["MODULE cal\n", *points, "ENDMODULE\n"])


@pytest.mark.parametrize(
    ("name", "program"), [("cal.dat", kuka), ("cal.src", kuka_inline), ("cal.ls", fanuc), ("cal.mod", abb)]
)
def test_the_points_of_a_program_are_joined_to_what_was_measured_there(tmp_path, capsys, measured, name, program):
    q, _, seen = measured
    (tmp_path / name).write_text(program(np.rad2deg(q)))
    np.savetxt(tmp_path / "tracker.csv", 1e3 * seen[:, :3, 3], delimiter=",", header="x_mm,y_mm,z_mm", comments="")
    said = init(capsys, tmp_path / name, tmp_path / "tracker.csv", "--set", "pose_source=laser_tracker")
    assert "paired in their order" in said
    np.testing.assert_allclose(read_recording(tmp_path / "cal_tracker.csv").joint_position, q, atol=1e-7)


def test_points_of_poses_alone_are_poses(tmp_path):
    path = tmp_path / "cal.mod"
    path.write_text("CONST robtarget p1:=[[300,20,400],[0,0,1,0],[0,0,0,0],[9E9,9E9]];\n" * 3)
    columns, notes = columns_of(path)
    assert columns["x [mm]"].tolist() == [300] * 3
    assert "poses of its tool" in notes


def test_a_table_that_ends_in_dat_is_a_table_still(tmp_path, measured):
    path = tmp_path / "run.dat"
    np.savetxt(path, measured[0], header=" ".join(NAMES), comments="")
    np.testing.assert_allclose(columns_of(path)[0]["q1_rad"], measured[0][:, 0])


# ------------------------------------------------------------------ what cannot be read


DAMAGED = {
    "run.npz": b"PK\x03\x04 not an archive",
    "run.npy": b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (3, 6), }",
    "run.mat": b"MATLAB 5.0 MAT-file" + bytes(300),
    "run.xlsx": b"PK\x03\x04 not a workbook",
    "run.h5": b"\x89HDF\r\n\x1a\n" + bytes(64),
    "run.src": b"DEF prog()\nEND\n",
    "run.yaml": b"- effector_wrt_world: [1, 2\n",
    "run.json": b'[{"q": [1, 2',
    "run.xml": b"<?xml version='1.0'?><opencv_storage><a type_id='opencv-matrix'><rows>3</rows>",
    "run.log": b"header:\n  stamp: {secs: 1}\nname: [a\n---\nname: []\n---\n",
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damage_is_one_line(tmp_path, capsys, name):
    path = tmp_path / name
    path.write_bytes(DAMAGED[name])
    said = refused(capsys, "init", path, "--arm", "lite6", "--yes")
    assert said.startswith(f"{path}: ")
    assert len(list(tmp_path.iterdir())) == 1


def test_objects_in_arrays_are_not_unpickled(tmp_path, capsys):
    path = tmp_path / "run.npz"

    class Bad:
        def __reduce__(self):
            return (open, (str(tmp_path / "made"), "w"))

    np.savez(path, q=np.array([Bad()], dtype=object))
    assert str(path) in refused(capsys, "init", path, "--arm", "lite6", "--yes")
    (tmp_path / "run.pkl").write_bytes(pickle.dumps([1]))
    assert "is no recording" in refused(capsys, "init", tmp_path / "run.pkl", "--yes")
    assert not (tmp_path / "made").exists()


def test_arrays_that_claim_to_be_huge_are_refused_before_they_are_read(tmp_path, capsys, h5py):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000, 6), }".ljust(117) + b"\n"
    (tmp_path / "run.npy").write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.create_dataset("q", (10**10, 6), dtype="f8", chunks=(1000, 6))
    with zipfile.ZipFile(tmp_path / "run.xlsx", "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("xl/workbook.xml", b"0" * (1 << 27))
    for name in ("run.npy", "run.h5", "run.xlsx"):
        said = refused(capsys, "init", tmp_path / name, "--arm", "lite6", "--yes")
        assert "numbers" in said or "bytes once it is unpacked" in said


def test_nesting_without_end_is_refused(tmp_path, capsys):
    path = tmp_path / "run.json"
    path.write_text('[{"q":' + "[" * 100_000)
    assert str(path) in refused(capsys, "init", path, "--arm", "lite6", "--yes")


@pytest.mark.parametrize(
    ("name", "module", "extra"),
    [("run.h5", "h5py", "hdf5"), ("run.xlsx", "openpyxl", "excel"), ("run.xml", "cv2", "camera")],
)
def test_a_library_that_is_missing_is_named_with_its_extra(tmp_path, capsys, monkeypatch, name, module, extra):
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"<opencv_storage>")
    assert f"pip install 'lite6jax[{extra}]'" in refused(capsys, "init", tmp_path / name, "--arm", "lite6", "--yes")


# ------------------------------------------------------------------ the table of formats


def test_every_suffix_of_measurements_has_a_reader(tmp_path):
    for suffix in suffixes.MEASUREMENTS:
        assert find_format(tmp_path / f"run{suffix}") is not None
    assert find_format(tmp_path / "arm.yaml") is None
    assert len({each.kind for each in FORMATS}) == len(FORMATS)


def test_a_description_of_an_arm_is_no_recording(tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text("name: arm\nkinematics:\n  joint1: {x: 0, y: 0, z: 0.1, roll: 0, pitch: 0, yaw: 0}\n")
    assert recording_file(path) is None
    assert "is no recording" not in refusal(read_recording, tmp_path / "none.csv")
