import pytest
from typed import unread

from lite6jax.errors import InputError
from lite6jax.recordings import FactoryUncertainty, RecordingSettings, read_settings, write_settings

FULL = """
recording:
  arm: arms/mine.yaml
  factory_calibration: arm.yaml
  factory_uncertainty: {position_m: 1.0e-5, rotation_rad: 1e-5}
  joint_source: measured
  joint_noise_rad: 3e-5
  pose_source: laser_tracker
  motion: static
  pose_frame: base
  tool: [0, 0, 0.1, 0, 0.5, -1]
  position_noise_m: 2.0e-05
  orientation_noise_rad: 1.0e-4
  payload_com_m: [0, 0, 0.05]
  reference_temperature_degC: 21
  gravity_m_per_s2: [0, 9.81, 0]
  torque_source: current
  torque_noise_Nm: [0.06, 8e-2]
  inertial: 0.1
  torque_constant_Nm_per_A: [-10, 0.5]
  date: 2026-11-21
  instrument: Leica AT960, 750012
"""


def sidecar(tmp_path, text):
    path = tmp_path / "run7.yaml"
    path.write_text(text)
    return path


def test_every_key_is_read(tmp_path):
    assert read_settings(sidecar(tmp_path, FULL)) == RecordingSettings(
        arm="arms/mine.yaml",
        factory_calibration="arm.yaml",
        factory_uncertainty=FactoryUncertainty(1e-5, 1e-5),
        joint_source="measured",
        joint_noise_rad=3e-5,
        pose_source="laser_tracker",
        motion="static",
        pose_frame="base",
        tool=(0.0, 0.0, 0.1, 0.0, 0.5, -1.0),
        position_noise_m=2e-5,
        orientation_noise_rad=1e-4,
        payload_com_m=(0.0, 0.0, 0.05),
        reference_temperature_degC=21.0,
        gravity_m_per_s2=(0.0, 9.81, 0.0),
        torque_source="current",
        torque_noise_Nm=(0.06, 0.08),
        inertial=0.1,
        torque_constant_Nm_per_A=(-10.0, 0.5),
        date="2026-11-21",
        instrument="Leica AT960, 750012",
    )


@pytest.mark.parametrize("settings", ["full", "default", "awkward"])
def test_round_trip_is_exact(tmp_path, settings):
    settings = {
        "full": read_settings(sidecar(tmp_path, FULL)),
        "default": RecordingSettings(),
        "awkward": RecordingSettings(
            arm="1e5", tool="none", joint_noise_rad=1e-7, position_noise_m=1 / 3e5, gravity_m_per_s2=(0.1, -1e-300, 9.8)
        ),
    }[settings]
    path = write_settings(settings, tmp_path / "out.yaml")
    assert read_settings(path) == settings


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("recording: {pose_frme: base}", "recording.pose_frme: unknown key; did you mean pose_frame?"),
        ("arm: lite6", "is not a sidecar; give the key `recording:`"),
        ("recording: [arm, lite6]", "recording: ['arm', 'lite6'] is not a mapping; write `key: value` lines"),
        ("recording: {motion: moving}", "recording.motion: 'moving' is not accepted; give static or trajectory"),
        ("recording: {joint_source: [measured]}", "recording.joint_source: ['measured'] is not accepted; give"),
        ("recording: {date: 21.11.2026}", "recording.date: '21.11.2026' is not accepted; give a day as YYYY-MM-DD"),
        (f"recording: {{instrument: {'x' * 121}}}", "is not accepted (expected str of length <= 120); give one line"),
        ("recording: {motion: }", "recording.motion: has no value; give static or trajectory, or leave the key out"),
        ("recording: {joint_noise_rad: -1.0e-5}", "joint_noise_rad: -1e-05 is not accepted (expected float >= 0.0);"),
        ("recording: {position_noise_m: 0}", "0 is not accepted (expected float >= 1e-12); give one sigma in m, more"),
        ("recording: {orientation_noise_rad: 0.1deg}", "orientation_noise_rad: '0.1deg' is not accepted"),
        ("recording: {gravity_m_per_s2: -9.81}", "-9.81 is not accepted; give three numbers [x, y, z] in m/s^2"),
        ("recording: {payload_com_m: [0, 0, 50]}", "[0, 0, 50] is not accepted (expected float <= 5.0, at [2]); give"),
        ("recording: {inertial_uncertainty: 10}", "10 is not accepted (expected float <= 0.5); give one sigma"),
        (
            "recording: {torque_noise_Nm: much}",
            "recording.torque_noise_Nm: 'much' is not accepted; give one sigma in N m of",
        ),
        ("recording: {torque_noise_Nm: [0.1, 0]}", "torque_noise_Nm: [0.1, 0] is not accepted (expected float >="),
        ("recording: {inertial: fitted}", "inertial: 'fitted' is not accepted; give declared, unknown (they are"),
        ("recording: {torque_constant_Nm_per_A: [12, 0]}", "[12, 0] is not accepted (zero); give a list with one"),
        ("recording: {tool: flange}", "recording.tool: 'flange' is not accepted; give none, unknown, or six numbers"),
        ("recording: {tool: [0, 0, 100, 0, 0, 0]}", "is not accepted (expected float <= 5.0, at [2]); give none"),
        ("recording: {tool: [0, 0, 0.1, 0, 0, 90]}", "is not accepted (expected float <= 6.283185307179586, at [5]);"),
        ("recording: {arm: 6}", "recording.arm: 6 is not accepted; give a bundled arm's name, or the path"),
        (
            "recording: {factory_uncertainty: {position_m: 1.0e-5, rotation_rad: 1.0e-5}}",
            "recording.factory_uncertainty: belongs to a factory_calibration; add that key or leave this one out",
        ),
        (
            "recording: {factory_calibration: a.yaml, factory_uncertainty: {position_m: 1.0e-5}}",
            "is not accepted (Object missing required field rotation_rad); give {position_m: 1.0e-5, rotation_rad: 1.0",
        ),
        ("recording: {tip: hand}", "recording.tip: names where the chain of a URDF or MJCF file ends; give the path"),
        ("recording: {arm: lite6, tip: hand}", "recording.tip: names where the chain of a URDF or MJCF file ends"),
        ("recording: {arm: a.xml, tip: 5}", "recording.tip: 5 is not accepted; give the name of a link"),
        ("recording: {motion: static, motion: static}", "line 1: the key 'motion' is given twice; keep one"),
        ("recording: {arm: !!python/object/apply:os.getcwd []}", "line 1: the YAML tag 'tag:yaml.org,2002:python/"),
    ],
)
def test_what_a_sidecar_must_not_say(tmp_path, text, message):
    assert message in unread(sidecar(tmp_path, text), read_settings)


def test_a_sidecar_of_the_other_suffix_is_not_passed_over(tmp_path):
    (tmp_path / "run7.yml").write_text(FULL)
    with pytest.raises(InputError, match=r"run7\.yml: a sidecar ends in \.yaml; rename it to run7\.yaml"):
        read_settings(tmp_path / "run7.yaml")


def test_the_tip_of_a_tree_may_stand_beside_its_file(tmp_path):
    settings = read_settings(sidecar(tmp_path, "recording: {arm: go2.xml, tip: FL_calf}"))
    assert settings.arm_reference(tmp_path) == tmp_path / "go2.xml#FL_calf"


def test_paths_are_kept_and_resolved_beside_the_sidecar(tmp_path):
    settings = read_settings(sidecar(tmp_path, FULL))
    assert settings.arm_is_file
    assert settings.arm_reference(tmp_path) == tmp_path / "arms/mine.yaml"
    assert settings.factory_path(tmp_path) == tmp_path / "arm.yaml"
    bundled = RecordingSettings(arm="xarm7")
    assert not bundled.arm_is_file
    assert bundled.arm_reference(tmp_path) == "xarm7"
    assert bundled.factory_path(tmp_path) is None
    for name in ("mine.urdf", "mine.YAML", "./mine", "mine.urdf.xacro", "arms\\mine"):
        assert RecordingSettings(arm=name).arm_is_file
