"""The sentences of a diagnosis of poses or of torques, made from the codes and numbers of its JSON document alone.

The sentences are functions of `sentences.diagnosis`, and in `templates/diagnosis.yaml` where they depend on no
condition; here is what they are filled with.
"""

from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np

from lite6jax.diagnosis.document import domains_beside
from lite6jax.domains.registry import DOMAINS
from lite6jax.domains.uncertainty import Basis
from lite6jax.effects.drivers import driver_of
from lite6jax.formatting import (
    NAMED_OF_TORQUES,
    SCREEN,
    RoundedParameter,
    capital,
    joined,
    quantity,
    rounded,
    significant,
)
from lite6jax.report import ranking
from lite6jax.report.faults import fault_alternative, fault_distinction, with_fault_statements
from lite6jax.report.remedies import (
    alternatives_of,
    component,
    distinct_rivals,
    drivers_of,
    effect_name,
    effect_title,
    shape,
    wanders,
    with_articles,
)
from lite6jax.report.reports import own_report
from lite6jax.report.sentences import diagnosis as sentences
from lite6jax.report.sentences.document import Document, Entry, words_of
from lite6jax.report.sentences.faults import quality_statement
from lite6jax.report.words import fill, read_texts

_TEXTS = read_texts("diagnosis.yaml")
NOT_CHECKED: str = _TEXTS["not_checked"]
_STATISTICS = {"mean": "mean", "rms": "RMS", "p95": "95th percentile", "max": "maximum"}
"""Of held-out errors: by the part of a key of the document, what it is called."""

_MOST = 0.5
"""The share of a variance from which it is most of it."""
_NEAREST = 2
"""Effects that a finding may be instead, for whose distinction the recording is said; more would vary everything."""
_SCATTERS = 1.5
"""Standard deviation from blocks over that of the fit, from which it is said: chance makes it so in one of 700."""


def with_statements(document: Document) -> dict[str, Any]:
    """A diagnosis as in its JSON file: with a `statement` for each finding, data fault and comparison.

    Untestable effects get a `reason`. Torques beside poses get all of this too.
    """
    own = own_report(document)
    if own is not None:
        return own.with_statements(document)
    stated = with_fault_statements(document)
    detailed = ranking.detailed(document)
    stated["findings"] = [
        {**finding, "statement": finding_statement(detailed_finding, detailed)}
        for finding, detailed_finding in zip(document["findings"], detailed, strict=True)
    ]
    drivers = [driver_of(entry["driver"]) for entry in document["untestable"]]
    stated["untestable"] = [
        {**entry, "reason": f"needs the {driver.phrase}: give {driver.remedy}"}
        for entry, driver in zip(document["untestable"], drivers, strict=True)
    ]
    if "against" in document:
        stated["against"] = with_comparison(document["against"])
    for domain in domains_beside(document):
        stated[domain] = with_statements(document[domain])
        stated["shared"] = [{**entry, "statement": agreement_statement(entry)} for entry in document["shared"]]
    return stated


# ------------------------------------------------------------------ the verdict


def cautions(document: Document) -> list[str]:
    """What qualifies the verdict: poses or torques that the controller computed, a model that does not describe them,
    effects that were not kept."""
    lines = sentences.not_measured(document)
    if "quality" in document and (bad := quality_statement(document["quality"])):
        lines.append(bad)
    if document["withdrawn"] is not None:
        lines.append(sentences.withdrawn_effects(document))
    return lines


# ------------------------------------------------------------------ errors and noise


def error_rows(document: Document) -> tuple[list[str], list[list[str]]]:
    """The table of held-out errors: headers, and a row for each with its unit and statistic."""
    before = document["before"]
    after = document["after"]
    rows = []
    words = words_of(document)
    for name, measure, unit in words.error_kinds(document):
        scale, shown = SCREEN.get(unit, (1.0, unit))
        for key, statistic in _STATISTICS.items():
            if (at := f"heldout_{measure}_{key}_{unit}") in before and at in after:
                rows.append((f"{name} ({shown}), {statistic}", scale * before[at], scale * after[at]))
    rows += words.error_rows_by_joint(document)
    has_findings = bool(document["findings"])
    size = words.shown
    headers = ["held-out error", "before", "after", *(["after / before"] if has_findings else [])]
    ratio = lambda initial, final: [f"{100 * final / initial:.0f} %" if initial else "–"] if has_findings else []  # noqa: E731
    return headers, [[name, size(initial), size(final), *ratio(initial, final)] for name, initial, final in rows]


# ------------------------------------------------------------------ findings


def findings_of(document: Document) -> list[dict[str, Any]]:
    """The findings, the largest contribution first, each with its own fields and with what is said of it.

    Added are `rank` (from 1), `title`, `statement`, `where` (the fields of its effect), `place` (in the document, from
    0), `contribution` (what it moves, with its unit), `share` (of the largest contribution), `rivals` and `rejected`
    (what is not, and what is, distinguished from it).
    """
    findings = ranking.detailed(document)
    shares = ranking.shares(document)
    largest = max(shares, default=0.0) or 1.0
    return [
        {
            **findings[k],
            "rank": rank,
            "title": capital(effect_title(findings[k])),
            "statement": finding_statement(findings[k], findings),
            "place": k,
            "contribution": ranking.contribution(document, findings[k]),
            "share": shares[k] / largest,
            "rivals": rivals(findings[k]),
            "rejected": rivals(findings[k], rejected=True),
        }
        for rank, k in enumerate(ranking.order(document), 1)
    ]


def finding_statement(finding: Entry, beside: Iterable[Entry] = ()) -> str:
    """A finding, as `ranking.detailed` gives it, in a sentence, and what it is with those `beside`."""
    numbers = ", ".join(str(size) for size in quantities(finding) if size.std)
    words = words_of(finding)
    drivers = with_articles(finding["driver"])
    if finding["effect"] == "unnamed":
        where = finding["where"]
        nearest = ""
        if "nearest" in finding:
            nearest = effect_title(finding["nearest"])
        sentence = words.unnamed(finding, drivers, numbers, component(where), shape(where), nearest)
    else:
        sentence = words.named(finding, effect_title(finding), drivers, numbers)
    return " ".join([sentence, *_by_blocks(finding), *_as_a_gear(finding, beside)])


def _by_blocks(finding: Entry) -> Iterator[str]:
    """That standard deviations are from blocks of the recording, where these scatter much more than the fit says."""
    parameters = finding["parameters"]
    by_fit = finding.get("fit_std", {})
    times = max((parameters[name]["std"] / std for name, std in by_fit.items() if std), default=1.0)
    if times > _SCATTERS:
        yield fill(_TEXTS["by_blocks"], {"times": significant(times, 2)})


def _as_a_gear(finding: Entry, findings: Iterable[Entry]) -> Iterator[str]:
    """Load friction μ beside a torque scale s, as efficiencies of a gear: 1/((1 + s)(1 + μ)), and (1 + s)(1 − μ).

    Where either is none, as of a scale that no loss explains, nothing is said.
    """
    if finding["effect"] != "load_friction":
        return
    for companion in findings:
        if (companion["effect"], companion["site"]) == ("torque_scale", finding["site"]):
            friction = finding["parameters"]["coefficient"]
            scale = companion["parameters"]["scale"]
            mu, s = (friction["value"], scale["value"])
            deviations = np.array([friction["std"], scale["std"]])
            shares = np.array([1 / ((1 + s) * (1 + mu)), (1 + s) * (1 - mu)])
            stds = np.linalg.norm(deviations * [[shares[0] / (1 + mu), shares[0] / (1 + s)], [1 + s, 1 - mu]], axis=1)
            if 0 < shares[1] <= 1 and shares[0] <= 1:
                driving, driven = (" ± ".join(rounded(*estimate)) for estimate in 100 * np.stack([shares, stds], 1))
                yield fill(_TEXTS["gear"], {"driving": driving, "driven": driven}, site=finding["site"])


def quantities(finding: Entry) -> list[RoundedParameter]:
    """The numbers of a finding as they are read; of a nonparametric effect its peak to peak."""
    special_units = words_of(finding).special_units
    estimates = finding.get("peak_to_peak", finding["parameters"])
    return [quantity(name, estimate, special_units) for name, estimate in estimates.items()]


def p_value_statement(finding: Entry) -> str:
    """How improbable a finding is without the effect."""
    p = finding["p_value"]  # one below what floats hold is not zero
    shown = f"p-value {p:.1e}" if p > 0 else "p-value below 1e-300"
    return f"Family-wise {shown} over all effects, sites and orders searched."


def rivals(finding: Entry, rejected: bool = False) -> list[str]:
    """What the recording does not distinguish from a finding, or the nearest that explain clearly less.

    These are effects and faults of the data. The nearest come first; on poses with their log evidence over its own.
    """
    distinct = distinct_rivals(finding)
    listed = [entry for entry in alternatives_of(finding) if "fault" in entry or entry in distinct]
    entries = [entry for entry in listed if (entry["status"] == "rejected") == rejected]
    return words_of(finding).rivals([(_alternative_title(entry), entry) for entry in entries])


def _alternative_title(entry: Entry) -> str:
    """An effect, or a fault of the data with the other effects that it would explain, in words."""
    if "fault" not in entry:
        return effect_title(entry)
    title = fault_alternative(entry)
    others = [effect_title(other) for other in entry.get("instead_of", ())]
    together_with = [effect_title(other) for other in entry.get("together_with", ())]
    if others:
        title += f", in place of {joined(others)} as well"
    if together_with:
        title += f" together with {joined(together_with)}"
    return title


# ------------------------------------------------------------------ what was not tested, and what to record


class Untested(NamedTuple):
    """Effects that a recording cannot show for one reason; no remedy where `what_to_record` states it."""

    reason: str
    remedy: str
    entries: tuple[Entry, ...]


def untested(document: Document) -> list[Untested]:
    """The effects that the recording cannot show, by reason; drivers that differ by their joint are one reason."""
    groups: dict[tuple[str, str], list[Entry]] = {}
    for entry in document["untestable"]:
        driver = driver_of(entry["driver"])
        groups.setdefault((driver.quantity, driver.remedy), []).append(entry)
    reasons = []
    for (kind, remedy), entries in groups.items():
        several = len({entry["driver"] for entry in entries}) > 1
        needed = f"{kind} of these joints" if several else entries[0]["driver"]
        reasons.append(Untested(f"The recording has no {needed}.", remedy, tuple(entries)))
    if document["confounded"]:
        reasons.append(Untested(words_of(document).confounded(document), "", tuple(document["confounded"])))
    return reasons


def what_to_record(document: Document) -> list[str]:
    """A sentence for each question that this recording leaves open: those that another one answers come first."""
    texts = _TEXTS["record"]
    lines = []
    equivalent = []
    by_fault: dict[tuple[str, str], list[str]] = {}
    findings = ranking.detailed(document)
    for finding in findings:
        subject = {"one": effect_title(finding), "site": finding["site"]}
        waves = [rival for rival in finding["confusable_with"] if "fault" not in rival and _of_one_wave(finding, rival)]
        open_waves = [rival for rival in waves if rival["status"] == "undecided"]
        if orders := [f"{rival['order']:.6g}" for rival in open_waves if "together_with" not in rival]:
            lines.append(fill(texts["orders"], subject, orders=orders))
        for rival in (rival for rival in open_waves if "together_with" in rival):
            orders = [f"{wave['order']:.6g}" for wave in (rival, *rival["together_with"])]
            lines.append(fill(texts["several_orders"], subject, orders=orders))
        undecided = []
        equivalents = [effect_title(rival) for rival in distinct_rivals(finding) if rival["status"] == "equivalent"]
        if equivalents:
            equivalent.append(fill(texts["equivalent"], subject, others=equivalents))
        for rival in distinct_rivals(finding):
            if rival["status"] == "separable":
                lines.append(fill(texts["separable"], subject, other=effect_title(rival)))
            elif rival["status"] == "undecided" and wanders(rival):
                lines.append(fill(texts["wandering"], subject, other=effect_title(rival)))
            elif rival["status"] == "undecided" and not _of_one_wave(finding, rival):
                undecided.append(rival)
        if near := undecided[:_NEAREST]:
            drivers = dict.fromkeys(f"the {driver}" for entry in (finding, *near) for driver in drivers_of(entry))
            titles = list(map(effect_title, near))
            lines.append(sentences.separate_undecided(document, subject["one"], titles, list(drivers)))
        for entry in alternatives_of(finding):
            if "fault" in entry:
                by_fault.setdefault((fault_alternative(entry), fault_distinction(entry)), []).append(subject["one"])
    lines += [
        fill(texts["separable_by"], {"names": names, "other": other, "remedy": remedy})
        for (other, remedy), names in by_fault.items()
    ]
    doubtful = [effect_title(finding) for finding in findings if finding.get("payload_share", 0.0) > _MOST]
    if doubtful:
        lines.append(fill(texts["payload"], {"names": doubtful}))
    for group in untested(document):
        if group.remedy:
            names = list(dict.fromkeys(effect_name(entry["effect"]) for entry in group.entries))
            lines.append(fill(texts["untested"], {"names": names, "remedy": group.remedy.removesuffix(" …")}))
    if document["confounded"]:
        sentence = words_of(document).remedy_of_confounded(document)
        lines += [sentence] if sentence else []
    return lines + equivalent


def _of_one_wave(finding: Entry, rival: Entry) -> bool:
    """Tells whether two effects are orders of one joint that these positions do not tell apart."""
    return "order" in rival and (finding["effect"], finding["site"]) == (rival["effect"], rival["site"])


# ------------------------------------------------------------------ comparisons with a reference recording


def with_comparison(comparison: Document) -> dict[str, Any]:
    """The comparison as in the JSON file, with a `statement` for each difference, each note and the whole."""
    file = comparison["file"]
    basis = comparison["basis"]
    stated = {**comparison, "statement": model_statement(file, basis)}
    if basis == "rows":
        return stated
    if basis == "effects":
        wording = [{**entry, "statement": agreement_statement(entry)} for entry in comparison["differences"]]
        return stated | {"differences": wording}
    stated["differences"] = []
    times = ("position_rms_before_m", "position_rms_after_m")
    for ends, group in groupby(comparison["differences"], key=lambda entry: tuple(entry.get(at) for at in times)):
        together = list(group)
        for entry in together:
            wording = sentences.difference_statement(entry, file)
            if ends[0] is not None and entry is together[-1]:
                wording += f" {sentences.reduction(ends[0], ends[1], len(together) > 1)}"
            stated["differences"].append({**entry, "statement": wording})
    stated["notes"] = [
        {**entry, "statement": fill(_TEXTS["notes"][entry["note"]], entry, file=file)} for entry in comparison["notes"]
    ]
    return stated


def model_statement(file: str, basis: Basis) -> str:
    """What a model contains that was estimated relative to a reference file; arguments as of `ReferenceOrigin`."""
    return fill(_TEXTS["against"][basis], {"file": file})


def agreement_statement(entry: Entry) -> str:
    """What two sides say of one quantity, and whether they agree: of two recordings, or of two domains.

    Parameters without a standard deviation were chosen and not estimated: two recordings have them alike.
    """
    shared = "quantity" in entry
    domains = [name for name in DOMAINS if name in entry]
    sides = {
        side: ", ".join(
            str(quantity(name, estimate, NAMED_OF_TORQUES))
            for name, estimate in (entry[side] or {"parameters": {}})["parameters"].items()
            if shared or estimate["std"]
        )
        for side in (domains if shared else ("recording", "reference"))
    }
    if shared:
        return sentences.shared_quantity(entry, sides)
    over = f" over {entry['driver']}" if "driver" in entry else ""
    title = f"Unnamed effect at {entry['site']}{over}" if over else capital(effect_title(entry))
    return sentences.effect_of_both(entry, title, sides)
