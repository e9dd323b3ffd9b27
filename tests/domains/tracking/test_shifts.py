"""Commands and read-outs that are off by a function of what was recorded: rolled out, found, saved and predicted."""

import json

import numpy as np
import pytest

from lite6jax import diagnose
from lite6jax.diagnosis.document import read_model
from lite6jax.diagnosis.servo_export import convert_servos
from lite6jax.domains.tracking.problem import along_rollout, diagnosed_servos, tracking_problem
from lite6jax.domains.tracking.rollout import CHANNELS, COMMAND, READ_OUT, hold_commands, roll
from lite6jax.domains.tracking.rows import tracking_rows
from lite6jax.effects.dynamic import UnnamedInLoop
from lite6jax.effects.servo import Servo
from lite6jax.errors import InputError
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording
from lite6jax.report import tracking
from tests.domains.tracking.test_servo_fit import PENDULUM, PERIOD, SERVO, TRUE, commands_of
from tests.oracles.servos import follow

SAMPLES = 600
NOISE = 5e-5
RAD = 3e-3


def bump(q):
    """`(sample,)` rad at positions of the joint."""
    return RAD * np.exp(-(((q - 0.1) / 0.3) ** 2))


def log_of(command, shown, servo=SERVO):
    """A recording of the pendulum with noise of its encoder."""
    noise = np.random.default_rng(5).normal(0.0, NOISE, len(shown))
    return Recording.from_arrays(
        (shown + noise)[:, None],
        arm=PENDULUM,
        time=np.arange(len(shown)) * PERIOD,
        commanded_position=command[:, None],
        motion="trajectory",
        joint_noise_rad=NOISE,
        payload_com_m=(0.0, -0.1, 0.0),
        servo=servo,
    )


def shown_by_encoder(command):
    """Read-outs of an encoder that is off where the joint passes a place."""
    q = follow(command, PERIOD, **TRUE)
    return q + bump(q)


def shown_by_command(command, **changed):
    """Read-outs where the servo is given another command than was recorded, by where the joint is."""
    q = follow(command, PERIOD, **(TRUE | changed))
    for _ in range(3):
        q = follow(command + bump(q), PERIOD, **(TRUE | changed))
    return q


@pytest.fixture(scope="module")
def off_encoder():
    command = commands_of(SAMPLES)
    return diagnose(log_of(command, shown_by_encoder(command)), PENDULUM)


# ------------------------------------------------------------------ rollouts


def servo_of(**numbers):
    plain = Servo.ideal(np.array([200.0]), np.array([8.0]))._replace(inertia=np.array([0.1]))
    return plain._replace(**{name: np.array([number]) for name, number in numbers.items()})


@pytest.mark.parametrize("interpolated", [False, True])
def test_a_shift_of_the_command_is_another_command(interpolated):
    """It passes delay, low pass and limits as any command does."""
    u = commands_of(SAMPLES)
    shift = bump(u)
    run = np.repeat([0, 1], SAMPLES // 2)
    servo = servo_of(delay=0.013, time_constant=0.02, rate_limit=1.0, coulomb=0.2)
    joint = np.array([0])
    given, shifted = (
        hold_commands(each[:, None], run, PERIOD, u[:, None], interpolated=interpolated) for each in (u, u + shift)
    )
    nothing = np.zeros((1, given.samples * given.steps))
    extra = np.zeros((1, CHANNELS, SAMPLES))
    extra[0, COMMAND] = shift
    by_shift = roll(servo, given, joint, nothing, nothing + 0.03, extra=extra).readout
    by_command = roll(servo, shifted, joint, nothing, nothing + 0.03).readout
    assert np.abs(by_shift - by_command).max() < 1e-12


def test_a_shift_of_the_read_out_leaves_the_motion_as_it_is():
    u = commands_of(SAMPLES)
    shift = bump(u)
    run = np.zeros(SAMPLES, int)
    joint = np.array([0])
    held = hold_commands(u[:, None], run, PERIOD, u[:, None])
    later = held._replace(start=held.start + shift[:, None])
    nothing = np.zeros((1, held.samples * held.steps))
    extra = np.zeros((1, CHANNELS, SAMPLES))
    extra[0, READ_OUT] = shift
    servo = servo_of(backlash=0.001)
    along = roll(servo, later, joint, nothing, nothing + 0.03, extra=extra, fine=True)
    plain = roll(servo, held, joint, nothing, nothing + 0.03, fine=True)
    assert along.position == pytest.approx(plain.position, abs=1e-12)
    assert along.readout == pytest.approx(plain.readout + shift, abs=1e-12)


@pytest.mark.parametrize("component", ["command", "read-out"])
def test_columns_of_shifts_are_how_exact_residuals_change(component):
    problem = along_rollout(
        tracking_problem(tracking_rows(log_of(commands_of(SAMPLES), shown_by_encoder(commands_of(SAMPLES))), PENDULUM)),
        Terms(),
        np.zeros(0),
    )
    (torque,) = problem.components
    shift = next(one for one in torque.alike if one.name == component)
    position = next(one for one in problem.quantities if one.driver.phrase == "position of joint 1")
    terms = Terms((problem.process(shift, [position], "line", RAD),))
    columns = problem.columns(terms.terms)
    none = np.zeros(0)
    before = problem.residual(none, terms, np.zeros(terms.size))
    for k, column in enumerate(columns):
        step = 1e-3 * np.eye(terms.size)[k]
        exact = (problem.residual(none, terms, step) - before) / 1e-3
        assert np.linalg.norm(column - exact) < 0.02 * np.linalg.norm(exact)


# ------------------------------------------------------------------ what is found


def test_a_read_out_that_is_off_is_found_as_such(off_encoder):
    document = off_encoder.to_dict()
    (finding,) = document["findings"]
    assert (finding["effect"], finding["site"], finding["component"]) == ("unnamed", "joint1", "read-out")
    assert finding["driver"] == "position of joint 1"
    assert finding["peak_to_peak"]["peak_to_peak_rad"]["value"] == pytest.approx(RAD, rel=0.1)
    # the loop would pass a torque or a command later
    assert not any(rival.get("component") == "command" for rival in finding["confusable_with"])
    # some blocks hold places that the others lack
    assert document["after"]["heldout_rollout_rms_rad"] < 0.2 * document["before"]["heldout_rollout_rms_rad"]


def test_a_sentence_says_that_the_read_out_is_off(off_encoder):
    document = off_encoder.to_dict()
    statement = tracking.finding_statement(document["findings"][0])
    assert statement.startswith(
        "The read-out of joint 1 is off as a function of the position of joint 1: peak to peak "
    )
    assert " mrad; it moves joint 1 by " in statement
    assert tracking.headline(document).startswith("The read-out of joint 1 is off: of ")


def test_a_saved_diagnosis_predicts_the_read_out(off_encoder, tmp_path):
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps(off_encoder.to_dict()))
    model = read_model(path, domain="tracking")
    assert model.terms.terms == off_encoder.model.terms.terms
    command = commands_of(SAMPLES, seed=3)
    time = np.arange(SAMPLES) * PERIOD
    predicted = model.predict(time, command[:, None]).position[:, 0]
    assert np.array_equal(predicted, off_encoder.model.predict(time, command[:, None]).position[:, 0])
    shown = shown_by_encoder(command)
    assert np.sqrt(np.mean((predicted - shown) ** 2)) < 1e-4
    assert np.sqrt(np.mean((follow(command, PERIOD, **TRUE) - shown) ** 2)) > 5e-4


def test_exports_say_that_they_lack_the_shift(off_encoder, tmp_path):
    conversion = convert_servos(off_encoder.model, tmp_path / "rollout.py")
    assert "unnamed shift of the read-out at joint1" in conversion.left_out


def likelihoods_in_loop(log):
    """Of a function of the joint's position in a log, by the component of the loop that it is added to."""
    problem = along_rollout(tracking_problem(tracking_rows(log, PENDULUM)), Terms(), np.zeros(0))
    (torque,) = problem.components
    position = [one for one in problem.quantities if one.driver.phrase == "position of joint 1"]
    spreads = {"": 200.0 * RAD, "command": RAD, "read-out": RAD}
    fits = {
        component.name: fit(
            problem,
            Terms((problem.process(component, position, "fine", spreads[component.name]),)),
            EngineOptions(),
        )
        for component in (torque, *torque.alike)
    }
    return {name: fitted.own_likelihood for name, fitted in fits.items()}


def test_a_command_that_is_off_is_like_a_torque_and_no_read_out():
    """Over the stiffness a torque is the same shift: friction and damping act beside both."""
    command = commands_of(SAMPLES)
    by_component = likelihoods_in_loop(log_of(command, shown_by_command(command)))
    others = by_component["command"] - by_component["read-out"]
    assert others > 50.0
    assert abs(by_component["command"] - by_component[""]) < 0.2 * others


def test_a_late_command_that_is_off_is_told_from_a_torque():
    """What is commanded passes the delay of a servo, and a torque does not."""
    command = commands_of(SAMPLES)
    log = log_of(command, shown_by_command(command, delay=0.05), SERVO | {"delay_s": 0.05})
    by_component = likelihoods_in_loop(log)
    assert by_component["command"] > by_component[""] + 50.0


def test_a_shift_is_of_the_command_or_of_the_read_out():
    with pytest.raises(InputError, match="component 'current' is not possible; give command, read-out, or none"):
        UnnamedInLoop(1, "time", 0.0, 1.0, component="current")


def test_a_prediction_beyond_the_driver_of_a_shift_is_outside():
    log = log_of(commands_of(SAMPLES), shown_by_encoder(commands_of(SAMPLES)))
    problem = along_rollout(tracking_problem(tracking_rows(log, PENDULUM)), Terms(), np.zeros(0))
    shift = problem.components[0].alike[1]
    time = next(one for one in problem.quantities if one.driver.phrase == "time")
    fitted = fit(problem, Terms((problem.process(shift, [time], "smooth", RAD),)), EngineOptions())
    readout = problem.readouts(np.zeros(0), fitted.terms, fitted.values)
    model = diagnosed_servos(problem, problem.servo, fitted.terms, fitted.values, readout)
    times = np.arange(SAMPLES) * PERIOD
    command = commands_of(SAMPLES)[:, None]
    assert not model.predict(times, command).outside.any()
    assert model.predict(times + 60.0, command).outside.all()
