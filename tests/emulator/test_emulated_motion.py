"""Paths as functions of time, how an arm follows them, and its core, all without sockets or threads.

A controller that ran beside would move the state of `random`, which the run-time type checker draws from, and
Hypothesis takes that for a strategy that is not repeatable.
"""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lite6jax.arms.description import load_bundled
from lite6jax.controller import protocol
from lite6jax.controller.protocol import Register
from lite6jax.emulator import Faults, draw_sines, interpolate, read_path, visit
from lite6jax.emulator.core import Core, answer, report
from lite6jax.errors import InputError
from lite6jax.simulation.motions import MAX_SPEED, rest

LITE6 = load_bundled("lite6")
HERE = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6])
THERE = np.array([1.1, 0.2, 0.3, -0.4, -0.1, 0.5])
PATHS = {
    "rest": rest(HERE),
    "sines": draw_sines(LITE6, seed=2),
    "visits": visit([HERE, THERE, HERE * 2]),
    "played": interpolate(np.linspace(3, 8, 40), np.sin(np.linspace(0, 2, 40))[:, None] * THERE),
}


@pytest.mark.parametrize("name", PATHS)
def test_velocity_is_the_derivative_of_position(name):
    path = PATHS[name]
    t, h = np.linspace(1e-3, min(path.duration, 30.0) - 1e-3, 501) if path.duration else np.array([0.5]), 1e-5
    slope = (path.at(t + h)[0] - path.at(t - h)[0]) / (2 * h)
    np.testing.assert_allclose(path.at(t)[1], slope, atol=1e-3 if name == "visits" else 1e-5)


@given(st.floats(0.01, 3.1), st.floats(0.1, 20.0), st.floats(1e-6, 6.0))
def test_a_visit_keeps_to_its_limits_and_wastes_no_time(speed, acceleration, way):
    path, pause = visit([np.zeros(2), [way, -way / 3]], 1.0, speed, acceleration), 1.0
    ramp = speed / acceleration
    expected = way / speed + ramp if way > speed * ramp else 2 * np.sqrt(way / acceleration)
    t = np.linspace(pause, pause + expected, 400)
    q, dq = path.at(t)
    assert q[-1, 0] == pytest.approx(way, rel=1e-9)
    assert not path.at(t[-1:] + 0.5)[1].any()
    assert np.abs(dq).max() <= speed * (1 + 1e-9)
    assert np.abs(np.diff(dq[:, 0]) / np.diff(t)).max() <= acceleration * (1 + 1e-6)
    np.testing.assert_allclose(q[:, 1], -q[:, 0] / 3, atol=1e-12)  # in time with each other


@pytest.mark.parametrize("name", ["lite6", "xarm5", "xarm7"])
def test_programs_stay_within_limits_and_speed(name):
    arm = load_bundled(name)
    for what in ("sines", "poses"):
        path = read_path(what, arm, seed=4)
        q, dq = path.at(np.linspace(0, 300, 30001))
        assert (q >= arm.joint_limits[:, 0]).all()
        assert (q <= arm.joint_limits[:, 1]).all()
        assert np.abs(dq).max() <= MAX_SPEED
        assert not path.at(np.zeros(1))[1].any()
        assert np.ptp(q, axis=0).min() > 1.0
    assert read_path("rest", arm) is None


def test_an_arm_rests_before_and_after_its_path_and_where_an_error_stops_it(lite6):
    core = Core(lite6, path=PATHS["played"])
    times = np.array([-1.0, 0.0, 2.5, 5.0, 99.0])
    q, dq = core.read_commands(times)
    np.testing.assert_array_equal(q, PATHS["played"].at(np.clip(times, 0, 5))[0])
    np.testing.assert_array_equal(dq.any(1), [False, False, True, False, False])
    core.advance(2.0)
    assert (core.state, core.enabled) == (1, 0b111111)
    core.set_faults(Faults(error=22))
    core.advance(3.0)
    assert (core.state, core.enabled) == (4, 0)
    position, velocity = core.read_commands(np.array([1.9, 2.0, 99.0]))
    np.testing.assert_array_equal(position, PATHS["played"].at(np.array([1.9, 2.0, 2.0]))[0])
    np.testing.assert_array_equal(velocity.any(1), [True, False, False])
    # and one that is in error from the start stands still
    position, velocity = Core(lite6, Faults(error=22), PATHS["sines"]).read_commands(times)
    assert not velocity.any()
    assert not np.ptp(position, axis=0).any()


# ------------------------------------------------------------------------------------------ from a file


def recording(path, text):
    path.write_text(text)
    return str(path)


def test_a_trajectory_is_played(tmp_path):
    rows = ["time_s," + ",".join(f"q{i}_rad" for i in range(1, 7))]
    rows += [f"{0.1 * k},{0.1 * np.sin(k / 5)},0,1,0,0,0" for k in range(60)]
    path = read_path(recording(tmp_path / "run.csv", "\n".join(rows)), LITE6)
    assert path.duration == pytest.approx(5.9)
    np.testing.assert_allclose(path.at(np.array([2.0]))[0][0], [0.1 * np.sin(4), 0, 1, 0, 0, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["0,0,1,0,0,0", "0,3,1,0,0,0"], "joint 2 is 21.9° beyond its limits in row 2; give a motion that this arm"),
        (["0,0,1,0,0", "0,0,1,0,0"], "has 5 joints .*, the arm has 6; choose the arm it is of"),
    ],
)
def test_motions_that_the_arm_cannot_do(tmp_path, rows, message):
    header = ",".join(f"q{i}_rad" for i in range(1, len(rows[0].split(",")) + 1))
    file = recording(tmp_path / "run.csv", "\n".join([header, *rows]))
    with pytest.raises(InputError, match=message):
        read_path(file, LITE6)


def test_motions_that_are_too_fast_or_out_of_order(tmp_path):
    header = "time_s," + ",".join(f"q{i}_rad" for i in range(1, 7))
    fast = recording(tmp_path / "fast.csv", "\n".join([header, *(f"{0.1 * k},{k % 2},0,1,0,0,0" for k in range(20))]))
    with pytest.raises(InputError, match=r"a joint moves at \d+°/s, but the limit is 180°/s; give a slower"):
        read_path(fast, LITE6)
    rows = (f"{0.1 * k},{int(k == 15000)},0,1,0,0,0" for k in range(20000))
    jerk = recording(tmp_path / "jerk.csv", "\n".join([header, *rows]))
    with pytest.raises(InputError, match=r"a joint moves at \d+°/s"):  # once in half an hour
        read_path(jerk, LITE6)
    back = recording(tmp_path / "back.csv", "\n".join([header, "0,0,0,1,0,0,0", "0.2,0,0,1,0,0,0", "0.1,0,0,1,0,0,0"]))
    with pytest.raises(InputError, match="time does not increase from row to row; sort the rows, and keep one run"):
        read_path(back, LITE6)


# ------------------------------------------------------------------------------------------ what it is asked

EXTREME = st.sampled_from([0.0, 1.0, -3.0, 1e30, -1e30, float("inf"), float("nan"), 1e-30])
BODY = st.one_of(
    st.binary(max_size=60),
    st.lists(EXTREME, max_size=12).map(lambda values: struct.pack(f"<{len(values)}f", *values)),
    st.tuples(st.lists(EXTREME, min_size=6, max_size=10), st.binary(max_size=30)).map(
        lambda parts: struct.pack(f"<{len(parts[0])}f", *parts[0]) + parts[1]
    ),
)


@settings(max_examples=80)
@given(
    requests=st.lists(st.tuples(st.sampled_from([*Register, 0, 11, 23, 99, 199]), BODY), min_size=1, max_size=6),
    moving=st.booleans(),
)
def test_nothing_that_is_asked_breaks_it(lite6, requests, moving):
    core = Core(lite6, path=draw_sines(lite6.arm) if moving else None)
    for transaction, (register, body) in enumerate(requests):
        reply = answer(core, protocol.Message(register, body, transaction))
        assert reply is not None
        assert (reply.transaction, reply.register) == (transaction, register)
        core.advance(core.time + 0.1)
        for port in protocol.RATES:
            assert len(report(core, port, np.array([core.time, core.time + 0.01]))) == 2 * protocol.LENGTHS[port]
    assert np.isfinite(core.read_encoders(np.array([core.time]))[0]).all()
    assert core.state == (1 if moving else 4)
