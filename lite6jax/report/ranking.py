"""What effects are called and what to do about them; what a diagnosis is worth, and the commands that follow.

Texts of causes and remedies are in `templates/remedies.yaml`; an effect of a user's own has a general remedy.
Contributions are in mm, degrees, Nm or N.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lite6jax.errors import command_line
from lite6jax.recordings.files import SUFFIXES
from lite6jax.report.faults import fault_name
from lite6jax.report.texts import fill, read_texts
from lite6jax.report.words import capital, joined, plus_minus, ranges, torque_units

Document = Mapping[str, Any]
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


OF_POSES, OF_TORQUES = (
    {
        effect: Remedy(one["cause"], one["action"], "sensor" not in one, "geometry" in one)
        for effect, one in remedies.items()
    }
    for remedies in read_texts("remedies.yaml").values()
)
"""By the name of an effect on poses, and of one on torques."""

_SENSOR = "Calibrate the sensor, of a camera its lens too, let it warm up, or replace it; the arm needs no correction."
"""Of what no effect of the catalogue names there: joint positions cannot compensate what a sensor shows."""

_OWN = Remedy("{place} has {effect}", "It is an effect of your own; its model is part of the diagnosis.")
_OF_SLIDE = {
    "the gear ratio": "the lead",
    "the gear": "the screw, the belt or the guide",
    "its gear": "its screw, belt or rack",
    "turns by another angle": "moves by another length",
}
"""What is said of a prismatic joint in place of what is said of a revolute one."""
_PLACES = {"links": "the arm"} | {site: f"the {site}" for site in ("clock", "sensor", "base", "tool", "payload")}


def remedy_of(entry: Entry, torques: bool = False) -> Remedy:
    """The remedy of a finding of the document, that of a user's own effect where neither catalogue has it."""
    found, exerted = (OF_TORQUES if torques else OF_POSES).get(entry["effect"], _OWN), _exerted(entry)
    if not torques and entry["site"] in ("sensor", "clock"):
        return found._replace(of_arm=False, action=_SENSOR if entry["effect"] == "unnamed" else found.action)
    if exerted == "force":
        for of_turn, of_slide in _OF_SLIDE.items():
            found = found._replace(cause=found.cause.replace(of_turn, of_slide))
            found = found._replace(action=found.action.replace(of_turn, of_slide))
    return found._replace(action=found.action.replace("{exerted}", exerted))


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
    in_metres = any(name.endswith(("_m", "_m_per_N")) for name in entry.get("parameters", ()))
    if entry["effect"].startswith("joint_") and (in_metres or "slide position" in str(entry.get("driver"))):
        return "force"
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


_SHARE = 0.1
"""Of the error of positions, below which all findings concern orientations."""
_NEARLY = 0.05
"""Family-wise p-value below which an effect that is no finding is said to be nearly significant."""


# ------------------------------------------------------------------ what a document is of


def of_torques(document: Document) -> bool:
    """Whether a document is of torques."""
    return document.get("domain") == "torque"


def sliding(document: Document) -> tuple[int, ...]:
    """The prismatic joints of the diagnosed arm, counted from 0."""
    return tuple(joint - 1 for joint in document["model"].get("prismatic_joints", ()))


def units(document: Document) -> tuple[str, ...]:
    """Of each joint of a document of torques: Nm, or N of a prismatic one."""
    return torque_units(sliding(document), len(document["model"]["kinematics"]))


def is_computed(document: Document) -> bool:
    """Whether no sensor measured the poses: the controller computed them from the joints."""
    found = any(fault["fault"] == "computed_pose" for fault in document["data_faults"])
    return found or document.get("pose_source") == "controller_fk"


def is_nearly_significant(nearest: Entry | None) -> bool:
    """Whether the nearest effect that is no finding leaves a verdict open; documents do not hold the thresholds."""
    return nearest is not None and nearest["p_value"] < _NEARLY


# ------------------------------------------------------------------ contributions


class Measure(NamedTuple):
    """In what findings are ranked: the keys of what one moves and of the RMS error, and how sizes are shown.

    `scale` leads from SI units to `unit`; `what` is moved.
    """

    moves: str
    error: str
    scale: float
    unit: str
    what: str

    def size_of(self, value: float) -> str:
        """A value in SI units as it is shown, in two digits."""
        return f"{plus_minus(self.scale * value)} {self.unit}"


POSITION = Measure("moves_rms_m", "heldout_position_rms_m", 1e3, "mm", "the measured point")
ORIENTATION = Measure("moves_rms_rad", "heldout_orientation_rms_rad", 180 / np.pi, "deg", "the measured orientation")
TORQUE = Measure("moves_rms_Nm", "heldout_torque_rms_Nm", 1.0, "Nm", "the torque")
FORCE = Measure("moves_rms_N", "heldout_torque_rms_N", 1.0, "N", "the force")
"""Of prismatic joints."""


class Bar(NamedTuple):
    """The contribution of a finding in a chart: its share of the largest, and its size in two digits."""

    share: float
    size: str


def measures_of(document: Document) -> tuple[Measure, ...]:
    """Millimetres; degrees where no finding moves the measured point, but one turns it; newton metres of torques.

    Of an arm that has prismatic joints also newtons, or these alone.
    """
    if of_torques(document):
        return tuple(measure for measure in (TORQUE, FORCE) if measure.error in document["before"]) or (TORQUE,)
    moved, turned = (
        max((_share(document, finding, measure) for finding in document["findings"]), default=0.0)
        for measure in (POSITION, ORIENTATION)
    )
    return (ORIENTATION,) if moved < _SHARE < turned else (POSITION,)


def unit_of(document: Document) -> str:
    """The unit of all contributions; empty where they have several, and each says its own."""
    measures = measures_of(document)
    return measures[0].unit if len(measures) == 1 else ""


def order(document: Document) -> list[int]:
    """Places of the findings, from 0, the largest share of the error before first."""
    findings = document["findings"]
    return sorted(range(len(findings)), key=lambda k: -_share(document, findings[k], _main(document, findings[k])))


def bars(document: Document) -> list[Bar]:
    """The contribution of each finding in this order."""
    ranked, alone = [document["findings"][k] for k in order(document)], unit_of(document)
    shares = [_share(document, finding, _main(document, finding)) for finding in ranked]
    return [
        Bar(share / (shares[0] or 1.0), contribution(document, finding).removesuffix(f" {alone}"))
        for share, finding in zip(shares, ranked, strict=True)
    ]


def contribution(document: Document, finding: Entry) -> str:
    """What a finding moves, with its unit: 0.21 mm, or 0.8 Nm and 12 N."""
    pairs = [(measure, finding.get(measure.moves)) for measure in measures_of(document)]
    return " and ".join(measure.size_of(moved) for measure, moved in pairs if moved is not None)


def _share(document: Document, finding: Entry, measure: Measure) -> float:
    """What a finding moves, over the error before; over the unit where there was no error."""
    return (finding.get(measure.moves) or 0.0) / (document["before"].get(measure.error) or 1.0)


def _main(document: Document, finding: Entry) -> Measure:
    """In what a finding moves most."""
    return max(measures_of(document), key=lambda measure: _share(document, finding, measure))


# ------------------------------------------------------------------ the first sentence


def headline(document: Document) -> str:
    """The cause in the words of a workshop and its worth, in one sentence; what there is instead where none is."""
    findings, torques, texts = document["findings"], of_torques(document), read_texts("diagnosis.yaml")
    more: dict[str, Any] = {"torques": torques, "sensor": "sensors'" if torques else "sensor's"}
    if findings:
        main = findings[order(document)[0]]
        measure = _main(document, main)
        before, after = (_error_at(document[stage], document, measure, main) for stage in ("before", "after"))
        return fill(
            texts["headline"],
            {
                **more,
                "findings": findings,
                "verdict": document["verdict"],
                "cause": cause_of(main, torques),
                "moved": plus_minus(measure.scale * main[measure.moves]),
                "more": measure.scale * main[measure.moves] > before,
                "before": plus_minus(before),
                "after": plus_minus(after),
                "unit": measure.unit,
                "of_arm": not torques and all(remedy_of(finding).of_arm for finding in findings),
            },
        )
    sizes = (measure.size_of(document["before"][measure.error]) for measure in measures_of(document))
    said = fill(
        texts["nothing_found"],
        document,
        **more,
        error=f"{' and '.join(sizes)} RMS",
        computed=not torques and is_computed(document),
        declared=document["noise"]["declared_torque_Nm" if torques else "declared_position_m"] is not None,
        near=is_nearly_significant(document["nearest"]),
    )
    faults = [fault for fault in document["data_faults"] if fault["fault"] not in ("outliers", "computed_pose")]
    if not faults:
        return capital(said)
    names = list(dict.fromkeys(fault_name(fault["fault"]).lower() for fault in faults))
    have = "a fault" if len(names) == 1 else f"{len(names)} faults"
    these = "this" if len(faults) == 1 else "these"
    return f"The data have {have} ({', '.join(names)}); with {these} corrected, {said}"


def _error_at(errors: Entry, document: Document, measure: Measure, finding: Entry) -> float:
    """The root mean square of held-out errors in the unit shown; of torques at the joints that a finding acts on."""
    joints = [joint for joint in finding.get("joints", ()) if (joint - 1 in sliding(document)) == (measure is FORCE)]
    if measure not in (TORQUE, FORCE) or not joints:
        return measure.scale * errors[measure.error]
    by_joint = np.array(errors["heldout_torque_rms_by_joint_Nm"])[np.array(joints) - 1]
    return float(np.sqrt(np.mean(by_joint**2)))


# ------------------------------------------------------------------ what to do


class Files(NamedTuple):
    """The files of a diagnosis as named on the command line: recording, JSON file, and effects of the user's own."""

    recording: Path
    diagnosis: Path | None = None
    effects: Path | None = None


class Step(NamedTuple):
    """A command to copy: its purpose, a phrase, and the line."""

    purpose: str
    command: str


def actions(document: Document) -> list[tuple[list[int], str]]:
    """What to do, each once, with the ranks of the findings that it is for."""
    ranks: dict[str, list[int]] = {}
    for rank, k in enumerate(order(document), 1):
        ranks.setdefault(remedy_of(document["findings"][k], of_torques(document)).action, []).append(rank)
    return [(held, action) for action, held in ranks.items()]


def steps(document: Document, files: Files) -> list[Step]:
    """Commands on these files, which write beside the diagnosis; where that was not written, the first one does."""
    recording, findings, torques = files.recording, document["findings"], of_torques(document)
    named = files.diagnosis or Path(f"{recording.stem}_diagnosis.json")
    own = ["--effects", str(files.effects)] if files.effects is not None else []
    known, table = _known(document, own), recording.suffix.lower() in (".csv", ".parquet")
    beside = lambda end: named.with_name(f"{recording.stem}_{end}")  # noqa: E731
    play = any(finding["effect"] == "joint_backlash" for finding in findings)
    side = ["--approach", "1"] if play else []
    shown = [] if recording.parent in (named.parent, Path()) else [recording]  # where `view` finds it
    compensated = not torques and known and table and any(remedy_of(finding).of_arm for finding in findings)
    geometry = not torques and any(remedy_of(finding).of_geometry for finding in findings)
    offered: list[tuple[bool, str, list[Any]]] = [
        (files.diagnosis is None, "keep this diagnosis", ["diagnose", recording, *own, "--out", named]),
        (
            torques and bool(findings) and known and table,
            "torques of this motion, for a feed-forward; give a motion of your own in its place",
            ["predict", named, recording, *own, "--out", beside("predicted.csv")],
        ),
        (
            torques and bool(findings) and known,
            "the arm with what was found, for a simulator",
            ["convert", named, beside("arm.urdf"), *own],
        ),
        (
            compensated,
            "joint positions that reach these poses; give a table of your own targets in their place",
            ["compensate", named, recording, *side, *own, "--out", beside("compensated.csv")],
        ),
        (geometry, "recalibrate", ["fit", recording, "--geometry", "free", "--out", beside("table.json")]),
        (
            known and recording.suffix.lower() in SUFFIXES,
            "the arm and its errors in the browser",
            ["view", named, *shown, *own],
        ),
        (True, "a certificate, one page", ["report", named, "--certificate", named.with_suffix(".pdf")]),
    ]
    return [Step(purpose, command_line(*line)) for wanted, purpose, line in offered if wanted]


def _known(document: Document, own: Sequence[str]) -> bool:
    """Whether the model can be read, which effects of the user's own take their file for."""
    # a look at a table, which has next steps too, takes no effects
    from lite6jax.effects.catalogue import POSE_EFFECTS
    from lite6jax.effects.catalogue import TORQUE_EFFECTS as OF_TORQUES

    known = OF_TORQUES if of_torques(document) else POSE_EFFECTS
    return bool(own) or all(finding["effect"] in known for finding in document["findings"])
