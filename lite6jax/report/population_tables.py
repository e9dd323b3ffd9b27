"""What is printed of a fleet: effects of the type, arms that differ, drifts, and recordings that were not pooled."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from lite6jax.report.cells import listing, number
from lite6jax.report.quantities import Quantity, quantity

_FOUND_BY = {
    "mean": "by the mean over all recordings",
    "any": "by the sum of what each recording shows",
    "drift": "by its change with the date",
    "one": "in one recording alone",
}
_DAYS = 365.25
"""In a year: what an arm loses in a day has no digit on the screen."""
_CHANCE = 0.05
"""Family-wise p-value from which a change is not significant."""


def population_report(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    """The screen report of a fleet's document."""
    members, effects = document["recordings"], document["effects"]
    pooled = [member for member in members if member["used"]]
    over = document["over"] is not None
    what = f"recordings of one {document['arm']}" if over else f"recordings of {document['arm']} arms"
    yield Text(f"{len(pooled)} {what} were pooled.")
    yield Text(headline(document))
    for k, effect in enumerate(effects, 1):
        yield ""
        yield Text(f"{k}. {title(effect)}: p = {effect['p_value']:.1e}, found {_FOUND_BY[effect['found_by']]}.")
        if effect["effect"] != "unnamed":  # coefficients of splines say nothing to a reader
            yield Padding(_parameters(effect), (0, 0, 0, 3))
        for line in remarks(effect, over):
            yield Padding(Text(line), (0, 0, 0, 3))
    own = {f"{effect['effect']}:{effect['site']}" for effect in effects}
    alone = {
        member["file"]: [one["label"] for one in member["found_alone"] if one["label"] not in own] for member in pooled
    }
    if any(alone.values()):
        yield ""
        yield Text("Found in one recording and not in the type:")
        for file, labels in alone.items():
            if labels:
                yield Padding(Text(f"{file}: {', '.join(labels)}"), (0, 0, 0, 2))
    left = [member for member in members if not member["used"]]
    if left:
        yield ""
        yield Text(f"{_count(len(left), 'recording')} of {len(members)} not pooled:")
        for member in left:
            reason = member["reason"]
            line = reason if member["file"] in reason else f"{member['file']}: {reason}"
            yield Padding(Text(line), (0, 0, 0, 2))
    yield ""


def headline(document: Mapping[str, Any]) -> str:
    """What the fleet shows, in a sentence or two."""
    effects = document["effects"]
    if not effects:
        return "No effect is significant over all recordings, and none in one that the others could be compared with."
    outlying = sorted({file for effect in effects for file in _outliers(effect)})
    said = f"{_count(len(effects), 'effect')} found."
    if outlying:
        said += f" {', '.join(outlying)} {'differs' if len(outlying) == 1 else 'differ'} from the others."
    drifting = [effect for effect in effects if _drifts(effect, document["level"])]
    if drifting:
        said += f" {'; '.join(title(effect) for effect in drifting)}: drifts with the date."
    return said


def title(effect: Mapping[str, Any]) -> str:
    """An effect with its site, and its order or source."""
    if effect["effect"] == "unnamed":
        return f"a function of {effect['driver']} without a name, {effect['site']}"
    name = effect["effect"].replace("_", " ")
    if "order" in effect:
        name += f" of order {effect['order']:g}"
    if "source_joint" in effect:
        name += f" to joint {effect['source_joint']}"
    return f"{name}, {effect['site']}"


def remarks(effect: Mapping[str, Any], over: bool) -> Iterator[str]:
    """What is said of an effect below its numbers."""
    if effect["effect"] == "unnamed":
        yield f"No effect of the catalogue describes it{_nearest(effect)}."
        if "curve" in effect:
            mean = effect["curve"]["mean"]
            size = {"value": max(mean) - min(mean), "std": 0.0}
            yield f"The range of its mean: {_shown(effect['curve']['name'], size)}."
    for name in ("amplitude_rms_rad", "amplitude_rms_Nm"):
        if name in effect:
            size = {"value": effect[name], "std": 0.0}
            yield f"Root mean square of its amplitude over the arms: {_shown(name, size)}."
    recordings = "recordings" if over else "arms"
    if effect["between_p_value"] < 0.01:
        p = effect["between_p_value"]
        yield f"The {recordings} differ from each other by more than their uncertainty (p = {p:.1e})."
    for arm in effect["arms"]:
        if arm["outlier_p_value"] is not None:
            own = ", ".join(str(quantity(name, each)) for name, each in arm["parameters"].items())
            said = "" if effect["effect"] == "unnamed" else f": {own}"
            yield f"{arm['file']} differs from the others (p = {arm['outlier_p_value']:.1e}){said}."
    if "drift" in effect and effect["effect"] == "unnamed":
        yield f"Its change with the date: {_chance(effect['drift']['p_value'])}."
    elif "drift" in effect:
        drift = effect["drift"]
        for name, each in drift["per_day"].items():
            low, high = (_of_a_year(name, each, bound) for bound in each["interval_95"])
            shown = _of_a_year(name, each, each["value"])
            yield (
                f"Drift of {shown.name} in a year: {shown.value} {shown.unit}, 95 % interval {low.value} to"
                f" {high.value} ({_chance(drift['p_value'])})."
            )
    near = [rival for rival in effect["rivals"] if rival["log_likelihood_gap"] < 6.0]
    if near:
        yield f"Not distinguished from {', '.join(title(rival) for rival in near)}."


def _chance(p: float) -> str:
    """A p-value; one that is no sign of anything is not printed."""
    return f"p = {p:.1e}" if p < _CHANCE else "not significant"


def _nearest(effect: Mapping[str, Any]) -> str:
    nearest = effect.get("nearest")
    return "" if nearest is None else f"; the nearest, {title(nearest)}, explains {100 * nearest['share']:.0f} % of it"


def _parameters(effect: Mapping[str, Any]) -> RenderableType:
    table = listing("", "mean", "95 % interval", "between arms", "unit")
    for name, each in effect["parameters"].items():
        mean = quantity(name, {"value": each["mean"], "std": each["std"]})
        low, high = (quantity(name, {"value": v, "std": each["std"]}).value for v in each["interval_95"])
        between = quantity(name, {"value": each["between_std"], "std": each["std"]}).value
        table.add_row(mean.name, mean.value, f"{low} to {high}", between, mean.unit)
    return table


def _of_a_year(name: str, estimate: Mapping[str, float], value: float) -> Quantity:
    return quantity(name, {"value": _DAYS * value, "std": _DAYS * estimate["std"]})


def _shown(name: str, estimate: Mapping[str, float]) -> str:
    found = quantity(name, estimate)
    return f"{number(float(found.value))} {found.unit}"


def _drifts(effect: Mapping[str, Any], level: float) -> bool:
    return "drift" in effect and effect["drift"]["p_value"] < level


def _outliers(effect: Mapping[str, Any]) -> Sequence[str]:
    return [arm["file"] for arm in effect["arms"] if arm["outlier_p_value"] is not None]


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
