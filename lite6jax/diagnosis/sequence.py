"""Faults that only the order of the rows shows: a frame that jumped, joints read before the arm had settled."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2, norm

from lite6jax.diagnosis.rigid import WINSOR, Rigid, physics_columns, transform_of
from lite6jax.fitting.start import frames_from_poses
from lite6jax.recordings import Recording
from lite6jax.recordings.recording import run_segments

Array = NDArray[np.floating]

LEVEL = 1e-3
"""Family-wise, of unsettled read-outs."""
LEAST_SHARE = 0.01
"""Of what the physics leaves, that unsettled read-outs explain: less may be anything where poses are in an order."""
JUMP_LEVEL = 1e-6
"""Family-wise, of a jump: what remains of unknown physics in neighbouring rows is not independent."""
LEAST_AFTER = 8
"""Rows on either side of a jump."""
LEAST_JUMP = 1.0
"""Standard deviations of the sensor by which a jump moves the rows after it at least."""
LEAST_WITHIN = 0.03
"""Squares that a jump explains, over those that it and all physics leave."""
LEAST_BETWEEN_RUNS = 2.0
"""The same without any physics, where a moving arm begins anew elsewhere and all is different."""
LOCAL = 12
"""Rows on either side of a jump in a trajectory that show it beside the arm's motion."""
_LOCAL_FIRST = 1.5
_TOOL_ADVANTAGE = 1.05
MOST = 1500
"""Samples that are looked at: more cost time and tell nothing that is needed here."""
_SPLITS = 300
_RIDGE = 1e-10
_SEEN = 1e-6
_LARGE = 20.0
_POLISHED = 6
_WILD = 30.0
_APART = 0.03
_ALONG = 0.9


class Jump(NamedTuple):
    """A frame that is another before a sample and after.

    Attributes:
        sample: the first after it.
        what: "base", the sensor's frame against the base, or "tool", the measured point on the flange.
        twist: `(6,)` m and rad by which it moved, in its own axes.
        moved: m by which the poses after it are off, root mean square.
        p: family-wise.
    """

    sample: int
    what: Literal["base", "tool"]
    twist: Array
    moved: float
    p: float


class Sought(NamedTuple):
    """What a search for jumps found: the next, or how near the best candidate came."""

    jump: Jump | None
    p: float
    drifted: bool


class Unsettled(NamedTuple):
    """What a search for unsettled read-outs found.

    Attributes:
        shape: "move", a share of each move was left; "velocity", a time at the recorded velocity; "constant", the same
            angle after each move; "rows", a share of the move in some rows; or None.
        joints: concerned, from 0.
        rest: `(joint,)` share, s or rad.
        std: of it.
        correction: `(sample, joint)` rad to be added.
        samples: concerned.
        p: family-wise, of the best candidate if nothing was found.
        foretold: whether one was turned down because the moves that follow explain the poses as well.
    """

    shape: Literal["move", "velocity", "constant", "rows"] | None
    joints: tuple[int, ...]
    rest: Array
    std: Array
    correction: Array
    samples: NDArray[np.integer]
    p: float
    foretold: bool = False


@dataclass(frozen=True, eq=False)
class Projected:
    """Residuals from which all that known columns can do is taken out; samples far off count for less.

    Attributes:
        arm: fitted.
        known: `(number, row, sample)`, beside the arm's own unknowns.
    """

    arm: Rigid
    known: Array

    @cached_property
    def weight(self) -> Array:
        """`(sample,)` square root of Huber's, at four standard deviations a number."""
        length = np.sqrt(self.arm.squares / self.arm.rows) / self.arm.scale
        return np.sqrt(np.minimum(1.0, WINSOR / np.maximum(length, 1e-300)))

    @cached_property
    def basis(self) -> Array:
        """Rows `(number, row sample)`, orthonormal but for those that the others make; these nearly vanish."""
        columns = np.concatenate([self.arm.twists[self.arm.unknown], self.known]) * self.weight
        flat = columns.reshape(len(columns), self.arm.rows * self.arm.samples)
        norms = np.linalg.norm(flat, axis=1)
        flat = flat[norms > 0] / norms[norms > 0, None]
        if not len(flat):
            return flat
        L = np.linalg.cholesky(flat @ flat.T + _RIDGE * np.eye(len(flat)))
        return solve_triangular(L, flat, lower=True, check_finite=False)

    @cached_property
    def residual(self) -> Array:
        """`(row sample)`."""
        return self.without(self.arm.residual[None])[0]

    @cached_property
    def freedom(self) -> float:
        """Numbers left."""
        return self.arm.rows * self.arm.samples - float(np.sum(self.basis**2))

    def without(self, columns: Array) -> Array:
        """Weighted columns `(number, row, sample)` less what the known ones can do, `(number, row sample)`."""
        flat = (columns * self.weight).reshape(len(columns), -1)
        for _ in range(2):  # the ridge leaves a little the first time
            flat = flat - (flat @ self.basis.T) @ self.basis
        return flat

    def regression(self, columns: Array) -> tuple[Array, Array, float]:
        """Numbers `(number,)` of columns that explain the residual, their covariance, and the squares they explain.

        The covariance is the larger of that of white noise and that of samples of unequal noise (H. White,
        Econometrica 48, 1980).
        """
        X = self.without(columns)
        size = np.linalg.norm((columns * self.weight).reshape(len(columns), -1), axis=1)
        G = X @ X.T
        hidden = np.sqrt(np.diagonal(G)) <= np.sqrt(_SEEN) * size
        G[hidden, hidden] = np.inf if hidden.all() else np.maximum(G[hidden, hidden], size[hidden] ** 2 * 1e9 + 1e300)
        inverse = np.linalg.pinv(np.where(np.isfinite(G), G, 0.0)) if hidden.all() else np.linalg.inv(G)
        if hidden.any():
            inverse[hidden] = inverse[:, hidden] = 0.0
        values = -inverse @ (X @ self.residual)
        left = self.residual + values @ X
        white = inverse * max(float(left @ left) / max(self.freedom - len(X), 1), 1e-300)
        pulls = (X * left).reshape(len(X), self.arm.rows, -1).sum(1)
        uneven = inverse @ (pulls @ pulls.T) @ inverse
        grown = np.sqrt(np.maximum(1.0, np.diagonal(uneven) / np.maximum(np.diagonal(white), 1e-300)))
        covariance = white * np.outer(grown, grown)
        covariance[hidden, hidden] = np.inf
        explained = float(values @ (X @ X.T) @ values)
        return values, covariance, explained / max(float(left @ left) / max(self.freedom - len(X), 1), 1e-300)


def estimated(arm: Rigid, known: Array, columns: Array) -> tuple[Array, Array]:
    """The numbers of `columns` `(number, row, sample)` and their standard deviations, beside the known ones."""
    values, covariance, _ = Projected(arm, known).regression(columns)
    return values, np.sqrt(np.diagonal(covariance))


def seek_jump(arm: Rigid) -> Sought:
    """The row, if any, at which the sensor's frame, the base or the tool jumped.

    The maximum over rows of the score of six numbers that are others after it, beside all physics and a drift that is a
    cubic of time; the numbers that remember their neighbours count as fewer. In a trajectory the jump must be seen
    between neighbouring rows too, more than at any other row: the arm's own physics is smooth there.

    Args:
        arm: fitted.
    """
    whole, few = arm, thinned(arm.samples)
    arm = arm.select(few)
    projected = Projected(arm, physics_columns(arm))
    n, last = arm.samples, 6 * arm.recording.dof
    if projected.freedom < n or n < 4 * LEAST_AFTER:
        return Sought(None, 1.0, False)
    segment = run_segments(arm.recording.run)
    found: list[tuple[float, int, str, Array]] = []
    for what, part in (("base", slice(0, 6)), ("tool", slice(last, last + arm.rows))):
        columns = arm.twists[part]
        block = max(1, n // _SPLITS)
        starts = np.unique(np.concatenate([np.arange(0, n, block), np.flatnonzero(np.diff(segment)) + 1]))
        k, gain = _best_split(projected, columns, starts)
        k, gain = _best_split(projected, columns, np.arange(max(k - block, 1), min(k + block + 1, n)))
        found.append((gain / (1.0 if what == "base" else _TOOL_ADVANTAGE), k, what, columns))
    _, k, what, columns = max(found, key=lambda item: item[0])
    after = np.where(np.arange(n) >= k, columns, 0.0)
    values, _, statistic = projected.regression(after)
    left = projected.residual + values @ projected.without(after)
    memory = _memory(left.reshape(arm.rows, n))
    p = min(float(n * 2 * chi2.sf(statistic / memory, len(columns))), 1.0)
    plain = np.einsum(
        "k,krs->rs", values, arm.plain_twists[:6] if what == "base" else arm.plain_twists[last:][: arm.rows]
    )
    moved = float(np.sqrt(np.mean(np.sum(plain[:3, k:] ** 2, 0))))
    seen = np.sqrt(np.mean(np.sum(np.einsum("k,krs->rs", values, columns)[:, k:] ** 2, 0)) / arm.rows)
    between_runs = arm.recording.motion == "trajectory" and segment[k - 1] != segment[k]
    small = statistic < LEAST_WITHIN * projected.freedom
    if between_runs and not small:
        bare = Projected(arm, np.zeros((0, arm.rows, n)))
        small = bare.regression(after)[2] < LEAST_BETWEEN_RUNS * bare.freedom
    if p > JUMP_LEVEL or seen < LEAST_JUMP or small:
        return Sought(None, p, p < JUMP_LEVEL)
    twist = np.zeros(6)
    twist[: len(values)] = values
    if len(few) < whole.samples:
        k = _located(whole, few[k - 1], few[k], last if what == "tool" else 0, values)
    if not _sharp(whole, k, run_segments(whole.recording.run)):
        return Sought(None, p, True)
    return Sought(Jump(k, "base" if what == "base" else "tool", twist, moved, p), p, False)


def _located(arm: Rigid, low: int, high: int, first: int, values: Array) -> int:
    """The first sample of `(low, high]` after a jump by the numbers of twists from `first` on."""
    part = arm.select(np.arange(low, high + 1))
    plain = np.sum(part.residual**2, 0)
    moved = np.sum((part.residual + np.einsum("k,krs->rs", values, part.twists[first:][: len(values)])) ** 2, 0)
    return low + 1 + int(np.argmin(np.cumsum(plain - moved)[:-1]))


def put_back(arm: Rigid, jump: Jump) -> tuple[Rigid, Jump]:
    """The arm with the poses after a jump where they would have been without it, fitted; and the jump as refined."""
    total, moved = np.eye(4), arm
    twist = transform_of(jump.twist)
    if jump.what == "base" and jump.moved > _LARGE * arm.noise[0]:
        assert arm.recording.position is not None
        seen = arm.tool.copy()
        seen[:, :3, :3] = np.eye(3)
        parts = (slice(0, jump.sample), slice(jump.sample, None))
        before, after = (
            frames_from_poses(seen[part], arm.recording.position[part], None, None, np.eye(4))[0] for part in parts
        )
        inside = np.linalg.inv(arm.T_sensor_base)
        twist = inside @ after @ np.linalg.inv(before) @ arm.T_sensor_base
    for _ in range(_POLISHED):
        total = twist @ total if jump.what == "tool" else total @ twist
        recording = _moved_back(arm, moved, jump, total)
        moved = replace(moved, recording=recording).fitted()
        projected = Projected(moved, physics_columns(moved, skip=("drift",)))
        last = 6 * arm.recording.dof
        columns = moved.twists[:6] if jump.what == "base" else moved.twists[last:][: arm.rows]
        values, covariance, _ = projected.regression(np.where(np.arange(arm.samples) >= jump.sample, columns, 0.0))
        if np.all(np.abs(values) < 0.1 * np.sqrt(np.diagonal(covariance))):
            break
        small = np.zeros(6)
        small[: len(values)] = np.where(np.isfinite(np.diagonal(covariance)), values, 0.0)
        twist = transform_of(small)
    rotation = Rotation.from_matrix(total[:3, :3]).as_rotvec()
    final = np.concatenate([total[:3, 3], rotation])
    assert moved.recording.position is not None
    assert arm.recording.position is not None
    shift = np.linalg.norm(moved.recording.position - arm.recording.position, axis=1)[jump.sample :]
    return moved, jump._replace(twist=final, moved=float(np.sqrt(np.mean(shift**2))))


def _moved_back(arm: Rigid, fitted: Rigid, jump: Jump, T: Array) -> Recording:
    """The recording with the poses after a jump by `T` put back."""
    recording, after = arm.recording, np.arange(arm.samples) >= jump.sample
    assert recording.position is not None
    position, quaternion = recording.position.copy(), recording.quaternion
    R = None if quaternion is None else Rotation.from_quat(np.roll(quaternion, -1, 1)).as_matrix()
    if jump.what == "base":
        back = fitted.T_sensor_base @ np.linalg.inv(T) @ np.linalg.inv(fitted.T_sensor_base)
        position[after] = position[after] @ back[:3, :3].T + back[:3, 3]
        turned = None if R is None else back[:3, :3] @ R
    else:
        flange, tool = fitted.frames[-1], fitted.T_flange_tool
        slipped = flange @ T @ tool
        position[after] -= (slipped - flange @ tool)[after, :3, 3]
        slip = np.linalg.inv(T @ tool)[:3, :3] @ tool[:3, :3]
        turned = None if R is None else R @ slip
    if R is not None and turned is not None:
        unit = np.roll(Rotation.from_matrix(np.where(after[:, None, None], turned, R)).as_quat(), 1, axis=1)
        leading = np.argmax(np.abs(np.sign(unit)), axis=1)
        quaternion = unit * np.sign(unit[np.arange(len(unit)), leading, None])
    return replace(recording, position=position, quaternion=quaternion)


def moves(recording: Recording) -> Array:
    """`(sample, joint)` rad from where each joint was in the row before; from zero in the first row of a run."""
    q = recording.joint_position
    first = np.concatenate([[True], np.diff(run_segments(recording.run)) != 0])
    before = np.concatenate([np.zeros((1, q.shape[1])), q[:-1]])
    return q - np.where(first[:, None], 0.0, before)


def seek_unsettled(arm: Rigid) -> Unsettled:
    """Whether the joints of a static recording were read before the arm had come to rest.

    Then the pose shows the arm at q + rest, rest in the direction of the move: a share of it, or a time at the recorded
    velocity, or an angle. No effect depends on where the arm was before but backlash, whose sign is the opposite; all
    are estimated beside each other.

    Args:
        arm: fitted.
    """
    recording = arm.recording
    dof, n = recording.dof, arm.samples
    none = Unsettled(None, (), np.zeros(dof), np.zeros(dof), np.zeros((n, dof)), np.zeros(0, int), 1.0)
    if recording.motion != "static" or n < 3:
        return none
    wild = _unsettled_rows(arm)
    if wild is not None:
        return wild
    every = _rests(recording)
    few = thinned(n)
    shapes, future, arm = (
        {name: shape[few] for name, shape in every.items()},
        _next_moves(recording)[few],
        arm.select(few),
    )
    columns = {name: arm.joints * shape.T[:, None] for name, shape in shapes.items()}
    plain = physics_columns(arm, skip=("direction",))
    tests, least, foretold = len(shapes) * (1 + dof), 1.0, False
    found: list[tuple[float, Unsettled]] = []
    for name in shapes:
        projected = Projected(arm, np.concatenate([plain, *(columns[other] for other in shapes if other != name)]))
        if projected.freedom < arm.samples:
            return none
        each, covariance, separate = projected.regression(columns[name])
        one, spread, common = projected.regression(columns[name].sum(0, keepdims=True))
        p_one = float(norm.sf(one[0] / np.sqrt(spread[0, 0]))) * tests
        p_each = norm.sf(each / np.sqrt(np.diagonal(covariance))) * tests
        p = min(p_one, float(p_each.min()))
        least = min(least, p)
        if p > LEVEL:
            continue
        rest, std = np.full(dof, one[0]), np.full(dof, np.sqrt(spread[0, 0]))
        concerned, explained = np.ones(dof, bool), common
        apart = separate - common > max(chi2.isf(1e-4, max(dof - 1, 1)), _APART * separate)
        if p_one > LEVEL or apart:
            concerned = p_each < LEVEL
            rest, std = np.where(concerned, each, 0.0), np.sqrt(np.diagonal(covariance))
            explained = float(np.sum((rest / std) ** 2))
        if explained < LEAST_SHARE * projected.freedom:
            continue
        if name != "velocity" and _foretold(projected, columns[name], future if name == "move" else np.sign(future)):
            foretold = True
            continue
        joints = tuple(int(j) for j in np.flatnonzero(concerned))
        if joints:
            unsettled = Unsettled(name, joints, rest, std, every[name] * rest, np.arange(n), min(p, 1.0))  # type: ignore[arg-type]
            found.append((separate, unsettled))
    return max(found, key=lambda item: item[0])[1] if found else none._replace(p=min(least, 1.0), foretold=foretold)


def settled(arm: Rigid, found: Unsettled) -> tuple[Rigid, Unsettled]:
    """The arm with the rest added to its joints, fitted; and what was found as refined, each step linearised anew."""
    rest, concerned = np.zeros(len(found.rest)), np.isin(np.arange(len(found.rest)), found.joints)
    alike = np.ptp(found.rest) == 0
    few, step, shape = thinned(arm.samples), found.rest, _rests(arm.recording)[str(found.shape)]
    start = arm.recording
    for _ in range(_POLISHED):
        rest = rest + step
        arm = replace(arm, recording=replace(start, joint_position=start.joint_position + shape * rest)).fitted()
        part = arm.select(few)
        columns = part.joints * shape[few].T[:, None]
        known = [physics_columns(part, skip=("direction",) if found.shape == "constant" else ())]
        group = columns.sum(0, keepdims=True) if alike else columns[concerned]
        values, covariance, _ = Projected(part, np.concatenate(known)).regression(group)
        std = np.sqrt(np.diagonal(covariance))
        if np.all(np.abs(values) < 0.1 * std):
            break
        step = np.zeros_like(rest)
        step[concerned] = np.where(np.isfinite(std), values, 0.0)
    return arm, found._replace(rest=rest, correction=shape * rest)


def _rests(recording: Recording) -> dict[str, Array]:
    """What a rest may be proportional to, `(sample, joint)` each."""
    shapes = {"move": moves(recording), "constant": recording.direction_of_motion}
    if recording.joint_velocity is not None and np.any(recording.joint_velocity):
        shapes["velocity"] = recording.joint_velocity
    return shapes


def _foretold(projected: Projected, columns: Array, future: Array) -> bool:
    """Whether the moves that follow explain the poses too, beside those that led there: then the order of the poses is
    tied to where they are, and it is something else that depends on that."""
    past = projected.regression(columns)[2]
    both = projected.regression(np.concatenate([columns, projected.arm.joints * future.T[:, None]]))[2]
    return bool(both - past > max(chi2.isf(1e-6, len(columns)), 0.1 * past))


def _next_moves(recording: Recording) -> Array:
    """`(sample, joint)` rad from where each joint is in the row after; zero in the last row of a run."""
    back = -moves(recording)
    back[np.concatenate([[True], np.diff(run_segments(recording.run)) != 0])] = 0.0
    return np.roll(back, -1, axis=0)


def thinned(samples: int) -> NDArray[np.integer]:
    """Some thousand samples, evenly."""
    return np.unique(np.linspace(0, samples - 1, min(samples, MOST)).astype(int))


def _unsettled_rows(arm: Rigid) -> Unsettled | None:
    """Rows far off whose residual lies along the move that led there."""
    recording, scale = arm.recording, arm.scale
    wild = arm.squares > _WILD * arm.rows * scale**2
    if not 3 <= wild.sum() <= arm.samples // 3:
        return None
    along = np.einsum("jrs,sj->rs", arm.joints, moves(recording))
    length = np.sum(along**2, 0)
    product = np.sum(along * arm.residual, 0)
    share = -product / np.maximum(length, 1e-300)
    cosine2 = product**2 / np.maximum(length * arm.squares, 1e-300)
    hit = wild & (cosine2 > _ALONG) & (share > 0)
    by_chance = (1 - np.sqrt(_ALONG)) / 2
    p = float(binom.sf(hit.sum() - 1, wild.sum(), by_chance))
    if p > LEVEL or hit.sum() < 3:
        return None
    rest = np.full(recording.dof, float(np.median(share[hit])))
    none = np.zeros_like(recording.joint_position)
    return Unsettled("rows", tuple(range(recording.dof)), rest, np.zeros_like(rest), none, np.flatnonzero(hit), p)


def _best_split(projected: Projected, columns: Array, starts: NDArray[np.integer]) -> tuple[int, float]:
    """The start that explains most, and the squares it explains."""
    n = projected.arm.samples
    starts = np.unique(np.concatenate([[0], starts]))
    gain = _scan(projected, columns, starts)
    gain[(starts < LEAST_AFTER) | (starts > n - LEAST_AFTER)] = 0.0
    k = int(np.argmax(gain))
    return int(starts[k]), float(gain[k])


def _scan(projected: Projected, columns: Array, starts: NDArray[np.integer]) -> Array:
    """The squares that columns switched on from each start explain of the residual, `(start,)`."""
    rows, n = projected.arm.rows, projected.arm.samples
    C = columns * projected.weight

    def suffix(values: Array) -> Array:
        return np.cumsum(np.add.reduceat(values, starts, axis=-1)[..., ::-1], -1)[..., ::-1]

    g = suffix(np.einsum("crs,rs->cs", C, projected.residual.reshape(rows, n)))
    G = suffix(np.einsum("crs,drs->cds", C, C))
    Q = projected.basis.reshape(-1, rows, n)
    B = np.stack([suffix(np.einsum("mrs,rs->ms", Q, c)) for c in C])
    size = np.sqrt(np.maximum(np.einsum("ccs->cs", G), 1e-300))
    G = np.moveaxis((G - np.einsum("cms,dms->cds", B, B)) / size[:, None] / size, -1, 0)
    eigenvalues, V = np.linalg.eigh(G)
    pulled = np.einsum("sck,cs->sk", V, g / size)
    told = eigenvalues > _SEEN * 100
    return np.sum(np.where(told, pulled**2 / np.where(told, eigenvalues, 1.0), 0.0), 1)


def _memory(rows: Array) -> float:
    """Over how many samples residuals `(row, sample)` remember: the sum of their autocorrelation, 1 for white noise."""
    n = rows.shape[1]
    spectrum = np.abs(np.fft.rfft(rows, 2 * n, axis=1)) ** 2
    correlation = np.fft.irfft(spectrum.sum(0))[: max(n // 4, 2)]
    correlation = correlation / max(correlation[0], 1e-300)
    under = correlation < 2 / np.sqrt(n)
    last = int(np.argmax(under)) if under.any() else len(correlation)
    return float(1 + 2 * correlation[1:last].sum())


def _sharp(arm: Rigid, k: int, segment: NDArray[np.integer]) -> bool:
    """Whether a trajectory shows more of a jump at a row than at any other; true where a run begins, and at rest."""
    n, w = arm.samples, LOCAL
    if arm.recording.motion == "static" or k < w or k > n - w or segment[k - 1] != segment[k]:
        return True
    steps = np.arange(w) + 0.5
    ahead = np.linalg.pinv(np.stack([np.ones(w), steps], 1))[0]  # the value at the row's near side, of a straight line
    kernel = np.concatenate([-ahead[::-1], ahead])
    jumps = np.stack([np.convolve(row, kernel[::-1], "valid") for row in arm.residual])  # at samples w … n − w
    at = np.arange(w, n - w + 1)
    inside = segment[at - w] == segment[at + w - 1]
    jumps, at = jumps[:, inside], at[inside]
    spread = 1.4826 * np.median(np.abs(jumps), axis=1, keepdims=True)
    size = np.sum((jumps / np.maximum(spread, 1e-300)) ** 2, 0)
    near = np.abs(at - k) <= w
    if not near.any() or near.all():
        return False
    return bool(size[near].max() > _LOCAL_FIRST * size[~near].max())
