"""No file of the engine names a joint, a pose, or a class of effects: other domains use it as it is."""

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "lite6jax"
ENGINE = sorted([*(PACKAGE / "estimation").glob("*.py"), *(PACKAGE / "search").glob("*.py")])
EFFECTS = {
    node.name
    for path in (PACKAGE / "effects").rglob("*.py")
    for node in ast.walk(ast.parse(path.read_text()))
    if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
}
WORDS = re.compile(r"\b(joints?|poses?|robots?|arms?|links?|encoders?|trackers?)\b", re.IGNORECASE)
GENERIC = {"Basis", "Domain", "Coordinate", "Estimate"}
"""Words of English as well."""


def named(source):
    """What a module names of robots: in identifiers, texts and comments alike."""
    classes = {name for name in EFFECTS - GENERIC if re.search(rf"\b{name}\b", source)}
    return {word.lower() for word in WORDS.findall(source)} | classes


@pytest.mark.parametrize("path", ENGINE, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_the_engine_names_no_robot(path):
    assert named(path.read_text()) == set()
