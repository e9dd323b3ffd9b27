"""The effects that a search has added, and whether each is still needed beside the others."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.problem import Case
from lite6jax.effects.composition import Physics
from lite6jax.effects.effect import Effect
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.effects.kinematic.surroundings import TimeOffset
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.estimation.least_squares import Fitted, refit, without
from lite6jax.estimation.noise import WHITE
from lite6jax.estimation.score_test import Score, colour_left, evidence_of

Array = NDArray[np.floating]

CLOSE = 6.0
"""Log-likelihood within which two candidates cannot be told apart."""
SEARCHED = 400.0
"""Orders, or shapes, of a joint that are looked through, about."""
_SPECIFIC = (
    *(
        "joint_offset",
        "joint_scale",
        "joint_compliance",
        "joint_backlash",
        "joint_lag",
        "joint_harmonic",
        "time_offset",
    ),
    *(
        "tool_offset",
        "measurement_scale",
        "link_thermal_expansion",
        "joint_coupling",
        "payload_error",
        "base_compliance",
    ),
    *("base_drift", "link_compliance", "frame_offset", "unnamed"),
)

T = TypeVar("T")


@dataclass(frozen=True)
class Rival:
    """An effect that explains nearly the same.

    Attributes:
        effect: which.
        gap: how much less log-likelihood its refit has.
    """

    effect: Effect
    gap: float


@dataclass(frozen=True, eq=False)
class Step:
    """An effect that was added.

    Attributes:
        effect: which.
        p: family-wise.
        score: against all before it.
        rivals: those that it was preferred to.
    """

    effect: Effect
    p: float
    score: Score
    rivals: tuple[Rival, ...] = ()


def most_specific(choices: Sequence[T], judged: Callable[[T], float], named: Callable[[T], Effect]) -> T:
    """Of the choices that the data cannot tell from the best, the one with the most specific name."""
    most = max(map(judged, choices))
    near = [choice for choice in choices if most - judged(choice) < CLOSE]
    return min(near, key=lambda choice: (_specific(named(choice)), -judged(choice)))


def cost(steps: Sequence[Step], n: float) -> float:
    """What a set of effects costs: half a logarithm a number, and the choice of an order or shape among hundreds."""
    effects = [step.effect for step in steps]
    orders = sum(isinstance(effect, JointHarmonic) and effect.order not in (1.0, 2.0) for effect in effects)
    shapes = sum(isinstance(effect, Unnamed) for effect in effects)
    numbers = sum(effect.size for effect in effects) + orders
    return float(0.5 * numbers * np.log(n) + (orders + shapes) * np.log(SEARCHED))


def sure(case: Case, fitted: Fitted, steps: list[Step], tried: float, level: float) -> tuple[Fitted, list[Step]]:
    """Without the steps that are not significant beside the others, by the memory of what all of them leave.

    Args:
        case: the data.
        fitted: with all steps.
        steps: those with `p` under `level` are not asked again.
        tried: how many independent candidates there were.
        level: of the family-wise error.
    """
    while doubtful := [k for k, step in enumerate(steps) if step.p >= level]:
        memory = evidence_of(case, fitted).memory
        judged = {k: _judged(case, fitted, steps[k], k, tried, memory) for k in doubtful}
        worst = max(judged, key=lambda k: judged[k][1].p)
        if judged[worst][1].p < level:
            return fitted, [judged[k][1] if k in judged else step for k, step in enumerate(steps)]
        fitted, steps = judged[worst][0], [step for k, step in enumerate(steps) if k != worst]
    return fitted, steps


def assured(case: Case, fitted: Fitted, steps: list[Step], tried: float, level: float) -> tuple[Fitted, list[Step]]:
    """All steps judged and fitted once more, where the noise that they leave remembers its neighbours.

    A search looks at white noise: it finds what is there, and things that noise of long memory looks like; these go.
    """
    while (colour := colour_left(case, fitted)) is not WHITE:
        fitted = refit(case, fitted.physics, fitted.values, fitted.moved, fitted.used, colour)
        memory = evidence_of(case, fitted).memory
        judged = {k: _judged(case, fitted, step, k, tried, memory) for k, step in enumerate(steps)}
        worst = max(judged, key=lambda k: judged[k][1].p, default=None)
        if worst is None or judged[worst][1].p < level:
            steps = [step for _, step in judged.values()]
            for k in range(len(steps)):
                fitted, steps = _renamed(case, fitted, steps, k, tried)
            return fitted, steps
        fitted, steps = judged[worst][0], [step for k, step in enumerate(steps) if k != worst]
    if fitted.colour is not WHITE:
        fitted = refit(case, fitted.physics, fitted.values, fitted.moved, fitted.used)
    return fitted, steps


def _renamed(case: Case, fitted: Fitted, steps: list[Step], k: int, tried: float) -> tuple[Fitted, list[Step]]:
    """With the k-th step's most likely name among its rivals': another colour of the noise makes another likelier."""
    step, rest = steps[k], without(case, fitted, k)
    evidence = evidence_of(case, rest)
    choices = [(step, fitted)]
    for rival in step.rivals:
        score = evidence.score([rival.effect])[0]
        physics = Physics((*rest.physics.effects[:k], rival.effect, *rest.physics.effects[k:]))
        values = np.insert(rest.values, fitted.physics.slices[k].start, score.values)
        fit = refit(case, physics, values, rest.moved, rest.used, rest.colour)
        choices.append((Step(rival.effect, score.familywise(tried), score), fit))
    scale, n = min(fit.residual.scale for _, fit in choices), rest.freedom

    def judged(choice: tuple[Step, Fitted]) -> float:
        return choice[1].log_likelihood(scale) - cost([choice[0]], n)

    best = most_specific(choices, judged, lambda choice: choice[0].effect)
    likely = best[1].log_likelihood(scale)
    rivals = tuple(
        Rival(other.effect, float(likely - fit.log_likelihood(scale)))
        for other, fit in sorted(choices, key=lambda choice: -judged(choice))
        if other is not best[0]
    )
    return best[1], [replace(best[0], rivals=rivals) if i == k else each for i, each in enumerate(steps)]


def pruned(case: Case, fitted: Fitted, steps: list[Step], tried: float) -> tuple[Fitted, list[Step]]:
    """Without those that the others make unnecessary."""
    n = fitted.freedom
    while len(steps) > 1:
        losses = []
        for i in range(len(steps)):
            rest = [step for k, step in enumerate(steps) if k != i]
            fit = without(case, fitted, i)
            loss = fitted.log_likelihood(fitted.residual.scale) - fit.log_likelihood(fitted.residual.scale)
            losses.append((loss - 0.5 * steps[i].effect.size * np.log(n), fit, rest))
        least = min(losses, key=lambda item: item[0])
        if least[0] > np.log(tried):
            break
        fitted, steps = least[1], least[2]
    return fitted, steps


def _judged(case: Case, fitted: Fitted, step: Step, k: int, tried: float, memory: float) -> tuple[Fitted, Step]:
    """The fit without the k-th step, and that step judged against it, by what noise remembers beside all steps."""
    fit = without(case, fitted, k)
    if case.clock and isinstance(step.effect, TimeOffset):
        return fit, step  # seconds off are far from where a score holds
    score = evidence_of(case, fit, memory).score([step.effect])[0]
    return fit, replace(step, p=score.familywise(tried), score=score)


def _specific(effect: Effect) -> int:
    """How specific a name is, the most specific first."""
    return _SPECIFIC.index(effect.name) if effect.name in _SPECIFIC else len(_SPECIFIC)
