"""How likely hypotheses about a torque recording are: what each leaves of some samples, and its evidence."""

from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize_scalar, nnls

from lite6jax.arms import frames
from lite6jax.arms.dynamics import recorded_regressor, recorded_torques
from lite6jax.array_types import Array, Mask
from lite6jax.domains.faults import Hypothesis, SuspectedFault, fault_cost, rounded_to_quarters
from lite6jax.domains.torque.changes import STEP, exchanges, maps, turned_back
from lite6jax.domains.torque.problem import uncertain
from lite6jax.domains.torque.rows import TorqueRows
from lite6jax.effects.dynamic import TILT, direction

_ROWS = 300
"""Samples on which hypotheses are compared, of one number, so that the dynamics are compiled once an arm."""
SUSPECT = 0.05
"""Of a joint's torque, RMS: what the arm as declared leaves beside friction, from which it is suspected."""
_CORRELATED = 0.3
"""Correlation of neighbouring samples below which what is left is noise."""
_FACTORS = (0.45, 1.8)
"""Of the measured torque over the true one, beyond which it is no error of calibration but another constant: those of
motors of one series vary by some per cent, and gear ratios by factors."""
_UNIT = (1 / 3, 3.0)
"""Of the mean of all joints: within, the arm has rather other masses; beyond, torques are in another unit."""
_LEAST_ZERO = 0.05
"""rad below which a zero is no fault of the data: other centres of mass do the same."""
_SNAP = 0.04
"""rad from a quarter of a turn within which a zero is another convention."""
_STRENGTH = 0.15
"""Relative deviation of gravity's strength up to which another direction of it is believed."""
_UPRIGHT = 0.1
"""rad from an axis of the base within which gravity points along it: arms stand, hang, or are mounted on a wall."""
_WIDTHS = (0.03, 0.1, 0.3, 1.0)
"""Relative standard deviations of declared inertial numbers, of which each hypothesis has the likeliest."""
_FLOOR = 2e-3
"""Of a joint's torque: what no model of a motor is more exact than."""
_PAYLOAD = 0.15
_PAYLOAD_LEVER = 0.15
"""Of the mass of the arm, and m: what may hang on the flange, one sigma of its mass and of its place."""
_BASE = 0.15
"""rad, one sigma of a base's tilt."""
_OUTSIDE = 0.05
"""rad by which a position may be beyond its limits: descriptions are rounded, and controllers stop late."""
_RIDGE = 1e-12
"""Added to the squares of columns of unit length, of which some may be zero or alike."""
_OF_SIGN = float(np.log(7))
"""Log-likelihood that a reversed sign costs: one of seven joints."""


class Scored(NamedTuple):
    """A hypothesis beside the rigid arm as declared.

    Attributes:
        hypothesis: with its changes of torques.
        cost: negative log-likelihood, with what its changes cost.
        left: `(joint,)` Nm RMS of what is left, in the unit that was recorded.
    """

    hypothesis: Hypothesis
    cost: float
    left: Array


class Samples:
    """Some samples of a recording, and what hypotheses leave of them."""

    def __init__(self, data: TorqueRows) -> None:
        self.data = data
        self.required = fault_cost(data.recording)  # log-likelihood by which a fault is likelier than none
        self.likeliest: Hypothesis = ()  # what it leaves is the noise of them all
        sampled = np.linspace(0, len(data.filter.kept) - 1, _ROWS).round().astype(int)
        at = data.filter.kept[sampled]
        motion = data.motion
        self.moved = data.bodies.moved[..., at]
        self.measured = data.measured[:, sampled]
        self.payload = np.asarray(motion.payload)[at] * np.ones(len(at))
        self.size = np.std(self.measured, axis=1)
        self.floor = _FLOOR * self.size + 1e-9
        if data.recording.settings.torque_noise_Nm is not None:
            noise = np.asarray(data.recording.settings.torque_noise_Nm) / np.sqrt(data.recorded.every)
            self.floor = np.hypot(self.floor, 0.5 * noise)
        still = data.recording.motion == "static"  # postures are not neighbours
        slope = np.stack([np.zeros_like(row) if still else np.gradient(row) for row in data.measured])
        self.slope = slope[:, sampled] * data.recorded.rate / data.recorded.every

    def about(self, likeliest: Hypothesis) -> "Samples":
        """The same with a hypothesis that leaves less: what one leaves that is wrong is no noise."""
        variant = copy(self)
        variant.likeliest = likeliest
        vars(variant).pop("counted", None)
        return variant if variant.counted > self.counted else self

    def with_axis(self, joint: int, R: Array) -> "Samples":
        """The same of an arm whose joint, from 0, turns about the axis of its frame that `R` turns z into."""
        bodies = self.data.bodies
        variant = copy(self)
        kinematics = bodies.kinematics.copy()
        links = bodies.links.copy()
        T = np.eye(4)
        T[:3, :3] = R
        kinematics[joint] = frames.row_from_transform(frames.transform_from_row(kinematics[joint]) @ T)
        if joint + 1 < self.dof:
            kinematics[joint + 1] = frames.row_from_transform(T.T @ frames.transform_from_row(kinematics[joint + 1]))
        links[joint] = _rotated(links[joint], R.T)
        center = bodies.payload_center if joint + 1 < self.dof else R.T @ bodies.payload_center
        turned = replace(bodies, kinematics=kinematics, links=links, payload_center=center)
        variant.data = replace(self.data, bodies=turned)
        vars(variant).pop("declared", None)  # which is that of the other arm
        return variant

    @property
    def dof(self) -> int:
        return len(self.measured)

    @cached_property
    def counted(self) -> float:
        """How many samples that remember each other count as independent ones, by what the likeliest leaves."""
        times = []
        for row in self._rest(self.likeliest):
            row = row - row.mean()
            spectrum = np.abs(np.fft.rfft(row, 2 * len(row))) ** 2
            correlation = np.fft.irfft(spectrum)[: len(row)]
            correlation = correlation / max(correlation[0], 1e-300)
            end = int(np.argmax(correlation < 0.05)) or len(row)
            times.append(1 + 2 * float(np.sum(correlation[1:end])))
        return self.measured.shape[1] / float(np.median(times))

    def price(self, hypothesis: Hypothesis) -> float:
        """Log-likelihood that its changes cost: which joints, and half the logarithm of the samples for each number."""
        cost_of = {"exchange": _of_pair(self.dof), "couple": float(np.log(4 * self.dof))}
        cost_of |= dict.fromkeys(("add", "divide"), self._of_number)
        reversed_both = {c.joints for c in hypothesis if c.code == "reversed_positions"}
        reversed_both &= {c.joints for c in hypothesis if c.code == "reversed_torque"}
        total = sum(cost_of.get(change.kind.operation, _OF_SIGN) for change in hypothesis)
        constants = [c.value for c in hypothesis if c.code == "wrong_torque_constant"]
        repeated = 0.5 * np.log(self.counted) * (len(constants) - len(set(constants)))
        return float(total - _OF_SIGN * len(reversed_both) - repeated)

    @property
    def _of_number(self) -> float:
        """Log-likelihood that a number of one of the joints costs."""
        return 0.5 * float(np.log(self.counted)) + float(np.log(self.dof + 1))

    @cached_property
    def declared(self) -> Scored:
        """The recording as it is."""
        return Scored((), 0.0, np.sqrt(np.mean(self._rest(()) ** 2, 1)))

    def suspicious(self, scored: Scored, share: float = SUSPECT) -> bool:
        """Tells whether a hypothesis leaves more of a torque than friction, offsets and noise would."""
        residual = self._rest(scored.hypothesis)
        near = np.sum(residual[:, 1:] * residual[:, :-1], 1) / np.maximum(np.sum(residual**2, 1), 1e-300)
        return bool(((scored.left > share * self.size) & (near > _CORRELATED)).any())

    def rigid(self, moved: Array, gravity: Array) -> Array:
        """`(joint, sample)` Nm of the arm as declared, in a motion `(3, joint, sample)`."""
        bodies = self.data.bodies
        sliding = self.data.arm.sliding
        torque = recorded_torques(bodies.kinematics, bodies.links, moved, gravity, sliding)
        if self.payload.any():
            per_kg = recorded_torques(bodies.kinematics, bodies.at_flange, moved, gravity, sliding)
            torque = torque + self.payload * per_kg
        return torque

    def _moved(self, hypothesis: Hypothesis) -> tuple[Array, Array]:
        """The motion `(3, joint, sample)` and gravity `(3,)` of a hypothesis."""
        A, b, _, gravity = maps(hypothesis, self.dof)
        moved = np.einsum("ij,kjs->kis", A, self.moved)
        moved[0] += b[:, None]
        return moved, self.data.bodies.gravity if gravity is None else np.asarray(gravity)

    def feels(self, hypothesis: Hypothesis, share: float) -> bool:
        """Tells whether a hypothesis of gravity changes more than a share of the torque of some joint, RMS."""
        moved, gravity = self._moved(hypothesis)
        change = self.rigid(moved, gravity) - self.rigid(*self._moved(()))
        return bool((np.std(change, axis=1) > share * self.size).any())

    def beyond_limits(self, hypothesis: Hypothesis) -> int:
        """How many positions of the samples a hypothesis puts beyond the limits of their joints."""
        low, high = self.data.arm.possible_positions.T
        q = self._moved(hypothesis)[0][0].T
        return int(np.sum((q < low - _OUTSIDE) | (q > high + _OUTSIDE)))

    def _beside(self, moved: Array) -> Array:
        """`(joint, number, sample)`: offset of both signs, friction, narrow and wide, and rotor, none negative."""
        _, dq, ddq = moved
        slides = self.data.arm.slides
        narrow = np.stack([direction(v, s) for v, s in zip(dq, slides, strict=True)])
        wide = np.tanh(dq / np.maximum(0.2 * np.abs(dq).max(1, keepdims=True), 1e-9))
        ones = np.ones_like(dq)
        columns = np.stack([ones, -ones, dq, narrow, wide, ddq], 1)
        return columns / np.maximum(np.linalg.norm(columns, axis=2, keepdims=True), 1e-300)

    def _rest(self, hypothesis: Hypothesis) -> Array:
        """`(joint, sample)` Nm that a hypothesis leaves beside what each joint may add."""
        moved, gravity = self._moved(hypothesis)
        return self._left(maps(hypothesis, self.dof)[2] @ self.measured - self.rigid(moved, gravity), moved)

    def _left(self, rigid_residual: Array, moved: Array) -> Array:
        """Torques `(joint, sample)` Nm less what each joint may add."""
        return np.stack(
            [row - nnls(c.T, row)[0] @ c for row, c in zip(rigid_residual, self._beside(moved), strict=True)]
        )

    def scored(self, hypothesis: Hypothesis) -> Scored:
        """A hypothesis about positions and gravity, with the columns, signs and constants of torques that fit it best.

        Args:
            hypothesis: without changes of torques.
        """
        moved, gravity = self._moved(hypothesis)
        measured = maps(hypothesis, self.dof)[2] @ self.measured
        rigid = self.rigid(moved, gravity)
        n = self.measured.shape[1]
        dof = self.dof
        half = 0.5 * self.counted
        weight = np.maximum(np.linalg.norm(rigid, axis=1, keepdims=True), 1e-300)
        # an offset of either sign is what the mean is taken off for
        joint_columns, measured, rigid = (
            x - x.mean(-1, keepdims=True) for x in (self._beside(moved)[:, 2:], measured, rigid)
        )
        missed = np.concatenate([sign * measured - rigid[:, None] for sign in (1.0, -1.0)] + [measured[:, None]], 1)
        squares = _nonnegative(joint_columns, missed)[1] / n
        square = squares[:, :-1].reshape(dof, 2, dof).transpose(1, 2, 0)
        signed_torques = np.stack([measured, -measured], 1)
        numbers, rss = _nonnegative(np.concatenate([joint_columns, (rigid / weight)[:, None]], 1), signed_torques)
        factor = numbers[..., -1].T / weight.T
        loaded = rss.T / n
        observable = half * np.log(squares[:, -1] / np.maximum(loaded.min(0), 1e-300)) > self.required
        square = np.maximum(square, self.floor[None, :, None] ** 2)
        loaded = np.maximum(loaded, self.floor**2)
        joints = np.arange(dof)
        of_sign = np.array([0.0, _OF_SIGN])
        cost = half * np.log(square) + of_sign[:, None, None] + 0.5 * _of_pair(dof) * (1 - np.eye(dof))
        columns, place = linear_sum_assignment(cost.min(0))
        order = np.empty(dof, int)
        order[place] = columns
        reversed_ = np.argmin(cost[:, order, joints], 0) == 1
        total = cost.min(0)[order, joints]
        residual_rms = np.sqrt(square[reversed_.astype(int), order, joints])
        constants = np.ones(dof)
        code = "wrong_torque_constant"
        with_any = half * np.log(loaded) + of_sign[:, None] + self._of_number
        for of_all in (False, True):
            rescaled = self._constants(with_any, factor, cost[:, joints, joints], observable if of_all else None)
            if rescaled is not None and rescaled[1].sum() < total.sum():
                code = "torque_unit" if of_all else "wrong_torque_constant"
                order = joints
                constants, total, reversed_ = rescaled
                k = reversed_.astype(int)
                residual_rms = np.sqrt(np.where(constants != 1, loaded[k, joints], square[k, joints, joints]))
        changes = [*hypothesis, *exchanges(order)]
        changes += [SuspectedFault("reversed_torque", (int(j),)) for j in np.flatnonzero(reversed_)]
        wrong_constants = [(int(j), float(constants[j])) for j in np.flatnonzero(constants != 1)]
        changes += [SuspectedFault(code, (j,), float(f"{k:.3g}")) for j, k in wrong_constants]
        return Scored(tuple(changes), float(total.sum()) + self.price(hypothesis), residual_rms)

    def _constants(
        self, loaded: Array, factor: Array, as_it_is: Array, observable: Mask | None
    ) -> tuple[Array, Array, Mask] | None:
        """Constants of the torques of joints, what each joint costs, and which are reversed, `(joint,)` each.

        Args:
            loaded: `(sign, joint)`, costs with any constant.
            factor: likewise, the measured torque over the true one.
            as_it_is: `(sign, joint)`, costs with the constant as declared.
            observable: `(joint,)`, whose constants the torques show, for constants of all joints; None for single
                joints'.
        """
        low, high = _FACTORS
        if observable is not None:
            k = np.argmin(loaded, 0)
            joints = np.arange(self.dof)
            joint_factors = factor[k, joints]
            shown = joint_factors[observable]
            if 2 * observable.sum() < self.dof or not ((shown > high).all() or ((shown > 0) & (shown < low)).all()):
                return None
            usual = float(np.exp(np.mean(np.log(shown))))
            if _UNIT[0] < usual < _UNIT[1]:
                return None
            return np.where(observable, joint_factors, usual), loaded[k, joints], k == 1
        beyond = ((factor > 0) & (factor < low)) | (factor > high)
        cost = np.minimum(as_it_is, np.where(beyond, loaded, np.inf))
        reversed_ = np.argmin(cost, 0) == 1
        joints = np.arange(self.dof)
        k = reversed_.astype(int)
        rescaled = cost[k, joints] < as_it_is[k, joints]
        if not rescaled.any() or 2 * rescaled.sum() > self.dof:
            return None
        return np.where(rescaled, factor[k, joints], 1.0), cost[k, joints], reversed_

    def refined(self, hypothesis: Hypothesis) -> Hypothesis:
        """With zeros between those that were tried."""
        for change in hypothesis:
            if change.code != "joint_zero":
                continue

            def at(value: float, change: SuspectedFault = change, changes: Hypothesis = hypothesis) -> Hypothesis:
                return tuple(replace(c, value=value) if c == change else c for c in changes)

            near = (change.size - STEP, change.size + STEP)
            minimum: Any = minimize_scalar(
                lambda value, at=at: self.scored(at(value)).cost, bounds=near, method="bounded", options={"xatol": 5e-3}
            )
            value = float(minimum.x)
            quarters = rounded_to_quarters(value, _SNAP)
            hypothesis = at(turned_back(quarters if quarters != value else float(f"{value:.3g}")))
        return tuple(c for c in hypothesis if c.code != "joint_zero" or abs(c.size) > _LEAST_ZERO)

    def gravity_found(self, hypothesis: Hypothesis) -> SuspectedFault | None:
        """Gravity along the direction that the torques show beside what joints may add; None where that is as declared.

        Torques are linear in gravity: its three components are fitted, joints weighted by what is left of them. A small
        tilt is an effect on its own (`base_tilt`).
        """
        declared = self.data.bodies.gravity
        strength = float(np.linalg.norm(declared))
        if not strength:
            return None
        moved, _ = self._moved(hypothesis)
        without = self.rigid(moved, np.zeros(3))
        of_axes = np.stack([self.rigid(moved, axis) - without for axis in np.eye(3)])
        rigid_residual = maps(hypothesis, self.dof)[2] @ self.measured - without
        gravity = declared
        scale = np.maximum(self.size, 1e-9)
        bases = [np.linalg.qr(np.stack([c[0], *c[2:]]).T)[0] for c in self._beside(moved)]
        X = np.stack([of_axes[:, j] - (of_axes[:, j] @ Q) @ Q.T for j, Q in enumerate(bases)])
        Y = np.stack([rigid_residual[j] - (rigid_residual[j] @ Q) @ Q.T for j, Q in enumerate(bases)])
        for _ in range(4):
            A = np.concatenate(X / scale[:, None, None], 1)
            b = np.concatenate(Y / scale[:, None])
            gravity = np.linalg.lstsq(A.T, b, rcond=None)[0]
            scale = np.maximum(np.sqrt(np.mean((Y - np.einsum("k,jks->js", gravity, X)) ** 2, 1)), self.floor)
        size = float(np.linalg.norm(gravity))
        cosine = float(gravity @ declared) / max(size * strength, 1e-300)
        if abs(size / strength - 1) > _STRENGTH or np.arccos(np.clip(cosine, -1, 1)) <= TILT:
            return None
        along = gravity / size
        k = int(np.argmax(np.abs(along)))
        if np.arccos(min(abs(along[k]), 1.0)) < _UPRIGHT:
            along = np.sign(along[k]) * np.eye(3)[k]
        return SuspectedFault("wrong_gravity", gravity=tuple(float(f"{value:.4g}") + 0.0 for value in strength * along))

    def evidence(self, hypothesis: Hypothesis) -> float:
        """The logarithm of the marginal likelihood, with the likeliest width of the inertial numbers' prior.

        Beside the arm each joint has what most arms have: offset, friction, rotor, spring, scale and lag; links have
        other masses, a payload hangs on the flange, and the base is tilted, all of a prior. Samples that remember each
        other count as fewer, and each joint has a noise of its own.
        """
        moved, gravity = self._moved(hypothesis)
        T = maps(hypothesis, self.dof)[2]
        measured = T @ self.measured
        size = np.std(measured, axis=1) + 1e-9
        rigid_residual = measured - self.rigid(moved, gravity)
        shared, of_links = self._of_bodies(moved, gravity)
        joint_columns, bounded = self._of_joints(moved, gravity, T @ self.slope, size)
        k = len(shared)
        m = joint_columns.shape[1]
        dof = self.dof
        columns = [np.vstack([shared[:, j], joint_columns[j]]) for j in range(dof)]
        grams = [c @ c.T for c in columns]
        sides = [c @ row for c, row in zip(columns, rigid_residual, strict=True)]
        places = [np.r_[:k, k + m * j : k + m * (j + 1)] for j in range(dof)]
        lower = np.r_[np.zeros(k, bool), np.tile(bounded, dof)]
        squares = np.sum(rigid_residual**2, 1)
        n = rigid_residual.shape[1]
        floor = np.abs(T) @ self.floor
        start = np.maximum(np.sqrt(np.mean(self._left(rigid_residual, moved) ** 2, 1)), floor)

        def of_width(width: float) -> float:
            prior = np.r_[np.where(of_links, width, 1.0), np.ones(m * dof)]
            noise = start
            square = start**2
            H = np.zeros((len(lower), len(lower)))
            x = np.zeros(len(lower))
            for _ in range(5):
                H = np.zeros_like(H)
                g = np.zeros(len(lower))
                for at, gram, side, sigma in zip(places, grams, sides, noise, strict=True):
                    weight = self.counted / (n * sigma**2)
                    H[np.ix_(at, at)] += weight * gram
                    g[at] += weight * side
                H *= np.outer(prior, prior)
                x = _solved(H + np.eye(len(H)), g * prior, lower)
                y = [(prior * x)[at] for at in places]
                residual_squares = [
                    s - 2 * v @ b + v @ G @ v for s, v, b, G in zip(squares, y, sides, grams, strict=True)
                ]
                square = np.maximum(residual_squares, 0.0) / n
                noise = np.maximum(np.sqrt(square), floor)
            of_noise = np.log(noise / np.abs(T).sum(1)) + 0.5 * square / noise**2  # in the unit that was recorded
            volume = float(np.linalg.slogdet(np.eye(len(H)) + H)[1])
            return -self.counted * float(of_noise.sum()) - 0.5 * float(x @ x) - 0.5 * volume

        return max(map(of_width, _WIDTHS))

    def _of_bodies(self, moved: Array, gravity: Array) -> tuple[Array, Mask]:
        """Torques `(number, joint, sample)` by changes of the bodies of one prior sigma, and which are of the links."""
        bodies = self.data.bodies
        Y = recorded_regressor(bodies.kinematics, moved, gravity, bodies.motion.sliding.joints)
        directions, deviations = uncertain(bodies.links, 1.0)
        links = np.einsum("nk,jks->njs", (deviations[:, None, None] * directions).reshape(len(directions), -1), Y)
        mass = _PAYLOAD * float(bodies.links[:, 0].sum())
        payload = np.moveaxis(Y[:, -10:-6], 1, 0) * (mass * np.r_[1.0, np.full(3, _PAYLOAD_LEVER)])[:, None, None]
        parts = [links, payload]
        if gravity.any():
            across = np.linalg.svd(gravity[None])[2][1:]
            still = np.stack([moved[0], 0 * moved[1], 0 * moved[2]])
            parts.append(np.stack([_BASE * self.rigid(still, np.cross(gravity, axis)) for axis in across]))
        columns = np.concatenate(parts)
        return columns, np.arange(len(columns)) < len(links)

    def _of_joints(self, moved: Array, gravity: Array, slope: Array, size: Array) -> tuple[Array, Mask]:
        """`(joint, number, sample)` Nm by what a joint may add, of one prior sigma, and which numbers are positive."""
        q = moved[0]
        joint_columns = self._beside(moved)[:, [0, 2, 3, 4, 5]] * np.sqrt(q.shape[1])  # of unit mean square
        spring = q - q.mean(1, keepdims=True)
        spring /= np.maximum(np.std(spring, axis=1, keepdims=True), 1e-9)
        rigid = self.rigid(moved, gravity) / size[:, None]
        added = np.stack([0.3 * spring, 0.1 * rigid, 0.02 * slope / size[:, None]], 1)
        columns = np.concatenate([joint_columns, added], 1) * size[:, None, None]
        return columns, np.array([False, True, True, True, True, False, False, False])


def _rotated(numbers: Array, R: Array) -> Array:
    """Inertial numbers `(10,)` of a link in axes turned by `R` about the same origin."""
    xx, yy, zz, xy, xz, yz = numbers[4:]
    tensor = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    return np.r_[numbers[0], R @ numbers[1:4], np.diagonal(tensor), tensor[[0, 0, 1], [1, 2, 2]]]


def _nonnegative(columns: Array, y: Array) -> tuple[Array, Array]:
    """Numbers `(…, row, number)` of a few columns, none negative, by least squares, and the squares that they leave.

    Of all sets of columns whose least squares have no negative number, the one that leaves least; all at once.

    Args:
        columns: `(…, number, sample)`, none longer than one.
        y: `(…, row, sample)`.
    """
    count = columns.shape[-2]
    sets = (np.arange(2**count)[:, None] >> np.arange(count)) % 2 == 1
    H = np.where(sets[:, :, None] & sets[:, None], (columns @ columns.swapaxes(-1, -2))[..., None, :, :], 0.0)
    H = H + np.where(sets, _RIDGE, 1.0)[..., None] * np.eye(count)
    b = (y @ columns.swapaxes(-1, -2)).swapaxes(-1, -2)[..., None, :, :]
    x = np.linalg.solve(H, np.where(sets[..., None], b, 0.0))
    explained = np.where((x >= 0).all(-2), np.sum(x * b, -2), -np.inf)
    active_set = np.argmax(explained, -2)
    numbers = np.take_along_axis(x, active_set[..., None, None, :], -3)[..., 0, :, :].swapaxes(-1, -2)
    return numbers, np.maximum(np.sum(y**2, -1) - np.max(explained, -2), 0.0)


def _solved(H: Array, g: Array, lower: Mask) -> Array:
    """The minimum of ½ xᵀHx − gᵀx in which the numbers `lower` are not negative."""
    free = ~lower
    L = np.linalg.cholesky(H[np.ix_(free, free)])
    B = np.linalg.solve(L, H[np.ix_(free, lower)])
    c = np.linalg.solve(L, g[free])
    S = np.linalg.cholesky(H[np.ix_(lower, lower)] - B.T @ B)
    x = np.zeros(len(g))
    x[lower] = nnls(S.T, np.linalg.solve(S, g[lower] - B.T @ c))[0]
    x[free] = np.linalg.solve(L.T, c - B @ x[lower])
    return x


def _of_pair(dof: int) -> float:
    """Log-likelihood that an exchange costs: one of all pairs."""
    return float(np.log(dof * (dof - 1) / 2 + 1))
