"""`lite6jax effects` and `lite6jax arms`: all that there is, from the catalogues and the descriptions themselves."""

import json
import re

import numpy as np
import pytest
from rich.cells import cell_len
from typed import run

from lite6jax.arms.description import bundled_arms, load_bundled
from lite6jax.effects import catalogue
from lite6jax.effects.drivers import QUANTITIES


def test_every_effect_of_both_catalogues_is_listed(capsys):
    code, out, _ = run(capsys, "effects", "--json")
    assert code == 0
    listed = json.loads(out)
    assert [(entry["domain"], entry["name"]) for entry in listed] == [
        *(("kinematic", name) for name in catalogue.POSE_EFFECTS),
        *(("dynamic", name) for name in catalogue.TORQUE_EFFECTS),
    ]
    found = {(entry["domain"], entry["name"]): entry for entry in listed}
    assert found["kinematic", "joint_compliance"] == {
        "domain": "kinematic",
        "name": "joint_compliance",
        "sites": ["jointN"],
        "drivers": ["gravity torque"],
        "parameters": ["compliance_rad_per_Nm"],
        "units": ["rad/Nm"],
        "description": "δq = c·τ: the gear gives way to the torque that gravity exerts on it.",
    }
    assert found["kinematic", "link_thermal_expansion"]["sites"] == ["links", "linkN"]
    assert found["dynamic", "coupled_friction"]["drivers"] == ["velocity"]
    assert found["dynamic", "stribeck_friction"]["parameters"] == ["stribeck_Nm", "velocity_rad_per_s"]
    for (_, name), entry in found.items():
        assert entry["description"].endswith("."), name
        assert set(entry["drivers"]) <= {*QUANTITIES, "any"}, name
        assert entry["sites"], name
        assert bool(entry["units"]) == (name != "unnamed"), name
    only = json.loads(run(capsys, "effects", "--domain", "dynamic", "--json")[1])
    assert {entry["name"] for entry in only} == {*catalogue.TORQUE_EFFECTS}
    made = catalogue.catalogue(3)
    for name in {effect.name for effect in made}:
        numbers = {unit.unit for effect in made if effect.name == name for unit in effect.coordinates}
        assert set(found["kinematic", name]["units"]) == numbers


@pytest.mark.parametrize("width", [40, 60, 200])
@pytest.mark.parametrize(
    ("command", "names", "text"),
    [
        ("effects", (*catalogue.POSE_EFFECTS, *catalogue.TORQUE_EFFECTS), "the gear gives way to the torque"),
        ("arms", bundled_arms(), load_bundled("ur5").source),
    ],
)
def test_a_list_is_readable_on_any_terminal(capsys, width, command, names, text):
    code, out, _ = run(capsys, command, width=width)
    assert code == 0
    assert max(map(cell_len, out.splitlines())) <= width
    for name in names:
        assert any(re.match(rf"{name}\b", line) for line in out.splitlines()), name
    assert "".join(text.split()) in "".join(out.split())


def test_every_bundled_arm_is_listed_as_its_description_has_it(capsys):
    code, out, _ = run(capsys, "arms", "--json")
    assert code == 0
    listed = {entry["name"]: entry for entry in json.loads(out)}
    assert tuple(listed) == bundled_arms()
    for name, entry in listed.items():
        arm = load_bundled(name)
        assert (entry["joints"], entry["inertia"], entry["source"]) == (arm.dof, arm.inertia is not None, arm.source)
        offsets = [*arm.kinematics[:, :3], arm.T_joint_flange[:3, 3]]
        assert entry["reach_m"] == pytest.approx(sum(map(np.linalg.norm, offsets)), abs=1e-4)
        assert entry["maker"] == ("Universal Robots" if name.startswith("ur") else "UFACTORY")
