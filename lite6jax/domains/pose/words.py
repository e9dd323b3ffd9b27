"""What is said of poses."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from lite6jax.calibration.quality import NOISES
from lite6jax.domains.words import Document, Entry, Measure, SectionWords, undeclared_noise
from lite6jax.effects.drivers import driver_of
from lite6jax.formatting import (
    capital,
    counted,
    fixed,
    joined,
    multiple,
    number,
    plural,
    plus_minus,
    rows_named,
    significant,
)

POSITION = Measure("moves_rms_m", "heldout_position_rms_m", 1e3, "mm")
ORIENTATION = Measure("moves_rms_rad", "heldout_orientation_rms_rad", 180 / np.pi, "deg")
_SHARE = 0.1
"""Share of the error of positions, or orientations, from which a finding matters there."""
_PARTS = {"base": "the sensor's frame", "link": "the arm's own calibration", "tool": "the tool"}


@final
@dataclass(frozen=True, kw_only=True)
class PoseWords(SectionWords):
    """The words of poses; errors are in mm and deg."""

    def error_ratios(self, document: Document) -> str:
        parts = []
        wandering = ""
        if any(fault["fault"] == "wandering_readout" for fault in document["data_faults"]):
            wandering = " beside read-outs that wander"
        for what, ratio in document["left"]["over_noise"].items():
            if ratio is None:
                continue
            errors = f"{what} errors"
            if what == "position" and not wandering:
                errors = f"held-out {errors}"
            parts.append(f"{errors}{wandering} are {multiple(ratio)} times the declared noise")
        if not document["left"]["white"]:
            parts.append("neighbouring rows are correlated")
        return f"{capital(joined(parts))}."

    def gross_error(self, document: Document) -> str:
        if document["quality"]["verdict"] == "bad":
            return "Unexplained: the model of the arm does not describe the poses, and no effect explains why."
        times = max(ratio or 0.0 for ratio in document["left"]["over_noise"].values())
        if times <= NOISES:
            return ""
        return (
            f"Unexplained: no effect that was tested explains the residuals, which are {multiple(times)} times the "
            "declared noise: check the arm, the frame, the tool and the columns that the sidecar declares."
        )

    def record_more(self, document: Document) -> str:
        return f"Record about {counted(document['rows_needed'] - document['samples'], 'more pose')}."

    def withdrawn(self, titles: Sequence[str], withdrawn: Entry) -> str:
        count = len(titles)
        before = 1e3 * withdrawn["before"]["heldout_position_rms_m"]
        after = 1e3 * withdrawn["after"]["heldout_position_rms_m"]
        start = (
            f"{capital(joined(titles))} {plural(count, 'was', 'were')} significant, but "
            f"{plural(count, 'it is', 'they are')} not kept:"
        )
        if after > before:
            return (
                f"{start} the errors on held-out rows are larger ({number(after, 3)} mm RMS of position) than without "
                f"({number(before, 3)} mm)."
            )
        return (
            f"{start} what is left on held-out rows is several times what is left of the fitted ones "
            f"({number(after, 3)} mm RMS of position; {number(before, 3)} mm without)."
        )

    def recorded(self, document: Document) -> str:
        return f" ({document['model']['motion']})."

    def noise(self, document: Document) -> str:
        declared = document["noise"]["declared"]["position_m"]
        comparison = "none is declared."
        if declared is not None:
            comparison = f"{number(1e3 * declared)} mm is declared."
        size = number(1e3 * document["noise"]["estimated"]["position_m"])
        return f"Noise per axis of position: the residuals have {size} mm, {comparison}"

    def declared_noise(self, document: Document, noise: Any) -> str:
        return f"{number(1e3 * noise)} mm per axis"

    def assumptions(self, document: Document) -> list[str]:
        lines = []
        phrases = [finding["driver"] for finding in document["findings"] if finding["driver"] != "none"]
        drivers = [driver_of(driver) for phrase in phrases for driver in phrase.split(" and ")]
        if document["model"]["accelerated"] and any(driver.loaded for driver in drivers):
            lines.append("The loads include the inertial forces of the moving arm, which the recording supports.")
        undeclared = undeclared_noise(document)
        if undeclared:
            lines.append(f"The sidecar declares {undeclared}: tests use the noise estimated from the residuals.")
        if document["left_out"]:
            lines.append(
                f"A gear may be between its flanks in {rows_named(document['left_out'])}: estimates do without, and "
                "the held-out errors include them."
            )
        return lines

    def error_kinds(self, document: Document) -> list[tuple[str, str, str]]:
        return [("position error", "position", "m"), ("orientation error", "orientation", "rad")]

    def shown(self, size: float) -> str:
        return number(size)

    def overall_error(self, document: Document) -> tuple[str, str, str]:
        before, after = (
            f"{number(1e3 * document[stage]['heldout_position_rms_m'])} mm" for stage in ("before", "after")
        )
        return "position error is", before, after

    def measures(self, document: Document) -> tuple[Measure, ...]:
        """Millimetres; degrees where no finding moves the measured point, but one turns it."""
        moved, turned = (
            max((measure.share_of(document, finding) for finding in document["findings"]), default=0.0)
            for measure in (POSITION, ORIENTATION)
        )
        return (ORIENTATION,) if moved < _SHARE < turned else (POSITION,)

    def _moves(self, finding: Entry) -> str:
        turned = finding.get("moves_rms_rad")
        turns = ""
        if turned:
            turns = f" and turns it by {plus_minus(float(np.rad2deg(turned)))} deg"
        return f"it moves the measured point by {plus_minus(1e3 * finding['moves_rms_m'])} mm RMS{turns}"

    def named(self, finding: Entry, title: str, drivers: str, numbers: str) -> str:
        driven = ""
        if finding["driver"] != "none":
            driven = f", a function of the {drivers},"
        return f"{capital(title)}{driven} is significant: {numbers}; {self._moves(finding)}."

    def unnamed(self, finding: Entry, drivers: str, numbers: str, component: str, shape: str, nearest: str) -> str:
        if "wanders" in finding:
            return f"{self._wandering(finding, numbers, component)}; {self._moves(finding)}."
        return (
            f"No effect of the catalogue explains an effect at {finding['site']}{component} as a function of the "
            f"{drivers}: {shape} ({finding['effective_parameters']:.0f} effective parameters), {numbers}; "
            f"{self._moves(finding)}."
        )

    def _wandering(self, finding: Entry, numbers: str, component: str) -> str:
        wanders = finding["wanders"]
        memory = f"{significant(wanders['memory_samples'], 2)} rows"
        if wanders["memory_s"] is not None:
            memory = f"{significant(wanders['memory_s'], 2)} s"
        return (
            f"An effect at {finding['site']}{component} wanders by itself, with a memory of about {memory}. Nothing "
            f"that was recorded drives it, and another recording has another one: {numbers}"
        )

    def rivals(self, entries: Sequence[tuple[str, Entry]]) -> list[str]:
        """With their log evidence over that of the finding."""
        return [f"{title} (log evidence {fixed(-entry['log_likelihood_gap'], 1, '+')})" for title, entry in entries]

    def places(self, site: str, near: Sequence[str]) -> list[str]:
        return [site, *near]

    def caption(self, finding: Entry, over: str, title: str) -> str:
        name = "effect"
        if finding["effect"] != "unnamed":
            name = finding["effect"].replace("_", " ")
        return f"The fitted {name} at {finding['site']}{over} with its 95 % band,"

    def confounded(self, document: Document) -> str:
        if document["nuisance"]["numbers"]:
            return "They are confounded with the fitted frames and geometry, or the sensor does not observe them."
        return "The sensor does not observe them in these poses."

    def remedy_of_confounded(self, document: Document) -> str:
        steps = []
        parts = [words for part, words in _PARTS.items() if part in document["nuisance"]["parts"]]
        if parts:
            steps.append(f"declare {joined(parts)}")
        if not document["model"]["orientation"]:
            steps.append("measure orientations too")
        if not steps:
            return ""
        return f"To test for effects that are confounded or not observed, {joined(steps)}."


POSE_WORDS = PoseWords(
    measured="poses",
    singular="pose",
    error_column="position_rms_m",
    noise_of="sensor's",
    noise_key="position_noise_m",
    consistent="Consistent{corrected}: the model of the arm{wandering} and the sensor's noise explain the recording.",
    consistent_beside_reference="Consistent: beyond the differences above, the two recordings differ by noise.",
    too_short="there are too few rows to tell whether something is missing.",
    separating="more poses",
    accuracy=(
        "Errors are distances between what the model predicts and what was measured. They resemble the pose accuracy "
        "of ISO 9283, which is defined for attained and commanded poses of its own test cycle."
    ),
    compensable=True,
)
