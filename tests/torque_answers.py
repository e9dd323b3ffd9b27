"""Diagnoses of torque trials as an oracle would give them that has seen the truth, and as bad ones would."""

import numpy as np

from benchmarks.torque_trials.outside import FAMILIES


def a_document(findings, faults=(), after=0.5):
    return {
        "findings": findings,
        "data_faults": list(faults),
        "verdict": "explained" if findings else "consistent",
        "before": {"heldout_torque_rms_Nm": 1.0},
        "after": {"heldout_torque_rms_Nm": after},
    }


def a_finding(name, site, parameters=None, driver=""):
    return {
        "effect": name,
        "site": site,
        "parameters": parameters or {},
        "p_value": 1e-6,
        "log_likelihood_gain": 50.0,
        "confusable_with": [],
        "driver": driver,
    }


def the_oracle(truth, rng):
    """The truth, its numbers off by as much as those of the best estimate; beyond two deviations no order is right."""
    findings = []
    for effect in truth["hidden"]:
        if effect["effect"] in FAMILIES:
            if not effect["nameless"]:
                findings.append(a_finding("unnamed", effect["site"], driver=effect["drivers"][0][0]))
            continue
        said = {name: {"value": value, "std": 0.0} for name, value in effect["parameters"].items()}
        for name, bound in effect["bound"].items():
            said[name] = {
                "value": effect["parameters"][name] + bound * float(np.clip(rng.normal(), -1.9, 1.9)),
                "std": bound,
            }
        findings.append(a_finding(effect["effect"], effect["site"], said))
    wanted = truth["fault_numbers"]
    numbers = {"joints": truth["fault_joints"]} | wanted | {"found_m_per_s2": wanted.get("gravity_m_per_s2")}
    faults = [{"fault": truth["fault"], "rows": truth["fault_rows"], "numbers": numbers}] if truth["fault"] else []
    return a_document(findings, faults, after=0.5 if findings else 1.0)


def nothing_said(truth, rng):
    return a_document([], after=1.0)


def wrongly_named(truth, rng):
    """A spring or a friction at the first joint, whichever is not hidden there."""
    there = {effect["effect"] for effect in truth["hidden"] if effect["site"] == "joint1"}
    name, number = ("viscous_friction", "viscous_Nm_s_per_rad")
    if name in there:
        name, number = ("joint_spring", "stiffness_Nm_per_rad")
    return a_document([a_finding(name, "joint1", {number: {"value": 1.0, "std": 0.1}})])


def the_prediction(truth, off=0.0):
    torque = np.array(truth["unseen_torque_Nm"]) + off
    return {f"tau{i + 1}_Nm": column.tolist() for i, column in enumerate(torque.T)}
