"""A folder of inputs, of this machine or behind a URL that fsspec reads (`s3://bucket/arms`), and what is in it."""

import os
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, TypeVar, final

from lite6jax import storage, suffixes
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError, InputWarning, name_options

with import_lazily():
    from lite6jax import recordings
    from lite6jax.recordings import settings as sidecar

BATCH = 128
"""Calibrations fitted together."""
DIED = "the process that read it was ended; the file is damaged or too large for this machine"
_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+(.*)", re.DOTALL)
"""Of a path made of a URL, which has lost a slash; one letter before the colon is a drive of Windows."""
T = TypeVar("T")


def guess_kind(name: str | Path) -> Literal["calibration", "recording"]:
    """What a file should be, by its name."""
    if _suffix(name) in suffixes.CALIBRATIONS:
        return "calibration"
    return "recording"


def restore_url(path: str | Path) -> str | None:
    """The URL that a path was given as; None where it names a file or folder of this machine."""
    match = _URL.fullmatch(str(path))
    if match is None:
        return None
    scheme, address = match.groups()
    return f"{scheme}://{'/' if scheme in ('file', 'local') else ''}{address}"


def attempt(path: Path, work: Callable[[], T]) -> tuple[T | None, str]:
    """What comes of work on one file, and the warnings of its input; None where nothing does, and why."""
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", InputWarning)
            done = work()
    except InputError as error:
        return None, name_options(str(error))
    except Exception as error:  # a defect of ours, met on one file, is no reason to lose the others
        description = " ".join(f"{type(error).__name__}: {error}".split())
        return None, f"{path}: unexpected {description}; please report it with this file"
    remarks = (name_options(str(warning.message)) for warning in caught if issubclass(warning.category, InputWarning))
    return done, "; ".join(dict.fromkeys(remarks))


@final
@dataclass(frozen=True)
class StorageFolder:
    """A folder, or what is like one in an object store.

    Attributes:
        shown: as it was given: what messages name.
        root: the absolute path, or the URL.
        remote: whether it is a URL.
    """

    shown: str
    root: str
    remote: bool

    @classmethod
    def of(cls, folder: str | Path) -> "StorageFolder":
        """The folder of a path or a URL; what is behind a URL is looked at when it is listed.

        Raises:
            InputError: there is no such folder here.
        """
        url = restore_url(folder)
        if url is not None:
            return cls(url.rstrip("/"), url.rstrip("/"), True)
        if not os.path.isdir(folder):
            problem = "no such folder"
            if storage.exists(folder):
                problem = "is not a folder"
            raise InputError(f"{folder}: {problem}; name one")
        return cls(str(folder), str(Path(folder).absolute()), False)

    def names(self) -> list[str]:
        """The names of its files and folders but hidden ones, in order; behind a URL those of files only.

        Raises:
            InputError: what is behind the URL cannot be read.
        """
        if not self.remote:
            return sorted(name for name in os.listdir(self.root) if not name.startswith("."))
        store, root = _store(self.root)
        try:
            entries = store.ls(root, detail=True)
        except FileNotFoundError as error:
            raise InputError(f"{self.root}: no such folder; check the URL") from error
        except Exception as error:  # as many kinds as there are stores
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(f"{self.root}: cannot be read ({reason}); check the URL, and the access to it") from error
        file_names = (entry["name"].rstrip("/").rpartition("/")[2] for entry in entries if entry["type"] == "file")
        return sorted(name for name in file_names if name and not name.startswith("."))

    def is_file(self, name: str) -> bool:
        """Tells whether a name is that of a file."""
        return self.remote or os.path.isfile(os.path.join(self.root, name))

    @contextmanager
    def local_folder(self, names: Sequence[str]) -> Iterator[Path]:
        """A folder of this machine with these files, and those that a recording of them takes.

        What is behind a URL is copied into a temporary folder; a file that cannot be read is not there.
        """
        if not self.remote:
            yield Path(self.root)
            return
        with storage.temporary_folder() as folder:
            store, root = _store(self.root)

            def copy(part: str) -> None:
                with suppress(Exception):  # the reader of a file says what is wrong with one that is not there
                    (folder / part).parent.mkdir(parents=True, exist_ok=True)
                    store.get_file(f"{root}/{part}", str(folder / part))

            recorded = [name for name in names if guess_kind(name) == "recording"]
            for part in dict.fromkeys([*names, *(f"{_stem(name)}.yaml" for name in recorded)]):
                copy(part)
            for name in recorded:
                with suppress(InputError):  # the row will say it, and it follows from the sidecar's content
                    for _, file in sidecar.list_sidecar_files(folder / name):
                        part = os.path.relpath(file, folder)
                        if not part.startswith("..") and not file.exists():
                            copy(Path(part).as_posix())
            yield folder

    def show(self, message: str, folder: Path) -> str:
        """A message on a file of `local_folder` that names it as the user did."""
        before = f"{self.shown}/" if self.remote else str(Path(self.shown, "x"))[:-1]
        return message.replace(f"{folder}{os.sep}", before)


def list_fleet(place: StorageFolder, out: Path) -> list[str]:
    """The calibrations and recordings of a folder, without its subfolders; a recording's sidecar belongs to it and is
    not listed, and neither is `out`, the table that is to be written.

    Raises:
        InputError: none is there, the table would replace one of them, or as `StorageFolder.names`.
    """
    listed = _without_growing(place.names())
    names = [
        name
        for name in listed
        if _suffix(name) in suffixes.CALIBRATIONS + suffixes.WRITTEN_TABLES and place.is_file(name)
    ]
    if not place.remote and out.name in names and out.parent.resolve() == Path(place.root).resolve():
        if not _holds_rows(out):
            raise InputError(f"{out}: is one of the files to be fitted and would be replaced; choose another name")
        names.remove(out.name)
    recordings = {_stem(name) for name in names if guess_kind(name) == "recording"}
    names = [name for name in names if _suffix(name) != ".yaml" or _stem(name) not in recordings]
    if not names:
        accepted = ", ".join(suffixes.CALIBRATIONS + suffixes.WRITTEN_TABLES)
        raise InputError(f"{place.shown}: has no calibration or recording ({accepted}); name another folder")
    return names


def list_recordings(place: StorageFolder) -> list[str]:
    """The recordings of a folder: files, and folders that hold one.

    Raises:
        InputError: there are none, or as `StorageFolder.names`.
    """
    kinds = (*suffixes.WRITTEN_TABLES, *suffixes.LOG_FILES)

    def is_recording(name: str) -> bool:
        if place.is_file(name):
            return _suffix(name) in kinds
        return recordings.recording_file(Path(place.root, name)) is not None

    names = list(filter(is_recording, _without_growing(place.names())))
    if not names:
        raise InputError(f"{place.shown}: has no recording ({', '.join(kinds)}); name another folder")
    return names


def divide(names: Sequence[str]) -> list[list[str]]:
    """The files in their order: calibrations that follow each other `BATCH` by `BATCH`, recordings one by one."""
    batches: list[list[str]] = []
    for kind, group in groupby(names, guess_kind):
        files = list(group)
        size = BATCH if kind == "calibration" else 1
        batches += [files[first : first + size] for first in range(0, len(files), size)]
    return batches


def _suffix(name: str | Path) -> str:
    return os.path.splitext(name)[1].lower()


def _stem(name: str) -> str:
    if name.endswith(sidecar.GROWING):
        return name.removesuffix(sidecar.GROWING)
    return os.path.splitext(name)[0]


def _without_growing(names: Sequence[str]) -> list[str]:
    """Without the rows of a recording beside that recording: a process was ended between the two."""
    return [name for name in names if not name.endswith(sidecar.GROWING) or f"{_stem(name)}.parquet" not in names]


def _holds_rows(path: Path) -> bool:
    """Tells whether a Parquet file is what a run wrote, not a recording."""
    import pyarrow
    import pyarrow.parquet

    try:
        return {"file", "kind", "result"} <= set(pyarrow.parquet.read_schema(path).names)
    except (pyarrow.ArrowException, OSError, UnicodeDecodeError):
        return False


def _store(url: str) -> tuple[Any, str]:
    """The file system behind a URL, and the path there.

    Raises:
        InputError: fsspec, or what it takes for this kind of URL, is not installed; or there is no such kind.
    """
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        raise InputError(f"{url}: URLs are read by fsspec; pip install 'lite6jax[distributed]'") from error
    try:
        store, root = url_to_fs(url)
    except ImportError as error:
        raise InputError(f"{url}: {error}") from error
    except ValueError as error:
        raise InputError(f"{url}: {error}; give a path, or a URL such as s3://bucket/folder") from error
    return store, root.rstrip("/")
