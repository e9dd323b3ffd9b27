"""Poses that a controller computes, through xarm-python-sdk in a separate process; whether they are a calibration's."""

import json
import math
import queue
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lite6jax import interruption
from lite6jax.arms import frames
from lite6jax.arms.description import bundled_arms, load_bundled
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.arms.frames import compare_transforms
from lite6jax.array_types import Array
from lite6jax.controller import protocol
from lite6jax.controller.connection import Address
from lite6jax.controller.station import Condition, read_condition
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


Pose = Array | str
"""`(6,)` x y z roll pitch yaw in mm and rad, or the reason why the controller refuses the joint positions."""


def compute_poses(
    address: Address,
    joints: Array,
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
    sdk = None
    failure = ""
    version = ""
    tries = 0
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
                sdk = None
                failure = str(error)
                if not poses or tries == TRIES:
                    break
                stop.wait(RETRY_S)
            else:
                tries = 0
                failure = ""
                advance(len(poses) - 1)
    return poses, failure, version


class Sdk:
    """A connection of the SDK, made by `connect_sdk`; `version` is the content of register 1."""

    def __init__(self, process: "subprocess.Popen[str]", where: str, seconds: float) -> None:
        self._process = process
        self._where = where
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
            if code is None:
                return str(pose)
            return _CODES.get(code, f"code {code}")
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

    def _failure(self, trouble: str) -> SdkError:
        return SdkError(
            f"{self._where}: the SDK's connection {trouble}; end other programs connected to the arm, check the "
            "network, and try again"
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


# ------------------------------------------------------------------ verification


GATE_M = 1e-6
"""m; a larger difference is significant."""
GATE_RAD = 2e-6
"""rad; a larger difference is significant. Rounding to 32 bits causes up to 6e-7."""
FLOOR_M = 1.2e-7
"""m, the largest difference of equal chains by rounding to 32 bits."""


@dataclass(frozen=True, eq=False)
class KinematicsCheck:
    """The differences between the controller's forward kinematics and the calibration's.

    Attributes:
        joint_position: `(sample, joint)` rad, drawn within the limits.
        position: `(sample,)` m, the distance at the joint positions as sent, rounded to 32 bits.
        orientation: `(sample,)` rad, the angle likewise.
        position_unrounded: `(sample,)` m, the distance with the chain at the joint positions before rounding.
        orientation_unrounded: `(sample,)` rad, the angle likewise.
        condition: from the report before the comparison.
        tool: how the tool offset enters: "none", "applied" or "omitted by the controller".
        tool_agrees: `(2,)` m and rad, the difference at the current joint positions, with that tool.
        hidden_tool: `(6,)` x y z roll pitch yaw in mm and rad of a tool offset that the report omits and that
            explains the difference; or None.
        other_chain: the bundled arm whose nominal chain the controller uses instead; or None.
        version: of the controller, from the SDK.
    """

    joint_position: Array
    position: Array
    orientation: Array
    position_unrounded: Array
    orientation_unrounded: Array
    condition: Condition
    tool: str
    tool_agrees: Array
    hidden_tool: Array | None
    other_chain: str | None
    version: str

    @property
    def passed(self) -> bool:
        """Tells whether all differences are below `GATE_M` and `GATE_RAD`."""
        return _agree(self.position, self.orientation)


def verify(
    calibration: FactoryCalibration,
    address: Address,
    samples: int = 1000,
    seed: int = 0,
    advance: Callable[[int], object] = lambda done: None,
) -> KinematicsCheck:
    """Compares a calibration's chain with the SDK's `get_forward_kinematics`.

    The tool offset is read from a report, because the cache of the SDK is zero until the first one. It must agree with
    the forward kinematics at the current joint positions.

    Args:
        calibration: from the same controller.
        address: of the controller.
        samples: the number of joint positions, drawn within the limits of the arm.
        seed: of the drawing.
        advance: called with 1 after each joint position.

    Raises:
        InputError: no report, a controller in error, a failed connection, or no pose.
    """
    if samples < 1:
        raise InputError(f"--fk-samples {samples}: give one or more")
    arm = calibration.arm
    limits = np.where(np.isfinite(arm.joint_limits), arm.joint_limits, [-np.pi, np.pi])
    q = np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (samples, arm.dof))
    condition = read_condition(address)
    if condition.error:
        raise InputError(
            f"{address}: the controller reports error {condition.error}, during which its tool offset is "
            "unreliable; clear the error with the vendor's program, and try again"
        )
    present_position = condition.joint_position[: arm.dof]
    answers, failure, version = compute_poses(
        address, np.vstack([present_position, q]), None, lambda row: row and advance(1)
    )
    for joints, answer in zip((present_position, *q), answers, strict=False):
        if isinstance(answer, str):
            shown = " ".join(f"{value:.1f}" for value in np.degrees(joints))
            raise InputError(
                f"{address}: the SDK's forward kinematics at {shown} deg gives {answer}; read again, and check "
                "that the firmware fits the SDK"
            )
    if failure:
        raise InputError(failure)
    at_rest, *_ = computed = protocol.read_pose(np.array(answers))
    computed = computed[1:]

    links = frames.transform_from_row(calibration.kinematics)
    q_sent = protocol.round_floats(q)
    tools = {"none": np.eye(4)}
    if condition.has_tool:
        tools = {"applied": condition.T_flange_tool, "omitted by the controller": np.eye(4)}
    at_rest_expected = frames.chain(links, present_position)
    agreement = {name: np.array(compare_transforms(at_rest_expected @ T, at_rest)) for name, T in tools.items()}
    tool = min(agreement, key=lambda name: agreement[name] @ [1.0, 0.1])
    expected = frames.chain(links, q_sent) @ tools[tool]
    position, orientation = compare_transforms(expected, computed)
    other_chain = offset = None
    if not _agree(position, orientation):
        offset = find_offset(expected, computed)
        for candidate in map(load_bundled, bundled_arms()):
            if candidate.dof == arm.dof and other_chain is None:
                poses = frames.chain(candidate.links, q_sent) @ tools[tool]
                other_chain = None
                if _agree(*compare_transforms(poses, computed)):
                    other_chain = candidate.name
    return KinematicsCheck(
        q,
        position,
        orientation,
        *compare_transforms(frames.chain(links, q) @ tools[tool], computed),
        condition=condition,
        tool=tool,
        tool_agrees=agreement[tool],
        hidden_tool=offset,
        other_chain=other_chain,
        version=version,
    )


def find_offset(expected: Array, computed: Array) -> Array | None:
    """`(6,)` mm and rad, the constant transform after the flange that explains the difference between `(sample, 4, 4)`
    poses by the calibration and by the controller; None if there is none."""
    if len(expected) < 3:
        return None
    mean = (np.linalg.inv(expected) @ computed).mean(axis=0)
    U, _, Vt = np.linalg.svd(mean[:3, :3])
    mean[:3, :3] = U @ Vt
    if _agree(*compare_transforms(expected @ mean, computed)):
        return protocol.encode_pose(mean)
    return None


def _agree(position: Array, orientation: Array) -> bool:
    return bool(position.max() <= GATE_M and orientation.max() <= GATE_RAD)
