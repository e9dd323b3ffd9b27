"""What a terminal says of connected arms, where a condition changes the words; the other texts are in
`templates/screens.yaml`."""

import numpy as np

from lite6jax.array_types import Array
from lite6jax.controller.recorder import LiveRecording
from lite6jax.controller.sdk import FLOOR_M, GATE_M, GATE_RAD, KinematicsCheck
from lite6jax.formatting import fixed, number, paragraph


def calibration_remarks(source: str, dof: int, arm: str, error: bool, distance: Array) -> list[str]:
    """Says whose calibration was read, and how far `(joint position,)` m its flange is from the nominal one."""
    remarks = [f"{source}: factory calibration of {dof} joints, of a {arm}."]
    if error:
        remarks.append("Note: the controller reports an error or a warning, which does not affect the calibration.")
    remarks.append(
        f"Its flange is {number(1e3 * distance.mean(), 3)} mm from the nominal one on average and "
        f"{number(1e3 * distance.max(), 3)} mm at most ({len(distance)} joint positions)."
    )
    return remarks


def _offset(offset: Array) -> str:
    """Shows x y z in mm and roll pitch yaw, rad, in degrees."""
    x, y, z = (fixed(float(length), 3) for length in offset[:3])
    roll, pitch, yaw = (fixed(float(np.degrees(angle)), 3) for angle in offset[3:])
    return f"x {x} y {y} z {z} mm, roll {roll} pitch {pitch} yaw {yaw} deg"


def tool_verified(verification: KinematicsCheck) -> str:
    """Says how the tool offset enters the controller's forward kinematics, and whether that agrees."""
    offset = "none in the controller's report"
    if verification.tool != "none":
        use = "omitted"
        if verification.tool == "applied":
            use = "applied"
        shown = _offset(verification.condition.tool_offset)
        offset = f"{shown} in its report, {use} by its forward kinematics"
    length, angle = verification.tool_agrees
    agreement = "disagrees"
    if length <= GATE_M:
        agreement = "agrees"
    return (
        f"Tool offset: {offset}; which {agreement} with the forward kinematics at the current joint position "
        f"(difference {number(1e3 * length)} mm and {number(float(np.rad2deg(angle)))} deg)."
    )


def verification_notes(verification: KinematicsCheck) -> list[str]:
    """Says what the controller reports besides, a phrase each."""
    condition = verification.condition
    notes = []
    if condition.has_world:
        notes.append(f"a base offset is set, {_offset(condition.world_offset)}; its effect is not included")
    if condition.warning:
        notes.append(f"the controller has warning {condition.warning}, which is not cleared")
    return notes


def verification_verdict(verification: KinematicsCheck) -> str:
    """Says whether controller and calibration agree, and within what."""
    if verification.passed:
        return (
            f"Passed: they agree within {number(1e3 * GATE_M, 3)} mm; rounding to 32 bits alone causes up to "
            f"{number(1e3 * FLOOR_M, 5)} mm. The controller computes with this calibration."
        )
    return (
        f"Not passed: they differ by up to {number(1e3 * verification.position.max())} mm and "
        f"{number(float(np.rad2deg(verification.orientation.max())))} deg; above {1e3 * GATE_M:g} mm or "
        f"{np.rad2deg(GATE_RAD):.4f} deg a difference is significant."
    )


def cause_of_difference(verification: KinematicsCheck) -> str:
    """Says why a controller computes otherwise than its calibration, and what to do."""
    if verification.hidden_tool is not None:
        return (
            f"A constant offset after the flange explains the difference: {_offset(verification.hidden_tool)}. The "
            "controller has a tool offset that its report omits; set the tool offset to zero with the vendor's "
            "program, and verify again."
        )
    if verification.other_chain is not None:
        return (
            f"The controller computes with the nominal chain {verification.other_chain}, not with its stored "
            "calibration; update its firmware, or use that chain to reproduce its poses."
        )
    return (
        "The six-parameter chain does not explain this controller's kinematics. Record and diagnose the poses that it "
        "computes:"
    )


def computed_rows(recorded: LiveRecording) -> list[str]:
    """Says for how many joint positions the controller computed a pose."""
    remarks = [f"Recorded the controller's forward kinematics at {recorded.rows} joint positions; nothing moved."]
    if recorded.missing:
        remarks.append(f"{recorded.missing} joint positions were not requested.")
    return remarks


def moved_rows(recorded: LiveRecording) -> list[str]:
    """Says how many rows of a motion were recorded, and how many are missing."""
    runs = ""
    if recorded.runs > 1:
        runs = f" in {recorded.runs} runs"
    remarks = [
        f"Recorded {recorded.rows} rows{runs}: {recorded.duration:.3f} s at {recorded.rate:.2f} Hz by the controller's "
        "clock."
    ]
    if recorded.short:
        remarks.append(f"{recorded.asked} rows were asked for.")
    if recorded.runs > 1 and recorded.missing_within + recorded.missing_between:
        missing = (
            f"{recorded.missing_within} reports missing within runs, about {recorded.missing_between} between runs"
        )
    elif recorded.runs > 1:
        missing = "No report missing within or between runs"
    elif recorded.missing_within:
        missing = f"{recorded.missing_within} reports missing"
    else:
        missing = "No report missing"
    duplicates = "no duplicates"
    if recorded.repeated:
        duplicates = f"{recorded.repeated} duplicates removed"
    gaps = ""
    if recorded.gaps:
        gaps = "The columns missing and gap say where and why."
    remarks.append(paragraph(f"{missing}, {duplicates}.", gaps))
    return remarks


def recorded_rows(recorded: LiveRecording) -> list[str]:
    """Says how much was recorded, and what is missing."""
    computed = recorded.settings.joint_source == "commanded"
    if recorded.rows and computed:
        return computed_rows(recorded)
    if recorded.rows:
        return moved_rows(recorded)
    remarks = ["Nothing was recorded, and nothing is written."]
    if computed and recorded.missing:
        remarks.append(f"{recorded.missing} joint positions were not requested.")
    return remarks
