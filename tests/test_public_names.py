"""The public names resolve, type checkers see the same ones, and the import does only what its docstring says."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import lite6jax

SOURCE = Path(lite6jax.__file__)


def names_for_type_checkers():
    """The public names by module, as the imports under `if TYPE_CHECKING` have them."""
    block = next(node for node in ast.parse(SOURCE.read_text()).body if isinstance(node, ast.If))
    assert ast.unparse(block.test) == "TYPE_CHECKING"
    found = {}
    for node in block.body:
        assert all(alias.name == alias.asname for alias in node.names)  # only so are they exported
        found.setdefault(node.module, []).extend(alias.name for alias in node.names)
    return {module: tuple(names) for module, names in found.items()}


@pytest.mark.parametrize("name", lite6jax.__all__)
def test_each_public_name_resolves(name):
    assert getattr(lite6jax, name).__name__ == name
    assert name in dir(lite6jax)


def test_type_checkers_see_the_same_names():
    assert names_for_type_checkers() == lite6jax._NAMES
    assert len(set(lite6jax.__all__)) == len(lite6jax.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'lite6jax' has no attribute 'fitt'"):
        lite6jax.fitt  # noqa: B018


def test_the_import_enables_64_bit_floats_and_imports_nothing_that_takes_time():
    program = (
        "import sys, lite6jax, jax.numpy as jnp\n"
        "assert jnp.ones(1).dtype == 'float64'\n"
        "slow = ('lite6jax', 'scipy', 'pyarrow', 'matplotlib', 'pandas')\n"
        "print(*(name for name in sys.modules if name.split('.')[0] in slow))"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert set(run.stdout.split()) == {"lite6jax", "lite6jax.errors", "lite6jax.results"}
