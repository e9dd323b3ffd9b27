"""The model of a diagnosed arm: evaluated as a JAX function, and predicted over a motion with standard deviations.

Those are of the true pose from the predicted one. The sensor's noise is no part of them.

A model is given joint positions as the arm's controller counts them, which is as they are recorded. Where the diagnosis
found that the zero of a joint is off, the model adds what is missing (`DiagnosedArm.joint_zero`) as it evaluates them.
Nothing else adds it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike

from lite6jax.arms.se3 import quaternion_from_rotation
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.domains.pose.deflections import Deflections, columns_of, site_of
from lite6jax.domains.pose.kinematics import FRAMES, Site, rigid_tool, site_columns
from lite6jax.domains.uncertainty import (
    MARGIN,
    ReferenceOrigin,
    Uncertainty,
    beyond_range,
    distance_to,
    freed,
    independent_directions,
    widened,
)
from lite6jax.effects.composition import Physics
from lite6jax.effects.deflection import Deflection
from lite6jax.effects.kinematic import TimeOffset
from lite6jax.effects.motion import Motion, Sliding, accelerated, in_another_recording
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.statics import Inertia
from lite6jax.errors import InputError, wrong_type
from lite6jax.model import ArmModel, predict_poses
from lite6jax.recordings import Recording, read_motion, require_radians
from lite6jax.recordings.motion import motion_of_recording, with_joints
from lite6jax.recordings.units import other_joints
from lite6jax.results import PublicResult
from lite6jax.sensors.pose import PoseSensor

SPARSE = 3.0
"""Times what is typical of the recorded rows: a row whose standard deviation is larger lies where they are too few."""
TURNED = ("rx_std_rad", "ry_std_rad", "rz_std_rad")
"""Columns of the standard deviations of orientations, about the axes of the predicted tool."""
_ROWS_AT_ONCE = 4096
_QUANTITIES = np.repeat([0, 1], 3)
"""Of the rows of a pose: its position, and its orientation."""
_CONVENTION = np.pi / 4
"""rad: a zero that is off by more is another convention, by quarter turns, and not one that was lost."""

_ARGUMENTS = {
    "direction of motion": "direction",
    "velocity": "joint_velocity",
    "temperature rise": "temperature_rise",
    "temperature": "temperature_rise",
    "time": "time",
}
"""The argument of `DiagnosedArm.pose` that provides a quantity which effects depend on."""


_LEAVES = ("model", "values", "inertia", "joint_limits", "joint_zero")
_STATIC = (
    *("arm", "physics", "orientation", "reference_temperature", "motion", "accelerated", "heldout_rms", "reference"),
    *("uncertainty", "sliding"),
)


@final
@partial(jax.tree_util.register_dataclass, data_fields=_LEAVES, meta_fields=_STATIC)
@dataclass(frozen=True, eq=False, repr=False)
class DiagnosedArm:
    """An arm with the effects that a diagnosis found. A pytree: arrays are its leaves, all else is static.

    Attributes:
        model: the rigid part.
        values: `(physics.size,)`, the numbers of the effects.
        inertia: masses, or None where none are known.
        joint_limits: `(joint, 2)` rad, m of prismatic joints, or None where the diagnosis has none; as the arm's
            description counts its joints.
        joint_zero: `(joint,)` rad, by how much the description counts each joint further than the controller does: the
            diagnosis added it to recorded positions. Every member adds it to the positions that it is given.
        arm: the nominal arm's name.
        physics: the effects.
        orientation: whether the sensor measured orientations.
        reference_temperature: °C, at which the geometry holds.
        motion: of the diagnosed recording: "static" or "trajectory".
        accelerated: whether loads include the arm's accelerations.
        heldout_rms: cross-validated position errors in m RMS, without and with the effects; None where not known.
        reference: the recording relative to which the effects were estimated; None where absolute.
        uncertainty: from which error bars of predictions follow; None where the diagnosis does not say.
        sliding: the prismatic joints, counted from 0.
    """

    model: ArmModel
    values: Any  # JAX puts other objects than arrays into leaves while it transforms
    inertia: Inertia | None
    joint_limits: Any
    joint_zero: Any
    arm: str
    physics: Physics
    orientation: bool = True
    reference_temperature: float = 25.0
    motion: str = "static"
    accelerated: bool = False
    heldout_rms: tuple[float, float] | None = None
    reference: ReferenceOrigin | None = None
    uncertainty: Uncertainty | None = None
    sliding: tuple[int, ...] = ()

    def __repr__(self) -> str:
        effects = ", ".join(effect.label for effect in self.physics.effects) or "no effects"
        return f"model of a {self.arm} with {effects}"

    def read_motion(self, path: str | Path) -> Recording:
        """A motion to predict, as `recordings.read_motion`; a note says what `predicted` adds to joint positions."""
        motion = read_motion(path, self)
        if not np.any(self.joint_zero):
            return motion
        zeros = zeros_text(self.joint_zero)
        note = f"the zeros of joints are off as in the diagnosed recording; joint positions are corrected by {zeros}"
        return replace(motion, notes=(*motion.notes, note))

    def predicted(self, motion: Recording, time_remedy: str = "add time_s") -> "Prediction":
        """The poses that the sensor shows in a motion, with their standard deviations.

        Joint positions are those of the controller, as recorded, and not those that a diagnosis has corrected.

        Raises:
            InputError: another number of joints, or the motion lacks what an effect needs, by name.
        """
        instants = self.motion_of(motion)
        poses = shown_poses(self, instants)
        bars = predict_deviations(self, instants)
        for std in bars[:2]:
            if std is not None:
                std[np.isnan(poses[:, 0, 0])] = np.nan
        return Prediction(poses, *bars, self.orientation)

    @property
    def dof(self) -> int:
        """The number of joints."""
        return self.model.geometry.size // 6

    def controller_limits(self, limits: Array) -> Array:
        """The limits `(joint, 2)` rad that the controller checks by its own count, of those of the arm's description.

        They are the same numbers, also where it has lost a zero. Where it counts by another convention, off by quarter
        turns, they are as far off.
        """
        zero = np.asarray(self.joint_zero)
        convention = np.where(np.abs(zero) > _CONVENTION, zero, 0.0)
        return limits - convention[:, None]

    def pose(
        self,
        joint_position: ArrayLike,
        *,
        payload: ArrayLike = 0.0,
        temperature_rise: ArrayLike | None = None,
        direction: ArrayLike | None = None,
        joint_velocity: ArrayLike | None = None,
        time: ArrayLike | None = None,
    ) -> jax.Array:
        """The poses `T_sensor_tool` `(..., 4, 4)` that the sensor shows, each of one instant alone.

        A pure function for `jax.jit`, `jax.grad` and `jax.vmap`, of its arguments and of this model's arrays:

            jax.jacfwd(model.pose)(q)
            jax.grad(lambda model: jnp.sum(model.pose(q) ** 2))(model)

        Args:
            joint_position: `(..., joint)` rad, and m of prismatic joints, as the controller counts.
            payload: `(...)` kg at the flange.
            temperature_rise: `(...)` K above the temperature at which the geometry holds.
            direction: `(..., joint)` -1, 0 or 1, from which side each joint was approached.
            joint_velocity: `(..., joint)` rad/s.
            time: `(...)` s since the recording began.

        Raises:
            InputError: another number of joints, degrees, a quantity not given on which an effect depends, or an effect
                of a whole sequence (a clock's offset, play), which `predict` evaluates and `without` removes.
        """
        q = jnp.asarray(joint_position, float)
        if q.ndim < 1 or q.shape[-1] != self.dof:
            raise InputError(f"pose: joint_position has the shape {q.shape}; give (..., {self.dof}) in rad")
        if not isinstance(q, Tracer):
            limits = None
            if not isinstance(self.joint_limits, Tracer):
                limits = self.joint_limits
            require_radians(q, limits)

        batch_shape = q.shape[:-1]
        samples = int(np.prod(q.shape[:-1], dtype=int))

        def row(name: str, value: ArrayLike | None, shape: tuple[int, ...]) -> jax.Array | None:
            if value is None:
                return None
            array = jnp.asarray(value, float)
            try:
                full = jnp.broadcast_to(array, shape)
            except ValueError as error:
                problem = f"pose: {name} has the shape {array.shape}"
                raise InputError(f"{problem}; give one that broadcasts to {shape}") from error
            return jnp.moveaxis(full.reshape(samples, *shape[q.ndim - 1 :]), 0, -1)

        rise = row("temperature_rise", temperature_rise, batch_shape)
        motion = Motion(
            joint_position=(q + self.joint_zero).reshape(samples, self.dof).T,
            joint_velocity=row("joint_velocity", joint_velocity, q.shape),
            direction=row("direction", direction, q.shape),
            time=row("time", time, batch_shape),
            run=jnp.tile(jnp.arange(samples), (2, 1)),
            temperature_rise=rise,
            joint_temperature_rise=None if rise is None else jnp.broadcast_to(rise, (self.dof, samples)),
            payload=row("payload", payload, batch_shape),  # type: ignore[arg-type]
            sliding=Sliding(self.sliding),
        )
        motion = in_another_recording(motion)
        for effect in self.physics.effects:
            if isinstance(effect, TimeOffset) or effect.hysteretic:
                raise InputError(
                    f"{effect.label}: depends on other samples, and pose() takes one at a time; give the motion to "
                    f"predict(), or remove the effect by model.without({effect.label!r})"
                )
            for driver in effect.drivers:
                argument = _ARGUMENTS.get(driver.quantity)
                if argument and not driver.known(motion, None):
                    raise InputError(f"{effect.label}: needs the {driver.phrase}: give {argument}=")
        poses = predict_poses(motion.chain, self.physics, self.model, self.values, motion, self.inertia)
        return poses.reshape(*batch_shape, 4, 4)

    def without(self, *effects: str) -> "DiagnosedArm":
        """The same arm without some effects, each given by name (all of that name) or by label.

        Raises:
            InputError: the model has no such effect.
        """
        present = self.physics.effects
        for name in effects:
            if not any(name in (effect.name, effect.label) for effect in present):
                labels = ", ".join(effect.label for effect in present) or "none"
                raise InputError(f"effect {name!r}: the model has {labels}; choose one of them")
        return self.keeping([effect.name not in effects and effect.label not in effects for effect in present])

    def keeping(self, kept: list[bool]) -> "DiagnosedArm":
        """The same arm with the effects for which `kept` is true."""
        physics, values = self.physics.part(self.values, kept)
        uncertainty = None
        if self.uncertainty is not None:
            uncertainty = self.uncertainty.keeping(self.physics.effects, kept)
        return replace(self, physics=physics, values=values, uncertainty=uncertainty)

    def motion_of(self, recording: Recording) -> Motion:
        """The motion of a recording, with accelerations where loads include them; `joint_zero` is added.

        What wandered by itself while the model was recorded is not known of it.
        """
        motion = in_another_recording(motion_of_recording(self.correct_zeros(recording)))
        return accelerated(motion) if self.accelerated else motion

    def correct_zeros(self, recording: Recording) -> Recording:
        """The recording with joint positions as the arm's description counts them.

        Raises:
            InputError: other joints.
        """
        if recording.sliding != self.sliding:
            raise InputError(f"{recording.source}: {other_joints(recording.sliding, self.sliding, self.arm)}")
        zero = np.asarray(self.joint_zero)
        if not zero.any() or recording.dof != self.dof:
            return recording
        return with_joints(recording, np.eye(self.dof), zero)


@final
@dataclass(frozen=True, eq=False, repr=False)
class Prediction(PublicResult):
    """Predicted poses with standard deviations, sample by sample; NaN as the poses are.

    The deviations are those of the true pose from the predicted one, which the estimated numbers and what is left of
    the model cause. What a sensor shows differs by its noise as well, which is no part of them.

    Attributes:
        poses: `T_sensor_tool` `(sample, 4, 4)`.
        position_std: `(sample, 3)` m, along the sensor's axes; None where the diagnosis says nothing of it, as those
            of earlier versions.
        orientation_std: `(sample, 3)` rad, about the predicted tool's axes; None also where no orientation was
            recorded.
        outside: `(sample,)` bool, rows that the recording does not support: a joint, or a quantity on which an effect
            depends, is beyond what was recorded, or the recorded rows near it are too few; None where the diagnosis
            does not say.
        orientation: whether the sensor measures orientations.
    """

    poses: Array
    position_std: Array | None
    orientation_std: Array | None
    outside: Mask | None
    orientation: bool = True

    @property
    def shown(self) -> Array:
        """The poses."""
        return self.poses

    @property
    def empty(self) -> Mask:
        """`(sample,)`, rows of which nothing is predicted."""
        return np.isnan(self.poses[:, 0, 0])

    def columns(self) -> dict[str, Array | Integers]:
        """Column name to values, as in a file of a recording, and as `deviation_columns`; NaN in empty rows."""
        columns: dict[str, Any] = dict(zip(("x_m", "y_m", "z_m"), self.poses[:, :3, 3].T, strict=True))
        if self.orientation:
            columns |= zip(("qw", "qx", "qy", "qz"), np.asarray(_quaternions(self.poses[:, :3, :3])).T, strict=True)
        return columns | deviation_columns(self)


def zeros_text(zero: Array) -> str:
    """Corrections `(joint,)` rad of the joints whose zeros are off, in words."""
    degrees = np.rad2deg(np.asarray(zero))
    return " and ".join(f"{degrees[i]:+.3f} deg at joint {i + 1}" for i in np.flatnonzero(degrees))


def require_model(model: object) -> None:
    """Refuses what is no model of poses.

    Raises:
        InputError: as said.
    """
    if not isinstance(model, DiagnosedArm):
        read = "lite6jax.read_model('diagnosis.json', domain='poses')"
        raise wrong_type("model", model, f"{read}, or the `model` of a Diagnosis")


def shown_poses(model: DiagnosedArm, motion: Motion) -> Array:
    """`T_sensor_tool` `(sample, 4, 4)` in a motion; NaN where a clock's offset reaches beyond the ends of a run."""
    poses = np.array(predict_poses(motion.chain, model.physics, model.model, model.values, motion, model.inertia))
    poses[np.asarray(_beyond(model.physics, model.values, motion))] = np.nan
    return poses


def deviation_columns(result: Any) -> dict[str, Array | Integers]:
    """Column name to values of a prediction or a compensation: `x_std_m` …, `rx_std_rad` …, `outside`, where known."""
    columns: dict[str, Any] = {}
    for std, names in ((result.position_std, ("x_std_m", "y_std_m", "z_std_m")), (result.orientation_std, TURNED)):
        if std is not None:
            columns |= zip(names, std.T, strict=True)
    if result.outside is None:
        return columns
    return columns | {"outside": result.outside.astype(int)}


@final
@dataclass(frozen=True, eq=False)
class Derivatives:
    """How the poses that a model predicts in a motion change with its numbers: rigid frames, and unit deflections.

    They are taken at the rigid arm, which is off by the angles of its deflections, a thousandth. Nothing is compiled.

    Attributes:
        model: the arm.
        motion: the whole sequence.
        sites: the displacements of frames and the errors of masses, which come before the effects' numbers.
    """

    model: DiagnosedArm
    motion: Motion
    sites: tuple[Site, ...]

    def blocks(self) -> Iterator[tuple[slice, dict[Site, Array], Array]]:
        """Rows after rows, derivatives of their poses by a unit deflection at each site, and by each number.

        Those are `(6, row)` and `(number, 6, row)`: of positions in the sensor's axes (m) and of rotations about the
        predicted tool's axes (rad).
        """
        units = self._units()
        sliding = self.model.sliding
        q = np.asarray(self._altered.joint_position)
        for first in range(0, q.shape[1], _ROWS_AT_ONCE):
            rows = slice(first, min(first + _ROWS_AT_ONCE, q.shape[1]))
            tool = rigid_tool(self.model.model, q[:, rows], sliding)
            shown = PoseSensor(tool[:, :3, 3].T, np.moveaxis(tool[:, :3, :3], 0, -1), np.ones(2))
            sites = site_columns(self.model.model, q[:, rows], shown, sliding)
            frames = [sites[site][None] for site in self.sites if site[0] in FRAMES]
            parts = [np.zeros((0, 6, rows.stop - rows.start)), *frames]
            for unit in units:
                part = Deflection(*(None if field is None else np.asarray(field)[..., rows] for field in unit))  # type: ignore[arg-type]
                parts.append(columns_of(part, sites))
            yield rows, sites, np.concatenate(parts)

    def all(self) -> Array:
        """`(number, 6, sample)` of all rows."""
        return np.concatenate([block for _, _, block in self.blocks()], 2)

    def variance(self, covariance: Array) -> Array:
        """`(6, sample)` m² and rad², of predicted poses, by the covariance `(number, number)` of the model's numbers.

        With that of nonparametric effects beyond the range of their drivers.
        """
        directions = independent_directions(covariance)
        variance = np.zeros((6, self.motion.samples))
        unnamed = [effect for effect in self.model.physics.effects if isinstance(effect, Unnamed)]
        of = self._deflections
        unknown = [effect.unknown_at(effect.values_at(of.host_motion, of.loads)) for effect in unnamed]
        for rows, sites, J in self.blocks():
            variance[:, rows] = np.sum(np.tensordot(directions, J, 1) ** 2, 0)
            for effect, part in zip(unnamed, unknown, strict=True):
                variance[:, rows] += sites[site_of(effect.where, effect.component)] ** 2 * part[rows]
        return variance

    def driver_values(self) -> dict[str, Array]:
        """`(sample,)` of every quantity on which effects depend and that the motion has, by its phrase.

        Without the order of recording, which no other recording can be within.
        """
        of_effects = [driver for effect in self.model.physics.effects for driver in effect.drivers]
        drivers = {driver.phrase: driver for driver in of_effects if not driver.is_order}
        on_arm = None
        if any(driver.loaded for driver in drivers.values()):
            on_arm = self._deflections.loads
        return {
            phrase: np.asarray(driver.values(self._seen, on_arm))
            for phrase, driver in drivers.items()
            if driver.known(self._seen, on_arm)
        }

    def _units(self) -> list[Deflection]:
        """The deflection by errors of masses, if any, and by each effect's numbers, `(number, …)`."""
        physics = self.model.physics
        values = np.asarray(self.model.values)
        masses = [site for site in self.sites if site[0] not in FRAMES]
        units = []
        if masses:
            units = [self._deflections.through_masses(masses, physics, values)]
        for effect, part in physics.pairs:
            free_effect = freed(effect)
            at = values[part]
            if free_effect is not effect and effect.chosen is not None:
                at = np.append(at, effect.chosen)
            units.append(self._deflections.by_each(free_effect, at, physics, values))
        return units

    @cached_property
    def _deflections(self) -> Deflections:
        kinematics = np.asarray(self.model.model.geometry).reshape(-1, 6)
        return Deflections(kinematics, self.model.inertia, self._seen, lambda alter: alter(self._seen))

    @cached_property
    def _seen(self) -> Motion:
        """The motion, with predicted positions where an effect requires measured ones."""
        drivers = (driver for effect in self.model.physics.effects for driver in effect.drivers)
        if not any(driver.quantity.startswith("measured position") for driver in drivers):
            return self.motion
        tool = rigid_tool(self.model.model, np.asarray(self.motion.joint_position), self.model.sliding)
        return self.motion._replace(measured_position=tool[:, :3, 3].T)  # type: ignore[arg-type]

    @cached_property
    def _altered(self) -> Motion:
        """The motion as it really was."""
        physics = self.model.physics
        if physics.altering:
            return physics.alter(jnp.asarray(self.model.values), self._seen)
        return self._seen


def predict_deviations(model: DiagnosedArm, motion: Motion) -> tuple[Array | None, Array | None, Mask | None]:
    """`position_std`, `orientation_std` and `outside` of a `Prediction`; None where the diagnosis says nothing of them.

    Rows are outside too where the recorded rows are too few near them: where the standard deviation is `SPARSE` times
    what is typical of the recorded ones.
    """
    uncertainty = model.uncertainty
    if uncertainty is None:
        return None, None, None
    change = Derivatives(model, motion, uncertainty.sites)
    recorded = uncertainty.recorded
    q = np.asarray(motion.joint_position).T
    beyond = recorded.beyond(change.driver_values())
    positions = [phrase for phrase in beyond if phrase.startswith("position of ")]
    estimated = change.variance(uncertainty.covariance)
    variance, outside = widened(
        estimated, uncertainty, _QUANTITIES, distance_to(recorded.positions, q), beyond, positions
    )
    outside |= (beyond_range(q, *recorded.joints.T) > MARGIN).any(1)
    if uncertainty.typical is not None:
        measured = (slice(0, 3), slice(3, 6))[: 2 if model.orientation else 1]
        for rows, usual in zip(measured, uncertainty.typical, strict=False):
            outside |= np.sqrt(variance[rows].mean(0)) > SPARSE * usual
    std = np.sqrt(variance)
    return std[:3].T, std[3:].T if model.orientation else None, outside


_beyond = jax.jit(Physics.beyond, static_argnums=0)
_quaternions = jax.jit(quaternion_from_rotation)
