"""The model of torques in a diagnosis file."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import msgspec
import numpy as np

from lite6jax.array_types import Array
from lite6jax.domains.entries import Document, JointModelEntry, joint_fields, restored_uncertainty, shared_fields
from lite6jax.domains.torque.predict import DiagnosedMotors, pairs
from lite6jax.effects.catalogue import TORQUE_EFFECTS
from lite6jax.effects.effect import Effect
from lite6jax.estimation.terms import Terms, join


class TorqueModelEntry(JointModelEntry, kw_only=True):
    """What predictions of torques need; `drives` has the fields `DRIVE_FIELDS` of an arm."""

    drives: dict[str, list[float]] = msgspec.field(default_factory=dict)


class TorqueDocument(Document[TorqueModelEntry], kw_only=True):
    """What is read of a diagnosis of torques beside its report."""

    catalogue: ClassVar[Mapping[str, type[Effect]]] = TORQUE_EFFECTS

    def restored(self, effects: Sequence[Effect]) -> DiagnosedMotors:
        """The model; `effects` are a user's own."""
        model = self.model
        joints = model.joints
        arm = model.declared_arm(**{name: np.asarray(part, float) for name, part in model.drives.items()})
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
    drives = {field: values.tolist() for field, values in model.arm.drives.items()}
    return {
        **joint_fields(model),
        **({"drives": drives} if drives else {}),
        **shared_fields(model, pairs(model.terms), covariances),
    }
