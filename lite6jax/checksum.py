"""The checksum inside the files that are written here, which shows that a file was changed afterwards.

It is of the values and not of the text, so that a file may be laid out anew. It protects from accidents, not from
intent: whoever edits a file can write a new one. Where it does not hold, every value is checked as ever.
"""

import hashlib
import json
import re
import warnings
from collections.abc import Mapping
from decimal import Context, Decimal
from typing import Any

import yaml

from lite6jax.errors import InputError, InputWarning

KEY = "checksum"
"""Of a JSON object: its other values' checksum."""
_COMMENT = re.compile(r"#.*(?:checksum|sha256)", re.IGNORECASE)
"""Of a first or last line: damaged in part, it is still no comment of somebody else."""
_EXACT = Context(prec=60)


def checksum_of(values: Any) -> str:
    """`sha256:` and 64 hexadecimal digits, of values as JSON or YAML holds them; of a mapping without its checksum."""
    if isinstance(values, Mapping):
        values = {name: value for name, value in values.items() if name != KEY}
    return _digest(_canonical(values), allow_nan=True)


def _digest(values: Any, *, allow_nan: bool) -> str:
    canonical = json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=allow_nan)
    return f"sha256:{hashlib.sha256(canonical.encode()).hexdigest()}"


def _canonical(value: Any) -> Any:
    """Values of JSON alone; decimals, which tables are read as, without what does not change them."""
    if isinstance(value, Mapping):
        return {str(name): _canonical(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [_canonical(entry) for entry in value]
    if isinstance(value, Decimal):
        return str(value.normalize(_EXACT))
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def with_checksum(document: Mapping[str, Any]) -> dict[str, Any]:
    """A JSON object, whose names are all text, with its checksum as the last value."""
    values = {name: value for name, value in document.items() if name != KEY}
    return {**values, KEY: _digest(values, allow_nan=False)}


def with_comment(text: str) -> str:
    """A YAML text with the checksum of its values in a comment before it and behind it, so that one may be lost."""
    comment = _comment(yaml.safe_load(text))
    return f"{comment}\n{text.rstrip()}\n{comment}\n"


def verify(document: Mapping[str, Any], source: object) -> None:
    """Warns where a JSON object has a checksum that is not that of its values.

    Warns:
        InputWarning: the file was changed after it was written.

    Raises:
        InputError: its checksum is no text.
    """
    if KEY not in document:
        return
    if not isinstance(document[KEY], str):
        raise InputError(f"{source}: {KEY} is not text; remove it, or write the file again")
    if document[KEY] != checksum_of(document):
        _warn(source)


def verify_comment(text: str, values: Any, source: object) -> None:
    """Warns where a YAML text has a checksum in a comment that is not that of its values.

    Warns:
        InputWarning: as `verify`.
    """
    lines = text.strip().splitlines() or [""]
    comments = [line.rstrip() for line in (lines[0], lines[-1]) if _COMMENT.match(line)]
    if comments and set(comments) != {_comment(values)}:
        _warn(source)


def _comment(values: Any) -> str:
    return f"# {KEY}: {checksum_of(values)}"


def _warn(source: object) -> None:
    warnings.warn(
        f"{source}: was changed after it was written (its checksum does not hold); its values are "
        "checked as ever, and used",
        InputWarning,
        stacklevel=4,
    )
