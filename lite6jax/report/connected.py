"""What a terminal shows of connected arms: what was read, verified and recorded, in mm and degrees, for 60 columns."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from rich.console import RenderableType
from rich.table import Table

from lite6jax.arms import frames
from lite6jax.arms.entries import SIX
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.start import calibration_poses, check_positions
from lite6jax.controller.recorder import LiveRecording
from lite6jax.controller.rows import Rows
from lite6jax.controller.sdk import KinematicsCheck
from lite6jax.controller.station import CalibrationRead
from lite6jax.formatting import SCREEN, STATISTICS, fixed, number
from lite6jax.report import screen
from lite6jax.report.sentences import connected as sentences
from lite6jax.report.words import listing

_COMMANDS = (
    "lite6jax design lite6 --poses 200 --out poses.csv",
    "lite6jax record --ip {} --poses poses.csv --out fk.csv",
    "lite6jax diagnose fk.csv --out diagnosis.json",
    "lite6jax fit fk.csv --geometry free",
)
"""Which find out why a controller computes otherwise; the address goes into them."""


def calibration_report(read: CalibrationRead) -> Iterator[RenderableType]:
    """The calibration, and its distance from nominal."""
    calibration = read.calibration
    arm = read.calibration.arm
    q = check_positions(arm)
    nominal = frames.chain(arm.links, q, arm.sliding) @ arm.T_joint_flange
    distance = np.linalg.norm((calibration_poses(calibration, q) - nominal)[:, :3, 3], axis=1)
    yield from sentences.calibration_remarks(calibration.source, arm.dof, arm.name, read.error, distance)
    yield from ("", "Six parameters (mm, deg); below each number its difference from nominal")
    console = screen.console()
    unbounded = console.options.update(max_width=1000)
    tables = [_six_parameters(calibration, digits) for digits in (4, 3, 2)]
    fits = (table for table in tables if console.measure(table, options=unbounded).maximum <= console.width)
    yield next(fits, tables[-1])


def _six_parameters(calibration: FactoryCalibration, digits: int) -> Table:
    table = listing("joint", *SIX)
    scale = np.array([1e3, 1e3, 1e3, *[180 / np.pi] * 3])
    for i, (row, nominal) in enumerate(zip(calibration.kinematics, calibration.arm.kinematics, strict=True)):
        turned = row - nominal
        turned[3:] = (turned[3:] + np.pi) % (2 * np.pi) - np.pi  # -180° and 180° are one angle
        pairs = zip(scale * row, scale * turned, strict=True)
        cells = (f"{fixed(value, digits)}\n{fixed(change, digits, '+')}" for value, change in pairs)
        table.add_row(f"J{i + 1}", *cells)
    return table


def verification_report(verification: KinematicsCheck, where: str) -> Iterator[RenderableType]:
    """The difference between the controller's forward kinematics and the calibration's, its cause and the remedy."""
    yield (
        f"Forward kinematics of the controller (xarm-python-sdk, {verification.version}) minus those of the "
        f"calibration at {len(verification.position)} random joint positions"
    )
    table = listing("", "", *(name for name, _ in STATISTICS), left=[1], wrapped=[0])
    for name, position, orientation in (
        ("joints as sent (32 bits)", verification.position, verification.orientation),
        ("joints as requested", verification.position_unrounded, verification.orientation_unrounded),
    ):
        for values, (scale, unit) in zip((position, orientation), SCREEN.values(), strict=True):
            digits = 6 if scale * values.max() < 1 else 4
            cells = (number(scale * float(statistic(values)), digits) for _, statistic in STATISTICS)
            table.add_row(name if unit == "mm" else "", unit, *cells)
    yield table
    yield sentences.tool_verified(verification)
    yield from screen.notes(sentences.verification_notes(verification))
    yield sentences.verification_verdict(verification)
    if not verification.passed:
        yield sentences.cause_of_difference(verification)
        if verification.hidden_tool is None and verification.other_chain is None:
            yield from (screen.unbroken(f"  {command}".format(where)) for command in _COMMANDS)


@contextmanager
def recording_progress() -> Iterator[Callable[[Rows, str], None]]:
    """The progress of a recording on stderr, from what the yielded function is called with."""
    reached = ["no row yet"]

    def show(rows: Rows, trouble: str) -> None:
        line = f"{rows.time:8.1f} s  {rows.count} rows  {rows.rate:.1f} Hz"
        line += f"  run {rows.run}" if rows.run else ""
        line += f"  {rows.missing} missing" if rows.missing else ""
        reached[0] = f"{line}  {trouble or '(stop with Ctrl-C)'}"

    with screen.repeated(lambda: reached[0]):
        yield show


def recorded_report(recorded: LiveRecording) -> Iterator[RenderableType]:
    """The rows, gaps, sources of the columns and notes of a recording."""
    yield from sentences.recorded_rows(recorded)
    if recorded.rows:
        yield _sources(recorded)
    yield from screen.notes(recorded.notes)


def _sources(recorded: LiveRecording) -> Table:
    """The sources of the columns, with neighbouring columns of the same source in one row."""
    grouped: list[tuple[list[str], str]] = []
    for name, source in recorded.sources.items():
        if grouped and grouped[-1][1] == source and _kind(grouped[-1][0][0]) == _kind(name):
            grouped[-1][0].append(name)
        else:
            grouped.append(([name], source))
    rows = ((names[0] if len(names) == 1 else f"{names[0]} … {names[-1]}", source) for names, source in grouped)
    return listing("columns", "source", rows=rows, left=[1], wrapped=[1])


def _kind(name: str) -> str:
    return (
        "pose" if name in ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz") else name.rstrip("0123456789_radNmCsegp/")[:2]
    )
