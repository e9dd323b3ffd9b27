"""The screen report of a fit: sentences and tables in mm and degrees, for terminals of 60 columns or more."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from lite6jax.arms import frames
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.estimation.robust import DOWNWEIGHTED
from lite6jax.fitting.problem import TOLERANCE
from lite6jax.fitting.quality import ABOVE_NOISE, Result
from lite6jax.fitting.solution import Errors, Held, Noise, Solution
from lite6jax.recordings import Recording
from lite6jax.report import screen
from lite6jax.report.cells import SCREEN, STATISTICS, fixed, listed, listing, number, plus_minus
from lite6jax.report.data_faults import fault_statement
from lite6jax.report.statements import quality_statement

Array = NDArray[np.floating]
_MOST_ROWS = 5
_SIX = ("x", "y", "z", "roll", "pitch", "yaw")


def calibration_read(calibration: FactoryCalibration) -> Iterator[RenderableType]:
    """The calibration file and its arm."""
    arm = calibration.arm
    yield Text(f"{calibration.source}", no_wrap=True, overflow="ignore")
    yield Text(f"Factory calibration of {arm.dof} joints, of a {arm.name}.")


def recording_read(recording: Recording, solution: Solution) -> Iterator[RenderableType]:
    """The recording, and which parameters the fit estimates according to its sidecar."""
    settings = recording.settings
    kind = "positions and orientations" if recording.quaternion is not None else "positions"
    by = "" if settings.pose_source == "unknown" else f" by {settings.pose_source.replace('_', ' ')}"
    yield Text(recording.source, no_wrap=True, overflow="ignore")
    yield Text(
        f"Recording of {recording.samples} samples, {recording.dof} joints of a {solution.arm.name}: {kind}{by}."
    )
    chain = "nominal, fitted"
    if not isinstance(solution.form.chain, HayatiForm):
        moved = bool(solution.free[: solution.form.chain.size].any())
        chain = "the factory calibration, fitted within its uncertainty" if moved else "the factory calibration, held"
    frame = "unknown, fitted" if solution.form.frame else "the arm's base"
    tool = "unknown, fitted" if solution.form.tool else "none" if settings.tool == "none" else "as declared"
    yield Text(f"Geometry: {chain}. Sensor frame: {frame}. Tool: {tool}.")
    yield from screen.notes(_notes_of_data(solution))


def solution_report(solution: Solution, recording: Recording | None = None) -> Iterator[RenderableType]:
    """The report of a fit: result, errors, parameters with standard deviations, noise, outliers and notes."""
    yield ""
    yield Text(_result_line(solution, recording is not None))
    bad = quality_statement(solution.quality.to_dict())
    if bad is not None:
        yield Text(bad)
    yield ""
    chain = solution.form.chain
    checked = "held-out blocks" if recording is not None else f"{len(solution.checked.position)} fresh samples"
    start = "factory calibration" if recording and recording.settings.factory_calibration else "nominal arm"
    rows = [(start, solution.nominal_errors), (checked, solution.checked)]
    if recording is not None:
        rows.insert(1, ("fitted rows", solution.errors))
    yield Text(f"Error at the {'flange' if recording is None else 'measured point'}")
    yield errors_table(rows)
    yield ""
    if isinstance(chain, HayatiForm):
        yield from hayati_tables(solution)
    elif solution.free[: chain.size].any():
        yield Text("Six-parameter chain (mm, deg); below each number its standard deviation")
        yield six_parameter_table(solution)
        yield ""
    if recording is not None:
        yield from frame_tables(solution)
        yield from _fault_lines(solution)
        yield from _held_lines(solution.held)
        yield from _noise_line(solution.noise, solution.checked)
        yield from _outlier_line(solution, recording)
        yield from screen.notes(note for note in solution.notes if note not in _notes_of_data(solution))


def _notes_of_data(solution: Solution) -> tuple[str, ...]:
    """What was dropped or assumed as the recording was read: it stands above the results."""
    return () if solution.recording is None else solution.recording.notes


def _result_line(solution: Solution, recorded: bool) -> str:
    steps = f"{solution.steps} step{'s' * (solution.steps != 1)}"
    if solution.result != Result.CONVERGED:
        return f"The fit {solution.result.message} ({steps}); the values below are those of its last step."
    before, after = (1e3 * e.position_rms for e in (solution.nominal_errors, solution.checked))
    if recorded:
        return f"Converged in {steps}: {number(after, 3)} mm RMS on held-out rows, {number(before, 3)} mm before."
    worst = 1e3 * float(solution.checked.position.max())
    most = 1e3 * float(solution.nominal_errors.position.max())
    return (
        f"Converged in {steps}: the table below is the calibrated arm to {number(worst)} mm; the nominal one is up to"
        f" {number(most, 3)} mm off, at {len(solution.checked.position)} joint positions."
    )


def errors_table(rows: Sequence[tuple[str, Errors]]) -> Table:
    """Mean, median, 95th percentile and maximum of position (mm) and orientation (deg) errors."""
    table = listing("", "", *(name for name, _ in STATISTICS))
    table.columns[1].justify = "left"
    for name, errors in rows:
        for values, unit in ((errors.position, "m"), (errors.orientation, "rad")):
            if values is not None:
                scale, shown = SCREEN[unit]
                cells = (number(scale * float(statistic(values))) for _, statistic in STATISTICS)
                table.add_row(name if unit == "m" else "", shown, *cells)
    return table


def hayati_columns(form: HayatiForm) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The parameters that the base of a form has, and those that any of its links has, in the order of tables."""
    given = set(form.names)
    base = [name for name in ("x", "y", "z", "roll", "pitch", "yaw") if f"base_{name}" in given]
    rows = [
        name
        for name in ("theta_off", "d", "a", "b", "alpha", "beta")
        if any(f"{name}{i + 1}" in given for i in range(form.dof))
    ]
    return tuple(base), tuple(rows)


def joint_name(form: HayatiForm, joint: int) -> str:
    """`J1`, or `J1 P` of a prismatic joint counted from 0."""
    return f"J{joint + 1}" + (" P" if joint in form.sliding else "")


def hayati_tables(solution: Solution) -> Iterator[RenderableType]:
    """The base and one row per joint; below each value its standard deviation or its difference from nominal."""
    form = solution.form.chain
    assert isinstance(form, HayatiForm)
    measured = solution.standard_deviation is not None
    below = solution.standard_deviation if measured else solution.parameters - solution.arm.hayati
    assert below is not None
    free, determined = solution.free[: form.size], solution.determined[: form.size]
    at = {name: i for i, name in enumerate(form.names)}

    def cell(name: str, otherwise: str = "") -> str:
        if name not in at:
            return otherwise
        i = at[name]
        scale, _ = SCREEN[form.units[i]]
        value = fixed(scale * solution.parameters[i])
        if measured:
            deviation = f"±{plus_minus(scale * below[i])}" if free[i] else "held"
            return f"{value}\n{deviation if determined[i] or not free[i] else f'({deviation})'}"
        return f"{value}\n{fixed(scale * below[i], sign='+')}"

    under = "its standard deviation" if measured else "its difference from nominal"
    yield Text(f"Effective model (mm, deg); below each number {under}")
    yield ""
    in_base, in_rows = hayati_columns(form)
    base = listing("base", *in_base)
    base.add_row("", *(cell(f"base_{name}") for name in in_base))
    yield base
    yield ""
    table = listing("joint", *in_rows)
    for i in range(form.dof):
        empty = ["" if name in ("b", "beta") else "0\nfixed" for name in in_rows]
        cells = [cell(f"{name}{i + 1}", otherwise) for name, otherwise in zip(in_rows, empty, strict=True)]
        table.add_row(joint_name(form, i), *cells)
    yield table
    if (free & ~determined).any():
        length, angle = (f"{SCREEN[unit][0] * TOLERANCE[unit]:.2g}" for unit in ("m", "rad"))
        yield Text(
            "In brackets: these data do not determine the number. Its prior does, which is the nominal one "
            f"± {length} mm or {angle} deg."
        )
    if form.sliding:
        yield Text(
            "P: a prismatic joint, whose axis is drawn through the origin of the frame before it; b is a shift along y "
            "after a."
        )
    if parallel := [i for i in form.parallel if i >= 0]:
        pairs = " and ".join(f"{i + 1}-{i + 2}" for i in parallel)
        yield Text(
            f"Joints {pairs} are nominally parallel: d is fixed at zero, beta (Hayati) is a turn about y after alpha."
        )
    yield ""


def six_parameter_table(solution: Solution) -> Table:
    """The fitted six-parameter chain with standard deviations."""
    chain = solution.form.chain
    deviation = solution.standard_deviation
    assert deviation is not None
    table = listing("joint", *_SIX)
    for i in range(chain.dof):
        cells = []
        for k in range(6 * i, 6 * i + 6):
            scale, _ = SCREEN[chain.units[k]]
            cells.append(f"{fixed(scale * solution.parameters[k], 3)}\n±{plus_minus(scale * deviation[k])}")
        table.add_row(f"J{i + 1}", *cells)
    return table


def frame_tables(solution: Solution) -> Iterator[RenderableType]:
    """The poses of the base in the sensor frame and of the tool on the flange, where they are estimated."""
    T_flange_tool = np.linalg.inv(solution.arm.T_joint_flange) @ np.asarray(solution.model.T_flange_tool)
    parts = []
    if solution.form.frame:
        parts.append(("Base in the sensor's frame", "frame", np.asarray(solution.model.T_sensor_base)))
    if solution.form.tool:
        parts.append(("Tool on the flange", "tool", T_flange_tool))
    if not parts:
        return
    deviation = solution.standard_deviation
    names = solution.form.names
    for title, prefix, T in parts:
        yield Text(f"{title} (mm, deg); below each number its standard deviation")
        table = listing(*_SIX)
        table.columns[0].justify = "right"
        row = frames.row_from_transform(T)
        shown = [fixed(v, 3) for v in (*(1e3 * row[:3]), *np.rad2deg(row[3:]))]
        below = []
        for k, axis in enumerate(("x", "y", "z", "rx", "ry", "rz")):
            i = names.index(f"{prefix}_{axis}")
            scale = SCREEN["m" if k < 3 else "rad"][0]
            below.append(
                "held" if not solution.free[i] or deviation is None else f"±{plus_minus(scale * deviation[i])}"
            )
        table.add_row(*(f"{value}\n{under}" for value, under in zip(shown, below, strict=True)))
        yield table
        yield ""


def _held_lines(held: Sequence[Held]) -> Iterator[Text]:
    groups: dict[tuple[str, ...], list[str]] = {}
    for each in held:
        groups.setdefault(each.carried_by, []).append(each.name)
    if groups:
        yield Text("Held at their start, because these data do not identify them:")
    for carried_by, names in groups.items():
        reason = f"confounded with {', '.join(carried_by)}" if carried_by else "no residual depends on them"
        yield Text(f"  {', '.join(names)}: {reason}")


def _noise_line(noise: Noise | None, checked: Errors) -> Iterator[Text]:
    if noise is None:
        return
    found = f"{number(1e3 * noise.position)} mm"
    if noise.orientation is not None:
        found += f", {number(np.rad2deg(noise.orientation))} deg"
    ratio = noise.over_declared
    if noise.declared is None or ratio is None:
        yield Text(f"Noise per axis: not declared; the residuals have {found}.")
        return
    parts = zip(noise.declared, ("m", "rad"), strict=True)
    told = ((value, *SCREEN[unit]) for value, unit in parts if value is not None)
    declared = ", ".join(f"{number(scale * value)} {unit}" for value, scale, unit in told)
    verdict = "as declared" if ratio < ABOVE_NOISE else f"{ratio:.0f} times it: this geometry does not explain the rest"
    yield Text(f"Noise per axis: declared {declared}; the residuals have {found}, {verdict}.")


def _fault_lines(solution: Solution) -> Iterator[Text]:
    for fault in solution.faults:
        rows = f" Rows {listed(fault.rows)}." if fault.rows else ""
        yield Text(f"Data fault: {fault_statement(fault)}{rows}")


def _outlier_line(solution: Solution, recording: Recording) -> Iterator[Text]:
    weight, low = solution.weight, np.flatnonzero(solution.outlying)
    if not low.size:
        yield Text(f"No outliers among {len(weight)} samples.")
        return
    rows = recording.row[low[np.argsort(weight[low])]]
    named = ", ".join(str(row) for row in rows[:_MOST_ROWS])
    more = ", …" if len(rows) > _MOST_ROWS else ""
    yield Text(
        f"{len(rows)} of {len(weight)} samples are outliers with weights below {DOWNWEIGHTED:g}: rows {named}{more}."
    )
