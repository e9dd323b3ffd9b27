"""The benchmarks' own honesty: what they simulate, when they call an answer wrong, and what they write."""

import importlib
import json
from functools import partial

import numpy as np
import pytest

from benchmarks import __main__ as harness
from benchmarks import fits, measure, scaling, seed_way
from benchmarks.measure import Record
from tests.oracles.chains import seed_poses, six_parameter_poses

RNG_SEED = 11


def test_the_rivals_chains_are_those_of_the_oracle():
    rng = np.random.default_rng(RNG_SEED)
    kinematics = fits.simulated_arms(1, RNG_SEED)[0]
    parameters = seed_way.NOMINAL + 2e-3 * rng.standard_normal(28)
    q = seed_way.sample_joints(20, rng)
    np.testing.assert_allclose(
        [seed_way.factory_pose(kinematics, each) for each in q], six_parameter_poses(kinematics, q), atol=1e-14
    )
    np.testing.assert_allclose(
        [seed_way.effective_pose(parameters, each) for each in q], seed_poses(parameters, q), atol=1e-14
    )


def test_the_simulated_sensor_has_the_noise_it_says():
    read = fits.measured(2, 2000, RNG_SEED)
    for arm in range(2):
        true = six_parameter_poses(read.kinematics[arm], read.joint_position[arm])
        shift = read.pose[arm, :, :3, 3] - true[:, :3, 3]
        relative = np.swapaxes(true[:, :3, :3], 1, 2) @ read.pose[arm, :, :3, :3]
        spin = np.stack([relative[:, 2, 1], relative[:, 0, 2], relative[:, 1, 0]], 1)
        np.testing.assert_allclose(shift.std(0), fits.NOISE[0], rtol=0.1)
        np.testing.assert_allclose(spin.std(0), fits.NOISE[1], rtol=0.1)
    assert np.abs(read.joint_position[0] - read.joint_position[1]).max() > 1


def test_an_answer_is_likely_or_not():
    rng = np.random.default_rng(RNG_SEED)
    root = rng.standard_normal((28, 28))
    covariance = np.broadcast_to(root @ root.T, (50, 28, 28))
    truth = rng.standard_normal((50, 28))
    fitted = truth + rng.standard_normal((50, 28)) @ root.T
    assert measure.unlikely(fitted, covariance, truth) == ""
    for wrong in (
        measure.unlikely(fitted, covariance / 4, truth),  # flatters itself
        measure.unlikely(fitted, covariance * 4, truth),  # knows more than it says
        measure.unlikely(fitted + 10 * root[:, 0] * (np.arange(50) == 7)[:, None], covariance, truth),  # one arm
        measure.unlikely(np.where(np.arange(50)[:, None] == 3, np.nan, fitted), covariance, truth),
    ):
        assert wrong.startswith("misses the truth")


@pytest.mark.parametrize(("run", "subject"), [(fits.one, "one"), (partial(fits.fleet, sizes=(2,)), "fleet of 2")])
def test_a_rival_that_finds_something_else_is_marked(run, subject):
    honest = fits.JACOBIAN
    liar = honest._replace(name="liar", solve=lambda q, pose: honest.solve(q, pose) + 1e-8)
    records = list(run(samples=40, repeats=1, rivals=(honest, liar)))
    assert {record.subject for record in records if record.failed} == {"liar", "lite6jax"}
    assert {r.metric for r in records if r.failed and r.subject == "lite6jax"} == {"faster than liar"}
    assert all(record.value is not None and record.value > 0 for record in records)
    assert {record.workload for record in records} == {subject}


def test_rollouts_of_many_variants_are_those_of_each_alone():
    records = list(scaling.rollouts(rows=200, variants=3, repeats=1))
    assert [record.failed for record in records] == [""] * 6
    assert all(record.value is not None and record.value > 0 for record in records)


def wrong_workload(failed):
    yield Record("w", "lite6jax", "fit", 1.0, "ms", failed)
    yield Record("w", "other", "fit", None, "", failed)


def test_the_exit_code_says_whether_every_answer_was_right(tmp_path, capsys):
    known = {"models": partial(wrong_workload, ""), "bad": partial(wrong_workload, "off by a lot")}
    out = tmp_path / "out.json"
    assert harness.main(["models", "--json", str(out)], known) == 0
    assert json.loads(out.read_text())[1] == {
        "workload": "w", "subject": "other", "metric": "fit", "value": None, "unit": "",
    }  # fmt: skip
    assert harness.main(["--json", str(out)], known) == 1
    assert [record.get("failed") for record in json.loads(out.read_text())] == [None, None] + ["off by a lot"] * 2
    assert "wrong: w, lite6jax, fit: off by a lot" in capsys.readouterr().out
    assert harness.main(["--json", str(tmp_path / "no" / "out.json")], known) == 2
    assert capsys.readouterr().err.startswith("benchmarks: ")


def test_every_workload_and_command_is_there():
    for module, name in harness.WORKLOADS.items():
        assert callable(getattr(importlib.import_module(f"benchmarks.{name}"), module))
    for module, _ in harness.COMMANDS.values():
        assert callable(importlib.import_module(f"benchmarks.{module}").main)


@pytest.mark.skipif(not fits.HEADERS.exists(), reason="Ceres (libceres-dev) is not installed here")
def test_ceres_and_the_library_agree():
    found = list(fits.ceres(arms=2, samples=40, repeats=1))
    assert [record.failed for record in found] == [""] * len(found)
    assert all(record.value > 0 for record in found)
