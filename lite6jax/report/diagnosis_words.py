"""The words for a diagnosis, the same on a page and on a terminal: verdicts, faults, findings, what to record next."""

import re
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.diagnosis.discrimination import Separation, differ
from lite6jax.domains.pose.problem import Case
from lite6jax.domains.pose.reference import ReferenceComparison
from lite6jax.effects.catalogue import Untestable
from lite6jax.effects.effect import Effect
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.report.cells import listed, plus_minus, ranges
from lite6jax.report.data_faults import fault_name, fault_statement, ruled_out_statement, ruled_out_statements
from lite6jax.search.backward import CLOSE, Rival, Step

Array = NDArray[np.floating]

VERDICTS = {
    "consistent": "Nothing is missing: the recording is what this arm's model and the sensor's noise make.",
    "explained": "Explained: with the physics below, what is left is the sensor's noise.",
    "partly_explained": "Partly explained: the physics below is there, and more is left than noise.",
    "unnamed": "Something real is there that no entry of the catalogue explains.",
}
AGREE = "Beyond that both sides agree: what is left of their difference is noise."
NOT_CHECKED = "They are inside the arm's limits, in an order of short moves, and not checked for collisions."


class Told(NamedTuple):
    """A fault of the data, or one that is not there.

    Attributes:
        name: in plain words.
        statement: what is known of it.
        rows: of the file, a short list; empty where all are concerned.
    """

    name: str
    statement: str
    rows: str = ""


class Untested(NamedTuple):
    """Effects that a recording cannot show for one and the same reason.

    Attributes:
        reason: what they need, or what hides them.
        remedy: what to give or to record; empty where `to_record` says it.
        effects: all of them, each once.
    """

    reason: str
    remedy: str
    effects: tuple[Effect, ...]


_FAR = 5.0
"""Times the declared noise, beyond which it is not believed that only noise is left."""


def verdict_of(found: Diagnosis, against: ReferenceComparison | None) -> str:
    """The verdict in a sentence or two."""
    if found.verdict == "consistent":
        times = found.estimated_noise / found.case.noise[0]
        if found.case.declared and times > _FAR:
            return (
                f"Nothing that was looked for explains it, and what is left is {times:.3g} times the declared noise: "
                "check the arm, the frame, the tool and the columns that the sidecar declares."
            )
        return AGREE if against is not None else VERDICTS["consistent"]
    return VERDICTS[found.verdict]


def chance(p: float) -> str:
    """A probability in a phrase; one below what floats hold is not zero."""
    return f"p = {p:.1e}" if p > 0 else "p < 1e-300"


def capital(text: str) -> str:
    """With a large first letter, the others as they are."""
    return text[:1].upper() + text[1:]


def faults_of(found: Diagnosis) -> list[Told]:
    """The faults of the data, in the order in which they were corrected; outliers last."""
    faults = list(found.faults)
    wild = found.outliers & found.problem.valid
    if wild.any():
        faults.append(DataFault("outliers", row_numbers(found.problem.recording.row[wild])))
    return [Told(fault_name(fault.code), fault_statement(fault), listed(fault.rows)) for fault in faults]


def ruled_out(found: Diagnosis) -> list[Told]:
    """The faults that were tested for, each with what rules it out."""
    return [Told(fault_name(fault.code), ruled_out_statement(fault)) for fault in found.ruled_out]


def ruled_out_in_short(found: Diagnosis) -> list[str]:
    """The same, with one sentence for the faults that the same numbers rule out."""
    return ruled_out_statements(found.ruled_out)


def untested(found: Diagnosis) -> list[Untested]:
    """What this recording cannot show, by the reason; reasons that differ by a joint's number are one."""
    groups: dict[str, list[Untestable]] = {}
    for item in found.untestable:
        groups.setdefault(re.sub(r"\d+", "", item.reason), []).append(item)
    told = []
    for items in groups.values():
        reason = items[0].reason
        if any(item.reason != reason for item in items):
            reason = re.sub(r"the (.*) of (joint|link) \d+", r"the \1 of its \2", reason)
        need, _, remedy = reason.partition(": ")
        told.append(Untested(capital(need), remedy, tuple(dict.fromkeys(item.effect for item in items))))
    if found.selection.hidden:
        reason = "The sensor does not see it here"
        if found.case.unknown:
            reason = "The frames and geometry that are fitted can do the same, or the sensor does not see it"
        told.append(Untested(reason, "", tuple(dict.fromkeys(found.selection.hidden))))
    return told


def by_site(effects: Iterable[Effect]) -> list[tuple[str, str]]:
    """Names of effects, each with all its sites, those of numbers that follow each other as a range: joint1–6."""
    sites: dict[str, list[str]] = {}
    for effect in effects:
        held = sites.setdefault(effect.name, [])
        held += [effect.site] if effect.site not in held else []
    return [(name, _sites_listed(held)) for name, held in sites.items()]


def named(effect: Effect) -> str:
    """An effect in words, such as "joint harmonic of order 2 at joint1"."""
    if isinstance(effect, Unnamed):
        return unnamed_title(effect)
    order, source = (getattr(effect, name, None) for name in ("order", "source_joint"))
    detail = f" of order {order:.4g}" if isinstance(order, float) else f" from joint{source}" if source else ""
    return f"{effect.name.replace('_', ' ')}{detail} at {effect.site}"


def unnamed_title(effect: Unnamed) -> str:
    """What is known of physics without a name: where it is, and what it is a function of."""
    place, driver = re.sub(r"(\D)(\d)", r"\1 \2", effect.where), effect.drivers[0].phrase
    if driver.endswith(f" of {place}"):
        driver = f"its {driver.removesuffix(f' of {place}')}"
    component = "" if place.startswith("joint") else f" {effect.component}"
    shape = "a smooth curve"
    if effect.memory:
        driver, shape = f"{driver} and of its past", "a loop"
    if effect.orders:
        count = len(effect.orders)
        shape = f"waves of {count} orders {min(effect.orders):g}–{max(effect.orders):g}" if count > 1 else "a wave"
    return f"unnamed: {place}{component}, function of {driver}, {shape}"


def peak_to_peak(case: Case, effect: Unnamed, values: Array, covariance: Array) -> tuple[float, float]:
    """How far a curve goes from its lowest to its highest where it was measured, and one standard deviation, m or rad.

    The ends of the driver's range, where few samples are, do not count.
    """
    driver = effect.drivers[0].values(case.motion, case.loads)
    low, high = np.percentile(np.asarray(driver), (2, 98))
    inside = (np.asarray(driver) >= low) & (np.asarray(driver) <= high)
    basis = np.asarray(effect.basis(driver, case.motion.run))[:, inside]
    curve = values @ basis
    apart = basis[:, np.argmax(curve)] - basis[:, np.argmin(curve)]
    return float(apart @ values), float(np.sqrt(max(float(apart @ covariance @ apart), 0.0)))


def rounded(value: float, std: float) -> tuple[str, str]:
    """A value to the digits that its standard deviation leaves, and this to two."""
    if not np.isfinite(std) or std < 1e-4:
        return f"{value:.6g}", f"{std:.1e}"
    return f"{value:.{max(0, 1 - int(np.floor(np.log10(std))))}f}", plus_minus(std)


def near(step: Step) -> list[str]:
    """What a finding is not told apart from, with the log-likelihood that each gives away, the nearest first."""
    return [_gap_named(rival.effect, rival.gap) for rival in _by_gap(step) if rival.gap < CLOSE]


def rejected(step: Step) -> list[str]:
    """The nearest entries that do not explain as much, the same way."""
    return [_gap_named(rival.effect, rival.gap) for rival in _by_gap(step) if rival.gap >= CLOSE]


def to_record(found: Diagnosis) -> list[str]:
    """What to record next, a sentence for each thing that this recording leaves open."""
    there = {item.effects for item in found.separating}
    told, undecided, drivers = [], [], []
    for k, step in enumerate(found.selection.steps):
        for rival in step.rivals:
            if rival.gap >= CLOSE or rival.effect in found.selection.fitted.physics.effects:
                continue
            pair = f"{named(step.effect)} from {named(rival.effect)}"
            if (step.effect.label, rival.effect.label) in there:
                told.append(f"To separate {pair}, record the poses below; they are in the JSON as separating_poses.")
            elif not differ(found.selection, k, rival):
                same = f"{named(step.effect)} and {named(rival.effect)} do the same in these poses"
                told.append(f"{capital(same)}: more poses of the kind do not separate them.")
            else:
                undecided.append(pair)
                drivers += [driver.phrase for driver in (*step.effect.drivers, *rival.effect.drivers)]
    if undecided:
        vary = f" with {_joined(dict.fromkeys(drivers))} varied each on its own" if drivers else ""
        told.append(f"To separate {_joined(undecided, 'or')}, record more poses{vary}.")
    for group in untested(found):
        if group.remedy:
            names = _joined(dict.fromkeys(effect.name.replace("_", " ") for effect in group.effects))
            told.append(f"To test for {names}, {group.remedy.removesuffix(' …')}.")
    return [*told, *(_unhidden(found.case) if found.selection.hidden else [])]


def separation_title(item: Separation) -> str:
    """What the poses of a table are for."""
    one, other = (label.replace("_", " ").replace(":", " at ") for label in item.effects)
    return f"Poses that separate {one} from {other} (deg)"


def _unhidden(case: Case) -> list[str]:
    """What would show the effects that the nuisance hides."""
    fields = {field for field, _, _ in case.unknown}
    declare = _joined(words for field, words in _DECLARED.items() if field in fields)
    told = [*([f"declare {declare}"] if declare else []), *(["measure orientations too"] if case.rows == 3 else [])]
    return [f"To see more of what is hidden, {' and '.join(told)}."] if told else []


_DECLARED = {"base": "the sensor's frame", "link": "the arm's own calibration", "tool": "the tool"}


def _by_gap(step: Step) -> list[Rival]:
    return sorted(step.rivals, key=lambda rival: rival.gap)


def _gap_named(effect: Effect, gap: float) -> str:
    return f"{named(effect)} ({gap:+.1f})"


def _joined(words: Iterable[str], last: str = "and") -> str:
    *first, final = [*words] or [""]
    return f"{', '.join(first)} {last} {final}" if first else final


def _sites_listed(sites: Iterable[str]) -> str:
    kinds: dict[str, list[int]] = {}
    for site in sites:
        kind = site.rstrip("0123456789")
        kinds.setdefault(kind, [])
        kinds[kind] += [int(site.removeprefix(kind))] if site != kind else []
    return ", ".join(kind + ", ".join(text for text, _ in ranges(sorted(held))) for kind, held in kinds.items())
