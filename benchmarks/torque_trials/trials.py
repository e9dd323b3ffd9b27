"""One trial: what is drawn from a seed and an index, what the diagnosis is given, and the truth that is sealed."""

from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.campaigns.rounds import Trial, first_made
from benchmarks.concealed.chain import Array, rotation_from_vector
from benchmarks.torque_trials.arms import drawn_arm
from benchmarks.torque_trials.faults import described_arm, friction, spoil
from benchmarks.torque_trials.hiding import described, hide, usual
from benchmarks.torque_trials.information import View, unseen_error
from benchmarks.torque_trials.motion import Motion, draw_motion
from benchmarks.torque_trials.mujoco_arm import SimulatedArm
from benchmarks.torque_trials.outside import FAMILIES
from benchmarks.torque_trials.physics import Setup, torques
from benchmarks.torque_trials.plans import AUTOCORRELATION, DATA_FAULTS, Plan, draw_plan, warms
from benchmarks.torque_trials.recorded import UNCERTAIN, declared_arm, files_of, measure

UNSEEN_SECONDS = 10.0
PAYLOAD_CENTER = (0.0, 0.0, 0.03)
_GRAVITY = np.array([0.0, 0.0, -9.81])
_SLOW = 0.1
"""Times the usual frequencies."""
_BOUND, _LEAST_BOUND = 3.0, 4e-3
"""An unseen error is to be within so many times what an efficient fit reaches, but no less than so many Nm."""
_OUTSIDE_BOUND = 0.25
"""Of what an effect outside the catalogue adds."""


def draw(seed: int, index: int, sealed: bool = False) -> Trial:
    """The trial of an index: what is hidden is drawn again until some sensor there could see it.

    Where `sealed`, what is outside the catalogue is of the sealed families, and of no other.
    """
    return first_made(lambda rng: _make(draw_plan(seed, index, rng, sealed), rng), seed, 20, index)


def _make(plan: Plan, rng: np.random.Generator) -> Trial | None:
    """The trial of a plan; None where what it would hide cannot be seen there, or only when huge."""
    arm = drawn_arm(plan.arm, rng)
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

    told = described_arm(rng, arm) if spoilt else declared_arm(plan, rng, arm)
    read = spoil(plan, rng, setup, motion, measure(plan, rng, motion, exerted, arm.noise))
    if read is None:
        return None
    added = later - torques(setup, (), unseen)
    truth = {
        "schema": "torque/truth/1",
        **asdict(plan),
        "rows": len(read.q),
        "hidden": usual(view, hidden) if spoilt else described(view, hidden),
        "fault_rows": read.rows,
        "fault_joints": read.joints,
        "fault_numbers": read.numbers,
        "noise_Nm": arm.noise.tolist(),
        "exerted_rms_Nm": _rms(exerted),
        "unseen_effect_rms_Nm": _rms(added),
        "unseen_bound_Nm": _unseen_bound(view, () if spoilt else hidden, unseen, added),
        "unseen_torque_Nm": np.round(later, 9).tolist(),
    }
    return Trial(plan, truth, files_of(plan, rng, setup, told, motion, read, unseen))


def _unseen_bound(view: View, hidden: tuple[Any, ...], unseen: Motion, added: Array) -> float:
    """Nm RMS over all joints within which the torques of the unseen motion are to be predicted."""
    if any(effect.name in FAMILIES for effect in hidden):
        known = unseen_error(view, (), unseen)
        return max(_OUTSIDE_BOUND * _rms(added), _BOUND * known, _LEAST_BOUND)
    return max(_BOUND * unseen_error(view, hidden, unseen), _LEAST_BOUND)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
