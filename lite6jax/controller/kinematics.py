"""Poses that a controller computes for given joints, and whether they are those of its calibration."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.description import bundled_arms, load_bundled
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.arms.frames import compare_transforms
from lite6jax.controller import protocol
from lite6jax.controller.connection import Address, ControlPort
from lite6jax.controller.protocol import Register, Status
from lite6jax.controller.station import Condition, read_condition
from lite6jax.errors import InputError

Array = NDArray[np.floating]
Pose = Array | str
"""`(6,)` x y z roll pitch yaw in mm and rad, or the reason why the controller refuses the joint positions."""

RETRY_S = 0.5
TRIES = 5
"""The number of consecutive connections without a pose after which the requests end."""


def compute_poses(
    address: Address,
    joints: Array,
    stop: threading.Event | None = None,
    advance: Callable[[int], object] = lambda row: None,
) -> tuple[list[Pose], str, str]:
    """Has the controller compute the poses at joint positions `(sample, joint)` rad, without a move.

    The poses are of the flange, or of the tool if one is set. After a lost connection the row is requested again, over
    a new one.

    Args:
        address: of the controller.
        joints: the joint positions.
        stop: ends the requests when set, from any thread.
        advance: called with the index of each row that is answered.

    Returns:
        the poses as far as there was an answer, why there is none for the others, and the content of register 1.
    """
    stop = stop or threading.Event()
    poses: list[Pose] = []
    failure, version, tries = "", "", 0
    while len(poses) < len(joints) and not stop.is_set():
        tries += 1
        try:
            with ControlPort(address) as port:
                version = (
                    port.ask(Register.VERSION, protocol.TEXT_PAYLOAD).body[1:].rstrip(b"\0").decode("ascii", "replace")
                )
                while len(poses) < len(joints) and not stop.is_set():
                    request = protocol.encode_floats(protocol.pad_joints(joints[len(poses)]))
                    poses.append(_read_pose(port.ask(Register.FORWARD_KINEMATICS, 4 * 6, request)))
                    tries, failure = 0, ""
                    advance(len(poses) - 1)
        except InputError as error:
            failure = str(error)
            if not poses or tries == TRIES:
                break
            stop.wait(RETRY_S)
    return poses, failure, version


def _read_pose(reply: protocol.Frame) -> Pose:
    if reply.body[0] & Status.INVALID:
        return "the controller calls it invalid"
    pose = protocol.read_floats(reply.body[1:], 6)
    return pose if np.isfinite(pose).all() else "a pose that is not finite"


# ------------------------------------------------------------------ verification

GATE_M = 1e-6
"""m; a larger difference is significant."""
GATE_RAD = 2e-6
"""rad; a larger difference is significant. Rounding to 32 bits causes up to 6e-7."""
FLOOR_M = 1.2e-7
"""m, the largest difference of equal chains by rounding to 32 bits."""


@dataclass(frozen=True, eq=False)
class Verification:
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
        version: of the controller, its register 1.
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
        """Whether all differences are below `GATE_M` and `GATE_RAD`."""
        return _agree(self.position, self.orientation)


def verify(
    calibration: FactoryCalibration,
    address: Address,
    samples: int = 1000,
    seed: int = 0,
    advance: Callable[[int], object] = lambda done: None,
) -> Verification:
    """Compares a calibration's chain with the forward kinematics of the controller.

    The tool offset is read from a report. It must agree with the forward kinematics at the current joint positions.

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
    here = condition.joint_position[: arm.dof]
    answers, failure, version = compute_poses(address, np.vstack([here, q]), None, lambda row: row and advance(1))
    for joints, answer in zip((here, *q), answers, strict=False):
        if isinstance(answer, str):
            shown = " ".join(f"{value:.1f}" for value in np.degrees(joints))
            raise InputError(
                f"{address}: the controller's forward kinematics at {shown} deg gives {answer}; read again, and "
                "update the firmware if it persists"
            )
    if failure:
        raise InputError(failure)
    at_rest, *_ = computed = protocol.read_pose(np.array(answers))
    computed = computed[1:]

    links, q_sent = frames.transform_from_row(calibration.kinematics), protocol.round_floats(q)
    tools = {"none": np.eye(4)}
    if condition.has_tool:
        tools = {"applied": condition.T_flange_tool, "omitted by the controller": np.eye(4)}
    at_rest_expected = frames.chain(links, here)
    agreement = {name: np.array(compare_transforms(at_rest_expected @ T, at_rest)) for name, T in tools.items()}
    tool = min(agreement, key=lambda name: agreement[name] @ [1.0, 0.1])
    expected = frames.chain(links, q_sent) @ tools[tool]
    position, orientation = compare_transforms(expected, computed)
    other_chain = offset = None
    if not _agree(position, orientation):
        offset = find_offset(expected, computed)
        for other in map(load_bundled, bundled_arms()):
            if other.dof == arm.dof and other_chain is None:
                poses = frames.chain(other.links, q_sent) @ tools[tool]
                other_chain = other.name if _agree(*compare_transforms(poses, computed)) else None
    return Verification(
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
    return protocol.encode_pose(mean) if _agree(*compare_transforms(expected @ mean, computed)) else None


def _agree(position: Array, orientation: Array) -> bool:
    return bool(position.max() <= GATE_M and orientation.max() <= GATE_RAD)
