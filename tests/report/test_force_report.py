"""Reports on forces of prismatic joints beside torques, and on an arm of prismatic joints alone."""

import re

import matplotlib.pyplot as plt
import numpy as np
from domains.torque import slid
from report.torque_diagnosed import diagnosed as undetected

from lite6jax.arms.arm import Arm
from lite6jax.arms.dynamics import inverse_dynamics, link_parameters
from lite6jax.effects.dynamic import PayloadTorque, ViscousFriction
from lite6jax.recordings import Recording
from lite6jax.report.diagnosis_figures import drawings, ranking_figure
from lite6jax.report.ranking import contribution, headline, remedy_of
from lite6jax.report.statements import with_statements
from tests.oracles import kane


def test_an_arm_of_slides_alone_is_said_in_newtons():
    arm = Arm(
        "gantry",
        np.array([[0, 0, 0.5, 0, slid.HALF, 0], [0, 0, 0, -slid.HALF, 0, 0], [0, 0, 0, 0, slid.HALF, 0]]),
        joint_limits=np.tile([-1.0, 1.0], (3, 1)),
        mass=np.array([5.0, 3.0, 2.0]),
        center_of_mass=np.zeros((3, 3)),
        inertia=np.tile(1e-3 * np.eye(3), (3, 1, 1)),
        sliding=(0, 1, 2),
    )
    t, q, dq, ddq = slid.moved()
    rng = np.random.default_rng(0)
    forces = np.array(inverse_dynamics(arm.kinematics, link_parameters(arm), q.T, dq.T, ddq.T, kane.GRAVITY, (0, 1, 2)))
    forces[1] += 30 * dq[:, 1]
    recording = Recording.from_arrays(
        q, time=t, joint_velocity=dq, joint_torque=(forces + rng.normal(0, 0.2, forces.shape)).T, sliding=(0, 1, 2),
        motion="trajectory", torque_noise_Nm=(0.2, 0.2, 0.2), torque_source="measured",
    )  # fmt: skip
    found = undetected(recording, (ViscousFriction(2, of_slide=True),), arm=arm)
    document = with_statements(found.to_dict())
    assert not [key for key in document["before"] if key.endswith("_Nm") and "by_joint" not in key]
    assert re.match(
        r"Joint 2 rubs the more the faster it moves: \d+ of \d+ N; with it in the model,", headline(document)
    )
    assert re.search(r"held-out torque errors of the joints are [\d., e-]+ N RMS with these effects", found.summary())
    figures = dict(drawings(found, "gantry"))
    assert "(N RMS)" in figures["error_by_joint"].axes[0].get_ylabel()
    assert figures["friction"].axes[1].get_xlabel() == "velocity of joint 2 (mm/s)"
    assert figures["friction"].axes[1].get_ylabel() == "force left at joint 2 (N)"
    assert figures["findings"].axes[0].get_ylabel() == "force at joint 2 (N)"
    assert figures["findings"].axes[0].get_xlabel() == "slide velocity of joint 2 (mm/s)"
    for figure in figures.values():
        plt.close(figure)


def test_what_moves_both_kinds_is_said_in_both_units():
    found = undetected(
        slid.recorded(slid.friction), (PayloadTorque(), ViscousFriction(3, of_slide=True)), arm=slid.arm()
    )
    document = with_statements(found.to_dict())
    payload, friction = document["findings"]
    assert {"moves_rms_Nm", "moves_rms_N"} <= set(payload)
    assert re.search(r"contributes \S+ Nm RMS to the torque and \S+ N RMS to the force\.", payload["statement"])
    assert " Nm and " in contribution(document, payload)
    assert contribution(document, friction).endswith(" N")
    label = ranking_figure(document, "telescope").axes[0].get_xlabel()
    assert label == "moves the torque or the force (RMS over the error before, largest: 1)"
    assert remedy_of(friction, torques=True).action.startswith(
        "Check the lubrication of the screw, the belt or the guide"
    )
