"""Families of physics outside the catalogue: where each acts, on what it depends, and which of them are sealed."""

from benchmarks.concealed.outside.drawing import drawn, straight
from benchmarks.concealed.outside.family import Drivers, Family, Fixed, Signals
from benchmarks.concealed.outside.opened import FAMILIES, OPENED, SEALED, families, seen_shift

__all__ = [
    "FAMILIES",
    "OPENED",
    "SEALED",
    "Drivers",
    "Family",
    "Fixed",
    "Signals",
    "drawn",
    "families",
    "seen_shift",
    "straight",
]
