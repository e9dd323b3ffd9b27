"""Commands that study an arm: what poses or torques determine of it, which to record, and what its error comes from."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, final

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax.cli import command, command_design
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError
from lite6jax.fields import field_values
from lite6jax.sensors.kinds import ReadingName

with import_lazily():
    import numpy as np

    from lite6jax import formatting, recordings
    from lite6jax.arms import arm as arms
    from lite6jax.arms import files
    from lite6jax.calibration import source
    from lite6jax.design import candidates, command_plans, identify, information, motions, poses, torques
    from lite6jax.design import readings as touching
    from lite6jax.effects import serialization
    from lite6jax.report import command_designs, figures, study
    from lite6jax.sensors import usual

Designed = tuple[Any, "recordings.Recording", Iterable[Any]]
"""A design, what is written of it, and its report."""
PoseSensor = Literal["tracker", "tracker_6d", "motion_capture", "camera", "dial_gauge", "ball_bar"]
_LITE6_VELOCITY = (180.0,)
_LITE6_ACCELERATION = (1146.0,)
"""deg/s and deg/s², of every joint."""
_MOTION_DURATION = 10.0
"""s, of a motion for torques where none is given."""
_TRIED_READINGS = 2000
"""Poses that read places, among which a design chooses."""


@final
@dataclass(frozen=True)
class Setup:
    """How poses are measured; the sidecar states it for a recording that has poses."""

    sensor: Literal[PoseSensor, ReadingName] = "tracker"
    """Positions: tracker; poses: tracker_6d, motion_capture, camera; along an axis: dial_gauge; distance: ball_bar.
    Readings of which places and tool are unknown: contact (sockets), plane, distance, axis, fixed_camera,
    flange_camera."""
    places: int | None = None
    """Plates with two sockets each (2 where not given), or with a plane (3)."""
    chain: Literal["hayati", "six_parameter"] = "hayati"
    """The parameters: Hayati's effective model, or the six numbers a joint of a factory file."""
    frame: command.Known = "unknown"
    """Whether the sensor's frame is known."""
    tool: command.Known = "known"
    """Whether the measured point's place on the flange is known."""
    tool_at: command.Triple = (0.0, 0.0, 0.0)
    """The nominal place of the measured point, mm in the flange's frame."""
    axis: command.Triple = (0.0, 0.0, 1.0)
    """The dial gauge's direction, in the sensor's frame."""
    center: command.Triple = (300.0, 0.0, 0.0)
    """The ball bar's other end, mm in the sensor's frame."""
    position_noise: Annotated[float | None, arg(metavar="MM")] = None
    """One standard deviation per axis, mm, in place of the sensor's; px of a camera's corners."""
    orientation_noise: Annotated[float | None, arg(metavar="DEG")] = None
    """One standard deviation per axis, degrees."""
    joint_noise: Annotated[float, arg(metavar="DEG")] = 0.0
    """One standard deviation of a joint's read-out, degrees."""
    effect: command.EffectTexts = ()
    """An effect that is unknown too, such as joint_compliance:joint=2; may be given more than once."""
    payload: Annotated[float, arg(metavar="KG")] = 0.0
    """Mass at the flange, for effects of gravity."""

    def experiment(self, arm: "arms.Arm") -> "information.Experiment":
        """The experiment that this set-up is on an arm; refuses noise that is not positive, or of what is not
        measured."""
        for name, numbers in (("tool-at", self.tool_at), ("center", self.center), ("axis", self.axis)):
            if not np.isfinite(numbers).all():
                raise InputError(f"--{name} {' '.join(map(str, numbers))}: give three finite numbers")
        if not (math.isfinite(self.payload) and self.payload >= 0):
            raise InputError(f"--payload {self.payload}: give a mass in kg, not below 0")
        setup = self._of_readings(arm) if self.reads else self._of_poses(arm)
        if not self.effect:
            return setup
        parsed = (serialization.parse_effect(text, neutral=True, sliding=arm.sliding) for text in self.effect)
        effects, values = zip(*parsed, strict=True)
        try:
            return replace(setup, payload=self.payload).with_physics(effects, np.concatenate(values))
        except InputError as error:
            if "six-parameter chain" not in str(error):
                raise
            effect_list = ", ".join(self.effect)
            raise InputError(f"{effect_list}: needs the frames of links; add --chain six_parameter") from error

    @property
    def reads(self) -> bool:
        """Tells whether the sensor reads no poses, so that the arm is to reach its places."""
        return self.sensor in usual.READINGS

    def _of_poses(self, arm: "arms.Arm") -> "information.Experiment":
        if self.places is not None:
            raise InputError("--places: is for --sensor contact or plane; leave it out")
        sensor = usual.place_sensor(self.sensor, self.axis, command.metres(self.center)).with_noise(
            None if self.position_noise is None else self.position_noise / 1e3,
            None if self.orientation_noise is None else math.radians(self.orientation_noise),
            math.radians(self.joint_noise),
        )
        return information.plan_experiment(
            arm,
            sensor,
            chain=self.chain,
            frame=self.frame == "unknown",
            tool=self.tool == "unknown",
            tool_at=command.metres(self.tool_at),
        )

    def _of_readings(self, arm: "arms.Arm") -> "information.Experiment":
        if unsuited_options := _given(self, "chain", "frame", "tool", "axis", "center", "orientation_noise"):
            raise InputError(
                f"{unsuited_options[0]}: of {self.sensor} the six numbers of each joint, the tool and the places "
                "are unknown; leave it out"
            )
        noise = self.position_noise
        if noise is not None and not (math.isfinite(noise) and noise > 0):
            raise InputError(f"--position-noise {noise}: give one standard deviation, above 0")
        return touching.plan_reading(
            arm,
            self.sensor,
            self.places or usual.READINGS[self.sensor].usual_places,
            noise=None if noise is None else noise / (1 if self.sensor.endswith("_camera") else 1e3),
            tool_at=command.metres(self.tool_at) if any(self.tool_at) else None,
            joint_noise=math.radians(self.joint_noise),
        )


@final
@dataclass(frozen=True)
class TorqueSetup:
    """Joint torques in place of poses, and the motion in which they are measured."""

    torque: bool = False
    """Study the torques of a motion: base parameters of the links, friction and rotor inertia of the joints."""
    torque_noise: Annotated[tuple[float, ...], arg(metavar="NM…")] = ()
    """One standard deviation of a torque, Nm, one number or one per joint (N of a prismatic one); of a recording as its
    sidecar declares, else 0.05, and 0.5 N."""
    inertial: Literal["declared", "unknown"] = "unknown"
    """Whether the links' masses and inertias are known as declared, or unknown."""
    gravity: Annotated[tuple[float, float, float] | None, arg(metavar="X Y Z")] = None
    """Gravity in the arm's base frame, m/s²; of a recording as its sidecar declares, else 0 0 -9.81."""
    duration: Annotated[float | None, arg(metavar="S")] = None
    """Duration of the motion of an arm, from rest to rest; 10 s for torques, 40 s of commands where not given."""
    harmonics: int = 5
    """Harmonics of each joint's Fourier series; the base frequency is that of the duration."""
    rate: Annotated[float, arg(metavar="HZ")] = 100.0
    """Samples a second."""
    velocity: Annotated[tuple[float, ...], arg(metavar="DEG/S…")] = ()
    """The greatest velocity, one number or one per joint (mm/s of a prismatic one); 180 deg/s, that of a Lite 6, where
    not given. Of one number, a prismatic joint has what that is at 0.1 m: 180 deg/s is 314 mm/s. Commands for another
    arm take it from the log, or it must be given."""
    acceleration: Annotated[tuple[float, ...], arg(metavar="DEG/S²…")] = ()
    """The greatest acceleration, likewise; 1146 deg/s² where not given, of another arm than a Lite 6 what reaches the
    velocity of a log in 0.2 s."""

    def model(
        self, arm: "arms.Arm", declared: "recordings.RecordingSettings | None" = None
    ) -> "torques.TorqueExperiment":
        """What is unknown of an arm, and the noise, of a recording as `declared`."""
        noise = self.torque_noise or (declared.torque_noise_Nm if declared else None) or None
        gravity = self.gravity or (declared.gravity_m_per_s2 if declared else torques.GRAVITY)
        return torques.TorqueExperiment(arm, noise, gravity, self.inertial == "unknown")

    def room(
        self, arm: "arms.Arm", filters: "Sequence[candidates.Filter]" = (), margin: float = 0.0
    ) -> "motions.MotionRoom":
        """Where a motion may be."""
        scales, _ = formatting.joint_units(arm.sliding, arm.dof)
        velocity, acceleration = (  # one number in degrees, or one per joint in degrees and mm
            np.array(numbers) / scales if len(numbers) == arm.dof > 1 else np.deg2rad(numbers)
            for numbers in (self.velocity or _LITE6_VELOCITY, self.acceleration or _LITE6_ACCELERATION)
        )
        duration = _MOTION_DURATION if self.duration is None else self.duration
        return motions.MotionRoom(arm, velocity, acceleration, margin, filters, duration, self.harmonics, self.rate)


def _given(options: Any, *names: str) -> list[str]:
    """Which of some options are not at their defaults; of all where none is named."""
    values = field_values(options)
    checked_fields = (item for item in fields(options) if not names or item.name in names)
    return [f"--{item.name.replace('_', '-')}" for item in checked_fields if values[item.name] != item.default]


def _refuse_torques(options: TorqueSetup) -> None:
    """Refuses options of torques where poses are studied."""
    if torque_options := _given(options):
        raise InputError(f"{torque_options[0]}: is for torques; add --torque")


@final
@dataclass(frozen=True)
class IdentifyCommand:
    """What poses determine of an arm's parameters, or torques (--torque) of its dynamics, and how well: before anything
    is measured, or of a recording. A recording with torques or currents and no poses is studied for its torques.

    For example:

        lite6jax identify lite6 --sensor tracker --poses 60
        lite6jax identify run7.csv --figures figures
        lite6jax identify poses.csv --tool unknown --json
        lite6jax identify lite6 --torque --duration 20
    """

    source: Annotated[Positional[str], arg(metavar="ARM|FILE")]
    """A bundled arm, an arm's file, or a recording (.csv, .parquet, .mcap); one without poses lists joint positions."""
    setup: Setup = Setup()
    torque: TorqueSetup = field(default_factory=TorqueSetup)
    poses: int = 100
    """Number of poses drawn inside the limits of an arm."""
    seed: int = 0
    """Seed of the poses."""
    geometry: command.Geometry = "declared"
    """The geometry of a recording's arm: as its sidecar states; the factory calibration exactly, or with a prior about
    it; or unknown."""
    arm: command.ArmName = None
    """The nominal arm of a recording; from the sidecar where not given."""
    figures: command.Folder = None
    """Draw the standard deviations into this folder (PNG and SVG)."""
    force: command.Force = False
    json: command.Json = False
    assume_degrees: command.AssumeDegrees = False
    assume_millimetres: command.AssumeMillimetres = False

    def run(self) -> int:
        """Computes, draws, prints."""
        command.check_seed(self.seed)
        names = [f"{command.stem(self.source)}_deviations"]
        command.check_figures(self.figures, names, self.force)
        nominal = recording = None
        if recordings.recording_file(self.source) is not None:
            nominal = source.load_nominal(self.arm)
            recording = source.load_recording(self.source, nominal, **command.assumptions(self))
        of_torques = self.torque.torque
        if recording is not None and recording.position is None:
            of_torques |= recording.joint_torque is not None or recording.motor_current is not None
        if of_torques:
            return self._identify_torques(recording, nominal)
        _refuse_torques(self.torque)
        return self._identify_poses(recording, nominal, names)

    def _identify_poses(
        self, recording: "recordings.Recording | None", nominal: "arms.Arm | None", names: list[str]
    ) -> int:
        if recording is None:
            if self.poses < 1:
                raise InputError(f"--poses {self.poses}: give at least 1")
            if self.geometry != "declared" or self.arm is not None:
                raise InputError(f"{self.source}: is an arm; --geometry and --arm are for recordings, leave them out")
        if recording is None or recording.position is None:
            q = None if recording is None else recording.joint_position
            experiment = self.setup.experiment(self._read_arm(recording, nominal))
            if self.setup.reads and q is None:
                q = touching.draw_readings(experiment, self.poses, self.seed).joint_position
            identification = identify.identify(experiment, q, poses=self.poses, seed=self.seed)
        else:
            if replace(self.setup, effect=()) != Setup():
                raise InputError(
                    f"{self.source}: has measured poses, and its sidecar states how; leave out all options of a set-up"
                    " but --effect"
                )
            sliding = recording.sliding
            effects = [serialization.parse_effect(text, neutral=True, sliding=sliding)[0] for text in self.setup.effect]
            identification = identify.identify_recording(
                recording, nominal, geometry=self.geometry, effects=effects, seed=self.seed
            )
        written = command.save_figures(
            self.figures, names, lambda: identification.plot(self.source).values(), self.force
        )
        report = study.identification_report(identification, self.source, drawn=recording is None)
        return command.present(self.json, identification, report, written)

    def _identify_torques(self, recording: "recordings.Recording | None", nominal: "arms.Arm | None") -> int:
        poses = self.setup != Setup() or self.poses != 100 or self.geometry != "declared"
        if poses or self.figures is not None:
            raise InputError(
                f"{self.source}: torques are studied; leave out --poses, --geometry, --figures and the options of a"
                " sensor"
            )
        arm = self._read_arm(recording, nominal)
        notes = []
        if recording is None:
            room = self.torque.room(arm)
            time, motion = torques.record_motion(room, motions.random_motions(room, self.seed, 1)[0])
            model = self.torque.model(arm)
            phrase = f"a random motion of {room.duration:g} s inside the limits, {len(time)} samples"
        else:
            motion, assumed = motions.read_motion(recording)
            model = self.torque.model(arm, recording.settings)
            phrase = f"{recording.samples} samples of a recording"
            notes = [*recording.notes, *assumed]
            if recording.settings.torque_noise_Nm is None and not self.torque.torque_noise:
                noise_and_units = dict.fromkeys(
                    zip(model.noise.tolist(), formatting.torque_units(arm.sliding, arm.dof), strict=True)
                )
                noise_list = " and ".join(f"{noise:g} {unit}" for noise, unit in noise_and_units)
                are = "are" if len(noise_and_units) > 1 else "is"
                notes.append(f"the sidecar declares no torque_noise_Nm: {noise_list} {are} assumed")
        identification = torques.identify_torques(model, motion, notes=tuple(notes))
        report = study.torque_identification_report(identification, self.source, phrase)
        return command.present(self.json, identification.to_dict, report)

    def _read_arm(self, recording: "recordings.Recording | None", nominal: "arms.Arm | None") -> "arms.Arm":
        """The arm itself, or that of a recording."""
        if nominal is not None or recording is None:
            return nominal or files.read_arm(self.source)
        if recording.settings.arm is None:
            raise InputError(f"{self.source}: declares no arm, and has no poses that would show it; give --arm")
        return files.read_arm(recording.settings.arm_reference(Path(recording.source).parent))


@final
@dataclass(frozen=True)
class SensitivityCommand:
    """Which parameters move the flange, where, and which make up the error of an arm as assembled.

    For example:

        lite6jax sensitivity lite6 --figures figures
    """

    source: Annotated[Positional[str], arg(metavar="ARM|FILE")]
    """A bundled arm or an arm's file."""
    chain: Literal["hayati", "six_parameter"] = "six_parameter"
    """The parameters: the six numbers a joint of a factory file, or Hayati's effective model."""
    length: Annotated[float, arg(metavar="MM")] = 0.8
    """Tolerance of a length, one standard deviation, mm."""
    angle: Annotated[float, arg(metavar="DEG")] = 0.15
    """Tolerance of an angle, one standard deviation, degrees."""
    seed: command.Seed = 0
    figures: command.Folder = None
    """Draw maps over each joint and over the workspace into this folder (PNG and SVG)."""
    json: command.Json = False
    force: command.Force = False

    def run(self) -> int:
        """Computes, draws, prints."""
        command.check_seed(self.seed)
        for name, value in (("length", self.length), ("angle", self.angle)):
            if not (math.isfinite(value) and value >= 0) or self.length == self.angle == 0:
                raise InputError(f"--{name} {value}: give one standard deviation, not below 0, and not both 0")
        names = [f"{command.stem(self.source)}_sensitivity_{kind}" for kind in ("by_joint", "workspace")]
        command.check_figures(self.figures, names, self.force)
        arm = files.read_arm(self.source)
        tolerance = {"m": self.length / 1e3, "rad": math.radians(self.angle)}
        sensitivity = identify.sensitivity(arm, chain=self.chain, tolerance=tolerance, seed=self.seed)
        written = command.save_figures(self.figures, names, lambda: sensitivity.plot(self.source).values(), self.force)
        return command.present(self.json, sensitivity, study.sensitivity_report(sensitivity, self.source), written)


@final
@dataclass(frozen=True)
class DesignCommand:
    """Which poses to record: those that determine an arm's parameters best, and how many are enough; or, with --torque,
    which motion to make: one from rest to rest whose torques determine an arm's dynamics best; or, with --tracking,
    which commands to send: those of which a log tells effects on how the arm follows apart.

    For example:

        lite6jax design lite6 --poses 40 --sensor tracker --out poses.csv
        lite6jax design lite6 --poses 30 --box 100 -300 0 500 300 500 --floor 20 --out poses.csv
        lite6jax design lite6 --discriminate joint_compliance:joint=2,compliance_rad_per_Nm=1e-5
            joint_harmonic:joint=2,order=1 --out poses.csv
        lite6jax design lite6 --torque --out motion.csv
        lite6jax design diagnosis.json --tracking --out commands.csv
    """

    out: Annotated[Path, arg(metavar="FILE")]
    """Write the joint positions here (.csv or .parquet), in an order of short moves, and a sidecar beside it; commands
    without a sidecar."""
    source: Annotated[Positional[str], arg(metavar="ARM|FILE")] = "lite6"
    """A bundled arm or an arm's file; with --tracking also a diagnosis of a log of commands, or such a log."""
    setup: Setup = field(default_factory=Setup)
    torque: TorqueSetup = field(default_factory=TorqueSetup)
    tracking: command_design.CommandSetup = field(default_factory=command_design.CommandSetup)
    poses: int = 40
    """Number of poses to choose."""
    accuracy: Annotated[float | None, arg(metavar="MM")] = None
    """Say how many poses predict positions to this accuracy (one standard deviation)."""
    criterion: Literal["I", "D", "A"] = "I"
    """I: positions predicted over the workspace; D, A: the parameters' volume, mean variance."""
    discriminate: Annotated[tuple[str, str] | None, arg(metavar="EFFECT EFFECT")] = None
    """Choose the poses that discriminate the first of these two effects, at a size that you give, from the second."""
    candidates: int = 100_000
    """Number of joint positions drawn, among which poses are chosen."""
    recorded: Annotated[Path | None, arg(metavar="FILE")] = None
    """A recording whose poses count as already measured; with --tracking a log of commands."""
    limit_margin: Annotated[float, arg(metavar="DEG")] = 2.0
    """The least distance of each joint from its limits."""
    box: Annotated[tuple[float, float, float, float, float, float] | None, arg(metavar="MM…")] = None
    """Where the sensor measures the tool: least x y z, then greatest x y z, mm in the base's frame."""
    floor: Annotated[float | None, arg(metavar="MM")] = None
    """Height above which all joints, the flange and the tool stay, mm in the base's frame."""
    link_radius: Annotated[float | None, arg(metavar="MM")] = None
    """The radius of the capsules around the links; a twentieth of the reach where not given, 0 for no check."""
    filter: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="FILE.py:FUNCTION")] = ()
    """A function of yours from (sample, joint) rad to bool, true where a pose may be recorded. Runs the file."""
    seed: command.Seed = 0
    figures: command.Folder = None
    """Draw the accuracy against the number of poses into this folder (PNG and SVG)."""
    json: command.Json = False
    force: command.Force = False

    def run(self) -> int:
        """Draws candidates or motions, chooses, writes, prints."""
        if self.tracking.tracking:
            return self._design_commands()
        if command_options := _given(self.tracking):
            raise InputError(f"{command_options[0]}: is for commands; add --tracking")
        sidecar = recordings.sidecar_path(self.out)
        inputs = [self.source, self.recorded, *self._filter_files()]
        command.check_outputs([self.out, sidecar], inputs, self.force)
        command.check_seed(self.seed)
        self._check_options()
        of_motion = self.torque.torque
        if of_motion:
            name = f"{self.out.stem}_motion"
            design = self._design_motion
        else:
            name = f"{self.out.stem}_accuracy"
            design = self._design_poses
        command.check_figures(self.figures, [name], self.force)
        plan, recording, report = design(files.read_arm(self.source))
        written = [recordings.write_recording(recording, self.out, self.force), sidecar]

        def draw():
            if of_motion:
                yield figures.designed_motion(plan, self.source)
            else:
                yield figures.accuracy_by_count(plan, self.source)

        written += command.save_figures(self.figures, [name], draw, self.force)
        return command.present(self.json, plan, report, written)

    def _design_commands(self) -> int:
        """As `run`, of commands."""
        foreign = _given(self, "poses", "accuracy", "criterion", "discriminate", "candidates")
        foreign += _given(self.torque, "torque", "torque_noise", "inertial", "harmonics")
        if replace(self.setup, tool_at=(0.0, 0.0, 0.0), joint_noise=0.0) != Setup():
            foreign.append("the options of a sensor")
        if foreign:
            raise InputError(f"--tracking: designs commands; leave {foreign[0]} out")
        command.check_outputs([self.out], [self.source, self.recorded, *self._filter_files()], self.force)
        command.check_seed(self.seed)
        name = f"{self.out.stem}_commands"
        command.check_figures(self.figures, [name], self.force)
        studied = command_design.study_source(self.tracking, self.source, self.recorded, self.torque, self.setup)
        arm = studied.experiment.model.arm
        filters, disabled = self._filters(arm)
        room = motions.MotionRoom(
            arm,
            studied.velocity,
            studied.acceleration,
            math.radians(self.limit_margin),
            filters,
            command_plans.DURATION if self.torque.duration is None else self.torque.duration,
            rate=self.torque.rate,
        )
        plan = command_plans.plan_commands(studied.experiment, room, seed=self.seed)
        written = [command_design.write_commands(plan, self.out, self.force)]
        drawn = command.save_figures(
            self.figures, [name], lambda: [figures.designed_commands(plan, self.source)], self.force
        )
        report = command_designs.command_plan_report(plan, disabled, self.source, studied.notes, self.out)
        return command.present(self.json, plan, report, [*written, *drawn])

    def _filter_files(self) -> list[str]:
        """The files of functions of the user's own."""
        return [reference.rpartition(":")[0] for reference in self.filter]

    def _check_options(self) -> None:
        if self.torque.torque:
            pose_options = _given(self, "poses", "accuracy", "criterion", "discriminate", "candidates", "recorded")
            if replace(self.setup, tool_at=(0.0, 0.0, 0.0)) != Setup():
                pose_options.append("the options of a sensor")
            if pose_options:
                raise InputError(f"--torque: designs a motion; leave {pose_options[0]} out")
            return
        _refuse_torques(self.torque)
        if self.discriminate is not None and (self.criterion != "I" or self.accuracy is not None):
            raise InputError(
                "--discriminate: chooses by the distance between two effects; leave --criterion and --accuracy out"
            )
        if self.accuracy is not None and not self.accuracy > 0:
            raise InputError(f"--accuracy {self.accuracy}: give a standard deviation in mm, above 0")

    def _design_poses(self, arm: "arms.Arm") -> Designed:
        experiment = self.setup.experiment(arm)
        recorded = None
        if self.recorded is not None:
            recorded = source.load_recording(self.recorded, arm).joint_position
        margin = math.radians(self.limit_margin)
        filters, disabled = self._filters(arm)
        if self.setup.reads:
            count = min(self.candidates, _TRIED_READINGS)
            drawn = touching.draw_readings(experiment, count, self.seed, filters, margin)
        else:
            drawn = candidates.candidates(arm, self.candidates, self.seed, filters, margin)
        accuracy = None if self.accuracy is None else self.accuracy / 1e3
        options: dict[str, Any] = {"recorded": recorded, "seed": self.seed}
        if self.discriminate is None:
            options |= {"criterion": self.criterion, "accuracy": accuracy}
            plan = poses.plan_poses(experiment, drawn.joint_position, self.poses, **options)
        else:
            hidden_text, rival_text = self.discriminate
            hidden = serialization.parse_effect(hidden_text, sliding=arm.sliding)
            rivals = hidden, serialization.parse_effect(rival_text, neutral=True, sliding=arm.sliding)[0]
            plan = poses.plan_discrimination(experiment, rivals, drawn.joint_position, self.poses, **options)
        q = plan.joint_position[poses.short_path(plan.joint_position)]
        settings = recordings.RecordingSettings(arm=command.name_arm(self.source, self.out), motion="static")
        report = study.design_report(plan, drawn, disabled, self.source, accuracy)
        readings = None
        if self.setup.reads:
            settings, readings = touching.planned_readings(experiment, q, settings)
            report = (*report, *study.places_report(experiment, q))
        planned = recordings.Recording.assembled(q, settings=settings, sliding=arm.sliding, readings=readings)
        return plan, planned, report

    def _design_motion(self, arm: "arms.Arm") -> Designed:
        filters, disabled = self._filters(arm)
        room = self.torque.room(arm, filters, math.radians(self.limit_margin))
        plan = torques.plan_motion(self.torque.model(arm), room, seed=self.seed)
        report = study.torque_plan_report(plan, disabled, self.source)
        motion = plan.motion
        settings = recordings.RecordingSettings(
            arm=command.name_arm(self.source, self.out),
            motion="trajectory",
            gravity_m_per_s2=self.torque.gravity or torques.GRAVITY,
        )
        recording = recordings.Recording.assembled(
            motion.q.T,
            time=plan.time,
            joint_velocity=motion.dq.T,
            joint_acceleration=motion.ddq.T,
            settings=settings,
            sliding=arm.sliding,
        )
        return plan, recording, report

    def _filters(self, arm: "arms.Arm") -> "tuple[list[candidates.Filter], tuple[tuple[str, str], ...]]":
        if self.floor is not None and not math.isfinite(self.floor):
            raise InputError(f"--floor {self.floor}: give a height in mm")
        at = command.metres(self.setup.tool_at)
        filters: list[candidates.Filter] = []
        disabled: tuple[tuple[str, str], ...] = ()
        if self.box is not None:
            filters.append(candidates.inside_box(arm, command.metres(self.box[:3]), command.metres(self.box[3:]), at))
        if self.floor is not None:
            filters.append(candidates.above_floor(arm, self.floor / 1e3, at))
        if self.link_radius != 0:
            radius = None
            if self.link_radius is not None:
                radius = self.link_radius / 1e3
            apart = candidates.self_collision(arm, candidates.chain_capsules(arm, radius, at))
            disabled = apart.disabled
            filters.append(candidates.clear_of_itself(apart))
        filters += map(candidates.user_filter, self.filter)
        return filters, disabled
