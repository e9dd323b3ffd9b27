"""The vendor's SDK: what it sends, and that its noise, its timeouts and its traps stay where they are."""

import os
import socket
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from live import emulated, new_host, serving, snapshot

from lite6jax.controller import protocol
from lite6jax.controller.connection import Address
from lite6jax.controller.sdk import SdkError, connect_sdk
from lite6jax.controller.sdk_worker import READS, allow_reads
from lite6jax.emulator import Faults
from lite6jax.errors import InputError

Q = np.array([0.3, -0.4, 1.2, 0.5, -0.6, 0.7])
CHANGES = (11, 12, 16, 17, 19, 23, 24, 25, 29, 31, 35, 36, 40)
"""Motion enable, set state, clear error and warning, set mode, moves, tool, payload, save."""


def recording_proxy(target, sent):
    """Passes bytes on between the SDK and a controller, and keeps what the SDK sends."""

    def answer(connection):
        with socket.create_connection((target.host, target.port), timeout=30) as onward:

            def back():
                try:
                    while piece := onward.recv(4096):
                        connection.sendall(piece)
                except OSError:
                    pass

            threading.Thread(target=back, daemon=True).start()
            while piece := connection.recv(4096):
                sent.extend(piece)
                onward.sendall(piece)

    return serving(answer)


def test_the_registers_that_the_sdk_sends_are_these_and_no_others():
    sent = bytearray()
    with emulated(faults=Faults(warning=11)) as (controller, address), recording_proxy(address, sent) as between:
        before = snapshot(controller)
        with connect_sdk(between) as sdk:
            for _ in range(3):
                sdk.forward_kinematics(Q)
            time.sleep(1.2)  # its threads wake up every half second
        seen = snapshot(controller)
    frames = list(protocol.take_frames(sent))
    assert not sent
    assert [frame.register for frame in frames] == [1, 44, 44, 44]
    assert {frame.protocol for frame in frames} <= {2, 3}
    assert frames[0].body == b""
    np.testing.assert_array_equal(np.frombuffer(frames[1].body, "<f4")[:6], Q.astype(np.float32))
    assert seen.requests == {1: 1, 44: 3}
    assert seen.state == before.state
    np.testing.assert_array_equal(seen.joints, before.joints)


def test_it_asks_for_what_it_may_and_nothing_that_changes_the_arm():
    assert not set(READS) & set(CHANGES)
    sent, refused = [], []
    write = allow_reads(lambda port, data: sent.append(data) or 0, refused)
    for register in range(256):
        frame = protocol.Message(register).encode()
        assert write(None, frame) == (0 if register in READS else -1)
    assert {data[6] for data in sent} == set(READS)
    assert set(refused) == set(range(256)) - set(READS)
    assert write(None, b"\x00") == -1
    assert write(None, bytes([0, 0, 0, 1, 0, 2, 0, 0])) == -1  # the SDK's heartbeat
    assert write(None, protocol.Message(44, protocol=0).encode()) == -1  # Modbus: 44 means something else there


def test_the_way_out_is_shut_for_the_real_sdk(tmp_path):
    """Without it, connecting with the report off clears the controller's warnings, and motion_enable enables."""
    program = textwrap.dedent("""
        import os, runpy, sys
        worker = runpy.run_path(sys.argv[3], run_name="worker")
        from xarm.core.comm.base import Port
        from xarm.core.config.x_config import XCONF
        from xarm.wrapper import XArmAPI
        XCONF.SocketConf.TCP_CONTROL_PORT = int(sys.argv[2])
        refused = []
        if sys.argv[4] == "shut":
            Port.write = worker["allow_reads"](Port.write, refused)
        arm = XArmAPI(sys.argv[1], enable_report=False, forbid_uds=True)
        arm.motion_enable(True)
        arm.set_mode(0)
        arm.set_state(0)
        arm.clean_error()
        os._exit(0)
    """)
    worker = Path(__file__).parents[2] / "lite6jax/controller/sdk_worker.py"
    asked = {}
    for way in ("open", "shut"):
        with emulated(faults=Faults(warning=11)) as (controller, address):
            command = [sys.executable, "-P", "-c", program, address.host, str(address.port), str(worker), way]
            environment = {**os.environ, "HOME": str(tmp_path)}
            subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL, timeout=60)
            asked[way] = set(snapshot(controller).requests)
    assert {11, 12, 16, 17, 19} <= asked["open"]
    assert {1, 15} <= asked["shut"] <= set(READS)


def test_nothing_of_the_sdk_is_seen_heard_or_left_behind(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    with emulated() as (_, address), connect_sdk(address) as sdk:
        assert sdk.version == "6,9,LI1006,DL1000,v2.7.1"
        assert len(sdk.forward_kinematics(Q)) == 6
    assert list(tmp_path.iterdir()) == []
    assert socket.getdefaulttimeout() is None
    assert capfd.readouterr() == ("", "")


def test_a_controller_that_says_nothing_ends_at_our_deadline_not_after_212_s():
    with emulated(faults=Faults(silent=frozenset({1}))) as (_, address):
        started = time.monotonic()
        says = r"did not connect within 2 s, as with a silent controller; end other"
        with pytest.raises(SdkError, match=says), connect_sdk(address, seconds=2.0):
            pass
        assert time.monotonic() - started < 8


def test_without_the_sdk_it_says_what_to_install(monkeypatch, tmp_path):
    (tmp_path / "xarm.py").write_text("raise ImportError('no xarm here')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    says = r"cannot be imported \(.*no xarm here\); pip install 'xarm-python-sdk>=1.18'"
    with pytest.raises(InputError, match=says), connect_sdk(Address(new_host(), 1)):
        pass


@pytest.mark.parametrize(
    ("payload", "status", "says"),
    [
        (bytes(10), 0, "Error"),
        (b"", 0, "Error"),
        (np.full(6, np.nan, "<f4").tobytes(), 0, "not finite"),
        (np.ones(6, "<f4").tobytes(), 0x08, "the controller calls it invalid"),
    ],
)
def test_a_pose_that_is_none_is_refused_and_the_next_is_asked(payload, status, says):
    identity = protocol.Identity(6, 9, "LI1006", "DL1000", (2, 7, 1)).encode()

    def answer(connection):
        received, count = bytearray(), 0
        while piece := connection.recv(4096):
            received += piece
            for frame in protocol.take_frames(received):
                count += frame.register == 44
                if frame.register == 1:
                    connection.sendall(frame.reply(identity).encode())
                elif count == 1:
                    connection.sendall(frame.reply(payload, status).encode())
                else:
                    connection.sendall(frame.reply(np.arange(6, dtype="<f4").tobytes()).encode())

    with serving(answer) as address, connect_sdk(address) as sdk:
        pose = sdk.forward_kinematics(Q)
        assert isinstance(pose, str)
        assert says in pose
        np.testing.assert_array_equal(sdk.forward_kinematics(Q), np.arange(6))
