"""What effects are called, what causes them in the words of a workshop, and what to do about them.

An effect of a user's own has a general remedy. Causes are parts of sentences about `{place}`, such as "joint 2".
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from lite6jax.report.words import joined, ranges

Entry = Mapping[str, Any]


class Remedy(NamedTuple):
    """An effect as a workshop sees it.

    Attributes:
        cause: what is the matter, a clause with `{place}`, with `{source}` where another joint is its source, and with
            `{exerted}` for what a motor exerts.
        action: what to do, in whole sentences.
        of_arm: whether it displaces the arm alike at each visit, so that other joint positions compensate it. What the
            sensor or its clock does is no error of the arm, and where a drift will be is not known.
        of_geometry: whether a new calibration of the geometry contains it.
    """

    cause: str
    action: str
    of_arm: bool = True
    of_geometry: bool = False


_GEAR = "Service the gear; until then compensate."
_DECLARE_LOAD = (
    "Set the payload in the controller. Give its mass in the column payload_kg and its centre as payload_com_m in the "
    "sidecar."
)
_PAYLOAD = Remedy("the payload is not the declared one", _DECLARE_LOAD)
_UPRIGHT = Remedy(
    "the base does not stand upright as declared",
    "Level the base, or set the mounting in the controller and gravity_m_per_s2 in the sidecar.",
)
_FEED = "Add it to the model of the controller's feed-forward."
_FRICTION = "Check the lubrication of the gear if it has grown, and add it to the controller's feed-forward."

OF_POSES: Mapping[str, Remedy] = {
    "joint_offset": Remedy(
        "the zero of {place} is off", "Master the joint (set its zero anew), or recalibrate.", of_geometry=True
    ),
    "joint_scale": Remedy(
        "{place} turns by another angle than its encoder says",
        "Check the gear ratio and the encoder's resolution in the controller; until then compensate.",
    ),
    "joint_compliance": Remedy(
        "{place} gives way to gravity",
        "Each gear yields under load: compensate, with the payload declared (payload_kg). Service the gear if it has "
        "become less stiff.",
    ),
    "joint_harmonic": Remedy(
        "the gear or the encoder of {place} runs out of true",
        "Check that encoder and gear run true; until then compensate.",
    ),
    "joint_backlash": Remedy(
        "{place} has play in its gear", "Service the gear. Until then compensate, and approach poses from one side."
    ),
    "joint_lag": Remedy(
        "{place} is behind what its encoder says while it moves",
        "Measure at rest, or slowly. Check the gains of the servo, and compensate where the arm must move.",
    ),
    "joint_coupling": Remedy(
        "the motion of {source} turns {place} as well",
        "Check cables and gears that the two joints share, and the coupling set in the controller; until then "
        "compensate.",
    ),
    "link_compliance": Remedy(
        "{place} bends under gravity",
        "Check the bolts at both of its ends, and compensate, with the payload declared (payload_kg).",
    ),
    "link_thermal_expansion": Remedy(
        "{place} grows as it warms",
        "Warm the arm up before work, or record temperatures and compensate with them.",
    ),
    "frame_offset": Remedy(
        "the geometry at {place} is not that of the calibration",
        "Look for a collision or an exchanged part, and recalibrate.",
        of_geometry=True,
    ),
    "base_compliance": Remedy(
        "the base tilts under the arm's weight", "Tighten the mount and stiffen the stand; compensate what is left."
    ),
    "base_drift": Remedy(
        "the base drifts",
        "Tighten the mount of the arm and the stand of the sensor; measure the base again before work.",
        of_arm=False,
    ),
    "tool_offset": Remedy(
        "the tool's tip is elsewhere than declared", "Set the tool (TCP) in the controller, and in the sidecar (tool)."
    ),
    "measurement_scale": Remedy(
        "the sensor's lengths are off",
        "Calibrate the sensor: scale bar, air temperature and pressure of a tracker, marker size of a camera.",
        of_arm=False,
    ),
    "time_offset": Remedy(
        "the clocks of poses and joints differ",
        "Synchronise the clocks, or correct the stamps by this offset, and record again.",
        of_arm=False,
    ),
    "payload_error": _PAYLOAD,
    "payload_com": Remedy("the payload's centre of mass is not the declared one", _DECLARE_LOAD),
    "joint_thermal_offset": Remedy(
        "the zero of {place} moves with temperature", "Warm the arm up before work, and compensate with temperatures."
    ),
    "joint_warm_up": Remedy(
        "{place} drifts while it warms up",
        "Warm the arm up for three of these time constants before work, and record temperatures.",
    ),
    "joint_windup": Remedy("{place} winds up against the friction of its gear", _GEAR),
    "axis_wobble": Remedy("the axis of {place} wobbles", "Check the joint's bearing; until then compensate."),
    "tool_compliance": Remedy(
        "the tool gives way to the payload's weight", "Tighten the tool and its flange; compensate what is left."
    ),
    "gravity_direction": _UPRIGHT,
    "sensor_drift": Remedy(
        "the sensor drifts",
        "Let the sensor warm up, check its stand, and measure fixed points again during the recording.",
        of_arm=False,
    ),
    "slide_offset": Remedy(
        "the zero of {place} is off", "Set the slide's zero anew, or recalibrate.", of_geometry=True
    ),
    "slide_scale": Remedy(
        "{place} moves by another length than its encoder says",
        "Check the lead or the scale in the controller, and the scale's temperature; until then compensate.",
    ),
    "slide_compliance": Remedy(
        "{place} gives way to gravity along its axis", "Set the payload, check the screw's preload, and compensate."
    ),
    "slide_backlash": Remedy(
        "{place} has play in its screw, belt or rack",
        "Service the drive. Until then compensate, and approach poses from one side.",
    ),
    "unnamed": Remedy(
        "{place} has an error that no effect of the catalogue names",
        "Inspect what moves there; of a step in time, what slipped, such as a belt or a coupling. Until then "
        "compensate: the model contains it.",
    ),
}
"""By the name of an effect on poses."""

_SENSOR = "Calibrate the sensor, of a camera its lens too, let it warm up, or replace it; the arm needs no correction."
"""Of what no effect of the catalogue names there: joint positions cannot compensate what a sensor shows."""

OF_TORQUES: Mapping[str, Remedy] = {
    "viscous_friction": Remedy("{place} rubs the more the faster it moves", _FRICTION),
    "coulomb_friction": Remedy("{place} rubs whichever way it moves", _FRICTION),
    "stribeck_friction": Remedy("{place} sticks at low speed", _FRICTION),
    "load_friction": Remedy("{place} rubs in proportion to its load", _FRICTION),
    "friction_temperature": Remedy(
        "the friction of {place} changes with temperature", "Warm the arm up before work, and record temperatures."
    ),
    "coupled_friction": Remedy("the motor that turns {place} and {source} together rubs", _FRICTION),
    "torque_offset": Remedy(
        "the {exerted} reading of {place} is off by a constant", "Zero the {exerted} sensor or the current at rest."
    ),
    "torque_scale": Remedy(
        "the {exerted} reading of {place} has another scale",
        "Check the torque constant and the gear ratio (torque_constant_Nm_per_A in the sidecar).",
    ),
    "rotor_inertia": Remedy(
        "the rotor of {place} weighs in", "Declare its inertia in the description of the arm (dynamics)."
    ),
    "joint_spring": Remedy(
        "a cable, a hose or a balancer pulls at {place}", "Look at the dress pack, and declare the spring."
    ),
    "torque_ripple": Remedy("{place} cogs as it moves", _GEAR.replace("compensate", "feed it forward")),
    "link_mass": Remedy(
        "{place} weighs another mass than declared", "Weigh what is mounted there, and declare it (inertial)."
    ),
    "link_com": Remedy(
        "the centre of mass of {place} is not the declared one", "Look at what is mounted there, and declare it."
    ),
    "payload": Remedy("another body hangs on the flange than declared", _DECLARE_LOAD),
    "payload_error": _PAYLOAD,
    "base_tilt": _UPRIGHT,
    "torque_lag": Remedy(
        "the torque of {place} is shown late or early",
        "Look at the filter and the bus of its drive, or correct the stamps of its torque by this lag.",
    ),
    "time_offset": Remedy(
        "the torques are stamped late or early", "Synchronise the clocks, or correct the stamps by this offset."
    ),
    "unnamed": Remedy("{place} has a {exerted} that no effect of the catalogue names", _FEED),
}
"""By the name of an effect on torques."""

_OWN = Remedy("{place} has {effect}", "It is an effect of your own; its model is part of the diagnosis.")
_PLACES = {"links": "the arm"} | {site: f"the {site}" for site in ("clock", "sensor", "base", "tool", "payload")}


def remedy_of(entry: Entry, torques: bool = False) -> Remedy:
    """The remedy of an effect, that of a user's own where neither catalogue has it.

    Args:
        entry: a finding of the document.
        torques: whether it acts on torques.
    """
    found = (OF_TORQUES if torques else OF_POSES).get(entry["effect"], _OWN)
    if not torques:
        if entry["site"] not in ("sensor", "clock"):
            return found
        return found._replace(of_arm=False, action=_SENSOR if entry["effect"] == "unnamed" else found.action)
    exerted, drive = _exerted(entry), "the screw, the belt or the guide"
    action = found.action.replace("the gear ratio", "the lead") if exerted == "force" else found.action
    action = action.replace("the gear", drive) if exerted == "force" else action
    return found._replace(action=action.replace("{exerted}", exerted))


def cause_of(entry: Entry, torques: bool = False) -> str:
    """The cause in the words of a workshop, a clause in small letters: joint 2 gives way to gravity."""
    parameters = entry.get("parameters", {})
    if torques and entry["effect"] == "payload" and "mass_kg" in parameters:
        mass, *center = (parameters[name]["value"] for name in ("mass_kg", "x_m", "y_m", "z_m"))
        at = ", ".join(f"{1e3 * value:.0f}" for value in center)
        return f"{abs(mass):.2g} kg {'more' if mass > 0 else 'less'} than declared hang on the flange, at ({at}) mm"
    source = parameters.get("source_joint", {"value": entry.get("source_joint") or 0})["value"]
    return remedy_of(entry, torques).cause.format(
        place=place_of(entry["site"]) if torques else joined(_places(entry), "or"),
        source=f"joint {source:.0f}" if source else "another joint",
        effect=effect_name(entry["effect"]),
        exerted=_exerted(entry),
    )


def _exerted(entry: Entry) -> str:
    """What the motors exert that a finding acts on: forces of prismatic joints, or torques, which may be both."""
    return "force" if "moves_rms_N" in entry and "moves_rms_Nm" not in entry else "torque"


def _places(entry: Entry) -> list[str]:
    """The place of a finding in words; of an unnamed one also those where it is nearly as likely, the nearest first."""
    near = [rival for rival in distinct_rivals(entry) if rival["status"] not in ("rejected", "found")]
    sites = [entry["site"], *(rival["site"] for rival in near if entry["effect"] == "unnamed")]
    return list(dict.fromkeys(map(place_of, sites)))[:_MOST_PLACES]


def distinct_rivals(finding: Entry) -> list[Entry]:
    """The effects that a finding may be instead, the nearest first.

    What depends on a further driver beside those of the finding, or of a nearer one, is left out: it contains this one.
    """
    rivals = sorted(finding.get("confusable_with", ()), key=lambda rival: rival.get("log_likelihood_gap", 0.0))
    kept, seen = [], [set(drivers_of(finding))] if finding["effect"] == "unnamed" else []
    for rival in rivals:
        if rival["effect"] == "unnamed":
            drivers = set(drivers_of(rival))
            if any(drivers > fewer for fewer in seen):
                continue
            seen.append(drivers)
        kept.append(rival)
    return kept


def place_of(site: str) -> str:
    """A site in words: joint2 is joint 2, base is the base."""
    return _PLACES.get(site) or spaced(site)


def effect_name(effect: str) -> str:
    """The name of an effect in words; friction has those of its discoverers."""
    return effect.replace("_", " ").replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")


# ------------------------------------------------------------------ titles


_SHAPES = {
    "line": "a line",
    "cubic": "a smooth curve",
    "smooth": "a smooth curve",
    "medium": "a curve",
    "fine": "a fine curve",
    "rough": "steps or kinks",
    "wave": "a wave that repeats after a turn",
    "spectrum": "waves of many orders, as of a gear",
    "play": "a hysteresis loop",
}
"""What a nonparametric effect of one driver looks like, by its kernel."""
_MOST_PLACES = 3
"""Where an effect may be, in its cause."""


def effect_title(entry: Entry) -> str:
    """An effect in words, such as "joint harmonic of order 2 at joint1"."""
    site, where = entry["site"], entry.get("where", {})
    if entry["effect"] == "unnamed" and "driver" in entry:
        driver = entry["driver"].removesuffix(f" of {spaced(site)}")
        own = driver != entry["driver"] and " and " not in driver
        of = f"its {driver}" if own else f"the {with_articles(entry['driver'])}"
        return f"unnamed effect at {site}{component(where or entry)} as a function of {of}"
    return f"{effect_name(entry['effect'])}{detail(entry)} at {site}"


def by_site(entries: Iterable[Entry]) -> list[tuple[str, str]]:
    """Names of effects, each with all its sites, those of consecutive numbers as a range: joint1–6."""
    numbers: dict[str, dict[str, list[int]]] = {}
    for entry in entries:
        kind = entry["site"].rstrip("0123456789")
        held = numbers.setdefault(effect_name(entry["effect"]), {}).setdefault(kind, [])
        held += [int(entry["site"].removeprefix(kind))] if entry["site"] != kind else []
    return [
        (name, ", ".join(kind + ", ".join(text for text, _ in ranges(sorted(held))) for kind, held in kinds.items()))
        for name, kinds in numbers.items()
    ]


def detail(entry: Entry) -> str:
    """The order of a harmonic, or its period along a slide, or the source of a coupling, of a finding or a rival."""
    numbers = entry.get("parameters", {})
    order, period, source = (
        numbers[key]["value"] if key in numbers else entry.get(key) for key in ("order", "period_m", "source_joint")
    )
    if period:
        return f" of period {1e3 * period:.4g} mm"
    return f" of order {order:.4g}" if order else f" from joint{source:.0f}" if source else ""


def component(where: Entry) -> str:
    """Along or about which axis an effect acts that is at no joint."""
    at_joint = where.get("where", where.get("site", "joint")).startswith("joint")
    return "" if at_joint or "component" not in where else f" ({where['component']})"


def shape(where: Entry) -> str:
    """What a nonparametric effect looks like; `where` has its fields."""
    two = "a curve in each direction" if "direction of motion" in where["driver"] else "a surface"
    return _SHAPES.get(where.get("kernel", "smooth"), two)


def drivers_of(entry: Entry) -> Sequence[str]:
    """The phrases of what an effect depends on."""
    return [] if entry["driver"] == "none" else entry["driver"].split(" and ")


def with_articles(driver: str) -> str:
    """The phrases of several drivers, an article before each but the first; those of one quantity together."""
    one, _, other = driver.partition(" and ")
    for of in (" of joint ", " of link "):
        (quantity, _, place), (same, _, further) = one.partition(of), other.partition(of)
        if further and quantity == same:
            return f"{quantity}{of.rstrip()}s {place} and {further}"
    return driver.replace(" and ", " and the ")


def spaced(site: str) -> str:
    """A site with a space before its number: joint2 is joint 2."""
    return re.sub(r"(\D)(\d)", r"\1 \2", site)
