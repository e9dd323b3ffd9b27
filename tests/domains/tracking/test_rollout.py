"""Rollouts from commands alone, against formulas, other step lengths and MuJoCo."""

import numpy as np
import pytest
from scipy.signal import lsim
from scipy.signal import step as step_response
from scipy.spatial.transform import Rotation

from lite6jax.domains.tracking.coupling import Bodies, JointLoads, loads_along, roll_coupled
from lite6jax.domains.tracking.rollout import CHANNELS, FRICTION, TORQUE, hold_commands, roll
from lite6jax.effects.servo import RIGID_GRIP, Servo

PERIOD = 0.01
TIME = np.arange(400) * PERIOD
KINEMATICS = np.array(
    [[0.0, 0.0, 0.2, 0.0, 0.1, 0.0], [0.0, 0.0, 0.0, -1.5, 0.0, 0.2], [0.25, 0.0, 0.0, 0.1, 0.0, 0.0]]
)
CENTERS = np.array([[0.01, 0.02, 0.03], [0.12, 0.01, 0.0], [0.08, 0.0, 0.02]])
MASSES = np.array([1.5, 1.2, 0.8])
TENSORS = np.array([[2e-3, 3e-3, 2.5e-3], [2e-3, 6e-3, 6e-3], [1e-3, 2e-3, 2e-3]])
ARMATURE = np.array([0.15, 0.1, 0.05])


def bodies():
    """Three links with diagonal tensors about their centres."""
    links = []
    for m, c, I in zip(MASSES, CENTERS, TENSORS, strict=True):
        about = np.diag(I) + m * (c @ c * np.eye(3) - np.outer(c, c))
        links.append([m, *(m * c), about[0, 0], about[1, 1], about[2, 2], about[0, 1], about[0, 2], about[1, 2]])
    return Bodies(KINEMATICS, np.array(links), np.zeros(3), np.array([0.0, 0.0, -9.81]))


def commands_of(joints, pause=0.5):
    """Sines of several frequencies after a pause, `(sample, joint)` rad."""
    t = np.maximum(TIME - pause, 0.0)[:, None]
    w = 2 * np.pi * np.array([0.2, 0.25, 0.3])[:joints]
    return 0.3 * np.sin(w * t) + 0.1 * (1 - np.cos(2.3 * w * t)) + np.array([0.1, -0.4, 0.3])[:joints]


def plain(joints, **numbers):
    servo = Servo.ideal(np.full(joints, 300.0), np.full(joints, 12.0))._replace(inertia=ARMATURE[:joints])
    return servo._replace(
        **{name: np.broadcast_to(np.asarray(value, float), (joints,)) for name, value in numbers.items()}
    )


def roll_alone(servo, u, run=None, start=None, load=0.0, **options):
    """One joint of 0.2 kg·m² that carries a load in Nm, from its first command or from a read-out."""
    run = np.zeros(len(u), int) if run is None else run
    begins = u[:, None] if start is None else np.full((len(u), 1), start)
    held = hold_commands(u[:, None], run, PERIOD, begins, **options)
    nothing = np.zeros((1, held.samples * held.steps))
    return roll(servo, held, np.array([0]), nothing + load, nothing + 0.2).readout[0]


def test_a_joint_without_friction_is_the_linear_system():
    u = np.where(TIME < 0.5, 0.1, 0.2)
    servo = plain(1, viscous=1.0)
    fine = np.linspace(0, TIME[-1], 20 * len(TIME) - 19)
    command = u[np.minimum((fine / PERIOD + 1e-6).astype(int), len(u) - 1)] - 0.1
    mass = 0.2 + ARMATURE[0]
    exact = lsim(([300.0], [mass, 13.0, 300.0]), command, fine, interp=False)[1][::20] + 0.1
    assert np.abs(roll_alone(servo, u) - exact).max() < 5e-5


def test_a_delay_of_samples_shifts_the_commands():
    u = commands_of(1)[:, 0]
    late = np.r_[np.full(3, u[0]), u[:-3]]
    assert np.abs(roll_alone(plain(1, delay=0.03), u) - roll_alone(plain(1), late)).max() < 1e-12


def test_a_rate_limit_holds_the_speed():
    u = np.where(TIME < 0.5, 0.0, 1.0)
    y = roll_alone(plain(1, rate_limit=0.5), u)
    assert np.diff(y[100:220]) / PERIOD == pytest.approx(0.5, rel=1e-3)


def test_commands_that_are_early_hold_the_last_one_of_their_run():
    u = commands_of(1)[:, 0]
    run = np.repeat([0, 1], 200)
    early = np.r_[u[3:200], np.full(3, u[199]), u[203:], np.full(3, u[-1])]
    apart = roll_alone(plain(1, delay=-0.03), u, run) - roll_alone(plain(1), early, run)
    assert np.abs(apart[5:200]).max() < 1e-6  # the pause before the motion is longer than the shift
    assert np.abs(apart[:200]).max() < 1e-12
    steady = np.where(TIME < 3.0, 0.1, 0.3)
    fast = roll_alone(plain(1, clock_rate=0.05), steady)
    assert fast[-1] == pytest.approx(0.3, abs=1e-6)


@pytest.mark.parametrize("delay", [0.0, 0.0033, 0.0068])
def test_a_rate_limit_follows_a_step_from_the_instant_of_its_switch(delay):
    step = np.where(TIME < 0.995, 0.0, 10.0)
    limited = roll_alone(plain(1, rate_limit=0.5, delay=delay), step)
    ramp = roll_alone(plain(1, delay=delay), np.maximum(TIME - 1.0, 0.0) * 0.5, interpolated=True)
    assert np.abs(limited - ramp).max() < 1e-6


@pytest.mark.parametrize("delay", [0.0, 0.003])
def test_feed_forward_pushes_at_the_instant_of_a_switch(delay):
    u = np.where(TIME < 0.495, 0.0, 0.1)
    moved = roll_alone(plain(1, feedforward=6.0, delay=delay), u)
    mass = 0.2 + ARMATURE[0]
    # the derivative of a step is what the numerator makes of it
    exact = step_response(([6.0 * 0.1, 300.0 * 0.1], [mass, 12.0, 300.0]), T=np.linspace(0.0, 3.0, 30001))
    assert np.abs(moved - np.interp(TIME - 0.5 - delay, *exact, left=0.0)).max() < 2e-4


def test_an_integral_part_has_settled_before_a_run():
    u = np.full(len(TIME), 0.4)
    balanced = roll_alone(plain(1, integral=30.0), u, start=0.39, load=3.0)
    assert np.abs(np.diff(balanced[:2])).max() < 1e-5
    # what the integral part adds at first is 3 Nm less 300 Nm/rad times the error
    helped = roll_alone(plain(1, integral=30.0), u, start=0.395, load=3.0)
    assert np.abs(np.diff(helped[:2])).max() < 1e-5
    assert np.all(np.diff(helped) > -1e-9)


def test_a_small_integral_part_hardly_moves_a_joint():
    """One that rests where its servo carries it, of which a read-out says so to 10 µrad."""
    u = 0.4 + 0.2 * np.sin(2 * np.pi * 0.5 * np.maximum(TIME - 0.5, 0.0))
    start = 0.4 - 3.0 / 300.0 + 1e-5
    friction = {"start": start, "load": 3.0}
    without = roll_alone(plain(1, coulomb=1.0), u, **friction)
    integral = roll_alone(plain(1, coulomb=1.0, integral=0.01), u, **friction)
    assert np.abs(integral - without).max() < 5e-5
    larger = roll_alone(plain(1, coulomb=1.0, integral=10.0), u, **friction)
    assert np.abs(larger - without).max() > 1e-3


def test_an_integral_part_balances_what_a_joint_carries_at_rest():
    """Loads with which a run begins may be those of other joints that move."""
    u = np.full(len(TIME), 0.4)
    held = hold_commands(u[:, None], np.zeros(len(u), int), PERIOD, u[:, None])
    nothing = np.zeros((1, held.samples * held.steps))
    weight = np.full((1, held.samples), 3.0)
    jerk = nothing + 3.0
    jerk[:, : held.steps] = 5.0
    one = plain(1, integral=30.0), held, np.array([0])
    quiet = roll(*one, nothing + 3.0, nothing + 0.2).readout[0]
    jerked = roll(*one, jerk, nothing + 0.2, weight=weight).readout[0]
    assert np.abs(quiet - 0.4).max() < 1e-9
    assert 1e-5 < np.abs(jerked - 0.4).max() < 1e-3
    assert abs(jerked[-1] - 0.4) < 1e-5


@pytest.mark.parametrize("numbers", [{"offset": 0.02}, {"scale": -0.05}, {"sine": 0.01, "cosine": -0.02}])
def test_runs_begin_where_the_encoder_shows_the_joint(numbers):
    u = np.full(len(TIME), 0.4)
    wave = numbers.get("sine", 0.0) * np.sin(0.4) + numbers.get("cosine", 0.0) * np.cos(0.4)
    shown = 0.4 * (1 + numbers.get("scale", 0.0)) + numbers.get("offset", 0.0) + wave
    assert roll_alone(plain(1, **numbers), u, start=shown) == pytest.approx(shown, abs=1e-6)


def test_a_tilted_base_turns_gravity():
    tilt = np.array([0.3, -0.2])
    turned = Rotation.from_rotvec([*-tilt, 0.0]).apply([0.0, 0.0, -9.81])
    assert bodies().tilted(tilt).gravity == pytest.approx(turned, abs=1e-12)
    assert bodies().tilted(np.zeros(2)).gravity == pytest.approx([0.0, 0.0, -9.81])


def test_a_torque_limit_that_falls_with_speed_bounds_the_speed():
    u = np.where(TIME < 0.5, 0.0, 20.0)
    y = roll_alone(plain(1, damping=0.0, torque_limit=3.0, torque_droop=0.5), u)
    assert np.diff(y).max() / PERIOD == pytest.approx(2.0, rel=0.02)


def test_friction_holds_a_joint_within_its_band_and_stops_it():
    u = np.where(TIME < 0.5, 0.0, 0.01)
    assert np.abs(roll_alone(plain(1, coulomb=3.1), u)).max() < 1e-6
    moved = roll_alone(plain(1, coulomb=1.5), u)
    assert 0.005 - 1e-9 < moved[-1] < 0.01
    assert np.ptp(moved[-100:]) < 1e-6


def test_friction_that_is_given_along_the_motion_is_that_of_the_servo():
    u = commands_of(1)
    held = hold_commands(u, np.zeros(len(u), int), PERIOD, u)
    nothing = np.zeros((1, held.samples * held.steps))
    extra = np.zeros((1, CHANNELS, len(u)))
    extra[0, TORQUE] = 0.3
    extra[0, FRICTION] = 0.8
    joint = np.array([0])
    along = roll(plain(1, coulomb=0.2), held, joint, nothing, nothing + 0.2, extra=extra).readout
    same = roll(plain(1, coulomb=1.0), held, joint, nothing + 0.3, nothing + 0.2).readout
    assert np.abs(along - same).max() < 1e-12
    less = roll(plain(1, coulomb=0.2), held, joint, nothing, nothing + 0.2, extra=-extra).readout
    none = roll(plain(1), held, joint, nothing - 0.3, nothing + 0.2).readout
    assert np.abs(less - none).max() < 1e-12


def test_backlash_delays_reversals_by_its_width():
    u = 0.2 * np.sin(2 * np.pi * 0.5 * TIME)
    apart = roll_alone(plain(1), u) - roll_alone(plain(1, backlash=0.003), u)
    assert apart[100:].max() == pytest.approx(0.003, rel=1e-6)
    assert apart[100:].min() == pytest.approx(-0.003, rel=1e-6)


def test_a_low_pass_and_a_delay_of_its_time_constant_agree_on_ramps():
    u = np.maximum(TIME - 0.5, 0.0) * 0.2
    apart = roll_alone(plain(1, time_constant=0.05), u) - roll_alone(plain(1, delay=0.05), u)
    assert np.abs(apart[200:]).max() < 1e-5


def roll_arm(servo, longest):
    u = commands_of(3)
    held = hold_commands(u, np.zeros(len(u), int), PERIOD, np.tile(u[0], (len(u), 1)), longest=longest)
    still = np.zeros_like(u.T)
    arm = bodies()
    return roll_coupled(servo, held, arm, loads_along(arm, held, u.T, still, still))[0].readout


RUBBED = [
    {"coulomb": 0.4, "viscous": 1.0},
    {"coulomb": 1.5},
    {"stribeck": 0.5, "coulomb": 0.3},
    {"load_friction": 0.1, "coulomb": 0.1},
]


@pytest.mark.parametrize("numbers", RUBBED)
def test_half_the_step_changes_a_coupled_arm_by_microradians(numbers):
    servo = plain(3, **numbers, grip=2.0)
    change = roll_arm(servo, 0.001) - roll_arm(servo, 0.0005)
    assert np.sqrt(np.mean(change**2, 1)).max() < 1.5e-6
    assert np.abs(change).max() < 10e-6


@pytest.mark.parametrize("grip", [2.0, RIGID_GRIP])
@pytest.mark.parametrize("numbers", [{"coulomb": 1.0}, {"coulomb": 0.5, "stribeck": 0.5, "stribeck_speed": 0.05}])
def test_friction_is_second_order_in_the_step(numbers, grip):
    u = 0.02 * np.sin(2 * np.pi * 0.7 * np.maximum(TIME - 0.3, 0.0))
    servo = plain(1, **numbers, grip=grip)
    by_step = {longest: roll_alone(servo, u, longest=longest) for longest in (0.001, 0.0005, 0.000125)}
    coarse, half = (np.sqrt(np.mean((by_step[h] - by_step[0.000125]) ** 2)) for h in (0.001, 0.0005))
    assert coarse < 0.3e-6
    assert half < 0.4 * coarse  # a fourth, and half where the scheme were of first order


def test_joints_that_move_each_other_as_much_as_themselves_settle():
    u = 0.3 * np.sin(2 * np.pi * np.array([0.4, 0.7, 1.1, 1.6]) * np.maximum(TIME - 0.5, 0.0)[:, None])
    rows = np.zeros((4, 6))
    rows[1:, 0] = 0.25
    light = np.array([[m, 0.12 * m, 0.0, 0.0, 1e-4, 0.015 * m, 0.015 * m, 0.0, 0.0, 0.0] for m in (1.5, 1.2, 1.0, 0.8)])
    arm = Bodies(rows, light, np.zeros(3), np.array([0.0, -9.81, 0.0]))
    servo = Servo.ideal(np.array([250.0, 150.0, 80.0, 40.0]), np.array([10.0, 6.0, 3.0, 1.2]))
    servo = servo._replace(inertia=np.array([0.4, 0.3, 0.15, 0.05]), coulomb=np.full(4, 0.02))
    held = hold_commands(u, np.zeros(len(u), int), PERIOD, np.tile(u[0], (len(u), 1)))
    still = np.zeros_like(u.T)
    rolled, loads = roll_coupled(servo, held, arm, loads_along(arm, held, u.T, still, still))
    torques = arm.torques(rolled.position, rolled.velocity, rolled.acceleration)
    along = torques - loads.mass * rolled.acceleration
    again = roll(servo, held, np.arange(4), along, loads.mass).readout
    # each sweep alone would go apart, to more than a radian after twelve
    assert np.sqrt(np.mean((again - rolled.readout) ** 2)) < 3e-3


def test_lanes_do_not_depend_on_each_other():
    u = commands_of(3)
    held = hold_commands(u, np.repeat([0, 1], 200), PERIOD, u)
    nothing = np.zeros((3, held.samples * held.steps))
    loads = JointLoads(nothing, nothing + 0.2, np.zeros((3, held.samples)))
    servo = plain(3, coulomb=[0.1, 0.2, 0.3])
    both = roll(servo, held, np.arange(3), loads.load, loads.mass).readout
    alone = roll(servo.take([2]), held, np.array([2]), loads.load, loads.mass).readout
    assert np.abs(alone[0] - both[2]).max() < 1e-12
    assert np.array_equal(both[:, 200], u[200])  # a run begins where it is said to


def mujoco_model(mujoco, step):
    """The same arm, its friction as stiff as that of `grip`."""

    def body(i):
        if i == 3:
            return ""
        x, y, z, roll_, pitch, yaw = KINEMATICS[i]
        (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (roll_, pitch, yaw))
        R = (
            np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
            @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
            @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        )
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, R.ravel())
        numbers = {"pos": (x, y, z), "quat": quaternion, "c": CENTERS[i], "I": TENSORS[i]}
        text = {name: " ".join(map(repr, map(float, value))) for name, value in numbers.items()}
        return (
            f'<body pos="{text["pos"]}" quat="{text["quat"]}"><joint axis="0 0 1" damping="1" frictionloss="0.4" '
            f'armature="{ARMATURE[i]}" solreffriction="0.002 1"/>'
            f'<inertial pos="{text["c"]}" mass="{MASSES[i]}" diaginertia="{text["I"]}"/>{body(i + 1)}</body>'
        )

    head = f'<compiler angle="radian"/><option timestep="{step}" integrator="implicitfast"/>'
    return mujoco.MjModel.from_xml_string(f"<mujoco>{head}<worldbody>{body(0)}</worldbody></mujoco>")


def test_the_coupled_arm_agrees_with_mujoco():
    mujoco = pytest.importorskip("mujoco")
    step = 0.0001
    model = mujoco_model(mujoco, step)
    data = mujoco.MjData(model)
    u = commands_of(3)
    data.qpos[:] = u[0]
    rows = []
    for before, command in zip(np.vstack([u[:1], u]), u, strict=False):
        rows.append(data.qpos.copy())
        for part in range(round(PERIOD / step)):
            # a step is centred at its time: half of the first belongs to the command before
            held = command if part else 0.5 * (before + command)
            data.qfrc_applied[:] = 300.0 * (held - data.qpos)
            model.dof_damping[:] = 13.0
            mujoco.mj_step(model, data)
    grip = 0.9 / 0.1 / model.dof_invweight0
    ours = roll_arm(plain(3, coulomb=0.4, viscous=1.0, grip=grip), 0.001)
    assert np.abs(ours - np.array(rows).T).max() < 20e-6


def test_a_rigid_grip_is_the_limit():
    u = np.where(TIME < 0.5, 0.0, 0.01)
    apart = roll_alone(plain(1, coulomb=1.5, grip=1e6), u) - roll_alone(plain(1, coulomb=1.5, grip=RIGID_GRIP), u)
    assert np.abs(apart).max() < 1e-6
