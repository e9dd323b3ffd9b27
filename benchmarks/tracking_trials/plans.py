"""What a trial is to be: kind, arm, servo, noise and sizes, in fixed shares, so that any number is a fair sample."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.campaigns.rounds import Kind, Rounds, turn
from benchmarks.tracking_trials.effects import FREE_SERVO, NAMED, OPEN, SEALED
from benchmarks.tracking_trials.motions import MOTIONS
from benchmarks.tracking_trials.mujoco_arm import SIMULATED

ROUNDS = Rounds({"clean": 8, "single": 8, "mixture": 3, "outside": 3, "faulty": 2}, 41)
SIZES = (1.0, 2.0, 4.0, 10.0, 20.0)  # times the threshold
OUTSIDE_SIZES = (10.0, 20.0, 40.0)
FAULTS = (
    *("joints_swapped", "joint_sign", "degrees", "gear", "zero_per_run", "stale_rows", "saturated_readout"),
    *("torque_off", "other_clock"),
)
"""What is wrong with a faulty log."""
SINGLE = tuple(NAMED)
RATES = (50.0, 100.0, 125.0, 200.0, 250.0, 500.0)  # Hz
ARMS = {"serial3": 0.42, "serial4": 0.38, "serial5": 0.08, "lite6": 0.04, "ur5e": 0.04, "xarm7": 0.04}
"""With the share of trials that each is drawn in: most are small, for a diagnosis takes the time of its joints."""
_ROWS = 600, 1200
_LONGEST = 6.0  # s of a run: runs are rolled out side by side
_NOISE = 1e-5, 3e-4  # rad
_QUANTA = (0.0, 0.0, 1.0, 3.0)  # of the noise, a step of the encoder
_NEEDS_RUNS = ("zero_per_run",)
_UNKNOWN = 0.25  # of the trials whose servo is unknown


@dataclass(frozen=True)
class Plan:
    """What is drawn first."""

    seed: int  # of the campaign
    index: int  # of the trial in it
    kind: Kind  # what is hidden
    engine: str  # which physics: plain or mujoco
    arm: str  # a key of `ARMS`
    servo: str  # declared or unknown
    noise: str  # white or quantised
    sigma: float  # rad, of the noise
    quantum: float  # rad, zero where there is none
    rate: float  # Hz
    samples: int  # of each run
    motions: tuple[str, ...]  # of the runs
    unseen: str  # the motion that is to be predicted
    effects: tuple[str, ...]  # names
    sizes: tuple[float, ...]  # of the effects, in thresholds
    fault: str = ""  # one of `FAULTS`, or none
    edge: str = ""  # none
    sealed: bool = False  # whether what is outside the table is of a sealed family


def draw_plan(seed: int, index: int, rng: np.random.Generator, sealed: bool = False) -> Plan:
    """What a trial is to be. What goals are set on goes round and does not depend on `rng`, which draws the rest."""
    kind = ROUNDS.kind_of(seed, index)
    ordinal = ROUNDS.ordinal(seed, index, kind)
    effects, sizes = _effects(kind, seed, ordinal, rng, SEALED if sealed else OPEN)
    fault = turn(seed, 44, ordinal, FAULTS) if kind == "faulty" else ""
    declared = bool(set(effects) & {*FREE_SERVO, "viscous_friction"}) or bool(fault) or rng.random() > _UNKNOWN
    sigma = float(np.exp(rng.uniform(*np.log(_NOISE))))
    quantum = sigma * float(rng.choice(_QUANTA))
    rate = float(rng.choice(RATES))
    rows = float(np.exp(rng.uniform(*np.log(_ROWS))))
    runs = int(rng.choice([1, 2, 3], p=[0.5, 0.3, 0.2])) + int(rows / rate / _LONGEST)
    if fault in _NEEDS_RUNS:
        runs = max(runs, 2)
    motions = tuple(str(name) for name in rng.choice(MOTIONS, runs))
    if runs == 1 and motions[0] in ("steps", "holds"):
        motions = ("multisine",)  # of steps or holds alone hardly anything is known
    unseen = [name for name in MOTIONS if name not in motions]
    if not unseen:
        unseen = list(MOTIONS)  # of many runs, another draw of one of them
    built = all(name in SIMULATED for name in effects) and not fault
    return Plan(
        seed=seed,
        index=index,
        kind=kind,
        engine="mujoco" if built and rng.random() < 0.5 else "plain",
        arm=str(rng.choice(list(ARMS), p=list(ARMS.values()))),
        servo="declared" if declared else "unknown",
        noise="quantised" if quantum else "white",
        sigma=round(sigma, 7),
        quantum=round(quantum, 7),
        rate=rate,
        samples=round(rows / runs),
        motions=motions,
        unseen=str(rng.choice(unseen)),
        effects=effects,
        sizes=sizes,
        fault=fault,
        sealed=sealed and kind == "outside",
    )


def _effects(
    kind: Kind, seed: int, ordinal: int, rng: np.random.Generator, families: Sequence[str]
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Names and sizes in thresholds."""
    if kind == "single":
        return (turn(seed, 42, ordinal, SINGLE),), (turn(seed, 43, ordinal, SIZES),)
    if kind == "outside":
        return (turn(seed, 45, ordinal, families),), (turn(seed, 46, ordinal, OUTSIDE_SIZES),)
    if kind == "mixture":
        count = 2 + ordinal % 2
        names = tuple(str(name) for name in rng.choice(SINGLE, count, replace=False))
        return names, tuple(float(size) for size in rng.choice(SIZES[2:], count))
    return (), ()
