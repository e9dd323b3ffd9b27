"""Thresholds that several modules of estimation and search share, each with the reason for its value.

Evidence is in log-likelihood.
"""

CLOSE = 6.0
"""Log-likelihood within which two models are not distinguished: a likelihood ratio of 400."""
CONFOUNDED = 1e-6
"""Share of a column's square, outside the span of nuisance and model, below which it is confounded.

A thousandth of its length: linearisation errors are as large.
"""
EIGENVALUE_ROUNDING = 1e-12
"""Relative eigenvalue below which a direction is rounding: the square of the rounding of residuals."""
MARGIN = 3.0
"""Log evidence that a term must gain beyond the cost of its choice: odds of twenty."""
BETTER = 0.5
"""Log evidence by which another term must be likelier to be exchanged for, as a refit may differ."""
EXCHANGES = 2
"""Most exchanges of terms; two suffice mostly."""
LISTED = 6
"""Most alternatives of a term, which fit on a screen."""
IMPOSSIBLE = 3.0
"""Standard deviations outside its bounds from which a name falls: noise does as much once in 700."""
LOWEST_ORDER = 1.0
"""Lowest order of a spectrum; less than a turn is an offset and a slope."""
EXACT_BELOW = 12.0
"""Order below which the gains of a spectrum are exact, as the nuisance is confounded with low orders."""
