"""Which rigid arm explains the poses of a reference recording, and how it differs from the recording's model."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import VARIANTS, bundled_arms, load_bundled
from lite6jax.arms.factory import read_factory
from lite6jax.calibration.problem import UNDECLARED_NOISE
from lite6jax.domains.pose.problem import pose_problem
from lite6jax.domains.pose.registration import Registration, register
from lite6jax.estimation.least_squares import relinearise
from lite6jax.estimation.options import DEFAULTS
from lite6jax.model import LEVER, ArmModel
from lite6jax.recordings import Recording, RecordingSettings

Array = NDArray[np.floating]
ChainKind = Literal[
    "factory_calibration", "reference_factory_calibration", "published_table", "ros_default_table", "nominal_table"
]

SUBSTANTIAL = 0.5
"""A difference is reported where it reduces the RMS position error at least to this share."""
_NEARLY = 1.5
"""A simpler explanation is preferred while its noise is below this multiple of the best one's."""
_LARGEST = 3
"""Displaced links reported of a chain of another geometry."""
_REDUNDANCY = 1.5
"""Measured numbers per parameter that a fit of the geometry requires."""


class Chain(NamedTuple):
    """A candidate for the reference's chain.

    Attributes:
        kind: where it is from.
        name: of the file or the bundled table.
        kinematics: `(joint, 6)`, x y z roll pitch yaw in m and rad.
    """

    kind: ChainKind
    name: str
    kinematics: Array


class RigidArm(NamedTuple):
    """A rigid arm as explanation of the reference.

    Attributes:
        chain: of the arm.
        flange: `(sample, 4, 4)` T_base_flange at the reference's joint positions.
        registration: sensor frame and tool, with residuals.
        fitted: whether the tool, and the frame, were fitted although they are declared.
    """

    chain: Chain
    flange: Array
    registration: Registration
    fitted: tuple[bool, bool]

    @property
    def rms(self) -> float:
        """RMS position error in m, outliers excluded."""
        return self.registration.rms

    def within(self, noise: tuple[float, float]) -> bool:
        """Whether the residuals of position (m) and orientation (rad) per axis are no larger than noise."""
        return all((found or 0.0) <= most for found, most in zip(self.registration.noise, noise, strict=True))


def chains_of(recording: Recording, reference: Recording, arm: Arm) -> list[Chain]:
    """The recording's own chain first, then the nominal ones of its model, then the reference's own calibration."""
    kinds: tuple[ChainKind, ChainKind] = ("factory_calibration", "reference_factory_calibration")
    calibrated = [
        Chain(kind, path.name, read_factory(path, arm).kinematics)
        for kind, side in zip(kinds, (recording, reference), strict=True)
        if (path := side.settings.factory_path(Path(side.source).parent)) is not None
    ]
    family = arm.name.split("_")[0]
    others = [load_bundled(name) for name in bundled_arms() if name != arm.name and name.split("_")[0] == family]
    nominal = [
        Chain(_kind_of(table.name), table.name, table.kinematics) for table in (arm, *others) if table.dof == arm.dof
    ]
    own = 0 if recording.settings.factory_calibration is None else 1
    return [*calibrated[:own], *nominal, *calibrated[own:]]


def _kind_of(table: str) -> ChainKind:
    if table not in bundled_arms():
        return "nominal_table"
    return "ros_default_table" if table in VARIANTS else "published_table"


def frame_hypotheses(settings: RecordingSettings) -> list[tuple[bool, bool]]:
    """Whether the tool, and the frame, are fitted although declared, fewest first; undeclared ones always are."""
    tool, frame = settings.tool != "unknown", settings.pose_frame == "base"
    every = [(False, False), (True, False), (False, True), (True, True)]
    return [fitted for fitted in every if (tool or not fitted[0]) and (frame or not fitted[1])]


def explained_by(reference: Recording, arm: Arm, chain: Chain, fitted: tuple[bool, bool]) -> RigidArm:
    """A chain with the sensor frame and the tool that fit the reference's poses best."""
    settings = reference.settings
    flange = flange_of(chain.kinematics, reference, arm)
    frame = np.eye(4) if settings.pose_frame == "base" and not fitted[1] else None
    tool = None if fitted[0] else declared_tool(settings)
    return RigidArm(chain, flange, registered(reference, flange, frame, tool), fitted)


def flange_of(kinematics: Array, recording: Recording, arm: Arm) -> Array:
    """`(sample, 4, 4)` T_base_flange of a chain `(joint, 6)` at a recording's joint positions."""
    links = np.stack([frames.transform_from_row(row) for row in kinematics])
    return frames.chain(links, recording.joint_position, arm.sliding) @ arm.T_joint_flange


def declared_tool(settings: RecordingSettings) -> Array | None:
    """`(4, 4)` T_flange_tool; None where it is unknown."""
    if settings.tool == "unknown":
        return None
    return np.eye(4) if settings.tool == "none" else frames.transform_from_row(settings.tool)


def registered(recording: Recording, flange: Array, frame: Array | None, tool: Array | None) -> Registration:
    """`register` of a recording's poses: a frame or a tool that is None is fitted."""
    settings, position = recording.settings, recording.position
    assert position is not None
    noise = (
        settings.position_noise_m or UNDECLARED_NOISE[0],
        settings.orientation_noise_rad or UNDECLARED_NOISE[1],
    )
    return register(flange, position, rotations(recording), noise, frame, tool)


def rotations(recording: Recording) -> Array | None:
    """`(sample, 3, 3)` measured orientations, or None."""
    quaternion = recording.quaternion
    return None if quaternion is None else Rotation.from_quat(np.roll(quaternion, -1, axis=1)).as_matrix()


def simplest(candidates: Sequence[RigidArm], noise: tuple[float, float]) -> RigidArm:
    """The first candidate within the noise.

    Otherwise the first that is nearly as good as the best, if it is substantially better than the first of all; else
    the first of all.
    """
    for rigid in candidates:
        if rigid.within(noise):
            return rigid
    best = [min(rigid.registration.noise[k] or 0.0 for rigid in candidates) for k in (0, 1)]
    most = (max(noise[0], _NEARLY * best[0]), max(noise[1], _NEARLY * best[1]))
    near = next((rigid for rigid in candidates if rigid.within(most)), candidates[0])
    return near if near.rms < SUBSTANTIAL * candidates[0].rms else candidates[0]


def with_fitted_geometry(reference: Recording, arm: Arm, start: RigidArm) -> RigidArm | None:
    """The chain of free geometry that fits the reference best; None where it has too few rows."""
    settings = replace(
        reference.settings,
        factory_calibration=None,
        factory_uncertainty=None,
        tool="unknown" if start.fitted[0] else reference.settings.tool,
        pose_frame="unknown" if start.fitted[1] else reference.settings.pose_frame,
    )
    freed = replace(reference, settings=settings)
    problem = pose_problem(freed, arm, "free")
    if problem.rows * problem.samples < _REDUNDANCY * len(problem.frames):
        return None
    found = start.registration
    model = ArmModel(start.chain.kinematics.ravel(), found.T_sensor_base, arm.T_joint_flange @ found.T_flange_tool)  # type: ignore[arg-type]
    model = relinearise(replace(problem, start=model), DEFAULTS).start
    rows, T_sensor_base = np.array(model.geometry).reshape(-1, 6), np.asarray(model.T_sensor_base)
    if settings.pose_frame == "base":  # a displacement of the base then belongs to the chain
        rows[0] = frames.row_from_transform(T_sensor_base @ frames.transform_from_row(rows[0]))
    fitted = explained_by(freed, arm, start.chain._replace(kinematics=rows), (False, False))
    return fitted._replace(fitted=start.fitted)


def differences(declared: RigidArm, chosen: RigidArm) -> list[dict[str, Any]]:
    """`other_table`, `other_frame` and `other_tool`, as plain JSON values in SI units."""
    step = {"position_rms_before_m": declared.rms, "position_rms_after_m": chosen.rms}
    found: list[dict[str, Any]] = []
    if chosen.chain[:2] != declared.chain[:2]:
        model, reference = ({"kind": kind, "name": name} for kind, name, _ in (declared.chain, chosen.chain))
        found.append({"difference": "other_table", "model": model, "reference": reference, **step})
    expected, T = declared.registration, chosen.registration
    if chosen.fitted[1]:
        found.append({"difference": "other_frame", **_displacement(expected.T_sensor_base, T.T_sensor_base), **step})
    if chosen.fitted[0]:
        tool = _displacement(expected.T_flange_tool, T.T_flange_tool)
        if T.turned is None:
            tool["rotation_rad"] = None
        found.append({"difference": "other_tool", **tool, **step})
    return found


def geometry_difference(free: RigidArm, start: RigidArm) -> dict[str, Any]:
    """`other_geometry` with the links displaced most; link 0 is the base.

    Of many displacements with the same effect, these are the smallest: the fit's prior is wide.
    """
    links = []
    for j, (row, before) in enumerate(zip(free.chain.kinematics, start.chain.kinematics, strict=True)):
        T = frames.transform_from_row(row) @ np.linalg.inv(frames.transform_from_row(before))
        links.append({"link": j, "distance_m": float(np.linalg.norm(T[:3, 3])), "rotation_rad": _angle(T)})
    links.sort(key=lambda link: link["distance_m"] + LEVER * link["rotation_rad"], reverse=True)
    return {
        "difference": "other_geometry",
        "links": links[:_LARGEST],
        "position_rms_before_m": start.rms,
        "position_rms_after_m": free.rms,
    }


def _displacement(before: Array, after: Array) -> dict[str, Any]:
    """Of a frame, in the axes of where it was before."""
    T = np.linalg.inv(before) @ after
    return {"translation_m": T[:3, 3].tolist(), "rotation_rad": _angle(T)}


def _angle(T: Array) -> float:
    return float(np.linalg.norm(Rotation.from_matrix(T[:3, :3]).as_rotvec()))
