"""What a recording's numbers reveal: refused where nothing can be made of them, located where a fit can still cope."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from lite6jax.errors import InputError
from lite6jax.recordings.recording import Recording, run_segments

LARGEST_MISSING_SHARE = 0.5
FAR_ROWS_SHARE = 0.1  # fewer far rows are outliers, which the diagnosis locates; a wrong unit spoils most rows
FAR_LIMITS = 2.0  # in multiples of the arm's widest limit: no swapped, mirrored or once-turned joint gets there
FAR_REACHES = 5.0  # a tool adds to the reach, but not this much


def drop_missing(recording: Recording, spelling: Mapping[str, str] | None = None) -> Recording:
    """The rows in which every recorded number is finite, with a note that counts the others.

    Args:
        spelling: SI column name to the name in the file, for the message.

    Raises:
        InputError: over half of the rows would go; the message names the column that costs most.
    """
    table = recording.columns()
    missing = {name: ~np.isfinite(column) for name, column in table.items()}
    bad = np.logical_or.reduce(list(missing.values()))
    count = int(bad.sum())
    if not count:
        return recording
    first = recording.row[np.argmax(bad)]
    if count > LARGEST_MISSING_SHARE * recording.samples:
        worst = max(missing, key=lambda name: int(missing[name].sum()))
        raise InputError(
            f"{recording.source}: {count} of {recording.samples} rows have NaN, infinite or empty fields, the first is "
            f"row {first}, most of them in column {(spelling or {}).get(worst, worst)} ({int(missing[worst].sum())}); "
            "fill or remove that column, or record again"
        )
    kept = recording.select(~bad)
    rows, verb = ("row", "that is") if count == 1 else ("rows", "the first is")
    note = f"dropped {count} {rows} with NaN, infinite or empty fields, {verb} row {first}"
    return replace(kept, notes=(*kept.notes, note))


def check_joint_scale(
    recording: Recording, joint_limits: ArrayLike, spelling: Mapping[str, str] | None = None, assumed: bool = False
) -> None:
    """Refuses joint positions so far outside the limits that they must be degrees.

    A few such rows are outliers and pass, and so do joints that are swapped, mirrored or a turn off: the diagnosis
    locates those.

    Args:
        joint_limits: `(joint, 2)` lowest and highest position in rad; infinite for a joint without end.
        spelling: SI column name to the name in the file, for the message.
        assumed: whether degrees have been assumed already, so that the message does not ask.

    Raises:
        InputError: a tenth of the rows or more are beyond twice the widest limit of the arm.
    """
    limits = _limits(recording, joint_limits)
    widest = np.max(np.abs(limits))
    far = np.abs(recording.joint_position) > FAR_LIMITS * widest
    rows = far.any(axis=1)
    if rows.mean() < FAR_ROWS_SHARE:
        return
    joint = int(np.argmax(far.sum(axis=0)))
    sample = int(np.argmax(far[:, joint]))
    name = (spelling or {}).get(f"q{joint + 1}_rad", f"q{joint + 1}_rad")
    asks = name.endswith("_rad") and not assumed
    remedy = "are these degrees? name the columns q1_deg ... or add --assume-degrees" if asks else "check the unit"
    raise InputError(
        f"{recording.source}: column {name}: row {recording.row[sample]} is at "
        f"{recording.joint_position[sample, joint]:.5g} rad while the arm's joint {joint + 1} goes from "
        f"{limits[joint, 0]:.4g} to {limits[joint, 1]:.4g} rad; {remedy}"
    )


def check_position_scale(
    recording: Recording, reach: float, spelling: Mapping[str, str] | None = None, assumed: bool = False
) -> None:
    """Refuses measured positions that spread, or lie from the base, so far that they must be millimetres.

    Medians decide, so outliers pass. Only `pose_frame: base` says where the base is; a tracker may stand anywhere.

    Args:
        reach: the arm's reach in m, without a tool.
        spelling, assumed: as in `check_joint_scale`.

    Raises:
        InputError: the median distance from the middle (or the base) is over five reaches.
    """
    if recording.position is None:
        return
    middle = np.median(recording.position, axis=0)
    distance = float(np.median(np.linalg.norm(recording.position - middle, axis=1)))
    place = "from their middle"
    if recording.settings.pose_frame == "base" and np.linalg.norm(middle) > distance:
        distance, place = float(np.linalg.norm(middle)), "from the base"
    if distance <= FAR_REACHES * reach:
        return
    names = [(spelling or {}).get(name, name) for name in ("x_m", "y_m", "z_m")]
    asks = names[0].endswith("_m") and not assumed
    remedy = (
        "are these millimetres? name the columns x_mm y_mm z_mm or add --assume-millimetres"
        if asks
        else "check the unit"
    )
    raise InputError(
        f"{recording.source}: columns {' '.join(names)}: the positions lie {distance:.4g} m {place} (median) while "
        f"the arm reaches {reach:.3g} m; {remedy}"
    )


def require_samples(recording: Recording, unknowns: int) -> None:
    """Refuses a recording that measures fewer numbers than are to be determined.

    Raises:
        InputError: no measured pose, or too few samples; the message gives both counts.
    """
    each = recording.numbers_per_sample
    if not each:
        raise InputError(f"{recording.source}: has no measured positions; a fit needs the columns x_m y_m z_m")
    given = each * recording.samples
    if given < unknowns:
        kind = "position and orientation" if each == 6 else "position without orientation"
        raise InputError(
            f"{recording.source}: {recording.samples} samples of {each} numbers ({kind}) give {given} numbers, fewer "
            f"than the {unknowns} to determine; record at least {-(-unknowns // each)} samples"
        )


@dataclass(frozen=True)
class TimeDisorder:
    """Samples whose time is before that of an earlier sample of the same run, and the largest such step back in s."""

    samples: Int[np.ndarray, " found"]
    rows: Int[np.ndarray, " found"]
    largest_step_back_s: float


def time_disorder(recording: Recording) -> TimeDisorder:
    """Finds rows out of time order within their run; empty where there are none or no times."""
    if recording.time is None:
        return TimeDisorder(np.empty(0, np.int64), np.empty(0, np.int64), 0.0)
    # the running maximum within each run: lift the ranks of every run above all before it, and one pass serves them all
    order = np.argsort(recording.time, kind="stable")
    rank = np.empty(recording.samples, np.int64)
    rank[order] = np.arange(recording.samples)
    lift = run_segments(recording.run) * recording.samples
    latest = recording.time[order][np.maximum.accumulate(rank + lift) - lift]
    back = latest - recording.time
    late = np.flatnonzero(back > 0)
    return TimeDisorder(late, recording.row[late], float(back.max()))


@dataclass(frozen=True)
class RepeatedRows:
    """Samples that equal an earlier one in joints, pose and load, and which one: `rows[i]` repeats `first_rows[i]`."""

    samples: Int[np.ndarray, " found"]
    rows: Int[np.ndarray, " found"]
    first_rows: Int[np.ndarray, " found"]


def repeated_rows(recording: Recording) -> RepeatedRows:
    """Finds samples with exactly the joints and pose of an earlier one, which a noisy sensor never gives twice."""
    blocks = (recording.joint_position, recording.position, recording.quaternion)
    table = np.column_stack([block for block in blocks if block is not None]) + 0.0  # -0.0 becomes 0.0
    # sorting whole rows is slow: sort one hash each, and compare in full only where it recurs
    factors = np.random.default_rng(0).integers(1, 2**63, size=table.shape[1], dtype=np.uint64) | np.uint64(1)
    key = (table.view(np.uint64) ^ (table.view(np.uint64) >> np.uint64(29))) @ factors
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    earlier = first[inverse]
    again = np.flatnonzero(earlier != np.arange(recording.samples))
    again = again[(table[again] == table[earlier[again]]).all(axis=1)]
    return RepeatedRows(again, recording.row[again], recording.row[earlier[again]])


@dataclass(frozen=True)
class OutsideLimits:
    """Samples of one joint (1-based) outside its limits, and by how much at most, in rad."""

    joint: int
    samples: Int[np.ndarray, " found"]
    rows: Int[np.ndarray, " found"]
    largest_excess_rad: float


def outside_limits(recording: Recording, joint_limits: ArrayLike, margin_rad: float = 0.002) -> list[OutsideLimits]:
    """Finds joints beyond their limits by more than `margin_rad` (the Lite 6 enforces its own to 0.1 deg)."""
    limits = np.asarray(joint_limits, dtype=float)
    excess = np.maximum(limits[:, 0] - recording.joint_position, recording.joint_position - limits[:, 1])
    found = []
    for joint in np.flatnonzero((excess > margin_rad).any(axis=0)):
        samples = np.flatnonzero(excess[:, joint] > margin_rad)
        found.append(OutsideLimits(int(joint) + 1, samples, recording.row[samples], float(excess[:, joint].max())))
    return found


def _limits(recording: Recording, joint_limits: ArrayLike) -> Float[np.ndarray, "joint 2"]:
    limits = np.asarray(joint_limits, dtype=float)
    if limits.shape != (recording.dof, 2):
        raise InputError(
            f"{recording.source}: has {recording.dof} joints, the arm {len(limits)}; choose the arm it is of"
        )
    return np.where(np.isfinite(limits), limits, [-2 * np.pi, 2 * np.pi])
