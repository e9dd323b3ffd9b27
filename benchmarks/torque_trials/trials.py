"""One trial: what is drawn from a seed and an index, what the diagnosis is given, and the truth that is sealed."""

from dataclasses import asdict
from typing import Any

import numpy as np
import yaml

from benchmarks.campaigns.rounds import Trial, csv_text, first_made, motion_columns
from benchmarks.concealed.chain import Array, rotation_from_vector
from benchmarks.torque_trials.effects import FAMILIES
from benchmarks.torque_trials.faults import Spoiled, describe_arm, friction, spoil
from benchmarks.torque_trials.hiding import View, describe, hide, unseen_error, usual
from benchmarks.torque_trials.mujoco_arm import SimulatedArm
from benchmarks.torque_trials.physics import Arm, Motion, Setup, arm_text, draw_arm, draw_motion, torques
from benchmarks.torque_trials.plans import AUTOCORRELATION, DATA_FAULTS, Plan, draw_plan, warms

UNSEEN_SECONDS = 10.0
PAYLOAD_CENTER = (0.0, 0.0, 0.03)
_GRAVITY = np.array([0.0, 0.0, -9.81])
_SLOW = 0.1  # times the usual frequencies
_BOUND, _LEAST_BOUND = 3.0, 4e-3
"""An unseen error is to be within so many times what an efficient fit reaches, but no less than so many Nm."""
_OUTSIDE_BOUND = 0.25  # of what an effect outside the catalogue adds
_JOINT_NOISE, _VELOCITY_NOISE, _NOISY = 2e-5, 1e-3, 2e-2
"""rad, and rad/s as a rule and where velocities are noisy: one standard deviation."""
_OUTLIERS = 0.01
_DIGITS = 8
UNCERTAIN = 0.1  # the relative uncertainty that some sidecars declare of the inertial numbers


def draw(seed: int, index: int, sealed: bool = False) -> Trial:
    """The trial of an index: what is hidden is drawn again until some sensor there could see it.

    Where `sealed`, what is outside the catalogue is of the sealed families, and of no other.
    """
    return first_made(lambda rng: _make(draw_plan(seed, index, rng, sealed), rng), seed, 20, index)


def _make(plan: Plan, rng: np.random.Generator) -> Trial | None:
    """The trial of a plan; None where what it would hide cannot be seen there, or only when huge."""
    arm = draw_arm(plan.arm, rng)
    gravity = _GRAVITY
    if rng.random() < 0.2:
        # the arm hangs on a wall, or from the ceiling
        gravity = rotation_from_vector(rng.uniform(-np.pi, np.pi, 3) * [1, 1, 0]) @ gravity
    setup = Setup(arm, gravity, np.array(PAYLOAD_CENTER))
    payload = float(rng.uniform(0.3, 1.0)) if rng.random() < 0.3 else 0.0
    moves = {
        "speed": _SLOW if plan.edge == "slow" else 1.0,
        "warming": warms(plan.effects) or rng.random() < 0.3,
        "payload": payload,
        "resting": 3 if plan.edge == "resting joints" or plan.fault == "velocity_bias" else 0,
    }
    motion = draw_motion(rng, arm, plan.rate, plan.seconds, **moves)
    unseen = draw_motion(rng, arm, plan.rate, UNSEEN_SECONDS, **moves)

    remembered = AUTOCORRELATION if plan.noise == "autocorrelated" else 0.0
    worth = arm.noise * np.sqrt((1 + remembered) / (1 - remembered))
    inertial = {"declared": 0.0, "uncertain": UNCERTAIN, "unknown": np.inf}[plan.inertial]
    view = View.of(setup, motion, worth, inertial)
    spoilt = plan.fault in DATA_FAULTS
    hidden = friction(rng, setup, motion) if spoilt else hide(plan, rng, view)
    if hidden is None:
        return None
    if plan.engine == "mujoco":
        body = SimulatedArm(setup, hidden, payload)
        (motion, exerted), (unseen, later) = body.driven(motion), body.driven(unseen)
        view = View.of(setup, motion, worth, inertial)
    else:
        exerted, later = torques(setup, hidden, motion), torques(setup, hidden, unseen)

    told = describe_arm(rng, arm) if spoilt else declare_arm(plan, rng, arm)
    read = spoil(plan, rng, setup, motion, measure(plan, rng, motion, exerted, arm.noise))
    if read is None:
        return None
    added = later - torques(setup, (), unseen)
    outside = any(effect.name in FAMILIES for effect in hidden)
    known = unseen_error(view, () if spoilt or outside else hidden, unseen)
    bound = max(_BOUND * known, _LEAST_BOUND, _OUTSIDE_BOUND * _rms(added) if outside else 0.0)
    truth = {
        "schema": "torque/truth/1",
        **asdict(plan),
        "rows": len(read.q),
        "hidden": usual(view, hidden) if spoilt else describe(view, hidden),
        "fault_rows": read.rows,
        "fault_joints": read.joints,
        "fault_numbers": read.numbers,
        "noise_Nm": arm.noise.tolist(),
        "exerted_rms_Nm": _rms(exerted),
        "unseen_effect_rms_Nm": _rms(added),
        "unseen_bound_Nm": bound,
        "unseen_torque_Nm": np.round(later, 9).tolist(),
    }
    return Trial(plan, truth, files_of(plan, rng, setup, told, motion, read, unseen))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def declare_arm(plan: Plan, rng: np.random.Generator, arm: Arm) -> Arm:
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
    q, dq = motion.q + rng.normal(0, _JOINT_NOISE, shape), motion.dq + rng.normal(0, quick, shape)
    return q, dq, exerted + noise * draws


def files_of(
    plan: Plan, rng: np.random.Generator, setup: Setup, told: Arm, motion: Motion, read: Spoiled, unseen: Motion
) -> dict[str, str]:
    """The files of a diagnosis of an arm with this description, and of the motion that is to be predicted."""
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
    columns = motion_columns(motion, read.q, read.dq, read.turns)
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
        "unseen.csv": csv_text(motion_columns(unseen, unseen.q, unseen.dq), _DIGITS),
    }
