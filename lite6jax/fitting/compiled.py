"""Traced, lowered and compiled functions kept between calls, so that only the first on a machine waits for them."""

import hashlib
import os
import sys
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, final

import jax
import jaxlib.version
from jax import export

from lite6jax import storage
from lite6jax.errors import InputError
from lite6jax.fitting.version import source_digest

_exports: Path | None = None
"""Where `Exported` functions are kept in this process; None keeps none."""


def keep_compiled_code() -> None:
    """Keeps compiled and exported functions in `cache_folder`, unless JAX has a folder; without a word if it cannot.

    What is kept is code that later runs of the program execute: the folders are made for their owner only, and are not
    used where they belong to, or can be written by, somebody else.
    """
    global _exports
    # JAX_COMPILATION_CACHE_DIR, or a program that calls `main`
    if getattr(jax.config, "jax_compilation_cache_dir", None):
        return
    try:
        folder = cache_folder()
        folder.parent.parent.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: an account without a home
        return
    if _private(folder.parent) is None or _private(folder) is None or not os.access(folder, os.W_OK):
        return
    warnings.filterwarnings("ignore", ".*persistent compilation cache", UserWarning)  # a full disk costs time only
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    _exports = _private(folder.parent / "exported")


def cache_folder() -> Path:
    """Where this system keeps what programs can make again."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "lite6jax" / "jax"


@final
class Exported:
    """A jitted function whose StableHLO is kept by `jax.export`: a later process neither traces nor lowers it.

    It is called as the function is. Where no folder is kept (`keep_compiled_code` was not called), or the package
    `flatbuffers` is not installed, it is the jitted function. Named tuples among its arguments and results must be
    registered with `jax.export.register_namedtuple_serialization`.
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
        if _exports is None:
            return self._jitted(*arguments)
        dynamic = [argument for i, argument in enumerate(arguments) if i not in self._static]
        key = self._key(arguments, dynamic)
        if key not in self._called:
            self._called[key] = self._load(_exports / f"{self._name}-{key}", arguments)
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


def _private(folder: Path) -> Path | None:
    """The folder, made for its owner only; None where it belongs to, or can be changed by, somebody else."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.stat()
    except OSError:
        return None
    foreign = hasattr(os, "getuid") and (found.st_uid != os.getuid() or found.st_mode & 0o022)
    return None if foreign else folder


@cache
def _version() -> tuple[str, ...]:
    """What a traced function depends on besides its arguments: the package's source, JAX and the platform."""
    return (source_digest(), jax.__version__, jaxlib.version.__version__, jax.default_backend())
