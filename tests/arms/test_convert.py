import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from typed import refusal

from lite6jax.arms import frames
from lite6jax.arms.chains import HayatiForm, hayati_fk, hayati_form_of, six_parameter_fk
from lite6jax.arms.description import load_bundled
from lite6jax.arms.dh import hayati_to_six_parameter, six_parameter_to_hayati
from lite6jax.errors import InputError
from tests.oracles.arms import (
    LITE6_DH,
    parameters_of_table,
    perturbed,
    random_kinematics,
    random_positions,
    table_of_parameters,
)
from tests.oracles.chains import six_parameter_poses
from tests.oracles.transforms import rotate, shift

LITE6 = HayatiForm(6, (1,))
NOMINAL = parameters_of_table(LITE6, np.zeros(4), LITE6_DH, [0.0])
KINEMATICS = load_bundled("lite6").kinematics
named = pytest.mark.parametrize("name", ["lite6", "ur10", "xarm7", "xarm5"])
seeds = st.integers(0, 2**32 - 1)


@named
@given(seed=seeds, size=st.sampled_from([0.0, 1e-6, 1.0, 10.0]))
def test_conversion_reproduces_the_chain_and_stays_by_nominal(name, seed, size):
    arm, rng = load_bundled(name), np.random.default_rng(seed)
    form = hayati_form_of(arm.kinematics)
    kinematics = perturbed(rng, arm.kinematics, size)
    nominal = parameters_of_table(form, np.zeros(4), arm.dh, np.zeros(len(form.parallel)))
    parameters = six_parameter_to_hayati(form, kinematics, nominal)
    positions = random_positions(rng, 8, arm.dof)
    expected = six_parameter_poses(kinematics, positions)
    np.testing.assert_allclose(hayati_fk(form, parameters, positions), expected, atol=1e-12)
    # corrections, not another description: a skew of 0.15 deg seen from a metre away is 3 mm
    lengths = np.array(form.units) == "m"
    assert np.abs(parameters - nominal)[lengths].max() <= 12e-3 * size + 1e-12
    assert np.abs(parameters - nominal)[~lengths].max() <= np.deg2rad(1.2) * size + 1e-12
    np.testing.assert_array_equal(
        parameters[[-1 - len(form.parallel), -2 - len(form.parallel)]], 0
    )  # alpha and a, last


@pytest.mark.parametrize("dof", range(2, 9))
@given(seed=seeds)
def test_conversion_of_any_arm(dof, seed):
    rng = np.random.default_rng(seed)
    kinematics = random_kinematics(rng, dof)
    kinematics[0, 3:5] *= 0.3  # joint 1 within 76 deg of the base's z
    directions = frames.frames_at_zero(kinematics)[:, :3, 2]
    sines = np.linalg.norm(np.cross(directions[1:], directions[:-1]), axis=1)
    form = HayatiForm(dof)
    parameters = six_parameter_to_hayati(form, kinematics)
    theta = table_of_parameters(form, parameters)[1][:-1, 0]
    assert np.all(np.abs(theta) <= np.pi / 2 + 1e-15)
    positions = random_positions(rng, 5, dof)
    expected = six_parameter_poses(kinematics, positions)
    # two axes a sine apart meet their common normal only to rounding over that sine
    tolerance = 1e-13 / np.min(sines, initial=1) ** 2
    np.testing.assert_allclose(hayati_fk(form, parameters, positions), expected, atol=tolerance)


@pytest.mark.parametrize("sliding", [(), (2,)])
@pytest.mark.parametrize("axis", range(3))
@given(seed=seeds, forwards=st.booleans())
def test_joint_1_may_point_along_any_axis_of_the_base(axis, sliding, seed, forwards):
    rng = np.random.default_rng(seed)
    kinematics = random_kinematics(rng, 4)
    kinematics[1:, 3] = rng.uniform(0.3, 1.2, 3)  # no two neighbouring axes are parallel
    kinematics[1:, 4] *= 0.1
    along = (np.eye(3)[axis] + rng.uniform(-0.3, 0.3, 3)) * (1 if forwards else -1)
    kinematics[0, 3:] = Rotation.align_vectors([along], [[0, 0, 1]])[0].as_euler("xyz")
    form = hayati_form_of(kinematics, sliding)
    assert form.first_axis == axis
    absent = (("x", "roll"), ("y", "pitch"), ("z", "yaw"))[axis]
    given_names = {name.removeprefix("base_") for name in form.names if name.startswith("base_")}
    assert given_names == {"x", "y", "z", "roll", "pitch", "yaw"} - set(absent)
    parameters = six_parameter_to_hayati(form, kinematics)
    positions = random_positions(rng, 5, 4)
    expected = six_parameter_fk(kinematics, positions, sliding)
    np.testing.assert_allclose(hayati_fk(form, parameters, positions), expected, atol=1e-12)
    again, T_joint_flange = hayati_to_six_parameter(form, parameters)
    np.testing.assert_allclose(six_parameter_fk(again, positions, sliding) @ T_joint_flange, expected, atol=1e-12)


@named
@given(seed=seeds)
def test_inverse_needs_only_a_flange_transform(name, seed):
    arm, rng = load_bundled(name), np.random.default_rng(seed)
    form = arm.form
    parameters = arm.hayati + rng.uniform(-1, 1, form.size) * 3e-3
    kinematics, T_joint_flange = hayati_to_six_parameter(form, parameters)
    positions = random_positions(rng, 8, arm.dof)
    expected = hayati_fk(form, parameters, positions)
    np.testing.assert_allclose(six_parameter_poses(kinematics, positions) @ T_joint_flange, expected, atol=1e-13)
    # the flange transform is the last joint's a and alpha
    a, alpha = table_of_parameters(form, parameters)[1][-1, 2:]
    np.testing.assert_allclose(T_joint_flange, shift(a, 0, 0) @ rotate("x", alpha), atol=1e-15)
    # and back: without it, the parameters come again
    without = parameters.copy()
    without[[form.names.index(f"{n}{arm.dof}") for n in ("a", "alpha")]] = 0
    again = six_parameter_to_hayati(form, kinematics, arm.hayati)
    np.testing.assert_allclose(again, without, atol=1e-13)


def test_many_arms_at_once_equal_one_by_one():
    rng = np.random.default_rng(0)
    kinematics = np.array([perturbed(rng, KINEMATICS) for _ in range(7)])
    many = six_parameter_to_hayati(LITE6, kinematics, NOMINAL)
    assert many.shape == (7, 28)
    for one, row in zip(many, kinematics, strict=True):
        np.testing.assert_allclose(one, six_parameter_to_hayati(LITE6, row, NOMINAL), atol=1e-14)
    # without nominal every arm has theta in (-90, 90] deg
    free = six_parameter_to_hayati(LITE6, kinematics)
    positions = random_positions(rng, 5, 6)
    for one, row in zip(free, kinematics, strict=True):
        np.testing.assert_allclose(hayati_fk(LITE6, one, positions), six_parameter_poses(row, positions), atol=1e-12)


def test_branch_follows_nominal_over_whole_turns_and_the_other_normal():
    turned = NOMINAL.copy()
    theta, alpha = (np.array([LITE6.names.index(f"{n}{i}") for i in range(1, 6)]) for n in ("theta_off", "alpha"))
    turned[theta[3]] += 2 * np.pi
    turned[alpha[1]] -= 2 * np.pi
    np.testing.assert_allclose(six_parameter_to_hayati(LITE6, KINEMATICS, turned), turned, atol=1e-14)
    # joint 4's common normal read the other way: theta turns by 180 deg, alpha changes its sign, and joint 5 turns back
    other = NOMINAL.copy()
    other[theta[3]] += np.pi
    other[alpha[3]] *= -1
    other[theta[4]] -= np.pi
    np.testing.assert_allclose(six_parameter_to_hayati(LITE6, KINEMATICS, other), other, atol=1e-14)


# The seed's reason for Hayati's parameter


def tilted(beta):
    """The nominal Lite 6 whose joint 3 is tilted against joint 2, in the plane of both."""
    parameters = parameters_of_table(LITE6, np.zeros(4), LITE6_DH, [beta])
    kinematics, T_joint_flange = hayati_to_six_parameter(LITE6, parameters)
    np.testing.assert_allclose(T_joint_flange, np.eye(4), atol=1e-15)
    return kinematics


def test_beta_passes_smoothly_through_zero():
    tilts = np.deg2rad(np.linspace(-0.1, 0.1, 21))
    assert tilts[10] == 0
    parameters = six_parameter_to_hayati(LITE6, np.array([tilted(beta) for beta in tilts]), NOMINAL)
    np.testing.assert_allclose(parameters[:, -1], tilts, atol=1e-15)
    np.testing.assert_allclose(parameters[:, :-1], np.tile(NOMINAL[:-1], (21, 1)), atol=1e-14)


# Refusals


def moved(joint, **changes):
    """The Lite 6 with some numbers of a joint (from 1) set."""
    rows = KINEMATICS.copy()
    for name, value in changes.items():
        rows[joint - 1, ["x", "y", "z", "roll", "pitch", "yaw"].index(name)] = value
    return rows


REFUSED = [
    (LITE6, np.zeros((7, 6)), "kinematics of shape (7, 6): this form takes (6, 6)"),
    (LITE6, np.zeros((2, 6, 5)), "kinematics of shape (2, 6, 5): this form takes (6, 6)"),
    (LITE6, moved(3, x=np.nan), "kinematics: every number must be finite"),
    (
        LITE6,
        moved(1, roll=np.pi / 2),
        "joint 1: its axis is at right angles to the base's z, along which this form draws it; check the arm's model",
    ),
    (
        HayatiForm(6),
        KINEMATICS,
        "joints 2 and 3: their axes are parallel, which this form does not expect; add 1 to `parallel`",
    ),
    (
        HayatiForm(6, (0, 1)),
        KINEMATICS,
        "joints 1 and 2: their axes are not parallel as this form expects; check the arm's model",
    ),
    (
        LITE6,
        moved(3, x=0.0),
        "joints 2 and 3: their axes coincide, so the two joints are indistinguishable; remove one",
    ),
]


@pytest.mark.parametrize(("form", "kinematics", "message"), REFUSED)
@pytest.mark.parametrize("nominal", [False, True])
def test_refusals(form, kinematics, message, nominal):
    assert refusal(six_parameter_to_hayati, form, kinematics, np.zeros(form.size) if nominal else None) == message


def test_every_arm_of_many_is_examined():
    kinematics = np.array([KINEMATICS, moved(3, x=0.0)])
    for nominal in (None, NOMINAL):
        with pytest.raises(InputError, match=r"^kinematics\[1\]: joints 2 and 3: their axes coincide"):
            six_parameter_to_hayati(LITE6, kinematics, nominal)


def test_a_nominal_of_another_arm_is_refused():
    with pytest.raises(InputError, match=r"parameters of shape \(32,\): this form takes \(28,\)"):
        six_parameter_to_hayati(LITE6, KINEMATICS, np.zeros(32))
