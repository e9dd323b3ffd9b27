"""Residuals of measured poses and their derivatives: of a rigid arm on the host, of a deflected one in JAX."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from lite6jax import threads
from lite6jax.arms import frames
from lite6jax.arms.chains import Form
from lite6jax.array_types import Array
from lite6jax.calibration.start import measured_rotations
from lite6jax.effects.deflection import Deflection
from lite6jax.model import ArmModel, predict_bent
from lite6jax.recordings import Recording
from lite6jax.sensors.pose import PoseSensor
from lite6jax.sensors.sensor import Sensor

Site = tuple[str, int, int]
"""A field of `Deflection`, the joint or link in it from 0, and the component of a twist.

As a nuisance also `mass`, its link from 0, and which of the errors of `with_mass_errors`; `payload`, 0, 0, in kg; and
`moved base` or `moved tool`, which of a recording's frame jumps from 0, and the component of a twist;
`reading`, which of a sensor's own unknowns from 0, and 0; and `wave`, which joint's error once a turn, and 0 of its
sine or 1 of its cosine, in rad.
"""
FRAMES = ("base", "link", "tool")
"""Names of the sites that displace a frame of the arm in all samples."""

_ROUNDING = 1e-12


class RigidFrames(NamedTuple):
    """The frames of a rigid arm in the sensor's frame.

    Attributes:
        frames: `(joint + 1, sample, 4, 4)`, the base and the frame after each joint's motion.
        tool: `(sample, 4, 4)`.
    """

    frames: Array
    tool: Array


def rigid_frames(model: ArmModel, joint_position: Array, sliding: tuple[int, ...]) -> RigidFrames:
    """The frames of a six-parameter chain with the prismatic joints `sliding` at `(joint, sample)` rad or m."""
    poses = list(_walked(model, joint_position, sliding))
    return RigidFrames(np.stack(poses), _tool(model, poses[-1]))


def rigid_tool(model: ArmModel, joint_position: Array, sliding: tuple[int, ...]) -> Array:
    """The tool of `rigid_frames` alone, `(sample, 4, 4)`."""
    *_, flange = _walked(model, joint_position, sliding)
    return _tool(model, flange)


def _tool(model: ArmModel, flange: Array) -> Array:
    return (flange.reshape(-1, 4) @ np.asarray(model.T_flange_tool)).reshape(-1, 4, 4)


def _walked(model: ArmModel, joint_position: Array, sliding: tuple[int, ...]) -> Iterator[Array]:
    links = frames.transform_from_row(np.asarray(model.geometry).reshape(-1, 6))
    return frames.walk(links, joint_position.T, sliding, np.asarray(model.T_sensor_base))


def rigid_residuals(model: ArmModel, joint_position: Array, sliding: tuple[int, ...], measured: Sensor) -> Array:
    """The sensor's differences of a chain at `(joint, sample)` rad or m, block by block: not all frames are kept."""
    residuals = np.empty((measured.rows, joint_position.shape[1]))

    def block(first: int) -> None:
        rows = slice(first, first + frames.BLOCK)
        tool = rigid_tool(model, joint_position[:, rows], sliding)
        residuals[:, rows] = measured.select(rows).differences(tool)

    threads.by_parts(block, range(0, residuals.shape[1], frames.BLOCK))
    return residuals


def whitened(columns: Array, whitener: Array) -> Array:
    """Columns `(…, row, sample)` in m and rad over the standard deviation of the noise."""
    if whitener.ndim == 1:
        return columns * np.repeat(whitener, 3)[: columns.shape[-2], None]
    return np.einsum("abs,...bs->...as", whitener, columns)


def unwhitened(rows: Array, whitener: Array) -> Array:
    """The inverse of `whitened`, of rows `(row, sample)`."""
    if whitener.ndim == 1:
        return rows / np.repeat(whitener, 3)[: len(rows), None]
    return np.linalg.solve(np.moveaxis(whitener, -1, 0), rows.T[..., None])[..., 0].T


class BentFrames(NamedTuple):
    """Where the twists of an arm act, in the sensor's frame: sensor, base, what follows each joint, and the tool.

    Attributes:
        before: `(site, sample, 4, 4)`, the frames that are displaced: translations are along their axes.
        turning: `(site, sample, 4, 4)`, the axes about which a change of the rotation vector turns, at the displaced
            origin.
        tool: `(sample, 4, 4)`.
    """

    before: Array
    turning: Array
    tool: Array


def bent_frames(model: ArmModel, joint_position: Array, sliding: tuple[int, ...], deflection: Deflection) -> BentFrames:
    """The frames of a six-parameter chain with a dense deflection, in the order of `predict_bent`."""
    bent: Any = jax.tree.map(np.asarray, deflection)
    links = frames.transform_from_row(np.asarray(model.geometry).reshape(-1, 6))
    samples = joint_position.shape[1]
    T = np.tile(np.eye(4), (samples, 1, 1))
    before = []
    turning = []

    def displaced_by(twist: Array) -> Array:
        before.append(T)
        if not twist.any():  # the same numbers: of equal sites the search takes the first
            turning.append(T)
            return T
        turning.append(T @ turned_axes(twist))
        return T @ displacements(twist)

    T = displaced_by(bent.sensor) @ np.asarray(model.T_sensor_base)
    T = displaced_by(bent.base)
    for joint, link in enumerate(links):
        along = np.tile(link, (samples, 1, 1))
        along[:, :3, 3] *= 1 + bent.stretch[joint][:, None]
        motion = np.zeros((6, samples))
        motion[2 if joint in sliding else 5] = joint_position[joint] + bent.joint[joint]
        T = T @ along @ displacements(motion)
        T = displaced_by(bent.link[joint])
    tool = displaced_by(bent.tool) @ np.asarray(model.T_flange_tool)
    of_sites = BentFrames(np.stack(before), np.stack(turning), tool)
    for transforms in of_sites:
        transforms[..., :3, 3] *= 1 + bent.scale[:, None]
    return of_sites


def site_columns(
    model: ArmModel,
    joint_position: Array,
    measured: Sensor,
    sliding: tuple[int, ...],
    deflection: Deflection | None = None,
) -> dict[Site, Array]:
    """How whitened residuals `(row, sample)` change with a unit deflection at each site.

    Args:
        model: the arm.
        joint_position: `(joint, sample)` rad, m of prismatic joints.
        measured: what is seen of it.
        sliding: which joints are prismatic.
        deflection: of the arm, dense; it is rigid where that is not given.
    """
    dof = len(joint_position)
    if deflection is None:
        rigid = rigid_frames(model, joint_position, sliding)
        sensor = np.broadcast_to(np.eye(4), rigid.frames[:1].shape)
        before = np.concatenate([sensor, rigid.frames, rigid.frames[-1:]])
        at = BentFrames(before, before, rigid.tool)
    else:
        at = bent_frames(model, joint_position, sliding, deflection)
    slid = np.where(np.isin(np.arange(dof), sliding)[:, None], joint_position, 0.0)
    twists, turns, stretches, scale = site_differences(at, slid, measured)
    columns = whitened(
        np.concatenate([twists.reshape(-1, *twists.shape[2:]), turns, stretches, scale[None]]), measured.whitener
    )
    visible = np.abs(columns).max((1, 2), initial=0.0)
    columns[visible < _ROUNDING * visible.max()] = 0.0  # rounding: the last joint's, of a point on its axis
    twisted = columns[: 6 * (dof + 3)].reshape(dof + 3, 6, *columns.shape[1:])
    turned, stretched = np.split(columns[6 * (dof + 3) : -1], 2)
    sites: dict[Site, Array] = {("base", 0, k): twisted[1, k] for k in range(6)}
    for j in range(dof):
        sites |= {("link", j, k): twisted[j + 2, k] for k in range(6)}
        sites["joint", j, 0] = twisted[j + 2, 2] if j in sliding else turned[j]
        sites["stretch", j, 0] = stretched[j]
    sites |= {("tool", 0, k): twisted[dof + 2, k] for k in range(6)}
    sites |= {("sensor", 0, k): twisted[0, k] for k in range(6)}
    sites["scale", 0, 0] = columns[-1]
    return sites


def displaced(model: ArmModel, unknown: Sequence[Site], nuisance: Array) -> ArmModel:
    """The rigid arm with the frames at the sites `unknown` displaced by `nuisance` `(unknown,)`, m and rad."""
    twists: dict[tuple[str, int], Array] = {}
    for (name, j, k), value in zip(unknown, nuisance, strict=True):
        if name in FRAMES:
            twists.setdefault((name, j), np.zeros(6))[k] = value
    rows = np.array(np.asarray(model.geometry).reshape(-1, 6))
    T_sensor_base, T_flange_tool = (np.array(leaf) for leaf in model[1:])
    for (name, j), twist in twists.items():
        T = small_displacement(twist)
        if name == "base":
            T_sensor_base = T_sensor_base @ T
        elif name == "tool":
            T_flange_tool = T @ T_flange_tool
        else:
            rows[j + 1] = frames.row_from_transform(T @ frames.transform_from_row(rows[j + 1]))
    return ArmModel(rows.ravel(), T_sensor_base, T_flange_tool)  # type: ignore[arg-type]


def small_displacement(twist: Array) -> Array:
    """`(4, 4)` of a displacement `(6,)`: its translation in m, and its rotation vector in rad."""
    return displacements(twist[:, None])[0]


def displacements(twist: Array) -> Array:
    """`(sample, 4, 4)` of displacements `(6, sample)`, as `small_displacement`."""
    T = np.tile(np.eye(4), (twist.shape[1], 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(np.array(twist[3:].T)).as_matrix()
    T[:, :3, 3] = twist[:3].T
    return T


def turned_axes(twist: Array) -> Array:
    """`(sample, 4, 4)`: about which axes, and where, a displacement `(6, sample)` turns as its rotation vector changes.

    That is the left Jacobian of a rotation vector r, 1 + [r]/2 + [r]²/6 with an error of third order, at the displaced
    origin.
    """
    cross = np.cross(twist[3:].T[:, None], np.eye(3)).swapaxes(1, 2)
    T = np.tile(np.eye(4), (twist.shape[1], 1, 1))
    T[:, :3, :3] += cross / 2 + cross @ cross / 6
    T[:, :3, 3] = twist[:3].T
    return T


def unit_quaternions(rotation: Array) -> Array:
    """`(sample, 4)` of rotations `(sample, 3, 3)`: scalar first, the first component that is not zero positive."""
    return Rotation.from_matrix(rotation).as_quat(scalar_first=True, canonical=True)


def measured_poses(recording: Recording, whitener: Array) -> PoseSensor:
    """The poses of a recording."""
    position = recording.position
    turned = measured_rotations(recording)
    assert position is not None
    rotation = np.zeros((3, 3, 0)) if turned is None else np.moveaxis(turned, 0, -1)
    measured = PoseSensor(np.ascontiguousarray(position.T), rotation, whitener)
    if recording.stations:
        further = np.tile(np.eye(4), (len(recording.stations), 1, 1))
        measured = replace(measured, station=recording.station, stations=further)
    board_poses = None
    if recording.readings is not None:
        board_poses = recording.readings.seen
    if board_poses is None or not board_poses.mean.size:
        return measured
    # with their deviations as units
    constants = np.linalg.solve(board_poses.whitener, board_poses.by_numbers)
    return replace(
        measured,
        constants=np.moveaxis(constants, 0, -1).swapaxes(0, 1),
        at=board_poses.mean,
        mean=board_poses.mean,
        deviation=board_poses.deviation,
    )


def rigid_columns(rigid: RigidFrames, measured: Sensor) -> Array:
    """How differences change with twists of the base and of the frame after each joint, `(frame, 6, row, sample)`."""
    return _twist_columns(BentFrames(rigid.frames, rigid.frames, rigid.tool), measured)


def site_differences(at: BentFrames, slid: Array, measured: Sensor) -> tuple[Array, Array, Array, Array]:
    """How differences change with deflections at every site of an arm.

    Args:
        at: where they act.
        slid: `(joint, sample)` m, by how much prismatic joints have moved along their axes; zero of others.
        measured: what is seen.

    Returns:
        twists `(site, 6, row, sample)`; turns about each joint's axis and stretches before it, `(joint, row, sample)`;
        and the scale `(row, sample)`.
    """
    joints = slice(2, -1)
    origins = np.moveaxis(at.before[joints, :, :3, 3], 1, -1)  # (joint, component, sample)
    axes = np.moveaxis(at.before[joints, :, :3, 2], 1, -1)
    tool = at.tool[:, :3, 3].T
    turns = measured.columns(at.tool, np.cross(axes, tool - origins, axis=1), axes)
    stretches = origins - slid[:, None] * axes - np.moveaxis(at.turning[1:-2, :, :3, 3], 1, -1)
    along = np.concatenate([stretches, tool[None]])
    lengths = measured.columns(at.tool, along)
    return _twist_columns(at, measured), turns, lengths[:-1], lengths[-1]


def _twist_columns(at: BentFrames, measured: Sensor) -> Array:
    axes = np.moveaxis(at.before[:, :, :3, :3], 1, -1).swapaxes(1, 2)  # (site, axis, component, sample)
    about = np.moveaxis(at.turning[:, :, :3, :3], 1, -1).swapaxes(1, 2)
    lever = at.tool[:, :3, 3].T - np.moveaxis(at.turning[:, :, :3, 3], 1, -1)
    turned = np.cross(about, lever[:, None], axis=2)
    return np.concatenate([measured.columns(at.tool, axes), measured.columns(at.tool, turned, about)], 1)


@partial(jax.jit, static_argnums=0)
def bent_residual(
    form: Form, model: ArmModel, joint_position: jax.Array, deflection: Deflection, measured: Sensor
) -> jax.Array:
    """Whitened residuals `(row, sample)` of a deflected arm."""
    return measured.residual(predict_bent(form, model, joint_position, deflection)[1])
