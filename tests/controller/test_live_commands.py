"""The commands for a live arm as they are typed: what they print, write and refuse, and what ends them."""

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.ipc
import pyarrow.parquet
import pytest
import yaml
from live import ARM, KINEMATICS, emulated, new_host, snapshot
from typed import flat, refused, run

from lite6jax.arms.factory import read_factory
from lite6jax.controller import station
from lite6jax.emulator import Faults, draw_sines
from lite6jax.recordings import read_recording

ROOT = Path(__file__).resolve().parents[2]


# ------------------------------------------------------------------ read


def test_read_prints_what_it_read_and_writes_a_file_that_fits(capsys, tmp_path):
    out = tmp_path / "arm.yaml"
    with emulated() as (controller, address):
        code, said, err = run(capsys, "read", "--ip", address, "--out", out)
        assert snapshot(controller).requests == {8: 1}
    assert (code, err) == (0, "")
    assert f"{address}: factory calibration of 6 joints, of a lite6." in said
    assert "mm from the nominal one on average" in flat(said)
    assert f"Wrote {out}" in said
    np.testing.assert_array_equal(read_factory(out).kinematics, KINEMATICS)
    assert list(yaml.safe_load(out.read_text())["kinematics"]) == [f"joint{i}" for i in range(1, 7)]
    assert run(capsys, "fit", out)[0] == 0


def test_read_refuses_before_it_calls(capsys, tmp_path):
    out = tmp_path / "arm.yaml"
    out.write_text("mine")
    nobody = new_host()
    assert "exists already" in refused(capsys, "read", "--ip", nobody, "--out", out)
    assert out.read_text() == "mine"
    assert "let the name end in .yaml" in refused(capsys, "read", "--ip", nobody, "--out", tmp_path / "arm.json")
    assert "does not exist" in refused(capsys, "read", "--ip", nobody, "--out", tmp_path / "no" / "arm.yaml")
    assert "--timeout 0" in refused(capsys, "read", "--ip", nobody, "--timeout", 0)
    assert "is not an IPv4 address" in refused(capsys, "read", "--ip", "arm.local")
    assert "nothing listens there" in refused(capsys, "read", "--ip", f"{nobody}:1")
    assert run(capsys, "read")[0] == 2


# ------------------------------------------------------------------ fit --ip


def test_fit_reads_fits_and_verifies(capsys, tmp_path):
    with emulated(faults=Faults(warning=11)) as (controller, address):
        code, said, err = run(
            capsys, "fit", "--ip", address, "--fk-samples", 300, "--out", tmp_path / "model.json",
            "--figures", tmp_path / "figures",
        )  # fmt: skip
        assert set(snapshot(controller).requests) == {1, 8, 44}
    assert (code, err) == (0, "")
    said = flat(said)
    assert "Converged" in said
    assert "at 300 random joint positions" in said
    assert "Passed: they agree within 0.001 mm; rounding to 32 bits alone causes up to 0.00012 mm." in said
    assert "Tool offset: none in the controller's report; which agrees" in said
    assert "warning 11, which is not cleared" in said
    row = re.search(r"joints as sent \(32 bits\) mm ([\d.e-]+) ([\d.e-]+) ([\d.e-]+) ([\d.e-]+)", said)
    assert row is not None
    assert float(row[4]) <= 1.2e-4
    names = {path.name for path in (tmp_path / "figures").iterdir()}
    stem = str(address).replace(":", "_")
    kinds = ("error_by_joint", "controller")
    assert names == {f"{stem}_{kind}.{suffix}" for kind in kinds for suffix in ("png", "svg")}


def test_a_controller_of_the_nominal_chain_does_not_pass(capsys):
    with emulated(faults=Faults(nominal_kinematics=True)) as (_, address):
        code, said, _ = run(capsys, "fit", "--ip", address, "--fk-samples", 40)
    assert code == 1
    assert "computes with the nominal chain lite6, not with its stored calibration" in flat(said)


def test_a_controller_of_an_unknown_chain_does_not_pass_and_is_sent_to_diagnose(capsys, monkeypatch):
    read = station.read_calibration

    def micrometres_off(*args):
        found = read(*args)
        rows = found.calibration.kinematics.copy()
        rows[3, 1] += 5e-6
        return found._replace(calibration=replace(found.calibration, kinematics=rows))

    monkeypatch.setattr(station, "read_calibration", micrometres_off)
    with emulated() as (_, address):
        code, said, _ = run(capsys, "fit", "--ip", address, "--fk-samples", 40)
    assert code == 1
    assert "Not passed: they differ by up to" in flat(said)
    assert "The six-parameter chain does not explain" in flat(said)
    assert f"  lite6jax record --ip {address} --poses poses.csv --out fk.csv\n" in said
    assert "  lite6jax diagnose fk.csv --out diagnosis.json\n" in said


def test_fit_wants_a_file_or_an_address(capsys, tmp_path):
    assert "needs a FILE, or an arm with --ip ADDRESS" in refused(capsys, "fit")
    assert "one of the two" in refused(capsys, "fit", tmp_path / "arm.yaml", "--ip", "127.0.0.1")
    with emulated(faults=Faults(error=22)) as (_, address):
        out = tmp_path / "fitted.json"
        code, said, err = run(capsys, "fit", "--ip", address, "--fk-samples", 3, "--out", out)
        assert code == 2
        assert "reports error 22" in err
        assert "Converged" in said, "the fit is good, whatever the controller says"
        assert out.exists()
        assert "--fk-samples 0" in refused(capsys, "fit", "--ip", address, "--fk-samples", 0)


# ------------------------------------------------------------------ record


def test_record_refuses_before_it_calls(capsys, tmp_path):
    nobody = new_host()
    for name in ("run.csv", "run.yaml", "run_factory.yaml"):
        (tmp_path / name).write_text("mine")
        message = refused(capsys, "record", "--ip", nobody, "--out", tmp_path / "run.csv")
        assert message.startswith(f"{tmp_path / name}: exists already")
        (tmp_path / name).unlink()
    assert "ends in .csv or .parquet" in refused(capsys, "record", "--ip", nobody, "--out", tmp_path / "run.mcap")
    out = tmp_path / "run.csv"
    assert "leave one out" in refused(
        capsys, "record", "--ip", nobody, "--out", out, "--poses", tmp_path / "p.csv", "--seconds", 3
    )
    assert "more than zero" in refused(capsys, "record", "--ip", nobody, "--out", out, "--seconds", 0)
    assert "no such file" in refused(capsys, "record", "--ip", nobody, "--out", out, "--poses", tmp_path / "p.csv")
    assert "nothing listens there" in refused(capsys, "record", "--ip", nobody, "--out", out)


@contextmanager
def recording(address, out, *more):
    """The command in a process of its own, from which Ctrl-C can be had."""
    command = [sys.executable, "-m", "lite6jax.cli", "record", "--ip", str(address), "--out", str(out), *more]
    environment = {**os.environ, "COLUMNS": "80"}
    process = subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize(("name", "number"), [("run.parquet", signal.SIGINT), ("run.csv", signal.SIGTERM)])
def test_an_interrupt_keeps_every_row(tmp_path, name, number):
    out = tmp_path / name
    with emulated(path=draw_sines(ARM)) as (_, address), recording(address, out) as process:
        deadline = time.monotonic() + 60
        while not (tmp_path / "run.yaml").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.6)
        for _ in range(3):  # impatience costs no row
            process.send_signal(number)
            time.sleep(0.02)
        said, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    rows = int(re.search(r"Recorded (\d+) rows", said)[1])
    read = read_recording(out)
    assert read.samples == rows > 50
    assert (np.rint(1e6 * np.diff(read.time)) == 4000).all()


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_a_kill_costs_a_second_at_most(tmp_path, capsys):
    out, rows = tmp_path / "run.parquet", tmp_path / "run.growing.csv"
    with emulated(path=draw_sines(ARM)) as (_, address):
        with recording(address, out) as process:
            deadline = time.monotonic() + 60
            while not (rows.exists() and rows.stat().st_size > 10_000) and time.monotonic() < deadline:
                time.sleep(0.05)
            time.sleep(1.5)
            process.kill()
            process.wait()
        read = read_recording(out)
        assert pyarrow.csv.read_csv(rows).num_rows == read.samples
        assert (np.rint(1e6 * np.diff(read.time)) == 4000).all()
        assert read.samples >= 250
        assert any("there is no run.parquet: the rows are those of run.growing.csv" in note for note in read.notes)
        assert yaml.safe_load((tmp_path / "run.yaml").read_text())["account"] == {"complete": False}
        assert "exists already" in refused(capsys, "record", "--ip", address, "--out", out, "--seconds", 1)
        code, _, _ = run(capsys, "record", "--ip", address, "--out", out, "--seconds", 1, "--force")
    assert code == 0
    assert read_recording(out).samples == 250
    assert {path.name for path in tmp_path.iterdir()} == {out.name, "run.yaml", "run_factory.yaml"}


def test_less_than_was_asked_for_is_said_and_not_0(capsys, tmp_path):
    with emulated(faults=Faults(lose_every=50), speed=20.0) as (controller, address):
        code, said, _ = run(capsys, "record", "--ip", address, "--out", tmp_path / "a.csv", "--seconds", 4, width=100)
        assert code == 1
        rows, missing = re.search(r"Recorded (\d+) rows", said)[1], re.search(r"(\d+) reports missing, no dup", said)[1]
        assert int(rows) + int(missing) in (999, 1000)
        assert "1000 rows were asked for." in said
        assert "no duplicates. The columns missing and gap say where and why." in flat(said)
        controller.set_faults(Faults(close_reports_after=300))
        code, said, _ = run(capsys, "record", "--ip", address, "--out", tmp_path / "b.csv", "--seconds", 30, width=100)
        assert code == 1
        assert re.search(r"Recorded \d+ rows in \d+ runs", said)
        assert re.search(r"0 reports missing within runs, about \d+ between runs, no duplicates\.", said)
