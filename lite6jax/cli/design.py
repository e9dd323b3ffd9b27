"""The command that chooses poses to record, for the parameters or to discriminate between two effects."""

import math
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, final

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax.cli import torque_study
from lite6jax.cli.arguments import (
    Folder,
    Processes,
    Scheduler,
    arm_reference,
    check_processes,
    check_seed,
    refuse_inputs,
)
from lite6jax.cli.exit_codes import DONE
from lite6jax.cli.study import Setup
from lite6jax.cli.torque_study import TorqueSetup
from lite6jax.errors import InputError
from lite6jax.storage import check_writable

if TYPE_CHECKING:
    from lite6jax.arms.arm import Arm
    from lite6jax.identifiability.candidates import Filter


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
    seed: int = 0
    """Seed of the random numbers."""
    processes: Processes = None
    """With --torque: so many processes of this machine compute, each with one thread; this one alone where not
    given."""
    scheduler: Scheduler = None
    """With --torque, in place of processes of this machine: the Dask cluster of the scheduler at this address
    (tcp://HOST:8786)."""
    figures: Folder = None
    """Draw the accuracy against the number of poses into this folder (PNG and SVG)."""
    json: bool = False
    """Print JSON instead of the report."""
    force: bool = False
    """Replace files that exist."""

    def run(self) -> int:
        """Draws candidates, chooses, writes, prints."""
        from lite6jax.arms.files import read_arm
        from lite6jax.fitting.source import read_source
        from lite6jax.identifiability.candidates import all_pass, candidates, inside_limits
        from lite6jax.identifiability.discrimination import plan_discrimination
        from lite6jax.identifiability.planning import plan_poses
        from lite6jax.identifiability.route import shortest_round
        from lite6jax.recordings import Recording, RecordingSettings, sidecar_path, write_recording
        from lite6jax.report import screen, study

        check_writable(self.out, self.force)
        check_writable(sidecar_path(self.out), self.force)
        filters = (reference.rpartition(":")[0] for reference in self.filter)
        read = [self.source, self.recorded, self.collision_geometry, *filters]
        refuse_inputs([self.out, sidecar_path(self.out)], read)
        check_seed(self.seed)
        check_processes(self.processes, self.scheduler)
        if self.torque.torque:
            return self._design_motion()
        torque_study.refuse_without_torque(self.torque)
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
        options = {
            "recorded": recorded,
            "refined": self.refine,
            "limits": inside_limits(arm, margin),
            "feasible": lambda q: all_pass(filters, q),
            "seed": self.seed,
        }
        accuracy = None if self.accuracy is None else self.accuracy / 1e3
        if self.discriminate is None:
            found = plan_poses(
                experiment, drawn.joint_position, self.poses, criterion=self.criterion, accuracy=accuracy, **options
            )
        else:
            from lite6jax.effects.serialization import parse_effect

            rivals = (parse_effect(self.discriminate[0]), parse_effect(self.discriminate[1], neutral=True))
            found = plan_discrimination(experiment, rivals, drawn.joint_position, self.poses, **options)
        q = found.joint_position[shortest_round(found.joint_position)]
        settings = RecordingSettings(arm=arm_reference(self.source, self.out), motion="static")
        planned = Recording.assembled(q, settings=settings, sliding=experiment.arm.sliding)
        written = [write_recording(planned, self.out, self.force)]
        written.append(sidecar_path(self.out))
        if self.figures:
            from lite6jax.report import canvas, figures

            drawing = figures.accuracy_by_count(found, self.source)
            written += canvas.save({name: drawing}, self.figures, self.force)
        if self.json:
            from lite6jax.report import documents

            print(documents.text(documents.document(found), written))
            return DONE
        screen.show(study.design_report(found, drawn, disabled, self.source, accuracy))
        screen.written(written)
        return DONE

    def _filters(self, arm: "Arm") -> "tuple[list[Filter], tuple[tuple[str, str], ...]]":
        from lite6jax.identifiability import candidates, capsules, clearance

        if self.floor is not None and not math.isfinite(self.floor):
            raise InputError(f"--floor {self.floor}: give a height in mm")
        at = [value / 1e3 for value in self.setup.tool_at]
        filters: list[Filter] = []
        disabled: tuple[tuple[str, str], ...] = ()
        if self.box is not None:
            low, high = (tuple(value / 1e3 for value in corner) for corner in (self.box[:3], self.box[3:]))
            filters.append(candidates.inside_box(arm, candidates.Box(low, high), at))  # type: ignore[arg-type]
        if self.floor is not None:
            filters.append(candidates.above_floor(arm, self.floor / 1e3, at))
        if self.collision_geometry is not None:
            file, _, tip = str(self.collision_geometry).partition("#")
            shapes = capsules.urdf_capsules(file, arm, tip=tip or None)
        elif self.link_radius != 0:
            radius = None if self.link_radius is None else self.link_radius / 1e3
            shapes = capsules.chain_capsules(arm, radius, at)
        else:
            shapes = []
        if shapes:
            apart = clearance.self_collision(arm, shapes)
            disabled = apart.disabled
            filters.append(candidates.clear_of_itself(apart))
        filters += map(candidates.user_filter, self.filter)
        return filters, disabled

    def _design_motion(self) -> int:
        from lite6jax.arms.files import read_arm

        others = (*("poses", "accuracy", "criterion", "candidates", "recorded", "refine"),)
        default = {item.name: item.default for item in fields(self)}
        given = [name for name in others if getattr(self, name) != default[name]]
        if given or replace(self.setup, tool_at=(0.0, 0.0, 0.0)) != Setup():
            raise InputError(
                f"--torque: designs a motion; leave {f'--{given[0]}' if given else 'the options of a sensor'} out"
            )
        if self.figures:
            from lite6jax.report import canvas

            canvas.check_names(self.figures, [torque_study.figure_name(self.out)], self.force)
        filters, disabled = self._filters(read_arm(self.source))
        return torque_study.design_motion(
            self.torque,
            self.source,
            self.out,
            arm_reference(self.source, self.out),
            filters,
            disabled,
            math.radians(self.limit_margin),
            self.discriminate,
            self.seed,
            self.processes,
            self.scheduler,
            self.figures,
            self.force,
            self.json,
        )
