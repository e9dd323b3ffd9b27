"""Arms as Pinocchio has them: the oracle of what they hold, at rest and moving."""

import numpy as np
import pinocchio as pin


def pinocchio_arm(kinematics, payload, inertia):
    """A model with the payload on the last link."""
    model = pin.Model()
    joint = 0
    for (x, y, z, *rpy), m, c in zip(kinematics, inertia["mass"], inertia["center_of_mass"], strict=True):
        placement = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array([x, y, z]))
        joint = model.addJoint(joint, pin.JointModelRZ(), placement, f"joint{joint + 1}")
        model.appendBodyToJoint(joint, pin.Inertia(m, c, np.zeros((3, 3))), pin.SE3.Identity())
    held = pin.Inertia(payload, inertia["payload_center"], np.zeros((3, 3)))
    model.appendBodyToJoint(joint, held, pin.SE3.Identity())
    model.gravity.linear = inertia["gravity"]
    return model
