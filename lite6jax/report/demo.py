"""What the demo prints between the commands that it runs, and at the end: the hidden faults beside the findings."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from rich.console import RenderableType
from rich.text import Text

from lite6jax.diagnosis.result import Diagnosis
from lite6jax.effects.effect import Effect
from lite6jax.errors import command_line
from lite6jax.report.sections import Report, sections_of, show_sections
from lite6jax.report.words import listing, quantity


def beginning(run: Path, poses: int) -> Iterator[RenderableType]:
    """What is simulated, and what happens next."""
    yield Text(
        f"No arm was measured: this Lite 6 is simulated. Two faults are hidden in it, and a laser tracker measures "
        f"it at {poses} poses."
    )
    yield ""
    yield Text("1. What is wrong with the arm?", style="bold")
    yield Text(f"The diagnosis sees {run} only and knows nothing of the faults. It takes about half a minute.")


def diagnosed(document: Mapping[str, Any], run: Path, diagnosis: Path, page: Path) -> Iterator[RenderableType]:
    """The command that gives the same, and the main of what it found.

    Args:
        document: of the diagnosis, with statements.
        run: the recording.
        diagnosis: the document's file.
        page: the page's.
    """
    yield _command("diagnose", run, "--quick", out=diagnosis, report=page)
    yield ""
    sections = sections_of(Report(document))
    yield from show_sections([one for one in sections if not one.title or one.title.startswith("What each")])
    yield ""


def before_the_fit(factory: Path, table: Path) -> Iterator[RenderableType]:
    """What the fit of the factory calibration is for."""
    yield Text("2. Its factory calibration as a DH table", style="bold")
    yield Text(
        "Some vendors measure each arm in the factory: six numbers a joint, here simulated as well. The fit turns them "
        "into a DH table."
    )
    yield _command("fit", factory, out=table)
    yield ""


def end(hidden: Sequence[tuple[Effect, NDArray]], found: Diagnosis, page: Path) -> Iterator[RenderableType]:
    """The hidden faults beside the findings, and where the page is."""
    findings = {finding.effect.label: finding.parameters for finding in found.findings}
    table = listing("", "hidden", "found", "")
    yield ""
    yield Text("3. What was hidden, and what was found", style="bold")
    for effect, values in hidden:
        name = f"{effect.name.replace('_', ' ')} at {effect.site}"
        for parameter, true in effect.reported(values).items():
            truth = quantity(parameter, true._asdict())
            if effect.label not in findings:
                table.add_row(name, truth.value, "not found", truth.unit)
                continue
            seen = quantity(parameter, findings[effect.label][parameter]._asdict())
            table.add_row(name, truth.value, f"{seen.value} ± {seen.std}", truth.unit)
    yield table
    others = [label for label in findings if label not in {effect.label for effect, _ in hidden}]
    if others:
        yield Text(f"Found and not hidden: {', '.join(others)}.")
    yield ""
    yield Text("The page with the figures, to be opened in a browser:")
    yield Text(f"  {page}", no_wrap=True, overflow="ignore")


def _command(*words: object, **files: Path) -> Text:
    """A command to copy, with a line for each option that names a file."""
    options = (f"--{name} {shlex.quote(str(path))}" for name, path in files.items())
    return Text(" \\\n    ".join([f"$ {command_line(*words)}", *options]), no_wrap=True, overflow="ignore")
