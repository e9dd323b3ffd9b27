"""Physics outside the catalogue: each family is what its formula says; sealed ones are drawn on request only."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.concealed import plans, recorded, rivals, trials
from benchmarks.concealed.chain import MADE, description_text, lite6, rotation_from_vector
from benchmarks.concealed.mujoco_physics import Arm
from benchmarks.concealed.outside import FAMILIES, families
from benchmarks.concealed.plain_physics import Hidden, Setup, hardening, poses, yielding
from benchmarks.concealed.view import Open, View, turned
from tests import vault_formulas
from tests.outside_signals import (
    PAYLOAD_CENTER,
    base_moment,
    beyond,
    faded,
    latched,
    late,
    played,
    rise,
    rising,
    torque,
    wave,
)


@pytest.fixture(scope="module")
def scene():
    """A Lite 6 that moves and warms up and down, seen from a sensor somewhere."""
    rng = np.random.default_rng(41)
    sensor, tool = turned(rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)), np.eye(4)
    tool[:3, 3] = 0.02, 0.0, 0.06
    setup = Setup(lite6().moved(rng, *MADE), sensor, tool, PAYLOAD_CENTER)
    motion = recorded.draw_motion(rng, setup.chain, True, 60, warming=True, wandering=True)
    return setup, motion


def incidence(p):
    """Of the sight, at a pane square to the sensor's z axis."""
    return np.arctan2(np.linalg.norm(p[:, :2], axis=1, keepdims=True), p[:, [2]])


# name: where, what is drawn, the axis of a twist, and the formula of its signal, written down a second time
FORMULAS = {
    "joint_bump": ("joint3", {"centre": 1.0, "width": 0.3}, lambda s, m: np.exp(-((m.q[:, 2] - 1.0) ** 2) / 0.18)),
    "joint_step": ("joint3", {"at": 1.0}, lambda s, m: np.where(m.q[:, 2] > 1.0, 1.0, 0.0)),
    "hardening_spring": ("joint2", {"torque_Nm": 3.0}, lambda s, m: hardening(torque(s, m, 2)[:, 2] / 3)),
    "yielding_spring": ("joint2", {"torque_Nm": 3.0}, lambda s, m: yielding(torque(s, m, 2)[:, 2] / 3)),
    "joint_parabola": ("joint3", {"power": 2.0}, lambda s, m: m.q[:, 2] ** 2),
    "squared_coupling": ("joint3", {"by": 5.0, "power": 2.0}, lambda s, m: m.q[:, 4] ** 2),
    "squared_speed": ("joint3", {"power": 2.0}, lambda s, m: m.dq[:, 2] * abs(m.dq[:, 2])),
    "squared_warmth": ("joint3", {"power": 2.0}, lambda s, m: rise(m) ** 2),
    "sticking_zone": (
        "joint3",
        {"lower": 0.5, "upper": 1.5},
        lambda s, m: -np.sign(m.dq[:, 2]) * (abs(m.q[:, 2] - 1) < 0.5),
    ),
    "link_tilt_by_time": ("link3", {"axis": 4.0, "span_s": 2.0}, lambda s, m: m.time / 2),
    "link_tilt_by_warmth": ("link3", {"axis": 3.0}, lambda s, m: rise(m)),
    "base_tilt_by_joint": ("base", {"axis": 3.0, "by": 4.0}, lambda s, m: m.q[:, 3]),
    "base_yaw_by_moment": ("base", {"axis": 5.0, "base_moment_Nm": 2.0}, lambda s, m: base_moment(s, m)[:, 0] / 2),
    "tool_turn_by_joint": ("tool", {"axis": 4.0, "by": 2.0}, lambda s, m: m.q[:, 1]),
    "sensor_turn_by_time": ("sensor", {"axis": 4.0, "span_s": 2.0, "power": 2.0}, lambda s, m: m.time**2 / 4),
    "sensor_shift_by_warmth": ("sensor", {"axis": 0.0}, lambda s, m: rise(m)),
    "squared_drift": ("sensor", {"axis": 1.0, "span_s": 2.0, "power": 2.0}, lambda s, m: m.time**2 / 4),
    "eccentric_coupling": ("joint3", {"by": 5.0, "phase": 0.4}, lambda s, m: np.sin(1.5 * m.q[:, 4] + 0.4)),
    "dragging_gear": ("joint3", {"torque_Nm": 3.0}, lambda s, m: -np.sign(m.dq[:, 2]) * abs(torque(s, m, 3)[:, 2]) / 3),
    "loose_clip": ("tool", {"axis": 1.0, "instant_s": 1.2}, lambda s, m: np.where(m.time > 1.2, 1.0, 0.0)),
    "creeping_glue": ("tool", {"axis": 2.0, "span_s": 2.0}, lambda s, m: 1 - np.exp(-2 * m.time)),
    "swaying_sensor": (
        "sensor",
        {"axis": 2.0, "span_s": 2.0, "turns": 1.5, "phase": 0.4},
        lambda s, m: np.sin(1.5 * np.pi * m.time + 0.4),
    ),
    "soft_stop": ("joint3", {"stop": 1.0}, lambda s, m: (m.q[:, 2] - 1).clip(min=0)),
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
    "whipped_link": ("link3", {"axis": 3.0, "by": 5.0, "and": 2.0}, lambda s, m: m.dq[:, 4] * m.dq[:, 1]),
    "wheeled_table": ("base", {"axis": 1.0, "by": 4.0}, lambda s, m: np.sign(m.dq[:, 3])),
    "tipping_tool": (
        "tool",
        {"axis": 3.0, "flange": 6.0, "flange_moment_Nm": 0.01},
        lambda s, m: np.select([torque(s, m, 6)[:, 0] > 0.005, torque(s, m, 6)[:, 0] < -0.005], [1.0, -1.0]),
    ),
    "shared_bench": ("sensor", {"axis": 2.0, "base_moment_Nm": 2.0}, lambda s, m: base_moment(s, m)[:, 0] / 2),
    "thinning_grease": ("joint3", {}, lambda s, m: (m.temperature.mean(1) / 10 - 2.5) * m.dq[:, 2]),
    "fading_friction": (
        "joint3",
        {"fades": 0.4},
        lambda s, m: np.where(m.dq[:, 2] > 0, -np.exp(-2.5 * m.dq[:, 2]), np.exp(2.5 * m.dq[:, 2])),
    ),
    "bowed_link": ("link3", {"axis": 4.0}, lambda s, m: np.diff(m.temperature[:, 2:4], axis=1)[:, 0] / 10),
    "swung_trolley": ("base", {"axis": 0.0}, lambda s, m: m.dq[:, 0] * np.sin(m.q[:, 0] + np.pi / 2) * m.dq[:, 0]),
    "cracked_tooth": (
        "joint3",
        {"torque_Nm": 3.0, "centre": 1.0, "width": 0.3},
        lambda s, m: torque(s, m, 3)[:, 2] / 3 * np.exp(-((m.q[:, 2] - 1.0) ** 2) / 0.18),
    ),
    "starved_servo": ("joint3", {"limit": 0.3}, lambda s, m: m.dq[:, 2].clip(-0.3, 0.3) - m.dq[:, 2]),
    "slack_bevel": ("joint3", {"by": 5.0}, lambda s, m: np.where(m.dq[:, 2] > -m.dq[:, 4], -1.0, 1.0)),
    "wandering_disc": (
        "joint3",
        {"span_s": 2.0, "phase": 0.4},
        lambda s, m: m.time / 2 * (np.sin(m.q[:, 2]) * np.cos(0.4) + np.cos(m.q[:, 2]) * np.sin(0.4)),
    ),
    "dented_bearing": (
        "link3",
        {"axis": 3.0, "moment_Nm": 2.0},
        lambda s, m: np.sign(torque(s, m, 3)[:, 0]) * np.cbrt(torque(s, m, 3)[:, 0] ** 2 / 4),
    ),
    "snapping_casing": ("link3", {"axis": 4.0, "snaps": 0.6}, lambda s, m: np.where(rise(m) > 0.6, 1.0, 0.0)),
    "humming_link": (
        "link3",
        {"axis": 3.0, "by": 5.0, "hums": 0.5, "band": 0.2},
        lambda s, m: np.exp(-12.5 * (np.sqrt(m.dq[:, 4] ** 2) - 0.5) ** 2),
    ),
    "passing_truck": (
        "base",
        {"axis": 3.0, "instant_s": 1.2, "passes_s": 0.5},
        lambda s, m: np.exp(-2 * (m.time - 1.2) ** 2),
    ),
    "rattling_ball": (
        "tool",
        {"axis": 0.0, "flange": 6.0, "flange_moment_Nm": 0.01},
        lambda s, m: (
            torque(s, m, 6)[:, 1] / np.sqrt(torque(s, m, 6)[:, 0] ** 2 + torque(s, m, 6)[:, 1] ** 2 + 0.001**2)
        ),
    ),
    "cold_hose": ("tool", {"axis": 4.0, "by": 2.0}, lambda s, m: m.q[:, 1] / np.exp(rise(m))),
    "warming_mesh": ("joint3", {}, lambda s, m: np.where(m.dq[:, 2] > 0, -1.0, 1.0) * rise(m)),
    "sprung_tensioner": ("joint3", {"torque_Nm": 3.0}, lambda s, m: (torque(s, m, 3)[:, 2] - 0.6).clip(min=0) / 3),
    "nested_shafts": ("joint3", {"by": 5.0}, lambda s, m: m.dq[:, 4]),
    "meshing_wrist": (
        "joint3",
        {"by": 5.0, "phase": 0.4},
        lambda s, m: np.sin(m.q[:, 2] + 0.4) * np.cos(m.q[:, 4]) - np.cos(m.q[:, 2] + 0.4) * np.sin(m.q[:, 4]),
    ),
    "thrusting_helix": (
        "link3",
        {"axis": 2.0, "torque_Nm": 3.0},
        lambda s, m: 1 - 2 / (np.exp(8 * torque(s, m, 3)[:, 2] / 3) + 1),
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
    "gel_pads": ("base", {"axis": 4.0, "by": 4.0}, lambda s, m: m.dq[:, 3] * 2 ** rise(m)),
    "parting_changer": (
        "tool",
        {"axis": 2.0, "flange": 6.0, "flange_moment_Nm": 0.01},
        lambda s, m: (100 * np.linalg.norm(torque(s, m, 6)[:, :2], axis=1) - 0.5).clip(min=0),
    ),
    "flowing_glue": ("tool", {"axis": 1.0, "span_s": 2.0}, lambda s, m: 0.5 * m.time * rise(m)),
    "shaken_tripod": (
        "sensor",
        {"axis": 4.0, "by": 5.0, "and": 2.0},
        lambda s, m: np.sum(m.dq[:, [1, 4]] ** 2, axis=1),
    ),
    "clamped_ring": (
        "joint3",
        {"phase": 0.4},
        lambda s, m: rise(m) * (np.sin(2 * m.q[:, 2]) * np.cos(0.4) + np.cos(2 * m.q[:, 2]) * np.sin(0.4)),
    ),
    "bent_sheath": (
        "joint3",
        {"by": 5.0},
        lambda s, m: np.where(m.dq[:, 2] > 0, -1.0, 1.0) * (1 - np.exp(-0.3 * np.sqrt(m.q[:, 4] ** 2))),
    ),
    "flipping_pull": ("joint3", {"by": 5.0, "over": -1.0}, lambda s, m: 1 - 2 / (np.exp(10 * (m.q[:, 4] + 1.0)) + 1)),
    "parting_pinion": ("link3", {"axis": 1.0, "torque_Nm": 3.0}, lambda s, m: np.sqrt(torque(s, m, 3)[:, 2] ** 2 / 9)),
    "flattened_tube": (
        "link3",
        {"axis": 3.0, "moment_Nm": 2.0},
        lambda s, m: torque(s, m, 3)[:, 0] * np.linalg.norm(torque(s, m, 3)[:, :2], axis=1) ** 2 / 8,
    ),
    "buckling_plate": ("base", {"axis": 4.0, "buckles": 0.6}, lambda s, m: (rise(m) - 0.6).clip(min=0) ** 0.5),
    "breathing_springs": (
        "base",
        {"axis": 3.0, "base_moment_Nm": 2.0, "span_s": 2.0, "turns": 1.5, "phase": 0.4},
        lambda s, m: np.cos(1.5 * np.pi * m.time + 0.4 - np.pi / 2) * base_moment(s, m)[:, 0] / 2,
    ),
    "opening_chuck": (
        "tool",
        {"axis": 3.0, "flange": 6.0, "flange_moment_Nm": 0.01},
        lambda s, m: 100 * torque(s, m, 6)[:, 0] * m.dq[:, 5] * m.dq[:, 5],
    ),
    "lost_motion": ("joint3", {"by": 5.0, "width": 0.3}, lambda s, m: played(m.q[:, 4], 0.3) - m.q[:, 4]),
    "dragged_boot": (
        "joint3",
        {"width": 0.2},
        lambda s, m: -faded(0.0, np.sign(np.diff(m.q[:, 2])), np.abs(np.diff(m.q[:, 2])) / 0.6),
    ),
    "sagging_supply": ("joint3", {"by": 5.0}, lambda s, m: -m.dq[:, 2] * np.sqrt(m.dq[:, 4] ** 2)),
    "tensioned_cable": ("joint3", {"by": 5.0, "torque_Nm": 3.0}, lambda s, m: m.q[:, 4] * torque(s, m, 3)[:, 2] / 3),
    "warm_flanks": ("joint3", {"torque_Nm": 3.0}, lambda s, m: rise(m) * rising(4 * torque(s, m, 3)[:, 2] / 3)),
    "lame_resolver": ("joint3", {"phase": 0.4}, lambda s, m: -wave(m.q[:, 2]) * m.dq[:, 2]),
    "tiring_amplifier": ("joint3", {"span_s": 2.0}, lambda s, m: -0.5 * m.time * m.dq[:, 2]),
    "nylon_wheel": (
        "joint3",
        {"torque_Nm": 3.0, "relaxes_s": 0.5},
        lambda s, m: late(torque(s, m, 3)[:, 2] / 3, m, 0.5),
    ),
    "sailing_cover": ("link3", {"axis": 4.0, "by": 5.0}, lambda s, m: m.dq[:, 4] * np.sqrt(m.dq[:, 4] ** 2)),
    "flopping_loom": ("link3", {"axis": 3.0, "moment_Nm": 0.2}, lambda s, m: latched(torque(s, m, 3)[:, 0], 0.1)),
    "soft_tyres": (
        "base",
        {"axis": 4.0, "base_moment_y_Nm": 2.0, "relaxes_s": 0.5},
        lambda s, m: late(base_moment(s, m)[:, 1] / 2, m, 0.5),
    ),
    "punching_press": (
        "base",
        {"axis": 2.0, "span_s": 2.0, "strokes": 5.0, "phase": 0.4},
        lambda s, m: wave(5 * np.pi * m.time).clip(min=0) ** 8,
    ),
    "cycling_gripper": (
        "tool",
        {"axis": 1.0, "span_s": 2.0, "turns": 1.5, "phase": 0.4},
        lambda s, m: np.where(wave(1.5 * np.pi * m.time) > 0, 1.0, -1.0),
    ),
    "trailing_lead": ("tool", {"axis": 4.0, "by": 2.0, "hums": 0.5}, lambda s, m: rising(2 * m.dq[:, 1])),
    "two_hoses": ("tool", {"axis": 3.0, "by": 1.0, "and": 4.0}, lambda s, m: np.sign(m.dq[:, [0, 3]]).sum(1)),
    "switching_fan": ("sensor", {"axis": 0.0, "snaps": 0.6}, lambda s, m: latched(rise(m) - 0.6, 0.15)),
    "brushed_mast": (
        "sensor",
        {"axis": 1.0, "by": 5.0, "over": -1.0},
        lambda s, m: np.exp(-((m.q[:, 4] + 1) ** 2) / 0.18),
    ),
} | vault_formulas.FORMULAS
IMAGES = {
    "lens_distortion": lambda p, m: p * np.sum(p**2, 1, keepdims=True),
    "stretched_axis": lambda p, m: p[:, [0]] * [1.0, 0.0, 0.0],
    "bent_beam": lambda p, m: np.linalg.norm(p, axis=1, keepdims=True) ** 2 * [0.0, 0.0, 1.0],
    "eccentric_circle": lambda p, m: np.sin(np.arctan2(p[:, [1]], p[:, [0]])) * np.cross([0.0, 0.0, 1.0], p),
    "cyclic_ranger": lambda p, m: (
        p / np.linalg.norm(p, axis=1, keepdims=True) * np.sin(5 * np.pi * np.linalg.norm(p, axis=1, keepdims=True))
    ),
    # beside an angle of incidence, that of the refracted ray
    "glass_pane": lambda p, m: (
        (np.cos(incidence(p)) / (1.5 * np.cos(np.arcsin(np.sin(incidence(p)) / 1.5)))) * [0.0, 0.0, 1.0]
    ),
    "drifting_clock": lambda p, m: np.einsum("sa,s->sa", p, 0.5 * m.time),
    "moire_fringes": lambda p, m: wave(8 * np.pi * p[:, [0]], 0.0) * [0.0, 0.0, 1.0],
    "steel_bench": lambda p, m: 1 / np.exp(5 * np.sqrt(p[:, [2]] ** 2)) * [0.0, 0.0, 1.0],
} | vault_formulas.IMAGES


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


def test_every_family_is_here():
    assert set(FORMULAS) | set(IMAGES) == set(FAMILIES)
    assert len(FAMILIES) == 109


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


def test_what_a_function_of_another_driver_does_as_well_is_taken_for_it(scene):
    setup, motion = scene
    following = replace(motion, q=np.column_stack([motion.q[:, :5], 0.1 * motion.q[:, 0]]))
    bent = Hidden("squared_coupling", "joint4", (1e-4,), {"by": 1.0, "power": 2.0})
    found = nearest((setup, following), bent)
    assert (found.name, found.site) == ("function of position of joint 6", "joint4")
    assert found.apart < 1e-2
    assert nearest(scene, bent).apart > 1.0


def a_plan(edge):
    index = next(
        i for i in plans.ROUNDS.indices(7, 8, "edge") if plans.draw_plan(7, i, np.random.default_rng(0)).edge == edge
    )
    return index, plans.draw_plan(7, index, np.random.default_rng(0))


def test_masses_are_off_in_the_arm_and_not_in_its_files():
    index, plan = a_plan("masses off")
    trial = trials.draw(7, index)
    errors = np.array(trial.truth["mass_errors"])
    assert 0.01 < np.abs(errors).max() <= 0.2 + 1e-12
    nominal, actual, told = trials._arms(replace(plan, arm="six"), np.random.default_rng(1))
    assert 0.01 < np.abs(actual.mass / nominal.mass - 1).max() <= 0.2 + 1e-12
    np.testing.assert_array_equal(told.mass, actual.mass)  # the oracle is told them
    measured = (np.tile(np.eye(3), (1, 1, 1)), np.zeros((1, 3)))
    motion = recorded.draw_motion(np.random.default_rng(1), actual, False, 1)
    files = recorded.files_of(plan, nominal, told, motion, measured, motion.q, (2e-5, None), motion)
    assert files["arm.yaml"] == description_text(nominal)  # the diagnosis is not


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
