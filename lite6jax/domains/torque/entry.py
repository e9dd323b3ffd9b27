"""The model of torques in a diagnosis file."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.domains.entries import (
    Document,
    Gravity,
    Link,
    ModelEntry,
    Point,
    Transform,
    restored_uncertainty,
    shared_fields,
)
from lite6jax.domains.torque.predict import DiagnosedMotors, pairs
from lite6jax.effects.catalogue import TORQUE_EFFECTS
from lite6jax.effects.effect import Effect
from lite6jax.estimation.terms import Terms, join

Array = NDArray[np.floating]


class TorqueModelEntry(ModelEntry, kw_only=True):
    """What predictions of torques need; `drives` has the fields `DRIVE_FIELDS` of an arm."""

    T_joint_flange: Transform
    links: list[Link]
    payload_center: Point
    gravity: Gravity
    drives: dict[str, list[float]] = msgspec.field(default_factory=dict)


class TorqueDocument(Document[TorqueModelEntry], kw_only=True):
    """What is read of a diagnosis of torques beside its report."""

    catalogue: ClassVar[Mapping[str, type[Effect]]] = TORQUE_EFFECTS

    def restored(self, effects: Sequence[Effect]) -> DiagnosedMotors:
        """The model; `effects` are a user's own."""
        model = self.model
        joints = model.joints
        fields = {"T_joint_flange": model.T_joint_flange, "joint_limits": model.joint_limits, **model.drives}
        arrays: dict[str, Any] = {name: np.asarray(part, float) for name, part in fields.items()}
        arm = Arm(model.arm, np.asarray(model.kinematics, float), sliding=model.sliding, **arrays)
        if len(model.links) != joints:
            raise ValueError(f"it has {joints} joints, but links of the shape {np.shape(model.links)}")
        model_effects, numbers = self.restored_effects(effects)
        return DiagnosedMotors(
            arm=arm,
            links=np.asarray(model.links, float),
            payload_center=np.asarray(model.payload_center, float),
            gravity=np.asarray(model.gravity, float),
            terms=Terms(model_effects),
            values=join(numbers),
            reference_temperature=model.reference_temperature_degC,
            uncertainty=restored_uncertainty(model, model_effects, {"inertia": (joints, 10)}, joints),
            reference=self.origin,
        )


def model_entry(model: DiagnosedMotors, covariances: Sequence[Array]) -> dict[str, Any]:
    """A model as values that JSON can hold, with covariances of the numbers of each effect."""
    arm = model.arm
    drives = {field: values.tolist() for field, values in arm.drives.items()}
    return {
        "arm": arm.name,
        "kinematics": arm.kinematics.tolist(),
        "T_joint_flange": arm.T_joint_flange.tolist(),
        "links": model.links.tolist(),
        **({"drives": drives} if drives else {}),
        "payload_center": model.payload_center.tolist(),
        "gravity": model.gravity.tolist(),
        "joint_limits": arm.joint_limits.tolist(),
        **shared_fields(model, pairs(model.terms), covariances),
    }
