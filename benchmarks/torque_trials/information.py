"""What a recording can tell: the detection threshold of an effect, its Cramér–Rao bound, its nearest rival.

All from the generator's own derivatives (central differences of `physics.torques`), whitened by the true noise of each
joint and seen only across what the recording leaves open of the inertial numbers. Autocorrelated noise counts by its
effective samples, (1 − ρ)/(1 + ρ) of the samples: exact for what varies slowly, strict for what does not.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from benchmarks.campaigns.threshold import LEAST_SEEN, Array, Rival, Threshold, across, apart, beyond, least_power
from benchmarks.torque_trials.arms import Arm, held, link_pull, travelled
from benchmarks.torque_trials.effects import NAMED, Hidden, Scene
from benchmarks.torque_trials.motion import Motion
from benchmarks.torque_trials.physics import RIGID, Setup, rigid, torques

_STEPS = {"s": 1e-4, "m": 1e-3, "rad": 1e-4}
_UNIT = 1e-3
"""Times what is drawn: small enough for a derivative."""
LADDER = (
    *("viscous_friction", "coulomb_friction", "load_friction", "torque_offset", "torque_scale"),
    *("rotor_inertia", "joint_spring"),
)
"""What the catalogue may add to a joint without another joint's help."""
_ROWS = 1000
"""Samples that are enough to know how much all of them can tell."""


@dataclass(frozen=True, eq=False)
class View:
    """A motion as its torques show it.

    Attributes:
        setup: the arm as it is.
        motion: what it does.
        noise: `(joint,)` Nm that a sample is worth: the noise's standard deviation over the root of effective samples.
        inertial: the relative uncertainty of the declared inertial numbers: 0 declared, infinite unknown.
    """

    setup: Setup
    motion: Motion
    noise: Array
    inertial: float = 0.0
    _scenes: dict[str, Scene] = field(default_factory=dict)

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
        bodies = travelled(arm, motion.q, motion.dq, motion.ddq, self.setup.gravity)
        nothing = np.zeros((len(motion.q), 3))
        columns = []
        for i, ahead, behind in _inertial_moves(arm, self.inertial):
            # of one link alone: the others ask for the same either way
            pair = [link_pull(each, bodies[i], i) for each in (ahead, behind)]
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
        for tensor in [share * arm.inertia[i]] if known else _tensors():
            either = np.zeros_like(arm.inertia)
            either[i] = tensor
            yield i, replace(arm, inertia=arm.inertia + either), replace(arm, inertia=arm.inertia - either)


def _tensors() -> Iterator[Array]:
    for a in range(3):
        for b in range(a, 3):
            tensor = np.zeros((3, 3))
            tensor[a, b] = tensor[b, a] = 1e-3
            yield tensor


def sizes_of(effect: Hidden) -> tuple[str, ...]:
    """The numbers that say how large an effect is."""
    return NAMED[effect.name].sizes if effect.name in NAMED else ("size",)


def threshold(view: View, hidden: Sequence[Hidden], place: int, span: Array) -> Threshold:
    """Of one of the hidden effects, its proportions given, across the columns of all that may vary beside it."""
    effect = hidden[place]
    others = [*hidden[:place], *hidden[place + 1 :]]
    there = view.torques([*others, effect.scaled(_UNIT, sizes_of(effect))])
    added = (there - view.torques(others)) / _UNIT
    g = view.whitened(added)
    left, whole = float(np.linalg.norm(across(span, g[:, None]))), float(np.linalg.norm(g))
    if left <= LEAST_SEEN**2 * whole or whole == 0:
        return Threshold(np.inf, 0.0, np.inf)
    count = NAMED[effect.name].linear if effect.name in NAMED else 1
    size = float(np.sqrt(least_power(count)) / left)
    return Threshold(size, left / whole, float(np.sqrt(np.mean(added**2))) * size)


def ladder(view: View, joint: int) -> Array:
    """The columns of all that the catalogue may add to a joint without another joint's help."""
    effects = [_blank(name, f"joint{joint}") for name in LADDER]
    return np.concatenate([view.columns([each], 0, sizes_of(each)) for each in effects], 1)


def _numbers(name: str) -> tuple[str, ...]:
    return (*NAMED[name].sizes, *NAMED[name].shapes)


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
            yield from ([_blank(name, f"link{joint}")] for name in ("link_mass", "link_com"))
    if declared:
        yield [_blank("payload_error", "payload")]
    yield [_blank("base_tilt", "base")]
    yield [_blank("time_offset", "clock")]


def _blank(name: str, site: str, **shapes: float) -> Hidden:
    """An effect of no size."""
    return Hidden(name, site, dict.fromkeys(_numbers(name), 0.0) | shapes)


def nearest_rival(view: View, hidden: Sequence[Hidden], place: int, span: Array) -> Rival:
    """Which other candidate explains most of one of the hidden effects, beside all that may vary."""
    effect = hidden[place]
    absent = [*hidden[:place], *hidden[place + 1 :]]
    left = beyond(span)
    rest = left(view.whitened(view.torques(hidden) - view.torques(absent))[:, None])[:, 0]
    best = Rival("", "", float(np.linalg.norm(rest)))
    for rival in candidates(view.setup, view.motion, view.inertial == 0):
        first = rival[0]
        if (first.name, first.site) == (effect.name, effect.site):
            continue
        columns = np.concatenate([view.columns([*absent, each], len(absent), sizes_of(each)) for each in rival], 1)
        best = best.or_nearer(first.name, first.site, apart(rest, columns, left(columns)))
    return best


def estimated(effect: Hidden) -> tuple[str, ...]:
    """The numbers of an effect that a fit estimates."""
    return _numbers(effect.name) if effect.name in NAMED else ("size",)


def bounds(view: View, hidden: Sequence[Hidden]) -> list[dict[str, float]]:
    """The Cramér–Rao bound of every reported number: one standard deviation of the best unbiased estimate."""
    if not hidden:
        return []
    names = [estimated(effect) for effect in hidden]
    found = across(view.span(), np.concatenate([view.columns(hidden, k, each) for k, each in enumerate(names)], 1))
    lengths = np.maximum(np.linalg.norm(found, axis=0), 1e-300)
    scaled = found / lengths
    covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    deviations = iter(np.sqrt(np.maximum(np.diag(covariance), 0)) / lengths)
    return [{name: float(next(deviations)) for name in each} for each in names]


def unseen_error(view: View, hidden: Sequence[Hidden], unseen: Motion) -> float:
    """Nm RMS over all joints by which an efficient fit that is told the form is off on another motion, on average."""
    later = View.of(view.setup, unseen, view.noise, view.inertial)
    ours, theirs = [view.span()], [later.nuisance]
    for k, effect in enumerate(hidden):
        ours.append(view.columns(hidden, k, estimated(effect)))
        theirs.append(np.stack([slope.ravel() for slope in later.slopes(hidden, k, estimated(effect))], 1))
    J, moved = np.concatenate(ours, 1), np.concatenate(theirs, 1)
    if not J.shape[1]:
        return 0.0
    lengths = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    _, s, vt = np.linalg.svd(J / lengths, full_matrices=False)
    kept = s > 1e-7 * s[0]
    off = (moved / lengths) @ (vt[kept].T / s[kept])
    return float(np.sqrt(np.sum(off**2) / len(moved)))
