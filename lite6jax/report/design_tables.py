"""Terminal reports of a design: which poses were chosen, from how many, and what they are worth."""

from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from lite6jax.design.candidates import Candidates
from lite6jax.design.poses import MOST_POSES, DiscriminationPlan, Plan
from lite6jax.report.cells import listing, number
from lite6jax.report.study_tables import described

_CLEAR = 5.0
"""Standard deviations between two models at which a test at a level of 1 % has a power of 99 % or more."""


def design_report(
    found: Plan | DiscriminationPlan,
    drawn: Candidates,
    disabled: Sequence[tuple[str, str]],
    source: str,
    accuracy: float | None = None,
) -> Iterator[RenderableType]:
    """Which poses were chosen, from how many, and what they are worth.

    Args:
        found: the design.
        drawn: the candidates.
        disabled: pairs of links that are not checked against each other.
        source: the arm.
        accuracy: m, the target of which `found.needed` says how many poses reach it.
    """
    yield Text(source, no_wrap=True, overflow="ignore")
    refused = {name: count for name, count in drawn.refused.items() if count}
    why = f" ({', '.join(f'{name} refused {count}' for name, count in refused.items())})" if refused else ""
    yield Text(
        f"{found.count} poses of {len(drawn.joint_position)} candidates{why}; a sensor of"
        f" {described(found.experiment.sensor)}."
    )
    if disabled:
        pairs = ", ".join(f"{a} with {b}" for a, b in disabled)
        yield Text(f"Not checked for collision, as they overlap nearly always: {pairs}.")
    yield ""
    yield from _plan_report(found, accuracy) if isinstance(found, Plan) else _discrimination_report(found)
    yield ""
    if any(driver.discrete for e in found.experiment.physics.effects for driver in e.drivers):
        yield Text("For effects of the direction of motion, come to each pose from where all joints are at zero.")
    d = found.design
    way = f"{d.exchanges} exchanges in {d.cycles} rounds"
    if found.refinement is not None:
        moved = len(found.refinement.values)
        way += f", then {moved} steps between the candidates"
    yield Text(
        f"Chosen by {way}; {d.rank} combinations of {found.experiment.size} unknown parameters are identifiable."
    )


def _plan_report(found: Plan, accuracy: float | None) -> Iterator[RenderableType]:
    reached, random = found.accuracy[-1], found.random_accuracy[:, found.count - 1]
    if np.isfinite(reached):
        middle = float(np.quantile(random, 0.5, method="nearest"))
        times = f" ({middle / reached:.2f} times as much)" if np.isfinite(middle) else ""
        drawn = f"to ±{number(1e3 * middle)} mm{times}" if np.isfinite(middle) else "do not determine all parameters"
        yield Text(
            f"These poses let the fit predict positions to ±{number(1e3 * reached)} mm over the workspace; as many"
            f" drawn at random {drawn}."
        )
        worth = found.worth
        if worth is None:
            yield Text(f"{found.random_accuracy.shape[1]} random poses predict less accurately.")
        else:
            yield Text(f"They are worth {worth} random poses.")
    else:
        yield Text(
            "Positions over the workspace depend on combinations that this sensor does not determine, however many the"
            " poses: the accuracy of predictions is unbounded (lite6jax identify names the combinations)."
        )
    if accuracy is not None:
        wanted = number(1e3 * accuracy)
        if found.needed is None:
            yield Text(f"±{wanted} mm is not reached by {MOST_POSES} poses either.")
        elif found.needed <= found.count:
            yield Text(f"±{wanted} mm is reached by {found.needed} of them; give --poses {found.needed}.")
        else:
            yield Text(f"±{wanted} mm takes {found.needed} poses; give --poses {found.needed}.")
    yield ""
    if np.isfinite(reached):
        table = listing("best of these", "designed", "random", "ratio")
        table.columns[0].justify = "right"
        for n in _steps(found):
            designed, drawn = found.accuracy[n - 1], found.random_median[n - 1]
            cells = [f"±{number(1e3 * value)} mm" if np.isfinite(value) else "–" for value in (designed, drawn)]
            ratio = f"{drawn / designed:.2f}" if np.isfinite(designed) and np.isfinite(drawn) else "–"
            table.add_row(str(n), *cells, ratio)
        yield table
    if found.efficiency is not None:
        low, median, high = np.quantile(found.efficiency, (0.05, 0.5, 0.95), method="nearest")
        if np.isfinite(median):
            most = f"{high:.2f}" if np.isfinite(high) else "no number"
            yield Text(
                f"By the criterion {found.criterion} a random selection would have to be recorded {median:.2f} times"
                f" over (90 % of {len(found.efficiency)} draws: {low:.2f} to {most})."
            )
        else:
            yield Text("Most random selections of as many poses do not determine all that these do.")


def _steps(found: Plan) -> list[int]:
    """A few numbers of poses, from a third more than the least that determine all parameters."""
    determined = np.flatnonzero(np.isfinite(found.accuracy))
    least = min(-(-4 * (int(determined[0]) + 1) // 3), found.count) if len(determined) else found.count
    return sorted({int(n) for n in np.geomspace(least, found.count, 6).round()})


def _discrimination_report(found: DiscriminationPlan) -> Iterator[RenderableType]:
    one, other = found.rivals
    reached = found.distance[-1]
    random = float(np.median(np.nan_to_num(found.random_distance)))
    hypothesis, alternative = ("either effect", "the other") if found.both_ways else (one, other)
    ratio = f" (ratio {reached / random:.2f})" if random > 0 else ""
    yield Text(
        f"If {hypothesis} has the size given, the readings at these poses are {reached:.1f} standard deviations from"
        f" the closest that {alternative} explains with all other unknowns refitted; {random:.1f} at as many drawn at"
        f" random{ratio}."
    )
    if reached < _CLEAR:
        yield Text(f"A reliable decision takes {_CLEAR:g}: record more poses, or use a sensor with less noise.")
