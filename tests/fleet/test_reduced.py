"""Evidence on an effect in a reduced recording, against least squares of all columns at once."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.recorded import Made, static_motion
from fleet.linear_arms import LOAD, OPTIONS, POSITION, arm, tried, wave

from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.options import Options
from lite6jax.errors import InputError
from lite6jax.estimation.noise import Autocorrelation, NoiseModel
from lite6jax.fleet.reduced import ReducedArm, order_grid, read_heading
from lite6jax.fleet.terms import FleetProcess, PooledTerm

SOFT, BENT = PooledTerm("soft"), PooledTerm("bent")
LINE = wave(7.25, 0.9, 0.4)
CURVE = FleetProcess("joint3", "rz", "rad", (POSITION.phrase,), (-3.2, 3.2), "cubic")
BOTH = FleetProcess("joint3", "rz", "rad", (POSITION.phrase, LOAD.phrase), (-3.2, 3.2, -3.0, 3.0), "wave*line")


@pytest.fixture
def made():
    return arm(np.random.default_rng(0), [(SOFT, [0.8]), (BENT, [0.9, -0.8]), LINE])


def least_squares(made, terms):
    """Numbers of the last term, fitted beside the nuisance and the others, and their covariance in unit noise."""
    A = np.concatenate([made.basis, *(made.columns_of(term) for term in terms)]).T
    numbers = -np.linalg.lstsq(A, made.residual, rcond=None)[0]
    size = len(made.columns_of(terms[-1]))
    return numbers[-size:], np.linalg.inv(A.T @ A)[-size:, -size:]


@pytest.mark.parametrize("term", [SOFT, BENT, LINE[0], CURVE, BOTH])
def test_evidence_is_least_squares_beside_the_others(made, term):
    others = [other for other in (SOFT, BENT, LINE[0]) if other != term]
    found = made.beside(others).evidence(term)
    values, covariance = least_squares(made, [*others, term])
    np.testing.assert_allclose(np.linalg.solve(found.information, found.score), values, rtol=1e-8)
    np.testing.assert_allclose(np.linalg.inv(found.information), covariance, rtol=1e-8)
    left = made.beside(others).left
    assert found.left == pytest.approx(left @ left)
    assert found.freedom == made.residual.size - len(made.basis) - sum(len(made.columns_of(one)) for one in others)
    ratio = np.diagonal(found.covariance) / np.diagonal(found.information)
    assert ratio.min() > 0.3  # of 20 blocks of white noise of unit variance
    assert ratio.max() < 3


@pytest.mark.parametrize("noise", [None, Autocorrelation(0.8, 0.6)])
def test_scores_of_a_search_are_the_evidence_on_each_term(made, noise):
    if noise is not None:
        made = replace(made, noise=NoiseModel((noise,), np.zeros(1, int), (0, 30)))
    made = replace(made, training=np.arange(made.residual.size) % 9 > 0).beside([BENT])
    scan = made.scan(tried([made]).singles, OPTIONS)
    expected = made.evidence(SOFT)
    np.testing.assert_allclose(scan.named["soft"].score, expected.score)
    assert scan.named["bent"] is None  # it is in the model
    orders, (score, information, _) = order_grid(OPTIONS), scan.groups["waves:joint3"]
    for order in (1.0, 7.25, 133.125):
        at = int(np.flatnonzero(orders == order)[0])
        expected = made.evidence(PooledTerm("waves:joint3", order))
        np.testing.assert_allclose(score[at], expected.score, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(information[at], expected.information, rtol=1e-9, atol=1e-9)


def test_what_is_in_the_model_or_unknown_has_no_evidence(made):
    assert made.beside([SOFT]).evidence(SOFT) is None
    assert made.evidence(PooledTerm("unheard of")) is None
    assert made.evidence(PooledTerm("waves:joint9", 3.0)) is None
    assert made.evidence(replace(CURVE, site="joint9")) is None
    assert made.evidence(replace(CURVE, drivers=("position of joint 9",))) is None


def test_a_number_that_the_nuisance_does_as_well_has_no_information_at_all(made):
    """Rounding, divided by rounding, would be a number of any size."""
    column = made.parts["bent"].start
    made.columns[column] = 1e3 * made.basis[0] + 1e-7 * made.columns[column]
    found = made.evidence(BENT)
    assert (found.score[0], *found.information[0], *found.information[:, 0]) == (0.0, 0.0, 0.0, 0.0, 0.0)
    assert found.information[1, 1] > 1


def test_a_file_holds_the_recording(made, tmp_path):
    made = replace(made, noise=NoiseModel((Autocorrelation(0.8, 0.6),), np.zeros(1, int), (0, 30)))
    path = tmp_path / "a.npz"
    path.write_bytes(made.to_bytes())
    again = ReducedArm.from_bytes(path.read_bytes())
    np.testing.assert_allclose(again.columns, made.columns, rtol=1e-7)
    for name in ("places", "values", "run", "training", "basis", "residual", "blocks"):
        np.testing.assert_array_equal(getattr(again, name), getattr(made, name))
    models = [(model.coefficient, model.share) for model in again.noise.models]
    assert (models, again.noise.starts) == ([(0.8, 0.6)], (0, 30))
    assert made.to_bytes() == made.to_bytes()
    assert again.heading == read_heading(path) == made.heading


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"no", lambda b: b""])
def test_a_damaged_file_is_refused_with_the_remedy(made, tmp_path, damage):
    path = tmp_path / "a.npz"
    path.write_bytes(damage(made.to_bytes()))
    with pytest.raises(InputError, match=r"a\.npz: is no reduced recording of this version; .* with --force"):
        read_heading(path)
    with pytest.raises(InputError, match=r"^here: is no reduced recording"):
        ReducedArm.from_bytes(path.read_bytes(), "here")


def test_the_reduced_recording_gives_the_estimates_of_its_diagnosis(corpus):
    from lite6jax.fleet.reduction import reduced

    diagnosis = corpus["compliance"].diagnosis
    made = reduced(diagnosis)
    (finding,) = diagnosis.findings
    assert made.heading.found == ((finding.effect.label, finding.p_value),)
    (key,) = (
        one.key
        for one in made.heading.candidates
        if (one.effect, one.site) == (finding.effect.name, finding.effect.site)
    )
    found = made.evidence(PooledTerm(key))
    std = float(np.sqrt(finding.covariance[0, 0]))
    assert 1 / found.information[0, 0] == pytest.approx(std**2, rel=0.1)  # robust weights differ a little
    assert found.score[0] / found.information[0, 0] == pytest.approx(finding.values[0], abs=0.3 * std)


def test_processes_are_those_of_the_search_of_the_recording(corpus):
    from lite6jax.fleet.reduction import reduced

    diagnosis = corpus["compliance"].diagnosis
    made, problem = reduced(diagnosis), diagnosis.problem
    all_tried = tried([made])
    assert len(all_tried.singles) > 1000
    assert len(all_tried.pairs) > 1000
    quantities = {one.driver.phrase: one for one in problem.quantities}
    components = {(one.site, one.name): one for one in problem.components}
    for screened in (*all_tried.singles[::97], *all_tried.pairs[::97]):
        for process in all_tried.with_every_kernel(screened):
            own = [quantities[one] for one in process.drivers]
            effect = problem.process(components[process.site, process.component], own, process.kernel, 1.0)
            assert (effect.site, effect.unit) == (process.site, process.unit)
            expected = problem.columns([effect])
            columns = made.columns_of(process)[:, : expected[0].size].reshape(expected.shape)
            columns, expected = columns[..., made.training], expected[..., made.training]
            scale = np.vdot(columns, expected) / np.vdot(expected, expected)  # the noise, which all of them share
            np.testing.assert_allclose(columns, scale * expected, rtol=1e-6, atol=1e-6 * scale)
            assert scale == pytest.approx(1 / diagnosis.fit.scale[0], rel=0.2)


def test_waves_of_a_joint_that_does_not_show_are_not_scored(tmp_path):
    from lite6jax.fleet.reduction import reduced

    recording = Made(tmp_path, seed=1, orientation=False).recording(static_motion(1, 60))
    made = reduced(diagnose_poses(recording, options=Options(folds=2)))
    assert [one.site for one in made.heading.families] == [f"joint{j}" for j in range(1, 6)]  # the flange is on axis 6
    scan = made.beside([]).scan(tried([made]).singles, OPTIONS)
    assert set(scan.groups) >= {one.key for one in made.heading.families}
