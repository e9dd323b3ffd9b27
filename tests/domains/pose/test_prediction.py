"""The model in a diagnosis predicts the poses of the independent generator: over a motion, and as a JAX function."""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from diagnosis.recorded import GRAVITY, LITE6, Made, moving_motion, static_motion, with_effects
from domains.pose.documents import OWN, document, stored
from typed import flat, refusal, refused, run

from lite6jax.diagnosis.document import model_from_document, read_model
from lite6jax.diagnosis.options import Options
from lite6jax.domains.pose.predict import Prediction
from lite6jax.domains.pose.registration import register_model
from lite6jax.domains.predict import predict
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict, parse_effect
from lite6jax.effects.user_effects import load_effects
from lite6jax.recordings import Recording, RecordingSettings, read_motion, write_recording
from lite6jax.report.statements import model_statement

SAMPLES = 30
FEW = Options(folds=2)
STATIC = [
    "joint_offset:joint=3,offset_rad=2e-4",
    "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",
    "joint_harmonic:joint=4,order=63.3,amplitude_rad=5e-4,phase_rad=3",
    "joint_backlash:joint=4,gap_rad=1.2e-3",
    "joint_coupling:joint=5,source_joint=4,coupling=4e-4",
    "link_compliance:link=3,compliance_x_rad_per_Nm=1e-4,compliance_y_rad_per_Nm=6e-5",
    "link_thermal_expansion:expansion_per_K=2.3e-5",
    "frame_offset:link=2,x_m=1e-4,y_m=-2e-4,z_m=1e-4,rx_rad=2e-4,ry_rad=-3e-4,rz_rad=2e-4",
    "base_compliance:compliance_x_rad_per_Nm=3e-5,compliance_y_rad_per_Nm=2e-5",
    "base_drift:vx_m_per_s=1e-6,vy_m_per_s=-2e-6,vz_m_per_s=1e-6",
    "tool_offset:turned=true,x_m=2e-4,y_m=1e-4,z_m=4e-4,rx_rad=3e-4,ry_rad=-2e-4,rz_rad=2e-4",
    "measurement_scale:scale=4e-4",
]
MOVING = ["joint_lag:joint=2,lag_s=2e-3", "time_offset:offset_s=0.006", "joint_backlash:joint=4,gap_rad=1.2e-3"]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=1, frame=True, tool=True)


def written(folder, motion, settings=None, leave_out=()):
    """A motion without poses, as a file."""
    moving = bool(motion["joint_velocity"].any())
    given = {
        "time": motion["time"],
        "joint_velocity": motion["joint_velocity"] if moving else None,
        "joint_temperature": motion["joint_temperature"],
        "payload": motion["payload"],
        "run": motion["run"],
    }
    given = {name: value for name, value in given.items() if name not in leave_out}
    recording = Recording.from_arrays(motion["joint_position"], settings=settings, **given)
    path = write_recording(recording, folder / "motion.csv", overwrite=True)
    if settings is None:
        path.with_suffix(".yaml").unlink(missing_ok=True)
    return path


def predicted(folder, content, motion, **options):
    model = read_model(stored(folder, content))
    return predict(model, read_motion(written(folder, motion, **options), model))


@pytest.mark.parametrize("texts", [STATIC, *([text] for text in MOVING)], ids=["static", "lag", "clock", "backlash"])
def test_effects_are_predicted_as_the_plain_arm_shows_them(arm, tmp_path, texts):
    moving = texts is not STATIC
    motion = (moving_motion if moving else static_motion)(9, SAMPLES)
    poses = predicted(tmp_path, document(arm, texts, "trajectory" if moving else "static"), motion)
    np.testing.assert_allclose(poses, with_effects(arm, *texts).poses(motion), rtol=0, atol=1e-11)


def test_rows_where_the_clock_reaches_beyond_the_ends_are_nan(arm, tmp_path):
    """Two samples of 20 ms, and one of them by extrapolation: 0.05 s loses one row at the end of each run."""
    for offset, lost in ((0.05, [13, 14, 28, 29]), (-0.05, [0, 1, 15, 16]), (0.02, []), (0.03, [14, 29])):
        motion = moving_motion(9, SAMPLES)
        text = f"time_offset:offset_s={offset}"
        poses = predicted(tmp_path, document(arm, [text], "trajectory"), motion)
        beyond = np.isnan(poses).any((1, 2))
        np.testing.assert_array_equal(np.flatnonzero(beyond), lost)
        columns = Prediction(poses, None, None, None).columns()
        assert list(columns) == ["x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
        for column in columns.values():
            np.testing.assert_array_equal(np.flatnonzero(np.isnan(column)), lost)
        np.testing.assert_allclose(poses[~beyond], with_effects(arm, text).poses(motion)[~beyond], rtol=0, atol=1e-11)


def test_settings_come_from_the_diagnosed_recording_or_the_motions_own_sidecar(arm, tmp_path):
    """Reference temperature and kind of motion: 20 °C instead of 25 is five kelvin of growth more."""
    text, motion = "link_thermal_expansion:expansion_per_K=2.3e-5", static_motion(9, SAMPLES)
    inherited = document(arm, [text])
    inherited["model"]["reference_temperature_degC"] = 20.0
    warmer = {**motion, "joint_temperature": motion["joint_temperature"] + 5.0}
    wanted = with_effects(arm, text).poses(warmer)
    np.testing.assert_allclose(predicted(tmp_path, inherited, motion), wanted, rtol=0, atol=1e-11)
    own = RecordingSettings(motion="static", reference_temperature_degC=20.0)
    found = predicted(tmp_path, document(arm, [text]), motion, settings=own)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-11)


def test_the_kind_of_motion_is_inherited(arm, tmp_path):
    """Rows 8 s apart would be taken as poses at rest, rows 20 ms apart as a trajectory."""
    content = document(arm, ["joint_backlash:joint=4,gap_rad=1.2e-3"])
    motion = {**static_motion(9, SAMPLES), "time": 0.02 * np.arange(SAMPLES)}
    found = predicted(tmp_path, content, motion)
    wanted = with_effects(arm, "joint_backlash:joint=4,gap_rad=1.2e-3").poses(motion)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-11)


def test_the_model_is_read_as_it_was_written(arm, tmp_path):
    rms = {"before": {"heldout_position_rms_m": 3e-4}, "after": {"heldout_position_rms_m": 3e-5}}
    model = read_model(stored(tmp_path, document(arm, STATIC, orientation=False) | rms))
    assert model.heldout_rms == (3e-4, 3e-5)
    np.testing.assert_array_equal(model.joint_limits, LITE6.joint_limits)
    assert model.arm == "lite6"
    assert (model.dof, model.orientation, model.motion, model.reference_temperature) == (6, False, "static", 25.0)
    np.testing.assert_array_equal(np.asarray(model.model.geometry).reshape(6, 6), arm.kinematics)
    assert [effect.label for effect in model.physics.effects] == [parse_effect(text)[0].label for text in STATIC]
    np.testing.assert_allclose(model.values, np.concatenate([parse_effect(t)[1] for t in STATIC]), rtol=1e-12)
    assert model.inertia is not None
    np.testing.assert_array_equal(model.inertia.gravity, GRAVITY)


def test_an_effect_of_ones_own(arm, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(OWN)
    effects = load_effects(path)
    content = document(arm, [])
    content["model"]["effects"] = [effect_as_dict(effects[2], [3e-4])]
    motion = static_motion(9, SAMPLES)
    model = read_model(stored(tmp_path, content), effects)
    poses = predict(model, read_motion(written(tmp_path, motion), model))
    moved = motion["joint_position"].copy()
    moved[:, 2] += 3e-4 * np.tanh(moved[:, 2])
    np.testing.assert_allclose(poses, arm.poses({**motion, "joint_position": moved}), rtol=0, atol=1e-11)
    assert "its model has the effect 'cable_drag', and the catalogue has none of this name" in refusal(
        read_model, stored(tmp_path, content)
    )


def test_a_model_of_no_domain_is_refused(arm, tmp_path):
    path = stored(tmp_path, document(arm, []))
    said = refusal(lambda: read_model(path, domain="pose"))
    assert said == 'domain=\'pose\': is none; give "poses", "torques" or "tracking", or leave it out'


# ------------------------------------------------------------------ plain arrays


def test_arrays_are_predicted_as_the_recording_of_them(arm, tmp_path):
    motion = static_motion(9, SAMPLES)
    model = model_from_document(document(arm, STATIC))
    names = ("time", "joint_temperature", "payload")
    poses = predict(model, motion["joint_position"], **{name: motion[name] for name in names})
    np.testing.assert_array_equal(poses, predicted(tmp_path, document(arm, STATIC), motion))


def test_arrays_that_are_no_motion_of_the_arm(arm):
    q = static_motion(9, SAMPLES)["joint_position"]
    model = model_from_document(document(arm, []))
    assert refusal(predict, model, q[:, :5]) == "motion: has 5 joints, and the arm 6; give that arm's motion"
    assert "are these degrees? give radians: np.deg2rad(joint_position)" in refusal(predict, model, np.rad2deg(q))
    said = refusal(lambda: predict(model, Recording.from_arrays(q), payload=np.zeros(SAMPLES)))
    assert said == "motion: is a recording, and arrays go with joint positions only; leave out payload"
    assert refusal(predict, model, None).startswith("motion: has the type NoneType; give a Recording, the path of its")
    assert "motion: payload has the shape (3,); give (30,)" in refusal(lambda: predict(model, q, payload=np.zeros(3)))


# ------------------------------------------------------------------ a JAX function

INSTANT = [text for text in STATIC if not text.startswith("base_drift")]


def instants(motion):
    """The arguments of `pose` for each sample of a motion."""
    return {
        "payload": motion["payload"],
        "temperature_rise": motion["joint_temperature"].mean(1) - 25.0,
        "direction": motion["direction"],
    }


@pytest.fixture(scope="module")
def instant(arm):
    return model_from_document(document(arm, INSTANT))


@pytest.fixture(scope="module")
def few(arm):
    """With the effects of position, load and sensor, for what takes long to compile."""
    return model_from_document(document(arm, [STATIC[1], STATIC[2], STATIC[11]]))


def test_poses_are_those_of_the_plain_arm(arm, instant):
    """In batches of any shape."""
    motion = static_motion(9, SAMPLES)
    given = instants(motion)
    wanted = with_effects(arm, *INSTANT).poses(motion)
    poses = instant.pose(motion["joint_position"], **given)
    np.testing.assert_allclose(poses, wanted, rtol=0, atol=1e-11)
    shaped = {name: value.reshape(5, 6, *value.shape[1:]) for name, value in given.items()}
    np.testing.assert_allclose(
        instant.pose(motion["joint_position"].reshape(5, 6, 6), **shaped),
        wanted.reshape(5, 6, 4, 4),
        rtol=0,
        atol=1e-11,
    )
    first = instant.pose(motion["joint_position"][0], **{name: value[0] for name, value in given.items()})
    np.testing.assert_allclose(first, wanted[0], rtol=0, atol=1e-11)


def test_jit_and_vmap_change_nothing(few):
    motion = static_motion(9, SAMPLES)
    q, given = motion["joint_position"], {"payload": motion["payload"]}
    poses = np.asarray(few.pose(q, **given))
    np.testing.assert_allclose(jax.jit(few.pose)(q, **given), poses, rtol=0, atol=1e-14)
    np.testing.assert_allclose(jax.vmap(lambda q, given: few.pose(q, **given))(q, given), poses, rtol=0, atol=1e-14)
    traced = jax.jit(lambda model, q: model.pose(q, **given))(few, q)  # the model itself as an argument
    np.testing.assert_allclose(traced, poses, rtol=0, atol=1e-14)


def test_derivatives_are_those_of_differences(few):
    """Central differences over 3e-6 rad, kg: truncated at 1e-10 for the harmonic, rounded at 1e-10."""
    motion, step = static_motion(9, 3), 3e-6
    q = motion["joint_position"][0]

    @jax.jit
    def shown(q, payload):
        return few.pose(q, payload=payload)[:3].ravel()

    by_joints, by_payload = map(np.asarray, jax.jit(jax.jacfwd(shown, argnums=(0, 1)))(q, 0.4))
    for k, direction in enumerate(step * np.eye(6)):
        difference = (shown(q + direction, 0.4) - shown(q - direction, 0.4)) / (2 * step)
        np.testing.assert_allclose(by_joints[:, k], difference, rtol=0, atol=2e-9)
    np.testing.assert_allclose(
        by_payload, (shown(q, 0.4 + step) - shown(q, 0.4 - step)) / (2 * step), rtol=0, atol=2e-9
    )
    assert np.abs(by_payload[3::4]).max() > 1e-5  # a compliant arm bends under a payload


def test_the_model_itself_is_differentiated(few):
    """By its effects' numbers and by its frames, each against differences."""
    q = static_motion(9, 4)["joint_position"]

    def height(model):
        return jnp.sum(model.pose(q)[:, 2, 3])

    jitted, gradient = jax.jit(height), jax.grad(height)(few)
    assert gradient.physics == few.physics
    for k in range(few.physics.size):
        step = 1e-6 * np.eye(few.physics.size)[k]
        up, down = (jitted(replace(few, values=few.values + sign * step)) for sign in (1, -1))
        assert float(gradient.values[k]) == pytest.approx(float(up - down) / 2e-6, abs=1e-7, rel=1e-6)
    assert float(gradient.model.T_sensor_base[2, 3]) == pytest.approx(4 * (1 + 4e-4), rel=1e-9)  # the sensor's scale


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (STATIC[3], "joint_backlash:joint4: needs the direction of motion of joint 4: give direction="),
        (STATIC[6], "link_thermal_expansion:links: needs the temperature rise: give temperature_rise="),
        (STATIC[9], "base_drift:base: needs the time: give time="),
        (MOVING[0], "joint_lag:joint2: needs the velocity of joint 2: give joint_velocity="),
        (
            MOVING[1],
            "time_offset:clock: depends on other samples, and pose() takes one at a time; give the motion to "
            "predict(), or remove the effect by model.without('time_offset:clock')",
        ),
    ],
)
def test_a_pose_that_lacks_what_an_effect_needs(arm, text, says):
    model = model_from_document(document(arm, [text]))
    assert refusal(model.pose, np.zeros(6)) == says
    assert refusal(jax.jit(model.pose), np.zeros(6)) == says


def test_play_needs_a_sequence(arm):
    content = document(arm, [])
    play = Unnamed("joint2", "position of joint 2", -3.0, 3.0, "play")
    content["model"]["effects"] = [effect_as_dict(play, [1e-4, 2e-4, 0, 0, 0, 0, 0, 0, 0])]
    model = model_from_document(content)
    assert "depends on other samples" in refusal(model.pose, np.zeros(6))
    bare = model.without("unnamed").pose(np.zeros(6))
    np.testing.assert_allclose(
        bare, arm.poses(static_motion(0, 1) | {"joint_position": np.zeros((1, 6))})[0], atol=1e-12
    )


def test_joint_positions_that_are_none(instant):
    given = {"temperature_rise": 0.0, "direction": 0.0}
    assert refusal(lambda: instant.pose(np.zeros(5), **given)) == (
        "pose: joint_position has the shape (5,); give (..., 6) in rad"
    )
    assert refusal(lambda: instant.pose(np.zeros((3, 6)), payload=np.zeros(2), **given)) == (
        "pose: payload has the shape (2,); give one that broadcasts to (3,)"
    )
    said = refusal(lambda: instant.pose(np.array([0.0, 10.0, 20.0, 0.0, 90.0, 0.0]), **given))
    assert said.startswith("joint_position: it is at 20 rad while the arm's joint 3 goes from ")
    assert said.endswith("; are these degrees? give radians: np.deg2rad(joint_position)")


def test_effects_are_removed_by_name_or_label(arm):
    model = model_from_document(document(arm, STATIC))
    names = [effect.name for effect in model.physics.effects]
    assert [effect.name for effect in model.without("base_drift").physics.effects] == [
        name for name in names if name != "base_drift"
    ]
    less = model.without("joint_backlash:joint4", "base_drift")
    assert len(less.physics.effects) == len(names) - 2
    assert less.values.size == less.physics.size
    said = refusal(model_from_document(document(arm, STATIC[:2])).without, "joint_lag")
    assert said == "effect 'joint_lag': the model has joint_offset:joint3, joint_compliance:joint2; choose one of them"


# ------------------------------------------------------------------ another set-up


def elsewhere(arm, *texts, orientation=True, turned=True):
    """The same arm under another sensor, with another tool."""
    other = Made(arm.folder, texts, seed=7, frame=True, tool=True, orientation=orientation)
    T = arm.T_flange_tool.copy()
    T[:3, 3] = other.T_flange_tool[:3, 3]
    other.__dict__.update(kinematics=arm.kinematics, T_flange_tool=other.T_flange_tool if turned else T)
    return other


def shown(other, motion, noise=None, seed=0):
    return write_recording(other.recording(motion, noise=noise, seed=seed), other.folder / "again.csv", overwrite=True)


def registered(arm, tmp_path, path, *texts, motion="static"):
    model = read_model(stored(tmp_path, document(arm, texts, motion)))
    recording = read_motion(path, model)
    moved, found = register_model(model, recording)
    return moved, found, predict(moved, recording)


@pytest.mark.parametrize("samples", [3, SAMPLES])
def test_another_set_up_is_found_under_all_physics(arm, tmp_path, samples):
    """Exact poses give exact frames, the sensor's scale and the bent tool included."""
    motion = static_motion(9, samples)
    other = elsewhere(arm, *INSTANT)
    moved, found, poses = registered(arm, tmp_path, shown(other, motion), *STATIC)
    np.testing.assert_allclose(moved.model.T_sensor_base, other.T_sensor_base, rtol=0, atol=1e-9)
    np.testing.assert_allclose(moved.model.T_flange_tool, other.T_flange_tool, rtol=0, atol=1e-9)
    np.testing.assert_allclose(poses, other.poses(motion), rtol=0, atol=1e-9)
    assert found.distance.max() < 1e-9
    before = read_model(tmp_path / "diagnosis.json")
    numbers = dict(zip(before.physics.names, before.values, strict=True))
    drift = [name for name in numbers if name.startswith("base_drift")]
    assert drift, "the old set-up drifted"
    assert moved.physics.names == tuple(name for name in numbers if name not in drift)
    np.testing.assert_array_equal(moved.values, [numbers[name] for name in moved.physics.names])


def test_positions_tell_the_tools_offset_not_its_rotation(arm, tmp_path):
    motion = static_motion(9, SAMPLES)
    other = elsewhere(arm, *INSTANT, orientation=False, turned=False)
    moved, found, poses = registered(arm, tmp_path, shown(other, motion), *STATIC)
    np.testing.assert_allclose(moved.model.T_flange_tool, other.T_flange_tool, rtol=0, atol=1e-9)
    np.testing.assert_allclose(poses[:, :3, 3], other.poses(motion)[:, :3, 3], rtol=0, atol=1e-9)
    assert found.turned is None
    assert not moved.orientation


def test_rows_beyond_the_clock_are_not_registered(arm, tmp_path):
    motion, text = moving_motion(9, SAMPLES), "time_offset:offset_s=0.05"
    other = elsewhere(arm, text)
    moved, found, _ = registered(arm, tmp_path, shown(other, motion), text, motion="trajectory")
    assert len(found.distance) == SAMPLES - 4
    np.testing.assert_allclose(moved.model.T_sensor_base, other.T_sensor_base, rtol=0, atol=1e-9)


def test_what_cannot_be_registered(arm, tmp_path):
    model = read_model(stored(tmp_path, document(arm, [])))

    def said(path):
        return refusal(lambda: register_model(model, read_motion(path, model)))

    path = written(tmp_path, static_motion(9, SAMPLES))
    assert said(path) == f"{path}: has no measured positions; a fit needs the columns x_m y_m z_m"
    path = shown(elsewhere(arm, orientation=False), static_motion(9, 4))
    assert said(path) == (
        f"{path}: 4 samples of 3 numbers (position without orientation) give 12 numbers, fewer than the 15 to "
        "determine; record at least 5 samples"
    )
    path = shown(elsewhere(arm), static_motion(9, 1))
    assert said(path) == (
        f"{path}: 1 samples of 6 numbers (position and orientation) give 6 numbers, fewer than the 12 to determine; "
        "record at least 2 samples"
    )
    still = static_motion(9, SAMPLES)
    still["joint_position"][:, :5] = 0.3
    for orientation in (True, False):
        path = shown(elsewhere(arm, orientation=orientation), still)
        assert said(path) == (
            f"{path}: its poses do not determine sensor frame and tool; record some that turn the flange about other "
            "axes"
        )


@pytest.mark.parametrize("orientation", [True, False])
def test_register_as_it_is_typed(capsys, arm, tmp_path, orientation):
    motion = static_motion(9, SAMPLES)
    other = elsewhere(arm, STATIC[1], orientation=orientation)
    path, model = shown(other, motion, (2e-5, 1e-4)), stored(tmp_path, document(arm, STATIC[1:2]))
    out = tmp_path / "p.csv"
    code, said, _ = run(capsys, "predict", model, path, "--register", "--out", out)
    assert code == 0
    text = flat(said)
    assert f"The registration on {SAMPLES} rows leaves errors of 0.03" in text
    for name, T in (("sensor to base", other.T_sensor_base), ("flange to tool", other.T_flange_tool)):
        printed = re.search(rf"{name} \(mm, deg\) (\S+) (\S+) (\S+)", text)
        np.testing.assert_allclose([float(value) for value in printed.groups()], 1e3 * T[:3, 3], rtol=0, atol=0.1)
    assert ("deg RMS." in text) is orientation
    assert ("Positions do not determine the tool's rotation: only its offset is fitted." in text) is not orientation
    assert "outliers" not in text
    lines = out.read_text().splitlines()
    assert lines[0] == ("x_m,y_m,z_m,qw,qx,qy,qz" if orientation else "x_m,y_m,z_m")
    found = np.array([[float(value) for value in line.split(",")][:3] for line in lines[1:]])
    assert np.sqrt(np.mean(np.sum((found - other.poses(motion)[:, :3, 3]) ** 2, 1))) < 3e-5
    joints = written(tmp_path, motion)
    said = refused(capsys, "predict", model, joints, "--register", "--out", out, "--force")
    assert said == f"{joints}: has no measured positions; a fit needs the columns x_m y_m z_m"


def test_a_model_relative_to_a_reference_says_so(arm):
    against = {"file": "gazebo.csv", "basis": "flexible", "statement": "The model is this arm's own."}
    relative = model_from_document(document(arm, []) | {"against": against})
    assert "the difference from gazebo.csv" in model_statement(relative.reference.file, relative.reference.basis)
    assert model_from_document(document(arm, [])).reference is None


# ------------------------------------------------------------------ what is refused


@pytest.mark.parametrize(
    ("content", "says"),
    [
        *((content, "is no JSON (") for content in ("{", "not json", "[" * 100_000)),
        *((content, "is no diagnosis of poses (lite6jax/diagnosis/3 with a model)") for content in ([], {}, 3)),
    ],
)
def test_a_file_that_is_no_diagnosis(tmp_path, content, says):
    path = stored(tmp_path, content)
    said = refusal(read_model, path)
    assert said.startswith(f"{path}: {says}")
    assert said.endswith("give what `lite6jax diagnose --out` wrote")


@pytest.mark.parametrize(
    ("text", "leave_out", "says"),
    [
        ("base_drift:vx_m_per_s=1e-6", ("time",), "base_drift:base: needs the time"),
        ("link_thermal_expansion:expansion_per_K=2e-5", ("joint_temperature",), "needs the temperature rise"),
        ("joint_lag:joint=2,lag_s=1e-3", ("time",), "joint_lag:joint2: needs the velocity of joint 2"),
        ("time_offset:offset_s=0.004", ("time",), "time_offset"),
    ],
)
def test_a_motion_that_lacks_what_the_model_needs(arm, tmp_path, text, leave_out, says):
    assert says in refusal(
        lambda: predicted(tmp_path, document(arm, [text]), static_motion(9, SAMPLES), leave_out=leave_out)
    )
