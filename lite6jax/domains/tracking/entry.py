"""The model of servos in a diagnosis file."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
from msgspec import Meta

from lite6jax.array_types import Array
from lite6jax.domains.entries import Document, JointModelEntry, Mass, Ranges, joint_fields, shared_fields
from lite6jax.domains.tracking.predict import DiagnosedServos
from lite6jax.domains.tracking.ranges import FittedRange
from lite6jax.effects.catalogue import TRACKING_EFFECTS
from lite6jax.effects.effect import Effect
from lite6jax.effects.servo import Servo
from lite6jax.estimation.terms import Terms, join
from lite6jax.storage import NonNegative


class TrackingModelEntry(JointModelEntry, kw_only=True):
    """What predictions of joints from commands need; `servo` has the numbers of each joint, without the effects."""

    payload_kg: Mass
    compensated: bool
    servo: dict[str, list[float]]
    step_s: Annotated[float, Meta(gt=0.0, le=1.0)]
    interpolated: bool
    velocity_range_rad_per_s: Ranges
    weight_range_Nm: Ranges  # noqa: N815 (the key)
    shortest_reversal_s: list[NonNegative | None] = msgspec.field(default_factory=list)
    """The shortest time between two reversals of each joint, None of one that reverses less than twice."""
    friction_share: list[Annotated[float, Meta(ge=-1.0, le=1.0)]] = msgspec.field(default_factory=list)
    """Where friction held each joint as runs began, s of `resting_positions`."""

    def __post_init__(self) -> None:
        """Checks that every servo has all numbers of each joint."""
        joints = self.joints
        if set(self.servo) != set(Servo._fields) or any(len(numbers) != joints for numbers in self.servo.values()):
            raise ValueError("servo does not have a number of each kind for each joint")
        lists: tuple[Sequence[Any], ...] = (self.links, self.velocity_range_rad_per_s, self.weight_range_Nm)
        lists += tuple(part for part in (self.shortest_reversal_s, self.friction_share) if part)
        if any(len(part) != joints for part in lists):
            raise ValueError(f"it has {joints} joints, but other numbers of links or ranges")


class TrackingDocument(Document[TrackingModelEntry], kw_only=True):
    """What is read of a diagnosis of commands and joints beside its report."""

    catalogue: ClassVar[Mapping[str, type[Effect]]] = TRACKING_EFFECTS

    def restored(self, effects: Sequence[Effect]) -> DiagnosedServos:
        """The model; `effects` are a user's own."""
        model = self.model
        model_effects, numbers = self.restored_effects(effects)
        velocity = np.asarray(model.velocity_range_rad_per_s, float)
        weight = np.asarray(model.weight_range_Nm, float)
        reversal = None
        if model.shortest_reversal_s:
            reversal = np.array([np.inf if time is None else time for time in model.shortest_reversal_s])
        return DiagnosedServos(
            arm=model.declared_arm(),
            servo=Servo(**{name: np.asarray(by_joint, float) for name, by_joint in model.servo.items()}),
            links=np.asarray(model.links, float),
            payload_center=np.asarray(model.payload_center, float),
            payload=model.payload_kg,
            gravity=np.asarray(model.gravity, float),
            compensated=model.compensated,
            terms=Terms(model_effects),
            values=join(numbers),
            step=model.step_s,
            interpolated=model.interpolated,
            ranges=FittedRange(velocity, weight, reversal),
            friction_share=np.asarray(model.friction_share, float) if model.friction_share else None,
            reference_temperature=model.reference_temperature_degC,
        )


def model_entry(model: DiagnosedServos, covariances: Sequence[Array]) -> dict[str, Any]:
    """A model as values that JSON can hold, with covariances of the numbers of each effect."""
    parts: list[tuple[Any, slice]] = [*model.terms.pairs]
    reversal = [] if model.ranges.reversal is None else model.ranges.reversal.tolist()
    return {
        **joint_fields(model),
        "payload_kg": model.payload,
        "compensated": model.compensated,
        "servo": {name: np.asarray(by_joint).tolist() for name, by_joint in model.servo._asdict().items()},
        "step_s": model.step,
        "interpolated": model.interpolated,
        "velocity_range_rad_per_s": model.ranges.velocity.tolist(),
        "weight_range_Nm": model.ranges.weight.tolist(),
        "shortest_reversal_s": [time if np.isfinite(time) else None for time in reversal],
        "friction_share": [] if model.friction_share is None else model.friction_share.tolist(),
        **shared_fields(model, parts, covariances),
    }
