"""The scores as figures: found against size, by effect, honesty of p-values and of intervals, unseen error."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from benchmarks.campaigns.shares import WITHIN, Share, share
from benchmarks.concealed import scores
from benchmarks.concealed.plans import NOISES, SINGLE, SIZES
from benchmarks.concealed.report import best_chance
from benchmarks.concealed.scores import Row

# Okabe and Ito's colours, told apart by the colour-blind (2008)
BLUE, ORANGE, GREEN, RED, GREY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#6b6b6b"
_STYLE: dict[Any, Any] = {
    "font.size": 13,
    "axes.titlesize": 14,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "lines.linewidth": 2,
    "figure.constrained_layout.use": True,
    "savefig.dpi": 110,
    "axes.grid": False,
}


def draw(rows: Sequence[Row], folder: Path) -> Iterator[Path]:
    """Writes the figures for which there are trials, and names them."""
    folder.mkdir(parents=True, exist_ok=True)
    figures: dict[str, Callable[[Sequence[Row]], Figure | None]] = {
        "detection": detection,
        "effects": effects,
        "honesty": honesty,
        "unseen": unseen,
    }
    with plt.rc_context(_STYLE):
        for name, drawn in figures.items():
            figure = drawn(rows)
            if figure is not None:
                path = folder / f"concealed_{name}.png"
                figure.savefig(path)
                plt.close(figure)
                yield path


def detection(rows: Sequence[Row]) -> Figure | None:
    """Detected, and named, against size, with the intervals."""
    sizes = [size for size in sorted(set(SIZES)) if scores.singles(rows, size, size)]
    if not sizes:
        return None
    figure, axes = plt.subplots(figsize=(9, 5.2))
    curves: list[tuple[str, str, str, Callable[[Row], bool], Callable[[Row], bool]]] = [
        ("something detected", BLUE, "o", lambda row: row["detected"], lambda row: True),
        ("the largest finding at the right site", ORANGE, "s", lambda row: row["top_site"], lambda row: True),
        ("right name, or within the set said inseparable", GREEN, "^", lambda row: row["top_in_set"], lambda row: True),
        ("right name, where the data distinguish it", RED, "D", lambda row: row["top_named"], scores.distinguishable),
    ]
    for k, (label, colour, marker, hit, counted) in enumerate(curves):
        shares = [share(hit(row) for row in scores.singles(rows, size, size) if counted(row)) for size in sizes]
        at = np.array(sizes) * 1.025 ** (k - 1.5)
        _with_intervals(axes, at, shares, colour, marker, label)
    power = [_power(size) for size in np.geomspace(min(sizes), max(sizes), 80)]
    axes.plot(np.geomspace(min(sizes), max(sizes), 80), power, color=GREY, lw=1.2, ls="--", zorder=0)
    axes.text(
        max(sizes), 103, "dashed: a test that is told where to look and what for", color=GREY, ha="right", fontsize=11
    )
    axes.axhline(95, color=GREY, lw=0.8, ls=":")
    axes.set_xscale("log")
    axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
    axes.minorticks_off()
    axes.set(
        ylim=(0, 110),
        yticks=range(0, 101, 20),
        xlabel="size of the hidden effect, in detection thresholds",
        ylabel="share of trials (%)",
    )
    count = len([row for row in rows if row["kind"] == "single"])
    axes.set_title(f"One hidden effect, {count} trials: bars are 95 % intervals")
    axes.legend(loc="lower right")
    return figure


def _power(size: float) -> float:
    """In %, of the test by which the threshold is defined, for one number."""
    limit = norm.isf(0.5e-4)
    return 100 * float(norm.sf(limit - size * limit) + norm.cdf(-limit - size * limit))


def _with_intervals(axes: Axes, at: np.ndarray, shares: Sequence[Share], colour: str, marker: str, label: str) -> None:
    there = [k for k, found in enumerate(shares) if found.of]
    at, kept = np.asarray(at)[there], [shares[k] for k in there]
    value = 100 * np.array([found.value for found in kept])
    bars = 100 * np.array([[found.value - found.low, found.high - found.value] for found in kept]).T
    axes.errorbar(at, value, bars, color=colour, marker=marker, ms=8, capsize=3, elinewidth=1.2, label=label)


def effects(rows: Sequence[Row]) -> Figure | None:
    """For each effect and size, the share with any finding and the share that was named or within the set."""
    sizes = [size for size in sorted(set(SIZES)) if scores.singles(rows, size, size)]
    names = [n for n in SINGLE if any(row["hidden"][0]["effect"] == n for row in scores.singles(rows))]
    if not names:
        return None
    figure, panels = plt.subplots(1, 2, figsize=(13, 0.5 * len(names) + 1.8), sharey=True)
    for axes, key, title in zip(
        panels,
        ("detected", "top_in_set"),
        ("Something detected", "Named, or within the set said inseparable"),
        strict=True,
    ):
        table = np.full((len(names), len(sizes)), np.nan)
        for i, name in enumerate(names):
            for j, size in enumerate(sizes):
                found = share(r[key] for r in scores.singles(rows, size, size) if r["hidden"][0]["effect"] == name)
                if found.of:
                    table[i, j] = found.value
                    tone = "white" if found.value > 0.6 else "black"
                    axes.text(j, i, f"{found.hits}/{found.of}", ha="center", va="center", color=tone, fontsize=12)
        axes.imshow(table, cmap="Blues", vmin=0, vmax=1, aspect="auto")
        axes.set_xticks(range(len(sizes)), [f"{size:g}" for size in sizes])
        axes.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
        axes.set(xlabel="size, in detection thresholds", title=title)
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
    return figure


def honesty(rows: Sequence[Row]) -> Figure | None:
    """p-values where nothing is hidden against chance, and errors in stated standard deviations against a Gaussian."""
    clean = [
        (row["noise"] == NOISES[0], p) for row in rows if row["kind"] == "clean" if (p := best_chance(row)) is not None
    ]
    found = scores.numbers([row for row in rows if row["kind"] in ("single", "mixture")], 3.0)
    if not clean and not found:
        return None
    figure, (left, right) = plt.subplots(1, 2, figsize=(13, 5))
    for label, colour, marker, kept in (
        ("noise as declared", BLUE, "o", [p for declared, p in clean if declared]),
        ("noise not as declared", ORANGE, "s", [p for declared, p in clean if not declared]),
    ):
        if kept:
            at = np.clip(np.sort(kept), 1e-6, 1)
            left.plot(
                at,
                np.arange(1, len(at) + 1) / len(at),
                color=colour,
                marker=marker,
                ms=4,
                lw=1,
                label=f"{label}, {len(at)}",
            )
    left.plot([1e-4, 1], [1e-4, 1], color=GREY, ls="--", lw=1.2)
    left.text(2e-3, 4e-3, "as often as it says", color=GREY, rotation=33, fontsize=11, ha="center")
    left.set(xscale="log", yscale="log", xlim=(1e-4, 1.1), ylim=(1e-3, 1.1))
    left.set(xlabel="p of the best candidate, nothing hidden", ylabel="share of trials with less")
    left.set_title("p-values: below the line is cautious")
    if clean:
        left.legend(loc="upper left")
    if found:
        pulls = np.clip([number["off"] / number["std"] for number in found], -5, 5)
        right.hist(pulls, np.linspace(-5, 5, 41), density=True, color=BLUE, alpha=0.75, label=f"{len(pulls)} numbers")
        x = np.linspace(-5, 5, 200)
        right.plot(x, norm.pdf(x), color=GREY, ls="--", lw=1.5, label="if the deviations are honest")
        covered = share(abs(number["off"]) <= WITHIN * number["std"] for number in found)
        right.set_title(f"Numbers: {100 * covered.value:.1f} % within their 95 % interval")
        right.set_ylim(0, 1.25 * right.get_ylim()[1])
        right.legend(loc="upper left")
    right.set(xlabel="error, in stated standard deviations (ends: beyond 5)", ylabel="density")
    return figure


def unseen(rows: Sequence[Row]) -> Figure | None:
    """The error on the unseen motion against the oracle's."""
    named = (("clean", GREY, "."), ("single", BLUE, "o"), ("mixture", ORANGE, "s"))
    kinds = (*named, ("outside", RED, "^"), ("edge", GREEN, "v"))
    figure, axes = plt.subplots(figsize=(7, 6.4))
    lowest, drawn = 1e-3, 0
    for kind, colour, marker in kinds:
        kept = [row for row in rows if row["kind"] == kind and row["unseen_m"] is not None]
        if kept:
            ours = [max(row["unseen_m"] / row["noise_m"], lowest) for row in kept]
            theirs = [max(row["oracle_m"] / row["noise_m"], lowest) for row in kept]
            axes.plot(theirs, ours, marker, color=colour, ms=6, alpha=0.65, label=f"{kind}, {len(kept)}", mew=0)
            drawn += len(kept)
    if not drawn:
        plt.close(figure)
        return None
    top = 10 ** math.ceil(math.log10(max(axes.get_ylim()[1], 2)))
    axes.plot([lowest, top], [lowest, top], color=GREY, ls="--", lw=1.2)
    axes.set(xscale="log", yscale="log", xlim=(lowest * 0.8, top), ylim=(lowest * 0.8, top))
    axes.set_xlabel("a fit that is told the form of the truth")
    axes.set_ylabel("the diagnosis")
    axes.set_title("Error on unseen motion, over the sensor's noise")
    axes.legend(loc="upper left", title="hidden")
    return figure
