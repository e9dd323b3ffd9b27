"""Residuals without what known columns can do, and what other columns explain of the rest, with honest deviations."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lite6jax.array_types import Array
from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.domains.pose.screening.thresholds import OBSERVABLE_SHARE
from lite6jax.estimation.projection import orthonormal, outside, unit_rows
from lite6jax.estimation.thresholds import EIGENVALUE_ROUNDING
from lite6jax.recordings.sequence import differentiate, run_segments

_HUBER_SIGMAS = 4.0
"""Deviations per number beyond which a sample counts less; one normal one in 16 000 does."""
_CONVERGED = 0.1
"""Standard deviations of the last step of a correction: below what the correction is known to."""


@dataclass(frozen=True, eq=False)
class Projected:
    """Residuals from which all that known columns can do is taken out; samples far off count for less.

    Attributes:
        arm: fitted.
        nuisance: `(number, row, sample)`, beside the arm's own unknowns.
    """

    arm: RigidArm
    nuisance: Array

    @cached_property
    def weight(self) -> Array:
        """`(sample,)` square root of Huber's."""
        length = np.sqrt(self.arm.squares / self.arm.rows) / self.arm.scale
        return np.sqrt(np.minimum(1.0, _HUBER_SIGMAS / np.maximum(length, 1e-300)))

    @cached_property
    def basis(self) -> Array:
        """`(rank, row sample)`, orthonormal, of the known columns."""
        columns = np.concatenate([self.arm.frame_columns, self.nuisance]) * self.weight
        flat = columns.reshape(len(columns), self.arm.rows * self.arm.samples)
        return orthonormal(unit_rows(flat), EIGENVALUE_ROUNDING)

    @cached_property
    def residual(self) -> Array:
        """`(row sample)`."""
        return self.without(self.arm.residuals[None])[0]

    @cached_property
    def freedom(self) -> int:
        """Residual degrees of freedom."""
        return self.arm.rows * self.arm.samples - len(self.basis)

    def without(self, columns: Array) -> Array:
        """Weighted columns `(number, row, sample)` less what the known ones can do, `(number, row sample)`."""
        return outside((columns * self.weight).reshape(len(columns), -1), self.basis)

    def regression(self, columns: Array) -> tuple[Array, Array, float]:
        """Numbers `(number,)` of columns that explain the residual, their covariance, and the squares they explain.

        The covariance is the larger of that of white noise and that of samples of unequal noise (H. White,
        Econometrica 48, 1980).
        """
        X = self.without(columns)
        size = np.linalg.norm((columns * self.weight).reshape(len(columns), -1), axis=1)
        G = X @ X.T
        confounded = np.sqrt(np.diagonal(G)) <= np.sqrt(OBSERVABLE_SHARE) * size
        G[confounded, confounded] = np.maximum(G[confounded, confounded], size[confounded] ** 2 * 1e9 + 1e300)
        inverse = np.zeros_like(G) if confounded.all() else np.linalg.inv(G)
        inverse[confounded] = inverse[:, confounded] = 0.0
        values = -inverse @ (X @ self.residual)
        remainder = self.residual + values @ X
        white = inverse * max(float(remainder @ remainder) / max(self.freedom - len(X), 1), 1e-300)
        pulls = (X * remainder).reshape(len(X), self.arm.rows, -1).sum(1)
        uneven = inverse @ (pulls @ pulls.T) @ inverse
        grown = np.sqrt(np.maximum(1.0, np.diagonal(uneven) / np.maximum(np.diagonal(white), 1e-300)))
        covariance = white * np.outer(grown, grown)
        covariance[confounded, confounded] = np.inf
        explained = float(values @ (X @ X.T) @ values)
        return values, covariance, explained / max(float(remainder @ remainder) / max(self.freedom - len(X), 1), 1e-300)


def estimated(arm: RigidArm, nuisance: Array, columns: Array) -> tuple[Array, Array]:
    """The numbers of `columns` `(number, row, sample)` and their standard deviations, beside the known ones."""
    values, covariance, _ = Projected(arm, nuisance).regression(columns)
    return values, np.sqrt(np.diagonal(covariance))


def next_step(arm: RigidArm, nuisance: Array, columns: Array) -> Array | None:
    """What a correction by `columns` still lacks, `(number,)`; None where that is little beside its deviations."""
    values, std = estimated(arm, nuisance, columns)
    if np.all(np.abs(values) < _CONVERGED * std):
        return None
    return np.where(np.isfinite(std), values, 0.0)


def physics_columns(arm: RigidArm, skip: tuple[str, ...] = ()) -> Array:
    """`(number, row, sample)`: what the catalogue's effects would do, roughly and in closed form.

    Joints: offset, scale, two harmonics, gravity's torque, direction, velocity, acceleration. Links and base: gravity's
    moments. Base: a drift that is a cubic of time. The sensor's scale and the links', and these with the temperature.

    Args:
        arm: fitted.
        skip: "direction", "drift" or "links" (of their own length each), to be left out.
    """
    recording = arm.recording
    joints = arm.joints
    twists = arm.twists
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
    positions = np.zeros((1, arm.rows, arm.samples))
    positions[0, :3] = arm.rigid.tool[:, :3, 3].T
    if "links" in skip:
        stretch = stretch.sum(0, keepdims=True)
    scale = np.concatenate([stretch, arm.whitened(positions)])
    out += [scale, scale * warmth]
    return np.concatenate(out)


def _moments(arm: RigidArm) -> Array | None:
    """`(dof + 1, 3, sample)` gravity's moment about the base's and each frame's origin, in its axes."""
    if arm.arm.mass is None or arm.arm.center_of_mass is None:
        return None
    recording = arm.recording
    F = arm.rigid.frames
    g = arm.T_sensor_base[:3, :3] @ np.array(recording.settings.gravity_m_per_s2)
    center = arm.arm.T_joint_flange[:3, :3] @ np.array(recording.settings.payload_com_m) + arm.arm.T_joint_flange[:3, 3]
    R = F[..., :3, :3]
    o = F[..., :3, 3]
    first = arm.arm.mass[:, None, None] * (np.einsum("jsab,jb->jsa", R[1:], arm.arm.center_of_mass) + o[1:])
    first[-1] += recording.payload[:, None] * (R[-1] @ center + o[-1])
    weight = np.cumsum(arm.arm.mass[::-1])[::-1, None] + recording.payload
    pulled = np.cumsum(first[::-1], 0)[::-1]
    pulled = np.concatenate([pulled[:1], pulled])
    weight = np.concatenate([weight[:1], weight])
    return np.einsum("jsab,jsa->jbs", R, np.cross(pulled - weight[..., None] * o, g))
