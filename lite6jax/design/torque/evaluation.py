"""What workers compute for the design of a motion: the criterion of each, ascents, and what each determines.

Motions are independent of each other and each is computed by one thread, so that numbers do not depend on the workers.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lite6jax.design.torque.ascent import Excitation, ascend
from lite6jax.design.torque.fourier import Free
from lite6jax.design.torque.identify import Structure, TorqueIdentification, identify_torques
from lite6jax.distribution.batches import Workers
from lite6jax.errors import InputError

if TYPE_CHECKING:
    from lite6jax.design.torque.planning import MotionRoom
    from lite6jax.distribution.worker import Function

Array = NDArray[np.floating]

_TOGETHER = 5
"""Motions of a batch; an ascent is a batch of its own."""


class Ascended(NamedTuple):
    """The end of an ascent.

    Attributes:
        free: the best motion met.
        value: its criterion.
        improved: how many steps led to a better one.
    """

    free: Free
    value: float
    improved: int


def values_of(workers: Workers, excitation: Excitation, motions: Sequence[Free]) -> Array:
    """`(motion,)`, the criterion of each."""
    return np.array([row["value"] for row in _rows(workers, valued, motions, _TOGETHER, (excitation,))])


def ascents(workers: Workers, excitation: Excitation, starts: Sequence[Free], steps: int) -> list[Ascended]:
    """The end of an ascent from each of some motions."""
    return [
        Ascended(_free(row), row["value"], row["improved"])
        for row in _rows(workers, ascended, starts, 1, (excitation, steps))
    ]


def identifications(
    workers: Workers, structure: Structure, room: "MotionRoom", motions: Sequence[Free]
) -> list[TorqueIdentification]:
    """What each motion determines."""
    rows = _rows(workers, identified, motions, _TOGETHER, (structure, room))
    arrays = ("span", "determined", "standard_deviation")
    for row in rows:
        row.update((name, np.array(row[name])) for name in arrays)
    return [TorqueIdentification(structure=structure, **row) for row in rows]


def _rows(
    workers: Workers, function: "Function", motions: Sequence[Free], together: int, given: tuple[Any, ...]
) -> list[dict[str, Any]]:
    plain = [Free(*(np.asarray(part) for part in free)) for free in motions]
    batches = [plain[first : first + together] for first in range(0, len(plain), together)]
    done = dict(workers.outcomes(function, enumerate(batches), given, died=_died))
    return [row for number in range(len(batches)) for row in done[number].to_pylist()]


def _died(free: Free) -> pa.Table:
    raise InputError("a process that works on the design was ended; free memory, or give --processes 1")


def _free(row: dict[str, Any]) -> Free:
    return Free(*(np.array(row[name]) for name in Free._fields))


@threadpool_limits.wrap(limits=1, user_api="blas")
def valued(motions: Sequence[Free], excitation: Excitation) -> pa.Table:
    """The criterion of motions, a row each."""
    return pa.table({"value": [excitation.value(free) for free in motions]})


@threadpool_limits.wrap(limits=1, user_api="blas")
def ascended(starts: Sequence[Free], excitation: Excitation, steps: int) -> pa.Table:
    """The ends of ascents, a row each."""
    rows = []
    for start in starts:
        free, value, improved = ascend(excitation, start, steps)
        parts = {name: np.asarray(part).tolist() for name, part in free._asdict().items()}
        rows.append({**parts, "value": value, "improved": improved})
    return pa.Table.from_pylist(rows)


@threadpool_limits.wrap(limits=1, user_api="blas")
def identified(motions: Sequence[Free], structure: Structure, room: "MotionRoom") -> pa.Table:
    """What motions determine, a row each."""
    rows = []
    for free in motions:
        found = identify_torques(structure.model, room.trajectory(room.series(free)).motion, structure=structure)
        rows.append(
            {
                "samples": found.samples,
                "span": found.span.tolist(),
                "determined": found.determined.tolist(),
                "standard_deviation": found.standard_deviation.tolist(),
                "condition": found.condition,
                "log_determinant": found.log_determinant,
                "at_rest": found.at_rest,
            }
        )
    return pa.Table.from_pylist(rows)
