"""Arrays of few shapes: what is compiled for one recording then serves the next, however many samples it has."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from lite6jax.array_types import AnyArray

_LEAST = 64


def filled_size(samples: int, least: int = _LEAST) -> int:
    """The smallest 2ᵏ or 3·2ᵏ that is no less than so many samples, nor than `least`: it adds at most one half."""
    at_least = max(samples, least)
    power = 1 << (at_least - 1).bit_length()
    return 3 * power // 4 if at_least <= 3 * power // 4 else power


def filled(array: ArrayLike, *sizes: int) -> AnyArray:
    """The array with the last entries along its first axes repeated, until these have so many."""
    values = np.asarray(array)
    whole = np.empty((*sizes, *values.shape[len(sizes) :]), values.dtype)
    whole[tuple(slice(size) for size in values.shape)] = values
    for axis, size in enumerate(values.shape[: len(sizes)]):
        along = np.moveaxis(whole, axis, 0)
        along[size:] = along[size - 1]
    return whole


def filled_motion(parts: Iterable[ArrayLike]) -> tuple[list[AnyArray], int]:
    """Position, velocity and acceleration, each `(joint, sample)`, filled up to the `filled_size` of their samples.

    Returns:
        these, and how many samples there were.
    """
    motion = [np.asarray(part) for part in parts]
    joints, samples = motion[0].shape
    return [filled(part, joints, filled_size(samples)) for part in motion], samples
