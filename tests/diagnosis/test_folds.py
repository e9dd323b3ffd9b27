"""Folds that are worked on side by side, by threads or processes, whose number changes no answer."""

import os
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from diagnosis.recorded import Made, static_motion

from lite6jax import threads
from lite6jax.cli import main
from lite6jax.cli.diagnose import share_folds
from lite6jax.diagnosis.fold_processes import work_on_folds
from lite6jax.diagnosis.heldout import fold_count, spread_folds
from lite6jax.diagnosis.options import Options
from lite6jax.diagnosis.result import block_count
from lite6jax.estimation.noise import UNCORRELATED, Autocorrelation, NoiseModel
from lite6jax.progress import Stage, entered, followed, part
from lite6jax.recordings import write_recording
from tests.batch_work import folded


def test_results_are_in_the_order_of_the_folds_and_stages_count_those_completed():
    stages = []

    def work(fold):
        threading.Event().wait(0.01 * (5 - fold))  # the first takes longest
        entered("selecting")
        return 10 * fold

    with followed(stages.append):
        assert work_on_folds(work, (), range(5)) == [0, 10, 20, 30, 40]
    parts = [stage.part for stage in stages]
    assert len(parts) == 5
    assert parts == sorted(parts)
    assert parts[0] == 1
    assert max(parts) <= 5
    assert {stage.parts for stage in stages} == {6}


def test_a_follower_hears_of_each_stage_and_its_part():
    heard = []
    entered("screening")  # nobody listens
    with followed(heard.append):
        entered("screening")
        with part(2, 6), followed(None):  # who follows goes on
            entered("naming")
        entered("estimating")
    entered("planning")
    assert heard == [Stage("screening"), Stage("naming", 2, 6), Stage("estimating")]


@pytest.mark.parametrize(
    ("samples", "needed", "count"),
    [
        (1000, 0, 5),
        (15, 0, 5),  # three rows in each: the search of the others has four fifths of them
        (15, 13, 8),  # two rows in each leave thirteen
        (4, 0, 4),
    ],
)
def test_few_rows_are_held_out_in_as_many_blocks_as_many_rows(samples, needed, count):
    assert fold_count(samples, Options(), needed) == count


@pytest.mark.parametrize(
    ("rows", "noise", "blocks"),
    [
        (200, UNCORRELATED, 25),
        (17, UNCORRELATED, 15),  # one or two rows in each
        (200, Autocorrelation(0.5, 1.0), 20),  # three times the autocorrelation time of 3 samples
        (200, Autocorrelation(0.95, 1.0), 5),  # contiguous fifths: none is shorter
    ],
)
def test_rows_that_are_held_out_together_are_spread_in_blocks_longer_than_the_noise_remembers(rows, noise, blocks):
    contiguous = list(np.arange(rows) * 5 // rows == np.arange(5)[:, None])
    folds = spread_folds(contiguous, NoiseModel((noise,), np.zeros(3, int)))
    assert np.array_equal(np.sum(folds, 0), np.ones(rows))
    assert (len(folds), block_count(folds)) == (5, blocks)
    ends = np.flatnonzero(np.diff(np.argmax(folds, 0))) + 1
    assert np.diff([0, *ends, rows]).min() == rows // blocks


# ------------------------------------------------------------------ processes


FOLDS = [np.array([k]) for k in range(5)]
HERE = os.getpid()


def test_folds_are_shared_and_results_in_their_order():
    deadline = time.monotonic() + 60
    with share_folds(3):
        while time.monotonic() < deadline:
            results = work_on_folds(folded, ("done", HERE), FOLDS)
            assert [fold for fold, _ in results] == [0, 1, 2, 3, 4]
            if len({process for _, process in results}) > 1:  # those that have started by then
                break
    assert HERE in {process for _, process in results}
    assert len({process for _, process in results}) > 1


@pytest.mark.parametrize("what", ["die", "fail"])
def test_what_a_process_could_not_do_is_done_here(what):
    with share_folds(3):
        assert work_on_folds(folded, (what, HERE), FOLDS) == [(k, HERE) for k in range(5)]


def test_the_document_is_the_same_for_any_number_of_processes(tmp_path, capsys, monkeypatch):
    made = Made(tmp_path, ("joint_compliance:joint=2,compliance_rad_per_Nm=9e-5",))
    path = write_recording(made.recording(static_motion(3, 120)), tmp_path / "run.csv")
    command = ["diagnose", str(path), "--json", "--processes"]
    shared = subprocess.run([sys.executable, "-m", "lite6jax.cli", *command, "2"], capture_output=True, check=True)
    monkeypatch.setattr(threads, "limit", lambda count: None)  # there is but one thread in tests
    assert main([*command, "1"]) == 0
    assert capsys.readouterr().out == shared.stdout.decode()
    assert b'"joint_compliance"' in shared.stdout
