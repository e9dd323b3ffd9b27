"""Standard deviations of predicted poses: of what was estimated, of what is left of the model, and outside its range.

The numbers of a model are uncertain together: their covariance goes through the derivatives of the prediction.
What is left of the model is known from rows that were not fitted. Far from every recorded row it may be larger, and
beyond the range of its driver a curve is not known at all. The sensor's noise is no part of any of this.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, final

import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from lite6jax.domains.pose.columns import columns_of
from lite6jax.domains.pose.deflections import Deflections
from lite6jax.domains.pose.kinematics import FRAMES, Measured, Site, rigid_tool, site_columns
from lite6jax.effects.composition import Physics
from lite6jax.effects.deflection import Deflection
from lite6jax.effects.effect import Effect, Loading
from lite6jax.effects.motion import Motion
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.projection import scaled_inverse

if TYPE_CHECKING:
    from lite6jax.domains.pose.predict import DiagnosedArm

Array = NDArray[np.floating]
Flags = NDArray[np.bool_]
PerAxis = tuple[float, float]
"""Standard deviations per axis: of a position in m, of an orientation in rad."""

LENGTH = 0.5
"""rad in joint space, beyond the spacing of the recorded rows, at which what is left of the model counts twice."""
DRIVEN = 0.25
"""Of the recorded range of a driver: so far beyond it what is left counts twice, and a curve is mostly unknown."""
MARGIN = 0.02
"""Of a recorded range: a row within this of its ends is not outside."""
SPARSE = 3.0
"""Times what is typical of the recorded rows: a row whose standard deviation is larger lies where they are too few."""
_ROWS_AT_ONCE = 4096


@final
@dataclass(frozen=True, eq=False)
class RecordedRange:
    """Where a model was recorded.

    Attributes:
        joints: `(joint, 2)` rad, the least and the greatest position of each.
        positions: `(row, joint)` rad, of some recorded rows.
        spacing: rad, the distance from a row to the nearest of `positions` in other blocks of the recording that 95 %
            of rows do not exceed: so far, errors on held-out rows tell what is left.
        drivers: the least and the greatest value of each quantity on which an effect depends, by its phrase.
    """

    joints: Array
    positions: Array
    spacing: float
    drivers: dict[str, tuple[float, float]]


@final
@dataclass(frozen=True, eq=False)
class Uncertainty:
    """What error bars of a model's predictions follow from.

    Attributes:
        sites: the nuisance that was fitted: displacements of frames, each about the frame as it is in the model, and
            errors of masses.
        covariance: `(number, number)`, of these and then of the numbers of all effects, each as `freed`; m, rad and the
            units of the effects.
        left: what is left of the model, on rows that were not fitted.
        unseen: what may be left of it without showing there: one standard error of `left`.
        noise: the sensor's, which is no part of the bars.
        curves: for each effect, what it moves per axis where it is a curve without a name; else None.
        recorded: the range.
        typical: the standard deviation of the recorded rows, their median; None where the diagnosis does not say.
    """

    sites: tuple[Site, ...]
    covariance: Array
    left: PerAxis
    unseen: PerAxis
    noise: PerAxis
    curves: tuple[PerAxis | None, ...]
    recorded: RecordedRange
    typical: PerAxis | None = None

    def keeping(self, physics: Physics, kept: Sequence[bool]) -> "Uncertainty":
        """That of the model with some of the effects of `physics`; the others' numbers stay as uncertain as they are.

        Args:
            physics: the effects that the covariance is of.
            kept: for each of them, whether it stays.
        """
        sizes = [freed(effect).size for effect in physics.effects]
        numbers = [*([True] * len(self.sites)), *np.repeat(kept, sizes).astype(bool)]
        curves = tuple(curve for curve, stays in zip(self.curves, kept, strict=True) if stays)
        return replace(self, covariance=self.covariance[np.ix_(numbers, numbers)], curves=curves)

    def without_base(self) -> "Uncertainty":
        """That of poses in the frame of the arm's own base, in which this frame's place does not matter."""
        kept = [name != "base" for name, _, _ in self.sites]
        numbers = [*kept, *([True] * (len(self.covariance) - len(kept)))]
        sites = tuple(site for site, stays in zip(self.sites, kept, strict=True) if stays)
        return replace(self, sites=sites, covariance=self.covariance[np.ix_(numbers, numbers)])


def registered(model: "DiagnosedArm", motion: Motion, noise: tuple[float, float | None]) -> Uncertainty | None:
    """The uncertainty of a model whose sensor frame and tool were fitted anew to the poses of a motion.

    These frames then follow whatever else of the model is off, as far as they can, and have the fit's own error.

    Args:
        model: with the new frames and the uncertainty of the diagnosis.
        motion: of the rows that the frames were fitted to.
        noise: standard deviations per axis of the poses, position (m) and orientation (rad); None where the latter were
            not measured, and the tool's rotation was kept.
    """
    known = model.uncertainty
    if known is None:
        return None
    rows = 3 if noise[1] is None else 6
    frames: list[Site] = [*(("base", 0, k) for k in range(6)), *(("tool", 0, k) for k in range(rows))]
    stays = [name not in ("base", "tool") for name, _, _ in known.sites]
    others = tuple(site for site, kept in zip(known.sites, stays, strict=True) if kept)
    J = Derivatives(model, motion, (*frames, *others)).all()[:, :rows]
    J = J / np.repeat([noise[0], noise[1] or 1.0], 3)[:rows, None]
    F, R = np.split(J.reshape(len(J), -1), [len(frames)])
    own = scaled_inverse(F @ F.T)
    follow = own @ (F @ R.T)
    numbers = np.flatnonzero([*stays, *([True] * (len(known.covariance) - len(stays)))])
    rest = known.covariance[np.ix_(numbers, numbers)]
    together = -follow @ rest
    C = np.block([[own - together @ follow.T, together], [together.T, rest]])
    return replace(known, sites=(*frames, *others), covariance=C, typical=None)  # the new frames are less certain


class Bars(NamedTuple):
    """Standard deviations of predicted poses, sample by sample.

    Attributes:
        position: `(sample, 3)` m, along the sensor's axes.
        orientation: `(sample, 3)` rad, about the predicted tool's axes.
        outside: `(sample,)` bool, where a joint or a driver is beyond its recorded range, or the recorded rows are too
            few near it: the standard deviation is `SPARSE` times what is typical of them.
    """

    position: Array
    orientation: Array
    outside: Flags


def freed(effect: Effect) -> Effect:
    """The effect with the order that was found for it as its last number, unless that is whole and so exact."""
    return effect.released() if effect.chosen is not None and effect.chosen % 1 else effect


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

    model: "DiagnosedArm"
    motion: Motion
    sites: tuple[Site, ...]

    def blocks(self) -> Iterator[tuple[slice, Array]]:
        """Rows after rows, and their derivatives `(number, 6, row)`.

        The six are positions in the sensor's axes (m) and rotations about the predicted tool's axes (rad).
        """
        units = self._units()
        q, sliding = np.asarray(self._altered.joint_position), self.model.sliding
        for first in range(0, q.shape[1], _ROWS_AT_ONCE):
            rows = slice(first, min(first + _ROWS_AT_ONCE, q.shape[1]))
            tool = rigid_tool(self.model.model, q[:, rows], sliding)
            rotation = np.moveaxis(tool[:, :3, :3], 0, -1)
            shown = Measured(tool[:, :3, 3].T, rotation, np.ones(2))
            sites = site_columns(self.model.model, q[:, rows], shown, sliding)
            frames = [sites[site][None] for site in self.sites if site[0] in FRAMES]
            parts = [np.zeros((0, 6, tool.shape[0])), *frames]
            for unit in units:
                part = Deflection(*(None if field is None else np.asarray(field)[..., rows] for field in unit))  # type: ignore[arg-type]
                parts.append(columns_of(part, sites))
            yield rows, np.concatenate(parts)

    def all(self) -> Array:
        """`(number, 6, sample)` of all rows."""
        return np.concatenate([block for _, block in self.blocks()], 2)

    def driver_values(self) -> dict[str, Array]:
        """`(sample,)` of every quantity on which effects depend and that the motion has, by its phrase."""
        drivers = {driver.phrase: driver for effect in self.model.physics.effects for driver in effect.drivers}
        on_arm = self._deflections.loads if any(driver.loaded for driver in drivers.values()) else None
        return {
            phrase: np.asarray(driver.values(self._seen, on_arm))
            for phrase, driver in drivers.items()
            if driver.known(self._seen, on_arm)
        }

    def _units(self) -> list[Deflection]:
        """The deflection by errors of masses, if any, and by each effect's numbers, `(number, …)`."""
        physics, values = self.model.physics, np.asarray(self.model.values)
        masses = [site for site in self.sites if site[0] not in FRAMES]
        units = [self._deflections.through_masses(masses, physics, values)] if masses else []
        for effect, part in zip(physics.effects, physics.slices, strict=True):
            one, at = freed(effect), values[part]
            if one is not effect and effect.chosen is not None:
                at = np.append(at, effect.chosen)
            if isinstance(one, Loading):
                units.append(self._deflections.through_loads(one, at, physics, values))
            elif isinstance(one, Unnamed) or one.linear or not at.any():
                units.append(self._deflections.unit(one))
            else:
                units.append(self._deflections.slope(one, at))
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
        return physics.alter(jnp.asarray(self.model.values), self._seen) if physics.altering else self._seen


def bars_of(model: "DiagnosedArm", motion: Motion) -> Bars | None:
    """The bars of a model's predictions in a motion; None where its diagnosis says nothing of uncertainty."""
    known = model.uncertainty
    if known is None:
        return None
    change = Derivatives(model, motion, known.sites)
    variance = estimated_variance(change, known.covariance)
    further, curved, outside = _departures(change, known)
    for rows, k in ((slice(0, 3), 0), (slice(3, 6), 1)):
        variance[rows] += known.left[k] ** 2 + further * (known.left[k] ** 2 + known.unseen[k] ** 2)
        for moved, share in zip(filter(None, known.curves), curved, strict=True):
            variance[rows] += moved[k] ** 2 * share
    std = np.sqrt(variance)
    if known.typical is not None:
        measured = (slice(0, 3), slice(3, 6))[: 2 if model.orientation else 1]
        for rows, usual in zip(measured, known.typical, strict=False):
            outside = outside | (np.sqrt(variance[rows].mean(0)) > SPARSE * usual)
    return Bars(std[:3].T, std[3:].T, outside)


def estimated_variance(change: Derivatives, covariance: Array) -> Array:
    """`(6, sample)` m² and rad², of predicted poses, by the covariance `(number, number)` of a model's numbers.

    Displacements of frames that no pose shows are as uncertain as their prior, and cancel: the covariance is split into
    independent directions first.
    """
    root = np.sqrt(np.maximum(np.diagonal(covariance), np.finfo(float).tiny))
    eigenvalues, V = np.linalg.eigh(covariance / np.outer(root, root))
    directions = (V * np.sqrt(np.maximum(eigenvalues, 0.0)) * root[:, None]).T
    variance = np.zeros((6, change.motion.samples))
    for rows, J in change.blocks():
        variance[:, rows] = np.sum(np.tensordot(directions, J, 1) ** 2, 0)
    return variance


def distance_to(positions: Array, joint_position: Array) -> Array:
    """`(sample,)` rad, from joint positions `(sample, joint)` to the nearest of `positions` `(row, joint)`."""
    return cdist(joint_position, positions).min(1)


def _departures(change: Derivatives, known: Uncertainty) -> tuple[Array, list[Array], Flags]:
    """How far a motion departs from what was recorded.

    Returns:
        `(sample,)`, by which multiple the variance of what is left grows; for each curve `(sample,)`, from 0 to 1, the
        share of its variance that is unknown; and `(sample,)`, whether the row is outside.
    """
    recorded, q = known.recorded, np.asarray(change.motion.joint_position).T
    further = (np.maximum(distance_to(recorded.positions, q) - recorded.spacing, 0.0) / LENGTH) ** 2
    outside: Flags = np.asarray((beyond_range(q, *recorded.joints.T) > MARGIN).any(1))
    beyond: dict[str, Array] = {}
    for phrase, values in change.driver_values().items():
        if phrase in recorded.drivers:
            beyond[phrase] = beyond_range(values, *recorded.drivers[phrase]) / DRIVEN
            outside = outside | (beyond[phrase] > MARGIN / DRIVEN)
            if not phrase.startswith("position of "):  # which the distance contains
                further += beyond[phrase] ** 2
    curved = [
        -np.expm1(-sum((beyond[d.phrase] ** 2 for d in effect.drivers if d.phrase in beyond), np.zeros(len(q))))
        for effect, curve in zip(change.model.physics.effects, known.curves, strict=True)
        if curve is not None
    ]
    return further, curved, outside


def beyond_range(values: Array, lower: Array | float, upper: Array | float, least: Array | float = 1e-6) -> Array:
    """By how much values are beyond a range, over its length; over the size of its values where it has none.

    Args:
        values: in the unit of the range.
        lower: of the range.
        upper: of the range.
        least: the shortest length.
    """
    size = 0.1 * np.maximum(np.abs(lower), np.abs(upper))
    length = np.maximum(np.maximum(np.asarray(upper) - lower, size), least)
    return np.maximum(np.maximum(lower - values, values - upper), 0.0) / length
