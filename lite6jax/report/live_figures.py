"""The figure of a verification: the difference between the controller's kinematics and the calibration."""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from lite6jax.controller.verification import GATE_M, Verification
from lite6jax.report.canvas import AFTER, STYLE, blank, degree_ticks, thinned


def verification_figure(verification: Verification, title: str) -> Figure:
    """The position difference from the controller against each joint, in nm, µm or mm."""
    q, position = verification.joint_position, verification.position
    joints = q.shape[1]
    columns = 4 if joints > 6 else 3
    rows = -(-joints // columns)
    most = float(position.max())
    scale, unit = (1e9, "nm") if most < 1e-6 else (1e6, "µm") if most < 1e-3 else (1e3, "mm")
    with rc_context(STYLE):
        figure = blank(3.0 + 3.0 * columns, 3.2 * rows + 1.0)
        panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
        shown = thinned(len(position))
        for joint, panel in enumerate(panels[:joints]):
            panel.plot(
                np.rad2deg(q[shown, joint]), scale * position[shown], ".", color=AFTER, markersize=5, alpha=0.5,
                markeredgewidth=0, rasterized=True,
            )  # fmt: skip
            if 2 * most > GATE_M:
                panel.axhline(scale * GATE_M, color="black", linewidth=1.5)
            panel.set_xlabel(f"joint {joint + 1} (deg)")
            panel.xaxis.set_major_locator(degree_ticks(panel))
            if joint % columns == 0:
                panel.set_ylabel(f"difference ({unit})")
        panels[0].set_ylim(0, 1.08 * scale * most or 1.0)
        for panel in panels[joints:]:
            panel.set_visible(False)
        figure.suptitle(f"{title}: controller's forward kinematics against the calibration", fontsize=15)
    return figure
