"""Each effect of the catalogue is put into a plainly simulated arm and found again: its name, its site, its numbers."""

import numpy as np
import pytest
from diagnosis.recorded import Made, check_values, found, moving_motion, static_motion, truth, with_effects
from diagnosis.recorded import searched as search_for

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.serialization import parse_effect


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Of a known geometry, where its sensor stands known as well."""
    return Made(tmp_path_factory.mktemp("arm"), seed=1)


@pytest.fixture(scope="module")
def still():
    return static_motion(1)


@pytest.fixture(scope="module")
def moving():
    return moving_motion(1)


def searched(made, motion, **options):
    return search_for(pose_problem(made.recording(motion, **options)))


STATIC = [
    "joint_offset:joint=3,offset_rad=2e-4",
    "joint_scale:joint=2,scale=3e-4",
    "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",
    "joint_harmonic:joint=1,order=2,amplitude_rad=4e-4,phase_rad=0.7",
    "joint_harmonic:joint=5,order=1,amplitude_rad=6e-4,phase_rad=-2",
    "joint_harmonic:joint=2,order=101,amplitude_rad=3e-4,phase_rad=1.2",
    "joint_harmonic:joint=4,order=63.3,amplitude_rad=5e-4,phase_rad=3",
    "joint_backlash:joint=4,gap_rad=1.2e-3",
    "joint_coupling:joint=5,source_joint=4,coupling=4e-4",
    "link_compliance:link=3,compliance_x_rad_per_Nm=6e-4,compliance_y_rad_per_Nm=3e-4",
    "link_thermal_expansion:expansion_per_K=2.3e-5",
    "link_thermal_expansion:link=3,expansion_per_K=6e-5",
    "frame_offset:x_m=1e-4,y_m=-2e-4,z_m=1e-4,rx_rad=2e-4,ry_rad=1e-4,rz_rad=-3e-4",
    "frame_offset:link=2,x_m=1e-4,y_m=-2e-4,z_m=1e-4,rx_rad=2e-4,ry_rad=-3e-4,rz_rad=2e-4",
    "base_compliance:compliance_x_rad_per_Nm=3e-5,compliance_y_rad_per_Nm=2e-5",
    "base_compliance:cross=true,compliance_x_rad_per_Nm=4e-5,compliance_y_rad_per_Nm=3e-5,"
    "compliance_xy_rad_per_Nm=-2e-5",
    "base_compliance:cross=true,shift=true,compliance_x_rad_per_Nm=4e-5,compliance_y_rad_per_Nm=3e-5,"
    "compliance_xy_rad_per_Nm=-2e-5,shift_xx_m_per_Nm=3e-6,shift_xy_m_per_Nm=1.5e-5,shift_yx_m_per_Nm=-1.5e-5,"
    "shift_yy_m_per_Nm=4e-6",
    "joint_thermal_offset:joint=2,offset_rad_per_K=4e-5",
    "axis_wobble:joint=3,x_cosine1_rad=3e-4,x_sine1_rad=1e-4,x_cosine2_rad=-2e-4,x_sine2_rad=4e-4,"
    "y_cosine1_rad=2e-4,y_sine1_rad=-3e-4,y_cosine2_rad=4e-4,y_sine2_rad=2e-4",
    "sensor_drift:vx_m_per_s=4e-7,vy_m_per_s=-3e-7,vz_m_per_s=2e-7,wx_rad_per_s=3e-7,wy_rad_per_s=5e-7,"
    "wz_rad_per_s=-4e-7",
    "tool_compliance:compliance_x_rad_per_Nm=3e-3,compliance_y_rad_per_Nm=2e-3",
    "tool_offset:turned=true,x_m=1e-4,z_m=4e-4",
    "tool_offset:turned=true,x_m=2e-4,y_m=1e-4,z_m=4e-4,rx_rad=3e-4,ry_rad=-2e-4,rz_rad=2e-4",
    "measurement_scale:scale=4e-4",
]


@pytest.mark.parametrize("text", STATIC)
def test_an_effect_of_an_arm_at_rest(arm, still, text):
    made = with_effects(arm, text)
    selection = searched(made, still)
    effect, _ = truth(text)
    assert found(selection) == [(effect.name, effect.site)]
    check_values(selection, text)


MOVING = ["joint_backlash:joint=4,gap_rad=1.2e-3"]


@pytest.mark.parametrize("text", MOVING)
def test_an_effect_of_a_moving_arm(arm, moving, text):
    selection = searched(with_effects(arm, text), moving)
    effect, _ = truth(text)
    assert found(selection) == [(effect.name, effect.site)]
    check_values(selection, text)


@pytest.mark.parametrize(
    "texts",
    [
        ("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5", "joint_backlash:joint=4,gap_rad=1.2e-3"),
        ("joint_harmonic:joint=1,order=101,amplitude_rad=4e-4,phase_rad=0.4", "tool_offset:turned=true,z_m=4e-4"),
    ],
)
def test_two_effects_at_once(arm, still, texts):
    selection = searched(with_effects(arm, *texts), still)
    assert found(selection) == sorted((effect.name, effect.site) for effect, _ in map(truth, texts))
    for text in texts:
        check_values(selection, text)


@pytest.mark.parametrize(
    "text",
    [
        "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",
        "joint_harmonic:joint=4,order=2,amplitude_rad=8e-4,phase_rad=0.7",
        "joint_backlash:joint=5,gap_rad=1.2e-3",
    ],
)
def test_an_effect_of_an_arm_whose_geometry_is_not_known(arm, still, text):
    """Millimetres of geometry, a sensor and a tool anywhere, and tenths of a millimetre of physics."""
    made = Made(arm.folder, (text,), seed=2, geometry="free", frame=True, tool=True)
    selection = searched(made, still)
    effect, _ = truth(text)
    assert found(selection) == [(effect.name, effect.site)]
    check_values(selection, text)


def test_an_effect_of_an_arm_whose_geometry_is_known_roughly(arm, still):
    text = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"
    selection = searched(Made(arm.folder, (text,), seed=2, geometry="prior", frame=True), still)
    assert found(selection) == [("joint_compliance", "joint2")]
    check_values(selection, text)


CLEAN = [
    {"geometry": "exact"},
    {"geometry": "exact", "frame": True, "orientation": False},
    {"geometry": "prior", "frame": True, "tool": True},
    {"geometry": "free", "frame": True, "tool": True},
]


@pytest.mark.parametrize("options", CLEAN)
def test_nothing_is_found_where_nothing_is_missing(arm, still, options):
    made = Made(arm.folder, seed=3, **options)
    poses = made.poses(still)
    for seed in range(2):
        selection = search_for(pose_problem(made.recording(still, poses=poses, seed=seed)))
        assert selection.state.tested == ()
        assert selection.state.fit is selection.state.baseline or np.array_equal(
            selection.state.fit.nuisance, selection.state.baseline.nuisance
        )


def test_nothing_is_found_in_a_moving_arm_where_nothing_is_missing(arm, moving):
    poses = arm.poses(moving)
    for seed in range(2):
        assert search_for(pose_problem(arm.recording(moving, poses=poses, seed=seed))).state.tested == ()


def test_two_effects_of_one_joint_that_hide_each_other(arm, moving):
    """Either alone makes what the other leaves look like noise that remembers."""
    texts = ("joint_harmonic:joint=4,order=1,amplitude_rad=5e-4,phase_rad=1", "joint_backlash:joint=4,gap_rad=1.2e-3")
    selection = searched(with_effects(arm, *texts), moving)
    assert found(selection) == [("joint_backlash", "joint4"), ("joint_harmonic", "joint4")]
    for text in texts:
        check_values(selection, text)


def test_a_payload_that_is_not_what_it_is_said_to_be(arm, still):
    """Seen only through a compliance; the plain generator carries what the sidecar does not say."""
    text = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"
    heavier = {**still, "payload": still["payload"] + 0.5}
    made = with_effects(arm, text)
    selection = searched(made, still, poses=made.poses(heavier))
    assert found(selection) == [("joint_compliance", "joint2"), ("payload_error", "payload")]
    check_values(selection, text)
    check_values(selection, "payload_error:mass_kg=0.5")


@pytest.mark.long
@pytest.mark.parametrize("offset", [3.9, -1.26])
def test_clocks_that_are_seconds_apart(arm, offset):
    motion = moving_motion(1, samples=1000)
    made = Made(arm.folder, (f"time_offset:offset_s={offset}",), seed=1, frame=True)
    selection = searched(made, motion)
    assert found(selection) == [("time_offset", "clock")]
    assert selection.state.fit.values[0] == pytest.approx(offset, abs=1e-4)
    assert selection.state.fit.scale[0] == pytest.approx(1, abs=0.1)
    late = selection.problem.valid
    assert 0 < np.sum(~late) <= 2 * abs(offset) / 0.02 + 2  # of two runs


@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize(
    "text",
    [
        "frame_offset:link=5,x_m=3e-3,y_m=1e-3,z_m=0,rx_rad=0,ry_rad=0,rz_rad=0",
        "joint_offset:joint=3,offset_rad=1.6e-3",
    ],
)
def test_what_a_calibration_cannot_be_off_by_is_found_although_it_could_explain_it(tmp_path, text, orientation):
    """A chain known to 50 µm and 50 µrad that would have to be off by thirty times as much."""
    made = Made(tmp_path, (text,), 2, geometry="prior", orientation=orientation)
    selection = searched(made, static_motion(2))
    effect, values = parse_effect(text)
    assert [one.term for one in selection.state.tested] == [effect]
    off = selection.state.fit.values - values
    assert np.abs(off[np.abs(values) > 0]).max() < 3e-4
    std = np.sqrt(np.diagonal(selection.state.fit.covariance))
    assert (np.abs(off) < 4 * std).all()
