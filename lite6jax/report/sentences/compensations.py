"""What a terminal says of compensations and registrations, where a condition changes the words; the other texts are in
`templates/screens.yaml`."""

from collections.abc import Sequence

import numpy as np

from lite6jax.array_types import Array
from lite6jax.domains.pose.compensate import Compensation, TargetFrame
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.domains.pose.registration import Registration
from lite6jax.domains.tracking.ranges import Beyond
from lite6jax.formatting import be, counted, joined, joints_named, number, plural, rows_named


def targets(compensation: Compensation, model: DiagnosedArm, frame: TargetFrame) -> str:
    """Says how many targets there are, in which frame, and of which model."""
    measured = "positions and orientations"
    if compensation.orientation_error is None:
        measured = "positions"
    where = "the arm's base"
    if frame == "sensor":
        where = "the sensor's frame"
    return (
        f"{counted(len(compensation.reached), 'target')} ({measured} in {where}) for a {model.arm} with "
        f"{counted(len(model.physics.effects), 'effect')} beyond its geometry."
    )


def targets_reached(reached: int, missed: int) -> str:
    """Says how many targets are reached, and how many are not; a list of these follows."""
    if missed:
        return f"{counted(reached, 'target')} reached, {counted(missed, 'target')} not:"
    return f"{counted(reached, 'target')} reached."


def omitted_effects(omitted: Sequence[str]) -> str:
    """Says which effects concern the sensor alone."""
    concern = plural(len(omitted), "concerns", "concern")
    return f"omitted: {' and '.join(omitted)}, which {concern} the sensor and not the arm's position"


def joints_at_limit(joints: Sequence[tuple[int, float, str]]) -> str:
    """Says which joints are at a limit: number, limit and its unit."""
    return " and ".join(f"joint {joint} at its limit of {limit:.4g} {unit}" for joint, limit, unit in joints)


def deviation_of_targets(std: Array) -> str:
    """Says the standard deviations `(target, 3)` m of the positions that are reached; empty where none is."""
    if not len(std):
        return ""
    rms = np.sqrt(np.mean(std**2))
    return (
        f"Standard deviation of the positions reached: {number(1e3 * rms)} mm RMS per axis, at most "
        f"{number(1e3 * std.max())} mm."
    )


def rows_outside(outside: int, rows: int, noun: str) -> str:
    """Says how many rows are outside what was recorded; `noun` is what a row is called."""
    if not outside:
        return f"No {noun} is outside what was recorded."
    return (
        f"{outside} of {counted(rows, noun)} {be(outside)} outside what was recorded, beyond its range or in its gaps: "
        "the standard deviations are large there."
    )


def rolled_rows_outside(beyond: Beyond) -> str:
    """Says in how many rows of a rollout the model extrapolates, and by what of which joints."""
    any_joint = beyond.any_joint
    outside = int(any_joint.sum())
    if not outside:
        return "No row is outside what was recorded."
    parts = []
    for quantity, mask in zip(("speed", "load", "reversals", "drivers"), beyond, strict=True):
        joints = (1 + np.flatnonzero(mask.any(0))).tolist()
        if joints:
            parts.append(f"the {quantity} of {joints_named(joints)}")
    return (
        f"{outside} of {counted(len(any_joint), 'row')} {be(outside)} outside what was recorded, by {joined(parts)}: "
        "the columns outside_… say where."
    )


def beyond_range(rows: Sequence[int], joints: Sequence[str]) -> str:
    """Says which rows leave what was recorded, and by how much their joints do."""
    by_joint = ""
    if joints:
        by_joint = f" ({', '.join(joints)})"
    return (
        f"{rows_named(rows)} {be(len(rows))} outside what was recorded{by_joint}: there the compensation extrapolates; "
        "record poses there, or keep targets inside"
    )


def registered(registration: Registration) -> list[str]:
    """Says the errors that a registration leaves, and how many rows are outliers."""
    fitted_rows = registration.kept
    error = f"{number(1e3 * registration.rms)} mm"
    if registration.turned is not None:
        turned = np.sqrt(np.mean(np.sum(registration.turned[fitted_rows] ** 2, 1)))
        error += f" and {number(float(np.rad2deg(turned)))} deg"
    remarks = [f"The registration on {len(fitted_rows)} rows leaves errors of {error} RMS."]
    outliers = int(np.sum(~fitted_rows))
    if outliers:
        remarks.append(f"{outliers} rows are outliers and have little weight.")
    return remarks


def undetermined_frames(registration: Registration) -> list[str]:
    """Says which numbers of the two frames the poses do not determine."""
    remarks = []
    if registration.turned is None:
        remarks.append("Positions do not determine the tool's rotation: only its offset is fitted.")
    if not registration.determined:
        remarks.append("These poses do not determine every number of the two frames.")
    return remarks
