"""Reading an arm by its name or path: a bundled arm, a description, a calibration, a table, a URDF or MJCF."""

import re
from dataclasses import replace
from pathlib import Path

from lite6jax import storage
from lite6jax.arms import entries
from lite6jax.arms.arm import Arm
from lite6jax.arms.bundled import bundled_arms, load_bundled
from lite6jax.arms.description import arm_from_description, read_description, write_arm
from lite6jax.arms.factory import DEVIATIONS, FactoryCalibration, read_factory, write_factory
from lite6jax.arms.mjcf import read_mjcf, write_mjcf
from lite6jax.arms.table import HayatiTable, is_table, read_table, write_table
from lite6jax.arms.urdf import read_urdf, write_urdf
from lite6jax.arms.urdf_tree import SIZE_LIMIT
from lite6jax.errors import InputError

__all__ = [
    "FactoryCalibration",
    "HayatiTable",
    "read_arm",
    "read_description",
    "read_factory",
    "read_mjcf",
    "read_table",
    "read_urdf",
    "write_arm",
    "write_factory",
    "write_mjcf",
    "write_table",
    "write_urdf",
]

_XML = (".urdf", ".xacro", ".xml", ".mjcf")
_MEASUREMENTS = (".csv", ".parquet", ".arrows", ".mcap", ".db3", ".bag", ".xlsx")
_ROOT = re.compile(r"<([A-Za-z][\w.:-]*)")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


def read_arm(path_or_name: str | Path) -> Arm:
    """An arm by its name or its file.

    - the name of a bundled arm (`lite6`);
    - a description: YAML with `name` and `kinematics`;
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
    if Path(file).suffix.lower() in _XML:
        read = read_mjcf if is_mjcf(file) else read_urdf
        return read(file, base, tip)
    path = Path(name)
    if not storage.exists(path) and not path.suffix:
        raise InputError(f"{name}: neither a bundled arm nor a file; {entries.suggestion(name, bundled_arms())}")
    if path.suffix.lower() in _MEASUREMENTS:
        raise InputError(
            f"{name}: holds measurements and describes no arm; name a description, URDF, MJCF or table, or what "
            "`lite6jax diagnose --out` or `lite6jax fit --out` makes of it"
        )
    if path.suffix.lower() in (".json", DEVIATIONS):
        return calibrated_arm(read_factory(path))
    content = storage.read_yaml(path)
    if is_table(content) or (isinstance(content, dict) and set(content) == {"kinematics"}):
        return calibrated_arm(read_factory(path))
    return arm_from_description(content, str(path))


def base_and_tip(name: str) -> tuple[str, str | None, str | None]:
    """The file, the base and the tip of `robot.urdf`, `robot.urdf#tip`, `robot.urdf#base:` or `robot.urdf#base:tip`."""
    file, _, chain = name.partition("#")
    base, _, tip = chain.rpartition(":")
    return file, base or None, tip or None


def with_chain(name: str, base: str | None, tip: str | None) -> str:
    """The name of an arm's file with the base and the tip in it, as `base_and_tip` takes it apart.

    Raises:
        InputError: of a file that is no tree, or that names them already.
    """
    if base is None and tip is None:
        return name
    file, *named = base_and_tip(name)
    if Path(file).suffix.lower() not in _XML:
        raise InputError(f"{name}: --base and --tip choose a chain of a URDF or MJCF; leave them out")
    if any(named):
        raise InputError(f"{name}: names base or tip already; leave out --base and --tip, or what follows #")
    return f"{file}#{base}:{tip or ''}" if base else f"{file}#{tip}"


def is_mjcf(path: str | Path) -> bool:
    """Whether the root element of an XML file is MuJoCo's.

    Raises:
        InputError: as `storage.read_text`.
    """
    root = _ROOT.search(_COMMENT.sub("", storage.read_text(path, SIZE_LIMIT)))
    return root is not None and root[1] == "mujoco"


def calibrated_arm(calibration: FactoryCalibration) -> Arm:
    """The nominal arm with the calibrated chain."""
    return replace(
        calibration.arm,
        kinematics=calibration.kinematics,
        T_joint_flange=calibration.T_joint_flange,
        dh=None,
        source=f"factory calibration {Path(calibration.source).name} of a {calibration.arm.name}",
    )
