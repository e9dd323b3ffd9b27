"""Corners of a ChArUco board in images, found by OpenCV, and the lens that they show."""

import re
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.errors import InputError
from lite6jax.recordings.files import open_table, require_table
from lite6jax.recordings.ros import ArmJoints
from lite6jax.recordings.settings import BoardSettings, CameraSettings
from lite6jax.sensors.camera import FEWEST_CORNERS

Array = NDArray[np.floating]

_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm")
_BOARD = re.compile(r"charuco:(\d{1,4})x(\d{1,4}),([\d.]+)mm(?:,([\d.]+)mm)?(?:,(?:DICT_)?(\w+))?", re.IGNORECASE)
_PARTS = re.compile(r"(\d+)")


class Board(NamedTuple):
    """A ChArUco board: a chessboard whose white squares hold markers, which number its inner corners.

    Attributes:
        columns: of squares.
        rows: of squares.
        square: m, a square's side.
        marker: m, a marker's side.
        dictionary: of the markers, as OpenCV names it after `DICT_`.
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
    """

    pixels: Array
    size: tuple[int, int]

    @property
    def shown(self) -> NDArray[np.bool_]:
        """`(image,)`, which show the board."""
        return np.asarray(np.isfinite(self.pixels[..., 0]).any(1))


def parse_board(text: str) -> Board:
    """A board from `charuco:7x5,20mm`, by its squares as OpenCV counts them.

    The side of a marker and the dictionary may follow: `charuco:7x5,20mm,15mm,5X5_100`.

    Raises:
        InputError: another form, fewer than three squares a side, or a marker that fills its square.
    """
    match = _BOARD.fullmatch(text.strip())
    if match is None:
        raise InputError(
            f"--board {text[:60]}: write charuco:COLUMNSxROWS,SQUAREmm, such as charuco:7x5,20mm; the side of a marker "
            "and the dictionary may follow, ,15mm,5X5_100. A board without markers looks the same after half a turn"
        )
    columns, rows, square, marker, dictionary = match.groups()
    try:
        side = float(square) / 1e3
        markers = float(marker) / 1e3 if marker else 0.75 * side
    except ValueError as error:
        raise InputError(f"--board {text[:60]}: {error}; give sides in mm") from error
    if min(int(columns), int(rows)) < 3 or not 0 < markers < side:
        raise InputError(f"--board {text[:60]}: give 3 squares or more a side, and markers smaller than these")
    return Board(int(columns), int(rows), side, markers, (dictionary or "4X4_50").upper())


def list_images(sources: Sequence[str | Path]) -> list[Path]:
    """The images of folders and files, each folder's in the order of the numbers in their names.

    Raises:
        InputError: no such file or folder, or a folder without images.
    """
    found: list[Path] = []
    for source in map(Path, sources):
        inside = [source] if source.is_file() else []
        if source.is_dir():
            inside = [file for file in source.iterdir() if file.suffix.lower() in _IMAGES]
            inside.sort(key=lambda file: [int(part) if part.isdecimal() else part for part in _PARTS.split(file.name)])
        if not inside:
            holds = f"holds no images ({', '.join(_IMAGES)})" if source.is_dir() else "no such file or folder"
            raise InputError(f"{source}: {holds}; name images or their folder")
        found += inside
    return found


def match_rows(images: Sequence[Path], table: Path) -> NDArray[np.integer]:
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
    found = [rows.get(file.name, rows.get(file.stem, 0)) for file in images]
    if 0 in found:
        raise InputError(f"{table}: no row is of image {images[found.index(0)].name}; name each in its column image")
    return np.array(found)


def detect_corners(images: Sequence[Path], board: Board) -> Corners:
    """The corners of a board in each image, to a fraction of a pixel.

    Raises:
        InputError: OpenCV is missing, a dictionary that it lacks, a file that is no image, images of several sizes, or
            none that shows the board.
    """
    cv2 = _opencv()
    number = getattr(cv2.aruco, f"DICT_{board.dictionary}", None)
    if number is None:
        listed = sorted(name[5:] for name in dir(cv2.aruco) if name.startswith("DICT_") and name.endswith("_50"))
        raise InputError(f"--board: OpenCV has no dictionary {board.dictionary}; take one such as {', '.join(listed)}")
    shape, markers = (board.columns, board.rows), cv2.aruco.getPredefinedDictionary(number)
    if board.columns * board.rows // 2 > len(markers.bytesList):
        raise InputError(
            f"--board: {board.columns} x {board.rows} squares hold more markers than {board.dictionary} has; take a "
            "larger dictionary"
        )
    detector = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard(shape, board.square, board.marker, markers))
    pixels = np.full((len(images), (board.columns - 1) * (board.rows - 1), 2), np.nan)
    size: tuple[int, int] = (0, 0)
    for k, file in enumerate(images):
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if image is None:
            raise InputError(f"{file}: is no image that OpenCV reads; leave it out or convert it")
        size = image.shape[::-1] if k == 0 else size
        if image.shape[::-1] != size:
            raise InputError(
                f"{file}: has {image.shape[1]} x {image.shape[0]} pixels, and {images[0].name} {size[0]} x {size[1]}; "
                "give images of one camera, none cropped"
            )
        corners, ids = detector.detectBoard(image)[:2]
        if ids is not None and len(ids) >= FEWEST_CORNERS:
            pixels[k, np.ravel(ids)] = np.reshape(corners, (-1, 2))
    if not np.isfinite(pixels).any():
        raise InputError(
            f"{images[0].parent if images else 'images'}: none of {len(images)} images shows a ChArUco board of "
            f"{board.columns} x {board.rows} squares with markers {board.dictionary}; give those of the printed one, "
            "--board charuco:COLUMNSxROWS,SQUAREmm,MARKERmm,DICTIONARY"
        )
    return Corners(pixels, size)


def calibrate_lens(corners: Corners, board: Board, mounted: str) -> tuple[CameraSettings, float]:
    """The lens that the images themselves show, as a start that is refined, and the RMS error of their corners, px.

    Raises:
        InputError: OpenCV is missing, or fewer than three images show the board.
    """
    cv2 = _opencv()
    points = np.array(board.settings.points, np.float32)
    there = [np.isfinite(image[:, 0]) for image in corners.pixels[corners.shown]]
    if len(there) < 3:
        raise InputError(
            f"{len(there)} images show the board, too few to calibrate the camera; give it, "
            "--set 'camera={mounted: fixed, fx: ..., fy: ..., cx: ..., cy: ...}'"
        )
    seen = [image[own].astype(np.float32) for image, own in zip(corners.pixels[corners.shown], there, strict=True)]
    try:
        error, K, distortion, *_ = cv2.calibrateCamera([points[own] for own in there], seen, corners.size, None, None)
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
