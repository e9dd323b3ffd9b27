"""Frames that jumped at a row: the sensor, the base or the tool was knocked, and all poses after it are elsewhere."""

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from lite6jax.domains.pose.screening.projection import SEEN, Projected, thinned
from lite6jax.domains.pose.screening.rigid import Rigid, physics_columns, transform_of
from lite6jax.estimation.noise import colour_of, correlation_length
from lite6jax.fitting.start import frames_from_poses
from lite6jax.recordings import Recording
from lite6jax.recordings.recording import run_segments

Array = NDArray[np.floating]

LEVEL = 1e-6
"""Family-wise: what remains of unknown physics in neighbouring rows is not independent."""
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
_SPLITS = 300
_LARGE = 20.0
_POLISHED = 6


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
    """What a search for jumps found.

    Attributes:
        jump: the next; None where there is none.
        p: family-wise, of the best candidate; NaN where there are too few rows to tell.
        drifted: whether that is more than chance, but no jump.
    """

    jump: Jump | None
    p: float
    drifted: bool


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
        return Sought(None, np.nan, False)
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
    rows, fitted = left.reshape(arm.rows, n), projected.basis.reshape(-1, arm.rows, n)
    colour = colour_of(rows, fitted, np.zeros(len(fitted)), segment)
    memory = max(correlation_length(rows), colour.length)
    p = min(float(n * 2 * chdtrc(len(columns), statistic / memory)), 1.0)
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
    if p > LEVEL or seen < LEAST_JUMP or small:
        return Sought(None, p, p < LEVEL)
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


def put_back(arm: Rigid, jump: Jump, beside_physics: bool = True) -> tuple[Rigid, Jump]:
    """The arm with the poses after a jump where they would have been without it, fitted; and the jump as refined.

    Args:
        arm: fitted.
        jump: as found.
        beside_physics: whether it is measured beside all that physics could do.
    """
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
        physics = physics_columns(moved, skip=("drift",)) if beside_physics else np.zeros((0, arm.rows, arm.samples))
        projected = Projected(moved, physics)
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
    told = eigenvalues > SEEN * 100
    return np.sum(np.where(told, pulled**2 / np.where(told, eigenvalues, 1.0), 0.0), 1)


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
