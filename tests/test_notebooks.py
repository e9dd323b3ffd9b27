"""The notebooks: stored as they ran, in few bytes; all run and end in a figure."""

import ast
import base64
import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from docs.hooks import pictures
from docs.hooks.screens import difference

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
CELL_TIMEOUT_S = 600
OF_REAL_ARMS = ("06_a_real_arm", "07_torques", "09_a_printed_socket", "10_a_follower")
"""Stored with the outputs of data that are not in the repository, without which they run too."""
LARGEST = 155_000
"""Bytes of a notebook with its outputs."""
# nbclient, zmq and their event loop stay in a process of their own, as this one turns each warning into an error.
EXECUTE = f"""
import sys
import nbformat
from nbclient import NotebookClient

notebook = nbformat.read(sys.argv[1], as_version=4)
nbformat.validate(notebook)
NotebookClient(notebook, timeout={CELL_TIMEOUT_S}, kernel_name="python3").execute()
nbformat.write(notebook, sys.argv[2])
"""
MISSING = [name for name in ("nbclient", "ipykernel") if importlib.util.find_spec(name) is None]
needs_jupyter = pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}")
every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def cells_of(path, kind=None):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    return [cell for cell in cells if kind in (None, cell["cell_type"])]


def said_by(cell):
    """What a cell prints, without how long it took."""
    text = "".join("".join(output["text"]) for output in cell["outputs"] if output.get("name") == "stdout")
    return "\n".join(line for line in text.splitlines() if not re.search(r"\d s, +[\d.]+ ms ", line))


def drawn_by(cell):
    """The pictures of a cell, in PNG."""
    return [
        base64.b64decode(output["data"]["image/png"])
        for output in cell["outputs"]
        if "image/png" in output.get("data", {})
    ]


def execute(path, folder):
    """The finished process, and where it has written the notebook with its outputs."""
    executed = folder / "executed.ipynb"
    # the kernel draws into the notebook, with its own settings
    own = ("MPLBACKEND", "PYTHONWARNINGS", "JUPYTER_PATH", "LITE6JAX_REAL")
    environment = {name: value for name, value in os.environ.items() if name not in own}
    environment |= dict.fromkeys(("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR"), str(folder))
    environment |= {"IPYTHONDIR": str(folder), "JUPYTER_PLATFORM_DIRS": "1"}
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    process = subprocess.run(
        [sys.executable, "-c", EXECUTE, str(path), str(executed)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=2 * CELL_TIMEOUT_S,
    )
    return process, executed


@every_notebook
def test_it_is_small(path):
    assert path.stat().st_size <= LARGEST, "draw its figures smaller, or with fewer colours"


@every_notebook
def test_it_is_stored_as_it_ran(path):
    cells = cells_of(path, "code")
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1)), "run `make notebooks`"
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not [output for output in outputs if output["output_type"] == "error" or output.get("name") == "stderr"]
    shown = json.dumps([{k: v for k, v in output.items() if k != "data"} for output in outputs])
    assert "No real data" not in shown
    assert "/home" not in shown
    assert "/tmp" not in shown


@every_notebook
def test_it_imports_nothing_that_the_package_does_not_bring(path):
    for cell in cells_of(path, "code"):
        for node in ast.walk(ast.parse("".join(cell["source"]))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                top = name.split(".")[0]
                assert top != "lite6jax" or name == top, "only what lite6jax exports is public"
                assert top in {"lite6jax", "jax", "numpy", "scipy", "matplotlib"} | sys.stdlib_module_names


@needs_jupyter
@every_notebook
def test_it_runs_and_ends_with_a_figure_and_an_answer(path, tmp_path):
    process, executed = execute(path, tmp_path)
    assert process.returncode == 0, process.stderr[-4000:]
    code = cells_of(executed, "code")
    for cell in code:
        said = "".join("".join(out["text"]) for out in cell["outputs"] if out.get("name") == "stderr")
        assert "Warning:" not in said, said
    answer = code[-1]["outputs"]
    assert any("image/png" in output.get("data", {}) for output in answer)
    assert any(output.get("name") == "stdout" for output in answer)
    if path.stem not in OF_REAL_ARMS:
        for stored, now in zip(cells_of(path, "code"), code, strict=True):
            assert difference(said_by(stored), said_by(now)) == "", f"{stored['id']}: run `make notebooks`"
            for own, other in zip(drawn_by(stored), drawn_by(now), strict=True):
                assert pictures.difference(own, other) == "", f"{stored['id']}: run `make notebooks`"
