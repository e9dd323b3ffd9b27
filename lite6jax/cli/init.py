"""The command that looks at a table with column names of its own and writes the sidecar by which all others read it."""

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any, final

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax.cli.arguments import ArmName, arm_reference, pairs
from lite6jax.cli.exit_codes import DONE
from lite6jax.cli.join import join
from lite6jax.errors import InputError
from lite6jax.storage import check_writable, write_atomically

if TYPE_CHECKING:
    from pathlib import Path

    from lite6jax.domains.pose.inspection import Inspection
    from lite6jax.recordings.fault import DataFault
    from lite6jax.recordings.raw import RawTable

_QUESTIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "joint_source": ("Where are the joint positions from?", ("measured", "commanded", "unknown")),
    "pose_source": (
        "What measured the poses?",
        ("laser_tracker", "motion_capture", "camera", "controller_fk", "unknown"),
    ),
    "pose_frame": ("Are the poses in the arm's base frame (base), or in the sensor's (unknown)?", ("unknown", "base")),
    "tool": ("Are the poses of the flange itself (none), or of a tool (unknown)?", ("unknown", "none")),
    "torque_source": ("Where are the torques from?", ("measured", "current", "estimated", "unknown")),
}


@final
@dataclass(frozen=True)
class Init:
    """Look at a recording, whatever its columns are called, and write the sidecar that says how to read it.

    Joints, poses, torques and times are recognised by the names; degrees, millimetres and the form of rotations by size
    and, with an arm, by its kinematics. It asks on a terminal, and takes options elsewhere.

    For example:

        lite6jax init run7.csv --arm ur10
        lite6jax init robot.csv tracker.csv --arm ur10
        lite6jax init run7.csv --arm my_arm.urdf --set pose_source=laser_tracker --set pose_frame=base
        lite6jax init run7.csv --column tracker_x=x_mm --column spindle=ignore
    """

    source: Annotated[Positional[tuple[str, ...]], arg(metavar="RECORDING")]
    """A table (.csv, .parquet), a log (.mcap, .bag, the folder of a rosbag2), or the folder of a LeRobot data set; or
    two files, one with the joints and one with the poses, which are joined to one table."""
    arm: ArmName = None
    """The nominal arm: a bundled name, or a description, URDF or MJCF. Recognised by the poses where not given."""
    column: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="COLUMN=MEANING")] = ()
    """What a column is, such as joint_1=q1_deg, tcp_x=x_mm, or foo=ignore. May be repeated."""
    names: str = ""
    """What the columns of a table without names are, in order: q1_deg,q2_deg,x_mm; nothing for one to be ignored."""
    set: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="KEY=VALUE")] = ()
    """A key of the sidecar, such as pose_frame=base or tool=none. May be repeated."""
    yes: bool = False
    """Ask nothing."""
    json: bool = False
    """Print what was recognised as JSON, and ask nothing."""
    force: bool = False
    """Replace the sidecar if it exists, and the table that two files are joined to."""

    def run(self) -> int:
        """Looks, asks, writes, prints."""
        from lite6jax.domains.pose.inspection import inspect
        from lite6jax.fitting.source import load_nominal
        from lite6jax.recordings.ros import ArmJoints
        from lite6jax.recordings.settings import declared_settings
        from lite6jax.recordings.sidecar import sidecar_path
        from lite6jax.recordings.sources import open_table, split_topics
        from lite6jax.report import inspection, screen

        settings = pairs("--set", self.set, parsed=True)
        given = pairs("--column", self.column)
        declared_settings(None, None, settings)
        joined = join(self.source, load_nominal(self.arm), given, self.force)
        source, given = (self.source[0], given) if joined is None else (str(joined.path), dict(joined.given))
        path, topics = split_topics(source)
        sidecar = sidecar_path(path)
        arm, shown = self.arm, False

        def opened() -> "tuple[Path, RawTable, list[tuple[str, Any]], list[str]]":
            if joined is not None:
                return joined.path, joined.table, list(joined.table.numbers()), list(joined.notes)
            notes: list[str] = []
            place, table = open_table(path, topics, ArmJoints.of(load_nominal(arm)), notes)
            return place, table, list(table.numbers()), notes

        def look() -> "Inspection":
            said = {key: settings[key] for key in ("pose_source", "motion") if isinstance(settings.get(key), str)}
            return inspect(columns, load_nominal(arm), given, str(file), assumed=table.assumed, **said)

        file, table, columns, notes = opened()
        check_writable(sidecar, self.force)
        given = table.renamed(str(file), given, self.names)
        found = look()
        if arm and (before_jaw := _before_jaw(arm, found)):
            arm = before_jaw
            found = look()
            notes.append(f"the jaw is left out, as its column is a gripper's: the arm is {arm}")
        if not (self.yes or self.json) and _on_a_terminal():
            screen.show(inspection.inspection_report(found, str(file)))
            arm = arm or _asked_arm(found)
            if arm and not self.arm:  # the joint states of a log are in the units of its joints
                file, table, columns, notes = opened()
            before = dict(given)
            given |= _asked_motors(look())
            given |= _asked_pose(look())
            given |= _asked_columns(look())
            settings |= _asked(look(), settings)
            found, shown = look(), bool(arm) == bool(self.arm) and given == before
        if found.motors:
            raise InputError(f"{file}: {inspection.choice_of_motors(found)}")
        if found.undecided:
            raise InputError(f"{file}: {inspection.choice_of_pose(found)}")
        named = arm_reference(arm, sidecar) if arm else None if found.arm is None else found.arm.name
        settings = ({"arm": named} if named else {}) | settings
        settings.setdefault("motion", found.motion[0])
        if found.computed:
            settings.setdefault("pose_source", "controller_fk")
        self._check(found, table, file, notes)
        text = inspection.sidecar_text(found, settings, file.name)
        made = [] if joined is None else [joined.write(self.force)]
        made.append(write_atomically(sidecar, text, self.force))
        faults = _gross_faults(source, found, settings, notes)
        if self.json:
            told = {"faults": [fault.to_dict() for fault in faults], "notes": notes, "sidecar": str(sidecar)}
            print(json.dumps({**found.to_dict(), **told}, indent=1, allow_nan=False))
            return DONE
        if not shown:
            screen.show(inspection.inspection_report(found, str(file)))
        if faults:
            from lite6jax.report import data_faults

            screen.show(data_faults.fault_lines(faults))
        screen.show(screen.notes(notes))
        screen.written(made)
        screen.show(inspection.next_steps(found, settings, source))
        return DONE

    def _check(self, found: "Inspection", table: "RawTable", path: "Path", notes: list[str]) -> None:
        """Refuses what the other commands would refuse, before anything is written."""
        from lite6jax.recordings.table import tabulated
        from lite6jax.report.inspection import no_angles

        q = found.of("q")
        if q is not None and q.unit.reason in ("percent", "ticks"):
            raise InputError(f"{path}: {no_angles(q)}")
        if q is None and not any(name.startswith("q1_") for name in found.given.values()):
            listed = ", ".join(repr(name[:40]) for name in table.names[:8]) + (", ..." if len(table.names) > 8 else "")
            raise InputError(
                f"{path}: no columns look like joint positions; say which they are, --column NAME=q1_deg --column "
                f"NAME=q2_deg and so on (q1_rad in radians, q1_mm of a prismatic joint); it has {listed}"
            )
        dof = None if found.arm is None else found.arm.dof
        tabulated(table.names, str(path), table.load, notes, dof=dof, renamed=found.columns)


def _gross_faults(
    source: str, found: "Inspection", settings: Mapping[str, Any], notes: list[str]
) -> "tuple[DataFault, ...]":
    """Why the recording, read as its new sidecar says, misses the arm grossly: the answer of `check`, without a fit."""
    from lite6jax.domains.pose.screening.options import ScreeningOptions

    if found.arm is None or found.of("q") is None or found.of("position") is None or not isfinite(found.error):
        return ()
    declared = settings.get("pose_frame") == "base" or settings.get("tool", "unknown") != "unknown"
    if not declared and found.error <= ScreeningOptions().suspect_reach * found.arm.reach:
        return ()  # nothing is declared that could be wrong, and the nominal arm agrees
    from lite6jax.domains.pose.screening.screen import screen as screened
    from lite6jax.recordings import read_recording

    try:
        return screened(read_recording(source), allow_undecided=True, coarse=True).found
    except InputError as error:  # of too few rows, and the like: the table was recognised all the same
        notes.append(str(error))
        return ()


def _on_a_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def _asked_arm(found: "Inspection") -> str | None:
    if found.arm is not None:
        return None
    return input("Arm (a bundled name or a file; nothing for later): ").strip() or None


def _before_jaw(arm: str, found: "Inspection") -> str | None:
    """An arm's file with the tip before its jaw, where none is named and a table has a gripper for the jaw."""
    from lite6jax.arms.urdf import tip_before_jaw
    from lite6jax.recordings.naming import is_of_gripper

    q = found.of("q")
    if not arm.endswith(".urdf") or q is None or not is_of_gripper(q.block.columns[-1]):
        return None
    tip = tip_before_jaw(arm)
    return f"{arm}#{tip}" if tip else None


def _asked_motors(found: "Inspection") -> dict[str, str]:
    """The columns of the arm's joints, where a table has more of them than the arm."""
    from lite6jax.report.inspection import choice_of_motors

    if not found.motors or found.arm is None:
        return {}
    print(choice_of_motors(found))
    every = [name for group in found.motors for name in group]
    usual = ",".join(every[: found.arm.dof])
    while True:
        answer = input(f"Which columns are the joints, in order? [nothing for {usual}]: ").strip() or usual
        said = [name.strip() for name in answer.split(",")]
        if len(said) == len({*said}) == found.arm.dof and {*said} <= {*every}:
            return dict(zip(said, found.joint_columns, strict=True))
        print(f"write {found.arm.dof} of {', '.join(every)}, between commas")


def _asked(found: "Inspection", settings: Mapping[str, Any]) -> dict[str, Any]:
    """Answers to the questions that the table raises and no option has answered."""
    poses = found.of("position") is not None
    torques = found.of("tau") is not None or found.of("current") is not None
    wanted = ["joint_source", *(("pose_source", "pose_frame", "tool") if poses else ())]
    answers = {}
    for key in (*wanted, *(("torque_source",) if torques else ())):
        if key in settings or (key == "pose_source" and found.computed):
            continue
        question, choices = _QUESTIONS[key]
        answers[key] = _answer(question, choices, "unknown")
    return {key: answer for key, answer in answers.items() if answer != "unknown"}


def _asked_pose(found: "Inspection") -> dict[str, str]:
    """The columns of the poses that are not meant, to be ignored, where several are there and none is taken."""
    from lite6jax.report.inspection import source_statement

    if not found.undecided:
        return {}
    for source in found.sources:
        print(source_statement(source))
    names = [source.columns[0] for source in found.sources]
    answer = _answer("Which pose is meant?", names, names[-1])
    return {name: "ignore" for source in found.sources if source.columns[0] != answer for name in source.columns}


def _asked_columns(found: "Inspection") -> dict[str, str]:
    """The names of columns whose unit or form is only assumed."""
    from lite6jax.report.inspection import statement

    given: dict[str, str] = {}
    for meaning in found.meanings:
        form, unit = meaning.form, meaning.unit
        doubtful = form is not None and form.sure == "assumed"
        if not doubtful and (unit.sure != "assumed" or len(meaning.units) < 2):
            continue
        print(statement(meaning))
        if form is not None and doubtful:
            given |= meaning.renamed(form=_answer("Which form is it?", meaning.forms, form.choice))
        if unit.choice and unit.sure == "assumed":
            given |= meaning.renamed(unit=_answer("In which unit?", meaning.units, unit.choice))
    return given


def _answer(question: str, choices: Sequence[str], usual: str) -> str:
    while True:
        answer = input(f"{question} [{' | '.join(choices)}; nothing for {usual}]: ").strip() or usual
        if answer in choices:
            return answer
        print(f"write one of {', '.join(choices)}")
