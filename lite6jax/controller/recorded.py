"""The result of recording a live arm: the files, counts, sources of the columns and notes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lite6jax.errors import InputError
from lite6jax.recordings import RecordingSettings, sidecar_path
from lite6jax.storage import check_writable


@dataclass(frozen=True, eq=False)
class Recorded:
    """A completed recording.

    Attributes:
        written: the files.
        rows: the number of rows on disk.
        unwritten: the number of rows that could not be written.
        refusal: the reason.
        duration: s, by the controller's clock; by this computer's for computed poses.
        rate: Hz, the rate of rows within runs, by the controller's clock.
        runs: the number of connections with rows.
        missing: the number of missing reports within runs, by the controller's clock.
        repeated: the number of duplicate reports, which are removed.
        sources: the source of each column, as a phrase.
        settings: the content of the sidecar.
        notes: remarks, one sentence each.
    """

    written: tuple[Path, ...]
    rows: int
    unwritten: int
    refusal: str
    duration: float
    rate: float
    runs: int
    missing: int
    repeated: int
    sources: Mapping[str, str]
    settings: RecordingSettings
    notes: tuple[str, ...]


def factory_path(out: Path) -> Path:
    """The file beside a recording for the calibration of its arm."""
    return out.with_name(f"{out.stem}_factory.yaml")


def check_targets(out: Path, overwrite: bool, factory: bool = True) -> None:
    """Checks that the files of a recording can be written, before the connection to the arm.

    Raises:
        InputError: a file exists and `overwrite` is false, another suffix, or no such folder.
    """
    if out.suffix.lower() not in (".csv", ".parquet"):
        raise InputError(f"{out}: a recording ends in .csv or .parquet; choose such a name")
    for path in (out, sidecar_path(out), *([factory_path(out)] if factory else [])):
        check_writable(path, overwrite)
