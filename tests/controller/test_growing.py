"""Tables that grow on the disk: whole when they are closed, when the disk is full, and CSV after every piece."""

import resource
import signal
from contextlib import contextmanager

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

from lite6jax.controller.growing import growing_table
from lite6jax.errors import InputError


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
    table = growing_table(path, False, {"c0": "measured"})
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


def test_csv_is_whole_after_every_piece(tmp_path):
    path = tmp_path / "run.csv"
    table = growing_table(path, False, {})
    for count in (1, 2, 3):
        table.append(rows(10, count))
        assert len(read(path)["c0"]) == 10 * count
    table.close()


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
@pytest.mark.parametrize("size", [200_000, 500_001, 1_200_000])
def test_a_full_disk_costs_the_piece_that_does_not_fit_and_no_other(tmp_path, suffix, size):
    path = tmp_path / f"run.{suffix}"
    table = growing_table(path, False, {})
    kept = []
    with room_for(size):
        for seed in range(100):
            part = rows(250, seed)
            try:
                table.append(part)
            except OSError:
                with pytest.raises(OSError, match="large"):  # it may be tried again
                    table.append(part)
                break
            kept.append(part)
        table.close()
    assert 0 < len(kept) < 100
    assert path.stat().st_size <= size
    found = read(path)
    for name in kept[0]:
        np.testing.assert_array_equal(found[name], np.concatenate([part[name] for part in kept]))


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_after_the_disk_has_room_again_it_goes_on(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    table = growing_table(path, False, {})
    table.append(rows(250, 0))
    with room_for(50_000), pytest.raises(OSError, match="large"):
        table.append(rows(2500, 1))
    table.append(rows(2500, 1))
    table.close()
    np.testing.assert_array_equal(read(path)["c3"], np.concatenate([rows(250, 0)["c3"], rows(2500, 1)["c3"]]))


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_without_a_row_there_is_no_file(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    growing_table(path, False, {}).close()
    table = growing_table(path, False, {})
    with room_for(10), pytest.raises(OSError, match="large"):
        table.append(rows(100))
    table.close()
    assert not path.exists() or path.stat().st_size == 0


def test_it_replaces_nothing_unasked(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        growing_table(path, False, {})
    growing_table(path, True, {}).close()
    assert path.read_text() == "mine"
    path.unlink()
    table = growing_table(path, False, {})
    path.write_text("mine")
    with pytest.raises(FileExistsError):
        table.append(rows(3))
    with pytest.raises(InputError, match=r"ends in \.csv or \.parquet"):
        growing_table(tmp_path / "run.txt", False, {})
