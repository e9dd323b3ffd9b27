"""The recordings of a folder diagnosed: a document for each and a row a recording; and pooled over many arms."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from lite6jax import storage
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError
from lite6jax.fleet.place import DIED, StorageFolder, list_recordings
from lite6jax.workers import Workers, run_batches

with import_lazily():  # where a recording is diagnosed, or all are pooled
    from lite6jax.diagnosis import document as diagnosis_file
    from lite6jax.domains import registry
    from lite6jax.estimation import options as engine_options
    from lite6jax.fleet import pooling, population, reduced, terms

TABLE = "summary.parquet"
POOLED = "fleet.json"
"""In the folder of results."""
DIAGNOSED = "diagnosed"
UNREADABLE = "unreadable"

_FINDING = pa.struct(
    [("domain", pa.string()), ("effect", pa.string()), ("site", pa.string()), ("p_value", pa.float64())]
)
SCHEMA = pa.schema(
    {
        "file": pa.string(),
        "result": pa.string(),
        "message": pa.string(),
        "document": pa.string(),
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
REDUCED = pa.schema({"reduced": pa.string()})
"""What the table of a fleet has besides: the file of each reduced recording."""
_CONTENT = {"document": "document_content", "reduced": "reduced_content"}
"""The columns of what these files hold, on its way from where it was made."""
_FEWEST = 2
"""Recordings that are pooled at least."""


def diagnose_folder(
    folder: str | Path,
    out: Path,
    diagnose: Callable[..., pa.Table],
    arguments: tuple[Any, ...],
    *,
    scheduler: str | None = None,
    processes: int | None = None,
    progress: Callable[[int, int], object] = lambda done, total: None,
    overwrite: bool = False,
) -> Path:
    """Diagnoses every recording of a folder, a path or a URL, one by one.

    The documents and the table are written to `out`, a folder that is made where it is not there. `diagnose(names,
    place, *arguments)`, of a module, gives a row of `make_row` or `make_refusal` each. `progress` is called with the
    number of recordings done since the last call, and of all; the other arguments are those of `run_batches`.

    Raises:
        InputError: as `StorageFolder.of`, `list_recordings` and `run_batches`; `out` is no folder, or that of the
            recordings.
    """
    place = StorageFolder.of(folder)
    names = list_recordings(place)
    table = _make_folder(out, place) / TABLE
    storage.check_writable(table, overwrite)
    # a document has the stem of its recording, or the whole name where another has the same stem
    stems = [Path(name).stem for name in names]
    documents = {
        name: f"{stem if stems.count(stem) == 1 else name}.json" for name, stem in zip(names, stems, strict=True)
    }
    for name in documents.values():
        storage.check_writable(out / name, overwrite)

    def write_files(inputs: Sequence[str], rows: pa.Table) -> pa.Table:
        """Writes the files of a row, and names them in it."""
        (row,) = rows.to_pylist()
        for column, suffix in (("document", ".json"), ("reduced", ".npz")):
            if (content := row.get(_CONTENT[column])) is not None:
                path = (out / documents[inputs[0]]).with_suffix(suffix)
                storage.write_atomically(path, content, overwrite=True)
                row[column] = path.name
        schema = pa.schema([*SCHEMA, *REDUCED]) if _CONTENT["reduced"] in row else SCHEMA
        return pa.Table.from_pylist([row], schema)

    return run_batches(
        diagnose,
        [[name] for name in names],
        (place, *arguments),
        out=table,
        died=lambda name: make_refusal(name, f"{name}: {DIED}"),
        store=write_files,
        scheduler=scheduler,
        processes=processes,
        progress=lambda done: progress(done, len(names)),
        overwrite=overwrite,
    )


def make_row(
    name: str, document: Mapping[str, Any], text: str, reduced: bytes | None = None, message: str = ""
) -> pa.Table:
    """The row of a recording of this name in its folder: of its `document`, the `text` of that file, of a fleet the
    file of the `reduced` recording, and what was remarked on the way."""
    row: dict[str, Any] = {"file": name, "result": DIAGNOSED, "message": message, "samples": document.get("samples")}
    faults = []
    findings = []
    for domain in registry.DOMAINS.values():
        part = diagnosis_file.find_part(document, domain.name)
        if part is None:
            continue
        words = domain.words
        row[words.verdict_column] = part["verdict"]
        if "quality" in part:
            row["quality"] = part["quality"]["verdict"]
        if words.error_column:
            errors = {when: part[when].get(f"heldout_{words.error_column}") for when in ("before", "after")}
            row |= {f"{when}_{words.error_column}": error for when, error in errors.items()}
        faults += [fault["fault"] for fault in part["data_faults"]]
        findings += [
            {"domain": domain.name, "effect": finding["effect"], "site": finding["site"], "p_value": finding["p_value"]}
            for finding in part["findings"]
        ]
    row |= {"data_faults": list(dict.fromkeys(faults)), "findings": findings}
    contents = {"document": text.encode()} | ({} if reduced is None else {"reduced": reduced})
    return _table(row, contents)


def make_refusal(name: str, message: str) -> pa.Table:
    """The row of a recording that was not diagnosed, and why."""
    return _table({"file": name, "result": UNREADABLE, "message": message}, {"document": None})


def _table(row: Mapping[str, Any], contents: Mapping[str, bytes | None]) -> pa.Table:
    table = pa.Table.from_pylist([row], SCHEMA)
    for column, content in contents.items():
        table = table.append_column(_CONTENT[column], pa.array([content], pa.binary()))
    return table


def _make_folder(out: Path, place: StorageFolder) -> Path:
    if not place.remote and out.exists() and out.samefile(place.root):
        raise InputError(f"{out}: is the folder of the recordings; write to another")
    try:
        out.mkdir(exist_ok=True)
    except FileExistsError as error:
        raise InputError(f"{out}: is not a folder; name one to write the diagnoses to") from error
    except OSError as error:
        raise InputError(f"{out}: cannot be made ({error.strerror}); choose another folder") from error
    return out


# ------------------------------------------------------------------ pooled


def pool_folder(
    folder: str,
    out: Path,
    thresholds: "engine_options.EngineOptions",
    scheduler: str | None = None,
    processes: int | None = None,
    progress: Callable[[int], object] = lambda effects: None,
) -> "population.Population":
    """Pools the recordings of many arms of one type that were diagnosed into `out`.

    `folder` is what messages name; `progress` is called with the number of effects at each round of the search, and
    `scheduler` and `processes` are as of `run_batches`.

    Raises:
        InputError: too few of the recordings can be pooled, or as `read_heading`.
    """
    import pyarrow.parquet as pq

    rows = pq.read_table(out / TABLE).to_pylist()
    places = {row["file"]: out / row["reduced"] for row in rows if row.get("reduced")}
    headings = {file: reduced.read_heading(path) for file, path in places.items()}
    if not headings:
        reason = next((row["message"] for row in rows if row["message"]), "no reason is known")
        raise InputError(f"{folder}: none of its recordings could be diagnosed: {reason}")
    kinds = [_kind(heading) for heading in headings.values()]
    arm = max(kinds, key=kinds.count)
    members = []
    for row in rows:
        heading = headings.get(row["file"])
        if heading is None or row["result"] != DIAGNOSED:
            about = {}
            findings = ()
            unused = row["message"] or "was not diagnosed"
        else:
            about = heading.about
            findings = heading.found
            unused = _reason_unused(heading, arm)
        members.append(population.Member(row["file"], about, findings, unused))
    files = [member.file for member in members if not member.unused]
    if len(files) < _FEWEST:
        reason = next((f" ({member.unused})" for member in members if member.unused), "")
        raise InputError(
            f"{folder}: {len(files)} recording can be pooled, and --fleet takes {_FEWEST} or more{reason}; add "
            "recordings of this type of arm"
        )
    candidate_terms = terms.Tried([headings[file] for file in files], thresholds)
    with Workers(scheduler, processes, len(files)) as workers:
        recordings = pooling.Reduced([places[file] for file in files], thresholds, workers)
        return population.diagnose_population(arm[0], members, candidate_terms, recordings, progress)


def check_pooled(out: Path, names: Sequence[str], overwrite: bool) -> None:
    """Refuses a recording whose document would have the name of the fleet's, and a file that is there."""
    for name in names:
        if f"{Path(name).stem}.json" == POOLED:
            raise InputError(f"{name}: its diagnosis would be named {POOLED}, as the fleet's; rename the recording")
    if out.is_dir():
        storage.check_writable(out / POOLED, overwrite)


def _kind(heading: "reduced.Heading") -> tuple[str, int, str]:
    """The kind of recordings that are pooled: the arm, its number of joints, and what is measured."""
    return heading.about["arm"], heading.about["joints"], heading.about["what"]


def _reason_unused(heading: "reduced.Heading", arm: tuple[str, int, str]) -> str:
    """Why a recording that was diagnosed is not pooled; empty where it is."""
    about = heading.about
    if _kind(heading)[:2] != arm[:2]:
        return f"is of the arm {about['arm']} with {about['joints']} joints, and most are of {arm[0]} with {arm[1]}"
    if _kind(heading) != arm:
        return f"has {about['what']}, and most have {arm[2]}; give --torques where all have torques"
    return ""
