"""The one residual of every fit, and its cost, gradient and curvature from the chain's own twists.

A sample's residual is the position difference in the sensor's frame and the rotation vector from the measured to the
predicted orientation in the measured tool's axes, `[p̂ − p; log(Rᵀ R̂)]`, whitened by the sensor's noise. Arrays have
the sample as their last axis. The curvature is Gauss–Newton's JᵀWJ.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from lite6jax.arms.chains import sweep, sweep_order
from lite6jax.arms.se3 import Frame, Turn, Twist, base_frame, cross, joint_turn, rotation_twist
from lite6jax.model import ArmModel, ModelForm
from lite6jax.sensors import pose
from lite6jax.sensors.sensor import whiten

POSITION = 3
POSE = 6
"""Rows a sample has: a position, or a position and an orientation."""
BLOCK = 2400
"""Samples walked together: their Jacobian stays in a core's cache, and memory does not grow with their number."""


class Observations(NamedTuple):
    """What a sensor saw. A pytree; blocks of samples and arms are leading axes.

    Attributes:
        joint: the joints' motions, `(joint, sample)` each.
        position: `(3, sample)` m in the sensor's frame.
        rotation: `(3, 3, sample)`, component by axis; `(3, 3, 0)` where no orientation was measured.
        weight: `(sample,)`; zero for a sample that is missing.
        whitener: what makes the noise of a residual unit: `(2,)`, the inverse standard deviations per axis of position
            (1/m) and orientation (1/rad), where it is isotropic and alike for all samples; else `(row, row, sample)`.
    """

    joint: Turn
    position: jax.Array
    rotation: jax.Array
    weight: jax.Array
    whitener: jax.Array


class Robust(NamedTuple):
    """A robust loss over whole samples: Student's t with `freedom` degrees and the noise scaled by `scale`.

    With s a sample's squared whitened residual: cost ½ (ν + rows) log(1 + s / (ν scale²)). Where a function takes
    `Robust | None`, None is least squares.
    """

    freedom: jax.Array
    scale: jax.Array


def observe(
    form: ModelForm, joint_position: jax.Array, pose: jax.Array, weight: jax.Array, whitener: jax.Array, block: int
) -> Observations:
    """One arm's data as the residual wants it, cut into blocks.

    Args:
        form: whose chain says which joints are prismatic.
        joint_position: `(sample, joint)` rad, and m of prismatic joints.
        pose: `(sample, 4, 4)`, or `(sample, 3)` where only positions were measured; missing where not finite.
        weight: `(sample,)`.
        whitener: `(2,)` or `(sample, row, row)`.
        block: samples in a block; divides their number.
    """
    axes = tuple(range(1, pose.ndim))
    finite = jnp.all(jnp.isfinite(pose), axes) & jnp.all(jnp.isfinite(joint_position), 1)
    used = finite & (weight > 0)
    pose = jnp.where(used.reshape(-1, *[1] * len(axes)), pose, 1.0)
    q = jnp.where(used[:, None], joint_position, 0.0)

    def blocked(leaf: jax.Array) -> jax.Array:
        return jnp.moveaxis(leaf.reshape(-1, block, *leaf.shape[1:]), 1, -1)

    count = weight.shape[0] // block
    position, rotation = (pose[:, :3, 3], blocked(pose[:, :3, :3])) if pose.ndim == 3 else (pose, None)
    if rotation is None:
        rotation = jnp.zeros((count, 3, 3, 0))
    whitener = jnp.broadcast_to(whitener, (count, 2)) if whitener.ndim == 1 else blocked(whitener)
    joint = joint_turn(blocked(q), form.chain.sliding)
    return Observations(joint, blocked(position), rotation, blocked(jnp.where(used, weight, 0.0)), whitener)


def padded_size(samples: int) -> tuple[int, int]:
    """How many samples to pad to, and a block's size: few shapes, so that few are compiled; it adds at most 1/16."""
    if samples > BLOCK:
        return -(-samples // BLOCK) * BLOCK, BLOCK
    grain = max(4, 2 ** (max(samples - 1, 1).bit_length() - 5))
    size = -(-samples // grain) * grain
    return size, size


def pad(array: np.ndarray, axis: int, size: int) -> np.ndarray:
    """The array with zeros appended along an axis."""
    missing = size - array.shape[axis]
    if missing == 0:
        return array
    return np.pad(array, [(0, missing if i == axis else 0) for i in range(array.ndim)])


def tool_frame(model: ArmModel, flange: Frame) -> Frame:
    """The frame of the tool."""
    T = model.T_flange_tool
    axes = [T[0, i] * flange.x + T[1, i] * flange.y + T[2, i] * flange.z for i in range(4)]
    return Frame(axes[0], axes[1], axes[2], flange.origin + axes[3])


def predict_frames(form: ModelForm, model: ArmModel, joint: Turn) -> tuple[Frame, Frame]:
    """The flange's and the tool's frames in sensor coordinates."""
    flange, _ = sweep(form.chain, model.geometry, joint, base_frame(model.T_sensor_base, joint.cos.shape[-1]))
    return flange, tool_frame(model, flange)


def differences(observed: Observations, tool: Frame) -> jax.Array:
    """Residuals before whitening, `(row, sample)`, m and rad."""
    return pose.differences(observed.position, observed.rotation, tool)


def residuals(form: ModelForm, model: ArmModel, observed: Observations) -> jax.Array:
    """Whitened, weighted residuals `(row, sample)`: plain code, for automatic differentiation."""
    _, tool = predict_frames(form, model, observed.joint)
    return jnp.sqrt(observed.weight) * whiten(observed.whitener, differences(observed, tool))


def _look(
    observed: Observations, tool: Frame, robust: Robust | None
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Residuals before and after whitening, their cost, and the weight of each sample's residual in the gradient."""
    raw = differences(observed, tool)
    whitened = whiten(observed.whitener, raw)
    squares = jnp.sum(whitened**2, 0)
    if robust is None:
        return raw, whitened, jnp.sum(0.5 * observed.weight * squares), observed.weight
    scaled = squares / robust.scale**2
    freedom = robust.freedom + len(raw)
    cost = 0.5 * freedom * jnp.log1p(scaled / robust.freedom)
    weight = freedom / (robust.freedom + scaled) / robust.scale**2
    return raw, whitened, jnp.sum(observed.weight * cost), observed.weight * weight


def _pull(observed: Observations, raw: jax.Array, weighted: jax.Array) -> tuple[jax.Array, jax.Array | None]:
    """The force and the moment `(3, sample)` that whitened residuals exert on the tool, sensor axes; no moment of
    positions."""
    isotropic = observed.whitener.ndim == 1
    dual = whiten(observed.whitener if isotropic else jnp.swapaxes(observed.whitener, 0, 1), weighted)
    if len(dual) == POSITION:
        return dual, None
    # the logarithm's derivative leaves a multiple of the rotation vector itself as it is
    moment = dual[3:] if isotropic else pose.left_jacobian_inverse(-raw[3:], dual[3:])
    return dual[:3], sum(observed.rotation[:, i] * moment[i] for i in range(3))  # type: ignore[return-value]


def evaluate(
    form: ModelForm, model: ArmModel, observed: Observations, robust: Robust | None
) -> tuple[jax.Array, jax.Array]:
    """The cost of one block of samples and its gradient `(size,)`, by the wrench that each sample's residual exerts.

    The gradient is what reverse-mode differentiation of the cost gives, for two walks of the chain.
    """
    _, tool = predict_frames(form, model, observed.joint)
    raw, whitened, cost, weight = _look(observed, tool, robust)
    force, moment = _pull(observed, raw, weight * whitened)
    about_base = cross(tool.origin, force)
    if moment is not None:
        about_base = about_base + moment

    def power(twist: Twist) -> jax.Array:
        total = force * twist.linear
        return jnp.sum(total if twist.angular is None else total + about_base * twist.angular)

    return cost, twist_columns(form, model, observed.joint, power)[step_order(form)]


def linearise(
    form: ModelForm, model: ArmModel, observed: Observations, robust: Robust | None
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The cost of one block, its gradient `(size,)` and Gauss–Newton's curvature JᵀWJ `(size, size)`, by one walk.

    The gradient is exact. The curvature is without the logarithm's own derivative, which differs from one by half the
    residual angle: it differs to second order.
    """
    _, tool, twists = _walk_twists(form, model, observed.joint, lambda twist: twist)
    raw, whitened, cost, weight = _look(observed, tool, robust)
    root = jnp.sqrt(weight)
    force, moment = _pull(observed, raw, root * whitened)
    shifts = []
    turns = []
    for twist, turning in zip(twists, _turning(form), strict=True):
        if twist.angular is None:
            shifts.append(twist.linear)
            continue
        shifts.append(twist.linear + jnp.moveaxis(cross(jnp.moveaxis(twist.angular, 1, 0), tool.origin[:, None]), 0, 1))
        turns.append(twist.angular if turning.all() else twist.angular[np.flatnonzero(turning)])
    shift = root * jnp.concatenate(shifts)
    turn = root * jnp.concatenate(turns)
    at = np.flatnonzero(np.concatenate(_turning(form)))  # those that turn: the others have no orientation rows

    def product(rows: jax.Array) -> jax.Array:
        J = rows.reshape(len(rows), -1)
        return J @ J.T

    gradient = shift.reshape(len(shift), -1) @ force.reshape(-1)
    if moment is not None:
        gradient = gradient.at[at].add(turn.reshape(len(turn), -1) @ moment.reshape(-1))
    W = observed.whitener
    if W.ndim == 1:  # two products, without the zeros
        curvature = W[0] ** 2 * product(shift)
        if moment is not None:
            curvature = curvature.at[np.ix_(at, at)].add(W[1] ** 2 * product(turn))
    else:
        rows = jnp.sum(W[:, :3] * shift[:, None], 2)
        if moment is not None:
            in_tool = jnp.stack([jnp.sum(observed.rotation[:, j] * turn, 1) for j in range(3)], 1)
            rows = rows.at[at].add(jnp.sum(W[:, 3:] * in_tool[:, None], 2))
        curvature = product(rows)
    order = step_order(form)  # of the small products: to reorder J would copy it
    return cost, gradient[order], curvature[order][:, order]


def twist_columns(form: ModelForm, model: ArmModel, joint: Turn, emit: Callable[[Twist], jax.Array]) -> jax.Array:
    """What `emit` makes of the twist of each entry of a step, in sensor coordinates, before `step_order`: arrays of one
    shape."""
    return jnp.concatenate(_walk_twists(form, model, joint, emit)[2])


def _walk_twists(
    form: ModelForm, model: ArmModel, joint: Turn, emit: Callable[[Twist], Any]
) -> tuple[Frame, Frame, list[Any]]:
    """The flange's and the tool's frames, and what `emit` makes of each twist, with the leading axes of `sweep`."""
    samples = joint.cos.shape[-1]
    flange, emitted = sweep(form.chain, model.geometry, joint, base_frame(model.T_sensor_base, samples), emit)
    tool = tool_frame(model, flange)
    pairs = []
    if form.frame:
        fixed = base_frame(jnp.eye(4).at[:3, 3].set(model.T_sensor_base[:3, 3]), samples)
        pairs.append((fixed, fixed))
    if form.tool:
        pairs.append((flange, tool))
    for shifting, turning in pairs:
        twists = [Twist(shifting[i], None) for i in range(3)] + [rotation_twist(turning, i) for i in range(3)]
        emitted += [jax.tree.map(lambda leaf: leaf[None], emit(twist)) for twist in twists]
    return flange, tool, emitted


def step_order(form: ModelForm) -> np.ndarray:
    """Where among `twist_columns` each entry of a step stands."""
    swept = sweep_order(form.chain)
    geometry = np.argsort(swept, kind="stable")[: form.chain.size]
    return np.concatenate([geometry, swept.size + np.arange(form.size - form.chain.size)])


def _turning(form: ModelForm) -> list[np.ndarray]:
    """Which twists of each array of `_walk_twists` are of rotations, the others of shifts or of nothing."""
    swept = sweep_order(form.chain)
    chain = form.chain
    units = np.append(chain.units, "")[swept]  # of what is always zero, no unit
    of_base = units[: chain.base_size, None]
    of_joints = units[chain.base_size :].reshape(-1, chain.dof)
    frames = np.array(form.units[chain.size :])[:, None]
    return [group == "rad" for group in (*of_base, *of_joints, *frames)]


def over_blocks(evaluate, observed: Observations):
    """The sum of `evaluate(block)` over the leading axis of `observed`: memory stays that of one block."""
    if observed.weight.shape[0] == 1:
        return evaluate(jax.tree.map(lambda leaf: leaf[0], observed))
    shapes = jax.eval_shape(evaluate, jax.tree.map(lambda leaf: leaf[0], observed))
    zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    return lax.scan(lambda total, block: (jax.tree.map(jnp.add, total, evaluate(block)), None), zeros, observed)[0]
