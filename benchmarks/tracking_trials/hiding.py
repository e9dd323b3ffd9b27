"""What is hidden: an effect somewhere it can be, of so many thresholds, and all that is known of it beforehand.

All from the generator's own rollouts. An effect is as large as the standard deviations by which it moves read-outs,
in what the unknown numbers of servos cannot do as well. At the threshold their square is `detection.least_power`, so
that a test that knows name, site and noise finds half of such effects, and some joint moves by `LEAST_MOVED`. Many
effects are not linear in their numbers: sizes are looked for among rollouts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.campaigns import detection
from benchmarks.campaigns.detection import Array, project_out
from benchmarks.tracking_trials.arms import Bodies, Dynamics
from benchmarks.tracking_trials.effects import AT_LEAST, FAMILIES, FREE_SERVO, NAMED, SITES, Hidden, Values, site_of
from benchmarks.tracking_trials.physics import Commands, Setup, roll
from benchmarks.tracking_trials.plans import Plan

STEP = 5e-4  # s, of rollouts of which only differences count
LEAST_MOVED = 1e-5  # rad RMS at a joint: simulators of the same arm differ by as much
_RUNGS = 16  # sizes that are tried
_SHARE = 0.02  # of a number, by which it is changed for a derivative
_LEAST_SEEN = 0.05  # of what an effect does, that the servos' numbers cannot do
_MOST_MOVED = 0.1  # rad RMS that an effect may do
_SMOOTH = 0.05  # s, over which commands are smoothed to know what they ask for
_AT_REST = 1e-9  # rad/s, the speed of a joint that is to stand still
_ELSEWHERE = (
    *("command_delay", "coulomb_friction", "servo_stiffness", "joint_spring", "encoder_offset", "link_mass"),
    "link_com",
)
"""What an effect of the whole arm may be taken for at each joint."""


@dataclass(frozen=True, eq=False)
class View:
    """A motion as encoders show it."""

    setup: Setup  # the arm
    commands: Commands  # what it is commanded
    noise: float  # rad, one standard deviation of a read-out
    free: bool  # whether stiffness and damping of the servos are unknown

    def whitened(self, variants: Sequence[tuple[Hidden, ...]]) -> Array:
        """`(variant, number)`: read-outs in standard deviations."""
        return roll(self.setup, variants, self.commands, STEP).readout.reshape(len(variants), -1) / self.noise

    def thresholds(self, clear: Array, changes: Array, numbers: int) -> Array:
        """`(variant,)` times the threshold of an effect of so many numbers.

        Args:
            clear: `(variant,)` standard deviations, by which it changes what servos cannot change as well.
            changes: `(variant, number)` standard deviations, by which it changes read-outs.
            numbers: of the effect, in which read-outs are linear.
        """
        by_joint = changes.reshape(len(changes), -1, self.setup.arm.chain.dof)
        moved = self.noise * np.sqrt(np.mean(by_joint**2, axis=1)).max(axis=1)
        return np.minimum(clear / np.sqrt(detection.least_power(numbers)), moved / LEAST_MOVED)

    def servos(self, hidden: tuple[Hidden, ...]) -> list[tuple[Hidden, ...]]:
        """Variants in which one unknown number of a servo is larger by a share."""
        if not self.free:
            return []
        joints = range(1, self.setup.arm.chain.dof + 1)
        return [(*hidden, Hidden(name, f"joint{j}", {"ratio": 1 + _SHARE})) for j in joints for name in FREE_SERVO]


def asked(setup: Setup, commands: Commands) -> dict[str, Array]:
    """What the commands ask of each joint, `(joint,)`: `fastest` rad/s, `strongest` and `heaviest` Nm."""
    arm, period = setup.arm, commands.period
    width = max(round(_SMOOTH / period), 1)
    parts = []
    for u in commands.u:
        padded = np.concatenate([np.repeat(u[:1], width, 0), u, np.repeat(u[-1:], width, 0)])
        smooth = padded
        for _ in range(2):
            smooth = np.stack([np.convolve(each, np.full(width, 1 / width), "same") for each in smooth.T], 1)
        velocity = np.gradient(smooth, period, axis=0)
        rows = slice(width, -width)
        parts.append([each[rows] for each in (smooth, velocity, np.gradient(velocity, period, axis=0))])
    q, dq, ddq = (np.concatenate(each).T for each in zip(*parts, strict=True))
    lanes = q.shape[1]
    dynamics = Dynamics(Bodies.of(arm, np.full(lanes, setup.payload), setup.payload_center))
    matrix, bias = dynamics.terms(q, dq, np.repeat(setup.gravity[:, None], lanes, 1))
    joints = arm.joints
    load = bias + np.einsum("ijl,jl->il", matrix, ddq)
    drag = (joints.damping + joints.viscous)[:, None] * dq + joints.coulomb[:, None]
    pull = np.abs(load + joints.rotor[:, None] * ddq + drag)
    return {"fastest": np.abs(dq).max(1), "strongest": pull.max(1), "heaviest": np.abs(load).max(1)}


def hide(plan: Plan, rng: np.random.Generator, view: View) -> tuple[Hidden, ...] | None:
    """Effects of the planned names and sizes; None where one of them is out of sight, or only large ones are seen."""
    if not plan.effects:
        return ()
    limits = asked(view.setup, view.commands)
    drawn = [_draw(name, rng, view, limits) for name in plan.effects]
    ladders = [
        [effect(size) for size in np.geomspace(*_sizes(name), _RUNGS)]
        for name, effect in zip(plan.effects, drawn, strict=True)
    ]
    flat = [(effect,) for ladder in ladders for effect in ladder]
    servos = view.servos(())
    with np.errstate(all="ignore"):
        shown = view.whitened([(), *flat, *servos])
    shown = shown - shown[0]
    if not np.isfinite(shown[1 + len(flat) :]).all():
        return None
    span = shown[1 + len(flat) :].T
    left = detection.projector(span)
    hidden: list[Hidden] = []
    for k, (name, times) in enumerate(zip(plan.effects, plan.sizes, strict=True)):
        rungs = shown[1 + k * _RUNGS : 1 + (k + 1) * _RUNGS]
        usable = np.isfinite(rungs).all(1)
        changes = np.where(usable[:, None], rungs, 0.0)
        moved = np.where(usable, np.linalg.norm(changes, axis=1), np.inf)
        clear = np.where(usable, np.linalg.norm(left(changes.T), axis=0), np.inf)
        thresholds = np.where(usable, view.thresholds(clear, changes, _linear(name)), np.inf)
        sizes = np.geomspace(*_sizes(name), _RUNGS)
        least = name in AT_LEAST and thresholds[0] >= times
        size = float(sizes[0]) if least else _size_at(sizes, thresholds, times)
        if size is None:
            return None
        near = int(np.argmin(np.abs(np.log(sizes / size))))
        rms = moved[near] * view.noise / np.sqrt(rungs.shape[1])
        if clear[near] < _LEAST_SEEN * moved[near] or not rms < _MOST_MOVED:
            return None
        hidden.append(drawn[k](size))
    return tuple(hidden)


def _sizes(name: str) -> tuple[float, float]:
    return NAMED[name].sizes if name in NAMED else FAMILIES[name].sizes


def _linear(name: str) -> int:
    return NAMED[name].linear if name in NAMED else 1


def _size_at(sizes: Array, thresholds: Array, times: float) -> float | None:
    """The size of so many thresholds, between two rungs of which the lower has less; None where no two are."""
    above = np.flatnonzero(thresholds >= times)
    if not len(above) or above[0] == 0 or not np.isfinite(thresholds[above[0]]):
        return None
    k = int(above[0])
    if thresholds[k - 1] <= 0:
        share = times / thresholds[k]
        return float(sizes[k - 1] + share * (sizes[k] - sizes[k - 1]))
    share = np.log(times / thresholds[k - 1]) / np.log(thresholds[k] / thresholds[k - 1])
    return float(np.exp(np.log(sizes[k - 1]) + share * np.log(sizes[k] / sizes[k - 1])))


def _draw(name: str, rng: np.random.Generator, view: View, limits: dict[str, Array]) -> Any:
    """Somewhere an effect can be, and its form: a function that makes it of a size."""
    dof = view.setup.arm.chain.dof
    joint = int(rng.integers(1, dof + 1))
    if name in NAMED:
        named = NAMED[name]
        values = _of_joint(view, limits, joint) | {
            "side": float(rng.choice([-1.0, 1.0])),
            "phase": float(rng.uniform(-np.pi, np.pi)),
        }
        values["speed"] = float(rng.uniform(0.05, 0.4)) * values["fastest"]
        values["rest"] = float(np.percentile(view.commands.u[..., joint - 1], rng.uniform(20, 80)))
        values["droop"] = float(rng.uniform(0.1, 0.5)) / max(values["fastest"], _AT_REST)
        values["order"] = float(rng.choice([float(rng.integers(2, 40)), rng.uniform(2, 40)]))
        values["rise"] = float(np.arcsin(rng.uniform(-1, 1)))
        site = site_of(name, joint)
        return lambda size: Hidden(name, site, named.values(float(size), values))
    family = FAMILIES[name]
    fixed = _fixed(name, rng, view, joint)
    unit = _of_joint(view, limits, joint)[family.unit]
    site = f"joint{joint}" if family.site == "joint" else family.site
    return lambda size: Hidden(name, site, {"size": float(size) * unit}, fixed)


def _of_joint(view: View, limits: dict[str, Array], joint: int) -> dict[str, float]:
    joints = view.setup.arm.joints
    return {
        "one": 1.0,
        **{name: float(getattr(joints, name)[joint - 1]) for name in ("stiffness", "damping", "rotor")},
        **{name: float(each[joint - 1]) for name, each in limits.items()},
        "per_load": 1 / max(float(limits["heaviest"][joint - 1]), 0.05),
        "mass": float(view.setup.arm.chain.mass[joint - 1]),
    }


def _fixed(name: str, rng: np.random.Generator, view: View, joint: int) -> dict[str, float]:
    """What belongs to the form of a family at a joint (from 1)."""
    u = view.commands.u
    q = u[..., joint - 1]
    others = [j for j in range(1, u.shape[2] + 1) if j != joint]
    by = int(rng.choice(others))
    drawn = {
        "centre": float(np.percentile(q, rng.uniform(25, 75))),
        "width": float(rng.uniform(0.1, 0.25) * np.ptp(q)),
        "by": float(by),
        "other": float(np.percentile(u[..., by - 1], rng.uniform(25, 75))),
        "phase": float(rng.uniform(-np.pi, np.pi)),
        "pulse": float(2 * np.pi * rng.uniform(0.4, 2.0)),
    }
    return {key: drawn[key] for key in FAMILIES[name].keys}


# ------------------------------------------------------------------ what is known of it


def describe(view: View, hidden: tuple[Hidden, ...], rivals: bool) -> list[dict[str, Any]]:
    """What is hidden, with its size in thresholds beside all the rest, its bound and, if wanted, its nearest rival."""
    if not hidden:
        return []
    absent = [tuple(other for other in hidden if other is not effect) for effect in hidden]
    slopes = [list(_slopes(hidden, k)) for k in range(len(hidden))]
    servos = view.servos(hidden)
    candidates = list(_candidates(view, hidden[0])) if rivals else []
    variants = [hidden, *absent, *servos]
    variants += [each for own in slopes for _, ahead, behind, _ in own for each in (ahead, behind)]
    variants += [(*absent[0], effect) for _, effects in candidates for effect in effects]
    shown = iter(view.whitened(variants))
    full = next(shown)
    added = [full - next(shown) for _ in hidden]
    without = full - added[0]
    span = np.stack([next(shown) - full for _ in servos], 1) if servos else np.zeros((len(full), 0))
    columns = [np.stack([(next(shown) - next(shown)) / over for *_, over in own], 1) for own in slopes]
    bounds = _bounds(span, columns, [[name for name, *_ in own] for own in slopes])
    described = []
    for k, effect in enumerate(hidden):
        others = np.concatenate([span, *(column for j, column in enumerate(columns) if j != k)], 1)
        clear = float(np.linalg.norm(project_out(others, added[k][:, None])))
        moved = float(np.linalg.norm(added[k]))
        about: dict[str, Any] = {
            "effect": effect.name,
            "site": effect.site,
            "parameters": dict(effect.values),
            "fixed": dict(effect.fixed),
            "bound": bounds[k] if effect.name in NAMED else {},
            "size": float(view.thresholds(np.array([clear]), added[k][None], _linear(effect.name))[0]),
            "seen": clear / moved if moved else 0.0,
            "moved_rad": moved * view.noise / float(np.sqrt(len(full))),
            "rival": None,
        }
        if effect.name in FAMILIES:
            family = FAMILIES[effect.name]
            drivers = family.drivers(effect.joint + 1, effect.fixed)
            about |= {"drivers": drivers, "beside": family.beside, "nameless": family.nameless}
        described.append(about)
    if rivals:
        ranked = _ranked(candidates, shown, without)
        described[0]["rival"] = asdict(detection.nearest(added[0], span, ranked))
    return described


def _ranked(candidates: Sequence[tuple[str, list[Hidden]]], shown: Iterator[Array], without: Array) -> Iterator[Any]:
    """Name, site and columns of candidates, from their rollouts."""
    for name, effects in candidates:
        yield name, effects[0].site, np.stack([next(shown) - without for _ in effects], 1)


def _slopes(
    hidden: tuple[Hidden, ...], place: int
) -> Iterator[tuple[str, tuple[Hidden, ...], tuple[Hidden, ...], float]]:
    """Of each number of an effect, its name, the hidden with more and with less of it, and the difference."""
    effect = hidden[place]
    largest = max(abs(value) for value in effect.values.values())
    for name, value in effect.values.items():
        step = _SHARE * abs(value - 1) if name == "ratio" else _SHARE * abs(value)
        if name in ("phase_rad", "rest_rad") or not step:
            step = _SHARE
        if name.startswith("tilt"):
            step = _SHARE * largest
        ahead, behind = (
            (*hidden[:place], effect.moved(**{name: value + way * step}), *hidden[place + 1 :]) for way in (1, -1)
        )
        yield name, ahead, behind, 2 * step


def _bounds(span: Array, columns: Sequence[Array], names: Sequence[Sequence[str]]) -> list[dict[str, float]]:
    """The Cramér–Rao bound of every number: one standard deviation of the best unbiased estimate."""
    left = project_out(span, np.concatenate(columns, 1))
    lengths = np.maximum(np.linalg.norm(left, axis=0), 1e-300)
    scaled = left / lengths
    covariance = np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True)
    deviations = iter(np.sqrt(np.maximum(np.diag(covariance), 0)) / lengths)
    return [{name: float(next(deviations)) for name in each} for each in names]


_FORM = {"side": 1.0, "speed": 0.1, "rest": 0.0, "droop": 0.1, "order": 1.0, "rise": 0.0}
"""What of an effect that something may be taken for is not its size."""


def _candidates(view: View, effect: Hidden) -> Iterator[tuple[str, list[Hidden]]]:
    """What an effect may be taken for: the table, at its joint and for the whole arm, in one or two ways each."""
    limits = asked(view.setup, view.commands)
    dof = view.setup.arm.chain.dof
    joints = range(1, dof + 1) if effect.joint < 0 else [effect.joint + 1]
    for name, named in NAMED.items():
        if view.free and name in (*FREE_SERVO, "viscous_friction"):
            continue
        if effect.joint < 0 and name not in SITES and name not in _ELSEWHERE:
            continue
        for joint in [1] if name in SITES else joints:
            site = site_of(name, joint)
            if (name, site) == (effect.name, effect.site):
                continue
            values = _of_joint(view, limits, joint) | _FORM
            size = 0.1 * float(np.sqrt(np.prod(named.sizes)))
            phases: Sequence[Values] = [values | {"phase": phase} for phase in (0.0, np.pi / 2)[: named.linear]]
            effects = [Hidden(name, site, named.values(size, each)) for each in phases]
            if name == "joint_spring":
                effects[1] = Hidden(name, site, {**effects[0].values, "rest_rad": 1.0})
            if name == "link_com":
                along_axis = values | {"phase": 0.0, "rise": np.pi / 2}
                effects.append(Hidden(name, site, named.values(size, along_axis)))
            if name == "torque_speed_limit":
                effects[1] = Hidden(name, site, {**effects[0].values, "droop_s_per_rad": 0.0})
            yield name, effects
