"""Score tests: blind to units, uniform under noise, large and near the truth where something is there."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.recorded import OPTIONS, Made, fitted_to, static_motion, truth, with_effects

from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.catalogue import catalogue
from lite6jax.effects.kinematic import FrameOffset, JointCompliance, JointOffset
from lite6jax.effects.serialization import parse_effect
from lite6jax.estimation.projection import Span, unit_rows
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms

SAMPLES = 160


@pytest.fixture(scope="module")
def still():
    return static_motion(7, SAMPLES)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=1)


def against_nothing(case):
    return score_test(case, fitted_to(case, Terms()), OPTIONS)


@pytest.mark.parametrize(
    "text",
    [
        "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",
        "joint_backlash:joint=4,gap_rad=1.2e-3",
        "joint_scale:joint=3,scale=3e-4",
        "joint_harmonic:joint=5,order=2,amplitude_rad=6e-4,phase_rad=-2",
        "measurement_scale:scale=4e-4",
        "link_thermal_expansion:expansion_per_K=4e-5",
    ],
)
def test_a_true_effect_scores_what_its_size_says(arm, still, text):
    made = with_effects(arm, text)
    case = pose_problem(made.recording(still))
    evidence = against_nothing(case)
    effect, values = parse_effect(text)
    score = evidence.score([effect])[0]
    column = case.columns([effect]).reshape(effect.size, -1)
    information = column @ column.T
    # residuals are taken to unit length of everything that is left, the effect too
    scale = evidence.fit.scale[0]
    off = score.values - values
    assert np.sqrt(off @ information @ off) < 5 * scale + 0.05 * np.sqrt(values @ information @ values)
    assert score.gain > 0.3 * min(values @ information @ values, 500)
    assert score.p_value < 1e-6
    assert not score.confounded
    # among all of the catalogue none explains clearly more
    every = [e for e in catalogue(6, turned_tool=True) if e.name not in ("joint_lag", "time_offset", "payload_error")]
    best = max(evidence.score(every), key=lambda s: s.gain)
    assert score.gain > 0.98 * best.gain


@pytest.mark.parametrize("options", [{}, {"frame": True, "orientation": False}, {"geometry": "free", "frame": True}])
def test_noise_alone_gives_p_values_that_are_not_too_small(arm, still, options):
    """Kolmogorov's bound, on one side, over candidates that have little in common."""
    made = Made(arm.folder, seed=1, **options)
    poses = made.poses(still)
    candidates = [parse_effect(text, neutral=True)[0] for text in CANDIDATES]
    p = []
    for seed in range(8):
        evidence = against_nothing(pose_problem(made.recording(still, poses=poses, seed=seed)))
        p += [score.p_value for score in evidence.score(candidates) if not score.confounded]
    p = np.sort(p)
    assert len(p) > 150
    above = np.arange(1, len(p) + 1) / len(p) - p
    assert above.max() < 1.95 / np.sqrt(len(p))  # of a thousand such tests one fails
    assert p[0] > 1e-5
    assert np.mean(p < 0.5) > 0.3  # nor are they useless


CANDIDATES = [
    *(f"joint_harmonic:joint={joint},order={order}" for joint in (1, 2, 4, 5) for order in (17.3, 40, 101)),
    *(f"joint_backlash:joint={joint}" for joint in (1, 2, 3, 4, 5)),
    *("joint_coupling:joint=2,source_joint=4", "joint_coupling:joint=4,source_joint=1", "base_drift"),
    *("joint_compliance:joint=3", "joint_compliance:joint=5"),
]


def test_units_and_the_choice_of_numbers_do_not_matter(arm, still):
    made = Made(arm.folder, ("joint_harmonic:joint=2,order=2,amplitude_rad=1e-4,phase_rad=1",), seed=1, frame=True)
    case = pose_problem(made.recording(still))
    evidence = against_nothing(case)
    columns = case.columns([FrameOffset(3)])
    mixed = np.einsum("ij,jrs->irs", np.random.default_rng(0).uniform(-1, 1, (6, 6)), columns)
    plain, scaled, other = evidence.score_columns([columns, 1e-7 * columns, mixed])
    assert plain.size == scaled.size == other.size == 6
    for score in (scaled, other):
        assert score.gain == pytest.approx(plain.gain, rel=1e-6)
        assert score.p_value == pytest.approx(plain.p_value, rel=1e-4)
    np.testing.assert_allclose(1e-7 * scaled.values, plain.values, rtol=1e-6)


def test_a_column_twice_counts_once(arm, still):
    case = pose_problem(Made(arm.folder, seed=1, frame=True).recording(still))
    evidence = against_nothing(case)
    column = case.columns([JointCompliance(2)])
    one, two = evidence.score_columns([column, np.concatenate([column, 3 * column])])
    assert (one.size, two.size) == (1, 1)
    assert two.gain == pytest.approx(one.gain, rel=1e-9)


def test_the_last_joint_does_not_show_in_positions_of_the_flange(arm, still):
    case = pose_problem(Made(arm.folder, seed=1, orientation=False).recording(still))
    evidence = against_nothing(case)
    hidden = {e.label for e, s in zip(_known(case), evidence.score(_known(case)), strict=True) if s.confounded}
    assert {e.label for e in _known(case) if e.site == "joint6"} <= hidden
    assert not any(label.startswith("joint_offset:joint2") for label in hidden)
    assert "joint_compliance:joint5" not in hidden


def _known(case):
    lacking = ("joint_lag", "time_offset", "payload_error")
    return [effect for effect in catalogue(6) if effect.name not in lacking]


def test_geometry_that_is_free_hides_offsets(arm, still):
    case = pose_problem(Made(arm.folder, seed=2, geometry="free", frame=True, tool=True).recording(still))
    fitted = fitted_to(case, Terms())
    evidence = score_test(case, fitted, OPTIONS)
    offsets = [FrameOffset(link) for link in (None, 1, 2, 3, 4, 5)] + [JointOffset(joint) for joint in range(1, 7)]
    assert all(score.confounded for score in evidence.score(offsets))
    backlash, _ = parse_effect("joint_backlash:joint=4", neutral=True)
    assert not any(score.confounded for score in evidence.score([JointCompliance(2), backlash]))


def test_what_the_model_has_already_is_hidden(arm, still):
    effect, _ = truth("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5")
    made = with_effects(arm, "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5")
    case = pose_problem(made.recording(still))
    evidence = score_test(case, fitted_to(case, Terms((effect,))), OPTIONS)
    assert evidence.score([effect])[0].confounded
    assert evidence.score([JointCompliance(3)])[0].p_value > 1e-4


def test_a_term_left_out_is_weighed_beside_the_others(arm, still):
    texts = (
        "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",
        "joint_harmonic:joint=5,order=2,amplitude_rad=6e-4,phase_rad=-2",
    )
    effects = tuple(truth(text)[0] for text in texts)
    case = pose_problem(with_effects(arm, *texts).recording(still))
    fitted = fitted_to(case, Terms(effects))
    whole = score_test(case, fitted, OPTIONS)
    assert whole.beside([True, True]) is whole
    for k, stays in enumerate(([False, True], [True, False])):
        score = whole.beside(stays).score([effects[k]])[0]
        assert score.gain > 100
        np.testing.assert_allclose(score.values, fitted.values[fitted.terms.slices[k]], rtol=2e-2, atol=1e-9)
    alone = whole.beside([False, False])
    assert alone.fit.terms.terms == ()
    assert len(alone.basis) == len(whole.basis) - fitted.terms.size


@pytest.mark.parametrize("dependent", [False, True])
@pytest.mark.parametrize("left_out", [[], [3], [0, 7, 8], range(12)])
def test_a_part_of_a_span_is_that_of_the_rows_which_stay(dependent, left_out):
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(12, 40))
    if dependent:
        rows[5] = rows[1] + rows[2]
    rows = unit_rows(rows)
    kept = np.ones(12, bool)
    kept[list(left_out)] = False
    part = Span.of_rows(rows, 1e-12).part(kept, 1e-12)
    basis = part.basis
    stay = np.linalg.svd(rows[kept], full_matrices=False)
    wanted = stay[2][stay[1] > 1e-6]
    np.testing.assert_allclose(basis.T @ basis, wanted.T @ wanted, rtol=0, atol=1e-10)
    np.testing.assert_allclose(basis @ basis.T, np.eye(len(wanted)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(part.coordinates @ part.whole, rows[kept], rtol=0, atol=1e-12)
    others = rng.normal(size=(3, 40))
    np.testing.assert_allclose(part.outside(others), others - others @ wanted.T @ wanted, rtol=0, atol=1e-10)
    more = part.extended(others, 1e-12)
    assert len(more.basis) == len(basis) + 3
    np.testing.assert_allclose(more.outside(np.concatenate([rows[kept], others])), 0.0, rtol=0, atol=1e-10)


def test_rows_left_out_are_not_evidence(arm, still):
    recording = arm.recording(still)
    used = np.arange(SAMPLES) < 120
    position = recording.position.copy()
    position[~used] += 1e-3
    spoilt = pose_problem(replace(recording, position=position))
    evidence = score_test(spoilt, fitted_to(spoilt, Terms(), training=used), OPTIONS)
    clean = pose_problem(recording)
    wanted = score_test(clean, fitted_to(clean, Terms(), training=used), OPTIONS)
    for one, other in zip(evidence.score(_known(clean)), wanted.score(_known(clean)), strict=True):
        assert one.gain == pytest.approx(other.gain, rel=1e-9, abs=1e-12)


def test_wild_rows_count_for_little(arm, still):
    recording = arm.recording(still)
    position = recording.position.copy()
    position[[3, 77, 140]] += 0.05
    evidence = against_nothing(pose_problem(replace(recording, position=position)))
    assert min(score.p_value for score in evidence.score(_known(evidence.problem))) > 1e-4
