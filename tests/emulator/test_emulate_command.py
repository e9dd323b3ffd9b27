"""`lite6jax emulate` as it is typed."""

import os
import re
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest
from live import new_host
from typed import flat, refused, run

from lite6jax.arms.description import load_bundled
from lite6jax.arms.factory import write_factory
from lite6jax.controller import protocol
from tests.oracles import sliding_arms

PORT = "15020"


def emulate(capsys, *arguments, width=80):
    return run(
        capsys, "emulate", "--address", new_host(), "--control-port", PORT, "--duration", "0.05", *arguments,
        width=width,
    )  # fmt: skip


def test_it_says_where_it_listens_and_what_is_hidden(capsys):
    code, out, err = emulate(
        capsys, "--motion", "sines", "--effect", "joint_backlash:joint=4,gap_rad=1e-3", "--fault", "latency:0.1",
        "--speed", "2", "--seed", "3",
    )  # fmt: skip
    assert (code, err) == (0, "")
    said = flat(out)
    assert re.search(r"An emulated lite6 at 127\.[\d.]+: control port 15020, reports on 30000 to 30003\.", said)
    assert "Calibration: as drawn. Motion: sines. Its clock runs 2 times as fast." in said
    assert "joint_backlash at joint4: gap_rad = 0.001" in said
    assert "Faults: latency:0.1." in said
    assert "XCONF.SocketConf.TCP_CONTROL_PORT = 15020" in said
    assert "Stop with Ctrl-C." in said


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--address", "192.168.1.2"], "192.168.1.2: is not on loopback"),
        (["--address", "here"], "--address 'here': is not an address; write it like 127.0.0.1"),
        (["--arms", "0"], "--arms 0: give 1 to 32"),
        (["--arms", "3", "--factory", "a.yaml"], "--factory: 1 files for 3 arms; give one for each, or none"),
        (["--factory", "absent.yaml"], "absent.yaml"),
        (["--motion", "dance"], "--motion 'dance': is neither rest, sines, poses nor a recording's file"),
        (["--effect", "nothing"], "nothing"),
        (["--duration", "0"], "--duration 0.0: give seconds above 0"),
        (["--payload", "-1"], "--payload -1.0: give kg, 0 or more"),
    ],
)
def test_what_is_refused(capsys, arguments, message):
    assert message in refused(capsys, "emulate", "--control-port", PORT, "--duration", "0.05", *arguments)


def test_a_prismatic_joint_is_refused_and_the_chain_without_it_is_not(capsys, tmp_path):
    (tmp_path / "rail.urdf").write_text(sliding_arms.ARMS["rail"])
    said = refused(capsys, "emulate", "--arm", tmp_path / "rail.urdf", "--control-port", PORT, "--duration", "0.05")
    assert said.startswith("arm: joint 1 is prismatic, and a UFACTORY controller drives revolute joints (its linear")
    assert said.endswith("or make recordings of the whole arm with `lite6jax simulate`")
    code, out, _ = emulate(capsys, "--arm", f"{tmp_path}/rail.urdf#l1:tool", width=200)
    assert code == 0
    assert "An emulated arm at" in out


def test_ctrl_c_ends_it(tmp_path):
    """As a process of its own, with a calibration that is read back from it, and exit code 130."""
    arm, address = load_bundled("lite6"), new_host()
    own = (arm.kinematics + 1e-3).astype(np.float32).astype(float)
    file = write_factory(own, tmp_path / "arm.yaml")
    command = [sys.executable, "-m", "lite6jax.cli", "emulate", "--factory", str(file), "--address", address]
    process = subprocess.Popen(
        [*command, "--control-port", PORT], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )  # fmt: skip
    assert process.stdout is not None
    lines = []
    while not lines or not lines[-1].startswith("Stop with"):
        lines.append(process.stdout.readline())
        assert lines[-1], process.communicate()
    with socket.create_connection((address, int(PORT)), timeout=10) as line:
        line.sendall(protocol.Message(8).encode())
        received = bytearray()
        while len(received) < protocol.CALIBRATION_REPLY:
            received += line.recv(1024)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    (frame,) = protocol.take_frames(received)
    np.testing.assert_array_equal(protocol.Calibration.decode(frame.body[1:]).rows[:6], own)
    assert (process.returncode, out) == (130, "")
    assert err == "interrupted: nothing is left half-written\n"
