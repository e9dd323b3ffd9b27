"""Faults that the rows of a recording show without a fit: order, repeats, units, turns, commands for measurements.

Each function is a screen: it returns the state with its fault corrected, or with the numbers that rule it out.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.readings import FEWEST, computed_by_controller
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.domains.pose.screening.screened import Screened
from lite6jax.recordings import repeated_rows, time_disorder
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.recordings.motion import at_positions, without_turns

Array = NDArray[np.floating]

_GRIDS = ((1e-4, "rad"), (float(np.deg2rad(0.01)), "deg"))
"""Spacing of commands in rad, and the unit in which it is round."""


def sort_rows(state: Screened, options: ScreeningOptions) -> Screened:
    """The rows of each run by time, where one is before an earlier row."""
    recording = state.recording
    late, step_back = time_disorder(recording)
    if not late.size:
        return state.rule_out("time_order", samples=recording.samples, timed=recording.time is not None)
    fault = DataFault("time_order", row_numbers(recording.row[late]), {"largest_step_back_s": step_back})
    return state.corrected(fault, recording.sorted_by_time())


def drop_repeats(state: Screened, options: ScreeningOptions) -> Screened:
    """Each row once: rows that repeat an earlier one in joints and pose, to the last digit, are dropped."""
    again, first = repeated_rows(state.recording)
    if not again.size:
        return state.rule_out("repeated_rows", samples=state.recording.samples)
    kept = np.ones(state.recording.samples, bool)
    kept[again] = False
    row = state.recording.row
    first_rows = row[first][np.argsort(row[again])].tolist()
    fault = DataFault("repeated_rows", row_numbers(row[again]), {"first_rows": first_rows})
    return state.corrected(fault, state.recording.select(kept))


def convert_positions(state: Screened, options: ScreeningOptions) -> Screened:
    """Positions in m, where some rows are a thousand times too far away or too near."""
    recording, position = state.recording, state.recording.position
    assert position is not None
    middle = np.median(position, axis=0)
    size = max(float(np.median(np.linalg.norm(position - middle, axis=1))), 1e-6)

    def distance(points: Array) -> Array:
        return np.linalg.norm(points - middle, axis=1)

    far = distance(position) > options.suspect_distances * size
    far &= distance(position / 1000) < options.cluster_distances * size
    near = np.linalg.norm(position, axis=1) < options.near_share * size
    near &= distance(position * 1000) < options.near_distances * size
    near &= np.mean(near) < options.most_in_another_unit  # positions of one point are near themselves in any unit
    if not (far | near).any():
        largest = float(distance(position).max())
        return state.rule_out("position_unit", largest_distance_m=largest, median_distance_m=size)
    factor = np.where(far, 1e3, np.where(near, 1e-3, 1.0))
    numbers = {"factor": float(factor.max() if factor.max() > 1 else factor.min())}
    fault = DataFault("position_unit", row_numbers(recording.row[factor != 1]), numbers)
    return state.corrected(fault, replace(recording, position=position * (1 / factor)[:, None]))


def note_commanded(state: Screened, options: ScreeningOptions) -> Screened:
    """As it is, where joints are round numbers: they were commanded."""
    recording = state.recording
    if recording.settings.joint_source == "commanded":
        return state.rule_out("commanded_joints", reason="declared")
    values = np.unique(np.abs(recording.joint_position))
    values = values[values > options.grid_smallest_rad]

    def share(grid: float) -> float:
        on_grid = np.abs(values - np.round(values / grid) * grid) < options.grid_tolerance_rad
        return float(np.mean(on_grid)) if values.size else 0.0

    largest, (grid, unit) = max(((share(grid), (grid, unit)) for grid, unit in _GRIDS), key=lambda item: item[0])
    named = {"grid_rad": grid, "grid_unit": unit}
    if values.size >= options.grid_positions and largest == 1.0:
        numbers = {"distinct_positions": int(values.size), **named}
        return state.corrected(DataFault("commanded_joints", (), numbers))
    return state.rule_out("commanded_joints", reason="not_round", share=largest, **named)


def note_computed(state: Screened, options: ScreeningOptions) -> Screened:
    """As it is, where the chain reproduces the poses to their rounding: a controller computed them."""
    arm, recording = state.rigid_arm, state.recording
    if recording.settings.pose_source == "controller_fk":
        return state.rule_out("computed_pose", reason="declared")
    error, position = float(np.median(arm.distance)), recording.position
    assert position is not None
    computed = computed_by_controller(error, position, recording.joint_position)
    computed &= recording.samples >= FEWEST  # frame and tool reproduce the poses of very few rows
    if not computed or float(np.median(arm.turn)) > options.computed_rad:
        return state.rule_out("computed_pose", reason="measured")
    numbers = {"median_error_m": error, "chain": "factory" if arm.exact else "nominal"}
    return state.corrected(DataFault("computed_pose", (), numbers))


def remove_turns(state: Screened, options: ScreeningOptions) -> Screened:
    """Joints without whole turns, where they wrap round in a trajectory or are beyond their limits by such turns."""
    recording, slack = state.recording, options.limit_slack_rad
    limits = state.rigid_arm.arm.joint_limits
    q = without_turns(recording, limits, slack)
    changed = np.abs(q - recording.joint_position) > 1.0
    if not changed.any():
        low, high = limits.T
        beyond = np.maximum(low - recording.joint_position, recording.joint_position - high)
        outside = float(np.max(beyond, initial=-np.inf))
        return state.rule_out("joint_turns", outside_limits_rad=outside if outside > slack else 0.0)
    joints = [int(j) + 1 for j in np.flatnonzero(changed.any(0))]
    fault = DataFault("joint_turns", row_numbers(recording.row[changed.any(1)]), {"joints": joints})
    state = state.corrected(fault, at_positions(recording, q))
    return state.transformed(lambda r: at_positions(r, without_turns(r, limits, slack)))
