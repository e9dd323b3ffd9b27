"""Truths, diagnoses and rows of concealed trials, made by hand, and diagnoses as an oracle would give them."""

import numpy as np

from benchmarks.concealed.campaign import score
from benchmarks.torque_trials import plans
from benchmarks.torque_trials.effects import FAMILIES

COMMON = {"seed": 1, "index": 4, "kind": "single", "engine": "plain", "arm": "lite6", "fault": "", "sizes": [2.0]}
TRUTH = COMMON | {
    "sensor": "tracker",
    "moving": False,
    "geometry": "known",
    "mounted": False,
    "noise": "as declared",
    "moved_rms_m": 1e-4,
    "noise_m": 2e-5,
    "noise_rad": 1e-4,
    "oracle": {"unseen_position_rms_m": 1e-6, "unseen_rotation_rms_rad": 1e-6},
    "unseen_position_m": [[0.1, 0.2, 0.3], [0.2, 0.2, 0.2]],
}
TORQUE_TRUTH = COMMON | {
    "inertial": "declared",
    "source": "torque",
    "noise": "white",
    "edge": "",
    "sealed": False,
    "rows": 1000,
    "fault_rows": [],
    "fault_joints": [],
    "fault_numbers": {},
    "unseen_bound_Nm": 0.01,
    "unseen_torque_Nm": [[1.0, 2.0], [3.0, 4.0]],
}


def a_hidden(name, site, parameters, **more):
    rest = {"fixed": {}, "bound": {}, "size": 2.0, "seen": 1.0, "moved_m": 1e-4, "moved_Nm": 0.1, "rival": None}
    return {"effect": name, "site": site, "parameters": parameters} | rest | more


def a_finding(name, site, gain=10.0, rivals=(), driver="none", std=0.1, **parameters):
    return {
        "effect": name,
        "site": site,
        "parameters": {key: {"value": value, "std": std} for key, value in parameters.items()},
        "p_value": 1e-3,
        "log_likelihood_gain": gain,
        "confusable_with": [{"effect": n, "site": s, "log_likelihood_gap": gap} for n, s, gap in rivals],
        "driver": driver,
    }


def a_diagnosis(*findings, faults=()):
    return {
        "findings": list(findings),
        "data_faults": list(faults),
        "verdict": "explained" if findings else "consistent",
        "before": {"heldout_position_rms_m": 1e-4, "heldout_torque_rms_Nm": 1.0},
        "after": {"heldout_position_rms_m": 4e-5, "heldout_torque_rms_Nm": 0.5},
        "noise": {},
        "nearest": {"effect": "joint_lag", "site": "joint1", "p_value": 0.4},
    }


def a_row(hidden=(), *findings, kind="single", faults=(), fault="", size=2.0, index=4, noise="as declared"):
    """Of a trial of poses, whose unseen positions are predicted exactly."""
    truth = TRUTH | {"kind": kind, "hidden": list(hidden), "fault": fault, "index": index, "noise": noise}
    truth |= {"sizes": [size] if hidden else []}
    said = {"x_m": [0.1, 0.2], "y_m": [0.2, 0.2], "z_m": [0.3, 0.2]}
    found = a_diagnosis(*findings, faults=[{"fault": each} for each in faults])
    return score(truth, found, said, 1.0, "") | {"sha256": "0" * 64}


WAVE = a_hidden(
    "joint_harmonic", "joint3", {"order": 12.0, "amplitude_rad": 1e-4, "phase_rad": 3.1}, bound={"phase_rad": 0.1}
)


# ------------------------------------------------------------------ answers to torque trials


CONTACT = next(
    i
    for i in plans.ROUNDS.indices(4, 30, "faulty")
    if plans.draw_plan(4, i, np.random.default_rng(0)).fault == "contact"
)
"""Of seed 4, the first trial of torques with a contact."""


def the_oracle(truth, rng):
    """The truth, its numbers off by as much as those of the best estimate; beyond two deviations no order is right."""
    findings = []
    for effect in truth["hidden"]:
        if effect["effect"] in FAMILIES:
            if not effect["nameless"]:
                findings.append(a_finding("unnamed", effect["site"], driver=effect["drivers"][0][0]))
            continue
        finding = a_finding(effect["effect"], effect["site"], std=0.0, **effect["parameters"])
        for name, bound in effect["bound"].items():
            off = bound * float(np.clip(rng.normal(), -1.9, 1.9))
            finding["parameters"][name] = {"value": effect["parameters"][name] + off, "std": bound}
        findings.append(finding)
    wanted = truth["fault_numbers"]
    numbers = {"joints": truth["fault_joints"]} | wanted | {"found_m_per_s2": wanted.get("gravity_m_per_s2")}
    faults = [{"fault": truth["fault"], "rows": truth["fault_rows"], "numbers": numbers}] if truth["fault"] else []
    return a_diagnosis(*findings, faults=faults)


def nothing_said(truth, rng):
    return a_diagnosis()


def wrongly_named(truth, rng):
    """A spring or a friction at the first joint, whichever is not hidden there."""
    there = {effect["effect"] for effect in truth["hidden"] if effect["site"] == "joint1"}
    return a_diagnosis(a_finding("joint_spring" if "viscous_friction" in there else "viscous_friction", "joint1"))


def the_prediction(truth, off=0.0):
    torque = np.array(truth["unseen_torque_Nm"]) + off
    return {f"tau{i + 1}_Nm": column.tolist() for i, column in enumerate(torque.T)}


# ------------------------------------------------------------------ what workers do in place of a diagnosis


def refusing(given):
    """No diagnosis."""
    raise OSError("no diagnosis here")


def listing(given):
    """No diagnosis, and the files that it is given."""
    raise OSError(" ".join(sorted(path.name for path in given.iterdir())))


def dying(given):
    """The end of the process."""
    import os

    os._exit(1)
