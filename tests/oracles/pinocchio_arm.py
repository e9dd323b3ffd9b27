"""Arms as Pinocchio has them."""

import numpy as np
import pinocchio as pin


def pinocchio_chain(kinematics, sliding=()):
    """A model of x y z roll pitch yaw (joint, 6) without masses; `sliding` are the prismatic joints, from 0."""
    model, joint = pin.Model(), 0
    for x, y, z, *rpy in kinematics:
        placement = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array([x, y, z], float))
        kind = pin.JointModelPZ() if joint in sliding else pin.JointModelRZ()
        joint = model.addJoint(joint, kind, placement, f"joint{joint + 1}")
    return model


def pinocchio_poses(kinematics, positions):
    """(sample, 4, 4) poses of the last joint's frame at (sample, joint) rad."""
    model = pinocchio_chain(kinematics)
    data, poses = model.createData(), []
    for q in positions:
        pin.forwardKinematics(model, data, q)
        poses.append(data.oMi[model.njoints - 1].homogeneous)
    return np.array(poses)


def pinocchio_arm(kinematics, payload, inertia):
    """A model with the links' masses, and the payload on the last link; `inertia` as in `gravity_moments`."""
    model = pinocchio_chain(kinematics)
    held = (payload, inertia["payload_center"])
    bodies = [*zip(inertia["mass"], inertia["center_of_mass"], strict=True), held]
    for i, (mass, center) in enumerate(bodies):
        joint = min(i + 1, len(kinematics))
        model.appendBodyToJoint(joint, pin.Inertia(mass, center, np.zeros((3, 3))), pin.SE3.Identity())
    model.gravity.linear = inertia["gravity"]
    return model


def urdf_link_pose(path, link):
    """A function from joint positions to the link's (4, 4) pose in the frame of the URDF's root."""
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    frame = model.getFrameId(link)
    assert frame < model.nframes

    def pose(q):
        # A continuous joint's position is a point on the circle to Pinocchio.
        positions = []
        for joint, angle in zip(list(model.joints)[1:], q, strict=True):
            positions += [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
        pin.framesForwardKinematics(model, data, np.array(positions))
        return data.oMf[frame].homogeneous

    return pose
