"""A recording and its reference: their differences in codes and sentences, and what is diagnosed beyond them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from diagnosis.recorded import (
    LITE6,
    Made,
    moving_motion,
    quaternions,
    static_motion,
    truth,
    with_effects,
)
from scipy.spatial.transform import Rotation
from typed import flat, refusal, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.diagnosis import diagnose
from lite6jax.diagnosis.options import Options
from lite6jax.domains.pose.reference import SAME_JOINTS, compare
from lite6jax.recordings import Recording, write_recording
from lite6jax.report import statements
from tests.oracles.chains import six_parameter_poses

SAMPLES = 160
COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"
HARMONIC = "joint_harmonic:joint=4,order=1,amplitude_rad=5e-4,phase_rad=1"
BENT = "frame_offset:link=3,x_m=3e-4,y_m=-5e-4,z_m=4e-4,rx_rad=1e-3,ry_rad=-2e-3,rz_rad=5e-4"
WARMTH = "link_thermal_expansion:expansion_per_K=2.3e-5"
STILL = static_motion(1, SAMPLES)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("sides")


@pytest.fixture(scope="module")
def arm(folder):
    """An arm with its factory calibration, measured in its base."""
    return Made(folder, (COMPLIANCE,), seed=1)


def simulator(poses, motion=STILL, settings=None, orientation=True, source="gazebo.csv"):
    """What another simulator says of the same joints: no noise and, mostly, no sidecar."""
    return Recording.from_arrays(
        motion["joint_position"],
        position=poses[:, :3, 3],
        quaternion=quaternions(poses) if orientation else None,
        settings=settings,
        source=source,
    )


def rigid(kinematics):
    return six_parameter_poses(kinematics, STILL["joint_position"])


def placed(x=0.0, y=0.0, z=0.0, turned=(0.0, 0.0, 0.0)):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(turned).as_matrix(), (x, y, z)
    return T


def poses_of(recording):
    T = np.tile(np.eye(4), (recording.samples, 1, 1))
    T[:, :3, :3] = Rotation.from_quat(np.roll(recording.quaternion, -1, axis=1)).as_matrix()
    T[:, :3, 3] = recording.position
    return T


def codes(compared):
    return [entry["difference"] for entry in compared.differences]


def differences(compared):
    """The sentences."""
    return [entry["statement"] for entry in statements.with_comparison(compared.to_dict())["differences"]]


def notes(compared):
    """The sentences."""
    return [entry["statement"] for entry in statements.with_comparison(compared.to_dict())["notes"]]


def diagnose_against(recording, other, *arguments):
    """With two folds: what is held out is tested elsewhere."""
    found = diagnose.diagnose_poses(recording, *arguments, reference=other, options=Options(folds=2))
    return found, found.against


def check_finding(diagnosis, text):
    """One finding, each of whose parameters is within four small standard deviations of the truth."""
    effect, wanted = truth(text)
    (finding,) = diagnosis.findings
    assert (finding.effect.name, finding.effect.site) == (effect.name, effect.site)
    assert set(finding.parameters) == set(wanted)
    size = max(abs(value) for value in wanted.values())
    for name, (value, std) in finding.parameters.items():
        assert abs(value - wanted[name]) <= 4 * std, name
        assert std < 0.1 * size, name


# ------------------------------------------------------------------ what the other side is


def test_a_simulator_of_the_same_calibration_is_reproduced(arm):
    recording = arm.recording(STILL)
    seen = compare(recording, simulator(rigid(arm.kinematics)))
    assert (seen.reproduced, seen.rigid, seen.differences, seen.notes) == (True, True, (), ())
    assert seen.distance.max() < 1e-12
    assert (seen.geometry, seen.factory) == ("declared", None)
    np.testing.assert_allclose(seen.recording.position, recording.position, rtol=0, atol=1e-12)
    assert seen.recording.settings == recording.settings


@pytest.mark.parametrize(
    ("name", "kind", "called"),
    [
        ("lite6", "published_table", "the published table (lite6)"),
        ("lite6_ros", "ros_default_table", "the vendor's ROS default table (lite6_ros)"),
    ],
)
def test_another_table_is_named(arm, name, kind, called):
    """The difference that has a name is no difference to diagnose: the poses stay."""
    recording = arm.recording(STILL)
    seen = compare(recording, simulator(rigid(load_bundled(name).kinematics)))
    off = np.linalg.norm(rigid(load_bundled(name).kinematics)[:, :3, 3] - rigid(arm.kinematics)[:, :3, 3], axis=1)
    assert not seen.reproduced
    np.testing.assert_allclose(seen.distance, off, rtol=0, atol=1e-12)
    (difference,) = seen.differences
    assert (difference["difference"], difference["reference"]) == ("other_table", {"kind": kind, "name": name})
    assert difference["model"] == {"kind": "factory_calibration", "name": "factory_exact_1.yaml"}
    assert difference["position_rms_before_m"] == pytest.approx(np.sqrt(np.mean(off**2)))
    assert difference["position_rms_after_m"] < 1e-12
    assert differences(seen) == [
        f"gazebo.csv uses {called}; this model uses the factory calibration (factory_exact_1.yaml). This reduces the "
        f"position error from {1e3 * np.sqrt(np.mean(off**2)):.3g} mm to 0 mm RMS."
    ]
    np.testing.assert_allclose(seen.recording.position, recording.position, rtol=0, atol=1e-12)


def test_a_calibration_that_the_other_side_declares_is_named(arm):
    """The same arm before it was calibrated anew; its file stands beside the other recording."""
    earlier = replace(arm, effects=(), seed=4)
    seen = compare(arm.recording(STILL), earlier.recording(STILL, seed=9))
    assert differences(seen)[0].startswith(
        "run.csv uses its own factory calibration (factory_exact_4.yaml); this model uses the factory calibration "
        "(factory_exact_1.yaml). This reduces "
    )
    assert seen.geometry == "declared"


def test_the_two_tables_of_one_model_are_distinguished_without_a_calibration(folder):
    """Of an arm that is not calibrated, in frames that are not known: by 0.2 mm of one link."""
    unknown = Made(folder, seed=1, geometry="free", frame=True, tool=True).recording(STILL)
    assert compare(unknown, simulator(rigid(LITE6.kinematics))).reproduced
    seen = compare(unknown, simulator(rigid(load_bundled("lite6_ros").kinematics)))
    assert seen.differences[0]["reference"] == {"kind": "ros_default_table", "name": "lite6_ros"}
    assert seen.differences[0]["model"] == {"kind": "published_table", "name": "lite6"}
    assert seen.geometry == "declared"


@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize(
    ("frame", "tool", "expected", "said"),
    [
        (
            np.eye(4),
            placed(z=1e-3),
            {"other_tool": (0, 0, 1e-3, 0)},
            ["Its tool is displaced from the declared one by (0, 0, 1) mm"],
        ),
        (
            placed(0.1, 0, 0.2, (0, 0, 0.5)),
            np.eye(4),
            {"other_frame": (0.1, 0, 0.2, 0.5)},
            ["Its base frame is displaced from the declared one by (100, 0, 200) mm and rotated by 500 mrad"],
        ),
        (
            placed(0.1),
            placed(0.03),
            {"other_frame": (0.1, 0, 0, 0), "other_tool": (0.03, 0, 0, 0)},
            ["by (100, 0, 0) mm and rotated by 0 mrad.", "by (30, 0, 0) mm"],
        ),
    ],
)
def test_frame_and_tool_are_named(arm, frame, tool, expected, said, orientation):
    seen = compare(arm.recording(STILL), simulator(frame @ rigid(arm.kinematics) @ tool, orientation=orientation))
    assert not seen.reproduced
    assert codes(seen) == list(expected)
    for entry, (*translation, angle) in zip(seen.differences, expected.values(), strict=True):
        np.testing.assert_allclose(entry["translation_m"], translation, rtol=0, atol=1e-9)
        determined = orientation or entry["difference"] == "other_frame"  # positions do not show how a tool is turned
        assert entry["rotation_rad"] == (pytest.approx(angle, abs=1e-9) if determined else None)
    for sentence, part in zip(differences(seen), said, strict=True):
        assert part in sentence
    subject = "This reduces" if len(said) == 1 else "Together they reduce"
    assert f" {subject} the position error from " in differences(seen)[-1]
    assert differences(seen)[-1].endswith(" mm to 0 mm RMS.")
    assert ({"note": "positions_only"} in seen.notes) is not orientation


def test_what_the_references_sidecar_declares_is_kept(arm):
    """Another tool than declared is named, and left in the difference for the diagnosis to find."""
    recording, shift = arm.recording(STILL), placed(z=1e-3)
    seen = compare(recording, simulator(rigid(arm.kinematics) @ shift, settings=arm.settings()))
    assert codes(seen) == ["other_tool"]
    assert (seen.geometry, seen.recording.settings.tool) == ("exact", "none")
    model = rigid(arm.kinematics)
    expected = model @ np.linalg.inv(shift) @ np.linalg.inv(model) @ poses_of(recording)
    np.testing.assert_allclose(poses_of(seen.recording), expected, rtol=0, atol=1e-12)


def test_a_bent_link_of_the_reference_is_named(arm):
    seen = compare(arm.recording(STILL), simulator(with_effects(arm, BENT).poses(STILL)))
    (entry,), (sentence,) = seen.differences, differences(seen)
    assert (entry["difference"], entry["links"][0]["link"]) == ("other_geometry", 3)
    assert sentence.startswith("Its geometry differs; the smallest displacements that explain it are link 3 by ")
    assert sentence.endswith(" mm to 0 mm RMS.")
    assert seen.geometry == "exact"


def test_effects_of_the_reference_are_reported(arm):
    """A simulator with the nominal table, another tool and a compliant joint."""
    compliant = Made(arm.folder, (COMPLIANCE,), seed=1)
    compliant.__dict__["kinematics"] = LITE6.kinematics
    seen = compare(arm.recording(STILL), simulator(compliant.poses(STILL) @ placed(z=0.02)))
    assert codes(seen) == ["other_table", "other_tool", "not_rigid"]
    assert differences(seen)[2].startswith("No rigid arm explains it completely: 0.")
    assert differences(seen)[2].endswith(
        " mm RMS remain, whose causes `lite6jax diagnose gazebo.csv` would find; if this is noise, declare "
        "position_noise_m in its sidecar."
    )


def test_noise_that_is_declared_is_no_difference(arm):
    earlier = with_effects(arm).recording(STILL, seed=9)
    seen = compare(arm.recording(STILL), earlier)
    assert (seen.reproduced, seen.differences) == (True, ())
    assert seen.recording.settings.position_noise_m == pytest.approx(np.sqrt(2) * 2e-5)
    assert seen.recording.settings.orientation_noise_rad == pytest.approx(np.sqrt(2) * 1e-4)
    undeclared = replace(earlier, settings=replace(earlier.settings, position_noise_m=None))
    assert "if this is noise, declare position_noise_m" in differences(compare(arm.recording(STILL), undeclared))[-1]


def test_outliers_of_the_reference_are_in_no_figure(arm):
    poses = rigid(LITE6.kinematics)
    poses[::20, :3, 3] += 0.03
    seen = compare(arm.recording(STILL), simulator(poses))
    assert codes(seen) == ["other_table"]
    assert seen.remaining.max() < 1e-12
    assert {"note": "outlying_rows", "count": 8, "rows": SAMPLES} in seen.notes
    assert f"8 of {SAMPLES} rows of gazebo.csv are outliers and excluded from these figures." in notes(seen)


# ------------------------------------------------------------------ what is taken out


def test_what_both_share_cancels_whatever_its_size(arm):
    """O anything, Y = O E: what is left is the model's pose times E, exactly."""
    rng = np.random.default_rng(3)
    model = rigid(arm.kinematics)
    wild, extra = (
        np.stack([placed(*5e-3 * rng.standard_normal(3), 0.02 * rng.standard_normal(3)) for _ in model])
        for _ in range(2)
    )
    recording = arm.recording(STILL, poses=model @ wild @ extra, noise=None)
    settings = replace(arm.settings(), factory_calibration=None)
    seen = compare(recording, simulator(model @ wild, settings=settings))
    np.testing.assert_allclose(poses_of(seen.recording), model @ extra, rtol=0, atol=1e-12)
    seen = compare(recording, simulator(model @ wild, settings=settings, orientation=False))
    shift = np.einsum("sij,sj->si", model[:, :3, :3], wild[:, :3, 3])
    assert seen.recording.quaternion is None
    np.testing.assert_allclose(seen.recording.position, recording.position - shift, rtol=0, atol=1e-12)


def test_a_recording_against_itself_has_no_finding(arm):
    recording = arm.recording(STILL)
    found, _ = diagnose_against(recording, replace(recording, source="copy.csv"))
    assert (found.verdict, found.findings) == ("consistent", ())


def test_rows_are_matched_in_any_order(arm):
    """By the joints, to a thousandth of a radian, each row once; those that stand alone are left out."""
    rng = np.random.default_rng(4)
    recording = arm.recording(STILL)
    other = with_effects(arm, HARMONIC).recording(STILL, seed=9)
    order = rng.permutation(SAMPLES)[:150]
    shuffled = replace(other.select(order), row=np.arange(1, 151))
    near = replace(shuffled, joint_position=shuffled.joint_position + 1e-9)
    seen, plain = compare(recording, near), compare(recording.select(np.sort(order)), other)
    assert (seen.rows, seen.matched) == (SAMPLES, 150)
    assert notes(seen)[0] == f"10 of {SAMPLES} rows have no row of run.csv at the same joint positions."
    np.testing.assert_array_equal(seen.recording.row, plain.recording.row)
    np.testing.assert_allclose(seen.recording.position, plain.recording.position, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(seen.recording.direction_of_motion, plain.recording.direction_of_motion)


def test_poses_taken_twice_are_matched_by_their_row(arm):
    """Where joints recur, the row's number tells which is which."""
    twice = {name: np.concatenate([value, value]) for name, value in static_motion(1, 30).items()}
    twice["time"] = 8.0 * np.arange(60)
    other = with_effects(arm).recording(twice, seed=9)
    seen = compare(arm.recording(twice), other)
    assert seen.matched == 60
    model = six_parameter_poses(arm.kinematics, twice["joint_position"])[:, :3, 3]
    np.testing.assert_allclose(seen.distance, np.linalg.norm(other.position - model, axis=1), atol=1e-12)


# ------------------------------------------------------------------ what has changed


def changed(folder, effect):
    """Of an arm of unknown geometry whose own harmonic is in both recordings: it cancels, and the change is found."""
    before = Made(folder, (HARMONIC,), seed=1, geometry="free", frame=True, tool=True)
    after = with_effects(before, HARMONIC, effect)
    diagnosis, seen = diagnose_against(after.recording(STILL, seed=3), before.recording(STILL, seed=4))
    check_finding(diagnosis, effect)
    return diagnosis, seen


def test_a_compliance_that_appeared(folder):
    diagnosis, seen = changed(folder, COMPLIANCE)
    assert diagnosis.verdict == "explained"
    assert not seen.reproduced
    assert seen.geometry == "exact"
    assert seen.factory is not None
    assert {"note": "equal_drivers", "drivers": ["payload", "direction_of_motion", "temperature"]} in seen.notes
    assert "Equal in both recordings: payload, direction of motion and temperature." in " ".join(notes(seen))
    assert codes(seen)[0] == "unknown_geometry"
    assert "The geometry of this arm is not known: the one fitted to run.csv" in differences(seen)[0]


@pytest.mark.long
def test_a_link_bent_in_a_crash(folder):
    changed(folder, BENT)


def test_cold_against_warm(folder):
    """The expansion acts by the difference of the two temperatures, whatever the geometry held at."""
    cold = Made(folder, (WARMTH, HARMONIC), seed=1, geometry="free", frame=True, tool=True)
    chilled = {**STILL, "joint_temperature": np.full((SAMPLES, 6), 8.0)}
    diagnosis, seen = diagnose_against(cold.recording(STILL, seed=3), cold.recording(chilled, seed=4))
    check_finding(diagnosis, WARMTH)
    assert seen.recording.settings.reference_temperature_degC == pytest.approx(8.0)
    warm = STILL["joint_temperature"].mean()
    assert (
        f"The mean temperature is {warm:.1f} °C here and 8.0 °C in the reference: expansion is estimated from the "
        "difference."
    ) in notes(seen)
    assert diagnosis.problem.recording.settings.reference_temperature_degC == pytest.approx(8.0)


def test_drivers_that_differ_are_reported(arm):
    other = {**STILL, "payload": STILL["payload"] + 0.5, "direction": -STILL["direction"]}
    rocked = with_effects(arm, HARMONIC).recording(other, seed=4)
    rocked = replace(rocked, direction_of_motion=-rocked.direction_of_motion, joint_temperature=None)
    assert notes(compare(arm.recording(STILL), rocked)) == [
        f"The payload differs in {SAMPLES} rows: there, compliance that both arms have does not cancel.",
        f"The direction of motion differs in {SAMPLES} rows: there, backlash that both arms have does not cancel.",
        "Only one of the recordings has temperatures: expansion that both arms have does not cancel.",
    ]


def test_a_trajectory_keeps_its_motion(folder):
    moving, lag = moving_motion(2, 40), "joint_lag:joint=2,lag_s=2e-3"
    before = Made(folder, (HARMONIC,), seed=2)
    after = with_effects(before, HARMONIC, lag).recording(moving, noise=None)
    seen = compare(after, before.recording(moving, noise=None)).recording
    assert seen.motion == "trajectory"
    for name in ("time", "run", "joint_velocity", "direction_of_motion", "payload"):
        np.testing.assert_array_equal(getattr(seen, name), getattr(after, name))
    alone = with_effects(before, lag).poses(moving)
    assert np.abs(poses_of(seen) - alone).max() < 2e-6  # what the two do to each other is of second order


# ------------------------------------------------------------------ what is refused


def test_other_joints_are_refused(arm, folder):
    other = replace(simulator(rigid(arm.kinematics), source="far.csv"))
    off = replace(other, joint_position=other.joint_position + 2 * SAME_JOINTS)
    assert refusal(compare, arm.recording(STILL), off) == (
        f"far.csv: 0 of its {SAMPLES} rows are at joint positions of the {SAMPLES} rows of {folder / 'run.csv'} "
        f"(within 0.001 rad), but at least {SAMPLES // 2} are needed; give the same motion in both recordings"
    )


def test_a_recording_without_positions_is_refused(arm):
    bare = Recording.from_arrays(STILL["joint_position"], source="bare.csv")
    said = "bare.csv: has no measured positions; a fit needs the columns x_m y_m z_m"
    assert refusal(compare, arm.recording(STILL), bare) == said
    assert refusal(compare, bare, arm.recording(STILL)) == said


# ------------------------------------------------------------------ as it is typed


def test_agreement_as_it_is_typed(capsys, folder, tmp_path):
    """Two recordings of an arm of unknown geometry with the same physics: nothing changed."""
    same = Made(folder, (HARMONIC, COMPLIANCE), seed=1, geometry="free", frame=True, tool=True)
    paths = [write_recording(same.recording(STILL, seed=k), tmp_path / f"run{k}.csv") for k in (1, 2)]
    out = tmp_path / "d.json"
    code, said, _ = run(capsys, "diagnose", paths[0], "--reference", paths[1], "--quick", "--out", out)
    assert code == 0
    assert "Consistent: beyond the differences above, the two recordings differ by noise." in flat(said)
    assert "`lite6jax diagnose run2.csv` would find." in flat(said)
    document = json.loads(out.read_text())
    assert document["against"]["statement"] == (
        "The model is the rigid arm with the difference from run2.csv: effects that both recordings have are not in "
        "it, and effects of run2.csv alone are in it with reversed sign."
    )
    assert document["verdict"] == "consistent"
    assert document["noise"]["estimated"]["position_m"] == pytest.approx(np.sqrt(2) * 2e-5, rel=0.1)
    assert document["against"]["left_position_rms_m"] > 4e-5  # the physics that both have


def test_what_the_command_refuses(capsys, arm, tmp_path):
    ours = write_recording(arm.recording(STILL), tmp_path / "run7.csv")
    out = tmp_path / "d.json"
    calibration = write_factory(LITE6.kinematics, tmp_path / "factory.yaml")
    assert refused(capsys, "diagnose", ours, "--reference", calibration, "--out", out) == (
        f"{calibration}: is a calibration; give a recording (.csv, .parquet, .mcap, .bag)"
    )
    assert "none.csv" in refused(capsys, "diagnose", ours, "--reference", tmp_path / "none.csv", "--out", out)
    other = write_recording(simulator(rigid(LITE6.kinematics), static_motion(5, SAMPLES)), tmp_path / "other.csv")
    said = refused(capsys, "diagnose", ours, "--reference", other, "--out", out)
    assert said.startswith(f"{other}: 0 of its {SAMPLES} rows are at joint positions of the {SAMPLES} rows of {ours}")
    assert not out.exists()
