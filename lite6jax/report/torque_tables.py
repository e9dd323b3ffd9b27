"""The screen report of a diagnosis of torques."""

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from lite6jax.report import statements, torque_statements, worth
from lite6jax.report.cells import listing
from lite6jax.report.next_steps import Files
from lite6jax.report.sections import against, chart, fault_line, finding_list, headed, ruled_out, what_to_do


def torque_report(
    document: Mapping[str, Any], source: str, files: Files | None = None, details: bool = False
) -> Iterator[RenderableType]:
    """The screen report; arguments as of `diagnosis_report`."""
    findings = torque_statements.findings_of(document)
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(torque_statements.setting_statement(document))
    yield ""
    yield from against(torque_statements.compared(document))
    yield Text(worth.headline(document))
    yield ""
    yield Text(torque_statements.verdict_statement(document))
    yield from map(Text, torque_statements.cautions(document))
    yield from chart(document, findings)
    yield ""
    yield _errors(document)
    yield Text(statements.held_out_statement(document, f"{document['kept_samples']} filtered samples"))
    yield Text(torque_statements.filter_statement(document))
    yield Text(torque_statements.inertial_statement(document))
    yield from headed("Data faults:", map(fault_line, document["data_faults"]))
    yield from finding_list(findings, torque_statements.undistinguished)
    yield from what_to_do(document, files)
    yield from headed("What to record next:", torque_statements.what_to_record(document))
    yield from ruled_out(document, torque_statements.untested(document), details)
    yield ""


def _errors(document: Mapping[str, Any]) -> Table:
    """Held-out errors by joint, one a line: seven joints side by side do not fit a narrow terminal."""
    common = torque_statements.common_unit(document)
    table = listing(f"held-out error ({f'{common} RMS'.strip()})", "before", "after")
    for joints, unit, _, *sizes in torque_statements.errors(document, [("rms", "RMS")]):
        table.add_row(joints if common else f"{joints} ({unit})", *(f"{size:.3g}" for size in sizes))
    return table
