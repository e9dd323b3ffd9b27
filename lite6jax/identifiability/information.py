"""The information that a sensor's readings at given joint positions carry about a model's parameters.

Everything here is dimensionless: a reading counts in standard deviations of its noise, a parameter in units of the
tolerance that it plausibly has. What follows, indices, designs and null spaces, then does not depend on units.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms import bundled
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm, Turn, Twist, turn
from lite6jax.errors import InputError
from lite6jax.fitting.fleet import BLOCK, pad
from lite6jax.fitting.problem import Geometry, recording_problem
from lite6jax.fitting.residual import predict_frames, step_order, twist_columns
from lite6jax.identifiability.sensor import Sensor, joint_whitener, sensor_named
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings import Recording

Array = NDArray[np.floating]
Chain = Literal["hayati", "six_parameter"]

TOLERANCE = {"m": 0.8e-3, "rad": float(np.deg2rad(0.15))}
"""What assembly leaves in a length and an angle of a Lite 6, one standard deviation (the seed's simulated test)."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """Which model is to be identified with which sensor.

    Attributes:
        arm: the nominal arm.
        form: the parameters.
        model: where they are linearised; NumPy leaves.
        sensor: what is read.
        movable: `(size,)` bool, the parameters that are unknown.
        precision: `(size,)` what is known of them beforehand, 1/m² or 1/rad²; zero is nothing.
        scale: `(size,)` the unit each counts in, m or rad.
    """

    arm: Arm
    form: ModelForm
    model: ArmModel
    sensor: Sensor
    movable: NDArray[np.bool_]
    precision: Array
    scale: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknown parameters."""
        return tuple(name for name, moves in zip(self.form.names, self.movable, strict=True) if moves)

    @property
    def units(self) -> tuple[str, ...]:
        """`m` or `rad` of each."""
        return tuple(unit for unit, moves in zip(self.form.units, self.movable, strict=True) if moves)

    @property
    def size(self) -> int:
        """How many are unknown."""
        return int(self.movable.sum())

    @cached_property
    def unit(self) -> Array:
        """`(size,)` m or rad: what 1 of an unknown parameter means here."""
        return self.scale[self.movable]

    @cached_property
    def prior(self) -> Array:
        """`(size, size)` the information there is beforehand, in these units."""
        return np.diag(self.precision[self.movable] * self.unit**2)

    def rows(self, joint_position: ArrayLike) -> Array:
        """How readings change with the parameters.

        Args:
            joint_position: `(sample, joint)` rad.

        Returns:
            `(sample, row, size)`: standard deviations of a reading's numbers per tolerance of a parameter.

        Raises:
            InputError: joints that the arm does not have.
        """
        q = self._checked(joint_position)
        columns = np.asarray(_columns(self.form, self.sensor, self.model, q))
        return np.transpose(columns[self.movable], (2, 1, 0)) * self.unit

    def root(self, joint_position: ArrayLike) -> Array:
        """An upper triangular R `(size, size)` with RᵀR the information of readings at `joint_position`, without prior.

        By orthogonal steps, block by block: its singular values are those of the rows to rounding, where an
        eigenvalue of RᵀR would lose half the digits.
        """
        q = self._checked(joint_position)
        R = np.zeros((0, self.size))
        for first in range(0, len(q), BLOCK):
            block = q[first : first + BLOCK]
            full = pad(block, 0, BLOCK) if len(q) > BLOCK else block  # of one shape: compiled once
            columns = np.asarray(_columns(self.form, self.sensor, self.model, full))[self.movable, :, : len(block)]
            rows = columns.reshape(self.size, -1).T * self.unit
            R = np.linalg.qr(np.concatenate([R, rows]), mode="r")
        return np.concatenate([R, np.zeros((self.size - len(R), self.size))])

    def information(self, joint_position: ArrayLike) -> Array:
        """The Fisher information `(size, size)` of readings at `joint_position` `(sample, joint)` and of the prior."""
        q = self._checked(joint_position)
        size = -(-len(q) // BLOCK) * BLOCK if len(q) > BLOCK else len(q)
        weight = pad(np.ones(len(q)), 0, size).reshape(-1, min(size, BLOCK))
        blocks = pad(q, 0, size).reshape(*weight.shape, -1)
        H = np.asarray(_information(self.form, self.sensor, self.model, blocks, weight))
        return H[np.ix_(self.movable, self.movable)] * np.outer(self.unit, self.unit) + self.prior

    def with_sensor(self, sensor: Sensor) -> "Experiment":
        """The same model seen by another sensor."""
        return replace(self, sensor=sensor)

    def _checked(self, joint_position: ArrayLike) -> Array:
        q = np.asarray(joint_position, float)
        if q.ndim != 2 or q.shape[1] != self.arm.dof or not len(q):
            raise InputError(f"joint_position of shape {q.shape}: {self.arm.name} takes (sample, {self.arm.dof})")
        if not np.isfinite(q).all():
            row = int(np.argmin(np.isfinite(q).all(1))) + 1
            raise InputError(f"joint_position: row {row} is not finite; leave it out")
        return q


def plan(
    arm: Arm | str,
    sensor: Sensor | str = "tracker",
    *,
    chain: Chain = "hayati",
    frame: bool = True,
    tool: bool = False,
    tool_at: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Experiment:
    """An experiment to come, on an arm at its nominal geometry.

    Args:
        arm: an `Arm` or a bundled name.
        sensor: a `Sensor` or a name of `SENSORS`.
        chain: the parameters of the geometry: `hayati` (4 n + 4, all determined by poses), or `six_parameter` (6 n, as
            in a factory file).
        frame: whether the sensor's frame is unknown too.
        tool: whether the tool is.
        tool_at: where it nominally is in the flange's frame, m. A point on the last joint's axis does not feel that
            joint turn.

    Raises:
        InputError: no such bundled arm or sensor.
    """
    arm = bundled.load_bundled(arm) if isinstance(arm, str) else arm
    sensor = sensor_named(sensor) if isinstance(sensor, str) else sensor
    geometry = arm.form if chain == "hayati" else SixParameterForm(arm.dof)
    values = arm.hayati if chain == "hayati" else arm.kinematics.ravel()
    form = ModelForm(geometry, frame, tool)
    T_joint_tool = np.array(arm.T_joint_flange)
    T_joint_tool[:3, 3] += T_joint_tool[:3, :3] @ np.asarray(tool_at, float)
    model = ArmModel(values, np.eye(4), T_joint_tool)  # type: ignore[arg-type]
    return experiment(arm, form, model, sensor)


def experiment(
    arm: Arm,
    form: ModelForm,
    model: ArmModel,
    sensor: Sensor,
    movable: NDArray[np.bool_] | None = None,
    precision: Array | None = None,
) -> Experiment:
    """An experiment of any model; all parameters are unknown, and nothing known beforehand, where not said."""
    return Experiment(
        arm=arm,
        form=form,
        model=ArmModel(*(np.asarray(leaf) for leaf in model)),  # type: ignore[arg-type]
        sensor=sensor,
        movable=np.ones(form.size, bool) if movable is None else movable,
        precision=np.zeros(form.size) if precision is None else precision,
        scale=np.array([TOLERANCE[unit] for unit in form.units]),
    )


def recorded(recording: Recording, arm: Arm | None = None, geometry: Geometry = "declared") -> Experiment:
    """The experiment that a recording is: what its sidecar leaves unknown, seen by its sensor.

    Raises:
        InputError: as `recording_problem`; nothing unknown.
    """
    problem = recording_problem(recording, arm, geometry)
    if not problem.movable.any():
        raise InputError(
            f"{recording.source}: its sidecar declares geometry, sensor frame and tool: nothing is left to identify; "
            f"use --geometry free"
        )
    position, orientation = problem.noise
    quantity = "position" if orientation is None else "pose"
    return experiment(
        problem.arm,
        problem.form,
        problem.start,
        Sensor(quantity, position, orientation, joint_noise=problem.joint_noise),
        problem.movable,
        problem.precision,
    )


@partial(jax.jit, static_argnums=(0, 1))
def _columns(form: ModelForm, sensor: Sensor, model: ArmModel, joint_position: jax.Array) -> jax.Array:
    """`(parameter, row, sample)`: standard deviations per m or rad."""
    joint = turn(joint_position.T)
    flange, tool = predict_frames(form, model, joint)

    def emit(twist: Twist) -> jax.Array:
        return sensor.change(tool, twist)

    columns = twist_columns(form, model, joint, flange, tool, emit)[step_order(form)]
    if not sensor.joint_noise:
        return columns
    whitener = joint_whitener(joint_changes(form, sensor, model, joint), sensor.joint_noise)
    return jnp.sum(jnp.moveaxis(whitener, 0, -1)[None] * columns[:, None], 2)


def joint_changes(form: ModelForm, sensor: Sensor, model: ArmModel, joint: Turn) -> jax.Array:
    """How whitened readings change with the joints, `(row, joint, sample)` per rad: the manipulator Jacobian."""
    _, tool = predict_frames(form, model, joint)

    def by(direction: jax.Array) -> jax.Array:
        turning = Turn(-direction[:, None] * joint.sin, direction[:, None] * joint.cos)
        _, moved = jax.jvp(lambda j: predict_frames(form, model, j)[1], (joint,), (turning,))
        # R' Rᵀ is skew: its entries below the diagonal are the angular velocity
        spin = jnp.stack([sum(moved[k][a] * tool[k][b] for k in range(3)) for a, b in ((2, 1), (0, 2), (1, 0))])
        linear = moved.origin - jnp.cross(spin, tool.origin, axis=0)
        return sensor.change(tool, Twist(linear, spin))

    return jnp.moveaxis(jax.vmap(by)(jnp.eye(form.chain.dof)), 0, 1)


@partial(jax.jit, static_argnums=(0, 1))
def _information(form: ModelForm, sensor: Sensor, model: ArmModel, blocks: jax.Array, weight: jax.Array) -> jax.Array:
    def add(total: jax.Array, block: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, None]:
        q, w = block
        J = (_columns(form, sensor, model, q) * w).reshape(form.size, -1)
        return total + J @ J.T, None

    return jax.lax.scan(add, jnp.zeros((form.size, form.size)), (blocks, weight))[0]
