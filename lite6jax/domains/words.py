"""Words that differ between domains: what each is called, and its phrases in the sections that poses and torques share.

Documents are those of a diagnosis file, of JSON; entries are their findings. A domain's words stand in its folder.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, final

from lite6jax.formatting import NAMED, plus_minus, torque_units

Document = Mapping[str, Any]
Entry = Mapping[str, Any]


@final
@dataclass(frozen=True)
class Measure:
    """In what findings are ranked: the keys of what one moves and of the RMS error, and how sizes are shown.

    `scale` leads from SI units to `unit`.
    """

    moves: str
    error: str
    scale: float
    unit: str

    def size_of(self, value: float) -> str:
        """A value in SI units as it is shown, in two digits."""
        return f"{plus_minus(self.scale * value)} {self.unit}"

    def share_of(self, document: Document, finding: Entry) -> float:
        """What a finding moves, over the error before; over the unit where there was no error."""
        return (finding.get(self.moves) or 0.0) / (document["before"].get(self.error) or 1.0)


@dataclass(frozen=True)
class Words:
    """What a domain is called.

    Attributes:
        measured: what is measured, in a word for messages.
        singular: the same of one.
        absent: of a recording that is to be diagnosed by it and lacks it, with the remedy; empty where its reading
            says so.
        verdict_column: of a table of recordings, in which the verdict is.
        error_column: the same of the RMS of held-out errors; empty where the table has none.
        special_units: factor and unit of numbers of effects, by names that do not say alone how they are read.
    """

    measured: str
    singular: str
    special_units: Mapping[str, tuple[float, str]] = field(default_factory=lambda: NAMED)
    absent: str = ""
    verdict_column: str = "verdict"
    error_column: str = ""


@dataclass(frozen=True, kw_only=True)
class SectionWords(Words, ABC):
    """What the sections that poses and torques share say of one of them.

    Attributes:
        subject: what of an arm is diagnosed, before its name; empty of the arm itself.
        noise_of: with whose noise errors are compared, in the genitive, such as "sensors'".
        noise_key: of the sidecar, which declares that noise.
        consistent: nothing was found; with `{corrected}`, the faults of the data, and of poses `{wandering}`, read-outs
            that wander.
        consistent_beside_reference: the same beside the differences from a reference; empty where that says no more.
        more_than_noise: what follows where effects were found and more is left.
        too_short: a recording that does not tell whether something is missing.
        held_out_rows: noun of the held-out samples, such as "poses".
        separating: what to record so that confounded effects become identifiable.
        accuracy: the sentence of a certificate that says what its errors are.
        predicted: the purpose of predicting the motion that was recorded; empty where it has none.
        simulated: the purpose of the arm as found in another form; empty where it has none.
        compensable: whether other joint positions, or another geometry, make up for findings.
    """

    subject: str = ""
    noise_of: str
    noise_key: str
    consistent: str
    consistent_beside_reference: str = ""
    more_than_noise: str = ""
    too_short: str
    held_out_rows: str = "rows"
    separating: str
    accuracy: str = ""
    predicted: str = ""
    simulated: str = ""
    compensable: bool = False

    # -------------------------------------------------------------- the verdict

    @abstractmethod
    def error_ratios(self, document: Document) -> str:
        """Says how many times the noise the errors are, and whether they are correlated."""

    def errors_of_unnamed(self, document: Document) -> str:
        """The same where the largest effect has no name; empty where nothing is said of it."""
        return ""

    def gross_error(self, document: Document) -> str:
        """Says that errors are far beyond what effects could be; empty where they are not."""
        return ""

    @abstractmethod
    def record_more(self, document: Document) -> str:
        """Says how much more to record, so that what is nearly significant is decided."""

    @abstractmethod
    def withdrawn(self, titles: Sequence[str], withdrawn: Entry) -> str:
        """Says which significant effects were not kept, and why."""

    # -------------------------------------------------------------- the recording and its errors

    @abstractmethod
    def recorded(self, document: Document) -> str:
        """What follows the arm and the number of samples."""

    @abstractmethod
    def noise(self, document: Document) -> str:
        """Says the noise that the residuals have, beside the declared one."""

    @abstractmethod
    def declared_noise(self, document: Document, noise: Any) -> str:
        """The declared noise with its unit."""

    @abstractmethod
    def assumptions(self, document: Document) -> list[str]:
        """Says on what the tests rest beyond the recording."""

    @abstractmethod
    def error_kinds(self, document: Document) -> list[tuple[str, str, str]]:
        """What is called an error, the part of its key in the document, and its SI unit, of each kind."""

    def error_rows_by_joint(self, document: Document) -> list[tuple[str, float, float]]:
        """A name with its unit, and the RMS before and after, of each joint that has an error of its own."""
        return []

    @abstractmethod
    def shown(self, size: float) -> str:
        """An error in digits."""

    @abstractmethod
    def overall_error(self, document: Document) -> tuple[str, str, str]:
        """What is held out, with its verb, and its RMS before and after with units."""

    # -------------------------------------------------------------- findings

    @abstractmethod
    def measures(self, document: Document) -> tuple[Measure, ...]:
        """In what the findings are ranked."""

    def error_at(self, document: Document, stage: str, measure: Measure, finding: Entry) -> float:
        """The RMS of held-out errors, before or after, in the unit shown; where a finding acts, if these are known."""
        return measure.scale * document[stage][measure.error]

    @abstractmethod
    def named(self, finding: Entry, title: str, drivers: str, numbers: str) -> str:
        """Says that an effect of the catalogue is significant, with its numbers and what it moves."""

    @abstractmethod
    def unnamed(self, finding: Entry, drivers: str, numbers: str, component: str, shape: str, nearest: str) -> str:
        """Says that something acts which the catalogue does not have.

        Args:
            finding: with `where`, the fields of its effect.
            drivers: on which it depends, with articles.
            numbers: of it.
            component: along or about which axis it acts; empty at a joint.
            shape: what its function looks like.
            nearest: the title of the nearest named effect; empty where there is none.
        """

    @abstractmethod
    def rivals(self, entries: Sequence[tuple[str, Entry]]) -> list[str]:
        """The titles of effects beside a finding, of pairs of title and entry."""

    @abstractmethod
    def places(self, site: str, near: Sequence[str]) -> list[str]:
        """The sites at which a finding may act, of its own and of those where it is nearly as likely."""

    @abstractmethod
    def caption(self, finding: Entry, over: str, title: str) -> str:
        """Begins the caption of its figure; `over` says over what it is drawn, if that is not itself."""

    # -------------------------------------------------------------- what was not tested

    @abstractmethod
    def confounded(self, document: Document) -> str:
        """Says why the confounded effects were not tested."""

    @abstractmethod
    def remedy_of_confounded(self, document: Document) -> str:
        """Says what to declare or to measure so that they are tested; empty where nothing helps."""


def sliding(document: Document) -> tuple[int, ...]:
    """The prismatic joints of the diagnosed arm, counted from 0."""
    return tuple(joint - 1 for joint in document["model"].get("prismatic_joints", ()))


def effort_units(document: Document) -> tuple[str, ...]:
    """Units of what the motor of each joint exerts: Nm, or N of a prismatic one."""
    return torque_units(sliding(document), len(document["model"]["kinematics"]))


def undeclared_noise(document: Document) -> str:
    """Names the noises that the sidecar does not declare: no position_noise_m and no orientation_noise_rad."""
    declared = document["noise"]["declared"]
    return " and ".join(f"no {name.replace('_', '_noise_')}" for name, size in declared.items() if size is None)
