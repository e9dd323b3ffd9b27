"""What is uncertain of the links of an arm before its torques are seen."""

import numpy as np
from numpy.typing import NDArray

from lite6jax.effects.dynamic.torque_effect import point_mass

Array = NDArray[np.floating]

_UNKNOWN_MASS, _UNKNOWN_LEVER = 3.0, 0.1
"""kg and m, of links about which nothing is declared."""


def uncertain(links: Array, relative: float) -> tuple[Array, Array]:
    """Changes `(number, joint, 10)` of inertial numbers, and the standard deviation `(number,)` of each's prior.

    They are those of each link's mass with its centre in place, of its centre of mass with its mass and tensor as they
    are, and of its tensor: what is uncertain by itself. A heavier link has larger first moments as well. The prior of a
    mass is relative to it, that of a centre to its distance from the joint, or to the mean such distance of the arm
    where that is larger, that of a tensor to it and to the mass at that distance. Links of unknown mass are taken as
    ones of `_UNKNOWN_MASS` at `_UNKNOWN_LEVER`.
    """
    mass = np.maximum(links[:, 0], _UNKNOWN_MASS * (not links.any()) + 0.05 * links[:, 0].mean())
    lever = np.linalg.norm(links[:, 1:4], axis=1) / mass
    lever = np.maximum(lever, lever.mean() if lever.any() else _UNKNOWN_LEVER)
    directions, deviations = np.zeros((len(links), 10, *links.shape)), np.zeros((len(links), 10))
    for j, (m, length) in enumerate(zip(mass, lever, strict=True)):
        center = links[j, 1:4] / m
        own = links[j, 4:7].sum() / 2 - point_mass(m, center)[4:7].sum() / 2
        directions[j, 0, j] = point_mass(1.0, center)
        for axis, step in enumerate(np.eye(3)):  # exact: a point's tensor is quadratic in its place
            directions[j, 1 + axis, j] = m * 0.5 * (point_mass(1.0, center + step) - point_mass(1.0, center - step))
        directions[j, 4:, j, 4:] = np.eye(6)
        deviations[j] = [m, *(3 * [length]), *(6 * [m * length**2 + max(own, 0.0)])]
    return directions.reshape(-1, *links.shape), relative * deviations.ravel()
