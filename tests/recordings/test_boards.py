"""Corners of a board that OpenCV itself renders, found in images and written as a recording."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lite6jax import recordings
from lite6jax.cli import main
from lite6jax.errors import InputError
from lite6jax.recordings import boards

K = np.array([[900.0, 0.0, 410.0], [0.0, 905.0, 300.0], [0.0, 0.0, 1.0]])
SIZE = 800, 600
BOARD = boards.parse_board("charuco:7x5,20mm")


@pytest.fixture
def cv2():
    return pytest.importorskip("cv2", reason="boards are rendered and found by OpenCV, extra camera")


def poses(count, seed=0):
    """Of the board in the camera, in sight: its corners' middle about 0.35 m away."""
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(rng.uniform(-0.4, 0.4, (count, 3))).as_matrix()
    middle = rng.uniform([-0.03, -0.02, 0.3], [0.03, 0.02, 0.4], (count, 3))
    T[:, :3, 3] = middle - T[:, :3, :3] @ [0.07, 0.05, 0.0]
    return T


def render(cv2, T, scale=10):
    """The board at a pose, seen by a camera without distortion."""
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((7, 5), 0.02, 0.015, markers)
    drawn = board.generateImage((7 * 20 * scale, 5 * 20 * scale), marginSize=0)
    per_pixel = np.array([[1e-3 / scale, 0, 0.5e-3 / scale], [0, 1e-3 / scale, 0.5e-3 / scale], [0, 0, 1]])
    H = K @ np.stack([T[:3, 0], T[:3, 1], T[:3, 3]], 1) @ per_pixel
    return cv2.warpPerspective(drawn, H, SIZE, flags=cv2.INTER_AREA, borderValue=200)


def true_pixels(T):
    # OpenCV counts corners from that of the first square, and the whole board from its edge
    points = np.array(BOARD.settings.points) + np.array([0.02, 0.02, 0.0])
    seen = (points @ T[:3, :3].T + T[:3, 3]) @ K.T
    return seen[:, :2] / seen[:, 2:]


def write_images(cv2, folder, T, blank=()):
    folder.mkdir()
    for k, one in enumerate(T):
        image = render(cv2, one) if k not in blank else np.full((SIZE[1], SIZE[0]), 200, np.uint8)
        assert cv2.imwrite(str(folder / f"image{k}.png"), image)
    return folder


def write_joints(path, names=None, rows=12, seed=0):
    q = np.random.default_rng(seed).uniform(-1, 1, (rows, 6))
    named = names is not None
    lines = [",".join([*["image"] * named, *(f"q{j}_rad" for j in range(1, 7))])]
    lines += [",".join([*([names[k]] if named else []), *map(repr, map(float, q[k]))]) for k in range(rows)]
    path.write_text("\n".join(lines) + "\n")
    return q


def test_corners_are_found_to_a_fraction_of_a_pixel(cv2, tmp_path):
    T = poses(12)
    images = boards.list_images([write_images(cv2, tmp_path / "images", T, blank=(3,))])
    assert [file.name for file in images] == [f"image{k}.png" for k in range(12)]
    found = boards.detect_corners(images, BOARD)
    assert found.size == SIZE
    assert found.shown.sum() >= 10
    assert not found.shown[3]
    off = found.pixels - np.stack([true_pixels(one) for one in T])
    shift = np.nanmedian(off, (0, 1))  # before version 5 of OpenCV half a pixel, as of its own calibrations
    assert np.abs(shift).max() < 0.6
    assert np.nanmedian(np.abs(off - shift)) < 0.15
    camera, error = boards.calibrate_lens(found, BOARD, "fixed")
    assert error < 0.3
    np.testing.assert_allclose((camera.fx, camera.fy), (900, 905), rtol=0.02)


def test_a_recording_is_written_that_the_other_commands_read(cv2, tmp_path, capsys):
    write_images(cv2, tmp_path / "images", poses(12), blank=(3, 7))
    q = write_joints(tmp_path / "joints.csv")
    command = ["detect", str(tmp_path / "images"), "--board", "charuco:7x5,20mm", "--arm", "lite6"]
    assert main([*command, "--joints", str(tmp_path / "joints.csv"), "--set", "pixel_noise_px=0.2"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "10 of 12 images show the board" in said
    assert "image3.png, image7.png" in said
    found = recordings.read_recording(tmp_path / "joints_corners.csv")
    settings = found.settings
    assert (settings.arm, settings.pose_source, settings.pixel_noise_px) == ("lite6", "camera", 0.2)
    assert settings.board is not None
    assert settings.camera is not None
    assert (settings.board.columns, settings.board.rows, settings.board.square_m) == (6, 4, 0.02)
    assert settings.camera.intrinsics == "refine"
    np.testing.assert_allclose(found.joint_position, np.delete(q, (3, 7), 0))
    assert found.position is not None
    assert np.isfinite(found.position).all()


def test_joints_that_do_not_match_are_refused(tmp_path):
    images = [tmp_path / f"image{k}.png" for k in range(3)]
    write_joints(tmp_path / "joints.csv", rows=4)
    with pytest.raises(InputError, match="4 rows, and there are 3 images"):
        boards.match_rows(images, tmp_path / "joints.csv")
    write_joints(tmp_path / "joints.csv", ["image0", "image1", "other"], 3)
    with pytest.raises(InputError, match=r"no row is of image image2\.png"):
        boards.match_rows(images, tmp_path / "joints.csv")
    write_joints(tmp_path / "joints.csv", ["image0", "image0", "image2"], 3)
    with pytest.raises(InputError, match="rows 1 and 2 are both of image image0"):
        boards.match_rows(images, tmp_path / "joints.csv")


def test_what_shows_no_board_ends_in_one_line(cv2, tmp_path, capsys):
    write_images(cv2, tmp_path / "images", poses(3), blank=(0, 1, 2))
    write_joints(tmp_path / "joints.csv", rows=3)
    command = ["detect", str(tmp_path / "images"), "--joints", str(tmp_path / "joints.csv"), "--board"]
    for board, said in (
        ("charuco:7x5,20mm", "none of 3 images shows a ChArUco board"),
        ("charuco:7x5,20mm,15mm,9X9_50", "no dictionary 9X9_50"),
        ("charuco:30x30,20mm", "take a larger dictionary"),
    ):
        assert main([*command, board]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
    assert not (tmp_path / "joints_corners.csv").exists()


# ------------------------------------------------------------------ other layouts, and boards without markers


def write_pictures(cv2, folder, drawn, T, mm_per_pixel):
    """Images of a drawn board at poses of its upper left corner."""
    folder.mkdir()
    per_pixel = np.diag([1e-3 * mm_per_pixel, 1e-3 * mm_per_pixel, 1.0])
    for k, one in enumerate(T):
        H = K @ np.stack([one[:3, 0], one[:3, 1], one[:3, 3]], 1) @ per_pixel
        image = cv2.warpPerspective(drawn, H, SIZE, flags=cv2.INTER_AREA, borderValue=200)
        assert cv2.imwrite(str(folder / f"image{k}.png"), image)
    return folder


def draw_legacy(cv2, columns, rows):
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    board = cv2.aruco.CharucoBoard((columns, rows), 0.02, 0.015, markers)
    board.setLegacyPattern(True)
    return board.generateImage((columns * 200, rows * 200), marginSize=0)


def test_a_board_of_the_pattern_before_opencv_4_6_is_found_and_that_is_said(cv2, tmp_path, capsys):
    T = poses(5)
    write_pictures(cv2, tmp_path / "images", draw_legacy(cv2, 7, 6), T, 0.1)
    found = boards.detect_corners(boards.list_images([tmp_path / "images"]), boards.parse_board("charuco:7x6,20mm"))
    assert found.legacy
    assert found.shown.all()
    write_joints(tmp_path / "joints.csv", rows=5)
    command = ["detect", str(tmp_path / "images"), "--board", "charuco:7x6,20mm", "--arm", "lite6"]
    assert main([*command, "--joints", str(tmp_path / "joints.csv")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "5 of 5 images show the board" in said
    assert "pattern of OpenCV before 4.6" in said


def test_markers_without_corners_are_said_to_be_in_another_layout(cv2, tmp_path):
    write_pictures(cv2, tmp_path / "images", draw_legacy(cv2, 7, 6), poses(2), 0.1)
    images = boards.list_images([tmp_path / "images"])
    with pytest.raises(InputError, match=r"markers 0 to \d+ are seen, but in another layout"):
        boards.detect_corners(images, boards.parse_board("charuco:4x11,20mm"))


@pytest.mark.parametrize("turned", [0, 2])
def test_a_checkerboard_is_found_from_its_dark_first_corner(cv2, tmp_path, turned):
    columns, rows, pixels = 8, 5, 150
    dark = np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0
    drawn = np.kron(np.where(dark, 10, 245), np.ones((pixels, pixels))).astype(np.uint8)
    drawn = cv2.copyMakeBorder(drawn, pixels, pixels, pixels, pixels, cv2.BORDER_CONSTANT, value=245)
    T = poses(4, seed=3)
    mm_per_pixel = 20 / pixels
    folder = write_pictures(cv2, tmp_path / "images", np.rot90(drawn, turned).copy(), T, mm_per_pixel)
    board = boards.parse_board("checkerboard:8x5,20mm")
    found = boards.detect_corners(boards.list_images([folder]), board)
    assert found.shown.all()
    first = 0.04 - 0.5e-3 * mm_per_pixel
    points = np.array(board.settings.points) + np.array([first, first, 0.0])
    if turned:  # the same board, mounted the other way round
        width, height = ((np.array([columns, rows]) + 2) * 0.02 - 1e-3 * mm_per_pixel).tolist()
        points = np.array([width, height, 0.0]) - points
    for k, one in enumerate(T):
        seen = (points @ one[:3, :3].T + one[:3, 3]) @ K.T
        off = np.abs(found.pixels[k] - seen[:, :2] / seen[:, 2:])
        assert off.max() < 1.0  # another first corner is off by tens of pixels
        assert np.median(off) < 0.15


def test_a_checkerboard_that_looks_the_same_after_half_a_turn_is_refused():
    with pytest.raises(InputError, match="looks the same after half a turn"):
        boards.parse_board("checkerboard:9x7,20mm")
