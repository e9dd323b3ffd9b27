"""The text form and the JSON form of effects with their parameters."""

import ast
import typing
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import joint_unit
from lite6jax.effects.catalogue import POSE_EFFECTS
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.fields import field_values
from lite6jax.storage import NonNegative, Strict, check

_TYPES = {
    int: "a whole number",
    float: "a number",
    str: "a name",
    bool: "true or false",
    tuple: "a list of numbers",
}
_OF_SLIDE = "of_slide"
"""The field that says that the joint of an effect is prismatic; names of its other fields then have other units."""


class _Estimate(Strict):
    """A parameter in the JSON form of an effect."""

    value: float
    std: NonNegative = 0.0


def _kind(name: Any, kinds: Mapping[str, type[Effect]]) -> type[Effect]:
    """The class of a name."""
    if not isinstance(name, str) or name not in kinds:
        raise InputError(f"effect {name!r}: unknown; the catalogue has {', '.join(kinds)}")
    return kinds[name]


def _field_types(kind: type[Effect], of_slide: bool = False) -> dict[str, tuple[type, ...]]:
    """The fields of an effect's class as they are written, and the types that each accepts."""
    hints = typing.get_type_hints(kind)

    def accepted(hint: Any) -> tuple[type, ...]:
        if typing.get_origin(hint) is tuple:
            return (tuple,)
        return typing.get_args(hint) or (hint,)

    return {joint_unit(field.name, of_slide): accepted(hints[field.name]) for field in fields(kind)}  # type: ignore[arg-type]


def _keys(kind: type[Effect], of_slide: bool = False) -> str:
    """The keys that the text form of an effect accepts, for messages."""
    field_names = [name for name in _field_types(kind, of_slide) if name != _OF_SLIDE]
    required = [field.name for field in fields(kind) if field.default is MISSING]  # type: ignore[arg-type]
    placeholders: dict[str, Any] = {name: number for number, name in enumerate(required, 1)}
    try:
        parameters = kind(**placeholders, **({_OF_SLIDE: True} if of_slide else {})).parameters
    except (InputError, TypeError):  # fields that are not numbers and determine the parameters
        parameters = ("its parameters",)
    return ", ".join([*field_names, *(name for name in parameters if name not in field_names)])


def _build(kind: type[Effect], field_values: Mapping[str, Any]) -> Effect:
    """An effect from its fields, whose types are checked because they come from a file or from the command line."""
    of_slide = field_values.get(_OF_SLIDE) is True
    field_types = _field_types(kind, of_slide)
    checked = {}
    for name, value in field_values.items():
        if name not in field_types:
            raise InputError(f"{kind.name}: the key {name!r} is unknown; the keys are {_keys(kind, of_slide)}")
        if float in field_types[name] and type(value) is int:
            value = float(value)
        elif int in field_types[name] and type(value) is float and value.is_integer():
            value = int(value)  # as `reported` gives a source_joint
        elif tuple in field_types[name] and isinstance(value, list) and all(type(v) in (int, float) for v in value):
            value = tuple(map(float, value))
        if type(value) not in field_types[name]:
            accepted = " or ".join(_TYPES.get(t, t.__name__) for t in field_types[name] if t is not type(None))
            raise InputError(f"{kind.name}: {name} is {value!r}; give {accepted}")
        if name in ("joint", "link", "source_joint") and isinstance(value, int) and value < 1:
            raise InputError(f"{kind.name}: {name} is {value}; joints and links count from 1")
        checked[name] = value
    arguments = {}
    for field in fields(kind):  # type: ignore[arg-type]
        name = joint_unit(field.name, of_slide)
        if name in checked:
            arguments[field.name] = checked[name]
        elif field.default is MISSING:
            raise InputError(f"{kind.name}: {name} is not given; the keys are {_keys(kind, of_slide)}")
    return kind(**arguments)


def parse_effect(
    text: str,
    kinds: Mapping[str, type[Effect]] = POSE_EFFECTS,
    neutral: bool = False,
    sliding: tuple[int, ...] = (),
) -> tuple[Effect, NDArray]:
    """An effect and its values from text such as `joint_compliance:joint=2,compliance_rad_per_Nm=9e-5`.

    Keys that are fields of the effect say where it acts; the others are its parameters. Missing parameters are zero.

    Args:
        text: name, colon, key=value separated by commas.
        kinds: the known effects by name.
        neutral: whether all parameters may be missing.
        sliding: the prismatic joints of the arm, counted from 0: numbers of effects on them are in m and N,
            such as `viscous_friction:joint=3,viscous_N_s_per_m=20`.

    Raises:
        InputError: an unknown name or key, with the accepted ones; a repeated key; a missing value.
    """
    name, _, assignments = text.partition(":")
    kind = _kind(name.strip(), kinds)
    written: dict[str, str] = {}
    for item in filter(None, (part.strip() for part in assignments.split(","))):
        key, _, value = (part.strip() for part in item.partition("="))
        if not key or not value:
            raise InputError(f"{kind.name}: {item!r} is not key=value; the keys are {_keys(kind)}")
        if key in written:
            raise InputError(f"{kind.name}: {key} is given twice; keep one")
        written[key] = value
    at_slide = written.get("joint") in {str(joint + 1) for joint in sliding}
    of_slide = _OF_SLIDE in _field_types(kind) and at_slide
    field_names = [name for name in _field_types(kind, of_slide) if name != _OF_SLIDE]
    place: dict[str, Any] = {key: _literal(value) for key, value in written.items() if key in field_names}
    effect = _build(kind, place | ({_OF_SLIDE: True} if of_slide else {}))
    numbers = {}
    for key in (key for key in written if key not in field_names):
        if key not in effect.parameters:
            raise InputError(f"{kind.name}: the key {key!r} is unknown; the keys are {_keys(kind, of_slide)}")
        try:
            numbers[key] = float(written[key])
        except ValueError as error:
            raise InputError(f"{kind.name}: {key} is {written[key]!r}; give a number") from error
    if not numbers and neutral:
        return effect, np.zeros(effect.size)
    if not numbers:
        raise InputError(f"{kind.name}: no parameter is given; the keys are {_keys(kind, of_slide)}")
    return effect, effect.values_of(numbers)


def _literal(text: str) -> Any:
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return {"true": True, "false": False}.get(text, text)


def effect_as_dict(effect: Effect, values: ArrayLike, covariance: ArrayLike | None = None) -> dict[str, Any]:
    """The JSON form of an effect: its name `effect`, its `site`, its fields `where` and its `parameters`.

    Args:
        effect: the effect.
        values: `(coordinate,)`.
        covariance: `(coordinate, coordinate)`; standard deviations are 0 without it.
    """
    where = field_values(effect)
    silent = {_OF_SLIDE: False, effect.fixed: effect.plain}  # fields that say nothing at these values
    written_fields = {
        effect.own(name): list(value) if isinstance(value, tuple) else value
        for name, value in where.items()
        if value not in (None, (), "", silent.get(name))
    }
    return {
        "effect": effect.name,
        "site": effect.site,
        "where": written_fields,
        "parameters": {name: e._asdict() for name, e in effect.reported(values, covariance).items()},
    }


def effect_from_dict(document: Any, kinds: Mapping[str, type[Effect]] = POSE_EFFECTS) -> tuple[Effect, NDArray]:
    """The inverse of `effect_as_dict`; a parameter may also be a plain number, and `site` may be missing.

    Raises:
        InputError: an unknown effect, key or parameter, or a value of the wrong type.
    """
    if not isinstance(document, Mapping):
        raise InputError(f"effect {document!r}: is not a mapping; give effect, where and parameters")
    unknown = [name for name in document if name not in ("effect", "site", "where", "parameters")]
    if unknown:
        raise InputError(f"effect: the key {unknown[0]!r} is unknown; the keys are effect, site, where, parameters")
    kind = _kind(document.get("effect"), kinds)
    where = document.get("where", {})
    parameters = document.get("parameters", {})
    for name, part in (("where", where), ("parameters", parameters)):
        if not isinstance(part, Mapping):
            raise InputError(f"{kind.name}: {name} is {part!r}; give a mapping of names to values")
    effect = _build(kind, where)
    if document.get("site", effect.site) != effect.site:
        raise InputError(f"{kind.name}: the site {document['site']!r} is not that of {dict(where)}; correct one")
    numbers = {}
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            value = check(value, _Estimate, f"{effect.label}: {name}").value
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise InputError(f"{effect.label}: {name} is {value!r}; give a number")
        numbers[name] = float(value)
    return effect, effect.values_of(numbers)
