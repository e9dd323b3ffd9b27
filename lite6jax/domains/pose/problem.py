"""A recording as the diagnosis sees it: whitened residuals, and how every cause inside the arm would change them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import Form, SixParameterForm, link_frames
from lite6jax.arms.moves import Frame, base_frame, cross, turn
from lite6jax.effects.catalogue import BUILT_IN
from lite6jax.effects.composition import Physics
from lite6jax.effects.deflection import Deflection, dense
from lite6jax.effects.effect import Altering, Bending, Effect
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.effects.kinematic.surroundings import PayloadError
from lite6jax.effects.motion import Motion, beyond, select, shifted
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.statics import Inertia, Loads, loads
from lite6jax.fitting.problem import Geometry, Problem, recording_problem, whitener_of
from lite6jax.fitting.residual import Observations, by_twist, differences, tool_frame, whiten
from lite6jax.model import ArmModel, predict_bent
from lite6jax.recordings import Recording
from lite6jax.recordings.motion import inertia_of_arm, motion_of_recording

Array = NDArray[np.floating]

GAUGE = {"m": 0.02, "rad": 0.05}
"""Prior of each number of a chain that is not known: wide enough for any arm; it settles what nothing determines."""


_ROUNDING = 1e-12
_GRAM = 1e-3
Site = tuple[str, int, int]
"""A field of `Deflection`, the joint or link in it from 0, and the component of a twist."""


class Measured(NamedTuple):
    """What the sensor saw, the sample last. A pytree.

    Attributes:
        position: `(3, sample)` m.
        rotation: `(3, 3, sample)`; `(3, 3, 0)` where no orientation was measured.
        whitener: `(2,)` or `(row, row, sample)`, as in `Observations`.
    """

    position: jax.Array
    rotation: jax.Array
    whitener: jax.Array


@dataclass(frozen=True, eq=False)
class Case:
    """A recording, the nuisance that must be fitted whatever the physics, and the motion that drives effects.

    Attributes:
        recording: as read; every row has a pose.
        arm: the nominal arm.
        chain: a six-parameter chain: the frames of its links are those that effects are defined in.
        start: the arm that everything is linearised about.
        unknown: the nuisance, constant displacements of frames: the field of `Deflection`, and where in it. What a
            chain's numbers can do, these can, without the singular spots of angles.
        precision: `(unknown,)` one over the variance of what is known of them beforehand.
        offset: `(unknown,)` how far `start` is from what is known beforehand.
        motion: the whole sequence.
        inertia: the arm's masses, or None where they are not known.
        measured: the poses.
        noise: one standard deviation per axis of position (m) and orientation (rad), as declared or assumed.
        declared: whether the sidecar declares it.
        notes: what was assumed.
        whole: of a thinned case, the motion that its rows are taken from, and which they are; an effect of the clock
            looks at their neighbours.
        clock: s, the offset of the clock that everything is linearised about.
    """

    recording: Recording
    arm: Arm
    chain: SixParameterForm
    start: ArmModel
    unknown: tuple[Site, ...]
    precision: Array
    offset: Array
    motion: Motion
    inertia: Inertia | None
    measured: Measured
    noise: tuple[float, float | None]
    declared: bool
    notes: tuple[str, ...]
    whole: tuple[Motion, NDArray[np.integer]] | None = None
    clock: float = 0.0

    @property
    def samples(self) -> int:
        """How many."""
        return self.motion.samples

    @property
    def rows(self) -> int:
        """Numbers that a sample has: 3 or 6."""
        return 3 if self.measured.rotation.shape[-1] == 0 else 6

    @cached_property
    def lived(self) -> Motion:
        """The motion at the clock that everything is linearised about."""
        return self.altered(lambda motion: shifted(motion, self.clock)) if self.clock else self.motion

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """`(sample,)`, the rows whose joints were recorded: a clock that is off leaves some at the ends without."""
        return ~np.asarray(beyond(self.motion, self.clock)) if self.clock else np.ones(self.samples, bool)

    @cached_property
    def loads(self) -> Loads | None:
        """Gravity's loads on the nominal arm; None where the masses are not known."""
        return self.loads_on(self.start, self.lived)

    def thinned(self, every: int) -> "Case":
        """One in `every` rows."""
        if every == 1:
            return self
        rows = slice(None, None, every)
        whitener = self.measured.whitener
        measured = Measured(
            self.measured.position[:, rows],
            self.measured.rotation[..., rows],
            whitener[..., rows] if whitener.ndim == 3 else whitener,
        )
        chosen = np.arange(self.samples)[rows]
        recording, motion = self.recording.select(chosen), select(self.motion, chosen)
        return replace(self, recording=recording, motion=motion, measured=measured, whole=(self.motion, chosen))

    def altered(self, alter: Callable[[Motion], Motion]) -> Motion:
        """The motion as it really was."""
        if self.whole is None:
            return alter(self.motion)
        motion, chosen = self.whole
        return select(alter(motion), chosen)

    def loads_on(self, model: ArmModel, motion: Motion) -> Loads | None:
        """The loads on a rigid chain in a motion."""
        if self.inertia is None:
            return None
        return _loads(self.chain, jnp.asarray(model.geometry), motion, self.inertia)

    def deflection(self, moved: Array, physics: Physics, values: Array) -> tuple[Motion, Deflection]:
        """The motion as it really was, and the deflections in it, dense: the nuisance `(unknown,)` and the effects."""
        if all(map(_is_linear, physics.effects)):
            motion, bent = self.motion, self._rigid
            for effect, part in zip(physics.effects, physics.slices, strict=True):
                bent = bent + _scaled(self._unit(effect), np.asarray(values)[part])
        else:
            motion = self.altered(partial(physics.alter, jnp.asarray(values)))
            altered = any(isinstance(effect, Altering) for effect in physics.effects)
            on_arm = self.loads_on(self.start, motion) if altered and physics.loaded else self.loads
            bent = dense(physics.deflect(jnp.asarray(values), motion, on_arm), motion.dof, motion.samples)
        if not self.unknown:
            return motion, bent
        base, link, tool = np.zeros(6), np.zeros((motion.dof, 6)), np.zeros(6)
        for (field, j, k), value in zip(self.unknown, moved, strict=True):
            {"base": base, "tool": tool, "link": link[j]}[field][k] = value
        assert bent.base is not None
        assert bent.link is not None
        assert bent.tool is not None
        return motion, bent._replace(
            base=bent.base + base[:, None], link=bent.link + link[:, :, None], tool=bent.tool + tool[:, None]
        )

    def residual(self, moved: Array, physics: Physics, values: Array) -> Array:
        """Whitened residuals `(row, sample)` with the nuisance `(unknown,)` and effects."""
        motion, deflection = self.deflection(moved, physics, values)
        return np.asarray(_residual(self.chain, self.start, motion.joint_position, deflection, self.measured))

    def position_errors(self, moved: Array, physics: Physics, values: Array) -> Array:
        """Predicted minus measured positions `(3, sample)` m."""
        motion, deflection = self.deflection(moved, physics, values)
        predicted = _positions(self.chain, self.start, motion.joint_position, deflection)
        return np.asarray(predicted) - np.asarray(self.measured.position)

    @cached_property
    def nuisance(self) -> Array:
        """How whitened residuals change with the nuisance, `(unknown, row, sample)`."""
        if not self.unknown:
            return np.zeros((0, self.rows, self.samples))
        return np.stack([self.sites[site] for site in self.unknown])

    @cached_property
    def sites(self) -> dict[Site, Array]:
        """How they change with a deflection at each site, `(row, sample)`: keys are the field of `Deflection`, and
        where in it."""
        dof = self.motion.dof
        columns = np.array(_sites(self.chain, self.start, self.lived.joint_position, self.measured))
        felt = np.abs(columns).max((1, 2), initial=0.0)
        columns[felt < _ROUNDING * felt.max()] = 0.0  # the last joint's, of a point on its axis
        keys = [
            *(("joint", j, 0) for j in range(dof)),
            *(("stretch", j, 0) for j in range(dof)),
            *(("link", j, k) for j in range(dof) for k in range(6)),
            *(("base", 0, k) for k in range(6)),
            *(("tool", 0, k) for k in range(6)),
            ("scale", 0, 0),
        ]
        return dict(zip(keys, columns, strict=True))

    def columns(
        self, effects: Sequence[Effect], values: Array | None = None, beside: tuple[Physics, Array] | None = None
    ) -> Array:
        """How whitened residuals change with the numbers of some effects, `(number, row, sample)`.

        Args:
            effects: any; each must have its drivers.
            values: `(number,)` where; neutral where not given.
            beside: the physics through whose compliances a wrong payload is seen, and its values; `effects` themselves
                where not given.
        """
        physics = Physics(tuple(effects))
        values = np.zeros(physics.size) if values is None else np.asarray(values, float)
        parts: list[Array] = [np.zeros((0, self.rows, self.samples))]
        for effect, part in zip(physics.effects, physics.slices, strict=True):
            if isinstance(effect, PayloadError):
                others = physics if beside is None else beside[0]
                at = values if beside is None else beside[1]
                parts.append(self._felt(self._by_mass(values[part], others, at)))
            elif _is_linear(effect) or not values[part].any():
                if effect not in self._known:
                    self._known[effect] = self._felt(self._unit(effect))
                parts.append(self._known[effect])
            else:
                parts.append(self._felt(self._shapes(effect, values[part])))
        return np.concatenate(parts)

    def harmonics(self, joint: int, orders: Array) -> Array:
        """The columns of a joint's harmonics, sine and cosine of each order, `(order, 2, row, sample)`."""
        turned = np.multiply.outer(orders, np.asarray(self.lived.joint_position[joint - 1]))
        shapes = np.stack([np.sin(turned), np.cos(turned)], 1)
        return self.sites["joint", joint - 1, 0] * shapes[:, :, None]

    def _by_mass(self, mass: Array, physics: Physics, values: Array) -> Deflection:
        """What a kilogram more at the flange makes of deflections that loads cause."""
        pairs = zip(physics.effects, physics.slices, strict=True)
        loaded = [(e, jnp.asarray(values[part])) for e, part in pairs if any(d.loaded for d in e.drivers)]
        if not loaded:
            return Deflection(scale=np.zeros((1, self.samples)))  # type: ignore[arg-type]

        def deflected(kilograms: float) -> Deflection:
            motion = self.lived._replace(payload=self.lived.payload + kilograms)
            loads, total = self.loads_on(self.start, motion), Deflection()
            for effect, at in loaded:
                if isinstance(effect, Bending):
                    total = total + effect.deflect(at, motion, loads)
            return dense(total, motion.dof, motion.samples)

        # loads are linear in masses, and all that gives way but curves in loads: no derivative has to be traced
        less, more = deflected(float(mass[0]) - _GRAM), deflected(float(mass[0]) + _GRAM)
        shapes = ((np.asarray(b) - np.asarray(a))[None] / (2 * _GRAM) for a, b in zip(less, more, strict=True))
        return Deflection(*shapes)  # type: ignore[arg-type]

    def _unit(self, effect: Effect) -> Deflection:
        """The deflection per unit of each of an effect's numbers, at neutral, remembered."""
        if effect not in self._units:
            if isinstance(effect, Unnamed):
                shapes = effect.units(self.lived, self.loads)
                self._units[effect] = Deflection(*(None if part is None else np.asarray(part) for part in shapes))  # type: ignore[arg-type]
            elif isinstance(effect, Bending) and _is_linear(effect):
                each = [effect.deflect(jnp.asarray(step), self.lived, self.loads) for step in np.eye(effect.size)]
                parts = zip(*each, strict=True)  # without a trace: for a hundred candidates those would take seconds
                self._units[effect] = Deflection(*(None if p[0] is None else np.stack(p) for p in parts))  # type: ignore[arg-type]
            else:
                self._units[effect] = self._shapes(effect, np.zeros(effect.size))
        return self._units[effect]

    def _shapes(self, effect: Effect, values: Array) -> Deflection:
        """The deflection per unit of each of an effect's numbers, a leading axis; NumPy."""
        at, steps = jnp.asarray(values), jnp.eye(len(values))

        def deflected(v: jax.Array) -> Deflection:
            if isinstance(effect, Altering):  # of the joints' positions; what follows from loads is of second order
                return Deflection(joint=self.altered(partial(effect.alter, v)).joint_position)
            assert isinstance(effect, Bending)
            return effect.deflect(v, self.lived, self.loads)

        shapes = jax.vmap(lambda step: jax.jvp(deflected, (at,), (step,))[1])(steps)
        return Deflection(*(None if part is None else np.asarray(part) for part in shapes))  # type: ignore[arg-type]

    def _felt(self, shapes: Deflection) -> Array:
        """The columns of unit deflections `(number, row, sample)`."""
        size = next(len(part) for part in shapes if part is not None)
        out = np.zeros((size, self.rows, self.samples))
        for field, part in zip(Deflection._fields, shapes, strict=True):
            if part is not None:
                for i in range(size):
                    self._add(out[i], field, np.asarray(part[i]))
        return out

    @cached_property
    def _units(self) -> dict[Effect, Deflection]:
        return {}

    @cached_property
    def _known(self) -> dict[Effect, Array]:
        return {}

    def _add(self, out: Array, field: str, shape: Array) -> None:
        sites = self.sites
        if field in ("joint", "stretch"):
            for j in range(len(shape)):
                if shape[j].any():
                    out += sites[field, j, 0] * shape[j]
        elif field == "link":
            for j, k in zip(*np.nonzero(shape.any(-1)), strict=True):
                out += sites["link", int(j), int(k)] * shape[j, k]
        elif field == "scale":
            out += sites["scale", 0, 0] * shape
        else:
            for k in np.flatnonzero(shape.any(-1)):
                out += sites[field, 0, int(k)] * shape[k]

    @cached_property
    def _rigid(self) -> Deflection:
        return Deflection(*map(np.asarray, dense(Deflection(), self.motion.dof, self.samples)))  # type: ignore[arg-type]


def case_of(recording: Recording, arm: Arm | None = None, geometry: Geometry = "declared") -> Case:
    """The case that a recording and its sidecar make.

    Raises:
        InputError: as `recording_problem`.
    """
    problem = recording_problem(recording, arm, geometry)
    arm, form = problem.arm, problem.form
    known_chain = isinstance(form.chain, SixParameterForm)
    values = np.asarray(problem.start.geometry) if known_chain else arm.kinematics.ravel()
    geometry_moves = bool(problem.movable[: form.chain.size].any())
    unknown: list[Site] = []
    precision: list[float] = []
    if geometry_moves or form.frame:
        unknown += [("base", 0, k) for k in range(6)]
    if geometry_moves:
        unknown += [("link", j, k) for j in range(arm.dof - 1) for k in range(6)]
    if form.tool:
        unknown += [("tool", 0, k) for k in range(6 if problem.rows == 6 else 3)]
    uncertainty = recording.settings.factory_uncertainty
    sigma = (GAUGE["m"], GAUGE["rad"])
    if known_chain and uncertainty is not None:
        sigma = (uncertainty.position_m, uncertainty.rotation_rad)
    for field, _, k in unknown:
        free = field == "tool" or (field == "base" and form.frame)
        precision.append(0.0 if free else 1 / sigma[k > 2] ** 2)
    return Case(
        recording=recording,
        arm=arm,
        chain=SixParameterForm(arm.dof),
        start=ArmModel(values, *(np.asarray(leaf) for leaf in problem.start[1:])),  # type: ignore[arg-type]
        unknown=tuple(unknown),
        precision=np.array(precision),
        offset=np.zeros(len(unknown)),
        motion=motion_of_recording(recording),
        inertia=inertia_of_arm(arm, recording.settings),
        measured=_measured(problem),
        noise=problem.noise,
        declared=problem.declared,
        notes=problem.notes,
    )


def moved_to(case: Case, moved: Array) -> Case:
    """The same case about the arm that the nuisance `(unknown,)` makes: its displacements become the chain's own."""
    return replace(case, start=arm_moved(case, moved), offset=case.offset + moved)


def arm_moved(case: Case, moved: Array) -> ArmModel:
    """The rigid arm that the nuisance `(unknown,)` makes of the start."""
    twists: dict[tuple[str, int], Array] = {}
    for (field, j, k), value in zip(case.unknown, moved, strict=True):
        twists.setdefault((field, j), np.zeros(6))[k] = value
    rows = np.array(np.asarray(case.start.geometry).reshape(-1, 6))
    T_sensor_base, T_flange_tool = (np.array(leaf) for leaf in case.start[1:])
    for (field, j), twist in twists.items():
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3]
        if field == "base":
            T_sensor_base = T_sensor_base @ T
        elif field == "tool":
            T_flange_tool = T @ T_flange_tool
        else:
            rows[j + 1] = frames.row_from_transform(T @ frames.transform_from_row(rows[j + 1]))
    return ArmModel(rows.ravel(), T_sensor_base, T_flange_tool)  # type: ignore[arg-type]


def _measured(problem: Problem) -> Measured:
    pose = problem.pose
    position = pose[:, :3, 3] if pose.ndim == 3 else pose
    rotation = np.moveaxis(pose[:, :3, :3], 0, -1) if pose.ndim == 3 else np.zeros((3, 3, 0))
    whitener = whitener_of(problem.covariance())
    if whitener.ndim == 3:
        whitener = np.moveaxis(whitener, 0, -1)
    return Measured(jnp.asarray(position.T), jnp.asarray(rotation), jnp.asarray(whitener))


def _is_linear(effect: Effect) -> bool:
    """Whether its deflections are proportional to its numbers: all of the catalogue that bends, but a free order."""
    free_order = isinstance(effect, JointHarmonic) and effect.order is None
    return isinstance(effect, Bending) and type(effect) in BUILT_IN.values() and not free_order


def _scaled(unit: Deflection, values: Array) -> Deflection:
    """The sum of unit deflections times values."""
    return Deflection(*(None if part is None else np.tensordot(values, part, 1) for part in unit))  # type: ignore[arg-type]


@partial(jax.jit, static_argnums=0)
def _loads(form: Form, kinematics: jax.Array, motion: Motion, inertia: Inertia) -> Loads:
    return loads(
        form,
        kinematics,
        turn(motion.joint_position),
        motion.payload,
        inertia,
        motion.joint_velocity,
        motion.joint_acceleration,
    )


def _plain_residual(
    form: Form, model: ArmModel, joint_position: jax.Array, deflection: Deflection, measured: Measured
) -> jax.Array:
    _, tool = predict_bent(form, model, joint_position, deflection)
    weight = jnp.ones(joint_position.shape[1])
    observed = Observations(turn(joint_position), measured.position, measured.rotation, weight, measured.whitener)
    return whiten(measured.whitener, differences(observed, tool))


_ONCE = {"xla_backend_optimization_level": 0}
_residual = jax.jit(_plain_residual, static_argnums=0, compiler_options=_ONCE)


@partial(jax.jit, static_argnums=0, compiler_options=_ONCE)
def _positions(form: Form, model: ArmModel, joint_position: jax.Array, deflection: Deflection) -> jax.Array:
    return predict_bent(form, model, joint_position, deflection)[1].origin


@partial(jax.jit, static_argnums=0)
def _sites(form: SixParameterForm, model: ArmModel, joint_position: jax.Array, measured: Measured) -> jax.Array:
    """`(site, row, sample)`: joints, stretches, links, base, tool, scale; `Deflection`'s own derivatives at none."""
    samples = joint_position.shape[1]
    joint = turn(joint_position)
    start = base_frame(model.T_sensor_base, samples)
    links = link_frames(form, model.geometry, joint, start)
    flange = jax.tree.map(lambda leaf: leaf[-1], links)
    tool = tool_frame(model, flange)
    rows = 6 if measured.rotation.shape[-1] else 3
    whitener = measured.whitener
    if whitener.ndim == 1:
        whitener = jnp.diag(jnp.repeat(whitener, 3)[:rows])[:, :, None]
    by_linear, by_angular = by_twist(
        Observations(joint, measured.position, measured.rotation, jnp.ones(samples), whitener), tool
    )

    def shifted(linear: jax.Array) -> jax.Array:
        return jnp.sum(by_linear * linear, 1)

    def turned(axis: jax.Array, origin: jax.Array) -> jax.Array:
        return shifted(cross(origin, axis)) + jnp.sum(by_angular * axis, 1)

    def displaced(frame: Frame) -> list[jax.Array]:
        return [*(shifted(axis) for axis in frame[:3]), *(turned(axis, frame.origin) for axis in frame[:3])]

    origins = jnp.concatenate([start.origin[None], links.origin])
    each = jax.lax.map(lambda frame: jnp.stack(displaced(frame)), links)
    parts = [
        each[:, 5],  # a joint's angle is about its frame's z
        jax.lax.map(shifted, jnp.diff(origins, axis=0)),
        each.reshape(-1, rows, samples),
        jnp.stack(displaced(start)),
        each[-1],
        shifted(tool.origin)[None],
    ]
    return jnp.concatenate(parts)
