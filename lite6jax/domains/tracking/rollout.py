"""Rollouts of position-servoed joints from their commands alone.

Of joint i with command u, true position q and read-out y:

    A q̈ + M q̈ + L + b q̇ + (c + s·exp(−(q̇/v)²) + μ|τ|)·sign q̇ + k q + x  =  sat(kp·e + ki∫e + kf·u̇_c) − kd q̇
    e = dead band(u_c − q),  u_c = rate limit(low pass(u(t(1 + r) − d))),  y = play(q)

M is the joint's own inertia, and L what the rest of the arm and gravity exert, along a motion that is given: joints are
decoupled, and `lite6jax.domains.tracking.coupling` iterates L. A lane is one joint with one set of numbers.

A step is leapfrog, with damping half implicit and the command averaged over the step. Where the inertia is less than
about 4h²·kp it passes into implicit Euler. Coulomb friction F is a proximal map: the friction of a step can stop the
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
_LANES = (6, 24, 144)
"""Numbers of lanes that are compiled for; others are filled up."""


@final
class Commands(NamedTuple):
    """Commands on the even grid of a rollout, run after run.

    Attributes:
        integral: `(joint, sample · steps + 1)` rad·s, ∫u dt at every step.
        reset: `(sample,)` bool, where a run begins.
        first: `(sample,)` int, the sample at which its run begins.
        start: `(sample, joint)` rad, positions from which runs begin; of other samples anything.
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
            **{name: getattr(self, name)[:samples] for name in ("reset", "first", "start", "velocity")},
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
        low: rad, the filtered command, half a step before.
        limited: rad, after the rate limit, likewise.
        summed: rad·s, ∫e.
        error: rad, e of the step before.
        y: rad, the read-out.
    """

    q: Any
    v: Any
    a: Any
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
    last = integral.shape[1] - 1
    decay = jnp.exp(-h / jnp.maximum(p.time_constant, _LEAST_TIME))
    mean_decay = jnp.maximum(p.time_constant, _LEAST_TIME) / h * (1 - decay)
    D = p.damping + p.viscous
    flat = integral.ravel()
    row = joints * integral.shape[1]

    def area_at(s: Any, begin: Any, initial: Any) -> Any:
        """∫u up to time s in steps; before a run its first command holds."""
        x = jnp.clip(s, begin, last - 1e-9)
        i = jnp.floor(x).astype(int)
        below = flat[row + i]
        above = flat[row + jnp.minimum(i + 1, last)]
        return below + (x - i) * (above - below) + jnp.minimum(s - begin, 0.0) * h * initial

    def advance(state: Any, inputs: Any) -> Any:
        u, L, M, x = inputs
        low = u + (state.low - u) * decay
        mean_low = u + (state.low - u) * mean_decay
        change = jnp.clip(low - state.limited, -p.rate_limit * h, p.rate_limit * h)
        limited = state.limited + change
        is_limited = jnp.abs(low - state.limited) > p.rate_limit * h
        target = jnp.where(is_limited, state.limited + 0.5 * change, mean_low)
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
        return _LaneState(q, v, a, low, limited, summed, e, y), shown

    def sample(state: Any, inputs: Any) -> Any:
        u, L, M, x, following, here, q, v, first_command = inputs
        zero = jnp.zeros(row.shape)
        fresh = _LaneState(q, v, zero, first_command, first_command, zero, zero, q)
        share = (jnp.arange(steps) / steps)[:, None]
        between = x + share * (following - x) + zero
        begun, _ = advance(fresh, (u[0], L[0], M[0], between[0]))
        fresh = fresh._replace(v=v - 0.5 * h * begun.a)  # half a step before the run begins
        state = jax.tree.map(lambda new, old: jnp.where(here, new, old), fresh, state)
        wave = p.sine * jnp.sin(state.y) + p.cosine * jnp.cos(state.y)
        shown = state.y * (1 + p.scale) + p.offset + wave
        state, fine_states = jax.lax.scan(advance, state, (u, L, M, between))
        return state, (shown, fine_states)

    begin = (first * steps)[:, None, None]
    n = jnp.arange(len(reset))[:, None, None] * steps + jnp.arange(-1, steps)[None, :, None] + 0.5
    initial = (flat[row + begin + 1] - flat[row + begin]) / h
    areas = area_at(begin + (n - begin) * (1 + p.clock_rate) - p.delay / h, begin, initial)
    mean = jnp.diff(areas, axis=1) / h / (1 + p.clock_rate)
    after = jnp.concatenate([extra[1:], extra[-1:]])
    inputs = (mean, load[..., columns], mass[..., columns], extra, after, reset, start, start_velocity, initial[:, 0])
    zero = jnp.zeros(row.shape)
    state = _LaneState(*(zero,) * len(_LaneState._fields))
    _, (readout, states) = jax.lax.scan(sample, state, inputs)
    return readout, states
