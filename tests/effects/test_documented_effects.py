"""The effects of a user's own that the documents show: they need public names only, load, and do what they say."""

import ast
import re

import numpy as np

import lite6jax
from docs.hooks import made
from lite6jax.effects import drivers, user_effects

BLOCKS = re.findall(r"```python\n(.*?)```", user_effects.__doc__, re.DOTALL)
ALL = "\n".join([*BLOCKS, "EFFECTS = [CableDrag(2), LinkSag(3), AirDrag(4), AirDrag(3, of_slide=True)]\n"])


def test_the_documents_show_each_of_them():
    assert [made.own_effect(place).split("\n", 1)[1] for place in range(3)] == [f"{block}```" for block in BLOCKS]


def test_they_import_public_names_only():
    imported = [node for node in ast.walk(ast.parse(ALL)) if isinstance(node, ast.Import | ast.ImportFrom)]
    ours = [node for node in imported if "lite6jax" in ast.unparse(node)]
    assert {node.module for node in ours} == {"lite6jax"}
    assert {alias.name for node in ours for alias in node.names} <= set(lite6jax.__all__)


def test_a_file_of_all_of_them_is_read_and_simulated(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(ALL)
    drag, sag, air, force = lite6jax.load_effects(path)
    assert [drag.label, sag.label, air.label] == ["cable_drag:joint2", "link_sag:link3", "air_drag:joint4"]
    assert (force.own_driver("velocity").unit, air.own_driver("velocity").unit) == ("m/s", "rad/s")
    perfect = lite6jax.UndeclaredNoise(factor=0)
    rigid, sunk = (
        lite6jax.simulate("lite6", effects=effects, samples=20, payload=2.0, undeclared=perfect)
        for effects in ([], [(sag, [1e-3])])
    )
    np.testing.assert_allclose(np.linalg.norm(sunk.position - rigid.position, axis=1), 2e-3, rtol=0, atol=1e-12)


def test_the_table_of_drivers_has_each_one_with_its_unit():
    lines = [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in made.driver_table().splitlines()[2:]]
    assert sorted(line[0] for line in lines) == sorted(drivers.QUANTITIES)
    assert all(cell for line in lines for cell in line)
    by_name = {line[0]: line for line in lines}
    assert by_name["gravity torque"][1:4] == ["τ", "Nm", "joint"]
    assert by_name["time"][2:4] == ["s", "whole arm"]
