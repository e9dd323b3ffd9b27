"""The scores of many trials as tables, for the terminal and as Markdown; and the story of one trial."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise

import numpy as np

from benchmarks.campaigns.shares import WITHIN, Share, met, share, short
from benchmarks.campaigns.tables import Cells, Section
from benchmarks.concealed import scores
from benchmarks.concealed.plain_physics import OUTSIDE
from benchmarks.concealed.plans import EDGES, FAULTS, NOISES, SINGLE, SIZES
from benchmarks.concealed.scores import Row


def sections(rows: Sequence[Row]) -> Iterator[Section]:
    """Title, head and rows of every table that has any."""
    for title, head, cells in (
        ("Goals", ("goal", "reached, 95 % interval", "met"), met(scores.goals(rows))),
        ("One effect hidden, by size", ("× threshold", *_SINGLE), _by_size(rows)),
        ("One effect hidden, twice the threshold or more, by effect", ("effect", *_SINGLE), _by_effect(rows)),
        ("Nothing hidden", ("noise", "trials", "something found", "a data fault", "best p below 0.05"), _clean(rows)),
        (
            "Two or three hidden",
            ("trials", "each named", "each in the set", "all and no more", "in the set"),
            _mixed(rows),
        ),
        ("What is said outside the catalogue and at its edge", ("", "trials", *_SAID), _said(rows)),
        (
            "Outside the catalogue",
            ("family", "trials", "something found", "at its site", "unnamed, by its driver", "misleading"),
            _outside(rows),
        ),
        ("Faults of the data", ("fault", "found", "and nothing else but what is hidden"), _faulty(rows)),
        ("Numbers, from three thresholds on", ("", "value"), _numbers(rows)),
        ("Unseen motion, error over the oracle's", ("trials", "ratio, 95 % interval"), _unseen(rows)),
        ("The run", ("", ""), _run(rows)),
    ):
        if cells:
            yield title, head, cells


_APART = (0.0, scores.DISTINGUISHED, 8.0, 16.0, math.inf)
"""Standard deviations between which trials outside the catalogue are counted together."""
_SAID = ("right", "partial", "misleading", "found, effect and site")
_SINGLE = (
    "trials",
    "something detected",
    "found, effect and site",
    "right site",
    "right name",
    "in the set",
    "exactly this",
    "right name where the data distinguish it",
)


def _single_cells(rows: Sequence[Row]) -> list[str]:
    keys = ("top_site", "top_named", "top_in_set", "exact")
    distinguished = share(row["top_named"] for row in rows if scores.distinguishable(row))
    found = [share(row["detected"] for row in rows), scores.share_found(rows)]
    found += [share(row[key] for row in rows) for key in keys]
    return [str(len(rows)), *map(short, found), str(distinguished)]


def _by_size(rows: Sequence[Row]) -> Cells:
    grouped = [(f"{size:g}", scores.singles(rows, size, size)) for size in sorted(set(SIZES))]
    return [(label, *_single_cells(found)) for label, found in grouped if found]


def _by_effect(rows: Sequence[Row]) -> Cells:
    grouped = [(name, [r for r in scores.singles(rows, 2.0) if r["hidden"][0]["effect"] == name]) for name in SINGLE]
    return [(name, *_single_cells(found)) for name, found in grouped if found]


def _clean(rows: Sequence[Row]) -> Cells:
    clean = [row for row in rows if row["kind"] == "clean" and not row["error"]]
    names = [name for name in dict.fromkeys(NOISES) if any(row["noise"] == name for row in clean)]
    groups = [("all", clean)] + [(name, [row for row in clean if row["noise"] == name]) for name in names]
    return [
        (
            label,
            str(len(found)),
            short(share(row["detected"] for row in found)),
            short(share(any(fault != "outliers" for fault in row["faults"]) for row in found)),
            short(share(p < 0.05 for row in found if (p := best_chance(row)) is not None)),
        )
        for label, found in groups
        if found
    ]


def best_chance(row: Row) -> float | None:
    """The smallest p-value of a trial: of what was found, or of the best candidate that was not taken."""
    said = [finding["p_value"] for finding in row["findings"]]
    said += [row["nearest_p"]] if row["nearest_p"] is not None else []
    return min(said) if said else None


def _mixed(rows: Sequence[Row]) -> Cells:
    mixed = [row for row in rows if row["kind"] == "mixture"]
    groups = [(f"{n} effects", [row for row in mixed if len(row["hidden"]) == n]) for n in (2, 3)]
    loaded = [row for row in mixed if any(effect["effect"] == "payload_error" for effect in row["hidden"])]
    return [
        (
            label,
            str(share(effect["named"] for row in found for effect in row["hidden"])),
            str(share(effect["in_set"] for row in found for effect in row["hidden"])),
            str(share(row["exact"] for row in found)),
            str(share(row["exact_in_set"] for row in found)),
        )
        for label, found in [*groups, ("— with a wrong payload", loaded)]
        if found
    ]


def _said(rows: Sequence[Row]) -> Cells:
    judged = scores.at_stake(rows)
    outside = [row for row in judged if row["kind"] == "outside"]
    groups = [("all", judged), ("outside the catalogue", outside)]
    groups += [(f"at its edge: {edge}", [row for row in judged if row["edge"] == edge]) for edge in EDGES]
    groups += [("masses off", [row for row in judged if row["masses_off"]])]
    groups += [
        (f"{low} to {high} rows", [row for row in judged if low <= row["rows"] <= high])
        for low, high in ((15, 40), (41, 200), (201, 3000))
    ]
    return [
        (
            label,
            str(len(found)),
            *(short(share(row["statement"] == grade for row in found)) for grade in ("right", "partial", "misleading")),
            short(scores.share_found(found)),
        )
        for label, found in groups
        if found
    ]


def _outside(rows: Sequence[Row]) -> Cells:
    trials = [row for row in rows if row["kind"] == "outside"]
    groups = [(name, [row for row in trials if row["hidden"][0]["effect"] == name]) for name in OUTSIDE]
    sizes = sorted({row["planned_size"] for row in trials})
    groups += [(f"× {size:g}", [row for row in trials if row["planned_size"] == size]) for size in sizes]
    groups += [
        (f"{low:g} to {high:g} standard deviations from what is nearest", found)
        for low, high in pairwise(_APART)
        if (found := [row for row in trials if low <= (row["hidden"][0]["apart"] or 0.0) < high])
    ]
    return [
        (
            label,
            str(len(found)),
            short(share(row["detected"] for row in found)),
            short(share(row["hidden"][0]["site_found"] for row in found)),
            short(share(row["hidden"][0]["named"] for row in found)),
            short(share(row["statement"] == "misleading" for row in found)),
        )
        for label, found in groups
        if found
    ]


def _faulty(rows: Sequence[Row]) -> Cells:
    trials = [row for row in rows if row["kind"] == "faulty"]
    groups = [(name, [row for row in trials if row["fault"] == name]) for name in FAULTS]
    return [
        (name, str(share(row["fault_found"] for row in found)), str(share(row["exact_in_set"] for row in found)))
        for name, found in groups
        if found
    ]


def _numbers(rows: Sequence[Row]) -> Cells:
    large = [row for row in rows if row["kind"] in ("single", "mixture")]
    found = scores.numbers(large, 3.0)
    if not found:
        return []
    pulls = np.array([number["off"] / number["std"] for number in found])
    bounded = [number for number in found if number["bound"] > 0]
    over = np.array([number["off"] / number["bound"] for number in bounded] or [np.nan])
    said = np.array([number["std"] / number["bound"] for number in bounded] or [np.nan])
    covered: Callable[[Iterable[Row]], Share] = lambda some: share(  # noqa: E731
        abs(number["off"]) <= WITHIN * number["std"] for number in some
    )
    worst = [(name, covered([n for n in found if n["effect"] == name])) for name in SINGLE]
    return [
        ("estimated numbers of effects that were named", str(len(found))),
        ("within their 95 % interval", str(covered(found))),
        ("— orders", str(covered([number for number in found if number["name"] == "order"]))),
        ("orders stated as exact that are", str(scores.exact_orders(large))),
        ("— of trials in the plain physics", str(covered(scores.numbers(_of_engine(large, "plain"), 3.0)))),
        ("— of trials in MuJoCo", str(covered(scores.numbers(_of_engine(large, "mujoco"), 3.0)))),
        *((f"— {name}", str(each)) for name, each in worst if each.of),
        (
            "error over the stated standard deviation, median of its size (0.67 if honest)",
            f"{np.median(abs(pulls)):.2f}",
        ),
        ("error over the Cramér–Rao bound, median of its size (0.67 if efficient)", f"{np.median(abs(over)):.2f}"),
        ("stated standard deviation over the Cramér–Rao bound, median", f"{np.median(said):.2f}"),
    ]


def _of_engine(rows: Sequence[Row], engine: str) -> list[Row]:
    return [row for row in rows if row["engine"] == engine]


def _unseen(rows: Sequence[Row]) -> Cells:
    named = [row for row in rows if row["kind"] in ("single", "mixture")]
    twice = [row for row in named if all(effect["size"] >= 2 for effect in row["hidden"])]
    groups = [
        ("nothing hidden, noise as declared", [r for r in rows if r["kind"] == "clean" and r["noise"] == NOISES[0]]),
        ("nothing hidden, other noise", [r for r in rows if r["kind"] == "clean" and r["noise"] != NOISES[0]]),
        ("one to three effects, each at twice the threshold or more", twice),
        ("— that were found exactly", [row for row in twice if row["exact"]]),
        ("— smaller ones", [row for row in named if row not in twice]),
        ("outside the catalogue", [row for row in rows if row["kind"] == "outside"]),
        ("at its edge", [row for row in rows if row["kind"] == "edge"]),
    ]
    return [(label, str(scores.against_oracle(found))) for label, found in groups if found]


def _run(rows: Sequence[Row]) -> Cells:
    failed = [row for row in rows if row["error"]]
    kinds = Counter(row["kind"] for row in rows)
    engines = Counter(row["engine"] for row in rows)
    return [
        ("trials", ", ".join(f"{count} {kind}" for kind, count in kinds.items())),
        ("physics", ", ".join(f"{count} {engine}" for engine, count in engines.items())),
        ("diagnosis and prediction, median", f"{np.median([row['seconds'] for row in rows]):.1f} s"),
        ("without an answer", str(share(bool(row["error"]) for row in rows))),
        *((f"— trial {row['index']}", row["error"]) for row in failed[:3]),
    ]


def story(truth: Row, row: Row) -> Iterator[str]:
    """What happened in a trial, line by line."""
    chain = f"chain {truth['geometry']}, frame and tool {'unknown' if truth['mounted'] else 'known'}"
    motion = "trajectory" if truth["moving"] else "poses at rest"
    fault = f", fault: {truth['fault']}" if truth["fault"] else ""
    motion = f"{row['rows']} rows of a {motion}" if truth["moving"] else f"{row['rows']} {motion}"
    yield (
        f"{truth['kind'].capitalize()}, physics: {truth['engine']}; arm {truth['arm']}, {truth['sensor']}, {motion}, "
        f"{chain}; noise {truth['noise']}{fault}."
    )
    yield "Hidden:" if truth["hidden"] else "Hidden: nothing"
    for effect, seen in zip(truth["hidden"], row["hidden"], strict=True):
        yield from _hidden_lines(effect, seen)
    if truth.get("edge") or truth.get("masses_off"):
        off = ", ".join(f"{100 * error:+.0f} %" for error in truth.get("mass_errors", ()))
        yield f"  Made hard by: {truth.get('edge') or 'masses off'}{f'; masses differ by {off}' if off else ''}"
    yield f"Statement: {row['statement']}{': ' + row['why'] if row['why'] else ''}"
    yield f"Verdict: {row['verdict']}{', error: ' + row['error'] if row['error'] else ''}"
    for finding in row["findings"]:
        mark, order = "✓" if finding["true"] else "✗", finding["order"]
        which = "" if order is None else f", order {order:.4g}"
        rivals = f"; nearest alternatives: {', '.join(finding['rivals'])}" if finding["rivals"] else ""
        yield (
            f"  {mark} {finding['effect']} at {finding['site']}{which} by {finding['driver']}: "
            f"p = {finding['p_value']:.2g}, gain {finding['gain']:.1f}{rivals}"
        )
    if row["nearest_p"] is not None:
        yield f"  nearest not significant: {row['nearest_effect']} at {row['nearest_site']}, p = {row['nearest_p']:.2g}"
    if row["after_m"] is not None:
        before, after = (1e6 * row[key] / np.sqrt(3) for key in ("before_m", "after_m"))
        estimated = row["estimated_noise_m"]
        said = "" if estimated is None else f", {1e6 * estimated:.3g} µm estimated"
        yield f"Held out, per axis: {before:.3g} µm before, {after:.3g} µm after."
        yield f"Noise per axis: {1e6 * row['noise_m']:.3g} µm declared{said}."
    if row["faults"]:
        yield f"Faults of the data: {', '.join(row['faults'])}"
    exact, in_set = ("yes" if row[key] else "no" for key in ("exact", "exact_in_set"))
    yield f"Found exactly: {exact}; within the set of alternatives: {in_set}."
    unseen = "nothing predicted" if row["unseen_m"] is None else f"off by {1e6 * row['unseen_m']:.3g} µm RMS"
    yield f"Unseen motion: {unseen}, the oracle by {1e6 * row['oracle_m']:.3g} µm. {row['seconds']:.1f} s."


def _hidden_lines(effect: Row, seen: Row) -> Iterator[str]:
    parameters = effect["parameters"]
    values = ", ".join(f"{name} {value:.4g}" for name, value in parameters.items())
    form = ", ".join(f"{name} {value:.4g}" for name, value in effect["fixed"].items() if name not in parameters)
    yield f"  {effect['effect']} at {effect['site']}: {values}{f' ({form})' if form else ''}"
    yield (
        f"    {effect['size']:.2f} thresholds; moves the point by {1e6 * effect['moved_m']:.3g} µm RMS, "
        f"{100 * effect['seen']:.0f} % of it visible"
    )
    rival = effect["rival"]
    if rival and rival["name"]:
        yield f"    nearest: {rival['name']} at {rival['site']}, {rival['apart']:.1f} standard deviations apart"
    for number in seen["numbers"]:
        pull = number["off"] / (number["std"] or np.nan)
        yield (
            f"    {number['name']}: off by {number['off']:.3g} = {pull:.2f} estimated standard deviations; "
            f"the bound is {number['bound']:.3g}"
        )
