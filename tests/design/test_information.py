"""Information is what finite differences of plainly computed readings give, for every sensor and chain."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lite6jax.arms.chains import HayatiForm, SixParameterForm
from lite6jax.arms.description import load_bundled
from lite6jax.design.identify import sensitivity
from lite6jax.design.information import TOLERANCE, Experiment, plan_experiment, recording_experiment
from lite6jax.errors import InputError
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings import Recording, RecordingSettings
from lite6jax.sensors.usual import SENSORS, plan_sensor, sensor_named
from tests.oracles.arms import perturbed, random_positions, table_of_parameters
from tests.oracles.chains import hayati_poses, six_parameter_poses

LITE6 = load_bundled("lite6")
RNG = np.random.default_rng(7)
Q = random_positions(np.random.default_rng(5), 25, 6)
SENSOR_KINDS = [
    plan_sensor("position", 2e-5),
    plan_sensor("pose", 2e-5, 1e-4),
    plan_sensor("axis", 1e-5, direction=(1.0, 2.0, -2.0)),
    plan_sensor("distance", 1e-6, center=(0.3, -0.2, 0.1)),
]


def moved(T, step):
    """A frame moved by a translation and a rotation vector in the axes of `T`'s parent."""
    out = T.copy()
    out[:3, :3] = Rotation.from_rotvec(step[3:]).as_matrix() @ T[:3, :3]
    out[:3, 3] += step[:3]
    return out


def plain_poses(form, model, step, positions):
    """(sample, 4, 4) in the sensor's frame, in plain NumPy."""
    n = form.chain.size
    values = np.asarray(model.geometry) + step[:n]
    if isinstance(form.chain, HayatiForm):
        base, dh, beta = table_of_parameters(form.chain, values)
        poses = hayati_poses(base, dh, dict(zip(form.chain.parallel, beta, strict=True)), positions)
    else:
        poses = six_parameter_poses(values.reshape(-1, 6), positions)
    rest = step[n:]
    T_sensor_base, T_flange_tool = (np.array(T) for T in model[1:])
    if form.frame:
        T_sensor_base, rest = moved(T_sensor_base, rest[:6]), rest[6:]
    if form.tool:
        T_flange_tool[:3, :3] = T_flange_tool[:3, :3] @ Rotation.from_rotvec(rest[3:]).as_matrix()
        T_flange_tool[:3, 3] += rest[:3]
    return T_sensor_base @ poses @ T_flange_tool


def plain_rows(sensor, form, model, positions, h=1e-6):
    """(sample, row, parameter) by central differences: standard deviations per m or rad."""
    middle = plain_poses(form, model, np.zeros(form.size), positions)

    def read(poses):
        p = poses[:, :3, 3]
        if sensor.quantity == "axis":
            return (p @ np.array(sensor.direction))[:, None]
        if sensor.quantity == "distance":
            return np.linalg.norm(p - sensor.at[:, 0], axis=1)[:, None]
        if sensor.quantity == "position":
            return p
        turned = np.swapaxes(middle[:, :3, :3], 1, 2) @ poses[:, :3, :3]  # in the axes of the tool that is read
        return np.concatenate([p, Rotation.from_matrix(turned).as_rotvec()], 1)

    noise = [sensor.position_noise] * min(sensor.rows, 3)
    if sensor.rows == 6:
        noise += [sensor.orientation_noise] * 3
    columns = []
    for step in np.eye(form.size) * h:
        ahead, behind = (plain_poses(form, model, sign * step, positions) for sign in (1, -1))
        columns.append((read(ahead) - read(behind)) / (2 * h) / np.array(noise))
    return np.stack(columns, -1)


def random_model(chain, arm=LITE6):
    values = arm.hayati if isinstance(chain, HayatiForm) else perturbed(RNG, arm.kinematics).ravel()
    frames = [np.eye(4), np.eye(4)]
    for T in frames:
        T[:3, :3] = Rotation.random(random_state=3).as_matrix()
        T[:3, 3] = RNG.uniform(-0.3, 0.3, 3)
    return ArmModel(values + RNG.normal(0, 1e-3, len(np.ravel(values))), *frames)


@pytest.mark.parametrize("sensor", SENSOR_KINDS, ids=lambda s: s.quantity)
@pytest.mark.parametrize("chain", [LITE6.form, SixParameterForm(6)], ids=lambda c: type(c).__name__)
def test_rows_are_finite_differences_of_plain_readings(sensor, chain):
    form = ModelForm(chain, frame=True, tool=True)
    model = random_model(chain)
    setup = Experiment(LITE6, form, model, sensor)
    want = plain_rows(sensor, form, model, Q)
    got = setup.rows(Q) / setup.unit
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-8 * np.abs(want).max())


@pytest.mark.parametrize("sensor", SENSOR_KINDS, ids=lambda s: s.quantity)
def test_the_root_is_that_of_the_rows(sensor):
    setup = plan_experiment("lite6", sensor, tool=True, tool_at=(0.05, 0.0, 0.1))
    q = random_positions(np.random.default_rng(1), 40, 6)
    rows = setup.rows(q).reshape(-1, setup.size)
    R = setup.root(q)
    assert (np.tril(R, -1) == 0).all()
    scale = np.abs(rows.T @ rows).max()
    np.testing.assert_allclose(R.T @ R, rows.T @ rows, rtol=0, atol=1e-12 * scale)


def test_noise_of_the_joints_is_carried_through_the_arm():
    """The covariance of a reading is Σ + σ² J Jᵀ, with J by finite differences of the plain chain."""
    sigma = 4e-5
    sensor = plan_sensor("pose", 2e-5, 1e-4, joint_noise=sigma)
    form, model = ModelForm(LITE6.form, frame=True), random_model(LITE6.form)
    got = Experiment(LITE6, form, model, sensor).rows(Q)
    clean = Experiment(LITE6, form, model, sensor.with_noise(joint=0.0)).rows(Q)
    h = 1e-6
    middle = plain_poses(form, model, np.zeros(form.size), Q)
    for k in range(len(Q)):
        J = np.zeros((6, 6))
        for j in range(6):
            poses = plain_poses(form, model, np.zeros(form.size), Q[k] + h * np.array([[1.0], [-1.0]]) * np.eye(6)[j])
            J[:3, j] = (poses[0] - poses[1])[:3, 3] / (2 * h)
            spun = [Rotation.from_matrix(middle[k, :3, :3].T @ p[:3, :3]).as_rotvec() for p in poses]
            J[3:, j] = (spun[0] - spun[1]) / (2 * h)
        noise = np.repeat([2e-5, 1e-4], 3)[:, None]
        covariance = np.eye(6) + sigma**2 * (J / noise) @ (J / noise).T
        want = clean[k].T @ np.linalg.solve(covariance, clean[k])
        np.testing.assert_allclose(got[k].T @ got[k], want, rtol=0, atol=1e-6 * np.abs(want).max())


def recording(**settings):
    q = random_positions(np.random.default_rng(3), 60, 6)
    poses = six_parameter_poses(LITE6.kinematics, q)
    quaternion = np.roll(Rotation.from_matrix(poses[:, :3, :3]).as_quat(), 1, axis=1)
    oriented = settings.pop("oriented", False)
    return Recording.from_arrays(
        q,
        position=poses[:, :3, 3],
        quaternion=quaternion if oriented else None,
        settings=RecordingSettings(**{"arm": "lite6", "motion": "static"} | settings),
        source="run.csv",
    )


def test_a_recording_is_the_experiment_its_sidecar_says():
    found = recording_experiment(
        recording(pose_frame="unknown", tool="none", position_noise_m=3e-5, joint_noise_rad=1e-5)
    )
    assert found.form == ModelForm(LITE6.form, frame=True)
    assert found.sensor.to_dict() == plan_sensor("position", 3e-5, joint_noise=1e-5).to_dict()
    oriented = recording(
        pose_frame="base", tool="unknown", position_noise_m=3e-5, orientation_noise_rad=2e-4, oriented=True
    )
    found = recording_experiment(oriented)
    assert found.form == ModelForm(LITE6.form, tool=True)
    assert found.sensor.to_dict() == plan_sensor("pose", 3e-5, 2e-4).to_dict()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (
            lambda: plan_sensor("pose", 1e-5),
            "orientation noise None: a sensor of poses needs one standard deviation in",
        ),
        (lambda: plan_sensor("axis", 1e-5, 1e-4), "a sensor of axis measures no orientation; leave it out"),
        (
            lambda: plan_sensor("position", 1e-5, joint_noise=-1.0),
            "joint noise -1.0: give one standard deviation in",
        ),
        (lambda: sensor_named("theodolite"), f"sensor 'theodolite': is none of {', '.join(SENSORS)}"),
        (lambda: plan_experiment("lite6").rows(np.zeros((3, 7))), "joint_position of shape (3, 7): lite6 takes"),
        (lambda: plan_experiment("lite6").rows([[0] * 6, [np.nan] * 6]), "joint_position: row 2 is not finite; leave"),
    ],
)
def test_what_is_refused(make, says):
    with pytest.raises(InputError) as error:
        make()
    assert says in str(error.value)


# ------------------------------------------------------------------ sensitivity


def test_sensitivities_are_finite_differences_of_the_plain_chain():
    found = sensitivity("lite6", Q)
    rows = LITE6.kinematics.ravel()
    h = 1e-6
    for i, unit in enumerate(found.units):
        step = h * np.eye(36)[i]
        ahead, behind = (six_parameter_poses((rows + s * step).reshape(6, 6), Q)[:, :3, 3] for s in (1, -1))
        want = np.linalg.norm(ahead - behind, axis=1) / (2 * h) * TOLERANCE[unit]
        np.testing.assert_allclose(found.position[:, i], want, rtol=0, atol=1e-12 + 1e-8 * want.max())
    np.testing.assert_allclose(found.flange_position, six_parameter_poses(LITE6.kinematics, Q)[:, :3, 3], atol=1e-15)


def test_the_expected_error_is_what_drawn_arms_show():
    found = sensitivity("lite6", Q)
    setup = plan_experiment("lite6", chain="six_parameter", frame=False)
    rng = np.random.default_rng(1)
    size = np.array([TOLERANCE[unit] for unit in setup.units])
    arms = [LITE6.kinematics + (size * rng.standard_normal(36)).reshape(6, 6) for _ in range(2000)]
    moved = np.stack([six_parameter_poses(k, Q[:3])[:, :3, 3] for k in arms]) - found.flange_position[:3]
    shown = np.sqrt(np.mean(np.sum(moved**2, -1), 0))
    np.testing.assert_allclose(found.expected_error[:3], shown, rtol=0.05)
