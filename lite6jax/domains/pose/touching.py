"""From touches, distances and heights of a recording to their sensor: where its unknowns and the tool's point start.

The point of the tool and the sensor's own unknowns are found together, by Gauss–Newton from several points of the
tool and, at each, from what the sensor then shows in closed form. What the readings do not determine is refused.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.calibration.start import declared_tool, frames_from_poses
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.readings import Readings
from lite6jax.sensors.points import Axis, Contact, Distance, Plane, Rod
from lite6jax.sensors.sensor import Sensor

Array = NDArray[np.floating]

UNDECLARED_TOUCH = 1e-4
"""m, one sigma of readings whose noise is not declared."""
_TOOL_M = 0.15
"""Along each axis of the flange, where the tool's point is sought, beside its origin."""
_STEPS = 40
_SLACK = 3.0
"""Times the median reading, beyond which one counts less."""


class Touched(NamedTuple):
    """A sensor and the frames between which it reads.

    Attributes:
        sensor: with its unknowns where they start.
        T_sensor_base: `(4, 4)`, the base in the frame of the sensor's points.
        T_flange_tool: `(4, 4)`.
        noise: m.
        declared: the same, None where the sidecar does not declare it.
    """

    sensor: Sensor
    T_sensor_base: Array
    T_flange_tool: Array
    noise: float
    declared: float | None


def noise_of(recording: Recording, kind: str) -> float | None:
    """The declared noise of readings, m."""
    return getattr(recording.settings, f"{kind}_noise_m")


def touched(recording: Recording, flange: Array, frame_unknown: bool, scale_known: bool) -> Touched:
    """The sensor of touches, started.

    Args:
        recording: of touches, distances or heights.
        flange: nominal flange poses `(sample, 4, 4)` in the base's frame.
        frame_unknown: whether its points are known in another frame than the base's.
        scale_known: whether the chain's lengths are known.

    Raises:
        InputError: readings that say nothing of the tool's point or of a point, plane, anchor or axis; a known distance
            of contacts that are not there; no scale.
    """
    readings, settings = recording.touches, recording.settings
    assert readings is not None
    declared = noise_of(recording, readings.kind)
    noise = declared or UNDECLARED_TOUCH
    sensor = _sensor(recording, readings, np.full(2, 1 / noise))
    if not scale_known:
        _require_scale(recording, sensor)
    tool = None if settings.tool == "unknown" else declared_tool(recording)
    T_sensor_base = np.eye(4)
    if frame_unknown:
        assert isinstance(sensor, Contact)
        seen = np.asarray(sensor.points).T[sensor.group]
        T_sensor_base, found = frames_from_poses(flange, seen, None, None, tool)
        return Touched(sensor, T_sensor_base, found, noise, declared)
    T = np.eye(4) if tool is None else tool
    starts = [tool[:3, 3]] if tool is not None else _TOOL_M * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    solved = [_solved(_shown(sensor, _moved_tool(flange, T, t)), flange, T, t, tool is None) for t in starts]
    sensor, t, _ = min(solved, key=lambda one: one[2])
    return Touched(sensor, T_sensor_base, _with_point(T, t), noise, declared)


# ------------------------------------------------------------------ the sensor


def _sensor(recording: Recording, readings: Readings, whitener: Array) -> Sensor:
    """Of the readings, with what is known of its points, planes, anchors or axis; zero elsewhere."""
    settings = recording.settings
    there, group = np.unique(readings.group, return_inverse=True)
    names = tuple(readings.names[k] for k in there)
    if readings.kind == "contact":
        known = settings.contact_points or {}
        points = np.array([known.get(name, (0.0, 0.0, 0.0)) for name in names]).T
        free = tuple(name not in known for name in names)
        return Contact(group, whitener, points, names, free, _rods(recording, names, free))
    if readings.kind == "plane":
        planes = settings.planes or {}
        normal, height = np.tile([[0.0], [0.0], [1.0]], len(names)), np.zeros(len(names))
        for k, name in enumerate(names):
            if name in planes:
                length = np.linalg.norm(planes[name].normal)
                normal[:, k], height[k] = np.array(planes[name].normal) / length, planes[name].offset_m / length
        free = tuple(name not in planes for name in names)
        return Plane(group, whitener, normal, np.zeros_like(normal), height, names, free)
    if readings.kind == "distance":
        given = settings.anchor_m
        anchors = dict.fromkeys(names, given) if isinstance(given, tuple) else {} if given == "unknown" else given
        if isinstance(given, tuple) and len(names) > 1:
            raise InputError(
                f"{recording.source}: has anchors {', '.join(names)} and one place for all; write anchor_m as "
                f"{{{names[0]}: [x, y, z], ...}}, or unknown"
            )
        points = np.array([anchors.get(name, (0.0, 0.0, 0.0)) for name in names], float).T  # type: ignore[union-attr]
        free = tuple(name not in anchors for name in names)
        offset_free = settings.distance_offset == "unknown"
        return Distance(group, whitener, readings.value, points, np.zeros(1), names, free, offset_free)
    free = settings.axis == "unknown"
    direction = np.array((0.0, 0.0, 1.0) if free else settings.axis, float)
    return Axis(group, whitener, readings.value, direction / np.linalg.norm(direction), np.zeros(1), free)


def _rods(recording: Recording, names: tuple[str, ...], free: tuple[bool, ...]) -> tuple[Rod, ...]:
    """The known distances as a forest: each contact hangs on one before it.

    Raises:
        InputError: a ring of distances, or one between contacts of which both are known.
    """
    source, place = recording.source, {name: k for k, name in enumerate(names)}
    left = [one for one in recording.settings.contact_distances if set(one.between) <= place.keys()]
    rods: list[Rod] = []
    fixed = {k for k in range(len(names)) if not free[k]}
    reached = set(fixed)
    while left:
        at = next((one for one in left if {place[name] for name in one.between} & reached), left[0])
        left.remove(at)
        a, b = (place[name] for name in at.between)
        a, b = (b, a) if b in reached and a not in reached else (a, b)
        if b in reached:
            raise InputError(
                f"{source}: the distance of contacts {at.between[0]} and {at.between[1]} closes a ring of known ones; "
                "give the coordinates of all contacts as contact_points instead"
            )
        reached |= {a, b}
        rods.append(Rod(a, b, at.distance_m, at.noise_m))
    return tuple(rods)


# ------------------------------------------------------------------ where it starts


def _moved_tool(flange: Array, T: Array, point: Array) -> Array:
    """`(sample, 4, 4)` of the flange's tool `T` with another point."""
    return flange @ _with_point(T, point)


def _with_point(T: Array, point: Array) -> Array:
    out = T.copy()
    out[:3, 3] = point
    return out


def _shown(sensor: Sensor, tool: Array) -> Sensor:
    """The sensor with its unknowns as a tool `(sample, 4, 4)` shows them in closed form."""
    p, group = tool[:, :3, 3], np.asarray(sensor.group)
    if isinstance(sensor, Contact):
        points = np.array(sensor.points)
        for k in np.flatnonzero(sensor.free):
            points[:, k] = np.median(p[group == k], 0)
        for rod in sensor.rods:  # two sockets are no nearer to each other than the rod is long
            apart = points[:, rod.child] - points[:, rod.parent]
            apart = apart if np.linalg.norm(apart) > 0.1 * rod.length else np.array([rod.length, 0.0, 0.0])
            points[:, rod.child] = points[:, rod.parent] + rod.length * apart / np.linalg.norm(apart)
        return replace(sensor, points=points)
    if isinstance(sensor, Plane):
        normal, centre, height = (np.array(part) for part in (sensor.normal, sensor.centre, sensor.height))
        for k in np.flatnonzero(sensor.free):
            own = p[group == k]
            centre[:, k], height[k] = own.mean(0), 0.0
            normal[:, k] = np.linalg.svd(own - own.mean(0), full_matrices=True)[2][2]
        return replace(sensor, normal=normal, centre=centre, height=height)
    if isinstance(sensor, Distance):
        anchors = np.array(sensor.anchors)
        for k in np.flatnonzero(sensor.free):
            own, d = p[group == k], np.asarray(sensor.value)[group == k]
            A = np.concatenate([2 * own, -np.ones((len(own), 1))], 1)  # 2 p·a − |a|² = |p|² − d²
            anchors[:, k] = np.linalg.lstsq(A, np.sum(own**2, 1) - d**2, rcond=1e-9)[0][:3]
        return replace(sensor, anchors=anchors)
    assert isinstance(sensor, Axis)
    direction, value = np.array(sensor.direction), np.asarray(sensor.value)
    if sensor.free:
        direction = np.linalg.lstsq(p - p.mean(0), value - value.mean(), rcond=1e-9)[0]
        direction = direction / max(float(np.linalg.norm(direction)), 1e-9)
    return replace(sensor, direction=direction, constant=np.array([np.median(value - p @ direction)]))


def _solved(sensor: Sensor, flange: Array, T: Array, point: Array, tool_free: bool) -> tuple[Sensor, Array, float]:
    """The sensor, the tool's point, and the size of what is left, from a start."""
    prior = 1e-8 * np.array([one.precision for one in sensor.own])
    R, damping, n = flange[:, :3, :3], 1e-3, 3 * tool_free

    def look(sensor: Sensor, point: Array) -> tuple[Array, Array, Array, float]:
        tool = _moved_tool(flange, T, point)
        r = sensor.differences(tool)
        size = np.sqrt(np.sum(r**2, 0))
        scale = _SLACK * max(float(np.median(size)), 1e-7)
        weight = 1 / np.maximum(size / scale, 1.0)
        own = sensor.by_numbers(tool)
        by_point = np.einsum("ris,sik->krs", sensor.slopes(tool)[:, :3], R) if tool_free else own[:0]
        J = np.concatenate([by_point, own]) * np.sqrt(weight)
        offset = np.array([one.offset for one in sensor.own])
        J = J.reshape(len(J), -1)
        H, g = J @ J.T, J @ (r * np.sqrt(weight)).ravel()
        H[np.arange(n, len(H)), np.arange(n, len(H))] += prior
        g[n:] += prior * offset
        cost = float(np.sum(weight * size**2 / np.maximum(weight, 0.5)) + np.sum(prior * offset**2))
        return H, g, size, cost

    H, g, size, cost = look(sensor, point)
    for _ in range(_STEPS):
        if not len(H):
            break
        lengths = np.sqrt(np.maximum(np.diagonal(H), 1e-300))
        scaled = H / np.outer(lengths, lengths) + (damping + 1e-12) * np.eye(len(H))
        step = -np.linalg.solve(scaled, g / lengths) / lengths
        trial = sensor.displaced(step[n:]), point + (step[:n] if tool_free else 0.0)
        H_, g_, size_, cost_ = look(*trial)
        if cost_ <= cost and np.isfinite(cost_):
            done = cost - cost_ < 1e-9 * cost
            (sensor, point), H, g, size, cost, damping = trial, H_, g_, size_, cost_, damping / 10
            if done:
                break
        else:
            damping *= 10
            if damping > 1e8:
                break
    return sensor, point, float(np.median(size))


# ------------------------------------------------------------------ what has no length


def _require_scale(recording: Recording, sensor: Sensor) -> None:
    """Refuses touches that any chain of another size would have as well."""
    if isinstance(sensor, Contact):
        known = bool(sensor.rods) or len(sensor.free) - sum(sensor.free) > 1
        if not known and (given := recording.settings.contact_distances):
            a, b = given[0].between
            raise InputError(
                f"{recording.source}: contact_distances is between {a} and {b}, which are not both among its contacts "
                f"{', '.join(sensor.names[:6])}; correct the names"
            )
        remedy = "declare a known distance as contact_distances: [{between: [a, b], distance_m: 0.05, noise_m: 5.0e-5}]"
    elif isinstance(sensor, Plane):
        known, remedy = not all(sensor.free), "declare one plane's place as planes: {a: {normal, offset_m}}"
    else:
        return
    if not known:
        raise InputError(
            f"{recording.source}: nothing in it has a known length, and any size of the arm would fit; {remedy}, or "
            "the arm's own factory_calibration"
        )
