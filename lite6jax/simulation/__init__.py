"""Recordings of a simulated arm with chosen effects, a motion that excites them, and a sensor with its noise."""

from lite6jax.simulation.commands import SAMPLES as TRACKING_SAMPLES
from lite6jax.simulation.commands import STEP_S as TRACKING_STEP_S
from lite6jax.simulation.commands import (
    TrackingSimulation,
    draw_commands,
    servos_with_effects,
    simulate_tracking,
    usual_servo,
)
from lite6jax.simulation.measurement import INSTRUMENTS, Measurement, UndeclaredNoise, measure, simulate
from lite6jax.simulation.motions import draw_calibration, draw_motion, draw_sensor_frame, perturb

__all__ = [
    "INSTRUMENTS",
    "TRACKING_SAMPLES",
    "TRACKING_STEP_S",
    "Measurement",
    "TrackingSimulation",
    "UndeclaredNoise",
    "draw_calibration",
    "draw_commands",
    "draw_motion",
    "draw_sensor_frame",
    "measure",
    "perturb",
    "servos_with_effects",
    "simulate",
    "simulate_tracking",
    "usual_servo",
]
