"""Commands among which a design of a log of commands chooses: short motions from rest to rest within limits.

Each is of one of `KINDS`, and each kind tells different effects apart: sums of sines, a sine of rising frequency
(chirp), reversals with rests, small steps, and far moves between postures of different load. With commands u in rad and
the period T of samples in s, |Δu| / T is within the limit of velocity and |Δ²u| / T² within that of acceleration.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lite6jax.array_types import Array
from lite6jax.design.candidates import all_pass, candidates, inside_limits
from lite6jax.design.motions import MotionRoom
from lite6jax.domains.tracking.coupling import Bodies
from lite6jax.errors import InputError

KINDS = ("slow sines", "fast sines", "chirp", "slow reversals", "reversals", "steps", "far moves")
POSTURES = 5
"""At which every kind of motion but far moves is tried."""
_FAR_MOVES = 6
_DRAWN = 400
"""Joint positions from which postures are chosen."""
_TOWARDS_MIDDLE = 0.7
"""Of a drawn position's distance from the middle of the range, so that there is room to move."""
_KEPT = 0.98
"""Of each limit, that commands use."""
_SLOW = (0.1, 1.0)
_FAST = (1.0, 6.0)
"""Hz, of sums of sines."""
_CHIRP = (0.3, 8.0)
"""Hz, from which and to which a chirp goes."""
_SINES = 4
_LARGEST_RATE = 0.1
"""Of the rate of samples, that no sine is faster than."""
_WIDEST = 0.6
"""rad, amplitude of sines about a posture."""
_RAMP = 0.2
"""Share of sines in which they grow, and in which they fade."""
_REVERSALS = {"slow reversals": (0.04, 0.05), "reversals": (0.12, 0.3)}
"""Half the way in rad, and the speed in rad/s or the share of the limit that is less."""
_STEP = 0.15
"""rad, of the largest step about a posture."""
_REST = 0.3
"""s, of every other rest in reversals, and of those after steps and moves."""
_CALM = 0.6
"""Of the limits of velocity and acceleration, for far moves and between motions."""
_REACH = 0.3
"""Share of a motion's time, in which the furthest move goes at full speed."""
_SMALLER = 3
"""Times that a motion is halved until the whole of it passes the filters."""


class CommandSegment(NamedTuple):
    """A part of a motion of commands, from rest to rest.

    Attributes:
        kind: of `KINDS`.
        position: `(sample, joint)` rad.
    """

    kind: str
    position: Array


def straight(
    places: Array, pauses: Sequence[float], velocity: Array, acceleration: Array, period: float, longest: float = np.inf
) -> Array:
    """The way through places on straight lines, from rest to rest at each, `(sample, joint)` rad.

    All joints move together; the speed is a trapezoid over time, or a triangle, that keeps the limits of all joints.

    Args:
        places: `(place, joint)` rad, with the start.
        pauses: s, of the rest after each move.
        velocity: `(joint,)` rad/s.
        acceleration: `(joint,)` rad/s².
        period: s between samples.
        longest: s, beyond which no further move begins.
    """
    parts = [places[:1]]
    duration = 0.0
    for start, end, pause in zip(places[:-1], places[1:], pauses, strict=True):
        way = np.abs(end - start)
        if not way.any():
            continue
        # of a share of the way that goes from 0 to 1
        fastest = float(np.min(velocity[way > 0] / way[way > 0]))
        strongest = float(np.min(acceleration[way > 0] / way[way > 0]))
        ramp = min(fastest / strongest, np.sqrt(1 / strongest))
        peak = ramp * strongest
        level = max(1 / peak - ramp, 0.0)
        if duration + 2 * ramp + level + pause > longest:
            break
        samples = int(np.ceil((2 * ramp + level + pause) / period))
        time = period * np.arange(1, samples + 1)
        rising = 0.5 * strongest * np.minimum(time, ramp) ** 2
        even = peak * np.clip(time - ramp, 0.0, level)
        falling = np.clip(time - ramp - level, 0.0, ramp)
        share = np.minimum(rising + even + peak * falling - 0.5 * strongest * falling**2, 1.0)
        parts.append(start + share[:, None] * (end - start))
        duration += samples * period
    return np.concatenate(parts)


class _Maker:
    """Makes the candidates of a room.

    Args:
        room: where and how fast commands may be.
        samples: of each.
        seed: of the random numbers.
    """

    def __init__(self, room: MotionRoom, samples: int, seed: int) -> None:
        self.room = room
        self.samples = samples
        self.period = 1 / room.rate
        self.rng = np.random.default_rng(seed)
        self.velocity = _KEPT * np.asarray(room.velocity)
        self.acceleration = _KEPT * np.asarray(room.acceleration)

    @property
    def duration(self) -> float:
        """s."""
        return self.samples * self.period

    def make(self, kind: str, posture: Array, far: Array) -> Array:
        """A motion of a kind about a posture `(joint,)`, `(sample, joint)` rad; `far` `(place, joint)` are others."""
        if kind.endswith("sines"):
            return posture + self._fitted(self._sines(_SLOW if kind == "slow sines" else _FAST), posture)
        if kind == "chirp":
            return posture + self._fitted(self._chirp(), posture)
        if kind in _REVERSALS:
            return self._filled(self._reverse(posture, *_REVERSALS[kind]))
        if kind == "steps":
            return self._filled(self._step(posture))
        calm = _CALM * self.velocity, _CALM * self.acceleration
        # as far as there is time for
        reach = _REACH * self.duration * calm[0]
        places = np.vstack([posture, posture + np.clip(far - posture, -reach, reach)])
        return self._filled(straight(places, [_REST] * len(far), *calm, self.period, self.duration))

    def _filled(self, position: Array) -> Array:
        """With a rest at its end."""
        rest = np.repeat(position[-1:], max(self.samples - len(position), 0), 0)
        return np.concatenate([position, rest])[: self.samples]

    def _grown(self, wave: Array) -> Array:
        """A wave `(sample, joint)` that grows from rest and fades to rest."""
        share = np.arange(self.samples) / (self.samples - 1)
        grown = np.minimum(np.clip(share / _RAMP, 0, 1), np.clip((1 - share) / _RAMP, 0, 1))
        return (grown**3 * (10 - 15 * grown + 6 * grown**2))[:, None] * wave

    def _fitted(self, wave: Array, posture: Array) -> Array:
        """A wave as large as the limits allow."""
        lower, upper = self.room.position.T
        limits = [(wave.max(0), upper - posture), (-wave.min(0), posture - lower), (np.abs(wave).max(0), _WIDEST)]
        limits.append((np.abs(np.diff(wave, axis=0)).max(0) / self.period, self.velocity))
        limits.append((np.abs(np.diff(wave, 2, axis=0)).max(0) / self.period**2, self.acceleration))
        sizes = [np.maximum(limit, 0.0) / np.maximum(largest, 1e-12) for largest, limit in limits]
        return np.min(np.stack(sizes), 0) * wave

    def _sines(self, band: tuple[float, float]) -> Array:
        fastest = _LARGEST_RATE * self.room.rate
        low, high = np.log(np.minimum(band, fastest))
        rate = 2 * np.pi * np.exp(self.rng.uniform(low, high, (_SINES, self.room.arm.dof)))
        phase = self.rng.uniform(-np.pi, np.pi, rate.shape)
        time = self.period * np.arange(self.samples)
        # amplitudes between those of equal velocity and of equal acceleration
        return self._grown((rate**-1.5 * np.sin(time[:, None, None] * rate + phase)).sum(1))

    def _chirp(self) -> Array:
        first, last = np.minimum(_CHIRP, _LARGEST_RATE * self.room.rate)
        time = self.period * np.arange(self.samples)
        frequency = first + (last - first) * time / self.duration
        angle = 2 * np.pi * (first * time + 0.5 * (last - first) * time**2 / self.duration)
        turned = angle[:, None] + self.rng.uniform(-np.pi, np.pi, self.room.arm.dof)
        return self._grown((frequency[:, None] / first) ** -1.5 * np.sin(turned))

    def _inside(self, places: Array) -> Array:
        return np.clip(places, *self.room.position.T)

    def _reverse(self, posture: Array, half: float, speed: float) -> Array:
        """To and fro, every other time with a rest."""
        count = int(self.duration * speed / half) + 2
        sides = np.where(np.arange(count) % 2, -1.0, 1.0)[:, None] * self.rng.choice([-1.0, 1.0], len(posture))
        # ways that differ put the reversals at different positions
        places = posture + half * sides * self.rng.uniform(0.6, 1.0, (count, 1))
        pauses = np.where(np.arange(count) % 4 < 2, 0.0, _REST)
        pauses[1::4] = _REST
        velocity = np.minimum(speed, self.velocity)
        way = self._inside(np.vstack([posture, places]))
        return straight(way, pauses.tolist(), velocity, self.acceleration, self.period, self.duration)

    def _step(self, posture: Array) -> Array:
        count = int(self.duration / _REST)
        places = self._inside(posture + _STEP * self.rng.uniform(-1, 1, (count, len(posture))))
        way = np.vstack([posture, places])
        return straight(way, [_REST] * count, self.velocity, self.acceleration, self.period, self.duration)


def choose_postures(room: MotionRoom, bodies: Bodies, count: int, seed: int) -> Array:
    """Postures `(posture, joint)` rad in which the weight of the arm loads its joints most differently.

    The first has the largest loads, each further one is furthest from those before. Arms without masses: by the joints.

    Raises:
        InputError: as `candidates`, or none passes the filters.
    """
    drawn = candidates(room.arm, _DRAWN, seed, room.filters, room.margin).joint_position
    lower, upper = inside_limits(room.arm, room.margin).T
    share = (drawn - (lower + upper) / 2) / (upper - lower)
    postures = room.position.mean(1) + _TOWARDS_MIDDLE * share * np.ptp(room.position, axis=1)
    postures = postures[all_pass(room.filters, postures)]
    if not len(postures):
        names = ", ".join(condition.name for condition in room.filters)
        raise InputError(f"commands: no posture near the middle of the joints' ranges passes {names}; widen them")
    still = np.zeros_like(postures.T)
    loads = bodies.torques(postures.T, still, still).T if bodies.links.any() else postures
    loads = loads / np.maximum(np.std(loads, axis=0), 1e-3 * max(float(np.std(loads)), 1e-9))
    chosen = [int(np.argmax(np.sum(loads**2, 1)))]
    while len(chosen) < min(count, len(postures)):
        distance = np.min([np.sum((loads - loads[k]) ** 2, 1) for k in chosen], 0)
        chosen.append(int(np.argmax(distance)))
    return postures[chosen]


def draw_segments(room: MotionRoom, bodies: Bodies, samples: int, seed: int = 0) -> list[CommandSegment]:
    """Motions of so many samples among which a design chooses, each as large as limits and filters allow.

    Raises:
        InputError: as `choose_postures`, or no motion passes the filters.
    """
    maker = _Maker(room, samples, seed)
    postures = choose_postures(room, bodies, POSTURES + _FAR_MOVES, seed)
    tried = [(kind, posture) for posture in postures[:POSTURES] for kind in KINDS[:-1]]
    tried += [(KINDS[-1], posture) for posture in postures[-_FAR_MOVES:]]
    segments = []
    for kind, posture in tried:
        far = postures[maker.rng.permutation(len(postures))]
        position = maker.make(kind, posture, far)
        for _ in range(_SMALLER):
            if all_pass(room.filters, position).all():
                break
            position = posture + (position - posture) / 2
        if np.ptp(position, axis=0).any() and all_pass(room.filters, position).all():
            segments.append(CommandSegment(kind, position))
    if not segments:
        names = ", ".join(condition.name for condition in room.filters)
        raise InputError(f"commands: no motion passes {names}; widen them")
    return segments


def connect(room: MotionRoom, start: Array, end: Array) -> Array | None:
    """The straight way between two places at rest, `(sample, joint)` rad without both; None where filters refuse it."""
    calm = _KEPT * _CALM * np.asarray(room.velocity), _KEPT * _CALM * np.asarray(room.acceleration)
    way = straight(np.stack([start, end]), [0.0], *calm, 1 / room.rate)[1:]
    if room.filters and len(way) and not all_pass(room.filters, way).all():
        return None
    return way
