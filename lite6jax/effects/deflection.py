"""Deflections of a rigid arm at each site. They add up, so that the order of effects does not matter."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from lite6jax.deferred import JaxArray, jnp


class Deflection(NamedTuple):
    """The difference between the real and the rigid arm at each sample. A pytree; None stands for zero.

    A twist is a translation (m) followed by a rotation vector (rad), both in the axes of the frame that it displaces.

    Attributes:
        joint: `(joint, sample)` rad, added to the encoders' readings.
        stretch: `(joint, sample)`, the relative growth of the vector to each joint's origin.
        link: `(joint, 6, sample)`, the twist of the frame after each joint's rotation.
        base: `(6, sample)`, the twist of the base frame.
        tool: `(6, sample)`, the twist of the flange.
        scale: `(sample,)`, the relative growth of positions in the sensor's frame.
        sensor: `(6, sample)`, the twist of all that the sensor shows, about its frame's origin and in its axes.
    """

    joint: JaxArray | None = None
    stretch: JaxArray | None = None
    link: JaxArray | None = None
    base: JaxArray | None = None
    tool: JaxArray | None = None
    scale: JaxArray | None = None
    sensor: JaxArray | None = None

    def __add__(self, other: "Deflection") -> "Deflection":  # type: ignore[override]  # not a tuple's concatenation
        sums = []
        for first, second in zip(self, other, strict=True):
            if first is None or second is None:
                sums.append(second if first is None else first)
            else:
                sums.append(first + second)
        return Deflection(*sums)


def dense(deflection: Deflection, dof: int, samples: int) -> Deflection:
    """The deflection with zeros in place of None, so that one compiled prediction serves every set of effects."""
    shapes = ((dof, samples), (dof, samples), (dof, 6, samples), (6, samples), (6, samples), (samples,), (6, samples))
    parts = (np.zeros(shape) if part is None else part for part, shape in zip(deflection, shapes, strict=True))
    return Deflection(*parts)  # type: ignore[arg-type]


def place_at_joint(dof: int, number: int, values: JaxArray) -> JaxArray:
    """What acts at one joint, or at the link behind it, as a part of a `Deflection`: zero at the others.

    Args:
        dof: how many joints the arm has.
        number: of the joint, counted from 1.
        values: `(…, sample)`, rad of a joint, or a `twist` of a link.

    Returns:
        `(joint, …, sample)`.
    """
    row = np.zeros((dof,) + (1,) * np.ndim(values))
    row[number - 1] = 1.0
    return row * values  # type: ignore[return-value]  # of NumPy values on the host: columns of a hundred candidates compile nothing


@cache
def place_of(site: str) -> tuple[str, int]:
    """The kind of a site, such as `link`, and the number of a joint or link; 0 of the others."""
    return site.rstrip("0123456789"), int("0" + "".join(filter(str.isdecimal, site)))


def place_at_site(dof: int, site: str, values: JaxArray) -> Deflection:
    """What acts at `jointN` `(sample,)` rad, or as a twist `(6, sample)` of `linkN`, `base`, `tool` or `sensor`."""
    kind, number = place_of(site)
    return Deflection(**{kind: place_at_joint(dof, number, values) if number else values})


def library_of(*values: JaxArray | None) -> Any:
    """NumPy for values on the host, where the columns of hundreds of effects are computed without compiling; else
    JAX's.
    """
    return jnp if any(isinstance(value, JaxArray) for value in values) else np


def twist(
    samples: int,
    x: JaxArray | None = None,
    y: JaxArray | None = None,
    z: JaxArray | None = None,
    rx: JaxArray | None = None,
    ry: JaxArray | None = None,
    rz: JaxArray | None = None,
) -> JaxArray:
    """The twist `(6, sample)` with these components; zero where not given.

    Args:
        samples: how many there are.
        x, y, z: `()` or `(sample,)` m, the translation.
        rx, ry, rz: `()` or `(sample,)` rad, the rotation vector.
    """
    parts = (x, y, z, rx, ry, rz)
    xp = library_of(*parts)
    filled = [xp.zeros(samples) if part is None else xp.broadcast_to(part, (samples,)) for part in parts]
    return xp.stack(filled)  # type: ignore[return-value]
