"""The folder of compiled code in the user's cache. Nothing is imported for it: programs choose it as they start."""

import os
import sys
import warnings
from pathlib import Path

_exports: Path | None = None


def exports() -> Path | None:
    """Where this process keeps exported functions; None keeps none."""
    return _exports


def keep_compiled_code() -> None:
    """Keeps compiled and exported functions in `cache_folder`, unless JAX has a folder; without a word if it cannot.

    What is kept is code that later runs of the program execute: the folders are made for their owner only, and are not
    used where they belong to, or can be written by, somebody else.
    """
    global _exports
    try:
        folder = cache_folder()
    except RuntimeError:  # an account without a home
        return
    # JAX_COMPILATION_CACHE_DIR, or a program that calls `main`; a process that this one starts has what is set here
    if _jax_folder() not in (None, "", str(folder)):
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
        if "jax" in sys.modules:
            sys.modules["jax"].config.update(name, value)
        else:  # JAX reads it when it is first imported, which takes half a second that some commands do not need
            os.environ[name.upper()] = str(value)
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


def _jax_folder() -> str | None:
    if "jax" in sys.modules:
        return getattr(sys.modules["jax"].config, "jax_compilation_cache_dir", None)
    return os.environ.get("JAX_COMPILATION_CACHE_DIR")


def _private(folder: Path) -> Path | None:
    """The folder, made for its owner only; None where it belongs to, or can be changed by, somebody else."""
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.stat()
    except OSError:
        return None
    foreign = hasattr(os, "getuid") and (found.st_uid != os.getuid() or found.st_mode & 0o022)
    return None if foreign else folder
