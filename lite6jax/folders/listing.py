"""The files of a folder that are to be fitted or diagnosed, and the batches in which they are."""

import os
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from lite6jax.errors import InputError
from lite6jax.folders.place import CALIBRATIONS, LOGS, RECORDINGS, Place, kind_of

BATCH = 128
"""Calibrations fitted together, as a whole: so their numbers do not depend on what was done before. A run that is
killed loses so many for each of its workers."""


def fleet_names(place: Place, out: Path) -> list[str]:
    """The calibrations and recordings of a folder; a recording's sidecar belongs to it and is not listed.

    Args:
        place: the folder; its subfolders are not looked into.
        out: the table that is to be written, and is no input where one is there.

    Raises:
        InputError: none is there, the table would replace one of them, or as `Place.names`.
    """
    names = [name for name in place.names() if _suffix(name) in CALIBRATIONS + RECORDINGS and place.is_file(name)]
    if not place.remote and out.name in names and out.parent.resolve() == Path(place.root).resolve():
        if not _holds_rows(out):
            raise InputError(f"{out}: is one of the files to be fitted and would be replaced; choose another name")
        names.remove(out.name)
    names = without_sidecars(names)
    if not names:
        accepted = ", ".join(CALIBRATIONS + RECORDINGS)
        raise InputError(f"{place.shown}: has no calibration or recording ({accepted}); name another folder")
    return names


def recording_names(place: Place) -> list[str]:
    """The recordings of a folder: files, and folders that hold one.

    Raises:
        InputError: there are none, or as `Place.names`.
    """
    from lite6jax.recordings import recording_file

    kinds = (*RECORDINGS, *LOGS)
    names = [
        name
        for name in place.names()
        if (_suffix(name) in kinds if place.is_file(name) else recording_file(Path(place.root, name)) is not None)
    ]
    # rows of a recording that is not complete yet, or was ended, stand in a file of the same stem
    names = [name for name in names if _suffix(name) != ".arrows" or f"{Path(name).stem}.parquet" not in names]
    if not names:
        raise InputError(f"{place.shown}: has no recording ({', '.join(kinds)}); name another folder")
    return names


def batches_of(names: Sequence[str]) -> list[list[str]]:
    """The files in their order: calibrations that follow each other `BATCH` by `BATCH`, recordings one by one."""
    batches: list[list[str]] = []
    for kind, group in groupby(names, kind_of):
        files = list(group)
        size = BATCH if kind == "calibration" else 1
        batches += [files[first : first + size] for first in range(0, len(files), size)]
    return batches


def without_sidecars(names: Sequence[str]) -> list[str]:
    """Names without those that are the sidecar of another."""
    recordings = {os.path.splitext(name)[0] for name in names if kind_of(name) == "recording"}
    return [name for name in names if _suffix(name) != ".yaml" or os.path.splitext(name)[0] not in recordings]


def _suffix(name: str) -> str:
    return os.path.splitext(name)[1].lower()


def _holds_rows(path: Path) -> bool:
    """Whether a Parquet file is what a run wrote, not a recording."""
    import pyarrow
    import pyarrow.parquet

    try:
        return {"file", "kind", "result"} <= set(pyarrow.parquet.read_schema(path).names)
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError):
        return False
