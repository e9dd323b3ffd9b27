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
    numbers = {"joints": truth["fault_joints"]}
    faults = [{"fault": truth["fault"], "rows": truth["fault_rows"], "numbers": numbers}] if truth["fault"] else []
    return a_document(findings, faults, after=0.5 if findings else 1.0)


def nothing_said(truth, rng):
    return a_document([], after=1.0)


def wrongly_named(truth, rng):
    """A friction at the first joint that is not hidden, whatever is."""
    sites = {effect["site"] for effect in truth["hidden"]}
    site = next(f"joint{k}" for k in range(1, 7) if f"joint{k}" not in sites)
    return a_document([a_finding("viscous_friction", site, {"viscous_Nm_s_per_rad": {"value": 1.0, "std": 0.1}})])


def the_prediction(truth, off=0.0):
    torque = np.array(truth["unseen_torque_Nm"]) + off
    return {f"tau{i + 1}_Nm": column.tolist() for i, column in enumerate(torque.T)}
