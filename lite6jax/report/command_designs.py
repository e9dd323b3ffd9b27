"""What a terminal shows of designed commands: what they tell apart and how well, and which of their motions do.

The sentences are functions of `sentences.command_designs`.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from rich.console import RenderableType

from lite6jax.design.command_plans import CLEAR, CommandPlan, DesignedPair
from lite6jax.domains.entries import effect_entry
from lite6jax.domains.tracking.words import TRACKING_WORDS
from lite6jax.effects.effect import Effect
from lite6jax.formatting import quantity, significant
from lite6jax.report import screen
from lite6jax.report.remedies import effect_name, effect_title
from lite6jax.report.sentences import command_designs as sentences
from lite6jax.report.sentences import studies
from lite6jax.report.words import listing

_NAMED = {
    **TRACKING_WORDS.special_units,
    "integral_Nm_per_rad_s": (1.0, "Nm/rad/s"),
    "time_constant_s": (1e3, "ms"),
}
_FAR = 100.0
"""Standard deviations from which a distance is only said to be more."""


def title(effect: Effect) -> str:
    """An effect in words, such as "command delay at joint 3"."""
    return effect_title(effect_entry(effect))


def shown_distance(distance: float) -> str:
    """In standard deviations, to two digits."""
    return f"over {_FAR:g}" if distance > _FAR else significant(distance, 2)


def deviation_of(pair: DesignedPair, distance: float) -> tuple[str, str]:
    """One standard deviation of the number that stands for an effect, and its unit, at a distance; "–" at none."""
    effect = pair.effect
    if not distance > 0:
        return "–", ""
    if pair.number is None and effect.size > 1:
        return significant(100 / distance, 2), "%"
    k = pair.number or 0
    variance = np.zeros((effect.size, effect.size))
    variance[k, k] = (pair.values[k] / distance) ** 2
    if effect.size > 1:
        name = effect.coordinates[k].name
        estimate = {"value": float(pair.values[k]), "std": float(np.sqrt(variance[k, k]))}
    else:
        name, reported = next(iter(effect.reported(pair.values, variance).items()))
        estimate = reported._asdict()
    shown = quantity(name, estimate, _NAMED)
    return shown.std or shown.value, shown.unit


def command_plan_report(
    plan: CommandPlan, disabled: Sequence[tuple[str, str]], source: str, notes: Sequence[str], out: Path
) -> Iterator[RenderableType]:
    """What designed commands tell apart, beside what there is, and which motions they have."""
    yield screen.unbroken(source)
    yield sentences.studied(plan)
    yield from notes
    yield from studies.unchecked_pairs(disabled)
    yield ""
    yield from _of_findings(plan) if plan.experiment.of_findings else _of_names(plan)
    yield ""
    yield sentences.parts(plan)
    yield from sentences.how_to_record(plan, out.name)


def _of_findings(plan: CommandPlan) -> Iterator[RenderableType]:
    """A row for each pair: how far apart now, and with the designed commands."""
    log = plan.experiment.recorded is not None
    headers = [*(["log"] if log else []), "log of the\nsame" if log else "at random", "designed"]
    table = listing("standard deviations apart", *headers)
    for pair in plan.pairs:
        distances = [*([pair.recorded or 0.0] if log else []), pair.compared, pair.designed]
        names = f"{title(pair.effect)}\n  or {title(pair.rival)}"
        table.add_row(names, *map(shown_distance, distances))
    yield table
    yield sentences.compared(log)
    yield ""
    for pair in plan.pairs:
        yield sentences.verdict_on_pair(title(pair.effect), title(pair.rival), pair.clear, pair.alike, pair.kind)
    for effect in dict.fromkeys(pair.effect for pair in plan.pairs):
        pairs = [pair for pair in plan.pairs if pair.effect == effect and not pair.alike]
        if pairs:
            worst = min(pairs, key=lambda pair: pair.designed)
            now = " ".join(deviation_of(worst, worst.recorded or 0.0)).strip() if log else ""
            designed = " ".join(deviation_of(worst, worst.designed)).strip()
            yield sentences.deviation(title(effect), now, designed)


def _of_names(plan: CommandPlan) -> Iterator[RenderableType]:
    """A row for each number of each effect, at the joint where it is known least."""
    log = plan.experiment.recorded is not None
    table = listing("effect, or what resembles it", "log" if log else "at random", "designed")
    worst: dict[tuple[str, int | None], DesignedPair] = {}
    for pair in plan.hardest:
        key = pair.effect.name, pair.number
        if key not in worst or pair.designed < worst[key].designed:
            worst[key] = pair
    for pair in worst.values():
        effect = pair.effect
        number = f" {pair.number + 1}" if effect.size > 1 and pair.number is not None else ""
        before, _ = deviation_of(pair, (pair.recorded or 0.0) if log else pair.compared)
        designed, unit = deviation_of(pair, pair.designed)
        in_unit = f" ({unit})" if unit else ""
        rival = title(pair.rival).removesuffix(f" at {effect.site}")
        names = f"{effect_name(effect.name)}{number} at {effect.site}{in_unit}\n  or {rival}"
        table.add_row(names, f"±{before}", f"±{designed}")
    yield sentences.of_all_names(log)
    yield ""
    yield table
    unclear = [pair for pair in plan.hardest if not pair.clear]
    if unclear:
        yield ""
        yield sentences.unclear_effects(list(dict.fromkeys(title(pair.effect) for pair in unclear)), CLEAR)
    if plan.unseen:
        yield ""
        yield sentences.unseen_effects([label.replace("_", " ").replace(":", " at ") for label in plan.unseen])
    pairs = {tuple(sorted((effect_name(p.effect.name), effect_name(p.rival.name)))) for p in plan.alike}
    if pairs:
        yield ""
        yield sentences.alike_names(sorted(pairs))
