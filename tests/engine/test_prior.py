"""The prior probabilities of explanations: one table, which a sidecar changes."""

import json
import math

import pytest

from lite6jax.cli import main
from lite6jax.diagnosis.options import Options
from lite6jax.errors import InputError
from lite6jax.estimation.prior import PRIOR, Prior
from lite6jax.recordings import RecordingSettings


def test_a_cost_is_minus_the_logarithm_of_a_probability():
    assert PRIOR.cost("calibration_off") == pytest.approx(-math.log(PRIOR.calibration_off), rel=1e-15)
    assert Prior(calibration_off=0.0).cost("calibration_off") == math.inf


def test_kinds_of_a_further_term_are_together_certain():
    kinds = PRIOR.named, PRIOR.wave, PRIOR.process, PRIOR.product
    assert sum(kinds) == pytest.approx(1.0, rel=1e-15)


def test_a_sidecar_changes_both_the_search_and_the_screening():
    options = Options().of(RecordingSettings(prior={"calibration_off": 0.02, "named": 0.5}))
    assert options.engine.prior == options.prior
    assert (options.prior.calibration_off, options.prior.named) == (0.02, 0.5)
    assert options.prior.wave == PRIOR.wave
    assert Options().of(RecordingSettings()) == Options()


@pytest.mark.parametrize(
    ("probabilities", "message"),
    [
        ({"calibration": 0.1}, "prior: 'calibration' is no explanation; the names are named, wave, process"),
        ({"named": 1.0}, "prior: "),
        ({"named": -0.1}, "prior: "),
    ],
)
def test_what_is_no_probability_is_refused(probabilities, message):
    with pytest.raises(InputError, match=message):
        Options().of(RecordingSettings(prior=probabilities))


def test_a_probability_of_one_costs_nothing_and_is_refused():
    with pytest.raises(InputError, match=r"prior: named is 1\.0; give a probability from 0 to below 1"):
        Prior(named=1.0)


def test_the_command_lists_each_with_its_cost(capsys):
    assert main(["effects", "--prior", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert list(listed) == list(PRIOR.probabilities)
    assert listed["nominal_table"]["cost"] == pytest.approx(math.log(300), rel=1e-12)
    assert main(["effects", "--prior"]) == 0
    assert "calibration_off" in capsys.readouterr().out
    assert main(["effects", "--prior", "--domain", "dynamic"]) == 2
    assert "leave --domain out" in capsys.readouterr().err
