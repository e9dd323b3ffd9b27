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
from lite6jax.domains.tracking.problem import RolloutCache, along_rollout, diagnosed_servos, tracking_problem
from lite6jax.domains.tracking.rows import tracking_rows
from lite6jax.effects.catalogue import TRACKING_EFFECTS
from lite6jax.effects.dynamic import PayloadTorque
from lite6jax.errors import InputError
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.options import EngineOptions
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


WARMING = Hidden("warming_friction", "joint2", {"size": 0.6})
CABLE = Hidden("cable_drag", "joint2", {"size": 1.5}, {"centre": 0.2, "by": 3.0, "other": 0.1})


def quantities_of(problem):
    return {quantity.driver.phrase: quantity for quantity in problem.quantities}


@pytest.fixture(scope="module")
def warm(setup, arm):
    """The problem of a log whose second joint warms; its temperatures are recorded."""
    rise = np.linspace(0.0, 10.0, 800)
    log = log_of(setup, [WARMING], joint_temperature=25.0 + rise[:, None] * np.array([0.5, 1.0, 0.2]))
    return along_rollout(tracking_problem(tracking_rows(log, arm)), Terms(), np.zeros(0))


def test_columns_of_bodies_hold_what_each_joint_does_to_the_others(setup, arm):
    problem = tracking_problem(tracking_rows(log_of(setup, []), arm))
    coupled = replace(problem, coupled_columns=True)
    effect = PayloadTorque()
    step = 0.02
    shown = [problem.residual(np.zeros(0), Terms((effect,)), np.array([mass])) for mass in (0.0, step)]
    true = (shown[1] - shown[0]) / step
    held, whole = (each.columns([effect])[0] for each in (problem, coupled))
    distances = [np.linalg.norm(column - true) / np.linalg.norm(true) for column in (held, whole)]
    assert distances[1] < 0.02
    assert distances[1] < 0.3 * distances[0]


def test_what_the_data_alone_do_not_distinguish_is_listed(setup, arm):
    """Less viscous friction, which is usual, a little delay and a little feed-forward differ by their priors alone."""
    hidden = Hidden("servo_feedforward", "joint2", {"feedforward_Nm_s_per_rad": 0.02})
    (finding,) = diagnose(log_of(setup, [hidden]), arm=arm).findings
    names = {finding.name, *(alternative.term.name for alternative in finding.alternatives)}
    assert {"servo_feedforward", "command_delay"} <= names


def test_finer_steps_are_nearer_to_a_limited_rate(setup, arm):
    hidden = Hidden("rate_limit", "joint2", {"velocity_rad_per_s": 0.5})
    problem = tracking_problem(tracking_rows(log_of(setup, []), arm))
    true = roll(setup, [(hidden,)], commands_of(setup, 800), 2.5e-4).readout[0, 0].T
    effect, values = effect_of(hidden)
    errors = []
    for data in (problem.data, problem.data.finer):
        shown = replace(problem, data=data, known=RolloutCache()).readouts(np.zeros(0), Terms((effect,)), values)
        errors.append(np.sqrt(np.mean((shown - true)[1] ** 2)))
    assert errors[1] < 0.6 * errors[0]
    assert errors[1] < 2e-5


def test_drivers_are_all_that_varies_each_where_it_may_act(warm):
    by_phrase = quantities_of(warm)
    assert {by_phrase[name].only for name in ("time", "temperature rise")} == {""}
    for joint in (1, 2, 3):
        site = f"joint{joint}"
        own = {by_phrase[f"{name} of joint {joint}"].only for name in ("command velocity", "temperature")}
        assert own == {site}
        assert by_phrase[f"gravity torque of joint {joint}"].own == {site}
        assert {by_phrase[f"{name} of joint {joint}"].only for name in ("position", "velocity")} == {""}
    command = np.asarray(warm.data.recording.commanded_position)
    assert np.cumsum(by_phrase["command velocity of joint 2"].values)[-2] * 0.01 == pytest.approx(
        command[-1, 1] - command[0, 1], abs=0.02
    )


def test_temperatures_that_all_joints_share_are_one_driver(setup, arm):
    log = log_of(setup, [], 200, ambient_temperature=np.linspace(20.0, 25.0, 200))
    phrases = quantities_of(tracking_problem(tracking_rows(log, arm)))
    assert "temperature rise" in phrases
    assert "temperature of joint 2" not in phrases


@pytest.mark.parametrize(
    ("hidden", "phrases", "kernel"),
    [
        (WARMING, ("time", "velocity of joint 2"), "smooth*line"),
        (CABLE, ("position of joint 2", "position of joint 3"), "cubic*cubic"),
    ],
    ids=["warming friction", "a cable that another joint draws"],
)
def test_what_no_name_describes_is_a_function_of_its_drivers(setup, arm, warm, hidden, phrases, kernel):
    problem = warm
    if hidden is CABLE:
        problem = along_rollout(tracking_problem(tracking_rows(log_of(setup, [CABLE]), arm)), Terms(), np.zeros(0))
    by_phrase = quantities_of(problem)
    process = problem.process(problem.components[1], [by_phrase[phrase] for phrase in phrases], kernel, 2.0)
    before, after = (fit(problem, Terms(terms), EngineOptions()) for terms in ((), (process,)))
    assert before.scale[1] > 5 * after.scale[1]


def test_a_prediction_later_than_the_log_is_outside(warm):
    by_phrase = quantities_of(warm)
    quantities = [by_phrase[phrase] for phrase in ("time", "velocity of joint 2")]
    process = Terms((warm.process(warm.components[1], quantities, "smooth*line", 2.0),))
    fitted = fit(warm, process, EngineOptions())
    readout = warm.readouts(np.zeros(0), fitted.terms, fitted.values)
    model = diagnosed_servos(warm, warm.servo, fitted.terms, fitted.values, readout)
    recording = warm.data.recording
    assert recording.time is not None
    command = np.asarray(recording.commanded_position)
    here = model.predict(recording.time, command)
    assert not here.outside.any()
    assert np.sqrt(np.mean((here.position - readout.T) ** 2)) < 1e-4
    assert model.predict(recording.time + 60.0, command).outside.all()


def test_what_depends_on_temperature_is_predicted_where_it_is_given(warm):
    by_phrase = quantities_of(warm)
    quantities = [by_phrase[phrase] for phrase in ("velocity of joint 2", "temperature of joint 2")]
    process = Terms((warm.process(warm.components[1], quantities, "line*line", 2.0),))
    fitted = fit(warm, process, EngineOptions())
    readout = warm.readouts(np.zeros(0), fitted.terms, fitted.values)
    model = diagnosed_servos(warm, warm.servo, fitted.terms, fitted.values, readout)
    motion = warm.data.recording
    assert np.sqrt(np.mean((model.predicted(motion).position - readout.T) ** 2)) < 1e-4
    with pytest.raises(InputError, match="temperature of joint 2: is required but missing"):
        model.predict(motion.time, motion.commanded_position)
    with pytest.raises(InputError, match=r"temperature has the shape \(3,\)"):
        model.predict(motion.time, motion.commanded_position, temperature=np.zeros(3))
