"""The concealed trials: a generator apart from the library, a threshold that holds, sealed truths, honest scores."""

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.campaigns import threshold
from benchmarks.campaigns.campaign import write_files
from benchmarks.concealed import information, plans, recorded, rivals, trials
from benchmarks.concealed import view as views
from benchmarks.concealed.chain import MADE, lite6, seven
from benchmarks.concealed.mujoco_physics import Arm
from benchmarks.concealed.plain_physics import (
    COORDINATES,
    OUTSIDE,
    Hidden,
    Setup,
    moments,
    poses,
)
from benchmarks.concealed.view import Open, View
from lite6jax.arms.chains import SixParameterForm
from lite6jax.domains.pose.fit import fit
from lite6jax.effects.composition import Physics
from lite6jax.effects.motion import motion_of
from lite6jax.effects.serialization import effect_from_dict
from lite6jax.effects.statics import inertia_of
from lite6jax.model import ArmModel, predict_poses
from lite6jax.recordings import read_recording

PAYLOAD_CENTER = np.array([0.01, 0.0, 0.05])


def a_setup(rng, arm=None):
    sensor, tool = views.turned(rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)), np.eye(4)
    tool[:3, 3] = 0.02, 0.0, 0.06
    return Setup((arm or lite6()).moved(rng, *MADE), sensor, tool, PAYLOAD_CENTER)


def a_motion(rng, setup, moving=False, rows=60, load=True):
    return recorded.draw_motion(rng, setup.chain, moving, rows, warming=True, loading=load, fixed_load=True)


def rms(points):
    return float(np.sqrt(np.mean(np.sum(np.square(points), 1))))


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


def test_what_frames_can_do_as_well_is_not_seen():
    view = a_view(np.random.default_rng(29))
    seen = information.threshold(view, (Hidden("joint_offset", "joint1", (1.0,)),), 0, view.nuisance())
    assert seen.seen < 1e-4
    rival = rivals.nearest_rival(view, (Hidden("tool_offset", "tool", (1e-3, 0.0, 0.0)),), 0, np.zeros((180, 0)))
    assert (rival.name, rival.site) == ("frame_offset", "link6")
    assert rival.apart < 1e-3


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
