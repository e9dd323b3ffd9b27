"""Sentences on the standard deviations of predicted poses, and on rows outside what was recorded."""

import numpy as np

from lite6jax.domains.pose.compensate import Compensation
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.report.cells import joint_units, rows_named

NO_BARS = (
    "the diagnosis does not say how uncertain its model is, so there are no standard deviations; run `lite6jax "
    "diagnose` again"
)


def outside_sentence(outside: int, rows: int, noun: str) -> str:
    """How many rows are outside what was recorded.

    Args:
        outside: how many are.
        rows: how many there are.
        noun: what a row is called, in the singular.
    """
    if not outside:
        return f"No {noun} is outside what was recorded."
    rows_are = f"{noun}{'' if rows == 1 else 's'} {'is' if outside == 1 else 'are'}"
    return (
        f"{outside} of {rows} {rows_are} outside what was recorded, beyond its range or in its gaps: the standard "
        "deviations are large there."
    )


_SHOWN = 0.05
"""deg or mm, that a joint is beyond its recorded range at least to be named."""


def outside_warning(found: Compensation, model: DiagnosedArm) -> str:
    """Which targets leave the recorded range, and by how much; empty where none does.

    Args:
        found: the joint positions.
        model: with which they were found.
    """
    if found.outside is None or model.uncertainty is None or not found.outside.any():
        return ""
    rows = found.recording.row[found.outside].tolist()
    lower, upper = model.uncertainty.recorded.joints.T
    q = found.joint_position[found.outside]
    scales, units = joint_units(model.sliding, model.dof)
    beyond = scales * np.nanmax(np.maximum(lower - q, q - upper), axis=0)
    joints = [
        f"joint {joint} by up to {excess:.3g} {unit}"
        for joint, (excess, unit) in enumerate(zip(beyond, units, strict=True), 1)
        if excess > _SHOWN
    ]
    where = f" ({', '.join(joints)})" if joints else ""
    verb = "is" if len(rows) == 1 else "are"
    return (
        f"{rows_named(rows)} {verb} outside what was recorded{where}: there the compensation extrapolates; record "
        "poses there, or keep targets inside"
    )
