"""Pinocchio as an oracle: the pose of a link of a URDF."""

import numpy as np
import pinocchio


def flange_of(path, link):
    """A function from joint positions to the link's (4, 4) pose in the frame of the URDF's root."""
    model = pinocchio.buildModelFromUrdf(str(path))
    data = model.createData()
    frame = model.getFrameId(link)
    assert frame < model.nframes

    def pose(q):
        # A continuous joint's position is a point on the circle to Pinocchio.
        positions = []
        for joint, angle in zip(list(model.joints)[1:], q, strict=True):
            positions += [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
        pinocchio.framesForwardKinematics(model, data, np.array(positions))
        return data.oMf[frame].homogeneous

    return pose
