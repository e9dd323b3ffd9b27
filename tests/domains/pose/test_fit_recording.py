"""`fit`, `check` and `diagnose` find the same data faults, and fit what is left without them."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.recorded import Made, static_motion

import lite6jax
from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.options import QUICK
from lite6jax.domains.pose.check import check_recording
from lite6jax.recordings import RecordingSettings, write_recording
from lite6jax.simulation import simulate

LITE6 = load_bundled("lite6")


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=2).recording(static_motion(21, 120))


def scalar_last(recording):
    return replace(recording, quaternion=np.roll(recording.quaternion, -1, axis=1))


def test_a_good_recording_is_fitted_as_it_is(good):
    solution = lite6jax.fit(good)
    assert solution.faults == ()
    np.testing.assert_array_equal(solution.recording.position, good.position)
    checked = check_recording(good)
    assert checked.faults == ()
    causes = {cause.code: cause for cause in checked.causes}
    assert set(causes) == {"tool_offset", "geometry", "outliers"}
    assert not any(cause.suspicious for cause in causes.values())


def test_weights_are_of_the_rows_that_were_fitted(good):
    """A row that repeats another is dropped: the weights are those of `recording`, which has the file's row numbers."""
    twice = good.select(np.insert(np.arange(good.samples), 5, 4))
    twice = replace(twice, row=np.arange(1, twice.samples + 1), time=8.0 * np.arange(twice.samples))
    position = twice.position.copy()
    position[80] += 0.02
    solution = lite6jax.fit(replace(twice, position=position))
    (fault,) = solution.faults
    assert (fault.code, fault.rows) == ("repeated_rows", (6,))
    assert len(solution.weight) == solution.recording.samples == good.samples
    assert solution.recording.row[np.argmin(solution.weight)] == 81


def test_too_few_rows_are_refused_with_the_count(good):
    with pytest.raises(lite6jax.InputError, match="5 samples give 30 numbers"):
        lite6jax.fit(good.select(np.arange(5)), geometry="free")


@pytest.mark.long
def test_a_folder_of_recordings_is_screened_too(tmp_path, good):
    import pyarrow.parquet

    from lite6jax import cli

    folder = tmp_path / "arms"
    folder.mkdir()
    write_recording(scalar_last(good), folder / "run.csv")
    out = tmp_path / "fleet.parquet"
    assert cli.main(["fleet", str(folder), "--out", str(out)]) == 0
    (row,) = pyarrow.parquet.read_table(out).to_pylist()
    assert row["message"] == "converged; data faults: orientation_convention"


@pytest.mark.parametrize(("size", "rows"), [(3e-8, []), (3e-4, [7])])
def test_a_row_that_is_off_by_less_than_rounding_is_no_outlier(tmp_path, size, rows):
    """Poses that a controller computed are exact to nanometres, beside which 0.03 µm stands out and matters nothing."""
    calibration = write_factory(LITE6.kinematics, tmp_path / "arm.yaml")
    settings = RecordingSettings(arm="lite6", factory_calibration=str(calibration))
    exact = simulate(LITE6, samples=40, settings=settings, position_noise=1e-9, joint_noise=0.0)
    position = exact.position.copy()
    position[6] += size
    recording = exact.made_anew(position=position, settings=replace(exact.settings, position_noise_m=None))
    solution = lite6jax.fit(recording)
    assert solution.weight[6] < 0.1
    assert recording.row[solution.outlying].tolist() == rows
    found = diagnose_poses(recording, options=QUICK)
    assert recording.row[found.outliers].tolist() == rows
