"""The sentences of a diagnosis, made from the codes and numbers of its JSON document alone."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from lite6jax.effects.drivers import Driver, driver_of
from lite6jax.report import data_faults, reference, worth
from lite6jax.report.cells import capital, fixed, joined, multiple, number, ranges, rows_named
from lite6jax.report.quantities import quantity
from lite6jax.report.remedies import effect_name

Document = Mapping[str, Any]
Entry = Mapping[str, Any]

NOT_CHECKED = "They are inside the arm's limits, in an order of short moves, and not checked for collisions."
COMPUTED = (
    "The poses are the controller's own computation from the joints: they test nothing but the table of the arm. To "
    "diagnose the arm itself, record the poses with a sensor."
)
INERTIAL = "The loads include the inertial forces of the moving arm, which the recording supports."

_VERDICTS = {
    "consistent": "Consistent: the model of the arm and the sensor's noise explain the recording.",
    "explained": "Explained: with the effects below, the held-out errors are the sensor's noise.",
    "unnamed": "Unnamed: no effect of the catalogue explains the largest effect that was found.",
    "unexplained": "Unexplained: what is left is not the sensor's noise alone, and no effect is significant.",
    "undetermined": "Undetermined: there are too few rows to tell whether something is missing.",
}
_LEFT_OVER = ("partly_explained", "unnamed", "unexplained", "undetermined")
_PARTS = {"base": "the sensor's frame", "link": "the arm's own calibration", "tool": "the tool"}
_MOST = 0.5
"""The share of a variance from which it is most of it."""
_SHARP = 0.01
"""A change of a curve within this share of where it happens, or of 1, is called a step."""
_EXCESSIVE = 5.0
"""Times the declared noise, beyond which residuals are not reported as noise."""


class Untested(NamedTuple):
    """Effects that a recording cannot show for one and the same reason.

    Attributes:
        reason: a sentence.
        remedy: what to give or to record; empty where `what_to_record` states it.
        entries: of the document, one for each effect.
    """

    reason: str
    remedy: str
    entries: tuple[Entry, ...]


def with_statements(document: Document) -> dict[str, Any]:
    """A diagnosis as in its JSON file: with a `statement` for each finding, data fault and difference from a reference.

    Untestable effects get a `reason`.
    """
    stated = data_faults.with_statements(document)
    stated["findings"] = stated_findings(document, finding_statement)
    stated["untestable"] = [{**entry, "reason": _requirement(entry)} for entry in document["untestable"]]
    if "against" in document:
        stated["against"] = reference.with_statements(document["against"])
    return stated


def setting_statement(document: Document) -> str:
    """The arm, and how much was recorded."""
    model = document["model"]
    return f"{model['arm']}, {document['samples']} samples ({model['motion']})."


def compared(document: Document) -> reference.Compared | None:
    """The comparison with a reference; None where nothing was compared."""
    return reference.compared(document)


def verdict_statement(document: Document) -> str:
    """The verdict in a few sentences, with the site of what is left where that is known."""
    where = document["left"].get("acts_at") if document["verdict"] in _LEFT_OVER else None
    if where is None:
        return _verdict(document)
    return (
        f"{_verdict(document)} The residuals look like an error of {where['site']}: fitting a separate angle of that "
        f"joint in every row removes {100 * where['share']:.0f} % of their sum of squares; of noise it would "
        f"remove {100 * where['share_of_noise']:.0f} %."
    )


def _verdict(document: Document) -> str:
    verdict, left = document["verdict"], document["left"]
    declared = document["noise"]["declared_position_m"]
    if verdict == "consistent" and worth.is_computed(document):
        return "Consistent: the table of the arm reproduces what the controller computed from the joints."
    if verdict == "undetermined":
        more = document["rows_needed"] - document["samples"]
        poses = "1 more pose" if more == 1 else f"{more} more poses"
        return f"{undetermined(_VERDICTS[verdict], document)} Record about {poses}."
    if verdict == "unexplained" and document["quality"]["verdict"] == "bad":
        return "Unexplained: the model of the arm does not describe the poses, and no effect explains why."
    if verdict == "unexplained":
        times = max(left["position_over_noise"] or 0.0, left["orientation_over_noise"] or 0.0)
        if times > _EXCESSIVE:
            return (
                f"Unexplained: no effect that was tested explains the residuals, which are {multiple(times)} times the "
                "declared noise: check the arm, the frame, the tool and the columns that the sidecar declares."
            )
        return f"{_VERDICTS[verdict]} {_what_is_left(left)}"
    if verdict == "consistent" and "against" in document:
        return "Consistent: beyond the differences above, the two recordings differ by noise."
    if verdict == "consistent" and not declared:
        return (
            "Consistent: no effect is significant, and the residuals look like noise. Their size is not tested, as the "
            f"sidecar declares {_undeclared_noise(document)}."
        )
    if verdict == "partly_explained" and not declared:
        return (
            "Partly explained: the effects below are significant. Whether more remains cannot be tested, because the "
            f"sidecar declares {_undeclared_noise(document)}."
        )
    if verdict == "partly_explained":
        return f"Partly explained: the effects below are significant. {_what_is_left(left)}"
    return _VERDICTS[verdict]


def undetermined(said: str, document: Document) -> str:
    """The sentence of an *undetermined* verdict: `said`, unless an effect that is no finding is nearly significant."""
    nearest = document["nearest"]
    if not worth.is_nearly_significant(nearest):
        return said
    after = ", with the effects below," if document["findings"] else ""
    return (
        f"Undetermined: what is left{after} is noise, but {effect_name(nearest['effect'])} at {nearest['site']} is "
        f"nearly significant (family-wise p-value {nearest['p_value']:.2g})."
    )


def cautions(document: Document) -> list[str]:
    """What qualifies the verdict: poses that no sensor measured, a model that does not describe them, effects that were
    not kept."""
    bad, withdrawn = quality_statement(document["quality"]), document["withdrawn"]
    lines = [COMPUTED] if worth.is_computed(document) else []
    lines += [] if bad is None else [bad]
    if withdrawn is not None:
        names = joined(_withdrawn_title(entry) for entry in withdrawn["effects"])
        before, after = (1e3 * withdrawn["heldout_position_rms_m"][stage] for stage in ("before", "after"))
        was, them = ("was", "it is") if len(withdrawn["effects"]) == 1 else ("were", "they are")
        if after > before:
            why = f"the errors on held-out rows are larger ({number(after, 3)} mm RMS of position) than without"
            why += f" ({number(before, 3)} mm)"
        else:
            why = "what is left on held-out rows is several times what is left of the fitted ones"
            why += f" ({number(after, 3)} mm RMS of position; {number(before, 3)} mm without)"
        lines.append(f"{capital(names)} {was} significant, but {them} not kept: {why}.")
    return lines


def _withdrawn_title(entry: Entry) -> str:
    return f"an effect without a name at {entry['site']}" if entry["effect"] == "unnamed" else effect_title(entry)


def _what_is_left(left: Entry) -> str:
    """What the model leaves, in a sentence."""
    ratios = [
        f"{name} errors are {multiple(left[f'{key}_over_noise'])} times the declared noise"
        for name, key in (("held-out position", "position"), ("orientation", "orientation"))
        if left[f"{key}_over_noise"] is not None
    ]
    correlated = [] if left["white"] else ["neighbouring rows are correlated"]
    return f"{capital(joined([*ratios, *correlated]))}."


def quality_statement(quality: Entry) -> str | None:
    """Why a model does not describe the poses it was fitted to, and what to check; None where it does.

    Args:
        quality: as in JSON documents.
    """
    if quality["verdict"] != "bad":
        return None
    error = "not finite" if quality["error_m"] is None else f"up to {number(1e3 * quality['error_m'], 3)} mm"
    if quality["explained_share"] is None:
        return f"The model does not reproduce the calibration: its errors are {error}. Check the arm that is named."
    if quality["reason"] == "unrelated":
        return (
            "The model does not describe the poses: it explains less than half of the variance of the positions. Check "
            "that the poses belong to these joint positions, row by row."
        )
    return (
        f"The model does not describe the poses: of three quarters of the held-out rows the errors are {error}, and a "
        f"model of this arm is expected within {number(1e3 * quality['limit_m'], 3)} mm. Check the arm, that the poses "
        "belong to these joint positions, and the order, the signs and the units of the joints."
    )


def finding_statement(finding: Entry) -> str:
    """A finding in one sentence, with its numbers; `finding` has the fields of its effect as `where`."""
    where, name = finding["where"], finding["effect"].replace("_", " ")
    driver = "" if finding["driver"] == "none" else f", a function of the {_worded(finding['driver'])}"
    moved = worth.moves_phrase(finding)
    moves = f"; {moved}" if moved else ""
    if "peak_to_peak" in finding:
        return (
            f"No effect of the catalogue explains an effect at {finding['site']}{_component(where)}{driver}: "
            f"{_shape(where)}{_effective(finding)}, {sizes(finding)}{moves}."
        )
    end, detail = "," if driver else "", _detail(_order_and_source(finding))
    said = "is significant" if worth.is_significant(finding) else "is likely"
    return f"{capital(name)}{detail} at {finding['site']}{driver}{end} {said}: {sizes(finding)}{moves}."


def sizes(finding: Entry) -> str:
    """The estimated numbers of a finding, with standard deviations and units."""
    numbers = finding.get("peak_to_peak", finding["parameters"])
    return ", ".join(str(number) for number in (quantity(*item) for item in numbers.items()) if number.std)


def stated_findings(document: Document, said: Callable[[Entry], str]) -> list[dict[str, Any]]:
    """The findings as in the JSON file, with a `statement` each.

    Args:
        document: of poses or of torques.
        said: makes it from a finding that has the fields of its effect as `where`.
    """
    pairs = zip(document["findings"], _detailed(document), strict=True)
    return [{**finding, "statement": said(detailed)} for finding, detailed in pairs]


def findings_of(document: Document, said: Callable[[Entry], str] = finding_statement) -> list[dict[str, Any]]:
    """The findings, those that move most first, each with `title`, `statement`, `where` and `place`.

    `where` has the fields of its effect, and `place` is that in the document, from 0.

    Args:
        document: of poses or of torques.
        said: as of `stated_findings`.
    """
    detailed = _detailed(document)
    return [
        {**detailed[k], "title": capital(effect_title(detailed[k])), "statement": said(detailed[k]), "place": k}
        for k in worth.order(document)
    ]


def p_value_statement(finding: Entry) -> str:
    """How improbable a finding is without the effect; what else it rests on, where a model was chosen as a whole."""
    if not worth.is_significant(finding):
        return "It is part of the likeliest model, and is not significant beside the other findings alone."
    p = finding["p_value"]  # one below what floats hold is not zero
    shown = f"p-value {p:.1e}" if p > 0 else "p-value below 1e-300"
    return f"Family-wise {shown} over all effects, sites and orders searched."


def effect_title(entry: Entry) -> str:
    """An effect in words, such as "joint harmonic of order 2 at joint1"."""
    where = entry.get("where", {})
    if entry["effect"] == "unnamed" and where:
        place = re.sub(r"(\D)(\d)", r"\1 \2", entry["site"])
        driver = entry["driver"].removesuffix(f" of {place}")
        alone = driver != entry["driver"] and " and " not in driver
        over = f"its {driver}" if alone else entry["driver"]
        return f"unnamed effect at {entry['site']}{_component(where)}, {_shape(where)} over {over}"
    if entry["effect"] == "unnamed" and "driver" in entry:
        return f"an effect without a name at {entry['site']}, a function of the {_worded(entry['driver'])}"
    return f"{effect_name(entry['effect'])}{_detail(_order_and_source(entry))} at {entry['site']}"


def undistinguished(finding: Entry) -> list[str]:
    """The effects that the recording does not distinguish from a finding, the nearest first."""
    return [_with_gap(rival) for rival in _by_gap(finding) if rival["status"] != "rejected"]


def rejected(finding: Entry) -> list[str]:
    """The nearest effects that explain clearly less."""
    return [_with_gap(rival) for rival in _by_gap(finding) if rival["status"] == "rejected"]


def untested(document: Document) -> list[Untested]:
    """The effects that the recording cannot show, by reason; drivers that differ by their joint are one reason."""
    groups: dict[tuple[str, str], list[Entry]] = {}
    for entry in document["untestable"]:
        driver = driver_of(entry["driver"])
        groups.setdefault((driver.quantity, driver.remedy), []).append(entry)
    found = []
    for (kind, remedy), entries in groups.items():
        drivers = {entry["driver"] for entry in entries}
        needed = entries[0]["driver"] if len(drivers) == 1 else f"{kind} of these joints"
        found.append(Untested(f"The recording has no {needed}.", remedy, tuple(entries)))
    if document["confounded"]:
        reason = "The sensor does not observe them in these poses."
        if document["nuisance"]["numbers"]:
            reason = "They are confounded with the fitted frames and geometry, or the sensor does not observe them."
        found.append(Untested(reason, "", tuple(document["confounded"])))
    return found


def by_site(entries: Iterable[Entry]) -> list[tuple[str, str]]:
    """Names of effects, each with all its sites, those of consecutive numbers as a range: joint1–6."""
    sites: dict[str, list[str]] = {}
    for entry in entries:
        held = sites.setdefault(effect_name(entry["effect"]), [])
        held += [entry["site"]] if entry["site"] not in held else []
    return [(name, _sites(held)) for name, held in sites.items()]


def what_to_record(document: Document) -> list[str]:
    """A sentence for each question that this recording leaves open and another one answers."""
    lines, pairs, drivers = [], [], []
    for finding in _detailed(document):
        waves = [rival for rival in finding["confusable_with"] if _of_one_wave(finding, rival)]
        orders = [f"{rival['order']:.6g}" for rival in waves if rival["status"] == "undecided"]
        if orders:
            asked = f"record positions of {finding['site']} that are no multiples of one angle"
            lines.append(f"To separate {effect_title(finding)} from order {joined(orders, 'or')}, {asked}.")
        for rival in finding["confusable_with"]:
            pair = f"{effect_title(finding)} from {effect_title(rival)}"
            if rival["status"] == "separable":
                lines.append(f"To separate {pair}, record the poses below (separating_poses in the JSON file).")
            elif rival["status"] == "equivalent":
                same = f"{effect_title(finding)} and {effect_title(rival)} have the same effect at these poses"
                lines.append(f"{capital(same)}: more poses of this kind do not separate them.")
            elif rival["status"] == "undecided" and not _of_one_wave(finding, rival):
                pairs.append(pair)
                drivers += [f"the {driver}" for entry in (finding, rival) for driver in _drivers(entry)]
    if pairs:
        vary = f" in which {joined(dict.fromkeys(drivers))} vary independently" if drivers else ""
        lines.append(f"To separate {joined(pairs, 'or')}, record more poses{vary}.")
    doubtful = [effect_title(finding) for finding in _detailed(document) if finding.get("payload_share", 0.0) > _MOST]
    if doubtful:
        lines.append(
            f"To narrow the ± of {joined(doubtful)}, record poses with another payload, or with none, as well: most "
            "of its variance is that the payload may be wrong by too little to be found."
        )
    for group in untested(document):
        if group.remedy:
            names = joined(dict.fromkeys(effect_name(entry["effect"]) for entry in group.entries))
            lines.append(f"To test for {names}, give {group.remedy.removesuffix(' …')}.")
    return [*lines, *(_against_confounding(document) if document["confounded"] else [])]


def held_out_statement(document: Document, rows: str) -> str:
    """How errors were held out, and what a quick diagnosis left out.

    Args:
        document: of poses or of torques.
        rows: how many, with their noun.
    """
    blocks = f"{document['heldout_blocks']} contiguous blocks" if "heldout_blocks" in document else "contiguous blocks"
    line = f"Errors of {rows}, held out in {blocks}: screening, search and fit of each did without it."
    if again := document.get("searched_again"):
        line = (
            f"Errors of {rows}, held out in {blocks}, several at a time: the effects found in all rows were fitted "
            f"again without them. A new search without each of {again['blocks']} contiguous blocks predicts them "
            f"worse: with its effects, the errors are {again['heldout_ratio']:.3g} times those without. Either a block "
            "alone shows a part of the effects, or the search selects others in its absence."
        )
    if document.get("quick"):
        line += (
            " This was a quick diagnosis: fewer blocks than usual, so that each is predicted from fewer rows and the"
            " errors are rather too large; poses that separate rival effects were not designed."
        )
    return line


def assumptions(document: Document) -> list[str]:
    """What the tests rest on beyond the recording and its sidecar."""
    loaded = any(driver_of(driver).loaded for finding in document["findings"] for driver in _drivers(finding))
    inertial = document["model"]["accelerated"] and loaded
    lacking = _undeclared_noise(document)
    missing = f"The sidecar declares {lacking}: tests use the noise estimated from the residuals."
    lines = [*([INERTIAL] if inertial else []), *([missing] if lacking else [])]
    if rows := document.get("left_out"):
        lines.append(
            f"A gear may be between its flanks in {rows_named(rows)}: estimates do without, and the held-out errors "
            "include them."
        )
    return lines


def _of_one_wave(finding: Entry, rival: Entry) -> bool:
    """Whether two effects are orders of one joint that these positions do not tell apart."""
    return "order" in rival and (finding["effect"], finding["site"]) == (rival["effect"], rival["site"])


def _undeclared_noise(document: Document) -> str:
    """The keys of the noise of what was measured that the sidecar lacks; empty where it has them."""
    noise, keys = document["noise"], []
    if noise["declared_position_m"] is None:
        keys.append("no position_noise_m")
    if document["model"]["orientation"] and noise.get("declared_orientation_rad", 1.0) is None:
        keys.append("no orientation_noise_rad")
    return " and ".join(keys)


def separating_title(item: Entry, units: Iterable[str] = ("deg",)) -> str:
    """What the poses of a table are for, and the units of the joints."""
    one, other = (label.replace("_", " ").replace(":", " at ") for label in item["effects"])
    return f"Poses that separate {one} from {other} ({', '.join(dict.fromkeys(units))})"


def sliding(document: Document) -> tuple[int, ...]:
    """The prismatic joints of the diagnosed arm, counted from 0."""
    return tuple(joint - 1 for joint in document["model"].get("prismatic_joints", ()))


def _detailed(document: Document) -> list[dict[str, Any]]:
    """The findings with the fields of their effects, which the model has."""
    effects = document["model"]["effects"]
    return [{**finding, "where": e["where"]} for finding, e in zip(document["findings"], effects, strict=True)]


def _requirement(entry: Entry) -> str:
    driver = driver_of(entry["driver"])
    return f"needs the {driver.phrase}: give {driver.remedy}"


def _against_confounding(document: Document) -> list[str]:
    declare = joined(words for part, words in _PARTS.items() if part in document["nuisance"]["parts"])
    orientation = document["model"]["orientation"]
    steps = [*([f"declare {declare}"] if declare else []), *([] if orientation else ["measure orientations too"])]
    return [f"To test for effects that are confounded or not observed, {' and '.join(steps)}."] if steps else []


def _drivers(entry: Entry) -> Sequence[str]:
    return [] if entry["driver"] == "none" else entry["driver"].split(" and ")


def _worded(driver: str) -> str:
    return driver.replace(" and ", " and the ")


def _order_and_source(entry: Entry) -> Mapping[str, float | None]:
    """A harmonic's order, or its period along a slide, and a coupling's source, of a finding or a rival."""
    estimates, keys = entry.get("parameters", {}), ("order", "period_m", "source_joint")
    return {key: estimates[key]["value"] if key in estimates else entry.get(key) for key in keys}


def _detail(numbers: Mapping[str, float | None]) -> str:
    order, period, source = numbers["order"], numbers["period_m"], numbers["source_joint"]
    if period:
        return f" of period {1e3 * period:.4g} mm"
    return f" of order {order:.4g}" if order else f" from joint{source:.0f}" if source else ""


def _component(where: Entry) -> str:
    return (
        ""
        if where.get("where", "joint").startswith("joint")
        else f" ({', '.join(where.get('component', 'rz').split())})"
    )


def _shape(where: Entry) -> str:
    if where.get("memory"):
        return "a hysteresis loop"
    orders = where.get("orders", ())
    if where.get("degree") == 1:
        return "a linear function"
    if where.get("degree"):
        return f"a polynomial of degree {where['degree']:.0f}"
    if orders:
        each = " per metre" if where.get("of_slide") else ""
        which = f"{len(orders)} orders from {min(orders):g} to {max(orders):g}{each}"
        return f"harmonics of {which}" if len(orders) > 1 else f"a harmonic of order {orders[0]:g}{each}"
    return _local_shape(where, driver_of(where["driver"])) if _is_local(where) else "a smooth curve"


def _is_local(where: Entry) -> bool:
    """Whether a curve is a spline of one interval, which is a part of the driver's range, but of a load all of it."""
    if where.get("pieces") != 1:
        return False
    first, *further = map(driver_of, _drivers(where))
    return not further and not first.loaded


def _local_shape(where: Entry, driver: Driver) -> str:
    lower, upper = where["lower"], where["upper"]
    at = 0.5 * (lower + upper)
    if upper - lower < _SHARP * max(abs(at), 1.0):
        return f"a step at {at:.5g} {driver.unit}"
    return f"a rise or fall between {lower:.5g} and {upper:.5g} {driver.unit}"


def _effective(finding: Entry) -> str:
    """Of a curve with a prior, how many of its coefficients the data determine."""
    return f" ({finding['effective_parameters']:.0f} effective parameters)" if finding["where"].get("spread") else ""


def _by_gap(finding: Entry) -> list[Entry]:
    return sorted(finding["confusable_with"], key=lambda rival: rival["log_likelihood_gap"])


def _with_gap(rival: Entry) -> str:
    return f"{effect_title(rival)} (log-likelihood {fixed(-rival['log_likelihood_gap'], 1, '+')})"


def _sites(sites: Iterable[str]) -> str:
    kinds: dict[str, list[int]] = {}
    for site in sites:
        kind = site.rstrip("0123456789")
        kinds.setdefault(kind, [])
        kinds[kind] += [int(site.removeprefix(kind))] if site != kind else []
    return ", ".join(kind + ", ".join(text for text, _ in ranges(sorted(held))) for kind, held in kinds.items())
