"""Units and sizes of prismatic joints beside those of revolute ones."""

import numpy as np
import pytest

from lite6jax.arms.arm import LEVER, as_revolute, by_kind, joint_size, joint_sizes, joint_unit


@pytest.mark.parametrize(
    ("revolute", "prismatic", "power"),
    [
        ("Nm", "N", -1),
        ("rad", "m", 1),
        ("rad/s²", "m/s²", 1),
        ("Nm·s/rad", "N·s/m", -2),
        ("Nm·s/rad/K", "N·s/m/K", -2),
        ("Nm/rad", "N/m", -2),
        ("kg·m²", "kg", -2),
        ("1", "1", 0),
    ],
)
def test_a_prismatic_joint_has_the_unit_and_size_at_the_lever(revolute, prismatic, power):
    assert joint_unit(revolute, True) == prismatic
    assert joint_unit(revolute, False) == revolute
    # a pinion of this radius: a shift is LEVER times an angle, and a force is a torque over LEVER
    assert joint_size(3.0, revolute, True) == pytest.approx(3.0 * LEVER**power)
    assert joint_size(3.0, revolute, False) == 3.0


@pytest.mark.parametrize(
    ("revolute", "prismatic"),
    [
        ("viscous_Nm_s_per_rad", "viscous_N_s_per_m"),
        ("viscous_Nm_s_per_rad_K", "viscous_N_s_per_m_K"),
        ("inertia_kg_m2", "mass_kg"),
        ("rotor_inertia_kg_m2", "rotor_mass_kg"),
        ("rest_rad", "rest_m"),
        ("coefficient", "coefficient"),
        ("heldout_torque_rms_Nm", "heldout_torque_rms_N"),
        ("radius_m", "radius_m"),
    ],
)
def test_names_have_the_unit_of_their_joint(revolute, prismatic):
    assert joint_unit(revolute, True) == prismatic


def test_sizes_by_joint():
    slides = np.array([False, True])
    np.testing.assert_allclose(joint_sizes(0.02, "rad", slides), [0.02, 0.002])
    values = np.array([[0.02, 0.04], [0.002, 0.004]])
    np.testing.assert_allclose(as_revolute(values, "rad", slides), [[0.02, 0.04], [0.02, 0.04]])
    np.testing.assert_allclose(as_revolute(values[1], "rad", True), [0.02, 0.04])
    assert by_kind("moves_Nm", values, slides, np.max) == {"moves_Nm": 0.04, "moves_N": 0.004}
    assert by_kind("moves_Nm", values, ~slides & False, np.max) == {"moves_Nm": 0.04}
