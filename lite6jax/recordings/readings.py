"""Readings that are no poses: touched points and planes, distances, heights along an axis, corners seen by a camera."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from lite6jax.array_types import Array
from lite6jax.errors import InputError
from lite6jax.fields import field_values
from lite6jax.recordings.columns.column import READINGS, spelled
from lite6jax.recordings.settings import RecordingSettings
from lite6jax.sensors.camera import BoardPoses, Lens, board_poses
from lite6jax.sensors.kinds import KINDS, Kind

LARGEST_CORNER = 10_000


@final
@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of one kind.

    Attributes:
        kind: of what.
        group: `(sample,)` int, which contact, plane or anchor; zero of what has but one.
        names: of each of these.
        value: `(sample,)` m, of a distance or along an axis; zero of touches.
        pixels: `(sample, corner, 2)` of a camera, NaN where a corner was not seen; `(sample, 0, 2)` of others.
        seen: the poses that a camera's corners give; None before they are computed, and of other readings.
    """

    kind: Kind
    group: NDArray[np.int64]
    names: tuple[str, ...]
    value: Array
    pixels: Array
    seen: BoardPoses | None = None

    @property
    def numbers(self) -> int:
        """How many numbers a sample measures, once corners are a pose."""
        return KINDS[self.kind].numbers

    def declared_noise(self, settings: RecordingSettings) -> float | None:
        """One sigma that a sidecar declares, m, or px of a camera."""
        return field_values(settings)[KINDS[self.kind].noise]

    def select(self, rows: Any) -> "Readings":
        """Those of some samples."""
        poses = None if self.seen is None else self.seen.select(rows)
        return replace(self, group=self.group[rows], value=self.value[rows], pixels=self.pixels[rows], seen=poses)

    def with_poses(self, settings: RecordingSettings, source: str) -> "Readings":
        """Adds to readings of a camera the poses that its corners give by the lens and the board of the settings.

        Raises:
            InputError: no lens, no board, a corner that the board lacks, corners outside one plane.
        """
        if settings.camera is None or (settings.board is None and settings.points_m is None):
            key = "camera" if settings.camera is None else "board (or points_m)"
            raise InputError(f"{source}: has corners of images and no {key} in its sidecar; declare {key}")
        points = settings.board.points if settings.board is not None else settings.points_m
        corners = np.array(points, float).reshape(-1, 3)
        count = self.pixels.shape[1]
        if count > len(corners):
            raise InputError(f"{source}: has corner {count - 1}, and the board only {len(corners)}, counted from 0")
        camera = settings.camera
        lens = Lens(np.array([camera.fx, camera.fy, camera.cx, camera.cy]), np.array(camera.distortion))
        noise = 0.0 if settings.board is None else settings.board.noise_m
        pixels = np.pad(self.pixels, ((0, 0), (0, len(corners) - count), (0, 0)), constant_values=np.nan)
        refined = camera.intrinsics == "refine"
        try:
            poses = board_poses(camera.mounted, lens, corners, pixels, settings.pixel_noise_px, noise, refined)
        except ValueError as error:
            raise InputError(f"{source}: points_m: {error}; give those of a flat board") from error
        return replace(self, seen=poses)

    def columns(self) -> dict[str, np.ndarray]:
        """The columns of a table, `(sample,)` each; of a camera none, as a row there is a corner."""
        labels = np.array(self.names, dtype=object)[self.group]
        if KINDS[self.kind].touched:
            return {self.kind: labels}
        if self.kind == "camera":
            return {}
        anchors = {"anchor": labels} if len(self.names) > 1 else {}
        return {f"{self.kind}_m": self.value, **anchors}

    def corner_rows(self, columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """A table with a row for each corner that a camera saw, in which the columns of an image repeat."""
        image, corner = np.nonzero(np.isfinite(self.pixels).all(2))
        u, v = self.pixels[image, corner].T
        repeated = {name: column[image] for name, column in columns.items()}
        return {"image": image.astype(str).astype(object), **repeated, "corner": corner, "u_px": u, "v_px": v}


def readings_from_arrays(
    kind: Kind, *, value: Any = None, labels: Sequence[str] | None = None, pixels: Any = None
) -> Readings:
    """Readings of arrays: of touches their labels, of distances and heights their values, of a camera its pixels.

    Args:
        kind: of what.
        value: `(sample,)` m.
        labels: `(sample,)`, which contact, plane or anchor; one where not given.
        pixels: `(sample, corner, 2)`, NaN where a corner was not seen.
    """
    samples = next(len(array) for array in (value, labels, pixels) if array is not None)
    names = tuple(dict.fromkeys(labels or ())) or (kind,)
    group = np.zeros(samples, np.int64) if labels is None else np.array([names.index(label) for label in labels])
    value = np.zeros(samples) if value is None else np.asarray(value, float)
    pixels = np.zeros((samples, 0, 2)) if pixels is None else np.asarray(pixels, float)
    return Readings(kind, group, names, value, pixels)


def with_readings(
    arrays: dict[str, Any],
    values: Mapping[str, Array],
    labels: Mapping[str, tuple[str, ...]],
    source: str,
    notes: list[str],
) -> dict[str, Any]:
    """Arguments of `Recording.assembled` with the readings among the values of a table; a row an image of a camera.

    Args:
        arrays: of everything else.
        values: `(row,)` by the names of columns in SI units.
        labels: the words that the values of a column of words count.
        source: what messages begin with.
        notes: gets a sentence where poses are taken in place of readings.

    Raises:
        InputError: readings of several kinds, or an image with corners twice or joints that differ.
    """
    kinds: dict[str, Kind] = {spelled(READINGS[kind][0]): kind for kind in KINDS}
    present = [column for column in kinds if column in values]
    if not present:
        return arrays
    if arrays["position"] is not None:
        listed = ", ".join(present)
        notes.append(f"the poses x_m y_m z_m are read, and not the readings {listed}; name the others `ignore`")
        return arrays
    if len(present) > 1:
        raise InputError(
            f"{source}: has readings of several kinds, columns {present[0]} and {present[1]}; write each kind to a "
            "file of its own, and name both files: `lite6jax diagnose a.csv b.csv`"
        )
    kind = kinds[present[0]]
    samples = len(arrays["joint_position"])
    if kind == "camera":
        return _of_corners(arrays, values, source)
    value = np.zeros(samples) if KINDS[kind].touched else values[present[0]]
    names = (kind,)
    group = np.zeros(samples, np.int64)
    label = KINDS[kind].label
    if label in labels:
        missing = ~np.isfinite(values[label])
        names = labels[label]
        group = np.where(missing, 0, values[label]).astype(np.int64)
        value = np.where(missing, np.nan, value)
    return arrays | {"readings": Readings(kind, group, names, value, np.zeros((samples, 0, 2)))}


def _of_corners(arrays: dict[str, Any], values: Mapping[str, Array], source: str) -> dict[str, Any]:
    """With the corners of each image in one sample, which has the joints of its first row."""
    if needed := [name for name in ("image", "corner", "v_px") if name not in values]:
        raise InputError(f"{source}: has u_px without {needed[0]}; give image, corner, u_px and v_px, a row a corner")
    image, corner, u, v = (values[name] for name in ("image", "corner", "u_px", "v_px"))
    complete = np.isfinite([image, corner, u, v]).all(0)
    wrong = np.flatnonzero(complete & ((corner != np.round(corner)) | (corner < 0) | (corner >= LARGEST_CORNER)))
    if wrong.size:
        raise InputError(f"{source}: column corner: row {wrong[0] + 1} is {corner[wrong[0]]:g}; count corners from 0")
    if not complete.any():
        raise InputError(f"{source}: no row has image, corner, u_px and v_px; record corners")
    rows = np.flatnonzero(complete)
    numbers, first, inverse = np.unique(image[rows].astype(int), return_index=True, return_inverse=True)
    first_rows = rows[first]
    at = corner[rows].astype(int)
    q = arrays["joint_position"]
    differs = np.flatnonzero((np.abs(q[rows] - q[first_rows][inverse]) > 1e-9).any(1))
    if differs.size:
        raise InputError(
            f"{source}: row {rows[differs[0]] + 1}: its joint positions differ from those of the other corners of its "
            "image; give each image a number of its own"
        )
    pixels = np.full((len(numbers), int(at.max()) + 1, 2), np.nan)
    if np.bincount(inverse * pixels.shape[1] + at).max() > 1:
        raise InputError(f"{source}: an image has a corner twice; give each image a number of its own")
    pixels[inverse, at] = np.stack([u[rows], v[rows]], 1)
    per_image = {
        name: array[first_rows] if isinstance(array, np.ndarray) and len(array) == len(image) else array
        for name, array in arrays.items()
    }
    per_image["row"] = first_rows + 1 if arrays["row"] is None else np.asarray(arrays["row"])[first_rows]
    readings = Readings("camera", np.zeros(len(numbers), np.int64), ("board",), np.zeros(len(numbers)), pixels)
    return per_image | {"readings": readings}
