"""What a caller may set of estimation and search: each value, what it means, and why it is so."""

from dataclasses import dataclass, replace
from typing import final

from lite6jax.estimation.documented import option
from lite6jax.estimation.prior import PRIOR, Prior


@final
@dataclass(frozen=True)
class FitOptions:
    """How far a fit is taken.

    Attributes:
        steps: most Gauss-Newton steps in one linearisation. Four suffice where the model is right.
        settled: length of a last step, in standard deviations; the default is invisible in any printed digit.
        stale: share by which the numbers of a term change before derivatives are taken anew; at each step if 0.
        may_relinearise: whether a fit that does not converge where its problem is linearised goes on where it ends.
    """

    steps: int = 25
    settled: float = 1e-3
    stale: float = 0.003
    may_relinearise: bool = True


COMPARED = FitOptions(steps=10, settled=0.05, stale=0.03, may_relinearise=False)
"""How far fits are taken that are only compared with others.

Most of the models that a search compares are not true, and their fits may take many more steps, ever smaller ones. The
last step gains a thousandth of a log-likelihood. Residuals are exact, whatever the derivatives are.
"""


@final
@dataclass(frozen=True)
class EngineOptions:
    """What a caller may set of estimation and search. Evidence is in log-likelihood.

    Attributes:
        prior: the probabilities of explanations before any data.
        fit: how far a fit is taken whose numbers are reported.
        compared: the same of fits that are only compared with others.
    """

    prior: Prior = PRIOR
    fit: FitOptions = FitOptions()
    compared: FitOptions = COMPARED
    level: float = option(0.003, "family-wise false-alarm level of a finding", "one in 300 recordings")
    highest_order: float = option(400.0, "highest order of a spectrum", "twice the ratio of strain-wave gears to 200")
    first_samples: int = option(500, "samples that are searched first", "12 of 18 terms of real data are found there")
    most_samples: int = option(2000, "samples of a search; all samples then fit its terms", "bounds the time")
    longest_memory: float = option(
        float("inf"), "samples after which noise has forgotten to 1/e, at most", "the length of a recording bounds it"
    )
    damping: tuple[float, ...] = option(
        (1e-6, 1e-4, 1e-2),
        "damping factors, over the diagonal of the normal equations, of steps where no halved one improves a fit",
        "squares of errors of derivatives of a thousandth, a hundredth and a tenth",
    )
    most_exact: int = option(100, "numbers of terms up to which derivatives are taken by differences", "saves minutes")

    @property
    def rough(self) -> "EngineOptions":
        """For the fits of a search: they are neither linearised anew nor fitted to more digits than it needs."""
        return replace(self, fit=self.compared)


DEFAULTS = EngineOptions()
"""The options as they are documented."""
