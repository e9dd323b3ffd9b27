"""Physics outside the catalogue: each family is what its formula says; sealed ones are drawn on request only."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.concealed import plans, recorded, rivals
from benchmarks.concealed.chain import MADE, lite6, rotation_from_vector
from benchmarks.concealed.mujoco_physics import Arm
from benchmarks.concealed.outside import FAMILIES, families
from benchmarks.concealed.plain_physics import Hidden, Setup, hardening, moments, poses
from benchmarks.concealed.view import Open, View, turned

PAYLOAD_CENTER = np.array([0.01, 0.0, 0.05])


def rise(motion):
    return (motion.temperature.mean(1) - 25) / 10


def torque(setup, motion, joint):
    return moments(setup.chain, motion.q, motion.payload, PAYLOAD_CENTER)[0][:, joint - 1]


def base_moment(setup, motion):
    return moments(setup.chain, motion.q, motion.payload, PAYLOAD_CENTER)[1]


def beyond(load, preload):
    """What is left of a load when a preload has taken its share, whichever way it acts; of a turn, beyond a slack."""
    return load - load.clip(-preload, preload)


def played(values, half):
    """What is pushed along stays behind by no more than the play."""
    behind, gap = [], 0.0
    for step in np.diff(values, prepend=values[0]):
        gap = np.clip(gap + step, -half, half)
        behind.append(gap)
    return values - behind


def latched(values, level):
    """The sign of the last value beyond a level."""
    known = np.abs(values) > level
    return np.sign(values[np.maximum.accumulate(np.where(known, np.arange(len(values)), 0))])


def faded(start, aims, path):
    """What goes from a start to one aim after the other along a path: every aim, as far as the path since left it."""
    way = np.cumsum(np.append(0.0, path))
    kicks = np.append(0.0, aims * (1 - np.exp(-path)))
    return start * np.exp(-way) + np.tril(np.exp(way[None] - way[:, None])) @ kicks


def late(values, motion, constant):
    """Values as they are followed with a time constant."""
    return faded(values[0], values[1:], np.diff(motion.time) / constant)


@pytest.fixture(scope="module")
def scene():
    """A Lite 6 that moves and warms up and down, seen from a sensor somewhere."""
    rng = np.random.default_rng(41)
    sensor, tool = turned(rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)), np.eye(4)
    tool[:3, 3] = 0.02, 0.0, 0.06
    setup = Setup(lite6().moved(rng, *MADE), sensor, tool, PAYLOAD_CENTER)
    motion = recorded.draw_motion(rng, setup.chain, True, 60, warming=True, wandering=True)
    return setup, motion


# name: where, what is drawn, and the formula of its signal, written down a second time: families of every site and of
# every kind of signal
FORMULAS = {
    "joint_bump": ("joint3", {"centre": 1.0, "width": 0.3}, lambda s, m: np.exp(-((m.q[:, 2] - 1.0) ** 2) / 0.18)),
    "hardening_spring": ("joint2", {"torque_Nm": 3.0}, lambda s, m: hardening(torque(s, m, 2)[:, 2] / 3)),
    "squared_coupling": ("joint3", {"by": 5.0, "power": 2.0}, lambda s, m: m.q[:, 4] ** 2),
    "sticking_zone": (
        "joint3",
        {"lower": 0.5, "upper": 1.5},
        lambda s, m: -np.sign(m.dq[:, 2]) * (abs(m.q[:, 2] - 1) < 0.5),
    ),
    "link_tilt_by_time": ("link3", {"axis": 4.0, "span_s": 2.0}, lambda s, m: m.time / 2),
    "base_yaw_by_moment": ("base", {"axis": 5.0, "base_moment_Nm": 2.0}, lambda s, m: base_moment(s, m)[:, 0] / 2),
    "tool_turn_by_joint": ("tool", {"axis": 4.0, "by": 2.0}, lambda s, m: m.q[:, 1]),
    "sensor_shift_by_warmth": ("sensor", {"axis": 0.0}, lambda s, m: rise(m)),
    "dragging_gear": ("joint3", {"torque_Nm": 3.0}, lambda s, m: -np.sign(m.dq[:, 2]) * abs(torque(s, m, 3)[:, 2]) / 3),
    "loose_clip": ("tool", {"axis": 1.0, "instant_s": 1.2}, lambda s, m: np.where(m.time > 1.2, 1.0, 0.0)),
    "pulled_encoder": (
        "joint3",
        {"by": 5.0, "phase": 0.4},
        lambda s, m: m.q[:, 4] * (np.sin(m.q[:, 2]) * np.cos(0.4) + np.cos(m.q[:, 2]) * np.sin(0.4)),
    ),
    "softening_link": ("link3", {"axis": 3.0, "moment_Nm": 2.0}, lambda s, m: rise(m) * torque(s, m, 3)[:, 0] / 2),
    "preloaded_base": (
        "base",
        {"axis": 3.0, "base_moment_Nm": 2.0},
        lambda s, m: beyond(base_moment(s, m)[:, 0], 1.0) / 2,
    ),
    "thinning_grease": ("joint3", {}, lambda s, m: (m.temperature.mean(1) / 10 - 2.5) * m.dq[:, 2]),
    "bowed_link": ("link3", {"axis": 4.0}, lambda s, m: np.diff(m.temperature[:, 2:4], axis=1)[:, 0] / 10),
    "rattling_ball": (
        "tool",
        {"axis": 0.0, "flange": 6.0, "flange_moment_Nm": 0.01},
        lambda s, m: (
            torque(s, m, 6)[:, 1] / np.sqrt(torque(s, m, 6)[:, 0] ** 2 + torque(s, m, 6)[:, 1] ** 2 + 0.001**2)
        ),
    ),
    "short_umbilical": (
        "link3",
        {"axis": 4.0, "by": 5.0, "and": 2.0, "slack": 0.5},
        lambda s, m: beyond(m.q[:, [1, 4]].sum(1), 0.5),
    ),
    "leaking_table": (
        "base",
        {"axis": 2.0, "span_s": 2.0, "turns": 1.5, "phase": 0.4},
        lambda s, m: np.modf(0.75 * m.time + 0.2 / np.pi)[0],
    ),
    "shaken_tripod": (
        "sensor",
        {"axis": 4.0, "by": 5.0, "and": 2.0},
        lambda s, m: np.sum(m.dq[:, [1, 4]] ** 2, axis=1),
    ),
    "lost_motion": ("joint3", {"by": 5.0, "width": 0.3}, lambda s, m: played(m.q[:, 4], 0.3) - m.q[:, 4]),
    "dragged_boot": (
        "joint3",
        {"width": 0.2},
        lambda s, m: -faded(0.0, np.sign(np.diff(m.q[:, 2])), np.abs(np.diff(m.q[:, 2])) / 0.6),
    ),
    "nylon_wheel": (
        "joint3",
        {"torque_Nm": 3.0, "relaxes_s": 0.5},
        lambda s, m: late(torque(s, m, 3)[:, 2] / 3, m, 0.5),
    ),
    "flopping_loom": ("link3", {"axis": 3.0, "moment_Nm": 0.2}, lambda s, m: latched(torque(s, m, 3)[:, 0], 0.1)),
}
IMAGES = {
    "lens_distortion": lambda p, m: p * np.sum(p**2, 1, keepdims=True),
    "stretched_axis": lambda p, m: p[:, [0]] * [1.0, 0.0, 0.0],
    "eccentric_circle": lambda p, m: np.sin(np.arctan2(p[:, [1]], p[:, [0]])) * np.cross([0.0, 0.0, 1.0], p),
    "drifting_clock": lambda p, m: np.einsum("sa,s->sa", p, 0.5 * m.time),
}


def displaced(setup, motion, site, twist):
    """The pose in the sensor's frame when the frame of a site moves by twists `(sample, 6)` in its own axes."""
    R, p = setup.chain.frames(motion.q)
    tip = p[:, -1] + R[:, -1] @ setup.tool[:3, 3], R[:, -1] @ setup.tool[:3, :3]
    at, origin = np.broadcast_to(np.eye(3), R[:, 0].shape), np.zeros((len(p), 3))
    if site.startswith("link") or site == "tool":
        number = setup.chain.dof if site == "tool" else int(site[4:])
        at, origin = R[:, number - 1], p[:, number - 1]
    elif site == "sensor":
        at, origin = (
            at @ setup.sensor[:3, :3].T,
            np.broadcast_to(-setup.sensor[:3, :3].T @ setup.sensor[:3, 3], p[:, 0].shape),
        )
    turn = at @ rotation_from_vector(twist[:, 3:]) @ np.swapaxes(at, 1, 2)
    position = origin + np.einsum("sab,sb->sa", at, twist[:, :3]) + np.einsum("sab,sb->sa", turn, tip[0] - origin)
    seen = setup.sensor
    return seen[:3, :3] @ turn @ tip[1], position @ seen[:3, :3].T + seen[:3, 3]


@pytest.mark.parametrize("name", FORMULAS)
def test_a_family_shows_what_its_formula_says(name, scene):
    setup, motion = scene
    site, fixed, formula = FORMULAS[name]
    number = float(site[-1]) if site[-1].isdecimal() else 0.0
    hidden = Hidden(name, site, (3e-4,), {"joint": number} | fixed)
    signal = 3e-4 * formula(setup, motion)
    assert np.ptp(signal) > 1e-6
    twist = np.zeros((len(motion.q), 6))
    if site.startswith("joint"):
        # an angle of a joint turns its link about its own axis
        twist[:, 5], site = signal, f"link{site[5:]}"
    else:
        twist[:, int(fixed["axis"])] = signal
    rotation, position = poses(setup, (hidden,), motion)
    expected = displaced(setup, motion, site, twist)
    np.testing.assert_allclose(position, expected[1], atol=1e-12)
    np.testing.assert_allclose(rotation, expected[0], atol=1e-12)


@pytest.mark.parametrize("name", IMAGES)
def test_an_image_shifts_points_and_turns_nothing(name, scene):
    setup, motion = scene
    rotation, position = poses(setup, (), motion)
    moved = poses(setup, (Hidden(name, "sensor", (3e-4,), {"span_s": 2.0}),), motion)
    np.testing.assert_allclose(moved[1] - position, 3e-4 * IMAGES[name](position, motion), atol=1e-15)
    np.testing.assert_array_equal(moved[0], rotation)


@pytest.mark.parametrize("seed", [5, 2321, 2341, 2361, 2381])
def test_families_not_looked_at_are_sealed_and_drawn_on_request_only(seed):
    opened, sealed = families(seed), families(seed, sealed=True)
    assert sealed
    assert not set(opened) & set(sealed)
    wanted = plans.ROUNDS.indices(seed, 3 * len(FAMILIES), "outside")
    for chosen, allowed in ((False, opened), (True, sealed)):
        drawn = [plans.draw_plan(seed, index, np.random.default_rng(0), chosen) for index in wanted]
        assert {plan.effects[0] for plan in drawn} == set(allowed)
        assert all(plan.sealed == chosen for plan in drawn)


def test_sites_that_move_what_is_seen_alike_are_one(scene):
    setup, motion = scene
    view = View(setup, Open(frame=True, tool=3, geometry=False), motion, (2e-5, 1e-4))
    tilt = Hidden("base_tilt_by_joint", "base", (1e-4,), {"axis": 3.0, "by": 4.0})
    assert rivals.equal_sites(view, tilt) == ["base", "sensor"]
    bump = Hidden("joint_bump", "joint4", (1e-4,), {"joint": 4.0, "centre": 0.0, "width": 0.3})
    assert {"joint4", "link4"} <= set(rivals.equal_sites(view, bump))
    assert not {"joint2", "base"} & set(rivals.equal_sites(view, bump))


def nearest(scene, effect, rows=60):
    setup, motion = scene
    view = View(setup, Open(frame=True, tool=3, geometry=False), motion.thinned(rows), (2e-5, 1e-4))
    drivers = FAMILIES[effect.name].drivers(effect.fixed)
    return rivals.nearest_to_outside(view, effect, rivals.equal_sites(view, effect), drivers)


@pytest.mark.parametrize(
    ("straight", "name"),
    [
        (Hidden("squared_coupling", "joint4", (1e-4,), {"by": 2.0, "power": 1.0}), "joint_coupling"),
        (Hidden("squared_warmth", "joint4", (1e-4,), {"joint": 4.0, "power": 1.0}), "joint_thermal_offset"),
        (Hidden("sensor_turn_by_time", "sensor", (1e-4,), {"span_s": 3.0, "power": 1.0, "axis": 4.0}), "sensor_drift"),
    ],
    ids=lambda case: case if isinstance(case, str) else "",
)
def test_what_a_name_does_as_well_is_taken_for_it(scene, straight, name):
    found = nearest(scene, straight)
    assert (found.name, found.site) == (name, straight.site)
    assert found.apart < 1e-2


def test_play_and_compliance_of_one_joint_of_mujoco_add_up():
    rng = np.random.default_rng(44)
    setup = Setup(lite6().moved(rng, *MADE), np.eye(4), np.eye(4), PAYLOAD_CENTER)
    motion = recorded.draw_motion(rng, setup.chain, False, 14)
    motion = replace(motion, payload=np.full(14, 0.5))
    play = Hidden("joint_backlash", "joint2", (6e-4,), {"friction_Nm": 0.3})
    spring = Hidden("joint_compliance", "joint2", (3e-5,))
    for hidden in ((play, spring), (spring, play)):
        found = Arm(setup, hidden, 0.5).at_rest(motion)
        shown = poses(setup, hidden, found.motion)[1]
        clear = np.abs(torque(setup, found.motion, 2)[:, 2]) > 1
        off = np.linalg.norm(found.position - shown, axis=1)[clear]
        for alone in hidden:
            missing = np.linalg.norm(poses(setup, (alone,), found.motion)[1] - shown, axis=1)[clear]
            assert np.all(off < 0.1 * missing.max())
            assert missing.max() > 1e-5
