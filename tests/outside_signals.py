"""What formulas of physics outside the catalogue are written with, a second time and without the generator's own."""

import numpy as np

from benchmarks.concealed.plain_physics import moments

PAYLOAD_CENTER = np.array([0.01, 0.0, 0.05])


def rise(motion):
    return (motion.temperature.mean(1) - 25) / 10


def torque(setup, motion, joint):
    return moments(setup.chain, motion.q, motion.payload, PAYLOAD_CENTER)[0][:, joint - 1]


def base_moment(setup, motion):
    return moments(setup.chain, motion.q, motion.payload, PAYLOAD_CENTER)[1]


def beyond(load, preload):
    """What is left of a load when a preload has taken its share, whichever way it acts; of a turn, beyond a slack."""
    return load - load.clip(-preload, preload)


def played(values, half):
    """What is pushed along stays behind by no more than the play."""
    behind, gap = [], 0.0
    for step in np.diff(values, prepend=values[0]):
        gap = np.clip(gap + step, -half, half)
        behind.append(gap)
    return values - behind


def latched(values, level):
    """The sign of the last value beyond a level."""
    known = np.abs(values) > level
    return np.sign(values[np.maximum.accumulate(np.where(known, np.arange(len(values)), 0))])


def faded(start, aims, path):
    """What goes from a start to one aim after the other along a path: every aim, as far as the path since left it."""
    way = np.cumsum(np.append(0.0, path))
    kicks = np.append(0.0, aims * (1 - np.exp(-path)))
    return start * np.exp(-way) + np.tril(np.exp(way[None] - way[:, None])) @ kicks


def late(values, motion, constant):
    """Values as they are followed with a time constant."""
    return faded(values[0], values[1:], np.diff(motion.time) / constant)


def wave(angle, phase=0.4):
    return np.sin(angle) * np.cos(phase) + np.cos(angle) * np.sin(phase)


def rising(values):
    """tanh."""
    return 1 - 2 / (np.exp(2 * values) + 1)
