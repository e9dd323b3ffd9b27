"""Closed-form conversion of six-parameter chains with prismatic joints to Hayati chains; `HayatiForm` has the rules."""

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lite6jax.arms import frames
from lite6jax.arms.chains import BASE, LINK, HayatiForm
from lite6jax.arms.entries import SIX
from lite6jax.errors import InputError

Array = NDArray[np.floating]

UPRIGHT = np.cos(np.deg2rad(85.0))
ACROSS = "joint 1: its axis is at right angles to the base's {}, along which this form draws it; check the arm's model"
_QUARTER = np.sin(np.pi / 6)


def parameters(form: HayatiForm, arms: Array, nominal: Array | None) -> Array:
    """(arm, size) the Hayati parameters of chains (arm, joint, 6), m and rad, on the branch of `nominal` (size,).

    Raises:
        InputError: joint 1 is revolute and its axis at right angles to the base's axis `form.first_axis`; or axes are
            parallel that the form does not take for such, or the reverse.
    """
    branch = None if nominal is None else form.spread(nominal)
    found = []
    for k, chain in enumerate(arms):
        try:
            found.append(form.gather(*_of_chain(form, chain, branch)))
        except InputError as error:
            raise InputError(f"kinematics[{k}]: {error}" if len(arms) > 1 else str(error)) from error
    return np.array(found)


def _of_chain(form: HayatiForm, chain: Array, branch: tuple[Array, Array] | None) -> tuple[Array, Array]:
    """The base (6,) and the links (joint, 6) of one chain."""
    near = (np.zeros(len(BASE)), np.zeros((form.dof, 6))) if branch is None else branch
    joints = []
    T = np.eye(4)
    for row in chain:
        T = T @ frames.transform_from_row(row)
        joints.append(T)
    base, H = _base(form, joints[0], dict(zip(BASE, near[0], strict=True)))
    links = []
    for i in range(form.dof):
        guess: dict[str, float] = dict(zip(LINK, near[1][i].tolist(), strict=True))
        relative = np.linalg.inv(H) @ joints[min(i + 1, form.dof - 1)]
        if branch is None and i in form.parallel and relative[2, 2] < 0:
            guess["alpha"] = np.pi
        link = _flange(form, relative) if i == form.dof - 1 else _link(form, i, relative, guess)
        link = {name: _near(guess[name], value) if name in _ANGLES else value for name, value in link.items()}
        links.append([link.get(name, 0.0) for name in LINK])
        H = H @ _transform(link)
    return np.array([base.get(name, 0.0) for name in BASE]), np.array(links)


_ANGLES = ("theta_off", "alpha", "beta")


def _base(form: HayatiForm, joint: Array, near: dict[str, float]) -> tuple[dict[str, float], Array]:
    """The base's parameters by name, and the frame that they lead to."""
    u = joint[:3, 2]
    names = form.of_link(-1)
    if 0 in form.sliding and "yaw" in names:
        yaw, roll = _turns(u, near["yaw"])
        return {"yaw": yaw, "roll": roll}, frames.transform_from_row([0, 0, 0, roll, 0, yaw])
    k = form.first_axis
    given = {name: float(angle) for name, angle in base_turns(k, u, np).items()}
    if 0 not in form.sliding:
        if abs(u[k]) < UPRIGHT:
            raise InputError(ACROSS.format("xyz"[k]))
        foot = joint[:3, 3] - joint[k, 3] / u[k] * u
        given |= {name: float(foot["xyz".index(name)]) for name in names if name in "xyz"}
    return given, frames.transform_from_row([given.get(name, 0.0) for name in SIX]) @ form.T_axes


def base_turns(first_axis: int, u: Any, of: ModuleType) -> dict[str, Any]:
    """The two angles of the base whose axis `first_axis` then points along `u`; `of` is numpy or jax.numpy."""
    if first_axis == 0:  # Rz(yaw) Ry(pitch)
        return {"yaw": of.arctan2(u[1], u[0]), "pitch": -of.arcsin(u[2])}
    if first_axis == 1:  # Rz(yaw) Rx(roll)
        return {"yaw": of.arctan2(-u[0], u[1]), "roll": of.arcsin(u[2])}
    return {"pitch": of.arctan2(u[0], u[2]), "roll": -of.arcsin(u[1])}  # Ry(pitch) Rx(roll)


def _link(form: HayatiForm, i: int, T: Array, near: dict[str, float]) -> dict[str, float]:
    """The parameters of the link after joint i to the next joint, whose frame in that of the link's start is T."""
    u, p = T[:3, 2], T[:3, 3]
    sine = np.hypot(u[0], u[1])
    pair = f"joints {i + 1} and {i + 2}: their axes"
    if i in form.parallel and sine > _QUARTER:
        raise InputError(f"{pair} are not parallel as this form expects; check the arm's model")
    if i not in form.parallel and sine < 1e-6:
        raise InputError(f"{pair} are parallel, which this form does not expect; add {i} to `parallel`")
    names = form.of_link(i)
    if i not in form.parallel:
        theta, alpha = _turns(u, near["theta_off"])
        if "d" not in names:
            return {"theta_off": theta, "alpha": alpha}
        c, s = np.cos(theta), np.sin(theta)
        d = p[2] + u[2] * (c * p[1] - s * p[0]) / (s * u[0] - c * u[1])
        return {"theta_off": theta, "d": float(d), "a": float(c * p[0] + s * p[1]), "alpha": alpha}
    foot = p - p[2] / u[2] * u  # where the next axis meets this frame's x-y plane
    theta = 0.0
    if "theta_off" in names:
        theta = float(np.arctan2(foot[1], foot[0]))
        if np.cos(theta - near["theta_off"]) < 0:
            theta += np.pi
        if np.hypot(*foot[:2]) < 1e-4:
            raise InputError(f"{pair} coincide, so the two joints are indistinguishable; remove one")
    c, s = np.cos(theta), np.sin(theta)
    across, along, up = c * u[0] + s * u[1], c * u[1] - s * u[0], u[2]  # (sin β, −sin α cos β, cos α cos β)
    alpha, beta = float(np.arctan2(-along, up)), float(np.arctan2(across, np.hypot(along, up)))
    link = {"alpha": alpha, "beta": beta}
    if "theta_off" in names:
        return link | {"theta_off": theta, "a": float(c * foot[0] + s * foot[1])}
    return link | ({"a": float(foot[0]), "b": float(foot[1])} if "a" in names else {})


def _flange(form: HayatiForm, T: Array) -> dict[str, float]:
    """The parameters of the last link, to a frame about the same axis."""
    theta = float(np.arctan2(T[1, 0], T[0, 0]))
    found = {"theta_off": theta, "d": float(T[2, 3])}
    if "b" in form.of_link(form.dof - 1):
        c, s = np.cos(theta), np.sin(theta)
        found |= {"a": float(c * T[0, 3] + s * T[1, 3]), "b": float(c * T[1, 3] - s * T[0, 3])}
    return found


def _turns(u: Array, near: float) -> tuple[float, float]:
    """The angles of Rz(θ) Rx(α) that takes z to the unit vector u, of two the one with θ near `near`."""
    theta = np.arctan2(u[0], -u[1])
    if np.cos(theta - near) < -1e-12:
        theta += np.pi
    theta = _near(near, float(theta))
    sine = np.sin(theta) * u[0] - np.cos(theta) * u[1]
    return theta, float(np.arctan2(sine, u[2]))


def _near(wanted: float, angle: float) -> float:
    return angle + 2 * np.pi * round((wanted - angle) / (2 * np.pi))


def _transform(link: dict[str, float]) -> Array:
    theta, d, a, b, alpha, beta = (link.get(name, 0.0) for name in LINK)
    T = frames.transform_from_row([0, 0, d, 0, 0, theta]) @ frames.transform_from_row([a, b, 0, alpha, 0, 0])
    return T @ frames.transform_from_row([0, 0, 0, 0, beta, 0])
