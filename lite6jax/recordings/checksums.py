"""The checksums in a sidecar: they bind it to the table it was written with, and tell when it was edited by hand.

A table and its sidecar are two files, and no file system replaces two at once. A process that is killed between the two
leaves a new sidecar beside an old table, which the checksum of the table reveals, as it does damage to a table.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from lite6jax.errors import InputError
from lite6jax.storage import open_file

KEY = "checksums"
RECORDING = "recording_sha256"
TABLES = {".csv": "csv_sha256", ".parquet": "parquet_sha256"}
"""The key of a table's checksum, by its suffix: tables of both kinds may stand beside one sidecar."""


@final
@dataclass(frozen=True)
class Checksums:
    """What a sidecar says of the table it was written with and of itself; nothing where it was written by hand.

    Attributes:
        sidecar: the file.
        tables: key of `TABLES` to SHA-256.
        edited: whether the settings are others than those that were written.
    """

    sidecar: Path
    tables: Mapping[str, str]
    edited: bool

    def check_table(self, table: Path) -> None:
        """Refuses a table that is not the one the sidecar was written with.

        Raises:
            InputError: as said, with the remedy where the table was edited on purpose.
        """
        expected = self.tables.get(TABLES.get(table.suffix.lower(), ""))
        if expected is not None and table_checksum(table) != expected:
            raise InputError(
                f"{table}: is not the table that {self.sidecar.name} was written with (their SHA-256 differ): it is "
                "damaged or edited, or writing both was interrupted; write both again, or remove the key "
                f"{KEY} from {self.sidecar.name} where they belong together"
            )

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence where the sidecar was edited."""
        if not self.edited:
            return ()
        return (
            f"{self.sidecar.name} has been edited since it was written, and is taken as it stands; remove its key "
            f"{KEY} where that is intended",
        )


def read_checksums(content: Mapping[str, Any], sidecar: Path) -> Checksums:
    """The checksums in the parsed `content` of a sidecar.

    Raises:
        InputError: no mapping of known keys to text.
    """
    given = content.get(KEY, {})
    known = (RECORDING, *TABLES.values())
    if not isinstance(given, dict) or any(key not in known or not isinstance(given[key], str) for key in given):
        raise InputError(
            f"{sidecar}: {KEY}: holds something else than the SHA-256 of {', '.join(known)}; remove the key"
        )
    written = given.get(RECORDING)
    return Checksums(sidecar, given, written is not None and written != settings_checksum(content["recording"]))


def table_checksum(table: Path) -> str:
    """SHA-256 of a file."""
    with open_file(table) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def settings_checksum(settings: Any) -> str:
    """SHA-256 of settings as YAML reads them, whatever their order and layout in the file."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True, default=str).encode()).hexdigest()
