"""Evidence on an effect in a reduced recording, against least squares of all columns at once."""

from dataclasses import replace

import numpy as np
import pytest
from populations.linear_arms import OPTIONS, arm, wave

from lite6jax.errors import InputError
from lite6jax.estimation.noise import Autocorrelation, NoiseModel
from lite6jax.populations.files import from_bytes, read_heading, to_bytes
from lite6jax.populations.reduced import PooledTerm, order_grid

SOFT, BENT = PooledTerm("soft"), PooledTerm("bent")
LINE = wave(7.25, 0.9, 0.4)


@pytest.fixture
def made():
    return arm(np.random.default_rng(0), [(SOFT, [0.8]), (BENT, [0.9, -0.8]), LINE])


def least_squares(made, terms):
    """Numbers of the last term, fitted beside the nuisance and the others, and their covariance in unit noise."""
    A = np.concatenate([made.basis, *(made.columns_of(term) for term in terms)]).T
    numbers = -np.linalg.lstsq(A, made.residual, rcond=None)[0]
    size = len(made.columns_of(terms[-1]))
    return numbers[-size:], np.linalg.inv(A.T @ A)[-size:, -size:]


@pytest.mark.parametrize("term", [SOFT, BENT, LINE[0]])
def test_evidence_is_least_squares_beside_the_others(made, term):
    others = [other for other in (SOFT, BENT, LINE[0]) if other != term]
    found = made.beside(others, OPTIONS).evidence(term, OPTIONS)
    values, covariance = least_squares(made, [*others, term])
    np.testing.assert_allclose(np.linalg.solve(found.information, found.score), values, rtol=1e-8)
    np.testing.assert_allclose(np.linalg.inv(found.information), covariance, rtol=1e-8)
    assert found.p_value < 0.05
    ratio = np.diagonal(found.covariance) / np.diagonal(found.information)
    assert ratio.min() > 0.3  # of 20 blocks of white noise of unit variance
    assert ratio.max() < 3


@pytest.mark.parametrize("noise", [None, Autocorrelation(0.8, 0.6)])
def test_scores_of_a_search_are_the_evidence_on_each_term(made, noise):
    if noise is not None:
        made = replace(made, noise=NoiseModel((noise,), np.zeros(1, int), (0, 30)))
    made = replace(made, training=np.arange(made.residual.size) % 9 > 0).beside([BENT], OPTIONS)
    named, score, information = made.scores(OPTIONS)
    expected = made.evidence(SOFT, OPTIONS)
    np.testing.assert_allclose(named[0][0], expected.score)
    np.testing.assert_allclose(named[0][1], expected.information)
    assert not named[1][1].any()  # it is in the model
    orders = order_grid(OPTIONS)
    for order in (1.0, 7.25, 133.125):
        at = int(np.flatnonzero(orders == order)[0])
        expected = made.evidence(PooledTerm("waves:joint3", order), OPTIONS)
        np.testing.assert_allclose(score[0, at], expected.score, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(information[0, at], expected.information[[0, 0, 1], [0, 1, 1]], rtol=1e-9, atol=1e-9)


def test_what_is_in_the_model_or_unknown_has_no_evidence(made):
    assert made.beside([SOFT], OPTIONS).evidence(SOFT, OPTIONS) is None
    assert made.evidence(PooledTerm("unheard of"), OPTIONS) is None
    assert made.evidence(PooledTerm("waves:joint9", 3.0), OPTIONS) is None


def test_a_number_that_the_nuisance_does_as_well_has_no_information_at_all(made):
    """Rounding, divided by rounding, would be a number of any size."""
    column = made.parts["bent"].start
    made.columns[column] = 1e3 * made.basis[0] + 1e-7 * made.columns[column]
    found = made.evidence(BENT, OPTIONS)
    assert (found.score[0], *found.information[0], *found.information[:, 0]) == (0.0, 0.0, 0.0, 0.0, 0.0)
    assert found.information[1, 1] > 1
    named = made.scores(OPTIONS)[0][1]
    np.testing.assert_allclose(named[0], found.score)
    np.testing.assert_allclose(named[1], found.information)


def test_a_file_holds_the_recording(made, tmp_path):
    made = replace(made, noise=NoiseModel((Autocorrelation(0.8, 0.6),), np.zeros(1, int), (0, 30)))
    path = tmp_path / "a.npz"
    path.write_bytes(to_bytes(made))
    again = from_bytes(path.read_bytes())
    assert (again.about, again.found, again.candidates, again.families) == (
        made.about, made.found, made.candidates, made.families
    )  # fmt: skip
    np.testing.assert_allclose(again.columns, made.columns, rtol=1e-7)
    for name in ("sites", "angles", "training", "basis", "residual", "blocks"):
        np.testing.assert_array_equal(getattr(again, name), getattr(made, name))
    models = [(model.coefficient, model.share) for model in again.noise.models]
    assert (models, again.noise.starts) == ([(0.8, 0.6)], (0, 30))
    assert to_bytes(made) == to_bytes(made)
    assert again.functions == made.functions
    for name in ("places", "drivers"):
        own, there = getattr(made, name), getattr(again, name)
        assert [*own] == [*there]
        np.testing.assert_array_equal([*own.values()], [*there.values()])
    assert read_heading(path).functions == made.functions
    assert read_heading(path).candidates == made.candidates


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"no", lambda b: b""])
def test_a_damaged_file_is_refused_with_the_remedy(made, tmp_path, damage):
    path = tmp_path / "a.npz"
    path.write_bytes(damage(to_bytes(made)))
    with pytest.raises(InputError, match=r"a\.npz: is no reduced recording of this version; .* with --force"):
        read_heading(path)
    with pytest.raises(InputError, match=r"^here: is no reduced recording"):
        from_bytes(path.read_bytes(), "here")


def test_the_reduced_recording_gives_the_estimates_of_its_diagnosis(corpus):
    from lite6jax.populations.reduction import reduced

    diagnosis = corpus["compliance"].diagnosis
    made = reduced(diagnosis)
    (finding,) = diagnosis.findings
    assert [(one.label, one.p_value) for one in made.found] == [(finding.effect.label, finding.p_value)]
    found = made.evidence(made.found[0].term, OPTIONS)
    std = float(np.sqrt(finding.covariance[0, 0]))
    assert 1 / found.information[0, 0] == pytest.approx(std**2, rel=0.1)  # robust weights differ a little
    assert found.score[0] / found.information[0, 0] == pytest.approx(finding.values[0], abs=0.3 * std)


def test_functions_are_those_that_test_the_names_of_the_diagnosis(corpus):
    from lite6jax.populations.reduction import reduced

    diagnosis = corpus["compliance"].diagnosis
    made, problem = reduced(diagnosis), diagnosis.problem
    tried = [part for whole in problem.flexible if not whole.rare for part in whole.displacements]
    assert "x y z rx ry rz" in {one.component for one in problem.flexible} - {one.component for one in tried}
    some = [k for k, effect in enumerate(tried) if effect.site in ("joint3", "link2", "tool", "sensor")]
    assert len(some) > 40
    assert len({function.key for function in made.functions}) == len(made.functions) > len(tried)
    for k in some:
        expected = problem.columns([tried[k]])
        columns = made.columns_of_function(made.functions[k])[:, : expected[0].size].reshape(expected.shape)
        columns, expected = columns[..., made.training], expected[..., made.training]
        scale = np.vdot(columns, expected) / np.vdot(expected, expected)  # the noise, which all of them share
        np.testing.assert_allclose(columns, scale * expected, rtol=1e-6, atol=1e-6 * scale)
        assert scale == pytest.approx(1 / diagnosis.fit.scale[0], rel=0.2)
