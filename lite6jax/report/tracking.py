"""The report of a diagnosis of commands and measured joints: sentences and sections of its JSON document.

The texts are in `templates/tracking.yaml` and `sentences.tracking`; causes of torques are those of
`templates/remedies.yaml`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lite6jax.domains.base import DomainName
from lite6jax.domains.tracking.words import TRACKING_WORDS
from lite6jax.errors import command_line
from lite6jax.formatting import capital, multiple, number, quantity, row_ranges, significant
from lite6jax.report.faults import fault_name, with_fault_statements
from lite6jax.report.remedies import REMEDIES, distinct_rivals, effect_name, effect_title, place_of
from lite6jax.report.sentences import tracking as sentences
from lite6jax.report.words import fill, read_texts

Document = Mapping[str, Any]
Entry = Mapping[str, Any]
Part = tuple[str, list[tuple[str, Any]]]
"""The heading of a section and its blocks."""

DOMAIN: DomainName = "tracking"
_TEXTS = read_texts("tracking.yaml")
_MRAD = 1e3
_ERROR = "heldout_rollout_rms_rad"
_BY_JOINT = "heldout_rollout_rms_by_joint_rad"
_P95 = "heldout_rollout_p95_rad"
_P95_BY_JOINT = "heldout_rollout_p95_by_joint_rad"
_PEERS = {
    "commanded": "measured = commanded",
    "best_delay": "best delay",
    "second_order": "second order",
    "simulator": "your simulator",
}
"""What is compared with, by its key in the document, as it is called: without a model of the arm, and a simulator."""
_MENTIONED = 0.001
"""Share of the samples, from which clipped commands, contacts and limits are said."""
_LATE = 5e-5
"""s of delay, from which it is said beside a lag."""
_MATTERS = 0.5
"""Of the difference of two rollouts, that is left with fine steps where those of the file make the difference."""
_RATIOS = {"servo_stiffness", "servo_damping"}
"""Effects whose numbers are ratios to those of the model: what it has is another."""
_OF_TORQUES = REMEDIES["torques"]
"""Of effects that act in servos as in motors."""
_TIMING = {"command_delay", "time_offset", "command_filter", "servo_damping", "viscous_friction", "servo_feedforward"}
_LOAD = {
    *("servo_stiffness", "payload_error", "base_tilt", "link_mass", "link_com", "encoder_offset", "encoder_scale"),
    "joint_spring",
}
_REVERSAL = {"dead_band", "coulomb_friction", "stribeck_friction", "load_friction", "backlash"}
"""Effects that the same kind of motion tells apart."""


# ------------------------------------------------------------------ sentences


def with_statements(document: Document) -> dict[str, Any]:
    """The document with a `statement` for each finding and each data fault."""
    stated = with_fault_statements(document)
    stated["findings"] = [{**finding, "statement": finding_statement(finding)} for finding in document["findings"]]
    return stated


def finding_statement(finding: Entry) -> str:
    """A finding in a sentence, with its numbers and what it moves."""
    estimates = finding.get("peak_to_peak", finding["parameters"])
    numbers = ", ".join(
        str(quantity(name, estimate, TRACKING_WORDS.special_units)) for name, estimate in estimates.items()
    )
    moves = number(_MRAD * finding["moves_rms_rad"])
    return sentences.finding_sentence(finding, capital(effect_title(finding)), numbers, moves)


def cause_of(finding: Entry) -> str:
    """The cause of a finding, a clause in small letters."""
    place = place_of(finding["site"])
    if finding.get("component"):
        return sentences.shift_of_loop(finding["component"], finding["site"])
    text = _TEXTS["causes"].get(finding["effect"])
    if text is not None:
        return text["cause"].format(place=place)
    remedy = _OF_TORQUES.get(finding["effect"])
    cause = "{place} has " + finding["effect"].replace("_", " ") if remedy is None else remedy.cause
    return cause.format(place=place, exerted="torque", source="another joint")


def action_of(finding: Entry) -> str:
    """What to do about a finding."""
    if finding["effect"] in _TEXTS["causes"]:
        return _TEXTS["causes"][finding["effect"]]["action"]
    if finding["effect"] == "unnamed":
        return "The model in the JSON file contains it, and `predict` uses it; no simulator has a name for it."
    return _OF_TORQUES[finding["effect"]].action.replace("{exerted}", "torque")


def ranked(document: Document) -> list[Entry]:
    """The findings, the largest contribution first."""
    return sorted(document["findings"], key=lambda finding: -finding["moves_rms_rad"])


def findings_of(document: Document) -> list[dict[str, Any]]:
    """The findings, the largest contribution first, with `rank` (from 1), `title`, `statement` and `contribution`."""
    return [
        {
            **finding,
            "rank": rank,
            "title": capital(effect_title(finding)),
            "statement": finding_statement(finding),
            "contribution": f"{number(_MRAD * finding['moves_rms_rad'])} mrad",
        }
        for rank, finding in enumerate(ranked(document), 1)
    ]


def headline(document: Document) -> str:
    """The cause and its worth, in one sentence; what there is instead where none is."""
    findings = ranked(document)
    after = number(_MRAD * document["after"][_ERROR])
    if findings:
        before = number(_MRAD * document["before"][_ERROR])
        return sentences.headline_of_findings(cause_of(findings[0]), before, after, len(findings))
    sentence = sentences.headline_without_findings(document["verdict"], after)
    names = list(dict.fromkeys(fault_name(fault["fault"]).lower() for fault in document["data_faults"]))
    if names:
        return f"The data have a fault ({', '.join(names)}), which was corrected. {sentence}"
    return sentence


def following_statement(document: Document) -> str:
    """How the joint that improves most follows, what of its error is left, and what the model lacks there; a sentence.

    Without findings it is the joint with the largest error.
    """
    joint = _most_improved(document)
    servo = document["servos"][joint - 1]
    delay = ""
    if abs(servo["delay_s"]) > _LATE:
        delay = significant(1e3 * servo["delay_s"])
    sag = ""
    if document["masses"]:
        sag = significant(_MRAD * servo["sag_rad_per_Nm"])
    commanded = document["peers"]["commanded"][_BY_JOINT][joint - 1]
    after = document["after"][_BY_JOINT][joint - 1]
    there = [finding for finding in ranked(document) if joint in finding["joints"]]
    return sentences.joint_following(
        joint,
        lag=significant(1e3 * servo["lag_s"]),
        delay=delay,
        sag=sag,
        error=significant(_MRAD * commanded),
        remainder=significant(_MRAD * after),
        lacking=[_first_number(finding, "of") for finding in there if finding["effect"] not in _RATIOS],
        ratios=[_first_number(finding, "is") for finding in there if finding["effect"] in _RATIOS],
        has_simulator="simulator" in document,
    )


def _most_improved(document: Document) -> int:
    """The joint, from 1, whose held-out mean square falls most; where nothing was found, whose is largest."""
    before = np.square(document["before"][_BY_JOINT])
    if not document["findings"]:
        return 1 + int(np.argmax(before))
    return 1 + int(np.argmax(before - np.square(document["after"][_BY_JOINT])))


def _first_number(finding: Entry, verb: str) -> str:
    """The name of a finding and its first number, to three digits, with a word between them."""
    name = effect_name(finding["effect"])
    if finding["effect"] == "unnamed":
        added = f"shift of the {finding['component']}" if finding.get("component") else "torque"
        name = f"a {added} over the {finding['driver']}"
    estimates = finding.get("peak_to_peak", finding["parameters"])
    if not estimates:
        return name
    parameter, estimate = next(iter(estimates.items()))
    to_three_digits = float(f"{estimate['value']:.3g}")
    shown = quantity(parameter, {"value": to_three_digits, "std": 0.0}, TRACKING_WORDS.special_units)
    return f"{name} {verb} {shown.value} {shown.unit}".rstrip()


def verdict_statement(document: Document) -> str:
    """The verdict in a sentence or two."""
    sizes = [ratio for ratio in document["left"]["over_noise"].values() if ratio is not None]
    ends = dict.fromkeys(multiple(size) for size in (min(sizes), max(sizes)))
    near = document["nearest"]
    near_title = ""
    if near is not None:
        near_title = effect_title({**near, "driver": "none"})
    return sentences.verdict_sentence(document, " to ".join(ends), near_title)


def cautions(document: Document) -> list[str]:
    """What qualifies the verdict: effects that were not kept."""
    withdrawn = document["withdrawn"]
    if withdrawn is None:
        return []
    return [sentences.withdrawn_effects([effect_title(entry) for entry in withdrawn["effects"]])]


def simulator_statements(document: Document) -> list[str]:
    """How far a simulator's own rollouts are from those of the same model here, where they differ, and why."""
    simulator = document.get("simulator")
    if simulator is None:
        return []
    said = []
    if simulator["payload_left_out_kg"]:
        said.append(fill(_TEXTS["simulator"]["payload"], simulator, payload=number(simulator["payload_left_out_kg"])))
    if not simulator["differs"]:
        return said
    apart = simulator["apart_rms_by_joint_rad"]
    fine = simulator["apart_rms_by_joint_rad_at_fine_steps"]
    joint = max(range(len(apart)), key=lambda j: apart[j])
    reasons = [
        _TEXTS["simulator"]["reasons"][name]
        for name in ("clipped", "touching", "at_limit", "at_torque_limit")
        if simulator[f"{name}_share"] > _MENTIONED
    ]
    if max(fine) < _MATTERS * max(apart):
        reasons.append(
            fill(
                _TEXTS["simulator"]["steps"],
                simulator,
                step=number(1e3 * simulator["timestep_s"]),
                fine=number(_MRAD * fine[joint]),
            )
        )
    return [*said, sentences.simulator_differs(joint + 1, number(_MRAD * apart[joint]), reasons)]


def rivals(finding: Entry, rejected: bool = False) -> list[str]:
    """The effects that the log does not distinguish from a finding, or the nearest that explain clearly less."""
    entries = [rival for rival in distinct_rivals(finding) if (rival["status"] == "rejected") == rejected]
    return list(dict.fromkeys(effect_title(rival) for rival in entries if rival["status"] != "found"))


def what_to_record(document: Document) -> list[str]:
    """For each finding that may be another effect, the motion that tells."""
    lines = []
    for finding in ranked(document):
        undecided = [rival for rival in distinct_rivals(finding) if rival["status"] == "undecided"]
        if undecided:
            kinds = {finding["effect"], *(rival["effect"] for rival in undecided)}
            rival_titles = list(dict.fromkeys(effect_title(rival) for rival in undecided))[:2]
            motion = _TEXTS["motions"][_motion_of(kinds)]
            lines.append(
                fill(_TEXTS["record"], {"one": effect_title(finding), "others": rival_titles, "motion": motion})
            )
    return lines


def undetermined(document: Document) -> list[str]:
    """What the log does not determine, with what to record, a sentence for each reason."""
    return [
        fill(_TEXTS["undetermined"][entry["lacks"]], entry, names=[effect_name(name) for name in entry["effects"]])
        for entry in document.get("undetermined", ())
    ]


def _motion_of(effects: set[str]) -> str:
    """The kind of motion in which some effects differ."""
    for kind, differing in (("reversal", _REVERSAL), ("timing", _TIMING), ("load", _LOAD)):
        if len(effects & differing) > 1:
            return kind
    return "other"


# ------------------------------------------------------------------ tables and sections


def error_rows(document: Document) -> tuple[list[str], list[list[str]]]:
    """The table of held-out errors in mrad RMS: headers, and a row for each joint and for all."""
    return _error_table(document, "held-out error\n(mrad RMS)", _ERROR, _BY_JOINT)


def percentile_rows(document: Document) -> tuple[list[str], list[list[str]]]:
    """The same of what 95 % of the held-out errors of a joint, or of all, do not exceed, in mrad."""
    return _error_table(document, "error\n(mrad)", _P95, _P95_BY_JOINT)


def _error_table(document: Document, header: str, of_all: str, by_joint: str) -> tuple[list[str], list[list[str]]]:
    """A table of errors in mrad, by their keys in the document."""
    peers = document["peers"]
    columns = {name: peers[key] for key, name in _PEERS.items() if key in peers}
    columns |= {"before": document["before"]}
    if document["findings"]:
        columns |= {"after": document["after"]}
    rows = [
        [f"joint {joint}", *(number(_MRAD * column[by_joint][joint - 1]) for column in columns.values())]
        for joint in range(1, len(document["before"][by_joint]) + 1)
    ]
    rows.append(["all", *(number(_MRAD * column[of_all]) for column in columns.values())])
    # a terminal may be 60 columns wide
    headers = [header, *(name.replace(" ", "\n", 1) for name in columns)]
    return headers, rows


def servo_rows(document: Document) -> tuple[list[str], list[list[str]]]:
    """The servos as they are with the findings: headers, and a row for each joint."""
    headers = ["servo", "kp\n(Nm/rad)", "sag\n(mrad/Nm)", "lag\n(ms)", "delay\n(ms)", "friction\n(Nm)"]
    rows = [
        [
            f"joint {joint}",
            number(servo["stiffness_Nm_per_rad"]),
            number(_MRAD * servo["sag_rad_per_Nm"]),
            number(1e3 * servo["lag_s"]),
            number(1e3 * servo["delay_s"]),
            number(servo["coulomb_Nm"]),
        ]
        for joint, servo in enumerate(document["servos"], 1)
    ]
    return headers, rows


def steps(document: Document, recording: Path, diagnosis: Path | None) -> list[tuple[str, str]]:
    """Commands to copy: a purpose and a line each."""
    if diagnosis is None:
        diagnosis_path = Path(f"{recording.stem}_diagnosis.json")
        return [("Keep this diagnosis", command_line("diagnose", recording, "--out", diagnosis_path))]
    predicted = diagnosis.with_name(f"{recording.stem}_predicted.csv")
    purpose = "Joints that follow these commands; give commands of your own in their place"
    commands = [(purpose, command_line("predict", diagnosis, recording, "--out", predicted))]
    if what_to_record(document):
        designed = diagnosis.with_name(f"{recording.stem}_next.csv")
        purpose = "Commands to record next, which tell the findings from what they may be instead"
        commands.insert(0, (purpose, command_line("design", diagnosis, "--tracking", "--out", designed)))
    return commands


def parts_of(document: Document, files: Any, details: bool, pictures: Mapping[str, Any]) -> list[Part]:
    """The sections of a report with statements; arguments as of `sections.sections_of`."""
    faults = [
        (fault_name(fault["fault"]), fault["statement"], row_ranges(fault["rows"])) for fault in document["data_faults"]
    ]
    lines = [
        following_statement(document),
        verdict_statement(document),
        *cautions(document),
        sentences.setting(document),
    ]
    ruled_out = [entry["statement"] for entry in document["ruled_out"]]
    commands = []
    if files is not None:
        commands = steps(document, files.recording, files.diagnosis)
    drawn = [("picture", picture) for picture in pictures.values()]
    no_findings = [("text", "None: no effect of the catalogue, and no function of what was recorded, is significant.")]
    findings = [("bullets", _finding_lines(document, details))] if document["findings"] else no_findings
    return [
        ("", [("cause", (document["verdict"], headline(document))), *(("text", line) for line in lines)]),
        (
            "Held-out rollouts from the commands alone",
            [
                ("table", error_rows(document)),
                ("heading", "95 % of rows err by no more than"),
                ("table", percentile_rows(document)),
                ("text", sentences.held_out(document)),
                *(("text", line) for line in simulator_statements(document)),
                *drawn,
            ],
        ),
        ("Data faults", [("faults", faults)] if faults else []),
        ("Findings", findings),
        ("Servos", [("table", servo_rows(document))]),
        ("What to do", [("bullets", list(dict.fromkeys(action_of(finding) for finding in ranked(document))))]),
        ("What to record next", [("bullets", what_to_record(document))]),
        ("Not determined by this log", [("bullets", undetermined(document))]),
        ("Commands to copy", [("command", step) for step in commands]),
        ("Tested and ruled out", [("bullets", ruled_out)] if details and ruled_out else []),
    ]


def _finding_lines(document: Document, details: bool) -> Sequence[str]:
    """A line for each finding, with what it is not distinguished from."""
    lines = []
    for finding in ranked(document):
        p_value = finding["p_value"]
        shown = f"{p_value:.1e}" if p_value > 0 else "below 1e-300"
        line = f"{finding_statement(finding)} {fill(_TEXTS['p_value'], {'p': shown})}"
        near = rivals(finding)
        if near:
            line += f" Not distinguished from {', '.join(near)}."
        far = rivals(finding, rejected=True)
        if details and far:
            line += f" Nearest effects that were rejected: {', '.join(far)}."
        lines.append(line)
    return lines
