"""A simulator as the nominal arm of a log of commands, and how far its own rollouts are from the log and from ours."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from lite6jax.arms.simulator import SimulatedMotion, Simulator
from lite6jax.array_types import Array
from lite6jax.domains.torque.rows import require_joints
from lite6jax.domains.tracking.coupling import loads_along
from lite6jax.domains.tracking.model import TrackingModel, roll_out
from lite6jax.domains.tracking.rollout import RETURN, hold_commands
from lite6jax.domains.tracking.rows import TrackingRows, even_rows, period_of
from lite6jax.errors import InputError
from lite6jax.recordings import Recording
from lite6jax.recordings.settings import ServoSettings

_DIFFERENT = 6e-5
"""rad RMS of a joint, from which two rollouts of one model are said to differ: some times what its steps are worth."""
_CHOOSE = "choose the arm it is of"
"""The remedy of what has another number of joints than its arm."""
_NO_LIMIT = 1e7
"""Nm, of a joint without a limit beside one with."""
_OFTEN = 1e-3
"""Share of the samples, from which a torque limit counts as reached: runs may begin away from their commands."""
_FINE = 1e-4
"""s, of the steps by which it is seen whether those of the file make the difference."""


@final
@dataclass(frozen=True, eq=False)
class SimulatorComparison:
    """What MuJoCo makes of the commands of a log.

    Attributes:
        file: its name.
        timestep: s.
        position: `(joint, sample)` rad, where it takes the joints.
        apart: `(joint,)` rad RMS, from the rollout here of the same model.
        apart_fine: likewise, with steps of 0.1 ms; None where `apart` is small.
        clipped: share of the samples at which a command is outside its range.
        touching: likewise, at which bodies touch.
        at_limit: likewise, at which a joint is beyond the end of its range.
        at_torque_limit: likewise, at which a servo exerts all it may.
        payload: kg at the flange in the log, which the file is not given.
    """

    file: str
    timestep: float
    position: Array
    apart: Array
    apart_fine: Array | None
    clipped: float
    touching: float
    at_limit: float
    at_torque_limit: float
    payload: float

    def to_dict(self) -> dict[str, object]:
        """As values of JSON."""
        fine = self.apart_fine
        return {
            "file": self.file,
            "timestep_s": self.timestep,
            "apart_rms_by_joint_rad": self.apart.tolist(),
            "apart_rms_by_joint_rad_at_fine_steps": None if fine is None else fine.tolist(),
            "clipped_share": self.clipped,
            "touching_share": self.touching,
            "at_limit_share": self.at_limit,
            "at_torque_limit_share": self.at_torque_limit,
            "differs": fine is not None,
            "payload_left_out_kg": self.payload,
        }


@contextmanager
def naming_the_chain(simulator: Simulator) -> Iterator[None]:
    """Lets errors on the number of joints within say how the chain of a simulator is named.

    Raises:
        InputError: that of within.
    """
    file = simulator.path.name
    names = ", ".join(simulator.arm.joint_names or ())
    remedy = f"name the chain of the log, {file}#TIP or {file}#BASE:TIP, in place of {names}"
    try:
        yield
    except InputError as error:
        raise InputError(str(error).replace(_CHOOSE, remedy)) from error


def with_simulator(recording: Recording, simulator: Simulator) -> Recording:
    """The recording with the servos and the gravity of a simulator, in which a payload is a body of its own.

    Raises:
        InputError: another number of joints.
    """
    with naming_the_chain(simulator):
        require_joints(recording, simulator.arm)
    declared = recording.settings.servo
    limits = _reached_limits(simulator, recording)
    hold = declared.hold if isinstance(declared, ServoSettings) else "previous"
    servo = ServoSettings(
        stiffness_Nm_per_rad=tuple(simulator.stiffness.tolist()),
        damping_Nm_s_per_rad=tuple(simulator.damping.tolist()),
        delay_s=simulator.delay,
        hold=hold,
        gravity_compensation=simulator.compensated,
        torque_limit_Nm=tuple(np.minimum(limits, _NO_LIMIT).tolist()) if np.isfinite(limits).any() else None,
        time_constant_s=tuple(simulator.time_constant.tolist()) if simulator.time_constant.any() else None,
    )
    x, y, z = simulator.gravity.tolist()
    settings = replace(recording.settings, servo=servo, gravity_m_per_s2=(x, y, z), factory_calibration=None)
    return replace(recording, settings=settings, payload=np.zeros_like(recording.payload))


def _reached_limits(simulator: Simulator, recording: Recording) -> Array:
    """`(joint,)` Nm, the torque limits that MuJoCo reaches with the commands of a log; others are infinite.

    MuJoCo limits a servo's torque with its damping, the rollouts here without, which then seem to reach a limit first.
    """
    limits = simulator.torque_limit
    if not np.isfinite(limits).any() or recording.time is None or recording.commanded_position is None:
        return np.full_like(limits, np.inf)
    even = even_rows(recording)
    period = period_of(even)
    motion = simulator.rolled_out(np.asarray(even.commanded_position), even.run, period, even.joint_position)
    return np.where(motion.at_torque_limit.mean(0) > _OFTEN, limits, np.inf)


def compare_simulator(simulator: Simulator, data: TrackingRows, payload: float = 0.0) -> SimulatorComparison:
    """What MuJoCo makes of the commands of a log, beside the rollout here of the same arm.

    Args:
        simulator: whose arm and servos the log has, as by `with_simulator`.
        data: the log.
        payload: kg, that the log has and the simulator has not.
    """
    recording = data.recording
    servo = recording.settings.servo
    interpolated = isinstance(servo, ServoSettings) and servo.hold == "interpolated"
    command = np.asarray(recording.commanded_position)
    run = recording.run
    period = data.commands.period
    start = data.commands.start

    def simulated(timestep: float | None = None) -> SimulatedMotion:
        return simulator.rolled_out(command, run, period, start, interpolated, timestep)

    motion = simulated()
    position = motion.position.T
    here = _rolled_out(simulator, data, interpolated)
    apart = np.sqrt(np.mean((position - here) ** 2, 1))
    fine = None
    if not np.all(apart < _DIFFERENT):
        finer = simulated(min(_FINE, simulator.timestep))
        fine = np.sqrt(np.mean((finer.position.T - here) ** 2, 1))
    return SimulatorComparison(
        file=simulator.path.name,
        timestep=simulator.timestep,
        position=position,
        apart=apart,
        apart_fine=fine,
        clipped=float(motion.clipped.mean()),
        touching=float(motion.touching.mean()),
        at_limit=float(motion.at_limit.mean()),
        at_torque_limit=float(motion.at_torque_limit.any(1).mean()),
        payload=payload,
    )


def _rolled_out(simulator: Simulator, data: TrackingRows, interpolated: bool) -> Array:
    """`(joint, sample)` rad, with friction that holds joints as MuJoCo does in that file."""
    command = np.asarray(data.recording.commanded_position)
    given = data.commands
    commands = hold_commands(command, data.recording.run, given.period, given.start, None, interpolated)
    servo = data.servo._replace(grip=simulator.friction_hold / RETURN)
    still = np.zeros_like(command.T)
    loads = loads_along(data.bodies, commands, command.T, still, still)
    readout, _ = roll_out(TrackingModel(servo, data.bodies), commands, loads, None, coupled=data.has_masses)
    return readout
