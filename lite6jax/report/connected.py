"""What a terminal shows of a connected arm: its calibration, its verification, its recording."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from lite6jax.arms import entries, frames
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.start import calibration_poses, check_positions
from lite6jax.controller.recorder import LiveRecording
from lite6jax.controller.rows import Rows
from lite6jax.controller.sdk import FLOOR_M, GATE_M, GATE_RAD, Verification
from lite6jax.controller.station import CalibrationRead
from lite6jax.report import screen
from lite6jax.report.texts import fill, read_texts
from lite6jax.report.words import SCREEN, STATISTICS, fixed, listing, number

Array = NDArray[np.floating]

_TEXTS = read_texts("screens.yaml")


def calibration_report(read: CalibrationRead) -> Iterator[RenderableType]:
    """The calibration, and its distance from nominal."""
    calibration = read.calibration
    arm = calibration.arm
    yield Text(f"{calibration.source}: factory calibration of {arm.dof} joints, of a {arm.name}.")
    if read.error:
        yield from screen.notes(["the controller reports an error or a warning, which does not affect the calibration"])
    q = check_positions(arm)
    nominal = frames.chain(arm.links, q, arm.sliding) @ arm.T_joint_flange
    distance = 1e3 * np.linalg.norm((calibration_poses(calibration, q) - nominal)[:, :3, 3], axis=1)
    yield Text(
        f"Its flange is {number(float(distance.mean()), 3)} mm from the nominal one on average and"
        f" {number(float(distance.max()), 3)} mm at most ({len(q)} joint positions)."
    )
    yield ""
    yield Text("Six parameters (mm, deg); below each number its difference from nominal")
    console = screen.console()
    unbounded = console.options.update(max_width=1000)
    tables = [_six_parameters(calibration, digits) for digits in (4, 3, 2)]
    fits = (table for table in tables if console.measure(table, options=unbounded).maximum <= console.width)
    yield next(fits, tables[-1])


def _six_parameters(calibration: FactoryCalibration, digits: int) -> Table:
    table = listing("joint", *entries.SIX)
    scale = np.array([1e3, 1e3, 1e3, *[180 / np.pi] * 3])
    for i, (row, nominal) in enumerate(zip(calibration.kinematics, calibration.arm.kinematics, strict=True)):
        turned = row - nominal
        turned[3:] = (turned[3:] + np.pi) % (2 * np.pi) - np.pi  # -180° and 180° are one angle
        pairs = zip(scale * row, scale * turned, strict=True)
        cells = (f"{fixed(value, digits)}\n{fixed(change, digits, '+')}" for value, change in pairs)
        table.add_row(f"J{i + 1}", *cells)
    return table


def verification_report(verification: Verification, where: str) -> Iterator[RenderableType]:
    """The difference between the controller's forward kinematics and the calibration's, its cause and the remedy."""
    texts, condition = _TEXTS["verification"], verification.condition
    facts = {"v": verification, "gate_m": GATE_M, "gate_rad": GATE_RAD, "floor_m": FLOOR_M, "offset": _offset}
    yield Text(fill(texts["head"], facts))
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
    yield Text(fill(texts["tool"], facts))
    if condition.has_world:
        offset = _offset(condition.world_offset)
        yield from screen.notes([f"a base offset is set, {offset}; its effect is not included"])
    if condition.warning:
        yield from screen.notes([f"the controller has warning {condition.warning}, which is not cleared"])
    yield Text(fill(texts["verdict"], facts))
    if verification.passed:
        return
    yield Text(fill(texts["cause"], facts))
    if verification.hidden_tool is None and verification.other_chain is None:
        for command in (
            "lite6jax design lite6 --poses 200 --out poses.csv",
            f"lite6jax record --ip {where} --poses poses.csv --out fk.csv",
            "lite6jax diagnose fk.csv --out diagnosis.json",
            "lite6jax fit fk.csv --geometry free",
        ):
            yield Text(f"  {command}", no_wrap=True, overflow="ignore")


def _offset(offset: Array) -> str:
    x, y, z = (fixed(float(v), 3) for v in offset[:3])
    roll, pitch, yaw = (fixed(float(np.degrees(v)), 3) for v in offset[3:])
    return f"x {x} y {y} z {z} mm, roll {roll} pitch {pitch} yaw {yaw} deg"


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
    computed = recorded.settings.joint_source == "commanded"
    if not recorded.rows:
        yield Text("Nothing was recorded, and nothing is written.")
    elif not computed:
        runs = f" in {recorded.runs} runs" if recorded.runs > 1 else ""
        yield Text(
            f"Recorded {recorded.rows} rows{runs}: {recorded.duration:.3f} s at {recorded.rate:.2f} Hz by the"
            " controller's clock."
        )
        if recorded.short:
            yield Text(f"{recorded.asked} rows were asked for.")
        repeated = f", {recorded.repeated} duplicates removed" if recorded.repeated else ", no duplicates"
        within, between = recorded.missing_within, recorded.missing_between
        missing = f"{within} reports missing" if within else "No report missing"
        if recorded.runs > 1:
            missing = f"{within} reports missing within runs, about {between} between runs"
            missing = missing if within + between else "No report missing within or between runs"
        where = " The columns missing and gap say where and why." if recorded.gaps else ""
        yield Text(f"{missing}{repeated}.{where}")
    else:
        yield Text(f"Recorded the controller's forward kinematics at {recorded.rows} joint positions; nothing moved.")
    if computed and recorded.missing:
        yield Text(f"{recorded.missing} joint positions were not requested.")
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
