"""What a diagnosis is worth: its first sentence, its ranking and the commands that follow.

Contributions are in mm, degrees, Nm or N.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from lite6jax import suffixes
from lite6jax.diagnosis.document import domain_of
from lite6jax.domains.registry import DOMAINS
from lite6jax.domains.words import Measure
from lite6jax.errors import command_line
from lite6jax.formatting import capital, plural, plus_minus
from lite6jax.recordings.formats import find_format
from lite6jax.report.faults import fault_name
from lite6jax.report.remedies import cause_of, remedy_of
from lite6jax.report.sentences import diagnosis as sentences
from lite6jax.report.sentences.diagnosis import Worth
from lite6jax.report.sentences.document import Document, Entry, corrected_faults, words_of


def detailed(document: Document) -> list[dict[str, Any]]:
    """The findings, each with the `domain` and, as `where`, the fields of its effect, which the model has.

    In the model, tolerances of joints come after them.
    """
    pairs = zip(document["findings"], document["model"]["effects"], strict=False)
    return [{**finding, "where": effect["where"], "domain": document["domain"]} for finding, effect in pairs]


# ------------------------------------------------------------------ contributions


def unit_of(document: Document) -> str:
    """The unit of all contributions; empty where they have several, and each says its own."""
    measures = words_of(document).measures(document)
    return measures[0].unit if len(measures) == 1 else ""


def shares(document: Document) -> list[float]:
    """What each finding moves most, over the error before."""
    return [_main(document, finding).share_of(document, finding) for finding in document["findings"]]


def order(document: Document) -> list[int]:
    """Places of the findings, from 0, the largest share of the error before first."""
    finding_shares = shares(document)
    return sorted(range(len(finding_shares)), key=lambda k: -finding_shares[k])


def contribution(document: Document, finding: Entry) -> str:
    """What a finding moves, with its unit: 0.21 mm, or 0.8 Nm and 12 N."""
    pairs = [(measure, finding.get(measure.moves)) for measure in words_of(document).measures(document)]
    return " and ".join(measure.size_of(moved) for measure, moved in pairs if moved is not None)


def _main(document: Document, finding: Entry) -> Measure:
    """In what a finding moves most."""
    return max(words_of(document).measures(document), key=lambda measure: measure.share_of(document, finding))


# ------------------------------------------------------------------ the first sentence


def headline(document: Document) -> str:
    """The cause in the words of a workshop and its worth, in one sentence; what there is instead where none is."""
    findings = detailed(document)
    if findings:
        main = findings[order(document)[0]]
        measure = _main(document, main)
        words = words_of(document)
        before = words.error_at(document, "before", measure, main)
        after = words.error_at(document, "after", measure, main)
        moved = measure.scale * main[measure.moves]
        worth = Worth(plus_minus(moved), moved > before, plus_minus(before), plus_minus(after), measure.unit)
        of_arm = words.compensable and all(remedy_of(finding).of_arm for finding in findings)
        return sentences.headline(document, cause_of(main), worth, of_arm)
    sizes = (measure.size_of(document["before"][measure.error]) for measure in words_of(document).measures(document))
    sentence = sentences.nothing_found(document, f"{' and '.join(sizes)} RMS")
    faults = corrected_faults(document)
    if not faults:
        return capital(sentence)
    names = list(dict.fromkeys(fault_name(fault["fault"]).lower() for fault in faults))
    have = plural(len(names), "a fault", f"{len(names)} faults")
    pronoun = plural(len(faults), "this", "these")
    return f"The data have {have} ({', '.join(names)}); with {pronoun} corrected, {sentence}"


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
    words = words_of(document)
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
    compensable = words.compensable and any(remedy_of(finding).of_arm for finding in findings)
    geometry = words.compensable and any(remedy_of(finding).of_geometry for finding in findings)
    offered: list[tuple[bool, str, list[Any]]] = [
        (
            files.diagnosis is None,
            "keep this diagnosis",
            ["diagnose", recording, *effects_option, "--out", diagnosis_path],
        ),
        (
            bool(words.predicted and findings) and readable and table,
            words.predicted,
            ["predict", diagnosis_path, recording, *effects_option, "--out", beside("predicted.csv")],
        ),
        (
            bool(words.simulated and findings) and readable,
            words.simulated,
            ["convert", diagnosis_path, beside("arm.urdf"), *effects_option],
        ),
        (
            compensable and readable and table,
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
    """Tells whether the model can be read, which effects of the user's own take their file for."""
    catalogue = DOMAINS[domain_of(document)].document.catalogue
    return bool(effects_option) or all(finding["effect"] in catalogue for finding in document["findings"])
