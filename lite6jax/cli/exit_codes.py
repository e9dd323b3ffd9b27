"""The exit codes of every command, by name and meaning; `docs/reference/exit_codes.md` has the same table."""

from collections.abc import Mapping
from types import MappingProxyType

DONE, NOT_REACHED, BAD_INPUT, BAD_FIT = 0, 1, 2, 3
# 128 and the number of the signal, as shells count; by their numbers, which Windows lacks in part
HUNG_UP, INTERRUPTED, READER_LEFT, TERMINATED = 129, 130, 141, 143

MEANINGS: Mapping[int, str] = MappingProxyType(
    {
        DONE: "done",
        NOT_REACHED: "done, but the result is not what was asked for: a fit did not converge, a target is out of reach,"
        " a controller does not agree with its calibration, or a recording has fewer rows than asked for",
        BAD_INPUT: "the input cannot be used, or a file cannot be written; one line says which, where and what to do",
        BAD_FIT: "`fit` converged to, or `diagnose` found, a model that does not describe its data;"
        " the files are written and say so",
        HUNG_UP: "ended because its terminal was closed (SIGHUP)",
        INTERRUPTED: "interrupted by Ctrl-C (SIGINT)",
        READER_LEFT: "the program that reads the output, such as head, has ended (SIGPIPE)",
        TERMINATED: "ended by SIGTERM",
    }
)
