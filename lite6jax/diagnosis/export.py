"""A diagnosed arm as an arm: what its motors were found to have goes where simulators look for it."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from lite6jax.arms.arm import Arm
from lite6jax.arms.consistency import bodies_near, consistent_links, is_consistent, with_link_parameters
from lite6jax.arms.dynamics import base_parameters
from lite6jax.diagnosis.document import SCHEMAS, parsed_document
from lite6jax.diagnosis.torque_document import is_of_torques, read_torque_model
from lite6jax.domains.torque.predict import DiagnosedMotors
from lite6jax.effects.dynamic.bodies import LinkCom, LinkMass
from lite6jax.effects.dynamic.friction import CoulombFriction, ViscousFriction
from lite6jax.effects.dynamic.motors import RotorInertia
from lite6jax.effects.dynamic.torque_effect import TorqueEffect
from lite6jax.errors import InputError

_FIELDS = {
    ViscousFriction: "viscous_friction",
    CoulombFriction: "coulomb_friction",
    RotorInertia: "rotor_inertia",
}
"""The effects that an `Arm` has a place for."""


def is_diagnosis(path: str | Path) -> bool:
    """Whether a file is a diagnosis, by its suffix and schema.

    Raises:
        InputError: no such file, or no JSON.
    """
    if Path(path).suffix.lower() != ".json":
        return False
    document = parsed_document(path)
    return isinstance(document, dict) and document.get("schema") in SCHEMAS


def read_diagnosed_arm(path: str | Path) -> tuple[Arm, tuple[str, ...]]:
    """The arm of a diagnosis of torques, with the friction, rotors and links that were found.

    Its links are bodies: of all that have the base parameters found, those nearest to what was estimated (see
    `arms.consistency`).

    Returns:
        the arm, and what was found and has no place in it, a phrase each.

    Raises:
        InputError: a diagnosis of poses, or as `read_torque_model`.
    """
    if not is_of_torques(parsed_document(path)):
        raise InputError(f"{path}: is a diagnosis of poses; an arm is written from a diagnosis of torques")
    return diagnosed_arm(read_torque_model(path))


def diagnosed_arm(model: DiagnosedMotors) -> tuple[Arm, tuple[str, ...]]:
    """The arm of a diagnosed model, and what of it an `Arm` has no place for; see `read_diagnosed_arm`."""
    arm, links, left_out = model.arm, model.links.copy(), []
    joints: dict[str, np.ndarray] = {}
    for effect, part in zip(model.terms.terms, model.terms.slices, strict=True):
        values = model.values[part]
        field = _FIELDS.get(type(effect))  # type: ignore[arg-type]
        if field is not None:
            assert isinstance(effect, ViscousFriction | CoulombFriction | RotorInertia)
            # an estimate may scatter below nothing, which no simulator takes
            joints.setdefault(field, np.zeros(arm.dof))[effect.joint - 1] += max(float(values[0]), 0.0)
        elif isinstance(effect, LinkMass | LinkCom):
            links[effect.link - 1] += effect.numbers(values, links)
        else:
            assert isinstance(effect, TorqueEffect)
            left_out.append(f"{effect.name.replace('_', ' ')} at {effect.site}")
    arm = replace(arm, **joints)
    if links.any():
        arm, kept = _with_bodies(arm, links, model.gravity)
        left_out += kept
    return arm, tuple(left_out)


def _with_bodies(arm: Arm, links: np.ndarray, gravity: np.ndarray) -> tuple[Arm, list[str]]:
    if is_consistent(links):
        return with_link_parameters(arm, links), []
    base = base_parameters(arm.kinematics, gravity)
    found = consistent_links(base, base.values(links), bodies_near(links))
    phrases = [] if found.exact else ["inertial numbers that no bodies have"]
    return with_link_parameters(arm, found.parameters), phrases
