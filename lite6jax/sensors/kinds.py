"""Kinds of readings that are no poses, and how each is recorded. It imports nothing, so that commands start at once."""

from collections.abc import Mapping
from typing import Literal, NamedTuple

Kind = Literal["contact", "plane", "distance", "axis", "camera"]
"""What a recording holds, by the column that tells of it."""
ReadingName = Literal["contact", "plane", "distance", "axis", "fixed_camera", "flange_camera"]
"""What commands call a sensor of such readings."""


class ReadingKind(NamedTuple):
    """How a kind of reading is recorded; its columns are in `columns.READINGS`.

    Attributes:
        numbers: how many a sample measures; of a camera, once corners are a pose.
        label: the column that says of which place a row is; empty where there is but one.
        noise: the key of its noise in a sidecar.
        touched: whether being at the place is the reading, which then has no value.
    """

    numbers: int
    label: str
    noise: str
    touched: bool = False


KINDS: Mapping[Kind, ReadingKind] = {
    "contact": ReadingKind(3, "contact", "contact_noise_m", touched=True),
    "plane": ReadingKind(1, "plane", "plane_noise_m", touched=True),
    "distance": ReadingKind(1, "anchor", "distance_noise_m"),
    "axis": ReadingKind(1, "", "axis_noise_m"),
    "camera": ReadingKind(6, "", "pixel_noise_px"),
}
