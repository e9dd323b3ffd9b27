"""What is stored of a diagnosis document, and where a document differs from a stored one."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeGuard

Document = Mapping[str, Any]

DIGITS = 9
RELATIVE = 1e-6
"""By which numbers may differ: fits stop at 1e-9, and sums in another order change a number by less than this."""
_OF_LIST = 1e-9
"""Of the largest number of a list, by which its numbers may differ: what is zero but for rounding has no scale."""
_LEAST = 1e-12  # m, rad, Nm: likewise of a number that stands alone
_LONGEST = 200
"""Numbers of a list that are all stored. Of a longer one, a covariance, a hundred spread evenly and the sum are."""
_SENTENCES = ("statement", "statements", "reason")
"""Keys that hold sentences in a document of a command; a `reason` that is a code stays."""
_STORED_OF_REAL = ("verdict", "findings", "refused")


def store(document: Document, real: bool = False) -> dict[str, Any]:
    """A document as it is stored: its codes and numbers, without sentences, files and recorded rows.

    Args:
        document: of a recording, or of a fleet.
        real: whether the arm is: then the verdict, the findings and the names of faults are stored, and nothing else.
    """
    plain = _round(document)
    plain.pop("inputs", None)
    for part in (plain, plain.get("torques") or {}):
        uncertainty = (part.get("model") or {}).get("uncertainty") or {}
        uncertainty.pop("recorded", None)
    if real:
        faults = [{"fault": entry["fault"]} for entry in plain.get("data_faults", ())]
        return {key: plain[key] for key in _STORED_OF_REAL if key in plain} | {"data_faults": faults}
    return plain


def _round(value: Any) -> Any:
    """A value of JSON with numbers of `DIGITS` digits, and without sentences."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, Mapping):
        return {key: _round(part) for key, part in value.items() if not _is_sentence(key, part)}
    if isinstance(value, (list, tuple)):
        if len(value) > _LONGEST and all(map(_is_number, value)):
            spread = value[:: len(value) // (_LONGEST // 2)]
            return {"count": len(value), "sum": _round(float(sum(value))), "spread": _round(spread)}
        return [_round(part) for part in value]
    return value


def _is_sentence(key: str, value: Any) -> bool:
    return key in _SENTENCES and (isinstance(value, list) or (isinstance(value, str) and " " in value))


# ------------------------------------------------------------------ differences


def list_differences(before: Document, after: Document) -> list[str]:
    """A line for each difference of two stored documents: the verdict, findings, faults, then numbers by their path."""
    lines = []
    if before.get("verdict") != after.get("verdict"):
        lines.append(f"verdict: {before.get('verdict')} → {after.get('verdict')}")
    for key, word in (("findings", "finding"), ("effects", "effect"), ("data_faults", "fault")):
        lines += _changed(word, before.get(key) or (), after.get(key) or ())
    lines += [line for line in _walk("", before, after) if not line.startswith("verdict:")]
    return lines


def _changed(word: str, before: Sequence[Document], after: Sequence[Document]) -> Iterator[str]:
    """What is in one list of findings or faults and not in the other, and whether the order is another."""
    earlier = [_label(entry) for entry in before]
    later = [_label(entry) for entry in after]
    for label in (Counter(earlier) - Counter(later)).elements():
        yield f"{word} gone: {label}"
    for label in (Counter(later) - Counter(earlier)).elements():
        yield f"{word} new: {label}"
    if earlier != later and Counter(earlier) == Counter(later):
        yield f"{word}s in another order: {', '.join(later)}"


def _label(entry: Any) -> str:
    """What an entry of a list is called; empty where it has no name, and its place says which it is."""
    if not isinstance(entry, Mapping):
        return ""
    if "effect" in entry:
        return f"{entry['effect']}@{entry.get('site')}"
    return str(entry.get("fault") or entry.get("recording") or "")


def _walk(path: str, before: Any, after: Any) -> Iterator[str]:
    """Where two values of JSON differ below a path. Entries with names are compared with those of their name."""
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for key in sorted({*before, *after}):
            below = f"{path}/{key}" if path else key
            if key not in after or key not in before:
                yield f"{below}: {'gone' if key in before else 'new'}"
            elif key.endswith("p_value"):
                yield from _compare_probabilities(below, before[key], after[key])
            else:
                yield from _walk(below, before[key], after[key])
    elif isinstance(before, list) and isinstance(after, list):
        yield from _walk_lists(path, before, after)
    elif _is_number(before) and _is_number(after):
        yield from _compare_numbers(path, before, after, _LEAST)
    elif before != after:
        yield f"{path}: {_short(before)} → {_short(after)}"


def _walk_lists(path: str, before: list[Any], after: list[Any]) -> Iterator[str]:
    earlier = _named(before)
    later = _named(after)
    if all(map(_label, before + after)):
        # those that are gone or new have a line of their own where they are findings or faults
        told = path.rpartition("/")[2] in ("findings", "effects", "data_faults")
        for label in earlier | later:
            if label in earlier and label in later:
                yield from _walk(f"{path}/{label}", earlier[label], later[label])
            elif not told:
                yield f"{path}/{label}: {'gone' if label in earlier else 'new'}"
        return
    if len(before) != len(after):
        yield f"{path}: {len(before)} → {len(after)} entries"
        return
    numbers = [*_numbers(before), *_numbers(after)]
    least = max(_LEAST, _OF_LIST * max(map(abs, numbers), default=0.0))
    for place, (old, new) in enumerate(zip(before, after, strict=True)):
        below = f"{path}/{place}"
        if _is_number(old) and _is_number(new):
            yield from _compare_numbers(below, old, new, least)
        else:
            yield from _walk(below, old, new)


def _named(entries: Sequence[Any]) -> dict[str, Any]:
    """Entries by label; the second of a label is called `label#2`."""
    count: Counter[str] = Counter()
    named = {}
    for entry in entries:
        label = _label(entry)
        count[label] += 1
        named[f"{label}#{count[label]}" if count[label] > 1 else label] = entry
    return named


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _numbers(values: Sequence[Any]) -> Iterator[float]:
    """The numbers of a list."""
    return (float(value) for value in values if _is_number(value))


def _compare_numbers(path: str, before: float, after: float, least: float) -> Iterator[str]:
    if abs(after - before) > max(least, RELATIVE * max(abs(before), abs(after))):
        share = abs(after - before) / max(abs(before), abs(after))
        yield f"{path}: {before:.9g} → {after:.9g} ({share:.1g})"


def _compare_probabilities(path: str, before: Any, after: Any) -> Iterator[str]:
    """By their logarithms: the error of a log-likelihood of hundreds is relative to it."""
    if not (_is_number(before) and _is_number(after)) or min(before, after) <= 0.0:
        yield from _walk(path, before, after)
        return
    allowed = RELATIVE * max(1.0, abs(math.log(before)))
    if abs(math.log(after) - math.log(before)) > allowed:
        yield f"{path}: {before:.9g} → {after:.9g}"


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
