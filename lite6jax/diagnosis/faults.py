"""Faults of the data before any physics: found, located, said in words, and put right in the recording that is used."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.diagnosis import hypotheses, sequence
from lite6jax.diagnosis.rigid import Rigid, rigid_of
from lite6jax.fitting.problem import Geometry
from lite6jax.recordings import Recording, repeated_rows, require_samples, time_disorder
from lite6jax.recordings.recording import run_segments

Array = NDArray[np.floating]

FAR = 5.0
"""Reaches from the middle of all poses beyond which a row is in another unit."""
GRIDS = ((1e-4, "0.0001 rad"), (float(np.deg2rad(0.01)), "0.01°"))
ROUNDED = 6e-7
"""rad; a command in degrees, written with six decimals in radians, is so far from its grid."""
FEWEST_VALUES = 20
_MOST_JUMPS = 3
_MOST_REREAD = 3
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


@dataclass(frozen=True, eq=False)
class Examined:
    """A recording without the faults that were found.

    Attributes:
        recording: as a diagnosis shall use it.
        arm: the nominal arm.
        faults: what was wrong, in the order in which it was put right.
        checked: what was looked for and is not there, each with the number that rules it out.
    """

    recording: Recording
    arm: Arm
    faults: tuple[Fault, ...]
    checked: tuple[Fault, ...]


class _Findings(NamedTuple):
    """What is being gathered."""

    faults: list[Fault]
    checked: list[Fault]

    def clear(self, fault: str, statement: str) -> None:
        self.checked.append(Fault(fault, (), statement))


def examine(recording: Recording, arm: Arm | None = None, geometry: Geometry = "declared") -> Examined:
    """Looks for faults of the data, the coarsest first, and puts each right before the next is looked for.

    Args:
        recording: measured poses.
        arm: the nominal arm; from the sidecar where not given.
        geometry: what is known of it, as in `fit`.

    Raises:
        InputError: no measured poses, or as `recording_problem`.
    """
    require_samples(recording, 1)
    found = _Findings([], [])
    recording = _sorted(recording, found)
    recording = _once(recording, found)
    recording = _metres(recording, found)
    rigid = rigid_of(recording, arm, geometry)
    _commanded(recording, found)
    rigid = _reread(rigid, geometry, found)
    rigid = replace(rigid, recording=_unturned(rigid.recording, rigid.arm, found))
    rigid = _settled_frame(rigid.fitted(), found)
    rigid = _settled_joints(rigid, found)
    recording, nominal = _table(rigid, geometry, found)
    return Examined(recording, nominal, tuple(found.faults), tuple(found.checked))


def _sorted(recording: Recording, found: _Findings) -> Recording:
    disorder = time_disorder(recording)
    if not disorder.rows.size:
        what = (
            "follow the clock within each run"
            if recording.time is not None
            else "carry no times: their order is the sequence"
        )
        found.clear("time_order", f"All {recording.samples} rows {what}.")
        return recording
    rows = _rows(disorder.rows)
    found.faults.append(
        Fault(
            "time_order",
            rows,
            f"{_named(rows)} out of time order within their run, by {disorder.largest_step_back_s:.4g} s at most; the "
            "rows of each run have been sorted by time. Check how the file was put together.",
        )
    )
    return recording.sorted_by_time()


def _once(recording: Recording, found: _Findings) -> Recording:
    repeated = repeated_rows(recording)
    if not repeated.rows.size:
        found.clear("repeated_rows", f"None of {recording.samples} rows repeats the joints and the pose of another.")
        return recording
    rows = _rows(repeated.rows)
    kept = np.ones(recording.samples, bool)
    kept[repeated.samples] = False
    found.faults.append(
        Fault(
            "repeated_rows",
            rows,
            f"{_named(rows)} exact repeats of earlier rows, in joints and pose (row {rows[0]} of row "
            f"{int(repeated.first_rows[0])}), which no sensor's noise gives twice; each is used once. Check whether "
            "the logger wrote them again or the sensor had stopped.",
        )
    )
    return recording.select(kept)


def _metres(recording: Recording, found: _Findings) -> Recording:
    """Rows a thousand times too far away, or too near."""
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
    rows = _rows(recording.row[far | near])
    found.faults.append(
        Fault(
            "position_unit",
            rows,
            f"The positions of {_named(rows)} a factor of 1000 {'too large' if far.any() else 'too small'}, in "
            "another unit than the rest; they have been converted. Check what wrote these rows.",
        )
    )
    return replace(recording, position=position * factor[:, None])


def _commanded(recording: Recording, found: _Findings) -> None:
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


def _unturned(recording: Recording, arm: Arm, found: _Findings) -> Recording:
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
    rows = _rows(recording.row[changed.any(1)])
    found.faults.append(
        Fault(
            "joint_turns",
            rows,
            f"{' and '.join(joints)} {'is' if len(joints) == 1 else 'are'} off by whole turns in "
            f"{_named(rows, False)}; these have been taken out, since gears and limits know them. Check where the "
            "encoder wraps.",
        )
    )
    fresh = Recording.from_arrays(
        q,
        time=recording.time,
        joint_velocity=None if recording.velocity_differentiated else recording.joint_velocity,
        run=recording.run,
        settings=replace(recording.settings, motion=recording.motion),
    )
    velocity = fresh.joint_velocity if recording.velocity_differentiated else recording.joint_velocity
    return replace(recording, joint_position=q, joint_velocity=velocity, direction_of_motion=fresh.direction_of_motion)


def _reread(arm: Rigid, geometry: Geometry, found: _Findings) -> Rigid:
    for again in range(_MOST_REREAD):
        tried = hypotheses.reread(arm)
        if tried.reading is None:
            if not again:
                _read_well(arm, tried, found)
            break
        assert tried.left is not None
        doubt = f" It cannot be told from {' or '.join(tried.alike)}, which fits as well." if tried.alike else ""
        for name, words in tried.reading.faults:
            found.faults.append(
                Fault(
                    name,
                    (),
                    f"The columns fit only when read as {words}: this takes the median misfit from "
                    f"{1e3 * tried.misfit:.4g} mm to {1e3 * tried.left:.3g} mm, and they are used so.{doubt} Correct "
                    "the columns in the file.",
                )
            )
        arm = rigid_of(tried.reading.recording(arm.recording), arm.arm, geometry)
    return arm


def _read_well(arm: Rigid, tried: hypotheses.Reread, found: _Findings) -> None:
    reason = f"as they stand the poses are met within {1e3 * tried.misfit:.3g} mm (median)"
    if tried.left is not None:
        reason = (
            f"as they stand they miss the poses by {1e3 * tried.misfit:.3g} mm (median), read otherwise by "
            f"{1e3 * tried.left:.3g} mm at best; check the arm, the frame and the tool that the sidecar declares"
        )
    for name, words in _RULED_OUT.items():
        if name != "orientation_convention" or arm.rows == 6:
            found.clear(name, f"{words}: {reason}; over {1e3 * tried.gross:.3g} mm would ask for it.")


_RULED_OUT = {
    "swapped_joints": "No joints are exchanged",
    "mirrored_joint": "No joint has its sign reversed",
    "joint_unit": "No joint is in another unit than the rest",
    "orientation_convention": "The orientations are unit quaternions of the tool, scalar first",
}


def _settled_frame(arm: Rigid, found: _Findings) -> Rigid:
    jumps = 0
    while (sought := sequence.seek_jump(arm)).jump is not None and jumps < _MOST_JUMPS:
        jumps += 1
        arm, jump = sequence.put_back(arm, sought.jump)
        recording, k = arm.recording, sought.jump.sample
        row, runs = int(recording.row[k]), recording.run
        place = f"at row {row}"
        if k and runs[k] != runs[k - 1]:
            place += f", where run {int(runs[k])} begins"
        what = "the sensor or the base" if jump.what == "base" else "the target or the tool on the flange"
        shift, turn = (float(np.linalg.norm(part)) for part in (jump.twist[:3], jump.twist[3:]))
        found.faults.append(
            Fault(
                "frame_jump",
                _rows(recording.row[k:]),
                f"Something moved {place}: {what} by {1e3 * shift:.3g} mm and {1e3 * turn:.3g} mrad "
                f"({1e3 * jump.moved:.3g} mm in the poses from there on, p = {jump.p:.1g}). The poses from that row "
                "on have been put back by this constant twist. Check the mount; record again where it matters.",
            )
        )
    if not jumps:
        reason = f"the likeliest row is as likely as p = {sought.p:.2g} by chance"
        if sought.drifted:
            reason = "what changes does so over many rows, as physics does, and between no two of them"
        found.clear("frame_jump", f"Neither the sensor's frame nor the tool jumped at a row: {reason}.")
    return arm


def _settled_joints(arm: Rigid, found: _Findings) -> Rigid:
    if arm.recording.motion != "static":
        found.clear("unsettled_readouts", "The arm moved while it was recorded: there is no rest to wait for.")
        return arm
    first = sequence.seek_unsettled(arm)
    if first.shape not in (None, "rows"):
        arm, first = sequence.settled(arm, first)
    if first.shape is None:
        reason = f"The joints were read at rest: what the moves before would explain has p = {first.p:.2g}."
        if first.foretold:
            reason = (
                f"Whether the joints were read at rest cannot be told: the moves before explain the poses (p = "
                f"{first.p:.2g}), but so do the moves after, the poses being in an orderly sequence. Record some in "
                "random order."
            )
        found.clear("unsettled_readouts", reason)
        return arm
    joints = (
        "all joints" if len(first.joints) == arm.recording.dof else ", ".join(f"joint {j + 1}" for j in first.joints)
    )
    rows: tuple[int, ...] = ()
    if first.shape == "rows":
        rows = _rows(arm.recording.row[first.samples])
        where = _named(rows, False)
        size = f"in {where} the arm was further along its move than the joints say, by {first.rest[0]:.2g} of it"
        done = "these rows count for little"
    else:
        largest = float(np.sqrt(np.mean(first.correction**2, 0)).max())
        share = {
            "move": "a share of each move was still to come",
            "velocity": "the pose shows the joints a while later, at the recorded velocities",
            "constant": "the same angle was still to come after each move, against the sign of backlash",
        }[first.shape]
        largest_joint = int(np.argmax(np.abs(first.rest)))
        number = f"{first.rest[largest_joint]:.3g} ± {first.std[largest_joint]:.1g}"
        unit = {"move": "of the move", "velocity": "s", "constant": "rad"}[first.shape]
        size = f"{share} ({joints}; {number} {unit}, up to {1e3 * largest:.2g} mrad RMS)"
        done = "the rest has been added to the joints"
    found.faults.append(
        Fault(
            "unsettled_readouts",
            rows,
            f"The joints were read before the arm had settled: {size}; {done}. Wait longer before reading, or read the "
            "joints when the pose is measured.",
        )
    )
    return arm


def _table(arm: Rigid, geometry: Geometry, found: _Findings) -> tuple[Recording, Arm]:
    compared = hypotheses.other_table(arm)
    recording, nominal, other = arm.recording, arm.arm, compared.name
    if other is None:
        why = "the chain is the arm's own file" if arm.exact else f"{nominal.name} has one table here"
        found.clear("nominal_table", f"No other nominal table comes into question: {why}.")
        return recording, nominal
    if compared.share is not None:
        share, std = compared.share
        number = f"on the way from the declared table (0) to {other} (1) the data lie at {share:.2f} ± {std:.1g}"
        if np.isinf(std):
            number = "the data cannot tell them apart"
    else:
        assert compared.scales is not None
        ours, theirs, free = compared.scales
        number = (
            f"residuals are {ours / free:.3g} times those of a fitted chain with {nominal.name}, {theirs / free:.3g} "
            f"times with {other}"
        )
    if not compared.decided:
        rest = "" if arm.exact else "; the chain is fitted, so that it matters little"
        found.clear("nominal_table", f"The data do not ask for the table {other}: {number}{rest}.")
        return recording, nominal
    done, advice = f"{other} is used", "Name it in the sidecar."
    if arm.exact and geometry != "declared":
        done, advice = "the chain was asked for and is left", f"Use --geometry free, or the file of {other}."
    else:
        recording, nominal = hypotheses.with_table(recording, other)
        if arm.exact:
            done = f"the chain is fitted, from {other}"
    found.faults.append(Fault("nominal_table", (), f"The declared table is not this arm's: {number}; {done}. {advice}"))
    return recording, nominal


def _rows(rows: NDArray[np.integer]) -> tuple[int, ...]:
    return tuple(int(row) for row in np.sort(rows))


def _named(rows: tuple[int, ...], verb: bool = True) -> str:
    """A few row numbers in words."""
    if len(rows) == 1:
        return f"row {rows[0]}{' is' if verb else ''}"
    few = ", ".join(map(str, rows[:_SHOWN]))
    more = f" and {len(rows) - _SHOWN} more" if len(rows) > _SHOWN else ""
    return f"{len(rows)} rows ({few}{more}){' are' if verb else ''}"
