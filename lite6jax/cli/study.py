"""Commands that study an arm: what poses determine of its parameters, and which parameters its error comes from."""

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, final

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax.cli import torque_study
from lite6jax.cli.arguments import ArmName, Folder, Processes, Scheduler, check_processes, check_seed, stem
from lite6jax.cli.exit_codes import DONE
from lite6jax.cli.torque_study import TorqueSetup
from lite6jax.errors import InputError

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.identifiability.information import Experiment
    from lite6jax.recordings import Recording

SensorName = Literal["tracker", "tracker_6d", "motion_capture", "camera", "dial_gauge", "ball_bar"]
Known = Literal["known", "unknown"]


@final
@dataclass(frozen=True)
class Setup:
    """How poses are measured; the sidecar states it for a recording that has poses."""

    sensor: SensorName = "tracker"
    """Positions: tracker; poses: tracker_6d, motion_capture, camera; along an axis: dial_gauge; distance: ball_bar."""
    chain: Literal["hayati", "six_parameter"] = "hayati"
    """The parameters: Hayati's effective model, or the six numbers a joint of a factory file."""
    frame: Known = "unknown"
    """Whether the sensor's frame is known."""
    tool: Known = "known"
    """Whether the measured point's place on the flange is known."""
    tool_at: Annotated[tuple[float, float, float], arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """The nominal place of the measured point, mm in the flange's frame."""
    axis: Annotated[tuple[float, float, float], arg(metavar="X Y Z")] = (0.0, 0.0, 1.0)
    """The dial gauge's direction, in the sensor's frame."""
    center: Annotated[tuple[float, float, float], arg(metavar="X Y Z")] = (300.0, 0.0, 0.0)
    """The ball bar's other end, mm in the sensor's frame."""
    position_noise: Annotated[float | None, arg(metavar="MM")] = None
    """One standard deviation per axis, mm, in place of the sensor's."""
    orientation_noise: Annotated[float | None, arg(metavar="DEG")] = None
    """One standard deviation per axis, degrees."""
    joint_noise: Annotated[float, arg(metavar="DEG")] = 0.0
    """One standard deviation of a joint's read-out, degrees."""
    effect: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="NAME:KEY=VALUE,…")] = ()
    """An effect that is unknown too, such as joint_compliance:joint=2; may be given more than once."""
    payload: Annotated[float, arg(metavar="KG")] = 0.0
    """Mass at the flange, for effects of gravity."""

    def experiment(self, arm: "Arm") -> "Experiment":
        """The experiment that this set-up is on an arm.

        Raises:
            InputError: noise that is not positive, or of what the sensor does not measure.
        """
        import numpy as np

        from lite6jax.identifiability.information import plan_experiment
        from lite6jax.identifiability.sensor import sensor_named

        for name, numbers in (("tool-at", self.tool_at), ("center", self.center), ("axis", self.axis)):
            if not np.isfinite(numbers).all():
                raise InputError(f"--{name} {' '.join(map(str, numbers))}: give three finite numbers")
        if not (math.isfinite(self.payload) and self.payload >= 0):
            raise InputError(f"--payload {self.payload}: give a mass in kg, not below 0")
        sensor = sensor_named(self.sensor).with_noise(
            None if self.position_noise is None else self.position_noise / 1e3,
            None if self.orientation_noise is None else math.radians(self.orientation_noise),
            math.radians(self.joint_noise),
        )
        x, y, z = self.center
        sensor = replace(sensor, direction=self.axis, center=(x / 1e3, y / 1e3, z / 1e3))
        x, y, z = self.tool_at
        setup = plan_experiment(
            arm,
            sensor,
            chain=self.chain,
            frame=self.frame == "unknown",
            tool=self.tool == "unknown",
            tool_at=(x / 1e3, y / 1e3, z / 1e3),
        )
        if not self.effect:
            return setup
        from lite6jax.effects.serialization import parse_effect

        effects, values = zip(*(parse_effect(text, neutral=True) for text in self.effect), strict=True)
        try:
            return replace(setup, payload=self.payload).with_physics(effects, np.concatenate(values))
        except InputError as error:
            if "six-parameter chain" in str(error):
                raise InputError(
                    f"{', '.join(self.effect)}: needs the frames of links; add --chain six_parameter"
                ) from error
            raise


@final
@dataclass(frozen=True)
class Identify:
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
    """Seed of the poses and of simulated readings."""
    refits: int = 0
    """Number of sets of simulated readings that are fitted to test the prediction."""
    processes: Processes = None
    """Processes of this machine that fit them, each with one thread; none but this one where not given."""
    scheduler: Scheduler = None
    """In place of processes of this machine: the Dask cluster of the scheduler at this address (tcp://HOST:8786)."""
    geometry: Literal["declared", "exact", "prior", "free"] = "declared"
    """The geometry of a recording's arm: as its sidecar states; the factory calibration exactly, or with a prior about
    it; or unknown."""
    arm: ArmName = None
    """The nominal arm of a recording; from the sidecar where not given."""
    figures: Folder = None
    """Draw singular values, correlations and standard deviations into this folder (PNG and SVG)."""
    force: bool = False
    """Replace files that exist."""
    json: bool = False
    """Print one JSON object (SI units) instead of sentences and tables."""
    assume_degrees: bool = False
    """Take joint columns that say rad as degrees."""
    assume_millimetres: bool = False
    """Take position columns that say m as millimetres."""

    def run(self) -> int:
        """Computes, draws, prints."""
        from lite6jax.arms.files import read_arm
        from lite6jax.effects.serialization import parse_effect
        from lite6jax.fitting.source import load_nominal, read_source
        from lite6jax.identifiability.identify import identify, identify_recording
        from lite6jax.recordings import Recording, recording_file

        check_seed(self.seed)
        check_processes(self.processes, self.scheduler)
        if not self.refits and (self.processes is not None or self.scheduler is not None):
            raise InputError("--processes and --scheduler are of --refits; add --refits N, or leave them out")
        names = [f"{stem(self.source)}_{what}" for what in ("singular_values", "correlation", "deviations")]
        if self.figures:
            from lite6jax.report import canvas

            canvas.check_names(self.figures, names, self.force)
        refits: dict[str, Any] = {
            "refits": self.refits,
            "seed": self.seed,
            "processes": self.processes,
            "scheduler": self.scheduler,
        }
        file = recording_file(self.source)
        drawn = file is None
        if self.torque.torque:
            self._refuse_with_torque()
            if file is None:
                return torque_study.identify_arm(self.torque, self.source, self.seed, self.json)
        if file is None:
            torque_study.refuse_without_torque(self.torque)
            if self.poses < 1:
                raise InputError(f"--poses {self.poses}: give at least 1")
            if self.geometry != "declared" or self.arm is not None:
                raise InputError(f"{self.source}: is an arm; --geometry and --arm are for recordings, leave them out")
            found = identify(self.setup.experiment(read_arm(self.source)), poses=self.poses, **refits)
        else:
            nominal = load_nominal(self.arm)
            recording = read_source(
                self.source, nominal, assume_degrees=self.assume_degrees, assume_millimetres=self.assume_millimetres
            )
            assert isinstance(recording, Recording)  # by its suffix
            torques = recording.joint_torque is not None or recording.motor_current is not None
            if self.torque.torque or (recording.position is None and torques):
                self._refuse_with_torque()
                arm = nominal or self._declared_arm(recording, file)
                return torque_study.identify_recording(self.torque, recording, arm, self.source, self.json)
            torque_study.refuse_without_torque(self.torque)
            if recording.position is None:
                arm = nominal or self._declared_arm(recording, file)
                found = identify(self.setup.experiment(arm), recording.joint_position, **refits)
            else:
                if replace(self.setup, effect=()) != Setup():
                    raise InputError(
                        f"{self.source}: has measured poses, and its sidecar states how; leave out all options of a"
                        " set-up but --effect"
                    )
                effects = [parse_effect(text, neutral=True)[0] for text in self.setup.effect]
                found = identify_recording(recording, nominal, geometry=self.geometry, effects=effects, **refits)

        from lite6jax.report import screen, study

        written = []
        if self.figures:
            from lite6jax.report import canvas, figures

            drawings = (
                figures.singular_values(found, self.source),
                figures.correlation(found, self.source),
                figures.deviations(found, self.source),
            )
            written = canvas.save(dict(zip(names, drawings, strict=True)), self.figures, self.force)
        if self.json:
            print(json.dumps(found.to_dict(), indent=1, allow_nan=False))
        else:
            screen.show(study.identification_report(found, self.source, drawn))
            screen.written(written)
        return DONE

    def _declared_arm(self, recording: "Recording", file: Path) -> "Arm":
        from lite6jax.arms.files import read_arm

        if recording.settings.arm is None:
            raise InputError(f"{self.source}: declares no arm, and has no poses that would show it; give --arm")
        return read_arm(recording.settings.arm_reference(file.parent))

    def _refuse_with_torque(self) -> None:
        given = self.setup != Setup() or self.poses != 100 or self.refits or self.geometry != "declared"
        if given or self.figures is not None:
            raise InputError(
                f"{self.source}: torques are studied; leave out --poses, --refits, --geometry, --figures and the"
                " options of a sensor"
            )


@final
@dataclass(frozen=True)
class Sensitivity:
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
    global_indices: bool = False
    """Sobol's indices of an arm's largest error too, with SALib (pip install 'lite6jax[sensitivity]')."""
    arms: int = 1024
    """Number of arms for Sobol's indices, a power of 2."""
    seed: int = 0
    """Seed of the random numbers."""
    figures: Folder = None
    """Draw maps over each joint and over the workspace into this folder (PNG and SVG)."""
    json: bool = False
    """Print JSON instead of the report."""
    force: bool = False
    """Replace files that exist."""

    def run(self) -> int:
        """Computes, draws, prints."""
        from lite6jax.arms.files import read_arm
        from lite6jax.identifiability.sensitivity import global_sensitivity, sensitivity
        from lite6jax.report import canvas, screen, study

        check_seed(self.seed)
        for name, value in (("length", self.length), ("angle", self.angle)):
            if not (math.isfinite(value) and value >= 0) or self.length == self.angle == 0:
                raise InputError(f"--{name} {value}: give one standard deviation, not below 0, and not both 0")
        names = [f"{stem(self.source)}_{what}" for what in ("sensitivity_by_joint", "sensitivity_workspace")]
        if self.figures:
            canvas.check_names(self.figures, names, self.force)
        arm = read_arm(self.source)
        tolerance = {"m": self.length / 1e3, "rad": math.radians(self.angle)}
        found = sensitivity(arm, chain=self.chain, tolerance=tolerance, seed=self.seed)
        over_arms = None
        if self.global_indices:
            over_arms = global_sensitivity(arm, chain=self.chain, tolerance=tolerance, arms=self.arms, seed=self.seed)
        written = []
        if self.figures:
            from lite6jax.report import figures

            drawings = (
                figures.sensitivity_by_joint(found, self.source),
                figures.sensitivity_over_workspace(found, self.source),
            )
            written = canvas.save(dict(zip(names, drawings, strict=True)), self.figures, self.force)
        if self.json:
            from lite6jax.report import documents

            print(documents.text(documents.of_sensitivity(found, over_arms), written))
            return DONE
        screen.show(study.sensitivity_report(found, over_arms, self.source))
        screen.written(written)
        return DONE
