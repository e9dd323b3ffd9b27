"""What wanders by itself at no read-out: a hidden state, which is said, and of which no prediction knows anything."""

import numpy as np
import pytest
from diagnosis.recorded import OPTIONS, Made, moving_motion, static_motion

from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.document import model_from_document
from lite6jax.diagnosis.export import diagnosed_chain
from lite6jax.diagnosis.options import QUICK
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.domains.pose.problem import pose_problem
from lite6jax.report.statements import findings_of
from lite6jax.search.scan import Scan

SAMPLES, STEP, MEMORY, SIZE = 250, 8.0, 80.0, 1.5e-4


def autoregression(seed):
    """`(sample,)` m, of first order."""
    rng = np.random.default_rng(seed)
    coefficient = np.exp(-STEP / MEMORY)
    states = SIZE * rng.standard_normal(SAMPLES)
    for k in range(1, SAMPLES):
        states[k] = coefficient * states[k - 1] + np.sqrt(1 - coefficient**2) * states[k]
    return states


def recorded(folder, moved):
    """Poses of an arm at rest, whose sensor is `moved` `(sample,)` m upwards."""
    motion = static_motion(3, SAMPLES) | {"joint_temperature": np.full((SAMPLES, 6), 25.0)}
    made = Made(folder, seed=1, orientation=False)
    poses = made.poses(motion)
    poses[:, 2, 3] += moved
    return made.recording(motion, poses=poses)


@pytest.fixture(scope="module")
def diagnosis(tmp_path_factory):
    return diagnose_poses(recorded(tmp_path_factory.mktemp("hidden"), autoregression(5)), options=QUICK)


def test_a_sensor_that_wanders_is_a_hidden_state_that_nothing_recorded_drives(diagnosis):
    (finding,) = diagnosis.to_dict()["findings"]
    sites = {finding["site"], *(rival["site"] for rival in finding["confusable_with"] if rival["driver"] == "none")}
    assert {"sensor", "base"} <= sites
    assert finding["driver"] == "none"
    assert MEMORY / 3 < finding["wanders"]["memory_s"] < 3 * MEMORY
    assert "time" not in findings_of(diagnosis.to_dict())[0]["statement"]
    assert "Nothing that was recorded drives it" in findings_of(diagnosis.to_dict())[0]["statement"]


def test_what_wandered_once_is_zero_and_unknown_in_a_prediction(diagnosis):
    model = model_from_document(diagnosis.to_dict())
    assert isinstance(model, DiagnosedArm)
    predicted = model.predicted(diagnosis.recording)
    bare = model.without("unnamed").predicted(diagnosis.recording)
    np.testing.assert_allclose(predicted.poses, bare.poses, rtol=0, atol=1e-12)
    np.testing.assert_allclose(model.pose(diagnosis.recording.joint_position), bare.poses, rtol=0, atol=1e-9)
    assert predicted.position_std is not None
    assert predicted.outside is not None
    assert np.median(predicted.position_std[:, 2]) == pytest.approx(SIZE, rel=0.5)
    assert predicted.outside.mean() < 0.2


def test_a_simulator_cannot_hold_what_wanders(diagnosis):
    _, left_out = diagnosed_chain(diagnosis.model)
    assert any(phrase.endswith("which wanders by itself") for phrase in left_out)


def test_noise_that_is_larger_along_one_axis_is_no_hidden_state(tmp_path):
    samples = 120
    motion = static_motion(3, samples) | {"joint_temperature": np.full((samples, 6), 25.0)}
    made = Made(tmp_path, seed=1, orientation=False)
    poses = made.poses(motion)
    poses[:, 2, 3] += SIZE * np.random.default_rng(7).standard_normal(samples)
    assert diagnose_poses(made.recording(motion, poses=poses), options=QUICK).findings == ()


def test_a_smooth_drift_is_a_function_of_the_time(tmp_path):
    place = np.linspace(0.0, 1.0, SAMPLES)
    found = diagnose_poses(recorded(tmp_path, SIZE * np.sin(9 * place)), options=QUICK)
    assert [finding["driver"] for finding in found.to_dict()["findings"]] == ["time"]


def test_a_function_of_the_time_costs_six_nats_more_than_what_wanders_there(tmp_path):
    made = Made(tmp_path, seed=1)
    motion = moving_motion(1, 60)
    scan = Scan(pose_problem(made.recording(motion, poses=made.poses(motion))), OPTIONS)
    assert scan.time is not None
    for site in ("joint2", "base", "sensor"):
        wander, of_time = (scan.cost_of_process(site, (k,)) for k in (scan.drivers, scan.time))
        assert of_time - wander == pytest.approx(np.log(400))
    assert scan.cost_of_process("joint2", (scan.drivers,)) < scan.cost_of_process("sensor", (scan.drivers,)) - 4
