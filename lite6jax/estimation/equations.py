"""The normal equations of candidates beside a fitted model, and what each candidate would explain of its residuals."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

Array = NDArray[np.floating]


class Explained(NamedTuple):
    """What a candidate would explain, as the test alone that costs little.

    Attributes:
        gain: in log-likelihood, by its quadratic approximation.
        size: how many of its numbers are identifiable beside the model.
    """

    gain: float
    size: int

    @property
    def confounded(self) -> bool:
        """Whether its columns lie in the span of nuisance and model."""
        return not self.size

    def familywise(self, searched: float) -> float:
        """The p-value of the best of `searched` independent candidates in white noise; that of a score is no less."""
        return min(float(chdtrc(self.size, 2 * self.gain)) * searched, 1.0) if self.size else 1.0


class Equations(NamedTuple):
    """Normal equations of candidates of one size, whose columns had unit length before the model was projected out.

    Attributes:
        score: `(…, number)`, products of the projected columns with the residuals.
        gram: `(…, number, number)`, products of the projected columns with one another.
    """

    score: Array
    gram: Array

    def each(self) -> "list[Equations]":
        """Those of each candidate alone."""
        return list(map(Equations, self.score, self.gram))

    def explained(self, confounded: float) -> list[Explained]:
        """What each candidate explains; directions whose share outside the model's span is less do not count."""
        eigenvalues, V = np.linalg.eigh(self.gram)
        inverse = np.where(eigenvalues > confounded, 1 / np.maximum(eigenvalues, confounded), 0.0)
        gains = 0.5 * np.sum(inverse * np.einsum("gji,gj->gi", V, self.score) ** 2, 1)
        return list(map(Explained, gains.tolist(), np.sum(eigenvalues > confounded, 1).tolist()))


def equations_of(score: Array, gram: Array, inside: Array) -> Equations:
    """The equations of groups of columns of one size.

    Args:
        score: `(group, number)`, products of projected columns with residuals.
        gram: `(group, number, number)`, products of columns with one another.
        inside: `(group, number, k)`, columns in an orthonormal basis of the model's span.
    """
    norms = np.sqrt(np.maximum(np.diagonal(gram, axis1=1, axis2=2), 1e-300))
    return Equations(score / norms, (gram - inside @ inside.swapaxes(1, 2)) / (norms[:, :, None] * norms[:, None]))


def explained_by(equations: Sequence[Equations], confounded: float) -> list[Explained]:
    """What single candidates of any sizes explain, as `Equations.explained`."""
    found: dict[int, Explained] = {}
    alike: dict[int, list[int]] = {}
    for k, one in enumerate(equations):
        alike.setdefault(len(one.score), []).append(k)
    for members in alike.values():
        stacked = Equations(*map(np.stack, zip(*(equations[k] for k in members), strict=True)))
        found |= zip(members, stacked.explained(confounded), strict=True)
    return [found[k] for k in range(len(equations))]
