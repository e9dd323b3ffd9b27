"""What holds for every sensor: zero at the truth, columns against differences, own unknowns that move what is read."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lite6jax.sensors.points import Axis, Contact, Distance, Plane, Rod
from lite6jax.sensors.sensor import host_frame
from lite6jax.sensors.usual import READINGS, plan_sensor
from lite6jax.sensors.usual import SENSORS as USUAL

SAMPLES = 12


def tools(seed=0):
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (SAMPLES, 1, 1))
    T[:, :3, :3] = Rotation.random(SAMPLES, rng).as_matrix()
    T[:, :3, 3] = rng.uniform(-0.5, 0.5, (SAMPLES, 3))
    return T


def sensors():
    rng = np.random.default_rng(1)
    group, W = np.arange(SAMPLES) % 3, np.full(2, 1 / 5e-5)
    points, unit = rng.uniform(-0.4, 0.4, (3, 3)), lambda v: v / np.linalg.norm(v, axis=0)
    rods = (Rod(0, 1, 0.05, 1e-5), Rod(1, 2, 0.1, 1e-4))
    value, names = rng.uniform(0.2, 0.9, SAMPLES), ("a", "b", "c")
    return {
        "contact": Contact(group, W, points, names, (True, False, True)),
        "contact with rods": Contact(group, W, points, names, (True,) * 3, rods),
        "plane": Plane(group, W, unit(points), points, np.zeros(3), names, (True, True, False)),
        "distance": Distance(group, W, value, points, np.array([0.01]), names, (True, False, True), True),
        "axis": Axis(0 * group, W, value, unit(points[:, 0]), np.array([0.1]), True),
        "axis known": Axis(0 * group, W, value, np.array([0.0, 0.0, 1.0]), np.array([0.1]), False),
    }


SENSORS = sensors()


def plainly(name, sensor, T):
    """The readings by their formula in plain NumPy."""
    p, g = T[:, :3, 3], sensor.group
    if isinstance(sensor, Contact):
        return (p - sensor.points.T[g]).T
    if isinstance(sensor, Plane):
        return np.sum(sensor.normal.T[g] * (p - sensor.centre.T[g]), 1)[None] - sensor.height[g]
    if isinstance(sensor, Distance):
        return (np.linalg.norm(p - sensor.anchors.T[g], axis=1) + sensor.constant - sensor.value)[None]
    return (p @ sensor.direction + sensor.constant - sensor.value)[None]


@pytest.mark.parametrize("name", SENSORS)
def test_readings_are_those_of_the_formula(name):
    sensor, T = SENSORS[name], tools()
    np.testing.assert_allclose(sensor.differences(T), plainly(name, sensor, T), atol=1e-12)
    np.testing.assert_allclose(sensor.residual(host_frame(T)), plainly(name, sensor, T) / 5e-5, rtol=1e-9)


@pytest.mark.parametrize("name", SENSORS)
def test_columns_are_differences(name):
    sensor, T, step = SENSORS[name], tools(), 1e-6
    rng = np.random.default_rng(2)
    shift, turn = rng.standard_normal((2, 3, SAMPLES))

    def moved(size):
        out = T.copy()
        out[:, :3, 3] += size * shift.T
        out[:, :3, :3] = Rotation.from_rotvec(size * turn.T).as_matrix() @ T[:, :3, :3]
        return sensor.differences(out)

    slope = (moved(step) - moved(-step)) / (2 * step)
    np.testing.assert_allclose(sensor.columns(T, shift, turn), slope, atol=1e-7)
    for k, column in enumerate(sensor.by_numbers(T)):
        one = step * np.eye(sensor.numbers)[k]
        slope = (sensor.moved(one).differences(T) - sensor.moved(-one).differences(T)) / (2 * step)
        np.testing.assert_allclose(column, slope, atol=1e-7)
    assert len(sensor.by_numbers(T)) == sensor.numbers == len(sensor.own)


@pytest.mark.parametrize("name", SENSORS)
def test_samples_that_are_selected_read_as_before(name):
    sensor, T, some = SENSORS[name], tools(), np.array([7, 2, 3])
    np.testing.assert_array_equal(sensor.select(some).differences(T[some]), sensor.differences(T)[:, some])


def test_the_length_of_a_rod_is_one_number_with_its_prior():
    sensor = SENSORS["contact with rods"]
    apart = np.linalg.norm(sensor.points[:, 1] - sensor.points[:, 0])
    (length,) = [k for k, one in enumerate(sensor.own) if one.precision == pytest.approx(1e-5**-2)]
    assert sensor.own[length].offset == pytest.approx(apart - 0.05)
    step = np.zeros(sensor.numbers)
    step[length], step[length + 1], step[0] = 0.003, 0.002, 0.01
    points = np.asarray(sensor.moved(step).points)
    assert np.linalg.norm(points[:, 1] - points[:, 0]) == pytest.approx(apart + 0.003, abs=1e-12)
    # what hangs on a child goes with it
    before = sensor.points[:, 2] - sensor.points[:, 1]
    np.testing.assert_allclose(points[:, 2] - points[:, 1], before, atol=1e-12)


PLANNED = {
    **USUAL,
    **{name: kind.plan(np.random.default_rng(3), 0.6, kind.usual_places, 2e-5) for name, kind in READINGS.items()},
}


@pytest.mark.parametrize("name", PLANNED)
def test_a_planned_sensor_reads_each_tool_exactly(name):
    T = tools()
    exact = PLANNED[name].exact(T)
    where = exact.nearest(T)
    if exact.touched:  # reads nothing but the place: on it, it is met
        for k, place in enumerate(exact.at.T):
            T[where == k, :3, 3] = place
        exact = PLANNED[name].exact(T)
        assert (exact.nearest(T) == where).all()
    np.testing.assert_allclose(exact.differences(T), 0, atol=1e-9)
    assert exact.differences(T).shape == (exact.rows, SAMPLES)


@pytest.mark.parametrize("name", PLANNED)
def test_columns_of_a_plan_are_differences_over_the_noise(name):
    sensor = PLANNED[name]
    T = tools()
    if name.endswith("_camera"):  # in sight
        T = sensor.targets(np.random.default_rng(5), SAMPLES, 0.6)
    exact, step = sensor.exact(T), 1e-6
    by_tool, by_numbers = sensor.columns_of_plan(T)
    assert by_tool.shape == (sensor.rows, 6, SAMPLES)
    assert by_numbers.shape == (len(sensor.own), sensor.rows, SAMPLES)

    def read(twist):
        moved = T.copy()
        moved[:, :3, 3] += twist[:3]
        moved[:, :3, :3] = Rotation.from_rotvec(twist[3:]).as_matrix() @ T[:, :3, :3]
        rows = exact.differences(moved)
        if exact.whitener.ndim == 1:
            return np.repeat(exact.whitener, 3)[: len(rows), None] * rows
        return np.einsum("rcs,cs->rs", exact.whitener, rows)

    for k, twist in enumerate(step * np.eye(6)):
        slope = (read(twist) - read(-twist)) / (2 * step)
        np.testing.assert_allclose(by_tool[:, k], slope, atol=1e-6 * np.abs(by_tool).max())


@pytest.mark.parametrize("name", READINGS)
def test_a_simulated_sensor_records_what_it_reads(name):
    sensor, target, error = READINGS[name].simulate(np.random.default_rng(6), SAMPLES, 0.6, 0.0, 2e-5)
    assert not error.any()
    T = tools() if target is None else target
    read = sensor.record(T, error)
    if "labels" in read:
        assert [sensor.names[k] for k in sensor.group] == read["labels"]
        np.testing.assert_allclose(sensor.differences(T), 0, atol=1e-12)
    elif "value" in read:
        np.testing.assert_allclose(read["value"], sensor.exact(T).value)
    else:
        assert np.isfinite(read["pixels"]).all((1, 2)).mean() > 0.5
    assert sensor.declared()


def test_noise_is_as_it_was_given_and_other_noise_takes_its_place():
    sensor = plan_sensor("pose", 3.7e-5, 1.3e-4, joint_noise=1e-5)
    assert sensor.to_dict() == {
        "quantity": "pose",
        "position_noise": 3.7e-5,
        "orientation_noise": 1.3e-4,
        "joint_noise": 1e-5,
    }
    assert sensor.with_noise(position=2e-5).to_dict() == sensor.to_dict() | {"position_noise": 2e-5}
    assert plan_sensor("axis", 1e-5, direction=(0.0, 3.0, 4.0)).to_dict()["direction"] == [0.0, 0.6, 0.8]
