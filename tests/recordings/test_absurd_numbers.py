"""Numbers beyond any arm or sensor: the rows are dropped and named, and what is left is as if they had not been."""

import numpy as np
import pytest
from typed import unread

from lite6jax.errors import InputError
from lite6jax.recordings import read_recording, read_targets
from tests.damaged import CSV, SAMPLES

ROW = 20
ABSURD = [
    *(("x_m", value) for value in ("1e15", "-1e15", "3.4028235e38", "1e160", "1e308", "101")),
    *(("q2_rad", value) for value in ("6284", "3.4028235e38", "-1e308")),
    *(("time_s", value) for value in ("1e308", "-1e300", "2e9")),
    *(("temp3_degC", "1e308"), ("payload_kg", "1e300")),
]


@pytest.fixture
def written(tmp_path):
    """Writes the recording with other text in some cells, by data row and column."""
    path = CSV.write(tmp_path)
    lines = [line.split(",") for line in path.read_text().splitlines()]

    def write(*cells):
        changed = [list(line) for line in lines]
        for row, name, value in cells:
            changed[row][lines[0].index(name)] = value
        path.write_text("".join(",".join(line) + "\n" for line in changed))
        return path

    return write


def arrays(read, rows):
    kept = read.select(rows)
    return {name: value for name, value in vars(kept).items() if isinstance(value, np.ndarray)}


@pytest.mark.parametrize(("column", "value"), ABSURD)
def test_the_row_of_an_absurd_number_is_dropped_and_named(written, column, value):
    whole = read_recording(written())
    read = read_recording(written((ROW, column, value)))
    assert read.row.tolist() == [row for row in range(1, SAMPLES + 1) if row != ROW]
    assert read.notes == (
        f"numbers beyond any arm or sensor count as missing: {float(value):.5g} in column {column}, row {ROW}",
        f"dropped 1 row with NaN, infinite or empty fields, that is row {ROW}",
    )
    others = whole.row != ROW
    expected, actual = arrays(whole, others), arrays(read, np.arange(read.samples))
    neighbour = expected.pop("direction_of_motion"), actual.pop("direction_of_motion")
    np.testing.assert_array_equal(neighbour[0][: ROW - 1], neighbour[1][: ROW - 1])
    for name, array in expected.items():
        np.testing.assert_array_equal(actual[name], array, err_msg=name)


def test_many_rows_are_listed_and_over_half_are_an_error(written):
    rows = range(2, 42, 2)
    notes = read_recording(written(*((row, "y_m", "1e9") for row in rows))).notes
    assert notes[0] == (
        "numbers beyond any arm or sensor count as missing: 1e+09 in column y_m, row 2; rows 2, 4, 6, 8, 10, 12, 14, "
        "16, 18, 20, 22, 24 and 8 more"
    )
    assert unread(written(*((row, "q1_rad", "1e9") for row in range(1, SAMPLES)))) == (
        "59 of 60 rows have numbers beyond any arm or sensor (1e+09 in column q1_rad, row 1); check the unit and the "
        "column"
    )


def test_a_target_that_is_absurd_is_a_target_without_a_value(tmp_path):
    path = tmp_path / "targets.csv"
    path.write_text("x_m,y_m,z_m\n1e15,0,0\n0.2,0.1,0.3\n")
    read = read_targets(path, 6).recording
    assert np.isnan(read.position[0, 0])
    assert read.notes[0] == "numbers beyond any arm or sensor count as missing: 1e+15 in column x_m, row 1"
    path.write_text("name,note\na,b\n")
    with pytest.raises(InputError, match=r"has no positions to reach; name their columns x_m y_m z_m"):
        read_targets(path, 6)
