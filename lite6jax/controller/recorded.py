"""What comes of recording a live arm: the files, and what there is to say about them."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lite6jax.errors import InputError
from lite6jax.recordings import RecordingSettings, sidecar_path
from lite6jax.storage import check_writable


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording that has ended.

    Attributes:
        written: the files.
        rows: on the disk.
        unwritten: rows that the disk did not take.
        refusal: why not.
        duration: s, by the controller's clock; by this computer's where the controller was asked.
        rate: rows a second within runs, by the controller's clock.
        runs: how many connections gave rows.
        missing: reports that the controller's clock has passed over within runs.
        repeated: reports that came twice, of which one is kept.
        sources: where each column's numbers come from, in words.
        settings: the sidecar's.
        notes: what else there is to say, one sentence each.
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
    """Where the calibration of a recording's arm is written: beside it."""
    return out.with_name(f"{out.stem}_factory.yaml")


def check_targets(out: Path, overwrite: bool, factory: bool = True) -> None:
    """Refuses to record over what stands there, before the arm is asked for anything.

    Raises:
        InputError: a file exists and `overwrite` is false, a name of another kind, or no such folder.
    """
    if out.suffix.lower() not in (".csv", ".parquet"):
        raise InputError(f"{out}: a recording ends in .csv or .parquet; choose such a name")
    for path in (out, sidecar_path(out), *([factory_path(out)] if factory else [])):
        check_writable(path, overwrite)
