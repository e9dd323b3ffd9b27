"""Data faults of torque recordings: what cannot be diagnosed at all, and what is located, said and corrected."""

import itertools
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from lite6jax.arms.arm import Arm, as_revolute, by_kind, joint_size, joint_unit
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.faults import LIMIT_SLACK_RAD, Screened, whole_turns
from lite6jax.domains.torque.filtering import each_posture, evenly_timed, runs_of, sample_rate, spikes, without_spikes
from lite6jax.domains.torque.hypotheses import computed_torque, correct_faults, correct_signs
from lite6jax.domains.torque.problem import TorqueProblem
from lite6jax.domains.torque.rows import TorqueRows, require_joints, torque_rows
from lite6jax.effects.dynamic import DIRECTION_SPEED, direction
from lite6jax.errors import InputError
from lite6jax.estimation.least_squares import fit
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.score_test import score_test
from lite6jax.estimation.terms import Terms
from lite6jax.fields import field_values
from lite6jax.recordings import Recording, estimated_torque
from lite6jax.recordings.checks import STILL_RAD, check_torque_scale, check_velocity_scale
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.recordings.motion import at_positions, without_turns
from lite6jax.recordings.placeholders import Mark, possible_marks, without_marks
from lite6jax.recordings.sequence import run_segments, stretches

_LEAST_MOTION = 0.02
"""rad over which one joint moves at least, 2 mm of a prismatic one; noise of encoders is far below."""
_FEWEST_POSTURES = 12
"""At rest, of which gravity is compared: the offset of a joint and the moments of its load are four numbers."""
_MARKED_RAD = 0.1
"""rad, or m, by which a number that repeats is off the rows beside it, where it is a mark."""
_MARKED_SHARE = 0.2
"""The same of torques, of their standard deviation."""
_UNITS = {"mN m": 1e3, "N cm": 100.0, "kgf cm": 100 / 9.80665, "kN m": 1e-3, "lbf in": 8.8507, "kgf m": 1 / 9.80665}
"""Of torques, and how many are one N m."""
_SAME_UNIT = 0.15
"""Relative deviation of all factors from a unit's, up to which it is that."""
_ONE_UNIT = 1.5
"""Of the largest factor over the least, above which no unit is that of all joints."""
_FEWEST_AT_REST = 10
"""Rows from which a bias, or a dead zone, of a velocity is known."""
_FEWEST_IN_ZONE = 5
"""Rows in a row without a velocity, over which positions show whether the joint moves."""
_EVENT = 60.0
"""Squared residual over its robust scale, summed over joints, from which a sample may belong to a contact."""
_JOINED = 0.3
"""s between samples that belong to one contact."""
_LONGEST = 0.25
"""Share of a recording beyond which what is far from the model is no event."""
_WRONG_IN_A_ROW = 3
"""Samples that may be wrong without a contact."""
_MOST_EVENTS = 3
_PRESSED = 4.0
"""Standard deviations from which a joint takes part in a contact."""
_LONG = 0.25
"""s for which a joint rests at least; a reversal takes less."""
_FEWEST = 10
"""Filtered samples at rest that it takes to say anything."""
_ROWS_PER_NUMBER = 3
"""Filtered samples in motion for each number of the model with which those at rest are compared."""
_AWAY = 3.0
"""Times what is left in motion, from which what is left at rest is no noise."""
_SURE = 3.0
"""Standard deviations of Coulomb friction from which there is some: without, it has no direction that is in doubt."""
_BAND = 2.0
"""Times Coulomb friction, up to which static friction holds a joint: what is more has another cause."""


def screen_torques(recording: Recording, arm: Arm) -> Screened[TorqueRows]:
    """Refuses what cannot be diagnosed, and corrects spikes and what is declared wrongly.

    Args:
        recording: with torques or currents.
        arm: the declared arm.

    Raises:
        InputError: as `Recording.torques` and `torque_rows`; an arm at rest; velocities or torques in another unit; or
            an arm without inertial numbers that is declared to have them.
    """
    still = recording.motion == "static"
    recording = _postures(recording) if still else recording.sorted_by_time()
    recording.torques()  # refuses what has none
    _require_inertia(recording, arm)
    require_joints(recording, arm)
    columns = _without_placeholders(Screened(recording), still)
    doubt = 0.0
    if not still:
        columns = _without_turns(columns, arm, wraps_only=True)
        columns = _without_dead_zone(_without_velocity_bias(columns, arm), arm)
        recording, uneven, doubt = evenly_timed(columns.data)
        columns = columns.with_faults([] if uneven is None else [uneven], recording)
    recording = columns.data
    torque = recording.torques().T
    runs = each_posture(recording.samples).runs if still else runs_of(recording, sample_rate(recording))
    _require_motion(recording, arm)
    check_velocity_scale(recording)
    check_torque_scale(recording, arm)
    spiked = spikes(torque, as_revolute(recording.velocities().T, "rad/s", arm.slides), runs)
    data = torque_rows(recording, arm, without_spikes(torque, spiked))
    state = Screened(data, columns.found)
    if spiked.any():
        rows = row_numbers(recording.row[spiked.any(0)])
        joints = (1 + np.flatnonzero(spiked.any(1))).tolist()
        state = state.with_faults([DataFault("torque_spikes", rows, {"joints": joints, "count": int(spiked.sum())})])
    if recording.settings.torque_source == "unknown" and not still:
        if estimated_torque(recording):
            state = state.with_faults([DataFault("estimated_torque")])
        elif computed_torque(data):
            state = state.with_faults([DataFault("estimated_torque", (), {"reason": "no_friction"})])
    if recording.settings.inertial != "unknown":
        state = correct_faults(state)
    elif not still:
        state = correct_signs(state)
    _require_unit(recording, state.found)
    _require_axes(recording, state.found)
    if not still:
        # a joint beyond its limits may have another sign or zero, which has been settled now
        turned = _without_turns(Screened(state.data.recording), arm, wraps_only=False)
        if turned.found:
            state = state.with_faults(turned.found, torque_rows(turned.data, arm, state.data.torque))
    data = state.data
    stiction = held_by_friction(data)
    if stiction.found or np.any(doubt):
        spread = 0.0
        if np.any(doubt):
            spread = np.sqrt(np.abs(data.recorded.whole(np.square(doubt)))[:, data.rows])
        data = replace(data, slack=np.hypot(stiction.slack, spread), repeated=stiction.repeated)
    if not still:
        data = replace(data, turning=turning_friction(data))
    return state.with_faults(stiction.found, data)


def _without_placeholders(state: Screened[Recording], still: bool) -> Screened[Recording]:
    """Without the rows in which all joints or all torques hold one number that no row beside them leads to.

    Of a single joint only positions are compared: a torque that is far from its neighbours is a spike.
    """
    recording = state.data
    recorded = field_values(recording)

    def far(mark: Mark, rows: Integers, lost: Mask) -> Integers:
        values = recorded[mark.array]
        of_positions = mark.array == "joint_position"
        if mark.value is None or (mark.column is not None and (still or not of_positions)):
            return rows[:0]
        unmarked = ~lost
        unmarked[mark.samples] = False
        usual = np.median(values[unmarked], axis=0)
        if not still:
            time = recording.time if recording.time is not None else np.arange(float(recording.samples))
            usual = np.stack([np.interp(time, time[unmarked], row[unmarked]) for row in values.T], 1)[rows]
        threshold = _MARKED_RAD if of_positions else _MARKED_SHARE * np.std(values[unmarked], axis=0)
        away = rows[(np.abs(values[rows] - usual) > threshold).any(1)]
        return away if len(away) >= min(2, len(mark.samples)) else rows[:0]

    corrected, faults = without_marks(recording, possible_marks(recording), far)
    return state.with_faults(faults, corrected)


def _without_turns(state: Screened[Recording], arm: Arm, wraps_only: bool) -> Screened[Recording]:
    """Positions without whole turns, and the joints that had them.

    Args:
        state: of a motion.
        arm: whose limits say which turn it is.
        wraps_only: whether a joint that is beyond its limits by a turn all the time is left.
    """
    recording = state.data
    q = without_turns(recording, arm.possible_positions, LIMIT_SLACK_RAD)
    if wraps_only:
        q = np.where(np.ptp(q - recording.joint_position, axis=0) > 1.0, q, recording.joint_position)
    turned = whole_turns(recording, q)
    if turned is None:
        return state
    return state.with_faults([turned], at_positions(recording, q))


def _require_inertia(recording: Recording, arm: Arm) -> None:
    declared = recording.settings.inertial
    if declared != "unknown" and (arm.mass is None or arm.inertia is None):
        lacks = "masses" if arm.mass is None else "inertia tensors"
        raise InputError(
            f"{recording.source}: the arm {arm.name} has no {lacks}; add them to its description, or declare inertial: "
            "unknown in the sidecar, and they are fitted"
        )


def _require_unit(recording: Recording, faults: tuple[DataFault, ...]) -> None:
    for fault in faults:
        if fault.code != "torque_unit":
            continue
        factors = np.array(fault.numbers["factors"])
        listed = ", ".join(f"{factor:.2g}" for factor in factors)
        problem = (
            f"{recording.source}: the torques of joints 1 to {len(factors)} are {listed} times what the weight and the "
            "motion of the arm require: they are in another unit"
        )
        constants = fault.numbers["constants_Nm_per_A"]
        median_factor = float(np.median(factors))
        unit = next((name for name, size in _UNITS.items() if np.abs(factors / size - 1).max() < _SAME_UNIT), None)
        if constants is not None:
            remedy = f"check torque_constant_Nm_per_A: about {', '.join(f'{c:.2g}' for c in constants)} would fit"
        elif unit is not None:
            remedy = f"are these {unit}? divide them by {_UNITS[unit]:.4g}"
        elif median_factor < 1:
            constants = ", ".join(f"{1 / factor:.2g}" for factor in factors)
            remedy = (
                "are these currents in A, or per cent of a rating? declare the columns as current1_A ... (columns, in "
                f"the sidecar) with torque_constant_Nm_per_A: about {constants} would fit, take the published ones"
            )
        elif factors.max() > _ONE_UNIT * factors.min():
            ratings = ", ".join(f"{100 / factor:.2g}" for factor in factors)
            remedy = (
                f"are these per cent of each joint's rating, or counts? ratings of about {ratings} N m would fit: "
                "multiply the published ones by the columns over 100"
            )
        else:
            remedy = "are these mN m, or counts? name the columns tau1_mNm ..., or convert them"
        raise InputError(f"{problem}; {remedy}")


def _require_axes(recording: Recording, faults: tuple[DataFault, ...]) -> None:
    for fault in faults:
        if fault.code == "joint_axis":
            joint = fault.numbers["joint"]
            axis = fault.numbers["axis"]
            raise InputError(
                f"{recording.source}: the torques fit an arm whose joint {joint} turns about {axis} of its frame, "
                "where the description has z; correct the joint's axis in the arm's description"
            )


def _postures(recording: Recording) -> Recording:
    """Static postures in the order of the file, with a number in the place of times that they do not have."""
    if recording.samples < _FEWEST_POSTURES:
        raise InputError(
            f"{recording.source}: holds {recording.samples} static postures; record {_FEWEST_POSTURES} or more for a "
            "check of gravity, or a motion"
        )
    if recording.time is not None:
        return recording
    return replace(recording, time=np.arange(float(recording.samples)))


def _without_velocity_bias(state: Screened[Recording], arm: Arm) -> Screened[Recording]:
    """Velocities without their bias, and the joints that have one."""
    biased = _velocity_bias(state.data, arm)
    if not biased.any():
        return state
    at = np.flatnonzero(biased)
    fault = DataFault("velocity_bias", (), {"joints": (1 + at).tolist(), "bias_rad_per_s": biased[at].tolist()})
    assert state.data.joint_velocity is not None
    return state.with_faults([fault], replace(state.data, joint_velocity=state.data.joint_velocity - biased))


def _velocity_bias(recording: Recording, arm: Arm) -> Array:
    """`(joint,)` rad/s, m/s of prismatic joints, that recorded velocities show beyond those of the positions.

    A register may be off by a constant. At rest that is a direction of motion that is not there. The bias is what
    velocities show where positions stand still, and it has to be what they show on average too.
    """
    recorded = recording.joint_velocity
    time = recording.time
    biases = np.zeros(recording.dof)
    if recorded is None or recording.velocity_differentiated or time is None:
        return biases
    segment = run_segments(recording.run)
    runs = [np.flatnonzero(segment == run) for run in np.unique(segment)]
    runs = [rows for rows in runs if len(rows) > 1]
    if not runs:
        return biases
    gone = np.sum([recording.joint_position[rows[-1]] - recording.joint_position[rows[0]] for rows in runs], axis=0)
    shown = np.sum([np.trapezoid(recorded[rows], time[rows], axis=0) for rows in runs], axis=0)
    average = (shown - gone) / sum(float(time[rows[-1]] - time[rows[0]]) for rows in runs)
    moved = np.abs(np.diff(recording.joint_position, axis=0, append=recording.joint_position[-1:]))
    still = as_revolute(moved.T, "rad", arm.slides).T <= STILL_RAD
    for joint in range(recording.dof):
        idle_velocity = recorded[still[:, joint], joint]
        if len(idle_velocity) < _FEWEST_AT_REST:
            continue
        bias = float(np.median(idle_velocity))
        large = abs(as_revolute([bias], "rad/s", arm.slides[[joint]])[0]) > DIRECTION_SPEED / 2
        if (
            large
            and np.mean(np.abs(idle_velocity - bias) < abs(bias) / 2) > 0.8
            and abs(average[joint] - bias) < abs(bias) / 2
        ):
            biases[joint] = bias
    return biases


def _without_dead_zone(state: Screened[Recording], arm: Arm) -> Screened[Recording]:
    """A register's zeros replaced by the slope of the positions where it has a dead zone, and the joints concerned.

    It has one if no other reading is smaller, and the joint moves slowly through enough of the zeros.
    """
    recording = state.data
    recorded = recording.joint_velocity
    time = recording.time
    if recorded is None or recording.velocity_differentiated or time is None:
        return state
    velocity = recorded.copy()
    widths = dict[int, float]()
    segment = run_segments(recording.run)
    for joint in range(recording.dof):
        shown = np.abs(recorded[:, joint])
        zero = recorded[:, joint] == 0
        width = float(np.min(shown[~zero], initial=np.inf))
        if not zero.any() or as_revolute([width], "rad/s", arm.slides[[joint]])[0] < DIRECTION_SPEED:
            continue
        q = recording.joint_position[:, joint]
        dead = 0
        for rows in stretches(zero, segment):
            span = time[rows.stop - 1] - time[rows.start]
            if rows.stop - rows.start < _FEWEST_IN_ZONE or span <= 0:
                continue
            fastest = abs(q[rows.stop - 1] - q[rows.start]) / span
            dead += (rows.stop - rows.start) * bool(width / 8 < fastest < 2 * width)
        if dead >= _FEWEST_AT_REST:
            for rows in stretches(np.ones(recording.samples, bool), segment):
                if rows.stop - rows.start > 1:
                    slope = uniform_filter1d(np.gradient(q[rows], time[rows]), _FEWEST_IN_ZONE, mode="nearest")
                    velocity[rows, joint] = np.where(zero[rows], slope, velocity[rows, joint])
            widths[joint] = width
    if not widths:
        return state
    numbers = {"joints": [1 + joint for joint in widths], "width_rad_per_s": [*widths.values()]}
    return state.with_faults(
        [DataFault("velocity_dead_zone", (), numbers)], replace(recording, joint_velocity=velocity)
    )


def _require_motion(recording: Recording, arm: Arm) -> None:
    if as_revolute(np.ptp(recording.joint_position, axis=0), "rad", arm.slides).max() < _LEAST_MOTION:
        size_of_unit = {
            joint_unit("rad", slides): joint_size(_LEAST_MOTION, "rad", slides) for slides in arm.slides.tolist()
        }
        smallest = " or ".join(f"{size:g} {unit}" for unit, size in size_of_unit.items())
        raise InputError(
            f"{recording.source}: the arm is at rest (no joint moves by {smallest}); record a motion in which every "
            f"joint {'moves' if arm.sliding else 'turns'} both ways"
        )


def contacts(problem: TorqueProblem, options: EngineOptions) -> tuple[Mask, list[DataFault]]:
    """Samples `(sample,)` in which something else pushed the arm, and a data fault for each such event.

    They are few, together, and far from a model that has everything which most arms have; physics of the arm recurs.
    """
    none = np.zeros(problem.samples, bool)
    baseline = fit(problem, Terms(), options)
    simple = problem.simple
    confounded = score_test(problem, baseline, options).confounded(simple)
    terms = Terms(tuple(term for term, is_confounded in zip(simple, confounded, strict=True) if not is_confounded))
    fitted = fit(problem, terms, options)
    rows = fitted.residuals.rows
    robust = 1.4826 * np.median(np.abs(rows), axis=1)  # the standard deviation of what is not far away
    scaled = rows / np.maximum(robust, 1e-300)[:, None]
    away = np.sum(scaled**2, 0)
    time = problem.data.time[problem.chosen]
    runs = problem.run
    if not (away > _EVENT).any() or np.median(away) > 3 * problem.rows:
        return none, []
    inside = _joined(away > _EVENT, time, runs)
    events = stretches(inside, runs)
    if len(events) > _MOST_EVENTS or inside.mean() > _LONGEST:
        return none, []
    faults = []
    chosen = problem.data.recorded
    spread = 1 / chosen.cutoff + (_WRONG_IN_A_ROW - 1) / chosen.rate  # s, of a few wrong torques behind the low pass
    recording = problem.data.recording
    assert recording.time is not None
    velocity = np.asarray(problem.data.motion.joint_velocity)[:, problem.data.filter.kept[problem.chosen]]
    for event in events:
        if time[event.stop - 1] - time[event.start] <= spread:
            inside[event] = False
            continue
        size = np.sqrt(np.mean(scaled[:, event] ** 2, 1))
        joints = (1 + np.flatnonzero(size > _PRESSED)).tolist()
        turned = velocity[:, event.start] * velocity[:, event.stop - 1] < 0
        lasting = time[event.stop - 1] - time[event.start]
        if joints and turned[size > _PRESSED].all() and lasting <= spread + 1 / problem.data.motion_cutoff:
            inside[event] = False  # friction turns at once, and the low pass of the motion takes a while
            continue
        step = 0.5 * float(np.median(np.diff(time)))
        rows = (recording.time >= time[event.start] - step) & (recording.time <= time[event.stop - 1] + step)
        rows &= chosen.runs == runs[event.start]
        numbers = {"joints": joints, "from_s": float(time[event.start]), "to_s": float(time[event.stop - 1])}
        off = np.abs(fitted.residuals.rows[:, event] * problem.sigma[:, event]).max(1)
        worst = by_kind("largest_Nm", off, problem.data.arm.slides, np.max)
        faults.append(DataFault("contact", row_numbers(recording.row[rows]), numbers | worst))
    return inside, faults


def _joined(far: Mask, time: Array, runs: Integers) -> Mask:
    """With the samples between those that are far away, where these are near each other in time."""
    inside = far.copy()
    at = np.flatnonzero(far)
    for a, b in itertools.pairwise(at):
        if runs[a] == runs[b] and time[b] - time[a] <= _JOINED:
            inside[a:b] = True
    return inside


class RestFriction(NamedTuple):
    """What friction holds at rest.

    Attributes:
        slack: `(joint, sample)` Nm of every sample, one sigma of the torque that is indeterminate, times the square
            root of the samples of a rest, which are not independent; zero in motion, but beside a rest.
        repeated: `(sample,)`, those in which all joints rest, but for one of each rest.
        found: the data fault, if a joint is held.
    """

    slack: Array
    repeated: Mask
    found: tuple[DataFault, ...]


def at_rest(data: TorqueRows) -> Mask:
    """`(joint, sample)`, whether a joint rests for a quarter of a second or more around each sample."""
    speed = np.abs(as_revolute(np.asarray(data.motion.joint_velocity), "rad/s", data.arm.slides))
    slow = speed <= DIRECTION_SPEED
    fewest_samples = max(int(np.ceil(_LONG * data.filter.rate)), 2)
    runs = data.filter.runs
    still = np.zeros_like(slow)
    for row, out in zip(slow, still, strict=True):
        for rows in stretches(row, runs):
            out[rows] = rows.stop - rows.start >= fewest_samples
    return still


def held_by_friction(data: TorqueRows) -> RestFriction:
    """The slack of torques at rest: of joints whose torque there is far from a model of their torque in motion.

    The model has inertial numbers, offset, friction and rotor of the joint and its neighbours, fitted to the samples in
    motion. What it leaves at rest is compared with what it leaves in motion, and with the Coulomb friction found there.
    """
    still = at_rest(data)
    near = _around(still, data)
    slack = np.zeros(still.shape)
    repeated = np.zeros(still.shape[1], bool)
    filtered_rows = data.filter.kept
    joints = []
    bands = []
    for j in range(len(still)):
        resting = still[j, filtered_rows]
        band = 0.0
        if resting.sum() >= _FEWEST:
            band = _left_at_rest(data, j, resting, ~near[j, filtered_rows])
        if band:
            joints.append(j + 1)
            bands.append(band)
    if not joints:
        return RestFriction(slack, repeated, ())

    def kept_samples(flags: Mask) -> list[tuple[slice, Integers]]:
        spans = stretches(flags, data.filter.runs)
        return [(span, filtered_rows[(filtered_rows >= span.start) & (filtered_rows < span.stop)]) for span in spans]

    # one rest is one torque, however many samples show it
    for _, samples in kept_samples(np.logical_and.reduce(still)):
        repeated[samples[np.arange(len(samples)) != len(samples) // 2]] = True
    for j, band in zip(joints, bands, strict=True):
        for span, samples in kept_samples(near[j - 1]):
            single = samples[~repeated[samples]]
            slack[j - 1, span] = band * np.sqrt(max(len(samples), 1))
            slack[j - 1, single] = band * np.sqrt(max(len(single), 1))
    recording = data.recording
    rows = row_numbers(recording.row[data.rows[still[np.array(joints) - 1].any(0)]])
    numbers: dict[str, list] = {"joints": joints, "std_Nm": bands}
    if data.arm.sliding:
        numbers["prismatic_joints"] = [joint for joint in joints if data.arm.slides[joint - 1]]
    return RestFriction(slack, repeated, (DataFault("held_by_friction", rows, numbers),))


def _around(still: Mask, data: TorqueRows) -> Mask:
    """`(joint, sample)`, rest and the samples beside it, in which the low passes show what was at rest."""
    cutoff = min(data.motion_cutoff, data.filter.cutoff)
    reach = int(np.ceil(data.filter.rate / cutoff))
    near = still.copy()
    for row, out in zip(still, near, strict=True):
        for span in stretches(row, data.filter.runs):
            beside = slice(max(span.start - reach, 0), span.stop + reach)
            out[beside] |= data.filter.runs[beside] == data.filter.runs[span.start]
    return near


def turning_friction(data: TorqueRows) -> Array:
    """`(joint, sample)` Nm, one standard deviation of the torque of each joint where it reverses.

    A sign of mean d has the variance 1 - d². The mean of the direction of motion is that over the time of a sample, as
    it is not known where within this time a joint turns, and over the error of its velocity. Friction of c Nm is then
    uncertain by c·√(1 - d²); the low pass spreads that over the samples beside it.
    """
    motion = data.motion
    chosen = data.filter
    slides = data.arm.slides
    velocity = np.asarray(motion.joint_velocity)
    acceleration = np.asarray(motion.joint_acceleration)
    window = max(int(chosen.rate / (2 * data.motion_cutoff)), 1)  # shorter than what the low pass leaves
    away = uniform_filter1d(data.recording.velocities().T[:, data.rows] - velocity, window, mode="nearest")
    error = np.sqrt(np.maximum(uniform_filter1d(away**2, window, mode="nearest"), 0.0))  # it rounds
    wide = np.hypot(1.0, as_revolute(error, "rad/s", slides) / DIRECTION_SPEED)
    mean = direction(velocity / wide, slides, change=acceleration / chosen.rate / wide)
    still = _around(at_rest(data), data)[:, chosen.kept]
    friction = np.zeros(len(still))
    for j, resting in enumerate(still):
        model = _in_motion(data, j, ~resting)
        if model is not None and model.coulomb > _SURE * model.coulomb_std:
            friction[j] = model.coulomb
    return np.abs(chosen.whole(friction[:, None] * np.sqrt(np.maximum(1 - mean**2, 0.0))))


class _InMotion(NamedTuple):
    """A model of a joint in motion.

    Attributes:
        left: `(kept,)` Nm, what it leaves of every sample.
        usual: Nm, robust standard deviation of that in motion.
        coulomb: Nm, the joint's Coulomb friction.
        coulomb_std: Nm, the standard deviation of that.
        doubt: `(kept,)`, standard deviation of what it would leave, over that of a sample that was fitted.
    """

    left: Array
    usual: float
    coulomb: float
    coulomb_std: float
    doubt: Array


def _left_at_rest(data: TorqueRows, j: int, resting: Mask, moving: Mask) -> float:
    """Nm RMS that a model of a joint in motion leaves at rest; 0 where that is noise, or more than friction holds."""
    model = _in_motion(data, j, moving)
    if model is None:
        return 0.0
    residual = model.left[resting]
    away = float(np.sqrt(np.mean((residual / model.doubt[resting]) ** 2)))
    noise = away < _AWAY * model.usual or model.coulomb < model.usual
    if noise or np.median(np.abs(residual)) > _BAND * model.coulomb:
        return 0.0
    return float(np.sqrt(np.mean(residual**2)))


def _in_motion(data: TorqueRows, j: int, moving: Mask) -> _InMotion | None:
    """The model of a joint, fitted to the samples `(kept,)` in which it moves; None where these are too few."""
    velocity = np.asarray(data.motion.joint_velocity)[:, data.filter.kept]
    acceleration = np.asarray(data.motion.joint_acceleration)[j, data.filter.kept]
    slides = data.arm.slides
    near = [k for k in (j - 1, j + 1) if 0 <= k < len(velocity) and slides[k] == slides[j]]
    X = np.concatenate(
        [
            direction(velocity[j], slides[j])[None],  # first: its number is Coulomb friction
            *(part[None] for part in (np.ones(len(acceleration)), velocity[j], acceleration)),
            *(np.stack([velocity[k], direction(velocity[j] + velocity[k], slides[j])]) for k in near),
            data.regressor[j],
        ]
    )
    size = np.linalg.norm(X, axis=1)
    X = X[size > 0] / size[size > 0, None]
    if moving.sum() < _ROWS_PER_NUMBER * len(X):
        return None
    y = data.measured[j]
    U, s, V = np.linalg.svd(X[:, moving].T, full_matrices=False)
    determined = s > 1e-8 * s[0]
    into = (V[determined].T / s[determined]) @ U[:, determined].T
    numbers = into @ y[moving]
    residual = y - numbers @ X
    usual = 1.4826 * float(np.median(np.abs(residual[moving])))
    doubt = np.sqrt(1 + np.sum(((V[determined] @ X) / s[determined, None]) ** 2, 0))  # of a row that was not fitted
    coulomb = abs(float(numbers[0]))
    coulomb_std = usual * float(np.linalg.norm(into[0]))
    return _InMotion(residual, usual, coulomb / float(size[0]), coulomb_std / float(size[0]), doubt)
