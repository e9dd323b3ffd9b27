"""`diagnose` and `predict` as they are typed: what is printed, written and refused."""

import json
import shlex
from pathlib import Path

import numpy as np
import pyarrow.csv
import pytest
from diagnosis.recorded import LITE6, Made, quaternions, static_motion, with_effects
from domains.pose.documents import OWN, document
from typed import flat, refused, run

from lite6jax.arms.factory import write_factory
from lite6jax.recordings import Recording, write_recording
from tests.corpus import COMPLIANCE

SAMPLES = 300


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=1)


@pytest.fixture(scope="module")
def recorded(corpus):
    """A recording of a compliant arm, with three outliers."""
    return corpus["compliance"].path


@pytest.fixture(scope="module")
def diagnosed(corpus):
    """The file that `diagnose` wrote of it, and what it printed."""
    return corpus["compliance"].printed


@pytest.fixture(scope="module")
def motion():
    return static_motion(12, 30)


@pytest.fixture
def motion_file(motion, tmp_path):
    path = write_recording(
        Recording.from_arrays(motion["joint_position"], payload=motion["payload"]), tmp_path / "motion.csv"
    )
    path.with_suffix(".yaml").unlink()
    return path


# ------------------------------------------------------------------ diagnose


def test_diagnose_prints_a_page(diagnosed, recorded):
    out, said = diagnosed
    text = flat(said)
    assert str(recorded) in said
    assert "lite6, 200 samples (static)." in text
    assert "Explained: with the effects below, the held-out errors are the sensor's noise." in text
    assert "held-out error before after after / before" in text
    assert "0.0200 mm is declared." in text
    assert "1. Joint compliance at joint2, a function of the gravity torque of joint 2, is significant: " in text
    assert "3 rows are outliers and have little weight. Check them. Rows 4, 51, 100." in text
    assert text.index("Joint 2 gives way to gravity: ") < text.index("Explained: ")
    assert "(stiffness 1" in text
    assert f"Wrote {out}" in said.replace("\n", "")
    assert max(map(len, said.splitlines())) <= 80 or str(recorded) in said


def test_diagnose_finds_an_effect_of_ones_own(capsys, arm, tmp_path):
    own = tmp_path / "mine.py"
    own.write_text(OWN)
    still = static_motion(1, SAMPLES)
    recording = arm.recording(still, bump=(3, lambda q: 8e-4 * np.tanh(q)))
    # what a curve like this may pass for without its own name is not asked here
    path = write_recording(recording, tmp_path / "run.csv")
    out = tmp_path / "d.json"
    code, said, _ = run(capsys, "diagnose", path, "--quick", "--out", out, "--effects", own)
    assert code == 0
    assert "Cable drag at joint3, a function of the position of joint 3, is significant: drag " in flat(said)
    found = json.loads(out.read_text())
    assert [(f["effect"], f["site"]) for f in found["findings"]] == [("cable_drag", "joint3")]
    entry = found["findings"][0]["parameters"]["drag_rad"]
    assert abs(entry["value"] - 8e-4) < 4 * entry["std"]
    # its model needs the file again
    for another in ((), ("--effects", tmp_path / "others.py")):
        (tmp_path / "others.py").write_text(OWN.replace("cable_drag", "hose_drag"))
        said = refused(capsys, "predict", out, path, "--out", tmp_path / "p.csv", *another)
        assert "its model has the effect 'cable_drag'" in said
        assert "--effects FILE.py" in said
        assert "damaged" not in said
    code, _, _ = run(capsys, "predict", out, path, "--out", tmp_path / "p.csv", "--effects", own)
    assert code == 0


def test_what_diagnose_refuses(capsys, arm, recorded, tmp_path):
    out = tmp_path / "d.json"
    calibration = write_factory(LITE6.kinematics, tmp_path / "factory.yaml")
    assert refused(capsys, "diagnose", calibration, "--out", out) == (
        f"{calibration}: is a calibration; give a recording (.csv, .parquet, .mcap, .bag)"
    )
    joints = write_recording(Recording.from_arrays(static_motion(1, 5)["joint_position"]), tmp_path / "joints.csv")
    said = refused(capsys, "diagnose", joints, "--out", out)
    assert said == f"{joints}: has no measured positions; a fit needs the columns x_m y_m z_m"
    assert "none.csv" in refused(capsys, "diagnose", tmp_path / "none.csv", "--out", out)
    said = refused(capsys, "diagnose", recorded, "--out", out, "--poses", "--torques")
    assert "give one of them, or none to diagnose all that was recorded" in said
    said = refused(capsys, "diagnose", recorded, "--out", tmp_path / "d.txt")
    assert said == f"{tmp_path / 'd.txt'}: what is written here is json; let the name end in .json"
    assert not out.exists()


@pytest.mark.parametrize("name", ["README.md", "pyproject.toml", "mkdocs.yml", "notes.json", "program.py"])
def test_a_file_that_is_no_recording_is_answered_in_one_line(capsys, tmp_path, name):
    path = tmp_path / name
    path.write_text("# A page: with colons\n\n- and: lists: of all kinds\n")
    assert refused(capsys, "diagnose", path) == (
        f"{path}: is no recording; a recording ends in .csv, .txt, .parquet, .xlsx, .h5, .npz, .mat or .mcap, or is "
        "the folder of a rosbag2 or of a LeRobot data set; convert it or correct the name"
    )


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("x = 1\n", "has no list EFFECTS; end it with EFFECTS = [MyEffect(joint=1), …]"),
        ("EFFECTS = [1 / 0]\n", "line 1: ZeroDivisionError"),
        ("EFFECTS = [3]\n", "EFFECTS[0]: 3 is not an effect; derive its class from JointEffect or Bending"),
        ("def (:\n", "line 1: SyntaxError"),
    ],
)
def test_a_bad_file_of_effects(capsys, recorded, diagnosed, motion_file, tmp_path, content, says):
    own = tmp_path / "bad.py"
    own.write_text(content)
    out = tmp_path / "d.json"
    said = refused(capsys, "diagnose", recorded, "--out", out, "--effects", own)
    assert said.startswith(f"{own}: ")
    assert says in said
    assert not out.exists()
    assert says in refused(capsys, "predict", diagnosed[0], motion_file, "--out", tmp_path / "p.csv", "--effects", own)


# ------------------------------------------------------------------ predict


def test_predict_another_motion(capsys, arm, diagnosed, motion, motion_file, tmp_path):
    out = tmp_path / "predicted.csv"
    code, said, err = run(capsys, "predict", diagnosed[0], motion_file, "--out", out)
    assert (code, err) == (0, "")
    assert f"Wrote {out}" in said.replace("\n", "")
    assert "rows are empty" not in said
    assert out.read_text().startswith("x_m,y_m,z_m,qw,qx,qy,qz,x_std_m,")
    table = pyarrow.csv.read_csv(out)
    found = np.stack([table[name].to_numpy() for name in table.column_names[:7]], 1)
    poses = with_effects(arm, COMPLIANCE).poses(motion)
    assert found.shape == (30, 7)
    off = found[:, :3] - poses[:, :3, 3]
    assert np.sqrt(np.mean(np.sum(off**2, 1))) < 3e-6
    assert (2 * np.arccos(np.minimum(np.abs(np.sum(found[:, 3:] * quaternions(poses), 1)), 1)) < 3e-5).all()
    assert f"{out}: exists already" in refused(capsys, "predict", diagnosed[0], motion_file, "--out", out)
    assert run(capsys, "predict", diagnosed[0], motion_file, "--out", out, "--force")[0] == 0


def test_what_predict_refuses(capsys, arm, diagnosed, motion_file, tmp_path):
    out = tmp_path / "p.csv"
    said = refused(capsys, "predict", diagnosed[0], motion_file, "--out", tmp_path / "p.json")
    assert said == f"{tmp_path / 'p.json'}: what is written here is csv; let the name end in .csv"
    assert "is a recording and no diagnosis" in refused(capsys, "predict", motion_file, motion_file, "--out", out)
    assert "none.csv" in refused(capsys, "predict", diagnosed[0], tmp_path / "none.csv", "--out", out)
    drift = tmp_path / "drift.json"
    drift.write_text(json.dumps(document(arm, ["base_drift:vx_m_per_s=1e-6"])))
    said = refused(capsys, "predict", drift, motion_file, "--out", out)
    assert "base_drift" in said
    assert "needs the time" in said
    assert not out.exists()


# ------------------------------------------------------------------ what it begins with, and what follows from it


def test_without_out_nothing_is_written_and_json_is_the_file(capsys, recorded, diagnosed, monkeypatch, corpus):
    found = corpus["compliance"].diagnosis
    monkeypatch.setattr("lite6jax.diagnosis.diagnose.diagnose", lambda *_, **__: found)
    before = {path.name: path.stat().st_mtime_ns for path in recorded.parent.iterdir()}
    code, said, err = run(capsys, "diagnose", recorded)
    assert (code, err) == (0, "")
    assert {path.name: path.stat().st_mtime_ns for path in recorded.parent.iterdir()} == before
    assert "Wrote" not in said
    assert f"    lite6jax diagnose {recorded} --out run7_diagnosis.json" in said
    code, said, err = run(capsys, "diagnose", recorded, "--json")
    assert (code, err) == (0, "")
    assert json.loads(said) == json.loads(diagnosed[0].read_text())


def test_the_commands_to_copy_work(capsys, recorded, diagnosed):
    lines = [line.strip() for line in diagnosed[1].splitlines() if line.startswith("    lite6jax ")]
    commands = [shlex.split(line)[1:] for line in lines]
    assert [command[0] for command in commands] == ["compensate", "view", "report"]
    served = commands.pop(1)
    assert run(capsys, *served, "--port", "0", "--duration", "0.1")[::2] == (0, "")
    for command in commands:
        code, _, err = run(capsys, *command)
        assert err == ""
        assert code in ((0, 1) if command[0] == "compensate" else (0,))  # the outliers are poses out of reach
        assert Path(command[-1]).exists()
        Path(command[-1]).unlink()
    recorded.with_name("run7_compensated.yaml").unlink()


def test_report_repeats_the_page_and_certifies(capsys, diagnosed, tmp_path):
    code, said, _ = run(capsys, "report", diagnosed[0])
    assert code == 0
    page = diagnosed[1].splitlines()
    assert said.splitlines()[1:20] == page[1:20]
    pdf = tmp_path / "c.pdf"
    code, said, _ = run(capsys, "report", diagnosed[0], "--certificate", pdf)
    assert code == 0
    assert pdf.read_bytes().startswith(b"%PDF-")
    assert f"Wrote {pdf}" in said.replace("\n", "")
    assert f"{pdf}: exists already" in refused(capsys, "report", diagnosed[0], "--certificate", pdf)
    code, said, _ = run(capsys, "report", diagnosed[0], "--json")
    assert json.loads(said) == json.loads(diagnosed[0].read_text())


def test_what_report_refuses(capsys, diagnosed, recorded, tmp_path):
    pdf = tmp_path / "c.pdf"
    made = f"lite6jax diagnose {recorded} --out {recorded.with_suffix('.json')}"
    assert refused(capsys, "report", recorded) == (
        f"{recorded}: is a recording and no diagnosis; give what `{made}` writes"
    )
    said = refused(capsys, "report", diagnosed[0], "--certificate", tmp_path / "c.txt")
    assert said == f"{tmp_path / 'c.txt'}: what is written here is pdf; let the name end in .pdf"
    document = json.loads(diagnosed[0].read_text())
    broken = tmp_path / "broken.json"
    for lost in ("before", "findings", "left"):
        broken.write_text(json.dumps({key: value for key, value in document.items() if key != lost}))
        code, out, err = run(capsys, "report", broken, "--certificate", pdf)
        assert (code, out) == (2, "")
        assert f"{broken}: is damaged (it lacks '{lost}'); run `lite6jax diagnose` again" in err
    assert not pdf.exists()
    broken.write_text(json.dumps({**document, "schema": "lite6jax/fit/1"}))
    assert "is no diagnosis of poses (lite6jax/diagnosis/3 with a model)" in refused(capsys, "report", broken)
