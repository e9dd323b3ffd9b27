"""Tables on the screen for many arms: their comparison, and the conversion of a file."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from lite6jax.arms.files import Conversion
from lite6jax.report.cells import SCREEN, SHOWS_AS_ZERO, STATISTICS, fixed, listing

if TYPE_CHECKING:
    from lite6jax.fitting.fleet import Comparison  # which takes JAX, and conversions do not

_MOST_ARMS = 12


def comparison_report(comparison: "Comparison", width: int) -> Iterator[RenderableType]:
    """A comparison of arms of one model."""
    names, form = comparison.names, comparison.arm.form
    arms = len(names)
    yield Text(
        f"{arms} arms of the type {comparison.arm.name}; flange over {comparison.from_nominal.shape[1]} samples."
    )
    yield ""
    yield Text("Distance from nominal (mm)")
    table = listing("arm", "mean", "median", "p95", "max", "file")
    table.columns[-1].justify, table.columns[-1].no_wrap, table.columns[-1].overflow = "left", False, "fold"
    for k in range(arms):
        cells = (f"{1e3 * float(statistic(comparison.from_nominal[k])):.3f}" for _, statistic in STATISTICS)
        table.add_row(str(k + 1), *cells, Text(names[k]))
    yield table
    yield ""
    shown = list(range(arms)) if arms <= _MOST_ARMS else []
    fitting = max(1, (width - 32) // 9)
    blocks = [shown[i : i + fitting] for i in range(0, len(shown), fitting)] or [[]]
    for block in blocks:
        which = f", arms {block[0] + 1}–{block[-1] + 1}" if len(blocks) > 1 else ""
        yield Text(f"Hayati parameters minus nominal{which}")
        yield _differences_table(comparison, block)
        yield ""
    scale = np.array([SCREEN[unit][0] for unit in form.units])
    equal = [name for name, most in zip(form.names, scale * comparison.largest, strict=True) if most < SHOWS_AS_ZERO]
    if equal:
        yield Text(f"Equal to nominal in every arm: {', '.join(equal)}.")
    lengths = np.array([unit == "m" for unit in form.units])
    spread = scale * comparison.spread
    yield Text(
        f"Spread between the arms: standard deviation {np.sqrt(np.mean(spread[lengths] ** 2)):.3f} mm and"
        f" {np.sqrt(np.mean(spread[~lengths] ** 2)):.4f} deg per parameter (RMS)."
    )
    yield from _pairwise_distances(comparison)


def _differences_table(comparison: "Comparison", arms: Sequence[int]) -> Table:
    form = comparison.arm.form
    table = listing("", "", *(str(k + 1) for k in arms), "std", "largest")
    for i, (name, unit) in enumerate(zip(form.names, form.units, strict=True)):
        scale, shown = SCREEN[unit]
        if scale * comparison.largest[i] < SHOWS_AS_ZERO:
            continue
        own = (fixed(scale * comparison.difference[k, i], sign="+") for k in arms)
        table.add_row(name, shown, *own, f"{scale * comparison.spread[i]:.4f}", f"{scale * comparison.largest[i]:.4f}")
    return table


def _pairwise_distances(comparison: "Comparison") -> Iterator[RenderableType]:
    arms = len(comparison.names)
    if arms <= 8:
        table = listing("arm", *(str(k + 1) for k in range(arms)))
        for i in range(arms):
            table.add_row(
                str(i + 1), *("–" if i == j else f"{1e3 * comparison.between[i, j]:.2f}" for j in range(arms))
            )
        yield ""
        yield Text("Largest distance between two arms' flanges (mm)")
        yield table
        return
    pairs = np.triu_indices(arms, 1)
    distance = comparison.between[pairs]
    near, far = int(np.argmin(distance)), int(np.argmax(distance))
    yield Text(
        f"Between two arms: {1e3 * distance[near]:.3f} mm at most for the nearest pair"
        f" ({pairs[0][near] + 1} and {pairs[1][near] + 1}), {1e3 * distance[far]:.3f} mm for the furthest"
        f" ({pairs[0][far] + 1} and {pairs[1][far] + 1})."
    )


def conversion_report(done: Conversion) -> Iterator[RenderableType]:
    """The largest change of the flange position by a conversion, and the parts that it omits."""
    kept = f"{1e3 * done.difference:.1e}" if done.difference else "0"
    yield Text(f"Form {done.form}, arm {done.arm.name}; read back, the flange differs by at most {kept} mm.")
    if done.left_out:
        yield Text(f"Left out: {'; '.join(done.left_out)}.")
