"""The sensor of touches, distances and heights of a recording, and what of it a tool shows in closed form."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.sensors.points import Axis, Contact, Distance, Plane, Rod
from lite6jax.sensors.sensor import Sensor

Array = NDArray[np.floating]


def touch_sensor(recording: Recording, noise: float) -> Sensor:
    """The sensor of touches, distances or heights, with what is known of its points, planes, anchors or axis.

    Args:
        recording: of such readings.
        noise: m, one sigma of them.

    Raises:
        InputError: a ring of known distances, or one place for several anchors.
    """
    readings, settings = recording.touches, recording.settings
    assert readings is not None
    whitener = np.full(2, 1 / noise)
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


def shown_by(sensor: Sensor, tool: Array) -> Sensor:
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


def require_scale(recording: Recording, sensor: Sensor) -> None:
    """Refuses touches that any chain of another size would have as well.

    Raises:
        InputError: as said, or known distances of contacts that are not there.
    """
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
