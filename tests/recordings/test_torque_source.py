"""Torques without noise are told from measured ones, by synthetic pendulums that move and rest."""

import numpy as np
import pytest

from lite6jax.recordings import Recording, estimated_torque

STEP = 0.004


def pendulum(noise=0.0, encoder=2e-6, digits=9, rests=True, seconds=12.0, spacing=1):
    """Two joints that swing for four seconds and rest for two, again and again; the torques of their weights.

    The torques follow the true positions, which differ from those of the encoders by their noise.
    """
    rng = np.random.default_rng(0)
    time = np.arange(0.0, seconds, STEP)
    phase = np.minimum(time % 6.0, 4.0) if rests else time % 4.0
    swing = 0.5 * (1 - np.cos(np.pi * phase / 2))
    q = np.stack([0.8 * swing, 1.2 - 0.5 * swing], 1)
    torque = np.stack([5 * np.sin(q[:, 0]), 0.7 * np.cos(q[:, 1])], 1)
    torque = np.round(torque + noise * np.abs(torque).max(0) * rng.normal(size=q.shape), digits)
    return Recording.from_arrays(
        (q + encoder * rng.normal(size=q.shape))[::spacing],
        time=time[::spacing],
        joint_torque=torque[::spacing],
        motion="trajectory",
    )


def test_a_torque_that_is_constant_at_rest_is_computed():
    assert estimated_torque(pendulum())


@pytest.mark.parametrize(
    "changed",
    [
        {"noise": 1e-3},
        {"noise": 3e-4, "digits": 3},
        {"noise": 2e-3, "digits": 1},  # the noise is rounded away at rest
        {"rests": False},
        {"seconds": 0.5},
        {"encoder": 1e-3},  # of an arm that shakes nothing is known
    ],
)
def test_a_measured_torque_and_one_of_which_nothing_can_be_told_are_not(changed):
    assert not estimated_torque(pendulum(**changed))
