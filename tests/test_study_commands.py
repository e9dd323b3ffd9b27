"""`identify`, `sensitivity` and `design` as they are typed: what is printed, written and refused."""

import json
import re

import numpy as np
import pyarrow.csv
import pytest
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.design.identify import identify, identify_recording
from lite6jax.design.information import plan_experiment
from lite6jax.recordings import Recording, RecordingSettings, read_recording, write_recording
from tests.oracles.arms import random_positions
from tests.oracles.chains import six_parameter_poses

LITE6 = load_bundled("lite6")


@pytest.fixture
def measured(tmp_path):
    q = random_positions(np.random.default_rng(0), 50, 6)
    position = six_parameter_poses(LITE6.kinematics, q)[:, :3, 3]
    settings = RecordingSettings(arm="lite6", motion="static", pose_frame="unknown", tool="none", position_noise_m=3e-5)
    return write_recording(Recording.from_arrays(q, position=position, settings=settings), tmp_path / "run.csv")


# ------------------------------------------------------------------ identify


def test_identify_an_arm(capsys):
    code, said, err = run(capsys, "identify", "lite6", "--poses", 60, "--sensor", "tracker_6d", "--tool", "unknown")
    assert (code, err) == (0, "")
    text = flat(said)
    assert "lite6, 60 poses drawn inside the limits; a sensor of positions and orientations to ±0.02 mm and" in text
    assert "These poses determine 30 of 40 unknown parameters. Other poses inside its limits determine no more." in text
    assert "The sensor's frame does what base_x, base_y, base_roll, base_pitch, theta_off1 and d1 do." in text
    assert "The tool does what theta_off6, d6, a6 and alpha6 do." in text
    assert "The data do not distinguish these: a fit holds the first of each at nominal" in text
    assert "O1 O2 O3 O4 O5 condition" in text
    found = identify(plan_experiment("lite6", "tracker_6d", tool=True), poses=60)
    assert f"predicts the whole workspace to ±{1e3 * found.accuracy.position_rms:.4f} mm" in text
    assert f"{found.observability.condition:.4g}" in text


def test_identify_says_why_positions_tell_less(capsys):
    text = flat(run(capsys, "identify", "lite6")[1])
    assert "These poses determine 24 of 34 unknown parameters." in text
    assert "determine no more. The measured point lies on the last joint's axis (--tool-at)." in text
    assert "No reading changes with theta_off6 and alpha6." in text
    assert "a5 and theta_off5 move together: a5 +1 mm is undone by theta_off5 +0.932 deg." in text
    offset = flat(run(capsys, "identify", "lite6", "--tool-at", 60, 0, 40)[1])
    assert (
        "These poses determine 27 of 34 unknown parameters. Other poses inside its limits determine no more." in offset
    )


def test_identify_with_physics(capsys):
    arguments = ("--effect", "joint_compliance:joint=2", "--effect", "joint_offset:joint=3", "--frame", "known")
    text = flat(run(capsys, "identify", "lite6", *arguments)[1])
    assert "determine 25 of 30 unknown parameters" in text
    assert "joint_compliance:joint2:compliance_rad_per_Nm" in text
    assert "joint_offset:joint3:offset_rad and theta_off3 move together: joint_offset:joint3:offset_rad +1 deg" in text


def test_identify_a_recording(capsys, measured):
    code, said, err = run(capsys, "identify", measured)
    assert (code, err) == (0, "")
    text = flat(said)
    assert "lite6, 50 poses; a sensor of positions to ±0.03 mm per axis." in text
    assert "These poses determine 24 of 34 unknown parameters." in text


@pytest.mark.long
def test_identify_a_recording_with_physics(capsys, measured):
    text = flat(run(capsys, "identify", measured, "--effect", "joint_compliance:joint=2")[1])
    assert "These poses determine 25 of 35 unknown parameters." in text
    assert "leave out all options of a set-up but --effect" in refused(
        capsys, "identify", measured, "--sensor", "camera"
    )


def test_identify_takes_noise_that_is_not_declared_from_a_fit(capsys, tmp_path):
    rng = np.random.default_rng(0)
    q = random_positions(rng, 60, 6)
    position = six_parameter_poses(LITE6.kinematics, q)[:, :3, 3] + 4e-5 * rng.standard_normal((60, 3))
    settings = RecordingSettings(arm="lite6", motion="static", tool="none")
    path = write_recording(Recording.from_arrays(q, position=position, settings=settings), tmp_path / "run.csv")
    document = json.loads(run(capsys, "identify", path, "--json")[1])
    assert document["sensor"]["position_noise"] == pytest.approx(4e-5, rel=0.2)
    assert "does not declare the noise of all that is measured" in document["notes"][-1]


def test_identify_names_a_joint_that_hardly_moves(capsys, tmp_path):
    q = random_positions(np.random.default_rng(0), 30, 6)
    q[:, 3] = 0.3
    path = write_recording(Recording.from_arrays(q, arm="lite6"), tmp_path / "poses.csv")
    text = flat(run(capsys, "identify", path, "--sensor", "tracker_6d", "--frame", "known")[1])
    assert "Other poses of this arm determine 28: joint 4 moves over 0 deg only; move it further." in text


def test_identify_json(capsys, measured):
    code, said, _ = run(capsys, "identify", measured, "--json")
    assert code == 0
    document = json.loads(said)
    recording = read_recording(measured, dof=6)
    found = identify_recording(recording)
    assert document == json.loads(json.dumps(found.to_dict())) | {"written": []}
    assert document["schema"] == "lite6jax/identification/1"
    assert document["rank"] == 24
    assert len(document["parameters"]) == len(document["correlation"]) == len(document["singular_values"]) == 34
    assert document["sensor"] == {"quantity": "position", "position_noise": 3e-5, "joint_noise": 0.0}
    held = [p["name"] for p in document["parameters"] if p["std"] is None]
    assert held == [d["held"] for d in document["dependencies"]]


def test_identify_draws(capsys, tmp_path):
    code, said, _ = run(capsys, "identify", "ur5e", "--figures", tmp_path / "f", "--poses", 30)
    assert code == 0
    for suffix in (".png", ".svg"):
        path = tmp_path / "f" / f"ur5e_deviations{suffix}"
        assert path.stat().st_size > 5_000
        assert f"Wrote {path}" in said
    assert "exists already" in refused(capsys, "identify", "ur5e", "--figures", tmp_path / "f")


def test_identify_an_arm_of_seven_joints_on_a_narrow_screen(capsys):
    code, said, _ = run(capsys, "identify", "xarm7", "--sensor", "tracker_6d", "--poses", 40, width=60)
    assert code == 0
    assert max(map(len, said.splitlines())) <= 60
    assert "These poses determine 32 of 38" in flat(said)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("lite7",), "neither a bundled arm nor a file"),
        (("lite6", "--poses", "0"), "--poses 0: give at least 1"),
        (("lite6", "--position-noise", "0"), "position noise 0.0: give one standard deviation in m, above 0"),
        (("lite6", "--orientation-noise", "0.1"), "a sensor of position measures no orientation; leave it out"),
        (("lite6", "--sensor", "dial_gauge", "--axis", "0", "0", "0"), "give three numbers that are not all zero"),
        (("lite6", "--effect", "gremlins:joint=2"), "effect 'gremlins': unknown; the catalogue has joint_offset"),
        (("lite6", "--effect", "joint_lag:joint=2"), "joint_lag:joint2: needs the velocity of joint 2"),
        (
            ("lite6", "--effect", "joint_compliance:joint=9"),
            "joint_compliance:joint9: acts at joint 9, but the arm has 6",
        ),
        (("ur10", "--effect", "link_compliance:link=2"), "needs the frames of links; add --chain six_parameter"),
        (("missing.csv",), "missing.csv"),
        (("lite6", "--seed", "-1"), "--seed -1: give 0 or more"),
        (("lite6", "--tool-at", "nan", "0", "0"), "--tool-at nan 0.0 0.0: give three finite numbers"),
        (("lite6", "--payload", "-1"), "--payload -1.0: give a mass in kg, not below 0"),
        (("lite6", "--geometry", "free"), "lite6: is an arm; --geometry and --arm are for recordings, leave them out"),
    ],
)
def test_what_identify_refuses(capsys, arguments, says):
    assert says in refused(capsys, "identify", *arguments)


# ------------------------------------------------------------------ sensitivity


def test_sensitivity(capsys, tmp_path):
    code, said, err = run(capsys, "sensitivity", "lite6", "--figures", tmp_path)
    assert (code, err) == (0, "")
    text = flat(said)
    assert "Arms made to ±0.8 mm and ±0.15 deg in each number, one standard deviation." in text
    assert "The flange stands 4.0 mm (RMS) from nominal over the workspace" in text
    assert "joint2_pitch 6.3" in text
    for what in ("sensitivity_by_joint", "sensitivity_workspace"):
        assert (tmp_path / f"lite6_{what}.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--length", "-1"), "--length -1.0: give one standard deviation, not below 0"),
        (("--length", "0", "--angle", "0"), "not both 0"),
    ],
)
def test_what_sensitivity_refuses(capsys, arguments, says):
    assert says in refused(capsys, "sensitivity", "lite6", *arguments)


# ------------------------------------------------------------------ design

SMALL = ("--candidates", "200", "--poses", "14", "--sensor", "tracker_6d")


def test_design(capsys, tmp_path):
    out = tmp_path / "poses.csv"
    code, said, err = run(capsys, "design", "lite6", *SMALL, "--out", out, "--accuracy", 0.02, "--figures", tmp_path)
    assert (code, err) == (0, "")
    text = flat(said)
    assert "14 poses of 200 candidates" in text
    assert "These poses let the fit predict positions to ±" in text
    assert "They are worth " in text
    more = int(re.search(r"±0\.0200 mm takes (\d+) poses; give --poses \1\.", text)[1])
    assert 14 < more < 40
    assert "28 combinations of 34 unknown parameters are identifiable" in text
    assert f"Wrote {out}" in said.replace("\n", "") or f"Wrote {out}\n" in said
    table = pyarrow.csv.read_csv(out)
    assert table.column_names == [f"q{i}_rad" for i in range(1, 7)]
    q = read_recording(out, dof=6).joint_position
    assert q.shape == (14, 6)
    margin = np.deg2rad(2.0)
    assert (q >= LITE6.joint_limits[:, 0] + margin - 1e-12).all()
    assert (q <= LITE6.joint_limits[:, 1] - margin + 1e-12).all()
    assert (tmp_path / "poses_accuracy.png").stat().st_size > 10_000
    # what it promises is what `identify` finds of the file
    document = json.loads(run(capsys, "identify", out, "--sensor", "tracker_6d", "--json")[1])
    promised = float(text.split("predict positions to ±")[1].split(" mm")[0])
    assert document["rank"] == 28
    assert 1e3 * document["predicted_accuracy"]["position_rms_m"] == pytest.approx(promised, abs=6e-5)


def test_design_keeps_to_what_is_asked(capsys, tmp_path):
    out = tmp_path / "poses.parquet"
    rule = tmp_path / "mine.py"
    rule.write_text("def front(q):\n    return abs(q[:, 0]) < 1.5\n")
    box = ("--box", "-100", "-500", "100", "600", "500", "900")
    code, said, _ = run(
        capsys, "design", "lite6", *SMALL, "--out", out, *box, "--floor", 50, "--filter", f"{rule}:front"
    )
    assert code == 0
    assert "box refused" in flat(said)
    q = read_recording(out, dof=6).joint_position
    assert (np.abs(q[:, 0]) < 1.5).all()
    p = six_parameter_poses(LITE6.kinematics, q)[:, :3, 3]
    assert (p > np.array([-0.1, -0.5, 0.1])).all()
    assert (p < np.array([0.6, 0.5, 0.9])).all()


def test_design_with_what_is_recorded(capsys, tmp_path, measured):
    out = tmp_path / "more.csv"
    arguments = ("--candidates", "300", "--poses", "5", "--recorded", measured)
    text = flat(run(capsys, "design", "lite6", *arguments, "--out", out)[1])
    assert "5 poses of 300 candidates" in text


@pytest.mark.long
def test_design_discriminates_between_two_effects(capsys, tmp_path):
    effects = (
        "--discriminate",
        "joint_compliance:joint=2,compliance_rad_per_Nm=5e-5",
        "joint_harmonic:joint=2,order=1",
    )
    out = tmp_path / "poses.csv"
    code, said, _ = run(capsys, "design", "lite6", *SMALL, *effects, "--out", out, "--figures", tmp_path)
    assert code == 0
    text = flat(said)
    assert re.search(
        r"If joint_compliance:joint2 has the size given, the readings at these poses are [\d.]+ standard deviations"
        r" from the closest that joint_harmonic:joint2 explains with all other unknowns refitted;",
        text,
    )
    assert (tmp_path / "poses_accuracy.svg").exists()


def test_design_of_an_arm_from_a_file(capsys, tmp_path):
    """The sidecar leads back to the arm from where the poses are."""
    from lite6jax.arms.files import write_arm

    (tmp_path / "arms").mkdir()
    (tmp_path / "runs").mkdir()
    arm = write_arm(load_bundled("ur5e"), tmp_path / "arms" / "mine.yaml")
    out = tmp_path / "runs" / "poses.csv"
    assert run(capsys, "design", arm, *SMALL, "--out", out)[0] == 0
    assert "arm: ../arms/mine.yaml" in out.with_suffix(".yaml").read_text()
    assert "14 poses" in flat(run(capsys, "identify", out)[1])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--poses", "2", "--candidates", "300"), "2 poses: too few for the"),
        (("--poses", "40", "--candidates", "30"), "40 poses out of 30 candidates"),
        (("--accuracy", "0"), "--accuracy 0.0: give a standard deviation in mm, above 0"),
        (("--box", "0", "0", "0", "0", "1", "1"), "empty; give the least x, y, z, then the greatest"),
        (("--box", "5000", "0", "0", "6000", "10", "10"), "box refused 100 % of them; widen it"),
        (("--filter", "nothing.py:f"), "nothing.py: no such file; a filter is FILE.py:function"),
        (("--limit-margin", "900"), "leaves joint1 no room; give a smaller one"),
        (("--discriminate", "joint_compliance:joint=2", "joint_harmonic:joint=2,order=1"), "no parameter is given"),
        (("--seed", "-3"), "--seed -3: give 0 or more"),
        (("--floor", "nan"), "--floor nan: give a height in mm"),
        (
            ("--discriminate", "joint_scale:joint=2,scale=1e-4", "joint_offset:joint=2", "--criterion", "D"),
            "--discriminate: chooses by the distance between two effects; leave --criterion and --accuracy out",
        ),
    ],
)
def test_what_design_refuses(capsys, tmp_path, arguments, says):
    assert says in refused(capsys, "design", "lite6", *arguments, "--out", tmp_path / "poses.csv")
    assert not (tmp_path / "poses.csv").exists()


def test_design_replaces_nothing_unasked(capsys, tmp_path):
    for name in ("poses.csv", "poses.yaml"):
        (tmp_path / name).write_text("mine")
        assert f"{tmp_path / name}: exists already" in refused(
            capsys, "design", "lite6", "--out", tmp_path / "poses.csv"
        )
        assert (tmp_path / name).read_text() == "mine"
        (tmp_path / name).unlink()
