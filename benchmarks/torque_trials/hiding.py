"""What is hidden: an effect somewhere it can be, of so many thresholds, and all that is known of it beforehand.

All from the generator's own derivatives (central differences of `physics.torques`), whitened by the true noise of each
joint and seen only across what the recording leaves open of the inertial numbers. Autocorrelated noise counts by its
effective samples, (1 − ρ)/(1 + ρ) of the samples: exact for what varies slowly, strict for what does not.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.campaigns import detection
from benchmarks.campaigns.detection import Array, Rival, Threshold, project_out
from benchmarks.torque_trials.effects import FAMILIES, NAMED, Hidden, Motion, draw_family
from benchmarks.torque_trials.physics import RIGID, Arm, Setup, held, link_wrench, move_links, rigid, torques
from benchmarks.torque_trials.plans import Plan

_STEPS = {"s": 1e-4, "m": 1e-3, "rad": 1e-4}
_UNIT = 1e-3  # times what is drawn: small enough for a derivative
LADDER = (
    *("viscous_friction", "coulomb_friction", "load_friction", "torque_offset", "torque_scale"),
    *("rotor_inertia", "joint_spring"),
)
"""What the catalogue may add to a joint without another joint's help."""
_ROWS = 1000  # samples that are enough to know how much all of them can tell
_MOST = {
    "scale": 0.5,
    "coefficient": 0.4,
    "offset_s": 0.04,
    "lag_s": 0.04,
    "mass_kg": 1.0,
    "x_m": 0.05,
    "y_m": 0.05,
    "z_m": 0.05,
    "tilt_x_rad": 0.2,
    "tilt_y_rad": 0.2,
}
"""Sizes beyond which an effect is no small error any more."""
_PLACES = np.arange(9).reshape(3, 3)  # of a tensor's entries
_LEAST_SEEN = 0.05
"""The share of what an effect does that the rest cannot do, below which a small error of the model would hide it."""
_MOST_MOVED = 1.0
"""Of the RMS of the joint's torque or, where that is small, of 20 times its noise, that an effect may add."""


@dataclass(frozen=True, eq=False)
class View:
    """A motion as its torques show it."""

    setup: Setup  # the arm as it is
    motion: Motion  # what it does
    # `(joint,)` Nm that a sample is worth: the noise's standard deviation over the root of effective samples
    noise: Array
    inertial: float = 0.0  # the relative uncertainty of the declared inertial numbers: 0 declared, infinite unknown
    _scenes: dict[str, Motion] = field(default_factory=dict)

    @classmethod
    def of(cls, setup: Setup, motion: Motion, noise: Array, inertial: float) -> "View":
        """Of every so many samples, each of which is worth as many: no motion changes much between them."""
        every = max(1, len(motion.time) // _ROWS)
        return cls(setup, motion.thinned(every), noise / np.sqrt(every), inertial)

    def torques(self, hidden: Sequence[Hidden]) -> Array:
        """`(sample, joint)` Nm."""
        changing = [effect for effect in hidden if effect.name in RIGID]
        key = repr(changing)
        if key not in self._scenes:
            if len(self._scenes) > 4:
                self._scenes.clear()
            self._scenes[key] = rigid(self.setup, changing, self.motion)
        return torques(self.setup, hidden, self.motion, self._scenes[key])

    def whitened(self, difference: Array) -> Array:
        """`(number,)`, below it zeros for the prior's rows."""
        return np.concatenate([(difference / self.noise).ravel(), np.zeros(self.prior_rows)])

    @property
    def prior_rows(self) -> int:
        """As many as inertial numbers of which something is known."""
        return self.nuisance.shape[1] if 0 < self.inertial < np.inf else 0

    @cached_property
    def nuisance(self) -> Array:
        """`(sample · joint, number)` Nm: how torques move with the inertial numbers left open.

        Ten a link where they are unknown. Where they are uncertain, five a link, one standard deviation each: the mass,
        the centre's three coordinates, and the tensor as a whole.
        """
        if not self.inertial:
            return np.zeros((self.motion.q.size, 0))
        arm, motion = self.setup.arm, self.motion
        bodies = move_links(arm, motion.q, motion.dq, motion.ddq, self.setup.gravity)
        nothing = np.zeros((len(motion.q), 3))
        columns = []
        for i, ahead, behind in _inertial_moves(arm, self.inertial):
            # of one link alone: the others ask for the same either way
            pair = [link_wrench(each, bodies[i], i) for each in (ahead, behind)]
            pull = [(a - b) / 2 for a, b in zip(*pair, strict=True)]
            columns.append(held(arm, bodies, [*[(nothing, nothing)] * i, (pull[0], pull[1])]).ravel())
        return np.stack(columns, 1)

    def span(self) -> Array:
        """The nuisance whitened, the prior's rows below."""
        columns = self.nuisance / np.tile(self.noise, len(self.motion.q))[:, None]
        return np.concatenate([columns, np.eye(self.prior_rows, columns.shape[1])])

    def columns(self, hidden: Sequence[Hidden], place: int, names: Sequence[str]) -> Array:
        """`(number, name)`: how what is seen moves with numbers of one of the effects, where all are as they are."""
        return np.stack([self.whitened(slope) for slope in self.slopes(hidden, place, names)], 1)

    def slopes(self, hidden: Sequence[Hidden], place: int, names: Sequence[str]) -> Iterator[Array]:
        """`(sample, joint)` Nm over the unit of each number."""
        effect = hidden[place]
        for name in names:
            step = _STEPS.get(name.rsplit("_", 1)[-1], 1e-3)
            ahead, behind = (
                self.torques([*hidden[:place], effect.moved(**{name: effect.values[name] + h}), *hidden[place + 1 :]])
                for h in (step, -step)
            )
            yield (ahead - behind) / (2 * step)


def _inertial_moves(arm: Arm, share: float) -> Iterator[tuple[int, Arm, Arm]]:
    """Of every inertial number left open, its link (from 0) and the arm with more and with less of it."""
    known = share < np.inf
    for i, (mass, center) in enumerate(zip(arm.chain.mass, arm.chain.center, strict=True)):
        step = share * mass if known else 1e-2
        yield i, arm.with_link(i + 1, mass=step), arm.with_link(i + 1, mass=-step)
        for axis in range(3):
            shift = np.zeros(3)
            shift[axis] = share * np.linalg.norm(center) if known else 1e-3
            yield i, arm.with_link(i + 1, center=shift), arm.with_link(i + 1, center=-shift)
        entries = ((a, b) for a in range(3) for b in range(a, 3))
        unit = (np.where(np.isin(_PLACES, (3 * a + b, 3 * b + a)), 1e-3, 0.0) for a, b in entries)
        for tensor in [share * arm.inertia[i]] if known else unit:
            either = np.zeros_like(arm.inertia)
            either[i] = tensor
            yield i, replace(arm, inertia=arm.inertia + either), replace(arm, inertia=arm.inertia - either)


def hide(plan: Plan, rng: np.random.Generator, view: View) -> tuple[Hidden, ...] | None:
    """Effects of the planned names and sizes; None where one of them is out of sight, or only large ones are seen."""
    hidden: tuple[Hidden, ...] = ()
    still = 3 if plan.edge == "resting joints" else 0
    for name, times in zip(plan.effects, plan.sizes, strict=True):
        effect = _drawn(name, rng, view, hidden, still)
        if effect is None or any((effect.name, effect.site) == (o.name, o.site) for o in hidden if not plan.edge):
            return None
        tried = (*hidden, effect)
        if "step_Nm" in effect.fixed:
            hidden = tried
            continue
        found = detection_threshold(view, tried, len(hidden), _beside(view, tried, len(hidden)))
        if found.seen < _LEAST_SEEN:
            return None
        sized = effect.scaled(found.size * times)
        if any(abs(sized.values[key]) > _MOST.get(key, np.inf) for key in sized.sizes):
            return None
        if sized.name == "link_mass" and sized.values["mass_kg"] < -0.5 * view.setup.arm.chain.mass[sized.number - 1]:
            return None
        if sized.name == "payload_error" and view.motion.payload.min() + sized.values["mass_kg"] < 0:
            return None
        hidden = (*hidden, sized)
    added = np.sqrt(np.mean((view.torques(hidden) - view.torques(())) ** 2, 0))
    most = np.maximum(np.sqrt(np.mean(view.torques(()) ** 2, 0)), 20 * view.setup.arm.noise)
    return None if np.any(added > _MOST_MOVED * most) else hidden


def _beside(view: View, hidden: Sequence[Hidden], place: int) -> Array:
    """The columns of all that may vary beside one of the effects: the nuisance and the others.

    Beside an effect outside the catalogue this is all, too, that the catalogue may add to the same joint: it counts by
    what is left of it when the catalogue has done its best.
    """
    others = (view.columns(hidden, k, other.sizes) for k, other in enumerate(hidden) if k != place)
    blocks = [view.span(), *others]
    if hidden[place].name in FAMILIES:
        blocks.append(ladder(view, hidden[place].number))
    return np.concatenate(blocks, 1)


def _drawn(name: str, rng: np.random.Generator, view: View, before: Sequence[Hidden], still: int) -> Hidden | None:
    """Somewhere an effect can be; its values of the right proportions but not yet of a size."""
    dof, motion = view.setup.arm.chain.dof, view.motion
    if name in FAMILIES:
        found = draw_family(name, rng, rigid(view.setup, (), motion), view.setup.arm.noise)
        if found is None:
            return None
        side = float(rng.choice([-1.0, 1.0]))
        return Hidden(name, f"joint{found[0]}", {"size": 1.0 if FAMILIES[name].positive else side}, found[1])
    # a second ripple stands at the joint of the first
    joint = before[-1].number if before and before[-1].name == name else int(rng.integers(1 + still, dof + 1))
    site, side = f"joint{joint}", float(rng.choice([-1.0, 1.0]))
    q = motion.q[:, joint - 1]
    match name:
        case "stribeck_friction":
            return Hidden(name, site, {"stribeck_Nm": 1.0, "velocity_rad_per_s": float(rng.uniform(0.05, 0.3))})
        case "coupled_friction":
            joint = int(rng.choice([dof, dof, max(2, joint)]))
            viscous, dry = rng.uniform(0.2, 1.0, 2)
            values = {"viscous_Nm_s_per_rad": float(viscous), "coulomb_Nm": float(dry)}
            return Hidden(name, f"joint{joint}", values | {"source_joint": joint - 1.0})
        case "joint_spring":
            rest = float(np.percentile(q, rng.uniform(20, 80)))
            return Hidden(name, site, {"stiffness_Nm_per_rad": 1.0, "rest_rad": rest})
        case "torque_ripple":
            order = float(rng.choice([float(rng.integers(2, 13)), float(rng.integers(13, 61)), rng.uniform(2, 40)]))
            if any(abs(order - other.values.get("order", np.inf)) < 1 for other in before):
                return None
            phase = float(rng.uniform(-np.pi, np.pi))
            return Hidden(name, site, {"amplitude_Nm": 1.0, "order": order, "phase_rad": phase})
        case "link_com":
            return Hidden(name, f"link{joint}", dict(zip(("x_m", "y_m", "z_m"), 0.1 * rng.normal(size=3), strict=True)))
        case "base_tilt":
            return Hidden(name, "base", dict(zip(("tilt_x_rad", "tilt_y_rad"), rng.normal(size=2), strict=True)))
    (size,) = NAMED[name].sizes
    if name in ("link_mass", "link_inertia"):
        site = f"link{joint}"
    site = {"payload_error": "payload", "time_offset": "clock"}.get(name, site)
    return Hidden(name, site, {size: 1.0 if NAMED[name].positive else side})


def usual(view: View, hidden: Sequence[Hidden]) -> list[dict[str, Any]]:
    """What is not hidden but there, as all arms have it: without its threshold, its bound and its rivals."""
    said = []
    for effect in hidden:
        about = {"effect": effect.name, "site": effect.site, "moved_Nm": _moved(view, (effect,), 0), "rival": None}
        said.append(about | {"parameters": dict(effect.values), "fixed": {}, "bound": {}, "size": None, "seen": None})
    return said


def _moved(view: View, hidden: Sequence[Hidden], place: int) -> float:
    """Nm RMS that one of the effects adds."""
    added = view.torques(hidden) - view.torques([*hidden[:place], *hidden[place + 1 :]])
    return float(np.sqrt(np.mean(added**2)))


def describe(view: View, hidden: Sequence[Hidden]) -> list[dict[str, Any]]:
    """What is hidden, with its size in thresholds beside all the rest, its bound and its nearest rival."""
    named = all(effect.name not in FAMILIES for effect in hidden)
    limits = bounds(view, hidden) if named else [{} for _ in hidden]
    said = []
    for k, effect in enumerate(hidden):
        span, family = _beside(view, hidden, k), FAMILIES.get(effect.name)
        found = detection_threshold(view, hidden, k, span)
        values, fixed = ({name: float(v) for name, v in each.items()} for each in (effect.values, effect.fixed))
        about = {"effect": effect.name, "site": effect.site, "parameters": values, "fixed": fixed, "bound": limits[k]}
        about |= {"size": 1 / found.size if found.size else None, "seen": found.seen}
        about |= {"moved_Nm": _moved(view, hidden, k)}
        if family is None:
            about |= {"rival": asdict(nearest_rival(view, hidden, k, span))}
        else:
            drivers = family.drivers(effect.number, effect.fixed)
            about |= {"rival": None, "drivers": drivers, "beside": family.beside, "nameless": family.nameless}
            about |= {"sum_of": family.sum_of} if family.sum_of else {}
        said.append(about)
    return said


def detection_threshold(view: View, hidden: Sequence[Hidden], place: int, span: Array) -> Threshold:
    """The threshold of one of the hidden effects, its proportions given, across the columns of all beside it."""
    effect = hidden[place]
    others = [*hidden[:place], *hidden[place + 1 :]]
    added = (view.torques([*others, effect.scaled(_UNIT)]) - view.torques(others)) / _UNIT
    count = NAMED[effect.name].linear if effect.name in NAMED else 1
    return detection.threshold(view.whitened(added), span, count, float(np.sqrt(np.mean(added**2))))


def ladder(view: View, joint: int) -> Array:
    """The columns of all that the catalogue may add to a joint without another joint's help."""
    effects = [_blank(name, f"joint{joint}") for name in LADDER]
    return np.concatenate([view.columns([each], 0, each.sizes) for each in effects], 1)


def candidates(setup: Setup, motion: Motion, declared: bool) -> Iterator[list[Hidden]]:
    """What an effect may be taken for: the catalogue, each site on its own; an effect's coordinates as effects each.

    Ripples are left out, whose orders are without number: what is no ripple is no ripple's rival.
    """
    for joint in range(1, setup.arm.chain.dof + 1):
        site = f"joint{joint}"
        yield from ([_blank(name, site)] for name in (*LADDER[:4], "rotor_inertia"))
        if np.ptp(motion.temperature) > 2:
            yield [_blank("friction_temperature", site)]
        yield [_blank("torque_scale", site)]
        yield [_blank("torque_lag", site)]
        yield [_blank("joint_spring", site), _blank("torque_offset", site)]
        yield from ([_blank("stribeck_friction", site, velocity_rad_per_s=v)] for v in (0.05, 0.2))
        if joint > 1:
            yield [_blank("coupled_friction", site, source_joint=joint - 1.0)]
        if declared:
            yield from ([_blank(name, f"link{joint}")] for name in ("link_mass", "link_com", "link_inertia"))
    if declared:
        yield [_blank("payload_error", "payload")]
    yield [_blank("base_tilt", "base")]
    yield [_blank("time_offset", "clock")]


def _blank(name: str, site: str, **shapes: float) -> Hidden:
    """An effect of no size."""
    return Hidden(name, site, dict.fromkeys((*NAMED[name].sizes, *NAMED[name].shapes), 0.0) | shapes)


def nearest_rival(view: View, hidden: Sequence[Hidden], place: int, span: Array) -> Rival:
    """Which other candidate explains most of one of the hidden effects, beside all that may vary."""
    effect, absent = hidden[place], [*hidden[:place], *hidden[place + 1 :]]

    def others() -> Iterator[tuple[str, str, Array]]:
        for rival in candidates(view.setup, view.motion, view.inertial == 0):
            if (rival[0].name, rival[0].site) != (effect.name, effect.site):
                columns = [view.columns([*absent, each], len(absent), each.sizes) for each in rival]
                yield rival[0].name, rival[0].site, np.concatenate(columns, 1)

    return detection.nearest(view.whitened(view.torques(hidden) - view.torques(absent)), span, others())


def bounds(view: View, hidden: Sequence[Hidden]) -> list[dict[str, float]]:
    """The Cramér–Rao bound of every reported number: one standard deviation of the best unbiased estimate."""
    if not hidden:
        return []
    names = [effect.estimated for effect in hidden]
    found = project_out(view.span(), np.concatenate([view.columns(hidden, k, each) for k, each in enumerate(names)], 1))
    lengths = np.maximum(np.linalg.norm(found, axis=0), 1e-300)
    scaled = found / lengths
    covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    deviations = iter(np.sqrt(np.maximum(np.diag(covariance), 0)) / lengths)
    return [{name: float(next(deviations)) for name in each} for each in names]


def unseen_error(view: View, hidden: Sequence[Hidden], unseen: Motion) -> float:
    """Nm RMS over all joints by which an efficient fit that knows the form is off on another motion, on average."""
    later = View.of(view.setup, unseen, view.noise, view.inertial)
    ours, theirs = [view.span()], [later.nuisance]
    for k, effect in enumerate(hidden):
        ours.append(view.columns(hidden, k, effect.estimated))
        theirs.append(np.stack([slope.ravel() for slope in later.slopes(hidden, k, effect.estimated)], 1))
    J, moved = np.concatenate(ours, 1), np.concatenate(theirs, 1)
    if not J.shape[1]:
        return 0.0
    lengths = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    _, s, vt = np.linalg.svd(J / lengths, full_matrices=False)
    kept = s > 1e-7 * s[0]
    off = (moved / lengths) @ (vt[kept].T / s[kept])
    return float(np.sqrt(np.sum(off**2) / len(moved)))
