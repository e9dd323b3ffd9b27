"""What every public result can do: its summary is what is printed, and it is drawn, tabulated and saved."""

import json
import re
import sys
from dataclasses import replace
from inspect import isabstract
from xml.etree import ElementTree as ET

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure
from report import diagnosed, torque_diagnosed

import lite6jax
from lite6jax import InputError
from lite6jax.arms.factory import read_factory
from lite6jax.calibration.fleet import compare
from lite6jax.design.poses import plan_discrimination
from lite6jax.results import Figures, PublicResult
from tests.domains.tracking.test_servo_fit import commands_of
from tests.domains.tracking.test_tracking_commands import columns_of, write_log

LITE6 = lite6jax.read_arm("lite6")
LONGEST = 2500
"""Characters of a printed result: less than a screen."""
HOUSEHOLD = re.compile(r"\b(told|tells|felt|feels|asks|lived|plain|remembers|sure|hidden|they stand)\b", re.IGNORECASE)


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """One of each kind of result, by its class."""
    folder, rng = tmp_path_factory.mktemp("results"), np.random.default_rng(0)
    make = diagnosed.recording_maker(folder)
    recording, effects = make(diagnosed.COMPLIANCE)
    poses = diagnosed.diagnosed(recording, effects, outliers=(3,))
    torques = torque_diagnosed.diagnosed(torque_diagnosed.recorded(), torque_diagnosed.EFFECTS[:2])
    motion = torques.problem.data.recording
    experiment = lite6jax.plan_experiment("lite6", frame=False)
    q = rng.uniform(*LITE6.joint_limits.T, (80, 6))
    kinematics = np.stack([LITE6.kinematics + 1e-3 * rng.standard_normal((6, 6)) for _ in range(3)])
    files = [lite6jax.write_factory(each, folder / f"arm{k}.yaml") for k, each in enumerate(kinematics)]
    kinematics[2, 0, 0] = np.nan
    log = write_log(tmp_path_factory.mktemp("tracked"), columns_of(commands_of(300), 2e-4, delay=0.023), noise=2e-4)
    tracked = lite6jax.diagnose(log)
    effect = poses.findings[0].effect
    rivals = (effect, [1e-4]), type(effect)(3)
    made = [
        *(recording, replace(poses, beside=(torques,)), torques),
        *(lite6jax.fit(recording), lite6jax.fit_fleet_calibrations(kinematics, nominal="lite6")),
        compare([read_factory(path, LITE6) for path in files[:2]]),
        *(lite6jax.identify(experiment, q[:20]), lite6jax.plan_poses(experiment, q, 12)),
        plan_discrimination(experiment, rivals, q, 12),
        lite6jax.sensitivity("lite6", samples=200),
        *(lite6jax.predicted(poses.model, q[:30]), lite6jax.predicted(torques.model, motion)),
        lite6jax.compensate(poses.model, recording.position[:5], start=recording.joint_position[:5]),
        lite6jax.register_model(poses.model, recording)[1],
        *(tracked, lite6jax.predicted(tracked.model, log)),
        tracked.model.commands_for(0.01 * np.arange(100), commands_of(100)[:, None]),
    ]
    return {type(one): one for one in made}


def kinds_of(kind):
    """The classes of results that there can be one of."""
    parts = kind.__subclasses__()
    return [*(part for part in parts if not isabstract(part)), *(each for part in parts for each in kinds_of(part))]


KINDS = sorted(
    (kind for kind in kinds_of(PublicResult) if kind.__module__.startswith("lite6jax.")), key=lambda kind: kind.__name__
)
each = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)


@each
def test_printing_a_result_shows_its_summary_and_nothing_else(found, kind):
    text = found[kind].summary()
    assert str(found[kind]) == repr(found[kind]) == text
    assert 20 < len(text) < LONGEST
    assert re.match(r"[^\n]*\.$", text)
    assert not re.search(r"\bnan\b|array\(|  ", text)
    assert not HOUSEHOLD.search(text)


@each
def test_what_a_notebook_shows_is_well_formed_and_needs_nothing_else(found, kind):
    text = found[kind]._repr_html_()
    said = [entry.text for entry in ET.fromstring(f"<div>{text}</div>").findall(".//li")]
    assert " ".join(said).startswith(found[kind].summary())
    assert not re.search(r"https?:|src=|href=|style|script", text)


def test_the_numbers_of_a_summary_are_those_of_plain_numpy(found):
    solution, fleet, plan = (of(found, name) for name in ("Solution", "FleetSolution", "Plan"))
    rms = 1e3 * np.sqrt(np.mean(solution.checked.position**2))
    assert f"The error on held-out blocks is {rms:.4f} mm RMS" in solution.summary()
    assert fleet.summary().startswith("2 of 3 fits converged, each of 28 parameters.")
    assert "For 1 arm the fit met a number that is not finite; check the input." in fleet.summary()
    assert f"predict positions to ±{1e3 * plan.accuracy[11]:.4f} mm" in plan.summary()
    recording = of(found, "Recording")
    q = np.rad2deg(np.ptp(recording.joint_position, axis=0))
    assert f"over ranges of {q.min():.0f} deg to {q.max():.0f} deg" in recording.summary()
    assert f"{recording.samples} samples of 6 joints in 1 run (static), with positions" in recording.summary()
    identified = of(found, "Identification")
    rank = identified.determination.rank
    assert f"These poses determine {rank} of 28 unknown parameters." in identified.summary()


@each
def test_each_result_has_figures_with_titles_and_named_axes(found, kind):
    drawn = found[kind].plot("mine")
    assert isinstance(drawn, Figures)
    assert drawn
    for figure in drawn.values():
        assert isinstance(figure, Figure)
        assert figure.get_suptitle().startswith("mine")
        shown = [axes for axes in figure.axes if axes.get_visible()]
        assert any(axes.get_xlabel() or axes.get_xticklabels() for axes in shown)


@each
def test_each_result_is_a_table_with_units_in_its_columns(found, kind):
    frame = found[kind].to_frame()
    assert isinstance(frame, pd.DataFrame)
    assert len(frame) > 0
    assert frame.columns.is_unique
    lengths = [name for name in frame.columns if re.match(r"(x|y|z|position.*|distance)_", name)]
    assert all(re.search(r"_(m|mm|m_per_s)$", name) for name in lengths)


@each
def test_each_result_is_saved_as_a_table_that_reads_back(found, kind, tmp_path):
    frame = found[kind].to_frame()
    path = found[kind].save(tmp_path / "table.parquet")
    assert path == tmp_path / "table.parquet"
    read = pq.read_table(path).to_pandas()
    assert list(read.columns) == list(frame.columns)
    for name in frame.columns:
        if frame[name].dtype.kind in "fiub":
            np.testing.assert_array_equal(read[name].to_numpy(float), frame[name].to_numpy(float))
    before = path.read_bytes()
    with pytest.raises(InputError, match=r"table\.parquet: exists already"):
        found[kind].save(path)
    assert path.read_bytes() == before
    found[kind].save(path, overwrite=True)


def of(found, name):
    return next(one for kind, one in found.items() if kind.__name__ == name)


def test_a_saved_diagnosis_is_what_other_commands_read(found, tmp_path):
    model = lite6jax.read_model(of(found, "Diagnosis").save(tmp_path / "d.json"))
    assert [effect.label for effect in model.physics.effects] == ["joint_compliance:joint2"]
    document = json.loads((tmp_path / "d.json").read_text())
    assert document["findings"][0]["statement"].startswith("Joint compliance at joint2")


def test_a_saved_fit_is_the_effective_table_and_a_saved_recording_keeps_its_settings(found, tmp_path):
    assert lite6jax.read_factory(of(found, "Solution").save(tmp_path / "model.json"))
    recording = of(found, "Recording")
    read = lite6jax.read_recording(recording.save(tmp_path / "run.csv"))
    assert read.settings.position_noise_m == recording.settings.position_noise_m
    np.testing.assert_array_equal(read.position, recording.position)


def test_without_pandas_the_remedy_is_named(found, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match=r"needs pandas; install it with: pip install pandas"):
        of(found, "Solution").to_frame()
