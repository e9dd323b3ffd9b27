"""Conversion of an arm's file to another form, and the parts that the new form cannot represent."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lite6jax import storage
from lite6jax.arms import convert, frames
from lite6jax.arms.arm import JOINT_TERMS, Arm, sample_joints
from lite6jax.arms.factory import DEVIATIONS, FactoryCalibration, read_factory, write_factory
from lite6jax.arms.files import (
    base_and_tip,
    calibrated_arm,
    read_arm,
    read_urdf,
    write_arm,
    write_mjcf,
    write_table,
    write_urdf,
)
from lite6jax.arms.urdf_edit import SPRINGS_LEFT_OUT, write_into_urdf
from lite6jax.errors import InputError

Array = NDArray[np.floating]
FileForm = Literal["vendor", "ur", "table", "urdf", "mjcf", "description"]

SUFFIXES: dict[FileForm, tuple[str, ...]] = {
    "vendor": (".yaml", ".yml"),
    "ur": (".yaml", ".yml"),
    "table": (".json",),
    "mjcf": (".xml", ".mjcf"),
    "urdf": (".urdf", ".xml"),
    "description": (".yaml", ".yml"),
}
WHOLE_ARM: dict[FileForm, Callable[[Arm, str | Path, bool], Path]] = {
    "description": write_arm,
    "urdf": write_urdf,
    "mjcf": write_mjcf,
}
"""The forms that hold an arm rather than its chain alone, and what writes them."""
_SAME = 1e-12
"""The tolerance of the identity, m and entries of a rotation, far below the firmware's 32-bit resolution."""


@dataclass(frozen=True)
class Conversion:
    """The result of a conversion.

    Attributes:
        path: the file written.
        form: its form.
        arm: the arm that was read.
        left_out: the parts that the new form cannot represent, a phrase each.
        difference: m, the largest distance between the flange positions of the source and of the written file.
    """

    path: Path
    form: FileForm
    arm: Arm
    left_out: tuple[str, ...]
    difference: float


def convert_file(
    source: str | Path,
    target: str | Path,
    form: FileForm | None = None,
    nominal: Arm | None = None,
    overwrite: bool = False,
) -> Conversion:
    """Reads an arm in any form and writes it in another.

    Args:
        source: a calibration or table, a URDF, MJCF, a description, or the name of a bundled arm.
        target: the file to write.
        form: of the target; None derives it from the suffix, `.yaml` being the vendor's form of a calibration and
            the description of any other arm.
        nominal: the nominal arm of a calibration; None for the recognised one.
        overwrite: whether the target may be replaced.

    Raises:
        InputError: as the readers and writers; a suffix of another form; a flange that the form cannot represent.
    """
    target = Path(target)
    calibrated = is_calibration(source)
    form = form or form_of(target, calibrated)
    if target.suffix.lower() not in SUFFIXES[form]:
        raise InputError(f"{target}: a file of the form {form} ends in {' or '.join(SUFFIXES[form])}; rename it")
    storage.check_writable(target, overwrite)
    arm, reference = _read(source, nominal, calibrated)
    beyond = arm.T_joint_flange @ np.linalg.inv(reference.T_joint_flange)
    left_out: list[str] = []
    if form in ("vendor", "ur"):
        if not _is_identity(beyond):
            raise InputError(
                f"{target}: a six-parameter file ends at joint {arm.dof} and cannot hold what follows it in {source}"
                f" ({_described(beyond)}); write a .json table, a .urdf or --to description"
            )
        write_factory(arm.kinematics, target, form, overwrite)
    elif form == "table":
        parameters = hayati_of(FactoryCalibration(arm.kinematics, reference, arm.T_joint_flange, str(source)))
        write_table(reference.form, parameters, target, overwrite)
        left_out.append("where each joint's frame stands on its axis (the flange's pose does not depend on it)")
    else:
        export_arm(arm, target, form, overwrite)
    left_out += left_out_of(arm, form, calibrated)
    again = _read(target, None if form in WHOLE_ARM else reference, is_calibration(target))[0]
    return Conversion(target, form, arm, tuple(left_out), _distance(arm, again))


def export_arm(arm: Arm, path: str | Path, form: FileForm | None = None, overwrite: bool = False) -> Path:
    """Writes all that an arm holds and the form has a place for; `left_out_of` says what it has none for.

    Args:
        arm: the arm.
        path: the file to write.
        form: description, urdf or mjcf; None derives it from the suffix: `.yaml`, `.urdf`, `.xml` (MJCF).
        overwrite: whether the file may be replaced.

    Raises:
        InputError: another form or suffix, or as the writers.
    """
    form = form or form_of(Path(path), calibrated=False)
    if form not in WHOLE_ARM:
        raise InputError(f"{path}: the form {form} holds a chain only; write {', '.join(WHOLE_ARM)}")
    return WHOLE_ARM[form](arm, path, overwrite)


def export_file(
    arm: Arm,
    target: str | Path,
    form: FileForm | None = None,
    overwrite: bool = False,
    left_out: tuple[str, ...] = (),
    nominal: Arm | None = None,
) -> Conversion:
    """As `export_arm`, read back; as a table of its chain where the nominal arm is known.

    Args:
        arm, target, form, overwrite: as of `export_arm`.
        left_out: what the arm itself has no place for, a phrase each.
        nominal: by whose axes a table is parameterised.

    Raises:
        InputError: as `export_arm`; a table without a nominal arm.
    """
    form = form or form_of(Path(target), calibrated=False)
    if form == "table" and nominal is not None:
        calibration = FactoryCalibration(arm.kinematics, nominal, arm.T_joint_flange, arm.name)
        table = write_table(nominal.form, hayati_of(calibration), target, overwrite)
        again = _read(table, nominal, True)[0]
        return Conversion(table, form, arm, (*left_out, *left_out_of(arm, form)), _distance(arm, again))
    path = export_arm(arm, target, form, overwrite)
    again = read_arm(str(target))
    return Conversion(path, form, arm, (*left_out, *left_out_of(arm, form)), _distance(arm, again))


def export_into(
    arm: Arm | str | Path,
    robot: str | Path,
    target: str | Path,
    overwrite: bool = False,
    left_out: tuple[str, ...] = (),
    with_flange: bool = True,
    nominal: Arm | None = None,
) -> Conversion:
    """As `write_into_urdf`, read back.

    Args:
        arm: what it does not know stays as the file has it; or the file that it is read from.
        robot: an existing URDF; `robot.urdf#tool0` names the tip link where it has several, `robot.urdf#torso:tool0`
            the base link too.
        target: the file to write.
        overwrite: whether the target may be replaced.
        left_out: what the arm itself has no place for, a phrase each.
        with_flange: whether what follows the last joint changes.
        nominal: the nominal arm of a calibration; None for that of `robot`.

    Raises:
        InputError: as `write_into_urdf` and the readers; a target of another suffix.
    """
    if Path(target).suffix.lower() not in SUFFIXES["urdf"]:
        raise InputError(f"{target}: what is written into a URDF is one; let the name end in .urdf")
    file, base, tip = base_and_tip(str(robot))
    if not isinstance(arm, Arm):
        calibrated = is_calibration(arm)
        arm, _ = _read(arm, (nominal or read_arm(robot)) if calibrated else nominal, calibrated)
    path, further = write_into_urdf(arm, file, target, base, tip, overwrite, with_flange)
    again = read_urdf(path, base, tip)
    written = arm if with_flange else replace(arm, T_joint_flange=again.T_joint_flange)
    return Conversion(path, "urdf", arm, (*left_out, *further), _distance(written, again))


def left_out_of(arm: Arm, form: FileForm, calibrated: bool = False) -> list[str]:
    """What of an arm a form has no place for, a phrase each; of a calibrated arm its chain alone is its own."""
    phrases = []
    drives = [what for field, what in JOINT_TERMS.items() if getattr(arm, field) is not None]
    if form not in WHOLE_ARM and not calibrated:
        bodies = "" if arm.mass is None else " and masses" if arm.inertia is None else ", masses and inertia"
        phrases += [f"joint limits{bodies}", *drives]
    if form in ("vendor", "ur") and arm.sliding:
        phrases.append("which joints are prismatic (name the arm with --arm where the file is read)")
    if form == "urdf" and arm.rotor_inertia is not None:
        phrases.append("rotor inertia")
    if form == "urdf" and arm.spring_stiffness is not None:
        phrases.append(SPRINGS_LEFT_OUT)
    if arm.dh is not None and form in ("vendor", "ur", "urdf", "mjcf"):
        phrases.append("the published DH table")
    return phrases


def is_calibration(path: str | Path) -> bool:
    """Whether a file is the calibration of an individual arm, valid or not, rather than the description of a model.

    Raises:
        InputError: as `storage.read_yaml`.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".yaml", ".yml"):
        return suffix in (".json", DEVIATIONS)
    content = storage.read_yaml(path)
    return not (isinstance(content, dict) and "name" in content)


def hayati_of(calibration: FactoryCalibration) -> Array:
    """The Hayati parameters `(size,)` of a calibration, in closed form, in the order of its arm's `form`.

    The last joint's a and alpha represent the transform after that joint, relative to the nominal flange.

    Raises:
        InputError: as `convert.six_parameter_to_hayati`; or the last joint's a and alpha cannot represent it.
    """
    arm = calibration.arm
    try:
        parameters = convert.six_parameter_to_hayati(arm.form, calibration.kinematics, arm.hayati)
    except InputError as error:
        raise InputError(f"{calibration.source}: {error}") from error
    beyond = calibration.T_joint_flange @ np.linalg.inv(arm.T_joint_flange)
    if _is_identity(beyond):
        return parameters
    if arm.sliding:
        raise InputError(
            f"{calibration.source}: a table cannot hold what follows joint {arm.dof} of an arm with prismatic joints"
            f" ({_described(beyond)}); write a .urdf or --to description"
        )
    a, alpha = beyond[0, 3], np.arctan2(beyond[2, 1], beyond[2, 2])
    if not _is_identity(np.linalg.inv(frames.transform_from_row([a, 0, 0, alpha, 0, 0])) @ beyond):
        raise InputError(
            f"{calibration.source}: a and alpha of joint {arm.dof} cannot hold what follows it ({_described(beyond)});"
            " write a .urdf or --to description"
        )
    base, dh, beta = (np.array(part) for part in arm.form.unpack(parameters))
    dh[-1, 2:] += a, alpha
    return np.asarray(arm.form.pack(base, dh, beta), float)


def form_of(target: Path, calibrated: bool) -> FileForm:
    """The form of a file by its suffix, of a calibration or of another arm.

    Raises:
        InputError: a suffix of no form.
    """
    suffix = target.suffix.lower()
    if suffix in (".yaml", ".yml"):
        return "vendor" if calibrated else "description"
    for form, suffixes in SUFFIXES.items():
        if suffix in suffixes:
            return form
    raise InputError(
        f"{target}: no form has this suffix; write .yaml, .json, .urdf or .xml, or name the form with --to"
    )


def _read(source: str | Path, nominal: Arm | None, calibrated: bool) -> tuple[Arm, Arm]:
    """The arm with its own chain, and the nominal arm, whose flange and branch a reader of the new file assumes."""
    if calibrated:
        calibration = read_factory(source, nominal)
        return calibrated_arm(calibration), calibration.arm
    arm = read_arm(source)
    if nominal is not None and nominal.dof != arm.dof:
        raise InputError(
            f"{source}: has {arm.dof} joints, but {nominal.name} has {nominal.dof}; name another with --arm"
        )
    return arm, nominal or replace(arm, T_joint_flange=np.eye(4))


def _distance(one: Arm, other: Arm) -> float:
    q = sample_joints(one.dof)
    flanges = [frames.chain(arm.links, q, arm.sliding) @ arm.T_joint_flange for arm in (one, other)]
    return float(np.linalg.norm(flanges[0][:, :3, 3] - flanges[1][:, :3, 3], axis=1).max())


def _is_identity(T: Array) -> bool:
    return bool(np.abs(T - np.eye(4)).max() <= _SAME)


def _described(T: Array) -> str:
    angle = np.rad2deg(2 * np.arcsin(min(np.linalg.norm(T[:3, :3] - np.eye(3)) / np.sqrt(8), 1.0)))
    return f"{1e3 * np.linalg.norm(T[:3, 3]):.3g} mm, {angle:.3g}°"
