"""What to do about a diagnosis: remedies, and commands to copy that work with the files at hand."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from lite6jax.errors import command_line
from lite6jax.recordings.sources import SUFFIXES
from lite6jax.report import worth
from lite6jax.report.remedies import remedy_of

Document = Mapping[str, Any]

_TARGETS = (".csv", ".parquet")
"""The forms of recordings that `compensate` and `predict` read."""


class Files(NamedTuple):
    """The files of a diagnosis, as they were named on the command line.

    Attributes:
        recording: that was diagnosed.
        diagnosis: its JSON file; None where it was not written.
        effects: of effects of the user's own; None where there are none.
    """

    recording: Path
    diagnosis: Path | None = None
    effects: Path | None = None


class Step(NamedTuple):
    """A command to copy.

    Attributes:
        purpose: what it does, a phrase.
        command: the line.
    """

    purpose: str
    command: str


def actions(document: Document) -> list[tuple[list[int], str]]:
    """What to do, each once, with the ranks of the findings that it is for."""
    torques, found = worth.of_torques(document), {}
    for rank, finding in enumerate(worth.ranked(document), 1):
        found.setdefault(remedy_of(finding, torques).action, []).append(rank)
    return [(ranks, action) for action, ranks in found.items()]


def steps(document: Document, files: Files) -> list[Step]:
    """Commands on these files, which write beside the diagnosis; where that was not written, the first one does."""
    recording = files.recording
    named = files.diagnosis or Path(f"{recording.stem}_diagnosis.json")
    own = ["--effects", str(files.effects)] if files.effects is not None else []
    found = []
    if files.diagnosis is None:
        found.append(_step("keep this diagnosis", "diagnose", recording, *own, "--out", named))
    if worth.of_torques(document):
        found += _of_torques(document, recording, named, own)
    else:
        found += _of_poses(document, recording, named, own)
    if _known(document, own) and recording.suffix.lower() in SUFFIXES:
        beside = recording.parent in (named.parent, Path())  # where `view` finds it
        shown = [] if beside else [recording]
        found.append(_step("the arm and its errors in the browser", "view", named, *shown, *own))
    found.append(_step("a certificate, one page", "report", named, "--certificate", named.with_suffix(".pdf")))
    return found


def _known(document: Document, own: Sequence[str]) -> bool:
    """Whether the model can be read, which effects of the user's own take their file for."""
    # a look at a table, which has next steps too, takes no effects
    from lite6jax.effects.catalogue import BUILT_IN
    from lite6jax.effects.dynamic.catalogue import BUILT_IN as OF_TORQUES

    known = OF_TORQUES if worth.of_torques(document) else BUILT_IN
    return bool(own) or all(finding["effect"] in known for finding in document["findings"])


def _of_poses(document: Document, recording: Path, diagnosis: Path, own: Sequence[str]) -> list[Step]:
    found, findings = [], document["findings"]
    if (
        _known(document, own)
        and recording.suffix.lower() in _TARGETS
        and any(remedy_of(finding).of_arm for finding in findings)
    ):
        play = any(finding["effect"] in ("joint_backlash", "slide_backlash") for finding in findings)
        side = ["--approach", "1"] if play else []
        out = diagnosis.with_name(f"{recording.stem}_compensated.csv")
        purpose = "joint positions that reach these poses; give a table of your own targets in their place"
        found.append(_step(purpose, "compensate", diagnosis, recording, *side, *own, "--out", out))
    if any(remedy_of(finding).of_geometry for finding in findings):
        out = diagnosis.with_name(f"{recording.stem}_table.json")
        found.append(_step("recalibrate", "fit", recording, "--geometry", "free", "--out", out))
    return found


def _of_torques(document: Document, recording: Path, diagnosis: Path, own: Sequence[str]) -> list[Step]:
    found, findings = [], document["findings"]
    if not findings or not _known(document, own):
        return []
    if recording.suffix.lower() in _TARGETS:
        out = diagnosis.with_name(f"{recording.stem}_predicted.csv")
        purpose = "torques of this motion, for a feed-forward; give a motion of your own in its place"
        found.append(_step(purpose, "predict", diagnosis, recording, *own, "--out", out))
    out = diagnosis.with_name(f"{recording.stem}_arm.urdf")
    found.append(_step("the arm with what was found, for a simulator", "convert", diagnosis, out, *own))
    return found


def _step(purpose: str, *arguments: object) -> Step:
    return Step(purpose, command_line(*arguments))
