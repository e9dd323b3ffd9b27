"""The commands as a person meets them: what is printed, what is written, what is refused and how."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
import yaml
from scipy.spatial.transform import Rotation
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import read_factory, write_factory
from lite6jax.calibration import compiled
from lite6jax.calibration.quality import Result
from lite6jax.cli import command as commands
from lite6jax.cli import program
from lite6jax.cli.demo import CALIBRATION as DEMO
from lite6jax.errors import InputError
from lite6jax.fleet import folder
from tests.oracles.arms import LITE6_DH, perturbed, random_positions
from tests.oracles.chains import hayati_poses, six_parameter_poses
from tests.oracles.transforms import perturb_poses

ROOT = Path(__file__).resolve().parents[1]
REAL = ROOT / "../shared/real"
LITE6 = load_bundled("lite6").kinematics


@pytest.fixture
def calibration(tmp_path):
    return write_factory(perturbed(np.random.default_rng(5), LITE6), tmp_path / "arm.yaml")


def write_recording_file(path, samples=120, tool=(0, 0, 0)):
    """Joints and noisy flange poses of a perturbed Lite 6, in its base frame."""
    rng = np.random.default_rng(0)
    q = random_positions(rng, samples, 6) * [1, 0.6, 0.5, 1, 0.6, 1] + [0, 0, 1.6, 0, 0, 0]
    poses = six_parameter_poses(perturbed(rng, LITE6), q)
    poses[:, :3, 3] += poses[:, :3, :3] @ np.array(tool)
    poses = perturb_poses(rng, poses, 2e-5, 1e-4)
    table = np.hstack([q, poses[:, :3, 3], Rotation.from_matrix(poses[:, :3, :3]).as_quat(scalar_first=True)])
    header = ",".join([f"q{i}_rad" for i in range(1, 7)] + ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"])
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.17g")
    settings = {"arm": "lite6", "motion": "static", "pose_frame": "base", "tool": "none"}
    settings |= {"position_noise_m": 2.0e-5, "orientation_noise_rad": 1.0e-4, "pose_source": "laser_tracker"}
    path.with_suffix(".yaml").write_text(yaml.safe_dump({"recording": settings}))
    return path


# ------------------------------------------------------------------ the program


def test_version_and_help(capsys):
    assert run(capsys, "--version")[:2] == (0, f"lite6jax {program._version()}\n")
    code, out, _ = run(capsys, "--help")
    assert code == 0
    for name in ("fit", "compare", "fleet", "convert", "check", "demo"):
        assert re.search(rf"• {name} ", out)
        code, own, err = run(capsys, name, "--help")
        assert (code, err) == (0, "")
        assert f"\n    lite6jax {name} " in own


def test_arguments_are_refused_in_tyros_style(capsys):
    code, _, err = run(capsys, "fit", "arm.yaml", "--sampels", "3")
    assert code == 2
    assert "--sampels" in err
    assert "--samples" in err
    assert run(capsys)[0] == 2
    assert "FILE" in run(capsys, "fit")[2]


def test_an_interrupt_is_one_line_and_130(capsys, monkeypatch, calibration):
    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("lite6jax.calibration.fit.fit_calibration", interrupt)
    out = calibration.with_suffix(".json")
    code, said, err = run(capsys, "fit", calibration, "--out", out)
    assert (code, said, err) == (130, "", "interrupted: nothing is left half-written\n")
    assert not out.exists()


@pytest.mark.skipif(not hasattr(signal, "SIGINT") or sys.platform == "win32", reason="signals of POSIX")
def test_ctrl_c_leaves_nothing_behind(tmp_path, calibration):
    before = set(tmp_path.iterdir())
    slow = (
        "import sys, time; from lite6jax.cli import main; from lite6jax.fleet import folder;"
        "folder.fit_folder = lambda *given, **named: (print('fitting', flush=True), time.sleep(60));"
        "sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", slow, "fleet", str(tmp_path), "--out", str(tmp_path / "fleet.parquet")]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "fitting\n"
    time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "interrupted: nothing is left half-written\n")
    assert set(tmp_path.iterdir()) == before


def test_a_reader_that_leaves_is_no_error(tmp_path):
    command = f'"{sys.executable}" -m lite6jax.cli --help | head -1'
    done = subprocess.run(command, shell=True, cwd=ROOT, capture_output=True, text=True)
    assert done.stderr == ""
    assert done.stdout.startswith("usage: lite6jax")


def test_control_characters_of_a_file_do_not_reach_the_terminal(capsys, tmp_path):
    assert refused(capsys, "fit", tmp_path / "no\nsuch\x1b[31m.yaml").endswith(
        "no\\nsuch\\x1b[31m.yaml: no such file; check the name"
    )


def test_the_cache_stands_in_the_users_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    assert compiled.cache_folder() == tmp_path / "lite6jax" / "jax"
    monkeypatch.setattr(sys, "platform", "darwin")
    assert compiled.cache_folder() == Path.home() / "Library" / "Caches" / "lite6jax" / "jax"
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert compiled.cache_folder() == tmp_path / "local" / "lite6jax" / "jax"


def test_the_documented_table_is_that_of_the_code():
    rows = re.findall(r"^\| (\d+) \| (.+) \|$", (ROOT / "docs/reference/exit_codes.md").read_text(), re.MULTILINE)
    assert {int(code): meaning for code, meaning in rows} == dict(commands.MEANINGS)
    named = [value for name, value in vars(commands).items() if name.isupper() and type(value) is int]
    assert len(rows) == len(named)
    assert sorted(named) == sorted(commands.MEANINGS)


# ------------------------------------------------------------------ fit: a calibration


def printed_table(out):
    """The numbers of the printed joint table, by joint."""
    rows = re.findall(r"^J(\d) +(.+?) *$", out, re.MULTILINE)
    return {int(joint): [float(value) for value in values.split()] for joint, values in rows}


def test_fit_prints_and_writes_the_calibrated_arm(capsys, tmp_path, calibration):
    out = tmp_path / "model.json"
    code, said, err = run(capsys, "fit", calibration, "--out", out)
    assert (code, err) == (0, "")
    assert said.startswith(f"{calibration}\nFactory calibration of 6 joints, of a lite6.\n")
    assert f"Wrote {out}\n" in said

    # the JSON has the seed's keys, and a plain NumPy chain made of it is the calibrated arm
    table = json.loads(out.read_text())
    assert set(table) == {"units", "base", "dh", "beta_joint2", "fit"}
    assert (table["fit"]["result"], table["fit"]["quality"]) == ("converged", "good")
    assert 0 < table["fit"]["checked_position_rms_m"] < 1e-13
    assert table["units"] == "mm and deg"
    assert (table["base"]["z"], table["base"]["yaw"], table["dh"][1]["d"]) == (0, 0, 0)
    base = [table["base"]["x"] / 1e3, table["base"]["y"] / 1e3]
    base += [np.deg2rad(table["base"]["roll"]), np.deg2rad(table["base"]["pitch"])]
    dh = [[np.deg2rad(r["theta_off"]), r["d"] / 1e3, r["a"] / 1e3, np.deg2rad(r["alpha"])] for r in table["dh"]]
    q = random_positions(np.random.default_rng(1), 50, 6)
    truth = six_parameter_poses(read_factory(calibration).kinematics, q)
    ours = hayati_poses(base, np.array(dh), {1: np.deg2rad(table["beta_joint2"])}, q)
    np.testing.assert_allclose(ours, truth, atol=1e-13)

    # the printed table is the same, rounded
    shown = printed_table(said)
    for i, row in enumerate(table["dh"]):
        wanted = [row["theta_off"], row["d"], row["a"], row["alpha"]] + ([table["beta_joint2"]] if i == 1 else [])
        np.testing.assert_allclose(shown[i + 1], wanted, atol=0.5001e-4)

    # the nominal difference is the one between two plain chains over the same samples
    limits = load_bundled("lite6").joint_limits
    fresh = np.random.default_rng(1).uniform(*limits.T, (1000, 6))
    nominal = hayati_poses([0, 0, 0, 0], LITE6_DH, {}, fresh)
    distance = 1e3 * np.linalg.norm(
        (nominal - six_parameter_poses(read_factory(calibration).kinematics, fresh))[:, :3, 3], axis=1
    )
    statistics = (distance.mean(), np.median(distance), np.percentile(distance, 95), distance.max())
    line = re.search(r"^nominal arm +mm +(.+)$", said, re.MULTILINE)
    np.testing.assert_allclose([float(v) for v in line[1].split()], statistics, atol=0.5001e-4)
    assert f"the nominal one is up to {distance.max():.3f} mm off" in flat(said)
    checked = re.search(r"^1000 fresh samples +mm +(.+)$", said, re.MULTILINE)
    assert 0 < max(float(v) for v in checked[1].split()) < 1e-10


@pytest.mark.parametrize("width", [60, 80, 120])
def test_no_line_is_wider_than_the_screen(capsys, calibration, width):
    _, said, _ = run(capsys, "fit", calibration, width=width)
    assert max(map(len, said.splitlines()[1:])) <= width  # the first is the path, in one piece
    assert "…" not in said
    shown = printed_table(said)
    assert [len(shown[i]) for i in range(1, 7)] == [4, 5, 4, 4, 4, 4]


def test_files_are_not_replaced_unasked(capsys, tmp_path, calibration):
    out = tmp_path / "model.json"
    out.write_text("mine")
    assert refused(capsys, "fit", calibration, "--out", out) == (
        f"{out}: exists already; choose another name or add --force to replace it"
    )
    figure = tmp_path / "figures" / "arm_error_by_joint.svg"
    figure.parent.mkdir()
    figure.write_text("mine")
    assert f"{figure}: exists already" in refused(capsys, "fit", calibration, "--figures", figure.parent)
    assert out.read_text() == figure.read_text() == "mine"
    assert run(capsys, "fit", calibration, "--out", out, "--force")[0] == 0
    assert json.loads(out.read_text())["units"] == "mm and deg"
    assert "let the name end in .json" in refused(capsys, "fit", calibration, "--out", tmp_path / "model.yaml")
    assert "this folder cannot be created" in refused(capsys, "fit", calibration, "--figures", out / "below")


def stop(*given, **named):
    raise InputError("stopped")


def test_the_demo_finds_what_it_hid_and_says_where_the_page_is(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("lite6jax.cli.demo.POSES", 100)
    code, said, _ = run(capsys, "demo", width=60)
    assert code == 0
    assert flat(said).startswith("No arm was measured: this Lite 6 is simulated.")
    assert max(map(len, said.splitlines())) <= 60
    for effect, true in (("joint compliance at joint2", 90.0), ("joint backlash at joint4", 1.5)):
        hidden, found, std = re.search(rf"^{effect} +([\d.]+) +([\d.]+) ± ([\d.]+) ", said, re.MULTILINE).groups()
        assert float(hidden) == true
        assert abs(float(found) - true) < 3.5 * float(std) < true / 2
    assert said.endswith("The page with the figures, to be opened in a browser:\n  lite6jax-demo/report.html\n")
    folder = tmp_path / "lite6jax-demo"
    names = {"run.csv", "run.yaml", "factory.yaml", "diagnosis.json", "report.html", "model.json"}
    assert {path.name for path in folder.iterdir()} == names
    page = (folder / "report.html").read_text()
    assert page.count("data:image/png") >= 4
    assert "lite6jax view lite6jax-demo/diagnosis.json" in page
    assert "Converged" in said

    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert "exists already" in refused(capsys, "demo", folder)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    monkeypatch.setattr("lite6jax.simulation.simulate", stop)
    assert refused(capsys, "demo") == "stopped"
    assert (tmp_path / "lite6jax-demo-2").is_dir()  # a folder of its own where none is named


def test_the_demo_needs_a_folder_that_can_be_made(capsys, tmp_path):
    (tmp_path / "file").write_text("mine")
    assert "cannot be created" in refused(capsys, "demo", tmp_path / "file" / "below")


def test_the_factory_file_of_the_demo_says_that_it_is_simulated():
    assert "SIMULATED" in DEMO.read_text().splitlines()[0]
    spread = read_factory(DEMO).kinematics - LITE6
    wanted = np.random.default_rng(0).standard_normal((6, 6)) * ([0.8e-3] * 3 + [np.deg2rad(0.15)] * 3)
    np.testing.assert_allclose(spread, wanted, atol=1e-9)


# ------------------------------------------------------------------ fit: what is refused


@pytest.mark.parametrize("name", ["missing.yaml", "missing.csv", "missing.json"])
def test_a_missing_file_is_named(capsys, tmp_path, name):
    assert refused(capsys, "fit", tmp_path / name) == f"{tmp_path / name}: no such file; check the name"


def test_files_of_other_kinds_are_refused(capsys, tmp_path, calibration):
    huge = tmp_path / "huge.yaml"
    huge.write_text("kinematics: [" + "1, " * 600_000 + "1]\n")
    assert refused(capsys, "fit", huge).startswith(f"{huge}: larger than 1048576 bytes")
    bomb = tmp_path / "bomb.yaml"
    bomb.write_text("a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
        f"{y}: &{y} [{', '.join(['*' + x] * 10)}]\n" for x, y in zip("abcdef", "bcdefg", strict=True)
    ))  # fmt: skip
    assert "aliases expand to over 100000 values" in refused(capsys, "fit", bomb)
    picture = tmp_path / "picture.yaml"
    picture.write_bytes(b"\x89PNG\r\n\x1a\n\xff\xfe")
    assert "is not text" in refused(capsys, "fit", picture)
    assert refused(capsys, "fit", tmp_path).startswith(f"{tmp_path}: is a folder without a recording: no rosbag2")
    folder_out = tmp_path / "model.json"
    folder_out.mkdir()
    assert refused(capsys, "fit", calibration, "--out", folder_out) == f"{folder_out}: is a folder; name a file"
    assert refused(capsys, "fit", calibration, "--arm", "lite7").startswith(
        "lite7: neither a bundled arm nor a file; did you mean 'lite6'?"
    )
    assert refused(capsys, "fit", calibration, "--arm", "xarm7") == (
        f"{calibration}: has 6 joints, but xarm7 has 7; name another with --arm NAME"
    )
    assert refused(capsys, "fit", calibration, "--samples", "3").startswith("samples 3: too few")


# ------------------------------------------------------------------ fit: a recording


def test_fit_of_a_recording(capsys, tmp_path):
    path = write_recording_file(tmp_path / "run.csv")
    out = tmp_path / "model.json"
    code, said, err = run(capsys, "fit", path, "--out", out, "--figures", tmp_path, width=60)
    assert (code, err) == (0, "")
    text = flat(said)
    assert "Recording of 120 samples, 6 joints of a lite6: positions and orientations by laser tracker." in text
    assert "Geometry: nominal, fitted. Sensor frame: the arm's base. Tool: none." in text
    assert "below each number its standard deviation" in text
    assert "Noise per axis: declared 0.0200 mm, 0.0057 deg; the residuals have" in text
    assert "as declared." in text
    assert "No outliers among 120 samples." in text
    assert max(map(len, [line for line in said.splitlines() if str(tmp_path) not in line])) <= 60
    assert (tmp_path / "run_error_by_joint.png").stat().st_size > 10_000

    # the table written is the arm that was measured, to the noise of 120 samples
    rng = np.random.default_rng(0)
    random_positions(rng, 120, 6)
    truth = perturbed(rng, LITE6)
    q = random_positions(np.random.default_rng(9), 200, 6) * 0.5
    model = read_factory(out)
    ours = six_parameter_poses(model.kinematics, q) @ model.T_joint_flange
    distance = np.linalg.norm((ours - six_parameter_poses(truth, q))[:, :3, 3], axis=1)
    assert 0 < np.sqrt(np.mean(distance**2)) < 4e-5


def test_degrees_and_millimetres_are_asked_about_and_accepted(capsys, tmp_path):
    path = write_recording_file(tmp_path / "run.csv", samples=5)
    rows = np.genfromtxt(path, delimiter=",", names=True)
    rows = np.array(rows.tolist())
    rows[:, :6] = np.rad2deg(rows[:, :6])
    header = path.read_text().splitlines()[0]
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.17g")
    line = refused(capsys, "fit", path)
    assert line.startswith(f"{path}: column q")
    assert line.endswith("are these degrees? name the columns q1_deg ... or add --assume-degrees")
    # accepted, the same file gets as far as its number of samples
    assert "record at least" in refused(capsys, "fit", path, "--assume-degrees")
    rows[:, 6:9] *= 1e3
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.17g")
    line = refused(capsys, "check", path, "--assume-degrees")
    assert line.endswith("are these millimetres? name the columns x_mm y_mm z_mm or add --assume-millimetres")


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        ("", ("is empty",)),
        ("q1,q2\n1,2\n", ("column 'q1': the unit is missing", "write q1_rad or q1_deg")),
        ("x_m,y_m,z_m\n1,2,3\n", ("q1_rad",)),
        ("q1_rad,q2_rad\n1,2\n", ("has no measured positions",)),
        (
            "q1_rad,q2_rad,x_m,y_m,z_m\n1,2,0,0,0\n",
            ("declares no arm, and no bundled one has 2 joints", "name it with --arm NAME, or `arm:` in the sidecar"),
        ),
    ],
)
def test_a_recording_that_is_none(capsys, tmp_path, content, parts):
    path = tmp_path / "run.csv"
    path.write_text(content)
    line = refused(capsys, "fit", path)
    assert line.startswith(str(path))
    for part in parts:
        assert part in line


# ------------------------------------------------------------------ compare


def test_compare_shows_how_arms_differ(capsys, tmp_path):
    arms = []
    for i, shift in enumerate((0.0, 1e-3, -1e-3)):
        kinematics = LITE6.copy()
        kinematics[0, 2] += shift  # d1
        arms.append(write_factory(kinematics, tmp_path / f"station{i + 1}.yaml"))
    code, said, err = run(capsys, "compare", *arms, "--figures", tmp_path, width=60)
    assert (code, err) == (0, "")
    assert said.startswith("3 arms of the type lite6; flange over 1000 samples.\n")
    row = re.search(r"^d1 +mm +(.+)$", said, re.MULTILINE)
    np.testing.assert_allclose([float(v) for v in row[1].split()], [0, 1, -1, 1, 1], atol=1e-4)
    same = flat(said).split("Equal to nominal in every arm: ")[1].split(".")[0].split(", ")
    assert len(same) == 27
    assert "d1" not in same
    distances = said.split("two arms' flanges (mm)\n")[1].splitlines()[2:5]
    assert [line.split() for line in distances] == [
        ["1", "–", "1.00", "1.00"],
        ["2", "1.00", "–", "2.00"],
        ["3", "1.00", "2.00", "–"],
    ]
    assert max(map(len, [line for line in said.splitlines() if "Wrote" not in line])) <= 60
    for name in ("compare_parameters.svg", "compare_distances.png"):
        assert (tmp_path / name).stat().st_size > 5_000


def test_compare_refuses_other_types_and_single_files(capsys, tmp_path, calibration):
    other = write_factory(load_bundled("ur5e").kinematics, tmp_path / "ur.yaml", "ur")
    assert refused(capsys, "compare", calibration, other) == (
        f"{other}: is of a ur5e, but {calibration} of a lite6; compare arms of one type"
    )
    assert refused(capsys, "compare", calibration) == "compare needs two calibrations or more; name their files"


# ------------------------------------------------------------------ fleet


def test_a_fleet_has_a_row_a_file(capsys, tmp_path):
    inputs = tmp_path / "arms"
    inputs.mkdir()
    rng = np.random.default_rng(2)
    for i in range(3):
        write_factory(perturbed(rng, LITE6), inputs / f"lite{i}.yaml")
    flawed = write_factory(perturbed(rng, LITE6), inputs / "flawed.yaml")
    content = yaml.safe_load(flawed.read_text())
    del content["kinematics"]["joint2"]
    flawed.write_text(yaml.safe_dump(content))
    (inputs / "settings.yaml").write_text("ros: {rate: 100}\n")
    (inputs / "notes.txt").write_text("not read")
    (inputs / "broken.csv").write_text("q1_rad\n")
    out = inputs / "fleet.parquet"
    code, said, err = run(capsys, "fleet", inputs, "--out", out, width=100)
    assert (code, err) == (0, "")
    table = pyarrow.parquet.read_table(out).to_pylist()
    rows = {row["file"]: row for row in table}
    assert list(rows) == ["broken.csv", "flawed.yaml", "lite0.yaml", "lite1.yaml", "lite2.yaml", "settings.yaml"]
    for i in range(3):
        row = rows[f"lite{i}.yaml"]
        assert (row["kind"], row["result"], row["message"]) == ("calibration", int(Result.CONVERGED), "converged")
        assert row["arm"] == "lite6"
        assert row["checked_position_max_m"] < 1e-13
        assert 1e-3 < row["nominal_position_max_m"] < 2e-2
        base = [row[name] for name in ("base_x_m", "base_y_m", "base_roll_rad", "base_pitch_rad")]
        dh = [
            [row.get(name) or 0.0 for name in (f"theta_off{j}_rad", f"d{j}_m", f"a{j}_m", f"alpha{j}_rad")]
            for j in range(1, 7)
        ]
        q = random_positions(rng, 20, 6)
        truth = six_parameter_poses(read_factory(inputs / f"lite{i}.yaml").kinematics, q)
        np.testing.assert_allclose(hayati_poses(base, np.array(dh), {1: row["beta2_rad"]}, q), truth, atol=1e-13)
    assert "joint2 is missing" in rows["flawed.yaml"]["message"]
    assert (rows["flawed.yaml"]["kind"], rows["flawed.yaml"]["result"]) == ("calibration", int(Result.UNREADABLE))
    assert rows["settings.yaml"]["kind"] == "other"
    assert "not a calibration" in rows["settings.yaml"]["message"]
    assert rows["broken.csv"]["kind"] == "recording"
    assert rows["flawed.yaml"]["d1_m"] is None
    assert "3 of 6 files have no usable fit:" in said
    # its own table is not an input when it is written again, and is not replaced unasked
    assert "exists already" in refused(capsys, "fleet", inputs, "--out", out)
    assert run(capsys, "fleet", inputs, "--out", out, "--force")[0] == 0
    assert pyarrow.parquet.read_table(out).to_pylist() == table


def test_a_fleet_is_fitted_by_workers_alone(tmp_path, calibration):
    code = (
        "import sys; from lite6jax import cli\n"
        "if __name__ == '__main__':\n"
        "    cli.main(sys.argv[1:]); sys.exit(sum(name in sys.modules for name in ('jax', 'scipy', 'matplotlib')))"
    )
    command = [sys.executable, "-c", code, "fleet", calibration.parent, "--out", tmp_path / "f.parquet"]
    done = subprocess.run(list(map(str, command)), cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_fleet_refuses_what_is_no_folder(capsys, tmp_path, calibration):
    out = tmp_path / "fleet.parquet"
    assert refused(capsys, "fleet", calibration, "--out", out) == f"{calibration}: is not a folder; name one"
    assert refused(capsys, "fleet", tmp_path / "no", "--out", out) == f"{tmp_path / 'no'}: no such folder; name one"
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "has no calibration or recording" in refused(capsys, "fleet", empty, "--out", out)
    assert "what is written here is parquet; let the name end in .parquet" in refused(
        capsys, "fleet", tmp_path, "--out", tmp_path / "fleet.csv"
    )
    assert not out.exists()


def test_a_defect_met_on_one_file_does_not_lose_the_others(monkeypatch, tmp_path, calibration):
    def stumble(path, nominal):
        raise ZeroDivisionError("division\nby zero")

    monkeypatch.setattr(folder, "_read_calibration", stumble)
    (row,) = folder.fit_files([calibration], None)
    assert row["result"] == Result.UNREADABLE
    assert row["message"] == (
        f"{calibration}: unexpected ZeroDivisionError: division by zero; please report it with this file"
    )


# ------------------------------------------------------------------ convert


def test_convert_carries_a_calibration_through_every_form(capsys, tmp_path, calibration):
    chain = [calibration, *(tmp_path / name for name in ("a.json", "b.urdf", "c.yaml", "d.yaml", "e.yaml"))]
    for source, target, form in zip(chain, chain[1:], [None, None, "description", "vendor", "ur"], strict=False):
        code, said, err = run(capsys, "convert", source, target, *(["--to", form] if form else []))
        assert (code, err) == (0, "")
        assert f"Wrote {target}\n" in said
        difference = re.search(r"differs by at most (\S+) mm", flat(said))
        assert float(difference[1]) < 1e-11
    q = random_positions(np.random.default_rng(3), 30, 6)
    truth = six_parameter_poses(read_factory(calibration).kinematics, q)
    np.testing.assert_allclose(six_parameter_poses(read_factory(chain[-1]).kinematics, q), truth, atol=1e-13)
    assert set(yaml.safe_load(chain[-1].read_text())["kinematics"]) >= {"shoulder", "wrist_3"}
    said = run(capsys, "convert", chain[3], tmp_path / "f.yaml", "--to", "ur")[1]
    assert "Left out: joint limits, masses and inertia." in said


def test_convert_refuses_what_a_form_cannot_hold(capsys, tmp_path, calibration):
    table = tmp_path / "model.json"
    run(capsys, "convert", calibration, table)
    content = json.loads(table.read_text())
    content["dh"][5].update(a=1.5, alpha=2.0)
    table.write_text(json.dumps(content))
    target = tmp_path / "out.yaml"
    assert refused(capsys, "convert", table, target) == (
        f"{target}: a six-parameter file ends at joint 6 and cannot hold what follows it in {table}"
        " (1.5 mm, 2°); write a .json table, a .urdf or --to description"
    )
    assert not target.exists()
    # the forms it names do hold it, and back to a table nothing is lost
    for name, form in (("out.urdf", None), ("out.yaml", "description")):
        assert run(capsys, "convert", table, tmp_path / name, *(["--to", form] if form else []))[0] == 0
        back = tmp_path / f"{name}.json"
        code, _, err = run(capsys, "convert", tmp_path / name, back)
        assert (code, err) == (0, "")
        last = json.loads(back.read_text())["dh"][5]
        np.testing.assert_allclose([last["a"], last["alpha"]], [1.5, 2.0], atol=1e-10)
    assert "a file of the form table ends in .json" in refused(
        capsys, "convert", table, target.with_name("x.yaml"), "--to", "table"
    )
    assert "name the form with --to" in refused(capsys, "convert", table, tmp_path / "x.txt")
    assert "exists already" in refused(capsys, "convert", calibration, table)
    xarm7 = tmp_path / "xarm7.yaml"
    assert "choose another form" in refused(capsys, "convert", "xarm7", xarm7, "--to", "ur")


# ------------------------------------------------------------------ check


def test_check_finds_the_default_table(capsys, tmp_path, calibration):
    default = write_factory(load_bundled("lite6_ros").kinematics, tmp_path / "ros.yaml")
    code, said, err = run(capsys, "check", default, calibration)
    assert (code, err) == (0, "")
    text = flat(said)
    assert "! Nominal table: This is the vendor's ROS default (lite6_ros), not the calibration of one arm" in text
    assert "the published table (lite6) 1.0" in text
    assert "· Nominal table: This is a calibration of a lite6: the published table (lite6)" in text
    assert "· Tool offset: No tool offset: a shift of" in text


def test_check_finds_a_tool_offset(capsys, tmp_path):
    shifted = LITE6.copy()
    shifted[5, 1] += 4e-3  # along joint 6's axis: as a tool 4 mm long would look
    calibration = write_factory(shifted, tmp_path / "arm.yaml")
    text = flat(run(capsys, "check", calibration)[1])
    assert "! Tool offset: A tool offset is likely: a shift of (" in text
    shift = re.search(r"a shift of \((\S+), (\S+), (\S+)\) mm in the flange frame explains 100 %", text)
    np.testing.assert_allclose([float(v) for v in shift.groups()], [0, 0, 4], atol=1e-3)


def test_check_of_a_recording(capsys, tmp_path):
    path = write_recording_file(tmp_path / "run.csv", tool=(0, 0, 0.03))
    lines = path.read_text().splitlines()
    values = np.array([float(v) for v in lines[40].split(",")])
    values[6:9] += 0.02  # row 40: a wild sample
    lines[40] = ",".join(repr(float(v)) for v in values)
    lines[61] = lines[60]
    path.write_text("\n".join(lines) + "\n")
    code, said, err = run(capsys, "check", path)
    assert (code, err) == (0, "")
    text = flat(said)
    assert "! Repeated rows: 1 row exactly repeats joints and pose of an earlier row (row 61 those of row 60)" in text
    offset = re.search(r"! Tool other than declared: .* it is at \((\S+), (\S+), (\S+)\) mm on the flange", text)
    np.testing.assert_allclose([float(v) for v in offset.groups()], [0, 0, 30], atol=3)
    assert "· Geometry: The error is a calibration error: a change of geometry explains" in text
    assert "! Outliers: Row 40 is an outlier, by up to" in text


# ------------------------------------------------------------------ real files


def test_the_distance_from_nominal_is_one_number_in_every_command(capsys, calibration, tmp_path):
    folder = tmp_path / "arms"
    folder.mkdir()
    for name in ("a.yaml", "b.yaml"):
        (folder / name).write_bytes(calibration.read_bytes())
    _, said, _ = run(capsys, "fit", calibration)
    shown = re.search(r"the nominal one is up to (\S+) mm off, at 1000 joint positions\.", flat(said))[1]
    _, said, _ = run(capsys, "compare", folder / "a.yaml", folder / "b.yaml", "--json")
    assert f"{1e3 * json.loads(said)['from_nominal_m'][0]['max']:.3f}" == shown
    run(capsys, "fleet", folder, "--out", tmp_path / "fleet.parquet")
    rows = pyarrow.parquet.read_table(tmp_path / "fleet.parquet")["nominal_position_max_m"].to_pylist()
    assert [f"{1e3 * most:.3f}" for most in rows] == [shown, shown]


@pytest.mark.long
@pytest.mark.skipif(not (REAL / "ur10").exists(), reason="ur10 is not here")
def test_the_ur10_recording(capsys):
    code, said, err = run(capsys, "fit", REAL / "ur10" / "ur10_series_b.csv")
    assert (code, err) == (0, "")
    text = flat(said)
    assert "Recording of 1495 samples, 6 joints of a ur10: positions and orientations by laser tracker." in text
    held_out = re.search(r"(\S+) mm RMS on held-out rows, (\S+) mm before", text)
    assert float(held_out[1]) <= 0.48
    assert float(held_out[2]) == pytest.approx(1.1, abs=0.02)
    assert "Joints 2-3 and 3-4 are nominally parallel" in text
    assert "theta_off1: confounded with frame_rz" in text
    assert re.search(r"^J1 .*\n +held +held +±", said, re.MULTILINE)
    named = re.search(r"samples are outliers with weights below 0.3: rows ([\d, ]+)", text)
    assert {"533", "855", "856"} <= set(named[1].split(", "))  # 532, 854 and 855 from zero, as its README has them


def test_a_reader_who_leaves_early_does_not_cost_the_file(tmp_path):
    """`lite6jax fit … --out model.json | head -1`."""
    out = tmp_path / "model.json"
    command = [sys.executable, "-m", "lite6jax.cli", "fit", str(DEMO), "--out", str(out)]
    with subprocess.Popen(
        command, cwd=Path(__file__).parents[1], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        complaint = process.stderr.read()
    assert complaint == b""
    assert json.loads(out.read_text())["units"] == "mm and deg"


def test_an_unknown_option_is_answered_with_options_of_its_command_alone(capsys):
    assert program.main(["diagnose", "run.csv", "--foo"]) == 2
    said = capsys.readouterr().err
    assert "Unrecognized options: --foo" in said
    assert "Perhaps you meant" not in said  # `design --floor` is another command's
    assert "lite6jax diagnose --help" in said
    assert program.main(["diagnose", "run.csv", "--reprt", "page.html"]) == 2
    assert "--report FILE" in capsys.readouterr().err
