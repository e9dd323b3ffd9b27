"""Images of a board become poses with their covariance."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lite6jax.sensors.camera import Lens, board_poses, project

PINHOLE, DISTORTION = np.array([900.0, 905.0, 640.0, 360.0]), np.array([-0.1, 0.05, 4e-4, -3e-4, -0.01])
LENS = Lens(PINHOLE, DISTORTION)
CORNERS = np.array([[0.02 * (k % 6), 0.02 * (k // 6), 0.0] for k in range(24)])


def seen(points):
    """OpenCV's model in plain NumPy."""
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    k1, k2, p1, p2, k3 = DISTORTION
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    fx, fy, cx, cy = PINHOLE
    return np.stack([fx * u + cx, fy * v + cy], -1)


def boards(count, seed=0):
    """Poses of a board in front of a camera."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (count, 3))).as_matrix()
    T[:, :3, 3] = rng.uniform([-0.1, -0.05, 0.35], [0.1, 0.05, 0.6], (count, 3))
    return T


def images(T, noise, seed=1, corners=CORNERS):
    points = corners @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    return seen(points) + noise * np.random.default_rng(seed).standard_normal((len(T), len(corners), 2))


def apart(mounted, found, true):
    """In the coordinates of the whitener, `(image, 6)`."""
    true = true if mounted == "fixed" else np.linalg.inv(true)
    turned = Rotation.from_matrix(np.swapaxes(found[:, :3, :3], 1, 2) @ true[:, :3, :3]).as_rotvec()
    return np.concatenate([true[:, :3, 3] - found[:, :3, 3], turned], 1)


def test_the_projection_is_that_of_the_formula():
    points = np.random.default_rng(0).uniform([-0.2, -0.2, 0.5], [0.2, 0.2, 1.0], (20, 3))
    np.testing.assert_allclose(project(LENS, points), seen(points), rtol=1e-12)


@pytest.mark.parametrize("mounted", ["fixed", "on_flange"])
def test_poses_are_as_far_off_as_their_covariance_says(mounted):
    T = boards(60)
    found = board_poses(mounted, LENS, CORNERS, images(T, 0.2), 0.2)
    assert found.noise == pytest.approx(0.2, rel=0.1)
    white = np.einsum("iab,ib->ia", found.whitener, apart(mounted, found.T, T))
    assert 0.85 < np.mean(white**2) < 1.25  # 360 numbers of unit variance, more by what robust weights cost
    assert len(found.mean) == 0


def test_corners_in_one_line_are_no_pose():
    pixels = images(boards(6), 0.1)
    pixels[2, 7:] = np.nan  # a row of six and one beside it, as at the edge of a picture
    pixels[4, 6:] = np.nan
    found = board_poses("fixed", LENS, CORNERS, pixels, 0.1)
    assert np.isnan(found.T[[2, 4], 0, 0]).all()
    assert np.isfinite(found.T[[0, 1, 3, 5]]).all()
    assert np.isfinite(found.whitener).all()


def test_errors_of_the_print_are_estimated_beside_the_poses():
    T, rng = boards(40), np.random.default_rng(5)
    printed = CORNERS + 2e-4 * rng.standard_normal(CORNERS.shape) * [1, 1, 0]
    pixels = images(T, 0.05, corners=printed)
    found = board_poses("fixed", LENS, CORNERS, pixels, 0.05, corner_noise=2e-4)
    off = apart("fixed", found.T, T)
    # with the constant errors at the truth all poses would be right: the best constants explain nearly all of it
    rows = np.einsum("iab,ib->ia", found.whitener, off)
    columns = found.by_numbers.reshape(-1, len(found.mean))
    best = np.linalg.lstsq(columns, rows.ravel(), rcond=None)[0]
    left = rows.ravel() - columns @ best
    assert np.mean(left**2) < 0.2 * np.mean(rows**2)
    assert np.mean(left**2) < 1.6
