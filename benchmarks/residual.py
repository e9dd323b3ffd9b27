"""What others learn from the rows that a fitted geometry leaves: a Gaussian process, a neural network, linear physics.

Linear are a ridge regression on Fourier orders and gravity, and a stepwise search of the same columns by BIC.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.concealed.chain import Chain, vector_from_rotation
from benchmarks.concealed.plain_physics import moments
from lite6jax.arms.chains import HayatiForm
from lite6jax.arms.dh import hayati_to_six_parameter
from lite6jax.calibration.problem import UNDECLARED_NOISE
from lite6jax.domains.pose.fit import fit
from lite6jax.recordings import Recording

Array = NDArray[Any]

_WILD = 8.0  # times the median distance from the median beyond which a row is not fitted
_GP_TUNED, _GP_ROWS = 800, 3000
"""Rows by which a Gaussian process' kernel is chosen, and rows that it then keeps at most."""
ORDERS = tuple(range(1, 61))
_BLOCKS, _PIECE = 5, 500
"""Blocks of neighbouring rows, by which a ridge is chosen; rows of a piece, so that memory does not matter."""
_MOST_GROUPS = 80
_RIDGES = np.logspace(-8, 2, 11)
_GAUGE = 1e-9


@dataclass(frozen=True, eq=False)
class View:
    """Rows of a recording as a fitted geometry sees them, in the base's axes.

    The sites are the base, every joint and the tool.
    """

    recording: Recording
    axes: Array  # rotations `(sample, site, 3, 3)`, after each joint
    origins: Array  # `(sample, site, 3)` m, where these are
    missed: Array | None  # `(sample, 3)` m, measured less predicted; None without poses
    turned: Array | None  # `(sample, 3)` rad; None without orientations
    # `(sample, site, 3)` Nm about each frame's origin in its axes, but not the tool's; None where masses are not known
    moment: Array | None
    noise: tuple[float, float]  # m and rad, what residuals are weighed by

    @property
    def tool(self) -> Array:
        """`(sample, 3)` m."""
        return self.origins[:, -1]

    def rows(self, chosen: NDArray) -> "View":
        """Some of them."""
        arrays = {each.name: getattr(self, each.name) for each in fields(self)[1:-1]}
        some = {name: None if array is None else array[chosen] for name, array in arrays.items()}
        return replace(self, recording=self.recording.select(chosen), **some)

    def pieces(self) -> Iterator["View"]:
        """All of them, some after the other, so that memory does not matter."""
        samples = self.recording.samples
        return map(self.rows, np.array_split(np.arange(samples), 1 + samples // _PIECE))

    @property
    def whitened(self) -> Array:
        """`(sample, row)`, residuals over the noise."""
        assert self.missed is not None
        shift = self.missed / self.noise[0]
        return shift if self.turned is None else np.hstack([shift, self.turned / self.noise[1]])

    @property
    def usable(self) -> "View":
        """Its rows that are not wild."""
        assert self.missed is not None
        far = np.linalg.norm(self.missed - np.median(self.missed, 0), axis=1)
        return self.rows(np.flatnonzero(far < _WILD * np.median(far)))


class Fitted(NamedTuple):
    """A rival after it has seen its rows."""

    # what it adds to the geometry's poses of other rows, `(sample, 6)` m and rad in the base's axes; turns are zero of
    # one that says nothing of orientation
    correct: Callable[[View], Array]
    parameters: int  # how many numbers it has fitted over the geometry; those of a Gaussian process are its weights
    names: tuple[str, ...] = ()  # the physics that it names, as `effect:site`


Rival = Callable[[View], Fitted]  # fits what is left of the geometry's residuals


@dataclass(frozen=True, eq=False)
class Geometry:
    """A fitted arm."""

    chain: Chain  # its six-parameter form with masses, zero where not known
    weighed: bool  # whether they are known
    sensor: Array  # `(4, 4)` T_sensor_base
    after: Array  # `(4, 4)` from the last joint's frame to the tool
    free: bool  # whether the chain was fitted; else only frame and tool

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
        tool, free = after @ np.asarray(solution.model.T_flange_tool), bool(solution.free[: form.size].any())
        return cls(chain, known, np.asarray(solution.model.T_sensor_base), tool, free)

    def view(self, recording: Recording) -> View:
        """Rows of a recording, with residuals where it has poses."""
        told, eye = recording.settings, np.eye(3)
        R, o = self.chain.frames(recording.joint_position)
        Rt, p = R[:, -1] @ self.after[:3, :3], o[:, -1] + R[:, -1] @ self.after[:3, 3]
        S, s = self.sensor[:3, :3], self.sensor[:3, 3]
        axes = np.concatenate([np.broadcast_to(eye, Rt.shape)[:, None], R, Rt[:, None]], 1)
        origins = np.concatenate([np.zeros_like(p)[:, None], o, p[:, None]], 1)
        missed = turned = moment = None
        if recording.position is not None:
            missed = (recording.position - s) @ S - p
        if recording.quaternion is not None:
            turned = vector_from_rotation(S.T @ rotations(recording.quaternion) @ np.swapaxes(Rt, 1, 2))
        if self.weighed:
            center = np.array(told.payload_com_m)
            of_joints, base = moments(self.chain, recording.joint_position, recording.payload, center)
            moment = np.concatenate([base[:, None], of_joints], 1)
        noise = (told.position_noise_m or UNDECLARED_NOISE[0], told.orientation_noise_rad or UNDECLARED_NOISE[1])
        return View(recording, axes, origins, missed, turned, moment, noise)


def rotations(quaternion: Array) -> Array:
    """`(sample, 3, 3)` of unit quaternions, scalar first."""
    return Rotation.from_quat(np.roll(quaternion, -1, axis=1)).as_matrix()


def geometry_alone(seen: View) -> Fitted:
    """Nothing more."""
    return Fitted(lambda view: np.zeros((len(view.tool), 6)), 0)


def _learn(seen: View, angles: bool, learn: Callable[[Array, Array], Any]) -> tuple[Any, Callable[[View], Array]]:
    """A black box fitted to inputs that vary, of mean zero and deviation one, and outputs over theirs; what it says.

    Its inputs are joints (`angles`: their sines and cosines too) and all that varies.
    """
    from sklearn.exceptions import ConvergenceWarning

    def features(view: View) -> Array:
        r, q = view.recording, view.recording.joint_position
        columns = [q, np.sin(q), np.cos(q)] if angles else [q]
        columns += [r.payload[:, None], r.direction_of_motion]
        warmth = (r.joint_temperature, r.ambient_temperature)
        return np.hstack([*columns, *(part.reshape(len(q), -1) for part in warmth if part is not None)])

    assert seen.missed is not None
    X, size = features(seen), max(float(np.std(seen.missed)), 1e-12)
    kept = X.std(0) > 1e-9
    mean, spread = X[:, kept].mean(0), X[:, kept].std(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        box = learn((X[:, kept] - mean) / spread, seen.missed / size)

    def correct(view: View) -> Array:
        shift = size * np.asarray(box.predict((features(view)[:, kept] - mean) / spread))
        return np.hstack([shift, np.zeros_like(shift)])

    return box, correct


def gaussian_process(seen: View) -> Fitted:
    """The residual's three components over joints, payload, direction and temperature: one length a feature, noise."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    def learn(X: Array, y: Array) -> Any:
        lengths: Any = np.ones(X.shape[1])  # one a feature
        kernel = ConstantKernel() * RBF(lengths, (0.05, 1e3)) + WhiteKernel(0.1, (1e-6, 10.0))
        chosen: Any = np.random.default_rng(0).permutation(len(X))
        tuned = GaussianProcessRegressor(kernel, normalize_y=True, random_state=0)
        tuned.fit(X[chosen[:_GP_TUNED]], y[chosen[:_GP_TUNED]])
        as_it_is: Any = None
        kept = chosen[:_GP_ROWS]
        return GaussianProcessRegressor(tuned.kernel_, optimizer=as_it_is, normalize_y=True).fit(X[kept], y[kept])

    process, correct = _learn(seen, False, learn)
    rows, inputs = process.X_train_.shape
    return Fitted(correct, 3 * rows + 2 + inputs)


def neural_network(seen: View) -> Fitted:
    """Two layers of 64 over joints, their sines and cosines, payload, direction and temperature; stopped early."""
    from sklearn.neural_network import MLPRegressor

    stopped: dict[str, Any] = {"early_stopping": True, "n_iter_no_change": 25, "max_iter": 600}
    net = MLPRegressor(hidden_layer_sizes=(64, 64), activation="tanh", alpha=1e-4, random_state=0, **stopped)
    _, correct = _learn(seen, True, net.fit)
    return Fitted(correct, sum(part.size for part in (*net.coefs_, *net.intercepts_)))


# ------------------------------------------------------------------ linear physics


class Column(NamedTuple):
    """A displacement of a frame by a driver: site 0 is the base, then the frame after each joint, then the tool."""

    site: int
    component: int
    driver: Callable[[View], Array]


class Group(NamedTuple):
    """Columns that belong together, and what they are called."""

    name: str
    columns: tuple[Column, ...]


def nuisance(view: View, free: bool) -> list[Column]:
    """What the geometry's fit moves, as displacements: sensor frame, tool, and every link where the chain is free."""
    settings, dof = view.recording.settings, view.recording.dof
    sites: list[tuple[int, int]] = []
    if settings.pose_frame == "unknown":
        sites += product([0], range(6))
    if settings.tool == "unknown":
        sites += product([dof + 1], range(3 if view.turned is None else 6))
    if free:
        sites += product(range(1, dof), range(6))
    return [Column(site, component, lambda v: np.ones(len(v.tool))) for site, component in sites]


def waves(view: View, orders: Sequence[int]) -> list[Group]:
    """Each order of each joint."""

    def wave(i: int, n: int, of: Callable[[Array], Array], v: View) -> Array:
        return of(n * v.recording.joint_position[:, i])

    return [
        Group(
            f"joint_harmonic:joint{i + 1}", tuple(Column(i + 1, 5, partial(wave, i, n, of)) for of in (np.sin, np.cos))
        )
        for i, n in product(range(view.recording.dof), orders)
    ]


def gravity(view: View) -> list[Group]:
    """Compliances of joints, links and base; none where the masses are not known."""
    if view.moment is None:
        return []

    def moment(site: int, axis: int, v: View) -> Array:
        assert v.moment is not None
        return v.moment[:, site, axis]

    joints = range(1, view.recording.dof + 1)
    found = [Group(f"joint_compliance:joint{i}", (Column(i, 5, partial(moment, i, 2)),)) for i in joints]
    for i in (*joints, 0):
        name = f"link_compliance:link{i}" if i else "base_compliance:base"
        found.append(Group(name, tuple(Column(i, 3 + k, partial(moment, i, k)) for k in (0, 1))))
    return found


def other_physics(view: View) -> list[Group]:
    """The catalogue's other linear effects, where the rows have their drivers."""
    r, found = view.recording, []
    for i in range(r.dof):
        drivers: list[tuple[str, Callable[[View], Array]]] = [
            ("joint_backlash", lambda v, i=i: v.recording.direction_of_motion[:, i]),
            ("joint_scale", lambda v, i=i: v.recording.joint_position[:, i]),
            *(("joint_coupling", lambda v, j=j: v.recording.joint_position[:, j]) for j in range(r.dof) if j != i),
        ]
        if r.motion == "trajectory" and r.joint_velocity is not None:
            drivers.append(("joint_lag", lambda v, i=i: v.recording.velocities()[:, i]))
        found += [Group(f"{name}:joint{i + 1}", (Column(i + 1, 5, driver),)) for name, driver in drivers]
    if r.time is not None:

        def time(v: View) -> Array:
            # a drift belongs to its set-up: another one that has no clock has none of it
            return np.zeros(len(v.tool)) if v.recording.time is None else v.recording.time

        found.append(Group("base_drift:base", tuple(Column(0, k, time) for k in range(3))))
    return found


def design(view: View, columns: Sequence[Column], turned: bool = False) -> Array:
    """`(sample, row, column)`, how each column moves the tool, in base axes, over the noise; `turned` has six rows."""
    rows = 6 if turned or view.turned is not None else 3
    J = np.zeros((len(view.tool), rows, len(columns)))
    for k, (site, component, driver) in enumerate(columns):
        axis = view.axes[:, site, :, component % 3] * driver(view)[:, None]
        turns = component > 2
        J[:, :3, k] = (np.cross(axis, view.tool - view.origins[:, site]) if turns else axis) / view.noise[0]
        if rows == 6 and turns:
            J[:, 3:, k] = axis / view.noise[1]
    return J


class Gram:
    """Normal equations of columns of unit length, block by block of neighbouring rows.

    Args:
        seen: the rows, in this order.
        free: whether the geometry's fit moved the chain; the first `held` columns are what it moved.
        groups: of the other columns.
        blocks: how many.
    """

    def __init__(self, seen: View, free: bool, groups: Sequence[Group], blocks: int):
        fixed = nuisance(seen, free)
        self.columns = [*fixed, *(column for group in groups for column in group.columns)]
        self.held, self.numbers, size = len(fixed), seen.whitened.size, len(self.columns)
        self.A, self.b, self.squares = np.zeros((blocks, size, size)), np.zeros((blocks, size)), np.zeros(blocks)
        block = np.arange(seen.recording.samples) * blocks // seen.recording.samples
        for k in range(blocks):
            for part in seen.rows(np.flatnonzero(block == k)).pieces():
                J, r = design(part, self.columns).reshape(-1, size), part.whitened.ravel()
                self.A[k] += J.T @ J
                self.b[k] += J.T @ r
                self.squares[k] += r @ r
        self.scale = np.sqrt(np.maximum(np.diagonal(self.A.sum(0)), 1e-300))
        self.A, self.b = self.A / self.scale / self.scale[:, None], self.b / self.scale

    def fitted(self, at: NDArray[np.integer], beta: Array, names: tuple[str, ...] = ()) -> Fitted:
        """What the columns at some places do, so many times each."""
        used, beta = [self.columns[k] for k in at], beta / self.scale[at]

        def correct(view: View) -> Array:
            moved = np.concatenate([design(part, used, turned=True) @ beta for part in view.pieces()])
            return moved * np.repeat(view.noise, 3)

        return Fitted(correct, len(at) - self.held, names)


def ridge(free: bool, seen: View) -> Fitted:
    """Fourier orders 1–60 of every joint and gravity's moments, shrunk by what contiguous blocks of the rows prefer."""
    gram = Gram(seen, free, [*waves(seen, ORDERS), *gravity(seen)], _BLOCKS)
    A, b, size = gram.A.sum(0), gram.b.sum(0), len(gram.columns)

    def solved(A: Array, b: Array, strength: float) -> Array:
        return np.linalg.solve(A + np.diag(np.where(np.arange(size) < gram.held, _GAUGE, strength)), b)

    missed = np.zeros(len(_RIDGES))
    for held_A, held_b, squares in zip(gram.A, gram.b, gram.squares, strict=True):
        for i, strength in enumerate(_RIDGES):
            beta = solved(A - held_A, b - held_b, strength)
            missed[i] += squares - 2 * beta @ held_b + beta @ held_A @ beta
    return gram.fitted(np.arange(size), solved(A, b, float(_RIDGES[np.argmin(missed)])))


def stepwise(free: bool, seen: View) -> Fitted:
    """The catalogue and all orders: one more while the Bayesian information criterion falls, then less likewise."""
    groups = [*gravity(seen), *other_physics(seen), *waves(seen, ORDERS)]
    gram = Gram(seen, free, groups, 1)
    A, b, n = gram.A[0], gram.b[0], gram.numbers
    slices = [slice(*ends) for ends in pairwise(np.cumsum([gram.held, *(len(group.columns) for group in groups)]))]

    def squares(chosen: Sequence[int]) -> tuple[float, Array, NDArray]:
        at = np.concatenate([np.arange(gram.held), *(np.arange(len(b))[slices[g]] for g in chosen)]).astype(int)
        beta = np.linalg.solve(A[np.ix_(at, at)] + _GAUGE * np.eye(len(at)), b[at])
        return float(gram.squares[0] - b[at] @ beta), beta, at

    def bic(rss: float, chosen: Sequence[int]) -> float:
        return n * np.log(max(rss, 1e-12) / n) + np.log(n) * sum(len(groups[g].columns) for g in chosen)

    chosen: list[int] = []
    now, beta, at = squares(chosen)
    while len(chosen) < _MOST_GROUPS:
        # what each group would gain, the chosen and the geometry projected out
        within = A[np.ix_(at, at)] + _GAUGE * np.eye(len(at))
        rest = b - A[:, at] @ beta
        explained = np.linalg.solve(within, A[at])
        gains = np.full(len(groups), -np.inf)
        for g, part in enumerate(slices):
            if g not in chosen:
                S = A[part, part] - A[part][:, at] @ explained[:, part]
                S = S + _GAUGE * np.eye(len(S))
                # a group that the geometry explains almost wholly has no coefficient of its own
                if np.linalg.eigvalsh(S)[0] > 1e-6:
                    gains[g] = rest[part] @ np.linalg.solve(S, rest[part])
        worth = [bic(max(now - gain, 1e-12), [*chosen, g]) for g, gain in enumerate(gains)]
        best = int(np.argmin(worth))
        if not np.isfinite(gains[best]) or worth[best] >= bic(now, chosen):
            break
        chosen.append(best)
        now, beta, at = squares(chosen)
    while chosen:
        without = [[g for g in chosen if g != gone] for gone in chosen]
        worth = [bic(squares(kept)[0], kept) for kept in without]
        best = int(np.argmin(worth))
        if worth[best] >= bic(now, chosen):
            break
        chosen = without[best]
        now, beta, at = squares(chosen)
    return gram.fitted(at, beta, tuple(sorted({groups[g].name for g in chosen})))
