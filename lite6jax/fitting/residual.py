"""The one residual of every fit, and its cost, gradient and curvature from the chain's own twists.

A sample's residual is the position difference in the sensor's frame and the rotation vector from the measured to the
predicted orientation in the measured tool's axes, `[p̂ − p; log(Rᵀ R̂)]`, whitened by the sensor's noise. Arrays have
the sample as their last axis. The curvature is Gauss–Newton's JᵀWJ.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from lite6jax.arms.forward_kinematics import sweep
from lite6jax.arms.moves import Frame, Turn, Twist, base_frame, cross, rotation_twist
from lite6jax.arms.se3 import rotation_log_components
from lite6jax.model import ArmModel, ModelForm

POSITION, POSE = 3, 6
"""Rows a sample has: a position, or a position and an orientation."""


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
    position: Array
    rotation: Array
    weight: Array
    whitener: Array


class Robust(NamedTuple):
    """A robust loss over whole samples: Student's t with `freedom` degrees and the noise scaled by `scale`.

    With s a sample's squared whitened residual: cost ½ (ν + rows) log(1 + s / (ν scale²)). Where a function takes
    `Robust | None`, None is least squares.
    """

    freedom: Array
    scale: Array


def tool_frame(model: ArmModel, flange: Frame) -> Frame:
    """The frame of the tool."""
    T = model.T_flange_tool
    axes = [T[0, i] * flange.x + T[1, i] * flange.y + T[2, i] * flange.z for i in range(4)]
    return Frame(axes[0], axes[1], axes[2], flange.origin + axes[3])


def predict_frames(form: ModelForm, model: ArmModel, joint: Turn) -> tuple[Frame, Frame]:
    """The flange's and the tool's frames in sensor coordinates."""
    flange, _ = sweep(form.chain, model.geometry, joint, base_frame(model.T_sensor_base, joint.cos.shape[-1]))
    return flange, tool_frame(model, flange)


def differences(observed: Observations, tool: Frame) -> Array:
    """Residuals before whitening, `(row, sample)`, m and rad."""
    shift = tool.origin - observed.position
    if observed.rotation.shape[-1] == 0:
        return shift
    R, axes = observed.rotation, tool[:3]
    relative = [
        [R[0, i] * axes[j][0] + R[1, i] * axes[j][1] + R[2, i] * axes[j][2] for j in range(3)] for i in range(3)
    ]
    return jnp.concatenate([shift, jnp.stack(rotation_log_components(relative))])


def whiten(whitener: Array, rows: Array) -> Array:
    """Whitened rows `(row, sample)`."""
    if whitener.ndim == 1:
        return jnp.repeat(whitener, 3)[: rows.shape[0], None] * rows
    return jnp.sum(whitener * rows, 1)


def residuals(form: ModelForm, model: ArmModel, observed: Observations) -> Array:
    """Whitened, weighted residuals `(row, sample)`: plain code, for automatic differentiation."""
    _, tool = predict_frames(form, model, observed.joint)
    return jnp.sqrt(observed.weight) * whiten(observed.whitener, differences(observed, tool))


def loss(observed: Observations, robust: Robust | None, squares: Array) -> tuple[Array, Array]:
    """Each sample's cost, and the weight `(sample,)` its residual has in the gradient.

    Args:
        observed: for its weights and the number of its rows.
        robust: the loss.
        squares: each sample's squared whitened residual, `(sample,)`.
    """
    if robust is None:
        return 0.5 * observed.weight * squares, observed.weight
    rows = POSITION if observed.rotation.shape[-1] == 0 else POSE
    scaled = squares / robust.scale**2
    cost = 0.5 * (robust.freedom + rows) * jnp.log1p(scaled / robust.freedom)
    weight = (robust.freedom + rows) / (robust.freedom + scaled) / robust.scale**2
    return observed.weight * cost, observed.weight * weight


class _Sight(NamedTuple):
    """What one walk of the chain shows: frames, residuals, and their loss."""

    flange: Frame
    tool: Frame
    raw: Array
    whitened: Array
    cost: Array
    weight: Array


def _look(form: ModelForm, model: ArmModel, observed: Observations, robust: Robust | None) -> _Sight:
    flange, tool = predict_frames(form, model, observed.joint)
    raw = differences(observed, tool)
    whitened = whiten(observed.whitener, raw)
    cost, weight = loss(observed, robust, jnp.sum(whitened**2, 0))
    return _Sight(flange, tool, raw, whitened, jnp.sum(cost), weight)


def evaluate(form: ModelForm, model: ArmModel, observed: Observations, robust: Robust | None) -> tuple[Array, Array]:
    """The cost of one block of samples and its gradient `(size,)`, by the wrench that each sample's residual exerts.

    The gradient is what reverse-mode differentiation of the cost gives, for two walks of the chain.
    """
    sight = _look(form, model, observed, robust)
    if observed.whitener.ndim == 1:
        dual = sight.weight * whiten(observed.whitener, sight.whitened)
    else:
        dual = sight.weight * jnp.sum(observed.whitener * sight.whitened[:, None], 0)
    force = dual[:3]
    moment = cross(sight.tool.origin, force)
    if len(dual) == POSE:
        # the logarithm's derivative leaves a multiple of the rotation vector itself as it is
        turned = dual[3:] if observed.whitener.ndim == 1 else _left_jacobian_inverse(-sight.raw[3:], dual[3:])
        moment = moment + _to_sensor(observed, turned)

    def power(twist: Twist) -> Array:
        total = force * twist.linear
        return jnp.sum(total if twist.angular is None else total + moment * twist.angular)

    return sight.cost, _columns(form, model, observed, sight, power)[step_order(form)]


def linearise(
    form: ModelForm, model: ArmModel, observed: Observations, robust: Robust | None
) -> tuple[Array, Array, Array]:
    """The cost of one block, its gradient `(size,)` and Gauss–Newton's curvature JᵀWJ `(size, size)`."""
    sight = _look(form, model, observed, robust)
    J = _walked_jacobian(form, model, observed, sight)
    J = J.reshape(len(J), -1)
    residual = sight.whitened
    if len(residual) == POSE and observed.whitener.ndim == 1:
        residual = jnp.concatenate([residual[:3], _to_sensor(observed, residual[3:])])
    gradient = J @ (jnp.sqrt(sight.weight) * residual).reshape(-1)
    order = step_order(form)  # of the small products: to reorder J would copy it
    return sight.cost, gradient[order], (J @ J.T)[order][:, order]


def identification_jacobian(form: ModelForm, model: ArmModel, observed: Observations, robust: Robust | None) -> Array:
    """The whitened, weighted residuals' derivatives `(parameter, row, sample)`, from the chain's twists.

    Where the whitener is isotropic the orientation rows are in the sensor's axes and without the logarithm's own
    derivative, which differs from one by half the residual angle: neither matters to JᵀJ or to Jᵀr.
    """
    return _walked_jacobian(form, model, observed, _look(form, model, observed, robust))[step_order(form)]


def _walked_jacobian(form: ModelForm, model: ArmModel, observed: Observations, sight: _Sight) -> Array:
    root = jnp.sqrt(sight.weight)
    if observed.whitener.ndim == 1:

        def rows(twist: Twist) -> Array:
            spin = twist.angular
            shift = twist.linear if spin is None else twist.linear + cross(spin, sight.tool.origin)
            if len(sight.raw) == POSE:
                shift = jnp.concatenate([shift, jnp.zeros_like(shift) if spin is None else spin])
            return root * whiten(observed.whitener, shift)

        return _columns(form, model, observed, sight, rows)

    by_linear, by_angular = by_twist(observed, sight.tool)

    def rows(twist: Twist) -> Array:
        shift = jnp.sum(by_linear * twist.linear, 1)
        return root * (shift if twist.angular is None else shift + jnp.sum(by_angular * twist.angular, 1))

    return _columns(form, model, observed, sight, rows)


def by_twist(observed: Observations, tool: Frame) -> tuple[Array, Array]:
    """The whitened residual's derivatives by a twist at the fixed origin, its linear and its angular part.

    Each `(row, 3, sample)`, orientation rows in the measured tool's axes, the logarithm's own derivative included. The
    whitener is `(row, row, sample)`.
    """
    by_linear = observed.whitener[:, :3]
    by_angular = -jnp.moveaxis(cross(jnp.moveaxis(by_linear, 1, 0), tool.origin[:, None]), 0, 1)
    if observed.rotation.shape[-1]:
        raw = differences(observed, tool)[3:]
        turned = jnp.stack([_left_jacobian_inverse(raw, observed.rotation[j]) for j in range(3)], 1)
        by_angular = by_angular + jnp.sum(observed.whitener[:, 3:, None] * turned, 1)
    return by_linear, by_angular


def _columns(
    form: ModelForm, model: ArmModel, observed: Observations, sight: _Sight, emit: Callable[[Twist], Array]
) -> Array:
    return twist_columns(form, model, observed.joint, sight.flange, sight.tool, emit)


def twist_columns(
    form: ModelForm, model: ArmModel, joint: Turn, flange: Frame, tool: Frame, emit: Callable[[Twist], Array]
) -> Array:
    """What `emit` makes of the twist of each entry of a step, the geometry's in *walking* order.

    Args:
        form: which entries.
        model: where.
        joint: the joints' motions.
        flange: its frame in sensor coordinates, as `predict_frames` gives it.
        tool: the tool's.
        emit: maps a twist, in sensor coordinates, to an array; all of one shape.
    """
    samples = joint.cos.shape[-1]
    _, columns = sweep(form.chain, model.geometry, joint, base_frame(model.T_sensor_base, samples), emit)
    parts = [columns]
    if form.frame:
        fixed = base_frame(jnp.eye(4).at[:3, 3].set(model.T_sensor_base[:3, 3]), samples)
        parts.append(jnp.stack([emit(twist) for twist in _frame_twists(fixed, fixed)]))
    if form.tool:
        parts.append(jnp.stack([emit(twist) for twist in _frame_twists(flange, tool)]))
    return jnp.concatenate(parts) if len(parts) > 1 else columns


def step_order(form: ModelForm) -> np.ndarray:
    """Where among `twist_columns` each entry of a step stands."""
    walked = form.chain.walking_order
    geometry = np.argsort(walked, kind="stable")[: form.chain.size]
    return np.concatenate([geometry, walked.size + np.arange(form.size - form.chain.size)])


def _frame_twists(shifting: Frame, turning: Frame) -> list[Twist]:
    return [Twist(shifting[i], None) for i in range(3)] + [rotation_twist(turning, i) for i in range(3)]


def _to_sensor(observed: Observations, in_tool: Array) -> Array:
    """Vectors `(3, sample)` in the measured tool's axes, in the sensor's."""
    return sum(observed.rotation[:, i] * in_tool[i] for i in range(3))  # type: ignore[return-value]


def _left_jacobian_inverse(vector: Array, rows: Array) -> Array:
    """J_l⁻¹(e) v = v − ½ e × v + γ e × (e × v), over the first axis (T. Barfoot, State Estimation for Robotics, 7.80).

    Its transpose is that of −e.
    """
    angle2 = jnp.sum(vector**2, 0)
    small = angle2 < 1e-4
    safe = jnp.where(small, 1.0, angle2)
    angle = jnp.sqrt(safe)
    exact = 1 / safe - (1 + jnp.cos(angle)) / (2 * angle * jnp.sin(angle))
    gamma = jnp.where(small, 1 / 12 + angle2 / 720 + angle2**2 / 30240, exact)
    once = cross(vector, rows)
    return rows - 0.5 * once + gamma * cross(vector, once)


def over_blocks(evaluate, observed: Observations):
    """The sum of `evaluate(block)` over the leading axis of `observed`: memory stays that of one block."""
    if observed.weight.shape[0] == 1:
        return evaluate(jax.tree.map(lambda leaf: leaf[0], observed))
    shapes = jax.eval_shape(evaluate, jax.tree.map(lambda leaf: leaf[0], observed))
    zeros = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
    return lax.scan(lambda total, block: (jax.tree.map(jnp.add, total, evaluate(block)), None), zeros, observed)[0]
