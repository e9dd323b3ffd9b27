"""The campaign of the pose trials: what its results hold, what a diagnosis is worth beside its truth, and the goals."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.campaigns import command, judgement
from benchmarks.campaigns.campaign import FLAG, NUMBER, TEXT, Campaign, Section, schema_of
from benchmarks.campaigns.judgement import WITHIN, Goal, Ratio, Row, Share, goal, ratio, share
from benchmarks.concealed.plans import (
    HARD_NOISES,
    NAMES_AT_STAKE,
    NOISE_ROUNDS,
    NOISES,
    READ_ROUNDS,
    READERS,
    ROUNDS,
    ROWS,
    SENSORS,
)
from benchmarks.concealed.trials import draw, draw_noise, draw_reading

WRONG_NAMES, WRONG_NAMES_AT_MOST = 0.02, 0.04
"""The share of statements outside and at the edge that may be misleading, and the upper end of its interval."""
_ABSENT: Row = {"rows": ROWS, "edge": "", "masses_off": False, "sealed": False}  # defaults that `Plan.told` leaves out
_UNSEEN = ("unseen_m", "inside_components", "inside_covered", "outside_components", "outside_covered")
SCHEMA = schema_of(
    "moved_m",
    {
        "sensor geometry statement why nearest_effect nearest_site": TEXT,
        "moving mounted masses_off": FLAG,
        "before_m after_m noise_m estimated_noise_m nearest_p moved_m": NUMBER,
        " ".join((*_UNSEEN, "oracle_m")): NUMBER,
    },
)


def score(truth: Row, diagnosis: Row | None, predicted: Row | None, seconds: float, error: str) -> Row:
    """The row of a trial; `predicted` has columns `x_m` …, `qw` … of the unseen motion."""
    truth = _ABSENT | truth
    statement = judgement.grade(truth, diagnosis)
    row = judgement.score_findings(truth, diagnosis, seconds, error, "moved_m")
    said = diagnosis or {"data_faults": [], "before": {}, "after": {}, "noise": {}}
    nearest = said.get("nearest") or {}
    keys = ("arm", "sensor", "moving", "geometry", "mounted", "masses_off", "noise_m")
    row |= {key: truth[key] for key in keys} | _unseen(truth, predicted)
    row |= {f"nearest_{key}": nearest.get(key) for key in ("effect", "site")}
    return row | {
        "statement": statement.grade,
        "why": statement.why,
        "fault_found": truth["fault"].split(" ")[0] in row["faults"],
        "before_m": said["before"].get("heldout_position_rms_m"),
        "after_m": said["after"].get("heldout_position_rms_m"),
        "estimated_noise_m": said["noise"].get("estimated", {}).get("position_m"),
        "nearest_p": nearest.get("p_value"),
        "moved_m": truth["moved_rms_m"],
    }


def _unseen(truth: Row, predicted: Row | None) -> Row:
    """The error of predicted positions, and how many of their components lie within the bars that hold 95 %.

    Predicted bars exclude the sensor's noise. Its variance is added to them, and a noise draw to the truth.
    """
    row: Row = dict.fromkeys(_UNSEEN) | {"oracle_m": (truth.get("oracle") or {}).get("unseen_position_rms_m")}
    if predicted is None:
        return row
    said = np.column_stack([predicted[name] for name in ("x_m", "y_m", "z_m")])
    off, there = said - np.array(truth["unseen_position_m"]), np.isfinite(said).all(1)
    if there.any():
        row["unseen_m"] = float(np.sqrt(np.mean(np.sum(off[there] ** 2, 1))))
    if "x_std_m" in predicted:
        noise = truth["noise_m"]
        std = np.hypot(np.column_stack([predicted[name] for name in ("x_std_m", "y_std_m", "z_std_m")]), noise)
        drawn = np.random.default_rng([truth["seed"], truth["index"]]).normal(0.0, noise, off.shape)
        within, outside = np.abs(off + drawn) <= WITHIN * std, np.array(predicted["outside"]) == 1
        for name, rows in (("inside", there & ~outside), ("outside", there & outside)):
            row |= {f"{name}_components": 3.0 * rows.sum(), f"{name}_covered": float(within[rows].sum())}
    return row


def wrong_names(rows: Iterable[Row]) -> Share:
    """Of the trials outside the catalogue and at its edge that were judged, those in which something false is said."""
    judged = (row for row in rows if row["kind"] in NAMES_AT_STAKE and row["statement"])
    return share(row["statement"] == "misleading" for row in judged)


def against_oracle(rows: Iterable[Row]) -> Ratio:
    """The error on the unseen motion beside the oracle's, each in units of the sensor's noise."""
    kept = [row for row in rows if row["unseen_m"] is not None and row["oracle_m"] is not None]
    return ratio([row["unseen_m"] / row["noise_m"] for row in kept], [row["oracle_m"] / row["noise_m"] for row in kept])


def goals(rows: Sequence[Row], known: float) -> list[Goal]:
    """The goals of the project, honestly; intervals are to hold from so many thresholds on."""
    twice = judgement.singles(rows, 2.0, 2.0)
    clean = [row for row in rows if row["kind"] == "clean" and not row["error"]]  # no answer is no false alarm
    declared = [row for row in clean if row["noise"] == "as declared"]
    outside = [row for row in rows if row["kind"] == "outside"]
    unlike = [row for row in outside if judgement.distinguishable(row)]
    distinct = [row for row in twice if judgement.distinguishable(row)]
    named = [row for row in rows if row["kind"] in ("single", "mixture")]
    large = [row for row in named if all(judgement.is_at_least(effect, 2.0) for effect in row["hidden"])]
    others = "— where the data distinguish it from all other names"
    functions = "— where the data distinguish it from names, and from functions elsewhere or of others"
    alarms = "false alarms, upper end of the interval: 1 %"
    return [
        goal(
            "wrong names, outside the catalogue and at its edge: 2 %, upper end 4 %",
            wrong_names(rows),
            most=WRONG_NAMES,
            upper=WRONG_NAMES_AT_MOST,
        ),
        goal("found at twice the threshold, effect and site: 95 %", judgement.share_found(twice), least=0.95),
        goal(others, judgement.share_found(distinct), least=0.95),
        goal("at the right site at twice the threshold: 90 %", _sited(twice), least=0.9),
        goal(others, _sited(distinct), least=0.9),
        goal(alarms, _alarms(clean), upper=0.01),
        goal("— noise as declared", _alarms(declared), upper=0.01),
        goal("unseen error: 1.1 × the oracle's", against_oracle(large), most=1.1),
        goal(judgement.covering(known), judgement.covered(rows, known), 0.93, 0.97),
        goal("outside the catalogue: unnamed, at its site, by its driver: 90 %", _found(outside, "named"), least=0.9),
        Goal("— or listed among the alternatives", str(_found(outside, "in_set")), None),
        goal(functions, _found(unlike, "named"), least=0.9),
        _bars("95 % bars of predictions hold unseen positions: 93 to 97 %", within_bars(rows, "inside"), 0.93, 0.97),
        _bars("— outside what was recorded: 90 %", within_bars(rows, "outside"), 0.9, 1.0),
    ]


def reading_goals(rows: Sequence[Row], known: float) -> list[Goal]:
    """Those of a sensor that measures no poses; intervals are to hold from so many thresholds on."""
    twice = judgement.singles(rows, 2.0)
    clean = [row for row in rows if row["kind"] == "clean"]
    return [
        goal("clean recordings with a finding, at most 1 %", _alarms(clean), most=0.01),
        goal("found from twice the threshold on: 95 %", judgement.share_found(twice), least=0.95),
        goal("— at the right site: 85 %", _sited(twice), least=0.85),
        goal(judgement.covering(known), judgement.covered(rows, known), 0.93, 0.97),
    ]


def noise_goals(rows: Sequence[Row], known: float) -> list[Goal]:
    """Those of healthy arms whose noise is hard; nothing is hidden of which `known` says how large it is."""
    answered = [row for row in rows if not row["error"]]
    return [goal("clean recordings with a finding, at most 1 %", _alarms(answered), most=0.01)]


def _alarms(clean: Iterable[Row]) -> Share:
    return share(row["detected"] for row in clean)


def _sited(rows: Iterable[Row]) -> Share:
    return share(row["top_site"] for row in rows)


def _found(outside: Iterable[Row], how: str) -> Share:
    return share(row["hidden"][0][how] for row in outside)


def _bars(asked: str, held: float, least: float, most: float) -> Goal:
    known = math.isfinite(held)
    return Goal(asked, f"{100 * held:.3g} %" if known else "none", least <= held <= most if known else None)


def within_bars(rows: Iterable[Row], where: str) -> float:
    """The share of unseen position components within the bars that hold 95 %, inside or outside of what was recorded.

    NaN where there are none. Components of a trial depend on each other, so it has no interval of independent draws.
    """
    kept = [row for row in rows if row[f"{where}_components"]]
    count = sum(row[f"{where}_components"] for row in kept)
    return sum(row[f"{where}_covered"] for row in kept) / count if count else math.nan


def unseen(rows: Sequence[Row]) -> Section:
    """Errors on the unseen motion beside the oracle's."""
    named = [row for row in rows if row["kind"] in ("single", "mixture")]
    twice = [row for row in named if all(judgement.is_at_least(effect, 2.0) for effect in row["hidden"])]
    clean = [row for row in rows if row["kind"] == "clean"]
    groups = [
        ("nothing hidden, noise as declared", [row for row in clean if row["noise"] == NOISES[0]]),
        ("nothing hidden, other noise", [row for row in clean if row["noise"] != NOISES[0]]),
        ("one to three effects, each at twice the threshold or more", twice),
        ("— that were found exactly", [row for row in twice if row["exact"]]),
        *((kind, [row for row in rows if row["kind"] == kind]) for kind in NAMES_AT_STAKE),
    ]
    cells = [(label, str(over)) for label, found in groups if (over := against_oracle(found)).of]
    return "Unseen motion, error over the oracle's", ("trials", "ratio, 95 % interval"), cells


POSES = Campaign(
    "concealed", 1000, 3.0, ROUNDS, SCHEMA, draw, score, goals, unseen, measuring=tuple(SENSORS), noise_names=NOISES
)
"""Of sensors that measure poses."""
_READING = replace(POSES, count=200, known=2.0, rounds=READ_ROUNDS, set_goals=reading_goals)
READINGS = {name: replace(_READING, draw=partial(draw_reading, name), measuring=(name,)) for name in READERS}
"""Of the others, by name."""
_NOISY = replace(POSES, count=67, rounds=NOISE_ROUNDS, set_goals=noise_goals)
NOISY = {name: replace(_NOISY, draw=partial(draw_noise, name), noise_names=(name,)) for name in HARD_NOISES}
"""Of healthy arms whose noise is hard, by its name."""


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code: 0, 1 where a goal is missed, 2 for arguments that cannot be used, 130 where interrupted."""
    return command.main(replace(POSES, sensors=READINGS, noises=NOISY), arguments)
