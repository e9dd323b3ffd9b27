"""Help as people read it: defaults that say something, paragraphs that break at words where the terminal ends."""

import ast
import inspect
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import is_dataclass
from itertools import pairwise
from typing import Annotated, Any

from tyro.conf import arg


def is_help(arguments: Sequence[str]) -> bool:
    """Whether a command line asks for help."""
    return not {"-h", "--help"}.isdisjoint(arguments)


def with_readable_options(command: Any) -> None:
    """Lets help show a command's options, and groups of options in it, as people read them.

    Nothing is said of the default of an option that is left out, or of a flag that is not set. Descriptions become one
    paragraph: tyro would keep the line breaks of the source.
    """
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(command))).body
    assert isinstance(tree, ast.ClassDef)
    said = {
        field.target.id: " ".join(text.value.value.split())
        for field, text in pairwise(tree.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }
    for name, annotation in command.__annotations__.items():
        if is_dataclass(annotation):
            with_readable_options(annotation)
        else:
            read = arg(help=said.get(name), help_behavior_hint=_default_as_read)
            command.__annotations__[name] = Annotated[annotation, read]


def _default_as_read(default: str) -> str:
    if default in ("None", "False", ""):
        return ""
    return "(default: on)" if default == "True" else f"(default: {default})"


class _Wrapping:
    """A stream that breaks lines of prose at words before it hands them on; frames are as wide as they are."""

    def __init__(self, stream: Any, width: int) -> None:
        self._stream, self._width = stream, width

    def write(self, text: str) -> int:
        self._stream.write("\n".join(map(self._wrapped, text.split("\n"))))
        return len(text)

    def _wrapped(self, line: str) -> str:
        if len(line) <= self._width or line[0] in "╭│╰" or line.startswith("    lite6jax "):
            return line  # a command to copy is one line
        line = line.replace(",", ", ") if line.startswith("usage: ") else line  # the commands are one word there
        indent = " " * (len(line) - len(line.lstrip()))
        return textwrap.fill(
            line, self._width, subsequent_indent=indent and indent + "    ", break_long_words=False,
            break_on_hyphens=False,
        )  # fmt: skip

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def wrapped() -> Iterator[None]:
    """Within, lines that are printed break at words."""
    stream = sys.stdout
    sys.stdout = _Wrapping(stream, max(40, shutil.get_terminal_size().columns))  # type: ignore[assignment]
    try:
        yield
    finally:
        sys.stdout = stream
