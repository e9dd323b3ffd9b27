"""Rows of batches kept as they come, so that a run that was ended goes on where it stopped."""

import hashlib
import json
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, final

from lite6jax.distribution.canonical import canonical
from lite6jax.errors import InputError
from lite6jax.fitting.compiled import versions

_FIRST_LINE = b'{"kept by": "lite6jax"}\n'


class _Place(NamedTuple):
    """Where the rows of a batch are in the file, and their checksum."""

    first: int
    size: int
    sha256: str


@final
class Kept:
    """A file beside the table that a run is to write: the rows of each batch that is done, as streams of Arrow.

    A batch is known by what its inputs hold, by what was asked for, and by the versions of the package and its
    libraries. Where any of these differs, it is done again. Rows are read when they are wanted: memory does not grow
    with their number.

    Attributes:
        path: of the file, which is there from the first `keep` on until it is removed.
    """

    def __init__(self, out: Path, *asked: Any) -> None:
        """Finds what an earlier run kept; `close` is to be called at the end.

        Args:
            out: the table, beside which the file stands.
            asked: what the rows depend on besides the inputs; of `canonical`.

        Raises:
            InputError: the file is there, and another program's.
        """
        self.path = out.with_name(f"{out.name}.kept")
        self._asked = hashlib.sha256(canonical((versions(), asked))).digest()
        self._places: dict[str, _Place] = {}
        self._end = 0
        self._file: BinaryIO | None = None
        try:
            self._file = open(self.path, "r+b")  # noqa: SIM115 (open as long as the run goes on)
            self._lock(self._file)
            self._find_all(self._file)
        except FileNotFoundError:
            return
        except InputError:
            self.close()
            raise
        except OSError as error:
            self.close()
            raise InputError(
                f"{self.path}: cannot be read ({error.strerror}); remove it, or choose another --out"
            ) from error

    def _lock(self, file: BinaryIO) -> None:
        """Has no other run write the file; where the system has no such locks, two runs at a time are not noticed."""
        try:
            import fcntl
        except ImportError:
            return
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(
                f"{self.path}: is being written by another run; wait for its end, or choose another --out"
            ) from error
        except OSError:  # a file system without locks
            return

    def _find_all(self, file: BinaryIO) -> None:
        first = file.readline(len(_FIRST_LINE))
        if first and first != _FIRST_LINE:
            raise InputError(f"{self.path}: was not kept by lite6jax; move it away, or choose another --out")
        whole = os.fstat(file.fileno()).st_size
        self._end = len(first)
        while line := file.readline(1000):
            try:
                said = json.loads(line)
                place = _Place(file.tell(), int(said["size"]), str(said["sha256"]))
            except (ValueError, KeyError, TypeError):
                return
            if place.first + place.size > whole:  # cut short by what ended the run
                return
            self._places[str(said["batch"])] = place
            self._end = file.seek(place.first + place.size)

    def key(self, content: bytes) -> str:
        """What a batch is known by, as hexadecimal digits, of the content of its inputs."""
        return hashlib.sha256(self._asked + content).hexdigest()

    def find(self, key: str) -> bytes | None:
        """The rows of the batch with this key, or None where they are not known or damaged."""
        place = self._places.get(key)
        if place is None or self._file is None:
            return None
        with suppress(OSError):
            self._file.seek(place.first)
            rows = self._file.read(place.size)
            if hashlib.sha256(rows).hexdigest() == place.sha256:
                return rows
        del self._places[key]
        return None

    def keep(self, key: str, rows: bytes) -> None:
        """Adds the rows of a batch.

        Raises:
            InputError: the disk is full, or cannot be written to.
        """
        digest = hashlib.sha256(rows).hexdigest()
        head = json.dumps({"batch": key, "size": len(rows), "sha256": digest}).encode() + b"\n"
        start = b"" if self._end else _FIRST_LINE
        try:
            if self._file is None:
                self._file = open(self.path, "x+b")  # noqa: SIM115
                self._lock(self._file)
            self._file.truncate(self._end)
            self._file.seek(self._end)
            self._file.write(start + head + rows)
            self._file.flush()
        except OSError as error:
            raise InputError(
                f"{self.path}: cannot be written ({error.strerror}); free space, and the same command goes on where it "
                "stopped"
            ) from error
        first = self._end + len(start) + len(head)
        self._places[key] = _Place(first, len(rows), digest)
        self._end = first + len(rows)

    def close(self, remove: bool = False) -> None:
        """Closes the file, and removes it once the table is written."""
        if self._file is not None:
            self._file.close()
            self._file = None
        if remove:
            self.path.unlink(missing_ok=True)


def sha256_of(paths: Sequence[str | Path]) -> bytes:
    """The SHA-256 of each file, one after the other; of one that cannot be read, as many zeros."""
    found = []
    for path in paths:
        digest = hashlib.sha256()
        try:
            with open(path, "rb", buffering=0) as file:  # most are small: what stands around the read is the time
                while block := file.read(1 << 16):
                    digest.update(block)
            found.append(digest.digest())
        except OSError:
            found.append(bytes(32))
    return b"".join(found)
