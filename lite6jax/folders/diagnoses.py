"""The diagnoses of a folder's recordings: a document for each, and a table with a row a recording."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from lite6jax import storage
from lite6jax.distribution.batches import Run, run_batches
from lite6jax.errors import InputError
from lite6jax.folders.listing import recording_names
from lite6jax.folders.place import Place

TABLE = "summary.parquet"
"""In the folder of results."""
DIAGNOSED, UNREADABLE = "diagnosed", "unreadable"

_FINDING = pa.struct(
    [("domain", pa.string()), ("effect", pa.string()), ("site", pa.string()), ("p_value", pa.float64())]
)
SCHEMA = pa.schema(
    {
        "file": pa.string(),
        "result": pa.string(),
        "message": pa.string(),
        "document": pa.string(),
        "document_sha256": pa.string(),
        "samples": pa.int64(),
        "verdict": pa.string(),
        "quality": pa.string(),
        "before_position_rms_m": pa.float64(),
        "after_position_rms_m": pa.float64(),
        "torque_verdict": pa.string(),
        "before_torque_rms_Nm": pa.float64(),
        "after_torque_rms_Nm": pa.float64(),
        "data_faults": pa.list_(pa.string()),
        "findings": pa.list_(_FINDING),
    }
)
"""A row a recording; errors are of rows that were held out, and what a diagnosis does not have is null."""
REDUCED = pa.schema({"reduced": pa.string(), "reduced_sha256": pa.string()})
"""What the table of a fleet has besides: the file of each reduced recording."""
_TEXT, _REDUCED = "text", "reduced_bytes"
"""The columns of the document itself, and of the reduced recording, on their way from where they were made."""


def diagnose_folder(
    folder: str | Path,
    out: Path,
    diagnose: Callable[..., pa.Table],
    given: tuple[Any, ...],
    *,
    also_read: bytes = b"",
    scheduler: str | None = None,
    processes: int | None = None,
    progress: Callable[[int, int], object] = lambda done, total: None,
    overwrite: bool = False,
) -> Run:
    """Diagnoses every recording of a folder, one by one.

    Args:
        folder: a path, or a URL.
        out: a folder for the documents and the table, made where it is not there.
        diagnose: of a module: `diagnose(names, place, *given)` gives a row of `row_of` or `refusal` each.
        given: to it.
        also_read: the checksums of files that all diagnoses depend on.
        scheduler, processes: as `run_batches`.
        progress: called with the number of recordings done since the last call, and of all.
        overwrite: whether a table and documents that are there may be replaced.

    Raises:
        InputError: as `Place.of`, `recording_names` and `run_batches`; `out` is no folder, or that of the
            recordings.
    """
    place = Place.of(folder)
    names = recording_names(place)
    table = _folder_for(out, place) / TABLE
    storage.check_writable(table, overwrite)
    documents = dict(zip(names, _document_names(names), strict=True))
    goes_on = table.with_name(f"{TABLE}.kept").exists()
    if not (overwrite or goes_on):
        for name in documents.values():
            storage.check_writable(out / name)

    def arrived(number: int, rows: pa.Table) -> pa.Table:
        (row,), document = rows.to_pylist(), documents[names[number]]
        schema = SCHEMA
        if _REDUCED in row:
            schema = pa.schema([*SCHEMA, *REDUCED])
            row |= written("reduced", Path(document).with_suffix(".npz").name, row[_REDUCED])
        if row[_TEXT] is not None:
            row |= written("document", document, row[_TEXT].encode())
        return pa.Table.from_pylist([row], schema)

    def written(what: str, name: str, content: bytes) -> dict[str, str]:
        storage.write_atomically(out / name, content, overwrite=True)
        return {what: name, f"{what}_sha256": hashlib.sha256(content).hexdigest()}

    def intact(rows: pa.Table) -> bool:
        (row,) = rows.to_pylist()
        for place in ("document", "reduced"):
            if row.get(place) is None:
                continue
            try:
                if hashlib.sha256((out / row[place]).read_bytes()).hexdigest() != row[f"{place}_sha256"]:
                    return False
            except OSError:
                return False
        return True

    return run_batches(
        diagnose,
        [[name] for name in names],
        (place, *given),
        out=table,
        content=lambda inputs: place.content(inputs) + also_read,
        died=lambda name: refusal(
            name, f"{name}: the process that read it was ended; the file is damaged or too large for this machine"
        ),
        arrived=arrived,
        intact=intact,
        scheduler=scheduler,
        processes=processes,
        progress=lambda done: progress(done, len(names)),
        overwrite=overwrite,
    )


def row_of(name: str, document: Mapping[str, Any], text: str, message: str = "") -> pa.Table:
    """The row of a recording and its document.

    Args:
        name: of the recording in its folder.
        document: as `diagnose` writes it.
        text: of its file.
        message: what was remarked on the way.
    """
    of_torques = document.get("domain") == "torque"
    poses = None if of_torques else document
    torques = document if of_torques else document.get("torques")
    row: dict[str, Any] = {"file": name, "result": DIAGNOSED, "message": message, "samples": document.get("samples")}
    faults, findings = [], []
    for domain, part in (("poses", poses), ("torques", torques)):
        if part is None:
            continue
        faults += [fault["fault"] for fault in part["data_faults"]]
        findings += [
            {"domain": domain, "effect": found["effect"], "site": found["site"], "p_value": found["p_value"]}
            for found in part["findings"]
        ]
    if poses is not None:
        row |= {"verdict": poses["verdict"], "quality": poses["quality"]["verdict"]}
        row |= {f"{when}_position_rms_m": poses[when].get("heldout_position_rms_m") for when in ("before", "after")}
    if torques is not None:
        row["torque_verdict"] = torques["verdict"]
        row |= {f"{when}_torque_rms_Nm": torques[when].get("heldout_torque_rms_Nm") for when in ("before", "after")}
    return _table(row | {"data_faults": list(dict.fromkeys(faults)), "findings": findings}, text)


def refusal(name: str, message: str) -> pa.Table:
    """The row of a recording that was not diagnosed, and why."""
    return _table({"file": name, "result": UNREADABLE, "message": message}, None)


def with_reduced(row: pa.Table, reduced: bytes) -> pa.Table:
    """A row with the bytes of the file of its reduced recording."""
    return row.append_column(_REDUCED, pa.array([reduced], pa.binary()))


def _table(row: Mapping[str, Any], text: str | None) -> pa.Table:
    table = pa.Table.from_pylist([row], SCHEMA)
    return table.append_column(_TEXT, pa.array([text], pa.string()))


def _folder_for(out: Path, place: Place) -> Path:
    if not place.remote and out.exists() and out.samefile(place.root):
        raise InputError(f"{out}: is the folder of the recordings; write to another")
    try:
        out.mkdir(exist_ok=True)
    except FileExistsError as error:
        raise InputError(f"{out}: is not a folder; name one to write the diagnoses to") from error
    except OSError as error:
        raise InputError(f"{out}: cannot be made ({error.strerror}); choose another folder") from error
    return out


def _document_names(names: Sequence[str]) -> list[str]:
    """By the stem of the recording, or by its whole name where another has the same stem."""
    stems = [Path(name).stem for name in names]
    return [f"{stem if stems.count(stem) == 1 else name}.json" for name, stem in zip(names, stems, strict=True)]
