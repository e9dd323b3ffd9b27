"""What takes time to import, imported where it is first used: commands that list or convert answer without waiting.

Commands name the modules of the package that they use within `import_lazily`. JAX alone takes half a second: modules
that describe arms and effects take `jax`, `jnp`, `lax`, `JaxArray` and `ArrayLike` from here, and modules that
compute import JAX itself. Where JAX is imported already, these are JAX's own.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import update_wrapper
from importlib import import_module
from importlib.abc import Loader
from threading import RLock
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeVar, cast

T = TypeVar("T")

_static: list[type] = []
"""Classes that `register_static` was given before JAX was imported."""

if TYPE_CHECKING or "jax" in sys.modules:
    import jax
    import jax.numpy as jnp
    from jax import Array as JaxArray
    from jax import lax
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
            self._function = function
            self._options = options
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

    class JaxArray(metaclass=_Arrays):
        """As `jax.Array` in annotations and for `isinstance`."""

    jax = _Module("jax")
    jnp = _Module("jax.numpy")
    lax = _Module("jax.lax")
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


class _LazyModule(ModuleType):  # a module that is executed when a name is wanted that only its code makes
    @property
    def __doc__(self) -> str | None:  # type: ignore[override]
        # every module has one from its beginning, None until its code is executed
        return self.__getattr__("__doc__")

    def __getattr__(self, name: str) -> Any:
        with _one_at_a_time:
            # within `import_lazily` a package is only asked for its modules
            lazily = any(isinstance(finder, _LazyLoader) for finder in sys.meta_path)
            module = cast(Any, self)
            loader = self.__loader__
            if isinstance(loader, _LazyLoader) and not lazily:
                module.__spec__.loader = module.__loader__ = loader.loader
                try:
                    loader.loader.exec_module(self)
                except BaseException:  # of its own imports: the next use says it again
                    module.__spec__.loader = module.__loader__ = loader
                    raise
                module.__class__ = ModuleType
        if name not in self.__dict__:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        return self.__dict__[name]


_one_at_a_time = RLock()


class _LazyLoader(Loader):
    """Finds the modules of this package as other finders do, and loads each as a `_LazyModule`."""

    def __init__(self, loader: Any = None) -> None:
        self.loader = loader

    def find_spec(self, name: str, path: Any, target: Any = None) -> Any:
        finders = []
        if name.startswith("lite6jax."):
            finders = [finder for finder in sys.meta_path if finder is not self]
        spec = next((located for finder in finders if (located := finder.find_spec(name, path, target))), None)
        if spec is not None and spec.loader is not None:
            spec.loader = _LazyLoader(spec.loader)
        return spec

    def exec_module(self, module: ModuleType) -> None:
        module.__class__ = _LazyModule


@contextmanager
def import_lazily() -> Iterator[None]:
    """Has modules of this package that are imported within executed when a name of them is first used.

    They are imported as modules, `from lite6jax.report import screen`: to import a name of one uses it.
    """
    finder = _LazyLoader()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


__all__ = ["ArrayLike", "JaxArray", "import_lazily", "jax", "jit", "jnp", "lax", "register_static"]
