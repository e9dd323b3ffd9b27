"""The sentences about data faults, each made from a fault's code and numbers alone, of poses and of torques."""

from collections.abc import Iterable, Mapping
from typing import Any

from lite6jax.recordings.fault import DataFault
from lite6jax.report import pose_faults, torque_faults
from lite6jax.report.pose_faults import MISMATCHES, mismatch_ruled_out

_NAMES = pose_faults.NAMES | torque_faults.NAMES
_FOUND = pose_faults.FOUND | torque_faults.FOUND
_RULED_OUT = pose_faults.RULED_OUT | torque_faults.RULED_OUT


def fault_name(code: str) -> str:
    """A fault in two or three words."""
    return _NAMES.get(code) or code.replace("_", " ").capitalize()


def fault_statement(fault: DataFault) -> str:
    """What is wrong, by how much, how it was corrected, and the remedy."""
    sentence = _FOUND.get(fault.code)
    return sentence(fault.rows, fault.numbers) if sentence else f"{fault_name(fault.code)}."


def ruled_out_statement(fault: DataFault) -> str:
    """Why a fault that was tested for is not there, with the number that rules it out."""
    sentence = _RULED_OUT.get(fault.code)
    return sentence(fault.numbers) if sentence else f"{fault_name(fault.code)}: none was found."


def ruled_out_statements(faults: Iterable[DataFault]) -> list[str]:
    """The same for several; faults that the same numbers rule out share a sentence."""
    groups: dict[tuple[object, ...], list[DataFault]] = {}
    for fault in faults:
        column = fault.code in MISMATCHES
        groups.setdefault(tuple(fault.numbers.values()) if column else (fault.code,), []).append(fault)
    lines = []
    for group in groups.values():
        if group[0].code in MISMATCHES:
            lines.append(mismatch_ruled_out([fault.code for fault in group], group[0].numbers))
        else:
            lines += map(ruled_out_statement, group)
    return lines


def with_statements(document: Mapping[str, Any]) -> dict[str, Any]:
    """A diagnosis as in its JSON file, with a `statement` added to each data fault, found or ruled out."""
    sentences = (("data_faults", fault_statement), ("ruled_out", ruled_out_statement))
    return dict(document) | {
        key: [{**entry, "statement": sentence(_read(entry))} for entry in document[key]] for key, sentence in sentences
    }


def _read(entry: Mapping[str, Any]) -> DataFault:
    return DataFault(entry["fault"], tuple(entry["rows"]), entry["numbers"])
