"""Tables that grow on the disk: whole when they are closed, when the disk is full, and CSV after every piece."""

import resource
import signal
from contextlib import contextmanager

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest
from typed import refusal

from lite6jax.controller.recorder import TableWriter, check_targets


def rows(count, seed=0, columns=20):
    rng = np.random.default_rng(seed)
    return {f"c{i}": rng.standard_normal(count) for i in range(columns)} | {"run": np.arange(count)}


def read(path):
    table = pyarrow.parquet.read_table(path) if path.suffix == ".parquet" else pyarrow.csv.read_csv(path)
    return {name: table[name].to_numpy() for name in table.column_names}


@contextmanager
def room_for(size):
    """A disk on which no file may be larger."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_what_was_added_is_read_back_bit_for_bit(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    table = TableWriter(path, False, {"c0": "measured"})
    assert not path.exists()
    parts = [rows(count, seed) for seed, count in enumerate((1, 300, 2500, 7))]
    for part in parts:
        table.append(part)
    table.close()
    found = read(path)
    for name in parts[0]:
        np.testing.assert_array_equal(found[name], np.concatenate([part[name] for part in parts]))
    if suffix == "parquet":
        assert pyarrow.parquet.read_schema(path).field("c0").metadata[b"source"] == b"measured"


def test_a_parquet_recording_is_whole_after_every_piece_in_the_csv_beside_it(tmp_path):
    path, growing, unrelated = (tmp_path / f"run.{suffix}" for suffix in ("parquet", "growing.csv", "csv"))
    unrelated.write_text("mine")
    table = TableWriter(path, True, {})
    parts = [rows(10, seed) | {"gap": np.array([None, "lost; 2", *[None] * 8], object)} for seed in range(4)]
    parts[0]["c3"][:2] = np.nan, np.inf
    for count, part in enumerate(parts, 1):
        table.append(part)
        table.flush()
        assert (table.waiting, table.file, len(read(growing)["run"])) == (0, growing, 10 * count)
    table.close()
    assert (table.file, {*tmp_path.iterdir()}, unrelated.read_text()) == (path, {path, unrelated}, "mine")
    found = read(path)
    assert found["run"].dtype == int
    for name in ("c3", "gap"):
        np.testing.assert_array_equal(found[name], np.concatenate([part[name] for part in parts]))


def test_rows_that_are_damaged_before_they_are_parquet_are_kept_and_it_is_said(tmp_path):
    table = TableWriter(tmp_path / "run.parquet", False, {})
    table.append(rows(250))
    with open(table.file, "ab") as file:
        file.write(b"1,2\n")
    table.close()
    assert "the rows are in" in table.refusal
    assert [*tmp_path.iterdir()] == [table.file] == [tmp_path / "run.growing.csv"]


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("size", [200_000, 500_001, 1_200_000])
def test_a_full_disk_costs_the_rows_that_do_not_fit_and_no_others(tmp_path, suffix, size):
    path = tmp_path / f"run.{suffix}"
    table = TableWriter(path, False, {})
    parts = []
    with room_for(size):
        while not table.refusal:
            parts.append(rows(250, len(parts)))
            table.append(parts[-1])
        table.close()
    assert "large" in table.refusal
    assert 0 < table.waiting <= 250
    assert path.stat().st_size <= size
    found = read(path)
    for name in parts[0]:
        sent = np.concatenate([part[name] for part in parts])
        np.testing.assert_array_equal(found[name], sent[: len(sent) - table.waiting])


@pytest.mark.parametrize("name", ["run.csv", "run.parquet", "run.CSV"])
def test_a_csv_of_its_stem_is_of_no_concern_to_a_recording(tmp_path, name):
    out, unrelated = tmp_path / name, tmp_path / ("run.csv" if name != "run.csv" else "run.parquet")
    unrelated.write_text("mine")
    check_targets(out, False)
    growing = tmp_path / "run.growing.csv"
    growing.write_text("rows of a recording that was ended")
    check_targets(out, False, live=False)
    if name == "run.parquet":
        assert refusal(check_targets, out, False).startswith(f"{growing}: exists already")


def test_it_replaces_nothing_unasked(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("mine")
    TableWriter(path, True, {}).close()
    assert path.read_text() == "mine"
    path.unlink()
    table = TableWriter(path, False, {})
    path.write_text("mine")
    table.append(rows(3))
    table.close()
    assert (table.waiting, table.refusal, path.read_text()) == (3, "File exists", "mine")
