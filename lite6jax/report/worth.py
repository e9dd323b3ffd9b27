"""What a diagnosis is worth: its first sentence, and its findings ranked by what they move, in mm, degrees or Nm."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from lite6jax.report.cells import plus_minus
from lite6jax.report.data_faults import fault_name
from lite6jax.report.remedies import cause_of, remedy_of

Document = Mapping[str, Any]
Entry = Mapping[str, Any]

_SHARE = 0.1
"""Of the error of positions, below which all findings concern orientations."""


class Measure(NamedTuple):
    """In what findings are ranked.

    Attributes:
        moves: the key of a finding.
        error: the key of the root mean square error before and after.
        scale: from SI units to the unit shown.
        unit: shown.
        what: is moved.
    """

    moves: str
    error: str
    scale: float
    unit: str
    what: str


POSITION = Measure("moves_rms_m", "heldout_position_rms_m", 1e3, "mm", "the measured point")
ORIENTATION = Measure("moves_rms_rad", "heldout_orientation_rms_rad", 180 / np.pi, "deg", "the measured orientation")
TORQUE = Measure("moves_rms_Nm", "heldout_torque_rms_Nm", 1.0, "Nm", "the torque")


class Bar(NamedTuple):
    """A finding in a chart of what findings move.

    Attributes:
        number: its rank, from 1.
        share: of the largest, from 0 to 1.
        size: what it moves, two digits.
    """

    number: int
    share: float
    size: str


def of_torques(document: Document) -> bool:
    """Whether a document is of torques."""
    return document.get("domain") == "torque"


def measure_of(document: Document) -> Measure:
    """Millimetres; degrees where no finding moves the measured point, but one turns it; newton metres of torques."""
    if of_torques(document):
        return TORQUE
    reach = [_share(document, POSITION), _share(document, ORIENTATION)]
    return ORIENTATION if reach[0] < _SHARE < reach[1] else POSITION


def _share(document: Document, measure: Measure) -> float:
    """The most that a finding moves, over the error before."""
    before = document["before"].get(measure.error)
    moved = [finding.get(measure.moves) or 0.0 for finding in document["findings"]]
    return max(moved, default=0.0) / before if before else 0.0


def order(document: Document) -> list[int]:
    """Places of the findings, from 0, those that move most first; by log-likelihood in a document without this."""
    findings, key = document["findings"], measure_of(document).moves
    known = all(finding.get(key) is not None for finding in findings)
    sizes = [finding[key] if known else finding["log_likelihood_gain"] for finding in findings]
    return sorted(range(len(findings)), key=lambda k: -sizes[k])


def ranked(document: Document) -> list[Entry]:
    """The findings in this order."""
    return [document["findings"][k] for k in order(document)]


def bars(document: Document) -> list[Bar]:
    """What each finding moves, in the order of `ranked`; none in a document without this."""
    measure, findings = measure_of(document), ranked(document)
    if any(finding.get(measure.moves) is None for finding in findings):
        return []
    moved = [measure.scale * finding[measure.moves] for finding in findings]
    most = max(moved, default=0.0) or 1.0
    return [Bar(k, size / most, plus_minus(size)) for k, size in enumerate(moved, 1)]


def moves_phrase(finding: Entry) -> str:
    """What a finding on poses moves and turns: it moves the measured point by 0.21 mm RMS and turns it by 0.012 deg."""
    moved, turned = finding.get("moves_rms_m"), finding.get("moves_rms_rad")
    if moved is None:
        return ""
    turn = f" and turns it by {plus_minus(float(np.rad2deg(turned)))} deg" if turned else ""
    return f"it moves the measured point by {plus_minus(1e3 * moved)} mm RMS{turn}"


def headline(document: Document) -> str:
    """The cause in the words of a workshop and its worth, in one sentence; what there is instead where none is."""
    if not document["findings"]:
        return _nothing_found(document)
    measure, torques = measure_of(document), of_torques(document)
    main, *others = ranked(document)
    before, after = (error_at(document[stage], measure, main) for stage in ("before", "after"))
    cause = cause_of(main, torques)
    cause = f"{cause[0].upper()}{cause[1:]}"
    whose = "sensors'" if torques else "sensor's"
    noise = f", the {whose} noise" if document["verdict"] == "explained" else ""
    left = f"{_kept(document, len(others) + 1, torques)} {_size(after, measure)} is left{noise}"
    moved = main.get(measure.moves)
    if moved is None:
        return f"{cause}: of {_size(before, measure)}, {left}."
    if measure.scale * moved > before:
        return f"{cause}: {_size(measure.scale * moved, measure)}, which others partly cancel; {left}."
    return f"{cause}: {plus_minus(measure.scale * moved)} of {_size(before, measure)}; {left}."


def error_at(errors: Entry, measure: Measure, finding: Entry) -> float:
    """The root mean square of held-out errors in the unit shown; of torques at the joints that a finding acts on."""
    joints = finding.get("joints")
    if measure is not TORQUE or not joints:
        return measure.scale * errors[measure.error]
    by_joint = np.array(errors["heldout_torque_rms_by_joint_Nm"])[np.array(joints) - 1]
    return float(np.sqrt(np.mean(by_joint**2)))


def _size(value: float, measure: Measure) -> str:
    return f"{plus_minus(value)} {measure.unit}"


def _kept(document: Document, count: int, torques: bool) -> str:
    of_arm = not torques and all(remedy_of(finding).of_arm for finding in document["findings"])
    if count == 1:
        return "compensated," if of_arm else "with it in the model,"
    return f"with all {count} findings {'compensated' if of_arm else 'in the model'},"


def _nothing_found(document: Document) -> str:
    torques = of_torques(document)
    measure, whose = (TORQUE, "sensors'") if torques else (POSITION, "sensor's")
    error = f"{_size(measure.scale * document['before'][measure.error], measure)} RMS"
    faults = [fault for fault in document["data_faults"] if fault["fault"] != "outliers"]
    begin = (
        f"The data have {_faults(faults)}; with {'this' if len(faults) == 1 else 'these'} corrected, " if faults else ""
    )
    of = "torques" if torques else "poses"
    said = {
        "consistent": f"nothing is missing from the model: the error of {error} is the {whose} noise.",
        "undetermined": f"the recording is too short to tell what the error of {error} is.",
    }.get(document["verdict"], f"the error of {error} is more than the noise of the {of}, and nothing explains it.")
    return begin + said if begin else f"{said[0].upper()}{said[1:]}"


def _faults(faults: Sequence[Entry]) -> str:
    names = list(dict.fromkeys(fault_name(fault["fault"]).lower() for fault in faults))
    return f"{'a fault' if len(names) == 1 else f'{len(names)} faults'} ({', '.join(names)})"
