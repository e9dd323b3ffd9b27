"""The run of many trials: sealed first, diagnosed in processes of their own, opened last, kept as they come."""

import contextlib
import hashlib
import io
import json
import math
import multiprocessing
import os
import queue
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import FrameType
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.concealed.scores import Row, scored
from benchmarks.concealed.trials import draw, sealed_text, write_trial

LONGEST = 600
"""s: a trial that takes longer has failed."""
_SAVED_EVERY = 10.0
_MOST_MAPPINGS = 40_000
_BATCH = 100
"""Trials that a process does; compiled code stays in its memory."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_TEXT, _NUMBER, _FLAG = pa.string(), pa.float64(), pa.bool_()


def _fields(kinds: dict[str, pa.DataType]) -> list[pa.Field]:
    """Of a kind each, the names separated by spaces."""
    return [pa.field(name, kind) for names, kind in kinds.items() for name in names.split()]


_ESTIMATE = pa.struct(_fields({"name": _TEXT, "true off std bound": _NUMBER}))
_HIDDEN = pa.struct(
    _fields(
        {
            "effect site": _TEXT,
            "size seen moved_m": _NUMBER,
            "rival rival_site": _TEXT,
            "apart": _NUMBER,
            "site_found named in_set": _FLAG,
            "numbers": pa.list_(_ESTIMATE),
        }
    )
)
_FINDING = pa.struct(
    _fields(
        {
            "effect site driver": _TEXT,
            "p_value gain order source_joint": _NUMBER,
            "true": _FLAG,
            "rivals": pa.list_(_TEXT),
        }
    )
)
SCHEMA = pa.schema(
    _fields(
        {
            "seed index rows": pa.int64(),
            "kind engine arm sensor geometry noise fault sha256 error verdict edge statement why": _TEXT,
            "moving mounted detected exact exact_in_set top_site top_named top_in_set fault_found": _FLAG,
            "masses_off sealed found": _FLAG,
            "seconds planned_size before_m after_m noise_m estimated_noise_m": _NUMBER,
            "nearest_effect nearest_site": _TEXT,
            "nearest_p moved_m unseen_m unseen_rad unseen_missing oracle_m oracle_rad": _NUMBER,
            "inside_components inside_covered outside_components outside_covered": _NUMBER,
            "faults": pa.list_(_TEXT),
            "hidden": pa.list_(_HIDDEN),
            "findings": pa.list_(_FINDING),
        }
    )
)
"""Of the results: a row a trial."""


class WorkerDiedError(RuntimeError):
    """The process that worked on a trial came to its end, twice."""


def seal(seed: int, index: int, folder: Path, sealed_families: bool = False) -> str:
    """Draws a trial, writes what the diagnosis is given, puts the truth aside, and gives only its SHA-256."""
    trial = draw(seed, index, sealed_families)
    write_trial(trial, given_in(folder, index))
    text = sealed_text(trial).encode()
    sealed = sealed_in(folder, index)
    sealed.parent.mkdir(parents=True, exist_ok=True)
    sealed.write_bytes(text)
    return hashlib.sha256(text).hexdigest()


def given_in(folder: Path, index: int) -> Path:
    """Where the files of a trial are that the diagnosis is given."""
    return folder / "given" / f"{index:05d}"


def sealed_in(folder: Path, index: int) -> Path:
    """Where the truth of a trial is."""
    return folder / "sealed" / f"{index:05d}.json"


def opened(folder: Path, index: int, digest: str) -> Row:
    """The truth of a trial, if it is the one that was sealed.

    Raises:
        ValueError: it is not.
    """
    text = sealed_in(folder, index).read_bytes()
    if hashlib.sha256(text).hexdigest() != digest:
        raise ValueError(f"{sealed_in(folder, index)}: is not what was sealed")
    return json.loads(text)


def judge(folder: Path, index: int, digest: str) -> Row:
    """Diagnoses a trial by the library's own commands, predicts the unseen motion, then opens the truth and scores."""
    given = given_in(folder, index)
    start = time.perf_counter()
    error = ""
    try:
        with _limit(LONGEST), contextlib.redirect_stdout(io.StringIO()):
            _commands(given)
    except ImportError:  # a library that is not whole is no trial's failure
        raise
    except Exception as problem:
        error = f"{type(problem).__name__}: {problem}"[:300]
    seconds = time.perf_counter() - start
    diagnosis, predicted = given / "diagnosis.json", given / "predicted.csv"
    said = json.loads(diagnosis.read_text()) if diagnosis.exists() else None
    shown = _columns(predicted) if predicted.exists() else None
    row = scored(opened(folder, index, digest), said, shown, seconds, error) | {"sha256": digest}
    _forget_compiled()
    return row


def _commands(given: Path) -> None:
    from lite6jax.cli.diagnose import Diagnose, Predict
    from lite6jax.fitting.compiled import keep_compiled_code

    keep_compiled_code()
    diagnosis = given / "diagnosis.json"
    Diagnose(given / "recording.csv", out=diagnosis, force=True).run()
    Predict(diagnosis, given / "unseen.csv", out=given / "predicted.csv", force=True).run()


def _columns(path: Path) -> dict[str, list[float]]:
    names, *rows = path.read_text().splitlines()
    values = [[float(cell) if cell else math.nan for cell in row.split(",")] for row in rows]
    return dict(zip(names.split(","), map(list, zip(*values, strict=True)), strict=True))


@contextlib.contextmanager
def _limit(seconds: int) -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"took longer than {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _forget_compiled() -> None:
    """Every compiled function holds mappings of memory, of which a process may have so many."""
    try:
        mappings = Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return
    if mappings > _MOST_MAPPINGS:
        import jax

        jax.clear_caches()


def run(
    seed: int,
    wanted: Sequence[int],
    out: Path,
    processes: int,
    say: Callable[[str], object],
    advance: Callable[[str, int, int], object],
    sealed_families: bool = False,
) -> list[Row]:
    """The rows of all wanted trials; those that the file already has are not run again.

    Beside the file of results comes a folder with what the diagnosis is given and, apart from it, the sealed truths;
    and their hashes, in the form of `sha256sum`, before the first diagnosis begins.

    Args:
        seed: of the campaign.
        wanted: indices of trials.
        out: the Parquet file.
        processes: that work at a time.
        say: called with a sentence on what happens.
        advance: called with the kind of work, how much of it is done, and how much there is.
        sealed_families: what is outside the catalogue is of the sealed families, and of no other.

    Raises:
        KeyboardInterrupt: after what is done has been kept.
        ValueError: the file has trials of another seed, or of families that are sealed where these are not.
    """
    folder = out.with_suffix(".trials")
    rows = {row["index"]: row for row in read_rows(out)} if out.exists() else {}
    if any(row["seed"] != seed for row in rows.values()):
        raise ValueError(f"{out}: has trials of another seed; give that, or another file")
    if any(row["kind"] == "outside" and bool(row["sealed"]) != sealed_families for row in rows.values()):
        raise ValueError(f"{out}: has trials of {'open' if sealed_families else 'sealed'} families; give another file")
    left = [index for index in wanted if index not in rows]
    try:
        digests = _sealed(seed, left, folder, out, processes, say, advance, sealed_families)
        for index, row in worked(judge, [(folder, i, digests[i]) for i in left], left, processes):
            if isinstance(row, WorkerDiedError):
                row = scored(opened(folder, index, digests[index]), None, None, 0.0, str(row))
                row["sha256"] = digests[index]
            elif isinstance(row, Exception):
                raise row
            rows[index] = row
            shutil.rmtree(given_in(folder, index), ignore_errors=True)
            _keep(rows, out)
            advance("diagnosed", sum(i in rows for i in wanted), len(wanted))
    finally:
        if rows:
            write_rows(list(rows.values()), out)
    return [rows[index] for index in wanted]


def _sealed(
    seed: int,
    left: Sequence[int],
    folder: Path,
    out: Path,
    processes: int,
    say: Callable[[str], object],
    advance: Callable[[str, int, int], object],
    sealed_families: bool,
) -> dict[int, str]:
    """The hashes of the truths, drawn where they are not yet."""
    listed = out.with_suffix(".sha256")
    digests = _listed(listed)
    todo = [i for i in left if i not in digests or not (given_in(folder, i) / "unseen.csv").exists()]
    drawn = [(seed, i, folder, sealed_families) for i in todo]
    for done, (index, digest) in enumerate(worked(seal, drawn, todo, processes), 1):
        if isinstance(digest, Exception):
            raise digest
        if digests.get(index, digest) != digest:
            raise ValueError(f"{listed}: trial {index} was sealed as another; the generator has changed")
        digests[index] = digest
        advance("sealed", done, len(todo))
    lines = [f"{digests[i]}  {sealed_in(Path(folder.name), i).as_posix()}\n" for i in sorted(digests)]
    out.parent.mkdir(parents=True, exist_ok=True)
    listed.write_text("".join(lines))
    whole = hashlib.sha256("".join(lines).encode()).hexdigest()
    say(f"{len(digests)} truths sealed; their hashes are in {listed}, whose own SHA-256 is {whole}.")
    return digests


def _listed(path: Path) -> dict[int, str]:
    if not path.exists():
        return {}
    pairs = (line.split("  ") for line in path.read_text().splitlines())
    return {int(Path(name).stem): digest for digest, name in pairs}


_last_kept = 0.0


def _keep(rows: dict[int, Row], out: Path) -> None:
    global _last_kept
    if time.monotonic() - _last_kept > _SAVED_EVERY:
        write_rows(list(rows.values()), out)
        _last_kept = time.monotonic()


def write_rows(rows: Sequence[Row], path: Path) -> None:
    """The rows by index, in one step: a reader never sees half a file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.part")
    pq.write_table(pa.Table.from_pylist(sorted(rows, key=lambda row: row["index"]), SCHEMA), part)
    part.replace(path)


def read_rows(path: Path) -> list[Row]:
    """The rows of a file of results."""
    return pq.read_table(path, schema=SCHEMA).to_pylist()


def worked(
    work: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], names: Sequence[int], processes: int
) -> Iterator[tuple[int, Any]]:
    """Name and result as they come. A process that dies takes the trials of that moment along: they are tried again."""
    waiting = dict(zip(names, arguments, strict=True))
    suspects: list[int] = []
    while waiting:
        # each of those that may have killed a process has one of its own
        batch = [suspects.pop()] if suspects else list(waiting)[: _BATCH * processes]
        # one thread each: two libraries' threads on the same cores only wait for each other
        before = {name: os.environ.get(name) for name in _THREADS}
        os.environ.update((name, "1") for name in _THREADS)
        context = multiprocessing.get_context("spawn")
        cores = context.Queue()
        for core in sorted(os.sched_getaffinity(0))[:processes] if processes > 1 else ():
            cores.put(core)
        pool = ProcessPoolExecutor(processes, context, _settle, (cores,))
        try:
            futures: dict[Future[Any], int] = {pool.submit(work, *waiting[name]): name for name in batch}
            for future in as_completed(futures):
                name = futures[future]
                try:
                    result = future.result()
                except BrokenProcessPool:
                    break
                except Exception as problem:
                    result = problem
                del waiting[name]
                yield name, result
            left = [name for name in batch if name in waiting]
            if left and len(batch) == 1:
                del waiting[left[0]]
                yield left[0], WorkerDiedError("the process died")
            elif left:
                suspects = left[:processes]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value


def _settle(cores: Any) -> None:
    """A worker leaves Ctrl-C to its parent, and keeps to a core of its own where there are others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(queue.Empty):
        os.sched_setaffinity(0, {cores.get(timeout=0.2)})
