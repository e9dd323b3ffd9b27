"""What a diagnosis is worth: of one trial beside its truth, and of many, every share with its 95 % interval."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.campaigns.shares import WITHIN, Goal, Ratio, Share, at_least, ratio, share
from benchmarks.concealed.chain import Array
from benchmarks.concealed.plans import NAMES_AT_STAKE, ROWS
from benchmarks.concealed.statements import (
    Row,
    admits,
    all_found,
    called,
    is_summed,
    judged,
    matched,
    same,
    value_of,
)

WRONG_NAMES, WRONG_NAMES_AT_MOST = 0.02, 0.04
"""The share of statements outside and at the edge that may be misleading, and the upper end of its interval."""
DISTINGUISHED = 4.0
"""Standard deviations by which the data distinguish an effect from its nearest rival, so that its name is expected."""


def scored(truth: Row, diagnosis: Row | None, predicted: Row | None, seconds: float, error: str) -> Row:
    """The row of a trial.

    Args:
        truth: the sealed one.
        diagnosis: what the library wrote; None where it wrote none.
        predicted: columns `x_m` …, `qw` … of the unseen motion.
        seconds: that diagnosis and prediction took.
        error: why there is no diagnosis or prediction.
    """
    keys = ("seed", "index", "kind", "engine", "arm", "sensor", "moving", "geometry", "mounted", "noise", "fault")
    row = {key: truth[key] for key in keys}
    hidden, measured = truth["hidden"], truth.get("rows", ROWS)
    statement = judged(truth, diagnosis, measured)
    diagnosis = diagnosis or {
        "findings": [],
        "data_faults": [],
        "verdict": "none",
        "before": {},
        "after": {},
        "noise": {},
    }
    findings = sorted(diagnosis["findings"], key=lambda finding: -finding.get("log_likelihood_gain", 0.0))
    names = [fault["fault"] for fault in diagnosis["data_faults"]]
    nearest = diagnosis.get("nearest") or {}
    row |= answered(hidden, findings, error) | {
        "rows": measured,
        "edge": truth.get("edge", ""),
        "masses_off": truth.get("masses_off", False),
        "sealed": truth.get("sealed", False),
        "statement": statement.grade,
        "why": statement.why,
        "error": error,
        "seconds": seconds,
        "verdict": diagnosis["verdict"],
        "planned_size": float(truth["sizes"][0]) if truth["sizes"] else None,
        "faults": names,
        "fault_found": _fault_of(truth["fault"]) in names,
        "before_m": diagnosis["before"].get("heldout_position_rms_m"),
        "after_m": diagnosis["after"].get("heldout_position_rms_m"),
        "noise_m": truth["noise_m"],
        "estimated_noise_m": diagnosis["noise"].get("estimated_position_m"),
        "nearest_effect": nearest.get("effect"),
        "nearest_site": nearest.get("site"),
        "nearest_p": nearest.get("p_value"),
        "hidden": [of_hidden(effect, findings) | {"moved_m": effect["moved_m"]} for effect in hidden],
        "moved_m": truth["moved_rms_m"],
    }
    return row | _unseen(truth, predicted)


def _fault_of(fault: str) -> str:
    return fault.split(" ")[0]


def answered(hidden: Sequence[Row], findings: Sequence[Row], error: str) -> Row:
    """What of a row says whether the findings, the largest first, are what is hidden."""
    top = findings[0] if findings else None
    first = hidden[0] if hidden else None
    return {
        "detected": bool(findings),
        "found": not error and all_found(hidden, findings),
        "exact": not error and matched(hidden, findings, same),
        "exact_in_set": not error and matched(hidden, findings, admits),
        "top_site": bool(first and top and top["site"] == first["site"]),
        "top_named": bool(first and top and same(first, top)),
        "top_in_set": bool(first and top and admits(first, top)),
        "findings": [_of_finding(finding, hidden) for finding in findings],
    }


def of_hidden(effect: Row, findings: Sequence[Row]) -> Row:
    """What of a row says how well an effect was found: its site, its name, and the error of each of its numbers."""
    ours = next((finding for finding in findings if same(effect, finding)), None)
    rival = effect["rival"] or {"name": "", "site": "", "apart": None}
    numbers = []
    if ours is not None and called(effect) != "unnamed":
        bounds = effect["bound"]
        if "order" in ours["parameters"]:
            # a whole order is no number to be found, but whoever reports it with an interval is to be right
            bounds = bounds | {"order": bounds.get("order", 0.0)}
        for name, bound in bounds.items():
            if name in ours["parameters"]:
                said, true = ours["parameters"][name], effect["parameters"][name]
                off = value_of(said) - true
                off = math.remainder(off, math.tau) if name == "phase_rad" else off
                numbers.append({"name": name, "true": true, "off": off, "std": float(said["std"]), "bound": bound})
    return {
        "effect": effect["effect"],
        "site": effect["site"],
        "size": effect["size"],
        "seen": effect["seen"],
        "rival": rival["name"],
        "rival_site": rival["site"],
        "apart": rival["apart"],
        "site_found": any(finding["site"] == effect["site"] for finding in findings),
        "named": ours is not None or is_summed(effect, findings),
        "in_set": any(admits(effect, finding) for finding in findings) or is_summed(effect, findings),
        "numbers": numbers,
    }


def _of_finding(finding: Row, hidden: Sequence[Row]) -> Row:
    parameters = finding["parameters"]
    return {
        "effect": finding["effect"],
        "site": finding["site"],
        "driver": finding.get("driver", ""),
        "p_value": finding["p_value"],
        "gain": finding.get("log_likelihood_gain"),
        "order": value_of(parameters["order"]) if "order" in parameters else None,
        "source_joint": value_of(parameters["source_joint"]) if "source_joint" in parameters else None,
        "true": any(same(effect, finding) for effect in hidden),
        "rivals": [f"{rival['effect']}:{rival['site']}" for rival in finding.get("confusable_with", ())],
    }


def _unseen(truth: Row, predicted: Row | None) -> Row:
    oracle = truth["oracle"]
    row: Row = {
        "unseen_m": None,
        "unseen_rad": None,
        "unseen_missing": None,
        "inside_components": None,
        "inside_covered": None,
        "outside_components": None,
        "outside_covered": None,
        "oracle_m": oracle["unseen_position_rms_m"],
        "oracle_rad": oracle["unseen_rotation_rms_rad"],
    }
    if predicted is None:
        return row
    actual = np.array(truth["unseen_position_m"])
    said = np.column_stack([predicted[name] for name in ("x_m", "y_m", "z_m")])
    there = np.isfinite(said).all(1)
    row["unseen_missing"] = float(np.mean(~there))
    if there.any():
        row["unseen_m"] = float(np.sqrt(np.mean(np.sum((said - actual)[there] ** 2, 1))))
        if truth["noise_rad"] and "qw" in predicted:
            q = np.column_stack([predicted[name] for name in ("qw", "qx", "qy", "qz")])[there]
            row["unseen_rad"] = float(
                np.sqrt(np.mean(turn_between(q, np.array(truth["unseen_quaternion"])[there]) ** 2))
            )
    return row | _covered(truth, predicted, said - actual, np.asarray(there))


def _covered(truth: Row, predicted: Row, off: Array, there: NDArray[np.bool_]) -> Row:
    """How many position components there are, and how many within the bars that hold 95 %, inside and outside.

    The bars are without the sensor's noise: it is drawn for both, from the declared distribution.
    """
    if "x_std_m" not in predicted:
        return {}
    noise = truth["noise_m"]
    std = np.hypot(np.column_stack([predicted[name] for name in ("x_std_m", "y_std_m", "z_std_m")]), noise)
    drawn = np.random.default_rng([truth["seed"], truth["index"]]).normal(0.0, noise, off.shape)
    within, outside = np.abs(off + drawn) <= WITHIN * std, np.array(predicted["outside"]) == 1
    row: Row = {}
    for name, rows in (("inside", there & ~outside), ("outside", there & outside)):
        row |= {f"{name}_components": 3.0 * rows.sum(), f"{name}_covered": float(within[rows].sum())}
    return row


def turn_between(a: Array, b: Array) -> Array:
    """`(sample,)` rad between unit quaternions, exact for small turns."""
    opposite = np.sign(np.sum(a * b, 1))[:, None]
    return 4 * np.arcsin(np.clip(np.linalg.norm(a - opposite * b, axis=1) / 2, 0, 1))


def singles(rows: Iterable[Row], least: float = 0.0, most: float = math.inf) -> list[Row]:
    """The trials of one named effect whose planned size is between two."""
    return [row for row in rows if row["kind"] == "single" and least <= row["planned_size"] <= most]


def distinguishable(row: Row) -> bool:
    """Whether the data distinguish the one hidden effect from what it is most easily taken for (`rivals`)."""
    return (row["hidden"][0]["apart"] or 0.0) >= DISTINGUISHED


def numbers(rows: Iterable[Row], least: float) -> list[Row]:
    """The estimated numbers of all effects that were named and are so many thresholds large, those with an interval.

    Reported orders are among them, also where the truth is a whole number and has no bound. Orders that are stated as
    exact have no interval; `exact_orders` counts them.
    """
    return [
        number | {"effect": effect["effect"], "size": effect["size"]}
        for row in rows
        for effect in row["hidden"]
        if effect["size"] >= least
        for number in effect["numbers"]
        if number["std"] > 0 and (number["bound"] > 0 or number["name"] == "order")
    ]


def exact_orders(rows: Iterable[Row]) -> Share:
    """Of the orders that were stated without an interval, those that are exactly so."""
    return share(
        abs(number["off"]) < 1e-9
        for row in rows
        for effect in row["hidden"]
        for number in effect["numbers"]
        if number["name"] == "order" and not number["std"]
    )


def wrong_names(rows: Iterable[Row]) -> Share:
    """Of the trials outside the catalogue and at its edge, those in which something false is said."""
    return share(row["statement"] == "misleading" for row in at_stake(rows))


def at_stake(rows: Iterable[Row]) -> list[Row]:
    """The trials outside the catalogue and at its edge that were judged."""
    return [row for row in rows if row["kind"] in NAMES_AT_STAKE and row["statement"]]


def share_found(rows: Iterable[Row]) -> Share:
    """Of the trials that hide something, those all of whose effects were found; results of version 0.1 do not say."""
    return share(row["found"] for row in rows if row["hidden"] and row["found"] is not None)


def against_oracle(rows: Iterable[Row]) -> Ratio:
    """The error on the unseen motion beside the oracle's, each in units of the sensor's noise."""
    kept = [row for row in rows if row["unseen_m"] is not None]
    return ratio([row["unseen_m"] / row["noise_m"] for row in kept], [row["oracle_m"] / row["noise_m"] for row in kept])


def goals(rows: Sequence[Row]) -> list[Goal]:
    """The goals of the project, honestly."""
    twice = singles(rows, 2.0, 2.0)
    clean = [row for row in rows if row["kind"] == "clean" and not row["error"]]  # no answer is no false alarm
    outside = [row for row in rows if row["kind"] == "outside"]
    distinct = [row for row in twice if distinguishable(row)]
    large = [row for row in rows if row["kind"] in ("single", "mixture")]
    covered = share(abs(number["off"]) <= WITHIN * number["std"] for number in numbers(large, 3.0))
    known = [row for row in large if all(effect["size"] >= 2 for effect in row["hidden"])]
    declared = [row for row in clean if row["noise"] == "as declared"]
    found, sited = share_found(twice), share(row["top_site"] for row in twice)
    found_distinct, wrong = share_found(distinct), wrong_names(rows)
    sited_distinct = share(row["top_site"] for row in distinct)
    alarms, alarms_declared = share(row["detected"] for row in clean), share(row["detected"] for row in declared)
    unseen = against_oracle(known)
    unnamed = share(row["hidden"][0]["named"] for row in outside)
    listed = share(row["hidden"][0]["in_set"] for row in outside)
    unnamed_distinct = share(row["hidden"][0]["named"] for row in outside if distinguishable(row))
    bars_inside, bars_outside = within_bars(rows, "inside"), within_bars(rows, "outside")
    few_wrong = wrong.value <= WRONG_NAMES and wrong.high <= WRONG_NAMES_AT_MOST if wrong.of else None
    return [
        Goal("wrong names, outside the catalogue and at its edge: 2 %, upper end 4 %", str(wrong), few_wrong),
        Goal("found at twice the threshold, effect and site: 95 %", str(found), at_least(found, 0.95)),
        Goal(
            "— where the data distinguish it from all other names", str(found_distinct), at_least(found_distinct, 0.95)
        ),
        Goal("at the right site at twice the threshold: 90 %", str(sited), at_least(sited, 0.9)),
        Goal(
            "— where the data distinguish it from all other names", str(sited_distinct), at_least(sited_distinct, 0.9)
        ),
        Goal("false alarms, upper end of the interval: 1 %", str(alarms), alarms.high <= 0.01 if clean else None),
        Goal("— noise as declared", str(alarms_declared), alarms_declared.high <= 0.01 if declared else None),
        Goal("unseen error: 1.1 × the oracle's", str(unseen), unseen.value <= 1.1 if unseen.of else None),
        Goal(
            "95 % intervals cover, from three thresholds on: 93 to 97 %",
            str(covered),
            0.93 <= covered.value <= 0.97 if covered.of else None,
        ),
        Goal("outside the catalogue: unnamed, at its site, by its driver: 90 %", str(unnamed), at_least(unnamed, 0.9)),
        Goal("— or listed among the alternatives", str(listed), None),
        Goal(
            "— where the data distinguish it from names, and from functions elsewhere or of others",
            str(unnamed_distinct),
            at_least(unnamed_distinct, 0.9),
        ),
        Goal(
            "95 % bars of predictions hold unseen positions: 93 to 97 %",
            _in_percent(bars_inside),
            0.93 <= bars_inside <= 0.97 if np.isfinite(bars_inside) else None,
        ),
        Goal(
            "— outside what was recorded: 90 %",
            _in_percent(bars_outside),
            bars_outside >= 0.9 if np.isfinite(bars_outside) else None,
        ),
    ]


def within_bars(rows: Iterable[Row], where: str) -> float:
    """The share of unseen position components within the bars that hold 95 %; NaN where there are none.

    Components of a trial depend on each other, so it has no interval of independent draws.

    Args:
        rows: of trials.
        where: "inside" or "outside" of what was recorded.
    """
    kept = [row for row in rows if row[f"{where}_components"]]
    count = sum(row[f"{where}_components"] for row in kept)
    return sum(row[f"{where}_covered"] for row in kept) / count if count else math.nan


def _in_percent(share: float) -> str:
    return f"{100 * share:.3g} %" if math.isfinite(share) else "none"
