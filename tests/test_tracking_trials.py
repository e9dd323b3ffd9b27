"""The generator of logs of commands: apart from the library, right by other physics, with a threshold that holds."""

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.signal import lfilter
from scipy.stats import chi2

from benchmarks import __main__ as harness
from benchmarks.campaigns import detection
from benchmarks.campaigns.campaign import write_files
from benchmarks.measure import DONE
from benchmarks.tracking_trials import faults, hiding, mujoco_arm, physics, plans, trials
from benchmarks.tracking_trials.arms import GRAVITY, PUBLISHED, Bodies, Dynamics, draw_arm
from benchmarks.tracking_trials.effects import FAMILIES, NAMED, OPEN, SEALED, Hidden
from benchmarks.tracking_trials.hiding import View
from benchmarks.tracking_trials.motions import MOTIONS, draw_commands
from benchmarks.tracking_trials.physics import Commands, Setup, roll
from lite6jax.arms.description import read_description
from lite6jax.recordings import read_recording
from tests.oracles.pinocchio_dynamics import pinocchio_model

ROOT = Path(__file__).resolve().parents[1]
AT = np.array([0.01, -0.02, 0.03])
CLOSE = 5e-5  # rad, within which NumPy and MuJoCo agree
FIRM = 1e-5  # rad, that dry friction may creep in MuJoCo beside


@pytest.fixture(autouse=True)
def _hurried(monkeypatch):
    """Runs begin sooner, and arms need not have settled: both simulators, and all variants, are alike in it."""
    for module in (physics, mujoco_arm):
        monkeypatch.setattr(module, "LEAD", 0.2)


def a_setup(name="serial3", seed=1, payload=0.3, sliding=False):
    arm = draw_arm(name, np.random.default_rng(seed), GRAVITY)
    if sliding:
        arm = replace(arm, joints=replace(arm.joints, coulomb=np.zeros(arm.chain.dof)))
    return Setup(arm, GRAVITY, payload, AT, 10.0, 0.25, 1.0)


def some_commands(arm, samples=150, seed=2, kinds=("multisine",), rate=100.0):
    return draw_commands(np.random.default_rng(seed), arm, kinds, rate, samples)


def at_rest(arm, samples=100, period=0.01):
    u = np.tile(arm.middle, (1, samples, 1))
    return Commands(period, u, np.zeros(1), np.ones((1, samples)))


@pytest.mark.parametrize("name", ["serial3", "serial5", *PUBLISHED])
def test_rigid_bodies_are_those_of_pinocchio(name):
    setup = a_setup(name)
    rng = np.random.default_rng(3)
    dof, lanes = setup.arm.chain.dof, 4
    q, dq, ddq = rng.normal(size=(3, dof, lanes))
    gravity = np.array([1.0, -2.0, -9.0])
    dynamics = Dynamics(Bodies.of(setup.arm, np.full(lanes, 0.7), AT))
    matrix, bias = dynamics.terms(q, dq, np.repeat(gravity[:, None], lanes, 1))
    chain = setup.arm.chain
    model = pinocchio_model(chain.rows, chain.mass, chain.center, setup.arm.inertia, gravity)
    model.appendBodyToJoint(dof, pin.Inertia(0.7, AT, np.zeros((3, 3))), pin.SE3.Identity())
    data = model.createData()
    for k in range(lanes):
        ours = matrix[:, :, k] @ ddq[:, k] + bias[:, k]
        np.testing.assert_allclose(ours, pin.rnea(model, data, q[:, k], dq[:, k], ddq[:, k]), atol=1e-9)
        np.testing.assert_allclose(matrix[:, :, k], matrix[:, :, k].T, atol=1e-12)


BUILT = [
    (),
    (Hidden("time_offset", "clock", {"offset_s": 0.0123}),),
    (Hidden("command_delay", "joint2", {"delay_s": 0.0071}),),
    (Hidden("command_filter", "joint2", {"time_constant_s": 0.03}),),
    (Hidden("servo_stiffness", "joint3", {"ratio": 0.7}),),
    (Hidden("servo_damping", "joint1", {"ratio": 1.6}),),
    (Hidden("torque_limit", "joint2", {"torque_Nm": 2.5}),),
    (Hidden("viscous_friction", "joint2", {"viscous_Nm_s_per_rad": 3.0}),),
    (Hidden("rotor_inertia", "joint3", {"inertia_kg_m2": 0.05}),),
    (Hidden("joint_spring", "joint3", {"stiffness_Nm_per_rad": 5.0, "rest_rad": 0.2}),),
    (Hidden("payload_error", "payload", {"mass_kg": 0.2}),),
    (Hidden("base_tilt", "base", {"tilt_x_rad": 0.1, "tilt_y_rad": -0.05}),),
    (Hidden("encoder_offset", "joint2", {"offset_rad": 0.02}),),
    (Hidden("link_mass", "link2", {"mass_kg": 0.3}),),
    (Hidden("link_com", "link3", {"x_m": 0.02, "y_m": -0.01, "z_m": 0.01}),),
]


def test_an_arm_follows_in_numpy_as_in_mujoco():
    setup = a_setup(sliding=True)
    commands = some_commands(setup.arm, 80)
    ours = roll(setup, BUILT, commands, hiding.STEP).readout
    for variant, hidden in zip(ours, BUILT, strict=True):
        theirs = mujoco_arm.follow(setup, hidden, commands)
        assert np.abs(variant - theirs).max() < CLOSE, hidden
        assert not hidden or np.abs(variant - ours[0]).max() > 10 * CLOSE, hidden
    assert {hidden[0].name for hidden in BUILT[1:]} == set(mujoco_arm.SIMULATED) - {"coulomb_friction"}


def test_dry_friction_is_that_of_mujoco_but_for_its_creep():
    setup = a_setup()
    commands = some_commands(setup.arm, 80)
    hidden = (Hidden("coulomb_friction", "joint2", {"coulomb_Nm": 1.0}),)
    ours = roll(setup, [hidden, ()], commands, hiding.STEP).readout
    theirs = mujoco_arm.follow(setup, hidden, commands)
    assert np.sqrt(np.mean((ours[0] - theirs) ** 2)) < FIRM
    assert np.abs(ours[0] - ours[1]).max() > 100 * FIRM


def test_what_mujoco_has_not_is_refused():
    setup = a_setup()
    with pytest.raises(ValueError, match="MuJoCo cannot be given backlash"):
        mujoco_arm.follow(setup, (Hidden("backlash", "joint1", {"half_width_rad": 1e-3}),), at_rest(setup.arm))


def test_half_the_step_changes_microradians():
    setup = a_setup()
    commands = some_commands(setup.arm, 40)
    steps = (physics.STEP, physics.STEP / 2)
    whole, half = (roll(setup, [()], commands, step).readout for step in steps)
    assert np.abs(whole - half).max() < 1e-5


def test_an_arm_at_rest_stays_where_friction_holds_it(monkeypatch):
    """Beside the weight: the servo's torque and gravity differ by no more than friction."""
    monkeypatch.setattr(physics, "LEAD", 1.0)
    setup = a_setup(payload=0.0)
    commands = at_rest(setup.arm, 10)
    q = roll(setup, [()], commands, hiding.STEP).readout[0, 0]
    assert np.ptp(q, axis=0).max() < 1e-9
    dynamics = Dynamics(Bodies.of(setup.arm, np.zeros(1), AT))
    _, weight = dynamics.terms(q[-1][:, None], 0 * q[-1][:, None], GRAVITY[:, None])
    left = setup.arm.joints.stiffness * (setup.arm.middle - q[-1]) - weight[:, 0]
    assert np.all(np.abs(left) <= setup.arm.joints.coulomb + 1e-6)
    assert np.abs(weight).max() > 0.5


def a_processed(commands, step=physics.STEP, **numbers):
    """What the first joint's servo sees, from the beginning of the run."""
    dof = commands.u.shape[2]
    n = {name: np.full((dof, 1), float(value)) for name, value in physics.START.items()}
    for name, value in numbers.items():
        n[name][:] = value
    wide = {name: n[name][0] for name in ("clock", "skipped")}
    samples = commands.u.shape[1]
    steps = (samples - 1) * round(commands.period / step) + 1
    columns, place = physics._processed(n, wide, commands, step, 0, steps)
    return columns[:, place[0, 0]]


def test_commands_are_late_filtered_limited_and_skipped():
    setup = a_setup()
    commands = some_commands(setup.arm, 60, kinds=("chirp",))
    every = round(commands.period / physics.STEP)
    plain = a_processed(commands)
    held = np.repeat(commands.u[0, :, 0], every)[: len(plain)]
    switches = np.arange(len(plain)) % every == 0
    np.testing.assert_allclose(plain[~switches], held[~switches], atol=1e-12)
    late = a_processed(commands, delay=5 * physics.STEP)
    np.testing.assert_allclose(late[5:], plain[:-5], atol=1e-12)
    # a low pass with a zero-order hold, at the middle of each step
    T = 0.03
    a = np.exp(-physics.STEP / T)
    low = lfilter([1 - a], [1, -a], plain - plain[0]) + plain[0]
    np.testing.assert_allclose(a_processed(commands, filter=T)[1:], low[:-1] + 0.5 * np.diff(low), atol=2e-5)
    limited = a_processed(commands, rate=0.3)
    assert np.abs(np.diff(limited)).max() <= 0.3 * physics.STEP + 1e-12
    assert np.abs(limited - plain).max() > 0.01
    fast = a_processed(commands, clock=0.01)
    assert fast[2000] == pytest.approx(np.interp(2020, np.arange(len(plain)), plain), abs=1e-6)
    lucky = replace(commands, luck=np.where(np.arange(60) == 40, 0.0, 1.0)[None])
    skipped = a_processed(lucky, skipped=0.5)
    changed = np.flatnonzero(np.abs(skipped - plain) > 1e-12)
    assert changed.min() >= 40 * every
    assert changed.max() <= 41 * every
    np.testing.assert_allclose(skipped[40 * every + 1], commands.u[0, 39, 0])


def test_encoders_show_play_scale_and_waves_of_the_true_position():
    setup = a_setup(sliding=True)
    commands = some_commands(setup.arm, 80)
    w, k, A, phase = 2e-3, 0.01, 3e-3, 0.7
    variants = [
        (),
        (Hidden("backlash", "joint2", {"half_width_rad": w}),),
        (Hidden("encoder_scale", "joint2", {"scale": k}),),
        (Hidden("encoder_eccentricity", "joint2", {"amplitude_rad": A, "phase_rad": phase}),),
    ]
    plain, play, scaled, wave = roll(setup, variants, commands, hiding.STEP).readout[:, 0, :, 1]
    assert np.abs(play - plain).max() == pytest.approx(w, rel=1e-6)
    moving = np.abs(np.gradient(plain)) > 1e-3
    assert np.mean(np.abs(np.abs(play - plain)[moving] - w) < 1e-9) > 0.6
    np.testing.assert_allclose(scaled, (1 + k) * plain, atol=1e-12)
    np.testing.assert_allclose(wave, plain + A * np.sin(plain + phase), atol=1e-12)


def an_effect(name, setup, commands, size, seed=0):
    view = View(setup, commands, 1e-4, False)
    return hiding._draw(name, np.random.default_rng(seed), view, hiding.asked(setup, commands))(size)


def test_every_effect_and_family_moves_the_arm_and_the_more_the_larger_it_is():
    setup = a_setup()
    commands = some_commands(setup.arm, 100)
    names = [*NAMED, *FAMILIES]
    ranges = {name: each.sizes for name, each in {**NAMED, **FAMILIES}.items()}
    sizes = {name: np.geomspace(*ranges[name], 5)[2:4] for name in names}
    variants = [(an_effect(name, setup, commands, size),) for name in names for size in sizes[name]]
    readout = roll(setup, [(), *variants], commands, hiding.STEP).readout
    moved = np.sqrt(np.mean((readout[1:] - readout[0]) ** 2, axis=(1, 2))).reshape(len(names), 2, -1)
    for name, (small, large) in zip(names, moved, strict=True):
        # what an integral part adds is the sag that it takes away, however fast it does
        least = 0.9 if name == "servo_integral" else 1.5
        assert np.linalg.norm(large) > least * np.linalg.norm(small) > 0, name
    one_joint = names.index("sticky_zone")
    at = variants[2 * one_joint][0].joint
    assert np.argmax(moved[one_joint, 1]) == at


def test_a_third_or_so_of_the_families_are_sealed_and_drawn_on_request_only():
    assert {*OPEN} | {*SEALED} == set(FAMILIES)
    assert not {*OPEN} & {*SEALED}
    wanted = plans.ROUNDS.indices(5, 3 * len(FAMILIES), "outside")
    for chosen, families in ((False, OPEN), (True, SEALED)):
        drawn = [plans.draw_plan(5, index, np.random.default_rng(0), chosen) for index in wanted]
        assert {plan.effects[0] for plan in drawn} == set(families)
        assert all(plan.sealed == chosen for plan in drawn)


@pytest.mark.parametrize("kind", MOTIONS)
def test_commands_keep_within_reach_and_begin_at_rest(kind):
    setup = a_setup("lite6")
    for seed in range(3):
        commands = some_commands(setup.arm, 800, seed, (kind,))
        u = commands.u[0]
        assert np.all(np.abs(u - setup.arm.middle) <= setup.arm.reach + 1e-6)
        assert np.ptp(u[:20], axis=0).max() < 1e-9
        assert np.ptp(u, axis=0).min() > 0.02
        if kind != "steps":
            assert np.abs(np.diff(u, axis=0)).max() / commands.period < 2.5


@pytest.mark.parametrize(
    "free", [pytest.param(False, id="declared"), pytest.param(True, id="unknown", marks=pytest.mark.long)]
)
def test_at_the_threshold_half_are_found(free):
    """A test that knows name and site, in noise: beside what stiffness and damping of a servo can do."""
    rng = np.random.default_rng(17)
    setup = a_setup()
    view = View(setup, some_commands(setup.arm, 80), 1e-4, free)
    plan = replace(plans.draw_plan(0, 0, rng), effects=("command_delay",), sizes=(1.0,))
    (effect,) = hiding.hide(plan, rng, view)
    (about,) = hiding.describe(view, (effect,), rivals=False)
    assert about["size"] == pytest.approx(1.0, rel=0.05)
    there, absent, *servos = view.whitened([(effect,), (), *view.servos((effect,))])
    span = np.stack([servo - there for servo in servos], 1) if free else np.zeros((len(there), 0))
    column = detection.project_out(span, (there - absent)[:, None])[:, 0]
    unit = column / np.linalg.norm(column)
    noise = rng.normal(size=(4000, len(unit)))
    explained = ((there - absent + noise) @ unit) ** 2
    assert np.mean(explained > chi2.isf(detection.ALARM / detection.SEARCHED, 1)) == pytest.approx(0.5, abs=0.04)
    assert (about["seen"] < 1 - 1e-6) == free


@pytest.mark.long
def test_bounds_are_what_a_fit_reaches():
    rng = np.random.default_rng(19)
    setup = a_setup()
    view = View(setup, some_commands(setup.arm, 80), 1e-4, False)
    hidden = (
        Hidden("coulomb_friction", "joint2", {"coulomb_Nm": 0.3}),
        Hidden("encoder_eccentricity", "joint2", {"amplitude_rad": 2e-3, "phase_rad": 1.0}),
    )
    about = hiding.describe(view, hidden, rivals=False)
    slopes = [own for k in (0, 1) for own in hiding._slopes(hidden, k)]
    shown = view.whitened([each for _, ahead, behind, _ in slopes for each in (ahead, behind)])
    J = np.stack([(shown[2 * k] - shown[2 * k + 1]) / own[3] for k, own in enumerate(slopes)], 1)
    off = np.linalg.lstsq(J, rng.normal(size=(len(J), 800)), rcond=None)[0]
    wanted = [bound for each in about for bound in each["bound"].values()]
    np.testing.assert_allclose(off.std(1), wanted, rtol=0.12)


@pytest.mark.long
def test_viscous_friction_is_what_comes_nearest_to_a_servos_damping():
    setup = a_setup()
    view = View(setup, some_commands(setup.arm, 100), 1e-4, False)
    (about,) = hiding.describe(view, (Hidden("servo_damping", "joint2", {"ratio": 1.05}),), rivals=True)
    assert (about["rival"]["name"], about["rival"]["site"]) == ("viscous_friction", "joint2")
    assert about["rival"]["apart"] < 0.05 * about["size"] * np.sqrt(detection.least_power(1))


@pytest.mark.parametrize("fault", plans.FAULTS)
def test_a_faulty_log_is_the_right_one_undone(fault):
    rng = np.random.default_rng(3)
    plan = replace(plans.draw_plan(0, 0, rng), fault=fault, rate=100.0)
    time = np.arange(400) * 0.01
    u = 0.5 * np.stack([np.sin(time * (1 + k) + k) for k in range(4)], 1)
    q = 0.99 * u
    run = np.repeat([0, 1], 200)
    log = next(filter(None, (faults.spoil(plan, np.random.default_rng(k), q, u, run) for k in range(30))))
    at = np.array(log.joints) - 1
    undone_q, undone_u = log.q.copy(), log.u.copy()
    match fault:
        case "joints_swapped":
            side = undone_q if not np.allclose(log.q, q) else undone_u
            side[:, at] = side[:, at[::-1]]
        case "joint_sign":
            side = undone_q if not np.allclose(log.q, q) else undone_u
            side[:, at] *= -1
        case "degrees":
            undone_q = np.deg2rad(log.q)
        case "gear":
            factor = np.ptp(log.q[:, at]) / np.ptp(q[:, at])
            assert factor in (pytest.approx(0.5), pytest.approx(2.0))
            undone_q[:, at] /= factor
        case "zero_per_run":
            off = log.q[200, at] - q[200, at]
            assert np.abs(off) >= 0.02
            undone_q[200:, at] -= off
        case "stale_rows":
            assert 4 <= len(log.rows) <= 40
            assert not {0, 200} & {*log.rows}
        case "saturated_readout":
            most = log.q[:, at].max()
            assert 0.05 < np.mean(log.q[:, at] == most) < 0.3
            undone_q = np.where(log.q == most, q, log.q)
        case "other_clock":
            late = next(n for n in range(1, 50) if np.allclose(log.u[60:200], u[60 - n : 200 - n]))
            assert late >= 15
            undone_u = u
        case "torque_off":
            (off,) = faults.before(plan, rng, u[None])
            assert off.values["ratio"] < 1e-3
    np.testing.assert_allclose(undone_q, q, atol=1e-12)
    np.testing.assert_allclose(undone_u, u, atol=1e-12)


def a_small_plan(monkeypatch, **fixed):
    """Trials of three joints and few rows, otherwise as drawn."""
    drawn = plans.draw_plan

    def small(seed, index, rng, sealed=False):
        plan = drawn(seed, index, rng, sealed)
        return replace(plan, arm="serial3", rate=100.0, samples=80, motions=("multisine",), unseen="chirp", **fixed)

    monkeypatch.setattr(trials, "draw_plan", small)


@pytest.mark.parametrize(
    "kind", ["clean", *(pytest.param(kind, marks=pytest.mark.long) for kind in ("single", "outside", "faulty"))]
)
def test_a_seed_gives_the_same_trial_of_about_the_planned_size(kind, monkeypatch, tmp_path):
    a_small_plan(monkeypatch)
    index = plans.ROUNDS.indices(1, 1, kind)[0]
    trial = trials.draw(1, index)
    if kind == "clean":
        assert trials.draw(1, index) == trial
    told = json.loads(json.dumps(trial.truth, allow_nan=False))
    assert told["rows"] == len(trial.files["recording.csv"].splitlines()) - 1
    given = " ".join(trial.files.values())
    assert not any(effect["effect"] in given for effect in trial.truth["hidden"])  # nothing tells
    assert set(trial.files) == {"arm.yaml", "recording.yaml", "recording.csv", "unseen.csv"}
    if kind in ("single", "outside") and trial.plan.engine == "plain":
        assert trial.truth["hidden"][0]["size"] == pytest.approx(trial.truth["sizes"][0], rel=0.2)
    write_files(trial.files, tmp_path)
    recording = read_recording(tmp_path / "recording.csv")
    assert recording.commanded_position.shape == recording.joint_position.shape == (told["rows"], 3)
    arm = read_description(tmp_path / "arm.yaml")
    rotors = [joint["rotor_inertia_kg_m2"] for joint in yaml.safe_load(trial.files["arm.yaml"])["dynamics"].values()]
    np.testing.assert_allclose(arm.rotor_inertia, rotors)
    assert arm.dof == 3
    assert np.all(arm.coulomb_friction > 0)


def test_drawing_a_trial_takes_nothing_of_the_library():
    """Nothing of it is loaded, and no module of the generator imports it anywhere."""
    said = "import json, sys; from benchmarks.tracking_trials import trials;"
    said += "loaded = {name: str(getattr(module, '__file__', '')) for name, module in sys.modules.items()};"
    said += "print(json.dumps(loaded))"
    run = subprocess.run([sys.executable, "-c", said], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = json.loads(run.stdout)
    ours = ("lite6jax", "jax", "tests")
    assert not [name for name in loaded if name.split(".")[0] in ours]
    generator = {name: path for name, path in loaded.items() if name.split(".")[0] == "benchmarks"}
    assert len(generator) > 10
    for name, path in generator.items():
        for node in ast.walk(ast.parse(Path(path).read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [each for each in names if each.split(".")[0] in ours], name
            assert not [each for each in names if each.startswith("benchmarks.") and each not in generator], name


def test_a_trial_is_exported_as_other_logs_are_scored(tmp_path, monkeypatch):
    a_small_plan(monkeypatch)
    index = plans.ROUNDS.indices(1, 1, "clean")[0]
    assert harness.main(["tracking", "--seed", "1", "--trial", str(index), "--export", str(tmp_path)]) == DONE
    (case,) = tmp_path.iterdir()
    names = {path.name for path in case.iterdir()}
    assert names == {"arm.yaml", "recording.csv", "recording.yaml", "truth.json", "unseen.csv", "unseen_truth.csv"}
    truth = json.loads((case / "truth.json").read_text())
    assert {"name", "effects", "unseen_limit_rad", "effect_rms_rad", "commanded_rms_rad"} <= set(truth)
