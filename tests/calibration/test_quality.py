"""A fit that converged is not good for that: its quality, and the arm that a recording looks like."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis.recorded import Made, static_motion
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.calibration.fit import fit_recording
from lite6jax.calibration.quality import FARTHEST_SHARE, quality_of_calibration, quality_of_poses
from lite6jax.calibration.source import arm_of, matches, read_source, with_arm
from lite6jax.cli.command import BAD_FIT
from lite6jax.errors import InputError, InputWarning
from lite6jax.recordings import RecordingSettings, write_recording

ROOT = Path(__file__).resolve().parents[2]
LITE6 = load_bundled("lite6")
SAMPLES = 60


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Poses of a Lite 6 off its nominal, in an unknown frame with an unknown tool; nothing is declared."""
    made = Made(tmp_path_factory.mktemp("arm"), seed=2, geometry="free", frame=True, tool=True)
    return replace(made.recording(static_motion(4, SAMPLES)), settings=RecordingSettings(motion="static"))


@pytest.fixture(scope="module")
def unrelated(recording):
    order = np.random.default_rng(0).permutation(SAMPLES)
    return replace(recording, position=recording.position[order], quaternion=recording.quaternion[order])


# ------------------------------------------------------------------ quality


def judged(error, spread=0.3, moved=0.3, reach=0.75, declared=None, over_noise=None):
    """The quality of a model whose errors and whose arm's positions have these sizes, m."""
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return quality_of_poses(np.full(200, error), spread * directions, moved * directions, reach, declared, over_noise)


def test_a_model_is_good_or_above_the_noise_or_bad():
    assert judged(1e-4)[:2] == ("good", None)
    assert judged(1e-4, declared=1e-4, over_noise=1.4)[:2] == ("good", None)
    assert judged(1e-4, declared=1e-5, over_noise=9.0)[:2] == ("above_noise", None)
    assert judged(0.1)[:2] == ("bad", "too_far")
    assert judged(np.nan)[:2] == ("bad", "too_far")
    # within the reach's share, but as large as all that was measured, while the joints move the arm
    assert judged(5e-3, spread=6e-3)[:2] == ("bad", "unrelated")
    assert judged(5e-3, spread=6e-3, moved=1e-3)[:2] == ("good", None)


def test_the_limit_is_a_share_of_the_reach_or_the_declared_noise():
    assert judged(1e-4).limit == FARTHEST_SHARE * 0.75
    assert judged(0.02, declared=0.01, over_noise=1.0)[:2] == ("good", None)  # a poor camera, which says so


def test_a_fifth_of_outliers_does_not_make_a_model_bad():
    distance = np.where(np.arange(200) % 5, 1e-4, 0.5)
    position = np.random.default_rng(2).normal(size=(200, 3))
    assert quality_of_poses(distance, position, position, 0.75, None, None).verdict == "good"


def test_a_calibration_is_reproduced_or_not():
    assert quality_of_calibration(np.array([1e-13, 2e-12])).verdict == "good"
    assert quality_of_calibration(np.array([1e-13, 2e-3]))[:2] == ("bad", "too_far")


def test_the_fit_of_an_arm_is_good_and_that_of_unrelated_poses_is_not(recording, unrelated):
    good = fit_recording(recording, LITE6).quality
    assert good.verdict == "good"
    assert good.explained > 0.99999
    bad = fit_recording(unrelated, LITE6, max_steps=10)
    assert bad.quality.verdict == "bad"
    assert "The model does not describe the poses" in bad.summary()


def test_the_exit_code_tells_a_bad_fit(capsys, tmp_path, monkeypatch, recording):
    from lite6jax.calibration import solution

    path = write_recording(recording, tmp_path / "run.csv")
    out = tmp_path / "model.json"
    far = quality_of_calibration(np.array([1.0]))._replace(error=0.096, limit=0.0075, explained=0.9)
    monkeypatch.setattr(solution, "quality_of_poses", lambda *given: far)
    code, said, _ = run(capsys, "fit", path, "--arm", "lite6", "--out", out)
    assert (code, BAD_FIT) == (3, 3)
    assert "Converged in" in said
    assert "of three quarters of the held-out rows the errors are up to 96" in flat(said)
    fit = json.loads(out.read_text())["fit"]
    assert (fit["result"], fit["quality"]) == ("converged", "bad")


# ------------------------------------------------------------------ the arm


def test_an_undeclared_arm_is_recognised_and_the_others_are_named(capsys, tmp_path, recording):
    nearest = matches(recording)
    names, errors = [arm.name for arm, _ in nearest], [error for _, error in nearest]
    assert names[0] == "lite6"
    assert errors[0] < 0.01 < 0.05 < errors[1]
    assert {*names} >= {"ur10", "ur3e", "xarm6", "uf850"}
    assert "lite6_ros" not in names
    found = with_arm(recording)
    assert found.settings.arm == "lite6"
    assert "no arm is declared, and this looks like a lite6: " in found.notes[-1]
    path = write_recording(recording, tmp_path / "run.csv")
    path.with_suffix(".yaml").unlink()
    with pytest.warns(InputWarning, match=r"this looks like a lite6: .* mm; .*; say so by `arm: lite6` in a sidecar"):
        assert read_source(path, None).settings.arm == "lite6"
    code, said, err = run(capsys, "fit", path)
    assert code == 0
    assert err.startswith(f"warning: {path}: no arm is declared, and this looks like a lite6: ")
    assert err.count("\n") == 1
    assert "joints of a lite6" in flat(said)


def test_a_declared_arm_is_taken_as_it_is(recording):
    declared = replace(recording, settings=replace(recording.settings, arm="ur10"))
    assert arm_of(declared).name == "ur10"
    assert with_arm(declared) is declared


def test_poses_that_fit_no_arm_are_refused(capsys, tmp_path, unrelated):
    path = write_recording(unrelated, tmp_path / "run.csv")
    said = refused(capsys, "fit", path)
    assert said.startswith(f"{path}: declares no arm, and its poses fit no bundled one (nearest: ")
    assert "name it with --arm NAME, or `arm:` in the sidecar" in said


def test_poses_that_fit_two_arms_alike_are_refused(recording):
    few = recording.select(np.zeros(5, int))  # one pose: a sensor's frame carries any arm there
    with pytest.raises(InputError, match=r"declares no arm, and fits several alike \(.* mm; .* mm.*\); name it with"):
        with_arm(replace(few, quaternion=None))


def test_joints_without_poses_do_not_show_the_arm(capsys, tmp_path, recording):
    path = write_recording(replace(recording, position=None, quaternion=None), tmp_path / "joints.csv")
    said = refused(capsys, "identify", path)
    assert said == f"{path}: declares no arm, and has no poses that would show it; give --arm"
