"""How far a fitted arm is from the nominal one, beside what factories grant, and the fault that explains it.

A chain that is fitted takes up the lost zero of a joint or the wrong size of a marker. Displacements u of its frames
have the prior N(0, (s σ)²): σ is what factories grant, and s ≥ 1 the likeliest factor for the arm. A hypothesis frees a
declared frame or tool, or adds a number of its own, a joint's zero or the sensor's scale. Each has its evidence

    log ∫ exp(z·R u − ½ |R u|²) N(u; 0, L²) du = ½ Σ sᵢ² (uᵢ·z)² / (1 + sᵢ²) − ½ Σ log(1 + sᵢ²),

with the derivatives Q R of the whitened data, its part z = Qᵀ y in their span, the standard deviations L of its prior,
and R L = Σ uᵢ sᵢ vᵢᵀ. The information RᵀR is not made, as sᵢ² goes beyond 1e16 where a sensor is exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np
from scipy.spatial.transform import Rotation

from lite6jax.array_types import Array
from lite6jax.calibration.problem import TOLERANCE, TOUCHED_TOLERANCE
from lite6jax.domains.faults import SuspectedFault, rounded_to_quarters
from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.estimation.robust import FREEDOM

_WIDE = 0.3
"""m, rad and 1: the standard deviation of a frame or a tool that is free, of a joint's zero and of a scale."""
_FACTORS = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 30.0, 50.0)
"""Of the prior, among which the likeliest is taken."""
_LEAST_SCALE = 1e-3
"""Of the noise over the declared one: residuals that are rounding weigh no more."""


@final
@dataclass(frozen=True)
class DeviationEvidence:
    """A hypothesis at the likeliest factor of the prior.

    Attributes:
        factor: s.
        evidence: its logarithm.
        fit: the part of it without the determinant, which more numbers never make smaller.
        displacements: `(number,)`, the mean of u.
    """

    factor: float
    evidence: float
    fit: float
    displacements: Array


@final
@dataclass(frozen=True, eq=False)
class Deviation:
    """What the data say of displacements of all frames of an arm, of its joints' zeros and of the scale of its sensor.

    Numbers are in this order: six of each frame (the base, then that after each joint), those of the sensor's own, one
    of each joint's zero, and the scale.

    Attributes:
        arm: fitted.
        start: the same before the fit, as the table or the calibration file has it.
    """

    arm: RigidArm
    start: RigidArm

    @property
    def frames(self) -> int:
        """The base, and one after each joint."""
        return self.arm.recording.dof + 1

    @property
    def size(self) -> int:
        """How many numbers there are."""
        return 6 * self.frames + self.arm.measured.numbers + self.arm.recording.dof + 1

    @cached_property
    def granted(self) -> Array:
        """`(number,)`, σ of the displacements of the chain and of a declared frame and tool; zero of all others."""
        arm = self.arm
        sigma = np.zeros(self.size)
        unknown = zip(arm.unknown, arm.precision, strict=True)
        of_links = {axis: precision for (name, _, axis), precision in unknown if name == "link"}
        if not of_links:
            return sigma
        pair = (of_links[0] ** -0.5, of_links[5] ** -0.5) if arm.exact else TOUCHED_TOLERANCE
        sigma[: 6 * self.frames] = np.tile(np.repeat(pair, 3), self.frames)
        sigma[self._free_places] = 0.0
        return sigma

    @cached_property
    def free(self) -> Array:
        """`(number,)`, standard deviations of what every hypothesis leaves free; zero of all others."""
        sigma = np.zeros(self.size)
        sensor_places = self._own
        sigma[self._free_places] = _WIDE
        precision = self.arm.precision[sensor_places]
        first = 6 * self.frames
        sigma[first : first + len(precision)] = np.minimum(np.maximum(precision, 1e-12) ** -0.5, _WIDE)
        return sigma

    @cached_property
    def data(self) -> tuple[Array, Array]:
        """The triangular factor R `(number, number)` of the derivatives, and the part z `(number,)` of the data."""
        arm = self.arm
        positions = np.zeros((1, arm.rows, arm.samples))
        if arm.recording.touches is None:
            positions[0, :3] = arm.rigid.tool[:, :3, 3].T
        parts = [arm.twists, arm.joints, arm.whitened(positions)]
        if arm.measured.numbers:
            parts.insert(1, arm.whitened(arm.measured.by_numbers(arm.rigid.tool)))
        scale = max(arm.scale, _LEAST_SCALE)
        root = np.sqrt((FREEDOM + arm.rows) / (FREEDOM + arm.squares / scale**2)) / scale
        derivatives = (np.concatenate(parts) * root).reshape(self.size, -1).T
        Q, R = np.linalg.qr(derivatives)
        return R, R @ self.displaced - Q.T @ (arm.residuals * root).ravel()

    @cached_property
    def displaced(self) -> Array:
        """`(number,)`, where the fit has displaced the frames to."""
        arm = self.arm
        start = self.start
        u = np.zeros(self.size)
        steps = [np.linalg.inv(start.T_sensor_base) @ arm.T_sensor_base, *(arm.links @ np.linalg.inv(start.links))[1:]]
        for frame, T in enumerate(steps):
            u[6 * frame : 6 * frame + 3] = T[:3, 3]
            u[6 * frame + 3 : 6 * frame + 6] = Rotation.from_matrix(T[:3, :3]).as_rotvec()
        u[self._free_places] = 0.0
        u[6 * self.frames : 6 * self.frames + arm.measured.numbers] = arm.offset[self._own]
        return u

    def places(self, change: SuspectedFault) -> slice:
        """The numbers that a change frees."""
        last = 6 * self.frames
        if change.code == "declared_frame":
            return slice(0, 6)
        if change.code == "declared_tool":
            return slice(last - 6, last)
        zero = self.size - 1 - self.arm.recording.dof + change.joints[0] if change.joints else self.size - 1
        return slice(zero, zero + 1)

    def weighed(self, hypothesis: Sequence[SuspectedFault], factors: Sequence[float] = _FACTORS) -> DeviationEvidence:
        """A hypothesis at the likeliest of some factors."""
        R, z = self.data
        candidates = []
        for factor in factors:
            L = np.maximum(factor * self.granted, self.free)
            for change in hypothesis:
                L[self.places(change)] = _WIDE
            U, s, Vt = np.linalg.svd(R * L, full_matrices=False)
            along = U.T @ z
            fit = 0.5 * float(np.sum((s * along) ** 2 / (1 + s**2)))
            mean = L * (Vt.T @ (s * along / (1 + s**2)))
            candidates.append(DeviationEvidence(factor, fit - 0.5 * float(np.sum(np.log1p(s**2))), fit, mean))
        return max(candidates, key=lambda candidate: candidate.evidence)

    def log_likelihood(self, scale: float) -> float:
        """Log-likelihood at `scale` times the declared noise, with all displacements integrated over their prior."""
        arm = self.arm
        R, z = self.data
        Ru = R @ self.displaced
        at_fit = replace(arm, precision=np.zeros(len(arm.precision))).log_likelihood(scale)
        return at_fit - float(z @ Ru - 0.5 * Ru @ Ru) + self.weighed(()).evidence

    def valued(self, change: SuspectedFault, weighed: DeviationEvidence) -> SuspectedFault:
        """A change by as much as its number says."""
        value = float(weighed.displacements[self.places(change)][0])
        if change.code == "joint_turns":
            return replace(change, value=rounded_to_quarters(value, TOLERANCE["rad"]))
        if change.code == "sensor_scale":
            return replace(change, value=1 / (1 - value))
        return change

    def share(self, change: SuspectedFault, weighed: DeviationEvidence) -> float:
        """The largest displacement by a change, of a zero, a frame or a tool, over what factories grant of it."""
        displaced = np.abs(weighed.displacements[self.places(change)])
        of_length = self.granted[6]
        of_angle = self.granted[11]
        granted = np.repeat([of_length, of_angle], 3) if len(displaced) == 6 else np.array([of_angle])
        return float(np.max(displaced / granted))

    @property
    def _free_places(self) -> list[int]:
        last = 6 * self.frames
        return [*range(6 * self.arm.form.frame), *range(last - 6 * self.arm.form.tool, last)]

    @property
    def _own(self) -> list[int]:
        return [k for k, (name, _, _) in enumerate(self.arm.unknown) if name == "reading"]

    def summary(self) -> dict[str, Any]:
        """How far the fitted arm is from the nominal one, and which frame is furthest beside what is granted."""
        weighed = self.weighed(())
        granted = self.granted
        apart = self.arm.rigid.tool[:, :3, 3] - self.start.rigid.tool[:, :3, 3]
        shares = np.abs(weighed.displacements) / np.where(granted > 0, granted, np.inf)
        equal = shares > (1 - 1e-3) * shares.max()  # along one axis, two frames share a displacement alike
        frame, axis = divmod(int(np.argmax(equal)), 6)
        return {
            "distance_m": float(np.median(np.linalg.norm(apart, axis=1))),
            "factor": weighed.factor,
            "granted_m": float(granted[6]),
            "granted_rad": float(granted[11]),
            "frame": frame,
            "axis": "xyz"[axis % 3],
            f"largest_{'m' if axis < 3 else 'rad'}": float(weighed.displacements[6 * frame + axis]),
            "largest_share": float(shares.max()),
        }
