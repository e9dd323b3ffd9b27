"""Rollouts of position-servoed joints from their commands alone.

Of joint i with command u, true position q and read-out y:

    A q̈ + M q̈ + L + b q̇ + (c + s·exp(−(q̇/v)²) + μ|τ|)·sign q̇ + k q + x  =  sat(kp·e + ki∫e + kf·u̇_c) − kd q̇
    e = dead band(u_c − q),  u_c = rate limit(low pass(u(t(1 + r) − d))),  y = play(q)

M is the joint's own inertia, and L what the rest of the arm and gravity exert, along a motion that is given: joints are
decoupled, and `lite6jax.domains.tracking.coupling` iterates L. A lane is one joint with one set of numbers.

A step is leapfrog, with damping half implicit and the command averaged over the step. A rate limit follows a command
that switches within the step from the instant of the switch on. Where the inertia is less than about 4h²·kp the step
passes into implicit Euler. Coulomb friction F is a proximal map: the friction of a step can stop the
joint, not reverse it. While |F| is less than Coulomb friction allows, the joint sticks as in MuJoCo: F = G·(q̈ + B·q̇),
with a grip G in kg·m² and B = `RETURN`. So it creeps under load, by load / (G·B).
"""

from functools import partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from lite6jax.effects.servo import Servo

Array = NDArray[np.floating]

LONGEST_STEP = 0.001
"""s, of an integration step: by half of it the rollouts of arms change by a few µrad."""
RETURN = 2 / (0.95 * 0.002)
"""1/s, B: 2 / (dmax · timeconst) of MuJoCo's `solreffriction` at its stiffest for a step of 1 ms."""
GRIP = 0.96 / (1 - 0.96)
"""Grip over the inertia of the links that a joint moves at its zero: d0 / (1 - d0) of MuJoCo's `solimpfriction`.

A diagnosis looks for the grip of its recording, beginning with this one: `problem.with_likely_grip`.
"""
_IMPLICIT = 4.0
"""h²·kp over the inertia of a joint at which a step is half leapfrog, half implicit Euler."""
_LEAST_TIME = 1e-9
"""s, of a low pass, below which it passes all."""
_INVERTED = 3
"""Iterations from a first read-out to where the joint is: each leaves at most a tenth of the error before it."""
_LANES = (6, 24, 144)
"""Numbers of lanes that are compiled for; others are filled up."""


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
    """

    integral: Array
    reset: NDArray[np.bool_]
    first: NDArray[np.integer]
    start: Array
    velocity: Array
    period: float
    steps: int

    @property
    def end(self) -> NDArray[np.integer]:
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
    run: NDArray[np.integer],
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
    following = np.vstack([command[1:], command[-1:]])
    last = np.r_[reset[1:], True]
    rise = np.where(last[:, None] | (not interpolated), 0.0, following - command)
    middle = (np.arange(steps) + 0.5) / steps
    held = command[:, None] + rise[:, None] * middle[:, None]
    areas = held.reshape(-1, command.shape[1]) * (period / steps)
    integral = np.vstack([np.zeros(command.shape[1]), np.cumsum(areas, 0)]).T
    v = np.zeros_like(command) if velocity is None else velocity
    return Commands(integral, reset, first, np.asarray(start, float), v, period, steps)


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


def roll(
    servo: Servo,
    commands: Commands,
    joints: NDArray[np.integer],
    load: Array,
    mass: Array,
    columns: NDArray[np.integer] | None = None,
    extra: Array | None = None,
    fine: bool = False,
) -> Rolled:
    """Rolls lanes out.

    Args:
        servo: each `(lane,)`.
        commands: of all joints.
        joints: `(lane,)`, of which joint each lane is, from 0.
        load: `(column, sample · steps)` Nm, L.
        mass: likewise, kg·m², M.
        columns: `(lane,)`, which load and mass each lane has; those of its joint where not given.
        extra: `(lane, sample)` Nm, x, on a line from sample to sample; zero where not given.
        fine: whether to give positions and their derivatives at every step as well.
    """
    lanes = len(joints)
    columns = joints if columns is None else columns
    size = next((size for size in _LANES if size >= lanes), -(-lanes // _LANES[-1]) * _LANES[-1])
    index = np.minimum(np.arange(size), lanes - 1)
    filled = Servo(*(np.asarray(field, float)[index] for field in servo))
    samples = commands.samples

    def by_sample(values: Array) -> Array:
        return np.ascontiguousarray(np.asarray(values).T.reshape(samples, commands.steps, -1))

    more = np.zeros((samples, 1)) if extra is None else np.ascontiguousarray(np.asarray(extra)[index].T)
    readout, states = _roll(
        filled,
        commands.integral,
        commands.reset,
        commands.first,
        commands.end,
        commands.start[:, joints[index]],
        commands.velocity[:, joints[index]],
        by_sample(load),
        by_sample(mass),
        more,
        joints[index],
        columns[index],
        commands.period,
        commands.steps,
        fine,
    )
    if not fine:
        return Rolled(np.asarray(readout).T[:lanes], *(np.zeros((lanes, 0)),) * 3)
    wide = (np.asarray(state).reshape(-1, size).T[:lanes] for state in states)
    return Rolled(np.asarray(readout).T[:lanes], *wide)


class _LaneState(NamedTuple):
    """Of each lane, between two steps.

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


@partial(jax.jit, static_argnames=("steps", "fine"))
def _roll(
    p: Servo,
    integral: Any,
    reset: Any,
    first: Any,
    end: Any,
    start: Any,
    start_velocity: Any,
    load: Any,
    mass: Any,
    extra: Any,
    joints: Any,
    columns: Any,
    period: Any,
    steps: int,
    fine: bool,
) -> Any:
    """As `roll`; the read-out `(sample, lane)`, and three `(sample, step, lane)`."""
    h = period / steps
    decay = jnp.exp(-h / jnp.maximum(p.time_constant, _LEAST_TIME))
    mean_decay = jnp.maximum(p.time_constant, _LEAST_TIME) / h * (1 - decay)
    filtered = p.time_constant > _LEAST_TIME
    most_rise = p.rate_limit * h
    D = p.damping + p.viscous
    flat = integral.ravel()
    row = joints * integral.shape[1]

    def command_at(s: Any) -> Any:
        """∫u up to time s in steps, and u·h there; before a run its first command holds, and after it the last."""
        i = jnp.clip(jnp.floor(s).astype(int), begin, finish - 1)
        below = flat[row + i]
        more = flat[row + i + 1] - below
        return below + (s - i) * more, more

    def advance(state: Any, inputs: Any) -> Any:
        u, arriving, L, M, x = inputs
        low = jnp.where(filtered, u + (state.low - u) * decay, arriving)
        mean_low = u + (state.low - u) * mean_decay
        # a held command switches at most once in a step: after the share of it by which its mean is reached
        rise = arriving - state.arrived
        early = jnp.where(rise == 0, 1.0, jnp.clip((arriving - u) / jnp.where(rise == 0, 1.0, rise), 0.0, 1.0))
        early = jnp.where(filtered, 1.0, early)
        later = 1 - early
        first_wanted = jnp.where(filtered, low, state.arrived) - state.limited
        first_change = jnp.clip(first_wanted, -most_rise * early, most_rise * early)
        second_wanted = low - state.limited - first_change
        second_change = jnp.clip(second_wanted, -most_rise * later, most_rise * later)
        mean_limited = (
            state.limited
            + first_change * (1 - 0.5 * jnp.abs(first_change) / most_rise)
            + second_change * (later - 0.5 * jnp.abs(second_change) / most_rise)
        )
        change = first_change + second_change
        limited = state.limited + change
        # a limit that is not reached leaves the mean as it is
        passes = (first_change == first_wanted) & (second_change == second_wanted)
        target = jnp.where(passes, mean_low, mean_limited)
        e = target - state.q
        dead = jnp.clip(e, -p.dead_band, p.dead_band)
        e = e - dead
        summed = state.summed + 0.5 * h * (e + state.error)
        pull = p.stiffness * e + p.integral * summed + p.feedforward * change / h
        most = p.torque_limit * jnp.maximum(1 - p.torque_droop * state.v * jnp.sign(pull), 0.0)
        drive = jnp.clip(pull, -most, most)
        free = (jnp.abs(pull) < most) & (jnp.abs(e) > 0)
        m = M + p.inertia
        late = 1 / (1 + (m / (_IMPLICIT * h * h * jnp.maximum(p.stiffness, 1e-9))) ** 2)
        friction = (
            p.coulomb
            + p.stribeck * jnp.exp(-((state.v / p.stribeck_speed) ** 2))
            + p.load_friction * jnp.abs(L + M * state.a)
        )
        spring = p.spring * state.q + p.spring_torque
        force = (m / h - 0.5 * (1 - late) * D) * state.v + drive - L - spring - x
        resisted = m / h + 0.5 * (1 + late) * D + jnp.where(free, late * h * p.stiffness, 0.0) + 1e-12
        held = p.grip * (1 / h + RETURN)
        creep = (force + p.grip / h * state.v) / (resisted + held)
        grip = held * creep - p.grip / h * state.v
        v = jnp.where(jnp.abs(grip) < friction, creep, (force - jnp.sign(grip) * friction) / resisted)
        a = (v - state.v) / h
        q = state.q + h * v
        y = jnp.clip(state.y, q - p.backlash, q + p.backlash)
        shown = (state.q, 0.5 * (v + state.v), a) if fine else ()
        return _LaneState(q, v, a, arriving, low, limited, summed, e, y), shown

    def sample(state: Any, inputs: Any) -> Any:
        u, arriving, L, M, x, following, here, q, v, first_command = inputs
        zero = jnp.zeros(row.shape)
        share = (jnp.arange(steps) / steps)[:, None]
        between = x + share * (following - x) + zero
        error = first_command - q
        error = error - jnp.clip(error, -p.dead_band, p.dead_band)
        # an integral part drives a joint that rests until friction alone holds it back
        balance = L[0] + p.spring * q + p.spring_torque + between[0] - p.stiffness * error
        balance = balance + jnp.sign(error) * (p.coulomb + p.stribeck + p.load_friction * jnp.abs(L[0]))
        summed = jnp.where(p.integral > 0, balance / jnp.where(p.integral > 0, p.integral, 1.0), 0.0)
        fresh = _LaneState(q, v, zero, first_command, first_command, first_command, summed, error, q)
        begun, _ = advance(fresh, (u[0], arriving[0], L[0], M[0], between[0]))
        fresh = fresh._replace(v=v - 0.5 * h * begun.a)  # half a step before the run begins
        state = jax.tree.map(lambda new, old: jnp.where(here, new, old), fresh, state)
        wave = p.sine * jnp.sin(state.y) + p.cosine * jnp.cos(state.y)
        shown = state.y * (1 + p.scale) + p.offset + wave
        state, fine_states = jax.lax.scan(advance, state, (u, arriving, L, M, between))
        return state, (shown, fine_states)

    begin = (first * steps)[:, None, None]
    finish = (end * steps)[:, None, None]
    n = jnp.arange(len(reset))[:, None, None] * steps + jnp.arange(-1, steps)[None, :, None] + 0.5
    initial = (flat[row + begin + 1] - flat[row + begin]) / h
    areas, held_areas = command_at(begin + (n - begin) * (1 + p.clock_rate) - p.delay / h)
    arriving = held_areas[:, 1:] / h
    mean = jnp.diff(areas, axis=1) / h / (1 + p.clock_rate)
    after = jnp.concatenate([extra[1:], extra[-1:]])
    true_start = start
    for _ in range(_INVERTED):
        wave = p.sine * jnp.sin(true_start) + p.cosine * jnp.cos(true_start)
        true_start = (start - p.offset - wave) / (1 + p.scale)
    loads = load[..., columns], mass[..., columns]
    begun = true_start, start_velocity, initial[:, 0]
    inputs = (mean, arriving, *loads, extra, after, reset, *begun)
    zero = jnp.zeros(row.shape)
    state = _LaneState(*(zero,) * len(_LaneState._fields))
    _, (readout, states) = jax.lax.scan(sample, state, inputs)
    return readout, states
