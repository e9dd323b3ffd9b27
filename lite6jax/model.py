"""The arm as a sensor sees it: a chain, the sensor's frame in front of it, a tool behind, and physics within."""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from lite6jax.arms.chains import Bend, Form, fk, joint_motion, sweep
from lite6jax.arms.se3 import Frame, base_frame, displace, frame_transform, rotation_exp, transform
from lite6jax.effects.composition import Physics
from lite6jax.effects.deflection import Deflection
from lite6jax.effects.motion import Motion
from lite6jax.effects.statics import Inertia, Loads, loads
from lite6jax.errors import InputError

LEVER = 0.1
"""m: the lever arm by which rotations are weighed against translations where no noise is declared, as in the seed."""
TWIST_NAMES = ("x", "y", "z", "rx", "ry", "rz")


class ArmModel(NamedTuple):
    """The numbers of an arm. A pytree; a fleet has a leading arm axis on each leaf.

    Attributes:
        geometry: the chain's parameters `(size,)`, in m and rad.
        T_sensor_base: `(4, 4)`, the arm's base in the frame in which poses are measured.
        T_flange_tool: `(4, 4)`, the measured point or probe in the last joint's frame; an arm's own
            `T_joint_flange` is part of it.
    """

    geometry: jax.Array
    T_sensor_base: jax.Array
    T_flange_tool: jax.Array


@dataclass(frozen=True)
class ModelForm:
    """Which numbers of an `ArmModel` a fit moves. Hashable: a static argument.

    A step `(size,)` holds the geometry's increments, then, with `frame`, the sensor frame's, then, with `tool`, the
    tool's: a translation (m) and a rotation vector (rad). The sensor's are about the base origin in sensor axes,
    the tool's about the tool point in flange axes (translation) and tool axes (rotation).
    """

    chain: Form
    frame: bool = False
    tool: bool = False

    @property
    def size(self) -> int:
        """The length of a step."""
        return self.chain.size + 6 * (self.frame + self.tool)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The name of each entry of a step."""
        frame = [f"frame_{name}" for name in TWIST_NAMES] if self.frame else []
        tool = [f"tool_{name}" for name in TWIST_NAMES] if self.tool else []
        return (*self.chain.names, *frame, *tool)

    @cached_property
    def units(self) -> tuple[str, ...]:
        """`m` or `rad` for each entry of a step."""
        return (*self.chain.units, *(("m", "m", "m", "rad", "rad", "rad") * (self.frame + self.tool)))

    def retract(self, model: ArmModel, step: jax.Array) -> ArmModel:
        """The model a step `(size,)` away; rotations move along their tangent, never through Euler angles."""
        n = self.chain.size
        geometry, T_sensor_base, T_flange_tool = model
        if self.frame:
            shift = step[n : n + 3]
            spin = step[n + 3 : n + 6]
            R = rotation_exp(spin) @ T_sensor_base[:3, :3]
            T_sensor_base = transform(R, T_sensor_base[:3, 3] + shift)
        if self.tool:
            shift = step[-6:-3]
            spin = step[-3:]
            R = T_flange_tool[:3, :3] @ rotation_exp(spin)
            T_flange_tool = transform(R, T_flange_tool[:3, 3] + shift)
        return ArmModel(geometry + step[:n], T_sensor_base, T_flange_tool)


def arm_model(
    geometry: ArrayLike, T_sensor_base: ArrayLike | None = None, T_flange_tool: ArrayLike | None = None
) -> ArmModel:
    """An `ArmModel`; a frame that is not given is the identity."""
    eye = jnp.eye(4)
    return ArmModel(
        jnp.asarray(geometry, float),
        eye if T_sensor_base is None else jnp.asarray(T_sensor_base, float),
        eye if T_flange_tool is None else jnp.asarray(T_flange_tool, float),
    )


@partial(jax.jit, static_argnums=0)
def predict(chain: Form, model: ArmModel, joint_position: ArrayLike) -> jax.Array:
    """The poses `T_sensor_tool` `(..., 4, 4)` that the sensor would show at `joint_position` `(..., joint)` rad."""
    return model.T_sensor_base @ fk(chain, model.geometry, joint_position) @ model.T_flange_tool


def predict_frames_with(
    chain: Form,
    physics: Physics,
    model: ArmModel,
    values: jax.Array,
    motion: Motion,
    statics: Inertia | Loads | None = None,
) -> tuple[Frame, Frame]:
    """The flange's and the tool's frames in sensor coordinates, of an arm with `physics`; plain JAX.

    Effects of clock and payload alter the motion; gravity's loads are those of the rigid chain in that motion; the
    deflections of all other effects add up; `predict_bent` composes them.

    Args:
        chain: which chain. Effects of links, and loads from masses, need the six-parameter chain.
        physics: which effects; static.
        model: the rigid arm.
        values: `(physics.size,)`.
        motion: the whole sequence, where an effect of the clock looks at neighbours.
        statics: the masses; or the loads themselves, which then stay as they are; or None where no effect needs them.

    Raises:
        InputError: the motion lacks what an effect needs, by name; or is one of another number of joints; the chain is
            not one that the effects can bend; or loads are given where an effect would change them.
    """
    if motion.dof != chain.dof:
        raise InputError(f"motion: has {motion.dof} joints, and the chain {chain.dof}; give that arm's motion")
    if any(driver.quantity.startswith("measured position") for e in physics.effects for driver in e.drivers):
        _, shown = predict_bent(chain, model, motion.joint_position, Deflection())
        motion = motion._replace(measured_position=shown.origin)  # nothing is measured of a motion that is predicted
    physics.check(motion, statics is not None)
    if isinstance(statics, Loads) and physics.loaded and physics.altering:
        raise InputError(
            f"{physics.altering[0].label}: changes the loads, and they are given; give the masses instead, with the "
            "six-parameter chain"
        )
    motion = physics.alter(values, motion)
    if isinstance(statics, Inertia):
        inertia = physics.alter_inertia(values, statics)
        joint = joint_motion(chain, motion.joint_position)
        moving = motion.joint_velocity, motion.joint_acceleration
        loaded = physics.loaded
        statics = None
        if loaded:
            statics = loads(chain, model.geometry, joint, motion.payload, inertia, *moving)
    return predict_bent(chain, model, motion.joint_position, physics.deflect(values, motion, statics))


def predict_bent(
    chain: Form, model: ArmModel, joint_position: jax.Array, deflection: Deflection
) -> tuple[Frame, Frame]:
    """The flange's and the tool's frames in sensor coordinates, of a deflected arm; plain JAX.

    In this order: (1 + scale) · sensor twist · T_sensor_base · base twist · ∏ [origin (1 + stretch), Rz(q + δq), link
    twist] · tool twist · T_flange_tool, where the scale is one of positions and a twist is a translation and then a
    rotation; a prismatic joint has Tz(q + δq). The flange is the last joint's frame before the tool twist.

    Args:
        chain: which chain; `stretch` and `link` need the six-parameter chain.
        model: the rigid arm.
        joint_position: `(joint, sample)` rad, and m of prismatic joints.
        deflection: None in it costs nothing.

    Raises:
        InputError: a link's deflection of a Hayati chain.
    """
    angle = joint_position if deflection.joint is None else joint_position + deflection.joint
    start = base_frame(model.T_sensor_base, angle.shape[-1])
    if deflection.sensor is not None:
        start = _mounted(displace(base_frame(jnp.eye(4), angle.shape[-1]), deflection.sensor), model.T_sensor_base)
    if deflection.base is not None:
        start = displace(start, deflection.base)
    bent = deflection.stretch is not None or deflection.link is not None
    bend = Bend(deflection.stretch, deflection.link) if bent else None
    flange, _ = sweep(chain, model.geometry, joint_motion(chain, angle), start, bend=bend)
    end = flange if deflection.tool is None else displace(flange, deflection.tool)
    tool = _mounted(end, model.T_flange_tool)
    if deflection.scale is None:
        return flange, tool
    growth = 1 + deflection.scale
    return flange._replace(origin=growth * flange.origin), tool._replace(origin=growth * tool.origin)


def _mounted(frame: Frame, T: jax.Array) -> Frame:
    """What is fixed to a moving frame at `T` `(4, 4)`."""
    axes = [T[0, i] * frame.x + T[1, i] * frame.y + T[2, i] * frame.z for i in range(4)]
    return Frame(axes[0], axes[1], axes[2], frame.origin + axes[3])


@partial(jax.jit, static_argnums=(0, 1))
def predict_poses(
    chain: Form,
    physics: Physics,
    model: ArmModel,
    values: ArrayLike,
    motion: Motion,
    statics: Inertia | Loads | None = None,
) -> jax.Array:
    """The poses `T_sensor_tool` `(sample, 4, 4)` that the sensor would show; as `predict_frames_with`.

    Rows for which `physics.beyond` is true are extrapolated and mean nothing.
    """
    _, tool = predict_frames_with(chain, physics, model, jnp.asarray(values, float), motion, statics)
    return frame_transform(tool)
