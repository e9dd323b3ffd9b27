"""Every file of a folder fitted into one table: a row a file, and of a bad file one that says why."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lite6jax.distribution.batches import Run, run_batches
from lite6jax.fitting.quality import Result
from lite6jax.folders.place import Place, batches_of, fleet_names, kind_of
from lite6jax.folders.rows import Row, table_of_rows

if TYPE_CHECKING:
    import pyarrow as pa

    from lite6jax.arms.arm import Arm


def fit_folder(
    folder: str | Path,
    out: str | Path,
    nominal: "Arm | None" = None,
    *,
    scheduler: str | None = None,
    processes: int | None = None,
    progress: Callable[[int, int], object] = lambda done, total: None,
    overwrite: bool = False,
) -> Run:
    """Fits every calibration and recording of a folder, and writes a row a file, in the order of their names.

    Args:
        folder: a path, or a URL; its subfolders are not read.
        out: the Parquet file to write.
        nominal: the arm of all of them; recognised file by file where not given.
        scheduler, processes: as `run_batches`.
        progress: called with the number of files done since the last call, and of all.
        overwrite: whether a file that is there may be replaced.

    Raises:
        InputError: as `Place.of`, `fleet_names` and `run_batches`.
    """
    place, out = Place.of(folder), Path(out)
    names = fleet_names(place, out)

    def died(name: str) -> "pa.Table":
        message = f"{name}: the process that read it was ended; the file is damaged or too large for this machine"
        return table_of_rows([Row(name, kind_of(name), Result.UNREADABLE, message)])

    return run_batches(
        fit_names,
        batches_of(names),
        (place, nominal),
        out=out,
        content=place.content,
        died=died,
        scheduler=scheduler,
        processes=processes,
        progress=lambda done: progress(done, len(names)),
        overwrite=overwrite,
    )


def fit_names(names: Sequence[str], place: Place, nominal: "Arm | None") -> "pa.Table":
    """The rows of some files of a folder, in their order."""
    # a program that has others do this does not import what it takes
    from lite6jax.folders.fit import fit_files

    with place.local_folder(names) as folder:
        rows = fit_files([folder / name for name in names], nominal, lambda said: place.show(said, folder))
    return table_of_rows(rows)
