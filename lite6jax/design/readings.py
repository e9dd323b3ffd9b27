"""What a sensor reads of an arm at rest, and how that changes with every parameter of the arm, compiled."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from lite6jax.arms.chains import SixParameterForm, joint_motion
from lite6jax.arms.moves import Frame, Turn, Twist, cross, joint_rate
from lite6jax.design.sensor import Sensor, joint_whitener
from lite6jax.effects.composition import Physics
from lite6jax.effects.motion import Motion
from lite6jax.effects.sliding import Sliding
from lite6jax.effects.statics import Inertia, Loads, loads
from lite6jax.fitting.residual import predict_frames, step_order, twist_columns
from lite6jax.model import ArmModel, ModelForm, predict_frames_with


class Numbers(NamedTuple):
    """What readings depend on beside the joints. A pytree.

    Attributes:
        model: of the rigid arm.
        values: of its effects.
        kinematics: `(6 n,)` of the nominal six-parameter chain, whose frames the masses are given in.
        inertia: its masses, or None where they are not known.
        payload: kg.
    """

    model: ArmModel
    values: jax.Array
    kinematics: jax.Array
    inertia: Inertia | None
    payload: float | jax.Array


@partial(jax.jit, static_argnums=(0, 1, 2))
def reading_columns(
    form: ModelForm,
    physics: Physics,
    sensor: Sensor,
    numbers: Numbers,
    joint_position: jax.Array,
    direction: jax.Array,
) -> jax.Array:
    """How readings change with the parameters, `(parameter, row, sample)`: standard deviations per SI unit.

    Args:
        form, physics, sensor: static; the parameters are those of a step of `form`, then the numbers of `physics`.
        numbers: where.
        joint_position: `(sample, joint)` rad.
        direction: `(sample, joint)`, in which each pose was approached.
    """
    model, joint = numbers.model, joint_motion(form.chain, joint_position.T)
    if physics.effects:
        columns = _columns_with(form, physics, sensor, numbers, joint_position, direction)
    else:
        _, tool = predict_frames(form, model, joint)

        def emit(twist: Twist) -> jax.Array:
            return sensor.change(tool, twist)

        columns = twist_columns(form, model, joint, emit)[step_order(form)]
    if not sensor.joint_noise:
        return columns
    whitener = joint_whitener(joint_changes(form, sensor, model, joint), sensor.joint_noise)
    return jnp.sum(jnp.moveaxis(whitener, 0, -1)[None] * columns[:, None], 2)


def _columns_with(
    form: ModelForm,
    physics: Physics,
    sensor: Sensor,
    numbers: Numbers,
    joint_position: jax.Array,
    direction: jax.Array,
) -> jax.Array:
    """As `reading_columns`, by automatic differentiation: effects have no closed form in common."""
    moved_by = partial(tool_frame, form, physics, numbers, joint_position, direction)
    zero = jnp.zeros(form.size + physics.size)
    tool = moved_by(zero)

    def by(entry: jax.Array) -> jax.Array:
        return sensor.change(tool, _twist(tool, jax.jvp(moved_by, (zero,), (entry,))[1]))

    return jax.lax.map(by, jnp.eye(zero.size))


def tool_frame(
    form: ModelForm,
    physics: Physics,
    numbers: Numbers,
    joint_position: jax.Array,
    direction: jax.Array,
    step: jax.Array,
) -> Frame:
    """The tool's frame in sensor coordinates of an arm at rest, a step `(parameter,)` away; plain JAX.

    Args:
        form, physics: static.
        numbers: where from.
        joint_position: `(sample, joint)` rad.
        direction: `(sample, joint)`, in which each pose was approached.
        step: of `form`, then of `physics`.
    """
    model, values = form.retract(numbers.model, step[: form.size]), numbers.values + step[form.size :]
    if not physics.effects:
        return predict_frames(form, model, joint_motion(form.chain, joint_position.T))[1]
    samples = joint_position.shape[0]
    motion = Motion(
        joint_position=joint_position.T,
        joint_velocity=None,
        direction=direction.T,
        time=None,
        run=jnp.stack([jnp.zeros(samples, int), jnp.full(samples, samples - 1)]),
        temperature_rise=None,
        payload=jnp.full(samples, numbers.payload),
        sliding=Sliding(form.chain.sliding),
    )
    statics: Inertia | Loads | None = numbers.inertia
    if statics is not None and not isinstance(form.chain, SixParameterForm):  # its frames are not those of the masses
        nominal = SixParameterForm(form.chain.dof, form.chain.sliding)
        joint = joint_motion(nominal, joint_position.T)
        statics = loads(nominal, numbers.kinematics, joint, motion.payload, statics)
    return predict_frames_with(form.chain, physics, model, values, motion, statics)[1]


def joint_changes(form: ModelForm, sensor: Sensor, model: ArmModel, joint: Turn) -> jax.Array:
    """How whitened readings change with the revolute joints, `(row, joint, sample)` per rad: the manipulator Jacobian.

    Prismatic joints are read without noise.
    """
    _, tool = predict_frames(form, model, joint)

    def by(direction: jax.Array) -> jax.Array:
        turning = joint_rate(joint, direction, form.chain.sliding)
        moved = jax.jvp(lambda j: predict_frames(form, model, j)[1], (joint,), (turning,))[1]
        return sensor.change(tool, _twist(tool, moved))

    turning = [joint for joint in range(form.chain.dof) if joint not in form.chain.sliding]
    return jnp.moveaxis(jax.vmap(by)(jnp.eye(form.chain.dof)[np.array(turning)]), 0, 1)


def _twist(frame: Frame, moved: Frame) -> Twist:
    """The twist, at the fixed origin, of a frame whose derivative is `moved`."""
    # R' Rᵀ is skew: its entries below the diagonal are the angular velocity
    spin = jnp.stack([sum(moved[k][a] * frame[k][b] for k in range(3)) for a, b in ((2, 1), (0, 2), (1, 0))])
    return Twist(moved.origin - cross(spin, frame.origin), spin)


@partial(jax.jit, static_argnums=(0, 1, 2))
def total_information(
    form: ModelForm,
    physics: Physics,
    sensor: Sensor,
    numbers: Numbers,
    blocks: jax.Array,
    directions: jax.Array,
    weight: jax.Array,
) -> jax.Array:
    """The information `(parameter, parameter)` of readings, in SI units, summed block by block.

    Args:
        form, physics, sensor, numbers: as in `reading_columns`.
        blocks, directions: `(block, sample, joint)`.
        weight: `(block, sample)`, 0 for filling.
    """
    size = form.size + physics.size

    def add(total: jax.Array, block: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        q, direction, w = block
        J = (reading_columns(form, physics, sensor, numbers, q, direction) * w).reshape(size, -1)
        return total + J @ J.T, None

    return jax.lax.scan(add, jnp.zeros((size, size)), (blocks, directions, weight))[0]
