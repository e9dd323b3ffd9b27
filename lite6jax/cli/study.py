"""Commands that study an arm: what poses determine, which parameters matter, which poses to record."""

import json
import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax.cli.arguments import DONE, ArmName, Folder
from lite6jax.errors import InputError
from lite6jax.storage import check_writable

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.identifiability.candidates import Filter
    from lite6jax.identifiability.information import Experiment

SensorName = Literal["tracker", "tracker_6d", "motion_capture", "camera", "dial_gauge", "ball_bar"]
Known = Literal["known", "unknown"]


@dataclass(frozen=True)
class Setup:
    """How poses are measured. Not asked of a recording that has poses: its sidecar says it."""

    sensor: SensorName = "tracker"
    """Positions: tracker; poses: tracker_6d, motion_capture, camera; along an axis: dial_gauge; distance: ball_bar."""
    chain: Literal["hayati", "six_parameter"] = "hayati"
    """The parameters: Hayati's effective model, or the six numbers a joint of a factory file."""
    frame: Known = "unknown"
    """Where the sensor stands."""
    tool: Known = "known"
    """Where the measured point or probe is on the flange."""
    tool_at: Annotated[tuple[float, float, float], arg(metavar="X Y Z")] = (0.0, 0.0, 0.0)
    """Where it nominally is, mm in the flange's frame."""
    axis: Annotated[tuple[float, float, float], arg(metavar="X Y Z")] = (0.0, 0.0, 1.0)
    """The dial gauge's direction, in the sensor's frame."""
    center: Annotated[tuple[float, float, float], arg(metavar="X Y Z")] = (300.0, 0.0, 0.0)
    """The ball bar's other end, mm in the sensor's frame."""
    position_noise: Annotated[float | None, arg(metavar="MM")] = None
    """One standard deviation per axis, mm, of a sensor of your own."""
    orientation_noise: Annotated[float | None, arg(metavar="DEG")] = None
    """One standard deviation per axis, degrees."""
    joint_noise: Annotated[float, arg(metavar="DEG")] = 0.0
    """One standard deviation of a joint's read-out, degrees."""
    effect: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="NAME:KEY=VALUE,…")] = ()
    """Physics that is unknown too, such as joint_compliance:joint=2; may be given more than once."""
    payload: Annotated[float, arg(metavar="KG")] = 0.0
    """At the flange, for effects of gravity."""

    def experiment(self, arm: "Arm") -> "Experiment":
        """What this measures of an arm.

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
        from lite6jax.effects.catalogue import parse_effect

        effects, values = zip(*(parse_effect(text, neutral=True) for text in self.effect), strict=True)
        try:
            return replace(setup, payload=self.payload).with_physics(effects, np.concatenate(values))
        except InputError as error:
            if "six-parameter chain" in str(error):
                raise InputError(
                    f"{', '.join(self.effect)}: needs the frames of links; add --chain six_parameter"
                ) from error
            raise


@dataclass(frozen=True)
class Identify:
    """What poses determine of an arm's parameters, and how well: before anything is measured, or of a recording.

    For example:

        lite6jax identify lite6 --sensor tracker --poses 60
        lite6jax identify run7.csv --figures figures
        lite6jax identify poses.csv --tool unknown --json
    """

    source: Annotated[Positional[str], arg(metavar="ARM|FILE")]
    """A bundled arm, an arm's file, or a recording (.csv, .parquet, .mcap); one without poses lists joint positions."""
    setup: Setup = Setup()
    poses: int = 100
    """Of an arm: how many to draw inside its limits."""
    seed: int = 0
    """Of those."""
    refits: int = 0
    """Fit so many sets of simulated readings, to put the prediction to the test."""
    geometry: Literal["declared", "exact", "prior", "free"] = "declared"
    """Of a recording: what its sidecar says; the factory calibration exactly, or near it; or unknown."""
    arm: ArmName = None
    """Of a recording: the nominal arm, from the sidecar where not given."""
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
        """Studies, draws, prints."""
        from lite6jax.arms.files import read_arm
        from lite6jax.effects.catalogue import parse_effect
        from lite6jax.fitting.fit import load_nominal, read_source
        from lite6jax.identifiability.identify import identify, identify_recording
        from lite6jax.recordings import Recording, recording_file

        _check_seed(self.seed)
        names = [f"{_stem(self.source)}_{what}" for what in ("singular_values", "correlation", "deviations")]
        if self.figures:
            from lite6jax.report import canvas

            canvas.check_names(self.figures, names, self.force)
        file = recording_file(self.source)
        drawn = file is None
        if file is None:
            if self.poses < 1:
                raise InputError(f"--poses {self.poses}: give at least 1")
            if self.geometry != "declared" or self.arm is not None:
                raise InputError(f"{self.source}: is an arm; --geometry and --arm are for recordings, leave them out")
            found = identify(
                self.setup.experiment(read_arm(self.source)), poses=self.poses, refits=self.refits, seed=self.seed
            )
        else:
            nominal = load_nominal(self.arm)
            recording = read_source(
                self.source, nominal, assume_degrees=self.assume_degrees, assume_millimetres=self.assume_millimetres
            )
            assert isinstance(recording, Recording)  # by its suffix
            if recording.position is None:
                arm = nominal or read_arm(recording.settings.arm_reference(file.parent))
                found = identify(
                    self.setup.experiment(arm), recording.joint_position, refits=self.refits, seed=self.seed
                )
            else:
                if replace(self.setup, effect=()) != Setup():
                    raise InputError(
                        f"{self.source}: has measured poses, and its sidecar says how; leave out all options of a"
                        " set-up but --effect"
                    )
                effects = [parse_effect(text, neutral=True)[0] for text in self.setup.effect]
                found = identify_recording(
                    recording, nominal, geometry=self.geometry, effects=effects, refits=self.refits, seed=self.seed
                )

        from lite6jax.report import screen, study_tables

        written = []
        if self.figures:
            from lite6jax.report import canvas, study_figures

            drawings = (
                study_figures.singular_values(found, self.source),
                study_figures.correlation(found, self.source),
                study_figures.deviations(found, self.source),
            )
            written = canvas.save(dict(zip(names, drawings, strict=True)), self.figures, self.force)
        if self.json:
            print(json.dumps(found.to_dict(), indent=1, allow_nan=False))
        else:
            screen.show(study_tables.identification_report(found, self.source, drawn))
            screen.written(written)
        return DONE


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
    """Tolerance of a length, one standard deviation."""
    angle: Annotated[float, arg(metavar="DEG")] = 0.15
    """Tolerance of an angle."""
    global_indices: bool = False
    """Sobol's indices of an arm's largest error too, with SALib (pip install 'lite6jax[sensitivity]')."""
    arms: int = 1024
    """Of those, a power of 2."""
    seed: int = 0
    """Of what is drawn."""
    figures: Folder = None
    """Draw maps over each joint and over the workspace into this folder (PNG and SVG)."""
    force: bool = False
    """Replace files that exist."""

    def run(self) -> int:
        """Studies, draws, prints."""
        from lite6jax.arms.files import read_arm
        from lite6jax.identifiability.sensitivity import global_sensitivity, sensitivity
        from lite6jax.report import canvas, screen, study_tables

        _check_seed(self.seed)
        for name, value in (("length", self.length), ("angle", self.angle)):
            if not (math.isfinite(value) and value >= 0) or self.length == self.angle == 0:
                raise InputError(f"--{name} {value}: give one standard deviation, not below 0, and not both 0")
        names = [f"{_stem(self.source)}_{what}" for what in ("sensitivity_by_joint", "sensitivity_workspace")]
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
            from lite6jax.report import study_figures

            drawings = (
                study_figures.sensitivity_by_joint(found, self.source),
                study_figures.sensitivity_over_workspace(found, self.source),
            )
            written = canvas.save(dict(zip(names, drawings, strict=True)), self.figures, self.force)
        screen.show(study_tables.sensitivity_report(found, over_arms, self.source))
        screen.written(written)
        return DONE


@dataclass(frozen=True)
class Design:
    """Which poses to record: those that tell an arm's parameters best, and how many are enough.

    For example:

        lite6jax design lite6 --poses 40 --sensor tracker --out poses.csv
        lite6jax design lite6 --poses 30 --box 100 -300 0 500 300 500 --floor 20 --out poses.csv
        lite6jax design lite6 --rivals joint_compliance:joint=2,compliance_rad_per_Nm=1e-5
            joint_harmonic:joint=2,order=1 --out poses.csv
    """

    out: Annotated[Path, arg(metavar="FILE")]
    """Write the joint positions here (.csv or .parquet), in an order of short moves, and a sidecar beside it."""
    source: Annotated[Positional[str], arg(metavar="ARM|FILE")] = "lite6"
    """A bundled arm or an arm's file."""
    setup: Setup = Setup()
    poses: int = 40
    """How many."""
    accuracy: Annotated[float | None, arg(metavar="MM")] = None
    """Say how many reach this accuracy of predicted positions (one standard deviation)."""
    criterion: Literal["I", "D", "A", "E"] = "I"
    """I: positions predicted over the workspace; D, A, E: the parameters' volume, mean variance, worst direction."""
    rivals: Annotated[tuple[str, str] | None, arg(metavar="EFFECT EFFECT")] = None
    """Choose the poses that tell these two kinds of physics apart instead; the first needs its size, the second may."""
    candidates: int = 100_000
    """Joint positions drawn, among which to choose."""
    recorded: Annotated[Path | None, arg(metavar="FILE")] = None
    """A recording whose poses are there already and count."""
    limit_margin: Annotated[float, arg(metavar="DEG")] = 2.0
    """How far each joint stays from its limits."""
    box: Annotated[tuple[float, float, float, float, float, float] | None, arg(metavar="MM…")] = None
    """Where the sensor sees the tool: least x y z, then greatest x y z, mm in the base's frame."""
    floor: Annotated[float | None, arg(metavar="MM")] = None
    """Height that every joint, flange and tool stay above."""
    link_radius: Annotated[float | None, arg(metavar="MM")] = None
    """Of the capsules that stand for the links; a twentieth of the reach where not given, 0 for no check."""
    geometry: Annotated[str | None, arg(metavar="URDF")] = None
    """Take the links' shapes from this URDF's collision geometry instead (robot.urdf#tip)."""
    filter: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="FILE.py:FUNCTION")] = ()
    """A function of yours: (sample, joint) rad to bool, true where a pose may be recorded. Runs the file."""
    refine: bool = True
    """Move the chosen poses on, between the candidates, as long as that gains."""
    seed: int = 0
    """Of what is drawn."""
    figures: Folder = None
    """Draw the accuracy against the number of poses into this folder (PNG and SVG)."""
    force: bool = False
    """Replace files that exist."""

    def run(self) -> int:
        """Draws candidates, chooses, writes, prints."""
        from lite6jax.arms.files import read_arm
        from lite6jax.fitting.fit import read_source
        from lite6jax.identifiability.candidates import all_pass, candidates, inside_limits
        from lite6jax.identifiability.planning import plan_poses, separate_poses, shortest_round
        from lite6jax.recordings import Recording, RecordingSettings, sidecar_path, write_recording
        from lite6jax.report import screen, study_tables

        check_writable(self.out, self.force)
        check_writable(sidecar_path(self.out), self.force)
        _check_seed(self.seed)
        if self.rivals is not None and (self.criterion != "I" or self.accuracy is not None):
            raise InputError("--rivals: chooses what tells two effects apart; leave --criterion and --accuracy out")
        if self.floor is not None and not math.isfinite(self.floor):
            raise InputError(f"--floor {self.floor}: give a height in mm")
        if self.accuracy is not None and not self.accuracy > 0:
            raise InputError(f"--accuracy {self.accuracy}: give a standard deviation in mm, above 0")
        name = f"{self.out.stem}_accuracy"
        if self.figures:
            from lite6jax.report import canvas

            canvas.check_names(self.figures, [name], self.force)
        arm = read_arm(self.source)
        experiment = self.setup.experiment(arm)
        recorded = None
        if self.recorded is not None:
            recorded = read_source(self.recorded, arm)
            if not isinstance(recorded, Recording):
                raise InputError(f"{self.recorded}: is no recording; --recorded takes a .csv or .parquet")
            recorded = recorded.joint_position
        margin = math.radians(self.limit_margin)
        filters, disabled = self._filters(arm)
        drawn = candidates(arm, self.candidates, self.seed, filters, margin)
        asked = {
            "recorded": recorded,
            "refined": self.refine,
            "limits": inside_limits(arm, margin),
            "feasible": lambda q: all_pass(filters, q),
            "seed": self.seed,
        }
        accuracy = None if self.accuracy is None else self.accuracy / 1e3
        if self.rivals is None:
            found = plan_poses(
                experiment, drawn.joint_position, self.poses, criterion=self.criterion, accuracy=accuracy, **asked
            )
        else:
            from lite6jax.effects.catalogue import parse_effect

            rivals = (parse_effect(self.rivals[0]), parse_effect(self.rivals[1], neutral=True))
            found = separate_poses(experiment, rivals, drawn.joint_position, self.poses, **asked)
        q = found.joint_position[shortest_round(found.joint_position)]
        settings = RecordingSettings(arm=self._arm_reference(), motion="static")
        written = [write_recording(Recording.from_arrays(q, settings=settings), self.out, self.force)]
        written.append(sidecar_path(self.out))
        if self.figures:
            from lite6jax.report import canvas, study_figures

            drawing = study_figures.accuracy_by_count(found, self.source)
            written += canvas.save({name: drawing}, self.figures, self.force)
        screen.show(study_tables.design_report(found, drawn, disabled, self.source, accuracy))
        screen.written(written)
        return DONE

    def _filters(self, arm: "Arm") -> "tuple[list[Filter], tuple[tuple[str, str], ...]]":
        from lite6jax.identifiability import candidates, clearance

        at = [value / 1e3 for value in self.setup.tool_at]
        filters: list[Filter] = []
        disabled: tuple[tuple[str, str], ...] = ()
        if self.box is not None:
            low, high = (tuple(value / 1e3 for value in corner) for corner in (self.box[:3], self.box[3:]))
            filters.append(candidates.inside_box(arm, candidates.Box(low, high), at))  # type: ignore[arg-type]
        if self.floor is not None:
            filters.append(candidates.above_floor(arm, self.floor / 1e3, at))
        if self.geometry is not None:
            file, _, tip = str(self.geometry).partition("#")
            capsules = clearance.urdf_capsules(file, arm, tip=tip or None)
        elif self.link_radius != 0:
            radius = None if self.link_radius is None else self.link_radius / 1e3
            capsules = clearance.chain_capsules(arm, radius, at)
        else:
            capsules = []
        if capsules:
            apart = clearance.self_collision(arm, capsules)
            disabled = apart.disabled
            filters.append(candidates.clear_of_itself(apart))
        filters += map(candidates.user_filter, self.filter)
        return filters, disabled

    def _arm_reference(self) -> str:
        """What the sidecar calls the arm: a bundled name, or its file's path from where the sidecar stands."""
        from lite6jax.arms.bundled import bundled_arms

        if self.source in bundled_arms():
            return self.source
        return Path(os.path.relpath(Path(self.source).resolve(), self.out.resolve().parent)).as_posix()


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise InputError(f"--seed {seed}: give 0 or more")


def _stem(source: str) -> str:
    """What the figures of a source are named after."""
    return Path(source.partition("#")[0]).stem
