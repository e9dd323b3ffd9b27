"""What a diagnosis is worth: its first sentence, its ranking and the commands that follow.

Contributions are in mm, degrees, Nm or N.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lite6jax import suffixes
from lite6jax.diagnosis.document import is_of_torques
from lite6jax.effects.catalogue import POSE_EFFECTS, TORQUE_EFFECTS
from lite6jax.errors import command_line
from lite6jax.formatting import capital, plural, plus_minus
from lite6jax.recordings.formats import find_format
from lite6jax.report.faults import fault_name
from lite6jax.report.remedies import cause_of, remedy_of
from lite6jax.report.sentences import diagnosis as sentences
from lite6jax.report.sentences.diagnosis import Worth
from lite6jax.report.sentences.document import Document, Entry, corrected_faults, sliding

_SHARE = 0.1
"""Share of the error of positions, or orientations, from which a finding matters there."""


def detailed(document: Document) -> list[dict[str, Any]]:
    """The findings, each with the `domain` and, as `where`, the fields of its effect, which the model has.

    In the model, tolerances of joints come after them.
    """
    pairs = zip(document["findings"], document["model"]["effects"], strict=False)
    return [{**finding, "where": effect["where"], "domain": document["domain"]} for finding, effect in pairs]


# ------------------------------------------------------------------ contributions


class Measure(NamedTuple):
    """In what findings are ranked: the keys of what one moves and of the RMS error, and how sizes are shown.

    `scale` leads from SI units to `unit`.
    """

    moves: str
    error: str
    scale: float
    unit: str

    def size_of(self, value: float) -> str:
        """A value in SI units as it is shown, in two digits."""
        return f"{plus_minus(self.scale * value)} {self.unit}"


POSITION = Measure("moves_rms_m", "heldout_position_rms_m", 1e3, "mm")
ORIENTATION = Measure("moves_rms_rad", "heldout_orientation_rms_rad", 180 / np.pi, "deg")
TORQUE = Measure("moves_rms_Nm", "heldout_torque_rms_Nm", 1.0, "Nm")
FORCE = Measure("moves_rms_N", "heldout_torque_rms_N", 1.0, "N")
"""Of prismatic joints."""


def measures_of(document: Document) -> tuple[Measure, ...]:
    """Millimetres; degrees where no finding moves the measured point, but one turns it; newton metres of torques.

    Of an arm that has prismatic joints also newtons, or these alone.
    """
    if is_of_torques(document):
        return tuple(measure for measure in (TORQUE, FORCE) if measure.error in document["before"]) or (TORQUE,)
    moved, turned = (
        max((_share(document, finding, measure) for finding in document["findings"]), default=0.0)
        for measure in (POSITION, ORIENTATION)
    )
    return (ORIENTATION,) if moved < _SHARE < turned else (POSITION,)


def unit_of(document: Document) -> str:
    """The unit of all contributions; empty where they have several, and each says its own."""
    measures = measures_of(document)
    return measures[0].unit if len(measures) == 1 else ""


def shares(document: Document) -> list[float]:
    """What each finding moves most, over the error before."""
    return [_share(document, finding, _main(document, finding)) for finding in document["findings"]]


def order(document: Document) -> list[int]:
    """Places of the findings, from 0, the largest share of the error before first."""
    finding_shares = shares(document)
    return sorted(range(len(finding_shares)), key=lambda k: -finding_shares[k])


def contribution(document: Document, finding: Entry) -> str:
    """What a finding moves, with its unit: 0.21 mm, or 0.8 Nm and 12 N."""
    pairs = [(measure, finding.get(measure.moves)) for measure in measures_of(document)]
    return " and ".join(measure.size_of(moved) for measure, moved in pairs if moved is not None)


def _share(document: Document, finding: Entry, measure: Measure) -> float:
    """What a finding moves, over the error before; over the unit where there was no error."""
    return (finding.get(measure.moves) or 0.0) / (document["before"].get(measure.error) or 1.0)


def _main(document: Document, finding: Entry) -> Measure:
    """In what a finding moves most."""
    return max(measures_of(document), key=lambda measure: _share(document, finding, measure))


# ------------------------------------------------------------------ the first sentence


def headline(document: Document) -> str:
    """The cause in the words of a workshop and its worth, in one sentence; what there is instead where none is."""
    findings = detailed(document)
    if findings:
        main = findings[order(document)[0]]
        measure = _main(document, main)
        before = _error_at(document["before"], document, measure, main)
        after = _error_at(document["after"], document, measure, main)
        moved = measure.scale * main[measure.moves]
        worth = Worth(plus_minus(moved), moved > before, plus_minus(before), plus_minus(after), measure.unit)
        of_arm = not is_of_torques(document) and all(remedy_of(finding).of_arm for finding in findings)
        return sentences.headline(document, cause_of(main), worth, of_arm)
    sizes = (measure.size_of(document["before"][measure.error]) for measure in measures_of(document))
    sentence = sentences.nothing_found(document, f"{' and '.join(sizes)} RMS")
    faults = corrected_faults(document)
    if not faults:
        return capital(sentence)
    names = list(dict.fromkeys(fault_name(fault["fault"]).lower() for fault in faults))
    have = plural(len(names), "a fault", f"{len(names)} faults")
    pronoun = plural(len(faults), "this", "these")
    return f"The data have {have} ({', '.join(names)}); with {pronoun} corrected, {sentence}"


def _error_at(errors: Entry, document: Document, measure: Measure, finding: Entry) -> float:
    """The root mean square of held-out errors in the unit shown; of torques at the joints that a finding acts on."""
    joints = [joint for joint in finding.get("joints", ()) if (joint - 1 in sliding(document)) == (measure is FORCE)]
    if measure not in (TORQUE, FORCE) or not joints:
        return measure.scale * errors[measure.error]
    by_joint = np.array(errors["heldout_torque_rms_by_joint_Nm"])[np.array(joints) - 1]
    return float(np.sqrt(np.mean(by_joint**2)))


# ------------------------------------------------------------------ what to do


class Files(NamedTuple):
    """The files of a diagnosis as named on the command line: recording, JSON file, and effects of the user's own."""

    recording: Path
    diagnosis: Path | None = None
    effects: Path | None = None


class Step(NamedTuple):
    """A command to copy: its purpose, a phrase, and the line."""

    purpose: str
    command: str


def actions(document: Document) -> list[tuple[list[int], str]]:
    """What to do, each once, with the ranks of the findings that it is for."""
    ranks: dict[str, list[int]] = {}
    findings = detailed(document)
    for rank, k in enumerate(order(document), 1):
        ranks.setdefault(remedy_of(findings[k]).action, []).append(rank)
    return [(finding_ranks, action) for action, finding_ranks in ranks.items()]


def steps(document: Document, files: Files) -> list[Step]:
    """Commands on these files, which write beside the diagnosis; where that was not written, the first one does."""
    recording = files.recording
    findings = detailed(document)
    torques = is_of_torques(document)
    diagnosis_path = files.diagnosis or Path(f"{recording.stem}_diagnosis.json")
    effects_option = []
    if files.effects is not None:
        effects_option = ["--effects", str(files.effects)]
    readable = _known(document, effects_option)
    table = recording.suffix.lower() in suffixes.WRITTEN_TABLES
    beside = lambda end: diagnosis_path.with_name(f"{recording.stem}_{end}")  # noqa: E731
    play = any(finding["effect"] == "joint_backlash" for finding in findings)
    side = ["--approach", "1"] if play else []
    shown = [] if recording.parent in (diagnosis_path.parent, Path()) else [recording]  # where `view` finds it
    compensated = not torques and readable and table and any(remedy_of(finding).of_arm for finding in findings)
    geometry = not torques and any(remedy_of(finding).of_geometry for finding in findings)
    offered: list[tuple[bool, str, list[Any]]] = [
        (
            files.diagnosis is None,
            "keep this diagnosis",
            ["diagnose", recording, *effects_option, "--out", diagnosis_path],
        ),
        (
            torques and bool(findings) and readable and table,
            "torques of this motion, for a feed-forward; give a motion of your own in its place",
            ["predict", diagnosis_path, recording, *effects_option, "--out", beside("predicted.csv")],
        ),
        (
            torques and bool(findings) and readable,
            "the arm with what was found, for a simulator",
            ["convert", diagnosis_path, beside("arm.urdf"), *effects_option],
        ),
        (
            compensated,
            "joint positions that reach these poses; give a table of your own targets in their place",
            ["compensate", diagnosis_path, recording, *side, *effects_option, "--out", beside("compensated.csv")],
        ),
        (geometry, "recalibrate", ["fit", recording, "--geometry", "free", "--out", beside("table.json")]),
        (
            readable and not recording.is_dir() and find_format(recording) is not None,
            "the arm and its errors in the browser",
            ["view", diagnosis_path, *shown, *effects_option],
        ),
        (
            True,
            "a certificate, one page",
            ["report", diagnosis_path, "--certificate", diagnosis_path.with_suffix(".pdf")],
        ),
    ]
    return [Step(purpose, command_line(*line)) for applies, purpose, line in offered if applies]


def _known(document: Document, effects_option: Sequence[str]) -> bool:
    """Whether the model can be read, which effects of the user's own take their file for."""
    catalogue = TORQUE_EFFECTS if is_of_torques(document) else POSE_EFFECTS
    return bool(effects_option) or all(finding["effect"] in catalogue for finding in document["findings"])
