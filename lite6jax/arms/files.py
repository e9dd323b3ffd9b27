"""Files of an arm: reading one by its name or path, writing it in any form, and what a form has no place for."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from lite6jax import storage, suffixes
from lite6jax.arms import entries, frames, mjcf, urdf
from lite6jax.arms.arm import JOINT_TERMS, Arm, sample_joints
from lite6jax.arms.description import (
    arm_from_description,
    arm_from_franka,
    bundled_arms,
    is_franka,
    load_bundled,
    write_arm,
)
from lite6jax.arms.dh import is_table, write_table
from lite6jax.arms.factory import (
    FactoryCalibration,
    calibrated_arm,
    flange_offset,
    hayati_of,
    read_factory,
    write_factory,
)
from lite6jax.arms.mjcf import read_mjcf, require_mujoco, write_mjcf
from lite6jax.arms.urdf import SIZE_LIMIT, SPRINGS_LEFT_OUT, LimitKey, read_urdf, write_into_urdf, write_urdf
from lite6jax.array_types import Array
from lite6jax.errors import InputError

FileForm = Literal["vendor", "ur", "table", "urdf", "mjcf", "description", "numpy", "isaac"]

SUFFIXES: dict[FileForm, tuple[str, ...]] = {
    "vendor": suffixes.YAML,
    "ur": suffixes.YAML,
    "table": (suffixes.JSON,),
    "mjcf": (suffixes.XML, ".mjcf"),
    "urdf": (".urdf", suffixes.XML),
    "description": suffixes.YAML,
    "numpy": (suffixes.PYTHON,),
    "isaac": (suffixes.PYTHON,),
}
OF_SERVOS: tuple[FileForm, ...] = ("numpy", "isaac")
"""The forms that are of servos and hold no arm."""
WHOLE_ARM: dict[FileForm, Callable[[Arm, str | Path, bool], Path]] = {
    "description": write_arm,
    "urdf": write_urdf,
    "mjcf": write_mjcf,
}
"""The forms that hold an arm rather than its chain alone, and what writes them."""

_ROOT = re.compile(r"<([A-Za-z][\w.:-]*)")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


def read_arm(path_or_name: str | Path) -> Arm:
    """An arm by its name or its file.

    - the name of a bundled arm (`lite6`);
    - a description: YAML with `name` and `kinematics`;
    - the `kinematics.yaml` of franka_description;
    - a factory calibration, in YAML, as a JSON table or `calibration.conf`: the calibrated chain as the nominal one,
      with the limits and masses of the recognised bundled arm;
    - a URDF or an MJCF file, by its root element; `robot.urdf#tool0` names the tip link, body or site where it has
      several, and `robot.urdf#torso:tool0` the base link or body too.

    Raises:
        InputError: neither the name of a bundled arm nor a file, or as the reader of that file.
    """
    name = str(path_or_name)
    if name in bundled_arms():
        return load_bundled(name)
    file, base, tip = base_and_tip(name)
    if Path(file).suffix.lower() in suffixes.ARM_XML:
        read = read_mjcf if _is_mjcf(file) else read_urdf
        return read(file, base, tip)
    path = Path(name)
    if not storage.exists(path) and not path.suffix:
        raise InputError(f"{name}: neither a bundled arm nor a file; {entries.suggestion(name, bundled_arms())}")
    if path.suffix.lower() in suffixes.MEASUREMENTS:
        raise InputError(
            f"{name}: holds measurements and describes no arm; name a description, URDF, MJCF or table, or what "
            "`lite6jax diagnose --out` or `lite6jax fit --out` makes of it"
        )
    if path.suffix.lower() in (suffixes.JSON, suffixes.DEVIATIONS):
        return calibrated_arm(read_factory(path))
    content = storage.read_yaml(path)
    if is_table(content) or (isinstance(content, dict) and set(content) == {"kinematics"}):
        return calibrated_arm(read_factory(path))
    if is_franka(content):
        return arm_from_franka(content, str(path))
    return arm_from_description(content, str(path))


def tip_before_jaw(path: str | Path) -> str:
    """The link, body or site before the jaw in which the only chain of a URDF or MJCF file ends; else empty."""
    name = str(path)
    if "#" in name or Path(name).suffix.lower() not in suffixes.ARM_XML:
        return ""
    return mjcf.tip_before_jaw(name) if _is_mjcf(name) else urdf.tip_before_jaw(name)


def _is_mjcf(path: str) -> bool:
    """Tells whether the root of an arm's XML is MuJoCo's."""
    root = _ROOT.search(_COMMENT.sub("", storage.read_text(path, SIZE_LIMIT)))
    return root is not None and root[1] == "mujoco"


def base_and_tip(name: str) -> tuple[str, str | None, str | None]:
    """The file, the base and the tip of `robot.urdf`, `robot.urdf#tip`, `robot.urdf#base:` or `robot.urdf#base:tip`."""
    file, _, chain = name.partition("#")
    base, _, tip = chain.rpartition(":")
    return file, base or None, tip or None


def name_chain(name: str, base: str | None, tip: str | None) -> str:
    """The name of an arm's file with the base and the tip in it, as `base_and_tip` takes it apart.

    Refuses a file that is no tree, or that names them already.
    """
    if base is None and tip is None:
        return name
    file, *ends = base_and_tip(name)
    if Path(file).suffix.lower() not in suffixes.ARM_XML:
        raise InputError(f"{name}: --base and --tip choose a chain of a URDF or MJCF; leave them out")
    if any(ends):
        raise InputError(f"{name}: names base or tip already; leave out --base and --tip, or what follows #")
    return f"{file}#{base}:{tip or ''}" if base else f"{file}#{tip}"


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
    source: Arm | str | Path,
    target: str | Path,
    form: FileForm | None = None,
    nominal: Arm | None = None,
    overwrite: bool = False,
    left_out: tuple[str, ...] = (),
    into: str | Path | None = None,
    limits: Mapping[LimitKey, Array] | None = None,
) -> Conversion:
    """Writes an arm, or what a file in any form holds of one, in another form, and reads it back.

    Args:
        source: an arm; a calibration or table, a URDF, MJCF, a description, or the name of a bundled arm.
        target: the file to write.
        form: None derives it from the suffix, `.yaml` being the vendor's form of a calibration and the description of
            any other arm.
        nominal: the nominal arm of a calibration, by whose axes a table is parameterised; None for the recognised one,
            or for that of `into`. Without one an arm cannot be written in a form of its chain alone.
        overwrite: whether the target may be replaced.
        left_out: what the arm itself has no place for, a phrase each.
        into: a URDF with the names, meshes and limits of what is written, as `write_into_urdf` has it. What follows its
            last joint stays where the source is an arm.
        limits: of a URDF, as `write_urdf` has them.

    Raises:
        InputError: as the readers and writers; a suffix of another form; a flange that the form cannot represent.
    """
    target = Path(target)
    calibrated = not isinstance(source, Arm) and is_calibration(source)
    if into is not None and target.suffix.lower() not in SUFFIXES["urdf"]:
        raise InputError(f"{target}: what is written into a URDF is one; let the name end in .urdf")
    form = "urdf" if into is not None else form or form_of(target, calibrated)
    if target.suffix.lower() not in SUFFIXES[form]:
        raise InputError(f"{target}: a file of the form {form} ends in {' or '.join(SUFFIXES[form])}; rename it")
    if isinstance(source, Arm) and nominal is not None and nominal.dof != source.dof:
        raise InputError(f"{source.name}: has {source.dof} joints, but {nominal.name} has {nominal.dof}; name its arm")
    if form in OF_SERVOS:
        raise InputError(f"{target}: the form {form} is of servos; give a diagnosis of commands")
    storage.check_writable(target, overwrite)
    if form == "mjcf":  # before anything is written: it is read back
        require_mujoco(target)
    if into is not None and calibrated:
        nominal = nominal or read_arm(into)
    arm, reference = (source, nominal) if isinstance(source, Arm) else _read(source, nominal, calibrated)
    name = arm.name if isinstance(source, Arm) else source
    if into is not None:
        file, base, tip = base_and_tip(str(into))
        further = write_into_urdf(arm, file, target, base, tip, overwrite, not isinstance(source, Arm), limits)
        again = read_urdf(target, base, tip)
        written = replace(arm, T_joint_flange=again.T_joint_flange) if isinstance(source, Arm) else arm
        return Conversion(target, form, arm, (*left_out, *further), flange_distance(written, again))
    if form in WHOLE_ARM:
        if form == "urdf":
            write_urdf(arm, target, overwrite, limits)
        else:
            WHOLE_ARM[form](arm, target, overwrite)
        again = read_arm(target)
    elif reference is None:
        raise InputError(f"{target}: the form {form} holds a chain only; write {', '.join(WHOLE_ARM)}")
    else:
        if form == "table":
            parameters = hayati_of(FactoryCalibration(arm.kinematics, reference, arm.T_joint_flange, str(name)))
            write_table(reference.form, parameters, target, overwrite)
        elif beyond := flange_offset(arm.T_joint_flange, reference)[1]:
            raise InputError(
                f"{target}: a six-parameter file ends at joint {arm.dof} and cannot hold what follows it in {name}"
                f" ({beyond}); write a .json table, a .urdf or --to description"
            )
        else:
            write_factory(arm.kinematics, target, form, overwrite)
        again = calibrated_arm(read_factory(target, reference))
    phrases = (*left_out, *omissions(arm, form, calibrated))
    return Conversion(target, form, arm, phrases, flange_distance(arm, again))


def omissions(arm: Arm, form: FileForm, calibrated: bool = False) -> list[str]:
    """What of an arm a form has no place for, a phrase each; of a calibrated arm its chain alone is its own."""
    phrases = []
    if form not in WHOLE_ARM and not calibrated:
        bodies = ""
        if arm.mass is not None:
            bodies = ", masses and inertia"
            if arm.inertia is None:
                bodies = " and masses"
        drives = [term for field, term in JOINT_TERMS.items() if field in arm.drives]
        phrases += [f"joint limits{bodies}", *drives]
    if form in ("vendor", "ur") and arm.sliding:
        phrases.append("which joints are prismatic (name the arm where the file is read)")
    if form == "urdf" and arm.rotor_inertia is not None:
        phrases.append("rotor inertia")
    if form == "urdf" and arm.spring_stiffness is not None:
        phrases.append(SPRINGS_LEFT_OUT)
    if arm.dh is not None and form in ("vendor", "ur", "urdf", "mjcf"):
        phrases.append("the published DH table")
    if form == "table":
        phrases.append("where each joint's frame stands on its axis (the flange's pose does not depend on it)")
    return phrases


def is_calibration(path: str | Path) -> bool:
    """Tells whether a file is the calibration of an individual arm, valid or not, and no description of a model."""
    suffix = Path(path).suffix.lower()
    if suffix not in suffixes.YAML:
        return suffix in (suffixes.JSON, suffixes.DEVIATIONS)
    content = storage.read_yaml(path)
    return not (is_franka(content) or (isinstance(content, dict) and "name" in content))


def form_of(target: Path, calibrated: bool) -> FileForm:
    """The form of a file by its suffix, of a calibration or of another arm; refuses a suffix of no form."""
    suffix = target.suffix.lower()
    if suffix in suffixes.YAML:
        return "vendor" if calibrated else "description"
    for form, endings in SUFFIXES.items():
        if suffix in endings:
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
            f"{source}: has {arm.dof} joints, but {nominal.name} has {nominal.dof}; name another with `arm=NAME`"
        )
    return arm, nominal or replace(arm, T_joint_flange=np.eye(4))


def flange_distance(first: Arm, second: Arm) -> float:
    q = sample_joints(first.dof)
    flanges = [frames.chain(arm.links, q, arm.sliding) @ arm.T_joint_flange for arm in (first, second)]
    return float(np.linalg.norm(flanges[0][:, :3, 3] - flanges[1][:, :3, 3], axis=1).max())
