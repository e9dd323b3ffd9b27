"""A folder of inputs: of this machine, or behind a URL that fsspec reads, such as `s3://bucket/arms`."""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, final

from lite6jax import storage
from lite6jax.distribution.kept import sha256_of
from lite6jax.errors import InputError
from lite6jax.temporaries import temporary_folder

CALIBRATIONS = (".yaml", ".yml", ".json", ".conf")
RECORDINGS = (".csv", ".parquet", ".arrows")
LOGS = (".mcap", ".bag")
"""The suffixes of files; a recording may be a folder as well."""
_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/+(.*)", re.DOTALL)
"""Of a path made of a URL, which has lost a slash; one letter before the colon is a drive of Windows."""


def kind_of(name: str | Path) -> Literal["calibration", "recording"]:
    """What a file should be, by its name."""
    return "calibration" if os.path.splitext(name)[1].lower() in CALIBRATIONS else "recording"


def url_of(path: str | Path) -> str | None:
    """The URL that a path was given as; None where it names a file or folder of this machine."""
    match = _URL.fullmatch(str(path))
    if match is None:
        return None
    scheme, rest = match.groups()
    return f"{scheme}://{'/' if scheme in ('file', 'local') else ''}{rest}"


@final
@dataclass(frozen=True)
class Place:
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
    def of(cls, folder: str | Path) -> "Place":
        """The folder of a path or a URL.

        Raises:
            InputError: there is no such folder here; what is behind a URL is looked at when it is listed.
        """
        url = url_of(folder)
        if url is not None:
            return cls(url.rstrip("/"), url.rstrip("/"), True)
        if not os.path.isdir(folder):
            what = "is not a folder" if storage.exists(folder) else "no such folder"
            raise InputError(f"{folder}: {what}; name one")
        return cls(str(folder), str(Path(folder).absolute()), False)

    def names(self) -> list[str]:
        """The names of its files and folders but hidden ones, in order.

        Raises:
            InputError: what is behind the URL cannot be read.
        """
        if not self.remote:
            return sorted(name for name in os.listdir(self.root) if not name.startswith("."))
        store, root = _store(self.root)
        entries = _read(self.root, lambda: store.ls(root, detail=True))
        found = (entry["name"].rstrip("/").rpartition("/")[2] for entry in entries if entry["type"] == "file")
        return sorted(name for name in found if name and not name.startswith("."))

    def is_file(self, name: str) -> bool:
        """Whether a name is that of a file; behind a URL nothing else is listed."""
        return self.remote or os.path.isfile(os.path.join(self.root, name))

    def content(self, names: Sequence[str]) -> bytes:
        """What tells files from others of the same names: their SHA-256; behind a URL what the store says of each.

        Of a recording it is of its sidecar too, and of the files that this names.
        """
        if self.remote:
            store, root = _store(self.root)
            stated = (f"{root}/{part}" for name in names for part in _with_sidecar(name))
            return "\0".join((*names, *(_stated(store, path) for path in stated))).encode(errors="surrogateescape")
        found = []
        for name in names:
            if kind_of(name) == "calibration":
                found += [os.fsencode(name), b"\0", sha256_of([os.path.join(self.root, name)])]
                continue
            path = Path(self.root, name)
            files = [path] if path.is_file() else sorted(part for part in path.rglob("*") if part.is_file())
            found += [os.fsencode(name), b"\0", sha256_of([*files, *named_by(path)])]
        return b"".join(found)

    @contextmanager
    def at_hand(self, names: Sequence[str]) -> Iterator[Path]:
        """A folder of this machine with these files, and those that a recording of them takes.

        What is behind a URL is copied into a temporary folder; a file that cannot be read is not there.
        """
        if not self.remote:
            yield Path(self.root)
            return
        with temporary_folder() as folder:
            store, root = _store(self.root)
            for part in dict.fromkeys(part for name in names for part in _with_sidecar(name)):
                _copy(store, f"{root}/{part}", folder / part)
            for name in names:
                for path in named_by(folder / name):
                    part = os.path.relpath(path, folder)
                    if not part.startswith("..") and not path.exists():
                        _copy(store, f"{root}/{Path(part).as_posix()}", path)
            yield folder

    def as_shown(self, message: str, folder: Path) -> str:
        """A message on a file of `at_hand` that names it as the user did."""
        before = f"{self.shown}/" if self.remote else str(Path(self.shown, "x"))[:-1]
        return message.replace(f"{folder}{os.sep}", before)


def named_by(path: Path) -> list[Path]:
    """The files on which what a recording says depends besides its own: the sidecar, and those that this names."""
    if kind_of(path) == "calibration":
        return []
    from lite6jax.recordings import read_settings, sidecar_path

    sidecar = sidecar_path(path)
    if not storage.exists(sidecar):
        return []
    try:
        settings = read_settings(sidecar)
    except InputError:  # the row will say it, and it follows from the sidecar's content
        return [sidecar]
    arm = str(settings.arm_reference(path.parent)).partition("#")[0] if settings.arm_is_file else None
    return [sidecar, *(Path(part) for part in (arm, settings.factory_path(path.parent)) if part is not None)]


def _with_sidecar(name: str) -> list[str]:
    return [name] if kind_of(name) == "calibration" else [name, f"{Path(name).stem}.yaml"]


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


def _read(url: str, read: Callable[[], Any]) -> Any:
    """What a store answers.

    Raises:
        InputError: any of the many exceptions by which stores say that they cannot.
    """
    try:
        return read()
    except FileNotFoundError as error:
        raise InputError(f"{url}: no such folder; check the URL") from error
    except Exception as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{url}: cannot be read ({said}); check the URL, and the access to it") from error


def _stated(store: Any, path: str) -> str:
    """The checksum that a store has of a file, or when it was made and its size; empty where there is none."""
    try:
        return str(store.ukey(path))
    except FileNotFoundError:
        return ""
    except Exception as error:  # as many kinds as there are stores
        return type(error).__name__


def _copy(store: Any, path: str, target: Path) -> None:
    """Copies a file, if it is there and can be read: its reader says what is wrong with one that is not."""
    with suppress(Exception):
        target.parent.mkdir(parents=True, exist_ok=True)
        store.get_file(path, str(target))
