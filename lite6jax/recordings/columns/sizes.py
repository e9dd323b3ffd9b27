"""What numbers say by themselves: the unit by their size, and whether they can be what their name says.

What an arm's forward kinematics says, where the arm is known, weighs more (`kinematics`).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from lite6jax.array_types import Array
from lite6jax.recordings.columns.column import FINE, MATRIX, Decision, Sureness, by_name, units_of

WIDE_RAD = 2.1 * np.pi
"""Beyond, joint positions are likely to be degrees."""
PERCENT = 100.0
"""Within, joints of LeRobot may be in percent of each joint's range; beyond, angles are degrees for certain."""
TURN_TICKS = 4096
"""Ticks of a servo's encoder in a turn (Feetech, Dynamixel)."""
TURNS_DEG = 720.0
"""Beyond, whole numbers are no degrees, but a finer unit or the counts of an encoder."""
_COVERED = (0.25, 1.05)
"""Of the range of some joint is what the arm moves in the right unit; in the next finer one it is a fifth at most."""
_LONGEST_MM = (3e3, 1e4)
"""Positions spread over less in mm for certain where they are whole numbers, and where they are not."""
_MARKED = (2.0, 0.5)
"""Times by which a number that repeats in fewer than that share of the rows exceeds all others, where it is a mark."""
LARGE_NM = 2000.0
"""Beyond, torques are millinewton metres."""
_CLOCKS = ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (1e8, "s"))
"""Times since 1970, by their least magnitude."""
_NEAREST = 0.03
"""Of the reach, that points lie from the base at least: taken a thousand times too small, they all lie within."""
_SLOW = 2e-3
_FAST = 8.0
"""rad/s: between them is the median speed of joints that move from row to row."""
_STEPS_S = (1e-4, 600.0)
"""Between rows."""


def increases(time: Array, run: Array | None = None) -> bool:
    """Tells whether numbers `(sample,)` increase from row to row as times do; of another `run` they begin anew."""
    finite = np.isfinite(time)
    steps = np.diff(time[finite])
    if run is not None:
        steps = steps[np.diff(run[finite]) == 0]
    # some do not: rows out of order, repeated rows, new runs
    return not steps.size or float(np.mean(steps <= 0)) <= 0.1


def has_unit_length(quaternion: Array) -> bool:
    """Tells whether rows `(sample, 4)` are unit quaternions, but for zeros that a sensor wrote when it saw nothing."""
    length = np.linalg.norm(complete_rows(quaternion), axis=1)
    length = length[length > 0]
    return bool(length.size) and float(np.mean(np.abs(length - 1) < 0.01)) > 0.9


def complete_rows(values: Array) -> Array:
    """The rows `(row, column)` in which all numbers are finite."""
    return values[np.isfinite(values).all(axis=1)]


def in_whole_numbers(values: Array) -> bool:
    """Tells whether all numbers are whole: only then are they tried in a unit of `FINE`."""
    finite = values[np.isfinite(values)]
    return bool(finite.size) and bool((finite == np.round(finite)).all())


def possible_units(quantity: str, values: Array, slides: bool = False) -> dict[str, float]:
    """The units in which numbers may be, as `units_of`: fine ones where they are whole, or beyond what others give."""
    largest = _largest(values)
    beyond = largest > (10 * TURNS_DEG if "deg" in units_of(quantity, slides) else _LONGEST_MM[1])
    return units_of(quantity, slides, fine=beyond or in_whole_numbers(values))


def angle_unit(
    position: Array, servo: bool = False, endless: Sequence[int] = (), limits: Array | None = None
) -> Decision:
    """The unit of joint positions `(sample, joint)`; numbers that are not finite are ignored.

    Args:
        position: the numbers.
        servo: whether they are named as LeRobot names them, which writes percent of each joint's range too. What may
            be none of both has the reason `percent` or `ticks`.
        endless: joints, from 0, that turn without end: the others decide whether what is beyond turns is degrees. Where
            there are no others it is radians, as robots' descriptions have them.
        limits: `(joint, 2)` rad, of the arm. Whole numbers beyond turns in degrees, of which they show no unit, have
            the reason `whole`.
    """
    position = without_marks(position)
    largest = _largest(position)
    if endless and largest > WIDE_RAD:
        bounded = np.delete(position, list(endless), axis=1)
        of_others = None if limits is None else np.delete(limits, list(endless), axis=0)
        if not bounded.size:
            return Decision("rad", "assumed", "endless", {"largest": largest})
        return angle_unit(bounded, limits=of_others)
    columns = [column[np.isfinite(column)] for column in position.T]
    spread = max((float(np.ptp(np.quantile(column, [0.05, 0.95]))) for column in columns if column.size), default=0.0)
    numbers = {"largest": largest}
    finite = position[np.isfinite(position)]
    if largest > 360 and in_whole_numbers(position) and finite.min() >= 0 and finite.max() < TURN_TICKS:
        return Decision("deg", "assumed", "ticks", numbers)
    if servo and WIDE_RAD < largest <= PERCENT:
        in_ticks = _in_ticks(columns)
        return Decision(
            "deg", "certain" if in_ticks else "assumed", "encoder_steps" if in_ticks else "percent", numbers
        )
    if largest > TURNS_DEG and in_whole_numbers(position):
        return _by_limits(columns, limits, numbers)
    if largest > WIDE_RAD:
        return Decision("deg", "certain" if PERCENT < largest <= TURNS_DEG else "likely", "beyond_turns", numbers)
    moving = spread > 0.5  # an arm that is measured moves by more than a degree
    return Decision("rad", "likely" if moving else "assumed", "within_turns", numbers | {"spread": spread})


def _by_limits(columns: Sequence[Array], limits: Array | None, numbers: dict[str, Any]) -> Decision:
    """The only unit in which joints move over much of their ranges and not beyond; else the reason is `whole`."""
    if limits is not None:
        ranges = np.ptp(np.where(np.isfinite(limits), limits, np.inf * np.sign(limits)), axis=1)
        moved = np.array([np.ptp(np.quantile(column, [0.001, 0.999])) if column.size else 0.0 for column in columns])
        rivals = units_of("q") | {"ticks": TURN_TICKS / (2 * np.pi)}
        covered = {unit: float(np.max(moved / divisor / ranges)) for unit, divisor in rivals.items()}
        fitting = [unit for unit, share in covered.items() if _COVERED[0] <= share <= _COVERED[1]]
        if len(fitting) == 1 and fitting[0] != "ticks":
            return Decision(fitting[0], "assumed", "limits", numbers)
    return Decision("deg", "assumed", "whole", numbers)


def _in_ticks(columns: Sequence[Array]) -> bool:
    """Tells whether all joints change in steps of a tick in degrees; those of percent depend on a range."""
    moved = [values - values[0] for values in map(np.unique, columns) if len(values) > 1]
    if sum(map(len, moved)) < 20:  # too few steps to tell
        return False
    ticks = [np.concatenate(moved) * turn / 360 for turn in (TURN_TICKS, TURN_TICKS - 1)]  # LeRobot divides by either
    return any(float(np.quantile(np.abs(count - np.round(count)), 0.99)) < 0.15 for count in ticks)


def unit_of_command(
    command: Array, position: Array, slides: bool = False, unit: str | None = None, named: bool = False
) -> Decision | None:
    """The unit in which numbers are the commands that joints follow, each of them; None where they follow in none.

    Args:
        command: `(sample, joint)`, in an unknown unit.
        position: `(sample, joint)` in SI units.
        slides: whether these joints are prismatic.
        unit: that the names state.
        named: whether they are commands by their names. It is then enough that most joints follow: that two are
            exchanged or one is reversed is a fault of the data, and not another meaning of the columns.
    """
    finite = np.isfinite(position).all(1) & np.isfinite(command).all(1)
    if not finite.any():
        return None
    far = np.maximum(0.5 * np.std(position[finite], axis=0), 0.05)  # joints are nearer to it at most of the time
    units = {name: size for name, size in units_of("q", slides).items() if unit in (None, name)}
    away = {name: np.median(np.abs(command / size - position)[finite], axis=0) / far for name, size in units.items()}
    closest = min(away, key=lambda name: float(away[name].max()))
    if (away[closest] > 1).any():
        following = {name: int(np.sum(distance <= 1)) for name, distance in away.items()}
        closest = max(following, key=lambda name: following[name])
        if not named or 2 * following[closest] <= position.shape[1]:
            return None
        others = [int(joint) + 1 for joint in np.flatnonzero(away[closest] > 1)]
        return Decision(closest, "certain" if unit else "likely", "mostly_follows", {"others": others})
    return by_name(closest) if unit else Decision(closest, "certain", "follows", {})


def rate_unit(
    rate: Array, position: Array | None, usual: str, time: Array | None, units: Mapping[str, float]
) -> Decision:
    """The unit of velocities or accelerations: that of the positions per second, unless their change says otherwise.

    Args:
        rate: velocities `(sample, joint)`, in an unknown unit.
        position: joint positions `(sample, joint)` in rad, or m of prismatic joints; None where unknown.
        usual: the unit in which they were given, such as `deg`.
        time: `(sample,)` s, or None.
        units: of positions, each with what to divide by to get to the first.
    """
    if position is None or time is None or len(time) < 3:
        return Decision(usual, "assumed", "as_positions", {})
    step = np.diff(time)
    with np.errstate(all="ignore"):
        slope = (position[1:] - position[:-1]) / step[:, None]
        middle = 0.5 * (rate[1:] + rate[:-1])
        fast = np.abs(slope) > 0.3 * np.nanmax(np.abs(slope), initial=0.0)
        ratio = np.nanmedian(np.abs(middle[fast]) / np.abs(slope[fast])) if fast.any() else np.nan
    for unit, divisor in units.items():
        if 0.5 < ratio / divisor < 2.0:
            return Decision(unit, "certain", "slope", {"ratio": float(ratio), "unit": next(iter(units))})
    return Decision(usual, "assumed", "as_positions", {})


def length_unit(position: Array) -> Decision:
    """The unit of positions `(sample, 3)`, or of prismatic joints `(sample, joint)`."""
    position = without_marks(position)
    finite = complete_rows(position)
    spread = float(np.max(np.ptp(np.quantile(finite, [0.02, 0.98], axis=0), axis=0))) if len(finite) else 0.0
    numbers = {"spread": spread}
    are_whole = in_whole_numbers(finite)
    if spread > 1e5 or (are_whole and spread > _LONGEST_MM[1]):
        fine = "um" if spread > 1e5 else "dmm"
        return Decision(fine, "likely" if fine == "um" else "assumed", "beyond_reach", numbers)
    if spread > 10.0:  # no arm reaches so far
        sure: Sureness = "certain" if spread <= _LONGEST_MM[int(not are_whole)] else "assumed"
        return Decision("mm", sure, "beyond_reach", numbers)
    # an arm that moved less than 5 mm is not measured
    return Decision("m", "likely" if spread < 5.0 else "assumed", "within_reach", numbers)


def unit_within_reach(position: Array, reach: float, centres: Sequence[Array]) -> str | None:
    """`m` or `mm`, in which most positions are where an arm can work; None where that is of both or of neither.

    Args:
        position: `(row, 3)`.
        reach: m, of the arm.
        centres: `(3,)` m each, where its base may be.
    """
    units = []
    for unit in ("m", "mm"):
        points = position / units_of("x")[unit]
        distances = [np.nanmedian(np.linalg.norm(points - centre, axis=1)) for centre in centres]
        if any(_NEAREST * reach < distance < 1.1 * reach for distance in distances):
            units.append(unit)
    return units[0] if len(units) == 1 else None


def current_unit(current: Array) -> Decision:
    """`mA` or `A`."""
    return _by_largest(current, 100.0, "A", "mA")


def torque_unit(torque: Array) -> Decision:
    """`mNm` or `Nm`; whole numbers, which may be neither, have the reason `register`."""
    decided = _by_largest(torque, LARGE_NM, "Nm", "mNm")
    if 100 < decided.numbers["largest"] <= LARGE_NM and in_whole_numbers(torque):
        return decided._replace(reason="register")
    return decided


def _by_largest(values: Array, limit: float, usual: str, small: str) -> Decision:
    largest = _largest(values)
    large = largest > limit
    return Decision(small if large else usual, "likely" if large else "assumed", "largest", {"largest": largest})


def time_unit(time: Array, position: Array | None) -> Decision:
    """`s`, `ms`, `us` or `ns`: of a clock by its size, else by the speed that joints would have.

    Microseconds since a controller was started may be as large as seconds since 1970. They are such where rows of that
    clock would be far apart, and joints move at a usual speed in another unit.

    Args:
        time: `(sample,)`.
        position: joint positions `(sample, joint)` in rad, or m; None where unknown.
    """
    finite = time[np.isfinite(time)]
    start = float(np.min(finite, initial=np.inf))
    clock = next((unit for earliest, unit in _CLOCKS if earliest <= start < np.inf), "")
    steps = np.diff(finite)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    speed = 0.0
    if position is not None and len(finite) == len(position):
        with np.errstate(invalid="ignore"):
            moved = np.nanmax(np.abs(np.diff(position, axis=0)), axis=1, initial=0.0)
        usable = (steps > 0) & np.isfinite(moved) & (moved > 1e-5)
        speed = float(np.median(moved[usable] / steps[usable])) if usable.any() else 0.0
    units = units_of("time")
    if clock and (not speed or step / units[clock] <= _STEPS_S[1]):
        return Decision(clock, "certain", "clock", {"start": start})
    for unit, divisor in units.items():
        possible = _STEPS_S[0] <= step / divisor <= _STEPS_S[1]
        if possible and (not speed or _SLOW <= speed * divisor <= _FAST):
            sure: Sureness = "likely" if speed else "assumed"
            return Decision(unit, sure, "step", {"step_s": step / divisor, "speed": speed * divisor})
    if clock:
        return Decision(clock, "certain", "clock", {"start": start})
    return Decision("s", "assumed", "step", {"step_s": step, "speed": speed})


def rotation_form(rotation: Array, unit: Decision | None, form: Decision | None) -> tuple[Decision, Decision]:
    """The form and the unit of a rotation of which no arm tells more.

    Args:
        rotation: `(sample, 3)` numbers, `(sample, 4)` of a quaternion or `(sample, 9)` of a matrix.
        unit, form: where their names say it.

    Returns:
        the name of a form in `FORMS`; and `rad`, `deg` or nothing.
    """
    if rotation.shape[1] in (4, len(MATRIX)):
        return form or Decision("scalar_last", "assumed", "usual_quaternion", {}), by_name("")
    finite = complete_rows(rotation)
    largest = _largest(finite)
    by_size = Decision("deg" if largest > WIDE_RAD else "rad", "likely", "largest_angle", {"largest": largest})
    if largest > TURNS_DEG:  # a rotation has no more turns than one
        size_in = {name: largest / divisor for name, divisor in units_of("rx").items() if name in FINE}
        finest = next((name for name, size in size_in.items() if size < WIDE_RAD), "deg")
        by_size = Decision(finest, "assumed", "largest_angle", {"largest": largest})
    angle = unit or by_size
    if form:
        return form, angle
    norm = np.linalg.norm(finite, axis=1) / units_of("rx")[angle.choice]
    if np.mean(norm > 1.01 * np.pi) > 0.01:
        return Decision("roll", "likely", "beyond_half_turn", {"largest": float(norm.max())}), angle
    if angle.choice.endswith("deg"):
        return Decision("roll", "assumed", "usual_degrees", {}), angle
    return Decision("rx", "assumed", "within_half_turn", {}), angle


def without_marks(values: Array) -> Array:
    """Numbers `(sample, column)` with NaN in the place of those that repeat exactly and are far larger than all others.

    They stand where nothing was measured (`recordings.placeholders`) and say nothing of a unit.
    """
    if not values.size:
        return values
    size = np.where(np.isfinite(values), np.abs(values), 0.0).reshape(len(values), -1)
    largest = size.max(axis=1)
    levels, count = np.unique(largest, return_counts=True)
    ratio, share = _MARKED
    while len(levels) > 2 and 1 < count[-1] < share * len(values) and levels[-1] > ratio * levels[-2]:
        levels = levels[:-1]
        count = count[:-1]
    return np.where(size <= levels[-1], values.reshape(size.shape), np.nan).reshape(values.shape)


def _largest(values: Array) -> float:
    """The largest magnitude but for marks, and for the highest thousandth, which may be faults."""
    values = without_marks(values)
    magnitudes = np.abs(values[np.isfinite(values)])
    return float(np.quantile(magnitudes, 0.999)) if magnitudes.size else 0.0
