"""The program: which commands there are, how their help is shown, how one is run, and what becomes of its mistakes."""

import gc
import inspect
import operator
import os
import re
import shutil
import sys
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import is_dataclass
from functools import reduce
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from io import TextIOWrapper
from typing import Annotated, Any

import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, arg, subcommand

from lite6jax.cli.command import BAD_INPUT, DONE, INTERRUPTED, MEANINGS, READER_LEFT
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError, InputWarning, name_options

with import_lazily():
    from lite6jax.calibration import compiled

COMMANDS = {
    "init": "init",
    "detect": "init",
    "fit": "fit",
    "compare": "fit",
    "fleet": "fit",
    "identify": "study",
    "sensitivity": "study",
    "design": "study",
    "diagnose": "diagnose",
    "report": "diagnose",
    "view": "diagnose",
    "predict": "diagnose",
    "compensate": "diagnose",
    "simulate": "simulate",
    "emulate": "live",
    "convert": "arms",
    "check": "fit",
    "read": "live",
    "record": "live",
    "effects": "arms",
    "arms": "arms",
    "demo": "demo",
}
"""The module of this package that holds each command, in the order in which help lists them."""
DESCRIPTION = f"""Find what the model of a robot arm lacks, from measured poses or joint torques, correct it, and fit
calibrations: of a UFACTORY Lite 6, or of any serial arm.

Exit codes: {"; ".join(f"{code} {meaning}" for code, meaning in MEANINGS.items())}."""


def main(arguments: Sequence[str] | None = None) -> int:
    """As `lite6jax.cli.main`, without a change to the process's signals: an interrupt is a `KeyboardInterrupt` here."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without × or ° shows a question mark
    try:
        if arguments == ["--version"]:
            print(f"lite6jax {_version()}")
            return DONE
        with _wrap_lines() if _asks_help(arguments) else nullcontext():
            command = _parse(arguments)
        compiled.keep_compiled_code()
        gc.set_threshold(200_000)  # tracing makes objects that stay; to look them through again and again takes a tenth
        with _warn_in_lines():
            code = command.run()
        sys.stdout.flush()
    except SystemExit as stop:  # tyro has printed help or what is wrong with the arguments
        return int(stop.code or DONE)
    except InputError as error:
        print(f"error: {_one_line(error)}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted: nothing is left half-written", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader (head, less) has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return READER_LEFT
    return code


@contextmanager
def _warn_in_lines() -> Iterator[None]:
    """Prints each warning of the input once, as one line on stderr."""
    shown = warnings.showwarning
    printed = set()

    def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
        if not issubclass(category, InputWarning):
            shown(message, category, *place)
        elif str(message) not in printed:
            printed.add(str(message))
            print(f"warning: {_one_line(message)}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = show
        yield


def _one_line(error: Warning | str | InputError) -> str:
    """The message with options for arguments, and with what breaks the line, or steers the terminal, spelled out."""
    message = name_options(str(error))
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in message)


def _version() -> str:
    try:
        return version("lite6jax")
    except PackageNotFoundError:
        return "(not installed)"


def load_command(name: str) -> Any:
    """The class of a command. Only its own module is imported."""
    module = import_module(f"lite6jax.cli.{COMMANDS[name]}")
    return vars(module)[f"{name.capitalize()}Command"]


# ------------------------------------------------------------------ help


def _asks_help(arguments: Sequence[str]) -> bool:
    return not {"-h", "--help"}.isdisjoint(arguments)


def _parse(arguments: Sequence[str]) -> Any:
    """The command that arguments ask for. A mistake in its options is answered with options of this command alone."""
    parser_options: dict[str, Any] = {"config": (FlagCreatePairsOff, OmitArgPrefixes)}
    name = arguments[0] if arguments else ""
    if name not in COMMANDS:
        return tyro.cli(_list_commands(), prog="lite6jax", description=DESCRIPTION, args=arguments, **parser_options)
    command = load_command(name)
    if _asks_help(arguments):
        _describe_options(command)
    text = inspect.getdoc(command) or ""  # as it stands: tyro would join the lines of the examples
    return tyro.cli(command, prog=f"lite6jax {name}", description=text, args=arguments[1:], **parser_options)


def _list_commands() -> Any:
    """All commands as tyro takes them, each with the first paragraph of its description."""
    commands = []
    for name in COMMANDS:
        command = load_command(name)
        text = " ".join((inspect.getdoc(command) or "").partition("\n\n")[0].split())
        commands.append(Annotated[command, subcommand(name, description=text)])
    return reduce(operator.or_, commands)


_FIELD = re.compile(r'^    (\w+):(?:(?!^    \w).)*?^    """(.*?)"""', re.MULTILINE | re.DOTALL)
"""A field of a class and the description below it."""


def _describe_options(command: Any) -> None:
    """Lets help show a command's options, and groups of options in it, as people read them.

    Nothing is said of the default of an option that is left out, or of a flag that is not set. Descriptions become one
    paragraph: tyro would keep the line breaks of the source.
    """
    descriptions = {name: " ".join(text.split()) for name, text in _FIELD.findall(inspect.getsource(command))}
    for name, annotation in command.__annotations__.items():
        if is_dataclass(annotation):
            _describe_options(annotation)
        else:
            described = arg(help=descriptions.get(name), help_behavior_hint=_describe_default)
            command.__annotations__[name] = Annotated[annotation, described]


def _describe_default(default: str) -> str:
    if default in ("None", "False", ""):
        return ""
    if default == "True":
        return "(default: on)"
    return f"(default: {default})"


class _Wrapping:
    """A stream that breaks lines of prose at words before it hands them on; frames are as wide as they are."""

    def __init__(self, stream: Any, width: int) -> None:
        self._stream = stream
        self._width = width

    def write(self, text: str) -> int:
        self._stream.write("\n".join(map(self._wrap, text.split("\n"))))
        return len(text)

    def _wrap(self, line: str) -> str:
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
def _wrap_lines() -> Iterator[None]:
    """Within, lines that are printed break at words."""
    stream = sys.stdout
    sys.stdout = _Wrapping(stream, max(40, shutil.get_terminal_size().columns))  # type: ignore[assignment]
    try:
        yield
    finally:
        sys.stdout = stream
