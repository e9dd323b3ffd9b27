"""Reading and writing files: regular files only, atomic writes, no silent overwriting, a safe subset of YAML; and types
of values of JSON, with their check by msgspec, whose messages name the place: `$.model.arm`.
"""

import hashlib
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import yaml
from msgspec import Meta

from lite6jax import interruption
from lite6jax.errors import InputError

_TEMPORARY = ".lite6jax-"
"""How names of temporary files begin; folders of inputs are listed without hidden files."""


def check_writable(path: str | Path, overwrite: bool = False) -> Path:
    """The path, after a check that a file may be written there; call it before a long computation.

    Raises:
        InputError: the file exists and `overwrite` is false, what exists is no regular file, its folder does not exist,
            or no file can have this name.
    """
    path = Path(path)
    kind = _kind(path, "cannot be written ({}); choose another name")
    if kind not in (None, "file"):
        raise InputError(f"{path}: is a {kind}, which a file would replace; choose another name")
    if kind and not overwrite:
        raise InputError(f"{path}: exists already; choose another name or add `overwrite=True` to replace it")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")
    return path


def write_atomically(path: str | Path, write: Callable[[Path], object] | str | bytes, overwrite: bool = False) -> Path:
    """Writes a file atomically: a reader sees the old content or the new, never a part.

    Args:
        path: the destination.
        write: the content, or a function that writes it to a temporary path beside the destination.
        overwrite: whether an existing file may be replaced.

    Raises:
        InputError: as `check_writable`, or the disk is full or read-only. No partial file remains.
    """
    path = check_writable(path, overwrite)
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=_TEMPORARY, suffix=path.suffix)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose a folder you may write to") from error
    os.close(handle)
    temporary = Path(name)
    with interruption.undone(lambda: temporary.unlink(missing_ok=True)):
        try:
            if callable(write):
                write(temporary)
            else:
                temporary.write_bytes(write.encode() if isinstance(write, str) else write)
            with open(temporary, "rb") as file:
                os.fsync(file.fileno())
            umask = os.umask(0)
            os.umask(umask)
            with suppress(PermissionError):  # some file systems (FAT, SMB) have no such permissions
                temporary.chmod(0o666 & ~umask)
            if overwrite:
                os.replace(temporary, path)
            else:
                _place(temporary, path)
        except FileExistsError as error:
            raise InputError(
                f"{path}: appeared while it was being written; choose another name or add `overwrite=True`"
            ) from error
        except OSError as error:
            reason = error.strerror or error
            raise InputError(f"{path}: cannot be written ({reason}); free space or choose another folder") from error
        finally:
            temporary.unlink(missing_ok=True)
    return path


def _place(temporary: Path, path: Path) -> None:
    """Gives a file its name unless another file has it by now.

    Raises:
        FileExistsError: another file has it.
    """
    try:
        os.link(temporary, path)  # fails if the file exists, where a rename would replace it
    except FileExistsError:
        raise
    except OSError:  # no hard links on this file system (FAT, SMB): an empty file reserves the name
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        try:
            os.replace(temporary, path)
        except OSError:
            path.unlink()
            raise


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """An empty folder among the system's temporary files, removed at the end with all that is in it."""
    path = Path(tempfile.mkdtemp(prefix=_TEMPORARY))
    try:
        with interruption.undone(lambda: shutil.rmtree(path, ignore_errors=True)):
            yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)


@contextmanager
def open_file(path: str | Path) -> Iterator[BufferedReader]:
    """A regular file, opened for reading.

    Raises:
        InputError: as `check_readable`, or not permitted.
    """
    path = check_readable(path)
    try:
        file = open(path, "rb")  # noqa: SIM115 (closed below: errors of the block stay what they are)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    with file:
        yield file


def check_readable(path: str | Path) -> Path:
    """The path, after a check that it is a regular file; every reader calls it, itself or by `open_file`.

    A pipe or a device may never begin or never end, and cannot be read twice.

    Raises:
        InputError: missing, a folder, a pipe, a device or a socket, or its name is not UTF-8.
    """
    path = Path(path)
    kind = _kind(path, "cannot be read ({}); check the name")
    if kind is None:
        raise InputError(f"{path}: no such file; check the name")
    if kind != "file":
        raise InputError(f"{path}: is a {kind}; write its content to a file first, and name that")
    return path


def file_sha256(path: str | Path) -> str:
    """The SHA-256 of a file, as 64 hexadecimal digits.

    Raises:
        InputError: as `open_file`.
    """
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def exists(path: str | Path) -> bool:
    """Tells whether there is anything of this name; false as well where no file can have it."""
    return os.path.exists(path)


def _kind(path: Path, otherwise: str) -> str | None:
    """What a path names: a file, a pipe, a socket or a device; None where nothing is there.

    Raises:
        InputError: a folder, a name that is not UTF-8, or `otherwise`, of what the system says.
    """
    try:
        os.fspath(path).encode()
        mode = path.stat().st_mode
    except UnicodeEncodeError as error:
        raise InputError(f"{path}: its name is not UTF-8; rename the file or its folder") from error
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise InputError(f"{path}: {otherwise.format(error.strerror)}") from error
    if stat.S_ISDIR(mode):
        raise InputError(f"{path}: is a folder; name a file")
    kinds = {stat.S_IFREG: "file", stat.S_IFIFO: "pipe", stat.S_IFSOCK: "socket"}
    return kinds.get(stat.S_IFMT(mode), "device")


def read_text(path: str | Path, size_limit: int) -> str:
    """A text file's content.

    Raises:
        InputError: as `open_file`, larger than `size_limit` bytes, or not UTF-8.
    """
    path = Path(path)
    with open_file(path) as file:
        try:
            content = file.read(size_limit + 1)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if len(content) > size_limit:
        raise InputError(f"{path}: larger than {size_limit} bytes, so it is not a file of this kind; check the name")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text (byte {error.start} is not UTF-8); check the name") from error


YAML_SIZE_LIMIT = 1 << 20
YAML_NODE_LIMIT = 100_000
YAML_DEPTH_LIMIT = 32
"""Levels; the deepest file of ours has five."""
YAML_SCALAR_LIMIT = 10_000
"""Characters of a key or value: YAML 1.1 takes quadratic time over a number to the base 60."""


def read_yaml(path: str | Path) -> Any:
    """A YAML file's content: plain mappings, lists, strings and numbers only.

    Raises:
        InputError: as `read_text`, not YAML, a tag, a repeated key, aliases that expand to too many values, or values
            that are nested too deeply or too long.
    """
    return parse_yaml(read_text(path, YAML_SIZE_LIMIT), path)


def parse_yaml(text: str, path: str | Path) -> Any:
    """The content of one YAML document; `path` is for messages.

    Raises:
        InputError: as `read_yaml`, of the text.
    """
    try:
        return _construct(path, text)
    except yaml.YAMLError as error:
        mark = None
        reason = None
        if isinstance(error, yaml.MarkedYAMLError):
            mark = error.problem_mark
            reason = error.problem
        where = f" line {mark.line + 1}:" if mark else ""
        problem = " ".join(str(reason or error).split())
        # libyaml from 0.2.6 on reads ahead to its own limit, which is above ours
        too_deep = "nesting depth" in problem
        defect = f"nested more than {YAML_DEPTH_LIMIT} levels deep" if too_deep else f"not valid YAML ({problem})"
        raise InputError(f"{path}:{where} {defect}; correct the file") from error
    except InputError:
        raise
    except (RecursionError, ValueError, ArithmeticError, TypeError) as error:  # numbers, dates and keys that cannot be
        raise InputError(
            f"{path}: not valid YAML (nested too deeply or a malformed value); correct the file"
        ) from error


YAML_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_RESOLVER = yaml.resolver.Resolver()
_CONSTRUCTOR = yaml.constructor.SafeConstructor()
_TAG = "tag:yaml.org,2002:"
_SCALARS = {f"{_TAG}{kind}" for kind in ("str", "int", "float", "bool", "null", "timestamp")}
_REAL = re.compile(r"[-+]?[0-9]{1,20}\.[0-9]{0,30}(?:[eE][-+][0-9]{1,4})?")
_WORDS = {"yes", "no", "on", "off", "true", "false", "null"}


def _construct(path: str | Path, text: str) -> Any:
    """What a YAML text holds, in one pass over its events: of thousands of files, no parser of trees is as fast."""
    events = yaml.parse(text, Loader=YAML_LOADER)
    anchors = dict[str, tuple[Any, int]]()
    count = 0

    def refuse(event: Any, problem: str) -> InputError:
        return InputError(f"{path}: line {event.start_mark.line + 1}: {problem}")

    def read(start: Any, depth: int = 0) -> Any:
        """The value that begins with an event."""
        nonlocal count
        kind = type(start)
        before = count
        count += 1
        if kind is yaml.AliasEvent:
            if start.anchor not in anchors:
                raise refuse(start, f"not valid YAML (found undefined alias {start.anchor!r}); correct the file")
            value, size = anchors[start.anchor]
            count = before + size
        elif kind is yaml.ScalarEvent:
            if len(start.value) > YAML_SCALAR_LIMIT:
                raise refuse(start, f"a value of over {YAML_SCALAR_LIMIT} characters; correct the file")
            value = read_scalar(start)
        elif depth == YAML_DEPTH_LIMIT:
            raise refuse(start, f"nested more than {YAML_DEPTH_LIMIT} levels deep; correct the file")
        elif start.tag not in (None, "!", f"{_TAG}{'map' if kind is yaml.MappingStartEvent else 'seq'}"):
            raise refuse(start, f"the YAML tag {start.tag!r} is not accepted; write plain values")
        elif kind is yaml.SequenceStartEvent:
            value = []
            while type(event := next(events)) is not yaml.SequenceEndEvent:
                value.append(read(event, depth + 1))
        else:
            value = {}
            while type(event := next(events)) is not yaml.MappingEndEvent:
                key = read(event, depth + 1)
                if isinstance(key, dict | list):
                    raise refuse(event, "a key that is not a plain name; write `name: value`")
                if key in value:
                    raise refuse(event, f"the key {key!r} is given twice; keep one")
                value[key] = read(next(events), depth + 1)
        if count > YAML_NODE_LIMIT:
            raise InputError(f"{path}: its YAML aliases expand to over {YAML_NODE_LIMIT} values; write them out")
        if kind is not yaml.AliasEvent and start.anchor is not None:
            anchors[start.anchor] = value, count - before
        return value

    def read_scalar(event: yaml.ScalarEvent) -> Any:
        text = event.value
        tag = event.tag
        if tag is None and event.implicit[0]:
            if _REAL.fullmatch(text):
                return float(text)
            if text[:1].isalpha() and text.lower() not in _WORDS:  # no such scalar is anything but a word
                return text
        if tag in (None, "!"):
            tag = _RESOLVER.resolve(yaml.ScalarNode, text, event.implicit)
        if tag not in _SCALARS:
            raise refuse(event, f"the YAML tag {event.tag or '!!merge'!r} is not accepted; write plain values")
        return _CONSTRUCTOR.yaml_constructors[tag](_CONSTRUCTOR, yaml.ScalarNode(tag, text))

    next(events)  # of the stream
    if isinstance(next(events), yaml.StreamEndEvent):
        raise InputError(f"{path}: is empty")
    value = read(next(events))
    _ = next(events)
    if not isinstance(after := next(events), yaml.StreamEndEvent):
        raise refuse(after, "not valid YAML (a second document); correct the file")
    return value


# ------------------------------------------------------------------ values of JSON

Kind = TypeVar("Kind")
NonNegative = Annotated[float, Meta(ge=0.0)]
Count = Annotated[int, Meta(ge=0)]
Number = Annotated[int, Meta(ge=1)]
"""Of a row or a joint, which count from 1; or of samples."""


class Strict(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """An object with these keys and no others."""


def check(value: Any, kind: type[Kind], place: str = "") -> Kind:
    """A value of JSON as one of a type.

    Args:
        value: as `json` or msgspec reads it; numbers may be NumPy's.
        kind: a type that msgspec knows.
        place: what the value is.

    Raises:
        InputError: it is none of the type, or has a number that is not finite; the message ends with its place.
    """
    try:
        # a number that is not finite becomes null
        return msgspec.json.decode(msgspec.json.encode(value, enc_hook=float), type=kind)
    except (msgspec.MsgspecError, TypeError, OverflowError, RecursionError) as error:
        raise InputError(f"{place}: {error}" if place else str(error)) from error
