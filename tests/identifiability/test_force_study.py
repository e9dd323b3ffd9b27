"""What motions determine of an arm with a prismatic joint, and which to make: in N, m and kg."""

import numpy as np
import pytest
from domains.torque import slid

from lite6jax.arms.description import write_arm
from lite6jax.cli import main
from lite6jax.cli.torque_study import TorqueSetup
from lite6jax.effects.dynamic.catalogue import BUILT_IN
from lite6jax.effects.dynamic.friction import ViscousFriction
from lite6jax.effects.serialization import parse_effect
from lite6jax.errors import InputError
from lite6jax.identifiability.torque.columns import torque_model
from lite6jax.identifiability.torque.discrimination import rival_of
from lite6jax.identifiability.torque.fourier import Motion, motion_limits
from lite6jax.identifiability.torque.identify import identify_torques, structure_of
from lite6jax.identifiability.torque.planning import plan_motion
from lite6jax.report.study import torque_identification_report, torque_plan_report


def test_a_study_of_a_slide_has_its_units(tmp_path, capsys):
    arm = str(write_arm(slid.arm(), tmp_path / "telescope.yaml"))
    assert main(["identify", arm, "--torque"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "±0.05 Nm, 0.05 Nm, 0.5 N (one standard deviation" in said
    assert "of prismatic joints, P: N·s/m, N, N, kg" in said
    assert "J3 P " in said
    model = torque_model(slid.arm())
    structure = structure_of(model)
    units = {item.name: item.unit for item in structure.base}
    assert units["joint3 viscous"] == "N·s/m"
    assert units["joint3 rotor inertia"] == "kg"
    assert units["joint2 Coulomb"] == "Nm"
    q, dq, ddq = slid.moved(seconds=4.0)[1:]
    few = identify_torques(model, Motion(*(part.T * [[1], [1], [0.04]] for part in (q, dq, ddq))), structure=structure)
    assert few.narrow() == [(2, pytest.approx(0.04 * np.ptp(q[:, 2])))]
    text = " ".join(str(part) for part in torque_identification_report(few, "a", "b"))
    assert "No joint" not in text


def test_limits_of_a_designed_motion_are_those_of_each_joint():
    limits = motion_limits(slid.arm(), np.pi, [2.0, 3.0, 0.5], margin=0.05)
    np.testing.assert_allclose(limits.velocity, [np.pi, np.pi, 0.1 * np.pi])
    np.testing.assert_allclose(limits.acceleration, [2.0, 3.0, 0.5])
    np.testing.assert_allclose(limits.position[2], [0.005, 0.395])
    setup = TorqueSetup(torque=True, velocity=(90.0, 90.0, 250.0), acceleration=(600.0,), duration=4.0)
    room = setup.room(slid.arm())
    np.testing.assert_allclose(room.limits.velocity, [np.pi / 2, np.pi / 2, 0.25])
    np.testing.assert_allclose(room.limits.acceleration[2], np.deg2rad(600) * 0.1)
    model = torque_model(slid.arm(), inertial=False)
    plan = plan_motion(model, room, draws=3, starts=1, steps=2)
    assert (np.abs(plan.trajectory.motion.dq).max(1) <= room.limits.velocity * (1 + 1e-9)).all()
    text = " ".join(str(part) for part in torque_plan_report(plan, (), "telescope"))
    assert "up to 90 deg/s and 250 mm/s and 600 deg/s² and 1047 mm/s²" in " ".join(text.split())
    parsed = parse_effect("viscous_friction:joint=3,viscous_N_s_per_m=10", BUILT_IN, sliding=(2,))
    rival = rival_of(*parsed, model)
    added = rival.columns(plan.trajectory.motion)
    np.testing.assert_allclose(added[2, 0], plan.trajectory.motion.dq[2])
    with pytest.raises(InputError, match="is of a revolute joint, and joint 3 is prismatic; give of_slide=True"):
        rival_of(ViscousFriction(3), [1.0], model)
