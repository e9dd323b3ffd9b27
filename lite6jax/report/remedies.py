"""What effects are called, what causes them, and what to do about them.

Texts of causes and remedies are in `templates/remedies.yaml`; an effect of a user's own has a general remedy.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from lite6jax.deferred import import_lazily
from lite6jax.formatting import joined, ranges, significant
from lite6jax.report.words import fill, read_texts

with import_lazily():  # which imports the domains; a list of effects does without
    from lite6jax.report.sentences import document

Entry = Mapping[str, Any]


class Remedy(NamedTuple):
    """An effect as a workshop sees it.

    Attributes:
        cause: what is the matter, a clause with `{place}`, `{source}` and `{exerted}`.
        action: what to do, in whole sentences.
        of_arm: whether it displaces the arm alike at each visit, so that other joint positions compensate it.
        of_geometry: whether a new calibration of the geometry contains it.
    """

    cause: str
    action: str
    of_arm: bool = True
    of_geometry: bool = False


REMEDIES = {
    domain: {
        effect: Remedy(entry["cause"], entry["action"], "sensor" not in entry, "geometry" in entry)
        for effect, entry in remedies.items()
    }
    for domain, remedies in read_texts("remedies.yaml")["domains"].items()
}
"""By domain and the name of an effect."""

_SENSOR = "Calibrate the sensor, of a camera its lens too, let it warm up, or replace it; the arm needs no correction."
"""Of what no effect of the catalogue names there: joint positions cannot compensate what a sensor shows."""

_OWN = Remedy("{place} has {effect}", "It is an effect of your own; its model is part of the diagnosis.")
_OF_SLIDE, _SHAPES = (read_texts("remedies.yaml")[name] for name in ("slides", "shapes"))
_WANDERING = Remedy(**read_texts("remedies.yaml")["wandering"], of_arm=False)
"""Of what wanders by itself: it is another one at the next visit."""
_PLACES = {"links": "the arm"} | {site: f"the {site}" for site in ("clock", "sensor", "base", "tool", "payload")}


def remedy_of(entry: Entry) -> Remedy:
    """The remedy of a finding with its `domain`, that of a user's own effect where no catalogue has it."""
    if wanders(entry):
        return _WANDERING
    exerted = _exerted(entry)
    remedy = REMEDIES[entry["domain"]].get(entry["effect"], _OWN)
    if entry["site"] in ("sensor", "clock"):
        remedy = remedy._replace(of_arm=False)
        if entry["effect"] == "unnamed":
            remedy = remedy._replace(action=_SENSOR)
    if exerted == "force":
        for of_turn, of_slide in _OF_SLIDE.items():
            remedy = remedy._replace(cause=remedy.cause.replace(of_turn, of_slide))
            remedy = remedy._replace(action=remedy.action.replace(of_turn, of_slide))
    return remedy._replace(action=remedy.action.replace("{exerted}", exerted))


def cause_of(entry: Entry) -> str:
    """The cause in the words of a workshop, a clause in small letters: joint 2 gives way to gravity."""
    parameters = entry.get("parameters", {})
    if entry["effect"] == "payload" and "mass_kg" in parameters:
        mass, *center = (parameters[name]["value"] for name in ("mass_kg", "x_m", "y_m", "z_m"))
        at = ", ".join(f"{1e3 * value:.0f}" for value in center)
        return f"{abs(mass):.2g} kg {'more' if mass > 0 else 'less'} than declared hang on the flange, at ({at}) mm"
    source = parameters.get("source_joint", {"value": entry.get("source_joint") or 0})["value"]
    return remedy_of(entry).cause.format(
        place=joined(_places(entry), "or"),
        source=f"joint {source:.0f}" if source else "another joint",
        effect=effect_name(entry["effect"]),
        exerted=_exerted(entry),
    )


def _exerted(entry: Entry) -> str:
    """What the motors exert that a finding acts on: forces of prismatic joints, or torques, which may be both."""
    in_metres = any(name.endswith(("_m", "_m_per_N")) for name in entry.get("parameters", ()))
    if entry["effect"].startswith("joint_") and (in_metres or "slide position" in str(entry.get("driver"))):
        return "force"
    if "moves_rms_N" in entry and "moves_rms_Nm" not in entry:
        return "force"
    return "torque"


def _places(entry: Entry) -> list[str]:
    """The place of a finding in words; of an unnamed one also those where it is nearly as likely, the nearest first."""
    near = []
    if entry["effect"] == "unnamed":
        rivals = distinct_rivals(entry)
        near = [rival["site"] for rival in rivals if rival["status"] not in ("rejected", "found")]
    sites = document.words_of(entry).places(entry["site"], near)
    return list(dict.fromkeys(map(place_of, sites)))[:_MOST_PLACES]


def alternatives_of(finding: Entry) -> list[Entry]:
    """The effects and the faults of the data that a finding may be instead, the nearest first."""
    return sorted(
        finding.get("confusable_with", ()), key=lambda alternative: alternative.get("log_likelihood_gap", 0.0)
    )


def distinct_rivals(finding: Entry) -> list[Entry]:
    """The effects that a finding may be instead, the nearest first; faults of the data are none.

    What depends on a further driver beside those of the finding, or of a nearer one, is left out: it contains this one.
    """
    rivals = [alternative for alternative in alternatives_of(finding) if "fault" not in alternative]
    distinct = []
    driver_sets = []
    if finding["effect"] == "unnamed" and not wanders(finding):
        driver_sets = [set(drivers_of(finding))]
    for rival in rivals:
        if rival["effect"] == "unnamed" and not wanders(rival):
            drivers = set(drivers_of(rival))
            if any(drivers > fewer for fewer in driver_sets):
                continue
            driver_sets.append(drivers)
        distinct.append(rival)
    return distinct


def wanders(entry: Entry) -> bool:
    """Tells whether an effect is one that nothing recorded drives."""
    return entry["effect"] == "unnamed" and entry.get("driver") == "none"


def place_of(site: str) -> str:
    """A site in words: joint2 is joint 2, base is the base."""
    return _PLACES.get(site) or spaced(site)


def effect_name(effect: str) -> str:
    """The name of an effect in words; friction has those of its discoverers."""
    return effect.replace("_", " ").replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")


# ------------------------------------------------------------------ titles


_MOST_PLACES = 3
"""The most places that a cause lists."""


def effect_title(entry: Entry) -> str:
    """An effect in words, such as "joint harmonic of order 2 at joint1"."""
    site = entry["site"]
    where = entry.get("where", {})
    if wanders(entry):
        if site.startswith("joint"):
            return f"a read-out of {site} that wanders by itself{_memory(entry)}"
        return f"unnamed effect at {site}{component(where or entry)} that wanders by itself{_memory(entry)}"
    if entry["effect"] == "unnamed" and "driver" in entry:
        driver = entry["driver"].removesuffix(f" of {spaced(site)}")
        at_site = driver != entry["driver"] and " and " not in driver
        of = f"its {driver}" if at_site else f"the {with_articles(entry['driver'])}"
        return f"unnamed effect at {site}{component(where or entry)} as a function of {of}"
    further = "".join(f" with another{detail(other)}" for other in entry.get("together_with", ()))
    return f"{effect_name(entry['effect'])}{detail(entry)}{further} at {site}"


def _memory(entry: Entry) -> str:
    """For how long what wanders remembers, where that is known."""
    memory = entry.get("wanders")
    if memory is None:
        return ""
    if memory["memory_s"] is not None:
        return f" with a memory of {significant(memory['memory_s'], 2)} s"
    return f" with a memory of {significant(memory['memory_samples'], 2)} rows"


def by_site(entries: Iterable[Entry]) -> list[tuple[str, str]]:
    """Names of effects, each with all its sites, those of consecutive numbers as a range: joint1–6."""
    numbers: dict[str, dict[str, list[int]]] = {}
    for entry in entries:
        kind = entry["site"].rstrip("0123456789")
        indices = numbers.setdefault(effect_name(entry["effect"]), {}).setdefault(kind, [])
        indices += [int(entry["site"].removeprefix(kind))] if entry["site"] != kind else []
    return [
        (
            name,
            ", ".join(kind + ", ".join(text for text, _ in ranges(sorted(indices))) for kind, indices in kinds.items()),
        )
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
    if order:
        return f" of order {order:.4g}"
    return f" from joint{source:.0f}" if source else ""


def component(where: Entry) -> str:
    """Along or about which axis an effect acts that is at no joint; of a joint whether its command or its read-out."""
    at_joint = where.get("where", where.get("site", "joint")).startswith("joint")
    if "component" not in where or (at_joint and where["component"] == "rz"):
        return ""
    return f" ({where['component']})"


def shape(where: Entry) -> str:
    """What a nonparametric effect looks like; `where` has its fields."""
    usual = "a surface" if " and " in where["driver"] else "a curve"
    if "direction of motion" in where["driver"]:
        usual = "a curve in each direction"
    text = _SHAPES.get(where.get("kernel", "smooth"), usual)
    rolloff = where.get("rolloff")
    if "{{" in text and rolloff:
        return fill(text, {"order": f"{rolloff[0]:.4g}", "period": f"{2 * math.pi / rolloff[0]:.3g}"})
    return text


def drivers_of(entry: Entry) -> Sequence[str]:
    """The phrases of what an effect depends on."""
    if entry["driver"] == "none":
        return []
    return entry["driver"].split(" and ")


def with_articles(driver: str) -> str:
    """The phrases of several drivers, an article before each but the first; those of one quantity together."""
    first, _, second = driver.partition(" and ")
    for of in (" of joint ", " of link "):
        quantity, _, place = first.partition(of)
        second_quantity, _, further = second.partition(of)
        if further and quantity == second_quantity:
            return f"{quantity}{of.rstrip()}s {place} and {further}"
    return driver.replace(" and ", " and the ")


def spaced(site: str) -> str:
    """A site with a space before its number: joint2 is joint 2."""
    return re.sub(r"(\D)(\d)", r"\1 \2", site)
