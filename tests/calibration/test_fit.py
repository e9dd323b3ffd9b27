import dataclasses
import json

import numpy as np
import pytest
from scipy.optimize import least_squares

import lite6jax
from lite6jax.calibration.fit import fit_recording
from lite6jax.estimation.robust import gaussian_t_scale, t_scale
from lite6jax.recordings import FactoryUncertainty, Recording, RecordingSettings
from lite6jax.report.documents import document, text
from tests.oracles.arms import NOMINAL, lite6_positions, perturbed_parameters
from tests.oracles.chains import seed_poses
from tests.oracles.transforms import perturb_poses, quaternions, random_transform

POSITION_NOISE, ORIENTATION_NOISE = 2e-5, 1e-4


def recording(
    rng,
    x,
    samples=120,
    *,
    frame=None,
    tool=None,
    orientation=True,
    noise=(POSITION_NOISE, ORIENTATION_NOISE),
    joint_noise=0.0,
    **settings,
):
    """What a tracker sees of an arm; `frame` and `tool` are 4x4, unknown to the fit where given."""
    q = lite6_positions(rng, samples)
    T = seed_poses(x, q)
    T = (np.eye(4) if frame is None else frame) @ T @ (np.eye(4) if tool is None else tool)
    T = perturb_poses(rng, T, *noise)
    return Recording.from_arrays(
        q + joint_noise * rng.normal(size=q.shape),
        position=T[:, :3, 3],
        quaternion=quaternions(T) if orientation else None,
        settings=RecordingSettings(
            **{
                "pose_frame": "base" if frame is None else "unknown",
                "tool": "none" if tool is None else "unknown",
                "position_noise_m": noise[0],
                "orientation_noise_rad": noise[1],
                "joint_noise_rad": joint_noise,
                "motion": "static",
                **settings,
            }
        ),
        source="simulated.csv",
    )


def cramer_rao(x, q, noise):
    """Standard deviations no unbiased estimator beats, by central differences of the plain NumPy chain."""
    columns = []
    for k in range(28):
        h = np.zeros(28)
        h[k] = 1e-6
        hi, lo = seed_poses(x + h, q), seed_poses(x - h, q)
        shift = (hi - lo)[:, :3, 3] / 2e-6
        relative = np.swapaxes(lo[:, :3, :3], 1, 2) @ hi[:, :3, :3]
        spin = np.stack([relative[:, 2, 1] - relative[:, 1, 2], relative[:, 0, 2] - relative[:, 2, 0],
                         relative[:, 1, 0] - relative[:, 0, 1]], -1) / 4e-6  # fmt: skip
        columns.append(np.concatenate([shift / noise[0], spin / noise[1]], 1).ravel())
    J = np.array(columns)
    return np.sqrt(np.diag(np.linalg.inv(J @ J.T)))


def z_bounds(count):
    """Within these the mean of `count` squared standard normal numbers lies, but for once in 10⁵."""
    return 1 - 4.4 * np.sqrt(2 / count), 1 + 4.4 * np.sqrt(2 / count)


def fitted(seeds, loss="student_t", **options):
    """Recordings of arms, their true parameters and their fits."""
    for seed in seeds:
        rng = np.random.default_rng(seed)
        x = perturbed_parameters(rng)
        data = recording(rng, x, **options)
        yield x, data, lite6jax.fit(data, loss=loss)


def check_standard_deviations(cases):
    """Errors scatter as the fits' own standard deviations say."""
    squares = [((found.parameters - x) / found.standard_deviation) ** 2 for x, _, found in cases]
    low, high = z_bounds(np.size(squares))
    assert low < np.mean(squares) < high


@pytest.mark.parametrize(
    ("loss", "first", "widened", "within"),
    [
        ("least_squares", 0, 1.0, 0.02),  # the noise is estimated from 720 numbers a recording, 12 times: to 0.8 %
        pytest.param("student_t", 100, 1.014, 3 * 0.008, marks=pytest.mark.long),  # an efficiency of 97.2 %
    ],
)
def test_truth_is_recovered_at_the_cramer_rao_bound(loss, first, widened, within):
    cases = list(fitted(range(first, first + 12), loss))
    bounds = [cramer_rao(x, data.joint_position, (POSITION_NOISE, ORIENTATION_NOISE)) for x, data, _ in cases]
    assert all(found.result == lite6jax.Result.CONVERGED and found.free.all() for _, _, found in cases)
    check_standard_deviations(cases)
    squares = [((found.parameters - x) / bound) ** 2 for (x, _, found), bound in zip(cases, bounds, strict=True)]
    low, high = z_bounds(np.size(squares))
    assert low < np.mean(squares) < high * widened**2
    ratios = [found.standard_deviation / bound for (_, _, found), bound in zip(cases, bounds, strict=True)]
    assert abs(np.mean(ratios) - widened) < within
    assert np.ptp(ratios) < 0.2


def test_five_percent_wild_samples_change_nothing_that_matters():
    rng = np.random.default_rng(3)
    x = perturbed_parameters(rng)
    data = recording(rng, x, 200)
    wild = rng.choice(200, 10, replace=False)
    position = data.position.copy()
    position[wild] += rng.normal(size=(10, 3)) * np.array([[1.0], [0.01]] * 5)
    found = lite6jax.fit(dataclasses.replace(data, position=position))
    z = (found.parameters - x) / found.standard_deviation
    low, high = z_bounds(28)
    assert max(0, low) < np.mean(z**2) < high
    assert (found.weight[wild] < 0.05).all()
    assert (np.delete(found.weight, wild) > 0.2).all()
    assert found.noise.position == pytest.approx(POSITION_NOISE, rel=0.25)


@pytest.mark.long
@pytest.mark.parametrize("orientation", [True, False])
def test_a_sensor_frame_and_a_tool_anywhere_are_found(orientation):
    squares = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        x, frame, tool = perturbed_parameters(rng), random_transform(rng, 5.0), random_transform(rng, 0.2)
        data = recording(rng, x, frame=frame, tool=tool, orientation=orientation)
        found = lite6jax.fit(data)
        assert found.result == lite6jax.Result.CONVERGED
        q = lite6_positions(rng, 40)
        truth = frame @ seed_poses(x, q) @ tool
        wrong = np.linalg.norm((found.predict(q) - truth)[:, :3, 3], axis=1)
        squares.append(np.mean(wrong**2))
    # 30 (or, with positions alone, 27) numbers share the information of 120 samples of 6 (3) numbers each
    determined = 30 if orientation else 27
    assert int(found.free.sum()) == determined
    assert np.sqrt(np.mean(squares)) < 2 * POSITION_NOISE * np.sqrt(3) * np.sqrt(determined / (120 * 3))


def test_what_the_frames_carry_is_held_at_nominal_and_said():
    rng = np.random.default_rng(1)
    data = recording(rng, perturbed_parameters(rng), frame=random_transform(rng, 1.0), tool=random_transform(rng, 0.1))
    found = lite6jax.fit(data)
    held = {item.name: item.carried_by for item in found.held}
    assert set(held) == {
        "base_x", "base_y", "base_roll", "base_pitch", "theta_off1", "d1", "theta_off6", "d6", "a6", "alpha6",
    }  # fmt: skip
    assert "tool_rz" in held["theta_off6"]
    assert all(
        any(name.startswith("frame_") for name in held[item]) for item in ("base_x", "base_roll", "theta_off1", "d1")
    )
    names = np.array(found.form.names)
    np.testing.assert_allclose(found.arm.hayati, NOMINAL, rtol=0, atol=1e-15)
    for name in held:
        k = int(np.flatnonzero(names == name)[0])
        assert found.parameters[k] == found.arm.hayati[k]
        assert found.standard_deviation[k] == 0


def test_what_positions_alone_do_not_determine_stays_near_nominal_and_is_marked():
    """The flange point stands on joint 6's axis: its turning is not seen, and a5, alpha5 do what theta5, d5 do."""
    rng = np.random.default_rng(2)
    x = perturbed_parameters(rng)
    data = recording(rng, x, orientation=False, noise=(1e-4, 1e-4))
    found = lite6jax.fit(data)
    assert (found.result, found.held) == (lite6jax.Result.CONVERGED, ())
    unsure = {name for name, sure in zip(found.form.names, found.determined, strict=True) if not sure}
    assert unsure == {"theta_off5", "alpha5", "theta_off6", "alpha6"}
    deviation, share = found.standard_deviation, found.prior_share
    z = (found.parameters - x) / deviation
    assert np.abs(z).max() < 4
    assert np.mean(z[found.determined] ** 2) < z_bounds(24)[1]
    assert share[found.form.names.index("alpha6")] == pytest.approx(1, abs=1e-6)  # nothing depends on it
    assert found.noise.orientation is None
    assert found.checked.orientation is None
    # one row less moves the table by little of what it says of itself
    fewer = lite6jax.fit(data.select(np.arange(120) != 40))
    assert np.abs((fewer.parameters - found.parameters) / deviation).max() < 0.5
    entries = json.loads(text(document(found)))["parameters"]
    said = {item["name"]: (item["determined"], item["prior_share"]) for item in entries}
    assert said["alpha6"] == (False, pytest.approx(1, abs=1e-6))
    assert said["d4"] == (True, pytest.approx(0, abs=1e-4))
    assert "The data do not determine, and their prior about nominal decides: theta_off5, " in found.summary()


def test_a_touched_point_sets_no_scale():
    """The chain must not shrink on the point, where all that is measured stands still: its longest length is held."""
    rng = np.random.default_rng(3)
    x, tool, point = perturbed_parameters(rng), np.eye(4), (0.3, 0.05, 0.15)
    tool[:3, 3] = 0.01, -0.02, 0.15
    q = []
    while len(q) < 40:
        near = lite6_positions(rng, 1)[0]
        reached = least_squares(lambda q: (seed_poses(x, q[None]) @ tool)[0, :3, 3] - point, near, xtol=1e-12)
        if reached.cost < 1e-12 and np.abs(reached.x).max() < 6:
            q.append(reached.x)
    settings = RecordingSettings(arm="lite6", motion="static", tool="unknown", position_noise_m=1e-4)
    q = np.array(q) + 1e-4 * rng.normal(size=(40, 6))
    data = Recording.from_arrays(q, position=np.zeros((40, 3)), settings=settings, source="touched.csv")
    found = fit_recording(data)
    assert (found.result, found.quality.verdict) == (lite6jax.Result.CONVERGED, "good")
    assert {item.name: item.carried_by for item in found.held}["d4"] >= ("a2",)
    away = found.parameters - found.arm.hayati
    assert np.abs(away / [{"m": 0.02, "rad": 0.05}[unit] for unit in found.form.chain.units]).max() < 1
    # all others are those of the chain at the scale of that length
    chain, sure = found.form.chain, found.determined[:28]
    k = chain.names.index("d4")
    scaled = np.where(np.array(chain.units) == "m", found.arm.hayati[k] / x[k], 1.0) * x
    z = ((found.parameters - scaled) / np.maximum(found.standard_deviation[:28], 1e-12))[sure]
    assert np.mean(z**2) < z_bounds(sure.sum())[1]


@pytest.mark.long
def test_read_out_noise_of_the_joints_is_weighed_in():
    cases = list(fitted(range(4), noise=(1e-5, 2e-5), joint_noise=1e-4))
    check_standard_deviations(cases)
    ratio = []
    for x, data, found in cases:
        settings = dataclasses.replace(data.settings, joint_noise_rad=0.0)
        blind = lite6jax.fit(dataclasses.replace(data, settings=settings))
        ratio.append(np.abs(found.parameters - x) / np.abs(blind.parameters - x))
    assert np.median(ratio) < 0.95  # and knowing its shape is worth something


def test_the_prior_of_a_factory_file_is_respected(tmp_path):
    rng = np.random.default_rng(5)
    x = perturbed_parameters(rng)
    x[25:27] = 0  # a six-parameter file ends at joint 6
    kinematics, _ = lite6jax.hayati_to_six_parameter(lite6jax.HayatiForm(6, (1,)), x)
    file = tmp_path / "factory.yaml"
    lite6jax.write_factory(kinematics + 1e-5 * rng.normal(size=kinematics.shape), file)
    data = recording(
        rng,
        x,
        40,
        factory_calibration=str(file),
        factory_uncertainty=FactoryUncertainty(position_m=1e-5, rotation_rad=1e-5),
    )
    exact, prior, free = (lite6jax.fit(data, geometry=g) for g in ("exact", "declared", "free"))
    q = lite6_positions(rng, 300)
    rms = [np.sqrt(np.mean(np.sum((s.predict(q) - seed_poses(x, q))[:, :3, 3] ** 2, 1))) for s in (exact, prior, free)]
    assert not exact.free.any()
    assert prior.free.all()
    assert len(prior.parameters) == 36
    assert (prior.standard_deviation < 1.05e-5).all()
    assert rms[1] < rms[0]
    assert rms[1] < rms[2]


@pytest.mark.parametrize(("loss", "unknown"), [("least_squares", True), ("student_t", False)])  # each compiles for long
def test_the_fast_solver_agrees_with_levenberg_marquardt(loss, unknown):
    rng = np.random.default_rng(7)
    frames = {"frame": random_transform(rng, 2.0), "tool": random_transform(rng, 0.1)} if unknown else {}
    data = recording(rng, perturbed_parameters(rng), joint_noise=5e-5 if unknown else 0.0, **frames)
    fast = lite6jax.fit(data, loss=loss)
    record = lite6jax.fit(data, loss=loss, solver="levenberg_marquardt")
    assert record.result == lite6jax.Result.CONVERGED
    q = lite6_positions(rng, 50)
    if loss == "least_squares":
        assert np.abs(fast.predict(q) - record.predict(q)).max() < 1e-12
        assert np.abs(fast.parameters - record.parameters).max() < 1e-12
        np.testing.assert_allclose(fast.checked.position, record.checked.position, rtol=0, atol=1e-12)
    else:
        assert np.abs(fast.parameters - record.parameters).max() < 1e-5 * fast.standard_deviation.max()
        np.testing.assert_allclose(fast.checked.position, record.checked.position, rtol=0, atol=1e-5 * POSITION_NOISE)


def test_held_out_blocks_are_predicted_by_the_others():
    """The checked errors are those of five fits that never saw the block: refitted here by hand."""
    rng = np.random.default_rng(8)
    data = recording(rng, perturbed_parameters(rng))
    found = lite6jax.fit(data, loss="least_squares")
    fold = data.contiguous_folds(5)[2]
    others = lite6jax.fit(data.select(~fold), loss="least_squares")
    expected = np.linalg.norm(others.predict(data.joint_position[fold])[:, :3, 3] - data.position[fold], axis=1)
    np.testing.assert_allclose(found.checked.position[fold], expected, rtol=1e-6)
    assert found.checked.position_rms > found.errors.position_rms


def test_a_calibration_is_reproduced_to_rounding():
    rng = np.random.default_rng(9)
    for _ in range(5):
        x = perturbed_parameters(rng)
        x[25:27] = 0
        kinematics, _ = lite6jax.hayati_to_six_parameter(lite6jax.HayatiForm(6, (1,)), x)
        found = lite6jax.fit(kinematics, "lite6")
        assert found.result == lite6jax.Result.CONVERGED
        assert len(found.checked.position) == 1000
        assert found.checked.position.max() < 1e-13  # 1e-10 mm
        assert np.rad2deg(found.checked.orientation.max()) < 1e-10
        np.testing.assert_allclose(found.parameters, x, atol=1e-13)
        assert 1e-3 < found.nominal_errors.position.max() < 3e-2


@pytest.mark.parametrize("seeds", [[10], pytest.param(range(4), marks=pytest.mark.long)])
def test_noise_that_is_not_declared_is_taken_from_the_residuals_in_both_parts(seeds):
    undeclared = {"position_noise_m": None, "orientation_noise_rad": None}
    cases = list(fitted(seeds, noise=(2e-4, 1e-4), **undeclared))
    check_standard_deviations(cases)
    for _, _, found in cases:
        assert found.noise.declared is None
        assert found.noise.position == pytest.approx(2e-4, rel=0.2)
        assert found.noise.orientation == pytest.approx(1e-4, rel=0.2)
        assert any("does not declare the noise" in note for note in found.notes)


@pytest.mark.parametrize("part", [0, 1])
def test_noise_that_is_declared_in_part_counts_where_it_is(part):
    """The residuals are fifty times the declared noise: not noise; that of the other part is taken from them."""
    rng = np.random.default_rng(14)
    key = ("position_noise_m", "orientation_noise_rad")[part]
    declared = {"position_noise_m": None, "orientation_noise_rad": None, key: (2e-5, 1e-4)[part]}
    found = lite6jax.fit(recording(rng, perturbed_parameters(rng), noise=(1e-3, 5e-3), **declared))
    assert found.noise.declared == (declared["position_noise_m"], declared["orientation_noise_rad"])
    assert found.noise.position == pytest.approx(1e-3, rel=0.1)
    assert found.noise.orientation == pytest.approx(5e-3, rel=0.1)
    assert found.quality.verdict == "above_noise"
    assert any(f"the noise of {('orientations', 'positions')[part]}" in note for note in found.notes)


@pytest.mark.long
def test_a_held_out_block_that_alone_moves_a_joint_is_said():
    rng = np.random.default_rng(13)
    x = perturbed_parameters(rng)
    data = recording(rng, x)
    q = np.repeat(data.joint_position[:1], 120, 0)
    for k in range(5):
        q[24 * k : 24 * k + 24, k : k + 2] = data.joint_position[:24, k : k + 2]
    T = seed_poses(x, q)
    found = lite6jax.fit(dataclasses.replace(data, joint_position=q, position=T[:, :3, 3], quaternion=quaternions(T)))
    assert any("held-out fits did not converge" in note for note in found.notes)


def test_messages():
    rng = np.random.default_rng(11)
    x = perturbed_parameters(rng)
    lite6, xarm7 = (lite6jax.read_arm(name).kinematics for name in ("lite6", "xarm7"))
    few, many = recording(rng, x, 5), recording(rng, x, 50)
    for source, options, message in [
        (few, {}, r"simulated.csv: 5 samples give 30 numbers, too few .* record at least 6"),
        (many, {"geometry": "exact"}, r"needs a factory_calibration in the sidecar; use `geometry='free'`"),
        (many, {"nominal": "xarm7"}, r"has 6 joints, but xarm7 has 7"),
        (dataclasses.replace(many, position=many.position + 1j), {}, "row 1 has .* give finite real numbers"),
        (np.zeros((6, 5)), {}, r"give \(joint, 6\) finite numbers"),
        (lite6, {"nominal": "lite6", "samples": 3}, "samples 3: too few for 28 parameters; give at least 5"),
        (xarm7, {"nominal": "xarm7", "samples": 5}, "samples 5: too few for 32 parameters; give at least 6"),
        (lite6, {"nominal": "lite6", "seed": -1}, "seed -1: give zero or more"),
        (xarm7, {"nominal": "lite6"}, "has 7 joints, but lite6 has 6"),
        (np.zeros((3, 6)), {}, "has 3 joints, as no bundled arm has"),
    ]:
        with pytest.raises(lite6jax.InputError, match=message):
            lite6jax.fit(source, **options)


def test_scale_of_student_t_on_gaussian_noise():
    rng = np.random.default_rng(12)
    for rows in (3, 6):
        squares = rng.chisquare(rows, 200_000)
        assert 2.5 * gaussian_t_scale(rows, 15.0) == pytest.approx(t_scale(6.25 * squares, rows, 15.0), rel=5e-3)
        assert t_scale(6.25 * squares, rows, None) == pytest.approx(2.5, rel=5e-3)


@pytest.mark.parametrize("shape", ["plain", "outliers", "half zero", "heavy", "one", "all zero"])
def test_scale_of_student_t_solves_its_equation(shape):
    squares = np.random.default_rng(13).chisquare(3, 1 if shape == "one" else 400) * 1e-12
    squares[: {"outliers": 40, "half zero": 201, "all zero": 400}.get(shape, 0)] *= 1e8 if shape == "outliers" else 0.0
    squares = squares**6 if shape == "heavy" else squares
    scale2 = t_scale(squares, 3, 15.0) ** 2
    if shape == "all zero":
        assert 0 < scale2 < 1e-100
    else:
        weight = (15.0 + 3) / (15.0 + squares / scale2)
        assert np.mean(weight * squares) / 3 == pytest.approx(scale2, rel=1e-8)
