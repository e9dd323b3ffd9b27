"""The run of many trials: sealed first, diagnosed in processes of their own, opened last, kept as they come."""

import contextlib
import hashlib
import io
import json
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from benchmarks.campaigns.workers import WorkerDiedError, worked

Row = dict[str, Any]

LONGEST = 600
"""s: a trial that takes longer has failed."""
_SAVED_EVERY = 10.0
_MOST_MAPPINGS = 40_000

TEXT, NUMBER, FLAG = pa.string(), pa.float64(), pa.bool_()


def fields(kinds: dict[str, pa.DataType]) -> list[pa.Field]:
    """Of a kind each, the names separated by spaces."""
    return [pa.field(name, kind) for names, kind in kinds.items() for name in names.split()]


class Drawn(NamedTuple):
    """A trial as it is written.

    Attributes:
        files: name to text, all that the diagnosis is given.
        truth: the sealed file's text, byte for byte the same whenever it is drawn.
    """

    files: dict[str, str]
    truth: str


@dataclass(frozen=True)
class Campaign:
    """What a kind of trials is made of; its functions stand in modules, so that other processes find them.

    Attributes:
        schema: of the results, a row a trial; `seed`, `index`, `kind`, `sealed` and `sha256` are among its columns.
        draw: a trial, of a seed, an index, and whether what is outside is of the sealed families.
        answer: diagnoses the files of a folder and writes what comes of it there.
        score: the row of a truth, of what `answer` left in a folder, of the seconds that it took and of its error.
    """

    schema: pa.Schema
    draw: Callable[[int, int, bool], Drawn]
    answer: Callable[[Path], None]
    score: Callable[[Row, Path, float, str], Row]

    def seal(self, seed: int, index: int, folder: Path, sealed_families: bool = False) -> str:
        """Draws a trial, writes what the diagnosis is given, puts the truth aside, and gives only its SHA-256."""
        files, truth = self.draw(seed, index, sealed_families)
        write_files(files, given_in(folder, index))
        sealed = sealed_in(folder, index)
        sealed.parent.mkdir(parents=True, exist_ok=True)
        sealed.write_bytes(truth.encode())
        return hashlib.sha256(truth.encode()).hexdigest()

    def judge(self, folder: Path, index: int, digest: str) -> Row:
        """Diagnoses a trial, predicts the unseen motion, then opens the truth and scores."""
        given = given_in(folder, index)
        start = time.perf_counter()
        error = ""
        try:
            with _limit(LONGEST), contextlib.redirect_stdout(io.StringIO()):
                self.answer(given)
        except ImportError:  # a library that is not whole is no trial's failure
            raise
        except Exception as problem:
            error = f"{type(problem).__name__}: {problem}"[:300]
        seconds = time.perf_counter() - start
        row = self.score(opened(folder, index, digest), given, seconds, error) | {"sha256": digest}
        _forget_compiled()
        return row

    def run(
        self,
        seed: int,
        wanted: Sequence[int],
        out: Path,
        processes: int,
        say: Callable[[str], object],
        advance: Callable[[str, int, int], object],
        sealed_families: bool = False,
    ) -> list[Row]:
        """The rows of all wanted trials; those that the file already has are not run again.

        Beside the file of results comes a folder with what the diagnosis is given and, apart from it, the sealed
        truths; and their hashes, in the form of `sha256sum`, before the first diagnosis begins.

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
        rows = {row["index"]: row for row in self.read_rows(out)} if out.exists() else {}
        if any(row["seed"] != seed for row in rows.values()):
            raise ValueError(f"{out}: has trials of another seed; give that, or another file")
        if any(row["kind"] == "outside" and bool(row["sealed"]) != sealed_families for row in rows.values()):
            raise ValueError(
                f"{out}: has trials of {'open' if sealed_families else 'sealed'} families; give another file"
            )
        left = [index for index in wanted if index not in rows]
        kept = time.monotonic()
        try:
            digests = self._sealed(seed, left, folder, out, processes, say, advance, sealed_families)
            for index, row in worked(self.judge, [(folder, i, digests[i]) for i in left], left, processes):
                if isinstance(row, WorkerDiedError):
                    truth, empty = opened(folder, index, digests[index]), folder / "died"
                    row = self.score(truth, empty, 0.0, str(row)) | {"sha256": digests[index]}
                elif isinstance(row, Exception):
                    raise row
                rows[index] = row
                shutil.rmtree(given_in(folder, index), ignore_errors=True)
                if time.monotonic() - kept > _SAVED_EVERY:
                    self.write_rows(list(rows.values()), out)
                    kept = time.monotonic()
                advance("diagnosed", sum(i in rows for i in wanted), len(wanted))
        finally:
            if rows:
                self.write_rows(list(rows.values()), out)
        return [rows[index] for index in wanted]

    def _sealed(
        self,
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
        for done, (index, digest) in enumerate(worked(self.seal, drawn, todo, processes), 1):
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

    def write_rows(self, rows: Sequence[Row], path: Path) -> None:
        """The rows by index, in one step: a reader never sees half a file."""
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f".{path.name}.part")
        pq.write_table(pa.Table.from_pylist(sorted(rows, key=lambda row: row["index"]), self.schema), part)
        part.replace(path)

    def read_rows(self, path: Path) -> list[Row]:
        """The rows of a file of results."""
        return pq.read_table(path, schema=self.schema).to_pylist()


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


def write_files(files: dict[str, str], folder: Path) -> None:
    """The files of a trial, all under names that say nothing."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)


def sealed_text(truth: Row) -> str:
    """A truth as it is sealed."""
    return json.dumps(truth, indent=1, allow_nan=False, default=float) + "\n"


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


def _listed(path: Path) -> dict[int, str]:
    if not path.exists():
        return {}
    pairs = (line.split("  ") for line in path.read_text().splitlines())
    return {int(Path(name).stem): digest for digest, name in pairs}
