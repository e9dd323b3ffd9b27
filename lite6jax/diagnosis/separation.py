"""What to record next: the poses at which two effects that a recording cannot tell apart differ most."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.diagnosis.case import Case
from lite6jax.diagnosis.selection import Rival, Selection, Step
from lite6jax.errors import InputError
from lite6jax.fitting.problem import Geometry, recording_problem
from lite6jax.identifiability.candidates import candidates
from lite6jax.identifiability.information import experiment
from lite6jax.identifiability.planning import separate_poses, shortest_round
from lite6jax.identifiability.sensor import Sensor

CLOSE = 6.0
"""Log-likelihood within which a rival explains the data as well."""
POSES = 12
_CANDIDATES = 3000
_MARGIN = np.deg2rad(2.0)
_MOST = 3


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
        if rival.gap < CLOSE and rival.effect not in selection.fitted.physics.effects
    ]
    found = []
    for k, step, rival in pairs[:_MOST]:
        poses = _poses(case, selection, k, step, rival, geometry)
        if poses is not None:
            found.append(Separation((step.effect.label, rival.effect.label), poses))
    return tuple(found)


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
        chosen = separate_poses(here, rivals, drawn, POSES, recorded=case.recording.joint_position, refined=False)
    except InputError:  # they move with time, temperature or velocity: poses at rest do not show them
        return None
    q = chosen.joint_position
    return q[shortest_round(q)]
