"""The campaign of the torque trials: what its results hold, what a diagnosis is worth, and the goals."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
import pyarrow as pa

from benchmarks.campaigns import command, judgement
from benchmarks.campaigns.campaign import FLAG, NUMBER, TEXT, Campaign, Section, schema_of
from benchmarks.campaigns.judgement import Goal, Row, Share, goal, share
from benchmarks.torque_trials.effects import FAMILIES
from benchmarks.torque_trials.plans import DATA_FAULTS, ROUNDS
from benchmarks.torque_trials.trials import draw

_OVERLAP = 0.5  # the share of the rows of a contact and of those said to be one that are to be both
_SAME_ZERO, _SAME_FACTOR, _SAME_GRAVITY = 0.06, 0.15, 1.0
"""rad, relative, and m/s²: how well a fault's size is to be said."""
_ABSURD_KG, _ABSURD_M = 1.0, 0.1
SCHEMA = schema_of(
    "moved_Nm",
    {
        "inertial source": TEXT,
        "wrong_name absurd": FLAG,
        "before_Nm after_Nm unseen_Nm bound_Nm": NUMBER,
        "false": pa.list_(TEXT),
    },
)


def score(truth: Row, diagnosis: Row | None, predicted: Row | None, seconds: float, error: str) -> Row:
    """The row of a trial; `predicted` has columns `tau1_Nm` … of the unseen motion."""
    hidden = truth["hidden"]
    said = diagnosis or {"findings": [], "data_faults": [], "before": {}, "after": {}}
    false = [f for f in said["findings"] if not judgement.is_true(f, hidden, said["findings"])]
    return judgement.score_findings(truth, diagnosis, seconds, error, "moved_Nm") | {
        "inertial": truth["inertial"],
        "source": truth["source"],
        "false": [f"{finding['effect']}@{finding['site']}" for finding in false],
        "wrong_name": any(finding["effect"] != "unnamed" for finding in false),
        "fault_found": bool(truth["fault"]) and _located(truth, said["data_faults"], error),
        "absurd": any(map(_is_absurd, said["findings"])),
        "before_Nm": said["before"].get("heldout_torque_rms_Nm"),
        "after_Nm": said["after"].get("heldout_torque_rms_Nm"),
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
    most = {"link_mass": _ABSURD_KG, "payload_error": _ABSURD_KG, "payload_body": _ABSURD_KG, "link_com": _ABSURD_M}
    values = (value for name, value in finding["parameters"].items() if name.endswith(("_kg", "_m")))
    return any(abs(judgement.value_of(value)) > most.get(finding["effect"], np.inf) for value in values)


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


def goals(rows: Sequence[Row], known: float) -> list[Goal]:
    """The goals of the project, honestly; intervals are to hold from so many thresholds on."""
    clean = [row for row in rows if row["kind"] == "clean" and not row["error"]]  # no answer is no false alarm
    twice = judgement.singles(rows, 2.0, 2.0)
    catalogued = [row for row in rows if row["kind"] in ("clean", "single", "mixture")]
    spoilt = [row for row in rows if row["fault"] in DATA_FAULTS]
    outside = [row for row in rows if row["kind"] == "outside"]
    contacts = [row for row in rows if row["fault"] == "contact"]
    in_set = "— right site and name, or within the set said inseparable: 90 %"
    by_driver = "outside the catalogue: unnamed, at its joint, by its driver: 90 %"
    return [
        goal("false alarms, upper end of the interval: 1 %", share(row["detected"] for row in clean), upper=0.01),
        goal("single effects at twice the threshold, found: 95 %", judgement.share_found(twice), least=0.95),
        goal(in_set, share(row["top_in_set"] for row in twice), least=0.9),
        goal("wrong names outside the catalogue: 2 %", share(row["wrong_name"] for row in outside), most=0.02),
        goal(judgement.covering(known), judgement.covered(rows, known), 0.93, 0.97),
        goal(by_driver, share(row["hidden"][0]["named"] for row in expected(rows)), least=0.9),
        goal("unseen torques within their bound: 95 %", within_bound(catalogued), least=0.95),
        goal("contacts found, with their rows: 95 %", share(row["fault_found"] for row in contacts), least=0.95),
        goal(
            "faults of the file said, with joints and sizes: 95 %",
            share(row["fault_found"] for row in spoilt),
            least=0.95,
        ),
        goal("— that became absurd inertias: none", share(row["absurd"] for row in spoilt), most=0.0),
    ]


def unseen(rows: Sequence[Row]) -> Section:
    """Errors on the unseen motion beside their bound."""
    cells = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        kept = [row for row in rows if row["kind"] == kind]
        over = [row["unseen_Nm"] / row["bound_Nm"] for row in kept if row["unseen_Nm"] is not None]
        spread = [f"{np.median(over):.2f}", f"{np.percentile(over, 90):.2f}"] if over else ["none", "none"]
        cells.append((kind, str(len(kept)), within_bound(kept).short, *spread))
    return "Unseen motion", ("", "trials", "within the bound", "error over the bound, median", "90 %"), cells


TORQUES = Campaign("torque", 500, 4.0, ROUNDS, SCHEMA, draw, score, goals, unseen)


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where a goal is missed, 2 for arguments that cannot be used, 130 where interrupted."""
    return command.main(TORQUES, arguments)
