"""The soak benchmark's own honesty: a right recording passes, and one that lost or doubled a row does not."""

from dataclasses import replace

import numpy as np
from live import ARM, emulated

from benchmarks import soak
from lite6jax.controller.recorder import record
from lite6jax.controller.station import read_station
from lite6jax.recordings import read_recording, write_recording


def test_a_lost_and_a_doubled_row_are_wrong(tmp_path):
    out = tmp_path / "run.parquet"
    with emulated(speed=20.0) as (_, address):
        done = record(address, out, read_station(address, ARM, "lite6"), seconds=1.0)
    assert soak.wrong_rows(done, out, 250) == ""
    assert soak.wrong_rows(done, out, 251) == "250 rows, not 251"
    assert "runs" in soak.wrong_rows(replace(done, runs=2), out, 250)
    assert "3 rows unwritten" in soak.wrong_rows(replace(done, unwritten=3), out, 250)
    read = read_recording(out)
    for rows, says in (
        (np.delete(np.arange(250), 7), "from 4000 to 8000"),
        (np.sort([*range(250), 7]), "from 0 to 4000"),
    ):
        write_recording(read.select(rows), out, overwrite=True)
        assert says in soak.wrong_rows(done, out, len(rows))
