"""How friction holds joints at rest: rigidly, or creeping, and where it holds them before a motion begins."""

from dataclasses import replace

import numpy as np
import pytest

from lite6jax.diagnosis.tracking_diagnosis import diagnose_tracking, interleaved_folds
from lite6jax.domains.tracking.growth import grown
from lite6jax.domains.tracking.model import TrackingModel
from lite6jax.domains.tracking.predict import friction_share_of, resting_positions
from lite6jax.domains.tracking.problem import diagnosed_servos, tracking_problem
from lite6jax.domains.tracking.rows import tracking_rows
from lite6jax.effects.servo import RIGID_GRIP
from lite6jax.estimation.least_squares import relinearise
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.terms import Terms
from tests.domains.tracking.test_servo_fit import LEVER, MASS, PENDULUM, PERIOD, SERVO, TRUE, commands_of, record
from tests.oracles.servos import follow

KP = 200.0
FRICTION = 0.2


def steps_of(samples, seed=1):
    """Steps with a hold of 0.8 s after each, `(sample,)` rad."""
    heights = np.random.default_rng(seed).uniform(-0.5, 0.5, -(-samples // 80))
    return np.repeat(heights, 80)[:samples]


def held_by(grip, friction=FRICTION):
    problem = tracking_problem(tracking_rows(record(commands_of(100), SERVO), PENDULUM))
    servo = problem.servo._replace(grip=np.array([grip]), coulomb=np.array([friction]))
    return TrackingModel(servo, problem.data.bodies)


def share_in(model, command, readout, at_rest=True):
    return friction_share_of(model, command, readout, np.full(command.shape, at_rest))


@pytest.mark.parametrize("share", [-1.0, 0.0, 0.3])
def test_a_joint_rests_where_servo_weight_and_friction_balance(share):
    model = held_by(RIGID_GRIP)
    command = np.array([[0.4, -0.7]])
    position = resting_positions(model, command, np.array([share]))
    left = KP * (command - position) - 9.81 * MASS * LEVER * np.sin(command)
    assert left == pytest.approx(np.full((1, 2), -share * FRICTION), abs=1e-9)
    assert share_in(model, command, position) == pytest.approx([share], abs=1e-9)
    shown = replace(model, servo=model.servo._replace(offset=np.array([0.01]), scale=np.array([-0.02])))
    assert share_in(shown, command, 0.98 * position + 0.01) == pytest.approx([share], abs=1e-6)
    assert share_in(model, command, position, at_rest=False) == pytest.approx([0.0])


@pytest.mark.parametrize(("grip", "friction"), [(0.5, FRICTION), (RIGID_GRIP, 0.0)])
def test_a_joint_that_moves_to_its_balance_begins_at_its_command(grip, friction):
    model = held_by(grip, friction)
    command = np.array([[0.4]])
    assert np.array_equal(resting_positions(model, command, np.array([1.0])), command)
    assert share_in(model, command, command + 0.1) == pytest.approx([0.0])


def test_where_a_joint_rests_is_within_its_friction():
    assert share_in(held_by(RIGID_GRIP), np.zeros((1, 2)), np.full((1, 2), 0.4)) == pytest.approx([1.0])


def test_logs_with_several_payloads_have_a_model():
    log = record(commands_of(200), SERVO)
    log = replace(log, payload=np.repeat([0.0, 0.5], 100), run=np.repeat([0, 1], 100))
    problem = tracking_problem(tracking_rows(log, PENDULUM))
    readout = problem.readouts(np.zeros(0), Terms(), np.zeros(0))
    model = diagnosed_servos(problem, problem.servo, Terms(), np.zeros(0), readout)
    assert np.isfinite(model.friction_share).all()


def unknown_servos(creep=0.0):
    """Servos of which nothing is known, as `grown` finds them in a log of steps and holds."""
    log = record(np.r_[commands_of(400), steps_of(400)], "unknown", coulomb=1.5, creep=creep)
    problem = relinearise(tracking_problem(tracking_rows(log, PENDULUM).coarse), EngineOptions(), steps=8)
    return grown(problem, interleaved_folds(problem.run), 1e-3, problem.data)


def test_unknown_servos_of_a_log_that_shows_creeping_creep():
    servos = unknown_servos(creep=0.03)
    assert servos.problem.servo.grip[0] < 10 * servos.problem.data.servo.grip[0]


def test_unknown_servos_hold_still():
    servos = unknown_servos()
    there = servos.problem.relinearised(servos.nuisance)
    assert there.servo.grip == pytest.approx([RIGID_GRIP])
    readout = there.readouts(np.zeros(len(servos.nuisance)), servos.terms, servos.values)
    model = diagnosed_servos(there, there.servo, servos.terms, servos.values, readout)
    command = steps_of(400, seed=4)
    predicted = model.predict(np.arange(400) * PERIOD, command[:, None]).position[:, 0]
    truth = follow(command, PERIOD, **(TRUE | {"coulomb": 1.5}))
    # the second half of each hold
    held = (np.arange(400) % 80) >= 40
    moved = np.abs(np.diff(predicted))[held[1:] & held[:-1]]
    assert moved.max() < 1e-6
    assert np.sqrt(np.mean((predicted - truth)[held] ** 2)) < 1.5e-3


def test_friction_that_lets_its_joint_creep_has_a_grip_of_its_own():
    creep = {"coulomb": 1.7, "creep": 0.004}
    log = record(np.r_[commands_of(300), steps_of(320)], SERVO, fine=400, **creep)
    diagnosis = diagnose_tracking(log, PENDULUM)
    assert diagnosis.findings[0].effect.label == "coulomb_friction:joint1"
    assert diagnosis.findings[0].values == pytest.approx([1.5], rel=0.05)
    nominal = diagnosis.problem.data.servo.grip
    assert diagnosis.model.servo.grip[0] < 0.8 * nominal[0]
    command = steps_of(400, seed=4)
    truth = follow(command, PERIOD, **(TRUE | creep | {"fine": 400}))
    time = np.arange(400) * PERIOD
    model = diagnosis.model
    stiff = replace(model, servo=model.servo._replace(grip=nominal))
    errors = [
        np.sqrt(np.mean((one.predict(time, command[:, None]).position[:, 0] - truth) ** 2)) for one in (model, stiff)
    ]
    assert errors[0] < 0.7 * errors[1]
