"""Functions kept between processes: traced once, equal, and in folders of their owner only."""

import os
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

from lite6jax.fitting import compiled
from lite6jax.fitting.compiled import Exported


class Pair(NamedTuple):
    first: object
    second: object


export.register_namedtuple_serialization(Pair, serialized_name="tests.Pair")
X = np.linspace(0, 1, 5)
ROOT = Path(__file__).resolve().parents[2]


def counted():
    """A function of a static power, an array and a number, and a list that grows as it is traced."""
    traced = []

    def function(power, x, offset):
        traced.append(power)
        return Pair(jnp.sin(x) ** power, x + offset)

    return Exported(function, 1), traced


@pytest.fixture
def folder(tmp_path, monkeypatch):
    kept = compiled._private(tmp_path / "exported")
    monkeypatch.setattr(compiled, "_exports", kept)
    return kept


def check(function, power=2, x=X, offset=3):
    found = function(power, x, offset)
    assert isinstance(found, Pair)
    np.testing.assert_allclose(found.first, np.sin(x) ** power, rtol=1e-14)
    np.testing.assert_allclose(found.second, x + offset, rtol=1e-15)


@pytest.mark.parametrize("change", [None, "versions"])
def test_a_later_process_traces_only_what_another_version_kept(folder, monkeypatch, change):
    first, traced_first = counted()
    check(first)
    if change:
        monkeypatch.setattr(compiled, "versions", lambda: ("another",))
    second, traced_second = counted()
    check(second, offset=4)
    assert (len(traced_first), len(traced_second)) == (1, 1 if change else 0)


def test_static_arguments_shapes_and_types_have_files_of_their_own(folder):
    function, traced = counted()
    for given in ({}, {"power": 3}, {"x": X[:3]}, {"offset": 0.5}, {}):
        check(function, **given)
    assert len(traced) == len(list(folder.iterdir())) == 4


@pytest.mark.parametrize("kept", [None, "a folder that is gone"])
def test_where_nothing_can_be_kept_it_is_the_jitted_function_in_every_thread(monkeypatch, tmp_path, kept):
    monkeypatch.setattr(compiled, "_exports", tmp_path / kept if kept else None)
    function, traced = counted()
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda _: check(function), range(8)))
    assert len(traced) == 1


def test_the_folder_is_its_owners_only(tmp_path):
    made = compiled._private(tmp_path / "made")
    assert made.stat().st_mode & 0o777 == 0o700
    made.chmod(0o777)
    assert compiled._private(made) is None
    assert compiled._private(tmp_path / "missing" / "made") is None


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="POSIX permissions")
@pytest.mark.parametrize("spoilt", [None, "lite6jax", "lite6jax/jax"])
def test_the_cache_is_made_for_its_owner_and_not_used_where_others_can_write(tmp_path, spoilt):
    if spoilt:
        (tmp_path / spoilt).mkdir(parents=True)
        (tmp_path / spoilt).chmod(0o777)
    environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    code = (
        "import jax; from lite6jax.fitting import compiled; compiled.keep_compiled_code();"
        "print(jax.config.jax_compilation_cache_dir, compiled._exports)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.stderr == ""
    if spoilt:
        assert done.stdout == "None None\n"
        return
    kept = tmp_path / "lite6jax"
    assert done.stdout == f"{kept / 'jax'} {kept / 'exported'}\n"
    assert [stat.S_IMODE((kept / name).stat().st_mode) for name in (".", "jax", "exported")] == [0o700] * 3
