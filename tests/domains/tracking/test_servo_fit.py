"""Servos fitted to rollouts: what is planted is found, held-out errors fall, and other motions are predicted."""

import numpy as np
import pytest

from lite6jax.arms.arm import Arm
from lite6jax.domains.tracking.fit import fit_servos
from lite6jax.domains.tracking.model import TrackingModel, with_effect
from lite6jax.domains.tracking.problem import NO_BODIES
from lite6jax.effects.catalogue import tracking_catalogue
from lite6jax.effects.servo import CommandDelay, DeadBand, EncoderBacklash, Servo, ServoFeedforward
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from tests.oracles.servos import follow

PERIOD = 0.01
MASS = 1.2
LEVER = 0.15
PENDULUM = Arm(
    "pendulum",
    np.array([[0.0, 0.0, 0.0, np.pi / 2, 0.0, 0.0]]),
    mass=np.array([MASS]),
    center_of_mass=np.array([[0.0, -LEVER, 0.0]]),
    inertia=1e-9 * np.eye(3)[None],
    rotor_inertia=np.array([0.1]),
    viscous_friction=np.array([0.5]),
    coulomb_friction=np.array([0.2]),
)
"""It hangs at zero."""
TRUE = {
    "inertia": 0.1 + MASS * LEVER**2,
    "weight": 9.81 * MASS * LEVER,
    "coulomb": 0.2,
    "viscous": 0.5,
    "kp": 200.0,
    "kd": 8.0,
}
SERVO = {"stiffness_Nm_per_rad": [200.0], "damping_Nm_s_per_rad": [8.0]}


def commands_of(samples, seed=1):
    """A pause, sines, and steps, `(sample,)` rad."""
    t = np.maximum(np.arange(samples) * PERIOD - 0.3, 0.0)
    phase = 0.2 * seed
    sines = 0.5 * np.sin(2 * np.pi * 0.4 * t + phase) + 0.15 * np.sin(2 * np.pi * 1.3 * t) - 0.5 * np.sin(phase)
    return np.round(sines + 0.1 * (np.floor(t / 0.9) % 2), 6)


def record(command, servo, run=None, sigma=2e-5, **changed):
    """A recording of the oracle, with encoders that scatter by 20 µrad, or by `sigma`."""
    q = follow(command, PERIOD, **(TRUE | changed))
    noise = np.random.default_rng(5).normal(0.0, sigma, len(q))
    return Recording.from_arrays(
        (q + noise)[:, None],
        arm=PENDULUM,
        time=np.arange(len(q)) * PERIOD,
        commanded_position=command[:, None],
        run=run,
        motion="trajectory",
        joint_noise_rad=max(sigma, 2e-5),
        payload_com_m=(0.0, -0.1, 0.0),
        servo=servo,
    )


@pytest.fixture(scope="module")
def softer():
    """The fit of a servo that is softer and later than declared."""
    return fit_servos(record(commands_of(600), SERVO, kp=150.0, delay=0.02, coulomb=0.6), PENDULUM)


def test_a_soft_and_late_servo_with_more_friction_is_found(softer):
    found = softer.parameters
    assert found["servo_stiffness:joint1"]["ratio"].value == pytest.approx(0.75, rel=2e-3)
    assert found["command_delay:joint1"]["delay_s"].value == pytest.approx(0.02, abs=2e-4)
    assert found["coulomb_friction:joint1"]["coulomb_Nm"].value == pytest.approx(0.4, rel=0.02)
    assert found["servo_damping:joint1"]["ratio"].value == pytest.approx(1.0, abs=0.02)
    assert softer.stiffness == pytest.approx([150.0], rel=2e-3)
    assert softer.lag == pytest.approx([8.5 / 150.0], rel=0.02)


def test_errors_on_blocks_that_were_not_fitted_fall_to_the_noise(softer):
    errors = softer.heldout
    assert errors.after < 4e-5
    assert errors.before > 20 * errors.after
    assert errors.before < errors.commanded
    assert errors.best_delay < errors.commanded


def test_another_motion_is_predicted_from_its_commands(softer):
    command = commands_of(500, seed=4)
    truth = follow(command, PERIOD, **(TRUE | {"kp": 150.0, "delay": 0.02, "coulomb": 0.6}))
    time = np.arange(500) * PERIOD
    predicted = softer.predict(time, command[:, None])
    assert np.sqrt(np.mean((predicted.position[:, 0] - truth) ** 2)) < 5e-5


def test_rows_faster_than_the_log_are_outside(softer):
    time = np.arange(600) * PERIOD
    assert not softer.predict(time, commands_of(600)[:, None]).outside.any()
    fast = softer.predict(time, 3 * commands_of(600)[:, None])
    assert fast.outside.any()
    assert not fast.outside[:20].any()  # it rests


def test_runs_are_predicted_one_by_one(softer):
    command = commands_of(300, seed=4)
    time = np.arange(300) * PERIOD
    alone = softer.predict(time, command[:, None]).position
    both = softer.predict(np.r_[time, time], np.r_[command, command][:, None], np.repeat([0, 1], 300)).position
    assert both == pytest.approx(np.vstack([alone, alone]), abs=1e-9)


def test_a_servo_of_which_nothing_is_declared_is_found():
    found = fit_servos(record(commands_of(600), "unknown"), PENDULUM)
    assert found.stiffness == pytest.approx([200.0], rel=0.01)
    assert found.lag == pytest.approx([8.5 / 200.0], rel=0.03)
    assert found.heldout.after < 5e-5


def test_what_is_to_be_fitted_can_be_chosen():
    found = fit_servos(record(commands_of(600), SERVO, play=0.002), PENDULUM, effects=[EncoderBacklash(1)])
    assert list(found.parameters) == ["backlash:joint1"]
    width = found.parameters["backlash:joint1"]["half_width_rad"]
    assert width.value == pytest.approx(0.002, rel=0.02)
    assert 0 < width.std < 1e-4


def test_a_feed_forward_of_velocity_is_measured():
    log = record(commands_of(600), SERVO, feedforward=3.0)
    found = fit_servos(log, PENDULUM, effects=[ServoFeedforward(1)])
    part = found.parameters["servo_feedforward:joint1"]["feedforward_Nm_s_per_rad"]
    assert part.value == pytest.approx(3.0, rel=0.02)
    assert found.heldout.after < 5e-5


@pytest.mark.parametrize("effect", tracking_catalogue(2), ids=lambda effect: effect.label)
def test_an_effect_changes_nothing_at_zero_and_has_a_form_for_people(effect):
    base = TrackingModel(Servo.ideal(np.full(2, 100.0), np.full(2, 5.0)), NO_BODIES)
    same = with_effect(base, effect, np.zeros(effect.size), coupled=False)
    assert all(np.array_equal(new, old) for new, old in zip(same.servo, base.servo, strict=True))
    assert not any(numbers.any() for _, numbers in same.driven)
    values = np.linspace(0.2, 0.3, effect.size)
    reported = {name: one.value for name, one in effect.reported(values).items()}
    assert effect.values_of(reported) == pytest.approx(values)


def commanded(q, command, **changed):
    values = {"time": np.arange(len(q)) * PERIOD, "commanded_position": command, "motion": "trajectory"} | changed
    return Recording.from_arrays(q, arm=PENDULUM, **values)


LINE = np.linspace(0.0, 1.0, 100)[:, None]
WAVE = 0.3 * np.sin(np.arange(800) * 0.05)[:, None]
LATE = np.vstack([np.zeros((4, 1)), WAVE[:-4]])


@pytest.mark.parametrize(
    ("recording", "message"),
    [
        (lambda: commanded(LINE, None), "has no commands; add cmd1_rad"),
        (lambda: commanded(LINE, LINE), "commands and read-outs are equal to 1e-06 rad: the log holds commands twice"),
        (lambda: commanded(LINE, 0 * LINE), "its commands never move; record a motion"),
        (lambda: commanded(LINE, LINE + 0.1, time=None), "commands need times; add time_s"),
        (lambda: commanded(LINE[:20], LINE[:20] + 0.1), "has 20 rows; record at least 51"),
        (lambda: commanded(-LATE, WAVE), "q1_rad moves against cmd1_rad; change the sign of one of them"),
        (
            lambda: commanded(LATE, 2 * WAVE),
            "q1_rad moves 0.*[0-9] times as far as cmd1_rad; give both in the same unit",
        ),
    ],
)
def test_what_is_no_tracking_recording_is_refused(recording, message):
    with pytest.raises(InputError, match=message):
        fit_servos(recording(), PENDULUM)


def test_a_joint_that_declared_servos_move_half_as_far_is_in_its_unit():
    soft = {"stiffness_Nm_per_rad": [2.4], "damping_Nm_s_per_rad": [0.3]}
    log = record(commands_of(600), soft, kp=2.4, kd=0.3)
    assert np.std(log.joint_position) == pytest.approx(0.5 * np.std(log.commanded_position), rel=0.1)
    assert fit_servos(log, PENDULUM).heldout.before < 1e-4
    stiff = {"stiffness_Nm_per_rad": [200.0], "damping_Nm_s_per_rad": [8.0]}
    with pytest.raises(InputError, match=r"q1_rad moves 0\.474 times as far as cmd1_rad"):
        fit_servos(record(commands_of(600), stiff, kp=2.4, kd=0.3), PENDULUM)


def test_exchanged_joints_are_refused():
    two = Arm("two", np.vstack([PENDULUM.kinematics, [[0.2, 0.0, 0.0, 0.0, 0.0, 0.0]]]))
    other = 0.3 * np.cos(np.arange(800) * 0.083)[:, None]
    later = np.vstack([np.tile(other[:1], (4, 1)), other[:-4]])
    time = np.arange(800) * PERIOD
    given = {"arm": two, "time": time, "motion": "trajectory"}
    recording = Recording.from_arrays(np.hstack([later, LATE]), commanded_position=np.hstack([WAVE, other]), **given)
    with pytest.raises(InputError, match="q1_rad follows cmd2_rad and not cmd1_rad; exchange the columns"):
        fit_servos(recording, two)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ([CommandDelay(2)], "command_delay:joint2 is of a joint that pendulum does not have; it has 1"),
        ([DeadBand(1), DeadBand(1)], "dead_band:joint1 is there twice; leave one out"),
        (["coulomb"], "coulomb is none on servos; take them from tracking_catalogue"),
    ],
)
def test_effects_that_cannot_be_fitted_are_refused(effects, message):
    with pytest.raises(InputError, match=message):
        fit_servos(record(commands_of(100), SERVO), PENDULUM, effects=effects)


@pytest.mark.parametrize(
    ("servo", "message"),
    [
        ({"stiffness_Nm_per_rad": [1.0, 2.0], "damping_Nm_s_per_rad": [1.0]}, "stiffness_Nm_per_rad has 2 numbers"),
        ({"stiffness_Nm_per_rad": [0.0], "damping_Nm_s_per_rad": [1.0]}, "stiffness_Nm_per_rad: is zero"),
        ({"stiffness": [1.0]}, "servo: .* is not accepted"),
        ("soft", "servo: 'soft' is not accepted"),
    ],
)
def test_a_servo_that_cannot_be_is_refused(servo, message):
    with pytest.raises(InputError, match=message):
        record(commands_of(60), servo)


@pytest.mark.parametrize(
    ("time", "command", "message"),
    [
        (np.arange(5.0), np.zeros((5, 2)), r"give \(sample,\), \(sample, 1\)"),
        (np.zeros(5), np.zeros((5, 1)), "the time does not increase in row 2"),
        (np.arange(5.0), np.full((5, 1), np.nan), "not finite; leave out such rows"),
    ],
)
def test_commands_that_cannot_be_rolled_out_are_refused(softer, time, command, message):
    with pytest.raises(InputError, match=message):
        softer.predict(time, command)
