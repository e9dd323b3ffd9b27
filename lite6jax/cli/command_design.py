"""What `design --tracking` takes: an arm, a log of commands or its diagnosis; and what it writes."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from tyro.conf import arg

from lite6jax.cli import command
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError
from lite6jax.storage import write_atomically

with import_lazily():
    import numpy as np

    from lite6jax import recordings, simulation
    from lite6jax.arms import arm as arms
    from lite6jax.arms import files
    from lite6jax.calibration import source as sources
    from lite6jax.design import command_plans, tracking
    from lite6jax.diagnosis import document as diagnosis_file
    from lite6jax.domains.tracking import predict as servos
    from lite6jax.domains.tracking import rows
    from lite6jax.recordings import files as recording_files
    from lite6jax.recordings import settings as sidecar_settings

if TYPE_CHECKING:
    from lite6jax.cli.study import Setup, TorqueSetup

_LITE6 = ("lite6", "lite6_ros")
_SPEED_UP = 0.2
"""s, in which commands reach the velocity of a log, where no acceleration is given."""
_LEAST_SHARE = 0.25
"""Of the fastest joint's velocity in a log, that others are allowed at least."""
_SELDOM = 0.999
"""Quantile of a joint's speed in a log that counts as its greatest."""


@dataclass(frozen=True)
class CommandSetup:
    """Commands in place of poses, of which a log is to tell effects on how the arm follows apart."""

    tracking: bool = False
    """Design commands for a log of commands and measured joints. Of a diagnosis they tell its findings from what it
    does not distinguish them from; of an arm or a log all named effects from each other."""
    payloads: Annotated[tuple[float, ...], arg(metavar="KG…")] = ()
    """Masses at the flange, with each of which the commands are recorded once; that of the log or none where not
    given."""
    stiffness: Annotated[tuple[float, ...], arg(metavar="NM_PER_RAD…")] = ()
    """Of the servos of an arm: one for all joints or one for each; as inertia asks for where not given."""
    damping: Annotated[tuple[float, ...], arg(metavar="NM_S_PER_RAD…")] = ()
    """Of its servos, likewise."""
    servo: command.Known = "known"
    """Whether stiffness and damping of an arm's servos are known."""


class Studied(NamedTuple):
    """What commands are designed for.

    Attributes:
        experiment: the arm, and what is to be distinguished.
        velocity: `(joint,)` rad/s, that commands may have.
        acceleration: `(joint,)` rad/s², likewise.
        notes: what was assumed, a sentence each.
    """

    experiment: "tracking.CommandExperiment"
    velocity: "np.ndarray"
    acceleration: "np.ndarray"
    notes: tuple[str, ...]


def study_source(
    options: CommandSetup, source: str, recorded: Path | None, limits: "TorqueSetup", setup: "Setup"
) -> Studied:
    """Reads what commands are designed for.

    Raises:
        InputError: a file of another kind, servos or limits that are neither declared nor given, or options that the
            file has an answer to.
    """
    payloads = command_plans.payloads_of(options.payloads) if options.payloads else ()
    if not (math.isfinite(setup.joint_noise) and setup.joint_noise >= 0):
        raise InputError(f"--joint-noise {setup.joint_noise:g}: give a standard deviation in degrees, 0 or more")
    given = {"--stiffness": options.stiffness, "--damping": options.damping, "--gravity": limits.gravity}
    given |= {"--servo": options.servo != "known"}
    log = recordings.recording_file(source) is not None
    if log or Path(source).suffix.lower() == ".json":
        for option, value in given.items():
            if value:
                raise InputError(f"{option}: is of an arm, and {source} says it; leave it out")
        if log and recorded is not None:
            raise InputError(f"--recorded {recorded}: {source} is a log already; give the other one's diagnosis")
        studied = _of_log(source) if log else _of_diagnosis(Path(source), recorded)
    else:
        studied = _of_arm(options, source, recorded, limits)
    experiment = replace(studied.experiment, payloads=payloads)
    if setup.joint_noise:
        noise = max(math.radians(setup.joint_noise), rows.FLOOR)
        experiment = replace(experiment, noise=np.full(experiment.model.dof, noise))
    velocity, acceleration, notes = _limits(experiment.model.arm, source, limits, studied.speeds)
    return Studied(experiment, velocity, acceleration, (*studied.notes, *notes))


class _CommandSource(NamedTuple):
    """What a file or an arm says.

    Attributes:
        experiment: the arm, and what is to be distinguished.
        notes: what was assumed.
        speeds: `(joint,)` rad/s, of the log; None where there is none.
    """

    experiment: "tracking.CommandExperiment"
    notes: tuple[str, ...] = ()
    speeds: "np.ndarray | None" = None


def _of_arm(options: CommandSetup, source: str, recorded: Path | None, limits: "TorqueSetup") -> _CommandSource:
    """An arm whose servos are given, or as stiff as its inertia asks for."""
    arm = files.read_arm(source)
    _require_revolute(arm)
    notes = ()
    usual = simulation.usual_servo(arm) if arm.mass is not None else None
    if not (options.stiffness and options.damping):
        if usual is None:
            raise InputError(
                f"{source}: has no masses that would say how stiff its servos are; give --stiffness and --damping"
            )
        notes = ("The servos are taken to be as stiff as the inertia of the arm asks for.",)
    servo = sidecar_settings.ServoSettings(
        stiffness_Nm_per_rad=_numbers("stiffness", options.stiffness, arm)
        or (usual.stiffness_Nm_per_rad if usual else ()),
        damping_Nm_s_per_rad=_numbers("damping", options.damping, arm) or (usual.damping_Nm_s_per_rad if usual else ()),
    )
    settings = recordings.RecordingSettings(servo=servo)
    if limits.gravity is not None:
        settings = replace(settings, gravity_m_per_s2=limits.gravity)
    model = servos.describe_servos(arm, settings, 0.0)
    log = None if recorded is None else _read_log(recorded, arm)
    noise = np.full(arm.dof, tracking.NOISE)
    experiment = tracking.CommandExperiment(model, options.servo == "known", noise, recorded=log)
    notes = (*notes, f"Read-outs are taken to scatter by {1e3 * tracking.NOISE:g} mrad; --joint-noise says otherwise.")
    return _CommandSource(experiment, notes, None if log is None else _speeds(log))


def _numbers(option: str, given: tuple[float, ...], arm: "arms.Arm") -> tuple[float, ...]:
    """Numbers of all joints, of one number or one for each; none where none is given."""
    numbers = given * arm.dof if len(given) == 1 else given
    if numbers and (len(numbers) != arm.dof or not all(0 < number < math.inf for number in numbers)):
        shown = " ".join(f"{number:g}" for number in given)
        raise InputError(f"--{option} {shown}: give one number above 0, or one for each of the {arm.dof} joints")
    return tuple(numbers)


def _of_log(source: str) -> _CommandSource:
    """A log whose sidecar declares arm and servos."""
    log = sources.load_recording(source, None)
    arm = sources.with_calibration(sources.declared_arm_of(log), log)
    _require_revolute(arm)
    _require_commands(log, arm, source)
    settings = log.settings
    if not isinstance(settings.servo, sidecar_settings.ServoSettings):
        raise InputError(
            f"{source}: its sidecar does not declare `servo`; give its diagnosis, which has the servos, in its place"
        )
    model = servos.describe_servos(arm, settings, rows.usual_payload(log))
    quanta = np.array([rows.quantum(column) for column in log.joint_position.T])
    declared = settings.joint_noise_rad
    noise = np.sqrt((declared or tracking.NOISE) ** 2 + quanta**2 / 12 + rows.FLOOR**2)
    notes = () if declared else (f"Read-outs are taken to scatter by {1e3 * tracking.NOISE:g} mrad.",)
    return _CommandSource(tracking.CommandExperiment(model, True, noise, recorded=log), notes, _speeds(log))


def _of_diagnosis(source: Path, recorded: Path | None) -> _CommandSource:
    """A diagnosis of a log, with that log where it is beside it."""
    document = diagnosis_file.parse_document(source)
    model = diagnosis_file.model_from_document(document, (), str(source), "tracking")
    assert isinstance(model, servos.DiagnosedServos)
    with command.refuse_damage(source):
        undecided = tracking.undecided_of(document, model)
        noise = tracking.noise_of(document)
        declared = document["servo"] == "declared"
        logs = _diagnosed_logs(document, source) if recorded is None else [recorded]
    notes = []
    log = None
    if logs:
        read = [_read_log(file, model.arm) for file in logs]
        log = read[0] if len(read) == 1 else recordings.join_recordings(read)
    else:
        notes.append(f"The log that was diagnosed is not beside {source.name}: it does not count; --recorded names it.")
    if not undecided:
        notes.append("The diagnosis leaves no effect undecided: all named effects are distinguished.")
    experiment = tracking.CommandExperiment(model, declared, noise, undecided, log)
    return _CommandSource(experiment, tuple(notes), np.abs(model.ranges.velocity).max(1))


def _diagnosed_logs(document: Mapping[str, Any], source: Path) -> list[Path]:
    """The logs that were diagnosed, where all of them are beside the diagnosis or here; else none."""
    names = [entry["file"] for entry in document.get("inputs", ()) if entry["role"] == "recording"]
    places = [next((file for file in (source.with_name(name), Path(name)) if file.is_file()), None) for name in names]
    return [file for file in places if file is not None] if None not in places else []


def _read_log(path: Path, arm: "arms.Arm") -> "recordings.Recording":
    """A log of commands that is recorded already."""
    log = sources.load_recording(path, arm)
    _require_commands(log, arm, str(path))
    return log


def _require_commands(log: "recordings.Recording", arm: "arms.Arm", source: str) -> None:
    if log.commanded_position is None or log.time is None:
        raise InputError(f"{source}: is no log of commands; it needs time_s, q1_rad ... and cmd1_rad ...")
    if log.dof != arm.dof:
        raise InputError(f"{source}: has {log.dof} joints, the arm {arm.name} {arm.dof}; give a log of that arm")


def _require_revolute(arm: "arms.Arm") -> None:
    if arm.sliding:
        raise InputError(f"{arm.name}: has prismatic joints, for which no commands are designed; choose another arm")


def _speeds(log: "recordings.Recording") -> "np.ndarray":
    """`(joint,)` rad/s, the greatest speeds of the joints in a log."""
    velocity = np.asarray(rows.measured_motion(rows.even_rows(log)).joint_velocity)
    return np.quantile(np.abs(velocity), _SELDOM, axis=1)


def _limits(
    arm: "arms.Arm", source: str, given: "TorqueSetup", speeds: "np.ndarray | None"
) -> "tuple[np.ndarray, np.ndarray, tuple[str, ...]]":
    """The limits of velocity and acceleration, given, of a Lite 6, or by the speeds of a log; and what was assumed."""
    velocity = _in_radians("velocity", given.velocity, arm)
    acceleration = _in_radians("acceleration", given.acceleration, arm)
    notes = []
    if velocity is None and speeds is not None and speeds.max() > 0:
        velocity = np.maximum(speeds, _LEAST_SHARE * speeds.max())
        notes.append("No joint is faster than in the log; --velocity sets other limits.")
    of_lite6 = arm.name in _LITE6
    if velocity is None and of_lite6:
        velocity = np.full(arm.dof, np.deg2rad(180.0))
    if acceleration is None and of_lite6:
        acceleration = np.full(arm.dof, np.deg2rad(1146.0))
    if acceleration is None and velocity is not None and speeds is not None:
        acceleration = velocity / _SPEED_UP
        notes.append(f"Accelerations reach that in {_SPEED_UP:g} s; --acceleration sets other limits.")
    if velocity is None or acceleration is None:
        missing = [
            f"--{name} {unit}"
            for name, unit, value in (("velocity", "DEG/S", velocity), ("acceleration", "DEG/S²", acceleration))
            if value is None
        ]
        raise InputError(
            f"{source}: declares no limit of these; give {' and '.join(missing)}, one number or one for each joint"
        )
    return velocity, acceleration, tuple(notes)


def _in_radians(name: str, given: tuple[float, ...], arm: "arms.Arm") -> "np.ndarray | None":
    """`(joint,)` of one number in degrees, or one for each joint; None where none is given."""
    if not given:
        return None
    if len(given) not in (1, arm.dof) or not all(0 < number < math.inf for number in given):
        shown = " ".join(f"{number:g}" for number in given)
        raise InputError(f"--{name} {shown}: give one number above 0, or one for each of the {arm.dof} joints")
    return np.deg2rad(np.broadcast_to(np.asarray(given, float), arm.dof))


def write_commands(plan: "command_plans.CommandPlan", out: Path, overwrite: bool) -> Path:
    """Writes `time_s` and `cmd1_rad` …"""
    import pyarrow as pa

    columns = {"time_s": plan.time} | {f"cmd{joint}_rad": row for joint, row in enumerate(plan.command.T, 1)}
    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    return write_atomically(out, lambda target: recording_files.write_table(table, target), overwrite)
