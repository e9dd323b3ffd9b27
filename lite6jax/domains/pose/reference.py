"""Another side of a recording, a simulator's answer or the same arm earlier: what it is, and what differs from it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import JOINTS, write_factory
from lite6jax.arms.files import read_arm
from lite6jax.diagnosis.diagnose import Diagnosis, diagnose
from lite6jax.domains.pose.reference_arm import (
    CLEARLY,
    RigidArm,
    chains_of,
    declared_tool,
    difference_statements,
    explained_by,
    flange_of,
    freedoms,
    geometry_statement,
    of_any_geometry,
    registered,
    remainder_statement,
    rotations,
    shared_statement,
    simplest,
)
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.fitting.problem import Geometry
from lite6jax.recordings import Recording, RecordingSettings, require_samples

Array = NDArray[np.floating]

SAME_JOINTS = 1e-3
"""rad within which two rows are of the same joint positions: what differs, differs there by a thousandth less."""
_ROUNDED = (1e-6, 2e-6)
"""m and rad that files lose by rounding."""
_AS_NOISE = 1.2
_NEIGHBOURS = 8
_SAME_WARMTH = 0.1
"""K."""


@dataclass(frozen=True, eq=False)
class Against:
    """Two sides compared, and what is left to be diagnosed.

    Attributes:
        file: the other side's name.
        rows: of the recording.
        matched: of these, with a row of the other side at the same joints.
        reproduced: whether the recording's model makes the other side, as it is declared.
        rigid: whether a rigid arm makes it exactly: a simulator without physics.
        distance: `(kept,)` m from that model to the other side, in rows that do not stand out.
        left: `(kept,)` m that remains of it with the differences below.
        differences: what the other side has otherwise, a sentence each.
        notes: what cancels between the two, and what was assumed.
        recording: the recording less what the other side has beyond the model.
        kinematics: `(joint, 6)` of the chain that both share, where it is the other side that tells it; or None.
        geometry: how the recording's geometry is to be taken.
    """

    file: str
    rows: int
    matched: int
    reproduced: bool
    rigid: bool
    distance: Array
    left: Array
    differences: tuple[str, ...]
    notes: tuple[str, ...]
    recording: Recording
    kinematics: Array | None
    geometry: Geometry

    @property
    def statement(self) -> str:
        """What the model in the diagnosis, and a prediction from it, is."""
        if self.rigid:
            return f"{self.file} is a rigid arm: the model is this arm's own, whole."
        return (
            f"The model is this arm's rigid one with the difference from {self.file}: what both have beyond a rigid "
            f"arm is not in it, and what only {self.file} has is in it with its sign reversed."
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and words in SI units."""
        return {
            "file": self.file,
            "rows": self.rows,
            "matched_rows": self.matched,
            "reproduced": self.reproduced,
            "position_rms_m": _rms(self.distance),
            "position_max_m": float(self.distance.max()),
            "left_position_rms_m": _rms(self.left),
            "differences": list(self.differences),
            "notes": list(self.notes),
            "statement": self.statement,
        }


def diagnose_against(
    recording: Recording,
    other: Recording,
    arm: Arm | None = None,
    *,
    geometry: Geometry = "declared",
    effects: Sequence[Effect] = (),
    progress: Callable[[int], object] | None = None,
) -> tuple[Diagnosis, Against]:
    """Diagnoses what a recording has beyond another one; arguments and errors as `compare` and `diagnose`."""
    arm = arm or _arm_of(recording)
    seen = compare(recording, other, arm, geometry)
    difference = seen.recording
    with TemporaryDirectory() as folder:
        if seen.kinematics is not None:
            path = write_factory(seen.kinematics, Path(folder) / "shared.yaml")
            shared = replace(difference.settings, factory_calibration=str(path), factory_uncertainty=None)
            difference = replace(difference, settings=shared)
        found = diagnose(difference, arm, geometry=seen.geometry, effects=effects, progress=progress)
    return found, seen


def compare(recording: Recording, other: Recording, arm: Arm | None = None, geometry: Geometry = "declared") -> Against:
    """What the other side is, seen from the recording's model, and the recording without it.

    The other side is explained by the recording's chain, the arm's nominal tables, another tool and another frame, the
    fewest changes first. What it has beyond the rigid arm that explains it, a motion of the flange in its own axes, is
    taken out of the recording's poses: with it goes the geometry that both share, and physics that both have under the
    same load, direction and temperature. Where the geometry is not known, the other side tells it. A frame or a tool
    that its own sidecar declares is believed: another one is named, and stays in the difference.

    Args:
        recording: measured poses.
        other: poses at the same joint positions, in any order. Where its settings declare nothing at all, frame and
            tool are expected as in the recording's. Noise that they do not declare is taken for none.
        arm: the nominal arm; from the recording's settings where not given.
        geometry: of the recording, as in `fit`; `declared` holds a chain that both share exactly.

    Raises:
        InputError: no positions on either side, another number of joints, or too few rows of the same joints.
    """
    arm = arm or _arm_of(recording)
    for side in (recording, other):
        if side.dof != arm.dof:
            raise InputError(f"{side.source}: has {side.dof} joints, but {arm.name} has {arm.dof}; give that arm's")
        require_samples(side, 1)
    name, rows = Path(other.source).name, recording.samples
    recording, other = _matched(recording, other)
    notes = []
    if other.samples < rows:
        notes.append(f"{rows - other.samples} of {rows} rows have none of {name} at their joints and are left out.")
    if recording.numbers_per_sample != other.numbers_per_sample:
        notes.append("Only one side has orientations: positions alone are compared.")
        recording, other = replace(recording, quaternion=None), replace(other, quaternion=None)
    undeclared = other.settings == RecordingSettings()
    if undeclared:
        expected = replace(other.settings, pose_frame=recording.settings.pose_frame, tool=recording.settings.tool)
        other = replace(other, settings=expected)

    tables = chains_of(recording, other, arm)
    known = recording.settings.factory_calibration is not None and geometry != "free"
    noise = other.settings.position_noise_m, other.settings.orientation_noise_rad
    allowed = (max(_AS_NOISE * (noise[0] or 0.0), _ROUNDED[0]), max(_AS_NOISE * (noise[1] or 0.0), _ROUNDED[1]))
    tried = [
        explained_by(other, arm, label, kinematics, freed)
        for freed in freedoms(other.settings)
        for label, kinematics in tables.items()
    ]
    declared, chosen = tried[0], simplest(tried, allowed)
    explained = chosen.within(allowed)
    if not explained and not known:
        chosen = declared  # frames found beside a wrong geometry mean nothing
    differences = difference_statements(declared, chosen, name)
    nearest, shared = chosen, None
    if not explained:
        free = of_any_geometry(other, arm, chosen)
        if free is not None and free.rms <= CLEARLY * chosen.rms:
            nearest = free
            differences.append(geometry_statement(free, chosen) if known else shared_statement(free, name))
        if not known and free is not None and geometry != "free" and arm.dof in JOINTS:
            shared = free
        if not nearest.within(allowed):
            differences.append(remainder_statement(nearest, name, noise[0] is not None))
    held = chosen if undeclared else next(r for r in tried if r.label == chosen.label and not any(r.freed))
    exactly = held.within(_ROUNDED)  # then nothing of its physics can hide in a frame or under noise
    if not exactly:
        notes += _cancelling(recording, other)
    kept = nearest.found.kept | (nearest.found.distance < _ROUNDED[0])
    if not kept.all():
        notes.append(f"Of {name} stand out, and are in no figure here, {np.sum(~kept)} of {kept.size} rows.")
    if geometry == "declared" and not held.within(allowed) and (known or shared is not None):
        geometry = "exact"
    common = shared or held
    base = next(iter(tables.values())) if known else common.kinematics
    difference = _less(recording, other, arm, common, base)
    if not exactly:
        difference = _less_warmth(_declared_with(difference, common.freed, other.settings), other)
    return Against(
        file=name,
        rows=rows,
        matched=other.samples,
        reproduced=explained and chosen is declared,
        rigid=exactly,
        distance=declared.found.distance[kept],
        left=nearest.found.distance[kept],
        differences=tuple(differences),
        notes=tuple(notes),
        recording=replace(difference, notes=(*difference.notes, *notes)),
        kinematics=None if shared is None else shared.kinematics,
        geometry=geometry,
    )


def _arm_of(recording: Recording) -> Arm:
    return read_arm(recording.settings.arm_reference(Path(recording.source).parent))


def _matched(recording: Recording, other: Recording) -> tuple[Recording, Recording]:
    """The rows of both that are of the same joints, in the recording's order: by their number, else the nearest."""
    _, i, j = np.intersect1d(recording.row, other.row, return_indices=True)
    same = np.abs(recording.joint_position[i] - other.joint_position[j]).max(1, initial=0.0) <= SAME_JOINTS
    partner = np.full(recording.samples, -1)
    partner[i[same]] = j[same]
    left = np.flatnonzero(partner < 0)
    spare = np.setdiff1d(np.arange(other.samples), partner)
    if left.size and spare.size:
        nearby = min(_NEIGHBOURS, spare.size)
        near = KDTree(other.joint_position[spare]).query(
            recording.joint_position[left], k=nearby, p=np.inf, distance_upper_bound=SAME_JOINTS
        )
        distance, found = (np.reshape(part, (left.size, nearby)) for part in near)
        taken = np.zeros(other.samples, bool)
        for at in np.argsort(distance, axis=None, kind="stable"):
            row, k = divmod(int(at), nearby)
            if not np.isfinite(distance[row, k]):
                break
            theirs = spare[found[row, k]]
            if partner[left[row]] < 0 and not taken[theirs]:
                partner[left[row]], taken[theirs] = theirs, True
    ours = np.flatnonzero(partner >= 0)
    fewer = min(recording.samples, other.samples)
    if 2 * ours.size < fewer:
        raise InputError(
            f"{other.source}: {ours.size} of its {other.samples} rows are at joint positions of the "
            f"{recording.samples} of {recording.source} (to {SAME_JOINTS:g} rad), and half of the fewer, "
            f"{-(-fewer // 2)}, are needed; give the same motion on both sides"
        )
    return recording.select(ours), other.select(partner[ours])


def _less(recording: Recording, other: Recording, arm: Arm, common: RigidArm, base: Array) -> Recording:
    """The recording's poses without what the other side has beyond a rigid arm, at the flange of the chain `base`.

    With D the other side's flange in that of the rigid arm that explains it, and P the recording's own by its model,
    Y' = P D⁻¹ P⁻¹ Y. Where both have Y = P D E, this leaves P E: what they share goes, whatever its size.
    """
    settings, position = recording.settings, recording.position
    measured = other.position
    assert position is not None
    assert measured is not None
    F, U = common.found.T_sensor_base, common.found.T_flange_tool
    own = flange_of(base, recording, arm)
    frame = np.eye(4) if settings.pose_frame == "base" else None
    P = registered(recording, own, frame, declared_tool(settings)).T_sensor_base @ own
    seen = (measured - F[:3, 3]) @ F[:3, :3]
    rotation, turned, quaternion = rotations(recording), rotations(other), None
    if rotation is None or turned is None:
        off = seen - (common.flange @ U)[:, :3, 3]
        in_flange = np.einsum("sji,sj->si", common.flange[:, :3, :3], off)
        position = position - np.einsum("sij,sj->si", P[:, :3, :3], in_flange)
    else:
        O, Y = (np.broadcast_to(np.eye(4), P.shape).copy() for _ in range(2))
        O[:, :3, :3], O[:, :3, 3] = F[:3, :3].T @ turned, seen
        Y[:, :3, :3], Y[:, :3, 3] = rotation, position
        D = np.linalg.inv(common.flange) @ O @ np.linalg.inv(U)
        left = P @ np.linalg.inv(D) @ np.linalg.inv(P) @ Y
        position = left[:, :3, 3]
        quaternion = np.roll(Rotation.from_matrix(left[:, :3, :3]).as_quat(), 1, axis=1)
    both = {}
    for key in ("position_noise_m", "orientation_noise_rad", "joint_noise_rad"):
        ours, theirs = getattr(settings, key), getattr(other.settings, key)
        both[key] = ours if ours is None else float(np.hypot(ours, theirs or 0.0))
    return replace(recording, position=position, quaternion=quaternion, settings=replace(settings, **both))


def _declared_with(recording: Recording, freed: tuple[bool, bool], others: RecordingSettings) -> Recording:
    """With frame and tool declared only where both sides declare them: where one is fitted, the difference lacks it."""
    settings = recording.settings
    if freed[0] or others.tool == "unknown":
        settings = replace(settings, tool="unknown")
    if freed[1] or others.pose_frame == "unknown":
        settings = replace(settings, pose_frame="unknown")
    return replace(recording, settings=settings)


def _less_warmth(recording: Recording, other: Recording) -> Recording:
    """Warmth counted from the other side's: an expansion that both have shows by the difference of their warmth."""
    theirs, ours = _warmth(other), _warmth(recording)
    if theirs is None or ours is None:
        return recording
    mean = float(theirs.mean())
    off = theirs - mean
    joints, ambient = recording.joint_temperature, recording.ambient_temperature
    return replace(
        recording,
        joint_temperature=None if joints is None else joints - off[:, None],
        ambient_temperature=None if ambient is None else ambient - off,
        settings=replace(recording.settings, reference_temperature_degC=mean),
    )


def _warmth(recording: Recording) -> Array | None:
    """`(sample,)` °C of the arm; None where it was not recorded."""
    joints = recording.joint_temperature
    return recording.ambient_temperature if joints is None else joints.mean(1)


def _cancelling(recording: Recording, other: Recording) -> list[str]:
    """What drove both sides alike, so that what it causes in both is not seen, and what did not."""
    ours, theirs = _warmth(recording), _warmth(other)
    colder = None if ours is None or theirs is None else np.abs(ours - theirs) > _SAME_WARMTH
    drivers = [
        ("payload", np.abs(recording.payload - other.payload) > 1e-6),
        ("direction of motion", (recording.direction_of_motion != other.direction_of_motion).any(1)),
        *([] if colder is None else [("temperature", colder)]),
    ]
    alike = [driver for driver, differs in drivers if not differs.any()]
    notes = []
    if alike:
        notes.append(
            f"The same on both sides: {' and '.join(alike)}. What depends on nothing else cancels where both have it."
        )
    for driver, what in (("payload", "what bends under load"), ("direction of motion", "backlash")):
        count = sum(int(differs.sum()) for name, differs in drivers if name == driver)
        if count:
            notes.append(f"The {driver} differs in {count} rows: there {what} that both sides have does not cancel.")
    if ours is not None and theirs is not None and "temperature" not in alike:
        notes.append(
            f"The arm was at {ours.mean():.1f} °C, on the other side at {theirs.mean():.1f} °C: expansion is sought by "
            "the difference."
        )
    if (ours is None) != (theirs is None):
        notes.append("Only one side has temperatures: an expansion that both sides have does not cancel.")
    return notes


def _rms(distance: Array) -> float:
    return float(np.sqrt(np.mean(distance**2)))
