"""How the site and the form of a family are drawn from what an arm does."""

import numpy as np

from benchmarks.concealed.outside.family import Fixed, Signals, column
from benchmarks.concealed.outside.opened import FAMILIES

_LEAST_LOAD = 0.05
"""Nm below which a load is none."""


def drawn(name: str, rng: np.random.Generator, s: Signals) -> tuple[str, dict[str, float]] | None:
    """A site of a family and what else belongs to its form; None where no load acts that it needs."""
    family, dof = FAMILIES[name], s.q.shape[1]
    joint = int(rng.integers(1, dof + 1))
    # the last link is the flange, to which the tool is fixed
    if family.place == "link":
        joint = int(rng.integers(1, dof))
    fixed = {"joint": float(joint)} if family.place in ("joint", "link") else {}
    # a base that tilts by joint 1 is an axis of joint 1 that wobbles, a tool that turns by the last joint likewise
    held = {"base": 1, "tool": dof}.get(family.place, joint)
    others = rng.permutation([k for k in range(1, dof + 1) if k != held])
    if family.skipping:
        others = others[others != joint + 1]
    q = s.q[:, joint - 1]
    for key in family.keys:
        match key:
            case "by" | "and":
                fixed[key] = float(others[int(key == "and")])
            case "power":
                fixed[key] = 2.0
            case "span_s":
                fixed[key] = float(s.time[-1])
            case "instant_s":
                fixed[key] = float(rng.uniform(0.3, 0.7) * s.time[-1])
            case "turns":
                fixed[key] = float(rng.uniform(1.5, 3.5))
            case "phase":
                fixed[key] = float(rng.uniform(-np.pi, np.pi))
            case "centre":
                fixed[key] = float(np.percentile(q, rng.uniform(20, 80)))
            case "width":
                fixed[key] = float(rng.uniform(0.15, 0.35))
            case "at":
                fixed[key] = float(np.percentile(q, rng.uniform(25, 75)))
            case "stop":
                fixed[key] = float(np.percentile(q, rng.uniform(55, 80)))
            case "slack":
                fixed[key] = float(np.percentile(np.abs(column(s.q, fixed, "by")), rng.uniform(30, 60)))
            case "buckles":
                fixed[key] = float(np.percentile(s.warmth(), rng.uniform(30, 60)))
            case "over":
                fixed[key] = float(np.percentile(column(s.q, fixed, "by"), rng.uniform(35, 65)))
            case "fades":
                fixed[key] = float(np.percentile(np.abs(s.dq[:, joint - 1]), rng.uniform(20, 50)))
            case "limit":
                fixed[key] = float(np.percentile(np.abs(s.dq[:, joint - 1]), rng.uniform(40, 70)))
            case "snaps":
                fixed[key] = float(np.percentile(s.warmth(), rng.uniform(35, 65)))
            case "passes_s":
                fixed[key] = float(rng.uniform(0.06, 0.15) * s.time[-1])
            case "hums":
                speed = np.abs(column(s.dq, fixed, "by"))
                band = float(rng.uniform(0.1, 0.2) * np.percentile(speed, 95))
                fixed |= {"hums": float(np.percentile(speed, rng.uniform(35, 75))), "band": band}
            case "strokes":
                fixed[key] = float(rng.uniform(5.0, 9.0))
            case "relaxes_s":
                # some poses at rest, or as long as it takes to come somewhere else
                fixed[key] = float(rng.uniform(2.0, 6.0) * max(s.time[1] - s.time[0], 0.3))
            case "flange":
                fixed[key] = float(dof)
            case "lower":
                start = rng.uniform(10, 50)
                fixed |= {"lower": float(np.percentile(q, start)), "upper": float(np.percentile(q, start + 35))}
            case _:
                load = {
                    "torque_Nm": s.moment[:, joint - 1, 2],
                    "moment_Nm": s.moment[:, joint - 1, 0],
                    "by_torque_Nm": s.moment[:, int(fixed.get("by", joint)) - 1, 2],
                    "flange_moment_Nm": s.moment[:, -1, 0],
                    "base_moment_Nm": s.base_moment[:, 0],
                    "base_moment_y_Nm": s.base_moment[:, 1],
                }[key]
                fixed[key] = float(np.percentile(np.abs(load), 90))
                if fixed[key] < _LEAST_LOAD:
                    return None
    if family.axes:
        fixed["axis"] = float(rng.choice(family.axes))
    site = {"joint": f"joint{joint}", "link": f"link{joint}", "image": "sensor"}.get(family.place, family.place)
    return site, fixed


def straight(fixed: Fixed) -> dict[str, float] | None:
    """The form of the named effect that is the straight line of a family; None where there is none."""
    return {**fixed, "power": 1.0} if "power" in fixed else None
