"""Factory calibrations: the six-parameter file of an individual arm, and the recognition of its model."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax import storage
from lite6jax.arms import convert, entries, frames
from lite6jax.arms.arm import Arm, sample_joints
from lite6jax.arms.bundled import bundled_of
from lite6jax.arms.table import read_table
from lite6jax.checksum import with_comment
from lite6jax.errors import InputError, InputWarning

Array = NDArray[np.floating]

# m; a calibration within this RMS distance of a model is recognised as that model, of several as the nearest. A real
# xArm 7 is 8.5 mm from its nominal, and the two most similar models (UR3, UR3e) differ by 21 mm.
RECOGNISED_WITHIN = 0.05

MOST_JOINTS = 99
"""The names of more have another form."""

# m; points at this distance along the flange's x and y are compared as well, so that its orientation matters too.
PROBE = 0.1


@dataclass(frozen=True, eq=False)
class FactoryCalibration:
    """The calibrated chain of an individual arm, and the nominal arm from which it deviates slightly.

    Attributes:
        kinematics: (joint, 6) x y z roll pitch yaw of each joint's frame in the previous one, m and rad.
        arm: the nominal arm, recognised or given.
        T_joint_flange: (4, 4) from the frame after the last joint to the flange.
        source: the file.
    """

    kinematics: Array
    arm: Arm
    T_joint_flange: Array
    source: str


def read_factory(path: str | Path, arm: Arm | None = None) -> FactoryCalibration:
    """A factory calibration: YAML in the vendor's form (`joint1`, …) or Universal Robots' (`shoulder`, …), or the JSON
    table of Hayati parameters.

    Args:
        path: the file.
        arm: its nominal arm; None for the nearest bundled arm, or for the chain itself where no bundled arm has as many
            joints, or prismatic ones.

    Warns:
        InputWarning: the chain is taken as its own nominal arm.

    Raises:
        InputError: not such a file; joints or keys missing or unknown; a value that is not a number; degrees for
            radians, millimetres for metres; a joint rotated by 180 deg; no `arm` given and no bundled arm near. The
            line names the file, the joint and the remedy.
    """
    if Path(path).suffix.lower() != ".json":
        return factory_from(storage.read_yaml(path), path, arm)
    table = read_table(path)
    chain = convert.hayati_to_six_parameter(table.form, table.parameters)
    kinematics, T_joint_flange = (np.array(part, np.float64) for part in chain)
    names = tuple(f"joint{i + 1}" for i in range(len(kinematics)))
    return _recognised(kinematics, names, T_joint_flange, table.form.sliding, path, arm)


def factory_from(content: Any, path: str | Path, arm: Arm | None = None) -> FactoryCalibration:
    """The factory calibration that a YAML file holds.

    Args:
        content: as `storage.read_yaml` gives it.
        path: the file, for messages.
        arm: as of `read_factory`.

    Raises:
        InputError: as `read_factory`.
    """
    content = entries.mapping(content, f"{path}:", ("kinematics",))
    kinematics, names = entries.kinematics(content["kinematics"], str(path))
    return _recognised(kinematics, names, np.eye(4), () if arm is None else arm.sliding, path, arm)


def _recognised(
    kinematics: Array,
    names: Sequence[str],
    T_joint_flange: Array,
    sliding: tuple[int, ...],
    path: str | Path,
    arm: Arm | None,
) -> FactoryCalibration:
    if arm is None and (sliding or not bundled_of(len(kinematics))):
        arm = Arm(Path(path).stem, kinematics, sliding=sliding, source=f"factory calibration {Path(path).name}")
        what = f"prismatic joints, as joint {sliding[0] + 1} is" if sliding else f"{len(kinematics)} joints"
        warnings.warn(
            f"{path}: no bundled arm has {what}, so this chain is its own nominal arm; name another with --arm to see"
            " how it deviates",
            InputWarning,
            stacklevel=3,
        )
        return FactoryCalibration(kinematics, arm, T_joint_flange, str(path))
    if arm is not None and arm.sliding != sliding:
        raise InputError(f"{path}: has other prismatic joints than {arm.name}; name another arm with --arm")
    if arm is not None and arm.dof != len(kinematics):
        raise InputError(f"{path}: has {len(kinematics)} joints, but {arm.name} has {arm.dof}; name another with --arm")
    recognised = recognise(kinematics, names, str(path), arm, T_joint_flange)
    return FactoryCalibration(kinematics, recognised, T_joint_flange @ recognised.T_joint_flange, str(path))


def write_factory(kinematics: ArrayLike, path: str | Path, form: str = "vendor", overwrite: bool = False) -> Path:
    """Writes a six-parameter table as a factory file; `read_factory` returns every number exactly.

    Args:
        kinematics: `(joint, 6)` x y z roll pitch yaw, m and rad.
        path: the file to write.
        form: `vendor` (`joint1`, …; any number of joints, of whose types it says nothing) or `ur` (`shoulder`, …; 6
            joints).
        overwrite: whether the file may be replaced.

    Raises:
        InputError: another form or number of joints, a number that is not finite, or as `storage.write_atomically`.
    """
    rows = np.asarray(kinematics, np.float64)
    if form not in ("vendor", "ur"):
        raise InputError(f"{path}: no form {form!r} of factory files; write 'vendor' or 'ur'")
    fitting = len(rows) == 6 if form == "ur" else 0 < len(rows) <= MOST_JOINTS
    if rows.ndim != 2 or rows.shape[1] != 6 or not fitting:
        wanted = "(6, 6)" if form == "ur" else "(joint, 6)"
        raise InputError(f"{path}: the {form} form holds an array {wanted}, not {rows.shape}; choose another form")
    if not np.isfinite(rows).all():
        joint = int(np.argmax(~np.isfinite(rows).all(axis=1))) + 1
        raise InputError(f"{path}: joint{joint} has a number that is not finite; nothing is written")
    joints = entries.UR_JOINTS if form == "ur" else [f"joint{i + 1}" for i in range(len(rows))]
    lines = ["kinematics:"]
    for joint, row in zip(joints, rows, strict=True):
        lines.append(f"  {joint}:")
        lines += [f"    {key}: {entries.yaml_number(value)}" for key, value in zip(entries.SIX, row, strict=True)]
    return storage.write_atomically(path, with_comment("\n".join(lines) + "\n"), overwrite)


@np.errstate(over="ignore", invalid="ignore")  # absurd numbers are far from every arm
def recognise(
    kinematics: Array, names: Sequence[str], where: str, arm: Arm | None, T_joint_flange: ArrayLike | None = None
) -> Arm:
    """The nominal arm of a six-parameter table: `arm` if given, else the bundled one whose flange is nearest.

    Args:
        kinematics: (joint, 6), m and rad.
        names: the joints' names, for messages.
        where: the file, for messages.
        arm: the nominal arm, or None.
        T_joint_flange: (4, 4) the transform after the last joint in the file; None for the identity.

    Raises:
        InputError: a joint is rotated by 180 deg relative to the nearest arm; or no `arm` is given and none is near.
    """
    q = sample_joints(len(kinematics))
    links = np.stack([frames.transform_from_row(row) for row in kinematics])
    after = np.eye(4) if T_joint_flange is None else np.asarray(T_joint_flange, float)
    candidates = bundled_of(len(kinematics)) if arm is None else [arm]
    sliding = candidates[0].sliding
    points = np.stack([_flange_points(near.links, near.T_joint_flange, q, sliding) for near in candidates])

    distances = _distances(_flange_points(links, after @ candidates[0].T_joint_flange, q, sliding), points)
    nearest = int(np.argmin(distances))
    if distances[nearest] <= RECOGNISED_WITHIN:
        return candidates[nearest]
    turn = _half_turn(links, after @ candidates[0].T_joint_flange, q, points, sliding)
    if turn is not None:
        joints, axes, model, distance = turn
        places = " and ".join(
            f"{names[i]} is turned by 180° about {axis}" for i, axis in zip(joints, axes, strict=True)
        )
        raise InputError(
            f"{where}: {places}: the flange is {1e3 * distances[model]:.0f} mm RMS from a {candidates[model].name}'s,"
            f" and {1e3 * distance:.1f} mm with that turned back; read the calibration from the arm again"
        )
    if arm is not None:
        return arm
    raise InputError(
        f"{where}: fits no bundled arm; the nearest is {candidates[nearest].name},"
        f" {1e3 * distances[nearest]:.0f} mm RMS away at the flange; name the arm with --arm"
        " (a bundled one, or a description of your own)"
    )


def _flange_points(links: Array, after: Array, q: Array, sliding: tuple[int, ...]) -> Array:
    """(sample, 3, 3) the flange's origin and the points beside it, in the base frame."""
    T = frames.chain(links, q, sliding) @ after
    origin = T[:, :3, 3]
    return np.stack([origin, origin + PROBE * T[:, :3, 0], origin + PROBE * T[:, :3, 1]], axis=1)


def _distances(points: Array, candidates: Array) -> Array:
    """(candidate,) m, the RMS distance of the points over the joint positions."""
    return np.sqrt(np.mean(np.sum((candidates - points) ** 2, axis=-1), axis=(-2, -1)))


_HALF_TURNS = {"x": np.diag([1.0, -1, -1, 1]), "y": np.diag([-1.0, 1, -1, 1]), "z": np.diag([-1.0, -1, 1, 1])}


def _half_turn(
    links: Array, after: Array, q: Array, candidates: Array, sliding: tuple[int, ...]
) -> tuple[tuple[int, ...], tuple[str, ...], int, float] | None:
    """The one or two joints whose rotation by 180 deg brings the flange near a candidate: joints, axes, index, m."""
    for count in (1, 2):
        found = []
        for joints in combinations(range(len(links)), count):
            for axes in product("xyz", repeat=count):
                turned = links.copy()
                for joint, axis in zip(joints, axes, strict=True):
                    turned[joint] = turned[joint] @ _HALF_TURNS[axis]
                distances = _distances(_flange_points(turned, after, q, sliding), candidates)
                model = int(np.argmin(distances))
                found.append((float(distances[model]), joints, axes, model))
        distance, joints, axes, model = min(found)
        if distance <= RECOGNISED_WITHIN:
            return joints, axes, model, distance
    return None
