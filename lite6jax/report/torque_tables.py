"""The screen report of a diagnosis of torques."""

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from lite6jax.report import statements, torque_reference, torque_statements
from lite6jax.report.cells import listed, listing


def torque_report(document: Mapping[str, Any], source: str) -> Iterator[RenderableType]:
    """The screen report.

    Args:
        document: as in the JSON file, with statements.
        source: the recording.
    """
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(torque_statements.setting_statement(document))
    yield ""
    if "against" in document:
        comparison = document["against"]
        yield Text(torque_reference.headline(comparison))
        lines = [*(entry["statement"] for entry in comparison.get("differences", ())), comparison["statement"]]
        yield from (Padding(Text(line), (0, 0, 0, 2)) for line in lines)
        yield ""
    yield Text(torque_statements.verdict_statement(document))
    yield from map(Text, torque_statements.cautions(document))
    yield ""
    yield _errors(document)
    yield Text(torque_statements.filter_statement(document))
    yield Text(torque_statements.inertial_statement(document))
    if document["data_faults"]:
        yield ""
        yield Text("Data faults:")
        for fault in document["data_faults"]:
            rows = f" Rows {listed(fault['rows'])}." if fault["rows"] else ""
            yield Padding(Text(f"{fault['statement']}{rows}"), (0, 0, 0, 2))
    if document["findings"]:
        yield ""
        yield Text("Findings:")
        yield _findings(document)
    groups = torque_statements.untested(document)
    if groups:
        yield ""
        yield Text("Effects not tested:")
        for group in groups:
            names = ", ".join(f"{name} at {sites}" for name, sites in statements.by_site(group.entries))
            yield Padding(Text(f"{statements.capital(names)}. {group.reason}"), (0, 0, 0, 2))
    to_record = torque_statements.what_to_record(document)
    if to_record:
        yield ""
        yield Text("What to record next:")
        yield from (Padding(Text(line), (0, 0, 0, 2)) for line in to_record)
    yield ""


def _errors(document: Mapping[str, Any]) -> Table:
    """Held-out errors by joint, one a line: seven joints side by side do not fit a narrow terminal."""
    stages = [document[stage] for stage in ("before", "after")]
    table = listing("held-out error (Nm RMS)", "before", "after")
    table.add_row("all joints", *(f"{stage['heldout_torque_rms_Nm']:.3g}" for stage in stages))
    by_joint = zip(*(stage["heldout_torque_rms_by_joint_Nm"] for stage in stages), strict=True)
    for joint, errors in enumerate(by_joint, 1):
        table.add_row(f"joint {joint}", *(f"{error:.3g}" for error in errors))
    return table


def _findings(document: Mapping[str, Any]) -> Table:
    table = Table.grid(padding=(0, 1, 0, 0))
    for k, finding in enumerate(document["findings"], 1):
        lines = [f"{finding['statement']} {statements.p_value_statement(finding)}"]
        rivals = torque_statements.undistinguished(finding)
        if rivals:
            lines.append(f"Not distinguished from {', '.join(rivals)}.")
        table.add_row(Text(f"{k}."), Text("\n".join(lines)))
    return table
