"""How uncertain a model is, as its JSON document holds it: that of poses whole, and what that of torques shares."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.uncertainty import PerAxis, RecordedRange, Uncertainty, freed
from lite6jax.effects.composition import Physics

Array = NDArray[np.floating]
Bounds = tuple[float, float]

_ROUNDING = 1e-9
"""Of the largest covariance, by which rounding may make a variance of zero negative."""


def uncertainty_as_dict(known: Uncertainty) -> dict[str, Any]:
    """The uncertainty of a model of poses as values that JSON can hold."""
    recorded = known.recorded
    return {
        "sites": [list(site) for site in known.sites],
        "covariance": lower_triangle(known.covariance),
        "left": _per_axis(known.left),
        "unseen": _per_axis(known.unseen),
        "noise": _per_axis(known.noise),
        "typical": None if known.typical is None else _per_axis(known.typical),
        "curves": [None if curve is None else _per_axis(curve) for curve in known.curves],
        "recorded": {
            "joint_range_rad": recorded.joints.tolist(),
            "joint_position_rad": recorded.positions.tolist(),
            "spacing_rad": recorded.spacing,
            "drivers": {phrase: list(bounds) for phrase, bounds in recorded.drivers.items()},
        },
    }


def uncertainty_from_dict(entry: Any, physics: Physics, joints: int) -> Uncertainty | None:
    """The inverse; None of a document without it.

    Args:
        entry: whose keys and types have been checked.
        physics: of the model.
        joints: of the arm.

    Raises:
        ValueError: it is not that of such a model.
    """
    if entry is None:
        return None
    sites = tuple((name, j, k) for name, j, k in entry["sites"])
    sizes = {"base": (1, 6), "link": (joints, 6), "tool": (1, 6), "mass": (joints, 4), "payload": (1, 1)}
    if any(name not in sizes or not (0 <= j < sizes[name][0] and 0 <= k < sizes[name][1]) for name, j, k in sites):
        raise ValueError("a site of its uncertainty is none of this arm")
    C = covariance_from(entry["covariance"], len(sites) + sum(freed(effect).size for effect in physics.effects))
    curves = tuple(None if curve is None else _per_axis_from(curve) for curve in entry["curves"])
    recorded = entry["recorded"]
    ranges, positions = (np.asarray(recorded[f"joint_{name}_rad"], float) for name in ("range", "position"))
    if ranges.shape != (joints, 2) or positions.ndim != 2 or positions.shape[1] != joints or not len(positions):
        raise ValueError("its recorded range is not one of this arm")
    if len(curves) != len(physics.effects):
        raise ValueError("its curves are not one for each effect")
    return Uncertainty(
        sites=sites,
        covariance=C,
        left=_per_axis_from(entry["left"]),
        unseen=_per_axis_from(entry["unseen"]),
        noise=_per_axis_from(entry["noise"]),
        curves=curves,
        recorded=RecordedRange(ranges, positions, float(recorded["spacing_rad"]), drivers_from(recorded, ranges)),
        typical=None if entry.get("typical") is None else _per_axis_from(entry["typical"]),
    )


def lower_triangle(covariance: Array) -> list[float]:
    """Of a covariance `(number, number)`, row by row."""
    return covariance[np.tril_indices(len(covariance))].tolist()


def covariance_from(triangle: Any, size: int) -> Array:
    """The covariance `(size, size)` of a lower triangle.

    Raises:
        ValueError: it is of another size, or a variance is negative.
    """
    triangle = np.asarray(triangle, float)
    if triangle.shape != (size * (size + 1) // 2,):
        raise ValueError(f"its covariance is not one of {size} numbers")
    C = np.zeros((size, size))
    C[np.tril_indices(size)] = triangle
    if (np.diagonal(C) < -_ROUNDING * np.abs(triangle).max(initial=0.0)).any():
        raise ValueError("a variance of its uncertainty is negative")
    return C + np.tril(C, -1).T


def drivers_from(recorded: Mapping[str, Any], ranges: Array) -> dict[str, Bounds]:
    """What a model was recorded with beside its joints: the least and the greatest value of each driver, by its phrase.

    Args:
        recorded: the part of the document.
        ranges: `(…, 2)`, of the joints.

    Raises:
        ValueError: a range, of these or of the joints, ends before it begins.
    """
    drivers = {str(phrase): (float(lower), float(upper)) for phrase, (lower, upper) in recorded["drivers"].items()}
    if (ranges[..., 0] > ranges[..., 1]).any() or any(lower > upper for lower, upper in drivers.values()):
        raise ValueError("a recorded range of its uncertainty ends before it begins")
    return drivers


def _per_axis(std: PerAxis) -> dict[str, float]:
    return dict(zip(("position_m", "orientation_rad"), std, strict=True))


def _per_axis_from(entry: Mapping[str, Any]) -> PerAxis:
    return float(entry["position_m"]), float(entry["orientation_rad"])
