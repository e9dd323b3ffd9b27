"""What is recorded of a motion: encoders and torque sensors with their noise and faults, and the files of it."""

from typing import Any

import numpy as np
import yaml

from benchmarks.campaigns.columns import csv_text
from benchmarks.concealed.chain import Array
from benchmarks.torque_trials.arms import Arm, arm_text
from benchmarks.torque_trials.faults import Spoiled
from benchmarks.torque_trials.motion import Motion
from benchmarks.torque_trials.physics import Setup
from benchmarks.torque_trials.plans import AUTOCORRELATION, Plan

_JOINT_NOISE, _VELOCITY_NOISE, _NOISY = 2e-5, 1e-3, 2e-2
"""rad, and rad/s as a rule and where velocities are noisy: one standard deviation."""
_OUTLIERS = 0.01
_DIGITS = 8
UNCERTAIN = 0.1
"""The relative uncertainty that some sidecars declare of the inertial numbers."""


def declared_arm(plan: Plan, rng: np.random.Generator, arm: Arm) -> Arm:
    """The arm as its description has it: its inertial numbers are right where they are declared, else off by chance."""
    if plan.inertial == "declared":
        return arm
    share = UNCERTAIN if plan.inertial == "uncertain" else 2 * UNCERTAIN
    dof = arm.chain.dof
    factor = 1 + share * np.clip(rng.normal(size=(2, dof)), -2.5, 2.5)
    shift = rng.normal(size=(dof, 3)) * share * np.linalg.norm(arm.chain.center, axis=1, keepdims=True)
    told = Arm(arm.chain, arm.inertia * factor[1][:, None, None], arm.noise)
    for i in range(dof):
        told = told.with_link(i + 1, mass=arm.chain.mass[i] * (factor[0, i] - 1), center=shift[i])
    return told


def measure(
    plan: Plan, rng: np.random.Generator, motion: Motion, exerted: Array, noise: Array
) -> tuple[Array, Array, Array]:
    """Joints, velocities and torques as they are read, with the noise of a plan."""
    shape = exerted.shape
    draws = rng.normal(size=shape)
    match plan.noise:
        case "autocorrelated":
            for k in range(1, len(draws)):
                draws[k] = AUTOCORRELATION * draws[k - 1] + np.sqrt(1 - AUTOCORRELATION**2) * draws[k]
        case "twice as declared":
            draws *= 2
        case "outliers":
            hit = rng.random(shape) < _OUTLIERS
            draws += hit * rng.choice([-1.0, 1.0], shape) * rng.uniform(8, 30, shape)
    quick = _NOISY if plan.noise == "noisy velocities" else _VELOCITY_NOISE
    return (
        motion.q + rng.normal(0, _JOINT_NOISE, shape),
        motion.dq + rng.normal(0, quick, shape),
        exerted + noise * draws,
    )


def files_of(
    plan: Plan, rng: np.random.Generator, setup: Setup, told: Arm, motion: Motion, read: Spoiled, unseen: Motion
) -> dict[str, str]:
    """What the diagnosis is given of an arm as it is told, and the motion that is to be predicted."""
    torque = read.torque
    said: dict[str, Any] = {
        "arm": "arm.yaml",
        "joint_source": "measured",
        "motion": "trajectory",
        "torque_source": "current" if plan.source == "current" else "measured",
        "joint_noise_rad": _JOINT_NOISE,
        "payload_com_m": [float(v) for v in setup.payload_center],
        "gravity_m_per_s2": [float(v) for v in read.gravity],
    }
    if rng.random() < 0.8:
        said["torque_noise_Nm"] = [float(v) for v in setup.arm.noise]
    if plan.inertial != "declared":
        said["inertial"] = UNCERTAIN if plan.inertial == "uncertain" else "unknown"
    if plan.fault == "estimated_torque":
        del said["torque_source"]
    columns = _columns(motion, read.q, read.dq, read.turns)
    joints = range(1, torque.shape[1] + 1)
    if plan.source == "current":
        constants = np.round(rng.uniform(2.0, 12.0, torque.shape[1]), 3)
        said["torque_constant_Nm_per_A"] = [float(v) for v in constants]
        columns |= {f"current{i}_A": torque[:, i - 1] / constants[i - 1] for i in joints}
    else:
        columns |= {f"tau{i}_Nm": torque[:, i - 1] for i in joints}
    return {
        "arm.yaml": arm_text(told),
        "recording.yaml": yaml.safe_dump({"recording": said}, sort_keys=False),
        "recording.csv": csv_text(columns, _DIGITS),
        "unseen.csv": csv_text(_columns(unseen, unseen.q, unseen.dq), _DIGITS),
    }


def _columns(motion: Motion, q: Array, dq: Array, turns: bool = False) -> dict[str, Array]:
    joints = range(1, q.shape[1] + 1)
    places = {f"q{i}_rad": q[:, i - 1] for i in joints}
    if turns:
        places = {f"q{i}_deg": np.rad2deg(np.mod(q[:, i - 1], 2 * np.pi)) for i in joints}
    columns = {"time_s": motion.time} | places
    columns |= {f"dq{i}_rad_per_s": dq[:, i - 1] for i in joints}
    columns |= {f"temp{i}_degC": motion.temperature[:, i - 1] for i in joints}
    return columns | {"payload_kg": motion.payload}
