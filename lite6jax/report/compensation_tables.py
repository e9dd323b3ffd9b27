"""What a person reads of a compensation: which targets are reached, which are not and why, and how far to trust it."""

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from lite6jax.domains.pose.compensate import REACHED, Compensation
from lite6jax.domains.pose.predict import Enriched
from lite6jax.report.cells import fixed, listing, number

_ROWS_NAMED = 8


def compensation_report(
    found: Compensation, model: Enriched, document: Mapping[str, Any], source: str, frame: str
) -> Iterator[RenderableType]:
    """The page.

    Args:
        found: what was found.
        model: with what.
        document: the diagnosis file's content.
        source: the targets' file.
        frame: "sensor" or "base".
    """
    count, hit = len(found.reached), int(found.reached.sum())
    kind = "positions" if found.orientation_error is None else "positions and orientations"
    where = "the sensor's frame" if frame == "sensor" else "the arm's base"
    effects = len(model.physics.effects)
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(
        f"{_rows(count)} ({kind} in {where}) for a {model.arm} with {effects} effect{'' if effects == 1 else 's'} "
        "beyond its geometry."
    )
    yield ""
    yield Text(f"{_rows(hit)} reached" + (f", {_rows(count - hit)} not:" if hit < count else "."))
    yield from _groups(found, ~found.reached)
    if any(reason for reason, ok in zip(found.reason, found.reached, strict=True) if ok):
        yield Text("Reached, and worth a look:")
        yield from _groups(found, found.reached)
    if found.correction is not None and hit:
        yield ""
        yield from _corrections(np.abs(np.rad2deg(found.correction[found.reached])))
    for note in found.notes:
        yield Text(f"Note: {note}.")
    after, before = (document.get(part, {}).get("heldout_position_rms_m") for part in ("after", "before"))
    if isinstance(after, float) and isinstance(before, float):
        yield ""
        yield Text(
            f"To expect: this model missed rows that it had not seen by {number(1e3 * after)} mm RMS; without its "
            f"effects it was {number(1e3 * before)} mm."
        )


def _indented(line: str) -> RenderableType:
    return Padding(Text(line), (0, 0, 0, 2))


def _rows(count: int) -> str:
    return f"{count} target{'' if count == 1 else 's'}"


def _groups(found: Compensation, chosen: np.ndarray) -> Iterator[RenderableType]:
    """A line a reason, with the rows and the largest error."""
    reasons = Counter(found.reason[k] for k in np.flatnonzero(chosen) if found.reason[k])
    for reason, _ in reasons.most_common(_ROWS_NAMED):
        rows = [int(k) for k in np.flatnonzero(chosen) if found.reason[k] == reason]
        named = ", ".join(str(found.recording.row[k]) for k in rows[:_ROWS_NAMED])
        missed = _missed(found, rows)
        more = ", …" if len(rows) > _ROWS_NAMED else ""
        yield _indented(f"{reason}: row{'' if len(rows) == 1 else 's'} {named}{more}{missed}")
    rest = sum(reasons.values()) - sum(n for _, n in reasons.most_common(_ROWS_NAMED))
    if rest:
        yield _indented(f"and {rest} more; the file says which")


def _missed(found: Compensation, rows: list[int]) -> str:
    """By how much, in what is missed; rows without a target miss nothing."""
    largest = []
    for errors, scale, unit, least in (
        (found.position_error, 1e3, " mm", REACHED[0]),
        (found.orientation_error, 180 / np.pi, "°", REACHED[1]),
    ):
        most = 0.0 if errors is None else float(np.nan_to_num(errors[rows]).max())
        if most > least:
            largest.append(f"{number(scale * most)}{unit}")
    return f", off by up to {' and '.join(largest)}" if largest else ""


def _corrections(degrees: np.ndarray) -> Iterator[RenderableType]:
    table = listing("moved from the joints given (deg)", *(f"q{joint}" for joint in range(1, degrees.shape[1] + 1)))
    table.columns[0].no_wrap = False  # rather than that numbers are cut short
    for name, values in (("median", np.median(degrees, 0)), ("max", degrees.max(0))):
        table.add_row(name, *(fixed(float(value)) for value in values))
    yield table
