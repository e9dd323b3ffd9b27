"""One trial: what is drawn from a seed and an index, what the diagnosis is given, and the truth that is sealed."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import yaml

from benchmarks.campaigns.rounds import Trial, csv_text, first_made
from benchmarks.concealed.chain import Array
from benchmarks.tracking_trials import mujoco_arm
from benchmarks.tracking_trials.arms import GRAVITY, Arm, arm_text, draw_arm
from benchmarks.tracking_trials.effects import AT_LEAST, FAMILIES, NAMED, Hidden
from benchmarks.tracking_trials.faults import before, spoil
from benchmarks.tracking_trials.hiding import View, describe, hide
from benchmarks.tracking_trials.motions import draw_commands
from benchmarks.tracking_trials.physics import Commands, Setup, roll
from benchmarks.tracking_trials.plans import Plan, draw_plan

PAYLOAD_CENTER = (0.0, 0.0, 0.03)
_SHARE, _OUTSIDE_SHARE = 0.1, 0.2
"""Of what the missing physics does in the unseen motion, what a prediction may err by; the second without a name."""
_LEAST_LIMIT, _OF_NOISE = 1.5e-4, 0.5
"""rad, and of the noise: what a prediction may always err by."""
_AGREED = 3e-5
"""rad, by which simulators of the same arm may differ in what they make of its commands: a part of the noise in which
effects are to be seen, though no part of the read-outs."""
_DIGITS = 9
_ONE_FAULT = {"joints_swapped", "joint_sign"}  # those that the shared score knows


def draw(seed: int, index: int, sealed: bool = False) -> Trial:
    """The trial of an index: what is hidden is drawn again until some encoder could see it.

    Where `sealed`, what is outside the table is of the sealed families, and of no other.
    """
    return first_made(lambda rng: make_trial(draw_plan(seed, index, rng, sealed), rng), seed, 40, index)


def make_trial(plan: Plan, rng: np.random.Generator) -> Trial | None:
    """The trial of a plan; None where what it would hide cannot be seen there, or only when huge."""
    arm = draw_arm(plan.arm, rng, GRAVITY)
    payload = float(np.round(rng.uniform(0.1, 0.6), 3)) if rng.random() < 0.3 else 0.0
    seconds = plan.samples * len(plan.motions) / plan.rate
    slow = seconds * float(rng.uniform(0.2, 0.5))
    setup = Setup(arm, GRAVITY, payload, np.array(PAYLOAD_CENTER), float(rng.uniform(8, 20)), 0.25, slow)
    commands = draw_commands(rng, arm, plan.motions, plan.rate, plan.samples)
    unseen = draw_commands(rng, arm, (plan.unseen,), plan.rate, plan.samples)
    noise = float(np.sqrt(plan.sigma**2 + plan.quantum**2 / 12))
    view = View(setup, commands, float(np.hypot(noise, _AGREED)), plan.servo == "unknown")
    hidden = hide(plan, rng, view)
    if hidden is None:
        return None
    broken = before(plan, rng, commands.u)
    shown, later, plainly = _rolled(plan, setup, (*hidden, *broken), commands, unseen)
    if not np.isfinite(shown).all() or not np.isfinite(later).all():
        return None
    runs, samples, dof = shown.shape
    run = np.repeat(np.arange(runs), samples)
    log = spoil(plan, rng, shown.reshape(-1, dof), commands.u.reshape(-1, dof), run)
    if log is None:
        return None
    read = log.q + rng.normal(0, plan.sigma, log.q.shape)
    for row in log.rows:
        read[row] = read[row - 1]  # a row that is stale repeats its noise
    if plan.quantum:
        read = np.round(read / plan.quantum) * plan.quantum
    commanded = _rms(unseen.u[0] - later)
    effect = _rms(later - plainly)
    wanted = commanded if view.free else effect
    share = _OUTSIDE_SHARE if plan.kind == "outside" else _SHARE
    limit = max(_LEAST_LIMIT, _OF_NOISE * noise, share * wanted)
    described = describe(view, hidden, plan.kind in ("single", "outside"))
    planned = zip(described, plan.sizes, strict=True)
    truth = {
        "schema": "tracking/truth/1",
        **asdict(plan),
        "sizes": [about["size"] if about["effect"] in AT_LEAST else size for about, size in planned],
        "rows": len(read),
        "hidden": described,
        "fault_joints": [effect.joint + 1 for effect in broken] or log.joints,
        "fault_rows": log.rows,
        "noise_rad": noise,
        "stiffness_Nm_per_rad": arm.joints.stiffness.tolist(),
        "damping_Nm_s_per_rad": arm.joints.damping.tolist(),
        # the form in which logs of other generators are scored
        "name": f"{plan.kind}_{plan.seed}_{plan.index}",
        "effects": _shared_form(plan, hidden, log.joints),
        "servo_unknown": view.free,
        "effect_rms_rad": effect,
        "commanded_rms_rad": commanded,
        "unseen_limit_rad": limit,
        "unseen_readout_rad": np.round(later, 8).tolist(),
    }
    files = _files(plan, setup, read, log.u, run, commands, unseen)
    time = np.arange(samples) * unseen.period
    beside = {"unseen_truth.csv": csv_text({"time_s": time} | _columns("q", later), _DIGITS)}
    return Trial(plan, truth, files, beside)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _rolled(
    plan: Plan, setup: Setup, hidden: tuple[Hidden, ...], commands: Commands, unseen: Commands
) -> tuple[Array, Array, Array]:
    """Read-outs `(run, sample, joint)` rad, and those of the unseen motion with and without what is hidden.

    The unseen motion goes on where the recording ended, in what is slow: joints are warm then.
    """
    end = commands.begins[-1] + commands.period * commands.u.shape[1] + 1.0
    both = Commands(
        commands.period,
        np.concatenate([commands.u, unseen.u]),
        np.concatenate([commands.begins, [end]]),
        np.concatenate([commands.luck, unseen.luck]),
    )
    if plan.engine == "mujoco":
        shown = mujoco_arm.follow(setup, hidden, both)
        return shown[:-1], shown[-1], mujoco_arm.follow(setup, (), unseen)[0]
    shown, plainly = roll(setup, [hidden, ()], both).readout
    return shown[:-1], shown[-1], plainly[-1]


def _shared_form(plan: Plan, hidden: Sequence[Hidden], joints: Sequence[int]) -> list[dict[str, Any]]:
    """What is hidden, as truths of other generators of such logs have it."""
    effects = []
    for effect in hidden:
        arguments: dict[str, Any] = {} if effect.joint < 0 else {"joint": effect.joint + 1}
        also: list[list[str]] = []
        if effect.name in NAMED:
            named = NAMED[effect.name]
            arguments |= {argument: effect.values[name] for name, argument in named.arguments.items()}
            also += [[name, effect.site] for name in (effect.name, *named.also)]
        else:
            arguments |= dict(effect.values) | dict(effect.fixed)
        if effect.joint < 0 and effect.name in FAMILIES:
            arguments |= {"joint": 0}  # no joint that there is
        effects.append({"effect": effect.name, "args": arguments, "also": also})
    if plan.fault in _ONE_FAULT:
        names = ("first", "second") if plan.fault == "joints_swapped" else ("joint",)
        effects.append({"effect": plan.fault, "args": dict(zip(names, joints, strict=True))})
    return effects


def _columns(name: str, values: Array) -> dict[str, Array]:
    return {f"{name}{i}_rad": column for i, column in enumerate(values.T, 1)}


def _files(
    plan: Plan, setup: Setup, q: Array, u: Array, run: Array, commands: Commands, unseen: Commands
) -> dict[str, str]:
    """The files of a diagnosis, and of the motion that is to be predicted."""
    arm: Arm = setup.arm
    recording: dict[str, Any] = {
        "arm": "arm.yaml",
        "joint_source": "measured",
        "motion": "trajectory",
        "command": "position",
        "joint_noise_rad": plan.sigma,
        "payload_com_m": [float(value) for value in setup.payload_center],
        "gravity_m_per_s2": [float(value) for value in setup.gravity],
    }
    if plan.servo == "declared":
        recording["servo"] = {
            "stiffness_Nm_per_rad": [float(value) for value in arm.joints.stiffness],
            "damping_Nm_s_per_rad": [float(value) for value in arm.joints.damping],
            "delay_s": 0.0,
            "hold": "previous",
        }
    samples = commands.u.shape[1]
    time = (commands.begins[:, None] + np.arange(samples) * commands.period).ravel()
    columns = {"time_s": time} | _columns("q", q) | _columns("cmd", u)
    later = {"time_s": np.arange(samples) * unseen.period} | _columns("cmd", unseen.u[0])
    if commands.runs > 1:
        columns["run"] = run.astype(float)
    if setup.payload:
        columns["payload_kg"] = np.full(len(time), setup.payload)
        later["payload_kg"] = np.full(samples, setup.payload)
    return {
        "arm.yaml": arm_text(arm),
        "recording.yaml": yaml.safe_dump({"recording": recording}, sort_keys=False),
        "recording.csv": csv_text(columns, _DIGITS),
        "unseen.csv": csv_text(later, _DIGITS),
    }
