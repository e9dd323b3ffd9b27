"""Physics of the campaign's generator, which shares no code with the library: rolled out alike, and found in logs."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.tracking_trials import physics
from benchmarks.tracking_trials.arms import GRAVITY, arm_text, draw_arm
from benchmarks.tracking_trials.effects import Hidden
from benchmarks.tracking_trials.motions import draw_commands
from benchmarks.tracking_trials.physics import Setup, roll
from lite6jax import diagnose
from lite6jax.arms.description import read_description
from lite6jax.domains.tracking.predict import describe_servos
from lite6jax.effects.catalogue import TRACKING_EFFECTS
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording, RecordingSettings
from lite6jax.recordings.settings import ServoSettings

AT = np.array([0.01, -0.02, 0.03])
PAYLOAD = 0.3
NOISE = 5e-5


@pytest.fixture(autouse=True)
def _hurried(monkeypatch):
    monkeypatch.setattr(physics, "LEAD", 0.5)


@pytest.fixture(scope="module")
def setup():
    """Without dry friction: how it holds a joint at rest differs between simulators."""
    drawn = draw_arm("serial3", np.random.default_rng(1), GRAVITY)
    sliding = replace(drawn, joints=replace(drawn.joints, coulomb=np.zeros(3)))
    return Setup(sliding, GRAVITY, PAYLOAD, AT, 10.0, 0.25, 4.0)


@pytest.fixture(scope="module")
def arm(setup, tmp_path_factory):
    path = tmp_path_factory.mktemp("arm") / "arm.yaml"
    path.write_text(arm_text(setup.arm))
    return read_description(path)


def settings_of(setup):
    joints = setup.arm.joints
    servo = ServoSettings(tuple(joints.stiffness.tolist()), tuple(joints.damping.tolist()))
    return RecordingSettings(
        arm="arm.yaml",
        joint_source="measured",
        motion="trajectory",
        joint_noise_rad=NOISE,
        payload_com_m=tuple(AT.tolist()),
        servo=servo,
    )


def commands_of(setup, samples, kinds=("multisine",)):
    return draw_commands(np.random.default_rng(2), setup.arm, kinds, 100.0, samples)


def log_of(setup, hidden, samples=800, **given):
    """A log of the generator with noise of its encoders."""
    commands = commands_of(setup, samples)
    shown = roll(setup, [tuple(hidden)], commands, 5e-4).readout[0, 0]
    noise = np.random.default_rng(5).normal(0.0, NOISE, shown.shape)
    return Recording.assembled(
        shown + noise,
        time=commands.begins[0] + np.arange(samples) * commands.period,
        commanded_position=commands.u[0],
        payload=np.full(samples, PAYLOAD),
        settings=settings_of(setup),
        **given,
    )


PLANTED = [
    Hidden("torque_ripple", "joint2", {"order": 7.3, "amplitude_Nm": 0.1, "phase_rad": 1.0}),
    Hidden("torque_speed_limit", "joint2", {"torque_Nm": 4.0, "droop_s_per_rad": 0.2}),
    Hidden("link_mass", "link2", {"mass_kg": 0.3}),
    Hidden("link_mass", "link3", {"mass_kg": -0.2}),
    Hidden("link_com", "link3", {"x_m": 0.01, "y_m": -0.006, "z_m": 0.004}),
]


def effect_of(hidden):
    """The effect of the library, and its numbers."""
    kind = TRACKING_EFFECTS[hidden.name]
    place = {"link" if hidden.site.startswith("link") else "joint": hidden.joint + 1}
    fixed = {"order": hidden.values["order"]} if "order" in hidden.values else {}
    effect = kind(**place, **fixed)
    return effect, effect.values_of(hidden.values)


@pytest.mark.parametrize("hidden", PLANTED, ids=lambda hidden: f"{hidden.name}:{hidden.site}")
def test_what_the_catalogue_names_is_rolled_out_as_by_the_generator(setup, arm, hidden):
    commands = commands_of(setup, 200)
    plain, shown = roll(setup, [(), (hidden,)], commands, 2.5e-4).readout[:, 0]
    effect, values = effect_of(hidden)
    model = describe_servos(arm, settings_of(setup), PAYLOAD, Terms((effect,)), values)
    predicted = model.predict(np.arange(200) * commands.period, commands.u[0]).position
    assert np.sqrt(np.mean((predicted - shown) ** 2)) < 3e-5
    assert np.sqrt(np.mean((plain - shown) ** 2)) > 2e-4


@pytest.mark.parametrize("hidden", [PLANTED[0], PLANTED[4]], ids=lambda hidden: hidden.name)
def test_what_the_catalogue_names_is_found(setup, arm, hidden):
    document = diagnose(log_of(setup, [hidden]), arm).to_dict()
    (finding,) = document["findings"]
    assert (finding["effect"], finding["site"]) == (hidden.name, hidden.site)
    scale = max(abs(value) for value in hidden.values.values())
    for name, value in hidden.values.items():
        estimate = finding["parameters"][name]
        assert estimate["value"] == pytest.approx(value, abs=max(0.05 * scale, 4 * estimate["std"])), name
    after = document["after"]["heldout_rollout_rms_rad"]
    assert after == pytest.approx(NOISE, rel=0.1)
