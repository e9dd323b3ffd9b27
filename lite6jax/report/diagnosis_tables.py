"""The screen report of a diagnosis: verdict, errors before and after, findings, and what was not tested."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from lite6jax.arms import frames
from lite6jax.domains.pose.registration import Registration
from lite6jax.recordings.fault import DataFault
from lite6jax.report import reference, statements
from lite6jax.report.cells import SCREEN, fixed, listed, listing, number
from lite6jax.report.data_faults import ruled_out_statements

ERRORS = ("heldout_position_rms_m", "heldout_position_p95_m", "heldout_position_max_m")
"""The keys of errors in the JSON file: root mean square, 95th percentile and largest."""


def diagnosis_report(document: Mapping[str, Any], source: str) -> Iterator[RenderableType]:
    """The screen report.

    Args:
        document: as in the JSON file, with statements.
        source: the recording.
    """
    model = document["model"]
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(f"{model['arm']}, {document['samples']} samples ({model['motion']}).")
    yield ""
    if "against" in document:
        yield from _reference(document["against"])
        yield ""
    yield Text(statements.verdict_statement(document))
    yield from map(Text, statements.cautions(document))
    yield ""
    table = listing("held-out position error (mm)", "rms", "p95", "max")
    for name in ("before", "after"):
        table.add_row(name, *(number(1e3 * document[name][key]) for key in ERRORS))
    yield table
    yield Text(noise_statement(document))
    yield from _headed("Data faults:", map(_fault, document["data_faults"]))
    if document["findings"]:
        yield ""
        yield Text("Findings:")
        yield _findings(document)
    yield from _headed("Assumptions:", statements.assumptions(document))
    ruled_out = (DataFault(entry["fault"], (), entry["numbers"]) for entry in document["ruled_out"])
    yield from _headed("Data faults tested and ruled out:", ruled_out_statements(ruled_out))
    yield from _headed("Effects not tested:", map(_untested, statements.untested(document)))
    yield from _headed("What to record next:", statements.what_to_record(document))
    for item in document["separating_poses"]:
        yield ""
        yield Text(f"{statements.separating_title(item)}:")
        yield _poses(item["joint_position_rad"])
    if document["separating_poses"]:
        yield Text(statements.NOT_CHECKED)
    yield ""


def noise_statement(document: Mapping[str, Any]) -> str:
    """The noise estimated from the residuals beside the declared one."""
    estimated, declared = (document["noise"][f"{name}_position_m"] for name in ("estimated", "declared"))
    beside = "none is declared" if declared is None else f"{number(1e3 * declared)} mm is declared"
    return f"Noise per axis of position: the residuals have {number(1e3 * estimated)} mm, {beside}."


def _reference(comparison: Mapping[str, Any]) -> Iterator[RenderableType]:
    yield Text(reference.headline(comparison))
    yield from (_indented(entry["statement"]) for entry in (*comparison["differences"], *comparison["notes"]))
    yield _indented(comparison["statement"])


def _findings(document: Mapping[str, Any]) -> Table:
    table = Table.grid(padding=(0, 1, 0, 0))
    for k, finding in enumerate(statements.findings_of(document), 1):
        lines = [f"{finding['statement']} {statements.p_value_statement(finding)}"]
        rivals = statements.undistinguished(finding)
        if rivals:
            lines.append(f"Not distinguished from {', '.join(rivals)}.")
        table.add_row(Text(f"{k}."), Text("\n".join(lines)))
    return table


def _fault(entry: Mapping[str, Any]) -> str:
    rows = f" Rows {listed(entry['rows'])}." if entry["rows"] else ""
    return f"{entry['statement']}{rows}"


def _untested(group: statements.Untested) -> str:
    names = ", ".join(f"{name} at {sites}" for name, sites in statements.by_site(group.entries))
    return f"{statements.capital(names)}. {group.reason}"


def _headed(heading: str, lines: Iterable[str]) -> Iterator[RenderableType]:
    """A heading with indented lines; nothing where there are none."""
    for k, line in enumerate(lines):
        if not k:
            yield ""
            yield Text(heading)
        yield _indented(line)


def _indented(line: str) -> RenderableType:
    return Padding(Text(line), (0, 0, 0, 2))


def _poses(joint_position: list[list[float]]) -> Table:
    table = listing("", *(f"q{joint}" for joint in range(1, len(joint_position[0]) + 1)))
    for k, row in enumerate(np.rad2deg(joint_position), 1):
        table.add_row(str(k), *(fixed(float(angle), 1) for angle in row))
    return table


def registration_report(found: Registration) -> Iterator[RenderableType]:
    """The frames that were fitted, and the remaining errors."""
    kept = found.kept
    turned = ""
    if found.turned is not None:
        turned = f" and {number(float(np.rad2deg(np.sqrt(np.mean(np.sum(found.turned[kept] ** 2, 1))))))} deg"
    yield Text(f"The registration on {len(kept)} rows leaves errors of {number(1e3 * found.rms)} mm{turned} RMS.")
    if not kept.all():
        yield Text(f"{np.sum(~kept)} rows are outliers and have little weight.")
    table = listing("", "x", "y", "z", "roll", "pitch", "yaw")
    for name, T in (("sensor to base", found.T_sensor_base), ("flange to tool", found.T_flange_tool)):
        row = frames.row_from_transform(T) * np.repeat([SCREEN["m"][0], SCREEN["rad"][0]], 3)
        table.add_row(f"{name} (mm, deg)", *(fixed(float(value), 3) for value in row))
    yield table
    if found.turned is None:
        yield Text("Positions do not determine the tool's rotation: only its offset is fitted.")
