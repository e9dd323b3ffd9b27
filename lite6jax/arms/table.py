"""The JSON table of Hayati parameters, in millimetres and degrees, read and written without rounding errors.

The numbers of the table are decimal and those of the program binary. Both conversions, by 1000 and by pi / 180, are
done on decimals and rounded once, so that reading a table returns the floats that were written.
"""

import json
import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Context, Decimal
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax import checksum, storage
from lite6jax.arms import entries
from lite6jax.arms.chains import PARALLEL_WITHIN, HayatiForm
from lite6jax.errors import InputError, InputWarning, command_line
from lite6jax.schema import RepeatedKeyError, unique_keys

UNITS = "mm and deg"
PRISMATIC = entries.TYPES[1]
SIZE_LIMIT = 1 << 20

FIT = ("result", "quality", "checked_position_rms_m")
"""Of the fit that a table is from: how it ended, whether it describes its data, its error on data not fitted."""
LENGTH_LIMIT = 100.0
"""m; far beyond any arm, but not beyond the common normal of axes that are nearly parallel."""
ANGLE_LIMIT = 4 * math.pi
"""rad; no table counts more turns than two."""

_EXACT = Context(prec=60)
_DEGREE = _EXACT.divide(Decimal("3.14159265358979323846264338327950288419716939937510582097494459"), Decimal(180))
_BETA = re.compile(r"beta_joint([1-9][0-9]?)")


@dataclass(frozen=True, eq=False)
class HayatiTable:
    """Hayati parameters with their form.

    Attributes:
        form: the parameterisation.
        parameters: (size,) in the order of `form`, m and rad.
    """

    form: HayatiForm
    parameters: NDArray[np.float64]


def read_table(path: str | Path) -> HayatiTable:
    """A table of the form

    ```json
    {"units": "mm and deg",
     "base": {"x": 0.0, "y": 0.0, "z": 0.0, "roll": 0.0, "pitch": 0.0, "yaw": 0.0},
     "dh": [{"joint": 1, "theta_off": 0.0, "d": 243.3, "a": 0.0, "alpha": -90.0}],
     "beta_joint2": 0.0}
    ```

    with one row of `dh` per joint, in order, and one `beta_jointK` for each joint K that is nominally parallel to the
    next (Hayati's form, with d zero). The base's z and yaw are zero, because d and theta_off of joint 1 represent them.
    A row with `"type": "prismatic"` is of a prismatic joint; then rows have `b` where `HayatiForm` has, and the base's
    yaw is not zero where such a joint is the first. A table that is from a fit may have `fit` with the keys `FIT`, and
    one that was written here has a `checksum`.

    Raises:
        InputError: not such a table; the line names the file, the place and the remedy.

    Warns:
        InputWarning: the table was changed after it was written, or is from a fit that does not describe its data.
    """
    content = _parse(storage.read_text(path, SIZE_LIMIT), path)
    if "schema" in content:
        shown = command_line("report", path)
        raise InputError(f"{path}: holds results ({str(content['schema'])[:40]}); `{shown}` shows them")
    betas = {key: int(match[1]) for key in content if isinstance(key, str) and (match := _BETA.fullmatch(key))}
    entries.mapping(content, f"{path}:", ("units", "base", "dh"), (*(betas or ("beta_joint2",)), "fit", checksum.KEY))
    if content["units"] != UNITS:
        raise InputError(f"{path}: units is {content['units']!r}; this table is in {UNITS!r} only, convert it")
    base = entries.mapping(content["base"], f"{path}: base", entries.SIX)
    rows = content["dh"]
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: dh must be a list with one row per joint: joint, theta_off, d, a, alpha")
    sliding = tuple(i for i, row in enumerate(rows) if isinstance(row, dict) and row.get("type") == PRISMATIC)
    for key in ("z", *(() if 0 in sliding else ("yaw",))):
        if _decimal(base[key], f"{path}: base: {key}") != 0:
            remedy = "add it to d of joint 1" if key == "z" else "add it to theta_off of joint 1"
            raise InputError(f"{path}: base: {key} is not zero, which this form has no place for; {remedy}")
    links = np.array([_dh_row(row, f"{path}: dh row {i + 1}", i + 1, bool(sliding)) for i, row in enumerate(rows)])
    for key, joint in betas.items():
        if joint >= len(rows):
            raise InputError(f"{path}: {key} is for a joint that no other follows (there are {len(rows)}); remove it")
        if links[joint - 1, 1] != 0:
            raise InputError(f"{path}: dh row {joint}: d is not zero beside {key}; the form has either, set d to 0")
    parallel = tuple(sorted(joint - 1 for joint in betas.values()))
    position = [_metres(base[key], f"{path}: base: {key}") for key in ("x", "y")]
    yaw, pitch, roll = (_radians(base[key], f"{path}: base: {key}") for key in ("yaw", "pitch", "roll"))
    links[list(parallel), 5] = [_radians(content[f"beta_joint{i + 1}"], f"{path}: beta_joint{i + 1}") for i in parallel]
    if 0 in sliding and np.cos(roll) * np.cos(pitch) > np.cos(PARALLEL_WITHIN):
        parallel = (-1, *parallel)
    form = HayatiForm(len(rows), parallel, sliding)
    try:
        parameters = form.gather([*position, yaw, pitch, roll], links)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    _check_fit(content.get("fit"), f"{path}: fit")
    checksum.verify(content, path)
    return HayatiTable(form, np.asarray(parameters, np.float64))


def write_table(
    form: HayatiForm,
    parameters: ArrayLike,
    path: str | Path,
    overwrite: bool = False,
    fit: Mapping[str, Any] | None = None,
) -> Path:
    """Writes Hayati parameters as a table; `read_table` returns every float exactly.

    Args:
        form: the parameterisation.
        parameters: (size,) m and rad.
        path: the file to write.
        overwrite: whether the file may be replaced.
        fit: what is to be said of the fit that they are from, under the keys `FIT`.

    Raises:
        InputError: parameters of the wrong size or not finite, or as `storage.write_atomically`.
    """
    values = np.asarray(parameters, np.float64)
    if values.shape != (form.size,) or not np.isfinite(values).all():
        raise InputError(f"{path}: a table of this form needs {form.size} finite numbers, not an array {values.shape}")
    (x, y, yaw, pitch, roll), links = form.spread(values)
    rows = [
        f'    {{"joint": {i + 1}, {kind}"theta_off": {degrees(theta)}, "d": {millimetres(d)}, "a": {millimetres(a)},'
        f'{across} "alpha": {degrees(alpha)}}}'
        for i, (theta, d, a, b, alpha, _) in enumerate(links)
        for kind in (f'"type": "{PRISMATIC}", ' if i in form.sliding else "",)
        for across in (f' "b": {millimetres(b)},' if form.sliding else "",)
    ]
    lines = [
        "{",
        f'  "units": "{UNITS}",',
        f'  "base": {{"x": {millimetres(x)}, "y": {millimetres(y)}, "z": 0.0,'
        f' "roll": {degrees(roll)}, "pitch": {degrees(pitch)}, "yaw": {degrees(yaw)}}},',
        '  "dh": [',
        ",\n".join(rows),
        "  ]" + "".join(f',\n  "beta_joint{i + 1}": {degrees(links[i, 5])}' for i in form.parallel if i >= 0),
    ]
    if fit is not None:
        lines[-1] += f',\n  "fit": {json.dumps(dict(fit), allow_nan=False)}'
    content = _parse("\n".join([*lines, "}"]), path)
    lines[-1] += f',\n  "{checksum.KEY}": "{checksum.checksum_of(content)}"'
    return storage.write_atomically(path, "\n".join([*lines, "}"]) + "\n", overwrite)


def millimetres(length: float) -> str:
    """The decimal of a length in mm that is read as exactly this float of metres."""
    return _plain(Decimal(repr(float(length))).scaleb(3, _EXACT))


def degrees(angle: float) -> str:
    """The shortest decimal of an angle in degrees that is read as exactly this float of radians."""
    angle = float(angle)
    exact = _EXACT.divide(Decimal(angle), _DEGREE)
    candidates = (_plain(Context(prec=digits).create_decimal(exact)) for digits in range(15, 40))
    return next(text for text in candidates if float(_EXACT.multiply(Decimal(text), _DEGREE)) == angle)


def _plain(value: Decimal) -> str:
    """A decimal in JSON with its point, so that every reader reads it as a float."""
    value = value.normalize(_EXACT)
    mantissa, _, power = (format(value, "f") if -7 <= value.adjusted() < 16 else str(value)).partition("E")
    mantissa = mantissa if "." in mantissa else f"{mantissa}.0"
    return f"{mantissa}e{power}" if power else mantissa


def _parse(text: str, path: str | Path) -> dict[str, Any]:
    try:
        content = json.loads(
            text, parse_float=Decimal, parse_int=Decimal, parse_constant=Decimal, object_pairs_hook=unique_keys
        )
    except RepeatedKeyError as error:
        raise InputError(f"{path}: the key {error.args[0]!r} is given twice; keep one") from error
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: line {error.lineno}: not valid JSON ({error.msg}); correct the file") from error
    except (RecursionError, ValueError, ArithmeticError) as error:
        raise InputError(
            f"{path}: not valid JSON (nested too deeply or a malformed number); correct the file"
        ) from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: must be a JSON object with the keys units, base, dh and beta_joint2")
    return content


def _dh_row(value: Any, where: str, joint: int, slides: bool) -> list[float]:
    """`chains.LINK`, beta zero; `slides` says whether the chain has a prismatic joint."""
    optional = ("type", "b") if slides else ("type",)
    row = entries.mapping(value, where, ("joint", "theta_off", "d", "a", "alpha"), optional)
    if (kind := row.get("type", entries.TYPES[0])) not in entries.TYPES:
        raise InputError(f"{where}: type is {str(kind)[:40]!r}; write {' or '.join(entries.TYPES)}")
    if _decimal(row["joint"], f"{where}: joint") != joint:
        raise InputError(f"{where}: is for joint {row['joint']}; list the joints in order, 1, 2, …")
    return [
        _radians(row["theta_off"], f"{where}: theta_off"),
        _metres(row["d"], f"{where}: d"),
        _metres(row["a"], f"{where}: a"),
        _metres(row.get("b", Decimal(0)), f"{where}: b"),
        _radians(row["alpha"], f"{where}: alpha"),
        0.0,
    ]


def _decimal(value: Any, where: str) -> Decimal:
    if not isinstance(value, Decimal):
        raise InputError(
            f"{where} is {json.dumps(value, default=str)[:40]}, which is not a number; write a plain number"
        )
    if not math.isfinite(value) or abs(value.adjusted()) > 10_000:
        raise InputError(f"{where} is {value:.6g}, which is not finite; read the table from its source again")
    return value


def _metres(value: Any, where: str) -> float:
    length = float(_decimal(value, where).scaleb(-3, _EXACT))
    if abs(length) > LENGTH_LIMIT:
        raise InputError(f"{where} is {length:.6g} m, longer than any arm's link; correct it")
    return length


def _radians(value: Any, where: str) -> float:
    angle = float(_EXACT.multiply(_decimal(value, where), _DEGREE))
    if abs(angle) > ANGLE_LIMIT:
        raise InputError(f"{where} is {math.degrees(angle):.6g} degrees, more than two turns; correct it")
    return angle


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
