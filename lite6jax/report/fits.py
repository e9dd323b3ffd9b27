"""What a terminal shows of fits and comparisons: in mm and degrees, for 60 columns."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from lite6jax.arms import frames
from lite6jax.arms.chains import HayatiForm, SixParameterForm
from lite6jax.arms.entries import SIX
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.problem import TOLERANCE
from lite6jax.calibration.solution import Solution
from lite6jax.formatting import SCREEN, SHOWS_AS_ZERO, STATISTICS, fixed, number, plus_minus, row_ranges
from lite6jax.model import TWIST_NAMES
from lite6jax.recordings import Recording
from lite6jax.report import screen
from lite6jax.report.faults import fault_statement, is_granted, ruled_out_statements
from lite6jax.report.sentences import fits as sentences
from lite6jax.report.sentences.faults import quality_statement
from lite6jax.report.words import fill, listing, read_texts

if TYPE_CHECKING:
    from lite6jax.calibration.fleet import Comparison  # a fit compares no arms

_TEXTS = read_texts("screens.yaml")
_MOST_PAIRS = 8
"""Arms of which each pair is listed."""


def calibration_read(calibration: FactoryCalibration) -> Iterator[RenderableType]:
    """The calibration file and its arm."""
    yield screen.unbroken(calibration.source)
    yield f"Factory calibration of {calibration.arm.dof} joints, of a {calibration.arm.name}."


def what_is_measured(recording: Recording) -> str:
    """In words: positions, poses or touches."""
    if recording.touches is not None:
        return _TEXTS["kinds"][recording.touches.kind]
    return _TEXTS["kinds"]["board" if recording.readings is not None else recording.numbers_per_sample]


def recording_read(recording: Recording, solution: Solution) -> Iterator[RenderableType]:
    """The recording, and which parameters the fit estimates according to its sidecar."""
    yield screen.unbroken(recording.source)
    yield sentences.recording_read(recording, solution.arm.name, what_is_measured(recording))
    yield sentences.geometry_of_fit(recording, solution)
    yield from screen.notes(_notes_of_data(solution))


def solution_report(solution: Solution, recording: Recording | None = None) -> Iterator[RenderableType]:
    """The report of a fit: result, errors, parameters with standard deviations, noise, outliers and notes."""
    chain = solution.form.chain
    yield from ("", sentences.fitted(solution, recorded=recording is not None))
    yield from filter(None, [quality_statement(solution.quality.to_dict())])
    yield ""
    checked = "held-out blocks"
    if recording is None:
        checked = f"{len(solution.checked.position)} fresh samples"
    start = "nominal arm"
    if recording and recording.settings.factory_calibration:
        start = "factory calibration"
    rows = [(start, solution.nominal_errors), (checked, solution.checked)]
    if recording is not None:
        rows.insert(1, ("fitted rows", solution.errors))
    yield f"Error at the {'flange' if recording is None else 'measured point'}"
    cells = []
    for name, errors in rows:
        for values, (scale, shown) in zip((errors.position, errors.orientation), SCREEN.values(), strict=True):
            if values is not None:
                numbers = (number(scale * float(statistic(values))) for _, statistic in STATISTICS)
                cells.append((name if values is errors.position else "", shown, *numbers))
    yield listing("", "", *(name for name, _ in STATISTICS), rows=cells, left=[1])
    yield ""
    if isinstance(chain, HayatiForm):
        yield from _hayati_tables(solution, chain)
    elif solution.free[: chain.size].any():
        std = solution.standard_deviation
        assert std is not None
        parameters = zip(chain.names, chain.units, solution.parameters, std, strict=False)
        texts = {name: _cell(SCREEN[unit][0], value, sigma) for name, unit, value, sigma in parameters}
        yield "Six-parameter chain (mm, deg); below each number its standard deviation"
        yield from parameter_tables(chain, lambda name, _: texts[name])
        yield ""
    if recording is not None:
        yield from _frame_tables(solution)
        yield from _place_tables(solution, recording)
        yield from _remarks(solution, recording)
        yield from screen.notes(note for note in solution.notes if note not in _notes_of_data(solution))


def _notes_of_data(solution: Solution) -> tuple[str, ...]:
    """What was dropped or assumed as the recording was read: it stands above the results."""
    return () if solution.recording is None else solution.recording.notes


def _cell(scale: float, value: float, std: float | None, otherwise: str = "held", digits: int = 3) -> str:
    """A number, and below it its standard deviation, or what it has in place of one."""
    return f"{fixed(scale * value, digits)}\n{otherwise if std is None else f'±{plus_minus(scale * std)}'}"


def parameter_tables(chain: HayatiForm | SixParameterForm, cell: Callable[[str, str], str]) -> Iterator[RenderableType]:
    """The parameters of a six-parameter chain, or of a Hayati form its base, then a row for each joint.

    `cell` gives the text of a parameter by its name and its column's; the form may have none of the name.
    """
    if isinstance(chain, HayatiForm):
        chain_names = set(chain.names)
        base = [name for name in SIX if f"base_{name}" in chain_names]
        yield listing("base", *base, rows=[("", *(cell(f"base_{name}", name) for name in base))])
        yield ""
        joints = range(1, chain.dof + 1)
        all_columns = ("theta_off", "d", "a", "b", "alpha", "beta")
        columns = [name for name in all_columns if any(f"{name}{joint}" in chain_names for joint in joints)]
        names = [[f"{name}{joint}" for name in columns] for joint in joints]
    else:
        columns = list(SIX)
        names = [[f"joint{i + 1}_{name}" for name in columns] for i in range(chain.dof)]
    slides = chain.sliding if isinstance(chain, HayatiForm) else ()
    rows = ((f"J{i + 1}{' P' * (i in slides)}", *map(cell, row, columns)) for i, row in enumerate(names))
    yield listing("joint", *columns, rows=rows)


def _hayati_tables(solution: Solution, form: HayatiForm) -> Iterator[RenderableType]:
    """The base and one row per joint; below each value its standard deviation or its difference from nominal."""
    measured = solution.standard_deviation is not None
    below = solution.standard_deviation if measured else solution.parameters - solution.arm.hayati
    assert below is not None
    free = solution.free[: form.size]
    determined = solution.determined[: form.size]
    at = {name: i for i, name in enumerate(form.names)}

    def cell(name: str, column: str) -> str:
        if name not in at:
            return "" if column in ("b", "beta") else "0\nfixed"
        i = at[name]
        scale, _ = SCREEN[form.units[i]]
        value = fixed(scale * solution.parameters[i])
        if not measured:
            return f"{value}\n{fixed(scale * below[i], sign='+')}"
        deviation = f"±{plus_minus(scale * below[i])}" if free[i] else "held"
        return f"{value}\n{deviation if determined[i] or not free[i] else f'({deviation})'}"

    under = "its difference from nominal"
    if measured:
        under = "its standard deviation"
    yield from (f"Effective model (mm, deg); below each number {under}", "")
    yield from parameter_tables(form, cell)
    prior = None
    if (free & ~determined).any():
        prior = [SCREEN[unit][0] * TOLERANCE[unit] for unit in SCREEN]
    yield from (*sentences.hayati_remarks(form, prior), "")


def _frame_tables(solution: Solution) -> Iterator[RenderableType]:
    """The poses of the base in the sensor frame and of the tool on the flange, where they are estimated."""
    parts = []
    if solution.form.frame:
        parts.append(("Base in the sensor's frame", "frame", np.asarray(solution.model.T_sensor_base)))
    if solution.form.tool:
        T_flange_tool = np.linalg.inv(solution.arm.T_joint_flange) @ np.asarray(solution.model.T_flange_tool)
        parts.append(("Tool on the flange", "tool", T_flange_tool))
    deviation = solution.standard_deviation
    names = solution.form.names
    for title, prefix, T in parts:
        yield f"{title} (mm, deg); below each number its standard deviation"
        table = listing(*SIX)
        cells = []
        table.columns[0].justify = "right"
        for k, (value, axis) in enumerate(zip(frames.row_from_transform(T), TWIST_NAMES, strict=True)):
            i = names.index(f"{prefix}_{axis}")
            scale, _ = SCREEN["m" if k < 3 else "rad"]
            cells.append(_cell(scale, value, None if deviation is None or not solution.free[i] else deviation[i]))
        table.add_row(*cells)
        yield from (table, "")


_PLACES = {
    "point_m": ("x", "y", "z"),
    "normal": ("nx", "ny", "nz"),
    "offset_m": ("offset",),
    "anchor_m": ("x", "y", "z"),
    "direction": ("nx", "ny", "nz"),
    "constant_m": ("constant",),
}
"""The columns of what is known of a place."""


def _place_tables(solution: Solution, recording: Recording) -> Iterator[RenderableType]:
    """What touches determine of points, planes, anchors or axes, and what they leave open."""
    if not solution.places:
        return
    keys = list(solution.places[0].values)
    yield "In the arm's base frame (mm; directions without unit); below each number its standard deviation"
    table = listing("", *(name for key in keys for name in _PLACES[key]))
    for place in solution.places:
        cells = []
        for key in keys:
            scale, digits = (1e3, 3) if key.endswith("_m") else (1.0, 5)
            for value, std in zip(place.values[key], place.std[key], strict=True):
                cells.append(_cell(scale, value, std if std > 0 else None, "given", digits))
        table.add_row(place.name, *cells)
    yield from (table, "", *sentences.undetermined_by_touches(solution.form, recording), "")


def _remarks(solution: Solution, recording: Recording) -> Iterator[str]:
    """Data faults, parameters that are held, the noise and outliers, a sentence each."""
    for fault in solution.faults:
        rows = f" Rows {row_ranges(fault.rows)}." if fault.rows else ""
        yield f"Data fault: {fault_statement(fault)}{rows}"
    yield from ruled_out_statements(fault for fault in solution.ruled_out if is_granted(fault))
    groups: dict[tuple[str, ...], list[str]] = {}
    for parameter in solution.held:
        groups.setdefault(parameter.carried_by, []).append(parameter.name)
    if groups:
        yield "Held at their start, because these data do not identify them:"
    for carried_by, names in groups.items():
        reason = "no residual depends on them"
        if carried_by:
            reason = f"confounded with {', '.join(carried_by)}"
        yield f"  {', '.join(names)}: {reason}"
    if (noise := solution.noise) is not None:
        declared_noise = []
        if noise.declared is not None:
            declared_noise = zip(noise.declared, SCREEN.values(), strict=True)
        declared = ", ".join(
            f"{number(scale * value)} {unit}" for value, (scale, unit) in declared_noise if value is not None
        )
        yield sentences.noise_of_residuals(noise, declared)
    low = np.flatnonzero(solution.outlying)
    rows = recording.row[low[np.argsort(solution.weight[low])]].tolist()
    yield sentences.outliers(rows, len(solution.weight))


# ------------------------------------------------------------------ comparisons


def comparison_report(comparison: "Comparison", width: int) -> Iterator[RenderableType]:
    """A comparison of arms of one model; the differences of each are listed where they fit beside each other."""
    names = comparison.names
    form = comparison.arm.form
    arms = len(names)
    yield from (fill(_TEXTS["comparison"]["arms"], {"c": comparison}), "", "Distance from nominal (mm)")
    table = listing("arm", *(name for name, _ in STATISTICS), "file", left=[5], wrapped=[5])
    for k in range(arms):
        cells = (f"{1e3 * float(statistic(comparison.from_nominal[k])):.3f}" for _, statistic in STATISTICS)
        table.add_row(str(k + 1), *cells, Text(names[k], overflow="fold"))
    yield from (table, "")
    shown = range(arms) if 32 + 9 * arms <= width else ()
    rows = []
    for i, (name, unit) in enumerate(zip(form.names, form.units, strict=True)):
        scale, shown_unit = SCREEN[unit]
        spread = scale * comparison.spread[i]
        largest = scale * comparison.largest[i]
        if largest >= SHOWS_AS_ZERO:
            differences = (fixed(scale * comparison.difference[k, i], sign="+") for k in shown)
            rows.append((name, shown_unit, *differences, f"{spread:.4f}", f"{largest:.4f}"))
    yield "Hayati parameters minus nominal"
    yield listing("", "", *(str(k + 1) for k in shown), "std", "largest", rows=rows)
    scale = np.array([SCREEN[unit][0] for unit in form.units])
    equal = [
        name for name, largest in zip(form.names, scale * comparison.largest, strict=True) if largest < SHOWS_AS_ZERO
    ]
    lengths = np.array([unit == "m" for unit in form.units])
    squares = (scale * comparison.spread) ** 2
    length, angle = (np.sqrt(np.mean(squares[chosen])) for chosen in (lengths, ~lengths))
    yield from ("", *sentences.spread_between_arms(equal, length, angle))
    if arms <= _MOST_PAIRS:
        between = [
            (str(i + 1), *("–" if i == j else f"{1e3 * d:.2f}" for j, d in enumerate(row)))
            for i, row in enumerate(comparison.between)
        ]
        yield from ("", "Largest distance between two arms' flanges (mm)")
        yield listing("arm", *(str(k + 1) for k in range(arms)), rows=between)
    else:
        pairs = np.triu_indices(arms, 1)
        distance = comparison.between[pairs]
        ends = {"near": int(np.argmin(distance)), "far": int(np.argmax(distance))}
        yield fill(_TEXTS["comparison"]["pairs"], {"distance": distance, "pairs": np.transpose(pairs) + 1, **ends})
