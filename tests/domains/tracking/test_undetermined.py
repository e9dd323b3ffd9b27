"""What a log of commands does not determine is said by name, with what to record; what does not show is not tested."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typed import flat, run

from lite6jax.arms.description import load_bundled
from lite6jax.domains.tracking.problem import tracking_problem
from lite6jax.domains.tracking.screening import screen_tracking
from lite6jax.domains.tracking.undetermined import undetermined
from lite6jax.effects.effect import OfJoint
from lite6jax.recordings import read_recording
from lite6jax.simulation import simulate_tracking
from tests.domains.tracking.test_servo_fit import PENDULUM, PERIOD, commands_of
from tests.domains.tracking.test_tracking_commands import NOISE, columns_of, write_log

LITE6 = load_bundled("lite6")
MASSLESS = replace(LITE6, **dict.fromkeys(("mass", "center_of_mass", "inertia")))
SAMPLES = 400
T = np.maximum(np.arange(SAMPLES) * PERIOD - 0.3, 0.0)


def problem_of(command, arm=LITE6):
    """The problem of a simulated log, screened; commands beside the first joints are at rest."""
    motion = np.zeros((SAMPLES, 6))
    motion[:, : command.shape[1]] = command
    log = simulate_tracking(LITE6, motion, samples=SAMPLES, joint_noise=2e-5, servo_known=True, seed=1).recording
    return tracking_problem(screen_tracking(log, arm).data)


@pytest.fixture(scope="module")
def problem():
    """Joint 1 goes one way, joint 2 to and fro with rests, joint 3 without end; joints 4 to 6 hold still."""
    waves = 0.4 * np.sin(2 * np.pi * 0.5 * T)
    shaken = 0.4 * np.sin(2 * np.pi * 0.5 * (T + 0.3) + 1e-3)
    return problem_of(np.stack([0.5 * T / T[-1], waves, shaken - shaken[0] + 1e-5 * np.arange(SAMPLES)], 1))


def by_reason(problem):
    return {entry.lacks: entry for entry in undetermined(problem.data)}


def test_each_reason_names_its_joints(problem):
    reasons = by_reason(problem)
    assert reasons["motion"].joints == (6,)
    assert reasons["command"].joints == (4, 5)  # the motion of the others makes them give way
    assert reasons["reversal"].joints == (1,)
    assert reasons["rest"].joints == (3,)
    assert reasons["reversal"].effects == ("coulomb_friction", "dead_band", "backlash")
    assert "masses" not in reasons


def candidates_at(problem, joint):
    return {effect.name for effect in problem.candidates if isinstance(effect, OfJoint) and effect.joint == joint}


def test_what_does_not_show_is_no_candidate(problem):
    everything = candidates_at(problem, 1)
    of_commands = {"command_delay", "command_filter", "rate_limit", "servo_feedforward"}
    assert of_commands | {"coulomb_friction", "dead_band", "backlash"} <= everything
    assert candidates_at(problem, 4) == everything - of_commands
    assert candidates_at(problem, 6) == {"servo_stiffness", "encoder_offset"}
    assert {item.driver.phrase for item in problem.untestable} == {f"velocity of joint {j}" for j in (4, 5, 6)}
    assert not {item.effect for item in problem.untestable} & set(problem.candidates)


def test_joints_that_move_in_noise_alone_are_at_rest_whether_it_is_declared_or_not(problem):
    data = problem.data
    noise = np.random.default_rng(3).normal(0.0, 3e-3, data.measured.shape)
    noisy = replace(data, measured=data.measured + noise)
    assert by_reason(replace(problem, data=noisy))["motion"].joints == (4, 5, 6)


def test_without_masses_the_effects_of_loads_are_untestable(problem):
    data = problem.data
    massless = replace(data, arm=MASSLESS, bodies=replace(data.bodies, links=np.zeros_like(data.bodies.links)))
    other = tracking_problem(massless)
    loaded = ("payload_error", "base_tilt", "load_friction", "link_mass", "link_com")
    assert by_reason(other)["masses"].effects == loaded
    of_loads = {item.effect.name for item in other.untestable if item.driver.loaded}
    assert of_loads == set(loaded)
    assert "load" not in by_reason(other)


def test_the_report_and_the_document_say_it(capsys, tmp_path):
    # about the horizontal the weight of a pendulum is nearly constant; the command never rests and reverses
    command = 1.5 + 0.1 * np.sin(2 * np.pi * 0.8 * np.arange(300) * PERIOD)
    path = write_log(tmp_path, columns_of(command, NOISE), noise=NOISE)
    code, out, _ = run(capsys, "diagnose", path, "--quick", "--out", tmp_path / "d.json", width=120)
    said = flat(out)
    assert code == 0
    assert "Not determined by this log" in said
    assert "No rest of joint 1: Coulomb friction and backlash are hardly told apart. Record rests under load" in said
    confounded = "servo stiffness, encoder offset and payload error cannot be told apart"
    assert f"No change of the weight on joint 1: {confounded}" in said
    document = json.loads((tmp_path / "d.json").read_text())
    assert [(entry["lacks"], entry["joints"]) for entry in document["undetermined"]] == [("rest", [1]), ("load", [1])]
    code, out, _ = run(capsys, "report", tmp_path / "d.json", width=120)
    assert "No rest of joint 1" in flat(out)


def test_a_log_with_all_of_it_is_not_told_to_record_more(tmp_path):
    path = write_log(tmp_path, columns_of(commands_of(300), NOISE), noise=NOISE)
    data = screen_tracking(read_recording(path), PENDULUM).data
    assert undetermined(data) == []
    assert tracking_problem(data).untestable == ()
