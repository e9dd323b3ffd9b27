"""Which parameters the data determine, and with which ones the others are confounded."""

import numpy as np
from numpy.typing import NDArray

from lite6jax.fitting.solution import Held
from lite6jax.model import ModelForm

_DETERMINED = 1e-10
"""Squared sine of a column to the span of those before it, above which it is determined; rounding leaves 1e-15."""
_OBSERVED = 1e-20
"""A column's square over the largest of its unit below which the parameter is not observable."""
_CONFOUNDED = 0.05


def determined(form: ModelForm, curvature: NDArray[np.float64]) -> tuple[NDArray[np.bool_], tuple[Held, ...]]:
    """The entries of a step that the data determine, and those held at nominal.

    The columns are taken one by one, sensor frame and tool first: one that lies in the span of those taken before is
    held, because the data do not distinguish it from them. A parameter that is not observable at nominal affects the
    data near it to second order only: for an arm made to 1 mm and 0.1°, by 2 µm.

    Args:
        form: names the entries.
        curvature: the information `(size, size)` of data and prior.

    Returns:
        `(size,)` bool, and the held ones.
    """
    size = form.size
    geometry = form.chain.size
    order = [*range(geometry, size), *range(geometry)]
    scale = np.sqrt(np.maximum(np.diagonal(curvature), np.finfo(float).tiny))
    H = curvature / scale[:, None] / scale
    taken: list[int] = []
    held: list[Held] = []
    L = np.zeros((size, size))
    units = np.array(form.units)
    largest = np.array([np.max(np.diagonal(curvature)[units == unit], initial=0.0) for unit in units])
    observed = np.diagonal(curvature) > _OBSERVED * largest
    for k in order:
        row = np.linalg.solve(L[: len(taken), : len(taken)], H[taken, k]) if taken else np.zeros(0)
        rest = H[k, k] - row @ row
        if rest > _DETERMINED and observed[k]:
            L[len(taken), : len(taken)], L[len(taken), len(taken)] = row, np.sqrt(rest)
            taken.append(k)
            continue
        share = np.linalg.solve(H[np.ix_(taken, taken)], H[taken, k]) if observed[k] else np.zeros(len(taken))
        strong = np.abs(share) > _CONFOUNDED * max(float(np.abs(share).max(initial=0.0)), 1e-6)
        held.append(Held(form.names[k], tuple(form.names[taken[i]] for i in np.flatnonzero(strong))))
    free = np.zeros(size, bool)
    free[taken] = True
    return free, tuple(sorted(held, key=lambda h: form.names.index(h.name)))
