"""A function over many inputs, batch by batch: kept as they come, retried where a worker dies, written in order."""

from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

from lite6jax import storage, threads
from lite6jax.distribution.kept import Kept
from lite6jax.distribution.processes import Died, Processes
from lite6jax.errors import InputError

if TYPE_CHECKING:
    import pyarrow as pa

    from lite6jax.distribution.cluster import Cluster
    from lite6jax.distribution.worker import Function

ROW_GROUP = 4096
"""Rows of a table that are written together, whatever the batches."""


class Run(NamedTuple):
    """What a run did.

    Attributes:
        path: of the table.
        rows: in the table.
        kept: how many of them an earlier run, which was ended, had kept.
    """

    path: Path
    rows: int
    kept: int


def run_batches(
    function: "Function",
    batches: Sequence[Sequence[Any]],
    given: tuple[Any, ...] = (),
    *,
    out: Path,
    content: Callable[[Sequence[Any]], bytes],
    died: Callable[[Any], "pa.Table"],
    arrived: "Callable[[int, pa.Table], pa.Table]" = lambda number, rows: rows,
    intact: "Callable[[pa.Table], bool]" = lambda rows: True,
    known: "Callable[[Sequence[Any]], pa.Table | None]" = lambda inputs: None,
    loaded: Callable[[Sequence[Any]], Sequence[Any]] = lambda inputs: inputs,
    scheduler: str | None = None,
    processes: int | None = None,
    progress: Callable[[int], object] = lambda done: None,
    overwrite: bool = False,
) -> Run:
    """Writes what a function makes of many inputs as one Parquet table, a row an input, in the order of the inputs.

    The rows of a batch are kept beside the table as they come. Where a run is ended, the next with the same inputs,
    the same `given` and the same versions goes on with what is not kept. The table's bytes do not depend on that, nor
    on the workers and their number: batches are what they are given as, and each is computed by one thread.

    Args:
        function: of a module: `function(inputs, *given)` makes a row of each input of a batch.
        batches: the inputs.
        given: to the function with each batch.
        out: the table to write.
        content: of the inputs of a batch, all on which its rows depend besides `given`; its checksum is taken.
        died: the row of an input at which workers die.
        arrived: called with the number of a batch and its rows before they are kept; returns what is to be kept.
        intact: of rows that were kept, whether what `arrived` made of them still stands.
        known: the rows of a batch that need no work, as a table has them that is to be replaced; None of the others.
        loaded: what is sent of the inputs of a batch, where it is too large to be held of all.
        scheduler: the address of the scheduler of a Dask cluster; processes of this machine where not given.
        processes: so many; one a core where not given, and none but this one for 0.
        progress: called with the number of inputs done since the last call.
        overwrite: whether a table that is there may be replaced.

    Raises:
        InputError: as `storage.write_atomically`, `Kept` and `Cluster`.
        Exception: what the function raised.
    """
    kept = Kept(out, function.__module__, function.__qualname__, given)
    keys: list[str] = [""] * len(batches)
    found = 0

    def left() -> Iterator[tuple[int, Sequence[Any]]]:
        nonlocal found
        for number, inputs in enumerate(batches):
            if (had := known(inputs)) is not None:
                keys[number] = f"known {number}"
                kept.keep(keys[number], _written(had))
                continue
            keys[number] = kept.key(content(inputs))
            rows = kept.find(keys[number])
            if rows is None or not intact(_read(rows)):
                yield number, loaded(inputs)
            else:
                found += len(inputs)
                progress(len(inputs))

    todo = outcomes(function, left(), given, died=died, scheduler=scheduler, processes=processes, most=len(batches))
    try:
        with closing(todo):
            for number, rows in todo:
                kept.keep(keys[number], _written(arrived(number, rows)))
                progress(len(batches[number]))
        written = write_tables(lambda: (_again(kept, key) for key in keys), out, overwrite)
    except BaseException:
        kept.close()
        raise
    kept.close(remove=True)
    return Run(written, sum(map(len, batches)), found)


def outcomes(
    function: "Function",
    batches: Iterable[tuple[int, Sequence[Any]]],
    given: tuple[Any, ...] = (),
    *,
    died: Callable[[Any], "pa.Table"],
    scheduler: str | None = None,
    processes: int | None = None,
    most: int | None = None,
) -> Generator[tuple[int, "pa.Table"]]:
    """Batches by their numbers with their rows, as they come; nothing is kept.

    A batch whose worker dies is tried again as a whole, as the reason may be another. Where that dies as well, its
    inputs are tried one by one, and those at which a worker dies get the row that `died` makes.

    Args:
        batches: numbers and inputs, taken as there is room for them.
        most: how many batches there are at most: more processes are not started.
        function, given, died, scheduler, processes: as `run_batches`.
    """
    with Workers(scheduler, processes, most) as workers:
        yield from workers.outcomes(function, batches, given, died=died)


@final
class Workers:
    """Processes of this machine or a cluster, started by the `with` statement.

    Any number of functions can then be run by them one after the other, each as by the function `outcomes`.
    """

    def __init__(self, scheduler: str | None = None, processes: int | None = None, most: int | None = None) -> None:
        """Starts nothing; arguments as of `outcomes`."""
        self._scheduler = scheduler
        self._here = processes == 0 and scheduler is None
        count = processes or threads.available()
        self._count = count if most is None else max(1, min(count, most))
        self._held = ExitStack()
        self._pool: Processes | Cluster | None = None

    def __enter__(self) -> "Workers":
        if self._scheduler is not None:
            from lite6jax.distribution.cluster import Cluster

            self._pool = self._held.enter_context(Cluster(self._scheduler))
        elif not self._here:
            self._pool = self._held.enter_context(Processes(self._count))
        return self

    def __exit__(self, *error: object) -> None:
        self._held.close()

    def outcomes(
        self,
        function: "Function",
        batches: Iterable[tuple[int, Sequence[Any]]],
        given: tuple[Any, ...] = (),
        *,
        died: Callable[[Any], "pa.Table"],
    ) -> Generator[tuple[int, "pa.Table"]]:
        """As the function of this name, by these workers; read it to its end before the next begins."""
        if self._pool is None:
            for number, inputs in batches:
                yield number, function(inputs, *given)
            return
        self._pool.begin(function, given)
        yield from _worked(self._pool, batches, died)


class _Task:
    """A batch, or one input of a batch at which workers died.

    Attributes:
        number: of the batch.
        inputs: of it.
        place: of the one input in the batch; None of a whole batch.
        deaths: of workers that had it.
    """

    def __init__(self, number: int, inputs: Sequence[Any], place: int | None = None) -> None:
        self.number, self.inputs, self.place, self.deaths = number, inputs, place, 0


def _worked(
    workers: "Processes | Cluster", batches: Iterable[tuple[int, Sequence[Any]]], died: Callable[[Any], "pa.Table"]
) -> Iterator[tuple[int, "pa.Table"]]:
    new, again = iter(batches), deque[_Task]()
    in_hand: dict[int, _Task] = {}
    parts: dict[int, list[pa.Table | None]] = {}
    count = 0

    def next_task() -> _Task | None:
        if again:
            return again.popleft()
        found = next(new, None)
        return None if found is None else _Task(*found)

    def fill() -> None:
        nonlocal count
        while workers.has_room and (task := next_task()) is not None:
            in_hand[count] = task
            workers.submit(count, task.inputs)
            count += 1

    fill()
    while in_hand:
        at, outcome = workers.next()
        task = in_hand.pop(at)
        if isinstance(outcome, Died):
            task.deaths += 1
            if task.deaths == 1 and task.place is None:
                again.append(task)
                rows = None
            elif len(task.inputs) > 1:
                parts[task.number] = [None] * len(task.inputs)
                again.extend(_Task(task.number, [one], i) for i, one in enumerate(task.inputs))
                rows = None
            else:
                rows = died(task.inputs[0])
        else:
            rows = _read(outcome)
        if rows is not None and task.place is not None:
            own = parts[task.number]
            own[task.place] = rows
            done = [part for part in own if part is not None]
            rows = concatenated(done) if len(done) == len(own) else None
        if rows is not None:
            yield task.number, rows  # kept before more is begun: a run that is killed loses what its workers have
        fill()


def concatenated(tables: "Sequence[pa.Table]") -> "pa.Table":
    """The rows of tables one after the other; a column that one of them lacks is null there."""
    import pyarrow as pa

    return pa.concat_tables(tables, promote_options="default")


def _again(kept: Kept, key: str) -> "pa.Table":
    rows = kept.find(key)
    if rows is None:
        raise InputError(f"{kept.path}: was changed while it was being written; give the same command again")
    return _read(rows)


def _read(stream: bytes) -> "pa.Table":
    # imported here, and below, as workers start meanwhile
    from lite6jax.distribution.worker import table_of

    return table_of(stream)


def _written(table: "pa.Table") -> bytes:
    from lite6jax.distribution.worker import of_table

    return of_table(table)


def write_tables(tables: "Callable[[], Iterator[pa.Table]]", path: Path, overwrite: bool = False) -> Path:
    """Writes the rows of tables as one Parquet file, in groups of `ROW_GROUP` rows whatever the tables' sizes.

    Args:
        tables: gives them, twice: for their columns, and for their rows.
        path: of the file.
        overwrite: whether it may be replaced.

    Raises:
        InputError: as `storage.write_atomically`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = pa.unify_schemas([*dict.fromkeys(table.schema for table in tables())])

    def write(target: Path) -> None:
        with pq.ParquetWriter(target, schema, write_page_checksum=True) as writer:
            waiting = schema.empty_table()
            for table in tables():
                waiting = concatenated([waiting, table])
                while len(waiting) >= ROW_GROUP:
                    writer.write_table(waiting.slice(0, ROW_GROUP).combine_chunks(), ROW_GROUP)
                    waiting = waiting.slice(ROW_GROUP)
            if len(waiting):
                writer.write_table(waiting.combine_chunks(), ROW_GROUP)

    return storage.write_atomically(path, write, overwrite)
