"""Sensors that are no poses, as designs plan with them: against differences of what they read, and against fits."""

from typing import Any

import numpy as np
import pytest
from typed import flat, refused, run

from lite6jax.arms import frames
from lite6jax.arms.description import load_bundled
from lite6jax.design.poses import plan_poses
from lite6jax.design.readings import draw_readings, plan_reading, read_places
from lite6jax.errors import InputError
from lite6jax.recordings import read_recording
from lite6jax.sensors.usual import READINGS
from tests.oracles.arms import random_positions

LITE6 = load_bundled("lite6")
STEP = 1e-6


def tool_points(experiment, q, kinematics=LITE6.kinematics, tool=(0.0, 0.0, 0.0)):
    T = frames.chain(frames.transform_from_row(kinematics), q, LITE6.sliding) @ np.asarray(
        experiment.model.T_flange_tool
    )
    return T[:, :3, 3] + T[:, :3, :3] @ np.asarray(tool)


def read(experiment, at, point):
    """What a sensor with its places moved by `at` reads of points `(sample, 3)`, over its noise, in plain NumPy."""
    sensor = experiment.sensor
    places = sensor.at.T
    group = read_places(experiment, random_positions(np.random.default_rng(0), 8, 6))  # of the poses at rest
    if sensor.quantity == "contact":
        reading = point - places[group] - at  # the second socket of a plate moves with the first
    elif sensor.quantity == "plane":
        reading = (np.sum(sensor.normal.T[group] * (point - places[group]), 1) - at[0])[:, None]
    elif sensor.quantity == "distance":
        reading = np.linalg.norm(point - places[0] - at[:3], axis=1)[:, None]
    else:
        reading = (point @ sensor.direction + at[0])[:, None]
    return reading / sensor.position_noise


@pytest.mark.parametrize("name", ["contact", "plane", "distance", "axis"])
def test_rows_are_differences_of_what_is_read(name):
    setup = plan_reading(LITE6, name, 1)
    q = random_positions(np.random.default_rng(0), 8, 6)
    rows = setup.rows(q) / setup.unit
    names, still = list(setup.names), np.zeros(3)

    def slope(at, kinematics=LITE6.kinematics, tool=(0.0, 0.0, 0.0)):
        moved = read(setup, np.asarray(at), tool_points(setup, q, kinematics, tool))
        return (moved - read(setup, still, tool_points(setup, q))) / STEP

    bent = LITE6.kinematics.copy()
    bent[2, 4] += STEP
    np.testing.assert_allclose(rows[..., names.index("joint3_pitch")], slope(still, bent), rtol=1e-3, atol=1e-2)
    by_tool = slope(still, tool=(0, STEP, 0))
    np.testing.assert_allclose(rows[..., names.index("tool_y")], by_tool, rtol=1e-3, atol=1e-2)
    first = names.index(next(one.name for one in setup.own if one.unit == "m"))
    np.testing.assert_allclose(rows[..., first], slope([STEP, 0, 0]), rtol=1e-3, atol=1e-2)


@pytest.mark.parametrize("name", READINGS)
def test_poses_read_their_places_inside_the_limits(name):
    setup = plan_reading(LITE6, name)
    q = draw_readings(setup, 24, limit_margin=0.05).joint_position
    assert len(q) >= 10
    lower, upper = LITE6.joint_limits.T
    assert ((q > lower + 0.04) & (q < upper - 0.04)).all()
    if name == "contact":
        sensor: Any = setup.sensor
        places = sensor.at.T
        apart = np.linalg.norm(tool_points(setup, q) - places[read_places(setup, q)], axis=1)
        assert apart.max() < 1e-6
        assert set(read_places(setup, q)) == {0, 1, 2, 3}
    if name.endswith("camera"):  # as far off as its corners say: the board fills much of the picture
        white = setup.rows(q)
        assert (np.abs(white).max((1, 2)) > 1).all()
        assert np.isfinite(white).all()
        anywhere = setup.rows(random_positions(np.random.default_rng(1), len(q), 6))
        assert np.isfinite(anywhere).all()
        if name == "flange_camera":  # which looks elsewhere in some
            assert not np.abs(anywhere).max((1, 2)).all()


def test_a_plan_of_touches_shares_them_among_sockets_and_is_no_worse_than_chance():
    setup = plan_reading(LITE6, "contact", 1)
    q = draw_readings(setup, 120).joint_position
    found = plan_poses(setup, q, 24)
    assert np.bincount(read_places(setup, found.joint_position)).min() >= 6
    assert found.accuracy[-1] < np.median(found.random_accuracy[:, 23])
    assert (np.diff(found.accuracy[np.isfinite(found.accuracy)]) < 1e-9).all()


def test_places_out_of_reach_are_said():
    setup = plan_reading(LITE6, "contact", 1, tool_at=(3.0, 0.0, 0.0))
    with pytest.raises(InputError, match="0 of 100 poses for contact are reached"):
        draw_readings(setup, 20)


# ------------------------------------------------------------------ commands


def test_design_writes_touches_with_the_names_of_their_sockets(capsys, tmp_path):
    out = tmp_path / "touches.csv"
    given = ("--sensor", "contact", "--places", 1, "--poses", 16, "--candidates", 80, "--link-radius", 0)
    code, said, _ = run(capsys, "design", "lite6", *given, "--out", out)
    assert code == 0
    text = flat(said)
    assert "16 poses of 80 candidates" in text
    assert "Put them within some centimetres of these places" in text
    found = read_recording(out)
    assert found.touches is not None
    assert found.touches.kind == "contact"
    assert found.samples == 16
    (known,) = found.settings.contact_distances
    assert known.between == found.touches.names or known.between == found.touches.names[::-1]


def test_options_that_do_not_go_together_are_refused(capsys, tmp_path):
    given = ("design", "lite6", "--out", tmp_path / "x.csv")
    assert "--places: is for --sensor contact or plane" in refused(capsys, *given, "--places", 2)
    assert "--frame: of plane" in refused(capsys, *given, "--sensor", "plane", "--frame", "known")
