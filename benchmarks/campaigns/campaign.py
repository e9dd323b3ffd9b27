"""The run of many trials: sealed first, diagnosed by workers, opened last, kept as they come."""

import contextlib
import hashlib
import io
import json
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.campaigns.judgement import Goal, Row
from benchmarks.campaigns.rounds import Rounds, read_columns
from lite6jax.workers import Workers, write_tables

LONGEST = 600  # s: a trial that takes longer has failed

TEXT, NUMBER, FLAG = pa.string(), pa.float64(), pa.bool_()
Section = tuple[str, Sequence[str], Sequence[Sequence[str]]]  # title, head and rows of a table


def fields(kinds: dict[str, pa.DataType]) -> list[pa.Field]:
    """Of a kind each, the names separated by spaces."""
    return [pa.field(name, kind) for names, kind in kinds.items() for name in names.split()]


def schema_of(moved: str, kinds: dict[str, pa.DataType]) -> pa.Schema:
    """Of the results, a row a trial.

    Args:
        moved: the column of what a hidden effect moves.
        kinds: columns of the domain.
    """
    estimate = pa.struct(fields({"name": TEXT, "true off std bound": NUMBER}))
    hidden = {
        "effect site rival rival_site": TEXT,
        f"size seen apart {moved}": NUMBER,
        "site_found named in_set": FLAG,
        "numbers": pa.list_(estimate),
    }
    finding = {
        "effect site driver": TEXT,
        "p_value gain order source_joint": NUMBER,
        "true": FLAG,
        "rivals": pa.list_(TEXT),
    }
    common = {
        "seed index rows": pa.int64(),
        "kind engine arm noise fault sha256 error verdict edge": TEXT,
        "sealed detected found exact exact_in_set top_site top_named top_in_set fault_found": FLAG,
        "seconds planned_size": NUMBER,
        "faults": pa.list_(TEXT),
        "hidden": pa.list_(pa.struct(fields(hidden))),
        "findings": pa.list_(pa.struct(fields(finding))),
    }
    return pa.schema(fields(common | kinds))


def diagnose_and_predict(given: Path) -> None:
    """As the command line does, in the folder of a trial's files: the diagnosis, and what it predicts of `unseen`."""
    from lite6jax.calibration.compiled import keep_compiled_code
    from lite6jax.cli.diagnose import DiagnoseCommand, PredictCommand

    keep_compiled_code()
    diagnosis = given / "diagnosis.json"
    DiagnoseCommand(given / "recording.csv", out=diagnosis, force=True).run()
    PredictCommand(diagnosis, given / "unseen.csv", out=given / "predicted.csv", force=True).run()


@dataclass(frozen=True)
class Campaign:
    """A kind of trials; its functions stand in modules, so that other processes find them."""

    name: str  # of its command
    count: int  # how many trials, if not said
    known: float  # thresholds from which the intervals of an effect's numbers are to hold
    rounds: Rounds  # in which its kinds come
    schema: pa.Schema  # of the results, a row a trial; as `schema_of`
    # a trial (`files` by name and `truth`), of a seed, an index, and whether what is outside is of the sealed families
    draw: Callable[[int, int, bool], Any]
    # the row of a truth, the diagnosis, the columns predicted, the seconds that both took, and their error
    score: Callable[[Row, Row | None, Row | None, float, str], Row]
    # those on rows, and on the intervals of effects that are `known` thresholds large
    set_goals: Callable[[Sequence[Row], float], list[Goal]]
    unseen: Callable[[Sequence[Row]], Section]  # a table on the errors of the unseen motion
    measuring: Sequence[str] = ()  # the sensors that its rows may name; empty where they name none
    noise_names: Sequence[str] = ()  # the noises that its rows may name; empty where they may name any
    # diagnoses the files of a folder and writes what comes of it there
    answer: Callable[[Path], None] = diagnose_and_predict
    # campaigns of other sensors, among which `--sensor` chooses
    sensors: Mapping[str, "Campaign"] = field(default_factory=dict)
    # campaigns of other noise, among which `--noise` chooses
    noises: Mapping[str, "Campaign"] = field(default_factory=dict)

    def goals(self, rows: Sequence[Row]) -> list[Goal]:
        """The goals on rows, and whether they are met."""
        return self.set_goals(rows, self.known)

    def run(
        self,
        seed: int,
        wanted: Sequence[int],
        out: Path,
        processes: int | None,
        say: Callable[[str], object],
        advance: Callable[[str, int, int], object],
        sealed_families: bool = False,
        scheduler: str | None = None,
    ) -> list[Row]:
        """The rows of all wanted trials; those that the file already has are not run again.

        Beside the file of results comes a folder with what the diagnosis is given and, apart from it, the sealed
        truths; and their hashes, in the form of `sha256sum`, before the first diagnosis begins. Workers are given files
        and answer with files: they never see a truth.

        Args:
            seed: of the campaign.
            wanted: indices of trials.
            out: the Parquet file.
            processes: that work at a time; one a core for None, and this one alone for 0.
            say: called with a sentence on what happens.
            advance: called with the kind of work, how much of it is done, and how much there is.
            sealed_families: what is outside the catalogue is of the sealed families, and of no other.
            scheduler: the address of the scheduler of a Dask cluster, in place of processes.

        Raises:
            ValueError: the file has trials of another campaign, seed, sensor or noise, or of families that are sealed
                where these are not.
        """
        # poses and torques differ in what a hidden effect moves
        there, ours = (
            {field.name for field in schema.field("hidden").type.value_type}
            for schema in (pq.read_schema(out) if out.exists() else self.schema, self.schema)
        )
        if not there <= ours:
            raise ValueError(f"{out}: has trials of another campaign than {self.name}; give another file")
        rows = {row["index"]: row for row in self.read_rows(out)} if out.exists() else {}
        if any(row["seed"] != seed for row in rows.values()):
            raise ValueError(f"{out}: has trials of another seed; give that, or another file")
        if others := sorted({str(row.get("sensor")) for row in rows.values()} - set(self.measuring or ("None",))):
            raise ValueError(f"{out}: has trials of another sensor ({', '.join(others)}); give that, or another file")
        noises_there = sorted({row["noise"] for row in rows.values()} - set(self.noise_names))
        if self.noise_names and noises_there:
            raise ValueError(
                f"{out}: has trials of another noise ({', '.join(noises_there)}); give that, or another file"
            )
        if any(row["kind"] == "outside" and bool(row["sealed"]) != sealed_families for row in rows.values()):
            kept = "open" if sealed_families else "sealed"
            raise ValueError(f"{out}: has trials of {kept} families; give another file")
        left = [index for index in wanted if index not in rows]
        if left:
            workers, folder = partial(Workers, scheduler, processes), out.with_suffix(".trials")
            digests = _seal(left, (self.draw, seed, sealed_families), out, workers, advance)
            listed = out.with_suffix(".sha256")
            whole = hashlib.sha256(listed.read_bytes()).hexdigest()
            say(f"{len(digests)} truths sealed; their hashes are in {listed}, whose own SHA-256 is {whole}.")
            done = len(wanted) - len(left)
            if done:
                advance("diagnosed", done, len(wanted))
            batches = ((index, [_read_files(given_in(folder, index))]) for index in left)
            with workers(len(left)) as at_work:
                died: Any = lambda given: ({}, 0.0, "WorkerDiedError: the process died")  # noqa: E731
                work: Any = at_work.outcomes(answer_trial, batches, (self.answer,), died=died)
                for count, (index, (files, seconds, error)) in enumerate(work, done + 1):
                    diagnosis = json.loads(files.get("diagnosis.json", "null"))
                    predicted = read_columns(files["predicted.csv"]) if "predicted.csv" in files else None
                    truth = open_truth(folder, index, digests[index])
                    row = self.score(truth, diagnosis, predicted, seconds, error)
                    rows[index] = row | {"sha256": digests[index]}
                    self.write_rows(list(rows.values()), out)  # a run that is ended has those that are done
                    advance("diagnosed", count, len(wanted))
            for index in left:
                shutil.rmtree(given_in(folder, index), ignore_errors=True)
        return [rows[index] for index in wanted]

    def write_rows(self, rows: Sequence[Row], path: Path) -> None:
        """The rows by index, in one step: a reader never sees half a file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        table = pa.Table.from_pylist(sorted(rows, key=lambda row: row["index"]), self.schema)
        write_tables([table], path, overwrite=True)

    def read_rows(self, path: Path) -> list[Row]:
        """The rows of a file of results."""
        return pq.read_table(path, schema=self.schema).to_pylist()


def _seal(
    left: Sequence[int],
    given: tuple[Any, ...],
    out: Path,
    workers: Callable[[int], Workers],
    advance: Callable[[str, int, int], object],
) -> dict[int, str]:
    """The hashes of the truths, drawn where they are not yet; what is `given` to each draw fixes them."""
    listed, folder = out.with_suffix(".sha256"), out.with_suffix(".trials")
    pairs = (line.split("  ") for line in (listed.read_text().splitlines() if listed.exists() else ()))
    digests = {int(Path(name).stem): digest for digest, name in pairs}
    todo = [i for i in left if i not in digests or not (given_in(folder, i) / "unseen.csv").exists()]
    with workers(len(todo)) as at_work:
        work: Any = at_work.outcomes(draw_trial, ((index, [index]) for index in todo), given, died=_not_drawn)
        for done, (index, (files, truth)) in enumerate(work, 1):
            write_files(files, given_in(folder, index))
            write_files({sealed_in(folder, index).name: truth}, sealed_in(folder, index).parent)
            digest = hashlib.sha256(truth.encode()).hexdigest()
            if digests.setdefault(index, digest) != digest:
                raise ValueError(f"{listed}: trial {index} was sealed as another; the generator has changed")
            advance("sealed", done, len(todo))
    lines = [f"{digests[i]}  {sealed_in(Path(folder.name), i).as_posix()}\n" for i in sorted(digests)]
    out.parent.mkdir(parents=True, exist_ok=True)
    listed.write_text("".join(lines))
    return digests


def given_in(folder: Path, index: int) -> Path:
    """Where the files of a trial are that the diagnosis is given."""
    return folder / "given" / f"{index:05d}"


def sealed_in(folder: Path, index: int) -> Path:
    """Where the truth of a trial is."""
    return folder / "sealed" / f"{index:05d}.json"


def open_truth(folder: Path, index: int, digest: str) -> Row:
    """The truth of a trial, if it is the one that was sealed.

    Raises:
        ValueError: it is not.
    """
    text = sealed_in(folder, index).read_bytes()
    if hashlib.sha256(text).hexdigest() != digest:
        raise ValueError(f"{sealed_in(folder, index)}: is not what was sealed")
    return json.loads(text)


def write_files(files: Mapping[str, str], folder: Path) -> None:
    """The files of a trial, all under names that say nothing."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)


def _read_files(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in sorted(folder.iterdir()) if path.is_file()}


def truth_text(truth: Row) -> str:
    """A truth as it is sealed."""
    return json.dumps(truth, indent=1, allow_nan=False, default=float) + "\n"


# ------------------------------------------------------------------ what a worker does with one trial


def draw_trial(indices: Sequence[int], draw: Callable[..., Any], seed: int, sealed_families: bool) -> Any:
    """The files and the truth of a trial."""
    (index,) = indices
    trial = draw(seed, index, sealed_families)
    return trial.files, truth_text(trial.truth)


def answer_trial(given: Sequence[Mapping[str, str]], answer: Callable[[Path], None]) -> Any:
    """What the diagnosis of a trial leaves: files by name, the seconds that it took, an error or an empty text."""
    (files,) = given
    with tempfile.TemporaryDirectory() as name:
        folder, error = Path(name), ""
        write_files(files, folder)
        start = time.perf_counter()
        try:
            with _limit(LONGEST), contextlib.redirect_stdout(io.StringIO()):
                answer(folder)
        except ImportError:  # a library that is not whole is no trial's failure
            raise
        except Exception as problem:
            error = f"{type(problem).__name__}: {problem}"[:300]
        seconds = time.perf_counter() - start
        written = {file: text for file, text in _read_files(folder).items() if file not in files}
        return written, seconds, error


def _not_drawn(index: int) -> Any:
    raise RuntimeError(f"trial {index}: the process that draws it was ended")


@contextlib.contextmanager
def _limit(seconds: int) -> Iterator[None]:
    """Ends what takes longer; in the main thread only, where alone there are signals."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TimeoutError(f"took longer than {seconds} s")

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
