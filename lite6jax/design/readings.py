"""Where to put sockets, plates, an anchor or a camera, and the poses at which an arm reads them.

Poses are reached by inverse kinematics: the tool's point in each socket or on each plate at any orientation, the board
in sight of the camera.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.calibration.problem import TOUCHED_TOLERANCE
from lite6jax.design.candidates import Candidates, Filter, all_pass, inside_limits
from lite6jax.design.information import Experiment
from lite6jax.design.sensor import BoardView, PlacedReading, Point, Sensor
from lite6jax.domains.pose.inverse import Target, reach
from lite6jax.errors import InputError
from lite6jax.model import ArmModel, ModelForm
from lite6jax.recordings.readings import Kind, Readings, readings_from_arrays
from lite6jax.recordings.settings import BoardSettings, KnownDistance, PoseSource, RecordingSettings
from lite6jax.sensors.points import Axis, Contact, Distance, Plane, Rod

Array = NDArray[np.floating]

SOCKETS_APART = 0.05
"""m, of the two sockets of one plate, …"""
SOCKETS_KNOWN = 5e-5
"""… and its standard deviation."""
BOARD = BoardSettings(7, 5, 0.02, 2e-5)
CAMERA = {"fx": 1450.0, "fy": 1452.0, "cx": 958.0, "cy": 603.0, "width": 1920.0, "height": 1200.0}
DISTORTION = (-0.11, 0.09, 4e-4, -3e-4, -0.02)
_TILT = 0.6
"""rad, by which a board is turned from facing the camera."""
_PLATE = 0.08
"""m, half a plate's side."""
_ROUNDS = 5
"""Times as many poses are tried as are wanted, at most: filters refuse some, and some places are out of reach."""


class Reader(NamedTuple):
    """A reading that is no pose: one sigma of it, m or px, its name in a sidecar, and where the tool is.

    The point, the board or the camera is away from the last joint's axis, m in the flange's frame.
    """

    kind: Kind
    noise: float
    source: PoseSource
    tool: Point


READERS: Mapping[str, Reader] = {
    "contact": Reader("contact", 1e-4, "touch", (0.02, 0.0, 0.09)),
    "plane": Reader("plane", 2e-5, "touch", (0.0, 0.03, 0.06)),
    "distance": Reader("distance", 5e-5, "draw_wire", (0.01, -0.02, 0.05)),
    "axis": Reader("axis", 2e-5, "height_gauge", (0.02, 0.0, 0.05)),
    "fixed_camera": Reader("camera", 0.15, "camera", (0.02, 0.0, 0.03)),
    "flange_camera": Reader("camera", 0.15, "camera", (0.04, 0.0, 0.03)),
}
"""By name."""


def draw_place(rng: np.random.Generator, arm: Arm, angle: float) -> Array:
    """A point within reach, in front of the arm at an angle about its base."""
    radius = arm.reach * rng.uniform(0.45, 0.6)
    height = arm.reach * rng.uniform(0.1, 0.4)
    return np.array([radius * np.cos(angle), radius * np.sin(angle), height])


def draw_views(rng: np.random.Generator, samples: int, arm: Arm, fixed: bool) -> tuple[Array, Array]:
    """Poses of a board in sight of a camera `(sample, 4, 4)`, and where what stands is in the arm's base `(4, 4)`."""
    middle = np.array(BOARD.points).mean(0)
    facing = np.diag([1.0, -1.0, -1.0])  # the board's z towards the camera
    turn = Rotation.from_rotvec(_TILT * rng.uniform(-1, 1, (samples, 3)) * [1, 1, 2]).as_matrix()
    wide = 0.3 * arm.reach if fixed else 0.1
    far = (0.9 if fixed else 0.35) + wide * rng.uniform(-1, 1, samples)
    board_poses = np.tile(np.eye(4), (samples, 1, 1))
    board_poses[:, :3, :3] = facing @ turn
    aside = wide * rng.uniform(-1, 1, (samples, 2))
    board_poses[:, :3, 3] = np.concatenate([aside, far[:, None]], 1) - board_poses[:, :3, :3] @ middle
    centre = draw_place(rng, arm, 0.0)
    T = np.eye(4)
    if fixed:  # looks along −x at the arm
        T[:3, :3] = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        T[:3, 3] = centre + np.array([0.9, 0.0, 0.0])
    else:  # the board lies on the table, its z upwards
        T[:3, 3] = centre * [1, 1, 0.2] - middle
    return board_poses, T


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
    """An experiment with a reading of `READERS`, whose places, tool and camera are unknown.

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
    reader = READERS[name]
    rng = np.random.default_rng([seed, 51])
    sigma = noise or reader.noise
    point = np.eye(4)
    point[:3, 3] = tool_at or reader.tool
    form = SixParameterForm(arm.dof, arm.sliding)
    T_tool = arm.T_joint_flange @ point
    if reader.kind == "camera":
        T = np.linalg.inv(draw_views(rng, 1, arm, name == "fixed_camera")[1])
        lens = (*(CAMERA[key] for key in ("fx", "fy", "cx", "cy")), *DISTORTION)
        mounted = "fixed" if name == "fixed_camera" else "on_flange"
        view = BoardView(mounted, sigma, lens, BOARD.points, joint_noise)
        model = ArmModel(arm.kinematics.ravel(), T, T_tool)  # type: ignore[arg-type]
        return Experiment(arm, ModelForm(form, True, True), model, view)
    angles = np.linspace(-1.2, 1.2, places) if places > 1 else [0.0]
    points = [draw_place(rng, arm, float(angle)) for angle in angles]
    if name == "contact":
        along = rng.standard_normal((places, 3)) * [1, 1, 0.2]
        along = SOCKETS_APART * along / np.linalg.norm(along, axis=1, keepdims=True)
        points = [socket for at, shift in zip(points, along, strict=True) for socket in (at, at + shift)]
    elif name != "plane":
        points = [1.6 * draw_place(rng, arm, 2.5)]
    at = np.array(points).T
    count = len(points)
    ends = ("_a", "_b") if name == "contact" else ("",)
    names = tuple(f"plate{k // len(ends) + 1}{ends[k % len(ends)]}" for k in range(count))
    group = np.arange(count)
    whitener = np.full(2, 1 / sigma)
    zeros = np.zeros(count)
    free = (True,) * count
    if name == "contact":
        rods = tuple(Rod(k, k + 1, SOCKETS_APART, SOCKETS_KNOWN) for k in range(0, count, 2))
        reading = Contact(group, whitener, at, names, free, rods)
    elif name == "plane":
        tilted = np.array([[0.0, 0.0, 1.0], [1.0, 0.1, 0.1], [0.1, 1.0, 0.2]])[group % 3].T
        reading = Plane(group, whitener, tilted / np.linalg.norm(tilted, axis=0), at, zeros, names, free)
    elif name == "distance":
        reading = Distance(group, whitener, zeros, at, np.zeros(1), names, free)
    else:
        reading = Axis(group, whitener, zeros, np.array([0.0, 0.0, 1.0]), np.zeros(1), True)
    placed = tuple(
        (place_name, (float(x), float(y), float(z))) for place_name, (x, y, z) in zip(names, points, strict=True)
    )
    chain_precision = np.array([TOUCHED_TOLERANCE[unit == "rad"] ** -2.0 for unit in form.units])
    model_form = ModelForm(form, False, True)
    return Experiment(
        arm,
        model_form,
        ArmModel(arm.kinematics.ravel(), np.eye(4), T_tool),  # type: ignore[arg-type]
        PlacedReading(reading, placed, sigma, joint_noise),
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
        if (target := _targets(of, rng, count)) is not None:
            q, reached = reach(of.model, target, q, limits, of.arm.sliding, rng)
            q = q[reached]
        drawn += count
        accepted.append(q[all_pass(filters, q)])
        passed += len(accepted[-1])
        if passed >= count:
            break
    if passed < min(count, 10):
        quantity = sensor.quantity if isinstance(sensor, Sensor | PlacedReading) else "images"
        raise InputError(
            f"candidates: {passed} of {drawn} poses for {quantity} are reached and pass; take another place of the "
            "tool (`tool_at=(X, Y, Z)`), another arm, or widen the filters"
        )
    passing = np.concatenate(accepted)
    return Candidates(passing[:count], drawn, {"reach": drawn - passed})


def _targets(of: Experiment, rng: np.random.Generator, count: int) -> Target | None:
    """Where the tool is to be in the sensor's coordinates, of each place as often; None where that is anywhere."""
    sensor = of.sensor
    if isinstance(sensor, BoardView):
        board_poses = draw_views(rng, count, of.arm, sensor.mounted == "fixed")[0]
        T = board_poses if sensor.mounted == "fixed" else np.linalg.inv(board_poses)
        return Target(T[:, :3, 3].T, np.moveaxis(T[:, :3, :3], 0, -1))  # type: ignore[arg-type]
    if not isinstance(sensor, PlacedReading) or sensor.quantity in ("distance", "axis"):
        return None
    place = np.arange(count) % len(sensor.places)
    at = np.array([point for _, point in sensor.places])[place]
    if isinstance(sensor.reading, Plane):
        normal = sensor.reading.normal.T[place]
        aside = rng.uniform(-_PLATE, _PLATE, (count, 3))
        at = at + aside - normal * np.sum(aside * normal, 1, keepdims=True)
    return Target(at.T, None)  # type: ignore[arg-type]


def read_places(of: Experiment, joint_position: Array) -> NDArray[np.integer]:
    """The place that each pose `(sample, joint)` reads, `(sample,)`; zero of what has but one."""
    if not isinstance(of.sensor, PlacedReading):
        return np.zeros(len(joint_position), int)
    T = frames.chain(frames.transform_from_row(of.arm.kinematics), joint_position, of.arm.sliding)
    return of.sensor.nearest(T @ np.asarray(of.model.T_flange_tool))


def planned_readings(
    of: Experiment, joint_position: Array, settings: RecordingSettings
) -> tuple[RecordingSettings, Readings | None]:
    """The sidecar of poses `(sample, joint)` that are to be read, and of touches which place each touches.

    Distances, heights and images are still to be measured: of these there are no readings.
    """
    sensor = of.sensor
    if not isinstance(sensor, PlacedReading) or sensor.quantity not in ("contact", "plane"):
        return settings, None
    names = [name for name, _ in sensor.places]
    labels = [names[k] for k in read_places(of, joint_position)]
    noise = {f"{sensor.quantity}_noise_m": sensor.position_noise}
    if isinstance(sensor.reading, Contact):
        distances = ((names[rod.parent], names[rod.child], rod) for rod in sensor.reading.rods)
        noise["contact_distances"] = tuple(KnownDistance((a, b), rod.length, rod.noise) for a, b, rod in distances)  # type: ignore[assignment]
    settings = replace(settings, pose_source="touch", tool="unknown", **noise)  # type: ignore[arg-type]
    return settings, readings_from_arrays(sensor.quantity, labels=labels)
