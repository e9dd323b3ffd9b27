"""Reading and writing files: regular files only, atomic writes, no silent overwriting, and a safe subset of YAML."""

import hashlib
import os
import re
import shutil
import stat
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import Any

import yaml

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
    _check_name(path)
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        mode = None
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another name") from error
    if mode is not None:
        if stat.S_ISDIR(mode):
            raise InputError(f"{path}: is a folder; name a file")
        if not stat.S_ISREG(mode):
            raise InputError(f"{path}: is a {_kind(mode)}, which a file would replace; choose another name")
        if not overwrite:
            raise InputError(f"{path}: exists already; choose another name or add --force to replace it")
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
                f"{path}: appeared while it was being written; choose another name or add --force"
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
    _check_name(path)
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(f"{path}: no such file; check the name") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the name") from error
    if stat.S_ISDIR(mode):
        raise InputError(f"{path}: is a folder; name a file")
    if not stat.S_ISREG(mode):
        raise InputError(f"{path}: is a {_kind(mode)}; write its content to a file first, and name that")
    return path


def file_sha256(path: str | Path) -> str:
    """The SHA-256 of a file, as 64 hexadecimal digits.

    Raises:
        InputError: as `open_file`.
    """
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def exists(path: str | Path) -> bool:
    """Whether there is anything of this name; false as well where no file can have it."""
    return os.path.exists(path)


def _kind(mode: int) -> str:
    return "pipe" if stat.S_ISFIFO(mode) else "socket" if stat.S_ISSOCK(mode) else "device"


def _check_name(path: Path) -> None:
    try:
        os.fspath(path).encode()
    except UnicodeEncodeError as error:
        raise InputError(f"{path}: its name is not UTF-8; rename the file or its folder") from error


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
    text = read_text(path, YAML_SIZE_LIMIT)
    values = _mapping_of_numbers(text)
    return _parse_yaml(path, text) if values is None else values


_NUMBERS_LIMIT = 20_000
"""Characters, which no file of numbers of one arm has."""
_ENTRY = re.compile(
    r"( *)([A-Za-z_][A-Za-z0-9_]{0,63}):"
    r"(?: +(?:([-+]?[0-9]{1,20}\.[0-9]{0,30}(?:[eE][-+][0-9]{1,4})?)|(0|-?[1-9][0-9]{0,17})))?"
    r" *(?:\r?\n|\Z)|(?: *(?:#[^\r\n]*)?(?:\r?\n|\Z))"
)
"""A line `name:`, `name: number`, or of nothing but a comment."""
_WORDS = {"yes", "no", "on", "off", "true", "false", "null"}
"""Names that YAML takes for something else."""


def _mapping_of_numbers(text: str) -> dict[str, Any] | None:
    """What a YAML text holds that is nothing but mappings of numbers in blocks; None of every other text.

    Thousands of factory files are read, and this takes a tenth of the time of a parser of all of YAML.
    """
    if len(text) > _NUMBERS_LIMIT:
        return None
    root: dict[str, Any] = {}
    levels: list[tuple[int, dict[str, Any]]] = [(0, root)]
    opened: dict[str, Any] | None = None
    at, end = 0, len(text)
    while at < end:
        line = _ENTRY.match(text, at)
        if line is None:
            return None
        at = line.end()
        indent, name, real, whole = line.groups()
        if name is None:
            continue
        depth = len(indent)
        if opened is not None:
            if depth <= levels[-1][0] or len(levels) > YAML_DEPTH_LIMIT:
                return None
            levels.append((depth, opened))
            opened = None
        while depth < levels[-1][0]:
            levels.pop()
        column, within = levels[-1]
        if depth != column or name in within or name.lower() in _WORDS:
            return None
        if real is not None:
            within[name] = float(real)
        elif whole is not None:
            within[name] = int(whole)
        else:
            within[name] = opened = {}
    return root if root and opened is None else None


def _parse_yaml(path: str | Path, text: str) -> Any:
    """What a YAML text holds; errors as of `read_yaml`."""
    try:
        _check_events(path, text)
        node = yaml.compose(text, Loader=_LOADER)
        if node is None:
            raise InputError(f"{path}: is empty")
        _check_node(path, node, budget=[YAML_NODE_LIMIT])
        return yaml.constructor.SafeConstructor().construct_document(node)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}:" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        # libyaml from 0.2.6 on reads ahead to its own limit, which is above ours
        too_deep = "nesting depth" in problem
        what = f"nested more than {YAML_DEPTH_LIMIT} levels deep" if too_deep else f"not valid YAML ({problem})"
        raise InputError(f"{path}:{where} {what}; correct the file") from error
    except (RecursionError, ValueError, ArithmeticError) as error:  # numbers and dates that cannot be
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: not valid YAML (nested too deeply or a malformed value); correct the file"
        ) from error


_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_PLAIN_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("map", "seq", "str", "int", "float", "bool", "null", "timestamp")
}


def _check_events(path: str | Path, text: str) -> None:
    """Bounds depth and length before anything recursive reads them: in C, too deep a nesting ends the process."""
    depth = 0
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > YAML_DEPTH_LIMIT:
                where = f"{path}: line {event.start_mark.line + 1}:"
                raise InputError(f"{where} nested more than {YAML_DEPTH_LIMIT} levels deep; correct the file")
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        elif isinstance(event, yaml.ScalarEvent) and len(event.value) > YAML_SCALAR_LIMIT:
            where = f"{path}: line {event.start_mark.line + 1}:"
            raise InputError(f"{where} a value of over {YAML_SCALAR_LIMIT} characters; correct the file")


def _check_node(path: str | Path, node: yaml.Node, budget: list[int]) -> None:
    """Checks a node and those below it; `budget` limits their number after the expansion of aliases."""
    budget[0] -= 1
    where = f"{path}: line {node.start_mark.line + 1}:"
    if budget[0] < 0:
        raise InputError(f"{path}: its YAML aliases expand to over {YAML_NODE_LIMIT} values; write them out")
    if node.tag not in _PLAIN_TAGS:
        raise InputError(f"{where} the YAML tag {node.tag!r} is not accepted; write plain values")
    if isinstance(node, yaml.MappingNode):
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        if len(keys) != len(node.value):
            raise InputError(f"{where} a key that is not a plain name; write `name: value`")
        if len(set(keys)) != len(keys):
            twice = next(key for key, count in Counter(keys).items() if count > 1)
            raise InputError(f"{where} the key {twice!r} is given twice; keep one")
        for _, value in node.value:
            _check_node(path, value, budget)
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            _check_node(path, value, budget)
