"""The evidence of many recordings for one effect, what workers compute for it, and the search of the effects of a type.

No effect in any arm is the hypothesis of all. What an arm says of the numbers β of an effect beside others is a
likelihood of score b and information G. There are three ways for arms to have an effect:

| way | score and information | cost |
|---|---|---|
| mean: all share its numbers | Σ b, Σ G | |
| any: those of each arm are drawn from one prior | of each arm, with one variance | |
| one: an arm alone has it | of that arm | ln of the arms |

The evidence is that of `estimation.evidence`: of processes with one variance of all coefficients, of names with all
directions equally determined. Numbers of names have no prior: with T the χ² statistic and K directions, the likeliest
ratio of prior to information gives −½ ν ln(1 − q T / S) + ½ K ln(1 − q).

Noise that the model does not know is seen by the scatter of scores between blocks of samples: where that is larger than
the information says, the likelihood is that of so many fewer samples. Whether a term is there is decided so; not which
of two terms, as the scatter of each is known to a tenth.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NoReturn, final

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from lite6jax.array_types import Array
from lite6jax.errors import InputError
from lite6jax.estimation.evidence import best_amplitude, of_process
from lite6jax.estimation.options import EngineOptions
from lite6jax.estimation.projection import scaled_inverse
from lite6jax.estimation.thresholds import BETTER, CLOSE, CONFOUNDED, EXCHANGES, IMPOSSIBLE, LISTED, LOWEST_ORDER
from lite6jax.fleet.hierarchy import ArmLikelihoods, fitted
from lite6jax.fleet.reduced import (
    ORDER_STEP,
    SCREENED,
    RecordingEvidence,
    RecordingScan,
    ReducedArm,
    chi_squared,
    order_grid,
)
from lite6jax.fleet.terms import CUBICS, SPLINES, FleetProcess, PooledTerm, Tested, Tried
from lite6jax.workers import Workers

Way = Literal["mean", "any", "one"]
Asked = tuple[Tested, tuple[Tested, ...]]
"""A term, and those beside which it is measured."""

_ROUNDING = 1e-9
_FINER = np.linspace(-1.0, 1.0, 9)
"""Of a step of the orders that are pooled, the orders that are measured."""


@final
@dataclass(frozen=True)
class PooledEvidence:
    """What all arms say of one term.

    Attributes:
        term: which.
        evidence: of each arm, beside the others; None of an arm that does not show it.
        cost: −ln of its prior probability.
        gain: log evidence over its absence from all arms.
        likelihood: gain of the likelihood.
        scatter: of scores between blocks of samples over the information, at least 1.
        way: in which it is likeliest.
        variance: of the coefficients of a process; infinite of a name.
        rivals: its alternatives, and by how much the evidence less the cost is lower.
        nearest: of a process, the named term that explains most of it, and the share.
    """

    term: Tested
    evidence: tuple[RecordingEvidence | None, ...]
    cost: float
    gain: float = 0.0
    likelihood: float = 0.0
    scatter: float = 1.0
    way: Way = "mean"
    variance: float = np.inf
    rivals: tuple[tuple[Tested, float], ...] = ()
    nearest: tuple[PooledTerm, float] | None = None

    @property
    def net(self) -> float:
        """Log posterior odds of its presence."""
        return self.gain - self.cost

    @property
    def sure(self) -> float:
        """The same in noise of the scatter between blocks."""
        return self.net - self.likelihood * (1 - 1 / self.scatter)

    @property
    def p_value(self) -> float:
        """A bound on the probability that chance alone makes anything so likely: that of an evidence is one over it."""
        return float(min(np.exp(-self.sure), 1.0))

    def likelihoods(self, typical: Sequence[float]) -> ArmLikelihoods:
        """What the arms say, for a hierarchical model of numbers of `typical` sizes; nothing where there is no
        evidence."""
        size = len(typical)
        arms = len(self.evidence)
        score = np.zeros((arms, size))
        information = np.zeros((arms, size, size))
        for i, arm_evidence in enumerate(self.evidence):
            if arm_evidence is not None:
                score[i], information[i] = arm_evidence.score, arm_evidence.information
        return ArmLikelihoods(score, information, np.array(typical, float), self.variance)


def weigh(
    term: Tested, evidence: Sequence[RecordingEvidence | None], confounded: float, cost: float = 0.0
) -> PooledEvidence:
    """The evidence of a term over all ways, of what each arm says, None of one that does not show it.

    `cost` is −ln of its prior probability. Eigenvalues over the largest that are below `confounded` are in the model's
    span.
    """
    shown = [arm_evidence for arm_evidence in evidence if arm_evidence is not None]
    if len(shown) < 2:  # which a hierarchical model takes
        return PooledEvidence(term, tuple(evidence), cost)
    b = np.array([arm_evidence.score for arm_evidence in shown])
    G = np.array([arm_evidence.information for arm_evidence in shown])
    spread = np.sum([arm_evidence.covariance for arm_evidence in shown], 0) * scaled_inverse(G.sum(0), _ROUNDING)
    scatter = max(float(spread.sum() / chi_squared(b.sum(0), G.sum(0))[1]), 1.0)
    residual_squares = np.array([arm_evidence.left for arm_evidence in shown])
    freedom = np.array([arm_evidence.freedom for arm_evidence in shown])

    def of(score: Array, information: Array, residual_squares: float, freedom: float) -> tuple[float, float, float]:
        """Evidence, likelihood and variance of several scores `(several, number)` and their information."""
        if not isinstance(term, FleetProcess):
            statistic, size = np.sum(chi_squared(score, information), 1)
            gain = evidence_of_names(statistic, size, residual_squares, freedom)
            return float(gain), float(_log(statistic, residual_squares, freedom)), np.inf
        values, V = np.linalg.eigh(information)
        squares = (np.einsum("aij,ai->aj", V, score) ** 2).ravel()
        values = np.maximum(values.ravel(), 0.0)
        squares = np.where(values > confounded * values.max(), squares, 0.0)
        amplitude = best_amplitude(values, squares, residual_squares, freedom)
        return (
            float(amplitude.gain),
            float(amplitude.gain + amplitude.volume),
            float(amplitude.variance),
        )

    S = float(residual_squares.sum())
    v = float(freedom.sum())
    ways: list[tuple[tuple[float, float, float], Way]] = [
        (of(b.sum(0)[None], G.sum(0)[None], S, v), "mean"),
        (of(b, G, S, v), "any"),
    ]
    gain, likelihood, variance = max(
        of(*arm_sums) for arm_sums in zip(b[:, None], G[:, None], residual_squares, freedom, strict=True)
    )
    ways.append(((gain - float(np.log(len(evidence))), likelihood, variance), "one"))
    (gain, likelihood, variance), sharing = max(ways, key=lambda alternative: alternative[0])
    return PooledEvidence(
        term, tuple(evidence), cost, gain - float(np.log(len(ways))), likelihood, scatter, sharing, variance
    )


def evidence_of_names(statistic: ArrayLike, size: ArrayLike, residual_squares: float, freedom: float) -> Array:
    """The evidence of numbers without a prior at the likeliest ratio of prior to information.

    Of χ² statistics T and as many directions K, of any shape, with S left of ν degrees of freedom.
    """
    t = np.asarray(statistic) / residual_squares
    K = np.asarray(size)
    q = (freedom * t - K) / np.maximum(t * np.maximum(freedom - K, 1.0), 1e-300)
    q = np.clip(q, 0.0, 1 - 1e-9)
    return _log(q * t * residual_squares, residual_squares, freedom) + 0.5 * K * np.log1p(-q)


def _log(explained: ArrayLike, residual_squares: float, freedom: float) -> Array:
    """The gain in log-likelihood where so much of a sum of squares is explained."""
    return -0.5 * freedom * np.log1p(-np.minimum(np.asarray(explained) / residual_squares, 1 - 1e-12))


# ------------------------------------------------------------------ a search's scan


def screen(
    scans: Iterable[RecordingScan], confounded: float
) -> tuple[dict[str, list[RecordingEvidence | None]], dict[str, Array]]:
    """What all recordings say of all that is tested.

    Of processes that are others in each arm it is approximate: F. Satterthwaite's equal directions (Biometrics Bulletin
    2, 1946).

    Returns:
        of each candidate by its key what each arm says; and by the keys of `RecordingScan.groups`, the evidence of each
        group `(group,)`.
    """
    candidate_evidence = dict[str, list[RecordingEvidence | None]]()
    total = dict[str, list[Array]]()
    alone = dict[str, Array]()
    arms = 0
    S = 0.0
    v = 0.0
    for scan in scans:
        for key in {**candidate_evidence, **scan.named}:
            candidate_evidence.setdefault(key, [None] * arms).append(scan.named.get(key))
        for key, screened in scan.groups.items():
            arm_gain = _evidence_of_sums(screened.sums, scan.left, scan.freedom)
            total[key] = [a + b for a, b in zip(total[key], screened, strict=True)] if key in total else list(screened)
            alone[key] = np.maximum(alone.get(key, 0.0), arm_gain)
        arms = arms + 1
        S = S + scan.left
        v = v + scan.freedom
    group_evidence = dict[str, Array]()
    for key, (score, information, sums) in total.items():
        if key in SCREENED:
            means = [of_process(score @ R, R.T @ information @ R, S, v, confounded).gain for R in SCREENED[key]]
        else:
            means = [evidence_of_names(*chi_squared(score, information), S, v)]
        group_evidence[key] = np.max([*means, _evidence_of_sums(sums, S, v), alone[key] - np.log(arms)], 0)
    return candidate_evidence, group_evidence


def _evidence_of_sums(sums: Array, residual_squares: float, freedom: float) -> Array:
    """By `Screened.sums`, `(group,)`: that of as many equal directions."""
    square, trace, of_square = sums
    scale = trace / np.maximum(of_square, 1e-300)
    return np.max(evidence_of_names(square * scale, trace * scale, residual_squares, freedom), 1)


# ------------------------------------------------------------------ workers


@final
class Reduced:
    """The reduced recordings of a run, and the workers that compute with them.

    Each recording is a task of its own, computed by one thread: numbers do not depend on workers and their number.
    """

    def __init__(self, stored: Sequence[Path], options: EngineOptions, workers: Workers) -> None:
        """The files of `ReducedArm.to_bytes`, thresholds, and workers that are started; computes nothing."""
        self._stored = tuple(stored)
        self.options = options
        self._workers = workers

    def scans(self, beside: Sequence[Tested], candidate_terms: Tried) -> Iterator[RecordingScan]:
        """What each recording says of all that is tested, beside some terms, in order."""
        return self._answers(
            scan_beside, self.options, tuple(beside), (*candidate_terms.singles, *candidate_terms.pairs)
        )

    def evidence(self, requests: Sequence[Asked]) -> list[list[RecordingEvidence | None]]:
        """For each recording, what it says of each term that is asked for."""
        return list(self._answers(measure, tuple(requests)))

    def _answers(self, question: Callable[..., Any], *arguments: Any) -> Iterator[Any]:
        """What `question(recording, *arguments)` gives of each recording, in order."""
        batches = ((number, [path.read_bytes()]) for number, path in enumerate(self._stored))
        waiting: dict[int, Any] = {}
        following = 0
        for number, result in self._workers.outcomes(answer, batches, (question, *arguments), died=_died):
            waiting[number] = result
            while following in waiting:
                yield waiting.pop(following)
                following += 1


def _died(stored: bytes) -> NoReturn:
    raise InputError(f"a process that read {len(stored)} bytes was ended; free memory, or give --processes 1")


@threadpool_limits.wrap(limits=1, user_api="blas")
def answer(stored: Sequence[bytes], question: Callable[..., Any], *arguments: Any) -> Any:
    """What a question gives of one recording."""
    (arm_bytes,) = stored
    return question(ReducedArm.from_bytes(arm_bytes), *arguments)


def scan_beside(
    arm: ReducedArm, options: EngineOptions, beside: tuple[Tested, ...], processes: tuple[FleetProcess, ...]
) -> RecordingScan:
    """The `RecordingScan` of one recording beside some terms."""
    return arm.beside(beside).scan(processes, options)


def measure(arm: ReducedArm, requests: tuple[Asked, ...]) -> list[RecordingEvidence | None]:
    """What one recording says of each term that is asked for."""
    arm_beside = {beside: arm.beside(beside) for beside in {beside for _, beside in requests}}
    return [arm_beside[beside].evidence(term) for term, beside in requests]


# ------------------------------------------------------------------ the search


_MOST_EFFECTS = 16
"""Most effects that a type is found to have: twice those of one recording."""
_LINES = 3
"""Sites whose best order is measured in every arm before one is added, as a line is narrow."""
_PROCESSES = 6
"""Processes whose kernels are measured in every arm: twice the sites, as drivers differ."""
_SAME_LINE = 0.5
"""Orders within which two waves are one line: a line's width over two turns."""


@final
class Search:
    """Which effects the arms of a type have, by evidence, as in the search of one recording.

    It does not share `search.select.Selector`, most steps of which refit a model, choose its noise anew or treat rows
    apart: a reduced recording has linear terms and one noise. Kernels are estimated anew by exchanges.

    1. Add the term whose evidence over all arms most exceeds the cost of its choice, if by a margin.
    2. Drop the term that is least worth its cost beside the others, as long as one is not.
    3. Where nothing more is worth adding, exchange a term, or all of a site, for whatever is likelier in its place.
    """

    def __init__(
        self, reduced: Reduced, candidate_terms: Tried, progress: Callable[[int], object] = lambda effects: None
    ) -> None:
        """Computes nothing; `progress` is called with the number of effects at each round."""
        self._reduced = reduced
        self._tried = candidate_terms
        self._progress = progress
        self._options = reduced.options
        self._least = -float(np.log(reduced.options.level))
        self._known: dict[frozenset[Tested], list[PooledEvidence]] = {}

    def selected(self) -> list[PooledEvidence]:
        """The effects, in the order in which they were found, each with its alternatives."""
        terms = self._grown([])
        for _ in range(EXCHANGES):
            better = self._exchanged(terms)
            if better is None:
                break
            terms = self._grown(better)
        return [
            self._reviewed(weighed, [term for term in terms if term != weighed.term])
            for weighed in self._beside_others(terms)
        ]

    def _grown(self, terms: list[Tested]) -> list[Tested]:
        considered = set[Tested]()
        while len(terms) < _MOST_EFFECTS:
            self._progress(len(terms))
            significant = (
                weighed
                for weighed in self._ranked(terms)
                if weighed.term not in considered and weighed.sure >= self._least
            )
            more = next(significant, None)
            if more is None:
                break
            considered.add(more.term)
            terms = self._dropped([*terms, more.term])
        return terms

    def _dropped(self, terms: list[Tested]) -> list[Tested]:
        """Without those that are not worth their cost beside the others, the least of them first."""
        while terms:
            worst = min(self._beside_others(terms), key=lambda weighed: weighed.sure)
            if worst.sure >= self._least:
                break
            terms = [term for term in terms if term != worst.term]
        return terms

    def _exchanged(self, terms: list[Tested]) -> list[Tested] | None:
        """With another term in the place of one, or of all of a site, that is likelier; None where none is."""
        site_of = {term: self._tried.candidate(term).site for term in terms}
        sites = [[term for term in terms if site_of[term] == site] for site in dict.fromkeys(site_of.values())]
        for replaced in (*([term] for term in terms), *(site_terms for site_terms in sites if len(site_terms) > 1)):
            remaining_terms = [term for term in terms if term not in replaced]
            replaced_net = sum(
                weighed.net
                for weighed in self._measured(
                    [(term, (*remaining_terms, *replaced[:k])) for k, term in enumerate(replaced)]
                )
            )
            replacement = next(iter(self._ranked(remaining_terms)), None)
            if (
                replacement is not None
                and replacement.term not in replaced
                and replacement.net >= replaced_net + BETTER
            ):
                return self._dropped([*remaining_terms, replacement.term])
        return None

    def _reviewed(self, weighed: PooledEvidence, other_terms: list[Tested]) -> PooledEvidence:
        """With its rivals, and of a process the nearest name."""
        rivals = [rival for rival in self._ranked(other_terms) if not _is_same(rival.term, weighed.term, _SAME_LINE)]
        gaps = [(rival.term, max(weighed.net - rival.net, 0.0)) for rival in rivals[:LISTED]]
        named_rivals = [(rival.likelihood, rival.term) for rival in rivals if isinstance(rival.term, PooledTerm)]
        nearest = None
        if isinstance(weighed.term, FleetProcess) and named_rivals:
            likelihood, term = max(named_rivals, key=lambda pair: pair[0])
            nearest = term, float(np.clip(likelihood / weighed.likelihood, 0.0, 1.0))
        return replace(weighed, rivals=tuple(pair for pair in gaps if pair[1] < CLOSE), nearest=nearest)

    # -------------------------------------------------------------- what is likeliest

    def _ranked(self, beside: Sequence[Tested]) -> list[PooledEvidence]:
        """All that is likely and possible beside some terms, the likeliest first; of processes the likeliest kernel."""
        key = frozenset(beside)
        if key not in self._known:
            candidate_evidence, groups = screen(self._reduced.scans(beside, self._tried), CONFOUNDED)
            requests = [(term, tuple(beside)) for term in (*self._lines(groups, beside), *self._processes(groups))]
            weighed_terms = [
                *(self._weighed(PooledTerm(name), evidence) for name, evidence in candidate_evidence.items()),
                *self._measured(requests),
            ]
            likeliest_by_key: dict[str, PooledEvidence] = {}
            for weighed in sorted(weighed_terms, key=lambda weighed: -weighed.net):
                if weighed.gain > 0 and self._is_possible(weighed):
                    likeliest_by_key.setdefault(weighed.term.key, weighed)
            self._known[key] = list(likeliest_by_key.values())
        return self._known[key]

    def _lines(self, groups: Mapping[str, Array], beside: Sequence[Tested]) -> list[Tested]:
        """Waves near the likeliest order of each family, of the likeliest families."""
        orders = order_grid(self._options)
        lines = []
        for key in self._tried.families:
            net = groups[key] - self._tried.cost_of_waves(orders)
            for term in beside:
                if isinstance(term, PooledTerm) and term.key == key and term.order is not None:
                    net[np.abs(orders - term.order) < _SAME_LINE] = -np.inf
            lines.append((float(net.max()), key, float(orders[np.argmax(net)])))
        waves: list[Tested] = []
        for net, key, order in sorted(lines, reverse=True)[:_LINES]:
            near = order + ORDER_STEP * _FINER if net > 0 else np.zeros(0)
            likely = {max(round(order), 1.0), *near[near >= LOWEST_ORDER].tolist()}
            waves += [PooledTerm(key, float(wave_order)) for wave_order in sorted(likely)] if net > 0 else []
        return waves

    def _processes(self, groups: Mapping[str, Array]) -> list[Tested]:
        """Processes of the likeliest quantities and pairs of them, with every kernel."""
        screened = zip((*self._tried.singles, *self._tried.pairs), (*groups[SPLINES], *groups[CUBICS]), strict=True)
        nets = [(gain - self._tried.cost(process), process) for process, gain in screened]
        close = [pair for pair in nets if pair[0] > self._least - CLOSE]
        likely = sorted(close, key=lambda pair: -pair[0])[:_PROCESSES]
        return [kernel for _, process in likely for kernel in self._tried.with_every_kernel(process)]

    # -------------------------------------------------------------- measured in every arm

    def _beside_others(self, terms: Sequence[Tested]) -> list[PooledEvidence]:
        return self._measured(
            [(term, tuple(other_term for other_term in terms if other_term != term)) for term in terms]
        )

    def _measured(self, requests: Sequence[Asked]) -> list[PooledEvidence]:
        columns = ()
        if requests:
            columns = zip(*self._reduced.evidence(requests), strict=True)
        return [self._weighed(term, column) for (term, _), column in zip(requests, columns, strict=True)]

    def _weighed(self, term: Tested, evidence: Sequence[RecordingEvidence | None]) -> PooledEvidence:
        return weigh(term, evidence, CONFOUNDED, self._tried.cost(term))

    def _is_possible(self, weighed: PooledEvidence) -> bool:
        """Tells whether the mean is not far outside what the named effect can be, as far as that matters."""
        candidate = self._tried.candidate(weighed.term)
        lower = np.array(candidate.lower)
        upper = np.array(candidate.upper)
        if weighed.net < 0 or np.isinf([lower, upper]).all():
            return True
        hierarchy = fitted(weighed.likelihoods(candidate.typical))
        assert hierarchy is not None  # what too few arms show has no evidence
        limit = IMPOSSIBLE * np.hypot(hierarchy.std, hierarchy.between)
        mean = hierarchy.mean
        return bool(((mean > lower - limit) & (mean < upper + limit)).all())


def _is_same(first: Tested, second: Tested, width: float) -> bool:
    """Tells whether two terms are one, or waves that are one line, or processes of the same drivers."""
    orders = [term.order for term in (first, second) if isinstance(term, PooledTerm) and term.order is not None]
    return first.key == second.key and (len(orders) < 2 or abs(orders[0] - orders[1]) < width)
