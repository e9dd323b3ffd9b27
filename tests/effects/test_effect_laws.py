"""What every effect of the catalogue obeys, and each one's prediction against plain NumPy."""

import json
from dataclasses import FrozenInstanceError, fields

import jax
import numpy as np
import pytest

from lite6jax.arms.chains import SixParameterForm
from lite6jax.effects.catalogue import POSE_EFFECTS, catalogue
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Altering, Bending
from lite6jax.effects.kinematic import (
    JointBacklash,
    JointCompliance,
    JointHarmonic,
    JointWarmUp,
    JointWindup,
    LinkCompliance,
    ToolOffset,
)
from lite6jax.effects.motion import motion_of
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict, effect_from_dict, parse_effect
from lite6jax.effects.statics import inertia_of
from lite6jax.model import arm_model, predict, predict_poses
from tests.oracles.arms import random_kinematics
from tests.oracles.effects import predicted_poses, random_motion
from tests.oracles.gravity import random_inertia
from tests.oracles.transforms import displacement

DOF = 3
FORM = SixParameterForm(DOF)
RNG = np.random.default_rng(20)
KINEMATICS = random_kinematics(RNG, DOF)
MOTION_ARRAYS = random_motion(RNG, DOF)
INERTIA_ARRAYS = random_inertia(RNG, DOF)
T_SENSOR_BASE, T_FLANGE_TOOL = (
    displacement([0.3, -0.2, 0.5, 0.4, 0.3, -0.8]),
    displacement([0.05, 0.02, 0.1, -0.2, 0.5, 0.1]),
)

MODEL = arm_model(KINEMATICS.ravel(), T_SENSOR_BASE, T_FLANGE_TOOL)
MOTION = motion_of(**MOTION_ARRAYS)
INERTIA = inertia_of(**INERTIA_ARRAYS)

EFFECTS = (
    *catalogue(DOF),
    *(JointHarmonic(2), JointHarmonic(3, 50.5), ToolOffset(turned=True)),
    Unnamed("joint2", "gravity torque of joint 2", -5.0, 5.0, "cubic"),
    Unnamed("link1", "position of joint 3", -1.0, 1.5, "wave", "y"),
    Unnamed("base", "time", 0.0, 6.0, "line", "rx"),
    Unnamed("tool", "temperature rise", -5.0, 15.0, "rough", "z"),
    *(JointBacklash(2, 0.0), JointBacklash(3, 0.7), JointWindup(2, 0.0), JointWindup(2, 0.9), JointWindup(3, 0.2)),
    *(JointWarmUp(1, 2.5), JointWarmUp(3, 40.0)),
)
THROUGH_LOADS = ("payload_error", "payload_com", "gravity_direction")
ALL = Physics(EFFECTS)
"""Compiled once: an effect alone is all of them with the others' values zero."""
every_effect = pytest.mark.parametrize("effect", EFFECTS, ids=lambda effect: f"{effect.label}{effect.size}")


def values_of(effect, size=1.0):
    """Values of the size that real arms show; an order is a number that the motion can show."""
    values = size * RNG.uniform(0.5, 1, effect.size) * [c.typical for c in effect.coordinates]
    if isinstance(effect, JointHarmonic) and effect.order is None:
        values[2] = 1.7
    return values


def beside(effect):
    """A compliance, where an effect shows in nothing else."""
    return (JointCompliance(2),) if effect.name in THROUGH_LOADS else ()


def placed(values):
    """Values of `ALL` from those of some effects."""
    return ALL.join([values.get(effect, np.zeros(effect.size)) for effect in EFFECTS])


def predicted(physics, values):
    return predict_poses(FORM, physics, MODEL, values, MOTION, INERTIA)


@jax.jit
def slope_of_all(at, step):
    return jax.jvp(lambda values: predicted(ALL, values), (at,), (step,))[1]


def test_zero_changes_nothing():
    rigid = predict(FORM, MODEL, MOTION.joint_position.T)
    np.testing.assert_allclose(predicted(ALL, np.zeros(ALL.size)), rigid, rtol=0, atol=1e-14)


@pytest.mark.parametrize("effect", {e.name: e for e in EFFECTS}.values(), ids=lambda effect: effect.name)
def test_an_effect_needs_no_other(effect):
    shape = jax.eval_shape(lambda values: predicted(Physics((effect,)), values), np.zeros(effect.size))
    assert shape.shape == (MOTION.samples, 4, 4)


@every_effect
def test_something_else_changes_something(effect):
    without = {other: values_of(other) for other in beside(effect)}
    values = without | {effect: values_of(effect)}
    change = np.abs(predicted(ALL, placed(values)) - predicted(ALL, placed(without))).max()
    assert 1e-9 < change < 0.2


@every_effect
@pytest.mark.parametrize("at_neutral", [True, False])
def test_derivative_is_that_of_finite_differences(effect, at_neutral):
    together = (effect, *beside(effect))
    at = placed({e: values_of(e) * (not at_neutral or e is not effect) for e in together})
    steps = {e: 1e-3 * RNG.uniform(0.5, 1, e.size) * [c.typical for c in e.coordinates] for e in together}
    if effect.name in ("base_drift", "sensor_drift"):
        steps[effect] = np.maximum(steps[effect], 1e-6)
    step = placed(steps)
    slope = slope_of_all(at, step)
    difference = (predicted(ALL, at + step) - predicted(ALL, at - step)) / 2
    np.testing.assert_allclose(slope, difference, rtol=0, atol=1e-15 + 2e-6 * np.abs(difference).max())


@every_effect
def test_names_say_units_and_sizes_are_positive(effect):
    suffixes = {"1": "", "1/K": "_per_K", "rad/Nm": "_rad_per_Nm", "m/s": "_m_per_s"}
    suffixes |= {"rad/s": "_rad_per_s", "rad/K": "_rad_per_K", "m/Nm": "_m_per_Nm"}
    assert effect.coordinates
    for coordinate in effect.coordinates:
        assert coordinate.name.endswith(suffixes.get(coordinate.unit, f"_{coordinate.unit}"))
        assert 0 < coordinate.typical < 1
        assert coordinate.lower <= 0 < 5 * coordinate.typical < coordinate.upper
        assert np.isfinite(coordinate.upper) or effect.name in ("unnamed", "joint_harmonic")
    assert effect.label == f"{effect.name}:{effect.site}"
    assert all(driver.phrase and driver.unit and driver.remedy for driver in effect.drivers)


@every_effect
def test_an_effect_is_a_frozen_final_value(effect):
    kind = type(effect)
    assert kind.__final__
    same = kind(**{field.name: getattr(effect, field.name) for field in fields(effect)})
    assert hash(effect) == hash(same)
    assert effect == same
    assert isinstance(effect, Bending) != isinstance(effect, Altering)
    with pytest.raises((FrozenInstanceError, TypeError)):
        effect.name = "other"


@every_effect
def test_json_gives_the_same_effect_back(effect):
    values = values_of(effect)
    document = json.loads(json.dumps(effect_as_dict(effect, values, np.diag(values**2))))
    again, numbers = effect_from_dict(document)
    assert again == effect
    np.testing.assert_allclose(numbers, values, rtol=1e-14)
    assert document["site"] == effect.site
    assert POSE_EFFECTS[document["effect"]] is type(effect)
    plain = {name: p["value"] for name, p in document["parameters"].items()}
    np.testing.assert_allclose(effect_from_dict({**document, "parameters": plain})[1], values, rtol=1e-14)


@every_effect
def test_text_gives_the_same_prediction(effect):
    values = values_of(effect)
    document = effect_as_dict(effect, values)
    items = dict(document["where"]) | {name: p["value"] for name, p in document["parameters"].items()}
    text = f"{effect.name}:" + ",".join(f"{name}={value!r}" for name, value in items.items())
    again, numbers = parse_effect(text.replace("'", ""))
    assert again.label == effect.label
    assert list(again.reported(numbers)) == list(effect.reported(values))
    numbers_of = lambda e, v: [estimate.value for estimate in e.reported(v).values()]  # noqa: E731
    np.testing.assert_allclose(numbers_of(again, numbers), numbers_of(effect, values), rtol=1e-13)


@every_effect
def test_standard_deviations_are_those_of_finite_differences(effect):
    values = values_of(effect)
    typical = np.array([c.typical for c in effect.coordinates])
    root = 0.01 * typical[:, None] * RNG.uniform(-1, 1, (effect.size, effect.size))
    reported = effect.reported(values, root @ root.T)
    assert list(reported) == list(effect.parameters)

    def parameters(at):
        return np.array([estimate.value for estimate in effect.reported(at).values()])

    slopes = [
        (parameters(values + step) - parameters(values - step)) / (2 * step.sum()) for step in np.diag(1e-5 * typical)
    ]
    stds = np.sqrt(np.sum((np.transpose(slopes) @ root) ** 2, axis=1))
    np.testing.assert_allclose([estimate.std for estimate in reported.values()], stds, rtol=1e-6, atol=1e-16)


def plain_form(effect, values):
    document = effect_as_dict(effect, values)
    parameters = {name: p["value"] for name, p in document["parameters"].items()}
    return effect.name, {**document["where"], **parameters}


NAMED = [effect for effect in EFFECTS if effect.name != "unnamed"]


@pytest.mark.parametrize("effect", NAMED, ids=lambda effect: f"{effect.label}{effect.size}")
def test_prediction_is_that_of_plain_numpy(effect):
    values = {e: values_of(e) for e in (effect, *beside(effect))}
    poses = predicted(ALL, placed(values))
    effects = [plain_form(e, v) for e, v in values.items()]
    plain = predicted_poses(KINEMATICS, T_SENSOR_BASE, T_FLANGE_TOOL, MOTION_ARRAYS, INERTIA_ARRAYS, effects)
    np.testing.assert_allclose(poses, plain, rtol=0, atol=1e-13)


def test_all_effects_together_are_those_of_plain_numpy_in_any_order():
    # a wobble before a joint's rotation commutes to first order only with what else is added to that rotation
    together = [effect for effect in NAMED if effect.name != "axis_wobble"]
    parts = [values_of(e, 3.0) for e in together]
    effects = [plain_form(e, v) for e, v in zip(together, parts, strict=True)]
    plain = predicted_poses(KINEMATICS, T_SENSOR_BASE, T_FLANGE_TOOL, MOTION_ARRAYS, INERTIA_ARRAYS, effects)
    for order in (np.arange(len(together)), RNG.permutation(len(together))):
        physics = Physics(tuple(together[i] for i in order))
        poses = predicted(physics, physics.join([parts[i] for i in order]))
        np.testing.assert_allclose(poses, plain, rtol=0, atol=1e-13)


def test_numbers_of_several_effects_stand_one_after_the_other():
    physics = Physics((JointHarmonic(1, 1.0), JointHarmonic(1, 2.0), LinkCompliance(2)))
    assert physics.size == 6
    assert physics.names == (
        "joint_harmonic:joint1:sine_rad",
        "joint_harmonic:joint1:cosine_rad",
        "joint_harmonic:joint1#2:sine_rad",
        "joint_harmonic:joint1#2:cosine_rad",
        "link_compliance:link2:compliance_x_rad_per_Nm",
        "link_compliance:link2:compliance_y_rad_per_Nm",
    )
    assert physics.units == ("rad", "rad", "rad", "rad", "rad/Nm", "rad/Nm")
    assert [len(np.arange(6)[part]) for part in physics.slices] == [2, 2, 2]
    covariance = np.diag(np.arange(1.0, 7.0) ** 2)
    first, second, third = physics.reported([3e-4, 4e-4, 0, -1e-4, 1e-5, 2e-5], covariance)
    assert first["amplitude_rad"].value == pytest.approx(5e-4)
    assert first["phase_rad"].value == pytest.approx(np.arctan2(4, 3))
    assert second["phase_rad"].value == pytest.approx(-np.pi / 2)
    assert third["compliance_y_rad_per_Nm"] == (2e-5, 6.0)
    assert Physics().size == 0
    assert physics.loaded
    assert not Physics((JointHarmonic(1),)).loaded


def test_phases_lie_above_minus_pi_and_at_most_at_pi():
    harmonic = JointHarmonic(1, 1.0)
    assert harmonic.reported([-1e-4, -0.0])["phase_rad"].value == np.pi
    assert harmonic.reported([-1e-4, 0.0])["phase_rad"].value == np.pi
    nothing = harmonic.reported([0.0, 0.0], np.eye(2) * 1e-12)
    assert nothing["amplitude_rad"] == (0.0, pytest.approx(1e-6))
    assert nothing["phase_rad"].std == pytest.approx(np.pi / np.sqrt(3))
    for phase in (-3.0, -0.2, 1.1, np.pi):
        values = harmonic.values_of({"order": 1.0, "amplitude_rad": 2e-4, "phase_rad": phase})
        assert harmonic.reported(values)["phase_rad"].value == pytest.approx(phase)


def test_the_catalogue_has_every_site_once():
    assert len(set(catalogue(6))) == len(catalogue(6))
    assert {e.name for e in catalogue(6)} == set(POSE_EFFECTS) - {"unnamed", "joint_windup", "joint_warm_up"}
    at_slide = [e for e in catalogue(3, sliding=(1,)) if e.site == "joint2"]
    assert [e.name for e in at_slide] == ["joint_offset", "joint_scale", "joint_compliance", "joint_backlash"]
    assert [c.name for e in at_slide for c in e.coordinates] == ["offset_m", "scale", "compliance_m_per_N", "gap_m"]
    phrases = ["slide position of joint 2", "gravity force of joint 2", "direction of motion of joint 2"]
    assert [driver.phrase for e in at_slide for driver in e.drivers] == phrases
    assert max(e.joints_needed for e in catalogue(4)) == 4
