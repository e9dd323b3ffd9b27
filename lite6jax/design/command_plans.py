"""Commands that tell effects on how servos follow apart: motions chosen one after the other for their information.

Each is the one that adds most, for its duration, to the sum of the logarithms of squared distances between pairs of
explanations, which are those of T-optimality (A. C. Atkinson, V. V. Fedorov, Biometrika 62, 1975).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.design.commands import CommandSegment, connect, draw_segments
from lite6jax.design.motions import MotionRoom
from lite6jax.design.tracking import CommandExperiment, Information
from lite6jax.domains.tracking.rows import even_rows, usual_payload
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError

CLEAR = 5.0
"""Standard deviations between two explanations at which a test at a level of 1 % has a power of 99 % or more."""
_ENOUGH = 10.0
"""Times that, from which more distance hardly counts."""
DURATION = 40.0
"""s, of commands, where none is given."""
SHORTEST = 6.0
LONGEST = 120.0
"""s, of designed commands: three motions, and more than that is that again."""
_OF_DURATION = 0.1
_SEGMENT = (1.5, 3.0)
"""s, the duration of a motion: a share of the whole, within these."""
_LEAD = 0.4
"""s of rest before a candidate, whose samples do not count: what a run begins with is no motion."""
_REST = 0.5
"""s of rest before the first motion."""
_UNSEEN = 0.1
"""Standard deviations by which an effect moves read-outs of all candidates together, if they do not show it."""
_DRAWS = 9
"""Of as many candidates as were chosen, with whose median the designed commands are compared."""
_ALIKE = 1e-6
_ALIKE_NAMES = 1e-4
"""Of the square of what an effect moves, what two explanations differ by if no motion tells them apart: an effect that
was found from one whose size is adapted to it, and effects of usual sizes, whose columns are less exact."""
_MOST_ROWS = 6000
"""Of a recorded log that are rolled out; those of a longer one count for the others."""


class DesignedPair(NamedTuple):
    """Two explanations, and how far apart they are, in standard deviations.

    Attributes:
        effect, rival: the two.
        values: `(coordinate,)` numbers of the effect, of the size at which they are compared.
        number: which of them is of that size; None of an effect that was found.
        recorded: in the log that there is; None where there is none.
        compared: with a log of the same motion that is as much longer; with as many candidates drawn at random, their
            median, where there is no log.
        designed: with the designed commands, beside the log.
        alike: whether no motion tells them apart.
        kind: of the motions that tell most.
    """

    effect: Effect
    rival: Effect
    values: Array
    number: int | None
    recorded: float | None
    compared: float
    designed: float
    alike: bool
    kind: str

    @property
    def clear(self) -> bool:
        """Tells whether the designed commands tell them apart."""
        return self.designed >= CLEAR

    def to_dict(self) -> dict[str, Any]:
        """As values of JSON."""
        return {
            "effect": {"effect": self.effect.name, "site": self.effect.site},
            "rival": {"effect": self.rival.name, "site": self.rival.site},
            "number": None if self.number is None else self.effect.coordinates[self.number].name,
            "recorded_distance": self.recorded,
            "compared_distance": self.compared,
            "distance": self.designed,
            "told_apart": self.clear,
            "alike_in_every_motion": self.alike,
            "kind": self.kind,
        }


@final
@dataclass(frozen=True, eq=False)
class CommandPlan:
    """Commands that tell effects apart.

    Attributes:
        experiment: the arm, and what is distinguished.
        room: where and how fast commands may be.
        time: `(sample,)` s.
        command: `(sample, joint)` rad.
        parts: the kind of each motion, and when it begins and ends in s.
        candidates: motions among which these were chosen.
        pairs: what they tell apart.
        unseen: labels of effects that no candidate shows.
    """

    experiment: CommandExperiment
    room: MotionRoom
    time: Array
    command: Array
    parts: tuple[tuple[str, float, float], ...]
    candidates: int
    pairs: tuple[DesignedPair, ...]
    unseen: tuple[str, ...] = ()

    @cached_property
    def hardest(self) -> tuple[DesignedPair, ...]:
        """The nearest alternative to each number of each effect, but for those that are always alike."""
        hardest: dict[tuple[Effect, int | None], DesignedPair] = {}
        for pair in self.pairs:
            key = pair.effect, pair.number
            if not pair.alike and (key not in hardest or pair.designed < hardest[key].designed):
                hardest[key] = pair
        return tuple(hardest.values())

    @property
    def alike(self) -> tuple[DesignedPair, ...]:
        """Pairs that no motion of commands tells apart."""
        return tuple(pair for pair in self.pairs if pair.alike)

    @property
    def fastest(self) -> Array:
        """`(joint,)` rad/s."""
        return np.abs(np.diff(self.command, axis=0)).max(0) / self.experiment.period

    @property
    def strongest(self) -> Array:
        """`(joint,)` rad/s²."""
        return np.abs(np.diff(self.command, 2, axis=0)).max(0) / self.experiment.period**2


def _recorded_information(experiment: CommandExperiment) -> tuple[Any, float, float]:
    """The problem of the recorded log, its duration in s, and the factor of what it is rolled out of it.

    Returns None, 0 and 1 where there is none.
    """
    if experiment.recorded is None:
        return None, 0.0, 1.0
    even = even_rows(experiment.recorded)
    assert even.time is not None
    assert even.commanded_position is not None
    period = float(np.median(np.diff(even.time)))
    rows = min(even.samples, _MOST_ROWS)
    command = even.commanded_position[:rows]
    run = np.unique(even.run[:rows], return_inverse=True)[1]
    shown = replace(experiment, period=period)
    problem = shown.problem(command, run, usual_payload(even))
    return problem, period * even.samples, even.samples / rows


@threadpool_limits.wrap(limits=1, user_api="blas")
def plan_commands(experiment: CommandExperiment, room: MotionRoom, *, seed: int = 0) -> CommandPlan:
    """Commands that tell the alternatives of an experiment apart, beside what is recorded.

    Args:
        experiment: the arm, and what is to be distinguished.
        room: limits, obstacles, duration and rate; of the experiment's arm.
        seed: of the candidates.

    Raises:
        InputError: a duration out of its range, no room for motions, or alternatives that are alike in every motion.
    """
    if not SHORTEST <= room.duration <= LONGEST:
        raise InputError(
            f"--duration {room.duration:g}: commands take from {SHORTEST:g} s, for three motions, to {LONGEST:g} s; "
            "give such a duration"
        )
    experiment = replace(experiment, period=1 / room.rate)
    duration = float(np.clip(_OF_DURATION * room.duration, *_SEGMENT))
    samples = max(round(duration * room.rate), 20)
    segments = draw_segments(room, experiment.model.bodies, samples, seed)
    command, run, counted = _library(segments, round(_LEAD * room.rate))
    problems = [experiment.problem(command, run, payload) for payload in experiment.carried]
    log, recorded_duration, factor = _recorded_information(experiment)
    information = Information(experiment, problems[0], problems[0] if log is None else log)
    matrices = np.sum([information.of_problem(problem, counted) for problem in problems], 0)
    recorded = np.zeros(matrices.shape[1:])
    if log is not None:
        recorded = factor * information.of_problem(log, np.ones(log.samples, bool)).sum(0)
    everything = matrices.sum(0) + recorded
    alike_share = _ALIKE if experiment.of_findings else _ALIKE_NAMES
    moved = information.moved(everything)
    unseen = moved < _UNSEEN**2
    alike = ~unseen & (information.squares(everything) < alike_share * moved)
    if np.all(alike | unseen):
        first = information.alternatives[0]
        raise InputError(
            f"{first.effect.label} and {first.rival.label}: are alike in every motion within these limits; record "
            "torques, or a payload that is known (--payloads), or widen the limits"
        )
    chosen, command = _choose(information, room, segments, matrices, recorded, ~(alike | unseen))
    final = np.zeros_like(recorded)
    for payload in experiment.carried:
        problem = experiment.problem(command, np.zeros(len(command), int), payload)
        final += information.of_problem(problem, np.ones(len(command), bool)).sum(0)
    designed = np.sqrt(information.squares(recorded + final))
    before = np.sqrt(information.squares(recorded))
    if log is None:
        compared = _distances_at_random(information, matrices, len(chosen), seed)
    else:
        more = room.duration * len(experiment.carried) / recorded_duration
        compared = np.sqrt(information.squares(recorded * (1 + more)))
    kinds = _best_kinds(information, segments, matrices, recorded, [k for k, _ in chosen])
    pairs = tuple(
        DesignedPair(
            effect=pair.effect,
            rival=pair.rival,
            values=pair.values,
            number=pair.number,
            recorded=None if log is None else float(before[p]),
            compared=float(compared[p]),
            designed=float(designed[p]),
            alike=bool(alike[p]),
            kind=kinds[p],
        )
        for p, pair in enumerate(information.alternatives)
        if not unseen[p]
    )
    hidden = {pair.effect.label for p, pair in enumerate(information.alternatives) if unseen[p]}
    parts = tuple(
        (segments[k].kind, first / room.rate, (first + len(segments[k].position)) / room.rate) for k, first in chosen
    )
    time = np.arange(len(command)) / room.rate
    hidden -= {pair.effect.label for pair in pairs}
    return CommandPlan(experiment, room, time, command, parts, len(segments), pairs, tuple(sorted(hidden)))


def _distances_at_random(information: Information, matrices: Array, count: int, seed: int) -> Array:
    """`(pair,)`, the median of the distances of so many candidates, drawn several times."""
    rng = np.random.default_rng(seed)
    drawn = [matrices[rng.integers(len(matrices), size=count)].sum(0) for _ in range(_DRAWS)]
    return np.sqrt(np.median(information.squares(np.stack(drawn)), axis=0))


def _library(segments: Sequence[CommandSegment], lead: int) -> tuple[Array, Integers, Mask]:
    """All candidates as runs: commands `(sample, joint)`, their runs, and which samples count."""
    parts = [np.concatenate([np.repeat(part.position[:1], lead, 0), part.position]) for part in segments]
    run = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    counted = np.concatenate([np.arange(len(part)) >= lead for part in parts])
    return np.concatenate(parts), run, counted


def _choose(
    information: Information,
    room: MotionRoom,
    segments: Sequence[CommandSegment],
    matrices: Array,
    recorded: Array,
    matters: Mask,
) -> tuple[list[tuple[int, int]], Array]:
    """The candidates that are chosen, each with the sample at which it begins, and the whole motion."""
    groups = _hardest_of(information, matters)
    most = round(room.duration * room.rate) + 1
    total = recorded
    chosen: list[tuple[int, int]] = []
    position = np.zeros((0, room.arm.dof))
    while True:
        ways = [_way(room, position, segment) for segment in segments]
        fits = [
            k
            for k, way in enumerate(ways)
            if way is not None and len(position) + len(way) + len(segments[k].position) <= most
        ]
        if not fits:
            break
        value = _value(information.squares(total), groups)
        gained = _value(information.squares(total + matrices[fits]), groups) - value
        samples = np.array([len(ways[k]) + len(segments[k].position) for k in fits])  # type: ignore[arg-type]
        best = fits[int(np.argmax(gained / samples))]
        way = ways[best]
        assert way is not None
        position = np.concatenate([position, way])
        chosen.append((best, len(position)))
        position = np.concatenate([position, segments[best].position])
        total = total + matrices[best]
    if not chosen:
        raise InputError(
            f"--duration {room.duration:g}: no motion fits into it at these limits; give a longer one or wider limits"
        )
    return chosen, np.concatenate([position, np.repeat(position[-1:], most - len(position), 0)])


def _way(room: MotionRoom, position: Array, segment: CommandSegment) -> Array | None:
    """`(sample, joint)` rad from the end of a motion to the begin of a candidate; at first a rest there."""
    if not len(position):
        return np.repeat(segment.position[:1], round(_REST * room.rate), 0)
    return connect(room, position[-1], segment.position[0])


def _hardest_of(information: Information, matters: Mask) -> list[Integers]:
    """Pairs of which the nearest counts: those of one number of an effect, or each of findings."""
    groups: dict[Any, list[int]] = {}
    for place, pair in enumerate(information.alternatives):
        if matters[place]:
            key = place if pair.number is None else (pair.effect, pair.number)
            groups.setdefault(key, []).append(place)
    return [np.array(places) for places in groups.values()]


def _value(squares: Array, groups: Sequence[Integers]) -> Array:
    """The sum of logarithms of squared distances `(…,)`, of the nearest pair of each group."""
    enough = (_ENOUGH * CLEAR) ** 2
    nearest = [squares[..., group].min(-1) for group in groups]
    return np.sum([np.log1p(square / (1 + square / enough)) for square in nearest], 0)


def _best_kinds(
    information: Information,
    segments: Sequence[CommandSegment],
    matrices: Array,
    recorded: Array,
    chosen: Sequence[int],
) -> list[str]:
    """The kind of motions without which the distance of each pair falls most."""
    kinds = list(dict.fromkeys(segments[k].kind for k in chosen))
    without = []
    for kind in kinds:
        rest = [matrices[k] for k in chosen if segments[k].kind != kind]
        without.append(information.squares(recorded + np.sum(rest, 0) if rest else recorded))
    return [kinds[k] for k in np.argmin(without, 0)]


def payloads_of(numbers: ArrayLike) -> tuple[float, ...]:
    """Payloads in kg, each of which the arm carries once.

    Raises:
        InputError: one that is negative or not finite, or one twice.
    """
    values = np.atleast_1d(np.asarray(numbers, float))
    shown = " ".join(f"{value:g}" for value in values)
    if not (np.isfinite(values).all() and np.all(values >= 0)):
        raise InputError(f"--payloads {shown}: give masses in kg, 0 or more")
    if len(np.unique(values)) < len(values):
        raise InputError(f"--payloads {shown}: has one twice; give each once")
    return tuple(values.tolist())
