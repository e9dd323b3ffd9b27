"""What commands say of what they do, where a condition changes the words; the other texts are in
`templates/commands.yaml`."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from lite6jax.effects.servo import Servo
from lite6jax.formatting import number
from lite6jax.recordings import Recording
from lite6jax.recordings.settings import RecordingSettings, ServoSettings


class SimulatedModel(NamedTuple):
    """What the sidecar of a simulated recording declares of the arm's geometry.

    Attributes:
        geometry: where the numbers are from: as drawn, that of a file, or nominal.
        uncertain: whether the sidecar declares their uncertainty.
        undeclared: whether it leaves them out.
        frame_known: whether the poses are in the frame of the arm's base.
    """

    geometry: str
    uncertain: bool
    undeclared: bool
    frame_known: bool


def _runs(count: int) -> str:
    if count > 1:
        return f" in {count} runs"
    return ""


def simulated_poses(recording: Recording, kind: str, arm: str, runs: int) -> str:
    """Says what was simulated, of which arm, and by which sensor."""
    sensor = recording.settings.pose_source.replace("_", " ")
    return f"Simulated {recording.samples} {kind} of a {arm} by {sensor}, {recording.motion}{_runs(runs)}."


def simulated_geometry(model: SimulatedModel, settings: RecordingSettings) -> str:
    """Says which geometry, sensor frame and tool a simulated arm has, and what of them is declared."""
    geometry = model.geometry
    if model.uncertain:
        geometry += ", within its declared uncertainty"
    if model.undeclared:
        geometry += ", not declared"
    frame = "unknown"
    if model.frame_known:
        frame = "the arm's base"
    tool = "declared"
    if isinstance(settings.tool, str):
        tool = settings.tool
    return f"Geometry: {geometry}. Sensor frame: {frame}. Tool: {tool}."


def simulated_noise(recording: Recording, joint_noise: float) -> str:
    """Says the declared noise of a simulated sensor, and that of the joints' read-outs, deg."""
    settings = recording.settings
    if recording.readings is not None and recording.readings.kind == "camera":
        sentence = f"Noise, as declared: {settings.pixel_noise_px:.3g} px"
    else:
        sentence = f"Noise, as declared: {1e3 * _length_noise(recording):.3g} mm"
    if settings.orientation_noise_rad is not None:
        sentence += f", {np.rad2deg(settings.orientation_noise_rad):.3g} deg"
    if joint_noise:
        sentence += f", joints {joint_noise:.3g} deg"
    return f"{sentence}."


def _length_noise(recording: Recording) -> float:
    """The declared noise of positions or of readings that are lengths, m; zero where none is."""
    settings = recording.settings
    if recording.readings is not None:
        return recording.readings.declared_noise(settings) or 0.0
    return settings.position_noise_m or 0.0


def simulated_log(samples: int, arm: str, runs: int, commands: str = "sines, trapezoids and steps") -> str:
    """Says that a log was simulated, and of which commands."""
    return f"Simulated {samples} samples of commands and measured joints of a {arm}{_runs(runs)}: {commands}."


def simulated_servos(servo: ServoSettings | None) -> str:
    """Says which servos a simulated log has; None where they are not declared."""
    if servo is None:
        return "Servos: not declared."
    stiffness = ", ".join(f"{size:.4g}" for size in servo.stiffness_Nm_per_rad)
    damping = ", ".join(f"{size:.4g}" for size in servo.damping_Nm_s_per_rad)
    return f"Servos, as declared: stiffness {stiffness} Nm/rad, damping {damping} Nm·s/rad."


def noise_of_log(noise: float, quantum: float) -> str:
    """Says the noise of the joints of a simulated log, rad, and to what they are rounded, deg."""
    sentence = f"Noise, as declared: joints {np.rad2deg(noise):.3g} deg"
    if quantum:
        sentence += f", rounded to {quantum:.3g} deg"
    return f"{sentence}."


def moved_joints(moved: Sequence[float]) -> str:
    """Says by how much effects move each joint, rad RMS."""
    sizes = ", ".join(number(1e3 * size) for size in moved)
    return f"The effects move the joints by {sizes} mrad RMS."


def emulated_motion(calibration: str, motion: str, speed: float) -> list[str]:
    """Says which calibration and which motion an emulated controller has, and how fast its clock runs."""
    sentence = f"Motion: {motion}."
    if speed != 1:
        sentence += f" Its clock runs {speed:g} times as fast."
    return [f"Calibration: {calibration}.", sentence]


def emulated_servos(servo: Servo) -> str:
    """Says which servos the joints of an emulated arm follow their commands with, as a sidecar declares them."""
    stiffness = ", ".join(f"{size:g}" for size in servo.stiffness)
    damping = ", ".join(f"{size:g}" for size in servo.damping)
    return f"servo: {{stiffness_Nm_per_rad: [{stiffness}], damping_Nm_s_per_rad: [{damping}]}}"


def emulated_faults(torque_noise: Sequence[float], faults: Sequence[str]) -> list[str]:
    """Says which noise the emulated torques have, N m, and which faults are emulated."""
    sentences = []
    if any(torque_noise):
        sizes = " ".join(f"{size:g}" for size in torque_noise)
        sentences.append(f"Noise of the torques: {sizes} N m.")
    if faults:
        sentences.append(f"Faults: {', '.join(faults)}.")
    return sentences
