"""Tables as people have them: found below titles and header blocks, with the names and units that stand above them."""

from math import pi

import numpy as np
import pytest
import yaml
from typed import refused, run

from lite6jax.errors import InputError
from lite6jax.recordings import ArmJoints, read_recording
from lite6jax.recordings.files import open_table

VALUES = np.array([[0.5, -1.25, 30.5], [1.5, 2.75, -40.25], [-2.5, 0.0, 50.0], [3.5, 1.0, 60.5]])


def rows(delimiter=",", decimal=".", end="", values=VALUES):
    return "".join(delimiter.join(f"{v:.3f}".replace(".", decimal) for v in row) + end + "\n" for row in values)


def opened(tmp_path, content, name="run7.csv"):
    """The names, the numbers, and what is said of the file."""
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    notes: list[str] = []
    _, table = open_table(path, (), ArmJoints(), notes)
    columns = list(table.numbers())
    return [name for name, _ in columns], [values for _, values in columns], notes


ALIGNED = "".join("".join(f"{v:12.4f}" for v in row) + "\n" for row in VALUES)
ABOVE = "line 1 stands above the table and is not read: 'Robot test 7'"


@pytest.mark.parametrize(
    ("text", "names", "said"),
    [
        ("\n\na,b,c\n" + rows(), "a b c", []),
        ("Robot test 7\n\na,b,c\n" + rows(), "a b c", [ABOVE]),
        ("Robot test 7;;\n;;\na;b;c\n" + rows(";", ","), "a b c", [ABOVE.replace("7'", "7;;'")]),
        ("sep=;\na;b;c\n" + rows(";", ","), "a b c", []),
        ("# Robot test 7\n# a,b,c\n" + rows(), "a b c", [ABOVE.replace("Robot", "# Robot")]),
        ("% a b c\n" + ALIGNED, "a b c", []),
        ("    joint 1     joint 2     joint 3\n" + ALIGNED, "joint 1|joint 2|joint 3", []),
        (",a,b\n" + rows(values=[[0, 0.5, 1], [1, 2, 3.5]]), "column_1 a b", []),
        ("a,b,c\n" + rows(end=","), "a b c", []),
        ("T (°C);Größe [mm];c\n".encode("latin-1") + rows(";", ",").encode(), "T (°C)|Größe [mm]|c", ["as Latin-1"]),
        (("T (°C)\tb\tc\n" + rows("\t", ",")).encode("utf-16"), "T (°C)|b|c", ["read as UTF-16"]),
        ("a;b;c\n[°];[mm];-\n" + rows(";", ","), "a [°]|b [mm]|c", ["line 2 holds units, which are added"]),
        ("q1_deg,x_mm,run\ndeg,mm,\n" + rows(), "q1_deg x_mm run", ["line 2 holds units"]),
        ("Joints,,Pose\n1,2,X\n" + rows(), "Joints/1 Joints/2 Pose/X", ["names are joined from lines 1 to 2"]),
        ("X,X,Y\n" + rows(), "X|X (2)|Y", ["several columns are called 'X': the later ones are read as 'X (2)'"]),
        (rows(), "column_1 column_2 column_3", []),
        (ALIGNED, "column_1 column_2 column_3", []),
        ("1,2,3\n" + rows(), "column_1 column_2 column_3", ["line 1 counts the columns and is not read"]),
    ],
    ids=range(18),
)
def test_where_a_table_stands_and_what_it_is_called(tmp_path, text, names, said):
    found, columns, notes = opened(tmp_path, text)
    assert found == (names.split("|") if "|" in names else names.split())
    expected = VALUES if columns[0].size == len(VALUES) else np.array([[0, 0.5, 1], [1, 2, 3.5]])
    np.testing.assert_array_equal(np.column_stack(columns), expected)
    assert len(notes) == len(said)
    for note, part in zip(notes, said, strict=True):
        assert part in note


MOTIVE = (
    "Format Version,1.23,Take Name,a take,Rotation Type,{turn},Length Units,{unit},Coordinate Space,Global\n\n"
    ",Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker\n"
    ',Name,tool,tool,tool,tool,tool,tool:1\n,ID,"A1","A1","A1","A1","A1",17\n'
    ",,Rotation,Position,Position,Position,Mean Marker Error,Position\n"
    "Frame,Time (Seconds),X,X,Y,Z,,X\n" + "".join(f"{k},{k / 120:.6f},0.5,1.5,2.5,{k}.5,0.0003,7.5\n" for k in range(4))
)
VICON = "Trajectories\n100\n,,arm:top,,,arm:left,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n" + "".join(
    f"{k},0,{k}.5,2.5,3.5,,,\n" for k in range(1, 5)
)
QUALISYS = (
    "NO_OF_FRAMES\t4\nFREQUENCY\t100\nTIME_STAMP\t2026-01-22, 17:47:17\t22107.9\nBODY_NAMES\ttool\n"
    "Frame\tTime\ttool X\tY\tZ\tRoll\tPitch\tYaw\n"
    + "".join(f"{k}\t{k / 100}\t1.5\t2.5\t3.5\t4\t5\t6\n" for k in range(4))
)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (
            MOTIVE.format(turn="Quaternion", unit="Meters"),
            "Frame|Time (Seconds)|tool/Rotation/X|tool/Position/X [m]|tool/Position/Y [m]|tool/Position/Z [m]|"
            "tool/Mean Marker Error|tool:1/Position/X [m]",
        ),
        (
            MOTIVE.format(turn="XYZ", unit="Millimeters"),
            "Frame|Time (Seconds)|tool/Rotation/X [deg]|tool/Position/X [mm]|tool/Position/Y [mm]|tool/Position/Z [mm]|"
            "tool/Mean Marker Error|tool:1/Position/X [mm]",
        ),
        (VICON, "Frame|Sub Frame|" + "|".join(f"arm:{m}/{x} [mm]" for m in ("top", "left") for x in "XYZ")),
        (QUALISYS, "Frame|Time|tool X|tool Y|tool Z|tool Roll|tool Pitch|tool Yaw"),
    ],
    ids=["motive", "motive, euler", "vicon", "qualisys"],
)
def test_exports_of_motion_capture(tmp_path, text, names):
    found, columns, _ = opened(tmp_path, text)
    assert found == names.split("|")
    assert {len(column) for column in columns} == {4}


def test_lengths_in_a_unit_that_is_none_here_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"its lengths are in Inches; export it in meters or millimeters"):
        opened(tmp_path, MOTIVE.format(turn="Quaternion", unit="Inches"))
    opened(tmp_path, MOTIVE.format(turn="Quaternion", unit="Centimeters"))
    with pytest.raises(InputError, match=r"column 'q1_deg': the row of units says 'rad'; correct the name or the unit"):
        opened(tmp_path, "q1_deg,x_mm\nrad,mm\n0.5,1.5\n")


@pytest.mark.parametrize(
    "cell",
    [
        '"[{0}, {1}, {2}]"',
        '"[{0} {1}\n {2}]"',  # as numpy breaks lines
        "\"array('d', [{0}, {1}, {2}])\"",
        '"array([{0}, {1}, {2}], dtype=float32)"',
        '"({0}, {1}, {2})"',
        '"[[{0}], [{1}], [{2}]]"',
        "[{0}, {1}, {2}]",
    ],
)
def test_lists_in_cells_are_a_column_for_each_number(tmp_path, cell):
    text = "t,q,load\n" + "".join(f"{k},{cell.format(*row)},0.5\n" for k, row in enumerate(VALUES.tolist()))
    found, columns, notes = opened(tmp_path, text)
    assert found == ["t", "q[0]", "q[1]", "q[2]", "load"]
    np.testing.assert_array_equal(np.column_stack(columns[1:4]), VALUES)
    assert notes == ["lists are read as a column for each of their numbers, such as 'q[0]'"]
    with pytest.raises(InputError, match="row 5 has 4 of 5 columns"):
        opened(tmp_path, text + '4,"[1, 2]",0.5\n')


def test_a_table_without_names_gets_them(capsys, tmp_path):
    path = tmp_path / "run 7.txt"
    path.write_text(ALIGNED)
    message = "its first row holds numbers, and no line names the columns; `lite6jax init"
    for command in ("init", "fit", "check"):
        assert message in refused(capsys, command, path)
    assert "--names gives 2 names for 3 columns; give each one" in refused(
        capsys, "init", path, "--names", "q1_deg,q2_deg"
    )
    assert run(capsys, "init", path, "--names", "q1_deg, q2_deg,")[0] == 0
    columns = yaml.safe_load(path.with_suffix(".yaml").read_text())["columns"]
    assert columns == {"column_1": "q1_deg", "column_2": "q2_deg", "column_3": "ignore"}
    np.testing.assert_allclose(read_recording(path).joint_position, VALUES[:, :2] * pi / 180)
    named = tmp_path / "named.csv"
    named.write_text("a,b,c\n" + rows())
    assert "names its columns already; say what they are by --column" in refused(
        capsys, "init", named, "--names", "q1_deg,q2_deg,q3_deg"
    )
