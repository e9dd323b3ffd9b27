"""The commands: arguments in, sentences, tables and files out; the numbers come from the library.

What computes or draws is imported by the command that needs it: help and mistakes answer at once.
"""

from lite6jax.cli.program import main

__all__ = ["main"]
