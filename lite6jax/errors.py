"""The error of invalid user input, the warning of input that is used all the same, and commands that messages name."""

import os
import re
import shlex
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from types import UnionType


class InputError(ValueError):
    """Invalid input of a user: a file, an argument or an option.

    The message is one line that names the file, the place in it and the remedy. An argument is named as in Python, in
    backquotes: `overwrite=True`. The command line prints the message with the options of commands in their place
    (`name_options`) and exits with code 2.
    """


class InputWarning(UserWarning):
    """Input of a user that is used, but of which something should be known, such as a file that was edited.

    The message is one line that names the file. The command line prints it on stderr.
    """


_OPTIONS = {"overwrite": "force", "nominal": "arm"}
"""Arguments that commands call otherwise than functions do."""
_ARGUMENT = re.compile(r"`(\w+)=(?:True|'([^'`]+)'|([^'`]+))`")


def name_options(message: str) -> str:
    """A message with options of commands for the arguments of functions: `geometry='free'` becomes --geometry free."""

    def spell(argument: re.Match[str]) -> str:
        name, text, value = argument.groups(default="")
        option = "--" + _OPTIONS.get(name, name).replace("_", "-")
        return " ".join(filter(None, (option, text, re.sub(r"[(),]", "", value))))

    return _ARGUMENT.sub(spell, message)


@contextmanager
def rename_argument(name: str, renamed: str) -> Iterator[None]:
    """Lets the messages of errors within name an argument as the function that calls the others has it.

    Raises:
        InputError: that of within.
    """
    try:
        yield
    except InputError as error:
        raise InputError(str(error).replace(f"`{name}=", f"`{renamed}=")) from error


def wrong_type(argument: str, argument_value: object, accepted: str) -> InputError:
    """The error of an argument whose type is not `accepted`, which is a phrase after "give"."""
    return InputError(f"{argument}: has the type {type(argument_value).__name__}; give {accepted}")


def require_type(argument: str, argument_value: object, kinds: type | UnionType, accepted: str) -> None:
    """Refuses an argument of another type than `kinds`, as `wrong_type` words it.

    Raises:
        InputError: as said.
    """
    if not isinstance(argument_value, kinds):
        raise wrong_type(argument, argument_value, accepted)


def command_line(*arguments: object) -> str:
    """A command `lite6jax …` as the shell takes it, names with spaces quoted."""
    words = ["lite6jax", *map(str, arguments)]
    if os.name == "nt":
        return subprocess.list2cmdline(words)
    return shlex.join(words)
