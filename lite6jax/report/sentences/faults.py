"""What is said of each fault of the data, where a condition changes the words; the other texts are in `faults.yaml`.

A function is named by the code of a fault and by what it says: `…_found` what is wrong, how it was corrected, and the
remedy; `…_ruled_out` why the fault is not there; `…_clause` the fault within a list of corrections.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from lite6jax.formatting import (
    be,
    capital,
    chance,
    counted,
    joined,
    joints_named,
    milli,
    number,
    paragraph,
    plural,
    significant,
)
from lite6jax.recordings.fault import DataFault
from lite6jax.report.words import fill, read_texts

Numbers = Mapping[str, Any]
Statement = Callable[[DataFault], str]
Clause = Callable[[Numbers], str]

FAULTS: Mapping[str, Mapping[str, Mapping[str, str]]] = read_texts("faults.yaml")
"""By domain and code the name of a fault, and those of its texts that depend on no condition."""
NAMES: Mapping[str, Mapping[str, str]] = {code: texts for faults in FAULTS.values() for code, texts in faults.items()}
"""The same of all domains, by code."""


# ------------------------------------------------------------------ phrases that several sentences share


def fault_clause(numbers: Numbers) -> str:
    """Says a fault within a list of corrections that explain the data; `numbers` have its code as `fault`."""
    clause = CLAUSES.get(numbers["fault"])
    if clause is not None:
        return clause(numbers)
    return fill(NAMES[numbers["fault"]]["clause"], numbers)


def has_clause(code: str) -> bool:
    """Tells whether a fault is said within a list of corrections."""
    return code in CLAUSES or "clause" in NAMES.get(code, {})


def either(alternatives: Iterable[Iterable[Numbers]]) -> str:
    """Lists corrections that explain the data alike."""
    return "; or ".join(joined(map(fault_clause, faults)) for faults in alternatives)


def _terms(labels: Sequence[str]) -> str:
    return ", ".join(labels) or "no effect"


def _listed(values: Iterable[float], digits: int = 2) -> str:
    return ", ".join(significant(value, digits) for value in values)


def _less_likely(numbers: Numbers, otherwise: str) -> str:
    """Says how much less likely the poses are without a fault; nothing where that was not compared."""
    if "log_likelihood_gap" not in numbers:
        return ""
    gap = numbers["log_likelihood_gap"]
    if gap < 0:
        return (
            f"{otherwise}, {_terms(numbers['rival_terms'])} would be more likely by {significant(-gap)} of "
            "log-likelihood, which distinguishes nothing: the explanation with less physics is kept."
        )
    return (
        f"{otherwise}, the best explanation ({_terms(numbers['rival_terms'])}) is less likely by "
        f"{significant(gap)} of log-likelihood."
    )


def _more_likely(numbers: Numbers) -> str:
    return (
        f"more likely by {significant(numbers['log_likelihood_gap'])} of log-likelihood, with "
        f"{_terms(numbers['rival_terms'])}."
    )


# ------------------------------------------------------------------ rows and columns


def placeholder_found(fault: DataFault) -> str:
    """Says which fields hold no measurement, and what stands in them."""
    numbers = fault.numbers
    mark = _placeholder(numbers["array"], numbers["column"], numbers["value"], numbers["unit"])
    count = len(fault.rows)
    return (
        f"{counted(count, 'row')} {plural(count, 'holds', 'hold')} no measurement: {mark}, as where the bus did not "
        f"answer or the sensor saw nothing. {plural(count, 'It was', 'They were')} left out. Leave such fields empty."
    )


def _placeholder(array: str, column: int | None, value: float | None, unit: str) -> str:
    """Says what was recorded instead of a measurement."""
    nouns = {"joint_position": "joints", "position": "coordinates"}
    quantities = nouns.get(array, "torques")
    if value is None:
        return f"all {quantities} are those of another row"
    shown = f"{value:.6g} {unit}"
    if unit == "rad" and value:
        shown += f" ({np.rad2deg(value):.6g} deg)"
    if unit == "m" and value:
        shown += f" ({1e3 * value:.6g} mm)"
    if column is None:
        return f"all {quantities} are {shown}"
    if array == "position":
        return f"{'xyz'[column - 1]} is {shown}"
    if array == "joint_position":
        return f"joint {column} is {shown}"
    return f"the torque of joint {column} is {shown}"


def time_order_found(fault: DataFault) -> str:
    """Says that rows are not in the order of their times."""
    count = len(fault.rows)
    return (
        f"{counted(count, 'row')} {be(count)} out of time order within {plural(count, 'its', 'their')} run, by "
        f"{significant(fault.numbers['largest_step_back_s'], 4)} s at most. The rows of each run were sorted by time. "
        "Check how the file was put together."
    )


def time_order_ruled_out(fault: DataFault) -> str:
    """Says that rows are in order, or have no times."""
    samples = fault.numbers["samples"]
    if fault.numbers["timed"]:
        return f"All {samples} rows are in time order within each run."
    return f"The {samples} rows have no times: their order is taken as the sequence."


def repeated_rows_found(fault: DataFault) -> str:
    """Says which rows repeat an earlier one."""
    count = len(fault.rows)
    return (
        f"{counted(count, 'row')} exactly {plural(count, 'repeats', 'repeat')} joints and pose of an earlier row "
        f"(row {fault.rows[0]} those of row {fault.numbers['first_rows'][0]}), which sensor noise makes impossible. "
        "Each was used once. Check whether the logger wrote rows twice or the sensor had stopped."
    )


def position_unit_found(fault: DataFault) -> str:
    """Says that some rows have positions in another unit."""
    size = "small"
    if fault.numbers["factor"] > 1:
        size = "large"
    return (
        f"The positions in {counted(len(fault.rows), 'row')} are a factor of 1000 too {size}: they are in another unit "
        "than the rest. They were converted. Check what wrote these rows."
    )


def _grid(numbers: Numbers) -> str:
    if numbers["grid_unit"] == "deg":
        return "0.01 deg"
    return f"{numbers['grid_rad']:g} rad"


def commanded_joints_found(fault: DataFault) -> str:
    """Says that joint positions are multiples of a step, which encoders do not read."""
    return (
        "The joint positions are commanded or rounded, not measured: all "
        f"{fault.numbers['distinct_positions']} joint positions are multiples of {_grid(fault.numbers)}, which "
        "encoders do not read. They were used unchanged; the servo error and the compliance of the gears are then part "
        "of the estimated physics. Record the encoders, or declare joint_source: commanded."
    )


def commanded_joints_ruled_out(fault: DataFault) -> str:
    """Says that joint positions are declared as commanded, or are measured."""
    if fault.numbers["reason"] == "declared":
        return (
            "The sidecar declares commanded joint positions; the servo error and the compliance of the gears are then "
            "part of the estimated physics."
        )
    return (
        f"The joint positions are measured, not commanded: {100 * fault.numbers['share']:.0f}% of them are multiples "
        f"of {_grid(fault.numbers)}."
    )


def no_joints_found(fault: DataFault) -> str:
    """Says which poses were measured at a time of which no joint positions were recorded."""
    count = len(fault.rows)
    return (
        f"{counted(count, 'row')} {plural(count, 'was', 'were')} left out: the clocks differ by "
        f"{significant(fault.numbers['clock_offset_s'], 4)} s, and the joint positions at that time were not recorded. "
        "Start the recording of the joints earlier and end it later."
    )


def outliers_found(fault: DataFault) -> str:
    """Says how many rows are outliers."""
    count = len(fault.rows)
    verb = plural(count, "is an outlier and has", "are outliers and have")
    return f"{counted(count, 'row')} {verb} little weight. Check them."


# ------------------------------------------------------------------ what makes poses miss the arm grossly


def mismatch_found(fault: DataFault, remedy: str) -> str:
    """Says which change of columns, frame, tool or sensor makes the poses fit, and by how much."""
    numbers = fault.numbers
    change = capital(fault_clause({**numbers, "fault": fault.code}))
    if "median_error_m" not in numbers:
        return f"{change}, together with the next fault."
    alternatives = numbers["alternatives"]
    also = ""
    if alternatives:
        also = f"These corrections fit about as well: {either(alternatives)}."
    return paragraph(
        f"{change}. This is corrected in memory whenever the file is read: the median error falls from "
        f"{milli(numbers['median_error_m'], 4)} mm to {milli(numbers['corrected_error_m'])} mm.",
        also,
        f"{remedy}.",
    )


def mismatch_ruled_out(numbers: Numbers, names: str) -> str:
    """Says why faults that make poses miss the arm grossly are not there."""
    if numbers.get("one_point"):
        return (
            "Signs, order, units and frames were not compared: the positions are one point, the same in every row, "
            "which shows neither a scale nor axes."
        )
    start = f"Not found: {names.lower()};"
    error = milli(numbers["median_error_m"])
    if "fitted_error_m" in numbers:
        return (
            f"{start} a change of geometry explains the median error of {error} mm, to "
            f"{milli(numbers['fitted_error_m'])} mm."
        )
    if "best_alternative_m" in numbers:
        best = milli(numbers["best_alternative_m"])
        return f"{start} the best correction leaves {best} mm of the median error of {error} mm."
    return (
        f"{start} the median error is {error} mm, and such faults are searched for above "
        f"{milli(numbers['suspected_above_m'])} mm."
    )


def declared_frame_clause(numbers: Numbers) -> str:
    """Says that poses are in another frame than declared, and where the base of the arm is in it."""
    placement = ""
    if "rotation_rad" in numbers:
        placement = _base_placement(numbers["rotation_rad"], numbers["translation_m"])
    return f"the poses are not in the frame that is declared{placement}"


def _base_placement(rotation: Sequence[float], translation: Sequence[float]) -> str:
    """Says how the base of the arm is turned and where it stands in the frame of the poses."""
    vector = np.array(rotation)
    shift = np.array(translation)
    angle = float(np.linalg.norm(vector))
    axis = vector
    if angle > 0:
        axis = vector / angle
    main = int(np.argmax(np.abs(axis)))
    about = f"about ({', '.join(f'{part:.2f}' for part in axis)})"
    if abs(axis[main]) > 0.999:
        about = f"about {'xyz'[main]}"
    placement = f": the base is turned by {np.rad2deg(angle):.4g} deg {about} in it"
    if np.linalg.norm(shift) > 2e-3:
        placement += f" and stands at ({', '.join(milli(part, 4) for part in shift)}) mm"
    if about == "about z" and abs(angle - np.pi) < 0.02:
        placement += ", as base_link and base of Universal Robots are to each other"
    return placement


def declared_tool_clause(numbers: Numbers) -> str:
    """Says that the tool is another one than declared, and where it is on the flange."""
    clause = "the tool is not the one that is declared"
    if "translation_m" not in numbers:
        return clause
    return f"{clause}; it is at ({', '.join(map(milli, numbers['translation_m']))}) mm on the flange"


def mirrored_sensor_clause(numbers: Numbers) -> str:
    """Says which axes of the sensor make it left-handed."""
    axes = numbers["axes"]
    start = "the axes of the sensor are left-handed"
    if len(axes) == 1:
        return f"{start} ({axes} is reversed, or an equivalent)"
    return f"{start} ({axes[0]} and {axes[1]} are exchanged, or an equivalent)"


_UNIT_RATIOS = {
    "inches and millimetres": 25.4,
    "inches and metres": 39.37,
    "feet and metres": 3.2808,
    "millimetres and centimetres": 10.0,
    "centimetres and metres": 100.0,
    "millimetres and metres": 1000.0,
}


def sensor_scale_clause(numbers: Numbers) -> str:
    """Says by which factor positions are too large, and what has such a factor."""
    factor = numbers["factor"]
    ratio = max(factor, 1 / factor)
    size = "small"
    if factor > 1:
        size = "large"
    near = (units for units, unit_ratio in _UNIT_RATIOS.items() if abs(ratio / unit_ratio - 1) < 0.01)
    units = next(near, "")
    if "square_m" in numbers:
        cause = (
            f"of a board whose squares are {milli(numbers['square_m'], 4)} mm and not the declared "
            f"{milli(numbers['declared_m'], 4)} mm"
        )
    elif units:
        cause = f"{units} are to each other"
    else:
        cause = "of a marker or board of another size than declared, or a sensor whose scale is off"
    return f"all positions are {ratio:.4g} times too {size}, as {cause}"


_CONVENTIONS = {
    "inverted": "inverted orientations (those of the sensor's frame in the tool's)",
    "scalar_last": "quaternions with the scalar last (x, y, z, w)",
    "inverted_scalar_last": "inverted orientations with the scalar last (x, y, z, w)",
}


def orientation_convention_clause(numbers: Numbers) -> str:
    """Says which convention the orientations have."""
    return f"the orientations are {_CONVENTIONS[numbers['convention']]}"


def joint_unit_clause(numbers: Numbers) -> str:
    """Says in which unit the column of a joint is."""
    unit = "radians though the others are in degrees"
    if numbers["unit"] == "deg":
        unit = "degrees"
    return f"joint {numbers['joint']} is in {unit}"


def coupled_joint_clause(numbers: Numbers) -> str:
    """Says from which other joint a column is to be freed."""
    joint = numbers["joint"]
    added_joint = numbers["added_joint"]
    sign = "−"
    if numbers["factor"] > 0:
        sign = "+"
    return f"joint {joint} is coupled to joint {added_joint} in its column: q{joint} = column {sign} q{added_joint}"


def joint_turns_clause(numbers: Numbers) -> str:
    """Says by how much the zero of a joint's column is off."""
    added = numbers["added_rad"]
    angle = f"{np.rad2deg(-added):+.3g} deg"
    if abs(abs(added) - math.pi) < 1e-5:
        angle = "half a turn"
    return f"the column of joint {numbers['joint']} has its zero off by {angle}"


def joint_turns_found(fault: DataFault) -> str:
    """Says which joints are off by whole turns, and in how many rows."""
    joints = fault.numbers["joints"]
    return (
        f"{capital(joints_named(joints))} {be(len(joints))} off by whole turns in {counted(len(fault.rows), 'row')}. "
        "The turns were removed, since gears and limits depend on them. Check where the encoder wraps."
    )


def joint_turns_ruled_out(fault: DataFault) -> str:
    """Says that no joint is off by whole turns, and how far its limits are exceeded."""
    beyond = fault.numbers["outside_limits_rad"]
    if beyond:
        return f"No joint is off by whole turns; the limits are exceeded by {significant(beyond)} rad at most."
    return "No joint is off by whole turns: all are within their limits."


def undecided_found(fault: DataFault) -> str:
    """Says that several corrections explain the poses or the torques alike."""
    numbers = fault.numbers
    alternatives = numbers["alternatives"]
    contradiction = "The torques contradict the arm"
    remainder = ""
    if "median_error_m" in numbers:
        contradiction = f"The poses miss the arm by {milli(numbers['median_error_m'], 4)} mm (median)"
        remainder = f", to {milli(numbers['corrected_error_m'])} mm"
    return (
        f"{contradiction}, and {len(alternatives)} corrections explain that alike{remainder}: {either(alternatives)}. "
        "Nothing was corrected. Find out which it is, and correct the file: what is found beside this is not to be "
        "trusted."
    )


def unexplained_found(fault: DataFault) -> str:
    """Says that no correction makes the poses fit the arm."""
    numbers = fault.numbers
    best = ""
    if numbers["best_alternative_m"] is not None:
        best = f" (the best leaves {milli(numbers['best_alternative_m'])} mm)"
    return (
        f"The poses miss the arm by {milli(numbers['median_error_m'], 4)} mm (median), and by "
        f"{milli(numbers['fitted_error_m'])} mm with its geometry fitted. That is no calibration error. No change of "
        f"frame, tool, axes, order, signs, zeros or units explains it{best}. Check that it is this arm, and that "
        "joints and poses of a row belong together."
    )


# ------------------------------------------------------------------ the arm and its table


def _deviation(numbers: Numbers) -> str:
    """Says how far a fitted arm is from the nominal one, beside what factories grant."""
    beside = f"{numbers['factor']:g} times"
    if numbers["factor"] <= 1:
        beside = "within"
    return (
        f"The fitted arm is {milli(numbers['distance_m'])} mm from the nominal one (median of the recorded poses), "
        f"{beside} what is granted ({milli(numbers['granted_m'])} mm and {np.rad2deg(numbers['granted_rad']):.2g} deg)."
    )


def _furthest(numbers: Numbers) -> str:
    """Names the frame that is furthest from where the table has it, and by how much."""
    where = f"the frame after joint {numbers['frame']}"
    if numbers["frame"] == 0:
        where = "the base"
    if "largest_m" in numbers:
        return f"{where}, by {milli(numbers['largest_m'])} mm along its {numbers['axis']}"
    return f"{where}, by {np.rad2deg(numbers['largest_rad']):.2g} deg about its {numbers['axis']}"


def arm_deviation_found(fault: DataFault) -> str:
    """Says that the fitted arm is further from its table than any calibration."""
    return (
        f"{_deviation(fault.numbers)} That is more than any calibration corrects ({_furthest(fault.numbers)}), and no "
        "zero of a joint, scale of the sensor, frame or tool alone explains it. The chain was fitted all the same. "
        "Check that it is this arm, and how its joints count."
    )


def arm_deviation_ruled_out(fault: DataFault) -> str:
    """Says that the chain is known, or that it is within what is granted."""
    if fault.numbers["reason"] == "known":
        return "The chain is known and not fitted: it takes up no fault of the data."
    return (
        f"{_deviation(fault.numbers)} No zero of a joint, scale of the sensor, frame or tool explains it better; the "
        f"furthest is {_furthest(fault.numbers)}."
    )


_CHAINS = {
    "nominal": "the nominal table",
    "factory": "the calibration file",
    "fitted": "a table that was fitted to them",
}


def computed_orientation_found(fault: DataFault) -> str:
    """Says which table computes the orientations, beside positions that were measured."""
    numbers = fault.numbers
    return (
        f"The orientations are those that {_CHAINS[numbers['chain']]} computes from the joints, to "
        f"{significant(1e6 * numbers['error_rad'], 2)} µrad, and the positions are not "
        f"({milli(numbers['position_error_m'])} mm): the controller's own orientations stand beside positions of a "
        "sensor. They show nothing of the arm and were left out. Name the columns of one source with --column."
    )


def computed_orientation_ruled_out(fault: DataFault) -> str:
    """Says where the orientations are from."""
    if fault.numbers["reason"] == "declared":
        return "The sidecar declares that the controller computed the orientations."
    if fault.numbers["reason"] == "positions":
        return "The orientations are not beside positions of another source: both are computed."
    return (
        "The orientations were measured: no table, and none that was fitted to them, computes them from the joints to "
        "rounding."
    )


def computed_pose_found(fault: DataFault) -> str:
    """Says which table computes the poses."""
    return (
        f"The poses are those that {_CHAINS[fault.numbers['chain']]} computes from the joints, to "
        f"{significant(1e6 * fault.numbers['median_error_m'], 2)} µm: no sensor measures so exactly. They are the "
        "controller's own forward kinematics and show nothing of the arm itself. Take the columns of a sensor, or "
        "declare pose_source: controller_fk."
    )


def computed_pose_ruled_out(fault: DataFault) -> str:
    """Says where the poses are from."""
    if fault.numbers["reason"] == "declared":
        return "The sidecar declares that the controller computed the poses: they compare tables and show no physics."
    return (
        "The poses were measured: no table computes them from the joints to rounding, and the one that was fitted to "
        f"them leaves {milli(fault.numbers['median_error_m'])} mm."
    )


def _tables_compared(numbers: Numbers) -> str:
    """Says how well each of two nominal tables fits."""
    if "share" in numbers:
        return (
            f"between the declared table (0) and {numbers['table']} (1), the data are at {numbers['share']:.2f} ± "
            f"{significant(numbers['share_std'], 1)}"
        )
    if "table_ratio" not in numbers:
        return "the data do not distinguish the two"
    return (
        f"residuals are {significant(numbers['declared_ratio'])} times those of a fitted chain with "
        f"{numbers['declared']}, and {significant(numbers['table_ratio'])} times with {numbers['table']}"
    )


def nominal_table_found(fault: DataFault) -> str:
    """Says that another table is that of the arm, why, and which was used."""
    numbers = fault.numbers
    table = numbers["table"]
    if numbers["decided"]:
        reason = _tables_compared(numbers)
    else:
        reason = f"{table} leaves smaller residuals, and no physics with the declared table compensates for that"
    chain = ""
    if numbers.get("chain") == "fitted":
        chain = "The chain was fitted from this table."
    elif "chain" in numbers:
        more = numbers.get("numbers_more", "its")
        chain = f"The chain was not fitted: a fit gains too little for {more} more parameters."
    uses = {
        "table": f"{table} was used. Name it in the sidecar.",
        "instead_of_file": f"{table} was used in place of the calibration file. Name it in the sidecar.",
        "none": f"The declared chain was used as requested. Use --geometry free, or the file of {table}.",
    }
    return paragraph(
        f"The declared table is not that of this arm: {reason}.",
        _less_likely(numbers, "With the declared table"),
        chain,
        uses[numbers["used"]],
    )


def nominal_table_ruled_out(fault: DataFault) -> str:
    """Says why no other table was tested, or that none fits better."""
    numbers = fault.numbers
    if numbers["reason"] == "own_chain":
        return "No other nominal table was tested: the calibration file is the arm's own."
    if numbers["reason"] == "single_table":
        return f"No other nominal table was tested: {numbers['declared']} has only one."
    if numbers["reason"] == "indistinguishable":
        return f"The data do not distinguish the declared table from {numbers['table']}."
    sentence = f"The data do not support the table {numbers['table']}: {_tables_compared(numbers)}."
    if numbers["fitted"]:
        return f"{sentence} The chain is fitted, so that the table matters little."
    return sentence


def calibration_off_found(fault: DataFault) -> str:
    """Says by how much all numbers of the calibration file are off."""
    numbers = fault.numbers
    return paragraph(
        f"All numbers of the calibration file are off by {milli(numbers['sigma_m'], 2)} mm and "
        f"{milli(numbers['sigma_rad'], 2)} mrad (one standard deviation), as those of a rounded or outdated file.",
        _less_likely(numbers, "With an exact file"),
        "The chain was fitted within that. Declare factory_uncertainty in the sidecar.",
    )


def calibration_off_ruled_out(fault: DataFault) -> str:
    """Says how much less likely all is with a file that is off."""
    numbers = fault.numbers
    return (
        f"The calibration file may be off everywhere, by {milli(numbers['sigma_m'], 2)} mm and mrad, but that is less "
        f"likely by {significant(numbers['log_likelihood_gap'], 2)} of log-likelihood; check it, or declare "
        "factory_uncertainty."
    )


# ------------------------------------------------------------------ the sensor and the encoders


def frame_jump_found(fault: DataFault) -> str:
    """Says at which row the sensor or the target moved, and by how much."""
    numbers = fault.numbers
    begins = ""
    if "run" in numbers:
        begins = f", where run {numbers['run']} begins"
    part = "the target or the tool on the flange"
    if numbers["part"] == "base":
        part = "the sensor or the base"
    return paragraph(
        f"At row {numbers['row']}{begins}, {part} moved by {milli(numbers['translation_m'])} mm and "
        f"{milli(numbers['rotation_rad'])} mrad ({milli(numbers['displacement_rms_m'])} mm RMS in the poses from there "
        f"on, {chance(numbers['p_value'], 1)}).",
        _less_likely(numbers, "Without a jump"),
        "This constant displacement was removed from the poses from that row on. Check the mount, and record again "
        "where it matters.",
    )


def frame_jump_ruled_out(fault: DataFault) -> str:
    """Says why there is no jump."""
    numbers = fault.numbers
    if numbers["reason"] == "physics":
        rows = joined(map(str, numbers["candidate_rows"]))
        return f"There is no frame jump at row {rows}: without one, the poses are {_more_likely(numbers)}"
    if numbers["reason"] == "gradual":
        return "There is no frame jump: what changes does so over many rows, as physics does."
    if numbers["reason"] == "too_few_rows":
        return f"{numbers['samples']} rows are too few to test for a frame jump."
    p_value = numbers["p_value"]
    if p_value < 0.01:
        return f"There is no frame jump that matters ({chance(p_value)})."
    return f"There is no frame jump ({chance(p_value)})."


_REMAINDERS = {
    "move": ("a share of each move remained", "of the move"),
    "velocity": ("the poses show the joints later, at the recorded velocities", "s"),
    "constant": ("the same angle remained after each move, against the sign of backlash", "rad"),
}
"""By the shape of what remained of a move: what it says, and the unit of its size."""


def unsettled_readouts_found(fault: DataFault) -> str:
    """Says which joints were read before the arm had settled, and what remained of the move."""
    numbers = fault.numbers
    meaning, unit = _REMAINDERS[numbers["shape"]]
    joints = ", ".join(f"joint {joint}" for joint in numbers["joints"])
    if numbers["all_joints"]:
        joints = "all joints"
    return paragraph(
        f"The joints were read before the arm had settled: {meaning} ({joints}; {significant(numbers['rest'])} ± "
        f"{significant(numbers['rest_std'], 1)} {unit}, up to {milli(numbers['largest_rms_rad'], 2)} mrad RMS).",
        _less_likely(numbers, "Without a correction"),
        "The remainder was added to the joint positions. Wait longer before reading, or read the joints when the pose "
        "is measured.",
    )


def unsettled_readouts_ruled_out(fault: DataFault) -> str:
    """Says that joints were read at rest, or why that was not tested."""
    numbers = fault.numbers
    if numbers["reason"] == "moving":
        return "Unsettled read-outs were not tested for: the arm moved while it was recorded."
    if numbers["reason"] == "too_few_rows":
        return f"{numbers['samples']} rows are too few to test for unsettled read-outs. Record more."
    if numbers["reason"] == "physics":
        return f"The joints were read at rest: without a correction, the poses are {_more_likely(numbers)}"
    shown = chance(numbers["p_value"])
    if numbers["reason"] == "ordered_poses":
        return (
            f"Unsettled read-outs cannot be tested for: the moves before explain the poses ({shown}), but the moves "
            "after explain them too, as the poses are in an orderly sequence. Record some in random order."
        )
    explained = "nothing"
    if numbers["p_value"] < 0.01:
        explained = "less than matters"
    return f"The joints were read at rest: the moves before explain {explained} ({shown})."


def distance_offset_found(fault: DataFault) -> str:
    """Says which constant all distances have."""
    numbers = fault.numbers
    return paragraph(
        f"All distances have a constant of {1e3 * numbers['constant_m']:+.4g} ± "
        f"{significant(1e3 * numbers['std_m'], 2)} mm: the zero of the wire is not set.",
        _less_likely(numbers, "Without a constant"),
        "It is fitted. Set the zero, or declare distance_offset: unknown.",
    )


def distance_offset_ruled_out(fault: DataFault) -> str:
    """Says that distances have no constant."""
    if fault.numbers["reason"] == "physics":
        return f"The distances have no constant: without one they are {_more_likely(fault.numbers)}"
    return "The distances show no constant: the zero of the wire is set."


def wandering_readout_found(fault: DataFault) -> str:
    """Says which joints have a read-out that wanders, how far, and for how long it remembers; and which err anew."""
    numbers = fault.numbers
    remembered = numbers.get("remembers") or [True] * len(numbers["joints"])  # of documents of earlier versions
    wandering = [k for k, remembers in enumerate(remembered) if remembers]
    independent = [k for k, remembers in enumerate(remembered) if not remembers]
    sentences = []
    if wandering:
        memory = _listed((numbers["memory_s"] or numbers["memory_samples"])[k] for k in wandering)
        unit = "rows"
        if numbers["memory_s"]:
            unit = "s"
        sentences.append(
            f"{_read_outs(numbers, wandering)} that wanders by itself: by {_microradians_of(numbers, wandering)} (one "
            f"standard deviation), with a memory of {memory} {unit}. Nothing that was recorded drives it. It is "
            "counted as noise. Record the temperatures of the joints, and check the encoders."
        )
    if independent:
        joints = joints_named([numbers["joints"][k] for k in independent])
        sentences.append(
            f"{_read_outs(numbers, independent)} that is another one in each row, of "
            f"{_microradians_of(numbers, independent)} (one standard deviation): noise of the encoder, or what these "
            f"rows are too few to resolve. Record rows along a slow motion of {joints}, at least 100."
        )
    return " ".join(sentences)


def _read_outs(numbers: Numbers, places: Sequence[int]) -> str:
    joints = [numbers["joints"][k] for k in places]
    return f"{capital(joints_named(joints))} {be(len(joints))} read out with an error"


def _microradians_of(numbers: Numbers, places: Sequence[int]) -> str:
    return f"{_listed(1e6 * numbers['std_rad'][k] for k in places)} µrad"


# ------------------------------------------------------------------ torques


def uneven_times_found(fault: DataFault) -> str:
    """Says how uneven times are, and how they were made even."""
    numbers = fault.numbers
    start = (
        f"Time steps vary, most of them from {significant(1e3 * numbers['from_s'])} to "
        f"{significant(1e3 * numbers['to_s'])} ms"
    )
    rate = significant(numbers["rate_Hz"])
    if numbers["reason"] == "stamps":
        return (
            f"{start}, but the positions are smooth over the number of the row: the stamps jitter, not the samples. "
            f"The times were made even, {rate} a second."
        )
    gaps = ""
    if numbers["gaps"]:
        gaps = f"{numbers['gaps']} gaps were too long to interpolate and begin a new run."
    return paragraph(
        f"{start}. The recording was resampled to {rate} a second by interpolation. Every other torque is within "
        f"{_listed(numbers['rms_Nm'])} Nm (RMS, by joint) of what its neighbours give, noise included.",
        gaps,
    )


def velocity_bias_found(fault: DataFault) -> str:
    """Says which bias the velocities of some joints have."""
    return (
        f"The velocity of {joints_named(fault.numbers['joints'])} has a bias of "
        f"{_listed(1e3 * bias for bias in fault.numbers['bias_rad_per_s'])} mrad/s (mm/s of a slide): it reads that "
        "where the position stands still, and exceeds the way gone by as much. It was subtracted."
    )


def velocity_dead_zone_found(fault: DataFault) -> str:
    """Says below which velocity some joints read nothing."""
    widths = fault.numbers["width_rad_per_s"]
    shown = ", ".join(f"{significant(1e3 * width, 2)} mrad/s" for width in widths)
    return (
        f"The velocity of {joints_named(fault.numbers['joints'])} reads nothing below {shown}, while the positions go "
        "on. There the slope of the positions was taken."
    )


def swapped_torques_found(fault: DataFault) -> str:
    """Says which column holds the torque of which joint."""
    pairs = zip(fault.numbers["columns"], fault.numbers["joints"], strict=True)
    exchanges = ", ".join(f"tau{column} is that of joint {joint}" for column, joint in pairs)
    return f"The torque columns are swapped: {exchanges}, by the weight and the motion of the arm. They were exchanged."


def coupled_positions_found(fault: DataFault) -> str:
    """Says from which two positions that of a joint is made."""
    sign = "less"
    if fault.numbers["factor"] > 0:
        sign = "plus"
    return (
        f"Torques fit the arm with the position of joint {fault.numbers['joint']} {sign} that of joint "
        f"{fault.numbers['added_joint']}: the motors of both are coupled, and the file has the motor's angle. The sum "
        "was taken."
    )


def wrong_torque_constant_clause(numbers: Numbers) -> str:
    """Says by which factors torques differ."""
    pairs = zip(numbers["factors"], numbers["joints"], strict=True)
    return " and ".join(f"a factor of {significant(factor)} in the torque of joint {joint}" for factor, joint in pairs)


def wrong_torque_constant_found(fault: DataFault) -> str:
    """Says by which factors torques differ, and which torque constants make up for them."""
    numbers = fault.numbers
    joints = numbers["joints"]
    count = len(joints)
    pairs = zip(numbers["factors"], joints, strict=True)
    factors = " and ".join(f"that of joint {joint} {factor:g} times" for factor, joint in pairs)
    constants = numbers["constants_Nm_per_A"]
    remedy = "Check the gear ratio and the torque constant from which the torques were computed."
    if constants is not None:
        shown = " and ".join(
            f"{significant(constant)} for joint {joint}" for constant, joint in zip(constants, joints, strict=True)
        )
        remedy = f"Declare torque_constant_Nm_per_A {shown}, or check the gear ratio in it."
    return (
        f"{plural(count, 'A torque is', 'Torques are')} not what the weight and the motion of the arm require, but "
        f"{factors} as much. {plural(count, 'It was divided by this', 'They were divided by these factors')}. {remedy}"
    )


def held_by_friction_found(fault: DataFault) -> str:
    """Says within which band the torque of a joint at rest is indeterminate."""
    numbers = fault.numbers
    bands = []
    for std, joint in zip(numbers["std_Nm"], numbers["joints"], strict=True):
        unit = "Nm"
        if joint in numbers.get("prismatic_joints", ()):
            unit = "N"
        bands.append(f"{significant(std, 2)} {unit} at joint {joint}")
    return (
        "At rest, friction holds a joint wherever it stands, and the torque is indeterminate within a band (one sigma: "
        f"{', '.join(bands)}). These rows have little weight for {joints_named(numbers['joints'])}, and of a rest of "
        "all joints one row is used. Record more motion."
    )


def contact_found(fault: DataFault) -> str:
    """Says when the arm touched something, and how far torques differ there."""
    numbers = fault.numbers
    which = "the arm"
    if numbers["joints"]:
        which = joints_named(numbers["joints"])
    sizes = [
        f"{significant(numbers[key])} {unit}"
        for key, unit in (("largest_Nm", "Nm"), ("largest_N", "N"))
        if key in numbers
    ]
    return (
        f"From {numbers['from_s']:.2f} to {numbers['to_s']:.2f} s the arm was in contact with something: the torque of "
        f"{which} differs by up to {' and '.join(sizes)} from the model, in these rows only. They were left out."
    )


def estimated_torque_found(fault: DataFault) -> str:
    """Says by what torques of the controller's own model are known."""
    sign = "of the arm at rest are constant"
    if fault.numbers.get("reason") == "no_friction":
        sign = "have neither noise nor any friction"
    return (
        f"The torques {sign}: they are the controller's own model, not measurements. What is found is what that model "
        "lacks or has beyond this arm's. Record motor currents, or declare torque_source."
    )


def stale_rows_found(fault: DataFault) -> str:
    """Says how many rows repeat the read-outs of the row before."""
    count = fault.numbers["count"]
    return (
        f"{counted(count, 'row')} {be(count)} the row before again, of all joints and to all digits, while the arm "
        "moves. They were left out. Look at the rate at which joints are read."
    )


def other_clock_found(fault: DataFault) -> str:
    """Says by how much commands are stamped by another clock than the read-outs."""
    numbers = fault.numbers
    shift = numbers["shift_s"]
    drift = numbers["drift_s_per_s"]
    side = "behind" if shift > 0 else "ahead of"
    growing = ""
    if drift:
        change = "more" if (shift > 0) == (drift > 0) else "less"
        growing = f"at time zero, and {1e3 * abs(drift):.3g} ms a second {change} later on "
    return (
        f"Read-outs are {abs(shift):.3g} s {side} their commands {growing}beyond what the servos lag: commands are "
        f"stamped by another clock. They were shifted, and {counted(numbers['count'], 'row')} without a command left "
        "out. A delay that all joints have cannot be told from this. Stamp commands and read-outs by one clock."
    )


def degrees_found(fault: DataFault) -> str:
    """Says which columns of a log of commands are in degrees."""
    numbers = fault.numbers
    return (
        f"{_moving(numbers)} 57 times as far as commanded, or a 57th of that: the {numbers['side']} columns are in "
        "degrees where the name says radians, or the other way round. They were converted. "
        f"{_undecided_side(numbers)}Check the unit of the columns."
    )


def gear_found(fault: DataFault) -> str:
    """Says which joints have a gear between command and read-out."""
    numbers = fault.numbers
    return (
        f"{_moving(numbers)} {numbers['ratio']:.3g} times as far as commanded, in all runs: the {numbers['side']} "
        "column is before a gear, or after another one. It was divided or multiplied by that. "
        f"{_undecided_side(numbers)}Give both columns after the gear."
    )


def _moving(numbers: Numbers) -> str:
    joints = numbers["joints"]
    return f"{capital(joints_named(joints))} {plural(len(joints), 'moves', 'move')}"


def _undecided_side(numbers: Numbers) -> str:
    """Says that the side of a fault was taken without a reason; nothing where it was decided."""
    if numbers["decided"]:
        return ""
    which = plural(len(numbers["joints"]), "this or the other column is", "these or the other columns are")
    return f"Whether {which} wrong does not show in this log. "


def saturated_readout_found(fault: DataFault) -> str:
    """Says in how many rows a read-out stays at its end."""
    numbers = fault.numbers
    return (
        f"The read-out of {joints_named(numbers['joints'])} stays at {numbers['end_rad']:.4g} rad in "
        f"{counted(numbers['count'], 'row')} while the command goes on: it is saturated, or the joint is at the end of "
        "its range. These rows were left out. Check the range of the encoder and of its column."
    )


def torque_off_found(fault: DataFault) -> str:
    """Says when the servos of which joints had no torque."""
    numbers = fault.numbers
    joints = numbers["joints"]
    count = numbers["count"]
    falling = f"{capital(joints_named(joints))} {plural(len(joints), 'falls or rests', 'fall or rest')}"
    return (
        f"{falling} while the command goes on, between {numbers['from_s']:.2f} and {numbers['to_s']:.2f} s: the torque "
        f"was off. {counted(count, 'row')} "
        f"{plural(count, 'was', 'were')} left out. Cut such times from the log."
    )


def zero_per_run_found(fault: DataFault) -> str:
    """Says by how much the zeros of joints differ between runs."""
    numbers = fault.numbers
    zeros = numbers["zeros_rad"]
    largest = 1e3 * (max(zeros) - min(zeros))
    return (
        f"The zero of {joints_named(numbers['joints'])} differs from run to run, by {largest:.3g} mrad at most."
        " Differences were taken away, so that the run nearest to its commands keeps its zero. Find out "
        "where the encoder loses it."
    )


# ------------------------------------------------------------------ a model that does not describe the data


def quality_statement(quality: Numbers) -> str | None:
    """Says why a model does not describe the poses it was fitted to, and what to check; None where it does."""
    if quality["verdict"] != "bad":
        return None
    error = "not finite"
    if quality["error_m"] is not None:
        error = f"up to {number(1e3 * quality['error_m'], 3)} mm"
    if quality["explained_share"] is None:
        return f"The model does not reproduce the calibration: its errors are {error}. Check the arm that is named."
    if quality["reason"] == "unrelated":
        return (
            "The model does not describe the poses: it explains less than half of the variance of the positions. Check "
            "that the poses belong to these joint positions, row by row."
        )
    return (
        f"The model does not describe the poses: of three quarters of the held-out rows the errors are {error}, and a "
        f"model of this arm is expected within {number(1e3 * quality['limit_m'], 3)} mm. Check the arm, that the poses "
        "belong to these joint positions, and the order, the signs and the units of the joints."
    )


# ------------------------------------------------------------------ by code

FOUND: Mapping[str, Statement] = {
    "placeholder": placeholder_found,
    "time_order": time_order_found,
    "repeated_rows": repeated_rows_found,
    "position_unit": position_unit_found,
    "commanded_joints": commanded_joints_found,
    "joint_turns": joint_turns_found,
    "undecided": undecided_found,
    "unexplained": unexplained_found,
    "arm_deviation": arm_deviation_found,
    "computed_orientation": computed_orientation_found,
    "computed_pose": computed_pose_found,
    "frame_jump": frame_jump_found,
    "unsettled_readouts": unsettled_readouts_found,
    "distance_offset": distance_offset_found,
    "nominal_table": nominal_table_found,
    "calibration_off": calibration_off_found,
    "wandering_readout": wandering_readout_found,
    "no_joints": no_joints_found,
    "outliers": outliers_found,
    "uneven_times": uneven_times_found,
    "velocity_bias": velocity_bias_found,
    "velocity_dead_zone": velocity_dead_zone_found,
    "swapped_torques": swapped_torques_found,
    "coupled_positions": coupled_positions_found,
    "undecided_torques": undecided_found,
    "wrong_torque_constant": wrong_torque_constant_found,
    "held_by_friction": held_by_friction_found,
    "contact": contact_found,
    "estimated_torque": estimated_torque_found,
    "stale_rows": stale_rows_found,
    "other_clock": other_clock_found,
    "degrees": degrees_found,
    "gear": gear_found,
    "saturated_readout": saturated_readout_found,
    "torque_off": torque_off_found,
    "zero_per_run": zero_per_run_found,
}
"""What is wrong, how it was corrected, and the remedy."""

RULED_OUT: Mapping[str, Statement] = {
    "time_order": time_order_ruled_out,
    "commanded_joints": commanded_joints_ruled_out,
    "joint_turns": joint_turns_ruled_out,
    "arm_deviation": arm_deviation_ruled_out,
    "computed_orientation": computed_orientation_ruled_out,
    "computed_pose": computed_pose_ruled_out,
    "frame_jump": frame_jump_ruled_out,
    "unsettled_readouts": unsettled_readouts_ruled_out,
    "distance_offset": distance_offset_ruled_out,
    "nominal_table": nominal_table_ruled_out,
    "calibration_off": calibration_off_ruled_out,
}
"""Why a fault that was tested for is not there."""

CLAUSES: Mapping[str, Clause] = {
    "declared_frame": declared_frame_clause,
    "declared_tool": declared_tool_clause,
    "mirrored_sensor": mirrored_sensor_clause,
    "sensor_scale": sensor_scale_clause,
    "orientation_convention": orientation_convention_clause,
    "joint_unit": joint_unit_clause,
    "coupled_joint": coupled_joint_clause,
    "joint_turns": joint_turns_clause,
    "wrong_torque_constant": wrong_torque_constant_clause,
}
"""A fault within a list of corrections that explain the data alike."""
