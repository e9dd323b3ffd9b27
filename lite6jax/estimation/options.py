"""Every threshold of the engine: its value, what it means, and why it has that value."""

from dataclasses import dataclass, replace
from typing import final

from lite6jax.estimation.documented import option
from lite6jax.estimation.prior import PRIOR, Prior


@final
@dataclass(frozen=True)
class EngineOptions:
    """Thresholds of estimation and search. Lengths of time are counted in samples, evidence in log-likelihood.

    Attributes:
        prior: the probabilities of explanations before any data.
    """

    prior: Prior = PRIOR

    # evidence
    level: float = option(0.003, "family-wise false-alarm level of a finding", "one in 300 recordings")
    close: float = option(
        6.0,
        "log-likelihood within which two models are not distinguished",
        "a likelihood ratio of 400; also what a noise model of two numbers must gain",
    )
    resolved_orders: float = option(
        3.8,
        "independent orders per order, over a full turn",
        "√(π gain / 3) at a gain of 14, where family-wise p-values meet the level (Baluev 2008)",
    )
    confounded: float = option(
        1e-6,
        "share of a column's square, outside the span of nuisance and model, below which it is confounded",
        "a thousandth of its length: linearisation errors are as large",
    )
    rounding: float = option(
        1e-12, "relative eigenvalue below which a direction is rounding", "the square of the rounding of residuals"
    )
    winsor: float = option(4.0, "standard deviations at which residuals are winsorised", "one normal sample in 16 000")
    # blocks of the score test
    most_blocks: int = option(
        200, "most blocks of a score test", "at p-values of one in a million, 60 blocks need an effect a tenth larger"
    )
    least_in_block: int = option(6, "fewest samples in a block", "fewer make heavy-tailed sums")
    enough_blocks: int = option(20, "blocks below which they are made shorter", "a variance known to a third")
    block_times: float = option(2.0, "autocorrelation times in a block", "neighbouring blocks then correlate little")
    # noise model
    lags: int = option(32, "lags of the portmanteau statistic", "covers autocorrelation times to about ten samples")
    suspicious: float = option(
        2.5, "standard deviations of summed autocorrelations below which noise is taken as white", "saves time"
    )
    least_in_run: int = option(4, "mean samples of a run from which autocorrelation is estimated", "two parameters")
    most_for_noise: int = option(2000, "samples from which the noise model is estimated", "known to 3 %")
    longest_memory: float = option(
        float("inf"), "samples after which noise has forgotten to 1/e, at most", "the length of a recording bounds it"
    )
    # least squares
    steps: int = option(
        25, "most Gauss-Newton steps of a fit in one linearisation", "four suffice where the model is right"
    )
    settled: float = option(1e-3, "length of a last step, in standard deviations", "invisible in any printed digit")
    stale: float = option(
        0.0,
        "share by which the numbers of a term change before derivatives are taken anew",
        "at each step if 0",
    )
    compared: float = option(
        0.05, "as `settled`, of fits that are only compared with others", "a thousandth of a log-likelihood"
    )
    compared_steps: int = option(
        10,
        "as `steps`, of fits that are only compared with others",
        "fits of models that are not true may take many more, in ever smaller steps",
    )
    compared_stale: float = option(
        0.03, "as `stale`, of fits that are only compared with others", "residuals are exact"
    )
    first_steps: int = option(
        6, "as `steps`, where a fit that has not converged by then is linearised anew", "four suffice mostly"
    )
    least_gain: float = option(
        0.01, "log-likelihood that a fit must gain to be linearised anew again", "`close` is 600 times that"
    )
    exact_steps: int = option(8, "most steps of a fit with derivatives by differences", "it starts at the solution")
    exact_settled: float = option(0.02, "length of its last step, in standard deviations", "each step is expensive")
    halvings: int = option(6, "most halvings of a step that does not improve", "a step of 1/64 is no progress")
    damping: tuple[float, ...] = option(
        (1e-6, 1e-4, 1e-2),
        "damping factors, over the diagonal of the normal equations, of steps where no halved one improves a fit",
        "squares of errors of derivatives of a thousandth, a hundredth and a tenth",
    )
    difference: float = option(1e-6, "m or rad by which a difference is taken", "between rounding and curvature")
    exact_rounding: float = option(
        1e-9,
        "relative eigenvalue below which a direction is rounding where derivatives are taken by differences",
        "these are known to about 1e-6: a thousand times the square",
    )
    most_exact: int = option(100, "numbers of terms up to which derivatives are taken by differences", "saves minutes")
    relinearisations: int = option(
        4, "most times that a fit or a selection is linearised anew; none if 0", "two suffice mostly"
    )
    same: float = option(
        0.1,
        "sum of the squared differences of residuals, in standard deviations, below which linearisations are the same",
        "a tenth of what each fitted number explains of noise",
    )
    # selection by evidence
    margin: float = option(3.0, "log evidence that a term must gain beyond the cost of its choice", "odds of twenty")
    better: float = option(
        0.5, "log evidence by which another term must be likelier to be exchanged for", "a refit may differ"
    )
    exchanges: int = option(2, "most exchanges of terms", "two suffice mostly")
    names_for_process: int = option(3, "most names that take the place of a process", "as many orders as gears have")
    estimates: int = option(4, "most estimates of tried numbers beside the others", "each comes closer")
    listed: int = option(6, "most alternatives of a term", "fits on a screen")
    most_terms: int = option(
        8, "terms of one group of rows from which none is added", "bounds the time; more were never true in a trial"
    )
    first_samples: int = option(500, "samples that are searched first", "12 of 18 terms of real data are found there")
    most_samples: int = option(2000, "samples of a search; all samples then fit its terms", "bounds the time")
    impossible: float = option(3.0, "standard deviations outside its bounds from which a name falls", "one in 700")
    # spectrum
    highest_order: float = option(400.0, "highest order of a spectrum", "twice the ratio of strain-wave gears to 200")
    lowest_order: float = option(1.0, "lowest order of a spectrum", "less than a turn is an offset and a slope")
    exact_below: float = option(12.0, "order below which gains are exact", "the nuisance is confounded with low orders")
    other_orders: int = option(3, "other orders that are reported beside one that explains no more", "fits on a screen")
    kept_lines: int = option(4, "peaks of a spectrum that are scored exactly", "side lobes are lower than these")
    # final estimates
    whole_within: float = option(2.0, "standard deviations within which an order is taken as whole", "95 %")

    @property
    def rough(self) -> "EngineOptions":
        """For the fits of a search: of the many models that it compares most are not true.

        They are neither linearised anew nor fitted to more digits than a comparison needs.
        """
        return replace(
            self, relinearisations=0, settled=self.compared, steps=self.compared_steps, stale=self.compared_stale
        )


DEFAULTS = EngineOptions()
"""The options as they are documented."""
