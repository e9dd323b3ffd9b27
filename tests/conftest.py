"""What every test runs under: one compilation cache, the same random examples each time, types checked on request."""

import importlib.metadata
import importlib.util
import mmap
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import hypothesis
import jax
import jaxtyping
import pytest
import threadpoolctl

ROOT = Path(__file__).resolve().parents[1]
# The parts that take arrays from outside; the others' types are pyright's.
CHECKED = ("arms", "recordings")
# Its constructor takes whatever numpy makes an array of, and refuses the rest itself, in one line.
UNCHECKED = {"lite6jax.arms.arm"}

if os.environ.get("CHECK_TYPES"):
    # Before anything imports the package: functions are instrumented as their modules load.
    files = (path for part in CHECKED for path in (ROOT / "lite6jax" / part).rglob("*.py"))
    modules = {".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files}
    jaxtyping.install_import_hook(sorted(m for m in modules - UNCHECKED if "__" not in m), "beartype.beartype")

# Functions of a hundred samples take longer to compile than to run; LLVM's optimiser doubles that time, and so do XLA's
# fusion emitters. XLA ends the process at a flag that it does not know, as it does not know the second from jaxlib 0.12
# on, whose library still has its name.
QUICK = {"xla_backend_optimization_level=0": (1, 0), "xla_cpu_use_fusion_emitters=false": (0, 12)}
"""Flags, and the version of jaxlib from which each is not given."""


def quick_flags() -> Iterator[str]:
    """Those of `QUICK` that stand in jaxlib's library and that its version knows."""
    version = tuple(map(int, importlib.metadata.version("jaxlib").split(".")[:2]))
    flags = [flag for flag, end in QUICK.items() if version < end]
    for path in Path(str(importlib.util.find_spec("jaxlib").origin)).parent.glob("*jax_common.*"):
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as library:
            yield from (f"--{flag}" for flag in flags if library.find(flag.split("=")[0].encode()) >= 0)


if "PYTEST_XDIST_WORKER" not in os.environ:  # a worker has them of the process that started it
    os.environ["XLA_FLAGS"] = " ".join([os.environ.get("XLA_FLAGS", ""), *quick_flags()])

# Small matrix products on several threads wait for each other, in one process and more so in two: one thread each, of
# the library that is loaded already and of those that load later or in another process.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
threadpoolctl.threadpool_limits(int(os.environ["OPENBLAS_NUM_THREADS"]), "blas")

# A shell that runs this in the background has it ignore interrupts, and the commands that are interrupted here with it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

hypothesis.settings.register_profile("repeatable", derandomize=True, deadline=None, max_examples=20)
hypothesis.settings.load_profile("repeatable")


def pytest_configure(config: pytest.Config) -> None:
    """All processes and later runs share compiled code, of XLA and of Python; `--cache-clear` removes it."""
    cache = getattr(config, "cache", None)  # absent under -p no:cacheprovider
    if cache is None:
        return
    kept = {
        "jax_compilation_cache_dir": str(cache.mkdir("jax")),
        "jax_persistent_cache_min_compile_time_secs": 0,
        "jax_persistent_cache_min_entry_size_bytes": 0,
    }
    for name, value in kept.items():
        jax.config.update(name, value)
        os.environ[name.upper()] = str(value)  # for the processes that tests start
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):  # then each of them would compile what it imports, for seconds
        sys.dont_write_bytecode = False
        sys.pycache_prefix = os.environ["PYTHONPYCACHEPREFIX"] = str(cache.mkdir("bytecode"))


@pytest.fixture(scope="session")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Diagnosed recordings by name, `tests.corpus.Corpus`; imported here, after types are instrumented."""
    from tests.corpus import Corpus

    return Corpus(tmp_path_factory.mktemp("corpus"))


def without_pictures(patch: pytest.MonkeyPatch) -> None:
    """Pages of a diagnosis without their pictures, where only text is read: painting them takes seconds."""
    from lite6jax.report.sections import Picture  # after types are instrumented

    patch.setattr("lite6jax.report.pages._picture", lambda _, caption: Picture("data:,", caption, False))


@pytest.fixture
def unpainted(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `without_pictures`, in one test."""
    without_pictures(monkeypatch)


@pytest.fixture(scope="module", autouse=True)
def _few_mappings() -> Iterator[None]:
    """Linux lets a process have 65 530 mappings of memory; compiled functions take several each, and crash beyond."""
    yield
    mappings = Path("/proc/self/maps")
    if mappings.exists() and mappings.read_bytes().count(b"\n") > 40_000:
        jax.clear_caches()
