"""`lite6jax effects` and `lite6jax arms`: all that there is, from the catalogues and the descriptions themselves."""

import json

import numpy as np
import pytest
from rich.cells import cell_len
from typed import flat, run

from lite6jax.arms.description import bundled_arms, load_bundled
from lite6jax.effects import catalogue
from lite6jax.effects.drivers import QUANTITIES

WIDTHS = [40, 60, 200]


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
    made = catalogue.catalogue(3)
    for name in {effect.name for effect in made}:
        numbers = {unit.unit for effect in made if effect.name == name for unit in effect.coordinates}
        assert set(found["kinematic", name]["units"]) == numbers


@pytest.mark.parametrize("width", WIDTHS)
def test_effects_are_readable_on_any_terminal(capsys, width):
    code, out, _ = run(capsys, "effects", width=width)
    assert code == 0
    assert max(map(cell_len, out.splitlines())) <= width
    for name in (*catalogue.POSE_EFFECTS, *catalogue.TORQUE_EFFECTS):
        assert any(line.startswith(name) for line in out.splitlines()), name
    assert "the gear gives way to the torque that gravity" in flat(out)
    only = run(capsys, "effects", "--domain", "dynamic", width=width)[1]
    assert "joint_compliance" not in only
    assert "coulomb_friction" in only


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


@pytest.mark.parametrize("width", WIDTHS)
def test_arms_are_readable_on_any_terminal(capsys, width):
    code, out, _ = run(capsys, "arms", width=width)
    assert code == 0
    assert max(map(cell_len, out.splitlines())) <= width
    for name in bundled_arms():
        assert any(line.split()[:1] == [name] for line in out.splitlines()), name
    assert "".join(load_bundled("ur5").source.split()) in "".join(out.split())
