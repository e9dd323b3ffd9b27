"""A diagnosis as a page: self-contained HTML of all sections, or its certificate, one A4 sheet as PDF.

The same diagnosis gives the same bytes: no clock and no file name beside those in its document is written.
"""

import base64
from collections.abc import Mapping
from datetime import datetime
from functools import cache
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure
from rich.console import Console

from lite6jax import storage
from lite6jax.diagnosis.document import domain_of
from lite6jax.diagnosis.result import DomainDiagnosis
from lite6jax.domains.registry import DOMAINS
from lite6jax.errors import InputError
from lite6jax.formatting import quantity
from lite6jax.report import ranking, statements
from lite6jax.report.diagnosis_figures import drawings, finding_figure, prefix_of
from lite6jax.report.faults import fault_name
from lite6jax.report.figures import STYLE
from lite6jax.report.ranking import Files
from lite6jax.report.remedies import effect_title
from lite6jax.report.reports import own_report
from lite6jax.report.sections import Picture, Section, parts_of, show_sections
from lite6jax.report.sentences import diagnosis as sentences
from lite6jax.report.sentences.document import words_of
from lite6jax.report.words import read_texts

Document = Mapping[str, Any]

# ------------------------------------------------------------------ HTML


_DPI = 120


def diagnosis_page(
    diagnosis: DomainDiagnosis[Any],
    document: Document,
    source: str | None = None,
    figures: Mapping[str, Figure] | None = None,
    files: Files | None = None,
) -> str:
    """The page, HTML; of both domains one after the other.

    Args:
        diagnosis: the diagnosis, of which the figures of single findings are drawn.
        document: as in its JSON file, with statements; all text is made from it.
        source: the recording's name, of any characters; that of the diagnosis where not given.
        figures: those of `diagnosis_figures.drawings`; drawn where not given.
        files: for commands to copy; without them there are none, and without a source the recording's where it is one.
    """
    recorded = diagnosis.recording.source
    if source is None and storage.exists(recorded):
        files = files or Files(Path(recorded))
    if source is None:
        source = recorded
    if figures is None:
        figures = dict(drawings(diagnosis, Path(source).name, document))
    pictures = [_pictures(diagnosis, document, figures)]
    for other in diagnosis.beside:
        prefix = prefix_of(other.domain)
        of_domain = {name.removeprefix(prefix): figure for name, figure in figures.items() if name.startswith(prefix)}
        pictures.append(_pictures(other, document[other.domain], of_domain))
    parts = parts_of(document, files, pictures=pictures)
    return _template().render(source=source, verdict=document["verdict"], parts=parts)


def _pictures(diagnosis: DomainDiagnosis[Any], document: Document, figures: Mapping[str, Figure]) -> dict[str, Picture]:
    """The figures that have a place of their own, and one of each finding."""
    captions = read_texts("diagnosis.yaml")["captions"].get(document["domain"], {})
    drawn = {name: _picture(figures[name], caption) for name, caption in captions.items() if name in figures}
    if own_report(document) is not None:
        return drawn
    order = ranking.order(document)
    words = words_of(document)
    for finding in statements.findings_of(document):
        over = ""
        if finding["driver"] != "none":
            over = f" over the {finding['driver']}"
        subject = words.caption(finding, over, effect_title(finding))
        caption = f"{subject} beside the partial residuals: those of the whole model without it."
        drawn[f"finding{finding['rank']}"] = _picture(finding_figure(diagnosis, "", [finding["place"]], order), caption)
    return drawn


def _picture(figure: Figure, caption: str) -> Picture:
    buffer = BytesIO()
    with rc_context(STYLE):
        figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    data = "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
    return Picture(data, caption, sum(panel.get_visible() for panel in figure.axes) == 1)


@cache
def _template() -> jinja2.Template:
    loader = jinja2.PackageLoader("lite6jax.report")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html")


# ------------------------------------------------------------------ the certificate


_WIDTH = 8.27
_HEIGHT = 11.69
_MARGIN = 0.75
"""Inches, of A4 and its margins."""
_SIZE = 7.8
_LINE = 0.148
_CHARACTERS = 100
"""Points of a letter, inches from line to line, and letters in a line."""
_MOST = 14
"""Findings that the page has room for."""
_NORMAL_95 = 1.96


def write_certificate(document: Document, path: str | Path, overwrite: bool = False) -> Path:
    """Writes the page as PDF, atomically; its date is that of the measurement.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    figure = certificate(document)
    day = document["date"]
    made = None if day is None else datetime.fromisoformat(day)
    metadata = {"Creator": "lite6jax", "Producer": "lite6jax", "CreationDate": made}

    def write(target: Path) -> None:
        with rc_context({"pdf.fonttype": 42}):
            figure.savefig(target, format="pdf", metadata=metadata)

    return storage.write_atomically(path, write, overwrite)


def certificate(document: Document) -> Figure:
    """The page of a diagnosis of poses or of torques, as in its JSON file; what does not fit is left out.

    Raises:
        InputError: a diagnosis of commands and joints, of which there is no certificate.
    """
    if own_report(document) is not None:
        measured = DOMAINS[domain_of(document)].words.measured
        raise InputError(f"certificate: is of poses or torques, and this diagnosis is of {measured}; leave it out")
    words = words_of(document)
    accuracy = [("text", words.accuracy)] if words.accuracy else []
    faults = list(dict.fromkeys(fault_name(entry["fault"]).lower() for entry in document["data_faults"]))
    sections = [
        Section("Certificate of accuracy", [("text", ranking.headline(document)), ("pairs", _subject(document))]),
        Section(
            "Accuracy on rows that were not used",
            [
                ("table", statements.error_rows(document)),
                ("text", sentences.held_out(document)),
                *accuracy,
            ],
        ),
        Section("Findings, with 95 % intervals", [("text", line) for line in _findings(document)]),
        Section(
            "Verdict and data",
            [
                ("text", sentences.verdict_statement(document)),
                ("text", f"Data faults, corrected or weighted: {', '.join(faults) or 'none'}."),
            ],
        ),
        Section(
            "Files (SHA-256)",
            [("text", line) for e in document.get("inputs", ()) for line in (f"{e['role']}: {e['file']}", e["sha256"])],
        ),
    ]
    buffer = StringIO()
    console = Console(file=buffer, width=_CHARACTERS, highlight=False, markup=False, emoji=False)
    for part in show_sections(sections):
        console.print(part)
    figure = Figure(figsize=(_WIDTH, _HEIGHT))
    y = _HEIGHT - _MARGIN
    titles = {f"{section.title}:" for section in sections}
    for line in buffer.getvalue().strip("\n").split("\n"):
        if line.strip() and y > _MARGIN / 2:
            weight = "bold" if line.strip() in titles else "normal"
            style: dict[str, Any] = {"size": _SIZE, "weight": weight, "family": "monospace", "parse_math": False}
            figure.text(_MARGIN / _WIDTH, y / _HEIGHT, line.rstrip(), va="top", **style)
        y -= _LINE
    return figure


def _subject(document: Document) -> list[tuple[str, str]]:
    instruments = read_texts("diagnosis.yaml")["instruments"]
    recording = next((entry["file"] for entry in document.get("inputs", ()) if entry["role"] == "recording"), "")
    instrument = document["instrument"] or instruments.get(document["source"], "not stated")
    noise = next(iter(document["noise"]["declared"].values()))
    if noise is not None:
        shown = words_of(document).declared_noise(document, noise)
        instrument += f"; declared noise {shown} (one standard deviation)"
    samples = f"{document['samples']} rows"
    if "motion" in document["model"]:
        samples += f", {document['model']['motion']}"
    return [
        ("Arm", document["model"]["arm"]),
        ("Recording", f"{recording}, {samples}" if recording else samples),
        ("Date", document["date"] or "not stated"),
        ("Instrument", instrument),
    ]


def _findings(document: Document) -> list[str]:
    """A line for each finding: rank, name, interval of each number, and what it moves."""
    special_units = words_of(document).special_units
    findings = statements.findings_of(document)
    lines = []
    for finding in findings[:_MOST]:
        numbers = finding.get("peak_to_peak", finding["parameters"])
        parts = [_interval(name, estimate, special_units) for name, estimate in numbers.items()]
        parts.append(f"moves {finding['contribution']} RMS")
        lines.append(f"{finding['rank']}. {finding['title']}: {'; '.join(parts)}")
    if len(findings) > _MOST:
        lines.append(f"and {len(findings) - _MOST} more, which move less; the JSON file has all of them")
    return lines or ["None."]


def _interval(name: str, estimate: Mapping[str, float], special_units: Mapping[str, tuple[float, str]]) -> str:
    """The 95 % interval of a number in the unit in which it is read; one that was chosen has none."""
    value = estimate["value"]
    std = estimate["std"]
    middle, *ends = (
        quantity(name, {"value": value + side * _NORMAL_95 * std, "std": std}, special_units) for side in (0, -1, 1)
    )
    between = f" [{ends[0].value}, {ends[1].value}]" if std else ""
    return f"{middle.name} {middle.value}{between} {middle.unit}".rstrip()
