"""Inverse dynamics and its regressor as Pinocchio has them."""

import numpy as np
import pinocchio as pin

from tests.oracles.pinocchio_arm import pinocchio_chain

# Pinocchio orders a body's parameters m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
_ORDER = [0, 1, 2, 3, 4, 6, 9, 5, 7, 8]


def random_bodies(rng, joints):
    """Mass (joint,), centre of mass (joint, 3) and inertia about it (joint, 3, 3) of clouds of twelve points each."""
    points, weights = rng.normal(0, 0.1, (joints, 12, 3)), rng.uniform(0.02, 0.3, (joints, 12))
    mass = weights.sum(1)
    center = np.einsum("jk,jka->ja", weights, points) / mass[:, None]
    p = points - center[:, None]
    inertia = np.einsum("jk,jkc,jkc,ab->jab", weights, p, p, np.eye(3)) - np.einsum("jk,jka,jkb->jab", weights, p, p)
    return mass, center, inertia


def pinocchio_model(kinematics, mass, center, inertia, gravity, sliding=()):
    """The chain with these bodies."""
    model = pinocchio_chain(kinematics, sliding)
    for i, body in enumerate(zip(mass, center, inertia, strict=True)):
        model.appendBodyToJoint(i + 1, pin.Inertia(*body), pin.SE3.Identity())
    model.gravity.linear = np.asarray(gravity, float)
    return model


def pinocchio_torques(model, q, dq, ddq):
    """(joint, sample) of motions (joint, sample)."""
    data = model.createData()
    return np.array([pin.rnea(model, data, *rows) for rows in _rows(q, dq, ddq)]).T


def pinocchio_regressor(model, q, dq, ddq):
    """(joint, 10 × joint, sample), each link's columns in the library's order."""
    data, joints = model.createData(), len(q)
    order = (10 * np.arange(joints)[:, None] + _ORDER).ravel()
    each = [pin.computeJointTorqueRegressor(model, data, *rows) for rows in _rows(q, dq, ddq)]
    return np.moveaxis(np.array(each).reshape(-1, joints, 10 * joints)[:, :, order], 0, -1)


def pinocchio_parameters(model):
    """(joint, 10) inertial parameters of the links, in the library's order."""
    return np.array([body.toDynamicParameters()[_ORDER] for body in list(model.inertias)[1:]])


def _rows(*motion):
    return zip(*(np.ascontiguousarray(part.T) for part in motion), strict=True)
