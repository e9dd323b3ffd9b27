"""One trial: what is drawn from a seed and an index, what the diagnosis is given, and the truth that is sealed.

What is recorded are motions, and what sensor and encoders read of them with noise and faults.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from benchmarks.campaigns.rounds import Trial, csv_text, first_made, motion_columns
from benchmarks.concealed import chain as chains
from benchmarks.concealed import plans, readings
from benchmarks.concealed.chain import Array, Chain, Poses
from benchmarks.concealed.hiding import describe, hide
from benchmarks.concealed.mujoco_physics import Arm
from benchmarks.concealed.outside import FAMILIES
from benchmarks.concealed.outside.family import Curve
from benchmarks.concealed.plain_physics import Effects, Motion, Setup, poses
from benchmarks.concealed.plans import UNCERTAIN, Plan
from benchmarks.concealed.view import Open, View, oracle, transform

MASS_ERROR = 0.1  # one standard deviation of the masses' errors where they are off, relative; twice that is the most
UNSEEN_ROWS = 200
_TRACK_STEP, _REST_STEP = 0.05, 8.0
PAYLOAD_CENTER = (0.01, 0.0, 0.05)
JOINTS = (-3.0, 3.4)  # rad, between which joints stay


def draw(seed: int, index: int, sealed: bool = False) -> Trial:
    """The trial of an index: what is hidden is drawn again until some sensor there could see it.

    Where `sealed`, what is outside the catalogue is of the sealed families, and of no other.
    """
    return first_made(lambda rng: _make(plans.draw_plan(seed, index, rng, sealed), rng), seed, 0, index)


def draw_reading(sensor: str, seed: int, index: int, sealed: bool = False) -> Trial:
    """As `draw`, of a sensor that measures no poses, a key of `READERS`; these hide nothing outside the catalogue."""

    draw_plan = partial(plans.draw_reading_plan, sensor, seed, index)
    return first_made(lambda rng: _make_reading(draw_plan(rng), rng), seed, 12, index)


def draw_noise(noise: str, seed: int, index: int, sealed: bool = False) -> Trial:
    """As `draw`, of a healthy arm whose noise is hard, a key of `HARD_NOISES`; these hide nothing."""

    def make(rng: np.random.Generator) -> Trial | None:
        return _make(plans.draw_noise_plan(noise, seed, index, rng), rng)

    return first_made(make, seed, plans.HARD_NOISES[noise], index)


def _make_reading(plan: Plan, rng: np.random.Generator) -> Trial | None:
    """The trial of a plan; None where the arm does not come to the places, or what it would hide cannot be seen."""
    nominal, actual, declared = _arms(plan, rng)
    scene = readings.draw_scene(plan.sensor, rng, actual, plan.rows)
    tool = transform(rng.uniform(-0.5, 0.5, 3), np.array([0.03, -0.01, 0.08]) + rng.uniform(-0.01, 0.01, 3))
    setup, frame = Setup(actual, scene.sensor, tool, np.array(PAYLOAD_CENTER)), scene.turned
    touched = plan.geometry == "unknown" and not frame
    loose, encoders = (plans.TOUCHED, plans.ENCODERS) if touched else (plans.LOOSE, 0.0)
    prior = {"uncertain": (UNCERTAIN, UNCERTAIN), "unknown": loose}.get(plan.geometry)
    left_open = Open(frame, 6 if frame else 3, plan.geometry != "known", prior, encoders)
    warming = "link_thermal_expansion" in plan.effects or rng.random() < 0.3
    loading = rng.random() < 0.4
    starts = draw_motion(rng, actual, False, len(scene.group), warming, loading)
    bounds = np.clip(actual.limits, *JOINTS)
    which: NDArray[np.integer] | None = np.arange(plan.rows)
    if scene.wanted is not None:
        came, reached = readings.led(setup, (), starts, scene, scene.wanted, bounds)
        starts, which = readings.at_rest(starts, came.q), readings.chosen(scene, reached, plan.rows)
    if which is None:
        return None
    motion = readings.at_rest(draw_motion(rng, actual, False, plan.rows, warming, loading), starts.q[which])
    group = scene.group[which]
    noise = (scene.noise_m, scene.noise_m if frame else None)
    view = View(setup, left_open, motion, noise, scene.reading(group))

    hidden = hide(plan, rng, view)
    if hidden is None:
        return None
    if scene.wanted is not None:
        motion, reached = readings.led(setup, hidden, motion, scene, scene.wanted[which], bounds)
        if not reached.all():
            return None
        view = replace(view, motion=motion)
    seen, unseen = poses(setup, hidden, motion), draw_motion(rng, actual, False, UNSEEN_ROWS, warming, loading)
    truth = _truth(plan, view, hidden, seen, poses(setup, hidden, unseen))
    said = {**scene.said, "payload_com_m": list(PAYLOAD_CENTER)}
    read = Measured(motion.q, scene.columns(seen, group), said, np.ones(plan.rows, bool))
    return Trial(plan, truth, files_of(plan, nominal, declared, motion, read, unseen))


def _make(plan: Plan, rng: np.random.Generator) -> Trial | None:
    """The trial of a plan; None where what it would hide cannot be seen there, or only when huge."""
    nominal, actual, declared = _arms(plan, rng)
    sensor, tool = np.eye(4), np.eye(4)
    if plan.mounted:
        sensor = transform(rng.uniform(-np.pi, np.pi, 3), rng.uniform(-2, 2, 3))
        tool = transform(rng.uniform(-0.5, 0.5, 3), np.array([0.02, -0.01, 0.06]) + rng.uniform(-0.02, 0.02, 3))
    setup = Setup(actual, sensor, tool, np.array(PAYLOAD_CENTER))
    noise = plans.SENSORS[plan.sensor][:2]
    prior = {"uncertain": (UNCERTAIN, UNCERTAIN), "unknown": plans.LOOSE}.get(plan.geometry)
    left_open = Open(plan.mounted, plan.mounted * (6 if noise[1] else 3), plan.geometry != "known", prior)
    warm = any(name in FAMILIES and "temperature" in FAMILIES[name].on for name in plan.effects)
    warming = "link_thermal_expansion" in plan.effects or warm or rng.random() < 0.3
    carried = any(name in FAMILIES and FAMILIES[name].is_carried for name in plan.effects)
    loading = "payload_error" in plan.effects or carried or rng.random() < 0.4
    fixed_load, wandering = plan.engine == "mujoco", plan.kind in plans.NAMES_AT_STAKE
    motion = draw_motion(rng, actual, plan.moving, plan.rows, warming, loading, fixed_load, wandering)
    unseen = draw_motion(rng, actual, plan.moving, UNSEEN_ROWS, warming, loading, fixed_load, wandering)
    view = View(setup, left_open, motion, noise)  # type: ignore[arg-type]

    hidden = hide(plan, rng, view)
    if hidden is None:
        return None
    if plan.engine == "mujoco":
        body = Arm(setup, hidden, float(motion.payload[0]))
        shown, later = (body.moving(m) if plan.moving else body.at_rest(m) for m in (motion, unseen))
        motion, unseen = shown.motion, later.motion
        seen, unseen_truth = (shown.rotation, shown.position), (later.rotation, later.position)
        view = replace(view, motion=motion)
    else:
        seen, unseen_truth = poses(setup, hidden, motion), poses(setup, hidden, unseen)

    measured, read = measure(plan, rng, setup, motion, seen)
    # the oracle knows of faults, and of a file that is another arm's; of noise it does not
    noisy_joints = plan.noise in ("in the joints", "wandering")
    known = replace(view, motion=replace(motion, q=read.q)) if noisy_joints else view
    believed = setup if plan.fault == "nominal_table" else replace(setup, chain=declared)
    rotation, position = poses(*oracle(known, believed, hidden, measured, read.used), unseen)
    turn = chains.vector_from_rotation(np.swapaxes(unseen_truth[0], 1, 2) @ rotation)
    fitted = {
        "unseen_position_rms_m": float(np.sqrt(np.mean(np.sum((position - unseen_truth[1]) ** 2, 1)))),
        "unseen_rotation_rms_rad": float(np.sqrt(np.mean(np.sum(turn**2, 1)))),
        "estimated_numbers": left_open.size(actual.dof) + sum(len(effect.values) for effect in hidden),
    }
    faulty = [int(k) + 1 for k in np.flatnonzero(~read.used)]
    truth = _truth(plan, view, hidden, seen, unseen_truth, faulty, oracle=fitted)
    if plan.masses_off:
        truth["mass_errors"] = (actual.mass / nominal.mass - 1).tolist()
    return Trial(plan, truth, files_of(plan, nominal, declared, motion, read, unseen))


def _truth(
    plan: Plan, view: View, hidden: Effects, seen: Poses, unseen: Poses, faulty: Sequence[int] = (), **more: Any
) -> dict[str, Any]:
    """What is sealed of poses that were seen, and of those of the unseen motion."""
    moved = seen[1] - poses(view.setup, (), view.motion)[1]
    return {
        "schema": "concealed/truth/1",
        **plan.told(),
        "hidden": describe(view, hidden),
        "fault_rows": list(faulty),
        "moved_rms_m": float(np.sqrt(np.mean(np.sum(moved**2, 1)))),
        "noise_m": view.noise[0],
        "noise_rad": view.noise[1],
        **more,
        "unseen_position_m": unseen[1].tolist(),
        "unseen_quaternion": chains.quaternion_from_rotation(unseen[0]).tolist(),
    }


def _arms(plan: Plan, rng: np.random.Generator) -> tuple[Chain, Chain, Chain]:
    """The arm as it is designed, as it is, and as the sidecar says that it is; but for masses, which nobody says."""
    nominal = {"lite6": chains.lite6, "seven": chains.seven, "six": lambda: chains.draw_six(rng)}[plan.arm]()
    if plan.fault == "nominal_table":
        return nominal, chains.lite6_ros(), nominal
    actual = nominal.moved(rng, *chains.MADE)
    if plan.masses_off:
        errors = np.clip(rng.normal(0, MASS_ERROR, nominal.dof), -2 * MASS_ERROR, 2 * MASS_ERROR)
        actual = replace(actual, mass=nominal.mass * (1 + errors))
    if plan.geometry == "unknown":
        return nominal, actual, replace(nominal, mass=actual.mass)
    off = UNCERTAIN if plan.geometry == "uncertain" else plans.OFF if plan.noise == "factory file off" else 0.0
    return nominal, actual, actual.moved(rng, off, off)


# ------------------------------------------------------------------ what is recorded


def draw_motion(
    rng: np.random.Generator,
    chain: Chain,
    moving: bool,
    rows: int,
    warming: bool = False,
    loading: bool = False,
    fixed_load: bool = False,
    wandering: bool = False,
) -> Motion:
    """Poses over the joints' range, or a trajectory of three sines a joint; temperatures; a payload on and off.

    Temperatures that are `wandering` rise and fall as well: what depends on them is then no function of time.
    """
    dof = chain.dof
    lower, upper = np.clip(chain.limits, *JOINTS).T
    curve: Curve | None = None
    if moving:
        curve = _draw_curve(rng, (lower + upper) / 2, (upper - lower) / 2)
        time = np.arange(rows) * _TRACK_STEP
        q, dq = curve(time)
        direction = np.sign(dq)
    else:
        time = np.arange(rows) * _REST_STEP
        q = rng.uniform(lower, upper, (rows, dof))
        dq = np.zeros((rows, dof))
        direction = np.concatenate([np.zeros((1, dof)), np.sign(np.diff(q, axis=0))])
    temperature = 25 + rng.normal(0, 0.05, (rows, dof))
    if warming:
        length = time[-1] + 1
        grown = rng.uniform(8, 20) * (1 - np.exp(-3 * time / length))
        temperature += grown[:, None]
        if wandering:
            turns, phase = rng.uniform(1.5, 3.0), rng.uniform(-np.pi, np.pi)
            waves = np.sin(2 * np.pi * turns * time / length + phase) - np.sin(phase)
            temperature += rng.uniform(3, 6) * waves[:, None] * rng.uniform(0.8, 1.2, dof)
    payload = np.zeros(rows)
    if loading:
        payload[:] = 0.5
        if not fixed_load:
            payload[(np.arange(rows) // 50) % 2 == 0] = 0
    return Motion(q, dq, direction, time, temperature, payload, curve)


def _draw_curve(rng: np.random.Generator, middle: Array, reach: Array) -> Curve:
    dof = len(middle)
    rate = rng.uniform(0.15, 1.2, (3, dof))
    amplitude = rng.dirichlet([2, 2, 2], dof).T * rng.uniform(0.5, 0.95, dof) * reach
    phase = rng.uniform(-np.pi, np.pi, (3, dof))

    def curve(time: Array) -> tuple[Array, Array]:
        angle = rate * time[:, None, None] + phase
        return middle + np.sum(amplitude * np.sin(angle), 1), np.sum(amplitude * rate * np.cos(angle), 1)

    return curve


class Measured(NamedTuple):
    """What is read of a motion."""

    q: Array  # `(sample, joint)` rad
    columns: Mapping[str, Any]  # of as many rows for each sample; `inside` is which rows there are
    said: Mapping[str, Any]  # what the sidecar says of the sensor
    used: NDArray[np.bool_]  # `(sample,)`, those that are no faults


_SILENT_JOINTS = (np.deg2rad(-1000.0), np.deg2rad(-1.0), -1.0, 0.0)
"""rad, what all joints hold where a bus did not answer."""
_LOST_TARGETS = (0.0, -1e-3, -1.0)
"""m, what all coordinates hold where a sensor saw nothing."""


def autoregression(draws: Array, coefficient: float) -> Array:
    """Stationary noise of first order and standard deviation 1, of independent draws `(row, number)` of the same."""
    states = draws.copy()
    for k in range(1, len(draws)):
        states[k] = coefficient * states[k - 1] + np.sqrt(1 - coefficient**2) * draws[k]
    return states


def measure(plan: Plan, rng: np.random.Generator, setup: Setup, motion: Motion, seen: Poses) -> tuple[Poses, Measured]:
    """Poses and what a table has of them, with the noise and the fault of a plan."""
    rows, dof = motion.q.shape
    noise = plans.SENSORS[plan.sensor]
    draws = rng.normal(size=(rows, 6))
    if plan.noise == "correlated":
        draws = autoregression(draws, float(rng.choice([0.3, 0.6, 0.9])))
    elif plan.noise == "autocorrelated":
        draws = autoregression(draws, 1 - 1 / plan.noise_memory)
    elif plan.noise == "heavy_tails":
        student = rng.standard_t(plans.FREEDOM, draws.shape)
        draws = plan.over_declared / plans.TAILS[-1] * student
    elif plan.noise == "half or twice":
        draws *= rng.choice([0.5, 2.0])
    elif plan.noise == "growing with reach":
        base = (seen[1] - setup.sensor[:3, 3]) @ setup.sensor[:3, :3]
        draws *= 1 + 2 * np.linalg.norm(base, axis=1, keepdims=True)
    q = motion.q.copy()
    if plan.noise == "in the joints":
        q += rng.normal(0, 5e-5, q.shape)
    elif plan.noise == "wandering":
        wander = autoregression(rng.normal(size=q.shape), 1 - 1 / plan.noise_memory)
        q += plan.encoder_std * wander
    position = seen[1] + noise[0] * draws[:, :3]
    rotation = seen[0] @ chains.rotation_from_vector((noise[1] or 0.0) * draws[:, 3:])
    used = np.ones(rows, bool)
    if plan.fault.startswith("outliers"):
        used[rng.choice(rows, rows // 30, replace=False)] = False
        push = rng.normal(size=(rows, 3))
        push *= (rng.uniform(1e-3, 1e-2, rows) / np.linalg.norm(push, axis=1))[:, None]
        position = np.where(used[:, None], position, position + push)
    elif plan.fault == "repeated_rows":
        again = np.sort(rng.choice(np.arange(1, rows), 8, replace=False))
        used[again] = False
    elif plan.fault == "swapped_joints":
        a = int(rng.integers(0, dof - 1))
        q[:, [a, a + 1]] = q[:, [a + 1, a]]
    elif plan.fault == "mirrored_joint":
        q[:, int(rng.integers(0, dof))] *= -1
    elif plan.fault == "placeholder":
        used[rng.choice(rows, rows // 40, replace=False)] = False
        if rng.random() < 0.5:
            q[~used] = rng.choice(_SILENT_JOINTS)
        else:
            position[~used] = rng.choice(_LOST_TARGETS)
    elif plan.fault == "frame_jump":
        first = int(rng.integers(rows // 3, 2 * rows // 3))
        position[first:] += rng.normal(0, 20 * noise[0], 3)
        used[first:] = False
    elif plan.fault == "joint_turns":
        # neither the first nor the last, whose zeros an unknown frame and tool take up
        lost = np.deg2rad(rng.uniform(3, 30)) * rng.choice([-1.0, 1.0])
        q[:, int(rng.integers(1, dof - 1))] -= lost
    elif plan.fault == "unsettled_readouts":
        # the encoder is read while this share of the move is still to come
        q[1:] -= 1e-3 * np.diff(motion.q, axis=0)
    # of a marker that is smaller or larger than declared
    read = position * (rng.uniform(1.03, 1.25) ** rng.choice([-1.0, 1.0]) if plan.fault == "sensor_scale" else 1.0)
    columns: dict[str, Array] = dict(zip(("x_m", "y_m", "z_m"), read.T, strict=True))
    said: dict[str, Any] = {"pose_source": noise[2], "position_noise_m": noise[0]}
    said["payload_com_m"] = list(PAYLOAD_CENTER)
    if noise[1]:
        said["orientation_noise_rad"] = noise[1]
        columns.update(zip(("qw", "qx", "qy", "qz"), chains.quaternion_from_rotation(rotation).T, strict=True))
    return (rotation, position), Measured(q, columns, said, used)


def files_of(
    plan: Plan, nominal: Chain, declared: Chain, motion: Motion, read: Measured, unseen: Motion
) -> dict[str, str]:
    """What the diagnosis is given, and the unseen motion, which is to be predicted.

    Of the arm as it is designed, and as the sidecar says that it is.
    """
    said = {
        "arm": nominal.name if nominal.bundled else "arm.yaml",
        "joint_source": "measured",
        "pose_source": read.said["pose_source"],
        "motion": "trajectory" if plan.moving else "static",
        "pose_frame": "unknown" if plan.mounted else "base",
        "tool": "unknown" if plan.mounted else "none",
    } | dict(read.said)
    files = {} if nominal.bundled else {"arm.yaml": chains.description_text(nominal)}
    if plan.geometry != "unknown":
        said["factory_calibration"] = "factory.yaml"
        files["factory.yaml"] = chains.factory_text(declared.rows)
    if plan.geometry == "uncertain":
        said["factory_uncertainty"] = {"position_m": UNCERTAIN, "rotation_rad": UNCERTAIN}
    (count,) = {len(column) // len(read.q) for column in read.columns.values()}
    moved = motion_columns(motion, read.q, motion.dq if plan.moving else None)
    columns = {name: np.repeat(column, count) for name, column in moved.items()}
    columns |= {name: column for name, column in read.columns.items() if name != "inside"}
    rows = read.columns.get("inside", np.arange(len(read.q) * count))
    if plan.fault == "time_order":
        k = len(rows) // 3
        rows[k : k + 12] = rows[k : k + 12][::-1]
    if plan.fault == "repeated_rows":
        rows = np.sort(np.concatenate([rows, np.flatnonzero(~read.used)]))
    return files | {
        "recording.yaml": yaml.safe_dump({"recording": said}, sort_keys=False),
        "recording.csv": csv_text({name: column[rows] for name, column in columns.items()}),
        "unseen.csv": csv_text(motion_columns(unseen, unseen.q, unseen.dq if plan.moving else None)),
    }
