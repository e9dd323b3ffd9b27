"""The screen report of a diagnosis, of poses or of torques: verdict, errors before and after, findings, remedies."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from lite6jax.arms import frames
from lite6jax.domains.pose.registration import Registration
from lite6jax.report import statements, torque_statements, worth
from lite6jax.report.cells import SCREEN, fixed, joint_units, listing, number, significant
from lite6jax.report.next_steps import Files
from lite6jax.report.sections import against, chart, fault_line, finding_list, headed, ruled_out, what_to_do

ERRORS = ("heldout_position_rms_m", "heldout_position_p95_m", "heldout_position_max_m")
"""The keys of errors in the JSON file: root mean square, 95th percentile and largest."""


def diagnosis_report(
    document: Mapping[str, Any], source: str, files: Files | None = None, details: bool = False
) -> Iterator[RenderableType]:
    """The screen report.

    Args:
        document: as in the JSON file, with statements.
        source: the recording.
        files: for commands to copy; without them there are none.
        details: whether to list also what was ruled out and what was not tested.
    """
    torques = worth.of_torques(document)
    named = torque_statements if torques else statements
    findings = named.findings_of(document)
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(named.setting_statement(document))
    yield ""
    yield from against(named.compared(document))
    yield Text(worth.headline(document))
    yield ""
    yield Text(named.verdict_statement(document))
    yield from map(Text, named.cautions(document))
    yield from chart(document, findings)
    yield ""
    if torques:
        yield _torque_errors(document)
        yield Text(statements.held_out_statement(document, f"{document['kept_samples']} filtered samples"))
        yield Text(torque_statements.filter_statement(document))
        yield Text(torque_statements.inertial_statement(document))
    else:
        yield _pose_errors(document)
        yield Text(statements.held_out_statement(document, f"{document['heldout_rows']} rows"))
        yield Text(noise_statement(document))
    yield from headed("Data faults:", map(fault_line, document["data_faults"]))
    yield from finding_list(findings, named.undistinguished)
    yield from what_to_do(document, files)
    if not torques:
        yield from headed("Assumptions:", statements.assumptions(document))
    yield from headed("What to record next:", named.what_to_record(document))
    for item in document.get("separating_poses", ()):
        yield ""
        scales, units = joint_units(statements.sliding(document), len(item["joint_position_rad"][0]))
        yield Text(f"{statements.separating_title(item, units)}:")
        yield _poses(item["joint_position_rad"], scales)
    if document.get("separating_poses"):
        yield Text(statements.NOT_CHECKED)
    yield from ruled_out(document, named.untested(document), details)
    yield ""


def _pose_errors(document: Mapping[str, Any]) -> Table:
    table = listing("held-out position error (mm)", "rms", "p95", "max")
    for name in ("before", "after"):
        table.add_row(name, *(number(1e3 * document[name][key]) for key in ERRORS))
    table.columns[0].no_wrap = False
    return table


def _torque_errors(document: Mapping[str, Any]) -> Table:
    """Held-out errors by joint, one a line: seven joints side by side do not fit a narrow terminal."""
    common = torque_statements.common_unit(document)
    table = listing(f"held-out error ({f'{common} RMS'.strip()})", "before", "after")
    for joints, unit, _, *sizes in torque_statements.errors(document, [("rms", "RMS")]):
        table.add_row(joints if common else f"{joints} ({unit})", *map(significant, sizes))
    return table


def noise_statement(document: Mapping[str, Any]) -> str:
    """The noise estimated from the residuals beside the declared one."""
    estimated, declared = (document["noise"][f"{name}_position_m"] for name in ("estimated", "declared"))
    beside = "none is declared" if declared is None else f"{number(1e3 * declared)} mm is declared"
    return f"Noise per axis of position: the residuals have {number(1e3 * estimated)} mm, {beside}."


def _poses(joint_position: list[list[float]], scales: np.ndarray) -> Table:
    table = listing("", *(f"q{joint}" for joint in range(1, len(joint_position[0]) + 1)))
    for k, row in enumerate(scales * np.array(joint_position), 1):
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
