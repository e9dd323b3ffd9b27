"""What a terminal shows of studies and designs: what poses and motions determine, and which of them to make.

The sentences are functions of `sentences.studies`; those that depend on no condition are in `templates/studies.yaml`.
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
from lite6jax.design.torques import JOINT, JOINT_UNITS, TorqueExperiment, TorqueIdentification, TorquePlan
from lite6jax.formatting import (
    SCREEN,
    capital,
    each_with_unit,
    joined,
    joint_units,
    number,
    plus_minus,
    ranges,
    torque_units,
)
from lite6jax.model import TWIST_NAMES
from lite6jax.report import screen
from lite6jax.report.fits import parameter_tables
from lite6jax.report.sentences import studies as sentences
from lite6jax.report.words import fill, listing, read_texts, say
from lite6jax.sensors.points import PointSensor
from lite6jax.sensors.sensor import Sensor

_TEXTS = read_texts("studies.yaml")
_MOST_LISTED = 12


def _say(text: str, **facts: object) -> Iterator[str]:
    """A text by its path, such as `poses.rank`, or a list of them."""
    return say(reduce(lambda texts, name: texts[name], text.split("."), _TEXTS), facts)


def _begin(source: str, studied: str, disabled: Sequence[tuple[str, str]] = ()) -> Iterator[RenderableType]:
    """The arm or the file, what was studied, and which pairs of links are not checked against each other."""
    yield screen.unbroken(source)
    yield from (studied, *sentences.unchecked_pairs(disabled), "")


# ------------------------------------------------------------------ what poses determine


def described(sensor: Sensor) -> str:
    """A sensor in a phrase, with the noise of the joints' read-outs."""
    joints = ""
    if sensor.joint_noise:
        joints = f", joints read to ±{np.rad2deg(sensor.joint_noise):.2g} deg"
    return sensor.phrase + joints


def identification_report(identification: Identification, source: str, drawn: bool) -> Iterator[RenderableType]:
    """What poses determine: the rank, the dependent parameters, the predicted deviations, the remedy."""
    experiment = identification.experiment
    d = identification.determination
    arm = identification.experiment.arm
    sensor = described(experiment.sensor)
    yield from _begin(source, sentences.poses_studied(experiment, d.samples, drawn, sensor))
    narrow = identification.narrow()
    narrow_joints = _name_narrow(arm, narrow) if len(narrow) < arm.dof else ""
    yield from (*sentences.rank_of_poses(identification, narrow_joints), "")
    if d.dependencies:
        yield from (*_in_words(experiment, d.dependencies), "")
    yield from ("Predicted standard deviations (mm, deg)", "")
    yield from _deviation_tables(experiment, d)
    yield from (*sentences.accuracy_of_poses(identification.accuracy, d), "")
    if (o := identification.observability) is not None:
        table = listing("O1", "O2", "O3", "O4", "O5", "condition", rows=[[f"{value:.4g}" for value in o[:6]]])
        table.columns[0].justify = "right"
        yield "Observability (parameters in units of 0.8 mm and 0.15 deg, readings in standard deviations)"
        yield from ("", table)
        yield from _say("poses.noise", noise_amplification=o.noise_amplification)
    yield from screen.notes(identification.notes)


def _name_narrow(arm: Arm, narrow: Sequence[tuple[int, float]]) -> str:
    """Joints that hardly move, and their ranges, in words; empty where there are none."""
    scales, units = joint_units(arm.sliding, arm.dof)
    return " and ".join(f"joint {j + 1} moves over {scales[j] * span:.2g} {units[j]}" for j, span in narrow)


def _in_words(experiment: Experiment, dependencies: Sequence[Dependency]) -> Iterator[str]:
    """The dependent parameters; those confounded with the sensor's frame or the tool take one sentence each."""
    remaining_dependencies = list(dependencies)
    if experiment.precision.any():  # the amounts of a direction that a prior keeps short would mislead
        yield f"The readings do not determine {len(remaining_dependencies)} combinations; their prior does."
        return
    for part, phrase in (("frame_", "The sensor's frame does"), ("tool_", "The tool does")):
        of_part = [
            d for d in remaining_dependencies if d.partners and all(name.startswith(part) for name, _, _ in d.partners)
        ]
        if len(of_part) > 1:
            remaining_dependencies = [d for d in remaining_dependencies if d not in of_part]
            yield f"{phrase} what {joined(d.name for d in of_part)} do."
    unobservable = [d for d in remaining_dependencies if not d.partners]
    if len(unobservable) > 1:
        remaining_dependencies = [d for d in remaining_dependencies if d.partners]
        yield f"No reading changes with {joined(d.name for d in unobservable)}."
    yield from (d.statement for d in remaining_dependencies)
    yield "The data do not distinguish these: a fit holds the first of each at nominal."


def _deviation_tables(experiment: Experiment, determination: Determination) -> Iterator[RenderableType]:
    """A row a joint, then the sensor's frame and the tool, and the effects."""
    d = determination
    chain = experiment.form.chain
    parameters = zip(d.names, d.units, d.standard_deviation, d.free, strict=True)
    shown = {
        name: plus_minus(SCREEN.get(unit, (1.0, unit))[0] * deviation) if free else "held"
        for name, unit, deviation, free in parameters
    }
    if experiment.movable[: chain.size].any():
        yield from (*parameter_tables(chain, lambda name, _: shown.get(name, "")), "")
    form = experiment.form
    parts = [part for part, is_free in (("frame", form.frame), ("tool", form.tool)) if is_free]
    if parts:
        rows = ((part, *(shown.get(f"{part}_{twist}", "") for twist in TWIST_NAMES)) for part in parts)
        yield from (listing("", *TWIST_NAMES, rows=rows), "")
    if experiment.physics.effects:
        table = listing("effect", "deviation", "typical", "unit")
        for i in range(experiment.size - experiment.physics.size, experiment.size):
            deviation = "held"
            if d.free[i]:
                deviation = f"{d.standard_deviation[i]:.2g}"
            table.add_row(d.names[i], deviation, f"{d.scale[i]:.2g}", d.units[i].strip("1"))
        yield from (table, "")


# ------------------------------------------------------------------ where the error of an arm comes from


def sensitivity_report(sensitivity: Sensitivity, source: str) -> Iterator[RenderableType]:
    """Which parameters make up the error of an arm as assembled."""
    tolerance = {"m": 0.0, "rad": 0.0} | dict(zip(sensitivity.units, sensitivity.tolerance.tolist(), strict=True))
    studied = fill(_TEXTS["tolerances"]["studied"], {"tolerance": tolerance})
    yield from _begin(source, studied)
    error = sensitivity.expected_error
    yield from (*_say("tolerances.error", rms=np.sqrt(np.mean(error**2)), least=error.min(), most=error.max()), "")
    table = listing("parameter", "mm per unit", "share")
    for i in np.argsort(-sensitivity.share)[:_MOST_LISTED]:
        scale, unit = SCREEN[sensitivity.units[i]]
        table.add_row(
            sensitivity.names[i],
            f"{1e3 * sensitivity.per_unit[i] / scale:.3g} /{unit}",
            f"{100 * sensitivity.share[i]:.1f} %",
        )
    yield table
    yield from _say("tolerances.shares", share=sensitivity.share)


# ------------------------------------------------------------------ which poses to record


def design_report(
    plan: Plan | DiscriminationPlan,
    drawn: Candidates,
    disabled: Sequence[tuple[str, str]],
    source: str,
    accuracy: float | None = None,
) -> Iterator[RenderableType]:
    """Which poses were chosen among candidates, and what they are worth.

    Pairs of links that are `disabled` are not checked against each other. `accuracy` is a target in m.
    """
    sensor = described(plan.experiment.sensor)
    yield from _begin(source, sentences.design_studied(plan, drawn, sensor), disabled)
    yield from plan_report(plan, accuracy) if isinstance(plan, Plan) else discrimination_report(plan)
    approached = any(driver.discrete for effect in plan.experiment.physics.effects for driver in effect.drivers)
    yield ""
    if approached:
        yield "For effects of the direction of motion, come to each pose from where all joints are at zero."
    yield from _say("design.chosen", found=plan)


def places_report(experiment: Experiment, joint_position: np.ndarray) -> Iterator[RenderableType]:
    """Where the places of touches are, in the base's frame, and how many poses `(pose, joint)` touch each."""
    sensor = experiment.sensor
    if not (isinstance(sensor, PointSensor) and sensor.touched):
        return
    counts = np.bincount(read_places(experiment, joint_position), minlength=len(sensor.names))
    rows = (
        (name, *(f"{1e3 * part:.0f}" for part in at), str(count))
        for name, at, count in zip(sensor.names, sensor.at.T, counts, strict=True)
    )
    yield from ("", "Put them within some centimetres of these places (mm in the arm's base frame)", "")
    yield listing("", "x", "y", "z", "touches", rows=rows)


def plan_report(plan: Plan, accuracy: float | None = None) -> Iterator[RenderableType]:
    """What designed poses are worth, beside random ones; `accuracy` as of `design_report`."""
    reached = plan.accuracy[-1]
    random = np.quantile(plan.random_accuracy[:, plan.count - 1], 0.5, method="nearest")
    tried = max(plan.count, min(MOST_POSES, plan.candidates))
    yield from sentences.worth_of_poses(plan, float(reached), float(random), accuracy, tried)
    yield ""
    if np.isfinite(reached):
        table = listing("best of these", "designed", "random", "ratio")
        table.columns[0].justify = "right"
        # a few numbers of poses, from a third more than the least that determine all parameters
        determined = int(np.flatnonzero(np.isfinite(plan.accuracy))[0]) + 1
        fewest_poses = min(-(-4 * determined // 3), plan.count)
        for n in sorted({int(n) for n in np.geomspace(fewest_poses, plan.count, 6).round()}):
            designed = plan.accuracy[n - 1]
            drawn = plan.random_median[n - 1]
            cells = [f"±{number(1e3 * value)} mm" if np.isfinite(value) else "–" for value in (designed, drawn)]
            ratio = "–"
            if np.isfinite(designed) and np.isfinite(drawn):
                ratio = f"{drawn / designed:.2f}"
            table.add_row(str(n), *cells, ratio)
        yield table


def discrimination_report(plan: DiscriminationPlan) -> Iterator[RenderableType]:
    """How far apart two effects are at designed poses, and at random ones."""
    random = float(np.median(np.nan_to_num(plan.random_distance)))
    yield from sentences.rivals_apart(plan, plan.distance[-1], random)


# ------------------------------------------------------------------ what motions determine


def _torque_noise(model: TorqueExperiment) -> str:
    """The noise of an arm's torques in a phrase."""
    noise = model.noise.tolist()
    units = torque_units(model.arm.sliding, model.arm.dof)
    uniform = len(set(zip(noise, units, strict=True))) == 1
    amounts = each_with_unit(*((noise[:1], units[:1]) if uniform else (noise, units)))
    return f"torques to ±{amounts} (one standard deviation, white)"


def _rank(identification: TorqueIdentification) -> str:
    base = identification.model.base
    links = sum(item.name.startswith("link") for item in base)
    rank = int(identification.determined.sum())
    return sentences.rank_of_motion(rank, links, len(base) - links, identification.model.inertial)


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


def torque_identification_report(
    identification: TorqueIdentification, source: str, motion: str
) -> Iterator[RenderableType]:
    """What a motion determines: the rank, base parameters in words, friction, what is not determined and why."""
    model = identification.model
    arm = identification.model.arm
    narrow = identification.narrow()
    deviations = {item.name: "not" for item in model.base}
    deviations |= {name: plus_minus(deviation) for name, deviation in identification.deviations.items()}
    yield from _begin(source, f"{arm.name}, {motion}; {_torque_noise(model)}.")
    yield _rank(identification)
    missed = [name for name, deviation in deviations.items() if deviation == "not"]
    none_moves = len(narrow) == arm.dof
    yield from sentences.missed_by_motion(identification, missed, _name_narrow(arm, narrow), none_moves)
    for name, carriers in model.confounded.items():
        if name.startswith("joint"):
            yield from _say("torques.confounded", name=name, carriers=carriers)
    yield from (*sentences.links_in_combinations(model), "")
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
    kinds = [
        (of_slide, label)
        for of_slide, label in ((False, ""), (True, "of prismatic joints, P: "))
        if of_slide in arm.slides
    ]
    units = "; ".join(
        label + ", ".join(joint_unit(unit, of_slide) for unit in JOINT_UNITS) for of_slide, label in kinds
    )
    yield from (f"Friction and rotors, standard deviations ({units})", "")
    table = listing("joint", *JOINT)
    carried = model.confounded
    for joint, slides in enumerate(arm.slides, 1):
        names = [f"joint{joint} {kind}" for kind in JOINT]
        cells = (f"in {carried[n][0]}" if n in carried else deviations.get(n, "not") for n in names)
        table.add_row(f"J{joint}{' P' * bool(slides)}", *cells)
    yield table
    weak = [item.name for item, is_weak in zip(model.base, identification.weak, strict=True) if is_weak]
    yield from sentences.quality_of_motion(identification, weak)
    yield from screen.notes(map(capital, identification.notes))


# ------------------------------------------------------------------ which motion to make


def torque_plan_report(plan: TorquePlan, disabled: Sequence[tuple[str, str]], source: str) -> Iterator[RenderableType]:
    """What a designed motion determines, beside random ones of the same limits."""
    designed = plan.identification
    random = plan.random
    room = plan.room
    scales, units = joint_units(room.arm.sliding, room.arm.dof)
    limits = []
    for limit, per in ((room.velocity, "/s"), (room.acceleration, "/s²")):
        largest = {unit: max(scales[j] * limit[j] for j in range(room.arm.dof) if units[j] == unit) for unit in units}
        limits += [f"{largest[unit]:.4g} {unit}{per}" for unit in ("deg", "mm") if unit in largest]
    facts = {"room": room, "limits": limits, "noise": _torque_noise(designed.model)}
    yield from _begin(source, fill(_TEXTS["motion"]["studied"], facts), disabled)
    yield _rank(designed)
    median, best_random = (of(plan.random_log_determinant) for of in (np.median, np.max))
    gains = {
        name: f"{plan.gain(float(value)):.2f}" if np.isfinite(value) else ""
        for name, value in (("median", median), ("best", best_random))
    }
    yield from (sentences.gain_of_motion(gains["median"], gains["best"], len(random)), "")
    table = listing("", "designed", "random, median", "random, best")
    for name, of, best_of in (
        ("log determinant", lambda identification: identification.log_determinant, np.max),
        ("condition number", lambda identification: identification.condition, np.min),
        ("weakly determined", lambda identification: identification.weak.sum(), np.min),
    ):
        random_values = [of(identification) for identification in random]
        table.add_row(
            name, *(f"{value:.4g}" for value in (of(designed), np.median(random_values), best_of(random_values)))
        )
    yield table
