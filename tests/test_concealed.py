"""The concealed trials: a generator apart from the library, a threshold that holds, sealed truths, honest scores."""

import ast
import csv
import hashlib
import io
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from concealed_rows import TRUTH, WAVE, a_diagnosis, a_finding, a_hidden, a_row
from concealed_work import dying, refusing
from scipy.stats import chi2

from benchmarks import __main__ as harness
from benchmarks.campaigns import shares, tables, threshold
from benchmarks.campaigns.campaign import given_in, opened, sealed_in, sealed_text, write_files
from benchmarks.concealed import (
    chain,
    command,
    figures,
    information,
    oracle,
    plans,
    recorded,
    report,
    rivals,
    scores,
    trials,
)
from benchmarks.concealed import view as views
from benchmarks.concealed.campaign import POSES
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
from benchmarks.ending import DONE, UNUSABLE
from lite6jax.arms.arm import Arm as LibraryArm
from lite6jax.arms.bundled import load_bundled
from lite6jax.arms.chains import SixParameterForm
from lite6jax.arms.description import read_description
from lite6jax.effects.composition import Physics
from lite6jax.effects.motion import motion_of
from lite6jax.effects.serialization import effect_from_dict
from lite6jax.effects.statics import inertia_of
from lite6jax.model import ArmModel, predict_poses
from lite6jax.recordings import read_recording

GENERATOR = (
    *("chain", "plain_physics", "mujoco_physics", "view", "information", "rivals", "oracle"),
    *("plans", "hiding", "recorded", "trials", "statements", "outside/__init__"),
    *(f"outside/{name}" for name in ("base", "drawing", "family", "joint", "link", "opened", "sensor", "tool")),
    *("outside/vault", "outside/workshop"),
)
PAYLOAD_CENTER = np.array([0.01, 0.0, 0.05])


def a_setup(rng, arm=None):
    sensor, tool = views.turned(rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)), np.eye(4)
    tool[:3, 3] = 0.02, 0.0, 0.06
    return Setup((arm or lite6()).moved(rng, *MADE), sensor, tool, PAYLOAD_CENTER)


def a_motion(rng, setup, moving=False, rows=60, load=True):
    return recorded.draw_motion(rng, setup.chain, moving, rows, warming=True, loading=load, fixed_load=True)


def rms(points):
    return float(np.sqrt(np.mean(np.sum(np.square(points), 1))))


def test_the_generator_imports_nothing_of_the_library():
    for name in GENERATOR:
        source = (Path(trials.__file__).parent / f"{name}.py").read_text()
        for node in ast.walk(ast.parse(source)):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [n for n in names if n.split(".")[0] in ("lite6jax", "jax", "tests")], (name, names)
            # of its neighbours, too, only those that import nothing of it
            own = [n.rsplit(".", 1)[-1] for n in names if n.startswith("benchmarks.")]
            neighbours = {name.removeprefix("outside/") for name in GENERATOR}
            assert not set(own) - {*neighbours, "concealed", "outside", "threshold", "columns"}, (name, own)


def test_drawing_a_trial_loads_nothing_of_the_library():
    said = "from benchmarks.concealed import trials; trials.draw(0, 5)"
    said += "; import sys; print([name for name in sys.modules if name.split('.')[0] in ('jax', 'lite6jax')])"
    run = subprocess.run(
        [sys.executable, "-c", said], cwd=harness.__file__.rsplit("/", 2)[0], capture_output=True, text=True
    )
    assert run.stdout.strip() == "[]", run.stderr


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


def test_sizes_are_those_that_were_planned():
    trial = trials.draw(0, 0)
    assert [h["size"] for h in trial.truth["hidden"]] == pytest.approx(trial.truth["sizes"], rel=1e-3)


@pytest.mark.parametrize(("seed", "index"), [(2240, 13), (2240, 49), (2240, 297), (2241, 140), (2241, 380)])
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
    kinds = [plans.kind_of(3, index) for index in range(50)]
    assert {kind: kinds.count(kind) for kind in plans.KINDS} == {
        "clean": 20,
        "single": 16,
        "mixture": 6,
        "outside": 2,
        "edge": 2,
        "faulty": 4,
    }
    assert plans.indices(3, 4, "faulty") == [index for index, kind in enumerate(kinds) if kind == "faulty"]
    drawn = [plans.draw_plan(3, i, np.random.default_rng(0)) for i in plans.indices(3, len(plans.SIZES), "single")]
    assert sorted(plan.sizes[0] for plan in drawn) == sorted(plans.SIZES)
    faults = [
        plans.draw_plan(3, i, np.random.default_rng(0)).fault for i in plans.indices(3, len(plans.FAULTS), "faulty")
    ]
    assert sorted(faults) == sorted(plans.FAULTS)


def test_a_finding_is_the_truth_by_name_site_order_and_source():
    right = a_finding("joint_harmonic", "joint3", order=12.1, amplitude_rad=1e-4, phase_rad=-3.1)
    row = a_row([WAVE], right)
    assert (row["exact"], row["top_named"], row["detected"], row["hidden"][0]["named"]) == (True,) * 4
    assert row["hidden"][0]["numbers"][0]["off"] == pytest.approx(2 * np.pi - 6.2)  # a phase goes round
    assert not a_row([WAVE], a_finding("joint_harmonic", "joint3", order=12.3, amplitude_rad=1e-4))["exact"]
    elsewhere = a_row([WAVE], a_finding("joint_harmonic", "joint2", order=12.0))
    assert not elsewhere["top_site"]
    assert elsewhere["detected"]
    pulled = a_hidden("joint_coupling", "joint3", {"coupling": 1e-4, "source_joint": 2.0})
    assert a_row([pulled], a_finding("joint_coupling", "joint3", coupling=1e-4, source_joint=2.0))["exact"]
    assert not a_row([pulled], a_finding("joint_coupling", "joint3", coupling=1e-4, source_joint=4.0))["exact"]


def test_a_finding_admits_what_it_says_it_cannot_be_told_from():
    soft = a_hidden("joint_compliance", "joint2", {"compliance_rad_per_Nm": 1e-5})
    said = a_finding("link_compliance", "link1", rivals=[("joint_compliance", "joint2", 0.3)])
    row = a_row([soft], said)
    assert (row["exact"], row["exact_in_set"], row["top_in_set"], row["top_site"]) == (False, True, True, False)
    far = a_finding("link_compliance", "link1", rivals=[("joint_compliance", "joint2", 7.0)])
    assert not a_row([soft], far)["exact_in_set"]
    assert not a_row([soft], said, a_finding("base_drift", "base", gain=1.0))["exact_in_set"]  # one too many


def test_physics_outside_the_catalogue_is_to_be_unnamed_at_its_joint():
    bump = a_hidden("joint_bump", "joint3", {"height_rad": 1e-3}, drivers=[["position of joint 3"]])
    assert a_row([bump], a_finding("unnamed", "joint3", driver="position of joint 3"), kind="outside")["exact"]
    assert not a_row([bump], a_finding("unnamed", "joint3", driver="time"), kind="outside")["exact"]
    named = a_row([bump], a_finding("joint_harmonic", "joint3", order=2.0), kind="outside")
    assert not named["exact"]
    assert named["hidden"][0]["site_found"]


def test_unseen_errors_leave_out_rows_that_cannot_be_predicted_and_say_how_many():
    row = a_row(off=3e-5)
    assert row["unseen_m"] == pytest.approx(3e-5 / np.sqrt(2))
    assert row["unseen_rad"] == pytest.approx(0, abs=1e-12)  # a quaternion and its negative are one rotation
    missing = scores.scored(
        TRUTH | {"hidden": []}, a_diagnosis(), {"x_m": [np.nan, 0.2], "y_m": [0, 0.2], "z_m": [0, 0.2]}, 1, ""
    )
    assert (missing["unseen_missing"], missing["unseen_m"]) == (0.5, 0.0)


def test_bars_hold_unseen_positions_or_not():
    """Noise is drawn for the truth, and counts beside the bars: a row that is far off is not within them."""
    shown = {name: [0.1, 0.2] for name in ("x_m", "y_m", "z_m")} | {"outside": [0.0, 1.0]}
    truth = TRUTH | {"hidden": [], "noise_m": 2e-5, "unseen_position_m": [[0.1, 0.1, 0.1], [0.2, 0.2, 0.3]]}
    bars = {f"{axis}_std_m": [1e-3, 1e-3] for axis in "xyz"}
    row = scores.scored(truth, a_diagnosis(), shown | bars, 1, "")
    assert (row["inside_components"], row["inside_covered"]) == (3.0, 3.0)
    assert (row["outside_components"], row["outside_covered"]) == (3.0, 2.0)
    assert scores.within_bars([row], "inside") == 1.0
    assert scores.within_bars([row], "outside") == pytest.approx(2 / 3)
    assert np.isnan(scores.within_bars([scores.scored(truth, a_diagnosis(), shown, 1, "")], "inside"))


def test_a_trial_without_an_answer_counts_as_wrong():
    row = scores.scored(TRUTH | {"hidden": [WAVE]}, None, None, 2.0, "InputError: no")
    assert (row["exact"], row["detected"], row["unseen_m"], row["error"]) == (False, False, None, "InputError: no")
    clean = scores.scored(TRUTH | {"hidden": [], "sizes": []}, None, None, 2.0, "InputError: no")
    assert not clean["exact"]


def test_shares_have_the_intervals_of_clopper_and_pearson():
    found = shares.share([True] * 95 + [False] * 5)
    assert (found.low, found.high) == pytest.approx((0.8872, 0.9836), abs=1e-4)
    assert shares.Share(0, 367).high == pytest.approx(0.01, abs=1e-4)
    assert (shares.Share(0, 5).low, shares.Share(5, 5).high) == (0.0, 1.0)
    assert str(shares.Share(0, 0)) == "none"


def test_ratios_are_of_root_mean_squares():
    found = shares.ratio([2.0, 2.0, 4.0], [1.0, 2.0, 4.0])
    assert found.value == pytest.approx(np.sqrt(24 / 21))
    assert found.low <= found.value <= found.high
    assert shares.ratio([], []).of == 0


def a_campaign():
    clean = [a_row(kind="clean", index=i, noise=noise) for i, noise in enumerate(plans.NOISES * 2)]
    said = dict.fromkeys(("order", "amplitude_rad", "phase_rad"), 0.0) | {"order": 12.0, "phase_rad": 3.0}
    hit = [
        a_row([WAVE], a_finding("joint_harmonic", "joint3", **said), size=s, index=50 + i)
        for i, s in enumerate(plans.SIZES)
    ]
    bump = a_hidden("joint_bump", "joint3", {"height_rad": 1e-3}, drivers=[["position of joint 3"]])
    unnamed = a_finding("unnamed", "joint3", driver="position of joint 3")
    out = [a_row([bump], unnamed, kind="outside", size=5.0, index=80)]
    bad = [a_row(kind="faulty", fault="swapped_joints", faults=["swapped_joints"], index=90)]
    both = [a_row([WAVE, WAVE], a_finding("joint_harmonic", "joint3", **said), kind="mixture", index=91)]
    return clean + hit + out + bad + both


def test_goals_are_met_or_not_and_said_so():
    rows = a_campaign()
    met = {goal.asked: goal.met for goal in scores.goals(rows)}
    assert met["found at twice the threshold, effect and site: 95 %"] is True
    assert met["false alarms, upper end of the interval: 1 %"] is False  # none, of too few
    assert met["outside the catalogue: unnamed, at its site, by its driver: 90 %"] is True
    assert all(goal.met is None for goal in scores.goals([]))
    assert "| NO |" in tables.markdown(report.sections(rows))
    assert all(table.row_count for table in tables.tables(report.sections(rows)))


def test_figures_are_drawn_of_what_there_is(tmp_path):
    drawn = [path.name for path in figures.draw(a_campaign(), tmp_path)]
    assert drawn == [f"concealed_{name}.png" for name in ("detection", "effects", "honesty", "unseen")]
    assert list(figures.draw([], tmp_path)) == []


def test_results_keep_their_types_and_are_read_again(tmp_path):
    rows = a_campaign()
    POSES.write_rows(rows, tmp_path / "a.parquet")
    assert POSES.read_rows(tmp_path / "a.parquet") == rows
    assert not list(tmp_path.glob(".*"))


def test_a_truth_that_was_touched_is_not_opened(tmp_path):
    digest = POSES.seal(0, 5, tmp_path)
    assert opened(tmp_path, 5, digest)["index"] == 5
    given = sorted(path.name for path in given_in(tmp_path, 5).iterdir())
    assert set(given) - {"arm.yaml", "factory.yaml"} == {"recording.csv", "recording.yaml", "unseen.csv"}
    sealed = sealed_in(tmp_path, 5)
    assert hashlib.sha256(sealed.read_bytes()).hexdigest() == digest
    sealed.write_text(sealed.read_text().replace("joint", "link", 1))
    with pytest.raises(ValueError, match="is not what was sealed"):
        opened(tmp_path, 5, digest)


def test_a_worker_that_dies_costs_its_trial_only(tmp_path):
    poses = replace(POSES, answer=dying)
    (row,) = poses.run(0, [5], tmp_path / "a.parquet", 1, lambda said: None, lambda *_: None)
    assert (row["index"], row["error"]) == (5, "WorkerDiedError: the process died")


def test_a_campaign_goes_on_where_it_stopped(tmp_path):
    out = tmp_path / "a.parquet"
    said, asked = [], []
    poses = replace(POSES, answer=refusing)

    def stop(what, done, total):
        asked.append((what, done, total))
        if (what, done) == ("diagnosed", 1):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        poses.run(0, [5, 6], out, 0, said.append, stop)
    rows = poses.run(0, [5, 6], out, 0, said.append, lambda *counts: asked.append(counts))
    assert asked == [
        *(("sealed", 1, 2), ("sealed", 2, 2), ("diagnosed", 1, 2)),
        *(("diagnosed", 1, 2), ("diagnosed", 2, 2)),
    ]
    assert [row["error"] for row in rows] == ["OSError: no diagnosis here"] * 2
    listed = out.with_suffix(".sha256").read_text().splitlines()
    assert [line.split("  ")[1] for line in listed] == ["a.trials/sealed/00005.json", "a.trials/sealed/00006.json"]
    assert subprocess.run(["sha256sum", "-c", "a.sha256"], cwd=tmp_path, capture_output=True).returncode == 0
    again = replace(POSES, answer=lambda given: pytest.fail("was done before"))
    assert again.run(0, [5, 6], out, 0, said.append, lambda *_: None) == rows
    more = poses.run(0, [6, 7], out, 0, said.append, lambda *_: None)
    assert more[0] == rows[1]
    assert [row["index"] for row in POSES.read_rows(out)] == [5, 6, 7]
    with pytest.raises(ValueError, match="another seed"):
        poses.run(1, [5], out, 0, said.append, lambda *_: None)


@pytest.mark.long
def test_one_trial_is_told_from_end_to_end(capsys):
    index = plans.indices(0, 1, "faulty")[0]
    assert harness.main(["concealed", "--seed", "0", "--trial", str(index)]) == DONE
    told = capsys.readouterr().out
    assert f"Trial {index} of seed 0: truth sealed, SHA-256" in told
    assert "Hidden: nothing" in told
    assert "Found exactly: yes" in told
    assert "the oracle by" in told


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--trial", "1", "--out", "a.parquet"], "leave --kind, --out and --figures out"),
        (["--out", "a.csv"], "end its name in .parquet"),
        (["--trials", "0"], "invalid whole number from 1"),
        (["--seed", "-1"], "invalid whole number from 0"),
        (["--kind", "dirty"], "invalid choice"),
    ],
)
def test_arguments_that_cannot_be_used_are_said(arguments, why, capsys):
    with pytest.raises(SystemExit, match="2"):
        command.main(arguments)
    assert why in capsys.readouterr().err


def test_a_file_of_another_seed_is_not_overwritten(tmp_path, capsys):
    out = tmp_path / "a.parquet"
    POSES.write_rows(a_campaign(), out)
    before = out.read_bytes()
    assert command.main(["--seed", "7", "--trials", "1", "--out", str(out)]) == UNUSABLE
    assert "has trials of another seed" in capsys.readouterr().err
    assert out.read_bytes() == before
    assert json.loads(json.dumps(POSES.read_rows(out)))
