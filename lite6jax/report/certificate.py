"""A diagnosis on one A4 page, as PDF: accuracy before and after, findings with intervals, and what was measured.

The same document gives the same bytes: no clock and no file name beside those in it is written.
"""

import textwrap
from collections.abc import Mapping, Sequence
from datetime import date, datetime
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from lite6jax import storage
from lite6jax.checksum import checksum_of
from lite6jax.report import statements, torque_statements, worth
from lite6jax.report.cells import number
from lite6jax.report.data_faults import fault_name
from lite6jax.report.quantities import OF_TORQUES, quantity

Document = Mapping[str, Any]

_WIDTH, _HEIGHT, _MARGIN = 8.27, 11.69, 0.75
"""Inches, of A4 and its margins."""
_LINE = 0.165
"""Inches from line to line."""
_CHARACTERS = 104
_MOST = 14
"""Findings that the page has room for."""
_NORMAL_95 = 1.96
_STATISTICS = (("mean", "mean"), ("rms", "RMS"), ("p95", "95th percentile"), ("max", "maximum"))
_INSTRUMENTS = {
    "laser_tracker": "laser tracker",
    "motion_capture": "motion capture",
    "camera": "camera",
    "controller_fk": "none: forward kinematics of the controller",
    "measured": "torque sensors of the joints",
    "current": "motor currents",
    "estimated": "none: torques estimated by the controller",
}


class Stated(NamedTuple):
    """What a person states on a certificate; what is None is as the recording's sidecar declared it.

    Attributes:
        day: of the measurement.
        instrument: such as its type and serial number.
    """

    day: date | None = None
    instrument: str | None = None


def write_certificate(document: Document, path: str | Path, stated: Stated, overwrite: bool = False) -> Path:
    """Writes the page as PDF, atomically; its date is that of the measurement.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    figure = certificate(document, stated)
    return storage.write_atomically(path, partial(_print, figure, _day(document, stated)), overwrite)


def _print(figure: Figure, day: str | None, target: Path) -> None:
    made = None if day is None else datetime.fromisoformat(day)
    metadata = {"Creator": "lite6jax", "Producer": "lite6jax", "CreationDate": made}
    with rc_context({"pdf.fonttype": 42}):
        figure.savefig(target, format="pdf", metadata=metadata)


def certificate(document: Document, stated: Stated) -> Figure:
    """The page.

    Args:
        document: a diagnosis of poses or of torques, as in its JSON file.
        stated: what a person adds.
    """
    page = _Page()
    torques = worth.of_torques(document)
    page.text("Certificate of accuracy", size=17, weight="bold", space=2.0)
    page.text(worth.headline(document), size=10.5, space=1.0)
    page.rows(_subject(document, stated))
    page.heading("Accuracy on rows that were not used")
    page.table(*_accuracy(document))
    page.text(
        statements.held_out_statement(document, _rows(document))
        + " Errors are distances between what the model predicts and what was measured. They resemble the pose"
        " accuracy of ISO 9283, which is defined for attained and commanded poses of its own test cycle."
        * (not torques),
        colour="#5c5c5c",
        size=7.5,
    )
    page.heading("Findings, with 95 % intervals")
    findings = torque_statements.findings_of(document) if torques else statements.findings_of(document)
    for line in _findings(document, findings, torques):
        page.text(line, size=8.5)
    page.heading("Verdict and data")
    page.text(
        torque_statements.verdict_statement(document) if torques else statements.verdict_statement(document), size=8.5
    )
    faults = list(dict.fromkeys(fault_name(entry["fault"]).lower() for entry in document["data_faults"]))
    page.text(f"Data faults, corrected or weighted: {', '.join(faults) or 'none'}.", size=8.5)
    page.heading("Files (SHA-256)")
    for entry in document.get("inputs", ()):
        page.text(f"{entry['role']}: {entry['file']}", size=7.5)
        page.text(entry["sha256"], size=7, family="monospace")
    page.text("this diagnosis (checksum of its values)", size=7.5)
    page.text(checksum_of(dict(document)), size=7, family="monospace")
    return page.figure


class _Page:
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


def _day(document: Document, stated: Stated) -> str | None:
    return document.get("date") if stated.day is None else stated.day.isoformat()


def _rows(document: Document) -> str:
    if worth.of_torques(document):
        return f"{document['kept_samples']} filtered samples"
    return f"{document['heldout_rows']} rows"


def _subject(document: Document, stated: Stated) -> list[tuple[str, str]]:
    torques = worth.of_torques(document)
    recording = next((entry["file"] for entry in document.get("inputs", ()) if entry["role"] == "recording"), "")
    source = document.get("torque_source" if torques else "pose_source", "unknown")
    instrument = stated.instrument or document.get("instrument") or _INSTRUMENTS.get(source, "not stated")
    noise = document["noise"]["declared_torque_Nm" if torques else "declared_position_m"]
    if noise is not None:
        shown = torque_statements.by_joint(document, noise) if torques else f"{number(1e3 * noise)} mm per axis"
        instrument += f"; declared noise {shown} (one standard deviation)"
    samples = f"{document['samples']} rows" + ("" if torques else f", {document['model']['motion']}")
    return [
        ("Arm", document["model"]["arm"]),
        ("Recording", f"{recording}, {samples}" if recording else samples),
        ("Date", _day(document, stated) or "not stated"),
        ("Instrument", instrument),
    ]


def _accuracy(document: Document) -> tuple[list[str], list[list[str]]]:
    """The header and the rows of the table of errors before and after."""
    before, after = document["before"], document["after"]
    if worth.of_torques(document):
        rows = [
            _compared(f"{joints} ({unit}), {statistic}", own, left, 1.0)
            for joints, unit, statistic, own, left in torque_statements.errors(document, _STATISTICS)
        ]
    else:
        rows = []
        for what, unit, scale, shown in (("position", "m", 1e3, "mm"), ("orientation", "rad", 180 / np.pi, "deg")):
            for key, name in _STATISTICS:
                at = f"heldout_{what}_{key}_{unit}"
                if at in before and at in after:
                    rows.append(_compared(f"{what} error ({shown}), {name}", before[at], after[at], scale))
    what = "torque error" if worth.of_torques(document) else ""
    return [what, "before", "after", "after / before"], rows


def _compared(name: str, before: float, after: float, scale: float) -> list[str]:
    ratio = f"{100 * after / before:.0f} %" if before else "–"
    return [name, number(scale * before), number(scale * after), ratio]


def _findings(document: Document, findings: Sequence[Mapping[str, Any]], torques: bool) -> list[str]:
    """A line for each finding: rank, name, interval of each number, and what it moves."""
    if not findings:
        return ["None."]
    lines = []
    for rank, finding in enumerate(findings[:_MOST], 1):
        numbers = finding["parameters"] if torques else finding.get("peak_to_peak", finding["parameters"])
        if torques and torque_statements.peak_to_peak(finding):
            numbers = {}
        sizes = [_interval(name, estimate, torques) for name, estimate in numbers.items()]
        moved = worth.moves_size(document, finding)
        moves = [f"moves {moved} RMS"] if moved else []
        lines.append(f"{rank}. {finding['title']}: {'; '.join([*filter(None, sizes), *moves])}")
    if len(findings) > _MOST:
        lines.append(f"and {len(findings) - _MOST} more, which move less; the JSON file has all of them")
    return lines


def _interval(name: str, estimate: Mapping[str, float], torques: bool) -> str:
    """The 95 % interval of a number in the unit in which it is read; one that was chosen has none."""
    named = {"named": OF_TORQUES} if torques else {}
    shown = quantity(name, estimate, **named)
    if not estimate["std"]:
        return f"{shown.name} {shown.value} {shown.unit}".rstrip()
    ends = [
        quantity(
            name, {"value": estimate["value"] + side * _NORMAL_95 * estimate["std"], "std": estimate["std"]}, **named
        )
        for side in (-1, 1)
    ]
    return f"{shown.name} {shown.value} [{ends[0].value}, {ends[1].value}] {shown.unit}".rstrip()
