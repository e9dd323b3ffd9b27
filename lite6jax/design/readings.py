"""Where to put sockets, plates, an anchor or a camera, and the poses at which an arm reads them.

Poses are reached by inverse kinematics: the tool's point in each socket or on each plate at any orientation, the board
in sight of the camera.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.array_types import Array, Integers
from lite6jax.calibration.problem import TOUCHED_TOLERANCE
from lite6jax.design.candidates import Candidates, Filter, all_pass, inside_limits
from lite6jax.design.information import Experiment
from lite6jax.domains.pose.inverse import Target, reach
from lite6jax.errors import InputError
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings.readings import Readings, readings_from_arrays
from lite6jax.recordings.settings import RecordingSettings, declared_settings
from lite6jax.sensors.board import Camera
from lite6jax.sensors.points import PointSensor
from lite6jax.sensors.sensor import Point
from lite6jax.sensors.usual import READINGS

_ROUNDS = 5
"""Times as many poses are tried as are wanted, at most: filters refuse some, and some places are out of reach."""


# ------------------------------------------------------------------ the experiment


def plan_reading(
    arm: Arm,
    name: str,
    places: int = 2,
    *,
    noise: float | None = None,
    tool_at: Point | None = None,
    joint_noise: float = 0.0,
    seed: int = 0,
) -> Experiment:
    """An experiment with a reading of `READINGS`, whose places, tool and camera are unknown.

    Readings determine no base frame: the base is held, and places are relative to it. The chain's numbers are known to
    1 mm and 5 mrad where no pose is measured, as in a fit of touches.

    Args:
        arm: at its nominal geometry.
        name: of the reading.
        places: how many plates, each with two sockets of a known distance, or with one plane.
        noise: one standard deviation, m, and px of a camera; the usual one where not given.
        tool_at: the tool's point, m in the flange's frame; the usual one where not given.
        joint_noise: rad, one standard deviation of each joint's read-out.
        seed: of the places.

    Raises:
        InputError: no places.
    """
    if places < 1:
        raise InputError(f"{places} places: give 1 or more")
    kind = READINGS[name]
    rng = np.random.default_rng([seed, 51])
    sensor = replace(kind.plan(rng, arm.reach, places, noise or kind.usual_noise), joint_noise=joint_noise)
    point = np.eye(4)
    point[:3, 3] = tool_at or kind.usual_tool
    T_tool = arm.T_joint_flange @ point
    form = SixParameterForm(arm.dof, arm.sliding)
    values = arm.kinematics.ravel()
    if isinstance(sensor, Camera):
        model = ArmModel(values, np.linalg.inv(sensor.stands), T_tool)  # type: ignore[arg-type]
        return Experiment(arm, ModelForm(form, True, True), model, sensor)
    chain_precision = np.array([TOUCHED_TOLERANCE[unit == "rad"] ** -2.0 for unit in form.units])
    model_form = ModelForm(form, False, True)
    return Experiment(
        arm,
        model_form,
        ArmModel(values, np.eye(4), T_tool),  # type: ignore[arg-type]
        sensor,
        movable=np.arange(model_form.size) >= 6,
        precision=np.concatenate([chain_precision, np.zeros(6)]),
    )


# ------------------------------------------------------------------ its poses


def draw_readings(
    of: Experiment, count: int, seed: int = 0, filters: Sequence[Filter] = (), limit_margin: float = 0.0
) -> Candidates:
    """Joint positions at which an arm reads, as many of each place, until `count` pass all filters, applied in order.

    Each joint stays `limit_margin`, rad, from its limits.

    Raises:
        InputError: the arm reaches too few of the places, or filters refuse nearly all.
    """
    sensor = of.sensor
    rng = np.random.default_rng([seed, 52])
    limits = inside_limits(of.arm, limit_margin)
    lower, upper = limits.T
    accepted: list[Array] = []
    drawn = passed = 0
    for _ in range(_ROUNDS):
        q = rng.uniform(lower, upper, (count, of.arm.dof))
        if (poses := sensor.targets(rng, count, of.arm.reach)) is not None:
            q, reached = reach(of.model, target_of(poses, sensor.turned), q, limits, of.arm.sliding, rng)
            q = q[reached]
        drawn += count
        accepted.append(q[all_pass(filters, q)])
        passed += len(accepted[-1])
        if passed >= count:
            break
    if passed < min(count, 10):
        raise InputError(
            f"candidates: {passed} of {drawn} poses for {sensor.quantity} are reached and pass; take another place of "
            "the tool (`tool_at=(X, Y, Z)`), another arm, or widen the filters"
        )
    passing = np.concatenate(accepted)
    return Candidates(passing[:count], drawn, {"reach": drawn - passed})


def target_of(poses: Array, turned: bool) -> Target:
    """Where a tool is to be led, of poses `(sample, 4, 4)`; whether their orientations count."""
    rotation = np.moveaxis(poses[:, :3, :3], 0, -1) if turned else None
    return Target(poses[:, :3, 3].T, rotation)  # type: ignore[arg-type]


def read_places(of: Experiment, joint_position: Array) -> Integers:
    """The place that each pose `(sample, joint)` reads, `(sample,)`; zero of what has but one."""
    T = frames.chain(frames.transform_from_row(of.arm.kinematics), joint_position, of.arm.sliding)
    return of.sensor.nearest(T @ np.asarray(of.model.T_flange_tool))


def planned_readings(
    of: Experiment, joint_position: Array, settings: RecordingSettings
) -> tuple[RecordingSettings, Readings | None]:
    """The sidecar of poses `(sample, joint)` that are to be read, and of touches which place each touches.

    Distances, heights and images are still to be measured: of these there are no readings.
    """
    sensor = of.sensor
    if not (isinstance(sensor, PointSensor) and sensor.touched):
        return settings, None
    labels = [sensor.names[k] for k in read_places(of, joint_position)]
    declared = declared_settings(settings, None, {"pose_source": sensor.source, "tool": "unknown", **sensor.declared()})
    return declared, readings_from_arrays(sensor.kind, labels=labels)  # type: ignore[arg-type]
