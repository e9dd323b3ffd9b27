"""What workers compute of reduced recordings: the scores of all candidates, and the evidence on chosen terms."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lite6jax.distribution.batches import Workers
from lite6jax.errors import InputError
from lite6jax.populations.files import from_bytes
from lite6jax.populations.functions import Function
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
        named: score `(number,)` and information `(number, number)` by the key of each candidate, or of
            each function without a name.
        waves: score `(order, 2)` and information `(order, 3)` by the key of each family.
    """

    named: dict[str, tuple[Array, Array]]
    waves: dict[str, tuple[Array, Array]]


@final
class Reduced:
    """The reduced recordings of a run, and the workers that compute with them.

    Each recording is a task of its own, computed by one thread: numbers do not depend on workers and their number.
    """

    def __init__(
        self,
        stored: Sequence[Path],
        options: PoolingOptions,
        workers: Workers,
        functions: Mapping[str, Function] | None = None,
    ) -> None:
        """Computes nothing.

        Args:
            stored: paths of files of `files.to_bytes`.
            options: thresholds.
            workers: that compute, started.
            functions: by key, those without a name, over the ranges of all recordings.
        """
        self._stored, self.options, self._workers = tuple(stored), options, workers
        self.functions = dict(functions or {})

    def __len__(self) -> int:
        return len(self._stored)

    def scans(self, beside: Sequence[PooledTerm]) -> Iterator[tuple[int, Scan]]:
        """The scores of each recording beside some terms, in order."""
        for number, row in self._rows(scanned, (tuple(beside), self._among(beside), self.options)):
            yield number, _scan(row)

    def scans_of_functions(self, beside: Sequence[PooledTerm]) -> Iterator[tuple[int, Scan]]:
        """Those of all functions without a name, in place of candidates and waves."""
        given = tuple(beside), tuple(self.functions.values()), self.options, True
        for number, row in self._rows(scanned, given):
            yield number, _scan(row)

    def evidence(self, asked: Sequence[Asked]) -> list[list[Evidence | None]]:
        """For each recording, what it says of each term that is asked for."""
        functions = self._among([one for term, beside in asked for one in (term, *beside)])
        rows = self._rows(measured, (tuple(asked), functions, self.options))
        return [[None if one is None else _evidence(one) for one in row["evidence"]] for _, row in rows]

    def _among(self, terms: Sequence[PooledTerm]) -> tuple[Function, ...]:
        keys = dict.fromkeys(term.key for term in terms)
        return tuple(self.functions[key] for key in keys if key in self.functions)

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
def scanned(
    stored: Sequence[bytes],
    beside: tuple[PooledTerm, ...],
    functions: tuple[Function, ...],
    options: PoolingOptions,
    of_functions: bool = False,
) -> "pa.Table":
    """The scores of one recording beside some terms, as a table of one row of lists.

    Args:
        stored: the file of the recording.
        beside: terms that are in the model.
        functions: without a name.
        options: thresholds.
        of_functions: whether the scores are of these, in place of the candidates and waves.
    """
    import pyarrow as pa

    (one,) = stored
    arm = from_bytes(one).over(functions).beside(beside, options)
    if of_functions:
        keys, families = [function.key for function in arm.functions], []
        named, score, information = arm.scores_of_functions(options), np.zeros(0), np.zeros(0)
    else:
        keys, families = ([each.key for each in some] for some in (arm.candidates, arm.families))
        named, score, information = arm.scores(options)
    none = np.zeros(0)
    row: dict[str, Any] = {
        "keys": keys,
        "sizes": [len(each) for each, _ in named],
        "families": families,
        "scores": np.concatenate([none, *(each for each, _ in named)]),
        "informations": np.concatenate([none, *(each.ravel() for _, each in named)]),
        "wave_scores": score.ravel(),
        "wave_informations": information.ravel(),
    }
    return pa.table({name: pa.array([values], pa.list_(_kind(name))) for name, values in row.items()})


def _kind(column: str) -> "pa.DataType":
    import pyarrow as pa

    return {"keys": pa.string(), "families": pa.string(), "sizes": pa.int64()}.get(column, pa.float64())


def _scan(row: dict[str, Any]) -> Scan:
    sizes = row["sizes"].astype(int)
    scores = np.split(row["scores"], np.cumsum(sizes))[:-1]
    informations = np.split(row["informations"], np.cumsum(sizes**2))[:-1]
    named = {
        str(key): (score, information.reshape(len(score), len(score)))
        for key, score, information in zip(row["keys"], scores, informations, strict=True)
    }
    families = [str(key) for key in row["families"]]
    orders = row["wave_scores"].size // (2 * max(len(families), 1))
    score = row["wave_scores"].reshape(len(families), orders, 2)
    information = row["wave_informations"].reshape(len(families), orders, 3)
    return Scan(named, {key: (score[i], information[i]) for i, key in enumerate(families)})


@threadpool_limits.wrap(limits=1, user_api="blas")
def measured(
    stored: Sequence[bytes], asked: tuple[Asked, ...], functions: tuple[Function, ...], options: PoolingOptions
) -> "pa.Table":
    """What one recording says of each term that is asked for, as a table of one row."""
    import pyarrow as pa

    (one,) = stored
    arm, known = from_bytes(one).over(functions), dict[tuple[PooledTerm, ...], ReducedArm]()
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
