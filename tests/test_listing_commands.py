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


def test_every_effect_of_all_catalogues_is_listed(capsys):
    code, out, _ = run(capsys, "effects", "--json")
    assert code == 0
    listed = json.loads(out)
    assert [(entry["domain"], entry["name"]) for entry in listed] == [
        *(("kinematic", name) for name in catalogue.POSE_EFFECTS),
        *(("dynamic", name) for name in catalogue.TORQUE_EFFECTS),
        *(("tracking", name) for name in catalogue.TRACKING_EFFECTS),
    ]
    found = {(entry["domain"], entry["name"]): entry for entry in listed}
    assert found["kinematic", "joint_compliance"] == {
        "domain": "kinematic",
        "name": "joint_compliance",
        "sites": ["jointN"],
        "drivers": ["gravity torque"],
        "parameters": ["compliance_rad_per_Nm"],
        "possible": [[0.0, 0.001]],
        "units": ["rad/Nm"],
        "description": "δq = c·τ: the gear gives way to the torque that gravity exerts on it.",
        "in_simulators": {"mujoco": "", "isaac_lab": "", "urdf": ""},
        "resembles": [],
    }
    assert found["kinematic", "link_thermal_expansion"]["sites"] == ["links", "linkN"]
    assert found["dynamic", "coupled_friction"]["drivers"] == ["velocity"]
    assert found["dynamic", "stribeck_friction"]["parameters"] == ["stribeck_Nm", "velocity_rad_per_s"]
    for (_, name), entry in found.items():
        assert entry["description"].endswith("."), name
        assert set(entry["drivers"]) <= {*QUANTITIES, "any"}, name
        assert entry["sites"], name
        assert bool(entry["units"]) == (name != "unnamed"), name
    for domain, effects in (("dynamic", catalogue.TORQUE_EFFECTS), ("tracking", catalogue.TRACKING_EFFECTS)):
        only = json.loads(run(capsys, "effects", "--domain", domain, "--json")[1])
        assert [entry["name"] for entry in only] == [*effects]
    made = catalogue.catalogue(3)
    for name in {effect.name for effect in made}:
        numbers = {unit.unit for effect in made if effect.name == name for unit in effect.coordinates}
        assert set(found["kinematic", name]["units"]) == numbers


def test_an_effect_on_servos_has_its_law_numbers_and_simulator_parameters(capsys):
    listed = {entry["name"]: entry for entry in json.loads(run(capsys, "effects", "--domain", "tracking", "--json")[1])}
    delay = listed["command_delay"]
    assert delay["sites"] == ["jointN"]
    assert (delay["parameters"], delay["possible"], delay["units"]) == (["delay_s"], [[-0.02, 0.3]], ["s"])
    assert listed["time_offset"]["sites"] == ["clock"]
    assert listed["dead_band"]["description"].startswith("e ← e − clip(e, ±w)")
    # the coordinate of a ratio is its logarithm, and that of a limit its reciprocal
    assert (listed["servo_stiffness"]["parameters"], listed["servo_stiffness"]["possible"]) == (
        ["ratio"],
        [[0.1, 10.0]],
    )
    assert listed["rate_limit"]["parameters"] == ["velocity_rad_per_s"]
    assert listed["torque_limit"]["possible"] == [[0.001, None]]
    assert listed["joint_spring"]["possible"] == [[0.0, 10000.0], [None, None]]
    mujoco = {
        "servo_stiffness": "kp",
        "servo_damping": "kv",
        "torque_limit": "forcerange",
        "coulomb_friction": "frictionloss",
        "viscous_friction": "damping",
        "rotor_inertia": "armature",
    }
    assert {name: listed[name]["in_simulators"]["mujoco"] for name in mujoco} == mujoco
    assert set(listed["servo_integral"]["in_simulators"].values()) == {""}
    _, out, _ = run(capsys, "effects", "--domain", "tracking", width=200)
    paragraph = out.partition("\nservo_stiffness\n")[2].partition("\nservo_damping\n")[0]
    assert "MuJoCo: kp; Isaac Lab: stiffness." in paragraph
    assert "Numbers: ratio, 0.1 to 10." in paragraph
    assert "Looks like payload_error" in paragraph


def test_what_looks_like_an_effect_looks_like_each_other(capsys):
    listed = {entry["name"]: entry for entry in json.loads(run(capsys, "effects", "--domain", "tracking", "--json")[1])}
    alike = {
        name: {(other, group["told_apart"]) for group in entry["resembles"] for other in group["effects"]}
        for name, entry in listed.items()
    }
    assert {other for others in alike.values() for other, _ in others} <= {*listed}
    assert {name for name, others in alike.items() if not others} == {"unnamed"}
    for name, others in alike.items():
        for other, told_apart in others:
            assert (name, told_apart) in alike[other]
    assert any("torques" in motion for other, motion in alike["servo_damping"] if other == "viscous_friction")
    assert any("reversals" in motion for other, motion in alike["dead_band"] if other == "backlash")


@pytest.mark.parametrize("width", [40, 60, 200])
@pytest.mark.parametrize(
    ("command", "names", "text"),
    [
        (
            "effects",
            (*catalogue.POSE_EFFECTS, *catalogue.TORQUE_EFFECTS, *catalogue.TRACKING_EFFECTS),
            "the gear gives way to the torque",
        ),
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
