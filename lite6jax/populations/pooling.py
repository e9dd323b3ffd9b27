"""The evidence of many recordings for one effect, and what workers compute for it.

No effect in any arm is the hypothesis of all. What an arm says of the numbers β of an effect beside others is a
likelihood of score b and information G. There are four ways for arms to have an effect:

| way | score and information | cost |
|---|---|---|
| mean: all share its numbers | Σ b, Σ G | |
| any: those of each arm are drawn from one prior | of each arm, with one variance | |
| one: an arm alone has it | of that arm | ln of the arms |
| drift: its numbers change with a covariate x | of the slope beside the mean | |

The evidence is that of `estimation.evidence`: of processes with one variance of all coefficients, of names with all
directions equally determined. Numbers of names have no prior: with T the χ² statistic and K directions, the likeliest
ratio of prior to information gives −½ ν ln(1 − q T / S) + ½ K ln(1 − q).

Noise that the model does not know is seen by the scatter of scores between blocks of samples: where that is larger than
the information says, the sum of squares S is so much larger.
"""

import pickle
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from lite6jax.distribution.batches import Workers
from lite6jax.effects import kernels
from lite6jax.errors import InputError
from lite6jax.estimation.evidence import best_amplitude, of_process
from lite6jax.populations.files import from_bytes
from lite6jax.populations.hierarchy import ArmLikelihoods
from lite6jax.populations.options import PoolingOptions
from lite6jax.populations.reduced import SCREENED, Evidence, ReducedArm, Scan
from lite6jax.populations.terms import Groups, Process, Tested

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.floating]
Way = Literal["mean", "any", "one", "drift"]
Asked = tuple[Tested, tuple[Tested, ...]]
"""A term, and those beside which it is measured."""

_ROUNDING = 1e-9


# ------------------------------------------------------------------ evidence


class Weighed(NamedTuple):
    """What all arms say of one effect.

    Attributes:
        gain: log evidence over its absence from all arms.
        likelihood: gain of the likelihood, of which the evidence is less.
        way: in which it is likeliest.
        variance: of the coefficients of a process; infinite of a name.
    """

    gain: float
    likelihood: float
    way: Way
    variance: float


def weigh(term: Tested, evidence: Sequence[Evidence | None], covariate: Array | None, confounded: float) -> Weighed:
    """The evidence of a term, over all ways.

    Args:
        term: which.
        evidence: of each arm; None of an arm that does not show it.
        covariate: `(arm,)`, what effects may drift with, or None.
        confounded: eigenvalue over the largest below which a direction is in the model's span.
    """
    at = [arm for arm, one in enumerate(evidence) if one is not None]
    shown = [one for one in evidence if one is not None]
    if len(shown) < (2 if covariate is None else 3):  # which a hierarchical model takes
        return Weighed(0.0, 0.0, "mean", np.inf)
    b, G = np.array([one.score for one in shown]), np.array([one.information for one in shown])
    total, information, process = b.sum(0), G.sum(0), isinstance(term, Process)
    T = whitening(information)
    scatter = np.trace(T.T @ np.sum([one.covariance for one in shown], 0) @ T) / max(T.shape[1], 1)
    scatter = max(float(scatter), 1.0)
    left, freedom = (np.array([getattr(one, name) for one in shown]) for name in ("left", "freedom"))

    def of(pairs: Sequence[tuple[Array, Array]], left: float, freedom: float) -> tuple[float, float, float]:
        """Evidence, likelihood and variance of several scores and their information."""
        if not process:
            statistic, size = np.sum([_form(*pair) for pair in pairs], 0)
            gain = float(evidence_of_names(statistic, size, left * scatter, freedom))
            return gain, float(_log(statistic, left * scatter, freedom)), np.inf
        each = [np.linalg.eigh(own) for _, own in pairs]
        squares = [(V.T @ score) ** 2 for (score, _), (_, V) in zip(pairs, each, strict=True)]
        values = np.maximum(np.concatenate([values for values, _ in each]), 0.0)
        kept = values > confounded * values.max()
        found = best_amplitude(values, np.where(kept, np.concatenate(squares), 0.0), left * scatter, freedom)
        return float(found.gain), float(found.gain + found.volume), float(found.variance)

    arms, S, v = list(zip(b, G, strict=True)), float(left.sum()), float(freedom.sum())
    ways: list[tuple[tuple[float, float, float], Way]] = [
        (of([(total, information)], S, v), "mean"),
        (of(arms, S, v), "any"),
    ]
    gain, *rest = max(of([arm], *own) for arm, *own in zip(arms, left, freedom, strict=True))
    ways.append(((gain - float(np.log(len(evidence))), *rest), "one"))
    if covariate is not None:
        ways.append((of([slope(b, G, covariate[at])], S, v), "drift"))
    (gain, likelihood, variance), way = max(ways, key=lambda one: one[0])
    return Weighed(gain - float(np.log(len(ways))), likelihood, way, variance)


def evidence_of_names(statistic: ArrayLike, size: ArrayLike, left: float, freedom: float) -> Array:
    """The evidence of numbers without a prior at the likeliest ratio of prior to information.

    Args:
        statistic: χ², of any shape.
        size: directions, likewise.
        left: S.
        freedom: ν.
    """
    t, K = np.asarray(statistic) / left, np.asarray(size)
    q = (freedom * t - K) / np.maximum(t * np.maximum(freedom - K, 1.0), 1e-300)
    q = np.clip(q, 0.0, 1 - 1e-9)
    return _log(q * t * left, left, freedom) + 0.5 * K * np.log1p(-q)


def _log(explained: ArrayLike, left: float, freedom: float) -> Array:
    """The gain in log-likelihood where so much of a sum of squares is explained."""
    return -0.5 * freedom * np.log1p(-np.minimum(np.asarray(explained) / left, 1 - 1e-12))


def slope(b: Array, G: Array, x: Array) -> tuple[Array, Array]:
    """Score and information of a slope over a covariate, beside the mean.

    Args:
        b: `(arm, number)`.
        G: `(arm, number, number)`.
        x: `(arm,)`.
    """
    whole, first, second = (np.tensordot(x**k, G, 1) for k in range(3))
    centre = first @ np.linalg.pinv(whole, hermitian=True)
    own = second - centre @ first
    # what one arm alone shows has no slope
    own[np.abs(own) < _ROUNDING * np.abs(second).max(initial=0.0)] = 0.0
    return x @ b - centre @ b.sum(0), own


def likelihoods(
    evidence: Sequence[Evidence | None], typical: Sequence[float], x: Array | None, variance: float
) -> ArmLikelihoods:
    """What the arms say of one effect, for its hierarchical model; nothing where there is no evidence.

    Args:
        evidence: of all arms.
        typical: sizes of its numbers.
        x: `(arm,)`, the covariate, or None.
        variance: of the mean's prior.
    """
    size = len(typical)
    score, information = np.zeros((len(evidence), size)), np.zeros((len(evidence), size, size))
    for i, one in enumerate(evidence):
        if one is not None:
            score[i], information[i] = one.score, one.information
    ones = np.ones(len(evidence))
    design = ones[:, None] if x is None else np.stack([ones, x], 1)
    return ArmLikelihoods(score, information, np.array(typical, float), design, variance)


def whitening(G: Array) -> Array:
    """T with TᵀGT the identity of the rank of G."""
    root = np.sqrt(np.maximum(np.diagonal(G), np.finfo(float).tiny))
    eigenvalues, V = np.linalg.eigh(G / np.outer(root, root))
    kept = eigenvalues > _ROUNDING
    return V[:, kept] / np.sqrt(eigenvalues[kept]) / root[:, None]


def _form(b: Array, G: Array) -> tuple[float, int]:
    """bᵀ G⁺ b, and the rank of G."""
    T = whitening(G)
    return float(np.sum((T.T @ b) ** 2)), T.shape[1]


# ------------------------------------------------------------------ a search's scan


@final
@dataclass(frozen=True, eq=False)
class Pool:
    """What all arms say of all that is tested.

    Attributes:
        named: of each candidate by its key, the evidence of each arm.
        waves: by the key of each family, the evidence at each order of `order_grid`.
        singles, pairs: the evidence `(group,)` of the likeliest kernel of those by which processes are screened.
    """

    named: dict[str, list[Evidence | None]]
    waves: dict[str, Array]
    singles: Array
    pairs: Array


def pool(scans: Iterator[Scan], confounded: float) -> Pool:
    """Adds what all recordings say.

    Args:
        scans: of the arms.
        confounded: eigenvalue over the largest below which a direction is in the model's span.
    """
    named, waves, groups = dict[str, list[Evidence | None]](), dict[str, _Waves](), list[_Groups]()
    arms, S, v = 0, 0.0, 0.0
    for scan in scans:
        for key in {**named, **scan.named}:
            named.setdefault(key, [None] * arms).append(scan.named.get(key))
        for key, (score, information) in scan.waves.items():
            waves.setdefault(key, _Waves(len(score))).add(score, information, scan)
        groups = groups or [_Groups(scan.singles), _Groups(scan.pairs)]
        for group, one in zip(groups, (scan.singles, scan.pairs), strict=True):
            group.add(one)
        arms, S, v = arms + 1, S + scan.left, v + scan.freedom
    singles, pairs = groups
    return Pool(
        named,
        {key: each.evidence(S, v, arms) for key, each in waves.items()},
        singles.evidence([kernels.root(name) for name in SCREENED], S, v, arms, confounded),
        pairs.evidence([np.eye(pairs.score.shape[1])], S, v, arms, confounded),
    )


class _Waves:
    """Sums over arms of what the evidence of the waves of one family needs, at every order."""

    def __init__(self, orders: int) -> None:
        self.score, self.information = np.zeros((orders, 2)), np.zeros((orders, 3))
        self.statistic, self.size, self.alone = np.zeros((3, orders))

    def add(self, score: Array, information: Array, scan: Scan) -> None:
        self.score += score
        self.information += information
        own, size = _forms(score, information), 2 * information.any(1)
        self.statistic += own
        self.size += size
        self.alone = np.maximum(self.alone, evidence_of_names(own, size, scan.left, scan.freedom))

    def evidence(self, left: float, freedom: float, arms: int) -> Array:
        size = 2 * self.information.any(1)
        mean = evidence_of_names(_forms(self.score, self.information), size, left, freedom)
        any_arm = evidence_of_names(self.statistic, self.size, left, freedom)
        return np.max([mean, any_arm, self.alone - np.log(arms)], 0)


class _Groups:
    """Sums over arms of what the evidence of processes needs."""

    def __init__(self, like: Any) -> None:
        self.score, self.information, self.explained, self.volume = (np.zeros_like(part) for part in like[:4])
        self.alone = np.zeros(len(self.score))

    def add(self, one: Any) -> None:
        for mine, theirs in zip((self.score, self.information, self.explained, self.volume), one[:4], strict=True):
            mine += theirs
        self.alone = np.maximum(self.alone, one.alone)

    def evidence(self, roots: Sequence[Array], left: float, freedom: float, arms: int, confounded: float) -> Array:
        found = [self.alone - np.log(arms)]
        if len(self.score):
            found.append(np.max(_log(self.explained, left, freedom) - self.volume, (1, 2)))
        for R in roots if len(self.score) else ():
            found.append(of_process(self.score @ R, R.T @ self.information @ R, left, freedom, confounded).gain)
        return np.max(found, 0)


def _forms(score: Array, packed: Array) -> Array:
    """bᵀ G⁻¹ b of many pairs of waves; zero where G is singular."""
    (s, c), (ss, sc, cc) = score.T, packed.T
    determinant = ss * cc - sc**2
    regular = determinant > _ROUNDING * ss * cc
    return np.where(regular, (cc * s**2 - 2 * sc * s * c + ss * c**2) / np.where(regular, determinant, 1.0), 0.0)


# ------------------------------------------------------------------ workers


@final
class Reduced:
    """The reduced recordings of a run, and the workers that compute with them.

    Each recording is a task of its own, computed by one thread: numbers do not depend on workers and their number.
    """

    def __init__(self, stored: Sequence[Path], options: PoolingOptions, workers: Workers) -> None:
        """Computes nothing.

        Args:
            stored: paths of files of `files.to_bytes`.
            options: thresholds.
            workers: that compute, started.
        """
        self._stored, self.options, self._workers = tuple(stored), options, workers

    def __len__(self) -> int:
        return len(self._stored)

    def scans(self, beside: Sequence[Tested], groups: Groups) -> Iterator[Scan]:
        """What each recording says of all that is tested, beside some terms, in order."""
        return self._found(scanned, (tuple(beside), groups, self.options))

    def evidence(self, asked: Sequence[Asked]) -> list[list[Evidence | None]]:
        """For each recording, what it says of each term that is asked for."""
        return list(self._found(measured, (tuple(asked), self.options)))

    def _found(self, function: Any, given: tuple[Any, ...]) -> Iterator[Any]:
        batches = ((number, [path.read_bytes()]) for number, path in enumerate(self._stored))
        waiting: dict[int, pa.Table] = {}
        following = 0
        for number, rows in self._workers.outcomes(function, batches, given, died=_died):
            waiting[number] = rows
            while following in waiting:
                yield pickle.loads(waiting.pop(following)["found"][0].as_py())
                following += 1


def _died(stored: bytes) -> "pa.Table":
    raise InputError(f"a process that read {len(stored)} bytes was ended; free memory, or give --processes 1")


@threadpool_limits.wrap(limits=1, user_api="blas")
def scanned(
    stored: Sequence[bytes], beside: tuple[Tested, ...], groups: Groups, options: PoolingOptions
) -> "pa.Table":
    """The `Scan` of one recording beside some terms, as a table of one row."""
    (one,) = stored
    return _row(from_bytes(one).beside(beside, options).scan(groups, options))


@threadpool_limits.wrap(limits=1, user_api="blas")
def measured(stored: Sequence[bytes], asked: tuple[Asked, ...], options: PoolingOptions) -> "pa.Table":
    """What one recording says of each term that is asked for, as a table of one row."""
    (one,) = stored
    arm, known, found = from_bytes(one), dict[tuple[Tested, ...], ReducedArm](), list[Evidence | None]()
    for term, beside in asked:
        if beside not in known:
            known[beside] = arm.beside(beside, options)
        found.append(known[beside].evidence(term, options))
    return _row(found)


def _row(found: Any) -> "pa.Table":
    import pyarrow as pa

    return pa.table({"found": pa.array([pickle.dumps(found)], pa.binary())})
