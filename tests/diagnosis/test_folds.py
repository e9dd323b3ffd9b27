"""Folds that are worked on side by side."""

import threading

import pytest

from lite6jax.diagnosis.folds import side_by_side
from lite6jax.progress import Stage, entered, followed


def test_results_are_in_the_order_of_the_folds_and_stages_count_those_completed():
    stages = []

    def work(fold):
        threading.Event().wait(0.01 * (5 - fold))  # the first takes longest
        entered("selecting")
        return 10 * fold

    with followed(stages.append):
        assert side_by_side(work, range(5)) == [0, 10, 20, 30, 40]
    parts = [stage.part for stage in stages]
    assert len(parts) == 5
    assert parts == sorted(parts)
    assert parts[0] == 1
    assert max(parts) <= 5
    assert {stage.parts for stage in stages} == {6}


def test_the_follower_of_the_caller_hears_the_stages_of_every_fold():
    stages = []
    with followed(stages.append):
        side_by_side(lambda fold: entered("noise"), [0])
    assert stages == [Stage("noise", 1, 2)]


def test_an_error_ends_the_work_on_folds_that_have_not_begun():
    begun = []

    def work(fold):
        begun.append(fold)
        if fold == 0:
            raise ValueError("no such fold")
        threading.Event().wait(0.05)

    with pytest.raises(ValueError, match="no such fold"):
        side_by_side(work, range(1000))
    assert len(begun) < 100
