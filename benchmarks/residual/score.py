"""The rivals beside the diagnosis: errors where they have not looked, the names they give, numbers and time.

Each rival sees the rows outside a contiguous fold and predicts the fold from its joints, payload, temperature and time;
the errors of all folds together are its score, all rows counted. Every one starts from the same fitted geometry, and
corrects it: a displacement and a turn of the tool in the base's axes.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.concealed.chain import rotation_from_vector
from benchmarks.measure import timed
from benchmarks.residual.black_boxes import gaussian_process, geometry_alone, neural_network
from benchmarks.residual.linear import ridge, stepwise
from benchmarks.residual.view import Array, Fitted, Geometry, Rival, View, rotations
from lite6jax.diagnosis.diagnose import diagnose
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.domains.pose.registration import register, register_model
from lite6jax.recordings import Recording

OURS = "lite6jax"
FOLDS = 5


def rivals(free: bool) -> dict[str, Rival]:
    """By name."""
    return {
        "geometry alone": geometry_alone,
        "geometry and Gaussian process": gaussian_process,
        "geometry and neural network": neural_network,
        "ridge, orders 1–60": partial(ridge, free),
        "stepwise, BIC": partial(stepwise, free),
    }


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one of them makes of a recording.

    Attributes:
        subject: which.
        errors: `(sample,)` m, each row predicted by a fit of the other folds.
        parameters: of the fit of all rows, over the geometry's.
        names: of the fit of all rows.
        seconds: of all fits, the geometry's included.
    """

    subject: str
    errors: Array
    parameters: int
    names: tuple[str, ...]
    seconds: float


def compare(recording: Recording, folds: int = FOLDS, progress: Callable[[str], object] = str) -> Iterator[Outcome]:
    """All rivals on one recording, by contiguous folds, and on all of it for their names.

    Args:
        recording: with poses.
        folds: how many.
        progress: is told who is at work.
    """
    held = recording.contiguous_folds(folds)
    everything = np.ones(recording.samples, bool)
    geometries = [timed(partial(Geometry.of, recording.select(~fold))) for fold in held]
    whole = timed(partial(Geometry.of, recording))
    for name in rivals(whole[1].free):
        progress(name)
        errors, seconds = np.zeros(recording.samples), sum(s for s, _ in (*geometries, whole))
        for fold, (_, geometry) in zip(held, geometries, strict=True):
            taken, fitted = timed(partial(_fitted, geometry, name, recording.select(~fold)))
            view = geometry.view(recording.select(fold))
            assert view.missed is not None
            errors[fold] = np.linalg.norm(fitted.correct(view).shift - view.missed, axis=1)
            seconds += taken
        taken, fitted = timed(partial(_fitted, whole[1], name, recording.select(everything)))
        yield Outcome(name, errors, fitted.parameters, fitted.names, seconds + taken)


def _fitted(geometry: Geometry, name: str, recording: Recording) -> Fitted:
    from threadpoolctl import threadpool_limits

    view = geometry.view(recording)
    with threadpool_limits(1):  # small matrices: more threads would wait for each other
        return rivals(geometry.free)[name](view.rows(np.flatnonzero(view.usable)))


def transfer(recording: Recording, other: Recording, progress: Callable[[str], object] = str) -> Iterator[Outcome]:
    """Fitted to one recording, errors on another of the same arm, its sensor frame and tool registered anew."""
    taken, geometry = timed(partial(Geometry.of, recording))
    for name in rivals(geometry.free):
        progress(name)
        seconds, fitted = timed(partial(_fitted, geometry, name, recording))
        view = geometry.view(other)
        tool = _shown(geometry, fitted, view)
        assert other.position is not None
        R = None if other.quaternion is None else rotations(other.quaternion)
        found = register(tool @ np.linalg.inv(geometry.after), other.position, R, view.noise)
        yield Outcome(name, found.distance, fitted.parameters, fitted.names, taken + seconds)


def unseen(
    recording: Recording, motion: Recording, truth: Array, progress: Callable[[str], object] = str
) -> Iterator[Outcome]:
    """Fitted to a recording, errors on another motion of the same arm whose true positions are known.

    Args:
        recording: with poses.
        motion: without.
        truth: `(sample, 3)` m, sensor frame.
        progress: is told who is at work.
    """
    taken, geometry = timed(partial(Geometry.of, recording))
    S = geometry.sensor
    for name in rivals(geometry.free):
        progress(name)
        seconds, fitted = timed(partial(_fitted, geometry, name, recording))
        position = _shown(geometry, fitted, geometry.view(motion))[:, :3, 3] @ S[:3, :3].T + S[:3, 3]
        errors = np.linalg.norm(position - truth, axis=1)
        yield Outcome(name, errors, fitted.parameters, fitted.names, taken + seconds)


def _shown(geometry: Geometry, fitted: Fitted, view: View) -> Array:
    """`(sample, 4, 4)`, the tool's corrected poses in the base's axes."""
    shift, turn = fitted.correct(view)
    tool = np.tile(np.eye(4), (len(shift), 1, 1))
    tool[:, :3, :3] = rotation_from_vector(turn) @ view.tool[0]
    tool[:, :3, 3] = view.tool[1] + shift
    return tool


def diagnosed(recording: Recording) -> tuple[Outcome, dict[str, Any]]:
    """The diagnosis: one search a fold, and one of all rows; and the file that it writes."""
    seconds, found = timed(partial(diagnose, recording))
    names = tuple(finding.effect.label for finding in found.findings)
    outcome = Outcome(OURS, found.after, found.fit.terms.size, names, seconds)
    return outcome, found.document()


def diagnosed_elsewhere(model: DiagnosedArm, other: Recording) -> Array:
    """`(sample,)` m: errors of a diagnosis' model on another recording, frame and tool registered anew."""
    _, found = register_model(model, other)
    return found.distance
