"""What is said of torques."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from lite6jax.domains.words import Document, Entry, Measure, SectionWords, effort_units, sliding
from lite6jax.formatting import (
    NAMED_OF_TORQUES,
    capital,
    each_with_unit,
    multiple,
    paragraph,
    significant,
)

TORQUE = Measure("moves_rms_Nm", "heldout_torque_rms_Nm", 1.0, "Nm")
FORCE = Measure("moves_rms_N", "heldout_torque_rms_N", 1.0, "N")
"""Of prismatic joints."""
_BY_JOINT = "heldout_torque_rms_by_joint_Nm"
_STANDS_OUT = 2.0
"""Times the others, at which one joint is named apart."""
_MOVES = (("moves_rms_Nm", "Nm RMS to the torque"), ("moves_rms_N", "N RMS to the force"))


@final
@dataclass(frozen=True, kw_only=True)
class TorqueWords(SectionWords):
    """The words of torques, Nm, and of forces of prismatic joints, N."""

    def error_ratios(self, document: Document) -> str:
        correlated = ""
        if not document["left"]["white"]:
            correlated = "Neighbouring samples of what is left are correlated."
        return paragraph(_ratios(document), correlated)

    def errors_of_unnamed(self, document: Document) -> str:
        return self.error_ratios(document)

    def record_more(self, document: Document) -> str:
        return "Record a longer one."

    def withdrawn(self, titles: Sequence[str], withdrawn: Entry) -> str:
        return f"Significant, but not kept, because the held-out errors are larger with them: {', '.join(titles)}."

    def recorded(self, document: Document) -> str:
        return " of torques."

    def noise(self, document: Document) -> str:
        units = effort_units(document)
        declared = document["noise"]["declared"]["torque_Nm"]
        comparison = "none is declared."
        if declared is not None:
            comparison = f"{each_with_unit(declared, units)} are declared."
        return (
            "Noise of the torques, one sigma of each joint in turn: the residuals have "
            f"{each_with_unit(document['noise']['estimated']['torque_Nm'], units)}; {comparison}"
        )

    def declared_noise(self, document: Document, noise: Any) -> str:
        return each_with_unit(noise, effort_units(document))

    def assumptions(self, document: Document) -> list[str]:
        return [_filtering(document), _inertial_numbers(document)]

    def error_kinds(self, document: Document) -> list[tuple[str, str, str]]:
        units = dict.fromkeys(effort_units(document))
        names = {"Nm": "revolute", "N": "prismatic"}
        if len(units) == 1:
            names = dict.fromkeys(units, "all")
        return [(f"{names[unit]} joints", "torque", unit) for unit in units]

    def error_rows_by_joint(self, document: Document) -> list[tuple[str, float, float]]:
        by_joint = (document[stage][_BY_JOINT] for stage in ("before", "after"))
        numbered = enumerate(zip(effort_units(document), *by_joint, strict=True), 1)
        return [(f"joint {joint} ({unit}), RMS", before, after) for joint, (unit, before, after) in numbered]

    def shown(self, size: float) -> str:
        return significant(size)

    def overall_error(self, document: Document) -> tuple[str, str, str]:
        before, after = (
            each_with_unit(document[stage][_BY_JOINT], effort_units(document)) for stage in ("before", "after")
        )
        return "torque errors of the joints are", before, after

    def measures(self, document: Document) -> tuple[Measure, ...]:
        """Newton metres; of an arm that has prismatic joints also newtons, or these alone."""
        return tuple(measure for measure in (TORQUE, FORCE) if measure.error in document["before"]) or (TORQUE,)

    def error_at(self, document: Document, stage: str, measure: Measure, finding: Entry) -> float:
        slides = measure is FORCE
        joints = [joint for joint in finding.get("joints", ()) if (joint - 1 in sliding(document)) == slides]
        if not joints:
            return super().error_at(document, stage, measure, finding)
        by_joint = np.array(document[stage][_BY_JOINT])[np.array(joints) - 1]
        return float(np.sqrt(np.mean(by_joint**2)))

    def _contributes(self, finding: Entry) -> str:
        moves = " and ".join(f"{significant(finding[key])} {words}" for key, words in _MOVES if key in finding)
        return f"it contributes {moves}."

    def named(self, finding: Entry, title: str, drivers: str, numbers: str) -> str:
        return f"{capital(title)} is significant: {numbers}; {self._contributes(finding)}"

    def unnamed(self, finding: Entry, drivers: str, numbers: str, component: str, shape: str, nearest: str) -> str:
        exerted = "torque"
        if finding["where"].get("of_slide"):
            exerted = "force"
        sentence = (
            f"No effect of the catalogue explains a {exerted} at {finding['site']} that is a function of the "
            f"{drivers}: {self._contributes(finding)}"
        )
        if not nearest:
            return sentence
        share = 100 * finding["nearest"]["share"]
        return f"{sentence} The nearest named effect, {nearest}, explains {share:.0f} % of it."

    def rivals(self, entries: Sequence[tuple[str, Entry]]) -> list[str]:
        return [title for title, entry in entries if entry["status"] != "found"]

    def places(self, site: str, near: Sequence[str]) -> list[str]:
        """Torques are measured joint by joint: each is where it acts."""
        return [site]

    def caption(self, finding: Entry, over: str, title: str) -> str:
        return f"The torque of this finding{over or f' over {title}'},"

    def confounded(self, document: Document) -> str:
        if document["nuisance"]["numbers"]:
            return (
                "They are confounded with the inertial numbers that are fitted, or what they depend on does not vary."
            )
        return "What they depend on does not vary in this recording."

    def remedy_of_confounded(self, document: Document) -> str:
        if not document["nuisance"]["numbers"]:
            return ""
        return (
            "To test for effects that are confounded with the inertial numbers, declare these numbers (`inertial` in "
            "the sidecar)."
        )


def _ratios(document: Document) -> str:
    """Says how many times the noise the errors are, and of which joint they are largest."""
    sizes = [ratio for ratio in document["left"]["over_noise"].values() if ratio is not None]
    if not sizes:
        return ""
    joint, largest = max(enumerate(sizes, 1), key=lambda pair: pair[1])
    remaining = sizes[: joint - 1] + sizes[joint:]
    if remaining and largest > _STANDS_OUT * max(remaining):
        sentence = (
            f"The held-out errors of joint {joint} are {multiple(largest)} times the declared noise, those of the "
            f"others {_range(remaining)} times."
        )
    else:
        sentence = f"The held-out errors are {_range(sizes)} times the declared noise, and largest of joint {joint}."
    between = (document["left"].get("between_reversals") or {}).get(f"joint{joint}", largest)
    if between >= 0.5 * (1 + largest):  # most of the excess over noise
        return sentence
    return (
        f"{sentence} They are larger where joint {joint} reverses: within a sample it is not known when its friction "
        f"turns. Elsewhere they are {multiple(between)} times."
    )


def _range(ratios: Sequence[float]) -> str:
    return " to ".join(dict.fromkeys(map(multiple, (min(ratios), max(ratios)))))


def _filtering(document: Document) -> str:
    """Says through which filters torques and motion pass."""
    low_pass = document["filter"]
    if low_pass is None:
        return (
            "Each row is a posture at rest, in which gravity alone is compared: friction, rotors and delays, which "
            "show in a motion, were not tested."
        )
    kept_samples = f"one sample in {low_pass['every']}"
    if low_pass["every"] == 1:
        kept_samples = "every sample"
    return (
        "Measured and modelled torques pass the same zero-phase low-pass filter of "
        f"{significant(low_pass['cutoff_Hz'])} Hz (of {significant(low_pass['rate_Hz'], 4)} samples a second), and "
        f"{kept_samples} is kept; the motion passes one of {significant(low_pass['motion_cutoff_Hz'])} Hz before it is "
        "differentiated."
    )


def _inertial_numbers(document: Document) -> str:
    """Says whether the inertial numbers of the links are fitted."""
    nuisance = document["nuisance"]
    if not nuisance["numbers"]:
        return "The inertial numbers of the links are taken as declared."
    return (
        "The inertial numbers of the links are fitted, with a prior standard deviation of "
        f"{significant(100 * nuisance['relative_std'], 2)} % about the declared ones."
    )


TORQUE_WORDS = TorqueWords(
    measured="torques",
    singular="torque",
    special_units=NAMED_OF_TORQUES,
    verdict_column="torque_verdict",
    error_column="torque_rms_Nm",
    subject="the torques of ",
    noise_of="sensors'",
    noise_key="torque_noise_Nm",
    consistent="Consistent: the inverse dynamics of the declared arm and the sensors' noise explain the torques.",
    more_than_noise=", and more than noise is left",
    too_short="the recording is too short to tell whether something is missing.",
    held_out_rows="filtered samples",
    separating="another motion",
    predicted="torques of this motion, for a feed-forward; give a motion of your own in its place",
    simulated="the arm with what was found, for a simulator",
)
