"""Errors on rows that were not used: screening, clock, linearisation and search are repeated without each block.

Only which faults are corrected rather than explained by physics, and at which rows frames jumped, is decided once, in
all rows: a search beside every uncorrected fault would take each fold as long as the diagnosis itself, and a block that
holds the jump cannot be predicted without its row. The size of a jump is estimated anew.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms.arm import Arm
from lite6jax.arms.factory import FactoryCalibration
from lite6jax.diagnosis.explanation import Decisions, explain
from lite6jax.diagnosis.options import Options
from lite6jax.domains.pose.problem import PoseProblem
from lite6jax.effects.effect import Effect
from lite6jax.estimation.least_squares import Fit
from lite6jax.fitting.problem import Geometry
from lite6jax.progress import part
from lite6jax.recordings import Recording

Array = NDArray[np.floating]


class HeldOut(NamedTuple):
    """Position errors on held-out rows, `(sample,)` m each.

    Attributes:
        before: with the nuisance alone.
        after: with the effects that a search of the other rows selects.
    """

    before: Array
    after: Array


def held_out_errors(
    recording: Recording,
    arm: Arm | None,
    geometry: Geometry,
    options: Options,
    decisions: Decisions,
    effects: Sequence[Effect] = (),
    factory: FactoryCalibration | None = None,
) -> HeldOut:
    """The errors on every row, predicted from the other contiguous blocks; arguments as of `diagnose`.

    Args:
        recording: whose rows are in order, each once and in one unit; all faults are screened for in each fold.
        decisions: between faults and physics, of all rows.
    """
    before, after = np.zeros(recording.samples), np.zeros(recording.samples)
    folds = recording.contiguous_folds(fold_count(recording.samples, options))
    for number, held in enumerate(folds, 1):
        with part(number, 1 + len(folds)):
            found = explain(recording, arm, geometry, options, effects, factory, ~held, False, decisions)
        state, reference = found.selection.state, found.selection.reference
        assert isinstance(reference, PoseProblem)
        before[held] = _distance(reference, state.baseline)[held]
        after[held] = _distance(found.problem, state.fit)[held]
    return HeldOut(before, after)


def fold_count(samples: int, options: Options) -> int:
    """How many blocks of so many rows are held out: fewer where these would be short."""
    return min(options.folds, max(2, samples // options.least_in_fold))


def _distance(problem: PoseProblem, fit: Fit) -> Array:
    """`(sample,)` m between predicted and measured positions."""
    return np.linalg.norm(problem.position_errors(fit.nuisance, fit.terms, fit.values), axis=0)
