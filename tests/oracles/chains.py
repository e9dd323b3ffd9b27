"""Forward kinematics of serial chains in plain NumPy, all samples at once."""

import numpy as np

from tests.oracles.transforms import origin_transform, rotate, shift


def joint_frames(kinematics, positions):
    """Yields the (…, 4, 4) frame after each joint's rotation, of x y z roll pitch yaw (joint, 6) at (…, joint) rad."""
    T = np.eye(4)
    for row, q in zip(kinematics, np.moveaxis(np.asarray(positions), -1, 0), strict=True):
        T = T @ origin_transform(row) @ rotate("z", q)
        yield T


def six_parameter_poses(kinematics, positions):
    """(…, 4, 4) poses of the last joint's frame, of x y z roll pitch yaw (joint, 6) at (…, joint) rad."""
    *_, T = joint_frames(kinematics, positions)
    return T


def hayati_links(base, dh, betas):
    """The fixed transforms (4, 4) before the first joint and (joint, 4, 4) after each joint's rotation.

    `base` x, y, roll, pitch; `dh` (joint, 4) of theta, d, a, alpha; `betas` {joint from 0: beta}.
    """
    x, y, roll, pitch = base
    links = [
        rotate("z", theta) @ shift(a, 0, d) @ rotate("x", alpha) @ rotate("y", betas.get(i, 0.0))
        for i, (theta, d, a, alpha) in enumerate(dh)
    ]
    return shift(x, y, 0) @ rotate("y", pitch) @ rotate("x", roll), np.stack(links)


def hayati_poses(base, dh, betas, positions):
    """(…, 4, 4) at (…, joint) rad; the parameters as in `hayati_links`."""
    T, links = hayati_links(base, dh, betas)
    for link, q in zip(links, np.moveaxis(np.asarray(positions), -1, 0), strict=True):
        T = T @ rotate("z", q) @ link
    return T


def seed_model(parameters):
    """Base, table and betas, as `hayati_links` takes them, of the seed's 28 parameters of a Lite 6: d2 is not one."""
    return parameters[:4], np.insert(parameters[4:27], 5, 0.0).reshape(6, 4), {1: parameters[27]}


def seed_poses(parameters, positions):
    """(…, 4, 4) of the seed's 28 parameters at (…, 6) rad."""
    return hayati_poses(*seed_model(parameters), positions)
