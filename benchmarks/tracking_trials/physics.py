"""How an arm follows its commands: rigid bodies, servos, dry friction and encoders in small steps, in NumPy.

Shares no code with the library. Many lanes are rolled out at once: a lane is a run of a motion with what is hidden in
one variant. A step is leapfrog: positions at its ends, velocities in its middle, damping half implicit. Dry friction
is the force of a step that stops each joint, clipped to what friction can do (projected Gauss–Seidel).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.concealed.chain import Array, rotation_from_vector
from benchmarks.tracking_trials.arms import Arm, Bodies, Dynamics
from benchmarks.tracking_trials.effects import NEVER, START, Hidden, Numbers, altered

STEP = 2.5e-4  # s
_RIGID = 1e-3  # s between masses and loads of the rigid bodies, which are extrapolated in between
LEAD = 1.0  # s that the first command is held before a run begins
_LONG_LEAD = 2.0  # s, with a servo that integrates, whose integral begins balanced
_SWEEPS, _SETTLED = 12, 1e-6
"""Of dry friction at most, and Nm by which its last sweep changes it."""
_SHAFT = 0.1  # of critical damping, of an elastic gear
_AMBIENT, _WARMER = 25.0, 10.0  # °C, and K in which families count
_ARM_WIDE = ("clock", "payload", "tilt_x", "tilt_y", "skipped", "rocking", "rocking_pulse", "rocking_way")


@dataclass(frozen=True, eq=False)
class Commands:
    """What is commanded in runs of one length."""

    period: float  # s
    u: Array  # `(run, sample, joint)` rad, held until the next
    begins: Array  # `(run,)` s of the recording at which each begins
    luck: Array  # `(run, sample)` in 0 … 1, by which a generator skips

    @property
    def runs(self) -> int:
        """How many."""
        return len(self.u)


@dataclass(frozen=True, eq=False)
class Setup:
    """An arm where it stands."""

    arm: Arm
    gravity: Array  # `(3,)` m/s² in the base's axes, as declared
    payload: float  # kg, as declared
    payload_center: Array  # `(3,)` m in the last frame
    warming: float  # K by which joints warm, with a time constant of `slow`
    sag: float  # share of a supply's voltage that sags, likewise
    slow: float  # s


class Rolled(NamedTuple):
    """What comes of variants."""

    readout: Array  # `(variant, run, sample, joint)` rad
    strongest: Array  # `(variant, joint)` Nm, the largest torque of each servo
    heaviest: Array  # `(variant, joint)` Nm, the largest load


def start_of(arm: Arm) -> Numbers:
    """The numbers of an arm in which nothing is hidden."""
    numbers = {name: np.full(arm.chain.dof, float(value)) for name, value in START.items()}
    joints = {
        name: getattr(arm.joints, name).copy() for name in ("stiffness", "damping", "rotor", "viscous", "coulomb")
    }
    return numbers | joints


def roll(setup: Setup, variants: Sequence[tuple[Hidden, ...]], commands: Commands, step: float = STEP) -> Rolled:
    """Rolls variants out, each from rest under the first command of each run."""
    start = start_of(setup.arm)
    each = [altered(start, hidden) for hidden in variants]
    runs = commands.runs
    stacked = {name: np.repeat(np.stack([numbers[name] for numbers in each], 1), runs, 1) for name in START}
    arm_wide = {name: stacked[name][0] for name in _ARM_WIDE}
    return _Rollout(setup, stacked, arm_wide, commands, step).run(len(variants))


class _Rollout:
    """Lanes on their way; a lane is a variant in a run, the run running fastest."""

    def __init__(self, setup: Setup, n: Numbers, wide: Numbers, commands: Commands, step: float):
        self.setup = setup
        self.n = n
        self.commands = commands
        self.step = step
        self.dof, self.lanes = n["stiffness"].shape
        self.every = round(_RIGID / step)
        lead = _LONG_LEAD if n["integral"].any() else LEAD
        self.per_sample = round(commands.period / step)
        self.lead = round(lead / step)
        self.steps = self.lead + (commands.u.shape[1] - 1) * self.per_sample + 1
        variants = self.lanes // commands.runs
        self.begins = np.tile(commands.begins, variants)
        shifted = np.stack([n["center_x"], n["center_y"], n["center_z"]])
        payload = setup.payload + wide["payload"]
        self.dynamics = Dynamics(Bodies.of(setup.arm, payload, setup.payload_center, n["link_mass"], shifted))
        tilts = np.stack([wide["tilt_x"], wide["tilt_y"], np.zeros(self.lanes)], 1)
        self.gravity = np.einsum("lji,j->il", rotation_from_vector(tilts), setup.gravity)
        self.rocking = wide["rocking"]
        self.pulse = wide["rocking_pulse"]
        self.way = np.stack([np.cos(wide["rocking_way"]), np.sin(wide["rocking_way"]), np.zeros(self.lanes)])
        self.columns, self.place = _processed(n, wide, commands, step, self.lead, self.steps)
        self.present = {name for name, values in n.items() if np.any(values != START[name])}

    def time(self, m: int) -> Array:
        """`(lane,)` s of the recording at a step."""
        return self.begins + (m - self.lead) * self.step

    def pulled(self, m: int) -> Array:
        """`(3, lane)` m/s²: gravity, less what the base accelerates by."""
        if not self.rocking.any():
            return self.gravity
        return self.gravity - self.way * (self.rocking * np.sin(self.pulse * self.time(m)))

    def aged(self, m: int) -> Array:
        """`(lane,)` in 0 … 1, how much of a slow change is over."""
        return 1 - np.exp(-np.maximum(self.time(m), 0.0) / self.setup.slow)

    def run(self, variants: int) -> Rolled:
        """All steps."""
        n, h, present = self.n, self.step, self.present
        shape = (self.dof, self.lanes)
        q = self.columns[0][self.place].copy()
        v = np.zeros(shape)
        a = np.zeros(shape)
        y = q.copy()
        friction = np.zeros(shape)
        summed = np.zeros(shape)
        error = np.zeros(shape)
        u_before = q.copy()
        flexible = n["compliance"] > 0
        bends = bool(flexible.any())
        motor = q.copy()
        motor_rate = np.zeros(shape)
        stiff_gear = np.where(flexible, n["stiffness"] / np.maximum(n["compliance"], 1e-12), 0.0)
        shaft = 2 * _SHAFT * np.sqrt(stiff_gear * n["rotor"])
        rotor = np.where(flexible, 0.0, n["rotor"])
        damping = np.where(flexible, shaft, n["damping"]) + n["viscous"]
        limited = bool(np.any(n["limit"] < NEVER))
        readout = np.empty((self.commands.u.shape[1], *shape))
        strongest = np.zeros(shape)
        heaviest = np.zeros(shape)
        matrix_before = bias_before = None
        matrix = inverse = bias = mean_slope = diagonal = np.zeros(0)
        for m in range(self.steps):
            phase = m % self.every
            if phase == 0:
                matrix, bias = self.dynamics.terms(q, v + 0.5 * h * a, self.pulled(m))
                if matrix_before is None or bias_before is None:
                    matrix_before, bias_before = matrix, bias
                # the middle of the steps until the next ones
                ahead = 0.5 * (self.every - 1) / self.every
                full = matrix + ahead * (matrix - matrix_before)
                mean_slope = (bias - bias_before) / self.every
                matrix_before, bias_before = matrix, bias
                moved = rotor + 0.5 * h * damping
                if "warming" in present:
                    warm = n["warming"] * (self.setup.warming / _WARMER) * self.aged(m)
                    moved = moved - 0.5 * h * warm
                with_rotors = full.copy()
                index = np.arange(self.dof)
                with_rotors[index, index] += moved
                inverse = np.moveaxis(np.linalg.inv(np.moveaxis(with_rotors, 2, 0)), 0, 2)
                diagonal = np.einsum("iil->il", inverse)
                matrix = full
            load = bias + phase * mean_slope
            if m == 0 and "integral" in present:
                # it has balanced the weight before the first command
                weight = load + n["spring"] * q + n["spring_torque"]
                summed = np.where(n["integral"] > 0, weight / np.maximum(n["integral"], 1e-12), 0.0)
            u = self.columns[m][self.place]
            row, rest = divmod(m - self.lead, self.per_sample)
            if rest == 0 and row >= 0:
                wave = n["sine"] * np.sin(y) + n["cosine"] * np.cos(y)
                readout[row] = y * (1 + n["scale"]) + n["offset"] + wave

            e = u - q
            if "dead" in present:
                e = e - np.clip(e, -n["dead"], n["dead"])
            pull = n["stiffness"] * e
            if "sagging" in present:
                pull = pull * (1 - n["sagging"] * self.setup.sag * self.aged(m))
            if "integral" in present:
                summed += 0.5 * h * (e + error)
                error = e
                pull = pull + n["integral"] * summed
            if "feedforward" in present:
                pull = pull + n["feedforward"] * (u - u_before) / h
                u_before = u
            if limited:
                # towards its motion a joint that droops is given less
                limit = n["limit"] * np.maximum(1 - n["droop"] * np.sign(pull) * (v + 0.5 * h * a), 0.0)
                pull = np.clip(pull, -limit, limit)
            strongest = np.maximum(strongest, np.abs(pull))
            heaviest = np.maximum(heaviest, np.abs(load))
            drive = pull
            if bends:
                gear = stiff_gear * (motor - q) + shaft * motor_rate
                drive = np.where(flexible, gear, pull)
                twist = stiff_gear * (motor - q) + shaft * (motor_rate - v)
                resisted = n["rotor"] / h + 0.5 * n["damping"]
                rate = (motor_rate * (n["rotor"] / h - 0.5 * n["damping"]) + pull - twist) / resisted
                motor_rate = np.where(flexible, rate, 0.0)
                motor = np.where(flexible, motor + h * motor_rate, q)
            force = drive - load - damping * v
            if "spring" in present:
                force = force - n["spring"] * q - n["spring_torque"]
            if "warming" in present:
                force = force + n["warming"] * (self.setup.warming / _WARMER) * self.aged(m) * v
            if "ripple" in present:
                force = force - n["ripple"] * np.sin(n["ripple_order"] * q + n["ripple_phase"])
            if "cable" in present:
                by = np.maximum(n["cable_by"].astype(int) - 1, 0)
                across = np.take_along_axis(q, by, 0) - n["cable_other"]
                force = force - n["cable"] * (q - n["cable_centre"]) * across
            dry = n["coulomb"]
            rigid = load
            if present & {"load_friction", "load_play"}:
                rigid = np.abs(load + np.einsum("ijl,jl->il", matrix, a))
                dry = dry + n["load_friction"] * rigid
            if "stribeck" in present:
                dry = dry + n["stribeck"] * np.exp(-((v / n["stribeck_speed"]) ** 2))
            if "sticky" in present:
                dry = dry + n["sticky"] * np.exp(-0.5 * ((q - n["sticky_centre"]) / n["sticky_width"]) ** 2)
            free = v + h * np.einsum("ijl,jl->il", inverse, force)
            friction, faster = _stop(free, inverse, diagonal, friction, dry, dry + n["one_way"], h)
            a = (faster - v) / h
            v = faster
            q = q + h * v
            width = n["play"] + n["load_play"] * rigid if "load_play" in present else n["play"]
            y = np.minimum(np.maximum(y, q - width), q + width)
        shown = readout.reshape(len(readout), self.dof, variants, self.commands.runs)
        largest = (each.reshape(self.dof, variants, -1).max(2).T for each in (strongest, heaviest))
        return Rolled(np.moveaxis(shown, (0, 1), (2, 3)), *largest)


def _stop(
    free: Array, inverse: Array, diagonal: Array, friction: Array, least: Array, most: Array, h: float
) -> tuple[Array, Array]:
    """Dry friction of a step, and velocities with it, `(joint, lane)` Nm and rad/s.

    Args:
        free: velocities without it.
        inverse: `(joint, joint, lane)` of the mass matrix.
        diagonal: of it.
        friction: of the step before, where the sweeps begin.
        least: Nm, what friction can do at most against a joint that moves backwards.
        most: likewise forwards.
        h: s, of a step.
    """
    lowest = -least
    friction = np.minimum(np.maximum(friction, lowest), most)
    v = free - h * np.einsum("ijl,jl->il", inverse, friction)
    gain = 1 / (h * diagonal)
    pushed = h * inverse
    more = np.empty_like(friction)
    for _ in range(_SWEEPS):
        for i in range(len(free)):
            change = more[i]
            np.multiply(v[i], gain[i], out=change)
            change += friction[i]
            np.maximum(change, lowest[i], out=change)
            np.minimum(change, most[i], out=change)
            change -= friction[i]
            friction[i] += change
            v -= pushed[:, i] * change
        if max(more.max(), -more.min()) <= _SETTLED:
            break
    return friction, v


def _processed(
    n: Numbers, wide: Numbers, commands: Commands, step: float, lead: int, steps: int
) -> tuple[Array, Array]:
    """What servos see of their commands: `(step, column)` rad, and the column of each `(joint, lane)`.

    A delay, a clock, a low pass and a limit of the rate, in this order. The value of a step is the mean over it, from
    half a step before to half a step after.
    """
    dof, lanes = n["delay"].shape
    keys: dict[tuple[float, ...], int] = {}
    place = np.empty((dof, lanes), int)
    for joint in range(dof):
        for lane in range(lanes):
            own = (n[name][joint, lane] for name in ("delay", "filter", "rate"))
            key = (joint, lane % commands.runs, wide["clock"][lane], wide["skipped"][lane], *own)
            place[joint, lane] = keys.setdefault(tuple(float(value) for value in key), len(keys))
    per_sample = round(commands.period / step)
    columns = np.empty((steps, len(keys)))
    ends = np.empty((steps, len(keys)))
    at = np.arange(steps) - lead
    for (joint, run, clock, skipped, delay, _, _), k in keys.items():
        u = _skip(commands.u[int(run), :, int(joint)], commands.luck[int(run)], skipped)
        integral = np.concatenate([[0.0], np.cumsum(u)]) * per_sample
        knots = np.arange(len(u) + 1.0) * per_sample

        def area(x: Array, integral: Array = integral, knots: Array = knots, u: Array = u) -> Array:
            """∫u in steps; the first command holds before, and the last behind."""
            inside = np.interp(x, knots, integral)
            return inside + np.minimum(x, 0.0) * u[0] + np.maximum(x - knots[-1], 0.0) * u[-1]

        middle = at * (1 + clock) - delay / step
        half = 0.5 * (1 + clock)
        columns[:, k] = (area(middle + half) - area(middle - half)) / (2 * half)
        ends[:, k] = u[np.clip(np.floor((middle + half) / per_sample), 0, len(u) - 1).astype(int)]
    slow = np.array([key[5] for key in keys])
    rate = np.array([key[6] for key in keys])
    if np.any(slow > 0) or np.any(rate < NEVER):
        _follow(columns, ends, slow, rate, step)
    return columns, place


def _skip(u: Array, luck: Array, share: float) -> Array:
    """Commands of which a share is not sent: the one before holds on."""
    sent = np.where(luck < share, 0, np.arange(len(u)))
    return u[np.maximum.accumulate(sent)]


def _follow(columns: Array, ends: Array, slow: Array, rate: Array, step: float) -> None:
    """A low pass of so many s, and a limit of so many rad/s, in place.

    Args:
        columns: `(step, column)` rad, means over the steps.
        ends: likewise, where the steps end: a held command that switches within a step is one of two values there.
        slow: `(column,)` s.
        rate: `(column,)` rad/s.
        step: s.
    """
    passed = slow > 0
    decay = np.where(passed, np.exp(-step / np.maximum(slow, 1e-12)), 0.0)
    most = rate * step
    low = columns[0].copy()
    shown = columns[0].copy()
    came = columns[0].copy()
    # the mean of a step is that of its two ends, half a step before and half a step after
    weight = np.where(passed, np.maximum(slow, 1e-12) / step * (1 - decay), 0.0)
    for m in range(len(columns)):
        u = columns[m]
        mean = u + (low - u) * weight
        low = np.where(passed, u + (low - u) * decay, ends[m])
        apart = ends[m] - came
        # the share of the step in which the command before holds
        still = np.where(np.abs(apart) > 1e-15, (ends[m] - u) / np.where(np.abs(apart) > 1e-15, apart, 1.0), 0.0)
        still = np.where(passed, 0.0, np.clip(still, 0.0, 1.0))
        middle = shown + np.clip(came - shown, -most * still, most * still)
        end = middle + np.clip(low - middle, -most * (1 - still), most * (1 - still))
        # a limit that is not reached leaves the mean as it is
        free = (end == low) & ((middle == came) | (still == 0))
        limited = 0.5 * (still * (shown + middle) + (1 - still) * (middle + end))
        columns[m] = np.where(free, mean, limited)
        shown = end
        came = ends[m]
