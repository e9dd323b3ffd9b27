"""XLA's work kept between calls, so that only the first on a machine waits for the compiler."""

import os
import sys
import warnings
from pathlib import Path

import jax


def keep_compiled_code() -> None:
    """Keeps XLA's work between calls in `cache_folder`, unless JAX was told where; in silence if it cannot."""
    # JAX_COMPILATION_CACHE_DIR, or a program that calls `main`
    if getattr(jax.config, "jax_compilation_cache_dir", None):
        return
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # RuntimeError: an account without a home
        return
    if not os.access(folder, os.W_OK):
        return
    warnings.filterwarnings("ignore", ".*persistent compilation cache", UserWarning)  # a full disk costs time only
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def cache_folder() -> Path:
    """Where this system keeps what programs can make again."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "lite6jax" / "jax"
