"""Families outside the catalogue that move the sensor, or shift what it sees by where it sees it."""

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside.family import (
    BY_JOINT,
    SPEED,
    TEMPERATURE,
    TIME,
    VELOCITY,
    Family,
    column,
    either,
    phrases,
    together,
)

_CYCLE = 0.4
"""m of distance in which the error of a distance meter comes round."""
_GLASS = 1.5
"""Refractive index."""

FAMILIES: dict[str, Family] = {
    "lens_distortion": Family(
        "image",
        "shift_m",
        None,
        (),
        phrases("measured position"),
        beside=("measurement_scale",),
    ),
    "skewed_axes": Family("image", "shift_m", None, (), phrases("measured position x", "measured position y")),
    "stretched_axis": Family(
        "image", "shift_m", None, (), phrases("measured position x"), beside=("measurement_scale",)
    ),
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
    # an image taken aslant: what is higher in it is smaller
    "keystone": Family("image", "shift_m", None, (), phrases("measured position"), beside=("measurement_scale",)),
    # air that is warmer on one side bends the sight, by the square of the distance
    "bent_beam": Family("image", "shift_m", None, (), phrases("measured position"), beside=("measurement_scale",)),
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
    # the circle on which a tracker reads its azimuth turns out of its centre
    "eccentric_circle": Family(
        "image", "shift_m", None, (), phrases("measured position"), beside=("measurement_scale",)
    ),
    # one camera of a pair was knocked and squints: all that is far comes too near, along its sight
    "squinting_pair": Family("image", "shift_m", None, (), phrases("measured position"), beside=("measurement_scale",)),
    # light that strays in a distance meter mixes with its signal, and the error comes round with the phase
    "cyclic_ranger": Family("image", "shift_m", None, (), phrases("measured position"), beside=("measurement_scale",)),
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
    # the axis about which a tracker raises its beam is not square to the one about which it turns
    "tilted_trunnion": Family("image", "shift_m", None, (), phrases("measured position")),
    # a sensor looks through a pane of glass, which brings what is aslant behind it nearer than what is straight
    "glass_pane": Family("image", "shift_m", None, (), phrases("measured position"), beside=("measurement_scale",)),
    # a lead from the arm to a camera is wound up as a joint turns, either way, and tugs at its head
    "wound_lead": Family(
        "sensor",
        "turn_rad",
        lambda fixed, s: column(s.q, fixed, "by") ** 2,
        ("by",),
        BY_JOINT,
        (3, 4, 5),
    ),
}


def seen_shift(name: str, position: Array) -> Array:
    """`(sample, 3)`: what an image shifts, of a number of 1, where the sensor has the point at `(sample, 3)` m."""
    x, y, z = position.T
    match name:
        case "lens_distortion":
            return position * (x**2 + y**2 + z**2)[:, None]
        case "skewed_axes":
            return np.column_stack([y, np.zeros((len(x), 2))])
        case "stretched_axis":
            return np.column_stack([x, np.zeros((len(x), 2))])
        case "keystone":
            return np.column_stack([x * y, y**2, np.zeros(len(x))])
        case "bent_beam":
            return np.column_stack([np.zeros((len(x), 2)), x**2 + y**2 + z**2])
        case "eccentric_circle":
            # off by the sine of the azimuth, square to the line of sight
            sine = y / np.hypot(x, y)
            return np.column_stack([-y * sine, x * sine, np.zeros(len(x))])
        case "squinting_pair":
            # an error of the disparity grows with the depth
            return position * z[:, None]
        case "cyclic_ranger":
            # along the line of sight
            distance = np.sqrt(x**2 + y**2 + z**2)
            return position * (np.sin(2 * np.pi * distance / _CYCLE) / distance)[:, None]
        case "tilted_trunnion":
            # off in azimuth by the tangent of the elevation
            tangent = z / np.hypot(x, y)
            return np.column_stack([-y * tangent, x * tangent, np.zeros(len(x))])
        case "glass_pane":
            # along the normal of the pane (W. Snell, 1621); what is the same everywhere is the sensor's place
            cosine = z / np.sqrt(x**2 + y**2 + z**2)
            return np.column_stack([np.zeros((len(x), 2)), cosine / np.sqrt(_GLASS**2 - 1 + cosine**2)])
    raise KeyError(name)
