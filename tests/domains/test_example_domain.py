"""A domain that the package does not know is diagnosed, reported on, saved, read and predicted without a change."""

from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from lite6jax import predict, read_model
from lite6jax.diagnosis.document import write_document
from lite6jax.domains import registry
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.settings import RecordingSettings
from lite6jax.report import pages, reports, sections, statements
from tests.domains import example_domain
from tests.domains.example_domain import (
    OSCILLATORS,
    Oscillator,
    OscillatorReport,
    Rubbing,
    Softening,
    diagnose_oscillator,
)

NOISE = 1e-4
TIME = np.arange(0.0, 8.0, 0.01)
NOMINAL = Oscillator()


def recording_of(effects, values, seed):
    rng = np.random.default_rng(seed)
    force = sum(rng.normal(0.0, 4.0) * np.sin(rng.uniform(1.0, 9.0) * TIME + rng.uniform(0, 6)) for _ in range(5))
    position = NOMINAL.rolled_out(TIME, force, effects, values) + rng.normal(0.0, NOISE, len(TIME))
    settings = RecordingSettings(motion="trajectory")
    arrays = {"time": TIME, "joint_torque": force[:, None]}
    return Recording.assembled(position[:, None], settings=settings, **arrays)


@pytest.fixture(autouse=True)
def known(monkeypatch):
    monkeypatch.setitem(registry.DOMAINS, OSCILLATORS.name, OSCILLATORS)
    monkeypatch.setitem(reports.REPORTS, OSCILLATORS.name, OscillatorReport())


@pytest.mark.parametrize(("effect", "value"), [(Rubbing(), 0.4), (Softening(), 0.1)])
def test_what_is_hidden_in_an_oscillator_is_found_saved_read_and_predicted(effect, value, tmp_path):
    found = diagnose_oscillator(recording_of([effect], [value], 1), NOMINAL, NOISE)
    assert [finding.effect for finding in found.findings] == [effect]
    (estimate,) = found.findings[0].parameters.values()
    assert abs(estimate.value - value) < 4 * estimate.std
    assert found.verdict == "explained"
    document = statements.with_statements(found.to_dict())
    screen = StringIO()
    for part in sections.diagnosis_report(document, "oscillator.csv"):
        Console(file=screen, width=100).print(part)
    page = pages.diagnosis_page(found, document, "oscillator.csv")
    for shown in (screen.getvalue(), page):
        assert "The oscillator is explained." in shown
        assert f"The mass has {effect.name}" in shown
        assert "before (mm)" in shown
    model = read_model(write_document(document, tmp_path / "found.json"))
    unseen = recording_of([effect], [value], 2)
    shown = predict(model, unseen)
    assert np.sqrt(np.mean((shown - unseen.joint_position[:, 0]) ** 2)) < 1.1 * NOISE


def test_an_oscillator_as_declared_has_no_finding():
    found = diagnose_oscillator(recording_of([], [], 3), NOMINAL, NOISE)
    assert found.findings == ()
    assert found.verdict == "consistent"


def test_a_domain_that_is_not_known_is_refused_with_the_known_ones(tmp_path):
    with pytest.raises(InputError, match='give "poses", "torques", "tracking" or "oscillators", or leave it out'):
        read_model(tmp_path / "found.json", domain="springs")


def test_it_is_one_file_of_at_most_250_lines():
    assert len(Path(example_domain.__file__).read_text().splitlines()) <= 250
