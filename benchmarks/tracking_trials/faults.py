"""What is wrong with a faulty log: columns, signs, units, gears, zeros, rows, ranges, motors, clocks.

Shares no code with the library. The sample comes first.
"""

from typing import NamedTuple

import numpy as np

from benchmarks.concealed.chain import Array
from benchmarks.tracking_trials.effects import Hidden
from benchmarks.tracking_trials.plans import Plan

_MOVING = 0.05  # rad, the range of a joint that counts as moving
_STALE = 0.04  # of the rows
_SATURATED = (75, 90)  # per cent of the rows that a read-out shows as they are
_OFF = 1e-6  # of its stiffness that a servo has whose torque is off
_OTHER_CLOCK = (0.15, 0.4)  # s by which the commands are stamped late


class Log(NamedTuple):
    """What is written."""

    q: Array  # `(sample, joint)` rad, or whatever it is
    u: Array  # `(sample, joint)` rad
    joints: list[int]  # that a fault concerns, counted from 1
    rows: list[int]  # likewise, from 0; these repeat the row before, with its noise


def before(plan: Plan, rng: np.random.Generator, u: Array) -> tuple[Hidden, ...]:
    """What is wrong with the arm, and not with the file: a motor whose torque is off.

    Args:
        plan: of the trial.
        rng: of it.
        u: `(run, sample, joint)` rad, what is commanded.
    """
    if plan.fault != "torque_off":
        return ()
    moving = np.flatnonzero(np.ptp(u, axis=(0, 1)) > _MOVING)
    return (Hidden("servo_stiffness", f"joint{int(rng.choice(moving)) + 1}", {"ratio": _OFF}),)


def spoil(plan: Plan, rng: np.random.Generator, q: Array, u: Array, run: Array) -> Log | None:
    """What is written of read-outs and commands `(sample, joint)` in runs `(sample,)`; None where nobody could tell."""
    right = Log(q, u, [], [])
    moving = np.flatnonzero((np.ptp(u, axis=0) > _MOVING) & (np.ptp(q, axis=0) > _MOVING))
    if not plan.fault:
        return right
    if len(moving) < 2:
        return None
    joint = int(rng.choice(moving))
    here = np.arange(q.shape[1]) == joint
    match plan.fault:
        case "joints_swapped":
            two = np.sort(rng.choice(moving, 2, replace=False))
            order = np.arange(q.shape[1])
            order[two] = two[::-1]
            follows = abs(np.corrcoef(u[:, two[0]], q[:, two[1]])[0, 1])
            swapped = {"q": q[:, order]} if rng.random() < 0.5 else {"u": u[:, order]}
            numbers = [int(each) + 1 for each in two]
            return right._replace(joints=numbers, **swapped) if follows < 0.4 else None
        case "joint_sign":
            sign = np.where(here, -1.0, 1.0)
            turned = {"q": q * sign} if rng.random() < 0.5 else {"u": u * sign}
            return right._replace(joints=[joint + 1], **turned)
        case "degrees":
            return right._replace(q=np.rad2deg(q), joints=[*range(1, q.shape[1] + 1)])
        case "gear":
            factor = float(rng.choice([0.5, 2.0]))
            return right._replace(q=q * np.where(here, factor, 1.0), joints=[joint + 1])
        case "zero_per_run":
            zeros = rng.uniform(0.02, 0.2, int(run.max()) + 1) * rng.choice([-1.0, 1.0], int(run.max()) + 1)
            zeros[0] = 0.0
            return right._replace(q=q + zeros[run.astype(int)][:, None] * here, joints=[joint + 1])
        case "stale_rows":
            stale = np.flatnonzero(rng.random(len(q)) < _STALE)
            stale = stale[(stale > 0) & (run[stale] == run[np.maximum(stale - 1, 0)])]
            return right._replace(rows=[int(row) for row in stale])
        case "saturated_readout":
            most = float(np.percentile(q[:, joint], rng.uniform(*_SATURATED)))
            return right._replace(q=np.where(here, np.minimum(q, most), q), joints=[joint + 1])
        case "other_clock":
            late = round(float(rng.uniform(*_OTHER_CLOCK)) * plan.rate)
            begins = np.maximum.accumulate(np.where(np.diff(run, prepend=-1) != 0, np.arange(len(run)), 0))
            return right._replace(u=u[np.maximum(np.arange(len(u)) - late, begins)])
    return right
