"""The indices on matrices whose values are known by hand."""

import numpy as np
import pytest

from lite6jax.design.indices import observability
from lite6jax.errors import InputError


def test_by_hand():
    found = observability([4.0, 2.0, 1.0], samples=4)
    assert pytest.approx((4 * 2 * 1) ** (1 / 3) / 2) == found.O1
    assert pytest.approx(1 / 4) == found.O2
    assert pytest.approx(1.0) == found.O3
    assert pytest.approx(1 / 4) == found.O4
    assert pytest.approx(1 / (1 / 4 + 1 / 2 + 1)) == found.O5
    assert found.condition == pytest.approx(4)
    assert found.noise_amplification == pytest.approx(1)


def test_orthonormal_columns():
    """Q of m = 9 rows: all singular values 1."""
    Q = np.linalg.qr(np.random.default_rng(0).normal(size=(9, 3)))[0]
    found = observability(np.linalg.svd(Q, compute_uv=False), samples=9)
    assert pytest.approx((1 / 3, 1, 1, 1)) == (found.O1, found.O2, found.O3, found.O4)
    assert pytest.approx(1 / 3) == found.O5


def test_as_matrices():
    """O1 is a determinant, O3 a smallest eigenvalue."""
    J = np.random.default_rng(1).normal(size=(40, 5))
    found = observability(np.linalg.svd(J, compute_uv=False), samples=10)
    assert pytest.approx(np.linalg.det(J.T @ J) ** (1 / 10) / np.sqrt(10)) == found.O1
    assert pytest.approx(np.sqrt(np.linalg.eigvalsh(J.T @ J)[0])) == found.O3
    assert found.condition == pytest.approx(np.linalg.cond(J))
    assert pytest.approx(found.O2 * found.O3) == found.O4


def test_the_same_poses_twice():
    """m doubles and every singular value grows by √2: O1 stays, as a measure of a pose; O3 to O5 grow."""
    s = np.array([5.0, 3.0, 0.5])
    once, twice = observability(s, 10), observability(np.sqrt(2) * s, 20)
    assert pytest.approx(once.O1) == twice.O1
    assert pytest.approx(once.O2) == twice.O2
    for name in ("O3", "O4", "O5"):
        assert getattr(twice, name) == pytest.approx(np.sqrt(2) * getattr(once, name))


@pytest.mark.parametrize(
    ("values", "samples", "says"),
    [
        ([], 3, "give those that are determined, above 0"),
        ([1.0, 0.0], 3, "give those that are determined, above 0"),
        ([1.0, np.nan], 3, "give those that are determined, above 0"),
        ([1.0], 0, "0 samples: give the number of poses, at least 1"),
    ],
)
def test_what_is_refused(values, samples, says):
    with pytest.raises(InputError, match=says):
        observability(values, samples)
