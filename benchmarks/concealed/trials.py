"""One trial: what is drawn from a seed and an index, what the diagnosis is given, and the truth that is sealed."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.campaigns.rounds import Trial, first_made
from benchmarks.concealed import chain as chains
from benchmarks.concealed import readings
from benchmarks.concealed.chain import Array, Chain, quaternion_from_rotation, vector_from_rotation
from benchmarks.concealed.hiding import described, hide
from benchmarks.concealed.mujoco_physics import Arm
from benchmarks.concealed.oracle import oracle
from benchmarks.concealed.outside import FAMILIES
from benchmarks.concealed.plain_physics import Hidden, Motion, Setup, poses
from benchmarks.concealed.plans import (
    ENCODERS,
    LOOSE,
    NAMES_AT_STAKE,
    OFF,
    SENSORS,
    TOUCHED,
    UNCERTAIN,
    Plan,
    draw_plan,
    draw_reading_plan,
)
from benchmarks.concealed.recorded import (
    JOINTS,
    PAYLOAD_CENTER,
    UNSEEN_ROWS,
    draw_motion,
    files_of,
    files_of_readings,
    measure,
)
from benchmarks.concealed.view import Open, View, turned

MASS_ERROR = 0.1
"""One standard deviation of the masses' errors where they are off, relative; twice that is the most."""


def draw(seed: int, index: int, sealed: bool = False) -> Trial:
    """The trial of an index: what is hidden is drawn again until some sensor there could see it.

    Where `sealed`, what is outside the catalogue is of the sealed families, and of no other.
    """
    return first_made(lambda rng: _make(draw_plan(seed, index, rng, sealed), rng), seed, 0, index)


def draw_reading(sensor: str, seed: int, index: int, sealed: bool = False) -> Trial:
    """As `draw`, of a sensor that measures no poses, a key of `READERS`; these hide nothing outside the catalogue."""

    def make(rng: np.random.Generator) -> Trial | None:
        return _make_reading(draw_reading_plan(sensor, seed, index, rng), rng)

    return first_made(make, seed, 12, index)


def _make_reading(plan: Plan, rng: np.random.Generator) -> Trial | None:
    """The trial of a plan; None where the arm does not come to the places, or what it would hide cannot be seen."""
    nominal, actual, declared = _arms(plan, rng)
    scene = readings.draw_scene(plan.sensor, rng, actual, plan.rows)
    tool = turned(rng.uniform(-0.5, 0.5, 3), np.array([0.03, -0.01, 0.08]) + rng.uniform(-0.01, 0.01, 3))
    setup, frame = Setup(actual, scene.sensor, tool, np.array(PAYLOAD_CENTER)), scene.turned
    touched = plan.geometry == "unknown" and not frame
    left_open = Open(
        frame=frame,
        tool=6 if frame else 3,
        geometry=plan.geometry != "known",
        prior={"uncertain": (UNCERTAIN, UNCERTAIN), "unknown": TOUCHED if touched else LOOSE}.get(plan.geometry),
        encoders=ENCODERS if touched else 0.0,
    )
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
    files = files_of_readings(plan, nominal, declared, motion, scene.columns(seen, group), scene.said, unseen)
    return Trial(plan, truth, files)


def _make(plan: Plan, rng: np.random.Generator) -> Trial | None:
    """The trial of a plan; None where what it would hide cannot be seen there, or only when huge."""
    nominal, actual, declared = _arms(plan, rng)
    sensor, tool = np.eye(4), np.eye(4)
    if plan.mounted:
        sensor = turned(rng.uniform(-np.pi, np.pi, 3), rng.uniform(-2, 2, 3))
        tool = turned(rng.uniform(-0.5, 0.5, 3), np.array([0.02, -0.01, 0.06]) + rng.uniform(-0.02, 0.02, 3))
    setup = Setup(actual, sensor, tool, np.array(PAYLOAD_CENTER))
    noise = SENSORS[plan.sensor][:2]
    left_open = Open(
        frame=plan.mounted,
        tool=0 if not plan.mounted else 6 if noise[1] else 3,
        geometry=plan.geometry != "known",
        prior={"uncertain": (UNCERTAIN, UNCERTAIN), "unknown": LOOSE}.get(plan.geometry),
    )
    warm = any(name in FAMILIES and FAMILIES[name].warm for name in plan.effects)
    warming = "link_thermal_expansion" in plan.effects or warm or rng.random() < 0.3
    loading = "payload_error" in plan.effects or rng.random() < 0.4
    fixed_load, wandering = plan.engine == "mujoco", plan.kind in NAMES_AT_STAKE
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

    measured, recorded, used, faulty = measure(plan, rng, setup, motion, seen)
    # of faults the oracle is told, of a file that is another arm's too; of noise it is not
    read = replace(view, motion=replace(motion, q=recorded)) if plan.noise == "in the joints" else view
    believed = setup if plan.fault == "nominal_table" else replace(setup, chain=declared)
    fitted = _oracle(read, believed, hidden, measured, used, unseen, unseen_truth)
    truth = _truth(plan, view, hidden, seen, unseen_truth, faulty, {"oracle": fitted})
    if plan.masses_off:
        truth["mass_errors"] = (actual.mass / nominal.mass - 1).tolist()
    files = files_of(plan, nominal, declared, motion, measured, recorded, noise, unseen)
    return Trial(plan, truth, files)


def _truth(
    plan: Plan,
    view: View,
    hidden: tuple[Hidden, ...],
    seen: tuple[Array, Array],
    unseen: tuple[Array, Array],
    faulty: Sequence[int] = (),
    more: Mapping[str, Any] = MappingProxyType({}),
) -> dict[str, Any]:
    """What is sealed of rotations and positions that were seen, and of those of the unseen motion."""
    moved = seen[1] - poses(view.setup, (), view.motion)[1]
    return {
        "schema": "concealed/truth/1",
        **plan.told(),
        "hidden": described(view, hidden),
        "fault_rows": list(faulty),
        "moved_rms_m": float(np.sqrt(np.mean(np.sum(moved**2, 1)))),
        "noise_m": view.noise[0],
        "noise_rad": view.noise[1],
        **more,
        "unseen_position_m": unseen[1].tolist(),
        "unseen_quaternion": quaternion_from_rotation(unseen[0]).tolist(),
    }


def _arms(plan: Plan, rng: np.random.Generator) -> tuple[Chain, Chain, Chain]:
    """The arm as it is designed, as it is, and as the sidecar says that it is; but for masses, which nobody says."""
    nominal = {"lite6": chains.lite6, "seven": chains.seven, "six": lambda: chains.drawn_six(rng)}[plan.arm]()
    if plan.fault == "nominal_table":
        return nominal, chains.lite6_ros(), nominal
    actual = nominal.moved(rng, *chains.MADE)
    if plan.masses_off:
        errors = np.clip(rng.normal(0, MASS_ERROR, nominal.dof), -2 * MASS_ERROR, 2 * MASS_ERROR)
        actual = replace(actual, mass=nominal.mass * (1 + errors))
    if plan.geometry == "unknown":
        return nominal, actual, replace(nominal, mass=actual.mass)
    off = UNCERTAIN if plan.geometry == "uncertain" else OFF if plan.noise == "factory file off" else 0.0
    return nominal, actual, actual.moved(rng, off, off)


def _oracle(
    view: View,
    believed: Setup,
    hidden: tuple[Hidden, ...],
    measured: tuple[Array, Array],
    used: NDArray[np.bool_],
    unseen: Motion,
    truth: tuple[Array, Array],
) -> dict[str, float]:
    """How well the fit that is told the form of the truth predicts the unseen motion."""
    rotation, position = poses(*oracle(view, believed, hidden, measured, used), unseen)
    turn = vector_from_rotation(np.swapaxes(truth[0], 1, 2) @ rotation)
    return {
        "unseen_position_rms_m": float(np.sqrt(np.mean(np.sum((position - truth[1]) ** 2, 1)))),
        "unseen_rotation_rms_rad": float(np.sqrt(np.mean(np.sum(turn**2, 1)))),
        "estimated_numbers": view.open.size(view.setup.chain.dof) + sum(len(effect.values) for effect in hidden),
    }
