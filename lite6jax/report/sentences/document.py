"""What sentences ask of the JSON document of a diagnosis of poses or of torques."""

from collections.abc import Mapping
from typing import Any

from lite6jax.diagnosis.document import is_of_torques
from lite6jax.diagnosis.result import NEARLY_SIGNIFICANT
from lite6jax.formatting import torque_units

Document = Mapping[str, Any]
Entry = Mapping[str, Any]

_NOT_CORRECTED = ("outliers", "computed_pose", "arm_deviation")
"""Faults of the data that are said and not corrected."""


def sliding(document: Document) -> tuple[int, ...]:
    """The prismatic joints of the diagnosed arm, counted from 0."""
    return tuple(joint - 1 for joint in document["model"].get("prismatic_joints", ()))


def units(document: Document) -> tuple[str, ...]:
    """Of each joint of a document of torques: Nm, or N of a prismatic one."""
    return torque_units(sliding(document), len(document["model"]["kinematics"]))


def corrected_faults(document: Document) -> list[Entry]:
    """The faults of the data that were corrected: nothing corrects what is no more than said."""
    return [fault for fault in document["data_faults"] if fault["fault"] not in _NOT_CORRECTED]


def has_computed_poses(document: Document) -> bool:
    """Tells whether no sensor measured the poses: the controller computed them from the joints."""
    if is_of_torques(document):
        return False
    of_controller = any(fault["fault"] == "computed_pose" for fault in document["data_faults"])
    return of_controller or document.get("source") == "controller_fk"


def declares_noise(document: Document) -> bool:
    """Tells whether the sidecar declares the noise of what is compared, so that the size of what is left is tested."""
    return bool(next(iter(document["noise"]["declared"].values())))


def undeclared_noise(document: Document) -> str:
    """Names the noises that the sidecar does not declare: no position_noise_m and no orientation_noise_rad."""
    declared = document["noise"]["declared"]
    return " and ".join(f"no {name.replace('_', '_noise_')}" for name, size in declared.items() if size is None)


def whose_noise(document: Document) -> str:
    """Says whose noise the errors are compared with."""
    if is_of_torques(document):
        return "sensors'"
    return "sensor's"


def nearly_significant(document: Document) -> Entry | None:
    """The nearest effect that is no finding, where it is nearly significant; documents do not hold that threshold."""
    nearest = document["nearest"]
    if nearest is not None and nearest["p_value"] < NEARLY_SIGNIFICANT:
        return nearest
    return None
