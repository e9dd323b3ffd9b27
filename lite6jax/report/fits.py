"""What a terminal shows of a fit and of a comparison of arms: in mm and degrees, for 60 columns."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from rich.console import RenderableType
from rich.text import Text

from lite6jax.arms import frames
from lite6jax.arms.chains import HayatiForm, SixParameterForm
from lite6jax.arms.entries import SIX
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.fleet import Comparison
from lite6jax.calibration.problem import TOLERANCE, TOUCHED_TOLERANCE
from lite6jax.calibration.quality import ABOVE_NOISE
from lite6jax.calibration.solution import Result, Solution
from lite6jax.estimation.robust import DOWNWEIGHTED
from lite6jax.model import TWIST_NAMES
from lite6jax.recordings import Recording
from lite6jax.report import screen
from lite6jax.report.faults import fault_statement
from lite6jax.report.statements import quality_statement
from lite6jax.report.texts import fill, read_texts
from lite6jax.report.words import SCREEN, SHOWS_AS_ZERO, STATISTICS, fixed, listing, number, plus_minus, row_ranges

Array = NDArray[np.floating]

_TEXTS = read_texts("screens.yaml")
_MOST_PAIRS = 8
"""Arms of which each pair is listed."""


def calibration_read(calibration: FactoryCalibration) -> Iterator[RenderableType]:
    """The calibration file and its arm."""
    arm = calibration.arm
    yield Text(f"{calibration.source}", no_wrap=True, overflow="ignore")
    yield Text(f"Factory calibration of {arm.dof} joints, of a {arm.name}.")


_READINGS = {
    "contact": "touches of points",
    "plane": "touches of planes",
    "distance": "distances",
    "axis": "heights along an axis",
}


def what_is_measured(recording: Recording) -> str:
    """In words: positions, poses or touches."""
    if recording.touches is not None:
        return _READINGS[recording.touches.kind]
    if recording.readings is not None:
        return "images of a board, as positions and orientations"
    return {0: "no poses", 3: "positions", 6: "positions and orientations"}[recording.numbers_per_sample]


def recording_read(recording: Recording, solution: Solution) -> Iterator[RenderableType]:
    """The recording, and which parameters the fit estimates according to its sidecar."""
    settings, chain = recording.settings, solution.form.chain
    yield Text(recording.source, no_wrap=True, overflow="ignore")
    facts = {
        "recording": recording,
        "arm": solution.arm.name,
        "kind": what_is_measured(recording),
        "by": settings.pose_source,
        "form": solution.form,
        "tool": settings.tool,
        "touched": TOUCHED_TOLERANCE
        if recording.touches is not None and settings.factory_calibration is None
        else None,
        "nominal": isinstance(chain, HayatiForm),
        "moved": bool(solution.free[: chain.size].any()),
    }
    yield Text(fill(_TEXTS["recording_read"], facts))
    yield Text(fill(_TEXTS["geometry"], facts))
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
    cells = []
    for name, errors in rows:
        for values, unit in ((errors.position, "m"), (errors.orientation, "rad")):
            if values is not None:
                scale, shown = SCREEN[unit]
                numbers = (number(scale * float(statistic(values))) for _, statistic in STATISTICS)
                cells.append((name if unit == "m" else "", shown, *numbers))
    yield listing("", "", *(name for name, _ in STATISTICS), rows=cells, left=[1])
    yield ""
    if isinstance(chain, HayatiForm):
        yield from _hayati_tables(solution, chain)
    elif solution.free[: chain.size].any():
        deviation = solution.standard_deviation
        assert deviation is not None
        shown = zip(chain.names, chain.units, solution.parameters, deviation, strict=False)
        texts = {
            name: f"{fixed(SCREEN[unit][0] * value, 3)}\n±{plus_minus(SCREEN[unit][0] * std)}"
            for name, unit, value, std in shown
        }
        yield Text("Six-parameter chain (mm, deg); below each number its standard deviation")
        yield from parameter_tables(chain, lambda name, _: texts[name])
        yield ""
    if recording is not None:
        yield from _frame_tables(solution)
        yield from _place_tables(solution)
        yield from map(Text, _remarks(solution, recording))
        yield from screen.notes(note for note in solution.notes if note not in _notes_of_data(solution))


def _notes_of_data(solution: Solution) -> tuple[str, ...]:
    """What was dropped or assumed as the recording was read: it stands above the results."""
    return () if solution.recording is None else solution.recording.notes


def _result_line(solution: Solution, recorded: bool) -> str:
    facts = {"converged": solution.result == Result.CONVERGED, "recorded": recorded, "solution": solution}
    return fill(_TEXTS["fitted"], facts, before=solution.nominal_errors, after=solution.checked)


def parameter_tables(chain: HayatiForm | SixParameterForm, cell: Callable[[str, str], str]) -> Iterator[RenderableType]:
    """The parameters of a six-parameter chain, or of a Hayati form its base, then a row for each joint.

    `cell` gives the text of a parameter by its name and its column's; the form may have none of the name.
    """
    if isinstance(chain, HayatiForm):
        given = set(chain.names)
        base = [name for name in SIX if f"base_{name}" in given]
        yield listing("base", *base, rows=[("", *(cell(f"base_{name}", name) for name in base))])
        yield ""
        columns = [
            name
            for name in ("theta_off", "d", "a", "b", "alpha", "beta")
            if any(f"{name}{i + 1}" in given for i in range(chain.dof))
        ]
        names = [[f"{name}{i + 1}" for name in columns] for i in range(chain.dof)]
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
    free, determined = solution.free[: form.size], solution.determined[: form.size]
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

    under = "its standard deviation" if measured else "its difference from nominal"
    yield Text(f"Effective model (mm, deg); below each number {under}")
    yield ""
    yield from parameter_tables(form, cell)
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


def _frame_tables(solution: Solution) -> Iterator[RenderableType]:
    """The poses of the base in the sensor frame and of the tool on the flange, where they are estimated."""
    parts = []
    if solution.form.frame:
        parts.append(("Base in the sensor's frame", "frame", np.asarray(solution.model.T_sensor_base)))
    if solution.form.tool:
        T_flange_tool = np.linalg.inv(solution.arm.T_joint_flange) @ np.asarray(solution.model.T_flange_tool)
        parts.append(("Tool on the flange", "tool", T_flange_tool))
    deviation, names = solution.standard_deviation, solution.form.names
    for title, prefix, T in parts:
        yield Text(f"{title} (mm, deg); below each number its standard deviation")
        table = listing(*SIX)
        table.columns[0].justify = "right"
        cells = []
        for k, (value, axis) in enumerate(zip(frames.row_from_transform(T), TWIST_NAMES, strict=True)):
            i, (scale, _) = names.index(f"{prefix}_{axis}"), SCREEN["m" if k < 3 else "rad"]
            held = "held" if deviation is None or not solution.free[i] else f"±{plus_minus(scale * deviation[i])}"
            cells.append(f"{fixed(scale * value, 3)}\n{held}")
        table.add_row(*cells)
        yield table
        yield ""


_PLACES = {
    "point_m": ("x", "y", "z"),
    "normal": ("nx", "ny", "nz"),
    "offset_m": ("offset",),
    "anchor_m": ("x", "y", "z"),
    "direction": ("nx", "ny", "nz"),
    "constant_m": ("constant",),
}
"""The columns of what is known of a place."""


def _place_tables(solution: Solution) -> Iterator[RenderableType]:
    """What touches determine of points, planes, anchors or axes, and what they leave open."""
    if not solution.places:
        return
    keys = list(solution.places[0].values)
    yield Text("In the arm's base frame (mm; directions without unit); below each number its standard deviation")
    table = listing("", *(name for key in keys for name in _PLACES[key]))
    for place in solution.places:
        cells = []
        for key in keys:
            scale = 1e3 if key.endswith("_m") else 1.0
            for value, std in zip(place.values[key], place.std[key], strict=True):
                below = f"±{plus_minus(scale * std)}" if std > 0 else "given"
                cells.append(f"{fixed(scale * value, 3 if scale > 1 else 5)}\n{below}")
        table.add_row(place.name, *cells)
    yield table
    yield ""
    yield from map(Text, gauge_statements(solution.recording, solution.form.frame))  # type: ignore[arg-type]
    yield ""


def gauge_statements(recording: Recording, frame: bool) -> Iterator[str]:
    """What touches leave open, a sentence each; `frame`: whether their frame is another than the arm's base."""
    settings = recording.settings
    facts = {
        "frame": frame,
        "kind": recording.touches.kind,  # type: ignore[union-attr]
        "calibrated": settings.factory_calibration is not None,
        "distances": settings.contact_distances,
    }
    yield from (said for text in _TEXTS["gauge"] if (said := fill(text, facts)))


def _remarks(solution: Solution, recording: Recording) -> Iterator[str]:
    """Data faults, parameters that are held, the noise and outliers, a sentence each."""
    for fault in solution.faults:
        rows = f" Rows {row_ranges(fault.rows)}." if fault.rows else ""
        yield f"Data fault: {fault_statement(fault)}{rows}"
    groups: dict[tuple[str, ...], list[str]] = {}
    for each in solution.held:
        groups.setdefault(each.carried_by, []).append(each.name)
    if groups:
        yield "Held at their start, because these data do not identify them:"
    for carried_by, names in groups.items():
        reason = f"confounded with {', '.join(carried_by)}" if carried_by else "no residual depends on them"
        yield f"  {', '.join(names)}: {reason}"
    if (noise := solution.noise) is not None:
        told = [] if noise.declared is None else zip(noise.declared, SCREEN.values(), strict=True)
        declared = ", ".join(f"{number(scale * value)} {unit}" for value, (scale, unit) in told if value is not None)
        facts = {"noise": noise, "ratio": noise.over_declared, "above": ABOVE_NOISE}
        yield fill(_TEXTS["noise"], facts, declared="" if noise.over_declared is None else declared)
    low = np.flatnonzero(solution.outlying)
    rows = recording.row[low[np.argsort(solution.weight[low])]].tolist()
    yield fill(_TEXTS["outliers"], {"rows": rows, "samples": len(solution.weight), "below": DOWNWEIGHTED})


# ------------------------------------------------------------------ comparisons


def comparison_report(comparison: Comparison, width: int) -> Iterator[RenderableType]:
    """A comparison of arms of one model; the differences of each are listed where they fit beside each other."""
    names, form = comparison.names, comparison.arm.form
    arms = len(names)
    yield Text(
        f"{arms} arms of the type {comparison.arm.name}; flange over {comparison.from_nominal.shape[1]} samples."
    )
    yield ""
    yield Text("Distance from nominal (mm)")
    table = listing("arm", *(name for name, _ in STATISTICS), "file", left=[5], wrapped=[5])
    for k in range(arms):
        cells = (f"{1e3 * float(statistic(comparison.from_nominal[k])):.3f}" for _, statistic in STATISTICS)
        table.add_row(str(k + 1), *cells, Text(names[k], overflow="fold"))
    yield table
    yield ""
    shown = range(arms) if 32 + 9 * arms <= width else ()
    rows = []
    for i, (name, unit) in enumerate(zip(form.names, form.units, strict=True)):
        scale, named = SCREEN[unit]
        spread, largest = scale * comparison.spread[i], scale * comparison.largest[i]
        if largest >= SHOWS_AS_ZERO:
            own = (fixed(scale * comparison.difference[k, i], sign="+") for k in shown)
            rows.append((name, named, *own, f"{spread:.4f}", f"{largest:.4f}"))
    yield Text("Hayati parameters minus nominal")
    yield listing("", "", *(str(k + 1) for k in shown), "std", "largest", rows=rows)
    yield ""
    scale = np.array([SCREEN[unit][0] for unit in form.units])
    equal = [name for name, most in zip(form.names, scale * comparison.largest, strict=True) if most < SHOWS_AS_ZERO]
    if equal:
        yield Text(f"Equal to nominal in every arm: {', '.join(equal)}.")
    lengths = np.array([unit == "m" for unit in form.units])
    spread = scale * comparison.spread
    yield Text(
        f"Spread between the arms: standard deviation {np.sqrt(np.mean(spread[lengths] ** 2)):.3f} mm and"
        f" {np.sqrt(np.mean(spread[~lengths] ** 2)):.4f} deg per parameter (RMS)."
    )
    yield from _pairwise_distances(comparison)


def _pairwise_distances(comparison: Comparison) -> Iterator[RenderableType]:
    arms = len(comparison.names)
    if arms <= _MOST_PAIRS:
        between = [
            ["–" if i == j else f"{1e3 * d:.2f}" for j, d in enumerate(row)] for i, row in enumerate(comparison.between)
        ]
        numbers = [str(k + 1) for k in range(arms)]
        yield ""
        yield Text("Largest distance between two arms' flanges (mm)")
        yield listing("arm", *numbers, rows=((name, *row) for name, row in zip(numbers, between, strict=True)))
        return
    pairs = np.triu_indices(arms, 1)
    distance = comparison.between[pairs]
    near, far = int(np.argmin(distance)), int(np.argmax(distance))
    yield Text(
        f"Between two arms: {1e3 * distance[near]:.3f} mm at most for the nearest pair"
        f" ({pairs[0][near] + 1} and {pairs[1][near] + 1}), {1e3 * distance[far]:.3f} mm for the furthest"
        f" ({pairs[0][far] + 1} and {pairs[1][far] + 1})."
    )
