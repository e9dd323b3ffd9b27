"""The arm as a sensor sees it: a chain, the sensor's frame in front of it and a tool behind."""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from lite6jax.arms.chains import Form, fk
from lite6jax.arms.se3 import rotation_exp, transform

TWIST_NAMES = ("x", "y", "z", "rx", "ry", "rz")


class ArmModel(NamedTuple):
    """The numbers of an arm. A pytree; a fleet has a leading arm axis on each leaf.

    Attributes:
        geometry: the chain's parameters `(size,)`, in m and rad.
        T_sensor_base: `(4, 4)`, the arm's base in the frame in which poses are measured.
        T_flange_tool: `(4, 4)`, the measured point or probe in the last joint's frame; an arm's own
            `T_joint_flange` is part of it.
    """

    geometry: Array
    T_sensor_base: Array
    T_flange_tool: Array


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

    def retract(self, model: ArmModel, step: Array) -> ArmModel:
        """The model a step `(size,)` away; rotations move along their tangent, never through Euler angles."""
        n = self.chain.size
        geometry, T_sensor_base, T_flange_tool = model
        if self.frame:
            shift, spin = step[n : n + 3], step[n + 3 : n + 6]
            R = rotation_exp(spin) @ T_sensor_base[:3, :3]
            T_sensor_base = transform(R, T_sensor_base[:3, 3] + shift)
        if self.tool:
            shift, spin = step[-6:-3], step[-3:]
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
def predict(chain: Form, model: ArmModel, joint_position: ArrayLike) -> Array:
    """The poses `T_sensor_tool` `(..., 4, 4)` that the sensor would show at `joint_position` `(..., joint)` rad."""
    return model.T_sensor_base @ fk(chain, model.geometry, joint_position) @ model.T_flange_tool
