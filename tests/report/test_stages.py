"""The stage and the time to go that a long diagnosis shows."""

import time

import pytest

from lite6jax.progress import Stage, entered, followed, part
from lite6jax.report import screen
from lite6jax.report.screen import Clock


def clock(*times):
    """After the beginnings of parts 0, 1, … of 5 at these times, in s."""
    ours = Clock(0.0)
    for number, at in enumerate(times):
        ours.entered(Stage("selecting", number, 5), at)
    return ours


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


def test_time_to_go_is_that_of_the_parts_left():
    # 40 s for all rows; of the four held-out blocks, each 10 s so far
    assert clock(0.0, 40.0, 50.0, 60.0).to_go(60.0) == pytest.approx(20.0)
    assert clock(0.0, 40.0, 50.0, 60.0).to_go(64.0) == pytest.approx(16.0)
    # one that takes longer than the others does not make the rest negative
    assert clock(0.0, 40.0, 50.0, 60.0).to_go(90.0) == pytest.approx(10.0)
    assert clock(0.0, 40.0, 50.0, 60.0, 70.0, 80.0).to_go(80.0) == 0.0


def test_before_a_block_is_measured_its_time_is_a_share_of_that_of_all_rows():
    assert clock(0.0, 40.0).to_go(40.0) == pytest.approx(4 * 20.0)
    assert clock(0.0).to_go(40.0) is None


def test_lines_name_stage_block_and_times():
    assert Clock(0.0).line(3.0) == "reading rows, 0:03 so far"
    assert clock(0.0).line(65.0) == "searching for physics: 1:05 so far, more than 2:10 to go"
    assert (
        clock(0.0, 40.0, 50.0).line(52.0)
        == "searching for physics, without block 2 of 4: 0:52 so far, about 0:28 to go"
    )
    last = Clock(0.0)
    last.entered(Stage("planning", 5, 5), 90.0)
    assert last.line(90.0).startswith("choosing poses that separate the alternatives: 1:30 so far")


def test_where_stderr_is_no_terminal_a_line_comes_from_time_to_time(monkeypatch, capsys):
    monkeypatch.setattr(screen, "EVERY", 0.01)
    with screen.stages() as follow:
        follow(Stage("naming", 1, 5))
        until = time.monotonic() + 10.0
        heard = ""
        while "testing names" not in heard and time.monotonic() < until:
            time.sleep(0.01)
            heard += capsys.readouterr().err
    assert "testing names, without block 1 of 4: 0:00 so far, about 0:00 to go" in heard


def test_a_short_computation_says_nothing(capsys):
    with screen.stages() as follow:
        follow(Stage("naming", 1, 5))
    assert capsys.readouterr().err == ""


def test_every_code_has_words():
    assert set(screen._STAGES) == set(screen.Code.__args__)
