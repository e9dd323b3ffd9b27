"""What a sensor measures of a simulated arm with effects in a motion, and what is true of it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple, final

import jax
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.files import read_arm
from lite6jax.arms.se3 import quaternion_from_rotation
from lite6jax.array_types import Array, Mask
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.serialization import parse_effect
from lite6jax.errors import InputError, require_type, wrong_type
from lite6jax.model import arm_model, predict_poses
from lite6jax.recordings import Recording, RecordingSettings
from lite6jax.recordings.motion import inertia_of_arm, motion_of_recording
from lite6jax.recordings.units import other_joints
from lite6jax.sensors.pose import PoseSensor
from lite6jax.sensors.sensor import Sensor
from lite6jax.sensors.usual import READINGS, SENSORS
from lite6jax.simulation import readings
from lite6jax.simulation.motions import MotionKind, draw_motion, make_generator, make_motion

OUTLIER_LEVER_M = 0.1
"""An outlier is rotated by its displacement divided by this."""

_quaternions = jax.jit(quaternion_from_rotation)
_beyond = jax.jit(Physics.beyond, static_argnums=0)


INSTRUMENTS: Mapping[str, PoseSensor] = {
    name: sensor for name, sensor in SENSORS.items() if isinstance(sensor, PoseSensor)
}
"""Sensors of positions or poses, by name."""


@final
@dataclass(frozen=True)
class UndeclaredNoise:
    """How the true noise differs from the declared one; the defaults are noise as declared.

    Attributes:
        factor: ratio of the true standard deviation of the poses to the declared one; 0 is no noise.
        correlation: autocorrelation of the noise from one sample of a run to the next, 0 to below 1 (first-order
            autoregression with the same variance).
        growth_per_m: relative growth of the standard deviation per m of distance between the measured point and the
            base: it is 1 + growth_per_m · distance times larger.
        joint_noise: standard deviation of the joints' read-outs in addition to the declared one, rad.
        outlier_share: share of the rows that are outliers, 0 to 1.
        outlier_size: m; an outlier is displaced by 0.5 to 2 times this in a random direction.

    Raises:
        InputError: a number outside these ranges.
    """

    factor: float = 1.0
    correlation: float = 0.0
    growth_per_m: float = 0.0
    joint_noise: float = 0.0
    outlier_share: float = 0.0
    outlier_size: float = 5e-3

    def __post_init__(self) -> None:
        inside = {
            "correlation": (self.correlation < 1, "0 to below 1"),
            "outlier_share": (self.outlier_share <= 1, "0 to 1"),
        }
        for name, value in asdict(self).items():
            below, limits = inside.get(name, (True, "0 or more"))
            if not (below and 0 <= value < np.inf):
                raise InputError(f"simulation: {name} is {value}; give a number, {limits}")


class Measurement(NamedTuple):
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
    outlier: Mask

    @property
    def displacement(self) -> Array:
        """`(sample,)` m by which the effects displace the tool."""
        return frames.compare_transforms(self.poses, self.rigid)[0]

    @property
    def rms(self) -> tuple[float, float]:
        """Root mean squares of the displacement (m) and of the angle (rad) by which the effects rotate the tool."""
        distance, angle = frames.compare_transforms(self.poses, self.rigid)
        return float(np.sqrt(np.mean(distance**2))), float(np.sqrt(np.mean(angle**2)))


def measure(
    motion: Recording,
    arm: Arm,
    physics: Physics = Physics(),  # noqa: B008 (frozen)
    values: Sequence[float] | Array = (),
    *,
    kinematics: Array | None = None,
    sensor: Sensor | str = "tracker",
    position_noise: float | None = None,
    orientation_noise: float | None = None,
    joint_noise: float | None = None,
    undeclared: UndeclaredNoise = UndeclaredNoise(),
    T_sensor_base: Array | None = None,
    tool: Sequence[float] | Array | None = None,
    tool_known: bool = True,
    seed: int = 0,
) -> Measurement:
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
        kinematics, sensor, position_noise, orientation_noise, joint_noise, undeclared, T_sensor_base, tool,
            tool_known: as in `simulate`.
        seed: of the noise.

    Raises:
        InputError: an unknown sensor or one of single distances, values that do not fit the effects, or a motion
            without a quantity that an effect depends on (by name).
    """
    reading = isinstance(sensor, str) and sensor in READINGS
    if isinstance(sensor, str) and not reading and sensor not in INSTRUMENTS:
        raise InputError(f"simulation: sensor {sensor!r}: is none of {', '.join((*INSTRUMENTS, *READINGS))}")
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
    T_sensor = np.eye(4) if T_sensor_base is None or reading else np.asarray(T_sensor_base, float)
    if tool is not None:
        T_tool = arm.T_joint_flange @ frames.transform_from_row(tool)
    else:
        T_tool = arm.T_joint_flange @ (readings.tool_of(str(sensor)) if reading else np.eye(4))
    model = arm_model(chain.ravel(), T_sensor, T_tool)
    statics = inertia_of_arm(arm, motion.settings)

    def move_rigidly(moved: Recording) -> Array:
        """`(sample, 4, 4)`, the tool of the rigid arm."""
        links = frames.transform_from_row(chain)
        return T_sensor @ frames.chain(links, moved.joint_position, arm.sliding) @ T_tool

    def move(moved: Recording) -> Array:
        """The same with the effects."""
        if not physics.effects:
            return move_rigidly(moved)
        at = motion_of_recording(moved)
        return np.array(predict_poses(at.chain, physics, model, values, at, statics))

    def read_joints(recording: Recording, sigma: float) -> Array:
        """`(sample, joint)`, joint positions with the noise of their read-out."""
        noise = sigma * make_generator(seed, "joints").standard_normal(recording.joint_position.shape)
        noise[:, arm.slides] = 0.0
        return recording.joint_position + noise

    if reading:
        noise = 0.0 if undeclared.factor == 0 else position_noise
        simulated = readings.read(str(sensor), motion, arm, model, move, noise, seed)
        declared = {"joint_source": "measured", "joint_noise_rad": joint_noise or 0.0, "motion": simulated.motion}
        settings = replace(simulated.settings, **declared)
        read = replace(simulated, joint_position=read_joints(simulated, joint_noise or 0.0), settings=settings)
        return Measurement(read, move(simulated), move_rigidly(simulated), np.zeros(simulated.samples, bool))

    probe = INSTRUMENTS[sensor] if isinstance(sensor, str) else sensor
    if not probe.reads_poses:
        raise InputError(
            f"simulation: a sensor of {probe.quantity} has no place in a recording; give one of positions or poses"
        )
    assert isinstance(probe, PoseSensor)
    probe = probe.with_noise(position_noise, orientation_noise, joint_noise)
    rigid = move_rigidly(motion)
    poses = move(motion)
    beyond = np.zeros(motion.samples, bool)
    if physics.effects:
        beyond = np.asarray(_beyond(physics, values, motion_of_recording(motion)))
    if beyond.all():
        raise InputError(
            f"{motion.source}: at every row the clock offset requires the motion beyond its ends; give a smaller "
            "offset or a longer motion"
        )

    distance = np.linalg.norm(rigid[:, :3, 3] - T_sensor[:3, 3], axis=1)[:, None]
    larger = undeclared.factor * (1 + undeclared.growth_per_m * distance)

    def draw_noise(purpose: str, sigma: float) -> Array:
        """`(sample, 3)`, a first-order autoregression in each run."""
        noise = make_generator(seed, purpose).standard_normal((motion.samples, 3))
        rho = undeclared.correlation
        for k in range(1, len(noise) if rho else 0):
            if motion.run[k] == motion.run[k - 1]:
                noise[k] = rho * noise[k - 1] + np.sqrt(1 - rho**2) * noise[k]
        return sigma * larger * noise

    position = poses[:, :3, 3] + draw_noise("position", probe.position_noise)
    turn = None
    if probe.orientation_noise is not None:
        turn = draw_noise("orientation", probe.orientation_noise)
    outlier = np.zeros(motion.samples, bool)
    rng = make_generator(seed, "outliers")
    hit = rng.permutation(motion.samples)[: round(undeclared.outlier_share * motion.samples)]
    outlier[hit] = True
    size = undeclared.outlier_size * rng.uniform(0.5, 2.0, hit.size)[:, None]
    position[hit] += size * _draw_directions(rng, hit.size)
    quaternion = None
    if turn is not None:
        turn[hit] += size / OUTLIER_LEVER_M * _draw_directions(rng, hit.size)
        quaternion = np.asarray(_quaternions(poses[:, :3, :3] @ Rotation.from_rotvec(turn).as_matrix()))
    declared_tool: str | tuple[float, ...] = "unknown"
    if tool_known:
        declared_tool = "none"
        if tool is not None:
            declared_tool = tuple(np.asarray(tool, float).tolist())
    settings = replace(
        motion.settings,
        joint_source="measured",
        joint_noise_rad=probe.joint_noise,
        pose_source=probe.source,  # type: ignore[arg-type]
        motion=motion.motion,
        pose_frame="base" if T_sensor_base is None else "unknown",
        tool=declared_tool,
        position_noise_m=probe.position_noise,
        orientation_noise_rad=probe.orientation_noise,
    )
    recording = replace(
        motion,
        joint_position=read_joints(motion, float(np.hypot(probe.joint_noise, undeclared.joint_noise))),
        position=position,
        quaternion=quaternion,
        settings=settings,
    )
    if beyond.any():
        note = f"dropped {beyond.sum()} rows whose instant lies beyond the motion, by a clock's offset"
        recording = replace(recording, notes=(*recording.notes, note)).select(~beyond)
    return Measurement(recording, poses[~beyond], rigid[~beyond], outlier[~beyond])


def _draw_directions(rng: np.random.Generator, count: int) -> Array:
    vector = rng.standard_normal((count, 3))
    return vector / np.linalg.norm(vector, axis=1, keepdims=True)


def simulate(
    arm: Arm | str,
    joint_position: ArrayLike | None = None,
    *,
    effects: Iterable[str | tuple[Effect, ArrayLike]] = (),
    motion: MotionKind = "static",
    time: ArrayLike | None = None,
    samples: int | None = None,
    runs: int = 1,
    payload: float | Sequence[float] | Array = 0.0,
    warm_up: float | None = None,
    settings: RecordingSettings | None = None,
    kinematics: Array | None = None,
    sensor: Sensor | str = "tracker",
    position_noise: float | None = None,
    orientation_noise: float | None = None,
    joint_noise: float | None = None,
    undeclared: UndeclaredNoise = UndeclaredNoise(),
    T_sensor_base: Array | None = None,
    tool: Sequence[float] | Array | None = None,
    tool_known: bool = True,
    seed: int = 0,
) -> Recording:
    """A recording of a simulated arm, as `lite6jax simulate` writes one. For example:

        lite6jax.simulate("lite6", effects=["joint_compliance:joint=2,compliance_rad_per_Nm=9e-5"], seed=1)

    Args:
        arm: an `Arm` or what `read_arm` takes.
        joint_position: `(sample, joint)` rad, the poses or the trajectory; drawn at random where not given.
        effects: beyond the rigid arm, each as text (name, colon, key=value separated by commas, in SI units) or as an
            effect with its `(coordinate,)` values.
        motion: `static` (the arm stands still at each sample) or `trajectory`.
        time: `(sample,)` s, of given joint positions; every 8 s of a static recording, every 0.02 s of a trajectory
            where not given.
        samples: how many are drawn; 400 static poses, 3000 of a trajectory where not given.
        runs: in how many runs of equal length they are drawn.
        payload: `()` or `(part,)` kg at the flange, in equal parts of the recording one after the other.
        warm_up: temperature rise of the first joint at the end, K; no temperatures are recorded where not given.
        settings: declared arm, geometry, gravity, payload centre and reference temperature; the arm's name and the
            defaults where not given.
        kinematics: `(joint, 6)` of this arm, m and rad; nominal where not given. See `draw_calibration`.
        sensor: tracker (positions), tracker_6d, motion_capture, camera or controller_fk (poses), or one that
            `plan_sensor` gives; or readings: contact, plane, distance, axis, fixed_camera or flange_camera, of which
            rows are dropped where the arm does not reach, and tool and places are unknown.
        position_noise: declared and true standard deviation per axis, m; the sensor's where not given.
        orientation_noise: likewise, rad.
        joint_noise: likewise, of each joint's read-out, rad.
        undeclared: how the true noise differs from the declared one; `UndeclaredNoise(factor=0)` is none.
        T_sensor_base: `(4, 4)` the base in the sensor's frame, then declared unknown; the base's frame where not given.
        tool: `(6,)` x y z roll pitch yaw of the measured point in the flange's frame, m and rad; none where not given.
        tool_known: whether the settings declare it.
        seed: of the random numbers.

    Returns:
        a `Recording` with `(sample, 3)` positions in m and, of a sensor of poses, `(sample, 4)` unit quaternions, in
        the sensor's frame. Its settings declare the sensor, its noise, the frame and the tool.

    Raises:
        InputError: an unknown arm, sensor or effect; an effect without values; joint positions of another shape, not
            finite, or in degrees; a number out of its range; a motion without a quantity that an effect depends on.
    """
    require_type("arm", arm, Arm | str, "an Arm, the name of a bundled one, or the path of an arm's file")
    if isinstance(arm, str):
        arm = read_arm(arm)
    parsed = _with_values(effects, arm.sliding)
    for effect, _ in parsed:
        quantities = {driver.quantity for driver in effect.drivers}
        if warm_up is None and quantities & {"temperature rise", "temperature"}:
            raise InputError(f"{effect.label}: depends on temperatures that rise; give warm_up, such as 15 K")
        if motion == "static" and "velocity" in quantities:
            raise InputError(f"{effect.label}: depends on joint velocities; simulate with motion='trajectory'")
    if joint_position is None:
        if time is not None:
            raise InputError("time: belongs to given joint positions; give joint_position as well, or leave it out")
        moved = draw_motion(
            arm, motion, samples, runs=runs, payload=payload, warm_up=warm_up, settings=settings, seed=seed
        )
    else:
        if samples is not None or runs != 1:
            raise InputError("samples and runs: belong to a drawn motion; leave them out beside joint_position")
        moved = make_motion(arm, joint_position, motion, time=time, payload=payload, warm_up=warm_up, settings=settings)
    physics = Physics(tuple(effect for effect, _ in parsed))
    return measure(
        moved,
        arm,
        physics,
        physics.join([np.asarray(values, float) for _, values in parsed]),
        kinematics=kinematics,
        sensor=sensor,
        position_noise=position_noise,
        orientation_noise=orientation_noise,
        joint_noise=joint_noise,
        undeclared=undeclared,
        T_sensor_base=T_sensor_base,
        tool=tool,
        tool_known=tool_known,
        seed=seed,
    ).recording


def _with_values(
    effects: Iterable[str | tuple[Effect, ArrayLike]], sliding: tuple[int, ...]
) -> list[tuple[Effect, ArrayLike]]:
    """Each effect with its `(coordinate,)` values, as `simulate` takes them."""
    if isinstance(effects, str | Effect):
        raise wrong_type("effects", effects, "a list of texts or of (effect, values)")
    parsed: list[tuple[Effect, ArrayLike]] = []
    for effect in effects:
        if isinstance(effect, str):
            parsed.append(parse_effect(effect, sliding=sliding))
        elif isinstance(effect, Effect):
            values = ", ".join(coordinate.name for coordinate in effect.coordinates)
            raise InputError(f"effects: {effect.label} has no values; give (effect, [{values}])")
        else:
            parsed.append(effect)
    return parsed
