"""Runs xarm-python-sdk in a separate process and blocks every request to the arm except reads.

Importing the SDK prints, sets a socket timeout for the whole process and creates a folder in the home directory. Its
connection may clear the controller's warnings (register 17) and may wait minutes for a controller that does not reply.
This process has no terminal, its home is a temporary folder of its parent, and the parent can kill it.

It imports nothing of this package and writes lines of JSON: first the connected controller or `{"error": …}`, then for
each line of joints (rad) on stdin `[code, result]`, the result being a pose (mm, rad) if the code is 0.
"""

import json
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

READS = (1, 13, 14, 15, 44)
"""The permitted registers, which are read only: version, state, commands waiting, errors, forward kinematics."""


def allow_reads(write: Callable[[Any, bytes], int], refused: list[int]) -> Callable[[Any, bytes], int]:
    """The SDK's write function, of a port and bytes, restricted to `READS`; `refused` receives the other registers."""

    def guarded(port: Any, data: bytes) -> int:
        if len(data) > 6 and data[6] in READS and data[2] == 0 and data[3] in (2, 3):
            return write(port, data)
        refused.append(data[6] if len(data) > 6 else -1)
        return -1

    return guarded


def serve(host: str, port: int, home: str) -> None:
    """Connects, then replies to every line of joints on stdin."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the SDK prints

    def answer(value: object) -> None:
        answers.write(json.dumps(value) + "\n")

    os.environ["HOME"] = os.environ["USERPROFILE"] = home
    refused: list[int] = []
    try:
        from xarm.core.comm.base import Port
        from xarm.core.config.x_config import XCONF
        from xarm.wrapper import XArmAPI

        setattr(XCONF.SocketConf, "TCP_CONTROL_PORT", port)  # noqa: B010 (typed as the constant 502)
        setattr(Port, "write", allow_reads(Port.write, refused))  # noqa: B010 (its own type is narrower)
        # Without reports, connecting would clear the controller's warnings. With Unix domain sockets permitted, the SDK
        # would connect to another program's socket in /tmp instead of the arm.
        arm = XArmAPI(host, is_radian=True, enable_report=True, forbid_uds=True)
        answer({"version": arm.version, "axis": arm.axis, "type": arm.device_type})
    except Exception as error:
        return answer({"error": f"{type(error).__name__}: {error}", "missing": isinstance(error, ImportError)})
    for line in sys.stdin:
        try:
            code, pose = arm.get_forward_kinematics(json.loads(line), input_is_radian=True, return_is_radian=True)
        except Exception as error:  # a short payload is a ValueError
            code = None
            pose = f"{type(error).__name__}: {error}"
        if refused:
            return answer({"error": f"the SDK requested register {refused[0]}, which was blocked"})
        answer([code, pose])


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles interrupts
    serve(sys.argv[1], int(sys.argv[2]), sys.argv[3])
    sys.stdout.flush()
    os._exit(0)  # its threads would wait for the controller
