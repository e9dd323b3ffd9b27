"""What a trial is to be: kind, arm, sensor, noise and sizes, in fixed shares, so that any number is a fair sample."""

from collections.abc import Sequence
from dataclasses import MISSING, asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from benchmarks.campaigns.rounds import KINDS, Kind, Rounds, turn
from benchmarks.concealed.chain import MADE
from benchmarks.concealed.mujoco_physics import OFFERED
from benchmarks.concealed.outside import FAMILIES, families
from benchmarks.concealed.plain_physics import COORDINATES, OUTSIDE

ROUNDS = Rounds({"clean": 10, "single": 8, "mixture": 3, "outside": 1, "edge": 1, "faulty": 2}, 1)
SIZES = (1.0, 1.5, 2.0, 2.0, 2.0, 3.0, 5.0, 10.0, 20.0)
"""Times the threshold; twice it is drawn three times as often, for a goal is set there."""
OUTSIDE_SIZES = (3.0, 5.0, 10.0, 20.0)
EDGES = ("masses off", "two harmonics", "few rows", "loaded backlash")
"""What makes it hard to name an effect that the catalogue has."""
NAMES_AT_STAKE: tuple[Kind, ...] = ("outside", "edge")  # the kinds in which the rate of wrong names is measured
ROWS = 300  # of a recording, but for the kinds in which names are at stake
FEW, FEWEST = 40, 15
_ROW_RANGES = ((0.2, FEWEST, 60), (0.65, 60, 500), (0.15, 500, 3000))
"""Share, and between which numbers of rows it is uniform in the logarithm; most are moderate, to bound the time."""
_TRAJECTORY = 100  # rows, 5 s: on a shorter way an arm does not come far
_CARRIED = 100  # rows in which a payload has come and gone
SINGLE = tuple(name for name in COORDINATES if name not in (*OUTSIDE, "payload_error"))
NOISES = (
    *("as declared",) * 5,
    *("half or twice", "correlated", "growing with reach", "in the joints", "factory file off"),
)
FAULTS = (
    *("outliers", "outliers beside an effect", "repeated_rows", "time_order", "swapped_joints", "mirrored_joint"),
    *("nominal_table", "frame_jump", "unsettled_readouts", "sensor_scale", "joint_turns", "placeholder"),
)
TAKEN_UP = ("sensor_scale", "joint_turns")
"""Faults that a chain takes up where it is fitted."""
ARMS = ("lite6", "seven", "six")
SENSORS = {
    "tracker": (2e-5, None, "laser_tracker"),
    "tracker_6d": (2e-5, 1e-4, "laser_tracker"),
    "motion_capture": (2e-4, 1e-3, "motion_capture"),
    "controller": (3e-8, 3e-7, "controller_fk"),
}
"""m and rad per axis, one standard deviation, and the sidecar's word."""
UNCERTAIN = 5e-5  # m and rad: the standard deviation that an uncertain factory file says of itself
LOOSE = (5 * MADE[0], 5 * MADE[1])
"""m and rad: what anyone believes of an arm of whose numbers nothing is said; it settles what no pose can."""
TOUCHED, ENCODERS = (1e-3, 5e-3), 2e-4
"""m and rad: what is believed of the chain, and of each encoder once a turn, where touches are all that is measured."""
OFF = 1e-5  # m and rad: how far the factory file is off that says nothing of it

READERS = {"contact": 120, "plane": 150, "distance": 200, "axis": 200, "fixed_camera": 60, "flange_camera": 60}
"""Sensors that measure no poses, and how many readings or images each takes."""
READ_ROUNDS = Rounds({"clean": 1, "single": 1}, 11)
READ_SIZES = (2.0, 2.0, 2.0, 3.0, 5.0, 10.0)
READ = tuple(name for name in SINGLE if name not in ("joint_lag", "time_offset", "measurement_scale", "tool_offset"))
"""Effects of an arm at rest that a sensor with places and a tool of its own may show."""

HARD_NOISES = {"wandering": 14, "heavy_tails": 15, "autocorrelated": 16}
"""Noise of healthy arms that is hard to tell from physics, and the stream of random numbers of each."""
NOISE_ROUNDS = Rounds({"clean": 1}, 13)
MEMORIES = (2.0, 500.0)
"""Rows between which the memory of noise is uniform in the logarithm: from two to more than a recording has."""
ENCODER_STDS = (7.5e-5, 3e-4)
"""rad, between which the standard deviation of read-outs that wander is uniform in the logarithm."""
FREEDOM = 3
"""Degrees of freedom of heavy tails: the fewest whole number of which they have a standard deviation."""
TAILS = (1.0, FREEDOM**0.5)
"""Standard deviations of heavy tails over the declared one: the same, and that of Student's t with it as its scale."""

BY_CONTROLLER = (
    *("joint_offset", "joint_scale", "joint_coupling", "frame_offset", "tool_offset", "joint_lag", "time_offset"),
)
"""What a controller's own forward kinematics can show: it knows no forces."""


@dataclass(frozen=True)
class Plan:
    """What is drawn first."""

    seed: int  # of the campaign
    index: int  # of the trial in it
    kind: Kind  # what is hidden
    engine: str  # which physics
    arm: str  # lite6, seven or six
    sensor: str  # a key of `SENSORS` or `READERS`
    moving: bool  # whether poses are taken along a trajectory
    geometry: str  # known, uncertain or unknown
    mounted: bool  # whether sensor frame and tool are unknown
    noise: str  # one of `NOISES` or a key of `HARD_NOISES`
    fault: str  # one of `FAULTS`, or none
    effects: tuple[str, ...]  # names
    sizes: tuple[float, ...]  # of the effects, in thresholds
    rows: int = ROWS  # of the recording
    edge: str = ""  # one of `EDGES`, or none
    masses_off: bool = False  # whether the links weigh other than declared
    sealed: bool = False  # whether what is outside the catalogue is of a sealed family
    noise_memory: float = 0.0  # rows that autocorrelated noise remembers: its coefficient is 1 − 1/memory
    encoder_std: float = 0.0  # rad, standard deviation of every read-out that wanders
    over_declared: float = 1.0  # the standard deviation of heavy tails over the declared one

    def told(self) -> dict[str, Any]:
        """For the truth. What an earlier version did not draw is left out where it is absent: truths stay the same."""
        absent = {field.name: field.default for field in fields(self) if field.default is not MISSING}
        return {name: value for name, value in asdict(self).items() if name not in absent or value != absent[name]}


def draw_plan(seed: int, index: int, rng: np.random.Generator, sealed: bool = False) -> Plan:
    """What a trial is to be. What goals are set on goes round and does not depend on `rng`, which draws the rest."""
    kind = ROUNDS.kind_of(seed, index)
    ordinal = ROUNDS.ordinal(seed, index, kind)
    noise = turn(seed, 2, ordinal, NOISES) if kind == "clean" else NOISES[0]
    fault = turn(seed, 7, ordinal, FAULTS) if kind == "faulty" else ""
    edge = turn(seed, 8, ordinal, EDGES) if kind == "edge" else ""
    effects, sizes = _effects(kind, fault or edge, seed, ordinal, rng, families(seed, sealed))
    forces = kind != "faulty" and all(name in OFFERED for name in effects) and noise != "factory file off"
    moving = bool(rng.random() < 0.45)
    driven = any(name in FAMILIES and "velocity" in FAMILIES[name].on for name in effects)
    rows = _rows(seed, kind, edge, ordinal) if kind in NAMES_AT_STAKE else ROWS
    if any(name in FAMILIES and FAMILIES[name].is_carried for name in effects):
        rows = max(rows, _CARRIED)
    if {"joint_lag", "time_offset"} & set(effects) or fault == "time_order" or driven:
        moving, rows = True, max(rows, _TRAJECTORY)
    elif fault == "unsettled_readouts" or rows < _TRAJECTORY:
        moving = False
    sensor = str(rng.choice(list(SENSORS), p=[0.45, 0.25, 0.2, 0.1]))
    geometry = rng.choice(["known", "uncertain", "unknown"], p=[0.4, 0.3, 0.3])
    mounted = bool(rng.random() < 0.5)
    arm = str(rng.choice(ARMS, p=[0.7, 0.15, 0.15]))
    if {"frame_offset", "measurement_scale"} & set(effects):
        geometry = rng.choice(["known", "uncertain"], p=[0.7, 0.3])
    if noise == "factory file off":
        geometry = "known"
    if fault in ("swapped_joints", "mirrored_joint"):
        geometry = rng.choice(["known", "uncertain"])
    if fault in TAKEN_UP:
        geometry = "unknown"
    if fault == "nominal_table":
        arm, geometry = "lite6", rng.choice(["known", "unknown"])
    if sensor == "controller":
        if kind in (*NAMES_AT_STAKE, "faulty") or noise != NOISES[0] or not set(effects) <= set(BY_CONTROLLER):
            sensor = "tracker_6d"
        else:
            geometry, mounted, forces = "known", False, False
    engine = "mujoco" if forces and rng.random() < (0.6 if effects else 0.25) else "plain"
    if "yielding_spring" in effects and not moving:
        engine = "plain"  # inertia on the way from pose to pose, which nobody records, would yield it and not gravity
    if engine == "mujoco" and not moving:
        rows = min(rows, ROWS)  # every pose is driven to
    where = (seed, index, kind, engine, arm, sensor, moving, str(geometry), mounted, noise, fault)
    off = edge == "masses off" or (kind == "outside" and ordinal % 3 == 0)
    return Plan(*where, effects, sizes, rows, edge, masses_off=off, sealed=sealed and kind == "outside")


def draw_reading_plan(sensor: str, seed: int, index: int, rng: np.random.Generator) -> Plan:
    """What a trial of a sensor that measures no poses is to be: nothing, or one effect of twice the threshold on."""
    kind = READ_ROUNDS.kind_of(seed, index)
    ordinal = READ_ROUNDS.ordinal(seed, index, kind)
    single = kind == "single"
    effects = (turn(seed, 3, ordinal, READ),) if single else ()
    sizes = (turn(seed, 4, ordinal, READ_SIZES),) if single else ()
    # an unknown frame is geometry, and touches of planes have no length of their own
    settled = sensor == "plane" or "frame_offset" in effects
    arm = str(rng.choice(ARMS, p=[0.7, 0.15, 0.15]))
    geometry = str(rng.choice(["known", "uncertain"] if settled else ["known", "uncertain", "unknown"]))
    where = ("plain", arm, sensor, False, geometry, True, NOISES[0], "")
    return Plan(seed, index, kind, *where, effects, sizes, READERS[sensor])


def draw_noise_plan(noise: str, seed: int, index: int, rng: np.random.Generator) -> Plan:
    """What a trial of a healthy arm is to be whose noise is hard, a key of `HARD_NOISES`."""
    sensors = [name for name in SENSORS if name != "controller"]
    sensor = str(rng.choice(sensors, p=[0.5, 0.28, 0.22]))
    arm = str(rng.choice(ARMS, p=[0.7, 0.15, 0.15]))
    geometry = str(rng.choice(["known", "uncertain", "unknown"], p=[0.4, 0.3, 0.3]))
    engine = str(rng.choice(["mujoco", "plain"], p=[0.25, 0.75]))
    moving = bool(rng.random() < 0.45)
    mounted = bool(rng.random() < 0.5)
    where = (engine, arm, sensor, moving, geometry, mounted, noise, "")
    plan = Plan(seed, index, NOISE_ROUNDS.kind_of(seed, index), *where, (), ())
    if noise == "heavy_tails":
        return replace(plan, over_declared=turn(seed, 17, index, TAILS))
    plan = replace(plan, noise_memory=_drawn_between(MEMORIES, rng))
    if noise == "wandering":
        plan = replace(plan, encoder_std=_drawn_between(ENCODER_STDS, rng))
    return plan


def _drawn_between(ends: tuple[float, float], rng: np.random.Generator) -> float:
    """A number that is uniform in the logarithm."""
    return float(np.exp(rng.uniform(*np.log(ends))))


def _rows(seed: int, kind: Kind, edge: str, ordinal: int) -> int:
    """How many rows a recording has, spread evenly over the trials of a kind."""
    # multiples of the golden section leave no gap and no cluster, however many there are
    place = float(np.random.default_rng([seed, 10, KINDS.index(kind)]).random() + ordinal * (5**0.5 - 1) / 2) % 1
    if edge == "few rows":
        return round(FEWEST * (FEW / FEWEST) ** place)
    for share, low, high in _ROW_RANGES:
        if place < share:
            return round(low * (high / low) ** (place / share))
        place -= share
    return _ROW_RANGES[-1][2]


def _effects(
    kind: Kind, trouble: str, seed: int, ordinal: int, rng: np.random.Generator, outside: Sequence[str]
) -> tuple[tuple[str, ...], tuple[float, ...]]:
    """Names and sizes in thresholds; `trouble` is a fault or what makes a trial one at the edge."""
    if kind == "single":
        return (turn(seed, 3, ordinal, SINGLE),), (turn(seed, 4, ordinal, SIZES),)
    if kind == "outside":
        return (turn(seed, 5, ordinal, outside),), (turn(seed, 6, ordinal, OUTSIDE_SIZES),)
    if kind == "mixture":
        count = 2 + ordinal % 2
        sizes = [float(size) for size in rng.choice(SIZES[2:], count)]
        if ordinal % 4 == 3:
            # a wrong payload is seen through what gives way
            soft = [float(size) for size in rng.choice([20.0, 40.0], count - 1)]
            return ("joint_compliance",) * (count - 1) + ("payload_error",), (*soft, sizes[-1])
        return tuple(str(name) for name in rng.choice(SINGLE, count)), tuple(sizes)
    if kind == "edge":
        names = _at_the_edge(trouble, rng)
        return names, tuple(float(size) for size in rng.choice(OUTSIDE_SIZES[trouble != "few rows" :], len(names)))
    if trouble == "outliers beside an effect":
        return (str(rng.choice(SINGLE)),), (float(rng.choice([5.0, 10.0])),)
    return (), ()


def _at_the_edge(edge: str, rng: np.random.Generator) -> tuple[str, ...]:
    """Effects that the catalogue has, where they are hard to name; with few rows a quarter of trials hides nothing."""
    if edge == "few rows":
        standing = [name for name in SINGLE if name not in ("joint_lag", "time_offset")]
        return (str(rng.choice(standing)),) if rng.random() < 0.75 else ()
    soft = ("joint_compliance",) if rng.random() < 0.5 else ()
    if edge == "two harmonics":
        return ("joint_harmonic", "joint_harmonic", *soft)
    if edge == "loaded backlash":
        return ("joint_backlash", *soft)
    return (str(rng.choice(["joint_compliance", "link_compliance", "base_compliance"])), *soft)
