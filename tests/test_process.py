"""A process: what a signal leaves of it, and the number of threads that everything in it computes with."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from lite6jax import threads

ROOT = Path(__file__).resolve().parents[1]
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


def process(program, *arguments, **options):
    """A program of Python that has printed its first line."""
    command = [sys.executable, "-c", program, *map(str, arguments)]
    started = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)
    assert started.stdout is not None
    assert started.stdout.readline() == "ready\n"
    return started


SWALLOWS = """
import signal, sys, time
from pathlib import Path
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # `nohup` has this run, and not its terminal, ignore it
from lite6jax import interruption
interruption.end_on_signals()
from lite6jax.storage import temporary_folder, write_atomically
def write(half):
    half.write_text("half")
    print("ready", flush=True)
    while True:
        try:
            time.sleep(60)
        except BaseException:
            pass
with temporary_folder() as folder, interruption.undone(lambda: Path(sys.argv[1], "undone").touch()):
    write_atomically(Path(sys.argv[1], "run.csv"), write)
"""


@POSIX
@pytest.mark.parametrize(
    ("number", "code", "says"),
    [
        (signal.SIGINT, 130, "interrupted: nothing is left half-written\n"),
        (signal.SIGTERM, 143, "ended by SIGTERM: nothing is left half-written\n"),
        (signal.SIGHUP, 129, "ended by SIGHUP: nothing is left half-written\n"),
    ],
)
def test_a_signal_ends_what_catches_every_exception_and_cleans_up(tmp_path, number, code, says):
    started = process(SWALLOWS, tmp_path, env=os.environ | {"TMPDIR": str(tmp_path)})
    assert len(list(tmp_path.iterdir())) == 2
    started.send_signal(number)
    try:
        out, err = started.communicate(timeout=30)
    finally:
        started.kill()  # what outlives its signal would go on for ever
        started.wait()
    assert (started.returncode, out, err) == (code, "", says)
    assert list(tmp_path.iterdir()) == [tmp_path / "undone"]


def test_the_program_has_its_signals_before_it_imports_what_takes_time():
    program = (
        "import sys; from lite6jax import interruption;"
        "interruption.end_on_signals = lambda: print(*sorted({'jax', 'numpy', 'tyro', 'yaml'} & set(sys.modules)));"
        "from lite6jax.cli import main; sys.argv = ['lite6jax', '--version']; main()"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("\nlite6jax ")


# ------------------------------------------------------------------ threads


LIMITED = """
import json, os
from lite6jax import threads
before = threads.available()
threads.limit(1)
import jax.numpy as jnp
from threadpoolctl import threadpool_info
jnp.ones((300, 300)) @ jnp.ones((300, 300))
names = [open(f"/proc/self/task/{task}/comm").read().strip() for task in os.listdir("/proc/self/task")]
print(json.dumps([before, threads.available(), [pool["num_threads"] for pool in threadpool_info()], names]))
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="threads are counted in /proc")
def test_a_limit_holds_for_blas_and_for_xla():
    environment = {name: value for name, value in os.environ.items() if "NUM_THREADS" not in name}
    done = subprocess.run(
        [sys.executable, "-c", LIMITED], cwd=ROOT, capture_output=True, text=True, check=True, env=environment
    )
    before, after, pools, names = json.loads(done.stdout)
    assert before == len(os.sched_getaffinity(0))
    assert after == 1
    assert set(pools) == {1}
    assert sum("Eigen" in name for name in names) <= 1, names


@pytest.mark.parametrize("cores", [1, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 40])
def test_parts_come_back_in_their_order_and_the_first_is_done_alone(monkeypatch, cores, count):
    monkeypatch.setattr(threads, "available", lambda: cores)
    begun, done = [], []

    def work(part: int) -> int:
        begun.append((part, len(done)))
        done.append(part)
        return part**2

    assert threads.by_parts(work, range(count)) == [part**2 for part in range(count)]
    assert sorted(done) == list(range(count))
    assert all(before > 0 for part, before in begun if part > 0), "a part began before the first was done"
