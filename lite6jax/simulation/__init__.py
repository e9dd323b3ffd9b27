"""Recordings of a simulated arm with chosen effects, a motion that excites them, and a sensor with its noise."""

from lite6jax.simulation.measurement import INSTRUMENTS, Instrument, Measurement, UndeclaredNoise, measure, simulate
from lite6jax.simulation.motions import draw_calibration, draw_motion, draw_sensor_frame, perturb

__all__ = [
    "INSTRUMENTS",
    "Instrument",
    "Measurement",
    "UndeclaredNoise",
    "draw_calibration",
    "draw_motion",
    "draw_sensor_frame",
    "measure",
    "perturb",
    "simulate",
]
