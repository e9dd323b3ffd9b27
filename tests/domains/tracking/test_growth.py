"""Names chosen by rollouts on held-out rows: what the oracle has is found in long steps, and nothing beside it."""

import numpy as np
import pytest

from lite6jax.diagnosis.tracking_diagnosis import interleaved_folds
from lite6jax.domains.tracking.growth import grown
from lite6jax.domains.tracking.problem import tracking_problem
from lite6jax.domains.tracking.rows import tracking_rows
from lite6jax.effects.dynamic import CoulombFriction
from lite6jax.estimation.least_squares import relinearise
from lite6jax.estimation.options import EngineOptions
from lite6jax.recordings import Recording
from tests.domains.tracking.test_servo_fit import PENDULUM, commands_of, record

SAMPLES = 600


def grown_of(log, enough=3e-4):
    data = tracking_rows(log, PENDULUM).coarse
    problem = relinearise(tracking_problem(data), EngineOptions(), steps=8)
    servos = grown(problem, interleaved_folds(problem.run), enough, problem.data)
    there = servos.problem.relinearised(servos.nuisance)
    errors = there.residual(np.zeros(len(servos.nuisance)), servos.terms, servos.values) * there.sigma
    return there.servo, servos.terms, servos.values, float(np.sqrt(np.mean(errors**2)))


def test_friction_that_the_description_lacks_is_named_in_long_steps():
    servo, terms, values, error = grown_of(record(commands_of(SAMPLES), "unknown", coulomb=1.5), enough=1e-3)
    numbers = dict(zip(terms.terms, (values[part] for part in terms.slices), strict=True))
    assert numbers[CoulombFriction(1)] == pytest.approx([1.3], rel=0.05)
    assert servo.stiffness == pytest.approx([200.0], rel=0.03)
    assert error < 1e-3


def test_a_joint_with_small_errors_has_no_names():
    _, terms, _, error = grown_of(record(commands_of(SAMPLES), "unknown"), enough=1.0)
    assert terms.terms == ()
    assert error < 1.0


def test_a_servo_of_which_nothing_is_known_may_be_soft():
    # a gain that is neither that of a gear nor of degrees is what gravity leaves of the command
    q = 0.28 * commands_of(SAMPLES)[:, None]
    late = np.vstack([q[:1], q[:-1]])
    log = Recording.from_arrays(
        late, arm=PENDULUM, time=np.arange(SAMPLES) * 0.01, commanded_position=q / 0.28, motion="trajectory"
    )
    assert tracking_rows(log, PENDULUM).measured.shape == (1, SAMPLES)
