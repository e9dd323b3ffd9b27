"""What to record next: the poses at which two effects that a recording does not distinguish differ most."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.factory import FactoryCalibration
from lite6jax.calibration.problem import Geometry, recording_problem
from lite6jax.design.candidates import candidates
from lite6jax.design.information import Experiment
from lite6jax.design.poses import plan_discrimination, short_path
from lite6jax.design.sensor import Sensor
from lite6jax.diagnosis.options import Options
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.effects.composition import missing
from lite6jax.effects.effect import Effect
from lite6jax.errors import InputError
from lite6jax.estimation.projection import orthonormal, outside, unit_rows
from lite6jax.search.search import Selection

Array = NDArray[np.floating]


class SeparatingPoses(NamedTuple):
    """Poses `(pose, joint)` rad that separate two effects, given by their labels, in an order of short moves.

    They are inside the arm's limits, and not checked for collisions.
    """

    effects: tuple[str, str]
    joint_position: Array


def separating_poses(
    selection: Selection, geometry: Geometry, factory: FactoryCalibration | None, options: Options
) -> tuple[SeparatingPoses, ...]:
    """Poses for each pair of effects that the recording does not distinguish, where poses at rest can.

    Nonparametric effects are no rivals here: what they are elsewhere is not known. Neither are other orders of the same
    wave: any position between those that were recorded separates them.
    """
    state, problem = selection.state, selection.problem
    assert isinstance(problem, PoseProblem)
    if problem.recording.touches is not None:  # which poses a socket or a plate can be touched at is not known
        return ()
    pairs = [
        (k, alternative.term)
        for k, tested in enumerate(state.tested)
        for alternative in tested.alternatives
        if alternative.gap < options.engine.close
        and isinstance(alternative.term, Effect)
        and not alternative.term.nonparametric
        and not (alternative.term.periodic and alternative.term.label == tested.term.label)
        and alternative.term not in state.fit.terms.terms
        and differ(selection, k, alternative.term, options)
    ][: options.most_separated]
    if not pairs:
        return ()
    rigid, (position, orientation) = recording_problem(problem.recording, problem.arm, geometry, factory), problem.noise
    sensor = Sensor("position" if orientation is None else "pose", position, orientation)
    here = Experiment(problem.arm, rigid.form, rigid.start, sensor, rigid.movable, rigid.precision)
    drawn = candidates(problem.arm, options.separating_candidates, limit_margin=options.separating_margin)
    recorded, count, found = problem.recording.joint_position, options.separating_poses, []
    for k, rival in pairs:
        effect, values = state.tested[k].term, state.fit.values[state.fit.terms.slices[k]]
        assert isinstance(effect, Effect)
        pair = (effect, values), rival
        try:
            chosen = plan_discrimination(here, pair, drawn.joint_position, count, recorded=recorded)
        except InputError:  # the effects depend on time, temperature or velocity, which poses at rest do not vary
            continue
        q = chosen.joint_position
        found.append(SeparatingPoses((effect.label, rival.label), q[short_path(q)]))
    return tuple(found)


def differ(selection: Selection, k: int, rival: Effect, options: Options) -> bool:
    """Whether columns of the k-th finding and a rival differ: a link may turn about the next joint's axis."""
    problem, fit = selection.problem, selection.state.fit
    assert isinstance(problem, PoseProblem)
    if missing(rival, problem.motion, problem.inertia is not None) is not None:
        return True
    part = fit.terms.slices[k]
    columns = problem.columns(fit.terms.terms, fit.values)[part]
    effect = np.tensordot(fit.values[part], columns, 1).reshape(1, -1)
    beside = problem.columns([rival], beside=(fit.terms, fit.values))
    span = np.concatenate([beside, problem.nuisance_columns(fit.terms, fit.values)]).reshape(-1, effect.size)
    left = outside(effect, orthonormal(unit_rows(span), options.engine.rounding))
    return bool(np.sum(left**2) > options.same_effect * np.sum(effect**2))
