"""At the joint positions of a compensation, the independent generator's arm reaches the targets; the rest is said."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.csv
import pytest
from diagnosis.recorded import LITE6, Made, moving_motion, quaternions, static_motion
from domains.pose.documents import document, stored
from typed import flat, refusal, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.diagnosis.document import model_from_document, read_model
from lite6jax.domains.pose.compensate import Reason, compensate, read_pose_targets
from lite6jax.domains.predict import predict
from lite6jax.domains.uncertainty import RecordedRange, Uncertainty
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict
from lite6jax.recordings import Recording, RecordingSettings, Targets, read_targets, write_recording
from lite6jax.report.compensations import compensation_report, reason_text
from tests.oracles.chains import six_parameter_poses

SAMPLES = 40
STATIC = (
    "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",
    "joint_harmonic:joint=4,order=63.3,amplitude_rad=5e-4,phase_rad=3",
    "joint_backlash:joint=4,gap_rad=1.2e-3",
    "link_thermal_expansion:expansion_per_K=2.3e-5",
    "measurement_scale:scale=4e-4",
    "base_drift:vx_m_per_s=1e-6,vy_m_per_s=-2e-6,vz_m_per_s=1e-6",
)
MOVING = ("joint_lag:joint=2,lag_s=2e-3", "time_offset:offset_s=0.006")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), STATIC, seed=1, frame=True, tool=True)


@pytest.fixture(scope="module")
def diagnosis(arm, tmp_path_factory):
    return stored(tmp_path_factory.mktemp("diagnosis"), document(arm, STATIC))


@pytest.fixture(scope="module")
def motion():
    return static_motion(3, SAMPLES)


@pytest.fixture(scope="module")
def poses(arm, motion):
    return arm.poses(motion)


def wanted(motion, poses, turned=True, **given):
    """Targets without joints that are to be shown in a motion's circumstances."""
    circumstances = {
        "time": motion["time"],
        "joint_temperature": motion["joint_temperature"],
        "payload": motion["payload"],
        "settings": RecordingSettings(motion="static"),
    }
    return Recording.assembled(
        motion["joint_position"],
        position=poses[:, :3, 3],
        quaternion=quaternions(poses) if turned else None,
        **(circumstances | given),
    )


def solved(path, recording, start=None, **options):
    return compensate(read_model(path), Targets(recording, start), **options)


def shown(arm, motion, q, direction=None):
    """What the plain arm shows where it goes through joints in a motion's circumstances."""
    if direction is None:
        direction = np.sign(np.diff(q, axis=0, prepend=0.0))
    return arm.poses({**motion, "joint_position": q, "direction": np.broadcast_to(direction, q.shape)})


def near(motion, size=0.01):
    """Joints as a nominal inverse kinematics would give them."""
    return motion["joint_position"] + size * np.random.default_rng(1).standard_normal((SAMPLES, 6))


def page(found, path, frame="sensor"):
    """The lines of the report."""
    parts = compensation_report(found, read_model(path), "targets.csv", frame)
    return [str(getattr(part, "renderable", part)) for part in parts]


def inside(q):
    return ((q >= LITE6.joint_limits[:, 0]) & (q <= LITE6.joint_limits[:, 1])).all()


# ------------------------------------------------------------------ what is reached


def test_the_plain_arm_shows_the_targets_on_the_branch_of_the_joints_given(arm, diagnosis, motion, poses):
    found = solved(diagnosis, wanted(motion, poses), near(motion))
    assert found.reached.all()
    assert set(found.reason) == {None}
    q = found.joint_position
    np.testing.assert_allclose(shown(arm, motion, q), poses, atol=1e-9)
    np.testing.assert_allclose(q, motion["joint_position"], atol=1e-6)
    np.testing.assert_allclose(found.correction, q - near(motion), atol=0)
    assert inside(q)
    assert found.position_error.max() < 1e-9
    assert found.orientation_error.max() < 1e-9


@pytest.mark.long
def test_without_joints_a_way_through_solutions_inside_the_limits_is_found(arm, diagnosis, motion, poses):
    found = solved(diagnosis, wanted(motion, poses))
    q, reached = found.joint_position, found.reached
    assert reached.mean() > 0.95
    np.testing.assert_allclose(shown(arm, motion, q)[reached], poses[reached], atol=1e-9)
    assert inside(q)
    assert found.correction is None
    # the way moves less than that through the joints of which the targets were made, drawn at random
    assert np.sum(np.diff(q, axis=0) ** 2) < 0.8 * np.sum(np.diff(motion["joint_position"], axis=0) ** 2)


def test_an_approach_from_one_side_holds_for_every_row(arm, diagnosis, motion, poses):
    for side in (-1, 1):
        found = solved(diagnosis, wanted(motion, poses), near(motion), approach=(side,) * 6)
        assert found.reached.all()
        np.testing.assert_allclose(shown(arm, motion, found.joint_position, side), poses, atol=1e-9)


def test_targets_in_the_arms_base_concern_no_sensor(arm, diagnosis, motion):
    made = replace(arm, effects=STATIC[:4], frame=False)
    poses = made.poses(motion)
    asked = wanted(motion, poses, time=None)
    found = solved(diagnosis, asked, near(motion), frame="base")
    assert found.reached.all()
    np.testing.assert_allclose(shown(made, motion, found.joint_position), poses, atol=1e-9)
    assert found.omitted == ("measurement_scale:sensor", "base_drift:base")
    assert (
        "Note: omitted: measurement_scale:sensor and base_drift:base, which concern the sensor and not the arm's "
        "position."
    ) in page(found, diagnosis, "base")


def test_an_arm_of_seven_joints(tmp_path):
    arm, rng = load_bundled("xarm7"), np.random.default_rng(4)
    lower, upper = np.clip(arm.joint_limits, -2.5, 2.5).T
    q = rng.uniform(lower, upper, (20, 7))
    content = document(Made(tmp_path, seed=1), [])
    content["model"] |= {
        "kinematics": arm.kinematics.tolist(),
        "joint_limits": arm.joint_limits.tolist(),
        "inertia": None,
        **{name: np.eye(4).tolist() for name in ("T_sensor_base", "T_flange_tool")},
    }
    poses = six_parameter_poses(arm.kinematics, q)
    asked = Recording.from_arrays(q, position=poses[:, :3, 3], quaternion=quaternions(poses))
    found = solved(stored(tmp_path, content), asked, q + 0.01 * rng.standard_normal(q.shape))
    assert found.reached.all()
    np.testing.assert_allclose(six_parameter_poses(arm.kinematics, found.joint_position), poses, atol=1e-9)
    assert ((found.joint_position >= arm.joint_limits[:, 0]) & (found.joint_position <= arm.joint_limits[:, 1])).all()


def test_a_moving_arm_lags_and_its_clock_is_left_out(tmp_path):
    made = Made(tmp_path, MOVING[:1], seed=1)
    motion = moving_motion(3, SAMPLES)
    poses = made.poses(motion)
    path = stored(tmp_path, document(made, MOVING, motion="trajectory"))
    recording = Recording.from_arrays(
        motion["joint_position"],
        position=poses[:, :3, 3],
        quaternion=quaternions(poses),
        time=motion["time"],
        run=motion["run"],
        joint_velocity=motion["joint_velocity"],
        settings=RecordingSettings(motion="trajectory"),
    )
    found = solved(path, recording, near(motion))
    assert found.reached.all()
    np.testing.assert_allclose(made.poses({**motion, "joint_position": found.joint_position}), poses, atol=1e-9)
    assert found.omitted == ("time_offset:clock",)
    assert any("omitted: time_offset:clock, which concerns the sensor" in line for line in page(found, path))
    # velocities that are not recorded are those of the joints found, as `predict` has them
    given = replace(recording, joint_velocity=None, velocity_differentiated=True)
    derived = solved(path, given, near(motion))
    assert derived.reached.all()
    velocity = derived.recording.joint_velocity
    assert derived.recording.velocity_differentiated
    again = made.poses({**motion, "joint_position": derived.joint_position, "joint_velocity": velocity})
    np.testing.assert_allclose(again, poses, atol=1e-9)


def test_arrays_serve_as_targets(arm, diagnosis, motion, poses):
    """As the recording of them does: poses and positions, with joint positions to start from and circumstances."""
    given = {name: motion[name] for name in ("time", "joint_temperature", "payload")}
    model, start = read_model(diagnosis), near(motion)
    found = compensate(model, poses, start=start, **given)
    np.testing.assert_allclose(
        found.joint_position, solved(diagnosis, wanted(motion, poses), start).joint_position, rtol=0, atol=1e-9
    )
    positions = compensate(model, poses[:, :3, 3], start=start, **given)
    assert positions.reached.all()
    assert positions.orientation_error is None


def test_arrays_that_are_no_targets(diagnosis, motion, poses):
    model = read_model(diagnosis)
    assert refusal(compensate, model, poses[:, :3]) == (
        f"compensate: targets have the shape ({SAMPLES}, 3, 4); give (row, 4, 4), or (row, 3) positions in m"
    )
    said = refusal(lambda: compensate(model, poses, start=np.zeros((SAMPLES, 5))))
    assert said == f"compensate: start has the shape ({SAMPLES}, 5); give ({SAMPLES}, 6) in rad"
    said = refusal(lambda: compensate(model, poses, start=np.rad2deg(near(motion))))
    assert said.endswith("are these degrees? give radians: np.deg2rad(joint_position)")
    said = refusal(lambda: compensate(model, Targets(wanted(motion, poses), None), payload=np.zeros(SAMPLES)))
    assert said == "compensate: these targets have their own joint positions; give the poses as an array"


# ------------------------------------------------------------------ what is not


def test_what_is_out_of_reach_is_reported_row_by_row(arm, diagnosis, motion, poses):
    far, spoiled = poses.copy(), wanted(motion, poses)
    away = far[5, :3, 3] - arm.T_sensor_base[:3, 3]
    far[5, :3, 3] += 2 * away / np.linalg.norm(away)
    spoiled = wanted(motion, far)
    spoiled.position[7, 1] = np.nan
    found = solved(diagnosis, spoiled, near(motion))
    others = ~np.isin(np.arange(SAMPLES), (5, 7))
    assert (found.reason[5], found.reason[7]) == (Reason("out_of_reach"), Reason("empty_field"))
    np.testing.assert_array_equal(found.reached, others)
    assert 1.0 < found.position_error[5] < 2.5
    assert np.isnan(found.joint_position[7]).all()
    assert np.isnan(found.position_error[7])
    assert inside(found.joint_position[others])
    np.testing.assert_allclose(found.joint_position[others], motion["joint_position"][others], atol=1e-6)
    said = page(found, diagnosis)
    assert "an empty field: row 8" in said
    assert any(line.startswith("out of reach: row 6, with errors up to ") and line.endswith(" deg") for line in said)


@pytest.mark.long
def test_a_joint_at_its_limit_is_named(arm, diagnosis, motion, poses, tmp_path):
    content = json.loads(diagnosis.read_text())
    row = int(np.argmax(motion["joint_position"][:, 2]))
    at = motion["joint_position"][row]
    narrow = np.stack([at - 0.3, at + 0.3], 1)
    narrow[2, 1] = at[2] - 0.05
    content["model"]["joint_limits"] = narrow.tolist()
    found = solved(stored(tmp_path, content), wanted(motion, poses), near(motion))
    assert not found.reached[row]
    reason = found.reason[row]
    assert (reason.code, dict(zip(reason.joints, reason.angles, strict=True))[3]) == ("at_limit", narrow[2, 1])
    assert f"joint 3 at its limit of {np.rad2deg(narrow[2, 1]):.4g} deg" in reason_text(reason)
    assert found.joint_position[row, 2] == narrow[2, 1]
    assert found.position_error[row] > 1e-4
    assert (found.joint_position <= narrow[:, 1]).all()
    assert (found.joint_position >= narrow[:, 0]).all()


def test_joints_far_from_those_given_are_reported(diagnosis, motion, poses):
    start = near(motion)
    start[4, 0] += 1.5
    found = solved(diagnosis, wanted(motion, poses), start)
    assert found.reached.all()
    reason = found.reason[4]
    assert reason.code == "far_from_start"
    assert reason.angles == (found.correction[4, reason.joints[0] - 1],)
    assert reason_text(reason).endswith("deg from where it was given")


def test_an_approach_that_reverses_is_reported(arm, diagnosis, motion, poses):
    """A target within the gap of the one before: from the one side it lies on the other."""
    direction = np.sign(np.diff(motion["joint_position"], axis=0, prepend=0.0))
    q, side = motion["joint_position"].copy(), direction.copy()
    q[9] = q[8]
    q[9, 3] -= 1e-4 * side[8, 3]
    side[9] = side[8]
    wide = with_gap(diagnosis, -1.2e-3)
    poses = replace(arm, effects=tuple(t.replace("gap_rad=", "gap_rad=-") for t in STATIC)).poses(
        {**motion, "joint_position": q, "direction": side}
    )
    found = solved(wide, wanted(motion, poses), q)
    assert found.reason[9] == Reason("reverses")
    assert reason_text(found.reason[9]) == "the direction of approach reverses; approach it from one side"
    assert not found.reached[9]
    assert 1e-6 < found.position_error[9] < 2e-3


def test_errors_are_those_of_the_whole_motion_where_an_effect_has_memory(arm):
    """Joint positions are searched row by row; where that is not enough, the rows are not said to be reached."""
    play = Unnamed("joint2", "position of joint 2", -3.0, 3.0, "play")
    content = document(arm, [])
    content["model"]["effects"] = [effect_as_dict(play, [0, 3e-3, 0, 6e-3, 0, 0, 0, 0, 0])]
    model, motion = model_from_document(content), static_motion(3, SAMPLES)
    wanted = predict(model, motion["joint_position"])
    found = compensate(model, wanted, start=motion["joint_position"])
    shown = predict(model, found.recording)
    np.testing.assert_allclose(found.position_error, np.linalg.norm((shown - wanted)[:, :3, 3], axis=1), atol=1e-12)
    np.testing.assert_allclose(shown[found.reached], wanted[found.reached], rtol=0, atol=1e-5)
    assert 0 < found.reached.sum() < SAMPLES
    assert {reason for reason, ok in zip(found.reason, found.reached, strict=True) if not ok} == {Reason("reverses")}


def with_gap(diagnosis, gap):
    content = json.loads(diagnosis.read_text())
    (backlash,) = (e for e in content["model"]["effects"] if e["effect"] == "joint_backlash")
    backlash["parameters"]["gap_rad"]["value"] = gap
    return stored(diagnosis.parent, content, "wide.json")


# ------------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("targets", "options", "says"),
    [
        ({"payload": np.full(SAMPLES, np.nan)}, {}, "recording: every row has an empty field; fill one row at least"),
        ({}, {"approach": (1, 1)}, "approach: give -1, 0 or 1 for each of the 6 joints"),
        ({}, {"approach": (2,) * 6}, "approach: give -1, 0 or 1 for each of the 6 joints"),
    ],
)
def test_what_is_no_task(diagnosis, motion, poses, targets, options, says):
    assert refusal(lambda: solved(diagnosis, wanted(motion, poses, **targets), **options)) == says


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad\n0,0,0,0,0,0\n", "has no positions to reach; name their columns"),
        ("x_m,y_m,z_m\n,0,0\n", "columns x_m y_m z_m: no row holds a whole position; fill them"),
        ("x_m,y_m,z_m\n300,0,0\n0,400,0\n-300,0,9\n", "the positions lie 300"),
        ("x_m,y_m,z_m,q1_rad\n0,0,0,1\n", "has 1 joints (q1 ... q1), the arm has 6"),
        ("x_m,y_m,z_m," + ",".join(f"q{i}_rad" for i in range(1, 7)) + "\n0,0,0,90,9,9,9,9,9\n", "is at 90 rad"),
    ],
)
def test_files_that_are_no_targets(tmp_path, content, says):
    path = tmp_path / "targets.csv"
    path.write_text(content)
    said = refusal(read_targets, path, 6, LITE6.joint_limits, 0.7)
    assert said.startswith(f"{path}: ")
    assert says in said


def test_targets_of_another_kind_of_file(tmp_path):
    log = tmp_path / "targets.mcap"
    log.touch()
    for read in (lambda path: read_targets(path, 6), lambda path: read_pose_targets(path, None)):
        assert refusal(read, log) == f"{log}: targets end in .csv or .parquet; convert it or correct the name"
    assert refusal(read_targets, tmp_path / "none.csv", 6).endswith("no such file; check the name")


# ------------------------------------------------------------------ as it is typed


FEW = 8
"""Targets of a file."""


@pytest.fixture
def targets(motion, poses, tmp_path):
    """A file of targets with joints in degrees."""
    return written(wanted(motion, poses), tmp_path)


def written(recording, folder):
    path = write_recording(recording.select(np.arange(FEW)), folder / "targets.csv")
    path.with_suffix(".yaml").unlink()
    text = path.read_text().split("\n")
    head = text[0].split(",")
    rows = [dict(zip(head, line.split(","), strict=True)) for line in text[1:] if line]
    for row in rows:
        row |= {f"q{i}_deg": f"{np.rad2deg(float(row.pop(f'q{i}_rad'))):.3f}" for i in range(1, 7)}
    path.write_text("\n".join([",".join(rows[0]), *(",".join(row.values()) for row in rows)]) + "\n")
    return path


def test_what_is_written_is_a_motion_that_predicts_the_targets(capsys, diagnosis, motion, poses, tmp_path):
    asked, out = wanted(motion, poses.copy()), tmp_path / "joints.csv"
    asked.position[FEW - 1, 1] = np.nan
    targets = written(asked, tmp_path)
    code, said, err = run(capsys, "compensate", diagnosis, targets, "--out", out)
    assert (code, err) == (1, "")
    text = flat(said)
    assert "8 targets (positions and orientations in the sensor's frame) for a lite6 with 6 effects beyond" in text
    assert "7 targets reached, 1 target not: an empty field: row 8" in text
    assert "correction of the joints (deg) q1" in text
    assert f"Wrote {out}" in said.replace("\n", "")
    table = pyarrow.csv.read_csv(out).to_pydict()
    assert table["ok"] == [1] * 7 + [0]
    assert table["reason"] == [""] * 7 + ["an empty field"]
    assert max(table["position_error_mm"][:-1]) < 1e-6
    assert set(table) >= {"payload_kg", "time_s", "temp1_degC", "orientation_error_deg"}
    assert not out.with_suffix(".yaml").exists()
    code, _, _ = run(capsys, "predict", diagnosis, out, "--out", tmp_path / "p.csv")
    assert code == 0
    shown = pyarrow.csv.read_csv(tmp_path / "p.csv").to_pydict()
    position = np.column_stack([shown[name] for name in ("x_m", "y_m", "z_m")])
    np.testing.assert_allclose(position[: FEW - 1], poses[: FEW - 1, :3, 3], atol=1e-9)


def test_positions_under_names_of_their_own_are_read_in_the_unit_that_the_arm_reaches(
    capsys, diagnosis, targets, tmp_path
):
    head, *rows = (line.split(",") for line in targets.read_text().strip().split("\n"))
    at = [head.index(name) for name in ("x_m", "y_m", "z_m")]
    lines = [[f"{1e3 * float(v)!r}" if k in at else v for k, v in enumerate(row)] for row in rows]
    own, out = tmp_path / "own.csv", tmp_path / "joints.csv"
    run(capsys, "compensate", diagnosis, targets, "--out", out)
    expected = pyarrow.csv.read_csv(out).to_pandas().filter(regex="^q")
    told = ["--column", "u=x_mm", "--column", "v=y_mm", "--column", "w=z_mm"]
    for names, options in (("XYZ", []), ("uvw", told)):
        named = [names[at.index(k)] if k in at else name for k, name in enumerate(head)]
        own.write_text("\n".join(",".join(line) for line in (named, *lines)) + "\n")
        if options:  # what the message says is what helps
            said = refused(capsys, "compensate", diagnosis, own, "--out", out, "--force")
            assert "say which they are: --column NAME=x_mm, and likewise y_mm and z_mm" in said
        code, said, err = run(capsys, "compensate", diagnosis, own, *options, "--out", out, "--force")
        assert code == 0, err
        assert options or "columns are read as X=x_mm, Y=y_mm, Z=z_mm" in flat(said)
        joints = pyarrow.csv.read_csv(out).to_pandas().filter(regex="^q")
        np.testing.assert_allclose(joints, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("X,Y,Z\n1e-7,0,0\n", "whether X, Y, Z are in m or mm is not certain; say it: --column X=x_mm (or x_m)"),
        ("q1_rad\n0\n", "no columns look like positions to reach; say which they are: --column NAME=x_mm"),
    ],
)
def test_what_no_column_says_is_asked(capsys, diagnosis, tmp_path, content, says):
    path = tmp_path / "t.csv"
    path.write_text(content)
    assert says in refused(capsys, "compensate", diagnosis, path, "--out", tmp_path / "joints.csv")


def test_a_sidecar_of_the_targets_goes_with_the_joints(capsys, diagnosis, targets, tmp_path):
    targets.with_suffix(".yaml").write_text("recording: {motion: static, reference_temperature_degC: 20}\n")
    out = tmp_path / "joints.csv"
    code, _, _ = run(capsys, "compensate", diagnosis, targets, "--approach", "-1", "--out", out)
    assert code == 0
    assert "reference_temperature_degC: 20" in out.with_suffix(".yaml").read_text()
    assert refused(capsys, "compensate", diagnosis, targets, "--out", out).endswith("add --force to replace it")
    targets.with_suffix(".yaml").unlink()
    said = refused(capsys, "compensate", diagnosis, targets, "--out", out, "--force")
    assert "joints.yaml: would be read as the settings of joints.csv, but belongs to another file; choose" in said


def test_of_several_solutions_one_inside_what_was_recorded_is_taken(arm):
    """Recorded with the arm stretched out to one side: it would reach the same poses turned round, too."""
    model = model_from_document(document(arm, ()))
    rng = np.random.default_rng(2)
    middle = np.array([2.4, 0.6, 1.2, 2.2, -0.9, -2.0])
    q = middle + rng.uniform(-0.3, 0.3, (4, 6))
    box = np.stack([middle - 0.35, middle + 0.35], 1)
    recorded = RecordedRange(box, q, 0.0, {})
    known = Uncertainty((), np.zeros((0, 0)), (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), recorded)
    found = compensate(replace(model, uncertainty=known), predict(model, q))
    assert found.reached.all()
    np.testing.assert_allclose(found.joint_position, q, rtol=0, atol=1e-6)
    assert not found.outside.any()
    anywhere = compensate(model, predict(model, q))
    assert anywhere.reached.all()
    assert np.abs(anywhere.joint_position - q).max() > 1  # the range decides
