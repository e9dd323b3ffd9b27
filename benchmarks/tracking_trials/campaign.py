"""The campaign of the logs of commands: what its results hold, what a diagnosis is worth, and the goals."""

import math
from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from benchmarks.campaigns import command, judgement
from benchmarks.campaigns.campaign import FLAG, NUMBER, TEXT, Campaign, Section, schema_of
from benchmarks.campaigns.judgement import DETECTABLE, LARGE, LEFT, Goal, Row, Share, goal, share
from benchmarks.tracking_trials.effects import FAMILIES
from benchmarks.tracking_trials.plans import ROUNDS
from benchmarks.tracking_trials.trials import draw

_VALUE, _STDS, _MOST = 0.05, 4.0, 0.3
"""A number is right within this share, or so many of its standard deviations, these at most the last share."""
_SAME_PHASE = 0.15  # rad
_HONEST = 0.05  # by which the error may change where nothing is hidden
_WHOLE = 0.97  # of the rows that a prediction must have
_ENDED = ("consistent", "explained")  # the verdicts that say that nothing is left
_REFUSED = {
    "degrees": ("same unit", "another unit", "times as far", "degrees"),
    "gear": ("gear", "times as far"),
    "torque_off": ("torque may be off", "hardly moves"),
    "saturated_readout": ("saturat", "end of its range"),
    "zero_per_run": ("zero",),
    "other_clock": ("clock",),
}
"""What an answer says, of which a part is enough, where a log is rightly refused."""
_CODES = {
    "degrees": ("position_unit", "joint_unit", "degrees"),
    "gear": ("gear", "joint_gear"),
    "zero_per_run": ("zero_per_run", "joint_zero"),
    "saturated_readout": ("saturated_readout",),
    "torque_off": ("torque_off",),
    "other_clock": ("other_clock", "clock"),
}
"""Codes of data faults that say it, beside the name of the fault itself."""
_OF_JOINTS = ("joints_swapped", "joint_sign")  # faults that are to be said with their joints
SCHEMA = schema_of(
    "moved_rad",
    {
        "servo statement why": TEXT,
        "value honest": FLAG,
        "noise_rad before_rad after_rad unseen_rad bound_rad commanded_rad": NUMBER,
        "false": pa.list_(TEXT),
    },
)


def score(truth: Row, diagnosis: Row | None, predicted: Row | None, seconds: float, error: str) -> Row:
    """The row of a trial; `predicted` has columns `q1_rad` … of the unseen motion."""
    hidden = truth["hidden"]
    said = diagnosis or {"findings": [], "data_faults": [], "before": {}, "after": {}}
    findings = said["findings"]
    false = [f for f in findings if not judgement.is_true(f, hidden, findings)]
    found = bool(truth["fault"]) and is_located(truth, said, error)
    labels = [f"{finding['effect']}@{finding['site']}" for finding in false]
    statement, why = grade(truth, diagnosis, labels, found)
    return judgement.score_findings(truth, diagnosis, seconds, error, "moved_rad") | {
        "servo": truth["servo"],
        "statement": statement,
        "why": why,
        "false": labels,
        "fault_found": found,
        "value": None if diagnosis is None else _are_numbers_right(hidden, findings),
        "honest": None if diagnosis is None else _is_honest(truth, diagnosis),
        "noise_rad": truth["noise_rad"],
        "before_rad": said["before"].get("heldout_rollout_rms_rad"),
        "after_rad": said["after"].get("heldout_rollout_rms_rad"),
        "unseen_rad": _unseen(truth, predicted),
        "bound_rad": truth["unseen_limit_rad"],
        "commanded_rad": truth["commanded_rms_rad"],
    }


def grade(truth: Row, diagnosis: Row | None, false: Sequence[str], fault_found: bool) -> tuple[str, str]:
    """What a diagnosis says: `right`, `partial` or `misleading`, and what is false or missing.

    Right: every finding is true, and all that can be found is named. Misleading: a finding is false, the verdict says
    that nothing is left where it is, or there is no answer to a log that is not to be refused.
    """
    if diagnosis is None:
        return ("right", "") if fault_found else ("misleading", "no answer")
    hidden, findings = truth["hidden"], diagnosis["findings"]
    missing = [e for e in hidden if not any(judgement.admits(e, f) for f in findings)]
    names = ", ".join(f"{effect['effect']}@{effect['site']}" for effect in missing)
    if false:
        return "misleading", f"false: {', '.join(false)}"
    if hidden and diagnosis["verdict"] in _ENDED:
        after = diagnosis["after"].get("heldout_rollout_rms_rad") or 0.0
        if after > LEFT * truth["noise_rad"] and missing:
            return "misleading", f"verdict {diagnosis['verdict']} with {after / truth['noise_rad']:.2g} times the noise"
        if any(effect["moved_rad"] * effect["seen"] > LARGE * truth["noise_rad"] for effect in missing):
            return "misleading", f"verdict {diagnosis['verdict']} without {names}"
    if truth["fault"] and not fault_found:
        return "partial", f"without {truth['fault']}"
    if any(judgement.is_at_least(effect, DETECTABLE) for effect in missing):
        return "partial", f"without {names}"
    return "right", ""


def is_located(truth: Row, said: Row, error: str) -> bool:
    """Whether a fault is said: with its joints where columns are corrected, or by refusing the log for it."""
    fault = truth["fault"]
    if any(phrase in error for phrase in _REFUSED.get(fault, ())):
        return True
    if fault == "other_clock" and any(finding["site"] == "clock" for finding in said["findings"]):
        return True
    for found in said["data_faults"]:
        if found["fault"] not in (fault, *_CODES.get(fault, ())):
            continue
        if fault not in _OF_JOINTS or _joints(found) == set(truth["fault_joints"]):
            return True
    return False


def _joints(fault: Row) -> set[int]:
    """Counted from 1; a document has numbers or names."""
    joints = fault.get("joints") or fault.get("numbers", {}).get("joints", ())
    return {int(str(joint).removeprefix("joint")) for joint in joints}


def _are_numbers_right(hidden: Sequence[Row], findings: Sequence[Row]) -> bool | None:
    """Whether every number of every named effect is right; None where none was named."""
    pairs = [
        (effect, finding)
        for effect in hidden
        if "drivers" not in effect
        for finding in findings
        if judgement.same(effect, finding)
    ]
    return all(_is_right(effect["parameters"], finding["parameters"]) for effect, finding in pairs) if pairs else None


def _is_right(true: Row, said: Row) -> bool:
    for name, wanted in true.items():
        if name not in said or name == "rest_rad":  # no log of a stiff servo knows where a soft spring rests
            continue
        off = judgement.value_of(said[name]) - wanted
        std = said[name]["std"] if isinstance(said[name], dict) else 0.0
        if name == "phase_rad":
            if abs(math.remainder(off, math.tau)) > max(_SAME_PHASE, _STDS * std):
                return False
            continue
        tilts = [abs(value) for key, value in true.items() if key.startswith("tilt")]
        scale = max(tilts) if name.startswith("tilt") else abs(wanted)
        if abs(off) > max(_VALUE * scale, min(_STDS * std, _MOST * scale)):
            return False
    return True


def _is_honest(truth: Row, diagnosis: Row) -> bool | None:
    before, after = (diagnosis[key].get("heldout_rollout_rms_rad") for key in ("before", "after"))
    if before is None or after is None:
        return None
    if not truth["hidden"]:
        return abs(after - before) <= _HONEST * before
    return after < before


def _unseen(truth: Row, predicted: Row | None) -> float | None:
    if predicted is None:
        return None
    actual = np.array(truth["unseen_readout_rad"])
    names = [f"q{i + 1}_rad" for i in range(actual.shape[1])]
    if any(name not in predicted for name in names) or len(predicted[names[0]]) != len(actual):
        return None
    off = np.column_stack([predicted[name] for name in names]) - actual
    whole = np.isfinite(off).all(1)
    return float(np.sqrt(np.mean(off[whole] ** 2))) if whole.mean() >= _WHOLE else None


def within_bound(rows: Sequence[Row]) -> Share:
    """Of the trials with an answer, those whose unseen rollout is within its limit; without a prediction none is."""
    return share(
        row["unseen_rad"] is not None and row["unseen_rad"] <= row["bound_rad"] for row in rows if not row["error"]
    )


def goals(rows: Sequence[Row], known: float) -> list[Goal]:
    """The goals of the project, honestly; intervals are to hold from so many thresholds on."""
    clean = [row for row in rows if row["kind"] == "clean" and not row["error"]]  # no answer is no false alarm
    large = judgement.singles(rows, known)
    catalogued = [row for row in rows if row["kind"] in ("clean", "single", "mixture")]
    outside = [row for row in rows if row["kind"] == "outside"]
    curves = [row for row in outside if not FAMILIES[row["hidden"][0]["effect"]].nameless]
    faulty = [row for row in rows if row["fault"]]
    flags = {name: [row[name] for row in catalogued if row[name] is not None] for name in ("value", "honest")}
    return [
        goal("false alarms, upper end of the interval: 1 %", share(row["detected"] for row in clean), upper=0.01),
        goal(f"single effects from {known:g} thresholds on, found: 95 %", judgement.share_found(large), least=0.95),
        goal(
            "— right site and name, or within the set said inseparable: 90 %",
            share(row["top_in_set"] for row in large),
            least=0.9,
        ),
        goal("numbers of named effects are right: 95 %", share(flags["value"]), least=0.95),
        goal(judgement.covering(known), judgement.covered(rows, known), 0.93, 0.97),
        goal("misleading, of all: 2 %", share(row["statement"] == "misleading" for row in rows), most=0.02),
        goal(
            "outside the table: unnamed, at its joint, by its driver: 90 %",
            share(row["hidden"][0]["named"] for row in curves),
            least=0.9,
        ),
        goal("unseen rollouts within their limit: 95 %", within_bound(catalogued), least=0.95),
        goal("held-out errors fall, or stay where nothing is hidden: 95 %", share(flags["honest"]), least=0.95),
        goal(
            "faults said, or refused for what they are: 95 %", share(row["fault_found"] for row in faulty), least=0.95
        ),
    ]


def unseen(rows: Sequence[Row]) -> Section:
    """By kind, errors on the unseen motion beside their limit, what is misleading, and whose numbers are right."""
    cells = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        ours = [row for row in rows if row["kind"] == kind]
        over = [row["unseen_rad"] / row["bound_rad"] for row in ours if row["unseen_rad"] is not None]
        spread = [f"{np.median(over):.2f}", f"{np.percentile(over, 90):.2f}"] if over else ["none", "none"]
        misleading = share(row["statement"] == "misleading" for row in ours)
        values = share(row["value"] for row in ours if row["value"] is not None)
        honest = share(row["honest"] for row in ours if row["honest"] is not None)
        shares = [within_bound(ours).short, *spread, misleading.short, str(values), str(honest)]
        cells.append((kind, str(len(ours)), *shares))
    head = ("", "trials", "within the limit", "error over the limit, median", "90 %")
    return "Unseen motion and statements", (*head, "misleading", "numbers right", "honest"), cells


TRACKING = Campaign("tracking", 24, 10.0, ROUNDS, SCHEMA, draw, score, goals, unseen)


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where a goal is missed, 2 for arguments that cannot be used, 130 where interrupted."""
    return command.main(TRACKING, arguments)
