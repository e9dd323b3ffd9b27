"""Tables to files: CSV or Parquet by the suffix, and a table with its sidecar."""

from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet

from lite6jax.recordings.settings import RecordingSettings
from lite6jax.recordings.sidecar import sidecar_path, write_settings
from lite6jax.storage import check_writable, write_atomically


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
    """Writes a table, and the sidecar beside it.

    Raises:
        InputError: as `storage.write_atomically` of either.
    """
    for file in (path, sidecar_path(path)):
        check_writable(file, overwrite)
    write_atomically(path, lambda target: write_table(table, target), overwrite)
    write_settings(settings, sidecar_path(path), overwrite)
    return path
