"""Marks in the place of measurements: numbers that repeat exactly among others that do not.

A bus that is silent, or a sensor that sees nothing, leaves such numbers as -1000, -1, 0 or the last ones read. What
repeats exactly may be a mark; whether it is one is decided by what is known of the arm or of the motion.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from lite6jax.array_types import Array, Integers, Mask
from lite6jax.fields import field_values
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.recordings.recording import Recording

ARRAYS = ("joint_position", "position", "joint_torque", "motor_current")
"""Of a recording, in which marks are looked for."""
LARGEST_SHARE = 0.5
"""Of the rows, of which fewer are marks."""


class Mark(NamedTuple):
    """Numbers of some rows that may be marks.

    Attributes:
        array: of the recording that holds them, one of `ARRAYS`.
        column: the only column of the array that holds it, from 0; None where they all do.
        value: the number, in SI units; None where the columns hold several, which repeat together.
        samples: the rows that hold it, in order.
    """

    array: str
    column: int | None
    value: float | None
    samples: Integers

    def fault(self, recording: Recording, samples: Integers) -> DataFault:
        """The mark in some samples of a recording."""
        column = None if self.column is None else self.column + 1
        slides = {*recording.sliding} & ({*range(recording.dof)} if self.column is None else {self.column})
        unit = {"position": "m", "joint_torque": "Nm", "motor_current": "A"}.get(self.array, "m" if slides else "rad")
        numbers = {"array": self.array, "value": self.value, "unit": unit, "column": column}
        return DataFault("placeholder", row_numbers(recording.row[samples]), numbers)


def repeated_vectors(values: Array) -> Mask:
    """Which rows `(sample, column)` repeat another one exactly, or hold one number in all of several columns."""
    _, group, count = np.unique(values, axis=0, return_inverse=True, return_counts=True)
    uniform = (values == values[:, :1]).all(1) & (values.shape[1] > 1)
    return (count[group.ravel()] > 1) | uniform


def possible_marks(recording: Recording) -> list[Mark]:
    """All that may be marks, of whole rows first; of rows that repeat in all columns, none of single ones."""
    recorded = field_values(recording)
    marks = [mark for array in ARRAYS for mark in _of_array(array, recorded[array])]
    return [mark for mark in marks if len(mark.samples) < LARGEST_SHARE * recording.samples]


def _of_array(array: str, values: Array | None) -> list[Mark]:
    if values is None:
        return []
    rows = np.flatnonzero(np.isfinite(values).all(1))
    repeated = rows[repeated_vectors(values[rows])]
    _, group = np.unique(values[repeated], axis=0, return_inverse=True)
    marks = []
    for samples in (repeated[group.ravel() == k] for k in range(int(group.max(initial=-1)) + 1)):
        uniform = bool((values[samples[0]] == values[samples[0], 0]).all())
        marks.append(Mark(array, None, float(values[samples[0], 0]) if uniform else None, samples))
    single = np.setdiff1d(rows, repeated)
    for column in range(values.shape[1]):
        numbers, group, count = np.unique(values[single, column], return_inverse=True, return_counts=True)
        if len(numbers) <= LARGEST_SHARE * len(single):  # steps of an encoder, or commands
            continue
        repeats = np.flatnonzero(count > 1)
        marks += [Mark(array, column, float(numbers[k]), single[group.ravel() == k]) for k in repeats]
    return marks


def without_marks(
    recording: Recording,
    marks: Sequence[Mark],
    lost_of: Callable[[Mark, Integers, Mask], Integers],
) -> tuple[Recording, list[DataFault]]:
    """The recording without rows that hold no measurement, and a fault for each mark.

    Args:
        recording: any.
        marks: in the order in which they are judged.
        lost_of: of a mark, its samples that no earlier one has and the rows lost so far, the samples that are lost.
    """
    lost = np.zeros(recording.samples, bool)
    faults = []
    for mark in marks:
        rows = mark.samples[~lost[mark.samples]]
        if len(rows):
            rows = lost_of(mark, rows, lost)
        if len(rows):
            lost[rows] = True
            faults.append(mark.fault(recording, rows))
    return (recording.without_rows(lost) if faults else recording), faults
