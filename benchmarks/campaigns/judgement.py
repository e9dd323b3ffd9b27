"""Whether what a diagnosis says is true: of each finding, of the verdict, of the whole statement, and of many trials.

Of poses and of torques alike; shares no code with the library.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.stats import beta

Row = dict[str, Any]
Grade = Literal["right", "partial", "misleading"]

WITHIN = 1.959964  # standard deviations on either side that hold 95 %
ORDER = 0.2  # by how much a harmonic's order may be off, or by two of its standard deviations
ADMITTED, GAP = 3, 6.0  # a set declared inseparable holds at most so many rivals, each within this log-likelihood
LEFT = 1.3  # times the noise above which something is left, whatever the verdict says
DETECTABLE = 2.0  # thresholds from which theory says that an effect can be found; a smaller one may be missed
LARGE, LARGE_IN_FEW, FEW = 1.5, 4.5, 60
"""Times the noise from which a missed effect contradicts the verdict; the second with fewer than `FEW` rows."""
DISTINGUISHED = 4.0
"""Standard deviations by which the data distinguish an effect from its nearest rival, so that its name is expected."""
_ROUNDING = 0.01
"""The share by which the size of a trial may be below the planned one: sizes are computed again of what is hidden."""
_EFFECT_OF_FAULT = {"sensor_scale": "measurement_scale", "joint_turns": "joint_offset"}
"""Faults of the data that say what a hidden effect is: a scale of the sensor, another zero of a joint."""
_ENDED = ("consistent", "explained")  # the verdicts that say that nothing is left


class Statement(NamedTuple):
    """A diagnosis beside its truth."""

    # right: every finding is true, and all that can be found is named; partial: nothing false is said, but something is
    # missing; misleading: a finding is false, or the verdict says that nothing is left where it is
    grade: Grade
    why: str  # what is false or missing; empty where it is right


def is_at_least(effect: Row, least: float) -> bool:
    """Whether a hidden effect is so many thresholds large, but for the rounding of a size that was planned as that."""
    return effect["size"] >= (1 - _ROUNDING) * least


def sites_of(effect: Row) -> Sequence[str]:
    """The site of a hidden effect, and outside the catalogue those that no recording tells from it."""
    return effect.get("sites", (effect["site"],))


def called(effect: Row) -> str:
    """What the library is to call a hidden effect."""
    return "unnamed" if "drivers" in effect else effect["effect"]


def same(effect: Row, finding: Row) -> bool:
    """Whether a finding is the hidden effect: name and site, a harmonic's order, a coupling's source, a driver."""
    if called(effect) == "unnamed":
        return unnamed_of(effect, finding)
    if (effect["effect"], effect["site"]) != (finding["effect"], finding["site"]):
        return False
    for key, slack in (("order", ORDER), ("source_joint", 0.5)):
        wanted = effect["parameters"].get(key)
        if wanted is None:
            continue
        said = finding["parameters"][key]
        if abs(value_of(said) - wanted) > max(slack, 2 * said["std"] if isinstance(said, dict) else 0.0):
            return False
    return True


def unnamed_of(effect: Row, finding: Row) -> bool:
    """Whether a finding without a name is a function at one of `sites_of` the effect, of a driver of the effect."""
    there = finding["effect"] == "unnamed" and finding["site"] in sites_of(effect)
    return there and is_driven(finding.get("driver", ""), drivers_of(effect))


def is_driven(driver: str, drivers: Sequence[Sequence[str]]) -> bool:
    """Whether a driver, or one of two, is one of those that a hidden effect has: one of its phrases, or begins so."""
    return any(said.startswith(phrase) for said in driver.split(" and ") for phrases in drivers for phrase in phrases)


def drivers_of(effect: Row) -> list[list[str]]:
    """The drivers of a hidden effect, each with the phrases that name it; none where it is a constant."""
    if "drivers" in effect:
        return effect["drivers"]
    site, number = effect["site"], effect["site"].lstrip("jointlk")
    match effect["effect"]:
        case "joint_scale" | "joint_harmonic":
            return [[f"position of joint {number}"]]
        case "joint_coupling":
            return [[f"position of joint {int(effect['parameters']['source_joint'])}"]]
        case "joint_compliance":
            return [[f"gravity torque of joint {number}"]]
        case "joint_backlash":
            return [[f"direction of motion of joint {number}"], [f"gravity torque of joint {number}"]]
        case "joint_lag":
            return [[f"velocity of joint {number}"]]
        case "link_compliance":
            return [[f"gravity moment {axis} of link {number}"] for axis in "xy"]
        case "base_compliance":
            return [[f"base moment {axis}"] for axis in "xy"]
        case "base_drift":
            return [["time"]]
        case "link_thermal_expansion":
            return [["temperature"]] if site.startswith("link") else []
        case "measurement_scale":
            return [["measured position"]]
    return []


def admits(effect: Row, finding: Row) -> bool:
    """Whether a finding is the hidden effect or lists it among the alternatives that are inseparable."""
    listed = [rival for rival in _effects_among(finding)[:ADMITTED] if rival["log_likelihood_gap"] <= GAP]
    return same(effect, finding) or any(
        rival["effect"] == called(effect) and rival["site"] in sites_of(effect) for rival in listed
    )


def _effects_among(finding: Row) -> list[Row]:
    """The alternatives of a finding that are effects; others are faults of the data."""
    return [rival for rival in finding.get("confusable_with", ()) if "fault" not in rival]


def named_by_faults(diagnosis: Row, hidden: Sequence[Row]) -> list[Row]:
    """The hidden effects that faults of the data name, as findings."""
    said = []
    for fault in diagnosis["data_faults"]:
        if fault["fault"] in _EFFECT_OF_FAULT:
            numbers = fault.get("numbers", {})
            site = f"joint{numbers['joint']}" if "joint" in numbers else "sensor"
            finding = {"effect": _EFFECT_OF_FAULT[fault["fault"]], "site": site, "parameters": {}}
            if any(same(effect, finding) for effect in hidden):
                said.append(finding)
    return said


def paired(hidden: Sequence[Row], findings: Sequence[Row], test: Callable[[Row, Row], bool]) -> bool:
    """Whether every hidden effect has a finding of its own that passes a test."""
    return not hidden or any(
        test(hidden[0], finding) and paired(hidden[1:], [*findings[:k], *findings[k + 1 :]], test)
        for k, finding in enumerate(findings)
    )


def value_of(parameter: Any) -> float:
    """Of a parameter with its standard deviation, or of a plain number."""
    return float(parameter["value"] if isinstance(parameter, dict) else parameter)


def grade(truth: Row, diagnosis: Row | None) -> Statement:
    """The grade of what a diagnosis says.

    A trial without an answer is misleading: whoever waits for one is left with nothing.
    """
    if diagnosis is None:
        return Statement("misleading", "no answer")
    hidden, findings = truth["hidden"], diagnosis["findings"]
    false = [f"{f['effect']}@{f['site']}" for f in findings if not is_true(f, hidden, findings)]
    with_said = [*findings, *named_by_faults(diagnosis, hidden)]
    missing = [effect for effect in hidden if not any(admits(effect, finding) for finding in with_said)]
    said = []
    if false:
        said.append(f"false: {', '.join(false)}")
    if hidden and diagnosis["verdict"] in _ENDED:
        left, large = _left(truth, diagnosis), LARGE_IN_FEW if truth["rows"] < FEW else LARGE
        missed = [
            e for e in missing if is_at_least(e, DETECTABLE) and e["moved_m"] * e["seen"] > large * truth["noise_m"]
        ]
        if left > LEFT:
            said.append(f"verdict {diagnosis['verdict']} with {left:.2g} times the noise left")
        elif missed:
            said.append(f"verdict {diagnosis['verdict']} without {_listed(missed)}")
    if said:
        return Statement("misleading", "; ".join(said))
    lacking = [effect for effect in hidden if not _whole(effect, with_said) and is_at_least(effect, DETECTABLE)]
    return Statement("partial", f"without the whole of {_listed(lacking)}") if lacking else Statement("right", "")


def is_true(finding: Row, hidden: Sequence[Row], findings: Sequence[Row]) -> bool:
    """Whether a finding is a hidden effect, says that it may be, or is a true part of one."""
    for effect in hidden:
        if admits(effect, finding) or unnamed_of(effect, finding):
            return True
        # the straight part of a function has a name, which is true only beside what is not straight
        beside = finding["effect"] in effect.get("beside", ()) and finding["site"] in sites_of(effect)
        if beside and any(unnamed_of(effect, other) for other in findings):
            return True
        part = finding["effect"] in effect.get("sum_of", ()) and finding["site"] in sites_of(effect)
        if part and is_summed(effect, findings):
            return True
    return False


def is_summed(effect: Row, findings: Sequence[Row]) -> bool:
    """Whether an effect outside the catalogue that is a sum of some inside it is found as that sum, at its site."""
    there = {finding["effect"] for finding in findings if finding["site"] in sites_of(effect)}
    return bool(effect.get("sum_of")) and there.issuperset(effect["sum_of"])


def _whole(effect: Row, findings: Sequence[Row]) -> bool:
    """Whether the findings say all of an effect: its name; or outside the catalogue, its site and every driver."""
    if called(effect) != "unnamed":
        return any(admits(effect, finding) for finding in findings)
    if is_summed(effect, findings):
        return True
    ours = [finding for finding in findings if unnamed_of(effect, finding)]
    if not ours:
        return any(admits(effect, finding) for finding in findings)
    return all(
        any(is_driven(finding.get("driver", ""), [phrases]) for finding in ours) for phrases in drivers_of(effect)
    )


def _left(truth: Row, diagnosis: Row) -> float:
    """What is left, per axis, over the noise that was declared: in positions or, where measured, in orientations."""
    position = diagnosis["after"].get("heldout_position_rms_m")
    ratios = [0.0 if position is None else position / math.sqrt(3) / truth["noise_m"]]
    orientation = diagnosis.get("left", {}).get("over_noise", {}).get("orientation")
    return max(*ratios, 0.0 if orientation is None else orientation)


def _listed(effects: Sequence[Row]) -> str:
    return ", ".join(f"{effect['effect']}@{effect['site']}" for effect in effects)


def score_findings(truth: Row, diagnosis: Row | None, seconds: float, error: str, moved: str) -> Row:
    """The columns of a trial's row that poses and torques share; `moved` is the key of what a hidden effect moves."""
    said = diagnosis or {"findings": [], "data_faults": [], "verdict": "none"}
    findings = sorted(said["findings"], key=lambda finding: -(finding.get("log_likelihood_gain") or 0.0))
    hidden = truth["hidden"]
    with_said = [*findings, *named_by_faults(said, hidden)]
    alone = len(with_said) == len(hidden)
    top, first = with_said[0] if with_said else None, hidden[0] if hidden else None
    keys = ("seed", "index", "rows", "kind", "engine", "arm", "noise", "fault", "edge", "sealed")
    return {key: truth[key] for key in keys} | {
        "error": error,
        "seconds": seconds,
        "verdict": said["verdict"],
        "planned_size": float(truth["sizes"][0]) if truth["sizes"] else None,
        "faults": [fault["fault"] for fault in said["data_faults"]],
        "hidden": [_of_hidden(effect, findings) | {moved: effect[moved]} for effect in hidden],
        "detected": bool(findings),
        "found": not error and bool(hidden) and paired(hidden, with_said, admits),
        "exact": not error and alone and paired(hidden, with_said, same),
        "exact_in_set": not error and alone and paired(hidden, with_said, admits),
        "top_site": bool(first and top and top["site"] in sites_of(first)),
        "top_named": bool(first and top and same(first, top)),
        "top_in_set": bool(first and top and admits(first, top)),
        "findings": [_of_finding(finding, hidden) for finding in findings],
    }


def _of_hidden(effect: Row, findings: Sequence[Row]) -> Row:
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
    return {key: effect[key] for key in ("effect", "site", "size", "seen")} | {
        "rival": rival["name"],
        "rival_site": rival["site"],
        "apart": rival["apart"],
        "site_found": any(finding["site"] in sites_of(effect) for finding in findings),
        "named": ours is not None or is_summed(effect, findings),
        "in_set": any(admits(effect, finding) for finding in findings) or is_summed(effect, findings),
        "numbers": numbers,
    }


def _of_finding(finding: Row, hidden: Sequence[Row]) -> Row:
    parameters = finding["parameters"]
    form = {key: value_of(parameters[key]) if key in parameters else None for key in ("order", "source_joint")}
    return (
        {key: finding[key] for key in ("effect", "site", "p_value")}
        | form
        | {
            "driver": finding.get("driver", ""),
            "gain": finding.get("log_likelihood_gain"),
            "true": any(same(effect, finding) for effect in hidden),
            "rivals": [f"{rival['effect']}:{rival['site']}" for rival in _effects_among(finding)],
        }
    )


# ------------------------------------------------------------------ shares and ratios of trials, and goals set on them


class Share(NamedTuple):
    """So many of so many, and the 95 % interval of the share (Clopper and Pearson, 1934)."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        """The share itself."""
        return self.hits / self.of if self.of else math.nan

    @property
    def low(self) -> float:
        """The interval's lower end."""
        return float(beta.ppf(0.025, self.hits, self.of - self.hits + 1)) if self.hits else 0.0

    @property
    def high(self) -> float:
        """The interval's upper end."""
        return float(beta.ppf(0.975, self.hits + 1, self.of - self.hits)) if self.hits < self.of else 1.0

    def __str__(self) -> str:
        return f"{self.short} of {self.of}" if self.of else "none"

    @property
    def short(self) -> str:
        """In words, where the count stands beside it."""
        return f"{100 * self.value:.3g} % ({_percent(self.low)}–{_percent(self.high)})" if self.of else "none"


def _percent(value: float) -> str:
    return f"{100 * value:.1f}" if 0 < value < 0.1 or 0.9 < value < 1 else f"{100 * value:.0f}"


def share(flags: Iterable[bool]) -> Share:
    """Of flags, those set."""
    found = [bool(flag) for flag in flags]
    return Share(sum(found), len(found))


class Ratio(NamedTuple):
    """A ratio of root mean squares over trials, and its 95 % interval by drawing trials again (B. Efron, 1979)."""

    value: float
    low: float
    high: float
    median: float
    of: int

    def __str__(self) -> str:
        said = f"{self.value:.2f} ({self.low:.2f}–{self.high:.2f}), median {self.median:.2f}, of {self.of}"
        return said if self.of else "none"


def ratio(ours: Sequence[float], theirs: Sequence[float], draws: int = 2000) -> Ratio:
    """Ratio of RMS errors, both in one unit, by paired bootstrap."""
    a, b = np.square(np.asarray(ours, float)), np.square(np.asarray(theirs, float))
    if not len(a) or not b.any():
        return Ratio(math.nan, math.nan, math.nan, math.nan, 0)
    chosen = np.random.default_rng(0).integers(0, len(a), (draws, len(a)))
    again = np.sqrt(a[chosen].sum(1) / np.maximum(b[chosen].sum(1), 1e-300))
    each = np.sqrt(a[b > 0] / b[b > 0])
    low, high = np.percentile(again, [2.5, 97.5])
    return Ratio(float(np.sqrt(a.sum() / b.sum())), float(low), float(high), float(np.median(each)), len(a))


class Goal(NamedTuple):
    """A goal."""

    asked: str  # in words, with the number
    reached: str  # the number with its interval
    met: bool | None  # None where there are no trials


def goal(
    asked: str, found: Share | Ratio, least: float = -math.inf, most: float = math.inf, upper: float = math.inf
) -> Goal:
    """A goal on a share or a ratio of trials, and on the upper end of its interval.

    Where there are no trials it is neither met nor missed.
    """
    met = least <= found.value <= most and found.high <= upper
    return Goal(asked, str(found), met if found.of else None)


def singles(rows: Iterable[Row], least: float = 0.0, most: float = math.inf) -> list[Row]:
    """The trials of one named effect whose planned size is between two."""
    return [row for row in rows if row["kind"] == "single" and least <= row["planned_size"] <= most]


def distinguishable(row: Row) -> bool:
    """Whether the data distinguish the one hidden effect from its nearest rival; not where none was sought."""
    apart = row["hidden"][0]["apart"]
    return apart is not None and apart >= DISTINGUISHED


def numbers(rows: Iterable[Row], least: float) -> list[Row]:
    """The estimated numbers of all effects that were named and are so many thresholds large, those with an interval.

    Reported orders are among them, also where the truth is a whole number and has no bound. Orders that are stated as
    exact have no interval; `exact_orders` counts them.
    """
    return [
        number | {"effect": effect["effect"], "size": effect["size"]}
        for row in rows
        for effect in row["hidden"]
        if is_at_least(effect, least)
        for number in effect["numbers"]
        if number["std"] > 0 and (number["bound"] > 0 or number["name"] == "order")
    ]


def covering(least: float) -> str:
    """The goal on `covered`, in words."""
    return f"95 % intervals cover, from {least:g} thresholds on: 93 to 97 %"


def covered(rows: Iterable[Row], least: float) -> Share:
    """Of the `numbers` of single effects and mixtures, those within their 95 % intervals."""
    kept = [row for row in rows if row["kind"] in ("single", "mixture")]
    return share(abs(number["off"]) <= WITHIN * number["std"] for number in numbers(kept, least))


def exact_orders(rows: Iterable[Row], least: float) -> Share:
    """Of the orders that were stated without an interval, of effects so many thresholds large, those exactly so."""
    return share(
        abs(number["off"]) < 1e-9
        for row in rows
        for effect in row["hidden"]
        if is_at_least(effect, least)
        for number in effect["numbers"]
        if number["name"] == "order" and not number["std"]
    )


def share_found(rows: Iterable[Row]) -> Share:
    """Of the trials that hide something and say whether all of it was found, those in which it was."""
    return share(row["found"] for row in rows if row["hidden"] and row["found"] is not None)
