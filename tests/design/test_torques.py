"""What motions determine of base parameters and friction, against Pinocchio's regressor and plain least squares."""

import re

import numpy as np
import pytest
from domains.torque import slid

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import load_bundled, write_arm
from lite6jax.cli import main
from lite6jax.cli.study import TorqueSetup
from lite6jax.design import candidates
from lite6jax.design.motions import JointTrajectory, MotionRoom, random_motions
from lite6jax.design.torques import TorqueExperiment, identify_torques, plan_motion, record_motion
from lite6jax.errors import InputError
from lite6jax.report.study import torque_identification_report, torque_plan_report
from tests.oracles.arms import random_kinematics
from tests.oracles.chains import six_parameter_poses
from tests.oracles.pinocchio_dynamics import pinocchio_model, pinocchio_regressor

GRAVITY = (0.0, 0.0, -9.81)
PLANAR = np.array([[0.0, 0, 0, 0, 0, 0], [0.4, 0, 0, 0, 0, 0], [0.3, 0, 0, 0, 0, 0]])


def random_states(dof, samples=200, seed=1):
    return JointTrajectory(*(2 * np.random.default_rng(seed).standard_normal((3, dof, samples))))


def oracle(kinematics, motion, gravity=GRAVITY):
    """Pinocchio's regressor `(joint · sample, 10 joint)`, joint after joint."""
    dof = len(kinematics)
    model = pinocchio_model(kinematics, np.ones(dof), np.zeros((dof, 3)), np.tile(np.eye(3), (dof, 1, 1)), gravity)
    return pinocchio_regressor(model, *motion).transpose(0, 2, 1).reshape(-1, 10 * dof)


def with_friction(kinematics, motion, gravity=GRAVITY):
    """The same with viscous, Coulomb, offset and rotor columns of each joint, written out."""
    dof, samples = motion.q.shape
    joints = np.zeros((dof, samples, dof, 4))
    for i in range(dof):
        joints[i, :, i] = np.stack([motion.dq[i], np.sign(motion.dq[i]), np.ones(samples), motion.ddq[i]], 1)
    return np.hstack([oracle(kinematics, motion, gravity), joints.reshape(dof * samples, -1)])


def chain(dof, seed=0):
    return random_kinematics(np.random.default_rng(seed), dof)


@pytest.mark.parametrize(
    ("kinematics", "gravity", "known"),
    [
        (load_bundled("lite6").kinematics, GRAVITY, 36),
        (load_bundled("xarm7").kinematics, GRAVITY, 43),
        (chain(3), GRAVITY, None),
        (PLANAR, GRAVITY, 7),  # gravity along the axes: Izz, m·cx, m·cy of each link, but m·c of the first
        (PLANAR, (0.0, -9.81, 0.0), 9),
    ],
    ids=["lite6", "xarm7", "3R", "planar along gravity", "planar across gravity"],
)
def test_the_number_of_base_parameters(kinematics, gravity, known):
    found = TorqueExperiment(Arm("an arm", kinematics), gravity=gravity)
    rank = np.linalg.matrix_rank(oracle(kinematics, random_states(len(kinematics)), gravity), rtol=1e-9)
    assert sum(item.name.startswith("link") for item in found.base) == rank
    if known is not None:
        assert rank == known
    with_joints = with_friction(kinematics, random_states(len(kinematics)), gravity)
    assert len(found.base) == np.linalg.matrix_rank(with_joints, rtol=1e-9)


def test_base_parameters_give_all_torques():
    """What the words say is the whole truth: torques of any link parameters follow from the combinations alone."""
    kinematics, motion = load_bundled("lite6").kinematics, random_states(6, 60)
    model = TorqueExperiment(Arm("an arm", kinematics))
    found = model
    x = np.random.default_rng(3).standard_normal(len(model.names))
    place = {name: i for i, name in enumerate(model.names)}
    beta = np.array([sum(factor * x[place[name]] for name, factor in item.terms) for item in found.base])
    W = with_friction(kinematics, motion)
    np.testing.assert_allclose(W[:, found.possible.free] @ beta, W @ x, atol=1e-8)


def test_standard_deviations_are_those_of_least_squares():
    kinematics, noise = chain(2), np.array([0.3, 0.05])
    motion = random_states(2, 150)
    found = identify_torques(TorqueExperiment(Arm("an arm", kinematics), noise), motion)
    W = with_friction(kinematics, motion)[:, found.model.possible.free]
    sigma = np.repeat(noise, motion.q.shape[1])
    draws = np.random.default_rng(5).standard_normal((len(W), 4000))
    spread = np.linalg.lstsq(W / sigma[:, None], draws, rcond=None)[0].std(1)
    np.testing.assert_allclose(found.standard_deviation, spread, rtol=0.06)
    scaled = W / sigma[:, None] * found.model.base_scale
    assert found.condition == pytest.approx(np.linalg.cond(scaled), rel=1e-3)
    assert found.log_determinant == pytest.approx(np.linalg.slogdet(scaled.T @ scaled)[1], rel=1e-3)


def test_a_joint_that_does_not_move():
    motion = random_states(3)
    motion.q[2], motion.dq[2], motion.ddq[2] = 0.3, 0.0, 0.0
    kinematics = chain(3)
    found = identify_torques(TorqueExperiment(Arm("an arm", kinematics)), motion)
    W = with_friction(kinematics, motion)[:, found.model.possible.free]
    # a number is determined where its unit vector lies in the row space
    rows = np.linalg.svd(W, full_matrices=False)
    kept = rows[2][rows[1] > 1e-9 * rows[1][0]]
    expected = np.linalg.norm(kept.T @ kept - np.eye(W.shape[1]), axis=1) < 1e-6
    np.testing.assert_array_equal(found.determined, expected)
    assert 0 < found.determined.sum() < len(found.model.base)
    assert found.narrow() == [(2, 0.0)]
    assert "joint3 viscous" not in found.deviations
    assert found.deviations["joint2 viscous"] > 0
    assert np.isneginf(found.log_determinant)
    assert np.isinf(found.standard_deviation[~found.determined]).all()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"motion": JointTrajectory(*np.zeros((3, 2, 90)))},
            "motion: q has the shape (2, 90); an arm takes (3, sample)",
        ),
        ({"motion": JointTrajectory(*np.full((3, 3, 90), np.nan))}, "motion: q has a number that is not finite"),
        ({"noise": 0.0}, "torque noise 0 Nm: give one standard deviation above 0"),
        ({"gravity": (0, 0)}, "gravity [0, 0]: give three finite numbers in m/s²"),
    ],
)
def test_what_is_refused(change, says):
    given = {"noise": 0.1, "gravity": GRAVITY, "motion": random_states(3)} | change
    with pytest.raises(InputError, match=re.escape(says)):
        identify_torques(TorqueExperiment(Arm("an arm", chain(3)), given["noise"], given["gravity"]), given["motion"])


def test_a_study_of_a_slide_has_its_units(tmp_path, capsys):
    arm = str(write_arm(slid.arm(), tmp_path / "telescope.yaml"))
    assert main(["identify", arm, "--torque"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "±0.05 Nm, 0.05 Nm, 0.5 N (one standard deviation" in said
    assert "of prismatic joints, P: N·s/m, N, N, kg" in said
    assert "J3 P " in said
    model = TorqueExperiment(slid.arm())
    units = {item.name: item.unit for item in model.base}
    names = ("joint3 viscous", "joint3 rotor inertia", "joint2 Coulomb")
    assert [units[name] for name in names] == ["N·s/m", "kg", "Nm"]
    q, dq, ddq = slid.moved(seconds=4.0)[1:]
    few = identify_torques(model, JointTrajectory(*(part.T * [[1], [1], [0.04]] for part in (q, dq, ddq))))
    assert few.narrow() == [(2, pytest.approx(0.04 * np.ptp(q[:, 2])))]
    assert "No joint" not in " ".join(str(part) for part in torque_identification_report(few, "a", "b"))


# ------------------------------------------------------------------ designed motions


ARM = Arm("an arm", chain(3, seed=4), joint_limits=np.array([[-2.0, 1.0], [0.1, 2.5], [-3.0, 3.0]]))
MADE = {"velocity": [1.0, 2.0, 3.0], "acceleration": [4.0, 6.0, 20.0]}
MADE |= {"duration": 6.0, "harmonics": 4, "rate": 50.0}
ROOM = MotionRoom(ARM, **MADE)
UNKNOWN = TorqueExperiment(ARM)
FINE = np.linspace(0.0, 6.0, 20011)


def draw(seed, size=1.0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.standard_normal((3, 6)), 3 * rng.standard_normal(3), np.full(3, size)])


def test_derivatives_are_those_of_the_positions():
    free, t, h = draw(0), np.linspace(0.3, 4.0, 40), 1e-4
    before, at, after = (ROOM.move(free, t + shift) for shift in (-h, 0.0, h))
    np.testing.assert_allclose((after.q - before.q) / (2 * h), at.dq, atol=1e-6)
    np.testing.assert_allclose((after.dq - before.dq) / (2 * h), at.ddq, atol=1e-5)
    np.testing.assert_allclose(ROOM.move(free, t + 6.0).q, at.q, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_limits_hold_at_every_instant_and_are_used(seed):
    free = draw(seed, size=20.0)  # the greatest amplitude
    q, dq, ddq = (np.asarray(part) for part in ROOM.move(free, FINE))
    lower, upper = ARM.joint_limits.T
    assert ((q >= lower[:, None]) & (q <= upper[:, None])).all()
    used = np.stack([
        np.ptp(q, axis=1) / (upper - lower), abs(dq).max(1) / ROOM.velocity, abs(ddq).max(1) / ROOM.acceleration
    ])  # fmt: skip
    assert (used <= 1).all()
    assert (used.max(0) > 0.98).all()
    np.testing.assert_allclose(np.stack([dq, ddq])[..., [0, -1]], 0, atol=1e-12)
    np.testing.assert_allclose(q[:, 0], q[:, -1], atol=1e-12)
    time, motion = record_motion(ROOM, free)
    np.testing.assert_allclose(time, np.arange(301) / 50)
    np.testing.assert_allclose(motion.dq[:, [0, -1]], 0, atol=1e-12)


def log_determinant(motion, model):
    """From Pinocchio and friction written out; the sign of a velocity that is zero is 0."""
    motion = JointTrajectory(*(np.where(abs(part) < 1e-9, 0, part) for part in motion))
    W = with_friction(ARM.kinematics, motion)[:, model.possible.free] / model.noise[0] * model.base_scale
    return np.linalg.slogdet(W.T @ W)[1]


def test_a_designed_motion_determines_more_than_random_ones():
    model, search = TorqueExperiment(ARM, 0.1), {"seed": 2, "draws": 20, "starts": 1, "steps": 60}
    plan = plan_motion(model, ROOM, **search)
    own = log_determinant(plan.motion, model)
    motions = [record_motion(ROOM, free)[1] for free in random_motions(ROOM, 2, 20)]
    random = [log_determinant(motion, model) for motion in motions]
    # near a reversal the direction is a smooth step, here a sign
    assert plan.identification.log_determinant == pytest.approx(own, abs=1.0)
    np.testing.assert_allclose(plan.random_log_determinant, random, atol=1.0)
    assert own > max(random) + 2
    assert plan.gain(float(np.median(random))) > 1.2
    np.testing.assert_array_equal(plan_motion(model, ROOM, **search).motion.q, plan.motion.q)


def test_obstacles_are_kept_clear_of():
    low, high = (0.0, -0.6, 0.0), (1.2, 0.9, 1.35)
    filters = [candidates.above_floor(ARM, 0.4), candidates.inside_box(ARM, low, high)]
    filters.append(candidates.Filter("mine", lambda q: q[:, 2] < 1.5))
    room = MotionRoom(ARM, **MADE | {"filters": filters, "harmonics": 3})
    plan = plan_motion(UNKNOWN, room, draws=10, starts=1, steps=20)
    q = np.asarray(room.move(plan.free, FINE).q).T
    p = six_parameter_poses(ARM.kinematics, q)[:, :3, 3]
    assert (p[:, 2] > 0.4 - 1e-4).all()
    assert ((p >= np.array(low) - 1e-4) & (p <= np.array(high) + 1e-4)).all()
    assert (q[:, 2] < 1.5 + 1e-3).all()
    assert plan.identification.log_determinant >= plan.random_log_determinant.max()
    # without them the same seed leads elsewhere
    unhindered = plan_motion(UNKNOWN, ROOM, draws=10, starts=1, steps=0).motion.q.T
    assert not candidates.all_pass(filters, unhindered).all()


def limited(*accepted):
    return MotionRoom(ARM, filters=[candidates.Filter("mine", accept) for accept in accepted], **MADE)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: MotionRoom(ARM, duration=-1.0), "duration -1: give a number of s, above 0"),
        (lambda: MotionRoom(ARM, rate=np.inf), "rate inf: give a number of samples a second, above 0"),
        (lambda: MotionRoom(ARM, harmonics=1), "harmonics 1: a motion from rest to rest takes 2"),
        (lambda: MotionRoom(ARM, 1.0, [1.0, 2.0]), "acceleration limit"),
        (lambda: random_motions(limited(lambda q: abs(q[:, 0]) < 0.004)), "mine at any amplitude; widen them"),
        (lambda: random_motions(limited(lambda q: q[:, 0] > 9)), "mine refused 100 % of them; widen it"),
    ],
)
def test_what_a_motion_is_refused_for(call, says):
    with pytest.raises(InputError, match=says):
        call()


# ------------------------------------------------------------------ prismatic joints: N, m and kg


def test_limits_of_a_designed_motion_are_those_of_each_joint():
    limits = MotionRoom(slid.arm(), np.pi, [2.0, 3.0, 0.5], margin=0.05)
    np.testing.assert_allclose(limits.velocity, [np.pi, np.pi, 0.1 * np.pi])
    np.testing.assert_allclose(limits.acceleration, [2.0, 3.0, 0.5])
    np.testing.assert_allclose(limits.position[2], [0.005, 0.395])
    setup = TorqueSetup(torque=True, velocity=(90.0, 90.0, 250.0), acceleration=(600.0,), duration=4.0)
    room = setup.room(slid.arm())
    np.testing.assert_allclose(room.velocity, [np.pi / 2, np.pi / 2, 0.25])
    np.testing.assert_allclose(room.acceleration[2], np.deg2rad(600) * 0.1)
    model = TorqueExperiment(slid.arm(), inertial=False)
    plan = plan_motion(model, room, draws=3, starts=1, steps=2)
    assert (np.abs(plan.motion.dq).max(1) <= room.velocity * (1 + 1e-9)).all()
    text = " ".join(str(part) for part in torque_plan_report(plan, (), "telescope"))
    assert "up to 90 deg/s and 250 mm/s and 600 deg/s² and 1047 mm/s²" in " ".join(text.split())
