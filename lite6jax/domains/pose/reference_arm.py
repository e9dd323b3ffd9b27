"""Which rigid arm made another side's poses, among those it may be, and how that differs from a model, in words."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import VARIANTS, bundled_arms, load_bundled
from lite6jax.arms.factory import read_factory
from lite6jax.domains.pose.problem import arm_moved, case_of, moved_to
from lite6jax.domains.pose.registration import Registration, register
from lite6jax.effects.composition import Physics
from lite6jax.estimation.least_squares import refit
from lite6jax.fitting.problem import UNDECLARED_NOISE
from lite6jax.model import ArmModel
from lite6jax.recordings import Recording, RecordingSettings

Array = NDArray[np.floating]

CLEARLY = 0.5
"""Share of what was left that a difference worth a name leaves."""
_NEARLY = 1.5
"""How much worse than the best a simpler explanation may be."""
_RELINEARISED = 3
_NAMED = 3
_SPARE = 1.5
"""Numbers measured over those fitted, for a free geometry."""
_LEVER = 0.3
"""m by which turned frames are set against displaced ones."""


class RigidArm(NamedTuple):
    """A rigid arm that may have made the other side.

    Attributes:
        label: its chain, in a sentence.
        kinematics: `(joint, 6)`.
        flange: `(sample, 4, 4)` T_base_flange at the other side's joints.
        found: frames, and what is left.
        freed: whether the tool, and the frame, are others than declared.
    """

    label: str
    kinematics: Array
    flange: Array
    found: Registration
    freed: tuple[bool, bool]

    @property
    def rms(self) -> float:
        """m left, wild rows apart."""
        return self.found.rms

    def within(self, allowed: tuple[float, float]) -> bool:
        """Whether no more is left than is allowed of position (m) and orientation (rad) per axis."""
        return all((left or 0.0) <= most for left, most in zip(self.found.noise, allowed, strict=True))


def chains_of(recording: Recording, other: Recording, arm: Arm) -> dict[str, Array]:
    """Chains `(joint, 6)` by what to call them: the recording's own, the nominal ones of its model, the other's own."""
    calibrated = [
        (f"{whose} factory calibration ({path.name})", read_factory(path, arm).kinematics)
        for whose, side in (("the", recording), ("its own", other))
        if (path := side.settings.factory_path(Path(side.source).parent)) is not None
    ]
    family = arm.name.split("_")[0]
    same = [load_bundled(name) for name in bundled_arms() if name != arm.name and name.split("_")[0] == family]
    nominal = []
    for table in (arm, *same):
        if table.dof == arm.dof:
            published = "the vendor's ROS default" if table.name in VARIANTS else "the published table"
            called = published if table.name in bundled_arms() else "the table"
            nominal.append((f"{called} ({table.name})", table.kinematics))
    own = 0 if recording.settings.factory_calibration is None else 1
    return dict([*calibrated[:own], *nominal, *calibrated[own:]])


def freedoms(settings: RecordingSettings) -> list[tuple[bool, bool]]:
    """Which of tool and frame may be others than declared, fewest first; what is unknown is fitted in any case."""
    tool, frame = settings.tool != "unknown", settings.pose_frame == "base"
    every = [(False, False), (True, False), (False, True), (True, True)]
    return [freed for freed in every if (tool or not freed[0]) and (frame or not freed[1])]


def explained_by(other: Recording, arm: Arm, label: str, kinematics: Array, freed: tuple[bool, bool]) -> RigidArm:
    """A chain under the other side's poses, its frames where they fit best."""
    settings = other.settings
    flange = flange_of(kinematics, other, arm)
    frame = np.eye(4) if settings.pose_frame == "base" and not freed[1] else None
    tool = None if freed[0] else declared_tool(settings)
    return RigidArm(label, kinematics, flange, registered(other, flange, frame, tool), freed)


def flange_of(kinematics: Array, recording: Recording, arm: Arm) -> Array:
    """`(sample, 4, 4)` T_base_flange of a chain `(joint, 6)` at a recording's joints."""
    links = np.stack([frames.transform_from_row(row) for row in kinematics])
    return frames.chain(links, recording.joint_position) @ arm.T_joint_flange


def declared_tool(settings: RecordingSettings) -> Array | None:
    """`(4, 4)`; None where it is unknown."""
    if settings.tool == "unknown":
        return None
    return np.eye(4) if settings.tool == "none" else frames.transform_from_row(settings.tool)


def registered(recording: Recording, flange: Array, frame: Array | None, tool: Array | None) -> Registration:
    """`register` of a recording, what is None fitted."""
    settings, position = recording.settings, recording.position
    assert position is not None
    noise = (
        settings.position_noise_m or UNDECLARED_NOISE[0],
        settings.orientation_noise_rad or UNDECLARED_NOISE[1],
    )
    return register(flange, position, rotations(recording), noise, frame, tool)


def rotations(recording: Recording) -> Array | None:
    """`(sample, 3, 3)` measured, or None."""
    quaternion = recording.quaternion
    return None if quaternion is None else Rotation.from_quat(np.roll(quaternion, -1, axis=1)).as_matrix()


def simplest(tried: Sequence[RigidArm], allowed: tuple[float, float]) -> RigidArm:
    """The first that is as good as noise lets it; else the first that is nearly as good as the best, if that is clearly
    better than the first of all."""
    for rigid in tried:
        if rigid.within(allowed):
            return rigid
    best = [min(rigid.found.noise[k] or 0.0 for rigid in tried) for k in (0, 1)]
    most = (max(allowed[0], _NEARLY * best[0]), max(allowed[1], _NEARLY * best[1]))
    near = next((rigid for rigid in tried if rigid.within(most)), tried[0])
    return near if near.rms < CLEARLY * tried[0].rms else tried[0]


def of_any_geometry(other: Recording, arm: Arm, start: RigidArm) -> RigidArm | None:
    """The chain, of any geometry, that comes nearest to the other side; None where it has too few rows to tell."""
    settings = replace(
        other.settings,
        factory_calibration=None,
        factory_uncertainty=None,
        tool="unknown" if start.freed[0] else other.settings.tool,
        pose_frame="unknown" if start.freed[1] else other.settings.pose_frame,
    )
    moved = replace(other, settings=settings)
    case = case_of(moved, arm, "free")
    if other.numbers_per_sample * other.samples < _SPARE * len(case.unknown):
        return None
    found = start.found
    model = ArmModel(start.kinematics.ravel(), found.T_sensor_base, arm.T_joint_flange @ found.T_flange_tool)  # type: ignore[arg-type]
    case = replace(case, start=model, offset=np.zeros(len(case.unknown)))
    for _ in range(_RELINEARISED):
        case = moved_to(case, refit(case, Physics()).moved)
    model = arm_moved(case, np.zeros(len(case.unknown)))
    rows, T_sensor_base = np.array(model.geometry).reshape(-1, 6), np.asarray(model.T_sensor_base)
    if settings.pose_frame == "base":  # there the base's displacement is the chain's
        rows[0] = frames.row_from_transform(T_sensor_base @ frames.transform_from_row(rows[0]))
    return explained_by(moved, arm, start.label, rows, (False, False))._replace(freed=start.freed)


def difference_statements(declared: RigidArm, chosen: RigidArm, name: str) -> list[str]:
    """Table, frame and tool, a sentence each."""
    said = []
    if chosen.label != declared.label:
        said.append(f"{name} has {chosen.label} where this model has {declared.label}.")
    T, expected = chosen.found, declared.found
    if chosen.freed[1]:
        said.append(f"Its base frame is another: {_offset(expected.T_sensor_base, T.T_sensor_base)}.")
    if chosen.freed[0]:
        turned = T.turned is not None
        said.append(f"Its tool is another: {_offset(expected.T_flange_tool, T.T_flange_tool, turned)}.")
    if said:
        said.append(f"That takes it from {_mm(declared.rms)} mm RMS to {_mm(chosen.rms)} mm.")
    return said


def geometry_statement(free: RigidArm, start: RigidArm) -> str:
    """Which frames of the chain stand otherwise; of many changes that do the same, those of a wide prior."""
    moved = []
    for j, (row, before) in enumerate(zip(free.kinematics, start.kinematics, strict=True)):
        T = frames.transform_from_row(row) @ np.linalg.inv(frames.transform_from_row(before))
        length, angle = float(np.linalg.norm(T[:3, 3])), _angle(T)
        place = f"link {j}" if j else "the base"
        moved.append((length + _LEVER * angle, f"{place} by {_mm(length)} mm and {_mm(angle)} mrad"))
    largest = [text for _, text in sorted(moved, reverse=True)[:_NAMED]]
    return (
        f"Its geometry is another: displaced are {', '.join(largest)} (the smallest changes that do it). That takes it "
        f"from {_mm(start.rms)} mm RMS to {_mm(free.rms)} mm."
    )


def shared_statement(free: RigidArm, name: str) -> str:
    """That an unknown geometry is the other side's."""
    return (
        f"No nominal table makes it. This arm's own geometry is not known: that which {name} shows, to "
        f"{_mm(free.rms)} mm RMS, is taken for both sides."
    )


def remainder_statement(nearest: RigidArm, name: str, declared: bool) -> str:
    """What no rigid arm explains, and what would; `declared` is whether the noise is."""
    remedy = "" if declared else "; if that is noise, declare position_noise_m in its sidecar"
    return (
        f"No rigid arm makes all of it: {_mm(nearest.rms)} mm RMS are left, which `lite6jax diagnose {name}` would "
        f"name{remedy}."
    )


def _offset(before: Array, after: Array, turned: bool = True) -> str:
    """Where a frame is in another, in words."""
    T = np.linalg.inv(before) @ after
    angle = f", turned by {_mm(_angle(T))} mrad" if turned else ""
    return f"({', '.join(_mm(value) for value in T[:3, 3])}) mm from the declared one{angle}"


def _angle(T: Array) -> float:
    return float(np.linalg.norm(Rotation.from_matrix(T[:3, :3]).as_rotvec()))


def _mm(length: float) -> str:
    """In thousandths, three digits; what rounding leaves is zero."""
    return f"{1e3 * length:.3g}" if abs(length) > 1e-9 else "0"
