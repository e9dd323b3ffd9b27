"""A diagnosis of poses and torques: its statements, its screen report and its page."""

from collections.abc import Iterator, Mapping
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure
from rich.console import RenderableType
from rich.text import Text

from lite6jax.diagnosis.combined import CombinedDiagnosis
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.report import (
    diagnosis_figures,
    diagnosis_tables,
    page,
    shared,
    statements,
    torque_figures,
    torque_page,
    torque_statements,
    worth,
)
from lite6jax.report.next_steps import Files
from lite6jax.report.rendering import template
from lite6jax.report.sections import indented

Document = Mapping[str, Any]

PREFIX = "torque_"
"""Of the names of the figures of torques, beside those of poses."""


def with_statements(document: Document) -> dict[str, Any]:
    """A document of both domains, or of poses whose torques were refused, with statements throughout."""
    stated = statements.with_statements(document)
    if "torques" in document:
        stated["torques"] = torque_statements.with_statements(document["torques"])
        stated["shared"] = shared.with_statements(document["shared"])
    return stated


def stated_document(found: Diagnosis | TorqueDiagnosis | CombinedDiagnosis) -> dict[str, Any]:
    """The document of any diagnosis, with statements."""
    document = found.to_dict()
    if isinstance(found, TorqueDiagnosis):
        return torque_statements.with_statements(document)
    return with_statements(document)


def combined_report(
    document: Document, source: str, files: Files | None = None, details: bool = False
) -> Iterator[RenderableType]:
    """The screen report: the poses, the torques, and what both depend on.

    Args:
        document: as in the JSON file, with statements.
        source: the recording.
        files: for commands to copy; without them there are none.
        details: whether to show what was ruled out and not tested.
    """
    yield Text("Poses", style="bold")
    yield from diagnosis_tables.diagnosis_report(document, source, files, details)
    if "torques" not in document:
        yield Text(shared.refusal(document))
        yield ""
        return
    yield Text("Torques", style="bold")
    yield from diagnosis_tables.diagnosis_report(document["torques"], source, None, details)
    yield Text(f"{shared.HEADING}:")
    yield from map(indented, [entry["statement"] for entry in document["shared"]] or [shared.NOTHING])
    yield ""


def drawings(found: CombinedDiagnosis, title: str, document: Document) -> Iterator[tuple[str, Figure]]:
    """The figures by name, those of torques with `PREFIX`; findings in the order of the document's report."""
    yield from diagnosis_figures.drawings(found.poses, title, worth.order(document))
    if found.torques is not None:
        order = worth.order(document["torques"])
        yield from ((PREFIX + name, figure) for name, figure in torque_figures.drawings(found.torques, title, order))


def combined_page(
    found: CombinedDiagnosis,
    document: Document,
    source: str,
    figures: Mapping[str, Figure],
    files: Files | None = None,
) -> str:
    """The page, HTML; both domains one after the other.

    Args:
        found: with torques.
        document: as in its JSON file, with statements.
        source: the recording's name, of any characters.
        figures: those of both domains, of torques with `PREFIX`.
        files: for commands to copy; without them there are none.
    """
    assert found.torques is not None
    torques = {name.removeprefix(PREFIX): each for name, each in figures.items() if name.startswith(PREFIX)}
    poses = {name: each for name, each in figures.items() if not name.startswith(PREFIX)}
    parts = [
        ("Poses", "diagnosis_content.html", page.page_values(found.poses, document, source, poses, files), ""),
        (
            "Torques",
            "torque_diagnosis_content.html",
            torque_page.page_values(found.torques, document["torques"], source, torques),
            "torque-",
        ),
    ]
    return template("combined.html").render(
        source=source,
        verdict_word=document["verdict"],
        heading=shared.HEADING,
        shared=[entry["statement"] for entry in document["shared"]] or [shared.NOTHING],
        parts=[
            {
                "title": title,
                "header": Markup(template("diagnosis_header.html").render(**values, anchor=anchor)),
                "content": Markup(template(name).render(**values, anchor=anchor)),
            }
            for title, name, values, anchor in parts
        ],
    )
