"""Masses that the sidecar calls unknown or uncertain, beside commands."""

from dataclasses import replace

import numpy as np
import pytest
from typed import refused

from lite6jax.domains.tracking.fit import fit_servos
from lite6jax.domains.tracking.problem import tracking_problem
from lite6jax.domains.tracking.screening import screen_tracking
from lite6jax.estimation.terms import Terms
from tests.domains.tracking.test_servo_fit import PENDULUM, SERVO, commands_of, record
from tests.domains.tracking.test_tracking_commands import NOISE, columns_of, write_log

SAMPLES = 300
MASSLESS = replace(PENDULUM, mass=None, center_of_mass=None, inertia=None)


def of_masses(log, inertial):
    return replace(log, settings=replace(log.settings, inertial=inertial))


@pytest.mark.parametrize("servo", [SERVO, "unknown"])
def test_unknown_masses_are_those_of_an_arm_without_any(servo):
    log = record(commands_of(SAMPLES), servo)
    declared, unknown, without = (
        tracking_problem(screen_tracking(of_masses(log, inertial), arm).data)
        for inertial, arm in (("declared", PENDULUM), ("unknown", PENDULUM), ("declared", MASSLESS))
    )
    assert not unknown.data.bodies.links.any()
    assert not unknown.data.has_masses
    assert unknown.candidates == without.candidates
    assert unknown.untestable == without.untestable
    rolled = [
        problem.readouts(np.zeros(len(problem.unknowns)), Terms(), np.zeros(0))
        for problem in (declared, unknown, without)
    ]
    assert np.array_equal(rolled[1], rolled[2])
    assert np.abs(rolled[0] - rolled[1]).max() > 5e-4  # the pendulum sags


def test_servos_are_fitted_without_masses():
    log = record(commands_of(SAMPLES), "unknown")
    fits = [fit_servos(of_masses(log, "unknown"), PENDULUM), fit_servos(log, MASSLESS)]
    assert fits[0].stiffness == pytest.approx(fits[1].stiffness)


def test_uncertain_masses_are_refused_in_one_line(capsys, tmp_path):
    path = write_log(tmp_path, columns_of(commands_of(SAMPLES), NOISE), noise=NOISE)
    sidecar = path.with_suffix(".yaml")
    text = sidecar.read_text()
    sidecar.write_text(text + "  inertial: 0.1\n")
    said = refused(capsys, "diagnose", path)
    assert "recording.inertial is 0.1" in said
    assert "write inertial: declared, or inertial: unknown" in said
