"""A rigid arm beside a recording as a problem of least squares: on the host, in milliseconds, nothing compiled."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.domains.pose.problem import GAUGE
from lite6jax.domains.pose.screening.options import ScreeningOptions
from lite6jax.estimation.least_squares import relinearise
from lite6jax.estimation.options import DEFAULTS
from lite6jax.estimation.robust import FREEDOM, gaussian_t_scale, t_scale
from lite6jax.estimation.terms import Term, Terms
from lite6jax.fitting.problem import Geometry, recording_problem
from lite6jax.recordings import Recording
from lite6jax.recordings.sequence import differentiate, run_segments

Array = NDArray[np.floating]


@final
@dataclass(frozen=True, eq=False)
class Rigid:
    """A rigid arm and the measured poses, a `LinearisedProblem` whose nuisance are twists of frames in their own axes.

    It has more than twelve members because that protocol has.

    Attributes:
        recording: joints and poses.
        arm: the nominal arm.
        links: `(joint, 4, 4)` the fixed transform before each joint.
        T_sensor_base, T_flange_tool: `(4, 4)`; the tool's is from the frame after the last joint.
        unknown: indices into the `(dof + 1) 6` numbers of `twists`, what is fitted.
        precision: `(unknown,)` one over the variance of what is known of them beforehand.
        offset: `(unknown,)` how far this arm is from that.
        noise: one standard deviation per axis of position (m) and orientation (rad), as declared or assumed.
        whitener: `(row,)`, or `(sample, row, row)` where the joints' read-outs have noise.
        exact: whether the sidecar says the chain, and it holds as it is or nearly.
    """

    recording: Recording
    arm: Arm
    links: Array
    T_sensor_base: Array
    T_flange_tool: Array
    unknown: NDArray[np.integer]
    precision: Array
    offset: Array
    noise: tuple[float, float | None]
    whitener: Array
    exact: bool

    @cached_property
    def frames(self) -> Array:
        """`(dof + 1, sample, 4, 4)`: the base, and the frame after each joint's rotation, in the sensor's."""
        turns = frames.joint_rotations(self.recording.joint_position)
        T = np.broadcast_to(self.T_sensor_base, (self.recording.samples, 4, 4))
        out = [T]
        for i, link in enumerate(self.links):
            T = T @ link @ turns[:, i]
            out.append(T)
        return np.stack(out)

    @cached_property
    def tool(self) -> Array:
        """`(sample, 4, 4)`, in the sensor's frame."""
        return self.frames[-1] @ self.T_flange_tool

    @cached_property
    def residuals(self) -> Array:
        """`(row, sample)`, whitened: predicted less measured position, and the turn between, in the sensor's axes."""
        return self.whitened(self._differences[None])[0]

    @cached_property
    def twists(self) -> Array:
        """`((dof + 1) 6, row, sample)`: how the residual changes with a twist of each of `frames`."""
        return self.whitened(self.plain_twists)

    @cached_property
    def plain_twists(self) -> Array:
        """`twists` in m and rad."""
        R = np.moveaxis(self.frames[:, :, :3, :3], 1, -1)  # (frame, axis, component, sample)
        lever = np.moveaxis(self.tool[:, :3, 3] - self.frames[:, :, :3, 3], 1, -1)
        directions = np.moveaxis(R, 2, 1)  # (frame, component, axis, sample)
        turned = np.cross(directions, lever[:, None], axis=2)
        out = np.concatenate([directions, turned], 1)
        if self.rows == 6:
            out = np.concatenate([out, np.concatenate([np.zeros_like(directions), directions], 1)], 2)
        return out.reshape(-1, self.rows, self.samples)

    @property
    def samples(self) -> int:
        """How many."""
        return self.recording.samples

    @property
    def rows(self) -> int:
        """Numbers a sample has: 3 or 6."""
        return self.recording.numbers_per_sample

    @property
    def joints(self) -> Array:
        """`(joint, row, sample)`: how the residual changes with what is added to each joint."""
        return self.twists[11::6]

    @property
    def scale(self) -> float:
        """Of the residual, robust; 1 where the sensor's noise is all there is."""
        return t_scale(self.squares, self.rows, FREEDOM) / gaussian_t_scale(self.rows, FREEDOM)

    @property
    def squares(self) -> Array:
        """`(sample,)` whitened."""
        return np.sum(self.residuals**2, 0)

    @property
    def distance(self) -> Array:
        """`(sample,)` m from predicted to measured."""
        return np.linalg.norm(self._differences[:3], axis=0)

    @property
    def turn(self) -> Array:
        """`(sample,)` rad between predicted and measured orientation; zero where none was measured."""
        return np.linalg.norm(self._differences[3:], axis=0)

    def whitened(self, columns: Array) -> Array:
        """Columns `(number, row, sample)` in m and rad, in standard deviations."""
        if self.whitener.ndim == 1:
            return columns * self.whitener[:, None]
        return np.moveaxis(np.matmul(self.whitener, np.moveaxis(columns, -1, 0).swapaxes(1, 2)), 0, -1).swapaxes(0, 1)

    @property
    def groups(self) -> NDArray[np.integer]:
        """Position and orientation share one scale over the declared noise."""
        return np.zeros(self.rows, int)

    @property
    def nuisance(self) -> Array:
        """How the residual changes with the unknowns, `(unknown, row, sample)`."""
        return self.twists[self.unknown]

    @property
    def preset(self) -> tuple[Terms, Array]:
        """None: a rigid arm has no effects."""
        return Terms(), np.zeros(0)

    def residual(self, nuisance: Array, terms: Terms, values: Array) -> Array:
        """`residuals` with the unknowns displaced."""
        return self.relinearised(nuisance).residuals if nuisance.any() else self.residuals

    def columns(
        self, terms: Sequence[Term], values: Array | None = None, beside: tuple[Terms, Array] | None = None
    ) -> Array:
        """Of no terms."""
        return np.zeros((0, self.rows, self.samples))

    def fitted(self, options: ScreeningOptions) -> "Rigid":
        """With its unknowns where Student's t has them."""
        if self.samples <= options.most_fitted:
            return relinearise(self, DEFAULTS)
        few = self.select(np.linspace(0, self.samples - 1, options.most_fitted).astype(int)).fitted(options)
        return replace(
            self,
            links=few.links,
            T_sensor_base=few.T_sensor_base,
            T_flange_tool=few.T_flange_tool,
            offset=few.offset,
        )

    def select(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> "Rigid":
        """Some of the samples."""
        whitener = self.whitener if self.whitener.ndim == 1 else self.whitener[rows]
        return replace(self, recording=self.recording.select(rows), whitener=whitener)

    def relinearised(self, nuisance: Array) -> "Rigid":
        """With the unknowns `(unknown,)` displaced."""
        twist = np.zeros((len(self.links) + 1, 6))
        twist.reshape(-1)[self.unknown] = nuisance
        displaced = np.array([transform_of(row) for row in twist])
        links = self.links.copy()
        links[1:] = displaced[1:-1] @ links[1:]
        return replace(
            self,
            links=links,
            T_sensor_base=self.T_sensor_base @ displaced[0],
            T_flange_tool=displaced[-1] @ self.T_flange_tool,
            offset=self.offset + nuisance,
        )

    @cached_property
    def _differences(self) -> Array:
        assert self.recording.position is not None
        apart = (self.tool[:, :3, 3] - self.recording.position).T
        if self.recording.quaternion is None:
            return apart
        measured = Rotation.from_quat(np.roll(self.recording.quaternion, -1, axis=1))
        turn = Rotation.from_matrix(self.tool[:, :3, :3]) * measured.inv()
        return np.concatenate([apart, turn.as_rotvec().T])

    def log_likelihood(self, scale: float) -> float:
        """Student's t, in noise of `scale` times the whitener's, and what is known beforehand, but for a constant."""
        spread = (FREEDOM + self.rows) * np.sum(np.log1p(self.squares / scale**2 / FREEDOM))
        return -0.5 * float(spread + np.sum(self.precision * self.offset**2))


def rigid_of(
    recording: Recording,
    arm: Arm | None = None,
    geometry: Geometry = "declared",
    factory: FactoryCalibration | None = None,
) -> Rigid:
    """The rigid arm that a recording and its sidecar make, frames where a closed form puts them, not fitted yet.

    Raises:
        InputError: as `recording_problem`.
    """
    problem = recording_problem(recording, arm, geometry, factory)
    form = problem.form
    chain_moves = bool(problem.movable[: form.chain.size].any())
    known = isinstance(form.chain, SixParameterForm)
    links = problem.arm.links
    if known:
        links = np.stack([frames.transform_from_row(row) for row in np.asarray(problem.start.geometry).reshape(-1, 6)])
    dof = recording.dof
    uncertainty = None if factory is not None else recording.settings.factory_uncertainty
    sigma = np.repeat((GAUGE["m"], GAUGE["rad"]), 3)
    if known and uncertainty is not None:
        sigma = np.repeat((uncertainty.position_m, uncertainty.rotation_rad), 3)
    unknown, precision = [], []
    if chain_moves or form.frame:
        unknown += [range(6)]
        precision += [np.zeros(6) if form.frame else sigma**-2.0]
    if chain_moves:
        unknown += [range(6, 6 * dof)]
        precision += [np.tile(sigma**-2.0, dof - 1)]
    if form.tool:
        unknown += [range(6 * dof, 6 * dof + problem.rows)]
        precision += [np.zeros(problem.rows)]
    size = sum(map(len, precision))
    sigma = np.repeat([problem.noise[0], problem.noise[1] or 1.0], 3)[: problem.rows]
    arm_there = Rigid(
        recording=recording,
        arm=problem.arm,
        links=links,
        T_sensor_base=np.asarray(problem.start.T_sensor_base),
        T_flange_tool=np.asarray(problem.start.T_flange_tool),
        unknown=np.concatenate([np.array(part, int) for part in unknown]) if unknown else np.zeros(0, int),
        precision=np.concatenate(precision) if precision else np.zeros(0),
        offset=np.zeros(size),
        noise=problem.noise,
        whitener=1 / sigma,
        exact=known,
    )
    if not problem.joint_noise:
        return arm_there
    J = arm_there.plain_twists[11::6] * problem.joint_noise
    covariance = np.einsum("jas,jbs->sab", J, J, optimize=True) + np.diag(sigma**2)
    return replace(arm_there, whitener=np.linalg.inv(np.linalg.cholesky(covariance)))


def transform_of(twist: Array) -> Array:
    """`(4, 4)` of a small displacement `(6,)`: its translation, and its rotation vector."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3]
    return T


def physics_columns(arm: Rigid, skip: tuple[str, ...] = ()) -> Array:
    """`(number, row, sample)`: what the catalogue's effects would do, roughly and in closed form.

    Joints: offset, scale, two harmonics, gravity's torque, direction, velocity, acceleration. Links and base: gravity's
    moments. Base: a drift that is a cubic of time. The sensor's scale and the links', and these with the temperature.

    Args:
        arm: fitted.
        skip: "direction", "drift" or "links" (of their own length each), to be left out.
    """
    recording, joints, twists = arm.recording, arm.joints, arm.twists
    q = recording.joint_position.T
    out = [
        joints * shape[:, None] for shape in (np.ones_like(q), q, np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q))
    ]
    if "direction" not in skip:
        out.append(joints * recording.direction_of_motion.T[:, None])
    if recording.motion == "trajectory" and recording.joint_velocity is not None:
        out.append(joints * recording.joint_velocity.T[:, None])
        if recording.time is not None:
            acceleration = differentiate(recording.joint_velocity, recording.time, run_segments(recording.run))
            out.append(joints * acceleration.T[:, None])
    moment = _moments(arm)
    if moment is not None:
        out.append(joints * moment[1:, 2, None])
        out += [twists[3::6] * moment[:, 0, None], twists[4::6] * moment[:, 1, None]]
    time = np.arange(arm.samples, dtype=float) if recording.time is None else recording.time
    time = 2 * (time - time.min()) / max(float(np.ptp(time)), 1e-9) - 1
    if "drift" not in skip:
        out += [twists[:6] * time**power for power in (1, 2, 3)]
    out += [twists[6 * len(joints) :][: arm.rows], twists[:6]]
    warmth = time
    for column in (recording.joint_temperature, recording.ambient_temperature):
        if column is not None:
            warmth = column.reshape(arm.samples, -1).mean(1) - recording.settings.reference_temperature_degC
            break
    along = np.concatenate([arm.links[:, :3, 3], arm.T_flange_tool[None, :3, 3]])
    stretch = np.einsum("jk,jkrs->jrs", along, twists.reshape(len(along), 6, arm.rows, -1)[:, :3])
    seen = np.zeros((1, arm.rows, arm.samples))
    seen[0, :3] = arm.tool[:, :3, 3].T
    stretch = stretch.sum(0, keepdims=True) if "links" in skip else stretch
    scale = np.concatenate([stretch, arm.whitened(seen)])
    out += [scale, scale * warmth]
    return np.concatenate(out)


def _moments(arm: Rigid) -> Array | None:
    """`(dof + 1, 3, sample)` gravity's moment about the base's and each frame's origin, in its axes."""
    if arm.arm.mass is None or arm.arm.center_of_mass is None:
        return None
    recording, F = arm.recording, arm.frames
    g = arm.T_sensor_base[:3, :3] @ np.array(recording.settings.gravity_m_per_s2)
    center = arm.arm.T_joint_flange[:3, :3] @ np.array(recording.settings.payload_com_m) + arm.arm.T_joint_flange[:3, 3]
    R, o = F[..., :3, :3], F[..., :3, 3]
    first = arm.arm.mass[:, None, None] * (np.einsum("jsab,jb->jsa", R[1:], arm.arm.center_of_mass) + o[1:])
    first[-1] += recording.payload[:, None] * (R[-1] @ center + o[-1])
    weight = np.cumsum(arm.arm.mass[::-1])[::-1, None] + recording.payload
    pulled = np.cumsum(first[::-1], 0)[::-1]
    pulled, weight = np.concatenate([pulled[:1], pulled]), np.concatenate([weight[:1], weight])
    return np.einsum("jsab,jsa->jbs", R, np.cross(pulled - weight[..., None] * o, g))
