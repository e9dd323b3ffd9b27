"""The recordings of many arms of one type, or of one arm over time: each diagnosed, and then pooled."""

from collections.abc import Callable, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lite6jax import storage
from lite6jax.distribution.batches import Workers
from lite6jax.errors import InputError
from lite6jax.folders.diagnoses import DIAGNOSED, TABLE
from lite6jax.populations.candidate import Candidate
from lite6jax.populations.evidence import Reduced
from lite6jax.populations.files import Heading, read_heading
from lite6jax.populations.functions import in_common
from lite6jax.populations.options import PoolingOptions
from lite6jax.populations.population import Member, Population, diagnose_population

DOCUMENT = "fleet.json"
"""In the folder of results."""
_FEWEST, _FEWEST_DATES = 2, 4
"""Recordings that are pooled at least; of a slope, so that its interval is finite and arms can vary about it."""


def diagnose_recorded_population(
    folder: str,
    out: Path,
    options: PoolingOptions,
    over: Literal["date"] | None = None,
    scheduler: str | None = None,
    processes: int | None = None,
    progress: Callable[[int], object] = lambda effects: None,
) -> Population:
    """Pools the recordings of a folder that were diagnosed into `out`.

    Args:
        folder: of the recordings, as it was given: what messages name.
        out: the folder of results, with the table and the reduced recordings.
        options: thresholds.
        over: "date" where the recordings are of one arm, whose effects may drift with the dates of their sidecars.
        scheduler, processes: as `distribution.batches.run_batches`.
        progress: called with the number of effects at each round of the search.

    Raises:
        InputError: too few of the recordings can be pooled, or have different dates; or as `read_heading`.
    """
    import pyarrow.parquet as pq

    rows = pq.read_table(out / TABLE).to_pylist()
    headings = {row["file"]: read_heading(out / row["reduced"]) for row in rows if row.get("reduced")}
    if not headings:
        raise InputError(f"{folder}: none of its recordings could be diagnosed: {_first_reason(rows)}")
    kinds = [_kind(heading) for heading in headings.values()]
    arm = max(kinds, key=kinds.count)
    members = [_member(row, headings.get(row["file"]), arm, over) for row in rows]
    used = [i for i, member in enumerate(members) if not member.unused]
    if len(used) < _FEWEST:
        reasons = next((member.unused for member in members if member.unused), "")
        raise InputError(
            f"{folder}: {len(used)} recording can be pooled, and --fleet takes {_FEWEST} or more"
            f"{f' ({reasons})' if reasons else ''}; add recordings of this type of arm"
        )
    dates = None
    if over is not None:
        dates = np.array([float(date.fromisoformat(members[i].about["date"]).toordinal()) for i in used])
        if len(set(dates)) < _FEWEST_DATES:
            raise InputError(
                f"{folder}: its recordings have {len(set(dates))} different dates, and --over date takes "
                f"{_FEWEST_DATES} or more; write `date: YYYY-MM-DD` into their sidecars"
            )
    candidates: dict[str, Candidate] = {}
    for i in used:
        heading = headings[members[i].file]
        for candidate in (*heading.candidates, *heading.families):
            candidates.setdefault(candidate.key, candidate)
    places = {row["file"]: out / row["reduced"] for row in rows if row.get("reduced")}
    functions = in_common(function for i in used for function in headings[members[i].file].functions)
    with Workers(scheduler, processes, len(used)) as workers:
        reduced = Reduced([places[members[i].file] for i in used], options, workers, functions)
        return diagnose_population(arm[0], members, used, candidates, reduced, dates, progress)


def check_document(out: Path, names: Sequence[str], overwrite: bool) -> None:
    """Refuses a recording whose document would have the name of the fleet's, and a file that is there.

    Raises:
        InputError: as said.
    """
    for name in names:
        if f"{Path(name).stem}.json" == DOCUMENT:
            raise InputError(f"{name}: its diagnosis would be named {DOCUMENT}, as the fleet's; rename the recording")
    if out.is_dir():
        storage.check_writable(out / DOCUMENT, overwrite)


def _member(row: Mapping[str, Any], heading: Heading | None, arm: tuple[str, int, str], over: str | None) -> Member:
    """The recording of a row, with the reason where it is not pooled."""
    if heading is None or row["result"] != DIAGNOSED:
        return Member(row["file"], {}, (), row["message"] or "was not diagnosed")
    unused, own = "", heading.about["arm"]
    if _kind(heading)[:2] != arm[:2]:
        unused = f"is of the arm {own} with {heading.about['joints']} joints, and most are of {arm[0]} with {arm[1]}"
    elif _kind(heading) != arm:
        unused = f"has {heading.about['what']}, and most have {arm[2]}; give --torques where all have torques"
    elif over is not None and heading.about["date"] is None:
        unused = "has no date; write `date: YYYY-MM-DD` into its sidecar"
    return Member(row["file"], heading.about, heading.found, unused)


def _kind(heading: Heading) -> tuple[str, int, str]:
    """Of which recordings are pooled: the arm, its number of joints, and what is measured."""
    return heading.about["arm"], heading.about["joints"], heading.about["what"]


def _first_reason(rows: list[dict[str, Any]]) -> str:
    return next((row["message"] for row in rows if row["message"]), "no reason is known")
