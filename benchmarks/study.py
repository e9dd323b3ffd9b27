"""What poses determine and which to record: the library against NumPy."""

from collections.abc import Iterator

import numpy as np

from benchmarks.measure import Record, disagreement, median_time, timed
from benchmarks.problem import NOISE
from benchmarks.seed_way import NOMINAL, sample_joints
from lite6jax.design.information import TOLERANCE, Experiment, plan_experiment
from lite6jax.design.poses import Criterion, Design, Pool, choose
from lite6jax.design.sensor import Sensor
from tests.oracles.chains import seed_poses

OURS, NUMPY = "lite6jax", "NumPy, finite differences"
LIMIT = "limit"
GREEDY = "NumPy, exchange over all candidates"
STEP = 1e-6
"""m and rad of the rival's forward differences."""
DIFFERENCES = 1e-4
"""How near forward differences come to a derivative, relative."""


def study(poses: int = 100_000, chosen: int = 40) -> Iterator[Record]:
    """Information and singular values, and a design."""
    experiment = plan_experiment("lite6", Sensor("pose", *NOISE), frame=False)
    q = sample_joints(poses, np.random.default_rng(0))
    yield from _information(experiment, q)
    yield from _design(experiment, q, chosen)


def _information(experiment: Experiment, q: np.ndarray) -> Iterator[Record]:
    work, metric = f"information of {len(q)} poses", "information and singular values"

    def ours() -> np.ndarray:
        return np.linalg.svd(experiment.root(q), compute_uv=False)

    first, _ = timed(ours)
    seconds, answer = median_time(ours, 5)
    taken, theirs = timed(lambda: np.linalg.svd(np.linalg.qr(plain_rows(q), mode="r"), compute_uv=False))
    wrong = disagreement(answer / theirs, np.ones_like(theirs), DIFFERENCES, "singular values")
    yield Record(work, OURS, "first call, with compilation", 1e3 * first, "ms", "lower", wrong)
    yield Record(work, OURS, metric, 1e3 * seconds, "ms", "lower", wrong)
    yield Record(work, NUMPY, metric, 1e3 * taken, "ms", "lower")
    yield Record(work, OURS, f"faster than {NUMPY}", taken / seconds, "×", "higher", wrong)
    J = experiment.rows(q).reshape(-1, experiment.size)
    floor, _ = median_time(lambda: J.T @ J, 5)
    yield Record(work, LIMIT, "JᵀJ at GEMM speed", 1e3 * floor, "ms", "lower")


def _design(experiment: Experiment, q: np.ndarray, count: int) -> Iterator[Record]:
    rows = experiment.rows(q)
    work = f"{count} of {len(q)} poses"

    def ours_of() -> Design:
        pool = Pool(rows)
        return choose(pool, count, pool.apply(Criterion()))

    first, _ = timed(ours_of)
    seconds, design = median_time(ours_of, 3)
    taken, rival = timed(lambda: plain_exchange(rows, count))
    ours, theirs = log_determinant(rows[design.indices]), log_determinant(rows[rival])
    wrong = disagreement(design.values[-1], np.array(ours), 1e-6, "the criterion")
    if ours < theirs - 0.01 * rows.shape[2]:  # 1 % of the poses
        wrong = wrong or f"log det {ours:.4f} is under the rival's {theirs:.4f}"
    yield Record(work, OURS, "first call, with compilation", first, "s", "lower", wrong)
    yield Record(work, OURS, "D-optimal design", seconds, "s", "lower", wrong)
    yield Record(work, GREEDY, "D-optimal design", taken, "s", "lower")
    yield Record(work, OURS, f"faster than {GREEDY}", taken / seconds, "×", "higher", wrong)
    random = np.random.default_rng(1)
    drawn = [log_determinant(rows[random.choice(len(q), count, replace=False)]) for _ in range(200)]
    gain = np.exp((ours - np.median(drawn)) / rows.shape[2])
    yield Record(work, OURS, "worth so many times as many random poses", float(gain), "×", "higher", wrong)


def plain_rows(q: np.ndarray) -> np.ndarray:
    """The same scaled, whitened Jacobian `(6 sample, 28)` by forward differences of the plain chain."""
    at = seed_poses(NOMINAL, q)
    units = np.array([TOLERANCE[unit] for unit in plan_experiment("lite6", frame=False).form.units])
    columns = []
    for step in STEP * np.eye(len(NOMINAL)):
        moved = seed_poses(NOMINAL + step, q)
        turned = moved[:, :3, :3] @ np.swapaxes(at[:, :3, :3], 1, 2)
        spin = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], 1)
        columns.append(np.concatenate([(moved - at)[:, :3, 3] / NOISE[0], spin / NOISE[1]], 1).ravel() / STEP)
    return np.stack(columns, 1) * units


def log_determinant(rows: np.ndarray) -> float:
    """Of the information of poses `(pose, row, parameter)`."""
    J = rows.reshape(-1, rows.shape[2])
    return float(np.linalg.slogdet(J.T @ J)[1])


def plain_exchange(rows: np.ndarray, count: int, rounds: int = 1) -> np.ndarray:
    """D-optimal poses `(count,)` by the textbook: greedy, then one round of exchange, each over all candidates.

    Adding a pose multiplies the determinant by det(I + J M⁻¹ Jᵀ) (V. Fedorov, 1972).
    """

    def best(M: np.ndarray, taken: list[int]) -> int:
        inside = rows @ np.linalg.inv(M) @ np.swapaxes(rows, 1, 2)
        gain = np.linalg.slogdet(np.eye(rows.shape[1]) + inside)[1]
        gain[taken] = -np.inf
        return int(np.argmax(gain))

    chosen: list[int] = []
    M = 1e-6 * np.eye(rows.shape[2])
    for _ in range(count):
        chosen.append(best(M, chosen))
        M = M + rows[chosen[-1]].T @ rows[chosen[-1]]
    for _ in range(rounds):
        for k in range(count):
            without = M - rows[chosen[k]].T @ rows[chosen[k]]
            chosen[k] = best(without, chosen[:k] + chosen[k + 1 :])
            M = without + rows[chosen[k]].T @ rows[chosen[k]]
    return np.array(chosen)
