"""Rows of a folder kept as they are made, so that a run that was ended goes on where it stopped."""

import hashlib
import json
import os
import pickle
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from lite6jax.errors import InputError
from lite6jax.fitting.folder_rows import Row, kind_of
from lite6jax.fitting.version import versions
from lite6jax.recordings import read_settings, sidecar_path

_FIRST_LINE = b'{"kept by": "lite6jax fleet"}\n'


class KeptRows:
    """A file of lines of JSON beside the table: a group of files that were fitted together, with their rows.

    A group is known by the content of its files and of those that they name, by what was asked for, and by the versions
    of the package and its libraries. Where any of these differs, it is fitted again.

    Attributes:
        path: of the file, which is there from the first `keep` on until `remove`.
        used: the number of rows taken from it.
    """

    def __init__(self, out: Path, *asked: Any) -> None:
        """Reads what an earlier run kept.

        Args:
            out: the table, beside which the file stands.
            asked: what the rows depend on besides the files; to be pickled.

        Raises:
            InputError: the file is there, and another program's.
        """
        self.path = out.with_name(f"{out.name}.kept")
        self.used = 0
        self._asked = pickle.dumps((versions(), *asked), protocol=4)
        self._rows: dict[str, list[Row]] = {}
        try:
            lines = self.path.read_bytes().splitlines(keepends=True)
        except FileNotFoundError:
            return
        except OSError as error:
            raise InputError(
                f"{self.path}: cannot be read ({error.strerror}); remove it, or choose another --out"
            ) from error
        if lines and lines[0] != _FIRST_LINE:
            raise InputError(f"{self.path}: is not of a run of fleet; move it away, or choose another --out")
        for line in lines[1:]:
            with suppress(ValueError, KeyError, TypeError):  # cut short by what ended the run
                content = json.loads(line)
                self._rows[content["group"]] = [Row.from_json(row) for row in content["rows"]]

    def find(self, key: str) -> list[Row] | None:
        """The rows of the group with this key, or None where they are not known."""
        rows = self._rows.get(key)
        self.used += len(rows or ())
        return rows

    def keep(self, key: str, rows: Sequence[Row]) -> None:
        """Adds the rows of a group; on a full disk without a word, as the table will say it."""
        line = json.dumps({"group": key, "rows": [row.as_json() for row in rows]})
        with suppress(OSError), open(self.path, "ab") as file:
            file.write(b"\n" if file.tell() else _FIRST_LINE)  # the last line may have been cut short
            file.write(line.encode() + b"\n")

    def remove(self) -> None:
        """Removes the file, once the table is written."""
        self.path.unlink(missing_ok=True)

    def key(self, group: Sequence[Path]) -> str:
        """What a group is known by, as hexadecimal digits; before it is fitted, as every file is read for it."""
        digest = hashlib.sha256(self._asked)
        for path in group:
            digest.update(os.fsencode(path.name) + b"\0")
            for part in (path, *_named_by(path)):
                digest.update(_content(part))
        return digest.hexdigest()


def _named_by(path: Path) -> list[Path]:
    """The files on which a recording's fit depends besides the recording."""
    if kind_of(path) == "calibration":
        return []
    sidecar = sidecar_path(path)
    try:
        settings = read_settings(sidecar)
    except InputError:  # the row will say it, and it follows from the sidecar's content
        return [sidecar]
    arm = settings.arm_reference(path.parent) if settings.arm_is_file else None
    return [sidecar, *(Path(part) for part in (arm, settings.factory_path(path.parent)) if part is not None)]


def _content(path: Path) -> bytes:
    """The SHA-256 of a file; of one that cannot be read, as many zeros."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").digest()
    except OSError:
        return bytes(32)
