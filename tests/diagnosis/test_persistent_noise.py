"""Read-outs that wander by themselves: noise of a joint, which no function of what was recorded explains."""

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
from diagnosis.recorded import NOISE, OPTIONS, Made, moving_motion, static_motion
from rich.console import Console

from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.options import QUICK
from lite6jax.domains.pose.problem import PoseProblem, pose_problem
from lite6jax.report.sections import diagnosis_report
from lite6jax.report.statements import with_statements
from lite6jax.search.scan import Scan
from lite6jax.search.search import search
from lite6jax.simulation import simulate

SAMPLES, COEFFICIENT, SIZE = 240, 0.97, 2e-4


def autoregression(draws, coefficient):
    """Stationary noise of first order, of independent draws `(sample, …)` of the same standard deviation."""
    states = draws.copy()
    for k in range(1, len(draws)):
        states[k] = coefficient * states[k - 1] + np.sqrt(1 - coefficient**2) * draws[k]
    return states


def wandering_problem(tmp_path, seed: int, compliance: float = 0.0) -> PoseProblem:
    """Poses of an arm whose joint 2 is read out with a first-order autoregression."""
    motion = moving_motion(seed, SAMPLES)
    steps = autoregression(SIZE * np.random.default_rng(seed).standard_normal(SAMPLES), COEFFICIENT)
    moved = motion["joint_position"].copy()
    moved[:, 1] += steps
    made = Made(tmp_path, seed=1, orientation=False)
    return pose_problem(made.recording(motion, poses=made.poses({**motion, "joint_position": moved})))


@pytest.mark.parametrize("seed", [1, 4])
def test_a_read_out_that_wanders_is_noise_of_its_joint_and_no_finding(tmp_path, seed):
    found = search(wandering_problem(tmp_path, seed), OPTIONS)
    assert found.state.tested == ()
    assert [one.term.site for one in found.wandering] == ["joint2"]
    (term,) = (one.term for one in found.wandering)
    memory = SAMPLES / np.pi / term.rolloff[0]
    assert 10 < memory < 100  # of 33 samples
    assert SIZE / 2 < term.spread < 2 * SIZE


@pytest.mark.parametrize(("declared", "verdict"), [(NOISE[0], "consistent"), (NOISE[0] / 2, "unexplained")])
def test_a_healthy_arm_whose_read_out_wanders_is_as_described(tmp_path, declared, verdict):
    """Unless more is left beside what wanders than the sensor's noise."""
    recording = wandering_problem(tmp_path, 1).recording
    settings = replace(recording.settings, position_noise_m=declared)
    document = diagnose_poses(replace(recording, settings=settings), options=QUICK).to_dict()
    assert document["verdict"] == verdict
    assert document["findings"] == []
    assert [fault["fault"] for fault in document["data_faults"]] == ["wandering_readout"]
    printed = StringIO()
    Console(width=2000, file=printed).print(*diagnosis_report(with_statements(document), "poses.csv"))
    said = printed.getvalue()
    assert "Joint 2 is read out with an error that wanders by itself" in said
    assert ("is the sensor's noise and what the read-out of joint 2 wanders by." in said) == (verdict == "consistent")
    assert ("Consistent: the model of the arm, read-outs that wander and" in said) == (verdict == "consistent")
    assert ("Position errors beside read-outs that wander are " in said) == (verdict == "unexplained")


def independent_errors(seed: int, samples: int):
    """Poses of an arm whose joint 4 is read out with another error of 0.8 mrad in each row."""
    recording = simulate("lite6", samples=samples, seed=seed)
    q = recording.joint_position.copy()
    q[:, 3] += np.random.default_rng(seed).normal(0.0, 8e-4, samples)
    return replace(recording, joint_position=q)


def test_a_read_out_that_errs_anew_in_each_row_is_not_known_to_be_noise():
    document = diagnose_poses(independent_errors(seed=3, samples=60), options=QUICK).to_dict()
    assert document["findings"] == []
    assert document["verdict"] in ("undetermined", "unexplained")
    (fault,) = (fault for fault in document["data_faults"] if fault["fault"] == "wandering_readout")
    assert fault["numbers"]["joints"] == [4]
    assert fault["numbers"]["remembers"] == [False]


def test_waves_that_few_rows_hardly_resolve_are_no_errors_of_each_row():
    effects = [
        "joint_harmonic:joint=5,order=111,amplitude_rad=8.4e-4,phase_rad=1.06",
        "joint_harmonic:joint=5,order=115,amplitude_rad=9.0e-4,phase_rad=-2.64",
        "joint_compliance:joint=5,compliance_rad_per_Nm=4e-5",
    ]
    diagnosis = diagnose_poses(simulate("lite6", effects=effects, samples=36, seed=3), options=QUICK)
    assert {finding.site for finding in diagnosis.findings} == {"joint5"}
    assert {finding.name for finding in diagnosis.findings} == {"joint_harmonic"}


def test_one_more_read_out_of_a_kind_that_wanders_costs_even_odds(tmp_path):
    problem = wandering_problem(tmp_path, 1)
    order = next(one for one in problem.quantities if one.driver.is_order)
    second, third = (next(one for one in problem.components if one.site == site) for site in ("joint2", "joint3"))
    scan = Scan(problem, OPTIONS)
    first = problem.process(second, [order], "wander", SIZE, (10.0, 2.0))
    beside = scan.cost_of_wander_beside(third.site, [first])
    assert beside == pytest.approx(np.log(2) + np.log(6))  # even odds, and any of six memories
    assert beside < scan.cost_of_process(third.site, (scan.drivers,)) - 1
    assert scan.cost_of_wander_beside(third.site, []) is None
    assert scan.cost_of_wander_beside("sensor", [first]) is None  # encoders say nothing of a tracker


def test_encoders_that_remember_longer_than_the_recording_are_no_finding(tmp_path):
    """Of a factory file that holds; their means over the recording are far from zero, as those of offsets are."""
    motion = moving_motion(1, SAMPLES)
    joints = motion["joint_position"]
    draws = np.random.default_rng(3).standard_normal(joints.shape)
    wandering = autoregression(SIZE * draws, 1 - 1 / (2 * SAMPLES))
    assert np.abs(wandering.mean(0)).max() > SIZE
    made = Made(tmp_path, seed=1, orientation=True)
    poses = made.poses({**motion, "joint_position": joints + wandering})
    found = search(pose_problem(made.recording(motion, poses=poses)), OPTIONS)
    assert found.state.tested == ()
    assert len(found.wandering) >= 5


def test_an_offset_is_no_read_out_that_wanders(tmp_path):
    """Of a small offset, alone: the mean of slow wandering may be as large."""
    motion = moving_motion(1, SAMPLES)
    moved = motion["joint_position"].copy()
    moved[:, 1] += 3e-5
    made = Made(tmp_path, seed=1, orientation=False)
    found = search(pose_problem(made.recording(motion, poses=made.poses({**motion, "joint_position": moved}))), OPTIONS)
    assert [selected.term.label for selected in found.state.tested] == ["joint_offset:joint2"]
    assert found.wandering == ()


@pytest.mark.parametrize("memory", [40, 80])
def test_slow_noise_of_a_sensor_is_no_physics(tmp_path, memory):
    """It forgets within a sixth or a third of the recording: what it leaves resembles frames that move."""
    motion = moving_motion(1, SAMPLES)
    made = Made(tmp_path, seed=1, orientation=False)
    poses = made.poses(motion)
    draws = NOISE[0] * np.random.default_rng(memory).standard_normal((SAMPLES, 3))
    poses[:, :3, 3] += autoregression(draws, 1 - 1 / memory)
    found = search(pose_problem(made.recording(motion, noise=None, poses=poses)), OPTIONS)
    assert found.state.tested == ()
    assert not found.state.fit.noise.white


def test_what_wanders_is_nuisance_with_the_variance_of_an_autoregression(tmp_path):
    problem = wandering_problem(tmp_path, 1)
    component = next(one for one in problem.components if one.site == "joint2")
    order = next(one for one in problem.quantities if one.driver.is_order)
    term = problem.process(component, [order], "wander", SIZE, (10.0, 2.0))
    functions = problem.deflections.basis(term)
    covariance = functions.T @ functions
    lag = np.abs(np.subtract.outer(np.arange(SAMPLES), np.arange(SAMPLES)))
    inside = slice(SAMPLES // 5, -SAMPLES // 5)
    expected = np.exp(-lag * 10 * np.pi / SAMPLES)[inside, inside]
    assert covariance[inside, inside] == pytest.approx(expected, abs=0.12)
    with_noise = problem.with_nuisance([term])
    columns = with_noise.nuisance_columns(*problem.preset)[len(problem.unknown) - len(problem.masses) :][: term.size]
    assert columns == pytest.approx(problem.columns([term]), rel=1e-12, abs=1e-300)
    # its residuals move as its columns say
    number = with_noise.unknown.index(("wander", 0, 3))
    nuisance = 1e-6 * np.eye(len(with_noise.unknown))[number]
    moved = with_noise.residual(nuisance, *problem.preset) - with_noise.residual(0 * nuisance, *problem.preset)
    assert moved == pytest.approx(1e-6 * columns[3], rel=1e-3, abs=1e-9)


def test_two_waves_of_a_gear_are_no_read_out_that_wanders(tmp_path):
    """Of high orders in few postures noise of the joint explains both, and more than either wave alone."""
    motion = static_motion(4, 46)
    effects = (
        "joint_harmonic:joint=4,order=78,amplitude_rad=2e-3,phase_rad=-1.4",
        "joint_harmonic:joint=4,order=43,amplitude_rad=1.5e-3,phase_rad=0",
    )
    made = Made(tmp_path, effects, seed=1, orientation=False)
    found = search(pose_problem(made.recording(motion)), OPTIONS)
    assert not found.wandering
    orders = sorted(selected.term.chosen for selected in found.state.tested)
    assert orders == pytest.approx([43, 78], abs=0.3)
