"""`lite6jax init` as a person meets it: what it says, the sidecar it writes, the commands that then read the table."""

import json
import re
from dataclasses import fields

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.cli import init
from lite6jax.recordings import RecordingSettings, read_recording, read_settings
from lite6jax.recordings.columns.inspection import inspect
from lite6jax.recordings.settings import OF_READINGS
from lite6jax.report import inspection
from tests.oracles.arms import lite6_positions, perturbed
from tests.oracles.chains import six_parameter_poses
from tests.oracles.transforms import perturb_poses

LITE6 = load_bundled("lite6").kinematics


@pytest.fixture(scope="module")
def measured():
    rng = np.random.default_rng(4)
    q = lite6_positions(rng, 80)
    return q, perturb_poses(rng, six_parameter_poses(perturbed(rng, LITE6), q), 2e-5, 1e-4)


@pytest.fixture
def recorded(tmp_path, measured):
    """A table as a lab wrote it: degrees and millimetres, a rotation vector, a text, spaces and a colon in names."""
    q, poses = measured
    vector = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
    columns = {f"Joint {k + 1}": np.rad2deg(q[:, k]) for k in range(6)}
    columns |= {f"tcp: {axis}": 1e3 * poses[:, k, 3] for k, axis in enumerate("xyz")}
    columns |= {f"tcp: r{axis}": vector[:, k] for k, axis in enumerate("xyz")}
    path = tmp_path / "run7.csv"
    rows = [[*columns, "operator", "x"]]
    rows += [[*map(repr, map(float, row)), "me", "1"] for row in zip(*columns.values(), strict=True)]
    path.write_text("".join(",".join(row) + "\n" for row in rows))
    return path


def test_the_table_is_read_by_all_commands_afterwards(capsys, recorded, measured):
    assert "has no joint positions" in refused(capsys, "fit", recorded)
    code, out, err = run(
        capsys, "init", recorded, "--arm", "lite6", "--set", "pose_frame=base", "--set", "tool=none", width=100
    )
    assert (code, err) == (0, "")
    said = flat(out)
    assert "Joint positions: Joint 1 … Joint 6, in degrees (certain: the arm's kinematics agree" in said
    assert "Tool orientation: tcp: rx, tcp: ry, tcp: rz, a rotation vector (certain: the arm's kinematics" in said
    assert "Not used: 'x', 'operator'." in said
    assert out.endswith(f"lite6jax diagnose {recorded} --out diagnosis.json\n")
    recording = read_recording(recorded)
    q, poses = measured
    np.testing.assert_allclose(recording.joint_position, q, atol=1e-13)
    np.testing.assert_allclose(recording.position, poses[:, :3, 3], atol=1e-13)
    turned = Rotation.from_quat(recording.quaternion, scalar_first=True).as_matrix()
    np.testing.assert_allclose(turned, poses[:, :3, :3], atol=1e-12)
    assert recording.settings == RecordingSettings(arm="lite6", motion="static", pose_frame="base", tool="none")
    assert recording.notes == ()
    code, out, _ = run(capsys, "fit", recorded)
    assert code == 0
    assert "Recording of 80 samples, 6 joints of a lite6: positions and orientations" in flat(out)


def test_the_sidecar_explains_every_key(recorded, capsys):
    assert run(capsys, "init", recorded)[0] == 0
    text = recorded.with_suffix(".yaml").read_text()
    content = yaml.safe_load(text)
    assert content["recording"] == {"arm": "lite6", "motion": "static"}  # recognised
    assert content["columns"]["tcp: x"] == "x_mm"
    assert content["columns"]["operator"] == content["columns"]["x"] == "ignore"
    assert set(inspection.KEYS) == {field.name for field in fields(RecordingSettings)}
    commented = re.findall(r"^  # (\w+): (.*)$", text, re.MULTILINE)
    examples = {key: value for key, value in commented if key in inspection.KEYS}
    of_torques = {"torque_source", "torque_noise_Nm", "inertial", "torque_constant_Nm_per_A"}
    of_commands = {"command", "servo"}
    others = of_torques | of_commands | set(OF_READINGS)
    assert set(examples) == set(inspection.KEYS) - set(content["recording"]) - others
    assert max(map(len, text.splitlines())) <= 120
    # each example is accepted in its place
    keys = "|".join(examples)
    uncommented = re.sub(rf"^  # ({keys}): ", r"  \1: ", text, flags=re.MULTILINE)
    recorded.with_suffix(".yaml").write_text(uncommented)
    assert read_settings(recorded.with_suffix(".yaml")).pose_source == "laser_tracker"
    for key, (_, example) in inspection.KEYS.items():
        paired = {"factory_calibration": "arm.yaml"} if key == "factory_uncertainty" else {}
        RecordingSettings(**{key: yaml.safe_load(example)}, **paired)


def test_what_is_given_and_what_is_refused(recorded, capsys, tmp_path):
    sidecar = recorded.with_suffix(".yaml")
    for arguments, message in (
        (["--set", "pose_fame=base"], "pose_fame: unknown key; did you mean pose_frame?"),
        (["--set", "pose_frame=table"], "pose_frame: 'table' is not accepted; give base or unknown"),
        (["--set", "tool"], "--set tool: write it as KEY=VALUE"),
        (["--set", "tool=["], "--set tool=[: its value is not valid YAML; write KEY=VALUE"),
        (["--column", "Joint 9=q1_deg"], f"{recorded}: has no column 'Joint 9'; it has 'Joint 1', 'Joint 2'"),
        (["--column", "Joint 1=theta"], "column 'Joint 1': the sidecar names it 'theta', which means nothing here"),
        (["--column", "Joint 6=ignore"], "has 5 joints (q1 ... q5), the arm has 6; choose the arm it is of"),
        (["--arm", "lite7"], "neither a bundled arm nor a file; did you mean 'lite6'?"),
    ):
        assert message in refused(capsys, "init", recorded, "--arm", "lite6", *arguments)
    assert not sidecar.exists()
    for name in ("other.csv", "empty.csv"):
        (tmp_path / name).write_text("load,depth\n" + "1,2\n" * (name == "other.csv"))
    assert refused(capsys, "init", tmp_path / "other.csv") == (
        f"{tmp_path / 'other.csv'}: no columns look like joint positions; say which they are, --column NAME=q1_deg "
        "--column NAME=q2_deg and so on (q1_rad in radians, q1_mm of a prismatic "
        f"joint); it has 'load', 'depth'"
    )
    assert refused(capsys, "init", tmp_path / "empty.csv").endswith("has column names but no rows; record again")
    declared = ["--set", "tool=[0, 0, 0.1, 0, 0, 0]", "--set", "inertial=unknown"]
    code, _, _ = run(capsys, "init", recorded, "--column", "operator=ignore", *declared)
    assert code == 0
    assert read_settings(sidecar).tool == (0, 0, 0.1, 0, 0, 0)
    assert read_settings(sidecar).inertial == "unknown"  # which is not what a missing key means
    before = sidecar.read_text()
    assert "exists already" in refused(capsys, "init", recorded)
    assert sidecar.read_text() == before
    assert run(capsys, "init", recorded, "--force")[0] == 0


def test_a_matrix_is_not_asked_for_another_form(monkeypatch):
    rng = np.random.default_rng(0)
    matrices = Rotation.random(20, random_state=rng).as_matrix().reshape(-1, 9)
    columns = dict(zip(("x_m", "y_m", "z_m"), rng.normal(size=(3, 20)), strict=True))
    found = inspect([*columns.items(), *((f"rotation_{k}", column) for k, column in enumerate(matrices.T))])
    assert found.of("rotation").form[:2] == ("r11", "assumed")
    monkeypatch.setattr("builtins.input", None)
    assert init._ask_columns(found) == {}


def test_on_a_terminal_it_asks_for_what_it_cannot_see(recorded, capsys, monkeypatch):
    asked = []
    answers = iter(["measured", "tracker", "laser_tracker", "", "none"])

    def answer(question):
        asked.append(question)
        return next(answers)

    monkeypatch.setattr("builtins.input", answer)
    monkeypatch.setattr(init, "_on_a_terminal", lambda: True)
    code, out, _ = run(capsys, "init", recorded)
    assert code == 0
    assert "write one of laser_tracker, motion_capture, camera, controller_fk, unknown" in out
    assert len(asked) == 5
    settings = read_settings(recorded.with_suffix(".yaml"))
    assert (settings.joint_source, settings.pose_source, settings.tool) == ("measured", "laser_tracker", "none")
    assert settings.pose_frame == "unknown"
    monkeypatch.setattr("builtins.input", lambda question: pytest.fail(question))
    assert run(capsys, "init", recorded, "--force", "--yes")[0] == 0
    assert run(capsys, "init", recorded, "--force", "--json")[0] == 0


@pytest.fixture
def two_poses(tmp_path, measured):
    """A log of a controller, exact to the digits that it writes, beside what a tracker measured."""
    q, poses = measured
    computed = six_parameter_poses(LITE6, q)[:, :3, 3]
    columns = {f"actual_q_{k}": q[:, k] for k in range(6)}
    columns |= {f"actual_TCP_pose_{k}": computed[:, k] for k in range(3)}
    columns |= {f"tracker_{axis}": 1e3 * poses[:, k, 3] for k, axis in enumerate("xyz")}
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack(list(columns.values())), "%.6f", ",", header=",".join(columns), comments="")
    return path


def test_the_pose_of_the_source_that_is_declared_is_taken(two_poses, capsys):
    said = refused(capsys, "init", two_poses, "--arm", "lite6", "--yes")
    assert said.startswith(f"{two_poses}: it holds 2 poses. Pose actual_TCP_pose_0, actual_TCP_pose_1, actual_TCP_pose")
    assert "the controller's, computed from the joints: the nominal arm reproduces it to 0.00" in said
    assert "Pose tracker_x, tracker_y, tracker_z: a sensor's; the nominal arm reproduces it to" in said
    keys = "--set pose_source=laser_tracker (or motion_capture, camera), or --set pose_source=controller_fk, or leaving"
    assert f"Choose by {keys} out what is not meant, such as --column" in said
    assert not two_poses.with_suffix(".yaml").exists()
    ignored = said.partition("such as ")[2].split()
    for options, column in (
        (["--set", "pose_source=laser_tracker"], "tracker_x"),
        (["--set", "pose_source=controller_fk"], "actual_TCP_pose_0"),
        (ignored, "tracker_x"),
    ):
        code, out, _ = run(capsys, "init", two_poses, "--arm", "lite6", "--yes", "--force", *options, width=200)
        assert code == 0
        assert out.count("It is taken.") == 1 - (options == ignored)
        columns = yaml.safe_load(two_poses.with_suffix(".yaml").read_text())["columns"]
        assert columns[column] in ("x_m", "x_mm")
        assert sorted(columns.values()).count("ignore") == 3
    code, out, _ = run(capsys, "init", two_poses, "--arm", "lite6", "--json", "--force", "--set", "pose_source=camera")
    assert [(pose["computed"], pose["taken"]) for pose in json.loads(out)["poses"]] == [(True, False), (False, True)]


def test_normalised_joints_are_not_taken_for_degrees(tmp_path, capsys, monkeypatch):
    path = tmp_path / "run7.csv"
    names = [f"{name}.pos" for name in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")]
    values = np.random.default_rng(0).uniform(-99, 99, (30, 5))
    np.savetxt(path, values, "%.3f", ",", header=",".join(names), comments="")
    said = refused(capsys, "init", path, "--yes")
    assert "joints shoulder_pan.pos … wrist_roll.pos look like LeRobot's normalised values (-100 to 100 of each" in said
    assert "record again with use_degrees=True" in said
    degrees = said.partition("If they are degrees, say so: ")[2].split()
    assert run(capsys, "init", path, "--yes", *degrees)[0] == 0
    np.testing.assert_allclose(np.rad2deg(read_recording(path).joint_position), values, atol=1e-3)
    answers = iter(["", "deg", ""])
    monkeypatch.setattr("builtins.input", lambda _: next(answers))
    monkeypatch.setattr(init, "_on_a_terminal", lambda: True)
    code, out, _ = run(capsys, "init", path, "--force")
    assert code == 0
    assert "they may be normalised: -100 to 100 of each joint's range" in flat(out)
    np.savetxt(path, np.round(2048 + 20 * values), "%d", ",", header=",".join(names), comments="")
    assert "look like raw ticks of servos (4096 a turn)" in refused(capsys, "init", path, "--yes", "--force")


@pytest.mark.parametrize("width", [40, 60, 200])
def test_the_report_is_readable_on_any_terminal(recorded, capsys, width):
    _, out, _ = run(capsys, "init", recorded, width=width)
    paths = {str(recorded), f"Wrote {recorded.with_suffix('.yaml')}"}
    lines = [line for line in out.splitlines() if line not in paths and not line.startswith("lite6jax diagnose")]
    assert max(map(len, lines)) <= width
    assert [line for line in out.splitlines() if line != line.rstrip()] == []  # a pipe needs no filled lines


def test_torques_without_a_column_of_times(capsys, tmp_path):
    path = tmp_path / "log.csv"
    rows = [f"{10 * k},{k / 10},{0.1 * k},{1 + k},{2 - k}" for k in range(20)]
    path.write_text("\n".join(["Zeit,pos_0,pos_1,torque_0,torque_1", *rows]) + "\n")
    code, out, _ = run(capsys, "init", path, "--yes", width=200)
    assert code == 0
    said = "Torques need times, and no column looks like them: say in the sidecar which it is, such as"
    assert f"{said} `Zeit: time_s`." in out
    assert "Motion: static" in out
    sidecar = path.with_suffix(".yaml")
    sidecar.write_text(sidecar.read_text().replace("Zeit: ignore", "Zeit: time_ms").replace("static", "trajectory"))
    assert read_recording(path).time[-1] == pytest.approx(0.19)
    code, out, _ = run(capsys, "init", path, "--yes", "--column", "Zeit=time_ms", "--force", width=200)
    assert code == 0
    assert "Torques need times" not in out
    assert "Motion: trajectory; its time step is 0.01 s." in out  # decided with what is given
    assert read_settings(sidecar).motion == "trajectory"
    assert run(capsys, "init", path, "--yes", "--column", "Zeit=time_ms", "--set", "motion=static", "--force")[0] == 0
    assert read_settings(sidecar).motion == "static"


@pytest.mark.parametrize("folder", [".", "..", "../.."])
def test_the_folder_that_one_is_in_is_no_recording(capsys, tmp_path, monkeypatch, folder):
    (tmp_path / "a" / "b").mkdir(parents=True)
    for place in (tmp_path, tmp_path / "a", tmp_path / "a" / "b"):
        (place / "run7.csv").write_text("q1_rad\n0\n")
    monkeypatch.chdir(tmp_path / "a" / "b")
    for command in ("init", "fit", "check"):
        assert "is a folder; name a file in it, such as run7.csv, or fit all" in refused(capsys, command, folder)


@pytest.mark.parametrize(
    ("command", "name", "message"),
    [
        ("fit", "robot.urdf", "describes an arm and holds no measurements; name a recording, and the arm with --arm"),
        ("diagnose", "robot.xml", "describes an arm and holds no measurements; name a recording, and the arm with"),
        ("init", "run7.ods", "save it as .xlsx, or its sheet as CSV (UTF-8), and name its columns by `lite6jax init"),
        ("diagnose", "run7.ods", "save it as .xlsx, or its sheet as CSV (UTF-8), and name its columns by `lite6jax"),
        ("check", "run7.pkl", "is no recording; write it as run7.csv or .parquet with a name for each column"),
        ("fit", "empty", "is a folder without a recording: no rosbag2 (metadata.yaml and .db3 or .mcap), no LeRobot"),
        ("diagnose", "tables", "is a folder; name a file in it, or a folder with --out for the documents of all"),
        ("init", "tables", "is a folder; name a file in it, such as run7.csv, or fit all of them with `lite6jax"),
    ],
)
def test_what_is_often_taken_for_a_recording(capsys, tmp_path, command, name, message):
    (tmp_path / "empty").mkdir()
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "run7.csv").write_text("q1_rad\n0\n")
    for file in ("robot.urdf", "robot.xml", "run7.ods", "run7.pkl"):
        (tmp_path / file).write_text("<robot/>")
    options = ["--out", tmp_path / "d.json"] if command == "diagnose" else []
    assert message in refused(capsys, command, tmp_path / name, *options)
