"""The command that simulates: a recording of an arm with chosen effects, as a sensor measures it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from lite6jax import suffixes
from lite6jax.cli import command
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError
from lite6jax.fields import field_values
from lite6jax.sensors.kinds import ReadingName

with import_lazily():
    from lite6jax import formatting, recordings, simulation
    from lite6jax.arms import arm as arms
    from lite6jax.arms import factory as factories
    from lite6jax.arms import files
    from lite6jax.effects import catalogue, composition, serialization
    from lite6jax.recordings import files as recording_files
    from lite6jax.recordings import settings as sidecar_settings
    from lite6jax.report import fits, screen
    from lite6jax.report.sentences import commands as sentences

if TYPE_CHECKING:
    import numpy as np
    from rich.console import RenderableType

_OF_POSES = (
    *("sensor", "motion", "effects", "warm_up", "factory", "tolerance", "factory_uncertainty", "geometry", "frame"),
    *("tool", "tool_at", "position_noise", "orientation_noise"),
)
"""Fields of `SimulateCommand` that a log of commands has no use for."""
_OF_COMMANDS = ("stiffness", "damping", "servo", "joint_quantum", "commands")
"""Fields that are of such a log alone."""


@dataclass(frozen=True)
class SimulateCommand:
    """Write a recording of a simulated arm with chosen effects, and its sidecar.

    For example:

        lite6jax simulate lite6 --effect joint_compliance:joint=2,compliance_rad_per_Nm=9e-5 --tolerance --out run.csv
        lite6jax simulate lite6 --effect joint_backlash:joint=4,gap_rad=1e-3 --sensor motion_capture
            --motion trajectory --out run.csv
        lite6jax simulate lite6 --tracking --effect coulomb_friction:joint=3,coulomb_Nm=1.5 --out log.csv
    """

    source: Annotated[Positional[str], arg(metavar="ARM|FILE")]
    """A bundled arm or an arm's file."""
    out: Annotated[Path, arg(metavar="FILE")]
    """Write the recording here (.csv or .parquet), and its sidecar beside it."""
    effect: command.EffectTexts = ()
    """An effect with its parameters, such as joint_compliance:joint=2,compliance_rad_per_Nm=9e-5; may be
    repeated."""
    effects: Annotated[Path | None, arg(metavar="FILE.py")] = None
    """Effects of your own that --effect may name. Runs the file."""
    sensor: Literal["tracker", "tracker_6d", "motion_capture", "camera", "controller_fk", ReadingName] = "tracker"
    """Positions: tracker; poses: the next four; touches of sockets or plates, distances from an anchor, heights, and
    corners of a board in images: the others, of which tool and places are unknown."""
    motion: Literal["static", "trajectory"] = "static"
    """static: poses over the joints' whole ranges, at which the arm stands still; trajectory: a smooth motion."""
    tracking: bool = False
    """Write a log of commands and measured joints, of an arm with position servos, in place of poses. Commands are
    sines, trapezoids and steps; effects are those on how servos follow, such as command_delay:joint=2,delay_s=0.01."""
    commands: Annotated[Path | None, arg(metavar="FILE")] = None
    """With --tracking, the commands to follow, in place of drawn ones: a table with time_s and cmd1_rad …"""
    samples: int | None = None
    """400 of a static recording, 3000 of a trajectory, 2000 of commands where not given."""
    runs: int = 1
    """In how many runs of equal length."""
    step: Annotated[float | None, arg(metavar="S")] = None
    """From sample to sample; 8 s of a static recording, 0.02 s of a trajectory, 0.01 s of commands where not given."""
    speed: Annotated[float, arg(metavar="DEG_PER_S")] = 120.0
    """That no joint of a trajectory exceeds, and no command but in steps."""
    stiffness: Annotated[tuple[float, ...], arg(metavar="NM_PER_RAD…")] = ()
    """Of servos: one for all joints or one for each; as inertia asks for where not given."""
    damping: Annotated[tuple[float, ...], arg(metavar="NM_S_PER_RAD…")] = ()
    """Of servos, likewise."""
    servo: command.Known = "known"
    """Whether the sidecar declares stiffness and damping of the servos."""
    joint_quantum: Annotated[float, arg(metavar="DEG")] = 0.0
    """Of commands, the step of encoders, to which read-outs are rounded."""
    payload: Annotated[tuple[float, ...], arg(metavar="KG…")] = (0.0,)
    """At the flange; several one after the other in equal parts of the recording."""
    payload_at: command.Triple = (0.0, 0.0, 0.0)
    """Its centre of mass, mm in the flange's frame."""
    warm_up: Annotated[float | None, arg(metavar="K")] = None
    """Record temperatures that rise by this. 0: constant temperatures."""
    factory: Annotated[Path | None, arg(metavar="FILE")] = None
    """The arm's own calibration: its geometry, which the sidecar names."""
    tolerance: bool = False
    """Draw the geometry with errors of 0.8 mm and 0.15 deg (one standard deviation) in each number, and write its
    calibration beside the recording."""
    factory_uncertainty: Annotated[tuple[float, float] | None, arg(metavar="MM DEG")] = None
    """Standard deviation of the geometry about its calibration in each number, which the sidecar declares."""
    geometry: command.Known = "known"
    """known: the sidecar names the calibration; unknown: it does not."""
    frame: command.Known = "known"
    """known: poses are in the arm's base frame; unknown: in the frame of a sensor whose place is not declared."""
    tool: command.Known = "known"
    """Whether the sidecar declares the measured point on the flange."""
    tool_at: command.Triple = (0.0, 0.0, 0.0)
    """The measured point, mm in the flange's frame."""
    position_noise: Annotated[float | None, arg(metavar="MM")] = None
    """One standard deviation per axis, mm, instead of the sensor's."""
    orientation_noise: Annotated[float | None, arg(metavar="DEG")] = None
    """One standard deviation per axis, degrees."""
    joint_noise: Annotated[float, arg(metavar="DEG")] = 0.0
    """One standard deviation of each joint's read-out, degrees."""
    seed: int = 0
    """Of the random numbers."""
    force: command.Force = False

    def run(self) -> int:
        """Draws, measures, writes, prints."""
        if self.out.suffix.lower() not in suffixes.WRITTEN_TABLES:
            raise InputError(f"{self.out}: a recording ends in .csv or .parquet; choose such a name")
        calibration = self.out.with_name(f"{self.out.stem}_factory.yaml")
        written = [self.out, recordings.sidecar_path(self.out), *([calibration] if self.tolerance else [])]
        command.check_outputs(written, [self.source, self.factory, self.effects, self.commands], self.force)
        self._check_options()
        if self.tracking:
            return self._write_log(written)
        arm = files.read_arm(self.source)
        physics, values = self._physics(arm.sliding)
        declared, kinematics = self._geometry(arm)
        motion = simulation.draw_motion(
            arm,
            self.motion,
            self.samples,
            runs=self.runs,
            step=self.step,
            speed=math.radians(self.speed),
            payload=self.payload,
            warm_up=self.warm_up,
            settings=self._settings(calibration),
            seed=self.seed,
        )
        measured = simulation.measure(
            motion,
            arm,
            physics,
            values,
            kinematics=kinematics,
            sensor=self.sensor,
            position_noise=None if self.position_noise is None else self.position_noise / 1e3,
            orientation_noise=None if self.orientation_noise is None else math.radians(self.orientation_noise),
            joint_noise=math.radians(self.joint_noise),
            T_sensor_base=simulation.draw_sensor_frame(self.seed) if self.frame == "unknown" else None,
            tool=[*command.metres(self.tool_at), 0.0, 0.0, 0.0] if any(self.tool_at) else None,
            tool_known=self.tool == "known",
            seed=self.seed,
        )
        # the large file first: where a disk is full, nothing else is written
        recordings.write_recording(measured.recording, self.out, self.force)
        if self.tolerance:
            factories.write_factory(declared, calibration, overwrite=self.force)
        screen.show(self._page(arm, physics, values, measured))
        screen.written(written)
        return command.DONE

    def _check_options(self) -> None:
        """Refuses options of poses for a log of commands, and the other way round."""
        usual = {field.name: field.default for field in fields(self)}
        changed = [name for name, value in field_values(self).items() if value != usual[name]]
        refused = _OF_POSES if self.tracking else _OF_COMMANDS
        for name in changed:
            if name in refused:
                option = f"--{name.replace('_', '-')}"
                if self.tracking:
                    raise InputError(f"{option}: is of poses, and --tracking of commands; keep one")
                raise InputError(f"{option}: is of servos; add --tracking")

    def _write_log(self, written: list[Path]) -> int:
        """Simulates commands and measured joints, writes, prints."""
        arm = files.read_arm(self.source)
        if len(self.payload) != 1:
            raise InputError("--payload: a log of commands has one; give one")
        commanded_position = None
        time = None
        run = None
        if self.commands is not None:
            motion = recording_files.read_commands(self.commands, arm)
            if motion.time is None:
                raise InputError(f"{self.commands}: commands need times; add time_s")
            if self.samples is not None or self.step is not None:
                raise InputError(f"--commands {self.commands}: says samples and step; leave --samples and --step out")
            commanded_position = motion.commanded_position
            time = motion.time
            run = motion.run
        simulated = simulation.simulate_tracking(
            arm,
            commanded_position,
            effects=self.effect,
            time=time,
            run=run,
            samples=simulation.TRACKING_SAMPLES if self.samples is None else self.samples,
            runs=self.runs,
            step=simulation.TRACKING_STEP_S if self.step is None else self.step,
            speed=math.radians(self.speed),
            servo=self._servo(arm),
            servo_known=self.servo == "known",
            payload=self.payload[0],
            joint_noise=math.radians(self.joint_noise),
            joint_quantum=math.radians(self.joint_quantum),
            settings=recordings.RecordingSettings(
                arm=command.name_arm(self.source, self.out), payload_com_m=command.metres(self.payload_at)
            ),
            seed=self.seed,
        )
        recordings.write_recording(simulated.recording, self.out, self.force)
        screen.show(self._log_page(arm, simulated))
        screen.written(written)
        return command.DONE

    def _servo(self, arm: "arms.Arm") -> "sidecar_settings.ServoSettings | None":
        """The servos that were given, each number for all joints or one for each; None where none was."""
        if not (self.stiffness or self.damping):
            return None
        usual = simulation.usual_servo(arm)
        numbers: dict[str, tuple[float, ...]] = {}
        for option, option_numbers, otherwise in (
            ("stiffness", self.stiffness, usual.stiffness_Nm_per_rad),
            ("damping", self.damping, usual.damping_Nm_s_per_rad),
        ):
            joint_numbers = option_numbers * arm.dof if len(option_numbers) == 1 else option_numbers or otherwise
            above = all(0 <= number < math.inf for number in joint_numbers) and (
                option == "damping" or all(joint_numbers)
            )
            if len(joint_numbers) != arm.dof or not above:
                raise InputError(
                    f"--{option} {' '.join(f'{number:g}' for number in option_numbers)}: give one number above 0, "
                    f"or one for each of the {arm.dof} joints"
                )
            numbers[option] = tuple(joint_numbers)
        return sidecar_settings.ServoSettings(
            stiffness_Nm_per_rad=numbers["stiffness"], damping_Nm_s_per_rad=numbers["damping"]
        )

    def _log_page(self, arm: "arms.Arm", simulated: "simulation.TrackingSimulation") -> "Iterator[RenderableType]":
        """What was simulated, with which numbers, and how far the effects move the joints."""
        recording = simulated.recording
        settings = recording.settings
        if self.commands is None:
            yield sentences.simulated_log(recording.samples, arm.name, self.runs)
        else:
            runs = len(set(recording.run.tolist()))
            yield sentences.simulated_log(recording.samples, arm.name, runs, f"those of {self.commands}")
        servo = None
        if self.servo == "known" and isinstance(settings.servo, sidecar_settings.ServoSettings):
            servo = settings.servo
        yield sentences.simulated_servos(servo)
        yield sentences.noise_of_log(settings.joint_noise_rad or 0.0, self.joint_quantum)
        yield ""
        model = simulated.model
        if not model.terms.terms:
            yield "No effects: the arm follows its commands as its servos do."
            return
        yield "Effects on how the arm follows its commands"
        yield from command.list_effects(simulated.reported)
        yield sentences.moved_joints(simulated.moved.tolist())

    def _physics(self, sliding: tuple[int, ...]) -> "tuple[composition.Physics, np.ndarray]":
        kinds = catalogue.kinds_of(command.load_own_effects(self.effects))
        parsed = [serialization.parse_effect(text, kinds, sliding=sliding) for text in self.effect]
        for effect, _ in parsed:
            if self.warm_up is None and any(d.quantity.startswith("temperature") for d in effect.drivers):
                raise InputError(f"{effect.label}: depends on temperatures that rise; add --warm-up 15")
            if self.motion == "static" and any(driver.quantity == "velocity" for driver in effect.drivers):
                raise InputError(f"{effect.label}: depends on joint velocities; add --motion trajectory")
        physics = composition.Physics(tuple(effect for effect, _ in parsed))
        return physics, physics.join([values for _, values in parsed])

    def _geometry(self, arm: "arms.Arm") -> "tuple[np.ndarray, np.ndarray]":
        """The kinematics of the calibration, and those of the arm."""
        import numpy as np

        if self.factory is not None and self.tolerance:
            raise InputError("--factory and --tolerance: both give the arm's geometry; keep one")
        has_calibration = self.factory is not None or self.tolerance
        if self.factory_uncertainty is not None and not (has_calibration and self.geometry == "known"):
            raise InputError("--factory-uncertainty: is one of a calibration; add --factory or --tolerance")
        declared = arm.kinematics
        if self.factory is not None:
            factory = factories.read_factory(self.factory, arm)
            if not np.allclose(factory.T_joint_flange, arm.T_joint_flange, rtol=0, atol=1e-12):
                raise InputError(
                    f"{self.factory}: holds a transform after the last joint, where a recording has its tool; give the "
                    "six-parameter file"
                )
            declared = factory.kinematics
        elif self.tolerance:
            declared = simulation.draw_calibration(arm, self.seed)
        if self.factory_uncertainty is None:
            return declared, declared
        length, angle = self.factory_uncertainty
        return declared, simulation.perturb(declared, length / 1e3, math.radians(angle), self.seed)

    def _settings(self, calibration: Path) -> "recordings.RecordingSettings":
        factory = calibration if self.tolerance else self.factory
        uncertainty = None
        if self.geometry == "unknown":
            factory = None
        if self.factory_uncertainty is not None:
            length, angle = self.factory_uncertainty
            uncertainty = recordings.FactoryUncertainty(length / 1e3, math.radians(angle))
        return recordings.RecordingSettings(
            arm=command.name_arm(self.source, self.out),
            factory_calibration=None if factory is None else command.relative_path(factory, self.out),
            factory_uncertainty=uncertainty,
            payload_com_m=command.metres(self.payload_at),
        )

    def _declared_model(self) -> "sentences.SimulatedModel":
        """What is said of the geometry."""
        geometry = "nominal, not declared"
        if self.tolerance:
            geometry = "as drawn"
        elif self.factory:
            geometry = f"that of {self.factory}"
        undeclared = bool(self.tolerance or self.factory) and self.geometry == "unknown"
        uncertain = self.factory_uncertainty is not None
        return sentences.SimulatedModel(geometry, uncertain, undeclared, self.frame == "known")

    def _page(
        self, arm: "arms.Arm", physics: "composition.Physics", values: "np.ndarray", measured: "simulation.Measurement"
    ) -> "Iterator[RenderableType]":
        """What was simulated, with which numbers, and how far the effects displace the measured point."""
        recording = measured.recording
        kind = "positions" if recording.quaternion is None else "poses"
        if recording.readings is not None:
            kind = fits.what_is_measured(recording)
        yield sentences.simulated_poses(recording, kind, arm.name, self.runs)
        yield sentences.simulated_geometry(self._declared_model(), recording.settings)
        yield sentences.simulated_noise(recording, self.joint_noise)
        yield from screen.notes(recording.notes)
        yield ""
        if not physics.effects:
            yield "No effects: the arm is rigid."
            return
        yield "Effects beyond the rigid model"
        yield from command.list_effects(zip(physics.effects, physics.reported(values), strict=True))
        turn = formatting.fixed(math.degrees(measured.rms[1]))
        yield from command.say("moved", rms=measured.rms, most=float(measured.displacement.max()), turn=turn)
