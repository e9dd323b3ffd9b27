"""Truths, diagnoses and rows of concealed trials, made by hand."""

from benchmarks.concealed.campaign import scored

TRUTH = {
    "seed": 1,
    "index": 4,
    "kind": "single",
    "engine": "plain",
    "arm": "lite6",
    "sensor": "tracker",
    "moving": False,
    "geometry": "known",
    "mounted": False,
    "noise": "as declared",
    "fault": "",
    "sizes": [2.0],
    "moved_rms_m": 1e-4,
    "noise_m": 2e-5,
    "noise_rad": 1e-4,
    "oracle": {"unseen_position_rms_m": 1e-6, "unseen_rotation_rms_rad": 1e-6},
    "unseen_position_m": [[0.1, 0.2, 0.3], [0.2, 0.2, 0.2]],
    "unseen_quaternion": [[1.0, 0, 0, 0], [0, 1.0, 0, 0]],
}


def a_hidden(name, site, parameters, **more):
    rest = {"fixed": {}, "bound": {}, "size": 2.0, "seen": 1.0, "moved_m": 1e-4, "rival": None}
    return {"effect": name, "site": site, "parameters": parameters} | rest | more


def a_finding(name, site, gain=10.0, rivals=(), p=1e-3, driver="none", **parameters):
    said = {key: {"value": value, "std": 0.1} for key, value in parameters.items()}
    others = [{"effect": n, "site": s, "log_likelihood_gap": gap} for n, s, gap in rivals]
    return {
        "effect": name,
        "site": site,
        "parameters": said,
        "p_value": p,
        "log_likelihood_gain": gain,
        "confusable_with": others,
        "driver": driver,
    }


def a_diagnosis(*findings, faults=()):
    return {
        "findings": list(findings),
        "data_faults": [{"fault": fault} for fault in faults],
        "verdict": "explained",
        "before": {"heldout_position_rms_m": 1e-4},
        "after": {"heldout_position_rms_m": 4e-5},
        "noise": {},
        "nearest": {"effect": "joint_lag", "site": "joint1", "p_value": 0.4},
    }


def a_row(hidden=(), *findings, kind="single", faults=(), fault="", size=2.0, index=4, noise="as declared", off=0.0):
    truth = TRUTH | {"kind": kind, "hidden": list(hidden), "fault": fault, "index": index, "noise": noise}
    truth |= {"sizes": [size] if hidden else []}
    said = {"x_m": [0.1 + off, 0.2], "y_m": [0.2, 0.2], "z_m": [0.3, 0.2]}
    said |= {"qw": [1.0, 0.0], "qx": [0.0, -1.0], "qy": [0.0, 0.0], "qz": [0.0, 0.0]}
    return scored(truth, a_diagnosis(*findings, faults=faults), said, 1.0, "") | {"sha256": "0" * 64}


WAVE = a_hidden(
    "joint_harmonic", "joint3", {"order": 12.0, "amplitude_rad": 1e-4, "phase_rad": 3.1}, bound={"phase_rad": 0.1}
)
