"""Error bars of predictions: of the numbers that were estimated, of what is left, and outside what was recorded."""

import copy
import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.csv
import pytest
from diagnosis.recorded import NOISE, Made, moving_motion, quaternions, static_motion
from domains.pose.documents import document, stored
from typed import flat, refusal, run

from lite6jax.arms.chains import SixParameterForm
from lite6jax.diagnosis.diagnose import diagnose_poses
from lite6jax.diagnosis.document import model_from_document
from lite6jax.diagnosis.options import Options
from lite6jax.domains.pose.compensate import compensate
from lite6jax.domains.pose.predict import SPARSE, Derivatives
from lite6jax.domains.pose.registration import register_model
from lite6jax.domains.predict import predict, predicted
from lite6jax.domains.uncertainty import RecordedRange, Uncertainty, freed
from lite6jax.effects.composition import Physics
from lite6jax.effects.kinematic import FrameOffset, ToolOffset
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.serialization import effect_as_dict
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.prior import Prior
from lite6jax.model import predict_poses
from lite6jax.recordings import Recording, read_recording, write_recording
from lite6jax.report.compensations import NO_BARS, corrected_columns

COMPLIANCE = "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"
SITES = tuple((name, j, k) for name, j in (("base", 0), ("link", 2), ("tool", 0)) for k in range(6))
SAMPLES = 25
ARRAYS = ("time", "joint_temperature", "payload")


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), (COMPLIANCE,), seed=1, frame=True, tool=True)


@pytest.fixture(scope="module")
def found(arm):
    """A diagnosis of a quarter of the arm's range, so that there is much outside."""
    return diagnose_poses(arm.recording(narrow(1)))


@pytest.fixture(scope="module")
def content(found):
    return json.loads(json.dumps(found.to_dict()))


@pytest.fixture(scope="module")
def model(content):
    return model_from_document(content)


def narrow(seed, samples=120):
    """Poses in a quarter of each joint's range."""
    motion = static_motion(seed, samples)
    return {**motion, "joint_position": motion["joint_position"] / 4 + [0.0, 0.0, 1.2, 0.0, 0.4, 0.0]}


def shown(model, motion):
    return predicted(model, motion["joint_position"], **{name: motion[name] for name in ARRAYS})


def known(model, covariance=None, sites=SITES, left=(0.0, 0.0), unseen=(0.0, 0.0), joints=None, rows=None):
    """A model with an uncertainty of one's own, recorded everywhere where not said otherwise."""
    size = len(sites) + sum(freed(effect).size for effect in model.physics.effects)
    C = np.zeros((size, size)) if covariance is None else covariance
    ranges = np.tile([-9.0, 9.0], (6, 1)) if joints is None else joints
    recorded = RecordedRange(ranges, np.zeros((1, 6)) if rows is None else rows, 99.0 if rows is None else 0.0, {})
    return replace(model, uncertainty=Uncertainty(sites, C, left, unseen, (0.0, 0.0), recorded))


# ------------------------------------------------------------------ derivatives and what they carry


@pytest.mark.parametrize(
    "texts",
    [
        (COMPLIANCE, "joint_harmonic:joint=4,order=63.3,amplitude_rad=5e-4,phase_rad=3"),
        ("measurement_scale:scale=4e-4", "base_drift:vx_m_per_s=1e-6,vy_m_per_s=-2e-6,vz_m_per_s=1e-6"),
        (COMPLIANCE, "payload_error:mass_kg=0.1"),
        ("time_offset:offset_s=0.006", "joint_lag:joint=2,lag_s=2e-3"),
    ],
)
def test_derivatives_are_those_of_the_pure_prediction(arm, texts):
    """To the angles of the deflections, some thousandths: `jax.jvp` with every frame displaced as an effect is.

    What one effect changes of another's derivative is left out: a wrong payload changes the loads by some per cent, and
    the clock the velocity that a lag multiplies.
    """
    moving = "time_offset" in texts[0]
    model = model_from_document(document(arm, texts, "trajectory" if moving else "static"))
    motion = (moving_motion if moving else static_motion)(9, 40)
    names = (*ARRAYS, "run", *(["joint_velocity"] if moving else []))
    recording = Recording.from_arrays(motion["joint_position"], **{name: motion[name] for name in names})
    recording = recording.made_anew(settings=replace(recording.settings, motion=model.motion))
    sequence = model.motion_of(recording)
    effects = (*(freed(e) for e in model.physics.effects), FrameOffset(), FrameOffset(3), ToolOffset(True))
    physics = Physics(effects)
    numbers = []
    for effect, part in model.physics.pairs:
        numbers += [*model.values[part], *([effect.chosen] if freed(effect) is not effect else [])]
    at = jnp.asarray([*numbers, *np.zeros(18)])

    @jax.jit
    def poses(values):
        return predict_poses(SixParameterForm(6), physics, model.model, values, sequence, model.inertia)

    T = np.asarray(poses(at))
    wanted = []
    for direction in np.roll(np.eye(len(at)), -18, 1):  # the offsets first
        _, moved = jax.jvp(poses, (at,), (jnp.asarray(direction),))
        spin = np.einsum("nji,njk->nik", T[:, :3, :3], np.asarray(moved)[:, :3, :3])
        wanted.append([*np.asarray(moved)[:, :3, 3].T, spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]])
    found = Derivatives(model, sequence, SITES).all()
    for ours, theirs in zip(found, np.array(wanted), strict=True):
        inner = slice(4, -4) if moving else slice(None)  # the ends are extrapolated
        atol = (0.05 if "payload" in texts[1] else 0.03 if moving else 0.01) * np.abs(theirs).max() + 1e-12
        np.testing.assert_allclose(ours[:, inner], theirs[:, inner], rtol=0, atol=atol)


def test_bars_are_those_of_draws_of_the_numbers(arm):
    """The spread of predictions by 400 draws of frames and effects; a standard deviation of these is known to 4 %."""
    rng = np.random.default_rng(0)
    model = model_from_document(document(arm, [COMPLIANCE]))
    A = rng.normal(size=(19, 19))
    size = np.array([*([1e-5] * 3 + [2e-5] * 3) * 3, 3e-6])
    C = A @ A.T / 19 * np.outer(size, size)
    model = known(model, C)
    motion = static_motion(9, SAMPLES)
    motion["joint_temperature"][:] = 25.0
    bars = shown(model, motion)
    physics = Physics((FrameOffset(), FrameOffset(3), ToolOffset(True), *model.physics.effects))
    drawn = []
    for numbers in rng.multivariate_normal(np.zeros(19), C, 400):
        values = np.array([*numbers[:18], model.values[0] + numbers[18]])
        drawn.append(shown(replace(model, physics=physics, values=values, uncertainty=None), motion).poses)
    spread = np.std(np.array(drawn)[:, :, :3, 3], 0)
    np.testing.assert_allclose(bars.position_std, spread, rtol=0.16)
    R = bars.poses[:, :3, :3]
    turned = np.einsum("nji,dnjk->dnik", R, np.array(drawn)[:, :, :3, :3])
    vectors = np.stack([turned[..., 2, 1], turned[..., 0, 2], turned[..., 1, 0]], -1)
    np.testing.assert_allclose(bars.orientation_std, vectors.std(0), rtol=0.16)


def test_the_covariance_is_that_of_the_fit(arm, found, model):
    """Of the effect's own number, but that a prediction carries the declared payload, right or wrong; and of the
    prediction by least squares in closed form.
    """
    known, k = model.uncertainty, len(model.uncertainty.sites)
    certain = EngineOptions(prior=Prior(wrong_input=0.0))
    sure = diagnose_poses(arm.recording(narrow(1)), options=Options(folds=2, engine=certain))
    np.testing.assert_allclose(known.covariance[k:, k:], sure.fit.covariance, rtol=1e-3)
    assert np.all(found.fit.covariance > sure.fit.covariance)
    change = Derivatives(model, found.problem.motion, known.sites)
    J = change.all() / np.repeat(NOISE, 3)[:, None]
    flat = J.reshape(len(J), -1)
    G = np.linalg.pinv(flat @ flat.T, rcond=1e-14, hermitian=True)
    wanted = np.einsum("ias,ij,jas->as", J, G, J) * np.repeat(np.square(NOISE), 3)[:, None]
    ours = change.variance(known.covariance)
    np.testing.assert_allclose(np.sqrt(ours / wanted), 1.0, atol=0.15)  # the scale of the noise is estimated


def test_what_is_left_adds_in_quadrature(arm):
    model = model_from_document(document(arm, [COMPLIANCE]))
    bars = shown(known(model, left=(3e-5, 2e-4)), static_motion(9, SAMPLES))
    np.testing.assert_allclose(bars.position_std, 3e-5, rtol=1e-12)
    np.testing.assert_allclose(bars.orientation_std, 2e-4, rtol=1e-12)
    assert not bars.outside.any()


def test_what_held_out_rows_show_is_left(found):
    """A model that misses unseen rows by a tenth of a millimetre says so; one that does not has nothing left."""
    worse = replace(found, errors=found.errors._replace(after=np.full_like(found.errors.after, 1e-4)))
    left = worse.to_dict()["model"]["uncertainty"]["left"][0]
    assert left == pytest.approx(1e-4 / np.sqrt(7.8147), rel=0.2)
    assert found.to_dict()["model"]["uncertainty"]["left"][0] < NOISE[0]


def test_poses_without_noise_are_within_their_bars(arm, model):
    """Of 1800 components where the arm was recorded, and as many outside."""
    inside, all_over = narrow(5, 300), static_motion(6, 300)
    for motion, least in ((inside, 0.93), (all_over, 0.9)):
        bars = shown(model, motion)
        off = np.abs(bars.poses - arm.poses(motion))[:, :3, 3]
        assert np.mean(off < 1.96 * bars.position_std) > least
        assert np.sqrt(np.mean(bars.position_std**2)) < 40 * NOISE[0]


# ------------------------------------------------------------------ outside


def test_bars_grow_with_the_distance_beyond_the_spacing(arm):
    """Half a radian away the variance of what is left has doubled."""
    rows = np.zeros((1, 6))
    model = known(
        model_from_document(document(arm, [])), left=(1e-5, 1e-4), joints=np.tile([-0.1, 0.1], (6, 1)), rows=rows
    )
    q = np.zeros((4, 6))
    q[:, 2] = 0.0, 0.1, 0.5, 1.5
    bars = predicted(model, q)
    np.testing.assert_allclose(bars.position_std[:, 0], 1e-5 * np.sqrt(1 + (q[:, 2] / 0.5) ** 2), rtol=1e-12)
    assert bars.outside.tolist() == [False, False, True, True]


def test_a_quantity_beyond_what_was_recorded_is_outside(arm):
    """A drift in time, an hour later than it was recorded."""
    model = model_from_document(document(arm, ["base_drift:vx_m_per_s=1e-6,vy_m_per_s=0,vz_m_per_s=0"]))
    model = known(model, left=(1e-5, 1e-4))
    recorded = replace(model.uncertainty.recorded, drivers={"time": (0.0, 1000.0)})
    model = replace(model, uncertainty=replace(model.uncertainty, recorded=recorded))
    bars = predicted(model, np.zeros((3, 6)), time=[0.0, 1000.0, 4600.0])
    assert bars.outside.tolist() == [False, False, True]
    assert bars.position_std[2, 0] > 10 * bars.position_std[1, 0] == pytest.approx(1e-4)


def test_a_process_goes_back_to_its_prior_beyond_its_range(arm):
    """Its angle is then as uncertain as the process alone: the pose turns by it, and moves by that times the lever."""
    process = Unnamed("joint3", "position of joint 3", -0.5, 0.5, "medium", spread=2e-4)
    values = 1e-4 * np.random.default_rng(0).normal(size=process.size)
    content = document(arm, [])
    content["model"]["effects"] = [effect_as_dict(process, values)]
    model = known(model_from_document(content))
    recorded = replace(model.uncertainty.recorded, drivers={"position of joint 3": (-0.5, 0.5)})
    model = replace(model, uncertainty=replace(model.uncertainty, recorded=recorded))
    q = np.zeros((5, 6))
    q[:, 2] = 0.0, 0.5, 0.6, 2.0, 6.0
    bars, rigid = predicted(model, q), predict(model.without("unnamed"), q)
    assert bars.outside.tolist() == [False, False, True, True, True]
    left = process.unknown_at(q[:, 2][None])
    np.testing.assert_allclose(np.sum(bars.orientation_std**2, 1), left, rtol=1e-9, atol=1e-30)
    assert (bars.position_std[:2] == 0).all()
    assert 0 < left[2] < left[3] == pytest.approx(left[4], rel=1e-3)
    # beside a constant of unit variance, as well known as the range has lengths of the kernel, the process has its own
    assert 1.0 < left[4] / 2e-4**2 < 1.3
    turned = np.linalg.norm(bars.poses[:, :3, 3] - rigid[:, :3, 3], axis=1)
    lever = turned / np.abs(values @ process.functions_at(q[:, 2][None]))
    moved = np.sqrt(np.sum(bars.position_std**2, 1))
    np.testing.assert_allclose(moved[2:], lever[2:] * np.sqrt(left[2:]), rtol=1e-3)


# ------------------------------------------------------------------ models that change


def test_an_effect_that_is_removed_takes_its_uncertainty_with_it(arm):
    texts = [COMPLIANCE, "joint_harmonic:joint=4,order=63.3,amplitude_rad=5e-4,phase_rad=3"]
    model = model_from_document(document(arm, texts))
    C = np.diag(np.arange(1.0, 23.0) ** 2)
    model = known(model, C)
    rest = model.without("joint_compliance").uncertainty
    np.testing.assert_array_equal(np.sqrt(np.diagonal(rest.covariance)), [*range(1, 19), 20, 21, 22])
    assert model.without("joint_harmonic").uncertainty.covariance.shape == (19, 19)
    np.testing.assert_array_equal(np.sqrt(np.diagonal(rest.without_base().covariance)), [*range(7, 19), 20, 21, 22])


def test_frames_that_are_registered_have_the_uncertainty_of_that_fit(arm, model):
    """Another place of the sensor: as sure as the new poses make it, within what is known of the rest."""
    moved, _ = register_model(model, arm.recording(narrow(7, 60), seed=3))
    bars, before = shown(moved, narrow(8, 60)), shown(model, narrow(8, 60))
    ratio = np.median(bars.position_std) / np.median(before.position_std)
    assert 0.8 < ratio < 2.0  # half as many poses


def test_positions_alone_have_no_bars_of_orientations(model):
    positions = replace(model, orientation=False)
    assert shown(positions, narrow(5, 5)).orientation_std is None


def test_rows_without_a_pose_have_no_bars(arm):
    model = known(model_from_document(document(arm, ["time_offset:offset_s=0.05"], "trajectory")), left=(1e-5, 1e-5))
    motion = moving_motion(9, 30)
    names = ("time", "run", "joint_velocity")
    bars = predicted(model, motion["joint_position"], **{name: motion[name] for name in names})
    np.testing.assert_array_equal(np.isnan(bars.position_std[:, 0]), np.isnan(bars.poses[:, 0, 0]))
    assert np.isnan(bars.poses[:, 0, 0]).sum() == 4


# ------------------------------------------------------------------ files


def test_what_is_written_is_read(found, content, model):
    again = model.uncertainty
    written = content["model"]["uncertainty"]
    assert len(again.recorded.positions) == 120
    assert list(written["recorded"]["drivers"]) == ["gravity torque of joint 2"]
    np.testing.assert_array_equal(again.covariance, again.covariance.T)
    assert np.linalg.eigvalsh(again.covariance / np.sqrt(np.outer(*[np.diagonal(again.covariance)] * 2))).min() > -1e-9
    assert again.sites == (*found.problem.frames, *found.problem.masses)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda entry: entry["covariance"].pop(), "its covariance is not one of"),
        (lambda entry: entry["sites"].append(["link", 9, 0]), "a site of its uncertainty is none of this arm"),
        (lambda entry: entry["recorded"]["joint_range_rad"].pop(), "its recorded range is not one of this arm"),
        (
            lambda entry: entry["left"].__setitem__(0, float("nan")),
            "Expected `float`, got `null` - at `$.model.uncertainty.left[0]`",
        ),
        (lambda entry: entry.pop("left"), "`left`"),
    ],
)
def test_what_is_damaged_is_refused(content, damage, says):
    content = copy.deepcopy(content)
    damage(content["model"]["uncertainty"])
    said = refusal(model_from_document, content)
    assert says in said
    assert "run `lite6jax diagnose` again" in said


@pytest.fixture
def motion_file(tmp_path):
    def written(motion):
        recording = Recording.from_arrays(motion["joint_position"], **{name: motion[name] for name in ARRAYS})
        path = write_recording(recording, tmp_path / "motion.csv", overwrite=True)
        path.with_suffix(".yaml").unlink(missing_ok=True)
        return path

    return written


def test_the_columns_that_predict_writes(capsys, model, content, motion_file, tmp_path):
    motion = {**narrow(5, 12)}
    motion["joint_position"][4] = static_motion(6, 12)["joint_position"][4]
    diagnosis, out = stored(tmp_path, content), tmp_path / "predicted.csv"
    code, said, err = run(capsys, "predict", diagnosis, motion_file(motion), "--out", out)
    assert (code, err) == (0, "")
    bars = shown(model, motion)
    count = int(bars.outside.sum())
    assert 1 <= count < 12
    assert f"{count} of 12 rows {'is' if count == 1 else 'are'} outside what was recorded, beyond its range or" in flat(
        said
    )
    table = pyarrow.csv.read_csv(out)
    std = [f"{axis}_std_m" for axis in "xyz"], [f"r{axis}_std_rad" for axis in "xyz"]
    assert table.column_names == [*("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"), *std[0], *std[1], "outside"]
    for names, wanted in zip(std, (bars.position_std, bars.orientation_std), strict=True):
        np.testing.assert_allclose(np.stack([table[name] for name in names], 1), wanted, rtol=1e-9)
    np.testing.assert_array_equal(table["outside"], bars.outside)


@pytest.mark.parametrize(
    ("code", "numbers", "says"),
    [
        (
            "joint_turns",
            {"joint": 5, "added_rad": 0.02},
            "corrected its joint columns (joint zero or whole turns), and these are taken as they are",
        ),
        ("joint_turns", {"joints": [5]}, ""),  # of some rows of that file
        ("sensor_scale", {"factor": 1.01}, "positions are in true metres, not in those of the sensor"),
    ],
)
def test_predict_says_which_faults_of_columns_it_does_not_correct(
    capsys, content, motion_file, tmp_path, code, numbers, says
):
    content = copy.deepcopy(content)
    content["data_faults"] = [{"fault": code, "rows": [], "numbers": numbers, "statement": "Said."}]
    diagnosis = stored(tmp_path, content)
    status, _, err = run(capsys, "predict", diagnosis, motion_file(narrow(5, 12)), "--out", tmp_path / "p.csv")
    assert status == 0
    assert says in flat(err)
    assert bool(says) == bool(err)
    assert ("undo the correction" in corrected_columns(content, written=True)) == ("added_rad" in numbers)


def test_predict_says_that_an_earlier_diagnosis_has_none(capsys, arm, motion_file, tmp_path):
    diagnosis, out = stored(tmp_path, document(arm, [COMPLIANCE], orientation=False)), tmp_path / "predicted.csv"
    code, _, err = run(capsys, "predict", diagnosis, motion_file(narrow(5, 12)), "--out", out)
    assert code == 0
    assert flat(err).strip() == f"{diagnosis}: {NO_BARS}"
    assert out.read_text().splitlines()[0] == "x_m,y_m,z_m"


def test_rows_near_which_too_few_were_recorded_are_outside(found, model):
    """Inside the recorded range too: the standard deviation is three times what is typical of the recorded rows."""
    known, recorded = model.uncertainty, found.problem.recording
    at = {"time": recorded.time, "joint_temperature": recorded.joint_temperature, "payload": recorded.payload}
    there = predicted(model, recorded.joint_position, **at)
    size = np.sqrt(np.mean(there.position_std**2, 1))[~found.outliers]
    assert known.typical[0] == pytest.approx(np.median(size), rel=0.02)
    assert there.outside.mean() < 0.05
    motion = narrow(5, 12)
    before = shown(model, motion)
    size = np.sqrt(np.mean(before.position_std**2, 1))
    typical = float(np.median(size)) / SPARSE
    sparse = replace(model, uncertainty=replace(known, typical=(typical, np.inf)))
    np.testing.assert_array_equal(shown(sparse, motion).outside, before.outside | (size > np.median(size)))
    assert shown(sparse, motion).outside.sum() > before.outside.sum()


# ------------------------------------------------------------------ compensation


def test_a_compensation_has_the_bars_of_its_poses(arm, model):
    motion = narrow(5, 12)
    motion["joint_temperature"][:] = 25.0
    targets, arrays = arm.poses(motion), {name: motion[name] for name in ARRAYS}
    found = compensate(model, targets, start=motion["joint_position"], **arrays)
    assert found.reached.all()
    bars = predicted(model, found.joint_position, **arrays)
    np.testing.assert_allclose(found.position_std, bars.position_std, rtol=1e-9)
    np.testing.assert_allclose(found.orientation_std, bars.orientation_std, rtol=1e-9)
    np.testing.assert_array_equal(found.outside, bars.outside)
    based = compensate(model, targets, start=motion["joint_position"], frame="base", **arrays)
    assert based.position_std.shape == (12, 3)


def test_the_columns_that_compensate_writes(capsys, arm, content, tmp_path):
    motion = narrow(5, 6)
    poses = arm.poses(motion)
    rows = Recording.assembled(
        motion["joint_position"],
        position=poses[:, :3, 3],
        quaternion=quaternions(poses),
        payload=motion["payload"],
    )
    path = write_recording(rows, tmp_path / "targets.csv")
    path.with_suffix(".yaml").unlink()
    out = tmp_path / "joints.csv"
    code, said, err = run(capsys, "compensate", stored(tmp_path, content), path, "--out", out)
    assert (code, err) == (0, "")
    assert "outside what was recorded" in flat(said)
    assert "Standard deviation of the positions reached: 0.0" in flat(said)
    names = pyarrow.csv.read_csv(out).column_names
    bars = [*(f"{axis}_std_m" for axis in "xyz"), *(f"r{axis}_std_rad" for axis in "xyz"), "outside"]
    assert names[-len(bars) - 1 :] == [*bars, "reason"]
    assert read_recording(out).position is None  # a motion, to be predicted, whose deviations are passed over
