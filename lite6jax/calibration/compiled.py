"""Compiled code kept between runs, and the versions of the source and the libraries that results depend on.

Nothing that computes is imported here, so that programs choose the folder as they start.
"""

import hashlib
import os
import sys
import warnings
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

SINGLE_THREADED = {"xla_cpu_multi_thread_eigen": False}
"""For functions that are called from several threads, which would otherwise share XLA's own pool."""

_PACKAGE = Path(__file__).parents[1]
_LIBRARIES = ("jax", "jaxlib", "numpy", "scipy", "pyarrow", "optimistix")


def keep_compiled_code() -> None:
    """Keeps compiled functions in `cache_folder`, unless JAX has a folder; without a word if it cannot.

    What is kept is code that later runs of the program execute: the folders are made for their owner only, and are not
    used where they belong to, or can be written by, somebody else.
    """
    try:
        folder = cache_folder()
    except RuntimeError:  # an account without a home
        return
    loaded = sys.modules.get("jax")
    from_environment = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    # JAX_COMPILATION_CACHE_DIR, or a folder of the program's; a process that this one starts has what is set here
    if (from_environment if loaded is None else loaded.config.jax_compilation_cache_dir) not in (None, "", str(folder)):
        return
    try:
        folder.parent.parent.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    if _private(folder.parent) is None or _private(folder) is None or not os.access(folder, os.W_OK):
        return
    warnings.filterwarnings("ignore", ".*persistent compilation cache", UserWarning)  # a full disk costs time only
    for name, value in (
        ("jax_compilation_cache_dir", str(folder)),
        ("jax_persistent_cache_min_compile_time_secs", 0),
        ("jax_persistent_cache_min_entry_size_bytes", -1),
    ):
        if loaded is not None:
            loaded.config.update(name, value)
        else:  # JAX reads it when it is first imported, which takes half a second that some commands do not need
            os.environ[name.upper()] = str(value)


def kept_folder() -> Path | None:
    """The folder of `keep_compiled_code` where JAX keeps compiled code there; None where it is another, or none."""
    loaded = sys.modules.get("jax")
    with suppress(RuntimeError):  # an account without a home
        folder = cache_folder()
        if loaded is None or not loaded.config.jax_enable_compilation_cache:
            return None
        if loaded.config.jax_compilation_cache_dir == str(folder):
            return folder
    return None


def cache_folder() -> Path:
    """Where this system keeps what programs can make again."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "lite6jax" / "jax"


def _private(folder: Path) -> Path | None:
    """The folder, made for its owner only; None where it belongs to, or can be changed by, somebody else."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.stat()
    except OSError:
        return None
    foreign = hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & 0o022)
    return None if foreign else folder


@cache
def versions() -> tuple[str, ...]:
    """The SHA-256 of the package's source and arms, and the versions of Python and the libraries."""
    digest = hashlib.sha256()
    for path in sorted(path for kind in ("*.py", "*.yaml") for path in _PACKAGE.rglob(kind)):
        digest.update(path.read_bytes())
    version_texts = [digest.hexdigest(), sys.version]
    for library in _LIBRARIES:
        try:
            version_texts.append(version(library))
        except PackageNotFoundError:
            version_texts.append("none")
    return tuple(version_texts)
