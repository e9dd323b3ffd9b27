"""The catalogue of effects: all that an arm may have, their text and JSON forms, and effects from a user's own file.

A user's own effects stand in a Python file that defines final subclasses of `JointEffect` or `Bending` and a list
`EFFECTS` of those to be tested for:

```python
from dataclasses import dataclass
from typing import ClassVar, final

import jax.numpy as jnp

from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Coordinate, JointEffect


@final
@dataclass(frozen=True)
class CableDrag(JointEffect):
    \"\"\"δq = d·tanh(q): a cable that pulls the joint back.\"\"\"

    name: ClassVar[str] = "cable_drag"

    @property
    def coordinates(self):
        return (Coordinate("drag_rad", "rad", 1e-4),)

    @property
    def drivers(self):
        return (Driver("position", self.joint),)

    def angle(self, values, motion, loads):
        return values[0] * jnp.tanh(motion.joint_position[self.joint - 1])


EFFECTS = [CableDrag(joint) for joint in range(1, 7)]
```
"""

import ast
import sys
import traceback
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.effects.composition import missing
from lite6jax.effects.deflection import Deflection, dense
from lite6jax.effects.effect import Altering, Bending, Effect
from lite6jax.effects.kinematic.joints import (
    JointBacklash,
    JointCompliance,
    JointCoupling,
    JointHarmonic,
    JointLag,
    JointOffset,
    JointScale,
)
from lite6jax.effects.kinematic.links import FrameOffset, LinkCompliance, LinkThermalExpansion
from lite6jax.effects.kinematic.surroundings import (
    BaseCompliance,
    BaseDrift,
    MeasurementScale,
    PayloadError,
    TimeOffset,
    ToolOffset,
)
from lite6jax.effects.motion import Motion, motion_of
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.statics import Loads
from lite6jax.errors import InputError
from lite6jax.storage import read_text

SIZE_LIMIT = 1 << 20
"""Bytes of a user's file of effects."""

_ALL: tuple[type[Effect], ...] = (
    *(JointOffset, JointScale, JointCompliance, JointHarmonic, JointBacklash, JointLag, JointCoupling),
    *(LinkCompliance, LinkThermalExpansion, FrameOffset, BaseCompliance, BaseDrift, ToolOffset),
    *(MeasurementScale, TimeOffset, PayloadError, Unnamed),
)
BUILT_IN: Mapping[str, type[Effect]] = types.MappingProxyType({kind.name: kind for kind in _ALL})
"""The classes of the catalogue by name."""


class Untestable(NamedTuple):
    """An effect that a recording cannot show, and why, in words."""

    effect: Effect
    reason: str


def catalogue(dof: int, *, orders: Sequence[float] = (1.0, 2.0), turned_tool: bool = False) -> tuple[Effect, ...]:
    """Every named effect of an arm, each site on its own.

    Args:
        dof: number of joints.
        orders: of the harmonics of each joint; gear orders are found by a spectrum.
        turned_tool: whether a tool's orientation can be seen.
    """
    joints = range(1, dof + 1)
    simple = (JointOffset, JointScale, JointCompliance, JointBacklash, JointLag)
    return (
        *(kind(joint) for kind in simple for joint in joints),
        *(JointHarmonic(joint, order) for joint in joints for order in orders),
        *(JointCoupling(joint, source) for joint in joints for source in joints if source != joint),
        *(LinkCompliance(link) for link in joints),
        *(LinkThermalExpansion(link) for link in (None, *range(1, dof))),
        *(FrameOffset(link) for link in (None, *joints)),
        *(BaseCompliance(), BaseDrift(), ToolOffset(turned_tool), MeasurementScale(), TimeOffset(), PayloadError()),
    )


def untestable(effects: Iterable[Effect], motion: Motion, loads_known: bool) -> list[Untestable]:
    """Those that lack a driver in a motion, with the reason in words.

    Args:
        effects: the candidates.
        motion: what was recorded.
        loads_known: whether the masses of the arm's links are.
    """
    reasons = ((effect, missing(effect, motion, loads_known)) for effect in effects)
    return [Untestable(effect, reason) for effect, reason in reasons if reason is not None]


def kinds_of(effects: Iterable[Effect] = ()) -> dict[str, type[Effect]]:
    """The classes of the catalogue and of a user's own `effects`, by name."""
    return {**BUILT_IN, **{effect.name: type(effect) for effect in effects}}


_TYPES = {
    int: "a whole number",
    float: "a number",
    str: "a name",
    bool: "true or false",
    tuple: "a list of numbers",
}


def _field_types(kind: type[Effect]) -> dict[str, tuple[type, ...]]:
    """The fields of an effect's class and the plain types that each takes."""
    hints = typing.get_type_hints(kind)
    return {
        field.name: (tuple,)
        if typing.get_origin(hint := hints[field.name]) is tuple
        else typing.get_args(hint) or (hint,)
        for field in fields(kind)  # type: ignore[arg-type]
    }


def _kind(name: Any, kinds: Mapping[str, type[Effect]]) -> type[Effect]:
    if not isinstance(name, str) or name not in kinds:
        raise InputError(f"effect {name!r}: unknown; the catalogue has {', '.join(kinds)}")
    return kinds[name]


def _keys(kind: type[Effect]) -> str:
    """The keys that the text form of an effect takes, for messages."""
    taken = _field_types(kind)
    required = [f.name for f in fields(kind) if f.default is MISSING]  # type: ignore[arg-type]
    try:
        example = kind(**{name: number for number, name in enumerate(required, 1)})
        parameters = example.reporting.names(example)
    except (InputError, TypeError):  # its fields are no numbers, and its parameters follow from them
        parameters = ("its parameters",)
    return ", ".join([*taken, *(name for name in parameters if name not in taken)])


def _build(kind: type[Effect], given: Mapping[str, Any]) -> Effect:
    """An effect of its fields, whose types are checked first: a file or a person wrote them."""
    taken, checked = _field_types(kind), {}
    for name, value in given.items():
        if name not in taken:
            raise InputError(f"{kind.name}: the key {name!r} is unknown; the keys are {_keys(kind)}")
        if float in taken[name] and type(value) is int:
            value = float(value)
        elif int in taken[name] and type(value) is float and value.is_integer():
            value = int(value)  # as `reported` gives a source_joint
        elif tuple in taken[name] and isinstance(value, list) and all(type(v) in (int, float) for v in value):
            value = tuple(map(float, value))
        if type(value) not in taken[name]:
            wanted = " or ".join(_TYPES.get(t, t.__name__) for t in taken[name] if t is not type(None))
            raise InputError(f"{kind.name}: {name} is {value!r}; give {wanted}")
        if name in ("joint", "link", "source_joint") and isinstance(value, int) and value < 1:
            raise InputError(f"{kind.name}: {name} is {value}; joints and links count from 1")
        checked[name] = value
    for field in fields(kind):  # type: ignore[arg-type]
        if field.default is MISSING and field.name not in checked:
            raise InputError(f"{kind.name}: {field.name} is not given; the keys are {_keys(kind)}")
    return kind(**checked)


def parse_effect(
    text: str, kinds: Mapping[str, type[Effect]] = BUILT_IN, neutral: bool = False
) -> tuple[Effect, NDArray]:
    """An effect and its values from text such as `joint_compliance:joint=2,compliance_rad_per_Nm=9e-5`.

    Keys that are an effect's fields say where it acts, the others are its parameters; those not given are zero.

    Args:
        text: name, colon, key=value separated by commas.
        kinds: the effects there are.
        neutral: whether all parameters may be left out.

    Raises:
        InputError: an unknown name or key, with the accepted ones; a key twice, or no value where one is needed.
    """
    name, _, rest = text.partition(":")
    kind = _kind(name.strip(), kinds)
    written: dict[str, str] = {}
    for item in filter(None, (part.strip() for part in rest.split(","))):
        key, _, value = (part.strip() for part in item.partition("="))
        if not key or not value:
            raise InputError(f"{kind.name}: {item!r} is not key=value; the keys are {_keys(kind)}")
        if key in written:
            raise InputError(f"{kind.name}: {key} is given twice; keep one")
        written[key] = value
    taken = _field_types(kind)
    effect = _build(kind, {key: _literal(value) for key, value in written.items() if key in taken})
    numbers = {}
    for key, value in written.items():
        if key in taken:
            continue
        if key not in effect.reporting.names(effect):
            raise InputError(f"{kind.name}: the key {key!r} is unknown; the keys are {_keys(kind)}")
        try:
            numbers[key] = float(value)
        except ValueError as error:
            raise InputError(f"{kind.name}: {key} is {value!r}; give a number") from error
    if not numbers and neutral:
        return effect, np.zeros(effect.size)
    if not numbers:
        raise InputError(f"{kind.name}: no parameter is given; the keys are {_keys(kind)}")
    return effect, effect.values_of(numbers)


def _literal(text: str) -> Any:
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return {"true": True, "false": False}.get(text, text)


def effect_as_dict(effect: Effect, values: ArrayLike, covariance: ArrayLike | None = None) -> dict[str, Any]:
    """An effect and its parameters as JSON holds them: `effect`, `site`, its fields as `where`, `parameters`.

    Args:
        effect: the effect.
        values: `(coordinate,)`.
        covariance: `(coordinate, coordinate)`; standard deviations are 0 without it.
    """
    where = {field.name: getattr(effect, field.name) for field in fields(effect)}  # type: ignore[arg-type]
    return {
        "effect": effect.name,
        "site": effect.site,
        "where": {name: list(v) if isinstance(v, tuple) else v for name, v in where.items() if v not in (None, ())},
        "parameters": {name: e._asdict() for name, e in effect.reported(values, covariance).items()},
    }


def effect_from_dict(document: Any, kinds: Mapping[str, type[Effect]] = BUILT_IN) -> tuple[Effect, NDArray]:
    """The inverse of `effect_as_dict`; a parameter may also be a plain number, and `site` may be absent.

    Raises:
        InputError: an unknown effect, key or parameter, or something of another type than it should be.
    """
    if not isinstance(document, Mapping):
        raise InputError(f"effect {document!r}: is no mapping; give effect, where and parameters")
    kind = _kind(document.get("effect"), kinds)
    where, parameters = document.get("where", {}), document.get("parameters", {})
    for name, part in (("where", where), ("parameters", parameters)):
        if not isinstance(part, Mapping):
            raise InputError(f"{kind.name}: {name} is {part!r}; give a mapping of names to values")
    effect = _build(kind, where)
    if document.get("site", effect.site) != effect.site:
        raise InputError(f"{kind.name}: the site {document['site']!r} is not that of {dict(where)}; correct one")
    numbers = {}
    for name, value in parameters.items():
        value = value.get("value") if isinstance(value, Mapping) else value
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise InputError(f"{effect.label}: {name} is {value!r}; give a number")
        numbers[name] = float(value)
    return effect, effect.values_of(numbers)


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """The effects of a user's own Python file, its list `EFFECTS`; the module's first lines show one. Runs the file.

    Raises:
        InputError: the file fails (with the line), has no list, or something in it is no final, frozen effect, has the
            name of a built-in one, deflects in other shapes than a `Deflection`'s, or does so at zero.
    """
    path = Path(path)
    text = read_text(path, SIZE_LIMIT)
    module = types.ModuleType(f"lite6jax_effects_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses and type hints look their module up there
    try:
        exec(compile(text, str(path), "exec"), module.__dict__)
    except Exception as error:
        line = getattr(error, "lineno", None)
        for entry in traceback.extract_tb(error.__traceback__):
            line = entry.lineno if entry.filename == str(path) else line
        raise InputError(
            f"{path}: line {line}: {type(error).__name__}: {_one_line(error)}; correct the file"
        ) from error
    effects = getattr(module, "EFFECTS", None)
    if not isinstance(effects, list | tuple) or not effects:
        raise InputError(f"{path}: has no list EFFECTS; end it with EFFECTS = [MyEffect(joint=1), …]")
    for index, effect in enumerate(effects):
        reason = _fault(effect)
        if reason:
            raise InputError(f"{path}: EFFECTS[{index}]: {reason}")
    return tuple(effects)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _fault(effect: Any) -> str | None:
    """What keeps an object of a user's file from being an effect, with the remedy."""
    if isinstance(effect, type):
        return f"is the class {effect.__name__}; give one of it, as {effect.__name__}(joint=1)"
    kind = type(effect)
    if not isinstance(effect, Bending | Altering):
        return f"{effect!r} is no effect; derive its class from JointEffect or Bending"
    if not getattr(kind, "__final__", False):
        return f"{kind.__name__} is not final; write @final above the class"
    if kind.__hash__ is None or "__eq__" not in kind.__dict__ or not kind.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        return f"{kind.__name__} is not frozen; write @dataclass(frozen=True) above the class"
    if not isinstance(getattr(kind, "name", None), str):
        return f'{kind.__name__} has no name; write name: ClassVar[str] = "…" in the class'
    if kind.name in BUILT_IN:
        return f"{kind.__name__} has the name of a built-in effect, {kind.name}; choose another"
    try:
        _try(effect)
    except InputError as error:
        return str(error)
    except Exception as error:
        return f"{effect!r} fails on a trial motion ({type(error).__name__}: {_one_line(error)}); correct it"
    return None


def _try(effect: Bending | Altering) -> None:
    """Runs an effect at zero on a small motion that has everything."""
    dof, samples = max(effect.joints_needed, 2), 3
    q = np.linspace(0.1, 1.0, samples * dof).reshape(samples, dof)
    row = np.arange(float(samples))
    motion = motion_of(q, joint_velocity=q, direction=np.sign(q), time=row, ambient_temperature=row, payload=row)
    loads = Loads(jnp.ones((dof, 3, samples)), jnp.ones((3, samples)))
    names = [coordinate.name for coordinate in effect.coordinates]
    if not names or len(set(names)) != len(names):
        raise InputError(f"{effect.label} has the coordinates {names}; give at least one, each with a name of its own")
    zero = jnp.zeros(effect.size)
    if isinstance(effect, Altering):
        rigid, found = motion, effect.alter(zero, motion)
    else:
        rigid, found = dense(Deflection(), dof, samples), dense(effect.deflect(zero, motion, loads), dof, samples)
    for name, plain, value in zip(rigid._fields, rigid, found, strict=True):
        if plain is None or value is None:
            continue
        if jnp.shape(value) != jnp.shape(plain):
            raise InputError(f"{effect.label} gives {name} of shape {jnp.shape(value)}; give {jnp.shape(plain)}")
        if not np.allclose(value, plain, rtol=0, atol=1e-12):
            raise InputError(f"{effect.label} changes {name} at zero; make zero the value at which nothing changes")
