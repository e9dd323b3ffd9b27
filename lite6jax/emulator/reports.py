"""The reports of each port, for many instants at once, as bytes.

The content of the ports, with which an arm with hidden effects can be recorded and diagnosed:

- 30000, `target_…`: the commanded joints and the controller's kinematics of them, without effects.
- 30000, joints and velocities: the readings of encoders, 8 ms after the commands. They do not contain the effects,
  because compliance or backlash acts between encoder and link.
- Every port and the registers 42 and 55, torques: what the motors exert in the motion of the encoders, by the dynamics
  of the rigid arm and its payload, with the effects on torques and their noise. Currents follow them.
- 30000, `pose`: the true pose of the tool *with* all effects, as measured by a perfect sensor. This is the only
  deviation from a real controller, which computes this pose from the encoders. It replaces a laser tracker.
- 30001, 30002, 30003 and the registers 41 and 42: the commanded joints and the controller's kinematics of them.
  Register 42 with a parameter gives the encoder readings.

Register 44 always gives the controller's kinematics by its calibration, without effects.
"""

import numpy as np

from lite6jax.arms.frames import Array
from lite6jax.controller import protocol
from lite6jax.emulator.body import identity_of
from lite6jax.emulator.core import DIFFERENCE_S, Core
from lite6jax.emulator.paths import MAX_ACCELERATION, MAX_SPEED


def report(core: Core, port: int, time: Array) -> bytes:
    """The concatenated reports of a port at increasing instants `(sample,)` s."""
    records = np.zeros(len(time), protocol.report_layout(port))
    records["length"] = records.dtype.itemsize
    records["state_mode"] = core.state | core.mode << 4
    records["commands"] = len(core.queue)
    fill = _realtime if port == protocol.REALTIME else _slow
    fill(core, time, records)
    if "reports" in core.faults.nan:
        for name in ("joint_position", "pose"):
            records[name] = np.nan
    return records.tobytes()


def _realtime(core: Core, time: Array, records: np.ndarray) -> None:
    count = len(time)
    records["time_us"] = np.round(time * 1e6).astype(np.uint64) + core.clock_us(0.0)
    both = [core.commanded(time), core.measured(time)]
    # one-sided, so that a later command does not change earlier reports
    earlier = [core.commanded(time - DIFFERENCE_S)[1], core.measured(time - DIFFERENCE_S)[1]]
    for prefix, (q, dq), before in zip(("target", "joint"), both, earlier, strict=True):
        records[f"{prefix}_position"] = protocol.seven(q)
        records[f"{prefix}_velocity"] = protocol.seven(dq)
        records[f"{prefix}_acceleration"] = protocol.seven((dq - before) / DIFFERENCE_S)
    pose, speed = _pose_and_speed(core, *(np.concatenate(parts) for parts in zip(*both, strict=True)))
    records["target_pose"], records["target_pose_speed"] = pose[:count], speed[:count]
    records["pose_speed"] = speed[count:]
    rigid = not core.body.physics.effects and not core.faults.nominal_kinematics
    records["pose"] = pose[count:] if rigid else protocol.wire_pose(core.true(time))
    if core.faults.rotation_vectors:
        for name in ("target_pose", "pose"):
            records[name] = protocol.axis_angle_of_wire_pose(records[name])
    torque = core.torque(time)
    records["torque"] = protocol.seven(torque)
    records["current"] = protocol.seven(core.current(torque, both[1][1]))


def _pose_and_speed(core: Core, q: Array, dq: Array) -> tuple[Array, Array]:
    """Poses and speeds by the controller's kinematics, `(sample, 6)` each, in mm and rad, and per second."""
    half = DIFFERENCE_S / 2 * dq
    before, here, after = np.split(core.computed_pose(np.concatenate([q - half, q, q + half])), 3)
    shift = (after[:, :3, 3] - before[:, :3, 3]) * protocol.MM
    turned = (after[:, :3, :3] - before[:, :3, :3]) @ np.swapaxes(here[:, :3, :3], 1, 2)
    spin = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], -1)
    return protocol.wire_pose(here), np.concatenate([shift, spin], -1) / DIFFERENCE_S


def _slow(core: Core, time: Array, records: np.ndarray) -> None:
    names = records.dtype.names or ()
    q, dq = core.commanded(time)
    pose = protocol.wire_pose(core.computed_pose(q))
    torque = core.torque(time)
    records["joint_position"] = protocol.seven(q)
    records["pose"] = pose
    records["torque"] = protocol.seven(torque)
    if "error" in names:
        records["brakes"] = records["enabled"] = core.enabled
        records["error"], records["warning"] = core.error, core.warning
        records["tool_offset"], records["payload"] = core.tool, core.payload
        records["collision_sensitivity"] = core.collision_sensitivity
        records["teach_sensitivity"] = core.teach_sensitivity
        records["gravity_direction"] = [0, 0, -1]
    if "temperature" in names:
        identity = identity_of(core.body, core.faults.firmware, core.faults.stated_model)
        records["dof"], records["type"] = identity.dof, identity.type
        records["master"], records["slave"] = 0xAA, 0x55
        records["version"] = identity.encode().rstrip(b"\0")[:30]
        records["pose_limits"] = [1000, 1, 50000, 0.1, 1000]  # mm and s, as the SDK assumes them
        records["joint_limits"] = [20, 0.01, MAX_ACCELERATION, 1e-4, MAX_SPEED]
        records["turn_limits"] = [2.3, 2.7]
        records["temperature"] = np.round(protocol.seven(core.body.temperature(time)))
        records["joint_velocity"] = protocol.seven(dq)
        records["pose_speed"] = np.linalg.norm(_pose_and_speed(core, q, dq)[1][:, :3], axis=1)
        records["voltage"] = 2400
        records["current"] = protocol.seven(core.current(torque, core.measured(time)[1]))
        records["axis_angle"] = protocol.axis_angle_of_wire_pose(pose)[:, 3:]
