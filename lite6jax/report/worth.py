"""What a diagnosis is worth: its first sentence, and its findings ranked by what they move, in mm, degrees, Nm or N."""

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
_NEARLY = 0.05
"""Family-wise p-value below which an effect that is no finding is said to be nearly significant."""


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
FORCE = Measure("moves_rms_N", "heldout_torque_rms_N", 1.0, "N", "the force")
"""Of prismatic joints."""


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


def measures_of(document: Document) -> tuple[Measure, ...]:
    """Millimetres; degrees where no finding moves the measured point, but one turns it; newton metres of torques.

    Of an arm that has prismatic joints also newtons, or these alone: what has no common unit is ranked by its share of
    the error before.
    """
    if of_torques(document):
        return tuple(measure for measure in (TORQUE, FORCE) if measure.error in document["before"]) or (TORQUE,)
    reach = [
        max((_share(document, finding, measure) for finding in document["findings"]), default=0.0)
        for measure in (POSITION, ORIENTATION)
    ]
    return (ORIENTATION,) if reach[0] < _SHARE < reach[1] else (POSITION,)


def _share(document: Document, finding: Entry, measure: Measure) -> float:
    """What a finding moves, over the error before."""
    before = document["before"].get(measure.error)
    return (finding.get(measure.moves) or 0.0) / before if before else 0.0


def _main(document: Document, finding: Entry) -> Measure:
    """In what a finding moves most."""
    return max(measures_of(document), key=lambda measure: _share(document, finding, measure))


def _moved(document: Document, finding: Entry) -> float | None:
    """By what a finding is ranked: what it moves, in shares of the errors where these have several units."""
    measures = measures_of(document)
    moved = [finding[measure.moves] for measure in measures if finding.get(measure.moves) is not None]
    if not moved:
        return None
    return moved[0] if len(measures) == 1 else _share(document, finding, _main(document, finding))


def order(document: Document) -> list[int]:
    """Places of the findings, from 0, those that move most first; by log-likelihood in a document without this."""
    findings = document["findings"]
    moved = [_moved(document, finding) for finding in findings]
    gains = [finding["log_likelihood_gain"] for finding in findings] if None in moved else []
    sizes = gains or [size or 0.0 for size in moved]
    return sorted(range(len(findings)), key=lambda k: -sizes[k])


def ranked(document: Document) -> list[Entry]:
    """The findings in this order."""
    return [document["findings"][k] for k in order(document)]


def bars(document: Document) -> list[Bar]:
    """What each finding moves, in the order of `ranked`; none in a document without this."""
    findings = ranked(document)
    moved = [_moved(document, finding) for finding in findings]
    known = [size for size in moved if size is not None]
    if len(known) < len(moved):
        return []
    most, alone = max(known, default=0.0) or 1.0, unit_of(document)
    sizes = [moves_size(document, finding).removesuffix(f" {alone}") for finding in findings]
    return [Bar(k, size / most, shown) for k, (size, shown) in enumerate(zip(known, sizes, strict=True), 1)]


def unit_of(document: Document) -> str:
    """The unit of all that findings move; empty where they have several, and each says its own."""
    measures = measures_of(document)
    return measures[0].unit if len(measures) == 1 else ""


def moves_size(document: Document, finding: Entry) -> str:
    """What a finding moves, with its unit: 0.21 mm, or 0.8 Nm and 12 N; empty in a document without this."""
    pairs = [(finding.get(measure.moves), measure) for measure in measures_of(document)]
    return " and ".join(_size(measure.scale * moved, measure) for moved, measure in pairs if moved is not None)


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
    torques = of_torques(document)
    main, *others = ranked(document)
    measure, slides = _main(document, main), document["model"].get("prismatic_joints", ())
    before, after = (_error_at(document[stage], measure, main, slides) for stage in ("before", "after"))
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


def _error_at(errors: Entry, measure: Measure, finding: Entry, slides: Sequence[int]) -> float:
    """The root mean square of held-out errors in the unit shown; of torques at the joints that a finding acts on."""
    joints = [joint for joint in finding.get("joints") or () if (joint in slides) == (measure is FORCE)]
    if measure not in (TORQUE, FORCE) or not joints:
        return measure.scale * errors[measure.error]
    by_joint = np.array(errors["heldout_torque_rms_by_joint_Nm"])[np.array(joints) - 1]
    return float(np.sqrt(np.mean(by_joint**2)))


def _size(value: float, measure: Measure) -> str:
    return f"{plus_minus(value)} {measure.unit}"


def _kept(document: Document, count: int, torques: bool) -> str:
    of_arm = not torques and all(remedy_of(finding).of_arm for finding in document["findings"])
    if count == 1:
        return "compensated," if of_arm else "with it in the model,"
    which = "both" if count == 2 else f"all {count}"
    return f"with {which} findings {'compensated' if of_arm else 'in the model'},"


def is_computed(document: Document) -> bool:
    """Whether no sensor measured the poses: the controller computed them from the joints."""
    found = any(fault["fault"] == "computed_pose" for fault in document["data_faults"])
    return found or document.get("pose_source") == "controller_fk"


def is_significant(finding: Entry) -> bool:
    """Whether a finding was tested by itself; numbers that share a prior are found together."""
    return bool(finding["p_value"] < _NEARLY)


def is_nearly_significant(nearest: Entry | None) -> bool:
    """Whether the nearest effect that is no finding leaves a verdict open; documents do not hold the thresholds."""
    return nearest is not None and nearest["p_value"] < _NEARLY


def _nothing_found(document: Document) -> str:
    torques = of_torques(document)
    measures, whose = (measures_of(document), "sensors'") if torques else ((POSITION,), "sensor's")
    errors = [_size(measure.scale * document["before"][measure.error], measure) for measure in measures]
    error = f"{' and '.join(errors)} RMS"
    if document["verdict"] == "consistent" and is_computed(document):
        return f"The poses are the controller's own computation: the arm's table reproduces them to {errors[0]} RMS."
    faults = [fault for fault in document["data_faults"] if fault["fault"] not in ("outliers", "computed_pose")]
    begin = (
        f"The data have {_faults(faults)}; with {'this' if len(faults) == 1 else 'these'} corrected, " if faults else ""
    )
    of = "torques" if torques else "poses"
    consistent = f"nothing is missing from the model: the error of {error} is the {whose} noise."
    key = "torque_noise_Nm" if torques else "position_noise_m"
    if document["noise"]["declared_torque_Nm" if torques else "declared_position_m"] is None:
        consistent = f"no effect is significant, and the error of {error} looks like noise; declare {key} to test this."
    said = {
        "consistent": consistent,
        "undetermined": f"the recording is too short to tell what the error of {error} is.",
    }.get(document["verdict"], f"the error of {error} is not the noise of the {of} alone, and nothing explains it.")
    if document["verdict"] == "undetermined" and is_nearly_significant(document.get("nearest")):
        said = f"the error of {error} is noise, or noise and one more effect, which is nearly significant."
    return begin + said if begin else f"{said[0].upper()}{said[1:]}"


def _faults(faults: Sequence[Entry]) -> str:
    names = list(dict.fromkeys(fault_name(fault["fault"]).lower() for fault in faults))
    return f"{'a fault' if len(names) == 1 else f'{len(names)} faults'} ({', '.join(names)})"
