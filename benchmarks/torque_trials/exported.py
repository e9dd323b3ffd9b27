"""Trials written with their truths beside them, in the form of the open cases: to look for what went wrong."""

from pathlib import Path

from benchmarks.campaigns.campaign import Row, sealed_text, write_files
from benchmarks.campaigns.columns import csv_text
from benchmarks.torque_trials.trials import draw

_NAMES = {"link_mass": "link_mass_error", "link_com": "link_com_error", "time_offset": "torque_delay"}
_ARGUMENTS = {
    "viscous_Nm_s_per_rad": "b",
    "coulomb_Nm": "c",
    "stribeck_Nm": "s",
    "velocity_rad_per_s": "v",
    "coefficient": "mu",
    "viscous_Nm_s_per_rad_K": "k",
    "source_joint": "source",
    "offset_Nm": "o",
    "scale": "s",
    "inertia_kg_m2": "I",
    "stiffness_Nm_per_rad": "k",
    "rest_rad": "rest",
    "amplitude_Nm": "amplitude",
    "order": "order",
    "phase_rad": "phase",
    "mass_kg": "mass",
    "tilt_x_rad": "rx",
    "tilt_y_rad": "ry",
    "offset_s": "dt",
    "lag_s": "lag",
}
"""What the open cases call the numbers of an effect."""


def export(seed: int, index: int, sealed: bool, folder: Path) -> Path:
    """Writes a trial into a folder of its own, which is named; an open truth, and that of the unseen motion, beside it.

    Args:
        seed: of the campaign.
        index: of the trial in it.
        sealed: whether what is outside the catalogue is of the sealed families.
        folder: of the trials.
    """
    trial = draw(seed, index, sealed)
    case = folder / f"{seed}_{index:05d}_{trial.plan.kind}"
    truth = dict(trial.truth)
    torque = truth.pop("unseen_torque_Nm")
    effects = [_told(effect) for effect in truth["hidden"]]
    if truth["fault_rows"]:
        first, last = truth["fault_rows"][0], truth["fault_rows"][-1]
        span = {"start": (first - 0.5) / trial.plan.rate, "stop": (last + 0.5) / trial.plan.rate}
        effects.append({"effect": truth["fault"], "args": span})
    if truth["fault_joints"]:
        effects.append({"effect": truth["fault"], "args": {"joints": truth["fault_joints"]}})
    truth |= {
        "name": case.name,
        "effects": effects,
        "effect_rms_Nm": truth["unseen_effect_rms_Nm"],
        "unseen_limit_Nm": truth["unseen_bound_Nm"],
    }
    columns = {f"tau{i + 1}_Nm": [row[i] for row in torque] for i in range(len(torque[0]))}
    write_files(trial.files | {"unseen_truth.csv": csv_text(columns), "truth.json": sealed_text(truth)}, case)
    return case


def _told(effect: Row) -> Row:
    args = {_ARGUMENTS[name]: value for name, value in effect["parameters"].items() if name in _ARGUMENTS}
    args |= {k: int(effect["site"][len(k) :]) for k in ("joint", "link") if effect["site"].startswith(k)}
    if "source" in args:
        args["source"] = int(args["source"])
    return {"effect": _NAMES.get(effect["effect"], effect["effect"]), "args": args}
