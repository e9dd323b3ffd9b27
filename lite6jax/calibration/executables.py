"""Executables of jitted functions that are kept between processes: one that finds them traces and lowers nothing.

JAX's own cache keeps what XLA compiles, by the lowered text of a function. To get that text, each process traces and
lowers anew, which takes longer than the computation of a short command.
"""

import hashlib
import pickle
import platform
import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jax.experimental import serialize_executable

from lite6jax.calibration.compiled import kept_folder, versions
from lite6jax.errors import InputError
from lite6jax.storage import write_atomically


class KeptJit:
    """A function as of `jax.jit`, whose executables are kept where compiled code is, in a folder of its owner only.

    Attributes:
        function: of a module; its leading `static` arguments are static, and have a `repr` that tells them apart.
        static: so many.
        options: the compiler's.
    """

    def __init__(self, function: Callable[..., Any], static: int = 0, **options: Any) -> None:
        self.function = function
        self.static = static
        self.options = options
        self._jitted = jax.jit(function, static_argnums=tuple(range(static)), compiler_options=options or None)
        self._ready: dict[Any, tuple[Callable[..., Any], Any]] = {}

    def __call__(self, *arguments: Any) -> Any:
        """The function's value. Within another transformation, and where nothing is kept, that of `jax.jit`."""
        folder = kept_folder()
        leaves, tree = jax.tree.flatten(arguments[self.static :])
        if folder is None or any(isinstance(leaf, Tracer) for leaf in leaves):
            return self._jitted(*arguments)
        arrays = [leaf if isinstance(leaf, jax.Array) else np.asarray(leaf) for leaf in leaves]
        shapes = tuple((array.shape, array.dtype.name) for array in arrays)
        key = arguments[: self.static], tree, shapes
        if key in self._ready:
            executable, structure = self._ready[key]
            return jax.tree.unflatten(structure, executable(*arrays))
        file = folder / f"{self._digest(key)}.executable"
        # a file that is absent, damaged, or does not run here: the function is traced
        with suppress(Exception):
            executable, structure = self._load(file, arrays)
            values = executable(*arrays)
            self._ready[key] = executable, structure
            return jax.tree.unflatten(structure, values)
        executable, structure = self._ready[key] = self._make(file, key, arrays)
        return jax.tree.unflatten(structure, executable(*arrays))

    def _make(self, file: Path, key: Any, arrays: list[Any]) -> tuple[Callable[..., Any], Any]:
        """The executable of flat arrays, and the structure of its flat result; the file keeps both."""
        static, tree, _ = key
        structures = []

        def flat(*leaves: Any) -> list[Any]:
            values, structure = jax.tree.flatten(self.function(*static, *jax.tree.unflatten(tree, leaves)))
            structures.append(structure)
            return values

        # A name of its own: what JAX's cache returns lacks, stored again, the code of its fusions on a processor.
        flat.__name__ = f"{self.function.__name__}_{secrets.token_hex(8)}"
        compiled = jax.jit(flat, compiler_options=self.options or None).lower(*arrays).compile()
        structure = structures[0]
        # a structure cannot be stored; a value that has it can
        example = jax.tree.unflatten(structure, range(structure.num_leaves))
        with suppress(InputError, OSError, ValueError):  # a full disk, or a backend without: the next process compiles
            content, _, _ = serialize_executable.serialize(compiled)
            write_atomically(file, pickle.dumps((content, example)), overwrite=True)
        return compiled, structure

    def _load(self, file: Path, arrays: list[Any]) -> tuple[Callable[..., Any], Any]:
        content, example = pickle.loads(file.read_bytes())
        structure = jax.tree.structure(example)
        called = jax.tree.structure((tuple(arrays), {}))
        returned = jax.tree.structure([0] * structure.num_leaves)
        device = jax.devices()[:1]
        return serialize_executable.deserialize_and_load(content, called, returned, execution_devices=device), structure

    def _digest(self, key: Any) -> str:
        """What an executable depends on, in one word: its function, shapes, source, libraries and machine."""
        static, tree, shapes = key
        device = jax.devices()[0]
        machine = platform.node(), platform.machine(), device.platform, device.device_kind
        function = self.function.__module__, self.function.__qualname__, sorted(self.options.items())
        identity = versions(), machine, function, static, str(tree), shapes
        return hashlib.sha256(repr(identity).encode()).hexdigest()
