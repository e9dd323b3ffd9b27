"""The one place that asks xarm-python-sdk: in a process of its own, each call under a deadline of ours."""

import json
import math
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.controller.exchange import Address
from lite6jax.errors import InputError

CONNECT_SECONDS = 15.0
"""For the start of Python, the import of the SDK, and its connection."""
CALL_SECONDS = 4.0
"""For one call; the SDK itself gives up after 2 s."""

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
    """The SDK's connection is of no use any more; a new one may be."""


class Pose(NamedTuple):
    """What the controller computes for joints: `(6,)` x y z roll pitch yaw in mm and rad, or why it does not."""

    values: NDArray[np.floating] | None
    refusal: str = ""


class Sdk:
    """A connection that the SDK holds; `connected` makes one.

    Attributes:
        version: what register 1 says, such as `6,9,LI1006,DL1000,v2.7.1`.
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

    def greet(self, seconds: float) -> None:
        """Waits until the SDK has connected.

        Raises:
            InputError: it did not within `seconds`, or says why not.
        """
        said = self._answer(seconds, f"did not connect within {seconds:g} s, as with a silent controller")
        self.version = str(said["version"])

    def forward_kinematics(self, joints: ArrayLike, seconds: float = CALL_SECONDS) -> Pose:
        """The controller's flange, or tool where one is set, at joints `(joint,)` in rad.

        Raises:
            SdkError: the connection is lost, or there is no answer within `seconds`.
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
        said = json.loads(line)
        if isinstance(said, dict) and "error" in said:
            if said.get("missing"):
                raise InputError(
                    f"xarm-python-sdk cannot be imported ({said['error']}); pip install 'xarm-python-sdk>=1.18'"
                )
            raise self._failure(f"says: {said['error']}")
        return said

    def _failure(self, what: str) -> SdkError:
        return SdkError(
            f"{self._where}: the SDK's connection {what}; end other programs that hold the arm, check the network, and "
            "try again"
        )


@contextmanager
def connected(address: Address, seconds: float = CONNECT_SECONDS) -> Iterator[Sdk]:
    """The SDK connected to a controller, for reading only: no register that changes anything can be sent.

    The SDK runs in a process of its own, which is ended on leaving, whatever it waits for; nothing that it prints is
    seen, and its log folder goes with it.

    Raises:
        SdkError: it does not connect within `seconds`.
        InputError: the SDK is not installed.
    """
    with tempfile.TemporaryDirectory(prefix="lite6jax-") as home:
        process = subprocess.Popen(
            # -P: the folder of the worker holds modules that are none of the SDK's business
            [sys.executable, "-P", str(WORKER), address.host, str(address.port), home],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        try:
            sdk = Sdk(process, str(address))
            sdk.greet(seconds)
            yield sdk
        finally:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                assert pipe is not None
                with suppress(OSError):  # what was not yet sent
                    pipe.close()
