"""What to record next: the poses at which two effects that a recording cannot tell apart differ most."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.problem import Case
from lite6jax.effects.composition import missing
from lite6jax.errors import InputError
from lite6jax.fitting.problem import Geometry, recording_problem
from lite6jax.identifiability.candidates import candidates
from lite6jax.identifiability.discrimination import plan_discrimination
from lite6jax.identifiability.information import experiment
from lite6jax.identifiability.route import shortest_round
from lite6jax.identifiability.sensor import Sensor
from lite6jax.search.backward import CLOSE, Rival, Step
from lite6jax.search.forward import Selection

POSES = 12
_CANDIDATES = 3000
_MARGIN = np.deg2rad(2.0)
_MOST = 3
_SAME = 1e-4
"""Share of what an effect does that its rival cannot do, over the poses recorded, under which they are the same."""


class Separation(NamedTuple):
    """Poses that tell two effects apart.

    Attributes:
        effects: their labels.
        joint_position: `(pose, joint)` rad, in an order of short moves; inside the arm's limits, not checked for
            collisions.
    """

    effects: tuple[str, str]
    joint_position: NDArray[np.floating]


def separations(selection: Selection, geometry: Geometry = "declared") -> tuple[Separation, ...]:
    """Poses for each pair of effects that the recording leaves undecided; of those that poses at rest can show."""
    case = selection.case
    pairs = [
        (k, step, rival)
        for k, step in enumerate(selection.steps)
        for rival in step.rivals
        if rival.gap < CLOSE and rival.effect not in selection.fitted.physics.effects and differ(selection, k, rival)
    ]
    found = []
    for k, step, rival in pairs[:_MOST]:
        poses = _poses(case, selection, k, step, rival, geometry)
        if poses is not None:
            found.append(Separation((step.effect.label, rival.effect.label), poses))
    return tuple(found)


def differ(selection: Selection, k: int, rival: Rival) -> bool:
    """Whether they are two things at all: a link may turn about the next joint's axis, which no pose tells apart."""
    case, fitted = selection.case, selection.fitted
    part = fitted.physics.slices[k]
    effect = fitted.values[part] @ case.columns(fitted.physics.effects, fitted.values)[part].reshape(
        part.stop - part.start, -1
    )
    if missing(rival.effect, case.motion, case.inertia is not None) is not None:
        return True
    beside = case.columns([rival.effect], beside=(fitted.physics, fitted.values))
    hiding = np.concatenate([beside, case.nuisance]).reshape(-1, effect.size)
    norms = np.linalg.norm(hiding, axis=1, keepdims=True)
    left = np.linalg.lstsq((hiding / np.where(norms > 0, norms, 1.0)).T, effect, rcond=1e-10)[0]
    remains = effect - (hiding / np.where(norms > 0, norms, 1.0)).T @ left
    return bool(remains @ remains > _SAME * (effect @ effect))


def _poses(
    case: Case, selection: Selection, k: int, step: Step, rival: Rival, geometry: Geometry
) -> NDArray[np.floating] | None:
    problem = recording_problem(case.recording, case.arm, geometry)
    position, orientation = case.noise
    sensor = Sensor("position" if orientation is None else "pose", position, orientation)
    here = experiment(case.arm, problem.form, problem.start, sensor, problem.movable, problem.precision)
    values = selection.fitted.values[selection.fitted.physics.slices[k]]
    drawn = candidates(case.arm, _CANDIDATES, limit_margin=_MARGIN).joint_position
    try:
        rivals = ((step.effect, values), (rival.effect, np.zeros(rival.effect.size)))
        chosen = plan_discrimination(here, rivals, drawn, POSES, recorded=case.recording.joint_position, refined=False)
    except InputError:  # they move with time, temperature or velocity: poses at rest do not show them
        return None
    q = chosen.joint_position
    return q[shortest_round(q)]
