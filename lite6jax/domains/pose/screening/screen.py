"""Faults of the data before any physics: found, located, said in words, and put right in the recording that is used."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.domains.pose.screening import columns as hypotheses
from lite6jax.domains.pose.screening import frame_jumps as jumps
from lite6jax.domains.pose.screening import settling
from lite6jax.domains.pose.screening.rigid import Rigid, rigid_of
from lite6jax.domains.pose.screening.rows import (
    Fault,
    Findings,
    check_commanded,
    in_metres,
    in_order,
    named,
    once,
    rows_of,
    without_turns,
)
from lite6jax.fitting.problem import Geometry
from lite6jax.recordings import Recording, require_samples

_MOST_REREAD = 3


class Mending(NamedTuple):
    """Which faults that physics may look like are put right.

    Attributes:
        jumps: how many at most.
        beside_physics: whether a jump is measured beside all that physics could do, or as if there were none.
        table: the nominal table to be taken where the data leave it open.
    """

    jumps: int = 3
    beside_physics: bool = True
    table: str | None = None


@dataclass(frozen=True, eq=False)
class Examined:
    """A recording without the faults that were found.

    Attributes:
        recording: as a diagnosis shall use it.
        arm: the nominal arm.
        faults: what was wrong, in the order in which it was put right.
        checked: what was looked for and is not there, each with the number that rules it out.
        mending: what was to be put right of what physics may look like.
        doubted: another nominal table that fits better than the declared one, though not so that physics is no
            other reason; None where there is none.
    """

    recording: Recording
    arm: Arm
    faults: tuple[Fault, ...]
    checked: tuple[Fault, ...]
    mending: Mending
    doubted: str | None = None


def examine(
    recording: Recording, arm: Arm | None = None, geometry: Geometry = "declared", mending: Mending | None = None
) -> Examined:
    """Looks for faults of the data, the coarsest first, and puts each right before the next is looked for.

    Args:
        recording: measured poses.
        arm: the nominal arm; from the sidecar where not given.
        geometry: what is known of it, as in `fit`.
        mending: of faults that physics may look like; all where not given.

    Raises:
        InputError: no measured poses, or as `recording_problem`.
    """
    require_samples(recording, 1)
    mending = mending or Mending()
    found = Findings([], [])
    recording = in_order(recording, found)
    recording = once(recording, found)
    recording = in_metres(recording, found)
    rigid = rigid_of(recording, arm, geometry)
    check_commanded(recording, found)
    rigid = _reread(rigid, geometry, found)
    rigid = replace(rigid, recording=without_turns(rigid.recording, rigid.arm, found))
    rigid = _settled_frame(rigid.fitted(), found, mending)
    rigid = _settled_joints(rigid, found)
    recording, nominal, doubted = _table(rigid, geometry, found, mending.table)
    return Examined(recording, nominal, tuple(found.faults), tuple(found.checked), mending, doubted)


def _reread(arm: Rigid, geometry: Geometry, found: Findings) -> Rigid:
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


def _read_well(arm: Rigid, tried: hypotheses.Reread, found: Findings) -> None:
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


def _settled_frame(arm: Rigid, found: Findings, mending: Mending) -> Rigid:
    if not mending.jumps:
        return arm
    known: set[tuple[int, str]] = set()
    while (sought := jumps.seek_jump(arm)).jump is not None and len(known) < mending.jumps:
        if sought.jump[:2] in known:  # what is left after it was put back is no constant twist
            break
        known.add(sought.jump[:2])
        arm, jump = jumps.put_back(arm, sought.jump, mending.beside_physics)
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
                rows_of(recording.row[k:]),
                f"Something moved {place}: {what} by {1e3 * shift:.3g} mm and {1e3 * turn:.3g} mrad "
                f"({1e3 * jump.moved:.3g} mm in the poses from there on, p = {jump.p:.1g}). The poses from that row "
                "on have been put back by this constant twist. Check the mount; record again where it matters.",
            )
        )
    if not known:
        reason = f"the likeliest row is as likely as p = {sought.p:.2g} by chance"
        if sought.drifted:
            reason = "what changes does so over many rows, as physics does, and between no two of them"
        if np.isnan(sought.p):
            reason = f"{arm.samples} rows are too few to tell"
        found.clear("frame_jump", f"Neither the sensor's frame nor the tool jumped at a row: {reason}.")
    return arm


def _settled_joints(arm: Rigid, found: Findings) -> Rigid:
    if arm.recording.motion != "static":
        found.clear("unsettled_readouts", "The arm moved while it was recorded: there is no rest to wait for.")
        return arm
    first = settling.seek_unsettled(arm)
    if first.shape not in (None, "rows"):
        arm, first = settling.settled(arm, first)
    if first.shape is None:
        reason = f"The joints were read at rest: what the moves before would explain has p = {first.p:.2g}."
        if np.isnan(first.p):
            reason = f"Whether the joints were read at rest cannot be told from {arm.samples} rows: record more."
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
        rows = rows_of(arm.recording.row[first.samples])
        where = named(rows, False)
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


def _table(arm: Rigid, geometry: Geometry, found: Findings, taken: str | None) -> tuple[Recording, Arm, str | None]:
    compared = hypotheses.other_table(arm)
    recording, nominal, other = arm.recording, arm.arm, compared.name
    if other is None:
        why = "the chain is the arm's own file" if arm.exact else f"{nominal.name} has one table here"
        found.clear("nominal_table", f"No other nominal table comes into question: {why}.")
        return recording, nominal, None
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
    if not compared.decided and other != taken:
        rest = "" if arm.exact else "; the chain is fitted, so that it matters little"
        found.clear("nominal_table", f"The data do not ask for the table {other}: {number}{rest}.")
        return recording, nominal, other if compared.likelier else None
    if not compared.decided:
        number = f"{other} leaves smaller residuals, and no physics with the declared one makes up for it"
    done, advice = f"{other} is used", "Name it in the sidecar."
    if arm.exact and geometry != "declared":
        done, advice = "the chain was asked for and is left", f"Use --geometry free, or the file of {other}."
    else:
        recording, nominal = hypotheses.with_table(recording, other)
        if arm.exact:
            done = f"{other} is used in place of the file"
    found.faults.append(Fault("nominal_table", (), f"The declared table is not this arm's: {number}; {done}. {advice}"))
    return recording, nominal, None
