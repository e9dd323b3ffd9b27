"""The stage that a long diagnosis shows."""

import time

from lite6jax.progress import Stage, entered, followed, part
from lite6jax.report import screen


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


def test_where_stderr_is_no_terminal_a_line_comes_from_time_to_time(monkeypatch, capsys):
    monkeypatch.setattr(screen, "EVERY", 0.01)
    with screen.stages() as follow:
        follow(Stage("naming", 1, 5))
        until = time.monotonic() + 10.0
        heard = ""
        while "testing names" not in heard and time.monotonic() < until:
            time.sleep(0.01)
            heard += capsys.readouterr().err
    assert "testing names, without block 1 of 4: 0:00 so far" in heard
