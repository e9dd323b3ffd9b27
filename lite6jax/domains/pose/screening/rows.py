"""What the rows of a recording show of themselves, without a fit: order, repeats, units, turns, round numbers."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.recordings import Recording, repeated_rows, time_disorder
from lite6jax.recordings.recording import run_segments

Array = NDArray[np.floating]

FAR = 5.0
"""Median distances from the middle of all poses within which a row converted to their unit must lie; one in another
unit lies ten times further."""
GRIDS = ((1e-4, "0.0001 rad"), (float(np.deg2rad(0.01)), "0.01°"))
ROUNDED = 6e-7
"""rad; a command in degrees, written with six decimals in radians, is so far from its grid."""
FEWEST_VALUES = 20
_SHOWN = 6


class Fault(NamedTuple):
    """A fault of the data, or a cause that was ruled out.

    Attributes:
        fault: its name.
        rows: of the file, from 1; empty where all are concerned.
        statement: what, where, what was done about it, what to do next; or what ruled it out.
    """

    fault: str
    rows: tuple[int, ...]
    statement: str


class Findings(NamedTuple):
    """What is being gathered."""

    faults: list[Fault]
    checked: list[Fault]

    def clear(self, fault: str, statement: str) -> None:
        """Notes that a cause was ruled out, and by what."""
        self.checked.append(Fault(fault, (), statement))


def in_order(recording: Recording, found: Findings) -> Recording:
    """The rows of each run by time."""
    disorder = time_disorder(recording)
    if not disorder.rows.size:
        what = (
            "follow the clock within each run"
            if recording.time is not None
            else "carry no times: their order is the sequence"
        )
        found.clear("time_order", f"All {recording.samples} rows {what}.")
        return recording
    rows = rows_of(disorder.rows)
    found.faults.append(
        Fault(
            "time_order",
            rows,
            f"{named(rows)} out of time order within their run, by {disorder.largest_step_back_s:.4g} s at most; the "
            "rows of each run have been sorted by time. Check how the file was put together.",
        )
    )
    return recording.sorted_by_time()


def once(recording: Recording, found: Findings) -> Recording:
    """Without rows that repeat an earlier one in joints and pose, to the last digit."""
    repeated = repeated_rows(recording)
    if not repeated.rows.size:
        found.clear("repeated_rows", f"None of {recording.samples} rows repeats the joints and the pose of another.")
        return recording
    rows = rows_of(repeated.rows)
    kept = np.ones(recording.samples, bool)
    kept[repeated.samples] = False
    found.faults.append(
        Fault(
            "repeated_rows",
            rows,
            f"{named(rows)} exact repeats of earlier rows, in joints and pose (row {rows[0]} of row "
            f"{int(repeated.first_rows[0])}), which no sensor's noise gives twice; each is used once. Check whether "
            "the logger wrote them again or the sensor had stopped.",
        )
    )
    return recording.select(kept)


def in_metres(recording: Recording, found: Findings) -> Recording:
    """With rows a thousand times too far away, or too near, put right."""
    position = recording.position
    assert position is not None
    middle = np.median(position, axis=0)
    size = max(float(np.median(np.linalg.norm(position - middle, axis=1))), 1e-6)

    def off(points: Array) -> Array:
        return np.linalg.norm(points - middle, axis=1)

    far = (off(position) > 10 * FAR * size) & (off(position / 1000) < FAR * size)
    near = (np.linalg.norm(position, axis=1) < 0.005 * size) & (off(position * 1000) < 2 * size)
    if not (far | near).any():
        found.clear(
            "position_unit",
            f"No position is further than {off(position).max():.3g} m from their middle, half of them within "
            f"{size:.3g} m: all are in one unit.",
        )
        return recording
    factor = np.where(far, 1e-3, np.where(near, 1e3, 1.0))
    rows = rows_of(recording.row[far | near])
    found.faults.append(
        Fault(
            "position_unit",
            rows,
            f"The positions of {named(rows)} a factor of 1000 {'too large' if far.any() else 'too small'}, in "
            "another unit than the rest; they have been converted. Check what wrote these rows.",
        )
    )
    return replace(recording, position=position * factor[:, None])


def check_commanded(recording: Recording, found: Findings) -> None:
    """Whether the joints are round numbers, or the same to the last digit at each return to a pose."""
    looks_like = "a servo's error and a gear's droop under load then look like the arm's own physics"
    if recording.settings.joint_source == "commanded":
        found.clear("commanded_joints", f"The sidecar says that the joints are commands: {looks_like}.")
        return
    values = np.unique(np.abs(recording.joint_position))
    values = values[values > 1e-3]
    nearest = {words: float(np.mean(np.abs(values - np.round(values / g) * g) < ROUNDED)) for g, words in GRIDS}
    words = max(nearest, key=lambda key: nearest[key]) if values.size else ""
    again = _exact_visits(recording)
    if values.size >= FEWEST_VALUES and nearest[words] == 1.0:
        reason = f"all {values.size} joint positions are multiples of {words}, as commands are and encoders are not"
    elif recording.settings.joint_noise_rad > 0 and again[0] >= 3 and again[0] == again[1]:
        reason = (
            f"all {again[0]} returns to an earlier pose read the same joints to the last digit, in spite of a declared "
            f"read-out noise of {recording.settings.joint_noise_rad:.2g} rad"
        )
    else:
        share = nearest[words] if values.size else 0.0
        found.clear(
            "commanded_joints",
            f"{share:.0%} of the joint positions are multiples of {words or 'a round number'}: they are not round "
            "numbers as commands are.",
        )
        return
    found.faults.append(
        Fault(
            "commanded_joints",
            (),
            f"The joints look commanded, or rounded, not measured: {reason}. They are used as they are; {looks_like}. "
            "Record the encoders, or declare joint_source: commanded.",
        )
    )


def _exact_visits(recording: Recording) -> tuple[int, int]:
    """How many samples of a static recording repeat an earlier one's joints exactly, and how many within 1 mrad."""
    if recording.motion != "static":
        return 0, 0
    q = recording.joint_position
    exact = len(q) - len(np.unique(q, axis=0))
    near = len(q) - len(np.unique(np.round(q, 3), axis=0))
    return exact, max(exact, near)


def without_turns(recording: Recording, arm: Arm, found: Findings) -> Recording:
    """Joints without whole turns: those that wrap round in a trajectory, and those that their limits exclude."""
    q = recording.joint_position.copy()
    segment = run_segments(recording.run)
    if recording.motion == "trajectory":
        for run in np.unique(segment):
            q[segment == run] = np.unwrap(q[segment == run], axis=0)
    low, high = arm.joint_limits.T
    slack = 0.01
    for joint in range(recording.dof):
        width = high[joint] - low[joint]
        for part in [segment == run for run in np.unique(segment)] if recording.motion == "trajectory" else [None]:
            values = q[:, joint] if part is None else q[part, joint]
            out = (values < low[joint] - slack) | (values > high[joint] + slack)
            if not out.any() or not np.isfinite(width):
                continue
            middle = (low[joint] + high[joint]) / 2
            turns = np.round((values - middle) / (2 * np.pi))
            if part is not None:
                turns = np.full(values.shape, np.round((np.median(values) - middle) / (2 * np.pi)))
            back = values - 2 * np.pi * turns * (out if part is None else 1.0)
            if ((back >= low[joint] - slack) & (back <= high[joint] + slack)).all():
                q[slice(None) if part is None else part, joint] = back
    changed = np.abs(q - recording.joint_position) > 1.0
    if not changed.any():
        outside = float(
            np.max(np.maximum(low - recording.joint_position, recording.joint_position - high), initial=-np.inf)
        )
        within = (
            "all joints are within their limits"
            if outside <= slack
            else f"joints pass their limits by {outside:.3g} rad, but by no whole turns"
        )
        found.clear("joint_turns", f"No joint is off by turns: {within}.")
        return recording
    joints = [f"joint {j + 1}" for j in np.flatnonzero(changed.any(0))]
    rows = rows_of(recording.row[changed.any(1)])
    found.faults.append(
        Fault(
            "joint_turns",
            rows,
            f"{' and '.join(joints)} {'is' if len(joints) == 1 else 'are'} off by whole turns in "
            f"{named(rows, False)}; these have been taken out, since gears and limits know them. Check where the "
            "encoder wraps.",
        )
    )
    fresh = recording.made_anew(joint_position=q, settings=replace(recording.settings, motion=recording.motion))
    velocity = fresh.joint_velocity if recording.velocity_differentiated else recording.joint_velocity
    return replace(recording, joint_position=q, joint_velocity=velocity, direction_of_motion=fresh.direction_of_motion)


def rows_of(rows: NDArray[np.integer]) -> tuple[int, ...]:
    """Row numbers in order."""
    return tuple(int(row) for row in np.sort(rows))


def named(rows: tuple[int, ...], verb: bool = True) -> str:
    """A few row numbers in words."""
    if len(rows) == 1:
        return f"row {rows[0]}{' is' if verb else ''}"
    few = ", ".join(map(str, rows[:_SHOWN]))
    more = f" and {len(rows) - _SHOWN} more" if len(rows) > _SHOWN else ""
    return f"{len(rows)} rows ({few}{more}){' are' if verb else ''}"
