"""The information that a sensor's readings at given joint positions carry about a model's parameters.

Everything here is dimensionless: a reading counts in standard deviations of its noise, a parameter in units of the
tolerance that it plausibly has. What follows, indices, designs and null spaces, then does not depend on units.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import compress
from typing import Any, Literal, final

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from lite6jax.arms import description
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm, joint_motion
from lite6jax.arms.se3 import Frame, Twist, cross, frame_transform
from lite6jax.array_types import Array, Mask
from lite6jax.calibration.problem import Geometry, recording_problem
from lite6jax.calibration.residual import BLOCK, predict_frames, step_order, twist_columns
from lite6jax.design.determination import accumulate_root, each_block
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.motion import Motion, Sliding
from lite6jax.effects.statics import Inertia, Loads, loads
from lite6jax.errors import InputError, require_type
from lite6jax.model import ArmModel, ModelForm, predict_frames_with
from lite6jax.recordings import Recording, RecordingSettings, require_radians
from lite6jax.recordings.motion import inertia_of_arm
from lite6jax.recordings.units import real_array
from lite6jax.sensors.sensor import OwnNumber, Sensor
from lite6jax.sensors.usual import plan_sensor, sensor_named

Chain = Literal["hayati", "six_parameter"]
Approach = Literal["sequence", "zero"]

TOLERANCE = {"m": 0.8e-3, "rad": float(np.deg2rad(0.15))}
"""What assembly leaves in a length and an angle of a Lite 6, one standard deviation."""
WITHIN_REACH = {"m": 0.3, "rad": 0.5}
"""One standard deviation of a place that is planned about where it will be."""


def _displacement(frame: Frame, moved: Frame) -> jax.Array:
    """The shift and the turn `(6, sample)` of a frame whose derivative is `moved`."""
    # R' Rᵀ is skew: its entries below the diagonal are the angular velocity
    turn = [sum(moved[k][a] * frame[k][b] for k in range(3)) for a, b in ((2, 1), (0, 2), (1, 0))]
    return jnp.concatenate([moved.origin, jnp.stack(turn)])


@partial(jax.jit, static_argnums=(0, 1))
def _tool_motions(
    form: ModelForm,
    physics: Physics,
    model: ArmModel,
    values: jax.Array,
    kinematics: jax.Array,
    statics: Inertia | Loads | None,
    payload: float,
    q: jax.Array,
    direction: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """The tools `(sample, 4, 4)`, and how they shift and turn with the parameters, `(parameter, 6, sample)`.

    Both are in the sensor's coordinates, at rest at joint positions `q` `(sample, joint)` rad, each of which was
    approached in a `direction`. The masses `statics` stand in the frames of the six-parameter chain `kinematics`
    `(6 n,)`. Where `form` has another chain, their loads are computed once, by `kinematics`, and do not change with the
    parameters. `values` are the numbers of the effects, and `payload` is in kg.
    """
    run = jnp.zeros((2, len(q)), int).at[1].set(len(q) - 1)
    payloads = jnp.full(len(q), payload)
    sliding = Sliding(form.chain.sliding)
    motion = Motion(q.T, None, direction.T, None, run, temperature_rise=None, payload=payloads, sliding=sliding)
    if isinstance(statics, Inertia) and not isinstance(form.chain, SixParameterForm):
        joint = joint_motion(motion.chain, motion.joint_position)
        statics = loads(motion.chain, kinematics, joint, motion.payload, statics)

    def moved(step: jax.Array) -> Frame:
        arm = form.retract(model, step[: form.size])
        numbers = values + step[form.size :]
        return predict_frames_with(form.chain, physics, arm, numbers, motion, statics)[1]

    zero = jnp.zeros(form.size + physics.size)
    tool = moved(zero)
    if physics.effects:  # they have no closed form in common
        motions = jax.lax.map(lambda step: _displacement(*jax.jvp(moved, (zero,), (step,))), jnp.eye(len(zero)))
    else:

        def displace(twist: Twist) -> jax.Array:
            if twist.angular is None:
                return jnp.concatenate([twist.linear, jnp.zeros_like(twist.linear)])
            return jnp.concatenate([twist.linear + cross(twist.angular, tool.origin), twist.angular])

        joint = joint_motion(form.chain, motion.joint_position)
        motions = twist_columns(form, model, joint, displace)[step_order(form)]
    return frame_transform(tool), motions


@partial(jax.jit, static_argnums=0)
def _joint_motions(form: ModelForm, model: ArmModel, q: jax.Array) -> jax.Array:
    """How the rigid arm's tool shifts and turns with the revolute joints, `(joint, 6, sample)`."""

    def moved(shift: jax.Array) -> Frame:
        return predict_frames(form, model, joint_motion(form.chain, q.T + shift[:, None]))[1]

    still = jnp.zeros(form.chain.dof)
    turning = np.delete(np.eye(form.chain.dof), form.chain.sliding, axis=0)
    return jax.vmap(lambda direction: _displacement(*jax.jvp(moved, (still,), (direction,))))(turning)


@final
@dataclass(frozen=True, eq=False)
class Experiment:
    """Which model is to be identified with which sensor.

    Its parameters are the entries of a step of `form`, the sensor's own unknowns, then the numbers of `physics`.

    Attributes:
        arm: the nominal arm; its masses cause the loads that effects depend on.
        form: the geometry, sensor frame and tool.
        model: where they are linearised.
        sensor: what is measured. Its own unknowns, as points that are touched, are somewhere within reach.
        movable: `(form.size,)` bool, which entries of a step are unknown; all where not given.
        precision: `(form.size,)` the prior of each, one over its variance; zero is no prior, and none is where not
            given.
        physics: effects beyond the rigid arm, all unknown.
        values: `(physics.size,)` where those are linearised.
        payload: kg at the flange.
        approach: from where each pose is approached, on which effects of the direction of motion depend:
            the pose before it, for the first all joints at zero; or always all joints at zero.
    """

    arm: Arm
    form: ModelForm
    model: ArmModel
    sensor: Sensor
    movable: Any = None
    precision: Any = None
    physics: Physics = field(default_factory=Physics)
    values: tuple[float, ...] = ()
    payload: float = 0.0
    approach: Approach = "sequence"

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", ArmModel(*(np.asarray(leaf) for leaf in self.model)))  # type: ignore[arg-type]
        if self.movable is None:
            object.__setattr__(self, "movable", np.ones(self.form.size, bool))
        if self.precision is None:
            object.__setattr__(self, "precision", np.zeros(self.form.size))

    @cached_property
    def own(self) -> tuple[OwnNumber, ...]:
        """The unknowns that the sensor has, each with a name of its own."""
        names = [number.name for number in self.sensor.own]
        return tuple(
            number._replace(name=f"{number.name} {names[:k].count(number.name) + 1}")
            if names.count(number.name) > 1
            else number
            for k, number in enumerate(self.sensor.own)
        )

    @cached_property
    def unknown(self) -> Mask:
        """`(parameter,)`, which of all parameters are unknown."""
        return np.concatenate([self.movable, np.ones(len(self.own) + self.physics.size, bool)])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the unknown parameters."""
        sensor_names = (number.name for number in self.own)
        return tuple(compress((*self.form.names, *sensor_names, *self.physics.names), self.unknown))

    @cached_property
    def units(self) -> tuple[str, ...]:
        """`m`, `rad`, or an effect's unit, of each."""
        sensor_units = (number.unit for number in self.own)
        return tuple(compress((*self.form.units, *sensor_units, *self.physics.units), self.unknown))

    @property
    def size(self) -> int:
        """How many are unknown."""
        return int(self.unknown.sum())

    @cached_property
    def unit(self) -> Array:
        """`(size,)`, the tolerance or typical size of each unknown parameter, SI."""
        tolerances = [TOLERANCE[unit] for unit in (*self.form.units, *(number.unit for number in self.own))]
        return np.concatenate([tolerances, self.physics.typical])[self.unknown]

    @cached_property
    def prior(self) -> Array:
        """`(size, size)`, the information of the prior, in these units; diagonal."""
        sensor_precision = [number.precision or WITHIN_REACH[number.unit] ** -2.0 for number in self.own]
        precision = np.concatenate([self.precision, sensor_precision, np.zeros(self.physics.size)])
        return np.diag(precision[self.unknown] * self.unit**2)

    @cached_property
    def _numbers(self) -> tuple[Any, ...]:
        """What `_tool_motions` takes beside the joints."""
        inertia = inertia_of_arm(self.arm, RecordingSettings()) if self.physics.effects else None
        return self.model, np.array(self.values, float), self.arm.kinematics.ravel(), inertia, self.payload

    def direction(self, joint_position: Array) -> Array:
        """`(sample, joint)` −1, 0 or 1: the direction in which each joint approached positions `(sample, joint)`."""
        if self.approach == "zero":
            return np.sign(joint_position)
        return np.sign(np.diff(joint_position, axis=0, prepend=np.zeros((1, joint_position.shape[1]))))

    def rows(self, joint_position: ArrayLike) -> Array:
        """How readings at `(sample, joint)` rad change with the parameters.

        Returns:
            `(sample, row, size)`: standard deviations of a reading's numbers per tolerance of a parameter.

        Raises:
            InputError: joints that the arm does not have, or effects that poses at rest do not show.
        """
        return np.transpose(np.concatenate(list(self._blocks(joint_position)), 2), (2, 1, 0)) * self.unit

    def root(self, joint_position: ArrayLike) -> Array:
        """`accumulate_root` of readings at `joint_position` `(sample, joint)` rad, without prior, per tolerance."""
        return self.unit * accumulate_root(self._blocks(joint_position), self.size)

    def _blocks(self, joint_position: ArrayLike) -> Iterator[Array]:
        """`_columns`, a block of samples at a time."""
        q = check_joints(self, joint_position)
        return each_block(self._columns, (q, self.direction(q)), min(len(q), BLOCK))

    def _columns(self, q: Array, direction: Array) -> Array:
        """`(size, row, sample)`, of the unknown parameters, per SI unit."""
        tool, motions = map(np.asarray, _tool_motions(self.form, self.physics, *self._numbers, q, direction))
        slopes, sensor_columns = self.sensor.columns_of_plan(tool)
        columns = np.einsum("rks,pks->prs", slopes, motions)
        columns = np.concatenate([columns[: self.form.size], sensor_columns, columns[self.form.size :]])[self.unknown]
        if not self.sensor.joint_noise:
            return columns
        # with J the change of whitened readings per rad of the joints, and I + σ² J Jᵀ = L Lᵀ, L⁻¹ whitens them again
        J = np.einsum("rks,jks->srj", slopes, np.asarray(_joint_motions(self.form, self.model, q)))  # type: ignore[arg-type]
        L = np.linalg.cholesky(np.eye(len(slopes)) + self.sensor.joint_noise**2 * J @ np.swapaxes(J, 1, 2))
        return np.transpose(np.linalg.solve(L, np.transpose(columns)), (2, 1, 0))

    def error_rows(self, joint_position: ArrayLike) -> Array:
        """How the tool's pose changes with the parameters, `(sample, 6, size)` m and rad per tolerance.

        A sensor with unknown places of its own determines no base: then but for the displacement of the base that
        moves the positions as nearly alike.
        """
        q = check_joints(self, joint_position)
        tool, motions = map(np.asarray, _tool_motions(self.form, self.physics, *self._numbers, q, self.direction(q)))
        motions = np.insert(motions, [self.form.size] * len(self.own), 0.0, axis=0)[self.unknown]
        J = np.transpose(motions, (2, 1, 0)) * self.unit
        if not self.own:
            return J
        base = np.tile(np.eye(6), (len(q), 1, 1))
        base[:, :3, 3:] = np.cross(np.eye(3), tool[:, None, :3, 3]).swapaxes(1, 2)
        base_displacement = np.linalg.lstsq(base[:, :3].reshape(-1, 6), J[:, :3].reshape(-1, self.size), rcond=None)[0]
        return J - base @ base_displacement

    def with_physics(self, effects: Sequence[Effect], values: ArrayLike | None = None) -> "Experiment":
        """The same with these effects unknown too, linearised at `values` `(number,)`, or where they are neutral.

        Raises:
            InputError: what poses at rest do not show, or what this chain cannot have; by name, with the remedy.
        """
        physics = Physics(tuple(effects))
        values = np.zeros(physics.size) if values is None else np.asarray(values, float)
        extended = replace(self, physics=physics, values=tuple(values.tolist()))
        extended.rows(np.zeros((1, self.arm.dof)))  # raises now rather than after a long computation
        return extended


def check_joints(experiment: Experiment, joint_position: ArrayLike) -> Array:
    """Joint positions `(sample, joint)` rad of an experiment's arm.

    Raises:
        InputError: another shape, numbers that are not real or not finite, or degrees.
    """
    q = real_array("joint_position", joint_position)
    arm = experiment.arm
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
        sensor: a `Sensor`, as of `plan_sensor`, or a name of `SENSORS`.
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
    arm = description.load_bundled(arm) if isinstance(arm, str) else arm
    sensor = sensor_named(sensor) if isinstance(sensor, str) else sensor
    geometry = arm.form if chain == "hayati" else SixParameterForm(arm.dof, arm.sliding)
    values = arm.hayati if chain == "hayati" else arm.kinematics.ravel()
    T_joint_tool = np.array(arm.T_joint_flange)
    T_joint_tool[:3, 3] += T_joint_tool[:3, :3] @ np.asarray(tool_at, float)
    model = ArmModel(values, np.eye(4), T_joint_tool)  # type: ignore[arg-type]
    return Experiment(arm, ModelForm(geometry, frame, tool), model, sensor)


def recording_experiment(recording: Recording, arm: Arm | None = None, geometry: Geometry = "declared") -> Experiment:
    """The experiment of a recording: what its sidecar leaves unknown, measured by its sensor.

    Raises:
        InputError: as `recording_problem`; nothing unknown.
    """
    problem = recording_problem(recording, arm, geometry)
    if not problem.movable.any():
        raise InputError(
            f"{recording.source}: its sidecar declares geometry, sensor frame and tool: nothing is left to identify; "
            "use `geometry='free'`"
        )
    position, orientation = problem.noise
    quantity = "position" if orientation is None else "pose"
    sensor = plan_sensor(quantity, position, orientation, joint_noise=recording.settings.joint_noise_rad)
    return Experiment(problem.arm, problem.form, problem.start, sensor, problem.movable, problem.precision)
