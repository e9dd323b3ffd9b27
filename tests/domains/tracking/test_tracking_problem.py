"""The estimation problem of commands and measured joints: its columns against differences of its exact residuals."""

from dataclasses import replace

import numpy as np
import pytest

from lite6jax import diagnose
from lite6jax.domains.tracking.model import units_along
from lite6jax.domains.tracking.problem import along_rollout, tracking_problem
from lite6jax.domains.tracking.rows import tracking_rows
from lite6jax.effects.dynamic import CoulombFriction
from lite6jax.effects.servo import RateLimit, TorqueLimit
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.problem import contribution, linearised_at
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording
from tests.domains.tracking.test_servo_fit import PENDULUM, PERIOD, SERVO, TRUE, commands_of, record

SAMPLES = 600


@pytest.fixture(scope="module")
def problem():
    return tracking_problem(tracking_rows(record(commands_of(SAMPLES), SERVO), PENDULUM))


def test_accelerations_beside_a_rollout_are_free_of_the_noise_of_encoders():
    """In a motion of steps, whose band is wide, against the motion without noise."""
    command = np.repeat([0.0, 0.4, -0.3, 0.5, 0.1], SAMPLES // 5)
    quiet = tracking_rows(record(command, SERVO, sigma=0.0), PENDULUM)
    noisy = tracking_rows(record(command, SERVO, sigma=1e-3), PENDULUM)
    beside = along_rollout(tracking_problem(noisy), Terms(), np.zeros(0)).data
    true, measured, rolled = (np.asarray(data.motion.joint_acceleration) for data in (quiet, noisy, beside))
    assert np.std(measured - true) > 5 * np.std(rolled - true)


def test_a_motion_beside_a_rollout_has_what_the_rollout_lacks():
    """A servo that is late by 60 ms: read-outs clearly show what a rollout without that lacks."""
    command = commands_of(SAMPLES)
    late = tracking_rows(record(command, SERVO, delay=0.06), PENDULUM)
    moved = along_rollout(tracking_problem(late), Terms(), np.zeros(0)).data
    both = (np.asarray(data.motion.joint_position)[0] for data in (late, moved))
    np.testing.assert_allclose(*both, atol=0.02 * np.std(late.measured))


def slope(problem, effect, k, step, beside=(), values=()):
    """The difference of residuals by one number of an effect, beside other effects with their values."""
    terms = Terms((*beside, effect))
    none = np.zeros(len(problem.precision))
    start = np.concatenate([values, np.zeros(effect.size)])
    moved = start.copy()
    moved[len(values) + k] = step
    return (problem.residual(none, terms, moved) - problem.residual(none, terms, start)) / step


def apart(column, other):
    """The distance of two columns over the length of one."""
    return np.linalg.norm(column - other) / np.linalg.norm(other)


def test_columns_are_how_exact_residuals_change(problem):
    for effect in problem.candidates:
        columns = problem.columns([effect])
        for k, coordinate in enumerate(effect.coordinates):
            if coordinate.unit in ("s/rad", "1/Nm"):
                continue  # of limits that are not reached: see below
            exact = slope(problem, effect, k, coordinate.typical)
            label = f"{effect.label}: {coordinate.name}"
            if label in ("base_tilt:base: tilt_x_rad", "link_com:link1: z_m"):  # about and along the joint's own axis
                assert not columns[k].any()
            else:
                assert apart(columns[k], exact) < 0.05, label


def test_the_column_of_a_limit_is_one_of_a_limit_that_is_reached(problem):
    column = problem.columns([RateLimit(1)])[0]
    assert np.abs(column).max() > 100 * np.abs(slope(problem, RateLimit(1), 0, 1e-3)).max()


def test_columns_beside_a_term_are_those_at_its_numbers(problem):
    friction = Terms((CoulombFriction(1),))
    numbers = np.array([2.0])
    for effect in problem.candidates:
        if effect.name in ("command_delay", "servo_stiffness"):
            column = problem.columns([effect], beside=(friction, numbers))[0]
            exact = slope(problem, effect, 0, effect.coordinates[0].typical, friction.terms, numbers)
            assert apart(column, exact) < 0.05
            assert apart(column, exact) < 0.5 * apart(problem.columns([effect])[0], exact)


def test_a_process_is_a_torque_through_the_loop(problem):
    quantity = next(one for one in problem.quantities if one.driver.phrase == "position of joint 1")
    process = problem.process(problem.components[0], [quantity], "line", 0.5)
    columns = problem.columns([process])
    # slow: the torque over the stiffness, later by the lag of the servo
    quasi_static = problem.components[0].column * process.functions_of(problem.data.dynamics)[:, None]
    assert columns.shape == quasi_static.shape
    for column, expected in zip(columns, quasi_static, strict=True):
        lagged = [apart(column[:, lag:], expected[:, : SAMPLES - lag]) for lag in range(12)]
        assert min(lagged) < 0.35


def test_fewer_samples_are_rows_of_all(problem):
    few = problem.thinned(7)
    none = np.zeros(len(problem.precision))
    terms = Terms(problem.candidates[:1])
    values = np.full(terms.size, 0.01)
    assert few.samples == len(range(0, SAMPLES, 7))
    assert np.array_equal(few.residual(none, terms, values), problem.residual(none, terms, values)[:, ::7])
    assert np.array_equal(few.columns(terms.terms), problem.columns(terms.terms)[..., ::7])


def test_unknown_servos_are_a_nuisance_that_moves_to_where_it_is_linearised():
    problem = tracking_problem(tracking_rows(record(commands_of(SAMPLES), "unknown"), PENDULUM))
    assert [one.field for one in problem.unknowns] == ["stiffness", "damping"]
    assert not {"servo_stiffness", "servo_damping", "viscous_friction"} & {one.name for one in problem.candidates}
    step = np.array([0.01, -0.02])
    moved = problem.relinearised(step)
    here = problem.residual(step, Terms(), np.zeros(0))
    assert moved.residual(np.zeros(2), Terms(), np.zeros(0)) == pytest.approx(here, abs=1e-9)
    assert moved.offset == pytest.approx(step)
    columns = problem.nuisance_columns(Terms(), np.zeros(0))
    for k, column in enumerate(columns):
        number = 0.01 * np.eye(2)[k]
        change = problem.residual(number, Terms(), np.zeros(0)) - problem.residual(np.zeros(2), Terms(), np.zeros(0))
        assert apart(column, change / 0.01) < 0.05


FAR = np.array([1.5, -0.8])
"""Of the logarithms of stiffness and damping."""


@pytest.fixture(scope="module")
def unknown():
    return tracking_problem(tracking_rows(record(commands_of(SAMPLES), "unknown"), PENDULUM))


def test_columns_at_a_nuisance_are_how_residuals_change_there(unknown):
    friction = CoulombFriction(1)
    terms = Terms((friction,))
    there = linearised_at(unknown, FAR)
    column = there.columns([friction])[0]
    step = friction.coordinates[0].typical
    change = unknown.residual(FAR, terms, np.array([step])) - unknown.residual(FAR, terms, np.zeros(1))
    assert apart(column, change / step) < 0.05
    assert apart(unknown.columns([friction])[0], change / step) > 0.3
    stiffness = there.nuisance_columns(Terms(), np.zeros(0))[0]
    number = np.array([0.01, 0.0])
    change = unknown.residual(FAR + number, Terms(), np.zeros(0)) - unknown.residual(FAR, Terms(), np.zeros(0))
    assert apart(stiffness, change / 0.01) < 0.05
    assert linearised_at(unknown, np.full(2, 0.001)) is unknown


def test_what_a_limit_contributes_is_a_difference_of_rollouts(unknown):
    limit = Terms((RateLimit(1),))
    friction = Terms((CoulombFriction(1),))
    model = Terms((*limit.terms, *friction.terms))
    numbers = np.array([2.0, 0.3])
    none = np.zeros(len(unknown.precision))
    contributed = contribution(unknown, limit, numbers[:1], (model, numbers))
    both = unknown.residual(none, model, numbers)
    assert contributed == pytest.approx(both - unknown.residual(none, friction, numbers[1:]), abs=1e-9)
    assert np.abs(contributed).max() > 100.0


def test_fitted_friction_beside_unknown_servos_is_never_less_than_none():
    problem = tracking_problem(tracking_rows(record(commands_of(SAMPLES), "unknown", coulomb=0.0), PENDULUM))
    fitted = fit(problem, Terms((CoulombFriction(1),)), EngineOptions())
    assert fitted.values == pytest.approx([-0.2], abs=0.01)  # of the description, all that can be taken away
    assert fitted.values >= -0.2


def test_a_rate_limit_beside_a_servo_of_which_nothing_is_known_is_found():
    # without the limit the servo that comes nearest to such a joint is of any stiffness
    time = np.maximum(np.arange(SAMPLES) * PERIOD - 0.3, 0.0)
    command = np.round(0.5 * np.sin(2 * np.pi * 0.4 * time) + 0.15 * np.sin(2 * np.pi * 1.3 * time), 6)
    log = record(command, "unknown", rate=0.8)
    document = diagnose(log, PENDULUM).to_dict()
    assert [(finding["effect"], finding["site"]) for finding in document["findings"]] == [("rate_limit", "joint1")]
    velocity = document["findings"][0]["parameters"]["velocity_rad_per_s"]
    assert velocity["value"] == pytest.approx(0.8, rel=2e-3)
    assert document["servos"][0]["stiffness_Nm_per_rad"] == pytest.approx(200.0, rel=0.1)
    after = document["after"]["heldout_rollout_rms_rad"]
    assert after < 0.005 * document["before"]["heldout_rollout_rms_rad"]


def test_each_run_is_rolled_out_with_its_own_payload():
    """Against the oracle, whose pendulum carries nothing in one run and 1.5 kg in the other."""
    mass = 1.5
    reach = 0.1  # of the payload's centre below the axis, as `record` declares it
    loaded = {"weight": TRUE["weight"] + 9.81 * mass * reach, "inertia": TRUE["inertia"] + mass * reach**2}
    empty = record(commands_of(400), SERVO)
    other = record(commands_of(400, seed=3), SERVO, **loaded)
    command = np.r_[commands_of(400), commands_of(400, seed=3)]
    both = Recording.assembled(
        np.concatenate([empty.joint_position, other.joint_position]),
        commanded_position=command[:, None],
        time=np.r_[empty.time, other.time + 20.0],
        payload=np.repeat([0.0, mass], 400),
        run=np.repeat([0, 1], 400),
        settings=empty.settings,
    )
    problem = tracking_problem(tracking_rows(both, PENDULUM))
    errors = problem.residual(np.zeros(0), Terms(), np.zeros(0)) * problem.sigma
    # friction of the oracle holds without creeping, which is worth some of this
    assert np.sqrt(np.mean(errors[:, :400] ** 2)) < 1.5e-4
    assert np.sqrt(np.mean(errors[:, 400:] ** 2)) < 1.5e-4
    without = tracking_problem(tracking_rows(replace(both, payload=np.zeros(800)), PENDULUM))
    missed = without.residual(np.zeros(0), Terms(), np.zeros(0)) * without.sigma
    assert np.sqrt(np.mean(missed[:, 400:] ** 2)) > 1e-3


def test_friction_over_the_position_holds_a_joint_at_rest():
    u = commands_of(500)
    log = record(u, SERVO, sticky=lambda q: 1.5 * np.exp(-(((q - 0.1) / 0.2) ** 2)), fine=400)
    problem = tracking_problem(tracking_rows(log, PENDULUM))
    by_phrase = {one.driver.phrase: one for one in problem.quantities}
    where = [by_phrase[f"{name} of joint 1"] for name in ("position", "direction of motion")]
    assert np.abs(where[1].values).max() == 1.0
    process = problem.process(problem.components[0], where, "rough*line", 2.0)
    before = fit(problem, Terms(), EngineOptions())
    after = fit(problem, Terms((process,)), EngineOptions())
    assert after.scale[0] == 1.0  # the noise
    assert before.scale[0] > 50 * after.scale[0]
    along = units_along(process, problem.data.dynamics)
    at = problem.data.dynamics.motion._replace(direction=np.ones((1, len(u))))
    forward = process.at_joint(after.values, problem.data.dynamics._replace(motion=at))
    assert np.tensordot(after.values, along, 1).sum(1)[0] == pytest.approx(forward, abs=1e-9)


@pytest.mark.parametrize(("sigma", "servo", "coupled"), [(1e-3, SERVO, True), (1e-3, "unknown", False)])
def test_declared_servos_are_rolled_out_exactly_whatever_the_noise(sigma, servo, coupled):
    rows = tracking_rows(record(commands_of(SAMPLES), servo, sigma=sigma), PENDULUM)
    assert rows.coupled is coupled
    assert (rows.commands.step < 2e-3) is coupled


def test_a_fit_of_a_limit_begins_near_it():
    log = record(commands_of(SAMPLES), SERVO, sigma=1e-4, limit=12.0)
    problem = tracking_problem(tracking_rows(log, PENDULUM))
    start = problem.likeliest_start(TorqueLimit(1), Terms(), np.zeros(0))
    assert 1 / start[0] == pytest.approx(12.0, rel=0.5)
    # where there is no limit, none of them is nearer than none
    free = tracking_problem(tracking_rows(record(commands_of(SAMPLES), SERVO), PENDULUM))
    assert not free.likeliest_start(TorqueLimit(1), Terms(), np.zeros(0)).any()


def test_a_limit_that_is_reached_but_seldom_is_no_function_of_the_speed():
    """The names of a joint are fitted before a process, which follows what columns at one limit show, is taken."""
    document = diagnose(record(commands_of(SAMPLES), SERVO, sigma=1e-4, limit=12.0), PENDULUM).to_dict()
    assert [(finding["effect"], finding["site"]) for finding in document["findings"]] == [("torque_limit", "joint1")]
    limit = document["findings"][0]["parameters"]["torque_Nm"]
    assert limit["value"] == pytest.approx(12.0, rel=0.01)


def test_a_fit_of_a_limit_that_is_hardly_reached_begins_below_what_is_asked_for():
    command = commands_of(SAMPLES)
    problem = tracking_problem(tracking_rows(record(command, SERVO), PENDULUM))
    asked = TRUE["kp"] * np.max(np.abs(command - problem.readouts(np.zeros(0), Terms(), np.zeros(0))[0]))
    limit = 0.95 * asked
    limited = tracking_problem(tracking_rows(record(command, SERVO, limit=limit), PENDULUM))
    (start,) = limited.likeliest_start(TorqueLimit(1), Terms(), np.zeros(0))
    assert 1 / start == pytest.approx(limit, rel=0.03)
