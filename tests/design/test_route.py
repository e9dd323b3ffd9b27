"""The order of poses is a short route: against every order of few poses, and against chance for many."""

import numpy as np

from lite6jax.design.route import shortest_round


def test_a_short_round():
    rng = np.random.default_rng(5)
    q = rng.uniform(-1, 1, (7, 3))
    order = shortest_round(q)
    assert sorted(order) == list(range(7))

    def length(order, q=q):
        points = np.vstack([np.zeros(q.shape[1]), q[list(order)]])
        return np.abs(np.diff(points, axis=0)).max(1).sum()

    from itertools import permutations

    best = min(length(p) for p in permutations(range(7)))
    assert length(order) <= 1.15 * best
    many = rng.uniform(-3, 3, (60, 6))
    assert length(shortest_round(many), many) < 0.6 * length(range(60), many)
