"""The time stamps of a log of commands: the period of its rows, repeated stamps, gaps, and times that go back."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.recordings.sequence import LONGEST_GAP, run_segments

_FEWEST = 50
"""Steps of time of a recording at least."""
_OFF = 0.5
"""Of the period, by which a step of time differs that is uneven."""
_UNEVEN = 0.05
"""Share of uneven steps that is said; fewer are single rows that came late or were lost."""
_MOST = (0.025, 0.975)
"""Quantiles between which most steps of time are."""
_MOST_BACK = 0.1
"""Share of rows at most, in which time goes back in a log of several runs."""


@final
@dataclass(frozen=True, eq=False)
class Stamps:
    """How the rows of a recording follow each other in time.

    Attributes:
        time: `(sample,)` s.
        run: `(sample,)`, runs of the file from 0.
        row: `(sample,)`, rows of the file.
    """

    time: Array
    run: Integers
    row: Integers

    @cached_property
    def steps(self) -> Array:
        """`(sample - 1,)` s from each row to the next one; NaN from run to run."""
        return np.where(np.diff(self.run) == 0, np.diff(self.time), np.nan)

    @cached_property
    def period(self) -> float:
        """s, the median step."""
        return float(np.median(self.steps[self.steps > 0]))

    @cached_property
    def repeated(self) -> Mask:
        """`(sample,)`, rows with the stamp of the next one, which counts in their place."""
        return np.r_[self.steps == 0, False]

    @cached_property
    def goes_back(self) -> Mask:
        """`(sample,)`, rows whose stamp is before that of the row before."""
        return np.r_[False, self.steps < 0]

    @cached_property
    def after_gap(self) -> Mask:
        """`(sample,)`, rows after a gap."""
        return np.r_[False, self.steps > LONGEST_GAP * self.period]

    @cached_property
    def pieces(self) -> list[Integers]:
        """The rows, from 0, of each run without repeated stamps, gaps and times that go back; of two rows at least."""
        begins = np.r_[True, np.isnan(self.steps)] | self.goes_back | self.after_gap
        used = np.flatnonzero(~self.repeated)
        piece = np.cumsum(begins)[used]
        by_piece = np.split(used, np.flatnonzero(np.diff(piece)) + 1)
        return [rows for rows in by_piece if len(rows) > 1]

    def faults(self) -> list[DataFault]:
        """What is said of the stamps."""
        faults = []
        if self.repeated.any():
            faults.append(self._fault("repeated_stamps", self.repeated))
        if self.after_gap.any():
            longest = float(self.steps[self.after_gap[1:]].max())
            faults.append(self._fault("time_gaps", self.after_gap, longest_s=longest))
        if self.goes_back.any():
            largest = float(-self.steps[self.goes_back[1:]].min())
            faults.append(self._fault("time_goes_back", self.goes_back, largest_step_back_s=largest))
        within = self.steps[(self.steps > 0) & (self.steps <= LONGEST_GAP * self.period)]
        if np.mean(np.abs(within / self.period - 1) > _OFF) > _UNEVEN:
            shortest, longest = (float(np.quantile(within, level)) for level in _MOST)
            numbers = {"from_s": shortest, "to_s": longest, "rate_Hz": 1 / self.period}
            faults.append(DataFault("uneven_rate", (), numbers))
        return faults

    def _fault(self, code: str, rows: Mask, **numbers: Any) -> DataFault:
        return DataFault(code, row_numbers(self.row[rows]), {**numbers, "count": int(rows.sum())})


def read_stamps(recording: Recording) -> Stamps:
    """The stamps of a recording.

    Raises:
        InputError: no times, too few rows, or rows that are not in the order of time.
    """
    if recording.time is None:
        raise InputError(f"{recording.source}: commands need times; add time_s")
    stamps = Stamps(recording.time, run_segments(recording.run), recording.row)
    if np.sum(stamps.steps > 0) < _FEWEST:
        raise InputError(f"{recording.source}: has {recording.samples} rows; record at least {_FEWEST + 1}")
    back = int(stamps.goes_back.sum())
    if back > _MOST_BACK * recording.samples:
        raise InputError(
            f"{recording.source}: time goes back in {back} of {recording.samples} rows; sort the rows by time, or give "
            "another column as time_s"
        )
    return stamps
