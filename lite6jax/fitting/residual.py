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
from jax import Array, lax

from lite6jax.arms.chains import sweep, sweep_order
from lite6jax.arms.se3 import Frame, Turn, Twist, base_frame, cross, rotation_log_components, rotation_twist
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
    return _seen(observed, *predict_frames(form, model, observed.joint), robust)


def _seen(observed: Observations, flange: Frame, tool: Frame, robust: Robust | None) -> _Sight:
    raw = differences(observed, tool)
    whitened = whiten(observed.whitener, raw)
    cost, weight = loss(observed, robust, jnp.sum(whitened**2, 0))
    return _Sight(flange, tool, raw, whitened, jnp.sum(cost), weight)


def block_cost(form: ModelForm, model: ArmModel, observed: Observations, robust: Robust | None) -> Array:
    """The cost of one block of samples."""
    return _look(form, model, observed, robust).cost


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

    return sight.cost, twist_columns(form, model, observed.joint, power)[step_order(form)]


def linearise(
    form: ModelForm, model: ArmModel, observed: Observations, robust: Robust | None
) -> tuple[Array, Array, Array]:
    """The cost of one block, its gradient `(size,)` and Gauss–Newton's curvature JᵀWJ `(size, size)`."""
    if observed.whitener.ndim == 1:
        return _linearise_isotropic(form, model, observed, robust)
    sight = _look(form, model, observed, robust)
    J = _walked_jacobian(form, model, observed, sight)
    J = J.reshape(len(J), -1)
    order = step_order(form)  # of the small products: to reorder J would copy it
    return sight.cost, (J @ (jnp.sqrt(sight.weight) * sight.whitened).reshape(-1))[order], (J @ J.T)[order][:, order]


def _linearise_isotropic(
    form: ModelForm, model: ArmModel, observed: Observations, robust: Robust | None
) -> tuple[Array, Array, Array]:
    """As `linearise` where the whitener is `(2,)`: by one walk, and without the zeros of a shift's orientation rows."""
    flange, tool, twists = walked_twists(form, model, observed.joint)
    sight = _seen(observed, flange, tool, robust)
    root = jnp.sqrt(sight.weight)
    shifts, spins = [], []
    for twist, turning in zip(twists, _turning(form), strict=True):
        if twist.angular is None:
            shifts.append(twist.linear)
            continue
        shifts.append(twist.linear + jnp.moveaxis(cross(jnp.moveaxis(twist.angular, 1, 0), tool.origin[:, None]), 0, 1))
        spins.append(twist.angular if turning.all() else twist.angular[np.flatnonzero(turning)])

    def product(columns: list[Array], rows: Array) -> tuple[Array, Array]:
        J = (root * jnp.concatenate(columns)).reshape(sum(map(len, columns)), -1)
        return J @ (root * rows).reshape(-1), J @ J.T

    per_metre = observed.whitener[0]
    gradient, curvature = product(shifts, sight.whitened[:POSITION])
    gradient, curvature = per_metre * gradient, per_metre**2 * curvature
    if len(sight.raw) == POSE:
        per_radian, at = observed.whitener[1], np.flatnonzero(np.concatenate(_turning(form)))
        of_spins, among_spins = product(spins, _to_sensor(observed, sight.whitened[POSITION:]))
        gradient = gradient.at[at].add(per_radian * of_spins)
        curvature = curvature.at[np.ix_(at, at)].add(per_radian**2 * among_spins)
    order = step_order(form)
    return sight.cost, gradient[order], curvature[order][:, order]


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

        return twist_columns(form, model, observed.joint, rows)

    by_linear, by_angular = by_twist(observed, sight.tool)

    def rows(twist: Twist) -> Array:
        shift = jnp.sum(by_linear * twist.linear, 1)
        return root * (shift if twist.angular is None else shift + jnp.sum(by_angular * twist.angular, 1))

    return twist_columns(form, model, observed.joint, rows)


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


def walked_twists(form: ModelForm, model: ArmModel, joint: Turn) -> tuple[Frame, Frame, list[Twist]]:
    """The flange's and the tool's frames, and the twists of all entries of a step, in sensor coordinates.

    The twists have the leading axes of `sweep`, and those of the sensor's frame and of the tool one of length one.
    `step_order` says which is which.
    """
    return _walked(form, model, joint, lambda twist: twist)


def twist_columns(form: ModelForm, model: ArmModel, joint: Turn, emit: Callable[[Twist], Array]) -> Array:
    """What `emit` makes of the twist of each entry of a step, before `step_order`.

    Args:
        form: which entries.
        model: where.
        joint: the joints' motions.
        emit: maps a twist, in sensor coordinates, to an array; all of one shape.
    """
    return jnp.concatenate(_walked(form, model, joint, emit)[2])


def _walked(
    form: ModelForm, model: ArmModel, joint: Turn, emit: Callable[[Twist], Any]
) -> tuple[Frame, Frame, list[Any]]:
    samples = joint.cos.shape[-1]
    flange, emitted = sweep(form.chain, model.geometry, joint, base_frame(model.T_sensor_base, samples), emit)
    tool = tool_frame(model, flange)
    twists = []
    if form.frame:
        fixed = base_frame(jnp.eye(4).at[:3, 3].set(model.T_sensor_base[:3, 3]), samples)
        twists += _frame_twists(fixed, fixed)
    if form.tool:
        twists += _frame_twists(flange, tool)
    return flange, tool, [*emitted, *(jax.tree.map(lambda leaf: leaf[None], emit(twist)) for twist in twists)]


def step_order(form: ModelForm) -> np.ndarray:
    """Where among `twist_columns` each entry of a step stands."""
    swept = sweep_order(form.chain)
    geometry = np.argsort(swept, kind="stable")[: form.chain.size]
    return np.concatenate([geometry, swept.size + np.arange(form.size - form.chain.size)])


def _turning(form: ModelForm) -> list[np.ndarray]:
    """Which twists of each array of `walked_twists` are of rotations, the others of shifts or of nothing."""
    swept, chain = sweep_order(form.chain), form.chain
    units = np.append(chain.units, "")[swept]  # of what is always zero, no unit
    of_base, of_joints = units[: chain.base_size, None], units[chain.base_size :].reshape(-1, chain.dof)
    frames = np.array(form.units[chain.size :])[:, None]
    return [group == "rad" for group in (*of_base, *of_joints, *frames)]


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
