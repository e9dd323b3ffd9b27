"""Runs the notebooks and stores them with what they print and draw, in few bytes.

`python -m docs.hooks.notebooks [NAME…]` (`make notebooks`) renews all, or those whose names begin so. Real recordings,
which are not in the repository, are in the folder that LITE6JAX_REAL names; without it a notebook that asks for them is
left as it is.
"""

import base64
import os
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

from docs.hooks.pictures import in_few_colours

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
REAL = "LITE6JAX_REAL"
_TIMEOUT_S = 1800
_LONGEST = 2000
_KEPT = {"text/plain", "text/html", "image/png"}


def renewed(path: Path) -> nbformat.NotebookNode:
    """The notebook as it runs now, in an empty folder."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=_TIMEOUT_S, kernel_name="python3", resources=resources).execute()
    for cell in notebook.cells:
        cell.metadata = nbformat.NotebookNode()
        for output in cell.get("outputs", ()):
            output.get("metadata", {}).clear()
            if "data" in output:
                output.data = {kind: _small(kind, content) for kind, content in output.data.items() if kind in _KEPT}
                if len(output.data) > 1 and len(output.data.get("text/plain", "")) > _LONGEST:
                    del output.data["text/plain"]  # arrays that nobody reads, beside what is shown
    notebook.metadata = nbformat.NotebookNode(
        kernelspec={"display_name": "Python 3", "language": "python", "name": "python3"},
        language_info={"name": "python"},
    )
    return notebook


def _small(kind: str, content: Any) -> Any:
    """A picture with few colours; all else as it is."""
    if kind != "image/png":
        return content
    return base64.b64encode(in_few_colours(base64.b64decode(content))).decode()


def main(names: Sequence[str]) -> None:
    """Renews the notebooks whose names begin as one of `names`, or all."""
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    for path in NOTEBOOKS:
        if names and not path.stem.startswith(tuple(names)):
            continue
        if REAL in path.read_text(encoding="utf-8") and REAL not in os.environ:
            print(f"{path.name}: needs {REAL}; left as it is", file=sys.stderr)
            continue
        nbformat.write(renewed(path), path)
        print(f"{path.name}: {path.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
