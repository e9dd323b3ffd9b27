"""Public functions take the path of a file where they take a recording, and refuse other types in one clear line."""

import re

import numpy as np
import pandas as pd
import pytest
from report import diagnosed

import lite6jax
from lite6jax import InputError

LITE6 = lite6jax.read_arm("lite6")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A recording, a motion, targets, two calibrations and a diagnosis."""
    folder = tmp_path_factory.mktemp("files")
    recording, effects = diagnosed.recording_maker(folder)(diagnosed.COMPLIANCE)
    recording.save(folder / "run.csv")
    lite6jax.simulate("lite6", samples=60, seed=2).save(folder / "other.csv")
    diagnosed.diagnosed(recording, effects).save(folder / "diagnosis.json")
    table = recording.to_frame()
    table[[f"q{j}_rad" for j in range(1, 7)]].head(20).to_csv(folder / "motion.csv", index=False)
    table[["x_m", "y_m", "z_m"]].head(4).to_csv(folder / "targets.csv", index=False)
    for k in range(2):
        lite6jax.write_factory(lite6jax.draw_calibration(LITE6, k), folder / f"arm{k}.yaml")
    return folder


@pytest.fixture(scope="module")
def model(folder):
    return lite6jax.read_model(folder / "diagnosis.json")


def test_a_list_of_files_is_fitted_one_by_one(folder):
    files = [folder / "run.csv", str(folder / "other.csv"), folder / "arm0.yaml"]
    fits = lite6jax.fit(files)
    assert [fit.arm.name for fit in fits] == ["lite6"] * 3
    for file, fit in zip(files, fits, strict=True):
        np.testing.assert_array_equal(fit.parameters, lite6jax.fit(file).parameters)


def test_motions_and_targets_are_read_from_files(folder, model):
    q = lite6jax.read_recording(folder / "motion.csv").joint_position
    np.testing.assert_array_equal(lite6jax.predict(model, folder / "motion.csv"), lite6jax.predict(model, q))
    predicted = lite6jax.predicted(model, str(folder / "motion.csv"))
    np.testing.assert_array_equal(predicted.position_std, lite6jax.predicted(model, q).position_std)
    targets = pd.read_csv(folder / "targets.csv").to_numpy()
    compensated = lite6jax.compensate(model, folder / "targets.csv")
    np.testing.assert_array_equal(compensated.joint_position, lite6jax.compensate(model, targets).joint_position)
    assert lite6jax.register_model(model, folder / "run.csv")[1].rms < 1e-4


BARE = lite6jax.Recording.from_arrays(np.zeros((3, 6)), np.full((3, 3), 0.1))
FRAME = pd.DataFrame({"q1_rad": [0.0]})


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda _: lite6jax.diagnose(42), "recording: has the type int; give the path of a recording, or a Recording"),
        (lambda _: lite6jax.diagnose(FRAME), r"has the type DataFrame; .* Recording\.from_dataframe"),
        (lambda _: lite6jax.diagnose(None), "recording: has the type NoneType; give the path"),
        (lambda _: lite6jax.diagnose(BARE, domain="both"), "domain='both': is none; give \"poses\" or"),
        (lambda _: lite6jax.identify_recording({}), "recording: has the type dict; give the path"),
        (lambda _: lite6jax.diagnose("run.csv", 6), "arm: has the type int; give an Arm, the name of a bundled one"),
        (lambda _: lite6jax.fit(42), r"source: has the type int; give a file or a list of files, a Recording"),
        (lambda _: lite6jax.fit({"a": 1}), "source: has the type dict; give a file"),
        (lambda _: lite6jax.fit(["a.csv", 3]), r"a\.csv: .*not found|a\.csv"),
        (lambda _: lite6jax.fit([["a", "b"]]), "source: holds .*, not numbers"),
        (lambda _: lite6jax.predict("d.json", "m.csv"), r"model: has the type str; give lite6jax\.read_model"),
        (lambda _: lite6jax.compensate(None, [[0, 0, 0]]), r"model: has the type NoneType; give lite6jax\.read_model"),
        (lambda m: lite6jax.predict(m, object()), "motion: has the type object; give a Recording"),
        (lambda m: lite6jax.register_model(m, 3), "recording: has the type int; give the path"),
        (lambda _: lite6jax.simulate(3), "arm: has the type int; give an Arm, the name of a bundled one"),
        (lambda _: lite6jax.sensitivity(3), "arm: has the type int; give an Arm or the name"),
        (lambda _: lite6jax.identify("lite6"), r"experiment: has the type str; give an Experiment, as lite6jax\.plan"),
        (lambda _: lite6jax.read_model(3), "path: has the type int; give the path of a diagnosis"),
        (lambda _: lite6jax.write_recording(3, "a.csv"), "recording: has the type int; give a Recording"),
        (lambda _: lite6jax.fit_fleet_calibrations([3], nominal=6), "nominal: has the type int; give an Arm or"),
        (lambda _: lite6jax.diagnose(BARE, options=3), r"options: has the type int; give lite6jax\.Options"),
        (lambda _: lite6jax.diagnose(BARE, effects="mine.py"), r"effects: has the type str; .*lite6jax\.load_effects"),
        (lambda _: lite6jax.diagnose(BARE, effects=[3]), r"effects\[0\]: has the type int; give an effect"),
    ],
)
def test_another_type_is_refused_in_one_line_that_says_what_is_accepted(model, call, said):
    with pytest.raises(InputError) as caught:
        call(model)
    assert re.search(said, str(caught.value))
    assert "\n" not in str(caught.value)
