"""The verdict of a diagnosis, which says no more than what is left of the residuals allows."""

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from scipy.special import chdtri

from lite6jax.estimation.concentration import Concentration, concentration
from lite6jax.estimation.multiplicity import multiplicity
from lite6jax.estimation.terms import Term

if TYPE_CHECKING:
    from lite6jax.diagnosis.options import Options
    from lite6jax.diagnosis.result import Diagnosis

Verdict = Literal["consistent", "explained", "partly_explained", "unnamed", "unexplained", "undetermined"]


class Left(NamedTuple):
    """What the model leaves of the residuals, outliers excluded.

    Attributes:
        position: root mean square of held-out position errors per axis over the declared noise; None where that of
            positions is not declared.
        orientation: the same of the fitted orientations; None where none were measured, or their noise is not declared.
        white: whether residuals of neighbouring rows are uncorrelated.
        acts_at: the joint at which most of it acts; None where there is no such.
    """

    position: float | None
    orientation: float | None
    white: bool
    acts_at: Concentration | None = None

    def is_noise(self, limit: float) -> bool:
        """Whether it is white, and at most `limit` times the noise of each quantity whose noise is declared."""
        return self.white and all(ratio is None or ratio <= limit for ratio in (self.position, self.orientation))


def left_of(found: "Diagnosis") -> Left:
    """What the model of a diagnosis leaves."""
    problem, kept, white = found.problem, ~found.outliers, found.fit.noise.white
    acts_at = concentration(problem, found.fit, found.options.engine)
    position, orientation = None, None
    if problem.declared_noise[0] is not None and kept.any():
        position = float(np.sqrt(np.mean(found.after[kept] ** 2) / 3) / problem.declared_noise[0])
    if problem.declared_noise[1] is not None and kept.any():
        rows, fit = found.fit.residuals.rows[3:, kept], found.fit
        freedom = max(1 - fit.parameters / max(problem.rows * kept.sum(), 1), 0.1)
        orientation = float(np.sqrt(np.mean(rows**2) / freedom))
    return Left(position, orientation, white, acts_at)


def verdict_of(found: "Diagnosis") -> Verdict:
    """The verdict by the findings, by what is left, and by whether the rows are enough to tell.

    *consistent*: nothing was found, and what is left is the declared noise. *explained*: with the findings it is.
    *partly_explained*: with the findings, more is left. *unnamed*: the largest finding has no name. *unexplained*: more
    is left than noise, and nothing was found. *undetermined*: the rows are too few to tell, or what is left is noise,
    but an effect that is no finding is nearly significant. What a model that does not describe the poses leaves is not
    noise, whether or not noise is declared.
    """
    options, left = found.options, found.left
    bad = found.quality.verdict == "bad"
    as_noise = left.is_noise(options.as_noise) and not bad
    # beside effects that were withdrawn, the nearest is that of another model
    doubtful = found.withdrawn is None and nearly_significant(found.selection.nearest, options)
    if not found.findings:
        few = found.problem.samples < options.fewest_rows
        if few or (not as_noise and not bad and found.rows_needed <= options.within_reach):
            return "undetermined"
        if not as_noise:
            return "unexplained"
        return "undetermined" if doubtful else "consistent"
    if max(found.findings, key=lambda finding: finding.gain).effect.nonparametric:
        return "unnamed"
    if not as_noise or left.position is None:
        return "partly_explained"
    return "undetermined" if doubtful else "explained"


def nearly_significant(nearest: tuple[Term, float] | None, options: "Options") -> bool:
    """Whether the nearest effect that is no finding, with its family-wise p-value, is nearly significant.

    Residuals of the size of the noise do not exclude it: what it moves may have gone into numbers of the findings, as
    the compliance of a joint goes into that of the base where both are loaded alike. One that is significant and yet no
    finding was refused for a reason of its own: its numbers are not possible, or something else is more likely.
    """
    return nearest is not None and options.engine.level <= nearest[1] < options.nearly_significant


def rows_needed(found: "Diagnosis") -> int:
    """About how many rows would make the nearest effect significant, if it is real.

    The statistic of an effect grows with the number of rows.
    """
    least = max(found.options.fewest_rows, found.problem.samples + 1)
    if found.selection.nearest is None:
        return least
    engine = found.options.engine
    term, p_value = found.selection.nearest
    searched = multiplicity(found.problem, term, engine)
    now, needed = (float(chdtri(term.size, max(p / searched, 1e-300))) for p in (p_value, engine.level))
    more = needed / now if now > 0 else np.inf
    rows = int(np.ceil(min(found.problem.samples * more, 1e9)))
    return max(rows, least)
