"""Inertia of rigid bodies: tensors as six numbers, bodies lumped into one, and which tensors a body can have."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating]

SIX = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
"""The order of a tensor's six numbers in descriptions and in link parameters."""
_ROWS, _COLUMNS = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)

ROUNDED = 1e-3
"""Of the largest principal moment: how far files that round to three or four digits miss the triangle inequality."""


class Body(NamedTuple):
    """A rigid body.

    Attributes:
        mass: kg.
        center: (3,) m, its centre of mass.
        inertia: (3, 3) kg·m² about the centre of mass, in the axes in which `center` is given.
    """

    mass: float
    center: Array
    inertia: Array


def tensor(six: ArrayLike) -> Array:
    """(..., 3, 3) of the entries (..., 6) in the order `SIX`; the products have the tensor's sign, as in URDF."""
    six = np.asarray(six, float)
    full = np.empty((*six.shape[:-1], 3, 3))
    full[..., _ROWS, _COLUMNS] = six
    full[..., _COLUMNS, _ROWS] = six
    return full


def six_entries(inertia: ArrayLike) -> Array:
    """(..., 6) entries of tensors (..., 3, 3) in the order `SIX`."""
    return np.asarray(inertia, float)[..., _ROWS, _COLUMNS]


def point_tensor(mass: ArrayLike | float, position: ArrayLike) -> Array:
    """(..., 3, 3) kg·m² about the origin of points of `mass` (...) kg at `position` (..., 3) m."""
    p = np.asarray(position, float)
    squared = (p * p).sum(-1)[..., None, None]
    return np.asarray(mass, float)[..., None, None] * (squared * np.eye(3) - p[..., :, None] * p[..., None, :])


def transform_body(body: Body, T: Array) -> Body:
    """The body in the axes to which the rigid transform `T` (4, 4) takes its coordinates."""
    R = T[:3, :3]
    return Body(body.mass, R @ body.center + T[:3, 3], R @ body.inertia @ R.T)


def lump(bodies: Iterable[Body]) -> Body:
    """Bodies that are fixed to each other as one, by the parallel-axis theorem; a single one unchanged."""
    bodies = list(bodies)
    if len(bodies) == 1:
        return bodies[0]
    mass = sum(body.mass for body in bodies)
    center = sum((body.mass * body.center for body in bodies), np.zeros(3)) / (mass or 1.0)
    inertia = sum((b.inertia + point_tensor(b.mass, b.center - center) for b in bodies), np.zeros((3, 3)))
    return Body(mass, center, inertia)


def defect(inertia: Array) -> str:
    """Why no rigid body has this tensor (3, 3) about its centre of mass; empty where one has, within `ROUNDED`.

    The principal moments of a body are not negative, and none exceeds the sum of the other two; zeros are a point's or
    a thin rod's.
    """
    scale = np.abs(inertia).max()
    if np.abs(inertia - inertia.T).max() > 1e-9 * scale:
        return "is not symmetric"
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] < -ROUNDED * scale:
        return f"has the negative principal moment {moments[0]:.4g} kg·m²"
    if moments[2] > moments[0] + moments[1] + ROUNDED * scale:
        return (
            f"has the principal moments {', '.join(f'{moment:.4g}' for moment in moments)} kg·m², the largest of which"
            " exceeds the sum of the others, as no body's does"
        )
    return ""
