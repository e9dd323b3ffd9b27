"""What `identify` and `design` do with torques: their options, and the runs that they lead to."""

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, final

from tyro.conf import arg

from lite6jax.cli.exit_codes import DONE
from lite6jax.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from lite6jax.arms.arm import Arm
    from lite6jax.identifiability.candidates import Filter
    from lite6jax.identifiability.torque.columns import TorqueModel
    from lite6jax.identifiability.torque.fourier import Motion
    from lite6jax.identifiability.torque.planning import MotionRoom
    from lite6jax.recordings import Recording, RecordingSettings


@final
@dataclass(frozen=True)
class TorqueSetup:
    """Joint torques in place of poses, and the motion in which they are measured."""

    torque: bool = False
    """Study the torques of a motion: base parameters of the links, friction and rotor inertia of the joints."""
    torque_noise: Annotated[tuple[float, ...], arg(metavar="NM…")] = ()
    """One standard deviation of a torque, Nm, one number or one per joint (N of a prismatic one); of a recording as its
    sidecar declares, else 0.05, and 0.5 N."""
    inertial: Literal["declared", "unknown"] | None = None
    """Whether the links' masses and inertias are known as declared, or unknown; declared for --discriminate only."""
    gravity: Annotated[tuple[float, float, float] | None, arg(metavar="X Y Z")] = None
    """Gravity in the arm's base frame, m/s²; of a recording as its sidecar declares, else 0 0 -9.81."""
    duration: Annotated[float, arg(metavar="S")] = 10.0
    """Duration of the motion of an arm, from rest to rest."""
    harmonics: int = 5
    """Harmonics of each joint's Fourier series; the base frequency is that of the duration."""
    rate: Annotated[float, arg(metavar="HZ")] = 100.0
    """Samples a second."""
    velocity: Annotated[tuple[float, ...], arg(metavar="DEG/S…")] = (180.0,)
    """The greatest velocity, one number or one per joint (mm/s of a prismatic one); the default is that of a Lite 6.
    Of one number, a prismatic joint has what that is at 0.1 m: 180 deg/s is 314 mm/s."""
    acceleration: Annotated[tuple[float, ...], arg(metavar="DEG/S²…")] = (1146.0,)
    """The greatest acceleration, likewise."""

    def model(self, arm: "Arm", declared: "RecordingSettings | None" = None, unknown: bool = True) -> "TorqueModel":
        """What is unknown of an arm, and the noise.

        Args:
            declared: of a recording.
            unknown: whether the links' parameters are, where --inertial does not say.

        Raises:
            InputError: as `torque_model`.
        """
        from lite6jax.identifiability.torque.columns import GRAVITY, torque_model

        noise = self.torque_noise or (declared.torque_noise_Nm if declared else None) or None
        gravity = self.gravity or (declared.gravity_m_per_s2 if declared else GRAVITY)
        inertial = unknown if self.inertial is None else self.inertial == "unknown"
        return torque_model(arm, noise, gravity, inertial)

    def room(self, arm: "Arm", filters: "Sequence[Filter]" = (), margin: float = 0.0) -> "MotionRoom":
        """Where a motion may be.

        Raises:
            InputError: as `motion_limits` and `MotionRoom`.
        """
        from lite6jax.identifiability.torque.fourier import motion_limits
        from lite6jax.identifiability.torque.planning import MotionRoom

        limits = motion_limits(arm, _in_si(arm, self.velocity), _in_si(arm, self.acceleration), margin)
        return MotionRoom(arm, limits, filters, self.duration, self.harmonics, self.rate)


def _in_si(arm: "Arm", limits: tuple[float, ...]) -> "NDArray[np.floating]":
    """Limits as typed, of one number in degrees, or of one per joint in degrees and mm."""
    import numpy as np

    from lite6jax.report.words import joint_units

    scales, _ = joint_units(arm.sliding, arm.dof)
    return np.array(limits) / scales if len(limits) == arm.dof > 1 else np.deg2rad(limits)


def identify_arm(setup: TorqueSetup, source: str, seed: int, as_json: bool) -> int:
    """Prints what a random motion inside an arm's limits determines.

    Raises:
        InputError: an arm that cannot be read, or as `TorqueSetup`.
    """
    from lite6jax.arms.files import read_arm
    from lite6jax.identifiability.torque.planning import random_motions

    arm = read_arm(source)
    room = setup.room(arm)
    drawn = random_motions(room, seed, 1)[0]
    trajectory = room.trajectory(room.series(drawn))
    phrase = f"a random motion of {room.duration:g} s inside the limits, {len(trajectory.time)} samples"
    return _identified(setup.model(arm), trajectory.motion, source, phrase, as_json)


def identify_recording(setup: TorqueSetup, recording: "Recording", arm: "Arm", source: str, as_json: bool) -> int:
    """Prints what the motion of a recording determines.

    Raises:
        InputError: a motion without times and accelerations, or as `identify_torques`.
    """
    from lite6jax.report.words import torque_units

    motion, notes = _recorded_motion(recording)
    phrase = f"{recording.samples} samples of a recording"
    model = setup.model(arm, recording.settings)
    if recording.settings.torque_noise_Nm is None and not setup.torque_noise:
        assumed = dict.fromkeys(zip(model.noise.tolist(), torque_units(arm.sliding, arm.dof), strict=True))
        said = " and ".join(f"{noise:g} {unit}" for noise, unit in assumed)
        notes.append(f"the sidecar declares no torque_noise_Nm: {said} {'are' if len(assumed) > 1 else 'is'} assumed")
    return _identified(model, motion, source, phrase, as_json, (*recording.notes, *notes))


def _identified(
    model: "TorqueModel", motion: "Motion", source: str, phrase: str, as_json: bool, notes: tuple[str, ...] = ()
) -> int:
    from lite6jax.identifiability.torque.identify import identify_torques
    from lite6jax.report import screen, study

    found = identify_torques(model, motion, notes=notes)
    if as_json:
        print(json.dumps(found.to_dict(), indent=1, allow_nan=False))
    else:
        screen.show(study.torque_identification_report(found, source, phrase))
    return DONE


def _recorded_motion(recording: "Recording") -> "tuple[Motion, list[str]]":
    import numpy as np

    from lite6jax.effects.motion import accelerated
    from lite6jax.identifiability.torque.fourier import Motion
    from lite6jax.recordings.motion import motion_of_recording

    recording = recording.sorted_by_time()
    q, dq = recording.joint_position.T, recording.velocities().T
    if recording.motion == "static":
        return Motion(q, dq, np.zeros_like(q)), []
    if recording.joint_acceleration is not None:
        return Motion(q, dq, recording.joint_acceleration.T), []
    if recording.time is None:
        raise InputError(f"{recording.source}: has no accelerations; add time_s, or ddq1_rad_per_s2 …")
    found = accelerated(motion_of_recording(recording)).joint_acceleration
    note = "the accelerations were not recorded and come from differences of the velocities over 0.1 s"
    return Motion(q, dq, np.asarray(found)), [note]


def design_motion(
    setup: TorqueSetup,
    source: str,
    out: Path,
    reference: str,
    filters: "Sequence[Filter]",
    disabled: "Sequence[tuple[str, str]]",
    margin: float,
    discriminate: tuple[str, str] | None,
    seed: int,
    processes: int | None,
    scheduler: str | None,
    figures: Path | None,
    force: bool,
    as_json: bool = False,
) -> int:
    """Designs a motion, writes it as a recording with its sidecar, prints what it is worth.

    Args:
        reference: the arm as the sidecar names it.
        margin: rad, from the limits of the joints.
        discriminate: two effects in text.
        processes, scheduler: as `plan_motion`.
        figures: a folder.

    Raises:
        InputError: as `plan_motion` and `plan_torque_discrimination`.
    """
    from lite6jax.arms.files import read_arm
    from lite6jax.effects.dynamic.catalogue import BUILT_IN
    from lite6jax.effects.dynamic.torque_effect import TorqueEffect
    from lite6jax.effects.serialization import parse_effect
    from lite6jax.identifiability.torque.columns import GRAVITY
    from lite6jax.identifiability.torque.discrimination import plan_torque_discrimination, rival_of
    from lite6jax.identifiability.torque.planning import plan_motion
    from lite6jax.recordings import Recording, RecordingSettings, sidecar_path, write_recording
    from lite6jax.report import screen, study

    arm = read_arm(source)
    room = setup.room(arm, filters, margin)
    if discriminate is None:
        found = plan_motion(setup.model(arm), room, seed=seed, processes=processes, scheduler=scheduler)
        report = study.torque_plan_report(found, disabled, source)
    else:
        model = setup.model(arm, unknown=False)
        parsed = [
            parse_effect(text, BUILT_IN, neutral, arm.sliding)
            for text, neutral in zip(discriminate, (False, True), strict=True)
        ]
        rivals = [rival_of(effect, values, model) for effect, values in parsed if isinstance(effect, TorqueEffect)]
        found = plan_torque_discrimination(model, room, rivals, seed=seed, processes=processes, scheduler=scheduler)
        report = study.torque_discrimination_report(found, disabled, source)
    made = found.trajectory
    settings = RecordingSettings(arm=reference, motion="trajectory", gravity_m_per_s2=setup.gravity or GRAVITY)
    recording = Recording.assembled(
        made.motion.q.T,
        time=made.time,
        joint_velocity=made.motion.dq.T,
        joint_acceleration=made.motion.ddq.T,
        settings=settings,
        sliding=arm.sliding,
    )
    written = [write_recording(recording, out, force), sidecar_path(out)]
    if figures is not None:
        from lite6jax.report import canvas
        from lite6jax.report.figures import designed_motion

        drawing = designed_motion(found, source)
        written += canvas.save({figure_name(out): drawing}, figures, force)
    if as_json:
        from lite6jax.report import documents

        print(documents.text(documents.document(found), written))
        return DONE
    screen.show(report)
    screen.written(written)
    return DONE


def figure_name(out: Path) -> str:
    """Of the figure of a designed motion."""
    return f"{out.stem}_motion"


def refuse_without_torque(setup: TorqueSetup) -> None:
    """Refuses options of torques where poses are studied.

    Raises:
        InputError: as said.
    """
    given = [field.name for field in fields(setup) if getattr(setup, field.name) != field.default]
    if given:
        raise InputError(f"--{given[0].replace('_', '-')}: is for torques; add --torque")
