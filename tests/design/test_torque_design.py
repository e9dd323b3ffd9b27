"""Designed motions: their series, their limits, what they are worth, against plain NumPy and Pinocchio."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from lite6jax.arms.arm import Arm
from lite6jax.design import candidates, clearance
from lite6jax.design.criteria import Determinant
from lite6jax.design.torque.ascent import ascend
from lite6jax.design.torque.columns import torque_model
from lite6jax.design.torque.discrimination import plan_torque_discrimination, rival_of
from lite6jax.design.torque.fourier import Free, Motion, Series, motion_limits
from lite6jax.design.torque.identify import structure_of
from lite6jax.design.torque.planning import MotionRoom, plan_motion, random_motions
from lite6jax.effects.dynamic.friction import CoulombFriction, ViscousFriction
from lite6jax.effects.dynamic.motors import TorqueRipple, TorqueScale, TorqueTimeOffset
from lite6jax.errors import InputError
from tests.design.test_torque_identify import chain, with_friction
from tests.oracles.chains import six_parameter_poses

ARM = Arm("an arm", chain(3, seed=4), joint_limits=np.array([[-2.0, 1.0], [0.1, 2.5], [-3.0, 3.0]]))
LIMITS = motion_limits(ARM, [1.0, 2.0, 3.0], [4.0, 6.0, 20.0])
ROOM = MotionRoom(ARM, LIMITS, duration=6.0, harmonics=4, rate=50.0)
NUMBERS = ("samples", "span", "determined", "standard_deviation", "condition", "log_determinant", "at_rest")
FINE = np.linspace(0.0, 6.0, 20011)


def draw(seed, size=1.0, harmonics=4):
    rng = np.random.default_rng(seed)
    return Free(rng.standard_normal((3, 2 * harmonics - 2)), 3 * rng.standard_normal(3), np.full(3, size))


def test_derivatives_are_those_of_the_series():
    rng = np.random.default_rng(0)
    series = Series(rng.standard_normal(3), *rng.standard_normal((2, 3, 4)), 5.0)
    t, h = np.linspace(0.3, 4.0, 40), 1e-4
    before, at, after = series.at(t - h), series.at(t), series.at(t + h)
    np.testing.assert_allclose((after.q - before.q) / (2 * h), at.dq, atol=1e-6)
    np.testing.assert_allclose((after.dq - before.dq) / (2 * h), at.ddq, atol=1e-6)
    np.testing.assert_allclose(series.at(t + 5.0).q, at.q, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_limits_hold_at_every_instant_and_are_used(seed):
    free = draw(seed, size=20.0)  # the greatest amplitude
    q, dq, ddq = (np.asarray(part) for part in ROOM.series(free).at(FINE))
    lower, upper = ARM.joint_limits.T
    assert (q >= lower[:, None]).all()
    assert (q <= upper[:, None]).all()
    used = np.stack([
        np.ptp(q, axis=1) / (upper - lower), abs(dq).max(1) / LIMITS.velocity, abs(ddq).max(1) / LIMITS.acceleration
    ])  # fmt: skip
    assert (used <= 1).all()
    assert (used.max(0) > 0.98).all()
    np.testing.assert_allclose(np.stack([dq, ddq])[..., [0, -1]], 0, atol=1e-12)
    np.testing.assert_allclose(q[:, 0], q[:, -1], atol=1e-12)


def test_what_is_recorded_begins_and_ends_at_rest():
    made = ROOM.trajectory(ROOM.series(draw(0)))
    assert made.time[0] == 0
    assert made.time[-1] == pytest.approx(6.0)
    assert made.motion.q.shape == (3, 301)
    np.testing.assert_allclose(np.diff(made.time), 0.02)
    np.testing.assert_allclose(made.motion.dq[:, [0, -1]], 0, atol=1e-12)


def test_the_gradient_is_that_of_the_criterion():
    model = torque_model(ARM)
    structure = structure_of(model)
    floor = candidates.above_floor(ARM, 0.7)
    room = MotionRoom(ARM, LIMITS, [floor], duration=6.0, harmonics=4, rate=50.0)
    judged = room.excitation(lambda motion: model.columns(motion, structure.free), Determinant())
    start = draw(1)

    def height(free):
        value, penalty, _ = judged.ascent(free)
        return value - penalty

    _, penalty, uphill = judged.ascent(start)
    assert penalty > 0
    for seed in range(3):
        rng = np.random.default_rng(seed)
        along = Free(*(rng.standard_normal(np.shape(part)) for part in start))
        ahead, behind = (Free(*(a + h * b for a, b in zip(start, along, strict=True))) for h in (1e-5, -1e-5))
        difference = (height(ahead) - height(behind)) / 2e-5
        slope = sum(jnp.vdot(g, d) for g, d in zip(uphill, along, strict=True))
        assert float(slope) == pytest.approx(difference, rel=2e-3)


def log_determinant(motion, structure, noise):
    """From Pinocchio and friction written out; the sign of a velocity that is zero is 0."""
    motion = Motion(*(np.where(abs(part) < 1e-9, 0, part) for part in motion))
    W = with_friction(ARM.kinematics, motion)[:, structure.free] / noise
    W = W * [item.scale for item in structure.base]
    return np.linalg.slogdet(W.T @ W)[1]


def test_a_designed_motion_determines_more_than_random_ones():
    model = torque_model(ARM, 0.1)
    plan = plan_motion(model, ROOM, seed=2, draws=20, starts=1, steps=60)
    own = log_determinant(plan.trajectory.motion, plan.identification.structure, 0.1)
    random = [
        log_determinant(ROOM.trajectory(ROOM.series(free)).motion, plan.identification.structure, 0.1)
        for free in random_motions(ROOM, 2, 20)
    ]
    # near a reversal the direction is a smooth step, here a sign
    assert plan.identification.log_determinant == pytest.approx(own, abs=1.0)
    np.testing.assert_allclose(plan.random_log_determinant, random, atol=1.0)
    assert own > max(random) + 2
    assert plan.gain(float(np.median(random))) > 1.2
    again = plan_motion(model, ROOM, seed=2, draws=20, starts=1, steps=60)
    np.testing.assert_array_equal(again.trajectory.motion.q, plan.trajectory.motion.q)


def test_obstacles_are_kept_clear_of():
    floor, box = candidates.above_floor(ARM, 0.4), candidates.Box((0.0, -0.6, 0.0), (1.2, 0.9, 1.35))
    filters = [floor, candidates.inside_box(ARM, box), candidates.Filter("mine", lambda q: q[:, 2] < 1.5)]
    room = MotionRoom(ARM, LIMITS, filters, duration=6.0, harmonics=3, rate=50.0)
    plan = plan_motion(torque_model(ARM), room, draws=10, starts=1, steps=20)
    q = np.asarray(plan.trajectory.series.at(FINE).q).T
    p = six_parameter_poses(ARM.kinematics, q)[:, :3, 3]
    assert (p[:, 2] > 0.4 - 1e-4).all()
    assert (p >= np.array(box.lower) - 1e-4).all()
    assert (p <= np.array(box.upper) + 1e-4).all()
    assert (q[:, 2] < 1.5 + 1e-3).all()
    assert plan.identification.log_determinant >= plan.random_log_determinant.max()
    # without them the same seed leads elsewhere
    freed = plan_motion(torque_model(ARM), ROOM, draws=10, starts=1, steps=0).trajectory.motion.q.T
    assert not candidates.all_pass(filters, freed).all()


def test_designs_do_not_depend_on_the_processes(tmp_path):
    """Under filters of every kind; each process loads the user's anew."""
    (tmp_path / "mine.py").write_text("def low(q):\n    return q[:, 2] < 2.5\n")
    box = candidates.Box((-2.0, -2.0, -2.0), (2.0, 2.0, 2.0))
    filters = [
        candidates.inside_box(ARM, box),
        candidates.above_floor(ARM, -1.5),
        candidates.clear_of_itself(clearance.self_collision(ARM)),
        candidates.user_filter(f"{tmp_path / 'mine.py'}:low"),
    ]
    room = MotionRoom(ARM, LIMITS, filters, duration=6.0, harmonics=3, rate=50.0)
    known = torque_model(ARM, inertial=False)
    rivals = [rival_of(ViscousFriction(2), [1.5], known), rival_of(CoulombFriction(2), [0.0], known)]
    few = {"draws": 7, "starts": 2, "steps": 3}

    def designed(processes):
        plan = plan_motion(torque_model(ARM), room, processes=processes, **few)
        apart = plan_torque_discrimination(known, room, rivals, processes=processes, **few)
        motions = [[part.tolist() for part in made.trajectory.motion] for made in (plan, apart)]
        found = [
            [np.asarray(getattr(one, name)).tolist() for name in NUMBERS] for one in (plan.identification, *plan.random)
        ]
        return motions, found, plan.steps, apart.steps, apart.distance, apart.random_distance.tolist()

    assert designed(2) == designed(None)


def test_an_ascent_never_ends_lower():
    model = torque_model(ARM)
    free = structure_of(model).free
    judged = ROOM.excitation(lambda motion: model.columns(motion, free), Determinant())
    start = random_motions(ROOM, 1, 1)[0]
    best, value, _ = ascend(judged, start, 5)
    assert value >= judged.value(start) - 1e-9
    assert jax.tree.map(np.shape, best) == jax.tree.map(np.shape, start)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"duration": 0.5}, "a motion of 0.5 s at 50 samples a second is too short for 4 harmonics"),
        ({"duration": -1.0}, "duration -1: give a number of s, above 0"),
        ({"rate": np.inf}, "rate inf: give a number of samples a second, above 0"),
        ({"harmonics": 1}, "harmonics 1: a motion from rest to rest takes 2 or more"),
    ],
)
def test_motions_that_are_refused(arguments, says):
    with pytest.raises(InputError, match=says):
        MotionRoom(ARM, LIMITS, **{"duration": 6.0, "harmonics": 4, "rate": 50.0} | arguments)


def test_limits_that_leave_no_room():
    with pytest.raises(InputError, match=r"velocity limit \[0\.\] rad/s: give one number above 0, or 3 of them"):
        motion_limits(ARM, 0.0)
    with pytest.raises(InputError, match="acceleration limit"):
        motion_limits(ARM, 1.0, [1.0, 2.0])
    with pytest.raises(InputError, match="leaves joint2 no room"):
        motion_limits(ARM, margin=1.3)
    fixed = candidates.Filter("mine", lambda q: abs(q[:, 0]) < 0.004)
    room = MotionRoom(ARM, LIMITS, [fixed], duration=6.0, harmonics=4, rate=50.0)
    with pytest.raises(InputError, match="mine at any amplitude; widen them"):
        random_motions(room, 0)
    nowhere = candidates.Filter("mine", lambda q: q[:, 0] > 9)
    with pytest.raises(InputError, match="mine refused 100 % of them; widen it"):
        random_motions(MotionRoom(ARM, LIMITS, [nowhere]), 0)


# ------------------------------------------------------------------ discrimination


def test_the_distance_between_two_rivals():
    """Viscous against Coulomb friction, by a projection in plain NumPy."""
    model = torque_model(ARM, 0.2, inertial=False)
    effects = [(ViscousFriction(2), [1.5]), (CoulombFriction(2), [0.0])]
    rivals = [rival_of(*pair, model) for pair in effects]
    plan = plan_torque_discrimination(model, ROOM, rivals, draws=20, starts=1, steps=40)
    made = plan.trajectory.motion
    dq, ddq = np.asarray(made.dq), np.asarray(made.ddq)
    ones = np.ones(dq.shape[1])
    unknown = np.stack([np.tanh(dq[1] / 0.002), ones, ddq[1]], 1)  # of joint 2: the others do not share a row
    shown = 1.5 * dq[1]
    rest = shown - unknown @ np.linalg.lstsq(unknown, shown, rcond=None)[0]
    assert plan.distance == pytest.approx(np.linalg.norm(rest) / 0.2, rel=0.02)
    assert plan.distance > 1.05 * plan.random_distance.max()
    assert not plan.both_ways
    assert plan.rivals == ("viscous_friction:joint2", "coulomb_friction:joint2")


def test_rivals_that_are_refused():
    known, unknown = torque_model(ARM, inertial=False), torque_model(ARM)
    viscous = rival_of(ViscousFriction(1), [1.0], known)
    with pytest.raises(InputError, match="has no size; give a value"):
        plan_torque_discrimination(known, ROOM, [rival_of(ViscousFriction(1), [0.0], known), viscous])
    with pytest.raises(InputError, match="no motion separates them"):
        plan_torque_discrimination(known, ROOM, [viscous, viscous])
    with pytest.raises(InputError, match="an arm has 3 joints; choose one of these"):
        rival_of(ViscousFriction(4), [1.0], known)
    with pytest.raises(InputError, match="depends on the arm's inertia"):
        rival_of(TorqueScale(1), [0.1], unknown)
    with pytest.raises(InputError, match="depends on more than the motion of the joints"):
        rival_of(TorqueTimeOffset(), [0.01], known)
    with pytest.raises(InputError, match="order is not given"):
        rival_of(TorqueRipple(1), [0.1, 0.0, 0.0], known)
