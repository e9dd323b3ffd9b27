"""A rigid arm and a recording of its poses: the least-squares problem that screening and pose problems start from.

Of measured poses all is NumPy, so that a recording is screened in milliseconds and nothing is compiled. Touch sensors
are differentiated by JAX.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress
from typing import Any, Self

import numpy as np

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.array_types import Array, Integers, Mask
from lite6jax.calibration.problem import TOLERANCE, TOUCHED_TOLERANCE, Geometry, declared_geometry, recording_problem
from lite6jax.calibration.start import declared_tool
from lite6jax.domains.pose.kinematics import (
    FRAMES,
    RigidFrames,
    Site,
    displaced,
    measured_poses,
    rigid_columns,
    rigid_frames,
    rigid_residuals,
    whitened,
)
from lite6jax.errors import InputError
from lite6jax.estimation.least_squares import relinearise
from lite6jax.estimation.options import DEFAULTS
from lite6jax.estimation.robust import FREEDOM, gaussian_t_scale, t_scale
from lite6jax.estimation.terms import Factored, Term, Terms
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings import Recording
from lite6jax.recordings.alignment import frames_from_poses
from lite6jax.recordings.sequence import spread_rows
from lite6jax.sensors.points import POINT_SENSORS, Contact, Declaration, PointSensor
from lite6jax.sensors.sensor import Sensor
from lite6jax.sensors.usual import ADVICE

UNDECLARED_TOUCH = 1e-4
"""m, one sigma of readings whose noise is not declared."""
_TOOLS = 0.15 * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
"""m, where the tool's point is sought on the flange."""
_ROUGH_STEPS = 5
"""Of a fit that only tells whether a chain can be the right one."""


class NuisanceProblem:
    """A `LinearisedProblem` without terms: some frames are displaced, and the noise is what is left.

    What derives from it has `rigid`, the frames, `measured`, the poses or the sensor, `frame_columns`, how residuals
    change with its unknowns, and `relinearised`.
    """

    rigid: Any
    measured: Any
    preset = Terms(), np.zeros(0)
    floored = False
    curved = False

    @property
    def rows(self) -> int:
        """Numbers that a sample has: 3 or 6, of some touches 1."""
        return self.measured.rows

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.rigid.tool)

    @cached_property
    def differences(self) -> Array:
        """Predicted minus measured `(row, sample)`: m in sensor axes, and rotation vectors in tool axes."""
        return self.measured.differences(self.rigid.tool)

    @cached_property
    def residuals(self) -> Array:
        """`(row, sample)`, the differences over the declared noise."""
        return whitened(self.differences, self.measured.whitener)

    @property
    def groups(self: Any) -> Integers:
        """Position and orientation share one scale over their noise."""
        return np.zeros(self.rows, int)

    def nuisance_columns(self: Any, terms: Terms, values: Array) -> Array:
        """`frame_columns`, whatever terms are beside them."""
        return self.frame_columns

    def residual(self: Any, nuisance: Array, terms: Terms, values: Array) -> Array:
        """Residuals `(row, sample)` with the unknowns displaced."""
        if nuisance.any():
            return self.relinearised(nuisance).residuals
        return self.residuals

    def columns(
        self: Any, terms: Sequence[Term], values: Array | None = None, beside: tuple[Terms, Array] | None = None
    ) -> Array:
        """No columns, as there are no terms."""
        return np.zeros((0, self.rows, self.samples))

    def factored(self, term: Term) -> Factored | None:
        """None, of no terms."""
        return

    def limits(self, term: Term) -> list[tuple[float, float]]:
        """No limits, as there are no terms."""
        return []


@dataclass(frozen=True, eq=False)
class RigidArm(NuisanceProblem):
    """A rigid arm and its measured poses, a problem of the unknown displacements of its frames.

    A `PoseProblem` is one whose effects are sought.

    Attributes:
        recording: joints and poses.
        arm: the nominal arm.
        start: the six-parameter chain, sensor frame and tool of the linearisation.
        unknown: the nuisance, each a `Site`: the constant displacements of frames that are fitted, which to first order
            span the same changes of poses as a chain's numbers, without the singularities of angles; and then the
            sensor's own unknowns.
        precision: `(unknown,)`, one over the variance of their prior.
        offset: `(unknown,)`, from the prior's mean to `start`.
        informative: `(unknown,)` bool, of which the prior counts as evidence: of all where the sidecar declares the
            chain's uncertainty or the readings are touches; of the sensor's own always.
        noise: standard deviation per axis of position (m) and orientation (rad), declared or assumed.
        declared_noise: the same, each None where the sidecar does not declare it.
        measured: the poses, or the sensor of touches.
        exact: whether the chain has six parameters a joint, as where the sidecar declares it.
        form: of the chain that is fitted, and whether the sensor's frame and the tool are.
    """

    recording: Recording
    arm: Arm
    start: ArmModel
    unknown: tuple[Site, ...]
    precision: Array
    offset: Array
    informative: Mask
    noise: tuple[float, float | None]
    declared_noise: tuple[float | None, float | None]
    measured: Sensor
    exact: bool
    form: ModelForm

    @property
    def samples(self) -> int:
        """Number of samples; no frames are computed for it."""
        return self.recording.samples

    @cached_property
    def links(self) -> Array:
        """`(joint, 4, 4)`, the fixed transform before each joint."""
        return frames.transform_from_row(np.asarray(self.start.geometry).reshape(-1, 6))

    @property
    def T_sensor_base(self) -> Array:
        """`(4, 4)`, from the base to the sensor's frame."""
        return np.asarray(self.start.T_sensor_base)

    @property
    def T_flange_tool(self) -> Array:
        """`(4, 4)`, from the frame after the last joint."""
        return np.asarray(self.start.T_flange_tool)

    @property
    def model(self) -> ArmModel:
        """The arm; where the sensor's frame is not fitted, the first link has the base's displacement."""
        if self.form.frame:
            return self.start
        rows = np.array(self.start.geometry).reshape(-1, 6)
        rows[0] = frames.row_from_transform(self.T_sensor_base @ frames.transform_from_row(rows[0]))
        return ArmModel(rows.ravel(), np.eye(4), self.start.T_flange_tool)  # type: ignore[arg-type]

    @property
    def joint_position(self) -> Array:
        """`(joint, sample)` rad, m of prismatic joints, at the instants of the poses."""
        return self.recording.joint_position.T

    @cached_property
    def rigid(self) -> RigidFrames:
        """The arm's frames in the sensor's, on the host."""
        return rigid_frames(self.start, self.joint_position, self.recording.sliding)

    @cached_property
    def differences(self) -> Array:
        """Predicted minus measured poses `(row, sample)`, m and rad."""
        return rigid_residuals(self.start, self.joint_position, self.recording.sliding, self.measured)

    @cached_property
    def plain_twists(self) -> Array:
        """`((joint + 1) 6, row, sample)`: how differences change with a twist of each frame, in its own axes."""
        twists = rigid_columns(self.rigid, self.measured)
        return twists.reshape(-1, self.rows, self.samples)

    @cached_property
    def twists(self) -> Array:
        """`plain_twists` over the declared noise."""
        return self.whitened(self.plain_twists)

    @property
    def joints(self) -> Array:
        """`(joint, row, sample)`: how residuals change with what is added to each joint's position."""
        return self.twists[11::6]

    @property
    def frame_columns(self) -> Array:
        """`(unknown, row, sample)`: how residuals change with the unknowns."""
        first = {"base": 0, "link": 6, "tool": 6 * len(self.links)}
        moved = self.twists[[first[name] + 6 * j + k for name, j, k in self.unknown if name in FRAMES]]
        if not self.measured.numbers:
            return moved
        return np.concatenate([moved, self.whitened(self.measured.by_numbers(self.rigid.tool))])

    @cached_property
    def squares(self) -> Array:
        """`(sample,)`, of the residuals."""
        return np.sum(self.residuals**2, 0)

    @cached_property
    def scale(self) -> float:
        """Robust scale of the residuals over the declared noise; 1 where they are that noise and nothing else."""
        return t_scale(self.squares, self.rows, FREEDOM) / gaussian_t_scale(self.rows, FREEDOM)

    @property
    def distance(self) -> Array:
        """`(sample,)` m from predicted to measured position."""
        return np.linalg.norm(self.differences[:3], axis=0)

    @property
    def turn(self) -> Array:
        """`(sample,)` rad between predicted and measured orientation; zero where none was measured."""
        return np.linalg.norm(self.differences[3:], axis=0)

    def whitened(self, columns: Array) -> Array:
        """Columns `(…, row, sample)` in m and rad over the declared noise."""
        return whitened(columns, self.measured.whitener)

    def displaced(self, nuisance: Array) -> ArmModel:
        """The arm `start` with its frames displaced by the nuisance `(unknown,)`."""
        return displaced(self.start, self.unknown, nuisance)

    def own_numbers(self, nuisance: Array) -> Array:
        """The sensor's own unknowns in a nuisance `(unknown,)`."""
        return nuisance[[k for k, site in enumerate(self.unknown) if site[0] == "reading"]]

    def relinearised(self, nuisance: Array, beside: tuple[Terms, Array] | None = None) -> Self:
        """The same problem linearised at `displaced(nuisance)`: nuisance zero is then there. It has no terms."""
        sensor_numbers = self.own_numbers(nuisance)
        measured = self.measured.displaced(sensor_numbers) if len(sensor_numbers) else self.measured
        return replace(self, start=self.displaced(nuisance), measured=measured, offset=self.offset + nuisance)

    def with_poses(self, recording: Recording) -> Self:
        """The arm with other poses of the same sensor, weighed as these are."""
        sensor = self.measured.reading_as(measured_poses(recording, self.measured.whitener))
        return replace(self, recording=recording, measured=sensor)

    def select(self, rows: Integers) -> Self:
        """Some of the samples."""
        return replace(self, recording=self.recording.select(rows), measured=self.measured.select(rows))

    def keeping(self, mask: Sequence[bool]) -> Self:
        """The arm with some of its unknowns; all others stay where they are."""
        return replace(
            self,
            unknown=tuple(compress(self.unknown, mask)),
            precision=self.precision[mask],
            offset=self.offset[mask],
            informative=self.informative[mask],
        )

    def fitted(self, limit: int) -> Self:
        """The arm with its unknowns fitted, to `limit` evenly spaced samples where there are more."""
        if self.samples <= limit:
            return relinearise(self, DEFAULTS)
        subset = self.select(spread_rows(self.samples, limit)).fitted(limit)
        return replace(
            self, start=subset.start, measured=subset.measured.reading_as(self.measured), offset=subset.offset
        )

    def log_likelihood(self, scale: float) -> float:
        """Log-likelihood of Student's t at `scale` times the declared noise and of the prior, but for terms of it."""
        spread = (FREEDOM + self.rows) * np.sum(np.log1p(self.squares / scale**2 / FREEDOM))
        return -0.5 * float(spread + np.sum(self.precision * self.offset**2))


LEAST_KNOWN = {"m": 0.1, "rad": 0.5}
"""One sigma of a number beyond which the readings do not determine it."""
_FEWEST_READINGS = 5
"""A fifth of them is held back."""
_DIRECTION_KNOWN = 0.01
"""rad, the same of a plane's normal or an axis: where a plane is touched at one place, noise passes for its normal."""


def require_determined(arm: RigidArm) -> None:
    """Refuses readings that say nothing of the tool, of the sensor's frame or of a place, were the chain exact.

    Args:
        arm: near the true one. Of recorded poses nothing is refused: a fit says what they leave open.

    Raises:
        InputError: as said, in one line with the remedy.
    """
    readings = arm.recording.readings
    if readings is None:
        return
    if arm.samples < _FEWEST_READINGS:
        raise InputError(f"{arm.recording.source}: its {arm.samples} readings are too few; {ADVICE[readings.kind]}")
    sensor_numbers = iter(arm.measured.own)
    numbers = []
    for k, (name, _, axis) in enumerate(arm.unknown):
        if name == "reading":
            number = next(sensor_numbers)
            if not number.precision:
                numbers.append((k, number.name, LEAST_KNOWN["m"] if number.unit == "m" else _DIRECTION_KNOWN))
        elif name == "tool" or (name == "base" and arm.form.frame):
            part = "the tool" if name == "tool" else "the sensor's frame"
            numbers.append((k, part, LEAST_KNOWN["m" if axis < 3 else "rad"]))
    if not numbers:
        return
    at, names, sizes = zip(*numbers, strict=True)
    J = (arm.frame_columns[list(at)] * np.array(sizes)[:, None, None]).reshape(len(at), -1)
    eigenvalues, V = np.linalg.eigh(J @ J.T)
    if eigenvalues[0] >= 1.0:
        return
    strong = [names[k] for k in np.argsort(-np.abs(V[:, 0]))[:3] if abs(V[k, 0]) > 0.3 * np.abs(V[:, 0]).max()]
    raise InputError(
        f"{arm.recording.source}: its {arm.samples} readings say nothing of {' and '.join(dict.fromkeys(strong))}; "
        f"{ADVICE[readings.kind]}"
    )


def rigid_arm(
    recording: Recording,
    arm: Arm | None = None,
    geometry: Geometry = "declared",
    factory: FactoryCalibration | None = None,
) -> RigidArm:
    """The rigid arm of a recording and its sidecar, with its frames in closed form; not fitted yet.

    Args:
        recording: measured poses.
        arm: the nominal arm; from the sidecar where not given.
        geometry: what is known of it, as in `fit`.
        factory: the arm's calibration; from the sidecar where not given.

    Raises:
        InputError: as `recording_problem`.
    """
    touches = recording.touches
    T_frame = np.eye(4)
    if touches is not None:
        declaration = declared_geometry(recording, arm, geometry, factory)
        arm = declaration.arm
        form = declaration.form
        movable = declaration.movable
        values = declaration.values
        declared = touches.declared_noise(recording.settings), None
        noise = declared[0] or UNDECLARED_TOUCH, None
        sensor = recorded_sensor(recording, noise[0])
        if not declaration.calibrated:
            _require_scale(recording, sensor)
        T_tool = declaration.known.T_joint_flange @ (np.eye(4) if form.tool else declared_tool(recording))
    else:
        problem = recording_problem(recording, arm, geometry, factory)
        arm = problem.arm
        form = problem.form
        movable = problem.movable
        noise = problem.noise
        declared = problem.declared_noise
        whitener = problem.whitener
        sensor = measured_poses(recording, whitener if whitener.ndim == 1 else np.moveaxis(whitener, 0, -1))
        values, T_frame, T_tool = (np.asarray(leaf) for leaf in problem.start)
    exact = isinstance(form.chain, SixParameterForm)
    start = ArmModel(values if exact else arm.kinematics.ravel(), T_frame, T_tool)  # type: ignore[arg-type]
    geometry_moves = bool(movable[: form.chain.size].any())
    unknown: list[Site] = []
    if geometry_moves or form.frame:
        unknown += [("base", 0, k) for k in range(6)]
    if geometry_moves:
        unknown += [("link", j, k) for j in range(arm.dof - 1) for k in range(6)]
    if form.tool:
        unknown += [("tool", 0, k) for k in range(6 if recording.numbers_per_sample == 6 else 3)]
    uncertainty = None
    if factory is None:
        uncertainty = recording.settings.factory_uncertainty
    sigma = (TOLERANCE["m"], TOLERANCE["rad"]) if touches is None else TOUCHED_TOLERANCE
    if exact and uncertainty is not None:
        sigma = (uncertainty.position_m, uncertainty.rotation_rad)
    free = [name == "tool" or (name == "base" and form.frame) for name, _, _ in unknown]
    precision = [0.0 if is_free else sigma[k > 2] ** -2.0 for (_, _, k), is_free in zip(unknown, free, strict=True)]
    sensor_numbers = sensor.own
    stated = [uncertainty is not None or touches is not None] * len(unknown) + [True] * len(sensor_numbers)
    unknown += [("reading", k, 0) for k in range(len(sensor_numbers))]
    begun = RigidArm(
        recording=recording,
        arm=arm,
        start=start,
        unknown=tuple(unknown),
        precision=np.array([*precision, *(number.precision for number in sensor_numbers)]),
        offset=np.array([*np.zeros(len(precision)), *(number.offset for number in sensor_numbers)]),
        informative=np.array(stated, bool),
        noise=noise,
        declared_noise=declared,
        measured=sensor,
        exact=exact,
        form=form,
    )
    return begun if touches is None else _place_touches(begun, len(_TOOLS))


def with_joints_of_touches(arm: RigidArm, recording: Recording) -> RigidArm:
    """An arm of touches that is not fitted, with other joint positions of the same touches, placed roughly."""
    tool = np.eye(4) if arm.form.tool else declared_tool(recording)
    start = arm.start._replace(T_flange_tool=arm.arm.T_joint_flange @ tool)  # type: ignore[arg-type]
    return _place_touches(replace(arm, recording=recording, start=start), 1)


def _place_touches(arm: RigidArm, tries: int) -> RigidArm:
    """The arm with its frame, its tool and the sensor's unknowns where the chain of its start has them.

    Args:
        arm: with a tool at the flange, or the declared one.
        tries: how many points of an unknown tool are tried.
    """
    if not arm.form.frame:
        return _locate_tool(arm, tries)
    assert isinstance(arm.measured, Contact)  # all of whose points are known in the sensor's frame
    flange = frames.chain(arm.links, arm.recording.joint_position, arm.recording.sliding) @ arm.arm.T_joint_flange
    tool = None if arm.form.tool else declared_tool(arm.recording)
    T_frame, tool = frames_from_poses(flange, arm.measured.points.T[arm.measured.group], None, None, tool)
    T_tool = arm.arm.T_joint_flange @ tool
    return replace(arm, start=arm.start._replace(T_sensor_base=T_frame, T_flange_tool=T_tool))  # type: ignore[arg-type]


def _locate_tool(arm: RigidArm, tries: int) -> RigidArm:
    """The arm of touches with its tool's point and the sensor's unknowns where the nominal chain meets them best.

    Several points of an unknown tool are tried. At each the sensor's unknowns are computed in closed form, and then all
    are fitted by least squares.
    """
    reduced = arm.keeping([name in ("tool", "reading") for name, _, _ in arm.unknown])
    candidates = []
    for point in _TOOLS[: tries if arm.form.tool else 1]:
        T_flange_tool = arm.T_flange_tool @ frames.transform_from_row([*point, 0, 0, 0])
        begun = replace(reduced, start=arm.start._replace(T_flange_tool=T_flange_tool))  # type: ignore[arg-type]
        assert isinstance(arm.measured, PointSensor)
        steps = None if tries > 1 else _ROUGH_STEPS
        shown = _with_sensor(begun, arm.measured.shown(begun.rigid.tool))
        candidates.append(relinearise(shown, DEFAULTS, steps=steps))
    closest = min(candidates, key=lambda candidate: float(np.median(candidate.squares)))
    return _with_sensor(replace(arm, start=closest.start), closest.measured)


def _with_sensor(arm: RigidArm, sensor: Sensor) -> RigidArm:
    """The arm with another sensor of its kind, and its own frames at the mean of their prior."""
    offset = np.array([*np.zeros(len(arm.unknown) - sensor.numbers), *(number.offset for number in sensor.own)])
    return replace(arm, measured=sensor, offset=offset)


def recorded_sensor(recording: Recording, noise: float) -> PointSensor:
    """The sensor of touches, distances or heights, with what is known of its points, planes, anchors or axis.

    Args:
        recording: of such readings.
        noise: m, one sigma of them.

    Raises:
        InputError: a ring of known distances, or one place for several anchors.
    """
    readings = recording.touches
    assert readings is not None
    present, group = np.unique(readings.group, return_inverse=True)
    names = tuple(readings.names[k] for k in present)
    declaration = Declaration(recording.settings, names, group, readings.value, noise, recording.source)
    return POINT_SENSORS[readings.kind].from_declaration(declaration)


def _require_scale(recording: Recording, sensor: PointSensor) -> None:
    """Refuses touches that any chain of another size would have as well.

    Raises:
        InputError: as said, or known distances of contacts that are not there.
    """
    if sensor.scaled:
        return
    remedy = "declare one plane's place as planes: {a: {normal, offset_m}}"
    if isinstance(sensor, Contact):
        if distances := recording.settings.contact_distances:
            a, b = distances[0].between
            raise InputError(
                f"{recording.source}: contact_distances is between {a} and {b}, which are not both among its contacts "
                f"{', '.join(sensor.names[:6])}; correct the names"
            )
        remedy = "declare a known distance as contact_distances: [{between: [a, b], distance_m: 0.05, noise_m: 5.0e-5}]"
    raise InputError(
        f"{recording.source}: nothing in it has a known length, and any size of the arm would fit; {remedy}, or "
        "the arm's own factory_calibration"
    )
