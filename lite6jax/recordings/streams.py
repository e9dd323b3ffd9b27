"""Streams of one recording, each at times of its own, joined at the times of the poses: joints are interpolated there.

A log has a stream for each topic; a table that was merged from topics has one in every few rows; a robot and a sensor
that were recorded apart have one in each file, once their clocks are known (`domains.pose.clocks`). Commands are a
stream too: each is in force until the next.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.errors import InputError
from lite6jax.recordings.sequence import differentiate, run_segments, unwrap

Method = Literal["linearly", "by cubics", "nearest"]

LONGEST_GAP = 2.0
"""Between joint states around a pose, in median steps; beyond, the joints at the pose are not known, …"""
LONGEST_STANDSTILL = 10.0
"""… or beyond this many, where the joints are the same before and after."""
_SHARED_ROWS = 0.5
"""Of the rows with poses: where fewer have joints as well, poses and joints are streams of their own."""


class Joined(NamedTuple):
    """Joint states at the times of poses.

    Attributes:
        usable: `(pose,)` bool, where the joints are known.
        columns: by their names, `(usable,)` each.
        method: how they are found between joint states; `nearest` where each pose has a capture of its own.
        outside: poses before the first or after the last joint state.
        wide: poses between joint states that are too far apart.
        gap: s, the longest between the joint states around a pose; with `nearest` the longest to the capture.
        error: RMS by which joint states that are left out are found again from those around them, at twice their
            distance, in the unit of the joints; NaN where there are too few.
        resolved: whether the joint states follow the motion; else what is interpolated means nothing.
    """

    usable: Mask
    columns: dict[str, Array]
    method: Method
    outside: int
    wide: int
    gap: float
    error: float
    resolved: bool = True


@final
@dataclass(frozen=True, eq=False)
class JointStream:
    """Joint positions at times of their own.

    Attributes:
        time: `(state,)` s, increasing.
        position: `(state, joint)`.
        near: `(state - 1,)` bool, which neighbours are near enough for joints between them to be known.
        step: s, the median.
        method: by what joints are found between joint states.
        error: as in `Joined`.
        slopes: `(state, joint)` per second; None of straight lines.
    """

    time: Array
    position: Array
    near: Mask
    step: float
    method: Method
    error: float
    slopes: Array | None

    @classmethod
    def of(cls, time: Array, position: Array) -> "JointStream":
        """The stream of at least two joint states.

        Joints are interpolated by straight lines, or by cubics whose slopes are those of a parabola through three joint
        states: by what finds joint states that are left out more exactly.
        """
        position = unwrap(position)
        gap = np.diff(time)
        step = float(np.median(gap)) * (1 + 1e-9)  # twice as far is not farther by rounding
        with np.errstate(invalid="ignore", over="ignore"):
            unmoved = np.abs(np.diff(position, axis=0)).max(1) <= 1e-4 * np.ptp(position, axis=0).max()
            near = gap <= np.where(unmoved, LONGEST_STANDSTILL, LONGEST_GAP) * step
            method, error = _method(time, position, near)
            slopes = _slopes(time, position, near) if method == "by cubics" else None
        return cls(time, position, near, step, method, error, slopes)

    @property
    def resolved(self) -> bool:
        """Tells whether the joint states follow a motion; false of captures, between which the joints move far."""
        with np.errstate(invalid="ignore", over="ignore"):
            change = np.sqrt(np.mean(np.diff(self.position, axis=0) ** 2))
            width = np.ptp(self.position, axis=0).max()
        # beside a fine log, rounding and a jump between runs are errors as large as its steps, but not as its motion
        return not (self.error > 0.3 * change and self.error > 0.01 * width)

    def known(self, at: Array) -> Mask:
        """`(pose,)`, where there are joint states near enough."""
        before = self._before(at)
        exact = (at == self.time[before]) | (at == self.time[before + 1])
        return (at >= self.time[0]) & (at <= self.time[-1]) & (exact | self.near[before])

    def gap(self, at: Array) -> float:
        """s, the longest between the joint states around times."""
        before = self._before(at)
        across = (at != self.time[before]) & (at != self.time[before + 1])
        return float(np.max(np.diff(self.time)[before[across]], initial=0.0))

    def at(self, at: Array) -> Array:
        """`(pose, joint)`; where no joint states are near, what a straight line or a cubic gives all the same."""
        return _between(self.time, self.position, at, self.slopes)

    def _before(self, at: Array) -> Integers:
        return np.clip(np.searchsorted(self.time, at, side="right") - 1, 0, len(self.time) - 2)


def join(time: Array, columns: Mapping[str, Array], joints: Sequence[str], at: Array) -> Joined:
    """Columns of joint states at the times of poses: joints as `JointStream` has them, all others on straight lines.

    Args:
        time: `(state,)` s, increasing; at least two.
        columns: `(state,)` each.
        joints: the columns that are joint positions.
        at: `(pose,)` s, of the same clock.
    """
    stream = JointStream.of(time, np.stack([columns[name] for name in joints], 1))
    if not stream.resolved and (captures := _captures(time, at, stream.step)) is not None:
        usable, nearest = captures
        at_poses = {name: column[nearest[usable]] for name, column in columns.items()}
        longest = float(np.max(np.abs(at - time[nearest])[usable], initial=0.0))
        return Joined(usable, at_poses, "nearest", 0, int(np.sum(~usable)), longest, np.nan)
    usable = stream.known(at)
    outside = int(np.sum((at < time[0]) | (at > time[-1])))
    at_poses = {name: _between(time, column[:, None], at[usable])[:, 0] for name, column in columns.items()}
    at_poses |= dict(zip(joints, stream.at(at[usable]).T, strict=True))
    wide = int(np.sum(~usable)) - outside
    gap = stream.gap(at[usable])
    return Joined(usable, at_poses, stream.method, outside, wide, gap, stream.error, stream.resolved)


def _captures(time: Array, at: Array, step: float) -> tuple[Mask, Integers] | None:
    """Which poses have a capture of joints of their own, and which; None where most have none.

    It stands beside the pose, within a tenth of the median step; or each pose has another one, all of them before the
    pose or all after it.
    """
    after = np.clip(np.searchsorted(time, at), 1, len(time) - 1)
    nearest = after - (at - time[after - 1] <= time[after] - at)
    late = at - time[nearest]
    beside = np.abs(late) <= 0.1 * step
    if np.mean(beside) > 0.8:
        return beside, nearest
    alone = np.bincount(nearest, minlength=len(time))[nearest] == 1
    for side in (late >= 0, late <= 0):
        captured = side & alone & (np.abs(late) <= 0.4 * step)
        if np.mean(captured) > 0.95:
            return captured, nearest
    return None


def merge(
    columns: Mapping[str, Array], joints: Sequence[str], places: Sequence[str], time: str, notes: list[str]
) -> tuple[dict[str, Array], Integers] | None:
    """A table at the rows of its poses, and these from 0, where they have no joints; None where nothing is joined.

    Args:
        columns: `(row,)` each, NaN where a row does not give one.
        joints: the columns of joint positions; `places` those of the position of the tool, and `time` that of times.
        notes: what was done is added here.

    Raises:
        InputError: no pose has joints, or joint states are too far apart to follow the motion.
    """
    if not joints or not places or not {time, *joints, *places} <= columns.keys():
        return None
    clock = columns[time]
    moved, measured = (
        np.isfinite([clock, *(columns[name] for name in names)]).all(axis=0) for names in (joints, places)
    )
    poses = np.flatnonzero(measured)
    if not poses.size or np.sum(moved & measured) >= _SHARED_ROWS * poses.size:
        return None
    clock = _clock_of_runs(columns, time)
    states = in_order(clock, moved)
    if len(states) < 2:
        return None
    start = clock[states[0]]
    joined = join(clock[states] - start, {name: columns[name][states] for name in joints}, joints, clock[poses] - start)
    rows = poses[joined.usable]
    if not joined.resolved or not rows.size:
        why = "no pose lies between joint states" if joined.resolved else "the joints move too far from one to the next"
        raise InputError(
            f"{len(poses)} poses and {len(states)} joint states stand in different rows, and {why}; record both in one "
            "row, or joint states more often"
        )
    at_poses = {}
    for name, column in columns.items():
        recorded = in_order(clock, np.isfinite(column))
        elsewhere = len(recorded) > 1 and np.mean(np.isfinite(column[rows])) < _SHARED_ROWS
        at_poses[name] = (
            np.interp(clock[rows] - start, clock[recorded] - start, column[recorded]) if elsewhere else column[rows]
        )
    first, *dropped = said_of(joined)
    notes += [f"{len(poses)} poses and {len(states)} joint states stand in different rows: {first}", *dropped]
    return at_poses | joined.columns, rows


class Held(NamedTuple):
    """Commands at the times of joint states.

    Attributes:
        usable: `(state,)` bool, where a command is in force.
        sent: `(usable,)` the number of that command.
        early: joint states before the first command.
        late: those over `LONGEST_GAP` median steps after the last, when none was logged any more.
    """

    usable: Mask
    sent: Integers
    early: int
    late: int


def hold(time: Array, at: Array, run: Array | None = None, run_at: Array | None = None) -> Held:
    """The commands that are in force at the times of joint states: each until the next, of the same run.

    Args:
        time: `(command,)` s, increasing; of runs one after the other.
        at: `(state,)` s, of the same clock.
        run, run_at: of the commands and of the joint states; None where there is one.
    """
    before = np.searchsorted(time, at, side="right") - 1
    sent = before >= 0
    if run is not None and run_at is not None:
        sent &= run[before] == run_at
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    last = np.append(np.diff(run) != 0, True) if run is not None else np.arange(len(time)) == len(time) - 1
    late = sent & last[before] & (at > time[before] + LONGEST_GAP * step * (1 + 1e-9))
    return Held(sent & ~late, before[sent & ~late], int(np.sum(~sent)), int(np.sum(late)))


def hold_commands(
    columns: Mapping[str, Array], joints: Sequence[str], commands: Sequence[str], time: str, notes: list[str]
) -> tuple[dict[str, Array], Integers] | None:
    """A table at the rows of its joint states, and these from 0, where they have no commands; None where most have.

    Args:
        columns: `(row,)` each, NaN where a row does not give one.
        joints: the columns of joint positions; `commands` those that are commanded, and `time` that of times.
        notes: what was done is added here.

    Raises:
        InputError: times begin anew, and no column says where a run begins.
    """
    if not joints or not commands or not {time, *joints, *commands} <= columns.keys():
        return None
    clock = columns[time]
    moved, commanded = (
        np.isfinite([clock, *(columns[name] for name in names)]).all(axis=0) for names in (joints, commands)
    )
    states = np.flatnonzero(moved)
    if not states.size or not commanded.any() or np.sum(moved & commanded) >= _SHARED_ROWS * states.size:
        return None
    clock = _clock_of_runs(columns, time)
    sent = in_order(clock, commanded)
    run = columns.get("run")
    runs = (None, None) if run is None else (run[sent], run[states])
    held = hold(clock[sent], clock[states], *runs)
    rows = states[held.usable]
    notes.append(
        f"{len(sent)} commands and {len(states)} joint states stand in different rows: each command is held until the "
        "next"
    )
    notes += said_of_commands(held)
    at_states = {name: column[rows] for name, column in columns.items()}
    return at_states | {name: columns[name][sent[held.sent]] for name in commands}, rows


def said_of_commands(held: Held) -> list[str]:
    """Which joint states have no command in force, in sentences."""
    dropped = ((held.early, "before the first command"), (held.late, "after the last command"))
    return [f"dropped {count} joint states {reason}" for count, reason in dropped if count]


def said_of(joined: Joined, unit: str = "rad") -> list[str]:
    """What was done to join streams, in sentences."""
    if joined.method == "nearest":
        sentences = [
            f"each pose has the joints that were captured with it, at most {joined.gap:.2g} s apart: between captures "
            "the joints move too far to be interpolated"
        ]
        dropped = ((joined.wide, "without a capture of joints beside them"),)
    else:
        error = f"; every other one left out is found again to {joined.error:.2g} {unit}"
        sentences = [
            f"the joints are interpolated {joined.method} to the times of the poses (between joint states at most "
            f"{joined.gap:.2g} s apart{'' if np.isnan(joined.error) else error})"
        ]
        dropped = (
            (joined.outside, "before the first or after the last joint state"),
            (joined.wide, f"between joint states over {LONGEST_GAP:g} median steps apart"),
        )
    if not joined.resolved:
        sentences.append(
            "joint states are too far apart to follow the motion: what is interpolated between them is not known"
        )
    return sentences + [f"dropped {count} poses {reason}" for count, reason in dropped if count]


def _clock_of_runs(columns: Mapping[str, Array], time: str) -> Array:
    """Times `(row,)` that grow from run to run, far apart between runs, where each run counts its own.

    Raises:
        InputError: times begin anew, and no column says where a run begins.
    """
    clock = columns[time]
    finite = np.isfinite(columns[time])
    width = float(np.ptp(clock[finite])) if finite.any() else 0.0
    with np.errstate(invalid="ignore", over="ignore"):
        anew = np.diff(clock[finite]) < -0.5 * width
    if not anew.any():
        return clock
    run = columns.get("run")
    if run is None or not np.isfinite(run).all():
        row = int(np.flatnonzero(finite)[np.flatnonzero(anew)[0] + 1]) + 1
        raise InputError(f"times begin anew at row {row}; number the runs in a column `run`")
    return clock + run_segments(np.unique(run, return_inverse=True)[1]) * (10 * width + 1.0)


def in_order(clock: Array, present: ArrayLike) -> Integers:
    """Rows in order of time, of those at one time the first."""
    rows = np.flatnonzero(np.asarray(present) & np.isfinite(clock))
    return rows[np.unique(clock[rows], return_index=True)[1]]


def _between(time: Array, values: Array, at: Array, slopes: Array | None = None) -> Array:
    """`(pose, column)` on straight lines, or with slopes on cubics, between `(state, column)`."""
    low = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    step = time[low + 1] - time[low]
    share = ((at - time[low]) / step)[:, None]
    low, high = low + (share[:, 0] == 1), low + (share[:, 0] > 0)  # at a state its neighbours do not matter
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite stays so, and its rows are dropped
        line = values[low] * (1 - share) + values[high] * share
        if slopes is None:
            return line
        rise = values[high] - values[low]
        ends = step[:, None] * slopes[low] - rise, step[:, None] * slopes[high] - rise
        inside = share * (1 - share) * ((1 - share) * ends[0] - share * ends[1])
        return np.where((share > 0) & (share < 1), line + inside, line)


def _slopes(time: Array, q: Array, joined: Mask) -> Array:
    """`(state, joint)` per second; zero where the joints of a state are not finite, and so is what lies around it."""
    return np.nan_to_num(differentiate(q, time, np.concatenate([[0], np.cumsum(~joined)])))


def _method(time: Array, q: Array, joined: Mask) -> tuple[Method, float]:
    """What finds every other joint state more exactly from those around it, and its RMS error."""
    left_out = np.arange(1, len(time) - 1, 2)
    finite = np.isfinite(q.sum(axis=1))
    usable = joined[:-1] & joined[1:] & finite[:-2] & finite[1:-1] & finite[2:]
    left_out = left_out[usable[left_out - 1]]
    if not left_out.size:
        return "linearly", np.nan
    part = slice(None, None, 2)
    pairs = len(time[part]) - 1
    unbroken = joined[0::2][:pairs] & joined[1::2][:pairs]
    errors = {}
    for method, slopes in (("linearly", None), ("by cubics", _slopes(time[part], q[part], unbroken))):
        missed: Array = _between(time[part], q[part], time[left_out], slopes) - q[left_out]
        errors[method] = float(np.sqrt(np.mean(missed**2)))
    chosen_method: Method = "by cubics" if errors["by cubics"] < errors["linearly"] else "linearly"
    return chosen_method, errors[chosen_method]
