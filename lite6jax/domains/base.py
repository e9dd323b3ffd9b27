"""What a domain is: one kind of measurements, how its problem is estimated, and how its model is kept and predicts.

The search, the verification and the documents know a domain by these members alone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from lite6jax.array_types import Array
from lite6jax.domains.entries import Document
from lite6jax.domains.uncertainty import Uncertainty
from lite6jax.domains.words import Words
from lite6jax.estimation.problem import Problem
from lite6jax.estimation.terms import Terms
from lite6jax.recordings import Recording, RecordingSettings

DomainName = str
"""Of a domain that is known: "poses", "torques", "tracking"."""


class DomainProblem(Problem, Protocol):
    """The estimation problem of a domain.

    Attributes:
        untestable: effects that the recording cannot show, and why.
    """

    @property
    def untestable(self) -> tuple[Any, ...]: ...

    def errors(self, nuisance: Array, terms: Terms, values: Array) -> tuple[Array, Array]:
        """The errors of a model, by which it is judged on samples that were not fitted.

        A group is what is reported as one error: the position and the orientation of a pose, or one joint.

        Args:
            nuisance: `(number,)`.
            terms: of the model.
            values: `(terms.size,)`.

        Returns:
            `(group, sample)` each: in SI units, and over the noise of each sample.
        """
        ...


class DomainPrediction(Protocol):
    """What the sensors of a diagnosed recording show in a motion."""

    @property
    def shown(self) -> Array:
        """`(sample, …)` in SI units, without standard deviations."""
        ...


@runtime_checkable
class DomainModel(Protocol):
    """An arm with the effects that were found in a recording of one domain: a frozen dataclass, with these members.

    Attributes:
        dof: number of joints.
        sliding: the prismatic joints, counted from 0.
        joint_limits: `(joint, 2)` rad, m of prismatic joints; None where there are none.
        motion: of the recording, "static" or "trajectory".
        reference_temperature: °C.
        uncertainty: from which standard deviations of predictions follow; None where none are known. A field.
    """

    @property
    def dof(self) -> int: ...
    @property
    def sliding(self) -> tuple[int, ...]: ...
    @property
    def joint_limits(self) -> Any: ...
    @property
    def motion(self) -> str: ...
    @property
    def reference_temperature(self) -> float: ...
    @property
    def uncertainty(self) -> Uncertainty | None: ...

    def read_motion(self, path: str | Path) -> Recording:
        """A motion to predict.

        Raises:
            InputError: as `read_recording`, or what the prediction needs is not in the file.
        """
        ...

    def predicted(self, motion: Recording, time_remedy: str = "add time_s") -> DomainPrediction:
        """What the sensors show in a motion.

        Args:
            motion: of as many joints.
            time_remedy: how its times are given, where they are needed and missing.

        Raises:
            InputError: another number of joints, or the motion lacks what an effect needs, by name.
        """
        ...


@dataclass(frozen=True)
class Domain:
    """One kind of measurements.

    Attributes:
        name: by which it is asked for, such as "poses".
        words: what it is called, and what reports say of it.
        source: what the sidecar says from where its numbers are.
        document: what is read of its diagnosis.
        is_recorded: whether a recording holds what is measured.
        gives_way_to: domains beside which it is diagnosed only when it is asked for.
    """

    name: str
    words: Words
    source: Callable[[RecordingSettings], str]
    document: type[Document[Any]]
    is_recorded: Callable[[Recording], bool]
    gives_way_to: frozenset[DomainName] = frozenset()
