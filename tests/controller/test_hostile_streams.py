"""Report streams of controllers that misbehave: no received row is lost, and every loss stands in the table."""

import threading
from typing import NamedTuple

import numpy as np
import pyarrow.parquet
import pytest
from live import ARM, serving
from test_rows import STEP, reports

from lite6jax.controller import connection, protocol, recorder
from lite6jax.controller.recorder import record
from lite6jax.controller.station import Station


class Hostile(NamedTuple):
    """What a controller sends: the bytes of each connection, in pieces, and what is to come of it.

    Attributes:
        connections: of each, the pieces.
        received: whole reports, of which each is to be a row or a duplicate.
        missing: reports missing within runs.
        runs: that the recording has.
        refusal: the begin of the reason why it ended; empty where it did not end by itself.
    """

    connections: list[list[bytes]]
    received: int
    missing: int = 0
    runs: int = 1
    refusal: str = ""


def whole(clock, **options):
    return b"".join(reports(np.asarray(clock, np.uint64), **options))


def spoiled(clock, field, value):
    made = np.frombuffer(whole(clock), protocol.report_layout(protocol.REALTIME)).copy()
    made[field][len(made) // 2] = value
    return made.tobytes()


def pieces(data, size):
    return [data[first : first + size] for first in range(0, len(data), size)]


K = np.arange(40)
PLAIN = whole(STEP * K)
STREAMS = {
    "whole": Hostile([[PLAIN]], 40),
    "single bytes": Hostile([pieces(PLAIN, 1)], 40),
    "pieces a byte short of a report": Hostile([pieces(PLAIN, 783)], 40),
    "every tenth lost": Hostile([[whole(STEP * K[K % 10 != 5])]], 36, missing=4),
    "half lost": Hostile([[whole(2 * STEP * K)]], 40, missing=39),
    "a second lost": Hostile([[whole(STEP * np.where(K < 20, K, K + 250))]], 40, missing=250),
    "each twice": Hostile([[whole(STEP * np.repeat(K, 2))]], 80),
    "one again and again": Hostile([[whole(STEP * np.sort([*K, *[7] * 60]))]], 100),
    "cut within a report": Hostile([[PLAIN[: 20 * 784 + 5]], [whole(STEP * (K + 30))]], 60, runs=2),
    "sent again after a reconnection": Hostile([[PLAIN], [whole(STEP * (K + 39))]], 80, runs=2),
    "garbage after reports": Hostile([[PLAIN, b"\xff" * 1000], [whole(STEP * (K + 60))]], 80, runs=2),
    "a length of zero": Hostile([[PLAIN, bytes(2000)], [whole(STEP * (K + 60))]], 80, runs=2),
    "a length of a gigabyte": Hostile([[PLAIN, b"\x40\0\0\0" + PLAIN], [whole(STEP * (K + 60))]], 80, runs=2),
    "a report of 32 bytes": Hostile([[PLAIN, b"\0\0\0\x20" + bytes(28)], [whole(STEP * (K + 60))]], 80, runs=2),
    "shorter reports": Hostile([[whole(STEP * K[:20], length=640), whole(STEP * K[20:])]], 40),
    "a clock that is set back": Hostile([[whole(STEP * np.where(K < 20, K + 1000, K))]], 40, runs=2),
    "a clock that is set back a step": Hostile([[whole(STEP * np.where(K < 20, K, K - 2))]], 40, runs=2),
    "a clock that jumps": Hostile([[whole(np.where(K < 20, 0, 10**9) + STEP * K)]], 40, runs=2),
    "a clock that jumps by an age": Hostile([[whole(np.where(K < 20, 0, 10**18) + STEP * K)]], 40, runs=2),
    "a clock that stops": Hostile(
        [[whole(STEP * np.minimum(np.arange(200), 30))]], 200, refusal="port 30000: the cont"
    ),
    "joints that are not finite": Hostile([[spoiled(STEP * K, "joint_position", np.nan)]], 40),
    "poses beyond all numbers": Hostile([[spoiled(STEP * K, "pose", 3e38)]], 40),
}


@pytest.mark.parametrize("name", STREAMS)
def test_no_row_is_lost_and_every_loss_is_counted(tmp_path, monkeypatch, name):
    hostile, sent, stop = STREAMS[name], [], threading.Event()
    monkeypatch.setattr(connection, "RETRY_S", 0.02)
    monkeypatch.setattr(recorder, "GATHER_S", 0.01)

    def answer(line):
        if len(sent) == len(hostile.connections):
            stop.wait(10)
            return
        sent.append(1)
        for piece in hostile.connections[len(sent) - 1]:
            line.sendall(piece)
        if len(sent) == len(hostile.connections):
            stop.wait(10)

    def show(rows, trouble):
        if rows.count and len(sent) == len(hostile.connections) and quiet[0] == rows.count:
            stop.set()
        quiet[0] = rows.count

    quiet = [0]
    out = tmp_path / "run.parquet"
    with serving(answer, protocol.REALTIME) as address:
        done = record(address, out, Station(ARM, "lite6", None, None, ()), stop=stop, show=show)
    table = pyarrow.parquet.read_table(out).to_pydict()
    assert done.rows + done.repeated == hostile.received
    assert done.rows == len(table["time_s"])
    assert (done.runs, done.missing_within) == (hostile.runs, hostile.missing)
    assert done.refusal[:20] == hostile.refusal
    # by the times alone: each gap has its row, its number and its reason
    steps = np.rint(1e6 * np.diff(table["time_s"])).astype(int)
    assert (steps > 0).all()
    np.testing.assert_array_equal(table["missing"][1:], np.maximum(np.rint(steps / STEP), 1) - 1)
    starts = np.diff(table["run"]) > 0
    lacking = np.array(table["missing"][1:]) > 0
    assert [reason is not None for reason in table["gap"]] == [False, *(starts | lacking)]
    assert sum(table["missing"]) == done.missing == done.missing_within + done.missing_between
