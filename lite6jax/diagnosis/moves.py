"""What each finding of a diagnosis of poses is worth: how far it moves the measured point, and how much it turns it."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.domains.pose.kinematics import unwhitened
from lite6jax.estimation.projection import scaled_solve

if TYPE_CHECKING:
    from lite6jax.diagnosis.result import Diagnosis

Array = NDArray[np.floating]


class Moves(NamedTuple):
    """What a finding moves, root mean square over the rows that are no outliers.

    Attributes:
        position: m.
        orientation: rad; None where no orientation was measured.
    """

    position: float
    orientation: float | None


def moves_of(found: "Diagnosis") -> tuple[Moves, ...]:
    """What each finding moves beyond what the fitted frames and geometry would take up, were it not in the model.

    The displacement is that of the whole model, with the finding less without it. From it the weighted least-squares
    fit of the nuisance beside the other findings, with its prior, is subtracted: an effect that a sensor's frame
    imitates moves a measured pose by much and its residual by little.
    """
    problem, fit, kept = found.problem, found.fit, ~found.outliers
    weight = np.where(fit.training & kept, fit.residuals.row_weight, 0.0)
    whole = problem.residual(fit.nuisance, fit.terms, fit.values)
    moves = []
    for k in range(len(fit.terms.terms)):
        others = fit.terms.part(fit.values, [other != k for other in range(len(fit.terms.terms))])
        moved = whole - problem.residual(fit.nuisance, *others)
        nuisance = problem.nuisance_columns(*others)
        if len(nuisance):
            weighted = (nuisance * weight).reshape(len(nuisance), -1)
            H = weighted @ nuisance.reshape(len(nuisance), -1).T + np.diag(problem.precision)
            moved = moved - np.tensordot(scaled_solve(H, weighted @ moved.ravel()), nuisance, 1)
        displaced = unwhitened(moved, problem.measured.whitener)[:, kept]
        moves.append(Moves(_rms(displaced[:3]), _rms(displaced[3:]) if problem.rows == 6 else None))
    return tuple(moves)


def _rms(vectors: Array) -> float:
    """The root mean square length of vectors `(3, sample)`."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, 0)))) if vectors.shape[1] else 0.0
