"""Standard deviations of predicted torques: of numbers, noise and what is left, and outside what was recorded."""

import json
from dataclasses import replace

import numpy as np
import pyarrow.csv
import pytest
from domains.torque.moved import GRAVITY, hidden, motion_of, recorded, setup_of
from typed import flat, run

from benchmarks.torque_trials.physics import torques
from lite6jax.arms.dynamics import link_parameters
from lite6jax.diagnosis.document import model_from_document, write_document
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.torque_diagnosis import diagnose_torques
from lite6jax.domains.predict import predict, predicted
from lite6jax.domains.torque.predict import (
    DiagnosedMotors,
    link_sites,
    with_free_numbers,
)
from lite6jax.domains.uncertainty import RecordedRange, Uncertainty
from lite6jax.effects.catalogue import TORQUE_EFFECTS
from lite6jax.effects.dynamic import UnnamedTorque
from lite6jax.effects.serialization import parse_effect
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Terms, join
from lite6jax.recordings import Recording, write_recording
from lite6jax.report.compensations import NO_BARS

FRICTION = (
    hidden("viscous_friction", "joint2", viscous_Nm_s_per_rad=0.6),
    hidden("coulomb_friction", "joint2", coulomb_Nm=0.4),
)


@pytest.fixture(scope="module")
def diagnosed():
    """Friction beside a wave that no effect of the search is allowed to explain, so that something is left."""
    wave = 0.06 * np.sin(np.arange(600) / 7.0)
    recording, arm = recorded(
        FRICTION, seed=1, change=lambda tau: tau + np.stack([wave * (j == 4) for j in range(6)], 1)
    )
    return diagnose_torques(recording, arm, options=Options(folds=2))


@pytest.fixture(scope="module")
def model(diagnosed):
    return model_from_document(json.loads(json.dumps(diagnosed.to_dict())))


def unseen(seed, factor=1.0):
    """Another motion of the arm of `diagnosed`, and what its motors exert."""
    setup, _ = setup_of(1)
    motion = motion_of(setup, seed)
    if factor != 1.0:
        motion = replace(motion, time=motion.time / factor, dq=motion.dq * factor, ddq=motion.ddq * factor**2)
    recording = Recording.from_arrays(motion.q, time=motion.time, joint_velocity=motion.dq, motion="trajectory")
    return setup, motion, recording


def test_bars_hold_the_share_of_rows_that_they_claim(diagnosed, model):
    """Of motions that were not recorded, of each joint and of all, with the sensor's noise."""
    rng, within = np.random.default_rng(0), []
    wave = np.sin(np.arange(600) / 7.0 + 1.0)
    for seed in (7, 9, 10):
        setup, motion, recording = unseen(seed)
        shown = torques(setup, FRICTION, motion) + rng.normal(0, 1, motion.q.shape) * 0.5 * setup.arm.noise
        shown[:, 4] += 0.06 * wave[: len(shown)]
        found = predicted(model, recording)
        inside = ~found.outside
        inside[:15] = inside[-15:] = False  # accelerations at the ends of a run are not known as well
        within.append((np.abs(found.torque - shown) <= 1.96 * found.std)[inside])
    share = np.concatenate(within)
    assert len(share) > 500
    assert 0.93 <= share.mean() <= 0.97
    assert share.mean(0).min() > 0.9


def test_without_what_is_left_the_bars_would_be_too_narrow(model):
    narrow = replace(model, uncertainty=replace(model.uncertainty, left=np.zeros(6), unseen=np.zeros(6)))
    _, _, recording = unseen(7)
    ratio = predicted(narrow, recording).std[:, 4] / predicted(model, recording).std[:, 4]
    assert ratio.max() < 0.9


def test_rows_outside_are_marked_and_their_bars_grow(model):
    _, _, usual = unseen(10)
    _, _, fast = unseen(10, factor=3.0)
    inside, beyond = (predicted(model, motion) for motion in (usual, fast))
    assert beyond.outside.mean() > 0.5 > inside.outside.mean()
    assert np.median(beyond.std[beyond.outside]) > 1.5 * np.median(inside.std[~inside.outside])


def with_uncertainty(texts, inertial, rng):
    """A Lite 6 with these effects and a covariance of all its numbers."""
    setup, arm = setup_of(2)
    pairs = [parse_effect(text, TORQUE_EFFECTS) for text in texts]
    terms, values = Terms(tuple(e for e, _ in pairs)), join(v for _, v in pairs)
    links = np.asarray(link_parameters(arm))
    size = 60 * inertial + with_free_numbers(terms, values)[0].size
    root = 1e-5 * rng.normal(size=(size, size))
    everywhere = np.tile([-1e3, 1e3], (6, 1))
    recorded_range = RecordedRange(everywhere, np.zeros((1, 6)), 1e3, {}, everywhere, everywhere)
    nothing, sites = np.zeros(6), link_sites(6) if inertial else ()
    known = Uncertainty(sites, root @ root.T, nothing, nothing, nothing, recorded_range)
    return setup, DiagnosedMotors(arm, links, np.zeros(3), GRAVITY, terms, values, 25.0, uncertainty=known)


@pytest.mark.parametrize(
    ("texts", "inertial"),
    [
        (("viscous_friction:joint=2,viscous_Nm_s_per_rad=0.8", "torque_scale:joint=2,scale=0.2"), True),
        (("stribeck_friction:joint=3,stribeck_Nm=0.5,velocity_rad_per_s=0.15", "payload_error:mass_kg=0.4"), False),
        (
            ("torque_ripple:joint=1,order=7.5,amplitude_Nm=0.2,phase_rad=1", "link_com:link=2,x_m=0.01,y_m=0,z_m=0.02"),
            False,
        ),
        (("time_offset:offset_s=0", "coulomb_friction:joint=4,coulomb_Nm=0.3"), False),
        (("torque_lag:joint=3,lag_s=0", "viscous_friction:joint=3,viscous_Nm_s_per_rad=0.8"), False),
    ],
)
def test_variances_are_those_of_the_prediction(texts, inertial):
    """By differences of the prediction itself, along each direction of the covariance."""
    setup, model = with_uncertainty(texts, inertial, np.random.default_rng(5))
    motion = motion_of(setup, 3, seconds=2.0)
    recording = Recording.from_arrays(motion.q, time=motion.time, joint_velocity=motion.dq, motion="trajectory")
    free, values = with_free_numbers(model.terms, model.values)
    eigenvalues, V = np.linalg.eigh(model.uncertainty.covariance)
    variance = np.zeros_like(motion.q)
    for direction in (V * np.sqrt(np.maximum(eigenvalues, 0.0))).T:
        links = direction[:60].reshape(6, 10) if inertial else np.zeros((6, 10))
        numbers = direction[60:] if inertial else direction
        sides = [
            predict(replace(model, links=model.links + s * links, terms=free, values=values + s * numbers), recording)
            for s in (1.0, -1.0)
        ]
        variance += ((sides[0] - sides[1]) / 2) ** 2
    inside = slice(20, -20)  # a delay goes on beyond the ends of a run in its own way
    found = predicted(model, recording).std
    np.testing.assert_allclose(found[inside], np.sqrt(variance)[inside], rtol=2e-2, atol=1e-4 * found.max())


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda u: u["covariance"].pop(), "covariance is not one of"),
        (lambda u: u.update(left=[0.1]), "not one of this arm"),
        (lambda u: u["recorded"].update(joint_range_rad=[[1, 0]] * 6), "ends before it begins"),
        (lambda u: u.update(noise=[-1.0] * 6), ">= 0.0"),
    ],
)
def test_damaged_bars_are_refused(diagnosed, damage, message):
    document = json.loads(json.dumps(diagnosed.to_dict()))
    damage(document["model"]["uncertainty"])
    with pytest.raises(InputError, match=message):
        model_from_document(document)


def test_the_command_writes_bars_beside_torques(diagnosed, tmp_path, capsys):
    document = diagnosed.to_dict()
    path = write_document(document, tmp_path / "d.json")
    motion = write_recording(unseen(7)[2], tmp_path / "motion.csv")
    code, said, _ = run(capsys, "predict", path, motion, "--out", tmp_path / "p.csv")
    assert code == 0
    table = pyarrow.csv.read_csv(tmp_path / "p.csv")
    names = [f"tau{j}{std}_Nm" for std in ("", "_std") for j in range(1, 7)]
    assert table.column_names == [*names, "outside"]
    count = sum(table.column("outside").to_pylist())
    assert f"{count} of {table.num_rows} rows are outside what was recorded" in flat(said)
    assert min(table.column("tau1_std_Nm").to_pylist()) > 0
    del document["model"]["uncertainty"]
    write_document(document, path, overwrite=True)
    code, _, warned = run(capsys, "predict", path, motion, "--out", tmp_path / "old.csv")
    assert code == 0
    assert NO_BARS in flat(warned)
    assert pyarrow.csv.read_csv(tmp_path / "old.csv").column_names == names[:6]


def test_a_process_is_as_uncertain_beyond_its_range_as_its_prior():
    setup, model = with_uncertainty((), False, np.random.default_rng(6))
    process = UnnamedTorque(2, "position of joint 2", -0.05, 0.05, "smooth", spread=0.3)
    terms, size = Terms((process,)), process.size
    known = replace(model.uncertainty, covariance=1e-12 * np.eye(size))
    model = replace(model, terms=terms, values=np.zeros(size), uncertainty=known)
    motion = motion_of(setup, 7)
    recording = Recording.from_arrays(motion.q, time=motion.time, joint_velocity=motion.dq, motion="trajectory")
    std = predicted(model, recording).std
    far = np.abs(motion.q[:, 1]) > 0.6
    # the constant that every process has is known, and the rest of it has the prior's variance
    np.testing.assert_allclose(std[far, 1], 0.3, atol=0.01)
    assert std[:, [0, 2, 3, 4, 5]].max() < 1e-3
