"""Corners of a ChArUco board or a checkerboard in images, found by OpenCV, and the lens that they show."""

import re
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.errors import InputError
from lite6jax.recordings.files import open_table, require_table
from lite6jax.recordings.ros import ArmJoints
from lite6jax.recordings.settings import BoardSettings, CameraSettings
from lite6jax.sensors.camera import FEWEST_CORNERS

_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm")
_BOARD = re.compile(r"charuco:(\d{1,4})x(\d{1,4}),([\d.]+)mm(?:,([\d.]+)mm)?(?:,(?:DICT_)?(\w+))?", re.IGNORECASE)
_PLAIN = re.compile(r"checkerboard:(\d{1,4})x(\d{1,4}),([\d.]+)mm", re.IGNORECASE)
_PARTS = re.compile(r"(\d+)")


class Board(NamedTuple):
    """A ChArUco board, a chessboard whose white squares hold markers, which number its inner corners; or one without.

    Attributes:
        columns: of squares.
        rows: of squares.
        square: m, a square's side.
        marker: m, a marker's side; zero of a board without markers.
        dictionary: of the markers, as OpenCV names it after `DICT_`; empty of a board without markers.
    """

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str

    @property
    def settings(self) -> BoardSettings:
        """Its inner corners, as a sidecar declares them."""
        return BoardSettings(self.columns - 1, self.rows - 1, self.square)


class Corners(NamedTuple):
    """What images show of a board.

    Attributes:
        pixels: `(image, corner, 2)`, NaN where a corner was not seen; all of an image with fewer than six.
        size: px, width and height of every image.
        legacy: whether the board has the pattern of OpenCV before 4.6, whose first square is white where it has an even
            number of rows.
    """

    pixels: Array
    size: tuple[int, int]
    legacy: bool = False

    @property
    def shown(self) -> Mask:
        """`(image,)`, which show the board."""
        return np.asarray(np.isfinite(self.pixels[..., 0]).any(1))


def parse_board(text: str) -> Board:
    """A board from `charuco:7x5,20mm` or `checkerboard:8x5,25mm`, by its squares as OpenCV counts those of ChArUco.

    The side of a marker and the dictionary may follow: `charuco:7x5,20mm,15mm,5X5_100`.

    Raises:
        InputError: another form, fewer than three squares a side, a marker that fills its square, or a board without
            markers that looks the same after half a turn.
    """
    match = _BOARD.fullmatch(text.strip())
    plain = _PLAIN.fullmatch(text.strip())
    if match is None and plain is None:
        raise InputError(
            f"--board {text[:60]}: write charuco:COLUMNSxROWS,SQUAREmm, such as charuco:7x5,20mm (the side of a marker "
            "and the dictionary may follow, ,15mm,5X5_100), or checkerboard:COLUMNSxROWS,SQUAREmm, by its squares"
        )
    columns, rows, square = (match or plain).group(1, 2, 3)  # type: ignore[union-attr]
    marker, dictionary = match.group(4, 5) if match else (None, None)
    try:
        side = float(square) / 1e3
        markers = float(marker) / 1e3 if marker else 0.75 * side
    except ValueError as error:
        raise InputError(f"--board {text[:60]}: {error}; give sides in mm") from error
    if min(int(columns), int(rows)) < 3 or not 0 < markers < side:
        raise InputError(f"--board {text[:60]}: give 3 squares or more a side, and markers smaller than these")
    if plain is None:
        return Board(int(columns), int(rows), side, markers, (dictionary or "4X4_50").upper())
    if (int(columns) + int(rows)) % 2 == 0:
        raise InputError(
            f"--board {text[:60]}: looks the same after half a turn; take a board with an odd number of squares along "
            "one side and an even number along the other, or one with markers"
        )
    return Board(int(columns), int(rows), side, 0.0, "")


def list_images(sources: Sequence[str | Path]) -> list[Path]:
    """The images of folders and files, each folder's in the order of the numbers in their names.

    Raises:
        InputError: no such file or folder, or a folder without images.
    """
    images: list[Path] = []
    for source in map(Path, sources):
        inside = [source] if source.is_file() else []
        if source.is_dir():
            inside = [file for file in source.iterdir() if file.suffix.lower() in _IMAGES]
            inside.sort(key=lambda file: [int(part) if part.isdecimal() else part for part in _PARTS.split(file.name)])
        if not inside:
            holds = f"holds no images ({', '.join(_IMAGES)})" if source.is_dir() else "no such file or folder"
            raise InputError(f"{source}: {holds}; name images or their folder")
        images += inside
    return images


def match_rows(images: Sequence[Path], table: Path) -> Integers:
    """The row of a table of joints that each image was taken at, `(image,)` from 1.

    A column `image` names the files, with or without suffix. Without one the rows are in the order of the images.

    Raises:
        InputError: a row that is missing or is there twice, or another number of rows than images.
    """
    _, content = open_table(require_table(table, "joints of images"), (), ArmJoints(), [])
    names = list(content.names)
    at = names.index("image") if "image" in names else 0
    values = content.load({at: "image"})[at]
    if isinstance(values, str):
        raise InputError(f"{table}: column {names[at]}: {values}")
    if "image" not in names:
        if len(values) != len(images):
            raise InputError(
                f"{table}: has {len(values)} rows, and there are {len(images)} images; give a row an image, or name "
                "them in a column image"
            )
        return np.arange(1, len(images) + 1)
    rows: dict[str, int] = {}
    for number, name in enumerate(values.to_pylist(), 1):
        if rows.setdefault(str(name), number) != number:
            raise InputError(f"{table}: rows {rows[str(name)]} and {number} are both of image {name}; name each once")
    row_numbers = [rows.get(file.name, rows.get(file.stem, 0)) for file in images]
    if 0 in row_numbers:
        raise InputError(
            f"{table}: no row is of image {images[row_numbers.index(0)].name}; name each in its column image"
        )
    return np.array(row_numbers)


def detect_corners(images: Sequence[Path], board: Board) -> Corners:
    """The corners of a board in each image, to a fraction of a pixel.

    Of a ChArUco board the present pattern is sought, and where that is not shown, the one of OpenCV before 4.6.

    Raises:
        InputError: OpenCV is missing, a dictionary that it lacks, a file that is no image, images of several sizes, or
            none that shows the board.
    """
    cv2 = _opencv()
    pixels = np.full((len(images), (board.columns - 1) * (board.rows - 1), 2), np.nan)
    pictures = _read_images(cv2, images)
    size: tuple[int, int] = pictures[0].shape[::-1] if pictures else (0, 0)
    if not board.dictionary:
        for k, picture in enumerate(pictures):
            if (grid := _find_checkerboard(cv2, picture, board)) is not None:
                pixels[k] = grid
        if not np.isfinite(pixels).any():
            raise InputError(_describe_unseen(images, board, ""))
        return Corners(pixels, size)
    seen_markers: set[int] = set()
    for legacy in (False, True):
        detector = _detector(cv2, board, legacy)
        for k, picture in enumerate(pictures):
            corners, ids, _, markers = detector.detectBoard(picture)
            seen_markers |= {*np.ravel(markers).tolist()} if markers is not None else set()
            if ids is not None and len(ids) >= FEWEST_CORNERS:
                pixels[k, np.ravel(ids)] = np.reshape(corners, (-1, 2))
        if np.isfinite(pixels).any():
            return Corners(pixels, size, legacy)
    layout = ""
    if seen_markers:
        layout = (
            f"; markers {min(seen_markers)} to {max(seen_markers)} are seen, but in another layout: count the squares "
            "again, columns before rows"
        )
    raise InputError(_describe_unseen(images, board, layout))


def _read_images(cv2: ModuleType, images: Sequence[Path]) -> list[NDArray[np.uint8]]:
    """Grey images `(height, width)` of one size."""
    pictures: list[NDArray[np.uint8]] = []
    for file in images:
        picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if picture is None:
            raise InputError(f"{file}: is no image that OpenCV reads; leave it out or convert it")
        pictures.append(picture)
        if picture.shape != pictures[0].shape:
            height, width = pictures[0].shape
            raise InputError(
                f"{file}: has {picture.shape[1]} x {picture.shape[0]} pixels, and {images[0].name} {width} x {height}; "
                "give images of one camera, none cropped"
            )
    return pictures


def _detector(cv2: ModuleType, board: Board, legacy: bool) -> Any:
    """OpenCV's detector of a ChArUco board, of its present pattern or of that before 4.6."""
    number = vars(cv2.aruco).get(f"DICT_{board.dictionary}")
    if number is None:
        listed = sorted(name[5:] for name in dir(cv2.aruco) if name.startswith("DICT_") and name.endswith("_50"))
        raise InputError(f"--board: OpenCV has no dictionary {board.dictionary}; take one such as {', '.join(listed)}")
    shape = (board.columns, board.rows)
    markers = cv2.aruco.getPredefinedDictionary(number)
    if board.columns * board.rows // 2 > len(markers.bytesList):
        raise InputError(
            f"--board: {board.columns} x {board.rows} squares hold more markers than {board.dictionary} has; take a "
            "larger dictionary"
        )
    pattern = cv2.aruco.CharucoBoard(shape, board.square, board.marker, markers)
    pattern.setLegacyPattern(legacy)
    return cv2.aruco.CharucoDetector(pattern)


def _find_checkerboard(cv2: ModuleType, picture: NDArray[np.uint8], board: Board) -> Array | None:
    """The corners `(corner, 2)` of a board whose first square is dark; None where it is not shown whole.

    OpenCV may begin at another corner of the board. A mirrored order is turned back, and the colour of the first square
    tells half a turn.
    """
    shape = board.columns - 1, board.rows - 1
    detected, corners = cv2.findChessboardCornersSB(picture, shape, flags=cv2.CALIB_CB_ACCURACY)
    if not detected:
        return None
    grid = np.reshape(corners, (shape[1], shape[0], 2)).astype(float)
    along = (grid[0, -1] - grid[0, 0]).tolist()
    across = (grid[-1, 0] - grid[0, 0]).tolist()
    if along[0] * across[1] < along[1] * across[0]:
        grid = grid[::-1]
    middles = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    column, row = np.round(middles).astype(int).reshape(-1, 2).T
    inner = board.rows - 2, board.columns - 2
    shade = picture[row, column].astype(float).reshape(inner)
    dark = np.add.outer(np.arange(inner[0]), np.arange(inner[1])) % 2 == 0
    if shade[dark].mean() > shade[~dark].mean():
        grid = grid[::-1, ::-1]
    return grid.reshape(-1, 2)


def _describe_unseen(images: Sequence[Path], board: Board, layout: str) -> str:
    """That no image shows a board, with what they show instead."""
    folder = images[0].parent if images else "images"
    squares = f"{board.columns} x {board.rows} squares"
    if not board.dictionary:
        return (
            f"{folder}: none of {len(images)} images shows the whole of a checkerboard of {squares}; count its "
            "squares, not its corners, and give --board checkerboard:COLUMNSxROWS,SQUAREmm"
        )
    return (
        f"{folder}: none of {len(images)} images shows a ChArUco board of {squares} with markers {board.dictionary}"
        f"{layout}; give those of the printed one, --board charuco:COLUMNSxROWS,SQUAREmm,MARKERmm,DICTIONARY"
    )


def calibrate_lens(corners: Corners, board: Board, mounted: str) -> tuple[CameraSettings, float]:
    """The lens that the images themselves show, as a start that is refined, and the RMS error of their corners, px.

    Raises:
        InputError: OpenCV is missing, or fewer than three images show the board.
    """
    cv2 = _opencv()
    points = np.array(board.settings.points, np.float32)
    visible = [np.isfinite(image[:, 0]) for image in corners.pixels[corners.shown]]
    if len(visible) < 3:
        raise InputError(
            f"{len(visible)} images show the board, too few to calibrate the camera; give it, "
            "--set 'camera={mounted: fixed, fx: ..., fy: ..., cx: ..., cy: ...}'"
        )
    image_points = [
        image[mask].astype(np.float32) for image, mask in zip(corners.pixels[corners.shown], visible, strict=True)
    ]
    try:
        error, K, distortion, *_ = cv2.calibrateCamera(
            [points[mask] for mask in visible], image_points, corners.size, None, None
        )
    except cv2.error as failed:
        raise InputError("images: show no lens; take some of the board turned by 30° and more") from failed
    lens = tuple(map(float, np.ravel(distortion)[:5]))
    width, height = map(float, corners.size)
    pinhole = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    return CameraSettings(mounted, *pinhole, lens, width, height, "refine"), float(error)  # type: ignore[arg-type]


def _opencv() -> ModuleType:
    try:
        return import_module("cv2")
    except ImportError as error:
        raise InputError("detect takes OpenCV; pip install 'lite6jax[camera]'") from error
