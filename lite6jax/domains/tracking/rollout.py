"""Rollouts of position-servoed joints from their commands alone.

Of joint i with command u, true position q and read-out y:

    A q̈ + M q̈ + L + b q̇ + (c + s·exp(−(q̇/v)²) + μ|τ|)·sign q̇ + k q + x  =  sat(kp·e + ki∫e + kf·u̇_c) − kd q̇
    e = dead band(u_c − q),  u_c = rate limit(low pass(w(t(1 + r) − d))),  w = u + f_u,  y = play(q) + f_y

x is a torque, f_u a shift of the command and f_y one of the read-out, along a motion that is given. M is the joint's
own inertia, and L what the rest of the arm and gravity exert, likewise along a given motion. A lane is one joint with
one set of numbers, and is integrated alone. Where all joints of an arm are rolled out together, each step corrects L
for their accelerations, with the off-diagonal terms of the mass matrix (`Coupling`). How L depends on positions and
velocities is left to the iteration in `lite6jax.domains.tracking.coupling`.

A step is leapfrog, with damping half implicit and the command averaged over the step. The force of the stiffness is
averaged over the step before, the step and the one after with weights ¼, ½, ¼, which is the method of constant average
acceleration (N. M. Newmark, Journal of the Engineering Mechanics Division 85, 1959, β = ¼). It adds h²·kp / 4 to the
inertia and is stable for any inertia. A rate limit follows a command that switches within the step from the instant of
the switch on.

While a joint sticks, its friction is F = G·(q̈ + B·q̇) as in MuJoCo, with a grip G in kg·m² and B = `RETURN`: it creeps
under load, by load / (G·B). It slides where F exceeds what friction allows. The force of a step is
constant, so its velocity goes piece by piece on lines and exponentials. The instants at which it begins to slide or to
stick lie anywhere in the step, and a held command that switches lets a joint go at its switch: rollouts are of second
order in the step. Light joints, which their damping halts within a step, take F as it is at the end of the step.
"""

from functools import partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.effects.servo import UNLIMITED, Servo
from lite6jax.few_shapes import filled, filled_size

LONGEST_STEP = 0.001
"""s, of an integration step: by half of it the rollouts of arms change by a few µrad."""
RETURN = 2 / (0.95 * 0.002)
"""1/s, B: 2 / (dmax · timeconst) of MuJoCo's `solreffriction` at its stiffest for a step of 1 ms."""
GRIP = 0.96 / (1 - 0.96)
"""Grip over the inertia of the links that a joint moves at its zero: d0 / (1 - d0) of MuJoCo's `solimpfriction`.

A diagnosis looks for the grip of its recording, beginning with this one: `problem.with_likely_grip`.
"""
_RESTED = 2.0
"""s, for which a joint has rested at least when a run begins."""
_MOST_HALTED = 6.0
"""Times h of damping over inertia at most: a lighter joint would turn to and fro at every step."""
_LEAST_TIME = 1e-9
"""s, of a low pass, below which it passes all."""
_HEAVIEST = 1e9
"""kg·m², from which a joint does not answer loads; the least is one over it."""
_WHOLE_STEPS = 4
"""Steps of Newton's, after which halves are taken: a joint may stick after one of them and slide after the next."""
_NEWTON_STEPS = 24
"""Steps of Newton's at most, to the accelerations of joints that load each other."""
_EQUAL_LOADS = 1e-8
"""Nm, and share of a load, by which loads differ at most after the last one."""
_INVERTED = 3
"""Iterations from a first read-out to where the joint is: each leaves at most a tenth of the error before it."""
CHANNELS = 4
"""What is added to a joint along a given motion:"""
TORQUE = 0
"""Nm, x."""
FRICTION = 1
"""Nm, what c is more."""
COMMAND = 2
"""rad, f_u."""
READ_OUT = 3
"""rad, f_y."""
_FURTHER_LANES = 48
"""Of which larger numbers of lanes are multiples."""
_LANES = (6, 24, _FURTHER_LANES, 144)
"""Numbers of lanes that are compiled for; others are filled up."""
_JOINTS = 8
"""Of which the numbers of joints that are compiled for are multiples."""
_LEAST_SAMPLES = 1024
"""That are compiled for; fewer are filled up."""
_BLOCK = 32
"""Samples whose commands and loads are computed at a time: they stay in a core's cache."""
MOST_LANES = _LANES[-1]
"""From which more at once save no time, and each number of them takes seconds to compile."""


@final
class Commands(NamedTuple):
    """Commands on the even grid of a rollout, run after run.

    Attributes:
        integral: `(joint, sample · steps + 1)` rad·s, ∫u dt at every step.
        reset: `(sample,)` bool, where a run begins.
        first: `(sample,)` int, the sample at which its run begins.
        start: `(sample, joint)` rad, read-outs with which runs begin; of other samples anything.
        velocity: `(sample, joint)` rad/s, likewise.
        period: s between samples.
        steps: of integration in this time.
        interpolated: whether commands go on a line to the next; else each holds until the next.
    """

    integral: Array
    reset: Mask
    first: Integers
    start: Array
    velocity: Array
    period: float
    steps: int
    interpolated: bool = False

    @property
    def end(self) -> Integers:
        """`(sample,)`, the sample before which its run ends."""
        edges = np.r_[np.flatnonzero(self.reset), self.samples]
        return np.repeat(edges[1:], np.diff(edges))

    @property
    def step(self) -> float:
        """s, of integration."""
        return self.period / self.steps

    @property
    def joints(self) -> int:
        return len(self.integral)

    @property
    def samples(self) -> int:
        return len(self.reset)

    def cut(self, samples: int) -> "Commands":
        """The first so many samples."""
        return self._replace(
            integral=self.integral[:, : samples * self.steps + 1],
            reset=self.reset[:samples],
            first=self.first[:samples],
            start=self.start[:samples],
            velocity=self.velocity[:samples],
        )


def hold_commands(
    command: Array,
    run: Integers,
    period: float,
    start: Array,
    velocity: Array | None = None,
    interpolated: bool = False,
    longest: float = LONGEST_STEP,
) -> Commands:
    """The commands of samples on an even grid.

    Args:
        command: `(sample, joint)` rad.
        run: `(sample,)`, which changes where a run begins.
        period: s between samples.
        start: `(sample, joint)` rad, of which the first of each run counts.
        velocity: `(sample, joint)` rad/s; zero where not given.
        interpolated: whether commands go on a line to the next; else each holds until the next.
        longest: s, of an integration step.
    """
    reset = np.r_[True, np.diff(run) != 0]
    first = np.maximum.accumulate(np.where(reset, np.arange(len(run)), 0))
    steps = max(int(np.ceil(period / longest - 1e-9)), 1)
    integral = _integrate(command.T, reset, period, steps, interpolated)
    v = np.zeros_like(command) if velocity is None else velocity
    return Commands(integral, reset, first, np.asarray(start, float), v, period, steps, interpolated)


def _integrate(command: Array, reset: Mask, period: float, steps: int, interpolated: bool) -> Array:
    """`(lane, sample · steps + 1)` rad·s, the integral of commands `(lane, sample)` rad; as of `Commands`."""
    following = np.hstack([command[:, 1:], command[:, -1:]])
    last = np.r_[reset[1:], True]
    rise = np.where(last | (not interpolated), 0.0, following - command)
    middle = (np.arange(steps) + 0.5) / steps
    areas = (command[..., None] + rise[..., None] * middle) * (period / steps)
    integral = np.zeros((len(command), command.shape[1] * steps + 1))
    np.cumsum(areas.reshape(len(command), -1), axis=1, out=integral[:, 1:])
    return integral


def read_out(position: Any, servo: Servo) -> Any:
    """What encoders show `(…, lane)` rad of joints, behind their play, at positions of that shape."""
    xp = jnp if isinstance(position, jax.Array) else np
    wave = servo.sine * xp.sin(position) + servo.cosine * xp.cos(position)
    return position * (1 + servo.scale) + servo.offset + wave


def invert_read_out(readout: Any, servo: Servo) -> Any:
    """The positions `(…, lane)` rad of joints of which encoders show so much."""
    position = readout
    for _ in range(_INVERTED):
        position = position + (readout - read_out(position, servo)) / (1 + servo.scale)
    return position


@final
class Rolled(NamedTuple):
    """A rollout.

    Attributes:
        readout: `(lane, sample)` rad.
        position, velocity, acceleration: `(lane, sample · steps)` rad, rad/s, rad/s², true ones at every step; empty
            where they were not asked for.
    """

    readout: Array
    position: Array
    velocity: Array
    acceleration: Array


@final
class Coupling(NamedTuple):
    """How the joints of one arm load each other while they accelerate otherwise than along the motion of a load.

    Attributes:
        matrix: `(sample, joint, joint)` kg·m², the mass matrix less its diagonal.
        acceleration: `(joint, sample · steps)` rad/s², along that motion.
    """

    matrix: Array
    acceleration: Array


def roll(
    servo: Servo,
    commands: Commands,
    joints: Integers,
    load: Array,
    mass: Array,
    columns: Integers | None = None,
    extra: Array | None = None,
    weight: Array | None = None,
    fine: bool = False,
    coupling: Coupling | None = None,
) -> Rolled:
    """Rolls lanes out.

    Args:
        servo: each `(lane,)`.
        commands: of all joints.
        joints: `(lane,)`, of which joint each lane is, from 0.
        load: `(column, sample · steps)` Nm, L.
        mass: likewise, kg·m², M.
        columns: `(lane,)`, which load and mass each lane has; those of its joint where not given.
        extra: `(lane, channel, sample)`, what is added by `CHANNELS`, torques on lines from sample to sample; nothing
            where not given.
        weight: `(column, sample)` Nm, what L is at rest where runs begin; that along the motion where not given.
        fine: whether to give positions and their derivatives at every step as well.
        coupling: of lanes that are all joints of one arm; none where not given.
    """
    lanes = len(joints)
    columns = joints if columns is None else columns
    size = lanes
    if coupling is None:
        size = next((size for size in _LANES if size >= lanes), -(-lanes // _FURTHER_LANES) * _FURTHER_LANES)
    index = np.minimum(np.arange(size), lanes - 1)
    filled_servo = Servo(*(np.asarray(field, float)[index] for field in servo))
    samples = commands.samples
    held = filled_size(samples, _LEAST_SAMPLES)
    begins = np.flatnonzero(commands.reset)
    runs = filled_size(len(begins))

    def by_step(values: Array) -> Array:
        """`(step, joint)` of values `(joint, step)`."""
        return filled(values.T, held * commands.steps + 1, _filled_joints(len(values)))

    start = commands.start[begins][:, joints[index]]
    velocity = commands.velocity[begins][:, joints[index]]
    weights = np.asarray(load)[:, :: commands.steps].T if weight is None else np.asarray(weight).T
    integral = commands.integral
    rows = joints[index]
    more = np.zeros((samples, 2, size))
    shift = np.zeros((lanes, 1))
    if extra is not None:
        more = np.transpose(extra[index, :COMMAND], (2, 1, 0))
        shift = extra[:, READ_OUT]
        start = start - shift[index][:, begins].T
        if extra[:, COMMAND].any():
            among = commands.reset, commands.period, commands.steps, commands.interpolated
            integral = (integral[joints] + _integrate(extra[:, COMMAND], *among))[index]
            rows = np.arange(size)
    by_joints = np.zeros((held, 0, 0)), np.zeros((held * commands.steps + 1, 0))
    if coupling is not None:
        by_joints = filled(coupling.matrix, held), by_step(np.asarray(coupling.acceleration))[:, :size]
    readout, states = _roll(
        filled_servo,
        by_step(integral),
        filled(begins, runs),
        filled(np.cumsum(commands.reset) - 1, held),
        filled(commands.end, held),
        filled(start, runs),
        filled(velocity, runs),
        by_step(np.asarray(load)),
        by_step(np.asarray(mass)),
        filled(weights[begins], runs, _filled_joints(weights.shape[1])),
        filled(more, held),
        by_joints,
        rows,
        columns[index],
        commands.period,
        samples,
        commands.steps,
        fine,
    )
    shown = np.asarray(readout).T[:lanes, :samples] + shift
    if not fine:
        return Rolled(shown, *(np.zeros((lanes, 0)),) * 3)
    wide = (np.asarray(state)[:samples].reshape(-1, size).T[:lanes] for state in states)
    return Rolled(shown, *wide)


def _filled_joints(joints: int) -> int:
    """The number of joints that is compiled for."""
    return -(-joints // _JOINTS) * _JOINTS


class _LaneState(NamedTuple):
    """The state of each lane, between two steps.

    Attributes:
        q: rad, at the step.
        v: rad/s, half a step before.
        a: rad/s², of the step before.
        arrived: rad, the command that has arrived, half a step before.
        low: rad, the filtered command, likewise.
        limited: rad, after the rate limit, likewise.
        summed: rad·s, ∫e.
        error: rad, e of the step before.
        y: rad, the read-out.
        load: Nm, L of this step along the motion that is given.
        before: Nm, L of the step before, likewise.
        strayed: rad/s², the acceleration of the step before less that along the motion that is given.
    """

    q: Any
    v: Any
    a: Any
    arrived: Any
    low: Any
    limited: Any
    summed: Any
    error: Any
    y: Any
    load: Any
    before: Any
    strayed: Any


class _Joint(NamedTuple):
    """A joint during one step, with a force that is constant; each `(lane,)`.

    Attributes:
        mass: kg·m², that moves.
        force: Nm, at rest and without friction.
        drag: Nm·s/rad, by which the force falls with speed.
        carried: Nm·s/rad, of the velocity before.
        resisted: Nm·s/rad, of the velocity after.
        grip: kg·m², G.
    """

    mass: Any
    force: Any
    drag: Any
    carried: Any
    resisted: Any
    grip: Any

    def gripped(self, v: Any) -> Any:
        """Nm, the friction of a joint that sticks, at a velocity."""
        share = self.grip / (self.mass + self.grip)
        return share * (self.force + (self.mass * RETURN - self.drag) * v)

    def slid(self, v: Any, friction: Any) -> Any:
        """rad/s after a whole step of sliding, from a velocity, against a friction with its sign."""
        return (self.carried * v + self.force - friction) / self.resisted

    def step(self, v: Any, friction: Any, h: Any, later: Any, sooner: Any, afterwards: Any) -> Any:
        """rad/s after a step of h s, from a velocity, with at most so much friction in Nm.

        A joint slides, sticks, and slides on: the instants between these lie anywhere in the step. `sooner` and
        `afterwards`, in Nm, add to the force before and after a switch of the command, whose mean is zero; `later` is
        the share of the step after it.
        """
        is_heavy = self.mass * RETURN - self.drag > self.drag
        switches = (sooner != afterwards) & is_heavy & (friction > 0)
        early = jnp.where(switches, 1 - later, 0.0)
        before = self._replace(force=self.force + jnp.where(switches, sooner, 0.0))
        after = self._replace(force=self.force + jnp.where(switches, afterwards, 0.0))
        at_switch = jax.lax.cond(
            jnp.any(switches), lambda: before._moved(v, v, early, friction, h, switches), lambda: v
        )
        v_new = after._moved(v, at_switch, 1 - early, friction, h, is_heavy)
        is_light = ~is_heavy & (friction > 0)
        return jax.lax.cond(
            jnp.any(is_light), lambda: jnp.where(is_light, self._halted(v, friction, h), v_new), lambda: v_new
        )

    def _moved(self, begun: Any, v: Any, share: Any, friction: Any, h: Any, gripping: Any) -> Any:
        """rad/s after a share of a step, from a velocity, of lanes that friction may hold.

        A joint that slides changes its velocity evenly, as from the one at which the step has begun: two shares in
        which it slides are then a whole step of sliding under the mean force.
        """
        rise = self.mass * RETURN - self.drag
        wide = friction * (1 + self.mass / self.grip)
        gripped = rise * v + self.force
        free = v + share * (self.slid(begun, jnp.where(gripped > 0, friction, -friction)) - begun)
        after = rise * free + self.force
        slides = (
            ~gripping | (friction <= 0) | ((gripped > wide) & (after > wide)) | ((gripped < -wide) & (after < -wide))
        )
        return jax.lax.cond(
            jnp.any(~slides),
            lambda: jnp.where(slides, free, self._caught(v, free, share, friction, h)),
            lambda: free,
        )

    def _caught(self, v: Any, free: Any, share: Any, friction: Any, h: Any) -> Any:
        """rad/s after a share of a step in which friction holds the joint at some time."""
        rise = jnp.maximum(self.mass * RETURN - self.drag, 1e-12)
        wide = friction * (1 + self.mass / self.grip)
        top = (wide - self.force) / rise  # joints that are faster slide, slower ones stick
        bottom = (-wide - self.force) / rise
        entered = jnp.clip(v, bottom, top)
        slides = v != entered
        rest = share * jnp.where(slides, 1 - (v - entered) / jnp.where(slides & (v != free), v - free, 1.0), 1.0)
        held = self.grip * RETURN + self.drag
        final = self.force / held
        pace = held / (self.mass + self.grip) * h
        stuck = final + (entered - final) * jnp.exp(-pace * rest)
        left_at = jnp.clip(stuck, bottom, top)
        leaves = stuck != left_at
        ratio = (left_at - final) / jnp.where(leaves & (entered != final), entered - final, 1.0)
        spent = -jnp.log(jnp.where(leaves, jnp.clip(ratio, 1e-30, 1.0), 1.0)) / pace
        again = self.slid(left_at, jnp.where(stuck > left_at, friction, -friction))
        return jnp.where(leaves, left_at + jnp.maximum(rest - spent, 0.0) * (again - left_at), stuck)

    def _halted(self, v: Any, friction: Any, h: Any) -> Any:
        """rad/s after a step of a light joint, which its damping alone halts within about a step."""
        creeps = self.grip * (1 / h + RETURN)
        creep = (self.carried * v + self.force + self.grip / h * v) / (self.resisted + creeps)
        grip = creeps * creep - self.grip / h * v
        slid = self.slid(v, jnp.sign(grip) * friction)
        return jnp.where(jnp.abs(grip) < friction, creep, slid)


def _solve(A: Any, b: Any) -> Any:
    """x of A x = b, of a few equations with positive definite A: a step takes a fifth of the time that LAPACK does."""
    rows = jnp.concatenate([A, b[:, None]], 1)
    for k in range(len(b)):
        pivot = rows[k] / rows[k, k]
        is_pivot = jnp.arange(len(b))[:, None] == k
        rows = jnp.where(is_pivot, pivot, rows - rows[:, k, None] * pivot)
        rows = jax.lax.optimization_barrier(rows)  # else the compiler computes each entry from all before it
    return rows[:, -1]


@partial(jax.jit, static_argnames=("steps", "fine"))
def _roll(
    p: Servo,
    integral: Any,
    begins: Any,
    run: Any,
    end: Any,
    start: Any,
    start_velocity: Any,
    load: Any,
    mass: Any,
    weight: Any,
    extra: Any,
    coupling: Any,
    rows: Any,
    columns: Any,
    period: Any,
    samples: Any,
    steps: int,
    fine: bool,
) -> Any:
    """The read-out `(sample, lane)`, and three `(sample, step, lane)` of the motion, of the first so many samples.

    Args:
        p: servos, each `(lane,)`.
        integral: `(step, row)` rad·s.
        begins: `(run,)` the sample at which each begins.
        run: `(sample,)` the run of each.
        end: `(sample,)` the sample before which its run ends.
        start: `(run, lane)` rad.
        start_velocity: `(run, lane)` rad/s.
        load: `(step, column)` Nm.
        mass: `(step, column)` kg·m².
        weight: `(run, column)` Nm.
        extra: `(sample, channel, lane)` Nm, of the first two of `CHANNELS`.
        coupling: matrix `(sample, joint, joint)` and acceleration `(step, joint)`, as of `Coupling`; empty without.
        rows: `(lane,)` of `integral`.
        columns: `(lane,)` of loads and masses.
        period: s between samples.
        samples: how many there are.
        steps: of integration in this time.
        fine: whether to give the motion; else it is empty.
    """
    h = period / steps
    decay = jnp.exp(-h / jnp.maximum(p.time_constant, _LEAST_TIME))
    mean_decay = jnp.maximum(p.time_constant, _LEAST_TIME) / h * (1 - decay)
    filtered = p.time_constant > _LEAST_TIME
    most_rise = p.rate_limit * h
    D = p.damping + p.viscous
    limits = jnp.any(p.rate_limit < UNLIMITED)
    bends = jnp.any(p.stribeck > 0) | jnp.any(p.load_friction > 0)
    others_act = coupling[0].size > 0

    def command_at(late: Any, begin: Any, finish: Any) -> Any:
        """∫u at a time in steps, and u·h there; before a run its first command holds, and after it the last."""
        i = jnp.clip(jnp.floor(late).astype(int), begin, finish - 1)
        below = integral[i, rows]
        more = integral[i + 1, rows] - below
        return below + (late - i) * more, more

    def settled_accelerations(accelerated: Any, L: Any, load: Any, m: Any, others: Any, given: Any) -> Any:
        """Accelerations under the loads that joints exert on each other with them, from a guess of these."""

        def follow(L: Any) -> Any:
            a, per_load = jax.jvp(accelerated, (L,), (jnp.ones_like(L),))
            return L, a, per_load, load + others @ (a - given) - L

        def is_unequal(carried: Any) -> Any:
            count, (L, _, _, left) = carried
            return (count < _NEWTON_STEPS) & jnp.any(jnp.abs(left) > _EQUAL_LOADS * (1 + jnp.abs(L)))

        def improve(carried: Any) -> Any:
            count, (L, _, per_load, left) = carried
            answering = 1 / jnp.clip(-per_load, 1 / _HEAVIEST, 1 / jnp.maximum(m, 1 / _HEAVIEST))
            share = jnp.where(count < _WHOLE_STEPS, 1.0, 0.5)
            return count + 1, follow(L + share * answering * _solve(others + jnp.diag(answering), left))

        _, (_, a, _, _) = jax.lax.while_loop(is_unequal, improve, (0, follow(L)))
        return a

    def advance(state: Any, inputs: Any) -> Any:
        u, arriving, following_load, M, x, rubbing, given, others = inputs
        coulomb = jnp.maximum(p.coulomb + rubbing, 0.0)
        low = jnp.where(filtered, u + (state.low - u) * decay, arriving)
        mean_low = u + (state.low - u) * mean_decay
        # a held command switches at most once in a step: after the share of it by which its mean is reached
        rise = arriving - state.arrived
        early = jnp.where(rise == 0, 1.0, jnp.clip((arriving - u) / jnp.where(rise == 0, 1.0, rise), 0.0, 1.0))
        early = jnp.where(filtered, 1.0, early)
        later = 1 - early

        def rate_limited() -> Any:
            first_wanted = jnp.where(filtered, low, state.arrived) - state.limited
            first_change = jnp.clip(first_wanted, -most_rise * early, most_rise * early)
            second_wanted = low - state.limited - first_change
            second_change = jnp.clip(second_wanted, -most_rise * later, most_rise * later)
            mean_limited = (
                state.limited
                + first_change * (1 - 0.5 * jnp.abs(first_change) / most_rise)
                + second_change * (later - 0.5 * jnp.abs(second_change) / most_rise)
            )
            # a limit that is not reached leaves the mean as it is
            passes = (first_change == first_wanted) & (second_change == second_wanted)
            limited = state.limited + first_change + second_change
            return limited, jnp.where(passes, mean_low, mean_limited), passes

        def unlimited() -> Any:
            return low, mean_low, jnp.ones(low.shape, bool)

        limited, target, passes = jax.lax.cond(limits, rate_limited, unlimited)
        change = limited - state.limited
        e = target - state.q
        dead = jnp.clip(e, -p.dead_band, p.dead_band)
        e = e - dead
        summed = state.summed + 0.5 * h * (e + state.error)
        pull = p.stiffness * e + p.integral * summed + p.feedforward * change / h
        side = jnp.sign(pull)
        v_here = state.v + 0.5 * h * state.a
        lost = p.torque_droop * v_here * side
        saturated = jnp.abs(pull) >= p.torque_limit * jnp.maximum(1 - lost, 0.0)
        drive = jnp.where(saturated, jnp.where(lost < 1, side * p.torque_limit, 0.0), pull)
        drag = D + jnp.where(saturated & (lost < 1), p.torque_limit * p.torque_droop, 0.0)
        yields = ~saturated & (jnp.abs(e) > 0)
        m = M + p.inertia + jnp.where(yields, 0.25 * h * h * p.stiffness, 0.0)
        m = jnp.maximum(m, h * drag / _MOST_HALTED)
        joint = _Joint(
            mass=m,
            force=drive - p.spring * state.q - p.spring_torque - x,
            drag=drag,
            carried=m / h - 0.5 * drag,
            resisted=m / h + 0.5 * drag + 1e-12,
            grip=p.grip,
        )
        # of a command that switches within the step: Nm in the share of it before, and in that after it, of mean zero
        switches = passes & yields & ~filtered & (rise != 0)
        jump = following_load - state.before
        sooner = jnp.where(switches, p.stiffness * (state.arrived - u) + later * jump, 0.0)
        afterwards = jnp.where(switches, p.stiffness * (arriving - u) - early * jump, 0.0)

        def bent_friction(L: Any, loaded: _Joint) -> Any:
            constant = coulomb + p.stribeck * jnp.exp(-((v_here / p.stribeck_speed) ** 2))
            before = constant + p.load_friction * jnp.abs(L + M * state.a)
            gripped = jnp.clip(loaded.gripped(state.v), -before, before)
            a = (loaded.force - drag * v_here - gripped) / jnp.maximum(m, 1e-12)
            share = M / jnp.maximum(m, 1e-12)
            sooner_load = jnp.abs(jnp.where(switches, state.before, L) + M * a + share * sooner)
            later_load = jnp.abs(jnp.where(switches, following_load, L) + M * a + share * afterwards)
            return constant + p.load_friction * (early * sooner_load + later * later_load)

        def accelerated(L: Any) -> Any:
            loaded = joint._replace(force=joint.force - L)
            friction = jax.lax.cond(bends, lambda: bent_friction(L, loaded), lambda: coulomb)
            return (loaded.step(state.v, friction, h, later, sooner, afterwards) - state.v) / h

        if others_act:
            a = settled_accelerations(accelerated, state.load + others @ state.strayed, state.load, m, others, given)
        else:
            a = accelerated(state.load)
        v = state.v + h * a
        q = state.q + h * v
        y = jnp.clip(state.y, q - p.backlash, q + p.backlash)
        strayed = a - given if others_act else state.strayed
        after = _LaneState(q, v, a, arriving, low, limited, summed, e, y, following_load, state.load, strayed)
        return after, (state.q, 0.5 * (v + state.v), a) if fine else ()

    def begin_run(by_step: Any, others: Any, begun: Any) -> _LaneState:
        """A run that begins with this sample, with the velocity half a step before."""
        q, v, carried, first_command, first_load = begun
        *_, x, rubbing, _ = (part[0] for part in by_step)
        error = first_command - q
        error = error - jnp.clip(error, -p.dead_band, p.dead_band)
        # an integral part has balanced the load, and drives a joint that rests until friction alone holds it back; what
        # the error exerts is balanced where friction is too weak to hold it
        balance = carried + p.spring * q + p.spring_torque + x - p.stiffness * error
        most = jnp.maximum(p.coulomb + rubbing, 0.0) + p.stribeck + p.load_friction * jnp.abs(carried)
        held = jnp.where(jnp.abs(p.stiffness * error) <= most, p.stiffness * error, 0.0)
        balance = balance + jnp.clip(held + p.integral * error * _RESTED, -most, most)
        summed = jnp.where(p.integral > 0, balance / jnp.where(p.integral > 0, p.integral, 1.0), 0.0)
        at_rest = first_command, first_command, first_command, summed, error
        fresh = _LaneState(q, v, zero, *at_rest, q, first_load, first_load, zero)
        after, _ = advance(fresh, (*(part[0] for part in by_step), others))
        return fresh._replace(v=v - 0.5 * h * after.a)

    def roll_sample(state: Any, inputs: Any) -> Any:
        by_step, others, begins_here, begun = inputs
        state = jax.lax.cond(begins_here, lambda: begin_run(by_step, others, begun), lambda: state)
        after, motion = jax.lax.scan(lambda state, here: advance(state, (*here, others)), state, by_step)
        return after, (state.y, motion)

    zero = jnp.zeros(rows.shape)
    places = invert_read_out(start, p)
    matrix, acceleration = coupling

    def roll_block(block: Any, carried: Any) -> Any:
        """The samples of a block; of the last one those that are too many repeat the last sample."""
        state, readout, motion = carried
        sample = jnp.minimum(block * _BLOCK + jnp.arange(_BLOCK), samples - 1)
        begin = begins[run[sample]] * steps
        finish = end[sample] * steps
        step = sample[:, None] * steps + jnp.arange(steps)
        first, last = begin[:, None, None], finish[:, None, None]
        middles = sample[:, None, None] * steps + jnp.arange(-1, steps)[:, None] + 0.5
        areas, held_areas = command_at(first + (middles - first) * (1 + p.clock_rate) - p.delay / h, first, last)
        u = jnp.diff(areas, axis=1) / h / (1 + p.clock_rate)
        following = jnp.minimum(step + 1, finish[:, None] - 1)
        share = (jnp.arange(steps) / steps)[:, None, None]
        of_next = extra[jnp.minimum(sample + 1, samples - 1)][:, None]
        forces = extra[sample][:, None] + share * (of_next - extra[sample][:, None]) + zero
        loads = load[step][..., columns]
        first_commands = (integral[(begin + 1)[:, None], rows] - integral[begin[:, None], rows]) / h
        begun = places[run[sample]], start_velocity[run[sample]], weight[run[sample]][:, columns], first_commands
        by_step = (
            *(u, held_areas[:, 1:] / h, load[following][..., columns], mass[step][..., columns]),
            *(forces[:, :, TORQUE], forces[:, :, FRICTION], acceleration[step]),
        )
        inputs = by_step, matrix[sample], begin == sample * steps, (*begun, loads[:, 0])
        state, (shown, moved) = jax.lax.scan(roll_sample, state, inputs)
        place = block * _BLOCK
        readout = jax.lax.dynamic_update_slice_in_dim(readout, read_out(shown, p), place, 0)
        updated = (jax.lax.dynamic_update_slice_in_dim(a, b, place, 0) for a, b in zip(motion, moved, strict=True))
        return state, readout, tuple(updated)

    state = _LaneState(*(zero,) * len(_LaneState._fields))
    shape = (len(run), steps, len(rows))
    motion = tuple(jnp.zeros(shape) for _ in range(3 if fine else 0))
    carried = state, jnp.zeros((len(run), len(rows))), motion
    _, readout, motion = jax.lax.fori_loop(0, -(-samples // _BLOCK), roll_block, carried)
    return readout, motion
