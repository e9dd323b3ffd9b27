"""Time stamps of logs of commands that repeat, jump or vary: what is made of them, and what is said."""

import numpy as np
import pytest
from typed import flat, refused, run

from lite6jax.domains.tracking.screening import screen_tracking
from lite6jax.recordings import read_recording
from lite6jax.report.faults import fault_statement
from tests.domains.tracking.test_servo_fit import PENDULUM, PERIOD, commands_of
from tests.domains.tracking.test_tracking_commands import NOISE, columns_of, write_log

SAMPLES = 400


@pytest.fixture(scope="module")
def log():
    return columns_of(commands_of(SAMPLES), NOISE)


def screened(folder, columns):
    return screen_tracking(read_recording(write_log(folder, columns, noise=NOISE)), PENDULUM)


def the_fault(result):
    (fault,) = result.found
    return fault, fault_statement(fault)


def test_even_stamps_are_not_mentioned(tmp_path, log):
    result = screened(tmp_path, log)
    assert result.found == ()
    assert np.array_equal(result.data.recording.row, np.arange(SAMPLES) + 1)


def test_of_rows_with_one_stamp_the_last_counts(tmp_path, log):
    doubled = {name: np.insert(column, 100, column[100] + (name != "time_s")) for name, column in log.items()}
    result = screened(tmp_path, doubled)
    fault, said = the_fault(result)
    assert (fault.code, fault.rows, fault.numbers) == ("repeated_stamps", (101,), {"count": 1})
    assert "The time stamp of the next row stands in 1 row" in said
    assert result.data.measured[0] == pytest.approx(log["q1_rad"], abs=1e-8)
    assert result.data.recording.commanded_position[:, 0] == pytest.approx(log["cmd1_rad"], abs=1e-8)


@pytest.mark.parametrize(
    ("code", "shift", "number", "words"),
    [
        ("time_gaps", 1.0, {"longest_s": 1.0 + PERIOD}, "Time has 1 gap of more than ten samples"),
        ("time_goes_back", -1.0, {"largest_step_back_s": 1.0 - PERIOD}, "goes back in 1 row, by 0.99 s at most"),
    ],
)
def test_where_time_jumps_a_run_begins(tmp_path, log, code, shift, number, words):
    result = screened(tmp_path, log | {"time_s": log["time_s"] + shift * (np.arange(SAMPLES) >= 150)})
    fault, in_motion = result.found
    said = fault_statement(fault)
    assert (fault.code, fault.rows) == (code, (151,))
    assert (in_motion.code, in_motion.rows[0], in_motion.numbers["runs"]) == ("moving_start", 151, 1)
    assert fault.numbers == pytest.approx({"count": 1} | number)
    assert words in said
    assert result.data.recording.run.tolist() == [0] * 150 + [1] * (SAMPLES - 150)
    assert result.data.measured[0] == pytest.approx(log["q1_rad"], abs=1e-8)


def test_an_uneven_rate_is_said_and_a_little_jitter_is_not(tmp_path, log):
    rng = np.random.default_rng(2)
    jitter = log | {"time_s": log["time_s"] + rng.uniform(-0.1, 0.1, SAMPLES) * PERIOD}
    assert screened(tmp_path, jitter).found == ()
    kept = np.sort(rng.choice(SAMPLES, SAMPLES * 3 // 4, replace=False))
    fault, said = the_fault(screened(tmp_path, {name: column[kept] for name, column in log.items()}))
    assert fault.code == "uneven_rate"
    assert "most of them from 10 to" in said
    assert "100 rows a second: read-outs on lines between rows, commands held" in said


def test_the_diagnosis_of_a_log_with_all_of_them_says_them_with_their_rows(capsys, tmp_path, log):
    time = log["time_s"].copy()
    time[50] = time[49]
    time[200:] += 1.0
    time[300:] -= 3.0
    path = write_log(tmp_path, log | {"time_s": time}, noise=NOISE)
    code, out, _ = run(capsys, "diagnose", path, "--quick", width=120)
    said = flat(out)
    assert code == 0
    for name, row in (("Repeated time stamps", 50), ("Gaps in time", 201), ("Time that goes back", 301)):
        assert name.lower() in said
        assert f"Rows {row}." in said


def test_rows_that_do_not_follow_each_other_are_refused(capsys, tmp_path, log):
    time = np.where(np.arange(SAMPLES) % 2, log["time_s"], log["time_s"] - 50.0)
    said = refused(capsys, "diagnose", write_log(tmp_path, log | {"time_s": time}))
    assert "sort the rows by time" in said
