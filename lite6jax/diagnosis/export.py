"""A diagnosed arm as an arm: what was found of its chain and its motors goes where simulators look for it."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from lite6jax.arms import frames
from lite6jax.arms.arm import Arm
from lite6jax.arms.description import bundled_arms, load_bundled
from lite6jax.arms.dynamics import base_parameters, bodies_near, consistent_links, is_consistent, set_link_parameters
from lite6jax.array_types import Array
from lite6jax.diagnosis.document import find_part, model_from_document, parse_document
from lite6jax.domains.pose.predict import DiagnosedArm
from lite6jax.domains.torque.predict import DiagnosedMotors, motion_of_joint
from lite6jax.domains.tracking.predict import DiagnosedServos
from lite6jax.effects.deflection import Deflection, dense
from lite6jax.effects.dynamic import (
    FIELDS,
    CoulombFriction,
    Dynamics,
    Friction,
    JointSpring,
    LinkCom,
    LinkInertia,
    LinkMass,
    OfJoint,
    RotorInertia,
    TorqueEffect,
    UnnamedTorque,
    ViscousFriction,
)
from lite6jax.effects.effect import Bending, Effect
from lite6jax.effects.motion import motion_of
from lite6jax.errors import InputError
from lite6jax.estimation.terms import Term

_SPEEDS = 200
"""From the fastest one way to the fastest the other, an even number: at rest friction has no direction."""
_SAME = 1e-9
"""m and rad by which a measured point is the flange."""


def read_diagnosed_arm(
    path: str | Path, nominal: Arm | None = None, effects: tuple[Effect, ...] = (), alone: bool = True
) -> tuple[Arm, tuple[str, ...]]:
    """The arm of a diagnosis: of poses its chain, of torques its friction, rotors, springs and links, of both all.

    Links are bodies: of all that have the base parameters found, those nearest to what was estimated (see
    `arms.dynamics`).

    Args:
        path: what `diagnose` wrote.
        nominal: from which limits and inertia are taken that the diagnosis does not say; the bundled arm of its name
            where not given.
        effects: a user's own, where the diagnosis has them.
        alone: whether the arm is written on its own: then it ends at the point that was measured and has the inertia of
            the nominal arm. Otherwise it goes into a file that has a flange and inertia.

    Returns:
        the arm, and what was found and has no place in it, a phrase each.

    Raises:
        InputError: as `read_model`; a diagnosis of commands.
    """
    document = parse_document(path)
    model = model_from_document(document, effects, str(path))
    if isinstance(model, DiagnosedMotors):
        return diagnosed_arm(model)
    if isinstance(model, DiagnosedServos):
        raise InputError(f"{path}: is of commands; give its model to convert_servos")
    chain, left_out = diagnosed_chain(model, nominal, alone)
    if find_part(document, "torques") is None:
        return chain, left_out
    motors = model_from_document(document, effects, str(path), "torques")
    assert isinstance(motors, DiagnosedMotors)
    arm, further = diagnosed_arm(motors)
    arm = replace(arm, kinematics=chain.kinematics, T_joint_flange=chain.T_joint_flange, dh=None)
    arm = replace(arm, joint_limits=model.controller_limits(arm.joint_limits))
    return arm, (*left_out, *further)


def diagnosed_chain(model: DiagnosedArm, nominal: Arm | None = None, alone: bool = True) -> tuple[Arm, tuple[str, ...]]:
    """The arm of a diagnosed model of poses, with every displacement that does not depend on the motion in its chain.

    It ends at the point that was measured. Where the base stands in the sensor's frame is no part of it. Its joints
    count as the controller of the recording does: a zero that is off is in the chain. Arguments and what is returned
    are as of `read_diagnosed_arm`.
    """
    if nominal is None and model.arm in bundled_arms():
        nominal = load_bundled(model.arm)
    rows = np.array(model.model.geometry).reshape(-1, 6)
    left_out = []
    total = dense(Deflection(), model.dof, 1)
    still = motion_of(np.zeros((1, model.dof)), sliding=model.sliding)
    for effect, part in model.physics.pairs:
        deflection = None
        if isinstance(effect, Bending) and not effect.drivers:
            deflection = dense(effect.deflect(jnp.asarray(model.values)[part], still, None), model.dof, 1)
            if any(np.any(np.asarray(field)) for field in (deflection.stretch, deflection.scale, deflection.sensor)):
                deflection = None
        if deflection is None:
            wanders = ", which wanders by itself" if any(driver.is_order for driver in effect.drivers) else ""
            left_out.append(f"{effect.name.replace('_', ' ')} at {effect.site}{wanders}")
        else:
            total = total + deflection
    joint, link, base, tool = (np.array(field)[..., 0] for field in (total.joint, total.link, total.base, total.tool))
    joint = joint + np.asarray(model.joint_zero)
    before = _displaced(base)
    for i, row in enumerate(rows):
        moved = [0, 0, joint[i], 0, 0, 0] if i in model.sliding else [0, 0, 0, 0, 0, joint[i]]
        T = before @ frames.transform_from_row(row) @ frames.transform_from_row(moved)
        exact = np.array_equal(before, np.eye(4)) and not joint[i]
        rows[i] = row if exact else frames.row_from_transform(T)
        before = _displaced(link[i])
    tip = before @ _displaced(tool) @ np.asarray(model.model.T_flange_tool)
    if not np.allclose(np.asarray(model.model.T_sensor_base), np.eye(4), rtol=0, atol=_SAME):
        left_out.append("where the base stands in the frame of the sensor")
    if nominal is not None and not np.allclose(tip, nominal.T_joint_flange, rtol=0, atol=_SAME):
        if alone:
            left_out.append("the nominal flange (the chain ends at the point that was measured)")
        else:
            left_out.append("the point that was measured (what follows the last joint stays as it is)")
    limits = model.joint_limits if nominal is None else nominal.joint_limits
    arm = Arm(model.arm, rows, joint_limits=limits, T_joint_flange=tip, sliding=model.sliding)
    arm = replace(arm, joint_limits=model.controller_limits(arm.joint_limits))
    if alone and nominal is not None and nominal.dof == arm.dof:
        arm = replace(arm, mass=nominal.mass, center_of_mass=nominal.center_of_mass, inertia=nominal.inertia)
    return arm, tuple(left_out)


def _displaced(twist: Array) -> Array:
    """(4, 4) of a translation and then a rotation vector."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(twist[3:]).as_matrix(), twist[:3]
    return T


def diagnosed_arm(model: DiagnosedMotors) -> tuple[Arm, tuple[str, ...]]:
    """The arm of a diagnosed model of torques, and what of it an `Arm` has no place for; see `read_diagnosed_arm`."""
    arm = model.arm
    links = model.links.copy()
    left_out = []
    joints: dict[str, np.ndarray] = {}
    springs = np.zeros((2, arm.dof))  # of each joint its stiffness, and its torque at zero
    if arm.spring_stiffness is not None and arm.spring_rest is not None:
        springs = np.stack([arm.spring_stiffness, -arm.spring_stiffness * arm.spring_rest])
    for effect, part in model.terms.pairs:
        values = model.values[part]
        arm_numbers, phrase = _held(effect, values, model)
        for kind, value in arm_numbers.items():
            assert isinstance(effect, OfJoint)
            field = FIELDS[kind]
            at = effect.joint - 1
            before = arm.drives.get(field)
            joint_values = joints.setdefault(field, np.zeros(arm.dof) if before is None else np.array(before))
            # an estimate may scatter below nothing, which no simulator takes
            joint_values[at] = max(joint_values[at] + value, 0.0)
        if arm_numbers:
            left_out += [phrase] if phrase else []
        elif isinstance(effect, JointSpring) and springs[0, effect.joint - 1] + values[0] > 0:
            springs[:, effect.joint - 1] += values
        elif isinstance(effect, LinkMass | LinkCom | LinkInertia):
            links[effect.link - 1] += effect.inertial(values, links)
        else:
            assert isinstance(effect, TorqueEffect)
            left_out.append(f"{effect.name.replace('_', ' ')} at {effect.site}")
    if springs.any():
        stiff = springs[0] > 0
        joints |= {"spring_stiffness": springs[0], "spring_rest": np.where(stiff, -springs[1], 0.0)}
        joints["spring_rest"][stiff] /= springs[0, stiff]
    arm = replace(arm, **joints)
    arm, not_bodies = with_bodies(arm, links, model.gravity)
    return arm, (*left_out, *not_bodies)


def with_bodies(arm: Arm, links: Array, gravity: Array) -> tuple[Arm, tuple[str, ...]]:
    """The arm with inertial numbers that bodies have, nearest to those of its links, and what is lost, a phrase.

    Args:
        arm: any.
        links: `(joint, 10)`; zeros leave the arm as it is.
        gravity: `(3,)` m/s², along which base parameters are kept.
    """
    if not links.any():
        return arm, ()
    exact = True
    if not is_consistent(links):
        base = base_parameters(arm.kinematics, gravity, arm.sliding)
        near = bodies_near(links)
        try:
            links, exact = consistent_links(base, base.values(links), near)
        except np.linalg.LinAlgError:  # far from any bodies
            links = near
            exact = False
    return set_link_parameters(arm, links), () if exact else ("inertial numbers that no bodies have",)


def _held(effect: Term, values: np.ndarray, model: DiagnosedMotors) -> tuple[dict[type, float], str]:
    """What an `Arm` holds of an effect at a joint, by the kind of effect, and what it does not, a phrase.

    Other friction over the velocity is viscous and Coulomb friction as far as these fit it at the speeds recorded.
    """
    bent = isinstance(effect, ViscousFriction) and effect.fixed_number is not None
    if isinstance(effect, ViscousFriction | CoulombFriction | RotorInertia) and not bent:
        transition = 0.0
        if isinstance(effect, CoulombFriction):
            transition = effect.transition_rad_per_s
        unit = "m/s" if effect.of_slide else "rad/s"
        phrase = ""
        if transition:
            phrase = f"the transition of Coulomb friction at {effect.site}, {transition:.2g} {unit}"
        return {type(effect): float(values[0])}, phrase
    if not isinstance(effect, Friction | UnnamedTorque) or not effect.follows_own_motion:
        return {}, ""
    if isinstance(effect, UnnamedTorque):
        ranges = zip(effect.drivers, effect.bounds[::2], effect.bounds[1::2], strict=True)
        speeds = [max(abs(low), abs(high)) for driver, low, high in ranges if not driver.discrete]
        fastest = max(speeds, default=1.0)
    elif model.uncertainty is not None:
        recorded = model.uncertainty.recorded.velocities
        assert recorded is not None
        fastest = float(np.abs(recorded[effect.joint - 1]).max())
    else:
        return {}, ""
    speed = np.linspace(-fastest, fastest, _SPEEDS)
    nothing = np.zeros((model.dof, _SPEEDS))
    motion = motion_of_joint(effect.joint - 1, speed, model.arm.slides)
    alone = Dynamics(motion, nothing, model.links, model.payload_center, _none, _none, model.gravity)
    torque = effect.at_joint(values, alone)
    columns = np.stack([speed, np.sign(speed)], 1)
    numbers, _ = nnls(columns, torque - torque.mean())
    residual = float(np.std(torque - columns @ numbers))
    curve = ""
    if isinstance(effect, ViscousFriction):
        curve = f" with the exponent {effect.exponent:.2g}"
    friction_label = f"{effect.name.replace('_', ' ')} at {effect.site}{curve}"
    unit = "N" if effect.of_slide else "Nm"
    return (
        {ViscousFriction: float(numbers[0]), CoulombFriction: float(numbers[1])},
        f"{residual:.2g} {unit} RMS of what is {friction_label}, which its viscous and Coulomb friction leave",
    )


def _none(numbers: np.ndarray) -> np.ndarray:
    raise NotImplementedError("friction over the velocity needs neither inertia nor gravity")
