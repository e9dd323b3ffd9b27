"""A function over many inputs, batch by batch: retried where a worker dies, and written in order."""

import pickle
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from lite6jax import storage, threads
from lite6jax.distribution.workers import Cluster, Function, Processes

if TYPE_CHECKING:  # imported in functions, while processes start
    import pyarrow as pa

ROW_GROUP = 4096
"""Rows of a table that are written together, whatever the batches."""


def run_batches(
    function: Function,
    batches: Sequence[Sequence[Any]],
    given: tuple[Any, ...] = (),
    *,
    out: Path,
    died: Callable[[Any], "pa.Table"],
    store: "Callable[[Sequence[Any], pa.Table], pa.Table]" = lambda inputs, rows: rows,
    scheduler: str | None = None,
    processes: int | None = None,
    progress: Callable[[int], object] = lambda done: None,
    overwrite: bool = False,
) -> Path:
    """Writes what a function makes of many inputs as one Parquet table, a row an input, in the order of the inputs.

    The table's bytes do not depend on the workers and their number: each batch is computed by one thread.

    Args:
        function: of a module: `function(inputs, *given)` makes a row of each input of a batch.
        batches: the inputs.
        given: to the function with each batch.
        out: the table to write.
        died: the row of an input at which workers die.
        store: called with the inputs of a batch and its rows as they come; returns the rows of the table.
        scheduler: the address of the scheduler of a Dask cluster; processes of this machine where not given.
        processes: so many; one a core where not given, and none but this one for 0.
        progress: called with the number of inputs done since the last call.
        overwrite: whether a table that is there may be replaced.

    Raises:
        InputError: as `storage.write_atomically` and `workers.Cluster`.
        Exception: what the function raised.
    """
    tables: dict[int, pa.Table] = {}
    with Workers(scheduler, processes, len(batches)) as workers:
        for number, rows in workers.outcomes(function, enumerate(batches), given, died=died):
            tables[number] = store(batches[number], rows)
            progress(len(batches[number]))
    return write_tables([tables[number] for number in sorted(tables)], out, overwrite)


@final
class Workers:
    """Processes of this machine or a cluster, started by the `with` statement.

    Any number of functions can then be run by them, one after the other.
    """

    def __init__(self, scheduler: str | None = None, processes: int | None = None, most: int | None = None) -> None:
        """Starts nothing.

        Args:
            scheduler, processes: as of `run_batches`.
            most: how many batches there are at most: more processes are not started.
        """
        self._pool: Processes | Cluster | None = None
        if scheduler is not None:
            self._pool = Cluster(scheduler)
        elif processes != 0:
            count = processes or threads.available()
            self._pool = Processes(count if most is None else max(1, min(count, most)))

    def __enter__(self) -> "Workers":
        if self._pool is not None:
            self._pool.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        if self._pool is not None:
            self._pool.__exit__(*error)

    def outcomes(
        self,
        function: Function,
        batches: Iterable[tuple[int, Sequence[Any]]],
        given: tuple[Any, ...] = (),
        *,
        died: Callable[[Any], "pa.Table"],
    ) -> Generator[tuple[int, "pa.Table"]]:
        """Batches by their numbers with their rows, as they come; read them to their end before the next begin.

        A batch whose worker dies is tried again as a whole, as the reason may be another. Where that dies as well, its
        inputs are tried one by one, and those at which a worker dies get the row that `died` makes.

        Args:
            batches: numbers and inputs, taken as there is room for them.
            function, given, died: as of `run_batches`.

        Raises:
            InputError: no process starts, or as `workers.Cluster`.
            Exception: what the function raised.
        """
        pool = self._pool
        if pool is None:
            for number, inputs in batches:
                yield number, function(inputs, *given)
            return
        job, following = pickle.dumps((function, given)), iter(batches)
        at_work: dict[Future[Any], tuple[int, Sequence[Any], bool]] = {}

        def submit(number: int, inputs: Sequence[Any], is_again: bool = False) -> None:
            at_work[pool.submit(job, inputs)] = number, inputs, is_again

        def alone(one: Any) -> "pa.Table":
            rows = pool.take(pool.submit(job, [one]))
            return died(one) if rows is None else rows

        def fill() -> None:
            while len(at_work) < pool.room and (batch := next(following, None)) is not None:
                submit(*batch)

        fill()
        while at_work:
            for future in wait(at_work, return_when=FIRST_COMPLETED).done:
                number, inputs, is_again = at_work.pop(future)
                rows = pool.take(future)
                if rows is None and not is_again:
                    submit(number, inputs, True)
                    continue
                if rows is None:
                    rows = concatenate(map(alone, inputs)) if len(inputs) > 1 else died(inputs[0])
                yield number, rows
            fill()


def concatenate(tables: "Iterable[pa.Table]") -> "pa.Table":
    """The rows of tables one after the other; a column that one of them lacks is null there."""
    import pyarrow as pa

    return pa.concat_tables(tables, promote_options="default")


def write_tables(tables: "Iterable[pa.Table]", path: Path, overwrite: bool = False) -> Path:
    """Writes the rows of tables as one Parquet file, in groups of `ROW_GROUP` rows whatever the tables' sizes.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    import pyarrow.parquet as pq

    rows = concatenate(tables).combine_chunks()

    def write(target: Path) -> None:
        pq.write_table(rows, target, row_group_size=ROW_GROUP, write_page_checksum=True)

    return storage.write_atomically(path, write, overwrite)
