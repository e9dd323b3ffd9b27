"""A least-squares fit that is told the form of the truth: what no search can beat but by luck."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.chain import Array, vector_from_rotation
from benchmarks.concealed.plain_physics import Hidden, Setup, poses
from benchmarks.concealed.view import View

_ROUNDS = 3
"""Of Gauss and Newton's method, which starts at the truth."""
_HALVINGS = 5


def oracle(
    view: View, believed: Setup, hidden: tuple[Hidden, ...], measured: tuple[Array, Array], used: NDArray[np.bool_]
) -> tuple[Setup, tuple[Hidden, ...]]:
    """A least-squares fit that is told which effects there are, and where, and starts at the truth.

    Of the set-up that is `believed`, what is closed is held and a prior is centred there; rows that are `used` are no
    faults.
    """
    size = view.open.size(believed.chain.dof)
    rows = np.repeat(used, 6 if view.noise[1] else 3)

    def missed(x: Array, found: tuple[Hidden, ...]) -> Array:
        shown = poses(view.open.moved(believed, x), found, view.motion)
        numbers = view.difference(measured, shown)[rows]
        return np.concatenate([numbers, view.prior() @ x]) if view.open.prior else numbers

    x, found = _open_difference(view, believed), hidden
    left = missed(x, found)
    for _ in range(_ROUNDS if size or hidden else 0):
        here = replace(view, setup=view.open.moved(believed, x))
        columns = [here.nuisance(found)] if size else []
        columns += [here.padded(here.columns(found, k)) for k in range(len(found))]
        slopes = np.concatenate(columns, 1)
        slopes = slopes[np.concatenate([rows, np.ones(len(slopes) - len(rows), bool)])]
        lengths = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
        step = -np.linalg.lstsq(slopes / lengths, left)[0] / lengths
        for _ in range(_HALVINGS):
            tried = x + step[:size], _moved(found, step[size:])
            beyond = missed(*tried)
            if beyond @ beyond <= left @ left:
                (x, found), left = tried, beyond
                break
            step = step / 2
    return view.open.moved(believed, x), found


def _moved(hidden: tuple[Hidden, ...], step: Array) -> tuple[Hidden, ...]:
    moved = []
    for effect in hidden:
        values = np.array(effect.values)
        moved.append(effect.sized(values + step[: len(values)]))
        step = step[len(values) :]
    return tuple(moved)


def _open_difference(view: View, believed: Setup) -> Array:
    """The open numbers by which the true set-up differs from the believed one."""
    x, open_ = [], view.open
    if open_.frame:
        turn = view.setup.sensor[:3, :3] @ believed.sensor[:3, :3].T
        x += [view.setup.sensor[:3, 3] - believed.sensor[:3, 3], vector_from_rotation(turn)]
    if open_.tool:
        x.append(view.setup.tool[:3, 3] - believed.tool[:3, 3])
        if open_.tool == 6:
            x.append(vector_from_rotation(believed.tool[:3, :3].T @ view.setup.tool[:3, :3]))
    if open_.geometry:
        x.append((view.setup.chain.rows - believed.chain.rows).ravel())
    return np.concatenate(x) if x else np.zeros(0)
