"""Whether a calibration is what the controller computes with: its forward kinematics beside ours, joint for joint."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.bundled import bundled_arms, load_bundled
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.controller import protocol
from lite6jax.controller.condition import Condition, read_condition, require_no_error
from lite6jax.controller.exchange import Address
from lite6jax.controller.sdk import Sdk, connected
from lite6jax.errors import InputError

Array = NDArray[np.floating]

GATE_M = 1e-6
"""A difference above 1e-3 mm is real."""
GATE_RAD = 2e-6
"""So is one above this; 32-bit numbers on the wire make up to 6e-7."""
FLOOR_M = 1.2e-7
"""What 32-bit numbers on the wire make of a chain that is right, at most."""


@dataclass(frozen=True, eq=False)
class Verification:
    """The controller's forward kinematics beside the calibration's.

    Attributes:
        joint_position: `(sample, joint)` rad, drawn inside the limits.
        position: `(sample,)` m, the distance between both, at the joints as they were sent: 32-bit numbers.
        orientation: `(sample,)` rad, the angle between both, likewise.
        position_as_asked: `(sample,)` m, the distance from our chain at the joints before they were rounded.
        orientation_as_asked: `(sample,)` rad, the angle likewise.
        condition: what the report said when it began.
        tool: how the tool offset enters: "none", "taken into account" or "left out by the controller".
        tool_agrees: `(2,)` m and rad, by how much both differ at the joints where the arm stands, with that tool.
        hidden_tool: `(6,)` x y z roll pitch yaw in mm and rad of a tool that no report shows, but which makes up the
            whole difference; or None.
        other_chain: the bundled arm whose nominal chain the controller computes with instead; or None.
        version: the controller's, from the SDK.
    """

    joint_position: Array
    position: Array
    orientation: Array
    position_as_asked: Array
    orientation_as_asked: Array
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
    """Compares a calibration's chain with the SDK's `get_forward_kinematics`.

    The tool offset is taken from a report, not from the SDK's cache, which is zero until the first one; it must agree
    with the forward kinematics where the arm stands.

    Args:
        calibration: as read from the same controller.
        address: the controller's.
        samples: how many joint positions to draw inside the arm's limits.
        seed: of those.
        advance: called with 1 after each.

    Raises:
        InputError: no report, a controller in error, a connection that does not stand, or a pose that is none.
    """
    if samples < 1:
        raise InputError(f"--fk-samples {samples}: give one or more")
    arm = calibration.arm
    limits = np.where(np.isfinite(arm.joint_limits), arm.joint_limits, [-np.pi, np.pi])
    q = np.random.default_rng(seed).uniform(limits[:, 0], limits[:, 1], (samples, arm.dof))
    condition = read_condition(address)
    require_no_error(condition, address)
    with connected(address) as sdk:
        here = condition.joint_position[: arm.dof]
        at_rest = _controllers(sdk, here[None], address, lambda done: None)
        theirs = _controllers(sdk, q, address, advance)
        version = sdk.version

    links = np.stack([frames.transform_from_row(row) for row in calibration.kinematics])
    at_rest_ours = frames.chain(links, here[None])
    tools = {"none": np.eye(4)}
    if condition.has_tool:
        tools = {"taken into account": condition.T_flange_tool, "left out by the controller": np.eye(4)}
    apart = {name: np.concatenate(differences(at_rest_ours @ T, at_rest)) for name, T in tools.items()}
    tool = min(apart, key=lambda name: float(apart[name][0] + 0.1 * apart[name][1]))
    ours = frames.chain(links, as_sent(q)) @ tools[tool]
    position, orientation = differences(ours, theirs)
    passed = _agree(position, orientation)
    return Verification(
        q,
        position,
        orientation,
        *differences(frames.chain(links, q) @ tools[tool], theirs),
        condition=condition,
        tool=tool,
        tool_agrees=apart[tool],
        hidden_tool=None if passed else hidden_tool(ours, theirs),
        other_chain=None if passed else _other_chain(q, tools[tool], theirs),
        version=version,
    )


def as_sent(joints: Array) -> Array:
    """Joint positions in rad as the controller gets them: 32-bit numbers."""
    return np.asarray(joints).astype(np.float32).astype(float)


def differences(ours: Array, theirs: Array) -> tuple[Array, Array]:
    """`(sample,)` distances in m and angles in rad between transforms `(sample, 4, 4)`."""
    distance = np.linalg.norm(ours[:, :3, 3] - theirs[:, :3, 3], axis=-1)
    # the chord of the rotation's matrix: arccos of a trace would see nothing below 1e-8
    chord = np.linalg.norm(ours[:, :3, :3] - theirs[:, :3, :3], axis=(-2, -1))
    return distance, 2 * np.arcsin(np.clip(chord / np.sqrt(8), 0, 1))


def hidden_tool(ours: Array, theirs: Array) -> Array | None:
    """`(6,)` mm and rad: the one transform after the flange that makes up all of a difference; None if there is none.

    Args:
        ours: `(sample, 4, 4)` flange poses.
        theirs: `(sample, 4, 4)` what the controller gives.
    """
    if len(ours) < 3:
        return None
    T = np.linalg.inv(ours) @ theirs
    mean = T.mean(axis=0)
    U, _, Vt = np.linalg.svd(mean[:3, :3])
    mean[:3, :3] = U @ Vt
    return protocol.wire_pose(mean) if _agree(*differences(ours @ mean, theirs)) else None


def _other_chain(q: Array, T_flange_tool: Array, theirs: Array) -> str | None:
    """The bundled arm whose nominal chain gives the controller's poses."""
    for name in bundled_arms():
        arm = load_bundled(name)
        if arm.dof != q.shape[1]:
            continue
        if _agree(*differences(frames.chain(arm.links, as_sent(q)) @ T_flange_tool, theirs)):
            return name
    return None


def _agree(position: Array, orientation: Array) -> bool:
    return bool(position.max() <= GATE_M and orientation.max() <= GATE_RAD)


def _controllers(sdk: Sdk, q: Array, address: Address, advance: Callable[[int], object]) -> Array:
    """`(sample, 4, 4)` m."""
    poses = []
    for joints in q:
        pose = sdk.forward_kinematics(joints)
        if pose.values is None:
            shown = " ".join(f"{value:.1f}" for value in np.degrees(joints))
            raise InputError(
                f"{address}: the SDK's forward kinematics at {shown} deg gives {pose.refusal}; read again, and check "
                "that the firmware fits the SDK"
            )
        poses.append(pose.values)
        advance(1)
    return protocol.transform_of_wire_pose(np.array(poses))
