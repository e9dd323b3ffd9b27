"""The sentences about data faults of recordings of poses, by code, found or not."""

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from lite6jax.report.words import Numbers, Wording, be, capital, counted, joined, joints_named, milli

_CONVENTIONS = {
    "inverted": "inverted orientations (those of the sensor's frame in the tool's)",
    "scalar_last": "quaternions with the scalar last (x, y, z, w)",
    "inverted_scalar_last": "inverted orientations with the scalar last (x, y, z, w)",
}
_COMMANDED = "the servo error and the compliance of the gears are then part of the estimated physics"


# ------------------------------------------------------------------ rows


def _time_order(rows: Sequence[int], n: Numbers) -> str:
    their = "its" if len(rows) == 1 else "their"
    return (
        f"{_number_of(rows)} {be(len(rows))} out of time order within {their} run, by {n['largest_step_back_s']:.4g} s "
        "at most. The rows of each run were sorted by time. Check how the file was put together."
    )


def _no_time_order(n: Numbers) -> str:
    if n["timed"]:
        return f"All {n['samples']} rows are in time order within each run."
    return f"The {n['samples']} rows have no times: their order is taken as the sequence."


def _repeated_rows(rows: Sequence[int], n: Numbers) -> str:
    verb = "repeats" if len(rows) == 1 else "repeat"
    return (
        f"{_number_of(rows)} exactly {verb} joints and pose of an earlier row (row {rows[0]} those of row "
        f"{n['first_rows'][0]}), which sensor noise makes impossible. Each was used once. Check whether the logger "
        "wrote rows twice or the sensor had stopped."
    )


def _position_unit(rows: Sequence[int], n: Numbers) -> str:
    size = "large" if n["factor"] > 1 else "small"
    return (
        f"The positions in {_number_of(rows)} are a factor of 1000 too {size}: they are in another unit than the rest. "
        "They were converted. Check what wrote these rows."
    )


def _commanded(rows: Sequence[int], n: Numbers) -> str:
    if n["reason"] == "grid":
        reason = (
            f"all {n['distinct_positions']} joint positions are multiples of {_grid(n)}, which encoders do not read"
        )
    else:
        reason = (
            f"all {n['returns']} returns to an earlier pose have the same joint positions to the last digit, although "
            f"the sidecar declares a read-out noise of {n['joint_noise_rad']:.2g} rad"
        )
    return (
        f"The joint positions are commanded or rounded, not measured: {reason}. They were used unchanged; {_COMMANDED}"
        ". Record the encoders, or declare joint_source: commanded."
    )


def _not_commanded(n: Numbers) -> str:
    if n["reason"] == "declared":
        return f"The sidecar declares commanded joint positions; {_COMMANDED}."
    return f"The joint positions are measured, not commanded: {n['share']:.0%} of them are multiples of {_grid(n)}."


def _grid(n: Numbers) -> str:
    return "0.01 deg" if n["grid_unit"] == "deg" else f"{n['grid_rad']:g} rad"


# ------------------------------------------------------------------ what misses the arm grossly

MISMATCHES = {
    "declared_frame": "Frame other than declared",
    "declared_tool": "Tool other than declared",
    "inverted_poses": "Inverted poses",
    "mirrored_sensor": "Left-handed sensor",
    "orientation_convention": "Orientation convention",
    "swapped_joints": "Swapped joints",
    "joint_unit": "Joint in another unit",
    "mirrored_joint": "Joint with reversed sign",
    "coupled_joint": "Coupled joints",
}
"""Faults that make poses miss the arm grossly, by code."""
_REMEDIES = {
    "declared_frame": "The frame is fitted. Declare pose_frame: unknown, or record the poses in the arm's base frame",
    "declared_tool": "The tool is fitted. Declare the tool that was set in the controller, or tool: unknown",
    "inverted_poses": "Write the poses of what moves with the flange, in the frame of what stands still",
    "mirrored_sensor": "Export the poses in right-handed axes",
    "coupled_joint": "Write each joint's own angle, as the driver (ROS) has it",
}


def _mismatch(rows: Sequence[int], n: Numbers, code: str) -> str:
    if "median_error_m" not in n:
        return f"{capital(_changed(code, n))}, together with the next fault."
    sentence = (
        f"{capital(_changed(code, n))}. This is corrected in memory whenever the file is read: the median error falls "
        f"from {milli(n['median_error_m'], 4)} mm to {milli(n['corrected_error_m'])} mm. "
    )
    if n["alternatives"]:
        sentence += f"These corrections fit about as well: {'; or '.join(map(_together, n['alternatives']))}. "
    return f"{sentence}{_REMEDIES.get(code, 'Correct the columns in the file')}."


def _undecided(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"The poses miss the arm by {milli(n['median_error_m'], 4)} mm (median), and {len(n['alternatives'])} "
        f"corrections explain that alike, to {milli(n['corrected_error_m'])} mm: "
        f"{'; or '.join(map(_together, n['alternatives']))}. Nothing was corrected. Find out which it is, and correct "
        "the file."
    )


def _other_arm(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"The poses are not those of a {n['declared']}, whose nominal kinematics miss them by "
        f"{milli(n['median_error_m'], 4)} mm (median), but of a {n['arm']}, to {milli(n['corrected_error_m'])} mm. "
        "Name that arm."
    )


def _unexplained(rows: Sequence[int], n: Numbers) -> str:
    left = n["best_alternative_m"]
    best = "" if left is None else f" (the best leaves {milli(left)} mm)"
    return (
        f"The poses miss the arm by {milli(n['median_error_m'], 4)} mm (median), and by {milli(n['fitted_error_m'])} "
        "mm with its geometry fitted. That is no calibration error. No change of frame, tool, axes, order, signs, "
        f"zeros or units explains it{best}. Check that it is this arm, and that joints and poses of a row belong "
        "together."
    )


def _together(parts: Sequence[Numbers]) -> str:
    signs = [part["joint"] for part in parts if part["fault"] == "mirrored_joint"]
    clauses = [_changed(part["fault"], part) for part in parts if part["fault"] != "mirrored_joint" or len(signs) < 2]
    if len(signs) > 1:
        clauses.append(f"joints {joined(map(str, signs))} have their signs reversed")
    return joined(clauses)


def _changed(code: str, n: Numbers) -> str:
    """A hypothesis in a clause."""
    match code:
        case "declared_frame":
            return "the poses are not in the frame that is declared" + (_frame(n) if "rotation_rad" in n else "")
        case "declared_tool":
            at = (
                f"; it is at ({', '.join(map(milli, n['translation_m']))}) mm on the flange"
                if "translation_m" in n
                else ""
            )
            return f"the tool is not the one that is declared{at}"
        case "inverted_poses":
            return (
                "the poses are inverted: each is that of the sensor's frame in the tool's, as a camera on the flange "
                "sees a board that stands still"
            )
        case "mirrored_sensor":
            axes = n["axes"]
            how = f"{axes} is reversed" if len(axes) == 1 else f"{axes[0]} and {axes[1]} are exchanged"
            return f"the axes of the sensor are left-handed ({how}, or an equivalent)"
        case "orientation_convention":
            return f"the orientations are {_CONVENTIONS[n['convention']]}"
        case "swapped_joints":
            return f"joints {joined(map(str, n['joints']))} are swapped"
        case "mirrored_joint":
            return f"joint {n['joint']} has its sign reversed"
        case "coupled_joint":
            mark = "+" if n["factor"] > 0 else "−"
            i, j = n["joint"], n["added_joint"]
            return f"joint {i} is coupled to joint {j} in its column: q{i} = column {mark} q{j}"
        case "joint_unit":
            other = "degrees" if n["unit"] == "deg" else "radians though the others are in degrees"
            return f"joint {n['joint']} is in {other}"
    turned = abs(n["added_rad"])
    away = "half a turn" if np.isclose(turned, np.pi) else f"{np.rad2deg(-n['added_rad']):+.3g} deg"
    return f"the column of joint {n['joint']} has its zero off by {away}"


def _frame(n: Numbers) -> str:
    vector, shift = np.array(n["rotation_rad"]), np.array(n["translation_m"])
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 0 else vector
    main = int(np.argmax(np.abs(axis)))
    about = f"about {'xyz'[main]}" if abs(axis[main]) > 0.999 else f"about ({', '.join(f'{a:.2f}' for a in axis)})"
    said = f": the base is turned by {np.rad2deg(angle):.4g} deg {about} in it"
    if np.linalg.norm(shift) > 2e-3:
        said += f" and stands at ({', '.join(milli(x, 4) for x in shift)}) mm"
    if about == "about z" and abs(angle - np.pi) < 0.02:
        said += ", as base_link and base of Universal Robots are to each other"
    return said


def mismatch_ruled_out(codes: Iterable[str], n: Numbers) -> str:
    """Why faults that the same numbers rule out are not there.

    Args:
        codes: of `MISMATCHES`.
        n: of each.
    """
    error, limit = milli(n["median_error_m"]), milli(n["suspected_above_m"])
    if n.get("one_point"):
        return (
            "Signs, order, units and frames were not compared: the positions are one point, the same in every row, "
            "which shows neither a scale nor axes."
        )
    reason = f"the median error is {error} mm, and such faults are searched for above {limit} mm."
    if "fitted_error_m" in n:
        reason = f"a change of geometry explains the median error of {error} mm, to {milli(n['fitted_error_m'])} mm."
    elif "best_alternative_m" in n:
        reason = f"the best correction leaves {milli(n['best_alternative_m'])} mm of the median error of {error} mm."
    return f"Not found: {', '.join(MISMATCHES[code].lower() for code in codes)}; {reason}"


def _joint_turns(rows: Sequence[int], n: Numbers) -> str:
    if "added_rad" in n:
        return _mismatch(rows, n, "joint_turns")
    return (
        f"{capital(joints_named(n['joints']))} {be(len(n['joints']))} off by whole turns in {_number_of(rows)}. The "
        "turns were removed, since gears and limits depend on them. Check where the encoder wraps."
    )


def _no_joint_turns(n: Numbers) -> str:
    if n["outside_limits_rad"]:
        return f"No joint is off by whole turns; the limits are exceeded by {n['outside_limits_rad']:.3g} rad at most."
    return "No joint is off by whole turns: all are within their limits."


def _computed_pose(rows: Sequence[int], n: Numbers) -> str:
    table = {"nominal": "the nominal table", "factory": "the calibration file"}[n["chain"]]
    return (
        f"The poses are those that {table} computes from the joints, to {1e6 * n['median_error_m']:.2g} µm: no sensor "
        "measures so exactly. They are the controller's own forward kinematics and show nothing of the arm itself. "
        "Take the columns of a sensor, or declare pose_source: controller_fk."
    )


def _not_computed(n: Numbers) -> str:
    if n["reason"] == "declared":
        return "The sidecar declares that the controller computed the poses: they compare tables and show no physics."
    return "The poses were measured: no table computes them from the joints to rounding."


# ------------------------------------------------------------------ frames and joints beside physics


def _frame_jump(rows: Sequence[int], n: Numbers) -> str:
    what = "the sensor or the base" if n["part"] == "base" else "the target or the tool on the flange"
    run = f", where run {n['run']} begins" if "run" in n else ""
    return (
        f"At row {n['row']}{run}, {what} moved by {milli(n['translation_m'])} mm and {milli(n['rotation_rad'])} mrad "
        f"({milli(n['displacement_rms_m'])} mm RMS in the poses from there on, {_chance(n['p_value'], 1)}). "
        f"{_compared(n, 'Without a jump')}This constant displacement was removed from the poses from that row on. "
        "Check the mount, and record again where it matters."
    )


def _no_frame_jump(n: Numbers) -> str:
    if n["reason"] == "physics":
        rows = joined(map(str, n["candidate_rows"]))
        return (
            f"There is no frame jump at row {rows}: without one, the poses are more likely by "
            f"{n['log_likelihood_gap']:.3g} of log-likelihood, with {_terms(n)}."
        )
    if n["reason"] == "gradual":
        return "There is no frame jump: what changes does so over many rows, as physics does."
    if n["reason"] == "too_few_rows":
        return f"{n['samples']} rows are too few to test for a frame jump."
    small = " that matters" if n["p_value"] < 0.01 else ""
    return f"There is no frame jump{small} ({_chance(n['p_value'])})."


_SHAPES = {
    "move": ("a share of each move remained", "of the move"),
    "velocity": ("the poses show the joints later, at the recorded velocities", "s"),
    "constant": ("the same angle remained after each move, against the sign of backlash", "rad"),
}


def _unsettled(rows: Sequence[int], n: Numbers) -> str:
    remedy = "Wait longer before reading, or read the joints when the pose is measured."
    if n["shape"] == "rows":
        return (
            f"The joints were read before the arm had settled in {_number_of(rows)}: {n['rest']:.2g} of the move "
            f"remained. These rows have little weight. {remedy}"
        )
    shape, unit = _SHAPES[n["shape"]]
    joints = "all joints" if n["all_joints"] else ", ".join(f"joint {joint}" for joint in n["joints"])
    return (
        f"The joints were read before the arm had settled: {shape} ({joints}; {n['rest']:.3g} ± {n['rest_std']:.1g} "
        f"{unit}, up to {milli(n['largest_rms_rad'], 2)} mrad RMS). "
        f"{_compared(n, 'Without a correction')}The remainder was added to the joint positions. "
        f"{remedy}"
    )


def _settled(n: Numbers) -> str:
    if n["reason"] == "moving":
        return "Unsettled read-outs were not tested for: the arm moved while it was recorded."
    if n["reason"] == "too_few_rows":
        return f"{n['samples']} rows are too few to test for unsettled read-outs. Record more."
    if n["reason"] == "physics":
        return (
            "The joints were read at rest: without a correction, the poses are more likely by "
            f"{n['log_likelihood_gap']:.3g} of log-likelihood, with {_terms(n)}."
        )
    if n["reason"] == "ordered_poses":
        return (
            f"Unsettled read-outs cannot be tested for: the moves before explain the poses ({_chance(n['p_value'])}), "
            "but the moves after explain them too, as the poses are in an orderly sequence. Record some in random "
            "order."
        )
    share = "less than matters" if n["p_value"] < 0.01 else "nothing"
    return f"The joints were read at rest: the moves before explain {share} ({_chance(n['p_value'])})."


# ------------------------------------------------------------------ what the sidecar declares


def _nominal_table(rows: Sequence[int], n: Numbers) -> str:
    reason = _tables(n)
    if not n["decided"]:
        reason = f"{n['table']} leaves smaller residuals, and no physics with the declared table compensates for that"
    used = {
        "table": f"{n['table']} was used. Name it in the sidecar.",
        "instead_of_file": f"{n['table']} was used in place of the calibration file. Name it in the sidecar.",
        "none": f"The declared chain was used as requested. Use --geometry free, or the file of {n['table']}.",
    }[n["used"]]
    chain = {
        "fitted": "The chain was fitted from this table. ",
        "as_published": "The chain was not fitted: "
        f"a fit gains too little for {n.get('numbers_more', 'its')} more parameters. ",
    }.get(n.get("chain", ""), "")
    return (
        f"The declared table is not that of this arm: {reason}. {_compared(n, 'With the declared table')}{chain}{used}"
    )


def _declared_table(n: Numbers) -> str:
    if n["reason"] == "own_chain":
        return "No other nominal table was tested: the calibration file is the arm's own."
    if n["reason"] == "single_table":
        return f"No other nominal table was tested: {n['declared']} has only one."
    if n["reason"] == "indistinguishable":
        return f"The data do not distinguish the declared table from {n['table']}."
    fitted = " The chain is fitted, so that the table matters little." if n["fitted"] else ""
    return f"The data do not support the table {n['table']}: {_tables(n)}.{fitted}"


def _tables(n: Numbers) -> str:
    if "share" in n:
        return (
            f"between the declared table (0) and {n['table']} (1), the data are at {n['share']:.2f} ± "
            f"{n['share_std']:.1g}"
        )
    if "table_ratio" not in n:
        return "the data do not distinguish the two"
    return (
        f"residuals are {n['declared_ratio']:.3g} times those of a fitted chain with {n['declared']}, and "
        f"{n['table_ratio']:.3g} times with {n['table']}"
    )


def _calibration_off(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"All numbers of the calibration file are off by {milli(n['sigma_m'], 2)} mm and {milli(n['sigma_rad'], 2)} "
        "mrad (one standard deviation), as those of a rounded or outdated file. "
        f"{_compared(n, 'With an exact file')}The chain was fitted within that. Declare factory_uncertainty in the "
        "sidecar."
    )


def _no_joints(rows: Sequence[int], n: Numbers) -> str:
    return (
        f"{_number_of(rows)} {'was' if len(rows) == 1 else 'were'} left out: the clocks differ by "
        f"{n['clock_offset_s']:.4g} s, and the joint positions at that time were not recorded. Start the recording of "
        "the joints earlier and end it later."
    )


def _outliers(rows: Sequence[int], n: Numbers) -> str:
    verb = "is an outlier and has" if len(rows) == 1 else "are outliers and have"
    return f"{_number_of(rows)} {verb} little weight. Check them."


def _compared(n: Numbers, otherwise: str) -> str:
    """How much less likely the poses are without a fault, where that was compared; "" where not."""
    if "log_likelihood_gap" not in n:
        return ""
    return (
        f"{otherwise}, the best explanation ({_terms(n)}) is less likely by {n['log_likelihood_gap']:.3g} of "
        "log-likelihood. "
    )


def _terms(n: Numbers) -> str:
    return ", ".join(n["rival_terms"]) or "no effect"


def _chance(p: float, digits: int = 2) -> str:
    return f"p = {p:.{digits}g}" if p > 0 else "p < 1e-300"


def _number_of(rows: Sequence[int]) -> str:
    return counted(len(rows), "row")


# ------------------------------------------------------------------ by code

FAULTS: dict[str, Wording] = {
    "time_order": Wording("Rows out of time order", _time_order, _no_time_order),
    "repeated_rows": Wording(
        "Repeated rows", _repeated_rows, "None of the {samples} rows repeats joints and pose of another."
    ),
    "position_unit": Wording(
        "Positions in another unit",
        _position_unit,
        "All positions are in one unit: none is further than {largest_distance_m:.3g} m from their middle, half are "
        "within {median_distance_m:.3g} m.",
    ),
    "commanded_joints": Wording("Commanded joint positions", _commanded, _not_commanded),
    **{
        code: Wording(name, partial(_mismatch, code=code), partial(mismatch_ruled_out, [code]))
        for code, name in MISMATCHES.items()
    },
    "joint_turns": Wording("Joint zero or whole turns", _joint_turns, _no_joint_turns),
    "undecided": Wording("Undecided mismatch", _undecided),
    "other_arm": Wording("Another arm", _other_arm),
    "unexplained": Wording("Unexplained mismatch", _unexplained),
    "computed_pose": Wording("Computed poses", _computed_pose, _not_computed),
    "frame_jump": Wording("Frame jump", _frame_jump, _no_frame_jump),
    "unsettled_readouts": Wording("Unsettled joint read-outs", _unsettled, _settled),
    "nominal_table": Wording("Nominal table", _nominal_table, _declared_table),
    "calibration_off": Wording("Calibration off everywhere", _calibration_off),
    "no_joints": Wording("Rows without joint positions", _no_joints),
    "outliers": Wording("Outliers", _outliers),
}
