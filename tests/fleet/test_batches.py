"""Batches: the same bytes whoever computes them, and one death costs one row."""

import ctypes
import os
import pickle
import subprocess
import sys
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lite6jax import workers as layer
from lite6jax.errors import InputError
from lite6jax.workers import Workers, run_batches, work
from tests.batch_work import dead, ends_at_once, freed, hoarded, resident, spelled, unsendable

ROOT = Path(__file__).resolve().parents[2]
LINUX = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory of processes is read on Linux")
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
INPUTS = [["a", "bb"], ["ccc"], ["dddd", "e"], ["f"]]


def ran(folder, inputs=INPUTS, out="out.parquet", **options):
    return run_batches(spelled, inputs, (str(folder),), out=folder / out, died=dead, **options)


def outcomes(function, batches, *given, **options):
    with Workers(**options) as workers:
        return dict(workers.outcomes(function, enumerate(batches), given, died=dead))


def done(folder):
    """The inputs that were worked on since the last call."""
    file = folder / "done"
    said = file.read_text().split("\n")[:-1] if file.exists() else []
    file.unlink(missing_ok=True)
    return said


def test_rows_are_in_the_order_of_the_inputs(tmp_path):
    advanced = []
    path = ran(tmp_path, processes=0, progress=advanced.append)
    assert path == tmp_path / "out.parquet"
    assert pq.read_table(path).to_pydict() == {
        "input": ["a", "bb", "ccc", "dddd", "e", "f"],
        "length": [1, 2, 3, 4, 1, 1],
    }
    assert sum(advanced) == 6


@POSIX
def test_processes_give_the_same_bytes_and_a_death_costs_one_row(tmp_path):
    whole = ran(tmp_path, processes=0).read_bytes()
    inputs = [["a", "die", "bb"], ["slow", "ccc"], *INPUTS[2:], ["die"]]
    one, two = tmp_path / "one", tmp_path / "two"
    one.mkdir(), two.mkdir()
    assert ran(one, processes=1).read_bytes() == whole
    assert ran(two, processes=2).read_bytes() == whole
    bytes_of = [ran(folder, inputs, "died.parquet", processes=n).read_bytes() for n, folder in ((1, one), (2, two))]
    assert bytes_of[0] == bytes_of[1]
    rows = pq.read_table(one / "died.parquet").to_pydict()
    assert rows["input"] == ["a", "die", "bb", "slow", "ccc", "dddd", "e", "f", "die"]
    assert rows["length"] == [1, -1, 2, 4, 3, 4, 1, 1, -1]


@POSIX
def test_a_batch_whose_worker_died_for_another_reason_is_done_as_a_whole(tmp_path):
    found = outcomes(spelled, [["a", "die once", "b"], ["c"]], str(tmp_path), processes=1)
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
    monkeypatch.setattr("lite6jax.workers.MOST_RESIDENT", bound)
    rows = outcomes(hoarded, [[f"{i}"] for i in range(6)], 130 << 20, processes=1)
    assert [rows[i]["input"].to_pylist() for i in range(6)] == [[f"{i}"] for i in range(6)]
    processes = [rows[i]["process"][0].as_py() for i in range(6)]
    assert len(set(processes)) == 3  # the second batch of each leaves it above the bound
    assert all(rows[i]["resident"][0].as_py() < bound for i in range(6))


def resident_of_a_fresh_worker():
    return outcomes(hoarded, [["a"]], 0, processes=1)[0]["resident"][0].as_py()


@LINUX
def test_freed_memory_between_what_stays_is_given_back():
    if not hasattr(ctypes.CDLL(None), "malloc_trim"):
        pytest.skip("the C library is not glibc")
    job = pickle.dumps((freed, ()))
    work(job, ["a"])
    before = resident()
    rows, after = work(job, ["a"])
    held = rows["held"][0].as_py()
    assert held - before > 5 << 20
    assert after - before < held - before


def test_what_a_function_raises_ends_the_run_and_writes_nothing(tmp_path):
    for processes in (0, 1):
        with pytest.raises(KeyError, match="fail"):
            ran(tmp_path, [["a"], ["bb"], ["fail"]], processes=processes)
    assert not (tmp_path / "out.parquet").exists()
    with pytest.raises(RuntimeError, match="Unsendable: no"):
        outcomes(unsendable, [["a"]], processes=1)


def test_row_groups_do_not_depend_on_the_batches(tmp_path, monkeypatch):
    monkeypatch.setattr(layer, "ROW_GROUP", 4)
    tables = [pa.table({"x": list(range(first, first + size))}) for first, size in ((0, 3), (3, 6), (9, 1))]
    parts = layer.write_tables(tables, tmp_path / "parts.parquet")
    whole = layer.write_tables([pa.table({"x": list(range(10))})], tmp_path / "whole.parquet")
    assert parts.read_bytes() == whole.read_bytes()
    assert [pq.ParquetFile(parts).metadata.row_group(i).num_rows for i in range(3)] == [4, 4, 2]


def test_columns_that_some_batches_lack_are_null_there(tmp_path):
    tables = [pa.table({"a": [1]}), pa.table({"a": [2], "b": [0.5]})]
    path = layer.write_tables(tables, tmp_path / "both.parquet")
    assert pq.read_table(path).to_pydict() == {"a": [1, 2], "b": [None, 0.5]}


SLOW = [[f"{i}", "slow"] for i in range(20)]
KILLED = """
import sys
from pathlib import Path
from tests.fleet.test_batches import SLOW, ran
ran(Path(sys.argv[1]), SLOW, processes=2)
"""


@POSIX
def test_a_run_that_was_killed_leaves_no_process_and_no_temporary_folder(tmp_path):
    home = tmp_path / "temporary"
    home.mkdir()
    environment = os.environ | {"TMPDIR": str(home)}
    started = subprocess.Popen([sys.executable, "-c", KILLED, tmp_path], cwd=ROOT, env=environment)
    deadline = time.monotonic() + 60
    while not (tmp_path / "done").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    started.kill()
    started.wait()
    while any(home.iterdir()) and time.monotonic() < deadline:  # workers end with the program
        time.sleep(0.02)
    assert not any(home.iterdir())
    worked_on = done(tmp_path)
    time.sleep(0.7)  # of a batch
    assert len(done(tmp_path)) == 0
    assert 0 < len(worked_on) < 40
    assert not (tmp_path / "out.parquet").exists()


def test_processes_that_cannot_start_are_one_line(monkeypatch, tmp_path):
    monkeypatch.setattr("lite6jax.workers._begin", ends_at_once)
    with pytest.raises(InputError, match="the processes that are to do the work end as they start; free memory, or"):
        outcomes(spelled, [["a"]], str(tmp_path), processes=1)
