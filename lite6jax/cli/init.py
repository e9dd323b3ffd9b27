"""Commands that make recordings of what people have: tables with column names of their own, and images of a board.

Two files with clocks of their own, commands beside measured joints, and points on one body, are joined to one table
before.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, final

from tyro.conf import Positional, UseAppendAction, arg

from lite6jax import suffixes
from lite6jax.cli import command
from lite6jax.deferred import import_lazily
from lite6jax.errors import InputError, command_line, name_options
from lite6jax.storage import check, check_writable, write_atomically

with import_lazily():
    from lite6jax import formatting, recordings
    from lite6jax.arms import arm as arms
    from lite6jax.arms import files
    from lite6jax.calibration import source as sources
    from lite6jax.domains.pose import joining as pose_joining
    from lite6jax.domains.pose.screening import screen as screening
    from lite6jax.domains.pose.screening import thresholds as screening_thresholds
    from lite6jax.domains.tracking import joining as tracking_joining
    from lite6jax.recordings import boards, fault, formats, points, reflectors
    from lite6jax.recordings import files as tables
    from lite6jax.recordings import settings as sidecar_settings
    from lite6jax.recordings import table as tabulation
    from lite6jax.recordings.columns import cells, documented
    from lite6jax.recordings.columns import inspection as recognition
    from lite6jax.recordings.columns import names as column_names
    from lite6jax.report import faults, inspection, screen

if TYPE_CHECKING:
    import numpy as np
    from rich.console import RenderableType

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


class _Table(NamedTuple):
    """A table as it is looked at.

    Attributes:
        path: of its file, or of the one that it is written to.
        content: what the file holds.
        columns: their numbers; None of text.
        words: of the columns of text.
        notes: how it was read.
        in_file: of columns that are called otherwise here, their names in the file.
        given: meanings that are known, by the names here.
        made: what it is called after, where it is made of others; empty where it is a file's own.
    """

    path: Path
    content: "tabulation.RawTable"
    columns: "list[tuple[str, np.ndarray | None]]"
    words: Mapping[str, Sequence[str]]
    notes: list[str]
    in_file: Mapping[str, str] = MappingProxyType({})
    given: Mapping[str, str] = MappingProxyType({})
    made: str = ""

    @property
    def numbers(self) -> "dict[str, np.ndarray]":
        """The columns of numbers."""
        return {name: values for name, values in self.columns if values is not None}

    def called(self, names: Mapping[str, str]) -> "_Table":
        """With other names of some columns, which are given by the new one."""
        new_names = {before: name for name, before in names.items()}
        columns = [(new_names.get(name, name), values) for name, values in self.columns]
        words = {new_names.get(name, name): cells for name, cells in self.words.items()}
        meanings = {new_names.get(name, name): meaning for name, meaning in self.given.items()}
        in_file = {name: name_in_file for name, name_in_file in self.in_file.items() if name not in new_names}
        in_file |= {name: self.in_file.get(before, before) for name, before in names.items()}
        return self._replace(columns=columns, words=words, given=meanings, in_file=in_file)

    def remade(self, columns: "Mapping[str, np.ndarray]", words: Mapping[str, Sequence[str]], made: str) -> "_Table":
        """With other columns, which no file has."""
        return self._replace(columns=list(columns.items()), words=words, in_file={}, made=self.made or made)


@final
@dataclass(frozen=True)
class InitCommand:
    """Look at a recording, whatever its columns are called, and write the sidecar that says how to read it.

    Joints, poses, torques and times are recognised by the names; degrees, millimetres and the form of rotations by size
    and, with an arm, by its kinematics. It asks on a terminal, and takes options elsewhere.

    For example:

        lite6jax init run7.csv --arm ur10
        lite6jax init robot.csv tracker.csv --arm ur10
        lite6jax init control.csv state_motor.csv --arm arm.urdf
        lite6jax init run7.csv --arm my_arm.urdf --set pose_source=laser_tracker --set pose_frame=base
        lite6jax init run7.csv --column tracker_x=x_mm --column spindle=ignore
    """

    source: Annotated[Positional[tuple[str, ...]], arg(metavar="RECORDING")]
    """A table (.csv, .parquet, .xlsx), arrays (.h5, .npz, .mat), samples of a hand-eye calibration (.yaml, .json), a
    program (.src, .ls, .mod), a log (.mcap, .bag, the folder of a rosbag2), or the folder of a LeRobot data set; or two
    files, one with the joints and one with the poses, or one with the commands and one with the measured joints, which
    are joined to one table."""
    arm: command.ArmName = None
    """The nominal arm: a bundled name, or a description, URDF or MJCF. Recognised by the poses where not given."""
    column: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="COLUMN=MEANING")] = ()
    """What a column is, such as joint_1=q1_deg, tcp_x=x_mm, or foo=ignore. May be repeated."""
    names: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="NAME,NAME,...")] = ()
    """The names of the columns of a table without names, in order: q1_deg,q2_deg,x_mm, or SMR1_x,SMR1_y; nothing for
    one to be ignored. Of two such tables one after the other, or by one --names each."""
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
        settings = command.parse_pairs("--set", self.set, as_yaml=True)
        meanings = command.parse_pairs("--column", self.column)
        sidecar_settings.declared_settings(None, None, settings)
        arm = self.arm
        shown = False
        declared = {key: settings[key] for key in ("pose_source", "motion") if isinstance(settings.get(key), str)}
        nominal = sources.load_nominal(arm)
        table = _read_table(self.source, nominal, meanings, self.names, declared.get("pose_source"), self.force)
        source = str(table.path) if table.made else self.source[0]
        file = table.path
        notes = [*table.notes]
        sidecar = check_writable(recordings.sidecar_path(tables.split_topics(source)[0]), self.force)
        meanings = dict(table.given)

        def look() -> "recognition.Inspection":
            nominal = sources.load_nominal(arm)
            assumed = table.content.assumed
            inspected = recognition.inspect(
                table.columns, nominal, meanings, str(file), assumed=assumed, words=table.words, **declared
            )
            return replace(inspected, in_file=table.in_file)

        inspected = look()
        if arm and (shorter := _leave_out_jaw(arm, inspected)):
            arm = shorter
            inspected = look()
            notes.append(f"the jaw is left out, as its column is a gripper's: the arm is {arm}")
        if not (self.yes or self.json) and _on_a_terminal():
            screen.show(inspection.inspection_report(inspected, str(file)))
            if not arm and inspected.arm is None:
                arm = input("Arm (a bundled name or a file; nothing for later): ").strip() or None
            if arm and not self.arm and not table.made:  # the joint states of a log are in the units of its joints
                table = _read_table(self.source, sources.load_nominal(arm), meanings, self.names, None, self.force)
                notes = [*table.notes]
            before = dict(meanings)
            for ask in (_ask_motors, _ask_pose, _ask_columns):
                meanings |= ask(look())
            settings |= _ask_settings(look(), settings)
            inspected = look()
            shown = bool(arm) == bool(self.arm) and meanings == before
        if inspected.motors:
            raise InputError(f"{file}: {inspection.choice_of_motors(inspected)}")
        if inspected.undecided:
            raise InputError(f"{file}: {inspection.choice_of_pose(inspected)}")
        if arm:
            settings = {"arm": command.name_arm(arm, sidecar)} | settings
        elif inspected.arm is not None:
            settings = {"arm": inspected.arm.name} | settings
        settings.setdefault("motion", inspected.motion[0])
        if inspected.holds("cmd_dq") and not inspected.holds("cmd"):
            settings.setdefault("command", "velocity")
        if inspected.computed:
            settings.setdefault("pose_source", "controller_fk")
        _check(inspected, table.content, file, notes)
        text = inspection.sidecar_text(inspected, settings, file.name)
        made = [_write(table, self.force)] if table.made else []
        made.append(write_atomically(sidecar, text, self.force))
        data_faults = _find_gross_faults(source, inspected, settings, notes)
        if self.json:
            more = {"faults": [fault.to_dict() for fault in data_faults], "notes": notes, "sidecar": str(sidecar)}
            plain = check({**inspected.to_dict(), **more}, dict)  # a number that is not finite becomes null
            print(json.dumps(plain, indent=1, allow_nan=False))
            return command.DONE
        if not shown:
            screen.show(inspection.inspection_report(inspected, str(file)))
        if data_faults:
            screen.show(faults.fault_lines(data_faults))
        screen.show(screen.notes(notes))
        screen.written(made)
        screen.show(inspection.next_steps(inspected, settings, source))
        return command.DONE


def _check(inspected: "recognition.Inspection", table: "tabulation.RawTable", path: "Path", notes: list[str]) -> None:
    """Refuses what the other commands would refuse, before anything is written."""
    q = inspected.of("q")
    if q is not None and q.unit and q.unit.reason in ("percent", "ticks", "whole"):
        raise InputError(f"{path}: {inspection.no_angles(q)}")
    if not inspected.holds("q"):
        raise InputError(
            f"{path}: no columns look like joint positions; say which they are, --column NAME=q1_deg --column "
            f"NAME=q2_deg and so on (q1_rad in radians, q1_mm of a prismatic joint); it has "
            f"{documented.list_names(table.names)}"
        )
    dof = None if inspected.arm is None else inspected.arm.dof
    tabulation.tabulate(table, str(path), notes, dof=dof, renamed=inspected.columns)


def _find_gross_faults(
    source: str, inspected: "recognition.Inspection", settings: Mapping[str, Any], notes: list[str]
) -> "tuple[fault.DataFault, ...]":
    """Why the recording, read as its new sidecar says, misses the arm grossly: the answer of `check`, without a fit."""
    if (
        inspected.arm is None
        or inspected.of("q") is None
        or inspected.of("position") is None
        or not isfinite(inspected.error)
    ):
        return ()
    declared = settings.get("pose_frame") == "base" or settings.get("tool", "unknown") != "unknown"
    agrees = inspected.error <= screening_thresholds.SUSPECT_REACH * inspected.arm.reach
    try:
        recording = recordings.read_recording(source)
        if agrees and not declared:  # nothing is declared that could be wrong
            return screening.screen_rows(recording).found
        return screening.screen(recording, allow_undecided=True, coarse=True).found
    except InputError as error:  # of too few rows, and the like: the table was recognised all the same
        notes.append(name_options(str(error)))
        return ()


def _on_a_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def _leave_out_jaw(arm: str, inspected: "recognition.Inspection") -> str | None:
    """An arm's file with the tip before its jaw, where none is named and a table has a gripper for the jaw."""
    q = inspected.of("q")
    if q is None or not column_names.is_of_gripper(q.columns[-1]):
        return None
    tip = files.tip_before_jaw(arm)
    return f"{arm}#{tip}" if tip else None


def _ask_motors(inspected: "recognition.Inspection") -> dict[str, str]:
    """The columns of the arm's joints, where a table has more of them than the arm."""
    if not inspected.motors or inspected.arm is None:
        return {}
    print(inspection.choice_of_motors(inspected))
    motor_columns = [name for group in inspected.motors for name in group]
    usual = ",".join(motor_columns[: inspected.arm.dof])
    while True:
        answer = input(f"Which columns are the joints, in order? [nothing for {usual}]: ").strip() or usual
        joint_columns = [name.strip() for name in answer.split(",")]
        if len(joint_columns) == len({*joint_columns}) == inspected.arm.dof and {*joint_columns} <= {*motor_columns}:
            return dict(zip(joint_columns, inspected.joint_columns, strict=True))
        print(f"write {inspected.arm.dof} of {', '.join(motor_columns)}, between commas")


def _ask_settings(inspected: "recognition.Inspection", settings: Mapping[str, Any]) -> dict[str, Any]:
    """Answers to the questions that the table raises and no option has answered."""
    poses = inspected.of("position") is not None
    torques = inspected.of("tau") is not None or inspected.of("current") is not None
    questions = ["joint_source", *(("pose_source", "pose_frame", "tool") if poses else ())]
    questions += ["torque_source"] if torques else []
    answered = {*settings, *(("pose_source",) if inspected.computed else ())}
    answers = {key: _ask(*_QUESTIONS[key], "unknown") for key in questions if key not in answered}
    return {key: answer for key, answer in answers.items() if answer != "unknown"}


def _ask_pose(inspected: "recognition.Inspection") -> dict[str, str]:
    """The columns of the poses that are not meant, to be ignored, where several are there and none is taken."""
    if not inspected.undecided:
        return {}
    for source in inspected.sources:
        print(inspection.source_statement(source))
    names = [source.columns[0] for source in inspected.sources]
    answer = _ask("Which pose is meant?", names, names[-1])
    return {name: "ignore" for source in inspected.sources if source.columns[0] != answer for name in source.columns}


def _ask_columns(inspected: "recognition.Inspection") -> dict[str, str]:
    """The names of columns whose unit or form is only assumed."""
    meanings: dict[str, str] = {}
    for block in inspected.blocks:
        form, unit = (
            decision if decision and decision.sure == "assumed" else None for decision in (block.form, block.unit)
        )
        forms = block.forms if form else ()
        units = block.units if unit else ()
        if not forms and len(units) < 2:
            continue
        print(inspection.statement(block))
        if form and forms:
            meanings |= block.renamed(form=_ask("Which form is it?", forms, form.choice))
        if unit and unit.choice:
            meanings |= block.renamed(unit=_ask("In which unit?", [*units], unit.choice))
    return meanings


def _ask(question: str, choices: Sequence[str], usual: str) -> str:
    while True:
        answer = input(f"{question} [{' | '.join(choices)}; nothing for {usual}]: ").strip() or usual
        if answer in choices:
            return answer
        print(f"write one of {', '.join(choices)}")


# ------------------------------------------------------------------ join


def _read_table(
    sources: tuple[str, ...],
    arm: "arms.Arm | None",
    meanings: Mapping[str, str],
    names: tuple[str, ...],
    pose_source: str | None,
    overwrite: bool,
) -> _Table:
    """The table of a file; or one that is made of two files, of points on one body, or of names that change places."""
    if not 1 <= len(sources) <= 2:
        raise InputError(
            f"{len(sources)} recordings: name one, or two, of which one has the joints and one the poses or commands"
        )
    opened = _name_columns([_open(source, arm) for source in sources], names)
    for table in opened:
        table.content.renamed(str(table.path), table.in_file or meanings)  # without names it says what to do
    read = [_reshape(_give_meanings(table, meanings), arm, meanings, len(sources) == 2) for table in opened]
    names_there = [name for table in (*opened, *read) for name in (*dict(table.columns), *table.in_file.values())]
    unknown = [name for name in tabulation.resolve_names(names_there, meanings) if name not in names_there]
    if unknown:
        files = " and ".join(sources)
        raise InputError(f"{files}: has no column {unknown[0][:60]!r}; {recognition.near(unknown[0], names_there)}")
    table = read[0]
    notes = read[0].notes
    if len(read) == 2:
        table, notes = _join(read[0], read[1], arm, pose_source, sources)
    else:
        table, notes = _solve_pairs(table, arm, sources[0])
    first = opened[0].path
    if not table.made and recordings.sidecar_path(first) == first:
        table = table.remade(table.numbers, table.words, "table")
    if not table.made:
        return table
    file_format = formats.find_format(first)
    written = file_format is not None and file_format.suffixes in (suffixes.TEXT_TABLES, (suffixes.PARQUET,))
    suffix = first.suffix.lower() if written else suffixes.WRITTEN_TABLES[0]
    place = check_writable(first.with_name(f"{first.stem}_{table.made}{suffix}"), overwrite)
    content = tabulation.RawTable.of_arrays(table.numbers)
    kept_meanings = {name: meaning for name, meaning in table.given.items() if name in content.names}
    return table._replace(path=place, content=content, columns=content.numbers(), given=kept_meanings, notes=notes)


def _open(source: str, arm: "arms.Arm | None") -> _Table:
    notes: list[str] = []
    path, content = tables.open_table(*tables.split_topics(source), recordings.ArmJoints.of(arm), notes)
    columns = content.numbers()
    words = content.words(name for name, numbers in columns if numbers is None)
    return _Table(path, content, columns, words, notes)


def _name_columns(opened: Sequence[_Table], names: Sequence[str]) -> list[_Table]:
    """Tables without names with those that are given, of one after the other."""
    nameless = [table for table in opened if table.content.nameless]
    if names and not nameless:
        raise InputError(f"{opened[0].path}: names its columns already; say what they are by --column NAME=MEANING")
    if not names:
        return [*opened]
    lists = [[name.strip() for name in listed.split(",")] for listed in names]
    counts = [len(table.content.names) for table in nameless]
    if len(lists) == 1 and len(lists[0]) == sum(counts):
        lists = [lists[0][sum(counts[:k]) : sum(counts[: k + 1])] for k in range(len(counts))]
    if len(lists) != len(nameless):
        columns = " and ".join(f"{count} of {table.path}" for count, table in zip(counts, nameless, strict=True))
        name_counts = " and ".join(str(len(listed)) for listed in lists)
        raise InputError(
            f"--names gives {name_counts} names for the columns {columns}; give each one, or one --names a file"
        )
    in_order = iter(lists)
    return [_name_in_order(table, next(in_order)) if table.content.nameless else table for table in opened]


def _name_in_order(table: _Table, names: Sequence[str]) -> _Table:
    """A table without names with these; those that are empty are ignored."""
    if len(names) != len(table.content.names):
        count = len(table.content.names)
        raise InputError(f"{table.path}: --names gives {len(names)} names for {count} columns; give each one")
    if twice := [name for name, count in Counter(filter(None, names)).items() if count > 1]:
        raise InputError(f"{table.path}: --names gives {twice[0][:40]!r} twice; give each column a name of its own")
    in_file = {
        name: name_in_file
        for name, name_in_file in zip(names, table.content.names, strict=True)
        if name and name != "ignore"
    }
    ignored = {name_in_file: "ignore" for name_in_file in table.content.names if name_in_file not in in_file.values()}
    return table.called(in_file)._replace(given=ignored)


def _give_meanings(table: _Table, meanings: Mapping[str, str]) -> _Table:
    """With the meanings that are given, by names in the file or here; those of no column are left out."""
    current_names = {name_in_file: name for name, name_in_file in table.in_file.items()}
    names = [name for name, _ in table.columns]
    resolved = tabulation.resolve_names(
        names, {current_names.get(name, name): meaning for name, meaning in meanings.items()}
    )
    known_meanings = {**table.given, **resolved}
    return table._replace(given={name: meaning for name, meaning in known_meanings.items() if name in names})


def _reshape(table: _Table, arm: "arms.Arm | None", meanings: Mapping[str, str], joined: bool) -> _Table:
    """With columns called by the words in cells beside them, a row for each state, and points on a body as its pose."""
    file_format = formats.find_format(table.path)
    if not joined and (file_format is None or not file_format.is_table):
        return table
    about = f"{table.path.name}: " if joined else ""
    notes = [*table.notes]
    if (named_columns := cells.name_by_cells(table.numbers, table.words)) is not None:
        notes += [f"{about}{sentence}" for sentence in inspection.describe_named_columns(named_columns)]
        words = {name: cells for name, cells in table.words.items() if name not in named_columns.by}
        table = (
            table.called(named_columns.in_file)
            if named_columns.in_file
            else table.remade(named_columns.columns, words, "named")
        )
        table = _give_meanings(table, meanings)
    states = points.gather_points(table.numbers, table.words, arm, table.given, str(table.path))
    if states is not None:
        notes += [f"{about}{sentence}" for sentence in inspection.describe_points(states.found, states.taken)]
        table = table.remade(states.columns, states.found.words, "poses")
    body = reflectors.with_pose_of_reflectors(table.numbers) if states is None else states.pose
    if body is not None:
        notes += [f"{about}{sentence}" for sentence in inspection.describe_reflectors(body)]
        table = table.remade(body.columns, table.words, "poses")
    return _give_meanings(table, meanings)._replace(notes=notes)


def _solve_pairs(table: _Table, arm: "arms.Arm | None", source: str) -> tuple[_Table, list[str]]:
    """Pairs of poses as joints and poses, as of a hand-eye calibration; any other table as it is."""
    alone = recognition.InspectedTable.of(table.numbers, table.path, arm, table.given, table.words)
    if not pose_joining.is_of_pairs(alone):
        return table, table.notes
    if arm is None:
        example = command_line("init", source, "--arm", "NAME")
        raise InputError(
            f"{table.path}: holds pairs of poses and no joints, which the nominal kinematics of the arm give; name it, "
            f"`{example}`"
        )
    pairs = pose_joining.solve_pairs(alone, arm)
    return table.remade(pairs.columns, {}, "poses"), [*table.notes, *inspection.describe_pairs(pairs, arm.name)]


def _join(
    first: _Table, second: _Table, arm: "arms.Arm | None", pose_source: str | None, sources: tuple[str, ...]
) -> tuple[_Table, list[str]]:
    """The table of two files, called after the second, and how they were joined."""
    notes = [*dict.fromkeys([*first.notes, *second.notes])]
    joined = [
        recognition.InspectedTable.of(table.numbers, table.path, arm, table.given, table.words, pose_source)
        for table in (first, second)
    ]
    with_joints = [file for file in joined if file.inspection.of("q") is not None]
    if len(with_joints) == 2 and (place := recognition.find_commands(joined)) is not None:
        return _join_commands((first, second), joined, place, notes)
    if arm is None and len(with_joints) < 2:
        example = command_line("init", *sources, "--arm", "NAME")
        raise InputError(f"two files are joined by the motion of the arm: name it, `{example}`")
    joints, poses = _assign_roles(*joined)
    assert arm is not None  # of two files with joints `_assign_roles` takes none
    if joints.inspection.of("q") is None:
        moved = pose_joining.with_joints(joints, arm)
        joints = moved.file
        notes += inspection.describe_solved_joints(moved, arm.name)
    joined_files = pose_joining.join_files(joints, poses, arm)
    notes += inspection.describe_joined_files(joined_files, Path(joints.source).name, Path(poses.source).name)
    column_meanings = {
        name: meaning for name, meaning in {**first.given, **second.given}.items() if name in joined_files.columns
    }
    return first.remade(joined_files.columns, {}, "")._replace(made=second.path.stem, given=column_meanings), notes


def _join_commands(
    tables: "Sequence[_Table]", joined: "Sequence[recognition.InspectedTable]", place: int, notes: list[str]
) -> tuple[_Table, list[str]]:
    """The table of the measured joints of one file with the commands of the other, and how they were joined."""
    commands = joined[place]
    states = joined[1 - place]
    both = tracking_joining.join_commands(states, commands)
    count = len(both.columns["time_s"])
    names = (Path(commands.source).name, Path(states.source).name)
    notes = [*notes, *inspection.describe_joined_commands(both, count, names)]
    column_meanings = {name: meaning for name, meaning in tables[1 - place].given.items() if name in both.columns}
    table = tables[0].remade(both.columns, {}, "")
    return table._replace(made=tables[1].path.stem, given=column_meanings), notes


def _write(table: _Table, overwrite: bool) -> Path:
    import pyarrow as pa

    numbers = pa.table(table.numbers)
    return write_atomically(table.path, lambda target: tables.write_table(numbers, target), overwrite)


def _assign_roles(
    first_file: "recognition.InspectedTable", second_file: "recognition.InspectedTable"
) -> "tuple[recognition.InspectedTable, recognition.InspectedTable]":
    """The file with the joints and the one with the poses, whatever their order.

    Where neither has joints, the robot's is the one whose poses are the controller's by their names, or the first.
    """
    with_joints = [file for file in (first_file, second_file) if file.inspection.of("q") is not None]
    if len(with_joints) == 2:
        raise InputError(
            f"{first_file.source} and {second_file.source}: both have joint positions; if one has the commands, call "
            "it commands.csv, else say which are none by --column NAME=ignore"
        )
    roles = [
        any(source.role == "controller" for source in file.inspection.sources) for file in (first_file, second_file)
    ]
    joints = first_file
    if with_joints:
        joints = with_joints[0]
    elif roles == [False, True]:
        joints = second_file
    poses = second_file if joints is first_file else first_file
    if poses.inspection.of("position") is None:
        raise InputError(
            f"{poses.source}: no columns look like positions of the tool; say which they are, --column NAME=x_mm "
            "--column NAME=y_mm --column NAME=z_mm"
        )
    return joints, poses


# ------------------------------------------------------------------ images


@final
@dataclass(frozen=True)
class DetectCommand:
    """Find the corners of a board in images, by OpenCV, and write them as a recording of a camera.

    Joints are those of a table with a row an image, in the order of the images, or with a column `image` of their
    names. Where no camera is declared, its lens is calibrated from the images and refined with the arm.

    For example:

        lite6jax detect images --board charuco:7x5,20mm --joints joints.csv --arm lite6
        lite6jax detect images --board charuco:7x5,20mm,15mm,5X5_100 --joints joints.csv --mounted on_flange
        lite6jax detect images --board checkerboard:8x5,25mm --joints joints.csv --arm lite6
    """

    source: Annotated[Positional[tuple[str, ...]], arg(metavar="IMAGES")]
    """Images, or the folder that holds them."""
    board: Annotated[str, arg(metavar="charuco:7x5,20mm")]
    """The board by its squares, columns and rows, and their side. Of a ChArUco board a marker's side (three quarters of
    a square's) and the dictionary (4X4_50) may follow; a checkerboard has no markers."""
    joints: Annotated[Path, arg(metavar="FILE")]
    """The joints at which the images were taken (.csv, .parquet)."""
    out: command.OutFile = None
    """Write the recording here (.csv or .parquet); beside the joints, as NAME_corners.csv, where not given."""
    mounted: Literal["fixed", "on_flange"] = "fixed"
    """fixed: the camera stands, and the board is on the flange; on_flange: the other way round."""
    arm: command.ArmName = None
    """The nominal arm: a bundled name, or a file."""
    set: Annotated[tuple[str, ...], UseAppendAction, arg(metavar="KEY=VALUE")] = ()
    """A key of the sidecar, such as pixel_noise_px=0.2. May be repeated."""
    force: command.Force = False

    def run(self) -> int:
        """Detects, writes, prints."""
        import numpy as np

        out = self.out or self.joints.with_name(f"{self.joints.stem}_corners.csv")
        sidecar = recordings.sidecar_path(out)
        command.check_outputs([out, sidecar], [self.joints, *self.source], self.force)
        board = boards.parse_board(self.board)
        overrides = command.parse_pairs("--set", self.set, as_yaml=True)
        arm = None if self.arm is None else files.read_arm(self.arm)
        joints = recordings.read_recording(self.joints, arm=arm)
        images = boards.list_images(self.source)
        rows = boards.match_rows(images, self.joints)
        corners = boards.detect_corners(images, board)
        declared = {"pose_source": "camera", "motion": "static"} | overrides
        # beside the joints, as their sidecar's paths are; both move with the recording
        arm_name = None if self.arm is None else command.name_arm(self.arm, self.joints)
        settings = sidecar_settings.declared_settings(joints.settings, arm_name, declared)
        settings = replace(settings, board=settings.board or board.settings)
        error = None
        if settings.camera is None:
            camera, error = boards.calibrate_lens(corners, board, self.mounted)
            settings = replace(settings, camera=camera)
        at = {int(row): k for k, row in enumerate(joints.row)}
        image_indices = [k for k, row in enumerate(rows) if corners.shown[k] and int(row) in at]
        moved = joints.select(np.array([at[int(rows[k])] for k in image_indices]))
        readings = recordings.readings_from_arrays("camera", pixels=corners.pixels[image_indices])
        recording = moved.made_anew(position=None, quaternion=None, readings=readings, settings=settings)
        written = [recordings.write_recording(recording, out, self.force), sidecar]
        left_out = [images[k].name for k in range(len(images)) if k not in image_indices]
        screen.show(self._page(recording, left_out, board, error))
        if corners.legacy:
            screen.show(
                screen.notes(["the board has the pattern of OpenCV before 4.6: its first square is white, not black"])
            )
        screen.written(written)
        return command.DONE

    def _page(
        self, recording: "recordings.Recording", left_out: list[str], board: "boards.Board", error: float | None
    ) -> "Iterator[RenderableType]":
        import numpy as np
        from rich.text import Text

        assert recording.readings is not None
        corner_count = np.isfinite(recording.readings.pixels[..., 0]).sum()
        images = recording.samples + len(left_out)
        board_corners = board.settings.columns * board.settings.rows
        yield Text(
            f"{recording.samples} of {images} images show the board: {corner_count} corners, "
            f"{board_corners} at most in each."
        )
        if left_out:
            listed = formatting.shortened(left_out, 6)
            yield Text(f"Left out, as they show fewer than 6 corners or have no joints: {listed}.")
        camera = recording.settings.camera
        if error is not None and camera is not None:
            yield Text(
                f"The camera, calibrated from the images: fx {camera.fx:.1f}, fy {camera.fy:.1f}, cx {camera.cx:.1f}, "
                f"cy {camera.cy:.1f} px; its corners are {error:.2f} px off (RMS). They are "
                "refined with the arm."
            )
