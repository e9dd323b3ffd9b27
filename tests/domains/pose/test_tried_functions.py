"""Where processes can act and on what they can depend: on arms with slides, with one joint, with little recorded."""

import numpy as np
import pytest

from lite6jax.domains.pose.columns import components, quantities
from lite6jax.effects.motion import motion_of
from lite6jax.effects.nonparametric import COMPONENTS, SCALE

SAMPLES = 40


def motion(dof, sliding=(), **more):
    rng = np.random.default_rng(dof)
    return motion_of(
        joint_position=rng.uniform(-1.0, 1.0, (SAMPLES, dof)), payload=np.zeros(SAMPLES), sliding=sliding, **more
    )


def everywhere(dof):
    """The columns of every site, all of which the sensor sees."""
    kinds = [("base", 0), ("tool", 0), ("sensor", 0), *(("link", j) for j in range(dof))]
    sites = [(kind, j, k) for kind, j in kinds for k in range(len(COMPONENTS))]
    return {site: np.ones((3, SAMPLES)) for site in [*sites, *(("joint", j, 0) for j in range(dof)), (SCALE, 0, 0)]}


def phrases(*given, **more):
    return {one.driver.phrase for one in quantities(motion(*given, **more), None)}


def test_a_slide_is_a_quantity_in_its_own_unit_and_has_no_angle():
    """A rail that is not straight tilts the base as the arm moves along it."""
    assert {"slide position of joint 1", "position of joint 2"} <= phrases(3, (0,))
    assert "position of joint 1" not in phrases(3, (0,))
    found = components(everywhere(3), motion(3, (0,)), 3)
    assert "joint1" not in {one.site for one in found}
    assert "link1" in {one.site for one in found}


def test_an_arm_of_one_joint_has_no_links_and_no_other_joints():
    found = components(everywhere(1), motion(1), 3)
    assert {one.site for one in found} == {"joint1", "base", "tool", "sensor"}
    assert phrases(1) == {"position of joint 1"}


@pytest.mark.parametrize("known", [{}, {"time": 8.0 * np.arange(SAMPLES)}])
def test_only_what_is_recorded_is_a_driver(known):
    assert {one.driver.quantity for one in quantities(motion(3, **known), None)} == {"position", *known}


def test_a_sensor_that_sees_no_orientation_sees_no_turn_of_the_tool():
    assert {one.name for one in components(everywhere(2), motion(2), 3) if one.site == "tool"} == {"x", "y", "z"}
    assert {one.name for one in components(everywhere(2), motion(2), 6) if one.site == "tool"} == set(COMPONENTS)


def test_what_the_sensor_does_not_see_is_no_component():
    sites = everywhere(2) | {("link", 0, 3): np.zeros((3, SAMPLES))}
    assert ("link1", "rx") not in {(one.site, one.name) for one in components(sites, motion(2), 3)}


def test_every_quantity_that_is_known_is_there_once():
    rng = np.random.default_rng(4)
    velocity, rise = rng.uniform(-1.0, 1.0, (2, 3, SAMPLES))
    moving = motion(3, time=8.0 * np.arange(SAMPLES))._replace(
        joint_velocity=velocity, direction=np.sign(velocity), joint_temperature_rise=9 * rise
    )
    found = [one.driver.phrase for one in quantities(moving, None)]
    assert len(found) == len(set(found)) == 1 + 4 * 3  # time; positions, velocities, directions and temperatures
    own = {one.driver.phrase: one.own for one in quantities(moving, None)}
    assert {"joint2", "link2"} <= own["velocity of joint 2"]
    assert own["time"] == {""}
