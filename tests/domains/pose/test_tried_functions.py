"""Functions without a name that are tried on arms with slides, with one joint and with little that is recorded."""

import numpy as np
import pytest

from lite6jax.domains.pose.functions import tried_functions
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


def tried(dof, sliding=(), **more):
    return tried_functions(motion(dof, sliding, **more), None, 3, everywhere(dof))


def test_the_base_and_the_tool_may_depend_on_a_slide_which_has_no_angle():
    """A rail that is not straight tilts the base as the arm moves along it."""
    found = {(one.site, one.driver): one for one in tried(3, sliding=(0,))}
    for site in ("base", "tool", "link1"):
        assert (site, "slide position of joint 1") in found
    assert not any(one.orders and "slide" in one.driver for one in found.values())
    assert not any(one.site == "joint1" for one in found.values())
    assert not any("position of joint 1" in driver and "slide" not in driver for _, driver in found)


def test_an_arm_of_one_joint_has_no_links_and_no_other_joints():
    found = tried(1)
    assert {one.site for one in found} == {"joint1", "base", "tool"}
    assert {driver.phrase for one in found for driver in one.drivers} == {"position of joint 1"}


@pytest.mark.parametrize("known", [{}, {"time": 8.0 * np.arange(SAMPLES)}])
def test_only_what_is_recorded_is_a_driver(known):
    quantities = {driver.quantity for one in tried(3, **known) for driver in one.drivers}
    assert quantities == {"position", *known}


def test_waves_of_a_joint_that_turns_far_hold_as_far_as_it_turns():
    far = motion(2)._replace(joint_position=np.linspace(-60.0, 60.0, 2 * SAMPLES).reshape(2, SAMPLES))
    waves = [one for one in tried_functions(far, None, 3, everywhere(2)) if one.orders]
    assert waves
    for one in waves:
        values = np.asarray(one.values_at(far, None))
        assert one.lower <= values.min()
        assert values.max() <= one.upper


def test_every_driver_that_is_known_is_tried_at_every_joint_and_link_by_itself():
    rng = np.random.default_rng(4)
    velocity, rise = rng.uniform(-1.0, 1.0, (2, 3, SAMPLES))
    moving = motion(3, time=8.0 * np.arange(SAMPLES))._replace(
        joint_velocity=velocity, direction=np.sign(velocity), joint_temperature_rise=9 * rise
    )
    found = tried_functions(moving, None, 3, everywhere(3))
    quantities = {driver.phrase for one in found for driver in one.drivers if not driver.phrase.startswith("measured")}
    assert len(quantities) == 1 + 4 * 3  # time; positions, velocities, directions and temperatures
    for site in ("joint1", "joint3", "link1", "link3"):
        assert {one.driver for one in found if one.site == site and len(one.drivers) == 1} == quantities


def test_no_function_is_tried_twice():
    """Nor as a function of the same products by another degree, as those of two directions are."""
    velocity = np.random.default_rng(6).uniform(-1.0, 1.0, (3, SAMPLES))
    moving = motion(3, time=8.0 * np.arange(SAMPLES))._replace(joint_velocity=velocity, direction=np.sign(velocity))
    found = tried_functions(moving, None, 6, everywhere(3))
    products = [
        frozenset(tuple(sorted(one.drivers[k].phrase for k in which)) for which in one.products) for one in found
    ]
    drawn = [
        (one.site, one.component, over or (one.driver, one.orders)) for one, over in zip(found, products, strict=True)
    ]
    assert len(drawn) == len(set(drawn))


def test_functions_of_quantities_that_a_list_of_drivers_leaves_out_are_rare():
    rng = np.random.default_rng(5)
    moving = motion(3)._replace(joint_velocity=rng.uniform(-1.0, 1.0, (3, SAMPLES)))
    found = tried_functions(moving, None, 3, everywhere(3))
    rare = {(one.site, one.component, one.driver): one.rare for one in found}
    assert not rare["joint2", "rz", "velocity of joint 1"]
    assert not rare["link2", "x y z", "position of joint 2"]
    assert rare["link2", "x y z", "velocity of joint 1"]
    assert rare["joint2", "rz", "position of joint 2 and velocity of joint 1"]
