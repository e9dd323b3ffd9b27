"""Data faults of torque recordings: what cannot be diagnosed at all, and what is located, said and corrected."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from lite6jax.arms.arm import Arm
from lite6jax.domains.torque.filtering import runs_of, sample_rate, spikes, without_spikes
from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.domains.torque.rows import TorqueRows, torque_rows
from lite6jax.errors import InputError
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault, row_numbers

Array = NDArray[np.floating]

_LEAST_MOTION = 0.02
"""rad over which one joint moves at least; noise of encoders is far below."""
_VELOCITY_RATIO = (0.7, 1.4)
"""Recorded over differentiated velocity, beyond which they are of another unit or another joint."""
_WEIGHT_RATIO = 100.0
"""Measured over modelled torque, from which its unit is another."""
_CORRELATED = 0.9
"""Correlation of a measured with another joint's modelled torque from which columns may be swapped."""
_CLEARLY = 0.3
"""By which that exceeds the correlation with the joint's own."""
_TURNED = 0.5
"""rad between declared and fitted gravity from which the declaration is wrong rather than the base tilted."""
_UPRIGHT_SHARE = 0.5
"""Share of the residual's squares that another direction of gravity must explain."""
_EVENT = 60.0
"""Squared residual over its robust scale, summed over joints, from which a sample may belong to a contact."""
_JOINED = 0.3
"""s between samples that belong to one contact."""
_LONGEST = 0.25
"""Share of a recording beyond which what is far from the model is no event."""
_MOST_EVENTS = 3
_PRESSED = 4.0
"""Standard deviations from which a joint takes part in a contact."""


class ScreenedTorques(NamedTuple):
    """A recording as it is diagnosed.

    Attributes:
        data: filtered, with corrected columns.
        found: data faults.
        ruled_out: faults that were tested for and are not there.
    """

    data: TorqueRows
    found: tuple[DataFault, ...]
    ruled_out: tuple[DataFault, ...]


def screen_torques(recording: Recording, arm: Arm) -> ScreenedTorques:
    """Refuses what cannot be diagnosed, and corrects swapped and reversed columns, spikes and the gravity declared.

    Args:
        recording: with torques or currents.
        arm: the declared arm.

    Raises:
        InputError: as `Recording.torques` and `torque_rows`; an arm at rest; velocities or torques in another unit; or
            an arm without inertial numbers that is declared to have them.
    """
    recording = recording.sorted_by_time()
    torque = recording.torques().T
    _require_inertia(recording, arm)
    rate = sample_rate(recording)
    runs = runs_of(recording, rate)
    _require_motion(recording, rate)
    spiked = spikes(torque, runs)
    found = []
    if spiked.any():
        rows = row_numbers(recording.row[spiked.any(0)])
        joints = (1 + np.flatnonzero(spiked.any(1))).tolist()
        found.append(DataFault("torque_spikes", rows, {"joints": joints, "count": int(spiked.sum())}))
    data = torque_rows(recording, arm, without_spikes(torque, spiked))
    ruled_out: list[DataFault] = []
    if recording.settings.inertial != "unknown":
        _require_newton_metres(data)
        data, columns = _in_order(data)
        found += columns
        if not columns:
            ruled_out.append(DataFault("swapped_torques", (), {}))
    return ScreenedTorques(data, tuple(found), tuple(ruled_out))


def _require_inertia(recording: Recording, arm: Arm) -> None:
    declared = recording.settings.inertial
    if declared != "unknown" and (arm.mass is None or arm.inertia is None):
        lacks = "masses" if arm.mass is None else "inertia tensors"
        raise InputError(
            f"{recording.source}: the arm {arm.name} has no {lacks}; add them to its description, or declare inertial: "
            "unknown in the sidecar, and they are fitted"
        )


def _require_motion(recording: Recording, rate: float) -> None:
    q = recording.joint_position
    if np.ptp(q, axis=0).max() < _LEAST_MOTION:
        raise InputError(
            f"{recording.source}: the arm is at rest (no joint moves by {_LEAST_MOTION:g} rad); record a motion in "
            "which every joint turns both ways"
        )
    recorded, t = recording.velocities(), recording.time
    assert t is not None
    inside = (np.diff(recording.run) == 0) & (np.diff(t) > 0)
    steps = np.diff(q, axis=0)[inside] / np.diff(t)[inside][:, None]
    middle = 0.5 * (recorded[1:] + recorded[:-1])[inside]
    for joint, (v, moved) in enumerate(zip(middle.T, steps.T, strict=True), 1):
        if np.ptp(q[:, joint - 1]) < _LEAST_MOTION:
            continue
        # the slope with the larger error in the denominator is the smaller one
        ratio = float(v @ moved / max(moved @ moved, 1e-300))
        if ratio > _VELOCITY_RATIO[1] or (ratio < _VELOCITY_RATIO[0] and v @ moved / max(v @ v, 1e-300) > 1.4):
            unit = "degrees? name them dq1_deg_per_s …" if 40 < ratio < 80 else "another unit, or another joint's?"
            raise InputError(
                f"{recording.source}: dq{joint} is {ratio:.3g} times the change of q{joint}; is it in {unit}"
            )


def _require_newton_metres(data: TorqueRows) -> None:
    rigid = data.filter(data.bodies.dynamics(data.bodies.links).torque)
    loaded = np.sqrt(np.mean(rigid**2, 1)) > 0.05 * np.sqrt(np.mean(rigid**2))
    ratio = np.sum(data.measured * rigid, 1)[loaded] / np.sum(rigid**2, 1)[loaded]
    typical = float(np.median(np.abs(ratio))) if loaded.any() else 1.0
    if typical > _WEIGHT_RATIO or typical < 1 / _WEIGHT_RATIO:
        unit = "mNm? name the columns tau1_mNm …" if typical > 1 else "kNm or an amplifier's units? give Nm"
        raise InputError(
            f"{data.recording.source}: the torques are {typical:.3g} times what the arm's weight and motion require; "
            f"are they in {unit}"
        )


def _in_order(data: TorqueRows) -> tuple[TorqueRows, list[DataFault]]:
    """With each torque in the column of its joint and of its sign, as far as the rigid arm shows."""
    rigid = data.filter(data.bodies.dynamics(data.bodies.links).torque)
    measured = data.measured
    both = np.corrcoef(np.concatenate([measured, rigid]))
    joints = len(rigid)
    # a joint that bears nothing correlates with nothing
    R = np.nan_to_num(both[:joints, joints:])
    order, sign = np.arange(joints), np.ones(joints)
    columns, place = linear_sum_assignment(-np.abs(R))
    for column, joint in zip(columns, place, strict=True):
        other = place[joint] if column != joint else joint
        mutual = abs(R[column, joint]) > _CORRELATED and abs(R[column, joint]) > abs(R[column, column]) + _CLEARLY
        if column != joint and mutual and abs(R[joint, other]) > _CORRELATED:
            order[joint] = column
    if sorted(order) != list(range(joints)):
        order = np.arange(joints)
    for joint in range(joints):
        if R[order[joint], joint] < -_CORRELATED:
            sign[joint] = -1.0
    found = []
    swapped = [int(j) + 1 for j in np.flatnonzero(order != np.arange(joints))]
    if swapped:
        sources = [int(order[j - 1]) + 1 for j in swapped]
        found.append(DataFault("swapped_torques", (), {"joints": swapped, "columns": sources}))
    reversed_ = [int(j) + 1 for j in np.flatnonzero(sign < 0)]
    if reversed_:
        found.append(DataFault("reversed_torque", (), {"joints": reversed_}))
    if not found:
        return data, []
    return torque_rows(data.recording, data.arm, sign[:, None] * data.torque[order]), found


def contacts(problem: TorqueProblem, options: EngineOptions) -> tuple[NDArray[np.bool_], list[DataFault]]:
    """Samples `(sample,)` in which something else pushed the arm, and a data fault for each such event.

    They are few, together, and far from a model that has everything which most arms have; physics of the arm recurs.
    """
    none = np.zeros(problem.samples, bool)
    baseline = fit(problem, Terms(), options)
    scores = zip(problem.ladder, score_test(problem, baseline, options).score(problem.ladder), strict=True)
    terms = Terms(tuple(term for term, score in scores if not score.confounded))
    found = fit(problem, terms, options)
    scaled = found.residuals.rows / np.maximum(_robust(found.residuals.rows), 1e-300)[:, None]
    away = np.sum(scaled**2, 0)
    time, runs = problem.data.time[problem.chosen], problem.run
    if not (away > _EVENT).any() or np.median(away) > 3 * problem.rows:
        return none, []
    inside = _joined(away > _EVENT, time, runs)
    events = _pieces(inside, runs)
    if len(events) > _MOST_EVENTS or inside.mean() > _LONGEST:
        return none, []
    faults = []
    recorded = problem.data.recording
    assert recorded.time is not None
    for event in events:
        if event.stop - event.start < 2:
            inside[event] = False
            continue
        size = np.sqrt(np.mean(scaled[:, event] ** 2, 1))
        joints = (1 + np.flatnonzero(size > _PRESSED)).tolist()
        step = 0.5 * float(np.median(np.diff(time)))
        rows = (recorded.time >= time[event.start] - step) & (recorded.time <= time[event.stop - 1] + step)
        rows &= problem.data.filter.runs == runs[event.start]
        numbers = {"joints": joints, "from_s": float(time[event.start]), "to_s": float(time[event.stop - 1])}
        worst = float(np.abs(found.residuals.rows[:, event] * problem.noise[:, None]).max())
        faults.append(DataFault("contact", row_numbers(recorded.row[rows]), numbers | {"largest_Nm": worst}))
    return inside, faults


def _robust(rows: Array) -> Array:
    """`(joint,)`, the standard deviation of what is not far away."""
    return 1.4826 * np.median(np.abs(rows), axis=1)


def _joined(far: NDArray[np.bool_], time: Array, runs: NDArray[np.integer]) -> NDArray[np.bool_]:
    """With the samples between those that are far away, where these are near each other in time."""
    inside, at = far.copy(), np.flatnonzero(far)
    for a, b in zip(at[:-1], at[1:], strict=True):
        if runs[a] == runs[b] and time[b] - time[a] <= _JOINED:
            inside[a:b] = True
    return inside


def _pieces(inside: NDArray[np.bool_], runs: NDArray[np.integer]) -> list[slice]:
    starts = np.flatnonzero(inside & ~(np.append(False, inside[:-1]) & (np.append(-1, runs[:-1]) == runs)))
    pieces = []
    for start in starts:
        stop = start + 1
        while stop < len(inside) and inside[stop] and runs[stop] == runs[start]:
            stop += 1
        pieces.append(slice(int(start), int(stop)))
    return pieces
