"""A diagnosis as a page: self-contained HTML of all sections, or its certificate, one A4 sheet as PDF.

The same diagnosis gives the same bytes: no clock and no file name beside those in its document is written.
"""

import base64
import textwrap
from collections.abc import Mapping, Sequence
from datetime import datetime
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import jinja2
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from lite6jax import storage
from lite6jax.diagnosis.combined import CombinedDiagnosis
from lite6jax.diagnosis.result import Diagnosis
from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.report import ranking, reference, statements
from lite6jax.report.canvas import STYLE
from lite6jax.report.diagnosis_figures import PREFIX, drawings, finding_figure
from lite6jax.report.faults import fault_name
from lite6jax.report.ranking import Files, of_torques, units
from lite6jax.report.remedies import effect_title
from lite6jax.report.sections import HEADER, SECTIONS, Picture, Report
from lite6jax.report.words import OF_TORQUES, each_with_unit, number, quantity

Document = Mapping[str, Any]

# ------------------------------------------------------------------ HTML


_DPI = 120
_CAPTIONS = {
    "error_by_joint": "Held-out position error against each joint: dots are samples, lines are medians.",
    "where": "Share of the residual's variance that a smooth function of each driver explains at each site, less what "
    "as many numbers explain of noise: of several the largest share. Each contains a constant, which is shown alone in "
    "the first column; of two drivers only the likeliest functions were tried. A dash where none was, the driver is "
    "not recorded or does not vary, or the function is confounded with the nuisance.",
    "orders": "Share of the residual's variance that a harmonic of each order explains at each joint, before and after "
    "(of the residual at that stage); the dotted line is the family-wise limit of white noise.",
}
_TORQUE_CAPTIONS = {
    "error_by_joint": "Held-out torque error of each joint, by the arm's model alone and with the findings. "
    "Dashed lines are the standard deviations of the measured torques themselves.",
    "over_time": "Torques of each joint as measured, of the rigid-body model, and modelled with the findings, in a "
    "part of the recording; all have passed the same low-pass filter.",
    "friction": "What the model without friction leaves of each joint's torque over the velocity of the joint, and the "
    "friction that was found, at the median load and temperature with the other joints at rest.",
    "spectra": "Power spectral densities of velocities and torques as recorded. A low pass removes what is right of a "
    "dashed line: the velocity is noise there, and differentiating would enlarge it.",
}


def diagnosis_page(
    found: Diagnosis | TorqueDiagnosis | CombinedDiagnosis,
    document: Document,
    source: str,
    figures: Mapping[str, Figure],
    files: Files | None = None,
) -> str:
    """The page, HTML; of both domains one after the other.

    Args:
        found: the diagnosis, of which the figures of single findings are drawn.
        document: as in its JSON file, with statements; all text is made from it.
        source: the recording's name, of any characters.
        figures: those of `diagnosis_figures.drawings`.
        files: for commands to copy; without them there are none.
    """
    poses = found.poses if isinstance(found, CombinedDiagnosis) else found
    torques = found.torques if isinstance(found, CombinedDiagnosis) else None
    reports = [("", Report(document, source, files, pictures=_pictures(poses, document, figures)))]
    if torques is not None:
        reports = [("Poses", reports[0][1])]
        own = {name.removeprefix(PREFIX): each for name, each in figures.items() if name.startswith(PREFIX)}
        shown = _pictures(torques, document["torques"], own)
        reports.append(("Torques", Report(document["torques"], source, pictures=shown, anchor="torque-")))
    return _template().render(
        source=source,
        verdict_word=document["verdict"],
        heading=reference.SHARED,
        shared=[] if torques is None else reference.shared_statements(document),
        parts=[
            {"title": title, "header": report.page(HEADER), "content": report.page(SECTIONS)}
            for title, report in reports
        ],
    )


def page_text(
    found: Diagnosis | TorqueDiagnosis | CombinedDiagnosis, document: dict[str, Any], files: Files | None = None
) -> str:
    """The page of a diagnosis with its figures, HTML.

    Args:
        found: the diagnosis.
        document: as in its JSON file, with statements.
        files: for commands to copy; the recording's, where that is a file, where not given.
    """
    poses = found.poses if isinstance(found, CombinedDiagnosis) else found
    source = (poses.problem.data if isinstance(poses, TorqueDiagnosis) else poses.problem).recording.source
    if files is None and storage.exists(source):
        files = Files(Path(source))
    figures = dict(drawings(found, Path(source).name, document))
    return diagnosis_page(found, document, source, figures, files)


def _pictures(
    found: Diagnosis | TorqueDiagnosis, document: Document, figures: Mapping[str, Figure]
) -> dict[str, Picture]:
    """The figures that have a place of their own, and one of each finding."""
    torques, order = of_torques(document), ranking.order(document)
    captions = _TORQUE_CAPTIONS if torques else _CAPTIONS
    drawn = {name: _picture(figures[name], caption) for name, caption in captions.items() if name in figures}
    for rank, finding in enumerate(statements.findings_of(document), 1):
        over = "" if finding["driver"] == "none" else f" over the {finding['driver']}"
        if torques:
            what = f"The torque of this finding{over or f' over {effect_title(finding)}'},"
        else:
            name = "effect" if finding["effect"] == "unnamed" else finding["effect"].replace("_", " ")
            what = f"The fitted {name} at {finding['site']}{over} with its 95 % band,"
        caption = f"{what} beside the partial residuals: those of the whole model without it."
        drawn[f"finding{rank}"] = _picture(finding_figure(found, "", [finding["place"]], order), caption)
    return drawn


def _picture(figure: Figure, caption: str) -> Picture:
    return Picture(_embedded(figure), caption, sum(panel.get_visible() for panel in figure.axes) == 1)


def _embedded(figure: Figure) -> str:
    held = BytesIO()
    with rc_context(STYLE):
        figure.savefig(held, format="png", dpi=_DPI, metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(held.getvalue()).decode()


@cache
def _template() -> jinja2.Template:
    loader = jinja2.PackageLoader("lite6jax.report")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.get_template("page.html")


# ------------------------------------------------------------------ the certificate


_WIDTH, _HEIGHT, _MARGIN = 8.27, 11.69, 0.75
"""Inches, of A4 and its margins."""
_LINE = 0.165
"""Inches from line to line."""
_CHARACTERS = 104
_MOST = 14
"""Findings that the page has room for."""
_NORMAL_95 = 1.96
_INSTRUMENTS = {
    "laser_tracker": "laser tracker",
    "motion_capture": "motion capture",
    "camera": "camera",
    "controller_fk": "none: forward kinematics of the controller",
    "measured": "torque sensors of the joints",
    "current": "motor currents",
    "estimated": "none: torques estimated by the controller",
}


def write_certificate(document: Document, path: str | Path, overwrite: bool = False) -> Path:
    """Writes the page as PDF, atomically; its date is that of the measurement.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    figure, day = certificate(document), document["date"]
    made = None if day is None else datetime.fromisoformat(day)
    metadata = {"Creator": "lite6jax", "Producer": "lite6jax", "CreationDate": made}

    def write(target: Path) -> None:
        with rc_context({"pdf.fonttype": 42}):
            figure.savefig(target, format="pdf", metadata=metadata)

    return storage.write_atomically(path, write, overwrite)


def certificate(document: Document) -> Figure:
    """The page of a diagnosis of poses or of torques, as in its JSON file."""
    page = _Sheet()
    torques = of_torques(document)
    page.text("Certificate of accuracy", size=17, weight="bold", space=2.0)
    page.text(ranking.headline(document), size=10.5, space=1.0)
    page.rows(_subject(document))
    page.heading("Accuracy on rows that were not used")
    rows = []
    for name, unit, statistic, before, after in statements.errors(document):
        ratio = f"{100 * after / before:.0f} %" if before else "–"
        said = f"{name} ({unit}), {statements.STATISTICS[statistic]}"
        rows.append([said, number(before), number(after), ratio])
    page.table(["torque error" if torques else "", "before", "after", "after / before"], rows)
    page.text(
        statements.held_out_statement(document)
        + " Errors are distances between what the model predicts and what was measured. They resemble the pose"
        " accuracy of ISO 9283, which is defined for attained and commanded poses of its own test cycle."
        * (not torques),
        colour="#5c5c5c",
        size=7.5,
    )
    page.heading("Findings, with 95 % intervals")
    for line in _findings(document):
        page.text(line, size=8.5)
    page.heading("Verdict and data")
    page.text(statements.verdict_statement(document), size=8.5)
    faults = list(dict.fromkeys(fault_name(entry["fault"]).lower() for entry in document["data_faults"]))
    page.text(f"Data faults, corrected or weighted: {', '.join(faults) or 'none'}.", size=8.5)
    page.heading("Files (SHA-256)")
    for entry in document.get("inputs", ()):
        page.text(f"{entry['role']}: {entry['file']}", size=7.5)
        page.text(entry["sha256"], size=7, family="monospace")
    return page.figure


class _Sheet:
    """Lines of text from the top of an A4 page to its bottom; what does not fit is left out."""

    def __init__(self) -> None:
        self.figure = Figure(figsize=(_WIDTH, _HEIGHT))
        self._y = _HEIGHT - _MARGIN

    def text(
        self, text: str, size: float = 9, weight: str = "normal", space: float = 0.0, colour: str = "black",
        family: str = "sans-serif",
    ) -> None:  # fmt: skip
        """Wrapped lines, and after them a space of so many lines."""
        for line in textwrap.wrap(text, int(_CHARACTERS * 8.5 / size)) or [""]:
            self._draw(_MARGIN, line, size=size, weight=weight, color=colour, family=family)
            self._y -= _LINE * max(size / 8.5, 0.9)
        self._y -= _LINE * space

    def heading(self, text: str) -> None:
        """A line in bold with a rule below."""
        self._y -= 0.9 * _LINE
        self.text(text, size=11, weight="bold")
        y = (self._y + 0.04) / _HEIGHT
        ends = [_MARGIN / _WIDTH, 1 - _MARGIN / _WIDTH]
        rule = Line2D(ends, [y, y], color="#d9d9d9", linewidth=0.8, transform=self.figure.transFigure)
        self.figure.add_artist(rule)
        self._y -= 0.5 * _LINE

    def rows(self, pairs: Sequence[tuple[str, str]]) -> None:
        """Names with values beside them."""
        for name, value in pairs:
            self._draw(_MARGIN, name, size=9, color="#5c5c5c")
            for line in textwrap.wrap(value, 76) or [""]:
                self._draw(_MARGIN + 1.5, line, size=9)
                self._y -= 1.1 * _LINE

    def table(self, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Columns of numbers, right-aligned beside the first."""
        step = (_WIDTH - 2 * _MARGIN - 2.3) / max(len(header) - 1, 1)
        for k, row in enumerate((header, *rows)):
            weight = "bold" if k == 0 else "normal"
            self._draw(_MARGIN, row[0], size=9, weight=weight)
            for column, cell in enumerate(row[1:], 1):
                self._draw(_MARGIN + 2.3 + step * column, cell, size=9, weight=weight, ha="right")
            self._y -= 1.15 * _LINE
        self._y -= 0.4 * _LINE

    def _draw(self, x: float, text: str, **style: Any) -> None:
        if text and self._y > _MARGIN / 2:
            self.figure.text(x / _WIDTH, self._y / _HEIGHT, text, va="top", parse_math=False, **style)


def _subject(document: Document) -> list[tuple[str, str]]:
    torques = of_torques(document)
    recording = next((entry["file"] for entry in document.get("inputs", ()) if entry["role"] == "recording"), "")
    source = document["torque_source" if torques else "pose_source"]
    instrument = document["instrument"] or _INSTRUMENTS.get(source, "not stated")
    noise = document["noise"]["declared_torque_Nm" if torques else "declared_position_m"]
    if noise is not None:
        shown = each_with_unit(noise, units(document)) if torques else f"{number(1e3 * noise)} mm per axis"
        instrument += f"; declared noise {shown} (one standard deviation)"
    samples = f"{document['samples']} rows" + ("" if torques else f", {document['model']['motion']}")
    return [
        ("Arm", document["model"]["arm"]),
        ("Recording", f"{recording}, {samples}" if recording else samples),
        ("Date", document["date"] or "not stated"),
        ("Instrument", instrument),
    ]


def _findings(document: Document) -> list[str]:
    """A line for each finding: rank, name, interval of each number, and what it moves."""
    torques, findings = of_torques(document), statements.findings_of(document)
    lines = []
    for rank, finding in enumerate(findings[:_MOST], 1):
        numbers = {} if statements.peak_to_peak(finding) else finding.get("peak_to_peak", finding["parameters"])
        said = [_interval(name, estimate, torques) for name, estimate in numbers.items()]
        said.append(f"moves {ranking.contribution(document, finding)} RMS")
        lines.append(f"{rank}. {finding['title']}: {'; '.join(said)}")
    if len(findings) > _MOST:
        lines.append(f"and {len(findings) - _MOST} more, which move less; the JSON file has all of them")
    return lines or ["None."]


def _interval(name: str, estimate: Mapping[str, float], torques: bool) -> str:
    """The 95 % interval of a number in the unit in which it is read; one that was chosen has none."""
    value, std = estimate["value"], estimate["std"]
    named = {"named": OF_TORQUES} if torques else {}
    middle, *ends = (
        quantity(name, {"value": value + side * _NORMAL_95 * std, "std": std}, **named) for side in (0, -1, 1)
    )
    between = f" [{ends[0].value}, {ends[1].value}]" if std else ""
    return f"{middle.name} {middle.value}{between} {middle.unit}".rstrip()
