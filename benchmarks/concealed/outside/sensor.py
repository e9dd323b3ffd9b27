"""Families outside the catalogue that move the sensor, or shift what it sees by where it sees it."""

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside.family import (
    SPEED,
    TEMPERATURE,
    TIME,
    VELOCITY,
    Family,
    X,
    Y,
    Z,
    column,
    either,
    family,
    phrases,
    together,
)

_CYCLE = 0.4
"""m of distance in which the error of a distance meter comes round."""
_GLASS = 1.5
"""Refractive index."""


def _cyclic(distance: Array) -> Array:
    return np.sin(2 * np.pi * distance / _CYCLE) / distance


def _refracted(cosine: Array) -> Array:
    # along the normal of the pane (W. Snell, 1621); what is the same everywhere is the sensor's place
    return cosine / np.sqrt(_GLASS**2 - 1 + cosine**2)


FAMILIES: dict[str, Family] = {
    "lens_distortion": family("image", "measured position", image=lambda p: p * (p**2).sum(0)),
    "stretched_axis": family("image", "measured position x", image=lambda p: X * p[0]),
    "sensor_turn_by_time": Family(
        "sensor",
        "turn_rad",
        lambda fixed, s: (s.time / fixed["span_s"]) ** fixed["power"],
        ("span_s", "power"),
        TIME,
        (3, 4, 5),
        beside=("sensor_drift",),
    ),
    "sensor_shift_by_warmth": Family(
        "sensor", "shift_m", lambda fixed, s: s.warmth(), (), TEMPERATURE, (0, 1, 2), warm=True
    ),
    "squared_drift": Family(
        "sensor",
        "shift_m",
        lambda fixed, s: (s.time / fixed["span_s"]) ** fixed["power"],
        ("span_s", "power"),
        TIME,
        (0, 1, 2),
        beside=("sensor_drift", "base_drift"),
    ),
    # a tall tripod that sways
    "swaying_sensor": Family(
        "sensor",
        "shift_m",
        lambda fixed, s: np.sin(2 * np.pi * fixed["turns"] * s.time / fixed["span_s"] + fixed["phase"]),
        ("span_s", "turns", "phase"),
        TIME,
        (0, 1, 2),
        beside=("sensor_drift", "base_drift"),
    ),
    # air that is warmer on one side bends the sight, by the square of the distance
    "bent_beam": family("image", "measured position", image=lambda p: Z * (p**2).sum(0)),
    # a sensor stands on the arm's bench, which gives way as the arm leans over
    "shared_bench": Family(
        "sensor",
        "shift_m",
        lambda fixed, s: s.base_moment[:, 0] / fixed["base_moment_Nm"],
        ("base_moment_Nm",),
        phrases("base moment x"),
        (0, 1, 2),
        loaded=True,
    ),
    # the circle on which a tracker reads its azimuth turns out of its centre: by the sine, square to the sight
    "eccentric_circle": family(
        "image", "measured position", image=lambda p: (Y * p[0] - X * p[1]) * p[1] / np.hypot(p[0], p[1])
    ),
    # light that strays in a distance meter mixes with its signal, and the error comes round with the phase
    "cyclic_ranger": family("image", "measured position", image=lambda p: p * _cyclic(np.linalg.norm(p, axis=0))),
    # the head of a sensor nods in its clamp while two joints shake the floor
    "shaken_tripod": Family(
        "sensor",
        "turn_rad",
        lambda fixed, s: column(s.dq, fixed, "by") ** 2 + column(s.dq, fixed, "and") ** 2,
        ("by", "and"),
        together(either(VELOCITY, SPEED, key="by"), either(VELOCITY, SPEED, key="and")),
        (3, 4),
        moving=True,
    ),
    # a sensor looks through a pane of glass, which brings what is aslant behind it nearer than what is straight
    "glass_pane": family(
        "image", "measured position", image=lambda p: Z * _refracted(p[2] / np.linalg.norm(p, axis=0))
    ),
}
