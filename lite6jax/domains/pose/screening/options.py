"""Every threshold of the screening of pose recordings, each with its meaning, its unit and the reason for its value."""

from dataclasses import dataclass
from typing import final

from lite6jax.estimation.documented import option
from lite6jax.estimation.prior import PRIOR, Prior


@final
@dataclass(frozen=True)
class ScreeningOptions:
    """Thresholds of the screening of pose recordings. Probabilities are those of a whole recording.

    Reasons that begin with "set on" refer to simulated recordings of arms with and without each fault.

    Attributes:
        prior: the probabilities of explanations before any data: what a correction must gain is its cost.
    """

    prior: Prior = PRIOR

    # rows
    cluster_distances: float = option(
        5.0, "median distances of a row in its right unit", "in mm it is 1000 times as far"
    )
    suspect_distances: float = option(10.0, "the same, beyond which a row may be in mm", "no pose is so far")
    near_share: float = option(0.005, "share of the median distance that suspect rows have", "few poses are so near")
    near_distances: float = option(2.0, "as cluster_distances, of rows too near", "most origins lie beside the poses")
    most_in_another_unit: float = option(0.5, "share of the rows that may be too near", "the rest shows the right unit")
    computed_rad: float = option(1e-5, "rad to which a table gives computed orientations", "columns of five decimals")
    grid_tolerance_rad: float = option(6e-7, "rad from a grid of commanded positions", "radians of six decimals")
    grid_smallest_rad: float = option(1e-3, "rad below which positions are left out", "they are near every grid")
    grid_positions: int = option(20, "distinct positions that must all lie on a grid", "fewer do so by chance")
    limit_slack_rad: float = option(0.01, "rad that a joint may be beyond its limits", "controllers stop a little late")
    # placeholders
    placeholder_misses: float = option(10.0, "median errors by which the nominal arm misses one", "outliers are nearer")
    placeholder_apart: float = option(0.1, "share of the spread over which one value is seen", "noise is far below")
    most_placeholders: float = option(0.5, "share of the rows that are beyond limits", "of more the limits are wrong")
    # columns
    suspect_reach: float = option(0.01, "share of the reach: a larger median error is suspect", "physics moves it less")
    suspect_noise: float = option(10.0, "the same in standard deviations of the sensor", "noise alone is below four")
    column_gain: float = option(5.0, "ratio by which a correction reduces the median error", "set beside large physics")
    corrected_reach: float = option(0.05, "share of the reach that is left then", "a clock offset in a fast motion")
    equal_ratio: float = option(1.5, "ratio of errors of corrections that are alike", "wrong columns differ more")
    equal_noise: float = option(0.1, "the same difference, in standard deviations", "below the scatter of a median")
    column_rows: int = option(200, "rows on which single changes are compared", "their median is known to a tenth")
    pair_rows: int = option(60, "rows on which several changes are compared", "there are a thousand of them")
    pairs_first: int = option(8, "best hypotheses that are joined with more changes, or fitted", "bounds the time")
    zeros_first: int = option(3, "best hypotheses beside which zeros of any angle are fitted", "each takes a fit")
    unfitted_ratio: float = option(
        2.0, "ratio to the allowed error up to which one is fitted", "closed forms are rough"
    )
    fitted_ratio: float = option(3.0, "ratio to the least error up to which one is fitted", "a fit reorders few")
    clearly_nearer: float = option(20.0, "ratio of errors by which another arm agrees better", "arms differ by some cm")
    most_changes: int = option(3, "faults that a hypothesis joins, a set of signs counted as one", "bounds the time")
    worth_another: float = option(0.7, "ratio by which another change reduces the error", "a right change halves it")
    beyond_granted: float = option(
        8.0, "times what factories grant, from which a fitted arm is not the declared one", "real arms are below five"
    )
    least_gross: float = option(
        3.0,
        "times what factories grant, from which a zero, a frame or a tool is a fault",
        "chains of one's own are below",
    )
    least_scale: float = option(1.005, "ratio from which a sensor's scale is sought as a fault", "physics is below")
    largest_scale: float = option(1100.0, "the same up to which", "millimetres that are read as metres")
    # nominal table
    published_tolerance: float = option(2e-5, "m and rad within which a chain is a table", "angles of four decimals")
    share_std: float = option(0.1, "standard deviation of a vague share of the way to a table", "a tenth of the way")
    share_tolerance: float = option(0.1, "the share's distance from 1, beside 4 deviations", "arms differ from tables")
    share_sigmas: float = option(6.0, "deviations of the share from 0", "tables differ hardly more than physics")
    table_ratio: float = option(0.5, "ratio of residuals that decides a vague share", "physics rarely halves them")
    # frame jumps
    most_jumps: int = option(3, "jumps that are corrected", "a mount that slips more often must be repaired")
    jump_level: float = option(1e-6, "chance of the best row, and of the next move", "rows depend by unknown physics")
    jump_margin: int = option(8, "rows on either side of a jump", "six numbers are estimated from them")
    jump_noise: float = option(1.0, "standard deviations of the sensor that a jump displaces", "less does no harm")
    jump_share: float = option(0.03, "squares that a jump explains over the freedom", "set on data without a jump")
    jump_window: int = option(12, "rows on either side that show a jump in motion", "a quarter of a second at 50 Hz")
    jump_sharpness: float = option(1.5, "ratio of the step at its row to others", "an arm's own physics is smooth")
    tool_advantage: float = option(1.05, "ratio by which one of the tool explains more", "bases are knocked more often")
    jump_blocks: int = option(300, "blocks of rows between which jumps are first sought", "bounds the time")
    large_jump_noise: float = option(20.0, "standard deviations that start in closed form", "a linear step fails")
    # unsettled read-outs
    settling_level: float = option(1e-4, "chance of the best shape, and of a joint's number", "three shapes are tested")
    settling_share: float = option(0.01, "share of the freedom that they explain", "poses in an order mimic less")
    separate_share: float = option(0.03, "share that joints explain beyond a common number", "set on equal servos")
    next_move_share: float = option(0.1, "share that the next move explains beyond the last", "poses are ordered then")
    numbers_per_piece: int = option(10, "measured numbers for each piece of a curve", "each is then known to a third")
    fewest_pieces: int = option(4, "fewest pieces of a curve beside the moves", "fewer are in the harmonics")
    most_pieces: int = option(16, "pieces of a curve at most", "finer ones only take time")
    # check
    mostly_explained: float = option(0.8, "share of the squared error at which a cause is likely", "set on real arms")
    partly_explained: float = option(0.3, "share of the squared error at which it is possible", "set on real arms")
    as_noise_ratio: float = option(2.0, "error over the declared noise up to which it is noise", "set on real arms")
    # estimation
    most_fitted: int = option(2000, "rows that fit the rigid arm, spread evenly", "more change no decision")
    most_samples: int = option(1500, "samples on which columns of physics are compared", "more change no decision")
    observable_share: float = option(1e-6, "share of its square that a confounded column keeps", "0.001 of the length")
    huber_sigmas: float = option(4.0, "deviations per number beyond which one counts less", "one normal one in 16 000")
    refinements: int = option(6, "linearisations of a correction", "two suffice for most")
    converged: float = option(0.1, "standard deviations of the last step", "below what the correction is known to")
