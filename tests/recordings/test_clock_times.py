"""A column of times may be a clock's: as text in forms of one meaning, or as timestamps of a table."""

from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typed import unread

from lite6jax.recordings import Recording, read_recording, read_targets

SECONDS = [0.0, 0.123, 61.5, 3600.25]


def stamps(form):
    first = datetime(2026, 11, 21, 23, 59, 59, 500_000, UTC)
    return [form(first + timedelta(seconds=s)) for s in SECONDS]


def written(tmp_path, times, name="time_s", separator=","):
    path = tmp_path / "run7.csv"
    rows = [separator.join([name, "q1_rad", "x_m", "y_m", "z_m"])]
    rows += [separator.join([time, "0.1", "0.2", "0.3", "0.4"]) for time in times]
    path.write_text("\n".join(rows) + "\n")
    path.with_suffix(".yaml").write_text("recording: {motion: static}\n")
    return path


EAST = timezone(timedelta(hours=5, minutes=30))
FORMS = {
    "zone": lambda t: t.strftime("%Y-%m-%dT%H:%M:%S.%fZ"),
    "no zone": lambda t: t.strftime("%Y-%m-%dT%H:%M:%S.%f"),
    "space": lambda t: t.strftime("  %Y-%m-%d %H:%M:%S.%f "),
    "offset": lambda t: t.astimezone(EAST).strftime("%Y-%m-%dT%H:%M:%S.%f+05:30"),
    "offset without colon": lambda t: t.astimezone(EAST).strftime("%Y-%m-%d %H:%M:%S.%f +0530"),
    "UTC": lambda t: t.strftime("%Y-%m-%d %H:%M:%S.%f UTC"),
    "milliseconds": lambda t: t.strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z",
    "nanoseconds": lambda t: t.strftime("%Y-%m-%dT%H:%M:%S.%f") + "000Z",
    "two zones": lambda t: t.astimezone(EAST).isoformat() if t.second % 2 else t.isoformat(),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["time_s", "time_ms"])  # the unit is the text's
def test_text_is_counted_from_the_first(tmp_path, form, name):
    path = written(tmp_path, stamps(FORMS[form]), name)
    recording = read_recording(path)
    np.testing.assert_allclose(recording.time, SECONDS, rtol=1e-15)
    first = stamps(FORMS[form])[0].strip()
    assert recording.notes == (f"{name} holds clock times: they are counted from the first, {first}",)
    np.testing.assert_array_equal(read_targets(path, 1).recording.time, recording.time)


def test_a_decimal_comma_and_missing_times(tmp_path):
    times = ["2026-11-21T10:00:02,5", "", "2026-11-21T10:00:00,25"]
    recording = read_recording(written(tmp_path, times, separator=";"))
    assert recording.time.tolist() == [2.25, 0.0]  # from the earliest; the row without a time is dropped
    assert recording.row.tolist() == [1, 3]


@pytest.mark.parametrize(
    ("times", "problem"),
    [
        (["21.11.2026 10:00:00"], "row 1 holds '21.11.2026 10:00:00', which is no clock time of one meaning"),
        (["11/21/2026 10:00:00"], "row 1 holds '11/21/2026 10:00:00', which is no clock time of one meaning"),
        (["10:00:00.5"], "row 1 holds '10:00:00.5', which is no clock time of one meaning"),
        (["2026-11-21"], "row 1 holds '2026-11-21', which is no clock time of one meaning"),
        (["2026-11-21T10:00:00 CET"], "row 1 holds '2026-11-21T10:00:00 CET', which is no clock time of one meaning"),
        (["2026-11-21T10:00:00", "2026-02-30T10:00:00"], "row 2 holds '2026-02-30T10:00:00', which is no clock time"),
        (["2026-11-21T10:00:00Z", "5.0"], "row 2 holds '5.0', which is no clock time of one meaning"),
        (["2026-11-21T10:00:00Z", "2026-11-21T10:00:01"], "row 2 holds '2026-11-21T10:00:01', but not all rows have a"),
        (["0.1", "late"], "row 2 holds 'late', which is no number; give numbers with a decimal point"),
    ],
)
def test_what_would_be_a_guess_is_refused(tmp_path, times, problem):
    assert unread(written(tmp_path, times)).startswith(f"column time_s: {problem}")


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
@pytest.mark.parametrize("zone", [None, "UTC"])
def test_timestamps_of_tables_are_read_alike(tmp_path, unit, zone):
    naive = stamps(lambda t: t.replace(tzinfo=None))
    table = {"time_s": pa.array(naive, pa.timestamp(unit, zone)), "q1_rad": pa.array([0.1] * 4)}
    path = tmp_path / "run7.parquet"
    pq.write_table(pa.table(table), path)
    np.testing.assert_allclose(read_recording(path).time, SECONDS, rtol=1e-15)
    frame = Recording.from_dataframe(pa.table(table), motion="static")
    np.testing.assert_allclose(frame.time, SECONDS, rtol=1e-15)
    assert "counted from the first, 2026-11-21T23:59:59.500" in frame.notes[0]
