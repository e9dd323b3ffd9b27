"""The arms that come with the library, each number with its source in `data/`."""

from functools import cache
from pathlib import Path

from lite6jax.arms import entries
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import read_description
from lite6jax.errors import InputError

_DATA = Path(__file__).parent / "data"

# The same model from another file of the vendor: excluded when the model of a calibration is recognised.
VARIANTS = ("lite6_ros",)

_MAKERS = {"lite6": "UFACTORY", "uf": "UFACTORY", "xarm": "UFACTORY", "ur": "Universal Robots"}
"""By how the name of an arm begins."""


@cache
def bundled_arms() -> tuple[str, ...]:
    """The names of the bundled arms, in alphabetical order."""
    return tuple(sorted(path.stem for path in _DATA.glob("*.yaml")))


def maker_of(name: str) -> str:
    """Who makes the bundled arm of this name; empty of any other arm."""
    return next((maker for start, maker in _MAKERS.items() if name in bundled_arms() and name.startswith(start)), "")


def bundled_of(joints: int) -> list[Arm]:
    """The bundled models of so many joints, in alphabetical order; of each one table."""
    arms = [load_bundled(name) for name in bundled_arms() if name not in VARIANTS]
    return [arm for arm in arms if arm.dof == joints]


@cache
def load_bundled(name: str) -> Arm:
    """A bundled arm by its name.

    Raises:
        InputError: no such arm; the message lists the names.
    """
    if name not in bundled_arms():
        raise InputError(f"no bundled arm {name!r}; {entries.suggestion(name, bundled_arms())}")
    return read_description(_DATA / f"{name}.yaml")
