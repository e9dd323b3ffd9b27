"""What a sensor measures of a simulated arm with effects in a motion, and what is true of it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.se3 import quaternion_from_rotation
from lite6jax.effects.composition import Physics
from lite6jax.errors import InputError
from lite6jax.model import arm_model, predict_poses
from lite6jax.recordings import Recording
from lite6jax.recordings.motion import inertia_of_arm, motion_of_recording
from lite6jax.recordings.units import other_joints
from lite6jax.simulation.draws import generator
from lite6jax.simulation.instruments import AS_DECLARED, Instrument, UndeclaredNoise, correlated, instrument

Array = NDArray[np.floating]

OUTLIER_LEVER_M = 0.1
"""An outlier is rotated by its displacement divided by this."""

_quaternions = jax.jit(quaternion_from_rotation)
_beyond = jax.jit(Physics.beyond, static_argnums=0)


class Measured(NamedTuple):
    """A simulated recording and the truth behind it.

    Attributes:
        recording: what the sensor and the encoders measure.
        poses: `(sample, 4, 4)` of the tool in the sensor's frame without noise, m.
        rigid: `(sample, 4, 4)`, those of the same arm without effects.
        outlier: `(sample,)` bool, which rows are outliers.
    """

    recording: Recording
    poses: Array
    rigid: Array
    outlier: NDArray[np.bool_]

    @property
    def displacement(self) -> Array:
        """`(sample,)` m by which the effects displace the tool."""
        return np.linalg.norm(self.poses[:, :3, 3] - self.rigid[:, :3, 3], axis=1)

    @property
    def turn(self) -> Array:
        """`(sample,)` rad by which the effects rotate the tool."""
        chord = np.linalg.norm(self.poses[:, :3, :3] - self.rigid[:, :3, :3], axis=(1, 2))
        return 2 * np.arcsin(np.minimum(chord / np.sqrt(8), 1.0))

    @property
    def rms(self) -> tuple[float, float]:
        """Root mean squares of displacement (m) and turn (rad)."""
        return float(np.sqrt(np.mean(self.displacement**2))), float(np.sqrt(np.mean(self.turn**2)))


def measure(
    motion: Recording,
    arm: Arm,
    physics: Physics = Physics(),  # noqa: B008 (frozen)
    values: Sequence[float] | Array = (),
    *,
    kinematics: Array | None = None,
    sensor: Instrument | str = "tracker",
    undeclared: UndeclaredNoise = AS_DECLARED,
    T_sensor_base: Array | None = None,
    tool: Sequence[float] | Array | None = None,
    tool_known: bool = True,
    seed: int = 0,
) -> Measured:
    """A recording of an arm with effects in a motion; its settings declare the simulation truthfully.

    Joint positions are those of the motion plus read-out noise; velocities, directions and temperatures, on which the
    effects depend, are exact. Rows at which a clock offset requires the motion beyond its ends are dropped, and a note
    counts them.

    Args:
        motion: joint positions and what the effects depend on; its poses, if any, are replaced. Of its settings
            gravity, the payload's centre and the reference temperature are used.
        arm: its masses, its flange, and its kinematics where `kinematics` is not given.
        physics: the effects beyond the rigid model.
        values: `(physics.size,)`, their coordinates.
        kinematics: `(joint, 6)` of this arm, m and rad.
        sensor: an instrument or the name of one: tracker (positions), tracker_6d, motion_capture, camera,
            controller_fk.
        undeclared: how the noise differs from what the settings declare.
        T_sensor_base: `(4, 4)` the base in the sensor's frame, then declared unknown; the base's frame if not given.
        tool: `(6,)` x y z roll pitch yaw of the measured point in the flange's frame, m and rad; none if not given.
        tool_known: whether the settings declare it.
        seed: of the noise.

    Raises:
        InputError: an unknown sensor or one of single distances, values that do not fit the effects, or a motion
            without a quantity that an effect depends on (by name).
    """
    chosen = instrument(sensor)
    values = np.asarray(values, float)
    if values.shape != (physics.size,) or not np.isfinite(values).all():
        raise InputError(
            f"simulation: values {values.tolist()}; give {physics.size} finite numbers, one per coordinate"
        )
    if motion.dof != arm.dof:
        raise InputError(f"{motion.source}: has {motion.dof} joints, but {arm.name} has {arm.dof}; give a motion of it")
    if motion.sliding != arm.sliding:
        raise InputError(f"{motion.source}: {other_joints(motion.sliding, arm.sliding, arm.name)}")
    chain = np.asarray(arm.kinematics if kinematics is None else kinematics, float)
    if chain.shape != (arm.dof, 6):
        raise InputError(f"simulation: kinematics has the shape {chain.shape}; give {(arm.dof, 6)}")
    settings = motion.settings
    T_sensor = np.eye(4) if T_sensor_base is None else np.asarray(T_sensor_base, float)
    T_tool = arm.T_joint_flange @ (np.eye(4) if tool is None else frames.transform_from_row(tool))
    links = np.stack([frames.transform_from_row(row) for row in chain])
    rigid = T_sensor @ frames.chain(links, motion.joint_position, arm.sliding) @ T_tool
    poses, beyond = rigid.copy(), np.zeros(motion.samples, bool)
    if physics.effects:
        moved = motion_of_recording(motion)
        model = arm_model(chain.ravel(), T_sensor, T_tool)
        statics = inertia_of_arm(arm, settings)
        poses = np.array(predict_poses(moved.chain, physics, model, values, moved, statics))
        beyond = np.asarray(_beyond(physics, values, moved))
    if beyond.all():
        raise InputError(
            f"{motion.source}: at every row the clock offset requires the motion beyond its ends; give a smaller "
            "offset or a longer motion"
        )

    from_base = rigid[:, :3, 3] - T_sensor[:3, 3]
    larger = undeclared.factor * (1 + undeclared.growth_per_m * np.linalg.norm(from_base, axis=1))[:, None]

    def noise(purpose: str, sigma: float) -> Array:
        white = generator(seed, purpose).standard_normal((motion.samples, 3))
        return sigma * larger * correlated(white, undeclared.correlation, motion.run)

    probe, source = chosen
    position = poses[:, :3, 3] + noise("position", probe.position_noise)
    turned = None if probe.orientation_noise is None else noise("orientation", probe.orientation_noise)
    outlier = np.zeros(motion.samples, bool)
    rng = generator(seed, "outliers")
    hit = rng.permutation(motion.samples)[: round(undeclared.outlier_share * motion.samples)]
    outlier[hit] = True
    size = undeclared.outlier_size * rng.uniform(0.5, 2.0, hit.size)[:, None]
    position[hit] += size * _directions(rng, hit.size)
    quaternion = None
    if turned is not None:
        turned[hit] += size / OUTLIER_LEVER_M * _directions(rng, hit.size)
        quaternion = np.asarray(_quaternions(poses[:, :3, :3] @ Rotation.from_rotvec(turned).as_matrix()))
    joint_noise = np.hypot(probe.joint_noise, undeclared.joint_noise)
    read_out = joint_noise * generator(seed, "joints").standard_normal(motion.joint_position.shape)
    read_out[:, arm.slides] = 0.0

    declared = replace(
        settings,
        joint_source="measured",
        joint_noise_rad=probe.joint_noise,
        pose_source=source,
        motion=motion.motion,
        pose_frame="base" if T_sensor_base is None else "unknown",
        tool="unknown" if not tool_known else "none" if tool is None else tuple(np.asarray(tool, float).tolist()),
        position_noise_m=probe.position_noise,
        orientation_noise_rad=probe.orientation_noise,
    )
    dropped = int(beyond.sum())
    note = (f"dropped {dropped} rows whose instant lies beyond the motion, by a clock's offset",) if dropped else ()
    recording = replace(
        motion,
        joint_position=motion.joint_position + read_out,
        position=position,
        quaternion=quaternion,
        settings=declared,
        notes=(*motion.notes, *note),
    )
    if dropped:
        recording = recording.select(~beyond)
    return Measured(recording, poses[~beyond], rigid[~beyond], outlier[~beyond])


def _directions(rng: np.random.Generator, count: int) -> Array:
    vector = rng.standard_normal((count, 3))
    return vector / np.linalg.norm(vector, axis=1, keepdims=True)
