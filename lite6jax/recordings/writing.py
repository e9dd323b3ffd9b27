"""Tables to files: CSV or Parquet by the suffix, and a table with its sidecar as one."""

from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet

from lite6jax.recordings.checksums import TABLES, table_checksum
from lite6jax.recordings.settings import RecordingSettings
from lite6jax.recordings.sidecar import sidecar_path, write_settings
from lite6jax.storage import check_writable, exists, write_atomically


def write_table(table: pa.Table, path: Path) -> None:
    """Writes a table so that every number reads back bit for bit; Parquet has a checksum in each page.

    Raises:
        OSError: the disk refuses.
    """
    if path.suffix.lower() == ".parquet":
        pa_parquet.write_table(table, path, use_dictionary=False, compression="zstd", write_page_checksum=True)
        return
    with open(path, "wb") as file:  # Arrow would put the names in quotes
        file.write(",".join(table.column_names).encode() + b"\n")
        pa_csv.write_csv(table, file, pa_csv.WriteOptions(include_header=False, quoting_style="none"))


def write_with_settings(table: pa.Table, settings: RecordingSettings, path: Path, overwrite: bool) -> Path:
    """Writes a table, and beside it the sidecar, which names the checksum of the table.

    Both are on the disk before either takes its place. A failure leaves both as they were; a process that is killed
    between the two leaves a pair that `read_recording` refuses.

    Raises:
        InputError: as `storage.write_atomically` of either.
    """
    sidecar = sidecar_path(path)
    check_writable(path, overwrite)
    check_writable(sidecar, overwrite)
    before = sidecar.read_bytes() if exists(sidecar) else None
    replaced = False

    def write(target: Path) -> None:
        nonlocal replaced
        write_table(table, target)
        key = TABLES[path.suffix.lower()]
        write_settings(settings, sidecar, overwrite, {key: table_checksum(target)})
        replaced = True

    try:
        return write_atomically(path, write, overwrite)
    except BaseException:
        if replaced:
            _restore(sidecar, before)
        raise


def _restore(sidecar: Path, before: bytes | None) -> None:
    if before is None:
        sidecar.unlink()
    else:
        write_atomically(sidecar, before, overwrite=True)
