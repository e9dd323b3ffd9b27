"""Torque recordings in memory, by the generator of the concealed trials, which shares no code with the library."""

import numpy as np
import yaml

from benchmarks.torque_trials.effects import Hidden
from benchmarks.torque_trials.physics import Setup, arm_text, draw_arm, draw_motion, torques
from lite6jax.arms.description import arm_from_description
from lite6jax.recordings import Recording

GRAVITY = np.array([0.0, 0.0, -9.81])
CENTER = np.array([0.0, 0.0, 0.03])


def setup_of(seed=0, name="lite6"):
    """An arm where it stands, and the same arm as the library reads it."""
    arm = draw_arm(name, np.random.default_rng(seed))
    return Setup(arm, GRAVITY, CENTER), arm_from_description(yaml.safe_load(arm_text(arm)), "arm")


def motion_of(setup, seed=0, rate=50.0, seconds=12.0, slow=1.0, **options):
    """What it does, so many times as fast as usual."""
    return draw_motion(np.random.default_rng(seed), setup.arm, rate, seconds, speed=1.5 * slow, **options)


def recorded(
    hidden=(),
    seed=0,
    noise=0.5,
    velocity_noise=1e-4,
    change=None,
    warming=False,
    declare=True,
    rate=50.0,
    slow=1.0,
    **declared,
):
    """A recording with these effects, and the declared arm.

    Args:
        hidden: `Hidden` effects.
        noise: over what a torque sensor of the arm's size has.
        velocity_noise: rad/s.
        change: alters the torques `(sample, joint)`.
        warming: whether joints grow warmer.
        declare: whether the noise is declared.
        rate: rows per second.
        slow: how many times as fast as usual.
        declared: keys of the sidecar.
    """
    setup, arm = setup_of(seed)
    motion = motion_of(setup, seed + 100, rate, slow=slow, warming=warming)
    rng = np.random.default_rng(seed + 200)
    sigma = noise * setup.arm.noise
    tau = torques(setup, hidden, motion) + rng.normal(0, 1, motion.q.shape) * sigma
    if change is not None:
        tau = change(tau)
    keys = {"motion": "trajectory", "payload_com_m": tuple(at_flange(arm))} | declared
    if declare:
        keys["torque_noise_Nm"] = tuple(sigma)
    return Recording.from_arrays(
        motion.q + rng.normal(0, 2e-5, motion.q.shape),
        time=motion.time,
        joint_velocity=motion.dq + rng.normal(0, velocity_noise, motion.q.shape),
        joint_torque=tau,
        joint_temperature=motion.temperature if warming else None,
        payload=motion.payload,
        **keys,
    ), arm


def at_flange(arm):
    """The payload's place in the frame of the flange, m."""
    T = arm.T_joint_flange
    return T[:3, :3].T @ (CENTER - T[:3, 3])


def hidden(name, site, **values):
    """An effect at a site."""
    return Hidden(name, site, values)
