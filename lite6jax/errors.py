"""The error of invalid user input, the warning of input that is used all the same, and commands that messages name."""

import os
import shlex
import subprocess
from types import UnionType


class InputError(ValueError):
    """Invalid input of a user: a file, an argument or an option.

    The message is one line that names the file, the place in it and the remedy. The command line prints it and exits
    with code 2.
    """


class InputWarning(UserWarning):
    """Input of a user that is used, but of which something should be known, such as a file that was edited.

    The message is one line that names the file. The command line prints it on stderr.
    """


def wrong_type(argument: str, given: object, accepted: str) -> InputError:
    """The error of an argument whose type is not `accepted`, which is a phrase after "give"."""
    return InputError(f"{argument}: has the type {type(given).__name__}; give {accepted}")


def require_type(argument: str, given: object, kinds: type | UnionType, accepted: str) -> None:
    """Refuses an argument of another type than `kinds`, as `wrong_type` words it.

    Raises:
        InputError: as said.
    """
    if not isinstance(given, kinds):
        raise wrong_type(argument, given, accepted)


def command_line(*arguments: object) -> str:
    """A command `lite6jax …` as the shell takes it, names with spaces quoted."""
    words = ["lite6jax", *map(str, arguments)]
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)
