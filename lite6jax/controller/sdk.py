"""Calls of xarm-python-sdk, in a separate process and with a deadline for each call."""

import json
import math
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax import interruption
from lite6jax.controller.exchange import Address
from lite6jax.errors import InputError
from lite6jax.storage import temporary_folder

CONNECT_SECONDS = 15.0
"""The time limit for starting Python, importing the SDK and connecting."""
CALL_SECONDS = 4.0
"""The time limit of a call; that of the SDK is 2 s."""

WORKER = Path(__file__).with_name("sdk_worker.py")

_CODES = {
    -1: "the connection is lost",
    3: "no answer within 2 s",
    4: "an answer of the wrong length",
    5: "an answer to another request",
    6: "an answer in another protocol",
    7: "an answer of another register",
    8: "the connection is lost",
    10: "the controller calls it invalid",
}


class SdkError(InputError):
    """The connection of the SDK has failed; a new one may succeed."""


class Pose(NamedTuple):
    """A pose computed by the controller, `(6,)` x y z roll pitch yaw in mm and rad, or the reason for its refusal."""

    values: NDArray[np.floating] | None
    refusal: str = ""


class Sdk:
    """A connection of the SDK, made by `connected`.

    Attributes:
        version: the content of register 1, such as `6,9,LI1006,DL1000,v2.7.1`.
    """

    def __init__(self, process: "subprocess.Popen[str]", where: str) -> None:
        self._process, self._where = process, where
        self._answers: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()
        self.version = ""

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._answers.put(line)
        self._answers.put(None)

    def wait_connected(self, seconds: float) -> None:
        """Waits until the SDK has connected.

        Raises:
            InputError: no connection within `seconds`, or an error of the SDK.
        """
        reply = self._answer(seconds, f"did not connect within {seconds:g} s, as with a silent controller")
        self.version = str(reply["version"])

    def forward_kinematics(self, joints: ArrayLike, seconds: float = CALL_SECONDS) -> Pose:
        """The pose of the flange, or of the tool if one is set, that the controller computes at joints `(joint,)` rad.

        Raises:
            SdkError: the connection is lost, or there is no reply within `seconds`.
        """
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps([float(q) for q in np.asarray(joints)]) + "\n")
            self._process.stdin.flush()
        except OSError as error:
            raise self._failure("has ended") from error
        code, pose = self._answer(seconds, f"gave no answer within {seconds:g} s")
        if code in (-1, 3, 8):
            raise self._failure(f"says: {_CODES[code]}")
        if code != 0:
            return Pose(None, str(pose) if code is None else _CODES.get(code, f"code {code}"))
        if not isinstance(pose, list) or len(pose) != 6 or not all(isinstance(v, float | int) for v in pose):
            return Pose(None, f"{pose!r:.40} for a pose")
        if not all(map(math.isfinite, pose)):
            return Pose(None, "a pose that is not finite")
        return Pose(np.array(pose, float))

    def _answer(self, seconds: float, late: str) -> Any:
        try:
            line = self._answers.get(timeout=seconds)
        except queue.Empty:
            raise self._failure(late) from None
        if line is None:
            raise self._failure("has ended")
        reply = json.loads(line)
        if isinstance(reply, dict) and "error" in reply:
            if reply.get("missing"):
                raise InputError(
                    f"xarm-python-sdk cannot be imported ({reply['error']}); pip install 'xarm-python-sdk>=1.18'"
                )
            raise self._failure(f"says: {reply['error']}")
        return reply

    def _failure(self, what: str) -> SdkError:
        return SdkError(
            f"{self._where}: the SDK's connection {what}; end other programs connected to the arm, check the network, "
            "and try again"
        )


@contextmanager
def connected(address: Address, seconds: float = CONNECT_SECONDS) -> Iterator[Sdk]:
    """A read-only connection of the SDK to a controller: requests that change anything are blocked.

    The SDK runs in a separate process, which is killed at the end, even if it waits. Its output is discarded and its
    log folder removed.

    Raises:
        SdkError: no connection within `seconds`.
        InputError: the SDK is not installed.
    """
    with temporary_folder() as home:
        process = subprocess.Popen(
            # -P: the modules in the worker's folder must not be importable by the SDK
            [sys.executable, "-P", str(WORKER), address.host, str(address.port), str(home)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        try:
            with interruption.undone(process.kill):
                sdk = Sdk(process, str(address))
                sdk.wait_connected(seconds)
                yield sdk
        finally:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                assert pipe is not None
                with suppress(OSError):  # unsent data
                    pipe.close()
