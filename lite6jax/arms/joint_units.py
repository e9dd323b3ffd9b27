"""Units of a joint: rad and Nm of a revolute one, m and N of a prismatic one, and the sizes that these entail.

Whatever is known of a revolute joint's coordinate q and of the torque τ of its motor holds for the coordinate and the
force of a prismatic joint: only the units differ. Everything that names a unit, or compares with a threshold that has
one, asks here.
"""

import re
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

LEVER = 0.1
"""m, the lever at which a prismatic joint's thresholds, typical sizes and bounds are those of a revolute joint: by a
pinion, a pulley or a link of that length a rotation becomes a shift in arms of the usual size. 0.02 rad is then 2 mm,
and 1 Nm is 10 N. Units do not depend on it, and estimates do only in so far as a threshold decides."""

_OF_SLIDE = {"Nm": ("N", -1), "rad": ("m", 1), "kg·m²": ("kg", -2), "inertia_kg_m2": ("mass_kg", -2)}
"""Of a revolute joint's unit, that of a prismatic joint and the power of the lever by which its sizes differ."""
_WORD = re.compile(rf"(?<![A-Za-z])(?:{'|'.join(_OF_SLIDE)})(?![A-Za-z])")


def joint_unit(text: str, slides: bool) -> str:
    """A unit of a revolute joint, or a name that contains one, as that of a joint that is prismatic where it `slides`.

    Nm·s/rad is N·s/m, and `viscous_Nm_s_per_rad` is `viscous_N_s_per_m`.
    """
    return _WORD.sub(lambda found: _OF_SLIDE[found.group()][0], text) if slides else text


def joint_size(value: float, unit: str, slides: bool) -> float:
    """A size in a unit of a revolute joint, as one of a joint that is prismatic where it `slides`, by `LEVER`."""
    if not slides:
        return value
    above, *below = unit.split("/")
    powers = [sum(_OF_SLIDE[word][1] for word in _WORD.findall(part)) for part in (above, "/".join(below))]
    return value * LEVER ** (powers[0] - powers[1])


def joint_sizes(value: float, unit: str, slides: ArrayLike | bool) -> NDArray[np.floating]:
    """A size for each joint: `joint_size` of `slides` `(joint,)`."""
    return np.where(np.asarray(slides, bool), joint_size(value, unit, True), value)


def as_revolute(values: ArrayLike, unit: str, slides: ArrayLike | bool) -> NDArray[np.floating]:
    """Values `(joint, …)` of joints divided by what one `unit` of a revolute joint is of each, for a common threshold.

    Args:
        values: in `unit` of revolute joints, and in its counterpart of those that slide.
        unit: such as `rad/s`.
        slides: `(joint,)`, or one bool for all.
    """
    values = np.asarray(values, float)
    sizes = joint_sizes(1.0, unit, slides)
    return values / sizes.reshape(sizes.shape + (1,) * (values.ndim - sizes.ndim))


def by_kind(
    name: str, values: NDArray[np.floating], slides: ArrayLike, statistic: Callable[[NDArray[np.floating]], float]
) -> dict[str, float]:
    """A statistic of the values of revolute joints, and of those of prismatic joints: the two have no common unit.

    Args:
        name: of the number, with the unit of a revolute joint, such as `moves_rms_Nm`.
        values: `(joint, …)`.
        slides: `(joint,)`.
        statistic: of the values of all joints of one kind.

    Returns:
        the number of each kind that is there, by its name.
    """
    of_slide = np.asarray(slides, bool)
    return {
        joint_unit(name, kind): float(statistic(values[of_slide == kind]))
        for kind in (False, True)
        if (of_slide == kind).any()
    }
