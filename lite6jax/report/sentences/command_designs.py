"""What is said of commands that are designed to tell effects apart."""

from collections.abc import Iterator, Sequence

import numpy as np

from lite6jax.design.command_plans import CLEAR, CommandPlan
from lite6jax.formatting import joined, plural, significant


def studied(plan: CommandPlan) -> str:
    """Says how long and how fast the commands are, among how many motions they were chosen, and what reads them."""
    arm = plan.experiment.model.arm.name
    fastest = np.rad2deg(plan.fastest.max())
    strongest = np.rad2deg(plan.strongest.max())
    noise = 1e3 * plan.experiment.noise
    size = significant(float(noise.min()), 2)
    if noise.max() > 1.05 * noise.min():
        size = f"{size} to {significant(float(noise.max()), 2)}"
    return (
        f"{arm}: commands of {plan.time[-1]:g} s, {len(plan.time)} samples, up to {fastest:.0f} deg/s and "
        f"{strongest:.0f} deg/s², of {len(plan.parts)} motions chosen among {plan.candidates}; read-outs with noise of "
        f"{size} mrad (one standard deviation, white)."
    )


def compared(log: bool) -> str:
    """Says what the columns of the table are."""
    if log:
        return (
            "Beside the log as it is, it is made longer by its own motion, or by the designed commands. "
            f"From {CLEAR:g} on two explanations are distinguished."
        )
    return (
        "Beside as many of these motions drawn at random, the median of several draws, are the designed commands. From "
        f"{CLEAR:g} on two explanations are distinguished."
    )


def verdict_on_pair(effect: str, rival: str, clear: bool, alike: bool, kind: str) -> str:
    """Says whether two explanations are distinguished, and by which motions."""
    if alike:
        return f"{effect} and {rival} are alike in every motion of commands: record torques, or another payload."
    if clear:
        return f"Distinguished: {effect} from {rival}, most by {kind}."
    return f"Not distinguished: {effect} from {rival}, most by {kind}. Give a longer --duration or wider limits."


def deviation(effect: str, now: str, designed: str) -> str:
    """Says how well an effect is known beside its nearest alternative."""
    before = ""
    if now:
        before = f" instead of ±{now}"
    return f"{effect[:1].upper()}{effect[1:]}: ±{designed}{before} beside its nearest alternative."


def of_all_names(log: bool) -> str:
    """Says what the table of all named effects shows."""
    beside = "as many of these motions drawn at random, the median of several draws"
    if log:
        beside = "the log"
    return (
        "One standard deviation (Cramér–Rao bound) of each effect beside the one that resembles it most, at the joint "
        f"where it is largest: of {beside}, and with the designed commands."
    )


def unclear_effects(names: Sequence[str], clear: float) -> str:
    """Says which effects of a usual size are not distinguished from the one that resembles them most."""
    are = plural(len(names), "is", "are")
    return f"Less than {clear:g} standard deviations from another explanation, at a usual size, {are} {joined(names)}."


def unseen_effects(names: Sequence[str]) -> str:
    """Says which effects no motion shows."""
    return f"No motion within these limits shows {joined(names, 'or')}."


def alike_names(pairs: Sequence[tuple[str, ...]]) -> str:
    """Says which effects no motion of commands tells apart at some joint."""
    named = "; ".join(f"{first} and {second}" for first, second in pairs)
    return f"Alike in every motion within these limits, at one joint or more: {named}."


def parts(plan: CommandPlan) -> str:
    """Says which motions there are, and when; those of one kind without a move between them together."""
    together: list[tuple[str, int, float, float]] = []
    for kind, begin, end in plan.parts:
        if together and together[-1][0] == kind and begin - together[-1][3] < 1e-9:
            _, count, first, _ = together.pop()
            together.append((kind, count + 1, first, end))
        else:
            together.append((kind, 1, begin, end))
    named = []
    for kind, count, begin, end in together:
        times = f", {count} times" if count > 1 else ""
        named.append(f"{kind}{times} ({begin:.1f} to {end:.1f} s)")
    return f"Motions: {', '.join(named)}."


def how_to_record(plan: CommandPlan, file: str) -> Iterator[str]:
    """Says how the commands are recorded."""
    start = ", ".join(f"{value:.1f}" for value in np.rad2deg(plan.command[0]))
    yield (
        f"Stand the arm at the first row of {file} ({start} deg), and try it slowly first: cables and surroundings are "
        "not checked."
    )
    payloads = plan.experiment.payloads
    if len(payloads) > 1:
        loads = joined(f"{payload:g} kg" for payload in payloads)
        yield f"Record it once with each of {loads} at the flange, and declare the payload of each log."
    yield "Record commands and joints, and diagnose the new log together with the old one, as runs of one recording."
