"""Each part of the package imports only parts above it, and the engine names no joint, no pose and no effect."""

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "lite6jax"
LIBRARY = [
    *("array_types", "interruption", "errors", "fields", "suffixes", "storage", "results", "progress", "threads"),
    *(
        "deferred",
        "few_shapes",
        "levenberg_marquardt",
        "arms",
        "formatting",
        "effects",
        "model",
        "sensors",
        "recordings",
    ),
    *("estimation", "search", "calibration", "domains", "design", "diagnosis", "simulation"),
]
"""What a program of a user imports."""
PROGRAMS = ["controller", "workers", "fleet", "emulator", "report", "cli"]
"""What is built on the library: a live arm, processes, folders of recordings, an emulated arm, pages and commands."""
PARTS = LIBRARY + PROGRAMS
MODULES = sorted(PACKAGE.rglob("*.py"))


def imported_parts(source, package):
    """The parts that a module of `package` (a tuple of names) imports; "" for the package's own top."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name.split(".") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = list(package[: len(package) - node.level + 1]) if node.level else []
            path = above + (node.module.split(".") if node.module else [])
            names = [[*path, alias.name] for alias in node.names]
        else:
            continue
        for name in names:
            if name[0] == "lite6jax":
                yield name[1] if len(name) > 1 and name[1] in PARTS else ""
            assert name[0] not in ("tests", "benchmarks"), f"the package imports {name[0]}"


def violations(source, part, package):
    """What a module of `part` imports and must not."""
    allowed = PARTS[: PARTS.index(part) + 1]
    return sorted({other or "lite6jax" for other in imported_parts(source, package)} - set(allowed))


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_go_upwards_only(path):
    package = path.relative_to(PACKAGE.parent).parts[:-1]
    if path == PACKAGE / "__init__.py":
        return  # the public names: it may know all
    part = path.relative_to(PACKAGE).with_suffix("").parts[0]
    assert part in PARTS, f"{part} has no place in the order of the parts"
    assert violations(path.read_text(), part, package) == []


@pytest.mark.parametrize("part", LIBRARY)
def test_the_library_names_nothing_that_is_built_on_it(part):
    """Not even as a text that is imported later; but for the public names, which may know all."""
    built_on_it = re.compile(rf"lite6jax\.({'|'.join(PROGRAMS)})\b")
    paths = [path for path in MODULES if path.relative_to(PACKAGE).with_suffix("").parts[0] == part]
    assert paths
    for path in paths:
        texts = [
            node.value
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.count("\n") == 0
        ]
        assert [text for text in texts if built_on_it.fullmatch(text.partition(":")[0])] == [], path


# ------------------------------------------------------------------ the engine, which other domains use as it is

ENGINE = sorted([*(PACKAGE / "estimation").glob("*.py"), *(PACKAGE / "search").glob("*.py")])
EFFECTS = {
    node.name
    for path in (PACKAGE / "effects").rglob("*.py")
    for node in ast.walk(ast.parse(path.read_text()))
    if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
}
WORDS = re.compile(r"\b(joints?|poses?|robots?|arms?|links?|encoders?|trackers?)\b", re.IGNORECASE)
GENERIC = {"Basis", "Domain", "Coordinate", "Estimate", "Kernel"}
"""Words of English as well."""


def named(source):
    """What a module names of robots: in identifiers, texts and comments alike."""
    classes = {name for name in EFFECTS - GENERIC if re.search(rf"\b{name}\b", source)}
    return {word.lower() for word in WORDS.findall(source)} | classes


@pytest.mark.parametrize("path", ENGINE, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_the_engine_names_no_robot(path):
    assert named(path.read_text()) == set()
