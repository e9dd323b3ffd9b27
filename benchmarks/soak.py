"""Ten minutes at 250 Hz, recorded in real time and as fast as it goes: what is lost, what doubled, what it costs."""

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.measure import Record, time_call
from lite6jax.arms.description import load_bundled
from lite6jax.controller.connection import Address
from lite6jax.controller.recorder import LiveRecording, record
from lite6jax.controller.station import read_station
from lite6jax.emulator import Body, Controller, draw_sines
from lite6jax.recordings import read_recording

RATE_HZ, PERIOD_US = 250, 4000
HOST, PORT = "127.0.0.99", 15099
SPEED = 200.0


def soak(seconds: float = 600.0) -> Iterator[Record]:
    """An emulated arm in a process of its own, recorded here; every row is looked at afterwards."""
    for kind, serve in (("real time", _in_real_time), ("compressed in time", _compressed)):
        with tempfile.TemporaryDirectory() as folder, serve() as address:
            out = Path(folder, "run.parquet")
            station = read_station(address, load_bundled("lite6"), "lite6")
            before = time.process_time()
            wall, done = time_call(lambda out=out, to=address, of=station: record(to, out, of, seconds=seconds))
            busy = time.process_time() - before
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10  # reading the file back takes more
            rows = round(seconds * RATE_HZ)
            yield Record("soak", kind, "rows", float(done.rows), "", wrong_rows(done, out, rows))
            yield Record("soak", kind, "reports lost", float(done.missing))
            yield Record("soak", kind, "reports doubled", float(done.repeated))
            yield Record("soak", kind, "wall time", wall, "s")
            if serve is _in_real_time:  # compressed, the emulator shares the process
                yield Record("soak", kind, "processor time a second recorded", 1e3 * busy / seconds, "ms")
            else:
                yield Record("soak", kind, "rows a second", done.rows / wall, "1/s")
            yield Record("soak", kind, "bytes a row", out.stat().st_size / max(done.rows, 1))
            yield Record("soak", kind, "peak memory of the process", peak, "MiB")


def wrong_rows(done: LiveRecording, out: Path, rows: int) -> str:
    """Why a recording is not every report once, in order, in one run; empty where it is."""
    if done.unwritten or done.runs != 1:
        return f"{done.unwritten} rows unwritten, {done.runs} runs"
    clock = np.rint(1e6 * np.asarray(read_recording(out).time)).astype(np.int64)
    if len(clock) != rows:
        return f"{len(clock)} rows, not {rows}"
    steps = np.diff(clock)
    off = int((steps != PERIOD_US).sum())
    return f"{off} steps are not {PERIOD_US} µs, from {steps.min()} to {steps.max()}" if off else ""


@contextmanager
def _in_real_time() -> Iterator[Address]:
    program = f"from lite6jax.cli import main; main(['emulate', '--address', '{HOST}', '--control-port', '{PORT}',"
    program += " '--motion', 'sines'])"
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    address = Address(HOST, PORT)
    try:
        for _ in range(300):
            time.sleep(0.2)
            try:
                read_station(address, load_bundled("lite6"), "lite6")
                break
            except ValueError:
                continue
        yield address
    finally:
        process.terminate()
        process.wait()


@contextmanager
def _compressed() -> Iterator[Address]:
    arm = load_bundled("lite6")
    path = draw_sines(arm)
    with Controller(Body(arm, arm.kinematics), path=path, address=HOST, control_port=PORT, speed=SPEED):
        yield Address(HOST, PORT)
