"""The figure of a verification: the difference between the controller's kinematics and the calibration."""

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from lite6jax.controller.verification import GATE_M, Verification
from lite6jax.report.canvas import AFTER, STYLE, degree_ticks
from lite6jax.report.panels import dots, label_first_column, panels_in_rows


def verification_figure(verification: Verification, title: str) -> Figure:
    """The position difference from the controller against each joint, in nm, µm or mm."""
    q, position = verification.joint_position, verification.position
    joints = q.shape[1]
    most = float(position.max())
    scale, unit = (1e9, "nm") if most < 1e-6 else (1e6, "µm") if most < 1e-3 else (1e3, "mm")
    with rc_context(STYLE):
        figure, panels = panels_in_rows(joints, shared=True)
        for joint, panel in enumerate(panels):
            dots(panel, np.rad2deg(q[:, joint]), scale * position, AFTER)
            if 2 * most > GATE_M:
                panel.axhline(scale * GATE_M, color="black", linewidth=1.5)
            panel.set_xlabel(f"joint {joint + 1} (deg)")
            panel.xaxis.set_major_locator(degree_ticks(panel))
            label_first_column(panel, f"difference ({unit})")
        panels[0].set_ylim(0, 1.08 * scale * most or 1.0)
        figure.suptitle(f"{title}: controller's forward kinematics against the calibration", fontsize=15)
    return figure
