"""Frame jumps: the sensor, the base or the tool moved between two rows, and all poses after it are displaced."""

from dataclasses import replace
from typing import Any, NamedTuple, final

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc

from lite6jax.array_types import AnyArray, Array, Integers
from lite6jax.calibration.start import measured_rotations
from lite6jax.domains.pose.kinematics import small_displacement, unit_quaternions
from lite6jax.domains.pose.rigid_arm import RigidArm
from lite6jax.domains.pose.screening.projection import Projected, estimated, next_step, physics_columns
from lite6jax.domains.pose.screening.screened import ScreenedPoses
from lite6jax.domains.pose.screening.thresholds import (
    JUMP_LEVEL,
    MOST_FITTED,
    MOST_SAMPLES,
    OBSERVABLE_SHARE,
    REFINEMENTS,
)
from lite6jax.estimation.noise import autocorrelation_time, noise_model
from lite6jax.estimation.options import DEFAULTS
from lite6jax.recordings import Recording
from lite6jax.recordings.alignment import frames_from_poses
from lite6jax.recordings.fault import DataFault, row_numbers
from lite6jax.recordings.sequence import run_segments, spread_rows

_MOST_JUMPS = 3
"""Jumps that are corrected; a mount that slips more often must be repaired."""
_MARGIN = 8
"""Rows on either side of a jump; six numbers are estimated from them."""
_NOISE = 1.0
"""Standard deviations of the sensor that a jump displaces; less does no harm."""
_SHARE = 0.03
"""Squares that a jump explains over the freedom, set on simulated recordings without a jump."""
_WINDOW = 12
"""Rows on either side that show a jump in motion: a quarter of a second at 50 Hz."""
_SHARPNESS = 1.5
"""Ratio of the step at its row to others; an arm's own physics is smooth."""
_TOOL_ADVANTAGE = 1.05
"""Ratio by which a jump of the tool must explain more; bases are knocked more often."""
_BLOCKS = 300
"""Blocks of rows between which jumps are first sought; bounds the time."""
_LARGE_NOISE = 20.0
"""Standard deviations from which a jump starts in closed form, as a linear step fails."""


@final
class Jump(NamedTuple):
    """A frame that is another before a sample and after.

    Attributes:
        sample: the first after it.
        part: "base", the sensor's frame against the base, or "tool", the measured point on the flange.
        twist: `(6,)` m and rad by which it moved, in its own axes.
        displacement: m by which the poses after it are off, root mean square.
        p: family-wise; NaN where its row was given, so that nothing is tested.
    """

    sample: int
    part: str
    twist: Array
    displacement: float
    p: float


def remove_jumps(state: ScreenedPoses) -> ScreenedPoses:
    """The poses after each jump where they would have been without it."""
    known_jumps = state.corrections.known_jumps
    limit = state.corrections.jumps
    if known_jumps is not None:
        for row, part in known_jumps:
            jump = _jump_at(state.rigid_arm, row, part)
            if jump is None:
                break
            state = _without(state, jump)
        return state
    for _ in range(_MOST_JUMPS if limit is None else limit):
        jump, numbers = seek_jump(state.rigid_arm)
        if jump is None:
            return state.rule_out("frame_jump", samples=state.recording.samples, **numbers)
        place = {"row": int(state.recording.row[jump.sample]), "part": jump.part}
        if any(place.items() <= fault.numbers.items() for fault in state.found if fault.code == "frame_jump"):
            break  # what is left after it was corrected is no constant twist
        state = _without(state, jump)
    return state


def _without(state: ScreenedPoses, jump: Jump) -> ScreenedPoses:
    arm, refined = without_jump(state.rigid_arm, jump, state.corrections.beside_physics)
    row = arm.recording.row
    run = arm.recording.run
    k = jump.sample
    numbers: dict[str, Any] = {
        "row": int(row[k]),
        "part": jump.part,
        **({"run": int(run[k])} if k and run[k] != run[k - 1] else {}),
        "translation_m": float(np.linalg.norm(refined.twist[:3])),
        "rotation_rad": float(np.linalg.norm(refined.twist[3:])),
        "twist": refined.twist.tolist(),
        "displacement_rms_m": refined.displacement,
        "p_value": refined.p,
    }

    def remove(recording: Recording) -> Recording:
        """The correction in more rows of the same recording, which show between which of them the jump happened."""
        full_arm = arm.with_poses(recording)
        rows = arm.recording.row
        before, sample = (int(np.flatnonzero(recording.row == rows[j])[0]) for j in (max(k - 1, 0), k))
        if sample - before > 1:
            part_numbers = _numbers(arm, jump.part)
            sample = _located(
                full_arm, before, sample, part_numbers, refined.twist[: part_numbers.stop - part_numbers.start]
            )
        return _displaced_back(full_arm, full_arm, refined._replace(sample=sample), small_displacement(refined.twist))

    return state.corrected(DataFault("frame_jump", row_numbers(row[k:]), numbers), rigid=arm).transformed(remove)


def _numbers(arm: RigidArm, part: str) -> slice:
    """Which of the arm's twists move the base, or the tool as far as it is measured."""
    last = 6 * arm.recording.dof
    return slice(0, 6) if part == "base" else slice(last, last + arm.rows)


def _displacement(arm: RigidArm, numbers: slice, values: Array, after: AnyArray) -> float:
    """m, root mean square, of the positions of some samples by a twist."""
    moved = np.einsum("k,krs->rs", values, arm.plain_twists[numbers])[:3, after]
    return float(np.sqrt(np.mean(np.sum(moved**2, 0))))


def _jump_at(arm: RigidArm, row: int, part: str) -> Jump | None:
    """The jump at a row of the file, its size estimated; None where no row before it, or none after it, is there."""
    later = arm.recording.row >= row
    sample = int(np.argmax(later))
    if not sample:
        return None
    sampled_rows = spread_rows(arm.samples, MOST_SAMPLES)
    numbers = _numbers(arm, part)
    after = sampled_rows >= sample
    arm = arm.select(sampled_rows)
    values, std = estimated(arm, physics_columns(arm), np.where(after, arm.twists[numbers], 0.0))
    twist = _twist(np.where(np.isfinite(std), values, 0.0))
    return Jump(sample, part, twist, _displacement(arm, numbers, values, after), float("nan"))


def _twist(values: Array) -> Array:
    """With zeros for what is not measured of it."""
    return np.pad(values, (0, 6 - len(values)))


def seek_jump(arm: RigidArm) -> tuple[Jump | None, dict[str, Any]]:
    """The row, if any, at which the sensor's frame, the base or the tool jumped; else the numbers that rule it out.

    The maximum over rows of the score of six numbers that are others after it, beside all physics and a drift that is a
    cubic of time; autocorrelated residuals count as fewer. In a trajectory the jump must be visible between
    neighbouring rows too, more than at any other row: the arm's own physics is smooth there.
    """
    full_arm = arm
    sampled_rows = spread_rows(arm.samples, MOST_SAMPLES)
    arm = arm.select(sampled_rows)
    projected = Projected(arm, physics_columns(arm))
    n = arm.samples
    if projected.freedom < n or n < 4 * _MARGIN:
        return None, {"reason": "too_few_rows"}
    segment = run_segments(arm.recording.run)
    splits = list[tuple[float, int, str]]()
    block = max(1, n // _BLOCKS)
    for part, advantage in (("base", 1.0), ("tool", _TOOL_ADVANTAGE)):
        columns = arm.twists[_numbers(arm, part)]
        starts = np.unique(np.concatenate([np.arange(0, n, block), np.flatnonzero(np.diff(segment)) + 1]))
        k, gain = _best_split(projected, columns, starts)
        k, gain = _best_split(projected, columns, np.arange(max(k - block, 1), min(k + block + 1, n)))
        splits.append((gain / advantage, k, part))
    _, k, part = max(splits, key=lambda item: item[0])
    numbers = _numbers(arm, part)
    later = np.arange(n) >= k
    after = np.where(later, arm.twists[numbers], 0.0)
    values, _, statistic = projected.regression(after)
    p = _p_value(projected, after, values, statistic)
    displacement = _displacement(arm, numbers, values, later)
    sigmas = np.sqrt(np.mean(np.sum(np.einsum("k,krs->rs", values, after)[:, k:] ** 2, 0)) / arm.rows)
    if p > JUMP_LEVEL or sigmas < _NOISE or statistic < _SHARE * projected.freedom:
        return None, {"reason": "gradual" if p < JUMP_LEVEL else "chance", "p_value": p}
    if len(sampled_rows) < full_arm.samples:
        k = _located(full_arm, sampled_rows[k - 1], sampled_rows[k], numbers, values)
    if not _sharp(full_arm, k):
        return None, {"reason": "gradual", "p_value": p}
    return Jump(k, part, _twist(values), displacement, p), {}


def _p_value(projected: Projected, after: Array, values: Array, statistic: float) -> float:
    """The probability by chance of the best row's statistic, of two kinds of jumps at every row.

    The noise model, which makes it larger, takes long; it is estimated only where it decides.
    """
    arm = projected.arm
    rows = (projected.residual + values @ projected.without(after)).reshape(arm.rows, arm.samples)

    def at(time: float) -> float:
        return min(float(2 * arm.samples * chdtrc(len(after), statistic / time)), 1.0)

    time = autocorrelation_time(rows)
    if at(time) > JUMP_LEVEL:
        return at(time)
    fitted = projected.basis.reshape(-1, arm.rows, arm.samples)
    segment = run_segments(arm.recording.run)
    groups = np.zeros(arm.rows, int)
    model = noise_model(rows, fitted, np.zeros(len(fitted)), groups, segment, DEFAULTS).models[0]
    return at(max(time, model.time))


def _located(arm: RigidArm, low: int, high: int, numbers: slice, values: Array) -> int:
    """The first sample of `(low, high]` after a jump by some of the twists."""
    part = arm.select(np.arange(low, high + 1))
    plain = np.sum(part.residuals**2, 0)
    moved = np.sum((part.residuals + np.einsum("k,krs->rs", values, part.twists[numbers])) ** 2, 0)
    return low + 1 + int(np.argmin(np.cumsum(plain - moved)[:-1]))


def without_jump(arm: RigidArm, jump: Jump, beside_physics: bool = True) -> tuple[RigidArm, Jump]:
    """The arm with the poses after a jump where they would have been without it, fitted; and the refined jump.

    Args:
        arm: fitted.
        jump: as found.
        beside_physics: whether it is estimated beside all physics.
    """
    total = np.eye(4)
    moved = arm
    twist = small_displacement(jump.twist)
    if jump.part == "base" and jump.displacement > _LARGE_NOISE * arm.noise[0]:
        assert arm.recording.position is not None
        points = arm.rigid.tool.copy()
        points[:, :3, :3] = np.eye(3)
        parts = (slice(0, jump.sample), slice(jump.sample, None))
        before, after = (
            frames_from_poses(points[part], arm.recording.position[part], None, None, np.eye(4))[0] for part in parts
        )
        inside = np.linalg.inv(arm.T_sensor_base)
        twist = inside @ after @ np.linalg.inv(before) @ arm.T_sensor_base
    for _ in range(REFINEMENTS):
        total = twist @ total if jump.part == "tool" else total @ twist
        recording = _displaced_back(arm, moved, jump, total)
        moved = moved.with_poses(recording).fitted(MOST_FITTED)
        physics = physics_columns(moved, skip=("drift",)) if beside_physics else np.zeros((0, arm.rows, arm.samples))
        columns = np.where(np.arange(arm.samples) >= jump.sample, moved.twists[_numbers(arm, jump.part)], 0.0)
        if (more := next_step(moved, physics, columns)) is None:
            break
        twist = small_displacement(_twist(more))
    twist = np.concatenate([total[:3, 3], Rotation.from_matrix(total[:3, :3]).as_rotvec()])
    assert moved.recording.position is not None
    assert arm.recording.position is not None
    shift = np.linalg.norm(moved.recording.position - arm.recording.position, axis=1)[jump.sample :]
    return moved, jump._replace(twist=twist, displacement=float(np.sqrt(np.mean(shift**2))))


def _displaced_back(arm: RigidArm, fitted: RigidArm, jump: Jump, T: Array) -> Recording:
    """The recording with the poses after a jump by `T` displaced back."""
    recording = arm.recording
    after = np.arange(arm.samples) >= jump.sample
    R = measured_rotations(arm.recording)
    assert recording.position is not None
    position = recording.position.copy()
    turned = R
    if jump.part == "base":
        correction = fitted.T_sensor_base @ np.linalg.inv(T) @ np.linalg.inv(fitted.T_sensor_base)
        position[after] = position[after] @ correction[:3, :3].T + correction[:3, 3]
        if R is not None:
            turned = np.where(after[:, None, None], correction[:3, :3] @ R, R)
    else:
        flange = fitted.rigid.frames[-1]
        tool = fitted.T_flange_tool
        position[after] -= (flange @ T @ tool - flange @ tool)[after, :3, 3]
        if R is not None:
            turned = np.where(after[:, None, None], R @ np.linalg.inv(T @ tool)[:3, :3] @ tool[:3, :3], R)
    return replace(recording, position=position, quaternion=None if turned is None else unit_quaternions(turned))


def _best_split(projected: Projected, columns: Array, starts: Integers) -> tuple[int, float]:
    """The start from which columns, switched on there, explain most of the residual, and the squares they explain."""
    rows = projected.arm.rows
    n = projected.arm.samples
    starts = np.unique(np.concatenate([[0], starts]))
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
    observable = eigenvalues > 100 * OBSERVABLE_SHARE
    gain = np.sum(np.where(observable, pulled**2 / np.where(observable, eigenvalues, 1.0), 0.0), 1)
    gain[(starts < _MARGIN) | (starts > n - _MARGIN)] = 0.0
    k = int(np.argmax(gain))
    return int(starts[k]), float(gain[k])


def _sharp(arm: RigidArm, k: int) -> bool:
    """Tells whether a trajectory shows more of a jump at a row than at others; true where a run begins, and at rest."""
    n = arm.samples
    w = _WINDOW
    segment = run_segments(arm.recording.run)
    if arm.recording.motion == "static" or k < w or k > n - w or segment[k - 1] != segment[k]:
        return True
    steps = np.arange(w) + 0.5
    ahead = np.linalg.pinv(np.stack([np.ones(w), steps], 1))[0]  # the value at the row's near side, of a straight line
    kernel = np.concatenate([-ahead[::-1], ahead])
    jumps = np.stack([np.convolve(row, kernel[::-1], "valid") for row in arm.residuals])  # at samples w … n − w
    at = np.arange(w, n - w + 1)
    inside = segment[at - w] == segment[at + w - 1]
    jumps = jumps[:, inside]
    at = at[inside]
    spread = 1.4826 * np.median(np.abs(jumps), axis=1, keepdims=True)
    size = np.sum((jumps / np.maximum(spread, 1e-300)) ** 2, 0)
    near = np.abs(at - k) <= w
    if not near.any() or near.all():
        return False
    return bool(size[near].max() > _SHARPNESS * size[~near].max())
