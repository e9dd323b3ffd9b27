"""Compiled functions are kept in folders of their owner only."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

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
