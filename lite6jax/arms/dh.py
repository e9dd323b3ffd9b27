"""DH parameters: six-parameter chains as Hayati chains and back, in closed form, and the table of the latter.

The conversion takes the joints' axes as lines. It involves no fit, so that it is an independent check of the fit. The
numbers of a table are decimal and those of the program binary: both conversions, by 1000 and by pi / 180, are done on
decimals and rounded once, so that reading a table returns the floats that were written.
"""

import json
import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax import storage, suffixes
from lite6jax.arms import entries, frames
from lite6jax.arms.chains import BASE, DH_COLUMNS, LINK, PARALLEL_WITHIN, HayatiForm, hayati_form_of
from lite6jax.array_types import Array, Mask
from lite6jax.errors import InputError, InputWarning, command_line

Irregular = list[tuple[Mask, str]]

_UPRIGHT = np.cos(np.deg2rad(85.0))
_PARALLEL = np.sin(np.deg2rad(30.0))
"""Sine of the angle of two axes beyond which they are not parallel, whatever a form says."""
_TIE = -1e-12
"""Of the cosine of a deviation of 90°: of two opposite directions that one is kept which the formula gives."""


def six_parameter_to_hayati(form: HayatiForm, kinematics: ArrayLike, nominal: ArrayLike | None = None) -> np.ndarray:
    """The Hayati parameters of a six-parameter chain.

    Each DH row has two solutions, for the two directions of the common normal. The result is the one closest to
    `nominal`, or without it the one with theta_off within ±90°. Parameters of arms are comparable with the same
    `nominal` only.

    Args:
        form: the Hayati form.
        kinematics: `(joint, 6)`, or many arms `(arm, joint, 6)`; m and rad.
        nominal: `(size,)`, the parameters that determine the branch.

    Returns:
        `(size,)` or `(arm, size)`, in the order of `form.names`.

    Raises:
        InputError: joint 1 is revolute and its axis at right angles to the base's axis `form.first_axis`; axes that are
            parallel in the form are not in the chain, or the reverse; or parallel axes coincide.
    """
    kinematics = np.asarray(kinematics, float)
    if kinematics.shape[-2:] != (form.dof, 6):
        raise InputError(f"kinematics of shape {kinematics.shape}: this form takes ({form.dof}, 6)")
    if not np.isfinite(kinematics).all():
        raise InputError("kinematics: every number must be finite")
    parameters, irregular = closed_form(form, kinematics.reshape(-1, form.dof, 6), nominal)
    for wrong, message in irregular:
        if wrong.any():
            raise InputError(("" if kinematics.ndim == 2 else f"kinematics[{np.argmax(wrong)}]: ") + message)
    return parameters.reshape(*kinematics.shape[:-2], form.size)


@np.errstate(all="ignore")  # of what is irregular
def closed_form(form: HayatiForm, kinematics: Array, nominal: ArrayLike | None = None) -> tuple[Array, Irregular]:
    """Parameters `(arm, size)` of chains `(arm, joint, 6)`, closest to `nominal` `(size,)`.

    The DH frame moves from joint to joint along the common normal, or where axes are parallel within its x-y plane.

    Returns:
        the parameters, meaningless where a chain is irregular; and `(arm,)` which are, with why, for each way to be.
    """
    near_base, near = (np.zeros(6), np.zeros((form.dof, 6))) if nominal is None else form.unpack(nominal)
    joints = frames.frames_at_zero(kinematics)
    base, irregular = _base(form, joints[:, 0], near_base[BASE.index("yaw")])
    H = frames.transform_from_row(base[:, [BASE.index(name) for name in entries.SIX]]) @ form.T_axes
    links = np.zeros((len(kinematics), form.dof, len(LINK)))
    for i, guess in enumerate(near):
        last = i == form.dof - 1
        parallel = i in form.parallel
        names = form.of_link(i)
        to_joint = joints[:, i if last else i + 1]
        offset = to_joint[:, :3, 3] - H[:, :3, 3]
        x, u, p = (np.einsum("aji,aj->ia", H[:, :3, :3], v) for v in (to_joint[:, :3, 0], to_joint[:, :3, 2], offset))
        foot = p - p[2] / u[2] * u  # where the next axis meets this frame's x-y plane
        if last:
            theta = _nearest_turn(np.arctan2(x[1], x[0]), guess[0])
        elif "theta_off" in names:
            normal = foot if parallel else (-u[1], u[0])
            theta = _nearest_direction(np.arctan2(normal[1], normal[0]), guess[0])
        else:
            theta = np.zeros_like(p[0])
        c = np.cos(theta)
        s = np.sin(theta)
        # in the frame turned by theta u is (sin β, −sin α cos β, cos α cos β); β is zero where axes are not parallel
        across = c * u[0] + s * u[1]
        sine = s * u[0] - c * u[1]
        at = foot if parallel else p
        opposite = nominal is None and parallel and not last
        link_parameters = {
            "theta_off": theta,
            "d": p[2] if last else p[2] + u[2] * (c * p[1] - s * p[0]) / sine,
            "a": c * at[0] + s * at[1],
            "b": c * at[1] - s * at[0],
            "alpha": _nearest_turn(np.arctan2(sine, u[2]), np.where(u[2] < 0, np.pi, 0.0) if opposite else guess[4]),
            "beta": np.arctan2(across, np.hypot(sine, u[2])),
        }
        if last and "b" not in names:
            names = ("theta_off", "d")  # a frame about the same axis
        for name in names:
            links[:, i, LINK.index(name)] = link_parameters[name]
        if not last:
            irregular += _irregular_pair(form, i, np.hypot(u[0], u[1]), np.hypot(foot[0], foot[1]))
        along, beyond = _link_transforms(links[:, i])
        H = H @ along @ beyond
    return form.pack(base, links), irregular


def _irregular_pair(form: HayatiForm, i: int, sine: Array, distance: Array) -> Irregular:
    """What is irregular about the axes of joints i and i + 1, by the sine of their angle and the second's distance."""
    pair = f"joints {i + 1} and {i + 2}: their axes"
    if i not in form.parallel:
        return [(sine < 1e-6, f"{pair} are parallel, which this form does not expect; add {i} to `parallel`")]
    irregularities = [(sine > _PARALLEL, f"{pair} are not parallel as this form expects; check the arm's model")]
    if "theta_off" in form.of_link(i):
        message = f"{pair} coincide, so the two joints are indistinguishable; remove one"
        irregularities.append((distance < 1e-4, message))
    return irregularities


def _base(form: HayatiForm, joint: Array, near_yaw: float) -> tuple[Array, Irregular]:
    """The bases `(arm, 6)`, `BASE`, that lead to frames of joint 1 `(arm, 4, 4)`."""
    names = form.of_link(-1)
    k = form.first_axis
    u = joint[:, :3, 2].T
    coordinates: dict[str, Array] = {}
    irregular: Irregular = []
    if 0 not in form.sliding:
        message = f"joint 1: its axis is at right angles to the base's {'xyz'[k]}, along which this form draws it;"
        irregular.append((np.abs(u[k]) < _UPRIGHT, f"{message} check the arm's model"))
        coordinates |= zip("xyz", joint[:, :3, 3].T - joint[:, k, 3] / u[k] * u, strict=True)
    if 0 in form.sliding and "yaw" in names:  # Rz(yaw) Rx(roll) takes z to u
        yaw = _nearest_direction(np.arctan2(u[0], -u[1]), near_yaw)
        coordinates |= {"yaw": yaw, "roll": np.arctan2(np.sin(yaw) * u[0] - np.cos(yaw) * u[1], u[2])}
    elif k == 0:  # Rz(yaw) Ry(pitch) takes x to u
        coordinates |= {"yaw": np.arctan2(u[1], u[0]), "pitch": -np.arcsin(u[2])}
    elif k == 1:  # Rz(yaw) Rx(roll) takes y to u
        coordinates |= {"yaw": np.arctan2(-u[0], u[1]), "roll": np.arcsin(u[2])}
    else:  # Ry(pitch) Rx(roll) takes z to u
        coordinates |= {"pitch": np.arctan2(u[0], u[2]), "roll": -np.arcsin(u[1])}
    nothing = np.zeros(len(joint))
    return np.stack([coordinates[name] if name in names else nothing for name in BASE], 1), irregular


def _nearest_direction(angle: Array, near: Array | float) -> Array:
    """The angle of a line's direction or of its opposite, by whole turns, whichever is nearest to `near`."""
    return _nearest_turn(np.where(np.cos(angle - near) < _TIE, angle + np.pi, angle), near)


def _nearest_turn(angle: Array, near: Array | float) -> Array:
    return angle + 2 * np.pi * np.round((near - angle) / (2 * np.pi))


def _link_transforms(links: Array) -> tuple[Array, Array]:
    """Rz(theta_off) Tz(d), and Tx(a) Ty(b) Rx(alpha) Ry(beta), of links `(..., 6)`, `LINK`; `(..., 4, 4)` each."""
    theta, d, a, b, alpha, beta = np.moveaxis(links, -1, 0)
    o = np.zeros_like(theta)
    rows = [(o, o, d, o, o, theta), (a, b, o, alpha, o, o), (o, o, o, o, beta, o)]
    along, across, tilt = frames.transform_from_row(np.stack([np.stack(row, -1) for row in rows]))
    return along, across @ tilt


def hayati_to_six_parameter(form: HayatiForm, parameters: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """The six-parameter chain of Hayati parameters, exactly.

    Args:
        form: the Hayati form.
        parameters: `(size,)` m and rad, in the order of `form.names`.

    Returns:
        kinematics `(joint, 6)` m and rad, and `T_joint_flange` `(4, 4)`, the last joint's a and alpha, or a and b: a
        six-parameter chain ends at the last joint and does not contain them.
    """
    base, links = form.unpack(parameters)
    along, beyond = _link_transforms(links)
    before = frames.transform_from_row(base[[BASE.index(name) for name in entries.SIX]]) @ form.T_axes
    return frames.row_from_transform(np.concatenate([[before], beyond[:-1]]) @ along), beyond[-1]


UNITS = "mm and deg"
SIZE_LIMIT = 1 << 20
FIT = ("result", "quality", "checked_position_rms_m")
"""Of the fit that a table is from: how it ended, whether it describes its data, its error on data not fitted."""
LENGTH_LIMIT = 1e4
"""m; beyond the common normal of any axes whose angle is known: what counts is where they lead the flange."""
ANGLE_LIMIT = 4 * math.pi
"""rad; no table counts more turns than two."""
_PRISMATIC = entries.TYPES[1]
_LENGTHS = ("x", "y", "z", "d", "a", "b")
_UNITS = (
    {"mm": ("mm", "millimetres", "millimeters"), "m": ("m", "metres", "meters")},
    {"deg": ("deg", "degrees", "°"), "rad": ("rad", "radians")},
)
"""Words for the units of lengths and of angles."""
_EXACT = Context(prec=60)
_DEGREE = _EXACT.divide(Decimal("3.14159265358979323846264338327950288419716939937510582097494459"), Decimal(180))
_BETA = re.compile(r"beta_joint([1-9][0-9]?)")
_Read = Callable[[str, Any, str], float]
"""The number of a key, in m or rad, of a value at a place."""


@dataclass(frozen=True, eq=False)
class HayatiTable:
    """Hayati parameters with their form.

    Attributes:
        form: the parameterisation.
        parameters: (size,) in the order of `form`, m and rad.
        convention: `standard` or `modified`, as the table says; None where it does not and could be either.
    """

    form: HayatiForm
    parameters: NDArray[np.float64]
    convention: str | None = entries.STANDARD


def read_table(path: str | Path, convention: str | None = None) -> HayatiTable:
    """A table of DH parameters, in JSON or in YAML with the same keys.

    ```json
    {"units": "mm and deg", "convention": "standard",
     "base": {"x": 0.0, "y": 0.0, "z": 0.0, "roll": 0.0, "pitch": 0.0, "yaw": 0.0},
     "dh": [{"joint": 1, "theta_off": 0.0, "d": 243.3, "a": 0.0, "alpha": -90.0}],
     "beta_joint2": 0.0}
    ```

    `units` are mm or m, and deg or rad. `dh` has one row per joint, and `beta_jointK` is of a joint that is nominally
    parallel to the next, whose d is zero. With `"convention": "modified"` the rows are Craig's, and there is no beta; a
    table that says no convention is read in the one that is given, or as standard. Of the base, zero where not given,
    nothing is along and about `first_axis`, z where not given. A row of a prismatic joint has `"type": "prismatic"`,
    and rows then have `b`. A table of a fit may have `fit` with the keys `FIT`.

    Raises:
        InputError: not such a table; the line names the file, the place and the remedy.

    Warns:
        InputWarning: the table is from a fit that does not describe its data.
    """
    by_yaml = Path(path).suffix.lower() in suffixes.YAML
    text = json.dumps(storage.read_yaml(path), default=str) if by_yaml else storage.read_text(path, SIZE_LIMIT)
    content = _parse(text, path)
    if "schema" in content:
        shown = command_line("report", path)
        raise InputError(f"{path}: holds results ({str(content['schema'])[:40]}); `{shown}` shows them")
    betas = {key: int(match[1]) for key in content if isinstance(key, str) and (match := _BETA.fullmatch(key))}
    further = (*(betas or ("beta_joint2",)), "convention", "first_axis", "fit")
    entries.mapping(content, f"{path}:", ("units", "dh"), ("base", *further))
    read = _reader(content["units"], f"{path}: units")
    rows = content["dh"]
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: dh must be a list with one row per joint: joint, theta_off, d, a, alpha")
    stated_convention = entries.convention(content.get("convention"), f"{path}: convention")
    if betas and stated_convention == entries.MODIFIED:
        raise InputError(f"{path}: {next(iter(betas))} is of standard DH, and convention says modified; keep one")
    sliding = tuple(i for i, row in enumerate(rows) if isinstance(row, dict) and row.get("type") == _PRISMATIC)
    base, first = _table_base(content, path, 0 in sliding, read)
    links = np.array([_table_row(row, f"{path}: dh row {i}", i, bool(sliding), read) for i, row in enumerate(rows, 1)])
    for key, joint in betas.items():
        if joint >= len(rows):
            raise InputError(
                f"{path}: {key} is for a joint that no other follows: dh has {len(rows)} row{'s' * (len(rows) != 1)};"
                " give one row per joint, or remove it"
            )
        if links[joint - 1, 1] != 0:
            raise InputError(f"{path}: dh row {joint}: d is not zero beside {key}; the form has either, set d to 0")
        links[joint - 1, 5] = read(key, content[key], str(path))
    try:
        if (stated_convention or convention) == entries.MODIFIED:
            form, parameters = _modified_table(base, links, sliding)
        else:
            parallel = sorted(joint - 1 for joint in betas.values())
            if 0 in sliding and np.cos(base[5]) * np.cos(base[4]) > np.cos(PARALLEL_WITHIN):
                parallel.insert(0, -1)
            form = HayatiForm(len(rows), tuple(parallel), sliding, first)
            parameters = form.pack(base, links)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    _check_fit(content.get("fit"), f"{path}: fit")
    sure = betas or sliding  # what only the standard form has
    return HayatiTable(
        form, np.asarray(parameters, np.float64), stated_convention or (entries.STANDARD if sure else None)
    )


def _table_base(content: Mapping[str, Any], path: str | Path, slides: bool, read: _Read) -> tuple[list[float], int]:
    """`BASE`, and the axis of the base along which joint 1's is drawn; `slides` says whether it is prismatic."""
    base = entries.mapping(content.get("base", dict.fromkeys(entries.SIX, Decimal(0))), f"{path}: base", entries.SIX)
    axis = content.get("first_axis", "z")
    if axis not in ("x", "y", "z") or (slides and axis != "z"):
        raise InputError(
            f"{path}: first_axis is {str(axis)[:40]!r}; write x, y or z, the base's axis nearest to joint 1's"
        )
    first = "xyz".index(axis)
    for key, instead in ((axis, "d"), *(() if slides else ((("roll", "pitch", "yaw")[first], "theta_off"),))):
        if _decimal(base[key], f"{path}: base: {key}") != 0:
            raise InputError(
                f"{path}: base: {key} is not zero, which this form has no place for; add it to {instead} of joint 1"
            )
    return [read(key, base[key], f"{path}: base") for key in BASE], first


def _modified_table(base: list[float], links: Array, sliding: tuple[int, ...]) -> tuple[HayatiForm, Array]:
    """A table of modified DH in Hayati's form."""
    if sliding:
        raise InputError("modified DH with a prismatic joint; write the arm as a description or URDF")
    chain, _ = frames.links_from_dh(links[:, DH_COLUMNS], entries.MODIFIED)
    chain[0] = frames.transform_from_row([base[BASE.index(key)] for key in entries.SIX]) @ chain[0]
    kinematics = frames.row_from_transform(chain)
    form = hayati_form_of(kinematics)
    return form, six_parameter_to_hayati(form, kinematics)


def is_table(content: Any) -> bool:
    """Tells whether the parsed content of a file means to be a table."""
    return isinstance(content, dict) and {"units", "dh"} <= content.keys()


def write_table(
    form: HayatiForm,
    parameters: ArrayLike,
    path: str | Path,
    overwrite: bool = False,
    fit: Mapping[str, Any] | None = None,
) -> Path:
    """Writes Hayati parameters `(size,)`, m and rad, as a table; `read_table` returns every float exactly.

    `fit` is what is to be said of the fit that they are from, under the keys `FIT`.

    Raises:
        InputError: parameters of the wrong size or not finite, or as `storage.write_atomically`.
    """
    values = np.asarray(parameters, np.float64)
    if values.shape != (form.size,) or not np.isfinite(values).all():
        raise InputError(f"{path}: a table of this form needs {form.size} finite numbers, not an array {values.shape}")
    base, links = form.unpack(values)
    shown = [name for name in LINK[:-1] if form.sliding or name != "b"]
    rows = []
    for i, link in enumerate(links):
        kind = f'"type": "{_PRISMATIC}", ' if i in form.sliding else ""
        numbers = _json_entries({name: link[LINK.index(name)] for name in shown})
        rows.append(f'    {{"joint": {i + 1}, {kind}{numbers}}}')
    by_name = {name: base[BASE.index(name)] for name in entries.SIX}
    betas = {f"beta_joint{i + 1}": links[i, 5] for i in form.parallel if i >= 0}
    parts = [
        f'  "units": "{UNITS}"',
        *([] if betas or form.sliding else [f'  "convention": "{entries.STANDARD}"']),
        *([] if form.first_axis == 2 else [f'  "first_axis": "{"xyz"[form.first_axis]}"']),
        f'  "base": {{{_json_entries(by_name)}}}',
        '  "dh": [\n' + ",\n".join(rows) + "\n  ]",
        *(f"  {_json_entries({name: beta})}" for name, beta in betas.items()),
        *([] if fit is None else [f'  "fit": {json.dumps(dict(fit), allow_nan=False)}']),
    ]
    return storage.write_atomically(path, "{\n" + ",\n".join(parts) + "\n}\n", overwrite)


def _json_entries(numbers: Mapping[str, float]) -> str:
    """Entries of JSON, in mm and degrees, that are read as exactly these floats of m and rad."""
    return ", ".join(
        f'"{name}": {_plain(Decimal(repr(float(value))).scaleb(3, _EXACT) if name in _LENGTHS else _degrees(value))}'
        for name, value in numbers.items()
    )


def _degrees(angle: float) -> Decimal:
    """The shortest decimal that is read as this float of radians."""
    exact = _EXACT.divide(Decimal(float(angle)), _DEGREE)
    candidates = (Context(prec=digits).create_decimal(exact) for digits in range(15, 40))
    return next(degrees for degrees in candidates if float(_EXACT.multiply(degrees, _DEGREE)) == angle)


def _plain(value: Decimal) -> str:
    """A decimal in JSON with its point, so that every reader reads it as a float."""
    value = value.normalize(_EXACT)
    mantissa, _, power = (format(value, "f") if -7 <= value.adjusted() < 16 else str(value)).partition("E")
    if "." not in mantissa:
        mantissa = f"{mantissa}.0"
    return f"{mantissa}e{power}" if power else mantissa


def _parse(text: str, path: str | Path) -> dict[str, Any]:
    def unique(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
        """An object, of which `json` would drop the first of two equal keys."""
        keys = [key for key, _ in pairs]
        if len(set(keys)) < len(keys):
            twice = next(key for i, key in enumerate(keys) if key in keys[:i])
            raise InputError(f"{path}: the key {twice!r} is given twice; keep one")
        return dict(pairs)

    try:
        content = json.loads(
            text, parse_float=Decimal, parse_int=Decimal, parse_constant=Decimal, object_pairs_hook=unique
        )
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: line {error.lineno}: not valid JSON ({error.msg}); correct the file") from error
    except (RecursionError, ArithmeticError) as error:
        raise InputError(
            f"{path}: not valid JSON (nested too deeply or a malformed number); correct the file"
        ) from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: must be a JSON object with the keys units, base, dh and beta_joint2")
    return content


def _table_row(value: Any, where: str, joint: int, slides: bool, read: _Read) -> list[float]:
    """`LINK`, beta zero; `slides` says whether the chain has a prismatic joint."""
    optional = ("type", "b") if slides else ("type",)
    row = entries.mapping(value, where, ("joint", "theta_off", "d", "a", "alpha"), optional)
    if (kind := row.get("type", entries.TYPES[0])) not in entries.TYPES:
        raise InputError(f"{where}: type is {str(kind)[:40]!r}; write {' or '.join(entries.TYPES)}")
    if _decimal(row["joint"], f"{where}: joint") != joint:
        raise InputError(f"{where}: is for joint {row['joint']}; list the joints in order, 1, 2, …")
    return [*(read(key, row.get(key, Decimal(0)), where) for key in LINK[:-1]), 0.0]


def _decimal(value: Any, where: str) -> Decimal:
    if not isinstance(value, Decimal):
        raise InputError(
            f"{where} is {json.dumps(value, default=str)[:40]}, which is not a number; write a plain number"
        )
    if not math.isfinite(value) or abs(value.adjusted()) > 10_000:
        raise InputError(f"{where} is {value:.6g}, which is not finite; read the table from its source again")
    return value


def _reader(units: Any, where: str) -> _Read:
    """How the numbers of a table are read, by words such as `mm and deg`, `mm,deg` or `m, rad`."""
    words = []
    if isinstance(units, str):
        words = re.split(r"\s*(?:,|;|/|\band\b|\s)\s*", units.strip().lower())
    lengths, angles = ([unit for word in words for unit, of in _UNITS[kind].items() if word in of] for kind in (0, 1))
    if (len(words), len(lengths), len(angles)) != (2, 1, 1):
        raise InputError(f"{where} is {str(units)[:40]!r}; write {UNITS!r}, or m instead of mm, rad instead of deg")
    millimetres = lengths == ["mm"]
    degrees = angles == ["deg"]

    def read(key: str, value: Any, where: str) -> float:
        number = _decimal(value, f"{where}: {key}")
        place = f"{where}: {key}"
        if key in _LENGTHS:
            length = float(number.scaleb(-3 if millimetres else 0, _EXACT))
            if abs(length) > LENGTH_LIMIT:
                raise InputError(f"{place} is {length:.6g} m, longer than any arm's link; correct it")
            return length
        angle = float(_EXACT.multiply(number, _DEGREE) if degrees else number)
        if abs(angle) > ANGLE_LIMIT:
            raise InputError(f"{place} is {math.degrees(angle):.6g} degrees, more than two turns; correct it")
        return angle

    return read


def _check_fit(value: Any, where: str) -> None:
    """What a table says of its fit; a table from a fit that does not describe its data is used with a warning."""
    if value is None:
        return
    fit = entries.mapping(value, where, FIT)
    for key in FIT[:2]:
        if not isinstance(fit[key], str):
            raise InputError(f"{where}: {key} is {json.dumps(fit[key], default=str)[:40]}, which is not text")
    if fit[FIT[2]] is not None and _decimal(fit[FIT[2]], f"{where}: {FIT[2]}") < 0:
        raise InputError(f"{where}: {FIT[2]} is negative; correct it")
    if fit["quality"] == "bad":
        warnings.warn(
            f"{where}: the fit that this table is from does not describe its data", InputWarning, stacklevel=3
        )
