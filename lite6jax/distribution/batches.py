"""A function over many inputs, batch by batch: kept as they come, retried where a worker dies, written in order."""

import hashlib
import io
import pickle
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, final

from lite6jax import storage, threads
from lite6jax.distribution.workers import Cluster, Function, Processes
from lite6jax.errors import InputError
from lite6jax.fitting.compiled import versions

if TYPE_CHECKING:  # imported in functions, while processes start
    import pyarrow as pa

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
    function: Function,
    batches: Sequence[Sequence[Any]],
    given: tuple[Any, ...] = (),
    *,
    out: Path,
    content: Callable[[Sequence[Any]], bytes],
    died: Callable[[Any], "pa.Table"],
    store: "Callable[[Sequence[Any], pa.Table], pa.Table]" = lambda inputs, rows: rows,
    is_intact: "Callable[[pa.Table], bool]" = lambda rows: True,
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
        batches: the inputs; each is asked for once, so that it may be read then.
        given: to the function with each batch.
        out: the table to write.
        content: of the inputs of a batch, all on which its rows depend besides `given`; its checksum is taken.
        died: the row of an input at which workers die.
        store: called with the inputs of a batch and its rows before they are kept; returns what is to be kept.
        is_intact: of rows that were kept, whether what `store` made of them still stands.
        scheduler: the address of the scheduler of a Dask cluster; processes of this machine where not given.
        processes: so many; one a core where not given, and none but this one for 0.
        progress: called with the number of inputs done since the last call.
        overwrite: whether a table that is there may be replaced.

    Raises:
        InputError: as `storage.write_atomically`, `Parts.keep` and `workers.Cluster`.
        Exception: what the function raised.
    """
    parts = Parts(out, function.__module__, function.__qualname__, given)
    keys: list[str] = []
    sizes: list[int] = []
    at_work: dict[int, Sequence[Any]] = {}
    kept = 0

    def batches_to_do() -> Iterator[tuple[int, Sequence[Any]]]:
        nonlocal kept
        for number, inputs in enumerate(batches):
            keys.append(parts.key(content(inputs)))
            sizes.append(len(inputs))
            rows = parts.find(keys[number])
            if rows is None or not is_intact(rows):
                at_work[number] = inputs
                yield number, inputs
            else:
                kept += len(inputs)
                progress(len(inputs))

    def rows_in_order() -> "Iterator[pa.Table]":
        for key in keys:
            if (rows := parts.find(key)) is None:
                raise InputError(f"{parts.folder}: was changed while it was being written; give the same command again")
            yield rows

    with Workers(scheduler, processes, len(batches)) as workers:
        for number, rows in workers.outcomes(function, batches_to_do(), given, died=died):
            parts.keep(keys[number], store(at_work.pop(number), rows))
            progress(sizes[number])
    write_tables(rows_in_order(), out, overwrite)
    parts.remove()
    return Run(out, sum(sizes), kept)


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
                yield number, rows  # kept before more is begun: a run that is killed loses what its workers have
            fill()


@final
class Parts:
    """The rows of the batches that are done, a file each in a folder beside the table that a run is to write.

    A file is named after all on which its rows depend: what the inputs hold, what was asked for, and the versions of
    the package and its libraries. So a run that was ended goes on, and where any of these differs a batch is done
    again.

    Attributes:
        folder: which is there from the first `keep` until `remove`.
    """

    def __init__(self, out: Path, *asked: Any) -> None:
        """Reads nothing.

        Args:
            out: the table, beside which the folder stands.
            asked: what the rows depend on besides the inputs; can be pickled.
        """
        self.folder = out.with_name(f"{out.name}.parts")
        pickled = io.BytesIO()
        pickler = pickle.Pickler(pickled)
        pickler.fast = True  # equal values have equal bytes, whether parts of them are the same object or not
        pickler.dump((versions(), asked))
        self._asked = pickled.getvalue()

    def key(self, content: bytes) -> str:
        """What a batch is known by, as hexadecimal digits, of the content of its inputs."""
        return hashlib.sha256(self._asked + content).hexdigest()

    def find(self, key: str) -> "pa.Table | None":
        """The rows of the batch with this key; None where there are none, or a kill cut them short."""
        import pyarrow as pa
        from pyarrow import feather

        try:
            return feather.read_table(str(self._file(key)), memory_map=False)
        except (OSError, pa.ArrowException):
            return None

    def keep(self, key: str, rows: "pa.Table") -> None:
        """Adds the rows of a batch.

        Raises:
            InputError: the disk is full, or cannot be written to.
        """
        from pyarrow import feather

        try:
            self.folder.mkdir(exist_ok=True)
            feather.write_feather(rows, str(self._file(key)))
        except OSError as error:
            raise InputError(
                f"{self.folder}: cannot be written ({error.strerror or error}); free space, and the same command goes "
                "on where it stopped"
            ) from error

    def remove(self) -> None:
        """Removes the files, and the folder unless there is something else in it."""
        for file in self.folder.glob("*.arrow"):
            file.unlink(missing_ok=True)
        if self.folder.is_dir() and not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _file(self, key: str) -> Path:
        return self.folder / f"{key}.arrow"


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
