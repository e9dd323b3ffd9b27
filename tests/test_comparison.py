"""Results of concealed trials against the record of an earlier version."""

from pathlib import Path

import pytest

from benchmarks.concealed.campaign import POSES
from benchmarks.concealed.comparison import differences

RECORD = Path(__file__).resolve().parents[1] / "benchmarks/records/concealed_0.1.0_seed8.parquet"


@pytest.fixture(scope="module")
def record():
    return POSES.read_rows(RECORD)


def test_a_result_agrees_with_itself(record):
    first, errors = differences(record, record)
    assert first == f"{len(record)} of {len(record)} trials have the same findings and data faults."
    assert errors.startswith("Held-out errors, over those before: median 1.0000, 1.000 to 1.000; 0 of ")


def test_what_differs_is_named(record):
    found = next(row for row in record if row["findings"])
    changed = [row | {"findings": [], "after_m": 2 * row["after_m"]} if row is found else row for row in record]
    line, agreeing, errors = differences(record, changed)
    assert line.startswith(f"trial {found['index']} ({found['kind']}): before (['{found['findings'][0]['effect']}:")
    assert agreeing.startswith(f"{len(record) - 1} of {len(record)} trials")
    assert "to 2.000; 1 of " in errors


def test_trials_of_another_truth_are_not_compared(record):
    others = [row | {"sha256": "0"} for row in record]
    assert list(differences(record, others)) == ["0 of 0 trials have the same findings and data faults."]
