"""The information that a sensor's readings at given joint positions carry about a model's parameters.

Everything here is dimensionless: a reading counts in standard deviations of its noise, a parameter in units of the
tolerance that it plausibly has. What follows, indices, designs and null spaces, then does not depend on units.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from typing import Any, Literal, final

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lite6jax.arms import bundled
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.statics import inertia_of
from lite6jax.errors import InputError, require_type
from lite6jax.fitting.problem import Geometry, recording_problem
from lite6jax.fitting.residual import BLOCK, pad
from lite6jax.identifiability.readings import Numbers, reading_columns, total_information
from lite6jax.identifiability.sensor import Sensor, sensor_named
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings import Recording, require_radians
from lite6jax.recordings.units import real_array

Array = NDArray[np.floating]
Chain = Literal["hayati", "six_parameter"]
Approach = Literal["sequence", "zero"]

TOLERANCE = {"m": 0.8e-3, "rad": float(np.deg2rad(0.15))}
"""What assembly leaves in a length and an angle of a Lite 6, one standard deviation (the seed's simulated test)."""

RIGID = Physics()


@final
@dataclass(frozen=True, eq=False)
class Experiment:
    """Which model is to be identified with which sensor.

    Its parameters are the entries of a step of `form`, then the numbers of `physics`.

    Attributes:
        arm: the nominal arm; its masses cause the loads that effects depend on.
        form: the geometry, sensor frame and tool.
        model: where they are linearised; NumPy leaves.
        sensor: what is measured.
        movable: `(parameter,)` bool, those that are unknown.
        precision: `(parameter,)` the prior of each, one over its variance; zero is no prior.
        scale: `(parameter,)` the unit of each: its tolerance or typical size, SI.
        physics: effects beyond the rigid arm.
        values: `(physics.size,)` where those are linearised.
        payload: kg at the flange.
        approach: from where each pose is approached, on which effects of the direction of motion depend:
            the pose before it, for the first all joints at zero; or always all joints at zero.
    """

    arm: Arm
    form: ModelForm
    model: ArmModel
    sensor: Sensor
    movable: NDArray[np.bool_]
    precision: Array
    scale: Array
    physics: Physics = RIGID
    values: tuple[float, ...] = ()
    payload: float = 0.0
    approach: Approach = "sequence"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the unknown parameters."""
        return tuple(compress((*self.form.names, *self.physics.names), self.movable))

    @cached_property
    def units(self) -> tuple[str, ...]:
        """`m`, `rad`, or an effect's unit, of each."""
        return tuple(compress((*self.form.units, *self.physics.units), self.movable))

    @property
    def size(self) -> int:
        """How many are unknown."""
        return int(self.movable.sum())

    @cached_property
    def unit(self) -> Array:
        """`(size,)`, the tolerance or typical size of each unknown parameter, SI."""
        return self.scale[self.movable]

    @cached_property
    def prior(self) -> Array:
        """`(size, size)`, the information of the prior, in these units."""
        return np.diag(self.precision[self.movable] * self.unit**2)

    def rows(self, joint_position: ArrayLike) -> Array:
        """How readings change with the parameters.

        Args:
            joint_position: `(sample, joint)` rad.

        Returns:
            `(sample, row, size)`: standard deviations of a reading's numbers per tolerance of a parameter.

        Raises:
            InputError: joints that the arm does not have, or effects that poses at rest do not show.
        """
        q = checked_joints(self, joint_position)
        columns = np.asarray(_columns(self, q, direction(self, q)))
        return np.transpose(columns[self.movable], (2, 1, 0)) * self.unit

    def traced_rows(self, joint_position: jax.Array) -> jax.Array:
        """As `rows`, of and to JAX arrays, unchecked: to be differentiated by the joint positions."""
        columns = _columns(self, joint_position, direction(self, joint_position))
        return jnp.transpose(columns[self.movable], (2, 1, 0)) * self.unit

    def root(self, joint_position: ArrayLike) -> Array:
        """An upper triangular R `(size, size)` with RᵀR the information of readings at `joint_position`, without prior.

        By orthogonal steps, block by block: its singular values are those of the rows to rounding, where an
        eigenvalue of RᵀR would lose half the digits.
        """
        R = np.zeros((0, self.size))
        q = checked_joints(self, joint_position)
        for first, (block, towards) in zip(range(0, len(q), BLOCK), _blocks(self, q), strict=True):
            columns = np.asarray(_columns(self, block, towards))[self.movable, :, : len(q) - first]
            R = np.linalg.qr(np.concatenate([R, columns.reshape(self.size, -1).T * self.unit]), mode="r")
        return np.concatenate([R, np.zeros((self.size - len(R), self.size))])

    def information(self, joint_position: ArrayLike) -> Array:
        """The Fisher information `(size, size)` of readings at `joint_position` `(sample, joint)` and of the prior."""
        q = checked_joints(self, joint_position)
        blocks, directions = map(np.stack, zip(*_blocks(self, q), strict=True))
        weight = pad(np.ones(len(q)), 0, blocks.shape[0] * blocks.shape[1]).reshape(blocks.shape[:2])
        H = np.asarray(
            total_information(self.form, self.physics, self.sensor, self.numbers, blocks, directions, weight)
        )
        return H[np.ix_(self.movable, self.movable)] * np.outer(self.unit, self.unit) + self.prior

    def with_sensor(self, sensor: Sensor) -> "Experiment":
        """The same model with another sensor."""
        return replace(self, sensor=sensor)

    def with_physics(self, effects: Sequence[Effect], values: ArrayLike | None = None) -> "Experiment":
        """The same with these effects unknown too.

        Args:
            effects: in the order of their numbers.
            values: `(number,)` where they are linearised; neutral where not given.

        Raises:
            InputError: what poses at rest do not show, or what this chain cannot have; by name, with the remedy.
        """
        physics = Physics(tuple(effects))
        extended = replace(
            self,
            movable=np.concatenate([self.movable[: self.form.size], np.ones(physics.size, bool)]),
            precision=np.concatenate([self.precision[: self.form.size], np.zeros(physics.size)]),
            scale=np.concatenate([self.scale[: self.form.size], physics.typical]),
            physics=physics,
            values=(0.0,) * physics.size if values is None else tuple(map(float, np.asarray(values, float))),
        )
        extended.rows(np.zeros((1, self.arm.dof)))  # raises now rather than after a long computation
        return extended

    @cached_property
    def numbers(self) -> "Numbers":
        """What readings depend on beside the joints."""
        arm = self.arm
        inertia = None
        if arm.mass is not None and arm.center_of_mass is not None:
            inertia = inertia_of(arm.mass, arm.center_of_mass, arm.T_joint_flange[:3, 3])
        return Numbers(self.model, np.array(self.values, float), arm.kinematics.ravel(), inertia, self.payload)  # type: ignore[arg-type]


def direction(experiment: Experiment, q: Any) -> Any:
    """`(sample, joint)` −1, 0 or 1: the direction in which each joint approached, as recordings define it at rest.

    Args:
        experiment: its `approach` says from where.
        q: `(sample, joint)` rad, NumPy or JAX.
    """
    if experiment.approach == "zero" or not isinstance(q, np.ndarray):
        return jnp.sign(q) if isinstance(q, jax.Array) else np.sign(q)
    return np.sign(np.diff(q, axis=0, prepend=np.zeros((1, q.shape[1]))))


def _columns(experiment: Experiment, q: ArrayLike, direction: ArrayLike) -> jax.Array:
    e = experiment
    return reading_columns(e.form, e.physics, e.sensor, e.numbers, q, direction)  # type: ignore[arg-type]


def _blocks(experiment: Experiment, q: Array) -> Iterator[tuple[Array, Array]]:
    """Joint positions and directions in blocks of one shape, for which the readings are compiled once."""
    directions = direction(experiment, q)
    size = min(len(q), BLOCK)
    for first in range(0, len(q), size):
        yield pad(q[first : first + size], 0, size), pad(directions[first : first + size], 0, size)


def checked_joints(experiment: Experiment, joint_position: ArrayLike) -> Array:
    """Joint positions `(sample, joint)` rad of an experiment's arm.

    Raises:
        InputError: another shape, numbers that are not real or not finite, or degrees.
    """
    q, arm = real_array("joint_position", joint_position), experiment.arm
    if q.ndim != 2 or q.shape[1] != arm.dof or not len(q):
        raise InputError(f"joint_position of shape {q.shape}: {arm.name} takes (sample, {arm.dof})")
    if not np.isfinite(q).all():
        row = int(np.argmin(np.isfinite(q).all(1))) + 1
        raise InputError(f"joint_position: row {row} is not finite; leave it out")
    require_radians(q, arm.joint_limits)
    return q


def plan_experiment(
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
        tool_at: where it nominally is in the flange's frame, m. A point on the last joint's axis does not
            depend on that joint.

    Raises:
        InputError: no such bundled arm or sensor.
    """
    require_type("arm", arm, Arm | str, "an Arm or the name of a bundled one")
    arm = bundled.load_bundled(arm) if isinstance(arm, str) else arm
    sensor = sensor_named(sensor) if isinstance(sensor, str) else sensor
    geometry = arm.form if chain == "hayati" else SixParameterForm(arm.dof, arm.sliding)
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
    """An experiment of any model; all parameters are unknown and without a prior where not given."""
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
    """The experiment of a recording: what its sidecar leaves unknown, measured by its sensor.

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
