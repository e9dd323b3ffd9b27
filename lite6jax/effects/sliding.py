"""Which joints of a motion are prismatic: known when a function is compiled, so that no array says it."""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from lite6jax.deferred import register_static


@final
@register_static
@dataclass(frozen=True)
class Sliding:
    """The prismatic joints of a chain, counted from 0. A pytree without leaves.

    Attributes:
        joints: in order.
    """

    joints: tuple[int, ...] = ()

    def mask(self, dof: int) -> NDArray[np.bool_]:
        """`(joint,)`, true for prismatic joints."""
        return np.isin(np.arange(dof), self.joints)
