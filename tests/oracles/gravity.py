"""Gravity's moments about the frames of a serial chain in plain NumPy."""

import numpy as np

from tests.oracles.chains import joint_frames

GRAVITY = np.array([0.3, -0.4, -9.7])  # of an arm that does not stand upright


def random_inertia(rng, dof):
    """Masses of every link, none of them at the joint's origin."""
    return {
        "mass": rng.uniform(0.2, 2, dof),
        "center_of_mass": rng.uniform(-0.2, 0.2, (dof, 3)),
        "payload_center": rng.uniform(-0.1, 0.1, 3),
        "gravity": GRAVITY,
    }


def mass_points(kinematics, positions, payload, inertia):
    """Where each link's mass and the payload's is, (…, joint + 1, 3) m in the base's axes, and (…, joint + 1) kg."""
    frames = np.stack(list(joint_frames(kinematics, positions)), -3)
    frames = np.concatenate([frames, frames[..., -1:, :, :]], -3)
    centers = np.vstack([inertia["center_of_mass"], inertia.get("payload_center", np.zeros(3))])
    points = np.einsum("...jab,jb->...ja", frames[..., :3, :3], centers) + frames[..., :3, 3]
    payload = np.broadcast_to(payload, points.shape[:-2])[..., None]
    masses = np.broadcast_to(inertia["mass"], (*points.shape[:-2], len(kinematics)))
    return points, np.concatenate([masses, payload], -1)


def gravity_moments(kinematics, positions, payload, inertia):
    """(…, joint, 3) N·m about each joint's frame in its axes, of all that hangs behind it; (…, 3) about the base's.

    Args:
        kinematics: (joint, 6) x y z roll pitch yaw.
        positions: (…, joint) rad.
        payload: (…) kg.
        inertia: `mass`, `center_of_mass`, `gravity` and, with a payload, `payload_center`; see `random_inertia`.
    """
    points, masses = mass_points(kinematics, positions, payload, inertia)
    force = masses[..., None] * inertia["gravity"]
    moments = []
    for i, T in enumerate(joint_frames(kinematics, positions)):
        about = np.cross(points[..., i:, :] - T[..., None, :3, 3], force[..., i:, :]).sum(-2)
        moments.append(np.einsum("...ba,...b->...a", T[..., :3, :3], about))
    return np.stack(moments, -2), np.cross(points, force).sum(-2)


def payload_moments(kinematics, positions, payload, inertia):
    """(…, 3) N·m of the payload alone about the last joint's frame, in its axes; arguments as of `gravity_moments`."""
    T = list(joint_frames(kinematics, positions))[-1]
    weight = payload[..., None] * np.einsum("...ba,b->...a", T[..., :3, :3], inertia["gravity"])
    return np.cross(inertia["payload_center"], weight)
