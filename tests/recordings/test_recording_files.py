import os
from random import Random

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from typed import unread

from lite6jax.errors import InputError
from lite6jax.recordings import Recording, RecordingSettings, read_recording, write_recording
from tests.damaged import flip_bit, recording

JOINTS = "q1_rad,q2_rad"
SIDECAR = "recording: {motion: static}\n"


def file(tmp_path, text, name="run7.csv", sidecar=SIDECAR):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    if sidecar:
        path.with_suffix(".yaml").write_text(sidecar)
    return path


def test_every_column_of_the_document_is_read_in_si(tmp_path):
    text = (
        "time_s,q1_rad,q2_rad,dq1_rad_per_s,dq2_rad_per_s,ddq1_rad_per_s2,ddq2_rad_per_s2,tau1_Nm,tau2_Nm,current1_A,current2_A,temp1_degC,temp2_degC,"
        "cmd1_rad,cmd2_deg,ambient_degC,payload_kg,run,x_m,y_m,z_m,qw,qx,qy,qz\n"
        "0,0.1,0.2,1,2,7,8,3,4,5,6,25,26,0.2,0,21,0.5,7,0.3,0.4,0.5,1,0,0,0\n"
        "0.5,0.2,0.1,-1,-2,-7,-8,-3,-4,-5,-6,27,28,0.3,180,22,0.6,8,0.6,0.7,0.8,0,1,0,0\n"
    )
    recording = read_recording(file(tmp_path, text))
    assert recording.time.tolist() == [0, 0.5]
    assert recording.joint_position.tolist() == [[0.1, 0.2], [0.2, 0.1]]
    assert recording.joint_velocity.tolist() == [[1, 2], [-1, -2]]
    assert recording.joint_acceleration.tolist() == [[7, 8], [-7, -8]]
    assert recording.joint_torque.tolist() == [[3, 4], [-3, -4]]
    assert recording.motor_current.tolist() == [[5, 6], [-5, -6]]
    assert recording.joint_temperature.tolist() == [[25, 26], [27, 28]]
    assert recording.commanded_position.tolist() == [[0.2, 0], [0.3, np.pi]]
    assert recording.ambient_temperature.tolist() == [21, 22]
    assert recording.payload.tolist() == [0.5, 0.6]
    assert recording.run.tolist() == [7, 8]
    assert recording.position.tolist() == [[0.3, 0.4, 0.5], [0.6, 0.7, 0.8]]
    assert recording.quaternion.tolist() == [[1, 0, 0, 0], [0, 1, 0, 0]]
    assert recording.row.tolist() == [1, 2]
    assert recording.motion == "static"
    assert recording.source == str(tmp_path / "run7.csv")
    assert recording.notes == ()


def test_other_units_are_converted_and_may_be_mixed(tmp_path):
    text = (
        "time_ms,q1_deg,q2_rad,dq1_deg_per_s,dq2_rad_per_s,ddq1_deg_per_s2,ddq2_rad_per_s2,tau1_mNm,tau2_Nm,"
        "current1_mA,current2_A,x_mm,y_m,z_mm\n"
        "20,90,1,180,2,-360,3,4300,4.3,1500,1.5,371.5,0.25,-1\n"
    )
    recording = read_recording(file(tmp_path, text))
    np.testing.assert_allclose(recording.joint_position, [[np.pi / 2, 1]], rtol=1e-15)
    np.testing.assert_allclose(recording.joint_velocity, [[np.pi, 2]], rtol=1e-15)
    np.testing.assert_allclose(recording.joint_acceleration, [[-2 * np.pi, 3]], rtol=1e-15)
    assert recording.joint_torque.tolist() == [[4.3, 4.3]]
    assert recording.motor_current.tolist() == [[1.5, 1.5]]
    assert recording.position.tolist() == [[0.3715, 0.25, -0.001]]  # to the last digit
    assert recording.time.tolist() == [0.02]


@pytest.mark.parametrize(
    "text",
    [
        "\ufeffq1_rad,q2_rad\n1,2\n3,4\n",
        "q1_rad,q2_rad\r\n1,2\r\n3,4\r\n",
        "q1_rad, q2_rad\n 1, 2\n 3 , 4\n",
        '"q1_rad","q2_rad"\n"1","2"\n3,4\n\n\n',
        "q1_rad\tq2_rad\r\n1,0\t2\r\n3\t4,0\r\n",
    ],
)
def test_the_ways_a_table_may_be_written(tmp_path, text):
    assert read_recording(file(tmp_path, text)).joint_position.tolist() == [[1, 2], [3, 4]]


def test_unknown_columns_are_ignored_and_named(tmp_path):
    recording = read_recording(file(tmp_path, f"{JOINTS},note,x2_m,ambent_degC\n1,2,a,b,3\n"))
    assert recording.ambient_temperature is None
    assert recording.notes == (
        "ignored columns that mean nothing here: 'note', 'x2_m' (meant x_m?), 'ambent_degC' (meant ambient_degC?)",
    )
    many = ",".join(f"extra{k}" for k in range(9))
    recording = read_recording(file(tmp_path, f"{JOINTS},{many}\n1,2{',x' * 9}\n"))
    assert recording.notes[0].endswith("'extra4', 'extra5' and 3 more")


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("time_s,x_m", "has no joint positions; name their columns q1_rad ... qN_rad (or q1_deg ...); it has"),
        ("q1_rad,q2_rad,q4_rad", "q3_rad or q3_deg is missing while q4 is there; give every joint"),
        ("q2_rad", "q1_rad or q1_deg is missing while q2 is there; give every joint"),
        ("q1", "column 'q1': the unit is missing; write q1_rad or q1_deg"),
        ("q1_grad", "column 'q1_grad': the unit 'grad' is unknown; write q1_rad or q1_deg"),
        ("q0_rad,q1_rad", "column 'q0_rad': joints are numbered from 1; write q1_rad or q1_deg"),
        (f"{JOINTS},dq1_rpm,dq2_rpm", "column 'dq1_rpm': the unit 'rpm' is unknown; write dq1_rad_per_s or"),
        (f"{JOINTS},tau1_Nm", "tau2_Nm or tau2_mNm is missing beside its like; give it for all joints"),
        (f"{JOINTS},x_m,y_m", "z_m or z_mm is missing; give all of x_m y_m z_m, or none"),
        (f"{JOINTS},x_m,y_m,z_m,qw,qx,qz", "qy is missing; give all of qw qx qy qz, or none"),
        (f"{JOINTS},qw,qx,qy,qz", "has the orientation qw qx qy qz without a position; add x_m y_m z_m"),
        (f"{JOINTS},temp1_degC,temp2_degC,temp3_degC", "column temp3_degC: the joint positions end with q2; add q3 or"),
        (f"{JOINTS},q1_deg", "columns q1_rad and q1_deg give the same quantity; keep one"),
        (f"{JOINTS},q1_rad", "column q1_rad stands there twice; keep one"),
    ],
)
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_columns_that_cannot_be_understood(tmp_path, header, message, suffix):
    names = header.split(",")
    path = file(tmp_path, header + "\n" + ",".join("1" for _ in names) + "\n")
    if suffix == "parquet":
        path = path.with_suffix(".parquet")
        pq.write_table(pa.Table.from_arrays([pa.array([1.0])] * len(names), names=names), path)
    assert message in unread(path)


FINE = f"{JOINTS},x_m,y_m,z_m\n" + "0.1,0.2,0.3,0.4,0.5\n" * 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty; record again"),
        (f"{JOINTS}\n", "has column names but no rows; record again"),
        ("0.1,0.2\n0.3,0.4\n", "its first row holds numbers, and no line names the columns; `lite6jax init"),
        (FINE + "0.1,0.2,0.3", "row 4 has 3 of 5 columns, y_m is the first without a value: the file is truncated;"),
        (FINE + "0.1,0.2\n" + FINE[-20:], "row 4 has 2 of 5 columns, x_m is the first without a value: the row is cut"),
        (FINE + "0,1,0,2,0,3,0,4,0,5\n", "row 4 has 10 of 5 columns, twice as many, as where decimal commas"),
        (
            FINE + "0.1,0.2,0.3,0.4,0.5,ok\n",
            "row 4 has 6 of 5 columns: of 4 rows 3 have 5, 1 have 6 fields, and there are 5",
        ),
        (
            FINE.replace("0.5", "0.5,0"),
            "row 1 has 6 of 5 columns: of 3 rows 3 have 6 fields, and there are 5 names; name",
        ),
        (
            FINE + "0,0,0,0\n0,0\n",
            "row 4 has 4 of 5 columns, z_m is the first without a value: of 5 rows 1 have 2, 1 have",
        ),
        (FINE + "0.1,oops,0.3,0.4,0.5\n", "column q2_rad: row 4 holds 'oops', which is no number; give numbers with a"),
        (FINE + "0.1,0.2,0.3,0.4,\0\n", "is not a CSV table but binary or of another encoding; write it as UTF-8 text"),
        (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "is not a CSV table but binary or of another encoding"),
        (b"PAR1" + bytes(20), "is a Parquet file, whatever its name says; name it .parquet"),
        (FINE.replace(".", ",").replace(",", ";"), "row 1 has 10 of 5 columns, twice as many, as where"),
        ("q1_rad;q2_rad\n0,1;0,2\n0,1;0.2\n", "column q2_rad: row 2 holds '0.2', which is no number; give numbers"),
        ("<html><body>404</body></html>\n", "is a page or XML, and no table; write its numbers as CSV"),
        ('{"q1_rad": [0.1,\n0.2]}\n', "is JSON, and no table; write its numbers as CSV with a name for each column"),
        (FINE * 2, "row 4 repeats the names of the columns; remove it, and give each recording a file"),
    ],
    ids=range(18),
)
def test_a_csv_that_is_none(tmp_path, content, message):
    assert message in unread(file(tmp_path, content))


def test_the_row_of_a_fault_is_right_in_a_file_of_many_blocks(tmp_path):
    body = b"0.123456789,0.987654321\n" * 100_000  # 2.4 MB: several of Arrow's blocks, read by several threads
    path = file(tmp_path, f"{JOINTS}\n".encode() + body + b"0.1,abc\n" + body)
    assert unread(path).startswith("column q2_rad: row 100001 holds 'abc', which is no number")
    path = file(tmp_path, f"{JOINTS}\n".encode() + body + b"0.1\n" + body)
    assert unread(path).startswith("row 100001 has 1 of 2 columns, q2_rad is the first without a value: the row is cut")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("run7.pkl", "is no recording; write it as run7.csv or .parquet with a name for each column"),
        (
            "run7.doc",
            "a recording ends in .csv, .txt, .parquet, .xlsx, .h5, .npz, .mat or .mcap, or is the folder of a",
        ),
        ("run7", "no such file or folder; check the name"),
        ("absent.csv", "no such file; check the name"),
        ("folder.csv", "is a folder; name a file"),
    ],
)
def test_a_path_that_is_no_recording(tmp_path, name, message):
    (tmp_path / "folder.csv").mkdir()
    (tmp_path / "run7.pkl").write_text(FINE)
    assert message in unread(tmp_path / name)


def parquet(tmp_path, **columns):
    path = tmp_path / "run7.parquet"
    pq.write_table(pa.table(columns), path)
    path.with_suffix(".yaml").write_text(SIDECAR)
    return path


def test_a_parquet_that_is_none(tmp_path):
    path = file(tmp_path, FINE, "run7.parquet")
    assert unread(path).startswith("is not Parquet, whatever its name says (Parquet magic bytes not found")
    assert unread(file(tmp_path, b"", "run7.parquet")).startswith("is not Parquet, whatever its name says")
    whole = parquet(tmp_path, q1_rad=np.arange(1000.0), q2_rad=np.arange(1000.0)).read_bytes()
    for part in (whole[:-9], whole[: len(whole) // 2], whole[:8] + b"\xff" * 4000 + whole[4008:]):
        message = unread(file(tmp_path, part, "run7.parquet"))
        assert message.startswith("is truncated or damaged (")
        assert message.endswith("; write it again")


def test_lists_and_structs_of_a_parquet_are_a_column_for_each_number(tmp_path):
    path = parquet(
        tmp_path,
        state=pa.array([{"position": [0.1, 0.2], "stamp": None}, None, {"position": [0.3, 0.4], "stamp": 3}]),
        tool=pa.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]], pa.list_(pa.float32(), 3)),
        time_s=[[0.0], [1.0], [2.0]],
    )
    lines = [f"state.position[{k}]: q{k + 1}_rad" for k in range(2)] + [f"tool[{k}]: {'xyz'[k]}_mm" for k in range(3)]
    path.with_suffix(".yaml").write_text("columns:\n  " + "\n  ".join(lines) + f"\n{SIDECAR}")
    recording = read_recording(path)
    assert recording.joint_position.tolist() == [[0.1, 0.2], [0.3, 0.4]]
    assert (1e3 * recording.position).tolist() == [[1, 2, 3], [7, 8, 9]]
    assert recording.time.tolist() == [0, 2]
    assert unread(parquet(tmp_path, q1_rad=[[1.0], [2.0, 3.0]])) == (
        "column q1_rad: its lists hold 1 to 2 numbers; give each row as many"
    )


@pytest.mark.parametrize("blank", ["", "NaN", "-inf", "null", "1e999"])
@pytest.mark.parametrize("column", [0, 2, 3, 7])
def test_rows_with_anything_missing_are_dropped_and_counted(tmp_path, blank, column):
    header = "q1_rad,q2_rad,time_s,run,temp1_degC,temp2_degC,x_m,y_m,z_m"
    rows = [[f"{k}.5", "0.2", f"{k}", "3", "25", "26", "0.1", "0.2", "0.3"] for k in range(6)]
    rows[2][column] = rows[4][column] = blank
    recording = read_recording(file(tmp_path, "\n".join([header, *map(",".join, rows), ""])))
    assert recording.row.tolist() == [1, 2, 4, 6]
    assert recording.joint_position[:, 0].tolist() == [0.5, 1.5, 3.5, 5.5]
    assert recording.direction_of_motion[:, 0].tolist() == [1, 1, 1, 1]
    assert set(recording.run) == {3}
    assert recording.notes == ("dropped 2 rows with NaN, infinite or empty fields, the first is row 3",)


def test_a_recording_without_a_sidecar_says_what_it_assumes(tmp_path):
    recording = read_recording(file(tmp_path, "q1_rad,time_s\n0,0\n1,0.1\n2,0.2\n", sidecar=None))
    assert recording.settings == RecordingSettings()
    assert recording.motion == "trajectory"
    assert recording.notes == (
        "there is no sidecar run7.yaml: the defaults are assumed",
        "the motion is not declared and is taken as trajectory: its time step is 0.1 s",
        "the joint velocities were not recorded and come from differentiating the positions over time",
    )
    np.testing.assert_allclose(recording.velocities(), 10.0)


LIMITS = np.deg2rad([[-360, 360], [-150, 150]])


def test_degrees_named_radians_are_asked_about_and_accepted(tmp_path):
    path = file(tmp_path, f"{JOINTS},dq1_rad_per_s,dq2_rad_per_s\n10,-20,1,2\n170,140,3,4\n-170,-90,5,6\n")
    assert unread(path, joint_limits=LIMITS) == (
        "column q2_rad: row 1 is at -20 rad while the arm's joint 2 goes from -2.618 to 2.618 rad; are these degrees? "
        "name the columns q1_deg ... or add `assume_degrees=True`"
    )
    recording = read_recording(path, joint_limits=LIMITS, assume_degrees=True)
    np.testing.assert_allclose(np.rad2deg(recording.joint_position), [[10, -20], [170, 140], [-170, -90]], rtol=1e-15)
    np.testing.assert_allclose(np.rad2deg(recording.joint_velocity), [[1, 2], [3, 4], [5, 6]], rtol=1e-15)
    assert recording.notes == ("columns q1_rad ... dq2_rad_per_s are taken as degrees, as asked",)
    assert read_recording(path).joint_position[1, 0] == 170  # without limits nothing can be said


def test_millimetres_named_metres_are_asked_about_and_accepted(tmp_path):
    rows = "0,0,100,200,300\n0,0,-100,200,500\n0,0,100,-300,300\n"
    path = file(tmp_path, f"{JOINTS},x_m,y_m,z_m\n{rows}")
    message = unread(path, reach=0.7)
    assert message.startswith("columns x_m y_m z_m: the positions lie ")
    assert message.endswith(
        "m from their middle (median) while the arm reaches 0.7 m; are these millimetres? name the columns x_mm y_mm "
        "z_mm or add `assume_millimetres=True`"
    )
    recording = read_recording(path, reach=0.7, assume_millimetres=True)
    assert recording.position.tolist() == [[0.1, 0.2, 0.3], [-0.1, 0.2, 0.5], [0.1, -0.3, 0.3]]
    assert recording.notes == ("columns x_m ... z_m are taken as millimetres, as asked",)
    path = file(tmp_path, f"{JOINTS},x_mm,y_mm,z_mm\n{rows}")
    assert read_recording(path, reach=0.7, assume_millimetres=True).notes == ()


def up_to(largest):
    """Numbers that a recording may hold, the smallest and -0 among them."""
    return st.floats(-largest, largest, allow_subnormal=True)


@st.composite
def contents(draw):
    """What a recording is made from."""
    samples, dof = draw(st.integers(1, 5)), draw(st.integers(1, 7))

    def block(*columns, elements):
        return draw(arrays(np.float64, (samples, *columns), elements=elements))

    def maybe(largest, *columns):
        return block(*columns, elements=up_to(largest)) if draw(st.booleans()) else None

    position, quaternion = maybe(49.0, 3), None
    if position is not None and draw(st.booleans()):
        quaternion = block(4, elements=st.floats(0.25, 1)) * draw(st.sampled_from([1, -1]))
        quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    return {
        "joint_position": block(dof, elements=up_to(6e3)),
        "position": position,
        "quaternion": quaternion,
        "time": block(elements=st.floats(-1e7, 1e7)) if draw(st.booleans()) else None,
        "joint_velocity": maybe(1e4, dof),
        "joint_acceleration": maybe(1e7, dof),
        "joint_torque": maybe(1e5, dof),
        "motor_current": maybe(1e5, dof),
        "joint_temperature": maybe(1e4, dof),
        "commanded_position": maybe(6e3, dof),
        "ambient_temperature": maybe(1e4),
        "payload": maybe(1e5),
        "run": draw(arrays(np.int64, samples, elements=st.integers(-(2**53), 2**53))) if draw(st.booleans()) else None,
        "settings": {
            "motion": "static",
            "tool": draw(st.sampled_from(["none", "unknown", (0.1, -0.2, 1 / 3, 0.0, 1e-9, -3.0)])),
            "joint_noise_rad": draw(st.floats(0, 1.0)),
            "position_noise_m": draw(st.none() | st.floats(1e-12, 1.0)),
            "gravity_m_per_s2": tuple(draw(arrays(np.float64, 3, elements=up_to(100.0))).tolist()),
            "torque_source": draw(st.sampled_from(["measured", "current", "estimated", "unknown"])),
            "torque_noise_Nm": draw(st.none() | st.tuples(*[st.floats(1e-9, 1e4)] * dof)),
            "inertial": draw(st.sampled_from(["declared", "unknown"]) | st.floats(1e-300, 0.5)),
            "torque_constant_Nm_per_A": draw(st.none() | st.tuples(*[st.floats(-1e5, -1e-9)] * dof)),
        },
    }


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(content=contents(), suffix=st.sampled_from([".csv", ".parquet"]))
def test_round_trips_are_exact(tmp_path, content, suffix):
    recording = Recording.assembled(**content | {"settings": RecordingSettings(**content["settings"])})
    again = read_recording(write_recording(recording, tmp_path / f"run7{suffix}", overwrite=True))
    assert again.settings == recording.settings
    assert again.motion == recording.motion
    expected, actual = (
        {name: array for name, array in vars(one).items() if isinstance(array, np.ndarray)}
        for one in (recording, again)
    )
    assert expected.keys() == actual.keys()
    for name, array in expected.items():
        assert actual[name].dtype == array.dtype, name
        assert actual[name].shape == array.shape, name
        np.testing.assert_array_equal(actual[name], array, err_msg=name)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_differentiated_velocities_are_not_written_as_recorded(tmp_path, suffix):
    time = np.arange(20) * 0.05
    recording = Recording.from_arrays(
        np.sin(time)[:, None], time=time, run=np.arange(20) // 10, settings=RecordingSettings(motion="trajectory")
    )
    path = write_recording(recording, tmp_path / f"run7{suffix}")
    again = read_recording(path)
    assert again.velocity_differentiated
    assert list(again.columns()) == ["time_s", "q1_rad", "run"]
    np.testing.assert_array_equal(again.velocities(), recording.velocities())


def test_writing_replaces_nothing_unasked_and_leaves_nothing_half_done(tmp_path, monkeypatch):
    recording = Recording.from_arrays([[0.1, 0.2]])
    path = write_recording(recording, tmp_path / "run7.csv")
    assert path.read_text() == "q1_rad,q2_rad\n0.1,0.2\n"
    with pytest.raises(InputError, match=r"run7\.csv: exists already; choose another name or add `overwrite=True`"):
        write_recording(recording, path)
    path.unlink()
    with pytest.raises(InputError, match=r"run7\.yaml: exists already; choose another name or add `overwrite=True`"):
        write_recording(recording, path)
    assert sorted(os.listdir(tmp_path)) == ["run7.yaml"]
    with pytest.raises(InputError, match=r"run7\.xlsx: a recording ends in \.csv or \.parquet; choose such a name"):
        write_recording(recording, tmp_path / "run7.xlsx")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pyarrow.csv, "write_csv", full)
    with pytest.raises(InputError, match=r"other\.csv: cannot be written \(No space left on device\); free space"):
        write_recording(recording, tmp_path / "other.csv")
    assert sorted(os.listdir(tmp_path)) == ["run7.yaml"]


def test_torques_are_those_recorded_or_currents_times_constants(tmp_path):
    head, row = f"{JOINTS},current1_mA,current2_mA", "1,2,500,-4000"
    constants = "recording: {motion: static, torque_constant_Nm_per_A: [10, -0.5]}"
    read = read_recording(file(tmp_path, f"{head}\n{row}\n", sidecar=constants))
    assert read.joint_torque is None
    assert read.torques().tolist() == [[5, 2]]
    both = read_recording(file(tmp_path, f"{head},tau1_mNm,tau2_Nm\n{row},7000,8\n", sidecar=constants))
    assert both.torques().tolist() == [[7, 8]]
    path = file(tmp_path, f"{head}\n{row}\n")
    assert unread(path, lambda file: read_recording(file).torques()) == (
        "has motor currents without torque constants; declare torque_constant_Nm_per_A in the sidecar, one number per "
        "joint"
    )
    path = file(tmp_path, f"{JOINTS}\n1,2\n", sidecar=constants)
    assert unread(path, lambda file: read_recording(file).torques()) == (
        "has no joint torques; add tau1_Nm ..., or current1_A ... and torque_constant_Nm_per_A in the sidecar"
    )


def test_no_flipped_bit_of_a_parquet_file_changes_numbers_in_silence(tmp_path):
    path = write_recording(recording(), tmp_path / "run7.parquet")
    assert pq.ParquetFile(path).metadata.num_rows == 60
    path.with_suffix(".yaml").write_text("recording: {motion: static, pose_frame: base}\n")
    whole, content = read_recording(path), path.read_bytes()
    rng, refused = Random(0), 0
    for _ in range(150):
        path.write_bytes(flip_bit(content, rng))
        try:
            read = read_recording(path)
        except InputError:
            refused += 1
            continue
        for name, column in whole.columns().items():
            assert read.notes != whole.notes or np.array_equal(read.columns()[name], column), name
    assert refused > 75


@pytest.mark.parametrize("end", [b"0.3", b"\0" * 5000, b"0.3,0.2\0\0"])
@pytest.mark.parametrize("name", ["run7.csv", "run7.growing.csv"])
def test_what_a_kill_or_a_power_cut_leaves_at_the_end_of_a_recording_is_left_out(tmp_path, name, end):
    rows = "".join(f"0.{k},0.2\n" for k in range(1, 4))
    path = file(tmp_path, f"{JOINTS}\n{rows}".encode() + end, name)
    (tmp_path / "run7.yaml").write_text("recording: {}\naccount: {complete: false}\n")
    for asked in (path, tmp_path / "run7.parquet") if "growing" in name else (path,):
        read = read_recording(asked)
        assert read.joint_position[:, 0].tolist() == [0.1, 0.2, 0.3]
        assert any(f"at the end of {name} is left out" in note for note in read.notes)
    (tmp_path / "run7.yaml").write_text("recording: {}\n")  # of a complete one, nobody knows what is lost
    unread(path)
