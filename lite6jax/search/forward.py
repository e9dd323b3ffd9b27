"""Which effects, together, a recording asks for: added while what is left holds more, taken away where not needed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from lite6jax.domains.pose.clock import clock_offset
from lite6jax.domains.pose.problem import Case, moved_to
from lite6jax.effects.catalogue import Untestable, catalogue, untestable
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.effects.kinematic.surroundings import TimeOffset
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.least_squares import Fitted, refit, without
from lite6jax.estimation.noise import WHITE
from lite6jax.estimation.score_test import Score, chance, evidence_of
from lite6jax.search.backward import CLOSE, SEARCHED, Rival, Step, assured, cost, most_specific, pruned, sure
from lite6jax.search.curves import TRIED, Shape, shapes
from lite6jax.search.shrinkage import sweep, waves_of
from lite6jax.search.spectrum import lines

Array = NDArray[np.floating]

LEVEL = 0.003
"""Family-wise: of 300 recordings with nothing missing, one may show something."""
MOST = 8
_RELINEARISED = 3
_REFITTED = 4
_NEAREST = 3
"""Named effects said beside a curve without a name."""
_DOUBTFUL = 3
"""Additions in a row that nothing makes sure yet."""
_ROWS = 2000
"""That a search looks at to begin with."""
_CURVES = 3
_SEVERAL = 3
"""Effects of which some may stand in for another set."""
_EXCHANGED = 2
_MANY = 3
"""Harmonics of one joint that together have no name."""


@dataclass(frozen=True, eq=False)
class Selection:
    """The physics that a recording asks for.

    Attributes:
        case: linearised where its geometry, and its clock, is.
        plain: the same with a clock that is right, which `baseline` was fitted to.
        baseline: the nuisance alone.
        fitted: with the effects.
        steps: one an effect, in the order of `fitted.physics`.
        candidates: what was tried.
        hidden: those of them that the nuisance hides.
        nearest: the candidate that is least likely chance beside them, and how likely that is, family-wise.
    """

    case: Case
    plain: Case
    baseline: Fitted
    fitted: Fitted
    steps: tuple[Step, ...]
    candidates: tuple[Effect, ...]
    hidden: tuple[Effect, ...] = ()
    nearest: tuple[Effect, float] | None = None


@dataclass(frozen=True, eq=False)
class Search:
    """The search of one case, with the same candidates for every part of its rows.

    Attributes:
        case: linearised where its geometry, and its clock, is.
        plain: the same with a clock that is right.
        start: `(unknown,)` where fits of the nuisance start.
        candidates: named effects, those that the recording can show.
        missing: those that it cannot.
        level: family-wise, of a false finding.
    """

    case: Case
    plain: Case
    start: Array
    candidates: tuple[Effect, ...]
    missing: tuple[Untestable, ...]
    level: float

    @cached_property
    def tried(self) -> float:
        """How many independent candidates, for the family-wise level."""
        return len(self.candidates) + self.case.motion.dof * (SEARCHED + TRIED)

    def run(self, used: NDArray[np.bool_] | None = None) -> Selection:
        """Selects on some rows; all where not given.

        Of very many rows, a part finds the physics; then all of them are fitted, and asked for what is still left. What
        might be there instead, or was beside it, is only looked for in all rows.
        """
        whole = used is None
        used = self.case.seen if used is None else used & self.case.seen
        every = max(int(used.sum()) // _ROWS, 1)
        if every == 1:
            selection = self._selected(used, whole)
        else:
            thin = replace(self, case=self.case.thinned(every), plain=self.plain.thinned(every))
            part = thin._selected(used[::every], whole)
            physics, values = part.fitted.physics, part.fitted.values
            baseline = refit(self.plain, Physics(), moved=self.start, used=used)
            fitted = refit(self.case, physics, values, part.fitted.moved, used) if physics.effects else baseline
            fitted, steps = sure(self.case, *self._added(fitted, list(part.steps)), self.tried, self.level)
            selection = replace(
                part, case=self.case, plain=self.plain, baseline=baseline, fitted=fitted, steps=tuple(steps)
            )
        if not any(isinstance(step.effect, Unnamed) and step.effect.spread for step in selection.steps):  # not swept
            fitted, steps = self._assured(selection.fitted, list(selection.steps))
            selection = replace(selection, fitted=fitted, steps=tuple(steps))
        return self._reviewed(selection) if whole else selection

    def _selected(self, used: NDArray[np.bool_], exchanging: bool) -> Selection:
        baseline = refit(self.plain, Physics(), moved=self.start, used=used)
        added = self._added(*self._clocked(baseline))
        fitted, steps = sure(self.case, *added, self.tried, self.level)
        swept = self._swept(baseline, fitted, steps) if len(steps) == MOST else None
        if swept:
            fitted, steps = swept
        else:
            fitted, steps = self._unnamed(baseline, *added)
            fitted, steps = pruned(self.case, fitted, steps, self.tried)
            fitted, steps = self._exchanged(fitted, steps) if exchanging else (fitted, steps)
            fitted, steps = self._merged(baseline, fitted, steps)
        return Selection(self.case, self.plain, baseline, fitted, tuple(steps), self.candidates)

    def _assured(self, fitted: Fitted, steps: list[Step]) -> tuple[Fitted, list[Step]]:
        """Judged by the colour of the noise that is left; with what else is clear in noise of that colour."""
        fitted, steps = assured(self.case, fitted, steps, self.tried, self.level)
        while fitted.colour is not WHITE and len(steps) < MOST:
            scores = zip(self.candidates, evidence_of(self.case, fitted).score(self.candidates), strict=True)
            clear = [(e, s) for e, s in scores if not s.hidden and s.p * self.tried < self.level]
            if not clear:
                break
            effect, score = max(clear, key=lambda pair: pair[1].gain - 0.5 * pair[1].size * np.log(fitted.freedom))
            more = self._with(fitted, effect, score.values)
            more, kept = assured(
                self.case, more, [*steps, Step(effect, score.familywise(self.tried), score)], self.tried, self.level
            )
            if len(kept) <= len(steps):
                break
            fitted, steps = more, kept
        return fitted, steps

    def _reviewed(self, selection: Selection) -> Selection:
        """With what could not be seen, and what comes next after all that was found."""
        fitted = selection.fitted
        scores = evidence_of(self.case, selection.baseline).score(self.candidates)
        hidden = tuple(effect for effect, score in zip(self.candidates, scores, strict=True) if score.hidden)
        left = [effect for effect in self.candidates if effect not in fitted.physics.effects]
        scored = zip(left, evidence_of(self.case, fitted).score(left), strict=True)
        chances = [(effect, score.familywise(self.tried)) for effect, score in scored if not score.hidden]
        return replace(selection, hidden=hidden, nearest=min(chances, key=lambda pair: pair[1], default=None))

    def _clocked(self, baseline: Fitted) -> tuple[Fitted, list[Step]]:
        """A clock that is off by seconds is known before anything else can be looked for."""
        if not self.case.clock:
            return baseline, []
        fitted = refit(self.case, Physics((TimeOffset(),)), np.array([self.case.clock]), used=baseline.used)
        gain = fitted.log_likelihood(fitted.residual.scale) - baseline.log_likelihood(fitted.residual.scale)
        p = min(chance(gain, 1, evidence_of(self.case, fitted).memory) * self.tried, 1.0)
        return fitted, [Step(TimeOffset(), p, Score(gain, 1, p, False, fitted.values), ())]

    def _swept(self, baseline: Fitted, fitted: Fitted, steps: list[Step]) -> tuple[Fitted, list[Step]] | None:
        """All orders of all joints at once, where that explains more than so many effects."""
        state, swept = sweep(self.case, baseline, steps, self.candidates, self.tried, self.level)
        scale, n = min(state.residual.scale, fitted.residual.scale), baseline.freedom
        gained = state.log_likelihood(scale) - fitted.log_likelihood(scale)
        if gained < 0.5 * (state.physics.size - fitted.physics.size) * np.log(n):
            return None
        return state, swept

    def _added(self, fitted: Fitted, steps: list[Step]) -> tuple[Fitted, list[Step]]:
        """Adds what is most likely, also what is not sure yet: one effect makes another's residual look like noise
        that remembers. What is not sure beside all the others is to go again."""
        doubtful = 0
        while len(steps) < MOST and doubtful < _DOUBTFUL:
            found = self._next(fitted)
            if found is None:
                break
            fitted, step = found
            steps = [*steps, step]
            doubtful = 0 if step.p < self.level else doubtful + 1
        return fitted, steps

    def _next(self, fitted: Fitted) -> tuple[Fitted, Step] | None:
        """The best single addition, or None where nothing is left."""
        evidence = evidence_of(self.case, fitted)
        named = [effect for effect in self.candidates if not isinstance(effect, JointHarmonic)]
        tried = [(e, s, 0.0) for e, s in zip(named, evidence.score(named), strict=True)]
        tried += [(line.effect, line.score, np.log(line.tried)) for line in lines(evidence)]
        n = evidence.freedom
        ranked = sorted(
            (item for item in tried if not item[1].hidden and item[1].gain > 0),
            key=lambda item: -(item[1].gain - 0.5 * item[1].size * np.log(n) - item[2]),
        )
        if not ranked:
            return None
        first = ranked[: 3 * _REFITTED]
        significant = [item for item in first if item[1].p * self.tried < self.level] or [
            item for item in first if float(chdtrc(item[1].size, 2 * item[1].gain)) * self.tried < self.level
        ]
        if not significant or significant[0][1].gain < 0.5 * significant[0][1].size * np.log(n) + significant[0][2]:
            return None
        close = [item for item in ranked if item[1].gain > 0.8 * significant[0][1].gain][:_REFITTED]
        close = [*significant[:1], *(item for item in close if item is not significant[0])]
        fits = [(item, self._with(fitted, item[0], item[1].values)) for item in close]
        scale = min(fit.residual.scale for _, fit in fits)

        def judged(pair: tuple) -> float:
            (_, score, search), fit = pair
            return fit.log_likelihood(scale) - 0.5 * score.size * np.log(n) - search

        best = most_specific(fits, judged, lambda pair: pair[0][0])
        likely = best[1].log_likelihood(scale)
        fits.sort(key=lambda pair: -judged(pair))
        rivals = tuple(
            Rival(pair[0][0], float(likely - pair[1].log_likelihood(scale))) for pair in fits if pair is not best
        )
        effect, score, _ = best[0]
        return best[1], Step(effect, score.familywise(self.tried), score, rivals)

    def _with(self, fitted: Fitted, effect: Effect, values: Array) -> Fitted:
        physics = Physics((*fitted.physics.effects, effect))
        start = np.concatenate([fitted.values, values])
        return refit(self.case, physics, start, fitted.moved, fitted.used, fitted.colour)

    def _unnamed(self, baseline: Fitted, fitted: Fitted, steps: list[Step]) -> tuple[Fitted, list[Step]]:
        """Curves in place of named effects of a joint, where they explain clearly more than these together."""
        for _ in range(_CURVES):
            better = self._curved(baseline, fitted, steps)
            if better is None:
                break
            fitted, steps = self._added(*better)
        return sure(self.case, fitted, steps, self.tried, self.level)

    def _curved(self, baseline: Fitted, fitted: Fitted, steps: list[Step]) -> tuple[Fitted, list[Step]] | None:
        """The most likely curve of a joint in place of all else there, or None where names do as well."""
        evidence = evidence_of(self.case, fitted)
        best: tuple[Fitted, list[Step]] | None = None
        for joint in range(1, self.case.motion.dof + 1):
            kept = [step for step in steps if step.effect.site != f"joint{joint}"]
            if len(kept) == len(steps):
                worth = [e for e, score in shapes(evidence, joint, local=False) if score.p * self.tried < self.level]
                curves = [self._replaced(fitted, kept, effect) for effect in worth]
            else:
                beside = self._beside(baseline, kept)
                curves = [(fitted, steps)]
                for _ in range(_CURVES):  # in the noise that the last leaves: a large effect blurs what it is like
                    worth = self._likeliest(beside, *curves[-1], joint)
                    if worth is None:
                        break
                    curves.append(self._replaced(beside, kept, worth))
                curves = curves[1:]
            for curve in curves:
                if curve[1][-1].p < self.level and self._better(curve, best or (fitted, steps), 0.0 if best else CLOSE):
                    best = curve
        return best

    def _better(self, ours: tuple[Fitted, list[Step]], theirs: tuple[Fitted, list[Step]], by: float) -> bool:
        scale, n = min(ours[0].residual.scale, theirs[0].residual.scale), ours[0].freedom
        gained = ours[0].log_likelihood(scale) - theirs[0].log_likelihood(scale)
        return gained > cost(ours[1], n) - cost(theirs[1], n) + by

    def _likeliest(self, beside: Fitted, fitted: Fitted, steps: list[Step], joint: int) -> Unnamed | None:
        """The curve of a joint that may well be better than what is fitted there, to first order."""
        evidence = evidence_of(self.case, beside, within=fitted)
        there = [step for step in steps if step.effect.site == f"joint{joint}"]
        effects, values = fitted.physics.part(fitted.values, [step in there for step in steps])
        has = evidence.score_columns([self.case.columns(effects.effects, values)])[0].gain - cost(
            there, evidence.freedom
        )

        def likely(shape: Shape) -> float:
            return shape.score.gain - cost([Step(shape.effect, 1.0, shape.score)], evidence.freedom)

        best = max(shapes(evidence, joint, local=True), key=likely)
        return best.effect if likely(best) > has else None

    def _exchanged(self, fitted: Fitted, steps: list[Step]) -> tuple[Fitted, list[Step]]:
        """With rivals in place of steps where that, and what comes next, is likelier: steps were chosen one by one."""
        best, tried, improved = (fitted, steps), {frozenset(fitted.physics.effects)}, len(steps) >= _SEVERAL
        while improved:
            improved, (fitted, steps) = False, best
            for k, rival in [(k, rival) for k, step in enumerate(steps) for rival in step.rivals[:_EXCHANGED]]:
                kept, rest = [*steps[:k], *steps[k + 1 :]], without(self.case, fitted, k)
                begun = frozenset((*rest.physics.effects, rival.effect))
                if begun in tried:
                    continue
                tried.add(begun)
                score = evidence_of(self.case, rest, within=fitted).score([rival.effect])[0]
                other = self._with(rest, rival.effect, score.values), [*kept, Step(rival.effect, 0.0, score)]
                other = sure(self.case, *self._added(*other), self.tried, self.level)
                if self._better(other, best, CLOSE):
                    best, improved = pruned(self.case, *other, self.tried), True
        return best

    def _merged(self, baseline: Fitted, fitted: Fitted, steps: list[Step]) -> tuple[Fitted, list[Step]]:
        """One curve in place of a joint's many harmonics: no gear has so many orders that are not whole."""
        for joint in range(1, self.case.motion.dof + 1):
            waves = [e for e in (step.effect for step in steps) if isinstance(e, JointHarmonic) and e.joint == joint]
            if len(waves) < _MANY or sum(map(_is_fractional, waves)) < _MANY - 1:
                continue
            orders = tuple(sorted({float(wave.order) for wave in waves if wave.order is not None}))
            kept = [step for step in steps if step.effect not in waves]
            beside = self._beside(baseline, kept)
            fit, path = self._replaced(beside, kept, waves_of(self.case, joint, orders, baseline.used))
            if path[-1].p < self.level:
                fitted, steps = fit, path
        return fitted, steps

    def _beside(self, baseline: Fitted, kept: list[Step]) -> Fitted:
        physics = Physics(tuple(step.effect for step in kept))
        return refit(self.case, physics, moved=baseline.moved, used=baseline.used)

    def _replaced(self, beside: Fitted, kept: list[Step], curve: Unnamed) -> tuple[Fitted, list[Step]]:
        evidence = evidence_of(self.case, beside)
        score = evidence.score([curve])[0]
        fit = self._with(beside, curve, score.values)
        scale = min(fit.residual.scale, beside.residual.scale)
        gain = fit.log_likelihood(scale) - beside.log_likelihood(scale)
        p = min(chance(gain, curve.size, evidence_of(self.case, fit).memory) * self.tried, 1.0)
        named = zip(self.candidates, evidence.score(self.candidates), strict=True)
        near = sorted((pair for pair in named if not pair[1].hidden), key=lambda pair: -pair[1].gain)[:_NEAREST]
        rivals = tuple(Rival(effect, float(gain - score.gain)) for effect, score in near)
        return fit, [*kept, Step(curve, p, score._replace(gain=gain), rivals)]


def search_of(case: Case, extra: Sequence[Effect] = (), level: float = LEVEL) -> Search:
    """The search of a case over the catalogue and `extra` effects; it linearises the case where its geometry is."""
    offset = clock_offset(case)
    late = replace(case, clock=offset)
    plain, start = _relinearised(case, Physics(), np.zeros(0))
    case = _relinearised(late, Physics((TimeOffset(),)), np.array([offset]))[0] if offset else plain
    every = (*catalogue(case.motion.dof, turned_tool=case.rows == 6), *extra)
    missing = tuple(untestable(every, case.motion, case.inertia is not None))
    lacking = {item.effect for item in missing}
    return Search(case, plain, start, tuple(effect for effect in every if effect not in lacking), missing, level)


def _relinearised(case: Case, physics: Physics, values: Array) -> tuple[Case, Array]:
    """The case about the geometry that fits, and the nuisance `(unknown,)` from there."""
    moved = refit(case, physics, values).moved
    for _ in range(_RELINEARISED):
        if not case.unknown:
            break
        case = moved_to(case, moved)
        moved = refit(case, physics, values).moved
    return case, moved


def select(case: Case, extra: Sequence[Effect] = (), level: float = LEVEL) -> Selection:
    """The physics that a case asks for."""
    return search_of(case, extra, level).run()


def _is_fractional(effect: Effect) -> bool:
    return isinstance(effect, JointHarmonic) and effect.order is not None and not float(effect.order).is_integer()
