"""Figures of a diagnosis: errors before and after, where and which orders, findings over the data, what is left."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray
from scipy.stats import chi2

from lite6jax.diagnosis.case import Case
from lite6jax.diagnosis.diagnose import Diagnosis
from lite6jax.diagnosis.evidence import Evidence, Score, evidence_of
from lite6jax.diagnosis.refit import Fitted
from lite6jax.diagnosis.selection import LEVEL
from lite6jax.diagnosis.spectrum import spectrum
from lite6jax.physics.deflection import Deflection
from lite6jax.physics.drivers import Driver
from lite6jax.physics.effect import Bending, Effect
from lite6jax.physics.joints import JointHarmonic
from lite6jax.physics.motion import Motion, motion_of
from lite6jax.physics.statics import Loads
from lite6jax.physics.unnamed import Unnamed, spline_basis
from lite6jax.report.canvas import AFTER, BEFORE, FRAMED, STYLE, blank, degree_ticks, thinned

Array = NDArray[np.floating]

NAMES = ("error_by_joint", "where", "orders", "findings", "remaining")
"""What `drawings` may give."""

_BINS = 20
_LEAST_IN_BIN = 5
_PIECES = 8
"""Of the free-form curves of the map."""
_EXACT_BELOW = 12.0
"""Orders under which the nuisance is projected out of the spectrum."""
_MANY_TURNS = 8
"""Periods of a harmonic over a joint's range, beyond which it is drawn over one period."""
_LAGS = 40
_GREY = "#8a8a8a"

_PER_JOINT = {
    "position": "position",
    "direction of motion": "direction\nof motion",
    "velocity": "velocity",
    "gravity torque": "gravity\nload",
}
_OF_ALL = {"temperature rise": "temperature", "time": "time", "payload": "payload"}
_SCREEN = {"rad": (180 / np.pi, "deg"), "rad/s": (180 / np.pi, "deg/s"), "1": (1.0, ""), "m": (1e3, "mm")}
"""Of drivers."""
_MOVES = {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "1": (1e6, "ppm")}
"""Of deflections, which are small."""


def drawings(found: Diagnosis, title: str) -> Iterator[tuple[str, Figure]]:
    """Every figure by its name, one of `NAMES`; without findings none of these is drawn."""
    yield "error_by_joint", error_by_joint(found, title)
    yield "where", explained_map(found, title)
    yield "orders", order_spectrum(found, title)
    if found.selection.steps:
        yield "findings", finding_curves(found, title)
    yield "remaining", remaining(found, title)


def error_by_joint(found: Diagnosis, title: str) -> Figure:
    """Held-out position error against each joint, before and after; lines are medians."""
    kept = ~found.outliers & np.isfinite(found.before) & np.isfinite(found.after)
    q = np.rad2deg(np.asarray(found.case.motion.joint_position)[:, kept])
    both = [
        (name, 1e3 * e[kept], c) for name, e, c in (("before", found.before, BEFORE), ("after", found.after, AFTER))
    ]
    with rc_context(STYLE):
        figure, panels = _grid(len(q), shared=True)
        shown = thinned(q.shape[1])
        for joint, panel in enumerate(panels):
            for _, error, colour in both:
                panel.plot(
                    q[joint, shown], error[shown], ".", color=colour, markersize=5, alpha=0.35, markeredgewidth=0,
                    rasterized=True, zorder=3,
                )  # fmt: skip
                at, middle, _ = _medians(q[joint], error)
                panel.plot(at, middle, color=colour, linewidth=2.5, zorder=5)
            panel.set_xlabel(f"joint {joint + 1} (deg)")
            panel.xaxis.set_major_locator(degree_ticks(panel))
            if panel.get_subplotspec().is_first_col():  # type: ignore[union-attr]
                panel.set_ylabel("position error (mm)")
        top = max((float(np.percentile(error, 99.5)) for _, error, _ in both if len(error)), default=1.0)
        panels[0].set_ylim(0, 1.1 * top or 1.0)
        for name, error, colour in both:
            rms = float(np.sqrt(np.mean(error**2))) if len(error) else 0.0
            panels[0].plot([], [], "-o", color=colour, linewidth=2.5, label=f"{name}: {rms:.3g} mm RMS, held out")
        _legend(figure, panels[0], 2)
        figure.suptitle(f"{title}: position error before and after", fontsize=15)
    return figure


def explained_map(found: Diagnosis, title: str) -> Figure:
    """How much of what the baseline leaves a free-form curve over each driver explains at each joint and the base."""
    rows, columns, shares = explained_shares(found)
    with rc_context(FRAMED):
        figure = blank(3.5 + 1.35 * len(columns), 2.2 + 0.62 * len(rows))
        panel = figure.subplots()
        colours = panel.imshow(
            np.ma.masked_invalid(100 * shares), cmap="cividis", vmin=0, vmax=100, aspect="auto", interpolation="nearest"
        )
        panel.set_facecolor("#eeeeee")  # of what is masked
        for (i, j), share in np.ndenumerate(shares):
            text, colour = "–", _GREY
            if np.isfinite(share):
                text, colour = f"{100 * share:.0f}", "black" if share > 0.55 else "white"
            panel.text(j, i, text, ha="center", va="center", color=colour, fontsize=14)
        panel.set_xticks(range(len(columns)), columns)
        panel.set_yticks(range(len(rows)), rows)
        panel.set(xlabel="driver of the curve", ylabel="site")
        panel.tick_params(length=0)
        figure.colorbar(colours, label="residual explained (%)")
        figure.suptitle(f"{title}: where the mismatch is", fontsize=15)
    return figure


def explained_shares(found: Diagnosis) -> tuple[list[str], list[str], Array]:
    """Names of sites and of drivers, and the share of the baseline residual's variance that a curve explains there.

    Returns:
        Sites, drivers, and `(site, driver)` shares from 0 to 1 less what as many numbers explain of noise; NaN where
        the driver is not known, does not vary, or where the nuisance can do the same.
    """
    case = found.selection.case
    evidence = evidence_of(case, found.selection.baseline)
    dof = case.motion.dof
    total = _left(evidence)

    def basis(driver: Driver, pieces: int) -> Array | None:
        if (driver.loaded and case.loads is None) or not driver.known(case.motion, case.loads):
            return None
        values = driver.values(case.motion, case.loads)
        if float(jnp.ptp(values)) < 1e-6:
            return None
        return np.asarray(spline_basis(values, float(values.min()), float(values.max()), pieces))

    def share(groups: Sequence[Array]) -> float:
        score = evidence.score_columns([np.concatenate(groups)])[0] if groups else None
        return np.nan if score is None or score.hidden else _adjusted(score, total, evidence.freedom)

    def at_site(keys: Sequence[tuple[str, int, int]], driver: Driver) -> list[Array]:
        curves = basis(driver, 1 if driver.quantity == "direction of motion" else _PIECES)
        return [] if curves is None else [case.sites[key] * curves[:, None] for key in keys]

    columns = {**_PER_JOINT, **_OF_ALL}
    shares = np.full((dof + 1, len(columns)), np.nan)
    for j, quantity in enumerate(columns):
        alone = quantity in _OF_ALL
        for i in range(dof):
            shares[i, j] = share(at_site([("joint", i, 0)], Driver(quantity, 0 if alone else i + 1)))
        if alone:
            shares[dof, j] = share(at_site([("base", 0, k) for k in range(6)], Driver(quantity)))
        elif quantity == "gravity torque":
            pairs = (("x", 3), ("y", 4))
            parts = [at_site([("base", 0, k)], Driver(f"base moment {axis}")) for axis, k in pairs]
            shares[dof, j] = share([part for found_parts in parts for part in found_parts])
    known = np.any(np.isfinite(shares), axis=0, keepdims=True)[0]
    known[0] = True
    rows = [*(f"joint {i + 1}" for i in range(dof)), "base"]
    return rows, [name for name, there in zip(columns.values(), known, strict=True) if there], shares[:, known]


def order_spectrum(found: Diagnosis, title: str) -> Figure:
    """What a harmonic of each order of each joint's angle explains, of the baseline's residual and of what is left."""
    selection = found.selection
    case = selection.case
    dof = case.motion.dof
    both = [(evidence_of(case, fitted), c) for fitted, c in _stages(found)]
    with rc_context(STYLE):
        figure, panels = _grid(dof, shared=True)
        noise = 0.0
        for joint, panel in enumerate(panels, 1):
            for evidence, colour in both:
                orders, shares = _spectrum(evidence, joint)
                panel.plot(orders, 100 * shares, color=colour, linewidth=1.4, zorder=3, rasterized=len(orders) > 3000)
                noise = float(chi2.isf(LEVEL / (dof * len(orders) / 2), 2)) / _left(evidence)
            panel.axhline(100 * noise, color="black", linestyle=":", linewidth=1.8, zorder=4)
            if not case.sites["joint", joint - 1, 0].any():
                panel.text(0.5, 0.5, "not seen by the sensor", ha="center", color=_GREY, transform=panel.transAxes)
            for step in selection.steps:
                if isinstance(step.effect, JointHarmonic) and step.effect.joint == joint and step.effect.order:
                    panel.axvline(step.effect.order, color="black", linestyle="--", linewidth=1.8, zorder=2)
                    panel.text(
                        step.effect.order, 0.97, f" {step.effect.order:.4g}", fontsize=13, fontweight="bold", va="top",
                        transform=panel.get_xaxis_transform(), ha="left" if step.effect.order < 60 else "right",
                    )  # fmt: skip
            panel.set_xscale("log")
            panel.set_yscale("log")
            panel.set_xlabel(f"order, of joint {joint}'s angle")
            panel.xaxis.set_major_locator(FixedLocator([1, 2, 5, 10, 20, 50, 100, 200]))
            panel.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
            panel.xaxis.set_minor_formatter(NullFormatter())
            panel.set_xlim(1, 200)
            if panel.get_subplotspec().is_first_col():  # type: ignore[union-attr]
                panel.set_ylabel("residual explained (%)")
        panels[0].set_ylim(max(3.0 * noise, 1e-3), 150)
        panels[0].yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        for name, (_, colour) in zip(("before", "after"), both, strict=False):
            panels[0].plot([], [], color=colour, linewidth=2.5, label=name)
        panels[0].plot(
            [], [], ":", color="black", linewidth=1.8, label=f"noise reaches this once in {1 / LEVEL:.0f} recordings"
        )
        if any(isinstance(step.effect, JointHarmonic) for step in selection.steps):
            panels[0].plot([], [], "--", color="black", linewidth=1.8, label="order found")
        _legend(figure, panels[0], 4)
        figure.suptitle(f"{title}: orders of the joints' angles", fontsize=15)
    return figure


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
        figure, panels = _grid(len(shown), wide=True)
        for panel, (k, view) in zip(panels, shown, strict=True):
            _draw_view(panel, view)
            panel.set_title(f"{k + 1}. {steps[k].effect.name.replace('_', ' ')}, {steps[k].effect.site}", fontsize=13)
        panels[0].plot([], [], color=AFTER, linewidth=2.5, label="fitted")
        panels[0].fill_between([], [], [], color=AFTER, alpha=0.3, linewidth=0, label="± 2 std. deviations")
        panels[0].errorbar([], [], [], fmt="o", color="black", capsize=3, label="data: medians ± std. error")
        _legend(figure, panels[0], 3)
        figure.suptitle(title, fontsize=15)
    return figure


def remaining(found: Diagnosis, title: str) -> Figure:
    """What is left against the sensor's noise: how large it is, and whether neighbouring rows are alike."""
    case = found.selection.case
    kept = ~found.outliers
    declared = case.declared
    with rc_context(STYLE):
        figure = blank(12.0, 5.0)
        left, right = figure.subplots(1, 2)
        bins = np.linspace(-5, 5, 61)
        for (fitted, colour), name in zip(_stages(found), ("before", "after"), strict=False):
            rows = fitted.residual.rows[:, kept]
            unit = 1.0 if declared else found.selection.fitted.residual.scale
            heights = np.histogram(rows / unit, bins)[0] / max(rows.size, 1) / (bins[1] - bins[0])
            rms = float(np.sqrt(np.mean((rows / unit) ** 2)))
            left.stairs(heights, bins, color=colour, linewidth=2, label=f"{name}: {rms:.3g} RMS")
            lags, alike = _autocorrelation(rows)
            right.plot(lags, alike, "-o", color=colour, markersize=5, linewidth=1.5)
        at = np.linspace(-5, 5, 201)
        left.plot(at, np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi), "--", color="black", linewidth=2, label="noise alone")
        left.set(
            xlabel="residual over the declared noise" if declared else "residual over the estimated noise",
            ylabel="density",
            xlim=(-5, 5),
        )
        left.set_ylim(0, 1.5 * left.get_ylim()[1])
        left.legend(frameon=False, loc="upper right")
        bound = 2 / np.sqrt(case.rows * max(int(kept.sum()), 1))
        right.axhspan(-bound, bound, color="black", alpha=0.15, linewidth=0)
        right.axhline(0, color="black", linewidth=1)
        right.plot([], [], color="black", alpha=0.15, linewidth=9, label="noise alone, 95 %")
        right.set(xlabel="rows apart", ylabel="correlation of the residuals")
        low, high = right.get_ylim()
        right.set_ylim(min(low, -0.3), min(max(high, 0.3) + 0.1, 1.1))
        right.legend(frameon=False, loc="upper right")
        figure.suptitle(f"{title}: what is left, against the sensor's noise", fontsize=15)
    return figure


class _View(NamedTuple):
    """A finding over one driver, on the screen's units: the data `(sample,)`, and the curve `(point,)` in order."""

    driver: Array
    seen: Array
    at: Array
    curve: Array
    std: Array
    across: str
    up: str
    angle: bool
    discrete: bool


def _stages(found: Diagnosis) -> list[tuple[Fitted, str]]:
    selection = found.selection
    return [(selection.baseline, BEFORE), *([(selection.fitted, AFTER)] if selection.steps else [])]


def _views(found: Diagnosis, k: int) -> list[_View]:
    """A finding over its driver, a panel for each way in which it moves a site."""
    case, fitted = found.selection.case, found.selection.fitted
    effect, part = fitted.physics.effects[k], fitted.physics.slices[k]
    values, covariance = fitted.values[part], fitted.covariance[part, part]
    without = np.array(fitted.values)
    without[part] = 0.0
    rows = case.residual(fitted.moved, fitted.physics, without)
    used = fitted.used & ~found.outliers
    views = []
    if isinstance(effect, Bending):
        for keys, shape, jacobian in _moves(case, effect, values):
            site = np.sum([case.sites[key] for key in keys], 0)
            view = _over_driver(case, effect, values, covariance, keys[0], site, shape, jacobian, rows, used)
            views += [] if view is None else [view]
        if effect.drivers and views and len(views) <= 3:
            return views
        if effect.site.startswith("joint") and views:
            return views
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
    """The curve of one site over the driver that it follows; None where it follows none."""
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
    seen = -np.sum(site * rows, 0) / np.where(power > 0, power, np.inf)
    spread = np.sqrt(1 / np.where(power > 0, power, np.finfo(float).tiny))
    good = used & (spread < 4 * np.median(spread))  # where the sensor sees this site move
    unit = "m" if key[0] in ("link", "base", "tool") and key[2] < 3 else "rad"
    scale, name = _MOVES["1" if key[0] in ("stretch", "scale") else unit]
    at, curve, slope = x, shape, jacobian
    if isinstance(effect, Unnamed):
        at = np.linspace(effect.lower, effect.upper, 400)
        slope = np.asarray(effect.basis(jnp.asarray(at))).T
        curve = slope @ values
    elif driver.quantity == "position" and at_joint:
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
        view.driver[shown], view.seen[shown], ".", color=_GREY, markersize=5, alpha=0.4, markeredgewidth=0,
        rasterized=True, zorder=2,
    )  # fmt: skip
    panel.fill_between(
        view.at, view.curve - 2 * view.std, view.curve + 2 * view.std, color=AFTER, alpha=0.3, linewidth=0, zorder=3
    )
    panel.plot(view.at, view.curve, color=AFTER, linewidth=2.5, zorder=4)
    at, middle, error = _medians(view.driver, view.seen, 3 if view.discrete else _BINS)
    panel.errorbar(at, middle, error, fmt="o", color="black", markersize=5, capsize=3, zorder=5)
    inner = np.percentile(view.seen, (1, 99)) if len(view.seen) else np.zeros(2)
    low, high = min(inner[0], view.curve.min(), 0.0), max(inner[1], view.curve.max(), 0.0)
    panel.set_ylim(low - 0.1 * (high - low or 1.0), high + 0.1 * (high - low or 1.0))
    panel.set(xlabel=view.across, ylabel=view.up)
    if view.discrete:
        panel.set_xticks((-1, 0, 1))
    elif view.angle:
        panel.xaxis.set_major_locator(degree_ticks(panel))


def _spectrum(evidence: Evidence, joint: int) -> tuple[Array, Array]:
    """Orders and the share that each explains; the nuisance taken out where it matters, of the low ones."""
    orders, gains = spectrum(evidence, joint)
    low = orders <= _EXACT_BELOW
    exact = evidence.score_columns(list(evidence.case.harmonics(joint, orders[low])))
    gains = np.concatenate([[score.gain for score in exact], gains[~low]])
    return orders, 2 * gains / _left(evidence)


def _left(evidence: Evidence) -> float:
    """The sum of squares of what the nuisance leaves."""
    rest = evidence.residual - (evidence.basis @ evidence.residual) @ evidence.basis
    return max(float(rest @ rest), np.finfo(float).tiny)


def _adjusted(score: Score, total: float, freedom: float) -> float:
    """The share explained, less what as many numbers explain of noise."""
    left = 1 - min(2 * score.gain / total, 1.0)
    return float(max(1 - left * freedom / max(freedom - score.size, 1.0), 0.0))


def _autocorrelation(rows: Array) -> tuple[NDArray[np.integer], Array]:
    """Of rows `(row, sample)` with their neighbours, the mean over rows, by how many samples they are apart."""
    count = rows.shape[1]
    lags = np.arange(1, max(2, min(_LAGS, count // 4) + 1))
    length = 2 ** int(np.ceil(np.log2(2 * max(count, 2))))
    centred = rows - rows.mean(1, keepdims=True)
    power = np.abs(np.fft.rfft(centred, length, axis=1)) ** 2
    alike = np.fft.irfft(power.sum(0), length)
    return lags, alike[lags] / max(float(alike[0]), np.finfo(float).tiny)


def _medians(x: Array, y: Array, count: int = _BINS) -> tuple[Array, Array, Array]:
    """Middles of bins of equal width, medians and their standard errors; NaN where a bin holds too little."""
    if not len(x):
        return np.zeros(0), np.zeros(0), np.zeros(0)
    edges = np.linspace(x.min(), max(x.max(), x.min() + 1e-9), count + 1)
    at = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, count - 1)
    middle, error = np.full(count, np.nan), np.full(count, np.nan)
    for k in range(count):
        inside = y[at == k]
        if len(inside) >= _LEAST_IN_BIN:
            middle[k] = np.median(inside)
            deviation = 1.4826 * np.median(np.abs(inside - middle[k]))
            error[k] = np.sqrt(np.pi / 2 / len(inside)) * deviation  # of a median of normal noise
    return (edges[1:] + edges[:-1]) / 2, middle, error


def _grid(count: int, shared: bool = False, wide: bool = False) -> tuple[Figure, list[Axes]]:
    """A figure of as many panels, in rows."""
    columns = min(count, 2 if wide else 4 if count > 6 else 3)
    rows = -(-count // columns)
    size = (
        (6.0 * columns + (1.5 if columns == 1 else 0.0), 4.2 * rows + 1.0)
        if wide
        else (3.0 + 3.0 * columns, 3.2 * rows + 1.0)
    )
    figure = blank(*size)
    panels = figure.subplots(rows, columns, sharey=shared, squeeze=False).ravel()
    for panel in panels[count:]:
        panel.set_visible(False)
    return figure, list(panels[:count])


def _legend(figure: Figure, panel: Axes, columns: int) -> None:
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
