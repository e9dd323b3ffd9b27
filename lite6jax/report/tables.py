"""What a person in a lab reads on the screen: sentences and tables in mm and degrees, 60 columns and up."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from lite6jax.arms import frames
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.arms.forms import Conversion
from lite6jax.estimation.robust import DOWNWEIGHTED
from lite6jax.fitting.compare import Comparison
from lite6jax.fitting.folder import Row, failed
from lite6jax.fitting.solution import Errors, Held, Noise, Result, Solution
from lite6jax.recordings import Recording
from lite6jax.report.cells import SCREEN, SHOWS_AS_ZERO, fixed, listed, listing, number, plus_minus
from lite6jax.report.data_faults import fault_statement

Array = NDArray[np.floating]

STATISTICS = (
    ("mean", np.mean),
    ("median", np.median),
    ("p95", lambda values: np.percentile(values, 95)),
    ("max", np.max),
)
_MOST_ARMS = 12
_ROWS_NAMED = 5
_SIX = ("x", "y", "z", "roll", "pitch", "yaw")


def calibration_read(calibration: FactoryCalibration) -> Iterator[RenderableType]:
    """What was read."""
    arm = calibration.arm
    yield Text(f"{calibration.source}", no_wrap=True, overflow="ignore")
    yield Text(f"Factory calibration of {arm.dof} joints, of a {arm.name}.")


def recording_read(recording: Recording, solution: Solution) -> Iterator[RenderableType]:
    """What was read, and what its sidecar lets the fit move."""
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


def solution_report(solution: Solution, recording: Recording | None = None) -> Iterator[RenderableType]:
    """A fit from its result to its notes."""
    yield ""
    yield Text(_sentence(solution, recording is not None))
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
        yield from _held_in_words(solution.held)
        yield from _noise_in_words(solution.noise, solution.checked)
        yield from _weights_in_words(solution.weight, recording)
        notes = solution.notes
        yield from (Text(f"Note: {note[0].upper()}{note[1:]}{'' if note.endswith('.') else '.'}") for note in notes)


def _sentence(solution: Solution, recorded: bool) -> str:
    steps = f"{solution.steps} step{'s' * (solution.steps != 1)}"
    if solution.result != Result.CONVERGED:
        return f"The fit {solution.result.message} ({steps}); the numbers below are where it stopped."
    before, after = (1e3 * e.position_rms for e in (solution.nominal_errors, solution.checked))
    if recorded:
        return (
            f"Converged in {steps}: {number(after, 3)} mm RMS on rows it had not seen, {number(before, 3)} mm before."
        )
    worst = 1e3 * float(solution.checked.position.max())
    most = 1e3 * float(solution.nominal_errors.position.max())
    return (
        f"Converged in {steps}: the table below is the calibrated arm to {number(worst)} mm; the nominal one is up to"
        f" {number(most, 3)} mm off."
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


def hayati_tables(solution: Solution) -> Iterator[RenderableType]:
    """Base, and a row a joint; below each number its standard deviation, or its difference from nominal."""
    form = solution.form.chain
    assert isinstance(form, HayatiForm)
    measured = solution.standard_deviation is not None
    below = solution.standard_deviation if measured else solution.parameters - solution.arm.hayati
    assert below is not None
    free = solution.free[: form.size]
    at = {name: i for i, name in enumerate(form.names)}

    def cell(name: str, otherwise: str = "") -> str:
        if name not in at:
            return otherwise
        i = at[name]
        scale, _ = SCREEN[form.units[i]]
        value = fixed(scale * solution.parameters[i])
        if measured:
            return f"{value}\n{f'±{plus_minus(scale * below[i])}' if free[i] else 'held'}"
        return f"{value}\n{fixed(scale * below[i], sign='+')}"

    under = "its standard deviation" if measured else "its difference from nominal"
    yield Text(f"Effective model (mm, deg); below each number {under}")
    yield ""
    base = listing("base", "x", "y", "roll", "pitch")
    base.add_row("", *(cell(f"base_{name}") for name in ("x", "y", "roll", "pitch")))
    yield base
    yield ""
    table = listing("joint", "theta_off", "d", "a", "alpha", *(["beta"] if form.parallel else []))
    for i in range(form.dof):
        names = [f"{name}{i + 1}" for name in ("theta_off", "d", "a", "alpha")]
        cells = [cell(name, "0\nfixed") for name in names]
        table.add_row(f"J{i + 1}", *cells, *([cell(f"beta{i + 1}")] if form.parallel else []))
    yield table
    if form.parallel:
        pairs = " and ".join(f"{i + 1}-{i + 2}" for i in form.parallel)
        yield Text(
            f"Joints {pairs} are nominally parallel: d is fixed at zero, beta (Hayati) is a turn about y after alpha."
        )
    yield ""


def six_parameter_table(solution: Solution) -> Table:
    """The chain of a factory file as it was fitted, with standard deviations."""
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
    """Where the arm's base stands in the sensor's frame, and the tool on the flange."""
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


def _held_in_words(held: Sequence[Held]) -> Iterator[Text]:
    groups: dict[tuple[str, ...], list[str]] = {}
    for each in held:
        groups.setdefault(each.carried_by, []).append(each.name)
    if groups:
        yield Text("Held at their start, because these data cannot tell them from other numbers:")
    for carried_by, names in groups.items():
        what = f"carried by {', '.join(carried_by)}" if carried_by else "nothing here depends on them"
        yield Text(f"  {', '.join(names)}: {what}")


def _noise_in_words(noise: Noise | None, checked: Errors) -> Iterator[Text]:
    if noise is None:
        return
    found = f"{number(1e3 * noise.position)} mm"
    if noise.orientation is not None:
        found += f", {number(np.rad2deg(noise.orientation))}°"
    if noise.declared is None:
        yield Text(f"Noise per axis: not declared for all that is measured; the residuals have {found}.")
        return
    said = f"{number(1e3 * noise.declared[0])} mm"
    if noise.declared[1] is not None:
        said += f", {number(np.rad2deg(noise.declared[1]))}°"
    ratio = noise.position / noise.declared[0]
    verdict = "as declared" if ratio < 1.5 else f"{ratio:.0f} times it: the rest is what this geometry cannot explain"
    yield Text(f"Noise per axis: declared {said}; the residuals have {found}, {verdict}.")


def _fault_lines(solution: Solution) -> Iterator[Text]:
    for fault in solution.faults:
        rows = f" Rows {listed(fault.rows)}." if fault.rows else ""
        yield Text(f"Data fault: {fault_statement(fault)}{rows}")


def _weights_in_words(weight: Array, recording: Recording) -> Iterator[Text]:
    low = np.flatnonzero(weight < DOWNWEIGHTED)
    if not low.size:
        yield Text(f"No sample stands out: all {len(weight)} keep their weight.")
        return
    rows = recording.row[low[np.argsort(weight[low])]]
    named = ", ".join(str(row) for row in rows[:_ROWS_NAMED])
    more = ", …" if len(rows) > _ROWS_NAMED else ""
    yield Text(
        f"{len(rows)} of {len(weight)} samples stand out and weigh less than {DOWNWEIGHTED:g}: rows {named}{more}."
    )


def comparison_report(comparison: Comparison, width: int) -> Iterator[RenderableType]:
    """Arms of one type side by side."""
    names, form = comparison.names, comparison.arm.form
    arms = len(names)
    yield Text(
        f"{arms} arms of the type {comparison.arm.name}; flange over {comparison.from_nominal.shape[1]} samples."
    )
    yield ""
    yield Text("Distance from nominal (mm)")
    table = listing("arm", "mean", "median", "p95", "max", "file")
    table.columns[-1].justify, table.columns[-1].no_wrap, table.columns[-1].overflow = "left", False, "fold"
    for k in range(arms):
        cells = (f"{1e3 * float(statistic(comparison.from_nominal[k])):.3f}" for _, statistic in STATISTICS)
        table.add_row(str(k + 1), *cells, Text(names[k]))
    yield table
    yield ""
    shown = list(range(arms)) if arms <= _MOST_ARMS else []
    fitting = max(1, (width - 32) // 9)
    blocks = [shown[i : i + fitting] for i in range(0, len(shown), fitting)] or [[]]
    for block in blocks:
        which = f", arms {block[0] + 1}–{block[-1] + 1}" if len(blocks) > 1 else ""
        yield Text(f"Hayati parameters minus nominal{which}")
        yield _differences_table(comparison, block)
        yield ""
    scale = np.array([SCREEN[unit][0] for unit in form.units])
    same = [name for name, most in zip(form.names, scale * comparison.largest, strict=True) if most < SHOWS_AS_ZERO]
    if same:
        yield Text(f"As nominal in every arm: {', '.join(same)}.")
    lengths = np.array([unit == "m" for unit in form.units])
    spread = scale * comparison.spread
    yield Text(
        f"Tolerance made visible: standard deviation {np.sqrt(np.mean(spread[lengths] ** 2)):.3f} mm and"
        f" {np.sqrt(np.mean(spread[~lengths] ** 2)):.4f}° per parameter (RMS)."
    )
    yield from _pairs(comparison)


def _differences_table(comparison: Comparison, arms: Sequence[int]) -> Table:
    form = comparison.arm.form
    table = listing("", "", *(str(k + 1) for k in arms), "std", "largest")
    for i, (name, unit) in enumerate(zip(form.names, form.units, strict=True)):
        scale, shown = SCREEN[unit]
        if scale * comparison.largest[i] < SHOWS_AS_ZERO:
            continue
        own = (fixed(scale * comparison.difference[k, i], sign="+") for k in arms)
        table.add_row(name, shown, *own, f"{scale * comparison.spread[i]:.4f}", f"{scale * comparison.largest[i]:.4f}")
    return table


def _pairs(comparison: Comparison) -> Iterator[RenderableType]:
    arms = len(comparison.names)
    if arms <= 8:
        table = listing("arm", *(str(k + 1) for k in range(arms)))
        for i in range(arms):
            table.add_row(
                str(i + 1), *("–" if i == j else f"{1e3 * comparison.between[i, j]:.2f}" for j in range(arms))
            )
        yield ""
        yield Text("Largest distance between two arms' flanges (mm)")
        yield table
        return
    pairs = np.triu_indices(arms, 1)
    distance = comparison.between[pairs]
    near, far = int(np.argmin(distance)), int(np.argmax(distance))
    yield Text(
        f"Between two arms: {1e3 * distance[near]:.3f} mm at most for the nearest pair"
        f" ({pairs[0][near] + 1} and {pairs[1][near] + 1}), {1e3 * distance[far]:.3f} mm for the furthest"
        f" ({pairs[0][far] + 1} and {pairs[1][far] + 1})."
    )


def folder_report(rows: Sequence[Row]) -> Iterator[RenderableType]:
    """Numbers by type of arm, and a line for each file that failed."""
    table = listing("arm", "files", "ok", "nominal", "worst", "check")
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.arm:
            groups.setdefault((row.kind, row.arm), []).append(row)
    for (kind, arm), group in sorted(groups.items()):
        nominal = [1e3 * float(row.nominal.position.max()) for row in group if row.nominal]
        checked = [1e3 * float(row.checked.position.max()) for row in group if row.checked]
        good = sum(row.result == Result.CONVERGED for row in group)
        name = arm if kind == "calibration" else f"{arm} (recorded)"
        table.add_row(
            name, str(len(group)), str(good), f"{np.median(nominal):.3f}", f"{max(nominal):.3f}", number(max(checked))
        )
    if groups:
        yield Text("By type of arm; position errors in mm")
        yield table
        yield Text(
            "nominal, worst: median and largest, over the arms, of the maximum error before the fit;"
            " check: largest after it."
        )
    bad = failed(rows)
    if bad:
        yield ""
        yield Text(f"{len(bad)} of {len(rows)} files have no fit to use:")
        for row in bad:
            yield Padding(
                Text(f"{row.message if row.file in row.message else f'{row.file}: {row.message}'}"), (0, 0, 0, 2)
            )


def conversion_report(done: Conversion) -> Iterator[RenderableType]:
    """What a conversion kept and what it left out."""
    kept = f"{1e3 * done.difference:.1e}" if done.difference else "0"
    yield Text(f"Form {done.form}, arm {done.arm.name}; read back, the flange differs by at most {kept} mm.")
    if done.left_out:
        yield Text(f"Left out: {'; '.join(done.left_out)}.")
