"""Each finding's fitted curve with its uncertainty, over what the data without it show at its site."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.domains.pose.problem import Case
from lite6jax.effects.deflection import Deflection
from lite6jax.effects.drivers import Driver
from lite6jax.effects.effect import Bending, Effect
from lite6jax.effects.kinematic.joints import JointHarmonic
from lite6jax.effects.motion import Motion, motion_of
from lite6jax.effects.nonparametric import Unnamed
from lite6jax.effects.statics import Loads
from lite6jax.estimation.least_squares import Fitted
from lite6jax.report.canvas import AFTER, STYLE, degree_ticks, thinned
from lite6jax.report.panels import BINS, GREY, legend_below, medians, panels_in_rows

Array = NDArray[np.floating]

_MANY_TURNS = 8
"""Periods of a harmonic over a joint's range, beyond which it is drawn over one period."""
_POINTS_PER_WAVE = 16
_SAMPLES_PER_BIN = 12
_BINS_PER_WAVE = 4
_SCREEN = {"rad": (180 / np.pi, "deg"), "rad/s": (180 / np.pi, "deg/s"), "1": (1.0, ""), "m": (1e3, "mm")}
"""Of drivers."""
_MOVES = {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "1": (1e6, "ppm")}
"""Of deflections, which are small."""


def finding_curves(found: Diagnosis, title: str, chosen: Sequence[int] | None = None) -> Figure:
    """Each finding's curve with two standard deviations, over what the data without it show at its site.

    Args:
        found: with findings.
        title: of the figure.
        chosen: which findings, from 0; all where not given.
    """
    steps = found.selection.steps
    chosen = range(len(steps)) if chosen is None else chosen
    shown = [(k, part) for k in chosen for part in _views(found, k)]
    with rc_context(STYLE):
        figure, panels = panels_in_rows(len(shown), wide=True)
        for panel, (k, view) in zip(panels, shown, strict=True):
            _draw_view(panel, view)
            panel.set_title(f"{k + 1}. {steps[k].effect.name.replace('_', ' ')}, {steps[k].effect.site}", fontsize=13)
        panels[0].plot([], [], color=AFTER, linewidth=2.5, label="fitted")
        if all(view.loops for _, view in shown):
            panels[0].plot([], [], ".", color=GREY, markersize=8, label="data")
        else:
            panels[0].fill_between([], [], [], color=AFTER, alpha=0.3, linewidth=0, label="± 2 std. deviations")
            panels[0].errorbar([], [], [], fmt="o", color="black", capsize=3, label="data: medians ± std. error")
        legend_below(figure, panels[0], 3)
        figure.suptitle(title, fontsize=15)
    return figure


class _View(NamedTuple):
    """A finding over one driver, on the screen's units: the data `(sample,)`, and the curve `(point,)` in order.

    Medians are of `bins` bins: as many as a curve of many waves needs to be followed. What loops is no curve over the
    driver: it has a point at each sample.
    """

    driver: Array
    seen: Array
    at: Array
    curve: Array
    std: Array
    across: str
    up: str
    angle: bool
    discrete: bool
    bins: int = BINS
    loops: bool = False


def _views(found: Diagnosis, k: int) -> list[_View]:
    """A finding over its driver, a panel for each way in which it moves a site."""
    case, fitted = found.selection.case, found.selection.fitted
    effect, part = fitted.physics.effects[k], fitted.physics.slices[k]
    values, covariance = fitted.values[part], fitted.covariance[part, part]
    used = fitted.used & ~found.outliers
    views = []
    if isinstance(effect, Bending):
        for keys, shape, jacobian in _moves(case, effect, values):
            site = np.sum([case.sites[key] for key in keys], 0)
            view = _over_driver(
                case, effect, values, covariance, keys[0], site, shape, jacobian, fitted.residual.rows, used
            )
            views += [] if view is None else [view]
        if effect.drivers and views and len(views) <= 3:
            return views
        if effect.site.startswith("joint") and views:
            return views
    without = np.array(fitted.values)
    without[part] = 0.0
    rows = case.residual(fitted.moved, fitted.physics, without)
    return [_along(case, fitted, effect, part, rows, used)]


def _moves(case: Case, effect: Bending, values: Array) -> list[tuple[list[tuple[str, int, int]], Array, Array]]:
    """What an effect does: sites that move alike, how far `(sample,)`, and that by its numbers `(sample, number)`."""
    bent, by_number = _deflected(effect, values, case.motion, case.loads)
    groups: list[tuple[list[tuple[str, int, int]], Array, Array]] = []
    for field, moved, slope in zip(Deflection._fields, bent, by_number, strict=True):
        if moved is None or slope is None:
            continue
        flat, slopes = np.asarray(moved).reshape(-1, moved.shape[-1]), np.asarray(slope).reshape(-1, *slope.shape[-2:])
        for i in np.flatnonzero(flat.any(-1)):
            j, component = divmod(int(i), 6) if moved.ndim == 3 else (int(i), 0)
            key = (field, 0, int(i)) if field in ("base", "tool") else (field, j, component)
            alike = next((g for g in groups if g[0][0][0] == field == "stretch" and np.allclose(g[1], flat[i])), None)
            if alike:
                alike[0].append(key)
            else:
                groups.append(([key], flat[i], slopes[i]))
    return groups


def _deflected(effect: Bending, values: Array, motion: Motion, loads: Loads | None) -> tuple[Deflection, Deflection]:
    """A deflection and its derivative by the effect's numbers, the last axis."""

    def deflect(v: jax.Array) -> Deflection:
        return effect.deflect(v, motion, loads)

    at = jnp.asarray(values)
    bent, by_number = deflect(at), jax.jacfwd(deflect)(at)
    plain = [Deflection(*(None if a is None else np.asarray(a) for a in d)) for d in (bent, by_number)]  # type: ignore[arg-type]
    return plain[0], plain[1]


def _over_driver(
    case: Case, effect: Bending, values: Array, covariance: Array, key: tuple[str, int, int], site: Array,
    shape: Array, jacobian: Array, rows: Array, used: NDArray[np.bool_],
) -> _View | None:  # fmt: skip
    """The curve of one site over the driver that it follows; None where it follows none.

    The data are partial residuals, what `rows` leave with the curve put back: the effect's other components and other
    effects do not show in them.
    """
    at_joint = key[0] == "joint"
    choices = effect.drivers or ((Driver("position", key[1] + 1),) if at_joint else ())
    if not choices:
        return None
    known = [np.asarray(driver.values(case.motion, case.loads), float) for driver in choices]
    follows = [0.0 if np.ptp(v) == 0 or np.ptp(shape) == 0 else abs(np.corrcoef(v, shape)[0, 1]) for v in known]
    best = int(np.argmax(follows))
    driver, x = choices[best], known[best]
    if len(choices) > 1 and follows[best] < 0.9999:
        return None
    power = np.sum(site**2, 0)
    seen = shape - np.sum(site * rows, 0) / np.where(power > 0, power, np.inf)
    spread = np.sqrt(1 / np.where(power > 0, power, np.finfo(float).tiny))
    good = used & (spread < 4 * np.median(spread))  # where the sensor sees this site move
    unit = "m" if key[0] in ("link", "base", "tool") and key[2] < 3 else "rad"
    scale, name = _MOVES["1" if key[0] in ("stretch", "scale") else unit]
    at, curve, slope = x, shape, jacobian
    waves = max(effect.orders, default=0.0) * np.ptp(x) / (2 * np.pi) if isinstance(effect, Unnamed) else 0.0
    loops = isinstance(effect, Unnamed) and bool(effect.memory)
    if isinstance(effect, Unnamed) and not loops:
        at = np.linspace(x.min(), x.max(), max(400, int(_POINTS_PER_WAVE * waves)))
        slope = np.asarray(effect.basis(jnp.asarray(at))).T
        curve = slope @ values
    elif not loops and driver.quantity == "position" and at_joint:
        at = np.linspace(x.min(), x.max(), 1000)
        q = np.zeros((len(at), case.motion.dof))
        q[:, driver.place - 1] = at
        if isinstance(effect, JointHarmonic) or len(effect.drivers) <= 1:
            bent, by_number = _deflected(effect, values, motion_of(q), None)
            assert bent.joint is not None
            assert by_number.joint is not None
            curve, slope = np.asarray(bent.joint)[key[1]], np.asarray(by_number.joint)[key[1]]
    std = np.sqrt(np.maximum(np.einsum("si,ij,sj->s", slope, covariance, slope), 0.0))
    per, unit = _SCREEN.get(driver.unit, (1.0, driver.unit))
    across = f"{driver.phrase} ({unit})" if unit else driver.phrase
    turns = effect.order * np.ptp(x) / (2 * np.pi) if isinstance(effect, JointHarmonic) and effect.order else 0.0
    if turns > _MANY_TURNS:
        assert isinstance(effect, JointHarmonic)
        assert effect.order is not None
        x, at = (np.mod(effect.order * v, 2 * np.pi) for v in (x, at))
        across = f"phase of order {effect.order:.4g} of joint {effect.joint} (deg)"
    order = np.argsort(at, kind="stable")
    what = {"joint": "turn of the joint", "stretch": "growth of the links", "scale": "growth"}.get(
        key[0], f"{'shift' if key[2] < 3 else 'turn'} about {'xyz'[key[2] % 3]}".replace("shift about", "shift along")
    )
    return _View(
        per * x[good], scale * seen[good], per * at[order], scale * curve[order], scale * std[order], across,
        f"{what} ({name})", unit == "deg", driver.quantity == "direction of motion",
        int(np.clip(_BINS_PER_WAVE * waves, BINS, max(len(x) // _SAMPLES_PER_BIN, BINS))), loops,
    )  # fmt: skip


def _along(case: Case, fitted: Fitted, effect: Effect, part: slice, rows: Array, used: NDArray[np.bool_]) -> _View:
    """What is seen of an effect along the way in which it moves each measured pose, against how far it does."""
    columns = case.columns([effect], fitted.values[part])
    scale, unit = 1.0, "std. deviations of the sensor"
    if case.measured.whitener.ndim == 1 and np.sum(columns[:, :3] ** 2) > 0.5 * np.sum(columns**2):
        columns, rows = columns[:, :3], rows[:3]
        scale, unit = 1e3 / float(case.measured.whitener[0]), "mm"
    moved = np.tensordot(fitted.values[part], columns, 1)
    size = np.sqrt(np.sum(moved**2, 0))
    safe = np.where(size > 0, size, np.inf)
    seen = -np.sum(moved * rows, 0) / safe
    along = np.sum(columns * moved, 1) / safe
    std = np.sqrt(np.maximum(np.einsum("is,ij,js->s", along, fitted.covariance[part, part], along), 0.0))
    good = used & (size > 0)
    x, across = scale * size, f"pose displaced by it, as fitted ({unit})"
    if np.ptp(size[good]) < 1e-3 * size.max():  # the same everywhere
        x, across = case.recording.row.astype(float), "row of the recording"
    order = np.argsort(x, kind="stable")
    curve, std = scale * size[order], scale * std[order]
    return _View(x[good], scale * seen[good], x[order], curve, std, across, f"as seen ({unit})", False, False)


def _draw_view(panel: Axes, view: _View) -> None:
    shown = thinned(len(view.seen))
    panel.plot(
        view.driver[shown], view.seen[shown], ".", color=GREY, markersize=5, alpha=0.4, markeredgewidth=0,
        rasterized=True, zorder=2,
    )  # fmt: skip
    if view.loops:
        panel.plot(view.at, view.curve, ".", color=AFTER, markersize=5, zorder=4)
        panel.set(xlabel=view.across, ylabel=view.up)
        return
    panel.fill_between(
        view.at, view.curve - 2 * view.std, view.curve + 2 * view.std, color=AFTER, alpha=0.3, linewidth=0, zorder=3
    )
    many = view.bins > BINS
    panel.plot(view.at, view.curve, color=AFTER, linewidth=1.5 if many else 2.5, zorder=4)
    at, middle, error = medians(view.driver, view.seen, 3 if view.discrete else view.bins)
    panel.errorbar(
        at, middle, error, fmt="o", color="black", markersize=3 if many else 5, capsize=0 if many else 3, zorder=5
    )
    inner = np.percentile(view.seen, (1, 99)) if len(view.seen) else np.zeros(2)
    low, high = min(inner[0], view.curve.min(), 0.0), max(inner[1], view.curve.max(), 0.0)
    panel.set_ylim(low - 0.1 * (high - low or 1.0), high + 0.1 * (high - low or 1.0))
    panel.set(xlabel=view.across, ylabel=view.up)
    if view.discrete:
        panel.set_xticks((-1, 0, 1))
    elif view.angle:
        panel.xaxis.set_major_locator(degree_ticks(panel))
    else:
        panel.xaxis.set_major_locator(MaxNLocator(4))
