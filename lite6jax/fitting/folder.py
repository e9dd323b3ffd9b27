"""Every file of a folder fitted, group by group: what was done before is kept, and no file stops the others."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lite6jax import storage
from lite6jax.errors import InputError
from lite6jax.fitting.folder_rows import CALIBRATIONS, RECORDINGS, Row

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.fitting.contained import Contained
    from lite6jax.fitting.folder_fit import RecordingFit
    from lite6jax.fitting.kept_rows import KeptRows

GROUP = 256
"""Calibrations fitted together, as a whole: so their numbers do not depend on what was done before."""


def folder_files(folder: str | Path, leave_out: Path | None = None) -> list[Path]:
    """The calibrations and recordings of a folder by name; a recording's sidecar belongs to it and is not listed.

    Raises:
        InputError: not a folder, or none in it.
    """
    folder = Path(folder)
    if not os.path.isdir(folder):
        raise InputError(f"{folder}: {'is not a folder' if storage.exists(folder) else 'no such folder'}; name one")
    out = leave_out.resolve() if leave_out else None
    if leave_out and out and out.is_file() and out.parent == folder.resolve() and not _holds_rows(out):
        raise InputError(f"{leave_out}: is one of the files to be fitted and would be replaced; choose another name")
    files = sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in CALIBRATIONS + RECORDINGS
        and path.is_file()
        and not path.name.startswith(".")
        and path.resolve() != out
    )
    recordings = {path.stem for path in files if path.suffix.lower() in RECORDINGS}
    files = [path for path in files if path.suffix.lower() != ".yaml" or path.stem not in recordings]
    if not files:
        accepted = ", ".join(CALIBRATIONS + RECORDINGS)
        raise InputError(f"{folder}: has no calibration or recording ({accepted}); name another folder")
    return files


def _holds_rows(path: Path) -> bool:
    """Whether a Parquet file is what `write_rows` writes, not a recording."""
    import pyarrow
    import pyarrow.parquet

    try:
        return {"file", "kind", "result"} <= set(pyarrow.parquet.read_schema(path).names)
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError):
        return False


def fit_folder(
    files: Sequence[Path],
    nominal: "Arm | None" = None,
    progress: Callable[[int], object] = lambda done: None,
    fit_one: "RecordingFit | None" = None,
    kept: "KeptRows | None" = None,
    process: "Contained | None" = None,
) -> list[Row]:
    """Fits every file: calibrations together by type of arm, recordings one by one.

    Args:
        files: as `folder_files` lists them.
        nominal: the arm of all of them; recognised file by file where not given.
        progress: called with the number of files done since the last call.
        fit_one: the fit of a recording, such as one that screens it for data faults first; `fit_recording` where not
            given.
        kept: of an earlier run, and gets the rows of this one.
        process: in which the files are fitted, so that its death costs the file at hand only; None for this one.

    Returns:
        a row a file, in their order. They do not depend on `kept` or `process`, but of a file that ends the process.
    """
    if fit_one is None:
        from lite6jax.fitting.recording_fit import fit_recording as fit_one
    rows: dict[Path, Row] = {}
    for group in _groups(files):
        key = kept.key(group) if kept is not None else ""
        found = kept.find(key) if kept is not None else None
        if found is None:
            found = _fitted(group, nominal, progress, fit_one, process)
            if kept is not None:
                kept.keep(key, found)
        else:
            progress(len(group))
        rows |= zip(group, found, strict=True)
    return [rows[path] for path in files]


def _fitted(
    group: Sequence[Path],
    nominal: "Arm | None",
    progress: Callable[[int], object],
    fit_one: "RecordingFit",
    process: "Contained | None",
) -> list[Row]:
    if process is not None:
        return process.fit(group, nominal, fit_one, progress)
    from lite6jax.fitting.folder_fit import fit_files

    rows = fit_files(group, nominal, fit_one)
    progress(len(group))
    return rows


def _groups(files: Sequence[Path]) -> list[Sequence[Path]]:
    calibrations = [path for path in files if path.suffix.lower() in CALIBRATIONS]
    recordings = [path for path in files if path.suffix.lower() in RECORDINGS]
    return [
        *(calibrations[first : first + GROUP] for first in range(0, len(calibrations), GROUP)),
        *([path] for path in recordings),
    ]
