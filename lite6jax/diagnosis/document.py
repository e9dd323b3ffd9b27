"""The JSON of a diagnosis: its schema, writing and reading; codes and numbers in SI units, of every domain.

The schema types what a model needs; the rest is numbers of a report, looked at where a sentence is made of them.

Sentences are added by the report where a file is written.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, overload

import msgspec

from lite6jax.domains.base import DomainName
from lite6jax.domains.entries import Document
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.domains.registry import DOMAINS
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.domains.tracking.predict import DiagnosedServos
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError, command_line, require_type
from lite6jax.recordings.files import recording_file
from lite6jax.storage import check, exists, read_text, write_atomically

Verdict = Literal["consistent", "explained", "partly_explained", "unnamed", "unexplained", "undetermined"]
AnyModel = DiagnosedArm | DiagnosedMotors | DiagnosedServos

_FAMILY = "lite6jax/diagnosis/"
SCHEMA = f"{_FAMILY}3"
DAMAGED = "run `lite6jax diagnose` again"
_SIZE_LIMIT = 1 << 26
_REPORTED = ("verdict", "before", "after", "left", "noise", "findings", "data_faults", "ruled_out")
"""What every report of a diagnosis says something of."""


# ------------------------------------------------------------------ models from values of JSON


def model_from_document(
    document: Any, effects: Sequence[Effect] = (), source: str = "diagnosis", domain: DomainName | None = None
) -> AnyModel:
    """The model in a diagnosis, as JSON holds it.

    Args:
        document: all of it.
        effects: a user's own, where the model has them.
        source: what messages begin with.
        domain: of which the model is, as of `read_model`.

    Raises:
        InputError: not a diagnosis of the domain, effects of a user's own that are not given, or something in it is
            missing or not possible.
    """
    read = _read(document, domain or domain_of(document), source)
    _require_known(read, effects, source)
    with _refuse_damage(source):
        return read.restored(effects)


def _require_known(read: Document[Any], effects: Sequence[Effect], source: str) -> None:
    """Refuses a model with effects that are neither in the catalogue nor given.

    Raises:
        InputError: as said; the file of these effects is the remedy.
    """
    name = read.unknown_effect(effects)
    if name is None:
        return
    reason = "the catalogue has none of this name"
    if effects:
        reason = "the file that was given has none of this name"
    raise InputError(
        f"{source}: its model has the effect {name[:60]!r}, and {reason}; give the file of effects with which it "
        "was diagnosed, --effects FILE.py (in Python effects=load_effects(FILE))"
    )


@contextmanager
def _refuse_damage(source: str) -> Iterator[None]:
    """Within, what is not possible in a document is an error of the input."""
    try:
        yield
    except (InputError, KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(f"{source}: its model is damaged ({error}); {DAMAGED}") from error


# ------------------------------------------------------------------ files


def write_document(document: Mapping[str, Any], path: str | Path, overwrite: bool = False) -> Path:
    """Writes a document, with or without sentences.

    Raises:
        InputError: as `write_atomically`.
    """
    return write_atomically(path, document_text(document), overwrite)


def document_text(document: Any, line: str = "\n") -> str:
    """The text of a diagnosis file, with a line for each entry of objects and lists, but one for a list of numbers.

    A covariance is then a line for each of its rows. `line` begins a line of the surrounding object or list.
    """
    if isinstance(document, dict) and document:
        entries = [f"{json.dumps(name)}: {document_text(entry, line + ' ')}" for name, entry in document.items()]
    elif isinstance(document, list | tuple) and any(isinstance(entry, dict | list | tuple) for entry in document):
        entries = [document_text(entry, line + " ") for entry in document]
    else:
        return json.dumps(document, allow_nan=False)
    first, last = "{}" if isinstance(document, dict) else "[]"
    return first + ",".join(f"{line} {entry}" for entry in entries) + line + last


@overload
def read_model(path: str | Path, effects: Sequence[Effect] = (), *, domain: None = None) -> AnyModel: ...
@overload
def read_model(path: str | Path, effects: Sequence[Effect] = (), *, domain: Literal["poses"]) -> DiagnosedArm: ...
@overload
def read_model(path: str | Path, effects: Sequence[Effect] = (), *, domain: Literal["torques"]) -> DiagnosedMotors: ...
@overload
def read_model(path: str | Path, effects: Sequence[Effect] = (), *, domain: Literal["tracking"]) -> DiagnosedServos: ...
def read_model(path: str | Path, effects: Sequence[Effect] = (), *, domain: DomainName | None = None) -> AnyModel:
    """The model in a diagnosis file: of the poses where they were diagnosed, else of the torques, or of the servos.

    Args:
        path: what `diagnose` wrote.
        effects: a user's own, where the model has them.
        domain: "poses", "torques" or "tracking", to have the model of that one of a diagnosis of several.

    Raises:
        InputError: no such domain or file, not a diagnosis of the domain, or something in it is missing or not
            possible.
    """
    require_type("path", path, str | Path, "the path of a diagnosis (.json)")
    require_domain(domain)
    return model_from_document(parse_document(path), effects, str(path), domain)


def require_domain(name: object) -> None:
    """Refuses what names no domain.

    Raises:
        InputError: as said.
    """
    if name is None or name in DOMAINS:
        return
    *first, last = (f'"{name}"' for name in DOMAINS)
    raise InputError(f"domain={name!r}: is none; give {', '.join(first)} or {last}, or leave it out")


def parse_document(path: str | Path) -> Any:
    """A document as JSON holds it.

    Raises:
        InputError: no such file, no JSON, a diagnosis of another schema, or a recording, with the command that
            diagnoses it.
    """
    if recording_file(path) is not None and exists(path):
        made = command_line("diagnose", path, "--out", Path(path).with_suffix(".json"))
        raise InputError(f"{path}: is a recording and no diagnosis; give what `{made}` writes")
    text = read_text(path, _SIZE_LIMIT)
    try:
        document = msgspec.json.decode(text)
    except (msgspec.MsgspecError, RecursionError) as error:
        raise InputError(f"{path}: is no JSON ({error}); give what `lite6jax diagnose --out` wrote") from error
    schema = document.get("schema") if isinstance(document, dict) else None
    if str(schema).startswith(_FAMILY) and schema != SCHEMA:
        raise InputError(
            f"{path}: is a diagnosis of the schema {schema}, and {SCHEMA} is read; diagnose the recording again"
        )
    return document


def check_document(document: Any, path: str | Path) -> None:
    """Refuses what is no diagnosis or has no whole model, for a report; effects of a user's own are not needed.

    Raises:
        InputError: as `model_from_document`, or a part is missing that every report has.
    """
    _read(document, domain_of(document), str(path))
    for domain in domains_beside(document):
        _read(document, domain, str(path))
    missing = [name for name in _REPORTED if name not in document]
    if missing:
        raise InputError(f"{path}: is damaged (it lacks {missing[0]!r}); {DAMAGED}")


def is_of_tracking(document: Any) -> bool:
    """Tells whether a document is a diagnosis of commands and measured joints."""
    return isinstance(document, dict) and document.get("domain") == "tracking"


def domain_of(document: Any) -> DomainName:
    """The domain of a document, or of the poses in it."""
    name = document.get("domain") if isinstance(document, dict) else None
    return name if name in DOMAINS else "poses"


def find_part(document: Any, domain: DomainName) -> dict[str, Any] | None:
    """The diagnosis by a domain that a document is, or that stands in one by another; None where there is none."""
    if not isinstance(document, dict):
        return None
    parts = (document, document.get(domain))
    return next((part for part in parts if isinstance(part, dict) and domain_of(part) == domain), None)


def domains_beside(document: Mapping[str, Any]) -> list[DomainName]:
    """The other domains by which the recording of a document was diagnosed as well."""
    own_domain = domain_of(document)
    return [name for name in DOMAINS if name != own_domain and find_part(document, name) is not None]


def refusals(document: Mapping[str, Any]) -> dict[DomainName, str]:
    """By domain, why the recording of a document could not be diagnosed by it as well."""
    return {name: document[f"{name}_refused"] for name in DOMAINS if f"{name}_refused" in document}


def _read(document: Any, domain: DomainName, source: str) -> Document[Any]:
    """A document of a domain by its schema, or that in one of another domain."""
    part = find_part(document, domain)
    named = document.get("domain") if isinstance(document, dict) else None
    if part is None and named in DOMAINS:
        raise InputError(f"{source}: is a diagnosis of {named}; give one of {domain}")
    if not (isinstance(part, dict) and part.get("schema") == SCHEMA and isinstance(part.get("model"), dict)):
        raise InputError(
            f"{source}: is no diagnosis of {domain} ({SCHEMA} with a model); give what `lite6jax diagnose --out` wrote"
        )
    with _refuse_damage(source):
        return check(part, DOMAINS[domain].document)
