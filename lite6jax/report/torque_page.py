"""A diagnosis of torques as one self-contained HTML page: cause, errors, data faults, findings, friction."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from lite6jax.diagnosis.torque_result import TorqueDiagnosis
from lite6jax.report import statements, torque_statements, worth
from lite6jax.report.finding_figures import torque_finding_figure
from lite6jax.report.next_steps import Files
from lite6jax.report.rendering import finding_row, picture, shared_values, whole_page

Document = Mapping[str, Any]

_CAPTIONS = {
    "error_by_joint": "Held-out torque error of each joint, by the arm's model alone and with the findings. "
    "Dashed lines are the standard deviations of the measured torques themselves.",
    "over_time": "Torques of each joint as measured, of the rigid-body model, and modelled with the findings, in a "
    "part of the recording; all have passed the same low-pass filter.",
    "friction": "What the model without friction leaves of each joint's torque over the velocity of the joint, and the "
    "friction that was found, at the median load and temperature with the other joints at rest.",
    "spectra": "Power spectral densities of velocities and torques as recorded. A low pass removes what is right of a "
    "dashed line: the velocity is noise there, and differentiating would enlarge it.",
}
_STATISTICS = (("rms", "RMS"), ("p95", "95th percentile"), ("max", "maximum"))


def torque_page(
    found: TorqueDiagnosis, document: Document, source: str, figures: Mapping[str, Figure], files: Files | None = None
) -> str:
    """The page, HTML; the same diagnosis gives the same bytes.

    Args:
        found: the diagnosis, of which the figures of single findings are drawn.
        document: as in its JSON file, with statements; all text is made from it.
        source: the recording's name, of any characters.
        figures: those of `torque_figures.drawings`.
        files: for commands to copy; without them there are none.
    """
    return whole_page("torque_diagnosis_content.html", page_values(found, document, source, figures, files))


def page_values(
    found: TorqueDiagnosis, document: Document, source: str, figures: Mapping[str, Figure], files: Files | None = None
) -> dict[str, Any]:
    """What the templates of the page are filled with; arguments as of `torque_page`."""
    order, unit = worth.order(document), torque_statements.common_unit(document)
    findings = [_finding(found, entry, order) for entry in torque_statements.findings_of(document)]
    captions = {name: caption for name, caption in _CAPTIONS.items() if name in figures}
    return {
        **shared_values(document, torque_statements, source, findings, figures, captions, files),
        "against": torque_statements.compared(document),
        "setting": torque_statements.setting_statement(document),
        "errors": _errors(document),
        "columns": [
            "held-out torque error",
            *(f"{stage} ({unit})" if unit else stage for stage in ("before", "after")),
        ],
        "held": statements.held_out_statement(document, f"{document['kept_samples']} filtered samples"),
        "noise": torque_statements.noise_statement(document),
        "notes": [torque_statements.filter_statement(document), torque_statements.inertial_statement(document)],
    }


def _errors(document: Document) -> list[dict[str, Any]]:
    common = torque_statements.common_unit(document)
    return [
        {
            "name": f"{joints}, {statistic}{'' if common else f' ({unit})'}",
            "numbers": [f"{value:.3g}" for value in pair],
        }
        for joints, unit, statistic, *pair in torque_statements.errors(document, _STATISTICS)
    ]


def _finding(found: TorqueDiagnosis, entry: Mapping[str, Any], order: Sequence[int]) -> dict[str, Any]:
    driver = statements.effect_title(entry) if entry["driver"] == "none" else f"the {entry['driver']}"
    caption = (
        f"The torque of this finding over {driver}, beside the partial residuals: those of the whole model without it."
    )
    shown = picture(torque_finding_figure(found, "", [entry["place"]], order), caption)
    rivals, rejected = torque_statements.undistinguished(entry), torque_statements.rejected(entry)
    return finding_row(entry, torque_statements.sizes(entry), rivals, rejected, shown, torques=True)
