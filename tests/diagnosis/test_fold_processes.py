"""Folds are shared with other processes, whatever becomes of these, and the answer does not depend on it."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest
from diagnosis.recorded import Made, static_motion

from lite6jax.cli import main
from lite6jax.diagnosis import fold_processes as module
from lite6jax.diagnosis.fold_processes import fold_processes, work_on_folds
from lite6jax.recordings import write_recording
from lite6jax.workers import _Process
from tests import batch_work
from tests.batch_work import folded

FOLDS = [np.array([k]) for k in range(5)]
HERE = os.getpid()


def at_hand():
    return module._at_hand.get()


def test_folds_are_shared_and_results_in_their_order():
    deadline = time.monotonic() + 60
    with fold_processes(3):
        while time.monotonic() < deadline:
            results = work_on_folds(folded, ("done", HERE), FOLDS)
            assert [fold for fold, _ in results] == [0, 1, 2, 3, 4]
            if len({process for _, process in results}) > 1:  # those that have started by then
                break
    assert HERE in {process for _, process in results}
    assert len({process for _, process in results}) > 1


@pytest.mark.parametrize("what", ["die", "fail"])
def test_what_a_process_could_not_do_is_done_here(what):
    with fold_processes(3):
        assert work_on_folds(folded, (what, HERE), FOLDS) == [(k, HERE) for k in range(5)]


def test_an_error_here_is_an_error_and_processes_that_work_are_ended_at_once(monkeypatch):
    started = []
    monkeypatch.setattr(_Process, "_start", lambda self, start=_Process._start: started.append(start(self)))

    def fail_once_the_other_works():
        deadline = time.monotonic() + 60
        while not process._is_ready and time.monotonic() < deadline:
            time.sleep(0.01)
        raise ValueError("no such fold")

    monkeypatch.setattr(batch_work, "work_here", fail_once_the_other_works)
    with fold_processes(2):
        (process,) = at_hand()._all
        begins = time.monotonic()
        with pytest.raises(ValueError, match="no such fold"):
            work_on_folds(folded, ("slow", HERE), FOLDS)
        ended = process._process.pid
    assert time.monotonic() - begins < 60  # not the minute that the work takes
    assert len(started) == 1  # and none in its place
    with pytest.raises(ProcessLookupError):
        os.kill(ended, 0)


def test_a_program_that_calls_the_library_gets_no_processes_unless_it_asks(monkeypatch):
    limits = []
    monkeypatch.setattr(module.threads, "limit", limits.append)
    with fold_processes():
        assert at_hand() is None
    assert limits == []
    with fold_processes(1):
        assert at_hand() is None
    assert limits == [1]
    with fold_processes(2):
        assert at_hand() is not None
    assert at_hand() is None


def test_the_document_is_the_same_for_any_number_of_processes(tmp_path, capsys, monkeypatch):
    made = Made(tmp_path, ("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",))
    path = write_recording(made.recording(static_motion(3, 120)), tmp_path / "run.csv")
    command = ["diagnose", str(path), "--json", "--processes"]
    shared = subprocess.run([sys.executable, "-m", "lite6jax.cli", *command, "2"], capture_output=True, check=True)
    monkeypatch.setattr(module.threads, "limit", lambda count: None)  # there is but one thread in tests
    assert main([*command, "1"]) == 0
    assert capsys.readouterr().out == shared.stdout.decode()
    assert b'"joint_compliance"' in shared.stdout
