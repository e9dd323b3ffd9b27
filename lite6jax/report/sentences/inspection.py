"""What is said of a table that was looked at, where a condition changes the words; the other texts are in
`templates/inspection.yaml`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lite6jax.domains.pose.clocks import Clocks, Pairing
from lite6jax.domains.pose.joining import JoinedFiles
from lite6jax.formatting import milli, paragraph, significant
from lite6jax.recordings.reflectors import RigidPose
from lite6jax.report.words import fill, read_texts

_TEXTS = read_texts("inspection.yaml")
_MUCH_BETTER = 1e3
"""Ratio of errors beyond which its size says nothing more."""
_AGREES = 1e3
"""m; error of the nominal arm below which it is one of this pose."""


def in_line(name: str) -> str:
    """A name of a column without line breaks."""
    return " ".join(name.splitlines())


# ------------------------------------------------------------------ what columns mean


def form_of_rotation(form: str, order: str) -> str:
    """Says how a rotation is written; `order` is that of the numbers in the names of a matrix."""
    if form != "r11":
        return _TEXTS["forms"][form]
    if order == "columns":
        return "a rotation matrix column by column"
    return "a rotation matrix row by row"


def reason_of_decision(reason: str, numbers: Mapping[str, Any]) -> str:
    """Says why a unit or a form was chosen."""
    if reason == "kinematics":
        return _agreement_of_kinematics(numbers)
    if reason == "slope":
        slope = f"what the positions change per second in {numbers['unit']}"
        if 0.5 < numbers["ratio"] < 2:
            return f"they are {slope}"
        return f"they are {numbers['ratio']:.3g} times {slope}"
    return fill(_TEXTS["reasons"][reason], numbers)


def _agreement_of_kinematics(numbers: Mapping[str, Any]) -> str:
    """Says how much better the arm's kinematics agree than with the next reading."""
    next_error = min(numbers["others"].values(), default=None)
    sentence = "the arm's kinematics agree"
    if not next_error:
        return sentence
    ratio = next_error / max(numbers["error"], 1e-12)
    if ratio < _MUCH_BETTER:
        return f"{sentence} {ratio:.3g} times better than with the next reading"
    return f"{sentence} over 1000 times better than with the next reading"


def announced_column(column: str, quantity: str, name: str, unit: str) -> str:
    """Says what a column is by the source of the poses; `unit` says how sure its unit is, or is empty."""
    sentence = f"{in_line(column)}: {quantity} ({name}), as pose_source says"
    if unit:
        return f"{sentence}; its unit is {unit}."
    return f"{sentence}."


def rows_and_columns(rows: int, used: int, unused: int) -> str:
    """Says how many rows there are, and how many columns are used."""
    if unused:
        return f"{rows} rows, {used + unused} columns, of which {used} are used."
    return f"{rows} rows, {used} columns."


def block_statement(meaning: Sequence[str], commanded: bool, assumed: bool, others: str) -> str:
    """Says what a block of columns is.

    Args:
        meaning: its kind with its columns, its form and its unit; the last two may be empty.
        commanded: whether it stands beside measured positions.
        assumed: whether it was commanded by name and is assumed to be measured.
        others: columns that may be meant instead, or none.
    """
    remark = ""
    if commanded:
        remark = "They stand beside the measured ones: `diagnose --tracking` asks why the arm does not follow."
    elif assumed:
        remark = "By name they were commanded or computed; that they were measured is assumed."
    choice = ""
    if others:
        choice = f"{others} may be meant instead: choose with --column."
    return paragraph(f"{', '.join(filter(None, meaning))}.", remark, choice)


def unread_commands(columns: str, why: str, ways: str) -> str:
    """Says that commands are not read, and why.

    Args:
        columns: of the commands.
        why: `not_followed` of positions, or `torques`.
        ways: how the first columns are said to be commands.
    """
    if why == "not_followed":
        return (
            f"Commanded by name: {columns}. The joints follow them in no unit, so they are not used; if they are the "
            f"positions that were commanded, say so for each: {ways}"
        )
    return (
        f"Commanded torques: {columns}. Commands are diagnosed where they are positions or velocities: log these, or "
        "diagnose the torques (--column NAME=tau1_Nm and so on)."
    )


def joints_without_angles(columns: str, wrong: str, unit: str, ways: Sequence[str], finer: Sequence[str]) -> str:
    """Says why joint positions may be no angles, and how to say that they are."""
    sentence = f"joints {columns} {wrong}. If they are {unit}, say so: {' '.join(ways)}"
    if finer:
        return f"{sentence} (likewise {', '.join(finer)})"
    return sentence


# ------------------------------------------------------------------ the arm and its poses


def arm_unknown(tried: str) -> str:
    """Says that no arm is given; `tried` lists the errors of bundled ones."""
    if tried:
        return f"Arm: none of the bundled ones alone agrees (median errors: {tried}). Name it with --arm."
    return "Arm: unknown. Name it with --arm, or `arm:` in the sidecar; `lite6jax arms` lists the bundled ones."


def arm_compared(name: str, error: float, missed: bool, others: str) -> str:
    """Says how well the poses agree with an arm, m; `others` lists those that agree nearly as well."""
    if missed:
        return (
            f"Arm: {name}, as given; as the columns are read, its nominal kinematics miss the poses by {milli(error)} "
            "mm (median)."
        )
    beside = ""
    if others:
        beside = f", {others}"
    return f"Arm: {name}; its nominal kinematics agree with the poses to {milli(error)} mm (median){beside}."


def pose_source(columns: str, role: str, computed: bool, error: float) -> str:
    """Says whose poses some columns are, and how well the nominal arm reproduces them, m."""
    sentence = f"Pose {columns}: {role}"
    if computed:
        return (
            f"{sentence}, computed from the joints: the nominal arm reproduces it to {significant(1e3 * error, 2)} mm."
        )
    if error < _AGREES:
        return f"{sentence}; the nominal arm reproduces it to {milli(error)} mm."
    return f"{sentence}."


# ------------------------------------------------------------------ what is still unknown


def unclear_deviations(ways: Sequence[str]) -> str:
    """Says how to declare that positions beside deviations are nominal."""
    if not ways:
        return ""
    return (
        "Some columns are called deviations, and nothing says whether the positions are nominal or measured. If they "
        f"are nominal, say so: {' '.join(ways)}."
    )


def unclear_matrix(ways: Sequence[str]) -> str:
    """Says how to declare that a matrix is written by columns."""
    if not ways:
        return ""
    return (
        "Nothing shows whether the matrix is written row by row or column by column. If by columns, say so: "
        f"{' '.join(ways)}."
    )


def assumed_kinds(kinds: Sequence[str]) -> str:
    """Says which quantities were assumed."""
    if not kinds:
        return ""
    return f"Check in the sidecar what was assumed: {', '.join(kinds)}."


def unclear_sources(joints_commanded: bool, torques_estimated: bool, as_current: str, currents: bool) -> list[str]:
    """Says what to declare of joint positions, torques and currents; `as_current` is how efforts become currents."""
    lines = []
    if joints_commanded:
        lines.append("If the joint positions were commanded, write joint_source: commanded.")
    if torques_estimated:
        lines.append("If the controller computed the torques by a model, write torque_source: estimated.")
    if as_current:
        lines.append(f"If the efforts are currents, say so for each: {as_current}.")
    if currents:
        lines.append("Currents become torques by torque_constant_Nm_per_A in the sidecar, one number for each joint.")
    return lines


def computed_or_measured(computed: bool, declared: str, of_controller: bool) -> str:
    """Says that poses were computed against what is declared, or may have been by their name."""
    if computed and declared not in ("controller_fk", "unknown"):
        return f"The poses were computed, not measured by a {declared}: errors of the arm do not show in them."
    if declared == "unknown" and of_controller:
        return "The poses have a name of the controller's. If it computed them, write pose_source: controller_fk."
    return ""


_NO_SENSOR = "There are neither poses nor torques"
_COLUMNS_OF_SOURCES = {"touch": "--column NAME=contact (or plane)", "draw_wire": "--column NAME=distance_mm"}


def only_a_motion(readings: Sequence[tuple[str, str, str]], announced: str) -> str:
    """Says which columns of a motion may be readings: source of poses, column and quantity of each; or how to name them
    where a source of poses is `announced`."""
    if readings:
        choices = " ".join(
            f"If {in_line(column)} is {quantity}, add --set pose_source={source}."
            for source, column, quantity in readings
        )
        return f"{_NO_SENSOR}. {choices} Else this is a motion, to predict or to compute with."
    if announced:
        way = _COLUMNS_OF_SOURCES.get(announced, "--column NAME=axis_mm")
        return f"pose_source is {announced}, and no column alone may be its readings: say which are, {way}."
    return f"{_NO_SENSOR}: this is a motion, to predict or to compute with."


def commands_beside(noise_undeclared: bool) -> str:
    """Says which command diagnoses commands that stand beside poses, and the noise that it needs."""
    noise = ""
    if noise_undeclared:
        noise = ", with joint_noise_rad in the sidecar"
    return f"That leaves the commands out. To ask why the arm does not follow them{noise}:"


def without_times(tracked: bool, remedy: str) -> str:
    """Says that commands or torques need times."""
    what = "Torques"
    if tracked:
        what = "Commands"
    return f"{what} need times, and no column looks like them: {remedy}."


def undeclared_noises(keys: Sequence[str]) -> str:
    """Says which noises the sidecar should declare."""
    if not keys:
        return ""
    return (
        "A verdict compares what is left with the sensor's noise. The sidecar declares none: write "
        f"{' and '.join(keys)} there, one standard deviation."
    )


# ------------------------------------------------------------------ what was joined to one table


def _short_time(seconds: float) -> str:
    if seconds < 1:
        return f"{1e3 * seconds:.2g} ms"
    return f"{seconds:.2g} s"


def joined_commands(commands: int, states: int, names: tuple[str, str]) -> str:
    """Says how the commands of one file stand beside the joints of another; `names` are of the two files."""
    return (
        f"{commands} commands of {names[0]} are held, each until the next, at {states} joint states of {names[1]}: "
        "their times are taken for those of one clock"
    )


def joined_by_clocks(clocks: Clocks, start: float, joints: str, poses: str) -> list[str]:
    """Says how far the clocks of joints and poses are apart, and how well they agree then; `start` as of "
    "`JoinedFiles`."""
    lines = [
        f"the clock of {joints} is ahead of that of {poses} by {clocks.offset + start:.6f} s ± "
        f"{_short_time(clocks.offset_std)} in the middle of the poses: found from the motion, beside the sensor's "
        "frame, the tool and the arm's geometry"
    ]
    if np.isfinite(clocks.drift_std):
        lines.append(
            f"the clock of {joints} runs {1e6 * clocks.drift:.1f} ± {significant(1e6 * clocks.drift_std, 2)} ppm "
            "faster; the joined table has its times"
        )
    else:
        lines.append(
            f"the arm stood still at every pose: the offset is known within {_short_time(clocks.offset_std)} only, and "
            "the drift cannot be estimated"
        )
    fitted = ""
    if np.isfinite(clocks.fitted_error):
        fitted = f", with its geometry fitted to {milli(clocks.fitted_error)} mm"
    lines.append(
        f"at these times the nominal arm agrees with the poses to {milli(clocks.error)} mm (median){fitted}; a delay "
        "of the sensor is a part of the offset"
    )
    return lines


def joined_by_order(pairing: Pairing, joined: JoinedFiles, joints: str, poses: str) -> str:
    """Says that captures of joints and poses were paired in their order, and which are left out."""
    sentence = (
        f"{pairing.rows} joint states and poses were captured one by one and are paired in their order, which the "
        f"nominal arm confirms to {milli(pairing.error)} mm (median)"
    )
    sides = (
        (pairing.joint, joined.states, f"joint states of {joints}"),
        (pairing.position, joined.poses, f"poses of {poses}"),
    )
    for first, count, what in sides:
        if count > pairing.rows:
            sentence += f"; the first {first} and the last {count - first - pairing.rows} {what} are left out"
    return sentence


def joined_by_names(columns: tuple[str, str], alone: tuple[str, str], error: float, joints: str, poses: str) -> str:
    """Says that rows of the same name belong together, and which names stand in one file alone."""
    sentence = (
        f"rows of the same name in {in_line(columns[0])} of {joints} and {in_line(columns[1])} of {poses} belong "
        f"together; the nominal arm agrees with them to {milli(error)} mm (median)"
    )
    for names, file in zip(alone, (joints, poses), strict=True):
        if names:
            sentence += f"; {file} alone has {names}"
    return sentence


def poses_not_reached(missed: int, count: int) -> list[str]:
    """Says how many poses a branch of the inverse kinematics does not reach."""
    if not missed:
        return []
    return [f"{missed} of {count} poses are not reached on it and are left out"]


def inverted_targets(inverted: bool, errors: tuple[float, float]) -> list[str]:
    """Says that poses of a target are inverted: errors of the nominal arm, m, as recorded and inverted."""
    if not inverted:
        return []
    return [
        "the target's poses are inverted, as those of a camera on the flange: the nominal arm then agrees to "
        f"{1e3 * errors[1]:.3g} mm instead of {1e3 * errors[0]:.3g} mm (median)"
    ]


def named_columns(by: str, words: str, ordered: bool) -> str:
    """Says that cells name whose numbers stand beside them."""
    sentence = f"the cells of {by} say whose the numbers beside them are: {words}"
    if ordered:
        return sentence
    return f"{sentence}; their order changes from row to row, so that each has columns of its own"


def points_of_states(by: str, labels: str, count: int, states: int, incomplete: bool) -> str:
    """Says that rows of several points became rows of states; `incomplete` where points are missing in some."""
    sentence = (
        f"{in_line(by)} says which of {count} points a row is of ({labels}): the rows of a state became one, of "
        f"{states} states"
    )
    if incomplete:
        return f"{sentence}, in some of which points are missing"
    return sentence


def one_point_read(point: str, states: int | None) -> str:
    """Says which one of several points is read, where they are not on one rigid body."""
    return (
        f"they are not on one rigid body that shows its pose: of the points only {point} is read, as it is seen in "
        f"{states} states"
    )


def pose_of_points(pose: RigidPose, names: str, lost: int, mm: float) -> list[str]:
    """Says how points became a pose; `lost` rows have too few of them, `mm` is the factor from their unit."""
    lines = [
        f"{pose.points} points ({names}) keep their distances and became the pose of one body: its position is their "
        "centre, its axes are the sensor's at the first row with all points",
        f"the points differ from the body's shape by {significant(mm * pose.misfit)} mm RMS, "
        f"{significant(mm * pose.size)} mm from its centre: a noise of {significant(mm * pose.position_noise, 2)} mm "
        f"and {significant(pose.orientation_noise, 2)} rad per axis of the pose",
    ]
    if lost:
        lines.append(f"{lost} rows without a pose: fewer than three points are seen there")
    if pose.outlying:
        lines.append(f"{pose.outlying} rows without a pose: their points show another shape, as exchanged points do")
    return lines
