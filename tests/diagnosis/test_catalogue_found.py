"""Each effect of the catalogue is put into a plainly simulated arm and found again: its name, its site, its numbers."""

import numpy as np
import pytest
from diagnosis.recorded import Made, check_values, found, moving_motion, static_motion, truth
from diagnosis.recorded import searched as search_for

from lite6jax.domains.pose.problem import pose_problem

MOTIONS = {"at rest": static_motion(1), "moving": moving_motion(1)}
SOFT = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"
SLACK = "joint_backlash:joint=4,gap_rad=1.2e-3"
KNOWN = {"seed": 1}
UNKNOWN = {"seed": 2, "geometry": "free", "frame": True, "tool": True}
"""Millimetres of geometry, a sensor and a tool anywhere, and tenths of a millimetre of physics."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("arm")


def searched(made, motion, **options):
    return search_for(pose_problem(made.recording(motion, **options)))


@pytest.mark.parametrize(
    ("options", "motion", "texts"),
    [
        *(
            (KNOWN, "at rest", (text,))
            for text in (
                "joint_offset:joint=3,offset_rad=2e-4",
                "joint_scale:joint=2,scale=3e-4",
                SOFT,
                "joint_harmonic:joint=5,order=1,amplitude_rad=6e-4,phase_rad=-2",
                "joint_harmonic:joint=2,order=101,amplitude_rad=3e-4,phase_rad=1.2",
                "joint_harmonic:joint=4,order=63.3,amplitude_rad=5e-4,phase_rad=3",
                SLACK,
                "joint_coupling:joint=5,source_joint=4,coupling=4e-4",
                "joint_thermal_offset:joint=2,offset_rad_per_K=4e-5",
                "axis_wobble:joint=3,x_cosine1_rad=3e-4,x_sine1_rad=1e-4,x_cosine2_rad=-2e-4,x_sine2_rad=4e-4,"
                "y_cosine1_rad=2e-4,y_sine1_rad=-3e-4,y_cosine2_rad=4e-4,y_sine2_rad=2e-4",
                "link_compliance:link=3,compliance_x_rad_per_Nm=6e-4,compliance_y_rad_per_Nm=3e-4",
                "link_thermal_expansion:expansion_per_K=2.3e-5",
                "link_thermal_expansion:link=3,expansion_per_K=6e-5",
                "frame_offset:link=2,x_m=1e-4,y_m=-2e-4,z_m=1e-4,rx_rad=2e-4,ry_rad=-3e-4,rz_rad=2e-4",
                "base_compliance:cross=true,shift=true,compliance_x_rad_per_Nm=4e-5,compliance_y_rad_per_Nm=3e-5,"
                "compliance_xy_rad_per_Nm=-2e-5,shift_xx_m_per_Nm=3e-6,shift_xy_m_per_Nm=1.5e-5,"
                "shift_yx_m_per_Nm=-1.5e-5,shift_yy_m_per_Nm=4e-6",
                "tool_compliance:compliance_x_rad_per_Nm=3e-3,compliance_y_rad_per_Nm=2e-3",
                "tool_offset:turned=true,x_m=2e-4,y_m=1e-4,z_m=4e-4,rx_rad=3e-4,ry_rad=-2e-4,rz_rad=2e-4",
                "sensor_drift:vx_m_per_s=4e-7,vy_m_per_s=-3e-7,vz_m_per_s=2e-7,wx_rad_per_s=3e-7,wy_rad_per_s=5e-7,"
                "wz_rad_per_s=-4e-7",
                "measurement_scale:scale=4e-4",
            )
        ),
        (KNOWN, "at rest", (SOFT, SLACK)),
        (KNOWN, "moving", (SLACK,)),
        # either alone makes what the other leaves look like autocorrelated noise
        (KNOWN, "moving", ("joint_harmonic:joint=4,order=1,amplitude_rad=5e-4,phase_rad=1", SLACK)),
        ({"seed": 2, "geometry": "prior", "frame": True}, "at rest", (SOFT,)),
        (UNKNOWN, "at rest", (SOFT,)),
        (UNKNOWN, "at rest", ("joint_backlash:joint=5,gap_rad=1.2e-3",)),
    ],
)
def test_effects_are_found_by_name_site_and_numbers(folder, options, motion, texts):
    selection = searched(Made(folder, texts, **options), MOTIONS[motion])
    assert found(selection) == sorted((effect.name, effect.site) for effect, _ in map(truth, texts))
    for text in texts:
        check_values(selection, text)


@pytest.mark.parametrize(
    ("motion", "options"),
    [
        ("at rest", {"geometry": "exact", "frame": True, "orientation": False}),
        ("at rest", {"geometry": "prior", "frame": True, "tool": True}),
        ("at rest", {"geometry": "free", "frame": True, "tool": True}),
        ("moving", {"geometry": "exact"}),
    ],
)
def test_nothing_is_found_where_nothing_is_missing(folder, motion, options):
    state = searched(Made(folder, seed=3, **options), MOTIONS[motion]).state
    assert state.tested == ()
    np.testing.assert_array_equal(state.fit.nuisance, state.baseline.nuisance)


def test_a_payload_that_is_not_what_it_is_said_to_be(folder):
    """Seen only through a compliance; the plain generator carries what the sidecar does not say."""
    still, made = MOTIONS["at rest"], Made(folder, (SOFT,), seed=1)
    selection = searched(made, still, poses=made.poses({**still, "payload": still["payload"] + 0.5}))
    assert found(selection) == [("joint_compliance", "joint2"), ("payload_error", "payload")]
    check_values(selection, SOFT)
    check_values(selection, "payload_error:mass_kg=0.5")


@pytest.mark.long
def test_clocks_that_are_seconds_apart(folder):
    made = Made(folder, ("time_offset:offset_s=3.9",), seed=1, frame=True)
    selection = searched(made, moving_motion(1, samples=1000))
    assert found(selection) == [("time_offset", "clock")]
    assert selection.state.fit.values[0] == pytest.approx(3.9, abs=1e-4)
    assert selection.state.fit.scale[0] == pytest.approx(1, abs=0.1)
    assert 0 < np.sum(~selection.problem.valid) <= 2 * 3.9 / 0.02 + 2  # of two runs


@pytest.mark.parametrize("orientation", [True, False])
def test_what_a_calibration_cannot_be_off_by_is_found_although_it_could_explain_it(tmp_path, orientation):
    """A chain known to 50 µm and 50 µrad that would have to be off by thirty times as much."""
    made = Made(tmp_path, ("joint_offset:joint=3,offset_rad=1.6e-3",), 2, geometry="prior", orientation=orientation)
    fit = searched(made, static_motion(2)).state.fit
    assert [effect.label for effect in fit.terms.terms] == ["joint_offset:joint3"]
    assert abs(fit.values[0] - 1.6e-3) < min(3e-4, 4 * np.sqrt(fit.covariance[0, 0]))
