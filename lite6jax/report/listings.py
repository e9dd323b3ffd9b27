"""Lists of what there is: effects, arms, the files of a folder, and what the recordings of a fleet have in common.

Nothing here takes JAX.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from lite6jax.arms.arm import Arm
from lite6jax.arms.description import VARIANTS, maker_of
from lite6jax.arms.files import Conversion
from lite6jax.calibration.quality import Result
from lite6jax.estimation.thresholds import CLOSE
from lite6jax.fleet import FLEET
from lite6jax.fleet.diagnoses import DIAGNOSED
from lite6jax.fleet.folder import has_failed
from lite6jax.formatting import capital, chance, counted, number, quantity
from lite6jax.report.remedies import effect_title
from lite6jax.report.screen import headed, indented
from lite6jax.report.sentences import listings as sentences
from lite6jax.report.words import listing, read_texts, say

if TYPE_CHECKING:
    from lite6jax.effects.catalogue import Listed  # which takes a second, and which arms do not need

Document = Mapping[str, Any]
_TEXTS = read_texts("screens.yaml")

# ------------------------------------------------------------------ effects and arms


def effects_report(effects: "Sequence[Listed]") -> Iterator[RenderableType]:
    """The effects by domain, a paragraph each."""
    texts = _TEXTS["effects"]
    domains = {effect.domain for effect in effects}
    for domain, title in texts["domains"].items():
        listed = [effect for effect in effects if effect.domain == domain]
        if listed:
            yield from (title, "")
            for effect in listed:
                yield effect.name
                yield from map(indented, sentences.listed_effect(effect))
            yield ""
    yield from sentences.units_of_effects(domains)


def prior_report(entries: Document) -> Iterator[RenderableType]:
    """The prior probabilities of explanations, as `Prior.entries`."""
    rows = (
        (name, f"{entry['probability']:.3g}", f"{entry['cost']:.1f}", f"{entry['meaning']} ({entry['why']})")
        for name, entry in entries.items()
    )
    yield listing("explanation", "probability", "cost (nats)", "of what", rows=rows, left=[3], wrapped=[3])
    yield from ("", *say(_TEXTS["effects"]["prior"], {}))


class ArmEntry(NamedTuple):
    """A bundled arm as it is listed: reach in m, an upper bound; where its numbers are from."""

    name: str
    maker: str
    joints: int
    reach_m: float
    inertia: bool
    source: str


def arm_entry(arm: Arm) -> ArmEntry:
    """What is listed of an arm."""
    return ArmEntry(arm.name, maker_of(arm.name), arm.dof, round(arm.reach, 4), arm.inertia is not None, arm.source)


def joint_entries(arm: Arm) -> list[dict[str, Any]]:
    """What is listed of each joint of an arm: name, kind, and limits in rad or m."""
    names = arm.joint_names or tuple(f"joint{i + 1}" for i in range(arm.dof))
    kinds = ["prismatic" if slides else "revolute" for slides in arm.slides]
    rows = zip(names, kinds, arm.joint_limits.tolist(), arm.joint_units, strict=True)
    return [{"name": name, "kind": kind, "limits": limits, "unit": unit} for name, kind, limits, unit in rows]


def arm_report(arm: Arm) -> Iterator[RenderableType]:
    """One arm as it is read: where its chain begins and ends, and its joints in order."""
    yield from (*sentences.arm_read(arm), "")
    table = listing("", "joint", "kind", "lower", "upper", "unit", left=[1, 2, 5])
    for i, joint in enumerate(joint_entries(arm)):
        scale, unit = (1e3, "mm") if joint["unit"] == "m" else (math.degrees(1.0), "deg")
        lower, upper = (f"{scale * limit:.1f}" for limit in joint["limits"])
        table.add_row(f"q{i + 1}", Text(joint["name"]), joint["kind"], lower, upper, unit)
    yield table


def arms_report(arms: Sequence[ArmEntry], width: int) -> Iterator[RenderableType]:
    """The bundled arms, and below the table where their numbers are from."""
    if width < 60:
        for arm in arms:
            sizes = sentences.bundled_arm(arm.maker, arm.joints, arm.reach_m, arm.inertia)
            yield from (arm.name, indented(sizes), indented(arm.source))
        return
    rows = (
        (arm.name, arm.maker, str(arm.joints), f"{1e3 * arm.reach_m:.0f}", "yes" if arm.inertia else "no")
        for arm in arms
    )
    yield listing("arm", "maker", "joints", "reach (mm)", "inertia", rows=rows, left=[1, 4])
    variants = [arm.name for arm in arms if arm.name in VARIANTS]
    yield from ("", *sentences.table_of_arms(variants), "", "Sources")
    yield from (indented(f"{arm.name}: {arm.source}") for arm in arms)


def conversion_report(done: Conversion) -> Iterator[RenderableType]:
    """The largest change of the flange position by a conversion, and the parts that it omits."""
    yield from sentences.converted(done)


# ------------------------------------------------------------------ folders


_ERRORS = (("verdict", "position_rms_m", 1e3), ("torque_verdict", "torque_rms_Nm", 1.0))
"""The columns of a verdict and of errors before and after, and the factor to their unit on the screen."""


def folder_report(rows: Iterable[Document]) -> Iterator[RenderableType]:
    """Position errors by type of arm, and a line for each file without a usable fit; rows are looked at once."""
    groups: dict[tuple[str, str], list[tuple[bool, float, float]]] = {}
    bad = list[str]()
    count = 0
    for count, row in enumerate(rows, 1):  # noqa: B007 (their number)
        if row["arm"]:
            errors = (1e3 * row[f"{part}_position_max_m"] for part in ("nominal", "checked"))
            groups.setdefault((row["kind"], row["arm"]), []).append((row["result"] == Result.CONVERGED, *errors))
        if has_failed(row):
            bad.append(_with_file(row["file"], row["message"]))
    table = listing("arm", "files", "ok", "nominal", "worst", "check")
    for (kind, arm), group in sorted(groups.items()):
        converged, nominal, checked = zip(*group, strict=True)
        name = arm if kind == "calibration" else f"{arm} (recorded)"
        errors = (f"{median(nominal):.3f}", f"{max(nominal):.3f}", number(max(checked)))
        table.add_row(name, str(len(group)), str(sum(converged)), *errors)
    if groups:
        yield from ("By type of arm; position errors in mm", table, _TEXTS["folder"])
    yield from headed(f"{len(bad)} of {count} files have no usable fit:", bad)


def diagnoses_report(rows: Sequence[dict[str, Any]]) -> Iterator[RenderableType]:
    """A line for each recording, a row of `fleet.diagnoses.SCHEMA`: verdict, errors, findings, or why none."""
    done = [row for row in rows if row["result"] == DIAGNOSED]
    table = listing("recording", "verdict", "before", "after", left=[1], wrapped=[0, 1])
    for column in table.columns[:2]:
        column.overflow = "fold"
    table.columns[1].min_width = len("unexplained")
    findings: list[str] = []
    for row in done:
        name = row["file"]
        for verdict, unit, scale in _ERRORS:
            if row[verdict] is None:
                continue
            errors = (row[f"{when}_{unit}"] for when in ("before", "after"))
            cells = ("–" if error is None else number(scale * error) for error in errors)
            table.add_row(Text(name), row[verdict].replace("_", " "), *cells)
            name = ""
        if row["findings"]:
            findings.append(
                f"{row['file']}: " + "; ".join(f"{finding['effect']} {finding['site']}" for finding in row["findings"])
            )
    yield from (table, _TEXTS["diagnoses"]) if done else ()
    yield from headed("Findings:", findings)
    undiagnosed = [row["message"] for row in rows if row["result"] != DIAGNOSED]
    yield from headed(f"{len(undiagnosed)} of {len(rows)} recordings were not diagnosed:", undiagnosed)


def _with_file(file: str, message: str) -> str:
    return message if file in message else f"{file}: {message}"


# ------------------------------------------------------------------ fleets


def is_of_fleet(document: Any) -> bool:
    """Tells whether a document says that it is that of a fleet."""
    return isinstance(document, dict) and document.get("schema") == FLEET


def population_report(document: Document) -> Iterator[RenderableType]:
    """The screen report of a fleet's document."""
    members = document["recordings"]
    effects = document["effects"]
    pooled = [member for member in members if member["used"]]
    arms = [arm for effect in effects for arm in effect["arms"]]
    outlying = sorted({arm["file"] for arm in arms if arm["outlier_p_value"] is not None})
    yield from sentences.fleet_found(document, len(pooled), outlying)
    for k, effect in enumerate(effects, 1):
        found_by = _TEXTS["fleet"]["found_by"][effect["found_by"]]
        yield from ("", f"{k}. {capital(_title(effect))}: {chance(effect['p_value'])}, found {found_by}.")
        if effect["effect"] != "unnamed":  # coefficients of splines say nothing to a reader
            table = listing("", "mean", "95 % interval", "between arms", "unit")
            for name, estimate in effect["parameters"].items():
                mean, *further_quantities = (
                    quantity(name, {"value": value, "std": estimate["std"]})
                    for value in (estimate["mean"], *estimate["interval_95"], estimate["between_std"])
                )
                low, high, between = (statistic.value for statistic in further_quantities)
                table.add_row(mean.name, mean.value, f"{low} to {high}", between, mean.unit)
            yield Padding(table, (0, 0, 0, 3))
        yield from (indented(line, 3) for line in _remarks(effect))
    pooled_effects = {f"{effect['effect']}:{effect['site']}" for effect in effects}
    alone = [
        f"{member['file']}: {', '.join(labels)}"
        for member in pooled
        if (labels := [finding["label"] for finding in member["found_alone"] if finding["label"] not in pooled_effects])
    ]
    yield from headed("Found in one recording and not in the type:", alone)
    unpooled = [_with_file(member["file"], member["reason"]) for member in members if not member["used"]]
    yield from headed(f"{counted(len(unpooled), 'recording')} of {len(members)} not pooled:", unpooled)
    yield ""


def _title(effect: Document) -> str:
    return effect_title({**effect, "parameters": {}})


def _remarks(effect: Document) -> Iterator[str]:
    """What is said of an effect below its numbers."""
    yield from sentences.effect_of_fleet(effect)
    for arm in effect["arms"]:
        if arm["outlier_p_value"] is not None:
            yield sentences.differing_arm(effect, arm)
    if near := [_title(rival) for rival in effect["rivals"] if rival["log_likelihood_gap"] < CLOSE]:
        yield f"Not distinguished from {', '.join(near)}."
