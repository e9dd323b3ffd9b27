"""Recordings of an arm with a prismatic joint, whose torques and forces are those of Pinocchio."""

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.recordings import Recording
from tests.oracles.pinocchio_dynamics import pinocchio_model, pinocchio_torques

HALF = np.pi / 2
ROWS = ((0, 0, 0.3, 0, 0, 0), (0, 0, 0.1, -HALF, 0, 0), (0, -0.25, 0, HALF, 0, 0))
"""A column that turns, a shoulder, and a telescope along the upper arm."""
SLIDING = (2,)
BODIES = (
    (4.0, (0.01, 0.0, -0.05), np.diag([0.03, 0.03, 0.02])),
    (3.0, (0.0, -0.1, 0.02), np.diag([0.03, 0.01, 0.03])),
    (2.0, (0.01, 0.0, 0.1), np.diag([0.01, 0.01, 0.004])),
)
LIMITS = ((-2.5, 2.5), (-1.2, 1.2), (0.0, 0.4))
GRAVITY = np.array([0.0, 0.0, -9.81])
NOISE = (0.02, 0.05, 0.3)
"""Nm, Nm and N."""
VISCOUS, COULOMB = 25.0, 6.0
"""N·s/m and N of the telescope."""
SHOULDER = 0.8
"""Nm·s/rad of the shoulder."""


def arm(**given):
    """As it is declared."""
    mass, center, inertia = zip(*BODIES, strict=True)
    return Arm(
        "telescope",
        np.array(ROWS, float),
        joint_limits=np.array(LIMITS),
        mass=np.array(mass),
        center_of_mass=np.array(center),
        inertia=np.array(inertia),
        sliding=SLIDING,
        **given,
    )


def moved(seed=0, seconds=14.0, rate=80.0):
    """Times, and positions, velocities and accelerations `(sample, joint)` of sums of sines inside the limits."""
    t = np.arange(0, seconds, 1 / rate)
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.array([0.15, 0.27, 0.44])
    lower, upper = np.array(LIMITS).T
    A = rng.uniform(0.5, 1.0, (3, 3))
    A *= 0.4 * (upper - lower) / A.sum(0)
    at = t[:, None, None] * w[:, None] + rng.uniform(0, 2 * np.pi, (3, 3))
    q = (lower + upper) / 2 + (A * np.sin(at)).sum(1)
    return t, q, (A * w[:, None] * np.cos(at)).sum(1), -(A * w[:, None] ** 2 * np.sin(at)).sum(1)


def exerted(q, dq, ddq):
    """Nm, Nm and N `(sample, joint)` that the motors exert on the rigid arm."""
    model = pinocchio_model(ROWS, *map(np.array, zip(*BODIES, strict=True)), GRAVITY, SLIDING)
    return pinocchio_torques(model, q.T, dq.T, ddq.T).T


def friction(dq, viscous=VISCOUS, coulomb=COULOMB, shoulder=SHOULDER):
    """`(sample, joint)`: of the telescope and of the shoulder."""
    added = np.zeros_like(dq)
    added[:, 1] = shoulder * dq[:, 1]
    added[:, 2] = viscous * dq[:, 2] + coulomb * np.sign(dq[:, 2])
    return added


def recorded(extra=None, seed=0, noise=1.0, **declared):
    """A recording; `extra` makes of velocities `(sample, joint)` what motors exert besides."""
    t, q, dq, ddq = moved(seed)
    tau = exerted(q, dq, ddq)
    tau += 0.0 if extra is None else extra(dq)
    rng = np.random.default_rng(seed + 1)
    tau += noise * np.array(NOISE) * rng.standard_normal(tau.shape)
    keys = {"motion": "trajectory", "torque_source": "measured", "torque_noise_Nm": NOISE} | declared
    return Recording.from_arrays(
        q + rng.normal(0, 1, q.shape) * [2e-5, 2e-5, 2e-6],
        time=t,
        joint_velocity=dq + rng.normal(0, 1, q.shape) * [1e-4, 1e-4, 1e-5],
        joint_torque=tau,
        sliding=SLIDING,
        **keys,
    )
