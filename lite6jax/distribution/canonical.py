"""A canonical form of values, by which equal requests are recognised: text that another process makes likewise.

A pickle is not one: its bytes depend on which objects are the same object, and on the version that wrote it.
"""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from enum import Enum
from pathlib import PurePath
from types import BuiltinFunctionType, FunctionType
from typing import Any

import numpy as np
import pyarrow as pa


def canonical(value: Any) -> bytes:
    """JSON of a value: equal values of equal types have equal text, and different ones have not.

    Args:
        value: numbers, text, bytes, paths, members of enumerations, arrays and scalars of NumPy, functions and classes
            of modules, schemas of Arrow, and dataclasses, tuples, lists, sets and mappings of these.

    Raises:
        TypeError: anything else, whose text might differ where the value is the same.
    """
    return json.dumps(_plain(value), ensure_ascii=True, separators=(",", ":")).encode()


def _plain(value: Any) -> Any:
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, Enum):
        return {"member": [_name(type(value)), value.name]}
    if isinstance(value, bytes):
        return {"bytes": value.hex()}
    if isinstance(value, PurePath):
        return {"path": str(value)}
    if isinstance(value, pa.Schema):
        return {"schema": value.serialize().to_pybytes().hex()}
    if isinstance(value, (np.ndarray, np.generic)) and value.dtype != object:
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return {"array": [value.dtype.str, list(value.shape), digest]}
    if isinstance(value, (type, FunctionType, BuiltinFunctionType)) and "<" not in _name(value):
        return {"name": _name(value)}
    if dataclasses.is_dataclass(value):
        fields = {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {"object": [_name(type(value)), fields]}
    if isinstance(value, tuple):
        kind = "tuple" if type(value) is tuple else _name(type(value))
        return {kind: [_plain(one) for one in value]}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    if isinstance(value, (set, frozenset)):
        return {"set": sorted((_plain(one) for one in value), key=json.dumps)}
    if isinstance(value, Mapping):
        return {"mapping": sorted(([_plain(key), _plain(one)] for key, one in value.items()), key=json.dumps)}
    raise TypeError(f"{type(value).__module__}.{type(value).__qualname__}: has no canonical form")


def _name(kind: Any) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"
