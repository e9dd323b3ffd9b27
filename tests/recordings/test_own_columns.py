"""Tables whose columns have names of their own, the sidecar that says what they are, all their faults in one line."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from lite6jax.errors import InputError
from lite6jax.recordings import Recording, naming, read_recording, read_targets

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


def refusal(path):
    with pytest.raises(InputError) as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{path}: ")


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


def test_without_their_unit_angles_are_any_columns():
    table = {"q1_rad": Q[:, 0], "alpha": Q[:, 0], "roll": Q[:, 0]}
    said = "ignored columns that mean nothing here: 'alpha' (meant alpha_rad?), 'roll' (meant roll_rad?)"
    assert Recording.from_dataframe(table).notes[0] == said
    written = dict.fromkeys(("rx_std_rad", "x_std_m", "tau1_std_Nm"), Q[:, 0])  # beside what `predict` predicts
    assert Recording.from_dataframe(table | written).notes[0] == said


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
    assert refusal(path) == (f"8 problems of its columns: {said}; `lite6jax init '{path}'` names columns as they are")
    table = {"q1_rad": ["a"], "q2_rad": [True], "run": [None], "q3_grad": [0.0]}
    with pytest.raises(InputError) as caught:
        Recording.from_dataframe(table)
    assert str(caught.value) == (
        "recording: 4 problems of its columns: (1) column 'q3_grad': the unit 'grad' is unknown; write q3_rad or "
        "q3_deg. (2) column q1_rad: holds string, not numbers; write it as float64. (3) column q2_rad: holds bool, not "
        "numbers; write it as float64. (4) column run: 1 of 1 rows are NaN, infinite or empty; fill it or leave it out"
    )


def test_a_table_cut_short_is_told_with_the_names(tmp_path):
    path = tmp_path / "run7.csv"
    path.write_text("q1_rad,y_m\n0.1,0.2\n0.1\n")
    assert refusal(path) == (
        "2 problems of its columns: (1) x_m or x_mm is missing; give all of x_m y_m z_m, or none. (2) row 2 has 1 of 2 "
        "columns, y_m is the first without a value: the file is truncated; complete the row or remove it"
    )


@pytest.mark.parametrize(
    ("sidecar", "message"),
    [
        ("columns: {J1: q1}", "column 'J1 (q1)': the unit is missing; write q1_rad or q1_deg"),
        ("columns: {J1: theta}", "column 'J1': the sidecar names it 'theta', which means nothing here; write q1_rad"),
        ("columns: {J2: q1_rad}", "column 'J2' of the sidecar is not in the table; it has 'J1', 'J3'"),
        ("columns: {J1: q1_rad, J3: q1_deg}", "columns J1 and J3 give the same quantity; keep one"),
        ("columns: [J1]", "columns: ['J1'] is not a mapping; write `name in the table: q1_rad` lines below it"),
        ("columns: {J1: 3}", "columns.J1: 3 is no name of a column; write one such as q1_rad, or ignore"),
        ("columns: {J1: q1_rad}\nrecord: {}", "record: unknown key; did you mean recording?"),
    ],
)
def test_a_sidecar_that_names_columns_wrongly(tmp_path, sidecar, message):
    path = written(tmp_path, {"J1": Q[:, 0], "J3": Q[:, 1]}, sidecar)
    assert message in refusal(path)


def test_two_forms_of_an_orientation_are_one_too_many():
    names = ("q1_rad", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "rx_rad", "ry_rad", "rz_rad")
    with pytest.raises(InputError, match="orientation twice, qw qx qy qz and rx_rad ry_rad rz_rad; keep one"):
        Recording.from_dataframe({name: [0.5] for name in names})


# ------------------------------------------------------------------ frames that are not pandas'


class Capsule:
    """A table that only hands out Arrow's stream."""

    def __init__(self, table):
        self._table = table

    def __arrow_c_stream__(self, requested_schema=None):
        return self._table.__arrow_c_stream__(requested_schema)


def test_frames_of_any_library():
    frame = Capsule(pa.table({"J1": Q[:, 0], "q2_rad": Q[:, 1]}))
    recording = Recording.from_dataframe(frame, columns={"J1": "q1_rad"})
    np.testing.assert_array_equal(recording.joint_position, Q)


# ------------------------------------------------------------------ names


def joints(pattern, count=6, first=0):
    return [pattern.format(k) for k in range(first, first + count)]


NAMINGS = {
    "ros": (
        [
            *joints("joint_{}.position", first=1),
            *joints("joint_{}.velocity", first=1),
            "pose.position.x",
            "pose.position.y",
            "pose.position.z",
            *(f"pose.orientation.{c}" for c in "xyzw"),
            "header.stamp.sec",
        ],
        {
            "q": joints("joint_{}.position", first=1),
            "dq": joints("joint_{}.velocity", first=1),
            "position": [f"pose.position.{c}" for c in "xyz"],
            "rotation": [f"pose.orientation.{c}" for c in "wxyz"],
        },
    ),
    "rtde": (
        [
            "timestamp",
            *joints("target_q_{}"),
            *joints("target_qd_{}"),
            *joints("target_moment_{}"),
            *joints("actual_q_{}"),
            *joints("actual_qd_{}"),
            *joints("actual_current_{}"),
            *joints("actual_TCP_pose_{}"),
            *joints("actual_TCP_speed_{}"),
            *joints("actual_TCP_force_{}"),
            *joints("joint_temperatures_{}"),
            *joints("joint_mode_{}"),
            "robot_mode",
            "payload",
            *joints("actual_tool_accelerometer_{}", 3),
            *joints("elbow_position_{}", 3),
            *joints("tcp_offset_{}"),
        ],
        {
            "time": ["timestamp"],
            "q": joints("actual_q_{}"),
            "dq": joints("actual_qd_{}"),
            "current": joints("actual_current_{}"),
            "cmd": joints("target_q_{}"),
            "temp": joints("joint_temperatures_{}"),
            "position": joints("actual_TCP_pose_{}", 3),
            "rotation": joints("actual_TCP_pose_{}", 3, 3),
            "payload": ["payload"],
        },
    ),
    "rtde without what is measured": (
        [*joints("target_q_{}"), *joints("target_qd_{}"), *joints("target_moment_{}")],
        {"q": joints("target_q_{}"), "dq": joints("target_qd_{}"), "tau": joints("target_moment_{}")},
    ),
    "currents as torques": (
        [*joints("actual_q_{}"), *joints("target_qdd_{}"), *joints("actual_current_as_torque_{}")],
        {"q": joints("actual_q_{}"), "tau": joints("actual_current_as_torque_{}")},
    ),
    "libfranka": (
        [
            name
            for of in ("tau_ext_hat_filtered", "tau_J_d", "q_d", "q", "dq_d", "dq", "tau_J", "ddq_d")
            for name in joints(of + "[{}]", 7)
        ],
        {
            "q": joints("q[{}]", 7),
            "dq": joints("dq[{}]", 7),
            "tau": joints("tau_J[{}]", 7),
            "cmd": joints("q_d[{}]", 7),
        },
    ),
    "torques from outside": (
        [*joints("q{}"), *joints("tau_ext_hat_filtered_{}"), *(f"tau_ext.shoulder_{part}" for part in ("pan", "lift"))],
        {"q": joints("q{}")},
    ),
    "mujoco": (
        [
            *joints("qpos[{}]"),
            *joints("qvel[{}]"),
            *joints("qacc[{}]"),
            *joints("ctrl[{}]"),
            *joints("qfrc_bias[{}]"),
            *joints("qfrc_actuator[{}]"),
        ],
        {
            "q": joints("qpos[{}]"),
            "dq": joints("qvel[{}]"),
            "ddq": joints("qacc[{}]"),
            "tau": joints("qfrc_actuator[{}]"),
        },
    ),
    "lists of a LeRobot data set": (
        [*joints("observation.state.{}"), *joints("observation.effort.{}"), *joints("action.{}")],
        {
            "q": joints("observation.state.{}"),
            "tau": joints("observation.effort.{}"),
            "cmd": joints("action.{}"),
        },
    ),
    "kuka": (
        [*joints("A{}", first=1), *"XYZABC"],
        {"q": joints("A{}", first=1), "position": [*"XYZ"], "rotation": [*"CBA"]},
    ),
    "plain": (
        [*joints("q{}"), *joints("dq{}"), *joints("ddq{}"), *joints("tau{}"), *"xyz", "qx", "qy", "qz", "qw", "t"],
        {
            "q": joints("q{}"),
            "dq": joints("dq{}"),
            "ddq": joints("ddq{}"),
            "tau": joints("tau{}"),
            "position": [*"xyz"],
            "rotation": ["qw", "qx", "qy", "qz"],
            "time": ["t"],
        },
    ),
    "arrays": (
        [
            *joints("position_{}"),
            *joints("velocity_{}"),
            *joints("effort_{}"),
            "tcp_x",
            "tcp_y",
            "tcp_z",
            "tcp_rx",
            "tcp_ry",
            "tcp_rz",
            "gripper_position",
            "position_error_0",
        ],
        {
            "q": joints("position_{}"),
            "dq": joints("velocity_{}"),
            "tau": joints("effort_{}"),
            "position": ["tcp_x", "tcp_y", "tcp_z"],
            "rotation": ["tcp_rx", "tcp_ry", "tcp_rz"],
        },
    ),
    "plotjuggler": (
        [
            "__time",
            *joints("/joint_states/position[{}]"),
            "/tracker/pose/position/x",
            "/tracker/pose/position/y",
            "/tracker/pose/position/z",
        ],
        {
            "time": ["__time"],
            "q": joints("/joint_states/position[{}]"),
            "position": [f"/tracker/pose/position/{c}" for c in "xyz"],
        },
    ),
    "camel": (
        [*joints("currentJointPosition{}", first=1), *joints("jointTorque{}", first=1), "toolX", "toolY", "toolZ"],
        {
            "q": joints("currentJointPosition{}", first=1),
            "tau": joints("jointTorque{}", first=1),
            "position": ["toolX", "toolY", "toolZ"],
        },
    ),
    "universal robots' joints": (
        [f"{part}_joint" for part in ("elbow", "shoulder_lift", "shoulder_pan", "wrist_1", "wrist_2", "wrist_3")],
        {
            "q": [
                f"{part}_joint" for part in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
            ]
        },
    ),
    "universal robots' teach pendant": (
        ["No", "Wrist 3", "Wrist 2", "Wrist 1", "Elbow", "Shoulder", "Base", *(f"Laser {c} [mm]" for c in "XYZ")],
        {
            "q": ["Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3"],
            "position": ["Laser X [mm]", "Laser Y [mm]", "Laser Z [mm]"],
        },
    ),
    "lerobot": (
        [
            "action.waist",
            "action.elbow",
            "observation.state.waist",
            "observation.state.elbow",
            "observation.state.gripper",
            "timestamp",
            "frame_index",
            "episode_index",
            "index",
            "task_index",
        ],
        {
            "q": ["observation.state.waist", "observation.state.elbow"],
            "cmd": ["action.waist", "action.elbow"],
            "time": ["timestamp"],
            "run": ["episode_index"],
        },
    ),
    "a quaternion q_w": (
        [*joints("jt{}", first=1), "px", "py", "pz", "q_w", "q_x", "q_y", "q_z"],
        {
            "q": joints("jt{}", first=1),
            "position": ["px", "py", "pz"],
            "rotation": ["q_w", "q_x", "q_y", "q_z"],
        },
    ),
    "opencv": (
        [*joints("θ{}", first=1), *joints("tvec_{}", 3), *joints("rvec_{}", 3)],
        {"q": joints("θ{}", first=1), "position": joints("tvec_{}", 3), "rotation": joints("rvec_{}", 3)},
    ),
    "an end effector's": (
        [*joints("theta_{}", first=1), "tx", "ty", "tz", *(f"ee_quat_{c}" for c in "xyzw")],
        {"q": joints("theta_{}", first=1), "position": ["tx", "ty", "tz"]},  # of another source
    ),
    "commanded and measured": (
        [*joints("J{}", first=1), "x_cmd", "y_cmd", "z_cmd", "x_meas", "y_meas", "z_meas"],
        {"q": joints("J{}", first=1), "position": ["x_meas", "y_meas", "z_meas"]},
    ),
    "yaskawa": (
        ["T", "B", "R", "U", "L", "S", *"XYZ", "time"],
        {"q": [*"SLURBT"], "position": [*"XYZ"], "time": ["time"]},
    ),
    "yaskawa, seven axes": ([f"pos_{axis} [°]" for axis in "SLEURBT"], {"q": [f"pos_{a} [°]" for a in "SLEURBT"]}),
    "external axes": (
        [
            *("E1", "E2", "Ext1", "linear_axis", "ext_axis_1", *joints("A{}", first=1)),
            *(*joints("tau_ext_{}"), *joints("temp_sensor_{}")),
        ],
        {"q": joints("A{}", first=1), "temp": joints("temp_sensor_{}")},
    ),
    "fanuc": (
        [*joints("J{}", first=1), *"XYZWPR"],
        {"q": joints("J{}", first=1), "position": [*"XYZ"], "rotation": [*"WPR"]},
    ),
    "motion capture": (
        [
            *("Frame", "Time (Seconds)", "flange/Mean Marker Error", *joints("q[{}]")),
            *(f"flange/{kind}/{c}" for kind, parts in (("Rotation", "XYZW"), ("Position", "XYZ")) for c in parts),
        ],
        {
            "q": joints("q[{}]"),
            "position": [f"flange/Position/{c}" for c in "XYZ"],
            "rotation": [f"flange/Rotation/{c}" for c in "WXYZ"],
            "time": ["Time (Seconds)"],
        },
    ),
    "units that bind": (
        [
            *(*joints("Achse {} [°]", first=1), *joints("M{} [Nm]", first=1), *joints("T{}_degC", first=1)),
            *("T (°C)", "t/s", "q7_kg", "T_room_degC"),
        ],
        {
            "q": joints("Achse {} [°]", first=1),
            "tau": joints("M{} [Nm]", first=1),
            "temp": joints("T{}_degC", first=1),
            "time": ["t/s"],
            "ambient": ["T_room_degC"],
        },
    ),
    "positions of a point beside joints": (
        [*joints("theta_{}", 4), *joints("position_{}", 3)],
        {"q": joints("theta_{}", 4), "position": joints("position_{}", 3)},
    ),
}


def meant(names, joint_names=()):
    """The blocks of a table by their names alone, and of the first of its poses."""
    found = naming.candidates(names, joint_names)
    blocks = naming.choose(found)
    used = {name for block in blocks for name in block.columns}
    poses = naming.sources([block for block in found if not used & set(block.columns)])
    return [*blocks, *([poses[0].position, *poses[0].rotations[:1]] if poses else [])], len(poses)


@pytest.mark.parametrize("case", NAMINGS)
def test_names_are_understood(case):
    names, wanted = NAMINGS[case]
    found, poses = meant(names)
    assert {block.kind: [*block.columns] for block in found} == wanted
    assert [block.rivals for block in found] == [()] * len(found)
    assert poses <= 1


@pytest.mark.parametrize("pattern", ["T{}{}", "T_{}_{}", "pose[{}][{}]", "pose[{}]", "O_T_EE_{}"])
@pytest.mark.parametrize("shape", [(3, 4), (4, 4)])
@pytest.mark.parametrize("first", [0, 1])
def test_matrices_are_understood(pattern, shape, first):
    one = pattern.count("{}") == 1
    places = [(k,) for k in range(12 if shape == (3, 4) else 16)] if one else [*np.ndindex(shape)]
    names = [pattern.format(*(first + index for index in place)) for place in places]
    found = [block for block in naming.candidates(names) if block.kind in ("position", "rotation")]
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
    assert found == {
        "q": ("swivel.pos", "elevator.pos"),
        "dq": ("swivel.vel", "elevator.vel"),
        "time": ("time",),
    }


def test_the_names_of_a_recording_mean_what_they_say():
    names = ["time_ms", "q1_rad", "q2_rad", "dq1_rad_per_s", "dq2_rad_per_s", "ddq1_deg_per_s2", "ddq2_deg_per_s2"]
    names += ["tau1_mNm", "tau2_mNm", "current1_A", "current2_A", "temp1_degC", "temp2_degC", "ambient_degC"]
    names += ["payload_kg", "run", "x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg"]
    found = {block.kind: block for block in meant(names)[0]}
    assert {kind: block.unit for kind, block in found.items()} == {
        "q": "rad",
        "dq": "rad_per_s",
        "ddq": "deg_per_s2",
        "tau": "mNm",
        "current": "A",
        "temp": "degC",
        "position": "mm",
        "rotation": "deg",
        "time": "ms",
        "payload": "kg",
        "ambient": "degC",
        "run": None,
    }
    assert found["rotation"].form == ("roll", "pitch", "yaw")
    assert sorted(sum((block.columns for block in found.values()), ())) == sorted(names)


def test_units_stand_at_the_end_of_names_in_many_ways():
    said = {"tcp x [mm]": "mm", "tcp_x_mm": "mm", "tcp.x (m)": "m", "tcp_x": None}
    for name, unit in said.items():
        names = [name.replace("x", axis, 1) if "x" in name else name for axis in "xyz"]
        ((block,), _) = meant(names)
        assert (block.kind, block.unit) == ("position", unit)
    (_, block), _ = meant([f"pose_{part}" for part in "xyzabc"])
    assert (block.kind, block.columns) == ("rotation", ("pose_c", "pose_b", "pose_a"))  # not amperes and degrees


def test_torques_and_commands_are_those_of_the_same_arm():
    names = [f"{side}_{what}_{k}" for what in ("joint", "torque", "target_joint") for side in ("left", "right")
             for k in range(2)]  # fmt: skip
    found = naming.choose(naming.candidates(names), 2, ["right_joint_0", "right_joint_1"])
    assert [block.columns[0] for block in found] == ["right_joint_0", "right_torque_0", "right_target_joint_0"]


def test_what_may_be_meant_instead_is_named():
    names = [*joints("left_joint_{}"), *joints("right_joint_{}")]
    ((block,), _) = meant(names)
    assert (block.columns[0], block.rivals) == ("left_joint_0", ("right_joint_0",))
