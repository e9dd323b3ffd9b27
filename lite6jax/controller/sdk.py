"""Poses that a controller computes, through xarm-python-sdk in a separate process and with a deadline for each call."""

import json
import math
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax import interruption
from lite6jax.controller.connection import Address
from lite6jax.errors import InputError
from lite6jax.storage import temporary_folder

CONNECT_SECONDS = 15.0
"""The time limit for starting Python, importing the SDK and connecting."""
CALL_SECONDS = 4.0
"""The time limit of a call; that of the SDK is 2 s."""
RETRY_S = 0.5
TRIES = 5
"""The number of consecutive connections without a pose after which the requests end."""

_CODES = {
    -1: "the connection is lost", 3: "no answer within 2 s", 4: "an answer of the wrong length",
    5: "an answer to another request", 6: "an answer in another protocol", 7: "an answer of another register",
    8: "the connection is lost", 10: "the controller calls it invalid",
}  # fmt: skip
"""Of the SDK."""


class SdkError(InputError):
    """The connection of the SDK has failed; a new one may succeed."""


Pose = NDArray[np.floating] | str
"""`(6,)` x y z roll pitch yaw in mm and rad, or the reason why the controller refuses the joint positions."""


def compute_poses(
    address: Address,
    joints: NDArray[np.floating],
    stop: threading.Event | None = None,
    advance: Callable[[int], object] = lambda row: None,
) -> tuple[list[Pose], str, str]:
    """Has the controller compute the poses at joint positions `(sample, joint)` rad, without a move.

    After a lost connection the row is requested again, over a new one.

    Args:
        address: of the controller.
        joints: the joint positions.
        stop: ends the requests when set, from any thread.
        advance: called with the index of each row that is answered.

    Returns:
        the poses as far as there was an answer, why there is none for the others, and the version of the controller.

    Raises:
        InputError: the SDK is not installed.
    """
    stop = stop or threading.Event()
    poses: list[Pose] = []
    sdk, failure, version, tries = None, "", "", 0
    with ExitStack() as connection:
        while len(poses) < len(joints) and not stop.is_set():
            try:
                if sdk is None:
                    tries += 1
                    sdk = connection.enter_context(connect_sdk(address))
                    version = sdk.version
                poses.append(sdk.forward_kinematics(joints[len(poses)]))
            except SdkError as error:
                connection.close()
                sdk, failure = None, str(error)
                if not poses or tries == TRIES:
                    break
                stop.wait(RETRY_S)
            else:
                tries, failure = 0, ""
                advance(len(poses) - 1)
    return poses, failure, version


class Sdk:
    """A connection of the SDK, made by `connect_sdk`; `version` is the content of register 1."""

    def __init__(self, process: "subprocess.Popen[str]", where: str, seconds: float) -> None:
        self._process, self._where = process, where
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._listen, daemon=True).start()
        late = f"did not connect within {seconds:g} s, as with a silent controller"
        self.version = str(self._answer(seconds, late)["version"])

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
            return str(pose) if code is None else _CODES.get(code, f"code {code}")
        if not isinstance(pose, list) or len(pose) != 6 or not all(isinstance(v, float | int) for v in pose):
            return f"{pose!r:.40} for a pose"
        if not all(map(math.isfinite, pose)):
            return "a pose that is not finite"
        return np.array(pose, float)

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._answers.put(line)
        self._answers.put("")

    def _answer(self, seconds: float, late: str) -> Any:
        try:
            line = self._answers.get(timeout=seconds)
        except queue.Empty:
            raise self._failure(late) from None
        if not line:
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
def connect_sdk(address: Address, seconds: float = CONNECT_SECONDS) -> Iterator[Sdk]:
    """A read-only connection of the SDK to a controller: requests that change anything are blocked.

    The SDK runs in a separate process, which is killed at the end, even if it waits. Its output is discarded and its
    log folder removed.

    Raises:
        SdkError: no connection within `seconds`.
        InputError: the SDK is not installed.
    """
    worker = Path(__file__).with_name("sdk_worker.py")
    with temporary_folder() as home:
        process = subprocess.Popen(
            # -P: the modules in the worker's folder must not be importable by the SDK
            [sys.executable, "-P", str(worker), address.host, str(address.port), str(home)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        try:
            with interruption.undone(process.kill):
                yield Sdk(process, str(address), seconds)
        finally:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                assert pipe is not None
                with suppress(OSError):  # unsent data
                    pipe.close()
