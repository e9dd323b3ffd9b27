"""Factory calibrations: the file of an individual arm's geometry, and the recognition of its model."""

import configparser
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lite6jax import storage, suffixes
from lite6jax.arms import entries, frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import DH_COLUMNS
from lite6jax.arms.description import bundled_of, maker_of
from lite6jax.arms.dh import SIZE_LIMIT, hayati_to_six_parameter, is_table, read_table, six_parameter_to_hayati
from lite6jax.array_types import Array
from lite6jax.errors import InputError, InputWarning

# m; a calibration within this RMS distance of a model is recognised as that model, of several as the nearest. A real
# xArm 7 is 8.5 mm from its nominal, and the two most similar models (UR3, UR3e) differ by 21 mm.
RECOGNISED_WITHIN = 0.05

# Deviations fit models alike whose distances differ by less than this factor, and than a millimetre.
_ALIKE = 1.5
_ALIKE_WITHIN = 1e-3

REACH_LIMIT = 100.0
"""m; far beyond any arm."""

MOST_JOINTS = 99
"""The names of more have another form."""

_PROBES = np.array([[0.0, 0.1, 0.0], [0.0, 0.0, 0.1], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
"""m, in the flange's frame: its origin and two points beside it are compared, so that its orientation matters too."""
_SAME = 1e-12
"""The tolerance of the identity, m and entries of a rotation, far below the firmware's 32-bit resolution."""


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
    """A factory calibration: YAML in the vendor's form (`joint1`, …) or Universal Robots' (`shoulder`, …), the JSON
    table of DH parameters, or `calibration.conf` of a controller of Universal Robots.

    Args:
        path: the file.
        arm: its nominal arm; None for the nearest bundled arm, or for the chain itself where no bundled arm has as many
            joints, or prismatic ones.

    Warns:
        InputWarning: the chain is taken as its own nominal arm; a table does not say its convention; or the deviations
            of `calibration.conf` fit two models alike, of which one is assumed.

    Raises:
        InputError: not such a file; joints or keys missing or unknown; a value that is not a number; degrees for
            radians, millimetres for metres; a joint rotated by 180 deg; no `arm` given and no bundled arm near; or a
            table that fits in another convention. The line names the file, the joint and the remedy.
    """
    suffix = Path(path).suffix.lower()
    if suffix == suffixes.DEVIATIONS:
        return _of_deviations(path, arm)
    if suffix != suffixes.JSON and not is_table(content := storage.read_yaml(path)):
        return factory_from(content, path, arm)
    table = read_table(path)
    kinematics, after = hayati_to_six_parameter(table.form, table.parameters)
    if table.convention is None:
        _require_standard(kinematics, after, path, arm)
    names = tuple(f"joint{i + 1}" for i in range(len(kinematics)))
    return _align(_recognise(kinematics, names, after, table.form.sliding, path, arm))


def factory_from(content: Any, path: str | Path, arm: Arm | None = None) -> FactoryCalibration:
    """The factory calibration in the `content` of a YAML file; `path` is for messages, `arm` as of `read_factory`."""
    content = entries.mapping(content, f"{path}:", ("kinematics",))
    kinematics, names, _ = entries.kinematics(content["kinematics"], str(path))
    calibration = _recognise(kinematics, names, np.eye(4), () if arm is None else arm.sliding, path, arm)
    if np.abs(kinematics[:, :3]).max() > entries.LENGTH_LIMIT:
        return _align(calibration)
    return calibration


def calibrated_arm(calibration: FactoryCalibration) -> Arm:
    """The nominal arm with the calibrated chain."""
    return replace(
        calibration.arm,
        kinematics=calibration.kinematics,
        T_joint_flange=calibration.T_joint_flange,
        dh=None,
        source=f"factory calibration {Path(calibration.source).name} of a {calibration.arm.name}",
    )


def hayati_of(calibration: FactoryCalibration) -> Array:
    """The Hayati parameters `(size,)` of a calibration, in closed form, in the order of its arm's `form`.

    The last joint's a and alpha represent the transform after that joint, relative to the nominal flange.

    Raises:
        InputError: as `six_parameter_to_hayati`; or the last joint's a and alpha cannot represent it.
    """
    arm = calibration.arm
    try:
        parameters = six_parameter_to_hayati(arm.form, calibration.kinematics, arm.hayati)
    except InputError as error:
        raise InputError(f"{calibration.source}: {error}") from error
    beyond, described = flange_offset(calibration.T_joint_flange, arm)
    if not described:
        return parameters
    if arm.sliding:
        raise InputError(
            f"{calibration.source}: a table cannot hold what follows joint {arm.dof} of an arm with prismatic joints"
            f" ({described}); write a .urdf or --to description"
        )
    a = beyond[0, 3]
    alpha = np.arctan2(beyond[2, 1], beyond[2, 2])
    if np.abs(frames.transform_from_row([a, 0, 0, alpha, 0, 0]) - beyond).max() > _SAME:
        raise InputError(
            f"{calibration.source}: a and alpha of joint {arm.dof} cannot hold what follows it ({described});"
            " write a .urdf or --to description"
        )
    for name, more in (("a", a), ("alpha", alpha)):
        parameters[arm.form.names.index(f"{name}{arm.dof}")] += more
    return parameters


def flange_offset(T_joint_flange: Array, nominal: Arm) -> tuple[Array, str]:
    """What a flange (4, 4) has beyond the nominal one, and that in words, which are empty where it is the same."""
    beyond = T_joint_flange @ np.linalg.inv(nominal.T_joint_flange)
    if np.abs(beyond - np.eye(4)).max() <= _SAME:
        return beyond, ""
    distance, angle = frames.compare_transforms(beyond, np.eye(4))
    return beyond, f"{1e3 * distance:.3g} mm, {np.rad2deg(angle):.3g}°"


def _require_standard(kinematics: Array, after: Array, path: str | Path, arm: Arm | None) -> None:
    """Refuses a table that does not say its convention and fits in the other one; warns where nothing tells."""
    candidates = bundled_of(len(kinematics)) if arm is None else [arm]
    if not candidates:
        warnings.warn(
            f'{path}: does not say its convention; standard DH is assumed, write "convention": "modified" for Craig\'s',
            InputWarning,
            stacklevel=3,
        )
        return
    if candidates[0].dof != len(kinematics) or candidates[0].sliding:
        return
    try:
        modified_table = read_table(path, entries.MODIFIED)
    except InputError:
        return
    by_modified, then = hayati_to_six_parameter(modified_table.form, modified_table.parameters)
    as_standard = _distances(frames.transform_from_row(kinematics), after, candidates).min()
    as_modified = _distances(frames.transform_from_row(by_modified), then, candidates)
    nearest = int(np.argmin(as_modified))
    if as_standard > RECOGNISED_WITHIN >= as_modified[nearest]:
        raise InputError(
            f"{path}: is {1e3 * as_standard:.0f} mm RMS from every arm as standard DH, and"
            f" {1e3 * as_modified[nearest]:.1f} mm from a {candidates[nearest].name} as modified DH (Craig's); write"
            ' "convention": "modified" into it'
        )


def _recognise(
    kinematics: Array,
    names: Sequence[str],
    T_joint_flange: Array,
    sliding: tuple[int, ...],
    path: str | Path,
    arm: Arm | None,
) -> FactoryCalibration:
    if arm is None and (sliding or not bundled_of(len(kinematics))):
        arm = Arm(Path(path).stem, kinematics, sliding=sliding, source=f"factory calibration {Path(path).name}")
        feature = f"prismatic joints, as joint {sliding[0] + 1} is" if sliding else f"{len(kinematics)} joints"
        warnings.warn(
            f"{path}: no bundled arm has {feature}, so this chain is its own nominal arm; name another with"
            " `arm=NAME` to see how it deviates",
            InputWarning,
            stacklevel=3,
        )
        return FactoryCalibration(kinematics, arm, T_joint_flange, str(path))
    if arm is not None and arm.sliding != sliding:
        raise InputError(f"{path}: has other prismatic joints than {arm.name}; name another arm with `arm=NAME`")
    if arm is not None and arm.dof != len(kinematics):
        raise InputError(
            f"{path}: has {len(kinematics)} joints, but {arm.name} has {arm.dof}; name another with `arm=NAME`"
        )
    recognised = recognise(kinematics, names, str(path), arm, T_joint_flange)
    return FactoryCalibration(kinematics, recognised, T_joint_flange @ recognised.T_joint_flange, str(path))


def _align(calibration: FactoryCalibration) -> FactoryCalibration:
    """The same chain with its frames where the nominal arm has them, along the joints' axes.

    Raises:
        InputError: lengths of no arm, by where the flange goes: single lengths cancel where axes are nearly parallel.
    """
    arm = calibration.arm
    links = frames.transform_from_row(calibration.kinematics)
    is_own_nominal = np.array_equal(arm.kinematics, calibration.kinematics)
    if is_own_nominal and np.abs(links[:, :3, 3]).max() <= entries.LENGTH_LIMIT:
        return calibration
    if not entries.is_reachable(links, REACH_LIMIT):
        raise InputError(
            f"{calibration.source}: its flange goes farther than {REACH_LIMIT:g} m from the base, farther than any"
            " arm's; correct its lengths or their unit"
        )
    kinematics = frames.row_from_transform(frames.align_frames(links, None if is_own_nominal else arm.links))
    return replace(
        calibration, kinematics=kinematics, arm=replace(arm, kinematics=kinematics) if is_own_nominal else arm
    )


def _of_deviations(path: str | Path, arm: Arm | None) -> FactoryCalibration:
    """The calibration in `calibration.conf`: deviations from the published DH table of a model that it does not name.

    Those along and about nearly parallel axes cancel only with the links of the right length, which tells the sizes
    apart; the two series of one size stay alike, and the newer is assumed.
    """
    deviations = _deviations(path)
    models = [model for model in bundled_of(6) if maker_of(model.name) == "Universal Robots"] if arm is None else [arm]
    chains = [
        (model, *frames.links_from_dh(dh + deviations)) for model in models if (dh := _published_dh(model)) is not None
    ]
    if not chains:
        raise InputError(
            f"{path}: deviates from the DH table of a model of Universal Robots, which {arm and arm.name} does not"
            " have; name one with `arm=NAME`"
        )
    distances = np.array([_distances(links, after, [model])[0] for model, links, after in chains])
    order = np.argsort(distances)
    nearest = distances[order[0]]
    chosen = chains[order[0]]
    if arm is not None and nearest > RECOGNISED_WITHIN:
        raise InputError(
            f"{path}: its deviations are not those of a {arm.name}: its flange would be {1e3 * nearest:.0f} mm RMS off"
            " nominal; name another with `arm=NAME`"
        )
    if arm is None:
        listed = [f"{chains[i][0].name} ({1e3 * distances[i]:.1f} mm)" for i in order]
        fitting_count = int(np.sum(distances <= max(_ALIKE * nearest, nearest + _ALIKE_WITHIN)))
        if nearest > RECOGNISED_WITHIN or fitting_count > 2:
            raise InputError(
                f"{path}: does not name its model, and its deviations do not tell it: the flange is off nominal by"
                f" {', '.join(listed)} RMS; name it with `arm=NAME`"
            )
        if fitting_count == 2:
            older, chosen = sorted((chains[i] for i in order[:2]), key=lambda chain: chain[0].name)
            warnings.warn(
                f"{path}: does not name its model; its deviations fit {listed[0]} and {listed[1]} RMS alike, then"
                f" {listed[2]}: a {chosen[0].name}, the newer, is assumed, name `arm={older[0].name!r}` if it is one",
                InputWarning,
                stacklevel=3,
            )
    model, links, after = chosen
    kinematics = frames.row_from_transform(links)
    return _align(FactoryCalibration(kinematics, model, after @ model.T_joint_flange, str(path)))


def _deviations(path: str | Path) -> Array:
    """(6, 4) theta, d, a, alpha in rad and m, of `calibration.conf`."""
    text = storage.read_text(path, SIZE_LIMIT)
    parser = configparser.ConfigParser(interpolation=None, inline_comment_prefixes=("#", ";"))
    try:
        parser.read_string(text)
    except configparser.Error as error:
        raise InputError(f"{path}: is no calibration.conf ({' '.join(str(error).split())}); correct it") from error
    section = next((parser[name] for name in parser.sections() if "delta_theta" in parser[name]), None)
    if section is None:
        raise InputError(f"{path}: has no delta_theta; name the calibration.conf of a controller of Universal Robots")
    columns = []
    for key in ("delta_theta", "delta_d", "delta_a", "delta_alpha"):
        if key not in section:
            raise InputError(f"{path}: lacks {key}; read the file from the controller again")
        values = [value.strip() for value in section[key].strip().strip("[]").split(",")]
        columns.append(entries.numbers(values, f"{path}: {key}", 6))
    if section.get("calibration_status", "").strip() == "0":
        warnings.warn(
            f"{path}: calibration_status is 0, not initialised: the controller does not use it",
            InputWarning,
            stacklevel=4,
        )
    return np.array(columns).T


def _published_dh(arm: Arm) -> Array | None:
    """The published DH table of an arm, or that which its chain has where this is no more than one."""
    if arm.dof != 6 or arm.sliding:
        return None
    if arm.dh is not None:
        return arm.dh
    base, links = arm.form.unpack(arm.hayati)
    if max(np.abs(base).max(), np.abs(links[:, 5]).max()) < 1e-6:
        return links[:, DH_COLUMNS]
    return None


def write_factory(kinematics: ArrayLike, path: str | Path, form: str = "vendor", overwrite: bool = False) -> Path:
    """Writes a six-parameter table as a factory file; `read_factory` returns every number exactly.

    Args:
        kinematics: `(joint, 6)`, m and rad.
        path: of the file.
        form: `vendor` (`joint1`, …; any number of joints, of whose types it says nothing) or `ur` (`shoulder`, …; 6).
        overwrite: whether a file that is there is replaced.

    Raises:
        InputError: another form or number of joints, a number that is not finite, or as `storage.write_atomically`.
    """
    rows = np.asarray(kinematics, np.float64)
    if form == "ur":
        joints = entries.UR_JOINTS
        fitting = len(rows) == 6
        expected_shape = "(6, 6)"
    elif form == "vendor":
        joints = [f"joint{i + 1}" for i in range(len(rows))]
        fitting = 0 < len(rows) <= MOST_JOINTS
        expected_shape = "(joint, 6)"
    else:
        raise InputError(f"{path}: no form {form!r} of factory files; write 'vendor' or 'ur'")
    if rows.ndim != 2 or rows.shape[1] != 6 or not fitting:
        raise InputError(
            f"{path}: the {form} form holds an array {expected_shape}, not {rows.shape}; choose another form"
        )
    if not np.isfinite(rows).all():
        joint = int(np.argmax(~np.isfinite(rows).all(axis=1))) + 1
        raise InputError(f"{path}: joint{joint} has a number that is not finite; nothing is written")
    content = {
        joint: dict(zip(entries.SIX, row.tolist(), strict=True)) for joint, row in zip(joints, rows, strict=True)
    }
    return entries.write_yaml({"kinematics": content}, path, overwrite)


def recognise(
    kinematics: Array, names: Sequence[str], where: str, arm: Arm | None, T_joint_flange: ArrayLike | None = None
) -> Arm:
    """The nominal arm of a six-parameter table (joint, 6): `arm` if given, else the bundled one whose flange is
    nearest.

    The joints' `names` and the file, `where`, are for messages. `T_joint_flange` (4, 4) follows the last joint in the
    file.

    Raises:
        InputError: a joint is rotated by 180 deg relative to the nearest arm; or no `arm` is given and none is near.
    """
    links = frames.transform_from_row(kinematics)
    after = np.eye(4) if T_joint_flange is None else np.asarray(T_joint_flange, float)
    candidates = bundled_of(len(kinematics)) if arm is None else [arm]
    distances = _distances(links, after, candidates)
    nearest = int(np.argmin(distances))
    if distances[nearest] <= RECOGNISED_WITHIN:
        return candidates[nearest]
    turn = _half_turn(links, after, candidates)
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
        f" {1e3 * distances[nearest]:.0f} mm RMS away at the flange; name the arm with `arm=NAME`"
        " (a bundled one, or a description of your own)"
    )


@np.errstate(over="ignore", invalid="ignore")  # absurd numbers are far from every arm
def _distances(links: Array, after: Array, arms: Sequence[Arm]) -> Array:
    """(..., arm) m, the RMS distance over joint positions between the flanges of chains and of arms of the same joints.

    Links are (..., joint, 4, 4), and `after` (4, 4) follows the last joint before the flange of the first arm.
    """
    flange_points = _points(links, after @ arms[0].T_joint_flange, arms[0].sliding)
    apart = (flange_points - _nominal_points(arm) for arm in arms)
    return np.stack([np.sqrt(np.sum(offset**2, (-3, -2, -1)) / (3 * flange_points.shape[-3])) for offset in apart], -1)


def _points(links: Array, T_joint_flange: Array, sliding: tuple[int, ...]) -> Array:
    """(..., sample, 3, probe) m, where chains have the points of their flange."""
    flange = frames.chain(links, frames.sample_joints(links.shape[-3]), sliding)
    return (flange @ (T_joint_flange @ _PROBES))[..., :3, :]


@lru_cache(64)
def _nominal_points(arm: Arm) -> Array:
    return _points(arm.links, arm.T_joint_flange, arm.sliding)


_HALF_TURNS = {"x": np.diag([1.0, -1, -1, 1]), "y": np.diag([-1.0, 1, -1, 1]), "z": np.diag([-1.0, -1, 1, 1])}


def _half_turn(
    links: Array, after: Array, candidates: Sequence[Arm]
) -> tuple[tuple[int, ...], tuple[str, ...], int, float] | None:
    """The one or two joints whose rotation by 180 deg brings the flange near a candidate: joints, axes, index, m."""
    for count in (1, 2):
        turns = list(product(combinations(range(len(links)), count), product("xyz", repeat=count)))
        turned = np.tile(links, (len(turns), 1, 1, 1))
        for chain, (joints, axes) in zip(turned, turns, strict=True):
            for joint, axis in zip(joints, axes, strict=True):
                chain[joint] = chain[joint] @ _HALF_TURNS[axis]
        distances = _distances(turned, after, candidates)
        nearest_turn, model = divmod(int(np.argmin(np.round(distances, 9))), len(candidates))  # of equals the first
        if distances[nearest_turn, model] <= RECOGNISED_WITHIN:
            return *turns[nearest_turn], model, float(distances[nearest_turn, model])
    return None
