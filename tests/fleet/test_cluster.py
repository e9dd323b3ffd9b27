"""A Dask cluster of two workers on this machine: the same bytes as by processes, also where one of them is killed."""

import json
import os
import signal
import sys
import threading
import time

import pytest

from lite6jax import workers as layer
from lite6jax.cli import main
from lite6jax.errors import InputError
from lite6jax.workers import run_batches
from tests.batch_work import dead, reduced, spelled

dask = pytest.importorskip("dask", reason="the extra distributed is not installed")
distributed = pytest.importorskip("distributed", reason="the extra distributed is not installed")

INPUTS = [["a", "bb"], *[[f"{i}", "slow"] for i in range(8)], ["dddd", "e"]]


@pytest.fixture(scope="module")
def workers():
    """Two workers of a thread each, which are given up after a death."""
    settings = {"distributed.scheduler.allowed-failures": 0, "distributed.admin.large-graph-warning-threshold": "1GB"}
    with (
        dask.config.set(settings),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs="CRITICAL"
        ) as cluster,
    ):
        yield cluster


def ran(folder, inputs=INPUTS, **options):
    folder.mkdir(exist_ok=True)
    return run_batches(spelled, inputs, (str(folder),), out=folder / "out.parquet", died=dead, **options)


def test_a_cluster_gives_the_same_bytes_though_a_worker_is_killed(workers, tmp_path):
    whole = ran(tmp_path / "here", processes=0).read_bytes()
    assert ran(tmp_path / "there", scheduler=workers.scheduler_address).read_bytes() == whole
    first = workers.workers[0].pid
    began = threading.Event()

    def kill():
        began.wait(30)
        os.kill(first, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    run = ran(tmp_path / "killed", scheduler=workers.scheduler_address, progress=lambda done: began.set())
    killer.join()
    assert run.read_bytes() == whole
    deadline = time.monotonic() + 30
    while workers.workers[0].pid in (None, first) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert workers.workers[0].pid != first


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_input_at_which_workers_die_costs_its_row(workers, tmp_path):
    inputs = [["a", "die"], ["bb"]]
    by_processes = ran(tmp_path / "here", inputs, processes=1).read_bytes()
    assert ran(tmp_path / "there", inputs, scheduler=workers.scheduler_address).read_bytes() == by_processes


def test_the_recordings_of_a_fleet_are_diagnosed_and_pooled_to_the_same_bytes(workers, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("lite6jax.cli.diagnose.diagnose_names", reduced)
    folder = tmp_path / "recordings"
    folder.mkdir()
    for seed in range(5):
        (folder / f"arm{seed}.csv").write_text(str(seed))
    written = []
    for by in (("--processes", "1"), ("--processes", "2"), ("--scheduler", workers.scheduler_address)):
        out = tmp_path / by[0].strip("-") / by[1][:1]
        out.parent.mkdir(exist_ok=True)
        assert main(["diagnose", "--fleet", str(folder), "--out", str(out), "--json", *by]) == 0
        written.append({path.name: path.read_bytes() for path in out.iterdir()})
    assert written[0].keys() == {
        "fleet.json",
        "summary.parquet",
        *(f"arm{i}.{kind}" for i in range(5) for kind in ("json", "npz")),
    }
    assert written[0] == written[1] == written[2]
    (effect,) = json.loads(written[0]["fleet.json"])["effects"]
    low, high = effect["parameters"]["compliance_rad_per_Nm"]["interval_95"]
    assert low < 0.6 < high
    capsys.readouterr()


def test_what_a_function_raises_arrives(workers, tmp_path):
    with pytest.raises(KeyError, match="fail"):
        ran(tmp_path, [["fail"]], scheduler=workers.scheduler_address)


def test_workers_with_another_version_are_refused(workers, tmp_path, monkeypatch):
    monkeypatch.setattr("lite6jax.calibration.compiled.versions", lambda: ("another",))
    with pytest.raises(InputError, match="a worker of the cluster has another version of lite6jax, of Python or of a"):
        ran(tmp_path, [["a"]], scheduler=workers.scheduler_address)


def test_a_cluster_that_is_not_there_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(layer, "ANSWERS_WITHIN", 0.5)
    with pytest.raises(InputError, match=r"--scheduler tcp://127\.0\.0\.1:9: no scheduler answers there; start one by"):
        ran(tmp_path, scheduler="tcp://127.0.0.1:9")


def test_a_cluster_without_a_worker_is_one_line(tmp_path, monkeypatch):
    # Only the wait for workers is short: a scheduler on a busy machine answers after more than a second.
    monkeypatch.setattr(layer, "WORKERS_WITHIN", 0.2)
    with (
        distributed.LocalCluster(
            n_workers=0, dashboard_address=":0", silence_logs="CRITICAL", processes=False, protocol="tcp"
        ) as empty,
        pytest.raises(InputError, match="the cluster has no worker; start some by `dask worker tcp://"),
    ):
        ran(tmp_path, scheduler=empty.scheduler_address)


def test_without_dask_the_remedy_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"takes Dask; pip install 'lite6jax\[distributed\]', or leave it out"):
        ran(tmp_path, scheduler="tcp://127.0.0.1:8786")
