"""`lite6jax init` of tables as people bring them: words in cells, deviations, readings by other names, odd shapes."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.recordings import read_recording, read_settings
from tests.oracles.arms import lite6_positions
from tests.oracles.chains import six_parameter_poses

LITE6 = load_bundled("lite6").kinematics
BODY = np.array([[0, 0, 0], [0.08, 0, 0], [0, 0.06, 0], [0.02, 0.03, 0.05]])
UR5E = load_bundled("ur5e").kinematics
PUBLISHED = ["elbow_joint", "shoulder_lift_joint", "shoulder_pan_joint", "wrist_1_joint", "wrist_2_joint"]
PUBLISHED += ["wrist_3_joint"]
ALONG_THE_ARM = [2, 1, 0, 3, 4, 5]
"""Where the joints of a UR stand in alphabetical order."""


def measured(chain=LITE6, rows=40, noise=3e-5, seed=1):
    """Joints in rad, and in the frame of a sensor the positions of a tool in m and the flange's axes."""
    rng = np.random.default_rng(seed)
    q = lite6_positions(rng, rows)
    poses = six_parameter_poses(chain, q)
    turned = Rotation.from_rotvec([0.1, 0.2, 1.0]).as_matrix()
    point = (poses[:, :3, 3] + poses[:, :3, :3] @ [0.03, -0.02, 0.09]) @ turned.T + [0.5, 1.0, 0.2]
    return rng, q, point + noise * rng.normal(size=point.shape), turned @ poses[:, :3, :3]


def write(path, names, rows, delimiter=","):
    """A table; numbers have six decimals."""
    cells = [[c if isinstance(c, str) else f"{c:.6f}" for c in row] for row in rows]
    path.write_text("\n".join(delimiter.join(row) for row in [names, *cells]) + "\n")
    return path


def joints(count=6):
    return [f"J{k + 1}" for k in range(count)]


def columns_of(table):
    return yaml.safe_load(table.with_suffix(".yaml").read_text())["columns"]


# ------------------------------------------------------------------ words in cells


def test_names_in_one_cell_are_of_the_list_beside_them(tmp_path, capsys):
    _, q, point, _ = measured(UR5E)
    rows = [[f'"{PUBLISHED}"', f'"{q[k, ALONG_THE_ARM].tolist()}"', *point[k]] for k in range(len(q))]
    table = write(tmp_path / "echo.csv", ["name", "position", "x_m", "y_m", "z_m"], rows)
    assert run(capsys, "init", table, "--arm", "ur5e", "--yes")[0] == 0
    np.testing.assert_allclose(read_recording(table).joint_position, q, atol=1e-12)


def test_names_in_cells_say_which_joint_a_column_is_of(tmp_path, capsys):
    _, q, point, _ = measured(UR5E)
    names = [f"field.name{k}" for k in range(6)] + [f"field.position{k}" for k in range(6)] + ["x_m", "y_m", "z_m"]
    rows = [[*PUBLISHED, *(float(q[i, k]) for k in ALONG_THE_ARM), *point[i]] for i in range(len(q))]
    table = write(tmp_path / "echo.csv", names, rows)
    code, out, _ = run(capsys, "init", table, "--arm", "ur5e", "--yes", width=300)
    assert code == 0
    assert "the cells of field.name0 … field.name5 say whose the numbers beside them are: elbow_joint" in flat(out)
    assert [columns_of(table)[f"field.position{k}"] for k in (0, 1, 2)] == ["q3_rad", "q2_rad", "q1_rad"]
    np.testing.assert_allclose(read_recording(table).joint_position, q, atol=1e-6)


def test_names_that_change_places_are_followed_from_row_to_row(tmp_path, capsys):
    rng, q, point, _ = measured(UR5E)
    names = [f"name[{k}]" for k in range(6)] + [f"position[{k}]" for k in range(6)] + ["x_m", "y_m", "z_m"]
    along = [PUBLISHED[k] for k in ALONG_THE_ARM]
    rows = []
    for i in range(len(q)):
        order = rng.permutation(6)
        rows.append([f'"{along[k]}"' for k in order] + [float(q[i, k]) for k in order] + [*point[i]])
    table = write(tmp_path / "echo.csv", names, rows, ";")
    code, out, _ = run(capsys, "init", table, "--arm", "ur5e", "--yes", width=300)
    assert code == 0
    assert "their order changes from row to row, so that each has columns of its own" in flat(out)
    np.testing.assert_allclose(read_recording(tmp_path / "echo_named.csv").joint_position, q, atol=1e-6)


def test_lists_of_unequal_length_are_read_by_the_names_of_their_elements(tmp_path, capsys):
    """Two frames in most rows of /tf, and one in some; the names are those of the first message."""
    _, q, point, _ = measured()
    parts = ("child_frame_id", "translation.x", "translation.y", "translation.z")
    for elements in (1, 2):
        names = joints() + [f"transforms{e}.{part}" for e in range(elements) for part in parts]
        rows = []
        for i in range(len(q)):
            frames = [["marker", *point[i]], ["camera", 0.0, 0.0, 1.0]][:: 1 if i % 2 else -1]
            kept = frames if i % 5 else [["marker", *point[i]]]
            rows.append([*q[i], *(cell for frame in kept for cell in frame)])
        table = write(tmp_path / f"tf{elements}.csv", names, rows)
        code, out, err = run(capsys, "init", table, "--arm", "lite6", "--yes", width=300)
        assert (code, err) == (0, "")
        assert "lists have fewer elements in some rows, which are read as missing there" in flat(out)
        np.testing.assert_allclose(read_recording(tmp_path / f"tf{elements}_named.csv").position, point, atol=1e-6)


@pytest.mark.parametrize(
    ("of_robot", "of_tracker"),
    [
        (lambda k: f"P{k}", lambda k: f"P{k}"),
        (lambda k: f"{1000 + k}", lambda k: f"{1000 + k}"),
        (lambda k: f'"pose {k}"', lambda k: f"Point {k:03d}"),
    ],
    ids=["names", "numbers", "numbers at the end"],
)
def test_rows_of_two_files_are_paired_by_their_names(tmp_path, capsys, of_robot, of_tracker):
    rng, q, point, _ = measured()
    kept = rng.permutation(len(q))[:-3]
    robot = write(tmp_path / "r.csv", ["Point", *joints()], [[of_robot(k), *q[k]] for k in range(len(q))])
    rows = [[of_tracker(k), *(1e3 * point[k])] for k in kept] + [["REF" if of_robot(1)[0] != "1" else "9", 0, 0, 1.0]]
    tracker = write(tmp_path / "t.csv", ["Name", "X [mm]", "Y [mm]", "Z [mm]"], rows)
    code, out, _ = run(capsys, "init", robot, tracker, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    assert "rows of the same name in Point of r.csv and Name of t.csv belong together" in flat(out)
    assert "r.csv alone has" in flat(out)
    recording = read_recording(tmp_path / "r_t.csv")
    np.testing.assert_allclose(recording.joint_position, q[np.sort(kept)], atol=1e-6)
    np.testing.assert_allclose(recording.position, point[np.sort(kept)], atol=1e-8)


def test_counters_of_two_devices_are_no_names(tmp_path, capsys):
    _, q, point, _ = measured()
    robot = write(tmp_path / "r.csv", ["id", *joints()], [[str(k), *q[k]] for k in range(len(q))])
    rows = [[str(k + 3), *point[k]] for k in range(len(q))]
    tracker = write(tmp_path / "t.csv", ["id", "x_m", "y_m", "z_m"], rows)
    code, out, _ = run(capsys, "init", robot, tracker, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    assert "are paired in their order" in flat(out)


def markers(rng, q, point, rotation, seen=0.9):
    """Rows of four markers on one body: the pose, joints, the marker and its place in mm; some are not seen."""
    for k in range(len(q)):
        for marker in range(4):
            if rng.uniform() < seen:
                place = point[k] + rotation[k] @ BODY[marker] + 5e-5 * rng.normal(size=3)
                yield [str(k), *q[k], f"{marker}", *(1e3 * place)]


@pytest.mark.parametrize("written", ["by state", "by marker", "joints once"])
def test_a_row_for_each_marker_becomes_a_row_for_each_state(tmp_path, capsys, written):
    rng, q, point, rotation = measured()
    rows = list(markers(rng, q, point, rotation))
    rows.sort(key=lambda row: row[7] if written == "by marker" else 0)
    if written == "joints once":
        first = {row[0]: k for k, row in reversed([*enumerate(rows)])}
        rows = [row if first[row[0]] == k else [row[0], *[""] * 6, *row[7:]] for k, row in enumerate(rows)]
    table = write(tmp_path / "long.csv", ["step", *joints(), "marker_id", "px", "py", "pz"], rows)
    code, out, _ = run(capsys, "init", table, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    assert "marker_id says which of 4 points a row is of" in flat(out)
    recording = read_recording(tmp_path / "long_poses.csv")
    at = [int(np.argmin(np.abs(q - joint).sum(1))) for joint in recording.joint_position]
    np.testing.assert_allclose(recording.joint_position, q[at], atol=1e-6)
    wanted = point[at] + rotation[at] @ BODY.mean(0)
    assert np.sqrt(np.mean((recording.position - wanted) ** 2)) < 6e-5


def test_of_tags_on_several_bodies_the_one_on_the_arm_is_read(tmp_path, capsys):
    _, q, point, _ = measured()
    rows = []
    for k in range(len(q)):
        rows += [[*q[k], "7", 0.1, 0.2, 0.3 + 1e-5 * k], [*q[k], "12", *point[k]]]
    table = write(tmp_path / "tags.csv", [*joints(), "tag_id", "tx", "ty", "tz"], rows)
    code, out, _ = run(capsys, "init", table, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    assert "of the points only 12 is read" in flat(out)
    np.testing.assert_allclose(read_recording(tmp_path / "tags_poses.csv").position, point, atol=1e-6)


def test_repeated_readings_of_one_point_stay_rows(tmp_path, capsys):
    rng, q, point, _ = measured()
    rows = [[*q[k], str(n), *(point[k] + 1e-5 * rng.normal(size=3))] for k in range(len(q)) for n in range(3)]
    table = write(tmp_path / "repeated.csv", [*joints(), "no", "x_m", "y_m", "z_m"], rows)
    assert run(capsys, "init", table, "--arm", "lite6", "--yes")[0] == 0
    assert read_recording(table).samples == 3 * len(q)


# ------------------------------------------------------------------ deviations


@pytest.fixture(scope="module")
def deviating():
    """Joints, the nominal positions that a controller computed, and those of the tool, in mm to a thousandth."""
    rng = np.random.default_rng(5)
    q = lite6_positions(rng, 60)
    nominal, actual = (six_parameter_poses(LITE6, at)[:, :3, 3] for at in (q, q + 1e-3 * np.sin(q)))
    return q, np.round(1e3 * nominal, 3), np.round(1e3 * actual, 3)


@pytest.mark.parametrize(
    ("names", "scales"),
    [
        ("X nominal,Y nominal,Z nominal,dX,dY,dZ", (1, 1)),
        ("SOLL_X,SOLL_Y,SOLL_Z,ABW_X,ABW_Y,ABW_Z", (1, 1)),
        ("Nominal X [m],Nominal Y [m],Nominal Z [m],Dev X [mm],Dev Y [mm],Dev Z [mm]", (1e-3, 1)),
        ("x_nom,y_nom,z_nom,ΔX,ΔY,ΔZ", (1e-3, 1)),
        ("x,y,z,error_x,error_y,error_z", (1, 1)),
    ],
)
def test_the_measured_position_is_the_nominal_one_and_its_deviation(tmp_path, capsys, deviating, names, scales):
    q, nominal, actual = deviating
    rows = np.hstack([q, scales[0] * nominal, scales[1] * (actual - nominal)])
    table = write(tmp_path / "report.csv", [*joints(), *names.split(",")], rows)
    code, out, _ = run(capsys, "init", table, "--arm", "lite6", "--set", "pose_source=laser_tracker", "--yes")
    assert code == 0
    assert "Deviations, which are added to the nominal positions" in flat(out)
    recording = read_recording(table)
    np.testing.assert_allclose(1e3 * recording.position, actual, atol=1e-3)
    assert any("the sum of the nominal one, x y z, and the deviation" in note for note in recording.notes)


@pytest.mark.parametrize(
    "names",
    [
        "Nom X,Nom Y,Nom Z,Act X,Act Y,Act Z,Dev X,Dev Y,Dev Z",
        "X-Soll,Y-Soll,Z-Soll,X-Ist,Y-Ist,Z-Ist,X-Abw,Y-Abw,Z-Abw",
        "P1 X,P1 Y,P1 Z,P2 X,P2 Y,P2 Z,P3 X,P3 Y,P3 Z",
    ],
)
def test_measured_positions_beside_nominal_ones_are_read_themselves(tmp_path, capsys, deviating, names):
    q, nominal, actual = deviating
    table = write(
        tmp_path / "report.csv", [*joints(), *names.split(",")], np.hstack([q, nominal, actual, actual - nominal])
    )
    assert run(capsys, "init", table, "--arm", "lite6", "--set", "pose_source=laser_tracker", "--yes")[0] == 0
    np.testing.assert_allclose(1e3 * read_recording(table).position, actual, atol=1e-6)


def test_deviations_from_what_may_be_measured_are_asked_for(tmp_path, capsys):
    _, q, point, _ = measured()
    rows = np.hstack([q, 1e3 * point, np.full_like(point, 0.2)])
    names = [*joints(), "x_mm", "y_mm", "z_mm", "dev_x", "dev_y", "dev_z"]
    table = write(tmp_path / "report.csv", names, rows)
    code, out, _ = run(capsys, "init", table, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    assert "nothing says whether the positions are nominal or measured. If they are nominal, say so: --column" in flat(
        out
    )
    np.testing.assert_allclose(read_recording(table).position, point, atol=1e-8)
    given = [word for axis in "xyz" for word in ("--column", f"dev_{axis}=dev{axis}_mm")]
    assert run(capsys, "init", table, "--arm", "lite6", "--yes", "--force", *given)[0] == 0
    np.testing.assert_allclose(read_recording(table).position, point + 2e-4, atol=1e-8)


# ------------------------------------------------------------------ readings by other names


@pytest.mark.parametrize(
    ("column", "values", "source", "meaning"),
    [
        ("socket", ["a", "b"], "touch", "contact"),
        ("point no", ["1", "2"], "touch", "contact"),
        ("Fläche", ["oben", "links"], "touch", "plane"),
        ("wire [mm]", None, "draw_wire", "distance_mm"),
        ("Seil", None, "draw_wire", "distance_mm"),
        ("dial [mm]", None, "height_gauge", "axis_mm"),
        ("z_mm", None, "height_gauge", "axis_mm"),
    ],
)
def test_readings_are_what_pose_source_announces(tmp_path, capsys, column, values, source, meaning):
    _, q, point, _ = measured()
    cells = [values[k % 2] if values else 1e3 * point[k, 2] for k in range(len(q))]
    table = write(tmp_path / "run.csv", [*joints(), column, "remark"], [[*q[k], cells[k], "ok"] for k in range(len(q))])
    code, out, _ = run(capsys, "init", table, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    assert f"add --set pose_source={source}" in flat(out)
    announced = ["--set", f"pose_source={source}"]
    code, out, _ = run(capsys, "init", table, "--arm", "lite6", "--yes", "--force", *announced, width=300)
    assert code == 0
    assert f"({meaning}), as pose_source says" in flat(out)
    assert columns_of(table)[column] == meaning
    assert read_recording(table).readings is not None


def test_an_announced_reading_that_no_column_holds_is_asked_for(tmp_path, capsys):
    _, q, _, _ = measured()
    table = write(tmp_path / "run.csv", joints(), q)
    code, out, _ = run(capsys, "init", table, "--arm", "lite6", "--yes", "--set", "pose_source=touch", width=300)
    assert code == 0
    assert "no column alone may be its readings: say which are, --column NAME=contact (or plane)" in flat(out)


# ------------------------------------------------------------------ tables without names, pairs, matrices


def test_names_are_given_to_each_of_two_tables(tmp_path, capsys):
    _, q, point, _ = measured()
    robot, tracker = tmp_path / "r.txt", tmp_path / "t.txt"
    robot.write_text("".join(f"{k} " + " ".join(f"{v:.6f}" for v in q[k]) + "\n" for k in range(len(q))))
    tracker.write_text("".join(",".join(f"{v:.6f}" for v in row) + "\n" for row in point))
    of_robot = "," + ",".join(f"q{k + 1}_rad" for k in range(6))
    for names in ([f"{of_robot},x_m,y_m,z_m"], [of_robot, "x_m,y_m,z_m"]):
        options = [word for listed in names for word in ("--names", listed)]
        assert run(capsys, "init", robot, tracker, "--arm", "lite6", "--yes", "--force", *options)[0] == 0
        np.testing.assert_allclose(read_recording(tmp_path / "r_t.txt").joint_position, q, atol=1e-6)
    said = refused(capsys, "init", robot, tracker, "--arm", "lite6", "--names", "q1_rad,q2_rad", "--force")
    assert (
        f"gives 2 names for the columns 7 of {robot} and 3 of {tracker}; give each one, or one --names a file" in said
    )


def test_names_may_be_ones_own(tmp_path, capsys):
    _, q, point, rotation = measured()
    table = tmp_path / "smr.txt"
    points = (point[:, None] + np.einsum("kij,pj->kpi", rotation, BODY[:3])).reshape(len(q), 9)
    np.savetxt(table, np.hstack([1e3 * points, np.rad2deg(q)]), "%.5f")
    names = ",".join([*(f"SMR{k}_{axis}" for k in (1, 2, 3) for axis in "xyz"), *joints()])
    assert run(capsys, "init", table, "--names", names, "--arm", "lite6", "--yes")[0] == 0
    np.testing.assert_allclose(read_recording(tmp_path / "smr_poses.txt").joint_position, q, atol=1e-6)
    np.savetxt(table, np.hstack([1e3 * point, np.rad2deg(q)]), "%.5f")
    names = ",".join(["tracker X", "tracker Y", "tracker Z", *joints()])
    assert run(capsys, "init", table, "--names", names, "--arm", "lite6", "--yes")[0] == 0
    assert columns_of(table)["column_1"] == "x_mm"
    np.testing.assert_allclose(read_recording(table).position, point, atol=1e-7)
    assert "gives 'J1' twice" in refused(capsys, "init", table, "--names", names.replace("J2", "J1"), "--force")


def test_pairs_of_keys_and_values_are_a_table(tmp_path, capsys):
    _, q, point, _ = measured()
    log = tmp_path / "client.txt"
    blocks = ["Version = 3"]
    for k in range(len(q)):
        line = " ".join(f"{axis}= {1e3 * v:9.3f} mm" for axis, v in zip("XYZ", point[k], strict=True))
        again = line.replace("X=", "X=  ") if k % 2 else ""
        blocks += [f"Pose {k}", " ".join(f"J{j + 1}={v:10.6f}" for j, v in enumerate(q[k])), line, again]
    log.write_text("\n".join(blocks) + "\n")
    code, out, _ = run(capsys, "init", log, "--arm", "lite6", "--yes", width=300)
    assert code == 0
    said = flat(out)
    assert "no table but KEY=VALUE pairs, in 40 blocks, of which some hold several readings: 60 rows" in said
    assert "keys that stand there once are not read: Version" in said
    recording = read_recording(log)
    assert recording.samples == 60
    np.testing.assert_allclose(recording.joint_position[:3], q[[0, 1, 1]], atol=1e-6)


def test_a_matrix_by_columns_is_said_to_be_one(tmp_path, capsys):
    _, q, point, rotation = measured()
    names = [*joints(), "flange X", "flange Y", "flange Z", *(f"flange Rot[{k}]" for k in range(9))]
    for order, entries in (("row by row", rotation), ("column by column", rotation.swapaxes(1, 2))):
        table = write(tmp_path / f"{order[:3]}.tsv", names, np.hstack([q, 1e3 * point, entries.reshape(-1, 9)]), "\t")
        code, out, _ = run(capsys, "init", table, "--arm", "lite6", "--yes", width=300)
        assert code == 0
        assert f"a rotation matrix {order} (certain: the arm's kinematics agree" in flat(out)
        turned = Rotation.from_quat(read_recording(table).quaternion, scalar_first=True).as_matrix()
        np.testing.assert_allclose(turned, rotation, atol=1e-5)
    code, out, _ = run(capsys, "init", table, "--arm", "xarm6", "--yes", "--force", width=300)
    assert "Nothing shows whether the matrix is written row by row or column by column" in flat(out)


# ------------------------------------------------------------------ noise


def test_the_noise_that_a_verdict_needs_is_asked_for(tmp_path, capsys):
    _, q, point, _ = measured()
    table = write(tmp_path / "run.csv", [*joints(), "x_m", "y_m", "z_m"], np.hstack([q, point]))
    out = run(capsys, "init", table, "--arm", "lite6", "--yes", width=300)[1]
    assert "The sidecar declares none: write position_noise_m there, one standard deviation." in flat(out)
    declared = ["--set", "position_noise_m=3e-5"]
    assert "declares none" not in run(capsys, "init", table, "--arm", "lite6", "--yes", "--force", *declared)[1]


def test_one_torque_noise_is_that_of_all_joints(tmp_path, capsys):
    time = np.arange(40) / 100
    q = np.sin(np.outer(time, [1.0, 2.0]))
    names = ["time_s", "q1_rad", "q2_rad", "tau1_Nm", "tau2_Nm"]
    table = write(tmp_path / "log.csv", names, np.column_stack([time, q, q]))
    assert "write torque_noise_Nm there" in flat(run(capsys, "init", table, "--yes", width=300)[1])
    assert run(capsys, "init", table, "--yes", "--force", "--set", "torque_noise_Nm=0.1")[0] == 0
    assert read_settings(table.with_suffix(".yaml")).torque_noise_Nm == 0.1
    assert read_recording(table).settings.torque_noise_Nm == (0.1, 0.1)
