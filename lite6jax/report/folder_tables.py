"""What is printed of the files of a folder: errors by type of arm, findings, and the files that need a look."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from lite6jax.fitting.quality import Result
from lite6jax.folders.diagnoses import DIAGNOSED
from lite6jax.folders.fleet import Row
from lite6jax.report.cells import listing, number

_DOMAINS = (("poses", "verdict", "position_rms_m", 1e3), ("torques", "torque_verdict", "torque_rms_Nm", 1.0))
"""With the columns of the verdict and the errors, and the factor to the unit on the screen."""


def folder_report(rows: Iterable[Row], kept: int = 0) -> Iterator[RenderableType]:
    """Position errors by type of arm, and a line for each file without a usable fit.

    Args:
        rows: of the files, looked at once.
        kept: how many of them are of an earlier run that was ended.
    """
    groups: dict[tuple[str, str], list[tuple[bool, float | None, float | None]]] = {}
    bad: list[str] = []
    count = 0
    for row in rows:
        count += 1
        if row.arm:
            nominal, checked = (part and 1e3 * part.position_max for part in (row.nominal, row.checked))
            groups.setdefault((row.kind, row.arm), []).append((row.result == Result.CONVERGED, nominal, checked))
        if row.failed:
            bad.append(row.message if row.file in row.message else f"{row.file}: {row.message}")
    if kept:
        yield Text(
            f"{kept} of {count} files had been fitted by a run that was ended; their rows are those of that run."
        )
    table = listing("arm", "files", "ok", "nominal", "worst", "check")
    for (kind, arm), group in sorted(groups.items()):
        nominal = [error for _, error, _ in group if error is not None]
        checked = [error for _, _, error in group if error is not None]
        good = sum(converged for converged, _, _ in group)
        name = arm if kind == "calibration" else f"{arm} (recorded)"
        table.add_row(
            name, str(len(group)), str(good), f"{median(nominal):.3f}", f"{max(nominal):.3f}", number(max(checked))
        )
    if groups:
        yield Text("By type of arm; position errors in mm")
        yield table
        yield Text(
            "nominal, worst: median and largest, over the arms, of the maximum error before the fit;"
            " check: largest after it."
        )
    if bad:
        yield ""
        yield Text(f"{len(bad)} of {count} files have no usable fit:")
        for message in bad:
            yield Padding(Text(message), (0, 0, 0, 2))


def read_diagnoses(path: Path) -> list[dict[str, Any]]:
    """The rows of a table of diagnoses."""
    import pyarrow.parquet as pq

    return pq.read_table(path).to_pylist()


def diagnoses_report(rows: Sequence[dict[str, Any]], kept: int = 0) -> Iterator[RenderableType]:
    """A line for each recording with its verdict, its errors and its findings, and for each that was not diagnosed.

    Args:
        rows: of `folders.diagnoses.SCHEMA`.
        kept: how many of them are of an earlier run that was ended.
    """
    yield from _of_earlier_run(kept, len(rows), "diagnosed")
    done = [row for row in rows if row["result"] == DIAGNOSED]
    table = listing("recording", "verdict", "before", "after")
    for column in table.columns[:2]:
        column.justify, column.no_wrap, column.overflow = "left", False, "fold"
    table.columns[1].min_width = len("unexplained")
    found: list[str] = []
    for row in done:
        for domain, verdict, unit, scale in _DOMAINS:
            if row[verdict] is None:
                continue
            errors = (row[f"{when}_{unit}"] for when in ("before", "after"))
            cells = ("–" if error is None else number(scale * error) for error in errors)
            name = row["file"] if domain == "poses" or row["verdict"] is None else ""
            table.add_row(Text(name), row[verdict].replace("_", " "), *cells)
        names = [f"{each['effect']} {each['site']}" for each in row["findings"]]
        if names:
            found.append(f"{row['file']}: {'; '.join(names)}")
    if done:
        yield table
        yield Text(
            "before, after: root mean square of the errors of held-out rows without and with the findings; of poses in"
            " mm, of torques in N·m."
        )
    if found:
        yield ""
        yield Text("Findings:")
        for line in found:
            yield Padding(Text(line), (0, 0, 0, 2))
    left = [row for row in rows if row["result"] != DIAGNOSED]
    if left:
        yield ""
        yield Text(f"{len(left)} of {len(rows)} recordings were not diagnosed:")
        for row in left:
            yield Padding(Text(row["message"]), (0, 0, 0, 2))


def _of_earlier_run(kept: int, count: int, done: str) -> Iterator[RenderableType]:
    if kept:
        yield Text(
            f"{kept} of {count} files had been {done} by a run that was ended; their rows are those of that run."
        )
