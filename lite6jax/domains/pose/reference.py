"""A recording compared with a reference recording: another simulator's poses, or the same arm at an earlier time.

The reference is explained by a rigid arm: the recording's chain, a nominal table, another tool or another frame. What
it has beyond that arm is removed from the recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import VARIANTS, bundled_arms
from lite6jax.arms.factory import FactoryCalibration, read_factory
from lite6jax.array_types import Array
from lite6jax.calibration.problem import Geometry
from lite6jax.calibration.source import arm_of
from lite6jax.calibration.start import declared_tool, measured_rotations
from lite6jax.domains.pose.kinematics import unit_quaternions
from lite6jax.domains.pose.registration import Registration, noise_of, register
from lite6jax.domains.pose.rigid_arm import rigid_arm
from lite6jax.domains.pose.screening.hypotheses import tables_of_model
from lite6jax.errors import InputError
from lite6jax.estimation.least_squares import relinearise
from lite6jax.estimation.options import DEFAULTS
from lite6jax.model import LEVER, ArmModel
from lite6jax.recordings import Recording, RecordingSettings, require_one_station, require_samples
from lite6jax.recordings.alignment import flange_poses
from lite6jax.recordings.units import other_joints

SAME_JOINTS = 1e-3
"""rad within which two rows are of the same joint positions: an error beyond the rigid arm varies by a thousandth less
over such a distance."""
_NEIGHBOURS = 8
"""Nearest rows tried as partners of a row whose row number does not decide."""
_ROUNDING = (1e-6, 2e-6)
"""m and rad, the rounding of numbers in files."""
_NOISE_MARGIN = 1.2
"""Residuals up to this multiple of the declared noise are taken as noise."""
_SAME_TEMPERATURE = 0.1
"""K."""
_SAME_PAYLOAD = 1e-6
"""kg."""
_SUBSTANTIAL = 0.5
"""A difference is reported where it reduces the RMS position error at least to this share."""
_NEARLY = 1.5
"""A simpler explanation is preferred while its noise is below this multiple of the best one's."""
_LARGEST = 3
"""Displaced links reported of a chain of another geometry."""
_REDUNDANCY = 1.5
"""Measured numbers per parameter that a fit of the geometry requires."""


@dataclass(frozen=True, eq=False)
class ReferenceComparison:
    """A recording's rigid model compared with a reference recording, and what remains to be diagnosed.

    `differences` and `notes` are plain JSON values in SI units, each with a code under `difference` or `note`; the
    sentences are those of `lite6jax.report.statements`.

    Attributes:
        file: the reference's name.
        rows: of the recording.
        matched: of these, with a row of the reference at the same joint positions.
        reproduced: whether the recording's rigid model, with the frames as declared, gives the reference's poses.
        rigid: whether a rigid arm gives them exactly: a simulator without further effects.
        distance: `(kept,)` m from that model to the reference, outliers excluded.
        remaining: `(kept,)` m after the differences are applied.
        differences: between the recording's model and the reference.
        notes: which effects cancel between the two recordings, and what was left out or assumed.
        recording: the recording corrected by what the reference has beyond the rigid arm.
        factory: the chain that both share, where it was fitted to the reference; None where it is known.
        geometry: what is known of the corrected recording's geometry, as in `fit`.
    """

    file: str
    rows: int
    matched: int
    reproduced: bool
    rigid: bool
    distance: Array
    remaining: Array
    differences: tuple[dict[str, Any], ...]
    notes: tuple[dict[str, Any], ...]
    recording: Recording
    factory: FactoryCalibration | None
    geometry: Geometry

    def to_dict(self) -> dict[str, Any]:
        """Codes and numbers in SI units."""
        return {
            "file": self.file,
            "rows": self.rows,
            "matched_rows": self.matched,
            "reproduced": self.reproduced,
            "basis": "rigid" if self.rigid else "flexible",
            "position_rms_m": float(np.sqrt(np.mean(self.distance**2))),
            "position_max_m": float(self.distance.max()),
            "left_position_rms_m": float(np.sqrt(np.mean(self.remaining**2))),
            "differences": list(self.differences),
            "notes": list(self.notes),
        }


class _Chain(NamedTuple):
    """A candidate for the reference's chain.

    Attributes:
        kind: where it is from: "factory_calibration", "reference_factory_calibration", "published_table",
            "ros_default_table" or "nominal_table".
        name: of the file or the bundled table.
        kinematics: `(joint, 6)`, x y z roll pitch yaw in m and rad.
    """

    kind: str
    name: str
    kinematics: Array


class _RigidArm(NamedTuple):
    """A rigid arm as explanation of the reference.

    Attributes:
        chain: of the arm.
        flange: `(sample, 4, 4)` T_base_flange at the reference's joint positions.
        registration: sensor frame and tool, with residuals.
        fitted: whether the tool, and the frame, were fitted although they are declared.
    """

    chain: _Chain
    flange: Array
    registration: Registration
    fitted: tuple[bool, bool]

    @property
    def rms(self) -> float:
        """RMS position error in m, outliers excluded."""
        return self.registration.rms

    def within(self, noise: Sequence[float]) -> bool:
        """Tells whether the residuals of position (m) and orientation (rad) per axis are no larger than noise."""
        return all(
            (residual or 0.0) <= allowed for residual, allowed in zip(self.registration.noise, noise, strict=True)
        )


def compare(
    recording: Recording, reference: Recording, arm: Arm | None = None, geometry: Geometry = "declared"
) -> ReferenceComparison:
    """Explains the reference by a rigid arm, and corrects the recording by what the reference has beyond that arm.

    Candidates are the recording's chain, the arm's nominal tables, another tool and another frame, in the order of the
    number of changes. The reference's motion of the flange relative to the rigid arm that explains it, in the flange's
    axes, is removed from the recording's poses. This removes the geometry that both share, and the effects that both
    have under the same load, direction of motion and temperature. Where the geometry is not known, it is fitted to the
    reference. A frame or a tool that the reference's own sidecar declares is kept: if another one fits, the difference
    is reported and remains in the corrected recording.

    Args:
        recording: measured poses.
        reference: poses at the same joint positions, in any order. Where its settings declare nothing at all, frame and
            tool are taken from the recording's. Undeclared noise is taken as zero.
        arm: the nominal arm; from the recording's settings where not given.
        geometry: of the recording, as in `fit`; `declared` keeps a shared chain fixed.

    Raises:
        InputError: no positions in one of them, another number of joints, or too few rows at the same joint positions.
    """
    arm = arm or arm_of(recording)
    for side in (recording, reference):
        require_one_station(side)
        if side.dof != arm.dof:
            raise InputError(f"{side.source}: has {side.dof} joints, but {arm.name} has {arm.dof}; give that arm's")
        if side.sliding != arm.sliding:
            raise InputError(f"{side.source}: {other_joints(side.sliding, arm.sliding, arm.name)}")
        require_samples(side, 1)
    file = Path(reference.source).name
    rows = recording.samples
    recording, reference = _match(recording, reference)
    notes: list[dict[str, Any]] = []
    if reference.samples < rows:
        notes.append({"note": "unmatched_rows", "count": rows - reference.samples, "rows": rows})
    if recording.numbers_per_sample != reference.numbers_per_sample:
        notes.append({"note": "positions_only"})
        recording = replace(recording, quaternion=None)
        reference = replace(reference, quaternion=None)
    undeclared = reference.settings == RecordingSettings()
    if undeclared:
        settings = replace(reference.settings, pose_frame=recording.settings.pose_frame, tool=recording.settings.tool)
        reference = replace(reference, settings=settings)

    chains = _chains(recording, reference, arm)
    chain_known = recording.settings.factory_calibration is not None and geometry != "free"
    declared_noise = reference.settings.position_noise_m, reference.settings.orientation_noise_rad
    noise = tuple(
        max(_NOISE_MARGIN * (declared or 0.0), rounding)
        for declared, rounding in zip(declared_noise, _ROUNDING, strict=True)
    )
    # whether the tool, and the frame, are fitted although declared, fewest first; undeclared ones always are
    tool = reference.settings.tool != "unknown"
    frame = reference.settings.pose_frame == "base"
    combinations = ((False, False), (True, False), (False, True), (True, True))
    freed = [fitted for fitted in combinations if (tool or not fitted[0]) and (frame or not fitted[1])]
    candidates = [_explained_by(reference, arm, chain, fitted) for fitted in freed for chain in chains]
    declared = candidates[0]
    chosen = _simplest(candidates, noise)
    explained = chosen.within(noise)
    if not explained and not chain_known:
        chosen = declared  # frames fitted together with a wrong geometry mean nothing
    differences = _differences(declared, chosen)
    nearest = chosen
    shared = None
    if not explained:
        free = _with_fitted_geometry(reference, arm, chosen)
        if free is not None and free.rms <= _SUBSTANTIAL * chosen.rms:
            nearest = free
            unknown = {"difference": "unknown_geometry", "position_rms_after_m": free.rms}
            differences.append(_geometry_difference(free, chosen) if chain_known else unknown)
        if not chain_known and geometry != "free":
            shared = free
        if not nearest.within(noise):
            differences.append(
                {
                    "difference": "not_rigid",
                    "position_rms_after_m": nearest.rms,
                    "noise_declared": declared_noise[0] is not None,
                }
            )
    as_declared = chosen
    if not undeclared:
        as_declared = next(c for c in candidates if c.chain[:2] == chosen.chain[:2] and not any(c.fitted))
    exactly = as_declared.within(
        _ROUNDING
    )  # no effect of the reference is then absorbed by a frame or lost in its noise
    if not exactly:
        notes += _cancelling(recording, reference)
    inliers = nearest.registration.kept | (nearest.registration.distance < _ROUNDING[0])
    if not inliers.all():
        notes.append({"note": "outlying_rows", "count": int(np.sum(~inliers)), "rows": inliers.size})
    if geometry == "declared" and not as_declared.within(noise) and (chain_known or shared is not None):
        geometry = "exact"
    common = shared or as_declared
    base = chains[0] if chain_known else common.chain
    corrected = _corrected(recording, reference, arm, common, base.kinematics)
    if not exactly:
        corrected = _relative_to(reference, corrected, common.fitted)
    factory = None
    if shared is not None:
        factory = FactoryCalibration(shared.chain.kinematics, arm, arm.T_joint_flange, reference.source)
    return ReferenceComparison(
        file=file,
        rows=rows,
        matched=reference.samples,
        reproduced=explained and chosen is declared,
        rigid=exactly,
        distance=declared.registration.distance[inliers],
        remaining=nearest.registration.distance[inliers],
        differences=tuple(differences),
        notes=tuple(notes),
        recording=corrected,
        factory=factory,
        geometry=geometry,
    )


def _match(recording: Recording, reference: Recording) -> tuple[Recording, Recording]:
    """The rows of both at the same joint positions, in the recording's order: by row number, otherwise the nearest.

    Args:
        recording: any.
        reference: of as many joints; its rows may have another order. Each is matched at most once.

    Raises:
        InputError: fewer than half of the shorter recording's rows have a partner.
    """
    _, i, j = np.intersect1d(recording.row, reference.row, return_indices=True)
    equal_joints = np.abs(recording.joint_position[i] - reference.joint_position[j]).max(1, initial=0.0) <= SAME_JOINTS
    partner = np.full(recording.samples, -1)
    partner[i[equal_joints]] = j[equal_joints]
    open_rows = np.flatnonzero(partner < 0)
    spare = np.setdiff1d(np.arange(reference.samples), partner)
    if open_rows.size and spare.size:
        count = min(_NEIGHBOURS, spare.size)
        nearest = KDTree(reference.joint_position[spare]).query(
            recording.joint_position[open_rows], k=count, p=np.inf, distance_upper_bound=SAME_JOINTS
        )
        distance, index = (np.reshape(part, (open_rows.size, count)) for part in nearest)
        used = np.zeros(reference.samples, bool)
        for at in np.argsort(distance, axis=None, kind="stable"):
            row, k = divmod(int(at), count)
            if not np.isfinite(distance[row, k]):
                break
            candidate = spare[index[row, k]]
            if partner[open_rows[row]] < 0 and not used[candidate]:
                partner[open_rows[row]] = candidate
                used[candidate] = True
    rows = np.flatnonzero(partner >= 0)
    shorter = min(recording.samples, reference.samples)
    if 2 * rows.size < shorter:
        raise InputError(
            f"{reference.source}: {rows.size} of its {reference.samples} rows are at joint positions of the "
            f"{recording.samples} rows of {recording.source} (within {SAME_JOINTS:g} rad), but at least "
            f"{-(-shorter // 2)} are needed; give the same motion in both recordings"
        )
    return recording.select(rows), reference.select(partner[rows])


def _corrected(recording: Recording, reference: Recording, arm: Arm, common: _RigidArm, base: Array) -> Recording:
    """The recording's poses without what the reference has beyond a rigid arm, at the flange of the chain `base`.

    With D the reference's flange relative to that of the rigid arm that explains it, and P the recording's pose by its
    own model, Y' = P D⁻¹ P⁻¹ Y. Where Y = P D E, this leaves P E: what both share cancels exactly, whatever its size.
    """
    settings = recording.settings
    position = recording.position
    measured = reference.position
    assert position is not None
    assert measured is not None
    F = common.registration.T_sensor_base
    U = common.registration.T_flange_tool
    flange = flange_poses(replace(arm, kinematics=base, dh=None), recording.joint_position)
    P = _registered(recording, flange, (False, False)).T_sensor_base @ flange
    in_base = (measured - F[:3, 3]) @ F[:3, :3]
    rotation = measured_rotations(recording)
    reference_rotation = measured_rotations(reference)
    quaternion = None
    if rotation is None or reference_rotation is None:
        offset = in_base - (common.flange @ U)[:, :3, 3]
        in_flange = np.einsum("sji,sj->si", common.flange[:, :3, :3], offset)
        position = position - np.einsum("sij,sj->si", P[:, :3, :3], in_flange)
    else:
        O, Y = (np.broadcast_to(np.eye(4), P.shape).copy() for _ in range(2))
        O[:, :3, :3], O[:, :3, 3] = F[:3, :3].T @ reference_rotation, in_base
        Y[:, :3, :3], Y[:, :3, 3] = rotation, position
        D = np.linalg.inv(common.flange) @ O @ np.linalg.inv(U)
        corrected = P @ np.linalg.inv(D) @ np.linalg.inv(P) @ Y
        position = corrected[:, :3, 3]
        quaternion = unit_quaternions(corrected[:, :3, :3])
    combined = {}
    of_reference = reference.settings
    for key, noise, reference_noise in (
        ("position_noise_m", settings.position_noise_m, of_reference.position_noise_m),
        ("orientation_noise_rad", settings.orientation_noise_rad, of_reference.orientation_noise_rad),
        ("joint_noise_rad", settings.joint_noise_rad, of_reference.joint_noise_rad),
    ):
        combined[key] = noise if noise is None else float(np.hypot(noise, reference_noise or 0.0))
    return replace(recording, position=position, quaternion=quaternion, settings=replace(settings, **combined))


def _relative_to(reference: Recording, recording: Recording, fitted: tuple[bool, bool]) -> Recording:
    """With frame and tool declared only where both declare them, and temperatures relative to the reference's.

    A fitted frame or tool is not in the difference, and an expansion of both acts by that of the temperatures.
    """
    settings = recording.settings
    if fitted[0] or reference.settings.tool == "unknown":
        settings = replace(settings, tool="unknown")
    if fitted[1] or reference.settings.pose_frame == "unknown":
        settings = replace(settings, pose_frame="unknown")
    reference_temperature = _temperature(reference)
    joints = recording.joint_temperature
    ambient = recording.ambient_temperature
    if reference_temperature is not None and _temperature(recording) is not None:
        mean = float(reference_temperature.mean())
        settings = replace(settings, reference_temperature_degC=mean)
        joints = None if joints is None else joints - (reference_temperature - mean)[:, None]
        ambient = None if ambient is None else ambient - (reference_temperature - mean)
    return replace(recording, joint_temperature=joints, ambient_temperature=ambient, settings=settings)


def _temperature(recording: Recording) -> Array | None:
    """`(sample,)` °C of the arm; None where it was not recorded."""
    joints = recording.joint_temperature
    if joints is None:
        return recording.ambient_temperature
    return joints.mean(1)


def _cancelling(recording: Recording, reference: Recording) -> list[dict[str, Any]]:
    """Which drivers are equal in both recordings, so that their effects cancel, and which are not."""
    temperature = _temperature(recording)
    reference_temperature = _temperature(reference)
    differs = {
        "payload": np.abs(recording.payload - reference.payload) > _SAME_PAYLOAD,
        "direction_of_motion": (recording.direction_of_motion != reference.direction_of_motion).any(1),
    }
    if temperature is not None and reference_temperature is not None:
        differs["temperature"] = np.abs(temperature - reference_temperature) > _SAME_TEMPERATURE
    notes: list[dict[str, Any]] = []
    equal = [driver for driver, rows in differs.items() if not rows.any()]
    if equal:
        notes.append({"note": "equal_drivers", "drivers": equal})
    for driver in ("payload", "direction_of_motion"):
        if driver not in equal:
            notes.append({"note": f"{driver}_differs", "count": int(differs[driver].sum())})
    if temperature is not None and reference_temperature is not None and "temperature" not in equal:
        mean = float(temperature.mean())
        reference_mean = float(reference_temperature.mean())
        notes.append({"note": "temperature_differs", "mean_degC": mean, "reference_mean_degC": reference_mean})
    if (temperature is None) != (reference_temperature is None):
        notes.append({"note": "one_temperature"})
    return notes


def _chains(recording: Recording, reference: Recording, arm: Arm) -> list[_Chain]:
    """The recording's own chain first, then the nominal ones of its model, then the reference's own calibration."""
    kinds = ("factory_calibration", "reference_factory_calibration")
    calibrated = [
        _Chain(kind, path.name, read_factory(path, arm).kinematics)
        for kind, side in zip(kinds, (recording, reference), strict=True)
        if (path := side.settings.factory_path(Path(side.source).parent)) is not None
    ]

    kind_of = {name: "ros_default_table" if name in VARIANTS else "published_table" for name in bundled_arms()}
    tables = [arm, *(table for table in tables_of_model(arm.name) if table.name != arm.name and table.dof == arm.dof)]
    nominal = [_Chain(kind_of.get(table.name, "nominal_table"), table.name, table.kinematics) for table in tables]
    calibrated_count = 1
    if recording.settings.factory_calibration is None:
        calibrated_count = 0
    return [*calibrated[:calibrated_count], *nominal, *calibrated[calibrated_count:]]


def _explained_by(reference: Recording, arm: Arm, chain: _Chain, fitted: tuple[bool, bool]) -> _RigidArm:
    """A chain with the sensor frame and the tool that fit the reference's poses best."""
    flange = flange_poses(replace(arm, kinematics=chain.kinematics, dh=None), reference.joint_position)
    return _RigidArm(chain, flange, _registered(reference, flange, fitted), fitted)


def _registered(recording: Recording, flange: Array, fitted: tuple[bool, bool]) -> Registration:
    """`register` of a recording's poses: tool and frame are fitted where they are not declared, or are to be."""
    settings = recording.settings
    position = recording.position
    assert position is not None
    tool = None if fitted[0] or settings.tool == "unknown" else declared_tool(recording)
    frame = None
    if settings.pose_frame == "base" and not fitted[1]:
        frame = np.eye(4)
    return register(flange, position, measured_rotations(recording), noise_of(settings), frame, tool)


def _simplest(candidates: Sequence[_RigidArm], noise: Sequence[float]) -> _RigidArm:
    """The first candidate within the noise.

    Otherwise the first that is nearly as good as the best, if it is substantially better than the first of all; else
    the first of all.
    """
    for rigid in candidates:
        if rigid.within(noise):
            return rigid
    smallest = [min(rigid.registration.noise[k] or 0.0 for rigid in candidates) for k in (0, 1)]
    limit = (max(noise[0], _NEARLY * smallest[0]), max(noise[1], _NEARLY * smallest[1]))
    near = next((rigid for rigid in candidates if rigid.within(limit)), candidates[0])
    if near.rms < _SUBSTANTIAL * candidates[0].rms:
        return near
    return candidates[0]


def _with_fitted_geometry(reference: Recording, arm: Arm, start: _RigidArm) -> _RigidArm | None:
    """The chain of free geometry that fits the reference best; None where it has too few rows."""
    settings = replace(
        reference.settings,
        factory_calibration=None,
        factory_uncertainty=None,
        tool="unknown" if start.fitted[0] else reference.settings.tool,
        pose_frame="unknown" if start.fitted[1] else reference.settings.pose_frame,
    )
    freed = replace(reference, settings=settings)
    begun = rigid_arm(freed, arm, "free")
    if begun.rows * begun.samples < _REDUNDANCY * len(begun.unknown):
        return None
    fit = start.registration
    model = ArmModel(start.chain.kinematics.ravel(), fit.T_sensor_base, arm.T_joint_flange @ fit.T_flange_tool)  # type: ignore[arg-type]
    rows = np.asarray(relinearise(replace(begun, start=model), DEFAULTS).model.geometry).reshape(-1, 6)
    fitted = _explained_by(freed, arm, start.chain._replace(kinematics=rows), (False, False))
    return fitted._replace(fitted=start.fitted)


def _differences(declared: _RigidArm, chosen: _RigidArm) -> list[dict[str, Any]]:
    """`other_table`, `other_frame` and `other_tool`, as plain JSON values in SI units."""
    step = {"position_rms_before_m": declared.rms, "position_rms_after_m": chosen.rms}
    differences: list[dict[str, Any]] = []
    if chosen.chain[:2] != declared.chain[:2]:
        model, reference = ({"kind": kind, "name": name} for kind, name, _ in (declared.chain, chosen.chain))
        differences.append({"difference": "other_table", "model": model, "reference": reference, **step})
    expected = declared.registration
    T = chosen.registration
    if chosen.fitted[1]:
        differences.append(
            {"difference": "other_frame", **_displacement(expected.T_sensor_base, T.T_sensor_base), **step}
        )
    if chosen.fitted[0]:
        tool = _displacement(expected.T_flange_tool, T.T_flange_tool)
        if T.turned is None:
            tool["rotation_rad"] = None
        differences.append({"difference": "other_tool", **tool, **step})
    return differences


def _geometry_difference(free: _RigidArm, start: _RigidArm) -> dict[str, Any]:
    """`other_geometry` with the links displaced most; link 0 is the base.

    Of many displacements with the same effect, these are the smallest: the fit's prior is wide.
    """
    after, before = (frames.transform_from_row(rigid.chain.kinematics) for rigid in (free, start))
    displaced = frames.compare_transforms(after @ np.linalg.inv(before), np.broadcast_to(np.eye(4), after.shape))
    links = [
        {"link": j, "distance_m": float(distance), "rotation_rad": float(angle)}
        for j, (distance, angle) in enumerate(zip(*displaced, strict=True))
    ]
    links.sort(key=lambda link: link["distance_m"] + LEVER * link["rotation_rad"], reverse=True)
    return {
        "difference": "other_geometry",
        "links": links[:_LARGEST],
        "position_rms_before_m": start.rms,
        "position_rms_after_m": free.rms,
    }


def _displacement(before: Array, after: Array) -> dict[str, Any]:
    """Translation and rotation of a frame, in the axes of where it was before."""
    T = np.linalg.inv(before) @ after
    return {"translation_m": T[:3, 3].tolist(), "rotation_rad": float(Rotation.from_matrix(T[:3, :3]).magnitude())}
