"""The screening of pose recordings: faults of the data are found and corrected before any physics is estimated.

A screen finds a fault in a recording that all earlier screens have corrected, and corrects it before the next looks.
The coarsest come first: faults of rows are found without an arm, those of columns with the nominal arm and frames in
closed form, and those of the size of the sensor's noise with a fitted arm. A new fault is one entry here, its function,
and its sentences in `report.faults`. A screen returns the state with its fault corrected, or with the numbers that rule
it out; those here need no fit.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, final

import numpy as np
from threadpoolctl import threadpool_limits

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.array_types import Array
from lite6jax.calibration.problem import Geometry
from lite6jax.domains.faults import LIMIT_SLACK_RAD, whole_turns
from lite6jax.domains.pose.rigid_arm import RigidArm, rigid_arm
from lite6jax.domains.pose.screening import (
    changes,
    frame_jumps,
    hypotheses,
    orientations,
    placeholders,
    reading_zero,
    settling,
    stations,
)
from lite6jax.domains.pose.screening.screened import Corrections, ScreenedPoses
from lite6jax.domains.pose.screening.thresholds import MOST_FITTED
from lite6jax.errors import InputError
from lite6jax.estimation.prior import PRIOR, Prior
from lite6jax.recordings import Recording, repeated_rows, require_radians, require_samples, time_disorder
from lite6jax.recordings.alignment import angle_step, computed_by_controller, is_below_sensors, median_distance
from lite6jax.recordings.columns.kinematics import FEWEST
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.recordings.motion import at_positions, without_turns

_CLUSTER_DISTANCES = 5.0
"""Median distances within which a row lies in its right unit; in mm it is 1000 times as far."""
_SUSPECT_DISTANCES = 10.0
"""Median distances beyond which a row may be in mm; no pose is so far."""
_NEAR_SHARE = 0.005
"""Share of the median distance below which a row may be a thousand times too near; few poses are so near."""
_NEAR_DISTANCES = 2.0
"""Median distances within which such a row lies in its right unit; most origins lie beside the poses."""
_MOST_IN_ANOTHER_UNIT = 0.5
"""Share of the rows that may be too near; the rest shows the right unit."""
_COMPUTED_RAD = 1e-5
"""rad to which a table gives computed orientations: columns have five decimals."""
_GRID_TOLERANCE_RAD = 6e-7
"""rad from a grid of commanded positions: radians have six decimals."""
_GRID_SMALLEST_RAD = 1e-3
"""rad below which positions are left out, as they are near every grid."""
_GRID_POSITIONS = 20
"""Distinct positions that must all lie on a grid; fewer do so by chance."""

_GRIDS = ((1e-4, "rad"), (float(np.deg2rad(0.01)), "deg"))
"""Spacing of commands in rad, and the unit in which it is round."""


def sort_rows(state: ScreenedPoses) -> ScreenedPoses:
    """The rows of each run by time, where one is before an earlier row."""
    recording = state.recording
    late, step_back = time_disorder(recording)
    if not late.size:
        return state.rule_out("time_order", samples=recording.samples, timed=recording.time is not None)
    fault = DataFault("time_order", row_numbers(recording.row[late]), {"largest_step_back_s": step_back})
    return state.corrected(fault, recording.sorted_by_time())


def drop_repeats(state: ScreenedPoses) -> ScreenedPoses:
    """Each row once: rows that repeat an earlier one in joints and pose, to the last digit, are dropped."""
    again, first = repeated_rows(state.recording)
    if not again.size:
        return state.rule_out("repeated_rows", samples=state.recording.samples)
    retained = np.ones(state.recording.samples, bool)
    retained[again] = False
    row = state.recording.row
    first_rows = row[first][np.argsort(row[again])].tolist()
    fault = DataFault("repeated_rows", row_numbers(row[again]), {"first_rows": first_rows})
    return state.corrected(fault, state.recording.select(retained))


def convert_positions(state: ScreenedPoses) -> ScreenedPoses:
    """Positions in m, where some rows are a thousand times too far away or too near."""
    recording = state.recording
    position = state.recording.position
    assert position is not None
    factor = np.ones(recording.samples)
    farthest: list[tuple[float, float]] = []
    for station in np.unique(recording.station):  # each in a frame of its own
        rows = recording.station == station
        factor[rows], largest, size = _factors(position[rows])
        farthest.append((largest, size))
    if (factor == 1).all():
        largest, size = max(farthest, key=lambda distances: distances[0] / distances[1])
        return state.rule_out("position_unit", largest_distance_m=largest, median_distance_m=size)
    numbers = {"factor": float(factor.max() if factor.max() > 1 else factor.min())}
    fault = DataFault("position_unit", row_numbers(recording.row[factor != 1]), numbers)
    return state.corrected(fault, replace(recording, position=position * (1 / factor)[:, None]))


def _factors(position: Array) -> tuple[Array, float, float]:
    """By how much each position is too large `(sample,)`; and the largest and the median distance from their middle."""
    middle = np.median(position, axis=0)
    size = max(median_distance(position), 1e-6)

    def distance(points: Array) -> Array:
        return np.linalg.norm(points - middle, axis=1)

    far = distance(position) > _SUSPECT_DISTANCES * size
    far &= distance(position / 1000) < _CLUSTER_DISTANCES * size
    near = np.linalg.norm(position, axis=1) < _NEAR_SHARE * size
    near &= distance(position * 1000) < _NEAR_DISTANCES * size
    near &= np.mean(near) < _MOST_IN_ANOTHER_UNIT  # positions of one point are near themselves in any unit
    return np.where(far, 1e3, np.where(near, 1e-3, 1.0)), float(distance(position).max()), size


def note_commanded(state: ScreenedPoses) -> ScreenedPoses:
    """As it is, where joints are round numbers: they were commanded."""
    recording = state.recording
    if recording.settings.joint_source == "commanded":
        return state.rule_out("commanded_joints", reason="declared")
    values = np.unique(np.abs(recording.joint_position))
    values = values[values > _GRID_SMALLEST_RAD]

    def share(grid: float) -> float:
        on_grid = np.abs(values - np.round(values / grid) * grid) < _GRID_TOLERANCE_RAD
        return float(np.mean(on_grid)) if values.size else 0.0

    largest, (grid, unit) = max(((share(grid), (grid, unit)) for grid, unit in _GRIDS), key=lambda item: item[0])
    grid_numbers = {"grid_rad": grid, "grid_unit": unit}
    if values.size >= _GRID_POSITIONS and largest == 1.0:
        numbers = {"distinct_positions": int(values.size), **grid_numbers}
        return state.corrected(DataFault("commanded_joints", (), numbers))
    return state.rule_out("commanded_joints", reason="not_round", share=largest, **grid_numbers)


def drop_computed_orientations(state: ScreenedPoses) -> ScreenedPoses:
    """Positions alone, where a table reproduces the orientations to rounding and not the positions: two sources."""
    recording = state.recording
    if recording.quaternion is None or recording.readings is not None:
        return state
    if recording.settings.pose_source == "controller_fk":
        return state.rule_out("computed_orientation", reason="declared")
    limit = _COMPUTED_RAD + min(angle_step(recording.joint_position) * recording.dof**0.5, _COMPUTED_RAD)
    nominal, fitted = orientations.reproduced(state.rigid_arm)
    if min(nominal, fitted) > limit:
        return state.rule_out("computed_orientation", reason="measured", error_rad=min(nominal, fitted))
    alone = replace(recording, quaternion=None)
    arm = rigid_arm(alone, state.rigid_arm.arm, state.geometry, state.factory)
    positions = arm.fitted(MOST_FITTED)
    if _is_computed(positions):
        return state.rule_out("computed_orientation", reason="positions")
    table = "factory" if state.rigid_arm.exact else "nominal"
    numbers = {
        "error_rad": nominal if nominal <= limit else fitted,
        "chain": table if nominal <= limit else "fitted",
        "position_error_m": float(np.median(positions.distance)),
    }
    state = state.corrected(DataFault("computed_orientation", (), numbers), rigid=arm)
    return state.transformed(lambda r: replace(r, quaternion=None))


def note_computed(state: ScreenedPoses) -> ScreenedPoses:
    """As it is, where a table, or one that is fitted, reproduces the poses to rounding: a controller computed them."""
    arm = state.rigid_arm
    recording = state.recording
    if recording.settings.pose_source == "controller_fk":
        return state.rule_out("computed_pose", reason="declared")
    declared = rigid_arm(recording, arm.arm, state.geometry, state.factory)
    error = float(np.median(declared.distance))
    position = recording.position
    assert position is not None
    computed = computed_by_controller(error, position, recording.joint_position)
    computed &= recording.samples >= FEWEST  # frame and tool reproduce the poses of very few rows
    if computed and float(np.median(declared.turn)) <= _COMPUTED_RAD:
        numbers = {"median_error_m": error, "chain": "factory" if declared.exact else "nominal"}
        return state.corrected(DataFault("computed_pose", (), numbers))
    error = float(np.median(arm.distance))
    if _is_computed(arm) and float(np.median(arm.turn)) <= _COMPUTED_RAD:
        return state.corrected(DataFault("computed_pose", (), {"median_error_m": error, "chain": "fitted"}))
    return state.rule_out("computed_pose", reason="measured", median_error_m=error)


def _is_computed(fitted: RigidArm) -> bool:
    """Tells whether a fitted arm is nearer to the positions than any arm comes back to a place."""
    freedom = fitted.rows * fitted.samples - len(fitted.unknown)
    position = fitted.recording.position
    assert position is not None
    if freedom < len(fitted.unknown):
        return False
    grown = (fitted.rows * fitted.samples / freedom) ** 0.5
    return is_below_sensors(grown * float(np.median(fitted.distance)), position)


def remove_turns(state: ScreenedPoses) -> ScreenedPoses:
    """Joints without whole turns, where they wrap round in a trajectory or are beyond their limits by such turns."""
    recording = state.recording
    slack = LIMIT_SLACK_RAD
    limits = state.rigid_arm.arm.joint_limits
    q = without_turns(recording, limits, slack)
    turned = whole_turns(recording, q)
    if turned is None:
        low, high = limits.T
        beyond = np.maximum(low - recording.joint_position, recording.joint_position - high)
        outside = float(np.max(beyond, initial=-np.inf))
        return state.rule_out("joint_turns", outside_limits_rad=outside if outside > slack else 0.0)
    state = state.corrected(turned, at_positions(recording, q))
    return state.transformed(lambda r: at_positions(r, without_turns(r, limits, slack)))


@final
@dataclass(frozen=True)
class Screen:
    """One kind of fault, and what its correction costs.

    Attributes:
        codes: those of the faults that it reports.
        needs: the recording alone, the rigid arm as well, or that arm fitted.
        run: returns the state with its faults found and corrected, or with the numbers that rule them out.
        estimated: how many continuous quantities the correction of a fault estimates, whose cost a comparison with
            physics includes; none where the screen decides alone.
        located: whether that cost includes the choice of a row too.
        prior: the fault's name in `Prior`, where a comparison with physics includes its probability.
        of_touches: whether readings that are no poses may have its faults.
    """

    codes: tuple[str, ...]
    needs: Literal["recording", "arm", "fit"]
    run: Callable[[ScreenedPoses], ScreenedPoses]
    estimated: Callable[[DataFault], int] = lambda fault: 0
    located: bool = False
    prior: str = ""
    of_touches: bool = False


SCREENS = (
    Screen(("placeholder",), "recording", placeholders.leave_out_placeholders),
    Screen(("time_order",), "recording", sort_rows),
    Screen(("repeated_rows",), "recording", drop_repeats),
    Screen(("position_unit",), "recording", convert_positions),
    Screen(("commanded_joints",), "arm", note_commanded),
    Screen(("computed_orientation",), "arm", drop_computed_orientations),
    Screen(
        (*changes.CODES, "undecided", "other_arm", "unexplained"), "arm", hypotheses.correct_mismatch, of_touches=True
    ),
    Screen(
        ("distance_offset",),
        "fit",
        reading_zero.free_constant,
        estimated=lambda fault: 1,
        prior="distance_constant",
        of_touches=True,
    ),
    Screen((*changes.CODES, "arm_deviation"), "fit", hypotheses.explain_deviation, of_touches=True),
    Screen(("computed_pose",), "arm", note_computed),
    Screen(("joint_turns",), "arm", remove_turns),
    Screen(
        ("frame_jump",), "fit", frame_jumps.remove_jumps, estimated=lambda fault: 6, located=True, prior="frame_jump"
    ),
    Screen(
        ("unsettled_readouts",),
        "fit",
        settling.settle_joints,
        estimated=settling.count_numbers,
        prior="unsettled_readouts",
    ),
    Screen(("nominal_table",), "fit", hypotheses.use_other_table, prior="nominal_table"),
)
"""All screens, in order."""


def price(screened: ScreenedPoses, numbers: float, samples: int) -> float:
    """Log-likelihood that the corrections made must gain over physics.

    It is −ln of the prior probability of each, ½ ln n for each quantity that is estimated (Schwarz), and ln of the
    samples for each row that is chosen.

    Args:
        screened: with the faults found.
        numbers: how many were measured, n: rows times samples.
        samples: how many.
    """
    corrections = [(screen, fault) for screen in SCREENS for fault in screened.found if fault.code in screen.codes]
    quantities = sum(screen.estimated(fault) for screen, fault in corrections)
    located = sum(screen.located for screen, _ in corrections)
    of_priors = sum(screened.prior.cost(screen.prior) for screen, _ in corrections if screen.prior)
    return of_priors + 0.5 * quantities * float(np.log(numbers)) + located * float(np.log(samples))


# a second thread gains little on matrices of this size, and costs many times as much where another job has a core
@threadpool_limits.wrap(limits=1, user_api="blas")
def screen(
    recording: Recording,
    arm: Arm | None = None,
    geometry: Geometry = "declared",
    prior: Prior = PRIOR,
    corrections: Corrections | None = None,
    factory: FactoryCalibration | None = None,
    allow_undecided: bool = False,
    coarse: bool = False,
) -> ScreenedPoses:
    """The recording without the faults of its data, and those faults.

    Args:
        recording: measured poses.
        arm: the nominal arm; from the sidecar where not given.
        geometry: what is known of it, as in `fit`.
        prior: the probabilities of explanations; those of the sidecar take their place.
        corrections: of faults that resemble physics; all where not given.
        factory: the arm's calibration; from the sidecar where not given.
        allow_undecided: whether poses may miss the arm grossly for one of several reasons that fit alike.
        coarse: whether only faults that show without a fit are looked for.

    Raises:
        InputError: no measured poses, joint positions that are degrees in all columns, an undecided mismatch,
            poses of another arm, or as `recording_problem`.
    """
    require_samples(recording, 1)
    prior = prior.given(recording.settings.prior or {})
    state = ScreenedPoses(
        recording, arm=arm, geometry=geometry, corrections=corrections or Corrections(), prior=prior, factory=factory
    )
    fitted = False
    for entry in SCREENS:
        if (coarse and entry.needs == "fit") or (recording.touches is not None and not entry.of_touches):
            continue
        if entry.needs != "recording" and state.rigid is None:
            if recording.stations:
                state = stations.join_stations(state)
            rigid = rigid_arm(state.recording, arm, geometry, factory)
            state = replace(state, rigid=rigid, arm=rigid.arm)
        if entry.needs == "fit" and not fitted:
            state = replace(state, rigid=state.rigid_arm.fitted(MOST_FITTED))
            fitted = True
        state = entry.run(state)
        if state.count("other_arm") and not allow_undecided:
            n = state.found[-1].numbers
            raise InputError(
                f"{recording.source}: its poses are not those of a {n['declared']} (off by "
                f"{1e3 * n['median_error_m']:.4g} mm, median) but of a {n['arm']} ({1e3 * n['corrected_error_m']:.3g} "
                f"mm); name that arm with `arm=NAME`, or in the sidecar"
            )
        if state.count("undecided") and not allow_undecided:
            error = 1e3 * state.found[-1].numbers["median_error_m"]
            raise InputError(
                f"{recording.source}: its poses miss the arm by {error:.4g} mm (median), for one of several reasons "
                "that fit alike; see them with `lite6jax check`, and correct the file"
            )
    assert state.arm is not None
    require_radians(state.recording.joint_position, state.arm.joint_limits, f"{recording.source}: joint_position")
    return state


def screen_rows(recording: Recording, arm: Arm | None = None) -> ScreenedPoses:
    """The recording without placeholders, in order, each row once and positions in m: the screens of rows."""
    require_samples(recording, 1)
    state = ScreenedPoses(recording, arm=arm, geometry="declared", corrections=Corrections())
    for entry in SCREENS:
        if entry.needs == "recording" and (recording.touches is None or entry.codes == ("time_order",)):
            state = entry.run(state)
    return state
