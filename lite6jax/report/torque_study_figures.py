"""A figure of a designed motion: each joint's position over time, and what it is worth beside random motions."""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from lite6jax.identifiability.torque.discrimination import TorqueDiscrimination
from lite6jax.identifiability.torque.planning import TorquePlan
from lite6jax.report.canvas import AFTER, BEFORE, OKABE_ITO, STYLE, blank
from lite6jax.report.cells import joint_units


def designed_motion(found: TorquePlan | TorqueDiscrimination, title: str) -> Figure:
    """Joint positions over time; below, standard deviations or distances: designed and random."""
    made = found.trajectory
    with rc_context(STYLE):
        figure = blank(11.0, 8.4)
        upper, lower = figure.subplots(2, 1)
        scales, units = joint_units(found.room.arm.sliding, found.room.arm.dof)
        for joint, q in enumerate(np.asarray(made.motion.q)):
            upper.plot(
                made.time,
                scales[joint] * q,
                color=OKABE_ITO[joint % len(OKABE_ITO)],
                linewidth=2,
                label=f"joint {joint + 1}",
            )
        upper.set(xlabel="time (s)", ylabel=f"position ({' or '.join(dict.fromkeys(units))})")
        upper.legend(frameon=False, ncols=2, loc="center left", bbox_to_anchor=(1.0, 0.5))
        if isinstance(found, TorquePlan):
            base = found.identification.structure.base
            scale = np.array([item.scale for item in base])
            random = np.array([other.standard_deviation for other in found.random]) / scale
            low, middle, high = np.quantile(random, (0.05, 0.5, 0.95), axis=0, method="nearest")
            at = np.arange(len(base))
            there = np.isfinite(high)
            lower.vlines(at[there], low[there], high[there], color=BEFORE, alpha=0.4, linewidth=5)
            lower.plot(
                at, np.where(np.isfinite(middle), middle, np.nan), "_", color=BEFORE, label="random, median, 90 %"
            )
            designed = found.identification.standard_deviation / scale
            lower.plot(at, np.where(np.isfinite(designed), designed, np.nan), "o", color=AFTER, label="designed")
            lower.set_yscale("log")
            lower.set_xticks(at, [item.name for item in base], rotation=90, fontsize=8)
            lower.set_ylabel("std. deviation\n(of typical size)")
            what = "motion whose torques determine the arm"
        else:
            lower.hist(found.random_distance, bins=20, color=BEFORE, alpha=0.6, label="random")
            lower.axvline(found.distance, color=AFTER, linewidth=3, label="designed")
            lower.set(xlabel="distance between the models (standard deviations)", ylabel="motions")
            what = f"motion to discriminate between {found.rivals[0]} and {found.rivals[1]}"
        lower.legend(frameon=False)
        figure.suptitle(f"{title}: {what}", fontsize=15)
    return figure
