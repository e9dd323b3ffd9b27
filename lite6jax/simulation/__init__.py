"""Recordings of a simulated arm with chosen effects, a motion that excites them, and a sensor with its noise."""

from lite6jax.simulation.draws import draw_calibration, draw_sensor_frame, perturbed
from lite6jax.simulation.instruments import INSTRUMENTS, Instrument, UndeclaredNoise
from lite6jax.simulation.measurement import Measured, measure
from lite6jax.simulation.motions import SAMPLES, draw_motion, given_motion
from lite6jax.simulation.simulate import simulate

__all__ = [
    "INSTRUMENTS",
    "SAMPLES",
    "Instrument",
    "Measured",
    "UndeclaredNoise",
    "draw_calibration",
    "draw_motion",
    "draw_sensor_frame",
    "given_motion",
    "measure",
    "perturbed",
    "simulate",
]
