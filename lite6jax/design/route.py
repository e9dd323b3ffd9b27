"""An order of poses in which an arm moves little."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

_ROUNDING = 1e-12
"""rad: a shorter route by less than this is rounding."""


def shortest_round(joint_position: Array, first: Array | None = None) -> NDArray[np.integer]:
    """An order `(pose,)` in which an arm moves little: from each pose to the nearest, then improved two by two.

    The distance is the largest move of any joint, which is what takes the time.

    Args:
        joint_position: `(pose, joint)` rad.
        first: `(joint,)` rad, where the arm stands; all joints at 0 where not given.
    """
    q = np.asarray(joint_position, float)
    start = np.zeros(q.shape[1]) if first is None else np.asarray(first, float)
    points = np.vstack([start, q])
    distance = np.abs(points[:, None] - points[None]).max(-1)
    order, left = [0], set(range(1, len(points)))
    while left:
        order.append(min(left, key=lambda k: distance[order[-1], k]))
        left.remove(order[-1])
    tour = np.array(order)
    for _ in range(20):  # 2-opt of an open path: turn a stretch round where that shortens it
        improved = False
        for i in range(1, len(tour) - 1):
            j = np.arange(i + 1, len(tour))
            after = np.where(j + 1 < len(tour), tour[np.minimum(j + 1, len(tour) - 1)], tour[j])
            now = distance[tour[i - 1], tour[i]] + distance[tour[j], after]
            turned = distance[tour[i - 1], tour[j]] + distance[tour[i], after] * (j + 1 < len(tour))
            gain = now - turned
            best = int(np.argmax(gain))
            if gain[best] > _ROUNDING:
                tour[i : j[best] + 1] = tour[i : j[best] + 1][::-1]
                improved = True
        if not improved:
            break
    return tour[1:] - 1
