"""Formulas of the families that are sealed, written down a second time: not to be read before these were drawn."""

import numpy as np

from tests.outside_signals import base_moment, beyond, late, played, rise, rising, torque, wave

FORMULAS = {
    "vernier_disc": (
        "joint3",
        {"turns": 2.5, "phase": 0.4},
        lambda s, m: (2.5 * m.q[:, 2] + 0.4) / 6.283185307179586 - np.floor((2.5 * m.q[:, 2] + 0.4) / (2 * np.pi)),
    ),
    "uneven_planets": (
        "joint3",
        {"torque_Nm": 3.0, "phase": 0.4},
        lambda s, m: torque(s, m, 3)[:, 2] * wave(3 * m.q[:, 2]) / 3,
    ),
    "binding_pinion": (
        "joint3",
        {"by": 5.0},
        lambda s, m: np.where(np.sign(m.dq[:, 2]) == np.sign(m.dq[:, 4]), 0.0, 1.0),
    ),
    "shared_clutch": (
        "joint3",
        {"by": 2.0, "torque_Nm": 3.0, "by_torque_Nm": 4.0},
        lambda s, m: beyond(torque(s, m, 3)[:, 2] / 3 + torque(s, m, 2)[:, 2] / 4, 0.5),
    ),
    "straining_motor": (
        "joint3",
        {"torque_Nm": 3.0},
        lambda s, m: -m.dq[:, 2] * np.sqrt(torque(s, m, 3)[:, 2] ** 2 / 9),
    ),
    "pinched_cable": (
        "joint3",
        {"by": 2.0, "by_torque_Nm": 3.0},
        lambda s, m: np.where(m.dq[:, 2] > 0, -1.0, 1.0) * np.sqrt(torque(s, m, 2)[:, 2] ** 2 / 9),
    ),
    "flying_weights": ("joint3", {"by": 5.0, "hums": 0.3}, lambda s, m: abs(beyond(m.dq[:, 4], 0.3))),
    "flung_forearm": (
        "link3",
        {"axis": 0.0, "by": 5.0, "and": 2.0},
        lambda s, m: m.dq[:, 4] ** 2 + 2 * m.dq[:, 4] * m.dq[:, 1] + m.dq[:, 1] ** 2,
    ),
    "thick_casting": ("link3", {"axis": 4.0, "span_s": 2.0}, lambda s, m: rise(m) - late(rise(m), m, 1 / 3)),
    "pulsing_hose": (
        "link3",
        {"axis": 4.0, "by": 5.0, "span_s": 2.0, "turns": 1.5, "phase": 0.4},
        lambda s, m: np.where(wave(1.5 * np.pi * m.time) > 0, m.q[:, 4], 0.0),
    ),
    "two_lines": ("link3", {"axis": 3.0, "by": 1.0, "and": 4.0}, lambda s, m: m.q[:, [0, 3]].max(1)),
    "twisted_channel": (
        "link3",
        {"axis": 4.0, "moment_Nm": 2.0, "torque_Nm": 3.0},
        lambda s, m: torque(s, m, 3)[:, 0] * torque(s, m, 3)[:, 2] / 6,
    ),
    "sunlit_link": ("link3", {"axis": 3.0, "by": 2.0, "phase": 0.4}, lambda s, m: wave(m.q[:, 1]).clip(min=0)),
    # the real part of a cube
    "three_legged_stand": (
        "base",
        {"axis": 3.0, "base_moment_Nm": 2.0, "base_moment_y_Nm": 2.0},
        lambda s, m: (
            base_moment(s, m)[:, 0]
            * (base_moment(s, m)[:, 0] ** 2 - 3 * base_moment(s, m)[:, 1] ** 2)
            / (2 * np.sum(base_moment(s, m)[:, :2] ** 2, 1))
        ),
    ),
    "sticking_plinth": ("base", {"axis": 0.0}, lambda s, m: played(rise(m), 0.4)),
    "warped_plate": (
        "base",
        {"axis": 2.0, "base_moment_Nm": 2.0, "base_moment_y_Nm": 3.0},
        lambda s, m: base_moment(s, m)[:, :2].prod(1) / 6,
    ),
    "twisted_umbilical": (
        "tool",
        {"axis": 4.0, "by": 2.0, "and": 4.0},
        lambda s, m: m.q[:, 1] ** 2 + 2 * m.q[:, 1] * m.q[:, 3] + m.q[:, 3] ** 2,
    ),
    "rubber_mount": (
        "tool",
        {"axis": 3.0, "flange": 6.0, "flange_moment_Nm": 0.01, "relaxes_s": 0.5},
        lambda s, m: 100 * late(torque(s, m, 6)[:, 0], m, 0.5),
    ),
}
IMAGES = {
    "bowing_bar": lambda p, m: np.einsum("sa,s,s->sa", p, p[:, 2], rise(m)),
    "stitched_volume": lambda p, m: rising(p[:, [0]] / 0.05) * [0.0, 0.0, 1.0],
}
