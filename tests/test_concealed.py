"""The concealed trials: a generator apart from the library, a threshold that holds, sealed truths, honest scores."""

import csv
import io
from functools import partial

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.campaigns import threshold
from benchmarks.campaigns.campaign import sealed_text, write_files
from benchmarks.concealed import chain, information, oracle, plans, recorded, rivals, trials
from benchmarks.concealed import view as views
from benchmarks.concealed.chain import MADE, lite6, lite6_ros, rotation_from_rpy, seven
from benchmarks.concealed.mujoco_physics import Arm
from benchmarks.concealed.plain_physics import (
    COORDINATES,
    HARDENING,
    OUTSIDE,
    YIELD,
    Hidden,
    Setup,
    hardening,
    moments,
    poses,
    yielding,
)
from benchmarks.concealed.view import Open, View
from lite6jax.arms.arm import Arm as LibraryArm
from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.description import load_bundled, read_description
from lite6jax.domains.pose.fit import fit
from lite6jax.effects.composition import Physics
from lite6jax.effects.motion import motion_of
from lite6jax.effects.serialization import effect_from_dict
from lite6jax.effects.statics import inertia_of
from lite6jax.model import ArmModel, predict_poses
from lite6jax.recordings import read_recording

LONG = partial(pytest.param, marks=pytest.mark.long)
PAYLOAD_CENTER = np.array([0.01, 0.0, 0.05])


def a_setup(rng, arm=None):
    sensor, tool = views.turned(rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)), np.eye(4)
    tool[:3, 3] = 0.02, 0.0, 0.06
    return Setup((arm or lite6()).moved(rng, *MADE), sensor, tool, PAYLOAD_CENTER)


def a_motion(rng, setup, moving=False, rows=60, load=True):
    return recorded.draw_motion(rng, setup.chain, moving, rows, warming=True, loading=load, fixed_load=True)


def rms(points):
    return float(np.sqrt(np.mean(np.sum(np.square(points), 1))))


@pytest.mark.parametrize(("ours", "theirs"), [(lite6, "lite6"), (lite6_ros, "lite6_ros")], ids=["published", "ros"])
def test_both_lite6_are_the_bundled_ones(ours, theirs):
    bundled = load_bundled(theirs)
    np.testing.assert_allclose(ours().rows, bundled.kinematics, atol=1e-12)
    np.testing.assert_allclose(ours().mass, bundled.mass)
    np.testing.assert_allclose(ours().center, bundled.center_of_mass, atol=1e-12)


@pytest.mark.parametrize("arm", [seven(), chain.drawn_six(np.random.default_rng(1))], ids=["seven", "six"])
def test_arms_of_its_own_are_described_as_they_are(arm, tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text(chain.description_text(arm))
    read = read_description(path)
    assert isinstance(read, LibraryArm)
    np.testing.assert_allclose(read.kinematics, arm.rows, atol=1e-15)
    np.testing.assert_allclose(read.center_of_mass, arm.center, atol=1e-15)
    np.testing.assert_allclose(read.joint_limits, arm.limits, atol=1e-15)


def test_an_arm_of_a_dh_table_is_where_the_table_says():
    rng = np.random.default_rng(3)
    theta, d, a, alpha, q = rng.uniform(-1, 1, (5, 4))
    T = np.eye(4)
    for i in range(4):
        turn, step = np.eye(4), np.eye(4)
        turn[:3, :3], turn[2, 3] = rotation_from_rpy(0, 0, theta[i] + q[i]), d[i]
        step[:3, :3], step[0, 3] = rotation_from_rpy(alpha[i], 0, 0), a[i]
        T = T @ turn @ step
    rows = chain.rows_from_dh(theta, d, a, alpha)
    arm = chain.Chain("x", rows, np.zeros((4, 2)), np.ones(4), np.zeros((4, 3)))
    R, p = arm.frames(q[None])
    last = R[0, -1] @ rotation_from_rpy(0, 0, theta[3])
    np.testing.assert_allclose(last @ rotation_from_rpy(alpha[3], 0, 0), T[:3, :3], atol=1e-14)
    np.testing.assert_allclose(p[0, -1] + last @ [a[3], 0, d[3]], T[:3, 3], atol=1e-14)


SITES = {
    "base_compliance": "base",
    "base_drift": "base",
    "tool_offset": "tool",
    "measurement_scale": "sensor",
    "payload_error": "payload",
    "link_compliance": "link3",
    "link_thermal_expansion": "link2",
    "frame_offset": "link4",
}
WHERE = {"joint_harmonic": {"joint": 2, "order": 3.5}, "joint_coupling": {"joint": 2, "source_joint": 4}}


SHARED = [name for name in COORDINATES if name not in (*OUTSIDE, "time_offset")]
"""Effects that both codes know."""


def of_the_library(hidden):
    """The library's effect for a hidden one, and its values."""
    place = "joint" if hidden.site.startswith("joint") else "link"
    where = WHERE.get(hidden.name, {place: hidden.number} if hidden.number else {})
    numbers = {key: value for key, value in views.reported(hidden).items() if key not in where}
    return effect_from_dict({"effect": hidden.name, "where": where, "parameters": numbers})


@pytest.fixture(scope="module")
def two_codes():
    """Each shared effect as it is hidden, and what either code shows of some of them.

    The library's code is compiled once, with all effects, of which the others' values are zero.
    """
    rng = np.random.default_rng(5)
    setup = a_setup(rng)
    motion = a_motion(rng, setup, moving=True, rows=20)
    hidden = {}
    for name in SHARED:
        values = 1e-4 * rng.normal(size=3 if name == "tool_offset" else len(COORDINATES[name]))
        fixed = {key: v for key, v in WHERE.get(name, {}).items() if key != "joint"}
        hidden[name] = Hidden(name, SITES.get(name, "joint2"), tuple(values), fixed)
    pairs = {name: of_the_library(effect) for name, effect in hidden.items()}
    physics = Physics(tuple(effect for effect, _ in pairs.values()))
    given = (
        ArmModel(setup.chain.rows.ravel(), setup.sensor, setup.tool),
        motion_of(
            motion.q,
            joint_velocity=motion.dq,
            direction=motion.direction,
            time=motion.time,
            joint_temperature=motion.temperature,
            payload=motion.payload,
        ),
        inertia_of(setup.chain.mass, setup.chain.center, PAYLOAD_CENTER),
    )

    def ours(*names):
        return poses(setup, tuple(hidden[name] for name in names), motion)

    def theirs(*names):
        values = physics.join([np.multiply(value, name in names) for name, (_, value) in pairs.items()])
        return np.asarray(predict_poses(SixParameterForm(6), physics, given[0], values, *given[1:]))

    return ours, theirs


@pytest.mark.parametrize("name", SHARED)
def test_two_codes_that_know_nothing_of_each_other_show_the_same_physics(two_codes, name):
    ours, theirs = two_codes
    names = (name, "joint_compliance") if name == "payload_error" else (name,)
    (rotation, position), shown = ours(*names), theirs(*names)
    assert rms(position - ours()[1]) > 1e-7
    np.testing.assert_allclose(position, shown[:, :3, 3], atol=1e-13)
    np.testing.assert_allclose(rotation, shown[:, :3, :3], atol=1e-13)


def test_gravity_does_the_work_that_its_torques_say():
    rng = np.random.default_rng(7)
    arm, q, load = seven(), rng.uniform(-1, 1, (5, 7)), np.full(5, 0.7)

    def energy(q):
        R, p = arm.frames(q)
        centers = p + np.einsum("sjab,jb->sja", R, arm.center)
        return 9.81 * (centers[..., 2] @ arm.mass + 0.7 * (p[:, -1] + R[:, -1] @ PAYLOAD_CENTER)[:, 2])

    slopes = [(energy(q - 1e-5 * e) - energy(q + 1e-5 * e)) / 2e-5 for e in np.eye(7)]
    np.testing.assert_allclose(moments(arm, q, load, PAYLOAD_CENTER)[0][..., 2].T, slopes, atol=1e-8)


def test_springs_outside_the_catalogue_do_what_they_say():
    load = np.linspace(-3, 3, 50)
    x = hardening(load)
    np.testing.assert_allclose(x + HARDENING * x**3, load, atol=1e-12)
    there_and_back = np.concatenate([np.linspace(0, 1, 40), np.linspace(1, -1, 80), np.linspace(-1, 1, 80)])
    x = yielding(there_and_back)
    assert x[40:120] == pytest.approx(-x[120:], abs=1e-12)  # a loop that closes on itself
    middle = np.argmin(abs(there_and_back[40:120])), np.argmin(abs(there_and_back[120:]))
    assert x[40 + middle[0]] > 0.1 > -0.1 > x[120 + middle[1]]  # the same load, other ways there
    small = yielding(0.5 * np.sin(np.linspace(0, 20, 200)))
    np.testing.assert_allclose(small, 0.2 * np.sin(np.linspace(0, 20, 200)), atol=1e-12)  # elastic until it yields


def test_a_spring_that_yields_is_a_spring_and_wind_up_of_the_catalogue():
    load = np.random.default_rng(4).normal(size=400).cumsum() / 4
    held, windup = 0.0, np.empty(400)
    for k, now in enumerate(load):
        held = windup[k] = np.clip(held, now - 2.5 * YIELD, now + 2.5 * YIELD)  # the play operator
    assert np.ptp(load) > 4 * YIELD
    np.testing.assert_allclose(yielding(load), 0.4 * load + 1.6 * windup, atol=1e-12)


AT_REST = [
    ((), 1e-9),
    ((Hidden("joint_compliance", "joint2", (3e-5,)),), 1e-3),
    ((Hidden("joint_compliance", "joint3", (3e-5,)), Hidden("payload_error", "payload", (0.3,))), 1e-3),
    ((Hidden("base_compliance", "base", (2e-5, 1e-5)),), 1e-3),
    ((Hidden("hardening_spring", "joint2", (3e-4,), {"torque_Nm": 5.0}),), 1e-3),
]
"""What is hidden, and the share of its effect by which a definition and forces may differ."""


@pytest.mark.parametrize(
    ("hidden", "within"), AT_REST, ids=lambda v: "+".join(h.name for h in v) if isinstance(v, tuple) else ""
)
def test_mujoco_at_rest_bends_as_the_definitions_say(hidden, within):
    rng = np.random.default_rng(11)
    setup = a_setup(rng)
    motion = a_motion(rng, setup, rows=20)
    found = Arm(setup, hidden, float(motion.payload[0])).at_rest(motion)
    rotation, position = poses(setup, hidden, motion)
    moved = rms(position - poses(setup, (), motion)[1]) or 1.0
    assert rms(found.position - position) < within * moved
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-6)


@pytest.mark.parametrize("moving", [False, True], ids=["at rest", "moving"])
def test_mujoco_s_clearance_follows_the_direction(moving):
    rng = np.random.default_rng(13)
    setup = a_setup(rng)
    hidden = (Hidden("joint_backlash", "joint1", (4e-4,), {"friction_Nm": 1.0}),)
    motion = a_motion(rng, setup, moving, rows=100 if moving else 12)
    body = Arm(setup, hidden, float(motion.payload[0]))
    found = body.moving(motion) if moving else body.at_rest(motion)
    after = slice(1, None)  # the first row at rest came from nowhere
    moved = poses(setup, (), found.motion)[1][after]
    off = found.position[after] - poses(setup, hidden, found.motion)[1][after]
    assert np.median(np.linalg.norm(off, axis=1)) < 0.05 * rms(found.position[after] - moved)


def test_mujoco_s_late_clock_shows_the_arm_later():
    rng = np.random.default_rng(17)
    setup = a_setup(rng)
    motion = a_motion(rng, setup, moving=True, rows=40)
    hidden = (Hidden("time_offset", "clock", (0.0123,)),)
    found = Arm(setup, hidden, float(motion.payload[0])).moving(motion)
    np.testing.assert_allclose(found.position, poses(setup, hidden, found.motion)[1], atol=1e-9)
    assert 1e-6 < abs(found.motion.q - motion.q).max() < 0.3  # servos err, encoders do not


def test_mujoco_refuses_what_it_cannot_build():
    with pytest.raises(ValueError, match="joint_bump"):
        Arm(a_setup(np.random.default_rng(0)), (Hidden("joint_bump", "joint1", (1.0,)),), 0.0)


def a_view(rng, **left_open):
    setup = a_setup(rng)
    said = {"frame": True, "tool": 3, "geometry": False} | left_open
    return View(setup, Open(**said), a_motion(rng, setup, rows=60), (2e-5, None))


@pytest.mark.parametrize("name", ["joint_compliance", "link_compliance"])
def test_a_test_that_is_told_where_to_look_finds_the_threshold_half_the_time(name):
    rng = np.random.default_rng(19)
    view = a_view(rng)
    effect = Hidden(
        name, {"joint_compliance": "joint2", "link_compliance": "link2"}[name], (1.0,) * len(COORDINATES[name])
    )
    span = view.nuisance()
    size = information.threshold(view, (effect,), 0, span).size
    hidden = (effect.sized(np.array(effect.values) * size),)
    columns = threshold.across(span, view.columns(hidden, 0))
    shown = view.difference(poses(view.setup, (), view.motion), poses(view.setup, hidden, view.motion))
    y = shown[:, None] + rng.normal(size=(len(shown), 4000))
    explained = np.sum((np.linalg.qr(columns)[0].T @ threshold.across(span, y)) ** 2, 0)
    limit = chi2.isf(threshold.ALARM / threshold.SEARCHED, columns.shape[1])
    assert np.mean(explained > limit) == pytest.approx(0.5, abs=0.03)


@pytest.mark.long
@pytest.mark.parametrize("prior", [None, (5e-5, 5e-5)], ids=["geometry known", "geometry uncertain"])
def test_the_oracle_is_as_good_as_the_bound(prior):
    rng = np.random.default_rng(23)
    view = a_view(rng, geometry=prior is not None, prior=prior)
    hidden = (
        Hidden("joint_compliance", "joint2", (5e-5,)),
        Hidden("joint_harmonic", "joint3", (1e-4, 1e-4), {"order": 5.0}),
        Hidden("base_drift", "base", (1e-7, -1e-7, 0.0)),
        Hidden("joint_backlash", "joint4", (1e-4,)),
    )
    bounds = [value for effect in information.bounds(view, hidden) for value in effect.values()]
    truth = [views.reported(effect)[name] for effect in hidden for name in information.bounds(view, (effect,))[0]]
    seen, off = poses(view.setup, hidden, view.motion), []
    for _ in range(8):
        chain_said = view.setup.chain if prior is None else view.setup.chain.moved(rng, *prior)
        believed = Setup(chain_said, view.setup.sensor, view.setup.tool, PAYLOAD_CENTER)
        measured = seen[0], seen[1] + rng.normal(0, 2e-5, seen[1].shape)
        fitted = oracle.oracle(view, believed, hidden, measured, np.ones(len(seen[1]), bool))
        said = [views.reported(effect)[name] for effect in fitted.hidden for name in views.reported_slopes(effect)[0]]
        off.append((np.array(said) - truth) / bounds)
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1, abs=0.25)  # of 56 numbers, three standard deviations


def test_what_frames_can_do_as_well_is_not_seen():
    view = a_view(np.random.default_rng(29))
    seen = information.threshold(view, (Hidden("joint_offset", "joint1", (1.0,)),), 0, view.nuisance())
    assert seen.seen < 1e-4
    rival = rivals.nearest_rival(view, (Hidden("tool_offset", "tool", (1e-3, 0.0, 0.0)),), 0, np.zeros((180, 0)))
    assert (rival.name, rival.site) == ("frame_offset", "link6")
    assert rival.apart < 1e-3


@pytest.mark.long
@pytest.mark.parametrize("index", [5, 8, 11])
def test_a_seed_gives_the_same_trial_and_the_library_reads_it(index, tmp_path):
    first, second = trials.draw(0, index), trials.draw(0, index)
    assert sealed_text(first.truth) == sealed_text(second.truth)
    assert first.files == second.files
    write_files(first.files, tmp_path)
    recording = read_recording(tmp_path / "recording.csv")
    assert recording.joint_position.shape[0] == first.plan.rows
    assert not recording.notes
    given = " ".join(first.files.values())
    assert not any(effect["effect"] in given for effect in first.truth["hidden"])  # nothing tells


@pytest.mark.parametrize("sensor", plans.READERS)
def test_the_library_fits_what_the_generator_reads_to_its_noise(sensor, tmp_path):
    clean = plans.READ_ROUNDS.indices(0, 12, "clean")
    index = next(i for i in clean if trials.draw_reading(sensor, 0, i).plan.geometry == "known")
    trial = trials.draw_reading(sensor, 0, index)
    assert trial.files == trials.draw_reading(sensor, 0, index).files
    write_files(trial.files, tmp_path)
    recording = read_recording(tmp_path / "recording.csv")
    assert recording.samples == plans.READERS[sensor]
    assert not recording.notes
    assert fit(recording).noise.over_declared == pytest.approx(1.0, abs=0.25)


def test_a_place_that_is_touched_is_none_of_what_an_effect_shows():
    trial = trials.draw_reading("contact", 0, 1)
    (effect,) = trial.truth["hidden"]
    assert effect["size"] == pytest.approx(trial.truth["sizes"][0], rel=1e-2)
    assert 0.01 < effect["seen"] < 0.5  # most of what it does, points, tool and chain can do as well


def test_sizes_are_those_that_were_planned():
    trial = trials.draw(0, 0)
    assert [h["size"] for h in trial.truth["hidden"]] == pytest.approx(trial.truth["sizes"], rel=1e-3)


@pytest.mark.parametrize(
    ("seed", "index"), [(2240, 13), LONG(2240, 49), LONG(2240, 297), (2241, 140), (2241, 380)], ids=str
)
def test_nothing_is_hidden_that_no_arm_can_have(seed, index):
    """These would draw payloads of less than nothing, links that grow more than plastics do or bend by a seventh of a
    degree under 1 Nm, and a spring as soft at an upright axis.
    """
    trial = trials.draw(seed, index)
    header, *rows = csv.reader(io.StringIO(trial.files["recording.csv"]))
    payload = [float(row[header.index("payload_kg")]) for row in rows]
    sizes = {effect["effect"]: effect["parameters"] for effect in trial.truth["hidden"]}
    assert min(payload) + sizes.get("payload_error", {"mass_kg": 0.0})["mass_kg"] >= 0
    assert sizes.get("link_thermal_expansion", {"expansion_per_K": 0.0})["expansion_per_K"] <= 1e-4
    assert max(map(abs, sizes.get("link_compliance", {"none": 0.0}).values())) <= 1e-3
    for effect in trial.truth["hidden"]:
        if effect["effect"] == "hardening_spring":
            assert effect["parameters"]["turn_rad"] <= 1e-3 * effect["fixed"]["torque_Nm"]


def test_every_round_has_every_kind_in_its_share():
    kinds = [plans.ROUNDS.kind_of(3, index) for index in range(50)]
    assert {kind: kinds.count(kind) for kind in plans.KINDS} == {
        "clean": 20,
        "single": 16,
        "mixture": 6,
        "outside": 2,
        "edge": 2,
        "faulty": 4,
    }
    assert plans.ROUNDS.indices(3, 4, "faulty") == [index for index, kind in enumerate(kinds) if kind == "faulty"]
    drawn = [
        plans.draw_plan(3, i, np.random.default_rng(0)) for i in plans.ROUNDS.indices(3, len(plans.SIZES), "single")
    ]
    assert sorted(plan.sizes[0] for plan in drawn) == sorted(plans.SIZES)
    faults = [
        plans.draw_plan(3, i, np.random.default_rng(0)).fault
        for i in plans.ROUNDS.indices(3, len(plans.FAULTS), "faulty")
    ]
    assert sorted(faults) == sorted(plans.FAULTS)
