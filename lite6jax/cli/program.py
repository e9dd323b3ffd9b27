"""The program: which commands there are, how one is run, and what becomes of its mistakes."""

import gc
import inspect
import operator
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import reduce
from importlib.metadata import PackageNotFoundError, version
from io import TextIOWrapper
from typing import Annotated, Any

import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, subcommand

from lite6jax.cli.compensate import Compensate
from lite6jax.cli.demo import Demo
from lite6jax.cli.design import Design
from lite6jax.cli.diagnose import Diagnose
from lite6jax.cli.emulate import Emulate
from lite6jax.cli.exit_codes import BAD_INPUT, DONE, INTERRUPTED, MEANINGS, READER_LEFT
from lite6jax.cli.files import Check, Convert
from lite6jax.cli.fit import Compare, Fit
from lite6jax.cli.fleet import Fleet
from lite6jax.cli.help import is_help, with_readable_options, wrapped
from lite6jax.cli.init import Init
from lite6jax.cli.listing import Arms, Effects
from lite6jax.cli.live import Read, Record
from lite6jax.cli.predict import Predict
from lite6jax.cli.report import Report
from lite6jax.cli.simulate import Simulate
from lite6jax.cli.study import Identify, Sensitivity
from lite6jax.cli.view import View
from lite6jax.errors import InputError, InputWarning

COMMANDS = {
    "init": Init,
    "fit": Fit,
    "compare": Compare,
    "fleet": Fleet,
    "identify": Identify,
    "sensitivity": Sensitivity,
    "design": Design,
    "diagnose": Diagnose,
    "report": Report,
    "view": View,
    "predict": Predict,
    "compensate": Compensate,
    "simulate": Simulate,
    "emulate": Emulate,
    "convert": Convert,
    "check": Check,
    "read": Read,
    "record": Record,
    "effects": Effects,
    "arms": Arms,
    "demo": Demo,
}
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
        with wrapped() if is_help(arguments) else nullcontext():
            command = tyro.cli(
                _subcommands(arguments), prog="lite6jax", description=DESCRIPTION, args=arguments,
                config=(FlagCreatePairsOff, OmitArgPrefixes),
            )  # fmt: skip
        from lite6jax.fitting.compiled import keep_compiled_code

        keep_compiled_code()
        gc.set_threshold(200_000)  # tracing makes objects that stay; to look them through again and again takes a tenth
        with _warnings_as_lines():
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


def _subcommands(arguments: Sequence[str]) -> Any:
    """The commands as tyro takes them; the list of all commands has their first paragraphs only."""
    options, alone = [], not set(arguments) & set(COMMANDS)
    for name, command in COMMANDS.items():
        text = inspect.getdoc(command) or ""  # as it stands: tyro would join the lines of the examples
        if alone:
            text = " ".join(text.partition("\n\n")[0].split())
        elif is_help(arguments):
            with_readable_options(command)
        options.append(Annotated[command, subcommand(name, description=text)])
    return reduce(operator.or_, options)


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Prints each warning of the input once, as one line on stderr."""
    shown, said = warnings.showwarning, set()

    def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
        if not issubclass(category, InputWarning):
            shown(message, category, *place)
        elif str(message) not in said:
            said.add(str(message))
            print(f"warning: {_one_line(message)}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", InputWarning)
        warnings.showwarning = show
        yield


def _one_line(error: Warning | str | InputError) -> str:
    """The message with what would break the line, or steer the terminal, spelled out."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(error))


def _version() -> str:
    try:
        return version("lite6jax")
    except PackageNotFoundError:
        return "(not installed)"
