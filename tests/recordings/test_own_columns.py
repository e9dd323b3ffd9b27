"""Tables whose columns have names of their own, the sidecar that says what they are, all their faults in one line."""

import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation
from typed import refusal, unread

from lite6jax.errors import InputError
from lite6jax.recordings import Recording, read_recording, read_targets
from lite6jax.recordings.columns.names import candidate_blocks, choose_blocks, pose_sources

RNG = np.random.default_rng(3)
ROWS = 20
Q = RNG.uniform(-2, 2, (ROWS, 2))
P = RNG.uniform(-0.3, 0.3, (ROWS, 3))
TURNED = Rotation.random(ROWS, random_state=RNG)


def written(tmp_path, table, sidecar, suffix=".csv"):
    path = tmp_path / f"run7{suffix}"
    if suffix == ".parquet":
        pq.write_table(pa.table(table), path)
    else:
        np.savetxt(path, np.column_stack(list(table.values())), "%.17g", ",", header=",".join(table), comments="")
    path.with_suffix(".yaml").write_text(sidecar)
    return path


SIDECAR = """
columns:
  "J 1": q1_deg
  "J: 2": q2_rad
  X: x_mm
  'y': y_mm
  7: z_mm
  spare: ignore
  x: ignore
recording: {motion: static, pose_frame: base}
"""


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_sidecar_says_what_columns_are(tmp_path, suffix):
    table = {"J 1": np.rad2deg(Q[:, 0]), "x": np.full(ROWS, 9e9), "J: 2": Q[:, 1], "spare": np.full(ROWS, np.nan)}
    table |= dict(zip(("X", "y", "7"), 1e3 * P.T, strict=True)) | {"payload_kg": np.ones(ROWS), "more": np.ones(ROWS)}
    path = written(tmp_path, table, SIDECAR, suffix)
    recording = read_recording(path)
    np.testing.assert_allclose(recording.joint_position, Q, rtol=1e-14)
    np.testing.assert_allclose(recording.position, P, rtol=1e-14)
    assert recording.payload.tolist() == [1.0] * ROWS  # a name of a recording needs no entry
    assert recording.settings.pose_frame == "base"
    assert recording.notes == ("ignored columns that mean nothing here: 'more'",)
    columns = {"J 1": "q1_deg", "J: 2": "q2_rad", "X": "x_mm", "y": "y_mm", "7": "z_mm", "x": "ignore"}
    frame = Recording.from_dataframe(table, columns=columns | {"spare": "ignore"}, motion="static")
    np.testing.assert_array_equal(frame.position, recording.position)
    np.testing.assert_array_equal(read_targets(path, 2).recording.position, recording.position)


@pytest.mark.parametrize(
    ("unit", "angle", "length", "size", "message"),
    [
        ("rad", 150, "mm", 1e3, r"column J1: .* are these degrees\? name the columns q1_deg ..."),
        ("deg", 150, "m", 1e3, r"columns X Y Z: .* are these millimetres\? name the columns x_mm y_mm z_mm"),
        ("deg", 9000, "mm", 1e3, r"column J1: .* rad; check the unit"),
        ("deg", 150, "mm", 1e5, r"columns X Y Z: .* check the unit"),
    ],
)
def test_columns_of_other_names_are_asked_about_where_they_are_declared_in_si(unit, angle, length, size, message):
    table = {f"J{i}": np.full(ROWS, angle if i == 1 else 0.0) for i in range(1, 7)}
    table |= dict(zip("XYZ", size * P.T, strict=True))
    columns = {f"J{i}": f"q{i}_{unit}" for i in range(1, 7)} | {name: f"{name.lower()}_{length}" for name in "XYZ"}
    assert re.search(f"{message}$", refusal(Recording.from_dataframe, table, columns=columns, arm="lite6"))


@pytest.mark.parametrize(
    ("form", "angles"),
    [
        (("rx", "ry", "rz"), TURNED.as_rotvec()),
        (("roll", "pitch", "yaw"), TURNED.as_euler("xyz")),
        (("rotx", "roty", "rotz"), TURNED.as_euler("XYZ")),
        (("alpha", "beta", "gamma"), TURNED.as_euler("ZYZ")),
    ],
)
@pytest.mark.parametrize("unit", ["rad", "deg"])
def test_orientations_in_other_forms_become_quaternions(form, angles, unit):
    table = {"q1_rad": Q[:, 0], **dict(zip(("x_m", "y_m", "z_m"), P.T, strict=True))}
    given = angles if unit == "rad" else np.rad2deg(angles)
    table |= {f"{part}_{unit}": column for part, column in zip(form, given.T, strict=True)}
    table[f"{form[1]}_{unit}"] = np.where(np.arange(ROWS) == 4, np.nan, given[:, 1])
    recording = Recording.from_dataframe(table, motion="static")
    assert recording.row.tolist() == [k + 1 for k in range(ROWS) if k != 4]
    found = Rotation.from_quat(recording.quaternion, scalar_first=True)
    kept = TURNED[np.arange(ROWS) != 4]
    np.testing.assert_allclose((found.inv() * kept).magnitude(), 0, atol=1e-14)


def test_a_rotation_matrix_becomes_a_quaternion():
    table = {"q1_rad": Q[:, 0], **dict(zip(("x_m", "y_m", "z_m"), P.T, strict=True))}
    entries = [f"r{i}{j}" for i in "123" for j in "123"]
    written = np.round(TURNED.as_matrix().reshape(-1, 9), 4)
    recording = Recording.from_dataframe(table | dict(zip(entries, written.T, strict=True)), motion="static")
    found = Rotation.from_quat(recording.quaternion, scalar_first=True)
    np.testing.assert_allclose((found.inv() * TURNED).magnitude(), 0, atol=2e-4)
    for wrong, said in ((2.0, "is not orthogonal"), (-1.0, "is mirrored")):
        broken = written.copy()
        broken[7, :3] *= wrong
        with pytest.raises(InputError, match=f"recording: row 8: r11 … r33 {said}, so it is no rotation"):
            Recording.from_dataframe(table | dict(zip(entries, broken.T, strict=True)), motion="static")
    with pytest.raises(InputError, match="r33 is missing; give all of r11 r12 r13 r21 r22 r23 r31 r32 r33, or none"):
        Recording.from_dataframe(table | dict(zip(entries[:8], written.T, strict=False)))


def test_one_line_says_all_that_is_wrong_with_the_columns(tmp_path):
    path = tmp_path / "run 7.csv"
    path.write_text(
        "q1_rad,q2_rad,q2_deg,q3_rad,x,y,z_m,tau1_Nm,time,payload_kg,ambient_degC\n"
        + "0.1,0.2,3,oops,1,2,3,4,0,,a\n0.2,x,3,0.3,1,2,3,4,0,,b\n0.2,0.1,3,0.3,1,2,3,4,0,1,\n"
    )
    problems = [
        "columns q2_rad and q2_deg give the same quantity; keep one",
        "column 'x': the unit is missing; write x_m or x_mm (and likewise 'y')",
        "column 'time': the unit is missing; write time_s or time_ms or time_us or time_ns",
        "tau2_Nm or tau2_mNm is missing beside its like; give it for all joints",
        *(
            f"column {name}: row {row} holds {value!r}, which is no number; give numbers with a decimal point, and "
            "leave missing ones empty"
            for name, row, value in (("q2_rad", 2, "x"), ("q3_rad", 1, "oops"), ("ambient_degC", 1, "a"))
        ),
        "column payload_kg: 2 of 3 rows are NaN, infinite or empty; fill it or leave it out",
    ]
    said = " ".join(f"({number}) {problem}." for number, problem in enumerate(problems, 1)).removesuffix(".")
    assert unread(path) == (f"8 problems of its columns: {said}; `lite6jax init '{path}'` names columns as they are")
    table = {"q1_rad": ["a"], "q2_rad": [True], "run": [None], "q3_grad": [0.0]}
    assert refusal(Recording.from_dataframe, table) == (
        "recording: 4 problems of its columns: (1) column 'q3_grad': the unit 'grad' is unknown; write q3_rad or "
        "q3_deg. (2) column q1_rad: holds string, not numbers; write it as float64. (3) column q2_rad: holds bool, not "
        "numbers; write it as float64. (4) column run: 1 of 1 rows are NaN, infinite or empty; fill it or leave it out"
    )


# ------------------------------------------------------------------ names


NAMINGS = {
    "ros": (
        (
            "joint_{1-6}.position|joint_{1-6}.velocity|pose.position.x|pose.position.y|pose.position.z|"
            "pose.orientation.x|pose.orientation.y|pose.orientation.z|pose.orientation.w|header.stamp.sec"
        ),
        {
            "q": "joint_{1-6}.position",
            "dq": "joint_{1-6}.velocity",
            "position": "pose.position.x|pose.position.y|pose.position.z",
            "rotation": "pose.orientation.w|pose.orientation.x|pose.orientation.y|pose.orientation.z",
        },
    ),
    "rtde": (
        (
            "timestamp|target_q_{0-5}|target_qd_{0-5}|target_moment_{0-5}|actual_q_{0-5}|actual_qd_{0-5}|"
            "actual_current_{0-5}|actual_TCP_pose_{0-5}|actual_TCP_speed_{0-5}|actual_TCP_force_{0-5}|"
            "joint_temperatures_{0-5}|joint_mode_{0-5}|robot_mode|payload|actual_tool_accelerometer_{0-2}|"
            "elbow_position_{0-2}|tcp_offset_{0-5}"
        ),
        {
            "time": "timestamp",
            "q": "actual_q_{0-5}",
            "dq": "actual_qd_{0-5}",
            "current": "actual_current_{0-5}",
            "cmd": "target_q_{0-5}",
            "temp": "joint_temperatures_{0-5}",
            "position": "actual_TCP_pose_{0-2}",
            "rotation": "actual_TCP_pose_{3-5}",
            "payload": "payload",
        },
    ),
    "libfranka": (
        (
            "tau_ext_hat_filtered[{0-6}]|tau_J_d[{0-6}]|q_d[{0-6}]|q[{0-6}]|dq_d[{0-6}]|dq[{0-6}]|tau_J[{0-6}]|"
            "ddq_d[{0-6}]"
        ),
        {"q": "q[{0-6}]", "dq": "dq[{0-6}]", "tau": "tau_J[{0-6}]", "cmd": "q_d[{0-6}]"},
    ),
    "mujoco": (
        "qpos[{0-5}]|qvel[{0-5}]|qacc[{0-5}]|ctrl[{0-5}]|qfrc_bias[{0-5}]|qfrc_actuator[{0-5}]",
        {
            "q": "qpos[{0-5}]",
            "dq": "qvel[{0-5}]",
            "ddq": "qacc[{0-5}]",
            "tau": "qfrc_actuator[{0-5}]",
            "cmd": "ctrl[{0-5}]",
        },
    ),
    "kuka": ("A{1-6}|X|Y|Z|A|B|C", {"q": "A{1-6}", "position": "X|Y|Z", "rotation": "C|B|A"}),
    "plotjuggler": (
        (
            "__time|/joint_states/position[{0-5}]|/tracker/pose/position/x|/tracker/pose/position/y|"
            "/tracker/pose/position/z"
        ),
        {
            "time": "__time",
            "q": "/joint_states/position[{0-5}]",
            "position": "/tracker/pose/position/x|/tracker/pose/position/y|/tracker/pose/position/z",
        },
    ),
    "universal robots' joints": (
        "elbow_joint|shoulder_lift_joint|shoulder_pan_joint|wrist_{1-3}_joint",
        {"q": "shoulder_pan_joint|shoulder_lift_joint|elbow_joint|wrist_{1-3}_joint"},
    ),
    "universal robots' teach pendant": (
        "No|Wrist 3|Wrist 2|Wrist 1|Elbow|Shoulder|Base|Laser X [mm]|Laser Y [mm]|Laser Z [mm]",
        {"q": "Base|Shoulder|Elbow|Wrist {1-3}", "position": "Laser X [mm]|Laser Y [mm]|Laser Z [mm]"},
    ),
    "lerobot": (
        (
            "action.waist|action.elbow|observation.state.waist|observation.state.elbow|"
            "observation.state.gripper|timestamp|frame_index|episode_index|index|task_index"
        ),
        {
            "q": "observation.state.waist|observation.state.elbow",
            "cmd": "action.waist|action.elbow",
            "time": "timestamp",
            "run": "episode_index",
        },
    ),
    "opencv": ("θ{1-6}|tvec_{0-2}|rvec_{0-2}", {"q": "θ{1-6}", "position": "tvec_{0-2}", "rotation": "rvec_{0-2}"}),
    "commanded and measured": (
        "J{1-6}|x_cmd|y_cmd|z_cmd|x_meas|y_meas|z_meas",
        {"q": "J{1-6}", "position": "x_meas|y_meas|z_meas"},
    ),
    "yaskawa": ("T|B|R|U|L|S|X|Y|Z|time", {"q": "S|L|U|R|B|T", "position": "X|Y|Z", "time": "time"}),
    "fanuc": ("J{1-6}|X|Y|Z|W|P|R", {"q": "J{1-6}", "position": "X|Y|Z", "rotation": "W|P|R"}),
    "motion capture": (
        (
            "Frame|Time (Seconds)|flange/Mean Marker Error|q[{0-5}]|flange/Rotation/X|flange/Rotation/Y|"
            "flange/Rotation/Z|flange/Rotation/W|flange/Position/X|flange/Position/Y|flange/Position/Z"
        ),
        {
            "q": "q[{0-5}]",
            "position": "flange/Position/X|flange/Position/Y|flange/Position/Z",
            "rotation": "flange/Rotation/W|flange/Rotation/X|flange/Rotation/Y|flange/Rotation/Z",
            "time": "Time (Seconds)",
        },
    ),
    "units that bind": (
        "Achse {1-6} [°]|M{1-6} [Nm]|T{1-6}_degC|T (°C)|t/s|q7_kg|T_room_degC",
        {"q": "Achse {1-6} [°]", "tau": "M{1-6} [Nm]", "temp": "T{1-6}_degC", "time": "t/s", "ambient": "T_room_degC"},
    ),
}


def expand(text):
    """Names between bars, of which those with `{0-5}` are six."""
    found = []
    for token in text.split("|"):
        match = re.search(r"\{(\d+)-(\d+)\}", token)
        numbers = range(int(match[1]), int(match[2]) + 1) if match else ()
        found += [token.replace(match[0], str(k)) for k in numbers] if match else [token]
    return found


def meant(names, joint_names=()):
    """The blocks of a table by their names alone, and of the first of its poses."""
    found = candidate_blocks(names, joint_names)
    blocks = choose_blocks(found)
    used = {name for block in blocks for name in block.columns}
    poses = pose_sources([block for block in found if not used & set(block.columns)])
    return [*blocks, *([poses[0].position, *poses[0].rotations[:1]] if poses else [])], len(poses)


@pytest.mark.parametrize("case", NAMINGS)
def test_names_are_understood(case):
    names, wanted = NAMINGS[case]
    found, poses = meant(expand(names))
    assert {block.kind: [*block.columns] for block in found} == {kind: expand(own) for kind, own in wanted.items()}
    assert [block.rivals for block in found] == [()] * len(found)
    assert poses <= 1


@pytest.mark.parametrize("pattern", ["T{}{}", "T_{}_{}", "pose[{}][{}]", "pose[{}]", "O_T_EE_{}"])
@pytest.mark.parametrize("shape", [(3, 4), (4, 4)])
@pytest.mark.parametrize("first", [0, 1])
def test_matrices_are_understood(pattern, shape, first):
    one = pattern.count("{}") == 1
    places = [(k,) for k in range(12 if shape == (3, 4) else 16)] if one else [*np.ndindex(shape)]
    names = [pattern.format(*(first + index for index in place)) for place in places]
    found = [block for block in candidate_blocks(names) if block.kind in ("position", "rotation")]
    grid = np.reshape(names, shape)
    by_rows = {block.kind: block for block in found if not block.weak}
    assert by_rows["position"].columns == tuple(grid[:3, 3])
    assert by_rows["rotation"].columns == tuple(grid[:3, :3].ravel())
    grid = np.reshape(names, shape[::-1]).T
    by_columns = {block.kind: block for block in found if block.weak}
    assert by_columns["position"].columns == tuple(grid[:3, 3])


def test_joints_have_the_names_that_the_arm_gives_them():
    names = ["elevator.pos", "time", "claw.pos", "swivel.pos", "elevator.vel", "swivel.vel"]
    found = {block.kind: block.columns for block in meant(names, ("swivel_joint", "elevator"))[0]}
    assert found == {"q": ("swivel.pos", "elevator.pos"), "dq": ("swivel.vel", "elevator.vel"), "time": ("time",)}
