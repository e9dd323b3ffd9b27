"""Arms for the oracles: the seed's table of the Lite 6, calibrations of the seed's size, and random chains."""

import numpy as np

# theta_off (deg), d (mm), a (mm), alpha (deg)
LITE6_TABLE = [
    (0, 243.3, 0, -90),
    (-90, 0, 200, 180),
    (-90, 0, 87, 90),
    (0, 227.6, 0, 90),
    (0, 0, 0, -90),
    (0, 61.5, 0, 0),
]
LITE6_DH = np.array([(np.deg2rad(t), d / 1000, a / 1000, np.deg2rad(alpha)) for t, d, a, alpha in LITE6_TABLE])
LITE6_LIMITS = np.deg2rad([(-360, 360), (-150, 150), (-3.5, 300), (-360, 360), (-124, 124), (-360, 360)])
# The seed's 28 parameters: base x, y, roll, pitch; the table without d2, which is zero; Hayati's beta of joint 2.
NOMINAL = np.concatenate([np.zeros(4), np.delete(LITE6_DH.ravel(), 5), [0.0]])

# The seed's size of a calibration: about 0.8 mm and 0.15 degrees in each number.
ASSEMBLY = np.array([0.8e-3] * 3 + [np.deg2rad(0.15)] * 3)
_LENGTH = np.concatenate([[True, True, False, False], np.delete(np.tile([False, True, True, False], 6), 5), [False]])


def perturbed(rng, kinematics, size=1.0):
    """A calibration of the seed's size about `kinematics`, uniform."""
    return kinematics + size * ASSEMBLY * rng.uniform(-1, 1, np.shape(kinematics))


def perturbed_parameters(rng):
    """The seed's 28 parameters of an arm as made, normal about nominal with the seed's size."""
    return NOMINAL + rng.normal(size=28) * np.where(_LENGTH, ASSEMBLY[0], ASSEMBLY[3])


def random_kinematics(rng, dof):
    """(joint, 6) of an arm with no two axes parallel but by chance."""
    return np.hstack([rng.uniform(-0.5, 0.5, (dof, 3)), rng.uniform(-np.pi, np.pi, (dof, 3))])


def random_positions(rng, samples, dof):
    """(sample, joint) over the full circle."""
    return rng.uniform(-np.pi, np.pi, (samples, dof))


def lite6_positions(rng, samples):
    """(sample, 6) rad, uniform inside the limits of a Lite 6."""
    return rng.uniform(*LITE6_LIMITS.T, (samples, 6))


def parameters_of_table(form, base, dh, beta=()):
    """(size,) Hayati parameters of revolute joints, of the base's x y roll pitch, a DH table and the betas."""
    links = np.zeros((form.dof, 6))
    links[:, [0, 1, 2, 4]] = dh
    links[list(form.parallel), 5] = beta
    return form.pack(np.array([*base[:2], 0, 0, base[3], base[2]]), links)


def table_of_parameters(form, parameters):
    """The inverse of `parameters_of_table`."""
    base, links = form.unpack(parameters)
    return base[[0, 1, 5, 4]], links[:, [0, 1, 2, 4]], links[list(form.parallel), 5]
