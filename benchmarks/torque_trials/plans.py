"""What a torque trial is to be: kind, arm, noise and sizes, in fixed shares, so that any number is a fair sample."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.campaigns.rounds import Kind, Rounds, turn
from benchmarks.torque_trials.effects import FAMILIES, NAMED, OPEN, SEALED

ROUNDS = Rounds({"clean": 10, "single": 8, "mixture": 3, "outside": 2, "edge": 1, "faulty": 1}, 21)
SIZES = (1.0, 2.0, 2.0, 4.0, 10.0)  # times the threshold; twice it is drawn twice as often, for a goal is set there
OUTSIDE_SIZES = (4.0, 8.0, 20.0)
EDGES = ("short", "slow", "two ripples", "resting joints")
"""What makes it hard to name an effect that the catalogue has."""
DATA_FAULTS = (
    *("swapped_torques", "reversed_torque", "swapped_columns", "reversed_positions", "reversed_joint", "joint_zero"),
    *("wrong_torque_constant", "torque_unit", "no_gravity", "wrong_gravity", "joint_turns", "velocity_bias"),
    *("estimated_torque", "joint_zero"),  # twice, so that it comes twice as often
)
"""What is wrong with the file, under the names that the library has for it."""
FAULTS = ("contact", *DATA_FAULTS)  # what is wrong with a faulty recording: an event, or the file
SINGLE = tuple(NAMED)
NOISES = ("white", "autocorrelated", "twice as declared", "outliers", "noisy velocities")
AUTOCORRELATION = 0.9
RATES = (100.0, 125.0, 200.0, 250.0)  # Hz
_MOST_ROWS = 6000
MASSES = (
    "link_mass",
    "link_com",
    "link_inertia",
    "payload_error",
)  # effects that are none where the inertial numbers are unknown
SIMULATED = (
    *("viscous_friction", "coulomb_friction", "rotor_inertia", "joint_spring", "link_mass", "link_com"),
    *("payload_error", "base_tilt"),
)
"""What MuJoCo can be given."""


@dataclass(frozen=True)
class Plan:
    """What is drawn first."""

    seed: int  # of the campaign
    index: int  # of the trial in it
    kind: Kind  # what is hidden
    engine: str  # which physics: plain or mujoco
    arm: str  # lite6 or seven
    inertial: str  # declared, uncertain or unknown
    source: str  # torque or current
    noise: str  # one of `NOISES`
    rate: float  # Hz
    seconds: float  # of the recording
    effects: tuple[str, ...]  # names
    sizes: tuple[float, ...]  # of the effects, in thresholds
    edge: str = ""  # one of `EDGES`, or none
    fault: str = ""  # one of `FAULTS`, or none
    sealed: bool = False  # whether what is outside the catalogue is of a sealed family


def draw_plan(seed: int, index: int, rng: np.random.Generator, sealed: bool = False) -> Plan:
    """What a trial is to be. What goals are set on goes round and does not depend on `rng`, which draws the rest."""
    kind = ROUNDS.kind_of(seed, index)
    ordinal = ROUNDS.ordinal(seed, index, kind)
    edge = turn(seed, 28, ordinal, EDGES) if kind == "edge" else ""
    other = str(rng.choice(NOISES[:2], p=[0.65, 0.35]))
    noise = turn(seed, 22, ordinal, NOISES) if kind == "clean" else other
    effects, sizes = _effects(kind, edge, seed, ordinal, rng, SEALED if sealed else OPEN)
    inertial = str(rng.choice(["declared", "uncertain", "unknown"], p=[0.6, 0.15, 0.25]))
    fault = turn(seed, 30, ordinal, FAULTS) if kind == "faulty" else ""
    if set(effects) & set(MASSES) or fault in DATA_FAULTS:
        inertial = "declared"
    rate = float(rng.choice(RATES))
    seconds = float(np.exp(rng.uniform(np.log(10), np.log(60))))
    if edge == "short":
        seconds = 10.0
    if kind == "outside" or edge == "slow":
        seconds = max(seconds, 25.0)
    built = all(name in SIMULATED for name in effects) and not edge and kind != "faulty" and noise == NOISES[0]
    engine = "mujoco" if built and rng.random() < 0.7 else "plain"
    arm = str(rng.choice(["lite6", "seven"], p=[0.75, 0.25]))
    source = str(rng.choice(["torque", "current"], p=[0.85, 0.15]))
    drawn = (seed, index, kind, engine, arm, inertial, source, noise, rate, min(seconds, _MOST_ROWS / rate))
    return Plan(*drawn, effects, sizes, edge, fault, sealed=sealed and kind == "outside")


def _effects(
    kind: Kind, edge: str, seed: int, ordinal: int, rng: np.random.Generator, families: Sequence[str]
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Names and sizes in thresholds."""
    if kind == "single":
        return (turn(seed, 23, ordinal, SINGLE),), (turn(seed, 24, ordinal, SIZES),)
    if kind == "outside":
        return (turn(seed, 25, ordinal, families),), (turn(seed, 26, ordinal, OUTSIDE_SIZES),)
    if kind == "mixture":
        count = 2 + ordinal % 2
        return tuple(str(n) for n in rng.choice(SINGLE, count)), tuple(float(s) for s in rng.choice(SIZES[2:], count))
    if kind == "edge":
        joint_effects = [name for name in SINGLE if NAMED[name].torque is not None]
        names = ("torque_ripple", "torque_ripple") if edge == "two ripples" else (str(rng.choice(joint_effects)),)
        return names, tuple(float(s) for s in rng.choice(OUTSIDE_SIZES[:2], len(names)))
    return (), ()


def warms(effects: Sequence[str]) -> bool:
    """Whether temperatures must vary for the effects to be seen."""
    return "friction_temperature" in effects or any(name in FAMILIES and FAMILIES[name].warm for name in effects)
