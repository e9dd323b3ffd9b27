"""Compiled functions are kept in folders of their owner only; those that are kept are neither traced nor compiled."""

import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
import pytest

from lite6jax.calibration import executables

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="POSIX permissions")
@pytest.mark.parametrize("spoilt", [None, "lite6jax", "lite6jax/jax"])
def test_the_cache_is_made_for_its_owner_and_not_used_where_others_can_write(tmp_path, spoilt):
    if spoilt:
        (tmp_path / spoilt).mkdir(parents=True)
        (tmp_path / spoilt).chmod(0o777)
    environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    code = (
        "import jax; from lite6jax.calibration import compiled; compiled.keep_compiled_code();"
        "print(jax.config.jax_compilation_cache_dir)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.stderr == ""
    if spoilt:
        assert done.stdout == "None\n"
        return
    kept = tmp_path / "lite6jax"
    assert done.stdout == f"{kept / 'jax'}\n"
    assert [stat.S_IMODE((kept / name).stat().st_mode) for name in (".", "jax")] == [0o700] * 2


@pytest.mark.parametrize("own", ["", "own"])
def test_a_python_program_keeps_compiled_code_unless_it_has_a_folder_of_its_own(tmp_path, own):
    environment = {key: value for key, value in os.environ.items() if not key.startswith("JAX_")}
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    environment |= {"JAX_COMPILATION_CACHE_DIR": str(tmp_path / own)} if own else {}
    code = (
        "import sys, lite6jax; light = 'jax' not in sys.modules; lite6jax.read_factory; import jax;"
        "from lite6jax.calibration.compiled import kept_folder;"
        "print(light, jax.config.jax_compilation_cache_dir, kept_folder())"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.stderr == ""
    folder = tmp_path / (own or "lite6jax/jax")
    assert done.stdout == f"True {folder} {None if own else folder}\n"


# ------------------------------------------------------------------ executables

traced = []


class Pair(NamedTuple):
    """A result with names."""

    total: Any
    scaled: Any


def scale_sum(factor, values, more):
    """Of a module, as functions are whose executables are kept."""
    traced.append(factor)
    return Pair(values["a"].sum() + more, factor * values["a"])


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setattr(executables, "kept_folder", lambda: tmp_path)
    traced.clear()
    return tmp_path


def test_an_executable_is_kept_and_another_process_traces_nothing(kept):
    values = {"a": np.arange(4.0)}
    for trial in range(2):
        # a new object knows what a new process knows
        result = executables.KeptJit(scale_sum, 1)(3, values, 2)
        assert isinstance(result, Pair)
        assert float(result.total) == 8.0
        np.testing.assert_array_equal(result.scaled, 3 * values["a"])
        assert (traced, len(list(kept.iterdir()))) == ([3], 1), trial
    executables.KeptJit(scale_sum, 1)(4, values, 2)
    executables.KeptJit(scale_sum, 1)(3, {"a": np.arange(5.0)}, 2)
    assert traced == [3, 4, 3]


def test_a_damaged_executable_is_made_anew(kept):
    values = {"a": np.arange(4.0)}
    executables.KeptJit(scale_sum, 1)(3, values, 2)
    (file,) = kept.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    assert float(executables.KeptJit(scale_sum, 1)(3, values, 2).total) == 8.0
    assert traced == [3, 3]
    assert executables.KeptJit(scale_sum, 1)(3, values, 2).total == 8.0
    assert traced == [3, 3]


def test_nothing_is_kept_within_a_transformation_or_without_a_folder(kept, monkeypatch):
    keeping = executables.KeptJit(scale_sum, 1)
    slope = jax.grad(lambda a: keeping(3, {"a": a}, 2).total)(np.arange(4.0))
    np.testing.assert_array_equal(slope, np.ones(4))
    monkeypatch.setattr(executables, "kept_folder", lambda: None)
    assert float(keeping(3, {"a": np.arange(4.0)}, 2).total) == 8.0
    assert list(kept.iterdir()) == []
