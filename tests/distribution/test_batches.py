"""Batches: the same bytes whoever computes them, one death costs one row, and a run that was ended goes on."""

import ctypes
import subprocess
import sys
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lite6jax.distribution import batches as layer
from lite6jax.distribution.batches import Workers, outcomes, run_batches
from lite6jax.distribution.kept import Kept
from lite6jax.distribution.worker import table_of, work
from lite6jax.errors import InputError
from tests.batch_work import content, dead, freed, hoarded, resident, spelled

ROOT = Path(__file__).resolve().parents[2]
LINUX = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory of processes is read on Linux")
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
INPUTS = [["a", "bb"], ["ccc"], ["dddd", "e"], ["f"]]


def ran(folder, inputs=INPUTS, out="out.parquet", **options):
    return run_batches(spelled, inputs, (str(folder),), out=folder / out, content=content, died=dead, **options)


def done(folder):
    """The inputs that were worked on since the last call."""
    file = folder / "done"
    said = file.read_text().split("\n")[:-1] if file.exists() else []
    file.unlink(missing_ok=True)
    return said


def test_rows_are_in_the_order_of_the_inputs(tmp_path):
    advanced = []
    run = ran(tmp_path, processes=0, progress=advanced.append)
    assert (run.path, run.rows, run.kept) == (tmp_path / "out.parquet", 6, 0)
    assert pq.read_table(run.path).to_pydict() == {
        "input": ["a", "bb", "ccc", "dddd", "e", "f"],
        "length": [1, 2, 3, 4, 1, 1],
    }
    assert sum(advanced) == 6
    assert not (tmp_path / "out.parquet.kept").exists()


@POSIX
def test_processes_give_the_same_bytes_and_a_death_costs_one_row(tmp_path):
    whole = ran(tmp_path, processes=0).path.read_bytes()
    inputs = [["a", "die", "bb"], ["slow", "ccc"], *INPUTS[2:], ["die"]]
    one, two = tmp_path / "one", tmp_path / "two"
    one.mkdir(), two.mkdir()
    assert ran(one, processes=1).path.read_bytes() == whole
    assert ran(two, processes=2).path.read_bytes() == whole
    bytes_of = [
        ran(folder, inputs, "died.parquet", processes=n).path.read_bytes() for n, folder in ((1, one), (2, two))
    ]
    assert bytes_of[0] == bytes_of[1]
    rows = pq.read_table(one / "died.parquet").to_pydict()
    assert rows["input"] == ["a", "die", "bb", "slow", "ccc", "dddd", "e", "f", "die"]
    assert rows["length"] == [1, -1, 2, 4, 3, 4, 1, 1, -1]


@POSIX
def test_a_batch_whose_worker_died_for_another_reason_is_done_as_a_whole(tmp_path):
    found = dict(
        outcomes(spelled, enumerate([["a", "die once", "b"], ["c"]]), (str(tmp_path),), died=dead, processes=1)
    )
    assert found[0]["length"].to_pylist() == [1, 8, 1]
    assert done(tmp_path) == ["a", "a", "die once", "b", "c"]


@POSIX
def test_the_same_workers_do_one_function_after_the_other(tmp_path):
    with Workers(processes=2) as workers:
        found = [
            dict(workers.outcomes(hoarded, enumerate([["a"]] * 6), (1,), died=dead)),
            dict(workers.outcomes(spelled, enumerate([["a", "die once"], ["bb"]]), (str(tmp_path),), died=dead)),
            dict(workers.outcomes(hoarded, enumerate([["a"]] * 6), (1,), died=dead)),
        ]
    before, after = ({row["process"][0].as_py() for row in each.values()} for each in found[::2])
    assert [found[1][k]["length"].to_pylist() for k in (0, 1)] == [[1, 8], [2]]
    assert len(before | after) <= 3  # and not four: the one that died was replaced, the other one went on


def test_work_that_was_left_does_not_come_back(tmp_path):
    with Workers(processes=1) as workers:
        for _ in workers.outcomes(spelled, enumerate([["a"], ["slow"], ["b"]]), (str(tmp_path),), died=dead):
            break
        found = dict(workers.outcomes(hoarded, enumerate([["c"]]), (1,), died=dead))
    assert [row["input"].to_pylist() for row in found.values()] == [["c"]]


@LINUX
def test_a_worker_that_has_grown_is_renewed_and_nothing_is_lost(monkeypatch):
    bound = resident_of_a_fresh_worker() + (250 << 20)
    monkeypatch.setattr("lite6jax.distribution.processes.MOST_RESIDENT", bound)
    rows = dict(outcomes(hoarded, enumerate([[f"{i}"] for i in range(6)]), (130 << 20,), died=dead, processes=1))
    assert [rows[i]["input"].to_pylist() for i in range(6)] == [[f"{i}"] for i in range(6)]
    processes = [rows[i]["process"][0].as_py() for i in range(6)]
    assert len(set(processes)) == 3  # the second batch of each leaves it above the bound
    assert all(rows[i]["resident"][0].as_py() < bound for i in range(6))


def resident_of_a_fresh_worker():
    ((_, rows),) = outcomes(hoarded, [(0, ["a"])], (0,), died=dead, processes=1)
    return rows["resident"][0].as_py()


@LINUX
def test_freed_memory_between_what_stays_is_given_back():
    if not hasattr(ctypes.CDLL(None), "malloc_trim"):
        pytest.skip("the C library is not glibc")
    work(freed, ["a"], ())
    before = resident()
    held = table_of(work(freed, ["a"], ()))["held"][0].as_py()
    assert held - before > 5 << 20
    assert resident() - before < held - before


def test_what_a_function_raises_ends_the_run_and_what_was_done_is_kept(tmp_path):
    inputs = [["a"], ["bb"], ["fail"]]
    for processes in (0, 1):
        with pytest.raises(KeyError, match="fail"):
            ran(tmp_path, inputs, processes=processes)
        assert (tmp_path / "out.parquet.kept").exists()
    assert done(tmp_path) == ["a", "bb"]
    with pytest.raises(RuntimeError, match="Unsendable: no"):
        list(outcomes(raise_unsendable, enumerate([["a"]]), died=dead, processes=1))


def raise_unsendable(inputs):
    class Unsendable(Exception):  # noqa: N818
        pass

    raise Unsendable("no")


def test_a_run_that_was_ended_goes_on_with_the_same_bytes(tmp_path):
    whole = ran(tmp_path, processes=0).path.read_bytes()
    assert done(tmp_path) == ["a", "bb", "ccc", "dddd", "e", "f"]

    def stop(number, rows):
        if number == 2:
            raise KeyboardInterrupt
        return rows

    with pytest.raises(KeyboardInterrupt):
        ran(tmp_path, out="again.parquet", processes=0, arrived=stop)
    assert done(tmp_path) == ["a", "bb", "ccc", "dddd", "e"]
    run = ran(tmp_path, out="again.parquet", processes=0)
    assert done(tmp_path) == ["dddd", "e", "f"]  # the third had been worked on, and not kept
    assert run.kept == 3
    assert run.path.read_bytes() == whole


def test_what_was_kept_is_done_again_where_anything_differs(tmp_path, monkeypatch):
    out = tmp_path / "out.parquet"

    def fill(*asked):
        kept = Kept(out, *asked)
        key = kept.key(b"content")
        found = kept.find(key)
        kept.keep(key, b"rows" * 1000)
        kept.close()
        return found

    assert fill("asked") is None
    assert fill("asked") == b"rows" * 1000
    assert fill("else") is None
    monkeypatch.setattr("lite6jax.distribution.kept.versions", lambda: ("another",))
    assert fill("asked") is None
    monkeypatch.undo()
    file = tmp_path / "out.parquet.kept"
    file.write_bytes(file.read_bytes()[:-20])  # cut short, as by a kill
    monkeypatch.setattr("lite6jax.distribution.kept.versions", lambda: ("another",))
    assert fill("asked") is None
    assert fill("asked") == b"rows" * 1000
    whole = file.read_bytes()
    file.write_bytes(whole[:-100] + b"x" + whole[-99:])  # damaged
    assert fill("asked") is None
    assert fill("asked") == b"rows" * 1000


def test_a_file_of_that_name_that_is_not_ours_or_is_in_use_is_not_touched(tmp_path):
    file = tmp_path / "out.parquet.kept"
    file.write_text("mine")
    with pytest.raises(InputError, match=r"out\.parquet\.kept: was not kept by lite6jax; move it away, or choose"):
        Kept(tmp_path / "out.parquet")
    assert file.read_text() == "mine"
    file.unlink()
    kept = Kept(tmp_path / "out.parquet")
    kept.keep("a", b"rows")
    with pytest.raises(InputError, match="is being written by another run; wait for its end"):
        Kept(tmp_path / "out.parquet")
    kept.close(remove=True)
    assert not file.exists()


def test_row_groups_do_not_depend_on_the_batches(tmp_path, monkeypatch):
    monkeypatch.setattr(layer, "ROW_GROUP", 4)
    tables = [pa.table({"x": list(range(first, first + size))}) for first, size in ((0, 3), (3, 6), (9, 1))]
    parts = layer.write_tables(lambda: iter(tables), tmp_path / "parts.parquet")
    whole = layer.write_tables(lambda: iter([pa.table({"x": list(range(10))})]), tmp_path / "whole.parquet")
    assert parts.read_bytes() == whole.read_bytes()
    assert [pq.ParquetFile(parts).metadata.row_group(i).num_rows for i in range(3)] == [4, 4, 2]


def test_columns_that_some_batches_lack_are_null_there(tmp_path):
    tables = [pa.table({"a": [1]}), pa.table({"a": [2], "b": [0.5]})]
    path = layer.write_tables(lambda: iter(tables), tmp_path / "both.parquet")
    assert pq.read_table(path).to_pydict() == {"a": [1, 2], "b": [None, 0.5]}


KILLED = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from lite6jax.distribution.batches import run_batches
from tests.batch_work import content, dead, spelled
if __name__ == "__main__":
    folder = Path(sys.argv[2])
    inputs = [[f"{i}", "slow"] for i in range(20)]
    run_batches(spelled, inputs, (str(folder),), out=folder / "out.parquet", content=content, died=dead, processes=2)
"""


@POSIX
def test_a_run_that_was_killed_loses_a_batch_a_worker(tmp_path):
    program = tmp_path / "killed.py"
    program.write_text(KILLED)
    started = subprocess.Popen([sys.executable, program, ROOT, tmp_path], cwd=ROOT)
    kept, deadline = tmp_path / "out.parquet.kept", time.monotonic() + 60
    while (not kept.exists() or kept.read_bytes().count(b'"batch"') < 3) and time.monotonic() < deadline:
        time.sleep(0.02)
    started.kill()
    started.wait()
    count = kept.read_bytes().count(b'"batch"')
    assert 3 <= count < 20
    before = done_in_the_end(tmp_path)
    assert len(before) <= 2 * (count + 2)
    inputs = [[f"{i}", "slow"] for i in range(20)]
    run = run_batches(
        spelled, inputs, (str(tmp_path),), out=tmp_path / "out.parquet", content=content, died=dead, processes=2
    )
    assert run.kept in (2 * count, 2 * (count - 1))  # the last batch may have been cut as it was written
    assert len(done(tmp_path)) == 2 * 20 - run.kept
    assert pq.read_table(run.path)["input"].to_pylist() == [value for one in inputs for value in one]


def done_in_the_end(folder):
    """What was done when the workers have ended, which they do with the batch that they have."""
    size, file = -1, folder / "done"
    while size != (now := file.stat().st_size):
        size = now
        time.sleep(0.9)  # an input takes a third of it
    return done(folder)


def test_processes_that_cannot_start_are_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr("lite6jax.distribution.processes._serve", ends_at_once)
    with pytest.raises(InputError, match=r"the processes that are to do the work end as they start \(exit code 3\)"):
        list(outcomes(spelled, enumerate([["a"]]), (str(tmp_path),), died=dead, processes=1))


def ends_at_once(connection, imports):
    sys.exit(3)
