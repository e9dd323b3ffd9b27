"""The number of threads that everything in a process computes with."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from lite6jax import threads

ROOT = Path(__file__).resolve().parents[1]
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
