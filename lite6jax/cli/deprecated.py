"""Old spellings of options: each is replaced by the new one before the command line is parsed, with one warning."""

import sys
from collections.abc import Mapping, Sequence
from typing import NamedTuple


class Renamed(NamedTuple):
    """What replaces an option.

    Attributes:
        new: the spelling that replaces the old one; it takes the same values.
        since: the version that deprecated the old spelling.
        removed: the version that no longer accepts it.
    """

    new: str
    since: str
    removed: str


RENAMED: Mapping[str, Mapping[str, Renamed]] = {
    "design": {
        "--rivals": Renamed("--discriminate", "0.2.0", "0.4.0"),
        "--geometry": Renamed("--collision-geometry", "0.2.0", "0.4.0"),
    },
    "diagnose": {"--against": Renamed("--reference", "0.2.0", "0.4.0")},
}
"""By command, then by the old spelling. An entry is all that a renamed option needs."""


def current_spelling(arguments: Sequence[str]) -> list[str]:
    """The command line with each old spelling replaced; one line on stderr says so for each.

    Args:
        arguments: the command line without the program's name: a command, then its options, as `--name value` or
            `--name=value`.
    """
    command = arguments[0] if arguments else ""
    spelled = []
    for argument in arguments:
        name, separator, value = argument.partition("=")
        renamed = RENAMED.get(command, {}).get(name)
        if renamed is None:
            spelled.append(argument)
            continue
        print(
            f"warning: {command} {name} is deprecated since {renamed.since} and will be removed in {renamed.removed};"
            f" write {renamed.new}",
            file=sys.stderr,
        )
        spelled.append(renamed.new + separator + value)
    return spelled
