"""The commands: arguments in, sentences, tables and files out; the numbers come from the library.

What computes or draws is executed when a command first uses it (`deferred.import_lazily`): help and mistakes answer at
once.
"""

from collections.abc import Sequence

from lite6jax import interruption


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        arguments: the command line without the program's name. Where not given it is the process's own, and signals
            end the process (`interruption.end_on_signals`), from before the first import that takes time.

    Returns:
        the exit code, as in `lite6jax.cli.command`.
    """
    if arguments is None:
        interruption.end_on_signals()
    from lite6jax.cli import program

    return program.main(arguments)


__all__ = ["main"]
