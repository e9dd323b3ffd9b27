"""One call from an arm and its effects to a recording."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.files import read_arm
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.serialization import parse_effect
from lite6jax.errors import InputError, require_type
from lite6jax.recordings import Recording, RecordingSettings
from lite6jax.simulation.instruments import AS_DECLARED, Instrument, UndeclaredNoise, instrument
from lite6jax.simulation.measurement import measure
from lite6jax.simulation.motions import MotionKind, draw_motion, given_motion

Array = NDArray[np.floating]


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
    sensor: Instrument | str = "tracker",
    position_noise: float | None = None,
    orientation_noise: float | None = None,
    joint_noise: float | None = None,
    undeclared: UndeclaredNoise = AS_DECLARED,
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
        sensor: tracker (positions), tracker_6d, motion_capture, camera or controller_fk (poses), or an `Instrument`.
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
        InputError: an unknown arm, sensor or effect; joint positions of another shape, not finite, or in degrees; a
            number out of its range; a motion without a quantity that an effect depends on.
    """
    require_type("arm", arm, Arm | str, "an Arm, the name of a bundled one, or the path of an arm's file")
    arm = read_arm(arm) if isinstance(arm, str) else arm
    chosen = instrument(sensor)
    chosen = chosen._replace(sensor=chosen.sensor.with_noise(position_noise, orientation_noise, joint_noise))
    parsed = [parse_effect(effect) if isinstance(effect, str) else effect for effect in effects]
    for effect, _ in parsed:
        quantities = {driver.quantity for driver in effect.drivers}
        if warm_up is None and quantities & {"temperature rise", "temperature"}:
            raise InputError(f"{effect.label}: depends on temperatures that rise; give warm_up, such as 15 K")
        if motion == "static" and "velocity" in quantities:
            raise InputError(f"{effect.label}: depends on joint velocities; simulate with motion='trajectory'")
    physics = Physics(tuple(effect for effect, _ in parsed))
    if joint_position is None:
        if time is not None:
            raise InputError("time: belongs to given joint positions; give joint_position as well, or leave it out")
        drawn = draw_motion(
            arm, motion, samples, runs=runs, payload=payload, warm_up=warm_up, settings=settings, seed=seed
        )
    else:
        if samples is not None or runs != 1:
            raise InputError("samples and runs: belong to a drawn motion; leave them out beside joint_position")
        drawn = given_motion(
            arm, joint_position, motion, time=time, payload=payload, warm_up=warm_up, settings=settings
        )
    return measure(
        drawn,
        arm,
        physics,
        physics.join([np.asarray(values, float) for _, values in parsed]),
        kinematics=kinematics,
        sensor=chosen,
        undeclared=undeclared,
        T_sensor_base=T_sensor_base,
        tool=tool,
        tool_known=tool_known,
        seed=seed,
    ).recording
