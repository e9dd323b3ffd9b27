"""What a terminal shows of many recordings: the fits and diagnoses of a folder, and what a fleet has in common."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import RenderableType
from rich.padding import Padding
from rich.text import Text

from lite6jax.calibration.quality import Result
from lite6jax.fleet.diagnoses import DIAGNOSED
from lite6jax.fleet.folder import has_failed
from lite6jax.report.remedies import effect_title
from lite6jax.report.screen import headed, indented
from lite6jax.report.words import capital, chance, counted, listing, number, quantity
from lite6jax.schema import FLEET

Document = Mapping[str, Any]

_DOMAINS = (("poses", "verdict", "position_rms_m", 1e3), ("torques", "torque_verdict", "torque_rms_Nm", 1.0))
"""With the columns of the verdict and the errors, and the factor to the unit on the screen."""
_FOUND_BY = {
    "mean": "by the mean over all recordings",
    "any": "by the sum of what each recording shows",
    "one": "in one recording alone",
}
_NEAR = 6.0
"""Log-likelihood within which effects are not distinguished."""


# ------------------------------------------------------------------ folders


def folder_report(rows: Iterable[Document]) -> Iterator[RenderableType]:
    """Position errors by type of arm, and a line for each file without a usable fit; rows are looked at once."""
    groups: dict[tuple[str, str], list[tuple[bool, float, float]]] = {}
    bad: list[str] = []
    count = 0
    for row in rows:
        count += 1
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
        yield Text("By type of arm; position errors in mm")
        yield table
        yield Text(
            "nominal, worst: median and largest, over the arms, of the maximum error before the fit;"
            " check: largest after it."
        )
    yield from headed(f"{len(bad)} of {count} files have no usable fit:", bad)


def read_diagnoses(path: Path) -> list[dict[str, Any]]:
    """The rows of a table of diagnoses."""
    import pyarrow.parquet as pq

    return pq.read_table(path).to_pylist()


def diagnoses_report(rows: Sequence[dict[str, Any]]) -> Iterator[RenderableType]:
    """A line for each recording, a row of `fleet.diagnoses.SCHEMA`: verdict, errors, findings, or why none."""
    done = [row for row in rows if row["result"] == DIAGNOSED]
    table = listing("recording", "verdict", "before", "after", left=[1], wrapped=[0, 1])
    for column in table.columns[:2]:
        column.overflow = "fold"
    table.columns[1].min_width = len("unexplained")
    found: list[str] = []
    for row in done:
        for domain, verdict, unit, scale in _DOMAINS:
            if row[verdict] is None:
                continue
            errors = (row[f"{when}_{unit}"] for when in ("before", "after"))
            cells = ("–" if error is None else number(scale * error) for error in errors)
            name = row["file"] if domain == "poses" or row["verdict"] is None else ""
            table.add_row(Text(name), row[verdict].replace("_", " "), *cells)
        if row["findings"]:
            names = "; ".join(f"{each['effect']} {each['site']}" for each in row["findings"])
            found.append(f"{row['file']}: {names}")
    if done:
        yield table
        yield Text(
            "before, after: root mean square of the errors of held-out rows without and with the findings; of poses in"
            " mm, of torques in N·m."
        )
    yield from headed("Findings:", found)
    left = [row["message"] for row in rows if row["result"] != DIAGNOSED]
    yield from headed(f"{len(left)} of {len(rows)} recordings were not diagnosed:", left)


def _with_file(file: str, message: str) -> str:
    return message if file in message else f"{file}: {message}"


# ------------------------------------------------------------------ fleets


def is_of_fleet(document: Any) -> bool:
    """Whether a document says that it is that of a fleet."""
    return isinstance(document, dict) and document.get("schema") == FLEET


def population_report(document: Document) -> Iterator[RenderableType]:
    """The screen report of a fleet's document."""
    members, effects = document["recordings"], document["effects"]
    pooled = [member for member in members if member["used"]]
    yield Text(f"{len(pooled)} recordings of {document['arm']} arms were pooled.")
    yield Text(_headline(document))
    for k, effect in enumerate(effects, 1):
        yield ""
        found_by = _FOUND_BY[effect["found_by"]]
        yield Text(f"{k}. {capital(_title(effect))}: {chance(effect['p_value'])}, found {found_by}.")
        if effect["effect"] != "unnamed":  # coefficients of splines say nothing to a reader
            table = listing("", "mean", "95 % interval", "between arms", "unit")
            for name, each in effect["parameters"].items():
                mean, *others = (
                    quantity(name, {"value": value, "std": each["std"]})
                    for value in (each["mean"], *each["interval_95"], each["between_std"])
                )
                low, high, between = (other.value for other in others)
                table.add_row(mean.name, mean.value, f"{low} to {high}", between, mean.unit)
            yield Padding(table, (0, 0, 0, 3))
        yield from (indented(line, 3) for line in remarks(effect))
    own = {f"{effect['effect']}:{effect['site']}" for effect in effects}
    alone = [
        f"{member['file']}: {', '.join(labels)}"
        for member in pooled
        if (labels := [one["label"] for one in member["found_alone"] if one["label"] not in own])
    ]
    yield from headed("Found in one recording and not in the type:", alone)
    left = [_with_file(member["file"], member["reason"]) for member in members if not member["used"]]
    yield from headed(f"{counted(len(left), 'recording')} of {len(members)} not pooled:", left)
    yield ""


def _headline(document: Document) -> str:
    """What the fleet shows, in a sentence or two."""
    effects = document["effects"]
    if not effects:
        return "No effect is significant over all recordings, and none in one that the others could be compared with."
    arms = [arm for effect in effects for arm in effect["arms"]]
    outlying = sorted({arm["file"] for arm in arms if arm["outlier_p_value"] is not None})
    said = f"{counted(len(effects), 'effect')} found."
    if outlying:
        said += f" {', '.join(outlying)} {'differs' if len(outlying) == 1 else 'differ'} from the others."
    return said


def _title(effect: Document) -> str:
    return effect_title({**effect, "parameters": {}})


def remarks(effect: Document) -> Iterator[str]:
    """What is said of an effect below its numbers."""
    if effect["effect"] == "unnamed":
        nearest = ""
        if near := effect.get("nearest"):
            nearest = f"; the nearest, {_title(near)}, explains {100 * near['share']:.0f} % of it"
        yield f"No effect of the catalogue describes it{nearest}."
        if "curve" in effect:
            mean = effect["curve"]["mean"]
            yield f"The range of its mean: {_shown(effect['curve']['name'], max(mean) - min(mean))}."
    for name in ("amplitude_rms_rad", "amplitude_rms_Nm"):
        if name in effect:
            yield f"Root mean square of its amplitude over the arms: {_shown(name, effect[name])}."
    if effect["between_p_value"] < 0.01:
        p = chance(effect["between_p_value"])
        yield f"The arms differ from each other by more than their uncertainty ({p})."
    for arm in effect["arms"]:
        if arm["outlier_p_value"] is not None:
            own = ", ".join(str(quantity(name, each)) for name, each in arm["parameters"].items())
            said = "" if effect["effect"] == "unnamed" else f": {own}"
            yield f"{arm['file']} differs from the others ({chance(arm['outlier_p_value'])}){said}."
    near = [rival for rival in effect["rivals"] if rival["log_likelihood_gap"] < _NEAR]
    if near:
        yield f"Not distinguished from {', '.join(map(_title, near))}."


def _shown(name: str, value: float) -> str:
    found = quantity(name, {"value": value, "std": 0.0})
    return f"{number(float(found.value))} {found.unit}"
