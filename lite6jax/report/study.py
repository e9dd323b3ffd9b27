"""What a terminal shows of studies and designs: what poses and motions determine, and which of them to make."""

from collections.abc import Iterator, Sequence

import numpy as np
from rich.console import RenderableType
from rich.text import Text

from lite6jax.arms.arm import Arm, joint_unit
from lite6jax.design.candidates import Candidates
from lite6jax.design.determination import Dependency, Determination
from lite6jax.design.identify import Identification, Sensitivity
from lite6jax.design.information import Experiment
from lite6jax.design.poses import MOST_POSES, DiscriminationPlan, Plan
from lite6jax.design.readings import read_places
from lite6jax.design.sensor import AnySensor, PlacedReading
from lite6jax.design.torques import (
    JOINT,
    JOINT_UNITS,
    WELL,
    TorqueIdentification,
    TorqueModel,
    TorquePlan,
)
from lite6jax.model import TWIST_NAMES
from lite6jax.report import screen
from lite6jax.report.fits import parameter_tables
from lite6jax.report.words import (
    SCREEN,
    capital,
    counted,
    each_with_unit,
    joined,
    joint_units,
    listing,
    number,
    plus_minus,
    ranges,
    torque_units,
)

_MOST_LISTED = 12
_MOST_PAIRS = 6
_CLEAR = 5.0
"""Standard deviations between two models at which a test at a level of 1 % has a power of 99 % or more."""


def _beginning(source: str, what: str, disabled: Sequence[tuple[str, str]] = ()) -> Iterator[RenderableType]:
    """The arm or the file, what was studied, and which pairs of links are not checked against each other."""
    yield Text(source, no_wrap=True, overflow="ignore")
    yield Text(what)
    if disabled:
        pairs = ", ".join(f"{a} with {b}" for a, b in disabled)
        yield Text(f"Not checked for collision, as they overlap nearly always: {pairs}.")
    yield ""


# ------------------------------------------------------------------ what poses determine


def described(sensor: AnySensor) -> str:
    """A sensor in a phrase, with the noise of the joints' read-outs."""
    joints = f", joints read to ±{np.rad2deg(sensor.joint_noise):.2g} deg" if sensor.joint_noise else ""
    return sensor.phrase + joints


def identification_report(found: Identification, source: str, drawn: bool) -> Iterator[RenderableType]:
    """What poses determine: the rank, the dependent parameters, the predicted deviations, the remedy."""
    experiment, d = found.experiment, found.determination
    poses = f"{counted(d.samples, 'pose')}{' drawn inside the limits' if drawn else ''}"
    yield from _beginning(source, f"{experiment.arm.name}, {poses}; a sensor of {described(experiment.sensor)}.")
    yield Text(f"These poses determine {'all' if d.rank == d.size else f'{d.rank} of'} {d.size} unknown parameters.")
    yield Text(_reason(found))
    yield ""
    if d.dependencies:
        yield from map(Text, _in_words(experiment, d.dependencies))
        yield ""
    yield Text("Predicted standard deviations (mm, deg)")
    yield ""
    yield from _deviation_tables(experiment, d)
    yield Text(_expected(found))
    if weak := d.weak():
        are = "is" if len(weak) == 1 else "are"
        yield Text(f"Weak: {joined(weak)} {are} determined no better than by the tolerances of assembly.")
    if pairs := d.correlated():
        listed = ", ".join(f"{a} with {b} ({rho:+.3f})" for a, b, rho in pairs[:_MOST_PAIRS])
        more = f" and {len(pairs) - _MOST_PAIRS} pairs more" if len(pairs) > _MOST_PAIRS else ""
        yield Text(f"Strongly correlated estimates (above 0.95): {listed}{more}.")
    yield ""
    if (o := found.observability) is not None:
        yield Text("Observability (parameters in units of 0.8 mm and 0.15 deg, readings in standard deviations)")
        yield ""
        table = listing("O1", "O2", "O3", "O4", "O5", "condition")
        table.columns[0].justify = "right"
        table.add_row(*(f"{value:.4g}" for value in (o.O1, o.O2, o.O3, o.O4, o.O5, o.condition)))
        yield table
        worst = f"one standard deviation moves the worst direction {o.noise_amplification:.2g} units"
        yield Text(f"Noise amplification: {worst}.")
    yield from screen.notes(found.notes)


def _reason(found: Identification) -> str:
    """Why these poses determine no more, or which would."""
    d, arm = found.determination, found.experiment.arm
    if found.missed:
        narrow = found.narrow()
        remedy = "record more poses, or others (lite6jax design)"
        if 0 < len(narrow) < arm.dof:
            remedy = f"{_narrow_joints(arm, narrow)} only; move it further"
        return f"Other poses of this arm determine {found.possible.rank}: {remedy}."
    why = " The measured point lies on the last joint's axis (--tool-at)." if found.on_last_axis else ""
    return f"Other poses inside its limits determine no more.{why if d.rank < d.size else ''}"


def _narrow_joints(arm: Arm, narrow: Sequence[tuple[int, float]]) -> str:
    scales, units = joint_units(arm.sliding, arm.dof)
    return " and ".join(f"joint {j + 1} moves over {scales[j] * span:.2g} {units[j]}" for j, span in narrow)


def _in_words(experiment: Experiment, dependencies: Sequence[Dependency]) -> Iterator[str]:
    """The dependent parameters; those confounded with the sensor's frame or the tool take one sentence each."""
    rest = list(dependencies)
    if experiment.precision.any():  # the amounts of a direction that a prior keeps short would mislead
        yield f"The readings do not determine {len(rest)} combinations; their prior does."
        return
    for part, phrase in (("frame_", "The sensor's frame does"), ("tool_", "The tool does")):
        same = [d for d in rest if d.partners and all(name.startswith(part) for name, _, _ in d.partners)]
        if len(same) > 1:
            rest = [d for d in rest if d not in same]
            yield f"{phrase} what {joined(d.name for d in same)} do."
    unobservable = [d for d in rest if not d.partners]
    if len(unobservable) > 1:
        rest = [d for d in rest if d.partners]
        yield f"No reading changes with {joined(d.name for d in unobservable)}."
    yield from (d.statement for d in rest)
    yield "The data do not distinguish these: a fit holds the first of each at nominal."


def _expected(found: Identification) -> str:
    accuracy = found.accuracy
    if not accuracy.position_determined:
        return (
            "The fitted model does not predict the whole workspace: positions there depend on combinations that these"
            " poses do not determine."
        )
    expected = f"±{number(1e3 * accuracy.position_rms)} mm"
    if accuracy.orientation_determined:
        expected += f" and ±{number(np.rad2deg(accuracy.orientation_rms))} deg"
    return f"The fitted model predicts the whole workspace to {expected}."


def _deviation_tables(experiment: Experiment, determination: Determination) -> Iterator[RenderableType]:
    """A row a joint, then the sensor's frame and the tool, and the effects."""
    d, chain = determination, experiment.form.chain
    parameters = zip(d.names, d.units, d.standard_deviation, d.free, strict=True)
    shown = {
        name: plus_minus(SCREEN.get(unit, (1.0, unit))[0] * deviation) if free else "held"
        for name, unit, deviation, free in parameters
    }
    if experiment.movable[: chain.size].any():
        yield from parameter_tables(chain, lambda name, _: shown.get(name, ""))
        yield ""
    parts = [part for part in ("frame", "tool") if getattr(experiment.form, part)]
    if parts:
        rows = ((part, *(shown.get(f"{part}_{twist}", "") for twist in TWIST_NAMES)) for part in parts)
        yield listing("", *TWIST_NAMES, rows=rows)
        yield ""
    if experiment.physics.effects:
        table = listing("effect", "deviation", "typical", "unit")
        for i in range(experiment.size - experiment.physics.size, experiment.size):
            deviation = f"{d.standard_deviation[i]:.2g}" if d.free[i] else "held"
            table.add_row(d.names[i], deviation, f"{d.scale[i]:.2g}", d.units[i].strip("1"))
        yield table
        yield ""


# ------------------------------------------------------------------ where the error of an arm comes from


def sensitivity_report(found: Sensitivity, source: str) -> Iterator[RenderableType]:
    """Which parameters make up the error of an arm as assembled."""
    length, angle = (
        next((t for t, unit in zip(found.tolerance, found.units, strict=True) if unit == kind), 0.0)
        for kind in ("m", "rad")
    )
    made = f"±{1e3 * length:.3g} mm and ±{np.rad2deg(angle):.3g} deg in each number, one standard deviation"
    yield from _beginning(source, f"Arms made to {made}.")
    expected = found.expected_error
    yield Text(
        f"The flange stands {1e3 * np.sqrt(np.mean(expected**2)):.1f} mm (RMS) from nominal over the workspace,"
        f" {1e3 * expected.min():.1f} mm where it is best and {1e3 * expected.max():.1f} mm where it is worst."
    )
    yield ""
    table = listing("parameter", "mm per unit", "share")
    for i in np.argsort(-found.share)[:_MOST_LISTED]:
        scale, unit = SCREEN[found.units[i]]
        table.add_row(found.names[i], f"{1e3 * found.per_unit[i] / scale:.3g} /{unit}", f"{100 * found.share[i]:.1f} %")
    yield table
    yield Text(
        f"Shares are of the mean squared error, to first order; even shares would be {100 / len(found.names):.1f} %"
        f" each (the largest is {100 * found.share.max():.1f} %)."
    )


# ------------------------------------------------------------------ which poses to record


def design_report(
    found: Plan | DiscriminationPlan,
    drawn: Candidates,
    disabled: Sequence[tuple[str, str]],
    source: str,
    accuracy: float | None = None,
) -> Iterator[RenderableType]:
    """Which poses were chosen among candidates, and what they are worth.

    Pairs of links that are `disabled` are not checked against each other. `accuracy` is a target in m.
    """
    refused = ", ".join(f"{name} refused {count}" for name, count in drawn.refused.items() if count)
    why = f" ({refused})" if refused else ""
    sensor = described(found.experiment.sensor)
    what = f"{found.count} poses of {len(drawn.joint_position)} candidates{why}; a sensor of {sensor}."
    yield from _beginning(source, what, disabled)
    yield from plan_report(found, accuracy) if isinstance(found, Plan) else discrimination_report(found)
    yield ""
    if any(driver.discrete for e in found.experiment.physics.effects for driver in e.drivers):
        yield Text("For effects of the direction of motion, come to each pose from where all joints are at zero.")
    d = found.design
    yield Text(
        f"Chosen by {d.exchanges} exchanges in {d.cycles} rounds; {d.rank} combinations of {found.experiment.size}"
        " unknown parameters are identifiable."
    )


def places_report(experiment: Experiment, joint_position: np.ndarray) -> Iterator[RenderableType]:
    """Where the places of touches are, in the base's frame, and how many poses `(pose, joint)` touch each."""
    sensor = experiment.sensor
    if not isinstance(sensor, PlacedReading) or sensor.quantity not in ("contact", "plane"):
        return
    counts = np.bincount(read_places(experiment, joint_position), minlength=len(sensor.places))
    rows = (
        (name, *(f"{1e3 * part:.0f}" for part in at), str(count))
        for (name, at), count in zip(sensor.places, counts, strict=True)
    )
    yield ""
    yield Text("Put them within some centimetres of these places (mm in the arm's base frame)")
    yield ""
    yield listing("", "x", "y", "z", "touches", rows=rows)


def plan_report(found: Plan, accuracy: float | None = None) -> Iterator[RenderableType]:
    """What designed poses are worth, beside random ones; `accuracy` as of `design_report`."""
    reached, random = found.accuracy[-1], found.random_accuracy[:, found.count - 1]
    if np.isfinite(reached):
        middle = float(np.quantile(random, 0.5, method="nearest"))
        times = f" ({middle / reached:.2f} times as much)" if np.isfinite(middle) else ""
        drawn = f"to ±{number(1e3 * middle)} mm{times}" if np.isfinite(middle) else "do not determine all parameters"
        yield Text(
            f"These poses let the fit predict positions to ±{number(1e3 * reached)} mm over the workspace; as many"
            f" drawn at random {drawn}."
        )
        less = f"{found.random_accuracy.shape[1]} random poses predict less accurately."
        yield Text(less if found.worth is None else f"They are worth {found.worth} random poses.")
    else:
        yield Text(
            "Positions over the workspace depend on combinations that this sensor does not determine, however many the"
            " poses: the accuracy of predictions is unbounded (lite6jax identify names the combinations)."
        )
    if accuracy is not None:
        wanted = number(1e3 * accuracy)
        if found.needed is None:
            tried = max(found.count, min(MOST_POSES, found.candidates))
            yield Text(f"±{wanted} mm is not reached by {tried} poses either.")
        elif found.needed <= found.count:
            yield Text(f"±{wanted} mm is reached by {found.needed} of them; give --poses {found.needed}.")
        else:
            yield Text(f"±{wanted} mm takes {found.needed} poses; give --poses {found.needed}.")
    yield ""
    if np.isfinite(reached):
        table = listing("best of these", "designed", "random", "ratio")
        table.columns[0].justify = "right"
        # a few numbers of poses, from a third more than the least that determine all parameters
        determined = int(np.flatnonzero(np.isfinite(found.accuracy))[0]) + 1
        least = min(-(-4 * determined // 3), found.count)
        for n in sorted({int(n) for n in np.geomspace(least, found.count, 6).round()}):
            designed, drawn = found.accuracy[n - 1], found.random_median[n - 1]
            cells = [f"±{number(1e3 * value)} mm" if np.isfinite(value) else "–" for value in (designed, drawn)]
            ratio = f"{drawn / designed:.2f}" if np.isfinite(designed) and np.isfinite(drawn) else "–"
            table.add_row(str(n), *cells, ratio)
        yield table


def discrimination_report(found: DiscriminationPlan) -> Iterator[RenderableType]:
    """How far apart two effects are at designed poses, and at random ones."""
    reached, random = found.distance[-1], float(np.median(np.nan_to_num(found.random_distance)))
    ratio = f" (ratio {reached / random:.2f})" if random > 0 else ""
    hypothesis, alternative = found.rivals
    yield Text(
        f"If {hypothesis} has the size given, the readings at these poses are {reached:.1f} standard deviations from"
        f" the closest that {alternative} explains with all other unknowns refitted;"
        f" {random:.1f} at as many drawn at random{ratio}."
    )
    if reached < _CLEAR:
        yield Text(f"A reliable decision takes {_CLEAR:g}: record more poses, or use a sensor with less noise.")


# ------------------------------------------------------------------ what motions determine


def _torque_noise(model: TorqueModel) -> str:
    """The noise of an arm's torques in a phrase."""
    noise, units = model.noise.tolist(), torque_units(model.arm.sliding, model.arm.dof)
    alike = len(set(zip(noise, units, strict=True))) == 1
    each = each_with_unit(*((noise[:1], units[:1]) if alike else (noise, units)))
    return f"torques to ±{each} (one standard deviation, white)"


def combination(terms: Sequence[tuple[str, float]]) -> str:
    """A base parameter as a sum, links with the same factor of the same quantity together: 0.2 link3–6 m."""
    groups: dict[tuple[str, str], list[str]] = {}
    for name, factor in terms:
        carrier, kind = name.split(" ", 1)
        groups.setdefault((f"{factor:.3g}", kind), []).append(carrier)
    text = ""
    for (factor, kind), carriers in groups.items():
        size = factor.removeprefix("-")
        word = carriers[0].rstrip("0123456789")
        numbers = ",".join(shown for shown, _ in ranges(int(carrier.removeprefix(word)) for carrier in carriers))
        sign = " − " if factor.startswith("-") else " + "
        text += f"{sign}{'' if size == '1' else f'{size} '}{word}{numbers} {kind}"
    return text.removeprefix(" + ")


def torque_identification_report(found: TorqueIdentification, source: str, motion: str) -> Iterator[RenderableType]:
    """What a motion determines: the rank, base parameters in words, friction, what is not determined and why."""
    model, deviations = found.model, found.deviations
    yield from _beginning(source, f"{model.arm.name}, {motion}; {_torque_noise(model)}.")
    yield Text(_rank(found))
    yield from map(Text, _undetermined(found))
    if model.silent:
        yield Text(f"No torque changes with {', '.join(model.silent)}.")
    for name, carriers in model.confounded.items():
        if name.startswith("joint"):
            yield Text(f"{name} is confounded with {' and '.join(carriers)}: only their sum is determined.")
    if links := [name for name in model.confounded if name.startswith("link")]:
        yield Text(f"Only in combinations: {', '.join(links)}.")
    yield ""
    if model.inertial:
        rows = (
            (combination(item.terms), _deviation(deviations.get(item.name)), f"{item.scale:.2g}", item.unit)
            for item in model.base
            if item.name.startswith("link")
        )
        table = listing("combination", "±", "typical", "unit", rows=rows)
        table.columns[0].no_wrap = False
        yield Text("Base parameters of the links, standard deviation and unit (factors in m and m²)")
        yield from ("", table, "")
    kinds = [
        (own, label) for own, label in ((False, ""), (True, "of prismatic joints, P: ")) if own in model.arm.slides
    ]
    units = "; ".join(label + ", ".join(joint_unit(unit, own) for unit in JOINT_UNITS) for own, label in kinds)
    yield Text(f"Friction and rotors, standard deviations ({units})")
    yield ""
    table, carried = listing("joint", *JOINT), model.confounded
    for joint, slides in enumerate(model.arm.slides, 1):
        names = [f"joint{joint} {kind}" for kind in JOINT]
        cells = (f"in {carried[n][0]}" if n in carried else _deviation(deviations.get(n)) for n in names)
        table.add_row(f"J{joint}{' P' * bool(slides)}", *cells)
    yield table
    yield Text(
        f"Condition number {found.condition:.4g} (regressor in standard deviations, parameters in typical sizes)."
        if np.isfinite(found.condition)
        else "Nothing is determined."
    )
    if weak := [item.name for item, is_weak in zip(model.base, found.weak, strict=True) if is_weak]:
        yield Text(f"Weak: {', '.join(weak)} (over {100 * WELL:.0f} % of the typical size).")
    yield from screen.notes(map(capital, found.notes))


def _deviation(value: float | None) -> str:
    return "not" if value is None else plus_minus(value)


def _rank(found: TorqueIdentification) -> str:
    base, rank = found.model.base, int(found.determined.sum())
    links = sum(item.name.startswith("link") for item in base)
    of = f"{links} of the links, " if found.model.inertial else ""
    amount = "all" if rank == len(base) else f"{rank} of"
    return f"This motion determines {amount} {len(base)} base parameters ({of}{len(base) - links} of the joints)."


def _undetermined(found: TorqueIdentification) -> Iterator[str]:
    missed = [item.name for item, there in zip(found.model.base, found.determined, strict=True) if not there]
    if not missed:
        return
    yield f"Not determined apart from others: {', '.join(missed)}."
    narrow, arm = found.narrow(), found.model.arm
    if len(narrow) == arm.dof:
        yield "No joint moves over more than 10 deg: record a motion of all joints (lite6jax design --torque)."
    elif narrow:
        yield f"{capital(_narrow_joints(arm, narrow))} only; move it further."
    elif found.at_rest:
        yield "The arm stands still in all samples, which show gravity only: record it in motion."
    else:
        yield "Another motion determines them: record a longer one, or that of lite6jax design --torque."


# ------------------------------------------------------------------ which motion to make


def torque_plan_report(found: TorquePlan, disabled: Sequence[tuple[str, str]], source: str) -> Iterator[RenderableType]:
    """What a designed motion determines, beside random ones of the same limits."""
    designed, random, room = found.identification, found.random, found.room
    scales, units = joint_units(room.arm.sliding, room.arm.dof)
    limits = []
    for limit, per in ((room.velocity, "/s"), (room.acceleration, "/s²")):
        most = {unit: max(scales[j] * limit[j] for j in range(room.arm.dof) if units[j] == unit) for unit in units}
        limits += [f"{most[unit]:.4g} {unit}{per}" for unit in ("deg", "mm") if unit in most]
    what = (
        f"A motion of {room.duration:g} s from rest to rest, {room.harmonics} harmonics, {room.samples + 1} samples, up"
        f" to {' and '.join(limits)}; {_torque_noise(designed.model)}."
    )
    yield from _beginning(source, what, disabled)
    yield Text(_rank(designed))
    middle, best = np.median(found.random_log_determinant), np.max(found.random_log_determinant)
    if np.isfinite(best):
        times = f"{found.gain(float(middle)):.2f} times" if np.isfinite(middle) else "much"
        yield Text(
            f"In the geometric mean its standard deviations are {times} smaller than those of a random motion of the"
            f" same limits (the median of {len(random)}), {found.gain(float(best)):.2f} times smaller than those of the"
            " best of them."
        )
    else:
        yield Text(f"None of {len(random)} random motions of the same limits determines all of them.")
    yield ""
    table = listing("", "designed", "random, median", "random, best")
    for name, of, best_of in (
        ("log determinant", lambda one: one.log_determinant, np.max),
        ("condition number", lambda one: one.condition, np.min),
        ("weakly determined", lambda one: one.weak.sum(), np.min),
    ):
        others = [of(one) for one in random]
        table.add_row(name, *(f"{value:.4g}" for value in (of(designed), np.median(others), best_of(others))))
    yield table
