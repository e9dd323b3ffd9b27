"""The exit codes: one table in the documents, one in the code, and no number beside them."""

import ast
import re
from pathlib import Path

from lite6jax.cli import command

ROOT = Path(__file__).resolve().parents[1]
NAMED = {name: value for name, value in vars(command).items() if name.isupper() and type(value) is int}


def test_the_documented_table_is_that_of_the_code():
    rows = re.findall(r"^\| (\d+) \| (.+) \|$", (ROOT / "docs/reference/exit_codes.md").read_text(), re.MULTILINE)
    assert {int(code): meaning for code, meaning in rows} == dict(command.MEANINGS)
    assert len(rows) == len(NAMED)
    assert sorted(NAMED.values()) == sorted(command.MEANINGS)


def test_commands_return_named_codes_only():
    for path in (ROOT / "lite6jax/cli").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and node.name in ("run", "main"):
                returned = [child.value for child in ast.walk(node) if isinstance(child, ast.Return)]
                for value in filter(None, returned):
                    numbers = [
                        leaf for leaf in ast.walk(value) if isinstance(leaf, ast.Constant) and type(leaf.value) is int
                    ]
                    assert not numbers, ast.unparse(value)
