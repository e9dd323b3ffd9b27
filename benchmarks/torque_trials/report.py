"""The scores of many torque trials as tables; and the story of one trial."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from benchmarks.campaigns.campaign import Row
from benchmarks.campaigns.shares import WITHIN, met, share, short
from benchmarks.campaigns.tables import Cells, Section
from benchmarks.concealed.scores import distinguishable, numbers, share_found, singles
from benchmarks.torque_trials import scores
from benchmarks.torque_trials.outside import FAMILIES
from benchmarks.torque_trials.plans import EDGES, FAULTS, NOISES, SINGLE, SIZES

_SINGLE = ("trials", "something detected", "found, effect and site", "right site", "right name", "in the set")
_FAULTS = {"outliers": ("torque_spikes",)}
"""The data faults that a kind of noise is."""
_LAST = "right name where the data distinguish it"


def sections(rows: Sequence[Row]) -> Iterator[Section]:
    """Title, head and rows of every table that has any."""
    for title, head, cells in (
        ("Goals", ("goal", "reached, 95 % interval", "met"), met(scores.goals(rows))),
        ("Nothing hidden", ("noise", "trials", "false alarms", "a data fault that is none"), _clean(rows)),
        ("One effect hidden, by size", ("× threshold", *_SINGLE, _LAST), _by_size(rows)),
        ("One effect hidden, twice the threshold or more", ("effect", *_SINGLE, _LAST), _by_effect(rows)),
        ("Several hidden", ("", "trials", "each named", "in the set", "all and no more"), _mixed(rows)),
        (
            "Outside the catalogue",
            ("family", "trials", "something detected", "at its joint", "unnamed, by its driver", "wrong name"),
            _outside(rows),
        ),
        ("Something wrong", ("fault", "trials", "said", "an absurd inertia", "nothing else found"), _faulty(rows)),
        ("Numbers, from four thresholds on", ("", "within their 95 % interval"), _numbers(rows)),
        (
            "Unseen motion",
            ("", "trials", "within the bound", "error over the bound, median", "90 %"),
            _unseen(rows),
        ),
        ("The run", ("", ""), _run(rows)),
    ):
        if cells:
            yield title, head, cells


def _clean(rows: Sequence[Row]) -> Cells:
    clean = [row for row in rows if row["kind"] == "clean" and not row["error"]]
    groups = [("all", clean), *((name, [row for row in clean if row["noise"] == name]) for name in NOISES)]
    for key in ("inertial", "engine", "source"):
        groups += [(f"{key}: {v}", [row for row in clean if row[key] == v]) for v in sorted({r[key] for r in clean})]
    return [
        (
            label,
            str(len(found)),
            short(share(row["detected"] for row in found)),
            short(share(any(fault not in _FAULTS.get(row["noise"], ()) for fault in row["faults"]) for row in found)),
        )
        for label, found in groups
        if found
    ]


def _single_cells(rows: Sequence[Row]) -> list[str]:
    found = [share(row["detected"] for row in rows), share_found(rows)]
    found += [share(row[key] for row in rows) for key in ("top_site", "top_named", "top_in_set")]
    distinguished = share(row["top_named"] for row in rows if distinguishable(row))
    return [str(len(rows)), *map(short, found), str(distinguished)]


def _by_size(rows: Sequence[Row]) -> Cells:
    grouped = [(f"{size:g}", singles(rows, size, size)) for size in sorted(set(SIZES))]
    return [(label, *_single_cells(found)) for label, found in grouped if found]


def _by_effect(rows: Sequence[Row]) -> Cells:
    large = singles(rows, 2.0)
    grouped = [(name, [row for row in large if row["hidden"][0]["effect"] == name]) for name in SINGLE]
    for key in ("inertial", "engine", "noise"):
        grouped += [(f"{key}: {v}", [row for row in large if row[key] == v]) for v in sorted({r[key] for r in large})]
    return [(name, *_single_cells(found)) for name, found in grouped if found]


def _mixed(rows: Sequence[Row]) -> Cells:
    mixed = [row for row in rows if row["kind"] == "mixture"]
    edges = [row for row in rows if row["kind"] == "edge"]
    groups = [(f"{n} effects", [row for row in mixed if len(row["hidden"]) == n]) for n in (2, 3)]
    groups += [(f"at the edge: {edge}", [row for row in edges if row["edge"] == edge]) for edge in EDGES]
    return [
        (
            label,
            str(len(found)),
            str(share(effect["named"] for row in found for effect in row["hidden"])),
            str(share(effect["in_set"] for row in found for effect in row["hidden"])),
            short(share(row["exact"] for row in found)),
        )
        for label, found in groups
        if found
    ]


def _outside(rows: Sequence[Row]) -> Cells:
    trials = [row for row in rows if row["kind"] == "outside"]
    groups = [("all", trials)]
    groups += [(name, [row for row in trials if row["hidden"][0]["effect"] == name]) for name in FAMILIES]
    groups += [
        (f"× {size:g}", [row for row in trials if row["planned_size"] == size])
        for size in sorted({row["planned_size"] for row in trials})
    ]
    return [
        (
            label,
            str(len(found)),
            short(share(row["detected"] for row in found)),
            short(share(row["hidden"][0]["site_found"] for row in found)),
            short(share(row["hidden"][0]["named"] for row in found)),
            short(share(row["wrong_name"] for row in found)),
        )
        for label, found in groups
        if found
    ]


def _faulty(rows: Sequence[Row]) -> Cells:
    faulty = [row for row in rows if row["fault"]]
    groups = [(fault, [row for row in faulty if row["fault"] == fault]) for fault in sorted(set(FAULTS))]
    cells = [
        (
            label,
            str(len(found)),
            *(short(share(row[key] for row in found)) for key in ("fault_found", "absurd")),
            short(share(not row["false"] for row in found)),
        )
        for label, found in groups
        if found
    ]
    return cells


def _numbers(rows: Sequence[Row]) -> Cells:
    found = numbers([row for row in rows if row["kind"] in ("single", "mixture")], scores.KNOWN)
    if not found:
        return []

    def within(some: Iterable[Row]) -> str:
        return str(share(abs(number["off"]) <= WITHIN * number["std"] for number in some))

    names = [name for name in SINGLE if any(number["effect"] == name for number in found)]
    bounded = [number for number in found if number["bound"] > 0]
    said = np.median([number["std"] / number["bound"] for number in bounded]) if bounded else np.nan
    return [
        ("all", within(found)),
        *((f"— {name}", within(number for number in found if number["effect"] == name)) for name in names),
        ("stated standard deviation over the Cramér–Rao bound, median", f"{said:.2f}"),
    ]


def _unseen(rows: Sequence[Row]) -> Cells:
    cells = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        kept = [row for row in rows if row["kind"] == kind]
        over = [row["unseen_Nm"] / row["bound_Nm"] for row in kept if row["unseen_Nm"] is not None]
        spread = [f"{np.median(over):.2f}", f"{np.percentile(over, 90):.2f}"] if over else ["none", "none"]
        cells.append((kind, str(len(kept)), short(scores.within_bound(kept)), *spread))
    return cells


def _run(rows: Sequence[Row]) -> Cells:
    failed = [row for row in rows if row["error"]]
    seconds = [row["seconds"] for row in rows]
    per_row = [1e3 * row["seconds"] / row["rows"] for row in rows]
    honest = share(row["honest"] for row in rows if row["honest"] is not None and not row["fault"])
    return [
        ("trials", ", ".join(f"{count} {kind}" for kind, count in Counter(row["kind"] for row in rows).items())),
        ("physics", ", ".join(f"{count} {name}" for name, count in Counter(row["engine"] for row in rows).items())),
        ("diagnosis and prediction, median and most", f"{np.median(seconds):.1f} s, {max(seconds):.1f} s"),
        ("— for 1000 rows, median", f"{np.median(per_row):.2f} s"),
        ("held-out error falls where something is hidden, and stays where nothing is", str(honest)),
        ("without an answer", str(share(bool(row["error"]) for row in rows))),
        *((f"— trial {row['index']}", row["error"]) for row in failed[:5]),
    ]


def story(truth: Row, row: Row) -> Iterator[str]:
    """What happened in a trial, line by line."""
    said = f", made hard by: {truth['edge']}" if truth["edge"] else f", {truth['fault']}" if truth["fault"] else ""
    yield (
        f"{truth['kind'].capitalize()}, physics: {truth['engine']}; arm {truth['arm']}, {truth['rows']} rows at "
        f"{truth['rate']:g} Hz of {truth['source']}, inertial numbers "
        f"{truth['inertial']}; noise {truth['noise']}{said}."
    )
    yield "Hidden:" if truth["hidden"] else "Hidden: nothing"
    for effect, seen in zip(truth["hidden"], row["hidden"], strict=True):
        yield from _hidden_lines(effect, seen)
    yield f"Verdict: {row['verdict']}{', error: ' + row['error'] if row['error'] else ''}"
    for finding in row["findings"]:
        mark = "✓" if finding["true"] else "✗"
        rivals = f"; nearest alternatives: {', '.join(finding['rivals'])}" if finding["rivals"] else ""
        yield f"  {mark} {finding['effect']} at {finding['site']} by {finding['driver'] or 'nothing said'}{rivals}"
    if row["faults"]:
        yield f"Faults of the data: {', '.join(row['faults'])}"
    if row["after_Nm"] is not None and row["before_Nm"] is not None:
        yield f"Held out: {1e3 * row['before_Nm']:.3g} mNm before, {1e3 * row['after_Nm']:.3g} mNm after."
    exact, in_set = ("yes" if row[key] else "no" for key in ("exact", "exact_in_set"))
    yield f"Found exactly: {exact}; within the set of alternatives: {in_set}."
    unseen = "nothing predicted" if row["unseen_Nm"] is None else f"off by {1e3 * row['unseen_Nm']:.3g} mNm RMS"
    yield f"Unseen motion: {unseen}, the bound is {1e3 * row['bound_Nm']:.3g} mNm. {row['seconds']:.1f} s."


def _hidden_lines(effect: Row, seen: Row) -> Iterator[str]:
    values = ", ".join(f"{name} {value:.4g}" for name, value in (effect["parameters"] | effect["fixed"]).items())
    yield f"  {effect['effect']} at {effect['site']}: {values}"
    size = effect["size"]
    if size is None:
        return
    yield (
        f"    {size:.2f} thresholds, {1e3 * effect['moved_Nm']:.3g} mNm RMS over all joints, "
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
