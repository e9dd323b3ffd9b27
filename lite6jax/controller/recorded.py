"""The result of recording a live arm: the files, counts, sources of the columns and notes."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from lite6jax.controller.gaps import Gaps
from lite6jax.errors import InputError
from lite6jax.recordings import RecordingSettings, sidecar_path
from lite6jax.recordings.stream import stream_path
from lite6jax.storage import check_writable

MOST_IN_SIDECAR = 100
"""Gaps listed in a sidecar, the longest; the columns `missing` and `gap` of the table have all."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """A completed recording.

    Attributes:
        written: the files.
        rows: the number of rows on disk.
        unwritten: the number of rows that could not be written.
        refusal: why rows are not written, or why no further ones could come.
        asked: the number of rows asked for, or None.
        short: whether there are fewer.
        duration: s, by the controller's clock; by this computer's for computed poses.
        rate: Hz, the rate of rows within runs, by the controller's clock.
        runs: the number of connections with rows.
        gaps: the missing reports, or joint positions, with row, length and reason.
        repeated: the number of duplicate reports, which are removed.
        sources: the source of each column, as a phrase.
        settings: the content of the sidecar.
        notes: remarks, one sentence each.
    """

    written: tuple[Path, ...]
    rows: int
    unwritten: int
    refusal: str
    asked: int | None
    short: bool
    duration: float
    rate: float
    runs: int
    gaps: Gaps
    repeated: int
    sources: Mapping[str, str]
    settings: RecordingSettings
    notes: tuple[str, ...]

    @property
    def missing(self) -> int:
        """The number of missing reports within and between runs, or of missing joint positions."""
        return self.gaps.within + self.gaps.between

    def account(self) -> dict[str, Any]:
        """What the sidecar says about the recording itself, in plain numbers and phrases."""
        longest = [asdict(gap) for gap in self.gaps.longest(MOST_IN_SIDECAR)]
        return {
            "complete": not self.short and not self.unwritten,
            "rows": self.rows,
            **({} if self.asked is None else {"rows_asked_for": self.asked}),
            "rows_not_written": self.unwritten,
            "runs": self.runs,
            "duplicates_removed": self.repeated,
            "reports_missing_within_runs": self.gaps.within,
            "reports_missing_between_runs": self.gaps.between,
            "gaps": self.gaps.count,
            "longest_gaps": longest,
            "notes": list(self.notes),
        }


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
    stream = [stream_path(out)] if out.suffix.lower() == ".parquet" else []
    for path in (out, *stream, sidecar_path(out), *([factory_path(out)] if factory else [])):
        check_writable(path, overwrite)
