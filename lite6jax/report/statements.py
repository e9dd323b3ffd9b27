"""The sentences of a diagnosis of poses or of torques, made from the codes and numbers of its JSON document alone."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from lite6jax.effects.drivers import driver_of
from lite6jax.report import faults, ranking, reference
from lite6jax.report.ranking import of_torques, units
from lite6jax.report.remedies import (
    component,
    detail,
    distinct_rivals,
    drivers_of,
    effect_name,
    effect_title,
    shape,
    with_articles,
)
from lite6jax.report.words import (
    OF_TORQUES,
    SCREEN,
    Quantity,
    capital,
    each_with_unit,
    fixed,
    joined,
    multiple,
    number,
    plus_minus,
    quantity,
    rows_named,
    significant,
)

Document = Mapping[str, Any]
Entry = Mapping[str, Any]

NOT_CHECKED = "They are inside the arm's limits, in an order of short moves, and not checked for collisions."
COMPUTED = (
    "The poses are the controller's own computation from the joints: they test nothing but the table of the arm. To "
    "diagnose the arm itself, record the poses with a sensor."
)
ESTIMATED = (
    "The torques are declared as estimated by the controller: the findings are differences between the model of the "
    "controller and the model of this arm, and not effects on the motors."
)
STATISTICS = {"mean": "mean", "rms": "RMS", "p95": "95th percentile", "max": "maximum"}
"""Of held-out errors: by the part of a key of the document, what it is called."""

_VERDICTS = {
    "explained": "Explained: with the effects below, the held-out errors are the {sensor} noise.",
    "unnamed": "Unnamed: no effect of the catalogue explains the largest effect that was found.",
    "unexplained": "Unexplained: what is left is not the {sensor} noise alone, and no effect is significant.",
}
_POSE_VERDICTS = {verdict: said.format(sensor="sensor's") for verdict, said in _VERDICTS.items()} | {
    "consistent": "Consistent: the model of the arm and the sensor's noise explain the recording.",
    "partly_explained": "Partly explained: the effects below are significant.",
    "undetermined": "Undetermined: there are too few rows to tell whether something is missing.",
}
_TORQUE_VERDICTS = {verdict: said.format(sensor="sensors'") for verdict, said in _VERDICTS.items()} | {
    "consistent": "Consistent: the inverse dynamics of the declared arm and the sensors' noise explain the torques.",
    "partly_explained": "Partly explained: the effects below are significant, and more than noise is left.",
    "undetermined": "Undetermined: the recording is too short to tell whether something is missing.",
}
_OF_UNKNOWN_NOISE = {
    "consistent": "Consistent: no effect is significant, and the residuals look like noise. Their size is not tested, "
    "as the sidecar declares {lacking}.",
    "partly_explained": "Partly explained: the effects below are significant. Whether more remains cannot be tested, "
    "because the sidecar declares {lacking}.",
}
_LEFT_OVER = ("partly_explained", "unnamed", "unexplained", "undetermined")
_PARTS = {"base": "the sensor's frame", "link": "the arm's own calibration", "tool": "the tool"}
_MOST = 0.5
"""The share of a variance from which it is most of it."""
_EXCESSIVE = 5.0
"""Times the declared noise, beyond which residuals are not reported as noise."""
_STANDS_OUT = 2.0
"""Times the others, at which one joint is named apart."""


def with_statements(document: Document) -> dict[str, Any]:
    """A diagnosis as in its JSON file: with a `statement` for each finding, data fault and comparison.

    Untestable effects on poses get a `reason`. Torques beside poses get all of this too.
    """
    torques, stated = of_torques(document), faults.with_statements(document)
    pairs = zip(document["findings"], _detailed(document), strict=True)
    stated["findings"] = [{**finding, "statement": finding_statement(each, torques)} for finding, each in pairs]
    if not torques:
        stated["untestable"] = [
            {**entry, "reason": f"needs the {driver.phrase}: give {driver.remedy}"}
            for entry in document["untestable"]
            for driver in (driver_of(entry["driver"]),)
        ]
    if "against" in document:
        stated["against"] = reference.with_statements(document["against"])
    if "torques" in document:
        stated["torques"] = with_statements(document["torques"])
        entries = document["shared"]
        stated["shared"] = [{**entry, "statement": reference.shared_statement(entry)} for entry in entries]
    return stated


# ------------------------------------------------------------------ the recording and the verdict


def setting_statement(document: Document) -> str:
    """The arm, and how much was recorded."""
    what = " of torques" if of_torques(document) else f" ({document['model']['motion']})"
    return f"{document['model']['arm']}, {document['samples']} samples{what}."


def verdict_statement(document: Document) -> str:
    """The verdict in a few sentences, with what is left and where that acts."""
    torques, verdict = of_torques(document), document["verdict"]
    said = _torque_verdict(document) if torques else _pose_verdict(document)
    where = None if torques or verdict not in _LEFT_OVER else document["left"]["acts_at"]
    if where is None:
        return said
    return (
        f"{said} The residuals look like an error of {where['site']}: fitting a separate angle of that joint in every "
        f"row removes {100 * where['share']:.0f} % of their sum of squares; of noise it would remove "
        f"{100 * where['share_of_noise']:.0f} %."
    )


def _pose_verdict(document: Document) -> str:
    verdict, left = document["verdict"], document["left"]
    said = _POSE_VERDICTS[verdict]
    if verdict == "consistent" and ranking.is_computed(document):
        return "Consistent: the table of the arm reproduces what the controller computed from the joints."
    if verdict == "undetermined":
        more = document["rows_needed"] - document["samples"]
        return f"{_undetermined(said, document)} Record about {'1 more pose' if more == 1 else f'{more} more poses'}."
    if verdict == "unexplained" and document["quality"]["verdict"] == "bad":
        return "Unexplained: the model of the arm does not describe the poses, and no effect explains why."
    if verdict == "unexplained":
        times = max(left["position_over_noise"] or 0.0, left["orientation_over_noise"] or 0.0)
        if times > _EXCESSIVE:
            return (
                f"Unexplained: no effect that was tested explains the residuals, which are {multiple(times)} times the "
                "declared noise: check the arm, the frame, the tool and the columns that the sidecar declares."
            )
    if verdict == "consistent" and "against" in document:
        return "Consistent: beyond the differences above, the two recordings differ by noise."
    if verdict in _OF_UNKNOWN_NOISE and not document["noise"]["declared_position_m"]:
        return _OF_UNKNOWN_NOISE[verdict].format(lacking=_undeclared_noise(document))
    if verdict not in ("partly_explained", "unexplained"):
        return said
    ratios = [
        f"{name} errors are {multiple(left[f'{key}_over_noise'])} times the declared noise"
        for name, key in (("held-out position", "position"), ("orientation", "orientation"))
        if left[f"{key}_over_noise"] is not None
    ]
    correlated = [] if left["white"] else ["neighbouring rows are correlated"]
    return f"{said} {capital(joined([*ratios, *correlated]))}."


def _torque_verdict(document: Document) -> str:
    verdict, left = document["verdict"], document["left"]
    said = _TORQUE_VERDICTS[verdict]
    if verdict in _OF_UNKNOWN_NOISE and document["noise"]["declared_torque_Nm"] is None:
        return _OF_UNKNOWN_NOISE[verdict].format(lacking="no torque_noise_Nm")
    if verdict == "undetermined":
        return f"{_undetermined(said, document)} Record a longer one."
    if verdict not in _LEFT_OVER:
        return said
    over_noise = left["torque_over_noise"]
    if over_noise is not None:
        joint, most = max(enumerate(over_noise, 1), key=lambda pair: pair[1])
        others = [value for number, value in enumerate(over_noise, 1) if number != joint]
        if others and most > _STANDS_OUT * max(others):
            said += (
                f" The held-out errors of joint {joint} are {multiple(most)} times the declared noise, those of the "
                f"others {_from_to(others)} times."
            )
        else:
            said += (
                f" The held-out errors are {_from_to(over_noise)} times the declared noise, and largest of joint "
                f"{joint}."
            )
    return said if left["white"] else f"{said} Neighbouring samples of what is left are correlated."


def _from_to(values: Sequence[float]) -> str:
    least, most = map(multiple, (min(values), max(values)))
    return least if least == most else f"{least} to {most}"


def _undetermined(said: str, document: Document) -> str:
    """The sentence of an *undetermined* verdict: `said`, unless an effect that is no finding is nearly significant."""
    nearest = document["nearest"]
    if not ranking.is_nearly_significant(nearest):
        return said
    after = ", with the effects below," if document["findings"] else ""
    return (
        f"Undetermined: what is left{after} is noise, but {effect_name(nearest['effect'])} at {nearest['site']} is "
        f"nearly significant (family-wise p-value {nearest['p_value']:.2g})."
    )


def cautions(document: Document) -> list[str]:
    """What qualifies the verdict: poses or torques that the controller computed, a model that does not describe them,
    effects that were not kept."""
    withdrawn = document["withdrawn"]
    if of_torques(document):
        lines = [ESTIMATED] if document["torque_source"] == "estimated" else []
        if withdrawn:
            names = ", ".join(map(effect_title, withdrawn))
            lines.append(f"Significant, but not kept, because the held-out errors are larger with them: {names}.")
        return lines
    bad = quality_statement(document["quality"])
    lines = [*([COMPUTED] if ranking.is_computed(document) else []), *([] if bad is None else [bad])]
    if withdrawn is not None:
        names = joined(
            f"an effect without a name at {entry['site']}" if entry["effect"] == "unnamed" else effect_title(entry)
            for entry in withdrawn["effects"]
        )
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


# ------------------------------------------------------------------ errors and noise


class Error(NamedTuple):
    """A held-out error before and after, in the unit shown: of what, and which statistic, as keys of `STATISTICS`."""

    name: str
    unit: str
    statistic: str
    before: float
    after: float


def errors(document: Document, statistics: Iterable[str] = STATISTICS) -> Iterator[Error]:
    """The held-out errors that a document has: of positions and orientations, or of all joints and then of each.

    Args:
        document: of poses or of torques.
        statistics: keys of `STATISTICS`.
    """
    before, after = document["before"], document["after"]
    if of_torques(document):
        both = dict.fromkeys(units(document))
        kinds = {unit: "all" if len(both) == 1 else "prismatic" if unit == "N" else "revolute" for unit in both}
        rows = [
            (f"{kinds[unit]} joints", unit, key, f"heldout_torque_{key}_{unit}", 1.0)
            for key in statistics
            for unit in both
        ]
    else:
        rows = [
            (f"{what} error", shown, key, f"heldout_{what}_{key}_{unit}", scale)
            for what, unit, (scale, shown) in (("position", "m", SCREEN["m"]), ("orientation", "rad", SCREEN["rad"]))
            for key in statistics
        ]
    for name, unit, key, at, scale in rows:
        if at in before and at in after:
            yield Error(name, unit, key, scale * before[at], scale * after[at])
    if of_torques(document):
        by_joint = (stage["heldout_torque_rms_by_joint_Nm"] for stage in (before, after))
        for joint, (unit, own, left) in enumerate(zip(units(document), *by_joint, strict=True), 1):
            yield Error(f"joint {joint}", unit, "rms", own, left)


def held_out_statement(document: Document) -> str:
    """How errors were held out, and what a quick diagnosis left out."""
    if of_torques(document):
        rows = f"{document['kept_samples']} filtered samples"
    else:
        rows = f"{document['heldout_rows']} rows"
    blocks = f"{document['heldout_blocks']} contiguous blocks"
    line = f"Errors of {rows}, held out in {blocks}: screening, search and fit of each did without it."
    if again := document["searched_again"]:
        line = (
            f"Errors of {rows}, held out in {blocks}, several at a time: the effects found in all rows were fitted "
            f"again without them. A new search without each of {again['blocks']} contiguous blocks predicts them "
            f"worse: with its effects, the errors are {again['heldout_ratio']:.3g} times those without. Either a block "
            "alone shows a part of the effects, or the search selects others in its absence."
        )
    if document["quick"]:
        line += (
            " This was a quick diagnosis: fewer blocks than usual, so that each is predicted from fewer rows and the"
            " errors are rather too large; poses that separate rival effects were not designed."
        )
    return line


def noise_statement(document: Document) -> str:
    """The noise estimated from the residuals beside the declared one."""
    noise = document["noise"]
    if of_torques(document):
        declared, of = noise["declared_torque_Nm"], units(document)
        said = f"the residuals have {each_with_unit(noise['estimated_torque_Nm'], of)}"
        beside = "none is declared" if declared is None else f"{each_with_unit(declared, of)} are declared"
        return f"Noise of the torques, one sigma of each joint in turn: {said}; {beside}."
    estimated, declared = (noise[f"{name}_position_m"] for name in ("estimated", "declared"))
    beside = "none is declared" if declared is None else f"{number(1e3 * declared)} mm is declared"
    return f"Noise per axis of position: the residuals have {number(1e3 * estimated)} mm, {beside}."


def assumptions(document: Document) -> list[str]:
    """What the tests rest on beyond the recording and its sidecar; of torques, how they were filtered."""
    if of_torques(document):
        return _torque_assumptions(document)
    lacking, lines = _undeclared_noise(document), []
    loaded = any(driver_of(driver).loaded for finding in document["findings"] for driver in drivers_of(finding))
    if document["model"]["accelerated"] and loaded:
        lines.append("The loads include the inertial forces of the moving arm, which the recording supports.")
    if lacking:
        lines.append(f"The sidecar declares {lacking}: tests use the noise estimated from the residuals.")
    if rows := document["left_out"]:
        lines.append(
            f"A gear may be between its flanks in {rows_named(rows)}: estimates do without, and the held-out errors "
            "include them."
        )
    return lines


def _undeclared_noise(document: Document) -> str:
    """The keys of the noise of what was measured that the sidecar lacks; empty where it has them."""
    noise, keys = document["noise"], []
    if noise["declared_position_m"] is None:
        keys.append("no position_noise_m")
    if document["model"]["orientation"] and noise["declared_orientation_rad"] is None:
        keys.append("no orientation_noise_rad")
    return " and ".join(keys)


def _torque_assumptions(document: Document) -> list[str]:
    """How both sides of the equation of motion were filtered, and what was taken as known of the links' inertia."""
    used, known = document["filter"], document["nuisance"]
    if used is None:
        filtered = (
            "Each row is a posture at rest, in which gravity alone is compared: friction, rotors and delays, which "
            "show in a motion, were not tested."
        )
    else:
        kept = "every sample" if used["every"] == 1 else f"one sample in {used['every']}"
        filtered = (
            f"Measured and modelled torques pass the same zero-phase low-pass filter of {used['cutoff_Hz']:.3g} Hz (of "
            f"{used['rate_Hz']:.4g} samples a second), and {kept} is kept; the motion passes one of "
            f"{used['motion_cutoff_Hz']:.3g} Hz before it is differentiated."
        )
    if not known["numbers"]:
        return [filtered, "The inertial numbers of the links are taken as declared."]
    prior = f"with a prior standard deviation of {100 * known['relative_std']:.2g} % about the declared ones"
    return [filtered, f"The inertial numbers of the links are fitted, {prior}."]


# ------------------------------------------------------------------ findings


def findings_of(document: Document) -> list[dict[str, Any]]:
    """The findings, the largest contribution first, each with its own fields and with what is said of it.

    Added are `title`, `statement`, `where` (the fields of its effect), `place` (in the document, from 0), `quantities`
    (its parameters as they are read), `rivals` and `rejected` (effects that are not, and are, distinguished from it).
    """
    torques, findings = of_torques(document), _detailed(document)
    return [
        {
            **findings[k],
            "title": capital(effect_title(findings[k])),
            "statement": finding_statement(findings[k], torques),
            "place": k,
            "quantities": quantities(findings[k], torques),
            "rivals": rivals(findings[k], torques),
            "rejected": rivals(findings[k], torques, rejected=True),
        }
        for k in ranking.order(document)
    ]


def _detailed(document: Document) -> list[dict[str, Any]]:
    """The findings with the fields of their effects, which the model has; tolerances of joints come after them."""
    pairs = zip(document["findings"], document["model"]["effects"], strict=False)
    return [{**finding, "where": effect["where"]} for finding, effect in pairs]


def finding_statement(finding: Entry, torques: bool = False) -> str:
    """A finding in one sentence, with its numbers and its contribution.

    Args:
        finding: with the fields of its effect as `where`.
        torques: whether it acts on torques.
    """
    said = "is significant" if ranking.is_significant(finding) else "is likely"
    shown = ", ".join(str(size) for size in quantities(finding, torques) if size.std)
    if torques:
        pairs = (("moves_rms_Nm", "Nm RMS to the torque"), ("moves_rms_N", "N RMS to the force"))
        adds = " and ".join(f"{significant(finding[key])} {words}" for key, words in pairs if key in finding)
        if finding["effect"] == "unnamed":
            return _unnamed_torque(finding, adds)
        return f"{capital(effect_title(finding))} {said}: {shown}; it contributes {adds}."
    site, where, turned = finding["site"], finding["where"], finding["moves_rms_rad"]
    driver = "" if finding["driver"] == "none" else f", a function of the {with_articles(finding['driver'])}"
    turns = f" and turns it by {plus_minus(float(np.rad2deg(turned)))} deg" if turned else ""
    shown += f"; it moves the measured point by {plus_minus(1e3 * finding['moves_rms_m'])} mm RMS{turns}"
    if "peak_to_peak" not in finding:
        name = capital(finding["effect"].replace("_", " "))
        return f"{name}{detail(finding)} at {site}{driver}{',' if driver else ''} {said}: {shown}."
    many = f"{finding['effective_parameters']:.0f} effective parameters"
    return (
        f"No effect of the catalogue explains an effect at {site}{component(where)} as a function of the "
        f"{with_articles(finding['driver'])}: {shape(where)} ({many}), {shown}."
    )


def _unnamed_torque(finding: Entry, adds: str) -> str:
    """A curve of torques: its drivers, its contribution, and which named effects come nearest to it."""
    where, near = finding["where"], ""
    what = "force" if where.get("of_slide") else "torque"
    if "nearest" in finding:
        share = 100 * finding["nearest"]["share"]
        near = f" The nearest named effect, {effect_title(finding['nearest'])}, explains {share:.0f} % of it."
    return (
        f"No effect of the catalogue explains a {what} at {finding['site']} that is a function of the "
        f"{with_articles(finding['driver'])}: it contributes {adds}.{near}"
    )


def quantities(finding: Entry, torques: bool = False) -> list[Quantity]:
    """The numbers of a finding as they are read; of a nonparametric effect its peak to peak."""
    if not torques:
        return [quantity(*item) for item in finding.get("peak_to_peak", finding["parameters"]).items()]
    if key := peak_to_peak(finding):
        return [_chosen(key, finding[key])]
    return [quantity(name, estimate, OF_TORQUES) for name, estimate in finding["parameters"].items()]


def peak_to_peak(finding: Entry) -> str:
    """The key of the peak to peak of a curve of torques, which has its unit; empty of an effect with a name."""
    return next((key for key in ("peak_to_peak_Nm", "peak_to_peak_N") if key in finding), "")


def _chosen(name: str, value: float) -> Quantity:
    """A number on torques without a standard deviation, to three digits."""
    return quantity(name, {"value": float(f"{value:.3g}"), "std": 0.0}, OF_TORQUES)


def p_value_statement(finding: Entry) -> str:
    """How improbable a finding is without the effect; what else it rests on, where a model was chosen as a whole."""
    if not ranking.is_significant(finding):
        return "It is part of the likeliest model, and is not significant beside the other findings alone."
    p = finding["p_value"]  # one below what floats hold is not zero
    shown = f"p-value {p:.1e}" if p > 0 else "p-value below 1e-300"
    return f"Family-wise {shown} over all effects, sites and orders searched."


def rivals(finding: Entry, torques: bool = False, rejected: bool = False) -> list[str]:
    """The effects that the recording does not distinguish from a finding, or the nearest that explain clearly less.

    The nearest come first; on poses with their log evidence over its own.
    """
    entries = [rival for rival in distinct_rivals(finding) if (rival["status"] == "rejected") == rejected]
    if torques:
        return list(map(effect_title, entries))
    return [f"{effect_title(rival)} (log evidence {fixed(-rival['log_likelihood_gap'], 1, '+')})" for rival in entries]


# ------------------------------------------------------------------ what was not tested, and what to record


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
        fitted = document["nuisance"]["numbers"]
        if of_torques(document):
            reason = "What they depend on does not vary in this recording."
            confounded = "They are confounded with the inertial numbers that are fitted, or what they depend on does"
            confounded += " not vary."
        else:
            reason = "The sensor does not observe them in these poses."
            confounded = "They are confounded with the fitted frames and geometry, or the sensor does not observe them."
        found.append(Untested(confounded if fitted else reason, "", tuple(document["confounded"])))
    return found


def what_to_record(document: Document) -> list[str]:
    """A sentence for each question that this recording leaves open and another one answers."""
    lines, pairs, drivers = [], [], []
    for finding in _detailed(document):
        waves = [rival for rival in finding["confusable_with"] if _of_one_wave(finding, rival)]
        orders = [f"{rival['order']:.6g}" for rival in waves if rival["status"] == "undecided"]
        if orders:
            asked = f"record positions of {finding['site']} that are no multiples of one angle"
            lines.append(f"To separate {effect_title(finding)} from order {joined(orders, 'or')}, {asked}.")
        for rival in distinct_rivals(finding):
            pair = f"{effect_title(finding)} from {effect_title(rival)}"
            if rival["status"] == "separable":
                lines.append(f"To separate {pair}, record the poses below (separating_poses in the JSON file).")
            elif rival["status"] == "equivalent":
                same = f"{effect_title(finding)} and {effect_title(rival)} have the same effect at these poses"
                lines.append(f"{capital(same)}: more poses of this kind do not separate them.")
            elif rival["status"] == "undecided" and not _of_one_wave(finding, rival):
                pairs.append(pair)
                drivers += [f"the {driver}" for entry in (finding, rival) for driver in drivers_of(entry)]
    if pairs:
        several = dict.fromkeys(drivers)
        vary = f" in which {joined(several)} vary independently" if len(several) > 1 else ""
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
    if not document["confounded"]:
        return lines
    if of_torques(document):
        declare = "declare these numbers (`inertial` in the sidecar)"
        asked = f"To test for effects that are confounded with the inertial numbers, {declare}."
        return [*lines, asked] if document["nuisance"]["numbers"] else lines
    parts = joined(words for part, words in _PARTS.items() if part in document["nuisance"]["parts"])
    steps = [f"declare {parts}"] if parts else []
    steps += [] if document["model"]["orientation"] else ["measure orientations too"]
    asked = f"To test for effects that are confounded or not observed, {' and '.join(steps)}."
    return [*lines, asked] if steps else lines


def _of_one_wave(finding: Entry, rival: Entry) -> bool:
    """Whether two effects are orders of one joint that these positions do not tell apart."""
    return "order" in rival and (finding["effect"], finding["site"]) == (rival["effect"], rival["site"])
