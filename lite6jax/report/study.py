"""What a terminal shows of studies and designs: what poses and motions determine, and which of them to make.

The sentences are in `templates/studies.yaml`.
"""

from collections.abc import Iterator, Sequence
from functools import reduce

import numpy as np
from rich.console import RenderableType

from lite6jax.arms.arm import Arm, joint_unit
from lite6jax.design.candidates import Candidates
from lite6jax.design.determination import Dependency, Determination
from lite6jax.design.identify import Identification, Sensitivity
from lite6jax.design.information import Experiment
from lite6jax.design.poses import MOST_POSES, DiscriminationPlan, Plan
from lite6jax.design.readings import read_places
from lite6jax.design.sensor import PlacedReading, PlannedSensor
from lite6jax.design.torques import JOINT, JOINT_UNITS, WELL, TorqueIdentification, TorqueModel, TorquePlan
from lite6jax.model import TWIST_NAMES
from lite6jax.report import screen
from lite6jax.report.fits import parameter_tables
from lite6jax.report.words import (
    SCREEN,
    capital,
    each_with_unit,
    joined,
    joint_units,
    listing,
    number,
    plus_minus,
    ranges,
    read_texts,
    say,
    torque_units,
)

_TEXTS = read_texts("studies.yaml")
_MOST_LISTED = 12
_CLEAR = 5.0
"""Standard deviations between two models at which a test at a level of 1 % has a power of 99 % or more."""


def _say(text: str, **facts: object) -> Iterator[str]:
    """A text by its path, such as `poses.rank`, or a list of them."""
    return say(reduce(lambda texts, name: texts[name], text.split("."), _TEXTS), facts)


def _begin(
    source: str, text: str, disabled: Sequence[tuple[str, str]] = (), **facts: object
) -> Iterator[RenderableType]:
    """The arm or the file, what was studied, and which pairs of links are not checked against each other."""
    yield screen.unbroken(source)
    yield from (*_say(text, **facts), *_say("beginning", disabled=disabled), "")


# ------------------------------------------------------------------ what poses determine


def described(sensor: PlannedSensor) -> str:
    """A sensor in a phrase, with the noise of the joints' read-outs."""
    joints = f", joints read to ±{np.rad2deg(sensor.joint_noise):.2g} deg" if sensor.joint_noise else ""
    return sensor.phrase + joints


def identification_report(found: Identification, source: str, drawn: bool) -> Iterator[RenderableType]:
    """What poses determine: the rank, the dependent parameters, the predicted deviations, the remedy."""
    experiment, d, arm = found.experiment, found.determination, found.experiment.arm
    yield from _begin(source, "poses.studied", e=experiment, d=d, drawn=drawn, sensor=described(experiment.sensor))
    narrow = found.narrow()
    said = _name_narrow(arm, narrow) if len(narrow) < arm.dof else ""
    yield from (*_say("poses.rank", found=found, d=d, narrow=said), "")
    if d.dependencies:
        yield from (*_in_words(experiment, d.dependencies), "")
    yield from ("Predicted standard deviations (mm, deg)", "")
    yield from _deviation_tables(experiment, d)
    pairs = [f"{a} with {b} ({rho:+.3f})" for a, b, rho in d.correlated()]
    yield from (*_say("poses.accuracy", accuracy=found.accuracy, weak=d.weak(), pairs=pairs), "")
    if (o := found.observability) is not None:
        table = listing("O1", "O2", "O3", "O4", "O5", "condition", rows=[[f"{value:.4g}" for value in o[:6]]])
        table.columns[0].justify = "right"
        yield "Observability (parameters in units of 0.8 mm and 0.15 deg, readings in standard deviations)"
        yield from ("", table)
        yield from _say("poses.noise", noise_amplification=o.noise_amplification)
    yield from screen.notes(found.notes)


def _name_narrow(arm: Arm, narrow: Sequence[tuple[int, float]]) -> str:
    """Joints that hardly move, and their ranges, in words; empty where there are none."""
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


def _deviation_tables(experiment: Experiment, determination: Determination) -> Iterator[RenderableType]:
    """A row a joint, then the sensor's frame and the tool, and the effects."""
    d, chain = determination, experiment.form.chain
    parameters = zip(d.names, d.units, d.standard_deviation, d.free, strict=True)
    shown = {
        name: plus_minus(SCREEN.get(unit, (1.0, unit))[0] * deviation) if free else "held"
        for name, unit, deviation, free in parameters
    }
    if experiment.movable[: chain.size].any():
        yield from (*parameter_tables(chain, lambda name, _: shown.get(name, "")), "")
    parts = [part for part in ("frame", "tool") if getattr(experiment.form, part)]
    if parts:
        rows = ((part, *(shown.get(f"{part}_{twist}", "") for twist in TWIST_NAMES)) for part in parts)
        yield from (listing("", *TWIST_NAMES, rows=rows), "")
    if experiment.physics.effects:
        table = listing("effect", "deviation", "typical", "unit")
        for i in range(experiment.size - experiment.physics.size, experiment.size):
            deviation = f"{d.standard_deviation[i]:.2g}" if d.free[i] else "held"
            table.add_row(d.names[i], deviation, f"{d.scale[i]:.2g}", d.units[i].strip("1"))
        yield from (table, "")


# ------------------------------------------------------------------ where the error of an arm comes from


def sensitivity_report(found: Sensitivity, source: str) -> Iterator[RenderableType]:
    """Which parameters make up the error of an arm as assembled."""
    tolerance = {"m": 0.0, "rad": 0.0} | dict(zip(found.units, found.tolerance.tolist(), strict=True))
    yield from _begin(source, "tolerances.studied", tolerance=tolerance)
    error = found.expected_error
    yield from (*_say("tolerances.error", rms=np.sqrt(np.mean(error**2)), least=error.min(), most=error.max()), "")
    table = listing("parameter", "mm per unit", "share")
    for i in np.argsort(-found.share)[:_MOST_LISTED]:
        scale, unit = SCREEN[found.units[i]]
        table.add_row(found.names[i], f"{1e3 * found.per_unit[i] / scale:.3g} /{unit}", f"{100 * found.share[i]:.1f} %")
    yield table
    yield from _say("tolerances.shares", share=found.share)


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
    refused = [f"{name} refused {count}" for name, count in drawn.refused.items() if count]
    sensor = described(found.experiment.sensor)
    yield from _begin(source, "design.studied", disabled, found=found, drawn=drawn, refused=refused, sensor=sensor)
    yield from plan_report(found, accuracy) if isinstance(found, Plan) else discrimination_report(found)
    approached = any(driver.discrete for effect in found.experiment.physics.effects for driver in effect.drivers)
    yield from ("", *_say("design.approach", approached=approached), *_say("design.chosen", found=found))


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
    yield from ("", "Put them within some centimetres of these places (mm in the arm's base frame)", "")
    yield listing("", "x", "y", "z", "touches", rows=rows)


def plan_report(found: Plan, accuracy: float | None = None) -> Iterator[RenderableType]:
    """What designed poses are worth, beside random ones; `accuracy` as of `design_report`."""
    reached = found.accuracy[-1]
    random = np.quantile(found.random_accuracy[:, found.count - 1], 0.5, method="nearest")
    yield from _say(
        "design.worth",
        found=found,
        accuracy=accuracy,
        reached=reached,
        determined=bool(np.isfinite(reached)),
        random=float(random) if np.isfinite(random) else None,
        tried=max(found.count, min(MOST_POSES, found.candidates)),
    )
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
    random = float(np.median(np.nan_to_num(found.random_distance)))
    return _say("design.rivals", found=found, reached=found.distance[-1], random=random, clear=_CLEAR)


# ------------------------------------------------------------------ what motions determine


def _torque_noise(model: TorqueModel) -> str:
    """The noise of an arm's torques in a phrase."""
    noise, units = model.noise.tolist(), torque_units(model.arm.sliding, model.arm.dof)
    alike = len(set(zip(noise, units, strict=True))) == 1
    each = each_with_unit(*((noise[:1], units[:1]) if alike else (noise, units)))
    return f"torques to ±{each} (one standard deviation, white)"


def _rank(found: TorqueIdentification) -> Iterator[str]:
    base = found.model.base
    links, rank = sum(item.name.startswith("link") for item in base), int(found.determined.sum())
    return _say("torques.rank", rank=rank, links=links, joints=len(base) - links, inertial=found.model.inertial)


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
    model, arm, narrow = found.model, found.model.arm, found.narrow()
    deviations = {item.name: "not" for item in model.base}
    deviations |= {name: plus_minus(deviation) for name, deviation in found.deviations.items()}
    yield from _begin(source, "torques.studied", arm=arm.name, motion=motion, noise=_torque_noise(model))
    yield from _rank(found)
    yield from _say(
        "torques.missed",
        found=found,
        model=model,
        missed=[name for name, deviation in deviations.items() if deviation == "not"],
        none_moves=len(narrow) == arm.dof,
        narrow=_name_narrow(arm, narrow),
    )
    for name, carriers in model.confounded.items():
        if name.startswith("joint"):
            yield from _say("torques.confounded", name=name, carriers=carriers)
    yield from (*_say("torques.links", names=[name for name in model.confounded if name.startswith("link")]), "")
    if model.inertial:
        rows = (
            (combination(item.terms), deviations[item.name], f"{item.scale:.2g}", item.unit)
            for item in model.base
            if item.name.startswith("link")
        )
        table = listing("combination", "±", "typical", "unit", rows=rows)
        table.columns[0].no_wrap = False
        yield "Base parameters of the links, standard deviation and unit (factors in m and m²)"
        yield from ("", table, "")
    kinds = [(own, label) for own, label in ((False, ""), (True, "of prismatic joints, P: ")) if own in arm.slides]
    units = "; ".join(label + ", ".join(joint_unit(unit, own) for unit in JOINT_UNITS) for own, label in kinds)
    yield from (f"Friction and rotors, standard deviations ({units})", "")
    table, carried = listing("joint", *JOINT), model.confounded
    for joint, slides in enumerate(arm.slides, 1):
        names = [f"joint{joint} {kind}" for kind in JOINT]
        cells = (f"in {carried[n][0]}" if n in carried else deviations.get(n, "not") for n in names)
        table.add_row(f"J{joint}{' P' * bool(slides)}", *cells)
    yield table
    weak = [item.name for item, is_weak in zip(model.base, found.weak, strict=True) if is_weak]
    yield from _say("torques.quality", found=found, weak=weak, well=WELL)
    yield from screen.notes(map(capital, found.notes))


# ------------------------------------------------------------------ which motion to make


def torque_plan_report(found: TorquePlan, disabled: Sequence[tuple[str, str]], source: str) -> Iterator[RenderableType]:
    """What a designed motion determines, beside random ones of the same limits."""
    designed, random, room = found.identification, found.random, found.room
    scales, units = joint_units(room.arm.sliding, room.arm.dof)
    limits = []
    for limit, per in ((room.velocity, "/s"), (room.acceleration, "/s²")):
        most = {unit: max(scales[j] * limit[j] for j in range(room.arm.dof) if units[j] == unit) for unit in units}
        limits += [f"{most[unit]:.4g} {unit}{per}" for unit in ("deg", "mm") if unit in most]
    yield from _begin(source, "motion.studied", disabled, room=room, limits=limits, noise=_torque_noise(designed.model))
    yield from _rank(designed)
    median, best = (of(found.random_log_determinant) for of in (np.median, np.max))
    gains = {
        name: f"{found.gain(float(value)):.2f}" if np.isfinite(value) else ""
        for name, value in (("median", median), ("best", best))
    }
    yield from (*_say("motion.gain", finite=np.isfinite(best), count=len(random), **gains), "")
    table = listing("", "designed", "random, median", "random, best")
    for name, of, best_of in (
        ("log determinant", lambda one: one.log_determinant, np.max),
        ("condition number", lambda one: one.condition, np.min),
        ("weakly determined", lambda one: one.weak.sum(), np.min),
    ):
        others = [of(one) for one in random]
        table.add_row(name, *(f"{value:.4g}" for value in (of(designed), np.median(others), best_of(others))))
    yield table
