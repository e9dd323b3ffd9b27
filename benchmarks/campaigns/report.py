"""The scores of many trials as tables and a figure."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.table import Table
from scipy.stats import norm

from benchmarks.campaigns.campaign import Campaign, Section
from benchmarks.campaigns.detection import ALARM, SEARCHED
from benchmarks.campaigns.judgement import (
    DISTINGUISHED,
    Row,
    covered,
    distinguishable,
    exact_orders,
    numbers,
    share,
    singles,
)

Groups = Iterable[tuple[str, Sequence[Row]]]
Columns = dict[str, str | Callable[[Row], Any]]
"""Of a table of shares: a key of the rows or a function of one; what is None does not count."""

_APART = (0.0, DISTINGUISHED, 8.0, 16.0, math.inf)
"""Standard deviations between which trials outside the catalogue are counted together."""
_ROWS = ((15, 40), (41, 200), (201, 3000))  # the fewest and the most rows of trials at stake that are counted together
_SINGLE: Columns = {
    "something detected": "detected",
    "found, effect and site": "found",
    "right site": "top_site",
    "right name": "top_named",
    "in the set": "top_in_set",
    "exactly this": "exact",
    "right name where the data distinguish it": lambda row: row["top_named"] if distinguishable(row) else None,
}


def sections(campaign: Campaign, rows: Sequence[Row]) -> Iterator[Section]:
    """Every table that has any rows."""
    clean = [row for row in rows if row["kind"] == "clean" and not row["error"]]
    large = singles(rows, 2.0)
    several = [row for row in rows if row["kind"] in ("mixture", "edge")]
    outside = [row for row in rows if row["kind"] == "outside"]
    judged = [row for row in rows if row.get("statement") and row["kind"] in ("outside", "edge")]
    effect, apart = (lambda row, key=key: row["hidden"][0][key] for key in ("effect", "apart"))
    words = {True: "yes", False: "NO", None: "no trials"}
    goals = [(goal.asked, goal.reached, words[goal.met]) for goal in campaign.goals(rows)]
    for title, head, cells in (
        ("Goals", ("goal", "reached, 95 % interval", "met"), goals),
        _shares(
            "Nothing hidden",
            [("all", clean), *_split(clean, "noise"), *_split(clean, "inertial")],
            {
                "something found": "detected",
                "a data fault": lambda row: any(fault not in ("outliers", "torque_spikes") for fault in row["faults"]),
                "best p below 0.05": lambda row: None if (p := best_chance(row)) is None else p < 0.05,
            },
        ),
        _shares("One effect hidden, by size", _split(singles(rows), "planned_size"), _SINGLE),
        _shares(
            "One effect hidden, twice the threshold or more",
            [*_split(large, effect), *_split(large, "engine")],
            _SINGLE,
        ),
        _shares(
            "Several hidden",
            [
                *_split([row for row in several if not row["edge"]], lambda row: f"{len(row['hidden'])} effects"),
                *_split([row for row in several if row["edge"]], "edge"),
            ],
            {"all found": "found", "all and no more": "exact", "in the set": "exact_in_set"},
        ),
        _shares(
            "What is said outside the catalogue and at its edge",
            [
                ("all", judged),
                *_split(judged, "kind"),
                *((f"{a} to {b} rows", [row for row in judged if a <= row["rows"] <= b]) for a, b in _ROWS),
            ],
            {grade: lambda row, grade=grade: row["statement"] == grade for grade in ("right", "partial", "misleading")},
        ),
        _shares(
            "Outside the catalogue",
            [
                ("all", outside),
                *_split(outside, effect),
                *_split(outside, lambda row: f"× {row['planned_size']:g}"),
                *(
                    (f"{a:g} to {b:g} standard deviations from what is nearest", found)
                    for a, b in pairwise(_APART)
                    if (found := [row for row in outside if (at := apart(row)) is not None and a <= at < b])
                ),
            ],
            {
                "something found": "detected",
                "at its site": lambda row: row["hidden"][0]["site_found"],
                "unnamed, by its driver": lambda row: row["hidden"][0]["named"],
                "misleading": lambda row: (
                    row["wrong_name"] if "wrong_name" in row else row["statement"] == "misleading"
                ),
            },
        ),
        _shares(
            "Something wrong with the data",
            _split([row for row in rows if row["fault"]], "fault"),
            {"found": "fault_found", "and nothing else but what is hidden": "exact_in_set"},
        ),
        _numbers(rows, campaign.known),
        campaign.unseen(rows),
        _run(rows),
    ):
        if cells:
            yield title, head, cells


def _shares(title: str, groups: Groups, columns: Columns) -> Section:
    """A table of shares with their intervals, a row a group that has any trials."""
    cells = []
    for label, rows in groups:
        flags = (
            [flag for row in rows if (flag := row[of] if isinstance(of, str) else of(row)) is not None]
            for of in columns.values()
        )
        if rows:
            found = [share(each) for each in flags]
            cells.append((label, str(len(rows)), *(s.short if s.of == len(rows) else str(s) for s in found)))
    return title, ("", "trials", *columns), cells


def _split(rows: Sequence[Row], of: str | Callable[[Row], Any]) -> list[tuple[str, list[Row]]]:
    """Rows by what a key or a function says of them, in order; none where the rows do not have the key."""
    found: dict[Any, list[Row]] = {}
    for row in rows:
        said = row.get(of) if isinstance(of, str) else of(row)
        if said is not None:
            found.setdefault(said, []).append(row)
    return [(f"{said:g}" if isinstance(said, float) else str(said), found[said]) for said in sorted(found)]


def best_chance(row: Row) -> float | None:
    """The smallest p-value of a trial: of what was found, or of the best candidate that was not taken."""
    said = [finding["p_value"] for finding in row["findings"]]
    said += [row["nearest_p"]] if row.get("nearest_p") is not None else []
    return min(said) if said else None


def _numbers(rows: Sequence[Row], known: float) -> Section:
    title = f"Numbers of effects that were named, from {known:g} thresholds on"
    named = [row for row in rows if row["kind"] in ("single", "mixture")]
    found = numbers(named, known)
    if not found:
        return title, (), ()
    off, std, bound = (np.array([number[key] for number in found]) for key in ("off", "std", "bound"))
    bounded = bound > 0
    cells = [
        ("within their 95 % interval", str(covered(rows, known))),
        *((f"— {name}", str(covered(each, known))) for name, each in _split(named, "engine") if numbers(each, known)),
        ("orders stated as exact that are", str(exact_orders(named, known))),
        ("error over its standard deviation, median size (0.67 if honest)", f"{np.median(abs(off / std)):.2f}"),
    ]
    if bounded.any():
        over = np.median(abs(off[bounded] / bound[bounded])), np.median(std[bounded] / bound[bounded])
        cells.append(("error over the Cramér–Rao bound, median size (0.67 if efficient)", f"{over[0]:.2f}"))
        cells.append(("stated standard deviation over the Cramér–Rao bound, median", f"{over[1]:.2f}"))
    return title, ("", "value"), cells


def _run(rows: Sequence[Row]) -> Section:
    if not rows:
        return "The run", (), ()
    failed, seconds = [row for row in rows if row["error"]], [row["seconds"] for row in rows]
    counted = (Counter(row[key] for row in rows) for key in ("kind", "engine"))
    kinds, engines = (", ".join(f"{count} {name}" for name, count in found.items()) for found in counted)
    cells = [
        ("trials", kinds),
        ("physics", engines),
        ("diagnosis and prediction, median and most", f"{np.median(seconds):.1f} s, {max(seconds):.1f} s"),
        ("without an answer", str(share(bool(row["error"]) for row in rows))),
        *((f"— trial {row['index']}", row["error"]) for row in failed[:5]),
    ]
    return "The run", ("", ""), cells


def tables(shown: Iterable[Section]) -> Iterator[Table]:
    """For the terminal."""
    for title, head, cells in shown:
        table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
        for name in head:
            table.add_column(name, overflow="fold")
        for row in cells:
            table.add_row(*row, style="red" if row[-1] == "NO" else None)
        yield table


def markdown(shown: Iterable[Section]) -> str:
    """For documents."""
    parts = []
    for title, head, cells in shown:
        lines = [f"**{title}**", "", f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
        lines += [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in cells]
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


# Okabe and Ito's colours, told apart by the colour-blind (2008)
_BLUE, _ORANGE, _GREEN, _RED, _GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#6b6b6b"


def draw_detection(rows: Sequence[Row], path: Path) -> Path:
    """Draws the shares of single effects that were found, placed and named, over their size, with the intervals."""
    import matplotlib.pyplot as plt  # takes a while to load

    sizes = sorted({row["planned_size"] for row in singles(rows)})
    curves: list[tuple[str, str, str, Callable[[Row], Any]]] = [
        ("something detected", _BLUE, "o", lambda row: row["detected"]),
        ("the largest finding at the right site", _ORANGE, "s", lambda row: row["top_site"]),
        ("right name, or within the set said inseparable", _GREEN, "^", lambda row: row["top_in_set"]),
        ("right name, where the data distinguish it", _RED, "D", _SINGLE["right name where the data distinguish it"]),  # type: ignore[list-item]
    ]
    plain: dict[Any, Any] = dict.fromkeys(("axes.spines.top", "axes.spines.right", "legend.frameon"), False)
    plain["font.size"] = 13
    with plt.rc_context(plain):
        figure, axes = plt.subplots(figsize=(9, 5.2), layout="constrained")
        for k, (label, colour, marker, hit) in enumerate(curves):
            found = [share(f for row in singles(rows, s, s) if (f := hit(row)) is not None) for s in sizes]
            there = [(size, each) for size, each in zip(sizes, found, strict=True) if each.of]
            at = np.array([size for size, _ in there]) * 1.025 ** (k - 1.5)
            value, low, high = 100 * np.array([(s.value, s.low, s.high) for _, s in there]).reshape(-1, 3).T
            style: Any = {"color": colour, "marker": marker, "ms": 8, "capsize": 3, "lw": 2, "elinewidth": 1.2}
            axes.errorbar(at, value, [value - low, high - value], label=label, **style)
        if sizes:
            at = np.geomspace(min(sizes), max(sizes), 80)
            limit = norm.isf(ALARM / SEARCHED / 2)
            power = 100 * (norm.sf(limit - at * limit) + norm.cdf(-limit - at * limit))
            axes.plot(at, power, color=_GREY, lw=1.2, ls="--", label="a test that is told where to look and what for")
        axes.axhline(95, color=_GREY, lw=0.8, ls=":")
        axes.set_xscale("log")
        axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
        axes.minorticks_off()
        axes.set(ylim=(0, 110), ylabel="share of trials (%)")
        axes.set_xlabel("size of the hidden effect, in detection thresholds")
        axes.set_title(f"One hidden effect, {len(singles(rows))} trials: bars are 95 % intervals", loc="left")
        axes.legend(loc="lower right")
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=110)
        plt.close(figure)
    return path
