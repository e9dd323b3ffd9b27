"""An emulated controller on loopback, to which the SDK connects, with selectable faults and physical effects."""

from lite6jax.emulator.body import Body
from lite6jax.emulator.faults import Faults, describe_faults, parse_faults
from lite6jax.emulator.paths import played, visits
from lite6jax.emulator.programs import draw_places, draw_sines, read_path
from lite6jax.emulator.server import Controller, Snapshot

__all__ = [
    "Body",
    "Controller",
    "Faults",
    "Snapshot",
    "describe_faults",
    "draw_places",
    "draw_sines",
    "parse_faults",
    "played",
    "read_path",
    "visits",
]
