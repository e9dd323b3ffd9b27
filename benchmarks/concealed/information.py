"""What a recording can tell: the detection threshold of an effect, its Cramér–Rao bound, its nearest rival.

All from the generator's own derivatives (central differences of `plain_physics.poses`), whitened by the sensor's true
noise, and seen only across what the recording leaves open: sensor frame, tool and geometry.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.campaigns.threshold import LEAST_SEEN, across, least_power
from benchmarks.concealed.chain import Array
from benchmarks.concealed.outside import FAMILIES
from benchmarks.concealed.plain_physics import OUTSIDE, Hidden, poses
from benchmarks.concealed.view import View, reported_slopes, source

_EQUAL, _EQUAL_ROWS = 0.03, 150
"""The share by which sites may differ that are called equal: axes that an arm's maker meant to be one are not quite."""


@dataclass(frozen=True, eq=False)
class Threshold:
    """How large an effect must be.

    Attributes:
        size: by what its values must be multiplied to be at the threshold.
        seen: the share of what it does that frames, tool and geometry cannot do as well.
        moved: m RMS, how far it moves the measured point at the threshold.
    """

    size: float
    seen: float
    moved: float


def threshold(view: View, hidden: tuple[Hidden, ...], place: int, span: Array) -> Threshold:
    """Of one of the hidden effects, the direction of its values given.

    Args:
        view: of the recording.
        hidden: all effects.
        place: which of them.
        span: the columns of all that may vary beside it.
    """
    effect = hidden[place]
    unit = 1e-3 * _typical(effect)
    scaled = effect.scaled(unit)
    others = (*hidden[:place], *hidden[place + 1 :])
    absent, there = poses(view.setup, others, view.motion), poses(view.setup, (*others, scaled), view.motion)
    g = view.padded(view.difference(absent, there)[:, None] / unit)
    left = across(span, g)[:, 0]
    length, whole = float(np.linalg.norm(left)), float(np.linalg.norm(g))
    if length == 0 or whole == 0:
        return Threshold(np.inf, 0.0, np.inf)
    count = 1 if effect.name in OUTSIDE else effect.linear
    size = np.sqrt(least_power(count)) / length
    moved = np.sqrt(np.mean(np.sum((there[1] - absent[1]) ** 2, 1))) / unit * size
    return Threshold(size, length / whole, float(moved))


def _typical(effect: Hidden) -> float:
    """A factor that makes values of unit size small enough for a derivative."""
    return 1.0 if effect.name in ("time_offset", "payload_error") else 0.1


def candidates(dof: int, moving: bool, orientation: bool) -> Iterator[Hidden]:
    """What an effect may be taken for: the catalogue, each site on its own."""
    joints = range(1, dof + 1)
    for joint in joints:
        for name in ("joint_offset", "joint_scale", "joint_compliance", "joint_backlash"):
            yield Hidden(name, f"joint{joint}", (0.0,))
        if moving:
            yield Hidden("joint_lag", f"joint{joint}", (0.0,))
        for order in (1.0, 2.0):
            yield Hidden("joint_harmonic", f"joint{joint}", (0.0, 0.0), {"order": order})
        for other in joints:
            if other != joint:
                yield Hidden("joint_coupling", f"joint{joint}", (0.0,), {"source_joint": other})
        yield Hidden("link_compliance", f"link{joint}", (0.0, 0.0))
        yield Hidden("frame_offset", f"link{joint}", (0.0,) * 6)
        if joint < dof:
            yield Hidden("link_thermal_expansion", f"link{joint}", (0.0,))
    yield Hidden("link_thermal_expansion", "links", (0.0,))
    yield Hidden("frame_offset", "base", (0.0,) * 6)
    yield Hidden("base_compliance", "base", (0.0, 0.0))
    yield Hidden("base_drift", "base", (0.0,) * 3)
    yield Hidden("tool_offset", "tool", (0.0,) * (6 if orientation else 3))
    yield Hidden("measurement_scale", "sensor", (0.0,))
    if moving:
        yield Hidden("time_offset", "clock", (0.0,))


@dataclass(frozen=True)
class Rival:
    """The candidate that comes nearest to an effect.

    Attributes:
        name: of the effect.
        site: of it.
        apart: standard deviations by which the data tell them apart; what is below 3 no method can name for sure.
    """

    name: str
    site: str
    apart: float


def nearest_rival(view: View, hidden: tuple[Hidden, ...], place: int, span: Array) -> Rival:
    """Which other candidate explains most of one of the hidden effects, beside all that may vary."""
    effect = hidden[place]
    absent = (*hidden[:place], *hidden[place + 1 :])
    g = view.difference(poses(view.setup, absent, view.motion), poses(view.setup, hidden, view.motion))
    lengths = np.linalg.norm(span, axis=0) if span.shape[1] else np.ones(0)
    u, s, _ = np.linalg.svd(span / np.where(lengths > 0, lengths, 1.0), full_matrices=False)
    u = u[:, s > 1e-9 * s[0]] if len(s) else u

    def left(columns: Array) -> Array:
        return columns - u @ (u.T @ columns)

    r = left(view.padded(g[:, None]))[:, 0]
    best = Rival("", "", float(np.linalg.norm(r)))
    moving = view.motion.curve is not None
    for rival in candidates(view.setup.chain.dof, moving, bool(view.noise[1])):
        order = effect.fixed.get("order")
        same = (rival.name, rival.site) == (effect.name, effect.site)
        if same and dict(rival.fixed) == ({} if order is None else {"order": order}) | source(effect):
            continue
        # where the effects are as they are: elsewhere, what cancels here would leave what effects do to each other
        columns = view.padded(view.columns((*hidden, rival), len(hidden)))
        lengths = np.linalg.norm(columns, axis=0)
        directions, sizes, _ = np.linalg.svd(left(columns / np.where(lengths > 0, lengths, 1.0)), full_matrices=False)
        done = directions[:, sizes > LEAST_SEEN**2].T @ r
        apart = float(np.sqrt(max(0.0, r @ r - done @ done)))
        if apart < best.apart:
            best = Rival(rival.name, rival.site, apart)
    return best


def equal_sites(view: View, effect: Hidden) -> list[str]:
    """The sites where the same function of the same driver moves what is seen in the same way; the effect's own first.

    The base may move or the sensor, the tool or the link that carries it: no recording tells these apart.

    Args:
        view: of the recording.
        effect: of a family outside the catalogue.
    """
    dof, own = view.setup.chain.dof, effect.site
    if FAMILIES[effect.name].place == "image":
        return [own]
    thin = replace(view, motion=view.motion.thinned(_EQUAL_ROWS))
    fixed = effect.fixed
    span = thin.nuisance()
    g = across(span, thin.padded(thin.columns((effect,), 0)))
    found = [own]
    for site in (*(f"{place}{k}" for k in range(1, dof + 1) for place in ("joint", "link")), "base", "tool", "sensor"):
        if site == own:
            continue
        axes = (None,) if site.startswith("joint") else range(6)
        forms = [fixed if axis is None else {**fixed, "axis": float(axis)} for axis in axes]
        moved = [thin.columns((replace(effect, site=site, fixed=form),), 0) for form in forms]
        columns = across(span, thin.padded(np.concatenate(moved, 1)))
        lengths = np.linalg.norm(columns, axis=0)
        # what frames, tool or geometry can do as well is rounding, and would fit anything
        columns = columns[:, lengths > 1e-6 * max(np.linalg.norm(m) for m in moved)]
        if np.linalg.norm(across(columns, g)) < _EQUAL * np.linalg.norm(g):
            found.append(site)
    return found


def bounds(view: View, hidden: tuple[Hidden, ...]) -> list[dict[str, float]]:
    """The Cramér–Rao bound of every reported number: one standard deviation of the best unbiased estimate."""
    if not hidden:
        return []
    blocks = [view.padded(view.columns(hidden, k)) for k in range(len(hidden))]
    found = across(view.nuisance(hidden), np.concatenate(blocks, 1))
    covariance = np.linalg.pinv(found.T @ found, rcond=1e-14, hermitian=True)
    out, first = [], 0
    for effect in hidden:
        size = len(effect.values)
        own = covariance[first : first + size, first : first + size]
        first += size
        names, J = reported_slopes(effect)
        variances = np.einsum("ia,ab,ib->i", J, own, J)
        out.append(dict(zip(names, np.sqrt(np.maximum(variances, 0)).tolist(), strict=True)))
    return out
