"""The sentences about faults of the data and about causes of an error, each from a code and its numbers alone.

Texts that depend on no condition are in `templates/faults.yaml`, the others are functions of `sentences.faults` and
`sentences.causes`. To add a fault, write its name in the first, and its sentences in either.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import RenderableType

from lite6jax.formatting import capital, rows_named
from lite6jax.recordings.fault import DataFault
from lite6jax.report.screen import indented, unbroken
from lite6jax.report.sentences.causes import CAUSES
from lite6jax.report.sentences.faults import (
    FAULTS,
    FOUND,
    NAMES,
    RULED_OUT,
    has_clause,
    mismatch_found,
    mismatch_ruled_out,
)
from lite6jax.report.words import fill

if TYPE_CHECKING:
    from lite6jax.domains.pose.check import Cause, RecordingCheck  # which fits, and what words faults does not

_MISMATCHES = frozenset(
    code
    for code, texts in FAULTS["poses"].items()
    if has_clause(code) and code not in RULED_OUT and "ruled_out" not in texts
)
"""Those that make poses miss the arm grossly; the same numbers rule out all of them."""


def fault_name(code: str) -> str:
    """A fault in two or three words."""
    return NAMES.get(code, {}).get("name") or code.replace("_", " ").capitalize()


def fault_statement(fault: DataFault) -> str:
    """What is wrong, by how much, how it was corrected, and the remedy."""
    texts = NAMES.get(fault.code, {})
    # the column of a joint may be off by whole turns in some rows, or by an angle in all
    off_in_all_rows = fault.code == "joint_turns" and "added_rad" in fault.numbers
    if not off_in_all_rows and fault.code in FOUND:
        return FOUND[fault.code](fault)
    if not off_in_all_rows and "found" in texts:
        return fill(texts["found"], fault.numbers)
    if has_clause(fault.code):
        return mismatch_found(fault, texts.get("remedy", "Correct the columns in the file"))
    return f"{fault_name(fault.code)}."


def with_fault_statements(document: Mapping[str, Any]) -> dict[str, Any]:
    """A document with a `statement` for each fault of the data that was found or ruled out."""
    stated = dict(document)
    for key, statement in (
        ("data_faults", fault_statement),
        ("ruled_out", lambda fault: ruled_out_statements([fault])[0]),
    ):
        faults = [DataFault(entry["fault"], tuple(entry["rows"]), entry["numbers"]) for entry in document[key]]
        pairs = zip(document[key], map(statement, faults), strict=True)
        stated[key] = [{**entry, "statement": sentence} for entry, sentence in pairs]
    return stated


def fault_alternative(entry: Mapping[str, Any]) -> str:
    """A fault that may be there in place of a finding, by the entry of `confusable_with`: a phrase."""
    return fill(NAMES[entry["fault"]]["alternative"], entry["numbers"])


def fault_distinction(entry: Mapping[str, Any]) -> str:
    """What to do to tell such a fault from a finding: a phrase that begins with a verb."""
    return fill(NAMES[entry["fault"]]["distinction"], entry["numbers"])


def ruled_out_statements(faults: Iterable[DataFault]) -> list[str]:
    """Why faults that were tested for are not there; those that the same numbers rule out share a sentence."""
    groups: dict[str, list[DataFault]] = {}
    for number, fault in enumerate(faults):
        groups.setdefault(str(fault.numbers) if fault.code in _MISMATCHES else str(number), []).append(fault)
    sentences = []
    for group in groups.values():
        code = group[0].code
        names = ", ".join(fault_name(fault.code) for fault in group)
        texts = NAMES.get(code, {})
        if code in _MISMATCHES:
            sentences.append(mismatch_ruled_out(group[0].numbers, names))
        elif code in RULED_OUT:
            sentences.append(RULED_OUT[code](group[0]))
        elif "ruled_out" in texts:
            sentences.append(fill(texts["ruled_out"], group[0].numbers))
        else:
            sentences.append(f"{names}: none was found.")
    return sentences


def is_granted(fault: DataFault) -> bool:
    """Tells whether a fault that was ruled out says how far a fitted arm is from the nominal one."""
    return fault.code == "arm_deviation" and fault.numbers.get("reason") == "granted"


def check_report(path: str | Path, check: "Sequence[Cause] | RecordingCheck") -> Iterator[RenderableType]:
    """A line for each possible cause of an error, with a mark before those to be removed first."""
    yield unbroken(str(path))
    causes = check if isinstance(check, Sequence) else check.causes
    if not isinstance(check, Sequence):
        yield from (_line(True, "Note", note) for note in check.notes)
        yield from fault_lines(check.faults)
        yield from (_line(False, "Data", sentence) for sentence in ruled_out_statements(check.ruled_out))
    for cause in causes:
        yield _line(cause.suspicious, CAUSES[cause.code][0], cause_statement(cause))


def fault_lines(faults: Iterable[DataFault]) -> Iterator[RenderableType]:
    """A line for each fault of the data."""
    for fault in faults:
        rows = f" {capital(rows_named(fault.rows))}." if fault.rows else ""
        yield _line(True, fault_name(fault.code), fault_statement(fault) + rows)


def cause_statement(cause: "Cause") -> str:
    """What the data say of a possible cause of an error, and the remedy where there is one."""
    return CAUSES[cause.code][1](cause)


def _line(suspicious: bool, name: str, sentence: str) -> RenderableType:
    return indented(f"{'!' if suspicious else '·'} {name}: {sentence}")
