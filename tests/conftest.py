"""What every test runs under: one compilation cache, the same random examples each time, types checked on request."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# LLVM's optimiser would take most of the suite's time, for functions that run on a hundred samples.
os.environ["XLA_FLAGS"] = " ".join([os.environ.get("XLA_FLAGS", ""), "--xla_backend_optimization_level=0"])

import hypothesis
import jax
import jaxtyping
import pytest

ROOT = Path(__file__).resolve().parents[1]
# Its constructor takes whatever numpy makes an array of, and refuses the rest itself, in one line.
UNCHECKED = {"lite6jax.arms.arm"}

if os.environ.get("CHECK_TYPES"):
    # Before anything imports the package: functions are instrumented as their modules load.
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts) for path in (ROOT / "lite6jax").rglob("*.py")}
    jaxtyping.install_import_hook(sorted(m for m in modules - UNCHECKED if "__" not in m), "beartype.beartype")

# A shell that runs this in the background has it ignore interrupts, and the commands that are interrupted here with it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=40)
hypothesis.settings.load_profile("repeatable")


def pytest_configure(config: pytest.Config) -> None:
    """XLA's work is kept between functions of equal code, and between runs (`--cache-clear` forgets it)."""
    cache = getattr(config, "cache", None)  # absent under -p no:cacheprovider
    if cache is None:
        return
    jax.config.update("jax_compilation_cache_dir", str(cache.mkdir("jax")))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


@pytest.fixture(scope="session")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Diagnosed recordings by name, `tests.corpus.Corpus`; imported here, after types are instrumented."""
    from tests.corpus import Corpus

    return Corpus(tmp_path_factory.mktemp("corpus"))


@pytest.fixture(scope="module", autouse=True)
def _few_mappings() -> Iterator[None]:
    """Linux lets a process have 65 530 mappings of memory; compiled functions take several each, and crash beyond."""
    yield
    mappings = Path("/proc/self/maps")
    if mappings.exists() and mappings.read_bytes().count(b"\n") > 40_000:
        jax.clear_caches()
