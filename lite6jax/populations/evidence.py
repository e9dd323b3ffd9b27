"""What workers compute of reduced recordings: the scores of all candidates, and the evidence on chosen terms."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lite6jax.distribution.batches import Workers
from lite6jax.errors import InputError
from lite6jax.populations.options import PoolingOptions
from lite6jax.populations.reduced import Evidence, PooledTerm, ReducedArm

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.floating]
Asked = tuple[PooledTerm, tuple[PooledTerm, ...]]
"""A term, and those beside which it is measured."""


class Scan(NamedTuple):
    """The scores of one recording.

    Attributes:
        named: score `(number,)` and information `(number, number)` by the key of each candidate.
        waves: score `(order, 2)` and information `(order, 3)` by the key of each family.
    """

    named: dict[str, tuple[Array, Array]]
    waves: dict[str, tuple[Array, Array]]


@final
class Reduced:
    """The reduced recordings of a run, and the workers that compute with them.

    Each recording is a task of its own, computed by one thread: numbers do not depend on workers and their number.
    """

    def __init__(self, stored: Sequence[Path], options: PoolingOptions, workers: Workers) -> None:
        """Computes nothing.

        Args:
            stored: paths of files of `ReducedArm.to_bytes`.
            options: thresholds.
            workers: that compute, started.
        """
        self._stored, self.options, self._workers = tuple(stored), options, workers

    def __len__(self) -> int:
        return len(self._stored)

    def scans(self, beside: Sequence[PooledTerm]) -> Iterator[tuple[int, Scan]]:
        """The scores of each recording beside some terms, in order."""
        for number, row in self._rows(scanned, (tuple(beside), self.options)):
            yield number, _scan(row)

    def evidence(self, asked: Sequence[Asked]) -> list[list[Evidence | None]]:
        """For each recording, what it says of each term that is asked for."""
        rows = self._rows(measured, (tuple(asked), self.options))
        return [[None if one is None else _evidence(one) for one in row["evidence"]] for _, row in rows]

    def _rows(self, function: Any, given: tuple[Any, ...]) -> Iterator[tuple[int, dict[str, Any]]]:
        batches = ((number, [path.read_bytes()]) for number, path in enumerate(self._stored))
        done = self._workers.outcomes(function, batches, given, died=_died)
        waiting: dict[int, pa.Table] = {}
        following = 0
        for number, rows in done:
            waiting[number] = rows
            while following in waiting:
                yield following, _columns(waiting.pop(following))
                following += 1


def _columns(table: "pa.Table") -> dict[str, Any]:
    """The lists of a table of one row, those of numbers as arrays."""
    found: dict[str, Any] = {}
    for name in table.column_names:
        values = table[name].combine_chunks().flatten()
        found[name] = values.to_pylist() if name == "evidence" else values.to_numpy(zero_copy_only=False)
    return found


def _died(stored: bytes) -> "pa.Table":
    raise InputError(f"a process that read {len(stored)} bytes was ended; free memory, or give --processes 1")


@threadpool_limits.wrap(limits=1, user_api="blas")
def scanned(stored: Sequence[bytes], beside: tuple[PooledTerm, ...], options: PoolingOptions) -> "pa.Table":
    """The scores of one recording beside some terms, as a table of one row of lists."""
    import pyarrow as pa

    (one,) = stored
    arm = ReducedArm.from_bytes(one)
    named, score, information = arm.beside(beside, options).scores(options)
    none = np.zeros(0)
    row: dict[str, Any] = {
        "keys": [candidate.key for candidate in arm.candidates],
        "sizes": [len(candidate.names) for candidate in arm.candidates],
        "families": [family.key for family in arm.families],
        "scores": np.concatenate([none, *(each for each, _ in named)]),
        "informations": np.concatenate([none, *(each.ravel() for _, each in named)]),
        "wave_scores": score.ravel(),
        "wave_informations": information.ravel(),
    }
    return pa.table({name: pa.array([values]) for name, values in row.items()})


def _scan(row: dict[str, Any]) -> Scan:
    sizes = row["sizes"].astype(int)
    scores = np.split(row["scores"], np.cumsum(sizes)[:-1])
    informations = np.split(row["informations"], np.cumsum(sizes**2)[:-1])
    named = {
        str(key): (score, information.reshape(len(score), len(score)))
        for key, score, information in zip(row["keys"], scores, informations, strict=True)
    }
    families = [str(key) for key in row["families"]]
    score = row["wave_scores"].reshape(len(families), -1, 2)
    information = row["wave_informations"].reshape(len(families), -1, 3)
    return Scan(named, {key: (score[i], information[i]) for i, key in enumerate(families)})


@threadpool_limits.wrap(limits=1, user_api="blas")
def measured(stored: Sequence[bytes], asked: tuple[Asked, ...], options: PoolingOptions) -> "pa.Table":
    """What one recording says of each term that is asked for, as a table of one row."""
    import pyarrow as pa

    (one,) = stored
    arm, known = ReducedArm.from_bytes(one), dict[tuple[PooledTerm, ...], ReducedArm]()
    rows: list[dict[str, Any] | None] = []
    for term, beside in asked:
        if beside not in known:
            known[beside] = arm.beside(beside, options)
        found = known[beside].evidence(term, options)
        rows.append(
            None
            if found is None
            else {
                name: value.ravel() if isinstance(value, np.ndarray) else value
                for name, value in found._asdict().items()
            }
        )
    numbers = pa.list_(pa.float64())
    kind = pa.struct(
        [("score", numbers), ("information", numbers), ("covariance", numbers), ("blocks", pa.int64()),
         ("p_value", pa.float64())]
    )  # fmt: skip
    return pa.table({"evidence": pa.array([rows], pa.list_(kind))})


def _evidence(row: dict[str, Any]) -> Evidence:
    score = np.array(row["score"])
    shape = (len(score), len(score))
    return Evidence(
        score,
        np.array(row["information"]).reshape(shape),
        np.array(row["covariance"]).reshape(shape),
        int(row["blocks"]),
        float(row["p_value"]),
    )
