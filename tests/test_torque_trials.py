"""The generator of the torque trials: apart from the library, right by other physics, with a threshold that holds."""

import json

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.interpolate import make_interp_spline
from scipy.stats import chi2

from benchmarks.campaigns import detection
from benchmarks.campaigns.campaign import write_files
from benchmarks.campaigns.rounds import KINDS
from benchmarks.concealed.chain import Chain, rotation_from_vector
from benchmarks.torque_trials import faults, hiding, mujoco_arm, plans, trials
from benchmarks.torque_trials.effects import FAMILIES, OPEN, SEALED, Hidden, draw_family
from benchmarks.torque_trials.hiding import View
from benchmarks.torque_trials.physics import Arm, Setup, draw_arm, draw_motion, inverse_dynamics, rigid, torques
from lite6jax.arms.description import read_description
from lite6jax.arms.dynamics import inverse_dynamics as library_torques
from lite6jax.arms.dynamics import link_parameters
from lite6jax.recordings import read_recording
from tests.oracles.pinocchio_dynamics import pinocchio_model, pinocchio_torques

GRAVITY = np.array([0.0, 0.0, -9.81])
AT = np.array([0.01, -0.02, 0.03])


def a_scene(name="lite6", seed=3, seconds=3.0, payload=0.0, tilted=False, **more):
    rng = np.random.default_rng(seed)
    arm = draw_arm(name, rng)
    gravity = rotation_from_vector(np.array([0.7, -0.4, 0.2])) @ GRAVITY if tilted else GRAVITY
    return Setup(arm, gravity, AT), draw_motion(rng, arm, 100.0, seconds, payload=payload, **more)


def torques_of_pinocchio(setup, motion):
    """With a payload lumped into the last link."""
    chain = setup.arm.chain
    model = pinocchio_model(chain.rows, chain.mass, chain.center, setup.arm.inertia, setup.gravity)
    point = pin.Inertia(motion.payload[0], setup.payload_center, np.zeros((3, 3)))
    model.appendBodyToJoint(len(chain.rows), point, pin.SE3.Identity())
    return pinocchio_torques(model, motion.q.T, motion.dq.T, motion.ddq.T).T


@pytest.mark.parametrize("name", ["lite6", "seven"])
@pytest.mark.parametrize("payload", [0.0, 0.7])
def test_torques_of_rigid_bodies_are_those_of_pinocchio_and_mujoco(name, payload):
    setup, motion = a_scene(name, payload=payload, tilted=True)
    ours = torques(setup, (), motion)
    np.testing.assert_allclose(ours, torques_of_pinocchio(setup, motion), atol=1e-9)
    theirs = mujoco_arm.SimulatedArm(setup, (), payload).exerted(motion.q, motion.dq, motion.ddq)
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    assert np.ptp(ours, axis=0).min() > 1e-3


@pytest.mark.parametrize(
    "effect",
    [
        Hidden("viscous_friction", "joint2", {"viscous_Nm_s_per_rad": 0.8}),
        Hidden("rotor_inertia", "joint5", {"inertia_kg_m2": 0.02}),
        Hidden("joint_spring", "joint3", {"stiffness_Nm_per_rad": 1.5, "rest_rad": 0.4}),
        Hidden("link_mass", "link4", {"mass_kg": 0.2}),
        Hidden("link_com", "link2", {"x_m": 0.01, "y_m": -0.02, "z_m": 0.005}),
        Hidden("payload_error", "payload", {"mass_kg": 0.3}),
        Hidden("base_tilt", "base", {"tilt_x_rad": 0.03, "tilt_y_rad": -0.02}),
    ],
    ids=lambda effect: effect.name,
)
def test_effects_that_mujoco_has_are_the_same_there(effect):
    setup, motion = a_scene(payload=0.2)
    theirs = mujoco_arm.SimulatedArm(setup, (effect,), 0.2).exerted(motion.q, motion.dq, motion.ddq)
    np.testing.assert_allclose(torques(setup, (effect,), motion), theirs, atol=1e-9)
    assert np.abs(theirs - torques(setup, (), motion)).max() > 1e-3


def test_a_driven_arm_exerts_what_its_motion_and_mujocos_dry_friction_ask_for():
    setup, motion = a_scene()
    effect = Hidden("coulomb_friction", "joint2", {"coulomb_Nm": 0.6})
    made, exerted = mujoco_arm.SimulatedArm(setup, (effect,), 0.0).driven(motion)
    np.testing.assert_allclose(made.q, motion.q, atol=0.02)
    added = exerted - torques(setup, (), made)
    moving = np.abs(made.dq[:, 1]) > 0.05
    off = np.abs(added[moving, 1] - 0.6 * np.sign(made.dq[moving, 1]))
    assert np.mean(off < 1e-6) > 0.97  # just after a reversal, a soft constraint holds with less
    assert np.abs(added[:, 1]).max() < 0.6 + 1e-6
    np.testing.assert_allclose(np.delete(added, 1, 1), 0, atol=1e-6)
    assert moving.mean() > 0.5


@pytest.mark.parametrize("name", ["lite6", "seven"])
def test_torques_of_a_driven_arm_belong_to_the_instant_of_its_motion(name):
    """A clock offset that nobody hid would be found: the best one is far below what 6000 rows can tell."""
    setup, motion = a_scene(name, seconds=8.0)
    made, exerted = mujoco_arm.SimulatedArm(setup, (), 0.0).driven(motion)
    place, rate = make_interp_spline(made.time, made.q, 5), make_interp_spline(made.time, made.dq, 5)

    def asked(offset):
        at = made.time + offset
        return inverse_dynamics(setup.arm, place(at), rate(at), rate.derivative()(at), setup.gravity)[20:-20]

    left = (exerted[20:-20] - asked(0.0)) / setup.arm.noise
    slope = (asked(1e-3) - asked(-1e-3)) / 2e-3 / setup.arm.noise
    offset = np.sum(left * slope) / np.sum(slope**2)
    sigma = 1 / np.sqrt(np.sum(slope**2) * 6000 / len(left))
    assert abs(offset) < 0.5 * sigma
    assert np.sqrt(np.mean(left**2)) < 0.005


def test_a_torque_stamped_t_belongs_to_the_motion_at_t_and_the_offset():
    setup, motion = a_scene()
    shifted = torques(setup, (Hidden("time_offset", "clock", {"offset_s": 0.05}),), motion)
    np.testing.assert_allclose(shifted[:-5], torques(setup, (), motion)[5:], atol=1e-9)


def test_the_torque_of_one_joint_belongs_to_the_motion_before():
    setup, motion = a_scene()
    friction = Hidden("coulomb_friction", "joint3", {"coulomb_Nm": 0.5})
    others = (friction, Hidden("torque_scale", "joint3", {"scale": 0.1}))
    plain = torques(setup, others, motion)
    late = torques(setup, (Hidden("torque_lag", "joint3", {"lag_s": 0.05}), *others), motion)
    np.testing.assert_allclose(late[5:, 2], plain[:-5, 2], atol=1e-9)
    np.testing.assert_array_equal(np.delete(late, 2, 1), np.delete(plain, 2, 1))


def test_a_third_of_the_families_are_sealed_and_drawn_on_request_only():
    assert {*OPEN} | {*SEALED} == set(FAMILIES)
    assert not {*OPEN} & {*SEALED}
    assert 0.2 <= len(SEALED) / len(FAMILIES) <= 0.45
    wanted = plans.ROUNDS.indices(5, 3 * len(FAMILIES), "outside")
    for chosen, families in ((False, OPEN), (True, SEALED)):
        drawn = [plans.draw_plan(5, index, np.random.default_rng(0), chosen) for index in wanted]
        assert {plan.effects[0] for plan in drawn} == set(families)
        assert all(plan.sealed == chosen for plan in drawn)


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_adds_to_its_own_joint_in_proportion_and_with_the_sign_that_physics_gives_it(name):
    """Friction that drives an arm on, or a stop that draws it in, is no physics that a library has to tell apart."""
    setup, motion = a_scene(warming=True)
    plain = torques(setup, (), motion)
    drawn = (
        draw_family(name, np.random.default_rng(seed), rigid(setup, (), motion), setup.arm.noise) for seed in range(9)
    )
    number, fixed = next(filter(None, drawn))
    joint = number - 1
    one, two = (
        torques(setup, (Hidden(name, f"joint{number}", {"size": size}, fixed),), motion) - plain for size in (1.0, 2.0)
    )
    assert one.any()
    assert not np.delete(one, joint, 1).any()
    np.testing.assert_allclose(two, 2 * one, atol=1e-12)
    added, velocity = one[:, joint], motion.dq[:, joint]
    if name in ("soft_stop", "hardening_cable"):
        rest = fixed.get("at", fixed.get("rest"))
        assert np.all(added * (motion.q[:, joint] - rest) >= 0)
    elif name == "presliding":  # bristles store energy, and give back less
        assert np.sum(added * velocity) > 0
    elif name == "quantised":
        steps = (plain[:, joint] + added) / fixed["step_Nm"]
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    elif FAMILIES[name].positive and name != "saturation":
        assert np.all(added * velocity >= 0)


def test_motions_keep_within_the_limits():
    for seed in range(5):
        setup, motion = a_scene("seven" if seed % 2 else "lite6", seed=seed, seconds=20.0)
        limits = setup.arm.chain.limits
        assert np.all((motion.q > limits[:, 0]) & (motion.q < limits[:, 1]))
        assert np.abs(motion.dq).max() < setup.arm.velocity
        assert np.abs(motion.ddq).max() < setup.arm.acceleration
        np.testing.assert_allclose(np.gradient(motion.q, 0.01, axis=0)[1:-1], motion.dq[1:-1], atol=5e-3)
        np.testing.assert_allclose(np.gradient(motion.dq, 0.01, axis=0)[1:-1], motion.ddq[1:-1], atol=3e-2)


@pytest.mark.parametrize("inertial", [0.0, 0.1, np.inf], ids=["declared", "uncertain", "unknown"])
def test_at_the_threshold_half_are_found(inertial):
    rng = np.random.default_rng(17)
    setup, motion = a_scene(seconds=8.0)
    view = View.of(setup, motion, setup.arm.noise, inertial)
    effect = Hidden("viscous_friction", "joint5", {"viscous_Nm_s_per_rad": 1.0})
    span = view.span()
    found = hiding.detection_threshold(view, (effect,), 0, span)
    there = effect.scaled(found.size)
    column = detection.project_out(span, view.columns((effect,), 0, effect.sizes))[:, 0]
    shown = view.whitened(view.torques((there,)) - view.torques(()))
    # noise of every whitened number, and of every inertial number of which something is known
    noise = rng.normal(size=(4000, len(shown)))
    explained = ((shown + noise) @ column / np.linalg.norm(column)) ** 2
    assert np.mean(explained > chi2.isf(detection.ALARM / detection.SEARCHED, 1)) == pytest.approx(0.5, abs=0.03)
    assert (found.seen < 1 - 1e-6) == (inertial > 0)


def test_bounds_are_what_a_fit_reaches():
    rng = np.random.default_rng(19)
    setup, motion = a_scene(seconds=8.0)
    view = View(setup, motion, setup.arm.noise, np.inf)
    hidden = (
        Hidden("viscous_friction", "joint3", {"viscous_Nm_s_per_rad": 0.3}),
        Hidden("torque_ripple", "joint3", {"amplitude_Nm": 0.3, "order": 9.0, "phase_rad": 1.0}),
    )
    limits = hiding.bounds(view, hidden)
    J = np.concatenate([view.span(), *(view.columns(hidden, k, list(limits[k])) for k in (0, 1))], 1)
    lengths = np.linalg.norm(J, axis=0).clip(1e-9)  # some numbers of the first link move nothing
    off = np.linalg.lstsq(J / lengths, rng.normal(size=(len(J), 800)), rcond=1e-10)[0][-4:] / lengths[-4:, None]
    wanted = [bound for each in limits for bound in each.values()]
    np.testing.assert_allclose(off.std(1), wanted, rtol=0.12)


def test_the_unseen_error_is_that_of_a_fit():
    """Of base parameters and a friction, fitted and predicted on another motion."""
    rng = np.random.default_rng(23)
    setup, motion = a_scene(seconds=8.0)
    unseen = draw_motion(rng, setup.arm, 100.0, 4.0)
    view = View(setup, motion, setup.arm.noise, np.inf)
    hidden = (Hidden("coulomb_friction", "joint2", {"coulomb_Nm": 0.3}),)
    later = View(setup, unseen, setup.arm.noise, np.inf)
    ours = np.concatenate([view.span(), view.columns(hidden, 0, ["coulomb_Nm"])], 1)
    slope = next(later.slopes(hidden, 0, ["coulomb_Nm"]))
    theirs = np.concatenate([later.nuisance, slope.reshape(-1, 1)], 1)
    lengths = np.linalg.norm(ours, axis=0).clip(1e-9)
    fits = np.linalg.lstsq(ours / lengths, rng.normal(size=(len(ours), 200)), rcond=1e-7)[0]
    off = theirs / lengths @ fits
    assert hiding.unseen_error(view, hidden, unseen) == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.06)


def test_a_payload_is_what_comes_nearest_to_a_mass_of_the_last_link():
    setup, motion = a_scene(seconds=5.0)
    at = setup.arm.chain.center[-1]
    view = View(Setup(setup.arm, GRAVITY, at), motion, setup.arm.noise)
    hidden = (Hidden("payload_error", "payload", {"mass_kg": 0.2}),)
    rival = hiding.nearest_rival(view, hidden, 0, view.span())
    assert (rival.name, rival.site) == ("link_mass", "link6")
    assert rival.apart < 1e-3


@pytest.mark.parametrize("noise", plans.NOISES)
def test_noise_is_of_its_kind(noise):
    setup, motion = a_scene(seconds=40.0)
    plan = plans.Plan(0, 0, "clean", "plain", "lite6", "declared", "torque", noise, 100.0, 40.0, (), ())
    exerted = torques(setup, (), motion)
    q, dq, torque = trials.measure(plan, np.random.default_rng(5), motion, exerted, setup.arm.noise)
    e = (torque - exerted) / setup.arm.noise
    memory = np.mean(e[1:] * e[:-1]) / np.mean(e**2)
    assert memory == pytest.approx(0.9 if noise == "autocorrelated" else 0, abs=0.05)
    assert np.median(np.abs(e)) / 0.6745 == pytest.approx(2 if noise == "twice as declared" else 1, rel=0.12)
    assert (np.abs(e).max() > 12) == (noise == "outliers")
    assert np.std(dq - motion.dq) == pytest.approx(2e-2 if noise == "noisy velocities" else 1e-3, rel=0.05)
    assert np.std(q - motion.q) == pytest.approx(2e-5, rel=0.05)


def test_a_contact_is_felt_where_it_is_said_to_be():
    setup, motion = a_scene(seconds=10.0)
    plan = plans.Plan(
        0, 0, "faulty", "plain", "lite6", "declared", "torque", "white", 100.0, 10.0, (), (), "", "contact"
    )
    quiet = np.zeros((len(motion.q), 6))
    read = trials.measure(plan, np.random.default_rng(5), motion, quiet, setup.arm.noise)
    spoiled = faults.spoil(plan, np.random.default_rng(5), setup, motion, read)
    rows, pushed = spoiled.rows, np.abs(spoiled.torque / setup.arm.noise).max(1)
    assert pushed[rows].max() > 8
    assert np.delete(pushed, rows).max() < 5
    assert rows == list(range(rows[0], rows[-1] + 1))


def test_a_declared_arm_is_as_far_off_as_is_said():
    arm = draw_arm("lite6", np.random.default_rng(0))
    said = {}
    for inertial in ("declared", "uncertain", "unknown"):
        plan = plans.Plan(0, 0, "clean", "plain", "lite6", inertial, "torque", "white", 100.0, 10.0, (), ())
        told = [trials.declare_arm(plan, np.random.default_rng(k), arm) for k in range(200)]
        said[inertial] = np.std([each.chain.mass / arm.chain.mass for each in told])
    assert said == {"declared": 0.0, "uncertain": pytest.approx(0.1, rel=0.1), "unknown": pytest.approx(0.2, rel=0.1)}


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.long if kind == "mixture" else ()) for kind in KINDS]
)
def test_a_seed_gives_the_same_trial_of_the_planned_size(kind):
    index = plans.ROUNDS.indices(1, 1, kind)[0]
    first, second = trials.draw(1, index), trials.draw(1, index)
    assert first.files == second.files
    assert first.truth == second.truth
    told = json.dumps(first.truth, allow_nan=False)
    assert json.loads(told)["rows"] == len(first.files["recording.csv"].splitlines()) - 1
    given = " ".join(first.files.values())
    assert not any(effect["effect"] in given for effect in first.truth["hidden"])  # nothing tells
    if kind == "single" and first.plan.engine == "plain":
        assert first.truth["hidden"][0]["size"] == pytest.approx(first.truth["sizes"][0], rel=0.01)


@pytest.mark.parametrize("source", ["torque", "current"])
def test_the_library_reads_a_trial_and_its_arm_exerts_the_same(source, tmp_path):
    drawn = (trials.draw(2, index) for index in plans.ROUNDS.indices(2, 40, "clean"))
    trial = next(t for t in drawn if (t.plan.source, t.plan.inertial) == (source, "declared"))
    write_files(trial.files, tmp_path)
    recording = read_recording(tmp_path / "recording.csv")
    assert not recording.notes
    assert len(recording.torques()) == trial.truth["rows"]
    arm, gravity = read_description(tmp_path / "arm.yaml"), np.array(recording.settings.gravity_m_per_s2)
    rng = np.random.default_rng(3)
    q, dq, ddq = rng.uniform(-2, 2, (3, 20, arm.dof))
    theirs = np.asarray(library_torques(arm.kinematics, link_parameters(arm), q.T, dq.T, ddq.T, gravity)).T
    ours = inverse_dynamics(read_arm(tmp_path / "arm.yaml"), q, dq, ddq, gravity)
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_resting_joints_rest_and_the_effect_is_elsewhere():
    plan = plans.Plan(
        *(0, 0, "edge", "plain", "lite6", "declared", "torque", "white", 100.0, 10.0),
        *(("viscous_friction",), (4.0,), "resting joints"),
    )
    rng = np.random.default_rng(2)
    setup, motion = a_scene(resting=3)
    assert not motion.dq[:, :3].any()
    view = View.of(setup, motion, setup.arm.noise, 0.0)
    sites = {effect.site for _ in range(20) for effect in hiding.hide(plan, rng, view) or ()}
    assert sites <= {"joint4", "joint5", "joint6"}
    assert len(sites) > 1


def read_arm(path):
    said = yaml.safe_load(path.read_text())
    rows = [[each[name] for name in ("x", "y", "z", "roll", "pitch", "yaw")] for each in said["kinematics"].values()]
    links = list(said["inertial"].values())
    tensors = [[[a, d, e], [d, b, f], [e, f, c]] for a, b, c, d, e, f in (link["inertia_kg_m2"] for link in links)]
    mass, center = (np.array([link[key] for link in links]) for key in ("mass_kg", "com_m"))
    chain = Chain(said["name"], np.array(rows), np.array(said["joint_limits_rad"]), mass, center)
    return Arm(chain, np.array(tensors), np.ones(len(mass)))


def spoiled(fault, seed=5, seconds=10.0):
    """A scene, what is read of it right, and with this fault where one can be told."""
    resting = 3 if fault == "velocity_bias" else 0
    setup, motion = a_scene(seconds=seconds, resting=resting)
    plan = plans.Plan(0, 0, "faulty", "plain", "lite6", "declared", "torque", "white", 100.0, 10.0, (), (), "", fault)
    read = motion.q, motion.dq, torques(setup, (), motion)
    drawn = (faults.spoil(plan, np.random.default_rng(k), setup, motion, read) for k in range(seed, seed + 50))
    return setup, motion, read, next(filter(None, drawn))


@pytest.mark.parametrize("fault", sorted(set(plans.DATA_FAULTS)))
def test_what_undoes_a_fault_gives_back_what_was_read(fault):
    setup, motion, (q, dq, torque), wrong = spoiled(fault)
    at = [joint - 1 for joint in wrong.joints]
    undone_q, undone_torque, undone_dq = wrong.q.copy(), wrong.torque.copy(), wrong.dq.copy()
    match fault:
        case "swapped_torques" | "swapped_columns":
            undone_torque[:, at] = undone_torque[:, at[::-1]]
            if fault == "swapped_columns":
                undone_q[:, at], undone_dq[:, at] = undone_q[:, at[::-1]], undone_dq[:, at[::-1]]
        case "reversed_torque" | "reversed_joint" | "reversed_positions":
            undone_torque[:, at] *= 1 if fault == "reversed_positions" else -1
            undone_q[:, at] *= 1 if fault == "reversed_torque" else -1
            undone_dq[:, at] *= 1 if fault == "reversed_torque" else -1
        case "joint_zero":
            undone_q[:, at] += wrong.numbers["added_rad"]
        case "wrong_torque_constant" | "torque_unit":
            undone_torque[:, at] /= wrong.numbers["factors"]
        case "no_gravity":
            undone_torque += inverse_dynamics(setup.arm, q, 0 * q, 0 * q, GRAVITY, motion.payload, AT)
        case "wrong_gravity":
            assert wrong.numbers["gravity_m_per_s2"] == setup.gravity.tolist()
            assert np.linalg.norm(wrong.gravity - setup.gravity) > 9
        case "joint_turns":
            assert wrong.turns
        case "velocity_bias":
            assert np.ptp(q[:, at]) == 0
            undone_dq[:, at] = dq[:, at]
            assert 0.005 <= abs(np.mean(wrong.dq[:, at])) <= 0.02
    for undone, right in ((undone_q, q), (undone_dq, dq), (undone_torque, torque)):
        np.testing.assert_allclose(undone, right, atol=1e-9)
