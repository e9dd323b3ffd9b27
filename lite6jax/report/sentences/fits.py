"""What a terminal says of fits and comparisons, where a condition changes the words; the other texts are in
`templates/screens.yaml`."""

from collections.abc import Sequence

import numpy as np

from lite6jax.arms.chains import HayatiForm
from lite6jax.calibration.problem import TOUCHED_TOLERANCE
from lite6jax.calibration.quality import ABOVE_NOISE, Result
from lite6jax.calibration.solution import Noise, Solution
from lite6jax.estimation.robust import DOWNWEIGHTED
from lite6jax.formatting import counted, number, significant
from lite6jax.model import ModelForm
from lite6jax.recordings import Recording
from lite6jax.sensors.kinds import KINDS

_MOST_ROWS = 5
"""Outliers that are listed."""


def recording_read(recording: Recording, arm: str, kind: str) -> str:
    """Says how much was recorded, of which arm, and by what."""
    sentence = f"Recording of {recording.samples} samples, {recording.dof} joints of a {arm}: {kind}"
    sensor = recording.settings.pose_source
    if sensor == "unknown":
        return f"{sentence}."
    return f"{sentence} by {sensor.replace('_', ' ')}."


def geometry_of_fit(recording: Recording, solution: Solution) -> str:
    """Says which parts of the model are fitted."""
    settings = recording.settings
    chain = solution.form.chain
    if recording.touches is not None and settings.factory_calibration is None:
        length, angle = TOUCHED_TOLERANCE
        geometry = (
            f"nominal, fitted near it: each number within {1e3 * length:g} mm or {1e3 * angle:g} mrad (one sigma)"
        )
    elif isinstance(chain, HayatiForm):
        geometry = "nominal, fitted"
    elif solution.free[: chain.size].any():
        geometry = "the factory calibration, fitted within its uncertainty"
    else:
        geometry = "the factory calibration, held"
    frame = "the arm's base"
    if solution.form.frame:
        frame = "unknown, fitted"
    tool = "as declared"
    if solution.form.tool:
        tool = "unknown, fitted"
    elif settings.tool == "none":
        tool = "none"
    return f"Geometry: {geometry}. Sensor frame: {frame}. Tool: {tool}."


def fitted(solution: Solution, recorded: bool) -> str:
    """Says whether a fit converged, and how much it reduced the error; `recorded` where it was one of a recording."""
    steps = counted(solution.steps, "step")
    if solution.result != Result.CONVERGED:
        return f"The fit {solution.result.message} ({steps}); the values below are those of its last step."
    before = solution.nominal_errors
    after = solution.checked
    if recorded:
        return (
            f"Converged in {steps}: {number(1e3 * after.position_rms, 3)} mm RMS on held-out rows, "
            f"{number(1e3 * before.position_rms, 3)} mm before."
        )
    return (
        f"Converged in {steps}: the table below is the calibrated arm to {number(1e3 * after.position.max())} mm; the "
        f"nominal one is up to {number(1e3 * before.position.max(), 3)} mm off, at {len(after.position)} joint "
        "positions."
    )


def noise_of_residuals(noise: Noise, declared: str) -> str:
    """Says the noise of the residuals beside the declared one; `declared` is that as it is shown, or empty."""
    estimated = f"{number(1e3 * noise.position)} mm"
    if noise.orientation is not None:
        estimated += f", {number(float(np.rad2deg(noise.orientation)))} deg"
    ratio = noise.over_declared
    if ratio is None or not declared:
        return f"Noise per axis: not declared; the residuals have {estimated}."
    comparison = f"{ratio:.0f} times it: this geometry does not explain the rest"
    if ratio < ABOVE_NOISE:
        comparison = "as declared"
    return f"Noise per axis: declared {declared}; the residuals have {estimated}, {comparison}."


def outliers(rows: Sequence[int], samples: int) -> str:
    """Says which of the samples have little weight."""
    if not rows:
        return f"No outliers among {samples} samples."
    listed = ", ".join(map(str, rows[:_MOST_ROWS]))
    if len(rows) > _MOST_ROWS:
        listed += ", …"
    return f"{len(rows)} of {samples} samples are outliers with weights below {DOWNWEIGHTED:g}: rows {listed}."


def hayati_remarks(form: HayatiForm, prior: Sequence[float] | None) -> list[str]:
    """Says how the table of a Hayati form is read; `prior` is that of undetermined numbers in mm and deg, if any is."""
    remarks = []
    if prior is not None:
        length, angle = prior
        remarks.append(
            "In brackets: these data do not determine the number. Its prior does, which is the nominal one ± "
            f"{significant(length, 2)} mm or {significant(angle, 2)} deg."
        )
    if form.sliding:
        remarks.append(
            "P: a prismatic joint, whose axis is drawn through the origin of the frame before it; b is a shift along y "
            "after a."
        )
    parallel = [f"{joint + 1}-{joint + 2}" for joint in form.parallel if joint >= 0]
    if parallel:
        remarks.append(
            f"Joints {' and '.join(parallel)} are nominally parallel: d is fixed at zero, beta (Hayati) is a turn "
            "about y after alpha."
        )
    return remarks


def undetermined_by_touches(form: ModelForm, recording: Recording) -> list[str]:
    """Says what touches, distances or heights leave open, and where their scale is from."""
    settings = recording.settings
    touches = recording.touches
    remarks = []
    if not form.frame:
        remarks.append(
            "Where the arm's base stands in the room is not determined: all coordinates are in the base's own frame."
        )
    remarks.append(
        "The tool's orientation, and with it the zero angle of the last joint, is not determined: one point is seen."
    )
    if settings.factory_calibration is not None:
        remarks.append("The scale is that of the factory calibration.")
    elif touches is not None and touches.kind == "contact" and settings.contact_distances:
        remarks.append("The scale is that of the known distances between contacts.")
    elif touches is not None and not KINDS[touches.kind].touched:
        remarks.append("The scale is that of the readings.")
    return remarks


def spread_between_arms(equal: Sequence[str], length: float, angle: float) -> list[str]:
    """Says which numbers are nominal in every arm, and the spread of the others, mm and deg."""
    remarks = []
    if equal:
        remarks.append(f"Equal to nominal in every arm: {', '.join(equal)}.")
    remarks.append(
        f"Spread between the arms: standard deviation {length:.3f} mm and {angle:.4f} deg per parameter (RMS)."
    )
    return remarks
