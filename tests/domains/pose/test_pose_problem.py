"""Residuals and their derivatives against plain computations, sample by sample and by finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from diagnosis.recorded import NOISE, Made, moving_motion, plain_effect, static_motion, with_effects
from scipy.spatial.transform import Rotation

from lite6jax.domains.pose.deflections import components, quantities
from lite6jax.domains.pose.problem import pose_problem
from lite6jax.effects.kinematic import (
    JointBacklash,
    JointCompliance,
    JointHarmonic,
    JointWarmUp,
    JointWindup,
    LinkCompliance,
)
from lite6jax.effects.motion import motion_of
from lite6jax.effects.nonparametric import COMPONENTS, SCALE
from lite6jax.effects.serialization import parse_effect
from lite6jax.effects.statics import with_mass_errors
from lite6jax.estimation.terms import Terms, join
from tests.oracles.chains import six_parameter_poses
from tests.oracles.effects import predicted_poses

SAMPLES = 12
NOTHING = Terms()
STATIC = [
    "joint_offset:joint=3,offset_rad=2e-4",
    "joint_scale:joint=2,scale=3e-4",
    "joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",
    "joint_harmonic:joint=4,order=63.3,amplitude_rad=5e-4,phase_rad=3",
    "joint_backlash:joint=4,gap_rad=1.2e-3",
    "joint_coupling:joint=5,source_joint=4,coupling=4e-4",
    "link_compliance:link=3,compliance_x_rad_per_Nm=1e-4,compliance_y_rad_per_Nm=6e-5",
    "link_thermal_expansion:expansion_per_K=2.3e-5",
    "link_thermal_expansion:link=3,expansion_per_K=6e-5",
    "frame_offset:x_m=1e-4,y_m=-2e-4,z_m=1e-4,rx_rad=2e-4,ry_rad=1e-4,rz_rad=-3e-4",
    "frame_offset:link=2,x_m=1e-4,y_m=-2e-4,z_m=1e-4,rx_rad=2e-4,ry_rad=-3e-4,rz_rad=2e-4",
    "base_compliance:compliance_x_rad_per_Nm=3e-5,compliance_y_rad_per_Nm=2e-5",
    "base_drift:vx_m_per_s=1e-6,vy_m_per_s=-2e-6,vz_m_per_s=1e-6",
    "tool_offset:turned=true,x_m=2e-4,y_m=1e-4,z_m=4e-4,rx_rad=3e-4,ry_rad=-2e-4,rz_rad=2e-4",
    "measurement_scale:scale=4e-4",
    "joint_thermal_offset:joint=2,offset_rad_per_K=2e-5",
    "axis_wobble:joint=3,x_cosine1_rad=2e-4,x_sine1_rad=1e-4,x_cosine2_rad=-1e-4,x_sine2_rad=3e-4,"
    "y_cosine1_rad=1e-4,y_sine1_rad=-2e-4,y_cosine2_rad=2e-4,y_sine2_rad=1e-4",
    "tool_compliance:compliance_x_rad_per_Nm=4e-4,compliance_y_rad_per_Nm=3e-4",
    "base_compliance:cross=true,shift=true,compliance_x_rad_per_Nm=3e-5,compliance_y_rad_per_Nm=2e-5,"
    "compliance_xy_rad_per_Nm=-1e-5,shift_xx_m_per_Nm=1e-6,shift_xy_m_per_Nm=2e-6,shift_yx_m_per_Nm=-3e-6,"
    "shift_yy_m_per_Nm=4e-6",
    "sensor_drift:vx_m_per_s=1e-6,vy_m_per_s=-2e-6,vz_m_per_s=1e-6,wx_rad_per_s=2e-6,wy_rad_per_s=1e-6,"
    "wz_rad_per_s=-1e-6",
    "joint_backlash:joint=2,gap_rad=1e-3,friction_torque_Nm=2.5",
    "joint_backlash:joint=3,gap_rad=1e-3,friction_torque_Nm=0",
    "joint_windup:joint=2,compliance_rad_per_Nm=9e-5,friction_torque_Nm=1.5",
    "joint_warm_up:joint=2,amplitude_rad=3e-4,time_constant_s=40",
]
DRIFTS = (*(f"v{axis}_m_per_s" for axis in "xyz"), *(f"w{axis}_rad_per_s" for axis in "xyz"))
MOVING = ["joint_lag:joint=2,lag_s=2e-3", "time_offset:offset_s=0.002"]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return Made(tmp_path_factory.mktemp("arm"), seed=1)


@pytest.fixture(scope="module")
def motions():
    return {"static": static_motion(3, SAMPLES), "moving": moving_motion(3, SAMPLES)}


@pytest.fixture(scope="module")
def known(arm, motions):
    """Nothing is to be fitted."""
    return {name: pose_problem(arm.recording(motion)) for name, motion in motions.items()}


@pytest.fixture(scope="module")
def unknown(arm, motions):
    """Geometry, sensor and tool are to be fitted."""
    made = Made(arm.folder, seed=1, geometry="free", frame=True, tool=True, inertial=0.1)
    return pose_problem(made.recording(static_motion(3, 40)))


def plain_residual(poses, recording, orientation=True):
    """(row, sample), whitened."""
    rows = [(poses[:, :3, 3] - recording.position).T / NOISE[0]]
    if orientation:
        measured = Rotation.from_quat(np.roll(recording.quaternion, -1, axis=1))
        turned = (measured.inv() * Rotation.from_matrix(poses[:, :3, :3])).as_rotvec()
        rows.append(turned.T / NOISE[1])
    return np.concatenate(rows)


def differentiated(function, at, step):
    """(number, row, sample) by central differences."""
    at = np.asarray(at, float)
    slopes = []
    for k in range(len(at)):
        h = np.zeros(len(at))
        h[k] = step
        slopes.append((function(at + h) - function(at - h)) / (2 * step))
    return np.array(slopes)


def at_start(case):
    """No displacement of a frame, and no error of a mass."""
    return np.zeros(len(case.unknown))


def close(found, wanted, relative):
    np.testing.assert_allclose(found, wanted, rtol=0, atol=relative * np.abs(wanted).max())


@pytest.mark.parametrize("text", [*STATIC, *MOVING])
def test_residuals_are_those_of_a_plain_arm_with_the_effect(arm, motions, known, text):
    kind = "moving" if text in MOVING else "static"
    case = known[kind]
    effect, values = parse_effect(text)
    poses = with_effects(arm, text).poses(motions[kind])
    found = case.residual(at_start(case), Terms((effect,)), values)
    close(found, plain_residual(poses, case.recording), 1e-9)
    errors = case.position_errors(at_start(case), Terms((effect,)), values)
    np.testing.assert_allclose(errors, (poses[:, :3, 3] - case.recording.position).T, rtol=0, atol=1e-12)


def test_residuals_of_several_effects_and_of_positions_alone(arm, motions):
    texts = [STATIC[2], STATIC[4], STATIC[7], STATIC[13]]
    made = Made(arm.folder, tuple(texts), seed=1, orientation=False)
    recording = made.recording(motions["static"])
    case = pose_problem(recording)
    parsed = [parse_effect(text) for text in texts]
    terms = Terms(tuple(effect for effect, _ in parsed))
    found = case.residual(at_start(case), terms, join(values for _, values in parsed))
    assert found.shape == (3, SAMPLES)
    close(found, plain_residual(made.poses(motions["static"]), recording, orientation=False), 1e-9)


@pytest.mark.parametrize("text", [*STATIC, *MOVING])
def test_columns_are_derivatives_of_residuals(known, text):
    case = known["moving" if text in MOVING else "static"]
    effect, values = parse_effect(text)
    terms = Terms((effect,))
    at_zero = differentiated(lambda v: case.residual(at_start(case), terms, v), np.zeros(effect.size), 1e-6)
    close(case.columns([effect]), at_zero, 1e-6)
    there = differentiated(lambda v: case.residual(at_start(case), terms, v), values, 1e-6)
    assert np.abs(case.columns([effect], values) - there).max() < 5e-3 * np.abs(there).max()


def test_columns_of_a_free_order(known):
    """The order itself is fitted about where it is, not about no amplitude."""
    case, effect, values = known["static"], JointHarmonic(4), np.array([3e-4, -2e-4, 7.5])
    there = differentiated(lambda v: case.residual(at_start(case), Terms((effect,)), v), values, 1e-6)
    assert np.abs(case.columns([effect], values) - there).max() < 5e-3 * np.abs(there).max()
    assert np.abs(there[2]).max() > 0


@pytest.mark.parametrize(
    ("effect", "values"),
    [(JointWindup(2), [9e-5, 1.5]), (JointWarmUp(3), [3e-4, 40.0]), (JointWarmUp(3, 40.0).released(), [3e-4, 40.0])],
)
def test_columns_of_a_free_shape(known, effect, values):
    """Friction and time constants, once they are chosen, are fitted like an order."""
    case = known["static"]
    there = differentiated(lambda v: case.residual(at_start(case), Terms((effect,)), v), values, 1e-7)
    found = case.columns([effect], np.array(values))
    for column, wanted in zip(found, there, strict=True):
        assert np.abs(wanted).max() > 0
        close(column, wanted, 5e-3)
    held = effect.held(values[1])
    fixed = case.residual(at_start(case), Terms((held,)), np.array(values[:1]))
    np.testing.assert_allclose(case.residual(at_start(case), Terms((effect,)), np.array(values)), fixed, atol=1e-9)
    assert held.chosen == values[1]
    assert effect.chosen is None


def test_a_free_step_is_the_step_itself_and_has_the_slope_of_a_ramp(known):
    """A step has no derivative by what places it; the residuals are those of the step all the same."""
    case, held = known["static"], JointBacklash(2, 2.5)
    free, values = held.released(), np.array([1e-3, 2.5])
    step = case.residual(at_start(case), Terms((held,)), values[:1])
    np.testing.assert_allclose(case.residual(at_start(case), Terms((free,)), values), step, atol=1e-9)
    torque = np.asarray(case.loads.torque[1])
    pressed = torque - 2.5 * np.asarray(case.motion.direction[1])
    near = np.abs(pressed) < 0.05 * np.abs(torque).max()
    slope = case.columns([free], values)[1]
    ramp = -0.5e-3 * np.asarray(case.motion.direction[1]) * near / (0.05 * np.abs(torque).max())
    np.testing.assert_allclose(slope, case.sites["joint", 1, 0] * ramp, rtol=0, atol=1e-2 * np.abs(slope).max() + 1e-12)
    assert held.held(3.0) == JointBacklash(2, 3.0)
    assert held.held(-0.1) == JointBacklash(2, 0.0)  # a refined friction may cross zero
    assert JointBacklash(2).chosen is None
    assert not any(effect.periodic for effect in (held, free, JointWindup(2, 1.0), JointWarmUp(1, 9.0)))


@pytest.mark.parametrize("text", ["payload_error", "payload_com", "gravity_direction"])
@pytest.mark.parametrize("at", [0.0, 0.3])
def test_columns_of_other_loads_are_those_of_the_compliances_beside_them(known, text, at):
    case, (effect, _) = known["static"], parse_effect(text, neutral=True)
    soft, heavy = parse_effect(STATIC[2]), parse_effect("payload_error:mass_kg=0.4")
    beside = [soft, parse_effect(STATIC[18])] + ([heavy] if effect != heavy[0] else [])
    values = at * np.array([number.typical for number in effect.coordinates])
    others = Terms(tuple(one for one, _ in beside)), join(numbers for _, numbers in beside)
    together = Terms((effect, *others[0].terms))
    there = differentiated(lambda v: case.residual(at_start(case), together, join([v, others[1]])), values, 1e-4)
    assert np.abs(there).max(axis=(1, 2)).min() > 0
    close(case.columns([effect], values, beside=others), there, 5e-3)
    alone = case.columns([effect], values, beside=(Terms(), np.zeros(0)))
    np.testing.assert_array_equal(alone, np.zeros((effect.size, 6, SAMPLES)))


def test_sites_are_derivatives_of_a_plain_arm(arm, motions, known):
    case, motion = known["static"], motions["static"]
    h = 1e-6

    def slope(text):
        one, other = (plain_residual(with_effects(arm, text.format(v)).poses(motion), case.recording) for v in (h, -h))
        return (one - other) / (2 * h)

    rise = motion["joint_temperature"].mean(1) - 25.0
    components = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
    rest = {c: ",".join(f"{other}=0" for other in components if other != c) for c in components}
    wanted = {("scale", 0, 0): slope("measurement_scale:scale={}")}
    for j in (0, 2, 5):
        wanted["joint", j, 0] = slope(f"joint_offset:joint={j + 1},offset_rad={{}}")
        for k, c in enumerate(components):
            wanted["link", j, k] = slope(f"frame_offset:link={j + 1},{c}={{}},{rest[c]}")
    for k, c in enumerate(components):
        wanted["base", 0, k] = slope(f"frame_offset:{c}={{}},{rest[c]}")
        wanted["tool", 0, k] = slope(f"tool_offset:turned=true,{c}={{}}")
    for j in (1, 4):
        wanted["stretch", j, 0] = slope(f"link_thermal_expansion:link={j},expansion_per_K={{}}") / rise
    for site, column in wanted.items():
        close(case.sites[site], column, 1e-6)
    for k, velocity in enumerate(DRIFTS):
        rest_of = ",".join(f"{a}=0" for a in DRIFTS if a != velocity)
        moved = slope(f"sensor_drift:{velocity}={{}},{rest_of}")
        close(case.sites["sensor", 0, k] * motion["time"], moved, 1e-5)
    assert len(case.sites) == 6 * (1 + 1 + 1 + 6) + 6 + 6 + 1


def test_the_nuisance_is_the_derivative_of_the_residuals(unknown):
    case, none = unknown, np.zeros(0)
    wanted = differentiated(lambda m: case.residual(m, NOTHING, none), at_start(case), 1e-6)
    frames = len(case.frames)
    found = case.nuisance_columns(NOTHING, none)
    close(found[:frames], wanted[:frames], 1e-6)
    assert not wanted[frames:].any()  # masses matter beside compliances alone
    assert not found[frames:].any()
    assert (frames, len(case.unknown) - frames) == (6 + 5 * 6 + 6, 6 * 4)


def uncertain(arm, motion, *effects):
    """A problem whose masses and payload are uncertain, of an arm with some physics."""
    made = replace(arm, effects=effects, inertial=0.07, payload=0.2)
    return pose_problem(made.recording(motion, noise=None))


def test_errors_of_masses_move_poses_through_compliances(arm, motions):
    case = uncertain(arm, motions["static"])
    terms = Terms((JointCompliance(2), LinkCompliance(3), JointWindup(3, friction_torque_Nm=0.4)))
    values = 1e-3 * np.array([9e-5, 4e-5, -2e-5, 2e-5])  # columns are those of the rigid arm
    assert [site[0] for site in case.unknown] == ["mass"] * 24 + ["payload"]
    np.testing.assert_allclose(case.precision, [*[0.07**-2] * 24, 0.2**-2])
    wanted = differentiated(lambda m: case.residual(m, terms, values), at_start(case), 1e-2)
    close(case.nuisance_columns(terms, values), wanted, 1e-5)
    assert (np.abs(wanted).max((1, 2)) > 0).sum() >= 15


def test_masses_that_are_off_are_those_of_a_plain_arm(arm, motions):
    texts = [f"joint_compliance:joint={j},compliance_rad_per_Nm=9e-5" for j in (2, 3)]
    effects = [parse_effect(text) for text in texts]
    terms, values = Terms(tuple(effect for effect, _ in effects)), join([value for _, value in effects])
    case, rng = uncertain(arm, motions["static"]), np.random.default_rng(5)
    errors, payload = 0.1 * rng.standard_normal((6, 4)), 0.3
    inertia = arm.inertia()
    mass, center = inertia["mass"], inertia["center_of_mass"]
    distances = np.sqrt((center**2).sum(1))
    lever = np.maximum(distances, sum(distances) / 6)[:, None]
    moment = (mass * (1 + errors[:, 0]))[:, None] * center + mass[:, None] * lever * errors[:, 1:]
    heavier = {**inertia, "mass": mass * (1 + errors[:, 0])}
    heavier["center_of_mass"] = moment / heavier["mass"][:, None]
    motion = {**motions["static"], "payload": motions["static"]["payload"] + payload}
    plain = [plain_effect(text) for text in texts]
    poses = predicted_poses(arm.kinematics, arm.T_sensor_base, arm.T_flange_tool, motion, heavier, plain)
    nuisance = np.append(errors.ravel(), payload)
    close(case.residual(nuisance, terms, values), plain_residual(poses, case.recording), 1e-9)
    # the same where the problem was linearised with these errors
    there = case.relinearised(nuisance)
    close(there.residual(at_start(case), terms, values), plain_residual(poses, case.recording), 1e-9)
    known = with_mass_errors(case.inertia, errors, payload)  # the payload's error within the last link
    lumped = heavier["mass"] + [0, 0, 0, 0, 0, payload]
    np.testing.assert_allclose(known.mass, lumped, rtol=1e-12)
    first = heavier["mass"][-1] * heavier["center_of_mass"][-1] + payload * inertia["payload_center"]
    np.testing.assert_allclose(known.center_of_mass[-1], first / lumped[-1], rtol=1e-12)
    np.testing.assert_allclose(known.center_of_mass[:-1], heavier["center_of_mass"][:-1], rtol=1e-12)


def test_what_is_left_of_a_frame_jump_is_fitted(arm, motions):
    recording = arm.recording(motions["static"])
    row = int(recording.row[5])
    case = pose_problem(recording, jumps=((row, "base"), (row, "tool")))
    none = np.zeros(0)
    assert [site[0] for site in case.unknown] == ["moved base"] * 6 + ["moved tool"] * 6
    wanted = differentiated(lambda m: case.residual(m, NOTHING, none), at_start(case), 1e-6)
    close(case.nuisance_columns(NOTHING, none), wanted, 1e-6)
    assert not wanted[..., :5].any()
    assert (np.abs(wanted[..., 5:]).max((1, 2)) > 0).all()
    moved = 1e-4 * np.random.default_rng(2).standard_normal(12)
    there = case.relinearised(moved)
    np.testing.assert_allclose(
        there.residual(at_start(case), NOTHING, none), case.residual(moved, NOTHING, none), rtol=0, atol=1e-9
    )
    later = case.select(np.arange(3, SAMPLES))
    np.testing.assert_allclose(
        later.residual(moved, NOTHING, none), case.residual(moved, NOTHING, none)[:, 3:], rtol=0, atol=1e-9
    )


def test_what_is_unknown_follows_from_what_is_declared(arm, motions):
    def unknown(**options):
        case = pose_problem(Made(arm.folder, seed=1, **options).recording(motions["static"]))
        return len(case.frames), int(np.count_nonzero(case.precision[: len(case.frames)]))

    assert unknown() == (0, 0)
    assert unknown(frame=True) == (6, 0)
    assert unknown(frame=True, tool=True) == (12, 0)
    assert unknown(tool=True, orientation=False) == (3, 0)
    assert unknown(geometry="prior") == (36, 36)
    assert unknown(geometry="prior", frame=True, tool=True) == (42, 30)


def test_moving_the_start_changes_no_prediction(unknown):
    case = unknown
    moved = 1e-3 * np.random.default_rng(0).standard_normal(len(case.unknown))
    there = case.relinearised(moved)
    none = np.zeros(0)
    before = case.residual(moved, NOTHING, none)
    np.testing.assert_allclose(there.residual(np.zeros(len(moved)), NOTHING, none), before, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(there.offset, moved)
    more = 1e-5 * np.random.default_rng(1).standard_normal(len(case.unknown))
    gap = there.residual(more, NOTHING, none) - case.residual(moved + more, NOTHING, none)
    change = there.residual(more, NOTHING, none) - there.residual(0 * more, NOTHING, none)
    assert np.abs(gap).max() < 1e-2 * np.abs(change).max()


def test_the_moved_arm_is_a_plain_chain(unknown):
    case = unknown
    moved = 1e-3 * np.random.default_rng(0).standard_normal(len(case.unknown))
    arm = case.displaced(moved)
    chain = six_parameter_poses(np.asarray(arm.geometry).reshape(-1, 6), case.recording.joint_position)
    poses = np.asarray(arm.T_sensor_base) @ chain @ np.asarray(arm.T_flange_tool)
    errors = case.position_errors(moved, NOTHING, np.zeros(0))
    np.testing.assert_allclose(errors, (poses[:, :3, 3] - case.recording.position).T, rtol=0, atol=1e-12)


def test_harmonics_are_columns_of_joint_harmonics(known):
    case, orders = known["static"], np.array([1.0, 2.0, 7.5, 101.0])
    found = case.periodic[3].columns(orders)
    assert found.shape == (4, 2, 6, SAMPLES)
    for order, pair in zip(orders, found, strict=True):
        np.testing.assert_allclose(pair, case.columns([JointHarmonic(4, float(order))]), rtol=1e-12)


def test_the_noise_of_joint_readings_whitens_with_the_arm(arm, motions):
    """The covariance of a sample is the sensor's and what the joints' noise makes at the tool."""
    recording = arm.recording(motions["static"])
    noisy = replace(recording, settings=replace(recording.settings, joint_noise_rad=3e-5))
    case = pose_problem(noisy)
    whitener = np.moveaxis(np.asarray(case.measured.whitener), -1, 0)
    plain = pose_problem(recording)
    J = np.stack([plain.sites["joint", j, 0] for j in range(6)])  # (joint, row, sample), whitened
    sigma = np.repeat(NOISE, 3)
    J = J * sigma[:, None]
    for k in range(SAMPLES):
        covariance = np.diag(sigma**2) + 3e-5**2 * J[:, :, k].T @ J[:, :, k]
        np.testing.assert_allclose(whitener[k] @ covariance @ whitener[k].T, np.eye(6), atol=1e-6)


def test_every_site_that_is_seen_has_its_components(known):
    found = {(one.site, one.name) for one in known["moving"].components}
    joints = {(f"joint{j}", "rz") for j in range(1, 7)}
    assert joints | {("link3", "ry"), ("base", "x"), ("tool", "rz"), ("sensor", "scale")} <= found
    assert ("link3", "rz") not in found  # that is an angle of joint 3


def quantities_of(recording):
    return {one.driver.phrase: one for one in pose_problem(recording).quantities}


def test_temperatures_are_quantities_once(arm, motions):
    """Each joint's own where there are several, else that of the arm."""
    several = arm.recording(motions["moving"])
    same = replace(several, joint_temperature=None, ambient_temperature=several.joint_temperature[:, 0])
    own, ambient = quantities_of(several), quantities_of(same)
    assert {"temperature of joint 3", "temperature rise"} <= set(own)
    assert {"joint4", "link4", "link3"} <= own["temperature of joint 4"].own
    assert "temperature rise" in ambient
    assert not any("temperature of joint" in phrase for phrase in ambient)


def test_a_process_reaches_the_residuals_by_the_column_of_its_component(known):
    case = known["moving"]
    component = next(one for one in case.components if (one.site, one.name) == ("link2", "rx"))
    quantity = next(one for one in case.quantities if one.driver.phrase == "position of joint 2")
    term = case.process(component, [quantity], "line", 1e-4)
    u = 2 * (quantity.values - quantity.values.min()) / np.ptp(quantity.values) - 1
    wanted = np.stack([np.ones_like(u), u])[:, None] * component.column
    np.testing.assert_allclose(case.columns([term]), wanted, atol=1e-9 * np.abs(wanted).max())


# ------------------------------------------------------------------ where processes can act, and on what


def moved(dof, sliding=(), **more):
    rng = np.random.default_rng(dof)
    return motion_of(joint_position=rng.uniform(-1.0, 1.0, (40, dof)), payload=np.zeros(40), sliding=sliding, **more)


def everywhere(dof):
    """The columns of every site, all of which the sensor sees."""
    kinds = [("base", 0), ("tool", 0), ("sensor", 0), *(("link", j) for j in range(dof))]
    sites = [(kind, j, k) for kind, j in kinds for k in range(len(COMPONENTS))]
    return {site: np.ones((3, 40)) for site in [*sites, *(("joint", j, 0) for j in range(dof)), (SCALE, 0, 0)]}


def phrases(*given, **more):
    return {one.driver.phrase for one in quantities(moved(*given, **more), None)}


def test_a_slide_is_a_quantity_in_its_own_unit_and_has_no_angle():
    """A rail that is not straight tilts the base as the arm moves along it."""
    assert {"slide position of joint 1", "position of joint 2"} <= phrases(3, (0,))
    assert "position of joint 1" not in phrases(3, (0,))
    found = components(everywhere(3), moved(3, (0,)), 3)
    assert "joint1" not in {one.site for one in found}
    assert "link1" in {one.site for one in found}


def test_every_quantity_that_is_known_is_there_once():
    rng = np.random.default_rng(4)
    velocity, rise = rng.uniform(-1.0, 1.0, (2, 3, 40))
    moving = moved(3, time=8.0 * np.arange(40))._replace(
        joint_velocity=velocity, direction=np.sign(velocity), joint_temperature_rise=9 * rise
    )
    found = [one.driver.phrase for one in quantities(moving, None)]
    assert len(found) == len(set(found)) == 2 + 4 * 3  # time and order; of each joint four
    own = {one.driver.phrase: one.own for one in quantities(moving, None)}
    assert {"joint2", "link2"} <= own["velocity of joint 2"]
    assert own["time"] == {""}
