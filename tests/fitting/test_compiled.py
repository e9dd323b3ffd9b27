"""Functions kept between processes: traced once, equal, and safe against damaged or foreign files."""

import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

from lite6jax.fitting import code_folder, compiled
from lite6jax.fitting.compiled import Exported


class Pair(NamedTuple):
    first: object
    second: object


export.register_namedtuple_serialization(Pair, serialized_name="tests.Pair")
X = np.linspace(0, 1, 5)
ROOT = Path(__file__).resolve().parents[2]


class Counted:
    """A function of a static power, an array and a number, that counts how often it is traced."""

    def __init__(self):
        self.traced = 0

    def __call__(self, power, x, offset):
        self.traced += 1
        return Pair(jnp.sin(x) ** power, x + offset)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    kept = code_folder._private(tmp_path / "exported")
    monkeypatch.setattr(code_folder, "_exports", kept)
    return kept


def check(function, power=2, x=X, offset=3):
    found = function(power, x, offset)
    assert isinstance(found, Pair)
    np.testing.assert_allclose(found.first, np.sin(x) ** power, rtol=1e-14)
    np.testing.assert_allclose(found.second, x + offset, rtol=1e-15)


def kept(counted):
    return Exported("counted", counted, (0,))


def test_a_later_process_does_not_trace(folder):
    first, second = Counted(), Counted()
    check(kept(first))
    check(kept(second), offset=4)
    assert (first.traced, second.traced) == (1, 0)


def test_static_arguments_shapes_and_types_have_files_of_their_own(folder):
    counted = Counted()
    function = kept(counted)
    check(function)
    check(function, power=3)
    check(function, x=X[:3])
    check(function, offset=0.5)
    check(function)
    assert counted.traced == len(list(folder.iterdir())) == 4


@pytest.mark.parametrize("version", ["source", "jax"])
def test_another_version_is_traced_anew(folder, monkeypatch, version):
    check(kept(Counted()))
    monkeypatch.setattr(compiled, "_version", lambda: (version,))
    counted = Counted()
    check(kept(counted))
    assert counted.traced == 1


@pytest.mark.parametrize("damage", [lambda content: content[:-1], lambda content: b"", lambda content: b"x" * 4000])
def test_a_damaged_file_is_replaced(folder, damage):
    check(kept(Counted()))
    (path,) = folder.iterdir()
    good = path.read_bytes()
    path.write_bytes(damage(good))
    counted = Counted()
    check(kept(counted))
    assert counted.traced == 1
    assert compiled._read(path) is not None


def test_without_a_folder_it_is_the_jitted_function(monkeypatch):
    monkeypatch.setattr(code_folder, "_exports", None)
    counted = Counted()
    function = kept(counted)
    check(function)
    check(function)
    assert counted.traced == 1


def test_a_folder_that_refuses_files_costs_time_only(folder):
    folder.rmdir()
    check(kept(Counted()))


def test_the_folder_is_its_owners_only(tmp_path):
    made = code_folder._private(tmp_path / "made")
    assert made.stat().st_mode & 0o777 == 0o700
    made.chmod(0o777)
    assert code_folder._private(made) is None
    assert code_folder._private(tmp_path / "missing" / "made") is None


def test_without_flatbuffers_it_is_the_jitted_function(folder, monkeypatch):
    def missing(path):
        raise ImportError("flatbuffers")

    monkeypatch.setattr(compiled, "_read", missing)
    check(kept(Counted()))
    assert list(folder.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="POSIX permissions")
@pytest.mark.parametrize("spoilt", [None, "lite6jax", "lite6jax/jax"])
def test_the_cache_is_made_for_its_owner_and_not_used_where_others_can_write(tmp_path, spoilt):
    if spoilt:
        (tmp_path / spoilt).mkdir(parents=True)
        (tmp_path / spoilt).chmod(0o777)
    environment = {key: value for key, value in os.environ.items() if key != "JAX_COMPILATION_CACHE_DIR"}
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    code = (
        "import jax; from lite6jax.fitting import code_folder; code_folder.keep_compiled_code();"
        "print(jax.config.jax_compilation_cache_dir, code_folder._exports)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.stderr == ""
    if spoilt:
        assert done.stdout == "None None\n"
        return
    kept = tmp_path / "lite6jax"
    assert done.stdout == f"{kept / 'jax'} {kept / 'exported'}\n"
    assert [stat.S_IMODE((kept / name).stat().st_mode) for name in (".", "jax", "exported")] == [0o700] * 3
