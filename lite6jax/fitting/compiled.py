"""Traced, lowered and compiled functions kept between calls, so that only the first on a machine waits for them."""

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, final

import jax
import jaxlib.version
from jax import export

from lite6jax import storage
from lite6jax.errors import InputError
from lite6jax.fitting import code_folder
from lite6jax.fitting.version import source_digest


@final
class Exported:
    """A jitted function whose StableHLO is kept by `jax.export`: a later process neither traces nor lowers it.

    It is called as the function is. Where no folder is kept (`code_folder.keep_compiled_code` was not called), or the
    package `flatbuffers` is not installed, it is the jitted function. Named tuples among its arguments and results must
    be registered with `jax.export.register_namedtuple_serialization`.
    """

    def __init__(self, name: str, function: Callable[..., Any], static: tuple[int, ...], options: dict | None = None):
        """Takes a function to compile.

        Args:
            name: of its files.
            function: to trace; pure.
            static: positions of its static arguments, whose `repr` must tell them apart.
            options: the compiler's.
        """
        self._name, self._static, self._options = name, static, options
        self._jitted = jax.jit(function, static_argnums=static, compiler_options=options)
        self._called: dict[str, Callable[..., Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        folder = code_folder.exports()
        if folder is None:
            return self._jitted(*arguments)
        dynamic = [argument for i, argument in enumerate(arguments) if i not in self._static]
        key = self._key(arguments, dynamic)
        if key not in self._called:
            self._called[key] = self._load(folder / f"{self._name}-{key}", arguments)
        return self._called[key](*dynamic) if self._called[key] is not self._jitted else self._jitted(*arguments)

    def _key(self, arguments: tuple[Any, ...], dynamic: list[Any]) -> str:
        leaves, structure = jax.tree.flatten(dynamic)
        kinds = [str(jax.typeof(leaf)) for leaf in leaves]
        parts = (_version(), self._options, [arguments[i] for i in self._static], str(structure), kinds)
        return hashlib.sha256(repr(parts).encode()).hexdigest()

    def _load(self, path: Path, arguments: tuple[Any, ...]) -> Callable[..., Any]:
        try:
            exported = _read(path)
            if exported is None:
                exported = export.export(self._jitted)(*arguments)
                _write(path, exported)
        except ImportError:
            return self._jitted
        return jax.jit(exported.call, compiler_options=self._options)


def _read(path: Path) -> export.Exported | None:
    """The function in a file; None where there is no file, or it is damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, serialized = content[:32], content[32:]
    if hashlib.sha256(serialized).digest() != digest:
        return None
    return export.deserialize(bytearray(serialized))


def _write(path: Path, exported: export.Exported) -> None:
    serialized = bytes(exported.serialize())
    try:
        storage.write_atomically(path, hashlib.sha256(serialized).digest() + serialized, overwrite=True)
    except InputError:  # a full disk costs time only
        return


@cache
def _version() -> tuple[str, ...]:
    """What a traced function depends on besides its arguments: the package's source, JAX and the platform."""
    return (source_digest(), jax.__version__, jaxlib.version.__version__, jax.default_backend())
