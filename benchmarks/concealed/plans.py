"""What a trial is to be: kind, arm, sensor, noise and sizes, in fixed shares, so that any number is a fair sample."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from benchmarks.concealed.chain import MADE
from benchmarks.concealed.mujoco_physics import OFFERED
from benchmarks.concealed.plain_physics import COORDINATES, OUTSIDE

Kind = Literal["clean", "single", "mixture", "outside", "faulty"]
KINDS: tuple[Kind, ...] = ("clean", "single", "mixture", "outside", "faulty")
_SHARES: dict[Kind, int] = {"clean": 10, "single": 8, "mixture": 3, "outside": 2, "faulty": 2}
_ROUND = tuple(kind for kind, count in _SHARES.items() for _ in range(count))
SIZES = (1.0, 1.5, 2.0, 2.0, 2.0, 3.0, 5.0, 10.0, 20.0)
"""Times the threshold; twice it is drawn three times as often, for a goal is set there."""
OUTSIDE_SIZES = (3.0, 5.0, 10.0, 20.0)
SINGLE = tuple(name for name in COORDINATES if name not in (*OUTSIDE, "payload_error"))
NOISES = ("as declared",) * 5 + (
    "half or twice",
    "correlated",
    "growing with reach",
    "in the joints",
    "factory file off",
)
FAULTS = (
    *("outliers", "outliers beside an effect", "repeated_rows", "time_order", "swapped_joints", "mirrored_joint"),
    *("nominal_table", "frame_jump", "unsettled_readouts"),
)
SENSORS = {
    "tracker": (2e-5, None, "laser_tracker"),
    "tracker_6d": (2e-5, 1e-4, "laser_tracker"),
    "motion_capture": (2e-4, 1e-3, "motion_capture"),
    "controller": (3e-8, 3e-7, "controller_fk"),
}
"""m and rad per axis, one standard deviation, and the sidecar's word."""
UNCERTAIN = 5e-5
"""m and rad: the standard deviation that an uncertain factory file says of itself."""
LOOSE = (5 * MADE[0], 5 * MADE[1])
"""m and rad: what anyone believes of an arm of whose numbers nothing is said; it settles what no pose can."""
OFF = 1e-5
"""m and rad: how far the factory file is off that says nothing of it."""

BY_CONTROLLER = (
    "joint_offset",
    "joint_scale",
    "joint_coupling",
    "frame_offset",
    "tool_offset",
    "joint_lag",
    "time_offset",
)
"""What a controller's own forward kinematics can show: it knows no forces."""


@dataclass(frozen=True)
class Plan:
    """What is drawn first.

    Attributes:
        seed: of the campaign.
        index: of the trial in it.
        kind: what is hidden.
        engine: which physics.
        arm: lite6, seven or six.
        sensor: a key of `SENSORS`.
        moving: whether poses are taken along a trajectory.
        geometry: known, uncertain or unknown.
        mounted: whether sensor frame and tool are unknown.
        noise: one of `NOISES`.
        fault: one of `FAULTS`, or none.
        effects: names.
        sizes: of the effects, in thresholds.
    """

    seed: int
    index: int
    kind: Kind
    engine: str
    arm: str
    sensor: str
    moving: bool
    geometry: str
    mounted: bool
    noise: str
    fault: str
    effects: tuple[str, ...]
    sizes: tuple[float, ...]


def kind_of(seed: int, index: int) -> Kind:
    """The kind of a trial: every round of 25 has each in its share, in an order of its own."""
    lap, place = divmod(index, len(_ROUND))
    return _ROUND[np.random.default_rng([seed, 1, lap]).permutation(len(_ROUND))[place]]


def indices(seed: int, trials: int, kind: Kind | None = None) -> list[int]:
    """The first trials of a campaign, or the first of a kind."""
    if kind is None:
        return list(range(trials))
    found: list[int] = []
    index = 0
    while len(found) < trials:
        if kind_of(seed, index) == kind:
            found.append(index)
        index += 1
    return found


def _ordinal(seed: int, index: int, kind: Kind) -> int:
    """How many trials of its kind come before it."""
    lap, place = divmod(index, len(_ROUND))
    order = np.random.default_rng([seed, 1, lap]).permutation(len(_ROUND))
    return lap * _ROUND.count(kind) + sum(_ROUND[k] == kind for k in order[:place])


def _turn(seed: int, stream: int, ordinal: int, choices: Sequence[Any]) -> Any:
    """A choice that goes round: each comes once a round, in an order of its own."""
    lap, place = divmod(ordinal, len(choices))
    return choices[np.random.default_rng([seed, stream, lap]).permutation(len(choices))[place]]


def draw_plan(seed: int, index: int, rng: np.random.Generator) -> Plan:
    """What a trial is to be. What goals are set on goes round and does not depend on `rng`, which draws the rest."""
    kind = kind_of(seed, index)
    ordinal = _ordinal(seed, index, kind)
    noise = _turn(seed, 2, ordinal, NOISES) if kind == "clean" else NOISES[0]
    fault = _turn(seed, 7, ordinal, FAULTS) if kind == "faulty" else ""
    effects, sizes = _effects(kind, fault, seed, ordinal, rng)
    forces = kind != "faulty" and all(name in OFFERED for name in effects) and noise != "factory file off"
    moving = bool(rng.random() < 0.45)
    if {"joint_lag", "time_offset"} & set(effects) or fault == "time_order":
        moving = True
    elif fault == "unsettled_readouts":
        moving = False
    sensor = str(rng.choice(list(SENSORS), p=[0.45, 0.25, 0.2, 0.1]))
    geometry = rng.choice(["known", "uncertain", "unknown"], p=[0.4, 0.3, 0.3])
    mounted = bool(rng.random() < 0.5)
    arm = str(rng.choice(["lite6", "seven", "six"], p=[0.7, 0.15, 0.15]))
    if {"frame_offset", "measurement_scale"} & set(effects):
        geometry = rng.choice(["known", "uncertain"], p=[0.7, 0.3])
    if noise == "factory file off":
        geometry = "known"
    if fault in ("swapped_joints", "mirrored_joint"):
        geometry = rng.choice(["known", "uncertain"])
    if fault == "nominal_table":
        arm, geometry = "lite6", rng.choice(["known", "unknown"])
    if sensor == "controller":
        if kind in ("outside", "faulty") or noise != NOISES[0] or not set(effects) <= set(BY_CONTROLLER):
            sensor = "tracker_6d"
        else:
            geometry, mounted, forces = "known", False, False
    engine = "mujoco" if forces and rng.random() < (0.6 if effects else 0.25) else "plain"
    return Plan(
        seed=seed,
        index=index,
        kind=kind,
        engine=engine,
        arm=arm,
        sensor=sensor,
        moving=moving,
        geometry=str(geometry),
        mounted=mounted,
        noise=noise,
        fault=fault,
        effects=effects,
        sizes=sizes,
    )


def _effects(
    kind: Kind, fault: str, seed: int, ordinal: int, rng: np.random.Generator
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Names and sizes in thresholds."""
    if kind == "single":
        return (_turn(seed, 3, ordinal, SINGLE),), (_turn(seed, 4, ordinal, SIZES),)
    if kind == "outside":
        return (_turn(seed, 5, ordinal, OUTSIDE),), (_turn(seed, 6, ordinal, OUTSIDE_SIZES),)
    if kind == "mixture":
        count = 2 + ordinal % 2
        sizes = [float(size) for size in rng.choice(SIZES[2:], count)]
        if ordinal % 4 == 3:
            # a wrong payload is seen through what gives way
            soft = [float(size) for size in rng.choice([20.0, 40.0], count - 1)]
            return ("joint_compliance",) * (count - 1) + ("payload_error",), (*soft, sizes[-1])
        return tuple(str(name) for name in rng.choice(SINGLE, count)), tuple(sizes)
    if fault == "outliers beside an effect":
        return (str(rng.choice(SINGLE)),), (float(rng.choice([5.0, 10.0])),)
    return (), ()
