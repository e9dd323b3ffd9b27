"""How the numbers of a table are to be read: the units and the form of rotations that agree best with an arm.

Each is compared with the nominal forward kinematics, with the sensor's frame and the tool fitted in closed form.
"""

from collections.abc import Mapping
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.calibration.start import frames_from_poses
from lite6jax.recordings.columns import ANGLES, quaternions, units_of
from lite6jax.recordings.sizes import Decision, Sureness, length_unit

Array = NDArray[np.floating]

ROWS = 400
"""Spread over the recording: enough to tell readings that differ by factors or by whole rotations."""
FEWEST = 8
"""Rows: the frame and the tool have nine numbers."""
CLOSE = 0.05
"""Of the spread of the positions, which errors of the right reading do not exceed: a nominal arm of 1 m is off by
millimetres. A wrong reading is off by as much as the arm moves."""
CLOSE_RAD = 0.2
"""The same for orientations."""
CLEARLY = 3.0
"""Times the error of the best reading, which all others have where it is certain."""
SLIGHTLY = 1.3
"""The same where it is likely."""


LEAST_SPREAD_M = 5e-3
"""Of positions that say something of an arm, from their median: those of one touched point set no scale."""
LONGEST_TOOL_M = 1.0
"""Or the reach of an arm, if that is longer."""
FINEST_SENSOR_M = 2e-5
"""Above, an error may be a sensor's noise."""
COMPUTED_M = 2e-6
"""Below, it is none: controllers compute in single precision too."""
LEAST_TRAVEL_M = 0.02
"""Of positions of which is said that they are computed."""


class Pose(NamedTuple):
    """Columns of a table in its own units and conventions, rows without gaps.

    Attributes:
        joint: `(sample, joint)`, rad or deg, and m or mm of prismatic joints.
        position: `(sample, 3)`, m or mm.
        rotation: `(sample, 3 | 4)`, or None.
    """

    joint: Array
    position: Array
    rotation: Array | None


class Agreement(NamedTuple):
    """The readings that agree with an arm; None where they are not distinguished.

    Attributes:
        angle: `rad` or `deg` of the revolute joints.
        slide: `m` or `mm` of the prismatic joints.
        length: `m` or `mm` of the positions.
        form: of the rotation: the first name of one of `columns.ANGLES`, `scalar_first` or `scalar_last`.
        turn: `rad` or `deg` of three numbers of a rotation.
        error: m, the median error of the best reading; infinite where too few rows tell.
        spread: m, of the positions in it.
    """

    angle: Decision | None
    slide: Decision | None
    length: Decision | None
    form: Decision | None
    turn: Decision | None
    error: float
    spread: float

    @property
    def close(self) -> bool:
        """Whether the arm agrees with the poses at all."""
        return self.error <= CLOSE * self.spread


NO_AGREEMENT = Agreement(None, None, None, None, None, np.inf, 0.0)


def agreement(
    arm: Arm, pose: Pose, angle: str | None, slide: str | None, length: str | None, turn: str | None
) -> Agreement:
    """The readings of a table with which an arm agrees best.

    Args:
        arm: of as many joints.
        pose: the numbers.
        angle, slide, length, turn: units that are known already, or None.
    """
    if len(pose.joint) < FEWEST:
        return NO_AGREEMENT
    rows = np.unique(np.linspace(0, len(pose.joint) - 1, ROWS).astype(int))
    # a gantry that is a thousand times as large moves alike: the size decides the one unit, and that the other
    by_size = length is None and bool(arm.slides.all())
    length = length_unit(pose.position).choice if by_size else length
    possible = (
        _possible(angle, "q", False) if not arm.slides.all() else ("rad",),
        _possible(slide, "q", True) if arm.sliding else ("m",),
        _possible(length, "x", False),
    )
    tried = {}
    for turning, sliding, unit in product(*possible):
        divisor = np.where(arm.slides, units_of("q", True)[sliding], units_of("q")[turning])
        position = pose.position[rows] / units_of("x")[unit]
        tried[turning, sliding, unit] = _positions(arm, pose.joint[rows] / divisor, position)
    # a free tool takes up any scale where the axes cross, so that the size counts as well
    farthest = 2 * (arm.reach + max(arm.reach, LONGEST_TOOL_M))
    plausible = {units: one for units, one in tried.items() if LEAST_SPREAD_M < one.spread < farthest}
    by_size, tried = by_size or not plausible, plausible or tried
    best = min(tried, key=lambda units: tried[units].score)
    found = tried[best]
    of_turns, of_slides, of_places = (_decided(best[k], _scores(tried, k), CLOSE) for k in range(3))
    form, angle_of_turn = None, None
    if pose.rotation is not None and found.score <= CLOSE:
        form, angle_of_turn = _rotations(found.predicted, pose.rotation[rows], turn)
    return Agreement(
        of_turns, of_slides, None if by_size else of_places, form, angle_of_turn, found.error, found.spread
    )


def computed_by_controller(error: float, position: Array, joint: Array) -> bool:
    """Whether an arm reproduces positions as only the controller's own computation from the joints is reproduced.

    Args:
        error: m, the median distance of the positions from those of the arm's kinematics.
        position: `(sample, 3)` m.
        joint: `(sample, joint)` rad, and m of prismatic joints.
    """
    spread = median_distance(position)
    turn = max(digit_step(joint), np.deg2rad(digit_step(np.rad2deg(joint))))
    step = float(np.hypot(digit_step(position), turn * spread * joint.shape[1] ** 0.5))
    return spread > LEAST_TRAVEL_M and error <= min(max(COMPUTED_M, step), FINEST_SENSOR_M)


def digit_step(values: Array) -> float:
    """The place of the last digit with which numbers are written, such as 0.001; 0 beyond the ninth."""
    there = values[np.isfinite(values)]
    there = there[:: max(len(there) // 1000, 1)]
    digits = (k for k in range(10) if np.allclose(there, np.round(there, k), rtol=0, atol=1e-3 * 10.0**-k))
    place = next(digits, None)
    return 0.0 if place is None else 10.0**-place


def median_distance(position: Array) -> float:
    """m, of positions `(sample, 3)` from their median."""
    return float(np.median(np.linalg.norm(position - np.median(position, axis=0), axis=1)))


def _possible(known: str | None, quantity: str, slides: bool) -> tuple[str, ...]:
    return (known,) if known else tuple(units_of(quantity, slides))


class _Tried(NamedTuple):
    """A reading: its median error in m, how far the positions spread, the rotations that it predicts of the flange."""

    error: float
    spread: float
    predicted: Array

    @property
    def score(self) -> float:
        return self.error / max(self.spread, 1e-9)


def _positions(arm: Arm, joint: Array, position: Array) -> _Tried:
    flange = flange_poses(arm, joint)
    error, T_sensor_base = match_poses(flange, position)
    return _Tried(error, median_distance(position), T_sensor_base[:3, :3] @ flange[:, :3, :3])


def flange_poses(arm: Arm, joint: Array) -> Array:
    """Nominal `T_base_flange` `(sample, 4, 4)` at joints `(sample, joint)` in SI units."""
    return frames.chain(arm.links, joint, arm.sliding) @ arm.T_joint_flange


def match_poses(flange: Array, position: Array) -> tuple[float, Array]:
    """The median error in m of positions `(sample, 3)` with frame and tool in closed form, and `T_sensor_base`."""
    T_sensor_base, T_flange_tool = frames_from_poses(flange, position, None, None, None)
    missed = position - (T_sensor_base @ flange @ T_flange_tool)[:, :3, 3]
    return float(np.median(np.linalg.norm(missed, axis=1))), T_sensor_base


def _scores(tried: Mapping[tuple[str, ...], _Tried], place: int) -> dict[str, float]:
    """Of each unit at a place the best score, whatever the others are."""
    scores: dict[str, float] = {}
    for units, found in tried.items():
        scores[units[place]] = min(found.score, scores.get(units[place], np.inf))
    return scores


def _rotations(predicted: Array, rotation: Array, unit: str | None) -> tuple[Decision | None, Decision | None]:
    """The form of a rotation and its unit, by how constant the tool is on the flange."""
    tried: dict[tuple[str, str], float] = {}
    if rotation.shape[1] == 4:
        for name, order in (("scalar_first", (1, 2, 3, 0)), ("scalar_last", (0, 1, 2, 3))):
            length = np.linalg.norm(rotation, axis=1, keepdims=True)
            tried[name, ""] = _wobble(predicted, rotation[:, order] / np.where(length > 0, length, 1.0) + 0.0)
    else:
        for form, angle in product(ANGLES, (unit,) if unit else ("rad", "deg")):
            given = quaternions(form, rotation / units_of(form[0])[angle])
            tried[form[0], angle] = _wobble(predicted, np.roll(given, -1, axis=1))
    best = min(tried, key=lambda reading: tried[reading])
    of_forms = {form: error for (form, angle), error in tried.items() if angle == best[1]}
    of_units = {angle: error for (form, angle), error in tried.items() if form == best[0]}
    form = _decided(best[0], of_forms, CLOSE_RAD)
    return form, None if form is None or not best[1] else _decided(best[1], of_units, CLOSE_RAD)


def _wobble(predicted: Array, quaternion: Array) -> float:
    """rad, the median turn of the tool on the flange from its mean; `quaternion` scalar last."""
    from scipy.spatial.transform import Rotation  # takes longer than a look at positions

    usable = np.linalg.norm(quaternion, axis=1) > 0.5
    if usable.sum() < FEWEST:
        return np.pi
    relative = np.swapaxes(predicted[usable], 1, 2) @ Rotation.from_quat(quaternion[usable]).as_matrix()
    turned = Rotation.from_matrix(relative)
    return float(np.median((turned.mean().inv() * turned).magnitude()))


def _decided(best: str, errors: dict[str, float], limit: float) -> Decision | None:
    """The best of some readings; None where it does not agree, or others do as well."""
    others = {name: error for name, error in errors.items() if name != best}
    numbers = {"error": errors[best], "others": others}
    if errors[best] > limit:
        return None
    if not others:
        return Decision(best, "certain", "kinematics", numbers)
    ratio = min(others.values()) / max(errors[best], 1e-12)
    if ratio < SLIGHTLY:
        return None
    sure: Sureness = "certain" if ratio >= CLEARLY else "likely"
    return Decision(best, sure, "kinematics", numbers)
