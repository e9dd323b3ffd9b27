"""What a recording can tell: the detection threshold of an effect, and its Cramér–Rao bound.

All from the generator's own derivatives (central differences of `plain_physics.poses`), whitened by the sensor's true
noise, and seen only across what the recording leaves open: sensor frame, tool and geometry.
"""

import numpy as np

from benchmarks.campaigns.threshold import Threshold, across, least_power
from benchmarks.concealed.chain import Array
from benchmarks.concealed.plain_physics import OUTSIDE, Hidden, poses
from benchmarks.concealed.view import View, reported_slopes


def threshold(view: View, hidden: tuple[Hidden, ...], place: int, span: Array) -> Threshold:
    """Of one of the hidden effects, the direction of its values given, across the columns of all that may vary."""
    effect = hidden[place]
    unit = 1e-3 * _typical(effect)
    scaled = effect.scaled(unit)
    others = (*hidden[:place], *hidden[place + 1 :])
    absent, there = poses(view.setup, others, view.motion), poses(view.setup, (*others, scaled), view.motion)
    g = view.padded(view.difference(absent, there)[:, None] / unit)
    left = across(span, g)[:, 0]
    length, whole = float(np.linalg.norm(left)), float(np.linalg.norm(g))
    if length == 0 or whole == 0:
        return Threshold(np.inf, 0.0, np.inf)
    count = 1 if effect.name in OUTSIDE else effect.linear
    size = np.sqrt(least_power(count)) / length
    moved = np.sqrt(np.mean(np.sum((there[1] - absent[1]) ** 2, 1))) / unit * size
    return Threshold(size, length / whole, float(moved))


def _typical(effect: Hidden) -> float:
    """A factor that makes values of unit size small enough for a derivative."""
    return 1.0 if effect.name in ("time_offset", "payload_error") else 0.1


def bounds(view: View, hidden: tuple[Hidden, ...]) -> list[dict[str, float]]:
    """The Cramér–Rao bound of every reported number: one standard deviation of the best unbiased estimate."""
    if not hidden:
        return []
    blocks = [view.padded(view.columns(hidden, k)) for k in range(len(hidden))]
    found = across(view.nuisance(hidden), np.concatenate(blocks, 1))
    covariance = np.linalg.pinv(found.T @ found, rcond=1e-14, hermitian=True)
    out, first = [], 0
    for effect in hidden:
        size = len(effect.values)
        own = covariance[first : first + size, first : first + size]
        first += size
        names, J = reported_slopes(effect)
        variances = np.einsum("ia,ab,ib->i", J, own, J)
        out.append(dict(zip(names, np.sqrt(np.maximum(variances, 0)).tolist(), strict=True)))
    return out
