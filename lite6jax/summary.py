"""`summary()` and a notebook's table for every result of the library, in words that `lite6jax.report` writes.

A result stands below the report in the order of the parts and imports nothing of it. `Summarised` therefore loads the
report by its name, when a summary is first requested; `report/summaries.py` holds one function for each kind of result.
"""

from importlib import import_module

RENDERER = "lite6jax.report.summaries"


class Summarised:
    """What a result inherits to be read by a person. The report words it; nothing here is overridden."""

    def summary(self) -> str:
        """A few whole sentences with the main numbers, in mm, degrees and the other units of the screen."""
        return import_module(RENDERER).summary(self)

    def _repr_html_(self) -> str:
        return import_module(RENDERER).html(self)
