"""The campaign of the torque trials: what its results hold, what a diagnosis is worth, and the goals."""

import math
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pyarrow as pa

from benchmarks.campaigns import command
from benchmarks.campaigns.campaign import FLAG, NUMBER, TEXT, Campaign, Section, schema_of
from benchmarks.campaigns.columns import csv_text
from benchmarks.campaigns.judgement import Row, covered, is_true, scored_by_findings, share_found, singles, value_of
from benchmarks.campaigns.report import KNOWN
from benchmarks.campaigns.shares import Goal, Share, at_least, at_most, covers, goal, share, short
from benchmarks.torque_trials.outside import FAMILIES
from benchmarks.torque_trials.plans import DATA_FAULTS, KINDS, ROUNDS
from benchmarks.torque_trials.trials import draw

_UNTOUCHED = 0.05
"""The share by which the held-out error may change where nothing is hidden."""
_OVERLAP = 0.5
"""The share of the rows of a contact and of those said to be one that are to be both."""
_SAME_ZERO, _SAME_FACTOR, _SAME_GRAVITY = 0.06, 0.15, 1.0
"""rad, relative, and m/s²: how well a fault's size is to be said."""
_ABSURD_KG, _ABSURD_M = 1.0, 0.1
_NAMES = {"link_mass": "link_mass_error", "link_com": "link_com_error", "time_offset": "torque_delay"}
_ARGUMENTS = {
    "viscous_Nm_s_per_rad": "b",
    "coulomb_Nm": "c",
    "stribeck_Nm": "s",
    "velocity_rad_per_s": "v",
    "coefficient": "mu",
    "viscous_Nm_s_per_rad_K": "k",
    "source_joint": "source",
    "offset_Nm": "o",
    "scale": "s",
    "inertia_kg_m2": "I",
    "stiffness_Nm_per_rad": "k",
    "rest_rad": "rest",
    "amplitude_Nm": "amplitude",
    "order": "order",
    "phase_rad": "phase",
    "mass_kg": "mass",
    "tilt_x_rad": "rx",
    "tilt_y_rad": "ry",
    "offset_s": "dt",
    "lag_s": "lag",
}
"""What the open cases call the numbers of an effect."""
SCHEMA = schema_of(
    "moved_Nm",
    {
        "inertial source": TEXT,
        "wrong_name absurd honest": FLAG,
        "before_Nm after_Nm unseen_Nm bound_Nm": NUMBER,
        "false": pa.list_(TEXT),
    },
)


def scored(truth: Row, diagnosis: Row | None, predicted: Row | None, seconds: float, error: str) -> Row:
    """The row of a trial; `predicted` has columns `tau1_Nm` … of the unseen motion."""
    hidden = truth["hidden"]
    said = diagnosis or {"findings": [], "data_faults": [], "before": {}, "after": {}}
    false = [f for f in said["findings"] if not is_true(f, hidden, said["findings"])]
    before, after = (said[key].get("heldout_torque_rms_Nm") for key in ("before", "after"))
    honest = None
    if before is not None and after is not None:
        honest = after < before if hidden else abs(after - before) <= _UNTOUCHED * before
    return scored_by_findings(truth, diagnosis, seconds, error, "moved_Nm") | {
        "inertial": truth["inertial"],
        "source": truth["source"],
        "false": [f"{finding['effect']}@{finding['site']}" for finding in false],
        "wrong_name": any(finding["effect"] != "unnamed" for finding in false),
        "fault_found": bool(truth["fault"]) and _located(truth, said["data_faults"], error),
        "absurd": any(map(_is_absurd, said["findings"])),
        "before_Nm": before,
        "after_Nm": after,
        "honest": honest,
        "unseen_Nm": _unseen(truth, predicted),
        "bound_Nm": truth["unseen_bound_Nm"],
    }


def _located(truth: Row, faults: Sequence[Row], error: str) -> bool:
    """Whether a fault is said where it is, or is among those that are said to be alike.

    A contact is where its rows are; a fault of the file has its joints and numbers. Another unit is refused.
    """
    if truth["fault"] == "torque_unit":
        return any(said in error for said in ("another unit", "are these", "check torque_constant_Nm_per_A"))
    if truth["fault"] == "contact":
        rows = set(truth["fault_rows"])
        said = [set(fault["rows"]) for fault in faults if fault["fault"] == "contact"]
        return any(len(rows & found) >= _OVERLAP * len(rows | found) for found in said)
    return any(
        _is_fault(truth, fault["fault"], fault["numbers"])
        or any(len(h) == 1 and _is_fault(truth, h[0]["fault"], h[0]) for h in fault["numbers"].get("alternatives", ()))
        for fault in faults
    )


def _is_fault(truth: Row, code: str, numbers: Row) -> bool:
    wanted, joints = truth["fault_numbers"], truth["fault_joints"]
    said = set(numbers.get("joints", [numbers["joint"]] if "joint" in numbers else []))
    if code != truth["fault"] or (joints and said != set(joints)):
        return False
    if "added_rad" in wanted:
        return abs(math.remainder(numbers["added_rad"] - wanted["added_rad"], math.tau)) < _SAME_ZERO
    if "factors" in wanted:
        return bool(np.allclose(numbers["factors"], wanted["factors"], rtol=_SAME_FACTOR))
    if "gravity_m_per_s2" in wanted:
        return bool(np.linalg.norm(np.subtract(numbers["found_m_per_s2"], wanted["gravity_m_per_s2"])) < _SAME_GRAVITY)
    return True


def _is_absurd(finding: Row) -> bool:
    """Whether a finding blames a body by more than any description is wrong."""
    values = [abs(value_of(number)) for name, number in finding["parameters"].items() if name.endswith(("_kg", "_m"))]
    most = {"link_mass": _ABSURD_KG, "payload_error": _ABSURD_KG, "payload_body": _ABSURD_KG, "link_com": _ABSURD_M}
    return any(value > most.get(finding["effect"], np.inf) for value in values)


def _unseen(truth: Row, predicted: Row | None) -> float | None:
    if predicted is None:
        return None
    actual = np.array(truth["unseen_torque_Nm"])
    names = [f"tau{i + 1}_Nm" for i in range(actual.shape[1])]
    if any(name not in predicted for name in names) or len(predicted[names[0]]) != len(actual):
        return None
    off = np.column_stack([predicted[name] for name in names]) - actual
    there = np.isfinite(off).all(1)
    return float(np.sqrt(np.mean(off[there] ** 2))) if there.mean() >= 0.97 else None


def expected(rows: Iterable[Row]) -> list[Row]:
    """The trials outside the catalogue in which a curve over something recorded can be the truth."""
    return [row for row in rows if row["kind"] == "outside" and not FAMILIES[row["hidden"][0]["effect"]].nameless]


def within_bound(rows: Iterable[Row]) -> Share:
    """Of the trials with an answer, those whose unseen torques are within the bound; without a prediction none is."""
    return share(
        row["unseen_Nm"] is not None and row["unseen_Nm"] <= row["bound_Nm"] for row in rows if not row["error"]
    )


def goals(rows: Sequence[Row]) -> list[Goal]:
    """The goals of the project, honestly."""
    clean = [row for row in rows if row["kind"] == "clean" and not row["error"]]  # no answer is no false alarm
    twice = singles(rows, 2.0, 2.0)
    known = [row for row in rows if row["kind"] in ("clean", "single", "mixture")]
    spoilt = [row for row in rows if row["fault"] in DATA_FAULTS]
    return [
        goal(
            "false alarms, upper end of the interval: 1 %",
            share(row["detected"] for row in clean),
            at_most(0.01, surely=True),
        ),
        goal("single effects at twice the threshold, found: 95 %", share_found(twice), at_least(0.95)),
        goal(
            "— right site and name, or within the set said inseparable: 90 %",
            share(row["top_in_set"] for row in twice),
            at_least(0.9),
        ),
        goal(
            "wrong names outside the catalogue: 2 %",
            share(row["wrong_name"] for row in rows if row["kind"] == "outside"),
            at_most(0.02),
        ),
        goal("95 % intervals cover, from four thresholds on: 93 to 97 %", covered(rows, KNOWN), covers),
        goal(
            "outside the catalogue: unnamed, at its joint, by its driver: 90 %",
            share(row["hidden"][0]["named"] for row in expected(rows)),
            at_least(0.9),
        ),
        goal("unseen torques within their bound: 95 %", within_bound(known), at_least(0.95)),
        goal(
            "contacts found, with their rows: 95 %",
            share(row["fault_found"] for row in rows if row["fault"] == "contact"),
            at_least(0.95),
        ),
        goal(
            "faults of the file said, with joints and sizes: 95 %",
            share(row["fault_found"] for row in spoilt),
            at_least(0.95),
        ),
        goal("— that became absurd inertias: none", share(row["absurd"] for row in spoilt), at_most(0.0)),
    ]


def unseen(rows: Sequence[Row]) -> Section:
    """Errors on the unseen motion beside their bound."""
    cells = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        kept = [row for row in rows if row["kind"] == kind]
        over = [row["unseen_Nm"] / row["bound_Nm"] for row in kept if row["unseen_Nm"] is not None]
        spread = [f"{np.median(over):.2f}", f"{np.percentile(over, 90):.2f}"] if over else ["none", "none"]
        cells.append((kind, str(len(kept)), short(within_bound(kept)), *spread))
    return "Unseen motion", ("", "trials", "within the bound", "error over the bound, median", "90 %"), cells


def story(truth: Row, row: Row) -> tuple[str, Iterator[str]]:
    """What is particular to a trial of torques."""
    return f"{truth['rate']:g} Hz of {truth['source']}, inertial numbers {truth['inertial']}", _errors(row)


def _errors(row: Row) -> Iterator[str]:
    if row["after_Nm"] is not None and row["before_Nm"] is not None:
        yield f"Held out: {1e3 * row['before_Nm']:.3g} mNm before, {1e3 * row['after_Nm']:.3g} mNm after."
    shown = "nothing predicted" if row["unseen_Nm"] is None else f"off by {1e3 * row['unseen_Nm']:.3g} mNm RMS"
    yield f"Unseen motion: {shown}, the bound is {1e3 * row['bound_Nm']:.3g} mNm."


def beside(name: str, truth: Row) -> tuple[dict[str, str], Row]:
    """An exported trial is like the open cases: effects with arguments, and torques of the unseen motion."""
    torque = np.array(truth["unseen_torque_Nm"])
    effects = [_told(effect) for effect in truth["hidden"]]
    if truth["fault_rows"]:
        first, last = truth["fault_rows"][0], truth["fault_rows"][-1]
        span = {"start": (first - 0.5) / truth["rate"], "stop": (last + 0.5) / truth["rate"]}
        effects.append({"effect": truth["fault"], "args": span})
    if truth["fault_joints"]:
        effects.append({"effect": truth["fault"], "args": {"joints": truth["fault_joints"]}})
    more = {
        "name": name,
        "effects": effects,
        "effect_rms_Nm": truth["unseen_effect_rms_Nm"],
        "unseen_limit_Nm": truth["unseen_bound_Nm"],
    }
    return {"unseen_truth.csv": csv_text({f"tau{i + 1}_Nm": column for i, column in enumerate(torque.T)})}, more


def _told(effect: Row) -> Row:
    args = {_ARGUMENTS[name]: value for name, value in effect["parameters"].items() if name in _ARGUMENTS}
    args |= {k: int(effect["site"][len(k) :]) for k in ("joint", "link") if effect["site"].startswith(k)}
    if "source" in args:
        args["source"] = int(args["source"])
    return {"effect": _NAMES.get(effect["effect"], effect["effect"]), "args": args}


TORQUES = Campaign("torque", 500, KINDS, ROUNDS.indices, SCHEMA, draw, scored, goals, unseen, story, beside)


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where a goal is missed, 2 for arguments that cannot be used, 130 where interrupted."""
    return command.main(TORQUES, arguments)
