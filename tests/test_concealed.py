"""The generator of the pose trials: right by two other codes, with a threshold that holds; families outside it."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from scipy.stats import t as student

from benchmarks.campaigns import detection
from benchmarks.campaigns.campaign import write_files
from benchmarks.concealed import hiding, plans, trials
from benchmarks.concealed import view as views
from benchmarks.concealed.chain import MADE, lite6, rotation_from_vector, seven
from benchmarks.concealed.mujoco_physics import Arm
from benchmarks.concealed.outside import FAMILIES, draw_form, families
from benchmarks.concealed.plain_physics import COORDINATES, OUTSIDE, Hidden, Setup, loaded, moments, poses
from benchmarks.concealed.view import Open, View
from lite6jax.domains.pose.fit import fit
from lite6jax.recordings import read_recording
from tests.oracles.effects import predicted_poses

PAYLOAD_CENTER = np.array([0.01, 0.0, 0.05])
GRAVITY = np.array([0.0, 0.0, -9.81])


def a_setup(rng):
    sensor, tool = views.transform(rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)), np.eye(4)
    tool[:3, 3] = 0.02, 0.0, 0.06
    return Setup(lite6().moved(rng, *MADE), sensor, tool, PAYLOAD_CENTER)


def a_motion(rng, setup, moving=False, rows=60):
    return trials.draw_motion(rng, setup.chain, moving, rows, warming=True, loading=True, fixed_load=True)


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
FIXED = {"joint_harmonic": {"order": 3.5}, "joint_coupling": {"source_joint": 4.0}}
SHARED = [name for name in COORDINATES if name not in (*OUTSIDE, "time_offset")]
"""Effects that both codes know."""


def plain_form(hidden):
    """A hidden effect as the oracle takes it."""
    place = {"joint" if hidden.site.startswith("joint") else "link": hidden.number} if hidden.number else {}
    return hidden.name, place | dict(hidden.fixed) | views.reported(hidden)


@pytest.mark.parametrize("name", SHARED)
def test_two_codes_that_know_nothing_of_each_other_show_the_same_physics(name):
    rng = np.random.default_rng(5)
    setup = a_setup(rng)
    motion = a_motion(rng, setup, moving=True, rows=20)
    values = 1e-4 * rng.normal(size=3 if name == "tool_offset" else len(COORDINATES[name]))
    beside = (Hidden("joint_compliance", "joint2", (1e-4,)),) if name == "payload_error" else ()
    hidden = (Hidden(name, SITES.get(name, "joint2"), tuple(values), FIXED.get(name, {})), *beside)
    told = {
        "joint_position": motion.q,
        "joint_velocity": motion.dq,
        "direction": motion.direction,
        "time": motion.time,
        "joint_temperature": motion.temperature,
        "payload": motion.payload,
    }
    chain = setup.chain
    inertia = {"mass": chain.mass, "center_of_mass": chain.center, "payload_center": PAYLOAD_CENTER, "gravity": GRAVITY}
    shown = predicted_poses(chain.rows, setup.sensor, setup.tool, told, inertia, [*map(plain_form, hidden)])
    rotation, position = poses(setup, hidden, motion)
    assert rms(position - poses(setup, (), motion)[1]) > 1e-7
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
    size = hiding.detection_threshold(view, (effect,), 0, span).size
    hidden = (effect.sized(np.array(effect.values) * size),)
    columns = detection.project_out(span, view.columns(hidden, 0))
    shown = view.difference(poses(view.setup, (), view.motion), poses(view.setup, hidden, view.motion))
    y = shown[:, None] + rng.normal(size=(len(shown), 4000))
    explained = np.sum((np.linalg.qr(columns)[0].T @ detection.project_out(span, y)) ** 2, 0)
    limit = chi2.isf(detection.ALARM / detection.SEARCHED, columns.shape[1])
    assert np.mean(explained > limit) == pytest.approx(0.5, abs=0.03)


def test_what_frames_can_do_as_well_is_not_seen():
    view = a_view(np.random.default_rng(29))
    seen = hiding.detection_threshold(view, (Hidden("joint_offset", "joint1", (1.0,)),), 0, view.nuisance())
    assert seen.seen < 1e-4
    rival = hiding.nearest_rival(view, (Hidden("tool_offset", "tool", (1e-3, 0.0, 0.0)),), 0, np.zeros((180, 0)))
    assert (rival.name, rival.site) == ("frame_offset", "link6")
    assert rival.apart < 1e-3


@pytest.mark.parametrize(
    "sensor",
    [pytest.param(sensor, marks=pytest.mark.long if "camera" in sensor else ()) for sensor in plans.READERS],
)
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


def test_the_rows_repeated_in_a_file_are_those_that_are_sealed():
    of_kind = plans.ROUNDS.indices(4, len(plans.FAULTS), "faulty")
    index = next(i for i in of_kind if plans.draw_plan(4, i, np.random.default_rng(0)).fault == "repeated_rows")
    trial = trials.draw(4, index)
    _, *lines = trial.files["recording.csv"].splitlines()
    again = [k for k, line in enumerate(lines) if k and line == lines[k - 1]]
    assert trial.truth["fault_rows"] == [k - before for before, k in enumerate(again)]
    assert len(again) == 8


# ------------------------------------------------------------------ noise that is hard to tell from physics


def read_at_rest(noise, index, rows, **said):
    """The plan of a trial with this noise, what is read of joints at zero, and positions over the declared noise."""
    plan = replace(plans.draw_noise_plan(noise, 5, index, np.random.default_rng(index)), **said)
    rng = np.random.default_rng(3)
    setup = a_setup(rng)
    motion = replace(a_motion(rng, setup, rows=rows), q=np.zeros((rows, 6)))
    seen = np.broadcast_to(np.eye(3), (rows, 3, 3)), np.zeros((rows, 3))
    (_, position), read = trials.measure(plan, rng, setup, motion, seen)
    return plan, read.q, position / plans.SENSORS[plan.sensor][0]


def followed(states):
    """The correlation of each column with itself a row later."""
    return [np.corrcoef(column[1:], column[:-1])[0, 1] for column in states.T]


@pytest.mark.parametrize("memory", [2.0, 33.3])
def test_read_outs_wander_as_far_and_as_slowly_as_drawn(memory):
    plan, q, position = read_at_rest("wandering", 0, 40_000, noise_memory=memory)
    np.testing.assert_allclose(q.std(0), plan.encoder_std, rtol=0.1)
    np.testing.assert_allclose(followed(q), 1 - 1 / memory, atol=0.02)
    np.testing.assert_allclose(np.corrcoef(q.T), np.eye(6), atol=0.15)
    np.testing.assert_allclose(followed(position), 0.0, atol=0.02)


@pytest.mark.parametrize("memory", [2.0, 33.3])
def test_noise_remembers_as_many_rows_as_drawn(memory):
    _, q, position = read_at_rest("autocorrelated", 0, 40_000, noise_memory=memory)
    np.testing.assert_array_equal(q, 0.0)
    np.testing.assert_allclose(position.std(0), 1.0, rtol=0.1)
    np.testing.assert_allclose(followed(position), 1 - 1 / memory, atol=0.02)


def test_noise_is_as_large_in_the_first_row_as_later():
    started = trials.autoregression(np.random.default_rng(0).normal(size=(2, 20_000)), 0.99)
    np.testing.assert_allclose(started.std(1), 1.0, rtol=0.03)


@pytest.mark.parametrize("index", [0, 1])
def test_heavy_tails_have_the_deviation_or_the_scale_that_is_declared(index):
    plan, _, position = read_at_rest("heavy_tails", index, 40_000)
    scale = plan.over_declared / 3**0.5
    for chance in (0.5, 0.01):
        assert np.mean(abs(position) > scale * student.isf(chance / 2, 3)) == pytest.approx(chance, rel=0.1)


def test_hard_noise_is_drawn_between_its_ends_and_hides_nothing():
    drawn = [
        plans.draw_noise_plan(noise, 5, index, np.random.default_rng([5, stream, index]))
        for noise, stream in plans.HARD_NOISES.items()
        for index in range(100)
    ]
    assert not any(plan.effects or plan.fault or plan.kind != "clean" for plan in drawn)
    memories = np.array([plan.noise_memory for plan in drawn if plan.noise != "heavy_tails"])
    assert 2.0 <= memories.min() < 4.0
    assert 250.0 < memories.max() <= 500.0
    assert np.exp(np.log(memories).mean()) == pytest.approx(31.6, rel=0.3)
    stds = np.array([plan.encoder_std for plan in drawn if plan.noise == "wandering"])
    assert 7.5e-5 <= stds.min() < stds.max() <= 3e-4
    assert np.exp(np.log(stds).mean()) == pytest.approx(1.5e-4, rel=0.2)
    over = [plan.over_declared for plan in drawn if plan.noise == "heavy_tails"]
    assert [over.count(each) for each in plans.TAILS] == [50, 50]


def test_what_was_drawn_before_there_was_hard_noise_is_drawn_still():
    told = [plans.draw_plan(7, index, np.random.default_rng([7, 0, index, 0])).told() for index in range(50)]
    for sensor in plans.READERS:
        for index in range(2):
            told.append(plans.draw_reading_plan(sensor, 7, index, np.random.default_rng([7, 12, index, 0])).told())
    digest = hashlib.sha256(json.dumps(told).encode()).hexdigest()
    assert digest == "429a70c603acaa51f802e31efc106a7dc29610d0005037c2a2b6073ca68ce738"


# ------------------------------------------------------------------ physics outside the catalogue


@pytest.fixture(scope="module")
def scene():
    """A Lite 6 that moves and warms up and down, seen from a sensor somewhere."""
    rng = np.random.default_rng(41)
    setup = a_setup(rng)
    motion = trials.draw_motion(rng, setup.chain, True, 60, warming=True, wandering=True, loading=True)
    return setup, motion


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


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_moves_its_own_site_in_proportion_to_its_number(name, scene):
    setup, motion = scene
    rotation, position = poses(setup, (), motion)
    forms = (draw_form(name, np.random.default_rng(seed), loaded(setup, motion)) for seed in range(20))
    for site, fixed in filter(None, forms):  # until one that this motion shows
        single, double = (poses(setup, (Hidden(name, site, (size,), fixed),), motion) for size in (1e-6, 2e-6))
        shift, turn = single[1] - position, single[0] @ np.swapaxes(rotation, 1, 2)
        if rms(shift) > 1e-10:
            break
    assert rms(shift) > 1e-10
    np.testing.assert_allclose(double[1] - position, 2 * shift, atol=1e-4 * np.abs(shift).max())
    if "axis" not in fixed and not site.startswith("joint"):  # an image turns nothing
        np.testing.assert_allclose(turn, np.broadcast_to(np.eye(3), turn.shape), atol=1e-15)
        return
    # an angle of a joint turns its link about its own axis
    axis = 5 if site.startswith("joint") else int(fixed["axis"])
    twist = np.eye(6)[axis] * np.ones((len(position), 1))
    unit = displaced(setup, motion, site.replace("joint", "link"), 1e-6 * twist)[1] - position
    signal = np.sum(shift * unit, 1, keepdims=True) / np.sum(unit**2, 1, keepdims=True)
    expected = displaced(setup, motion, site.replace("joint", "link"), 1e-6 * signal * twist)
    np.testing.assert_allclose(single[1], expected[1], atol=1e-4 * np.abs(shift).max() + 1e-13)
    np.testing.assert_allclose(single[0], expected[0], atol=1e-4 * np.abs(signal).max() * 1e-6 + 1e-13)


@pytest.mark.parametrize("seed", [5, 2381])
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
    assert hiding.equal_sites(view, tilt) == ["base", "sensor"]
    bump = Hidden("joint_bump", "joint4", (1e-4,), {"joint": 4.0, "centre": 0.0, "width": 0.3})
    assert {"joint4", "link4"} <= set(hiding.equal_sites(view, bump))
    assert not {"joint2", "base"} & set(hiding.equal_sites(view, bump))


def nearest(scene, effect):
    setup, motion = scene
    view = View(setup, Open(frame=True, tool=3, geometry=False), motion.thinned(60), (2e-5, 1e-4))
    drivers = FAMILIES[effect.name].drivers(effect.fixed)
    return hiding.nearest_to_outside(view, effect, hiding.equal_sites(view, effect), drivers)


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
    motion = trials.draw_motion(rng, setup.chain, False, 14)
    motion = replace(motion, payload=np.full(14, 0.5))
    play = Hidden("joint_backlash", "joint2", (6e-4,), {"friction_Nm": 0.3})
    spring = Hidden("joint_compliance", "joint2", (3e-5,))
    for hidden in ((play, spring), (spring, play)):
        found = Arm(setup, hidden, 0.5).at_rest(motion)
        shown = poses(setup, hidden, found.motion)[1]
        torque = moments(setup.chain, found.motion.q, found.motion.payload, PAYLOAD_CENTER)[0][:, 1, 2]
        clear = np.abs(torque) > 1
        off = np.linalg.norm(found.position - shown, axis=1)[clear]
        for alone in hidden:
            missing = np.linalg.norm(poses(setup, (alone,), found.motion)[1] - shown, axis=1)[clear]
            assert np.all(off < 0.1 * missing.max())
            assert missing.max() > 1e-5
