"""What is recorded: motions, what sensor and encoders read of them with noise and faults, and the files of it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from benchmarks.campaigns.columns import csv_text
from benchmarks.concealed.chain import (
    Array,
    Chain,
    description_text,
    factory_text,
    quaternion_from_rotation,
    rotation_from_vector,
)
from benchmarks.concealed.plain_physics import Curve, Motion, Setup
from benchmarks.concealed.plans import SENSORS, UNCERTAIN, Plan

UNSEEN_ROWS = 200
_TRACK_STEP, _REST_STEP = 0.05, 8.0
PAYLOAD_CENTER = (0.01, 0.0, 0.05)
JOINTS = (-3.0, 3.4)
"""rad, between which joints stay."""


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
        curve = _drawn_curve(rng, (lower + upper) / 2, (upper - lower) / 2)
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


def _drawn_curve(rng: np.random.Generator, middle: Array, reach: Array) -> Curve:
    dof = len(middle)
    rate = rng.uniform(0.15, 1.2, (3, dof))
    amplitude = rng.dirichlet([2, 2, 2], dof).T * rng.uniform(0.5, 0.95, dof) * reach
    phase = rng.uniform(-np.pi, np.pi, (3, dof))

    def curve(time: Array) -> tuple[Array, Array]:
        angle = rate * time[:, None, None] + phase
        return middle + np.sum(amplitude * np.sin(angle), 1), np.sum(amplitude * rate * np.cos(angle), 1)

    return curve


def measure(
    plan: Plan, rng: np.random.Generator, setup: Setup, motion: Motion, seen: tuple[Array, Array]
) -> tuple[tuple[Array, Array], Array, NDArray[np.bool_], list[int]]:
    """Poses and joints as they are read, which rows are no faults, and the rows (from 1) that are."""
    rows, dof = motion.q.shape
    noise = SENSORS[plan.sensor]
    draws = rng.normal(size=(rows, 6))
    if plan.noise == "correlated":
        rho = float(rng.choice([0.3, 0.6, 0.9]))
        for k in range(1, rows):
            draws[k] = rho * draws[k - 1] + np.sqrt(1 - rho**2) * draws[k]
    elif plan.noise == "half or twice":
        draws *= rng.choice([0.5, 2.0])
    elif plan.noise == "growing with reach":
        base = (seen[1] - setup.sensor[:3, 3]) @ setup.sensor[:3, :3]
        draws *= 1 + 2 * np.linalg.norm(base, axis=1, keepdims=True)
    q = motion.q.copy()
    if plan.noise == "in the joints":
        q += rng.normal(0, 5e-5, q.shape)
    position = seen[1] + noise[0] * draws[:, :3]
    rotation = seen[0] @ rotation_from_vector((noise[1] or 0.0) * draws[:, 3:])
    used, faulty = np.ones(rows, bool), []
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
    elif plan.fault == "frame_jump":
        first = int(rng.integers(rows // 3, 2 * rows // 3))
        position[first:] += rng.normal(0, 20 * noise[0], 3)
        used[first:] = False
    elif plan.fault == "unsettled_readouts":
        # the encoder is read while this share of the move is still to come
        q[1:] -= 1e-3 * np.diff(motion.q, axis=0)
    faulty = [int(k) + 1 for k in np.flatnonzero(~used)]
    return (rotation, position), q, used, faulty


def files_of(
    plan: Plan,
    nominal: Chain,
    declared: Chain,
    motion: Motion,
    measured: tuple[Array, Array],
    q: Array,
    noise: tuple[float, float | None],
    unseen: Motion,
) -> dict[str, str]:
    """What the diagnosis is given, and the motion that is to be predicted."""
    said: dict[str, Any] = {"pose_source": SENSORS[plan.sensor][2], "position_noise_m": noise[0]}
    said["payload_com_m"] = list(PAYLOAD_CENTER)
    if noise[1]:
        said["orientation_noise_rad"] = noise[1]
    columns = _columns(motion, q, plan.moving)
    columns.update(zip(("x_m", "y_m", "z_m"), measured[1].T, strict=True))
    if noise[1]:
        columns.update(zip(("qw", "qx", "qy", "qz"), quaternion_from_rotation(measured[0]).T, strict=True))
    order = np.arange(len(q))
    if plan.fault == "time_order":
        k = len(order) // 3
        order[k : k + 12] = order[k : k + 12][::-1]
    if plan.fault == "repeated_rows":
        again = np.random.default_rng([plan.seed, 9, plan.index]).choice(len(order), 8, replace=False)
        order = np.sort(np.concatenate([order, again]))
    return {
        **_declared(plan, nominal, declared, said),
        "recording.csv": csv_text({name: values[order] for name, values in columns.items()}),
        "unseen.csv": csv_text(_columns(unseen, unseen.q, plan.moving)),
    }


def files_of_readings(
    plan: Plan,
    nominal: Chain,
    declared: Chain,
    motion: Motion,
    readings: Mapping[str, Any],
    said: Mapping[str, Any],
    unseen: Motion,
) -> dict[str, str]:
    """As `files_of`, of columns of readings: as many for each sample of the motion."""
    (count,) = {len(column) // len(motion.q) for column in readings.values()}
    columns = {name: np.repeat(column, count) for name, column in _columns(motion, motion.q, False).items()}
    columns |= {name: column for name, column in readings.items() if name != "inside"}
    there = readings.get("inside", slice(None))
    return {
        **_declared(plan, nominal, declared, {**said, "payload_com_m": list(PAYLOAD_CENTER)}),
        "recording.csv": csv_text({name: column[there] for name, column in columns.items()}),
        "unseen.csv": csv_text(_columns(unseen, unseen.q, False)),
    }


def _declared(plan: Plan, nominal: Chain, declared: Chain, sensor: Mapping[str, Any]) -> dict[str, str]:
    """The sidecar, with what it says of the sensor, and the files that it names."""
    said: dict[str, Any] = {
        "arm": nominal.name if nominal.bundled else "arm.yaml",
        "joint_source": "measured",
        "pose_source": sensor["pose_source"],
        "motion": "trajectory" if plan.moving else "static",
        "pose_frame": "unknown" if plan.mounted else "base",
        "tool": "unknown" if plan.mounted else "none",
    } | dict(sensor)
    files: dict[str, str] = {}
    if plan.geometry != "unknown":
        said["factory_calibration"] = "factory.yaml"
        files["factory.yaml"] = factory_text(declared.rows)
    if plan.geometry == "uncertain":
        said["factory_uncertainty"] = {"position_m": UNCERTAIN, "rotation_rad": UNCERTAIN}
    if not nominal.bundled:
        files["arm.yaml"] = description_text(nominal)
    return files | {"recording.yaml": yaml.safe_dump({"recording": said}, sort_keys=False)}


def _columns(motion: Motion, q: Array, moving: bool) -> dict[str, Array]:
    joints = range(q.shape[1])
    columns = {"time_s": motion.time} | {f"q{i + 1}_rad": q[:, i] for i in joints}
    if moving:
        columns |= {f"dq{i + 1}_rad_per_s": motion.dq[:, i] for i in joints}
    columns |= {f"temp{i + 1}_degC": motion.temperature[:, i] for i in joints}
    return columns | {"payload_kg": motion.payload}
