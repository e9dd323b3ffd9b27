"""The rivals' own honesty: their columns are what the physics does, and what is held out they have not seen."""

import numpy as np
import pytest
from diagnosis.recorded import LITE6, Made, static_motion, with_effects

from benchmarks import residual
from benchmarks.concealed.chain import Chain
from benchmarks.residual import Geometry

SAMPLES = 120


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=1, frame=True, tool=True)


@pytest.fixture(scope="module")
def motion():
    return static_motion(1, SAMPLES)


@pytest.fixture(scope="module")
def view(arm, motion):
    """Rows as the true geometry sees them, without noise."""
    return true_geometry(arm).view(arm.recording(motion, noise=None))


def true_geometry(arm):
    """What a fit would find of an arm's frame and tool if there were neither noise nor physics."""
    chain = Chain("lite6", arm.kinematics, LITE6.joint_limits, LITE6.mass, LITE6.center_of_mass)
    return Geometry(chain, True, arm.T_sensor_base, arm.T_flange_tool, free=False)


def moved(arm, motion, text, size):
    """What an effect does to positions and orientations, per unit, in the base's axes."""
    name, _, rest = text.partition(":")
    plus, minus = (with_effects(arm, f"{name}:{rest.format(sign * size)}").poses(motion) for sign in (1, -1))
    R = arm.T_sensor_base[:3, :3]
    shift = (plus - minus)[:, :3, 3] @ R / (2 * size)
    spin = R.T @ (plus @ np.linalg.inv(minus))[:, :3, :3] @ R
    turn = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], 1) / (2 * size)
    return shift, turn


@pytest.mark.long
@pytest.mark.parametrize(
    ("text", "group", "place"),
    [
        ("joint_compliance:joint=2,compliance_rad_per_Nm={:g}", "joint_compliance:joint2", 0),
        ("link_compliance:link=3,compliance_x_rad_per_Nm=0,compliance_y_rad_per_Nm={:g}", "link_compliance:link3", 1),
        ("base_compliance:compliance_x_rad_per_Nm={:g},compliance_y_rad_per_Nm=0", "base_compliance:base", 0),
        ("joint_scale:joint=4,scale={:g}", "joint_scale:joint4", 0),
        ("base_drift:vx_m_per_s=0,vy_m_per_s={:g},vz_m_per_s=0", "base_drift:base", 1),
    ],
)
def test_a_column_is_what_the_effect_does(arm, motion, view, text, group, place):
    (found,) = (g for g in (*residual.gravity(view), *residual.other_physics(view)) if g.name == group)
    J = residual.design(view, found.columns)[:, :, place]
    shift, turn = moved(arm, motion, text, 1e-6)
    scale = np.abs(shift).max()
    np.testing.assert_allclose(J[:, :3] * view.noise[0], shift, atol=2e-5 * scale)
    np.testing.assert_allclose(J[:, 3:] * view.noise[1], turn, atol=2e-5 * max(scale, np.abs(turn).max()))


def test_a_wave_is_a_joints_sine(motion, view):
    groups = [g for g in residual.waves(view, (3,)) if g.name == "joint_harmonic:joint5"]
    J = residual.design(view, groups[0].columns)
    lever = residual.design(view, [residual.Column(5, 5, lambda v: np.ones(len(v.tool)))])[:, :, 0]
    angle = 3 * motion["joint_position"][:, 4]
    np.testing.assert_allclose(J[:, :, 0], lever * np.sin(angle)[:, None], atol=1e-9)
    np.testing.assert_allclose(J[:, :, 1], lever * np.cos(angle)[:, None], atol=1e-9)
