"""Reading and writing files: atomic writes, no silent overwriting, and a safe subset of YAML."""

import os
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from lite6jax.checksum import verify_comment
from lite6jax.errors import InputError

YAML_SIZE_LIMIT = 1 << 20
YAML_NODE_LIMIT = 100_000


def check_writable(path: str | Path, overwrite: bool = False) -> Path:
    """The path, after a check that a file may be written there; call it before a long computation.

    Raises:
        InputError: the file exists and `overwrite` is false, or its folder does not exist.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if path.exists() and not overwrite:
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
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=path.suffix)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose a folder you may write to") from error
    temporary = Path(name)
    try:
        os.close(handle)
        if callable(write):
            write(temporary)
        else:
            temporary.write_bytes(write.encode() if isinstance(write, str) else write)
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        if overwrite:
            os.replace(temporary, path)
        else:  # a link fails if the file exists by now, where a rename would replace it
            os.link(temporary, path)
            temporary.unlink()
    except FileExistsError as error:
        raise InputError(f"{path}: appeared while it was being written; choose another name or add --force") from error
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: cannot be written ({reason}); free space or choose another folder") from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def read_text(path: str | Path, size_limit: int) -> str:
    """A text file's content.

    Raises:
        InputError: missing, unreadable, larger than `size_limit` bytes, or not UTF-8.
    """
    path = Path(path)
    try:
        with open(path, "rb") as file:
            content = file.read(size_limit + 1)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; check the name") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if len(content) > size_limit:
        raise InputError(f"{path}: larger than {size_limit} bytes, so it is not a file of this kind; check the name")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text (byte {error.start} is not UTF-8); check the name") from error


def read_yaml(path: str | Path) -> Any:
    """A YAML file's content: plain mappings, lists, strings and numbers only.

    Raises:
        InputError: as `read_text`, not YAML, a tag, a repeated key, or aliases that expand to too many values.
    """
    text = read_text(path, YAML_SIZE_LIMIT)
    try:
        node = yaml.compose(text, Loader=yaml.CSafeLoader if hasattr(yaml, "CSafeLoader") else yaml.SafeLoader)
        if node is None:
            raise InputError(f"{path}: is empty")
        _check_node(path, node, budget=[YAML_NODE_LIMIT])
        values = _construct(text)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}:" if mark else ""
        problem = " ".join(str(getattr(error, "problem", None) or error).split())
        raise InputError(f"{path}:{where} not valid YAML ({problem}); correct the file") from error
    except (RecursionError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: not valid YAML (nested too deeply or a malformed value); correct the file"
        ) from error
    verify_comment(text, values, path)
    return values


def _construct(text: str) -> Any:
    return yaml.load(text, Loader=yaml.CSafeLoader if hasattr(yaml, "CSafeLoader") else yaml.SafeLoader)


_PLAIN_TAGS = {
    f"tag:yaml.org,2002:{kind}" for kind in ("map", "seq", "str", "int", "float", "bool", "null", "timestamp")
}


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
