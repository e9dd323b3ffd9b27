"""Temporary files named after the process that writes them: a later process removes those of one that was killed."""

import os
import re
import shutil
import sys
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from lite6jax import interruption

_NAME = re.compile(r"\.lite6jax-([0-9a-f]{8})-(\d+)-")


_files: set[Path] = set()
"""Of this process, for a signal that ends it."""


def create_temporary(beside: Path) -> Path:
    """An empty file in the folder of `beside` and with its suffix; `remove_temporary` is to be called at the end.

    Raises:
        OSError: it cannot be created.
    """
    remove_left(beside.parent)
    handle, name = tempfile.mkstemp(dir=beside.parent, prefix=_prefix(), suffix=beside.suffix)
    os.close(handle)
    path = Path(name)
    _files.add(path)
    return path


def remove_temporary(path: Path) -> None:
    """Removes a file of `create_temporary`, which may have been moved to its place."""
    path.unlink(missing_ok=True)
    _files.discard(path)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """An empty folder among the system's temporary files, removed at the end with all that is in it."""
    remove_left(Path(tempfile.gettempdir()))
    path = Path(tempfile.mkdtemp(prefix=_prefix()))
    try:
        with interruption.undone(lambda: shutil.rmtree(path, ignore_errors=True)):
            yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)


@cache
def remove_left(folder: Path) -> None:
    """Removes from a folder what killed processes of this machine left there; once a process, as it lists the folder.

    What belongs to a process that runs, to another machine or to another user stays.
    """
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            match = _NAME.match(entry.name)
            if match is None or match[1] != _host() or _runs(int(match[2])):
                continue
            with suppress(OSError):
                if entry.is_dir(follow_symlinks=False):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    os.unlink(entry.path)


def _prefix() -> str:
    return f".lite6jax-{_host()}-{os.getpid()}-"


@cache
def _host() -> str:
    """This machine, as folders may be shared by several."""
    import socket

    return f"{zlib.crc32(socket.gethostname().encode()):08x}"


def _runs(process: int) -> bool:
    if sys.platform == "win32":  # there the question itself would end the process
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # it belongs to somebody else
        return True
    return True


def _remove_files() -> None:
    for path in list(_files):
        remove_temporary(path)


interruption.undo_at_signal(_remove_files)
