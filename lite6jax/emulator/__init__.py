"""An emulated controller on loopback, to which the SDK connects, with selectable faults and physical effects."""

from lite6jax.emulator.body import EmulatedArm
from lite6jax.emulator.core import Faults, describe_faults, parse_faults
from lite6jax.emulator.server import Controller
from lite6jax.simulation.motions import draw_sines, interpolate, read_path, visit

__all__ = [
    "Controller",
    "EmulatedArm",
    "Faults",
    "describe_faults",
    "draw_sines",
    "interpolate",
    "parse_faults",
    "read_path",
    "visit",
]
