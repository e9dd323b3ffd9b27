"""Thresholds that several screens of pose recordings share, each with its unit and the reason for its value."""

SUSPECT_REACH = 0.01
"""Share of the reach: a larger median error is suspect, as physics moves the tool less."""
PUBLISHED_TOLERANCE = 2e-5
"""m and rad within which a chain is a published table, whose angles have four decimals."""
JUMP_LEVEL = 1e-6
"""Chance of the best row of a jump, and of the next move; rows depend on each other by unknown physics."""
AS_NOISE_RATIO = 2.0
"""Error over the declared noise up to which it is noise, set on real arms."""
MOST_FITTED = 2000
"""Rows that fit the rigid arm, spread evenly; more change no decision."""
MOST_SAMPLES = 1500
"""Samples on which columns of physics are compared; more change no decision."""
OBSERVABLE_SHARE = 1e-6
"""Share of its square that a confounded column keeps: 0.001 of its length."""
REFINEMENTS = 6
"""Linearisations of a correction; two suffice for most."""
