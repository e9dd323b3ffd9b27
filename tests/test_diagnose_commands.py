"""`diagnose` and `predict` as they are typed: what is printed, written and refused."""

import json

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


@pytest.fixture(autouse=True)
def _terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")


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
    assert "held-out position error (mm) rms p95 max" in text
    assert "0.0200 mm is declared." in text
    assert "1. Joint compliance at joint2, a function of the gravity torque of joint 2, is significant: " in text
    assert "3 rows are outliers and have little weight. Check them. Rows 4, 51, 100." in text
    assert "Effects not tested:" in text
    assert "Joint lag at joint1–6" in text
    assert f"Wrote {out}" in said.replace("\n", "")
    assert max(map(len, said.splitlines())) <= 80 or str(recorded) in said


def test_diagnose_writes_the_schema(diagnosed):
    document = json.loads(diagnosed[0].read_text())
    assert {
        "schema",
        "verdict",
        "before",
        "after",
        "noise",
        "data_faults",
        "findings",
        "model",
    } <= set(document)
    assert document["schema"] == "lite6jax/diagnosis/2"
    assert document["verdict"] == "explained"
    for part in ("before", "after"):
        errors = document[part]
        assert set(errors) == {"heldout_position_rms_m", "heldout_position_p95_m", "heldout_position_max_m"}
        assert all(type(value) is float and value > 0 for value in errors.values())
        assert errors["heldout_position_rms_m"] < errors["heldout_position_p95_m"] <= errors["heldout_position_max_m"]
    assert document["after"]["heldout_position_rms_m"] < document["before"]["heldout_position_rms_m"]
    assert type(document["noise"]["estimated_position_m"]) is float
    assert document["noise"]["declared_position_m"] == 2e-5
    (fault,) = document["data_faults"]
    assert fault["fault"] == "outliers"
    assert fault["rows"] == [4, 51, 100]
    assert "3 rows" in fault["statement"]
    (finding,) = document["findings"]
    assert {
        "effect",
        "site",
        "driver",
        "parameters",
        "p_value",
        "heldout_rms_before_m",
        "heldout_rms_after_m",
        "confusable_with",
        "statement",
    } <= set(finding)
    assert (finding["effect"], finding["site"]) == ("joint_compliance", "joint2")
    assert finding["driver"] == "gravity torque of joint 2"
    entry = finding["parameters"]["compliance_rad_per_Nm"]
    assert set(entry) == {"value", "std"}
    assert abs(entry["value"] - 9e-5) < 4 * entry["std"] < 1e-5
    assert 0 <= finding["p_value"] < 1e-3
    for rival in finding["confusable_with"]:
        assert {"effect", "site", "driver", "log_likelihood_gap", "status"} <= set(rival)
        assert type(rival["log_likelihood_gap"]) is float
    model = document["model"]
    assert np.shape(model["kinematics"]) == (6, 6)
    assert model["arm"] == "lite6"


def test_diagnose_finds_an_effect_of_ones_own(capsys, arm, tmp_path):
    own = tmp_path / "mine.py"
    own.write_text(OWN)
    still = static_motion(1, SAMPLES)
    recording = arm.recording(still, bump=(3, lambda q: 8e-4 * np.tanh(q)))
    # what a curve like this may pass for without its own name is not asked here
    path = write_recording(recording, tmp_path / "run.csv")
    out = tmp_path / "d.json"
    code, said, _ = run(capsys, "diagnose", path, "--out", out, "--effects", own)
    assert code == 0
    assert "Cable drag at joint3, a function of the position of joint 3, is significant: drag " in flat(said)
    found = json.loads(out.read_text())
    assert [(f["effect"], f["site"]) for f in found["findings"]] == [("cable_drag", "joint3")]
    entry = found["findings"][0]["parameters"]["drag_rad"]
    assert abs(entry["value"] - 8e-4) < 4 * entry["std"]
    # its model needs the file again
    assert "effect 'cable_drag': unknown" in refused(capsys, "predict", out, path, "--out", tmp_path / "p.csv")
    code, _, _ = run(capsys, "predict", out, path, "--out", tmp_path / "p.csv", "--effects", own)
    assert code == 0


def test_what_diagnose_refuses(capsys, arm, recorded, tmp_path):
    out = tmp_path / "d.json"
    calibration = write_factory(LITE6.kinematics, tmp_path / "factory.yaml")
    assert refused(capsys, "diagnose", calibration, "--out", out) == (
        f"{calibration}: is a calibration; diagnose takes a recording (.csv, .parquet, .mcap)"
    )
    joints = write_recording(Recording.from_arrays(static_motion(1, 5)["joint_position"]), tmp_path / "joints.csv")
    said = refused(capsys, "diagnose", joints, "--out", out)
    assert said == f"{joints}: has no measured positions; a fit needs the columns x_m y_m z_m"
    assert "none.csv" in refused(capsys, "diagnose", tmp_path / "none.csv", "--out", out)
    said = refused(capsys, "diagnose", recorded, "--out", tmp_path / "d.txt")
    assert said == f"{tmp_path / 'd.txt'}: what is written here is json; let the name end in .json"
    assert not out.exists()


def test_diagnose_replaces_nothing_unasked(capsys, recorded, tmp_path):
    out = tmp_path / "d.json"
    out.write_text("mine")
    assert f"{out}: exists already" in refused(capsys, "diagnose", recorded, "--out", out)
    assert out.read_text() == "mine"


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


def test_predict_says_which_rows_are_empty(capsys, arm, tmp_path):
    from diagnosis.recorded import moving_motion

    motion = moving_motion(9, 30)
    content = document(arm, ["time_offset:offset_s=0.05"], "trajectory", orientation=False)
    model = tmp_path / "diagnosis.json"
    model.write_text(json.dumps(content))
    path = write_recording(
        Recording.from_arrays(
            motion["joint_position"], time=motion["time"], joint_velocity=motion["joint_velocity"], run=motion["run"]
        ),
        tmp_path / "motion.csv",
    )
    out = tmp_path / "predicted.csv"
    code, said, _ = run(capsys, "predict", model, path, "--out", out)
    assert code == 0
    assert "4 rows are empty: there, the clock offset reaches beyond the ends of the motion." in flat(said)
    lines = out.read_text().splitlines()
    assert lines[0] == "x_m,y_m,z_m"
    assert len(lines) == 31
    rows = [[float(value) for value in line.split(",")] for line in lines[1:]]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(rows).all(1)), [13, 14, 28, 29])


def test_what_predict_refuses(capsys, arm, diagnosed, motion_file, tmp_path):
    out = tmp_path / "p.csv"
    said = refused(capsys, "predict", diagnosed[0], motion_file, "--out", tmp_path / "p.json")
    assert said == f"{tmp_path / 'p.json'}: what is written here is csv; let the name end in .csv"
    assert "is no JSON (" in refused(capsys, "predict", motion_file, motion_file, "--out", out)
    assert "none.csv" in refused(capsys, "predict", diagnosed[0], tmp_path / "none.csv", "--out", out)
    drift = tmp_path / "drift.json"
    drift.write_text(json.dumps(document(arm, ["base_drift:vx_m_per_s=1e-6"])))
    said = refused(capsys, "predict", drift, motion_file, "--out", out)
    assert "base_drift" in said
    assert "needs the time" in said
    assert not out.exists()
