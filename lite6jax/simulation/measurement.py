"""Recordings of a simulated arm: chosen physics, a motion that shows it, a sensor that is as declared or is not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.se3 import quaternion_from_rotation
from lite6jax.effects.composition import Physics
from lite6jax.errors import InputError
from lite6jax.identifiability.sensor import SENSORS, Sensor
from lite6jax.model import arm_model, predict_poses
from lite6jax.recordings import Recording, RecordingSettings
from lite6jax.recordings.motion import inertia_of_arm, motion_of_recording
from lite6jax.recordings.settings import Motion as MotionKind
from lite6jax.recordings.settings import PoseSource

Array = NDArray[np.floating]

LENGTH_TOLERANCE = 0.8e-3
ANGLE_TOLERANCE = float(np.deg2rad(0.15))
"""One standard deviation of each number of a calibrated Lite 6 against nominal."""

MARGIN = 0.05
"""Share of each joint's range kept clear at either end."""
STATIC_STEP_S = 8.0
TRAJECTORY_STEP_S = 0.02
SPEED = float(np.deg2rad(120.0))
"""rad/s that no joint exceeds in a trajectory; the Lite 6 is able to 180 deg/s."""
PERIODS_S = (3.0, 15.0)
"""Of the sines that make a trajectory."""
SINES = 5
RUN_UP_S = 1.0
"""From rest to full speed at the start of a run."""
PAUSE_S = 5.0
"""Between runs of a trajectory."""
OUTLIER_LEVER_M = 0.1
"""An outlier is turned by its distance over this."""


class Instrument(NamedTuple):
    """A sensor and what a sidecar calls it."""

    sensor: Sensor
    pose_source: PoseSource


INSTRUMENTS: Mapping[str, Instrument] = MappingProxyType(
    {
        "tracker": Instrument(SENSORS["tracker"], "laser_tracker"),
        "tracker_6d": Instrument(SENSORS["tracker_6d"], "laser_tracker"),
        "motion_capture": Instrument(SENSORS["motion_capture"], "motion_capture"),
        "camera": Instrument(SENSORS["camera"], "camera"),
        # 32-bit floats on the wire: 3.4e-8 m on average, 6e-7 rad at most
        "controller_fk": Instrument(Sensor("pose", 3e-8, 3e-7), "controller_fk"),
    }
)
"""By the names of the command line."""


@dataclass(frozen=True)
class Undeclared:
    """What is true of the noise and the sidecar does not say; the defaults are an honest sidecar.

    Attributes:
        factor: the true standard deviation of the poses over the declared one.
        correlation: of a sample's noise with the one before in its run, 0 to below 1 (a first-order autoregression of
            the same variance).
        growth_per_m: the standard deviation is 1 + this · the measured point's distance from the base (m) times larger.
        joint_noise: of the joints' read-outs, rad, on top of what the sensor declares.
        outlier_share: of the rows, 0 to 1.
        outlier_size: m; an outlier is 0.5 to 2 times that off in a random direction.

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
        for field in fields(self):
            value, top = getattr(self, field.name), {"correlation": 1.0, "outlier_share": 1.0}.get(field.name, np.inf)
            if not 0 <= value < np.inf or value > top or (field.name == "correlation" and value == 1):
                limits = {"correlation": "0 to below 1", "outlier_share": "0 to 1"}.get(field.name, "0 or more")
                raise InputError(f"simulation: {field.name} is {value}; give a number, {limits}")


class Measured(NamedTuple):
    """A simulated recording and what is true of it.

    Attributes:
        recording: what the sensor and the encoders say.
        poses: `(sample, 4, 4)` of the tool in the sensor's frame, without noise.
        rigid: `(sample, 4, 4)`, those of the same arm without the physics.
        outlier: `(sample,)` bool.
    """

    recording: Recording
    poses: Array
    rigid: Array
    outlier: NDArray[np.bool_]

    @property
    def displacement(self) -> Array:
        """`(sample,)` m by which the physics moves the tool."""
        return np.linalg.norm(self.poses[:, :3, 3] - self.rigid[:, :3, 3], axis=1)

    @property
    def turn(self) -> Array:
        """`(sample,)` rad by which the physics turns the tool."""
        chord = np.linalg.norm(self.poses[:, :3, :3] - self.rigid[:, :3, :3], axis=(1, 2))
        return 2 * np.arcsin(np.minimum(chord / np.sqrt(8), 1.0))


def simulate(
    arm: Arm,
    physics: Physics = Physics(),  # noqa: B008 (frozen)
    values: Sequence[float] | Array = (),
    *,
    motion: MotionKind = "static",
    samples: int = 400,
    runs: int = 1,
    payload: float | Sequence[float] | Array = 0.0,
    warm_up: float | None = None,
    settings: RecordingSettings | None = None,
    kinematics: Array | None = None,
    sensor: Instrument | str = "tracker",
    undeclared: Undeclared = Undeclared(),
    T_sensor_base: Array | None = None,
    tool: Sequence[float] | Array | None = None,
    tool_known: bool = True,
    seed: int = 0,
) -> Recording:
    """A recording with chosen physics: `draw_motion`, then `measure`, whose arguments these are.

    Raises:
        InputError: as those.
    """
    drawn = draw_motion(arm, motion, samples, runs=runs, payload=payload, warm_up=warm_up, settings=settings, seed=seed)
    return measure(
        drawn, arm, physics, values, kinematics=kinematics, sensor=sensor, undeclared=undeclared,
        T_sensor_base=T_sensor_base, tool=tool, tool_known=tool_known, seed=seed,
    ).recording  # fmt: skip


def draw_motion(
    arm: Arm,
    kind: MotionKind = "static",
    samples: int = 400,
    *,
    runs: int = 1,
    step: float | None = None,
    speed: float = SPEED,
    payload: float | Sequence[float] | Array = 0.0,
    warm_up: float | None = None,
    settings: RecordingSettings | None = None,
    seed: int = 0,
) -> Recording:
    """A motion to be measured: a recording without poses.

    Static: a Latin hypercube over the joints' ranges, in random order, so that each joint visits its whole range
    evenly and comes from below as often as from above. Trajectory: in every run each joint follows a sum of sines, from
    rest, with its true velocities. A joint's range is its limits less 5 % at either end, and one turn at most.

    Args:
        arm: its joints and limits.
        kind: static or trajectory.
        samples: of all runs together, which are of equal length.
        runs: how many; the clock goes on from one to the next.
        step: s from sample to sample; 8 of a static recording, 0.02 of a trajectory where not given.
        speed: rad/s that no joint of a trajectory exceeds.
        payload: `()` or `(part,)` kg at the flange, in equal parts of the recording one after the other.
        warm_up: K by which the first joint warms up in the end, exponentially from the reference temperature with a
            third of the duration for time constant; the last joint gets 0.8 of it. Not given: temperatures are not
            recorded.
        settings: what the sidecar declares of arm, geometry, gravity, payload centre and reference temperature; the
            arm's name and the defaults where not given.
        seed: of all that is drawn.

    Raises:
        InputError: fewer samples than a run takes, or a number out of its range.
    """
    fewest = 2 if kind == "trajectory" else 1
    if runs < 1 or samples < fewest * runs:
        raise InputError(f"simulation: {samples} samples in {runs} runs; give at least {fewest} a run, and one run")
    step = (STATIC_STEP_S if kind == "static" else TRAJECTORY_STEP_S) if step is None else step
    for name, value in (("step", step), ("speed", speed)):
        if not 0 < value < np.inf:
            raise InputError(f"simulation: {name} is {value}; give a number above 0")
    masses = np.atleast_1d(np.asarray(payload, float))
    if masses.ndim != 1 or not 1 <= masses.size <= samples or not np.isfinite(masses).all() or masses.min() < 0:
        raise InputError(f"simulation: payload {np.asarray(payload).tolist()}; give masses in kg, 0 or more")
    if warm_up is not None and not abs(warm_up) < np.inf:
        raise InputError(f"simulation: warm_up is {warm_up}; give a number of K")

    rng = _generator(seed, "motion")
    run = np.arange(samples) * runs // samples
    centre, half = _ranges(arm)
    velocity = None
    if kind == "static":
        order = np.argsort(rng.random((samples, arm.dof)), axis=0)
        position = centre + half * (2 * (order + rng.random((samples, arm.dof))) / samples - 1)
        time = step * np.arange(samples)
    else:
        starts = np.searchsorted(run, np.arange(runs))
        within = step * (np.arange(samples) - starts[run])
        time = step * (np.arange(samples) - run) + PAUSE_S * run
        parts = [_multi_sine(rng, centre, half, within[run == number], speed) for number in range(runs)]
        position, velocity = (np.concatenate(part) for part in zip(*parts, strict=True))
    settings = settings or RecordingSettings(arm=arm.name)
    temperature = None
    if warm_up is not None:
        duration = max(time[-1], step)
        rise = warm_up * -np.expm1(-3 * time / duration)
        temperature = settings.reference_temperature_degC + np.outer(rise, np.linspace(1.0, 0.8, arm.dof))
    return Recording.assembled(
        position,
        time=time,
        joint_velocity=velocity,
        joint_temperature=temperature,
        payload=masses[np.arange(samples) * masses.size // samples],
        run=run,
        settings=replace(settings, motion=kind),
        source="simulation",
    )


def measure(
    motion: Recording,
    arm: Arm,
    physics: Physics = Physics(),  # noqa: B008 (frozen)
    values: Sequence[float] | Array = (),
    *,
    kinematics: Array | None = None,
    sensor: Instrument | str = "tracker",
    undeclared: Undeclared = Undeclared(),
    T_sensor_base: Array | None = None,
    tool: Sequence[float] | Array | None = None,
    tool_known: bool = True,
    seed: int = 0,
) -> Measured:
    """What a sensor shows of an arm with physics in a motion; the settings say truthfully what was done.

    Joint positions are those of the motion plus read-out noise; velocities, directions and temperatures, which drive
    the physics, are exact. Rows for which a clock's effect asks beyond the motion are dropped, and a note counts them.

    Args:
        motion: joints and what drives the physics; its poses, if any, are replaced. Of its settings gravity, the
            payload's centre and the reference temperature hold.
        arm: its masses, its flange, and its chain where `kinematics` is not given.
        physics: what the arm does beyond its rigid model.
        values: `(physics.size,)`.
        kinematics: `(joint, 6)` the arm's own chain, m and rad.
        sensor: an instrument or the name of one: tracker (positions), tracker_6d, motion_capture, camera,
            controller_fk.
        undeclared: how the noise differs from what the settings declare.
        T_sensor_base: `(4, 4)` the base in the sensor's frame, then declared unknown; the base's frame if not given.
        tool: `(6,)` x y z roll pitch yaw of the measured point on the flange, m and rad; none if not given.
        tool_known: whether the settings declare it.
        seed: of the noise.

    Raises:
        InputError: an unknown sensor or one of single distances, values that do not fit the physics, or a motion that
            lacks what an effect needs (by name).
    """
    instrument = _instrument(sensor)
    values = np.asarray(values, float)
    if values.shape != (physics.size,) or not np.isfinite(values).all():
        raise InputError(
            f"simulation: values {values.tolist()}; give {physics.size} finite numbers, one per coordinate"
        )
    if motion.dof != arm.dof:
        raise InputError(f"{motion.source}: has {motion.dof} joints, and {arm.name} has {arm.dof}; give that arm's")
    chain = np.asarray(arm.kinematics if kinematics is None else kinematics, float)
    if chain.shape != (arm.dof, 6):
        raise InputError(f"simulation: kinematics has the shape {chain.shape}; give {(arm.dof, 6)}")
    settings = motion.settings
    T_sensor = np.eye(4) if T_sensor_base is None else np.asarray(T_sensor_base, float)
    T_tool = arm.T_joint_flange @ (np.eye(4) if tool is None else frames.transform_from_row(tool))
    links = np.stack([frames.transform_from_row(row) for row in chain])
    rigid = T_sensor @ frames.chain(links, motion.joint_position) @ T_tool
    poses, beyond = rigid.copy(), np.zeros(motion.samples, bool)
    if physics.effects:
        moved = motion_of_recording(motion)
        model = arm_model(chain.ravel(), T_sensor, T_tool)
        statics = inertia_of_arm(arm, settings)
        poses = np.array(predict_poses(SixParameterForm(arm.dof), physics, model, values, moved, statics))
        beyond = np.asarray(_beyond(physics, values, moved))
    if beyond.all():
        raise InputError(f"{motion.source}: every row asks beyond the motion; give a smaller offset or a longer motion")

    from_base = rigid[:, :3, 3] - T_sensor[:3, 3]
    larger = undeclared.factor * (1 + undeclared.growth_per_m * np.linalg.norm(from_base, axis=1))[:, None]

    def noise(purpose: str, sigma: float) -> Array:
        white = _generator(seed, purpose).standard_normal((motion.samples, 3))
        return sigma * larger * _correlated(white, undeclared.correlation, motion.run)

    probe, source = instrument
    position = poses[:, :3, 3] + noise("position", probe.position_noise)
    turned = None if probe.orientation_noise is None else noise("orientation", probe.orientation_noise)
    outlier = np.zeros(motion.samples, bool)
    rng = _generator(seed, "outliers")
    hit = rng.permutation(motion.samples)[: round(undeclared.outlier_share * motion.samples)]
    outlier[hit] = True
    size = undeclared.outlier_size * rng.uniform(0.5, 2.0, hit.size)[:, None]
    position[hit] += size * _directions(rng, hit.size)
    quaternion = None
    if turned is not None:
        turned[hit] += size / OUTLIER_LEVER_M * _directions(rng, hit.size)
        quaternion = np.asarray(_quaternions(poses[:, :3, :3] @ _rotations(turned)))
    joint_noise = np.hypot(probe.joint_noise, undeclared.joint_noise)
    read_out = joint_noise * _generator(seed, "joints").standard_normal(motion.joint_position.shape)

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


def draw_calibration(
    arm: Arm, seed: int = 0, *, length: float = LENGTH_TOLERANCE, angle: float = ANGLE_TOLERANCE
) -> Array:
    """`(joint, 6)` the chain of one arm as it was made: nominal, each number off by a tolerance.

    Args:
        arm: the nominal arm.
        seed: of the draw.
        length: one standard deviation of x, y, z in m.
        angle: of roll, pitch, yaw in rad.
    """
    return perturbed(arm.kinematics, length, angle, seed, "calibration")


def perturbed(kinematics: Array, length: float, angle: float, seed: int, purpose: str = "uncertainty") -> Array:
    """A chain `(joint, 6)` with normal errors of these standard deviations (m, rad) in each number."""
    return kinematics + np.array([length] * 3 + [angle] * 3) * _generator(seed, purpose).standard_normal(
        kinematics.shape
    )


def draw_sensor_frame(seed: int = 0) -> Array:
    """`(4, 4)` T_sensor_base of a sensor 1.5 to 3 m away that is turned anyhow and tilted by up to 10 degrees."""
    rng = _generator(seed, "frame")
    distance, bearing, yaw = rng.uniform(1.5, 3.0), *rng.uniform(-np.pi, np.pi, 2)
    roll, pitch = rng.uniform(-1, 1, 2) * np.deg2rad(10)
    x, y = distance * np.cos(bearing), distance * np.sin(bearing)
    return frames.transform_from_row([x, y, rng.uniform(-1.0, 0.5), roll, pitch, yaw])


_quaternions = jax.jit(quaternion_from_rotation)
_beyond = jax.jit(Physics.beyond, static_argnums=0)


def _instrument(sensor: Instrument | str) -> Instrument:
    if isinstance(sensor, str):
        if sensor not in INSTRUMENTS:
            raise InputError(f"simulation: sensor {sensor!r}: is none of {', '.join(INSTRUMENTS)}")
        sensor = INSTRUMENTS[sensor]
    if sensor.sensor.quantity not in ("position", "pose"):
        raise InputError(
            f"simulation: a sensor of {sensor.sensor.quantity} has no place in a recording; give one of positions or "
            "poses"
        )
    return sensor


_PURPOSES = ("motion", "calibration", "uncertainty", "frame", "position", "orientation", "joints", "outliers")


def _generator(seed: int, purpose: str) -> np.random.Generator:
    """Each purpose draws from a stream of its own: another sensor leaves the motion as it was."""
    if seed < 0:
        raise InputError(f"seed {seed}: give zero or more")
    return np.random.default_rng([seed, _PURPOSES.index(purpose)])


def _ranges(arm: Arm) -> tuple[Array, Array]:
    """`(joint,)` each: the middle of a joint's range and half its width."""
    lower, upper = np.where(np.isfinite(arm.joint_limits), arm.joint_limits, [-np.pi, np.pi]).T
    return (lower + upper) / 2, np.minimum((upper - lower) / 2, np.pi) * (1 - 2 * MARGIN)


def _multi_sine(rng: np.random.Generator, centre: Array, half: Array, time: Array, speed: float) -> tuple[Array, Array]:
    """Positions and velocities `(sample, joint)` of sums of sines within range and speed, from rest."""
    shape = (SINES, len(centre))
    amplitude = rng.uniform(0.2, 1.0, shape)
    amplitude *= half / amplitude.sum(0)
    rate = 2 * np.pi / np.exp(rng.uniform(np.log(PERIODS_S[0]), np.log(PERIODS_S[1]), shape))
    rate *= np.minimum(1.0, speed / (amplitude * rate).sum(0))
    phase = rng.uniform(-np.pi, np.pi, shape)
    # the path is walked by a clock that starts from rest: limits and speed hold however it runs
    x = np.minimum(time / RUN_UP_S, 1.0)
    pace = x**3 * (10 - 15 * x + 6 * x * x)
    clock = RUN_UP_S * x**4 * (2.5 - 3 * x + x * x) + np.maximum(time - RUN_UP_S, 0.0)
    angle = clock[:, None, None] * rate + phase
    position = centre + (amplitude * np.sin(angle)).sum(1)
    return position, pace[:, None] * (amplitude * rate * np.cos(angle)).sum(1)


def _correlated(white: Array, correlation: float, run: NDArray[np.integer]) -> Array:
    """White noise `(sample, axis)` of variance 1 made a first-order autoregression of variance 1, anew in each run."""
    if not correlation:
        return white
    noise, fresh = white.copy(), np.sqrt(1 - correlation**2)
    for k in range(1, len(noise)):
        if run[k] == run[k - 1]:
            noise[k] = correlation * noise[k - 1] + fresh * white[k]
    return noise


def _directions(rng: np.random.Generator, count: int) -> Array:
    vector = rng.standard_normal((count, 3))
    return vector / np.linalg.norm(vector, axis=1, keepdims=True)


def _rotations(vector: Array) -> Array:
    """Rotations `(sample, 3, 3)` of rotation vectors `(sample, 3)` (Rodrigues)."""
    angle = np.linalg.norm(vector, axis=1)
    x, y, z = (vector / np.maximum(angle, np.finfo(float).tiny)[:, None]).T
    o = np.zeros_like(x)
    K = np.stack([np.stack(row, -1) for row in ([o, -z, y], [z, o, -x], [-y, x, o])], -2)
    s, c = np.sin(angle)[:, None, None], 1 - np.cos(angle)[:, None, None]
    return np.eye(3) + s * K + c * (K @ K)
