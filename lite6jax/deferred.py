"""JAX, imported where it is first used: commands that list or convert answer without the half second that it takes.

Modules that describe arms and effects take `jax`, `jnp`, `lax`, `Array` and `ArrayLike` from here, and modules that
compute import JAX itself. Where JAX is imported already, these are JAX's own.
"""

import sys
from collections.abc import Callable
from functools import update_wrapper
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar

T = TypeVar("T")

_static: list[type] = []
"""Classes that `register_static` was given before JAX was imported."""

if TYPE_CHECKING or "jax" in sys.modules:
    import jax
    import jax.numpy as jnp
    from jax import Array, lax
    from jax.typing import ArrayLike

    jit = jax.jit
else:

    class _Module:
        """A module that is imported when a name of it is wanted; the name is looked up once."""

        def __init__(self, name: str) -> None:
            self._name = name

        def __getattr__(self, name: str) -> Any:
            value = getattr(import_module(self._name), name)
            _register()
            setattr(self, name, value)
            return value

    class _Jitted:
        """A function that `jax.jit` takes when it is first called."""

        def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
            self._function, self._options = function, options
            update_wrapper(self, function)

        def __call__(self, *args: Any, **kwargs: Any) -> Any:
            return self._jitted(*args, **kwargs)

        def __getattr__(self, name: str) -> Any:
            if name != "_jitted":
                return getattr(self._jitted, name)
            jitted = self._jitted = jax.jit(self._function, **self._options)
            return jitted

    class _Arrays(type):
        def __instancecheck__(cls, value: Any) -> bool:
            return "jax" in sys.modules and isinstance(value, sys.modules["jax"].Array)

    class Array(metaclass=_Arrays):
        """As `jax.Array` in annotations and for `isinstance`."""

    jax, jnp, lax = _Module("jax"), _Module("jax.numpy"), _Module("jax.lax")
    ArrayLike = Any

    def jit(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
        """As `jax.jit`."""
        return _Jitted(function, options)


def register_static(kind: type[T]) -> type[T]:
    """As `jax.tree_util.register_static`: the class is part of a pytree's structure."""
    _static.append(kind)
    if "jax" in sys.modules:
        _register()
    return kind


def _register() -> None:
    while _static:
        sys.modules["jax"].tree_util.register_static(_static.pop())


__all__ = ["Array", "ArrayLike", "jax", "jit", "jnp", "lax", "register_static"]
