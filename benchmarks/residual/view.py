"""Rows of a recording as a fitted geometry sees them, and what may be added to its poses."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.concealed.chain import Chain, vector_from_rotation
from benchmarks.concealed.plain_physics import moments
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.dh import hayati_to_six_parameter
from lite6jax.domains.pose.fit import fit
from lite6jax.fitting.problem import UNDECLARED_NOISE
from lite6jax.recordings import Recording

Array = NDArray[Any]

_WILD = 8.0
"""Robust standard deviations beyond which a row is left out of what a rival is fitted to."""


class Correction(NamedTuple):
    """What a rival adds to the geometry's poses.

    Attributes:
        shift: `(sample, 3)` m, base axes.
        turn: `(sample, 3)` rad, base axes; zero of one that says nothing of orientation.
    """

    shift: Array
    turn: Array


class Fitted(NamedTuple):
    """A rival after it has seen its rows.

    Attributes:
        correct: what it says of other rows.
        parameters: how many numbers it has fitted over the geometry; those of a Gaussian process are its weights.
        names: the physics that it names, as `effect:site`.
    """

    correct: "Callable[[View], Correction]"
    parameters: int
    names: tuple[str, ...] = ()


class View(NamedTuple):
    """Rows of a recording as a fitted geometry sees them, in the base's axes.

    Attributes:
        recording: the rows.
        frames: rotations `(sample, joint, 3, 3)` and origins `(sample, joint, 3)` after each joint.
        tool: rotations `(sample, 3, 3)` and positions `(sample, 3)`.
        missed: `(sample, 3)` m, measured less predicted; None without poses.
        turned: `(sample, 3)` rad; None without orientations.
        moment: `(sample, joint, 3)` Nm about each frame's origin in its axes; None where the masses are not known.
        base_moment: `(sample, 3)` Nm; likewise.
        noise: m and rad, what residuals are weighed by.
    """

    recording: Recording
    frames: tuple[Array, Array]
    tool: tuple[Array, Array]
    missed: Array | None
    turned: Array | None
    moment: Array | None
    base_moment: Array | None
    noise: tuple[float, float]

    def rows(self, chosen: NDArray) -> "View":
        """Some of them."""

        def of(array: Array | None) -> Array | None:
            return None if array is None else array[chosen]

        (R, o), (Rt, p) = self.frames, self.tool
        return View(
            self.recording.select(chosen), (R[chosen], o[chosen]), (Rt[chosen], p[chosen]),
            of(self.missed), of(self.turned), of(self.moment), of(self.base_moment), self.noise,
        )  # fmt: skip

    @property
    def usable(self) -> NDArray[np.bool_]:
        """`(sample,)`, rows that are not wild."""
        assert self.missed is not None
        far = np.linalg.norm(self.missed - np.median(self.missed, 0), axis=1)
        return far < _WILD * np.median(far)


class Rival(Protocol):
    """Fits what is left of the geometry's residuals."""

    def __call__(self, seen: View) -> Fitted: ...


@dataclass(frozen=True, eq=False)
class Geometry:
    """A fitted arm.

    Attributes:
        chain: its six-parameter form with masses, zero where not known.
        weighed: whether they are known.
        sensor: `(4, 4)` T_sensor_base.
        after: `(4, 4)` from the last joint's frame to the tool.
        free: whether the chain was fitted; else only frame and tool.
        parameters: how many numbers were.
    """

    chain: Chain
    weighed: bool
    sensor: Array
    after: Array
    free: bool
    parameters: int

    @classmethod
    def of(cls, recording: Recording) -> "Geometry":
        """By robust least squares, as `lite6jax fit` does it."""
        solution = fit(recording)
        form, arm = solution.form.chain, solution.arm
        if isinstance(form, HayatiForm):
            rows, after = hayati_to_six_parameter(form, solution.parameters)
        else:
            rows, after = solution.parameters.reshape(-1, 6), np.eye(4)
        known = arm.mass is not None and arm.center_of_mass is not None
        mass = arm.mass if known else np.zeros(arm.dof)
        center = arm.center_of_mass if known else np.zeros((arm.dof, 3))
        chain = Chain(arm.name, np.asarray(rows), arm.joint_limits, np.asarray(mass), np.asarray(center))
        tool = after @ np.asarray(solution.model.T_flange_tool)
        moved = bool(solution.free[: form.size].any())
        return cls(chain, known, np.asarray(solution.model.T_sensor_base), tool, moved, int(solution.free.sum()))

    def view(self, recording: Recording) -> View:
        """Rows of a recording, with residuals where it has poses."""
        R, o = self.chain.frames(recording.joint_position)
        Rt, p = R[:, -1] @ self.after[:3, :3], o[:, -1] + R[:, -1] @ self.after[:3, 3]
        S, s = self.sensor[:3, :3], self.sensor[:3, 3]
        missed = turned = None
        if recording.position is not None:
            missed = (recording.position - s) @ S - p
        if recording.quaternion is not None:
            turned = vector_from_rotation(S.T @ rotations(recording.quaternion) @ np.swapaxes(Rt, 1, 2))
        moment = base = None
        if self.weighed:
            center = np.array(recording.settings.payload_com_m)
            moment, base = moments(self.chain, recording.joint_position, recording.payload, center)
        told = recording.settings
        noise = (
            told.position_noise_m or UNDECLARED_NOISE[0],
            told.orientation_noise_rad or UNDECLARED_NOISE[1],
        )
        return View(recording, (R, o), (Rt, p), missed, turned, moment, base, noise)


def rotations(quaternion: Array) -> Array:
    """`(sample, 3, 3)` of unit quaternions, scalar first."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.roll(quaternion, -1, axis=1)).as_matrix()
