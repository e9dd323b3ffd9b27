"""The command that designs poses to record or a motion to make, to identify parameters or to separate effects."""

import math
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, final

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax.cli import command
from lite6jax.cli.study import Setup, TorqueSetup
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError

with import_lazily():
    from lite6jax import recordings
    from lite6jax.arms import arm as arms
    from lite6jax.arms import files
    from lite6jax.design import candidates, clearance, motions, poses, torques
    from lite6jax.effects import serialization
    from lite6jax.effects.dynamic import catalogue
    from lite6jax.fitting import source
    from lite6jax.report import figures, study

if TYPE_CHECKING:
    from collections.abc import Iterable

    from rich.console import RenderableType

    Designed = tuple[Any, recordings.Recording, Iterable[RenderableType]]
    """A design, what is written of it, and its report."""


@final
@dataclass(frozen=True)
class Design:
    """Which poses to record: those that determine an arm's parameters best, and how many are enough; or, with --torque,
    which motion to make: one from rest to rest whose torques determine an arm's dynamics best.

    For example:

        lite6jax design lite6 --poses 40 --sensor tracker --out poses.csv
        lite6jax design lite6 --poses 30 --box 100 -300 0 500 300 500 --floor 20 --out poses.csv
        lite6jax design lite6 --discriminate joint_compliance:joint=2,compliance_rad_per_Nm=1e-5
            joint_harmonic:joint=2,order=1 --out poses.csv
        lite6jax design lite6 --torque --out motion.csv
        lite6jax design lite6 --torque --discriminate viscous_friction:joint=2,viscous_Nm_s_per_rad=1
            coulomb_friction:joint=2 --out motion.csv
    """

    out: Annotated[Path, arg(metavar="FILE")]
    """Write the joint positions here (.csv or .parquet), in an order of short moves, and a sidecar beside it."""
    source: Annotated[Positional[str], arg(metavar="ARM|FILE")] = "lite6"
    """A bundled arm or an arm's file."""
    setup: Setup = field(default_factory=Setup)
    torque: TorqueSetup = field(default_factory=TorqueSetup)
    poses: int = 40
    """Number of poses to choose."""
    accuracy: Annotated[float | None, arg(metavar="MM")] = None
    """Say how many poses predict positions to this accuracy (one standard deviation)."""
    criterion: Literal["I", "D", "A", "E"] = "I"
    """I: positions predicted over the workspace; D, A, E: the parameters' volume, mean variance, worst direction."""
    discriminate: Annotated[tuple[str, str] | None, arg(metavar="EFFECT EFFECT")] = None
    """Choose the poses that discriminate between these two effects instead. The first must have a size; the second
    may have one, and then each is tested against the other."""
    candidates: int = 100_000
    """Number of joint positions drawn, among which poses are chosen."""
    recorded: Annotated[Path | None, arg(metavar="FILE")] = None
    """A recording whose poses count as already measured."""
    limit_margin: Annotated[float, arg(metavar="DEG")] = 2.0
    """The least distance of each joint from its limits."""
    box: Annotated[tuple[float, float, float, float, float, float] | None, arg(metavar="MM…")] = None
    """Where the sensor measures the tool: least x y z, then greatest x y z, mm in the base's frame."""
    floor: Annotated[float | None, arg(metavar="MM")] = None
    """Height above which all joints, the flange and the tool stay, mm in the base's frame."""
    link_radius: Annotated[float | None, arg(metavar="MM")] = None
    """The radius of the capsules around the links; a twentieth of the reach where not given, 0 for no check."""
    collision_geometry: Annotated[str | None, arg(metavar="URDF")] = None
    """Take the links' shapes from this URDF's collision geometry instead (robot.urdf#tip)."""
    filter: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="FILE.py:FUNCTION")] = ()
    """A function of yours from (sample, joint) rad to bool, true where a pose may be recorded. Runs the file."""
    refine: bool = True
    """Move the chosen poses on by gradient, between the candidates."""
    seed: command.Seed = 0
    processes: command.Processes = None
    """With --torque: so many processes of this machine compute, each with one thread; this one alone where not
    given."""
    scheduler: command.Scheduler = None
    """With --torque, in place of processes of this machine: the Dask cluster of the scheduler at this address
    (tcp://HOST:8786)."""
    figures: command.Folder = None
    """Draw the accuracy against the number of poses into this folder (PNG and SVG)."""
    json: command.Json = False
    force: command.Force = False

    def run(self) -> int:
        """Draws candidates or motions, chooses, writes, prints."""
        sidecar = recordings.sidecar_path(self.out)
        filters = (reference.rpartition(":")[0] for reference in self.filter)
        inputs = [self.source, self.recorded, self.collision_geometry, *filters]
        command.check_outputs([self.out, sidecar], inputs, self.force)
        command.check_seed(self.seed)
        command.check_processes(self.processes, self.scheduler)
        self._check_options()
        of_motion = self.torque.torque
        name = f"{self.out.stem}_{'motion' if of_motion else 'accuracy'}"
        command.check_figures(self.figures, [name], self.force)
        design = self._design_motion if of_motion else self._design_poses
        found, recording, report = design(files.read_arm(self.source))
        written = [recordings.write_recording(recording, self.out, self.force), sidecar]

        def draw():
            yield (figures.designed_motion if of_motion else figures.accuracy_by_count)(found, self.source)

        written += command.save_figures(self.figures, [name], draw, self.force)
        return command.present(self.json, found, report, written)

    def _check_options(self) -> None:
        if self.torque.torque:
            others = ("poses", "accuracy", "criterion", "candidates", "recorded", "refine")
            default = {item.name: item.default for item in fields(self)}
            given = [f"--{name}" for name in others if getattr(self, name) != default[name]]
            if replace(self.setup, tool_at=(0.0, 0.0, 0.0)) != Setup():
                given.append("the options of a sensor")
            if given:
                raise InputError(f"--torque: designs a motion; leave {given[0]} out")
            return
        self.torque.refuse_unused()
        if self.processes is not None or self.scheduler is not None:
            raise InputError(
                "--processes, --scheduler: apply only to the design of a motion; add --torque, or leave them out"
            )
        if self.discriminate is not None and (self.criterion != "I" or self.accuracy is not None):
            raise InputError(
                "--discriminate: chooses by the distance between two effects; leave --criterion and --accuracy out"
            )
        if self.accuracy is not None and not self.accuracy > 0:
            raise InputError(f"--accuracy {self.accuracy}: give a standard deviation in mm, above 0")

    def _design_poses(self, arm: "arms.Arm") -> "Designed":
        experiment = self.setup.experiment(arm)
        recorded = None
        if self.recorded is not None:
            recorded = source.read_source(self.recorded, arm)
            if not isinstance(recorded, recordings.Recording):
                raise InputError(f"{self.recorded}: is no recording; --recorded takes a .csv or .parquet")
            recorded = recorded.joint_position
        margin = math.radians(self.limit_margin)
        filters, disabled = self._filters(arm)
        drawn = candidates.candidates(arm, self.candidates, self.seed, filters, margin)
        options = {
            "recorded": recorded,
            "refined": self.refine,
            "limits": candidates.inside_limits(arm, margin),
            "feasible": lambda q: candidates.all_pass(filters, q),
            "seed": self.seed,
        }
        accuracy = None if self.accuracy is None else self.accuracy / 1e3
        if self.discriminate is None:
            options |= {"criterion": self.criterion, "accuracy": accuracy}
            found = poses.plan_poses(experiment, drawn.joint_position, self.poses, **options)
        else:
            one, other = self.discriminate
            rivals = (serialization.parse_effect(one), serialization.parse_effect(other, neutral=True))
            found = poses.plan_discrimination(experiment, rivals, drawn.joint_position, self.poses, **options)
        q = found.joint_position[poses.shortest_round(found.joint_position)]
        settings = recordings.RecordingSettings(arm=command.name_arm(self.source, self.out), motion="static")
        planned = recordings.Recording.assembled(q, settings=settings, sliding=arm.sliding)
        report = study.design_report(found, drawn, disabled, self.source, accuracy)
        return found, planned, report

    def _design_motion(self, arm: "arms.Arm") -> "Designed":
        filters, disabled = self._filters(arm)
        room = self.torque.room(arm, filters, math.radians(self.limit_margin))
        search = motions.MotionSearch(seed=self.seed, processes=self.processes, scheduler=self.scheduler)
        if self.discriminate is None:
            found = torques.plan_motion(self.torque.model(arm), room, search)
            report = study.torque_plan_report(found, disabled, self.source)
        else:
            model = self.torque.model(arm, unknown=False)
            one, other = self.discriminate
            rivals = [
                serialization.parse_effect(one, catalogue.BUILT_IN, False, arm.sliding),
                serialization.parse_effect(other, catalogue.BUILT_IN, True, arm.sliding),
            ]
            found = torques.plan_torque_discrimination(model, room, rivals, search)  # type: ignore[arg-type]
            report = study.torque_discrimination_report(found, disabled, self.source)
        time, motion = found.trajectory.time, found.trajectory.motion
        settings = recordings.RecordingSettings(
            arm=command.name_arm(self.source, self.out),
            motion="trajectory",
            gravity_m_per_s2=self.torque.gravity or torques.GRAVITY,
        )
        recording = recordings.Recording.assembled(
            motion.q.T,
            time=time,
            joint_velocity=motion.dq.T,
            joint_acceleration=motion.ddq.T,
            settings=settings,
            sliding=arm.sliding,
        )
        return found, recording, report

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
        if self.collision_geometry is not None:
            file, _, tip = str(self.collision_geometry).partition("#")
            shapes = clearance.urdf_capsules(file, arm, tip=tip or None)
        elif self.link_radius != 0:
            radius = None if self.link_radius is None else self.link_radius / 1e3
            shapes = clearance.chain_capsules(arm, radius, at)
        else:
            shapes = []
        if shapes:
            apart = clearance.self_collision(arm, shapes)
            disabled = apart.disabled
            filters.append(candidates.clear_of_itself(apart))
        filters += map(candidates.user_filter, self.filter)
        return filters, disabled
