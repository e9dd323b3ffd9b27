"""The model of poses in a diagnosis file."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

import msgspec
import numpy as np
from msgspec.structs import asdict

from lite6jax.arms import frames
from lite6jax.array_types import Array
from lite6jax.domains.entries import (
    Angle,
    Document,
    Gravity,
    Mass,
    ModelEntry,
    Point,
    Transform,
    restored_uncertainty,
    shared_fields,
)
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.effects.catalogue import POSE_EFFECTS
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.statics import inertia_of
from lite6jax.estimation.terms import join
from lite6jax.model import ArmModel
from lite6jax.storage import NonNegative, Strict


class InertiaEntry(Strict):
    """Masses and their centres as estimated, with the payload's centre and gravity."""

    mass: list[Mass]
    center_of_mass: list[Point]
    payload_center: Point
    gravity: Gravity


class PoseModelEntry(ModelEntry, kw_only=True):
    """What predictions of poses need."""

    T_sensor_base: Transform
    T_flange_tool: Transform
    orientation: bool
    inertia: InertiaEntry | None
    motion: Literal["static", "trajectory"]
    accelerated: bool = False
    joint_zero_rad: list[Angle] | None = None

    def __post_init__(self) -> None:
        """Checks what one number alone does not show; of torques an `Arm` does that."""
        joints = self.joints
        prismatic = self.prismatic_joints
        limits = self.joint_limits
        if prismatic != tuple(sorted(set(prismatic))) or any(joint > joints for joint in prismatic):
            raise ValueError("prismatic_joints are not joints of its chain in order")
        if limits is not None and not (len(limits) == joints and all(lower < upper for lower, upper in limits)):
            raise ValueError("joint_limits are not the lower and the upper one of each joint")
        if self.joint_zero_rad is not None and len(self.joint_zero_rad) != joints:
            raise ValueError("joint_zero_rad is not a number of each joint")
        for name, rows in (("T_sensor_base", self.T_sensor_base), ("T_flange_tool", self.T_flange_tool)):
            T = np.array(rows, float)
            if not (frames.is_rotation(T[:3, :3]) and np.allclose(T[3], [0.0, 0.0, 0.0, 1.0], rtol=0, atol=1e-12)):
                raise ValueError(f"{name} is no rigid transform")
        # the last mass contains by how much the payload is lighter than declared
        masses = [] if self.inertia is None else self.inertia.mass
        uncertainty = self.uncertainty
        lighter = uncertainty is not None and any(site[0] == "payload" for site in uncertainty.sites)
        for i, mass in enumerate(masses[:-1] if lighter else masses):
            if mass < 0:
                raise ValueError(f"inertia.mass[{i}] is {mass:.6g}, which is negative")


class PoseDocument(Document[PoseModelEntry], kw_only=True):
    """What is read of a diagnosis of poses beside its report."""

    catalogue: ClassVar[Mapping[str, type[Effect]]] = POSE_EFFECTS

    before: dict[str, NonNegative] = msgspec.field(default_factory=dict)
    after: dict[str, NonNegative] = msgspec.field(default_factory=dict)

    def restored(self, effects: Sequence[Effect]) -> DiagnosedArm:
        """The model; `effects` are a user's own."""
        model = self.model
        joints = model.joints
        model_effects, numbers = self.restored_effects(effects)
        before = self.before.get("heldout_position_rms_m")
        after = self.after.get("heldout_position_rms_m")
        inertia = None
        if model.inertia is not None:
            inertia = inertia_of(**{name: np.asarray(row, float) for name, row in asdict(model.inertia).items()})
            if len(inertia.mass) != joints:
                raise ValueError(f"it has {joints} joints, but {len(inertia.mass)} masses")
        sizes = {"base": (1, 6), "link": (joints, 6), "tool": (1, 6), "mass": (joints, 4), "payload": (1, 1)}
        return DiagnosedArm(
            arm=model.arm,
            model=ArmModel(
                np.asarray(model.kinematics, float).ravel(),  # type: ignore[arg-type]
                np.asarray(model.T_sensor_base, float),  # type: ignore[arg-type]
                np.asarray(model.T_flange_tool, float),  # type: ignore[arg-type]
            ),
            physics=Physics(model_effects),
            values=join(numbers),
            inertia=inertia,
            joint_limits=None if model.joint_limits is None else np.asarray(model.joint_limits, float),
            joint_zero=np.zeros(joints) if model.joint_zero_rad is None else np.asarray(model.joint_zero_rad, float),
            orientation=model.orientation,
            reference_temperature=model.reference_temperature_degC,
            motion=model.motion,
            accelerated=model.accelerated,
            heldout_rms=None if before is None or after is None else (before, after),
            reference=self.origin,
            uncertainty=restored_uncertainty(model, model_effects, sizes, 2),
            sliding=model.sliding,
        )


def model_entry(model: DiagnosedArm, covariances: Sequence[Array]) -> dict[str, Any]:
    """A model as values that JSON can hold, with covariances of the numbers of each effect."""
    limits = model.joint_limits
    zero = np.asarray(model.joint_zero)
    masses = model.inertia
    return {
        "arm": model.arm,
        "kinematics": np.asarray(model.model.geometry).reshape(-1, 6).tolist(),
        "T_sensor_base": np.asarray(model.model.T_sensor_base).tolist(),
        "T_flange_tool": np.asarray(model.model.T_flange_tool).tolist(),
        "joint_limits": None if limits is None else np.asarray(limits).tolist(),
        **({"joint_zero_rad": zero.tolist()} if zero.any() else {}),
        "orientation": model.orientation,
        "inertia": masses and {name: np.asarray(value).tolist() for name, value in masses._asdict().items()},
        "motion": model.motion,
        "accelerated": model.accelerated,
        **shared_fields(model, model.physics.pairs, covariances),
    }
