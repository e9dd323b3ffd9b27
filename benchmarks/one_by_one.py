"""A search for hidden physics as one would first write it: SciPy refits everything anew for each candidate.

Plain vectorised NumPy and finite differences. Of the library it takes which candidates there are and where they sit;
what each does to the arm is written here again; transforms and gravity's moments are those of `tests.oracles`.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares

from tests.oracles.gravity import gravity_moments
from tests.oracles.transforms import displacement, origin_transform, rotate

FRAME, TOOL = 6, 3
GAUGE = np.array([0.02] * 3 + [0.05] * 3)
"""m and rad: one standard deviation of each number of a chain that is not known; it settles what nothing determines."""


class Refit(NamedTuple):
    """What one candidate explains.

    Attributes:
        gain: of the log-likelihood, over the nuisance alone.
        values: of the candidate's numbers, fitted.
    """

    gain: float
    values: np.ndarray


class Bent(NamedTuple):
    """What an effect adds: rad to each joint, and twists; the sample first, 0 and None where there is nothing."""

    joint: np.ndarray | float = 0.0
    link: tuple[int, np.ndarray] | None = None
    base: np.ndarray | None = None
    tool: np.ndarray | None = None
    scale: float = 0.0
    sensor: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Readings:
    """Positions that a sensor read of an arm at rest, with nothing at its flange.

    Attributes:
        joint_position: `(sample, 6)` rad.
        direction: `(sample, 6)`, the sign of each joint's last move.
        time: `(sample,)` s.
        position: `(sample, 3)` m.
        noise: m, one standard deviation per axis.
        kinematics: `(6, 6)`, the chain from which to start; the arm's own where it is known.
        T_sensor_base: `(4, 4)` from which to start.
        T_flange_tool: `(4, 4)` from which to start.
        chain_known: whether the chain is left as it is.
        mass: `(6,)` kg.
        center_of_mass: `(6, 3)` m.
    """

    joint_position: np.ndarray
    direction: np.ndarray
    time: np.ndarray
    position: np.ndarray
    noise: float
    kinematics: np.ndarray
    T_sensor_base: np.ndarray
    T_flange_tool: np.ndarray
    chain_known: bool
    mass: np.ndarray
    center_of_mass: np.ndarray

    @property
    def unknown(self) -> int:
        """Numbers of the nuisance: sensor frame, tool, and the links where the chain is not known."""
        return FRAME + TOOL + (0 if self.chain_known else self.kinematics[1:].size)

    def residual(self, x: np.ndarray, effect: Any = None) -> np.ndarray:
        """Whitened, with the nuisance and then the effect's numbers in `x`, and the prior of the links."""
        frame, tool, rows = np.split(x[: self.unknown], [FRAME, FRAME + TOOL])
        bent = Bent() if effect is None else self.bent(effect, x[self.unknown :])
        kinematics = self.kinematics.copy()
        if rows.size:
            kinematics[1:] += rows.reshape(-1, 6)
        T = self.T_sensor_base @ displacement(frame)
        T = T if bent.base is None else T @ displacement(bent.base)
        for i, frame_i in enumerate(self.frames(kinematics, bent)):
            T = T @ frame_i
            if bent.link is not None and bent.link[0] == i + 1:
                T = T @ displacement(bent.link[1])
        at = self.T_flange_tool[:3, 3] + tool
        at = at if bent.tool is None else displacement(bent.tool)[:3, :3] @ at + bent.tool[:3]
        position = T[:, :3, :3] @ at + T[:, :3, 3]
        if bent.sensor is not None:
            D = displacement(bent.sensor)
            position = np.einsum("sab,sb->sa", D[:, :3, :3], position) + D[:, :3, 3]
        position = (1 + bent.scale) * position
        prior = (rows.reshape(-1, 6) / GAUGE).ravel()
        return np.concatenate([((position - self.position) / self.noise).ravel(), prior])

    def frames(self, kinematics: np.ndarray, bent: Bent) -> list[np.ndarray]:
        """What each joint multiplies the chain by, `(sample, 4, 4)` each."""
        angle = self.joint_position + bent.joint
        return [origin_transform(row) @ rotate("z", q) for row, q in zip(kinematics, angle.T, strict=True)]

    def bent(self, effect: Any, v: np.ndarray) -> Bent:
        """What a candidate does with its numbers."""
        q, none = self.joint_position, np.zeros(len(self.joint_position))
        match effect.name:
            case "joint_offset":
                return self._turned(effect.joint, v[0] + none)
            case "joint_scale":
                return self._turned(effect.joint, v[0] * q[:, effect.joint - 1])
            case "joint_compliance":
                return self._turned(effect.joint, v[0] * self.moment[:, effect.joint - 1, 2])
            case "joint_harmonic":
                turned = effect.order * q[:, effect.joint - 1]
                return self._turned(effect.joint, v[0] * np.sin(turned) + v[1] * np.cos(turned))
            case "joint_backlash":
                return self._turned(effect.joint, -v[0] / 2 * self.direction[:, effect.joint - 1])
            case "joint_coupling":
                return self._turned(effect.joint, v[0] * q[:, effect.source_joint - 1])
            case "link_compliance":
                about = v * self.moment[:, effect.link - 1, :2]
                return Bent(link=(effect.link, np.column_stack([none, none, none, about, none])))
            case "frame_offset":
                return Bent(base=v) if effect.link is None else Bent(link=(effect.link, v))
            case "axis_wobble":
                return self._wobbling(effect.joint, v)
            case "base_compliance":
                x, y = self.base_moment[:, :2].T
                xy = v[2] if effect.cross else 0.0
                shift = v[-4:].reshape(2, 2) if effect.shift else np.zeros((2, 2))
                moved = self.base_moment[:, :2] @ shift.T
                return Bent(base=np.column_stack([moved, none, v[0] * x + xy * y, v[1] * y + xy * x, none]))
            case "base_drift":
                return Bent(base=np.column_stack([np.outer(self.time, v), none, none, none]))
            case "tool_offset":
                return Bent(tool=np.concatenate([v, np.zeros(6 - len(v))]))
            case "measurement_scale":
                return Bent(scale=v[0])
            case "sensor_drift":
                return Bent(sensor=np.outer(self.time, v))
            case "payload_error" | "payload_com" | "gravity_direction" | "tool_compliance":
                return Bent()  # seen only through a compliance, or only with a payload
        raise NotImplementedError(effect.name)

    def _wobbling(self, joint: int, v: np.ndarray) -> Bent:
        q = self.joint_position[:, joint - 1]
        waves = np.stack([np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q)])
        tilt = np.column_stack([v[:4] @ waves, v[4:] @ waves, np.zeros_like(q)])
        after = np.einsum("sba,sb->sa", rotate("z", q)[:, :3, :3], tilt)  # what it is behind the joint's rotation
        return Bent(link=(joint, np.concatenate([np.zeros_like(after), after], 1)))

    def _turned(self, joint: int, angle: np.ndarray) -> Bent:
        turned = np.zeros_like(self.joint_position)
        turned[:, joint - 1] = angle
        return Bent(joint=turned)

    @cached_property
    def moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Gravity's, N·m: `(sample, 6, 3)` about each joint's frame in its axes, `(sample, 3)` about the base's."""
        inertia = {"mass": self.mass, "center_of_mass": self.center_of_mass, "gravity": np.array([0.0, 0.0, -9.81])}
        return gravity_moments(self.kinematics, self.joint_position, 0.0, inertia)

    @property
    def moment(self) -> np.ndarray:
        """About each joint's frame."""
        return self.moments[0]

    @property
    def base_moment(self) -> np.ndarray:
        """About the base's."""
        return self.moments[1]


def refit_each(readings: Readings, candidates: tuple[Any, ...]) -> list[Refit]:
    """The nuisance together with each candidate, from the nuisance fitted alone."""
    alone = least_squares(readings.residual, np.zeros(readings.unknown), method="lm", x_scale="jac")
    refits = []
    for effect in candidates:
        start = np.concatenate([alone.x, np.zeros(effect.size)])
        found = least_squares(partial(readings.residual, effect=effect), start, method="lm", x_scale="jac")
        refits.append(Refit(alone.cost - found.cost, found.x[readings.unknown :]))
    return refits
