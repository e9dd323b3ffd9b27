"""The passive calibration read: what it sends, what it believes, what it says of everything else."""

import socket
import struct
import time
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from live import ARM, KINEMATICS, reply

from lite6jax.controller import protocol, station
from lite6jax.controller.connection import Address, parse_address
from lite6jax.controller.station import SilentError, UncalibratedError, read_calibration
from lite6jax.errors import InputError

READ = bytes.fromhex("00010002000108")


class Dribble(socket.socket):
    """Gives no more than so many bytes at a time, however many are there."""

    at_a_time = 1 << 16

    def recv(self, size, *flags):
        return super().recv(min(size, self.at_a_time), *flags)


def asked(answer, at_a_time=1 << 16, closes=True, seconds=5.0, arm=None):
    """What the reader makes of some bytes, and what it sent."""
    ours, theirs = socket.socketpair()
    near = Dribble(fileno=ours.detach())
    near.at_a_time = at_a_time
    with near, theirs:
        theirs.sendall(answer)
        if closes:
            theirs.shutdown(socket.SHUT_WR)
        try:
            with patch.object(station, "connect", lambda *_: near):
                return read_calibration(Address("10.0.0.7"), arm, seconds)
        finally:
            theirs.setblocking(False)
            assert theirs.recv(4096) == READ


def refused(answer, **options):
    with pytest.raises(InputError) as error:
        asked(answer, **options)
    message = str(error.value)
    assert message.startswith("10.0.0.7: ")
    assert "\n" not in message
    assert ";" in message  # the remedy
    return message


@pytest.mark.parametrize("at_a_time", [1, 2, 7, 8, 178, 4096])
def test_a_reply_is_read_in_whatever_pieces_it_comes(at_a_time):
    read = asked(reply(), at_a_time)
    np.testing.assert_array_equal(read.calibration.kinematics, KINEMATICS)
    assert read.calibration.arm.name == "lite6"
    assert read.calibration.source == "10.0.0.7"
    assert not read.error


def test_no_calibration_is_no_garbage():
    for answer in (
        reply(valid=0),
        reply(status=0x08),
        reply(status=0x48, payload=b""),
        reply(status=0x08, payload=b""),
    ):
        message = refused(answer)
        assert "reports no valid calibration" in message
        assert "firmware" in message
        with pytest.raises(UncalibratedError):
            asked(answer)


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (reply(transaction=2), "transaction 2, protocol 2 to transaction 1, protocol 2"),
        (reply(proto=3), "transaction 1, protocol 3"),
        (reply(register=7), "register 7 to 8"),
        (reply(payload=bytes(100)), "a reply of 102 bytes, not 173"),
        (reply(payload=bytes(1000)), "a reply of 1002 bytes, not 173"),
        (reply(dof=8), "8 joints of type 9"),
        (reply(dof=0), "0 joints of type 9"),
        (struct.pack(">HHH", 1, 2, 0) + bytes(200), "a reply of 0 bytes"),
        (b"SSH-2.0-OpenSSH_9.6\r\n", "53 53 48 2d 32 2e"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "check that the address is the arm's control box"),
    ],
)
def test_an_answer_that_is_none_is_shown(answer, says):
    assert says in refused(answer)


def test_numbers_that_no_arm_has():
    rows = KINEMATICS.copy()
    for value in (np.nan, np.inf, -np.inf):
        rows[3, 4] = value
        assert "joint4 has a number that is not finite" in refused(reply(rows))
    for place, value in (((2, 0), 200.0), ((2, 3), 90.0), ((0, 2), 3e38)):
        rows = KINEMATICS.copy()
        rows[place] = value
        assert "implausible size" in refused(reply(rows))
    rows = KINEMATICS.copy()
    rows[2, 0] += 0.3
    assert "mm RMS from a lite6's" in refused(reply(rows))
    assert "mm RMS from a lite6's" in refused(reply(np.zeros((6, 6))))


def test_a_connection_closed_half_way_says_where():
    whole = reply()
    for count in (0, 1, 5, 6, 7, 8, 90, 178):
        assert f"closed the connection after {count} of 179 bytes" in refused(whole[:count])


def test_silence_and_half_a_silence_are_told_apart():
    with pytest.raises(SilentError, match=r"does not reply.*1\.12\.1"):
        asked(b"", closes=False, seconds=0.05)
    assert "stopped replying after 90 of 179 bytes" in refused(reply()[:90], closes=False, seconds=0.05)


@pytest.mark.parametrize(
    "text", ["", "arm", "192.168.1", "192.168.1.300", "::1", "10.0.0.1:", "10.0.0.1:x", "1.2.3.4:0"]
)
def test_what_is_no_address(text):
    with pytest.raises(InputError, match=r"is not an IPv4 address; .*192\.168\.1\.185"):
        parse_address(text)


# ------------------------------------------------------------------ fuzz

HEADS = st.builds(struct.Struct(">HHH").pack, *[st.integers(0, 3) | st.integers(0, 65535)] * 3)
PAYLOADS = st.builds(
    lambda valid, dof, kind, numbers: bytes([valid, dof, kind]) + np.array(numbers, "<f4").tobytes(),
    st.integers(0, 255),
    st.sampled_from([6, 5, 7]) | st.integers(0, 255),
    st.sampled_from([9, 12]) | st.integers(0, 255),
    st.lists(st.floats(width=32), min_size=0, max_size=44),
)


@st.composite
def damaged(draw):
    """The right reply with some bytes changed, left out, put in, or cut off."""
    message = bytearray(reply())
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(message) - 1) if len(message) else st.just(0))
        kind = draw(st.sampled_from(["set", "drop", "insert", "cut"]))
        if kind == "set" and message:
            message[at] = draw(st.integers(0, 255))
        elif kind == "drop":
            del message[at : at + draw(st.integers(1, 8))]
        elif kind == "insert":
            message[at:at] = draw(st.binary(min_size=1, max_size=8))
        else:
            del message[at:]
    return bytes(message)


ANSWERS = st.one_of(
    damaged(),
    st.binary(max_size=400),
    st.builds(lambda head, rest: head + rest, HEADS, st.binary(max_size=300)),
    st.builds(
        lambda payload, status: reply(payload=payload, status=status), PAYLOADS, st.sampled_from([0, 0x40, 0x08])
    ),
)


@settings(max_examples=500)
@given(ANSWERS, st.sampled_from([1, 3, 1 << 16]))
def test_no_reply_hangs_the_reader_or_escapes_it(answer, at_a_time):
    started = time.monotonic()
    try:
        read = asked(answer, at_a_time)
    except InputError as error:
        message = str(error)
        assert message.startswith("10.0.0.7: ")
        assert message.isprintable()
        assert ";" in message
    else:  # then it is a calibration, and one of this arm
        rows = read.calibration.kinematics
        assert answer[:6] == reply()[:6]
        assert answer[6] == 8
        assert answer[9:11] == bytes([6, 9])
        np.testing.assert_array_equal(rows, protocol.Calibration.decode(answer[8:179]).rows[:6])
        assert np.isfinite(rows).all()
        assert np.abs(rows[:, :3] - ARM.kinematics[:, :3]).max() < 1
    assert time.monotonic() - started < 4
